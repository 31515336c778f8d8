/* Layout 2 ("fast"): the proof that it can be traversed without checks, and the box of its voxels. Both walk every stored
 * node once. Rules are those of docs/format/svdag.md. */
#include <string.h>

#include "svoi_fast.h"
#include "svoi_view.h"

/* Where nodes of a pool begin, one bit for each byte, and what is known of them by rank. */
typedef struct pool {
    uint64_t *bit;
    uint32_t *before;
    uint64_t words, count;
    uint64_t *size;  /* attributes */
    uint64_t *times; /* in the octree */
    bool broken;     /* where its nodes begin cannot be told */
} pool;

#define UNKNOWN UINT64_MAX /* a size that hangs on a violation */

typedef struct check {
    const svo_view *v;
    const svo_allocator *a;
    svo_error *err;
    svo_rules *rules; /* NULL: the first violation is enough */
    pool pool[SVO_MAX_DEPTH];
    uint64_t stored[SVO_MAX_DEPTH]; /* nodes */
    uint64_t nodes[SVO_MAX_DEPTH + 3];
    uint64_t *seen; /* bricks of the dictionary */
    uint64_t seen_words;
    uint64_t end; /* of the pool at hand */
    bool lost;    /* something cannot be counted */
} check;

static svo_result bad(check *c, const char *rule, uint32_t level, uint64_t p, const char *why)
{
    svo_fail(c->err, SVO_INVALID_DATA, "%s: level %u, bit %llu: %s", rule, level, (unsigned long long)p, why);
    if (c->err != NULL) c->err->index = p;
    return SVO_INVALID_DATA;
}

static svo_result go_on(check *c, svo_result r) { return svo_go_on(c->rules, r, c->err); }
/* The same for what makes counting impossible. */
static svo_result lose(check *c, svo_result r)
{
    c->lost = true;
    return go_on(c, r);
}
static uint64_t add_size(uint64_t a, uint64_t b) { return a == UNKNOWN || b == UNKNOWN ? UNKNOWN : a + b; }

/* --- the head of the layout --------------------------------------------------------------------------------------- */

static svo_result check_head(check *c)
{
    const svo_view *v = c->v;
    const svo_view_fast *f = &v->fast;
    uint64_t turns = 0, at = 0;
    for (uint32_t k = 0; k < SVOI_TURNS; k++) {
        if (f->turn[k] >= SVOI_TURNS) return bad(c, "DAG-17", 0, k, "no turn");
        turns |= (uint64_t)1 << f->turn[k];
    }
    if (turns != ((uint64_t)1 << SVOI_TURNS) - 1 || f->turn[0] != 0 || v->root >= SVOI_TURNS)
        return bad(c, "DAG-17", 0, 0, "the table of turns does not hold each once, none first");
    for (uint32_t m = 0; m < 2; m++)
        for (uint32_t t = 0; t < 4; t++) {
            uint32_t ids = f->id_bits[m][t], bits = f->code_bits[m][t];
            if (ids == SVO_FAST_LITERAL ? bits != 64 : ids > 32 || bits < ids || bits > ids + 6)
                return bad(c, "DAG-17", v->brick_level, 4 * m + t, "widths of a brick's code out of range");
        }
    if (f->tree_bytes < 8 || f->tree_bytes > (uint64_t)1 << 48) return bad(c, "DAG-17", 0, f->tree_bytes, "size of TREE out of range");
    for (uint32_t l = 0; l < v->brick_level; l++) {
        const svo_view_fast_level *x = &f->level[l];
        bool last = l + 1 == v->brick_level, above = l + 2 == v->brick_level;
        if (x->begin != at || x->end < at || x->end % 8 != 0 || x->end > 8 * (f->tree_bytes - 8))
            return bad(c, "DAG-17", l, x->begin, "pools do not fill the tree");
        at = x->end;
        for (uint32_t t = 1; t < 4; t++)
            if (last ? x->code_bits[t] != 0 : x->code_bits[t] < 6 || x->code_bits[t] > 38)
                return bad(c, "DAG-17", l, t, "width of a reference out of range");
        bool sizes = !last && !above && !v->unnumbered;
        if (x->code_bits[0] != 0 || x->skip_bits > 48 || (x->skip_bits != 0) != (!last && !above) || x->size_bits > 64 || (x->size_bits != 0) != sizes)
            return bad(c, "DAG-17", l, 0, "widths of a level's tables out of range");
        if (x->pool_count > (x->end - x->begin) / 8) return bad(c, "DAG-17", l, x->pool_count, "more nodes than bytes in a pool");
    }
    uint64_t padding;
    memcpy(&padding, f->tree + f->tree_bytes - 8, 8);
    if (at != 8 * (f->tree_bytes - 8) || padding != 0) return bad(c, "DAG-17", 0, at, "pools do not fill the tree");
    if (f->level[0].pool_count != 1) return bad(c, "DAG-17", 0, 0, "there is not one root");
    return SVO_OK;
}

/* --- pools -------------------------------------------------------------------------------------------------------- */

static svo_result make_pool(check *c, uint32_t level)
{
    const svo_view_fast_level *l = &c->v->fast.level[level];
    pool *p = &c->pool[level];
    p->words = (l->end - l->begin) / 8 / 64 + 1;
    p->count = l->pool_count;
    p->bit = svo_calloc(c->a, p->words, sizeof *p->bit);
    p->before = svo_alloc(c->a, p->words, sizeof *p->before);
    p->size = svo_calloc(c->a, p->count, sizeof *p->size);
    p->times = svo_calloc(c->a, p->count, sizeof *p->times);
    if (p->bit == NULL || p->before == NULL || ((p->size == NULL || p->times == NULL) && p->count != 0))
        return svo_fail(c->err, SVO_OUT_OF_MEMORY, "out of memory (validation)");
    return SVO_OK;
}

static void rank_pool(pool *p)
{
    uint32_t before = 0;
    for (uint64_t i = 0; i < p->words; i++) {
        p->before[i] = before;
        before += (uint32_t)__builtin_popcountll(p->bit[i]);
    }
}

/* Number of the pool's node at a byte, or count when none begins there. */
static uint64_t pool_number(const pool *p, uint64_t byte)
{
    if (byte / 64 >= p->words || !(p->bit[byte / 64] >> byte % 64 & 1)) return p->count;
    return p->before[byte / 64] + (uint64_t)__builtin_popcountll(p->bit[byte / 64] & (((uint64_t)1 << byte % 64) - 1));
}

/* --- the walk ----------------------------------------------------------------------------------------------------- */

/* First pass: bounds of everything, sizes bottom-up. Leaves *p behind the node. */
static svo_result check_block(check *c, uint64_t *p, uint64_t *size)
{
    const svo_view *v = c->v;
    uint32_t level = v->brick_level - 1;
    uint64_t begin = *p;
    svoi_fast_block b = svoi_fast_open_block(v, *p);
    if (b.mask == 0) return bad(c, "DAG-04", level, begin, "mask is empty");
    if (v->fast.full && (svoi_fast_peek(v, begin) >> 8 & 0xff & ~(uint64_t)b.mask) != 0) return bad(c, "DAG-04", level, begin, "a full leaf that is no child");
    uint32_t r = (uint32_t)__builtin_popcount(b.refs);
    if (b.codes > c->end || svoi_fast_codes(v, &b, r) > c->end - b.codes) return bad(c, "DAG-18", level, begin, "a node reaches beyond its pool");
    if (b.turn >= SVOI_TURNS) SVO_TRY(lose(c, bad(c, "DAG-20", level, begin, "no turn")));
    *size = (v->lod ? 1 : 0) + (uint64_t)__builtin_popcount(b.mask & ~b.refs);
    for (uint32_t k = 0; k < r; k++) {
        uint32_t tag = b.tags >> 2 * k & 3, ids = v->fast.id_bits[b.mode][tag], bits = v->fast.code_bits[b.mode][tag];
        uint64_t code = svoi_fast_bits64(v, b.codes + svoi_fast_codes(v, &b, k), bits);
        if (ids == SVO_FAST_LITERAL) {
            if (code == 0) SVO_TRY(go_on(c, bad(c, "DAG-04", level, begin, "a brick is empty")));
            *size = add_size(*size, svoi_brick_size(svo_view_brick_lod(v), code));
            continue;
        }
        uint64_t id = code & (((uint64_t)1 << ids) - 1);
        if (id >= v->brick_count || code >> ids >= SVOI_TURNS) {
            SVO_TRY(lose(c, bad(c, "DAG-20", level, begin, "a code names no brick")));
            *size = UNKNOWN;
            continue;
        }
        c->seen[id / 64] |= (uint64_t)1 << id % 64;
        *size = add_size(*size, svoi_brick_size(svo_view_brick_lod(v), v->bricks[id]));
    }
    *p = svoi_fast_block_end(v, &b);
    c->stored[level]++;
    return SVO_OK;
}

/* At most SVO_MAX_DEPTH deep. */
static svo_result check_node(check *c, uint32_t level, uint64_t *p, uint64_t *size)
{
    const svo_view *v = c->v;
    if (*p >= c->end) return bad(c, "DAG-18", level, *p, "a node reaches beyond its pool");
    if (level + 1 == v->brick_level) return check_block(c, p, size);
    const svo_view_fast_level *l = &v->fast.level[level];
    uint64_t begin = *p;
    svoi_fast_node n = svoi_fast_open(v, level, begin);
    if (n.mask == 0) return bad(c, "DAG-04", level, begin, "mask is empty");
    if (v->fast.full && (svoi_fast_peek(v, begin) >> 8 & 0xff & ~(uint64_t)n.mask) != 0) return bad(c, "DAG-04", level, begin, "a full leaf that is no child");
    if (n.inner > c->end) return bad(c, "DAG-18", level, begin, "a node reaches beyond its pool");
    uint64_t inner = n.inner, code_at = n.codes, size_at = n.sizes, inner_left = n.inner_count;
    uint64_t skip_at = n.skips;
    uint32_t tags = n.tags;
    *size = v->lod ? 1 : 0;
    for (uint32_t o = 0; o < 8; o++) {
        uint64_t below = 1;
        if (!(n.mask >> o & 1)) continue;
        if (n.refs >> o & 1) {
            uint32_t tag = tags & 3;
            tags >>= 2;
            if (tag == 0) {
                SVO_TRY(check_node(c, level + 1, &inner, &below));
                if (--inner_left != 0 && l->skip_bits != 0) {
                    if (svoi_fast_bits(v, skip_at, l->skip_bits) != inner - n.inner) SVO_TRY(go_on(c, bad(c, "DAG-19", level, begin, "a skip is not the length of the nodes before")));
                    skip_at += l->skip_bits;
                }
            } else {
                uint64_t code = svoi_fast_bits(v, code_at, l->code_bits[tag]), k = pool_number(&c->pool[level + 1], code >> 6);
                code_at += l->code_bits[tag];
                if ((code & 63) >= SVOI_TURNS) SVO_TRY(go_on(c, bad(c, "DAG-20", level, begin, "no turn")));
                below = UNKNOWN;
                if (k != c->pool[level + 1].count) below = c->pool[level + 1].size[k];
                else if (!c->pool[level + 1].broken) SVO_TRY(lose(c, bad(c, "DAG-05", level, begin, "a reference does not point to a node")));
            }
        }
        if (l->size_bits != 0) {
            if (below != UNKNOWN && svoi_fast_bits64(v, size_at, l->size_bits) != below) SVO_TRY(go_on(c, bad(c, "DAG-06", level, begin, "a size is not that of the child")));
            size_at += l->size_bits;
        }
        *size = add_size(*size, below);
    }
    *p = inner;
    c->stored[level]++;
    return SVO_OK;
}

static svo_result check_pool(check *c, uint32_t level)
{
    const svo_view_fast_level *l = &c->v->fast.level[level];
    pool *own = &c->pool[level];
    c->end = l->end;
    uint64_t k = 0;
    for (uint64_t p = l->begin; p < l->end; k++) {
        if (k == l->pool_count) return bad(c, "DAG-07", level, p, "more nodes in a pool than it says");
        uint64_t byte = (p - l->begin) / 8;
        own->bit[byte / 64] |= (uint64_t)1 << byte % 64;
        SVO_TRY(check_node(c, level, &p, &own->size[k]));
        uint64_t gap = (8 - p % 8) % 8;
        if (p > l->end || gap > l->end - p) return bad(c, "DAG-18", level, p, "a node reaches beyond its pool");
        if (svoi_fast_bits(c->v, p, (uint32_t)gap) != 0) SVO_TRY(go_on(c, bad(c, "DAG-18", level, p, "bits between nodes are not 0")));
        p += gap;
    }
    if (k != l->pool_count) return bad(c, "DAG-07", level, k, "fewer nodes in a pool than it says");
    rank_pool(own);
    return SVO_OK;
}

/* Second pass: how often each node appears, from the root down. Everything has been checked. */
static void count_block(check *c, uint64_t *p, uint64_t times)
{
    const svo_view *v = c->v;
    svoi_fast_block b = svoi_fast_open_block(v, *p);
    uint32_t r = (uint32_t)__builtin_popcount(b.refs);
    uint64_t full = (uint64_t)__builtin_popcount(b.mask & ~b.refs) * times, *nodes = c->nodes + v->brick_level;
    nodes[0] += full, nodes[1] += 8 * full, nodes[2] += 64 * full;
    for (uint32_t k = 0; k < r; k++) {
        uint32_t turn;
        uint64_t brick = svoi_fast_brick(v, &b, k, &turn);
        nodes[0] += times;
        nodes[1] += times * (uint64_t)__builtin_popcountll(svo_brick_octants(brick));
        nodes[2] += times * (uint64_t)__builtin_popcountll(brick);
    }
    nodes[-1] += times;
    *p = svoi_fast_block_end(v, &b);
}

static void count_node(check *c, uint32_t level, uint64_t *p, uint64_t times)
{
    const svo_view *v = c->v;
    if (level + 1 == v->brick_level) {
        count_block(c, p, times);
        return;
    }
    const svo_view_fast_level *l = &v->fast.level[level];
    svoi_fast_node n = svoi_fast_open(v, level, *p);
    uint64_t inner = n.inner, code_at = n.codes, full = (uint64_t)__builtin_popcount(n.mask & ~n.refs) * times;
    c->nodes[level] += times;
    for (uint32_t below = level + 1; below <= v->tree_depth && full != 0; below++, full *= 8) c->nodes[below] += full;
    for (uint32_t k = 0; k < (uint32_t)__builtin_popcount(n.refs); k++) {
        uint32_t tag = n.tags >> 2 * k & 3;
        if (tag == 0) {
            count_node(c, level + 1, &inner, times);
            continue;
        }
        c->pool[level + 1].times[pool_number(&c->pool[level + 1], svoi_fast_bits(v, code_at, l->code_bits[tag]) >> 6)] += times;
        code_at += l->code_bits[tag];
    }
    *p = inner;
}

/* *whole: every node is referred to, so that the counts are those of the octree. */
static svo_result count_pools(check *c, bool *whole)
{
    const svo_view *v = c->v;
    c->pool[0].times[0] = 1;
    for (uint32_t level = 0; level < v->brick_level; level++) {
        uint64_t p = v->fast.level[level].begin;
        for (uint64_t k = 0; k < c->pool[level].count; k++, p = (p + 7) & ~(uint64_t)7) {
            if (c->pool[level].times[k] == 0) SVO_TRY(go_on(c, bad(c, "DAG-05", level, p, "a node that nothing refers to")));
            *whole = *whole && c->pool[level].times[k] != 0;
            count_node(c, level, &p, c->pool[level].times[k]);
        }
        if (!*whole) return SVO_OK; /* nodes below may be counted too seldom for that */
        if (c->stored[level] != v->fast.level[level].node_count) SVO_TRY(go_on(c, bad(c, "DAG-07", level, c->stored[level], "number of nodes is wrong")));
    }
    for (uint64_t i = 0; i < v->brick_count; i++)
        if (!(c->seen[i / 64] >> i % 64 & 1)) SVO_TRY(go_on(c, bad(c, "DAG-05", v->brick_level, i, "a brick that nothing refers to")));
    return SVO_OK;
}

static svo_result validate(check *c)
{
    const svo_view *v = c->v;
    if (v->brick_level == 0) return bad(c, "DAG-17", 0, 0, "an octree of depth 2 or less has layout 1");
    if (v->brick_count > UINT32_MAX) return bad(c, "DAG-04", v->brick_level, v->brick_count, "number of bricks out of range");
    for (uint64_t i = 0; i < v->brick_count; i++)
        if (v->bricks[i] == 0) SVO_TRY(go_on(c, bad(c, "DAG-04", v->brick_level, i, "a brick is empty")));
    SVO_TRY(check_head(c));
    c->seen_words = v->brick_count / 64 + 1;
    c->seen = svo_calloc(c->a, c->seen_words, sizeof *c->seen);
    if (c->seen == NULL) return svo_fail(c->err, SVO_OUT_OF_MEMORY, "out of memory (validation)");
    for (uint32_t level = v->brick_level; level-- > 0;) {
        pool *own = &c->pool[level];
        SVO_TRY(make_pool(c, level));
        svo_result r = check_pool(c, level);
        if (r == SVO_INVALID_DATA) { /* nothing behind can be told in this pool; the others can */
            own->broken = true;
            memset(own->bit, 0, own->words * sizeof *own->bit);
        }
        SVO_TRY(own->broken ? lose(c, r) : r);
    }
    if (c->lost) return SVO_OK;
    bool whole = true;
    SVO_TRY(count_pools(c, &whole));
    uint64_t total = c->pool[0].size[0];
    if (total != v->attribute_count) SVO_TRY(go_on(c, bad(c, "DAG-06", 0, total, "number of attributes is not the size of the tree")));
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH && whole; l++)
        if ((l <= v->depth ? c->nodes[l] : 0) != v->nodes[l]) SVO_TRY(go_on(c, bad(c, "DAG-07", l, v->nodes[l], "number of octree nodes is wrong")));
    return SVO_OK;
}

static void check_free(check *c)
{
    for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) {
        pool *p = &c->pool[l];
        svo_free(c->a, p->bit, p->words, sizeof *p->bit);
        svo_free(c->a, p->before, p->words, sizeof *p->before);
        svo_free(c->a, p->size, p->count, sizeof *p->size);
        svo_free(c->a, p->times, p->count, sizeof *p->times);
    }
    svo_free(c->a, c->seen, c->seen_words, sizeof *c->seen);
}

svo_result svoi_fast_validate(const svo_view *v, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    check c = {.v = v, .a = a, .err = err, .rules = rules};
    svo_result r = validate(&c);
    check_free(&c);
    return r;
}

/* --- bounds ------------------------------------------------------------------------------------------------------- */

typedef struct box { uint32_t low[3], high[3]; } box; /* cells, both inclusive */

typedef struct bounds {
    const svo_view *v;
    box *pool[SVO_MAX_DEPTH];
    uint32_t *number[SVO_MAX_DEPTH]; /* of the node at a byte of a pool */
} bounds;

static void box_add(box *to, const box *b, uint32_t octant, uint32_t half)
{
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t shift = octant >> k & 1 ? half : 0;
        if (b->low[k] + shift < to->low[k]) to->low[k] = b->low[k] + shift;
        if (b->high[k] + shift > to->high[k]) to->high[k] = b->high[k] + shift;
    }
}

static box box_turn(const box *b, uint32_t turn, uint32_t size)
{
    box r;
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t to = (uint32_t)__builtin_ctz(svoi_turn_octant(turn & ~7u, 1u << k));
        bool mirror = turn >> to & 1;
        r.low[to] = mirror ? size - 1 - b->high[k] : b->low[k];
        r.high[to] = mirror ? size - 1 - b->low[k] : b->high[k];
    }
    return r;
}

static box brick_box(uint64_t brick)
{
    box b = {{3, 3, 3}, {0, 0, 0}};
    for (; brick != 0; brick &= brick - 1) {
        uint32_t bit = (uint32_t)__builtin_ctzll(brick);
        for (uint32_t k = 0; k < 3; k++) {
            uint32_t x = (bit >> k & 1) | (bit >> (2 + k) & 2);
            if (x < b.low[k]) b.low[k] = x;
            if (x > b.high[k]) b.high[k] = x;
        }
    }
    return b;
}

/* Box of a node in its own frame; leaves *p behind it. */
static box node_box(const bounds *c, uint32_t level, uint64_t *p)
{
    const svo_view *v = c->v;
    uint32_t size = (uint32_t)1 << (v->tree_depth - level), half = size / 2, slot = 0;
    box all = {{UINT32_MAX, UINT32_MAX, UINT32_MAX}, {0, 0, 0}}, full = {{0, 0, 0}, {half - 1, half - 1, half - 1}};
    if (level + 1 == v->brick_level) {
        svoi_fast_block b = svoi_fast_open_block(v, *p);
        for (uint32_t o = 0; o < 8; o++) {
            if (!(b.mask >> o & 1)) continue;
            box child = full;
            if (b.refs >> o & 1) {
                uint32_t turn;
                uint64_t brick = svoi_fast_brick(v, &b, slot++, &turn);
                child = brick_box(svoi_turn_brick(svoi_turn_inverse(turn), brick));
            }
            box_add(&all, &child, o, half);
        }
        *p = svoi_fast_block_end(v, &b);
        return all;
    }
    svoi_fast_node n = svoi_fast_open(v, level, *p);
    uint64_t inner = n.inner;
    for (uint32_t o = 0; o < 8; o++) {
        if (!(n.mask >> o & 1)) continue;
        box child = full;
        if (n.refs >> o & 1) {
            uint32_t turn = 0, tag = n.tags >> 2 * slot & 3;
            if (tag == 0) child = node_box(c, level + 1, &inner);
            else {
                uint64_t at = svoi_fast_find(v, level, &n, slot, &turn);
                child = box_turn(&c->pool[level + 1][c->number[level + 1][(at - v->fast.level[level + 1].begin) / 8]], svoi_turn_inverse(turn), half);
            }
            slot++;
        }
        box_add(&all, &child, o, half);
    }
    *p = inner;
    return all;
}

svo_result svoi_fast_bounds(const svo_view *v, const svo_allocator *a, uint32_t low[3], uint32_t high[3], svo_error *err)
{
    bounds c = {.v = v};
    svo_result r = SVO_OK;
    box all = {{0, 0, 0}, {0, 0, 0}};
    for (uint32_t level = v->brick_level; level-- > 0 && r == SVO_OK;) {
        const svo_view_fast_level *l = &v->fast.level[level];
        uint64_t p = l->begin;
        c.pool[level] = svo_alloc(a, l->pool_count, sizeof *c.pool[level]);
        c.number[level] = svo_alloc(a, (l->end - l->begin) / 8, sizeof *c.number[level]);
        if (l->pool_count != 0 && (c.pool[level] == NULL || c.number[level] == NULL))
            r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to find the bounds of an octree");
        for (uint64_t k = 0; k < l->pool_count && r == SVO_OK; k++, p = (p + 7) & ~(uint64_t)7) {
            c.number[level][(p - l->begin) / 8] = (uint32_t)k;
            c.pool[level][k] = node_box(&c, level, &p);
        }
        if (level == 0 && r == SVO_OK) all = box_turn(&c.pool[0][0], svoi_turn_inverse(v->root), (uint32_t)1 << v->tree_depth);
    }
    for (uint32_t l = 0; l < v->brick_level; l++) {
        svo_free(a, c.pool[l], v->fast.level[l].pool_count, sizeof *c.pool[l]);
        svo_free(a, c.number[l], (v->fast.level[l].end - v->fast.level[l].begin) / 8, sizeof *c.number[l]);
    }
    memcpy(low, all.low, sizeof all.low);
    memcpy(high, all.high, sizeof all.high);
    return r;
}
