/* Averages of textures over the parts of one triangle in many voxels: what svoi_read_texture says, but the footprints of a batch are
 * measured together, and a reading inside the image takes both texels of a row at once. */
#include <math.h>
#include <string.h>

#include "svoi_lanes.h"
#include "svoi_shade.h"

enum { MOST = 128, ACROSS = 4 }; /* readings of a footprint, and across its short axis */

/* Footprints in texels of the image: variances along the long and the short axis, the direction of the long one. */
typedef struct footprints { float large[SVOI_LANES], small[SVOI_LANES], x[SVOI_LANES], y[SVOI_LANES]; } footprints;

static void measure(const svo_facet_texture *f, const svoi_clip_batch *b, uint32_t count, footprints *out)
{
    const float ax = (float)f->per_x[0], ay = (float)f->per_y[0], bx = (float)f->per_x[1], by = (float)f->per_y[1];
    for (uint32_t i = 0; i < count; i++) {
        const float xx = b->xx[i], xy = b->xy[i], yy = b->yy[i];
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

/* How a footprint is read: level, counts of readings, and steps between them in texels of the level. */
typedef struct plan { uint32_t level, along, across; float step[2], side[2]; } plan;

static inline float spacing(float rest, uint32_t count) { return count > 1 && rest > 0 ? sqrtf(12 * rest / (float)(count * count - 1)) : 0; }

static void make_plan(const svo_pyramid *p, const footprints *f, uint32_t i, plan *out)
{
    const float length = sqrtf(12 * f->large[i]), breadth = sqrtf(12 * f->small[i]);
    uint32_t level = 0;
    float size = 1;
    while (level + 1 < p->levels && 2 * size <= 0.58f * breadth) level++, size *= 2;
    while (level + 1 < p->levels && !(length <= 1.6f * size * (float)(MOST / taps_for(breadth / size, ACROSS)))) level++, size *= 2;
    out->level = level;
    out->across = taps_for(breadth / size, ACROSS);
    out->along = taps_for(length / size, MOST / out->across);
    const float inherent = (size * size - 1) * 0.25f, step = spacing(f->large[i] - inherent, out->along), side = spacing(f->small[i] - inherent, out->across);
    const float sx = (float)p->width[level] / (float)p->width[0], sy = (float)p->height[level] / (float)p->height[0];
    out->step[0] = step * f->x[i] * sx, out->step[1] = step * f->y[i] * sy;
    out->side[0] = -side * f->y[i] * sx, out->side[1] = side * f->x[i] * sy;
}

typedef float pair __attribute__((vector_size(32)));
typedef uint16_t stored_pair __attribute__((vector_size(16)));
typedef int32_t whole_pair __attribute__((vector_size(32)));

/* Two neighbours in a row. Above the image, and for linear images, not yet divided by what they are stored with. */
static inline void load_pair(const svo_pyramid *p, uint32_t level, uint64_t at, pair *out)
{
    if (level != 0) {
        stored_pair t;
        memcpy(&t, p->texels[level] + 4 * at, sizeof t);
        *out = __builtin_convertvector(__builtin_convertvector(t, whole_pair), pair);
        return;
    }
    const uint8_t *t = p->image->pixels + 4 * at;
    const float *linear = p->linear;
    if (p->kind == SVO_TEXEL_COLOR) {
        *out = (pair){linear[t[0]], linear[t[1]], linear[t[2]], 1, linear[t[4]], linear[t[5]], linear[t[6]], 1};
    } else if (p->kind == SVO_TEXEL_LINEAR) {
        *out = (pair){t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7]};
    } else {
        const float a = t[3] * (1.0f / 255), b = t[7] * (1.0f / 255);
        *out = (pair){linear[t[0]] * a, linear[t[1]] * a, linear[t[2]] * a, a, linear[t[4]] * b, linear[t[5]] * b, linear[t[6]] * b, b};
    }
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

/* The mean of a plan's readings around a point of the image. False where one of them may reach beyond the level's edge. */
static inline bool mean_inside(const svo_pyramid *p, const svo_texture *how, const plan *n, const double at[2], float out[4])
{
    const uint32_t w = p->width[n->level], h = p->height[n->level];
    double cx = at[0] / p->width[0], cy = at[1] / p->height[0];
    if (how->wrap_u == SVO_WRAP_REPEAT) cx -= floor(cx);
    if (how->wrap_v == SVO_WRAP_REPEAT) cy -= floor(cy);
    cx = cx * w - 0.5, cy = cy * h - 0.5;
    const float along = 0.5f * (float)(n->along - 1), across = 0.5f * (float)(n->across - 1);
    const double ex = (double)(fabsf(n->step[0]) * along + fabsf(n->side[0]) * across) + 0.01, ey = (double)(fabsf(n->step[1]) * along + fabsf(n->side[1]) * across) + 0.01;
    if (!(cx - ex > 0 && cy - ey > 0 && cx + ex < w - 1.0 && cy + ey < h - 1.0)) return false;
    const uint32_t left = (uint32_t)(cx - ex), top = (uint32_t)(cy - ey);
    const float ox = (float)(cx - left) - along * n->step[0] - across * n->side[0], oy = (float)(cy - top) - along * n->step[1] - across * n->side[1];
    const uint64_t origin = (uint64_t)top * w + left;
    pair sum = {0};
    for (uint32_t i = 0; i < n->along; i++)
        for (uint32_t j = 0; j < n->across; j++) {
            const float x = ox + (float)i * n->step[0] + (float)j * n->side[0], y = oy + (float)i * n->step[1] + (float)j * n->side[1];
            const int32_t ix = (int32_t)x, iy = (int32_t)y; /* neither is negative */
            const float fx = x - (float)ix, fy = y - (float)iy, rx = 1 - fx;
            const uint64_t texel = origin + (uint64_t)(uint32_t)iy * w + (uint32_t)ix;
            pair upper, lower;
            if (p->outside) touch(p, n->level, texel);
            load_pair(p, n->level, texel, &upper);
            load_pair(p, n->level, texel + w, &lower);
            upper += (lower - upper) * fy;
            sum += upper * (pair){rx, rx, rx, rx, fx, fx, fx, fx};
        }
    const float scale = (n->level != 0 ? 1.0f / 65535 : p->kind == SVO_TEXEL_LINEAR ? 1.0f / 255 : 1) / (float)(n->along * n->across);
    for (int k = 0; k < 4; k++) out[k] = (sum[k] + sum[k + 4]) * scale;
    return true;
}

void svoi_read_footprints(const svo_facet_texture *f, const svo_texture *how, const svo_pyramid *p, const svoi_lanes *l, float (*out)[SVOI_LANES])
{
    footprints prints;
    measure(f, &l->clip, l->count, &prints);
    for (uint32_t i = 0; i < l->count; i++) {
        const double at[2] = {l->at[0][i], l->at[1][i]}, width = 1.0 / p->width[0], height = 1.0 / p->height[0];
        float texel[4];
        plan n = {.along = 1, .across = 1};
        if (prints.large[i] > 0.03f) make_plan(p, &prints, i, &n); /* wider than 0.6 texels */
        if (!mean_inside(p, how, &n, at, texel)) {
            float sum[4] = {0, 0, 0, 0};
            const double sx = (double)p->width[0] / p->width[n.level], sy = (double)p->height[0] / p->height[n.level];
            for (uint32_t j = 0; j < n.along; j++)
                for (uint32_t k = 0; k < n.across; k++) {
                    const float r = (float)j - 0.5f * (float)(n.along - 1), q = (float)k - 0.5f * (float)(n.across - 1);
                    const double x = at[0] + (double)(r * n.step[0] + q * n.side[0]) * sx, y = at[1] + (double)(r * n.step[1] + q * n.side[1]) * sy;
                    svo_pyramid_sample(p, how, x * width, y * height, n.level, texel);
                    for (int c = 0; c < 4; c++) sum[c] += texel[c];
                }
            for (int c = 0; c < 4; c++) texel[c] = sum[c] / (float)(n.along * n.across);
        }
        for (int c = 0; c < 4; c++) out[c][i] = texel[c];
    }
}
