/* Rays against one packed octree, traversed in place.
 *
 * Grid space: the octree's finest voxels are the cells [x, x+1) of a grid of 2^depth cubed; use the inverse of
 * svo_view.voxel_to_world to get there. t is the ray's own parameter (point = origin + t * direction), so a direction
 * that is transformed but not normalised keeps t in the units of the space it came from.
 *
 * Which voxels a ray meets. For each axis the planes of the grid have the parameters
 *     t_axis(p) = (p - origin) * (1 / direction)                               (double precision, in this order)
 * which rounding keeps in order. A node with its corner at c and edge s is entered at the largest of the three near planes'
 * parameters, left at the smallest of the far planes', and is met for t in [enter, leave): half open, so that every
 * point of a ray lies in exactly one cell, a ray that only touches an edge or a corner of a voxel does not meet it, and a
 * start on the far face is outside. Where a direction component is zero the origin's cell is floor(origin). A ray hits
 * the first voxel whose interval meets [t_min, t_max], at t = max(enter, t_min); no other rounding decides anything, so
 * the traversal finds exactly the voxel that a test of all voxels with the same planes finds. Origins more than 2^40 cells
 * away are first moved to where the ray enters the grid. */
#ifndef SVO_RAYCAST_H
#define SVO_RAYCAST_H

#include "svo_view.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct svo_ray {
    double origin[3], direction[3]; /* grid space; components that are not finite miss everything */
    double t_min, t_max;
    /* Level of detail: the ray stops at the first non-empty node whose edge, in finest voxels, is at most
     * spread * t + offset where the ray enters it (t not below t_min). Both 0: always down to the finest voxels.
     * Ignored for a view whose inner nodes have no attributes. */
    double spread, offset;
} svo_ray;

/* Faces by the direction they look in. */
typedef enum svo_face {
    SVO_FACE_LOW_X = 0, SVO_FACE_HIGH_X = 1, SVO_FACE_LOW_Y = 2, SVO_FACE_HIGH_Y = 3, SVO_FACE_LOW_Z = 4, SVO_FACE_HIGH_Z = 5,
    SVO_FACE_INSIDE = 6 /* the ray begins inside the voxel */
} svo_face;

typedef struct svo_hit {
    double t;
    uint64_t attribute; /* index for svo_view_attribute; of the node itself, see svo_view.h */
    uint32_t cell[3];   /* the node's coordinates on its own level: [0, 2^level) */
    uint8_t level;      /* 0 (root) .. depth */
    uint8_t face;       /* svo_face through which the ray enters; on ties the lowest axis */
    bool hit;           /* nothing else is set when false */
} svo_hit;

/* Nearest hits of `count` rays: hits[i] belongs to rays[i]. Rays are independent; results do not depend on how many are
 * given at once. Any number of threads may use a view at the same time. */
void svo_raycast(const svo_view *view, const svo_ray *rays, uint32_t count, svo_hit *hits);

/* Does the ray hit anything? For shadows: the same answer as svo_raycast's `hit`, without the search for attributes. */
bool svo_ray_blocked(const svo_view *view, const svo_ray *ray);

/* Parameters at which the ray enters and leaves a node by the rule above, not clipped to [t_min, t_max]; for checks of
 * the level-of-detail rule and for tests. False if the node is not met by the ray's line. */
bool svo_ray_node(const svo_view *view, const svo_ray *ray, uint32_t level, const uint32_t cell[3], double *enter, double *leave);

#ifdef __cplusplus
}
#endif
#endif
