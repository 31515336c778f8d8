/* Voxels that no edge of a large triangle reaches, and rows put together to bricks: what tables and bits say against polygons and marks. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "polygon_moments.h"
#include "svo_block.h"
#include "svo_morton.h"
#include "svoi_lanes.h"
#include "svoi_shade.h"
#include "test.h"

/* A triangle with these corners, of a mesh without anything else, as svo_facet_make leaves it. */
static bool make_facet(const double v[3][3], svo_facet *t)
{
    memset(t, 0, sizeof *t);
    memcpy(t->corner, v, sizeof t->corner);
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        t->normal[k] = (v[1][i] - v[0][i]) * (v[2][j] - v[0][j]) - (v[1][j] - v[0][j]) * (v[2][i] - v[0][i]);
    }
    t->clips = svoi_clipper_make(&t->clipper, v);
    t->axis = t->clipper.axis;
    t->material = SVO_NONE;
    return t->clips;
}

static void slice(const double v[3][3], const int cell[3], svo_polygon *out)
{
    svo_polygon a = {.count = 3}, b;
    memcpy(a.at, v, sizeof a.at[0] * 3);
    svo_polygon_slab(&a, 0, cell[0], &b);
    svo_polygon_slab(&b, 1, cell[1], &a);
    svo_polygon_slab(&a, 2, cell[2], out);
}

/* Planes through a block: tilted anyhow, nearly parallel to an axis plane, at 45 degrees, through corners of voxels; corners nearby and far away. */
static void choose_triangle(uint64_t *seed, int round, double v[3][3])
{
    double n[3], centre[3], far = round % 4 == 0 ? 40 : round % 4 == 1 ? 120 : round % 4 == 2 ? 3000 : 60000;
    const int w = round % 3, i = (w + 1) % 3, j = (w + 2) % 3;
    for (int k = 0; k < 3; k++) n[k] = 2 * test_random_unit(seed) - 1, centre[k] = 40.00013 + 40 * test_random_unit(seed);
    if (round % 5 == 0) n[i] *= 1e-4, n[j] *= 1e-3, n[w] = 1;
    if (round % 5 == 1) n[i] = n[w], n[j] *= 0.01;
    if (round % 5 == 2) n[i] = n[j] = n[w] = 1;
    if (round % 7 == 0)
        for (int k = 0; k < 3; k++) centre[k] = floor(centre[k]) + (k == 0 ? 1e-4 : k == 1 ? 1.37e-4 : 0.73e-4);
    /* the axis must be the one of the largest component, to reach far in the other two */
    const int axis = fabs(n[1]) > fabs(n[0]) ? (fabs(n[2]) > fabs(n[1]) ? 2 : 1) : fabs(n[2]) > fabs(n[0]) ? 2 : 0;
    const int x = (axis + 1) % 3, y = (axis + 2) % 3;
    const double turn = 6.28 * test_random_unit(seed);
    for (int c = 0; c < 3; c++) {
        const double dx = far * cos(turn + 2.0943951 * c), dy = far * sin(turn + 2.0943951 * c);
        v[c][x] = centre[x] + dx;
        v[c][y] = centre[y] + dy;
        v[c][axis] = centre[axis] - (n[x] * dx + n[y] * dy) / n[axis];
    }
}

TEST(centroids_of_inner_voxels_are_those_of_polygons)
{
    svo_mesh mesh = {0};
    svo_placement placement = {.mesh = &mesh};
    shade_material material = {.m = svo_material_default()};
    svo_shader shader = {.placement = &placement, .materials = &material};
    svo_shade_layout *none = &shader.layout;
    none->color = none->normal = none->emissive = none->metallic = none->roughness = none->material = none->coverage = SVO_MAX_CHANNELS;
    svoi_lanes *l = calloc(1, sizeof *l);
    svoi_inner *inner = calloc(1, sizeof *inner);
    uint64_t seed = 11, voxels = 0, tables = 0;
    double worst = 0, sum = 0, moment = 0;
    for (int round = 0; round < 4000; round++) {
        double v[3][3];
        svo_facet t;
        choose_triangle(&seed, round, v);
        if (!make_facet((const double(*)[3])v, &t)) continue;
        if (!svoi_inner_make(&shader, &t, inner)) continue;
        tables++;
        const uint32_t x = (t.axis + 1) % 3, y = (t.axis + 2) % 3, w = t.axis;
        /* cells under random places of the plane, a little above or below */
        int cell[SVOI_LANES][3];
        l->count = 0;
        for (int n = 0; n < SVOI_LANES; n++) {
            int *c = cell[l->count];
            c[x] = (int)(test_random_unit(&seed) * 128), c[y] = (int)(test_random_unit(&seed) * 128);
            const double px = c[x] + test_random_unit(&seed), py = c[y] + test_random_unit(&seed);
            const double height = v[0][w] - (t.normal[x] * (px - v[0][x]) + t.normal[y] * (py - v[0][y])) / t.normal[w];
            if (!(height >= 0 && height < 128)) continue;
            c[w] = (int)height;
            l->code[l->count++] = (uint32_t)svo_morton_encode((uint32_t)c[0], (uint32_t)c[1], (uint32_t)c[2]);
        }
        if (l->count == 0) continue;
        uint8_t is[SVOI_LANES];
        svoi_inner_find(&t, l, is);
        svoi_inner_values(&shader, &t, inner, l);
        for (uint32_t n = 0; n < l->count; n++) {
            if (!is[n]) continue;
            /* the whole column is inside */
            for (int corner = 0; corner < 4; corner++)
                for (int e = 0; e < 3; e++) {
                    const double *a = v[e], *b = v[(e + 1) % 3], side = (b[x] - a[x]) * (cell[n][y] + corner / 2 - a[y]) - (b[y] - a[y]) * (cell[n][x] + corner % 2 - a[x]);
                    CHECK_MSG(side * t.normal[w] > 0, "an edge reaches voxel %d %d %d of round %d", cell[n][0], cell[n][1], cell[n][2], round);
                }
            svo_polygon p;
            slice((const double(*)[3])v, cell[n], &p);
            const exact e = of_polygon(&p, x, y);
            if (e.area < 0.002) continue; /* hardly anything is left; what there is lies somewhere in the voxel */
            if (inner->steps == 1 && e.area < 0.9999) continue; /* a plane as good as level, in the side of a voxel: taken as whole */
            const double cx = (double)inner->base[0] + (double)l->offset_x[n], cy = (double)inner->base[1] + (double)l->offset_y[n], off = hypot(cx - e.x, cy - e.y);
            voxels++;
            sum += off;
            worst = fmax(worst, off);
            CHECK_MSG(off * fmin(1, 10 * e.area) < 0.03, "round %d: centroid %.4f %.4f instead of %.4f %.4f, area %g", round, cx, cy, e.x, e.y, e.area);
            /* covariances are those of the nearest row, half a step away at most; where little is left that can be much */
            if (e.area < 0.15) continue;
            const uint32_t k = l->step[n];
            const double apart = fmax(fabs((double)inner->xx[k] - e.xx), fmax(fabs((double)inner->xy[k] - e.xy), fabs((double)inner->yy[k] - e.yy)));
            moment = fmax(moment, apart);
            CHECK_MSG(apart < 0.03, "round %d: covariance off by %g, area %g", round, apart, e.area);
        }
    }
    printf("%llu tables, %llu inner voxels: centroids off by %.5f in the mean, %.4f at most; covariances by %.4f at most\n", (unsigned long long)tables, (unsigned long long)voxels,
           sum / (double)voxels, worst, moment);
    CHECK(tables > 2000 && voxels > 20000);
    CHECK(sum / (double)voxels < 0.001);
    free(l);
    free(inner);
}

TEST(a_brick_is_inner_only_where_all_its_voxels_are)
{
    uint64_t seed = 5, all = 0, some = 0;
    svoi_lanes *l = calloc(1, sizeof *l);
    for (int round = 0; round < 4000; round++) {
        double v[3][3];
        float reach[3];
        svo_facet t;
        choose_triangle(&seed, round, v);
        if (!make_facet((const double(*)[3])v, &t)) continue;
        svoi_inner_bricks(&t, reach);
        for (int n = 0; n < 20; n++) {
            const uint32_t brick = (uint32_t)(test_random_unit(&seed) * SVO_BLOCK_BRICKS);
            uint8_t is[SVOI_LANES];
            l->count = 64;
            for (uint32_t i = 0; i < 64; i++) l->code[i] = brick << 6 | i;
            svoi_inner_find(&t, l, is);
            uint32_t count = 0;
            for (uint32_t i = 0; i < 64; i++) count += is[i];
            if (svoi_inner_brick(&t, reach, brick)) {
                CHECK_MSG(count == 64, "round %d, brick %u: %u voxels are inner", round, brick, count);
                all++;
            } else {
                some += count != 64;
            }
        }
    }
    CHECK(all > 1000 && some > 1000);
    free(l);
}

/* Random rows of a plane and of nonsense: marks by bricks are those of voxel by voxel, and visits hold each voxel once. */
TEST(rows_by_bricks_mark_what_rows_mark)
{
    svo_block *a = malloc(sizeof *a), *b = malloc(sizeof *b);
    svo_block_visit *visits = malloc(200 * SVO_BLOCK_ROW_VISITS * sizeof *visits);
    svo_block_visits list = {.at = visits};
    uint64_t seed = 23, voxels = 0, used = 0;
    svo_block_init(a);
    svo_block_init(b);
    for (int round = 0; round < 600; round++) {
        const int order = round % 6;
        svo_raster_row row = {.u = (uint32_t)order % 3, .v = (uint32_t)(order % 3 + 1 + order / 3) % 3};
        row.w = 3 - row.u - row.v;
        int32_t lo[SVO_RASTER_SIZE], hi[SVO_RASTER_SIZE];
        for (int i = 0; i < SVO_RASTER_SIZE; i++) lo[i] = INT32_MAX / 4 * (i % 2 ? 1 : -1), hi[i] = -lo[i]; /* outside of the row: nonsense */
        row.lo = lo, row.hi = hi;
        const double slope = round % 4 == 0 ? 0 : round % 4 == 1 ? 0.4 : round % 4 == 2 ? 1 : 9, across = test_random_unit(&seed) - 0.5, start = 128 * test_random_unit(&seed);
        list.first = list.count = round % 3 == 0 ? 0 : list.count < 100 ? list.count : 0;
        const uint32_t first = list.count;
        const int from = (int)(test_random_unit(&seed) * 120), rows = 1 + (int)(test_random_unit(&seed) * 20);
        for (int at = from; at < from + rows && at < SVO_RASTER_SIZE; at++) {
            row.at_v = at;
            row.u0 = (int32_t)(test_random_unit(&seed) * 64);
            row.u1 = row.u0 + (int32_t)(test_random_unit(&seed) * (round % 2 ? 64 : 6));
            for (int u = row.u0; u <= row.u1; u++) {
                const double w = start + slope * (u - 64) + across * (at - from);
                lo[u] = (int32_t)floor(w), hi[u] = lo[u] + (int32_t)(test_random_unit(&seed) * (slope > 1 ? 20 : 2.5));
                if (lo[u] < 0) lo[u] = 0;
                if (hi[u] > 127) hi[u] = 127;
                if (test_random_unit(&seed) < 0.05) lo[u] = 128, hi[u] = -1; /* empty */
                for (int k = lo[u]; k <= hi[u]; k++) voxels++;
            }
            svo_block_mark_flat(a, &row);
            svo_block_remember(b, &row, &list);
            for (int i = row.u0; i <= row.u1; i++) lo[i] = INT32_MAX / 4, hi[i] = -lo[i];
        }
        uint64_t bits = 0;
        for (uint32_t i = first; i < list.count; i++) bits += (uint64_t)__builtin_popcountll(visits[i].bits);
        used += bits;
        CHECK_U64(used, voxels);
        svo_block_meet(b, visits + first, list.count - first);
        if (round % 20 != 19) continue;
        CHECK(memcmp(a->bricks, b->bricks, sizeof a->bricks) == 0);
        CHECK(memcmp(a->complex, b->complex, sizeof a->complex) == 0);
        CHECK(memcmp(a->used, b->used, sizeof a->used) == 0);
        svo_block_clear(a);
        svo_block_clear(b);
    }
    CHECK(voxels > 100000);
    free(a);
    free(b);
    free(visits);
}
