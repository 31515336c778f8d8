/* Ball sums: FLANN and the grid against brute force, bit for bit, on the layouts that are hard for either. */
#include "skel_radius.h"

#include <stdlib.h>
#include <string.h>

#include "test.h"

enum { MAX_POINTS = 150000 };
static int32_t point[3 * MAX_POINTS];
static uint32_t weight[MAX_POINTS];
static uint8_t doublings[MAX_POINTS];
static skel_ball_sum slow[MAX_POINTS], got[MAX_POINTS];

static void brute(uint64_t n, double radius, bool doubled)
{
    float r = (float)radius;
    for (uint64_t i = 0; i < n; i++) {
        const float wider = doubled ? (float)(1 << doublings[i]) : 1, squared = r * r * wider * wider;
        skel_ball_sum s = {0};
        for (uint64_t j = 0; j < n; j++) {
            float d[3];
            for (uint64_t k = 0; k < 3; k++) d[k] = (float)point[3 * i + k] / SKEL_LATTICE - (float)point[3 * j + k] / SKEL_LATTICE;
            if (!((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2] < squared)) continue;
            s.x += (int64_t)weight[j] * point[3 * j];
            s.y += (int64_t)weight[j] * point[3 * j + 1];
            s.z += (int64_t)weight[j] * point[3 * j + 2];
            s.weight += weight[j];
        }
        slow[i] = s;
    }
}

static void compare_with(uint64_t n, double radius, bool doubled)
{
    svo_error err = {0};
    const uint8_t *wider = doubled ? doublings : NULL;
    brute(n, radius, doubled);
    for (uint32_t threads = 1; threads <= 7; threads += 3) {
        memset(got, 0xff, sizeof got);
        CHECK_OK(skel_radius_flann(point, weight, wider, n, radius, threads, got, &err));
        CHECK_MSG(memcmp(got, slow, n * sizeof *got) == 0, "FLANN differs: %llu points, radius %g, %u threads", (unsigned long long)n, radius, threads);
        memset(got, 0xff, sizeof got);
        CHECK_OK(skel_radius_grid(NULL, point, weight, wider, n, radius, threads, got, &err));
        CHECK_MSG(memcmp(got, slow, n * sizeof *got) == 0, "the grid differs: %llu points, radius %g, %u threads", (unsigned long long)n, radius, threads);
    }
}

static void compare(uint64_t n, double radius) { compare_with(n, radius, false); }

static int32_t coordinate(uint64_t *seed, int32_t range) { return (int32_t)((test_random_unit(seed) * 2 - 1) * range); }

TEST(volume)
{
    uint64_t seed = 1;
    for (uint64_t n = 1; n <= 4000; n = n * 3 + 1) {
        for (uint64_t i = 0; i < n; i++) {
            for (uint64_t k = 0; k < 3; k++) point[3 * i + k] = coordinate(&seed, SKEL_LATTICE - 1);
            weight[i] = 1 + (uint32_t)(test_random(&seed) % 5);
        }
        for (double radius = 0.003; radius < 4 && !test_failed(); radius *= 3) compare(n, radius);
    }
}

/* Balls of different widths at once: no point sees another's. */
TEST(doubled_radii)
{
    uint64_t seed = 9;
    for (uint64_t n = 100; n <= 3000 && !test_failed(); n = n * 3 + 1)
        for (uint32_t most = 0; most <= 3; most++) {
            for (uint64_t i = 0; i < n; i++) {
                for (uint64_t k = 0; k < 3; k++) point[3 * i + k] = coordinate(&seed, SKEL_LATTICE - 1);
                weight[i] = 1 + (uint32_t)(test_random(&seed) % 5);
                doublings[i] = (uint8_t)(test_random(&seed) % (most + 1));
            }
            for (double radius = 0.01; radius < 1 && !test_failed(); radius *= 4) compare_with(n, radius, true);
        }
}

TEST(line_and_plane)
{
    uint64_t seed = 2, n = 3000;
    for (int flat = 1; flat <= 2; flat++) {
        for (uint64_t i = 0; i < n; i++) {
            for (uint64_t k = 0; k < 3; k++) point[3 * i + k] = (int)k < flat ? coordinate(&seed, 1000000) : -77;
            weight[i] = 1;
        }
        compare(n, 0.01);
        if (test_failed()) return;
        compare(n, 0.0002);
    }
}

/* Distances that are exactly the radius, and lattice points a hair inside or outside: the rounding of tree bounds must not show. */
TEST(exactly_at_the_radius)
{
    uint64_t n = 0;
    int32_t step = 4096; /* 2^-12 */
    for (int z = 0; z < 14; z++)
        for (int y = 0; y < 14; y++)
            for (int x = 0; x < 14; x++) {
                int32_t p[3] = {x * step - 8000000, y * step + 5000000, z * step - 123};
                memcpy(point + 3 * n, p, sizeof p);
                weight[n++] = 1;
            }
    compare(n, 2.0 / 4096);
    if (test_failed()) return;
    compare(n, 3.0 / 4096 * 1.0000001);
    if (test_failed()) return;
    compare(n, 5.0 / 4096 * 0.9999999);
}

TEST(coincident)
{
    uint64_t n = 3000;
    for (uint64_t i = 0; i < n; i++) {
        int32_t p[3] = {(int32_t)(i % 3) * 500000, -9, 9};
        memcpy(point + 3 * i, p, sizeof p);
        weight[i] = (uint32_t)(i + 1);
    }
    compare(n, 0.01);
    if (test_failed()) return;
    compare(n, 1);
}

TEST(clusters_far_apart)
{
    uint64_t seed = 3, n = 4000;
    for (uint64_t i = 0; i < n; i++) {
        for (uint64_t k = 0; k < 3; k++) point[3 * i + k] = (i % 8 >> k & 1 ? 1 : -1) * (SKEL_LATTICE - 40000) + coordinate(&seed, 30000);
        weight[i] = 1 << 20;
    }
    compare(n, 0.0009);
    if (test_failed()) return;
    compare(n, 0.0000001);
}

/* Merge some near points: labels as welding gives them, the weighted mean as place. Gives the number of groups. */
static uint64_t weld(uint64_t n, uint64_t *seed, uint32_t *label)
{
    static int64_t sum[4 * MAX_POINTS];
    uint64_t groups = 0;
    memset(sum, 0, sizeof sum);
    for (uint64_t i = 0; i < n; i++) {
        label[i] = i > 0 && test_random(seed) % 8 == 0 ? label[test_random(seed) % 16 == 0 ? test_random(seed) % i : i - 1] : (uint32_t)groups++;
        int64_t *s = sum + 4 * (uint64_t)label[i];
        for (uint64_t k = 0; k < 3; k++) s[k] += (int64_t)weight[i] * point[3 * i + k];
        s[3] += weight[i];
    }
    for (uint64_t g = 0; g < groups; g++) {
        for (uint64_t k = 0; k < 3; k++) point[3 * g + k] = (int32_t)(sum[4 * g + k] / sum[4 * g + 3]);
        weight[g] = (uint32_t)sum[4 * g + 3];
    }
    return groups;
}

/* Points that creep, jump, and are welded, on one search from the first call to the last: as if each call were alone. `pace` in radii a call. */
static void moving(double pace, uint64_t jumps, bool welds, bool doubled, uint32_t threads)
{
    static uint32_t label[MAX_POINTS];
    uint64_t seed = 5 + threads + jumps, n = 1100;
    const double radius = 0.05;
    const int32_t step = (int32_t)(pace * radius * SKEL_LATTICE) + 1;
    svo_error err = {0};
    skel_flann *f;
    for (uint64_t i = 0; i < n; i++) { /* a sheet that is not quite flat, in the order of its rows */
        point[3 * i] = (int32_t)(i % 40) * 200000 - 4000000 + coordinate(&seed, 100000);
        point[3 * i + 1] = (int32_t)(i / 40) * 200000 - 4000000 + coordinate(&seed, 100000);
        point[3 * i + 2] = coordinate(&seed, 300000);
        weight[i] = 1 + (uint32_t)(test_random(&seed) % 5);
        doublings[i] = (uint8_t)(test_random(&seed) % 3);
    }
    CHECK_OK(skel_flann_open(radius, threads, &f, &err));
    for (int call = 0; call < 28 && !test_failed(); call++) {
        brute(n, radius, doubled);
        memset(got, 0xff, sizeof got);
        CHECK_OK(skel_flann_sums(f, point, weight, doubled ? doublings : NULL, n, call > 0, got, &err));
        CHECK_MSG(memcmp(got, slow, n * sizeof *got) == 0, "call %d of %u threads, pace %g, %llu jumps", call, threads, pace, (unsigned long long)jumps);
        for (uint64_t i = 0; i < n; i++) /* two crowds that go through each other, none of them straight */
            for (uint64_t k = 0; k < 3; k++) point[3 * i + k] += coordinate(&seed, step) / 4 + (k > 0 ? 0 : i % 2 == 0 ? step : -step);
        for (uint64_t j = 0; j < jumps; j++)
            for (uint64_t k = 0, i = test_random(&seed) % n; k < 3; k++) point[3 * i + k] = coordinate(&seed, 5000000);
        if (!welds || call % 4 != 3) continue;
        const uint64_t groups = weld(n, &seed, label);
        CHECK_OK(skel_flann_weld(f, label, (uint32_t)groups, &err));
        n = groups;
    }
    skel_flann_close(f);
}

TEST(points_that_move)
{
    for (uint32_t threads = 1; threads <= 4; threads += 3)
        for (uint64_t jumps = 0; jumps < 16 && !test_failed(); jumps = jumps * 8 + 9)
            for (double pace = 0; pace < 1.5 && !test_failed(); pace = pace * 8 + 0.004) {
                moving(pace, jumps, false, false, threads);
                moving(pace, jumps, false, true, threads);
                moving(pace, jumps, true, false, threads);
            }
}

/* So many that lists are not kept before two thirds of them are gone. Against the grid, which the other tests hold against brute force. */
TEST(many_points_that_move)
{
    static uint32_t label[MAX_POINTS];
    uint64_t seed = 8, n = MAX_POINTS;
    const double radius = 0.01;
    svo_error err = {0};
    skel_flann *f;
    for (uint64_t i = 0; i < n; i++) {
        for (uint64_t k = 0; k < 3; k++) point[3 * i + k] = coordinate(&seed, 4000000);
        weight[i] = 1 + (uint32_t)(test_random(&seed) % 5);
    }
    CHECK_OK(skel_flann_open(radius, 2, &f, &err));
    for (int call = 0; call < 8 && !test_failed(); call++) {
        CHECK_OK(skel_flann_sums(f, point, weight, NULL, n, call > 0, got, &err));
        CHECK_OK(skel_radius_grid(NULL, point, weight, NULL, n, radius, 2, slow, &err));
        CHECK_MSG(memcmp(got, slow, n * sizeof *got) == 0, "call %d", call);
        for (uint64_t i = 0; i < 3 * n; i++) point[i] += coordinate(&seed, 3000);
        if (call != 1 && call != 3 && call != 5) continue;
        const uint64_t groups = call == 3 ? n / 4 : weld(n, &seed, label);
        if (call == 3) /* most of them at once; where to does not matter */
            for (uint64_t i = 0; i < n; i++) label[i] = (uint32_t)(i % groups);
        CHECK_OK(skel_flann_weld(f, label, (uint32_t)groups, &err));
        n = groups;
    }
    skel_flann_close(f);
}

TEST(nothing)
{
    svo_error err = {0};
    CHECK_OK(skel_radius_flann(point, weight, NULL, 0, 1, 1, got, &err));
    CHECK_OK(skel_radius_grid(NULL, point, weight, NULL, 0, 1, 1, got, &err));
}
