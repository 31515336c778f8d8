/* Damaged .svo files are refused with a message, or what is read from them is sound. */
#include <string.h>

#include "fmt_svo.h"
#include "hostile.h"
#include "svo_morton.h"
#include "test.h"
#include "trees.h"

typedef struct walk { uint32_t depth; uint64_t voxels, last; bool sound; } walk;

static bool visit(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    walk *w = user;
    uint64_t code = svo_morton_encode(x, y, z);
    (void)index;
    if ((x | y | z) >> w->depth != 0 || (w->voxels != 0 && code <= w->last)) w->sound = false;
    w->last = code;
    w->voxels++;
    return w->sound;
}

static svo_result use_chunk(const svo_tree_info *info, svo_chunk_source s, const svo_buffer *packed, svo_buffer *storage, walk *w, svo_error *err)
{
    svo_chunk chunk;
    SVO_TRY(s.decode(s.user, packed, storage, &chunk, err));
    uint64_t before = w->voxels, sum = 0;
    svo_chunk_voxels(&chunk, visit, w);
    for (uint32_t i = 0; i < info->channel_count; i++) {
        if (chunk.channels[i] == NULL) continue;
        for (uint64_t k = 0; k < chunk.voxel_count * svo_channel_stride(info->channels[i].kind); k++) sum += chunk.channels[i][k];
    }
    volatile uint64_t keep = sum; /* the sanitizers have seen every byte */
    (void)keep;
    if (w->voxels - before != chunk.voxel_count) w->sound = false;
    return SVO_OK;
}

static svo_result read_svo(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    (void)user;
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
    walk w = {info->depth, 0, 0, true};
    bool more = true;
    while (result == SVO_OK && more) {
        result = s.fetch(s.user, &packed, &more, err);
        if (result == SVO_OK && more) result = use_chunk(info, s, &packed, &storage, &w, err);
    }
    if (!w.sound) test_fail(__FILE__, __LINE__, "voxels out of order or outside the grid");
    if (result == SVO_OK && fmt_svo_reader_counts(r)->nodes[info->depth] != w.voxels) test_fail(__FILE__, __LINE__, "counts accepted that are wrong");
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    return result;
}

static void run(uint32_t depth, uint32_t style, uint32_t rounds)
{
    uint64_t seed = 100 + depth;
    tree t;
    tree_random(&t, depth, style, &seed);
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    tree_write(&t, 1, &file, NULL);
    tree_free(&t);
    if (test_failed()) return;
    hostile_case c = {.read = read_svo, .bytes = file.data, .size = file.size, .rounds = rounds, .seed = seed};
    hostile_run(&c);
    svo_buffer_free(&file);
}

TEST(damaged_single_voxel) { run(0, 2, 0); }
TEST(damaged_without_channels) { run(6, 0, 0); }
TEST(damaged_corners_of_a_deep_tree) { run(21, 2, 0); }
TEST(damaged_clusters_with_all_channels) { run(9, 1, 1000); }
