/* Octrees of one chunk: so that all threads work on it, its voxels are made in smaller cubes ("units"), which are put together here.
 * The units do not depend on threads, and the chunk not on the units. */
#include <string.h>

#include "svoi_voxelize.h"

static svo_result out_of_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while voxelizing"); }

uint32_t svoi_unit_levels(uint32_t depth)
{
    if (depth > SVO_CHUNK_LEVELS) return SVO_CHUNK_LEVELS;
    return depth > 4 ? depth - SVOI_JOIN_LEVELS : depth;
}

void svoi_join_init(svoi_join *j, const svo_allocator *a)
{
    memset(j, 0, sizeof *j);
    svo_buffer_init(&j->masks, a);
    svo_buffer_init(&j->chunk, a);
    for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) svo_buffer_init(&j->channels[c], a);
}

void svoi_join_free(svoi_join *j)
{
    svo_buffer_free(&j->masks);
    svo_buffer_free(&j->chunk);
    for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) svo_buffer_free(&j->channels[c]);
}

svo_result svoi_join_add(svoi_join *j, const svo_tree_info *info, uint64_t code, const svo_chunk *unit, svo_error *err)
{
    j->start[code] = j->masks.size;
    j->used |= (uint64_t)1 << code;
    j->value_count += unit->value_count;
    if (svo_buffer_append(&j->masks, unit->masks, (size_t)unit->node_count) == NULL) return out_of_memory(err);
    j->start[code + 1] = j->masks.size;
    for (uint32_t c = 0; c < info->channel_count; c++) {
        if (info->channels[c].constant) continue;
        size_t bytes = (size_t)unit->value_count * svo_channel_stride(info->channels[c].kind);
        if (svo_buffer_append(&j->channels[c], unit->channels[c], bytes) == NULL) return out_of_memory(err);
    }
    return SVO_OK;
}

svo_result svoi_join_chunk(svoi_join *j, const svo_tree_info *info, svo_chunk *out, svo_error *err)
{
    /* Preorder: the root, then each of its children with the units below it. */
    if (!svo_buffer_reserve(&j->chunk, j->masks.size + 9)) return out_of_memory(err);
    uint8_t root = 0;
    for (uint32_t i = 0; i < 8; i++)
        if (j->used >> 8 * i & 255) root |= (uint8_t)(1u << i);
    svo_buffer_append(&j->chunk, &root, 1);
    for (uint32_t i = 0; i < 8; i++) {
        uint8_t mask = (uint8_t)(j->used >> 8 * i & 255);
        if (mask == 0) continue;
        svo_buffer_append(&j->chunk, &mask, 1);
        for (uint32_t k = 0; k < 8; k++)
            if (mask >> k & 1) svo_buffer_append(&j->chunk, j->masks.data + j->start[8 * i + k], j->start[8 * i + k + 1] - j->start[8 * i + k]);
    }
    *out = (svo_chunk){.depth = info->depth, .masks = j->chunk.data, .node_count = j->chunk.size, .value_count = j->value_count};
    for (uint32_t c = 0; c < info->channel_count; c++) out->channels[c] = j->channels[c].data;
    return SVO_OK;
}
