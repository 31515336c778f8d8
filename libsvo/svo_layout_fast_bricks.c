/* Layout 2 ("fast"): the dictionary of bricks, and how blocks name them. */
#include <stdlib.h>
#include <string.h>

#include "svo_task.h"
#include "svoi_layout_fast.h"

/* --- order by use ------------------------------------------------------------------------------------------------ */

typedef struct used { uint32_t uses, number; } used;

static int compare_used(const void *x, const void *y)
{
    const used *a = x, *b = y;
    if (a->uses != b->uses) return a->uses > b->uses ? -1 : 1;
    return (a->number > b->number) - (a->number < b->number);
}

/* Most used first, then by number: by counting where few uses are frequent, by sorting where they are many. */
bool svoi_fast_sort(const svo_allocator *a, const uint32_t *uses, uint64_t count, const uint32_t *chosen, uint32_t *out)
{
    enum { FEW = 1024 };
    uint64_t at[FEW] = {0}, many = 0;
    for (uint64_t i = 0; i < count; i++)
        if (chosen[i] != SVOI_FAST_INSIDE) {
            if (uses[i] < FEW) at[uses[i]]++;
            else many++;
        }
    used *top = svo_alloc(a, many, sizeof *top);
    if (top == NULL && many != 0) return false;
    uint64_t next = many;
    for (uint32_t u = FEW; u-- > 0;) {
        uint64_t n = at[u];
        at[u] = next;
        next += n;
    }
    uint64_t k = 0;
    for (uint64_t i = 0; i < count; i++) {
        if (chosen[i] == SVOI_FAST_INSIDE) continue;
        if (uses[i] < FEW) out[at[uses[i]]++] = (uint32_t)i;
        else top[k++] = (used){uses[i], (uint32_t)i};
    }
    if (many != 0) qsort(top, (size_t)many, sizeof *top, compare_used);
    for (uint64_t i = 0; i < many; i++) out[i] = top[i].number;
    svo_free(a, top, many, sizeof *top);
    return true;
}

/* --- bricks ------------------------------------------------------------------------------------------------------ */

svo_result svoi_fast_dictionary(svoi_fast_writer *w, svo_error *err)
{
    const svoi_symlevel *l = &w->d->level[w->bottom];
    uint64_t count = 0;
    w->rank = svo_alloc(w->a, l->count, sizeof *w->rank);
    if (w->rank == NULL) return svoi_no_memory(w->p, "geometry", err);
    for (uint64_t i = 0; i < l->count; i++) {
        bool in = l->uses[i] > 1;
        w->rank[i] = in ? 0 : SVOI_FAST_INSIDE;
        count += in;
    }
    uint32_t *order = svo_alloc(w->a, count, sizeof *order);
    if ((order == NULL && count != 0) || !svo_buffer_reserve(&w->p->bricks, (size_t)count * 8) ||
        !svoi_fast_sort(w->a, l->uses, l->count, w->rank, order)) {
        svo_free(w->a, order, count, sizeof *order);
        return svoi_no_memory(w->p, "geometry", err);
    }
    uint64_t *bricks = (uint64_t *)(void *)w->p->bricks.data;
    for (uint64_t i = 0; i < count; i++) {
        w->rank[order[i]] = (uint32_t)i;
        bricks[i] = l->bits[order[i]];
    }
    w->p->bricks.size = (size_t)count * 8;
    w->p->view.bricks = bricks;
    w->p->view.brick_count = count;
    w->dictionary = (uint32_t)count;
    svo_free(w->a, order, count, sizeof *order);
    return SVO_OK;
}

static bool make_cosets(svoi_fast_writer *w)
{
    w->coset = svo_alloc(w->a, w->d->subgroup_count, sizeof *w->coset);
    if (w->coset == NULL) return false;
    for (uint32_t i = 0; i < w->d->subgroup_count; i++)
        for (uint32_t t = 0; t < SVOI_TURNS; t++) {
            uint64_t same = 0;
            for (uint64_t s = w->d->subgroup[i]; s != 0; s &= s - 1)
                same |= (uint64_t)1 << svoi_turn_after(t, (uint32_t)__builtin_ctzll(s));
            w->coset[i][t] = same;
        }
    return true;
}

/* Turns, one bit each, that take a brick of the dictionary to its place in a block. */
static uint64_t brick_turns(const svoi_fast_writer *w, const uint32_t *item, const uint8_t *turn, uint32_t i)
{
    uint32_t number = item[1 + i];
    return w->coset[w->d->level[w->bottom].stabilizer[number]][turn[1 + i]];
}

/* The turn that most bricks of a block have (the least of these), by adding 48 counters bit by bit. */
static uint32_t common_turn(const svoi_fast_writer *w, const uint32_t *item, const uint8_t *turn, uint32_t count)
{
    uint64_t c[4] = {0};
    for (uint32_t i = 0; i < count; i++) {
        if (w->rank[item[1 + i]] == SVOI_FAST_INSIDE) continue;
        uint64_t carry = brick_turns(w, item, turn, i);
        for (int k = 0; k < 4; k++) {
            uint64_t both = c[k] & carry;
            c[k] ^= carry;
            carry = both;
        }
    }
    uint64_t best = ((uint64_t)1 << SVOI_TURNS) - 1;
    for (int k = 4; k-- > 0;)
        if ((best & c[k]) != 0) best &= c[k];
    return (uint32_t)__builtin_ctzll(best);
}

/* A change takes the frame of the block's bricks to the brick's: the inverse of what is left of the brick's turn. */
static uint32_t change_of(uint32_t block_turn, uint32_t turn)
{
    return svoi_turn_after(svoi_turn_inverse(turn), block_turn);
}

typedef struct census {
    uint64_t change[SVOI_TURNS];
    uint64_t code[2][33][SVOI_CODE_TURNS]; /* bricks of blocks without and with literals, by bits of their number and of the index of their change */
} census;

typedef struct block_work {
    svoi_fast_writer *w;
    census *census; /* one for each worker */
} block_work;

/* The turn of each block, and how often each change is needed. Of several that mean the same the least is taken here. */
static svo_result turn_blocks(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)err;
    block_work *u = user;
    svoi_fast_writer *w = u->w;
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    for (uint64_t i = begin; i < end; i++) {
        const uint32_t *item = l->items + l->start[i];
        const uint8_t *turn = l->turn + l->start[i];
        uint32_t count = (uint32_t)__builtin_popcount(svoi_head_refs(item[0])), common = common_turn(w, item, turn, count);
        w->block_turn[i] = (uint8_t)common;
        for (uint32_t k = 0; k < count; k++) {
            uint64_t same = brick_turns(w, item, turn, k);
            if (w->rank[item[1 + k]] == SVOI_FAST_INSIDE || (same >> common & 1)) continue;
            u->census[worker].change[change_of(common, (uint32_t)__builtin_ctzll(same))]++;
        }
    }
    return SVO_OK;
}

/* The most frequent change that each brick can have. */
static svo_result change_bricks(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)err;
    block_work *u = user;
    svoi_fast_writer *w = u->w;
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    for (uint64_t i = begin; i < end; i++) {
        const uint32_t *item = l->items + l->start[i];
        const uint8_t *turn = l->turn + l->start[i];
        uint32_t count = (uint32_t)__builtin_popcount(svoi_head_refs(item[0])), common = w->block_turn[i];
        uint32_t literals = 0;
        for (uint32_t k = 0; k < count; k++) literals |= w->rank[item[1 + k]] == SVOI_FAST_INSIDE;
        for (uint32_t k = 0; k < count; k++) {
            uint64_t same = brick_turns(w, item, turn, k);
            uint32_t best = 0;
            if (!(same >> common & 1)) {
                best = SVOI_TURNS;
                for (; same != 0; same &= same - 1) {
                    uint32_t order = w->order[change_of(common, (uint32_t)__builtin_ctzll(same))];
                    if (order < best) best = order;
                }
            }
            uint32_t rank = w->rank[item[1 + k]];
            if (rank == SVOI_FAST_INSIDE) { /* written as it lies in the block's turn; the change is not stored */
                w->change[l->start[i] + 1 + k] = 0;
                continue;
            }
            w->change[l->start[i] + 1 + k] = (uint8_t)best;
            u->census[worker].code[literals][svoi_fast_length(rank)][svoi_fast_length(best)]++;
        }
    }
    return SVO_OK;
}

/* Blocks of mode 1 are those with bricks that are written out, and others that it suits. */
static void choose_codes(svoi_fast_writer *w, census *c)
{
    for (uint32_t mode = 0; mode < 2; mode++) {
        svoi_code_class best[4];
        svoi_fast_classes(c->code[mode], svoi_fast_bits_for(w->dictionary), 3 - mode, best);
        for (uint32_t k = 0; k < 4; k++) {
            bool literal = mode == 1 && k == 3;
            w->f->id_bits[mode][k] = literal ? SVO_FAST_LITERAL : (uint8_t)best[k].ids;
            w->f->code_bits[mode][k] = literal ? 64 : (uint8_t)(best[k].ids + best[k].turns);
        }
    }
}

/* Tag of a brick in a block of a mode: the narrowest that can say it; 4 when none can. */
uint32_t svoi_fast_tag(const svoi_fast_writer *w, uint32_t mode, uint32_t rank, uint32_t change)
{
    const svo_view_fast *f = w->f;
    uint32_t best = 4;
    for (uint32_t t = 0; t < 4; t++) {
        uint32_t ids = f->id_bits[mode][t], width = f->code_bits[mode][t];
        bool can = rank == SVOI_FAST_INSIDE ? ids == SVO_FAST_LITERAL
                                  : ids != SVO_FAST_LITERAL && rank >> ids == 0 && change >> (width - ids) == 0;
        if (can && (best == 4 || width < f->code_bits[mode][best])) best = t;
    }
    return best;
}

static uint64_t block_size(const svoi_fast_writer *w, uint64_t number, uint32_t mode)
{
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    const uint32_t *item = l->items + l->start[number];
    uint32_t count = (uint32_t)__builtin_popcount(svoi_head_refs(item[0]));
    uint64_t bits = (w->full ? 16 : 8) + 1 + SVOI_FAST_TURN_BITS + 2 * count;
    for (uint32_t k = 0; k < count; k++) {
        uint32_t tag = svoi_fast_tag(w, mode, w->rank[item[1 + k]], w->change[l->start[number] + 1 + k]);
        if (tag == 4) return UINT64_MAX;
        bits += w->f->code_bits[mode][tag];
    }
    return bits;
}

uint32_t svoi_fast_mode(const svoi_fast_writer *w, uint64_t number, uint64_t *bits)
{
    uint64_t zero = block_size(w, number, 0), one = block_size(w, number, 1);
    *bits = one < zero ? one : zero;
    return one < zero;
}

static svo_result size_blocks(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    svoi_fast_writer *w = ((block_work *)user)->w;
    for (uint64_t i = begin; i < end; i++) {
        uint64_t bits;
        svoi_fast_mode(w, i, &bits);
        w->block_bits[i] = (uint16_t)bits;
    }
    return SVO_OK;
}

static void order_changes(svoi_fast_writer *w, const census *c)
{
    uint64_t uses[SVOI_TURNS];
    memcpy(uses, c->change, sizeof uses);
    for (uint32_t k = 0; k < SVOI_TURNS; k++) {
        uint32_t best = SVOI_TURNS;
        for (uint32_t t = 0; t < SVOI_TURNS && k != 0; t++)
            if (uses[t] != UINT64_MAX && (best == SVOI_TURNS || uses[t] > uses[best])) best = t;
        if (k == 0) best = 0;
        uses[best] = UINT64_MAX;
        w->f->turn[k] = (uint8_t)best;
        w->order[best] = (uint8_t)k;
    }
}

svo_result svoi_fast_blocks(svoi_fast_writer *w, uint32_t threads, svo_error *err)
{
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    uint32_t workers = threads != 0 ? threads : svo_processor_count();
    block_work u = {w, svo_calloc(w->a, workers, sizeof *u.census)};
    w->block_turn = svo_alloc(w->a, l->count, 1);
    w->block_bits = svo_alloc(w->a, l->count, sizeof *w->block_bits);
    w->change = svo_alloc(w->a, l->item_count, 1);
    if (u.census == NULL || w->block_turn == NULL || w->block_bits == NULL || w->change == NULL || !make_cosets(w)) {
        svo_free(w->a, u.census, workers, sizeof *u.census);
        return svoi_no_memory(w->p, "geometry", err);
    }
    svo_result r = svo_parallel_for(threads, l->count, 4096, turn_blocks, &u, err);
    for (uint32_t i = 1; i < workers; i++)
        for (uint32_t t = 0; t < SVOI_TURNS; t++) u.census[0].change[t] += u.census[i].change[t];
    order_changes(w, u.census);
    if (r == SVO_OK) r = svo_parallel_for(threads, l->count, 4096, change_bricks, &u, err);
    for (uint32_t i = 1; i < workers; i++)
        for (uint32_t n = 0; n < sizeof u.census->code / sizeof(uint64_t); n++) (&u.census[0].code[0][0][0])[n] += (&u.census[i].code[0][0][0])[n];
    choose_codes(w, u.census);
    if (r == SVO_OK) r = svo_parallel_for(threads, l->count, 4096, size_blocks, &u, err);
    svo_free(w->a, u.census, workers, sizeof *u.census);
    return r;
}
