/* Any triangles to a canonical, indexed soup on the lattice: normalisation, welding of coincident points, removal of what has no
 * triangle. */
#include "skeli_internal.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* --- normalisation ------------------------------------------------------------------------------------------------ */

typedef struct sphere { double centre[3], radius; } sphere;

static double distance3(const double *a, const double *b)
{
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return sqrt(x * x + y * y + z * z);
}

/* Smallest sphere through the n <= 4 points p (centre in their affine hull); false when they are degenerate. */
static bool circumsphere(const double p[][3], int n, sphere *out)
{
    double m[3][4], u[3][3];
    int d = n - 1;
    for (int i = 0; i < d; i++)
        for (int k = 0; k < 3; k++) u[i][k] = p[i + 1][k] - p[0][k];
    for (int i = 0; i < d; i++) {
        for (int j = 0; j < d; j++) m[i][j] = 2 * (u[i][0] * u[j][0] + u[i][1] * u[j][1] + u[i][2] * u[j][2]);
        m[i][d] = m[i][i] / 2;
    }
    for (int c = 0; c < d; c++) { /* Gauss with row pivoting */
        int best = c;
        for (int r = c + 1; r < d; r++)
            if (fabs(m[r][c]) > fabs(m[best][c])) best = r;
        if (!(fabs(m[best][c]) > 1e-14)) return false;
        for (int k = c; k <= d; k++) {
            double t = m[c][k];
            m[c][k] = m[best][k];
            m[best][k] = t;
        }
        for (int r = 0; r < d; r++) {
            if (r == c) continue;
            double f = m[r][c] / m[c][c];
            for (int k = c; k <= d; k++) m[r][k] -= f * m[c][k];
        }
    }
    for (int k = 0; k < 3; k++) {
        out->centre[k] = p[0][k];
        for (int i = 0; i < d; i++) out->centre[k] += m[i][d] / m[i][i] * u[i][k];
    }
    out->radius = distance3(out->centre, p[0]);
    return true;
}

/* Smallest enclosing sphere of n <= 5 points; keeps in p only the points that define it. */
static sphere small_ball(double p[5][3], int *n)
{
    sphere best = {.radius = DBL_MAX};
    uint32_t chosen = 1;
    for (uint32_t set = 1; set < 1u << *n; set++) {
        double q[5][3];
        int c = 0;
        for (int i = 0; i < *n; i++)
            if (set >> i & 1) memcpy(q[c++], p[i], sizeof q[0]);
        sphere s;
        if (c > 4 || !circumsphere((const double(*)[3])q, c, &s) || s.radius >= best.radius) continue;
        bool all = true;
        for (int i = 0; i < *n; i++) all &= distance3(s.centre, p[i]) <= s.radius * (1 + 1e-10) + 1e-14;
        if (!all) continue;
        best = s;
        chosen = set;
    }
    int c = 0;
    for (int i = 0; i < *n; i++)
        if (chosen >> i & 1) memmove(p[c++], p[i], sizeof p[0]);
    *n = c;
    return best;
}

static int by_position(const void *a, const void *b)
{
    const double *x = a, *y = b;
    for (int k = 0; k < 3; k++)
        if (x[k] != y[k]) return x[k] < y[k] ? -1 : 1;
    return 0;
}

/* Smallest enclosing ball of points in [-1, 1]^3: grow the defining set by the farthest point until none is outside. The radius grows
 * strictly, so this ends; 64 rounds are far more than was ever seen. Ties go to the smallest point and the set is kept sorted, so that the
 * result does not depend on the order of the points. */
static sphere enclosing_ball(const double *p, uint64_t count, const double shift[3], double inverse)
{
    double support[5][3];
    int n = 1;
    const double *least = p;
    for (uint64_t i = 1; i < count; i++)
        if (by_position(p + 3 * i, least) < 0) least = p + 3 * i;
    for (int k = 0; k < 3; k++) support[0][k] = (least[k] - shift[k]) * inverse;
    sphere s = {.radius = 0};
    memcpy(s.centre, support[0], sizeof s.centre);
    for (int round = 0; round < 64; round++) {
        double far = -1, at[3] = {0};
        for (uint64_t i = 0; i < count; i++) {
            double q[3];
            for (int k = 0; k < 3; k++) q[k] = (p[3 * i + (uint64_t)k] - shift[k]) * inverse;
            double x = q[0] - s.centre[0], y = q[1] - s.centre[1], z = q[2] - s.centre[2], d = x * x + y * y + z * z;
            if (d < far || (d == far && by_position(q, at) >= 0)) continue;
            far = d;
            memcpy(at, q, sizeof at);
        }
        far = sqrt(far);
        if (far <= s.radius * (1 + 1e-9) + 1e-12) break;
        memcpy(support[n++], at, sizeof at);
        qsort(support, (size_t)n, sizeof support[0], by_position);
        sphere next = small_ball(support, &n);
        if (!(next.radius < DBL_MAX) || next.radius <= s.radius) { /* rounding: take what encloses everything */
            s.radius = far;
            break;
        }
        s = next;
    }
    return s;
}

svo_result skeli_normalization(const double *position, uint64_t count, skel_normalize how, double centre[3], double *unit, svo_error *err)
{
    double low[3], half = 0;
    for (int k = 0; k < 3; k++) {
        double high = low[k] = position[k];
        for (uint64_t i = 1; i < count; i++) {
            double v = position[3 * i + (uint64_t)k];
            if (v < low[k]) low[k] = v;
            if (v > high) high = v;
        }
        centre[k] = 0.5 * low[k] + 0.5 * high;
        double h = 0.5 * high - 0.5 * low[k];
        if (h > half) half = h;
    }
    *unit = 1;
    if (half == 0) return SVO_OK; /* one point */
    double inverse = 1 / half;
    if (!(half < 1e300) || !(inverse < 1e300)) return svo_fail(err, SVO_LIMIT, "the model's extent %g is beyond 1e-300..1e300", 2 * half);
    *unit = 2 * half;
    if (how == SKEL_NORMALIZE_BOX) return SVO_OK;
    sphere s = enclosing_ball(position, count, centre, inverse);
    for (int k = 0; k < 3; k++) centre[k] += s.centre[k] * half;
    /* 1.15: ball diameter over longest box side, typical of organic models, so that omega means about the same in both. */
    *unit = 2 * s.radius * half / 1.15;
    return SVO_OK;
}

/* --- canonical soup ----------------------------------------------------------------------------------------------- */

static uint64_t spread(uint64_t v)
{
    v &= 0x1fffff;
    v = (v | v << 32) & 0x1f00000000ffffull;
    v = (v | v << 16) & 0x1f0000ff0000ffull;
    v = (v | v << 8) & 0x100f00f00f00f00full;
    v = (v | v << 4) & 0x10c30c30c30c30c3ull;
    return (v | v << 2) & 0x1249249249249249ull;
}

/* Points that have a triangle, in Morton order, equal ones together. */
static void morton_order(const int32_t *position, uint64_t count, uint32_t *order, uint32_t *scratch, uint64_t *key, uint64_t points)
{
    /* Coordinates have 25 bits: 4 low bits of each first, then 21 high ones (a stable sort, least digit first). */
    for (uint64_t i = 0; i < points; i++) {
        uint64_t k = 0;
        for (uint64_t c = 0; c < 3; c++) k = k << 4 | ((uint64_t)(position[3 * i + c] + SKEL_LATTICE) & 15);
        key[i] = k;
    }
    skeli_sort_by64(order, scratch, count, key, 12);
    for (uint64_t i = 0; i < points; i++) {
        uint64_t k = 0;
        for (uint64_t c = 0; c < 3; c++) k |= spread((uint64_t)(position[3 * i + c] + SKEL_LATTICE) >> 4) << c;
        key[i] = k;
    }
    skeli_sort_by64(order, scratch, count, key, 63);
}

static bool same_point(const int32_t *a, const int32_t *b) { return a[0] == b[0] && a[1] == b[1] && a[2] == b[2]; }

svo_result skeli_canonical(skeli_pool *pool, const int32_t *position, uint64_t points, const uint32_t *corner, uint64_t triangles,
                           skeli_soup *out, uint32_t *remap, uint64_t *point_triangles, svo_error *err)
{
    SVO_ASSERT(points < INT32_MAX && triangles < INT32_MAX);
    uint32_t *kept = skeli_take(pool, 3 * triangles, sizeof *kept);
    uint32_t *sorted = skeli_take(pool, 3 * triangles, sizeof *sorted);
    uint32_t *order = skeli_take(pool, points, sizeof *order), *scratch = skeli_take(pool, points + 1, sizeof *scratch);
    uint64_t *key = skeli_take(pool, points, sizeof *key);
    if (kept == NULL || sorted == NULL || order == NULL || scratch == NULL || key == NULL) return skeli_no_memory(err);

    /* Triangles that are more than a point; only where there is none, the points themselves are kept. */
    uint64_t n = 0;
    for (uint64_t t = 0; t < triangles; t++) {
        const uint32_t *c = corner + 3 * t;
        const int32_t *a = position + 3 * (uint64_t)c[0];
        if (same_point(a, position + 3 * (uint64_t)c[1]) && same_point(a, position + 3 * (uint64_t)c[2])) continue;
        memcpy(kept + 3 * n++, c, 3 * sizeof *c);
    }
    *point_triangles = triangles - n;
    memset(remap, 0xff, points * sizeof *remap);
    const uint32_t *source = n > 0 ? kept : corner;
    for (uint64_t i = 0; i < 3 * (n > 0 ? n : triangles); i++) remap[source[i]] = 0;

    uint64_t used = 0;
    for (uint64_t i = 0; i < points; i++)
        if (remap[i] == 0) order[used++] = (uint32_t)i;
    morton_order(position, used, order, scratch, key, points);
    uint32_t vertices = 0;
    for (uint64_t i = 0; i < used; i++) {
        if (i > 0 && !same_point(position + 3 * (uint64_t)order[i], position + 3 * (uint64_t)order[i - 1])) vertices++;
        remap[order[i]] = vertices;
    }
    if (used > 0) vertices++;
    out->position = skeli_take(pool, 3 * (uint64_t)vertices, sizeof *out->position);
    if (out->position == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < used; i++)
        memcpy(out->position + 3 * (uint64_t)remap[order[i]], position + 3 * (uint64_t)order[i], 3 * sizeof *position);
    for (uint64_t t = 0; t < n; t++) {
        for (int k = 0; k < 3; k++) kept[3 * t + (uint64_t)k] = remap[kept[3 * t + (uint64_t)k]];
        skeli_sort3(kept + 3 * t);
    }
    out->vertex_count = vertices;
    out->triangle_count = (uint32_t)skeli_sort_unique(kept, n, 3, vertices, sorted, scratch);
    out->corner = kept;
    skeli_give(pool, sorted);
    skeli_give(pool, order);
    skeli_give(pool, scratch);
    skeli_give(pool, key);
    return SVO_OK;
}

svo_result skeli_soup_make(skeli_pool *pool, const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles,
                           skel_report *report, skeli_soup *out, uint32_t *remap, svo_error *err)
{
    if (points >= INT32_MAX || triangles >= INT32_MAX)
        return svo_fail(err, SVO_LIMIT, "%llu points and %llu triangles: a skeleton takes fewer than 2^31", (unsigned long long)points,
                        (unsigned long long)triangles);
    uint8_t *state = skeli_take(pool, points, 1); /* 0 not finite, 1 finite, 2 has a triangle */
    uint32_t *finite = skeli_take(pool, 3 * triangles, sizeof *finite);
    double *used = skeli_take(pool, 3 * points, sizeof *used);
    int32_t *lattice = skeli_take(pool, 3 * points, sizeof *lattice);
    if (state == NULL || finite == NULL || used == NULL || lattice == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < points; i++)
        state[i] = isfinite(position[3 * i]) && isfinite(position[3 * i + 1]) && isfinite(position[3 * i + 2]);
    uint64_t n = 0;
    for (uint64_t t = 0; t < triangles; t++) {
        const uint32_t *c = corner + 3 * t;
        if (state[c[0]] == 0 || state[c[1]] == 0 || state[c[2]] == 0) continue;
        memcpy(finite + 3 * n++, c, 3 * sizeof *c);
        state[c[0]] = state[c[1]] = state[c[2]] = 2;
    }
    if (n == 0) return svo_fail(err, SVO_INVALID_DATA, "the model has no triangle with finite corners, so it has no skeleton");
    uint64_t used_count = 0;
    for (uint64_t i = 0; i < points; i++) {
        if (state[i] == 2) memcpy(used + 3 * used_count++, position + 3 * i, 3 * sizeof *used);
        report->not_finite += state[i] == 0;
    }
    SVO_TRY(skeli_normalization(used, used_count, report->normalize, report->centre, &report->unit, err));
    double scale = SKEL_LATTICE / report->unit;
    if (!isfinite(scale)) return svo_fail(err, SVO_LIMIT, "the model is too small (%g)", report->unit);
    for (uint64_t i = 0; i < points; i++)
        for (uint64_t k = 0; k < 3; k++)
            lattice[3 * i + k] = state[i] == 2 ? (int32_t)rint((position[3 * i + k] - report->centre[k]) * scale) : 0;
    uint64_t point_triangles;
    SVO_TRY(skeli_canonical(pool, lattice, points, finite, n, out, remap, &point_triangles, err));
    report->dropped_triangles = triangles - n + point_triangles;
    uint64_t mapped = 0;
    for (uint64_t i = 0; i < points; i++) mapped += remap[i] != SVO_NONE;
    report->unreferenced = points - report->not_finite - mapped;
    report->coincident = mapped - out->vertex_count;
    report->mesh_vertices = out->vertex_count;
    report->mesh_triangles = out->triangle_count;
    skeli_give(pool, state);
    skeli_give(pool, finite);
    skeli_give(pool, used);
    skeli_give(pool, lattice);
    return SVO_OK;
}

void skeli_rings(const skeli_soup *s, const double *position, double *ring)
{
    memset(ring, 0, (size_t)s->vertex_count * sizeof *ring);
    for (uint64_t t = 0; t < s->triangle_count; t++) {
        const uint32_t *c = s->corner + 3 * t;
        double a = skeli_area(position + 3 * (uint64_t)c[0], position + 3 * (uint64_t)c[1], position + 3 * (uint64_t)c[2]);
        for (int k = 0; k < 3; k++) ring[c[k]] += a;
    }
}
