/* A scene made ready for rays: a bounding volume hierarchy over its instances, each with its map into the grid of its asset.
 * Everything is in scene coordinates; rays keep their own parameter t in all instances. */
#ifndef SVO_BVH_H
#define SVO_BVH_H

#include "svo_rays.h"
#include "svo_scene.h"

#ifdef __cplusplus
extern "C" {
#endif

/* An instance that can be hit. grid point = to_grid * (scene point - origin). */
typedef struct svo_placed {
    double to_grid[9]; /* row-major */
    double origin[3];  /* where grid corner 0, 0, 0 lies */
    double stretch;    /* largest scene length of a vector that is one voxel edge long in the grid (never too small) */
    uint64_t instance; /* in the scene */
    uint32_t asset, page;
} svo_placed;

typedef struct svo_bvh_report {
    uint64_t instances;  /* of the scene */
    uint64_t placed;     /* in the hierarchy */
    uint64_t empty;      /* left out: the asset has no voxels */
    uint64_t singular;   /* left out: the transform has no inverse, or is not finite */
    uint64_t duplicates; /* left out: same asset and place as an earlier one, so it could never be seen */
    uint64_t nodes, depth, bytes;
    double seconds;
} svo_bvh_report;

/* Build. The scene is borrowed and must outlive the result. The result does not depend on threads (0 = all). Memory: about
 * 190 bytes an instance kept, 70 more while building. Singular instances are warned about. report may be NULL. */
typedef struct svo_bvh svo_bvh;
svo_result svo_bvh_build(const svo_scene *scene, uint32_t threads, const svo_allocator *a, svo_warnings *warnings, svo_bvh **out,
                         svo_bvh_report *report, svo_error *err);
void svo_bvh_free(svo_bvh *bvh);

/* Trace many rays at a time (svo_rays.h) in batches of the functions below; nothing changes but the time it takes. A second form is made of every
 * asset with an instance that can be hit, until options->memory is used up; instances of the others are traced as before. Before any ray is
 * traced; not by several threads. report: sums over the assets; zero where nothing was made; may be NULL. */
svo_result svo_bvh_use_rays(svo_bvh *bvh, const svo_rays_options *options, svo_rays_report *report, svo_error *err);

/* Box around everything that can be hit, tight to the voxels but for rotated instances; false when there is nothing. */
bool svo_bvh_bounds(const svo_bvh *bvh, double low[3], double high[3]);

typedef struct svo_scene_ray {
    svo_vec3 origin, direction;
    double t_min, t_max;
    /* Stop at nodes whose largest edge in scene units is at most spread * t + offset (see svo_ray). */
    double spread, offset;
} svo_scene_ray;

typedef struct svo_scene_hit {
    svo_hit node;  /* node.hit false: nothing; t as the ray's */
    uint32_t item; /* for svo_bvh_item */
} svo_scene_hit;

/* Nearest hits; of several at the same t the instance with the lowest number wins, so that pictures do not depend on the
 * hierarchy. Batches as in svo_raycast. Any number of threads at once. */
void svo_scene_trace(const svo_bvh *bvh, const svo_scene_ray *rays, uint32_t count, svo_scene_hit *hits);
bool svo_scene_blocked(const svo_bvh *bvh, const svo_scene_ray *ray);
/* The same for many rays, which costs less a ray: blocked[i] belongs to rays[i]. */
void svo_scene_blocked_many(const svo_bvh *bvh, const svo_scene_ray *rays, uint32_t count, bool *blocked);

/* What a hit's item number stands for: the instance as placed, and its octree. item < the number of placed instances;
 * both belong to the hierarchy (the view to its scene). */
const svo_placed *svo_bvh_item(const svo_bvh *bvh, uint32_t item);
const svo_view *svo_bvh_view(const svo_bvh *bvh, uint32_t item);
/* The ray in the grid of an item, as it is traced there. */
svo_ray svo_bvh_grid_ray(const svo_bvh *bvh, uint32_t item, const svo_scene_ray *ray);
/* Map of an item's grid to the scene, vectors only (3x3 row-major): inverse of to_grid. */
void svo_bvh_from_grid(const svo_bvh *bvh, uint32_t item, double m[9]);
/* Outward unit normal of the face a ray entered through, in scene coordinates; 0 for SVO_FACE_INSIDE. */
svo_vec3 svo_bvh_face_normal(const svo_bvh *bvh, const svo_scene_hit *hit);

#ifdef __cplusplus
}
#endif
#endif
