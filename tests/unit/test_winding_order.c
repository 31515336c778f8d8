/* Winding numbers to the last bit, and the nearest point, whatever the order of triangles and whichever corner comes first. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_bin.h"
#include "svo_winding.h"
#include "test.h"
#include "voxel_set.h"

enum { POINTS = 2000, DEPTH = 8 };

typedef struct answer {
    double margin, at[3];
    bool inside;
} answer;

/* A point of a ball's surface on a grid of angles: neighbours share their corners. */
static void corner(uint32_t i, uint32_t j, uint32_t rings, double out[3])
{
    const double t = 3.14159265358979 * i / rings, p = 2 * 3.14159265358979 * (j % rings) / rings;
    out[0] = 1.3 * sin(t) * cos(p), out[1] = 0.8 * sin(t) * sin(p) + 0.2 * cos(t), out[2] = cos(t);
}

static uint64_t torn_ball(double *out, uint64_t *seed)
{
    const uint32_t rings = 20;
    uint64_t count = 0;
    for (uint32_t i = 0; i < rings; i++)
        for (uint32_t j = 0; j < rings; j++)
            for (uint32_t k = 0; k < 2; k++) {
                if (test_random_unit(seed) < 0.3) continue;
                double *t = out + 9 * count++;
                corner(i, j, rings, t);
                corner(i + 1, j + k, rings, t + 3);
                corner(i + 1 - k, j + 1, rings, t + 6);
            }
    return count;
}

static void ask(const double *positions, uint64_t count, const svo_grid *grid, answer *out)
{
    svo_error err;
    loose_mesh m;
    svo_placement placement;
    svo_winding *w;
    svo_winding_report report;

    loose_make(&m, positions, count);
    CHECK_OK(svo_placement_create(&m.mesh, NULL, &placement, &err));
    CHECK_OK(svo_winding_create(&placement, grid, 1, NULL, NULL, &w, &report, &err));
    CHECK(report.open > count / 2); /* at the poles triangles are lines */
    uint64_t seed = 9;
    for (uint32_t i = 0; i < POINTS; i++) {
        int32_t p[3];
        for (int k = 0; k < 3; k++) p[k] = 2 * (int32_t)(test_random(&seed) % (1u << (DEPTH + 7)));
        out[i].inside = svo_winding_inside(w, p, &out[i].margin);
        svo_winding_hit hit = {.triangle = UINT32_MAX};
        double b[3];
        CHECK(svo_winding_nearest(w, p, &hit, b));
        for (int k = 0; k < 3; k++) { /* of the mesh as it is in the placement: so the corners must be those that the weights mean */
            out[i].at[k] = 0;
            for (int c = 0; c < 3; c++) out[i].at[k] += b[c] * positions[9 * (uint64_t)hit.triangle + 3 * (uint64_t)c + (uint64_t)k];
        }
    }
    svo_winding_free(w);
    svo_placement_free(&placement);
    loose_free(&m);

}

TEST(answers_do_not_depend_on_the_order)
{
    static double first[9 * 1000], now[9 * 1000];
    static answer expected[POINTS], got[POINTS];
    uint64_t seed = 3;
    const svo_grid grid = {.origin = {-1.5, -1.5, -1.5}, .size = 3.0 / (1 << DEPTH), .depth = DEPTH};
    const uint64_t count = torn_ball(first, &seed);
    ask(first, count, &grid, expected);
    for (int turn = 0; turn < 4; turn++) {
        for (uint64_t i = 0; i < count; i++) {
            const uint64_t from = turn < 2 ? i : count - 1 - i, by = turn == 0 ? 1 : test_random(&seed) % 3;
            for (uint64_t c = 0; c < 3; c++) memcpy(now + 9 * i + 3 * c, first + 9 * from + 3 * ((c + by) % 3), 24);
        }
        ask(now, count, &grid, got);
        for (uint32_t i = 0; i < POINTS; i++) {
            CHECK(got[i].inside == expected[i].inside);
            CHECK_MSG(got[i].margin == expected[i].margin, "point %u: %.17g instead of %.17g", i, got[i].margin, expected[i].margin);
            for (int k = 0; k < 3; k++) CHECK(fabs(got[i].at[k] - expected[i].at[k]) < 1e-9);
        }
    }
}
