/* Internal to libsvo: strings of bits, highest bit of a byte first. Not installed. */
#ifndef SVOI_BITS_H
#define SVOI_BITS_H

#include <string.h>

#include "svo_alloc.h"

enum { SVOI_BITS_GUARD = 16 }; /* zero bytes after a string, so that a load at any bit of it stays inside */

/* The 64 bits from bit `at` on, of which the first 57 are right. */
static inline uint64_t svoi_bits_peek(const uint8_t *bytes, uint64_t at)
{
    uint64_t v;
    memcpy(&v, bytes + (at >> 3), 8);
    return __builtin_bswap64(v) << (at & 7);
}

/* `n` bits, 0 <= n <= 57. */
static inline uint64_t svoi_bits_get(const uint8_t *bytes, uint64_t at, uint32_t n)
{
    return svoi_bits_peek(bytes, at) >> 1 >> (63 - n);
}

/* Bits that a number takes. */
static inline uint32_t svoi_bit_width(uint64_t v) { return v == 0 ? 0 : 64 - (uint32_t)__builtin_clzll(v); }

typedef struct svoi_bit_writer {
    svo_buffer *to;
    uint64_t last;  /* bits not yet in `to`, the first one highest */
    uint32_t count; /* of these, < 8 between calls */
    bool ok;        /* false: out of memory */
} svoi_bit_writer;

static inline void svoi_bits_put(svoi_bit_writer *w, uint64_t v, uint32_t n)
{
    SVO_ASSERT(n <= 56 && v >> n == 0);
    if (n == 0) return;
    w->last |= v << (64 - n) >> w->count;
    w->count += n;
    uint8_t bytes[8];
    uint32_t whole = w->count >> 3;
    for (uint32_t i = 0; i < whole; i++) bytes[i] = (uint8_t)(w->last >> (56 - 8 * i));
    w->ok = w->ok && svo_buffer_append(w->to, bytes, whole) != NULL;
    w->last = whole == 8 ? 0 : w->last << 8 * whole;
    w->count &= 7;
}

static inline uint64_t svoi_bits_written(const svoi_bit_writer *w) { return 8 * (uint64_t)w->to->size + w->count; }

/* Zeros up to the next byte. */
static inline void svoi_bits_align(svoi_bit_writer *w)
{
    if (w->count != 0) svoi_bits_put(w, 0, 8 - w->count);
}

#endif
