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
