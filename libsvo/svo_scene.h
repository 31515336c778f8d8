/* A packed scene as the renderer takes it: assets, and instances of them in pages. Plain, read-only data; an .svscene is
 * mapped into it, a single asset becomes a scene with one instance. */
#ifndef SVO_SCENE_H
#define SVO_SCENE_H

#include "svo_math.h"
#include "svo_view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Instances [first, first + count) with their bounds in scene coordinates. A page is what a streaming engine loads. */
typedef struct svo_scene_page {
    double low[3], high[3];
    double origin[3]; /* added to the translation of its instances, so that floats keep their precision far out */
    uint64_t first, count;
} svo_scene_page;

typedef struct svo_scene {
    uint32_t asset_count;
    const svo_view *const *assets;
    const char *const *asset_names;
    uint64_t instance_count;
    const uint32_t *instance_asset;   /* < asset_count */
    const float *instance_transform;  /* 12 each: row-major 3x4 from the asset's mesh coordinates to scene minus page origin */
    const uint64_t *instance_id;
    const uint32_t *instance_name;    /* offset into names */
    const char *names;                /* NUL-terminated strings; offset 0 is "" */
    uint64_t names_size;
    uint32_t page_count;
    const svo_scene_page *pages;      /* in order, covering all instances */
    bool has_camera;
    svo_mat4 camera_transform; /* camera to scene; looks along -Z, +Y up */
    double camera_yfov;        /* radians */
} svo_scene;

/* Full transform of an instance in double precision. */
svo_mat4 svo_scene_instance_transform(const svo_scene *s, uint32_t page, uint64_t instance);

/* Bounds of all pages; false for a scene without instances. */
bool svo_scene_bounds(const svo_scene *s, double low[3], double high[3]);

#ifdef __cplusplus
}
#endif
#endif
