/* Layout 3 against layout 1: every voxel, every node, every attribute index. */
#include <stdlib.h>
#include <string.h>

#include "svo_dag.h"
#include "svo_morton.h"
#include "svo_raycast.h"
#include "test.h"
#include "trees.h"

static svo_packed *build(const tree *t, svo_geometry geometry, bool lod, uint32_t threads)
{
    svo_error err = {0};
    svo_dag_builder *b;
    svo_packed *p = NULL;
    svo_dag_options o = svo_default_dag_options();
    o.geometry = geometry;
    o.lod = lod;
    o.threads = threads;
    if (svo_dag_builder_create(&t->info, &o, &b, &err) != SVO_OK) {
        test_fail(__FILE__, __LINE__, "%s", err.message);
        return NULL;
    }
    if (tree_feed(t, o.threads, svo_dag_builder_sink(b), &err) != SVO_OK) {
        svo_dag_builder_free(b);
        test_fail(__FILE__, __LINE__, "%s", err.message);
        return NULL;
    }
    if (svo_dag_builder_finish(b, &p, NULL, &err) != SVO_OK) test_fail(__FILE__, __LINE__, "%s", err.message);
    return p;
}

/* Both at the same place: same children, full leaves, indices, voxels. */
static void same_node(const svo_view *a, const svo_view *b, uint32_t level, svo_view_node x, svo_view_node y)
{
    CHECK_U64(x.attribute, y.attribute);
    CHECK(x.full == y.full);
    if (level == a->brick_level) {
        uint64_t brick = svo_view_brick(a, x);
        CHECK_U64(brick, svo_view_brick(b, y));
        for (uint64_t m = brick; m != 0; m &= m - 1) {
            uint32_t bit = (uint32_t)__builtin_ctzll(m);
            CHECK_U64(svo_view_brick_voxel(a, x, brick, bit), svo_view_brick_voxel(b, y, brick, bit));
            CHECK_U64(svo_view_brick_octant(a, x, brick, bit / 8), svo_view_brick_octant(b, y, brick, bit / 8));
        }
        return;
    }
    CHECK_U64(svo_view_mask(a, level, x), svo_view_mask(b, level, y));
    CHECK_U64(svo_view_full(a, level, x), svo_view_full(b, level, y));
    for (uint32_t m = svo_view_mask(a, level, x); m != 0 && !test_failed(); m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        same_node(a, b, level + 1, svo_view_child(a, level, x, o), svo_view_child(b, level, y, o));
    }
}

/* Each voxel of the tree is found, by itself and with its index, and its neighbours are where they are in the tree. */
static void same_voxels(const tree *t, const svo_view *plain, const svo_view *v)
{
    uint64_t side = (uint64_t)1 << v->depth;
    for (uint64_t i = 0; i < t->count; i++) {
        uint32_t x, y, z;
        svo_morton_decode(t->codes[i], &x, &y, &z);
        uint64_t index[2];
        CHECK(svo_view_voxel(v, x, y, z, NULL) && svo_view_voxel(v, x, y, z, &index[1]) && svo_view_voxel(plain, x, y, z, &index[0]));
        CHECK_U64(index[1], index[0]);
        if (x + 1 == side) continue;
        uint64_t code = svo_morton_encode(x + 1, y, z), low = 0, high = t->count;
        while (low < high) {
            uint64_t middle = (low + high) / 2;
            if (t->codes[middle] < code) low = middle + 1;
            else high = middle;
        }
        CHECK(svo_view_voxel(v, x + 1, y, z, NULL) == (low < t->count && t->codes[low] == code));
    }
}

/* Rays meet the same nodes, with and without levels of detail. */
static void same_rays(const svo_view *a, const svo_view *b)
{
    enum { RAYS = 64 };
    uint64_t seed = 9;
    svo_ray ray[RAYS];
    svo_hit x[RAYS], y[RAYS];
    double size = (double)((uint64_t)1 << a->depth);
    for (int i = 0; i < RAYS; i++) {
        ray[i] = (svo_ray){.t_max = 1e30, .spread = i & 1 ? 0.05 : 0};
        for (int k = 0; k < 3; k++) {
            ray[i].origin[k] = (test_random_unit(&seed) * 3 - 1) * size;
            ray[i].direction[k] = test_random_unit(&seed) * size - ray[i].origin[k];
        }
    }
    svo_raycast(a, ray, RAYS, x);
    svo_raycast(b, ray, RAYS, y);
    for (int i = 0; i < RAYS; i++) {
        CHECK(x[i].hit == y[i].hit && x[i].t == y[i].t && x[i].level == y[i].level && memcmp(x[i].cell, y[i].cell, sizeof x[i].cell) == 0);
        CHECK_U64(x[i].attribute, y[i].attribute);
        CHECK(svo_ray_blocked(b, &ray[i]) == x[i].hit);
    }
}

static void compare(const tree *t, bool lod)
{
    svo_error err = {0};
    svo_packed *plain = build(t, SVO_GEOMETRY_SVDAG, lod, 1), *best = build(t, SVO_GEOMETRY_BEST, lod, 2);
    if (plain != NULL && best != NULL) {
        const svo_view *a = svo_packed_view(plain), *b = svo_packed_view(best);
        CHECK(b->layout == (b->empty || b->brick_level == 0 ? SVO_LAYOUT_PLAIN : SVO_LAYOUT_BEST));
        CHECK_OK(svo_view_validate(b, NULL, &err));
        if (!a->empty) same_node(a, b, 0, svo_view_root(a), svo_view_root(b));
        same_voxels(t, a, b);
        bool any[2];
        uint32_t low[2][3], high[2][3];
        CHECK_OK(svo_view_grid_bounds(a, NULL, &any[0], low[0], high[0], &err));
        CHECK_OK(svo_view_grid_bounds(b, NULL, &any[1], low[1], high[1], &err));
        CHECK(any[0] == any[1] && memcmp(low[0], low[1], sizeof low[0]) == 0 && memcmp(high[0], high[1], sizeof high[0]) == 0);
        same_rays(a, b);
    }
    svo_packed_free(plain);
    svo_packed_free(best);
}

TEST(random_trees_read_the_same)
{
    uint64_t seed = 1;
    for (int i = 0; i < 120 && !test_failed(); i++) {
        tree t;
        tree_random(&t, (uint32_t)i % 12, (uint32_t)i / 12 % TREE_STYLES, &seed);
        compare(&t, i & 1);
        tree_free(&t);
    }
}
