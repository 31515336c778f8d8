#include "svo_raster.h"

#include <math.h>

/* Both gcc and clang have it on every 64-bit machine; __extension__ keeps -Wpedantic quiet. */
__extension__ typedef __int128 wide;

enum { FAR_AWAY = 1 << 20 }; /* stands for any voxel index beyond the block */

svo_raster_target svo_raster_cube(void)
{
    svo_raster_target t = {{0, 0, 0}, {256, 256, 256}};
    return t;
}

svo_raster_target svo_raster_centre_line(uint32_t axis)
{
    svo_raster_target t = {{128, 128, 128}, {128, 128, 128}};
    t.lo[axis] = 0;
    t.hi[axis] = 256;
    return t;
}

static inline int32_t min32(int32_t a, int32_t b) { return a < b ? a : b; }
static inline int32_t max32(int32_t a, int32_t b) { return a > b ? a : b; }
static inline int64_t max64(int64_t a, int64_t b) { return a > b ? a : b; }
static inline int64_t abs64(int64_t a) { return a < 0 ? -a : a; }

/* floor(num / den) for den > 0, clamped to +-FAR_AWAY. |num| < 2^62. inverse is 1 / den rounded: the guess is off by one
 * at most inside the clamp, because its relative error is below 2^-50 and it is below 2^21. */
static inline int32_t floor_div(int64_t num, int64_t den, double inverse)
{
    double guess = (double)num * inverse;
    if (guess < -FAR_AWAY) return -FAR_AWAY;
    if (guess > FAR_AWAY) return FAR_AWAY;
    int64_t k = (int64_t)guess;
    int64_t rest = num - k * den; /* truncation may round up for negative guesses: two corrections below */
    if (rest < 0) k--, rest += den;
    if (rest < 0) k--;
    else if (rest >= den) k++;
    return (int32_t)k;
}

static int32_t floor_div_wide(wide num, wide den)
{
    wide k = num / den;
    if (k * den > num) k--;
    return k < -FAR_AWAY ? -FAR_AWAY : k > FAR_AWAY ? FAR_AWAY : (int32_t)k;
}

/* An edge of the triangle projected to axes (a, b), as the half-plane ka * i + kb * j + c >= 0 of voxel indices i along
 * a, j along b whose target part reaches the inner side. */
typedef struct edge { int64_t ka, kb, c; } edge;

static inline void edges2(const int32_t q[3][3], uint32_t a, uint32_t b, int64_t orientation, const svo_raster_target *t, edge e[3])
{
    int64_t sign = orientation < 0 ? -1 : 1; /* of a projection that is a segment either will do: edges run both ways */
    for (int i = 0; i < 3; i++) {
        const int32_t *p = q[i], *next = q[i == 2 ? 0 : i + 1];
        int64_t ka = -sign * ((int64_t)next[b] - p[b]), kb = sign * ((int64_t)next[a] - p[a]);
        int64_t c = -(ka * p[a] + kb * p[b]);
        c += max64(ka * t->lo[a], ka * t->hi[a]) + max64(kb * t->lo[b], kb * t->hi[b]);
        e[i] = (edge){ka, kb, c >> 8}; /* 256 k + c >= 0 if and only if k + floor(c / 256) >= 0 */
    }
}

/* For every row i in [i0, i1]: narrow lo[i] .. hi[i] to the indices along b that the projection to (a, b) allows. */
static inline void narrow(const edge e[3], int32_t i0, int32_t i1, int32_t *lo, int32_t *hi)
{
    for (int k = 0; k < 3; k++) {
        int64_t ka = e[k].ka, kb = e[k].kb, r = ka * i0 + e[k].c;
        if (kb > 0) {
            double inverse = 1.0 / (double)kb;
            for (int32_t i = i0; i <= i1; i++, r += ka) lo[i] = max32(lo[i], -floor_div(r, kb, inverse));
        } else if (kb < 0) {
            double inverse = 1.0 / (double)-kb;
            for (int32_t i = i0; i <= i1; i++, r += ka) hi[i] = min32(hi[i], floor_div(r, -kb, inverse));
        } else {
            for (int32_t i = i0; i <= i1; i++, r += ka)
                if (r < 0) hi[i] = -FAR_AWAY;
        }
    }
}

/* The plane as bounds of w: hi = floor((top - nu u - nv v) / nw), lo = floor((bottom - nu u - nv v) / nw) + 1. */
typedef struct plane {
    int64_t nu, nv, nw; /* nw > 0 */
    wide top, bottom;
    bool narrow; /* everything fits 64 bits */
    double inverse, slope;
} plane;

static inline plane plane_make(const int32_t q[3][3], const int64_t n[3], uint32_t u, uint32_t v, uint32_t w, const svo_raster_target *t)
{
    int64_t sign = n[w] < 0 ? -1 : 1;
    plane p = {.nu = sign * n[u], .nv = sign * n[v], .nw = sign * n[w]};
    wide d = (wide)p.nu * q[0][u] + (wide)p.nv * q[0][v] + (wide)p.nw * q[0][w];
    /* corners of the target where the plane is highest and lowest */
    int32_t ut = p.nu < 0 ? t->hi[u] : t->lo[u], ub = p.nu < 0 ? t->lo[u] : t->hi[u];
    int32_t vt = p.nv < 0 ? t->hi[v] : t->lo[v], vb = p.nv < 0 ? t->lo[v] : t->hi[v];
    p.top = (d - (wide)p.nu * ut - (wide)p.nv * vt - (wide)p.nw * t->lo[w]) >> 8;
    p.bottom = (d - (wide)p.nu * ub - (wide)p.nv * vb - (wide)p.nw * t->hi[w] - 1) >> 8;
    const wide far = (wide)1 << 61;
    p.narrow = p.nw < (int64_t)1 << 53 && p.top < far && p.top > -far && p.bottom < far && p.bottom > -far;
    p.inverse = 1.0 / (double)p.nw;
    p.slope = (double)p.nu * p.inverse;
    return p;
}

/* Narrow a row by the plane; false when nothing can be left. */
static inline bool plane_row(const plane *p, int32_t v, int32_t u0, int32_t u1, int32_t *lo, int32_t *hi)
{
    if (!p->narrow) {
        wide top = p->top - (wide)p->nv * v, bottom = p->bottom - (wide)p->nv * v;
        for (int32_t u = u0; u <= u1; u++) {
            hi[u] = min32(hi[u], floor_div_wide(top - (wide)p->nu * u, p->nw));
            lo[u] = max32(lo[u], floor_div_wide(bottom - (wide)p->nu * u, p->nw) + 1);
        }
        return true;
    }
    int64_t top = (int64_t)p->top - p->nv * v, bottom = (int64_t)p->bottom - p->nv * v;
    if (u1 - u0 >= 4) {
        double base_top = (double)top * p->inverse, base_bottom = (double)bottom * p->inverse, slope = p->slope;
        /* |slope| <= 1 and u < 128, top - bottom <= 4: outside of this the row misses the block */
        if (base_top < -300 || base_bottom > 600) return false;
        /* Fixed point with 20 fraction bits, offset 512. The error of a value is one unit (truncation) and 2^-40, so one
         * that is two units away from an integer is rounded as the exact one would be. */
        const double one = 0x1p20;
        base_top = (base_top + 512) * one;
        base_bottom = (base_bottom + 512) * one;
        slope *= one;
        int32_t any = 0;
        for (int32_t u = u0; u <= u1; u++) {
            int32_t a = (int32_t)(base_top - slope * u), b = (int32_t)(base_bottom - slope * u);
            int32_t doubt_a = ((a + 2) & 0xfffff) < 5, doubt_b = ((b + 2) & 0xfffff) < 5;
            any |= doubt_a | doubt_b;
            hi[u] = min32(hi[u], (a >> 20) - 512 + doubt_a);
            lo[u] = max32(lo[u], (b >> 20) - 512 + 1 - doubt_b);
        }
        if (any == 0) return true;
    }
    for (int32_t u = u0; u <= u1; u++) {
        hi[u] = min32(hi[u], floor_div(top - p->nu * u, p->nw, p->inverse));
        lo[u] = max32(lo[u], floor_div(bottom - p->nu * u, p->nw, p->inverse) + 1);
    }
    return true;
}

static inline void fill(int32_t *values, int32_t first, int32_t last, int32_t value)
{
    for (int32_t i = first; i <= last; i++) values[i] = value;
}

/* Scratch of a scan: bounds by row and by column, and of the current row. */
typedef struct scan {
    int32_t lo_row_u[128], hi_row_u[128]; /* u by v */
    int32_t lo_row_w[128], hi_row_w[128]; /* w by v */
    int32_t lo_col_w[128], hi_col_w[128]; /* w by u */
    int32_t lo[128], hi[128];
} scan;

static void scan_rows(const int32_t q[3][3], const int64_t n[3], const svo_raster_target *t, const int32_t first[3], const int32_t last[3],
                      svo_raster_row *row, svo_raster_row_fn fn, void *user)
{
    scan s;
    uint32_t u = row->u, v = row->v, w = row->w;
    edge e[3];
    fill(s.lo_row_u, first[v], last[v], first[u]);
    fill(s.hi_row_u, first[v], last[v], last[u]);
    /* n[w] is the signed area in axes (w+1, w+2); with (v, u) or (u, v) as first and second axis the sign follows */
    edges2(q, v, u, (v + 1) % 3 == u ? n[w] : -n[w], t, e);
    narrow(e, first[v], last[v], s.lo_row_u, s.hi_row_u);
    fill(s.lo_row_w, first[v], last[v], first[w]);
    fill(s.hi_row_w, first[v], last[v], last[w]);
    edges2(q, v, w, (v + 1) % 3 == w ? n[u] : -n[u], t, e);
    narrow(e, first[v], last[v], s.lo_row_w, s.hi_row_w);
    fill(s.lo_col_w, first[u], last[u], first[w]);
    fill(s.hi_col_w, first[u], last[u], last[w]);
    edges2(q, u, w, (u + 1) % 3 == w ? n[v] : -n[v], t, e);
    narrow(e, first[u], last[u], s.lo_col_w, s.hi_col_w);

    bool has_plane = n[w] != 0;
    plane p = {0};
    if (has_plane) p = plane_make(q, n, u, v, w, t);
    row->lo = s.lo;
    row->hi = s.hi;
    for (int32_t at = first[v]; at <= last[v]; at++) {
        int32_t u0 = s.lo_row_u[at], u1 = s.hi_row_u[at], w0 = s.lo_row_w[at], w1 = s.hi_row_w[at];
        if (u0 > u1 || w0 > w1) continue;
        for (int32_t i = u0; i <= u1; i++) {
            s.lo[i] = max32(s.lo_col_w[i], w0);
            s.hi[i] = min32(s.hi_col_w[i], w1);
        }
        if (has_plane && !plane_row(&p, at, u0, u1, s.lo, s.hi)) continue;
        row->at_v = at;
        row->u0 = u0;
        row->u1 = u1;
        fn(user, row);
    }
}

void svo_raster_scan(const int32_t q[3][3], const svo_raster_target *t, const int32_t box_lo[3], const int32_t box_hi[3],
                     svo_raster_row_fn fn, void *user)
{
    int32_t first[3], last[3], extent[3]; /* voxels whose part reaches the triangle's bounds; clipped to the box */
    uint32_t single = 0, cube = 0;
    for (int k = 0; k < 3; k++) {
        int32_t low = min32(q[0][k], min32(q[1][k], q[2][k])), high = max32(q[0][k], max32(q[1][k], q[2][k]));
        int32_t a = (low - t->hi[k] + 255) >> 8, b = (high - t->lo[k]) >> 8;
        single += a == b;
        cube += t->lo[k] == 0 && t->hi[k] == 256;
        extent[k] = b - a;
        first[k] = max32(a, box_lo[k]);
        last[k] = min32(b, box_hi[k]);
        if (first[k] > last[k]) return;
    }
    svo_raster_row row;
    if (cube == 3 && single >= 2) {
        /* Strictly inside a line of voxels: it meets all of its bounds. */
        row.w = extent[0] != 0 ? 0 : extent[1] != 0 ? 1 : 2;
        row.u = (row.w + 1) % 3;
        row.v = (row.w + 2) % 3;
        int32_t lo[128], hi[128];
        row.at_v = first[row.v];
        row.u0 = row.u1 = first[row.u];
        lo[row.u0] = first[row.w];
        hi[row.u0] = last[row.w];
        row.lo = lo;
        row.hi = hi;
        fn(user, &row);
        return;
    }
    int64_t a[3], b[3], n[3];
    for (int k = 0; k < 3; k++) {
        a[k] = (int64_t)q[1][k] - q[0][k];
        b[k] = (int64_t)q[2][k] - q[0][k];
    }
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        n[k] = a[i] * b[j] - a[j] * b[i];
    }
    if (cube == 3 && single == 1) {
        /* Strictly inside a layer: one projection decides. */
        row.v = extent[0] == 0 ? 0 : extent[1] == 0 ? 1 : 2;
        row.u = (row.v + 1) % 3;
        row.w = (row.v + 2) % 3;
        int32_t lo[128], hi[128];
        edge e[3];
        fill(lo, first[row.u], last[row.u], first[row.w]);
        fill(hi, first[row.u], last[row.u], last[row.w]);
        edges2(q, row.u, row.w, (row.u + 1) % 3 == row.w ? n[row.v] : -n[row.v], t, e);
        narrow(e, first[row.u], last[row.u], lo, hi);
        row.at_v = first[row.v];
        row.u0 = first[row.u];
        row.u1 = last[row.u];
        row.lo = lo;
        row.hi = hi;
        fn(user, &row);
        return;
    }
    /* W: dominant axis of the normal, so that columns are short; of a segment its longest axis. U: the longer of the
     * others, so that rows are long and few. */
    const bool flat = n[0] == 0 && n[1] == 0 && n[2] == 0;
    int64_t size[3];
    for (int k = 0; k < 3; k++) size[k] = flat ? extent[k] : abs64(n[k]);
    row.w = size[1] > size[0] ? 1 : 0;
    if (size[2] > size[row.w]) row.w = 2;
    row.u = (row.w + 1) % 3;
    row.v = (row.w + 2) % 3;
    if (last[row.v] - first[row.v] > last[row.u] - first[row.u]) {
        uint32_t swap = row.u;
        row.u = row.v;
        row.v = swap;
    }
    scan_rows(q, n, t, first, last, &row, fn, user);
}

bool svo_raster_box(const int32_t q[3][3], const int32_t lo[3], const int32_t hi[3])
{
    for (int k = 0; k < 3; k++) {
        if (max32(q[0][k], max32(q[1][k], q[2][k])) < lo[k]) return false;
        if (min32(q[0][k], min32(q[1][k], q[2][k])) > hi[k]) return false;
    }
    int64_t n[3];
    wide centre = 0, radius = 0; /* of the box along the normal, relative to the plane, doubled */
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        n[k] = ((int64_t)q[1][i] - q[0][i]) * ((int64_t)q[2][j] - q[0][j]) - ((int64_t)q[1][j] - q[0][j]) * ((int64_t)q[2][i] - q[0][i]);
        centre += (wide)n[k] * ((int64_t)lo[k] + hi[k] - 2 * (int64_t)q[0][k]);
        radius += (wide)abs64(n[k]) * ((int64_t)hi[k] - lo[k]);
    }
    if (centre > radius || centre < -radius) return false;
    for (int o = 0; o < 3; o++) {
        int a = (o + 1) % 3, b = (o + 2) % 3;
        int64_t sign = n[o] < 0 ? -1 : 1;
        for (int i = 0; i < 3; i++) {
            const int32_t *p = q[i], *next = q[i == 2 ? 0 : i + 1];
            int64_t ka = -sign * ((int64_t)next[b] - p[b]), kb = sign * ((int64_t)next[a] - p[a]);
            int64_t best = max64(ka * ((int64_t)lo[a] - p[a]), ka * ((int64_t)hi[a] - p[a])) +
                           max64(kb * ((int64_t)lo[b] - p[b]), kb * ((int64_t)hi[b] - p[b]));
            if (best < 0) return false;
        }
    }
    return true;
}
