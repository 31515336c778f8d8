/* Segmentation (Willcocks 2013, section 5.6): the surface in parts, one for each branch of the curve. */
#ifndef SKEL_SEGMENT_H
#define SKEL_SEGMENT_H

#include "skel_build.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct skel_segment {
    uint32_t first, last; /* the joints that its chain of bones begins and ends at; equal for a loop of its own and for a joint without bones */
    uint32_t bones;
    uint64_t triangles;
    double area;          /* in the model's coordinates, squared */
    uint32_t pieces;      /* connected over edges (by the places of their ends); 0 where no triangle is its own */
    uint32_t color;       /* 0xRRGGBB; segments that share an edge or a joint have different ones */
} skel_segment;

/* Triangles and vertices in the order of the skeleton's map (skel_build.h). */
typedef struct skel_segments {
    const svo_allocator *allocator;
    uint32_t count, color_count;
    skel_segment *segment;
    uint64_t vertex_count, triangle_count;
    double *position;  /* 3 each, as placed */
    uint32_t *corner;  /* 3 each */
    uint32_t *segment_of; /* of each triangle; SVO_NONE with a corner that the skeleton dropped */
    uint32_t *bone_of;    /* of each triangle; SVO_NONE also at a joint without bones */
    uint64_t islands;  /* pieces that were given to the segment around them */
} skel_segments;

/* Segments are the chains of bones between ends and branches, in order of their lowest bones, then joints without bones. A triangle goes to the nearest of the
 * bones of its corners' joints (from its centroid). Then every piece of a segment that is not its largest goes to the segment that it has the longest
 * border with, if it touches one: so a segment has more than one piece only where the model's surface is in parts. mesh: the one the skeleton was built from
 * (SVO_INVALID_ARGUMENT where the skeleton was not built from a mesh of as many vertices). SVO_OUT_OF_MEMORY. *out is freed by skel_segments_free. One thread; about
 * linear time. */
svo_result skel_segments_make(const svo_mesh *mesh, const skel_skeleton *s, const svo_allocator *a, skel_segments *out, svo_error *err);
void skel_segments_free(skel_segments *s);

#ifdef __cplusplus
}
#endif
#endif
