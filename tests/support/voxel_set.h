/* For tests of voxelization: a mesh made of loose triangles, and a sink that keeps every voxel with its attributes. */
#ifndef VOXEL_SET_H
#define VOXEL_SET_H

#include <stdlib.h>
#include <string.h>

#include "svo_morton.h"
#include "svo_voxelize.h"
#include "test.h"

/* Borrowed-memory mesh with one shape, one part and one identity instance; freed with loose_free. */
typedef struct loose_mesh {
    svo_mesh mesh;
    svo_shape shape;
    svo_part part;
    svo_instance instance;
} loose_mesh;

/* positions: 9 doubles a triangle. Keeps its own copy. */
static inline void loose_make(loose_mesh *m, const double *positions, uint64_t triangles)
{
    memset(m, 0, sizeof *m);
    m->part.material = SVO_NONE;
    m->part.vertex_count = 3 * triangles;
    m->part.triangle_count = triangles;
    m->part.positions = (double *)malloc(72 * (triangles + 1));
    if (triangles != 0) memcpy(m->part.positions, positions, 72 * triangles);
    m->part.indices = (uint32_t *)malloc(12 * (triangles + 1));
    for (uint64_t i = 0; i < 3 * triangles; i++) m->part.indices[i] = (uint32_t)i;
    m->shape.name = (char *)"";
    m->shape.part_count = 1;
    m->shape.parts = &m->part;
    m->instance.name = (char *)"";
    m->instance.transform = svo_mat4_identity();
    m->mesh.shape_count = m->mesh.instance_count = 1;
    m->mesh.shapes = &m->shape;
    m->mesh.instances = &m->instance;
}
static inline void loose_free(loose_mesh *m)
{
    free(m->part.positions);
    free(m->part.indices);
    free(m->part.normals);
    free(m->part.colors);
    for (int i = 0; i < 4; i++) free(m->part.uvs[i]);
}

/* What a voxelization gave: voxel codes in order, channel values beside them, and one running hash of all bytes. */
typedef struct voxel_set {
    svo_tree_info info;
    svo_voxelize_report report;
    svo_tree_counts counts; /* counted again from the chunks */
    uint64_t count, capacity;
    uint64_t *codes;
    uint8_t *values[SVO_MAX_CHANNELS];
    uint64_t hash;
    bool keep;             /* codes and values, not only the hash */
    bool ordered;          /* chunks came in ascending order and passed svo_chunk_check */
    uint64_t previous, end;
    bool has_previous;
    uint64_t live_blobs;
    const svo_chunk *chunk; /* in hand */
} voxel_set;

typedef struct voxel_blob {
    svo_chunk chunk;
    svo_result check;
    svo_tree_counts counts;
} voxel_blob;

static inline void voxel_blob_free(voxel_blob *b)
{
    free((void *)(uintptr_t)b->chunk.masks);
    for (int c = 0; c < (int)SVO_MAX_CHANNELS; c++) free((void *)(uintptr_t)b->chunk.channels[c]);
    free(b);
}
static inline uint8_t *voxel_copy(const uint8_t *p, size_t n)
{
    uint8_t *q = (uint8_t *)malloc(n + 1);
    if (n != 0) memcpy(q, p, n);
    return q;
}
static inline svo_result voxel_encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err)
{
    (void)worker;
    voxel_set *s = (voxel_set *)user;
    voxel_blob *b = (voxel_blob *)calloc(1, sizeof *b);
    b->chunk = *chunk;
    b->check = svo_chunk_check(&s->info, chunk, &b->counts, err);
    b->chunk.masks = voxel_copy(chunk->masks, chunk->node_count);
    for (uint32_t c = 0; c < s->info.channel_count; c++) {
        b->chunk.channels[c] = NULL;
        if (!s->info.channels[c].constant) b->chunk.channels[c] = voxel_copy(chunk->channels[c], chunk->value_count * svo_channel_stride(s->info.channels[c].kind));
    }
    *blob = b;
    __atomic_fetch_add(&s->live_blobs, 1, __ATOMIC_RELAXED);
    return b->check;
}
static inline void voxel_hash(voxel_set *s, const void *bytes, uint64_t n)
{
    const uint8_t *p = (const uint8_t *)bytes;
    for (uint64_t i = 0; i < n; i++) s->hash = (s->hash ^ p[i]) * 0x100000001b3u;
}
static inline bool voxel_keep(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    voxel_set *s = (voxel_set *)user;
    if (s->count == s->capacity) {
        s->capacity = s->capacity * 2 + 1024;
        s->codes = (uint64_t *)realloc(s->codes, s->capacity * 8);
        for (uint32_t c = 0; c < s->info.channel_count; c++)
            if (!s->info.channels[c].constant) s->values[c] = (uint8_t *)realloc(s->values[c], s->capacity * svo_channel_stride(s->info.channels[c].kind));
    }
    for (uint32_t c = 0; c < s->info.channel_count; c++) {
        if (s->info.channels[c].constant) continue;
        uint64_t stride = svo_channel_stride(s->info.channels[c].kind);
        memcpy(s->values[c] + s->count * stride, s->chunk->channels[c] + index * stride, stride);
    }
    s->codes[s->count++] = svo_morton_encode(x, y, z);
    return true;
}
static inline svo_result voxel_commit(void *user, void *blob, svo_error *err)
{
    (void)err;
    voxel_set *s = (voxel_set *)user;
    voxel_blob *b = (voxel_blob *)blob;
    if (b->check != SVO_OK || (s->has_previous && svo_chunk_first(&b->chunk) < s->end)) s->ordered = false;
    svo_counts_ancestors(&s->counts, svo_chunk_level(s->info.depth), b->chunk.level, s->has_previous, s->previous, svo_chunk_first(&b->chunk));
    svo_counts_add(&s->counts, &b->counts);
    s->previous = svo_chunk_first(&b->chunk);
    s->end = svo_chunk_end(&b->chunk);
    s->has_previous = true;
    voxel_hash(s, &b->chunk.code, 8);
    voxel_hash(s, b->chunk.masks, b->chunk.node_count);
    s->chunk = &b->chunk;
    if (s->keep) svo_chunk_voxels(&b->chunk, voxel_keep, s);
    for (uint32_t c = 0; c < s->info.channel_count; c++) {
        if (s->info.channels[c].constant) continue;
        uint64_t stride = svo_channel_stride(s->info.channels[c].kind);
        voxel_hash(s, b->chunk.channels[c], b->chunk.value_count * stride);
    }
    __atomic_fetch_sub(&s->live_blobs, 1, __ATOMIC_RELAXED);
    voxel_blob_free(b);
    return SVO_OK;
}
static inline void voxel_discard(void *user, void *blob)
{
    voxel_set *s = (voxel_set *)user;
    __atomic_fetch_sub(&s->live_blobs, 1, __ATOMIC_RELAXED);
    voxel_blob_free((voxel_blob *)blob);
}

/* Plan and voxelize; *out is filled (free with voxel_free) also when it fails. */
static inline svo_result voxel_run(const svo_mesh *mesh, const svo_voxelize_options *o, bool keep, voxel_set *out, svo_error *err)
{
    memset(out, 0, sizeof *out);
    out->keep = keep;
    out->ordered = true;
    out->hash = 0xcbf29ce484222325u;
    svo_result r = svo_voxelize_plan(mesh, o, &out->info, err);
    if (r != SVO_OK) return r;
    svo_chunk_sink sink = {out, voxel_encode, voxel_commit, voxel_discard};
    return svo_voxelize(mesh, o, &out->info, &sink, &out->report, err);
}
static inline void voxel_free(voxel_set *s)
{
    free(s->codes);
    for (int c = 0; c < (int)SVO_MAX_CHANNELS; c++) free(s->values[c]);
}
/* Index of a voxel, or -1. */
static inline int64_t voxel_find(const voxel_set *s, uint64_t code)
{
    uint64_t low = 0, high = s->count;
    while (low < high) {
        uint64_t mid = (low + high) / 2;
        if (s->codes[mid] < code) low = mid + 1;
        else high = mid;
    }
    return low < s->count && s->codes[low] == code ? (int64_t)low : -1;
}

#endif
