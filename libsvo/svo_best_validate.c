/* The proof that layout 3 can be traversed without checks: pools from the blocks up (form, places, sizes), then from the
 * root down (how often each node of the octree appears). Rules are those of docs/format/svdag.md. */
#include <string.h>

#include "svoi_best.h"

typedef struct checker {
    const svo_view *v;
    const svoi_best *b;
    const svo_allocator *a;
    svo_error *err;
    svo_rules *rules; /* NULL: the first violation is enough */
    svoi_best_pool pool[SVO_MAX_DEPTH];
    uint64_t stored[SVO_MAX_DEPTH]; /* nodes met */
    uint64_t nodes[SVO_MAX_DEPTH + 3]; /* of the octree */
    bool broken[SVO_MAX_DEPTH]; /* where entries of the pool begin cannot be told */
    bool lost;                  /* something cannot be counted */
} checker;

#define UNKNOWN UINT64_MAX /* a size that hangs on a violation */

static svo_result bad(checker *c, const char *rule, uint32_t level, uint64_t bit, const char *why)
{
    svo_fail(c->err, SVO_INVALID_DATA, "%s: level %u, bit %llu of the stream: %s", rule, level, (unsigned long long)bit, why);
    if (c->err != NULL) c->err->index = bit;
    return SVO_INVALID_DATA;
}

static svo_result go_on(checker *c, svo_result r) { return svo_go_on(c->rules, r, c->err); }
/* The same for what makes counting impossible. */
static svo_result lose(checker *c, svo_result r)
{
    c->lost = true;
    return go_on(c, r);
}

static svo_result no_memory(checker *c) { return svo_fail(c->err, SVO_OUT_OF_MEMORY, "out of memory (validation)"); }

/* `n` bits that must lie in the stream. */
static bool take(const checker *c, uint64_t *at, uint64_t n, uint64_t *value)
{
    if (*at > c->b->stream_bits || n > c->b->stream_bits - *at) return false;
    if (value != NULL) *value = n > 56 ? UINT64_MAX : svoi_bits_get(c->b->stream, *at, (uint32_t)n);
    *at += n;
    return true;
}

/* Do all fields of the head lie in the stream, with widths that can be read? svoi_best_read_head is safe then. */
static bool head_fits(const checker *c, uint32_t level, svoi_best_node n)
{
    const svoi_best *b = c->b;
    uint64_t at = n.at, bits = 0, shared, width;
    uint32_t k = (uint32_t)__builtin_popcount(n.mask), field = svoi_best_field(b->block_level - level), slots = k;
    if (b->solid) {
        if (!take(c, &at, 1, &bits)) return false;
        if (bits != 0) {
            if (!take(c, &at, k, &bits)) return false;
            slots -= (uint32_t)__builtin_popcountll(bits);
        }
    }
    if (!take(c, &at, slots, &shared)) return false;
    uint32_t shared_count = (uint32_t)__builtin_popcountll(shared), inside = slots - shared_count;
    if (inside > 1 && (!take(c, &at, field, &width) || width > 56 || !take(c, &at, width * (inside - 1), NULL))) return false;
    if (b->numbered && k > 1 && (!take(c, &at, field, &width) || width > 56 || !take(c, &at, width * (k - 1), NULL))) return false;
    uint64_t tags = at;
    if (!take(c, &at, 2 * shared_count, NULL)) return false;
    for (uint32_t i = 0; i < shared_count; i++) {
        uint64_t tag = svoi_bits_get(b->stream, tags + 2 * i, 2);
        if (!take(c, &at, 6u + b->level[level + 1].tier[tag], NULL)) return false;
    }
    return true;
}

static uint64_t block_size(const svoi_best *b, uint32_t mask, const svoi_best_block *block)
{
    uint64_t size = b->lod ? 1 : 0;
    for (uint32_t m = mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        size += block->full >> o & 1 ? 1 : svoi_brick_size(b->brick_lod, block->bits[o]);
    }
    return size;
}

/* The depth is that of the octree, which has been checked: at most 21. */
static svo_result check_node(checker *c, uint32_t level, svoi_best_node n, uint64_t *end, uint64_t *size)
{
    const svoi_best *b = c->b;
    c->stored[level]++;
    if (level == b->block_level) {
        svoi_best_block block;
        if (!svoi_best_check_block(b, n, &block, end)) return bad(c, "DAG-14", level, n.at, "a block holds a symbol without a code, or reaches beyond the stream");
        *size = block_size(b, n.mask, &block);
        return SVO_OK;
    }
    if (!head_fits(c, level, n)) return bad(c, "DAG-12", level, n.at, "a node reaches beyond the stream");
    svoi_best_head h = svoi_best_read_head(b, level, n);
    uint64_t child_size[8] = {0};
    uint32_t inside = 0; /* children written inside so far */
    *end = h.inside;
    for (uint32_t m = n.mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), turn;
        if (h.full >> o & 1) {
            child_size[o] = 1;
            continue;
        }
        uint32_t slot = (uint32_t)__builtin_popcount(h.refs & ((1u << o) - 1));
        if (h.shared >> (h.slots - 1 - slot) & 1) {
            /* the reference's place is checked before the node there is touched */
            uint64_t tags = svoi_bits_peek(b->stream, h.tags), at = h.values, value = 0;
            for (uint32_t i = (uint32_t)__builtin_popcount(h.shared >> (h.slots - slot)); i > 0; i--, tags <<= 2) at += 6u + b->level[level + 1].tier[tags >> 62];
            take(c, &at, b->level[level + 1].tier[tags >> 62], &value);
            child_size[o] = UNKNOWN;
            if (c->broken[level + 1]) continue;
            uint64_t entry = svoi_best_entry_at(&c->pool[level + 1], value);
            if (entry == UINT64_MAX) {
                SVO_TRY(lose(c, bad(c, "DAG-15", level, n.at, "a reference does not point to an entry of the next level's pool")));
                continue;
            }
            svoi_best_child(b, level, n, &h, o, &turn);
            if (turn >= SVOI_TURNS) SVO_TRY(go_on(c, bad(c, "DAG-15", level, n.at, "the turn of a reference is none")));
            child_size[o] = c->pool[level + 1].size[entry];
            continue;
        }
        svoi_best_node child = {*end, 0};
        uint64_t bits, skip = 0;
        if (inside++ != 0) skip = svoi_bits_get(b->stream, h.skips + (uint64_t)h.skip_width * (inside - 2), h.skip_width);
        if (h.inside + skip != *end) SVO_TRY(lose(c, bad(c, "DAG-16", level, n.at, "a skip does not lead to the child")));
        if (level + 1 == b->block_level) {
            if (!svoi_best_check_mask(b, n.mask, o, &child.at, &child.mask)) return bad(c, "DAG-14", level, n.at, "a mask without a code");
        } else {
            if (!take(c, &child.at, 8, &bits)) return bad(c, "DAG-12", level, n.at, "a node reaches beyond the stream");
            child.mask = (uint32_t)bits;
            if (child.mask == 0) return bad(c, "DAG-04", level + 1, child.at, "a mask is empty");
        }
        SVO_TRY(check_node(c, level + 1, child, end, &child_size[o]));
    }
    *size = b->lod ? 1 : 0;
    uint32_t k = 0;
    for (uint32_t m = n.mask; m != 0; m &= m - 1, k++) {
        uint64_t s = child_size[__builtin_ctz(m)];
        *size = *size == UNKNOWN || s == UNKNOWN ? UNKNOWN : *size + s;
        if (!b->numbered || (m & (m - 1)) == 0 || s == UNKNOWN) continue;
        if (svoi_bits_get(b->stream, h.sizes + (uint64_t)h.size_width * k, h.size_width) != s)
            SVO_TRY(go_on(c, bad(c, "DAG-06", level, n.at, "a size is not that of the child")));
    }
    return SVO_OK;
}

static svo_result check_pool(checker *c, uint32_t level)
{
    const svoi_best *b = c->b;
    svoi_best_pool *p = &c->pool[level];
    uint64_t first = b->level[level].first, next = level == b->block_level ? b->stream_bits / 8 : b->level[level + 1].first;
    if (next < first || next > b->stream_bits / 8) return bad(c, "DAG-12", level, 8 * first, "pools are out of order");
    p->bytes = next - first;
    p->entries = b->level[level].entries;
    if (p->entries > p->bytes || (level == 0 && p->entries != 1)) return bad(c, "DAG-12", level, 8 * first, "number of entries of a pool is impossible");
    if (level != 0)
        for (int i = 0; i < SVOI_TIERS; i++)
            if (b->level[level].tier[i] > 56) return bad(c, "DAG-12", level, 8 * first, "a tier is too wide");
    if (!svoi_best_pool_alloc(p, c->a)) return no_memory(c);
    p->size = svo_alloc(c->a, p->entries + 1, sizeof *p->size);
    p->times = svo_calloc(c->a, p->entries + 1, sizeof *p->times);
    if (p->size == NULL || p->times == NULL) return no_memory(c);
    uint64_t at = 8 * first, pad;
    for (uint64_t i = 0; i < p->entries; i++) {
        if (at >= 8 * next) return bad(c, "DAG-12", level, at, "a pool is too short");
        svoi_best_node n = {at + 8, b->stream[at / 8]};
        if (n.mask == 0) return bad(c, "DAG-04", level, at, "a mask is empty");
        svoi_best_pool_begin(p, at / 8 - first);
        SVO_TRY(check_node(c, level, n, &at, &p->size[i]));
        if (!take(c, &at, -at & 7, &pad)) return bad(c, "DAG-12", level, at, "an entry is not padded with zeros");
        if (pad != 0) SVO_TRY(go_on(c, bad(c, "DAG-12", level, at, "an entry is not padded with zeros")));
    }
    if (at != 8 * next) return bad(c, "DAG-12", level, at, "a pool is too long");
    svoi_best_pool_end(p);
    return SVO_OK;
}

/* Full leaves of a level count as if they were expanded. */
static void count_full(checker *c, uint32_t level, uint32_t full, uint64_t times)
{
    uint64_t leaves = times * (uint64_t)__builtin_popcount(full);
    for (uint32_t l = level; full != 0 && l <= c->v->depth; l++) c->nodes[l] += leaves << 3 * (l - level);
}

/* The node, and all that is written inside it, appears `times` times in the octree. */
static void count_node(checker *c, uint32_t level, svoi_best_node n, uint64_t times)
{
    const svoi_best *b = c->b;
    c->nodes[level] += times;
    if (level == b->block_level) {
        svoi_best_block block;
        svoi_best_read_block(b, n, &block);
        count_full(c, level + 1, block.full, times);
        for (uint32_t m = n.mask & ~block.full; m != 0; m &= m - 1) {
            uint64_t bits = block.bits[__builtin_ctz(m)];
            c->nodes[level + 1] += times;
            c->nodes[level + 2] += times * (uint64_t)__builtin_popcountll(svo_brick_octants(bits));
            c->nodes[level + 3] += times * (uint64_t)__builtin_popcountll(bits);
        }
        return;
    }
    svoi_best_head h = svoi_best_read_head(b, level, n);
    count_full(c, level + 1, h.full, times);
    for (uint32_t m = h.refs; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), turn, slot = (uint32_t)__builtin_popcount(h.refs & ((1u << o) - 1));
        svoi_best_node child = svoi_best_child(b, level, n, &h, o, &turn);
        if (h.shared >> (h.slots - 1 - slot) & 1) c->pool[level + 1].times[svoi_best_entry_of(b, c->pool, level + 1, child)] += times;
        else count_node(c, level + 1, child, times);
    }
}

static svo_result count_nodes(checker *c)
{
    const svoi_best *b = c->b;
    bool whole = true;
    c->pool[0].times[0] = 1;
    for (uint32_t level = 0; level <= b->block_level; level++) {
        const svoi_best_pool *p = &c->pool[level];
        uint64_t entry = 0;
        for (uint64_t w = 0; w < p->words; w++)
            for (uint64_t m = p->bit[w]; m != 0; m &= m - 1, entry++) {
                uint64_t byte = b->level[level].first + 64 * w + (uint64_t)__builtin_ctzll(m);
                svoi_best_node n = {8 * byte + 8, b->stream[byte]};
                if (p->times[entry] == 0) SVO_TRY(go_on(c, bad(c, "DAG-05", level, 8 * byte, "an entry that nothing refers to")));
                whole = whole && p->times[entry] != 0;
                count_node(c, level, n, p->times[entry]);
            }
        if (!whole) return SVO_OK; /* nodes below may be counted too seldom for that */
        if (c->stored[level] != b->level[level].nodes) SVO_TRY(go_on(c, bad(c, "DAG-07", level, 0, "number of stored nodes is wrong")));
    }
    for (uint32_t level = 0; level <= SVO_MAX_DEPTH; level++)
        if (c->v->nodes[level] != c->nodes[level]) SVO_TRY(go_on(c, bad(c, "DAG-07", level, 0, "number of octree nodes is wrong")));
    return SVO_OK;
}

static svo_result check(checker *c)
{
    const svoi_best *b = c->b;
    if (b->level[0].first != 0) return bad(c, "DAG-12", 0, 0, "the first pool is not at the begin");
    for (uint32_t l = 0; l <= b->block_level; l++)
        if (b->level[l].zero != 0) SVO_TRY(go_on(c, bad(c, "DAG-12", l, 0, "a reserved field is not 0")));
    for (uint64_t i = 0; i < SVOI_BITS_GUARD; i++)
        if (b->stream[b->stream_bits / 8 + i] != 0) SVO_TRY(go_on(c, bad(c, "DAG-12", 0, b->stream_bits, "the guard behind the stream is not 0")));
    for (uint64_t i = 0; i < c->v->brick_count; i++)
        if (b->dictionary[i] == 0) SVO_TRY(go_on(c, bad(c, "DAG-04", c->v->brick_level, i, "a brick is empty")));
    for (uint32_t level = b->block_level + 1; level-- > 0;) {
        svo_result r = check_pool(c, level);
        c->broken[level] = r == SVO_INVALID_DATA; /* nothing behind can be told in this pool; the others can */
        SVO_TRY(c->broken[level] ? lose(c, r) : r);
    }
    if (c->lost) return SVO_OK;
    if (c->pool[0].size[0] != c->v->attribute_count) SVO_TRY(go_on(c, bad(c, "DAG-06", 0, c->pool[0].size[0], "number of attributes is not the size of the tree")));
    return count_nodes(c);
}

svo_result svoi_best_validate(const svo_view *v, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    checker *c = svo_calloc(a, 1, sizeof *c);
    if (c == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (validation)");
    *c = (checker){.v = v, .b = v->best, .a = a, .err = err, .rules = rules};
    svo_result r = check(c);
    for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) {
        svoi_best_pool *p = &c->pool[l];
        svoi_best_pool_free(p, a);
        svo_free(a, p->size, p->entries + 1, sizeof *p->size);
        svo_free(a, p->times, p->entries + 1, sizeof *p->times);
    }
    svo_free(a, c, 1, sizeof *c);
    return r;
}
