/* Container read front to back. The table is not stored: what it must be is hashed while the chunks go by, and the
 * stream's own table must have that hash, so memory does not grow with the number of chunks. */
#include <string.h>

#include "fmti_container.h"

struct fmt_stream {
    fmt_input *in;
    const svo_allocator *allocator;
    XXH3_state_t content, table_hash;
    uint64_t count;
    fmt_chunk pending; /* its payload has not been read yet */
    bool has_pending, ended;
    uint8_t content_hash[16];
    uint8_t scratch[1 << 15];
};

enum { PIECE = 1 << 20 };

static svo_result take(fmt_stream *s, void *to, size_t size, const char *rule, svo_error *err)
{
    size_t got = 0;
    SVO_TRY(fmt_input_read(s->in, to, size, &got, err));
    if (got == size) return SVO_OK;
    return fmt_chunk_fail(err, SVO_INVALID_DATA, s->has_pending ? s->pending.type : 0, fmt_input_offset(s->in),
                          "the file ends too early; it was cut off (%s)", rule);
}

svo_result fmt_stream_open(fmt_input *in, const svo_allocator *a, fmt_stream **out, fmt_kind *kind, uint16_t *major, svo_error *err)
{
    fmt_stream *s = svo_alloc(a, 1, sizeof *s);
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a file reader");
    memset(s, 0, offsetof(fmt_stream, scratch));
    s->in = in;
    s->allocator = a;
    XXH3_128bits_reset(&s->content);
    XXH3_64bits_reset(&s->table_hash);
    uint8_t header[FMTI_BLOCK];
    uint16_t minor;
    size_t got = 0;
    svo_result r = fmt_input_read(in, header, sizeof header, &got, err);
    if (r == SVO_OK && got < sizeof header)
        r = fmt_chunk_fail(err, SVO_INVALID_DATA, 0, got, got == 0 ? "the file is empty (CON-01)" : "the file is too short for a header (CON-01)");
    if (r == SVO_OK) r = fmti_parse_header(header, kind, major, &minor, err);
    if (r != SVO_OK) {
        fmt_stream_close(s);
        return r;
    }
    *out = s;
    return SVO_OK;
}

static svo_result check_payload_end(fmt_stream *s, uint64_t hash, svo_error *err)
{
    const fmt_chunk *c = &s->pending;
    if (hash != c->hash) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - FMTI_BLOCK, "the content is damaged: wrong hash (CON-07)");
    uint8_t zeros[FMTI_BLOCK] = {0}, padding[FMTI_BLOCK];
    size_t n = (size_t)fmti_padding(c->stored_size);
    SVO_TRY(take(s, padding, n, "CON-04", err));
    if (memcmp(padding, zeros, n) != 0) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset + c->stored_size, "padding is not 0 (CON-03)");
    s->has_pending = false;
    return SVO_OK;
}

static svo_result skip_payload(fmt_stream *s, svo_error *err)
{
    XXH3_state_t hash;
    XXH3_64bits_reset(&hash);
    for (uint64_t left = s->pending.stored_size; left != 0;) {
        size_t n = left < sizeof s->scratch ? (size_t)left : sizeof s->scratch;
        SVO_TRY(take(s, s->scratch, n, "CON-04", err));
        XXH3_64bits_update(&hash, s->scratch, n);
        left -= n;
    }
    return check_payload_end(s, XXH3_64bits_digest(&hash), err);
}

/* Table and footer; `t` is the table's chunk. */
static svo_result read_end(fmt_stream *s, const fmt_chunk *t, svo_error *err)
{
    uint64_t at = t->offset - FMTI_BLOCK;
    if (t->flags != FMT_CHUNK_CRITICAL || t->codec != FMT_CODEC_NONE || t->element_stride != FMTI_BLOCK || t->element_count != s->count || t->id != 0)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, t->type, at, "the table lists %llu chunks, the file has %llu (CON-05)",
                              (unsigned long long)t->element_count, (unsigned long long)s->count);
    if (t->hash != XXH3_64bits_digest(&s->table_hash))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, t->type, at, "the chunk headers differ from the table (CON-06)");
    XXH3_64bits_reset(&s->table_hash);
    for (uint64_t left = t->stored_size; left != 0;) {
        size_t n = left < sizeof s->scratch ? (size_t)left : sizeof s->scratch;
        SVO_TRY(take(s, s->scratch, n, "CON-04", err));
        XXH3_64bits_update(&s->table_hash, s->scratch, n);
        left -= n;
    }
    if (t->hash != XXH3_64bits_digest(&s->table_hash)) return fmt_chunk_fail(err, SVO_INVALID_DATA, t->type, at, "the table is damaged: wrong hash (CON-05)");
    uint8_t block[FMTI_BLOCK];
    uint64_t footer_at = fmt_input_offset(s->in);
    fmti_footer f;
    SVO_TRY(take(s, block, sizeof block, "CON-04", err));
    SVO_TRY(fmti_parse_footer(block, footer_at, &f, err));
    if (f.file_size != footer_at + FMTI_BLOCK) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, footer_at, "the footer states a wrong file size (CON-04)");
    if (f.table_offset != at || f.chunk_count != s->count)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, footer_at, "the footer does not lead to the table (CON-05)");
    uint8_t content[16];
    fmti_content_get(&s->content, content);
    if (memcmp(content, f.content_hash, 16) != 0) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, footer_at, "the content hash does not match (CON-11)");
    size_t got = 0;
    SVO_TRY(fmt_input_read(s->in, block, 1, &got, err));
    if (got != 0) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, footer_at + FMTI_BLOCK, "bytes after the footer (CON-04)");
    memcpy(s->content_hash, content, 16);
    s->ended = true;
    return SVO_OK;
}

svo_result fmt_stream_next(fmt_stream *s, fmt_chunk *chunk, bool *more, svo_error *err)
{
    if (s->ended) {
        *more = false;
        return SVO_OK;
    }
    if (s->has_pending) SVO_TRY(skip_payload(s, err));
    uint8_t element[8 + FMTI_BLOCK];
    uint64_t at = fmt_input_offset(s->in);
    fmt_chunk c;
    SVO_TRY(take(s, element + 8, FMTI_BLOCK, "CON-04", err));
    SVO_TRY(fmti_parse_chunk(element + 8, at, &c, err));
    if (c.type == FMT_TYPE_TABLE) {
        SVO_TRY(read_end(s, &c, err));
        *more = false;
        return SVO_OK;
    }
    fmt_store64(element, at);
    XXH3_64bits_update(&s->table_hash, element, FMTI_BLOCK);
    fmti_content_add(&s->content, &c);
    s->count++;
    s->pending = c;
    s->has_pending = true;
    *chunk = c;
    *more = true;
    return SVO_OK;
}

svo_result fmt_stream_payload(fmt_stream *s, const fmt_chunk *chunk, svo_buffer *to, svo_error *err)
{
    SVO_ASSERT(s->has_pending && s->pending.offset == chunk->offset);
    (void)chunk;
    to->size = 0;
    for (uint64_t left = s->pending.stored_size; left != 0;) {
        size_t n = left < PIECE ? (size_t)left : PIECE;
        if (!svo_buffer_reserve(to, n))
            return fmt_chunk_fail(err, SVO_OUT_OF_MEMORY, s->pending.type, s->pending.offset - FMTI_BLOCK, "no memory for its %llu bytes",
                                  (unsigned long long)s->pending.stored_size);
        SVO_TRY(take(s, to->data + to->size, n, "CON-04", err));
        to->size += n;
        left -= n;
    }
    return check_payload_end(s, XXH3_64bits(to->size != 0 ? to->data : (const uint8_t *)"", to->size), err);
}

void fmt_stream_content_hash(const fmt_stream *s, uint8_t out[16]) { memcpy(out, s->content_hash, 16); }

void fmt_stream_close(fmt_stream *s)
{
    if (s != NULL) svo_free(s->allocator, s, 1, sizeof *s);
}
