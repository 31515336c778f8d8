/* How far the attributes of some voxels are from what dense samples of the surface inside them give. The reference shares nothing with
 * the way the attributes are made but the reading of the finest level of a texture: pieces are cut as polygons in double precision, and
 * each point on them is evaluated on its own. */
#ifndef SVOI_REFERENCE_H
#define SVOI_REFERENCE_H

#include "svo_bin.h"
#include "svo_stream.h"
#include "svo_voxelize.h"

enum { SVOI_REFERENCE_TRIANGLES = 4096 }; /* voxels that more triangles meet are left out */

/* A voxel that is looked at closely. */
typedef struct svoi_sample {
    uint64_t order;             /* a hash of its code: the smallest are kept */
    uint64_t code;              /* Morton, in the grid */
    uint64_t first;             /* its triangles: [first, first + count) of the list beside the samples */
    uint32_t count;
    uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE]; /* of channels that are not constant */
} svoi_sample;

/* Errors of the voxels' values, a channel each, in out[info->channel_count]. Deterministic for any number of threads. */
svo_result svoi_reference_measure(const svo_placement *p, const svo_grid *g, const svo_tree_info *info, const svoi_sample *samples, uint64_t count,
                                  const uint32_t *triangles, uint32_t threads, const svo_allocator *a, svo_channel_error *out, uint64_t *measured,
                                  svo_error *err);

#endif
