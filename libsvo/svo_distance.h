/* Distance from a point to a triangle, and the measured distance of voxel centres from the surface that marked them. */
#ifndef SVO_DISTANCE_H
#define SVO_DISTANCE_H

#include "svo_bin.h"
#include "svo_block.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Distance of p from the closed triangle; segments and points are fine. */
double svo_point_triangle(const double p[3], const double corner[3][3]);

typedef struct svo_distances {
    uint64_t count;
    double sum, most;
} svo_distances;

/* Every marked voxel of `samples` cubes of 16^3 in the block (spread from `choice` over those that are not empty): distance of its
 * centre from the nearest of the triangles in the list that meet the voxel, before the snap, in voxels. `corner` is the
 * block's low corner in voxels, `block_size` its edge. */
void svo_block_distances(const svo_block *block, const svo_bins *bins, const svo_placement *placement, const svo_grid *grid,
                         const uint32_t *list, uint64_t count, const int32_t corner[3], int32_t block_size, uint64_t choice,
                         uint32_t samples, svo_distances *out);

#ifdef __cplusplus
}
#endif
#endif
