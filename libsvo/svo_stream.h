/* A sparse voxel octree as a stream of chunks: what the voxelizer produces, .svo files hold, and every builder reads.
 * A whole octree never has to be in memory.
 *
 * The octree has levels 0 (root) to `depth`; its finest voxels are cells of a grid of 2^depth cubed. It is cut at
 * `chunk_level` = max(0, depth - 7): every non-empty node of that level is the root of one chunk, a subtree of at most
 * 128^3 voxels. Chunks come in ascending Morton order. Nodes above the cut follow from the chunks' codes. */
#ifndef SVO_STREAM_H
#define SVO_STREAM_H

#include "svo_alloc.h"
#include "svo_channel.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_CHUNK_LEVELS 7u
static inline uint32_t svo_chunk_level(uint32_t depth) { return depth > SVO_CHUNK_LEVELS ? depth - SVO_CHUNK_LEVELS : 0; }

typedef enum svo_surface { SVO_SURFACE_CONSERVATIVE = 0, SVO_SURFACE_THIN = 1 } svo_surface;
typedef enum svo_fill { SVO_FILL_SURFACE = 0, SVO_FILL_SOLID = 1 } svo_fill;

/* Known before the first chunk. */
typedef struct svo_tree_info {
    uint32_t depth; /* 0..SVO_MAX_DEPTH */
    svo_surface surface;
    svo_fill fill;
    /* Row-major affine map from integer grid coordinates (voxel corners) to the mesh's coordinates. */
    double voxel_to_world[16];
    uint32_t channel_count;
    svo_channel channels[SVO_MAX_CHANNELS];
} svo_tree_info;

/* Known after the last chunk. */
typedef struct svo_tree_counts {
    uint64_t chunks;
    uint64_t nodes[SVO_MAX_DEPTH + 1]; /* non-empty nodes a level; nodes[depth] are the finest voxels */
} svo_tree_counts;

/* One subtree. Masks are the child masks of its inner nodes (levels chunk_level .. depth - 1) in depth-first
 * preorder, children in octant order; bit i is octant i, and no mask is 0. Channel values belong to the finest voxels
 * in the same depth-first (= Morton) order. depth == 0: no masks, one voxel. */
typedef struct svo_chunk {
    uint64_t code;  /* Morton code of its root at chunk_level */
    uint32_t level; /* chunk_level */
    uint32_t depth;
    uint64_t node_count;  /* masks */
    uint64_t voxel_count; /* >= 1 */
    const uint8_t *masks;
    const uint8_t *channels[SVO_MAX_CHANNELS]; /* voxel_count * stride bytes; NULL for constant channels */
} svo_chunk;

/* Takes chunks. `encode` may run for several chunks at once; it must not keep pointers into the chunk. `commit` is
 * called for one chunk at a time in ascending code order and consumes the blob, also when it fails. `discard` frees a
 * blob that will not be committed. */
typedef struct svo_chunk_sink {
    void *user;
    svo_result (*encode)(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err);
    svo_result (*commit)(void *user, void *blob, svo_error *err);
    void (*discard)(void *user, void *blob);
} svo_chunk_sink;

/* Gives chunks. `fetch` is called by one thread at a time and replaces *packed by the next chunk's stored bytes, or
 * sets *more to false. `decode` may run for several chunks at once: it checks everything (masks, counts, order inside
 * the chunk) and fills *out, whose pointers go into *storage and live until storage is reused. The ascending order of
 * codes is checked by fetch. */
typedef struct svo_chunk_source {
    void *user;
    svo_result (*fetch)(void *user, svo_buffer *packed, bool *more, svo_error *err);
    svo_result (*decode)(void *user, const svo_buffer *packed, svo_buffer *storage, svo_chunk *out, svo_error *err);
} svo_chunk_source;

/* Check the rules above on one chunk: mask count and structure, voxel count against the masks, code range, channel
 * pointers present. Time is linear in its masks. Adds its node counts of levels level..depth to counts (may be NULL);
 * levels above are the caller's (svo_counts_ancestors). */
svo_result svo_chunk_check(const svo_tree_info *info, const svo_chunk *chunk, svo_tree_counts *counts, svo_error *err);

/* Count the new ancestors (levels 0 .. chunk_level - 1) of a chunk that follows `previous` in order; has_previous
 * false for the first. */
void svo_counts_ancestors(svo_tree_counts *counts, uint32_t chunk_level, bool has_previous, uint64_t previous, uint64_t code);

/* Walk the finest voxels of a chunk in order; x, y, z are grid coordinates in the whole octree, index counts from 0.
 * The chunk must have passed svo_chunk_check. Stops early when fn returns false. */
typedef bool (*svo_voxel_fn)(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index);
void svo_chunk_voxels(const svo_chunk *chunk, svo_voxel_fn fn, void *user);

#ifdef __cplusplus
}
#endif
#endif
