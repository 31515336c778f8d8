/* .svdag files: what is written is read back, whatever the encoding; the same bytes for any number of threads. */
#include <string.h>

#include "fmt_svdag.h"
#include "fmt_svo.h"
#include "packer.h"
#include "svo_dag.h"
#include "test.h"
#include "trees.h"

static void write_view(const svo_view *v, const char *provenance, svo_buffer *file)
{
    svo_error err = {0};
    fmt_output *out;
    svo_buffer_init(file, NULL);
    CHECK_OK(fmt_output_open_memory(file, &out, &err));
    CHECK_OK(fmt_svdag_write(out, v, provenance, &err));
    CHECK_OK(fmt_output_commit(out, &err));
}

static void check_equal(const svo_view *a, const svo_view *b)
{
    CHECK(a->depth == b->depth && a->tree_depth == b->tree_depth && a->brick_level == b->brick_level && a->empty == b->empty && a->lod == b->lod);
    CHECK(a->surface == b->surface && a->fill == b->fill && a->channel_count == b->channel_count);
    CHECK_U64(a->root, b->root);
    CHECK_U64(a->attribute_count, b->attribute_count);
    CHECK(memcmp(a->nodes, b->nodes, sizeof a->nodes) == 0);
    CHECK(memcmp(a->voxel_to_world, b->voxel_to_world, sizeof a->voxel_to_world) == 0);
    CHECK(a->layout == b->layout && svo_view_compare_geometry(a, b) == 0);
    for (uint32_t c = 0; c < a->channel_count; c++) {
        CHECK(a->channels[c].encoding == b->channels[c].encoding);
        CHECK(memcmp(&a->channels[c].channel, &b->channels[c].channel, sizeof(svo_channel)) == 0);
        for (uint64_t i = 0; i < a->attribute_count; i++) {
            uint8_t x[SVO_MAX_STRIDE] = {0}, y[SVO_MAX_STRIDE] = {0};
            svo_view_attribute(a, c, i, x);
            svo_view_attribute(b, c, i, y);
            CHECK(memcmp(x, y, sizeof x) == 0);
        }
    }
}

static void check_file(const svo_view *v)
{
    svo_error err = {0};
    svo_buffer file, again;
    write_view(v, "{\"tool\":\"test\"}", &file);
    if (test_failed()) return;
    fmt_svdag f;
    CHECK_OK(fmt_svdag_open(file.data, file.size, NULL, &f, &err));
    CHECK(strcmp(f.provenance, "{\"tool\":\"test\"}") == 0);
    check_equal(v, &f.view);
    /* a view that was read writes the same file */
    write_view(&f.view, f.provenance, &again);
    CHECK_U64(file.size, again.size);
    CHECK(memcmp(file.data, again.data, file.size) == 0);
    fmt_svdag_close(&f);
    svo_buffer_free(&file);
    svo_buffer_free(&again);
}

/* The whole way: .svo bytes through the source into a packed octree. */
static svo_packed *build(const tree *t, const svo_dag_options *o)
{
    svo_error err = {0};
    svo_buffer svo;
    svo_buffer_init(&svo, NULL);
    tree_write(t, 1, &svo, NULL);
    fmt_input *in;
    fmt_svo_reader *reader = NULL;
    svo_packed *p = NULL;
    svo_result r = fmt_input_open_memory(svo.data, svo.size, &in, &err);
    if (r == SVO_OK) r = fmt_svo_reader_open(in, NULL, &reader, &err);
    if (r == SVO_OK) {
        svo_chunk_source s = fmt_svo_reader_source(reader);
        r = svo_dag_build(fmt_svo_reader_info(reader), &s, o, &p, NULL, &err);
    }
    if (r != SVO_OK) test_fail(__FILE__, __LINE__, "%s", err.message);
    fmt_svo_reader_close(reader);
    fmt_input_close(in);
    svo_buffer_free(&svo);
    return p;
}

TEST(round_trip)
{
    static const uint32_t depths[] = {0, 1, 2, 3, 7, 8, 12, 21};
    uint64_t seed = 11;
    for (uint32_t style = 0; style < TREE_STYLES; style++)
        for (size_t d = 0; d < sizeof depths / sizeof depths[0]; d++)
            for (int lod = 0; lod < 2; lod++) {
                tree t;
                tree_random(&t, depths[d], style, &seed);
                svo_dag_options o = svo_default_dag_options();
                o.lod = lod != 0;
                svo_packed *p = build(&t, &o);
                if (p == NULL) return;
                check_file(svo_packed_view(p));
                svo_packed_free(p);
                tree_free(&t);
                if (test_failed()) return;
            }
}

TEST(empty)
{
    for (uint32_t depth = 0; depth <= 21; depth += 7) {
        uint64_t seed = 12;
        tree t;
        tree_random(&t, depth, 2, &seed);
        t.count = 0;
        svo_dag_options o = svo_default_dag_options();
        svo_packed *p = build(&t, &o);
        if (p == NULL) return;
        CHECK(svo_packed_view(p)->empty);
        check_file(svo_packed_view(p));
        svo_packed_free(p);
        tree_free(&t);
    }
}

TEST(threads_do_not_show)
{
    uint64_t seed = 13;
    tree t;
    tree_random(&t, 11, 1, &seed);
    svo_buffer first = {0};
    for (uint32_t threads = 1; threads <= 7; threads = threads == 1 ? 2 : threads + 5) {
        svo_dag_options o = svo_default_dag_options();
        o.threads = threads;
        svo_packed *p = build(&t, &o);
        if (p == NULL) return;
        svo_buffer file;
        write_view(svo_packed_view(p), NULL, &file);
        svo_packed_free(p);
        if (threads == 1) {
            first = file;
            continue;
        }
        CHECK_U64(file.size, first.size);
        CHECK(memcmp(file.data, first.data, file.size) == 0);
        svo_buffer_free(&file);
    }
    svo_buffer_free(&first);
    tree_free(&t);
}

/* Offsets of two words, as only huge octrees have them. */
TEST(solid_of_depth_21)
{
    for (int lod = 0; lod < 2; lod++) {
        svo_view *v = packer_solid(21, lod != 0);
        svo_error err = {0};
        CHECK_OK(svo_view_validate(v, NULL, &err));
        svo_buffer file;
        write_view(v, NULL, &file);
        if (test_failed()) return;
        CHECK(file.size < 10000);
        fmt_svdag f;
        CHECK_OK(fmt_svdag_open(file.data, file.size, NULL, &f, &err));
        check_equal(v, &f.view);
        uint64_t index;
        uint32_t last = ((uint32_t)1 << 21) - 1;
        CHECK(svo_view_voxel(&f.view, last, last, last, &index));
        CHECK_U64(index + 1, f.view.attribute_count);
        fmt_svdag_close(&f);
        svo_buffer_free(&file);
        packer_free(v);
    }
}
