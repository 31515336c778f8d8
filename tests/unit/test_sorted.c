/* Sorted arrays in memory and in temporary files: the order is that of qsort, whatever the keys, the number of records and how many of them fit in a run. */
#include <stdlib.h>
#include <string.h>

#include "fmt_spill.h"
#include "svoi_sorted.h"
#include "test.h"

enum { RUN = 4096 /* records at least: svo_sorted.c */, MOST = 64 };

/* Records begin with the key's 44 bits; the rest of their bytes tells them apart. */
static uint64_t key_of(const void *record, const void *user)
{
    (void)user;
    uint64_t key;
    memcpy(&key, record, sizeof key);
    return key & (((uint64_t)1 << SVOI_SORT_BITS) - 1);
}

static uint32_t stride; /* of compare */
static int compare(const void *a, const void *b) { return memcmp(a, b, stride); }

static int by_order(const void *a, const void *b)
{
    const uint64_t x = key_of(a, NULL), y = key_of(b, NULL);
    return x != y ? (x < y ? -1 : 1) : compare(a, b);
}

typedef enum keys { KEYS_RANDOM, KEYS_FEW, KEYS_SAME, KEYS_UP, KEYS_DOWN, KEYS_KINDS } keys;

static uint8_t *records(keys kind, uint64_t count, uint64_t *seed)
{
    uint8_t *r = malloc(count * stride + 1);
    for (uint64_t i = 0; i < count; i++) {
        uint64_t key = test_random(seed);
        for (uint32_t k = 0; k < stride; k++) r[i * stride + k] = (uint8_t)test_random(seed);
        switch (kind) {
        case KEYS_FEW: key %= 5; break;
        case KEYS_SAME: key = 77; break;
        case KEYS_UP: key = i << 20; break;
        case KEYS_DOWN: key = (count - i) << 9; break;
        default: break;
        }
        if (kind == KEYS_SAME && i % 3 == 0) memset(r + i * stride, 9, stride); /* equal in all bytes too */
        memcpy(r + i * stride, &key, sizeof key);
    }
    return r;
}

static const svo_allocator *plain; /* NULL: the default */

static svo_result sort(const svoi_room *room, const uint8_t *r, uint64_t count, uint64_t total, svoi_store *out, uint64_t *sorted, svo_error *err)
{
    const svoi_order order = {key_of, compare, NULL};
    svoi_sorter s;
    svo_result result = svoi_sorter_begin(&s, room, &order, stride, total, err);
    for (uint64_t i = 0; result == SVO_OK && i < count; i++) result = svoi_sorter_put(&s, r + i * stride, err);
    if (result == SVO_OK) return svoi_sorter_end(&s, out, sorted, err);
    svoi_sorter_drop(&s);
    return result;
}

static void expect_sorted(const svoi_room *room, keys kind, uint64_t count, uint64_t *seed)
{
    svo_error err = {0};
    svoi_store out;
    uint64_t sorted = 0;
    uint8_t *r = records(kind, count, seed);
    /* Room for more than come is fine. */
    CHECK_OK(sort(room, r, count, count + count / 8, &out, &sorted, &err));
    CHECK_U64(sorted, count);
    qsort(r, count, stride, by_order);
    uint64_t wrong = 0;
    for (uint64_t i = 0; i < count; i++) wrong += memcmp(svoi_at(&out, i), r + i * stride, stride) != 0;
    CHECK_MSG(wrong == 0, "%d keys, %d records of %u: %d wrong", (int)kind, (int)count, stride, (int)wrong);
    svoi_store_free(&out);
    free(r);
}

static const uint64_t counts[] = {0, 1, 2, 15, 16, 17, 1000, RUN - 1, RUN, RUN + 1, 3 * RUN + 5, 40000};

TEST(in_memory)
{
    uint64_t seed = 1;
    const svoi_room room = {.allocator = plain};
    for (stride = 8; stride <= MOST; stride += 28)
        for (uint32_t k = 0; k < KEYS_KINDS; k++)
            for (uint32_t c = 0; c < sizeof counts / sizeof *counts; c++) expect_sorted(&room, (keys)k, counts[c], &seed);
}

TEST(in_temporary_files)
{
    uint64_t seed = 2;
    svo_error err = {0};
    fmt_spill *spill;
    svo_pager *pager;
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder()}, &spill, &err));
    CHECK_OK(svo_pager_create(fmt_spill_files(spill), 1 << 20, 0, plain, &pager, &err)); /* 16 pieces resident */
    const svoi_room rooms[] = {{plain, pager, 0}, {plain, pager, 600000}};
    for (uint32_t i = 0; i < 2; i++)
        for (stride = 8; stride <= MOST; stride += 28)
            for (uint32_t k = 0; k < KEYS_KINDS; k++)
                for (uint32_t c = 0; c < sizeof counts / sizeof *counts; c++) expect_sorted(&rooms[i], (keys)k, counts[c], &seed);
    CHECK(fmt_spill_count(spill).bytes_peak > 0);
    svo_pager_free(pager);
    CHECK_U64(fmt_spill_count(spill).bytes_now, 0);
    fmt_spill_close(spill);
}

TEST(dropped_and_without_memory)
{
    uint64_t seed = 3;
    svo_error err = {0};
    fmt_spill *spill;
    stride = 24;
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder()}, &spill, &err));
    uint8_t *r = records(KEYS_RANDOM, 3 * RUN, &seed);
    for (uint32_t paged = 0; paged < 2; paged++)
        for (uint64_t fail_at = 1;; fail_at++) { /* every allocation fails once, until none does */
            svo_limit_allocator limit;
            svo_pager *pager = NULL;
            svo_limit_allocator_init(&limit, UINT64_MAX, plain);
            limit.fail_at = fail_at;
            svo_result result = paged ? svo_pager_create(fmt_spill_files(spill), 1 << 20, 0, &limit.base, &pager, &err) : SVO_OK;
            if (result == SVO_OK) {
                const svoi_room room = {&limit.base, pager, 0};
                svoi_store out = {0};
                uint64_t sorted;
                result = sort(&room, r, 3 * RUN, 3 * RUN, &out, &sorted, &err);
                if (result == SVO_OK) svoi_store_free(&out);
            }
            svo_pager_free(pager);
            CHECK_U64(svo_limit_in_use(&limit), 0);
            if (result == SVO_OK) break;
            CHECK_RESULT(result, SVO_OUT_OF_MEMORY);
            CHECK(fail_at < 100);
        }
    for (uint64_t count = 0; count < 2 * RUN + 10; count += RUN + 3) { /* given up half way */
        svoi_sorter s;
        svo_pager *pager;
        const svoi_order order = {key_of, compare, NULL};
        CHECK_OK(svo_pager_create(fmt_spill_files(spill), 1 << 20, 0, plain, &pager, &err));
        const svoi_room room = {plain, pager, 0};
        CHECK_OK(svoi_sorter_begin(&s, &room, &order, stride, 3 * RUN, &err));
        for (uint64_t i = 0; i < count; i++) CHECK_OK(svoi_sorter_put(&s, r + i * stride, &err));
        svoi_sorter_drop(&s);
        svo_pager_free(pager);
    }
    CHECK_U64(fmt_spill_count(spill).bytes_now, 0);
    free(r);
    fmt_spill_close(spill);
}
