/* Ball sums through a grid with cells of the radius: the neighbours of all queries of a cell are gathered once into arrays. */
#include "skel_radius.h"

#include <string.h>

#include "svo_task.h"

/* A query sees the cells around its own, so a cell may not be narrower than the radius, float rounding included. */
typedef struct grid {
    const int32_t *points;
    const uint32_t *weights;
    const uint8_t *doublings; /* may be NULL */
    uint64_t count;
    float squared; /* in lattice steps squared */
    skel_ball_sum *out;
    int64_t low[3], cell; /* lattice steps */
    int64_t size[3];
    uint32_t *start; /* cells + 1: first entry in order */
    uint32_t *order; /* points by cell, by index inside a cell */
    const svo_allocator *allocator;
} grid;

/* Float arithmetic of skel_radius.h in lattice steps: powers of two scale exactly. */
static inline bool inside(int32_t dx, int32_t dy, int32_t dz, float squared)
{
    float x = (float)dx, y = (float)dy, z = (float)dz;
    return (x * x + y * y) + z * z < squared;
}

/* The squared radius of point i: times a power of two, which is exact. */
static inline float squared_of(const grid *g, uint64_t i) { return g->doublings == NULL ? g->squared : g->squared * (float)(1u << 2 * g->doublings[i]); }

/* Candidates of a cell as arrays (weights are below 2^31). */
typedef struct gathered {
    int32_t *x, *y, *z, *w;
    uint64_t count, capacity;
} gathered;

static skel_ball_sum sum_candidates(const gathered *g, const int32_t p[3], float squared)
{
    int64_t x = 0, y = 0, z = 0, weight = 0;
    for (uint64_t j = 0; j < g->count; j++) {
        bool in = inside(g->x[j] - p[0], g->y[j] - p[1], g->z[j] - p[2], squared);
        int32_t w = in ? g->w[j] : 0;
        x += (int64_t)w * g->x[j];
        y += (int64_t)w * g->y[j];
        z += (int64_t)w * g->z[j];
        weight += w;
    }
    return (skel_ball_sum){x, y, z, weight};
}

static svo_result brute(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    const grid *g = user;
    for (uint64_t i = begin; i < end; i++) {
        const int32_t *p = g->points + 3 * i;
        const float squared = squared_of(g, i);
        skel_ball_sum s = {0};
        for (uint64_t j = 0; j < g->count; j++) {
            const int32_t *q = g->points + 3 * j;
            if (!inside(q[0] - p[0], q[1] - p[1], q[2] - p[2], squared)) continue;
            int64_t w = g->weights[j];
            s.x += w * q[0];
            s.y += w * q[1];
            s.z += w * q[2];
            s.weight += w;
        }
        g->out[i] = s;
    }
    return SVO_OK;
}

static uint64_t cell_of(const grid *g, const int32_t *p)
{
    int64_t c[3];
    for (int k = 0; k < 3; k++) c[k] = (p[k] - g->low[k]) / g->cell;
    return (uint64_t)((c[2] * g->size[1] + c[1]) * g->size[0] + c[0]);
}

/* Candidates of the cell (x, y, z): the points of the 27 cells around it, row by row. */
static svo_result gather(const grid *g, int64_t x, int64_t y, int64_t z, gathered *to, svo_error *err)
{
    int64_t nx = g->size[0], ny = g->size[1], nz = g->size[2];
    uint32_t first[9], last[9];
    uint64_t total = 0;
    int rows = 0;
    for (int64_t dz = -1; dz <= 1; dz++)
        for (int64_t dy = -1; dy <= 1; dy++) {
            if (y + dy < 0 || y + dy >= ny || z + dz < 0 || z + dz >= nz) continue;
            uint64_t base = (uint64_t)((z + dz) * ny + y + dy) * (uint64_t)nx;
            first[rows] = g->start[base + (uint64_t)(x > 0 ? x - 1 : 0)];
            last[rows] = g->start[base + (uint64_t)(x + 1 < nx ? x + 1 : x) + 1];
            total += last[rows] - first[rows];
            rows++;
        }
    if (total > to->capacity) {
        svo_free(g->allocator, to->x, to->capacity, 16);
        uint64_t capacity = total + total / 2 + 64;
        *to = (gathered){.x = svo_alloc(g->allocator, capacity, 16)};
        if (to->x == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory in the radius search");
        to->capacity = capacity;
        to->y = to->x + capacity;
        to->z = to->y + capacity;
        to->w = to->z + capacity;
    }
    to->count = 0;
    for (int r = 0; r < rows; r++)
        for (uint32_t k = first[r]; k < last[r]; k++) {
            const int32_t *p = g->points + 3 * (uint64_t)g->order[k];
            to->x[to->count] = p[0];
            to->y[to->count] = p[1];
            to->z[to->count] = p[2];
            to->w[to->count++] = (int32_t)g->weights[g->order[k]];
        }
    return SVO_OK;
}

/* Rows of cells (same y and z) are the items: begin and end count rows. */
static svo_result search_rows(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    const grid *g = user;
    gathered c = {0};
    svo_result result = SVO_OK;
    for (uint64_t row = begin; row < end && result == SVO_OK; row++) {
        int64_t y = (int64_t)row % g->size[1], z = (int64_t)row / g->size[1];
        for (int64_t x = 0; x < g->size[0] && result == SVO_OK; x++) {
            uint64_t cell = row * (uint64_t)g->size[0] + (uint64_t)x;
            if (g->start[cell] == g->start[cell + 1]) continue;
            result = gather(g, x, y, z, &c, err);
            if (result != SVO_OK) break;
            for (uint32_t k = g->start[cell]; k < g->start[cell + 1]; k++) {
                uint32_t i = g->order[k];
                g->out[i] = sum_candidates(&c, g->points + 3 * (uint64_t)i, squared_of(g, i));
            }
        }
    }
    svo_free(g->allocator, c.x, c.capacity, 16);
    return result;
}

svo_result skel_radius_grid(const svo_allocator *a, const int32_t *points, const uint32_t *weights, const uint8_t *doublings, uint64_t count, double radius,
                            uint32_t threads, skel_ball_sum *out, svo_error *err)
{
    if (count == 0) return SVO_OK;
    if (count > INT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu points are too many for the radius search", (unsigned long long)count);
    float r = (float)radius, squared = r * r;
    grid g = {.points = points, .weights = weights, .doublings = doublings, .count = count, .out = out, .allocator = a};
    g.squared = squared * (float)SKEL_LATTICE * (float)SKEL_LATTICE;
    if (count <= 256) return brute(&g, 0, count, 0, err);

    int64_t high[3];
    for (int k = 0; k < 3; k++) g.low[k] = high[k] = points[k];
    for (uint64_t i = 1; i < count; i++)
        for (int k = 0; k < 3; k++) {
            int64_t v = points[3 * i + k];
            if (v < g.low[k]) g.low[k] = v;
            if (v > high[k]) high[k] = v;
        }
    /* The squared radius was rounded to float: the cell is wider by more than that. Fewer cells than 8 a point keep the grid small. */
    uint8_t most = 0;
    for (uint64_t i = 0; i < count && doublings != NULL; i++) most = doublings[i] > most ? doublings[i] : most;
    g.cell = (int64_t)(radius * (1u << most) * SKEL_LATTICE * 1.001) + 2;
    uint64_t cells;
    for (;;) {
        cells = 1;
        for (int k = 0; k < 3; k++) {
            g.size[k] = (high[k] - g.low[k]) / g.cell + 1;
            cells *= (uint64_t)g.size[k]; /* at most (2^25 / 2)^3 < 2^64: cell >= 2 */
            if (cells > UINT32_MAX) break;
        }
        if (cells <= 8 * count + 4096) break;
        g.cell *= 2;
    }
    if (cells == 1) return svo_parallel_for(count < 2048 ? 1 : threads, count, 256, brute, &g, err);
    g.start = svo_calloc(a, cells + 1, sizeof *g.start);
    g.order = svo_alloc(a, count, sizeof *g.order);
    svo_result result = SVO_OUT_OF_MEMORY;
    if (g.start == NULL || g.order == NULL) {
        svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory in the radius search");
    } else {
        for (uint64_t i = 0; i < count; i++) g.start[cell_of(&g, points + 3 * i)]++;
        uint32_t sum = 0;
        for (uint64_t k = 0; k <= cells; k++) {
            sum += g.start[k];
            g.start[k] = sum;
        }
        for (uint64_t i = count; i-- > 0;) g.order[--g.start[cell_of(&g, points + 3 * i)]] = (uint32_t)i;
        result = svo_parallel_for(count < 2048 ? 1 : threads, (uint64_t)(g.size[1] * g.size[2]), 0, search_rows, &g, err);
    }
    svo_free(a, g.start, cells + 1, sizeof *g.start);
    svo_free(a, g.order, count, sizeof *g.order);
    return result;
}
