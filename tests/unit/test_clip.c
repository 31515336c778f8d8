/* Pieces of triangles in voxels: sums over lines against polygons that are cut plane by plane in double precision. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "polygon_moments.h"
#include "svo_shade.h"
#include "svoi_clip.h"
#include "test.h"

TEST(pieces_agree_with_polygons)
{
    uint64_t seed = 3, pieces = 0, bad = 0;
    double error = 0;
    for (int round = 0; round < 60000; round++) {
        const double size = round % 3 == 0 ? 1 : round % 3 == 1 ? 6 : 60;
        double v[3][3];
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < 3; k++) {
                v[c][k] = 60.00007 + size * (test_random_unit(&seed) - 0.5);
                if (round % 5 == 0 && k == round / 5 % 3) v[c][k] = 60.00007 + 0.01 * size * (test_random_unit(&seed) - 0.5); /* nearly flat */
                if (round % 7 == 0 && c != 0 && k == round % 3) v[c][k] = v[0][k];                                          /* parallel to an axis plane */
                if (round % 11 == 0) v[c][k] = floor(v[c][k]) + (k == 0 ? 1e-4 : k == 1 ? 1.37e-4 : 0.73e-4);                                                      /* beside the grid's corners */
            }
        svoi_clipper clipper;
        if (!svoi_clipper_make(&clipper, (const double(*)[3])v)) continue;
        svoi_clip_batch batch;
        int cell[13][3];
        const uint32_t i = (clipper.axis + 1) % 3, j = (clipper.axis + 2) % 3;
        for (int n = 0; n < 13; n++) {
            double s = test_random_unit(&seed), t = test_random_unit(&seed);
            if (s + t > 1) s = 1 - s, t = 1 - t;
            for (int k = 0; k < 3; k++) cell[n][k] = (int)floor(v[0][k] + s * (v[1][k] - v[0][k]) + t * (v[2][k] - v[0][k])) + (n == 0 && k == 0);
            batch.x[n] = (float)cell[n][i], batch.y[n] = (float)cell[n][j], batch.z[n] = (float)cell[n][clipper.axis];
        }
        svoi_clip(&clipper, &batch, 13, true);
        for (int n = 0; n < 13; n++) {
            svo_polygon a = {.count = 3}, b;
            memcpy(a.at, v, sizeof v);
            svo_polygon_slab(&a, 0, cell[n][0], &b);
            svo_polygon_slab(&b, 1, cell[n][1], &a);
            svo_polygon_slab(&a, 2, cell[n][2], &b);
            exact e = of_polygon(&b, i, j);
            double off = fabs(e.area * (double)clipper.per_area - (double)batch.area[n]);
            CHECK(batch.area[n] >= 0 && batch.area[n] < 1.8f);
            pieces++;
            error += off;
            if (e.area > 0.01) {
                off = fmax(off, 0.1 * fmax(fabs(e.x - (double)batch.cx[n]), fabs(e.y - (double)batch.cy[n])));
                off = fmax(off, 0.1 * fmax(fabs(e.xx - (double)batch.xx[n]), fmax(fabs(e.xy - (double)batch.xy[n]), fabs(e.yy - (double)batch.yy[n]))));
            }
            bad += off > 2e-3;
        }
    }
    printf("        %llu pieces: mean error of area %.2g, %llu worse than 0.002\n", (unsigned long long)pieces, error / (double)pieces, (unsigned long long)bad);
    CHECK(error / (double)pieces < 2e-5);
    CHECK(bad * 10000 < pieces); /* slivers whose edges are parallel to single precision */
}

TEST(results_do_not_depend_on_the_batch)
{
    const double v[3][3] = {{1.1, 2.2, 3.3}, {40.7, 5.1, 17.9}, {9.3, 50.2, 11.4}};
    svoi_clipper clipper;
    CHECK(svoi_clipper_make(&clipper, v));
    svoi_clip_batch all, one;
    for (int n = 0; n < SVOI_CLIP_BATCH; n++) all.x[n] = (float)(3 + n % 8), all.y[n] = (float)(5 + n / 8), all.z[n] = (float)(5 + n % 3);
    svoi_clip(&clipper, &all, SVOI_CLIP_BATCH, true);
    for (int n = 0; n < SVOI_CLIP_BATCH; n++) {
        one.x[0] = all.x[n], one.y[0] = all.y[n], one.z[0] = all.z[n];
        svoi_clip(&clipper, &one, 1, n % 2);
        CHECK(one.area[0] == all.area[n] && one.cx[0] == all.cx[n] && one.cy[0] == all.cy[n]);
        if (n % 2) CHECK(one.xx[0] == all.xx[n] && one.xy[0] == all.xy[n] && one.yy[0] == all.yy[n]);
    }
}

static bool same(const float *a, const float *b, uint32_t count) { return memcmp(a, b, count * sizeof *a) == 0; }

TEST(results_do_not_depend_on_the_processor)
{
    uint64_t seed = 11;
    if (!svoi_clip_has_wide()) {
        printf("        skipped: the processor has one kernel only\n");
        return;
    }
    for (int round = 0; round < 3000; round++) {
        double v[3][3];
        const double extent = round % 3 == 0 ? 2 : round % 3 == 1 ? 20 : 120;
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < 3; k++) v[c][k] = test_random_unit(&seed) * extent;
        if (round % 5 == 0) v[1][2] = v[0][2]; /* an edge on a level */
        if (round % 7 == 0) v[0][2] = v[1][2] = v[2][2] = 0.3;
        svoi_clipper clipper;
        if (!svoi_clipper_make(&clipper, (const double(*)[3])v)) continue;
        const uint32_t count = 1 + (uint32_t)round % SVOI_CLIP_BATCH;
        svoi_clip_batch narrow, wide;
        for (uint32_t n = 0; n < count; n++) {
            narrow.x[n] = floorf((float)(test_random_unit(&seed) * extent));
            narrow.y[n] = floorf((float)(test_random_unit(&seed) * extent));
            narrow.z[n] = floorf(clipper.gradient[0] * narrow.x[n] + clipper.gradient[1] * narrow.y[n] + clipper.height);
        }
        wide = narrow;
        const svoi_clip_parts want = (svoi_clip_parts)(round % 3);
        svoi_clip_narrow(&clipper, &narrow, count, want);
        svoi_clip_wide(&clipper, &wide, count, want);
        CHECK(same(narrow.area, wide.area, count));
        if (want != SVOI_CLIP_AREAS) CHECK(same(narrow.cx, wide.cx, count) && same(narrow.cy, wide.cy, count));
        if (want == SVOI_CLIP_MOMENTS) CHECK(same(narrow.xx, wide.xx, count) && same(narrow.xy, wide.xy, count) && same(narrow.yy, wide.yy, count));
    }
}
