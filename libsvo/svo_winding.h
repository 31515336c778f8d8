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
#include "svo_pager.h"

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

/* Where to put what does not fit in memory. */
typedef struct svo_winding_paging {
    svo_pager *pager;
    uint64_t run_bytes; /* memory that sorting may take at a time while building */
} svo_winding_paging;

/* Memory: about 52 bytes a triangle, 16 more while building, 160 more again while building where not all edges are balanced. With paging (NULL: without) about as
 * many bytes of temporary files instead, run_bytes while building, and what the pager keeps resident; parts of the placement may lie outside of memory
 * (svo_part.soup) then, and the pager must outlive the result. The result depends neither on threads nor on paging, nor on the order of the triangles but for their
 * numbers and for coincident ones. placement need not outlive it. SVO_LIMIT for 2^32 - 1 triangles and more. */
svo_result svo_winding_create(const svo_placement *placement, const svo_grid *grid, uint32_t threads, const svo_allocator *a, const svo_winding_paging *paging,
                              svo_winding **out, svo_winding_report *report, svo_error *err);
void svo_winding_free(svo_winding *w);

/* Are there no open parts? Then svo_winding_inside is the same for all points of a connected space that the surface does not pass. */
bool svo_winding_closed(const svo_winding *w);

/* Is the point (even lattice coordinates, not on the surface) inside? *margin receives how far the winding number is from where that would
 * change (at least 1/2 where the mesh is closed). Any thread. */
bool svo_winding_inside(const svo_winding *w, const int32_t p[3], double *margin);

/* The same for up to SVO_WINDING_MANY points that are near each other, several times as fast; numbers may differ from those of single questions by what
 * SVO_WINDING_ERROR allows. They depend on which points are asked together. */
enum { SVO_WINDING_MANY = 64 };
void svo_winding_inside_many(const svo_winding *w, const int32_t (*p)[3], uint32_t count, bool *inside, double *margin);

/* What the margin can change by at most between two points of the box low..high that the surface does not separate; INFINITY near the
 * boundary of an open part. */
double svo_winding_change(const svo_winding *w, const int32_t low[3], const int32_t high[3]);

/* Approximation of hierarchical winding numbers that svo_winding_inside does not count as margin: stay away from it by this much. */
#define SVO_WINDING_ERROR 0.004

/* A triangle: its number in the placement (UINT32_MAX: none), and where svo_winding has it. */
typedef struct svo_winding_hit {
    uint32_t triangle, part;
    uint64_t at;
} svo_winding_hit;

/* Triangle nearest to p (of equally near ones the first in an order by their places), and the barycentric coordinates of its nearest point on the corners at *hit as they are
 * in the placement, whichever way it was turned; false when there are none. *hit may be an earlier answer that is likely to be near, which saves time and changes
 * nothing; else its triangle is UINT32_MAX. */
bool svo_winding_nearest(const svo_winding *w, const int32_t p[3], svo_winding_hit *hit, double barycentric[3]);

#ifdef __cplusplus
}
#endif
#endif
