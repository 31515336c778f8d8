/* Every rule of docs/format/svo.md broken once, with all hashes right, is refused by name; what is optional is skipped. */
#include <math.h>
#include <string.h>

#include "fmt_svo.h"
#include "hostile.h"
#include "rules_agree.h"
#include "test.h"
#include "trees.h"

static svo_error err;

/* Read everything; chunks are decoded as they come, or all after the end has been fetched. */
static svo_result read_all(const svo_buffer *file, bool late)
{
    enum { MOST = 64 };
    fmt_input *in;
    fmt_svo_reader *r;
    svo_buffer packed[MOST], storage;
    uint32_t count = 0;
    SVO_TRY(fmt_input_open_memory(file->data, file->size, &in, &err));
    svo_result result = fmt_svo_reader_open(in, NULL, &r, &err);
    if (result != SVO_OK) {
        fmt_input_close(in);
        return result;
    }
    svo_chunk_source s = fmt_svo_reader_source(r);
    svo_chunk chunk;
    svo_buffer_init(&storage, NULL);
    for (bool more = true; result == SVO_OK && more && count < MOST;) {
        svo_buffer_init(&packed[count], NULL);
        result = s.fetch(s.user, &packed[count], &more, &err);
        if (result == SVO_OK && more && !late) result = s.decode(s.user, &packed[count], &storage, &chunk, &err);
        count++;
    }
    for (uint32_t i = 0; result == SVO_OK && late && i + 1 < count; i++) result = s.decode(s.user, &packed[i], &storage, &chunk, &err);
    for (uint32_t i = 0; i < count; i++) svo_buffer_free(&packed[i]);
    svo_buffer_free(&storage);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    return result;
}

static svo_buffer good, bad;
static hostile_file f;

/* A tree of depth 9 with channels color, normal, metallic, material, bone and some TREE chunks, taken apart into f. */
static void begin(void)
{
    if (good.size == 0) {
        uint64_t seed = 77;
        tree t;
        tree_random(&t, 9, 1, &seed);
        tree_write(&t, 1, &good, NULL);
        tree_free(&t);
    }
    hostile_free(&f);
    hostile_parse(good.data, good.size, &f);
}

static void expect(svo_result code, const char *rule)
{
    hostile_build(&f, &bad);
    for (int late = 0; late < 2; late++) {
        svo_result r = read_all(&bad, late != 0);
        CHECK_MSG(r == code, "%s: %s (%s)", rule, svo_result_name(r), err.message);
        /* decoded late, the counts of the chunk headers are compared first */
        CHECK_MSG(code == SVO_OK || (late && strstr(err.message, "SVO-08") != NULL) || strstr(err.message, rule) != NULL, "no %s in '%s'", rule, err.message);
    }
}
static void refuse(const char *rule) { expect(SVO_INVALID_DATA, rule); }

/* f.chunks: 0 HEAD, 1.. TREE, then STAT, META */
static uint32_t stat_index(void) { return f.count - 2; }
static uint8_t *head(void) { return f.chunks[0].payload.data; }
static uint8_t *channel(uint32_t i) { return head() + 144 + 32 * i; }
static uint8_t *tree_payload(uint32_t i) { return f.chunks[1 + i].payload.data; }
static void put_f64(uint8_t *p, double v)
{
    uint64_t bits;
    memcpy(&bits, &v, 8);
    fmt_store64(p, bits);
}

TEST(the_file_itself_is_good)
{
    begin();
    CHECK(f.count > 6);
    expect(SVO_OK, "");
}

TEST(svo_01_order_of_chunks)
{
    begin(), hostile_drop(&f, 0), refuse("SVO-01");
    begin(), hostile_swap(&f, 0, 1), refuse("SVO-01");
    begin(), hostile_double(&f, 0), refuse("SVO-01");
    begin(), hostile_double(&f, stat_index()), refuse("SVO-01");
    begin(), hostile_drop(&f, stat_index()), refuse("SVO-01");
    begin(), hostile_swap(&f, stat_index(), stat_index() - 1), refuse("SVO-0");
    begin(), hostile_swap(&f, stat_index(), stat_index() + 1), refuse("SVO-01");
    begin(), f.chunks[0].chunk.flags = 0, refuse("SVO-01");
    begin(), f.chunks[0].chunk.id = 1, refuse("SVO-01");
    begin(), f.chunks[1].chunk.codec = FMT_CODEC_NONE, refuse("SVO-01");
    begin(), f.chunks[stat_index()].chunk.codec = FMT_CODEC_ZSTD, refuse("SVO-01");
    begin(), f.chunks[stat_index()].chunk.element_count = 3, refuse("SVO-01");
    begin(), hostile_double(&f, f.count - 1), refuse("CON-12");
}

TEST(all_violations_at_once)
{
    begin();
    CHECK(stat_index() >= 6);
    tree_payload(0)[16] = 0;
    hostile_swap(&f, 2, 3);
    f.chunks[4].chunk.element_count = 0;
    hostile_double(&f, stat_index());
    bad.size = 0;
    hostile_build(&f, &bad);
    const rules_text *t = rules_all(fmt_svo_violations, bad.data, bad.size);
    static const char *const rules[] = {"SVO-07", "SVO-05", "SVO-06", "a second STAT (SVO-01)"};
    CHECK_MSG(t->count == 4, "%llu: %s", (unsigned long long)t->count, t->all);
    for (size_t i = 0; i < sizeof rules / sizeof rules[0]; i++) CHECK_MSG(strstr(t->all, rules[i]) != NULL, "no %s: %s", rules[i], t->all);
    /* where nothing else is wrong, each count of STAT */
    begin();
    for (uint32_t i = 0; i < 13; i++) {
        uint8_t *stat = f.chunks[stat_index()].payload.data + 8 * i;
        fmt_store64(stat, fmt_load64(stat) + 1);
    }
    bad.size = 0;
    hostile_build(&f, &bad);
    t = rules_all(fmt_svo_violations, bad.data, bad.size);
    CHECK_MSG(t->count == 13, "%llu: %s", (unsigned long long)t->count, t->all);
    /* of a sound file nothing */
    t = rules_all(fmt_svo_violations, good.data, good.size);
    CHECK_MSG(t->count == 0, "%s", t->all);
}

TEST(svo_02_head)
{
    begin(), fmt_store32(head(), 22), refuse("SVO-02");
    begin(), fmt_store32(head(), UINT32_MAX), refuse("SVO-02");
    begin(), fmt_store32(head() + 4, 3), refuse("SVO-02");
    begin(), head()[8] = 2, refuse("SVO-02");
    begin(), head()[9] = 2, refuse("SVO-02");
    begin(), fmt_store16(head() + 10, 17), refuse("SVO-02");
    begin(), fmt_store16(head() + 10, 4), refuse("SVO-02");
    begin(), head()[12] = 1, refuse("CON-03");
    begin(), f.chunks[0].payload.size = 143, refuse("SVO-02");
    begin(), svo_buffer_append(&f.chunks[0].payload, NULL, 1000), refuse("SVO-02");
}

TEST(svo_03_matrix)
{
    begin(), put_f64(head() + 16, NAN), refuse("SVO-03");
    begin(), put_f64(head() + 16 + 24, INFINITY), refuse("SVO-03");
    begin(), put_f64(head() + 16 + 120, 2), refuse("SVO-03");
    begin(), put_f64(head() + 16, 0), refuse("SVO-03");
    begin(), put_f64(head() + 16, 5e-324), refuse("SVO-03");
}

TEST(svo_04_channels)
{
    begin(), channel(0)[0] = 'C', refuse("SVO-04");
    begin(), channel(0)[0] = 0, refuse("SVO-04");
    begin(), channel(0)[14] = 'x', refuse("SVO-04");
    begin(), memset(channel(0), 'a', 16), refuse("SVO-04");
    begin(), memcpy(channel(0), channel(1), 16), refuse("SVO-04");
    begin(), channel(0)[16] = 0, refuse("SVO-04");
    begin(), channel(0)[16] = 6, refuse("SVO-04");
    begin(), channel(0)[20] = 2, refuse("SVO-04");
    begin(), channel(0)[24] = 1, refuse("SVO-04"); /* a value though not constant */
    begin(), channel(2)[20] = 1, channel(2)[25] = 1, refuse("SVO-04");
}

TEST(svo_05_codes)
{
    begin(), f.chunks[1].chunk.id = 64, refuse("SVO-05"); /* depth 9: codes below 8^2 */
    begin(), hostile_swap(&f, 1, 2), refuse("SVO-05");
    begin(), hostile_double(&f, 1), refuse("SVO-05");
}

TEST(svo_06_counts)
{
    begin(), f.chunks[1].chunk.element_count++, refuse("SVO-06");
    begin(), f.chunks[1].chunk.element_count = 0, refuse("SVO-06");
    begin(), f.chunks[1].chunk.element_count = UINT64_MAX, refuse("SVO-06");
    begin(), f.chunks[1].chunk.element_count = ((uint64_t)1 << 21) + 1, refuse("SVO-06");
    begin(), fmt_store64(tree_payload(0), fmt_load64(tree_payload(0)) + 1), refuse("SVO-06");
    begin(), fmt_store64(tree_payload(0) + 8, UINT64_MAX), refuse("SVO-06");
    begin(), f.chunks[1].payload.size--, refuse("SVO-06");
    begin(), svo_buffer_append(&f.chunks[1].payload, NULL, 1), refuse("SVO-06");
    begin(), f.chunks[1].payload.size = 8, refuse("SVO-06");
    begin(), svo_buffer_append(&f.chunks[1].payload, NULL, 400000), refuse("SVO-06"); /* more masks than a chunk can have */
}

TEST(svo_07_masks)
{
    begin(), tree_payload(0)[16] = 0, refuse("SVO-07");
    begin(), tree_payload(0)[16] ^= (uint8_t)(tree_payload(0)[16] == 0x10 ? 0x30 : 0x10), refuse("SVO-07");
    begin();
    uint64_t masks = fmt_load64(tree_payload(0));
    tree_payload(0)[16 + masks - 1] ^= 0xff; /* the last mask is that of finest voxels */
    if (tree_payload(0)[16 + masks - 1] == 0) tree_payload(0)[16 + masks - 1] = 1;
    refuse("SVO-07");
    /* one mask more, one value less of the one-byte channel: the sizes agree */
    begin();
    svo_buffer *p = &f.chunks[1].payload;
    fmt_store64(p->data, masks + 14); /* 14 bytes a voxel in this tree */
    fmt_store64(p->data + 8, fmt_load64(p->data + 8) - 1);
    f.chunks[1].chunk.element_count--;
    refuse("SVO-07");
}

TEST(svo_08_statistics)
{
    for (uint32_t i = 0; i < 13 && !test_failed(); i++) {
        begin();
        uint8_t *stat = f.chunks[stat_index()].payload.data + 8 * i;
        fmt_store64(stat, fmt_load64(stat) + 1);
        refuse("SVO-08");
    }
    begin(), f.chunks[stat_index()].payload.size -= 8, refuse("SVO-08");
    begin(), svo_buffer_append(&f.chunks[stat_index()].payload, NULL, 8), refuse("SVO-08");
    begin(), hostile_drop(&f, 1), refuse("SVO-08"); /* a chunk is missing */
}

TEST(svo_09_normals)
{
    begin();
    uint64_t masks = fmt_load64(tree_payload(0)), voxels = fmt_load64(tree_payload(0) + 8);
    uint8_t *planes = tree_payload(0) + 16 + masks + 3 * voxels; /* behind the colours */
    planes[2 * voxels - 1] = 0x80, planes[voxels - 1] = 0;       /* u of the last voxel */
    refuse("SVO-09");
    begin();
    planes = tree_payload(0) + 16 + masks + 3 * voxels;
    planes[2 * voxels] = 0, planes[3 * voxels] = 0x80; /* v of the first */
    refuse("SVO-09");
    begin(), channel(1)[20] = 1, channel(1)[25] = 0x80, refuse("SVO-09");
}

/* --- full leaves --- */

/* Depth 9, so C = 2: full leaves of chunks 0 and 8, chunk 9, the octants 2 and 3 of the grid. */
static void begin_full(void)
{
    static const uint8_t masks[] = {0x03, 0x00, 0x81, 0x00, 0x01, 0x01, 0x03, 0x00, 0x03, 0x00, 0x05}, values[] = {1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0, 7, 0, 8, 0, 9, 0, 10, 0, 11, 0, 12, 0};
    static svo_buffer full;
    if (full.size == 0) {
        static const struct { uint64_t code; uint32_t level; bool tree; } items[] = {{0, 2, false}, {8, 2, false}, {9, 2, true}, {2, 1, false}, {3, 1, false}};
        svo_tree_info info = {.depth = 9, .fill = SVO_FILL_SOLID, .channel_count = 1, .channels = {{.name = "normal", .kind = SVO_KIND_NORMAL_OCT32}}};
        for (int i = 0; i < 16; i += 5) info.voxel_to_world[i] = 1;
        fmt_output *out;
        fmt_svo_writer *w;
        CHECK_OK(fmt_output_open_memory(&full, &out, &err));
        CHECK_OK(fmt_svo_writer_begin(out, &info, NULL, 3, NULL, &w, &err));
        svo_chunk_sink s = fmt_svo_writer_sink(w);
        for (size_t i = 0; i < sizeof items / sizeof items[0]; i++) {
            svo_chunk c = {.code = items[i].code, .level = items[i].level, .depth = 9, .value_count = 1, .channels = {values}};
            if (items[i].tree) c.node_count = sizeof masks, c.masks = masks, c.value_count = 6;
            void *blob;
            CHECK_OK(s.encode(s.user, &c, 0, &blob, &err));
            CHECK_OK(s.commit(s.user, blob, &err));
        }
        CHECK_OK(fmt_svo_writer_end(w, NULL, &err));
        CHECK_OK(fmt_output_commit(out, &err));
    }
    hostile_free(&f);
    hostile_parse(full.data, full.size, &f); /* HEAD, FULL of 2, TREE, FULL of 2, STAT */
}
static uint8_t *full_payload(uint32_t i) { return f.chunks[i].payload.data; }

TEST(svo_11_full_leaves)
{
    begin_full(), expect(SVO_OK, "");
    CHECK(f.count == 5 && f.chunks[1].chunk.type == FMT_FOURCC('F', 'U', 'L', 'L') && f.chunks[3].chunk.id == 16);
    begin_full(), f.chunks[1].chunk.flags = 0, refuse("SVO-11");
    begin_full(), f.chunks[1].chunk.codec = FMT_CODEC_ZSTD, refuse("SVO-11");
    begin_full(), f.chunks[1].chunk.id = 1, refuse("SVO-11");
    begin_full(), f.chunks[1].chunk.element_count = 0, f.chunks[1].chunk.element_stride = 0, refuse("SVO-11");
    begin_full(), f.chunks[1].chunk.element_count = 24, f.chunks[1].chunk.element_stride = 1, refuse("SVO-11");
    begin_full(), fmt_store64(full_payload(1), 1), refuse("SVO-11");                   /* the root */
    begin_full(), fmt_store64(full_payload(1), 0), refuse("SVO-11");
    begin_full(), fmt_store64(full_payload(1), (uint64_t)1 << 9), refuse("SVO-11");    /* level 3: below the cut */
    begin_full(), fmt_store64(full_payload(1), (uint64_t)1 << 7), refuse("SVO-11");    /* between two levels */
    begin_full(), fmt_store64(full_payload(1), UINT64_MAX), refuse("SVO-11");
    begin_full(), fmt_store64(full_payload(1) + 12, 64 + 0), refuse("SVO-05");         /* the same again */
    begin_full(), fmt_store64(full_payload(1) + 12, 64 + 9), refuse("SVO-05");         /* where the TREE chunk is */
    begin_full(), fmt_store64(full_payload(3), 8 + 1), f.chunks[3].chunk.id = 8, refuse("SVO-05"); /* over it */
    begin_full(), hostile_swap(&f, 1, 2), refuse("SVO-05");
    begin_full(), hostile_swap(&f, 3, 4), refuse("SVO-0");
    begin_full(), hostile_drop(&f, 1), refuse("SVO-08");
    begin_full(), full_payload(1)[8] = 0, full_payload(1)[9] = 0x80, refuse("SVO-09");
    begin_full(), f.chunks[2].payload.data[16 + 1] = 1, refuse("SVO-07"); /* a mask where a full leaf was */
    begin_full(), f.chunks[2].payload.data[16] = 0, refuse("SVO-07");
    begin_full(), fmt_store64(f.chunks[4].payload.data + 8, 7), refuse("SVO-08");
    /* a TREE chunk that is one full leaf belongs into FULL */
    begin_full();
    static const uint8_t leaf[20] = {0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 5, 0, 6, 0};
    f.chunks[2].payload.size = 0;
    CHECK(svo_buffer_append(&f.chunks[2].payload, leaf, sizeof leaf) != NULL);
    f.chunks[2].chunk.element_count = 1;
    refuse("SVO-07");
}

TEST(unknown_chunks)
{
    for (uint32_t at = 0; at <= 3 && !test_failed(); at++) { /* anywhere, even first */
        begin();
        uint32_t i = at < 3 ? at : f.count - 1;
        hostile_double(&f, i);
        f.chunks[i].chunk.type = FMT_FOURCC('z', 'z', 'z', 'z');
        f.chunks[i].chunk.flags = 0;
        expect(SVO_OK, "");
        if (test_failed()) return;
        f.chunks[i].chunk.flags = FMT_CHUNK_CRITICAL;
        expect(SVO_UNSUPPORTED, "zzzz");
    }
}

TEST(other_kinds_are_named)
{
    begin(), f.kind = FMT_KIND_SVDAG, refuse(".svdag");
}

TEST(the_writer_refuses_what_no_file_may_hold)
{
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *o;
    fmt_svo_writer *w;
    uint64_t seed = 4;
    tree t;
    tree_random(&t, 8, 1, &seed);
    CHECK_OK(fmt_output_open_memory(&file, &o, &err));
    svo_tree_info info = t.info;
    info.voxel_to_world[0] = NAN;
    CHECK_RESULT(fmt_svo_writer_begin(o, &info, NULL, 0, NULL, &w, &err), SVO_INVALID_ARGUMENT);
    info = t.info, info.depth = 22;
    CHECK_RESULT(fmt_svo_writer_begin(o, &info, NULL, 0, NULL, &w, &err), SVO_INVALID_ARGUMENT);
    CHECK_OK(fmt_svo_writer_begin(o, &t.info, NULL, 0, NULL, &w, &err));
    svo_chunk_sink s = fmt_svo_writer_sink(w);
    svo_buffer masks;
    svo_buffer_init(&masks, NULL);
    svo_chunk chunk;
    void *blob;
    tree_chunk(&t, 0, &masks, &chunk);
    CHECK_OK(s.encode(s.user, &chunk, 0, &blob, &err));
    CHECK_OK(s.commit(s.user, blob, &err));
    CHECK_OK(s.encode(s.user, &chunk, 0, &blob, &err));
    CHECK_RESULT(s.commit(s.user, blob, &err), SVO_RUNTIME); /* the same chunk again */
    CHECK_OK(s.encode(s.user, &chunk, 0, &blob, &err));
    s.discard(s.user, blob);
    chunk.value_count--;
    CHECK_RESULT(s.encode(s.user, &chunk, 0, &blob, &err), SVO_INVALID_DATA);
    svo_buffer_free(&masks);
    fmt_svo_writer_discard(w);
    fmt_output_discard(o);
    tree_free(&t);
}

TEST(a_disk_that_fills_up_stops_the_writer)
{
    fmt_output *o;
    fmt_svo_writer *w;
    uint64_t seed = 4;
    tree t;
    tree_full(&t, 7, &seed); /* megabytes of noise */
    CHECK_OK(fmt_output_open("/dev/full", false, &o, &err));
    CHECK_OK(fmt_svo_writer_begin(o, &t.info, NULL, 0, NULL, &w, &err));
    CHECK_RESULT(tree_feed(&t, 2, fmt_svo_writer_sink(w), &err), SVO_IO);
    CHECK_RESULT(fmt_svo_writer_end(w, NULL, &err), SVO_IO);
    CHECK_RESULT(fmt_output_commit(o, &err), SVO_IO);
    tree_free(&t);
}
