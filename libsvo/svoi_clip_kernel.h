/* The clip itself, for as many voxels at a time as LANES says: svo_clip.c and svo_clip_wide.c are made of it, which give the same results to the bit. */
#ifndef LANES
#error "how many voxels at a time?"
#endif
#include <math.h>
#include <string.h>
#ifdef __SSE2__
#include <immintrin.h>
#endif

#include "svoi_clip.h"

/* gcc and clang both have these, and split them where the machine's registers are shorter. By pointer, because
 * passing them by value depends on the machine. */
typedef float lanes __attribute__((vector_size(4 * LANES)));
typedef int32_t masks __attribute__((vector_size(4 * LANES)));

/* a = max(a, b), a = min(a, b); a stays where b is not a number, which is what the machine's instructions do too. */
static inline void raise(lanes *a, const lanes *b)
{
#if LANES == 16 && defined(__AVX512F__)
    *a = (lanes)_mm512_max_ps((__m512)*b, (__m512)*a);
#elif LANES == 8 && defined(__AVX__)
    *a = (lanes)_mm256_max_ps((__m256)*b, (__m256)*a);
#else
    masks m = *b > *a;
    *a = (lanes)((m & (masks)*b) | (~m & (masks)*a));
#endif
}
static inline void lower(lanes *a, const lanes *b)
{
#if LANES == 16 && defined(__AVX512F__)
    *a = (lanes)_mm512_min_ps((__m512)*b, (__m512)*a);
#elif LANES == 8 && defined(__AVX__)
    *a = (lanes)_mm256_min_ps((__m256)*b, (__m256)*a);
#else
    masks m = *b < *a;
    *a = (lanes)((m & (masks)*b) | (~m & (masks)*a));
#endif
}
static inline void clamp(lanes *a, float low, float high)
{
    lanes l = (lanes){0} + low, h = (lanes){0} + high;
    raise(a, &l);
    lower(a, &h);
}

/* An interval of a line's parameter, and the cuts that narrow it. */
typedef struct span { lanes begin, end; } span;

/* -1/2 <= at + t m <= 1/2 */
static inline void cut_slab(span *s, const lanes *at, const svoi_clip_slab *c)
{
    lanes middle = *at * c->inverse, low = middle - c->half, high = middle + c->half;
    raise(&s->begin, &low);
    lower(&s->end, &high);
}

/* at + t m >= 0 */
static inline void cut_half(span *s, const lanes *at, const svoi_clip_half *h)
{
    lanes low = *at * h->low, high = *at * h->high;
    raise(&s->begin, &low);
    lower(&s->end, &high);
}

/* Green's theorem: sums over the boundary, relative to the voxel's centre. */
typedef struct sums { lanes area, x, y, xx, xy, yy; } sums;

/* The segment (x, y) + t d */
static inline void add(sums *s, const span *t, const lanes *x, const lanes *y, float dx, float dy, float sign, const svoi_clip_parts want)
{
    const lanes zero = {0};
    lanes length = t->end - t->begin;
    raise(&length, &zero);
    const lanes cross = (*x * dy - *y * dx) * (sign * length);
    s->area += cross;
    if (want == SVOI_CLIP_AREAS) return;
    const lanes middle = 0.5f * (t->begin + t->end), mx = *x + middle * dx, my = *y + middle * dy;
    s->x += cross * mx;
    s->y += cross * my;
    if (want == SVOI_CLIP_MOMENTS) {
        lanes hx = 0.5f * length * dx, hy = 0.5f * length * dy;
        s->xx += cross * (3 * mx * mx + hx * hx);
        s->xy += cross * (3 * mx * my + hx * hy);
        s->yy += cross * (3 * my * my + hy * hy);
    }
}

static inline void clip(const svoi_clipper *c, svoi_clip_batch *b, uint32_t first, const svoi_clip_parts want)
{
    const svoi_clip_lines *l = &c->lines;
    const float gx = c->gradient[0], gy = c->gradient[1];
    const lanes zero = {0};
    lanes x, y, z, inside[3];
    memcpy(&x, b->x + first, sizeof x);
    memcpy(&y, b->y + first, sizeof y);
    memcpy(&z, b->z + first, sizeof z);
    x += 0.5f;
    y += 0.5f;
    z = gx * x + gy * y + c->height - (z + 0.5f); /* the plane over the voxel's centre */
    for (int k = 0; k < 3; k++) inside[k] = c->edge[k].a[0] * x + c->edge[k].a[1] * y + c->edge[k].offset;
    sums s = {zero, zero, zero, zero, zero, zero};
    for (int k = 0; k < 2; k++) { /* the column's sides, counter-clockwise: along x at y = at, along y at x = at */
        const float at = k == 0 ? -0.5f : 0.5f, turn = k == 0 ? 1 : -1;
        const lanes fixed = zero + at;
        span t = {zero - 0.5f, zero + 0.5f};
        lanes value = z + at * gy;
        cut_slab(&t, &value, &l->height_x);
        for (int e = 0; e < 3; e++) {
            value = inside[e] + at * c->edge[e].a[1];
            cut_half(&t, &value, &l->along_x[e]);
        }
        add(&s, &t, &zero, &fixed, 1, 0, turn, want);
        t = (span){zero - 0.5f, zero + 0.5f};
        value = z + at * gx;
        cut_slab(&t, &value, &l->height_y);
        for (int e = 0; e < 3; e++) {
            value = inside[e] + at * c->edge[e].a[0];
            cut_half(&t, &value, &l->along_y[e]);
        }
        add(&s, &t, &fixed, &zero, 0, 1, -turn, want);
    }
    for (int k = 0; k < 3; k++) { /* the triangle's edges */
        const svoi_clip_edge *e = &c->edge[k];
        lanes near = (x - e->q[0]) * e->d[0] + (y - e->q[1]) * e->d[1]; /* of the line, to the voxel's centre */
        lanes px = e->q[0] + near * e->d[0] - x, py = e->q[1] + near * e->d[1] - y, pz = z + gx * px + gy * py;
        span t = {e->begin - near, e->end - near};
        cut_slab(&t, &px, &l->edge_x[k]);
        cut_slab(&t, &py, &l->edge_y[k]);
        cut_slab(&t, &pz, &l->edge_z[k]);
        add(&s, &t, &px, &py, e->d[0], e->d[1], 1, want);
    }
    for (int k = 0; k < 2; k++) { /* where the plane passes the floor and the ceiling */
        const float at = k == 0 ? -0.5f : 0.5f;
        lanes away = (at - z) * l->step, px = gx * away, py = gy * away;
        span t = {zero - l->reach, zero + l->reach};
        cut_slab(&t, &px, &l->level_x);
        cut_slab(&t, &py, &l->level_y);
        for (int e = 0; e < 3; e++) {
            lanes value = inside[e] + c->edge[e].a[0] * px + c->edge[e].a[1] * py;
            cut_half(&t, &value, &l->along_level[e]);
        }
        add(&s, &t, &px, &py, l->dx, l->dy, k == 0 ? 1 : -1, want);
    }
    lanes whole = s.area;
    clamp(&whole, 1e-6f, 4);
    const lanes area = 0.5f * c->per_area * (whole - 1e-6f);
    memcpy(b->area + first, &area, sizeof area);
    if (want == SVOI_CLIP_AREAS) return;
    const lanes inverse = 1 / whole;
    lanes cx = s.x * inverse * (2.0f / 3), cy = s.y * inverse * (2.0f / 3);
    clamp(&cx, -0.5f, 0.5f);
    clamp(&cy, -0.5f, 0.5f);
    if (want == SVOI_CLIP_MOMENTS) {
        lanes xx = s.xx * inverse * (1.0f / 6) - cx * cx, yy = s.yy * inverse * (1.0f / 6) - cy * cy, xy = s.xy * inverse * (1.0f / 6) - cx * cy;
        clamp(&xx, 0, 0.25f);
        clamp(&yy, 0, 0.25f);
        clamp(&xy, -0.25f, 0.25f);
        memcpy(b->xx + first, &xx, sizeof xx);
        memcpy(b->xy + first, &xy, sizeof xy);
        memcpy(b->yy + first, &yy, sizeof yy);
    }
    cx += x;
    cy += y;
    memcpy(b->cx + first, &cx, sizeof cx);
    memcpy(b->cy + first, &cy, sizeof cy);
}

static inline void clip_some(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, const svoi_clip_parts want)
{
    for (; count % LANES != 0; count++) b->x[count] = b->x[0], b->y[count] = b->y[0], b->z[count] = b->z[0];
    for (uint32_t i = 0; i < count; i += LANES) clip(c, b, i, want);
}

static void clip_all(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, svoi_clip_parts want)
{
    switch (want) {
    case SVOI_CLIP_AREAS: clip_some(c, b, count, SVOI_CLIP_AREAS); break;
    case SVOI_CLIP_CENTRES: clip_some(c, b, count, SVOI_CLIP_CENTRES); break;
    case SVOI_CLIP_MOMENTS: clip_some(c, b, count, SVOI_CLIP_MOMENTS); break;
    }
}
