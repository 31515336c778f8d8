#include "fmt_survey.h"

#include "fmti_container.h"

typedef struct survey {
    const uint8_t *data;
    uint64_t size, count;
    const fmt_survey *to;
} survey;

static void report(survey *s, const svo_error *what, uint64_t bytes)
{
    s->count++;
    if (s->to->damage != NULL) s->to->damage(s->to->user, what, bytes);
}

/* Is there a chunk header at this place? */
static bool header_at(const survey *s, uint64_t at, fmt_chunk *c)
{
    svo_error ignored;
    return at <= s->size - FMTI_BLOCK && fmti_parse_chunk(s->data + at, at, c, &ignored) == SVO_OK && c->stored_size <= s->size - at - FMTI_BLOCK;
}

/* A chunk with a sound header. Returns where the next one begins. */
static uint64_t take_chunk(survey *s, const fmt_chunk *c)
{
    svo_error e;
    bool intact = XXH3_64bits(s->data + c->offset, c->stored_size) == c->hash;
    if (!intact) {
        fmt_chunk_fail(&e, SVO_INVALID_DATA, c->type, c->offset - FMTI_BLOCK, "the content is damaged: wrong hash (%s)", c->type == FMT_TYPE_TABLE ? "CON-05" : "CON-07");
        e.index = c->id;
        report(s, &e, c->stored_size);
    }
    if (s->to->chunk != NULL) s->to->chunk(s->to->user, c, intact);
    uint64_t end = c->offset + c->stored_size, next = end + fmti_padding(c->stored_size);
    for (uint64_t i = end; i < next && i < s->size; i++) {
        if (s->data[i] == 0) continue;
        fmt_chunk_fail(&e, SVO_INVALID_DATA, c->type, i, "padding is not 0 (CON-03)");
        report(s, &e, next - end);
        break;
    }
    return next;
}

static void take_chunks(survey *s, uint64_t limit)
{
    uint64_t at = FMTI_BLOCK;
    while (at + FMTI_BLOCK <= limit) {
        fmt_chunk c;
        svo_error e;
        svo_result r = fmti_parse_chunk(s->data + at, at, &c, &e);
        if (r == SVO_OK && c.stored_size <= s->size - at - FMTI_BLOCK) {
            at = take_chunk(s, &c);
            if (c.type == FMT_TYPE_TABLE) break;
            continue;
        }
        if (r == SVO_OK)
            fmt_chunk_fail(&e, SVO_INVALID_DATA, c.type, at, "the chunk of %llu bytes goes beyond the end of the file (CON-06)", (unsigned long long)c.stored_size);
        uint64_t from = at;
        do at += FMTI_BLOCK;
        while (at + FMTI_BLOCK <= limit && !header_at(s, at, &c));
        report(s, &e, (at < s->size ? at : s->size) - from);
    }
}

uint64_t fmt_survey_file(const uint8_t *data, uint64_t size, const fmt_survey *to)
{
    survey s = {data, size, 0, to};
    svo_error e;
    fmt_kind kind;
    uint16_t major, minor;
    if (size < FMTI_BLOCK) {
        fmt_chunk_fail(&e, SVO_INVALID_DATA, 0, 0, size == 0 ? "the file is empty (CON-01)" : "the file is too short for a header (CON-01)");
        report(&s, &e, size);
        return s.count;
    }
    if (fmti_parse_header(data, &kind, &major, &minor, &e) != SVO_OK) report(&s, &e, FMTI_BLOCK);
    uint64_t limit = size;
    fmti_footer f;
    bool whole = size >= 2 * FMTI_BLOCK && size % FMTI_BLOCK == 0;
    if (!whole) {
        fmt_chunk_fail(&e, SVO_INVALID_DATA, 0, size, "the file does not end with a footer; it was cut off or is still being written (CON-04)");
        report(&s, &e, 0);
    } else if (fmti_parse_footer(data + size - FMTI_BLOCK, size - FMTI_BLOCK, &f, &e) != SVO_OK) {
        report(&s, &e, FMTI_BLOCK);
    } else {
        limit = size - FMTI_BLOCK;
        if (f.file_size != size) {
            fmt_chunk_fail(&e, SVO_INVALID_DATA, 0, limit, "the footer speaks of %llu bytes, the file has %llu (CON-04)", (unsigned long long)f.file_size,
                           (unsigned long long)size);
            report(&s, &e, 0);
        }
    }
    take_chunks(&s, limit);
    return s.count;
}
