/* Exact triangle against voxel grid: which voxels of a block of at most 128^3 does a triangle on the lattice meet?
 *
 * Coordinates are integers in units of 1/256 voxel; vertices are odd, so that none lies on a voxel face or on a centre
 * plane. The decision is the separating axis test of a closed triangle against a closed box, split into intervals:
 * with W the dominant axis of the normal and U, V the others, voxel (u, v, w) is met if and only if
 *   u lies in an interval that depends on v   (projection along W),
 *   w lies in an interval that depends on v   (projection along U),
 *   w lies in an interval that depends on u   (projection along V),
 *   w lies in an interval that depends on u,v (plane of the triangle).
 * The first three are computed once a row, so a column costs two roundings. All of them are integer divisions; floating
 * point gives a first guess that is proved or corrected in integers. Segments and points (zero normal) need no case
 * of their own: their projections bound them from both sides. */
#ifndef SVO_RASTER_H
#define SVO_RASTER_H

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_RASTER_SIZE 128       /* voxels an axis of a block */
#define SVO_RASTER_UNIT 256       /* lattice units a voxel */

/* The part [lo, hi] (lattice units, 0..256 an axis) of each voxel that has to be met. The whole cube gives the
 * conservative set; the segment through the centre along each axis gives the three parts of the thin set. */
typedef struct svo_raster_target { int32_t lo[3], hi[3]; } svo_raster_target;
svo_raster_target svo_raster_cube(void);
svo_raster_target svo_raster_centre_line(uint32_t axis);

/* One row of columns: axes u, v, w are a permutation of 0, 1, 2; for every column at in [u0, u1] the voxels lo[at] .. hi[at]
 * along w are met (none when lo > hi). */
typedef struct svo_raster_row {
    uint32_t u, v, w;
    int32_t at_v, u0, u1;
    const int32_t *lo, *hi; /* indexed by u, 0..127 */
} svo_raster_row;
typedef void (*svo_raster_row_fn)(void *user, const svo_raster_row *row);

/* Calls fn for the rows of voxels with box_lo <= (x,y,z) <= box_hi (0..127) that the triangle q meets. q is relative to
 * the block's corner: q[corner][axis], magnitude below 2^30, differences below 2^29. Reentrant, no allocation. */
void svo_raster_scan(const int32_t q[3][3], const svo_raster_target *target, const int32_t box_lo[3], const int32_t box_hi[3],
                     svo_raster_row_fn fn, void *user);

/* Does the closed triangle meet the closed box [lo, hi]? Any integers below 2^30 in magnitude. Exact. */
bool svo_raster_box(const int32_t q[3][3], const int32_t lo[3], const int32_t hi[3]);

/* Bounds of a triangle. */
static inline void svo_raster_bounds(const int32_t q[3][3], int32_t low[3], int32_t high[3])
{
    for (int k = 0; k < 3; k++) {
        int32_t a = q[0][k], b = q[1][k], c = q[2][k];
        low[k] = a < b ? a : b;
        high[k] = a < b ? b : a;
        if (c < low[k]) low[k] = c;
        if (c > high[k]) high[k] = c;
    }
}

/* Octants of a node (low corner `corner`, children of `size`, lattice units; planes between children are even, vertices odd, so they never
 * meet) that a triangle with these bounds may meet, as bits. Exact for triangles from a quarter of a child on: without that a large triangle
 * would reach 8^k nodes k levels down instead of about 4^k. Every walk that hands triangles to subtrees must use this one rule. */
static inline uint8_t svo_raster_octants(const int32_t q[3][3], const int32_t low[3], const int32_t high[3], const int32_t corner[3], int32_t size)
{
    /* by axis and half: the octants on that side */
    static const uint8_t below[3] = {0x55, 0x33, 0x0f}, above[3] = {0xaa, 0xcc, 0xf0};
    uint8_t mask = 0xff;
    int32_t extent = 0;
    for (int k = 0; k < 3; k++) {
        int32_t middle = corner[k] + size;
        if (low[k] > middle) mask &= above[k];
        if (high[k] < middle) mask &= below[k];
        if (high[k] - low[k] > extent) extent = high[k] - low[k];
    }
    if ((mask & (mask - 1)) == 0 || extent < size / 4) return mask;
    for (uint32_t i = 0; i < 8; i++) {
        if (!(mask >> i & 1)) continue;
        int32_t lo[3], hi[3];
        for (uint32_t k = 0; k < 3; k++) {
            lo[k] = corner[k] + (i >> k & 1 ? size : 0);
            hi[k] = lo[k] + size;
        }
        if (!svo_raster_box(q, lo, hi)) mask &= (uint8_t)~(1u << i);
    }
    return mask;
}

#ifdef __cplusplus
}
#endif
#endif
