#include "svoi_lanes.h"

#include <math.h>
#include <string.h>

#include "svoi_channel.h"
#include "svoi_shade.h"
#include "svoi_shade_avx2.h"
#include "svoi_shade_wide.h"

/* --- where -------------------------------------------------------------------------------------------------------- */

/* Every third bit. */
static inline uint32_t compact(uint32_t x)
{
    x &= 0x249249;
    x = (x | x >> 2) & 0x0c30c3;
    x = (x | x >> 4) & 0x00f00f;
    return (x | x >> 8) & 0xff;
}

static uint32_t rounded(uint32_t count) { return (count + 7) & ~7u; }

void svoi_lanes_place(const svo_facet *t, svoi_lanes *l)
{
    const uint32_t n = rounded(l->count), x = (t->axis + 1) % 3, y = (t->axis + 2) % 3, z = t->axis;
    for (uint32_t i = l->count; i < n; i++) l->code[i] = l->code[0];
    if (svoi_clip_has_wide()) {
        svoi_wide_place(x, y, z, l);
        return;
    }
    for (uint32_t i = 0; i < n; i++) {
        l->clip.x[i] = (float)(int32_t)compact(l->code[i] >> x);
        l->clip.y[i] = (float)(int32_t)compact(l->code[i] >> y);
        l->clip.z[i] = (float)(int32_t)compact(l->code[i] >> z);
    }
}

/* Where nothing is cut: the whole facet, or a segment or a point, which has no area. */
static void uncut(const svo_facet *t, svoi_lanes *l)
{
    const uint32_t n = rounded(l->count);
    svo_piece p = {.area = 0};
    if (t->inside) svo_facet_piece(t, &p);
    for (uint32_t i = 0; i < n; i++) {
        l->clip.area[i] = (float)p.area;
        l->clip.cx[i] = t->inside ? (float)p.centre[(t->axis + 1) % 3] : l->clip.x[i] + 0.5f;
        l->clip.cy[i] = t->inside ? (float)p.centre[(t->axis + 2) % 3] : l->clip.y[i] + 0.5f;
        l->clip.xx[i] = (float)p.xx, l->clip.xy[i] = (float)p.xy, l->clip.yy[i] = (float)p.yy;
    }
}

void svoi_lanes_areas(const svo_facet *t, svoi_lanes *l)
{
    svoi_lanes_place(t, l);
    if (t->inside || !t->clips) uncut(t, l);
    else svoi_clip_areas(&t->clipper, &l->clip, l->count);
}

static void find_barycentric(const svo_facet *t, svoi_lanes *l)
{
    const uint32_t n = rounded(l->count), x = (t->axis + 1) % 3, y = (t->axis + 2) % 3;
    if (t->normal[t->axis] == 0) {
        for (uint32_t i = 0; i < n; i++) {
            double at[3], b[3];
            at[x] = (double)l->clip.cx[i], at[y] = (double)l->clip.cy[i], at[t->axis] = (double)l->clip.z[i] + 0.5;
            svoi_barycentric(t, at, b);
            for (int k = 0; k < 3; k++) l->b[k][i] = (float)b[k];
        }
        return;
    }
    /* in single precision from a point in the block on, near the triangle: the same for all batches */
    const float fx = (float)fmin(fmax(t->corner[0][x], 0), 128), fy = (float)fmin(fmax(t->corner[0][y], 0), 128);
    const double ex = (double)fx - t->corner[0][x], ey = (double)fy - t->corner[0][y];
    const float x1 = (float)t->per_x[0], y1 = (float)t->per_y[0], x2 = (float)t->per_x[1], y2 = (float)t->per_y[1];
    const float at1 = (float)(ex * t->per_x[0] + ey * t->per_y[0]), at2 = (float)(ex * t->per_x[1] + ey * t->per_y[1]);
    for (uint32_t i = 0; i < n; i++) {
        const float dx = l->clip.cx[i] - fx, dy = l->clip.cy[i] - fy, b1 = at1 + (dx * x1 + dy * y1), b2 = at2 + (dx * x2 + dy * y2);
        l->b[0][i] = 1 - b1 - b2;
        l->b[1][i] = b1;
        l->b[2][i] = b2;
    }
    /* centroids are inside but for rounding, which is much on needles */
    for (uint32_t i = 0; i < n; i++) {
        float b0 = l->b[0][i] > 0 ? l->b[0][i] : 0, b1 = l->b[1][i] > 0 ? l->b[1][i] : 0, b2 = l->b[2][i] > 0 ? l->b[2][i] : 0;
        float sum = b0 + b1 + b2, inverse = 1 / (sum > 1e-30f ? sum : 1);
        l->b[0][i] = b0 * inverse;
        l->b[1][i] = b1 * inverse;
        l->b[2][i] = b2 * inverse;
    }
}

/* --- textures ----------------------------------------------------------------------------------------------------- */

/* One texel coordinate of the centroids. (Both in one loop is what gcc 12's -fivopts gets wrong at -O1.) */
static void find_texel(const svo_facet *t, const double corner[3], double per_x, double per_y, svoi_lanes *l, double *at)
{
    const uint32_t n = rounded(l->count);
    if (t->normal[t->axis] == 0 || t->inside) {
        for (uint32_t i = 0; i < n; i++) at[i] = (double)l->b[0][i] * corner[0] + (double)l->b[1][i] * corner[1] + (double)l->b[2][i] * corner[2];
        return;
    }
    const double ox = t->corner[0][(t->axis + 1) % 3], oy = t->corner[0][(t->axis + 2) % 3];
    for (uint32_t i = 0; i < n; i++) at[i] = corner[0] + ((double)l->clip.cx[i] - ox) * per_x + ((double)l->clip.cy[i] - oy) * per_y;
}

static void find_texels(const svo_facet *t, const svo_facet_texture *f, svoi_lanes *l)
{
    const double u[3] = {f->corner[0][0], f->corner[1][0], f->corner[2][0]}, v[3] = {f->corner[0][1], f->corner[1][1], f->corner[2][1]};
    find_texel(t, u, f->per_x[0], f->per_y[0], l, l->at[0]);
    find_texel(t, v, f->per_x[1], f->per_y[1], l, l->at[1]);
}

/* Is every piece narrower than 0.6 texels, so that one bilinear reading of the image will do? A convex piece varies by at most 1/12 along each axis. */
static bool magnified(const svo_facet_texture *f)
{
    double u = fabs(f->per_x[0]) + fabs(f->per_y[0]), v = fabs(f->per_x[1]) + fabs(f->per_y[1]);
    return (u * u + v * v) * (1.0 / 12) < 0.03;
}

static bool in_range(const svo_facet_texture *f)
{
    for (int k = 0; k < 3; k++)
        if (!(fabs(f->corner[k][0]) < 1e9 && fabs(f->corner[k][1]) < 1e9)) return false;
    return true;
}

/* One of the facet's textures at every lane, `components` of them. */
static void read_lanes(svo_facet *t, uint32_t slot, const svo_texture *how, const svo_pyramid *p, bool weighted, svoi_lanes *l, float (*out)[SVOI_LANES])
{
    const svo_facet_texture *f = svoi_facet_texture(t, slot, how, p);
    if (p->kind != SVO_TEXEL_COLOR_ALPHA && !how->nearest && magnified(f) && in_range(f)) {
        find_texels(t, f, l);
        svoi_read_points(how, p, l, out);
        return;
    }
    const bool batch = !how->nearest && in_range(f);
    if (batch) {
        find_texels(t, f, l);
        svoi_read_footprints(f, how, p, l, out);
    }
    const uint32_t x = (t->axis + 1) % 3, y = (t->axis + 2) % 3;
    for (uint32_t i = 0; i < l->count; i++) {
        if (batch && (!weighted || out[3][i] > 0)) {
            if (weighted)
                for (int k = 0; k < 3; k++) out[k][i] /= out[3][i];
            continue;
        }
        svo_piece piece = {.xx = (double)l->clip.xx[i], .xy = (double)l->clip.xy[i], .yy = (double)l->clip.yy[i]};
        float texel[4];
        piece.centre[x] = (double)l->clip.cx[i];
        piece.centre[y] = (double)l->clip.cy[i];
        piece.centre[t->axis] = (double)l->clip.z[i] + 0.5;
        svoi_read_texture(t, slot, how, p, &piece, texel);
        if (weighted) svoi_unmultiply(t, how, p, &piece, texel);
        for (int k = 0; k < 4; k++) out[k][i] = texel[k];
    }
}

static bool needs_moments(const shade_material *m, svo_facet *t)
{
    const struct { const svo_pyramid *p; const svo_texture *how; } uses[4] = {{m->base, &m->m.base_color_texture}, {m->opacity, &m->m.opacity_texture},
        {m->emissive, &m->m.emissive_texture}, {m->metallic_roughness, &m->m.metallic_roughness_texture}};
    for (uint32_t k = 0; k < 4; k++)
        if (uses[k].p != NULL && !magnified(svoi_facet_texture(t, k, uses[k].how, uses[k].p))) return true;
    return false;
}

/* --- values ------------------------------------------------------------------------------------------------------- */

static void clamp_unit(float *v, uint32_t n)
{
    for (uint32_t i = 0; i < n; i++) {
        float x = v[i] > 0 ? v[i] : 0; /* NaN becomes 0 */
        v[i] = x < 1 ? x : 1;
    }
}

static void find_colors(const shade_material *m, svo_facet *t, svoi_lanes *l)
{
    const uint32_t n = rounded(l->count);
    float texel[4][SVOI_LANES];
    for (int k = 0; k < 4; k++) {
        const float base = m->m.base_color[k];
        if (t->part->colors != NULL) {
            const float c0 = base * t->part->colors[4 * (uint64_t)t->vertex[0] + (uint64_t)k], c1 = base * t->part->colors[4 * (uint64_t)t->vertex[1] + (uint64_t)k],
                        c2 = base * t->part->colors[4 * (uint64_t)t->vertex[2] + (uint64_t)k];
            for (uint32_t i = 0; i < n; i++) l->color[k][i] = l->b[0][i] * c0 + l->b[1][i] * c1 + l->b[2][i] * c2;
        } else {
            for (uint32_t i = 0; i < n; i++) l->color[k][i] = base;
        }
    }
    if (m->base != NULL) {
        read_lanes(t, BASE, &m->m.base_color_texture, m->base, m->alpha_matters, l, texel);
        for (int k = 0; k < 4; k++)
            for (uint32_t i = 0; i < l->count; i++) l->color[k][i] *= texel[k][i];
    }
    if (m->opacity != NULL) {
        read_lanes(t, OPACITY, &m->m.opacity_texture, m->opacity, false, l, texel);
        for (uint32_t i = 0; i < l->count; i++) l->color[3][i] *= texel[0][i];
    }
    for (int k = 0; k < 4; k++) clamp_unit(l->color[k], n);
}

/* The face's normal, and that of all corners where they have one. */
void svoi_plain_normals(const svo_facet *t, float face[3], float corners[3])
{
    const double *c = t->corner_normal[0], length = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
    for (int i = 0; i < 3; i++) {
        face[i] = (float)((t->mirrored ? -1 : 1) * t->face[i]);
        corners[i] = length > 1e-9 ? (float)(c[i] / length) : face[i];
    }
}

static void find_normals(const svo_facet *t, svoi_lanes *l)
{
    const uint32_t n = rounded(l->count);
    float c[3][3], face[3], all[3];
    svoi_plain_normals(t, face, all);
    l->one_normal = !t->smooth;
    if (!t->smooth) {
        for (int k = 0; k < 3; k++)
            for (uint32_t i = 0; i < n; i++) l->normal[k][i] = all[k];
        return;
    }
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) c[k][i] = (float)t->corner_normal[k][i];
    for (uint32_t i = 0; i < n; i++) {
        float b0 = l->b[0][i], b1 = l->b[1][i], b2 = l->b[2][i];
        float x = b0 * c[0][0] + b1 * c[1][0] + b2 * c[2][0], y = b0 * c[0][1] + b1 * c[1][1] + b2 * c[2][1], z = b0 * c[0][2] + b1 * c[1][2] + b2 * c[2][2];
        float square = x * x + y * y + z * z, inverse = 1 / sqrtf(square > 1e-12f ? square : 1);
        bool none = !(square > 1e-12f); /* they cancel: the face */
        l->normal[0][i] = none ? face[0] : x * inverse;
        l->normal[1][i] = none ? face[1] : y * inverse;
        l->normal[2][i] = none ? face[2] : z * inverse;
    }
}

void svoi_lanes_values(const svo_shader *s, svo_facet *t, svoi_lanes *l)
{
    const shade_material *m = svoi_material_of(s, t->material);
    const svo_shade_layout *layout = &s->layout;
    const uint32_t n = rounded(l->count);
    svoi_lanes_place(t, l);
    if (t->inside || !t->clips) uncut(t, l);
    else if (needs_moments(m, t)) svoi_clip(&t->clipper, &l->clip, l->count, true);
    else {
        svoi_clip(&t->clipper, &l->clip, l->count, false);
        for (uint32_t i = 0; i < n; i++) l->clip.xx[i] = l->clip.xy[i] = l->clip.yy[i] = 0;
    }
    find_barycentric(t, l);
    const bool covers = layout->coverage < SVO_MAX_CHANNELS;
    if (layout->color < SVO_MAX_CHANNELS || (covers && m->alpha_matters)) find_colors(m, t, l);
    for (uint32_t i = 0; covers && i < n; i++) l->coverage[i] = m->alpha_matters ? l->color[3][i] : 1;
    if (layout->normal < SVO_MAX_CHANNELS) find_normals(t, l);
    if (layout->emissive < SVO_MAX_CHANNELS) {
        float texel[4][SVOI_LANES];
        if (m->emissive != NULL) read_lanes(t, EMISSIVE, &m->m.emissive_texture, m->emissive, false, l, texel);
        for (int k = 0; k < 3; k++) {
            for (uint32_t i = 0; i < n; i++) l->emissive[k][i] = m->m.emissive[k] * (m->emissive != NULL && i < l->count ? texel[k][i] : 1);
            clamp_unit(l->emissive[k], n);
        }
    }
    if (layout->metallic < SVO_MAX_CHANNELS || layout->roughness < SVO_MAX_CHANNELS) {
        float texel[4][SVOI_LANES];
        const bool read = m->metallic_roughness != NULL;
        if (read) read_lanes(t, METALLIC_ROUGHNESS, &m->m.metallic_roughness_texture, m->metallic_roughness, false, l, texel);
        for (uint32_t i = 0; i < n; i++) l->roughness[i] = m->m.roughness * (read && i < l->count ? texel[1][i] : 1);
        for (uint32_t i = 0; i < n; i++) l->metallic[i] = m->m.metallic * (read && i < l->count ? texel[2][i] : 1);
        clamp_unit(l->roughness, n);
        clamp_unit(l->metallic, n);
    }
}

/* --- sums --------------------------------------------------------------------------------------------------------- */

static void find_weights(const svoi_lanes *l, uint32_t shift, uint32_t *weight)
{
    const float scale = (float)(1u << shift);
    for (uint32_t i = 0; i < rounded(l->count); i++) {
        int32_t w = (int32_t)(l->clip.area[i] * scale + 0.5f);
        weight[i] = w > 1 ? (uint32_t)w : 1;
    }
}

/* The largest contribution is kept for normals that cancel: 28 bits of weight over 3 x 12 bits of direction. */
static inline uint64_t direction_key(const int32_t n[3])
{
    return (uint64_t)((uint32_t)(n[0] + 32768) >> 4) | (uint64_t)((uint32_t)(n[1] + 32768) >> 4) << 12 | (uint64_t)((uint32_t)(n[2] + 32768) >> 4) << 24;
}

/* Colours in 16 bits, normals in 15 and a sign. */
static inline void quantize(const float *v, uint32_t n, int32_t *out)
{
    for (uint32_t i = 0; i < n; i++) out[i] = (int32_t)(v[i] * 65535 + 0.5f);
}

static inline void quantize_normals(const float *v, uint32_t n, int32_t *out)
{
    for (uint32_t i = 0; i < n; i++) out[i] = (int32_t)floorf(v[i] * 32767 + 0.5f);
}

enum { WIDE_FIELDS = 9 }; /* as many as the vector code adds to: 5 or 9 */

void svoi_lanes_add(const svo_shader *s, const svo_facet *t, svoi_lanes *l, uint32_t shift, uint64_t *sums)
{
    const svo_shade_layout *layout = &s->layout;
    const uint32_t n = rounded(l->count), fields = layout->fields;
    const bool weighted = svoi_material_of(s, t->material)->alpha_matters;
    uint32_t weight[SVOI_LANES];
    find_weights(l, shift, weight);
    if (fields == 9 && layout->color < SVO_MAX_CHANNELS && layout->normal < SVO_MAX_CHANNELS && !weighted && (svoi_clip_has_wide() || svoi_avx2_has())) { /* what is asked for most */
        int32_t normal[3][SVOI_LANES];
        for (int k = 0; k < 3; k++) quantize(l->color[k], n, l->integer[k]);
        for (int k = 0; k < 3; k++) quantize_normals(l->normal[k], n, normal[k]);
        (svoi_clip_has_wide() ? svoi_wide_add : svoi_avx2_add)(weight, l->target, l->count, l->integer, normal, sums);
        return;
    }
    for (uint32_t i = 0; i < l->count; i++) sums[(uint64_t)l->target[i] * fields + layout->sum_weight] += weight[i];
    if (layout->color < SVO_MAX_CHANNELS) {
        uint32_t color_weight[SVOI_LANES];
        memcpy(color_weight, weight, sizeof weight);
        for (uint32_t i = 0; weighted && i < n; i++) {
            uint32_t w = (uint32_t)((double)weight[i] * (double)l->color[3][i] + 0.5);
            color_weight[i] = w > 1 ? w : 1;
        }
        for (int k = 0; k < 3; k++) quantize(l->color[k], n, l->integer[k]);
        for (uint32_t i = 0; i < l->count; i++) {
            uint64_t *f = sums + (uint64_t)l->target[i] * fields + layout->sum_color, w = color_weight[i];
            f[0] += w;
            for (int k = 0; k < 3; k++) f[1 + k] += w * (uint64_t)l->integer[k][i];
        }
    }
    if (layout->normal < SVO_MAX_CHANNELS) {
        for (int k = 0; k < 3; k++) quantize_normals(l->normal[k], n, l->integer[k]);
        for (uint32_t i = 0; i < l->count; i++) {
            uint64_t *f = sums + (uint64_t)l->target[i] * fields + layout->sum_normal, w = weight[i];
            const int32_t normal[3] = {l->integer[0][i], l->integer[1][i], l->integer[2][i]};
            uint64_t key = w << 36 | direction_key(normal);
            for (int k = 0; k < 3; k++) f[k] += w * (uint64_t)(int64_t)normal[k]; /* two's complement */
            f[3] = key > f[3] ? key : f[3];
        }
    }
    if (layout->emissive < SVO_MAX_CHANNELS) {
        for (int k = 0; k < 3; k++) {
            quantize(l->emissive[k], n, l->integer[0]);
            for (uint32_t i = 0; i < l->count; i++)
                sums[(uint64_t)l->target[i] * fields + layout->sum_emissive + (uint32_t)k] += (uint64_t)weight[i] * (uint64_t)l->integer[0][i];
        }
    }
    if (layout->metallic < SVO_MAX_CHANNELS) {
        quantize(l->metallic, n, l->integer[0]);
        for (uint32_t i = 0; i < l->count; i++) sums[(uint64_t)l->target[i] * fields + layout->sum_metallic] += (uint64_t)weight[i] * (uint64_t)l->integer[0][i];
    }
    if (layout->coverage < SVO_MAX_CHANNELS) {
        quantize(l->coverage, n, l->integer[0]);
        for (uint32_t i = 0; i < l->count; i++) sums[(uint64_t)l->target[i] * fields + layout->sum_coverage] += (uint64_t)weight[i] * (uint64_t)l->integer[0][i];
    }
    if (layout->roughness < SVO_MAX_CHANNELS) {
        quantize(l->roughness, n, l->integer[0]);
        for (uint32_t i = 0; i < l->count; i++) sums[(uint64_t)l->target[i] * fields + layout->sum_roughness] += (uint64_t)weight[i] * (uint64_t)l->integer[0][i];
    }
}

/* What a weight of one adds to each sum, where nothing is transparent. */
static void find_factors(const svo_shade_layout *layout, const svo_contribution *c, int32_t factor[WIDE_FIELDS])
{
    factor[layout->sum_weight] = 1;
    if (layout->color < SVO_MAX_CHANNELS) {
        factor[layout->sum_color] = 1;
        for (uint32_t k = 0; k < 3; k++) factor[layout->sum_color + 1 + k] = c->color[k];
    }
    for (uint32_t k = 0; layout->normal < SVO_MAX_CHANNELS && k < 3; k++) factor[layout->sum_normal + k] = c->normal[k];
    for (uint32_t k = 0; layout->emissive < SVO_MAX_CHANNELS && k < 3; k++) factor[layout->sum_emissive + k] = c->emissive[k];
    if (layout->metallic < SVO_MAX_CHANNELS) factor[layout->sum_metallic] = c->metallic;
    if (layout->roughness < SVO_MAX_CHANNELS) factor[layout->sum_roughness] = c->roughness;
    if (layout->coverage < SVO_MAX_CHANNELS) factor[layout->sum_coverage] = 65535;
}

void svoi_lanes_add_flat(const svo_shade_layout *layout, const svo_contribution *c, const svoi_lanes *l, uint32_t shift, uint64_t *sums)
{
    uint32_t weight[SVOI_LANES], fields = layout->fields;
    find_weights(l, shift, weight);
    if ((fields == 5 || fields == WIDE_FIELDS) && c->alpha == 1 && (svoi_clip_has_wide() || svoi_avx2_has())) {
        int32_t factor[WIDE_FIELDS] = {0};
        const bool normals = layout->normal < SVO_MAX_CHANNELS;
        find_factors(layout, c, factor);
        (svoi_clip_has_wide() ? svoi_wide_add_flat : svoi_avx2_add_flat)(weight, l->target, l->count, fields, factor, normals ? layout->sum_normal + 3 : fields, normals ? direction_key(c->normal) : 0, sums);
        return;
    }
    for (uint32_t i = 0; i < l->count; i++) {
        uint64_t *v = sums + (uint64_t)l->target[i] * fields, w = weight[i];
        v[layout->sum_weight] += w;
        if (layout->color < SVO_MAX_CHANNELS) {
            svo_contribution own = {.alpha = c->alpha};
            svo_contribution_weigh(&own, w);
            uint64_t *f = v + layout->sum_color;
            f[0] += own.color_weight;
            for (int k = 0; k < 3; k++) f[1 + k] += own.color_weight * c->color[k];
        }
        if (layout->normal < SVO_MAX_CHANNELS) {
            uint64_t *f = v + layout->sum_normal, key = w << 36 | direction_key(c->normal);
            for (int k = 0; k < 3; k++) f[k] += w * (uint64_t)(int64_t)c->normal[k];
            f[3] = key > f[3] ? key : f[3];
        }
        for (uint32_t k = 0; layout->emissive < SVO_MAX_CHANNELS && k < 3; k++) v[layout->sum_emissive + k] += w * c->emissive[k];
        if (layout->metallic < SVO_MAX_CHANNELS) v[layout->sum_metallic] += w * c->metallic;
        if (layout->roughness < SVO_MAX_CHANNELS) v[layout->sum_roughness] += w * c->roughness;
        if (layout->coverage < SVO_MAX_CHANNELS) v[layout->sum_coverage] += w * (uint64_t)(c->alpha * 65535 + 0.5);
    }
}

void svoi_lanes_add_areas(const svoi_lanes *l, uint32_t shift, uint64_t *sums)
{
    uint32_t weight[SVOI_LANES];
    find_weights(l, shift, weight);
    for (uint32_t i = 0; i < l->count; i++) sums[l->target[i]] += weight[i];
}

/* --- bytes -------------------------------------------------------------------------------------------------------- */

/* Octahedral, as svo_oct32_encode but for the choice of the best of four neighbours: u and v rounded to the nearest. Unit vectors. */
static void encode_normals(const float *x, const float *y, const float *z, uint32_t n, uint32_t *out)
{
    for (uint32_t i = 0; i < n; i++) {
        float sum = fabsf(x[i]) + fabsf(y[i]) + fabsf(z[i]), inverse = 32767 / (sum > 1e-30f ? sum : 1), u = x[i] * inverse, v = y[i] * inverse;
        float a = copysignf(32767 - fabsf(v), u), b = copysignf(32767 - fabsf(u), v);
        u = z[i] < 0 ? a : u;
        v = z[i] < 0 ? b : v;
        int32_t iu = (int32_t)(u + copysignf(0.5f, u)), iv = (int32_t)(v + copysignf(0.5f, v));
        out[i] = ((uint32_t)iu & 0xffff) | (uint32_t)iv << 16;
    }
}

enum { BEHIND = 64 }; /* bytes that may be read behind values */

static void write_normals(const svoi_lanes *l, const uint32_t *index, uint32_t count, uint8_t *out)
{
    uint32_t bytes[SVOI_LANES + BEHIND / 4];
    if (l->one_normal) {
        encode_normals(l->normal[0], l->normal[1], l->normal[2], 1, bytes);
        if (svoi_clip_has_wide()) {
            for (uint32_t i = 1; i < count; i++) bytes[i] = bytes[0];
            svoi_wide_put((const uint8_t *)bytes, 4, index, count, out);
            return;
        }
        for (uint32_t i = 0; i < count; i++) memcpy(out + 4 * (uint64_t)index[i], &bytes[0], 4);
        return;
    }
    encode_normals(l->normal[0], l->normal[1], l->normal[2], rounded(count), bytes);
    if (svoi_clip_has_wide()) {
        svoi_wide_put((const uint8_t *)bytes, 4, index, count, out);
        return;
    }
    for (uint32_t i = 0; i < count; i++) memcpy(out + 4 * (uint64_t)index[i], &bytes[i], 4);
}

static void write_colors(float (*color)[SVOI_LANES], const uint32_t *index, uint32_t count, uint8_t *out)
{
    if (svoi_clip_has_wide()) {
        uint8_t pixels[3 * SVOI_LANES + BEHIND];
        svoi_wide_colors(svoi_srgb_steps(), color[0], color[1], color[2], count, pixels);
        svoi_wide_put(pixels, 3, index, count, out);
        return;
    }
    if (svoi_avx2_has()) {
        uint8_t pixels[3 * SVOI_LANES + BEHIND];
        svoi_avx2_colors(svoi_srgb_steps(), color[0], color[1], color[2], count, pixels);
        for (uint32_t i = 0; i < count; i++) {
            uint8_t *to = out + 3 * (uint64_t)index[i];
            to[0] = pixels[3 * i], to[1] = pixels[3 * i + 1], to[2] = pixels[3 * i + 2];
        }
        return;
    }
    uint8_t bytes[3][SVOI_LANES];
    for (int k = 0; k < 3; k++) svoi_linear_to_srgb(color[k], count, bytes[k]);
    for (uint32_t i = 0; i < count; i++) {
        uint8_t *to = out + 3 * (uint64_t)index[i];
        to[0] = bytes[0][i], to[1] = bytes[1][i], to[2] = bytes[2][i];
    }
}

static void write_bytes(const float *v, const uint32_t *index, uint32_t count, uint8_t *out)
{
    for (uint32_t i = 0; i < count; i++) out[index[i]] = (uint8_t)(v[i] * 255 + 0.5f);
}

static void write_all(const svo_shade_layout *layout, svoi_lanes *l, const uint32_t *index, uint32_t count, uint8_t *const channels[SVO_MAX_CHANNELS])
{
    if (layout->color < SVO_MAX_CHANNELS) write_colors(l->color, index, count, channels[layout->color]);
    if (layout->normal < SVO_MAX_CHANNELS) write_normals(l, index, count, channels[layout->normal]);
    if (layout->emissive < SVO_MAX_CHANNELS) write_colors(l->emissive, index, count, channels[layout->emissive]);
    if (layout->metallic < SVO_MAX_CHANNELS) write_bytes(l->metallic, index, count, channels[layout->metallic]);
    if (layout->coverage < SVO_MAX_CHANNELS) write_bytes(l->coverage, index, count, channels[layout->coverage]);
    if (layout->roughness < SVO_MAX_CHANNELS) write_bytes(l->roughness, index, count, channels[layout->roughness]);
}

void svoi_lanes_write(const svo_shade_layout *layout, svoi_lanes *l, uint8_t *const channels[SVO_MAX_CHANNELS])
{
    write_all(layout, l, l->target, l->count, channels);
}

void svoi_flat_values(const svo_shade_layout *layout, const svo_contribution *c, svoi_values *out)
{
    uint64_t sums[32] = {0};
    svo_contribution own = *c;
    svo_contribution_weigh(&own, 1 << 24);
    svo_shade_add(layout, &own, sums);
    svo_shade_value(layout, sums, out->of);
}

void svoi_lanes_write_flat(const svo_shade_layout *layout, const svoi_values *v, const svoi_lanes *l, uint8_t *const channels[SVO_MAX_CHANNELS])
{
    const uint32_t colors[2] = {layout->color, layout->emissive}, bytes[3] = {layout->metallic, layout->roughness, layout->coverage}, count = l->count;
    for (int n = 0; n < 3; n++) {
        if (n < 2 && colors[n] < SVO_MAX_CHANNELS) {
            uint8_t c[3], *to = channels[colors[n]];
            memcpy(c, v->of[colors[n]], 3);
            for (uint32_t i = 0; i < count; i++) memcpy(to + 3 * (uint64_t)l->target[i], c, 3);
        }
        if (bytes[n] < SVO_MAX_CHANNELS)
            for (uint32_t i = 0; i < count; i++) channels[bytes[n]][l->target[i]] = v->of[bytes[n]][0];
    }
    if (layout->normal < SVO_MAX_CHANNELS) {
        uint32_t normal;
        uint8_t *to = channels[layout->normal];
        memcpy(&normal, v->of[layout->normal], 4);
        for (uint32_t i = 0; i < count; i++) memcpy(to + 4 * (uint64_t)l->target[i], &normal, 4);
    }
}

/* The same 1, 3 or 4 bytes again and again, some at a time. */
static inline void repeat(const uint8_t *value, const uint32_t stride, uint32_t count, uint8_t *out)
{
    uint8_t some[4 * 4];
    for (uint32_t i = 0; i < 4; i++) memcpy(some + stride * i, value, stride);
    for (; count >= 4; count -= 4, out += 4 * stride) memcpy(out, some, 4 * stride);
    for (; count != 0; count--, out += stride) memcpy(out, value, stride);
}

void svoi_write_run(const svo_shade_layout *layout, const svoi_values *v, uint32_t first, uint32_t count, uint8_t *const channels[SVO_MAX_CHANNELS])
{
    const uint32_t colors[2] = {layout->color, layout->emissive}, bytes[3] = {layout->metallic, layout->roughness, layout->coverage};
    for (int n = 0; n < 3; n++) {
        if (n < 2 && colors[n] < SVO_MAX_CHANNELS) repeat(v->of[colors[n]], 3, count, channels[colors[n]] + 3 * (uint64_t)first);
        if (bytes[n] < SVO_MAX_CHANNELS) repeat(v->of[bytes[n]], 1, count, channels[bytes[n]] + first);
    }
    if (layout->normal < SVO_MAX_CHANNELS) repeat(v->of[layout->normal], 4, count, channels[layout->normal] + 4 * (uint64_t)first);
}

void svoi_sums_write(const svo_shade_layout *layout, svoi_lanes *l, const uint64_t *sums, const uint32_t *index, uint32_t count,
                     uint8_t *const channels[SVO_MAX_CHANNELS])
{
    const uint32_t fields = layout->fields;
    l->one_normal = false;
    for (uint32_t i = 0; i < count; i++) {
        const uint64_t *v = sums + (uint64_t)i * fields;
        const double weight = (double)(int64_t)v[layout->sum_weight], inverse = 1 / (weight * 65535);
        if (layout->color < SVO_MAX_CHANNELS) {
            const uint64_t *f = v + layout->sum_color;
            const double scale = 1 / ((double)(int64_t)f[0] * 65535);
            for (int k = 0; k < 3; k++) l->color[k][i] = (float)((double)(int64_t)f[1 + k] * scale);
        }
        if (layout->normal < SVO_MAX_CHANNELS) {
            const uint64_t *f = v + layout->sum_normal;
            const double scale = inverse * 2;
            double x = (double)(int64_t)f[0] * scale, y = (double)(int64_t)f[1] * scale, z = (double)(int64_t)f[2] * scale;
            if (x * x + y * y + z * z < 1e-6) { /* they cancel */
                x = (double)(f[3] & 0xfff) * 16 + 8 - 32768;
                y = (double)(f[3] >> 12 & 0xfff) * 16 + 8 - 32768;
                z = (double)(f[3] >> 24 & 0xfff) * 16 + 8 - 32768;
            }
            l->normal[0][i] = (float)x, l->normal[1][i] = (float)y, l->normal[2][i] = (float)z;
        }
        for (uint32_t k = 0; layout->emissive < SVO_MAX_CHANNELS && k < 3; k++)
            l->emissive[k][i] = (float)((double)(int64_t)v[layout->sum_emissive + k] * inverse);
        if (layout->metallic < SVO_MAX_CHANNELS) l->metallic[i] = (float)((double)(int64_t)v[layout->sum_metallic] * inverse);
        if (layout->coverage < SVO_MAX_CHANNELS) l->coverage[i] = (float)((double)(int64_t)v[layout->sum_coverage] * inverse);
        if (layout->roughness < SVO_MAX_CHANNELS) l->roughness[i] = (float)((double)(int64_t)v[layout->sum_roughness] * inverse);
    }
    for (uint32_t i = count; layout->normal < SVO_MAX_CHANNELS && i < rounded(count); i++)
        for (int k = 0; k < 3; k++) l->normal[k][i] = 1;
    write_all(layout, l, index, count, channels);
}
