/* Layout 2 ("fast") from a symmetric DAG. Everything that a node's bits depend on is the same in every frame, so sizes are
 * found once for each stored node, bottom-up, and then every node is written where it belongs.
 *
 * Sharing has a price: a reference and its turn. A node is put into the pool of its level only where that is smaller
 * than writing it as often as it is used, and a brick that is used once is written out in its block. */
#include <string.h>

#include "svoi_layout_fast.h"

/* --- pools ------------------------------------------------------------------------------------------------------- */

static uint64_t node_bits(const svoi_fast_writer *w, uint32_t level, uint64_t number)
{
    return level == w->bottom - 1 ? w->block_bits[number] : w->bits[level][number];
}

/* Which nodes of a level are shared, and where they go. */
static svo_result make_pool(svoi_fast_writer *w, uint32_t level, svo_error *err)
{
    const svoi_symlevel *l = &w->d->level[level];
    svo_view_fast_level *f = &w->f->level[level];
    w->place[level] = svo_alloc(w->a, l->count, sizeof *w->place[level]);
    if (w->place[level] == NULL) return svoi_no_memory(w->p, "geometry", err);
    /* what a reference may cost, from what would be shared at most */
    uint64_t bytes = 0;
    for (uint64_t i = 0; i < l->count; i++)
        if (l->uses[i] > 1) bytes += (node_bits(w, level, i) + 7) / 8;
    uint64_t reference = SVOI_FAST_TURN_BITS + svoi_fast_bits_for(bytes), count = 0;
    for (uint64_t i = 0; i < l->count; i++) {
        uint64_t bits = node_bits(w, level, i), uses = l->uses[i];
        bool in = level == 0 || (uses > 1 && (uses - 1) * bits > uses * reference);
        w->place[level][i] = in ? 0 : SVOI_FAST_INSIDE;
        count += in;
    }
    f->pool_count = count;
    w->pool[level] = svo_alloc(w->a, count, sizeof *w->pool[level]);
    if ((w->pool[level] == NULL && count != 0) || !svoi_fast_sort(w->a, l->uses, l->count, w->place[level], w->pool[level]))
        return svoi_no_memory(w->p, "geometry", err);
    uint64_t at = 0;
    for (uint64_t i = 0; i < count; i++) {
        if (at >= SVOI_FAST_INSIDE) return svo_fail(err, SVO_LIMIT, "level %u has more than 2^32 bytes of shared nodes", level);
        w->place[level][w->pool[level][i]] = (uint32_t)at;
        at += (node_bits(w, level, w->pool[level][i]) + 7) / 8;
    }
    f->end = at * 8; /* counted from the begin of the pool; the caller adds where that lies */
    return SVO_OK;
}

/* Three widths of references to the pool of level + 1. */
static void choose_references(svoi_fast_writer *w, uint32_t level)
{
    const svoi_symlevel *l = &w->d->level[level + 1];
    uint64_t sum[33] = {0}, least = UINT64_MAX;
    uint32_t widest = 0, best[2] = {0, 0};
    for (uint64_t i = 0; i < w->f->level[level + 1].pool_count; i++) {
        uint32_t n = w->pool[level + 1][i], k = svoi_fast_length(w->place[level + 1][n]);
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
    bits[1] = (uint8_t)(best[0] + SVOI_FAST_TURN_BITS);
    bits[2] = (uint8_t)(best[1] + SVOI_FAST_TURN_BITS);
    bits[3] = (uint8_t)(widest + SVOI_FAST_TURN_BITS);
}

static uint32_t reference_tag(const svoi_fast_writer *w, uint32_t level, uint32_t place)
{
    const uint8_t *bits = w->f->level[level].code_bits;
    for (uint32_t t = 1; t < 3; t++)
        if (place >> (bits[t] - SVOI_FAST_TURN_BITS) == 0) return t;
    return 3;
}

static uint64_t child_size(const svoi_fast_writer *w, uint32_t level, uint32_t number) { return svoi_symdag_size(w->d, level + 1, number); }

/* Widths of the tables of a level, and bits of its nodes: of levels above the blocks. */
static svo_result size_nodes(svoi_fast_writer *w, uint32_t level, svo_error *err)
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
                if (place == SVOI_FAST_INSIDE) inside += node_bits(w, level + 1, n), inner++;
                else shared += f->code_bits[reference_tag(w, level, place)];
                if (pass == 0 && child_size(w, level, n) > widest_size) widest_size = child_size(w, level, n);
            }
            if (svoi_head_full(item[0]) != 0 && widest_size == 0) widest_size = 1; /* a full leaf counts one */
            if (inside > widest_skip) widest_skip = inside;
            w->bits[level][i] = (w->full ? 16 : 8) + 2 * count + (inner > 1 ? (uint64_t)(inner - 1) * f->skip_bits : 0) +
                                (uint64_t)__builtin_popcount(svoi_head_mask(item[0])) * f->size_bits + shared + inside;
        }
        if (pass != 0) break;
        f->skip_bits = above_blocks ? 0 : (uint8_t)(svoi_fast_length(widest_skip) + (widest_skip == 0));
        f->size_bits = above_blocks || !w->numbered ? 0 : (uint8_t)svoi_fast_length(widest_size);
    }
    return SVO_OK;
}

/* --- writing ----------------------------------------------------------------------------------------------------- */

static void put(svoi_fast_writer *w, uint64_t *p, uint64_t value, uint32_t n)
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

static void put_head(svoi_fast_writer *w, uint64_t *p, uint32_t head, uint32_t turn)
{
    put(w, p, svoi_turn_mask(turn, svoi_head_mask(head)), 8);
    if (w->full) put(w, p, svoi_turn_mask(turn, svoi_head_full(head)), 8);
}

static void write_block(svoi_fast_writer *w, uint64_t number, uint32_t turn, uint64_t *p)
{
    const svoi_symlevel *l = &w->d->level[w->bottom - 1];
    const uint32_t *item = l->items + l->start[number];
    const uint8_t *turns = l->turn + l->start[number], *change = w->change + l->start[number];
    uint8_t at[8];
    uint64_t bits;
    uint32_t mode = svoi_fast_mode(w, number, &bits), tags = 0, count = 0, tag[8] = {0};
    uint32_t common = w->block_turn[number]; /* brick's frame to block's */
    turned_children(item, turn, at);
    for (uint32_t o = 0; o < 8; o++) {
        if (at[o] == 0) continue;
        tag[o] = svoi_fast_tag(w, mode, w->rank[item[at[o]]], change[at[o]]);
        tags |= tag[o] << 2 * count++;
    }
    put_head(w, p, item[0], turn);
    put(w, p, mode, 1);
    put(w, p, svoi_turn_inverse(svoi_turn_after(turn, common)), SVOI_FAST_TURN_BITS);
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
static void write_node(svoi_fast_writer *w, uint32_t level, uint64_t number, uint32_t turn, uint64_t *p)
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
        if (where == SVOI_FAST_INSIDE) inner++;
        else tags |= reference_tag(w, level, where) << 2 * count;
        count++;
    }
    put_head(w, p, item[0], turn);
    put(w, p, tags, 2 * count);
    uint64_t skip = 0;
    uint32_t left = inner;
    for (uint32_t o = 0; o < 8 && f->skip_bits != 0 && left > 1; o++) {
        if (at[o] == 0 || place[item[at[o]]] != SVOI_FAST_INSIDE) continue;
        skip += node_bits(w, level + 1, item[at[o]]);
        put(w, p, skip, f->skip_bits);
        left--;
    }
    for (uint32_t o = 0; o < 8 && f->size_bits != 0; o++)
        if (mask >> o & 1) put(w, p, at[o] == 0 ? 1 : child_size(w, level, item[at[o]]), f->size_bits);
    for (uint32_t o = 0; o < 8; o++) {
        if (at[o] == 0 || place[item[at[o]]] == SVOI_FAST_INSIDE) continue;
        uint32_t n = item[at[o]], code_bits = f->code_bits[reference_tag(w, level, place[n])];
        uint32_t back = w->d->least[below->stabilizer[n]][svoi_turn_after(turn, turns[at[o]])];
        put(w, p, (uint64_t)place[n] << SVOI_FAST_TURN_BITS | svoi_turn_inverse(back), code_bits);
    }
    for (uint32_t o = 0; o < 8; o++)
        if (at[o] != 0 && place[item[at[o]]] == SVOI_FAST_INSIDE)
            write_node(w, level + 1, item[at[o]], svoi_turn_after(turn, turns[at[o]]), p);
}

static svo_result write_tree(svoi_fast_writer *w, svo_error *err)
{
    uint64_t bits = 0;
    for (uint32_t l = 0; l < w->bottom; l++) {
        svo_view_fast_level *f = &w->f->level[l];
        f->begin = bits;
        bits += f->end;
        f->end = bits;
    }
    uint64_t bytes = bits / 8 + SVOI_FAST_PADDING;
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

static svo_result write_all(svoi_fast_writer *w, uint32_t threads, svo_error *err)
{
    w->full = w->f->full = any_full(w->d, w->bottom);
    SVO_TRY(svoi_fast_dictionary(w, err));
    SVO_TRY(svoi_fast_blocks(w, threads, err));
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
    svoi_fast_writer w = {.p = p, .a = &p->memory.base, .d = d, .f = &v->fast, .bottom = v->brick_level, .numbered = !v->unnumbered};
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
