/* A sparse voxel octree as a stream of chunks: what the voxelizer produces, .svo files hold, and every builder reads.
 * A whole octree never has to be in memory.
 *
 * The octree has levels 0 (root) to `depth`; its finest voxels are cells of a grid of 2^depth cubed. It is cut at
 * `chunk_level` = max(0, depth - 7): every non-empty node of that level is the root of one chunk, a subtree of at most
 * 128^3 voxels. Chunks come in ascending Morton order. Nodes above the cut follow from the chunks' codes.
 *
 * Solid octrees have full leaves: a node all of whose finest voxels exist and that has one value a channel for all of them. So an octree of a
 * solid grows with its surface. A full leaf is a node of level 1 .. depth - 1, never the root. Inside a chunk its child mask is 0; one
 * that covers a whole chunk or more is an item of the stream of its own (svo_chunk without masks). */
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
    uint64_t chunks;      /* with masks; the voxel of depth 0 is one */
    uint64_t nodes[SVO_MAX_DEPTH + 1]; /* non-empty nodes a level, those inside full leaves too; nodes[depth] are the finest voxels */
    uint64_t full_leaves; /* in chunks, and those that are items of their own */
    uint64_t values;      /* a channel: finest voxels outside full leaves, and one for each full leaf */
} svo_tree_counts;

/* One subtree. Masks are the child masks of its inner nodes (levels chunk_level .. depth - 1) in depth-first
 * preorder, children in octant order; bit i is octant i. The mask of a full leaf is 0; that of the root is not. Values belong to the finest voxels
 * outside full leaves and to the full leaves, in the same depth-first (= Morton) order.
 * Without masks it is one full leaf of a level 1 .. chunk_level (or, with depth == 0, the only voxel), with one value. */
typedef struct svo_chunk {
    uint64_t code;  /* Morton code of its root at `level` */
    uint32_t level; /* chunk_level; less only for a full leaf */
    uint32_t depth;
    uint64_t node_count;  /* masks */
    uint64_t value_count; /* >= 1 */
    const uint8_t *masks;
    const uint8_t *channels[SVO_MAX_CHANNELS]; /* value_count * stride bytes; NULL for constant channels */
} svo_chunk;

/* Codes at chunk_level that an item covers: first <= code < end. Items are ordered by them and never overlap. */
static inline uint64_t svo_chunk_first(const svo_chunk *c) { return c->code << 3 * (svo_chunk_level(c->depth) - c->level); }
static inline uint64_t svo_chunk_end(const svo_chunk *c) { return (c->code + 1) << 3 * (svo_chunk_level(c->depth) - c->level); }
/* Is the item one full leaf? (The voxel of depth 0 is not counted as one.) */
static inline bool svo_chunk_full(const svo_chunk *c) { return c->node_count == 0 && c->depth != 0; }

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

/* Check the rules above on one chunk: mask count and structure, value count against the masks, code range, channel
 * pointers present. Time is linear in its masks. Adds what it holds to counts (may be NULL), but for the levels above its root, which are the
 * caller's (svo_counts_ancestors). */
svo_result svo_chunk_check(const svo_tree_info *info, const svo_chunk *chunk, svo_tree_counts *counts, svo_error *err);

/* Count the new ancestors (levels 0 .. level - 1, level <= chunk_level) of an item that begins at chunk code `first` and follows one
 * that began at `previous`; has_previous false for the first. */
void svo_counts_ancestors(svo_tree_counts *counts, uint32_t chunk_level, uint32_t level, bool has_previous, uint64_t previous, uint64_t first);
void svo_counts_add(svo_tree_counts *to, const svo_tree_counts *more);

/* Walk the values of a chunk in order: finest voxels (size 1) and full leaves (size 2, 4 ..) with their low corners in the whole octree. The
 * chunk must have passed svo_chunk_check. Stops early when fn returns false; then the result is false. */
typedef bool (*svo_value_fn)(void *user, const uint32_t low[3], uint32_t size, uint64_t index);
bool svo_chunk_values(const svo_chunk *chunk, svo_value_fn fn, void *user);

/* Walk the finest voxels of a chunk in order, those of full leaves too; x, y, z are grid coordinates in the whole octree, index is that of
 * the voxel's value. As above; a full leaf can have 8^20 voxels. */
typedef bool (*svo_voxel_fn)(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index);
bool svo_chunk_voxels(const svo_chunk *chunk, svo_voxel_fn fn, void *user);

#ifdef __cplusplus
}
#endif
#endif
