#include "svo_stream.h"

#include "svo_morton.h"

static svo_result bad(svo_error *err, const svo_chunk *c, uint64_t index, const char *why)
{
    svo_fail(err, SVO_INVALID_DATA, "chunk %llx: %s", (unsigned long long)c->code, why);
    if (err != NULL) err->index = index;
    return SVO_INVALID_DATA;
}

svo_result svo_chunk_check(const svo_tree_info *info, const svo_chunk *c, svo_tree_counts *counts, svo_error *err)
{
    uint32_t level = svo_chunk_level(info->depth);
    if (c->depth != info->depth || c->level != level) return bad(err, c, 0, "wrong depth or level");
    if (level < SVO_MAX_DEPTH && c->code >> (3 * level) != 0) return bad(err, c, 0, "code outside the grid");
    for (uint32_t i = 0; i < info->channel_count; i++)
        if (!info->channels[i].constant && c->channels[i] == NULL) return bad(err, c, i, "a channel is missing");
    svo_tree_counts local = {.chunks = 1};
    if (info->depth == level) {
        if (c->node_count != 0 || c->voxel_count != 1) return bad(err, c, 0, "wrong counts for a single voxel");
        local.nodes[level] = 1;
    } else {
        uint8_t left[SVO_CHUNK_LEVELS + 1]; /* children still to come, a level */
        uint32_t l = level;                 /* level of the node whose mask comes next */
        uint32_t base = level;
        uint64_t i = 0;
        for (;;) {
            if (i == c->node_count) return bad(err, c, i, "masks end inside the tree");
            uint8_t mask = c->masks[i++];
            if (mask == 0) return bad(err, c, i - 1, "empty mask");
            local.nodes[l]++;
            if (l + 1 < info->depth) {
                left[l - base] = (uint8_t)__builtin_popcount(mask);
                l++;
                continue;
            }
            local.nodes[info->depth] += (uint64_t)__builtin_popcount(mask);
            /* back up to the deepest ancestor with children left */
            while (l > base && --left[l - 1 - base] == 0) l--;
            if (l == base) break;
        }
        if (i != c->node_count) return bad(err, c, i, "masks after the end of the tree");
        if (local.nodes[info->depth] != c->voxel_count) return bad(err, c, 0, "voxel count does not match the masks");
    }
    if (counts != NULL) {
        counts->chunks++;
        for (uint32_t l = level; l <= info->depth; l++) counts->nodes[l] += local.nodes[l];
    }
    return SVO_OK;
}

void svo_counts_ancestors(svo_tree_counts *counts, uint32_t chunk_level, bool has_previous, uint64_t previous, uint64_t code)
{
    for (uint32_t l = 0; l < chunk_level; l++) {
        uint32_t shift = 3 * (chunk_level - l);
        if (!has_previous || previous >> shift != code >> shift) counts->nodes[l]++;
    }
}

void svo_chunk_voxels(const svo_chunk *c, svo_voxel_fn fn, void *user)
{
    uint32_t x, y, z;
    if (c->depth == c->level) {
        svo_morton_decode(c->code, &x, &y, &z);
        fn(user, x, y, z, 0);
        return;
    }
    uint8_t mask[SVO_CHUNK_LEVELS]; /* children not yet visited, a level */
    uint64_t code[SVO_CHUNK_LEVELS];
    uint32_t top = c->depth - c->level - 1, l = 0;
    uint64_t node = 0, index = 0;
    mask[0] = c->masks[node++];
    code[0] = c->code;
    for (;;) {
        if (l == top) {
            for (uint32_t m = mask[l]; m != 0; m &= m - 1) {
                svo_morton_decode(code[l] << 3 | (uint32_t)__builtin_ctz(m), &x, &y, &z);
                if (!fn(user, x, y, z, index++)) return;
            }
            mask[l] = 0;
        }
        while (mask[l] == 0) {
            if (l == 0) return;
            l--;
        }
        uint32_t octant = (uint32_t)__builtin_ctz(mask[l]);
        mask[l] &= (uint8_t)(mask[l] - 1);
        code[l + 1] = code[l] << 3 | octant;
        l++;
        mask[l] = c->masks[node++];
    }
}
