/* Layout 3 against layout 1: every voxel, every node, every attribute index. */
#include <stdlib.h>
#include <string.h>

#include "svo_dag.h"
#include "svo_morton.h"
#include "svo_raycast.h"
#include "svoi_top.h"
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
    if (x.full) return; /* nothing is stored below */
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
static void same_places(const tree *t, const svo_view *plain, const svo_view *v)
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

/* With the table of upper levels as it is made, without one, and with some of other levels. */
static void same_voxels(const tree *t, const svo_view *plain, const svo_view *v)
{
    static const uint64_t cells[] = {0, 64, 600};
    same_places(t, plain, v);
    for (int i = 0; i < 3 && !test_failed(); i++) {
        svo_view other = *v;
        other.top = svoi_top_make(&other, cells[i], SVOI_RECORDS, NULL);
        same_places(t, plain, &other);
        svoi_top_free(other.top, NULL);
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

/* --- extreme cases ----------------------------------------------------------------------------------------------- */

static int compare_codes(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

/* A tree of these voxels, a random colour each. */
static tree tree_of(uint32_t depth, const uint64_t *codes, uint64_t count, uint64_t seed)
{
    tree t = {.info = {.depth = depth, .channel_count = 1}};
    for (int i = 0; i < 4; i++) t.info.voxel_to_world[5 * i] = 1;
    strcpy(t.info.channels[0].name, "color");
    t.info.channels[0].kind = SVO_KIND_COLOR_SRGB8;
    t.codes = malloc((count + 1) * sizeof *codes);
    t.values[0] = malloc(count * 3 + 1);
    if (count != 0) memcpy(t.codes, codes, count * sizeof *codes);
    qsort(t.codes, count, sizeof *codes, compare_codes);
    for (uint64_t i = 0; i < count; i++)
        if (t.count == 0 || t.codes[t.count - 1] != t.codes[i]) t.codes[t.count++] = t.codes[i];
    for (uint64_t i = 0; i < 3 * t.count; i++) t.values[0][i] = (uint8_t)test_random(&seed);
    return t;
}

static uint64_t turned(uint32_t g, uint32_t levels, uint64_t code)
{
    static const uint32_t axes[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    uint32_t in[3], out[3], n = 1u << levels;
    svo_morton_decode(code, &in[0], &in[1], &in[2]);
    for (uint32_t k = 0; k < 3; k++) out[axes[g >> 3][k]] = in[k];
    for (uint32_t k = 0; k < 3; k++)
        if (g >> k & 1) out[k] = n - 1 - out[k];
    return svo_morton_encode(out[0], out[1], out[2]);
}

enum { MOST = 1 << 18 };
static uint64_t code_of[MOST];

TEST(turned_copies_are_one)
{
    uint64_t seed = 11, pattern[200], n = 0;
    for (int i = 0; i < 200; i++) pattern[i] = test_random(&seed) & 0x3ffff; /* 64^3 */
    for (uint32_t g = 0; g < 48; g++)
        for (int i = 0; i < 200; i++) code_of[n++] = (uint64_t)g << 18 | turned(g, 6, pattern[i]);
    tree t = tree_of(8, code_of, n, 12);
    compare(&t, true);
    svo_packed *p = build(&t, SVO_GEOMETRY_BEST, true, 1), *mirrors = build(&t, SVO_GEOMETRY_SYMMETRIC, true, 1), *plain = build(&t, SVO_GEOMETRY_SVDAG, true, 1);
    CHECK(p != NULL && mirrors != NULL && plain != NULL);
    CHECK_U64(svo_view_stored(svo_packed_view(p), 2), 1);
    CHECK_U64(svo_view_stored(svo_packed_view(mirrors), 2), 6);
    CHECK_U64(svo_view_stored(svo_packed_view(plain), 2), 48);
    same_node(svo_packed_view(plain), svo_packed_view(mirrors), 0, svo_view_root(svo_packed_view(plain)), svo_view_root(svo_packed_view(mirrors)));
    svo_packed_free(p);
    svo_packed_free(mirrors);
    svo_packed_free(plain);
    tree_free(&t);
}

TEST(a_full_block)
{
    uint64_t seed = 13;
    for (uint32_t depth = 3; depth <= 5; depth++) {
        tree t;
        tree_full(&t, depth, &seed);
        compare(&t, depth & 1);
        svo_packed *p = build(&t, SVO_GEOMETRY_BEST, true, 1);
        CHECK(p != NULL);
        for (uint32_t l = 0; l + 2 < depth; l++) CHECK_U64(svo_view_stored(svo_packed_view(p), l), 1);
        svo_packed_free(p);
        tree_free(&t);
    }
}

TEST(a_checkerboard)
{
    uint64_t n = 0;
    for (uint64_t c = 0; c < 1 << 18; c++) {
        uint32_t x, y, z;
        svo_morton_decode(c, &x, &y, &z);
        if (((x + y + z) & 1) == 0) code_of[n++] = c;
    }
    tree t = tree_of(6, code_of, n, 14);
    compare(&t, true);
    tree_free(&t);
}

TEST(voxels_that_share_nothing)
{
    uint64_t seed = 15, n = 0;
    while (n < 60000) code_of[n++] = test_random(&seed) & (((uint64_t)1 << 24) - 1);
    tree t = tree_of(8, code_of, n, 16);
    compare(&t, false);
    tree_free(&t);
}

TEST(one_voxel_at_every_depth)
{
    uint64_t seed = 17;
    for (uint32_t depth = 0; depth <= 21; depth++) {
        uint64_t code = test_random(&seed) & (((uint64_t)1 << 3 * depth) - 1);
        tree t = tree_of(depth, &code, 1, 18);
        compare(&t, depth & 1);
        tree_free(&t);
    }
}

/* The same 8^3 block in every second place of 64^3 of them: one entry, many references. */
TEST(a_subtree_shared_very_often)
{
    uint64_t n = 0;
    for (uint64_t c = 0; c < 1 << 18; c += 2) code_of[n++] = c << 9 | 0x155;
    tree t = tree_of(9, code_of, n, 19);
    compare(&t, true);
    svo_packed *p = build(&t, SVO_GEOMETRY_BEST, true, 1);
    CHECK(p != NULL);
    for (uint32_t l = 0; l <= 6; l++) CHECK_U64(svo_view_stored(svo_packed_view(p), l), 1);
    svo_packed_free(p);
    tree_free(&t);
}

TEST(threads_and_memory)
{
    uint64_t seed = 20;
    tree t;
    tree_random(&t, 6, 0, &seed);
    svo_packed *one = build(&t, SVO_GEOMETRY_BEST, true, 1), *four = build(&t, SVO_GEOMETRY_BEST, true, 4);
    CHECK(one != NULL && four != NULL);
    CHECK(svo_view_compare_geometry(svo_packed_view(one), svo_packed_view(four)) == 0);
    svo_packed_free(one);
    svo_packed_free(four);
    /* every allocation in turn fails: a clear error, nothing left behind */
    for (uint64_t fail = 1;; fail++) {
        svo_error err = {0};
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = fail;
        svo_dag_options o = svo_default_dag_options();
        o.geometry = SVO_GEOMETRY_BEST, o.threads = 1, o.allocator = &a.base;
        svo_dag_builder *b;
        svo_packed *p = NULL;
        svo_result r = svo_dag_builder_create(&t.info, &o, &b, &err);
        if (r == SVO_OK) {
            r = tree_feed(&t, 1, svo_dag_builder_sink(b), &err);
            if (r == SVO_OK) r = svo_dag_builder_finish(b, &p, NULL, &err);
            else svo_dag_builder_free(b);
        }
        if (r == SVO_OK) svo_packed_free(p);
        CHECK_U64(svo_limit_in_use(&a), 0);
        if (r == SVO_OK) break;
        CHECK(r == SVO_OUT_OF_MEMORY && err.message[0] != 0);
    }
    tree_free(&t);
}

/* --- full leaves ------------------------------------------------------------------------------------------------- */

typedef struct solid { uint8_t mask[1 << 16], color[3 << 18]; uint64_t masks, values; uint64_t seed; uint32_t full; } solid;
static solid shape;

/* A random subtree with `levels` below it; about one child in `full` is a full leaf. */
static void random_solid(uint32_t levels, bool root)
{
    uint32_t mask = (uint32_t)test_random(&shape.seed) & (levels > 2 ? 0xff : (uint32_t)test_random(&shape.seed) & 0xff), at = (uint32_t)shape.masks++;
    if (mask == 0 || (root && shape.full == 1)) mask = root ? 0xff : 1;
    if (!root && levels >= 1 && test_random(&shape.seed) % shape.full == 0) {
        shape.mask[at] = 0;
        for (int k = 0; k < 3; k++) shape.color[3 * shape.values + (uint64_t)k] = (uint8_t)test_random(&shape.seed);
        shape.values++;
        return;
    }
    shape.mask[at] = (uint8_t)mask;
    for (uint32_t m = mask; m != 0; m &= m - 1) {
        if (levels > 1) {
            random_solid(levels - 1, false);
            continue;
        }
        for (int k = 0; k < 3; k++) shape.color[3 * shape.values + (uint64_t)k] = (uint8_t)test_random(&shape.seed);
        shape.values++;
    }
}

static svo_packed *build_solid(uint32_t depth, svo_geometry geometry, bool lod)
{
    svo_error err = {0};
    tree t = tree_of(depth, NULL, 0, 0);
    t.info.fill = SVO_FILL_SOLID;
    svo_dag_options o = {.geometry = geometry, .lod = lod, .threads = 1};
    svo_dag_builder *b;
    svo_packed *p = NULL;
    void *blob = NULL;
    svo_chunk c = {.depth = depth, .node_count = shape.masks, .value_count = shape.values, .masks = shape.mask, .channels = {shape.color}};
    svo_result r = svo_dag_builder_create(&t.info, &o, &b, &err);
    if (r == SVO_OK) {
        svo_chunk_sink s = svo_dag_builder_sink(b);
        r = s.encode(s.user, &c, 0, &blob, &err);
        if (r == SVO_OK) r = s.commit(s.user, blob, &err);
        if (r == SVO_OK) r = svo_dag_builder_finish(b, &p, NULL, &err);
        else svo_dag_builder_free(b);
    }
    if (r != SVO_OK) test_fail(__FILE__, __LINE__, "%s", err.message);
    tree_free(&t);
    return p;
}

TEST(full_leaves)
{
    svo_error err = {0};
    for (int i = 0; i < 60 && !test_failed(); i++) {
        uint32_t depth = 3 + (uint32_t)i % 4;
        shape.masks = shape.values = 0;
        shape.seed = 100 + (uint64_t)i;
        shape.full = 1 + (uint32_t)i % 5; /* 1: full leaves alone, all levels below are empty */
        random_solid(depth, true);
        svo_packed *plain = build_solid(depth, SVO_GEOMETRY_SVDAG, i & 1), *best = build_solid(depth, i % 7 == 0 ? SVO_GEOMETRY_SYMMETRIC : SVO_GEOMETRY_BEST, i & 1);
        if (plain != NULL && best != NULL) {
            const svo_view *a = svo_packed_view(plain), *b = svo_packed_view(best);
            CHECK(b->layout == SVO_LAYOUT_BEST);
            CHECK_OK(svo_view_validate(b, NULL, &err));
            same_node(a, b, 0, svo_view_root(a), svo_view_root(b));
            same_rays(a, b);
            for (uint32_t z = 0; z >> depth == 0; z++)
                for (uint32_t y = 0; y >> depth == 0; y++)
                    for (uint32_t x = 0; x >> depth == 0; x += 1 + (depth > 5)) {
                        uint64_t index[2] = {0};
                        CHECK(svo_view_voxel(a, x, y, z, &index[0]) == svo_view_voxel(b, x, y, z, &index[1]));
                        CHECK_U64(index[0], index[1]);
                    }
        }
        svo_packed_free(plain);
        svo_packed_free(best);
    }
}
