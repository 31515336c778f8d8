/* 63-bit Morton codes. Bit 3i of the code is bit i of x, 3i+1 of y, 3i+2 of z, so the octant of a child is
 * x + 2y + 4z of the half-space bits and depth-first order of an octree is ascending code order. */
#ifndef SVO_MORTON_H
#define SVO_MORTON_H

#include <stdint.h>

/* Spread the low 21 bits of v to every third bit. */
static inline uint64_t svo_morton_spread(uint64_t v)
{
    v &= 0x1fffffu;
    v = (v | v << 32) & 0x001f00000000ffffu;
    v = (v | v << 16) & 0x001f0000ff0000ffu;
    v = (v | v << 8) & 0x100f00f00f00f00fu;
    v = (v | v << 4) & 0x10c30c30c30c30c3u;
    v = (v | v << 2) & 0x1249249249249249u;
    return v;
}

static inline uint32_t svo_morton_compact(uint64_t v)
{
    v &= 0x1249249249249249u;
    v = (v | v >> 2) & 0x10c30c30c30c30c3u;
    v = (v | v >> 4) & 0x100f00f00f00f00fu;
    v = (v | v >> 8) & 0x001f0000ff0000ffu;
    v = (v | v >> 16) & 0x001f00000000ffffu;
    v = (v | v >> 32) & 0x1fffffu;
    return (uint32_t)v;
}

/* x, y, z in [0, 2^21). */
static inline uint64_t svo_morton_encode(uint32_t x, uint32_t y, uint32_t z)
{
    return svo_morton_spread(x) | svo_morton_spread(y) << 1 | svo_morton_spread(z) << 2;
}

static inline void svo_morton_decode(uint64_t code, uint32_t *x, uint32_t *y, uint32_t *z)
{
    *x = svo_morton_compact(code);
    *y = svo_morton_compact(code >> 1);
    *z = svo_morton_compact(code >> 2);
}

#endif
