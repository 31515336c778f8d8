/* The container alone: mapped and as a stream, every payload and the META text. */
#include "../fuzz.h"
#include "fmt_container.h"
#include "fmt_survey.h"

static svo_result read_mapped(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_container c;
    SVO_TRY(fmt_container_open(bytes, size, a, &c, err));
    svo_result r = SVO_OK;
    for (uint32_t i = 0; i < c.chunk_count && r == SVO_OK; i++) {
        const uint8_t *stored;
        r = fmt_container_stored(&c, &c.chunks[i], &stored, err);
    }
    char *meta = NULL;
    if (r == SVO_OK) r = fmt_container_meta(&c, a, &meta, err);
    if (r == SVO_OK) fmt_meta_free(a, meta);
    fmt_section sections[4];
    if (fmt_container_sections(&c, sections, 4) > 4) fuzz_fail("more sections than asked for");
    fmt_container_close(&c);
    return r;
}

static svo_result read_stream(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_input *in;
    fmt_stream *s;
    fmt_kind kind;
    uint16_t major;
    SVO_TRY(fmt_input_open_memory(bytes, size, &in, err));
    svo_result r = fmt_stream_open(in, a, &s, &kind, &major, err);
    svo_buffer payload;
    svo_buffer_init(&payload, a);
    bool more = r == SVO_OK;
    fmt_stream *opened = more ? s : NULL;
    while (r == SVO_OK && more) {
        fmt_chunk chunk;
        r = fmt_stream_next(s, &chunk, &more, err);
        if (r == SVO_OK && more && chunk.id % 2 == 0) r = fmt_stream_payload(s, &chunk, &payload, err);
    }
    if (opened != NULL) fmt_stream_close(opened);
    svo_buffer_free(&payload);
    fmt_input_close(in);
    return r;
}

static void see_chunk(void *user, const fmt_chunk *chunk, bool intact)
{
    (void)user, (void)intact;
    if (chunk->offset % 64 != 0) fuzz_fail("a chunk at byte %llu", (unsigned long long)chunk->offset);
}

static void see_damage(void *user, const svo_error *what, uint64_t bytes)
{
    (void)user, (void)bytes;
    if (what->message[0] == '\0') fuzz_fail("damage without a message");
}

/* What one reader refuses the other must refuse (META aside, which a stream's reader checks when it is asked to). */
static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    svo_error second = {0};
    svo_result mapped = read_mapped(bytes, size, a, err), streamed = read_stream(bytes, size, a, &second);
    if (mapped == SVO_OK && streamed != SVO_OK) fuzz_fail("mapped is accepted, stream is refused: %s", second.message);
    if (streamed != SVO_OK && second.message[0] == '\0') fuzz_fail("no message from the stream");
    const fmt_survey survey = {.chunk = see_chunk, .damage = see_damage};
    uint64_t damaged = fmt_survey_file(bytes, size, &survey);
    if (mapped == SVO_OK && damaged != 0) fuzz_fail("accepted, but the survey finds damage in %llu places", (unsigned long long)damaged);
    return mapped;
}

const fuzz_target fuzz_this = {.read = read, .memory = 32 << 20};
