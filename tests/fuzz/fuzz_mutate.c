/* A mutator for our containers. Most changes keep what surrounds them right (sizes, hashes, table), so that the rules of
 * the kinds are reached and not only those of the container; a .svdag inside a .svscene is changed in the same way. */
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"
#include "hostile.h"

static uint64_t state;
static uint32_t below(uint32_t n)
{
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(state >> 33) % n;
}

static const uint8_t signature[4] = {0x89, 'S', 'V', 'X'};
static bool is_container(const uint8_t *b, size_t size) { return size >= 128 && memcmp(b, signature, 4) == 0; }

static void set_payload(hostile_chunk *c, const uint8_t *bytes, size_t size)
{
    svo_buffer_init(&c->payload, NULL);
    if (size == 0) return;
    if (c->chunk.codec == FMT_CODEC_ZSTD && c->chunk.decoded_size <= (1u << 24) &&
        fmt_zstd_decode(NULL, bytes, size, c->chunk.decoded_size, &c->payload, NULL) == SVO_OK)
        return;
    c->payload.size = 0;
    if (svo_buffer_append(&c->payload, bytes, size) == NULL) abort();
}

/* The chunks as far as their headers make sense; false when there are none. */
static bool take_apart(const uint8_t *b, size_t size, hostile_file *f)
{
    memset(f, 0, sizeof *f);
    f->kind = (fmt_kind)fmt_load32(b + 16), f->major = fmt_load16(b + 8), f->minor = fmt_load16(b + 10);
    for (size_t at = 64; at + 64 <= size && f->count < 200 && fmt_load32(b + at) != FMT_TYPE_TABLE;) {
        const uint8_t *h = b + at;
        uint64_t left = size - at - 64, stored = fmt_load64(h + 8);
        if (stored > left) stored = left;
        hostile_chunk *c = &f->chunks[f->count++];
        c->chunk = (fmt_chunk){fmt_load32(h), fmt_load16(h + 4), fmt_load16(h + 6), at + 64, stored, fmt_load64(h + 16),
                               fmt_load64(h + 24), fmt_load32(h + 32), fmt_load64(h + 40), 0};
        set_payload(c, h + 64, stored);
        hostile_touch(c);
        at += 64 + (stored + 63) / 64 * 64;
    }
    return f->count != 0;
}

static void change_payload(svo_buffer *p, unsigned depth)
{
    size_t room = p->size + 64;
    uint8_t *copy = malloc(room);
    if (copy == NULL) abort();
    if (p->size != 0) memcpy(copy, p->data, p->size);
    size_t n;
    if (depth == 0 && is_container(copy, p->size)) {
        n = LLVMFuzzerCustomMutator(copy, p->size, room, 0);
    } else if (p->size >= 8 && below(3) != 0) { /* one field or a few bytes, sizes kept */
        size_t span = (size_t)1 << below(5), at;
        if (span > p->size) span = 1;
        at = below((uint32_t)(p->size / span)) * span;
        size_t got = LLVMFuzzerMutate(copy + at, span, span);
        if (got < span) memset(copy + at + got, 0, span - got);
        n = p->size;
    } else {
        n = LLVMFuzzerMutate(copy, p->size, room);
    }
    p->size = 0;
    if (n != 0 && svo_buffer_append(p, copy, n) == NULL) abort();
    free(copy);
}

static void change_header(hostile_chunk *c)
{
    uint64_t *const wide[] = {&c->chunk.decoded_size, &c->chunk.element_count, &c->chunk.id, &c->chunk.stored_size};
    uint32_t which = below(8);
    if (which < 4) {
        if (which != 2) c->chunk.stored_size = c->payload.size, c->chunk.decoded_size = c->payload.size;
        LLVMFuzzerMutate((uint8_t *)wide[which], 8, 8);
    } else if (which == 4) LLVMFuzzerMutate((uint8_t *)&c->chunk.type, 4, 4);
    else if (which == 5) c->chunk.flags ^= 1;
    else if (which == 6) c->chunk.codec ^= 1;
    else LLVMFuzzerMutate((uint8_t *)&c->chunk.element_stride, 4, 4);
}

static void change(hostile_file *f, unsigned depth)
{
    uint32_t i = below(f->count), what = below(32);
    if (what < 26) change_payload(&f->chunks[i].payload, depth);
    else if (what < 29) change_header(&f->chunks[i]);
    else if (what == 29 && f->count > 1) hostile_drop(f, i);
    else if (what == 30 && f->count < 200) hostile_double(f, i);
    else hostile_swap(f, i, below(f->count));
}

size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    static hostile_file files[2]; /* the outer file while an inner one is changed */
    static unsigned depth;
    if (depth == 0) state = seed;
    if (!is_container(data, size) || below(24) == 0) return LLVMFuzzerMutate(data, size, max_size);
    hostile_file *f = &files[depth];
    size_t n = 0;
    if (take_apart(data, size, f)) {
        svo_buffer out;
        svo_buffer_init(&out, NULL);
        for (uint32_t rounds = 1 + below(3); rounds != 0; rounds--) {
            unsigned here = depth++;
            change(f, here);
            depth = here;
        }
        hostile_build(f, &out);
        if (out.size <= max_size) memcpy(data, out.data, n = out.size);
        svo_buffer_free(&out);
    }
    hostile_free(f);
    return n != 0 ? n : LLVMFuzzerMutate(data, size, max_size);
}
