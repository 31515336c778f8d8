/* The plan of shards (contiguous, complete, the same for any threads), ranges of the voxelizer, SHRD's rule broken in every way, and
 * merging of damaged shards. */
#include <math.h>
#include <stdio.h>

#include "fmt_svo.h"
#include "hostile.h"
#include "svo_bin.h"
#include "svo_shard.h"
#include "trees.h"
#include "voxel_set.h"

#define SHRD FMT_FOURCC('S', 'H', 'R', 'D')

static svo_error err;

/* Triangles of all sizes, more of them in one corner. */
static void scatter(loose_mesh *m, uint64_t count)
{
    uint64_t seed = 11;
    double *p = malloc(72 * count);
    for (uint64_t t = 0; t < count; t++) {
        double size = pow(10, -3 * test_random_unit(&seed)), at[3];
        for (int k = 0; k < 3; k++) at[k] = pow(test_random_unit(&seed), 3) * 4;
        for (int i = 0; i < 9; i++) p[9 * t + (uint64_t)i] = at[i % 3] + size * test_random_unit(&seed);
    }
    loose_make(m, p, count);
    free(p);
}

TEST(ranges_follow_each_other_and_share_the_work)
{
    loose_mesh m;
    scatter(&m, 3000);
    const uint32_t counts[] = {1, 2, 3, 7, 64, 150};
    for (uint32_t depth = 5; depth <= 11; depth += 3)
        for (uint32_t k = 0; k < 6; k++) {
            svo_voxelize_options o = svo_default_voxelize_options();
            svo_tree_info info;
            o.depth = depth;
            CHECK_OK(svo_voxelize_plan(&m.mesh, &o, &info, &err));
            uint64_t at = 0;
            double sum = 0, most = 0;
            for (uint32_t i = 1; i <= counts[k]; i++) {
                svo_shard s, t;
                o.threads = 1;
                CHECK_OK(svo_shard_plan(&m.mesh, &o, &info, i, counts[k], &s, &err));
                if (i <= 3) { /* the same without memory for snapped triangles, and with threads */
                    o.threads = 3, o.memory = 100000;
                    CHECK_OK(svo_shard_plan(&m.mesh, &o, &info, i, counts[k], &t, &err));
                    o.memory = 0;
                    CHECK(s.first_code == t.first_code && s.end_code == t.end_code && s.share == t.share);
                }
                CHECK_U64(s.first_code, at);
                CHECK(s.end_code >= s.first_code);
                at = s.end_code;
                sum += s.share;
                if (s.share > most) most = s.share;
            }
            CHECK_U64(at, (uint64_t)1 << 3 * svo_chunk_level(depth));
            CHECK_MSG(fabs(sum - 1) < 1e-9, "%g", sum);
            if (depth == 11 && counts[k] <= 7) CHECK_MSG(most * counts[k] < 1.3, "%u shards: %g", counts[k], most * counts[k]);
        }
    loose_free(&m);
}

/* Chunks that some triangle meets. */
static void count_chunks(const loose_mesh *m, const svo_tree_info *info, uint32_t *count)
{
    svo_placement placement;
    svo_bins *bins;
    svo_bins_report unused;
    svo_grid grid = {.size = info->voxel_to_world[0], .depth = info->depth};
    svo_buffer list;
    uint64_t code;
    bool more = true;
    *count = 0;
    for (int i = 0; i < 3; i++) grid.origin[i] = info->voxel_to_world[4 * i + 3];
    svo_buffer_init(&list, NULL);
    CHECK_OK(svo_placement_create(&m->mesh, NULL, &placement, &err));
    CHECK_OK(svo_bins_create(&placement, &grid, svo_chunk_level(info->depth), UINT64_MAX, 1, NULL, &bins, &unused, &err));
    for (; more; *count += more) CHECK_OK(svo_bins_next(bins, &code, &list, &more, &err));
    svo_bins_free(bins);
    svo_placement_free(&placement);
    svo_buffer_free(&list);
}

TEST(no_shard_is_empty_while_there_are_chunks)
{
    loose_mesh m;
    scatter(&m, 300);
    for (uint32_t depth = 8; depth <= 11; depth++) {
        svo_voxelize_options o = svo_default_voxelize_options();
        svo_tree_info info;
        o.depth = depth;
        CHECK_OK(svo_voxelize_plan(&m.mesh, &o, &info, &err));
        uint32_t chunks = 0;
        count_chunks(&m, &info, &chunks);
        const uint32_t counts[] = {2, chunks / 3 + 1, chunks - 1, chunks, chunks + 5};
        double largest = 0; /* chunk: no cut does without it */
        for (uint32_t k = 5; k-- > 0;) {
            uint32_t empty = 0;
            double most = 0;
            for (uint32_t i = 1; i <= counts[k]; i++) {
                svo_shard s;
                CHECK_OK(svo_shard_plan(&m.mesh, &o, &info, i, counts[k], &s, &err));
                CHECK((s.share > 0) == (s.first_code < s.end_code));
                empty += !(s.share > 0);
                if (s.share > most) most = s.share;
            }
            CHECK_U64(empty, counts[k] > chunks ? counts[k] - chunks : 0);
            if (counts[k] == chunks) largest = most;
            if (counts[k] < chunks) CHECK_MSG(most < 1.0 / counts[k] + largest + 1e-9, "%u of %u: %g", counts[k], chunks, most);
        }
    }
    loose_free(&m);
}

TEST(wrong_numbers_and_too_little_memory_are_refused)
{
    loose_mesh m;
    scatter(&m, 500);
    svo_voxelize_options o = svo_default_voxelize_options();
    svo_tree_info info;
    svo_shard s;
    CHECK_OK(svo_voxelize_plan(&m.mesh, &o, &info, &err));
    CHECK_RESULT(svo_shard_plan(&m.mesh, &o, &info, 0, 2, &s, &err), SVO_INVALID_ARGUMENT);
    CHECK_RESULT(svo_shard_plan(&m.mesh, &o, &info, 3, 2, &s, &err), SVO_INVALID_ARGUMENT);
    CHECK_RESULT(svo_shard_plan(&m.mesh, &o, &info, 1, 0, &s, &err), SVO_INVALID_ARGUMENT);
    CHECK_RESULT(svo_shard_plan(&m.mesh, &o, &info, 1, SVO_MAX_SHARDS + 1, &s, &err), SVO_INVALID_ARGUMENT);
    o.memory = 500;
    CHECK_RESULT(svo_shard_plan(&m.mesh, &o, &info, 1, 2, &s, &err), SVO_OUT_OF_MEMORY);
    loose_free(&m);
}

TEST(any_range_gives_the_voxels_of_a_whole_run)
{
    loose_mesh m;
    scatter(&m, 2000);
    for (uint32_t depth = 6; depth <= 10; depth += 2) {
        svo_voxelize_options o = svo_default_voxelize_options();
        o.depth = depth;
        o.channels = SVO_WANT_NORMAL;
        voxel_set whole, part;
        CHECK_OK(voxel_run(&m.mesh, &o, true, &whole, &err));
        uint64_t all = (uint64_t)1 << 3 * svo_chunk_level(depth), cuts[] = {0, 0, 1, all / 3, all / 2, all, all}, seen = 0;
        uint32_t shift = 3 * (depth - svo_chunk_level(depth));
        o.has_range = true;
        for (int i = 0; i + 1 < 7; i++) {
            if (cuts[i] > cuts[i + 1]) continue; /* one chunk */
            o.first_code = cuts[i], o.end_code = cuts[i + 1];
            CHECK_OK(voxel_run(&m.mesh, &o, true, &part, &err));
            for (uint64_t v = 0; v < part.count; v++) {
                CHECK(part.codes[v] >> shift >= o.first_code && part.codes[v] >> shift < o.end_code);
                if (depth == 6) continue; /* the same chunk several times */
                CHECK_U64(part.codes[v], whole.codes[seen]);
                CHECK(memcmp(part.values[0] + 4 * v, whole.values[0] + 4 * seen, 4) == 0);
                seen++;
            }
            CHECK(part.ordered && part.live_blobs == 0);
            voxel_free(&part);
        }
        if (depth != 6) CHECK_U64(seen, whole.count);
        voxel_free(&whole);
    }
    loose_free(&m);
}

/* --- files --- */

static svo_buffer good;
static hostile_file f;

/* A whole octree of depth 9 as shard 1 of 1, taken apart: HEAD, SHRD, TREE... */
static void begin(void)
{
    if (good.size == 0) {
        uint64_t seed = 5;
        tree t;
        tree_random(&t, 9, 1, &seed);
        tree_write(&t, 1, &good, NULL);
        tree_free(&t);
    }
    hostile_free(&f);
    hostile_parse(good.data, good.size, &f);
    hostile_double(&f, 0);
    hostile_chunk *c = &f.chunks[1];
    memset(&c->chunk, 0, sizeof c->chunk);
    c->chunk.type = SHRD;
    c->payload.size = 0;
    svo_buffer_append(&c->payload, NULL, 40);
    fmt_store32(c->payload.data, 1);
    fmt_store32(c->payload.data + 4, 1);
    fmt_store64(c->payload.data + 16, 64);
    memset(c->payload.data + 24, 0x5a, 16);
    hostile_touch(c);
}
static uint8_t *shard(void) { return f.chunks[1].payload.data; }

/* Merge files made of these bytes; the output is thrown away or kept in *to. */
static svo_result merge_bytes(const svo_buffer *files, int count, const svo_allocator *a, svo_buffer *to, svo_error *e)
{
    char names[4][400];
    const char *paths[4];
    for (int i = 0; i < count; i++) {
        snprintf(names[i], sizeof names[i], "%s/shard%d.svo", test_folder(), i);
        paths[i] = names[i];
        FILE *file = fopen(names[i], "wb");
        if (file == NULL || fwrite(files[i].data, 1, files[i].size, file) != files[i].size || fclose(file) != 0)
            return svo_fail(e, SVO_RUNTIME, "the test cannot write its files");
    }
    fmt_output *out = NULL;
    svo_result r = fmt_output_open_memory(to, &out, e);
    if (r == SVO_OK) r = fmt_svo_merge(paths, (uint64_t)count, out, a, NULL, NULL, e);
    if (r == SVO_OK) return fmt_output_commit(out, e);
    fmt_output_discard(out);
    return r;
}

static void expect(svo_result code, const char *rule)
{
    svo_buffer file, to;
    svo_buffer_init(&file, NULL);
    svo_buffer_init(&to, NULL);
    hostile_build(&f, &file);
    svo_result r = merge_bytes(&file, 1, NULL, &to, &err);
    CHECK_MSG(r == code && (code == SVO_OK || strstr(err.message, rule) != NULL), "%s: merge gave %s (%s)", rule, svo_result_name(r), err.message);
    if (code == SVO_OK) CHECK(to.size == good.size && memcmp(to.data, good.data, good.size) == 0);
    /* and a plain reader */
    fmt_input *in = NULL;
    fmt_svo_reader *reader = NULL;
    CHECK_OK(fmt_input_open_memory(file.data, file.size, &in, &err));
    r = fmt_svo_reader_open(in, NULL, &reader, &err);
    if (r == SVO_OK) {
        svo_chunk_source s = fmt_svo_reader_source(reader);
        for (bool more = true; r == SVO_OK && more;) r = s.fetch(s.user, &to, &more, &err);
        if (r == SVO_OK) CHECK(fmt_svo_reader_shard(reader) != NULL && fmt_svo_reader_shard(reader)->job[15] == 0x5a);
        fmt_svo_reader_close(reader);
    }
    CHECK_MSG(r == code && (code == SVO_OK || strstr(err.message, rule) != NULL), "%s: the reader gave %s (%s)", rule, svo_result_name(r), err.message);
    fmt_input_close(in);
    svo_buffer_free(&file);
    svo_buffer_free(&to);
}
static void refuse(const char *rule) { expect(SVO_INVALID_DATA, rule); }

TEST(svo_10_shrd)
{
    begin(), expect(SVO_OK, "");
    begin(), fmt_store32(shard(), 0), refuse("SVO-10");
    begin(), fmt_store32(shard(), 2), refuse("SVO-10");
    begin(), fmt_store32(shard() + 4, 0), refuse("SVO-10");
    begin(), fmt_store32(shard() + 4, FMT_SVO_MAX_SHARDS + 1), refuse("SVO-10");
    begin(), fmt_store64(shard() + 8, 65), refuse("SVO-10");
    begin(), fmt_store64(shard() + 16, 65), refuse("SVO-10");
    begin(), fmt_store64(shard() + 16, UINT64_MAX), refuse("SVO-10");
    begin(), f.chunks[1].chunk.flags = FMT_CHUNK_CRITICAL, refuse("SVO-10");
    begin(), f.chunks[1].chunk.id = 1, refuse("SVO-10");
    begin(), f.chunks[1].payload.size = 39, refuse("SVO-10");
    begin(), svo_buffer_append(&f.chunks[1].payload, NULL, 1), refuse("SVO-10");
    begin(), hostile_double(&f, 1), refuse("SVO-10");
}

TEST(chunks_outside_the_range_are_refused)
{
    begin();
    uint64_t last = f.chunks[f.count - 3].chunk.id, first = f.chunks[2].chunk.id;
    CHECK(last > first);
    /* two shards that fit together, but one holds a chunk of the other */
    svo_buffer files[2], to;
    svo_buffer_init(&to, NULL);
    for (int i = 0; i < 2; i++) {
        begin();
        svo_buffer_init(&files[i], NULL);
        fmt_store32(shard(), (uint32_t)i + 1);
        fmt_store32(shard() + 4, 2);
        fmt_store64(shard() + 8, i == 0 ? 0 : last);
        fmt_store64(shard() + 16, i == 0 ? last : 64);
        hostile_build(&f, &files[i]);
    }
    CHECK_RESULT(merge_bytes(files, 2, NULL, &to, &err), SVO_INVALID_DATA);
    CHECK(strstr(err.message, "SVO-10") != NULL);
    /* ranges that leave a gap */
    begin();
    fmt_store32(shard(), 2), fmt_store32(shard() + 4, 2), fmt_store64(shard() + 8, last + 1);
    hostile_build(&f, &files[1]);
    CHECK_RESULT(merge_bytes(files, 2, NULL, &to, &err), SVO_INVALID_DATA);
    CHECK(strstr(err.message, "does not begin") != NULL);
    begin();
    fmt_store64(shard() + 16, 63);
    hostile_build(&f, &files[0]);
    CHECK_RESULT(merge_bytes(files, 1, NULL, &to, &err), SVO_INVALID_DATA);
    CHECK(strstr(err.message, "does not reach") != NULL);
    for (int i = 0; i < 2; i++) svo_buffer_free(&files[i]);
    svo_buffer_free(&to);
}

static svo_result read_by_merging(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *e)
{
    (void)user;
    svo_buffer file = {.data = (uint8_t *)(uintptr_t)bytes, .size = (size_t)size}, to;
    svo_buffer_init(&to, NULL);
    svo_result r = merge_bytes(&file, 1, a, &to, e);
    if (r == SVO_OK) { /* what was written is a good container */
        fmt_container c;
        r = fmt_container_open(to.data, to.size, NULL, &c, e);
        if (r != SVO_OK) test_fail(__FILE__, __LINE__, "svo-merge wrote a file that cannot be read: %s", e->message);
        else fmt_container_close(&c);
    }
    svo_buffer_free(&to);
    return r;
}

TEST(damaged_shards)
{
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    begin();
    hostile_build(&f, &file);
    hostile_case c = {.read = read_by_merging, .bytes = file.data, .size = file.size, .rounds = 300, .seed = 3};
    hostile_run(&c);
    svo_buffer_free(&file);
    hostile_free(&f);
}
