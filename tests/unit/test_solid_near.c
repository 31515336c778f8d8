/* The nearest surface voxel against a search through all of them. */
#include <math.h>
#include <string.h>

#include "svo_morton.h"
#include "svoi_solid_near.h"
#include "test.h"

static uint64_t seed = 7;
static uint32_t below(uint64_t n) { return (uint32_t)(test_random(&seed) % n); }

typedef struct truth {
    uint32_t count;
    int32_t at[1 << 16][3];
} truth;

static int32_t square_to(const int32_t *v, const int32_t middle[3])
{
    int32_t d = 0;
    for (int k = 0; k < 3; k++) d += (2 * v[k] + 1 - middle[k]) * (2 * v[k] + 1 - middle[k]);
    return d;
}

static void mark(svo_block *b, truth *t, uint32_t x, uint32_t y, uint32_t z)
{
    uint32_t code = b->spread[0][x] | b->spread[1][y] | b->spread[2][z];
    if (b->bricks[code >> 6] >> (code & 63) & 1) return;
    svo_block_set(b, code);
    int32_t *v = t->at[t->count++];
    v[0] = (int32_t)x, v[1] = (int32_t)y, v[2] = (int32_t)z;
}

/* A shell of thickness about one, or single voxels. */
static void fill(svo_block *b, truth *t, uint32_t side, bool shell)
{
    if (!shell) {
        for (uint32_t i = 0; i < 1 + side / 4; i++) mark(b, t, below(side), below(side), below(side));
        return;
    }
    double c[3], r = side * (0.1 + 0.5 * test_random_unit(&seed));
    for (int k = 0; k < 3; k++) c[k] = side * test_random_unit(&seed);
    for (uint32_t z = 0; z < side; z++)
        for (uint32_t y = 0; y < side; y++)
            for (uint32_t x = 0; x < side; x++) {
                double d = sqrt((x - c[0]) * (x - c[0]) + (y - c[1]) * (y - c[1]) + (z - c[2]) * (z - c[2]));
                if (fabs(d - r) < 0.8 && t->count + 1 < sizeof t->at / sizeof *t->at) mark(b, t, x, y, z);
            }
}

static bool is_empty(const svo_block *b, uint32_t code, uint32_t height)
{
    const uint32_t count = 1u << 3 * height;
    for (uint32_t i = code; i < code + count; i++)
        if (b->bricks[i >> 6] >> (i & 63) & 1) return false;
    return true;
}

static void compare(svo_block *b, const truth *t, uint32_t levels, const int32_t corner[3], int32_t grid)
{
    svoi_near n;
    svoi_near_begin(&n, b, levels, corner, grid);
    const int32_t side = 1 << levels;
    uint32_t code = 0;
    for (uint32_t round = 0; round < 400; round++) {
        const uint32_t height = below(levels < 3 ? levels + 1 : 4);
        code = below(3) == 0 ? below((uint64_t)1 << 3 * levels) : (code + below(64)) & ((1u << 3 * levels) - 1);
        code &= ~((1u << 3 * height) - 1);
        if (!is_empty(b, code, height)) continue;
        uint32_t at[3], found = UINT32_MAX;
        int32_t middle[3], least = INT32_MAX, outside = INT32_MAX;
        svo_morton_decode(code, &at[0], &at[1], &at[2]);
        for (int k = 0; k < 3; k++) middle[k] = 2 * (int32_t)at[k] + (1 << height);
        for (uint32_t i = 0; i < t->count; i++) {
            int32_t d = square_to(t->at[i], middle);
            least = d < least ? d : least;
        }
        for (int k = 0; k < 3; k++) {
            if (corner[k] > 0 && middle[k] + 1 < outside) outside = middle[k] + 1;
            if (corner[k] + side < grid && 2 * side - middle[k] + 1 < outside) outside = 2 * side - middle[k] + 1;
        }
        const double slack = height == 0 ? 0 : 1 << height;
        if (!svoi_near_voxel(&n, code, height, &found)) {
            /* nothing is there, or another block may hold what is nearer */
            CHECK(t->count == 0 || outside + (height == 0 ? 2 : slack) < sqrt(least) + slack + 1e-3);
            continue;
        }
        uint32_t v[3];
        svo_morton_decode(found, &v[0], &v[1], &v[2]);
        const int32_t voxel[3] = {(int32_t)v[0], (int32_t)v[1], (int32_t)v[2]};
        CHECK(b->bricks[found >> 6] >> (found & 63) & 1);
        const double d = sqrt(square_to(voxel, middle));
        CHECK(d <= sqrt(least) + slack + 1e-6);
        CHECK(d <= outside + (height == 0 ? 2 : slack) + 1e-6);
    }
}

TEST(nearest_voxels_are_nearest)
{
    svo_block *b = svo_alloc(NULL, 1, sizeof *b);
    truth *t = svo_alloc(NULL, 1, sizeof *t);
    CHECK(b != NULL && t != NULL);
    svo_block_init(b);
    for (uint32_t round = 0; round < 60; round++) {
        const uint32_t levels = round % 8;
        const int32_t side = 1 << levels, corner[3] = {round & 8 ? side : 0, 0, round & 16 ? 2 * side : 0};
        t->count = 0;
        fill(b, t, (uint32_t)side, round % 3 != 0 && levels < 7);
        compare(b, t, levels, corner, round & 24 ? 4 * side : side);
        svo_block_clear(b);
    }
    svo_free(NULL, t, 1, sizeof *t);
    svo_free(NULL, b, 1, sizeof *b);
}

TEST(nothing_is_near_in_an_empty_block)
{
    svo_block *b = svo_alloc(NULL, 1, sizeof *b);
    CHECK(b != NULL);
    svo_block_init(b);
    svoi_near n;
    uint32_t code;
    svoi_near_begin(&n, b, 5, (int32_t[3]){0, 0, 0}, 32);
    for (uint32_t height = 0; height < 4; height++) CHECK(!svoi_near_voxel(&n, 4096, height, &code));
    svo_free(NULL, b, 1, sizeof *b);
}
