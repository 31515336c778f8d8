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
typedef struct slab { float inverse, half; } slab; /* -1 / m, 1 / |2 m|; of what is parallel far away */
static inline void cut_slab(span *s, const lanes *at, const slab *c)
{
    lanes middle = *at * c->inverse, low = middle - c->half, high = middle + c->half;
    raise(&s->begin, &low);
    lower(&s->end, &high);
}

/* at + t m >= 0: a lower bound when m > 0, an upper one when not */
typedef struct half_plane { float inverse; bool below; } half_plane;
static inline void cut_half(span *s, const lanes *at, const half_plane *h)
{
    lanes bound = *at * h->inverse;
    if (h->below) lower(&s->end, &bound); /* the same for every voxel of the triangle */
    else raise(&s->begin, &bound);
}

/* Green's theorem: sums over the boundary, relative to the voxel's centre. */
typedef enum parts { AREAS, CENTRES, MOMENTS } parts; /* what is summed, each with what is before it */
typedef struct sums { lanes area, x, y, xx, xy, yy; } sums;

/* The segment (x, y) + t d */
static inline void add(sums *s, const span *t, const lanes *x, const lanes *y, float dx, float dy, float sign, const parts want)
{
    const lanes zero = {0};
    lanes length = t->end - t->begin;
    raise(&length, &zero);
    const lanes cross = (*x * dy - *y * dx) * (sign * length);
    s->area += cross;
    if (want == AREAS) return;
    const lanes middle = 0.5f * (t->begin + t->end), mx = *x + middle * dx, my = *y + middle * dy;
    s->x += cross * mx;
    s->y += cross * my;
    if (want == MOMENTS) {
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
    enum { COUNT = 24 };
    const float gx = c->gradient[0], gy = c->gradient[1], g2 = gx * gx + gy * gy, slope = sqrtf(g2);
    const bool level = !(slope > parallel); /* no such lines: the whole plane lies between two */
    const float turn = level ? 0 : 1 / slope;
    l->dx = gy * turn;
    l->dy = -gx * turn;
    l->step = level ? 0 : 1 / g2;
    l->reach = level ? 0 : 2;
    /* all slopes, and their reciprocals at once */
    float m[COUNT] = {gx, gy, l->dx, l->dy}, inverse[COUNT];
    for (int k = 0; k < 3; k++) {
        const svoi_clip_edge *e = &c->edge[k];
        m[6 * k + 4] = e->a[0];
        m[6 * k + 5] = e->a[1];
        m[6 * k + 6] = e->a[0] * l->dx + e->a[1] * l->dy;
        m[6 * k + 7] = e->d[0];
        m[6 * k + 8] = e->d[1];
        m[6 * k + 9] = e->slope;
    }
    for (int i = 0; i < COUNT; i++) inverse[i] = fabsf(m[i]) > parallel ? -1 / m[i] : -1e8f;
    slab s[COUNT];
    for (int i = 0; i < COUNT; i++) s[i] = (slab){inverse[i], 0.5f * fabsf(inverse[i])};
    l->height_x = s[0], l->height_y = s[1], l->level_x = s[2], l->level_y = s[3];
    for (int k = 0; k < 3; k++) {
        const int i = 6 * k + 4;
        l->along_x[k] = (half_plane){inverse[i], m[i] < -parallel};
        l->along_y[k] = (half_plane){inverse[i + 1], m[i + 1] < -parallel};
        l->along_level[k] = (half_plane){inverse[i + 2], m[i + 2] < -parallel};
        l->edge_x[k] = s[i + 3], l->edge_y[k] = s[i + 4], l->edge_z[k] = s[i + 5];
    }
}

static inline void clip(const svoi_clipper *c, const lines *l, svoi_clip_batch *b, uint32_t first, const parts want)
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
    if (want == AREAS) return;
    const lanes inverse = 1 / whole;
    lanes cx = s.x * inverse * (2.0f / 3), cy = s.y * inverse * (2.0f / 3);
    clamp(&cx, -0.5f, 0.5f);
    clamp(&cy, -0.5f, 0.5f);
    if (want == MOMENTS) {
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

static inline void clip_all(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, const parts want)
{
    lines l;
    lines_of(c, &l);
    for (; count % LANES != 0; count++) b->x[count] = b->x[0], b->y[count] = b->y[0], b->z[count] = b->z[0];
    for (uint32_t i = 0; i < count; i += LANES) clip(c, &l, b, i, want);
}

void svoi_clip(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, bool moments)
{
    if (moments) clip_all(c, b, count, MOMENTS);
    else clip_all(c, b, count, CENTRES);
}

void svoi_clip_areas(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count) { clip_all(c, b, count, AREAS); }
