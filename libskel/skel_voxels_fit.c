/* Where the surface passed that the cells were made of. A cell is occupied if the surface meets it: so near a plane with the unit normal n, at n.x = t, cells whose centre c has |n.c - t| up to
 * h = (|nx| + |ny| + |nz|) / 2 are occupied and the next ones are empty. Seen from outside, t is between the farthest occupied centre and the nearest empty one, less h. The corners of the grid, where
 * the boundary has its points, lie up to 1.7 cells away from that, always outside of it; points are moved there, as far as it is
 * less than half a cell on every axis. */
#include "skeli_voxels.h"

#include <math.h>

#define AGREES 0.5   /* least length of the mean normal of the cells at a point, and cosine of it and the side that faces out */
#define ASIDE 1.5    /* cells: how far from the line along the normal others are asked, */
#define ALONG 0.9    /* and how far along it: those that touch the point, but not another surface two cells away */
#define FARTHEST 0.49 /* cells that a point is moved at most on an axis: so no two come to be one, and the surface stays closed */

static inline bool bit(const bits *b, const uint64_t *set, int64_t x, int64_t y, int64_t z) { return set[((uint64_t)z * b->n + (uint64_t)y) * b->words + ((uint64_t)x >> 6)] >> (x & 63) & 1; }

static void fit(const bits *b, const float *sum, double p[3])
{
    double n[3], length = 0, out = 0, out2 = 0, sides = 0;
    for (int k = 0; k < 3; k++) {
        length += (double)sum[k] * sum[k];
        out += (double)sum[k] * sum[3 + k];
        out2 += (double)sum[3 + k] * sum[3 + k];
        sides += fabs((double)sum[3 + k]);
    }
    length = sqrt(length);
    /* NaN, at gaps between voxels that touch, is not more either */
    if (!(length > AGREES * sides) || !(out > AGREES * length * sqrt(out2))) return;
    double h = 0, low = -INFINITY, high = INFINITY; /* relative to p */
    for (int k = 0; k < 3; k++) {
        n[k] = sum[k] / length;
        h += fabs(n[k]) / 2;
    }
    const int64_t first[3] = {(int64_t)floor(p[0] + 0.5) - 2, (int64_t)floor(p[1] + 0.5) - 2, (int64_t)floor(p[2] + 0.5) - 2};
    for (int64_t z = first[2]; z < first[2] + 4; z++)
        for (int64_t y = first[1]; y < first[1] + 4; y++)
            for (int64_t x = first[0]; x < first[0] + 4; x++) {
                const double d[3] = {(double)x + 0.5 - p[0], (double)y + 0.5 - p[1], (double)z + 0.5 - p[2]};
                const double along = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
                if (d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - along * along > ASIDE * ASIDE) continue;
                const bool beyond = x < 0 || y < 0 || z < 0 || x >= b->n || y >= b->n || z >= b->n;
                if (!beyond && bit(b, b->occupied, x, y, z)) {
                    if (along <= ALONG && along > low) low = along;
                } else if (beyond || bit(b, b->outside, x, y, z)) {
                    if (along >= -ALONG && along < high) high = along;
                }
            }
    if (low == -INFINITY || high == INFINITY) return;
    double t = (low + high) / 2 - h;
    double most = 0;
    for (int k = 0; k < 3; k++) most = fmax(most, fabs(t * n[k]));
    if (most > FARTHEST) t *= FARTHEST / most;
    for (int k = 0; k < 3; k++) p[k] += t * n[k];
}

void skeli_voxels_fit(const bits *grid, boundary *b)
{
    for (uint64_t i = 0; i < b->points; i++) fit(grid, b->normal + 6 * i, b->position + 3 * i);
}
