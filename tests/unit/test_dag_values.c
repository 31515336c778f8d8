/* Attribute values in pages: whatever of them lies in temporary files, compressed or not, reads are those of a plain array. */
#include <stdlib.h>
#include <string.h>

#include "fmt_spill.h"
#include "svo_task.h"
#include "svoi_dag.h"
#include "svoi_palette.h"
#include "test.h"

static svo_error err;

enum { STYLES = 4 };

/* One value, by kind of data: all equal, runs, smooth, noise. */
static void make_value(uint32_t style, uint64_t i, uint32_t stride, uint64_t *seed, uint8_t *to)
{
    const uint32_t v = style == 0 ? 77 : style == 1 ? (uint32_t)(i / 37 * 2654435761u) : style == 2 ? (uint32_t)(i >> 5 & 255) * 0x010101u + (uint32_t)(i * i & 3) : (uint32_t)test_random(seed);
    for (uint32_t b = 0; b < 4 && b < stride; b++) to[b] = (uint8_t)(v >> 8 * b);
}

/* Values, and the array that they should equal. */
typedef struct pair {
    svoi_values v;
    svoi_store store;
    uint8_t *plain;
} pair;

static void compare(const pair *p, uint64_t first, uint64_t n)
{
    uint8_t *buffer = malloc((size_t)n * p->v.stride + 1);
    const uint8_t *got = svoi_values_get(&p->v, first, n, buffer, &err);
    CHECK(got != NULL && memcmp(got, p->plain + first * p->v.stride, (size_t)n * p->v.stride) == 0);
    free(buffer);
}

static void compare_all(const pair *p, uint64_t *seed)
{
    const uint64_t count = p->v.count;
    for (uint64_t first = 0; first < count; first += SVO_SUPERBLOCK) compare(p, first, count - first < SVO_SUPERBLOCK ? count - first : SVO_SUPERBLOCK);
    for (uint64_t first = 0; first < count; first += SVOI_PAGE) compare(p, first, count - first < SVOI_PAGE ? count - first : SVOI_PAGE);
    for (int i = 0; i < 50; i++) { /* any range in a page */
        const uint64_t first = test_random(seed) % count, left = SVOI_PAGE - first % SVOI_PAGE, most = left < count - first ? left : count - first;
        compare(p, first, 1 + test_random(seed) % most);
    }
}

static void set_some(pair *p, uint32_t times, uint64_t *seed)
{
    for (uint32_t k = 0; k < times; k++) {
        uint64_t i = k % 3 == 0 && k >= 3 ? (p->v.count - 1) / 2 : test_random(seed) % p->v.count; /* one of them again and again */
        uint8_t value[4];
        make_value(3, i, p->v.stride, seed, value);
        CHECK_OK(svoi_values_set(&p->v, i, value));
        memcpy(p->plain + i * p->v.stride, value, p->v.stride);
    }
}

static svo_result put_pages(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *e)
{
    (void)worker;
    pair *p = user;
    uint8_t *bytes = malloc((size_t)SVOI_PAGE * p->v.stride);
    svo_result r = SVO_OK;
    for (uint64_t page = begin; page < end && r == SVO_OK; page++) {
        const uint64_t first = page * SVOI_PAGE, n = p->v.count - first < SVOI_PAGE ? p->v.count - first : SVOI_PAGE;
        for (uint64_t i = 0; i < n * p->v.stride; i++) p->plain[first * p->v.stride + i] ^= (uint8_t)(page + i / 5);
        memcpy(bytes, p->plain + first * p->v.stride, (size_t)n * p->v.stride);
        r = svoi_values_put(&p->v, page, bytes, e);
    }
    free(bytes);
    return r;
}

/* `budget` bytes stay in memory. */
static void check(const svo_spill *spill, uint32_t stride, uint32_t style, uint64_t budget, uint64_t count, uint64_t *seed)
{
    pair p = {.store = {.spill = spill, .budget = budget}, .plain = calloc(count, stride)};
    p.v = (svoi_values){.stride = stride, .store = &p.store};
    for (uint64_t at = 0; at < count;) {
        const uint64_t left = count - at, run = test_random(seed) % 3 == 0 ? 1 : 1 + test_random(seed) % 5000, n = run < left ? run : left;
        const bool zeros = n == 1;
        for (uint64_t i = 0; i < n && !zeros; i++) make_value(style, at + i, stride, seed, p.plain + (at + i) * stride);
        CHECK_OK(svoi_values_append(&p.v, zeros ? NULL : p.plain + at * stride, n, &err));
        at += n;
        if (test_random(seed) % 16 == 0) set_some(&p, 1, seed);
    }
    CHECK_U64(p.v.count, count);
    CHECK(p.store.resident <= budget + (uint64_t)SVOI_PAGE * stride);
    compare_all(&p, seed);
    set_some(&p, 100, seed);
    compare_all(&p, seed);
    CHECK_OK(svoi_values_spill(&p.v, &err));
    CHECK_U64(p.store.resident, 0);
    compare_all(&p, seed);
    set_some(&p, 100, seed);
    compare_all(&p, seed);
    CHECK_OK(svo_parallel_for(3, p.v.page_count, 1, put_pages, &p, &err));
    compare_all(&p, seed);
    for (uint64_t i = 0; i < p.v.page_count; i++) svoi_values_drop(&p.v, i);
    svoi_values_free(&p.v);
    CHECK_U64(p.store.resident, 0);
    free(p.plain);
}

TEST(values_are_those_of_an_array)
{
    uint64_t seed = 5;
    fmt_spill *s;
    fmt_spill_options o = {0};
    CHECK_OK(fmt_spill_open(&o, &s, &err));
    svo_spill plain = *fmt_spill_files(s);
    plain.compress = NULL;
    plain.decompress = NULL;
    for (uint32_t stride = 1; stride <= 4; stride++)
        for (uint32_t style = 0; style < STYLES; style++) {
            const uint64_t counts[] = {1, SVO_SUPERBLOCK + 1, SVOI_PAGE, 2 * SVOI_PAGE + 777};
            check(fmt_spill_files(s), stride, style, 1, counts[test_random(&seed) % 4], &seed);
            check(style % 2 == 0 ? &plain : fmt_spill_files(s), stride, style, (uint64_t)SVOI_PAGE * stride * 2, 3 * SVOI_PAGE + 1, &seed);
            if (test_failed()) return;
        }
    CHECK_U64(fmt_spill_count(s).bytes_now, 0);
    fmt_spill_close(s);
}

/* Constant values must take next to nothing on the disk, noise no more than itself. */
TEST(files_hold_what_values_need)
{
    for (uint32_t style = 0; style < STYLES; style++) {
        uint64_t seed = 9;
        fmt_spill *s;
        fmt_spill_options o = {0};
        CHECK_OK(fmt_spill_open(&o, &s, &err));
        svoi_store store = {.spill = fmt_spill_files(s), .budget = 1};
        svoi_values v = {.stride = 4, .store = &store};
        for (uint64_t i = 0; i < 4 * SVOI_PAGE; i++) {
            uint8_t value[4];
            make_value(style, i, 4, &seed, value);
            CHECK_OK(svoi_values_append(&v, value, 1, &err));
        }
        CHECK_OK(svoi_values_spill(&v, &err));
        const uint64_t raw = (uint64_t)4 * SVOI_PAGE * 4, held = fmt_spill_count(s).bytes_now;
        CHECK(held <= raw && held >= 4 * SVOI_PAGE_UNITS);
        CHECK(style == 3 || held < raw / 2);
        CHECK(style != 0 || held < raw / 50);
        svoi_values_free(&v);
        fmt_spill_close(s);
    }
}

static svo_result damaged(void *user, const void *packed, uint32_t packed_size, void *bytes, uint32_t size, svo_error *e)
{
    (void)user, (void)packed, (void)packed_size, (void)bytes, (void)size;
    return svo_fail(e, SVO_IO, "not what was written");
}

TEST(what_cannot_be_read_back_is_an_error)
{
    fmt_spill *s;
    fmt_spill_options o = {0};
    CHECK_OK(fmt_spill_open(&o, &s, &err));
    svo_spill bad = *fmt_spill_files(s);
    svoi_store store = {.spill = &bad, .budget = 1};
    svoi_values v = {.stride = 3, .store = &store};
    CHECK_OK(svoi_values_append(&v, NULL, 3000, &err));
    CHECK_OK(svoi_values_spill(&v, &err));
    uint8_t *buffer = malloc(9000);
    CHECK(svoi_values_get(&v, 0, 3000, buffer, &err) == buffer && buffer[8999] == 0);
    bad.decompress = damaged;
    memset(&err, 0, sizeof err);
    CHECK(svoi_values_get(&v, 1024, 1024, buffer, &err) == NULL && err.code == SVO_IO);
    free(buffer);
    svoi_values_free(&v);
    /* and a frame of the wrong bytes, by the real decoder */
    const svo_spill *files = fmt_spill_files(s);
    uint8_t in[256] = {0}, to[256], out[256];
    const uint32_t n = files->compress(files->user, in, sizeof in, to, sizeof to);
    CHECK(n > 0 && n < sizeof in);
    CHECK_OK(files->decompress(files->user, to, n, out, sizeof out, &err));
    CHECK(files->decompress(files->user, to, n, out, sizeof out - 1, &err) == SVO_IO);
    CHECK(files->decompress(files->user, to, n - 1, out, sizeof out, &err) == SVO_IO);
    CHECK_U64(files->compress(files->user, in, sizeof in, to, 4), 0);
    fmt_spill_close(s);
}
