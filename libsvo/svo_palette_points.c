/* Points and nearest entries: svoi_points.h. */
#include <math.h>
#include <stdlib.h>

#include "svo_color.h"
#include "svoi_points.h"

/* Cube root of a positive float: an estimate from the exponent, then Halley's iteration twice. */
static float cube_root(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits = bits / 3 + 0x2a5137a0u;
    float y;
    memcpy(&y, &bits, sizeof y);
    for (int i = 0; i < 2; i++) {
        float c = y * y * y;
        y = y * (c + 2 * x) / (2 * c + x);
    }
    return y;
}

static float lab_f(float t) { return t > 216.0f / 24389.0f ? cube_root(t) : (24389.0f / 27.0f * t + 16) / 116; }

svoi_point svoi_point_of(svo_channel_kind kind, bool rgb, uint32_t value)
{
    svoi_point p = {{0, 0, 0, 0}};
    uint8_t bytes[4] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};
    if (kind == SVO_KIND_NORMAL_OCT32) {
        svo_oct32_decode(bytes, p.x);
        for (int i = 0; i < 3; i++) p.x[i] *= 57.29577951f;
    } else if (rgb) {
        for (int i = 0; i < 3; i++) p.x[i] = bytes[i];
    } else { /* as svo_srgb8_to_lab */
        float r = svo_srgb_to_linear(bytes[0]), g = svo_srgb_to_linear(bytes[1]), b = svo_srgb_to_linear(bytes[2]);
        float x = (0.4124f * r + 0.3576f * g + 0.1805f * b) * (1 / (0.4124f + 0.3576f + 0.1805f));
        float y = (0.2126f * r + 0.7152f * g + 0.0722f * b) * (1 / (0.2126f + 0.7152f + 0.0722f));
        float z = (0.0193f * r + 0.1192f * g + 0.9505f * b) * (1 / (0.0193f + 0.1192f + 0.9505f));
        float fx = lab_f(x), fy = lab_f(y), fz = lab_f(z);
        p.x[0] = 116 * fy - 16, p.x[1] = 500 * (fx - fy), p.x[2] = 200 * (fy - fz);
        p.x[3] = sqrtf(p.x[1] * p.x[1] + p.x[2] * p.x[2]);
    }
    return p;
}

svoi_weights svoi_weights_of(svo_channel_kind kind, bool rgb, const svoi_point *p)
{
    svoi_weights w = {1, 0};
    if (kind == SVO_KIND_NORMAL_OCT32 || rgb) return w;
    float h = 1 / (1 + 0.015f * p->x[3]), c = 1 / (1 + 0.045f * p->x[3]);
    w.wh = h * h;
    w.wd = c * c - h * h;
    return w;
}

/* --- nearest ----------------------------------------------------------------------------------------------------- */

static uint64_t first_above(const svoi_points *t, float x)
{
    const float *sorted = t->sorted[0] + SVOI_NEAR_STEP;
    uint64_t low = 0, high = t->count;
    while (low < high) {
        uint64_t middle = (low + high) / 2;
        if (sorted[middle] < x) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* The nearest so far, nearest first. */
typedef struct nearest { float distance[SVOI_NEAR]; uint64_t at[SVOI_NEAR]; } nearest;

static void keep(nearest *n, uint64_t at, float d)
{
    uint32_t i = SVOI_NEAR - 1;
    for (; i > 0 && d < n->distance[i - 1]; i--) n->distance[i] = n->distance[i - 1], n->at[i] = n->at[i - 1];
    n->distance[i] = d;
    n->at[i] = at;
}

/* Look at entries [at, at + SVOI_NEAR_STEP) in the order along the first axis, counted from the padding. */
static void look_at(const svoi_points *t, uint64_t at, const svoi_point *middle, svoi_weights w, nearest *n)
{
    float d2[SVOI_NEAR_STEP], x0 = middle->x[0], x1 = middle->x[1], x2 = middle->x[2];
    const float *s0 = t->sorted[0] + at, *s1 = t->sorted[1] + at, *s2 = t->sorted[2] + at;
    for (uint32_t i = 0; i < SVOI_NEAR_STEP; i++) {
        float a = x0 - s0[i], b = x1 - s1[i], c = x2 - s2[i];
        d2[i] = a * a + w.wh * (b * b + c * c);
    }
    uint32_t closer = 0;
    for (uint32_t i = 0; i < SVOI_NEAR_STEP; i++) closer |= (uint32_t)(d2[i] < n->distance[SVOI_NEAR - 1]) << i;
    for (; closer != 0; closer &= closer - 1) {
        uint32_t i = (uint32_t)__builtin_ctz(closer);
        if (d2[i] < n->distance[SVOI_NEAR - 1]) keep(n, at + i, d2[i]);
    }
}

/* The entries nearest to the middle of a cell: outward from it along the first axis. Chroma and hue weigh the same here, between the two. */
static void fill_cell(const svoi_points *t, svoi_near_cell *c, const svoi_point *middle)
{
    svoi_weights w = svoi_weights_of(t->kind, t->squares, middle);
    w.wh += w.wd / 2;
    nearest n;
    for (int i = 0; i < SVOI_NEAR; i++) n.distance[i] = INFINITY, n.at[i] = UINT64_MAX;
    uint64_t up = first_above(t, middle->x[0]) + SVOI_NEAR_STEP, down = up;
    for (;;) { /* the padding is infinitely far away */
        float above = t->sorted[0][up] - middle->x[0], below = middle->x[0] - t->sorted[0][down - 1];
        bool upwards = above < below;
        float gap = upwards ? above : below;
        if (gap * gap >= n.distance[SVOI_NEAR - 1] || !(gap < INFINITY)) break;
        if (!upwards) down -= SVOI_NEAR_STEP < down ? SVOI_NEAR_STEP : down;
        look_at(t, upwards ? up : down, middle, w, &n);
        if (upwards) up = up + SVOI_NEAR_STEP < t->count + SVOI_NEAR_STEP ? up + SVOI_NEAR_STEP : t->count + SVOI_NEAR_STEP;
    }
    for (int i = 0; i < SVOI_NEAR; i++) c->entry[i] = (uint16_t)t->order[n.at[n.at[i] != UINT64_MAX ? i : 0] - SVOI_NEAR_STEP];
}

uint32_t svoi_near(const svoi_points *t, svoi_near_cache *cache, const float p[3])
{
    uint64_t key = 1;
    svoi_point at = {{p[0], p[1], p[2], 0}}, middle = {{0, 0, 0, 0}};
    if (t->kind == SVO_KIND_NORMAL_OCT32) { /* means lie inside the sphere; what is near is the same in their direction */
        float l = sqrtf(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
        for (int i = 0; i < 3 && l > 0; i++) at.x[i] = p[i] * (57.29577951f / l);
    }
    for (int i = 0; i < 3; i++) {
        int32_t cell = (int32_t)floorf(at.x[i] * t->per_cell);
        middle.x[i] = ((float)cell + 0.5f) * t->cell;
        key = key << 16 | (uint32_t)(cell & 0xffff);
    }
    svoi_near_cell *c = &cache->cell[(key * 0x9e3779b97f4a7c15u) >> (64 - SVOI_NEAR_BITS)];
    if (c->key != key) {
        if (t->kind == SVO_KIND_COLOR_SRGB8 && !t->squares) middle.x[3] = sqrtf(middle.x[1] * middle.x[1] + middle.x[2] * middle.x[2]);
        c->key = key;
        fill_cell(t, c, &middle);
    }
    if (t->kind == SVO_KIND_COLOR_SRGB8 && !t->squares) at.x[3] = sqrtf(at.x[1] * at.x[1] + at.x[2] * at.x[2]);
    svoi_weights w = svoi_weights_of(t->kind, t->squares, &at);
    uint32_t best = c->entry[0];
    float least = INFINITY;
    for (uint32_t i = 0; i < SVOI_NEAR; i++) {
        float d = svoi_distance2(&at, w, &t->table[c->entry[i]]);
        if (d < least) least = d, best = c->entry[i];
    }
    return best;
}

/* --- the table --------------------------------------------------------------------------------------------------- */

typedef struct sorted { float x; uint32_t entry; } sorted;

static int compare_sorted(const void *a, const void *b)
{
    const sorted *p = a, *q = b;
    if (p->x != q->x) return p->x < q->x ? -1 : 1;
    return (p->entry > q->entry) - (p->entry < q->entry);
}

svo_result svoi_lossy_prepare(svoi_encoder *e, svo_error *err)
{
    const svo_palette_job *j = e->job;
    const svo_allocator *a = j->allocator;
    svoi_points *t = svo_calloc(a, 1, sizeof *t);
    if (t == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    e->points = t;
    t->kind = j->kind;
    t->squares = j->goal.squares && j->kind == SVO_KIND_COLOR_SRGB8;
    t->count = j->table_count;
    t->price = (float)j->goal.price;
    t->cell = t->squares || j->kind == SVO_KIND_NORMAL_OCT32 ? 2 : 1; /* 12-bit normals are 3 degrees apart */
    double bound = j->goal.bound * 0.999 - 5e-4;
    if (bound < 0) bound = 0;
    if (j->kind == SVO_KIND_NORMAL_OCT32) bound = 2 * sin((bound < 180 ? bound : 180) / 2 / 57.29577951308232) * 57.29577951308232;
    t->bound2 = (float)(bound * bound);
    t->per_cell = 1 / t->cell;
    t->table = svo_alloc(a, t->count, sizeof *t->table);
    t->order = svo_alloc(a, t->count, sizeof *t->order);
    t->check = t->squares ? svo_alloc(a, t->count, sizeof *t->check) : t->table;
    for (int k = 0; k < 3; k++) t->sorted[k] = svo_alloc(a, t->count + 2 * SVOI_NEAR_STEP, sizeof *t->sorted[k]);
    sorted *s = svo_alloc(a, t->count, sizeof *s);
    if (t->count != 0 && (t->sorted[0] == NULL || t->sorted[1] == NULL || t->sorted[2] == NULL || t->table == NULL || t->order == NULL || t->check == NULL || s == NULL)) {
        svo_free(a, s, t->count, sizeof *s);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)"); /* svoi_lossy_release frees the rest */
    }
    for (uint64_t i = 0; i < t->count; i++) {
        t->table[i] = svoi_point_of(t->kind, t->squares, j->table[i]);
        if (t->squares) t->check[i] = svoi_point_of(t->kind, false, j->table[i]);
        s[i] = (sorted){t->table[i].x[0], (uint32_t)i};
    }
    if (t->count != 0) qsort(s, (size_t)t->count, sizeof *s, compare_sorted);
    for (uint64_t i = 0; i < t->count; i++) t->order[i] = s[i].entry;
    for (int k = 0; k < 3 && t->count != 0; k++)
        for (uint64_t i = 0; i < t->count + 2 * SVOI_NEAR_STEP; i++) {
            bool before = i < SVOI_NEAR_STEP, behind = i >= t->count + SVOI_NEAR_STEP;
            t->sorted[k][i] = before || behind ? (k == 0 ? (before ? -INFINITY : INFINITY) : 0) : t->table[t->order[i - SVOI_NEAR_STEP]].x[k];
        }
    svo_free(a, s, t->count, sizeof *s);
    return SVO_OK;
}

void svoi_lossy_release(svoi_encoder *e)
{
    svoi_points *t = e->points;
    if (t == NULL) return;
    const svo_allocator *a = e->job->allocator;
    if (t->check != t->table) svo_free(a, t->check, t->count, sizeof *t->check);
    svo_free(a, t->table, t->count, sizeof *t->table);
    svo_free(a, t->order, t->count, sizeof *t->order);
    for (int k = 0; k < 3; k++) svo_free(a, t->sorted[k], t->count + 2 * SVOI_NEAR_STEP, sizeof *t->sorted[k]);
    svo_free(a, t, 1, sizeof *t);
    e->points = NULL;
}
