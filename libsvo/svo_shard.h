/* Cutting one voxelization into shards: ranges of chunks of nearly equal work. */
#ifndef SVO_SHARD_H
#define SVO_SHARD_H

#include "svo_voxelize.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_MAX_SHARDS 100000u

typedef struct svo_shard {
    uint32_t index, count;      /* index 1..count */
    uint64_t first_code, end_code; /* chunks with first_code <= code < end_code; may be none */
    double share;               /* of the estimated work, 0..1 */
} svo_shard;

/* The range of shard `index` of `count`: 1 <= index <= count <= SVO_MAX_SHARDS, else SVO_INVALID_ARGUMENT. It depends on the mesh, the
 * info, the index and the count alone, not on threads or memory, so every shard of a job finds the same plan for itself; the
 * ranges of a plan follow each other without gaps and cover all codes. Work is estimated as the area of the triangles clipped to nodes of one
 * level, measured in voxels that a plane of that slope meets, and a constant for each triangle in a node. No cut of these nodes into ranges has a smaller
 * largest share. A chunk is never cut, so the largest one bounds the balance; no shard is empty while there are as many chunks that triangles meet. Meshes outside of
 * memory are read once or a few times for it; they can be cut into 1024 shards (more, or fewer where a mesh fills next to nothing of its grid: SVO_LIMIT). */
svo_result svo_shard_plan(const svo_mesh *mesh, const svo_voxelize_options *options, const svo_tree_info *info, uint32_t index,
                          uint32_t count, svo_shard *out, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
