/* The part of a triangle inside each of many voxels: area, centroid and second moments, without building polygons.
 *
 * Seen along the dominant axis of its normal, the part of a triangle in a voxel is what 3 edges, 4 sides of the column and the
 * 2 lines where the plane passes the voxel's floor and ceiling leave. Each of these 9 lines is cut by the others to a segment, and Green's
 * theorem sums the segments. There are no branches, so voxels are done as many at a time as the machine has lanes. Single precision,
 * relative to the voxel's centre: areas are right to about 1e-4 of a voxel face. A result depends on the triangle, the voxel and
 * the frame of the corners alone, not on what else is in the batch. */
#ifndef SVOI_CLIP_H
#define SVOI_CLIP_H

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVOI_CLIP_BATCH 64

typedef struct svoi_clip_edge {
    float q[2], d[2];   /* a point of the line (the nearest to the frame's origin) and its unit direction */
    float begin, end;   /* of the edge along d */
    float a[2];         /* inward unit normal */
    float slope;        /* of the plane along d */
    float offset;       /* a . x + offset >= 0 inside */
} svoi_clip_edge;

/* Where lines of slope m cut others, for all voxels of a triangle. Of what is parallel, far away. */
typedef struct svoi_clip_slab { float inverse, half; } svoi_clip_slab; /* -1 / m, 1 / |2 m| */
typedef struct svoi_clip_half { float low, high; } svoi_clip_half; /* -1 / m where it is a lower (an upper) bound; the other one is not a number, and bounds nothing */
typedef struct svoi_clip_lines {
    svoi_clip_half along_x[3], along_y[3], along_level[3]; /* edges that cut sides and lines of constant height */
    svoi_clip_slab height_x, height_y;                     /* heights along the sides */
    svoi_clip_slab level_x, level_y;                       /* sides that cut lines of constant height */
    float dx, dy, step, reach;                             /* direction of those lines, gradient / |gradient|^2 to the next, half their length */
    svoi_clip_slab edge_x[3], edge_y[3], edge_z[3];
} svoi_clip_lines;

/* A triangle ready to be clipped: x, y, z are the axes (axis + 1) % 3, (axis + 2) % 3 and axis. */
typedef struct svoi_clipper {
    uint32_t axis;
    svoi_clip_edge edge[3];
    float gradient[2], height; /* z = gradient . (x, y) + height */
    float per_area;            /* area on the surface of a unit of (x, y) */
    svoi_clip_lines lines;
} svoi_clipper;

/* Corners in voxels in some frame within 256 voxels of every cell. False where the triangle has no area to speak of. */
bool svoi_clipper_make(svoi_clipper *c, const double corner[3][3]);

/* Integer coordinates of voxels in the frame of the corners, by axis of the clipper (x, y, z), and the results. */
typedef struct svoi_clip_batch {
    float x[SVOI_CLIP_BATCH], y[SVOI_CLIP_BATCH], z[SVOI_CLIP_BATCH];
    float area[SVOI_CLIP_BATCH];                     /* on the surface, in voxel faces; 0 where the triangle misses */
    float cx[SVOI_CLIP_BATCH], cy[SVOI_CLIP_BATCH];   /* centroid in (x, y); the voxel's centre where the area is 0 */
    float xx[SVOI_CLIP_BATCH], xy[SVOI_CLIP_BATCH], yy[SVOI_CLIP_BATCH]; /* covariance in (x, y), when asked for */
} svoi_clip_batch;

/* Entries 0 .. count - 1; the input of the rest, up to a multiple of 16, is overwritten. */
void svoi_clip(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, bool moments);
/* The areas alone, the same to the bit. */
void svoi_clip_areas(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count);

/* The two are one of these, by what the processor can. The same to the bit. */
typedef enum svoi_clip_parts { SVOI_CLIP_AREAS, SVOI_CLIP_CENTRES, SVOI_CLIP_MOMENTS } svoi_clip_parts; /* what is found, each with what is before it */
bool svoi_clip_has_wide(void);
void svoi_clip_hold_back(bool held); /* say that it is not there, in tests: while no other thread runs */
void svoi_clip_wide(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, svoi_clip_parts want); /* only where it is there */
void svoi_clip_narrow(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, svoi_clip_parts want);

#ifdef __cplusplus
}
#endif
#endif
