#include "svo_distance.h"

#include <math.h>

#include "svo_morton.h"

static double dot3(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static double point_segment2(const double p[3], const double a[3], const double b[3])
{
    double d[3], e[3];
    for (int i = 0; i < 3; i++) d[i] = b[i] - a[i], e[i] = p[i] - a[i];
    double length = dot3(d, d), t = length > 0 ? dot3(d, e) / length : 0;
    t = t > 0 ? t < 1 ? t : 1 : 0;
    for (int i = 0; i < 3; i++) e[i] -= t * d[i];
    return dot3(e, e);
}

double svo_point_triangle(const double p[3], const double corner[3][3])
{
    double a[3], b[3], e[3], n[3];
    for (int i = 0; i < 3; i++) a[i] = corner[1][i] - corner[0][i], b[i] = corner[2][i] - corner[0][i], e[i] = p[i] - corner[0][i];
    for (int i = 0; i < 3; i++) n[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
    double nn = dot3(n, n);
    if (nn > 0) {
        /* inside the prism over the triangle: distance from the plane */
        double aa = dot3(a, a), ab = dot3(a, b), bb = dot3(b, b), ea = dot3(e, a), eb = dot3(e, b);
        double u = ea * bb - eb * ab, v = eb * aa - ea * ab, whole = aa * bb - ab * ab;
        if (u >= 0 && v >= 0 && u + v <= whole) return fabs(dot3(e, n)) / sqrt(nn);
    }
    double d = point_segment2(p, corner[0], corner[1]);
    d = fmin(d, point_segment2(p, corner[1], corner[2]));
    return sqrt(fmin(d, point_segment2(p, corner[2], corner[0])));
}

typedef struct measure {
    const svo_block *block;
    double corner[3][3];
    double nearest[4096]; /* of the cube's voxels, x + 16 y + 256 z */
} measure;

static void measure_row(void *user, const svo_raster_row *row)
{
    measure *m = user;
    for (int32_t u = row->u0; u <= row->u1; u++) {
        uint32_t column = svo_block_column(m->block, row, u);
        for (int32_t w = row->lo[u]; w <= row->hi[u]; w++) {
            uint32_t code = column | m->block->spread[row->w][w];
            if (!(m->block->bricks[code >> 6] >> (code & 63) & 1)) continue;
            int32_t cell[3];
            cell[row->u] = u, cell[row->v] = row->at_v, cell[row->w] = w;
            double centre[3] = {cell[0] + 0.5, cell[1] + 0.5, cell[2] + 0.5};
            double d = svo_point_triangle(centre, (const double(*)[3])m->corner);
            double *nearest = &m->nearest[(cell[0] & 15) | (cell[1] & 15) << 4 | (cell[2] & 15) << 8];
            if (d < *nearest) *nearest = d;
        }
    }
}

static void cube_distances(const svo_block *block, const svo_bins *bins, const svo_placement *placement, const svo_grid *grid,
                           const uint32_t *list, uint64_t count, const int32_t corner[3], int32_t block_size, uint32_t word, svo_distances *out)
{
    uint32_t x, y, z;
    svo_morton_decode(word, &x, &y, &z);
    const int32_t size = block_size < 16 ? block_size : 16;
    const int32_t lo[3] = {(int32_t)x * 16, (int32_t)y * 16, (int32_t)z * 16};
    const int32_t hi[3] = {lo[0] + size - 1, lo[1] + size - 1, lo[2] + size - 1};
    measure m = {.block = block};
    for (int i = 0; i < 4096; i++) m.nearest[i] = INFINITY;
    const svo_raster_target cube = svo_raster_cube();
    for (uint64_t i = 0; i < count; i++) {
        svo_record r;
        svo_bins_record(bins, list[i], &r);
        bool outside = false;
        for (int k = 0; k < 3; k++) {
            int32_t low = (corner[k] + lo[k]) * SVO_RASTER_UNIT, high = (corner[k] + hi[k] + 1) * SVO_RASTER_UNIT;
            outside |= r.q[0][k] < low && r.q[1][k] < low && r.q[2][k] < low;
            outside |= r.q[0][k] > high && r.q[1][k] > high && r.q[2][k] > high;
            for (int c = 0; c < 3; c++) r.q[c][k] -= corner[k] * SVO_RASTER_UNIT;
        }
        if (outside) continue;
        const svo_group *group = &placement->groups[r.group];
        svo_vec3 v[3];
        svo_placement_world(placement, group, list[i] - group->first, v);
        for (int c = 0; c < 3; c++) {
            const double p[3] = {v[c].x, v[c].y, v[c].z};
            for (int k = 0; k < 3; k++) m.corner[c][k] = (p[k] - grid->origin[k]) / grid->size - corner[k];
        }
        svo_raster_scan((const int32_t(*)[3])r.q, &cube, lo, hi, measure_row, &m);
    }
    for (int i = 0; i < 4096; i++) {
        if (m.nearest[i] == INFINITY) continue;
        out->count++;
        out->sum += m.nearest[i];
        if (m.nearest[i] > out->most) out->most = m.nearest[i];
    }
}

void svo_block_distances(const svo_block *block, const svo_bins *bins, const svo_placement *placement, const svo_grid *grid,
                         const uint32_t *list, uint64_t count, const int32_t corner[3], int32_t block_size, uint64_t choice,
                         uint32_t samples, svo_distances *out)
{
    *out = (svo_distances){0};
    uint16_t cubes[512];
    uint32_t cube_count = 0;
    for (uint32_t i = 0; i < 512; i++)
        if (block->used[i] != 0) cubes[cube_count++] = (uint16_t)i;
    if (samples > cube_count) samples = cube_count;
    for (uint32_t i = 0; i < samples; i++) { /* evenly spread, from a place that `choice` says */
        uint32_t at = (uint32_t)((choice % cube_count + (uint64_t)i * cube_count / samples) % cube_count);
        cube_distances(block, bins, placement, grid, list, count, corner, block_size, cubes[at], out);
    }
}
