/* Inside libskel and for svo-skeleton: a mesh as one list of triangles, and work that is done on it before the skeleton is built. */
#ifndef SKELI_PREPARE_H
#define SKELI_PREPARE_H

#include "skel_build.h"

#ifdef __cplusplus
extern "C" {
#endif

/* All instances as one list of points and triangles in world coordinates, in the order the map of a skeleton is defined by. */
typedef struct skeli_flat { double *position; uint32_t *corner; uint64_t points, triangles; } skeli_flat;
svo_result skeli_flat_make(const svo_mesh *mesh, const svo_allocator *a, skeli_flat *out, svo_error *err);
void skeli_flat_free(skeli_flat *f, const svo_allocator *a);

/* A copy of a mesh that others may change before its skeleton is built; the mesh itself stays as it is. `mesh` has one shape of one part, placed once. Its
 * first `places` points are those of the given mesh, as its instances place them, that have a finite triangle: one for each place, sorted by x, y, z. */
typedef struct skeli_prepared {
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
} skeli_prepared;

/* *out borrows nothing. Free it by skeli_prepared_free, also after a failure. It must not be moved. SVO_INVALID_DATA when no triangle is finite. */
svo_result skeli_prepare(const svo_mesh *mesh, const svo_allocator *a, skeli_prepared *out, svo_error *err);
void skeli_prepared_free(skeli_prepared *p);
/* Take new arrays (of the allocator; from then on p's): the first `places` points are those of before. */
void skeli_prepared_replace(skeli_prepared *p, double *position, uint64_t points, uint32_t *corner, uint64_t triangles);
/* The size of the model as skel_build_mesh will find it. */
svo_result skeli_prepared_unit(const skeli_prepared *p, skel_normalize how, double *unit, svo_error *err);
/* After skel_build_mesh of p->mesh: give the map the elements of the given mesh, and the report its counts. */
svo_result skeli_prepared_map(const skeli_prepared *p, skel_skeleton *s, svo_error *err);

/* --- other people's code: adapters/, in a library of its own (svorepair), which svo-skeleton alone links ----------------------------------------- */

/* CGAL's Polygon_mesh_processing: triangles that are a line or there twice go, neighbours are turned to look the same way, and edges and vertices where the
 * surface is no manifold are cut apart. (Points at one place are one already.) */
typedef struct skeli_repair_report {
    uint64_t points_unused, triangles_degenerate, triangles_duplicate, triangles_turned;
    uint64_t edges_nonmanifold, vertices_nonmanifold, points_added;
    bool manifold; /* afterwards */
    double seconds;
} skeli_repair_report;
/* memory: bytes that may be taken, 0 = no limit (SVO_LIMIT when an estimate says that it will be more). SVO_UNSUPPORTED where the build has no CGAL. */
svo_result skeli_repair_cgal(skeli_prepared *p, uint64_t memory, skeli_repair_report *out, svo_error *err);
bool skeli_have_cgal(void);

/* OpenMesh: every edge of `length` and longer is split at its middle, the longest first. Triangles that its meshes refuse (at edges of three triangles) are split apart
 * from the others; since middles depend on nothing but the ends of their edge, they fit. */
typedef struct skeli_split_report {
    uint64_t triangles_apart; /* refused, and so given points of their own */
    uint64_t splits;
    double seconds;
} skeli_split_report;
/* SVO_LIMIT when there would be more than max_points. memory and SVO_UNSUPPORTED as above. */
svo_result skeli_split_openmesh(skeli_prepared *p, double length, uint64_t max_points, uint64_t memory, skeli_split_report *out, svo_error *err);
bool skeli_have_openmesh(void);

#ifdef __cplusplus
}
#endif
#endif
