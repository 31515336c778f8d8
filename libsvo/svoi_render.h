/* Inside of svo_render: shared by the picture and the light that comes by way of other surfaces. Not installed. */
#ifndef SVOI_RENDER_H
#define SVOI_RENDER_H

#include <stddef.h>

#include "svo_rays.h"
#include "svo_render.h"

/* Channels of an asset that shading uses; SVO_MAX_CHANNELS = not there. */
typedef struct asset_channels { uint32_t color, normal, emissive, metallic, roughness, bone, coverage; } asset_channels;

enum { TILE = 16, TILE_PIXELS = TILE * TILE };
#define SVOI_DARK (1.0f / 1024) /* a share of light that is not followed any further */

/* What one thread needs; results are sums and extremes, the same for every division of work but for the seconds. */
typedef struct worker {
    svo_scene_ray rays[TILE_PIXELS], shadow_rays[TILE_PIXELS];
    svo_scene_hit hits[TILE_PIXELS];
    float sum[TILE_PIXELS][4]; /* linear light times coverage, and coverage */
    svo_vec3 normals[TILE_PIXELS];
    float seen[TILE_PIXELS], cover[TILE_PIXELS]; /* share of the sample that is not covered yet; of it, what this hit covers */
    svo_scene_hit first_hits[TILE_PIXELS];       /* of the sample, for the planes */
    svo_vec3 first_normals[TILE_PIXELS];
    /* secondary rays */
    svo_scene_ray more[TILE_PIXELS];
    svo_scene_hit more_hits[TILE_PIXELS];
    float more_light[TILE_PIXELS][3];
    uint32_t more_pixel[TILE_PIXELS];
    float around[TILE_PIXELS][3], mirrored[TILE_PIXELS][4]; /* light from the hemisphere; from the mirror direction, and its share */
    svo_render_stats stats;
} worker;

typedef struct renderer {
    const svo_bvh *bvh;
    const svo_scene *scene;
    const svo_render_options *o;
    uint8_t *pixels;
    const svo_render_planes *planes;
    asset_channels *channels;
    svo_vec3 light;
    worker *workers;
    uint64_t tiles_x, tiles;
    bool see_through; /* an asset has voxels that do not cover all behind them */
} renderer;

double svoi_thread_seconds(void);
/* Linear values of a channel of colours, given by its place in asset_channels, at the hits, at most TILE_PIXELS; rgb[i] stays as it is where there is no hit or no
 * channel. Of all hits of an asset at a time. */
void svoi_render_colors(const renderer *r, size_t field, const svo_scene_hit *hits, uint32_t count, float (*rgb)[3]);
svo_vec3 svoi_render_normal(const renderer *r, const svo_scene_ray *ray, const svo_scene_hit *hit);
/* Light from a direction in which nothing is; its mean over a hemisphere, weighted by the cosine, is 0.75 + 0.25 n.y. */
static inline float svoi_sky(svo_vec3 d) { return (float)(0.75 + 0.375 * d.y); }

/* Share of what is behind it that a hit with this normal covers; 1: all, and otherwise the ray's begin is moved behind the node. Where a ray goes
 * through several voxels of a surface, each counts by the way inside, so that all together count as one surface. */
float svoi_render_pass(const renderer *r, svo_scene_ray *ray, const svo_scene_hit *hit, svo_vec3 normal);
/* Shadow rays for the hits with direct[i] > 0, which is multiplied by the share of light that arrives. At most TILE_PIXELS. */
void svoi_render_shadows(const renderer *r, worker *w, const svo_scene_ray *from, const svo_scene_hit *hits, const svo_vec3 *normals, uint32_t count, float *direct);

/* Fill in `around` and `mirrored` for the hits of a tile. `sample` numbers the samples of a pixel. */
void svoi_render_secondary(const renderer *r, worker *w, uint32_t x0, uint32_t y0, uint32_t nx, uint32_t count, uint32_t sample);

#endif
