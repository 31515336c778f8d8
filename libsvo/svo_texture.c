#include "svo_texture.h"

#include <math.h>
#include <string.h>

#if defined(__linux__)
#include <sys/mman.h>
#endif

#include "svo_channel.h"

void *svo_alloc_texels(const svo_allocator *a, uint64_t count, size_t size)
{
    void *p = svo_alloc(a, count, size);
#if defined(__linux__) && defined(MADV_HUGEPAGE)
    /* of the pages that lie in it altogether; refused where there is no such thing, which is well */
    const uint64_t page = 4096, least = 1 << 20, begin = ((uint64_t)(uintptr_t)p + page - 1) / page * page;
    if (p != NULL && count >= least / size) madvise((void *)(uintptr_t)begin, (size_t)(((uint64_t)(uintptr_t)p + count * size - begin) / page * page), MADV_HUGEPAGE);
#endif
    return p;
}

/* Is some level outside of memory? */
static inline bool is_paged(const svo_pyramid *p) { return p->outside; }
/* Make texels [x, x + count) of row y ready to be used; also their alpha. */
static void touch(const svo_pyramid *p, uint32_t level, uint32_t x, uint32_t y, uint32_t count)
{
    const uint64_t at = (uint64_t)y * p->width[level] + x;
    if (level == 0) {
        svo_image_touch(p->image, x, y, count);
    } else if (p->paged != NULL) {
        svo_paged_touch(p->paged, p->texels[level] + 4 * at, 8 * (uint64_t)count);
        if (p->most[level] != NULL) svo_paged_touch(p->paged, p->most[level] + at, count);
    }
}

static inline void texel(const svo_pyramid *p, uint32_t level, uint32_t x, uint32_t y, float out[4])
{
    if (level != 0) {
        const uint16_t *t = p->texels[level] + 4 * ((uint64_t)y * p->width[level] + x);
        for (int i = 0; i < 4; i++) out[i] = t[i] * (1.0f / 65535);
        return;
    }
    const uint8_t *t = p->image->pixels + 4 * ((uint64_t)y * p->width[0] + x);
    float alpha = p->kind == SVO_TEXEL_COLOR_ALPHA ? t[3] * (1.0f / 255) : 1;
    for (int i = 0; i < 3; i++) out[i] = p->linear[t[i]] * alpha;
    out[3] = alpha;
}

/* The same for even sizes, where each texel has four whole ones below it: in integers of the level's 16 bits, or of the table of the image. */
static bool halved(svo_pyramid *p, uint32_t to)
{
    const uint32_t from = to - 1, w = p->width[from], h = p->height[from];
    if (w != 2 * p->width[to] || h != 2 * p->height[to]) return false;
    uint16_t *out = p->texels[to];
    for (uint32_t y = 0; y < p->height[to]; y++) {
        touch(p, from, 0, 2 * y, w);
        touch(p, from, 0, 2 * y + 1, w);
        touch(p, to, 0, y, p->width[to]);
        for (uint32_t x = 0; x < p->width[to]; x++, out += 4) {
            const uint64_t at = 2 * ((uint64_t)y * w + x), corner[4] = {at, at + 1, at + w, at + w + 1};
            if (from != 0) {
                for (int k = 0; k < 4; k++) {
                    uint32_t sum = 2;
                    for (int c = 0; c < 4; c++) sum += p->texels[from][4 * corner[c] + (uint64_t)k];
                    out[k] = (uint16_t)(sum >> 2);
                }
            } else {
                float sum[4] = {0, 0, 0, 0};
                for (int c = 0; c < 4; c++) {
                    float t[4];
                    texel(p, 0, 2 * x + (uint32_t)(c & 1), 2 * y + (uint32_t)(c >> 1), t);
                    for (int k = 0; k < 4; k++) sum[k] += t[k];
                }
                for (int k = 0; k < 4; k++) out[k] = (uint16_t)(sum[k] * (65535 / 4.0f) + 0.5f);
            }
            if (p->most[to] == NULL) continue;
            uint8_t most = 0;
            for (int c = 0; c < 4; c++) {
                uint8_t alpha = from == 0 ? p->image->pixels[4 * corner[c] + 3] : p->most[from][corner[c]];
                if (alpha > most) most = alpha;
            }
            p->most[to][(uint64_t)y * p->width[to] + x] = most;
        }
    }
    return true;
}

/* One level from the one above it: box filter with exact overlaps. Texel i of m covers [i n / m, (i + 1) n / m) of n. */
static void average_level(svo_pyramid *p, uint32_t to)
{
    if (halved(p, to)) return;
    uint32_t from = to - 1, n[2] = {p->width[from], p->height[from]}, m[2] = {p->width[to], p->height[to]};
    for (uint32_t y = 0; y < m[1]; y++) {
        for (uint64_t j = (uint64_t)y * n[1] / m[1]; j * m[1] < ((uint64_t)y + 1) * n[1]; j++) touch(p, from, 0, (uint32_t)j, n[0]);
        touch(p, to, 0, y, m[0]);
        for (uint32_t x = 0; x < m[0]; x++) {
            double sum[4] = {0, 0, 0, 0};
            uint8_t most = 0;
            /* in units of 1/m of a source texel, so that all overlaps are integers */
            uint64_t y0 = (uint64_t)y * n[1], y1 = y0 + n[1], x0 = (uint64_t)x * n[0], x1 = x0 + n[0];
            for (uint64_t j = y0 / m[1]; j * m[1] < y1; j++) {
                uint64_t a = j * m[1] > y0 ? j * m[1] : y0, b = (j + 1) * m[1] < y1 ? (j + 1) * m[1] : y1;
                for (uint64_t i = x0 / m[0]; i * m[0] < x1; i++) {
                    uint64_t c = i * m[0] > x0 ? i * m[0] : x0, d = (i + 1) * m[0] < x1 ? (i + 1) * m[0] : x1;
                    float t[4];
                    texel(p, from, (uint32_t)i, (uint32_t)j, t);
                    double weight = (double)((b - a) * (d - c));
                    for (int k = 0; k < 4; k++) sum[k] += weight * t[k];
                    if (p->most[to] != NULL) {
                        uint64_t at = j * n[0] + i;
                        uint8_t alpha = from == 0 ? p->image->pixels[4 * at + 3] : p->most[from][at];
                        if (alpha > most) most = alpha;
                    }
                }
            }
            uint64_t at = (uint64_t)y * m[0] + x;
            double area = (double)((uint64_t)n[0] * n[1]);
            for (int k = 0; k < 4; k++) p->texels[to][4 * at + (uint64_t)k] = (uint16_t)(sum[k] / area * 65535 + 0.5);
            if (p->most[to] != NULL) p->most[to][at] = most;
        }
    }
}

/* Room for all levels above the image, in one array of the image's pager. */
static svo_result place_levels(svo_pyramid *p, svo_error *err)
{
    uint64_t texels = 0;
    for (uint32_t l = 1; l < p->levels; l++) texels += (uint64_t)p->width[l] * p->height[l];
    if (texels == 0) return SVO_OK;
    SVO_TRY(svo_paged_create(p->image->paged->pager, texels * (p->kind == SVO_TEXEL_COLOR_ALPHA ? 9 : 8), &p->paged, err));
    uint8_t *at = p->paged->data, *alpha = at + 8 * texels;
    for (uint32_t l = 1; l < p->levels; l++) {
        const uint64_t count = (uint64_t)p->width[l] * p->height[l];
        p->texels[l] = (uint16_t *)(void *)at;
        at += 8 * count;
        if (p->kind == SVO_TEXEL_COLOR_ALPHA) p->most[l] = alpha, alpha += count;
    }
    return SVO_OK;
}

void svo_pyramid_finest(const svo_image *image, svo_texel kind, svo_pyramid *out)
{
    *out = (svo_pyramid){.image = image, .kind = kind, .levels = 1};
    for (int i = 0; i < 256; i++) {
        out->linear[i] = kind == SVO_TEXEL_LINEAR ? (float)i * (1.0f / 255) : svo_srgb_to_linear((uint8_t)i);
        const uint16_t stored = (uint16_t)(out->linear[i] * 65535 + 0.5f);
        out->stored[i] = stored;
        out->halves[0][i] = (uint8_t)stored;
        out->halves[1][i] = (uint8_t)(stored >> 8);
    }
    out->outside = image->paged != NULL;
    out->width[0] = image->width;
    out->height[0] = image->height;
    out->share_x[0] = out->share_y[0] = 1;
}

svo_result svo_pyramid_create(const svo_image *image, svo_texel kind, const svo_allocator *a, svo_pyramid *out, svo_error *err)
{
    svo_pyramid p;
    svo_pyramid_finest(image, kind, &p);
    p.allocator = a;
    while (p.width[p.levels - 1] > 1 || p.height[p.levels - 1] > 1) {
        uint32_t l = p.levels++;
        p.width[l] = p.width[l - 1] > 1 ? p.width[l - 1] / 2 : 1;
        p.height[l] = p.height[l - 1] > 1 ? p.height[l - 1] / 2 : 1;
        p.share_x[l] = (float)p.width[l] / (float)p.width[0];
        p.share_y[l] = (float)p.height[l] / (float)p.height[0];
    }
    if (is_paged(&p)) SVO_TRY(place_levels(&p, err));
    for (uint32_t l = 1; l < p.levels; l++) {
        if (is_paged(&p)) {
            average_level(&p, l);
            continue;
        }
        uint64_t count = (uint64_t)p.width[l] * p.height[l];
        p.texels[l] = svo_alloc_texels(a, count, 8);
        if (kind == SVO_TEXEL_COLOR_ALPHA) p.most[l] = svo_alloc(a, count, 1);
        if (p.texels[l] == NULL || (kind == SVO_TEXEL_COLOR_ALPHA && p.most[l] == NULL)) {
            svo_pyramid_free(&p);
            return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the filtered levels of a %u x %u texture", image->width, image->height);
        }
        average_level(&p, l);
    }
    *out = p;
    return SVO_OK;
}

void svo_pyramid_expand(svo_pyramid *p)
{
    const uint64_t count = (uint64_t)p->width[0] * p->height[0];
    if (p->kind == SVO_TEXEL_COLOR_ALPHA || p->outside || p->texels[0] != NULL) return;
    p->texels[0] = svo_alloc_texels(p->allocator, count, 8);
    if (p->texels[0] == NULL) return;
    uint16_t stored[256];
    for (int i = 0; i < 256; i++) stored[i] = (uint16_t)p->stored[i];
    const uint8_t *from = p->image->pixels;
    for (uint64_t i = 0; i < count; i++, from += 4) {
        const uint64_t texel = stored[from[0]] | (uint64_t)stored[from[1]] << 16 | (uint64_t)stored[from[2]] << 32 | (uint64_t)65535 << 48;
        memcpy(p->texels[0] + 4 * i, &texel, 8); /* little-endian */
    }
}

void svo_pyramid_free(svo_pyramid *p)
{
    if (p == NULL) return;
    if (p->paged != NULL) {
        svo_paged_free(p->paged);
        p->paged = NULL;
        p->levels = 0;
        return;
    }
    for (uint32_t l = 0; l < p->levels; l++) {
        uint64_t count = (uint64_t)p->width[l] * p->height[l];
        svo_free(p->allocator, p->texels[l], count, 8);
        svo_free(p->allocator, p->most[l], count, 1);
        p->texels[l] = NULL;
        p->most[l] = NULL;
    }
    p->levels = 0;
}

/* Texel number of an integer position that may lie outside. |i| < 2^53. */
static inline uint32_t wrap(double i, uint32_t n, svo_wrap mode)
{
    if (i >= 0 && i < n) return (uint32_t)i;
    if (mode == SVO_WRAP_CLAMP) return i < 0 ? 0 : n - 1;
    double period = mode == SVO_WRAP_MIRROR ? 2.0 * n : n;
    double k = i - floor(i / period) * period; /* exact: integers below 2^53 */
    if (k >= period) k = 0;
    if (k < 0) k = 0;
    return k < n ? (uint32_t)k : (uint32_t)(2.0 * n - 1 - k);
}

/* Texture coordinates that are absurdly large have no fraction bits left; keep their arithmetic in range. */
static inline double sane(double t) { return t > -1e9 && t < 1e9 ? t : 0; }

typedef float texel4 __attribute__((vector_size(16)));
typedef uint16_t stored4 __attribute__((vector_size(8)));
typedef int32_t whole4 __attribute__((vector_size(16)));

static inline void texel_vector(const svo_pyramid *p, uint32_t level, uint32_t x, uint32_t y, texel4 *out)
{
    if (level != 0) { /* not yet divided by 65535 */
        stored4 t;
        memcpy(&t, p->texels[level] + 4 * ((uint64_t)y * p->width[level] + x), sizeof t);
        *out = __builtin_convertvector(__builtin_convertvector(t, whole4), texel4);
        return;
    }
    if (p->kind != SVO_TEXEL_COLOR_ALPHA) {
        const uint8_t *c = p->image->pixels + 4 * ((uint64_t)y * p->width[0] + x);
        *out = (texel4){p->linear[c[0]], p->linear[c[1]], p->linear[c[2]], 1};
        return;
    }
    float t[4];
    texel(p, 0, x, y, t);
    memcpy(out, t, sizeof t);
}

static __attribute__((noinline)) void touch_corners(const svo_pyramid *p, uint32_t level, uint32_t x0, uint32_t x1, uint32_t y0, uint32_t y1)
{
    touch(p, level, x0, y0, 1);
    touch(p, level, x1, y0, 1);
    touch(p, level, x0, y1, 1);
    touch(p, level, x1, y1, 1);
}

static void bilinear(const svo_pyramid *p, const svo_texture *how, uint32_t level, double u, double v, float out[4])
{
    const uint32_t w = p->width[level], h = p->height[level];
    double x = u * w - 0.5, y = v * h - 0.5;
    double fx = floor(x), fy = floor(y);
    uint32_t x0, x1, y0, y1;
    if (fx >= 0 && fx + 1 < w && fy >= 0 && fy + 1 < h) {
        x0 = (uint32_t)(int32_t)fx, x1 = x0 + 1, y0 = (uint32_t)(int32_t)fy, y1 = y0 + 1;
    } else {
        x0 = wrap(fx, w, how->wrap_u), x1 = wrap(fx + 1, w, how->wrap_u);
        y0 = wrap(fy, h, how->wrap_v), y1 = wrap(fy + 1, h, how->wrap_v);
    }
    if (is_paged(p)) touch_corners(p, level, x0, x1, y0, y1);
    texel4 a, b, c, d;
    const float s = (float)(x - fx), t = (float)(y - fy);
    texel_vector(p, level, x0, y0, &a);
    texel_vector(p, level, x1, y0, &b);
    texel_vector(p, level, x0, y1, &c);
    texel_vector(p, level, x1, y1, &d);
    a += (b - a) * s;
    c += (d - c) * s;
    a += (c - a) * t;
    if (level != 0) a *= 1.0f / 65535;
    memcpy(out, &a, sizeof a);
}

void svo_pyramid_sample(const svo_pyramid *p, const svo_texture *how, double u, double v, double level, float out[4])
{
    u = sane(u);
    v = sane(v);
    if (!(level > 0)) {
        if (how->nearest) {
            const uint32_t x = wrap(floor(u * p->width[0]), p->width[0], how->wrap_u), y = wrap(floor(v * p->height[0]), p->height[0], how->wrap_v);
            if (is_paged(p)) touch(p, 0, x, y, 1);
            texel(p, 0, x, y, out);
        } else {
            bilinear(p, how, 0, u, v, out);
        }
        return;
    }
    uint32_t last = p->levels - 1;
    if (level >= last) {
        bilinear(p, how, last, u, v, out);
        return;
    }
    uint32_t l = (uint32_t)level;
    float t = (float)(level - l), fine[4], coarse[4];
    if (t == 0) {
        bilinear(p, how, l, u, v, out);
        return;
    }
    bilinear(p, how, l, u, v, fine);
    bilinear(p, how, l + 1, u, v, coarse);
    for (int i = 0; i < 4; i++) out[i] = fine[i] + (coarse[i] - fine[i]) * t;
}

float svo_pyramid_most_alpha(const svo_pyramid *p, const svo_texture *how, double u0, double u1, double v0, double v1)
{
    u0 = sane(u0), u1 = sane(u1), v0 = sane(v0), v1 = sane(v1);
    /* A range of a whole period and more is the whole image; texels of other ranges are counted from its start. */
    double x0 = floor(u0 * p->width[0]), x1 = floor(u1 * p->width[0]), y0 = floor(v0 * p->height[0]), y1 = floor(v1 * p->height[0]);
    uint32_t level = 0;
    while (level + 1 < p->levels && (x1 - x0 > 3 || y1 - y0 > 3)) {
        /* texel x of n is inside texel floor(x m / n) of the next level's m, also across the wrapped copies */
        double sx = p->width[level], sy = p->height[level];
        level++;
        sx = p->width[level] / sx, sy = p->height[level] / sy;
        x0 = floor(x0 * sx), x1 = floor(x1 * sx);
        y0 = floor(y0 * sy), y1 = floor(y1 * sy);
    }
    /* rounding of the products above may lose a texel at an edge: widen coarse levels by one */
    if (level != 0) x0--, x1++, y0--, y1++;
    uint32_t w = p->width[level], h = p->height[level];
    if (x1 - x0 > 3 && x1 - x0 >= w) x0 = 0, x1 = w - 1;
    if (y1 - y0 > 3 && y1 - y0 >= h) y0 = 0, y1 = h - 1;
    uint8_t most = 0;
    for (double y = y0; y <= y1; y++)
        for (double x = x0; x <= x1; x++) {
            const uint32_t column = wrap(x, w, how->wrap_u), row = wrap(y, h, how->wrap_v);
            const uint64_t at = (uint64_t)row * w + column;
            if (is_paged(p)) touch(p, level, column, row, 1);
            uint8_t a = level == 0 ? p->image->pixels[4 * at + 3] : p->most[level][at];
            if (a > most) most = a;
        }
    return most * (1.0f / 255);
}
