/* Attributes of voxels: what each triangle contributes to each voxel that it meets, and their averages.
 *
 * A contribution is taken over the part of the triangle inside the voxel: its area is the weight, its centroid is where vertex
 * values are read, and textures are averaged over it. Positions are those before the snap. Sums are 64-bit integers, so that
 * the result does not depend on the order of triangles. */
#ifndef SVO_SHADE_H
#define SVO_SHADE_H

#include "svo_bin.h"
#include "svoi_clip.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Which channels an info asks for, where in it (SVO_MAX_CHANNELS: not there or constant), and where their sums are. */
typedef struct svo_shade_layout {
    uint32_t color, normal, emissive, metallic, roughness, material, coverage; /* channel numbers */
    uint32_t fields; /* 64-bit sums a voxel */
    uint32_t sum_weight, sum_color, sum_normal, sum_emissive, sum_metallic, sum_roughness, sum_coverage;
} svo_shade_layout;

/* Shared by all workers, read-only after creation. */
typedef struct svo_shader svo_shader;
svo_result svo_shader_create(const svo_placement *p, const svo_grid *g, const svo_tree_info *info, uint32_t threads,
                             const svo_allocator *a, svo_shader **out, svo_error *err);
/* Mean another placement from now on, of a mesh with the same materials and images. */
svo_result svo_shader_rebind(svo_shader *s, const svo_placement *p, svo_error *err);
/* Use up to so many bytes to make readings of textures quicker, of those that are read much. The results are the same. */
void svo_shader_expand(svo_shader *s, uint64_t bytes, uint32_t threads);
void svo_shader_free(svo_shader *s);
const svo_shade_layout *svo_shader_layout(const svo_shader *s);

/* A texture's coordinates over a facet, in texels of the image: at + x * per_x + y * per_y, where x and y are offsets from
 * corner 0 along the axes after `axis`. */
typedef struct svo_facet_texture {
    double corner[3][2];
    double per_x[2], per_y[2];
    bool ready;
} svo_facet_texture;

/* A triangle ready to be clipped: corners in voxels relative to a block's corner. */
typedef struct svo_facet {
    double corner[3][3];
    double normal[3];   /* of the corners above, not unit */
    double face[3];     /* unit normal */
    double length;      /* of normal = twice the area in voxels */
    svoi_clipper clipper;
    bool clips;         /* clipper is usable */
    bool inside;        /* lies in one voxel altogether */
    uint32_t axis;      /* dominant axis of normal */
    double per_x[2], per_y[2]; /* barycentric coordinates 1 and 2 by offset from corner 0 */
    double corner_normal[3][3]; /* vertex normals in the world, with a common scale; of the face where there are none */
    bool smooth;                /* corner_normal may differ */
    bool mirrored;              /* the transform turns triangles inside out */
    svo_facet_texture texture[4]; /* filled when first read; by use */
    const svo_part *part;
    uint32_t vertex[3];
    uint32_t instance;
    uint32_t material; /* SVO_NONE: default */
    bool flat;         /* every point of it has the same values */
    bool masks;        /* alpha MASK with something to test */
} svo_facet;

/* `block` is the low corner of the block, in voxels; q the snapped corners relative to it. */
void svo_facet_make(const svo_shader *s, uint32_t group, uint64_t local, const double block[3], const int32_t q[3][3], svo_facet *out);
/* Have the triangles of a group alpha MASK with something to test? */
bool svo_facet_is_masked(const svo_shader *s, uint32_t group);

/* A convex polygon. */
typedef struct svo_polygon { uint32_t count; double at[10][3]; } svo_polygon;
/* The part of `in` with low <= coordinate <= low + 1. */
void svo_polygon_slab(const svo_polygon *in, uint32_t axis, double low, svo_polygon *out);

/* What one triangle puts into one voxel. Colours are 0..65535 linear, normals -32767..32767 */
typedef struct svo_contribution {
    uint64_t weight, color_weight; /* area in units of 2^-shift voxel faces, at least 1 */
    uint16_t color[3], emissive[3], metallic, roughness;
    double alpha; /* color_weight / weight */
    int32_t normal[3];
} svo_contribution;

/* The part of a facet in one voxel. */
typedef struct svo_piece {
    double area;       /* voxel faces */
    double centre[3];  /* centroid, relative to the block; where `clips`, only the axes after the facet's are used */
    double xx, xy, yy; /* covariance of its points along those two axes; 0 where it has no extent to speak of */
} svo_piece;

/* The facet as a whole. */
void svo_facet_piece(const svo_facet *t, svo_piece *out);
/* What a piece contributes. */
void svo_facet_contribution(const svo_shader *s, svo_facet *t, const svo_piece *piece, uint32_t shift, svo_contribution *out);
/* The weight alone, and the same values with another weight (of a flat facet). */
uint64_t svo_piece_weight(const svo_piece *piece, uint32_t shift);
void svo_contribution_weigh(svo_contribution *c, uint64_t weight);
/* The values at single points of a triangle, as of a voxel whose only surface is one voxel face around the point: for voxels that
 * are filled from the nearest surface. First the triangle (by its number in the placement), then any of its points; `values` receives
 * the bytes of every channel that is not constant, the material too. The facet is good for nothing else. Any thread; a facet has one user. */
void svo_facet_make_points(const svo_shader *s, uint64_t triangle, svo_facet *out);
void svo_facet_point(const svo_shader *s, svo_facet *t, const double barycentric[3], uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE]);
/* Does alpha MASK leave something of it? Polygon: the facet clipped to the voxel at cell[3] (block-relative); it may be empty or thin,
 * then the nearest point counts. */
bool svo_facet_visible(const svo_shader *s, svo_facet *t, const svo_polygon *polygon, const int32_t cell[3]);
/* Do contributions read textures, so that the covariance is used? */
bool svo_facet_reads_textures(const svo_shader *s, const svo_facet *t);

/* Add to `sums` (layout fields), and turn sums into channel values: values[channel] receives the bytes. */
void svo_shade_add(const svo_shade_layout *l, const svo_contribution *c, uint64_t *sums);
void svo_shade_value(const svo_shade_layout *l, const uint64_t *sums, uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE]);

#ifdef __cplusplus
}
#endif
#endif
