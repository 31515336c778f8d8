/* PSNR and SSIM of two images. */
#include <math.h>
#include <string.h>

#include "svo_compare.h"

enum { WINDOW = 11, MAPS = 5 }; /* maps: x, y, x^2, y^2, x y, smoothed */

static void gaussian(double w[WINDOW])
{
    double sum = 0;
    for (int i = 0; i < WINDOW; i++) {
        double d = i - WINDOW / 2;
        w[i] = exp(-d * d / (2 * 1.5 * 1.5));
        sum += w[i];
    }
    for (int i = 0; i < WINDOW; i++) w[i] /= sum;
}

static double luma(const uint8_t *p) { return 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]; }

/* The five maps of one image row, smoothed along it: `out` holds MAPS rows of `columns` doubles. */
static void smooth_row(const uint8_t *a, const uint8_t *b, uint32_t columns, const double w[WINDOW], double *out)
{
    for (uint32_t x = 0; x < columns; x++) {
        double sum[MAPS] = {0};
        for (uint32_t k = 0; k < WINDOW; k++) {
            double u = luma(a + 4 * (size_t)(x + k)), v = luma(b + 4 * (size_t)(x + k));
            sum[0] += w[k] * u, sum[1] += w[k] * v;
            sum[2] += w[k] * u * u, sum[3] += w[k] * v * v, sum[4] += w[k] * u * v;
        }
        for (uint32_t m = 0; m < MAPS; m++) out[(size_t)m * columns + x] = sum[m];
    }
}

static svo_result mean_ssim(const svo_image *a, const svo_image *b, const svo_allocator *allocator, double *out, svo_error *err)
{
    *out = NAN;
    if (a->width < WINDOW || a->height < WINDOW) return SVO_OK;
    uint32_t columns = a->width - WINDOW + 1, rows = a->height - WINDOW + 1;
    size_t row_size = (size_t)MAPS * columns;
    double *ring = svo_alloc(allocator, WINDOW * row_size, sizeof *ring); /* the last WINDOW smoothed rows */
    if (ring == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    double w[WINDOW], total = 0;
    gaussian(w);
    const double c1 = (0.01 * 255) * (0.01 * 255), c2 = (0.03 * 255) * (0.03 * 255);
    for (uint32_t y = 0; y < a->height; y++) {
        size_t at = 4 * (size_t)y * a->width;
        smooth_row(a->pixels + at, b->pixels + at, columns, w, ring + (y % WINDOW) * row_size);
        if (y + 1 < WINDOW) continue;
        double row_total = 0;
        for (uint32_t x = 0; x < columns; x++) {
            double s[MAPS] = {0};
            for (uint32_t k = 0; k < WINDOW; k++) {
                const double *row = ring + ((y + 1 + k) % WINDOW) * row_size + x; /* oldest first */
                for (uint32_t m = 0; m < MAPS; m++) s[m] += w[k] * row[(size_t)m * columns];
            }
            double va = s[2] - s[0] * s[0], vb = s[3] - s[1] * s[1], cov = s[4] - s[0] * s[1];
            row_total += (2 * s[0] * s[1] + c1) * (2 * cov + c2) / ((s[0] * s[0] + s[1] * s[1] + c1) * (va + vb + c2));
        }
        total += row_total;
    }
    svo_free(allocator, ring, WINDOW * row_size, sizeof *ring);
    *out = total / ((double)columns * rows);
    return SVO_OK;
}

static double psnr(double mse) { return mse > 0 ? 10 * log10(255.0 * 255.0 / mse) : INFINITY; }

svo_result svo_compare_images(const svo_image *a, const svo_image *b, const svo_allocator *allocator, svo_compare_image *out,
                              svo_error *err)
{
    SVO_ASSERT(a->width == b->width && a->height == b->height);
    svo_compare_image r = {.pixels = (uint64_t)a->width * a->height};
    uint64_t sum[4] = {0}; /* exact: 2^28 pixels and more fit */
    for (uint64_t i = 0; i < r.pixels; i++) {
        const uint8_t *p = a->pixels + 4 * i, *q = b->pixels + 4 * i;
        r.alpha |= (p[3] & q[3]) != 255;
        if (memcmp(p, q, 4) == 0) continue;
        r.different++;
        for (int k = 0; k < 4; k++) {
            uint32_t d = p[k] > q[k] ? (uint32_t)(p[k] - q[k]) : (uint32_t)(q[k] - p[k]);
            if (d > r.max_difference) r.max_difference = d;
            sum[k] += (uint64_t)d * d;
        }
    }
    int channels = r.alpha ? 4 : 3;
    for (int k = 0; k < 4; k++) {
        r.mse[k] = (double)sum[k] / (double)r.pixels;
        r.psnr[k] = psnr(r.mse[k]);
        if (k < channels) r.mse_all += r.mse[k] / channels;
    }
    r.psnr_all = psnr(r.mse_all);
    SVO_TRY(mean_ssim(a, b, allocator, &r.ssim, err));
    *out = r;
    return SVO_OK;
}
