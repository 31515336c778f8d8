/* Layout 2 ("fast") from a symmetric DAG. Everything that a node's bits depend on is the same in every frame, so sizes are
 * found once for each stored node, bottom-up, and then every node is written where it belongs.
 *
 * Sharing has a price: a reference and its turn. A node is put into the pool of its level only where that is smaller
 * than writing it as often as it is used, and a brick that is used once is written out in its block. */
#include <stdlib.h>
#include <string.h>

#include "svo_task.h"
#include "svoi_fast.h"

enum { INSIDE = UINT32_MAX, TURN_BITS = 6, PADDING = 8 };

typedef struct writer {
    svo_packed *p;
    const svo_allocator *a;
    svoi_symdag *d;
    svo_view_fast *f;
    uint32_t bottom; /* level of the bricks */
    bool numbered, full;
    /* bricks */
    uint32_t *rank;  /* number in the dictionary, or INSIDE */
    uint32_t dictionary;
    uint64_t (*coset)[SVOI_TURNS]; /* [subgroup][turn]: the turns that mean the same */
    uint8_t order[SVOI_TURNS];     /* place of a change of turn in f->turn */
    /* blocks: the level above */
    uint8_t *block_turn; /* turns the block's bricks to the block, all of them together */
    uint8_t *change;     /* parallel to items: what is left for this brick, as an index of f->turn */
    uint16_t *block_bits;
    /* levels above the blocks */
    uint64_t *bits[SVO_MAX_DEPTH];
    uint32_t *place[SVO_MAX_DEPTH]; /* in the pool, in bytes, or INSIDE */
    uint32_t *pool[SVO_MAX_DEPTH];  /* numbers in order */
    uint8_t *tree;
} writer;

static uint32_t bits_for(uint64_t count) { return count < 2 ? 0 : 64 - (uint32_t)__builtin_clzll(count - 1); }
static uint32_t length(uint64_t value) { return value == 0 ? 0 : 64 - (uint32_t)__builtin_clzll(value); }

/* --- order by use ------------------------------------------------------------------------------------------------ */

typedef struct used { uint32_t uses, number; } used;

static int compare_used(const void *x, const void *y)
{
    const used *a = x, *b = y;
    if (a->uses != b->uses) return a->uses > b->uses ? -1 : 1;
    return (a->number > b->number) - (a->number < b->number);
}

/* Most used first, then by number: by counting where few uses are frequent, by sorting where they are many. */
static bool sort_by_use(const svo_allocator *a, const uint32_t *uses, uint64_t count, const uint32_t *chosen, uint32_t *out)
{
    enum { FEW = 1024 };
    uint64_t at[FEW] = {0}, many = 0;
    for (uint64_t i = 0; i < count; i++)
        if (chosen[i] != INSIDE) {
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
        if (chosen[i] == INSIDE) continue;
        if (uses[i] < FEW) out[at[uses[i]]++] = (uint32_t)i;
        else top[k++] = (used){uses[i], (uint32_t)i};
    }
    if (many != 0) qsort(top, (size_t)many, sizeof *top, compare_used);
    for (uint64_t i = 0; i < many; i++) out[i] = top[i].number;
    svo_free(a, top, many, sizeof *top);
    return true;
}

/* --- bricks ------------------------------------------------------------------------------------------------------ */

static svo_result make_dictionary(writer *w, svo_error *err)
{
    const svoi_symlevel *l = &w->d->level[w->bottom];
    uint64_t count = 0;
    w->rank = svo_alloc(w->a, l->count, sizeof *w->rank);
    if (w->rank == NULL) return svoi_no_memory(w->p, "geometry", err);
    for (uint64_t i = 0; i < l->count; i++) {
        bool in = l->uses[i] > 1;
        w->rank[i] = in ? 0 : INSIDE;
        count += in;
    }
    uint32_t *order = svo_alloc(w->a, count, sizeof *order);
    if ((order == NULL && count != 0) || !svo_buffer_reserve(&w->p->bricks, (size_t)count * 8) ||
        !sort_by_use(w->a, l->uses, l->count, w->rank, order)) {
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

static bool make_cosets(writer *w)
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
static uint64_t brick_turns(const writer *w, const uint32_t *item, const uint8_t *turn, uint32_t i)
{
    uint32_t number = item[1 + i];
    return w->coset[w->d->level[w->bottom].stabilizer[number]][turn[1 + i]];
}

/* The turn that most bricks of a block have (the least of these), by adding 48 counters bit by bit. */
static uint32_t common_turn(const writer *w, const uint32_t *item, const uint8_t *turn, uint32_t count)
{
    uint64_t c[4] = {0};
    for (uint32_t i = 0; i < count; i++) {
        if (w->rank[item[1 + i]] == INSIDE) continue;
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
    writer *w;
    census *census; /* one for each worker */
} block_work;

/* The turn of each block, and how often each change is needed. Of several that mean the same the least is taken here. */
static svo_result turn_blocks(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)err;
    block_work *u = user;
    writer *w = u->w;
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    for (uint64_t i = begin; i < end; i++) {
        const uint32_t *item = l->items + l->start[i];
        const uint8_t *turn = l->turn + l->start[i];
        uint32_t count = (uint32_t)__builtin_popcount(svoi_head_refs(item[0])), common = common_turn(w, item, turn, count);
        w->block_turn[i] = (uint8_t)common;
        for (uint32_t k = 0; k < count; k++) {
            uint64_t same = brick_turns(w, item, turn, k);
            if (w->rank[item[1 + k]] == INSIDE || (same >> common & 1)) continue;
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
    writer *w = u->w;
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    for (uint64_t i = begin; i < end; i++) {
        const uint32_t *item = l->items + l->start[i];
        const uint8_t *turn = l->turn + l->start[i];
        uint32_t count = (uint32_t)__builtin_popcount(svoi_head_refs(item[0])), common = w->block_turn[i];
        uint32_t literals = 0;
        for (uint32_t k = 0; k < count; k++) literals |= w->rank[item[1 + k]] == INSIDE;
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
            if (rank == INSIDE) { /* written as it lies in the block's turn; the change is not stored */
                w->change[l->start[i] + 1 + k] = 0;
                continue;
            }
            w->change[l->start[i] + 1 + k] = (uint8_t)best;
            u->census[worker].code[literals][length(rank)][length(best)]++;
        }
    }
    return SVO_OK;
}

/* Blocks of mode 1 are those with bricks that are written out, and others that it suits. */
static void choose_codes(writer *w, census *c)
{
    for (uint32_t mode = 0; mode < 2; mode++) {
        svoi_code_class best[4];
        svoi_fast_classes(c->code[mode], bits_for(w->dictionary), 3 - mode, best);
        for (uint32_t k = 0; k < 4; k++) {
            bool literal = mode == 1 && k == 3;
            w->f->id_bits[mode][k] = literal ? SVO_FAST_LITERAL : (uint8_t)best[k].ids;
            w->f->code_bits[mode][k] = literal ? 64 : (uint8_t)(best[k].ids + best[k].turns);
        }
    }
}

/* Tag of a brick in a block of a mode: the narrowest that can say it; 4 when none can. */
static uint32_t tag_of(const writer *w, uint32_t mode, uint32_t rank, uint32_t change)
{
    const svo_view_fast *f = w->f;
    uint32_t best = 4;
    for (uint32_t t = 0; t < 4; t++) {
        uint32_t ids = f->id_bits[mode][t], width = f->code_bits[mode][t];
        bool can = rank == INSIDE ? ids == SVO_FAST_LITERAL
                                  : ids != SVO_FAST_LITERAL && rank >> ids == 0 && change >> (width - ids) == 0;
        if (can && (best == 4 || width < f->code_bits[mode][best])) best = t;
    }
    return best;
}

static uint64_t block_size(const writer *w, uint64_t number, uint32_t mode)
{
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    const uint32_t *item = l->items + l->start[number];
    uint32_t count = (uint32_t)__builtin_popcount(svoi_head_refs(item[0]));
    uint64_t bits = (w->full ? 16 : 8) + 1 + TURN_BITS + 2 * count;
    for (uint32_t k = 0; k < count; k++) {
        uint32_t tag = tag_of(w, mode, w->rank[item[1 + k]], w->change[l->start[number] + 1 + k]);
        if (tag == 4) return UINT64_MAX;
        bits += w->f->code_bits[mode][tag];
    }
    return bits;
}

static uint32_t block_mode(const writer *w, uint64_t number, uint64_t *bits)
{
    uint64_t zero = block_size(w, number, 0), one = block_size(w, number, 1);
    *bits = one < zero ? one : zero;
    return one < zero;
}

static svo_result size_blocks(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    writer *w = ((block_work *)user)->w;
    for (uint64_t i = begin; i < end; i++) {
        uint64_t bits;
        block_mode(w, i, &bits);
        w->block_bits[i] = (uint16_t)bits;
    }
    return SVO_OK;
}

static void order_changes(writer *w, const census *c)
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

static svo_result make_blocks(writer *w, uint32_t threads, svo_error *err)
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

/* --- pools ------------------------------------------------------------------------------------------------------- */

static uint64_t node_bits(const writer *w, uint32_t level, uint64_t number)
{
    return level == w->bottom - 1 ? w->block_bits[number] : w->bits[level][number];
}

/* Which nodes of a level are shared, and where they go. */
static svo_result make_pool(writer *w, uint32_t level, svo_error *err)
{
    const svoi_symlevel *l = &w->d->level[level];
    svo_view_fast_level *f = &w->f->level[level];
    w->place[level] = svo_alloc(w->a, l->count, sizeof *w->place[level]);
    if (w->place[level] == NULL) return svoi_no_memory(w->p, "geometry", err);
    /* what a reference may cost, from what would be shared at most */
    uint64_t bytes = 0;
    for (uint64_t i = 0; i < l->count; i++)
        if (l->uses[i] > 1) bytes += (node_bits(w, level, i) + 7) / 8;
    uint64_t reference = TURN_BITS + bits_for(bytes), count = 0;
    for (uint64_t i = 0; i < l->count; i++) {
        uint64_t bits = node_bits(w, level, i), uses = l->uses[i];
        bool in = level == 0 || (uses > 1 && (uses - 1) * bits > uses * reference);
        w->place[level][i] = in ? 0 : INSIDE;
        count += in;
    }
    f->pool_count = count;
    w->pool[level] = svo_alloc(w->a, count, sizeof *w->pool[level]);
    if ((w->pool[level] == NULL && count != 0) || !sort_by_use(w->a, l->uses, l->count, w->place[level], w->pool[level]))
        return svoi_no_memory(w->p, "geometry", err);
    uint64_t at = 0;
    for (uint64_t i = 0; i < count; i++) {
        if (at >= INSIDE) return svo_fail(err, SVO_LIMIT, "level %u has more than 2^32 bytes of shared nodes", level);
        w->place[level][w->pool[level][i]] = (uint32_t)at;
        at += (node_bits(w, level, w->pool[level][i]) + 7) / 8;
    }
    f->end = at * 8; /* counted from the begin of the pool; the caller adds where that lies */
    return SVO_OK;
}

/* Three widths of references to the pool of level + 1. */
static void choose_references(writer *w, uint32_t level)
{
    const svoi_symlevel *l = &w->d->level[level + 1];
    uint64_t sum[33] = {0}, least = UINT64_MAX;
    uint32_t widest = 0, best[2] = {0, 0};
    for (uint64_t i = 0; i < w->f->level[level + 1].pool_count; i++) {
        uint32_t n = w->pool[level + 1][i], k = length(w->place[level + 1][n]);
        sum[k] += l->uses[n];
        if (k > widest) widest = k;
    }
    for (uint32_t k = 1; k <= 32; k++) sum[k] += sum[k - 1];
    for (uint32_t a = 0; a <= widest; a++)
        for (uint32_t b = a; b <= widest; b++) {
            uint64_t cost = sum[a] * a + (sum[b] - sum[a]) * b + (sum[widest] - sum[b]) * widest;
            if (cost < least) least = cost, best[0] = a, best[1] = b;
        }
    uint8_t *bits = w->f->level[level].code_bits;
    bits[1] = (uint8_t)(best[0] + TURN_BITS);
    bits[2] = (uint8_t)(best[1] + TURN_BITS);
    bits[3] = (uint8_t)(widest + TURN_BITS);
}

static uint32_t reference_tag(const writer *w, uint32_t level, uint32_t place)
{
    const uint8_t *bits = w->f->level[level].code_bits;
    for (uint32_t t = 1; t < 3; t++)
        if (place >> (bits[t] - TURN_BITS) == 0) return t;
    return 3;
}

static uint64_t child_size(const writer *w, uint32_t level, uint32_t number) { return svoi_symdag_size(w->d, level + 1, number); }

/* Widths of the tables of a level, and bits of its nodes: of levels above the blocks. */
static svo_result size_nodes(writer *w, uint32_t level, svo_error *err)
{
    const svoi_symlevel *l = &w->d->level[level];
    svo_view_fast_level *f = &w->f->level[level];
    bool above_blocks = level + 2 == w->bottom;
    w->bits[level] = svo_alloc(w->a, l->count, sizeof *w->bits[level]);
    if (w->bits[level] == NULL) return svoi_no_memory(w->p, "geometry", err);
    uint64_t widest_skip = 0, widest_size = 0;
    for (int pass = 0; pass < 2; pass++) {
        for (uint64_t i = 0; i < l->count; i++) {
            const uint32_t *item = l->items + l->start[i];
            uint32_t count = (uint32_t)__builtin_popcount(svoi_head_refs(item[0])), inner = 0;
            uint64_t inside = 0, shared = 0;
            for (uint32_t k = 0; k < count; k++) {
                uint32_t n = item[1 + k], place = w->place[level + 1][n];
                if (place == INSIDE) inside += node_bits(w, level + 1, n), inner++;
                else shared += f->code_bits[reference_tag(w, level, place)];
                if (pass == 0 && child_size(w, level, n) > widest_size) widest_size = child_size(w, level, n);
            }
            if (svoi_head_full(item[0]) != 0 && widest_size == 0) widest_size = 1; /* a full leaf counts one */
            if (inside > widest_skip) widest_skip = inside;
            w->bits[level][i] = (w->full ? 16 : 8) + 2 * count + (inner > 1 ? (uint64_t)(inner - 1) * f->skip_bits : 0) +
                                (uint64_t)__builtin_popcount(svoi_head_mask(item[0])) * f->size_bits + shared + inside;
        }
        if (pass != 0) break;
        f->skip_bits = above_blocks ? 0 : (uint8_t)(length(widest_skip) + (widest_skip == 0));
        f->size_bits = above_blocks || !w->numbered ? 0 : (uint8_t)length(widest_size);
    }
    return SVO_OK;
}

/* --- writing ----------------------------------------------------------------------------------------------------- */

static void put(writer *w, uint64_t *p, uint64_t value, uint32_t n)
{
    if (n > 57) {
        put(w, p, value & 0xffffffff, 32);
        value >>= 32, n -= 32;
    }
    uint64_t word;
    memcpy(&word, w->tree + (*p >> 3), 8);
    word |= value << (*p & 7);
    memcpy(w->tree + (*p >> 3), &word, 8);
    *p += n;
}

/* Children of a stored node as they lie after `turn`: for each octant the place in its items, 0 where it has no reference. */
static uint32_t turned_children(const uint32_t *item, uint32_t turn, uint8_t at[8])
{
    uint32_t refs = svoi_head_refs(item[0]), k = 1;
    memset(at, 0, 8);
    for (uint32_t s = refs; s != 0; s &= s - 1) at[svoi_turn_octant(turn, (uint32_t)__builtin_ctz(s))] = (uint8_t)k++;
    return refs;
}

static void put_head(writer *w, uint64_t *p, uint32_t head, uint32_t turn)
{
    put(w, p, svoi_turn_mask(turn, svoi_head_mask(head)), 8);
    if (w->full) put(w, p, svoi_turn_mask(turn, svoi_head_full(head)), 8);
}

static void write_block(writer *w, uint64_t number, uint32_t turn, uint64_t *p)
{
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    const uint32_t *item = l->items + l->start[number];
    const uint8_t *turns = l->turn + l->start[number], *change = w->change + l->start[number];
    uint8_t at[8];
    uint64_t bits;
    uint32_t mode = block_mode(w, number, &bits), tags = 0, count = 0, tag[8] = {0};
    uint32_t common = w->block_turn[number]; /* brick's frame to block's */
    turned_children(item, turn, at);
    for (uint32_t o = 0; o < 8; o++) {
        if (at[o] == 0) continue;
        tag[o] = tag_of(w, mode, w->rank[item[at[o]]], change[at[o]]);
        tags |= tag[o] << 2 * count++;
    }
    put_head(w, p, item[0], turn);
    put(w, p, mode, 1);
    put(w, p, svoi_turn_inverse(svoi_turn_after(turn, common)), TURN_BITS);
    put(w, p, tags, 2 * count);
    for (uint32_t o = 0; o < 8; o++) {
        if (at[o] == 0) continue;
        uint32_t n = item[at[o]], ids = w->f->id_bits[mode][tag[o]];
        if (ids == SVO_FAST_LITERAL) /* seen in the frame of the block's bricks */
            put(w, p, svoi_turn_brick(svoi_turn_after(svoi_turn_inverse(common), turns[at[o]]), w->d->level[w->bottom].bits[n]), 64);
        else put(w, p, w->rank[n] | (uint64_t)change[at[o]] << ids, w->f->code_bits[mode][tag[o]]);
    }
}

/* `turn` takes the stored node to the frame it is written in. At most 20 deep. */
static void write_node(writer *w, uint32_t level, uint64_t number, uint32_t turn, uint64_t *p)
{
    svo_view_fast_level *f = &w->f->level[level];
    f->node_count++;
    if (level == w->bottom - 1) {
        write_block(w, number, turn, p);
        return;
    }
    const svoi_symlevel *l = &w->d->level[level], *below = &w->d->level[level + 1];
    const uint32_t *item = l->items + l->start[number];
    const uint8_t *turns = l->turn + l->start[number];
    const uint32_t *place = w->place[level + 1];
    uint8_t at[8];
    uint32_t tags = 0, count = 0, inner = 0, mask = svoi_turn_mask(turn, svoi_head_mask(item[0]));
    turned_children(item, turn, at);
    for (uint32_t o = 0; o < 8; o++) {
        if (at[o] == 0) continue;
        uint32_t where = place[item[at[o]]];
        if (where == INSIDE) inner++;
        else tags |= reference_tag(w, level, where) << 2 * count;
        count++;
    }
    put_head(w, p, item[0], turn);
    put(w, p, tags, 2 * count);
    uint64_t skip = 0;
    uint32_t left = inner;
    for (uint32_t o = 0; o < 8 && f->skip_bits != 0 && left > 1; o++) {
        if (at[o] == 0 || place[item[at[o]]] != INSIDE) continue;
        skip += node_bits(w, level + 1, item[at[o]]);
        put(w, p, skip, f->skip_bits);
        left--;
    }
    for (uint32_t o = 0; o < 8 && f->size_bits != 0; o++)
        if (mask >> o & 1) put(w, p, at[o] == 0 ? 1 : child_size(w, level, item[at[o]]), f->size_bits);
    for (uint32_t o = 0; o < 8; o++) {
        if (at[o] == 0 || place[item[at[o]]] == INSIDE) continue;
        uint32_t n = item[at[o]], code_bits = f->code_bits[reference_tag(w, level, place[n])];
        uint32_t back = w->d->least[below->stabilizer[n]][svoi_turn_after(turn, turns[at[o]])];
        put(w, p, (uint64_t)place[n] << TURN_BITS | svoi_turn_inverse(back), code_bits);
    }
    for (uint32_t o = 0; o < 8; o++)
        if (at[o] != 0 && place[item[at[o]]] == INSIDE)
            write_node(w, level + 1, item[at[o]], svoi_turn_after(turn, turns[at[o]]), p);
}

static svo_result write_tree(writer *w, svo_error *err)
{
    uint64_t bits = 0;
    for (uint32_t l = 0; l < w->bottom; l++) {
        svo_view_fast_level *f = &w->f->level[l];
        f->begin = bits;
        bits += f->end;
        f->end = bits;
    }
    uint64_t bytes = bits / 8 + PADDING;
    if (!svo_buffer_reserve(&w->p->tree, (size_t)bytes)) return svoi_no_memory(w->p, "geometry", err);
    w->tree = w->p->tree.data;
    memset(w->tree, 0, (size_t)bytes);
    for (uint32_t l = 0; l < w->bottom; l++)
        for (uint64_t i = 0; i < w->f->level[l].pool_count; i++) {
            uint32_t n = w->pool[l][i];
            uint64_t p = w->f->level[l].begin + (uint64_t)w->place[l][n] * 8;
            write_node(w, l, n, 0, &p);
            SVO_ASSERT(p == w->f->level[l].begin + (uint64_t)w->place[l][n] * 8 + node_bits(w, l, n));
        }
    w->p->tree.size = (size_t)bytes;
    w->f->tree = w->tree;
    w->f->tree_bytes = bytes;
    return SVO_OK;
}

static bool any_full(const svoi_symdag *d, uint32_t bottom)
{
    for (uint32_t l = 0; l < bottom; l++)
        for (uint64_t i = 0; i < d->level[l].count; i++)
            if (svoi_head_full(d->level[l].items[d->level[l].start[i]]) != 0) return true;
    return false;
}

static svo_result write_all(writer *w, uint32_t threads, svo_error *err)
{
    w->full = w->f->full = any_full(w->d, w->bottom);
    SVO_TRY(make_dictionary(w, err));
    SVO_TRY(make_blocks(w, threads, err));
    SVO_TRY(make_pool(w, w->bottom - 1, err));
    for (uint32_t level = w->bottom - 1; level-- > 0;) {
        choose_references(w, level);
        SVO_TRY(size_nodes(w, level, err));
        SVO_TRY(make_pool(w, level, err));
    }
    w->p->view.root = svoi_turn_inverse(w->d->root_turn);
    return write_tree(w, err);
}

svo_result svoi_layout_fast(svo_packed *p, svoi_nodes *nodes, svoi_bricks *bricks, uint32_t threads, svo_error *err)
{
    svo_view *v = &p->view;
    svoi_symdag *d = svo_calloc(&p->memory.base, 1, sizeof *d);
    if (d == NULL) return svoi_no_memory(p, "geometry", err);
    svo_buffer_init(&p->bricks, &p->memory.base);
    svo_buffer_init(&p->tree, &p->memory.base);
    v->layout = SVO_LAYOUT_FAST;
    svo_result r = svoi_symdag_make(d, nodes, bricks, v->brick_level, v->root, v->lod, svo_view_brick_lod(v), SVOI_ALL, threads, &p->memory.base);
    if (r == SVO_LIMIT) r = svo_fail(err, r, "a level has more than 2^32 words of distinct nodes");
    else if (r != SVO_OK) r = svoi_no_memory(p, "geometry", err);
    writer w = {.p = p, .a = &p->memory.base, .d = d, .f = &v->fast, .bottom = v->brick_level, .numbered = !v->unnumbered};
    if (r == SVO_OK) r = write_all(&w, threads, err);
    const svoi_symlevel *blocks = &d->level[w.bottom - 1];
    svo_free(w.a, w.rank, d->level[w.bottom].count, sizeof *w.rank);
    svo_free(w.a, w.coset, d->subgroup_count, sizeof *w.coset);
    svo_free(w.a, w.block_turn, blocks->count, 1);
    svo_free(w.a, w.block_bits, blocks->count, sizeof *w.block_bits);
    svo_free(w.a, w.change, blocks->item_count, 1);
    for (uint32_t l = 0; l < w.bottom; l++) {
        svo_free(w.a, w.bits[l], d->level[l].count, sizeof *w.bits[l]);
        svo_free(w.a, w.place[l], d->level[l].count, sizeof *w.place[l]);
        svo_free(w.a, w.pool[l], v->fast.level[l].pool_count, sizeof *w.pool[l]);
    }
    svoi_symdag_free(d);
    svo_free(&p->memory.base, d, 1, sizeof *d);
    return r;
}
