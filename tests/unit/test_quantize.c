/* Quantisation: bounds hold for every value, tables are no larger than asked for, errors are what they are said to be,
 * threads do not show, and clustering is close to the best that brute force finds. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_color.h"
#include "svo_quantize.h"
#include "test.h"

typedef struct values { uint32_t *v; uint64_t *times; uint64_t count; } values;

static int compare_u32(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

/* style 0: uniform; 1: clusters; 2: greys; 3: neighbours of each other */
static values random_values(uint64_t count, bool normals, int style, uint64_t *seed)
{
    values x = {calloc(count + 1, sizeof(uint32_t)), calloc(count + 1, sizeof(uint64_t)), 0};
    uint32_t center = 0;
    for (uint64_t i = 0; i < count; i++) {
        uint32_t v = (uint32_t)test_random(seed);
        if (normals) {
            if ((v & 0xffff) == 0x8000) v++;
            if (v >> 16 == 0x8000) v += 0x10000;
        } else {
            v &= 0xffffff;
            if (i % 100 == 0) center = v & 0xe0e0e0;
            if (style == 1) v = center | (v & 0x1f1f1f);
            if (style == 2) v = (v & 0xff) * 0x10101;
            if (style == 3) v = 0x808080 + (v & 0x070707);
        }
        x.v[i] = v;
    }
    qsort(x.v, count, sizeof *x.v, compare_u32);
    for (uint64_t i = 0; i < count; i++)
        if (x.count == 0 || x.v[x.count - 1] != x.v[i]) x.v[x.count++] = x.v[i];
    for (uint64_t i = 0; i < x.count; i++) x.times[i] = 1 + test_random(seed) % 50 * (test_random(seed) % 3);
    return x;
}

static void values_free(values *x)
{
    free(x->v);
    free(x->times);
}

static double error_of(svo_channel_kind kind, uint32_t from, uint32_t to)
{
    uint8_t a[4], b[4];
    float x[3], y[3];
    memcpy(a, &from, 4);
    memcpy(b, &to, 4);
    if (kind == SVO_KIND_COLOR_SRGB8) {
        svo_srgb8_to_lab(a, x);
        svo_srgb8_to_lab(b, y);
        return svo_delta_e94(x, y);
    }
    svo_oct32_decode(a, x);
    svo_oct32_decode(b, y);
    double s = 0; /* by the chord, another way than the library's */
    for (int i = 0; i < 3; i++) s += ((double)x[i] - y[i]) * ((double)x[i] - y[i]);
    return 2 * asin(sqrt(s) / 2) * 57.29577951308232;
}

static uint64_t distinct(const uint32_t *v, uint64_t count)
{
    uint32_t *copy = malloc((count + 1) * sizeof *copy);
    memcpy(copy, v, count * sizeof *copy);
    qsort(copy, count, sizeof *copy, compare_u32);
    uint64_t n = 0;
    for (uint64_t i = 0; i < count; i++)
        if (i == 0 || copy[i] != copy[i - 1]) n++;
    free(copy);
    return n;
}

/* Runs, compares two numbers of threads, measures; false when a check failed. */
static bool run(svo_channel_kind kind, const values *x, svo_dag_options o, uint32_t *mapped, double *mean, double *most)
{
    svo_error err = {0};
    svo_quantize_result q, q7;
    uint32_t *other = calloc(x->count + 1, sizeof *other);
    o.threads = 1;
    svo_result r = svo_quantize(kind, x->v, x->times, x->count, &o, NULL, mapped, &q, &err);
    o.threads = 7;
    if (r == SVO_OK) r = svo_quantize(kind, x->v, x->times, x->count, &o, NULL, other, &q7, &err);
    bool ok = r == SVO_OK && memcmp(mapped, other, x->count * sizeof *other) == 0 && q.error_mean == q7.error_mean && q.error_max == q7.error_max;
    free(other);
    double sum = 0, weight = 0;
    *most = 0;
    for (uint64_t i = 0; i < x->count && ok; i++) {
        double e = error_of(kind, x->v[i], mapped[i]);
        if (e > *most) *most = e;
        sum += e * (double)x->times[i];
        weight += (double)x->times[i];
    }
    *mean = weight > 0 ? sum / weight : 0;
    double slack = kind == SVO_KIND_NORMAL_OCT32 ? 2e-5 : 1e-9; /* floats decode a normal to 1e-7 */
    if (!ok || fabs(*mean - q.error_mean) > slack || fabs(*most - q.error_max) > slack) {
        test_fail(__FILE__, __LINE__, "%s; mean %g reported %g, max %g reported %g", err.message, *mean, q.error_mean, *most, q.error_max);
        return false;
    }
    return true;
}

TEST(lossless_maps_to_itself)
{
    uint64_t seed = 1;
    values x = random_values(1000, false, 0, &seed);
    uint32_t mapped[1001];
    double mean, most;
    svo_dag_options o = svo_default_dag_options();
    CHECK(run(SVO_KIND_COLOR_SRGB8, &x, o, mapped, &mean, &most));
    CHECK(memcmp(mapped, x.v, x.count * 4) == 0);
    o.color_bits = 10; /* fewer than 1024 colours stay as they are; labels always do */
    CHECK(run(SVO_KIND_COLOR_SRGB8, &x, o, mapped, &mean, &most));
    CHECK(memcmp(mapped, x.v, x.count * 4) == 0 && most == 0);
    o.color_bits = 1;
    CHECK(run(SVO_KIND_ID32, &x, o, mapped, &mean, &most));
    CHECK(memcmp(mapped, x.v, x.count * 4) == 0);
    values_free(&x);
}

TEST(color_tables)
{
    uint64_t seed = 2;
    for (int style = 0; style < 4; style++) {
        values x = random_values(style == 0 ? 20000 : 6000, false, style, &seed);
        uint32_t *mapped = calloc(x.count, sizeof *mapped);
        double last = INFINITY, mean = 0, most;
        for (uint32_t bits = 1; bits <= 12; bits += bits < 4 ? 1 : 4) {
            svo_dag_options o = {.color_bits = bits};
            if (!run(SVO_KIND_COLOR_SRGB8, &x, o, mapped, &mean, &most)) return;
            CHECK(distinct(mapped, x.count) <= (uint64_t)1 << bits);
            CHECK_MSG(mean < last || mean == 0, "style %d: %u bits give %g after %g", style, bits, mean, last);
            last = mean;
        }
        /* The seed reports 1.5 to 1.75 for scenes of up to millions of colours with 4096; uniform ones are harder. */
        CHECK_MSG(mean < 2, "style %d: mean delta E %g with 4096 colours", style, mean);
        free(mapped);
        values_free(&x);
    }
}

/* Two groups far apart and a table of two: the table must separate them. */
TEST(two_groups)
{
    uint32_t v[6] = {0x000000, 0x000001, 0x000100, 0xfefeff, 0xfffeff, 0xffffff}, mapped[6];
    uint64_t times[6] = {5, 1, 1, 1, 1, 100};
    values x = {v, times, 6};
    svo_dag_options o = {.color_bits = 1};
    double mean, most;
    CHECK(run(SVO_KIND_COLOR_SRGB8, &x, o, mapped, &mean, &most));
    CHECK(mapped[0] == mapped[1] && mapped[1] == mapped[2] && mapped[3] == mapped[4] && mapped[4] == mapped[5]);
    CHECK(mapped[0] != mapped[3] && most < 2);
}

TEST(color_bound_holds_for_every_color)
{
    static const double bounds[] = {0.01, 0.5, 1, 3, 10, 30, 200};
    uint64_t seed = 3;
    for (int style = 0; style < 4; style++) {
        values x = random_values(8000, false, style, &seed);
        uint32_t *mapped = calloc(x.count, sizeof *mapped);
        uint64_t last = UINT64_MAX;
        for (size_t b = 0; b < sizeof bounds / sizeof bounds[0]; b++) {
            svo_dag_options o = {.color_delta_e = bounds[b]};
            double mean, most;
            if (!run(SVO_KIND_COLOR_SRGB8, &x, o, mapped, &mean, &most)) return;
            CHECK_MSG(most <= bounds[b], "%g over the bound %g", most, bounds[b]);
            uint64_t n = distinct(mapped, x.count);
            CHECK(n <= last);
            last = n;
            /* a representative occurs itself, and no colour that could be covered by a more frequent one stands alone:
               greedy covers are maximal, so representatives are farther apart than the bound, one way */
            if (style == 3 && b == 2) CHECK(n < x.count / 4);
        }
        CHECK_U64(last, 1); /* nothing is 200 apart from anything */
        free(mapped);
        values_free(&x);
    }
}

TEST(normal_bits)
{
    uint64_t seed = 4;
    values x = random_values(20000, true, 0, &seed);
    uint32_t *mapped = calloc(x.count, sizeof *mapped);
    double last = INFINITY;
    for (uint32_t bits = 4; bits <= 32; bits += 2) {
        svo_dag_options o = {.normal_bits = bits};
        double mean, most;
        if (!run(SVO_KIND_NORMAL_OCT32, &x, o, mapped, &mean, &most)) return;
        uint64_t steps = ((uint64_t)2 << (bits / 2 - 1)) - 1;
        CHECK(distinct(mapped, x.count) <= steps * steps);
        CHECK(most < last);
        /* the worst is about half a diagonal of the grid, stretched by the map: below 120 degrees / 2^(bits/2 - 1) */
        CHECK_MSG(most < 120.0 / (double)(1u << (bits / 2 - 1)), "%u bits: %g degrees", bits, most);
        last = most;
        if (bits == 32) CHECK(most == 0 && memcmp(mapped, x.v, x.count * 4) == 0);
    }
    free(mapped);
    values_free(&x);
}

TEST(axes_stay_axes)
{
    static const float axis[6][3] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    for (uint32_t bits = 4; bits <= 32; bits += 2)
        for (int i = 0; i < 6; i++) {
            uint8_t code[4], out[4];
            uint32_t v;
            float n[3];
            svo_oct32_encode(axis[i], code);
            memcpy(&v, code, 4);
            v = svo_quantize_normal(v, bits);
            memcpy(out, &v, 4);
            svo_oct32_decode(out, n);
            for (int k = 0; k < 3; k++) CHECK(fabsf(n[k] - axis[i][k]) < 1e-6f);
        }
}

TEST(normal_bound_holds_for_every_normal)
{
    static const double bounds[] = {1e-9, 0.001, 0.01, 0.1, 1, 5, 45, 180};
    uint64_t seed = 5;
    values x = random_values(20000, true, 0, &seed);
    uint32_t *mapped = calloc(x.count, sizeof *mapped);
    for (size_t b = 0; b < sizeof bounds / sizeof bounds[0]; b++) {
        svo_dag_options o = {.normal_degrees = bounds[b]};
        double mean, most;
        if (!run(SVO_KIND_NORMAL_OCT32, &x, o, mapped, &mean, &most)) return;
        CHECK_MSG(most <= bounds[b] + 2e-5, "%g over the bound %g", most, bounds[b]);
    }
    free(mapped);
    values_free(&x);
}

TEST(out_of_memory)
{
    uint64_t seed = 6;
    values x = random_values(3000, false, 0, &seed);
    uint32_t *mapped = calloc(x.count, sizeof *mapped);
    for (int bound = 0; bound < 2; bound++) {
        svo_result r = SVO_OUT_OF_MEMORY;
        for (uint64_t n = 1; r != SVO_OK; n++) {
            svo_limit_allocator limit;
            svo_limit_allocator_init(&limit, UINT64_MAX, NULL);
            limit.fail_at = n;
            svo_dag_options o = {.color_bits = bound ? 0 : 4, .color_delta_e = bound ? 2 : 0, .threads = 1};
            svo_quantize_result q;
            svo_error err = {0};
            r = svo_quantize(SVO_KIND_COLOR_SRGB8, x.v, x.times, x.count, &o, &limit.base, mapped, &q, &err);
            CHECK(r == SVO_OK || r == SVO_OUT_OF_MEMORY);
            CHECK_U64(svo_limit_in_use(&limit), 0);
            CHECK(n < 10000);
        }
    }
    free(mapped);
    values_free(&x);
}
