/* Inside of svo_render: shared by the picture and the light that comes by way of other surfaces. Not installed. */
#ifndef SVOI_RENDER_H
#define SVOI_RENDER_H

#include "svo_render.h"

/* Channels of an asset that shading uses; SVO_MAX_CHANNELS = not there. */
typedef struct asset_channels { uint32_t color, normal, emissive, metallic, roughness, bone; } asset_channels;

enum { TILE = 16, TILE_PIXELS = TILE * TILE };

/* What one thread needs; results are sums and extremes, the same for every division of work but for the seconds. */
typedef struct worker {
    svo_scene_ray rays[TILE_PIXELS], shadow_rays[TILE_PIXELS];
    svo_scene_hit hits[TILE_PIXELS];
    float sum[TILE_PIXELS][4]; /* linear light times coverage, and coverage */
    svo_vec3 normals[TILE_PIXELS];
    /* secondary rays */
    svo_scene_ray more[TILE_PIXELS], more_shadow[TILE_PIXELS];
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
} renderer;

double svoi_thread_seconds(void);
bool svoi_render_color(const svo_view *v, uint32_t channel, uint64_t index, float rgb[3]);
svo_vec3 svoi_render_normal(const renderer *r, const svo_scene_ray *ray, const svo_scene_hit *hit);
/* Light from a direction in which nothing is; its mean over a hemisphere, weighted by the cosine, is 0.75 + 0.25 n.y. */
static inline float svoi_sky(svo_vec3 d) { return (float)(0.75 + 0.375 * d.y); }

/* Fill in `around` and `mirrored` for the hits of a tile. `sample` numbers the samples of a pixel. */
void svoi_render_secondary(const renderer *r, worker *w, uint32_t x0, uint32_t y0, uint32_t nx, uint32_t count, uint32_t sample);

#endif
