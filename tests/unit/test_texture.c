/* Texture filtering against brute force. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_channel.h"
#include "svo_texture.h"
#include "test.h"

static svo_image random_image(uint32_t width, uint32_t height, uint64_t seed)
{
    svo_image image = {.width = width, .height = height, .has_alpha = true};
    image.pixels = malloc((size_t)width * height * 4);
    for (size_t i = 0; i < (size_t)width * height * 4; i++) image.pixels[i] = (uint8_t)test_random(&seed);
    return image;
}

static void linear_texel(const svo_image *image, svo_texel kind, int64_t x, int64_t y, double out[4])
{
    const uint8_t *p = image->pixels + 4 * ((size_t)y * image->width + (size_t)x);
    double alpha = kind == SVO_TEXEL_COLOR_ALPHA ? p[3] / 255.0 : 1;
    for (int i = 0; i < 3; i++) {
        double c = p[i] / 255.0, l = c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4);
        out[i] = kind == SVO_TEXEL_LINEAR ? c : kind == SVO_TEXEL_COLOR_ALPHA ? l * alpha : l;
    }
    out[3] = alpha;
}

static int64_t wrap_index(int64_t i, int64_t n, svo_wrap mode)
{
    if (mode == SVO_WRAP_CLAMP) return i < 0 ? 0 : i >= n ? n - 1 : i;
    if (mode == SVO_WRAP_REPEAT) return ((i % n) + n) % n;
    int64_t k = ((i % (2 * n)) + 2 * n) % (2 * n);
    return k < n ? k : 2 * n - 1 - k;
}

TEST(every_level_averages_all_texels)
{
    const uint32_t sizes[][2] = {{1, 1}, {8, 8}, {7, 5}, {1, 9}, {13, 1}, {33, 20}, {3, 2}};
    for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++)
        for (int kind = 0; kind < 3; kind++) {
            svo_image image = random_image(sizes[s][0], sizes[s][1], s + 1);
            double mean[4] = {0, 0, 0, 0}, texel[4];
            for (uint32_t y = 0; y < image.height; y++)
                for (uint32_t x = 0; x < image.width; x++) {
                    linear_texel(&image, (svo_texel)kind, x, y, texel);
                    for (int i = 0; i < 4; i++) mean[i] += texel[i] / (image.width * image.height);
                }
            svo_pyramid p;
            svo_error err;
            CHECK_OK(svo_pyramid_create(&image, (svo_texel)kind, NULL, &p, &err));
            CHECK(p.width[p.levels - 1] == 1 && p.height[p.levels - 1] == 1);
            for (uint32_t l = 1; l < p.levels; l++) { /* box filters with exact overlaps keep the mean on every level */
                double sum[4] = {0, 0, 0, 0};
                uint64_t count = (uint64_t)p.width[l] * p.height[l];
                for (uint64_t i = 0; i < 4 * count; i++) sum[i % 4] += p.texels[l][i] / 65535.0 / (double)count;
                for (int i = 0; i < 4; i++) CHECK_MSG(fabs(sum[i] - mean[i]) < 1e-4, "level %u of %u x %u: %g, mean %g", l, image.width, image.height, sum[i], mean[i]);
            }
            svo_pyramid_free(&p);
            free(image.pixels);
        }
}

TEST(bilinear_reading_agrees_with_brute_force)
{
    uint64_t seed = 4;
    for (int k = 0; k < 3000; k++) {
        svo_image image = random_image(1 + (uint32_t)(test_random(&seed) % 9), 1 + (uint32_t)(test_random(&seed) % 9), (uint64_t)k);
        svo_texel kind = (svo_texel)(k % 3);
        svo_texture how = svo_texture_none();
        how.wrap_u = (svo_wrap)(test_random(&seed) % 3);
        how.wrap_v = (svo_wrap)(test_random(&seed) % 3);
        how.nearest = k % 5 == 0;
        double u = 6 * test_random_unit(&seed) - 3, v = 6 * test_random_unit(&seed) - 3;
        svo_pyramid p;
        svo_error err;
        CHECK_OK(svo_pyramid_create(&image, kind, NULL, &p, &err));
        float got[4];
        svo_pyramid_sample(&p, &how, u, v, -1, got);
        double expected[4] = {0, 0, 0, 0}, texel[4];
        double x = u * image.width - 0.5, y = v * image.height - 0.5;
        if (how.nearest) x = floor(x + 0.5), y = floor(y + 0.5);
        for (int c = 0; c < 4; c++) {
            int64_t i = (int64_t)floor(x) + (c & 1), j = (int64_t)floor(y) + (c >> 1);
            double weight = (c & 1 ? x - floor(x) : 1 - (x - floor(x))) * (c >> 1 ? y - floor(y) : 1 - (y - floor(y)));
            linear_texel(&image, kind, wrap_index(i, image.width, how.wrap_u), wrap_index(j, image.height, how.wrap_v), texel);
            for (int t = 0; t < 4; t++) expected[t] += weight * texel[t];
        }
        for (int t = 0; t < 4; t++) CHECK_MSG(fabs(got[t] - expected[t]) < 1e-5, "%g %g: %g, expected %g", u, v, got[t], expected[t]);
        svo_pyramid_free(&p);
        free(image.pixels);
    }
}

TEST(bad_coordinates_read_something_finite)
{
    svo_image image = random_image(5, 3, 1);
    svo_pyramid p;
    svo_error err;
    CHECK_OK(svo_pyramid_create(&image, SVO_TEXEL_COLOR_ALPHA, NULL, &p, &err));
    const double bad[] = {NAN, INFINITY, -INFINITY, 1e300, -1e300, 1e9, -999999999.5, 0, 1, 5e-324};
    for (size_t i = 0; i < 10; i++)
        for (size_t j = 0; j < 10; j++)
            for (int w = 0; w < 3; w++) {
                svo_texture how = svo_texture_none();
                how.wrap_u = how.wrap_v = (svo_wrap)w;
                float out[4];
                for (double level = -1; level < 5; level += 0.7) {
                    svo_pyramid_sample(&p, &how, bad[i], bad[j], level, out);
                    for (int t = 0; t < 4; t++) CHECK(out[t] >= 0 && out[t] <= 1);
                }
                float most = svo_pyramid_most_alpha(&p, &how, bad[i], bad[j], bad[j], bad[i]);
                CHECK(most >= 0 && most <= 1);
            }
    svo_pyramid_free(&p);
    free(image.pixels);
}

TEST(largest_alpha_is_a_bound_and_exact_when_small)
{
    uint64_t seed = 8;
    for (int k = 0; k < 2000; k++) {
        svo_image image = random_image(1 + (uint32_t)(test_random(&seed) % 40), 1 + (uint32_t)(test_random(&seed) % 40), (uint64_t)k);
        svo_texture how = svo_texture_none();
        how.wrap_u = (svo_wrap)(test_random(&seed) % 3);
        how.wrap_v = (svo_wrap)(test_random(&seed) % 3);
        svo_pyramid p;
        svo_error err;
        CHECK_OK(svo_pyramid_create(&image, SVO_TEXEL_COLOR_ALPHA, NULL, &p, &err));
        double size = k % 2 ? 3.0 / image.width : 0.7, tall = k % 2 ? 3.0 / image.height : 0.7;
        double u0 = 4 * test_random_unit(&seed) - 2, v0 = 4 * test_random_unit(&seed) - 2;
        double u1 = u0 + size * test_random_unit(&seed), v1 = v0 + tall * test_random_unit(&seed);
        float got = svo_pyramid_most_alpha(&p, &how, u0, u1, v0, v1);
        int64_t x0 = (int64_t)floor(u0 * image.width), x1 = (int64_t)floor(u1 * image.width);
        int64_t y0 = (int64_t)floor(v0 * image.height), y1 = (int64_t)floor(v1 * image.height);
        uint8_t most = 0;
        for (int64_t y = y0; y <= y1; y++)
            for (int64_t x = x0; x <= x1; x++) {
                uint8_t a = image.pixels[4 * ((size_t)wrap_index(y, image.height, how.wrap_v) * image.width + (size_t)wrap_index(x, image.width, how.wrap_u)) + 3];
                if (a > most) most = a;
            }
        CHECK_MSG(got >= most / 255.0f - 1e-6f, "%g is below %g", got, most / 255.0);
        if (x1 - x0 <= 3 && y1 - y0 <= 3) CHECK_MSG(got <= most / 255.0f + 1e-6f, "%g is not %g", got, most / 255.0);
        svo_pyramid_free(&p);
        free(image.pixels);
    }
}

TEST(out_of_memory_leaves_nothing)
{
    svo_image image = random_image(33, 17, 1);
    for (uint64_t n = 1; n < 40; n++) {
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = n;
        svo_pyramid p;
        svo_error err;
        svo_result r = svo_pyramid_create(&image, SVO_TEXEL_COLOR_ALPHA, &a.base, &p, &err);
        if (r == SVO_OK) svo_pyramid_free(&p);
        else CHECK(r == SVO_OUT_OF_MEMORY);
        CHECK_U64(svo_limit_in_use(&a), 0);
    }
    free(image.pixels);
}
