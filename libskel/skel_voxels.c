/* Skeletons of voxels: the octree is read once, at a level that is fine enough for omega; what cannot be reached from outside is filled; the
 * outer boundary becomes a mesh of quads welded at the corners of the grid, and that goes the way of every mesh. Where voxels have normals, those of neighbours that face each other say that
 * there is a gap between them which is narrower than the voxels: there the boundary passes between them. */
#include "skeli_internal.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"

enum { MAX_LEVEL = 10 };                   /* 1024^3 cells: 128 MiB a bit set */
#define MAX_CELLS ((uint64_t)1 << 27)      /* occupied cells of the level read */
#define MAX_VOXELS ((uint64_t)1 << 32)     /* finest voxels: entries of the map */

/* Occupied cells of one level in Morton order, and how many finest voxels each holds. */
typedef struct cells {
    const svo_allocator *allocator;
    svo_buffer code, voxels; /* u32, u32 */
    svo_buffer normal;       /* float[3] of each cell, sums over its voxels; empty without normals */
    uint32_t channel;        /* of normals; SVO_NONE: none */
    const svo_chunk *chunk;  /* being read */
    uint32_t level, shift;   /* shift: levels between the cells and the finest voxels */
    uint64_t count, total;
    bool failed, too_many;
} cells;

static inline uint32_t *codes(const cells *c) { return (uint32_t *)(void *)c->code.data; }
static inline uint32_t *counts(const cells *c) { return (uint32_t *)(void *)c->voxels.data; }
static inline float *normals(const cells *c) { return (float *)(void *)c->normal.data; }

/* `voxels` finest voxels in the cell with this code, which comes after all others or is the last one. */
static bool add_to_cell(cells *c, uint32_t code, uint32_t voxels, const float normal[3])
{
    if (c->count > 0 && codes(c)[c->count - 1] == code && counts(c)[c->count - 1] <= UINT32_MAX - voxels) {
        counts(c)[c->count - 1] += voxels;
        for (uint64_t k = 0; k < 3 && c->channel != SVO_NONE; k++) normals(c)[3 * (c->count - 1) + k] += normal[k] * (float)voxels;
        return true;
    }
    if (c->count == MAX_CELLS) {
        c->too_many = true;
        return false;
    }
    c->failed = svo_buffer_append(&c->code, &code, 4) == NULL || svo_buffer_append(&c->voxels, &voxels, 4) == NULL;
    const float sum[3] = {normal[0] * (float)voxels, normal[1] * (float)voxels, normal[2] * (float)voxels};
    c->failed = c->failed || (c->channel != SVO_NONE && svo_buffer_append(&c->normal, sum, sizeof sum) == NULL);
    c->count++;
    return !c->failed;
}

/* A voxel, or a full leaf of size^3 of them. */
static bool add_value(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    cells *c = user;
    float normal[3] = {0, 0, 0};
    if (c->channel != SVO_NONE && size == 1) svo_oct32_decode(c->chunk->channels[c->channel] + 4 * index, normal); /* full leaves are inside */
    const uint64_t voxels = (uint64_t)size * size * size;
    if (voxels > MAX_VOXELS || (c->total += voxels) > MAX_VOXELS) {
        c->too_many = true;
        return false;
    }
    const uint32_t first = (uint32_t)svo_morton_encode(low[0] >> c->shift, low[1] >> c->shift, low[2] >> c->shift); /* at most 30 bits */
    const uint32_t side = size >> c->shift, cell = 1u << 3 * (c->shift < 10 ? c->shift : 10);
    if (side <= 1) return add_to_cell(c, first, (uint32_t)(voxels < cell ? voxels : cell), normal);
    for (uint32_t i = 0; i < side * side * side; i++)
        if (!add_to_cell(c, first + i, cell, normal)) return false;
    return true;
}

static svo_result read_cells(const svo_chunk_source *source, cells *c, svo_error *err)
{
    svo_buffer packed, storage;
    svo_buffer_init(&packed, c->allocator);
    svo_buffer_init(&storage, c->allocator);
    svo_result result = SVO_OK;
    for (bool more = true; result == SVO_OK;) {
        svo_chunk chunk;
        result = source->fetch(source->user, &packed, &more, err);
        if (result != SVO_OK || !more) break;
        result = source->decode(source->user, &packed, &storage, &chunk, err);
        if (result != SVO_OK) break;
        c->chunk = &chunk;
        svo_chunk_values(&chunk, add_value, c);
        c->chunk = NULL;
        if (c->too_many) result = svo_fail(err, SVO_LIMIT, "the octree has more voxels than a skeleton is built from (2^32, and 2^27 at level %u)", c->level);
        else if (c->failed) result = skeli_no_memory(err);
    }
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    if (result == SVO_OK && c->count == 0) result = svo_fail(err, SVO_INVALID_DATA, "the octree has no voxels, so it has no skeleton");
    return result;
}

/* Merge cells down to a coarser level. */
static void coarsen(cells *c, uint32_t level)
{
    uint32_t by = 3 * (c->level - level);
    uint64_t n = 0;
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t code = codes(c)[i] >> by;
        if (n > 0 && codes(c)[n - 1] == code && (uint64_t)counts(c)[n - 1] + counts(c)[i] <= UINT32_MAX) {
            counts(c)[n - 1] += counts(c)[i];
            for (uint64_t k = 0; k < 3 && c->channel != SVO_NONE; k++) normals(c)[3 * (n - 1) + k] += normals(c)[3 * i + k];
        } else {
            codes(c)[n] = code;
            if (c->channel != SVO_NONE) memmove(normals(c) + 3 * n, normals(c) + 3 * i, 3 * sizeof(float));
            counts(c)[n++] = counts(c)[i];
        }
    }
    c->count = n;
    c->shift += c->level - level;
    c->level = level;
}

/* The coarsest level whose cells are at most omega/2 of the longest side of what is occupied. */
static svo_result choose_level(cells *c, double omega, uint32_t depth, svo_error *err)
{
    uint32_t low[3] = {UINT32_MAX, UINT32_MAX, UINT32_MAX}, high[3] = {0}, side = 0;
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t p[3];
        svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
        for (int k = 0; k < 3; k++) {
            low[k] = p[k] < low[k] ? p[k] : low[k];
            high[k] = p[k] + 1 > high[k] ? p[k] + 1 : high[k];
        }
    }
    for (int k = 0; k < 3; k++) side = high[k] - low[k] > side ? high[k] - low[k] : side;
    double cell = 1.0 / side; /* in units, about */
    if (cell > omega / 2 && c->level < depth)
        return svo_fail(err, SVO_LIMIT, "omega %g needs voxels of level %u and finer, which is beyond the limit of %d levels; choose at least %.3g", omega,
                        c->level + 1, MAX_LEVEL, 2 * cell);
    uint32_t level = c->level;
    while (level > 0 && 2 * cell <= omega / 2) {
        cell *= 2;
        level--;
    }
    coarsen(c, level);
    return SVO_OK;
}

/* --- outside ------------------------------------------------------------------------------------------------------ */

/* Bits of an n^3 grid, rows of words along x. */
typedef struct bits {
    uint32_t n, words;
    uint64_t last;      /* valid bits of a row's last word */
    uint64_t *occupied, *outside;
} bits;

static inline uint64_t *row(const bits *b, uint64_t *set, uint32_t y, uint32_t z) { return set + ((uint64_t)z * b->n + y) * b->words; }
static inline bool is_outside(const bits *b, uint32_t x, uint32_t y, uint32_t z)
{
    if (x >= b->n || y >= b->n || z >= b->n) return true; /* -1 wraps */
    return row(b, b->outside, y, z)[x >> 6] >> (x & 63) & 1;
}

static uint64_t flood_up(uint64_t seed, uint64_t through)
{
    for (int s = 1; s < 64; s *= 2) {
        seed |= through & seed << s;
        through &= through << s;
    }
    return seed;
}
static uint64_t flood_down(uint64_t seed, uint64_t through)
{
    for (int s = 1; s < 64; s *= 2) {
        seed |= through & seed >> s;
        through &= through >> s;
    }
    return seed;
}

/* Bring what is outside in the rows around into this row and along it; true when the row grew. */
static bool flood_row(const bits *b, uint32_t y, uint32_t z)
{
    uint64_t *to = row(b, b->outside, y, z);
    const uint64_t *filled = row(b, b->occupied, y, z);
    const uint64_t *near[4] = {y > 0 ? row(b, b->outside, y - 1, z) : NULL, y + 1 < b->n ? row(b, b->outside, y + 1, z) : NULL,
                               z > 0 ? row(b, b->outside, y, z - 1) : NULL, z + 1 < b->n ? row(b, b->outside, y, z + 1) : NULL};
    bool border = y == 0 || z == 0 || y + 1 == b->n || z + 1 == b->n, grew = false;
    uint64_t carry = 1; /* beyond the grid all is outside */
    for (uint32_t w = 0; w < b->words; w++) {
        uint64_t empty = ~filled[w] & (w + 1 == b->words ? b->last : UINT64_MAX), seed = to[w] | carry;
        for (int k = 0; k < 4; k++)
            if (near[k] != NULL) seed |= near[k][w];
        if (border) seed = UINT64_MAX;
        seed = flood_up(seed & empty, empty);
        grew |= seed != to[w];
        to[w] = seed;
        carry = seed >> 63;
    }
    carry = b->last & ~(b->last >> 1); /* the last valid bit */
    for (uint32_t w = b->words; w-- > 0;) {
        uint64_t empty = ~filled[w] & (w + 1 == b->words ? b->last : UINT64_MAX);
        uint64_t seed = flood_down((to[w] | carry) & empty, empty);
        grew |= seed != to[w];
        to[w] = seed;
        carry = seed << 63;
    }
    return grew;
}

static void flood(const bits *b)
{
    for (bool grew = true; grew;) {
        grew = false;
        for (uint32_t z = 0; z < b->n; z++)
            for (uint32_t y = 0; y < b->n; y++) grew |= flood_row(b, y, z);
        for (uint32_t z = b->n; z-- > 0;)
            for (uint32_t y = b->n; y-- > 0;) grew |= flood_row(b, y, z);
    }
}

/* --- boundary ----------------------------------------------------------------------------------------------------- */

static const uint32_t side_step[6][3] = {{UINT32_MAX, 0, 0}, {1, 0, 0}, {0, UINT32_MAX, 0}, {0, 1, 0}, {0, 0, UINT32_MAX}, {0, 0, 1}};
static const uint32_t side_corner[6][4][3] = {
    {{0, 0, 0}, {0, 0, 1}, {0, 1, 1}, {0, 1, 0}}, {{1, 0, 0}, {1, 1, 0}, {1, 1, 1}, {1, 0, 1}}, {{0, 0, 0}, {1, 0, 0}, {1, 0, 1}, {0, 0, 1}},
    {{0, 1, 0}, {0, 1, 1}, {1, 1, 1}, {1, 1, 0}}, {{0, 0, 0}, {0, 1, 0}, {1, 1, 0}, {1, 0, 0}}, {{0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}},
};

/* --- gaps ---------------------------------------------------------------------------------------------------------- */

#define FACING 0.35 /* least cosine of a normal and the way to the other voxel */
#define CERTAIN 0.3 /* length of a cell's mean normal from which on it says something */

static uint64_t find_cell(const cells *c, uint32_t code)
{
    uint64_t low = 0, high = c->count;
    while (low < high) {
        uint64_t middle = (low + high) / 2;
        if (codes(c)[middle] < code) low = middle + 1;
        else high = middle;
    }
    return low < c->count && codes(c)[low] == code ? low : UINT64_MAX;
}

/* Do the normals of two cells that touch face each other, d the way from a to b in cells? Those of a thin part face away from each other. */
static bool facing(const cells *c, uint64_t a, uint64_t b, const int d[3])
{
    double x = 0, y = 0, aa = 0, bb = 0, dd = 0;
    for (uint64_t k = 0; k < 3; k++) {
        const double p = normals(c)[3 * a + k], q = normals(c)[3 * b + k];
        x += p * d[k];
        y += q * d[k];
        aa += p * p;
        bb += q * q;
        dd += d[k] * d[k];
    }
    const double na = counts(c)[a], nb = counts(c)[b];
    if (!(aa > CERTAIN * CERTAIN * na * na) || !(bb > CERTAIN * CERTAIN * nb * nb)) return false;
    return x >= FACING * sqrt(aa * dd) && y <= -FACING * sqrt(bb * dd);
}

/* --- boundary of sheets ----------------------------------------------------------------------------------------------- */

/* The sides of boundary at one corner of the grid: those between the 8 cells around it, number 3 k + a for the one of cell k (bits x + 2 y + 4 z) across axis a; group[]: the lowest of those it
 * hangs together with around the corner, 24 where there is no boundary. Several groups are several vertices: so the surface is closed and simple also where cells touch at an edge or a corner. */
typedef struct star { uint8_t group[24], groups, solid, open[8]; /* bit y of open[x]: boundary between cells x and y */ } star;

static void join_sides(star *s, uint32_t x, uint32_t y)
{
    const uint8_t a = s->group[x], b = s->group[y];
    if (a == b) return;
    for (int i = 0; i < 24; i++)
        if (s->group[i] == (a > b ? a : b)) s->group[i] = a > b ? b : a;
    s->groups--;
}

/* The four cells around an edge of the corner, on axis a and its lower or upper half, are a ring. A run of solid ones with no boundary between them that begins with the i-th has a side at both
 * ends, which hang together; false where none begins there. */
static bool run_at(const star *s, uint32_t a, uint32_t half, uint32_t i, uint32_t two[2])
{
    const uint32_t u = (a + 1) % 3, v = (a + 2) % 3, low = half << a, ring[4] = {low, low | 1u << u, low | 1u << u | 1u << v, low | 1u << v};
    const uint32_t x = ring[i], before = ring[(i + 3) % 4];
    if ((s->solid >> x & 1) == 0 || (s->open[x] >> before & 1) == 0) return false;
    uint32_t end = i;
    while ((s->open[ring[end % 4]] >> ring[(end + 1) % 4] & 1) == 0) end++;
    two[0] = 3 * x + (i % 2 != 0 ? u : v); /* axes of the ways to the cells before and after */
    two[1] = 3 * ring[end % 4] + (end % 2 == 0 ? u : v);
    return true;
}

static void look_around(const cells *c, const bits *b, const uint32_t corner[3], star *s)
{
    uint32_t solid = 0;
    uint8_t *open = s->open;
    uint64_t at[8];
    s->groups = 0;
    for (uint32_t k = 0; k < 8; k++) {
        const uint32_t p[3] = {corner[0] - 1 + (k & 1), corner[1] - 1 + (k >> 1 & 1), corner[2] - 1 + (k >> 2)};
        at[k] = UINT64_MAX;
        if (is_outside(b, p[0], p[1], p[2])) continue;
        solid |= 1u << k;
        if (c->channel != SVO_NONE) at[k] = find_cell(c, (uint32_t)svo_morton_encode(p[0], p[1], p[2]));
    }
    for (uint32_t k = 0; k < 8; k++) {
        open[k] = 0;
        for (uint32_t a = 0; a < 3; a++) {
            const uint32_t y = k ^ 1u << a;
            bool side = (solid >> k & 1) != 0 && (solid >> y & 1) == 0;
            if ((solid >> k & 1) != 0 && (solid >> y & 1) != 0 && at[k] != UINT64_MAX && at[y] != UINT64_MAX) {
                int d[3] = {0, 0, 0};
                d[a] = (y >> a & 1) != 0 ? 1 : -1;
                side = facing(c, at[k], at[y], d);
            }
            s->group[3 * k + a] = side ? (uint8_t)(3 * k + a) : 24;
            s->groups += side;
            if (side) open[k] |= (uint8_t)(1u << y);
        }
    }
    s->solid = (uint8_t)solid;
    for (uint32_t a = 0; a < 3; a++)
        for (uint32_t half = 0; half < 2; half++)
            for (uint32_t i = 0, two[2]; i < 4; i++)
                if (run_at(s, a, half, i, two)) join_sides(s, two[0], two[1]);
}

/* Around the edge of the corner on axis a (half 1: upwards): how many runs there are, and the number of the one that has this side. */
static uint32_t runs_at(const star *s, uint32_t a, uint32_t half, uint32_t side, uint32_t *mine)
{
    uint32_t runs = 0;
    for (uint32_t i = 0, two[2]; i < 4; i++) {
        if (!run_at(s, a, half, i, two)) continue;
        if (two[0] == side || two[1] == side) *mine = i;
        runs++;
    }
    return runs;
}

/* Corners of the grid that the boundary uses, by number of the corner and group of sides: 0, or where there are several, one more than the first side. */
typedef struct corners {
    uint64_t *key;   /* UINT64_MAX = empty slot */
    uint32_t *index;
    uint64_t mask;
    uint32_t count;
    uint32_t side; /* n + 1 */
} corners;

static uint64_t corner_slot(const corners *c, uint64_t key)
{
    uint64_t h = key * 0x9e3779b97f4a7c15ull, i = (h ^ h >> 32) & c->mask;
    while (c->key[i] != UINT64_MAX && c->key[i] != key) i = (i + 1) & c->mask;
    return i;
}

static uint64_t corner_key(const corners *c, const uint32_t at[3], const star *s, uint32_t side)
{
    return 32 * (((uint64_t)at[2] * c->side + at[1]) * c->side + at[0]) + (s->groups > 1 ? 1 + s->group[side] : 0);
}

/* Number of a cell among the 8 around a corner. */
static uint32_t cell_at(const uint32_t cell[3], const uint32_t corner[3])
{
    return (cell[0] + 1 - corner[0]) | (cell[1] + 1 - corner[1]) << 1 | (cell[2] + 1 - corner[2]) << 2;
}

typedef struct boundary {
    corners corner;
    double *position;
    uint32_t *triangle;
    uint64_t points, triangles;
} boundary;

/* Is there boundary between a cell and the one beside it on this side? */
static bool is_side(const cells *c, const bits *b, uint64_t cell, const uint32_t p[3], int s)
{
    const uint32_t q[3] = {p[0] + side_step[s][0], p[1] + side_step[s][1], p[2] + side_step[s][2]};
    if (is_outside(b, q[0], q[1], q[2])) return true;
    if (c->channel == SVO_NONE) return false;
    const uint64_t other = find_cell(c, (uint32_t)svo_morton_encode(q[0], q[1], q[2]));
    const int d[3] = {(int)side_step[s][0], (int)side_step[s][1], (int)side_step[s][2]};
    return other != UINT64_MAX && facing(c, cell, other, d);
}

static uint64_t count_quads(const cells *c, const bits *b)
{
    uint64_t n = 0;
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t p[3];
        svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
        if (i > 0 && codes(c)[i] == codes(c)[i - 1]) continue;
        for (int s = 0; s < 6; s++) n += is_side(c, b, i, p, s);
    }
    return n;
}

#define EDGE_KEY ((uint64_t)1 << 60)

/* Groups of sides draw back from each other by up to a quarter of a cell. */
static void draw_back(const star *s, uint32_t side, double where[3])
{
    double moved[3] = {0, 0, 0}, members = 0;
    for (uint32_t m = 0; m < 24; m++) {
        if (s->group[m] != s->group[side]) continue;
        members++;
        for (int e = 0; e < 3; e++) moved[e] += (m / 3 >> e & 1) != 0 ? 0.25 : -0.25;
    }
    for (int e = 0; e < 3; e++) where[e] += moved[e] / members;
}

static uint32_t corner_index(boundary *out, uint64_t key, const double at[3], const double *to_world, double scale)
{
    const uint64_t slot = corner_slot(&out->corner, key);
    if (out->corner.key[slot] == UINT64_MAX) {
        out->corner.key[slot] = key;
        out->corner.index[slot] = out->corner.count++;
        for (int e = 0; e < 3; e++)
            out->position[3 * out->points + (uint64_t)e] = to_world[4 * e] * at[0] * scale + to_world[4 * e + 1] * at[1] * scale + to_world[4 * e + 2] * at[2] * scale + to_world[4 * e + 3];
        out->points++;
    }
    return out->corner.index[slot];
}

/* Only occupied cells have sides to the outside: a filled hole is enclosed by them. */
static svo_result make_boundary(skeli_pool *pool, const cells *c, const bits *b, const double *to_world, uint64_t max_vertices, boundary *out,
                                svo_error *err)
{
    uint64_t quads = count_quads(c, b), capacity = 64;
    if (quads > 2 * max_vertices)
        return svo_fail(err, SVO_LIMIT, "the voxels have %llu outer sides at level %u, more than %llu; choose a larger omega or raise the limit on vertices",
                        (unsigned long long)quads, c->level, (unsigned long long)(2 * max_vertices));
    while (capacity < 8 * quads) capacity *= 2; /* at most 8 points a quad, mostly 1 */
    out->corner = (corners){.mask = capacity - 1, .side = b->n + 1};
    out->corner.key = skeli_take(pool, capacity, sizeof *out->corner.key);
    out->corner.index = skeli_take(pool, capacity, sizeof *out->corner.index);
    out->position = skeli_take(pool, 3 * 9 * quads, sizeof *out->position);
    out->triangle = skeli_take(pool, 24 * quads, sizeof *out->triangle);
    if (out->corner.key == NULL || out->corner.index == NULL || out->position == NULL || out->triangle == NULL) return skeli_no_memory(err);
    memset(out->corner.key, 0xff, capacity * sizeof *out->corner.key);
    double scale = ldexp(1, (int)c->shift);
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t p[3];
        if (i > 0 && codes(c)[i] == codes(c)[i - 1]) continue;
        svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
        for (int s = 0; s < 6; s++) {
            if (!is_side(c, b, i, p, s)) continue;
            uint32_t q[8], n = 0;
            for (int k = 0; k < 4; k++) {
                uint32_t at[3], to[3], axis = 0, run = 0;
                for (int e = 0; e < 3; e++) {
                    at[e] = p[e] + side_corner[s][k][e];
                    to[e] = p[e] + side_corner[s][(k + 1) % 4][e];
                    if (at[e] != to[e]) axis = (uint32_t)e;
                }
                star around;
                look_around(c, b, at, &around);
                const uint32_t side = 3 * cell_at(p, at) + (uint32_t)s / 2, half = to[axis] > at[axis];
                double where[3] = {at[0], at[1], at[2]};
                if (around.groups > 1) draw_back(&around, side, where);
                q[n++] = corner_index(out, corner_key(&out->corner, at, &around, side), where, to_world, scale);
                if (runs_at(&around, axis, half, side, &run) < 2) continue;
                /* cells touch at this edge: it gets a point for each run, so that it is no edge of both */
                for (int e = 0; e < 3; e++) where[e] = (at[e] + to[e]) / 2.0;
                const uint32_t u = (axis + 1) % 3, v = (axis + 2) % 3, *first = half != 0 ? at : to;
                where[u] += run == 0 || run == 3 ? -0.125 : 0.125;
                where[v] += run < 2 ? -0.125 : 0.125;
                q[n++] = corner_index(out, EDGE_KEY + 16 * (((uint64_t)first[2] * out->corner.side + first[1]) * out->corner.side + first[0]) + 4 * axis + run, where, to_world, scale);
            }
            /* with such points, around the middle: a diagonal beside one of them would be an edge of both after all */
            const uint32_t middle = (uint32_t)out->points;
            if (n > 4) {
                for (int e = 0; e < 3; e++) {
                    double sum = 0;
                    for (uint32_t k = 0; k < n; k++) sum += out->position[3 * (uint64_t)q[k] + (uint64_t)e] / n;
                    out->position[3 * out->points + (uint64_t)e] = sum;
                }
                out->points++;
                out->corner.count++;
            }
            for (uint32_t k = 0; k < (n > 4 ? n : 2); k++) {
                const uint32_t three[3] = {n > 4 ? middle : q[0], q[n > 4 ? k : k + 1], q[n > 4 ? (k + 1) % n : k + 2]};
                memcpy(out->triangle + 3 * out->triangles++, three, sizeof three);
            }
        }
    }
    return SVO_OK;
}

/* --- map ---------------------------------------------------------------------------------------------------------- */

static uint32_t nearest_joint(const skel_skeleton *s, const double *centre, const uint32_t *among, uint32_t count)
{
    uint32_t best = SVO_NONE;
    double best2 = INFINITY;
    for (uint32_t k = 0; k < count; k++) {
        uint32_t j = among != NULL ? among[k] : k;
        double d2 = 0;
        for (int e = 0; e < 3; e++) d2 += (s->joints[j].position[e] - centre[e]) * (s->joints[j].position[e] - centre[e]);
        if (d2 < best2 || (d2 == best2 && j < best)) {
            best2 = d2;
            best = j;
        }
    }
    return best;
}

/* Joint of each cell: the nearest of those its corners on the boundary are mapped to. Cells without such a corner take that of the cells
 * they touch, from outside inwards; what touches none, the nearest joint. */
static svo_result map_cells(skeli_pool *pool, const cells *c, const bits *grid, const boundary *b, const double *to_world, const skel_skeleton *s, uint32_t *joint,
                            svo_error *err)
{
    uint32_t *queue = skeli_take(pool, c->count, sizeof *queue);
    if (queue == NULL) return skeli_no_memory(err);
    uint64_t head = 0, tail = 0;
    double scale = ldexp(1, (int)c->shift);
    for (int pass = 0; pass < 2; pass++) {
        for (uint64_t i = 0; i < c->count; i++) {
            if (pass == 1 && joint[i] != SVO_NONE) continue;
            uint32_t p[3], among[24], n = 0;
            svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
            double centre[3];
            for (int e = 0; e < 3; e++)
                centre[e] = (to_world[4 * e] * (p[0] + 0.5) + to_world[4 * e + 1] * (p[1] + 0.5) + to_world[4 * e + 2] * (p[2] + 0.5)) * scale + to_world[4 * e + 3];
            for (uint32_t k = 0; k < 8 && pass == 0; k++) {
                const uint32_t at[3] = {p[0] + (k & 1), p[1] + (k >> 1 & 1), p[2] + (k >> 2)};
                star around;
                look_around(c, grid, at, &around);
                for (uint32_t a = 0; a < 3; a++) {
                    const uint32_t side = 3 * cell_at(p, at) + a;
                    if (around.group[side] == 24) continue;
                    const uint64_t slot = corner_slot(&b->corner, corner_key(&b->corner, at, &around, side));
                    if (b->corner.key[slot] != UINT64_MAX && s->map[b->corner.index[slot]] != SVO_NONE) among[n++] = s->map[b->corner.index[slot]];
                }
            }
            joint[i] = pass == 1 ? nearest_joint(s, centre, NULL, s->joint_count) : n > 0 ? nearest_joint(s, centre, among, n) : SVO_NONE;
            if (joint[i] != SVO_NONE && pass == 0) queue[tail++] = (uint32_t)i;
        }
        while (pass == 0 && head < tail) {
            uint64_t i = queue[head++];
            uint32_t p[3];
            svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
            for (int side = 0; side < 6; side++) {
                uint32_t x = p[0] + side_step[side][0], y = p[1] + side_step[side][1], z = p[2] + side_step[side][2], n = b->corner.side - 1;
                if (x >= n || y >= n || z >= n) continue;
                uint64_t k = find_cell(c, (uint32_t)svo_morton_encode(x, y, z));
                if (k == UINT64_MAX || joint[k] != SVO_NONE) continue;
                joint[k] = joint[i];
                queue[tail++] = (uint32_t)k;
            }
        }
    }
    return SVO_OK;
}

static svo_result map_voxels(skeli_pool *pool, const cells *c, const bits *grid, const boundary *b, const double *to_world, skel_skeleton *s, svo_error *err)
{
    uint32_t *joint = skeli_take(pool, c->count, sizeof *joint);
    uint32_t *map = svo_alloc(s->allocator, c->total, sizeof *map);
    svo_result result = joint == NULL || map == NULL ? skeli_no_memory(err) : map_cells(pool, c, grid, b, to_world, s, joint, err);
    if (result != SVO_OK) {
        svo_free(s->allocator, map, c->total, sizeof *map);
        return result;
    }
    uint64_t n = 0;
    for (uint64_t i = 0; i < c->count; i++)
        for (uint32_t k = 0; k < counts(c)[i]; k++) map[n++] = joint[i];
    SVO_ASSERT(n == c->total);
    svo_free(s->allocator, s->map, s->map_count, sizeof *s->map);
    s->map = map;
    s->map_count = s->report.input_count = s->report.mapped_count = c->total;
    return SVO_OK;
}

/* --- all ---------------------------------------------------------------------------------------------------------- */

static svo_result build(skeli_pool *pool, const svo_tree_info *info, cells *c, const skel_options *o, skel_skeleton *out, svo_error *err)
{
    double since = svo_seconds();
    SVO_TRY(choose_level(c, o->omega, info->depth, err));
    bits b = {.n = 1u << c->level};
    b.words = (b.n + 63) / 64;
    b.last = b.n % 64 == 0 ? UINT64_MAX : ((uint64_t)1 << b.n % 64) - 1;
    uint64_t size = (uint64_t)b.n * b.n * b.words;
    b.occupied = skeli_take(pool, size, 8);
    b.outside = skeli_take(pool, size, 8);
    if (b.occupied == NULL || b.outside == NULL) return skeli_no_memory(err);
    memset(b.occupied, 0, size * 8);
    memset(b.outside, 0, size * 8);
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t x, y, z;
        svo_morton_decode(codes(c)[i], &x, &y, &z);
        row(&b, b.occupied, y, z)[x >> 6] |= (uint64_t)1 << (x & 63);
    }
    flood(&b);
    boundary edge = {0};
    SVO_TRY(make_boundary(pool, c, &b, info->voxel_to_world, o->max_vertices != 0 ? o->max_vertices : 8000000, &edge, err));
    skeli_give(pool, b.occupied);
    skel_skeleton s;
    double boundary_seconds = svo_seconds() - since;
    SVO_TRY(skeli_pipeline(edge.position, edge.points, edge.triangle, edge.triangles, o, &s, err));
    s.report.source = SKEL_SOURCE_VOXELS;
    s.report.voxel_level = c->level;
    if (s.report.phase_count < SKEL_MAX_PHASES) s.report.phases[s.report.phase_count++] = (skel_phase){"boundary", boundary_seconds};
    s.report.voxel_depth = info->depth;
    svo_result result = map_voxels(pool, c, &b, &edge, info->voxel_to_world, &s, err);
    if (result != SVO_OK) {
        skel_skeleton_free(&s);
        return result;
    }
    *out = s;
    return SVO_OK;
}

svo_result skel_build_voxels(const svo_tree_info *info, const svo_chunk_source *source, const skel_options *options, skel_skeleton *out, svo_error *err)
{
    SVO_TRY(skeli_check_options(options, err));
    cells c = {.allocator = options->allocator};
    c.level = info->depth < MAX_LEVEL ? info->depth : MAX_LEVEL;
    c.shift = info->depth - c.level;
    svo_buffer_init(&c.code, options->allocator);
    svo_buffer_init(&c.voxels, options->allocator);
    svo_buffer_init(&c.normal, options->allocator);
    c.channel = SVO_NONE;
    for (uint32_t k = 0; k < info->channel_count; k++)
        if (info->channels[k].kind == SVO_KIND_NORMAL_OCT32 && !info->channels[k].constant && strcmp(info->channels[k].name, "normal") == 0) c.channel = k;
    skeli_pool pool = {.allocator = options->allocator};
    svo_result result = read_cells(source, &c, err);
    if (result == SVO_OK) result = build(&pool, info, &c, options, out, err);
    skeli_pool_free(&pool);
    svo_buffer_free(&c.code);
    svo_buffer_free(&c.voxels);
    svo_buffer_free(&c.normal);
    return result;
}
