#include "svo_block.h"

#include <string.h>

#include "svo_morton.h"

void svo_block_init(svo_block *b)
{
    memset(b, 0, sizeof *b);
    for (uint32_t axis = 0; axis < 3; axis++)
        for (uint32_t i = 0; i < SVO_RASTER_SIZE; i++) b->spread[axis][i] = (uint32_t)(svo_morton_spread(i) << axis);
}

void svo_block_clear(svo_block *b)
{
    for (uint32_t i = 0; i < 512; i++) {
        uint64_t bits = b->used[i] | b->dirty[i];
        while (bits != 0) {
            uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(bits);
            bits &= bits - 1;
            b->bricks[brick] = b->complex[brick] = b->masked[brick] = 0;
        }
        b->used[i] = b->dirty[i] = 0;
    }
}

void svo_block_mark(svo_block *b, const svo_raster_row *row)
{
    const uint32_t *along = b->spread[row->w];
    for (int32_t u = row->u0; u <= row->u1; u++) {
        uint32_t column = svo_block_column(b, row, u);
        for (int32_t w = row->lo[u]; w <= row->hi[u]; w++) svo_block_set(b, column | along[w]);
    }
}

void svo_block_mark_flat(svo_block *b, const svo_raster_row *row)
{
    const uint32_t *along = b->spread[row->w];
    for (int32_t u = row->u0; u <= row->u1; u++) {
        uint32_t column = svo_block_column(b, row, u);
        for (int32_t w = row->lo[u]; w <= row->hi[u]; w++) {
            uint32_t code = column | along[w];
            uint64_t old = b->bricks[code >> 6], bit = (uint64_t)1 << (code & 63);
            if (old & bit) b->complex[code >> 6] |= bit;
            else svo_block_set(b, code);
        }
    }
}

void svo_block_mark_shaded(svo_block *b, const svo_raster_row *row)
{
    const uint32_t *along = b->spread[row->w];
    for (int32_t u = row->u0; u <= row->u1; u++) {
        uint32_t column = svo_block_column(b, row, u);
        for (int32_t w = row->lo[u]; w <= row->hi[u]; w++) {
            uint32_t code = column | along[w];
            svo_block_set(b, code);
            b->complex[code >> 6] |= (uint64_t)1 << (code & 63);
        }
    }
}

/* --- visits ------------------------------------------------------------------------------------------------------- */

static inline void add_bits(svo_block_visits *v, uint32_t slot, uint32_t brick, uint64_t bits)
{
    const uint32_t open = v->open[slot];
    /* what another triangle or another chunk left there is out of range, or happens to be right */
    if (open - v->first < v->count - v->first && v->at[open].brick == brick) {
        v->at[open].bits |= bits;
        return;
    }
    v->open[slot] = v->count;
    v->at[v->count++] = (svo_block_visit){bits, brick};
}

/* Bits of two columns of four voxels, neighbours along u, by four bits each of the voxels that are there: bit i of eight is voxel (i / 4, i % 4) of (u, w). */
#define BIT(u, w, n, i) ((uint64_t)((n) >> (i) & 1) << (((i) >> 2) << (u) | ((i) & 1) << (w) | (((i) >> 1 & 1) << (3 + (w)))))
#define BITS(u, w, n) (BIT(u, w, n, 0) | BIT(u, w, n, 1) | BIT(u, w, n, 2) | BIT(u, w, n, 3) | BIT(u, w, n, 4) | BIT(u, w, n, 5) | BIT(u, w, n, 6) | BIT(u, w, n, 7))
#define BITS4(u, w, n) BITS(u, w, n), BITS(u, w, n + 1), BITS(u, w, n + 2), BITS(u, w, n + 3)
#define BITS16(u, w, n) BITS4(u, w, n), BITS4(u, w, n + 4), BITS4(u, w, n + 8), BITS4(u, w, n + 12)
#define BITS64(u, w, n) BITS16(u, w, n), BITS16(u, w, n + 16), BITS16(u, w, n + 32), BITS16(u, w, n + 48)
#define BITS256(u, w) {BITS64(u, w, 0), BITS64(u, w, 64), BITS64(u, w, 128), BITS64(u, w, 192)}
static const uint64_t plane_bits[3][3][256] = {{{0}, BITS256(0, 1), BITS256(0, 2)}, {BITS256(1, 0), {0}, BITS256(1, 2)}, {BITS256(2, 0), BITS256(2, 1), {0}}};

typedef int32_t columns __attribute__((vector_size(16)));
typedef uint32_t column_set __attribute__((vector_size(16)));
typedef uint64_t halves __attribute__((vector_size(16)));

/* All bits that are set in one of four. */
static inline uint32_t any_of(const column_set *c)
{
    const halves h = (halves)*c;
    const uint64_t both = h[0] | h[1];
    return (uint32_t)(both | both >> 32);
}

/* Four columns u .. u + 3, as far as the row has them. `base` is a multiple of four; what lies outside of [base, base + 31] is left out. True where nothing does. */
static inline bool remember_columns(const svo_raster_row *row, int32_t u, uint32_t column, const uint64_t *bits_of, const uint32_t *along, int32_t base, svo_block_visits *v)
{
    const columns number = {0, 1, 2, 3}, zero = {0};
    columns lo, hi;
    memcpy(&lo, row->lo + u, sizeof lo);
    memcpy(&hi, row->hi + u, sizeof hi);
    columns there = (lo <= hi) & (number >= row->u0 - u) & (number <= row->u1 - u);
    lo = (lo & there) - base; /* the others are whatever an earlier row left there */
    hi = (hi & there) - base;
    const columns first = lo & (lo > 0), last = (hi & (hi < 31)) | ((zero + 31) & (hi >= 31)), whole = (first == lo) & (last == hi);
    const column_set outside = (column_set)(there & ~whole);
    there &= first <= last;
    /* voxels first .. last as bits */
    const column_set one = {1, 1, 1, 1}, length = (column_set)((last - first) & there), begin = (column_set)(first & there);
    const column_set voxels = ((((one << length) << 1) - 1) << begin) & (column_set)there, place = {0, 4, 8, 12};
    for (uint32_t all = any_of(&voxels); all != 0;) {
        const uint32_t k = (uint32_t)__builtin_ctz(all) / 4;
        const column_set part = ((voxels >> 4 * k) & 15) << place;
        const uint32_t plane = any_of(&part);
        const uint32_t code = column | along[base + 4 * (int32_t)k];
        const uint64_t bits = bits_of[plane & 255] | bits_of[plane >> 8] << (8 << row->u);
        all &= ~((uint32_t)15 << 4 * k);
        add_bits(v, ((uint32_t)u / 4 * 2) | (((uint32_t)(base >> 2) + k) & 1), code >> 6, bits << (code & 63));
    }
    return any_of(&outside) == 0;
}

void svo_block_remember(const svo_block *b, const svo_raster_row *row, svo_block_visits *v)
{
    const uint64_t *bits_of = plane_bits[row->u][row->w];
    const uint32_t *along = b->spread[row->w];
    for (int32_t u = row->u0 & ~3, start = row->u0; u <= row->u1; start = u += 4) {
        const uint32_t column = svo_block_column(b, row, u);
        /* around the first column, the others are not far away */
        const int32_t at = row->lo[start] < 16 ? 16 : row->lo[start] > 112 ? 112 : row->lo[start], base = (at & ~3) - 16;
        if (remember_columns(row, u, column, bits_of, along, base, v)) continue;
        for (int32_t other = (base & 31) - 32; other < SVO_RASTER_SIZE; other += 32)
            if (other != base) remember_columns(row, u, column, bits_of, along, other, v);
    }
}

void svo_block_meet(svo_block *b, const svo_block_visit *v, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t brick = v[i].brick;
        const uint64_t bits = v[i].bits, old = b->bricks[brick];
        b->used[brick >> 6] |= (uint64_t)1 << (brick & 63);
        b->bricks[brick] = old | bits;
        b->complex[brick] |= old & bits;
    }
}

/* Bit i of the result: byte i of x is not 0. */
static inline uint32_t bytes_used(uint64_t x)
{
    x |= x >> 4;
    x |= x >> 2;
    x |= x >> 1;
    return (uint32_t)((x & 0x0101010101010101u) * 0x0102040810204080u >> 56);
}

bool svo_block_emit(svo_block *b, svo_buffer *masks, svo_block_counts *counts)
{
    memset(counts, 0, sizeof *counts);
    uint64_t coarse[8] = {0}; /* bit i of word j: word 64 j + i of `used` is not 0 */
    uint32_t root = 0;
    uint64_t bricks = 0;
    for (uint32_t i = 0; i < 512; i++) {
        if (b->used[i] == 0) continue;
        coarse[i >> 6] |= (uint64_t)1 << (i & 63);
        root |= 1u << (i >> 6);
        bricks += (uint64_t)__builtin_popcountll(b->used[i]);
    }
    if (root == 0) return true;
    if (!svo_buffer_reserve(masks, 1 + 8 * 9 + 512 * 9 + bricks * 9)) return false;
    uint8_t *out = masks->data + masks->size;
    uint32_t voxels = 0, complex = 0;
    counts->nodes[0] = 1;
    *out++ = (uint8_t)root;
    for (; root != 0; root &= root - 1) {
        uint32_t a = (uint32_t)__builtin_ctz(root);
        uint32_t octants = bytes_used(coarse[a]);
        counts->nodes[1]++;
        *out++ = (uint8_t)octants;
        for (; octants != 0; octants &= octants - 1) {
            uint32_t o = (uint32_t)__builtin_ctz(octants), inner = (uint32_t)(coarse[a] >> 8 * o) & 255;
            counts->nodes[2]++;
            *out++ = (uint8_t)inner;
            for (; inner != 0; inner &= inner - 1) {
                uint32_t word = a * 64 + o * 8 + (uint32_t)__builtin_ctz(inner);
                uint32_t octants2 = bytes_used(b->used[word]);
                counts->nodes[3]++;
                *out++ = (uint8_t)octants2;
                for (; octants2 != 0; octants2 &= octants2 - 1) {
                    uint32_t p = (uint32_t)__builtin_ctz(octants2), inner2 = (uint32_t)(b->used[word] >> 8 * p) & 255;
                    counts->nodes[4]++;
                    *out++ = (uint8_t)inner2;
                    for (; inner2 != 0; inner2 &= inner2 - 1) {
                        uint32_t index = word * 64 + p * 8 + (uint32_t)__builtin_ctz(inner2);
                        uint64_t brick = b->bricks[index];
                        uint32_t octants3 = bytes_used(brick);
                        b->rank[index] = voxels;
                        b->complex_rank[index] = complex;
                        voxels += (uint32_t)__builtin_popcountll(brick);
                        complex += (uint32_t)__builtin_popcountll(b->complex[index]);
                        counts->nodes[5]++;
                        counts->nodes[6] += (uint64_t)__builtin_popcount(octants3);
                        *out++ = (uint8_t)octants3;
                        for (; octants3 != 0; octants3 &= octants3 - 1)
                            *out++ = (uint8_t)(brick >> 8 * (uint32_t)__builtin_ctz(octants3));
                    }
                }
            }
        }
    }
    counts->nodes[7] = voxels;
    counts->complex = complex;
    masks->size = (size_t)(out - masks->data);
    return true;
}
