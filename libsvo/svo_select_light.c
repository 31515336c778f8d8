/* What can throw a shadow on what is seen: seen along the light, depths of the farthest surface that is seen in each texel, with a pyramid of minima. */
#include <math.h>
#include <string.h>

#include "svoi_select_jobs.h"

enum { LEVELS = 10, SIDE = 1 << (LEVELS - 1) };

struct svo_light_mask {
    const svo_allocator *allocator;
    double axis[3][3], low[2], per_texel; /* axis[2]: towards the light */
    float *least[LEVELS]; /* of what is seen, along axis[2]; [0] is the finest */
};

/* Bounds of a box along the axes, `more` wider. */
static void along_axes(const svo_light_mask *m, const double low[3], const double high[3], double more, double from[3], double to[3])
{
    for (int i = 0; i < 3; i++) {
        double middle = 0, half = more;
        for (int k = 0; k < 3; k++) middle += m->axis[i][k] * 0.5 * (low[k] + high[k]), half += fabs(m->axis[i][k]) * 0.5 * (high[k] - low[k]);
        half += 1e-6 * (fabs(middle) + half); /* rounding */
        from[i] = middle - half, to[i] = middle + half;
    }
}

static uint32_t texel(const svo_light_mask *m, int axis, double x)
{
    const double t = (x - m->low[axis]) * m->per_texel;
    return t > 0 ? t < SIDE - 1 ? (uint32_t)t : SIDE - 1 : 0;
}

/* The texels of a box, on the finest level where they are at most three an axis. */
typedef struct span { uint32_t level, x0, y0, x1, y1; } span;
static span span_of(const svo_light_mask *m, const double from[3], const double to[3])
{
    span t = {0, texel(m, 0, from[0]), texel(m, 1, from[1]), texel(m, 0, to[0]), texel(m, 1, to[1])};
    for (; t.x1 - t.x0 > 2 || t.y1 - t.y0 > 2; t.level++) t.x0 >>= 1, t.y0 >>= 1, t.x1 >>= 1, t.y1 >>= 1;
    return t;
}

/* From a surface that is seen a ray to the light begins up to 1.5 * |n|_1 edges of its cell from the cell's middle (svo_render_shadow_origin), with |n|_1 at most the root of three: less than
 * four edges from what is seen. Whether a cell that it passes belongs to the surface depends on the cell's mean normal, to which boxes below it add: with 4 edges for all, 111 of 43,200 pixels of
 * one view of a city (cli.culling) were another, with 16 none of 16 views. */
enum { EDGES_AROUND = 16 };
static void receiver(const svo_light_mask *m, const svo_selected *b, const double overhang[2], double from[3], double to[3])
{
    double low[3], high[3], longest;
    for (int k = 0; k < 3; k++) low[k] = b->low[k], high[k] = b->high[k];
    const double reach = svoi_overhang(overhang, low, high, &longest), edge = reach > longest ? reach : longest; /* no cell of the box has a longer one */
    along_axes(m, low, high, reach + EDGES_AROUND * edge, from, to);
}

svo_result svo_light_mask_make(const svo_selection *seen, svo_vec3 light, const double overhang[2], const svo_allocator *a, svo_light_mask **out, svo_error *err)
{
    svo_light_mask *m = svo_calloc(a, 1, sizeof *m);
    bool ok = m != NULL;
    for (uint32_t l = 0; l < LEVELS && ok; l++) {
        m->allocator = a;
        m->least[l] = svo_alloc(a, (uint64_t)(SIDE >> l) * (SIDE >> l), sizeof(float));
        ok = m->least[l] != NULL;
    }
    if (!ok) {
        svo_light_mask_free(m);
        return svoi_select_no_memory(err);
    }
    const svo_vec3 w = svo_normalize(light), side = fabs(w.x) < 0.6 ? svo_v3(1, 0, 0) : svo_v3(0, 1, 0), u = svo_normalize(svo_cross(w, side)), v = svo_cross(w, u);
    const svo_vec3 axes[3] = {u, v, w};
    for (int i = 0; i < 3; i++) m->axis[i][0] = axes[i].x, m->axis[i][1] = axes[i].y, m->axis[i][2] = axes[i].z;
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, from[3], to[3];
    for (uint64_t i = 0; i < seen->count; i++) {
        receiver(m, &seen->boxes[i], overhang, from, to);
        for (int k = 0; k < 2; k++) low[k] = from[k] < low[k] ? from[k] : low[k], high[k] = to[k] > high[k] ? to[k] : high[k];
    }
    const double longest = fmax(high[0] - low[0], high[1] - low[1]);
    m->low[0] = low[0], m->low[1] = low[1], m->per_texel = longest > 0 ? SIDE / longest : 0;
    for (uint32_t l = 0; l < LEVELS; l++)
        for (uint64_t i = 0; i < (uint64_t)(SIDE >> l) * (SIDE >> l); i++) m->least[l][i] = INFINITY;
    for (uint64_t i = 0; i < seen->count; i++) { /* where it is at most three texels wide */
        receiver(m, &seen->boxes[i], overhang, from, to);
        const span t = span_of(m, from, to);
        const float least = nextafterf((float)from[2], -INFINITY);
        for (uint32_t y = t.y0; y <= t.y1; y++)
            for (uint32_t x = t.x0; x <= t.x1; x++) {
                float *to_least = &m->least[t.level][(uint64_t)y * (SIDE >> t.level) + x];
                *to_least = least < *to_least ? least : *to_least;
            }
    }
    for (uint32_t l = LEVELS - 1; l-- > 0;) /* what is coarse holds for all of its parts, */
        for (uint32_t y = 0, n = SIDE >> l; y < n; y++)
            for (uint32_t x = 0; x < n; x++) {
                float *here = &m->least[l][(uint64_t)y * n + x];
                *here = fminf(*here, m->least[l + 1][(uint64_t)(y / 2) * (n / 2) + x / 2]);
            }
    for (uint32_t l = 1; l < LEVELS; l++) /* and what parts have is asked of the whole */
        for (uint32_t y = 0, n = SIDE >> l; y < n; y++)
            for (uint32_t x = 0; x < n; x++) {
                const float *below = &m->least[l - 1][(uint64_t)2 * y * 2 * n + 2 * x];
                m->least[l][(uint64_t)y * n + x] = fminf(fminf(below[0], below[1]), fminf(below[2 * n], below[2 * n + 1]));
            }
    *out = m;
    return SVO_OK;
}

void svo_light_mask_free(svo_light_mask *m)
{
    if (m == NULL) return;
    for (uint32_t l = 0; l < LEVELS; l++) svo_free(m->allocator, m->least[l], (uint64_t)(SIDE >> l) * (SIDE >> l), sizeof(float));
    svo_free(m->allocator, m, 1, sizeof *m);
}

bool svoi_can_shade(const svo_select_options *o, const double low[3], const double high[3])
{
    const svo_light_mask *m = o->shading;
    double from[3], to[3], longest;
    if (m == NULL) return false;
    along_axes(m, low, high, svoi_overhang(o->overhang, low, high, &longest), from, to);
    /* all of it beside what is seen? */
    for (int k = 0; k < 2; k++)
        if ((to[k] - m->low[k]) * m->per_texel < 0 || (from[k] - m->low[k]) * m->per_texel > SIDE) return false;
    const span t = span_of(m, from, to);
    for (uint32_t y = t.y0; y <= t.y1; y++)
        for (uint32_t x = t.x0; x <= t.x1; x++)
            if ((double)m->least[t.level][(uint64_t)y * (SIDE >> t.level) + x] < to[2]) return true;
    return false;
}
