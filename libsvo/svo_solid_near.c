/* The nearest surface voxel of a voxel or leaf that is inside.
 *
 * Almost all of them lie in bricks that hold surface, and have some in the voxels around them. So the 27 bricks around the one in hand are brought
 * to linear order and shifted by every step of one voxel: then all steps of one length are tests of single words. What is farther away
 * is looked for in the bricks within the distance to what was found last. */
#include "svoi_solid_near.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"

/* --- bricks in linear order: bit x + 4 y + 16 z ------------------------------------------------------------------- */

/* Exchange two bits of the number of each bit. */
static inline uint64_t swap_bits(uint64_t v, uint64_t low, uint32_t distance)
{
    uint64_t t = ((v >> distance) ^ v) & low;
    return v ^ t ^ (t << distance);
}

static inline uint64_t linear(uint64_t morton)
{
    morton = swap_bits(morton, 0x00cc00cc00cc00ccu, 6);
    morton = swap_bits(morton, 0x0000ff000000ff00u, 8);
    return swap_bits(morton, 0x0000f0f00000f0f0u, 12);
}

/* Where bit i of a brick is in linear order. */
static const uint8_t linear_of[64] = {
    0, 1, 4, 5, 16, 17, 20, 21, 2, 3, 6, 7, 18, 19, 22, 23, 8, 9, 12, 13, 24, 25, 28, 29, 10, 11, 14, 15, 26, 27, 30, 31,
    32, 33, 36, 37, 48, 49, 52, 53, 34, 35, 38, 39, 50, 51, 54, 55, 40, 41, 44, 45, 56, 57, 60, 61, 42, 43, 46, 47, 58, 59, 62, 63};

/* Brick at a place given in bricks. */
static inline uint32_t brick_at(const svo_block *b, uint32_t x, uint32_t y, uint32_t z) { return (b->spread[0][4 * x] | b->spread[1][4 * y] | b->spread[2][4 * z]) >> 6; }

/* Bit i of the result: the voxel one step before (-1), at (0) or behind (1) voxel i along an axis; `around` are the bricks there. */
static inline uint64_t step_x(const uint64_t around[3], int step)
{
    return step == 0 ? around[1] : step > 0 ? (around[1] >> 1 & 0x7777777777777777u) | (around[2] << 3 & 0x8888888888888888u) :
                                              (around[1] << 1 & 0xeeeeeeeeeeeeeeeeu) | (around[0] >> 3 & 0x1111111111111111u);
}
static inline uint64_t step_y(const uint64_t around[3], int step)
{
    return step == 0 ? around[1] : step > 0 ? (around[1] >> 4 & 0x0fff0fff0fff0fffu) | (around[2] << 12 & 0xf000f000f000f000u) :
                                              (around[1] << 4 & 0xfff0fff0fff0fff0u) | (around[0] >> 12 & 0x000f000f000f000fu);
}
static inline uint64_t step_z(const uint64_t around[3], int step)
{
    return step == 0 ? around[1] : step > 0 ? around[1] >> 16 | around[2] << 48 : around[1] << 16 | around[0] >> 48;
}

/* Steps of one voxel by length, then z, y, x; as numbers x + 3 y + 9 z of steps plus one. */
enum { FACES = 6, EDGES = 12, CORNERS = 8, NO_STEP = 255, VOXEL = 2 /* in half voxels */ };
static const uint8_t steps[FACES + EDGES + CORNERS] = {
    4, 10, 12, 14, 16, 22, /* */
    1, 3, 5, 7, 9, 11, 15, 17, 19, 21, 23, 25, /* */
    0, 2, 6, 8, 18, 20, 24, 26};

static void load_around(svoi_near *n)
{
    const int32_t bricks = n->levels > 2 ? 1 << (n->levels - 2) : 1;
    const int32_t at[3] = {n->low[0] >> 2, n->low[1] >> 2, n->low[2] >> 2};
    uint64_t in[3][3][3], x[3][3][3], y[3][3][3];
    for (int32_t k = 0; k < 3; k++)
        for (int32_t j = 0; j < 3; j++)
            for (int32_t i = 0; i < 3; i++) {
                const int32_t c[3] = {at[0] + i - 1, at[1] + j - 1, at[2] + k - 1};
                bool inside = true;
                for (int a = 0; a < 3; a++) inside &= c[a] >= 0 && c[a] < bricks;
                uint64_t bits = inside ? n->block->bricks[brick_at(n->block, (uint32_t)c[0], (uint32_t)c[1], (uint32_t)c[2])] : 0;
                in[k][j][i] = bits != 0 ? linear(bits) : 0;
            }
    for (int k = 0; k < 3; k++)
        for (int j = 0; j < 3; j++)
            for (int s = 0; s < 3; s++) x[k][s][j] = step_x(in[k][j], s - 1);
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++)
            for (int s = 0; s < 3; s++) y[s][i][k] = step_y(x[k][i], s - 1);
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < 3; i++)
            for (int s = 0; s < 3; s++) n->set[9 * s + 3 * j + i] = step_z(y[j][i], s - 1);
    memset(n->step, NO_STEP, sizeof n->step);
    uint64_t left = ~linear(n->block->bricks[n->brick]);
    for (uint32_t i = 0; i < FACES + EDGES + CORNERS; i++) {
        uint64_t hit = left & n->set[steps[i]];
        left &= ~hit;
        for (; hit != 0; hit &= hit - 1) n->step[__builtin_ctzll(hit)] = (uint8_t)i;
    }
    n->border = false;
    for (int k = 0; k < 3; k++) n->border |= at[k] == 0 || at[k] == bricks - 1;
    n->loaded = true;
}

/* Code of the voxel one step from voxel `bit` (linear) of the brick. */
static uint32_t stepped(const svoi_near *n, uint32_t bit, uint32_t step)
{
    const uint32_t x = (uint32_t)n->low[0] + (bit & 3) + step % 3 - 1, y = (uint32_t)n->low[1] + (bit >> 2 & 3) + step / 3 % 3 - 1;
    const uint32_t z = (uint32_t)n->low[2] + (bit >> 4) + step / 9 - 1;
    return n->block->spread[0][x] | n->block->spread[1][y] | n->block->spread[2][z];
}

/* A leaf of 2^3 voxels, whose first is `base` (linear): among the voxels that share a face with it (at (3, 1, 1) half voxels from its middle), or an edge ((3, 3, 1)). */
static bool near_of_octant(const svoi_near *n, uint32_t base, uint32_t *out, int32_t *distance)
{
    /* its voxels on either side of an axis */
    static const uint64_t side[3][3] = {{0x00110011, 0x00330033, 0x00220022}, {0x00030003, 0x00330033, 0x00300030}, {0x00000033, 0x00330033, 0x00330000}};
    for (uint32_t i = 0; i < FACES + EDGES; i++) {
        const uint32_t s = steps[i];
        const uint64_t hit = n->set[s] & (side[0][s % 3] & side[1][s / 3 % 3] & side[2][s / 9]) << base;
        if (hit == 0) continue;
        *out = stepped(n, (uint32_t)__builtin_ctzll(hit), s);
        *distance = i < FACES ? 11 : 19;
        return true;
    }
    return false;
}

/* --- rings of bricks ---------------------------------------------------------------------------------------------- */

typedef struct search {
    const svo_block *block;
    int32_t at[3];  /* in half voxels from the block's corner */
    int32_t best;   /* squared distance to the centre of `code`, half voxels */
    uint32_t code;
} search;

typedef int32_t whole8 __attribute__((vector_size(32)));

/* All 64 voxels at once, eight of an octant at a time: the least of distance << 6 | bit is the nearest, and the one of the smaller code. */
static void search_brick(search *s, uint32_t brick, const int32_t at[3])
{
    const uint64_t bits = s->block->bricks[brick];
    whole8 square[3][2]; /* by axis, and half of the brick */
    for (int k = 0; k < 3; k++)
        for (int h = 0; h < 2; h++) {
            const int32_t d = 2 * (4 * at[k] + 2 * h) + 1 - s->at[k], a = d * d << 6, b = (d + 2) * (d + 2) << 6;
            square[k][h] = k == 0 ? (whole8){a, b, a, b, a, b, a, b} : k == 1 ? (whole8){a, a, b, b, a, a, b, b} : (whole8){a, a, a, a, b, b, b, b};
        }
    const whole8 lane = {1, 2, 4, 8, 16, 32, 64, 128}, number = {0, 1, 2, 3, 4, 5, 6, 7};
    whole8 least = {INT32_MAX, INT32_MAX, INT32_MAX, INT32_MAX, INT32_MAX, INT32_MAX, INT32_MAX, INT32_MAX};
    for (int32_t g = 0; g < 8; g++) {
        const int32_t in = (int32_t)(bits >> 8 * g & 255);
        if (in == 0) continue;
        const whole8 key = square[0][g & 1] + square[1][g >> 1 & 1] + square[2][g >> 2] + (number | 8 * g);
        const whole8 better = ((lane & in) != 0) & (key < least);
        least = (key & better) | (least & ~better);
    }
    int32_t key = least[0];
    for (int i = 1; i < 8; i++) key = least[i] < key ? least[i] : key;
    const int32_t d = key >> 6;
    const uint32_t code = brick << 6 | ((uint32_t)key & 63);
    if (d < s->best || (d == s->best && code < s->code)) s->best = d, s->code = code;
}

/* Squared distance, in half voxels, from the point to the nearest middle of a voxel in the slab of bricks at `i` along an axis. */
static inline int32_t slab_gap(int32_t at, int32_t i)
{
    int32_t low = 8 * i + 1, d = at < low ? low - at : at > low + 6 ? at - low - 6 : 0;
    return d * d;
}

static void search_rings(const svoi_near *n, search *q)
{
    const int32_t bricks = n->levels > 2 ? 1 << (n->levels - 2) : 1, home[3] = {q->at[0] >> 3, q->at[1] >> 3, q->at[2] >> 3};
    for (int32_t ring = 0; ring < bricks; ring++) {
        bool nearer = false; /* could a brick of this ring hold a nearer voxel? */
        for (int32_t z = home[2] - ring; z <= home[2] + ring; z++) {
            int32_t gz = slab_gap(q->at[2], z);
            if (z < 0 || z >= bricks || gz > q->best) continue;
            for (int32_t y = home[1] - ring; y <= home[1] + ring; y++) {
                int32_t gy = gz + slab_gap(q->at[1], y);
                if (y < 0 || y >= bricks || gy > q->best) continue;
                bool edge = z == home[2] - ring || z == home[2] + ring || y == home[1] - ring || y == home[1] + ring;
                for (int32_t x = home[0] - ring; x <= home[0] + ring; x += edge || ring == 0 ? 1 : 2 * ring) {
                    if (x < 0 || x >= bricks || gy + slab_gap(q->at[0], x) > q->best) continue;
                    nearer = true;
                    const uint32_t brick = brick_at(n->block, (uint32_t)x, (uint32_t)y, (uint32_t)z);
                    const int32_t at[3] = {x, y, z};
                    if (n->block->bricks[brick] != 0) search_brick(q, brick, at);
                }
            }
        }
        if (!nearer) break;
    }
}

/* Squared distance that a voxel has to be within to count as nearer than the best by more than `slack`. */
static inline int32_t within(const search *q, int32_t slack)
{
    if (slack == 0) return q->best;
    const int32_t d = (int32_t)sqrtf((float)q->best) + 1 - slack;
    return d > 0 ? d * d : 0;
}

/* All bricks within the distance to what is already found, less the slack. */
static void search_ball(const svoi_near *n, search *q, int32_t slack)
{
    int32_t most = within(q, slack);
    const int32_t bricks = n->levels > 2 ? 1 << (n->levels - 2) : 1, radius = (int32_t)sqrtf((float)most) + 1;
    int32_t low[3], high[3], gap[3][SVO_RASTER_SIZE / 4];
    for (int k = 0; k < 3; k++) {
        low[k] = q->at[k] > radius ? (q->at[k] - radius) >> 3 : 0;
        high[k] = (q->at[k] + radius) >> 3;
        if (high[k] >= bricks) high[k] = bricks - 1;
        for (int32_t i = low[k]; i <= high[k]; i++) gap[k][i] = slab_gap(q->at[k], i);
    }
    int32_t at[3];
    for (at[2] = low[2]; at[2] <= high[2]; at[2]++)
        for (at[1] = low[1]; at[1] <= high[1]; at[1]++) {
            const int32_t beside = gap[2][at[2]] + gap[1][at[1]];
            const uint32_t row = n->block->spread[1][4 * at[1]] | n->block->spread[2][4 * at[2]];
            if (beside > most) continue;
            for (at[0] = low[0]; at[0] <= high[0]; at[0]++) {
                const uint32_t brick = (row | n->block->spread[0][4 * at[0]]) >> 6;
                if (beside + gap[0][at[0]] > most || n->block->bricks[brick] == 0) continue;
                search_brick(q, brick, at);
                most = within(q, slack);
            }
        }
}

/* --- */

void svoi_near_begin(svoi_near *n, const svo_block *block, uint32_t levels, const int32_t corner[3], int32_t grid)
{
    n->block = block;
    n->levels = levels;
    memcpy(n->corner, corner, sizeof n->corner);
    n->grid = grid;
    n->brick = n->last = UINT32_MAX;
}

bool svoi_near_voxel(svoi_near *n, uint32_t code, uint32_t height, uint32_t *out)
{
    const int32_t half = 1 << height;
    search q = {.block = n->block, .best = INT32_MAX, .code = UINT32_MAX};
    if (n->brick != code >> 6) {
        uint32_t at[3];
        n->brick = code >> 6;
        n->loaded = false;
        svo_morton_decode((uint64_t)n->brick << 6, &at[0], &at[1], &at[2]);
        for (int k = 0; k < 3; k++) n->low[k] = (int32_t)at[k];
    }
    const uint32_t bit = linear_of[code & 63];
    if (height <= 1 && !n->loaded) load_around(n);
    const uint32_t step = height == 0 ? n->step[bit] : NO_STEP;
    if (step != NO_STEP && !n->border) {
        *out = n->last = stepped(n, bit, steps[step]);
        return true;
    }
    for (int k = 0; k < 3; k++) q.at[k] = 2 * (n->low[k] + (int32_t)(bit >> 2 * k & 3)) + half;
    bool found = height == 1 && near_of_octant(n, bit, &q.code, &q.best);
    if (step != NO_STEP) {
        q.code = stepped(n, bit, steps[step]);
        q.best = step < FACES ? 4 : step < FACES + EDGES ? 8 : 12;
        found = true;
    }
    if (!found) {
        if (n->last != UINT32_MAX) { /* no farther than what its neighbour found */
            uint32_t v[3];
            svo_morton_decode(n->last, &v[0], &v[1], &v[2]);
            q.best = 0;
            for (int k = 0; k < 3; k++) q.best += (2 * (int32_t)v[k] + 1 - q.at[k]) * (2 * (int32_t)v[k] + 1 - q.at[k]);
            q.code = n->last;
            search_ball(n, &q, height == 0 ? 0 : half);
        } else {
            search_rings(n, &q);
        }
    }
    if (q.code == UINT32_MAX) return false;
    n->last = q.code;
    /* Middles of voxels behind the block's own faces, where the grid goes on: could one be nearer by more than the slack? */
    const int32_t side = 2 << n->levels, slack = height == 0 ? VOXEL : half;
    for (int k = 0; k < 3; k++) {
        const int32_t down = q.at[k] + 1 + slack, up = side - q.at[k] + 1 + slack;
        if ((n->corner[k] > 0 && down * down < q.best) || (n->corner[k] + side / 2 < n->grid && up * up < q.best)) return false;
    }
    *out = q.code;
    return true;
}
