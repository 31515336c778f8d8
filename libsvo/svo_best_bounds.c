/* The box of layout 3's voxels: the box of each pool's entry in its own frame, from the blocks up. */
#include "svoi_best.h"

bool svoi_best_pool_alloc(svoi_best_pool *p, const svo_allocator *a)
{
    p->words = p->bytes / 64 + 1;
    p->bit = svo_calloc(a, p->words, sizeof *p->bit);
    p->before = svo_alloc(a, p->words, sizeof *p->before);
    return p->bit != NULL && p->before != NULL;
}

void svoi_best_pool_free(svoi_best_pool *p, const svo_allocator *a)
{
    svo_free(a, p->bit, p->words, sizeof *p->bit);
    svo_free(a, p->before, p->words, sizeof *p->before);
}

void svoi_best_pool_end(svoi_best_pool *p)
{
    uint64_t before = 0;
    for (uint64_t i = 0; i < p->words; i++) {
        p->before[i] = before;
        before += (uint64_t)__builtin_popcountll(p->bit[i]);
    }
}

typedef struct box { uint32_t low[3], high[3]; } box;

typedef struct bounds {
    const svoi_best *b;
    svoi_best_pool pool[SVO_MAX_DEPTH];
    box *box[SVO_MAX_DEPTH]; /* of a level's entries */
} bounds;

/* A box in a cube of `size` voxels a side, turned with the cube. */
static box turn_box(uint32_t turn, box in, uint32_t size)
{
    static const uint8_t axes[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    box out;
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t to = axes[turn >> 3][k];
        bool mirror = turn >> to & 1;
        out.low[to] = mirror ? size - 1 - in.high[k] : in.low[k];
        out.high[to] = mirror ? size - 1 - in.low[k] : in.high[k];
    }
    return out;
}

static void add_box(box *to, box in, uint32_t octant, uint32_t size)
{
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t at = octant >> k & 1 ? size : 0;
        if (in.low[k] + at < to->low[k]) to->low[k] = in.low[k] + at;
        if (in.high[k] + at > to->high[k]) to->high[k] = in.high[k] + at;
    }
}

static box brick_box(uint64_t bits)
{
    /* voxels with coordinate 0 along x, y, z; the others are these shifted */
    static const uint64_t first[3] = {0x0055005500550055u, 0x0000333300003333u, 0x000000000f0f0f0fu};
    box b;
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t seen = 0;
        for (uint32_t i = 0; i < 4; i++) seen |= (uint32_t)((bits & first[k] << ((i & 1) << k) << ((i >> 1) << (k + 3))) != 0) << i;
        b.low[k] = (uint32_t)__builtin_ctz(seen);
        b.high[k] = 31 - (uint32_t)__builtin_clz(seen);
    }
    return b;
}

/* `size`: voxels along an edge of a child. */
static box node_box(bounds *s, uint32_t level, svoi_best_node n, uint32_t size, uint64_t *end)
{
    box out = {{2 * size, 2 * size, 2 * size}, {0, 0, 0}}, full = {{0, 0, 0}, {size - 1, size - 1, size - 1}};
    if (level == s->b->block_level) {
        svoi_best_block block;
        svoi_best_check_block(s->b, n, &block, end);
        for (uint32_t m = n.mask; m != 0; m &= m - 1) {
            uint32_t o = (uint32_t)__builtin_ctz(m);
            add_box(&out, brick_box(svoi_turn_brick(block.turn[o], block.bits[o])), o, size);
        }
        return out;
    }
    svoi_best_head h = svoi_best_read_head(s->b, level, n);
    *end = h.inside;
    for (uint32_t m = n.mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), slot = (uint32_t)__builtin_popcount(h.refs & ((1u << o) - 1)), turn;
        if (h.full >> o & 1) {
            add_box(&out, full, o, size);
            continue;
        }
        svoi_best_node child = svoi_best_child(s->b, level, n, &h, o, &turn);
        bool shared = h.shared >> (h.slots - 1 - slot) & 1;
        box in = shared ? turn_box(turn, s->box[level + 1][svoi_best_entry_of(s->b, s->pool, level + 1, child)], size)
                        : node_box(s, level + 1, child, size / 2, end);
        add_box(&out, in, o, size);
    }
    return out;
}

static bool pool_boxes(bounds *s, uint32_t level, const svo_allocator *a)
{
    const svoi_best *b = s->b;
    svoi_best_pool *p = &s->pool[level];
    uint64_t first = b->level[level].first, next = level == b->block_level ? b->stream_bits / 8 : b->level[level + 1].first, at = 8 * first;
    p->bytes = next - first;
    p->entries = b->level[level].entries;
    s->box[level] = svo_alloc(a, p->entries + 1, sizeof **s->box);
    if (s->box[level] == NULL || !svoi_best_pool_alloc(p, a)) return false;
    for (uint64_t i = 0; i < p->entries; i++) {
        svoi_best_node n = {at + 8, b->stream[at / 8]};
        svoi_best_pool_begin(p, at / 8 - first);
        s->box[level][i] = node_box(s, level, n, 4u << (b->block_level - level), &at);
        at = (at + 7) & ~(uint64_t)7;
    }
    svoi_best_pool_end(p);
    return true;
}

bool svoi_best_bounds(const svo_view *v, const svo_allocator *a, uint32_t low[3], uint32_t high[3])
{
    bounds *s = svo_calloc(a, 1, sizeof *s);
    if (s == NULL) return false;
    s->b = v->best;
    bool ok = true;
    for (uint32_t level = s->b->block_level + 1; level-- > 0 && ok;) ok = pool_boxes(s, level, a);
    if (ok) {
        box b = turn_box(s->b->root_turn, s->box[0][0], 8u << s->b->block_level);
        for (int k = 0; k < 3; k++) low[k] = b.low[k], high[k] = b.high[k];
    }
    for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) {
        svo_free(a, s->box[l], s->pool[l].entries + 1, sizeof **s->box);
        svoi_best_pool_free(&s->pool[l], a);
    }
    svo_free(a, s, 1, sizeof *s);
    return ok;
}
