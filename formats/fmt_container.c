/* Container: headers and footer as bytes, and the reader of a mapped file. */
#include "fmt_container.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "fmti_container.h"

const uint8_t fmti_signature[8] = {0x89, 'S', 'V', 'X', 0x0d, 0x0a, 0x1a, 0x0a};
const uint8_t fmti_end_mark[8] = {0x89, 'S', 'V', 'X', 'E', 'N', 'D', 0x0a};

uint32_t fmt_container_kind(const uint8_t *data, uint64_t size)
{
    if (size < sizeof fmti_signature || memcmp(data, fmti_signature, sizeof fmti_signature) != 0) return 0;
    uint32_t kind = size >= 20 ? fmt_load32(data + 16) : 0;
    return kind != 0 ? kind : UINT32_MAX;
}

void fmt_fourcc_text(uint32_t type, char out[5])
{
    for (int i = 0; i < 4; i++) {
        char c = (char)(type >> 8 * i & 0xff);
        out[i] = c >= 0x20 && c < 0x7f ? c : '?';
    }
    out[4] = 0;
}

svo_result fmt_chunk_fail(svo_error *err, svo_result code, uint32_t type, uint64_t offset, const char *format, ...)
{
    char what[sizeof err->message], name[5];
    va_list args;
    va_start(args, format);
    vsnprintf(what, sizeof what, format, args);
    va_end(args);
    fmt_fourcc_text(type, name);
    if (type != 0) svo_fail(err, code, "chunk %s at byte %llu: %s", name, (unsigned long long)offset, what);
    else svo_fail(err, code, "at byte %llu: %s", (unsigned long long)offset, what);
    if (err != NULL) {
        err->chunk = type;
        err->offset = offset;
    }
    return code;
}

svo_result fmt_chunk_known(const fmt_chunk *chunk, const uint32_t *types, size_t count, svo_error *err)
{
    for (size_t i = 0; i < count; i++)
        if (types[i] == chunk->type) return SVO_OK;
    if ((chunk->flags & FMT_CHUNK_CRITICAL) == 0) return SVO_OK;
    return fmt_chunk_fail(err, SVO_UNSUPPORTED, chunk->type, chunk->offset - FMTI_BLOCK,
                          "the file needs a chunk of this type, which this version does not know; use a newer version (CON-09)");
}

static bool all_zero(const uint8_t *p, uint64_t size)
{
    uint8_t any = 0;
    for (uint64_t i = 0; i < size; i++) any |= p[i];
    return any == 0;
}

svo_result fmti_parse_header(const uint8_t *b, fmt_kind *kind, uint16_t *major, uint16_t *minor, svo_error *err)
{
    if (memcmp(b, fmti_signature, 8) != 0) {
        bool text_mode = memcmp(b, fmti_signature, 4) == 0;
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, 0, text_mode ? "the signature is damaged, as by a transfer in text mode (CON-01)"
                                                                     : "this is not a svokit file: wrong signature (CON-01)");
    }
    if (fmt_load64(b + 56) != XXH3_64bits(b, FMTI_HEADER_HASHED))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, 0, "the file header is damaged: wrong hash (CON-01)");
    if (fmt_load32(b + 12) != FMTI_BLOCK)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, 12, "header size %u, expected 64 (CON-01)", fmt_load32(b + 12));
    if (!all_zero(b + 28, 28)) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, 28, "reserved bytes of the header are not 0 (CON-03)");
    uint32_t k = fmt_load32(b + 16), required = fmt_load32(b + 20);
    if (k != FMT_KIND_SVO && k != FMT_KIND_SVDAG && k != FMT_KIND_SKEL && k != FMT_KIND_SCENE) {
        char name[5];
        fmt_fourcc_text(k, name);
        return fmt_chunk_fail(err, SVO_UNSUPPORTED, 0, 16, "the file is of unknown kind '%s'; use a newer version (CON-02)", name);
    }
    if (fmt_load16(b + 8) != 1)
        return fmt_chunk_fail(err, SVO_UNSUPPORTED, 0, 8, "format version %u.%u; this version reads 1.x (CON-02)", fmt_load16(b + 8), fmt_load16(b + 10));
    if (required != 0)
        return fmt_chunk_fail(err, SVO_UNSUPPORTED, 0, 20, "the file requires features 0x%x that this version does not know (CON-02)", required);
    *kind = (fmt_kind)k;
    *major = fmt_load16(b + 8);
    *minor = fmt_load16(b + 10);
    return SVO_OK;
}

void fmti_store_chunk(const fmt_chunk *c, uint8_t *b)
{
    fmt_store32(b, c->type);
    fmt_store16(b + 4, c->flags);
    fmt_store16(b + 6, c->codec);
    fmt_store64(b + 8, c->stored_size);
    fmt_store64(b + 16, c->decoded_size);
    fmt_store64(b + 24, c->element_count);
    fmt_store32(b + 32, c->element_stride);
    fmt_store32(b + 36, 0);
    fmt_store64(b + 40, c->id);
    fmt_store64(b + 48, c->hash);
    fmt_store64(b + 56, XXH3_64bits(b, FMTI_HEADER_HASHED));
}

svo_result fmti_parse_chunk(const uint8_t *b, uint64_t at, fmt_chunk *c, svo_error *err)
{
    if (fmt_load64(b + 56) != XXH3_64bits(b, FMTI_HEADER_HASHED))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, at, "a chunk header is damaged: wrong hash (CON-06)");
    fmt_chunk n = {.type = fmt_load32(b), .flags = fmt_load16(b + 4), .codec = fmt_load16(b + 6), .offset = at + FMTI_BLOCK,
                   .stored_size = fmt_load64(b + 8), .decoded_size = fmt_load64(b + 16), .element_count = fmt_load64(b + 24),
                   .element_stride = fmt_load32(b + 32), .id = fmt_load64(b + 40), .hash = fmt_load64(b + 48)};
    if ((n.flags & ~FMT_CHUNK_CRITICAL) != 0 || fmt_load32(b + 36) != 0)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, n.type, at, "reserved fields of the chunk header are not 0 (CON-03)");
    if (n.codec > FMT_CODEC_PACKED)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, n.type, at, "unknown codec %u (CON-08)", n.codec);
    if (n.codec == FMT_CODEC_NONE && n.stored_size != n.decoded_size)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, n.type, at, "%llu bytes stored, %llu decoded, though not compressed (CON-08)",
                              (unsigned long long)n.stored_size, (unsigned long long)n.decoded_size);
    uint64_t product;
    if (n.element_stride != 0 && (__builtin_mul_overflow(n.element_count, (uint64_t)n.element_stride, &product) || product != n.decoded_size))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, n.type, at, "%llu elements of %u bytes are not %llu bytes (CON-08)",
                              (unsigned long long)n.element_count, n.element_stride, (unsigned long long)n.decoded_size);
    /* so that no sum of an offset and a size can wrap from here on */
    if (n.stored_size > UINT64_MAX / 4) return fmt_chunk_fail(err, SVO_INVALID_DATA, n.type, at, "impossible size (CON-06)");
    *c = n;
    return SVO_OK;
}

svo_result fmti_parse_footer(const uint8_t *b, uint64_t at, fmti_footer *f, svo_error *err)
{
    if (memcmp(b + 56, fmti_end_mark, 8) != 0)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, at, "the file does not end with a footer; it was cut off or is still being written (CON-04)");
    if (fmt_load64(b + 48) != XXH3_64bits(b, FMTI_FOOTER_HASHED))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, at, "the footer is damaged: wrong hash (CON-04)");
    if (!all_zero(b + 40, 8)) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, at + 40, "reserved bytes of the footer are not 0 (CON-03)");
    f->table_offset = fmt_load64(b);
    f->chunk_count = fmt_load64(b + 8);
    f->file_size = fmt_load64(b + 16);
    memcpy(f->content_hash, b + 24, 16);
    return SVO_OK;
}

/* The table's header and payload, which lie between table_offset and the footer. */
static svo_result check_table(const uint8_t *data, const fmti_footer *f, uint64_t footer_at, svo_error *err)
{
    fmt_chunk t;
    uint64_t at = f->table_offset;
    if (at % FMTI_BLOCK != 0 || at < FMTI_BLOCK || at > footer_at - FMTI_BLOCK)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, FMT_TYPE_TABLE, at, "the table cannot be there (CON-05)");
    if (fmti_parse_chunk(data + at, at, &t, NULL) != SVO_OK)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, FMT_TYPE_TABLE, at, "the header of the table is damaged (CON-05)");
    if (t.type != FMT_TYPE_TABLE || t.flags != FMT_CHUNK_CRITICAL || t.codec != FMT_CODEC_NONE || t.element_stride != FMTI_BLOCK || t.id != 0 ||
        t.element_count != f->chunk_count || t.stored_size != footer_at - FMTI_BLOCK - at)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, t.type, at, "the footer names this place as the table, which it is not (CON-05)");
    if (XXH3_64bits(data + t.offset, (size_t)t.stored_size) != t.hash)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, FMT_TYPE_TABLE, at, "the table is damaged: wrong hash (CON-05)");
    return SVO_OK;
}

/* Walk the chunks from 64 to the table beside the table's elements. */
static svo_result read_chunks(const uint8_t *data, const fmti_footer *f, fmt_chunk *chunks, svo_error *err)
{
    XXH3_state_t hash;
    XXH3_128bits_reset(&hash);
    uint64_t at = FMTI_BLOCK;
    const uint8_t *element = data + f->table_offset + FMTI_BLOCK;
    for (uint64_t i = 0; i < f->chunk_count; i++, element += FMTI_BLOCK) {
        if (at >= f->table_offset || f->table_offset - at < FMTI_BLOCK)
            return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, at, "the table lists more chunks than there are (CON-06)");
        SVO_TRY(fmti_parse_chunk(data + at, at, &chunks[i], err));
        const fmt_chunk *c = &chunks[i];
        if (c->type == FMT_TYPE_TABLE) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "a second table (CON-05)");
        if (fmt_load64(element) != at || memcmp(element + 8, data + at, FMTI_HEADER_HASHED) != 0)
            return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "the chunk header differs from the table (CON-06)");
        if (c->stored_size > f->table_offset - c->offset || fmti_padding(c->stored_size) > f->table_offset - c->offset - c->stored_size)
            return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "the chunk of %llu bytes runs into the table (CON-06)", (unsigned long long)c->stored_size);
        uint64_t end = c->offset + c->stored_size;
        if (!all_zero(data + end, fmti_padding(c->stored_size)))
            return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, end, "padding is not 0 (CON-03)");
        fmti_content_add(&hash, c);
        at = end + fmti_padding(c->stored_size);
    }
    if (at != f->table_offset) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, at, "bytes between the chunks and the table (CON-06)");
    uint8_t content[16];
    fmti_content_get(&hash, content);
    if (memcmp(content, f->content_hash, 16) != 0) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, at, "the content hash does not match (CON-11)");
    return SVO_OK;
}

svo_result fmt_container_open(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_container *out, svo_error *err)
{
    fmt_container c = {.data = data, .size = size, .allocator = a};
    if (size < FMTI_BLOCK) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, 0, size == 0 ? "the file is empty (CON-01)" : "the file is too short for a header (CON-01)");
    SVO_TRY(fmti_parse_header(data, &c.kind, &c.major, &c.minor, err));
    if (size < 3 * FMTI_BLOCK || size % FMTI_BLOCK != 0)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, size, "the file does not end with a footer; it was cut off or is still being written (CON-04)");
    fmti_footer f;
    uint64_t footer_at = size - FMTI_BLOCK;
    SVO_TRY(fmti_parse_footer(data + footer_at, footer_at, &f, err));
    if (f.file_size != size) return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, footer_at, "the footer speaks of %llu bytes, the file has %llu (CON-04)",
                                                   (unsigned long long)f.file_size, (unsigned long long)size);
    if (f.chunk_count > size / (2 * FMTI_BLOCK) || f.chunk_count > UINT32_MAX)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, 0, footer_at, "%llu chunks cannot be in a file of this size (CON-05)", (unsigned long long)f.chunk_count);
    SVO_TRY(check_table(data, &f, footer_at, err));
    c.chunk_count = (uint32_t)f.chunk_count;
    if (c.chunk_count != 0) {
        c.chunks = svo_alloc(a, c.chunk_count, sizeof *c.chunks);
        if (c.chunks == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a table of %u chunks", c.chunk_count);
    }
    svo_result r = read_chunks(data, &f, c.chunks, err);
    if (r != SVO_OK) {
        fmt_container_close(&c);
        return r;
    }
    memcpy(c.content_hash, f.content_hash, 16);
    *out = c;
    return SVO_OK;
}

void fmt_container_close(fmt_container *c)
{
    if (c == NULL) return;
    svo_free(c->allocator, c->chunks, c->chunk_count, sizeof *c->chunks);
    memset(c, 0, sizeof *c);
}

const fmt_chunk *fmt_container_find(const fmt_container *c, uint32_t type, bool any_id, uint64_t id)
{
    for (uint32_t i = 0; i < c->chunk_count; i++)
        if (c->chunks[i].type == type && (any_id || c->chunks[i].id == id)) return &c->chunks[i];
    return NULL;
}

static void add_section(fmt_section *out, uint32_t capacity, uint32_t *count, uint32_t type, uint64_t stored, uint64_t decoded)
{
    uint32_t i = 0;
    while (i < *count && out[i].type != type) i++;
    if (i == capacity) out[--i].type = 0;
    else if (i == *count) out[(*count)++] = (fmt_section){.type = type};
    out[i].chunks++;
    out[i].bytes += FMTI_BLOCK + stored + fmti_padding(stored);
    out[i].payload += stored;
    out[i].decoded += decoded;
}

uint32_t fmt_container_sections(const fmt_container *c, fmt_section *out, uint32_t capacity)
{
    SVO_ASSERT(capacity != 0);
    uint32_t count = 0;
    for (uint32_t i = 0; i < c->chunk_count; i++)
        add_section(out, capacity, &count, c->chunks[i].type, c->chunks[i].stored_size, c->chunks[i].decoded_size);
    uint64_t table = FMTI_BLOCK * (uint64_t)c->chunk_count;
    add_section(out, capacity, &count, FMT_TYPE_TABLE, table, table);
    return count;
}

svo_result fmt_container_payload(const fmt_container *c, const fmt_chunk *chunk, const uint8_t **bytes, svo_error *err)
{
    uint64_t at = chunk->offset - FMTI_BLOCK;
    if (chunk->codec != FMT_CODEC_NONE) return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "compressed, but this chunk must be stored as it is (CON-08)");
    return fmt_container_stored(c, chunk, bytes, err);
}

svo_result fmt_container_stored(const fmt_container *c, const fmt_chunk *chunk, const uint8_t **bytes, svo_error *err)
{
    uint64_t at = chunk->offset - FMTI_BLOCK;
    if (XXH3_64bits(c->data + chunk->offset, (size_t)chunk->stored_size) != chunk->hash)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "the content is damaged: wrong hash (CON-07)");
    *bytes = c->data + chunk->offset;
    return SVO_OK;
}
