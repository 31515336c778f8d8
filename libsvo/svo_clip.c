#include "svoi_clip.h"

#include <math.h>
#include <string.h>

/* Directions that differ by less than this are taken as parallel: the cuts of lines that nearly coincide would be lost in rounding. */
static const float parallel = 1e-4f;

/* Eight voxels at a time; gcc and clang both have these, and split them where the machine's registers are shorter. By pointer, because
 * passing them by value depends on the machine. */
enum { LANES = 8 };
typedef float lanes __attribute__((vector_size(4 * LANES)));
typedef int32_t masks __attribute__((vector_size(4 * LANES)));

static inline float inverse_of(float m) { return m > parallel || m < -parallel ? 1 / m : 1e8f; }

bool svoi_clipper_make(svoi_clipper *c, const double v[3][3])
{
    double n[3];
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        n[k] = (v[1][i] - v[0][i]) * (v[2][j] - v[0][j]) - (v[1][j] - v[0][j]) * (v[2][i] - v[0][i]);
    }
    uint32_t w = fabs(n[1]) > fabs(n[0]) ? 1 : 0;
    if (fabs(n[2]) > fabs(n[w])) w = 2;
    if (!(fabs(n[w]) > 1e-12)) return false;
    const uint32_t i = (w + 1) % 3, j = (w + 2) % 3;
    c->axis = w;
    const double gx = -n[i] / n[w], gy = -n[j] / n[w];
    c->gradient[0] = (float)gx;
    c->gradient[1] = (float)gy;
    c->height = (float)(v[0][w] - gx * v[0][i] - gy * v[0][j]);
    c->per_area = (float)(sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / fabs(n[w]));
    for (uint32_t k = 0; k < 3; k++) { /* counter-clockwise in (x, y) */
        const double *a = v[k], *b = v[(k + 1) % 3];
        if (n[w] < 0) a = v[(k + 1) % 3], b = v[k];
        double dx = b[i] - a[i], dy = b[j] - a[j], length = sqrt(dx * dx + dy * dy);
        if (!(length > 0)) return false;
        dx /= length;
        dy /= length;
        svoi_clip_edge *e = &c->edge[k];
        double begin = a[i] * dx + a[j] * dy;
        e->q[0] = (float)(a[i] - begin * dx);
        e->q[1] = (float)(a[j] - begin * dy);
        e->d[0] = (float)dx;
        e->d[1] = (float)dy;
        e->begin = (float)begin;
        e->end = (float)(begin + length);
        e->a[0] = (float)-dy;
        e->a[1] = (float)dx;
        e->offset = (float)(dy * a[i] - dx * a[j]);
        e->slope = (float)(gx * dx + gy * dy);
    }
    return true;
}

/* a = max(a, b), a = min(a, b) */
static inline void raise(lanes *a, const lanes *b)
{
    masks m = *b > *a;
    *a = (lanes)((m & (masks)*b) | (~m & (masks)*a));
}
static inline void lower(lanes *a, const lanes *b)
{
    masks m = *b < *a;
    *a = (lanes)((m & (masks)*b) | (~m & (masks)*a));
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
typedef struct slab { float inverse, half; } slab; /* 1 / m, 1 / |2 m| */
static inline slab slab_of(float m) { return (slab){-inverse_of(m), 0.5f * fabsf(inverse_of(m))}; }
static inline void cut_slab(span *s, const lanes *at, const slab *c)
{
    lanes middle = *at * c->inverse, low = middle - c->half, high = middle + c->half;
    raise(&s->begin, &low);
    lower(&s->end, &high);
}

/* at + t m >= 0: a lower bound when m > 0, an upper one when not */
typedef struct half_plane { float inverse; bool below; } half_plane;
static inline half_plane half_plane_of(float m) { return (half_plane){-inverse_of(m), m < -parallel}; }
static inline void cut_half(span *s, const lanes *at, const half_plane *h)
{
    lanes bound = *at * h->inverse;
    if (h->below) lower(&s->end, &bound); /* the same for every voxel of the triangle */
    else raise(&s->begin, &bound);
}

/* Green's theorem: sums over the boundary, relative to the voxel's centre. */
typedef struct sums { lanes area, x, y, xx, xy, yy; } sums;

/* The segment (x, y) + t d */
static inline void add(sums *s, const span *t, const lanes *x, const lanes *y, float dx, float dy, float sign, bool moments)
{
    const lanes zero = {0};
    lanes length = t->end - t->begin, middle = 0.5f * (t->begin + t->end);
    raise(&length, &zero);
    lanes cross = (*x * dy - *y * dx) * (sign * length), mx = *x + middle * dx, my = *y + middle * dy;
    s->area += cross;
    s->x += cross * mx;
    s->y += cross * my;
    if (moments) {
        lanes hx = 0.5f * length * dx, hy = 0.5f * length * dy;
        s->xx += cross * (3 * mx * mx + hx * hx);
        s->xy += cross * (3 * mx * my + hx * hy);
        s->yy += cross * (3 * my * my + hy * hy);
    }
}

/* What is the same for all voxels. */
typedef struct lines {
    half_plane along_x[3], along_y[3], along_level[3]; /* edges that cut sides and lines of constant height */
    slab height_x, height_y;           /* heights along the sides */
    slab level_x, level_y;             /* sides that cut lines of constant height */
    float dx, dy, step, reach;         /* direction of those lines, gradient / |gradient|^2 to the next, half their length */
    slab edge_x[3], edge_y[3], edge_z[3];
} lines;

static void lines_of(const svoi_clipper *c, lines *l)
{
    const float gx = c->gradient[0], gy = c->gradient[1], g2 = gx * gx + gy * gy, slope = sqrtf(g2);
    const bool level = !(slope > parallel); /* no such lines: the whole plane lies between two */
    l->height_x = slab_of(gx);
    l->height_y = slab_of(gy);
    l->dx = level ? 0 : gy / slope;
    l->dy = level ? 0 : -gx / slope;
    l->step = level ? 0 : 1 / g2;
    l->reach = level ? 0 : 2;
    l->level_x = slab_of(l->dx);
    l->level_y = slab_of(l->dy);
    for (int k = 0; k < 3; k++) {
        const svoi_clip_edge *e = &c->edge[k];
        l->along_x[k] = half_plane_of(e->a[0]);
        l->along_y[k] = half_plane_of(e->a[1]);
        l->along_level[k] = half_plane_of(e->a[0] * l->dx + e->a[1] * l->dy);
        l->edge_x[k] = slab_of(e->d[0]);
        l->edge_y[k] = slab_of(e->d[1]);
        l->edge_z[k] = slab_of(e->slope);
    }
}

static inline void clip(const svoi_clipper *c, const lines *l, svoi_clip_batch *b, uint32_t first, const bool moments)
{
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
        add(&s, &t, &zero, &fixed, 1, 0, turn, moments);
        t = (span){zero - 0.5f, zero + 0.5f};
        value = z + at * gx;
        cut_slab(&t, &value, &l->height_y);
        for (int e = 0; e < 3; e++) {
            value = inside[e] + at * c->edge[e].a[0];
            cut_half(&t, &value, &l->along_y[e]);
        }
        add(&s, &t, &fixed, &zero, 0, 1, -turn, moments);
    }
    for (int k = 0; k < 3; k++) { /* the triangle's edges */
        const svoi_clip_edge *e = &c->edge[k];
        lanes near = (x - e->q[0]) * e->d[0] + (y - e->q[1]) * e->d[1]; /* of the line, to the voxel's centre */
        lanes px = e->q[0] + near * e->d[0] - x, py = e->q[1] + near * e->d[1] - y, pz = z + gx * px + gy * py;
        span t = {e->begin - near, e->end - near};
        cut_slab(&t, &px, &l->edge_x[k]);
        cut_slab(&t, &py, &l->edge_y[k]);
        cut_slab(&t, &pz, &l->edge_z[k]);
        add(&s, &t, &px, &py, e->d[0], e->d[1], 1, moments);
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
        add(&s, &t, &px, &py, l->dx, l->dy, k == 0 ? 1 : -1, moments);
    }
    lanes whole = s.area;
    clamp(&whole, 1e-6f, 4);
    const lanes inverse = 1 / whole;
    lanes cx = s.x * inverse * (2.0f / 3), cy = s.y * inverse * (2.0f / 3), area = 0.5f * c->per_area * (whole - 1e-6f);
    clamp(&cx, -0.5f, 0.5f);
    clamp(&cy, -0.5f, 0.5f);
    if (moments) {
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
    memcpy(b->area + first, &area, sizeof area);
    memcpy(b->cx + first, &cx, sizeof cx);
    memcpy(b->cy + first, &cy, sizeof cy);
}

void svoi_clip(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, bool moments)
{
    lines l;
    lines_of(c, &l);
    for (; count % LANES != 0; count++) b->x[count] = b->x[0], b->y[count] = b->y[0], b->z[count] = b->z[0];
    if (moments)
        for (uint32_t i = 0; i < count; i += LANES) clip(c, &l, b, i, true);
    else
        for (uint32_t i = 0; i < count; i += LANES) clip(c, &l, b, i, false);
}
