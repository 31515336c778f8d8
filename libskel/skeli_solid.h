/* Inside libskel: the voxels that the surface passes while it is contracted. */
#ifndef SKELI_SOLID_H
#define SKELI_SOLID_H

#include "skeli_surface.h"

enum { SKELI_SOLID_SEEN = 1 << 16 };

typedef struct skeli_solid {
    const svo_allocator *allocator;
    const skeli_soup *mesh;
    double edge;     /* of a voxel, lattice steps */
    uint32_t depth;  /* of the octree; the middle of its grid is the lattice's origin */
    float *last;     /* 3 a vertex: where it was when the surface was last drawn */
    uint8_t *moves;  /* scratch of a drawing, one a vertex */
    uint64_t *seen;  /* hashes of ways drawn lately */
    double moved;    /* largest sum of movements since */
    uint64_t *slot;  /* codes, UINT64_MAX = empty; open addressing */
    uint64_t capacity, count;
} skeli_solid;

svo_result skeli_solid_begin(const svo_allocator *a, const skeli_soup *mesh, double omega, uint32_t divide, skeli_solid *out, svo_error *err);
/* Before the first sweep, and after each: `movement` of the sweep at most, in lattice steps. Draws only when enough has moved, or `all`. */
svo_result skeli_solid_step(skeli_solid *s, const skeli_state *state, double movement, bool all, svo_error *err);
/* Add what is inside by winding number and joined to what was passed (where the model has holes, the surface does not pass everything), and move the sorted codes
 * into out->solid. */
svo_result skeli_solid_end(skeli_solid *s, const skeli_surface *surface, skel_skeleton *out, svo_error *err);
struct skel_closed;
svo_result skeli_reconstruct(const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles, const skel_skeleton *k, const svo_allocator *a,
                             struct skel_closed *out, svo_error *err);
void skeli_solid_free(skeli_solid *s);

#endif
