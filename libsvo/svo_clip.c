#define LANES 8
#include "svoi_clip_kernel.h"

/* Directions that differ by less than this are taken as parallel: the cuts of lines that nearly coincide would be lost in rounding. */
static const float parallel = 1e-4f;

static svoi_clip_half half_of(float inverse, bool below) { return below ? (svoi_clip_half){NAN, inverse} : (svoi_clip_half){inverse, NAN}; }

static void find_lines(svoi_clipper *c)
{
    enum { COUNT = 24 };
    svoi_clip_lines *l = &c->lines;
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
    svoi_clip_slab s[COUNT];
    for (int i = 0; i < COUNT; i++) s[i] = (svoi_clip_slab){inverse[i], 0.5f * fabsf(inverse[i])};
    l->height_x = s[0], l->height_y = s[1], l->level_x = s[2], l->level_y = s[3];
    for (int k = 0; k < 3; k++) {
        const int i = 6 * k + 4;
        l->along_x[k] = half_of(inverse[i], m[i] < -parallel);
        l->along_y[k] = half_of(inverse[i + 1], m[i + 1] < -parallel);
        l->along_level[k] = half_of(inverse[i + 2], m[i + 2] < -parallel);
        l->edge_x[k] = s[i + 3], l->edge_y[k] = s[i + 4], l->edge_z[k] = s[i + 5];
    }
}

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
    find_lines(c);
    return true;
}

static void choose(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, svoi_clip_parts want)
{
    (svoi_clip_has_wide() ? svoi_clip_wide : clip_all)(c, b, count, want);
}

void svoi_clip(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, bool moments)
{
    choose(c, b, count, moments ? SVOI_CLIP_MOMENTS : SVOI_CLIP_CENTRES);
}

void svoi_clip_areas(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count) { choose(c, b, count, SVOI_CLIP_AREAS); }

void svoi_clip_narrow(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, svoi_clip_parts want) { clip_all(c, b, count, want); }
