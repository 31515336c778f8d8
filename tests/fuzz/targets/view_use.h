/* Everything a program does with a view that was accepted: walk, look up, decode, cast rays. */
#ifndef VIEW_USE_H
#define VIEW_USE_H

#include "../fuzz.h"
#include "svo_raycast.h"
#include "svo_scene.h"

typedef struct view_use { const svo_view *view; uint32_t left; } view_use;

static inline void view_value(const svo_view *v, uint64_t index)
{
    uint8_t value[64];
    const uint64_t voxels = svo_average_voxels(index);
    if ((svo_average_first(index) >= v->attribute_count || voxels > v->attribute_count - svo_average_first(index)) && !v->unnumbered) fuzz_fail("attribute %llu of %llu", (unsigned long long)index, (unsigned long long)v->attribute_count);
    for (uint32_t c = 0; c < v->channel_count; c++) svo_view_attribute(v, c, index, value);
}

static inline bool view_average(void *user, uint64_t attribute)
{
    view_use *u = user;
    view_value(u->view, attribute);
    return --u->left != 0;
}

static inline bool view_visit(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    view_use *u = user;
    uint64_t same;
    if ((x | y | z) >> u->view->depth != 0) fuzz_fail("a voxel lies outside of the grid");
    if (!svo_view_voxel(u->view, x, y, z, &same) || same != index) fuzz_fail("walk and look-up differ at %u %u %u", x, y, z);
    view_value(u->view, index);
    return --u->left != 0;
}

static inline void view_check(const svo_view *v)
{
    view_use u = {v, 2000};
    svo_view_voxels(v, view_visit, &u);
    if (!v->empty && u.left == 2000) fuzz_fail("no voxel in an octree that is not empty");
    u.left = 2000;
    if (!v->empty) svo_view_averages(v, 0, svo_view_root(v), view_average, &u);
    uint32_t low[3], high[3];
    bool any;
    svo_error err;
    if (svo_view_grid_bounds(v, NULL, &any, low, high, &err) != SVO_OK) fuzz_fail("no bounds: %s", err.message);
    if (any == v->empty) fuzz_fail("bounds and emptiness differ");
    double side = (double)((uint64_t)1 << v->depth);
    svo_ray rays[24];
    svo_hit hits[24];
    for (int i = 0; i < 24; i++) {
        svo_ray r = {.t_max = 4 * side, .spread = i % 4 == 3 ? 0.01 : 0};
        for (int k = 0; k < 3; k++) {
            r.origin[k] = v->empty ? side / 2 : low[k] + 0.5;
            r.direction[k] = i < 12 && k != i % 3 ? 0 : (double)((i * 7 + k * 3) % 5 - 2) + 0.25 * i;
            if (k == i % 3) r.origin[k] -= i % 2 != 0 ? 2 * side : 0;
        }
        rays[i] = r;
    }
    svo_raycast(v, rays, 24, hits);
    for (int i = 0; i < 24; i++) {
        if (hits[i].hit != svo_ray_blocked(v, &rays[i])) fuzz_fail("ray %d: hit and blocked differ", i);
        if (hits[i].hit && (rays[i].spread == 0 || v->lod)) view_value(v, hits[i].attribute);
    }
}

#endif
