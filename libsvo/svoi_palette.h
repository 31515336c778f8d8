/* Internal: choosing and writing blocks (svo_palette.h). Not installed. */
#ifndef SVOI_PALETTE_H
#define SVOI_PALETTE_H

#include "svo_palette.h"

enum {
    SVOI_GRANULES = 64,     /* in a superblock */
    SVOI_LEVELS = 7,        /* block sizes 16 << 0 .. 16 << 6 */
    SVOI_HEADER_BITS = 16,  /* of a block */
    SVOI_ENTRIES = 256,     /* of a palette, at most */
    SVOI_REACH = 2047       /* a block's data begins at most here */
};

/* svo_lattice_point, for those who read many: a lattice that stays in registers. */
static inline uint32_t svoi_clamp8(int32_t v) { return v < 0 ? 0 : v > 255 ? 255 : (uint32_t)v; }
static inline uint32_t svoi_clamp16(int64_t v) { return (uint16_t)(int16_t)(v < -32767 ? -32767 : v > 32767 ? 32767 : v); }

static inline uint32_t svoi_lattice_point(svo_channel_kind kind, const svo_lattice *l, uint32_t number)
{
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: {
        uint32_t n0 = (uint32_t)l->n[0], n1 = (uint32_t)l->n[1], q = number / n0, p = q / n1;
        int32_t y = l->low[0] + (int32_t)((number - q * n0) * l->step[0]);
        int32_t co = l->low[1] + (int32_t)((q - p * n1) * l->step[1]);
        int32_t cg = l->low[2] + (int32_t)(p * l->step[2]);
        int32_t t = y - (cg >> 1), g = cg + t, b = t - (co >> 1), r = b + co;
        return svoi_clamp8(r) | svoi_clamp8(g) << 8 | svoi_clamp8(b) << 16;
    }
    case SVO_KIND_NORMAL_OCT32: {
        uint32_t n0 = (uint32_t)l->n[0], q = number / n0;
        return svoi_clamp16(l->low[0] + (int64_t)(number - q * n0) * l->step[0]) | svoi_clamp16(l->low[1] + (int64_t)q * l->step[1]) << 16;
    }
    case SVO_KIND_UNORM8: return svoi_clamp8(l->low[0] + (int32_t)(number * l->step[0]));
    case SVO_KIND_ID16: return ((uint32_t)l->low[0] + number) & 0xffff;
    case SVO_KIND_ID32: return (uint32_t)l->low[0] + number;
    }
    return 0;
}

typedef struct svoi_bits { uint8_t *p; uint64_t bits; uint32_t held; } svoi_bits;

static inline void svoi_put(svoi_bits *w, uint32_t value, uint32_t width)
{
    w->bits |= (uint64_t)value << w->held;
    w->held += width;
    while (w->held >= 8) {
        *w->p++ = (uint8_t)w->bits;
        w->bits >>= 8;
        w->held -= 8;
    }
}

static inline void svoi_put_end(svoi_bits *w)
{
    if (w->held != 0) *w->p++ = (uint8_t)w->bits;
    w->bits = 0;
    w->held = 0;
}

/* A block as it is to be written. `number` has one for each value, runs are found from it. */
typedef struct svoi_block {
    uint32_t mode, length;
    uint32_t entry[SVOI_ENTRIES], entries; /* table indices */
    svo_lattice lattice;
    uint32_t number[SVO_SUPERBLOCK];
} svoi_block;

uint32_t svoi_step_of(svo_channel_kind kind, uint32_t code);
uint32_t svoi_step_code(svo_channel_kind kind, uint32_t step); /* largest code whose step is not above */
void svoi_lattice_width(svo_lattice *l);
void svoi_put_lattice(svoi_bits *w, svo_channel_kind kind, const svo_lattice *l);

/* What encoding a channel needs to know; read by all workers. */
typedef struct svoi_encoder {
    const svo_palette_job *job;
    uint32_t table_bits, lattice_bits;
    uint64_t *slots, slot_count; /* value << 32 | index + 1 */
    struct svoi_points *points; /* only with a bound: svoi_points.h */
} svoi_encoder;

#define SVOI_NO_INDEX UINT32_MAX
bool svoi_table_fill(svoi_encoder *e); /* slots of the job's table; false: out of memory */
uint32_t svoi_table_index(const svoi_encoder *e, uint32_t value); /* SVOI_NO_INDEX: not in the table */

/* A chooser: looks at 1024 values, gives the map of begins, then block by block what to write. */
typedef struct svoi_chooser {
    void *(*create)(const svoi_encoder *e, const svo_allocator *a);
    void (*destroy)(void *state, const svo_allocator *a);
    uint64_t (*choose)(void *state, const uint32_t *v);
    void (*block)(void *state, uint32_t first_granule, uint32_t end_granule, svoi_block *out);
} svoi_chooser;

extern const svoi_chooser svoi_exact, svoi_lossy;

svo_result svoi_lossy_prepare(svoi_encoder *e, svo_error *err);
void svoi_lossy_release(svoi_encoder *e);

/* Map, headers and data; a superblock of noise is one block, and no block begins beyond SVOI_REACH. */
enum { SVOI_SUPERBLOCK_MAX = SVO_PALETTE_ENTRY + 2 * SVOI_GRANULES + SVOI_REACH + 5 * SVO_SUPERBLOCK };

/* Which entries of a table its blocks name. */
typedef struct svoi_used {
    uint64_t *bit;    /* of each entry */
    uint32_t *before; /* entries named before each word of `bit` */
    uint64_t words, count;
} svoi_used;
uint32_t svoi_used_index(const svoi_used *u, uint32_t index); /* of a named entry, among these */
void svoi_used_free(svoi_used *u, const svo_allocator *a);

/* A limit that is to grow: bytes that it does not mean. NULL: there is none. */
static inline void svoi_limit_raise(svo_limit_allocator *limit, uint64_t bytes)
{
    if (limit != NULL && __atomic_load_n(&limit->limit, __ATOMIC_RELAXED) != UINT64_MAX) (void)__atomic_add_fetch(&limit->limit, bytes, __ATOMIC_RELAXED);
}

/* svo_palette_encode; the limit (NULL: none) grows by one and a half times the bytes that are written, since these are output. */
svo_result svoi_palette_encode(const svo_palette_job *job, svo_limit_allocator *limit, svo_buffer *directory, svo_buffer *payload,
                               svo_palette_stats *stats, svo_error *err);

/* Rewrite sound blocks for a table without the entries that none of them names. `used` (to be freed) says which those are not; count 0: there
 * was nothing to encode. */
svo_result svoi_palette_drop_unused(svo_channel_kind kind, uint64_t table_count, svo_buffer *directory, svo_buffer *payload, svoi_used *used,
                                    const svo_allocator *a, svo_error *err);

/* Leave out superblocks that repeat the last value of the one before, if that is smaller: `directory` becomes the records of svo_palette.repeats,
 * *words of them (0: nothing was changed), and the entries. p is what directory and payload were. */
svo_result svoi_palette_skip_repeats(const svo_palette *p, svo_buffer *directory, svo_buffer *payload, uint64_t *words, svo_error *err);

/* Error of `other` for `value`: CIE94 or degrees, in double precision. */
double svoi_error_of(svo_channel_kind kind, uint32_t value, uint32_t other);

#endif
