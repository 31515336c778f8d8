/* Algorithm 1 of Dado et al. 2016 against the printed algorithm, done literally. */
#include <stdlib.h>
#include <string.h>

#include "svo_algorithm1.h"
#include "svo_palette.h"
#include "test.h"

typedef struct literal {
    const uint32_t *v;
    uint64_t table_bits, directory_bits;
    uint8_t *bits;  /* of the block of each value */
    uint8_t *first; /* 1 where a block begins */
} literal;

static uint64_t memory(const literal *l, uint64_t n, uint32_t w) { return n * w + (l->table_bits << w) + l->directory_bits; }

/* How far a block from i reaches before it would have more than 2^w values. */
static uint64_t reach(const literal *l, uint64_t i, uint64_t end, uint32_t w)
{
    uint32_t seen[256], n = 0;
    for (uint64_t k = i; k < end; k++) {
        uint32_t q = 0;
        while (q < n && seen[q] != l->v[k]) q++;
        if (q == n) {
            if (n == 1u << w) return k;
            seen[n++] = l->v[k];
        }
    }
    return end;
}

static void mark(literal *l, uint64_t i, uint64_t j, uint32_t w)
{
    l->first[i] = 1;
    for (; i < j; i++) l->bits[i] = (uint8_t)w;
}

static void large_blocks(literal *l, uint64_t i, uint64_t j)
{
    if (i >= j) return;
    for (uint32_t w = 0; w < 4; w++) {
        uint64_t from = i, most = 0;
        for (uint64_t k = i; k < j; k++) {
            uint64_t n = reach(l, k, j, w) - k;
            if (n > most) most = n, from = k;
        }
        if (memory(l, most, w) >= most * (w + 1)) continue;
        mark(l, from, from + most, w);
        large_blocks(l, i, from);
        large_blocks(l, from + most, j);
        return;
    }
    while (i < j) {
        double least = 0;
        uint64_t end = j;
        uint32_t bits = 0;
        for (uint32_t w = 0; w <= 8; w++) {
            uint64_t n = reach(l, i, j, w) - i;
            double each = (double)memory(l, n, w) / (double)n;
            if (w == 0 || each < least) least = each, bits = w, end = i + n;
        }
        mark(l, i, end, bits);
        i = end;
    }
}

static void compare(const uint32_t *v, uint64_t n, uint64_t table, uint32_t threads)
{
    svo_algorithm1_result r;
    svo_error err;
    literal l = {v, svo_palette_table_bits(table), 64, calloc(n + 1, 1), calloc(n + 1, 1)};
    large_blocks(&l, 0, n);
    CHECK_OK(svo_algorithm1(v, n, table, 64, threads, NULL, &r, &err));
    uint64_t blocks = 0, bits = r.palette_entries * l.table_bits;
    for (uint64_t i = 0; i < n; i++) {
        blocks += l.first[i];
        bits += l.bits[i] + (l.first[i] ? 64u : 0u);
    }
    CHECK_U64(r.block_count, blocks);
    CHECK_U64(r.bits, bits);
    for (uint64_t b = 0; b < r.block_count && !test_failed(); b++) {
        const svo_algorithm1_block *x = &r.blocks[b];
        const uint32_t *p = r.palettes + x->palette;
        CHECK(l.first[x->begin] && l.bits[x->begin] == x->bits && p[-1] <= 1u << x->bits);
        for (uint64_t i = x->begin; i < (b + 1 < r.block_count ? x[1].begin : n); i++) {
            uint32_t q = 0;
            while (q < p[-1] && p[q] != v[i]) q++;
            CHECK(q < p[-1]);
        }
    }
    svo_algorithm1_free(&r, NULL);
    free(l.bits);
    free(l.first);
}

TEST(as_printed)
{
    uint64_t seed = 5;
    uint32_t v[3000];
    for (int round = 0; round < 60; round++) {
        uint64_t n = round < 20 ? (uint64_t)round : test_random(&seed) % 3000, table = (uint64_t)1 << (1 + round % 13), value = 0;
        uint64_t change = 1 + test_random(&seed) % 60, reachable = 1 + test_random(&seed) % table;
        for (uint64_t i = 0; i < n; i++) {
            if (test_random(&seed) % change == 0) value = test_random(&seed) % (i % 700 < 300 ? reachable : reachable < 4 ? reachable : 4);
            v[i] = (uint32_t)value;
        }
        compare(v, n, table, 1 + (uint32_t)round % 3);
        if (test_failed()) return;
    }
}
