/* The voxelizer's half for solids: chunks of surface and inside, and the values of what is inside.
 *
 * A voxel or leaf inside takes the values of the nearest surface: up to 8^3 voxels, those of the surface voxel of the chunk whose centre is nearest to
 * its own (but for half the side of a leaf: svoi_solid_near.h), so they are averaged and filtered already; where another chunk may hold a nearer one, and for larger
 * leaves, those at the nearest point of the mesh. */
#include <string.h>

#include "svo_morton.h"
#include "svoi_solid_near.h"
#include "svoi_voxelize.h"

enum { NEAR_HEIGHT = 3, ASK_MESH = 0x80000000u /* a source that is no voxel */ };

static svo_result out_of_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while voxelizing"); }

svo_bin_side svoi_solid_side(void *user, uint64_t code, uint32_t level)
{
    svoi_run *r = user;
    uint32_t x, y, z, shift = r->info->depth - level;
    svo_morton_decode(code, &x, &y, &z);
    const int32_t corner[3] = {(int32_t)(x << shift), (int32_t)(y << shift), (int32_t)(z << shift)};
    switch (svo_solid_node(r->winding, corner, (int32_t)1 << shift, &r->asked)) {
    case SVO_SIDE_OUTSIDE: return SVO_BIN_SKIP;
    case SVO_SIDE_INSIDE: return SVO_BIN_FULL;
    case SVO_SIDE_MIXED: break;
    }
    return SVO_BIN_SPLIT;
}

/* --- values ------------------------------------------------------------------------------------------------------- */

/* Values at the point of the mesh nearest to the middle of a node whose low corner and size are given in voxels. */
static svo_result mesh_values(svoi_scan *s, const int32_t low[3], int32_t size, uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE], svo_error *err)
{
    svoi_worker *w = s->w;
    int32_t p[3];
    svo_winding_hit hit = w->hit;
    double barycentric[3];
    for (int k = 0; k < 3; k++) p[k] = low[k] * SVO_RASTER_UNIT + size * (SVO_RASTER_UNIT / 2);
    if (!svo_winding_nearest(s->r->winding, p, &hit, barycentric)) return SVO_OK; /* nothing is inside of no mesh */
    if (hit.triangle != w->hit.triangle) {
        w->hit.triangle = SVO_NONE;
        if (s->r->far != NULL) SVO_TRY(svoi_far_facet(s->r, w, hit.triangle, err));
        else svo_facet_make_points(s->r->shader, hit.triangle, &w->nearest);
        w->hit = hit;
    }
    svo_facet_point(s->r->shader, &w->nearest, barycentric, values);
    return SVO_OK;
}

/* For every value the number of the surface voxel that it takes after, or ASK_MESH. */
static bool find_sources(svoi_scan *s, uint32_t levels)
{
    svoi_worker *w = s->w;
    const svo_block *b = w->block;
    const uint32_t *entries = (const uint32_t *)(const void *)w->entries.data;
    uint64_t count = w->entries.size / sizeof *entries;
    svoi_near near;
    svoi_near_begin(&near, b, levels, s->corner_axis, (int32_t)1 << s->r->info->depth);
    w->sources.size = 0;
    uint32_t *source = svo_buffer_append(&w->sources, NULL, count * sizeof *source), surface = 0;
    if (source == NULL) return false;
    for (uint64_t i = 0; i < count; i++) {
        uint32_t code;
        if (entries[i] & SVO_SOLID_SURFACE) source[i] = surface++;
        else if (svo_solid_height(entries[i]) <= NEAR_HEIGHT && svoi_near_voxel(&near, svo_solid_code(entries[i]), svo_solid_height(entries[i]), &code)) source[i] = svo_block_index(b, code);
        else source[i] = ASK_MESH;
    }
    return true;
}

/* The values of surface and inside in order, from those of the surface. */
static svo_result fill_values(svoi_scan *s, uint32_t levels, svo_error *err)
{
    svoi_run *r = s->r;
    svoi_worker *w = s->w;
    if (!find_sources(s, levels)) return out_of_memory(err);
    const uint32_t *entries = (const uint32_t *)(const void *)w->entries.data, *source = (const uint32_t *)(const void *)w->sources.data;
    uint64_t count = w->entries.size / sizeof *entries, bytes = 0;
    for (uint32_t c = 0; c < r->info->channel_count; c++)
        if (!r->info->channels[c].constant) bytes += count * svo_channel_stride(r->info->channels[c].kind);
    w->filled.size = 0;
    if (svo_buffer_append(&w->filled, NULL, bytes) == NULL) return out_of_memory(err);
    uint8_t *to = w->filled.data, *first[SVO_MAX_CHANNELS] = {NULL};
    for (uint32_t c = 0; c < r->info->channel_count; c++) {
        if (r->info->channels[c].constant) continue;
        uint32_t stride = svo_channel_stride(r->info->channels[c].kind);
        const uint8_t *from = s->channels[c];
        first[c] = to;
        for (uint64_t i = 0; i < count; i++, to += stride)
            if (source[i] != ASK_MESH) memcpy(to, from + (uint64_t)source[i] * stride, stride);
    }
    for (uint64_t i = 0; i < count; i++) {
        if (source[i] != ASK_MESH) continue;
        uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE] = {{0}};
        uint32_t at[3];
        svo_morton_decode(svo_solid_code(entries[i]), &at[0], &at[1], &at[2]);
        const int32_t low[3] = {s->corner_axis[0] + (int32_t)at[0], s->corner_axis[1] + (int32_t)at[1], s->corner_axis[2] + (int32_t)at[2]};
        SVO_TRY(mesh_values(s, low, (int32_t)1 << svo_solid_height(entries[i]), values, err));
        for (uint32_t c = 0; c < r->info->channel_count; c++) {
            uint32_t stride = svo_channel_stride(r->info->channels[c].kind);
            if (first[c] != NULL) memcpy(first[c] + i * stride, values[c], stride);
        }
    }
    for (uint32_t c = 0; c < r->info->channel_count; c++) s->channels[c] = first[c];
    return SVO_OK;
}

static bool varies(const svoi_run *r)
{
    for (uint32_t c = 0; c < r->info->channel_count; c++)
        if (!r->info->channels[c].constant) return true;
    return false;
}

/* An item that is one full leaf: its values go into the worker's `filled`. */
static svo_result full_item(svoi_scan *s, uint32_t level, svo_chunk *chunk, svo_error *err)
{
    const svoi_run *r = s->r;
    svoi_worker *w = s->w;
    uint32_t shift = r->info->depth - level, x, y, z;
    *chunk = (svo_chunk){.code = s->it->code, .level = level, .depth = r->info->depth, .value_count = 1};
    if (!varies(r)) return SVO_OK;
    uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE] = {{0}};
    svo_morton_decode(s->it->code, &x, &y, &z);
    const int32_t low[3] = {(int32_t)(x << shift), (int32_t)(y << shift), (int32_t)(z << shift)};
    SVO_TRY(mesh_values(s, low, (int32_t)1 << shift, values, err));
    w->filled.size = 0;
    if (svo_buffer_append(&w->filled, values, sizeof values) == NULL) return out_of_memory(err);
    for (uint32_t c = 0; c < r->info->channel_count; c++)
        if (!r->info->channels[c].constant) chunk->channels[c] = w->filled.data + c * SVO_MAX_STRIDE;
    return SVO_OK;
}

svo_result svoi_solid_chunk(svoi_scan *s, uint32_t levels, svo_chunk *chunk, bool *any, svo_error *err)
{
    svoi_run *r = s->r;
    svoi_worker *w = s->w;
    svoi_item *it = s->it;
    *any = true;
    if (it->full) {
        SVO_TRY(full_item(s, it->level, chunk, err));
    } else {
        const bool values_vary = varies(r);
        bool full = false;
        uint64_t values = 0;
        if (w->solid == NULL) w->solid = svo_solid_create(r->allocator);
        w->masks.size = w->entries.size = 0;
        if (w->solid == NULL || !svo_solid_fill(w->solid, w->block, r->winding, s->corner_axis, levels, it->level > 0, &w->masks,
                                                values_vary ? &w->entries : NULL, &values, &full, &it->asked))
            return out_of_memory(err);
        *any = values != 0;
        if (!*any) return SVO_OK;
        if (full) {
            SVO_TRY(full_item(s, it->level, chunk, err));
        } else {
            *chunk = (svo_chunk){.code = it->code, .level = it->level, .depth = r->info->depth, .masks = w->masks.data, .node_count = w->masks.size, .value_count = values};
            if (values_vary) SVO_TRY(fill_values(s, levels, err));
            for (uint32_t c = 0; c < r->info->channel_count; c++)
                if (!r->info->channels[c].constant) chunk->channels[c] = s->channels[c];
        }
    }
    return svo_chunk_check(r->info, chunk, &it->tree, err);
}
