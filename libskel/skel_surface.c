/* The model's surface: nearest point and rays through a tree of boxes over the welded triangles, inside by the winding numbers of libsvo. */
#include "skeli_surface.h"

#include <math.h>
#include <string.h>

enum { LEAF = 4, FOUR = 4 * (6 + 5) /* boxes and slabs */, SLAB_LEVELS = 5, GRID_DEPTH = 12 /* 2^20 lattice steps over two units */ };

#define SLAB_SLACK 16.0 /* lattice steps: more than what rounding of normals and planes to floats makes of a distance */

/* --- tree --------------------------------------------------------------------------------------------------------- */

static void grow(float *box, const float *p)
{
    for (int k = 0; k < 3; k++) {
        if (p[k] < box[k]) box[k] = p[k];
        if (p[3 + k] > box[3 + k]) box[3 + k] = p[3 + k];
    }
}

static double dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void load(const skeli_soup *soup, uint64_t t, double p[3][3])
{
    for (uint64_t k = 0; k < 3; k++)
        for (uint64_t e = 0; e < 3; e++) p[k][e] = soup->position[3 * (uint64_t)soup->corner[3 * t + k] + e];
}

/* Twice the area along the normal. */
static void area_normal(const double p[3][3], double n[3])
{
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        n[k] = (p[1][i] - p[0][i]) * (p[2][j] - p[0][j]) - (p[1][j] - p[0][j]) * (p[2][i] - p[0][i]);
    }
}

/* Two planes across the mean normal of the triangles of a node, which lie between them. A piece of surface is thin along its normal and not along the axes: from the middle of a limb, where all of its surface is nearly
 * as far away, boxes alone would leave hundreds of triangles to look at. */
static void make_slab(const skeli_soup *soup, uint64_t begin, uint64_t end, float slab[5])
{
    double n[3] = {0, 0, 0}, p[3][3], low = INFINITY, high = -INFINITY;
    for (uint64_t t = begin; t < end; t++) {
        double x[3];
        load(soup, t, p);
        area_normal((const double(*)[3])p, x);
        const double side = dot3(x, n) < 0 ? -1 : 1; /* directions of triangles may disagree */
        for (int k = 0; k < 3; k++) n[k] += side * x[k];
    }
    const double length = sqrt(dot3(n, n));
    for (int k = 0; k < 3; k++) slab[k] = length > 0 ? (float)(n[k] / length) : k == 0;
    const double m[3] = {slab[0], slab[1], slab[2]}; /* as it was rounded */
    for (uint64_t t = begin; t < end; t++) {
        load(soup, t, p);
        for (int k = 0; k < 3; k++) {
            const double at = dot3(m, p[k]);
            low = at < low ? at : low;
            high = at > high ? at : high;
        }
    }
    slab[3] = (float)(low - SLAB_SLACK);
    slab[4] = (float)(high + SLAB_SLACK);
}

static svo_result make_tree(skeli_pool *pool, skeli_surface *s, svo_error *err)
{
    uint64_t n = (s->soup->triangle_count + LEAF - 1) / LEAF, nodes = 0, fours = 0;
    s->levels = 0;
    while (n > 0) {
        s->first[s->levels] = nodes;
        s->size[s->levels++] = n;
        nodes += n;
        n = n > 1 ? (n + 1) / 2 : 0;
    }
    for (uint32_t level = 0; level < s->levels; level += 2) {
        s->first_four[level / 2] = fours;
        fours += (s->size[level] + 3) / 4;
    }
    s->box = skeli_take(pool, 6 * nodes, sizeof *s->box);
    s->four = skeli_take(pool, fours, FOUR * sizeof *s->four);
    if (s->box == NULL || s->four == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < 6 * nodes; i++) s->box[i] = i % 6 < 3 ? INFINITY : -INFINITY;
    for (uint64_t t = 0; t < s->soup->triangle_count; t++)
        for (uint64_t k = 0; k < 3; k++) {
            const int32_t *q = s->soup->position + 3 * (uint64_t)s->soup->corner[3 * t + k];
            const float p[6] = {(float)q[0], (float)q[1], (float)q[2], (float)q[0], (float)q[1], (float)q[2]};
            grow(s->box + 6 * (t / LEAF), p);
        }
    for (uint32_t level = 1; level < s->levels; level++)
        for (uint64_t i = 0; i < s->size[level - 1]; i++) grow(s->box + 6 * (s->first[level] + i / 2), s->box + 6 * (s->first[level - 1] + i));
    for (uint32_t level = 0; level < s->levels; level += 2)
        for (uint64_t i = 0; i < (s->size[level] + 3) / 4 * 4; i++) {
            float *four = s->four + FOUR * (s->first_four[level / 2] + i / 4) + i % 4, slab[5] = {0, 0, 0, 0, 0}; /* no direction: everything is between the planes */
            const uint64_t begin = (i * LEAF) << level, end = ((i + 1) * LEAF) << level;
            if (i < s->size[level] && level < SLAB_LEVELS) make_slab(s->soup, begin, end < s->soup->triangle_count ? end : s->soup->triangle_count, slab);
            for (uint64_t k = 0; k < 6; k++) four[4 * k] = i < s->size[level] ? s->box[6 * (s->first[level] + i) + k] : k < 3 ? INFINITY : -INFINITY;
            for (uint64_t k = 0; k < 5; k++) four[4 * (6 + k)] = slab[k];
        }
    return SVO_OK;
}

typedef struct place { uint32_t level, at; double key; } place;

/* Of a needle, whose plane is not known: the nearest point of its sides. */
static double needle_distance2(const double t[3][3], const double *p, double *nearest)
{
    double best = INFINITY;
    for (int e = 0; e < 3; e++) {
        const double *a = t[e], *b = t[(e + 1) % 3];
        double foot, d = skeli_segment_distance(p, a, b, &foot);
        if (d * d >= best) continue;
        best = d * d;
        for (int k = 0; k < 3; k++) nearest[k] = a[k] + foot * (b[k] - a[k]);
    }
    return best;
}

/* Nearest point of a triangle by the region of its plane that p is over: corners, sides, inside (Ericson, Real-Time Collision Detection, 5.1.5). */
static double triangle_distance2(const double t[3][3], const double *p, double *nearest)
{
    double u[3], v[3], a[3], f = 0, g = 0;
    for (int k = 0; k < 3; k++) {
        u[k] = t[1][k] - t[0][k];
        v[k] = t[2][k] - t[0][k];
        a[k] = p[k] - t[0][k];
    }
    double d1 = dot3(u, a), d2 = dot3(v, a), uu = dot3(u, u), uv = dot3(u, v), vv = dot3(v, v);
    double d3 = d1 - uu, d4 = d2 - uv, d5 = d1 - uv, d6 = d2 - vv; /* the same from the second and the third corner */
    if (!(uu * vv - uv * uv > 1e-12 * uu * vv)) return needle_distance2(t, p, nearest);
    double x = d3 * d6 - d5 * d4, y = d5 * d2 - d1 * d6, z = d1 * d4 - d3 * d2;
    if (d1 <= 0 && d2 <= 0) { /* first corner: f = g = 0 */
    } else if (d3 >= 0 && d4 <= d3) {
        f = 1;
    } else if (d6 >= 0 && d5 <= d6) {
        g = 1;
    } else if (z <= 0 && d1 >= 0 && d3 <= 0) {
        f = d1 > d3 ? d1 / (d1 - d3) : 0;
    } else if (y <= 0 && d2 >= 0 && d6 <= 0) {
        g = d2 > d6 ? d2 / (d2 - d6) : 0;
    } else if (x <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
        g = d4 - d3 + d5 - d6 > 0 ? (d4 - d3) / (d4 - d3 + d5 - d6) : 0;
        f = 1 - g;
    } else {
        double n = 1 / (x + y + z);
        f = y * n;
        g = z * n;
    }
    double best = 0;
    for (int k = 0; k < 3; k++) {
        nearest[k] = t[0][k] + f * u[k] + g * v[k];
        best += (p[k] - nearest[k]) * (p[k] - nearest[k]);
    }
    return best;
}

/* Four nodes, or the triangles of a leaf, side by side. */
typedef double lanes __attribute__((vector_size(8 * LEAF)));
typedef int64_t chosen __attribute__((vector_size(8 * LEAF)));
typedef float stored __attribute__((vector_size(4 * LEAF)));

static inline lanes get(const float *leaf, int k)
{
    stored f;
    memcpy(&f, leaf + LEAF * k, sizeof f);
    return __builtin_convertvector(f, lanes);
}

static inline lanes pick(chosen which, lanes a, lanes b) { return (lanes)(((chosen)a & which) | ((chosen)b & ~which)); }

/* At least so far, squared, are four nodes from p. */
static void node_distances2(const float *four, const double *p, double out[LEAF])
{
    const lanes none = {0};
    lanes box2 = none, along = none;
    for (int k = 0; k < 3; k++) {
        const lanes below = get(four, k) - p[k], above = p[k] - get(four, 3 + k), d = pick(below > none, below, pick(above > none, above, none));
        box2 += d * d;
        along += get(four, 6 + k) * p[k];
    }
    const lanes below = get(four, 9) - along, above = along - get(four, 10), d = pick(below > above, below, above), slab2 = pick(d > none, d * d, none);
    const lanes most2 = pick(slab2 > box2, slab2, box2);
    memcpy(out, &most2, sizeof most2);
}

/* Corners of a leaf's triangles side by side: the first's x of all four, its y, .. the third's z. The last leaf has its last triangle more than once. Kept, they would take 36 bytes a triangle. */
static void load_leaf(const skeli_soup *soup, uint64_t begin, uint64_t end, float leaf[9 * LEAF])
{
    for (uint64_t i = 0; i < LEAF; i++) {
        const uint32_t *c = soup->corner + 3 * (begin + i < end ? begin + i : end - 1);
        for (uint64_t k = 0; k < 3; k++)
            for (uint64_t e = 0; e < 3; e++) leaf[LEAF * (3 * k + e) + i] = (float)soup->position[3 * (uint64_t)c[k] + e];
    }
}

/* Squared distances of the triangles of a leaf by triangle_distance2's arithmetic, so with its bits. Of the regions the last one that is picked is the first there. Needles have -1. */
static void leaf_distances2(const float *leaf, const double *p, double out[LEAF])
{
    const lanes none = {0}, one = none + 1;
    const lanes tx = get(leaf, 0), ty = get(leaf, 1), tz = get(leaf, 2);
    const lanes ux = get(leaf, 3) - tx, uy = get(leaf, 4) - ty, uz = get(leaf, 5) - tz, vx = get(leaf, 6) - tx, vy = get(leaf, 7) - ty, vz = get(leaf, 8) - tz;
    const lanes ax = p[0] - tx, ay = p[1] - ty, az = p[2] - tz;
    const lanes d1 = ux * ax + uy * ay + uz * az, d2 = vx * ax + vy * ay + vz * az;
    const lanes uu = ux * ux + uy * uy + uz * uz, uv = ux * vx + uy * vy + uz * vz, vv = vx * vx + vy * vy + vz * vz;
    const lanes d3 = d1 - uu, d4 = d2 - uv, d5 = d1 - uv, d6 = d2 - vv, x = d3 * d6 - d5 * d4, y = d5 * d2 - d1 * d6, z = d1 * d4 - d3 * d2, a = d4 - d3, b = d5 - d6;
    /* f = fy * q + fc, g = gy * q + gc with q = over / under: products with 0 and 1 and sums with 0 are exact */
    lanes over = one, under = x + y + z, fy = y, fc = none, gy = z, gc = none;
    chosen in = (x <= none) & (a >= none) & (b >= none), sides = in; /* third side */
    over = pick(in, a, over), under = pick(in, a + b, under), fy = pick(in, -one, fy), fc = pick(in, one, fc), gy = pick(in, one, gy);
    in = (y <= none) & (d2 >= none) & (d6 <= none), sides |= in; /* second side */
    over = pick(in, d2, over), under = pick(in, d2 - d6, under), fy = pick(in, none, fy), fc = pick(in, none, fc), gy = pick(in, one, gy);
    in = (z <= none) & (d1 >= none) & (d3 <= none), sides |= in; /* first side */
    over = pick(in, d1, over), under = pick(in, d1 - d3, under), fy = pick(in, one, fy), fc = pick(in, none, fc), gy = pick(in, none, gy);
    const chosen third = (d6 >= none) & (d5 <= d6), second = (d3 >= none) & (d4 <= d3), first = (d1 <= none) & (d2 <= none), corner = third | second | first;
    const chosen flat = sides & ~(under > none); /* a side without a length */
    lanes q = pick(flat | corner, none, over / pick(flat | corner, one, under));
    fc = pick(corner, pick(second & ~first, one, none), fc);
    gc = pick(third & ~second & ~first, one, gc);
    const lanes f = fy * q + fc, g = gy * q + gc;
    const lanes nx = p[0] - (tx + f * ux + g * vx), ny = p[1] - (ty + f * uy + g * vy), nz = p[2] - (tz + f * uz + g * vz);
    const lanes distance2 = pick(uu * vv - uv * uv > 1e-12 * uu * vv, nx * nx + ny * ny + nz * nz, -one);
    memcpy(out, &distance2, sizeof distance2);
}

double skeli_surface_distance(const skeli_surface *s, const double p[3], double most, double nearest[3])
{
    return skeli_surface_clearance(s, p, 0, most, nearest);
}

double skeli_surface_clearance(const skeli_surface *s, const double p[3], double least, double most, double nearest[3])
{
    if (s->levels == 0) return most;
    double best2 = most * most, least2 = least * least;
    place stack[3 * SKELI_SURFACE_LEVELS];
    int n = 0;
    stack[n++] = (place){(s->levels + 1) & ~1u, 0, 0}; /* above all: two levels at a time, even ones */
    while (n > 0 && best2 > least2) {
        place top = stack[--n];
        if (!(top.key < best2)) continue;
        if (top.level == 0) {
            uint64_t begin = (uint64_t)top.at * LEAF, end = begin + LEAF < s->soup->triangle_count ? begin + LEAF : s->soup->triangle_count;
            float leaf[9 * LEAF];
            double far2[LEAF];
            load_leaf(s->soup, begin, end, leaf);
            leaf_distances2(leaf, p, far2);
            for (uint64_t t = begin; t < end; t++) {
                if (far2[t - begin] >= best2) continue;
                double corners[3][3], at[3], d2;
                load(s->soup, t, corners);
                d2 = triangle_distance2((const double(*)[3])corners, p, at);
                if (d2 >= best2) continue;
                best2 = d2;
                if (nearest != NULL) memcpy(nearest, at, sizeof at);
            }
            continue;
        }
        const uint32_t level = top.level - 2;
        double away2[4];
        place child[4];
        int children = 0;
        node_distances2(s->four + FOUR * (s->first_four[level / 2] + top.at), p, away2);
        for (uint32_t k = 0; k < 4; k++) {
            if (!(away2[k] < best2)) continue;
            int i = children++;
            for (; i > 0 && child[i - 1].key < away2[k]; i--) child[i] = child[i - 1]; /* the nearest one on top */
            child[i] = (place){level, 4 * top.at + k, away2[k]};
        }
        for (int k = 0; k < children; k++) stack[n++] = child[k];
    }
    return sqrt(best2);
}

static double box_entry(const float *box, const double *p, const double *inverse, double most)
{
    double enter = 0, leave = most;
    for (int k = 0; k < 3; k++) {
        double a = (box[k] - p[k]) * inverse[k], b = (box[3 + k] - p[k]) * inverse[k];
        if (a != a || b != b) continue; /* in the plane of a side, along it */
        double low = a < b ? a : b, high = a < b ? b : a;
        enter = low > enter ? low : enter;
        leave = high < leave ? high : leave;
    }
    return enter <= leave * (1 + 1e-12) + 1e-9 ? enter : INFINITY;
}

static double triangle_hit(const double t[3][3], const double *p, const double *d)
{
    double u[3], v[3], w[3], q[3], r[3];
    for (int k = 0; k < 3; k++) {
        u[k] = t[1][k] - t[0][k];
        v[k] = t[2][k] - t[0][k];
        w[k] = p[k] - t[0][k];
    }
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        q[k] = d[i] * v[j] - d[j] * v[i];
        r[k] = w[i] * u[j] - w[j] * u[i];
    }
    double det = dot3(u, q);
    if (det == 0) return INFINITY;
    double a = dot3(w, q) / det, b = dot3(d, r) / det, at = dot3(v, r) / det;
    return a >= -1e-9 && b >= -1e-9 && a + b <= 1 + 1e-9 && at > 0 ? at : INFINITY;
}

double skeli_surface_ray(const skeli_surface *s, const double p[3], const double d[3], double most)
{
    if (s->levels == 0) return most;
    const double inverse[3] = {1 / d[0], 1 / d[1], 1 / d[2]};
    place stack[2 * SKELI_SURFACE_LEVELS];
    int n = 0;
    stack[n++] = (place){s->levels - 1, 0, box_entry(s->box + 6 * s->first[s->levels - 1], p, inverse, most)};
    while (n > 0) {
        place top = stack[--n];
        if (!(top.key < most)) continue;
        if (top.level == 0) {
            uint64_t begin = (uint64_t)top.at * LEAF, end = begin + LEAF < s->soup->triangle_count ? begin + LEAF : s->soup->triangle_count;
            for (uint64_t t = begin; t < end; t++) {
                double corners[3][3];
                load(s->soup, t, corners);
                double at = triangle_hit((const double(*)[3])corners, p, d);
                if (at < most) most = at;
            }
            continue;
        }
        place child[2];
        int children = 0;
        for (uint32_t k = 0; k < 2; k++) {
            uint32_t at = 2 * top.at + k;
            if (at >= s->size[top.level - 1]) break;
            child[children++] = (place){top.level - 1, at, box_entry(s->box + 6 * (s->first[top.level - 1] + at), p, inverse, most)};
        }
        if (children == 2 && child[0].key < child[1].key) {
            stack[n++] = child[1];
            stack[n++] = child[0];
        } else {
            for (int k = 0; k < children; k++) stack[n++] = child[k];
        }
    }
    return most;
}

/* --- inside ------------------------------------------------------------------------------------------------------- */

static svo_result make_winding(skeli_surface *s, const skel_report *r, uint32_t threads, const svo_allocator *a, svo_error *err)
{
    svo_grid grid = {.size = ldexp(r->unit, 1 - GRID_DEPTH), .depth = GRID_DEPTH};
    if (!isfinite(1 / grid.size) || !(grid.size > 0)) return SVO_OK; /* sizes near the ends of what a double holds: nothing is inside */
    for (int k = 0; k < 3; k++) grid.origin[k] = r->centre[k] - r->unit;
    svo_winding_report w;
    svo_placement placement;
    SVO_TRY(svo_placement_create(&s->mesh, a, &placement, err));
    const svo_result made = svo_winding_create(&placement, &grid, threads, a, NULL, &s->winding, &w, err);
    svo_placement_free(&placement);
    SVO_TRY(made);
    s->turned = w.turned;
    s->boundary_edges = w.boundary_edges;
    return SVO_OK;
}

svo_result skeli_surface_tree(skeli_pool *pool, const skeli_soup *soup, skeli_surface *s, svo_error *err)
{
    memset(s, 0, sizeof *s);
    s->soup = soup;
    return make_tree(pool, s, err);
}

/* Triangles that lie at the same place more than once (both sides of a sheet that is drawn from both sides), once: those in opposite directions would cancel in every winding
 * number. Left as they are where there are none. */
static svo_result without_doubles(skeli_pool *pool, const skeli_soup *soup, const uint32_t *remap, const uint32_t **corner, uint64_t *triangles, svo_error *err)
{
    const uint32_t *given = *corner;
    uint64_t n = 0, kept = 0, capacity = 64;
    for (uint64_t t = 0; t < *triangles; t++) {
        uint32_t a = remap[given[3 * t]], b = remap[given[3 * t + 1]], c = remap[given[3 * t + 2]];
        n += a != SVO_NONE && b != SVO_NONE && c != SVO_NONE && !(a == b && b == c);
    }
    if (n == soup->triangle_count) return SVO_OK;
    while (capacity < 2 * n) capacity *= 2;
    uint32_t *slot = skeli_take(pool, capacity, sizeof *slot), *out = skeli_take(pool, 3 * n, sizeof *out);
    if (slot == NULL || out == NULL) return skeli_no_memory(err);
    memset(slot, 0xff, capacity * sizeof *slot);
    for (uint64_t t = 0; t < *triangles; t++) {
        uint32_t v[3];
        for (int k = 0; k < 3; k++) v[k] = remap[given[3 * t + (uint64_t)k]];
        if (v[0] == SVO_NONE || v[1] == SVO_NONE || v[2] == SVO_NONE || (v[0] == v[1] && v[1] == v[2])) continue;
        skeli_sort3(v);
        uint64_t i = skeli_hash3(v) & (capacity - 1);
        for (; slot[i] != UINT32_MAX; i = (i + 1) & (capacity - 1)) {
            uint32_t w[3];
            for (int k = 0; k < 3; k++) w[k] = remap[out[3 * (uint64_t)slot[i] + (uint64_t)k]];
            skeli_sort3(w);
            if (w[0] == v[0] && w[1] == v[1] && w[2] == v[2]) break;
        }
        if (slot[i] != UINT32_MAX) continue;
        slot[i] = (uint32_t)kept;
        memcpy(out + 3 * kept++, given + 3 * t, 3 * sizeof *out);
    }
    skeli_give(pool, slot);
    *corner = out;
    *triangles = kept;
    return SVO_OK;
}

svo_result skeli_surface_make(skeli_pool *pool, const skeli_soup *soup, const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles,
                              const uint32_t *remap, const skel_report *report, uint32_t threads, skeli_surface *s, svo_error *err)
{
    SVO_TRY(skeli_surface_tree(pool, soup, s, err));
    SVO_TRY(skeli_surface_genus(pool, soup, &s->genus, err));
    if (soup->triangle_count == 0) return SVO_OK;
    SVO_TRY(without_doubles(pool, soup, remap, &corner, &triangles, err));
    /* a const model in a struct that has no const: nothing writes to it */
    memcpy(&s->part.positions, &position, sizeof position);
    memcpy(&s->part.indices, &corner, sizeof corner);
    s->part.material = SVO_NONE;
    s->part.vertex_count = points;
    s->part.triangle_count = triangles;
    s->shape = (svo_shape){.part_count = 1, .parts = &s->part};
    s->instance = (svo_instance){.transform = svo_mat4_identity()};
    s->mesh = (svo_mesh){.allocator = pool->allocator, .shape_count = 1, .instance_count = 1, .shapes = &s->shape, .instances = &s->instance};
    return make_winding(s, report, threads, pool->allocator, err);
}

void skeli_surface_free(skeli_surface *s)
{
    svo_winding_free(s->winding);
    memset(s, 0, sizeof *s);
}

bool skeli_surface_inside(const skeli_surface *s, const double p[3])
{
    if (s->winding == NULL) return false;
    int32_t q[3];
    for (int k = 0; k < 3; k++) { /* 2^24 steps a unit to 2^19, even */
        double x = (p[k] / SKEL_LATTICE + 1) * 0x1p18;
        if (!(x > 0 && x < 0x1p19)) return false;
        q[k] = 2 * (int32_t)x;
    }
    double margin;
    return svo_winding_inside(s->winding, q, &margin);
}

/* --- genus -------------------------------------------------------------------------------------------------------- */

svo_result skeli_surface_genus(skeli_pool *pool, const skeli_soup *soup, skeli_genus *out, svo_error *err)
{
    uint64_t n = soup->vertex_count, f = soup->triangle_count;
    memset(out, 0, sizeof *out);
    uint32_t *parent = skeli_take(pool, n, sizeof *parent), *edge = skeli_take(pool, 6 * f, sizeof *edge);
    uint64_t *key = skeli_take(pool, 3 * f, sizeof *key);
    int64_t *euler = skeli_take(pool, n, sizeof *euler);
    uint8_t *open = skeli_take(pool, n, 1);
    if (parent == NULL || edge == NULL || key == NULL || euler == NULL || open == NULL) return skeli_no_memory(err);
    uint32_t *order = edge, *scratch = edge + 3 * f;
    for (uint32_t v = 0; v < n; v++) parent[v] = v;
    memset(open, 0, n);
    memset(euler, 0, n * sizeof *euler);
    for (uint64_t t = 0; t < f; t++) {
        const uint32_t *c = soup->corner + 3 * t;
        for (int k = 0; k < 3; k++) {
            uint32_t a = c[k], b = c[(k + 1) % 3], p = skeli_root(parent, a), q = skeli_root(parent, b);
            if (p != q) parent[p > q ? p : q] = p > q ? q : p;
            key[3 * t + (uint64_t)k] = (uint64_t)(a < b ? a : b) << 32 | (a < b ? b : a);
            order[3 * t + (uint64_t)k] = (uint32_t)(3 * t + (uint64_t)k);
        }
    }
    uint32_t bits = 1;
    while (n >> bits != 0) bits++;
    skeli_sort_by64(order, scratch, 3 * f, key, 32 + bits);
    for (uint64_t t = 0; t < f; t++) {
        const uint32_t *c = soup->corner + 3 * t;
        uint32_t r = skeli_root(parent, c[0]);
        euler[r]++;
        if (c[0] == c[1] || c[1] == c[2] || c[2] == c[0]) open[r] = 1;
    }
    for (uint64_t i = 0; i < 3 * f;) {
        uint64_t end = i;
        while (end < 3 * f && key[order[end]] == key[order[i]]) end++;
        uint32_t r = skeli_root(parent, (uint32_t)(key[order[i]] >> 32));
        euler[r]--;
        if (end - i != 2) open[r] = 1;
        i = end;
    }
    for (uint32_t v = 0; v < n; v++) euler[skeli_root(parent, v)]++;
    out->known = true;
    for (uint32_t v = 0; v < n; v++) {
        if (parent[v] != v) continue;
        out->components++;
        if (open[v] || euler[v] > 2 || euler[v] % 2 != 0) {
            out->known = false;
            continue;
        }
        out->closed++;
        out->genus += (uint64_t)(1 - euler[v] / 2);
    }
    skeli_give(pool, parent);
    skeli_give(pool, edge);
    skeli_give(pool, key);
    skeli_give(pool, euler);
    skeli_give(pool, open);
    return SVO_OK;
}
