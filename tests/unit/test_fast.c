/* Layout 2 ("fast") against layout 1 on the same voxels: every voxel, every inner node, every attribute, every ray. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_dag.h"
#include "svo_morton.h"
#include "svo_raycast.h"
#include "svo_unpack.h"
#include "svoi_raycast.h"
#include "svoi_symmetry.h"
#include "svoi_top.h"
#include "test.h"
#include "trees.h"

/* CHECK in a function that returns a value. */
#define CHECK_VALUE(cond, value)                               \
    do {                                                       \
        if (!(cond)) {                                         \
            test_fail(__FILE__, __LINE__, "%s", #cond);        \
            return value;                                      \
        }                                                      \
    } while (0)

static svo_packed *build(const tree *t, svo_layout layout, bool lod, uint32_t threads, svo_dag_report *report)
{
    svo_error err = {0};
    svo_dag_options o = {.geometry = layout == SVO_LAYOUT_PLAIN ? SVO_GEOMETRY_SVDAG : layout == SVO_LAYOUT_FAST ? SVO_GEOMETRY_FAST : SVO_GEOMETRY_BEST, .lod = lod, .threads = threads};
    svo_dag_builder *b;
    svo_packed *p = NULL;
    svo_result r = svo_dag_builder_create(&t->info, &o, &b, &err);
    if (r == SVO_OK) {
        r = tree_feed(t, 1, svo_dag_builder_sink(b), &err);
        if (r == SVO_OK) r = svo_dag_builder_finish(b, &p, report, &err);
        else svo_dag_builder_free(b);
    }
    if (r != SVO_OK) test_fail(__FILE__, __LINE__, "build: %s", err.message);
    return p;
}

/* All nodes of both in step, down to the bricks. */
static uint64_t same_nodes(const svo_view *a, const svo_view *b, uint32_t level, svo_view_node x, svo_view_node y)
{
    CHECK_VALUE(x.attribute == y.attribute && x.full == y.full, 0);
    if (level == a->brick_level) {
        CHECK_VALUE(svo_view_brick(a, x) == svo_view_brick(b, y), 0);
        return 1;
    }
    uint8_t mask = svo_view_mask(a, level, x);
    CHECK_VALUE(mask == svo_view_mask(b, level, y) && svo_view_full(a, level, x) == svo_view_full(b, level, y), 0);
    uint64_t n = 1;
    for (uint32_t o = 0; o < 8 && !test_failed(); o++)
        if (mask >> o & 1) n += same_nodes(a, b, level + 1, svo_view_child(a, level, x, o), svo_view_child(b, level, y, o));
    return n;
}

static void same_hit(const svo_hit *x, const svo_hit *y)
{
    CHECK(x->hit == y->hit);
    if (x->hit)
        CHECK(x->t == y->t && x->attribute == y->attribute && x->level == y->level && x->face == y->face && memcmp(x->cell, y->cell, sizeof x->cell) == 0);
}

/* One by one, in a batch, and both octrees in turn with one memory of what was decoded. Every fourth ray begins a group of
 * neighbours. */
static void same_rays(const svo_view *a, const svo_view *b, uint64_t *seed)
{
    enum { RAYS = 200 };
    svo_ray rays[RAYS];
    svo_hit batch[RAYS];
    static svoi_ray_cache cache; /* large */
    double side = (double)((uint64_t)1 << a->depth);
    for (int i = 0; i < RAYS; i++) {
        svo_ray r = {.t_max = i % 5 == 0 ? side : 10 * side, .spread = i % 3 == 0 ? 0.02 : 0, .offset = i % 7 == 0 ? 2 : 0};
        for (int k = 0; k < 3; k++) {
            r.origin[k] = i % 4 != 0 ? rays[i - 1].origin[k] : side * ((double)(test_random(seed) % 3000) / 1000 - 1);
            r.direction[k] = side * (double)(test_random(seed) % 1000) / 1000 - r.origin[k];
            if (i % 4 != 0) r.direction[k] = rays[i - 1].direction[k] + (double)(test_random(seed) % 5) - 2;
            if (i % 11 == k) r.direction[k] = 0;
        }
        rays[i] = r;
    }
    svo_raycast(b, rays, RAYS, batch);
    svoi_ray_cache_init(&cache, RAYS);
    for (int i = 0; i < RAYS && !test_failed(); i++) {
        svo_hit x, y;
        svo_raycast(a, &rays[i], 1, &x);
        svo_raycast(b, &rays[i], 1, &y);
        same_hit(&x, &y);
        same_hit(&x, &batch[i]);
        svoi_raycast(i % 3 == 0 ? a : b, &cache, &rays[i], 1, &y);
        same_hit(&x, &y);
        CHECK(x.hit == svo_ray_blocked(b, &rays[i]) && x.hit == svoi_ray_blocked(b, &cache, &rays[i]));
    }
}

/* Two octrees of this layout that are met in turn with one memory. */
static void same_rays_of_two(const svo_view *a, const svo_view *b)
{
    static svoi_ray_cache cache;
    uint64_t seed = 23;
    double side = (double)((uint64_t)1 << a->depth);
    svoi_ray_cache_init(&cache, 1000);
    for (int i = 0; i < 500 && !test_failed(); i++) {
        svo_ray r = {.t_max = 10 * side};
        for (int k = 0; k < 3; k++) {
            r.origin[k] = side * (test_random_unit(&seed) * 3 - 1);
            r.direction[k] = side * test_random_unit(&seed) - r.origin[k];
        }
        for (int k = 0; k < 2; k++) {
            svo_hit x, y;
            svo_raycast(k == 0 ? a : b, &r, 1, &x);
            svoi_raycast(k == 0 ? a : b, &cache, &r, 1, &y);
            same_hit(&x, &y);
        }
    }
}

static void same_places(const svo_view *a, const svo_view *b, const tree *t, uint64_t *seed)
{
    for (uint64_t i = 0; i < 3000; i++) {
        uint64_t code = i % 2 == 0 && t->count != 0 ? t->codes[test_random(seed) % t->count] : test_random(seed);
        if (i % 4 == 0) code ^= test_random(seed) & 0x1ff;
        code &= ((uint64_t)1 << 3 * t->info.depth) - 1;
        uint32_t x, y, z;
        uint64_t p = 0, q = 0;
        svo_morton_decode(code, &x, &y, &z);
        bool in = svo_view_voxel(a, x, y, z, &p);
        CHECK(in == svo_view_voxel(b, x, y, z, &q) && in == svo_view_voxel(b, x, y, z, NULL));
        CHECK(!in || p == q);
    }
}

/* The tables for look-ups change nothing: without them, with those of any level, with and without records. */
static uint64_t sizes_seen; /* nodes whose children's sizes were in a table */
static void same_with_other_tables(const svo_view *a, const svo_view *b, const tree *t)
{
    static const uint64_t cells[] = {0, 64, 600, 5000};
    for (int i = 0; i < 8 && !test_failed(); i++) {
        uint64_t seed = 31;
        svo_view v = *b;
        v.top = svoi_top_make(&v, cells[i / 2], i % 2 == 0 ? SVOI_RECORDS : 0, NULL);
        CHECK(i > 1 || v.top == NULL);
        CHECK(i % 2 == 0 || v.top == NULL || v.top->record == NULL);
        if (v.top != NULL) sizes_seen += v.top->sizes.count;
        same_places(a, &v, t, &seed);
        if (i % 4 < 2) same_nodes(a, &v, 0, svo_view_root(a), svo_view_root(&v));
        if (i % 4 < 2) same_rays(a, &v, &seed);
        svoi_top_free(v.top, NULL);
    }
}

/* Both layouts of a tree, with and without attributes of inner nodes. */
static void compare(const tree *t)
{
    svo_packed *both[2] = {NULL, NULL};
    for (int lod = 0; lod < 2 && !test_failed(); lod++) {
        uint64_t seed = 17;
        svo_error err = {0};
        svo_packed *plain = build(t, SVO_LAYOUT_PLAIN, lod != 0, 1, NULL), *fast = build(t, SVO_LAYOUT_FAST, lod != 0, 1, NULL);
        if (test_failed()) return;
        const svo_view *a = svo_packed_view(plain), *b = svo_packed_view(fast);
        CHECK(b->layout == (b->empty || b->brick_level == 0 ? SVO_LAYOUT_PLAIN : SVO_LAYOUT_FAST) && a->attribute_count == b->attribute_count && a->unnumbered == b->unnumbered);
        CHECK(memcmp(a->nodes, b->nodes, sizeof a->nodes) == 0);
        CHECK_OK(svo_view_validate(b, NULL, &err));
        if (!a->empty) {
            same_nodes(a, b, 0, svo_view_root(a), svo_view_root(b));
            same_places(a, b, t, &seed);
            same_rays(a, b, &seed);
            same_with_other_tables(a, b, t);
        }
        for (uint32_t c = 0; c < a->channel_count && !test_failed(); c++)
            for (uint64_t i = 0; i < a->attribute_count && a->channels[c].encoding != SVO_ENCODING_CONSTANT; i++) {
                uint8_t x[SVO_MAX_STRIDE] = {0}, y[SVO_MAX_STRIDE] = {0};
                svo_view_attribute(a, c, i, x);
                svo_view_attribute(b, c, i, y);
                CHECK(memcmp(x, y, sizeof x) == 0);
            }
        uint32_t low[2][3], high[2][3];
        bool any[2];
        CHECK_OK(svo_view_grid_bounds(a, NULL, &any[0], low[0], high[0], &err));
        CHECK_OK(svo_view_grid_bounds(b, NULL, &any[1], low[1], high[1], &err));
        CHECK(any[0] == any[1] && memcmp(low[0], low[1], sizeof low[0]) == 0 && memcmp(high[0], high[1], sizeof high[0]) == 0);
        svo_unpack u;
        svo_unpack_begin(&u, b);
        svo_tree_info info = svo_unpack_info(b);
        bool left_out = false;
        for (uint32_t c = 0; c < t->info.channel_count; c++) left_out |= info.channels[c].constant != t->info.channels[c].constant;
        if (!left_out) tree_check(t, &info, svo_unpack_source(&u));
        svo_packed_free(plain);
        both[lod] = fast;
    }
    if (!test_failed()) same_rays_of_two(svo_packed_view(both[0]), svo_packed_view(both[1]));
    svo_packed_free(both[0]);
    svo_packed_free(both[1]);
}

TEST(random_trees)
{
    static const uint32_t depths[] = {0, 1, 2, 3, 4, 5, 6, 8, 9, 13, 21};
    for (uint32_t i = 0; i < sizeof depths / sizeof depths[0]; i++)
        for (uint32_t style = 0; style < TREE_STYLES && !test_failed(); style++) {
            uint64_t seed = 31 * i + style;
            tree t;
            tree_random(&t, depths[i], style, &seed);
            compare(&t);
            tree_free(&t);
        }
    CHECK(sizes_seen > 100 || test_failed());
}

/* --- by name ------------------------------------------------------------------------------------------------------ */

static int compare_codes(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

/* Sorted, each once; with a label that varies. Takes the codes. */
static void set_codes(tree *t, uint32_t depth, uint64_t *codes, uint64_t count)
{
    memset(t, 0, sizeof *t);
    t->info.depth = depth;
    for (int i = 0; i < 16; i += 5) t->info.voxel_to_world[i] = 1;
    qsort(codes, count, sizeof *codes, compare_codes);
    uint64_t unique = 0;
    for (uint64_t i = 0; i < count; i++)
        if (i == 0 || codes[i] != codes[i - 1]) codes[unique++] = codes[i];
    t->codes = codes;
    t->count = t->capacity = unique;
    t->info.channel_count = 1;
    strcpy(t->info.channels[0].name, "material");
    t->info.channels[0].kind = SVO_KIND_ID16;
    t->values[0] = malloc(2 * unique + 1);
    if (t->values[0] == NULL) abort();
    for (uint64_t i = 0; i < unique; i++) t->values[0][2 * i] = (uint8_t)(i * 37 >> 3), t->values[0][2 * i + 1] = 0;
}

static uint64_t *new_codes(uint64_t count)
{
    uint64_t *c = malloc(8 * count + 8);
    if (c == NULL) abort();
    return c;
}

static void compare_and_free(tree *t)
{
    compare(t);
    tree_free(t);
}

TEST(one_voxel_at_every_depth)
{
    for (uint32_t depth = 0; depth <= 21 && !test_failed(); depth++)
        for (uint32_t k = 0; k < 3; k++) {
            uint64_t *c = new_codes(1), all = ((uint64_t)1 << 3 * depth) - 1;
            c[0] = k == 0 ? 0 : k == 1 ? all : all & 0x5a5a5a5a5a5a5a5a;
            tree t;
            set_codes(&t, depth, c, 1);
            compare_and_free(&t);
        }
}

TEST(checkerboard)
{
    uint64_t *c = new_codes((uint64_t)1 << 17), n = 0;
    for (uint64_t i = 0; i < (uint64_t)1 << 18; i++) {
        uint32_t x, y, z;
        svo_morton_decode(i, &x, &y, &z);
        if ((x + y + z) % 2 == 0) c[n++] = i;
    }
    tree t;
    set_codes(&t, 6, c, n);
    svo_packed *p = build(&t, SVO_LAYOUT_FAST, true, 1, NULL);
    if (p != NULL) {
        for (uint32_t l = 0; l < 4; l++) CHECK_U64(svo_view_stored(svo_packed_view(p), l), 1);
        CHECK_U64(svo_view_stored(svo_packed_view(p), 4), 1);
        svo_packed_free(p);
    }
    compare_and_free(&t);
}

TEST(random_voxels_that_share_nothing)
{
    uint64_t seed = 5, *c = new_codes(60000);
    for (int i = 0; i < 60000; i++) c[i] = test_random(&seed) & 0x1fffff; /* depth 7, 3 % */
    tree t;
    set_codes(&t, 7, c, 60000);
    compare_and_free(&t);
    c = new_codes(100000);
    for (int i = 0; i < 100000; i++) c[i] = test_random(&seed) & 0x3ffff; /* depth 6, a third */
    set_codes(&t, 6, c, 100000);
    compare_and_free(&t);
}

/* Records hold bit positions: of a tree so large that they do not fit into what is left beside a turn. */
TEST(records_of_a_tree_of_more_than_26_bits_of_position)
{
    const uint32_t depth = 9;
    const uint64_t bricks = (uint64_t)1 << (3 * depth - 6);
    uint64_t seed = 8, *c = new_codes(bricks * 8), n = 0;
    for (uint64_t i = 0; i < bricks; i++) { /* most bricks, which are hardly ever alike: written out, 64 bits each in layout 2 */
        if (test_random(&seed) % 8 > 6) continue;
        uint64_t bits = 0, r = test_random(&seed);
        for (uint32_t k = 0; k < 8; k++, r >>= 6) bits |= (uint64_t)1 << (r & 63);
        for (; bits != 0; bits &= bits - 1) c[n++] = i << 6 | (uint64_t)__builtin_ctzll(bits);
    }
    tree t;
    set_codes(&t, depth, c, n);
    for (int best = 0; best < 2 && !test_failed(); best++) {
        svo_packed *p = build(&t, best ? SVO_LAYOUT_BEST : SVO_LAYOUT_FAST, true, 2, NULL);
        if (p == NULL) break;
        svo_view v = *svo_packed_view(p), bare = v;
        const uint64_t bits = 8 * (best ? v.best_stream_bytes : v.fast.tree_bytes);
        CHECK_MSG(bits >> SVOI_RECORD_BITS != 0 && bits >> (SVOI_RECORD_BITS + SVOI_RECORD_MORE) == 0, "%llu bits", (unsigned long long)bits);
        v.top = svoi_top_make(&v, SVOI_TOP_CELLS, SVOI_RECORDS, NULL);
        bare.top = NULL;
        CHECK(v.top != NULL && v.top->record != NULL);
        for (uint64_t k = 0; k < 20 && !test_failed(); k++) same_places(&bare, &v, &t, &seed);
        svoi_top_free(v.top, NULL);
        svo_packed_free(p);
    }
    tree_free(&t);
}

/* All 48 turns of one random block of 8^3, side by side: one block must be stored, and each of its bricks once. */
TEST(mirrored_and_rotated_copies_merge)
{
    uint64_t seed = 6, cells[512], used = 0;
    for (uint64_t i = 0; i < 512; i++)
        if (test_random(&seed) % 3 == 0) cells[used++] = i;
    uint64_t *c = new_codes(64 * used), n = 0;
    for (uint64_t copy = 0; copy < 64; copy++) {
        uint32_t turn = (uint32_t)(copy * 29 % SVOI_TURNS);
        for (uint64_t i = 0; i < used; i++) {
            uint64_t code = 0;
            for (uint32_t k = 0; k < 3; k++) code |= (uint64_t)svoi_turn_octant(turn, (uint32_t)(cells[i] >> 3 * k) & 7) << 3 * k;
            c[n++] = copy << 9 | code;
        }
    }
    tree t;
    set_codes(&t, 5, c, n);
    svo_packed *p = build(&t, SVO_LAYOUT_FAST, true, 1, NULL);
    if (p != NULL) {
        const svo_view *v = svo_packed_view(p);
        CHECK_U64(svo_view_stored(v, 2), 1); /* blocks */
        CHECK(v->brick_count <= 8);
        CHECK_U64(v->nodes[5], 64 * used);
        svo_packed_free(p);
    }
    compare_and_free(&t);
}

/* A subtree of 8^3 shared 10^6 times and more: by its size, without building the voxels. */
static svo_result shared_chunks(svo_dag_builder *b, const svo_tree_info *info, const tree *part, svo_error *err)
{
    svo_chunk_sink sink = svo_dag_builder_sink(b);
    svo_buffer masks;
    svo_buffer_init(&masks, NULL);
    svo_chunk chunk;
    tree_chunk(part, 0, &masks, &chunk);
    svo_result r = SVO_OK;
    uint64_t chunks = (uint64_t)1 << 3 * svo_chunk_level(info->depth);
    for (uint64_t i = 0; i < chunks && r == SVO_OK; i++) {
        void *blob;
        chunk.code = i, chunk.depth = info->depth, chunk.level = svo_chunk_level(info->depth);
        r = sink.encode(sink.user, &chunk, 0, &blob, err);
        if (r == SVO_OK) r = sink.commit(sink.user, blob, err);
    }
    svo_buffer_free(&masks);
    return r;
}

TEST(a_subtree_shared_a_million_times)
{
    enum { CELLS = 12 };
    uint64_t *c = new_codes(4096 * CELLS), n = 0, seed = 9, cells[CELLS];
    for (int i = 0; i < CELLS; i++) cells[i] = test_random(&seed) & 0x1ff;
    for (uint64_t place = 0; place < 4096; place++) /* 4096 times in a chunk of 128^3, 512 chunks: 2 million */
        for (int i = 0; i < CELLS; i++) c[n++] = place << 9 | cells[i];
    tree t;
    set_codes(&t, 7, c, n);
    t.info.channel_count = 0;
    svo_tree_info info = t.info;
    info.depth = 10;
    svo_packed *p[2] = {NULL, NULL};
    for (int k = 0; k < 2; k++) {
        svo_error err = {0};
        svo_dag_options o = {.geometry = k == 0 ? SVO_GEOMETRY_SVDAG : SVO_GEOMETRY_FAST, .lod = true};
        svo_dag_builder *b;
        CHECK_OK(svo_dag_builder_create(&info, &o, &b, &err));
        CHECK_OK(shared_chunks(b, &info, &t, &err));
        CHECK_OK(svo_dag_builder_finish(b, &p[k], NULL, &err));
        CHECK_OK(svo_view_validate(svo_packed_view(p[k]), NULL, &err));
    }
    const svo_view *v = svo_packed_view(p[1]);
    CHECK_U64(v->nodes[7], (uint64_t)1 << 21);
    for (uint32_t l = 0; l <= 7; l++) CHECK(svo_view_stored(v, l) <= 1);
    CHECK(v->fast.tree_bytes + 8 * v->brick_count < 1000);
    for (int i = 0; i < 20000; i++) {
        uint64_t code = test_random(&seed) & (((uint64_t)1 << 30) - 1), a = 0, b = 0;
        uint32_t x, y, z;
        if (i % 2) code = (code & ~(uint64_t)0x1ff) | cells[i % CELLS];
        svo_morton_decode(code, &x, &y, &z);
        CHECK(svo_view_voxel(svo_packed_view(p[0]), x, y, z, &a) == svo_view_voxel(v, x, y, z, &b) && a == b);
    }
    svo_packed_free(p[0]);
    svo_packed_free(p[1]);
    t.info.channel_count = 1;
    tree_free(&t);
}

TEST(a_full_block_and_a_plane)
{
    uint64_t *c = new_codes((uint64_t)1 << 15);
    for (uint64_t i = 0; i < (uint64_t)1 << 15; i++) c[i] = i;
    tree t;
    set_codes(&t, 5, c, (uint64_t)1 << 15);
    compare_and_free(&t);
    c = new_codes((uint64_t)1 << 14);
    for (uint32_t i = 0; i < 1u << 14; i++) c[i] = svo_morton_encode(77, i & 127, i >> 7);
    set_codes(&t, 7, c, (uint64_t)1 << 14);
    compare_and_free(&t);
}

/* The same bytes for any number of threads. */
TEST(threads_do_not_show)
{
    uint64_t seed = 12, *c = new_codes(200000);
    for (int i = 0; i < 200000; i++) c[i] = test_random(&seed) % 3 ? test_random(&seed) & 0x7ffff : test_random(&seed) & 0x7ffffff;
    tree t;
    set_codes(&t, 9, c, 200000);
    svo_packed *one = build(&t, SVO_LAYOUT_FAST, true, 1, NULL), *many = build(&t, SVO_LAYOUT_FAST, true, 5, NULL);
    if (!test_failed()) CHECK(svo_view_compare_geometry(svo_packed_view(one), svo_packed_view(many)) == 0);
    svo_packed_free(one);
    svo_packed_free(many);
    tree_free(&t);
}

/* Without memory for the tables there are none, and nothing else changes. */
TEST(tables_without_memory)
{
    uint64_t seed = 14;
    tree t;
    tree_random(&t, 8, 1, &seed);
    svo_packed *p = build(&t, SVO_LAYOUT_FAST, true, 1, NULL), *plain = build(&t, SVO_LAYOUT_PLAIN, true, 1, NULL);
    svo_view v = *svo_packed_view(p);
    CHECK(v.top != NULL && v.top->record != NULL);
    bool all = false;
    for (uint64_t fail = 1; !all && !test_failed(); fail++) {
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = fail;
        v.top = NULL;
        svo_view_accelerate(&v, &a.base);
        all = v.top != NULL && v.top->record != NULL;
        same_places(svo_packed_view(plain), &v, &t, &seed);
        svo_view_release(&v, &a.base);
        CHECK(v.top == NULL && svo_limit_in_use(&a) == 0);
        CHECK(fail < 20);
    }
    for (uint64_t fail = 1; fail < 10 && !test_failed(); fail++) { /* the same with sizes */
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = fail;
        v.top = NULL;
        v.top = svoi_top_make(&v, 600, 0, &a.base);
        same_places(svo_packed_view(plain), &v, &t, &seed);
        svoi_top_free(v.top, &a.base);
        CHECK(svo_limit_in_use(&a) == 0);
    }
    v.top = NULL;
    tree_free(&t);
    svo_packed_free(p);
    svo_packed_free(plain);
}

/* Any bit of the tree or the dictionary changed: refused, or as sound an octree. */
typedef struct seen { uint64_t count, last; const svo_view *v; bool sound; } seen;
static bool see(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    seen *s = user;
    uint64_t code = svo_morton_encode(x, y, z), same;
    if (index >= s->v->attribute_count || (s->count != 0 && code <= s->last) || (x | y | z) >> s->v->depth != 0) s->sound = false;
    if (!svo_view_voxel(s->v, x, y, z, &same) || same != index) s->sound = false;
    s->last = code;
    s->count++;
    return s->sound;
}

TEST(changed_bits_are_refused)
{
    uint64_t seed = 13;
    tree t;
    tree_random(&t, 8, 1, &seed);
    svo_packed *p = build(&t, SVO_LAYOUT_FAST, true, 1, NULL);
    tree_free(&t);
    if (p == NULL) return;
    svo_view v = *svo_packed_view(p);
    v.top = NULL; /* made anew of every tree that is accepted */
    uint64_t bits = 8 * v.fast.tree_bytes, accepted = 0, tried = 0, step = bits / 6000 + 1;
    for (uint64_t i = 0; i < bits && !test_failed(); i += 1 + test_random(&seed) % (2 * step)) {
        uint8_t *byte = (uint8_t *)(uintptr_t)v.fast.tree + i / 8;
        svo_error err = {0};
        *byte ^= (uint8_t)(1 << i % 8);
        tried++;
        if (svo_view_validate(&v, NULL, &err) == SVO_OK) {
            seen s = {.v = &v, .sound = true};
            accepted++;
            svo_view_accelerate(&v, NULL);
            svo_view_voxels(&v, see, &s);
            CHECK(s.sound && s.count == v.nodes[8]);
            svo_view_release(&v, NULL);
        } else CHECK_MSG(strstr(err.message, "DAG-") != NULL, "'%s' names no rule", err.message);
        *byte ^= (uint8_t)(1 << i % 8);
    }
    CHECK_MSG(accepted < tried / 2, "%llu of %llu changes accepted", (unsigned long long)accepted, (unsigned long long)tried);
    svo_packed_free(p);
}
