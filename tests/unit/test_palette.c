/* Palette blocks: every value comes back by random access, for all sizes around the limits of blocks and superblocks;
 * the bytes do not depend on threads; damaged blocks are refused; the partition is no worse than simple ones. */
#include <stdlib.h>
#include <string.h>

#include "svo_palette.h"
#include "test.h"

typedef struct stream { uint32_t *v; uint64_t count; } stream;

static void give(void *user, uint64_t first, uint32_t n, uint32_t *indices)
{
    memcpy(indices, ((const stream *)user)->v + first, n * sizeof *indices);
}

typedef struct encoded { svo_buffer directory, payload; svo_palette_stats stats; } encoded;

static void encode(const stream *s, uint64_t table, uint32_t threads, encoded *e)
{
    svo_error err = {0};
    svo_buffer_init(&e->directory, NULL);
    svo_buffer_init(&e->payload, NULL);
    e->stats = (svo_palette_stats){0};
    CHECK_OK(svo_palette_encode(s->count, table, give, (void *)(uintptr_t)s, threads, &e->directory, &e->payload, &e->stats, &err));
}

static void encoded_free(encoded *e)
{
    svo_buffer_free(&e->directory);
    svo_buffer_free(&e->payload);
}

/* Encodes with 1, 2 and 7 threads, checks, reads every value. Returns bytes of directory and payload. */
static uint64_t check_stream(const stream *s, uint64_t table)
{
    encoded e, f;
    svo_error err = {0};
    encode(s, table, 1, &e);
    if (test_failed()) return 0;
    for (uint32_t threads = 2; threads <= 7; threads += 5) {
        encode(s, table, threads, &f);
        if (test_failed()) return 0;
        bool same = e.directory.size == f.directory.size && e.payload.size == f.payload.size &&
                    (e.directory.size == 0 || memcmp(e.directory.data, f.directory.data, e.directory.size) == 0) &&
                    memcmp(e.payload.data, f.payload.data, e.payload.size) == 0 && memcmp(&e.stats, &f.stats, sizeof e.stats) == 0;
        if (!same) test_fail(__FILE__, __LINE__, "%u threads give other bytes", threads);
        encoded_free(&f);
    }
    const uint64_t *directory = (const uint64_t *)(const void *)e.directory.data;
    svo_palette_stats stats;
    svo_result r = svo_palette_check(s->count, table, directory, e.directory.size / 8, e.payload.data, e.payload.size, &stats, &err);
    if (r != SVO_OK || memcmp(&stats, &e.stats, sizeof stats) != 0) test_fail(__FILE__, __LINE__, "%s", err.message);
    uint32_t bits = svo_palette_table_bits(table);
    for (uint64_t i = 0; i < s->count; i++)
        if (svo_palette_index(directory, e.payload.data, bits, i) != s->v[i]) {
            test_fail(__FILE__, __LINE__, "value %llu of %llu, table %llu: %u != %u", (unsigned long long)i, (unsigned long long)s->count,
                      (unsigned long long)table, svo_palette_index(directory, e.payload.data, bits, i), s->v[i]);
            break;
        }
    uint64_t bytes = e.directory.size + e.payload.size;
    encoded_free(&e);
    return bytes;
}

enum { STYLES = 7 };

static void fill(stream *s, uint64_t table, int style, uint64_t *seed)
{
    uint32_t run = 0;
    for (uint64_t i = 0; i < s->count; i++) {
        switch (style) {
        case 0: s->v[i] = (uint32_t)(table - 1); break;                       /* one value */
        case 1: s->v[i] = (uint32_t)(i % 2 % table); break;                   /* two, alternating */
        case 2: s->v[i] = (uint32_t)(i % table); break;                       /* all different, as far as they go */
        case 3: s->v[i] = (uint32_t)(test_random(seed) % table); break;       /* noise */
        case 4:                                                               /* runs */
            if (test_random(seed) % 20 == 0) run = (uint32_t)(test_random(seed) % table);
            s->v[i] = run;
            break;
        case 5: s->v[i] = (uint32_t)((i / 50 + test_random(seed) % 3) % table); break; /* drifting */
        default: s->v[i] = (uint32_t)((i % 1024 < 500 ? 0 : test_random(seed)) % table); break; /* half quiet */
        }
    }
}

TEST(all_sizes_and_tables)
{
    static const uint64_t counts[] = {0, 1, 2, 15, 16, 17, 31, 32, 33, 1008, 1009, 1023, 1024, 1025, 1040, 2047, 2048, 2049, 5000, 70000};
    static const uint64_t tables[] = {1, 2, 3, 16, 17, 64, 65, 100, 1024, 4096, 1000003, 0xffffffff, 0x100000000};
    uint64_t seed = 1;
    for (size_t c = 0; c < sizeof counts / sizeof counts[0]; c++)
        for (size_t t = 0; t < sizeof tables / sizeof tables[0]; t++)
            for (int style = 0; style < STYLES; style++) {
                stream s = {malloc(counts[c] * 4 + 4), counts[c]};
                fill(&s, tables[t], style, &seed);
                uint64_t bytes = check_stream(&s, tables[t]);
                /* never more than raw indices, a map, a header and the rounding of each superblock, and the padding */
                uint64_t superblocks = (counts[c] + 1023) / 1024, raw = 0;
                for (uint64_t b = 0; b < superblocks; b++) {
                    uint64_t n = counts[c] - b * 1024 < 1024 ? (counts[c] - b * 1024 + 15) / 16 * 16 : 1024;
                    raw += 8 + 8 + 2 + (n * svo_palette_table_bits(tables[t]) + 7) / 8;
                }
                free(s.v);
                if (test_failed()) return;
                CHECK_MSG(bytes <= raw + 8, "%llu values, table %llu, style %d: %llu bytes, raw %llu", (unsigned long long)counts[c],
                          (unsigned long long)tables[t], style, (unsigned long long)bytes, (unsigned long long)raw);
                if (style == 0) CHECK_U64(bytes, 8 * superblocks + 8);
            }
}

/* Sizes that follow from the format by hand: 1024 values alternating between two, table of 4096 (12 bits):
 * directory 8, map 8, header 2, data (1024 + 24) / 8 = 131, padding 8. */
TEST(size_by_hand)
{
    stream s = {malloc(4096), 1024};
    for (uint64_t i = 0; i < 1024; i++) s.v[i] = i % 2 ? 4095 : 7;
    CHECK_U64(check_stream(&s, 4096), 8 + 8 + 2 + 131 + 8);
    /* half constant, half noise of 12 bits: map, two headers, 2 bytes of constant, 768 of noise */
    for (uint64_t i = 0; i < 1024; i++) s.v[i] = i < 512 ? 5 : (uint32_t)(i * 2654435761u >> 20 & 4095);
    CHECK_U64(check_stream(&s, 4096), 8 + 8 + 4 + 2 + 768 + 8);
    free(s.v);
}

/* Any change of a bit is refused or leaves all values in the table and readable (the sanitizers watch). */
TEST(damage_is_refused_or_harmless)
{
    uint64_t seed = 2;
    stream s = {malloc(4 * 3000), 3000};
    fill(&s, 100, 5, &seed);
    encoded e;
    encode(&s, 100, 1, &e);
    uint64_t refused = 0, tried = 0;
    for (uint64_t bit = 0; bit < 8 * (e.directory.size + e.payload.size); bit++, tried++) {
        svo_buffer *b = bit < 8 * e.directory.size ? &e.directory : &e.payload;
        uint64_t at = b == &e.directory ? bit : bit - 8 * e.directory.size;
        b->data[at / 8] ^= (uint8_t)(1u << at % 8);
        const uint64_t *directory = (const uint64_t *)(const void *)e.directory.data;
        svo_error err = {0};
        if (svo_palette_check(s.count, 100, directory, e.directory.size / 8, e.payload.data, e.payload.size, NULL, &err) == SVO_OK) {
            for (uint64_t i = 0; i < s.count; i++) CHECK(svo_palette_index(directory, e.payload.data, 7, i) < 100);
        } else {
            refused++;
        }
        b->data[at / 8] ^= (uint8_t)(1u << at % 8);
    }
    CHECK(refused > 8 * e.directory.size / 2 && refused < tried);
    /* wrong sizes */
    const uint64_t *directory = (const uint64_t *)(const void *)e.directory.data;
    svo_error err = {0};
    CHECK_RESULT(svo_palette_check(s.count, 100, directory, 2, e.payload.data, e.payload.size, NULL, &err), SVO_INVALID_DATA);
    for (uint64_t size = 0; size < e.payload.size; size++)
        CHECK_RESULT(svo_palette_check(s.count, 100, directory, 3, e.payload.data, size, NULL, &err), SVO_INVALID_DATA);
    CHECK_RESULT(svo_palette_check(s.count, 0, directory, 3, e.payload.data, e.payload.size, NULL, &err), SVO_INVALID_DATA);
    encoded_free(&e);
    free(s.v);
}
