/* Voxels that follow a skeleton: the bone of a point, and an octree with a channel that holds it for every voxel. */
#ifndef SKEL_BIND_H
#define SKEL_BIND_H

#include "skel_build.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Finds the bone of a point: the surface sample nearest to the point (ties: the one with the lower number) tells the joint, and of that joint's
 * bones the nearest is taken (ties: the lower number). So a point belongs to the part of the model on whose surface it lies, not to a bone that passes
 * nearby. The skeleton (built with keep_samples, else SVO_INVALID_ARGUMENT) is borrowed. Any number of threads may ask at once. */
typedef struct skel_binder skel_binder;
svo_result skel_binder_create(const skel_skeleton *s, const svo_allocator *a, skel_binder **out, svo_error *err);
/* Number of the bone, SVO_NONE where the joint has none. Point in the model's coordinates; *distance (may be NULL) is that to the sample. */
uint32_t skel_binder_bone(const skel_binder *b, const double point[3], double *distance);
void skel_binder_free(skel_binder *b);

/* The info of the bound octree: that of `from` with a last channel "bone" of kind ID16, or ID32 beyond 65535 bones; a channel of that name in
 * `from` is left out. 65535 (4294967295) means no bone. SVO_LIMIT when there are SVO_MAX_CHANNELS others. */
svo_result skel_bind_info(const skel_skeleton *s, const svo_tree_info *from, svo_tree_info *out, svo_error *err);

typedef struct skel_bind_report {
    svo_tree_counts counts;
    uint64_t bones_used, unbound; /* bones that values have; values without a bone */
    double distance_mean, distance_max; /* centre of a value's voxels to the nearest surface sample, in voxels */
} skel_bind_report;

/* Read all chunks of `source` (an octree with `from`) and give them with the bone channel to the sink, on all threads (0). A full leaf has the bone of
 * its centre. The chunks do not depend on threads. report may be NULL. */
svo_result skel_bind_octree(const skel_binder *b, const svo_tree_info *from, const svo_chunk_source *source, const svo_tree_info *info, const svo_chunk_sink *sink,
                            uint32_t threads, const svo_allocator *a, skel_bind_report *report, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
