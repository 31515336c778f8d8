/* A mesh as one list of triangles, and a copy of it for work that is done on it before the skeleton is built (skel_repair.h). */
#ifndef SKEL_PREPARE_H
#define SKEL_PREPARE_H

#include "skel_build.h"

#ifdef __cplusplus
extern "C" {
#endif

/* All instances as one list of points and triangles in world coordinates, in the order the map of a skeleton is defined by. position: 3 a point; corner: 3 a triangle.
 * Free by skel_flat_free with the same allocator, also after a failure. SVO_INVALID_DATA without triangles, SVO_LIMIT beyond 2^31 of either, SVO_OUT_OF_MEMORY. */
typedef struct skel_flat { double *position; uint32_t *corner; uint64_t points, triangles; } skel_flat;
svo_result skel_flat_make(const svo_mesh *mesh, const svo_allocator *a, skel_flat *out, svo_error *err);
void skel_flat_free(skel_flat *f, const svo_allocator *a);

/* A copy of a mesh that others may change before its skeleton is built; the mesh itself stays as it is. `mesh` has one shape of one part, placed once. Its
 * first `places` points are those of the given mesh, as its instances place them, that have a finite triangle: one for each place, sorted by x, y, z. */
typedef struct skel_prepared {
    const svo_allocator *allocator;
    svo_mesh mesh;
    svo_shape shape;
    svo_part part;
    svo_instance instance;
    uint64_t points, triangles; /* what the part's arrays were allocated for */
    uint64_t given;             /* points of the given mesh: length of its map */
    uint32_t *same;             /* of each: where it went, SVO_NONE where it has no finite triangle */
    uint64_t places, merged;    /* merged: given points less places, of those that have a triangle */
    uint64_t points_not_finite, not_finite; /* points, triangles that were left out */
} skel_prepared;

/* *out borrows nothing. Free it by skel_prepared_free, also after a failure. It must not be moved. SVO_INVALID_DATA when no triangle is finite,
 * SVO_LIMIT and SVO_OUT_OF_MEMORY as skel_flat_make. */
svo_result skel_prepare(const svo_mesh *mesh, const svo_allocator *a, skel_prepared *out, svo_error *err);
void skel_prepared_free(skel_prepared *p);
/* Take new arrays (of the allocator; from then on p's): the first `places` points are those of before. */
void skel_prepared_replace(skel_prepared *p, double *position, uint64_t points, uint32_t *corner, uint64_t triangles);
/* The size of the model as skel_build_mesh will find it: what omega is a part of, in units of the mesh. */
svo_result skel_prepared_unit(const skel_prepared *p, skel_normalize how, double *unit, svo_error *err);
/* After skel_build_mesh of p->mesh: give the map the elements of the given mesh, and the report its counts. SVO_OUT_OF_MEMORY: s is as it was. */
svo_result skel_prepared_map(const skel_prepared *p, skel_skeleton *s, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
