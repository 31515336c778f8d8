/* How far vertices can move before they meet another part of the surface, and how wide their balls may be for that. */
#include <math.h>
#include <string.h>

#include "skeli_thick.h"
#include "test.h"

enum { SIDE = 21, SHEETS = 3, POINTS = SIDE * SIDE * SHEETS, TRIANGLES = 2 * (SIDE - 1) * (SIDE - 1) * SHEETS };
#define STEP (0.02 * SKEL_LATTICE)

static double position[3 * POINTS];
static uint32_t corner[3 * TRIANGLES], edge[2 * 6 * TRIANGLES], incident[3 * TRIANGLES], incident_start[POINTS + 1], bucket[POINTS + 2], scratch[2 * 6 * TRIANGLES];
static uint64_t edge_start[POINTS + 1];

/* Square sheets that face each other, at the heights z. */
static skeli_state sheets(const double z[SHEETS])
{
    skeli_state s = {.count = POINTS, .original_count = POINTS, .position = position, .corner = corner, .edge = edge, .edge_start = edge_start, .incident_start = incident_start, .incident = incident,
                     .bucket = bucket, .scratch = scratch};
    uint64_t n = 0;
    for (uint32_t i = 0; i < POINTS; i++) {
        position[3 * i] = rint((i % SIDE) * STEP - 0.2 * SKEL_LATTICE);
        position[3 * i + 1] = rint((i / SIDE % SIDE) * STEP - 0.2 * SKEL_LATTICE);
        position[3 * i + 2] = rint(z[i / (SIDE * SIDE)] * SKEL_LATTICE);
    }
    for (uint32_t i = 0; i < POINTS; i++) {
        if (i % SIDE == SIDE - 1 || i / SIDE % SIDE == SIDE - 1) continue;
        const uint32_t t[2][3] = {{i, i + 1, i + SIDE}, {i + 1, i + SIDE, i + SIDE + 1}};
        for (int k = 0; k < 2; k++) {
            memcpy(corner + 3 * (uint64_t)s.triangle_count++, t[k], sizeof t[k]);
            for (int e = 0; e < 3; e++) {
                edge[2 * n] = edge[2 * (n + 1) + 1] = t[k][e];
                edge[2 * n + 1] = edge[2 * (n + 1)] = t[k][(e + 1) % 3];
                n += 2;
            }
        }
    }
    s.edge_count = skeli_sort_unique(edge, n, 2, POINTS, scratch, bucket);
    skeli_index(&s);
    return s;
}

/* The nearer of what is above and below counts, and no thread count changes anything. */
TEST(ways_of_sheets)
{
    svo_error err = {0};
    const double z[SHEETS] = {-0.1, 0.2, 0.3};
    const float want[SHEETS] = {0.3f, 0.1f, 0.1f};
    skeli_state s = sheets(z);
    static float way[2][POINTS];
    for (uint32_t threads = 1; threads <= 2; threads++) {
        skeli_pool pool = {0};
        CHECK_OK(skeli_ways(&pool, &s, threads, way[threads - 1], &err));
        skeli_pool_free(&pool);
    }
    CHECK(memcmp(way[0], way[1], sizeof way[0]) == 0);
    for (uint32_t i = 0; i < POINTS; i++) CHECK_MSG(fabsf(way[0][i] / SKEL_LATTICE - want[i / (SIDE * SIDE)]) < 1e-5f, "vertex %u: %g", i, (double)way[0][i] / SKEL_LATTICE);
}

/* A vertex without area has no way, and what lies beside it as much as it is away. */
TEST(ways_grow_with_the_distance_from_thin_parts)
{
    svo_error err = {0};
    const double z[SHEETS] = {-0.5, 0.5, 0.9};
    skeli_state s = sheets(z);
    skeli_pool pool = {0};
    static float way[POINTS];
    const uint32_t thin = SIDE * (SIDE / 2) + SIDE / 2;
    s.incident_start[thin + 1] = s.incident_start[thin]; /* the next vertex gets them: they are as flat */
    CHECK_OK(skeli_ways(&pool, &s, 1, way, &err));
    skeli_pool_free(&pool);
    CHECK(way[thin] == 0);
    for (uint32_t i = 0; i < SIDE * SIDE; i++) {
        const double *p = position + 3 * (uint64_t)i, *q = position + 3 * (uint64_t)thin, apart = hypot(p[0] - q[0], p[1] - q[1]);
        CHECK_MSG(way[i] >= 0.999 * apart && way[i] <= 1.42 * apart + 1, "vertex %u: %g, %g away", i, (double)way[i], apart); /* along edges */
    }
}

/* The wider ball never reaches through: its radius is at most a quarter of the way. */
TEST(doublings_by_way)
{
    float way[200];
    uint8_t doublings[200];
    const double omega = 1000;
    uint32_t thick = 0;
    for (int i = 0; i < 200; i++) way[i] = (float)(i - 20) * 500;
    CHECK_U64(skeli_doublings(way, 200, omega, doublings), 200 - 20 - 16);
    for (int i = 0; i < 200; i++) {
        thick += doublings[i] > 0;
        CHECK(doublings[i] <= SKELI_MOST_DOUBLINGS && (doublings[i] == 0 || 4 * omega * (1 << doublings[i]) <= way[i]));
        CHECK(doublings[i] == SKELI_MOST_DOUBLINGS || 4 * omega * (2 << doublings[i]) > way[i]);
    }
    CHECK_U64(thick, 200 - 20 - 16);
}
