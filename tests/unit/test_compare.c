/* Colour difference, PSNR, SSIM and the comparison of octrees, against values worked out by hand or in the papers. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_svo.h"
#include "svo_color.h"
#include "svo_compare.h"
#include "svo_morton.h"
#include "test.h"
#include "trees.h"

static bool near(double a, double b, double tolerance) { return fabs(a - b) <= tolerance; }

/* Published CIELAB (D65) values of the sRGB primaries, to four decimals with this matrix. */
TEST(lab_of_known_colours)
{
    static const struct { uint8_t rgb[3]; double lab[3]; } known[] = {
        {{255, 255, 255}, {100, 0, 0}},
        {{0, 0, 0}, {0, 0, 0}},
        {{255, 0, 0}, {53.2408, 80.0925, 67.2032}},
        {{0, 255, 0}, {87.7347, -86.1827, 83.1793}},
        {{0, 0, 255}, {32.2970, 79.1875, -107.8602}},
        {{119, 119, 119}, {50.0344, 0, 0}},
    };
    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        float lab[3];
        svo_srgb8_to_lab(known[i].rgb, lab);
        for (int k = 0; k < 3; k++)
            CHECK_MSG(near(lab[k], known[i].lab[k], 0.02), "colour %zu component %d: %.5f, expected %.5f", i, k, lab[k], known[i].lab[k]);
    }
}

TEST(greys_have_no_chroma_and_rise)
{
    float before = -1;
    for (int v = 0; v < 256; v++) {
        uint8_t rgb[3] = {(uint8_t)v, (uint8_t)v, (uint8_t)v};
        float lab[3];
        svo_srgb8_to_lab(rgb, lab);
        CHECK(near(lab[1], 0, 1e-5) && near(lab[2], 0, 1e-5));
        CHECK(lab[0] > before);
        before = lab[0];
    }
}

TEST(delta_e94_by_hand)
{
    /* Only lightness differs. */
    CHECK(near(svo_delta_e94((float[]){50, 0, 0}, (float[]){53, 0, 0}), 3, 1e-9));
    /* Same hue: the reference's chroma 20 gives SC = 1.9, so 10 / 1.9; the other way round SC = 2.35. */
    CHECK(near(svo_delta_e94((float[]){50, 20, 0}, (float[]){50, 30, 0}), 10 / 1.9, 1e-9));
    CHECK(near(svo_delta_e94((float[]){50, 30, 0}, (float[]){50, 20, 0}), 10 / 2.35, 1e-9));
    /* Same chroma 20, hue turned by 90 degrees: dH^2 = 800, SH = 1.3. */
    CHECK(near(svo_delta_e94((float[]){50, 20, 0}, (float[]){50, 0, 20}), sqrt(800) / 1.3, 1e-9));
    /* All three at once: C 5 -> 13, SC = 1.225, SH = 1.075, da^2 + db^2 = 4 + 64 = 68, dC^2 = 64. */
    CHECK(near(svo_delta_e94((float[]){50, 3, 4}, (float[]){48, 5, 12}), sqrt(4 + 64 / (1.225 * 1.225) + 4 / (1.075 * 1.075)), 1e-9));
    CHECK(svo_delta_e94((float[]){12, 3, -4}, (float[]){12, 3, -4}) == 0);
}

/* --- octrees --- */

static svo_result compare(const tree *a, const tree *b, const svo_compare_options *options, svo_compare_result *out, svo_error *err)
{
    const tree *trees[2] = {a, b};
    svo_buffer file[2];
    fmt_input *in[2];
    fmt_svo_reader *reader[2];
    svo_chunk_source source[2];
    for (int i = 0; i < 2; i++) {
        svo_buffer_init(&file[i], NULL);
        tree_write(trees[i], 1, &file[i], NULL);
        if (fmt_input_open_memory(file[i].data, file[i].size, &in[i], err) != SVO_OK) abort();
        if (fmt_svo_reader_open(in[i], NULL, &reader[i], err) != SVO_OK) abort();
        source[i] = fmt_svo_reader_source(reader[i]);
    }
    svo_result r = svo_compare_trees(fmt_svo_reader_info(reader[0]), &source[0], fmt_svo_reader_info(reader[1]), &source[1], options, out, err);
    for (int i = 0; i < 2; i++) {
        fmt_svo_reader_close(reader[i]);
        fmt_input_close(in[i]);
        svo_buffer_free(&file[i]);
    }
    return r;
}

static void copy_tree(const tree *a, tree *b)
{
    *b = *a;
    b->codes = malloc(a->capacity * sizeof *b->codes + 8);
    memcpy(b->codes, a->codes, a->count * sizeof *b->codes);
    for (uint32_t c = 0; c < a->info.channel_count; c++) {
        if (a->values[c] == NULL) continue;
        size_t size = a->count * svo_channel_stride(a->info.channels[c].kind);
        b->values[c] = malloc(size + 8);
        memcpy(b->values[c], a->values[c], size);
    }
}

static void drop_voxel(tree *t, uint64_t i)
{
    t->count--;
    memmove(t->codes + i, t->codes + i + 1, (t->count - i) * sizeof *t->codes);
    for (uint32_t c = 0; c < t->info.channel_count; c++) {
        size_t stride = svo_channel_stride(t->info.channels[c].kind);
        if (t->values[c] != NULL) memmove(t->values[c] + i * stride, t->values[c] + (i + 1) * stride, (t->count - i) * stride);
    }
}

/* The error of two values, written down a second time and more slowly. */
static double slow_error(svo_channel_kind kind, const uint8_t *a, const uint8_t *b)
{
    if (memcmp(a, b, svo_channel_stride(kind)) == 0) return 0;
    if (kind == SVO_KIND_COLOR_SRGB8) {
        float la[3], lb[3];
        svo_srgb8_to_lab(a, la);
        svo_srgb8_to_lab(b, lb);
        return svo_delta_e94(la, lb);
    }
    if (kind == SVO_KIND_NORMAL_OCT32) {
        float u[3], v[3];
        svo_oct32_decode(a, u);
        svo_oct32_decode(b, v);
        double chord = 0; /* the angle from the chord, where the comparison uses cross and dot product */
        for (int i = 0; i < 3; i++) chord += ((double)u[i] - v[i]) * ((double)u[i] - v[i]);
        return 2 * asin(chord > 4 ? 1 : sqrt(chord) / 2) * 180 / acos(-1);
    }
    return kind == SVO_KIND_UNORM8 ? abs(a[0] - b[0]) / 255.0 : 1;
}

static void check_against_lists(const tree *a, const tree *b, const svo_compare_result *r)
{
    uint64_t only_a = 0, only_b = 0, both = 0, first = UINT64_MAX, different[SVO_MAX_CHANNELS] = {0};
    bool first_in_a = false;
    double sum[SVO_MAX_CHANNELS] = {0}, max[SVO_MAX_CHANNELS] = {0};
    for (uint64_t i = 0; i < a->count; i++) {
        uint64_t j = 0;
        while (j < b->count && b->codes[j] != a->codes[i]) j++;
        if (j == b->count) {
            only_a++;
            if (a->codes[i] < first) first = a->codes[i], first_in_a = true;
            continue;
        }
        both++;
        for (uint32_t c = 0; c < a->info.channel_count; c++) {
            uint32_t stride = svo_channel_stride(a->info.channels[c].kind);
            const uint8_t *va = a->info.channels[c].constant ? a->info.channels[c].value : a->values[c] + i * stride;
            const uint8_t *vb = b->info.channels[c].constant ? b->info.channels[c].value : b->values[c] + j * stride;
            double e = slow_error(a->info.channels[c].kind, va, vb);
            different[c] += memcmp(va, vb, stride) != 0;
            sum[c] += e;
            if (e > max[c]) max[c] = e;
        }
    }
    for (uint64_t j = 0; j < b->count; j++) {
        uint64_t i = 0;
        while (i < a->count && a->codes[i] != b->codes[j]) i++;
        if (i < a->count) continue;
        only_b++;
        if (b->codes[j] < first) first = b->codes[j], first_in_a = false;
    }
    CHECK(r->same_depth && r->same_transform && r->transform_distance == 0);
    CHECK_U64(r->voxels_a, a->count);
    CHECK_U64(r->voxels_b, b->count);
    CHECK_U64(r->only_a, only_a);
    CHECK_U64(r->only_b, only_b);
    CHECK_U64(r->both, both);
    CHECK(only_a + only_b == 0 || (r->first == first && r->first_in_a == first_in_a));
    CHECK_U64(r->channel_count, a->info.channel_count);
    for (uint32_t c = 0; c < r->channel_count; c++) {
        CHECK_U64(r->channels[c].different, different[c]);
        CHECK_MSG(near(r->channels[c].mean, both > 0 ? sum[c] / (double)both : 0, 1e-3), "channel %u mean %g", c, r->channels[c].mean);
        CHECK_MSG(near(r->channels[c].max, max[c], 1e-2), "channel %u max %g, expected %g", c, r->channels[c].max, max[c]);
    }
}

TEST(octrees_against_lists_of_voxels)
{
    uint64_t seed = 11;
    static const uint32_t depths[] = {0, 1, 2, 5, 7, 8, 10, 21};
    for (size_t d = 0; d < sizeof depths / sizeof *depths; d++) {
        for (uint32_t style = 0; style < TREE_STYLES; style++) {
            tree a, b;
            svo_error err = {0};
            svo_compare_options options = {0};
            svo_compare_result r;
            tree_random(&a, depths[d], style, &seed);
            copy_tree(&a, &b);
            CHECK_OK(compare(&a, &b, &options, &r, &err));
            check_against_lists(&a, &b, &r);
            for (uint32_t c = 0; c < r.channel_count; c++) CHECK(r.channels[c].different == 0 && r.channels[c].max == 0);
            /* change values in some voxels, drop some of either side */
            for (uint32_t c = 0; c < a.info.channel_count; c++) {
                size_t stride = svo_channel_stride(a.info.channels[c].kind);
                if (b.values[c] == NULL) continue;
                for (uint64_t i = 0; i < b.count; i += 1 + test_random(&seed) % 40) b.values[c][i * stride] ^= (uint8_t)(1 + test_random(&seed) % 7);
            }
            CHECK_OK(compare(&a, &b, &options, &r, &err));
            check_against_lists(&a, &b, &r);
            for (int i = 0; i < 9 && a.count > 1 && b.count > 1; i++) {
                drop_voxel(&a, test_random(&seed) % a.count);
                drop_voxel(&b, test_random(&seed) % b.count);
            }
            CHECK_OK(compare(&a, &b, &options, &r, &err));
            check_against_lists(&a, &b, &r);
            if (test_failed()) return;
            tree_free(&a);
            tree_free(&b);
        }
    }
}

TEST(octrees_that_share_nothing)
{
    uint64_t seed = 3;
    tree a, b;
    svo_error err = {0};
    svo_compare_options options = {0};
    svo_compare_result r;
    tree_random(&a, 12, 2, &seed);
    tree_random(&b, 12, 1, &seed);
    CHECK_OK(compare(&a, &b, &options, &r, &err));
    CHECK_U64(r.only_a + r.both, a.count);
    CHECK_U64(r.only_b + r.both, b.count);
    /* the channels of both, each told apart */
    CHECK_U64(r.channel_count, 7);
    for (uint32_t c = 0; c < 7; c++) CHECK(!r.channels[c].comparable && r.channels[c].in_a == (c < 2) && r.channels[c].in_b == (c >= 2));
    /* empty against anything */
    tree empty = {.info = a.info};
    CHECK_OK(compare(&empty, &a, &options, &r, &err));
    CHECK(r.only_a == 0 && r.only_b == a.count && r.both == 0 && r.first == a.codes[0] && !r.first_in_a);
    /* another depth: no comparison, but both are counted */
    b.info.depth = 13;
    CHECK_OK(compare(&a, &b, &options, &r, &err));
    CHECK(!r.same_depth && r.voxels_a == a.count && r.voxels_b == b.count && r.channel_count == 0);
    /* a moved grid */
    tree moved;
    copy_tree(&a, &moved);
    moved.info.voxel_to_world[3] += 2;
    CHECK_OK(compare(&a, &moved, &options, &r, &err));
    CHECK(!r.same_transform && near(r.transform_distance, 2, 1e-9) && r.only_a + r.only_b == 0);
    options.max_voxels = a.count + moved.count - 1;
    CHECK_RESULT(compare(&a, &moved, &options, &r, &err), SVO_LIMIT);
    tree_free(&a);
    tree_free(&b);
    tree_free(&moved);
}

TEST(comparison_gives_back_its_memory_when_it_runs_out)
{
    uint64_t seed = 9;
    tree a, b;
    tree_random(&a, 9, 1, &seed);
    copy_tree(&a, &b);
    drop_voxel(&b, 5);
    for (uint64_t n = 1;; n++) {
        svo_limit_allocator limit;
        svo_limit_allocator_init(&limit, 1 << 30, NULL);
        limit.fail_at = n;
        svo_error err = {0};
        svo_compare_options options = {.allocator = &limit.base};
        svo_compare_result r;
        svo_result result = compare(&a, &b, &options, &r, &err);
        CHECK_U64(svo_limit_in_use(&limit), 0);
        if (result == SVO_OK) {
            CHECK(n > 4);
            break;
        }
        CHECK(result == SVO_OUT_OF_MEMORY);
    }
    tree_free(&a);
    tree_free(&b);
}

/* --- images --- */

static svo_image make_image(uint32_t w, uint32_t h)
{
    svo_image image = {.width = w, .height = h, .pixels = malloc(4 * (size_t)w * h)};
    memset(image.pixels, 255, 4 * (size_t)w * h);
    return image;
}

TEST(psnr_by_hand)
{
    svo_image a = make_image(20, 10), b = make_image(20, 10);
    svo_error err = {0};
    svo_compare_image r;
    CHECK_OK(svo_compare_images(&a, &b, NULL, &r, &err));
    CHECK(r.different == 0 && r.max_difference == 0 && isinf(r.psnr_all) && !r.alpha);
    CHECK(isnan(r.ssim)); /* 10 rows are too few */
    /* one of 200 pixels differs by 10 in red and 20 in green: mse 0.5, 2, 0 and 2.5 / 3 over all */
    b.pixels[4 * 33] = 245, b.pixels[4 * 33 + 1] = 235;
    CHECK_OK(svo_compare_images(&a, &b, NULL, &r, &err));
    CHECK(r.pixels == 200 && r.different == 1 && r.max_difference == 20);
    CHECK(near(r.mse[0], 0.5, 1e-12) && near(r.mse[1], 2, 1e-12) && r.mse[2] == 0);
    CHECK(near(r.psnr[0], 51.141103565318916, 1e-9) && near(r.psnr[1], 45.120503652038, 1e-6) && isinf(r.psnr[2]));
    CHECK(near(r.psnr_all, 10 * log10(65025 / (2.5 / 3)), 1e-9));
    /* alpha is a fourth channel as soon as one image uses it */
    b.pixels[4 * 7 + 3] = 254;
    CHECK_OK(svo_compare_images(&a, &b, NULL, &r, &err));
    CHECK(r.alpha && r.different == 2 && near(r.mse_all, (2.5 + 1 / 200.0) / 4, 1e-12));
    free(a.pixels);
    free(b.pixels);
}

/* SSIM from its definition: every window, two-dimensional weights, central moments. */
static double slow_ssim(const svo_image *a, const svo_image *b)
{
    double w[11][11], sum = 0, total = 0;
    for (int i = 0; i < 11; i++)
        for (int j = 0; j < 11; j++) sum += w[i][j] = exp(-((i - 5) * (i - 5) + (j - 5) * (j - 5)) / 4.5);
    for (uint32_t y = 0; y + 11 <= a->height; y++) {
        for (uint32_t x = 0; x + 11 <= a->width; x++) {
            double mu[2] = {0}, var[2] = {0}, cov = 0, luma[2][11][11];
            for (uint32_t i = 0; i < 121; i++) {
                size_t at = 4 * ((size_t)(y + i / 11) * a->width + x + i % 11);
                const uint8_t *p[2] = {a->pixels + at, b->pixels + at};
                for (int k = 0; k < 2; k++) {
                    luma[k][i / 11][i % 11] = 0.299 * p[k][0] + 0.587 * p[k][1] + 0.114 * p[k][2];
                    mu[k] += w[i / 11][i % 11] / sum * luma[k][i / 11][i % 11];
                }
            }
            for (uint32_t i = 0; i < 121; i++) {
                double da = luma[0][i / 11][i % 11] - mu[0], db = luma[1][i / 11][i % 11] - mu[1], q = w[i / 11][i % 11] / sum;
                var[0] += q * da * da, var[1] += q * db * db, cov += q * da * db;
            }
            total += (2 * mu[0] * mu[1] + 6.5025) * (2 * cov + 58.5225) /
                     ((mu[0] * mu[0] + mu[1] * mu[1] + 6.5025) * (var[0] + var[1] + 58.5225));
        }
    }
    return total / ((double)(a->width - 10) * (a->height - 10));
}

TEST(ssim_against_its_definition)
{
    static const uint32_t sizes[][2] = {{11, 11}, {12, 30}, {45, 17}, {64, 64}};
    uint64_t state = 2;
    for (int s = 0; s < 4; s++) {
        svo_image a = make_image(sizes[s][0], sizes[s][1]), b = make_image(sizes[s][0], sizes[s][1]);
        svo_error err = {0};
        svo_compare_image r;
        for (size_t i = 0; i < 4 * (size_t)a.width * a.height; i++) {
            a.pixels[i] = (uint8_t)(i % 4 == 3 ? 255 : 100 + 50 * sin((double)i / 20) + (double)(test_random(&state) % 40));
            b.pixels[i] = (uint8_t)(i % 4 == 3 ? 255 : a.pixels[i] + test_random(&state) % 30);
        }
        CHECK_OK(svo_compare_images(&a, &b, NULL, &r, &err));
        CHECK_MSG(near(r.ssim, slow_ssim(&a, &b), 1e-9), "%.12f, expected %.12f", r.ssim, slow_ssim(&a, &b));
        CHECK(r.ssim < 0.999);
        CHECK_OK(svo_compare_images(&a, &a, NULL, &r, &err));
        CHECK(r.ssim == 1);
        free(a.pixels);
        free(b.pixels);
    }
    /* two flat greys: only the luminance term is left */
    svo_image a = make_image(16, 16), b = make_image(16, 16);
    svo_error err = {0};
    svo_compare_image r;
    for (size_t i = 0; i < 1024; i++) a.pixels[i] = i % 4 == 3 ? 255 : 100, b.pixels[i] = i % 4 == 3 ? 255 : 150;
    CHECK_OK(svo_compare_images(&a, &b, NULL, &r, &err));
    CHECK(near(r.ssim, (2.0 * 100 * 150 + 6.5025) / (100.0 * 100 + 150.0 * 150 + 6.5025), 1e-9));
    free(a.pixels);
    free(b.pixels);
}
