/* Meshes for the skeleton tests: growing lists of points and triangles, and the analytic shapes whose curve is known. */
#ifndef SKEL_SHAPES_H
#define SKEL_SHAPES_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "skel_build.h"

typedef struct shape { double *p; uint32_t *t; uint64_t points, triangles, room_p, room_t; } shape;

static inline uint32_t shape_point(shape *s, double x, double y, double z)
{
    if (s->points == s->room_p) s->p = realloc(s->p, (s->room_p = s->room_p * 2 + 64) * 3 * sizeof *s->p);
    s->p[3 * s->points] = x;
    s->p[3 * s->points + 1] = y;
    s->p[3 * s->points + 2] = z;
    return (uint32_t)s->points++;
}

static inline void shape_triangle(shape *s, uint32_t a, uint32_t b, uint32_t c)
{
    if (s->triangles == s->room_t) s->t = realloc(s->t, (s->room_t = s->room_t * 2 + 64) * 3 * sizeof *s->t);
    s->t[3 * s->triangles] = a;
    s->t[3 * s->triangles + 1] = b;
    s->t[3 * s->triangles++ + 2] = c;
}

static inline void shape_free(shape *s)
{
    free(s->p);
    free(s->t);
    memset(s, 0, sizeof *s);
}

#define SHAPE_TAU 6.283185307179586

/* Closed tube along x from 0 to length; n segments along, m around. */
static inline shape shape_tube(double length, double radius, int n, int m)
{
    shape s = {0};
    for (int i = 0; i <= n; i++)
        for (int j = 0; j < m; j++) shape_point(&s, length * i / n, radius * cos(SHAPE_TAU * j / m), radius * sin(SHAPE_TAU * j / m));
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) {
            uint32_t a = (uint32_t)(i * m + j), b = (uint32_t)(i * m + (j + 1) % m), c = a + (uint32_t)m, d = b + (uint32_t)m;
            shape_triangle(&s, a, b, c);
            shape_triangle(&s, b, d, c);
        }
    uint32_t first = shape_point(&s, 0, 0, 0), last = shape_point(&s, length, 0, 0);
    for (int j = 0; j < m; j++) {
        shape_triangle(&s, first, (uint32_t)((j + 1) % m), (uint32_t)j);
        shape_triangle(&s, last, (uint32_t)(n * m + j), (uint32_t)(n * m + (j + 1) % m));
    }
    return s;
}

/* Torus about z. */
static inline shape shape_torus(double big, double small, int n, int m)
{
    shape s = {0};
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) {
            double u = SHAPE_TAU * i / n, v = SHAPE_TAU * j / m, r = big + small * cos(v);
            shape_point(&s, r * cos(u), r * sin(u), small * sin(v));
        }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) {
            uint32_t a = (uint32_t)(i * m + j), b = (uint32_t)(i * m + (j + 1) % m), c = (uint32_t)((i + 1) % n * m + j), d = (uint32_t)((i + 1) % n * m + (j + 1) % m);
            shape_triangle(&s, a, c, b);
            shape_triangle(&s, b, c, d);
        }
    return s;
}

static inline shape shape_sphere(double radius, int n, int m)
{
    shape s = {0};
    for (int i = 1; i < n; i++)
        for (int j = 0; j < m; j++) {
            double u = SHAPE_TAU / 2 * i / n, v = SHAPE_TAU * j / m;
            shape_point(&s, radius * sin(u) * cos(v), radius * sin(u) * sin(v), radius * cos(u));
        }
    uint32_t top = shape_point(&s, 0, 0, radius), bottom = shape_point(&s, 0, 0, -radius);
    for (int j = 0; j < m; j++) {
        uint32_t k = (uint32_t)((j + 1) % m), last = (uint32_t)((n - 2) * m);
        shape_triangle(&s, top, (uint32_t)j, k);
        shape_triangle(&s, bottom, last + k, last + (uint32_t)j);
        for (int i = 0; i + 2 < n; i++) {
            uint32_t row = (uint32_t)(i * m), next = row + (uint32_t)m;
            shape_triangle(&s, row + (uint32_t)j, next + (uint32_t)j, row + k);
            shape_triangle(&s, row + k, next + (uint32_t)j, next + k);
        }
    }
    return s;
}

/* Three closed arms from the origin in the xy-plane, 120 degrees apart: three ends and one branch. Arms overlap at the centre. */
static inline shape shape_star(double length, double radius, int n, int m)
{
    shape s = {0};
    for (int arm = 0; arm < 3; arm++) {
        shape t = shape_tube(length, radius, n, m);
        uint32_t base = (uint32_t)s.points;
        double c = cos(SHAPE_TAU * arm / 3), d = sin(SHAPE_TAU * arm / 3);
        for (uint64_t i = 0; i < t.points; i++)
            shape_point(&s, c * t.p[3 * i] - d * t.p[3 * i + 1], d * t.p[3 * i] + c * t.p[3 * i + 1], t.p[3 * i + 2]);
        for (uint64_t i = 0; i < t.triangles; i++) shape_triangle(&s, base + t.t[3 * i], base + t.t[3 * i + 1], base + t.t[3 * i + 2]);
        shape_free(&t);
    }
    return s;
}

static inline svo_result shape_skeleton(const shape *s, const skel_options *o, skel_skeleton *out, svo_error *err)
{
    svo_part part = {.material = SVO_NONE, .vertex_count = s->points, .triangle_count = s->triangles, .positions = s->p, .indices = s->t};
    svo_shape sh = {.part_count = 1, .parts = &part};
    svo_instance in = {.transform = svo_mat4_identity()};
    svo_mesh mesh = {.shape_count = 1, .instance_count = 1, .shapes = &sh, .instances = &in};
    return skel_build_mesh(&mesh, o, out, err);
}

/* Distance of p from the nearest bone or joint. */
static inline double shape_curve_distance(const skel_skeleton *s, const double *p)
{
    double best = INFINITY;
    for (uint32_t j = 0; j < s->joint_count; j++) {
        const double *q = s->joints[j].position;
        best = fmin(best, sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) + (p[2] - q[2]) * (p[2] - q[2])));
    }
    for (uint32_t b = 0; b < s->bone_count; b++) {
        const double *a = s->joints[s->bones[b].a].position, *c = s->joints[s->bones[b].b].position;
        double d[3], t = 0, l = 0, e = 0;
        for (int k = 0; k < 3; k++) {
            d[k] = c[k] - a[k];
            t += d[k] * (p[k] - a[k]);
            l += d[k] * d[k];
        }
        t = l > 0 ? fmin(1, fmax(0, t / l)) : 0;
        for (int k = 0; k < 3; k++) e += (p[k] - a[k] - t * d[k]) * (p[k] - a[k] - t * d[k]);
        best = fmin(best, sqrt(e));
    }
    return best;
}

/* Mean distance of the points of curve a from curve b (sampled along the bones), and the reverse: the larger. */
static inline double shape_curves_apart(const skel_skeleton *a, const skel_skeleton *b)
{
    double worst = 0;
    for (int turn = 0; turn < 2; turn++) {
        const skel_skeleton *x = turn ? b : a, *y = turn ? a : b;
        double sum = 0;
        uint64_t n = 0;
        for (uint32_t i = 0; i < x->bone_count; i++) {
            const double *p = x->joints[x->bones[i].a].position, *q = x->joints[x->bones[i].b].position;
            for (int k = 0; k <= 16; k++) {
                double m[3];
                for (int c = 0; c < 3; c++) m[c] = p[c] + (q[c] - p[c]) * k / 16;
                sum += shape_curve_distance(y, m);
                n++;
            }
        }
        for (uint32_t j = 0; x->bone_count == 0 && j < x->joint_count; j++, n++) sum += shape_curve_distance(y, x->joints[j].position);
        if (n > 0) worst = fmax(worst, sum / (double)n);
    }
    return worst;
}
#endif
