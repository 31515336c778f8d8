/* A packed scene as the renderer takes it: assets, and instances of them in pages. Plain, read-only data; an .svscene is
 * mapped into it, a single asset becomes a scene with one instance. */
#ifndef SVO_SCENE_H
#define SVO_SCENE_H

#include "svo_pose.h"
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
    const float *instance_transform;  /* 12 each: row-major 3x4 from the asset's mesh coordinates to scene minus page origin;
                                         finite and invertible always */
    const uint64_t *instance_id;
    const uint32_t *instance_name;    /* offset into names; NULL when no instance has a name */
    const char *names;                /* NUL-terminated strings; offset 0 is "" */
    uint64_t names_size;
    const uint32_t *instance_pose;    /* < poses.count or SVO_NO_POSE; NULL when no instance has a pose */
    svo_poses poses;
    uint32_t page_count;
    const svo_scene_page *pages;      /* in order, covering all instances */
    bool has_camera;
    svo_mat4 camera_transform; /* camera to scene; looks along -Z, +Y up */
    double camera_yfov;        /* radians */
} svo_scene;

/* Name of an instance, "" if it has none. */
const char *svo_scene_instance_name(const svo_scene *s, uint64_t instance);

/* Pose of an instance, NULL if it has none. */
const svo_pose *svo_scene_instance_pose(const svo_scene *s, uint64_t instance);

/* Full transform of an instance in double precision. */
svo_mat4 svo_scene_instance_transform(const svo_scene *s, uint32_t page, uint64_t instance);

/* Bounds of all pages; false for a scene without instances. */
bool svo_scene_bounds(const svo_scene *s, double low[3], double high[3]);

/* One packed octree as a scene of one instance with the identity transform (none when it is empty). `storage` is
 * caller-owned and must neither move nor end while *scene is used; view and name are borrowed. The page's bounds are
 * those of the finest voxels. Fails only for want of memory (scratch, freed before it returns). */
typedef struct svo_scene_one {
    svo_scene scene; /* use this */
    const svo_view *view;
    const char *asset_name;
    uint32_t asset;
    float transform[12];
    uint64_t id;
    svo_scene_page page;
} svo_scene_one;
svo_result svo_scene_single(const svo_view *view, const char *name, const svo_allocator *a, svo_scene_one *storage, svo_error *err);

/* Bounds of the image of a box under an affine matrix, widened by `ulps` units in the last place of the sizes involved.
 * With 16 they hold every mapped point of the box in spite of rounding; 0 gives the plain values. Not finite (infinite
 * or NaN) where the image overflows. */
void svo_box_transform(const svo_mat4 *m, const double low[3], const double high[3], double ulps, double out_low[3], double out_high[3]);

#ifdef __cplusplus
}
#endif
#endif
