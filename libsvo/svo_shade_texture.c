/* Averages of textures over the parts of triangles in voxels. */
#include "svoi_shade.h"

#include <math.h>

const svo_facet_texture *svoi_facet_texture(svo_facet *t, uint32_t slot, const svo_texture *how, const svo_pyramid *p)
{
    svo_facet_texture *f = &t->texture[slot];
    if (f->ready) return f;
    f->ready = true;
    const float *set = t->part->uvs[how->uv_set];
    for (int k = 0; k < 3; k++) {
        double u = set != NULL ? set[2 * (uint64_t)t->vertex[k]] : 0, v = set != NULL ? set[2 * (uint64_t)t->vertex[k] + 1] : 0;
        f->corner[k][0] = (how->transform[0] * u + how->transform[1] * v + how->transform[2]) * p->width[0];
        f->corner[k][1] = (how->transform[3] * u + how->transform[4] * v + how->transform[5]) * p->height[0];
        /* what no texture can mean must not spread through the arithmetic */
        for (int i = 0; i < 2; i++)
            if (!(fabs(f->corner[k][i]) < 1e12)) f->corner[k][i] = 0;
    }
    double e[2], g[2];
    for (int i = 0; i < 2; i++) {
        e[i] = f->corner[1][i] - f->corner[0][i];
        g[i] = f->corner[2][i] - f->corner[0][i];
        f->per_x[i] = e[i] * t->per_x[0] + g[i] * t->per_x[1];
        f->per_y[i] = e[i] * t->per_y[0] + g[i] * t->per_y[1];
    }
    return f;
}

/* Texel coordinates at a point of the facet. Points of a clipped polygon are inside; others are brought there. */
static void texel_at(const svo_facet *t, const svo_facet_texture *f, const double p[3], bool inside, double out[2])
{
    if (inside && t->normal[t->axis] != 0) {
        double x = p[(t->axis + 1) % 3] - t->corner[0][(t->axis + 1) % 3], y = p[(t->axis + 2) % 3] - t->corner[0][(t->axis + 2) % 3];
        for (int i = 0; i < 2; i++) out[i] = f->corner[0][i] + x * f->per_x[i] + y * f->per_y[i];
        return;
    }
    double b[3];
    svoi_barycentric(t, p, b);
    for (int i = 0; i < 2; i++) out[i] = b[0] * f->corner[0][i] + b[1] * f->corner[1][i] + b[2] * f->corner[2][i];
}

/* Taps that have the variance `rest` together when they are spread evenly, `count` of them. */
static double spacing(double rest, uint32_t count) { return count > 1 && rest > 0 ? sqrt(12 * rest / ((double)count * count - 1)) : 0; }

static uint32_t taps_for(double width, uint32_t most)
{
    if (width < 0.6) return 1;
    double n = ceil(width * (1 / 1.25));
    return n < 2 ? 2 : n < most ? (uint32_t)n : most;
}

/* Average of a texture over a piece: readings of one mip level, on a lattice along the long and the short axis of the piece's
 * footprint in the texture. Readings, with the filter that is in the level, have the covariance of the footprint, so that the average is
 * right for every image that varies at most quadratically over it. The level follows from the short axis. */
void svoi_read_texture(svo_facet *t, uint32_t slot, const svo_texture *how, const svo_pyramid *p, const svo_piece *piece, float out[4])
{
    enum { MOST = 128 };
    const svo_facet_texture *f = svoi_facet_texture(t, slot, how, p);
    double at[2], width = 1.0 / p->width[0], height = 1.0 / p->height[0];
    texel_at(t, f, piece->centre, t->clips, at);
    /* covariance in texels, its two variances and the direction of the larger */
    const double a = f->per_x[0], b = f->per_y[0], c = f->per_x[1], d = f->per_y[1];
    double uu = a * a * piece->xx + 2 * a * b * piece->xy + b * b * piece->yy, vv = c * c * piece->xx + 2 * c * d * piece->xy + d * d * piece->yy;
    double uv = a * c * piece->xx + (a * d + b * c) * piece->xy + b * d * piece->yy;
    double middle = 0.5 * (uu + vv), half = 0.5 * (uu - vv), root = sqrt(half * half + uv * uv);
    double large = middle + root, small = middle - root > 0 ? middle - root : 0;
    if (!(large > 0.03)) { /* narrower than 0.6 texels (or not a number) */
        svo_pyramid_sample(p, how, at[0] * width, at[1] * height, 0, out);
        return;
    }
    double x = uv, y = large - uu;
    if (uu > vv) x = large - vv, y = uv;
    double norm = sqrt(x * x + y * y);
    x = norm > 0 ? x / norm : 1;
    y = norm > 0 ? y / norm : 0;
    const double length = sqrt(12 * large), breadth = sqrt(12 * small);
    /* A level of texels of size s has a variance of (s^2 - 1) / 4 (box and tent, less that of the image itself), which has to fit
     * into the footprint: s <= breadth / sqrt(3), or a little more; larger where the number of readings asks for it. */
    uint32_t level = 0, m = 0, n = 0;
    double size = 1;
    for (;; level++, size *= 2) {
        m = taps_for(breadth / size, 4);
        n = taps_for(length / size, MOST / m);
        if (level + 1 >= p->levels) break;
        if (2 * size <= 0.58 * breadth) continue;
        if (length <= 1.6 * size * (MOST / m)) break;
    }
    if (how->nearest && level == 0) { /* hard edges between texels: more readings */
        m = m < 4 ? m + 2 : m;
        n = n < 4 ? n + 2 : n;
    }
    const double inherent = (size * size - 1) * 0.25, step = spacing(large - inherent, n), across = spacing(small - inherent, m);
    float sum[4] = {0, 0, 0, 0};
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t j = 0; j < m; j++) {
            float texel[4];
            const double r = (i - 0.5 * (n - 1)) * step, q = (j - 0.5 * (m - 1)) * across;
            svo_pyramid_sample(p, how, (at[0] + r * x - q * y) * width, (at[1] + r * y + q * x) * height, level, texel);
            for (int k = 0; k < 4; k++) sum[k] += texel[k];
        }
    for (int k = 0; k < 4; k++) out[k] = sum[k] / (float)(n * m);
}

/* Colours are stored times alpha. Where the readings met only what is hidden, the colour is that of the nearest level that has one. */
void svoi_unmultiply(svo_facet *t, const svo_texture *how, const svo_pyramid *p, const svo_piece *piece, float texel[4])
{
    float colour[4] = {texel[0], texel[1], texel[2], texel[3]};
    for (uint32_t level = 1; !(colour[3] > 0) && level < p->levels; level++) {
        double at[2];
        texel_at(t, svoi_facet_texture(t, BASE, how, p), piece->centre, t->clips, at);
        svo_pyramid_sample(p, how, at[0] / p->width[0], at[1] / p->height[0], level, colour);
    }
    for (int i = 0; i < 3; i++) texel[i] = colour[3] > 0 ? colour[i] / colour[3] : 0;
}

/* Largest alpha (red for a linear image) that a texture has anywhere in the polygon. */
double svoi_most_alpha(svo_facet *t, uint32_t slot, const svo_texture *how, const svo_pyramid *p, const svo_polygon *polygon, const double centre[3])
{
    const svo_facet_texture *f = svoi_facet_texture(t, slot, how, p);
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, most = 0, width = p->width[0], height = p->height[0];
    bool color = p->kind == SVO_TEXEL_COLOR_ALPHA;
    for (uint32_t k = 0; k <= polygon->count; k++) {
        double at[2];
        float texel[4];
        texel_at(t, f, k == polygon->count ? centre : polygon->at[k], polygon->count > 0, at);
        svo_pyramid_sample(p, how, at[0] / width, at[1] / height, 0, texel);
        double alpha = (double)(color ? texel[3] : texel[0]);
        if (alpha > most) most = alpha;
        for (int i = 0; i < 2; i++) {
            if (at[i] < low[i]) low[i] = at[i];
            if (at[i] > high[i]) high[i] = at[i];
        }
    }
    /* Smaller than a texel: the readings above have seen it all. Larger: look at every texel. */
    if (!color || (high[0] - low[0] <= 1 && high[1] - low[1] <= 1)) return most;
    double texels = (double)svo_pyramid_most_alpha(p, how, low[0] / width, high[0] / width, low[1] / height, high[1] / height);
    return texels > most ? texels : most;
}
