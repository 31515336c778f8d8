/* Other people's code for meshes before their skeleton is built: CGAL's repair of polygon soups, OpenMesh's subdivision. A library of its own (svorepair), which
 * svo-skeleton alone links, and which is not installed: CGAL's part is GPL. */
#ifndef SKEL_REPAIR_H
#define SKEL_REPAIR_H

#include "skel_prepare.h"

#ifdef __cplusplus
extern "C" {
#endif

/* CGAL's Polygon_mesh_processing: triangles that are a line or there twice go, neighbours are turned to look the same way, and edges and vertices where the
 * surface is no manifold are cut apart. (Points at one place are one already.) */
typedef struct skel_repair_report {
    uint64_t points_unused, triangles_degenerate, triangles_duplicate, triangles_turned;
    uint64_t edges_nonmanifold, vertices_nonmanifold, points_added;
    bool manifold; /* afterwards */
    double seconds;
} skel_repair_report;
/* memory: bytes that may be taken, 0 = no limit (SVO_LIMIT when an estimate says that it will be more). SVO_UNSUPPORTED where the build has no CGAL. */
svo_result skel_repair_cgal(skel_prepared *p, uint64_t memory, skel_repair_report *out, svo_error *err);
bool skel_have_cgal(void);

/* OpenMesh: every edge of `length` and longer is split at its middle, the longest first. Triangles that its meshes refuse (at edges of three triangles) are split apart
 * from the others; since middles depend on nothing but the ends of their edge, they fit. */
typedef struct skel_split_report {
    uint64_t triangles_apart; /* refused, and so given points of their own */
    uint64_t splits;
    double seconds;
} skel_split_report;
/* SVO_LIMIT when there would be more than max_points. memory and SVO_UNSUPPORTED as above. */
svo_result skel_split_openmesh(skel_prepared *p, double length, uint64_t max_points, uint64_t memory, skel_split_report *out, svo_error *err);
bool skel_have_openmesh(void);

#ifdef __cplusplus
}
#endif
#endif
