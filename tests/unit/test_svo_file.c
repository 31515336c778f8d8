/* .svo files: what goes in comes out, through files and pipes, with the same bytes for any number of threads. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmt_svo.h"
#include "svo_morton.h"
#include "svo_task.h"
#include "test.h"
#include "trees.h"

static svo_error err;

/* One tree through a file in memory, chunk for chunk. */
static void round_trip_as(const tree *t, bool small, int level, uint32_t threads)
{
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    svo_tree_counts written = {0};
    tree_write_as(t, small, level, threads, &file, &written);
    if (test_failed()) return;
    fmt_input *in;
    fmt_svo_reader *r;
    CHECK_OK(fmt_input_open_memory(file.data, file.size, &in, &err));
    CHECK_OK(fmt_svo_reader_open(in, NULL, &r, &err));
    tree_check(t, fmt_svo_reader_info(r), fmt_svo_reader_source(r));
    if (test_failed()) return;
    const svo_tree_counts *read = fmt_svo_reader_counts(r);
    CHECK(memcmp(read, &written, sizeof written) == 0);
    CHECK_U64(read->nodes[t->info.depth], t->count);
    CHECK(strcmp(fmt_svo_reader_provenance(r), "{\"tool\":\"test\"}") == 0);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    svo_buffer_free(&file);
}

/* In every way of coding values. */
static void round_trip(const tree *t, uint32_t threads)
{
    for (int way = 0; way < 4 && !test_failed(); way++) round_trip_as(t, way & 1, way < 2 ? 0 : 3, threads);
}

TEST(random_trees_come_back)
{
    static const uint32_t depths[] = {0, 1, 2, 3, 6, 7, 8, 9, 12, 20, 21};
    uint64_t seed = 11;
    for (size_t d = 0; d < sizeof depths / sizeof depths[0]; d++)
        for (uint32_t style = 0; style < TREE_STYLES; style++) {
            tree t;
            tree_random(&t, depths[d], style, &seed);
            round_trip(&t, 2);
            tree_free(&t);
            if (test_failed()) return;
        }
}

/* docs/format/svo.md, Example */
TEST(the_example_of_the_specification)
{
    static const uint8_t masks[] = {0x81, 0x01, 0xc0}, colors[] = {255, 0, 0, 0, 255, 0, 0, 0, 255};
    static const uint8_t expected[] = {3, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 0x81, 1, 0xc0, 255, 0, 0, 0, 255, 0, 0, 0, 255};
    svo_tree_info info = {.depth = 2, .channel_count = 1, .channels = {{.name = "color", .kind = SVO_KIND_COLOR_SRGB8}}};
    for (int i = 0; i < 16; i += 5) info.voxel_to_world[i] = 1;
    svo_chunk chunk = {.depth = 2, .node_count = 3, .value_count = 3, .masks = masks, .channels = {colors}};
    svo_buffer file, payload;
    svo_buffer_init(&file, NULL);
    svo_buffer_init(&payload, NULL);
    fmt_output *out;
    fmt_svo_writer *w;
    void *blob;
    CHECK_OK(fmt_output_open_memory(&file, &out, &err));
    CHECK_OK(fmt_svo_writer_begin(out, &info, NULL, 3, NULL, &w, &err));
    svo_chunk_sink s = fmt_svo_writer_sink(w);
    CHECK_OK(s.encode(s.user, &chunk, 0, &blob, &err));
    CHECK_OK(s.commit(s.user, blob, &err));
    CHECK_OK(fmt_svo_writer_end(w, NULL, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    fmt_container c;
    CHECK_OK(fmt_container_open(file.data, file.size, NULL, &c, &err));
    CHECK(c.chunk_count == 3 && c.chunks[1].element_count == 3 && c.chunks[1].id == 0);
    CHECK_OK(fmt_zstd_decode(NULL, file.data + c.chunks[1].offset, c.chunks[1].stored_size, c.chunks[1].decoded_size, &payload, &err));
    CHECK(payload.size == sizeof expected && memcmp(payload.data, expected, sizeof expected) == 0);
    const uint8_t *stat = file.data + c.chunks[2].offset;
    CHECK(fmt_load64(stat) == 1 && fmt_load64(stat + 8) == 0 && fmt_load64(stat + 16) == 3);
    CHECK(fmt_load64(stat + 24) == 1 && fmt_load64(stat + 32) == 2 && fmt_load64(stat + 40) == 3);
    fmt_container_close(&c);
    svo_buffer_free(&payload);
    svo_buffer_free(&file);
}

/* --- full leaves --- */

static void write_items(const svo_tree_info *info, const svo_chunk *chunk, uint32_t count, svo_buffer *file, svo_tree_counts *counts)
{
    fmt_output *out;
    fmt_svo_writer *w;
    CHECK_OK(fmt_output_open_memory(file, &out, &err));
    CHECK_OK(fmt_svo_writer_begin(out, info, NULL, 0, NULL, &w, &err));
    svo_chunk_sink s = fmt_svo_writer_sink(w);
    for (uint32_t i = 0; i < count; i++) {
        void *blob;
        CHECK_OK(s.encode(s.user, &chunk[i], 0, &blob, &err));
        CHECK_OK(s.commit(s.user, blob, &err));
    }
    CHECK_OK(fmt_svo_writer_end(w, counts, &err));
    CHECK_OK(fmt_output_commit(out, &err));
}

static bool sum_boxes(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    uint64_t *sum = user;
    sum[0] += (uint64_t)size * size * size;
    sum[1] = sum[1] * 31 + low[0] + 7 * low[1] + 49 * low[2] + index;
    return true;
}

/* Depth 10, C = 3: full leaves of level 1 (octants of the grid), two chunks with full leaves of every height
 * inside, a full leaf of level C and one of level 2, with a colour and a normal. */
TEST(full_leaves_come_back)
{
    /* root 0x03: child 0 full (64^3); child 1: mask 0x81: 32^3 full, then down to single voxels */
    static const uint8_t masks[] = {0x03, 0x00, 0x81, 0x00, 0x01, 0x01, 0x03, 0x00, 0x03, 0x00, 0x05};
    static const uint8_t colors[6 * 3] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18};
    static const uint8_t normals[6 * 4] = {1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0, 7, 0, 8, 0, 9, 0, 10, 0, 11, 0, 12, 0};
    svo_tree_info info = {.depth = 10, .fill = SVO_FILL_SOLID, .channel_count = 2,
                          .channels = {{.name = "color", .kind = SVO_KIND_COLOR_SRGB8}, {.name = "normal", .kind = SVO_KIND_NORMAL_OCT32}}};
    for (int i = 0; i < 16; i += 5) info.voxel_to_world[i] = 1;
    const uint8_t *v[2] = {colors, normals};
    const svo_chunk chunk[] = {
        {.code = 0, .level = 1, .depth = 10, .value_count = 1, .channels = {v[0], v[1]}},
        {.code = 64, .level = 3, .depth = 10, .node_count = sizeof masks, .value_count = 6, .masks = masks, .channels = {v[0], v[1]}},
        {.code = 65, .level = 3, .depth = 10, .value_count = 1, .channels = {v[0] + 3, v[1] + 4}},
        {.code = 9, .level = 2, .depth = 10, .value_count = 1, .channels = {v[0] + 6, v[1] + 8}},
        {.code = 3, .level = 1, .depth = 10, .value_count = 1, .channels = {v[0] + 9, v[1] + 12}},
        {.code = 511, .level = 3, .depth = 10, .node_count = sizeof masks, .value_count = 6, .masks = masks, .channels = {v[0], v[1]}},
    };
    enum { ITEMS = sizeof chunk / sizeof chunk[0] };
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    svo_tree_counts counts;
    write_items(&info, chunk, ITEMS, &file, &counts);
    if (test_failed()) return;
    /* 64^3 + 32^3 + 4^3 + 2^3 + 2 voxels a chunk */
    const uint64_t inside = 262144 + 32768 + 64 + 8 + 2;
    CHECK_U64(counts.nodes[10], 2 * inside + 2 * ((uint64_t)1 << 27) + ((uint64_t)1 << 21) + ((uint64_t)1 << 24));
    CHECK(counts.chunks == 2 && counts.full_leaves == 4 + 2 * 4 && counts.values == 4 + 12 && counts.nodes[0] == 1 && counts.nodes[1] == 4);
    CHECK_U64(counts.nodes[2], 8 + 2 + 8 + 1); /* octants 0 and 3 whole, two of octant 1, one of octant 7 */
    fmt_container c;
    CHECK_OK(fmt_container_open(file.data, file.size, NULL, &c, &err));
    CHECK(c.chunk_count == 6 && c.chunks[3].element_count == 3 && c.chunks[3].id == 65); /* HEAD FULL TREE FULL TREE STAT: a run shares a chunk */
    fmt_container_close(&c);
    for (int late = 0; late < 2; late++) {
        fmt_input *in;
        fmt_svo_reader *r;
        CHECK_OK(fmt_input_open_memory(file.data, file.size, &in, &err));
        CHECK_OK(fmt_svo_reader_open(in, NULL, &r, &err));
        svo_chunk_source s = fmt_svo_reader_source(r);
        svo_buffer packed[ITEMS + 1], storage;
        svo_buffer_init(&storage, NULL);
        bool more = true;
        for (uint32_t i = 0; i <= ITEMS; i++) {
            svo_buffer_init(&packed[i], NULL);
            CHECK_OK(s.fetch(s.user, &packed[i], &more, &err));
            CHECK(more == (i < ITEMS));
            if (late && more) continue;
            for (uint32_t k = late ? 0 : i; k <= (late ? ITEMS - 1 : i) && k < ITEMS; k++) {
                svo_chunk got;
                uint64_t a[2] = {0, 0}, b[2] = {0, 0};
                CHECK_OK(s.decode(s.user, &packed[k], &storage, &got, &err));
                CHECK(got.code == chunk[k].code && got.level == chunk[k].level && got.node_count == chunk[k].node_count && got.value_count == chunk[k].value_count);
                CHECK(memcmp(got.channels[0], chunk[k].channels[0], 3 * got.value_count) == 0 && memcmp(got.channels[1], chunk[k].channels[1], 4 * got.value_count) == 0);
                CHECK(svo_chunk_values(&got, sum_boxes, a) && svo_chunk_values(&chunk[k], sum_boxes, b));
                CHECK(a[0] == b[0] && a[1] == b[1] && (got.node_count == 0 || a[0] == inside));
            }
        }
        CHECK(memcmp(fmt_svo_reader_counts(r), &counts, sizeof counts) == 0);
        for (uint32_t i = 0; i <= ITEMS; i++) svo_buffer_free(&packed[i]);
        svo_buffer_free(&storage);
        fmt_svo_reader_close(r);
        fmt_input_close(in);
    }
    svo_buffer_free(&file);
}

TEST(many_full_leaves_fill_several_chunks)
{
    enum { N = 5000 };
    svo_tree_info info = {.depth = 13, .fill = SVO_FILL_SOLID};
    for (int i = 0; i < 16; i += 5) info.voxel_to_world[i] = 1;
    svo_chunk *chunk = calloc(N, sizeof *chunk);
    for (uint32_t i = 0; i < N; i++) chunk[i] = (svo_chunk){.code = 2 * i, .level = 6, .depth = 13, .value_count = 1};
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    svo_tree_counts counts;
    write_items(&info, chunk, N, &file, &counts);
    fmt_container c;
    CHECK_OK(fmt_container_open(file.data, file.size, NULL, &c, &err));
    CHECK(c.chunk_count == 4 && c.chunks[1].element_count == 4096 && c.chunks[2].element_count == N - 4096 && c.chunks[2].id == 8192);
    CHECK(counts.full_leaves == N && counts.chunks == 0 && counts.nodes[13] == (uint64_t)N << 21 && counts.nodes[6] == N && counts.nodes[5] == N / 4);
    fmt_container_close(&c);
    svo_buffer_free(&file);
    free(chunk);
}

TEST(an_empty_tree_comes_back)
{
    uint64_t seed = 1;
    for (uint32_t depth = 0; depth <= 21; depth += 7) {
        tree t;
        tree_random(&t, depth, 0, &seed);
        t.count = 0;
        round_trip(&t, 1);
        tree_free(&t);
        if (test_failed()) return;
    }
}

TEST(a_full_block_comes_back)
{
    tree t;
    uint64_t seed = 3;
    tree_full(&t, 7, &seed);
    round_trip(&t, 2);
    tree_free(&t);
}

TEST(the_bytes_do_not_depend_on_threads)
{
    uint64_t seed = 5;
    tree t;
    tree_random(&t, 10, 1, &seed);
    svo_buffer one, other;
    svo_buffer_init(&one, NULL);
    svo_buffer_init(&other, NULL);
    tree_write(&t, 1, &one, NULL);
    for (uint32_t threads = 2; threads <= 7; threads += 5) {
        tree_write(&t, threads, &other, NULL);
        CHECK_U64(one.size, other.size);
        CHECK(memcmp(one.data, other.data, one.size) == 0);
    }
    svo_buffer_free(&one);
    svo_buffer_free(&other);
    tree_free(&t);
}

TEST(a_pipe_gets_the_same_bytes_as_a_file)
{
    uint64_t seed = 6;
    tree t;
    tree_random(&t, 9, 2, &seed); /* small enough for a pipe's buffer */
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    tree_write(&t, 1, &file, NULL);
    int ends[2];
    char path[64];
    CHECK(file.size < 60000 && pipe(ends) == 0);
    snprintf(path, sizeof path, "/dev/fd/%d", ends[1]);
    fmt_output *out;
    fmt_svo_writer *w;
    CHECK_OK(fmt_output_open(path, false, &out, &err));
    CHECK_OK(fmt_svo_writer_begin(out, &t.info, "{\"tool\":\"test\"}", 3, NULL, &w, &err));
    CHECK_OK(tree_feed(&t, 3, fmt_svo_writer_sink(w), &err));
    CHECK_OK(fmt_svo_writer_end(w, NULL, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    close(ends[1]);
    /* and it is read from the pipe */
    fmt_bytes b;
    snprintf(path, sizeof path, "/dev/fd/%d", ends[0]);
    CHECK_OK(fmt_bytes_open(path, 0, NULL, &b, &err));
    CHECK(b.size == file.size && memcmp(b.data, file.data, b.size) == 0);
    fmt_bytes_close(&b);
    close(ends[0]);
    svo_buffer_free(&file);
    tree_free(&t);
}

/* Read by a pipeline, as tools do. */
typedef struct parallel { svo_chunk_source source; uint64_t voxels; } parallel;
typedef struct parallel_item { svo_buffer packed, storage; svo_chunk chunk; } parallel_item;
static svo_result parallel_produce(void *user, void *item, bool *more, svo_error *e)
{
    parallel *p = user;
    parallel_item *i = item;
    return p->source.fetch(p->source.user, &i->packed, more, e);
}
static svo_result parallel_work(void *user, void *item, uint32_t worker, svo_error *e)
{
    (void)worker;
    parallel *p = user;
    parallel_item *i = item;
    return p->source.decode(p->source.user, &i->packed, &i->storage, &i->chunk, e);
}
static svo_result parallel_commit(void *user, void *item, svo_error *e)
{
    (void)e;
    parallel *p = user;
    p->voxels += ((parallel_item *)item)->chunk.value_count;
    return SVO_OK;
}
static void parallel_destroy(void *user, void *item)
{
    (void)user;
    parallel_item *i = item;
    svo_buffer_free(&i->packed);
    svo_buffer_free(&i->storage);
}

TEST(many_threads_decode_one_stream)
{
    uint64_t seed = 8;
    tree t;
    tree_random(&t, 12, 1, &seed);
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    tree_write(&t, 4, &file, NULL);
    for (uint32_t threads = 1; threads <= 7; threads += 3) {
        fmt_input *in;
        fmt_svo_reader *r;
        CHECK_OK(fmt_input_open_memory(file.data, file.size, &in, &err));
        CHECK_OK(fmt_svo_reader_open(in, NULL, &r, &err));
        parallel p = {fmt_svo_reader_source(r), 0};
        svo_pipeline line = {.threads = threads, .item_size = sizeof(parallel_item), .user = &p, .produce = parallel_produce,
                             .work = parallel_work, .commit = parallel_commit, .destroy = parallel_destroy};
        CHECK_OK(svo_pipeline_run(&line, &err));
        CHECK_U64(p.voxels, t.count);
        fmt_svo_reader_close(r);
        fmt_input_close(in);
    }
    svo_buffer_free(&file);
    tree_free(&t);
}
