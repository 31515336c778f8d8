/* Damaged .svdag files are refused with a message, or what is read from them is sound: every voxel lies in the grid,
 * every index is in range and in order, every attribute can be decoded. */
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmt_svdag.h"
#include "hostile.h"
#include "rules_agree.h"
#include "svo_dag.h"
#include "svo_morton.h"
#include "test.h"
#include "trees.h"

/* Of the processor, not of the clock on the wall: how busy the machine is says nothing about the code. */
static double cpu_seconds(void) { return (double)clock() / CLOCKS_PER_SEC; }

typedef struct walk { const svo_view *v; uint64_t voxels, last_code, last_index; bool sound; } walk;

static bool visit(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    walk *w = user;
    uint64_t code = svo_morton_encode(x, y, z), found;
    if ((x | y | z) >> w->v->depth != 0 || (index >= w->v->attribute_count && !w->v->unnumbered)) w->sound = false;
    if (w->voxels != 0 && (code <= w->last_code || (index <= w->last_index && !w->v->unnumbered))) w->sound = false;
    if (w->sound && (!svo_view_voxel(w->v, x, y, z, &found) || found != index)) w->sound = false;
    w->last_code = code;
    w->last_index = index;
    w->voxels++;
    return w->sound && w->voxels < 100000; /* a small file can describe very many */
}

typedef struct averages { const svo_view *v; uint64_t sum; uint32_t left; } averages;

static bool add_average(void *user, uint64_t attribute)
{
    averages *k = user;
    for (uint32_t c = 0; c < k->v->channel_count; c++) {
        uint8_t value[SVO_MAX_STRIDE] = {0};
        svo_view_attribute(k->v, c, attribute, value);
        for (int i = 0; i < 8; i++) k->sum += value[i];
    }
    return --k->left != 0;
}

static svo_result read_svdag(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    (void)user;
    fmt_svdag f;
    svo_result r = fmt_svdag_open(bytes, size, a, &f, err);
    const char *differ = rules_agree(fmt_svdag_violations, bytes, size, a, r, err, true);
    if (differ != NULL) test_fail(__FILE__, __LINE__, "%s", differ);
    if (r != SVO_OK) return r;
    const svo_view *v = &f.view;
    walk w = {.v = v, .sound = true};
    bool all = svo_view_voxels(v, visit, &w);
    if (!w.sound) test_fail(__FILE__, __LINE__, "voxels out of order, outside the grid or with wrong indices");
    if (all && w.voxels != v->nodes[v->depth]) test_fail(__FILE__, __LINE__, "accepted with a wrong number of voxels");
    uint64_t sum = 0;
    for (uint32_t c = 0; c < v->channel_count; c++)
        for (uint64_t i = 0; i < v->attribute_count && i < 100000; i++) {
            uint8_t value[SVO_MAX_STRIDE] = {0};
            svo_view_attribute(v, c, i, value);
            for (int k = 0; k < 8; k++) sum += value[k];
        }
    averages k = {v, 0, 100000};
    if (!v->empty) svo_view_averages(v, 0, svo_view_root(v), add_average, &k);
    sum += k.sum;
    volatile uint64_t keep = sum; /* the sanitizers have seen every byte */
    (void)keep;
    fmt_svdag_close(&f);
    return SVO_OK;
}

/* The file of a tree. */
static void pack_with(tree *t, svo_dag_options o, const char *provenance, svo_buffer *file)
{
    svo_buffer_init(file, NULL);
    svo_error err = {0};
    svo_dag_builder *b;
    svo_packed *p;
    CHECK_OK(svo_dag_builder_create(&t->info, &o, &b, &err));
    CHECK_OK(tree_feed(t, 1, svo_dag_builder_sink(b), &err));
    CHECK_OK(svo_dag_builder_finish(b, &p, NULL, &err));
    fmt_output *out;
    CHECK_OK(fmt_output_open_memory(file, &out, &err));
    CHECK_OK(fmt_svdag_write(out, svo_packed_view(p), provenance, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    svo_packed_free(p);
}

static void pack(tree *t, bool lod, svo_geometry geometry, const char *provenance, svo_buffer *file)
{
    pack_with(t, (svo_dag_options){.lod = lod, .geometry = geometry, .threads = 1}, provenance, file);
}

static void run_with(uint32_t depth, uint32_t style, svo_dag_options o, uint32_t rounds)
{
    uint64_t seed = 200 + depth;
    tree t;
    tree_random(&t, depth, style, &seed);
    /* few values, so that channels become palette blocks of several modes */
    for (uint32_t c = 0; c < t.info.channel_count && style == 1; c++) {
        uint32_t stride = svo_channel_stride(t.info.channels[c].kind);
        for (uint64_t i = 0; i < t.count * stride; i++) t.values[c][i] &= c == 0 || i / stride % 1500 < 700 ? 3 : 0x3f;
    }
    svo_buffer file;
    pack_with(&t, o, "{\"tool\":\"test\"}", &file);
    tree_free(&t);
    hostile_case c = {.read = read_svdag, .bytes = file.data, .size = file.size, .rounds = rounds, .seed = seed};
    hostile_run(&c);
    svo_buffer_free(&file);
}

static void run(uint32_t depth, uint32_t style, bool lod, svo_geometry geometry, uint32_t rounds)
{
    run_with(depth, style, (svo_dag_options){.lod = lod, .geometry = geometry, .threads = 1}, rounds);
}

/* Averages instead of attributes of bricks, and corrections. */
static svo_dag_options averaged(svo_geometry geometry)
{
    return (svo_dag_options){.lod = true, .averaged = true, .geometry = geometry, .color_delta_e = 12, .normal_degrees = 20, .threads = 1};
}

TEST(damaged_averages) { run_with(6, 1, averaged(SVO_GEOMETRY_SVDAG), 300); }
TEST(damaged_averages_of_layout_2) { run_with(6, 1, averaged(SVO_GEOMETRY_FAST), 300); }
TEST(damaged_averages_of_layout_3) { run_with(6, 1, averaged(SVO_GEOMETRY_BEST), 300); }
TEST(damaged_single_voxel) { run(0, 2, true, SVO_GEOMETRY_SVDAG, 0); }
TEST(damaged_brick) { run(2, 0, true, SVO_GEOMETRY_SVDAG, 0); }
TEST(damaged_without_channels) { run(6, 0, true, SVO_GEOMETRY_SVDAG, 0); }
TEST(damaged_without_lod) { run(8, 2, false, SVO_GEOMETRY_SVDAG, 0); }
TEST(damaged_corners_of_a_deep_tree) { run(21, 2, true, SVO_GEOMETRY_SVDAG, 0); }
TEST(damaged_clusters_with_all_channels) { run(8, 1, true, SVO_GEOMETRY_SVDAG, 600); }
TEST(damaged_layout_3_without_channels) { run(6, 0, true, SVO_GEOMETRY_BEST, 0); }
TEST(damaged_layout_3_of_one_block) { run(3, 2, true, SVO_GEOMETRY_SYMMETRIC, 0); }
TEST(damaged_layout_3_of_a_deep_tree) { run(21, 2, true, SVO_GEOMETRY_BEST, 0); }
TEST(damaged_layout_3_without_lod) { run(7, 1, false, SVO_GEOMETRY_BEST, 300); }
TEST(damaged_layout_2_without_channels) { run(6, 0, true, SVO_GEOMETRY_FAST, 0); }
TEST(damaged_layout_2_of_one_block) { run(3, 2, true, SVO_GEOMETRY_FAST, 0); }
TEST(damaged_layout_2_of_a_deep_tree) { run(21, 2, true, SVO_GEOMETRY_FAST, 0); }
TEST(damaged_layout_2_without_lod) { run(7, 1, false, SVO_GEOMETRY_FAST, 300); }
TEST(damaged_layout_2_with_all_channels) { run(8, 1, true, SVO_GEOMETRY_FAST, 300); }

/* Each number in each chunk of each layout claims 2^60 (nodes, values, bytes, positions ...), with right hashes. Nothing may be allocated, or walked, on its word. */
static void claim(hostile_file *h, uint32_t chunk, uint64_t at, uint32_t width, const svo_allocator *counted, const svo_limit_allocator *limit, uint32_t *refused)
{
    hostile_chunk *c = &h->chunks[chunk];
    uint64_t before = c->chunk.element_count, size = c->chunk.stored_size;
    uint8_t kept[8];
    if (width == 0) {
        c->chunk.element_count = (uint64_t)1 << 60;
    } else {
        memcpy(kept, c->payload.data + at, width);
        if (width == 8) fmt_store64(c->payload.data + at, (uint64_t)1 << 60);
        else fmt_store32(c->payload.data + at, UINT32_MAX - 15);
    }
    hostile_touch(c);
    svo_buffer bad;
    svo_buffer_init(&bad, NULL);
    hostile_build(h, &bad);
    svo_error err = {0};
    double start = cpu_seconds();
    svo_result r = read_svdag(NULL, bad.data, bad.size, counted, &err);
    *refused += r != SVO_OK;
    CHECK_MSG(r == SVO_OK || r == SVO_INVALID_DATA || r == SVO_UNSUPPORTED || r == SVO_LIMIT, "chunk %u, %u bytes at %llu: %s: %s", chunk, width,
              (unsigned long long)at, svo_result_name(r), err.message);
    CHECK_MSG(cpu_seconds() - start < 5 && svo_limit_in_use(limit) == 0, "chunk %u, %u bytes at %llu: %g s, %llu bytes left", chunk, width, (unsigned long long)at,
              cpu_seconds() - start, (unsigned long long)svo_limit_in_use(limit));
    svo_buffer_free(&bad);
    if (width == 0) c->chunk.element_count = before;
    else memcpy(c->payload.data + at, kept, width);
    c->chunk.stored_size = size;
}

TEST(claims_of_2_to_the_60)
{
    static const svo_geometry geometries[] = {SVO_GEOMETRY_SVDAG, SVO_GEOMETRY_FAST, SVO_GEOMETRY_SYMMETRIC, SVO_GEOMETRY_BEST};
    for (int g = 0; g < 4 && !test_failed(); g++) {
        uint64_t seed = 900;
        tree t;
        tree_random(&t, 5, 1, &seed);
        svo_buffer file;
        pack(&t, true, geometries[g], NULL, &file);
        tree_free(&t);
        svo_limit_allocator limit;
        svo_limit_allocator_init(&limit, (uint64_t)64 << 20, NULL);
        hostile_file *h = malloc(sizeof *h);
        CHECK(h != NULL);
        hostile_parse(file.data, file.size, h);
        uint32_t refused = 0;
        for (uint32_t k = 0; k < h->count && !test_failed(); k++) {
            uint64_t size = h->chunks[k].payload.size, step = size / 120 / 4 * 4 + 4; /* all of the small tables, a sample of the large streams */
            claim(h, k, 0, 0, &limit.base, &limit, &refused);
            for (uint64_t at = 0; at + 8 <= size && !test_failed(); at += step) claim(h, k, at, 8, &limit.base, &limit, &refused);
            for (uint64_t at = 0; at + 4 <= size && !test_failed(); at += step) claim(h, k, at, 4, &limit.base, &limit, &refused);
        }
        CHECK_MSG(refused > 100, "geometry %d: only %u claims were refused", g, refused);
        hostile_free(h);
        free(h);
        svo_buffer_free(&file);
    }
}

/* A field of a payload changed and the hashes made right again: each rule has its own message. */
typedef struct edit { uint32_t type; uint64_t offset; uint8_t mask; const char *rule; } edit;

TEST(rules_of_corrections)
{
    uint64_t seed = 9;
    svo_error err = {0};
    tree t;
    svo_buffer file;
    tree_random(&t, 6, 1, &seed);
    pack_with(&t, averaged(SVO_GEOMETRY_FAST), NULL, &file);
    tree_free(&t);
    const edit edits[] = {
        {FMT_FOURCC('H', 'E', 'A', 'D'), 12, 4, "DAG"},     /* corrections without averages */
        {FMT_FOURCC('H', 'E', 'A', 'D'), 12, 1, "DAG-02"},  /* averages without lod */
        {FMT_FOURCC('A', 'C', 'O', 'R'), 7, 0x80, "DAG-22"}, /* no such value, and not ascending */
        {FMT_FOURCC('A', 'C', 'O', 'R'), 11, 1, "DAG-22"},  /* an unused byte of a colour */
    };
    for (size_t i = 0; i < sizeof edits / sizeof edits[0]; i++) {
        hostile_file h;
        svo_buffer bad;
        fmt_svdag f;
        svo_buffer_init(&bad, NULL);
        hostile_parse(file.data, file.size, &h);
        hostile_chunk *c = hostile_find(&h, edits[i].type);
        CHECK_MSG(c != NULL && edits[i].offset < c->payload.size, "edit %zu: no such chunk", i);
        if (c == NULL) break;
        c->payload.data[edits[i].offset] ^= edits[i].mask;
        hostile_touch(c);
        hostile_build(&h, &bad);
        CHECK(fmt_svdag_open(bad.data, bad.size, NULL, &f, &err) == SVO_INVALID_DATA);
        CHECK_MSG(strstr(err.message, edits[i].rule) != NULL, "edit %zu: '%s' does not name %s", i, err.message, edits[i].rule);
        svo_buffer_free(&bad);
        hostile_free(&h);
    }
    svo_buffer_free(&file);
}

TEST(each_rule)
{
    uint64_t seed = 300;
    tree t;
    tree_random(&t, 6, 1, &seed);
    for (uint32_t c = 0; c < t.info.channel_count; c++) {
        uint32_t stride = svo_channel_stride(t.info.channels[c].kind);
        for (uint64_t i = 0; i < t.count * stride; i++) t.values[c][i] &= 3;
    }
    svo_error err = {0};
    svo_dag_options o = {.geometry = SVO_GEOMETRY_SVDAG, .lod = true, .threads = 1};
    svo_dag_builder *b;
    svo_packed *p;
    CHECK_OK(svo_dag_builder_create(&t.info, &o, &b, &err));
    CHECK_OK(tree_feed(&t, 1, svo_dag_builder_sink(b), &err));
    CHECK_OK(svo_dag_builder_finish(b, &p, NULL, &err));
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *out;
    CHECK_OK(fmt_output_open_memory(&file, &out, &err));
    CHECK_OK(fmt_svdag_write(out, svo_packed_view(p), NULL, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    uint32_t k = (uint32_t)__builtin_popcount(svo_packed_view(p)->levels[0].words[0]);
    svo_packed_free(p);
    tree_free(&t);
#define C4(s) FMT_FOURCC(s[0], s[1], s[2], s[3])
    const edit edits[] = {
        {C4("HEAD"), 0, 0x20, "SVO-02"},    /* depth 38 */
        {C4("HEAD"), 0, 1, "DAG"},          /* depth 7: a level is missing */
        {C4("HEAD"), 4, 2, "DAG-01"},       /* layout 3 */
        {C4("HEAD"), 8, 7, "SVO-02"},       /* surface */
        {C4("HEAD"), 12, 8, "DAG-02"},       /* unknown flag */
        {C4("HEAD"), 12, 2, "DAG-06"},       /* channels vary, but nothing is numbered */
        {C4("HEAD"), 12, 1, "DAG-06"},      /* lod */
        {C4("HEAD"), 144, 1, "DAG"},        /* attributes */
        {C4("HEAD"), 152, 1, "DAG-05"},     /* root */
        {C4("HEAD"), 156, 1, "DAG-02"},     /* reserved */
        {C4("HEAD"), 160 + 8 * 3, 1, "DAG-07"},
        {C4("HEAD"), 160 + 8 * 9, 1, "DAG-07"}, /* beyond the depth */
        {C4("HEAD"), 336 + 20, 1, "DAG-02"},    /* constant but blocks */
        {C4("HEAD"), 336 + 32, 3, "DAG"},       /* encoding 1 */
        {C4("HEAD"), 336 + 40, 1, "DAG-08"},    /* table entries */
        {C4("NODE"), 0, 3, "DAG"},              /* 2 words an offset */
        {C4("NODE"), 4, 1, "DAG-03"},
        {C4("NODE"), 8, 1, "DAG-07"},
        {C4("NODE"), 16 + 2, 1, "DAG-04"},             /* unused bit of a mask */
        {C4("NODE"), 16 + 1, 255, "DAG-0"},            /* full leaves in place of references */
        {C4("NODE"), 16 + 4, 1, "DAG-05"},             /* first reference */
        {C4("NODE"), 16 + 4 + 4 * (uint64_t)k, 1, "DAG-06"}, /* first offset */
        {C4("ADIR"), 0, 1, "DAG-09"},
        {C4("ADIR"), 8, 1, "DAG-09"}, /* offset of the first superblock */
        {C4("APAY"), 0, 1, "DAG-09"}, /* first base */
        {C4("APAY"), 8, 31, "DAG-09"}, /* mode of the first block */
    };
    for (size_t i = 0; i < sizeof edits / sizeof edits[0]; i++) {
        hostile_file h;
        hostile_parse(file.data, file.size, &h);
        hostile_chunk *c = hostile_find(&h, edits[i].type);
        CHECK(c != NULL && edits[i].offset < c->payload.size);
        c->payload.data[edits[i].offset] ^= edits[i].mask;
        hostile_touch(c);
        svo_buffer bad;
        svo_buffer_init(&bad, NULL);
        hostile_build(&h, &bad);
        fmt_svdag f;
        svo_result r = fmt_svdag_open(bad.data, bad.size, NULL, &f, &err);
        CHECK_MSG(r == SVO_INVALID_DATA || r == SVO_UNSUPPORTED, "edit %zu: %s", i, svo_result_name(r));
        CHECK_MSG(strstr(err.message, edits[i].rule) != NULL, "edit %zu: '%s' does not name %s", i, err.message, edits[i].rule);
        svo_buffer_free(&bad);
        hostile_free(&h);
    }
    /* and violations that do not hang on each other all in one go */
    const edit many[] = {
        {C4("HEAD"), 156, 1, "reserved fields are not 0 (DAG-02)"},
        {C4("HEAD"), 160 + 8 * 3, 1, "DAG-07: level 3"},
        {C4("HEAD"), 160 + 8 * 9, 1, "DAG-07: level 9"},
        {C4("NODE"), 4, 1, "a reserved field is not 0 (DAG-03)"},
        {C4("NODE"), 16 + 4 + 4 * (uint64_t)k, 1, "DAG-06"},
        {C4("APAY"), 8, 31, "DAG-09"},
    };
    hostile_file h;
    svo_buffer bad;
    svo_buffer_init(&bad, NULL);
    hostile_parse(file.data, file.size, &h);
    for (size_t i = 0; i < sizeof many / sizeof many[0]; i++) {
        hostile_chunk *c = hostile_find(&h, many[i].type);
        c->payload.data[many[i].offset] ^= many[i].mask;
        hostile_touch(c);
    }
    hostile_build(&h, &bad);
    const rules_text *all = rules_all(fmt_svdag_violations, bad.data, bad.size);
    for (size_t i = 0; i < sizeof many / sizeof many[0]; i++) CHECK_MSG(strstr(all->all, many[i].rule) != NULL, "\"%s\" is not among\n%s", many[i].rule, all->all);
    svo_buffer_free(&bad);
    hostile_free(&h);
    svo_buffer_free(&file);
}

/* Any bit of layout 3's chunks changed, the hashes right: refused, or read soundly. */
TEST(every_bit_of_layout_3)
{
    uint64_t seed = 400;
    tree t;
    tree_random(&t, 5, 0, &seed);
    svo_error err = {0};
    svo_dag_options o = {.lod = true, .geometry = SVO_GEOMETRY_BEST, .threads = 1};
    svo_dag_builder *b;
    svo_packed *p;
    CHECK_OK(svo_dag_builder_create(&t.info, &o, &b, &err));
    CHECK_OK(tree_feed(&t, 1, svo_dag_builder_sink(b), &err));
    CHECK_OK(svo_dag_builder_finish(b, &p, NULL, &err));
    CHECK(svo_packed_view(p)->layout == SVO_LAYOUT_BEST);
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *out;
    CHECK_OK(fmt_output_open_memory(&file, &out, &err));
    CHECK_OK(fmt_svdag_write(out, svo_packed_view(p), NULL, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    svo_packed_free(p);
    tree_free(&t);
    static const struct { uint32_t type; uint32_t step; } chunks[] = {{C4("LVLS"), 1}, {C4("CODE"), 5}, {C4("TREE"), 1}, {C4("BRCK"), 7}};
    uint32_t refused[4] = {0}, tried[4] = {0};
    for (int kind = 0; kind < 4; kind++) {
        for (uint64_t bit = 0;; bit += chunks[kind].step) {
            hostile_file h;
            hostile_parse(file.data, file.size, &h);
            hostile_chunk *c = hostile_find(&h, chunks[kind].type);
            CHECK(c != NULL);
            bool end = bit >= 8 * c->payload.size;
            if (!end) {
                c->payload.data[bit / 8] ^= (uint8_t)(1 << bit % 8);
                hostile_touch(c);
                svo_buffer bad;
                svo_buffer_init(&bad, NULL);
                hostile_build(&h, &bad);
                tried[kind]++;
                svo_result r = read_svdag(NULL, bad.data, bad.size, NULL, &err);
                refused[kind] += r != SVO_OK;
                CHECK_MSG(r == SVO_OK || (r == SVO_INVALID_DATA && strstr(err.message, "DAG-") != NULL), "bit %llu of chunk %d: %s: %s",
                          (unsigned long long)bit, kind, svo_result_name(r), err.message);
                svo_buffer_free(&bad);
            }
            hostile_free(&h);
            if (end || test_failed()) break;
        }
    }
    svo_buffer_free(&file);
    /* tiers that no reference uses are free; a brick changed is another octree unless its number of voxels tells */
    CHECK(2 * refused[0] > tried[0] && 2 * refused[1] > tried[1] && 2 * refused[2] > tried[2] && (tried[3] == 0 || refused[3] > 0));
}
