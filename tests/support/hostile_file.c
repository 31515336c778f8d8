/* Taking containers apart and putting them together again: written from docs/format/container.md, apart from the
 * library's writer, so that it can write what the writer never would. */
#define XXH_STATIC_LINKING_ONLY
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

#include "hostile.h"

static void must(bool ok)
{
    if (!ok) abort(); /* the test itself is wrong */
}

void hostile_parse(const uint8_t *bytes, uint64_t size, hostile_file *f)
{
    memset(f, 0, sizeof *f);
    f->kind = (fmt_kind)fmt_load32(bytes + 16);
    f->major = fmt_load16(bytes + 8);
    f->minor = fmt_load16(bytes + 10);
    uint64_t table = fmt_load64(bytes + size - 64), count = fmt_load64(bytes + size - 56);
    must(count < 256);
    f->count = (uint32_t)count;
    for (uint32_t i = 0; i < f->count; i++) {
        uint64_t at = fmt_load64(bytes + table + 64 + 64 * (uint64_t)i);
        const uint8_t *h = bytes + at;
        fmt_chunk c = {fmt_load32(h), fmt_load16(h + 4), fmt_load16(h + 6), at + 64, fmt_load64(h + 8), fmt_load64(h + 16),
                       fmt_load64(h + 24), fmt_load32(h + 32), fmt_load64(h + 40), fmt_load64(h + 48)};
        f->chunks[i].chunk = c;
        svo_buffer_init(&f->chunks[i].payload, NULL);
        if (c.codec == FMT_CODEC_ZSTD) must(fmt_zstd_decode(NULL, bytes + c.offset, c.stored_size, c.decoded_size, &f->chunks[i].payload, NULL) == SVO_OK);
        else must(c.stored_size == 0 || svo_buffer_append(&f->chunks[i].payload, bytes + c.offset, c.stored_size) != NULL);
        hostile_touch(&f->chunks[i]);
    }
}

void hostile_free(hostile_file *f)
{
    for (uint32_t i = 0; i < f->count; i++) svo_buffer_free(&f->chunks[i].payload);
    f->count = 0;
}

hostile_chunk *hostile_find(hostile_file *f, uint32_t type)
{
    for (uint32_t i = 0; i < f->count; i++)
        if (f->chunks[i].chunk.type == type) return &f->chunks[i];
    must(false);
    return NULL;
}

void hostile_drop(hostile_file *f, uint32_t index)
{
    must(index < f->count);
    svo_buffer_free(&f->chunks[index].payload);
    memmove(&f->chunks[index], &f->chunks[index + 1], (--f->count - index) * sizeof f->chunks[0]);
}

void hostile_double(hostile_file *f, uint32_t index)
{
    must(index < f->count && f->count < 256);
    memmove(&f->chunks[index + 1], &f->chunks[index], (f->count++ - index) * sizeof f->chunks[0]);
    svo_buffer *old = &f->chunks[index + 1].payload, fresh;
    svo_buffer_init(&fresh, NULL);
    must(old->size == 0 || svo_buffer_append(&fresh, old->data, old->size) != NULL);
    f->chunks[index].payload = fresh;
}

void hostile_swap(hostile_file *f, uint32_t a, uint32_t b)
{
    must(a < f->count && b < f->count);
    hostile_chunk t = f->chunks[a];
    f->chunks[a] = f->chunks[b];
    f->chunks[b] = t;
}

static void put(svo_buffer *out, const void *bytes, size_t size)
{
    must(size == 0 || svo_buffer_append(out, bytes, size) != NULL);
}

static void store_header(const fmt_chunk *c, uint8_t *h)
{
    memset(h, 0, 64);
    fmt_store32(h, c->type);
    fmt_store16(h + 4, c->flags);
    fmt_store16(h + 6, c->codec);
    fmt_store64(h + 8, c->stored_size);
    fmt_store64(h + 16, c->decoded_size);
    fmt_store64(h + 24, c->element_count);
    fmt_store32(h + 32, c->element_stride);
    fmt_store64(h + 40, c->id);
}

/* All hashes, by the positions of the chunk headers. */
static void hash_all(uint8_t *b, uint64_t size, const uint64_t *at, uint64_t count, uint64_t table)
{
    XXH3_state_t content;
    XXH3_128bits_reset(&content);
    fmt_store64(b + 56, XXH3_64bits(b, 56));
    for (uint64_t i = 0; i <= count; i++) {
        uint64_t p = i < count ? at[i] : table;
        uint8_t *h = b + p;
        if (i < count) {
            uint64_t stored = fmt_load64(h + 8);
            if (stored <= size - p - 64) fmt_store64(h + 48, XXH3_64bits(h + 64, stored));
            if (fmt_load32(h) != FMT_TYPE_META) XXH3_128bits_update(&content, h + 48, 8);
            fmt_store64(b + table + 64 + 64 * i, p);
            memcpy(b + table + 64 + 64 * i + 8, h, 56);
        } else {
            fmt_store64(h + 48, XXH3_64bits(h + 64, 64 * count));
        }
        fmt_store64(h + 56, XXH3_64bits(h, 56));
    }
    XXH128_canonical_t canonical;
    XXH128_canonicalFromHash(&canonical, XXH3_128bits_digest(&content));
    memcpy(b + size - 64 + 24, canonical.digest, 16);
    fmt_store64(b + size - 16, XXH3_64bits(b + size - 64, 48));
}

void hostile_build(const hostile_file *f, svo_buffer *out)
{
    static const uint8_t signature[8] = {0x89, 'S', 'V', 'X', 0x0d, 0x0a, 0x1a, 0x0a}, mark[8] = {0x89, 'S', 'V', 'X', 'E', 'N', 'D', 0x0a};
    uint8_t block[64] = {0};
    uint64_t at[256];
    out->size = 0;
    memcpy(block, signature, 8);
    fmt_store16(block + 8, f->major);
    fmt_store16(block + 10, f->minor);
    fmt_store32(block + 12, 64);
    fmt_store32(block + 16, (uint32_t)f->kind);
    put(out, block, 64);
    svo_buffer packed;
    svo_buffer_init(&packed, NULL);
    for (uint32_t i = 0; i < f->count; i++) {
        fmt_chunk c = f->chunks[i].chunk;
        const svo_buffer *p = &f->chunks[i].payload;
        if (c.codec == FMT_CODEC_ZSTD) {
            must(fmt_zstd_encode(NULL, p->data, p->size, 3, &packed, NULL) == SVO_OK);
            p = &packed;
        }
        if (c.stored_size == UINT64_MAX) {
            c.stored_size = p->size;
            if (c.codec != FMT_CODEC_PACKED || c.type != FMT_FOURCC('T', 'R', 'E', 'E')) c.decoded_size = f->chunks[i].payload.size;
            if (c.element_stride != 0 && c.decoded_size % c.element_stride == 0) c.element_count = c.decoded_size / c.element_stride;
        }
        at[i] = out->size;
        store_header(&c, block);
        put(out, block, 64);
        put(out, p->data, p->size);
        put(out, NULL, (64 - out->size % 64) % 64);
    }
    svo_buffer_free(&packed);
    uint64_t table = out->size, bytes = 64 * (uint64_t)f->count;
    fmt_chunk t = {.type = FMT_TYPE_TABLE, .flags = FMT_CHUNK_CRITICAL, .stored_size = bytes, .decoded_size = bytes, .element_count = f->count, .element_stride = 64};
    store_header(&t, block);
    put(out, block, 64);
    put(out, NULL, bytes);
    memset(block, 0, 64);
    fmt_store64(block, table);
    fmt_store64(block + 8, f->count);
    fmt_store64(block + 16, out->size + 64);
    memcpy(block + 56, mark, 8);
    put(out, block, 64);
    hash_all(out->data, out->size, at, f->count, table);
}

void hostile_repair(uint8_t *bytes, uint64_t size, const uint8_t *original)
{
    uint64_t at[256], table = fmt_load64(original + size - 64), count = fmt_load64(original + size - 56);
    must(count <= 256);
    for (uint64_t i = 0; i < count; i++) at[i] = fmt_load64(original + table + 64 + 64 * i);
    hash_all(bytes, size, at, count, table);
}
