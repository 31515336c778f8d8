/* A small reference renderer: one primary ray a sample, stop at nodes smaller than a sample, one shadow ray to a
 * directional light. See docs/design/003-ray-casting.md for the choices made here. */
#ifndef SVO_RENDER_H
#define SVO_RENDER_H

#include "svo_bvh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A perspective camera: orthonormal axes, forward looks into the picture. */
typedef struct svo_eye {
    svo_vec3 position, right, up, forward;
    double yfov; /* radians, of the picture's height; in (0, pi) */
} svo_eye;

/* Camera at `position` looking at `target`. Where `up` is parallel to the view another axis is taken. INVALID_ARGUMENT when
 * the two points coincide or something is not finite. */
svo_result svo_eye_look(svo_vec3 position, svo_vec3 target, svo_vec3 up, double yfov, svo_eye *out, svo_error *err);
/* From a scene's camera (its transform may scale or mirror; only its directions count). */
svo_result svo_eye_from_transform(const svo_mat4 *transform, double yfov, svo_eye *out, svo_error *err);
/* Three-quarter view from the right, above and in front (+X, +Y, +Z) as near as the box's corners allow with a margin
 * of 4 % of the picture on each side. `aspect` = width / height. An empty or infinite box gives a view of the unit cube. */
svo_eye svo_eye_frame(const double low[3], const double high[3], double aspect, double yfov);

typedef struct svo_render_options {
    uint32_t width, height; /* 1..65536 each, at most 2^28 pixels */
    uint32_t samples;       /* a side: samples * samples rays a pixel, 1..16 */
    svo_eye eye;
    svo_vec3 light;         /* from the scene towards the light, any length > 0 */
    bool shadows;
    double ambient;         /* share of light that comes from everywhere, 0..1 */
    double footprint;       /* stop at nodes whose edge is at most this many samples wide; 0 = only at finest voxels */
    double background_top[3], background_bottom[3]; /* linear light */
    /* Light that comes by way of other surfaces (Dado et al. 2016, section 2.5.6). */
    uint32_t bounce;        /* a side: bounce * bounce stratified rays over the hemisphere of every primary hit, 0..16; 0: none */
    bool reflections;       /* one ray in the mirror direction of the stored normal where the surface reflects */
    double reflectance;     /* of surfaces without the channels metallic and roughness, 0..1; others: metallic * (1 - roughness) */
    bool transparent;       /* no background: alpha is the covered share of the pixel */
    bool measure;           /* verify the stop rule on every hit (costs some time) */
    uint32_t threads;       /* 0 = all */
    const svo_allocator *allocator;
    void (*progress)(void *user, double fraction); /* called with 0 at the start, then by one worker after some of its tiles (by none, where others draw them all); may be NULL */
    void *user;
} svo_render_options;
svo_render_options svo_default_render_options(void);

/* Planes of numbers beside the picture, width * height each, of the sample nearest to the pixel's middle; NULL: not wanted. Where
 * nothing is hit: depth is infinite, the others 0 (normal) or UINT32_MAX. */
typedef struct svo_render_planes {
    float *light;     /* 4 a pixel: linear RGB times coverage, and coverage; of all samples */
    float *depth;     /* along the view's axis, in scene units */
    float *normal;    /* 3 a pixel: unit, scene */
    uint32_t *level;  /* of the node that was hit */
    uint32_t *instance; /* the lower 32 bits of its id */
    uint32_t *bone;   /* value of the channel "bone"; UINT32_MAX without one */
} svo_render_planes;

typedef struct svo_render_stats {
    uint64_t primary, hits, shadow, blocked;
    uint64_t secondary, secondary_hits; /* reflected and bounced rays; their shadow rays count as shadow */
    uint64_t inside;       /* primary rays that began inside a voxel */
    uint64_t lod_stops;    /* hits on inner nodes */
    uint64_t levels[SVO_MAX_DEPTH + 1]; /* hits by node level */
    /* seconds of thread time in tracing, summed over threads */
    double primary_seconds, shadow_seconds, shade_seconds, secondary_seconds;
    /* With measure: edges in samples. The rule holds when stop_max <= footprint and parent_min > footprint. */
    double stop_max;       /* largest edge of an inner node a ray stopped at; 0 if there was none */
    double parent_min;     /* smallest edge of a parent of a hit node, where the ray enters the parent; INFINITY if none */
} svo_render_stats;

/* Render into pixels (width * height RGBA, row 0 on top, sRGB, alpha not premultiplied; 255 where there is a background).
 * The picture does not depend on threads. */
svo_result svo_render(const svo_bvh *bvh, const svo_scene *scene, const svo_render_options *options, uint8_t *pixels,
                      svo_render_stats *stats, svo_error *err);
svo_result svo_render_with_planes(const svo_bvh *bvh, const svo_scene *scene, const svo_render_options *options, uint8_t *pixels,
                                  const svo_render_planes *planes, svo_render_stats *stats, svo_error *err);

/* Statistics of several pictures together: sums and extremes. Begin with all zero but parent_min = INFINITY. */
void svo_render_add_stats(svo_render_stats *to, const svo_render_stats *s);

/* The ray through a sample position, in pixels from the top left corner of the picture; its direction has length 1 along
 * the view's axis, so t is depth. */
svo_scene_ray svo_render_ray(const svo_render_options *options, double x, double y);

/* Where a shadow ray begins, for a hit with unit surface normal n (scene): far enough above the voxels of a plane through
 * the hit node that the plane cannot shadow itself. */
svo_vec3 svo_render_shadow_origin(const svo_bvh *bvh, const svo_scene_hit *hit, svo_vec3 n);

#ifdef __cplusplus
}
#endif
#endif
