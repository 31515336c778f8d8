/* The container: round trip, and every rule of docs/format/container.md broken once, with the hashes around it right. */
#include <string.h>
#include <xxhash.h>

#include "fmt_container.h"
#include "hostile.h"
#include "test.h"

static svo_error err;
#define TYPE_A FMT_FOURCC('A', 'A', 'A', 'A')
#define TYPE_B FMT_FOURCC('B', 'B', 'B', 'B')

static const char text[] = "compressible compressible compressible compressible compressible compressible";

/* Three chunks: 5 bytes as they are, compressed text, META. */
static void make(svo_buffer *file)
{
    fmt_output *o;
    fmt_writer *w;
    svo_buffer packed;
    svo_buffer_init(&packed, NULL);
    CHECK_OK(fmt_output_open_memory(file, &o, &err));
    CHECK_OK(fmt_writer_begin(o, FMT_KIND_SVO, 1, 0, &w, &err));
    fmt_chunk a = {.type = TYPE_A, .flags = FMT_CHUNK_CRITICAL, .stored_size = 5, .decoded_size = 5, .element_count = 5, .element_stride = 1, .id = 42};
    CHECK_OK(fmt_writer_chunk(w, &a, "12345", &err));
    CHECK_OK(fmt_zstd_encode(NULL, text, sizeof text, 3, &packed, &err));
    fmt_chunk b = {.type = TYPE_B, .codec = FMT_CODEC_ZSTD, .stored_size = packed.size, .decoded_size = sizeof text};
    CHECK_OK(fmt_writer_chunk(w, &b, packed.data, &err));
    CHECK_OK(fmt_writer_meta(w, "{\"a\":\"\xc3\xa9\"}", &err));
    CHECK_OK(fmt_writer_end(w, &err));
    CHECK_OK(fmt_output_commit(o, &err));
    svo_buffer_free(&packed);
}

/* Everything a mapped reader does. */
static svo_result read_mapped(const uint8_t *bytes, uint64_t size)
{
    fmt_container c;
    const uint8_t *p;
    char *meta;
    SVO_TRY(fmt_container_open(bytes, size, NULL, &c, &err));
    svo_result r = SVO_OK;
    for (uint32_t i = 0; i < c.chunk_count && r == SVO_OK; i++)
        if (c.chunks[i].codec == FMT_CODEC_NONE) r = fmt_container_payload(&c, &c.chunks[i], &p, &err);
    if (r == SVO_OK) r = fmt_container_meta(&c, NULL, &meta, &err);
    if (r == SVO_OK) fmt_meta_free(NULL, meta);
    fmt_container_close(&c);
    return r;
}

/* Everything a stream reader does; `take` reads payloads, otherwise they are skipped. */
static svo_result read_stream(const uint8_t *bytes, uint64_t size, bool take)
{
    fmt_input *in;
    fmt_stream *s;
    fmt_kind kind;
    uint16_t major;
    svo_buffer b, plain;
    svo_buffer_init(&b, NULL);
    svo_buffer_init(&plain, NULL);
    SVO_TRY(fmt_input_open_memory(bytes, size, &in, &err));
    svo_result r = fmt_stream_open(in, NULL, &s, &kind, &major, &err);
    if (r != SVO_OK) {
        fmt_input_close(in);
        return r;
    }
    for (bool more = true; r == SVO_OK && more;) {
        fmt_chunk c;
        r = fmt_stream_next(s, &c, &more, &err);
        if (r != SVO_OK || !more || !take) continue;
        r = fmt_stream_payload(s, &c, &b, &err);
        if (r == SVO_OK && c.codec == FMT_CODEC_ZSTD) r = fmt_zstd_decode(NULL, b.data, b.size, c.decoded_size, &plain, &err);
    }
    svo_buffer_free(&b);
    svo_buffer_free(&plain);
    fmt_stream_close(s);
    fmt_input_close(in);
    return r;
}

static void expect_one(svo_result r, svo_result code, const char *rule, const char *who)
{
    CHECK_MSG(r == code, "%s: %s, expected %s %s (%s)", who, svo_result_name(r), svo_result_name(code), rule, err.message);
    CHECK_MSG(strstr(err.message, rule) != NULL, "%s: no %s in '%s'", who, rule, err.message);
}

/* All readers refuse the bytes and name the rule. */
static void expect(const uint8_t *bytes, uint64_t size, svo_result code, const char *rule)
{
    expect_one(read_mapped(bytes, size), code, rule, "mapped");
    if (!test_failed()) expect_one(read_stream(bytes, size, true), code, rule, "stream");
    if (!test_failed()) expect_one(read_stream(bytes, size, false), code, rule, "skipping stream");
}

static svo_buffer good, bad;
static uint64_t at_a, at_b, at_meta, at_table, at_footer;

static void begin(void)
{
    if (good.size == 0) {
        make(&good);
        at_footer = good.size - 64;
        at_table = fmt_load64(good.data + at_footer);
        at_a = 64;
        at_b = fmt_load64(good.data + at_table + 128);
        at_meta = fmt_load64(good.data + at_table + 192);
    }
    bad.size = 0;
    svo_buffer_append(&bad, good.data, good.size);
}

static void hash_footer(void) { fmt_store64(bad.data + at_footer + 48, XXH3_64bits(bad.data + at_footer, 48)); }
static void hash_header(uint64_t at) { fmt_store64(bad.data + at + 56, XXH3_64bits(bad.data + at, 56)); }
static void repaired(svo_result code, const char *rule)
{
    hostile_repair(bad.data, bad.size, good.data);
    expect(bad.data, bad.size, code, rule);
}

TEST(what_is_written_is_read)
{
    begin();
    CHECK_OK(read_mapped(good.data, good.size));
    CHECK_OK(read_stream(good.data, good.size, true));
    CHECK_OK(read_stream(good.data, good.size, false));
    fmt_container c;
    CHECK_OK(fmt_container_open(good.data, good.size, NULL, &c, &err));
    CHECK(c.chunk_count == 3 && c.kind == FMT_KIND_SVO && c.major == 1);
    const fmt_chunk *a = fmt_container_find(&c, TYPE_A, false, 42);
    CHECK(a == &c.chunks[0] && a->offset % 64 == 0 && a->element_count == 5 && a->flags == FMT_CHUNK_CRITICAL);
    CHECK(fmt_container_find(&c, TYPE_A, false, 41) == NULL && fmt_container_find(&c, TYPE_B, true, 9) == &c.chunks[1]);
    const uint8_t *p;
    CHECK_OK(fmt_container_payload(&c, a, &p, &err));
    CHECK(memcmp(p, "12345", 5) == 0);
    CHECK_RESULT(fmt_container_payload(&c, &c.chunks[1], &p, &err), SVO_INVALID_DATA);
    char *meta;
    CHECK_OK(fmt_container_meta(&c, NULL, &meta, &err));
    CHECK(strcmp(meta, "{\"a\":\"\xc3\xa9\"}") == 0);
    fmt_meta_free(NULL, meta);
    fmt_section s[8];
    uint64_t sum = 128;
    uint32_t n = fmt_container_sections(&c, s, 8);
    for (uint32_t i = 0; i < n; i++) sum += s[i].bytes;
    CHECK(n == 4 && sum == good.size);
    n = fmt_container_sections(&c, s, 2); /* the rest is summed */
    CHECK(n == 2 && s[1].type == 0 && 128 + s[0].bytes + s[1].bytes == good.size);
    fmt_container_close(&c);
}

TEST(the_independent_builder_agrees)
{
    begin();
    hostile_file f;
    hostile_parse(good.data, good.size, &f);
    hostile_build(&f, &bad);
    CHECK(bad.size == good.size && memcmp(bad.data, good.data, good.size) == 0);
    hostile_free(&f);
}

TEST(many_chunks_spill_the_table)
{
    /* enough for the table to leave memory: 16384 elements of 64 bytes */
    enum { COUNT = 20000 };
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *o;
    fmt_writer *w;
    CHECK_OK(fmt_output_open_memory(&file, &o, &err));
    CHECK_OK(fmt_writer_begin(o, FMT_KIND_SVO, 1, 0, &w, &err));
    for (uint32_t i = 0; i < COUNT; i++) {
        fmt_chunk a = {.type = TYPE_A, .stored_size = 4, .decoded_size = 4, .id = i};
        CHECK_OK(fmt_writer_chunk(w, &a, &i, &err));
    }
    CHECK_OK(fmt_writer_end(w, &err));
    CHECK_OK(fmt_output_commit(o, &err));
    CHECK_OK(read_stream(file.data, file.size, false));
    fmt_container c;
    CHECK_OK(fmt_container_open(file.data, file.size, NULL, &c, &err));
    CHECK(c.chunk_count == COUNT && c.chunks[COUNT - 1].id == COUNT - 1);
    fmt_container_close(&c);
    svo_buffer_free(&file);
}

TEST(no_chunk_at_all)
{
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *o;
    fmt_writer *w;
    CHECK_OK(fmt_output_open_memory(&file, &o, &err));
    CHECK_OK(fmt_writer_begin(o, FMT_KIND_SKEL, 1, 7, &w, &err));
    CHECK_OK(fmt_writer_end(w, &err));
    CHECK_OK(fmt_output_commit(o, &err));
    CHECK_U64(file.size, 192);
    CHECK_OK(read_mapped(file.data, file.size));
    CHECK_OK(read_stream(file.data, file.size, true));
    svo_buffer_free(&file);
}

TEST(con_01_signature_and_header)
{
    begin(), bad.data[1] ^= 1, expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-01");
    begin(), bad.data[4] = '\n', expect(bad.data, bad.size, SVO_INVALID_DATA, "text mode");
    begin(), bad.data[10] ^= 1, expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-01");
    begin(), bad.data[12] = 65, repaired(SVO_INVALID_DATA, "CON-01");
    begin(), expect(bad.data, 0, SVO_INVALID_DATA, "CON-01");
    begin(), expect(bad.data, 63, SVO_INVALID_DATA, "CON-01");
}

TEST(con_02_kind_version_flags)
{
    begin(), bad.data[16] = 'X', repaired(SVO_UNSUPPORTED, "CON-02");
    begin(), bad.data[8] = 2, repaired(SVO_UNSUPPORTED, "CON-02");
    begin(), bad.data[20] = 1, repaired(SVO_UNSUPPORTED, "CON-02");
    begin(), bad.data[24] = 1, hostile_repair(bad.data, bad.size, good.data);
    CHECK_OK(read_mapped(bad.data, bad.size)); /* optional flags and minor versions do not matter */
    begin(), bad.data[10] = 9, hostile_repair(bad.data, bad.size, good.data);
    CHECK_OK(read_stream(bad.data, bad.size, true));
}

TEST(con_03_zero_fields)
{
    begin(), bad.data[40] = 1, repaired(SVO_INVALID_DATA, "CON-03");
    begin(), bad.data[at_a + 4] |= 2, repaired(SVO_INVALID_DATA, "CON-03");
    begin(), bad.data[at_a + 36] = 1, repaired(SVO_INVALID_DATA, "CON-03");
    begin(), bad.data[at_a + 64 + 5] = 1, repaired(SVO_INVALID_DATA, "CON-03");
    begin(), bad.data[at_footer + 40] = 1, repaired(SVO_INVALID_DATA, "CON-03");
}

TEST(con_04_footer)
{
    begin(), expect(bad.data, bad.size - 64, SVO_INVALID_DATA, "CON-04");
    begin(), expect(bad.data, bad.size - 1, SVO_INVALID_DATA, "CON-04");
    begin(), bad.data[at_footer + 60] ^= 1, expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-04");
    begin(), bad.data[at_footer + 16] ^= 64, expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-04");
    begin(), bad.data[at_footer + 16] ^= 64, hash_footer(), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-04");
    begin(), svo_buffer_append(&bad, NULL, 64), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-04");
}

TEST(con_05_table)
{
    begin(), bad.data[at_footer] ^= 64, hash_footer(), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-05");
    begin(), bad.data[at_footer + 8] += 1, hash_footer(), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-05");
    begin(), fmt_store64(bad.data + at_footer + 8, UINT64_MAX / 64), hash_footer(), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-05");
    begin(), fmt_store64(bad.data + at_footer, UINT64_MAX - 63), hash_footer(), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-05");
    begin(), bad.data[at_table + 64 + 9] ^= 1, expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-05");
    begin(), bad.data[at_table + 24] -= 1, hash_header(at_table), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-0");
}

TEST(con_06_chunks_and_table_agree)
{
    begin(), bad.data[at_a + 40] ^= 1, expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-06");
    begin(), bad.data[at_a + 40] ^= 1, hash_header(at_a), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-06");
    /* an element of the table that is wrong, with the right hash of the table */
    begin(), bad.data[at_table + 64] ^= 64;
    fmt_store64(bad.data + at_table + 48, XXH3_64bits(bad.data + at_table + 64, 192));
    hash_header(at_table);
    expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-06");
    /* a size that leads beyond the file */
    begin(), fmt_store64(bad.data + at_b + 8, (uint64_t)1 << 40);
    hostile_repair(bad.data, bad.size, good.data);
    expect_one(read_mapped(bad.data, bad.size), SVO_INVALID_DATA, "CON-06", "mapped");
    expect_one(read_stream(bad.data, bad.size, true), SVO_INVALID_DATA, "CON-04", "stream");
}

TEST(con_07_payload_hash)
{
    begin(), bad.data[at_a + 64 + 2] ^= 1, expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-07");
    CHECK_U64(err.chunk, TYPE_A);
    CHECK_U64(err.offset, at_a);
    begin(), bad.data[at_meta + 64 + 2] ^= 1, expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-07");
}

TEST(con_08_codec_and_sizes)
{
    begin(), bad.data[at_a + 6] = 7, repaired(SVO_INVALID_DATA, "CON-08");
    begin(), bad.data[at_a + 16] = 6, repaired(SVO_INVALID_DATA, "CON-08");
    begin(), bad.data[at_a + 24] = 6, repaired(SVO_INVALID_DATA, "CON-08");
    begin(), fmt_store64(bad.data + at_a + 24, ((uint64_t)1 << 63) + 5), fmt_store32(bad.data + at_a + 32, 2), repaired(SVO_INVALID_DATA, "CON-08");
}

TEST(con_09_unknown_critical_types_are_refused_by_name)
{
    const uint32_t known[] = {TYPE_B};
    fmt_chunk a = {.type = TYPE_A, .flags = FMT_CHUNK_CRITICAL, .offset = 128};
    CHECK_RESULT(fmt_chunk_known(&a, known, 1, &err), SVO_UNSUPPORTED);
    CHECK(strstr(err.message, "AAAA") != NULL && strstr(err.message, "CON-09") != NULL);
    a.flags = 0;
    CHECK_OK(fmt_chunk_known(&a, known, 1, &err));
    CHECK(fmt_chunk_skip(&a, known, 1));
    a.type = TYPE_B;
    CHECK(!fmt_chunk_skip(&a, known, 1));
}

static void refuse_frame(const svo_buffer *frame, uint64_t decoded)
{
    svo_buffer to;
    svo_buffer_init(&to, NULL);
    CHECK_RESULT(fmt_zstd_decode(NULL, frame->data, frame->size, decoded, &to, &err), SVO_INVALID_DATA);
    CHECK_MSG(strstr(err.message, "CON-10") != NULL, "%s", err.message);
    svo_buffer_free(&to);
}

TEST(con_10_one_zstd_frame_of_the_stated_size)
{
    svo_buffer frame, to;
    svo_buffer_init(&frame, NULL);
    svo_buffer_init(&to, NULL);
    CHECK_OK(fmt_zstd_encode(NULL, text, sizeof text, 3, &frame, &err));
    CHECK_OK(fmt_zstd_decode(NULL, frame.data, frame.size, sizeof text, &to, &err));
    CHECK(to.size == sizeof text && memcmp(to.data, text, sizeof text) == 0);
    refuse_frame(&frame, sizeof text - 1);
    refuse_frame(&frame, sizeof text + 1);
    refuse_frame(&frame, UINT64_MAX);
    size_t size = frame.size;
    frame.size--;
    refuse_frame(&frame, sizeof text);
    frame.size = size;
    svo_buffer_append(&frame, NULL, 1); /* bytes behind it */
    refuse_frame(&frame, sizeof text);
    frame.size = size;
    svo_buffer two; /* two frames */
    svo_buffer_init(&two, NULL);
    svo_buffer_append(&two, frame.data, size);
    svo_buffer_append(&two, frame.data, size);
    refuse_frame(&two, sizeof text);
    refuse_frame(&two, 2 * sizeof text);
    static const uint8_t skippable[12] = {0x50, 0x2a, 0x4d, 0x18, 4, 0, 0, 0, 1, 2, 3, 4};
    two.size = 0;
    svo_buffer_append(&two, skippable, sizeof skippable);
    refuse_frame(&two, 0);
    CHECK_OK(fmt_zstd_encode(NULL, "", 0, 3, &frame, &err));
    CHECK_OK(fmt_zstd_decode(NULL, frame.data, frame.size, 0, &to, &err));
    CHECK_U64(to.size, 0);
    svo_buffer_free(&two);
    svo_buffer_free(&frame);
    svo_buffer_free(&to);
}

TEST(con_11_content_hash)
{
    begin(), bad.data[at_footer + 24] ^= 1, hash_footer(), expect(bad.data, bad.size, SVO_INVALID_DATA, "CON-11");
}

TEST(provenance_is_not_part_of_the_content)
{
    begin();
    hostile_file f;
    hostile_parse(good.data, good.size, &f);
    f.chunks[2].payload.data[2] = 'b';
    hostile_build(&f, &bad);
    CHECK(memcmp(bad.data + bad.size - 40, good.data + good.size - 40, 16) == 0);
    f.chunks[0].payload.data[0] = '2';
    hostile_build(&f, &bad);
    CHECK(memcmp(bad.data + bad.size - 40, good.data + good.size - 40, 16) != 0);
    hostile_free(&f);
}

TEST(con_12_meta)
{
    hostile_file f;
    static const char *const texts[] = {"", "[]", "{", "{}x", "{\"a\":\"\xff\"}", "{\"a\":1,\"a\":2}", "null"};
    for (size_t i = 0; i < sizeof texts / sizeof texts[0] && !test_failed(); i++) {
        begin();
        hostile_parse(good.data, good.size, &f);
        f.chunks[2].payload.size = 0;
        svo_buffer_append(&f.chunks[2].payload, texts[i], strlen(texts[i]));
        hostile_build(&f, &bad);
        expect_one(read_mapped(bad.data, bad.size), SVO_INVALID_DATA, "CON-12", texts[i]);
        hostile_free(&f);
    }
    begin();
    hostile_parse(good.data, good.size, &f);
    hostile_double(&f, 2);
    hostile_build(&f, &bad);
    expect_one(read_mapped(bad.data, bad.size), SVO_INVALID_DATA, "CON-12", "twice");
    hostile_drop(&f, 3);
    f.chunks[2].chunk.flags = FMT_CHUNK_CRITICAL;
    hostile_build(&f, &bad);
    expect_one(read_mapped(bad.data, bad.size), SVO_INVALID_DATA, "CON-12", "critical");
    hostile_free(&f);
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *o;
    fmt_writer *w;
    CHECK_OK(fmt_output_open_memory(&file, &o, &err));
    CHECK_OK(fmt_writer_begin(o, FMT_KIND_SVO, 1, 0, &w, &err));
    CHECK_RESULT(fmt_writer_meta(w, "not JSON", &err), SVO_INVALID_ARGUMENT);
    fmt_writer_discard(w);
    fmt_output_discard(o);
    CHECK_U64(file.size, 0);
    svo_buffer_free(&file);
}

/* Reader for the damaged containers: both ways, everything touched. */
static svo_result read_both(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *e)
{
    (void)user, (void)a;
    svo_result r = read_mapped(bytes, size);
    if (r == SVO_OK) r = read_stream(bytes, size, true);
    if (r == SVO_OK && read_stream(bytes, size, false) != SVO_OK) test_fail(__FILE__, __LINE__, "skipping refuses what reading takes: %s", err.message);
    if (r != SVO_OK && e != NULL) *e = err, e->code = r;
    return r;
}

TEST(damaged_containers)
{
    begin();
    hostile_case c = {.read = read_both, .bytes = good.data, .size = good.size, .rounds = 3000, .seed = 9};
    hostile_truncations(&c);
    hostile_flips(&c);
    hostile_repaired_flips(&c);
    hostile_payloads(&c);
    hostile_orders(&c);
}
