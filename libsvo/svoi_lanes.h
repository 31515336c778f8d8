/* Many voxels of one triangle at a time: from the places of voxels to the values of the triangle's part in each, and from there to
 * sums or bytes. Loops without branches over arrays, which compilers turn into vector code; what cannot be done so (textures) goes one
 * by one. A voxel's result depends on the triangle and the voxel alone, not on what else is in the batch. */
#ifndef SVOI_LANES_H
#define SVOI_LANES_H

#include "svo_shade.h"
#include "svo_texture.h"

enum { SVOI_LANES = SVOI_CLIP_BATCH };

/* Voxels that wait to be a batch. */
enum { SVOI_WAITING = 2 * SVOI_LANES + 16 }; /* some are written behind the last one */
typedef struct svoi_wait { uint32_t count, code[SVOI_WAITING], target[SVOI_WAITING]; } svoi_wait;

/* How a footprint in a texture is read: level, counts of readings, and steps between them in texels of the level. */
typedef struct svoi_tap_plan { uint32_t level, along, across; float step[2], side[2]; } svoi_tap_plan;

/* Voxels that no edge of the triangle reaches: what the plane leaves of the column depends on its height over the voxel's centre alone. So
 * centroids come from a table by that height (and those below the centre from their mirror images), and so do the ways to read textures. Values
 * are linear functions of the place, at + dx * per_x + dy * per_y from a base in the block. */
enum { SVOI_INNER_STEPS = 16, SVOI_INNER_ROWS = 32 }; /* rows that vector code reads */
typedef struct svoi_inner_texture {
    float at[2], per_x[2], per_y[2]; /* texel coordinates of the image */
    uint8_t shape[SVOI_INNER_STEPS + 1];             /* by step: the first step with the same triple */
    uint32_t alike[SVOI_INNER_STEPS + 1];            /* of such a first step: a bit for each step with its shape */
    svoi_tap_plan plan[SVOI_INNER_STEPS + 1];
    /* of the plans, by step: from the middle back to the first reading, how far readings reach from the middle, and steps */
    float back_x[SVOI_INNER_ROWS], back_y[SVOI_INNER_ROWS], reach_x[SVOI_INNER_ROWS], reach_y[SVOI_INNER_ROWS];
    float step_x[SVOI_INNER_ROWS], step_y[SVOI_INNER_ROWS], side_x[SVOI_INNER_ROWS], side_y[SVOI_INNER_ROWS];
    float row[SVOI_INNER_STEPS + 2][8];                                 /* the same, a step a row: back, step, side (x and y each), and 0; the last row is 0 */
    float most_x[SVOI_INNER_STEPS + 1], most_y[SVOI_INNER_STEPS + 1];   /* of a first step: how far readings of the steps with its shape reach at most */
} svoi_inner_texture;

/* Inner voxels that are read with one shape, a bit each: all readings inside the level, all less than a period away, others. */
typedef struct svoi_sorted_lanes { uint64_t inside, near, far; } svoi_sorted_lanes;
typedef struct svoi_inner {
    uint32_t steps;                                  /* rows of the table: 1 where the plane is level */
    float from, per_height;                          /* height at which something is cut away; rows by height */
    float x[SVOI_INNER_ROWS], y[SVOI_INNER_ROWS];    /* centroid from the voxel's centre */
    float xx[SVOI_INNER_STEPS + 1], xy[SVOI_INNER_STEPS + 1], yy[SVOI_INNER_STEPS + 1]; /* covariances */
    float base[2];
    float normal[3][3], color[3][3];                 /* component; at, per_x, per_y */
    svoi_inner_texture texture[4];
} svoi_inner;

typedef struct svoi_lanes {
    uint32_t count;
    uint32_t code[SVOI_WAITING];   /* local Morton codes; more than a batch of them may wait */
    uint32_t target[SVOI_WAITING]; /* number among the voxels that are averaged now, or among all */
    svoi_clip_batch clip;
    float b[3][SVOI_LANES];      /* barycentric coordinates of the centroids */
    float color[4][SVOI_LANES], normal[3][SVOI_LANES], emissive[3][SVOI_LANES], metallic[SVOI_LANES], roughness[SVOI_LANES], coverage[SVOI_LANES]; /* 0..1; normals unit */
    double at[2][SVOI_LANES];    /* texel coordinates, while a texture is read */
    int32_t integer[3][SVOI_LANES];
    bool one_normal;                                  /* all normals are the first */
    float offset_x[SVOI_LANES], offset_y[SVOI_LANES]; /* of inner voxels: from the base */
    uint8_t step[SVOI_LANES];                         /* of inner voxels: row of the table */
} svoi_lanes;

/* Areas (when `areas`), centroids and, when the facet needs them, moments; then the values of every channel of the layout. */
void svoi_lanes_values(const svo_shader *s, svo_facet *t, svoi_lanes *l);
/* Averages of a texture over the pieces, at texel coordinates l->at; nearest-texel images and coordinates beyond 1e9 are not for it. */
void svoi_read_footprints(const svo_facet_texture *f, const svo_texture *how, const svo_pyramid *p, const svoi_lanes *l, float (*out)[SVOI_LANES]);
/* Bilinear readings of the image itself, of opaque colours, at texel coordinates l->at (the image's corner: 0). */
void svoi_read_points(const svo_texture *how, const svo_pyramid *p, svoi_lanes *l, float (*out)[SVOI_LANES]);
/* The table of a facet. False: it is not worth one, or has something that only the general way can do; then no voxel is an inner one. */
bool svoi_inner_make(const svo_shader *s, svo_facet *t, svoi_inner *out);
/* Which voxels does no edge reach? 1 or 0 each. */
void svoi_inner_find(const svo_facet *t, svoi_lanes *l, uint8_t inner[SVOI_LANES]);
/* The same for all voxels of a brick at once: true only where svoi_inner_find says so of each of the 64. `reach` is the facet's. */
void svoi_inner_bricks(const svo_facet *t, float reach[3]);
bool svoi_inner_brick(const svo_facet *t, const float reach[3], uint32_t brick);
/* What svoi_lanes_values says, for inner voxels. */
void svoi_inner_values(const svo_shader *s, svo_facet *t, const svoi_inner *inner, svoi_lanes *l);
void svoi_inner_plan(const svo_facet_texture *f, const svo_pyramid *p, const svoi_inner *inner, svoi_inner_texture *out);
/* Averages of a texture over inner voxels, at the lanes' offsets and steps: three components (alpha is of materials that have no inner voxels). */
void svoi_inner_read(const svoi_inner_texture *f, const svo_texture *how, const svo_pyramid *p, const svoi_lanes *l, float (*out)[SVOI_LANES]);
/* The normal of the face, and that of all corners where the facet is not smooth. */
void svoi_plain_normals(const svo_facet *t, float face[3], float corners[3]);
/* Codes to places. */
void svoi_lanes_place(const svo_facet *t, svoi_lanes *l);
/* Areas alone. */
void svoi_lanes_areas(const svo_facet *t, svoi_lanes *l);
/* Add to sums[target * layout->fields]: the values with their areas, or one contribution with the areas of all. */
void svoi_lanes_add(const svo_shader *s, const svo_facet *t, svoi_lanes *l, uint32_t shift, uint64_t *sums);
void svoi_lanes_add_flat(const svo_shade_layout *layout, const svo_contribution *c, const svoi_lanes *l, uint32_t shift, uint64_t *sums);
void svoi_lanes_add_areas(const svoi_lanes *l, uint32_t shift, uint64_t *sums); /* sums[target] */
/* To bytes, at channels[c] + target * stride, of the channels that have a pointer (not: the material). */
void svoi_lanes_write(const svo_shade_layout *layout, svoi_lanes *l, uint8_t *const channels[SVO_MAX_CHANNELS]);
typedef struct svoi_values { uint8_t of[SVO_MAX_CHANNELS][SVO_MAX_STRIDE]; } svoi_values;
void svoi_flat_values(const svo_shade_layout *layout, const svo_contribution *c, svoi_values *out); /* of a voxel that has this contribution alone */
void svoi_lanes_write_flat(const svo_shade_layout *layout, const svoi_values *v, const svoi_lanes *l, uint8_t *const channels[SVO_MAX_CHANNELS]);
/* To the values with the numbers first .. first + count - 1. */
void svoi_write_run(const svo_shade_layout *layout, const svoi_values *v, uint32_t first, uint32_t count, uint8_t *const channels[SVO_MAX_CHANNELS]);
/* The same for averages: sums of `count` voxels in order, to the values with the numbers in index. */
void svoi_sums_write(const svo_shade_layout *layout, svoi_lanes *scratch, const uint64_t *sums, const uint32_t *index, uint32_t count,
                     uint8_t *const channels[SVO_MAX_CHANNELS]);

#endif
