#include "svo_stream.h"

#include "svo_morton.h"

static svo_result bad(svo_error *err, const svo_chunk *c, uint64_t index, const char *why)
{
    svo_fail(err, SVO_INVALID_DATA, "chunk %llx: %s", (unsigned long long)c->code, why);
    if (err != NULL) err->index = index;
    return SVO_INVALID_DATA;
}

/* A full leaf of a level: all nodes below it, and itself. */
static void count_full(svo_tree_counts *counts, uint32_t level, uint32_t depth)
{
    counts->full_leaves++;
    counts->values++;
    for (uint32_t l = level; l <= depth; l++) counts->nodes[l] += (uint64_t)1 << 3 * (l - level);
}

/* The masks of a chunk form exactly one tree. */
static svo_result check_masks(const svo_chunk *c, svo_tree_counts *counts, svo_error *err)
{
    uint8_t left[SVO_CHUNK_LEVELS + 1]; /* children still to come, a level */
    uint32_t l = c->level;              /* level of the node whose mask comes next */
    const uint32_t base = c->level;
    uint64_t i = 0;
    for (;;) {
        if (i == c->node_count) return bad(err, c, i, "masks end inside the tree");
        uint8_t mask = c->masks[i++];
        if (mask == 0) {
            if (l == base) return bad(err, c, i - 1, "the root's mask is empty");
            count_full(counts, l, c->depth);
        } else {
            counts->nodes[l]++;
            if (l + 1 < c->depth) {
                left[l - base] = (uint8_t)__builtin_popcount(mask);
                l++;
                continue;
            }
            counts->nodes[c->depth] += (uint64_t)__builtin_popcount(mask);
            counts->values += (uint64_t)__builtin_popcount(mask);
        }
        /* back up to the deepest ancestor with children left */
        while (l > base && --left[l - 1 - base] == 0) l--;
        if (l == base) break;
    }
    if (i != c->node_count) return bad(err, c, i, "masks after the end of the tree");
    return SVO_OK;
}

svo_result svo_chunk_check(const svo_tree_info *info, const svo_chunk *c, svo_tree_counts *counts, svo_error *err)
{
    uint32_t level = svo_chunk_level(info->depth);
    if (c->depth != info->depth || c->level > level || (c->level < level && c->node_count != 0)) return bad(err, c, 0, "wrong depth or level");
    if (c->level < SVO_MAX_DEPTH && c->code >> (3 * c->level) != 0) return bad(err, c, 0, "code outside the grid");
    for (uint32_t i = 0; i < info->channel_count; i++)
        if (!info->channels[i].constant && c->channels[i] == NULL) return bad(err, c, i, "a channel is missing");
    svo_tree_counts local = {0};
    if (info->depth == 0) {
        if (c->node_count != 0) return bad(err, c, 0, "wrong counts for a single voxel");
        local.chunks = local.nodes[0] = local.values = 1;
    } else if (c->node_count == 0) {
        if (c->level == 0) return bad(err, c, 0, "the octree's root is a full leaf");
        count_full(&local, c->level, info->depth);
    } else {
        local.chunks = 1;
        SVO_TRY(check_masks(c, &local, err));
    }
    if (local.values != c->value_count) return bad(err, c, 0, "value count does not match the masks");
    if (counts != NULL) svo_counts_add(counts, &local);
    return SVO_OK;
}

void svo_counts_add(svo_tree_counts *to, const svo_tree_counts *more)
{
    to->chunks += more->chunks;
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) to->nodes[l] += more->nodes[l];
    to->full_leaves += more->full_leaves;
    to->values += more->values;
}

void svo_counts_ancestors(svo_tree_counts *counts, uint32_t chunk_level, uint32_t level, bool has_previous, uint64_t previous, uint64_t first)
{
    for (uint32_t l = 0; l < level; l++) {
        uint32_t shift = 3 * (chunk_level - l);
        if (!has_previous || previous >> shift != first >> shift) counts->nodes[l]++;
    }
}

/* Calls fn for every value: code and height (levels above the finest) of the voxel or full leaf, and its number. */
typedef bool (*node_fn)(void *user, uint64_t code, uint32_t height, uint64_t index);
static bool visit_values(const svo_chunk *c, node_fn fn, void *user)
{
    if (c->node_count == 0) return fn(user, c->code, c->depth - c->level, 0);
    uint8_t mask[SVO_CHUNK_LEVELS]; /* children not yet visited, a level */
    uint64_t code[SVO_CHUNK_LEVELS];
    uint32_t top = c->depth - c->level - 1, l = 0;
    uint64_t node = 0, index = 0;
    mask[0] = c->masks[node++];
    code[0] = c->code;
    for (;;) {
        if (l == top) {
            for (uint32_t m = mask[l]; m != 0; m &= m - 1)
                if (!fn(user, code[l] << 3 | (uint32_t)__builtin_ctz(m), 0, index++)) return false;
            mask[l] = 0;
        }
        while (mask[l] == 0) {
            if (l == 0) return true;
            l--;
        }
        uint32_t octant = (uint32_t)__builtin_ctz(mask[l]);
        mask[l] &= (uint8_t)(mask[l] - 1);
        code[l + 1] = code[l] << 3 | octant;
        l++;
        mask[l] = c->masks[node++];
        if (mask[l] == 0 && !fn(user, code[l], top + 1 - l, index++)) return false;
    }
}

typedef struct value_visitor { svo_value_fn fn; void *user; } value_visitor;

static bool visit_box(void *user, uint64_t code, uint32_t height, uint64_t index)
{
    const value_visitor *v = user;
    uint32_t low[3];
    svo_morton_decode(code, &low[0], &low[1], &low[2]);
    for (int k = 0; k < 3; k++) low[k] <<= height;
    return v->fn(v->user, low, (uint32_t)1 << height, index);
}

bool svo_chunk_values(const svo_chunk *c, svo_value_fn fn, void *user)
{
    value_visitor v = {fn, user};
    return visit_values(c, visit_box, &v);
}

typedef struct voxel_visitor { svo_voxel_fn fn; void *user; } voxel_visitor;

static bool visit_voxels(void *user, uint64_t code, uint32_t height, uint64_t index)
{
    const voxel_visitor *v = user;
    uint64_t count = (uint64_t)1 << 3 * height;
    for (uint64_t i = 0; i < count; i++) {
        uint32_t x, y, z;
        svo_morton_decode(code << 3 * height | i, &x, &y, &z);
        if (!v->fn(v->user, x, y, z, index)) return false;
    }
    return true;
}

bool svo_chunk_voxels(const svo_chunk *c, svo_voxel_fn fn, void *user)
{
    voxel_visitor v = {fn, user};
    return visit_values(c, visit_voxels, &v);
}
