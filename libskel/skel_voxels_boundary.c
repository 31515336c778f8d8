/* The closed surface around the cells of an octree's level: what cannot be reached from outside is filled, and sides between cells and the outside become quads that are
 * welded at the corners of the grid. Where voxels have normals, those of neighbours that face each other say that there is a gap between them which is narrower than the voxels: there the
 * boundary passes between them. */
#include "skeli_voxels.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"

/* --- outside ------------------------------------------------------------------------------------------------------ */

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

static const uint32_t side_corner[6][4][3] = {
    {{0, 0, 0}, {0, 0, 1}, {0, 1, 1}, {0, 1, 0}}, {{1, 0, 0}, {1, 1, 0}, {1, 1, 1}, {1, 0, 1}}, {{0, 0, 0}, {1, 0, 0}, {1, 0, 1}, {0, 0, 1}},
    {{0, 1, 0}, {0, 1, 1}, {1, 1, 1}, {1, 1, 0}}, {{0, 0, 0}, {0, 1, 0}, {1, 1, 0}, {1, 0, 0}}, {{0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}},
};

/* --- gaps ---------------------------------------------------------------------------------------------------------- */

#define FACING 0.35 /* least cosine of a normal and the way to the other voxel */
#define CERTAIN 0.3 /* length of a cell's mean normal from which on it says something */

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

/* Is there boundary between two cells that are both solid? */
static bool is_gap(const star *s)
{
    for (uint32_t k = 0; k < 8; k++)
        if ((s->open[k] & s->solid) != 0) return true;
    return false;
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

static uint32_t corner_index(boundary *out, uint64_t key, const double at[3])
{
    const uint64_t slot = corner_slot(&out->corner, key);
    if (out->corner.key[slot] == UINT64_MAX) {
        out->corner.key[slot] = key;
        out->corner.index[slot] = out->corner.count++;
        memcpy(out->position + 3 * out->points, at, 3 * sizeof *at);
        out->points++;
    }
    return out->corner.index[slot];
}

/* Points of a quad: the normal of its cell, and the way that its side faces. */
static void add_normals(const cells *c, uint64_t cell, int s, const uint32_t *q, uint32_t n, boundary *out)
{
    float length2 = 0;
    for (uint64_t e = 0; e < 3; e++) length2 += normals(c)[3 * cell + e] * normals(c)[3 * cell + e];
    const float least = (float)CERTAIN * (float)counts(c)[cell], by = length2 > least * least ? 1 / sqrtf(length2) : 0;
    for (uint32_t k = 0; k < n; k++) {
        float *to = out->normal + 6 * (uint64_t)q[k];
        for (uint64_t e = 0; e < 3; e++) {
            to[e] += by * normals(c)[3 * cell + e];
            to[3 + e] += (float)(int32_t)side_step[s][e];
        }
    }
}

/* Only occupied cells have sides to the outside: a filled hole is enclosed by them. */
static svo_result make_boundary(skeli_pool *pool, const cells *c, const bits *b, uint64_t max_vertices, boundary *out, svo_error *err)
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
    if (c->channel != SVO_NONE) {
        out->normal = skeli_take(pool, 6 * 9 * quads, sizeof *out->normal);
        if (out->normal == NULL) return skeli_no_memory(err);
        memset(out->normal, 0, 6 * 9 * quads * sizeof *out->normal);
    }
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t p[3];
        if (i > 0 && codes(c)[i] == codes(c)[i - 1]) continue;
        svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
        for (int s = 0; s < 6; s++) {
            if (!is_side(c, b, i, p, s)) continue;
            uint32_t q[9], n = 0;
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
                q[n++] = corner_index(out, corner_key(&out->corner, at, &around, side), where);
                if (c->channel != SVO_NONE && is_gap(&around)) out->normal[6 * (uint64_t)q[n - 1]] = NAN; /* stays where it is */
                if (runs_at(&around, axis, half, side, &run) < 2) continue;
                /* cells touch at this edge: it gets a point for each run, so that it is no edge of both */
                for (int e = 0; e < 3; e++) where[e] = (at[e] + to[e]) / 2.0;
                const uint32_t u = (axis + 1) % 3, v = (axis + 2) % 3, *first = half != 0 ? at : to;
                where[u] += run == 0 || run == 3 ? -0.125 : 0.125;
                where[v] += run < 2 ? -0.125 : 0.125;
                q[n++] = corner_index(out, EDGE_KEY + 16 * (((uint64_t)first[2] * out->corner.side + first[1]) * out->corner.side + first[0]) + 4 * axis + run, where);
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
                q[n] = middle;
            }
            if (c->channel != SVO_NONE) add_normals(c, i, s, q, n > 4 ? n + 1 : n, out);
            for (uint32_t k = 0; k < (n > 4 ? n : 2); k++) {
                const uint32_t three[3] = {n > 4 ? middle : q[0], q[n > 4 ? k : k + 1], q[n > 4 ? (k + 1) % n : k + 2]};
                memcpy(out->triangle + 3 * out->triangles++, three, sizeof three);
            }
        }
    }
    return SVO_OK;
}

svo_result skeli_voxels_boundary(skeli_pool *pool, const cells *c, const double *to_world, uint64_t max_vertices, bits *grid, boundary *out, svo_error *err)
{
    bits b = {.n = 1u << c->level};
    b.words = (b.n + 63) / 64;
    b.last = b.n % 64 == 0 ? UINT64_MAX : ((uint64_t)1 << b.n % 64) - 1;
    const uint64_t size = (uint64_t)b.n * b.n * b.words;
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
    SVO_TRY(make_boundary(pool, c, &b, max_vertices, out, err));
    if (c->channel != SVO_NONE) skeli_voxels_fit(&b, out);
    skeli_give(pool, out->normal);
    out->normal = NULL;
    const double scale = ldexp(1, (int)c->shift);
    for (uint64_t i = 0; i < out->points; i++) {
        double *p = out->position + 3 * i;
        const double at[3] = {p[0], p[1], p[2]};
        for (int e = 0; e < 3; e++) p[e] = to_world[4 * e] * at[0] * scale + to_world[4 * e + 1] * at[1] * scale + to_world[4 * e + 2] * at[2] * scale + to_world[4 * e + 3];
    }
    skeli_give(pool, b.occupied);
    b.occupied = NULL;
    *grid = b;
    return SVO_OK;
}

uint32_t skeli_voxels_points(const cells *c, const bits *grid, const boundary *b, const uint32_t p[3], uint32_t points[24])
{
    uint32_t n = 0;
    for (uint32_t k = 0; k < 8; k++) {
        const uint32_t at[3] = {p[0] + (k & 1), p[1] + (k >> 1 & 1), p[2] + (k >> 2)};
        star around;
        look_around(c, grid, at, &around);
        for (uint32_t a = 0; a < 3; a++) {
            const uint32_t side = 3 * cell_at(p, at) + a;
            if (around.group[side] == 24) continue;
            const uint64_t slot = corner_slot(&b->corner, corner_key(&b->corner, at, &around, side));
            if (b->corner.key[slot] != UINT64_MAX) points[n++] = b->corner.index[slot];
        }
    }
    return n;
}
