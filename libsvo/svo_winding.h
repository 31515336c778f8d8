/* Is a point inside a mesh? Exact where the mesh is closed, by generalised winding numbers where it is not.
 *
 * All of it is about the snapped triangles (svo_bin.h), in lattice units of 1/256 voxel. Triangles are told apart by the edges of
 * the snapped mesh (equal points are one vertex):
 *   oriented   parts whose edges are used equally often in both directions, so that they wind around every point a whole number of times
 *   even       parts whose edges are used an even number of times but cannot be oriented (a Klein bottle): a point is inside
 *              when a ray leaves them an odd number of times
 *   open       all others: their generalised winding number (Jacobson et al. 2013) is evaluated hierarchically (Barill et al. 2018)
 * Faces that look the other way than the rest of their part (joined across edges of two faces) are turned first; a mesh
 * with open parts that encloses a clearly negative volume is turned as a whole.
 * With W the sum of the winding numbers of oriented and open parts a point is inside when W > 1/2, or W < -1/2 where the oriented parts alone
 * are negative (they are inside out), or when it is inside of an even part. So overlapping solids unite, and a cavity is a
 * surface that looks inwards. */
#ifndef SVO_WINDING_H
#define SVO_WINDING_H

#include "svo_bin.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct svo_winding svo_winding;

typedef struct svo_winding_report {
    uint64_t oriented, even, open; /* triangles */
    uint64_t turned;               /* of them, against the orientation they came with */
    uint64_t boundary_edges;       /* of open parts */
    double seconds;
} svo_winding_report;

/* Memory: about 20 bytes a triangle, 45 more while building, 50 more again where not all edges are balanced. bins and placement must outlive
 * the result, which does not depend on threads. */
svo_result svo_winding_create(const svo_bins *bins, const svo_placement *placement, const svo_grid *grid, uint32_t threads, const svo_allocator *a,
                              svo_winding **out, svo_winding_report *report, svo_error *err);
void svo_winding_free(svo_winding *w);

/* Are there no open parts? Then svo_winding_inside is the same for all points of a connected space that the surface does not pass. */
bool svo_winding_closed(const svo_winding *w);

/* Is the point (even lattice coordinates, not on the surface) inside? *margin receives how far the winding number is from where that would
 * change (at least 1/2 where the mesh is closed). Any thread. */
bool svo_winding_inside(const svo_winding *w, const int32_t p[3], double *margin);

/* What the margin can change by at most between two points of the box low..high that the surface does not separate; INFINITY near the
 * boundary of an open part. */
double svo_winding_change(const svo_winding *w, const int32_t low[3], const int32_t high[3]);

/* Approximation of hierarchical winding numbers that svo_winding_inside does not count as margin: stay away from it by this much. */
#define SVO_WINDING_ERROR 0.004

/* Triangle nearest to p (ties: the smaller number) and the barycentric coordinates of its nearest point; false when there are none. *triangle
 * may name one that is likely to be near, which saves time and changes nothing; else UINT32_MAX. */
bool svo_winding_nearest(const svo_winding *w, const int32_t p[3], uint32_t *triangle, double barycentric[3]);

#ifdef __cplusplus
}
#endif
#endif
