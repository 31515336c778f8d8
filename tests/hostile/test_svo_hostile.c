/* Damaged .svo files are refused with a message, or what is read from them is sound. */
#include <string.h>

#include "fmt_svo.h"
#include "hostile.h"
#include "rules_agree.h"
#include "svo_morton.h"
#include "test.h"
#include "trees.h"

typedef struct walk { uint32_t depth; uint64_t voxels, values, end; bool sound; } walk;

static bool visit(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    walk *w = user;
    uint64_t code = svo_morton_encode(low[0], low[1], low[2]), voxels = (uint64_t)size * size * size;
    (void)index;
    for (int k = 0; k < 3; k++)
        if (low[k] % size != 0 || low[k] >> w->depth != 0) w->sound = false;
    if (code < w->end) w->sound = false;
    w->end = code + voxels;
    w->voxels += voxels;
    w->values++;
    return w->sound;
}

static svo_result use_chunk(const svo_tree_info *info, svo_chunk_source s, const svo_buffer *packed, svo_buffer *storage, walk *w, svo_error *err)
{
    svo_chunk chunk;
    SVO_TRY(s.decode(s.user, packed, storage, &chunk, err));
    uint64_t before = w->values, sum = 0;
    svo_chunk_values(&chunk, visit, w);
    for (uint32_t i = 0; i < info->channel_count; i++) {
        if (chunk.channels[i] == NULL) continue;
        for (uint64_t k = 0; k < chunk.value_count * svo_channel_stride(info->channels[i].kind); k++) sum += chunk.channels[i][k];
    }
    volatile uint64_t keep = sum; /* the sanitizers have seen every byte */
    (void)keep;
    if (w->values - before != chunk.value_count) w->sound = false;
    return SVO_OK;
}

static svo_result read_alone(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *r;
    SVO_TRY(fmt_input_open_memory(bytes, size, &in, err));
    svo_result result = fmt_svo_reader_open(in, a, &r, err);
    if (result != SVO_OK) {
        fmt_input_close(in);
        return result;
    }
    const svo_tree_info *info = fmt_svo_reader_info(r);
    svo_chunk_source s = fmt_svo_reader_source(r);
    svo_buffer packed, storage;
    svo_buffer_init(&packed, a);
    svo_buffer_init(&storage, a);
    walk w = {info->depth, 0, 0, 0, true};
    bool more = true;
    while (result == SVO_OK && more) {
        result = s.fetch(s.user, &packed, &more, err);
        if (result == SVO_OK && more) result = use_chunk(info, s, &packed, &storage, &w, err);
    }
    if (!w.sound) test_fail(__FILE__, __LINE__, "voxels out of order or outside the grid");
    const svo_tree_counts *counts = fmt_svo_reader_counts(r);
    if (result == SVO_OK && (counts->nodes[info->depth] != w.voxels || counts->values != w.values)) test_fail(__FILE__, __LINE__, "counts accepted that are wrong");
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    return result;
}

/* And the list of all violations says the same. */
static svo_result read_svo(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    (void)user;
    svo_result r = read_alone(bytes, size, a, err);
    const char *differ = rules_agree(fmt_svo_violations, bytes, size, a, r, err, true);
    if (differ != NULL) test_fail(__FILE__, __LINE__, "%s", differ);
    return r;
}

static void run_form(uint32_t depth, uint32_t style, uint32_t rounds, bool small, int level)
{
    uint64_t seed = 100 + depth;
    tree t;
    tree_random(&t, depth, style, &seed);
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    tree_write_as(&t, small, level, 1, &file, NULL);
    tree_free(&t);
    if (test_failed()) return;
    hostile_case c = {.read = read_svo, .bytes = file.data, .size = file.size, .rounds = rounds, .seed = seed};
    hostile_run(&c);
    svo_buffer_free(&file);
}

static void run(uint32_t depth, uint32_t style, uint32_t rounds) { run_form(depth, style, rounds, false, 3); }

TEST(damaged_small_single_voxel) { run_form(0, 2, 500, true, 0); }
TEST(damaged_small_without_channels) { run_form(6, 0, 500, true, 0); }
TEST(damaged_small_corners_of_a_deep_tree) { run_form(21, 2, 300, true, 0); }
TEST(damaged_small_clusters_with_all_channels) { run_form(9, 1, 200, true, 0); }
TEST(damaged_small_through_zstd) { run_form(9, 1, 100, true, 3); }
TEST(damaged_packed_single_voxel) { run_form(0, 2, 500, false, 0); }
TEST(damaged_packed_corners_of_a_deep_tree) { run_form(21, 2, 300, false, 0); }
TEST(damaged_packed_clusters_with_all_channels) { run_form(9, 1, 1000, false, 0); }

TEST(damaged_single_voxel) { run(0, 2, 0); }
TEST(damaged_without_channels) { run(6, 0, 0); }
TEST(damaged_corners_of_a_deep_tree) { run(21, 2, 0); }
TEST(damaged_clusters_with_all_channels) { run(9, 1, 1000); }

/* Full leaves inside a chunk, of chunks and above them, in runs. */
static void run_full_leaves(bool small, uint32_t rounds)
{
    static const uint8_t masks[] = {0x03, 0x00, 0x81, 0x00, 0x01, 0x01, 0x03, 0x00, 0x03, 0x00, 0x05};
    static const uint8_t values[] = {1, 2, 3, 4, 5, 6};
    static const struct { uint64_t code; uint32_t level; bool tree; } items[] = {
        {0, 1, false}, {64, 3, true}, {65, 3, false}, {9, 2, false}, {3, 1, false}, {510, 3, true}, {511, 3, false}};
    svo_tree_info info = {.depth = 10, .fill = SVO_FILL_SOLID, .channel_count = 1, .channels = {{.name = "metallic", .kind = SVO_KIND_UNORM8}}};
    for (int i = 0; i < 16; i += 5) info.voxel_to_world[i] = 1;
    svo_error err;
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *out;
    fmt_svo_writer *w;
    CHECK_OK(fmt_output_open_memory(&file, &out, &err));
    CHECK_OK(fmt_svo_writer_begin(out, &info, NULL, 0, NULL, &w, &err));
    if (small) CHECK_OK(fmt_svo_writer_small(w, &err));
    svo_chunk_sink s = fmt_svo_writer_sink(w);
    for (size_t i = 0; i < sizeof items / sizeof items[0]; i++) {
        svo_chunk c = {.code = items[i].code, .level = items[i].level, .depth = 10, .value_count = 1, .channels = {values}};
        if (items[i].tree) c.node_count = sizeof masks, c.masks = masks, c.value_count = 6;
        void *blob;
        CHECK_OK(s.encode(s.user, &c, 0, &blob, &err));
        CHECK_OK(s.commit(s.user, blob, &err));
    }
    CHECK_OK(fmt_svo_writer_end(w, NULL, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    hostile_case c = {.read = read_svo, .bytes = file.data, .size = file.size, .rounds = rounds, .seed = 9};
    hostile_run(&c);
    svo_buffer_free(&file);
}

TEST(damaged_full_leaves) { run_full_leaves(false, 3000); }
TEST(damaged_small_full_leaves) { run_full_leaves(true, 500); }
