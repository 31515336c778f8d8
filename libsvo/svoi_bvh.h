/* Inside of svo_bvh: shared by the builder and the traversal. */
#ifndef SVOI_BVH_H
#define SVOI_BVH_H

#include "svo_alloc.h"
#include "svo_bvh.h"

/* 32 bytes, boxes relative to `centre` and rounded outwards, so that scenes far from the origin keep small boxes. */
typedef struct svoi_bvh_node {
    float low[3];
    uint32_t first; /* inner: children first and first + 1; leaf: first item */
    float high[3];
    uint32_t count; /* items of a leaf, 0 for an inner node */
} svoi_bvh_node;

/* 60 levels of splits by cost, then halves: 2^32 entries need 32 more. */
enum { SVOI_BVH_COST_LEVELS = 60, SVOI_BVH_STACK = SVOI_BVH_COST_LEVELS + 33 };

struct svo_bvh {
    const svo_scene *scene;
    const svo_allocator *allocator;
    svo_placed *placed; /* in the order of the leaves */
    svoi_bvh_node *nodes;
    uint64_t placed_count, placed_capacity, node_count, node_capacity;
    double centre[3];
    svo_rays **rays; /* by asset, NULL where there is none; or NULL */
};

/* Product of an instance's transform and its asset's voxel_to_world. */
svo_mat4 svoi_grid_to_scene(const svo_scene *s, uint32_t page, uint64_t instance);

#endif
