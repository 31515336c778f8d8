/* Averages of textures over the parts of one triangle in many voxels: what svoi_read_texture says, but the footprints of a batch are
 * measured together, and a reading inside the image takes both texels of a row at once. */
#include <math.h>
#include <string.h>

#include "svoi_lanes.h"
#include "svoi_shade.h"
#include "svoi_shade_avx2.h"
#include "svoi_shade_wide.h"

enum { MOST = 128, ACROSS = 4 }; /* readings of a footprint, and across its short axis */

/* Footprints in texels of the image: variances along the long and the short axis, the direction of the long one. */
typedef struct footprints { float large[SVOI_LANES], small[SVOI_LANES], x[SVOI_LANES], y[SVOI_LANES]; } footprints;

static void measure(const svo_facet_texture *f, const float *moment_xx, const float *moment_xy, const float *moment_yy, uint32_t count, footprints *out)
{
    const float ax = (float)f->per_x[0], ay = (float)f->per_y[0], bx = (float)f->per_x[1], by = (float)f->per_y[1];
    for (uint32_t i = 0; i < count; i++) {
        const float xx = moment_xx[i], xy = moment_xy[i], yy = moment_yy[i];
        const float uu = ax * ax * xx + 2 * ax * ay * xy + ay * ay * yy, vv = bx * bx * xx + 2 * bx * by * xy + by * by * yy;
        const float uv = ax * bx * xx + (ax * by + ay * bx) * xy + ay * by * yy;
        const float middle = 0.5f * (uu + vv), half = 0.5f * (uu - vv), root = sqrtf(half * half + uv * uv), large = middle + root, small = middle - root;
        const float x = uu > vv ? large - vv : uv, y = uu > vv ? uv : large - uu, square = x * x + y * y, inverse = 1 / sqrtf(square > 0 ? square : 1);
        out->large[i] = large;
        out->small[i] = small > 0 ? small : 0;
        out->x[i] = square > 0 ? x * inverse : 1;
        out->y[i] = square > 0 ? y * inverse : 0;
    }
}

static inline uint32_t taps_for(float width, uint32_t most)
{
    if (width < 0.6f) return 1;
    const uint32_t n = (uint32_t)(width < 1e6f ? width * 0.8f : 1e6f) + 1;
    return n < 2 ? 2 : n < most ? n : most;
}

typedef svoi_tap_plan plan;

static inline float spacing(float rest, uint32_t count) { return count > 1 && rest > 0 ? sqrtf(12 * rest / (float)(count * count - 1)) : 0; }

/* The finest level that is coarse enough for what is so broad: texels of the next are larger than 0.58 of it. */
static inline uint32_t level_for(float breadth, uint32_t levels)
{
    const float most = 0.58f * breadth;
    uint32_t bits;
    memcpy(&bits, &most, sizeof bits);
    const uint32_t level = most >= 1 ? (bits >> 23) - 127 : 0; /* the power of two below it */
    return level < levels - 1 ? level : levels - 1;
}

static void make_plan(const svo_pyramid *p, const footprints *f, uint32_t i, plan *out)
{
    static const uint32_t most_along[ACROSS + 1] = {0, MOST, MOST / 2, MOST / 3, MOST / 4};
    const float length = sqrtf(12 * f->large[i]), breadth = sqrtf(12 * f->small[i]);
    uint32_t level = level_for(breadth, p->levels);
    float size = (float)(1u << level), per_size = 1 / size; /* powers of two: exact */
    while (level + 1 < p->levels && !(length <= 1.6f * size * (float)most_along[taps_for(breadth * per_size, ACROSS)])) level++, size *= 2, per_size *= 0.5f;
    out->level = level;
    out->across = taps_for(breadth * per_size, ACROSS);
    out->along = taps_for(length * per_size, most_along[out->across]);
    const float inherent = (size * size - 1) * 0.25f, step = spacing(f->large[i] - inherent, out->along), side = spacing(f->small[i] - inherent, out->across);
    const float sx = p->share_x[level], sy = p->share_y[level];
    out->step[0] = step * f->x[i] * sx, out->step[1] = step * f->y[i] * sy;
    out->side[0] = -side * f->y[i] * sx, out->side[1] = side * f->x[i] * sy;
}

typedef float pair __attribute__((vector_size(32)));
typedef uint16_t stored_pair __attribute__((vector_size(16)));
typedef int32_t whole_pair __attribute__((vector_size(32)));

/* Two neighbours in a row. Not yet divided by what they are stored with (unit). */
static inline void load_pair(const svo_pyramid *p, uint32_t level, uint64_t at, pair *out)
{
    if (p->texels[level] != NULL) {
        stored_pair t;
        memcpy(&t, p->texels[level] + 4 * at, sizeof t);
        *out = __builtin_convertvector(__builtin_convertvector(t, whole_pair), pair);
        return;
    }
    const uint8_t *t = p->image->pixels + 4 * at;
    const float *linear = p->linear;
    if (p->kind != SVO_TEXEL_COLOR_ALPHA) {
        const float *stored = p->stored;
        *out = (pair){stored[t[0]], stored[t[1]], stored[t[2]], 65535, stored[t[4]], stored[t[5]], stored[t[6]], 65535};
    } else {
        const float a = t[3] * (1.0f / 255), b = t[7] * (1.0f / 255);
        *out = (pair){linear[t[0]] * a, linear[t[1]] * a, linear[t[2]] * a, a, linear[t[4]] * b, linear[t[5]] * b, linear[t[6]] * b, b};
    }
}

static inline float unit(const svo_pyramid *p, uint32_t level)
{
    return level != 0 || p->kind != SVO_TEXEL_COLOR_ALPHA ? 1.0f / 65535 : 1;
}

/* Two rows of two texels where the image is not all in memory. */
static __attribute__((noinline)) void touch(const svo_pyramid *p, uint32_t level, uint64_t at)
{
    const uint32_t w = p->width[level];
    for (uint64_t row = at; row <= at + w; row += w) {
        if (level == 0) svo_image_touch(p->image, (uint32_t)(row % w), (uint32_t)(row / w), 2);
        else svo_paged_touch(p->paged, p->texels[level] + 4 * row, 16);
    }
}

/* A plan around a point of the image: its first reading, in texels of the level from `origin` on. */
typedef struct placed { plan n; bool inside; uint64_t origin; float x, y; } placed;

/* False where a reading may reach beyond the level's edge. */
static inline bool place(const svo_pyramid *p, const svo_texture *how, const double at[2], double width, double height, placed *out)
{
    const plan *n = &out->n;
    const uint32_t w = p->width[n->level], h = p->height[n->level];
    double cx = at[0] * width, cy = at[1] * height;
    if (how->wrap_u == SVO_WRAP_REPEAT) cx -= floor(cx);
    if (how->wrap_v == SVO_WRAP_REPEAT) cy -= floor(cy);
    cx = cx * w - 0.5, cy = cy * h - 0.5;
    const float along = 0.5f * (float)(n->along - 1), across = 0.5f * (float)(n->across - 1);
    const double ex = (double)(fabsf(n->step[0]) * along + fabsf(n->side[0]) * across) + 0.01, ey = (double)(fabsf(n->step[1]) * along + fabsf(n->side[1]) * across) + 0.01;
    if (!(cx - ex > 0 && cy - ey > 0 && cx + ex < w - 1.0 && cy + ey < h - 1.0)) return false;
    const uint32_t left = (uint32_t)(cx - ex), top = (uint32_t)(cy - ey);
    out->x = (float)(cx - left) - along * n->step[0] - across * n->side[0];
    out->y = (float)(cy - top) - along * n->step[1] - across * n->side[1];
    out->origin = (uint64_t)top * w + left;
    if (p->outside) return true;
    /* its texels are far away in memory: ask for them while other footprints are placed */
    const uint64_t size = p->texels[n->level] != NULL ? 8 : 4, row = w * size;
    const uint8_t *texel = (p->texels[n->level] != NULL ? (const uint8_t *)p->texels[n->level] : p->image->pixels) + size * out->origin;
    const uint32_t rows = (uint32_t)(2 * ey) + 1; /* and one more */
    for (uint32_t i = 0; i <= (rows < 4 ? rows : 4); i++) __builtin_prefetch(texel + i * row);
    return true;
}

/* Is the level an image of bytes without alpha that vector code can read? */
static inline bool reads_bytes(const svo_pyramid *p, uint32_t level)
{
    return p->texels[level] == NULL && p->kind != SVO_TEXEL_COLOR_ALPHA && !p->outside && (uint64_t)p->width[0] * p->height[0] < (uint64_t)1 << 29 && svoi_bytes_has_wide();
}

/* Can the code for eight lanes read the level? */
static inline bool reads_eight(const svo_pyramid *p, uint32_t level)
{
    return (p->texels[level] != NULL || p->kind != SVO_TEXEL_COLOR_ALPHA) && !p->outside && (uint64_t)p->width[level] * p->height[level] < (uint64_t)1 << 31 && svoi_avx2_has();
}

/* The mean of its readings. Every other one has a sum of its own. */
static inline void mean_inside(const svo_pyramid *p, const placed *r, float out[4])
{
    const plan *n = &r->n;
    const uint32_t w = p->width[n->level];
    pair sums[2] = {{0}, {0}};
    if (n->along * n->across > 2 && reads_bytes(p, n->level)) {
        svoi_bytes_footprint(p->image->pixels + 4 * r->origin, p->halves, w, n, r->x, r->y, (float *)sums);
    } else if (p->texels[n->level] != NULL && !p->outside && n->along * n->across > 2 && svoi_clip_has_wide()) {
        svoi_wide_footprint(p->texels[n->level] + 4 * r->origin, w, n, r->x, r->y, (float *)sums);
    } else if (n->along * n->across > 2 && reads_eight(p, n->level)) {
        const svoi_texels from = {p->texels[n->level], p->image->pixels, p->stored};
        svoi_avx2_footprint(&from, r->origin, w, n, r->x, r->y, (float *)sums);
    } else {
        uint32_t odd = 0;
        for (uint32_t i = 0; i < n->along; i++)
            for (uint32_t j = 0; j < n->across; j++, odd ^= 1) {
                const float x = r->x + (float)i * n->step[0] + (float)j * n->side[0], y = r->y + (float)i * n->step[1] + (float)j * n->side[1];
                const int32_t ix = (int32_t)x, iy = (int32_t)y; /* neither is negative */
                const float fx = x - (float)ix, fy = y - (float)iy, rx = 1 - fx;
                const uint64_t texel = r->origin + (uint64_t)(uint32_t)iy * w + (uint32_t)ix;
                pair upper, lower;
                if (p->outside) touch(p, n->level, texel);
                load_pair(p, n->level, texel, &upper);
                load_pair(p, n->level, texel + w, &lower);
                upper += (lower - upper) * fy;
                sums[odd] += upper * (pair){rx, rx, rx, rx, fx, fx, fx, fx};
            }
    }
    const float scale = unit(p, n->level) / (float)(n->along * n->across);
    const pair sum = sums[0] + sums[1];
    for (int k = 0; k < 4; k++) out[k] = (sum[k] + sum[k + 4]) * scale;
}

/* The mean of readings anywhere. */
static void mean_anywhere(const svo_pyramid *p, const svo_texture *how, const plan *n, const double at[2], double width, double height, float out[4])
{
    float sum[4] = {0, 0, 0, 0}, texel[4];
    const double sx = (double)p->width[0] / p->width[n->level], sy = (double)p->height[0] / p->height[n->level];
    for (uint32_t j = 0; j < n->along; j++)
        for (uint32_t k = 0; k < n->across; k++) {
            const float r = (float)j - 0.5f * (float)(n->along - 1), q = (float)k - 0.5f * (float)(n->across - 1);
            const double x = at[0] + (double)(r * n->step[0] + q * n->side[0]) * sx, y = at[1] + (double)(r * n->step[1] + q * n->side[1]) * sy;
            svo_pyramid_sample(p, how, x * width, y * height, n->level, texel);
            for (int c = 0; c < 4; c++) sum[c] += texel[c];
        }
    for (int c = 0; c < 4; c++) out[c] = sum[c] / (float)(n->along * n->across);
}

void svoi_read_footprints(const svo_facet_texture *f, const svo_texture *how, const svo_pyramid *p, const svoi_lanes *l, float (*out)[SVOI_LANES])
{
    const double width = 1.0 / p->width[0], height = 1.0 / p->height[0];
    footprints prints;
    placed lane[SVOI_LANES];
    measure(f, l->clip.xx, l->clip.xy, l->clip.yy, l->count, &prints);
    for (uint32_t i = 0; i < l->count; i++) {
        const double at[2] = {l->at[0][i], l->at[1][i]};
        lane[i].n = (plan){.along = 1, .across = 1};
        if (prints.large[i] > 0.03f) make_plan(p, &prints, i, &lane[i].n); /* wider than 0.6 texels */
        lane[i].inside = place(p, how, at, width, height, &lane[i]);
    }
    for (uint32_t i = 0; i < l->count; i++) {
        const double at[2] = {l->at[0][i], l->at[1][i]};
        float texel[4];
        if (lane[i].inside) mean_inside(p, &lane[i], texel);
        else mean_anywhere(p, how, &lane[i].n, at, width, height, texel);
        for (int c = 0; c < 4; c++) out[c][i] = texel[c];
    }
}

/* --- voxels that no edge reaches ---------------------------------------------------------------------------------- */

void svoi_inner_plan(const svo_facet_texture *f, const svo_pyramid *p, const svoi_inner *inner, svoi_inner_texture *out)
{
    footprints prints;
    measure(f, inner->xx, inner->xy, inner->yy, inner->steps, &prints);
    for (uint32_t k = 0; k < inner->steps; k++) {
        plan *n = &out->plan[k];
        *n = (plan){.along = 1, .across = 1};
        if (prints.large[k] > 0.03f) make_plan(p, &prints, k, n);
        uint32_t same = 0;
        while (out->plan[same].level != n->level || out->plan[same].along != n->along || out->plan[same].across != n->across) same++;
        out->shape[k] = (uint8_t)same;
        out->alike[k] = 0;
        out->alike[same] |= (uint32_t)1 << k;
        const float along = 0.5f * (float)(n->along - 1), across = 0.5f * (float)(n->across - 1);
        out->back_x[k] = along * n->step[0] + across * n->side[0], out->back_y[k] = along * n->step[1] + across * n->side[1];
        /* and a little, for rounding */
        out->reach_x[k] = fabsf(n->step[0]) * along + fabsf(n->side[0]) * across + 0.01f, out->reach_y[k] = fabsf(n->step[1]) * along + fabsf(n->side[1]) * across + 0.01f;
        out->step_x[k] = n->step[0], out->step_y[k] = n->step[1];
        out->side_x[k] = n->side[0], out->side_y[k] = n->side[1];
        const float row[8] = {out->back_x[k], out->back_y[k], n->step[0], n->step[1], n->side[0], n->side[1], 0, 0};
        memcpy(out->row[k], row, sizeof row);
        out->most_x[k] = out->most_y[k] = 0;
        out->most_x[same] = fmaxf(out->most_x[same], out->reach_x[k]), out->most_y[same] = fmaxf(out->most_y[same], out->reach_y[k]);
    }
    memset(out->row[SVOI_INNER_STEPS + 1], 0, sizeof out->row[0]);
}

/* Lanes that are read alike, one after the other: where, and with which steps. */
typedef struct tap_lanes {
    uint32_t count;
    uint8_t lane[SVOI_LANES];
    float x[SVOI_LANES], y[SVOI_LANES]; /* first reading, in texels of the level, 0 at the middle of the first */
    float step_x[SVOI_LANES], step_y[SVOI_LANES], side_x[SVOI_LANES], side_y[SVOI_LANES];
    uint32_t texel[SVOI_LANES];
    float fx[SVOI_LANES], fy[SVOI_LANES];
    pair sum[SVOI_LANES];
} tap_lanes;


/* Two texels of one level, wherever they are: as load_pair gives them. */
static void load_two(const svo_pyramid *p, uint32_t level, uint64_t left, uint64_t right, pair *out)
{
    const uint32_t w = p->width[level];
    const uint64_t at[2] = {left, right};
    float t[8];
    for (int k = 0; k < 2; k++) {
        if (p->outside && level == 0) svo_image_touch(p->image, (uint32_t)(at[k] % w), (uint32_t)(at[k] / w), 1);
        if (p->outside && level != 0) svo_paged_touch(p->paged, p->texels[level] + 4 * at[k], 8);
        if (p->texels[level] != NULL) {
            const uint16_t *from = p->texels[level] + 4 * at[k];
            for (int c = 0; c < 4; c++) t[4 * k + c] = (float)from[c];
            continue;
        }
        const uint8_t *from = p->image->pixels + 4 * at[k];
        const bool opaque = p->kind != SVO_TEXEL_COLOR_ALPHA;
        const float alpha = opaque ? 65535 : from[3] * (1.0f / 255);
        for (int c = 0; c < 3; c++) t[4 * k + c] = opaque ? p->stored[from[c]] : p->linear[from[c]] * alpha;
        t[4 * k + 3] = alpha;
    }
    memcpy(out, t, sizeof t);
}

static inline int32_t around(int32_t i, int32_t n) { return i < 0 ? i + n : i >= n ? i - n : i; }

/* Readings of one lane that may reach over the edge of a texture that repeats. Less than a period away. */
static void mean_around(const svo_pyramid *p, const plan *n, float x0, float y0, pair *sum)
{
    const int32_t w = (int32_t)p->width[n->level], h = (int32_t)p->height[n->level];
    for (uint32_t i = 0; i < n->along; i++)
        for (uint32_t j = 0; j < n->across; j++) {
            const float x = x0 + ((float)i * n->step[0] + (float)j * n->side[0]), y = y0 + ((float)i * n->step[1] + (float)j * n->side[1]);
            const float bx = floorf(x), by = floorf(y), fx = x - bx, fy = y - by, rx = 1 - fx;
            const int32_t ix = around((int32_t)bx, w), iy = around((int32_t)by, h), next_x = ix + 1 < w ? ix + 1 : 0, next_y = iy + 1 < h ? iy + 1 : 0;
            const uint64_t upper = (uint64_t)(uint32_t)iy * (uint32_t)w, lower = (uint64_t)(uint32_t)next_y * (uint32_t)w;
            pair top, bottom;
            load_two(p, n->level, upper + (uint32_t)ix, upper + (uint32_t)next_x, &top);
            load_two(p, n->level, lower + (uint32_t)ix, lower + (uint32_t)next_x, &bottom);
            top += (bottom - top) * fy;
            *sum += top * (pair){rx, rx, rx, rx, fx, fx, fx, fx};
        }
}

/* Add a reading a lane, where t->texel, fx and fy say. */
static void add_taps(const svo_pyramid *p, uint32_t level, tap_lanes *t)
{
    const uint32_t w = p->width[level], count = t->count;
    for (uint32_t k = 0; p->outside && k < count; k++) touch(p, level, t->texel[k]);
    for (uint32_t k = 0; k < count; k++) {
        const float fx = t->fx[k], rx = 1 - fx;
        pair upper, lower;
        load_pair(p, level, t->texel[k], &upper);
        load_pair(p, level, (uint64_t)t->texel[k] + w, &lower);
        upper += (lower - upper) * t->fy[k];
        t->sum[k] += upper * (pair){rx, rx, rx, rx, fx, fx, fx, fx};
    }
}

static void read_taps(const svo_pyramid *p, const plan *n, tap_lanes *t)
{
    const uint32_t w = p->width[n->level], filled = (t->count + 7) & ~7u;
    for (uint32_t i = 0; i < n->along; i++)
        for (uint32_t j = 0; j < n->across; j++) {
            for (uint32_t k = 0; k < filled; k++) {
                const float x = t->x[k] + ((float)i * t->step_x[k] + (float)j * t->side_x[k]), y = t->y[k] + ((float)i * t->step_y[k] + (float)j * t->side_y[k]);
                const int32_t ix = (int32_t)x, iy = (int32_t)y; /* neither is negative */
                t->fx[k] = x - (float)ix;
                t->fy[k] = y - (float)iy;
                t->texel[k] = (uint32_t)iy * w + (uint32_t)ix;
            }
            add_taps(p, n->level, t);
        }
}

/* The mean of readings where one of them may reach over the edge. */
static void read_edge(const svo_texture *how, const svo_pyramid *p, const plan *n, float x0, float y0, bool near, float out[4])
{
    const uint32_t w = p->width[n->level], h = p->height[n->level];
    const float scale = unit(p, n->level) / (float)(n->along * n->across);
    if (near && how->wrap_u == SVO_WRAP_REPEAT && how->wrap_v == SVO_WRAP_REPEAT) {
        pair sum = {0};
        mean_around(p, n, x0, y0, &sum);
        for (int c = 0; c < 4; c++) out[c] = (sum[c] + sum[c + 4]) * scale;
        return;
    }
    float sum[4] = {0, 0, 0, 0}, texel[4];
    for (uint32_t i = 0; i < n->along; i++)
        for (uint32_t j = 0; j < n->across; j++) {
            const float x = x0 + ((float)i * n->step[0] + (float)j * n->side[0]), y = y0 + ((float)i * n->step[1] + (float)j * n->side[1]);
            svo_pyramid_sample(p, how, (double)(x + 0.5f) / w, (double)(y + 0.5f) / h, n->level, texel);
            for (int c = 0; c < 4; c++) sum[c] += texel[c];
        }
    for (int c = 0; c < 4; c++) out[c] = sum[c] / (float)(n->along * n->across);
}

typedef float quad __attribute__((vector_size(16)));

/* Means to one array a component. Sums behind the last are read, and do not matter. */
static void store_means(const tap_lanes *t, float scale, float (*out)[SVOI_LANES])
{
    for (uint32_t i = 0; i < t->count; i += 4) {
        quad a[4];
        for (uint32_t k = 0; k < 4; k++) {
            quad low, high;
            memcpy(&low, &t->sum[i + k], sizeof low);
            memcpy(&high, (const float *)&t->sum[i + k] + 4, sizeof high);
            a[k] = (low + high) * scale;
        }
        const quad r = {a[0][0], a[1][0], a[2][0], a[3][0]}, g = {a[0][1], a[1][1], a[2][1], a[3][1]}, b = {a[0][2], a[1][2], a[2][2], a[3][2]}, w = {a[0][3], a[1][3], a[2][3], a[3][3]};
        memcpy(&out[0][i], &r, sizeof r);
        memcpy(&out[1][i], &g, sizeof g);
        memcpy(&out[2][i], &b, sizeof b);
        memcpy(&out[3][i], &w, sizeof w);
    }
}

/* A texel number that may be one over the edge, or far away. */
static inline uint32_t wrapped(int64_t i, uint32_t n, svo_wrap mode)
{
    if (i >= 0 && i < n) return (uint32_t)i;
    if (mode == SVO_WRAP_CLAMP) return i < 0 ? 0 : n - 1;
    const int64_t period = mode == SVO_WRAP_MIRROR ? 2 * (int64_t)n : (int64_t)n;
    int64_t k = i % period;
    if (k < 0) k += period;
    return k < n ? (uint32_t)k : (uint32_t)(2 * (int64_t)n - 1 - k);
}

/* Two neighbours in a row of the image, or wherever they are, with all the precision that there is: one reading is all that is taken here. */
static inline void load_finest(const svo_pyramid *p, const uint8_t *left, const uint8_t *right, pair *out)
{
    const float *linear = p->linear;
    *out = (pair){linear[left[0]], linear[left[1]], linear[left[2]], 1, linear[right[0]], linear[right[1]], linear[right[2]], 1};
}

void svoi_read_points(const svo_texture *how, const svo_pyramid *p, svoi_lanes *l, float (*out)[SVOI_LANES])
{
    const uint32_t w = p->width[0], h = p->height[0], filled = (l->count + 7) & ~7u;
    const uint8_t *pixels = p->image->pixels;
    int32_t x[SVOI_LANES], y[SVOI_LANES], outside[SVOI_LANES];
    tap_lanes t;
    t.count = l->count;
    for (uint32_t i = l->count; i < filled; i++) l->at[0][i] = l->at[0][0], l->at[1][i] = l->at[1][0];
    for (uint32_t i = 0; i < filled; i++) {
        const double cx = l->at[0][i] - 0.5, cy = l->at[1][i] - 0.5, left = floor(cx), top = floor(cy);
        x[i] = (int32_t)left, y[i] = (int32_t)top;
        t.fx[i] = (float)(cx - left), t.fy[i] = (float)(cy - top);
    }
    for (uint32_t i = 0; i < filled; i++) outside[i] = ((uint32_t)x[i] >= w - 1) | ((uint32_t)y[i] >= h - 1);
    for (uint32_t i = 0; i < l->count; i++) {
        uint32_t x0 = (uint32_t)x[i], x1 = x0 + 1, y0 = (uint32_t)y[i], y1 = y0 + 1;
        if (outside[i]) {
            x0 = wrapped(x[i], w, how->wrap_u), x1 = wrapped((int64_t)x[i] + 1, w, how->wrap_u);
            y0 = wrapped(y[i], h, how->wrap_v), y1 = wrapped((int64_t)y[i] + 1, h, how->wrap_v);
        }
        if (p->outside) {
            const uint32_t corner[4][2] = {{x0, y0}, {x1, y0}, {x0, y1}, {x1, y1}};
            for (int k = 0; k < 4; k++) svo_image_touch(p->image, corner[k][0], corner[k][1], 1);
        }
        const uint8_t *top = pixels + 4 * (uint64_t)y0 * w, *bottom = pixels + 4 * (uint64_t)y1 * w;
        const float fx = t.fx[i], rx = 1 - fx;
        pair upper, lower;
        load_finest(p, top + 4 * (uint64_t)x0, top + 4 * (uint64_t)x1, &upper);
        load_finest(p, bottom + 4 * (uint64_t)x0, bottom + 4 * (uint64_t)x1, &lower);
        upper += (lower - upper) * t.fy[i];
        t.sum[i] = upper * (pair){rx, rx, rx, rx, fx, fx, fx, fx};
    }
    for (uint32_t i = l->count; i < filled; i++) t.sum[i] = (pair){0};
    store_means(&t, 1, out);
}

/* Where the middles of footprints are, in texels of a level, 0 at the middle of the first one. */
static void find_middles(const svoi_inner_texture *f, const svo_texture *how, const svo_pyramid *p, const svoi_lanes *l, uint32_t level, float *restrict cx, float *restrict cy)
{
    const float width = (float)p->width[level], height = (float)p->height[level], per_u = 1 / (float)p->width[0], per_v = 1 / (float)p->height[0];
    const float u0 = f->at[0], ux = f->per_x[0], uy = f->per_y[0], v0 = f->at[1], vx = f->per_x[1], vy = f->per_y[1];
    const float repeat_u = how->wrap_u == SVO_WRAP_REPEAT ? 1 : 0, repeat_v = how->wrap_v == SVO_WRAP_REPEAT ? 1 : 0;
    for (uint32_t i = 0, n = (l->count + 7) & ~7u; i < n; i++) {
        const float x = l->offset_x[i], y = l->offset_y[i], u = (u0 + (x * ux + y * uy)) * per_u, v = (v0 + (x * vx + y * vy)) * per_v;
        cx[i] = (u - floorf(u) * repeat_u) * width - 0.5f;
        cy[i] = (v - floorf(v) * repeat_v) * height - 0.5f;
    }
}

/* The lanes whose plans have the shape of `first`: which have all readings inside the level, which all less than a period away? */
static svoi_sorted_lanes sort_lanes(const svoi_inner_texture *f, const svoi_lanes *l, uint32_t first, const float *cx, const float *cy, float width, float height)
{
    if (svoi_clip_has_wide()) return svoi_wide_sort(f, l, f->alike[first], cx, cy, width, height);
    if (svoi_avx2_has()) return svoi_avx2_sort(f, l, first, cx, cy, width, height);
    svoi_sorted_lanes r = {0, 0, 0};
    for (uint32_t i = 0; i < l->count; i++) {
        const uint32_t step = l->step[i];
        if (f->shape[step] != first) continue;
        const float x = cx[i], y = cy[i], ex = f->reach_x[step], ey = f->reach_y[step];
        const uint64_t bit = (uint64_t)1 << i;
        if (x - ex > 0 && y - ey > 0 && x + ex < width - 1 && y + ey < height - 1) r.inside |= bit;
        else if (ex + 1 < width && ey + 1 < height) r.near |= bit;
        else r.far |= bit;
    }
    return r;
}

/* Those inside the level. */
static void read_inside(const svoi_inner_texture *f, const svo_pyramid *p, const svoi_lanes *l, const plan *shape, uint64_t lanes, const float *cx, const float *cy, float (*out)[SVOI_LANES])
{
    float mean[4][SVOI_LANES];
    tap_lanes t;
    t.count = 0;
    for (uint64_t rest = lanes; rest != 0; rest &= rest - 1) {
        const uint32_t i = (uint32_t)__builtin_ctzll(rest), k = t.count++, step = l->step[i];
        t.lane[k] = (uint8_t)i;
        t.x[k] = cx[i] - f->back_x[step], t.y[k] = cy[i] - f->back_y[step];
        t.step_x[k] = f->step_x[step], t.step_y[k] = f->step_y[step];
        t.side_x[k] = f->side_x[step], t.side_y[k] = f->side_y[step];
    }
    const uint32_t filled = (t.count + 7) & ~7u;
    for (uint32_t k = t.count; k < filled; k++) t.x[k] = t.y[k] = t.step_x[k] = t.step_y[k] = t.side_x[k] = t.side_y[k] = 0;
    memset(t.sum, 0, filled * sizeof *t.sum);
    read_taps(p, shape, &t);
    store_means(&t, unit(p, shape->level) / (float)(shape->along * shape->across), mean);
    for (int c = 0; c < 3; c++)
        for (uint32_t k = 0; k < t.count; k++) out[c][t.lane[k]] = mean[c][k];
}

/* The lanes whose plans have the shape of `first`. */
static void read_shape(const svoi_inner_texture *f, const svo_texture *how, const svo_pyramid *p, const svoi_lanes *l, uint32_t first, float (*out)[SVOI_LANES])
{
    const plan *shape = &f->plan[first];
    const uint32_t level = shape->level, w = p->width[level], h = p->height[level];
    float cx[SVOI_LANES], cy[SVOI_LANES];
    find_middles(f, how, p, l, level, cx, cy);
    const bool wide = svoi_clip_has_wide() && p->texels[level] != NULL && !p->outside, repeats = how->wrap_u == SVO_WRAP_REPEAT && how->wrap_v == SVO_WRAP_REPEAT;
    const float scale = unit(p, level) / (float)(shape->along * shape->across);
    svoi_sorted_lanes of = sort_lanes(f, l, first, cx, cy, (float)w, (float)h);
    if (reads_bytes(p, level)) {
        if (of.inside != 0) svoi_bytes_read(p->image->pixels, p->halves, w, h, f, shape, l, of.inside, false, cx, cy, scale, out);
        if (of.near != 0 && repeats) svoi_bytes_read(p->image->pixels, p->halves, w, h, f, shape, l, of.near, true, cx, cy, scale, out);
        if (repeats) of.near = 0;
    } else if (wide) {
        if (of.inside != 0) svoi_wide_read(p->texels[level], w, h, f, shape, l, of.inside, false, cx, cy, scale, out);
        if (of.near != 0 && repeats) svoi_wide_read(p->texels[level], w, h, f, shape, l, of.near, true, cx, cy, scale, out);
        if (repeats) of.near = 0;
    } else if (of.inside != 0 && reads_eight(p, level)) {
        const svoi_texels from = {p->texels[level], p->image->pixels, p->stored};
        svoi_avx2_read(&from, w, f, shape, l, of.inside, cx, cy, scale, out);
    } else if (of.inside != 0) {
        read_inside(f, p, l, shape, of.inside, cx, cy, out);
    }
    for (uint64_t rest = of.near | of.far; rest != 0; rest &= rest - 1) {
        const uint32_t i = (uint32_t)__builtin_ctzll(rest), step = l->step[i];
        float texel[4];
        read_edge(how, p, &f->plan[step], cx[i] - f->back_x[step], cy[i] - f->back_y[step], of.near >> i & 1, texel);
        for (int c = 0; c < 3; c++) out[c][i] = texel[c];
    }
}

void svoi_inner_read(const svoi_inner_texture *f, const svo_texture *how, const svo_pyramid *p, const svoi_lanes *l, float (*out)[SVOI_LANES])
{
    uint32_t steps = 0; /* bits of those that are there */
    for (uint32_t i = 0; i < l->count; i++) steps |= (uint32_t)1 << l->step[i];
    for (uint32_t i = l->count; i % 8 != 0; i++)
        for (int c = 0; c < 3; c++) out[c][i] = 0;
    while (steps != 0) {
        const uint32_t first = f->shape[__builtin_ctz(steps)];
        read_shape(f, how, p, l, first, out);
        steps &= ~f->alike[first];
    }
}
