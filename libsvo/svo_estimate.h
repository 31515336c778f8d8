/* How many voxels a mesh will have, before it is voxelized. */
#ifndef SVO_ESTIMATE_H
#define SVO_ESTIMATE_H

#include "svo_mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Sum over all placed, finite triangles of |nx| + |ny| + |nz| times the area, in units of the mesh squared: what a plane meets of the
 * voxels of a grid, so about this over the square of a voxel's edge is the number of voxels of a surface that is smooth at their
 * size. Where surfaces lie closer than a voxel it is too high. Parts outside of memory are read once. */
svo_result svo_estimate_area(const svo_mesh *mesh, uint32_t threads, double *area, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
