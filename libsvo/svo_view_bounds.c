/* The box of all finest voxels, in time by stored nodes rather than by voxels. */
#include <string.h>

#include "svoi_best.h"
#include "svoi_view.h"

/* Nodes of one level that may hold the extreme voxel: a bit for every word (or brick) index. */
typedef struct frontier {
    uint64_t *bits;
    uint64_t words; /* 64-bit words of bits */
} frontier;

static inline void frontier_set(frontier *f, uint64_t ref) { f->bits[ref >> 6] |= (uint64_t)1 << (ref & 63); }

/* Octants with bit `axis` set. */
static const uint32_t upper_octants[3] = {0xaa, 0xcc, 0xf0};

/* The 8-bit child mask of a brick's 4x4x4 block. */
static uint32_t brick_mask(uint64_t brick)
{
    uint64_t o = svo_brick_octants(brick);
    return (uint32_t)((o * 0x0102040810204080u) >> 56);
}

/* Extreme coordinate along an axis: level by level, keep just the nodes whose coordinate is extreme so far. */
static uint32_t extreme(const svo_view *v, frontier levels[2], uint32_t axis, bool upper)
{
    uint32_t coordinate = 0;
    uint32_t wanted = upper ? upper_octants[axis] : ~upper_octants[axis] & 0xffu;
    frontier *now = &levels[0], *next = &levels[1];
    memset(now->bits, 0, now->words * 8);
    frontier_set(now, v->root);
    for (uint32_t level = 0; level < v->brick_level; level++) {
        bool found = false;
        uint64_t count = v->levels[level].word_count;
        for (int pass = 0; pass < 2 && !found; pass++) {
            uint32_t octants = pass == 0 ? wanted : ~wanted & 0xffu;
            memset(next->bits, 0, next->words * 8);
            for (uint64_t w = 0; w < (count + 63) / 64; w++)
                for (uint64_t set = now->bits[w]; set != 0; set &= set - 1) {
                    uint32_t ref = (uint32_t)(64 * w) + (uint32_t)__builtin_ctzll(set);
                    uint32_t mask = v->levels[level].words[ref] & 0xffu, full = v->levels[level].words[ref] >> 8;
                    if (full & octants) { /* it reaches to the end of its cell: nothing can be further out */
                        uint32_t rest = v->tree_depth - level - 1, bit = upper == (pass == 0);
                        return (2 * coordinate + bit) << rest | (upper ? (1u << rest) - 1 : 0);
                    }
                    mask &= ~full;
                    for (uint32_t m = mask & octants; m != 0; m &= m - 1) {
                        uint32_t octant = (uint32_t)__builtin_ctz(m);
                        uint32_t slot = (uint32_t)__builtin_popcount(mask & ((1u << octant) - 1));
                        frontier_set(next, v->levels[level].words[ref + 1 + slot]);
                        found = true;
                    }
                }
            if (found) coordinate = 2 * coordinate + (uint32_t)(upper == (pass == 0));
        }
        frontier *swap = now;
        now = next, next = swap;
    }
    /* All bricks left agree above: take their union, then its extreme of four layers. */
    uint64_t all = 0;
    for (uint64_t w = 0; w < (v->brick_count + 63) / 64; w++)
        for (uint64_t set = now->bits[w]; set != 0; set &= set - 1)
            all |= v->bricks[64 * w + (uint64_t)__builtin_ctzll(set)];
    uint32_t octant_mask = brick_mask(all), halves = 0; /* bit h: a voxel in half h of the axis */
    if (octant_mask & ~upper_octants[axis] & 0xffu) halves |= 1;
    if (octant_mask & upper_octants[axis]) halves |= 2;
    uint32_t half = upper ? (halves >> 1 & 1) : (halves & 1 ? 0 : 1);
    uint32_t quarters = 0;
    for (uint32_t a = 0; a < 8; a++)
        if ((upper_octants[axis] >> a & 1) == half) quarters |= (uint32_t)(all >> (8 * a)) & 0xffu;
    uint32_t low_voxels = quarters & ~upper_octants[axis] & 0xffu, high_voxels = quarters & upper_octants[axis];
    uint32_t quarter = upper ? (high_voxels != 0 ? 1 : 0) : (low_voxels != 0 ? 0 : 1);
    return 4 * coordinate + 2 * half + quarter;
}

svo_result svo_view_grid_bounds(const svo_view *v, const svo_allocator *a, bool *any, uint32_t low[3], uint32_t high[3], svo_error *err)
{
    *any = !v->empty;
    for (int k = 0; k < 3; k++) low[k] = high[k] = 0;
    if (v->empty) return SVO_OK;
    if (v->layout == SVO_LAYOUT_FAST) return svoi_fast_bounds(v, a, low, high, err);
    if (v->layout == SVO_LAYOUT_BEST) return svoi_best_bounds(v, a, low, high) ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to find the bounds of an octree");
    uint64_t items = v->brick_count;
    for (uint32_t l = 0; l < v->brick_level; l++)
        if (v->levels[l].word_count > items) items = v->levels[l].word_count;
    uint64_t words = items / 64 + 1;
    uint64_t *bits = svo_calloc(a, 2 * words, 8);
    if (bits == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to find the bounds of an octree");
    frontier levels[2] = {{bits, words}, {bits + words, words}};
    for (uint32_t axis = 0; axis < 3; axis++) {
        low[axis] = extreme(v, levels, axis, false);
        high[axis] = extreme(v, levels, axis, true);
    }
    svo_free(a, bits, 2 * words, 8);
    return SVO_OK;
}
