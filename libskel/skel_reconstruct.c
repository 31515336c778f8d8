/* A closed surface from the solid. Voxel sides that look outwards are paired over their edges: where four meet, those of one voxel belong together, so that every edge
 * has two sides and voxels that only touch stay apart; corners are told apart by the same pairing. So the result is closed and without singular edges, whatever the voxels
 * are. Then it is smoothed, and what lies near the model's surface is moved onto it. */
#include <math.h>
#include <string.h>

#include "skel_solid.h"
#include "skeli_solid.h"
#include "svo_morton.h"

enum { SMOOTHING = 6, FAIRING = 12 };
#define NEAR 1.6 /* voxels: the model's surface that far from a corner is what the corner stands for */

/* Side s of a voxel looks along axis s / 2, down or up. Its corners, counter-clockwise from outside, and which edge is where: corner k to k + 1. */
static const uint8_t side_corner[6][4][3] = {
    {{0, 0, 0}, {0, 0, 1}, {0, 1, 1}, {0, 1, 0}}, {{1, 0, 0}, {1, 1, 0}, {1, 1, 1}, {1, 0, 1}}, {{0, 0, 0}, {1, 0, 0}, {1, 0, 1}, {0, 0, 1}},
    {{0, 1, 0}, {0, 1, 1}, {1, 1, 1}, {1, 1, 0}}, {{0, 0, 0}, {0, 1, 0}, {1, 1, 0}, {1, 0, 0}}, {{0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}},
};

typedef struct sides {
    const skel_solid *solid;
    uint64_t count;
    uint64_t *voxel; /* index into codes */
    uint8_t *side;
    uint32_t *first; /* of each voxel: number of its first side; count + 1 */
} sides;

static uint64_t index_of(const skel_solid *s, const uint32_t at[3])
{
    const uint32_t side = 1u << s->depth;
    if (at[0] >= side || at[1] >= side || at[2] >= side) return UINT64_MAX; /* -1 wraps */
    uint64_t code = svo_morton_encode(at[0], at[1], at[2]), low = 0, high = s->count;
    while (low < high) {
        uint64_t middle = low + (high - low) / 2;
        if (s->codes[middle] < code) low = middle + 1;
        else high = middle;
    }
    return low < s->count && s->codes[low] == code ? low : UINT64_MAX;
}

static void step(const uint32_t from[3], int side, uint32_t to[3])
{
    for (int k = 0; k < 3; k++) to[k] = from[k];
    to[side / 2] += side % 2 ? 1 : UINT32_MAX;
}

static svo_result find_sides(skeli_pool *pool, const skel_solid *solid, sides *s, svo_error *err)
{
    *s = (sides){.solid = solid};
    s->first = skeli_take(pool, solid->count + 1, sizeof *s->first);
    if (s->first == NULL) return skeli_no_memory(err);
    for (int pass = 0; pass < 2; pass++) {
        uint64_t n = 0;
        for (uint64_t v = 0; v < solid->count; v++) {
            uint32_t at[3], to[3];
            svo_morton_decode(solid->codes[v], &at[0], &at[1], &at[2]);
            s->first[v] = (uint32_t)n;
            for (int side = 0; side < 6; side++) {
                step(at, side, to);
                if (index_of(solid, to) != UINT64_MAX) continue;
                if (pass == 1) {
                    s->voxel[n] = v;
                    s->side[n] = (uint8_t)side;
                }
                n++;
            }
        }
        if (n > UINT32_MAX / 8) return svo_fail(err, SVO_LIMIT, "the solid has too many outer sides (%llu)", (unsigned long long)n);
        s->first[solid->count] = (uint32_t)n;
        if (pass == 1) continue;
        s->count = n;
        s->voxel = skeli_take(pool, n, sizeof *s->voxel);
        s->side = skeli_take(pool, n, 1);
        if (s->voxel == NULL || s->side == NULL) return skeli_no_memory(err);
    }
    return SVO_OK;
}

static uint32_t number_of(const sides *s, uint64_t voxel, int side)
{
    for (uint32_t i = s->first[voxel]; i < s->first[voxel + 1]; i++)
        if (s->side[i] == side) return i;
    return SVO_NONE;
}

/* The side across edge `edge` (corner edge to edge + 1) of side i. Walking around the edge: the voxel's own other side, unless the neighbour there is solid, then the
 * neighbour's side that goes on flat, unless the voxel diagonally in front is solid, then that one's side that looks back. */
static uint32_t across(const sides *s, uint32_t i, int edge)
{
    int side = s->side[i], axis = side / 2;
    const uint8_t *p = side_corner[side][edge], *q = side_corner[side][(edge + 1) % 4];
    int turn = -1; /* the direction from the side's middle to the edge */
    for (int k = 0; k < 3; k++)
        if (k != axis && p[k] == q[k]) turn = 2 * k + p[k];
    uint32_t at[3], beside[3], front[3];
    svo_morton_decode(s->solid->codes[s->voxel[i]], &at[0], &at[1], &at[2]);
    step(at, turn, beside);
    step(beside, side, front);
    uint64_t neighbour = index_of(s->solid, beside), diagonal = index_of(s->solid, front);
    if (neighbour == UINT64_MAX) return number_of(s, s->voxel[i], turn); /* four sides around an edge: those of one voxel */
    if (diagonal == UINT64_MAX) return number_of(s, neighbour, side);
    return number_of(s, diagonal, turn ^ 1);
}

static svo_result number_corners(skeli_pool *pool, const sides *s, uint32_t *corner, uint64_t *count, svo_error *err)
{
    uint32_t *parent = skeli_take(pool, 4 * s->count, sizeof *parent);
    if (parent == NULL) return skeli_no_memory(err);
    for (uint32_t c = 0; c < 4 * s->count; c++) parent[c] = c;
    for (uint32_t i = 0; i < s->count; i++) {
        uint32_t at[3];
        svo_morton_decode(s->solid->codes[s->voxel[i]], &at[0], &at[1], &at[2]);
        for (int e = 0; e < 4; e++) {
            uint32_t j = across(s, i, e), to[3];
            SVO_ASSERT(j != SVO_NONE);
            svo_morton_decode(s->solid->codes[s->voxel[j]], &to[0], &to[1], &to[2]);
            for (int end = 0; end < 2; end++) {
                const uint8_t *p = side_corner[s->side[i]][(e + end) % 4];
                for (int k = 0; k < 4; k++) {
                    const uint8_t *q = side_corner[s->side[j]][k];
                    if (at[0] + p[0] != to[0] + q[0] || at[1] + p[1] != to[1] + q[1] || at[2] + p[2] != to[2] + q[2]) continue;
                    uint32_t a = skeli_root(parent, 4 * i + (uint32_t)((e + end) % 4)), b = skeli_root(parent, 4 * j + (uint32_t)k);
                    if (a != b) parent[a > b ? a : b] = a > b ? b : a;
                }
            }
        }
    }
    *count = 0;
    for (uint32_t c = 0; c < 4 * s->count; c++) corner[c] = skeli_root(parent, c) == c ? (uint32_t)(*count)++ : corner[skeli_root(parent, c)];
    skeli_give(pool, parent);
    return SVO_OK;
}

/* One round over the edges: every chosen vertex goes a part of the way to the mean of its neighbours. */
static void relax(const uint32_t *corner, uint64_t quads, uint64_t vertices, double part, const uint8_t *only, double *position, double *sum)
{
    memset(sum, 0, 4 * vertices * sizeof *sum);
    for (uint64_t i = 0; i < quads; i++)
        for (int e = 0; e < 4; e++) { /* every edge is met from both sides, so once in each direction */
            const uint64_t a = corner[4 * i + (uint64_t)e], b = corner[4 * i + (uint64_t)((e + 1) % 4)];
            sum[4 * a] += 1;
            for (int k = 0; k < 3; k++) sum[4 * a + 1 + (uint64_t)k] += position[3 * b + (uint64_t)k];
        }
    for (uint64_t v = 0; v < vertices; v++) {
        if (only != NULL && !only[v]) continue;
        for (uint64_t k = 0; k < 3; k++) position[3 * v + k] += part * (sum[4 * v + 1 + k] / sum[4 * v] - position[3 * v + k]);
    }
}

static svo_result shape(skeli_pool *pool, const skeli_surface *surface, const sides *s, double edge, const uint32_t *corner, uint64_t vertices, double *position, skel_closed *out,
                        svo_error *err)
{
    const double half = ldexp(1, (int)s->solid->depth - 1);
    double *sum = skeli_take(pool, 4 * vertices, sizeof *sum);
    if (sum == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < s->count; i++) {
        uint32_t at[3];
        svo_morton_decode(s->solid->codes[s->voxel[i]], &at[0], &at[1], &at[2]);
        for (uint64_t k = 0; k < 4; k++)
            for (uint64_t e = 0; e < 3; e++) position[3 * (uint64_t)corner[4 * i + k] + e] = (at[e] + (double)side_corner[s->side[i]][k][e] - half) * edge;
    }
    for (int i = 0; i < SMOOTHING; i++) relax(corner, s->count, vertices, 0.5, NULL, position, sum);
    for (uint64_t v = 0; v < vertices; v++) {
        double near[3], *p = position + 3 * v;
        out->invented[v] = !(skeli_surface_distance(surface, p, NEAR * edge, near) < NEAR * edge);
        out->invented_count += out->invented[v];
        if (!out->invented[v]) memcpy(p, near, sizeof near);
    }
    for (int i = 0; i < FAIRING; i++) relax(corner, s->count, vertices, 0.5, out->invented, position, sum);
    skeli_give(pool, sum);
    return SVO_OK;
}

/* Where parts of the solid touch along an edge, two pairs of sides may have the same two corners there. Each such pair gets a vertex of its own in the middle of its edge, so that no
 * two edges are between the same vertices. middle[4 * side + edge]: its number, from `vertices` on, or SVO_NONE. */
static svo_result split_shared(skeli_pool *pool, const sides *s, const uint32_t *corner, uint64_t vertices, uint32_t *middle, uint64_t *count, svo_error *err)
{
    const uint64_t n = 4 * s->count;
    uint64_t *key = skeli_take(pool, n, sizeof *key);
    uint32_t *order = skeli_take(pool, n, sizeof *order), *scratch = skeli_take(pool, n, sizeof *scratch);
    if (key == NULL || order == NULL || scratch == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < n; i++) {
        key[i] = (uint64_t)corner[i] << 32 | corner[i / 4 * 4 + (i + 1) % 4];
        order[i] = (uint32_t)i;
        middle[i] = SVO_NONE;
    }
    skeli_sort_by64(order, scratch, n, key, 64);
    *count = 0;
    for (uint64_t i = 0; i < n; i++) {
        bool twice = (i > 0 && key[order[i - 1]] == key[order[i]]) || (i + 1 < n && key[order[i + 1]] == key[order[i]]);
        if (!twice || middle[order[i]] != SVO_NONE) continue;
        const uint64_t edge = order[i], a = corner[edge], b = corner[edge / 4 * 4 + (edge + 1) % 4];
        const uint64_t other = 4 * (uint64_t)across(s, (uint32_t)(edge / 4), (int)(edge % 4));
        for (uint64_t e = 0; e < 4; e++) /* the other side's edge runs the other way */
            if (corner[other + e] == b && corner[other + (e + 1) % 4] == a) middle[other + e] = (uint32_t)(vertices + *count);
        middle[edge] = (uint32_t)(vertices + (*count)++);
    }
    skeli_give(pool, key);
    skeli_give(pool, order);
    skeli_give(pool, scratch);
    return SVO_OK;
}

/* A side as triangles, with the vertices in the middle of its edges. Returns how many. */
static uint32_t triangles_of(const uint32_t *corner, const uint32_t *middle, uint32_t out[6][3])
{
    uint32_t ring[8], n = 0, start = 0;
    for (int e = 0; e < 4; e++) {
        ring[n++] = corner[e];
        if (middle[e] == SVO_NONE) continue;
        start = n; /* all triangles meet in a vertex of its own, so no diagonal is between two corners that others share */
        ring[n++] = middle[e];
    }
    for (uint32_t t = 0; t + 2 < n; t++)
        for (uint32_t k = 0; k < 3; k++) out[t][k] = ring[(start + (k > 0 ? t + k : 0)) % n];
    return n - 2;
}

static svo_result build(skeli_pool *pool, const skeli_surface *surface, const skel_skeleton *k, skel_closed *out, svo_error *err)
{
    sides s;
    SVO_TRY(find_sides(pool, &k->solid, &s, err));
    uint32_t *corner = skeli_take(pool, 4 * s.count, sizeof *corner);
    if (corner == NULL) return skeli_no_memory(err);
    uint64_t corners = 0, middles = 0;
    uint32_t *middle = skeli_take(pool, 4 * s.count, sizeof *middle);
    if (middle == NULL) return skeli_no_memory(err);
    SVO_TRY(number_corners(pool, &s, corner, &corners, err));
    SVO_TRY(split_shared(pool, &s, corner, corners, middle, &middles, err));
    out->vertex_count = corners + middles;
    out->triangle_count = 2 * (s.count + middles); /* a middle is on two sides */
    out->position = svo_alloc(out->allocator, 3 * out->vertex_count, sizeof *out->position);
    out->corner = svo_alloc(out->allocator, 3 * out->triangle_count, sizeof *out->corner);
    out->invented = svo_calloc(out->allocator, out->vertex_count, 1);
    if (out->position == NULL || out->corner == NULL || out->invented == NULL) return skeli_no_memory(err);
    const skel_report *r = &k->report;
    SVO_TRY(shape(pool, surface, &s, k->solid.voxel_to_world[0] / r->unit * SKEL_LATTICE, corner, corners, out->position, out, err));
    uint64_t n = 0;
    for (uint64_t i = 0; i < s.count; i++) {
        uint32_t t[6][3];
        for (uint64_t e = 0; e < 4; e++) {
            const uint64_t m = middle[4 * i + e], a = corner[4 * i + e], b = corner[4 * i + (e + 1) % 4];
            for (uint64_t x = 0; m != SVO_NONE && x < 3; x++) out->position[3 * m + x] = (out->position[3 * a + x] + out->position[3 * b + x]) / 2;
            if (m != SVO_NONE) out->invented[m] = out->invented[a] & out->invented[b];
        }
        uint32_t made = triangles_of(corner + 4 * i, middle + 4 * i, t);
        SVO_ASSERT(n + made <= out->triangle_count);
        memcpy(out->corner + 3 * n, t, made * sizeof *t);
        n += made;
    }
    SVO_ASSERT(n == out->triangle_count);
    for (uint64_t v = corners; v < out->vertex_count; v++) out->invented_count += out->invented[v];
    for (uint64_t i = 0; i < 3 * out->vertex_count; i++) out->position[i] = r->centre[i % 3] + r->unit * (out->position[i] / SKEL_LATTICE);
    return SVO_OK;
}

enum { MEASURED = 20000 };

/* How far the model's vertices are from what was made of them. */
static svo_result measure(skeli_pool *pool, const skeli_soup *model, const skel_report *r, skel_closed *c, svo_error *err)
{
    skeli_soup closed;
    skeli_surface tree;
    uint64_t dropped, step = model->vertex_count / MEASURED + 1, n = 0;
    int32_t *lattice = skeli_take(pool, 3 * c->vertex_count, sizeof *lattice);
    uint32_t *remap = skeli_take(pool, c->vertex_count, sizeof *remap);
    if (lattice == NULL || remap == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < 3 * c->vertex_count; i++) lattice[i] = (int32_t)rint((c->position[i] - r->centre[i % 3]) / r->unit * SKEL_LATTICE);
    SVO_TRY(skeli_canonical(pool, lattice, c->vertex_count, c->corner, c->triangle_count, &closed, remap, &dropped, err));
    SVO_TRY(skeli_surface_tree(pool, &closed, &tree, err));
    for (uint64_t v = 0; v < model->vertex_count; v += step) {
        const int32_t *q = model->position + 3 * v;
        const double p[3] = {q[0], q[1], q[2]}, d = skeli_surface_distance(&tree, p, 4.0 * SKEL_LATTICE, NULL) * (r->unit / SKEL_LATTICE);
        c->distance_mean += d;
        c->distance_max = fmax(c->distance_max, d);
        n++;
    }
    c->distance_mean /= (double)n;
    return SVO_OK;
}

svo_result skeli_reconstruct(const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles, const skel_skeleton *k, const svo_allocator *a, skel_closed *out,
                             svo_error *err)
{
    if (k->solid.count == 0) return svo_fail(err, SVO_INVALID_ARGUMENT, "the skeleton was built without a solid");
    skeli_pool pool = {.allocator = a};
    skel_closed c = {.allocator = a};
    skel_report r = {.normalize = k->report.normalize};
    skeli_soup soup;
    skeli_surface surface = {0};
    uint32_t *remap = skeli_take(&pool, points, sizeof *remap);
    svo_result result = remap == NULL ? skeli_no_memory(err) : skeli_soup_make(&pool, position, points, corner, triangles, &r, &soup, remap, err);
    if (result == SVO_OK) result = skeli_surface_tree(&pool, &soup, &surface, err);
    if (result == SVO_OK) result = build(&pool, &surface, k, &c, err);
    if (result == SVO_OK && c.triangle_count > 0) result = measure(&pool, &soup, &k->report, &c, err);
    skeli_pool_free(&pool);
    if (result == SVO_OK) *out = c;
    else skel_closed_free(&c);
    return result;
}

void skel_closed_free(skel_closed *c)
{
    svo_free(c->allocator, c->position, 3 * c->vertex_count, sizeof *c->position);
    svo_free(c->allocator, c->corner, 3 * c->triangle_count, sizeof *c->corner);
    svo_free(c->allocator, c->invented, c->vertex_count, 1);
    memset(c, 0, sizeof *c);
}
