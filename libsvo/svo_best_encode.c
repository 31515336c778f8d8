/* The writer of layout 3: frames from the top down, statistics, sizes from the bottom up, then the stream. */
#include <stdlib.h>
#include <string.h>

#include "svoi_best_encoder.h"
#include "svoi_compare.h"

enum {
    MOST_PAIRS = 1 << 22, /* of bricks that are looked at to find classes */
};

typedef svoi_best_encoder encoder;

static bool shared(const encoder *e, uint32_t level, uint32_t number) { return level == 0 || e->d->level[level].uses[number] > 1; }

/* --- symbols ----------------------------------------------------------------------------------------------------- */

static void put_bits(encoder *e, uint64_t v, uint32_t n)
{
    if (e->pass == PASS_SIZE) e->size += n;
    else if (e->pass == PASS_WRITE) svoi_bits_put(&e->out, v, n);
}

static void put_symbol(encoder *e, svoi_context_kind kind, uint32_t context, uint32_t symbol)
{
    uint32_t c = e->contexts.first[kind] + context;
    switch (e->pass) {
    case PASS_COUNT: e->weight[c][symbol]++; break;
    case PASS_SIZE: e->size += e->length[c][symbol]; break;
    case PASS_WRITE:
        svoi_bits_put(&e->out, e->code[c][symbol], e->length[c][symbol]);
        e->stats.bits[kind] += e->length[c][symbol];
        break;
    }
}

/* --- blocks ------------------------------------------------------------------------------------------------------ */

/* Children of a node by octant of the frame it is written in. */
typedef struct children {
    uint32_t mask, full, number[8];
    uint8_t turn[8]; /* from the stored child to that frame */
} children;

static children children_of(const svoi_symdag *d, uint32_t level, uint32_t number, uint32_t frame)
{
    children c = {0};
    const svoi_symlevel *l = &d->level[level];
    const uint32_t *item = l->items + l->start[number];
    const uint8_t *turn = l->turn + l->start[number];
    c.mask = svoi_turn_mask(frame, svoi_head_mask(item[0]));
    c.full = svoi_turn_mask(frame, svoi_head_full(item[0]));
    uint32_t k = 1;
    for (uint32_t m = svoi_head_refs(item[0]); m != 0; m &= m - 1, k++) {
        uint32_t o = svoi_turn_octant(frame, (uint32_t)__builtin_ctz(m));
        c.number[o] = item[k];
        c.turn[o] = (uint8_t)svoi_turn_after(frame, turn[k]);
    }
    return c;
}

/* Full leaves among the children: one bit, and if there are any a bit for each child. */
static void put_full(encoder *e, const children *c)
{
    if (!e->solid) return;
    put_bits(e, c->full != 0, 1);
    for (uint32_t m = c->full != 0 ? c->mask : 0; m != 0; m &= m - 1) put_bits(e, c->full >> __builtin_ctz(m) & 1, 1);
}

static void put_voxels(encoder *e, uint64_t bits)
{
    uint32_t mask = (uint32_t)(svo_brick_octants(bits) * 0x0102040810204080u >> 56);
    put_symbol(e, SVOI_CONTEXT_OCTANTS, 0, mask);
    for (uint32_t m = mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        svoi_corner c = e->corners.of[mask][o];
        put_symbol(e, SVOI_CONTEXT_OCTANT, c.corner, svoi_turn_mask(c.turn, bits >> 8 * o & 0xff));
    }
}

static void put_id(encoder *e, uint32_t brick)
{
    uint64_t at = e->class_first[e->class_of[brick]] + (uint64_t)e->id[brick];
    if (e->pass == PASS_SIZE) e->size += e->id_length[at];
    else if (e->pass == PASS_WRITE) svoi_bits_put(&e->out, e->id_code[at], e->id_length[at]), e->stats.bits[SVOI_CONTEXT_KINDS] += e->id_length[at];
}

/* Of the turns that mean the same for a brick the one whose symbol is cheapest. */
static uint32_t cheapest_turn(const encoder *e, uint32_t brick, uint32_t turn, uint32_t context, const svoi_corner *first, uint32_t previous)
{
    uint32_t best = turn, least = UINT32_MAX;
    for (uint64_t s = svoi_symdag_stabilizer(e->d, e->d->brick_level, brick); s != 0; s &= s - 1) {
        uint32_t t = svoi_turn_after(turn, (uint32_t)__builtin_ctzll(s));
        uint32_t symbol = first != NULL ? svoi_turn_after(first->turn, t) : t;
        uint32_t cost = e->costs ? e->turn_cost[context][symbol] : t == previous ? 0 : 1 + symbol;
        if (cost < least) least = cost, best = t;
    }
    return best;
}

static void put_block(encoder *e, const children *c)
{
    put_full(e, c);
    uint32_t refs = c->mask & ~c->full, previous_class = 0, previous_turn = SVOI_TURNS;
    for (uint32_t m = refs; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), brick = c->number[o], class = e->class_of[brick];
        svoi_corner corner = e->corners.of[c->mask][o];
        if (previous_class == 0) put_symbol(e, SVOI_CONTEXT_CLASS_FIRST, corner.corner, class);
        else put_symbol(e, SVOI_CONTEXT_CLASS, previous_class, class);
        previous_class = class;
        if (class == e->classes - 1) {
            put_voxels(e, svoi_turn_brick(c->turn[o], e->d->level[e->d->brick_level].bits[brick]));
            continue;
        }
        put_id(e, brick);
        if (previous_turn == SVOI_TURNS) {
            previous_turn = cheapest_turn(e, brick, c->turn[o], SVOI_TURNS + corner.corner, &corner, SVOI_TURNS);
            put_symbol(e, SVOI_CONTEXT_TURN_FIRST, corner.corner, svoi_turn_after(corner.turn, previous_turn));
        } else {
            uint32_t t = cheapest_turn(e, brick, c->turn[o], previous_turn, NULL, previous_turn);
            put_symbol(e, SVOI_CONTEXT_TURN, previous_turn, t);
            previous_turn = t;
        }
    }
}

/* --- nodes above the blocks -------------------------------------------------------------------------------------- */

static void put_mask(encoder *e, uint32_t child_level, const children *c, uint32_t octant)
{
    const svoi_symlevel *l = &e->d->level[child_level];
    uint32_t mask = svoi_turn_mask(c->turn[octant], svoi_head_mask(l->items[l->start[c->number[octant]]]));
    if (child_level == e->block_level) {
        svoi_corner corner = e->corners.of[c->mask][octant];
        put_symbol(e, SVOI_CONTEXT_MASK, corner.corner, svoi_turn_mask(corner.turn, mask));
    } else {
        put_bits(e, mask, 8);
    }
}

static uint64_t child_size(const encoder *e, uint32_t level, const children *c, uint32_t octant)
{
    return c->full >> octant & 1 ? 1 : svoi_symdag_size(e->d, level + 1, c->number[octant]);
}

/* Bits of the child's mask where it is written inside its parent. */
static uint64_t mask_bits(encoder *e, uint32_t child_level, const children *c, uint32_t octant)
{
    svoi_best_pass now = e->pass;
    uint64_t size = e->size;
    e->pass = PASS_SIZE;
    e->size = 0;
    put_mask(e, child_level, c, octant);
    uint64_t n = e->size;
    e->pass = now;
    e->size = size;
    return n;
}

/* All of a node above the blocks but its mask and what is written of its children inside it. */
static void put_head(encoder *e, uint32_t level, const children *c)
{
    uint32_t refs = c->mask & ~c->full, inside = 0, field = svoi_best_field(e->block_level - level), k = 0;
    uint64_t skip[8], sum = 0, size[8], most = 0, begin = e->pass == PASS_WRITE ? svoi_bits_written(&e->out) : 0;
    put_full(e, c);
    for (uint32_t m = refs; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        bool s = shared(e, level + 1, c->number[o]);
        put_bits(e, s, 1);
        if (s) continue;
        sum += mask_bits(e, level + 1, c, o) + e->bits[level + 1][c->number[o]];
        skip[inside++] = sum;
    }
    if (inside > 1) {
        uint32_t width = svoi_bit_width(skip[inside - 2]);
        put_bits(e, width, field);
        for (uint32_t i = 0; i + 1 < inside; i++) put_bits(e, skip[i], width);
        if (e->pass == PASS_WRITE) e->stats.skips += field + width * (inside - 1);
    }
    for (uint32_t m = c->mask; m != 0; m &= m - 1) size[k++] = child_size(e, level, c, (uint32_t)__builtin_ctz(m));
    if (e->numbered && k > 1) {
        for (uint32_t i = 0; i + 1 < k; i++) most = size[i] > most ? size[i] : most;
        uint32_t width = svoi_bit_width(most);
        put_bits(e, width, field);
        for (uint32_t i = 0; i + 1 < k; i++) put_bits(e, size[i], width);
        if (e->pass == PASS_WRITE) e->stats.counts += field + width * (k - 1);
    }
    const uint8_t *tier = e->tier[level + 1];
    for (uint32_t m = refs; m != 0; m &= m - 1) {
        uint32_t n = c->number[__builtin_ctz(m)];
        if (shared(e, level + 1, n)) put_bits(e, svoi_best_tier_of(tier, e->place[level + 1][n]), 2);
    }
    for (uint32_t m = refs; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), n = c->number[o];
        if (!shared(e, level + 1, n)) continue;
        uint64_t place = e->place[level + 1][n];
        put_bits(e, place, tier[svoi_best_tier_of(tier, place)]);
        put_bits(e, c->turn[o], 6);
        if (e->pass == PASS_WRITE) e->stats.references += 8u + tier[svoi_best_tier_of(tier, place)];
    }
    if (e->pass == PASS_WRITE) e->stats.heads += svoi_bits_written(&e->out) - begin;
}

/* Depth is that of the octree. */
static void put_node(encoder *e, uint32_t level, uint32_t number)
{
    children c = children_of(e->d, level, number, e->frame[level][number]);
    if (level == e->block_level) {
        put_block(e, &c);
        return;
    }
    put_head(e, level, &c);
    for (uint32_t m = c.mask & ~c.full; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        if (shared(e, level + 1, c.number[o])) continue;
        put_mask(e, level + 1, &c, o);
        put_node(e, level + 1, c.number[o]);
    }
}

/* --- preparation ------------------------------------------------------------------------------------------------- */

/* A node with one parent is written in the frame of that parent. */
static void make_frames(encoder *e)
{
    for (uint32_t level = 0; level < e->block_level; level++) {
        for (uint32_t n = 0; n < e->d->level[level].count; n++) {
            children c = children_of(e->d, level, n, e->frame[level][n]);
            for (uint32_t m = c.mask & ~c.full; m != 0; m &= m - 1) {
                uint32_t o = (uint32_t)__builtin_ctz(m);
                e->frame[level + 1][c.number[o]] = shared(e, level + 1, c.number[o]) ? 0 : c.turn[o];
            }
        }
    }
}

static bool make_classes(encoder *e)
{
    const svoi_symlevel *blocks = &e->d->level[e->block_level], *bricks = &e->d->level[e->d->brick_level];
    uint64_t total = blocks->item_count - blocks->count, step = total / MOST_PAIRS + 1, pairs = 0, capacity = 0;
    for (uint64_t n = 0; n < blocks->count; n += step) capacity += (uint64_t)__builtin_popcount(svoi_head_refs(blocks->items[blocks->start[n]]));
    svoi_brick_pair *pair = svo_alloc(e->a, capacity + 1, sizeof *pair);
    if (pair == NULL) return false;
    for (uint64_t n = 0; n < blocks->count; n += step) {
        children c = children_of(e->d, e->block_level, (uint32_t)n, e->frame[e->block_level][n]);
        uint32_t before = (uint32_t)bricks->count;
        for (uint32_t m = c.mask & ~c.full; m != 0; m &= m - 1) {
            uint32_t brick = c.number[__builtin_ctz(m)];
            pair[pairs++] = (svoi_brick_pair){before, brick};
            before = brick;
        }
    }
    bool ok = svoi_best_classes(e->a, bricks, pair, pairs, e->classes, e->class_of);
    svo_free(e->a, pair, capacity + 1, sizeof *pair);
    return ok;
}

/* What all blocks and their masks hold, as the symbols that they will be written with. */
static void count_symbols(encoder *e)
{
    memset(e->weight, 0, SVOI_CONTEXTS * sizeof *e->weight);
    e->pass = PASS_COUNT;
    for (uint32_t n = 0; n < e->d->level[e->block_level].count; n++) {
        children c = children_of(e->d, e->block_level, n, e->frame[e->block_level][n]);
        put_block(e, &c);
    }
    for (uint32_t n = 0; e->block_level != 0 && n < e->d->level[e->block_level - 1].count; n++) {
        children c = children_of(e->d, e->block_level - 1, n, e->frame[e->block_level - 1][n]);
        for (uint32_t m = c.mask & ~c.full; m != 0; m &= m - 1) {
            uint32_t o = (uint32_t)__builtin_ctz(m);
            if (!shared(e, e->block_level, c.number[o])) put_mask(e, e->block_level, &c, o);
        }
    }
}

/* Costs of turns from a first count, in which any of those that mean the same was taken: all turns get one. */
static bool make_turn_costs(encoder *e)
{
    uint32_t first = e->contexts.first[SVOI_CONTEXT_TURN], n = SVOI_TURNS + e->corners.count;
    for (uint32_t c = 0; c < n; c++) {
        uint64_t weight[SVOI_TURNS];
        for (uint32_t t = 0; t < SVOI_TURNS; t++) weight[t] = e->weight[first + c][t] * 64 + 1;
        if (!svoi_huffman_lengths(e->a, weight, SVOI_TURNS, SVOI_HUFFMAN_LONGEST, e->turn_cost[c])) return false;
    }
    e->costs = true;
    return true;
}

static uint32_t context_kind(const svoi_contexts *c, uint32_t context)
{
    uint32_t kind = 0;
    while (context >= c->first[kind + 1]) kind++;
    return kind;
}

static bool make_codes(encoder *e)
{
    for (uint32_t c = 0; c < e->contexts.first[SVOI_CONTEXT_KINDS]; c++) {
        uint32_t n = e->contexts.symbols[context_kind(&e->contexts, c)];
        if (!svoi_huffman_lengths(e->a, e->weight[c], n, SVOI_HUFFMAN_LONGEST, e->length[c])) return false;
        svoi_huffman_codes(e->length[c], n, e->code[c]);
    }
    return svoi_best_make_id_codes(e);
}

/* Bricks whose writing out costs no more than their entry and the references to it. */
static void choose_written_out(encoder *e)
{
    const svoi_symlevel *bricks = &e->d->level[e->d->brick_level];
    e->pass = PASS_SIZE;
    for (uint32_t i = 0; i < bricks->count; i++) {
        uint32_t uses = bricks->uses[i];
        if (uses > 8 || e->class_of[i] == e->classes - 1) continue;
        uint64_t at = e->class_first[e->class_of[i]] + (uint64_t)e->id[i];
        bool known = true;
        uint32_t mask = (uint32_t)(svo_brick_octants(bricks->bits[i]) * 0x0102040810204080u >> 56);
        uint32_t c = e->contexts.first[SVOI_CONTEXT_OCTANTS];
        known = e->length[c][mask] != SVOI_HUFFMAN_UNUSED;
        uint64_t cost = e->length[c][mask];
        for (uint32_t m = mask; m != 0 && known; m &= m - 1) {
            uint32_t o = (uint32_t)__builtin_ctz(m);
            svoi_corner corner = e->corners.of[mask][o];
            uint8_t l = e->length[e->contexts.first[SVOI_CONTEXT_OCTANT] + corner.corner][svoi_turn_mask(corner.turn, bricks->bits[i] >> 8 * o & 0xff)];
            known = l != SVOI_HUFFMAN_UNUSED;
            cost += l;
        }
        if (known && uses * cost <= 64 + uses * (uint64_t)(e->id_length[at] + 3)) e->class_of[i] = (uint8_t)(e->classes - 1);
    }
}

/* --- sizes ------------------------------------------------------------------------------------------------------- */

/* Sizes of a level's nodes; places of those that are shared: the most used first. */
static bool size_level(encoder *e, uint32_t level)
{
    const svoi_symlevel *l = &e->d->level[level];
    uint64_t n_shared = 0, uses[65] = {0};
    e->pass = PASS_SIZE;
    for (uint32_t n = 0; n < l->count; n++) {
        children c = children_of(e->d, level, n, e->frame[level][n]);
        e->size = 0;
        if (level == e->block_level) {
            put_block(e, &c);
        } else {
            put_head(e, level, &c);
            for (uint32_t m = c.mask & ~c.full; m != 0; m &= m - 1) {
                uint32_t o = (uint32_t)__builtin_ctz(m);
                if (shared(e, level + 1, c.number[o])) continue;
                put_mask(e, level + 1, &c, o);
                e->size += e->bits[level + 1][c.number[o]];
            }
        }
        e->bits[level][n] = e->size;
        n_shared += shared(e, level, n);
    }
    uint64_t *key = svo_alloc(e->a, n_shared + 1, sizeof *key), i = 0;
    e->order[level] = svo_alloc(e->a, n_shared + 1, sizeof *e->order[level]);
    e->shared[level] = n_shared;
    if (key == NULL || e->order[level] == NULL) {
        svo_free(e->a, key, n_shared + 1, sizeof *key);
        return false;
    }
    for (uint32_t n = 0; n < l->count; n++)
        if (shared(e, level, n)) key[i++] = (uint64_t)(UINT32_MAX - l->uses[n]) << 32 | n;
    qsort(key, (size_t)n_shared, sizeof *key, svoi_compare_u64);
    uint64_t at = 0;
    for (i = 0; i < n_shared; i++) {
        uint32_t n = (uint32_t)key[i];
        e->order[level][i] = n;
        e->place[level][n] = at;
        uses[svoi_bit_width(at)] += l->uses[n];
        at += (8 + e->bits[level][n] + 7) / 8;
    }
    e->pool_bytes[level] = at;
    svoi_best_choose_tiers(uses, e->tier[level]);
    svo_free(e->a, key, n_shared + 1, sizeof *key);
    return true;
}

/* --- writing ----------------------------------------------------------------------------------------------------- */

static void write_stream(encoder *e)
{
    e->pass = PASS_WRITE;
    for (uint32_t level = 0; level <= e->block_level; level++) {
        const svoi_symlevel *l = &e->d->level[level];
        for (uint64_t i = 0; i < e->shared[level]; i++) {
            uint32_t n = e->order[level][i];
            svoi_bits_put(&e->out, svoi_turn_mask(e->frame[level][n], svoi_head_mask(l->items[l->start[n]])), 8);
            put_node(e, level, n);
            svoi_bits_align(&e->out);
        }
    }
    for (int i = 0; i < SVOI_BITS_GUARD; i++) svoi_bits_put(&e->out, 0, 8);
}

static void write_codes(encoder *e, svoi_bit_writer *w)
{
    svoi_bits_put(w, e->classes, 8);
    svoi_bits_put(w, e->solid, 8);
    for (uint32_t c = 0; c < e->contexts.first[SVOI_CONTEXT_KINDS]; c++)
        svoi_best_write_lengths(w, e->length[c], e->contexts.symbols[context_kind(&e->contexts, c)]);
    for (uint32_t c = 1; c + 1 < e->classes; c++) {
        uint32_t count[SVOI_ID_LONGEST + 1] = {0}, longest = 0;
        for (uint32_t i = 0; i < e->class_count[c]; i++) {
            uint32_t l = e->id_length[e->class_first[c] + i];
            count[l]++;
            if (l > longest) longest = l;
        }
        svoi_bits_put(w, longest, 5);
        for (uint32_t l = 0; l <= longest; l++) {
            uint32_t width = svoi_bit_width(count[l]);
            svoi_bits_put(w, width, 5);
            svoi_bits_put(w, count[l], width);
        }
    }
    svoi_bits_align(w);
}

/* --- all of it --------------------------------------------------------------------------------------------------- */

static bool encoder_alloc(encoder *e)
{
    const svo_allocator *a = e->a;
    bool ok = true;
    for (uint32_t l = 0; l <= e->block_level; l++) {
        uint64_t n = e->d->level[l].count + 1; /* a level may be empty: all above are full leaves */
        e->frame[l] = svo_calloc(a, n, 1);
        e->bits[l] = svo_alloc(a, n, sizeof **e->bits);
        e->place[l] = svo_alloc(a, n, sizeof **e->place);
        ok = ok && e->frame[l] != NULL && e->bits[l] != NULL && e->place[l] != NULL;
    }
    uint64_t bricks = e->d->level[e->d->brick_level].count + 1;
    e->class_of = svo_calloc(a, bricks, 1);
    e->id = svo_alloc(a, bricks, sizeof *e->id);
    e->dictionary = svo_alloc(a, bricks, sizeof *e->dictionary);
    e->id_length = svo_alloc(a, bricks, 1);
    e->id_code = svo_alloc(a, bricks, sizeof *e->id_code);
    e->weight = svo_alloc(a, SVOI_CONTEXTS, sizeof *e->weight);
    e->length = svo_alloc(a, SVOI_CONTEXTS, sizeof *e->length);
    e->code = svo_alloc(a, SVOI_CONTEXTS, sizeof *e->code);
    e->turn_cost = svo_alloc(a, SVOI_TURNS + SVOI_CORNERS, sizeof *e->turn_cost);
    return ok && e->class_of != NULL && e->id != NULL && e->dictionary != NULL && e->id_length != NULL && e->id_code != NULL &&
           e->weight != NULL && e->length != NULL && e->code != NULL && e->turn_cost != NULL;
}

static void encoder_free(encoder *e)
{
    const svo_allocator *a = e->a;
    for (uint32_t l = 0; l <= e->block_level; l++) {
        uint64_t n = e->d->level[l].count + 1;
        svo_free(a, e->frame[l], n, 1);
        svo_free(a, e->bits[l], n, sizeof **e->bits);
        svo_free(a, e->place[l], n, sizeof **e->place);
        svo_free(a, e->order[l], e->shared[l] + 1, sizeof **e->order);
    }
    uint64_t bricks = e->d->level[e->d->brick_level].count + 1;
    svo_free(a, e->class_of, bricks, 1);
    svo_free(a, e->id, bricks, sizeof *e->id);
    svo_free(a, e->dictionary, bricks, sizeof *e->dictionary);
    svo_free(a, e->id_length, bricks, 1);
    svo_free(a, e->id_code, bricks, sizeof *e->id_code);
    svo_free(a, e->weight, SVOI_CONTEXTS, sizeof *e->weight);
    svo_free(a, e->length, SVOI_CONTEXTS, sizeof *e->length);
    svo_free(a, e->code, SVOI_CONTEXTS, sizeof *e->code);
    svo_free(a, e->turn_cost, SVOI_TURNS + SVOI_CORNERS, sizeof *e->turn_cost);
}

static bool encode(encoder *e)
{
    const svoi_symlevel *bricks = &e->d->level[e->d->brick_level];
    for (uint32_t l = 0; l <= e->block_level; l++) {
        const svoi_symlevel *level = &e->d->level[l];
        for (uint64_t n = 0; n < level->count && !e->solid; n++) e->solid = svoi_head_full(level->items[level->start[n]]) != 0;
    }
    make_frames(e);
    for (uint32_t i = 0; i < bricks->count; i++)
        if (bricks->uses[i] < 2) e->class_of[i] = (uint8_t)(e->classes - 1);
    if (!make_classes(e) || !svoi_best_make_dictionary(e)) return false;
    count_symbols(e);
    if (!make_turn_costs(e) || !make_codes(e)) return false;
    choose_written_out(e);
    if (!svoi_best_make_dictionary(e)) return false;
    count_symbols(e);
    if (!make_codes(e)) return false;
    for (uint32_t level = e->block_level + 1; level-- > 0;)
        if (!size_level(e, level)) return false;
    return true;
}

static bool write_parts(encoder *e, svoi_best_parts *out)
{
    uint64_t bytes = SVOI_BITS_GUARD;
    for (uint32_t l = 0; l <= e->block_level; l++) bytes += e->pool_bytes[l];
    svoi_best_level record[SVO_MAX_DEPTH] = {{0}};
    uint64_t first = 0;
    for (uint32_t l = 0; l <= e->block_level; l++) {
        record[l] = (svoi_best_level){.first = first, .entries = e->shared[l], .nodes = e->d->level[l].count};
        memcpy(record[l].tier, e->tier[l], SVOI_TIERS);
        first += e->pool_bytes[l];
    }
    if (svo_buffer_append(&out->levels, record, (e->block_level + 1) * sizeof *record) == NULL) return false;
    for (uint64_t i = 0; i < e->dictionary_count; i++)
        if (svo_buffer_append(&out->dictionary, &e->d->level[e->d->brick_level].bits[e->dictionary[i]], 8) == NULL) return false;
    svoi_bit_writer codes = {.to = &out->codes, .ok = true};
    write_codes(e, &codes);
    for (int i = 0; i < SVOI_BITS_GUARD; i++) svoi_bits_put(&codes, 0, 8);
    if (!codes.ok || !svo_buffer_reserve(&out->stream, bytes)) return false;
    e->out = (svoi_bit_writer){.to = &out->stream, .ok = true};
    write_stream(e);
    SVO_ASSERT(!e->out.ok || out->stream.size == bytes);
    return e->out.ok;
}

svo_result svoi_best_encode(const svoi_symdag *d, bool numbered, uint32_t classes, const svo_allocator *a, svoi_best_parts *out, svoi_best_stats *stats)
{
    SVO_ASSERT(d->brick_level >= 1 && classes >= 3 && classes <= SVOI_CLASSES);
    encoder *e = svo_calloc(a, 1, sizeof *e);
    if (e == NULL) return SVO_OUT_OF_MEMORY;
    *e = (encoder){.a = a, .d = d, .block_level = d->brick_level - 1, .classes = classes, .numbered = numbered};
    svoi_corners_make(&e->corners);
    e->contexts = svoi_contexts_make(e->classes, e->corners.count);
    svo_buffer_init(&out->stream, a);
    svo_buffer_init(&out->levels, a);
    svo_buffer_init(&out->codes, a);
    svo_buffer_init(&out->dictionary, a);
    bool ok = encoder_alloc(e) && encode(e) && write_parts(e, out);
    if (ok && stats != NULL) *stats = e->stats;
    encoder_free(e);
    svo_free(a, e, 1, sizeof *e);
    if (!ok) svoi_best_parts_free(out);
    return ok ? SVO_OK : SVO_OUT_OF_MEMORY;
}
