/* A solid from the contraction (Willcocks 2013, section 5.6): every voxel that the surface passes on its way to the curve, and from it a closed surface. */
#ifndef SKEL_SOLID_H
#define SKEL_SOLID_H

#include "skel_build.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Info of the octree: no channels, fill SOLID. The skeleton was built with solid_divide > 0, else SVO_INVALID_ARGUMENT. */
svo_result skel_solid_info(const skel_skeleton *s, svo_tree_info *out, svo_error *err);
/* Give its chunks to a sink, in order; nodes of which all voxels exist are full leaves (but for whole chunks). counts may be NULL. */
svo_result skel_solid_stream(const skel_skeleton *s, const svo_chunk_sink *sink, const svo_allocator *a, svo_tree_counts *counts, svo_error *err);

/* A closed surface: the boundary of the solid, each side of a voxel two triangles, smoothed, and moved onto the model's surface where there is one. */
typedef struct skel_closed {
    const svo_allocator *allocator;
    uint64_t vertex_count, triangle_count;
    double *position;  /* 3 each, the mesh's coordinates */
    uint32_t *corner;  /* 3 each, outward by the right hand; every edge has exactly two triangles, in opposite directions */
    uint8_t *invented; /* of each vertex: 1 where the model has no surface, so that a hole was closed there */
    uint64_t invented_count;
    double distance_mean, distance_max; /* vertices of the model (evenly some of them, where there are many) to the closed surface, the mesh's coordinates */
} skel_closed;
svo_result skel_reconstruct(const svo_mesh *mesh, const skel_skeleton *s, const svo_allocator *a, skel_closed *out, svo_error *err);
void skel_closed_free(skel_closed *c);

#ifdef __cplusplus
}
#endif
#endif
