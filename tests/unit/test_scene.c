/* Scenes: bounds of octrees, packing into pages, .svscene files. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmt_scene.h"
#include "packer.h"
#include "svo_morton.h"
#include "svo_pack.h"
#include "test.h"

/* Of the processor, not of the clock on the wall: how busy the machine is says nothing about the code. */
static double cpu_seconds(void) { return (double)clock() / CLOCKS_PER_SEC; }

static svo_error err;

/* ---- octrees to make scenes of ---- */

static void colour_of(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    uint8_t base = *(const uint8_t *)user;
    (void)channel;
    out[0] = (uint8_t)(base + x), out[1] = (uint8_t)(base + y), out[2] = (uint8_t)(base + z);
}

/* `count` random voxels (0: empty) at a place and edge in mesh coordinates, with a colour channel. */
static svo_view *asset(uint32_t depth, uint64_t count, double at, double edge, uint8_t base, uint64_t seed)
{
    uint64_t *codes = calloc(count + 1, sizeof *codes);
    for (uint64_t i = 0; i < count; i++) codes[i] = test_random(&seed) & (((uint64_t)1 << (3 * depth)) - 1);
    double matrix[16] = {edge, 0, 0, at, 0, edge, 0, at, 0, 0, edge, at, 0, 0, 0, 1};
    packer_options o = {.lod = true, .share = true, .voxel_to_world = matrix, .channel_count = 1, .value = colour_of, .user = &base};
    strcpy(o.channels[0].name, "color");
    o.channels[0].kind = SVO_KIND_COLOR_SRGB8;
    svo_view *v = packer_make(depth, codes, count, &o);
    free(codes);
    return v;
}

typedef struct extent { bool any; uint32_t low[3], high[3]; } extent;
static bool extend(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    extent *e = user;
    uint32_t p[3] = {x, y, z};
    (void)index;
    for (int k = 0; k < 3; k++) {
        if (!e->any || p[k] < e->low[k]) e->low[k] = p[k];
        if (!e->any || p[k] > e->high[k]) e->high[k] = p[k];
    }
    e->any = true;
    return true;
}

TEST(grid_bounds_are_those_of_the_voxels)
{
    uint64_t seed = 5;
    for (uint32_t depth = 0; depth <= 8; depth++)
        for (uint64_t round = 0; round < 12; round++) {
            uint64_t count = round * round;
            if (depth == 0 && count > 1) count = 1;
            svo_view *v = asset(depth, count, 0, 1, 0, test_random(&seed));
            extent e = {0};
            svo_view_voxels(v, extend, &e);
            bool any;
            uint32_t low[3], high[3];
            CHECK_OK(svo_view_grid_bounds(v, NULL, &any, low, high, &err));
            CHECK(any == e.any);
            for (int k = 0; k < 3 && any; k++) CHECK_MSG(low[k] == e.low[k] && high[k] == e.high[k], "depth %u count %u axis %d: %u..%u, not %u..%u",
                                                         depth, (unsigned)count, k, low[k], high[k], e.low[k], e.high[k]);
            packer_free(v);
        }
}

/* A plane of voxels one layer inside the grid, at the greatest depth: 4^20 of them in a few nodes. */
TEST(grid_bounds_take_time_by_stored_nodes)
{
    uint32_t words[SVO_MAX_DEPTH][16];
    uint64_t bricks[2];
    svo_view v = {.depth = 21, .tree_depth = 21, .brick_level = 19, .lod = false, .brick_count = 1, .bricks = bricks};
    bricks[0] = 0;
    for (uint32_t b = 0; b < 64; b++)
        if (((b >> 0 & 1) | (b >> 2 & 2)) == 1) bricks[0] |= (uint64_t)1 << b; /* x == 1 */
    for (uint32_t l = 0; l < 19; l++) {
        words[l][0] = 0x55;
        for (int i = 1; i <= 4; i++) words[l][i] = 0;
        for (int i = 5; i <= 7; i++) words[l][i] = 0; /* offsets: not used here */
        v.levels[l].words = words[l], v.levels[l].word_count = 8, v.levels[l].node_count = 1, v.levels[l].offset_words = 1;
    }
    bool any;
    uint32_t low[3], high[3];
    double start = cpu_seconds();
    CHECK_OK(svo_view_grid_bounds(&v, NULL, &any, low, high, &err));
    CHECK(any && low[0] == 1 && high[0] == 1 && low[1] == 0 && high[1] == (1u << 21) - 1 && low[2] == 0 && high[2] == (1u << 21) - 1);
    CHECK(cpu_seconds() - start < 1);
}

TEST(box_transform_holds_every_point)
{
    uint64_t seed = 9;
    for (int round = 0; round < 2000; round++) {
        svo_mat4 m = svo_mat4_identity();
        double scale = ldexp(1, (int)(test_random(&seed) % 60) - 30);
        for (int i = 0; i < 12; i++) m.m[i] = (test_random_unit(&seed) * 2 - 1) * scale;
        double low[3], high[3], a[3], b[3];
        for (int k = 0; k < 3; k++) low[k] = floor(test_random_unit(&seed) * 100), high[k] = low[k] + floor(test_random_unit(&seed) * 50);
        svo_box_transform(&m, low, high, 16, a, b);
        for (int p = 0; p < 27; p++) {
            double t[3] = {(p % 3) / 2.0, (p / 3 % 3) / 2.0, (p / 9) / 2.0};
            svo_vec3 q = svo_mat4_point(&m, svo_v3(low[0] + t[0] * (high[0] - low[0]), low[1] + t[1] * (high[1] - low[1]), low[2] + t[2] * (high[2] - low[2])));
            CHECK(q.x >= a[0] && q.x <= b[0] && q.y >= a[1] && q.y <= b[1] && q.z >= a[2] && q.z <= b[2]);
        }
    }
}

TEST(a_single_octree_is_a_scene)
{
    svo_view *v = asset(5, 40, 7, 0.25, 3, 1), *empty = asset(5, 0, 0, 1, 0, 1);
    svo_scene_one one, none;
    CHECK_OK(svo_scene_single(v, "a", NULL, &one, &err));
    CHECK_OK(svo_scene_single(empty, "b", NULL, &none, &err));
    CHECK(one.scene.instance_count == 1 && one.scene.page_count == 1 && none.scene.instance_count == 0 && none.scene.page_count == 0);
    CHECK(strcmp(svo_scene_instance_name(&one.scene, 0), "") == 0 && strcmp(one.scene.asset_names[0], "a") == 0);
    extent e = {0};
    svo_view_voxels(v, extend, &e);
    for (int k = 0; k < 3; k++) {
        CHECK(fabs(one.page.low[k] - (7 + 0.25 * e.low[k])) < 1e-12 && one.page.low[k] <= 7 + 0.25 * e.low[k]);
        CHECK(fabs(one.page.high[k] - (7 + 0.25 * (e.high[k] + 1))) < 1e-12 && one.page.high[k] >= 7 + 0.25 * (e.high[k] + 1));
    }
    packer_free(v);
    packer_free(empty);
}

/* ---- packing ---- */

enum { ASSETS = 6 }; /* 0, 1 different; 2 empty; 3 unused; 4 equals 1; 5 far from its origin */
typedef struct world {
    svo_view *views[ASSETS];
    const svo_view *pointers[ASSETS];
    const char *names[ASSETS];
    svo_place *places;
    svo_buffer text;
    svo_pack_input input;
} world;

static void random_transform(uint64_t *seed, double spread, double t[12])
{
    double p[3], q[4], s[3];
    for (int k = 0; k < 3; k++) p[k] = (test_random_unit(seed) - 0.5) * spread, s[k] = (0.2 + test_random_unit(seed)) * (test_random(seed) % 8 ? 1 : -1);
    for (int k = 0; k < 4; k++) q[k] = test_random_unit(seed) - 0.5;
    svo_mat4 m = svo_mat4_trs(p, q, s);
    memcpy(t, m.m, 12 * sizeof *t);
}

static void world_make(world *w, uint64_t count, double spread, uint64_t seed)
{
    memset(w, 0, sizeof *w);
    static const char *names[ASSETS] = {"tree", "stone", "nothing", "spare", "pebble", "far \xc3\xa4"};
    w->views[0] = asset(4, 60, 0, 0.1, 10, 1);
    w->views[1] = asset(3, 30, -1, 0.5, 20, 2);
    w->views[2] = asset(3, 0, 0, 1, 0, 3);
    w->views[3] = asset(3, 20, 0, 1, 30, 4);
    w->views[4] = asset(3, 30, -1, 0.5, 20, 2);
    w->views[5] = asset(4, 50, 1e9, 1e-3, 40, 5);
    svo_buffer_init(&w->text, NULL);
    svo_buffer_append(&w->text, "", 1);
    w->places = calloc(count + 1, sizeof *w->places);
    for (uint64_t i = 0; i < count; i++) {
        svo_place *p = &w->places[i];
        uint64_t kind = test_random(&seed) % 20;
        if (i < ASSETS) kind = (const uint64_t[ASSETS]){0, 8, 14, 15, 18, 15}[i]; /* each at least once */
        p->asset = kind < 8 ? 0 : kind < 14 ? 1 : kind < 15 ? 2 : kind < 18 ? 4 : 5;
        p->id = 1000 + i;
        random_transform(&seed, spread, p->transform);
        if (p->asset == 5) {
            /* Place the far asset's grid near the scene's origin, without rotation, where doubles can hold it. */
            static const double move[12] = {1, 0, 0, -1e9, 0, 1, 0, -1e9, 0, 0, 1, -1e9};
            memcpy(p->transform, move, sizeof move);
        }
        if (test_random(&seed) % 3 == 0) {
            char name[24];
            snprintf(name, sizeof name, "n%u", (unsigned)(test_random(&seed) % 7));
            p->name = (uint32_t)w->text.size;
            svo_buffer_append(&w->text, name, strlen(name) + 1);
        }
    }
    for (int a = 0; a < ASSETS; a++) w->pointers[a] = w->views[a], w->names[a] = names[a];
    w->pointers[3] = NULL; /* as for an asset that was never opened */
    w->input = (svo_pack_input){.asset_count = ASSETS, .assets = w->pointers, .asset_names = w->names, .place_count = count, .places = w->places,
                                .names = (const char *)w->text.data, .names_size = w->text.size};
}

static void world_free(world *w)
{
    for (int a = 0; a < ASSETS; a++) packer_free(w->views[a]);
    free(w->places);
    svo_buffer_free(&w->text);
}

typedef struct inside { const svo_scene_page *page; svo_mat4 m; bool all; } inside;
static bool voxel_inside(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    inside *in = user;
    (void)index;
    for (int c = 0; c < 8; c++) {
        svo_vec3 p = svo_mat4_point(&in->m, svo_v3(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2 & 1)));
        double q[3] = {p.x, p.y, p.z};
        for (int k = 0; k < 3; k++) in->all = in->all && q[k] >= in->page->low[k] && q[k] <= in->page->high[k];
    }
    return in->all;
}

/* Every promise of svo_pack, on the result for a world. `error` bounds the error of a grid point's place. */
static void check_packed(const world *w, const svo_packed_scene *packed, uint64_t page_instances, double error)
{
    const svo_scene *s = svo_packed_scene_get(packed);
    const svo_pack_report *r = svo_packed_scene_report(packed);
    uint64_t expected = 0;
    for (uint64_t i = 0; i < w->input.place_count; i++) expected += w->places[i].asset != 2;
    CHECK_U64(s->instance_count, expected);
    CHECK_U64(r->kept, expected);
    CHECK_U64(r->dropped_empty, w->input.place_count - expected);
    CHECK(s->asset_count == 3 && r->assets[2].fate == SVO_PACK_EMPTY && r->assets[3].fate == SVO_PACK_UNUSED);
    CHECK(r->assets[4].fate == SVO_PACK_EQUAL && r->assets[4].packed == r->assets[1].packed);
    CHECK(r->assets[5].moved && !r->assets[0].moved);
    bool *seen = calloc(w->input.place_count, sizeof *seen);
    uint64_t next = 0;
    bool good = true;
    for (uint32_t p = 0; p < s->page_count && good; p++) {
        const svo_scene_page *page = &s->pages[p];
        uint64_t before = 0;
        good = page->first == next && page->count >= 1 && page->count <= page_instances && (page->count == page_instances || p + 1 == s->page_count);
        next += page->count;
        for (uint64_t i = page->first; i < next && good; i++) {
            uint64_t source = s->instance_id[i] - 1000;
            const svo_place *place = &w->places[source];
            good = source < w->input.place_count && !seen[source] && (i == page->first || source > before);
            good = good && s->instance_asset[i] == r->assets[place->asset].packed;
            good = good && strcmp(svo_scene_instance_name(s, i), (const char *)w->text.data + place->name) == 0;
            seen[source] = true, before = source;
            const svo_view *view = s->assets[s->instance_asset[i]];
            svo_mat4 grid, original, t = svo_scene_instance_transform(s, p, i);
            memcpy(grid.m, view->voxel_to_world, sizeof grid.m);
            inside in = {page, svo_mat4_mul(t, grid), true};
            svo_view_voxels(view, voxel_inside, &in);
            good = good && in.all;
            /* The product of both matrices is that of the input, in all corners of the grid. */
            svo_mat4 wanted = svo_mat4_identity();
            memcpy(wanted.m, place->transform, sizeof place->transform);
            memcpy(original.m, w->views[place->asset]->voxel_to_world, sizeof original.m);
            double size = ldexp(1, (int)view->depth);
            for (int c = 0; c < 8 && good; c++) {
                svo_vec3 g = svo_v3(size * (c & 1), size * (c >> 1 & 1), size * (c >> 2 & 1));
                svo_vec3 q = svo_mat4_point(&original, g), a = svo_mat4_point(&wanted, q), b = svo_mat4_point(&in.m, g);
                /* (doubles themselves lose 1e9 * 2^-52 for the far asset) */
                good = svo_length(svo_sub(a, b)) <= error + (place->asset == 5 ? 1e-6 : 0);
            }
        }
    }
    free(seen);
    CHECK(good);
    CHECK_U64(next, s->instance_count);
}

TEST(packing_keeps_what_is_needed_where_it_is)
{
    static const uint64_t counts[] = {1, 7, 64, 65, 1000};
    for (int i = 0; i < 5; i++) {
        world w;
        world_make(&w, counts[i] + 40, i % 2 ? 100 : 1e4, 77 + (uint64_t)i);
        svo_pack_options o = {.page_instances = 64};
        svo_packed_scene *packed;
        CHECK_OK(svo_pack(&w.input, &o, &packed, &err));
        check_packed(&w, packed, 64, i % 2 ? 3e-5 : 3e-3);
        CHECK(svo_packed_scene_report(packed)->translation_error <= (i % 2 ? 1e-5 : 1e-3));
        svo_packed_scene_free(packed);
        world_free(&w);
    }
}

static bool same_scene(const svo_scene *a, const svo_scene *b)
{
    uint64_t n = a->instance_count;
    return n == b->instance_count && a->page_count == b->page_count && a->names_size == b->names_size && memcmp(a->names, b->names, a->names_size) == 0 &&
           memcmp(a->instance_asset, b->instance_asset, n * 4) == 0 && memcmp(a->instance_transform, b->instance_transform, n * 48) == 0 &&
           memcmp(a->instance_id, b->instance_id, n * 8) == 0 && memcmp(a->instance_name, b->instance_name, n * 4) == 0 &&
           memcmp(a->pages, b->pages, a->page_count * sizeof *a->pages) == 0;
}

TEST(packing_does_not_depend_on_threads)
{
    world w;
    world_make(&w, 20000, 1000, 3);
    svo_packed_scene *first = NULL, *again;
    for (uint32_t threads = 1; threads <= 7; threads += threads == 1 ? 1 : 5) {
        svo_pack_options o = {.threads = threads, .page_instances = 100};
        CHECK_OK(svo_pack(&w.input, &o, &again, &err));
        if (first == NULL) first = again;
        else {
            CHECK(same_scene(svo_packed_scene_get(first), svo_packed_scene_get(again)));
            svo_packed_scene_free(again);
        }
    }
    svo_packed_scene_free(first);
    world_free(&w);
}

/* A grid of instances in random order: pages of a k-d tree are compact, so they hardly overlap. */
TEST(pages_are_compact)
{
    svo_view *v = asset(2, 64 * 8, 0, 0.25, 0, 1); /* nearly the unit cube */
    const svo_view *views[1] = {v};
    const char *names[1] = {"cube"};
    uint64_t n = 40 * 40 * 40, seed = 1;
    svo_place *places = calloc(n, sizeof *places);
    for (uint64_t i = 0; i < n; i++) {
        static const double identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
        memcpy(places[i].transform, identity, sizeof identity);
        places[i].transform[3] = (double)(i % 40), places[i].transform[7] = (double)(i / 40 % 40), places[i].transform[11] = (double)(i / 1600);
    }
    for (uint64_t i = n - 1; i > 0; i--) {
        uint64_t j = test_random(&seed) % (i + 1);
        svo_place swap = places[i];
        places[i] = places[j], places[j] = swap;
    }
    for (uint64_t i = 0; i < n; i++) places[i].id = i;
    svo_pack_input in = {.asset_count = 1, .assets = views, .asset_names = names, .place_count = n, .places = places};
    svo_pack_options o = {.page_instances = 500};
    svo_packed_scene *packed;
    CHECK_OK(svo_pack(&in, &o, &packed, &err));
    const svo_scene *s = svo_packed_scene_get(packed);
    CHECK_U64(s->page_count, 128);
    double volume = 0;
    for (uint32_t p = 0; p < s->page_count; p++) {
        const svo_scene_page *g = &s->pages[p];
        volume += (g->high[0] - g->low[0]) * (g->high[1] - g->low[1]) * (g->high[2] - g->low[2]);
        CHECK(g->origin[0] == 0 && g->origin[1] == 0 && g->origin[2] == 0); /* integers are exact as they are */
    }
    CHECK_MSG(volume < 1.6 * 40 * 40 * 40, "pages take %g of the scene's volume", volume / 64000);
    CHECK(s->instance_name == NULL);
    svo_packed_scene_free(packed);
    free(places);
    packer_free(v);
}

static svo_place place_at(double x, double y, double z, double scale)
{
    svo_place p = {.transform = {scale, 0, 0, x, 0, scale, 0, y, 0, 0, scale, z}};
    return p;
}

TEST(extreme_scenes_pack)
{
    svo_view *v = asset(3, 20, 0, 1, 0, 1);
    const svo_view *views[1] = {v};
    const char *names[1] = {"a"};
    uint64_t n = 100000;
    svo_place *places = calloc(n, sizeof *places);
    svo_pack_input in = {.asset_count = 1, .assets = views, .asset_names = names, .place_count = n, .places = places};
    svo_packed_scene *packed;
    /* all in one place */
    for (uint64_t i = 0; i < n; i++) places[i] = place_at(1, 2, 3, 1), places[i].id = i;
    CHECK_OK(svo_pack(&in, NULL, &packed, &err));
    CHECK_U64(svo_packed_scene_get(packed)->page_count, (n + 1023) / 1024);
    for (uint64_t i = 0; i < n; i++) CHECK_U64(svo_packed_scene_get(packed)->instance_id[i], i);
    svo_packed_scene_free(packed);
    /* distances and scales over the whole range of single precision */
    for (uint64_t i = 0; i < n; i++) places[i] = place_at(ldexp(i % 2 ? 1 : -1, (int)(i % 240) - 120), 0, 0, ldexp(1, (int)(i % 200) - 100)), places[i].id = i;
    CHECK_OK(svo_pack(&in, NULL, &packed, &err));
    CHECK_U64(svo_packed_scene_get(packed)->instance_count, n);
    svo_packed_scene_free(packed);
    /* no instance at all; hidden, flat and mirrored ones */
    in.place_count = 0;
    CHECK_OK(svo_pack(&in, NULL, &packed, &err));
    CHECK(svo_packed_scene_get(packed)->page_count == 0 && svo_packed_scene_get(packed)->asset_count == 0);
    svo_packed_scene_free(packed);
    in.place_count = 4;
    for (int i = 0; i < 4; i++) places[i] = place_at(0, 0, 0, 1);
    places[0].transform[0] = places[0].transform[5] = places[0].transform[10] = 0;
    places[1].transform[5] = 0;
    places[2].transform[0] = -1;
    places[3].transform[0] = 1e-6, places[3].transform[5] = 1e6;
    svo_warnings warnings = {0};
    svo_pack_options o = {.warnings = &warnings};
    CHECK_OK(svo_pack(&in, &o, &packed, &err));
    const svo_pack_report *r = svo_packed_scene_report(packed);
    CHECK(r->kept == 2 && r->dropped_hidden == 1 && r->dropped_flat == 1 && warnings.count == 1);
    svo_packed_scene_free(packed);
    /* transforms that cannot be stored */
    static const double no_numbers[] = {NAN, INFINITY, -INFINITY, 1e39, -1e300};
    for (int k = 0; k < 5; k++)
        for (int e = 0; e < 12; e++) {
            places[2] = place_at(0, 0, 0, 1);
            places[2].transform[e] = no_numbers[k];
            CHECK_RESULT(svo_pack(&in, NULL, &packed, &err), SVO_INVALID_DATA);
            CHECK_U64(err.index, 2);
        }
    free(places);
    packer_free(v);
}

TEST(packing_survives_failing_allocations)
{
    world w;
    world_make(&w, 200, 10, 5);
    for (uint64_t n = 1;; n++) {
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, (uint64_t)1 << 30, NULL);
        a.fail_at = n;
        svo_pack_options o = {.allocator = &a.base, .threads = 2};
        svo_packed_scene *packed;
        svo_result result = svo_pack(&w.input, &o, &packed, &err);
        if (result == SVO_OK) svo_packed_scene_free(packed);
        CHECK_U64(svo_limit_in_use(&a), 0);
        if (result == SVO_OK) break;
        CHECK(result == SVO_OUT_OF_MEMORY && n < 100);
    }
    world_free(&w);
}

/* ---- files ---- */

static void write_world(const world *w, const svo_pack_options *o, const char *provenance, svo_buffer *file, fmt_scene_bytes *bytes)
{
    svo_packed_scene *packed;
    fmt_output *out;
    CHECK_OK(svo_pack(&w->input, o, &packed, &err));
    CHECK_OK(fmt_output_open_memory(file, &out, &err));
    CHECK_OK(fmt_scene_write(out, svo_packed_scene_get(packed), provenance, NULL, bytes, NULL, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    svo_packed_scene_free(packed);
}

TEST(a_file_gives_back_the_scene)
{
    for (int camera = 0; camera < 2; camera++) {
        world w;
        world_make(&w, 700, 50, 21);
        if (camera) w.input.has_camera = true, w.input.camera_transform = svo_mat4_trs((double[3]){1, 2, 3}, (double[4]){0, 0, 1, 1}, (double[3]){1, 1, 1}), w.input.camera_yfov = 0.7;
        svo_pack_options o = {.page_instances = 64};
        svo_buffer file, again;
        svo_buffer_init(&file, NULL);
        svo_buffer_init(&again, NULL);
        fmt_scene_bytes bytes;
        write_world(&w, &o, "{\"tool\":\"test\"}", &file, &bytes);
        if (test_failed()) return;
        CHECK_U64(bytes.assets + bytes.instances + bytes.pages + bytes.names + bytes.rest, file.size);
        fmt_scene f;
        svo_packed_scene *packed;
        CHECK_OK(fmt_scene_open(file.data, file.size, NULL, &f, &err));
        CHECK_OK(svo_pack(&w.input, &o, &packed, &err));
        const svo_scene *s = svo_packed_scene_get(packed);
        CHECK_U64(f.scene.instance_count, s->instance_count);
        CHECK(memcmp(f.scene.instance_transform, s->instance_transform, s->instance_count * 48) == 0);
        CHECK(memcmp(f.scene.instance_id, s->instance_id, s->instance_count * 8) == 0);
        CHECK(memcmp(f.scene.pages, s->pages, s->page_count * sizeof *s->pages) == 0);
        for (uint64_t i = 0; i < s->instance_count; i++) CHECK(strcmp(svo_scene_instance_name(&f.scene, i), svo_scene_instance_name(s, i)) == 0);
        CHECK(f.scene.asset_count == 3 && strcmp(f.scene.asset_names[2], "far \xc3\xa4") == 0 && strcmp(f.provenance, "{\"tool\":\"test\"}") == 0);
        CHECK(f.scene.has_camera == (camera == 1));
        if (camera) CHECK(f.scene.camera_yfov == 0.7 && memcmp(&f.scene.camera_transform, &w.input.camera_transform, sizeof(svo_mat4)) == 0);
        for (uint32_t a = 0; a < 3; a++) {
            const svo_view *x = f.scene.assets[a], *y = s->assets[a];
            CHECK(x->attribute_count == y->attribute_count && x->brick_count == y->brick_count && memcmp(x->bricks, y->bricks, y->brick_count * 8) == 0);
            for (uint64_t i = 0; i < y->attribute_count; i++) {
                uint8_t p[8] = {0}, q[8] = {0};
                svo_view_attribute(x, 0, i, p);
                svo_view_attribute(y, 0, i, q);
                CHECK(memcmp(p, q, 8) == 0);
            }
        }
        /* A mapped scene written again has the same bytes. */
        fmt_output *out;
        CHECK_OK(fmt_output_open_memory(&again, &out, &err));
        CHECK_OK(fmt_scene_write(out, &f.scene, f.provenance, NULL, NULL, NULL, &err));
        CHECK_OK(fmt_output_commit(out, &err));
        CHECK(again.size == file.size && memcmp(again.data, file.data, file.size) == 0);
        fmt_scene_close(&f);
        fmt_scene_close(&f);
        svo_packed_scene_free(packed);
        svo_buffer_free(&file);
        svo_buffer_free(&again);
        world_free(&w);
    }
}

TEST(a_scene_of_one_octree_and_an_empty_one_can_be_written)
{
    svo_view *views[2] = {asset(5, 40, 7, 0.25, 3, 1), asset(5, 0, 0, 1, 0, 1)};
    for (int i = 0; i < 2; i++) {
        svo_scene_one one;
        CHECK_OK(svo_scene_single(views[i], "a", NULL, &one, &err));
        if (i == 1) one.scene.asset_count = 0; /* (an asset without instances cannot be stored) */
        svo_buffer file;
        svo_buffer_init(&file, NULL);
        fmt_output *out;
        CHECK_OK(fmt_output_open_memory(&file, &out, &err));
        CHECK_OK(fmt_scene_write(out, &one.scene, NULL, NULL, NULL, NULL, &err));
        CHECK_OK(fmt_output_commit(out, &err));
        fmt_scene f;
        CHECK_OK(fmt_scene_open(file.data, file.size, NULL, &f, &err));
        CHECK(f.scene.instance_count == (i == 0) && f.scene.asset_count == (i == 0) && f.provenance[0] == 0);
        fmt_scene_close(&f);
        svo_buffer_free(&file);
        packer_free(views[i]);
    }
}

/* What the reader would refuse is not written either. */
TEST(a_bad_scene_is_not_written)
{
    world w;
    world_make(&w, 300, 50, 2);
    svo_packed_scene *packed;
    CHECK_OK(svo_pack(&w.input, NULL, &packed, &err));
    svo_scene good = *svo_packed_scene_get(packed);
    uint64_t n = good.instance_count;
    for (int what = 0; what < 12; what++) {
        svo_scene s = good;
        uint32_t *assets = malloc(n * 4), *names = malloc(n * 4);
        float *transforms = malloc(n * 48);
        svo_scene_page page = good.pages[0];
        char *text = malloc(good.names_size);
        memcpy(assets, good.instance_asset, n * 4), memcpy(names, good.instance_name, n * 4), memcpy(transforms, good.instance_transform, n * 48);
        memcpy(text, good.names, good.names_size);
        s.instance_asset = assets, s.instance_name = names, s.instance_transform = transforms, s.pages = &page, s.names = text;
        CHECK_U64(s.page_count, 1);
        switch (what) {
        case 0: assets[5] = s.asset_count; break;
        case 1: for (uint64_t i = 0; i < n; i++) assets[i] = 0; break;
        case 2: transforms[12 * 9 + 4] = NAN; break;
        case 3: memset(transforms + 24, 0, 48); break;
        case 4: page.count--; break;
        case 5: page.first = 1; break;
        case 6: page.low[1] += 1; break;
        case 7: page.high[2] = INFINITY; break;
        case 8: names[3] = (uint32_t)s.names_size; break;
        case 9: names[3] = 2; break;
        case 10: text[1] = (char)0xff; break;
        case 11: s.has_camera = true; s.camera_yfov = 4; s.camera_transform = svo_mat4_identity(); break;
        }
        svo_buffer file;
        svo_buffer_init(&file, NULL);
        fmt_output *out;
        CHECK_OK(fmt_output_open_memory(&file, &out, &err));
        CHECK_MSG(fmt_scene_write(out, &s, NULL, NULL, NULL, NULL, &err) == SVO_INVALID_ARGUMENT, "case %d: %s", what, err.message);
        CHECK_U64(fmt_output_offset(out), 0);
        fmt_output_discard(out);
        svo_buffer_free(&file);
        free(assets), free(names), free(transforms), free(text);
    }
    svo_packed_scene_free(packed);
    world_free(&w);
}
