/* Blocks: every value comes back by random access, exactly or within the bound, for all sizes around the limits of blocks
 * and superblocks, of every kind; the bytes do not depend on threads; damaged blocks are refused. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "svo_color.h"
#include "svo_palette.h"
#include "svoi_palette.h"
#include "test.h"

typedef struct stream { uint32_t *v; uint64_t count; svo_channel_kind kind; } stream;

static void give(void *user, uint64_t first, uint32_t n, uint32_t *values) { memcpy(values, ((const stream *)user)->v + first, n * sizeof *values); }

typedef struct encoded {
    svo_buffer directory, payload;
    uint8_t *table;
    svo_palette p;
    svo_palette_stats stats;
} encoded;

static void encode(const stream *s, const uint32_t *table, uint64_t table_count, svo_palette_goal goal, uint32_t threads, encoded *e)
{
    svo_error err = {0};
    uint32_t stride = svo_channel_stride(s->kind);
    svo_buffer_init(&e->directory, NULL);
    svo_buffer_init(&e->payload, NULL);
    svo_palette_job job = {.kind = s->kind, .count = s->count, .source = give, .user = (void *)(uintptr_t)s, .table = table,
                           .table_count = table_count, .goal = goal, .threads = threads};
    CHECK_OK(svo_palette_encode(&job, &e->directory, &e->payload, &e->stats, &err));
    e->table = malloc(table_count * stride + 1);
    for (uint64_t i = 0; i < table_count; i++)
        for (uint32_t k = 0; k < stride; k++) e->table[i * stride + k] = (uint8_t)(table[i] >> 8 * k);
    e->p = (svo_palette){s->kind, s->count, e->table, table_count, e->directory.data, e->directory.size / SVO_PALETTE_ENTRY, e->payload.data, e->payload.size, NULL};
}

static void encoded_free(encoded *e)
{
    svo_buffer_free(&e->directory);
    svo_buffer_free(&e->payload);
    free(e->table);
}

static double degrees_between(uint32_t a, uint32_t b)
{
    uint8_t x[4], y[4];
    float n[3], m[3];
    memcpy(x, &a, 4);
    memcpy(y, &b, 4);
    svo_oct32_decode(x, n);
    svo_oct32_decode(y, m);
    double chord = 0;
    for (int i = 0; i < 3; i++) chord += ((double)n[i] - m[i]) * ((double)n[i] - m[i]);
    return 2 * asin(fmin(1, sqrt(chord) / 2)) * 57.29577951308232;
}

static double error_of(svo_channel_kind kind, uint32_t value, uint32_t other)
{
    if (value == other) return 0;
    if (kind == SVO_KIND_NORMAL_OCT32) return degrees_between(value, other);
    uint8_t a[3] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16)}, b[3] = {(uint8_t)other, (uint8_t)(other >> 8), (uint8_t)(other >> 16)};
    float x[3], y[3];
    svo_srgb8_to_lab(a, x);
    svo_srgb8_to_lab(b, y);
    return svo_delta_e94(x, y);
}

/* Without the entries that no block names: the same values, no more bytes, and every entry named. `e` is changed. */
static void check_unused(const stream *s, encoded *e)
{
    svoi_used used, again;
    svo_error err = {0};
    uint32_t stride = svo_channel_stride(s->kind);
    uint64_t before = e->payload.size, kept = 0;
    uint32_t *values = malloc((s->count + 1) * sizeof *values);
    for (uint64_t i = 0; i < s->count; i++) values[i] = svo_palette_value(&e->p, i);
    CHECK_OK(svoi_palette_drop_unused(s->kind, e->p.table_count, &e->directory, &e->payload, &used, NULL, &err));
    for (uint64_t i = 0; i < e->p.table_count; i++)
        if (used.bit[i / 64] >> i % 64 & 1) memmove(e->table + kept++ * stride, e->table + i * stride, stride);
    CHECK_U64(kept, used.count);
    e->p.table_count = kept;
    e->p.payload_size = e->payload.size;
    CHECK(e->payload.size <= before);
    if (svo_palette_check(&e->p, NULL, &err) != SVO_OK) test_fail(__FILE__, __LINE__, "without unused entries: %s", err.message);
    for (uint64_t i = 0; i < s->count && !test_failed(); i++) CHECK_U64(svo_palette_value(&e->p, i), values[i]);
    CHECK_OK(svoi_palette_drop_unused(s->kind, kept, &e->directory, &e->payload, &again, NULL, &err));
    CHECK_U64(again.count, kept);
    svoi_used_free(&used, NULL);
    svoi_used_free(&again, NULL);
    free(values);
}

/* Without superblocks that repeat what is before them: the same values, one by one, many and in ranges, and no more bytes. `e` is changed. */
static void check_repeats(const stream *s, encoded *e, uint64_t *records)
{
    svo_error err = {0};
    const uint64_t before = e->directory.size + e->payload.size;
    uint64_t words = 0, seed = s->count;
    uint32_t *values = malloc((s->count + 1) * sizeof *values), part[3000];
    for (uint64_t i = 0; i < s->count; i++) values[i] = svo_palette_value(&e->p, i);
    CHECK_OK(svoi_palette_skip_repeats(&e->p, &e->directory, &e->payload, &words, &err));
    if (words != 0) {
        e->p.repeats = e->directory.data;
        e->p.directory = e->directory.data + words * SVO_PALETTE_ENTRY;
        e->p.superblock_count = e->directory.size / SVO_PALETTE_ENTRY - words;
        e->p.payload = e->payload.data;
        e->p.payload_size = e->payload.size;
        CHECK(e->directory.size + e->payload.size < before);
    }
    if (svo_palette_check(&e->p, NULL, &err) != SVO_OK) test_fail(__FILE__, __LINE__, "without repeats: %s", err.message);
    for (uint64_t i = 0; i < s->count && !test_failed(); i++) CHECK_U64(svo_palette_value(&e->p, i), values[i]);
    for (int k = 0; k < 50 && s->count != 0 && !test_failed(); k++) {
        const uint64_t first = test_random(&seed) % s->count, left = s->count - first;
        const uint32_t n = (uint32_t)(1 + test_random(&seed) % (k % 2 != 0 ? 80 : 3000)), count = left < n ? (uint32_t)left : n;
        svo_palette_range(&e->p, first, count, part);
        CHECK(memcmp(part, values + first, count * sizeof *part) == 0);
    }
    free(values);
    *records = words;
}

/* Many values at a time are those one by one, in whatever order and number. */
static void check_many(const svo_palette *p, uint64_t count)
{
    enum { MANY = 300 };
    uint64_t index[MANY], seed = count;
    uint32_t values[MANY];
    for (uint32_t n = 1; n <= MANY && !test_failed(); n = 2 * n + 1) {
        for (uint32_t i = 0; i < n; i++) index[i] = (i % 3 == 0 ? test_random(&seed) : test_random(&seed) % 70 + count / 2) % count;
        svo_palette_values(p, index, n, values);
        for (uint32_t i = 0; i < n && !test_failed(); i++) CHECK_U64(values[i], svo_palette_value(p, index[i]));
    }
}

/* Encodes with 1, 2 and 7 threads, checks, reads every value. Returns bytes of directory and payload. */
static uint64_t check_stream(const stream *s, const uint32_t *table, uint64_t table_count, svo_palette_goal goal)
{
    encoded e, f;
    svo_error err = {0};
    encode(s, table, table_count, goal, 1, &e);
    if (test_failed()) return 0;
    for (uint32_t threads = 2; threads <= 7; threads += 5) {
        encode(s, table, table_count, goal, threads, &f);
        if (test_failed()) return 0;
        bool same = e.directory.size == f.directory.size && e.payload.size == f.payload.size &&
                    (e.directory.size == 0 || memcmp(e.directory.data, f.directory.data, e.directory.size) == 0) &&
                    memcmp(e.payload.data, f.payload.data, e.payload.size) == 0 && memcmp(&e.stats, &f.stats, sizeof e.stats) == 0;
        if (!same) test_fail(__FILE__, __LINE__, "%u threads give other bytes", threads);
        encoded_free(&f);
    }
    svo_palette_stats stats;
    svo_result r = svo_palette_check(&e.p, &stats, &err);
    if (r != SVO_OK || memcmp(stats.blocks, e.stats.blocks, sizeof stats.blocks) != 0) test_fail(__FILE__, __LINE__, "%s", err.message);
    if (s->count != 0 && !test_failed()) check_many(&e.p, s->count);
    double sum = 0, most = 0;
    for (uint64_t i = 0; i < s->count && !test_failed(); i++) {
        uint32_t got = svo_palette_value(&e.p, i);
        double error = goal.bound > 0 ? error_of(s->kind, s->v[i], got) : got != s->v[i];
        sum += error;
        most = fmax(most, error);
        if (error > goal.bound)
            test_fail(__FILE__, __LINE__, "value %llu of %llu, table %llu, kind %d: %x for %x, error %g", (unsigned long long)i,
                      (unsigned long long)s->count, (unsigned long long)table_count, (int)s->kind, got, s->v[i], error);
    }
    if (fabs(most - e.stats.error_max) > 1e-4 || fabs(sum - e.stats.error_sum) > 1e-4 * (double)(s->count + 1))
        test_fail(__FILE__, __LINE__, "errors are said to be %g, %g but are %g, %g", e.stats.error_sum, e.stats.error_max, sum, most);
    uint64_t bytes = e.directory.size + e.payload.size;
    check_unused(s, &e);
    uint64_t records;
    if (!test_failed()) check_repeats(s, &e, &records);
    if (s->count != 0 && !test_failed()) check_many(&e.p, s->count);
    encoded_free(&e);
    return bytes;
}

static uint32_t valid(svo_channel_kind kind, uint32_t v)
{
    static const uint32_t mask[] = {0, 0xffffff, 0xffffffff, 0xff, 0xffff, 0xffffffff};
    if (kind == SVO_KIND_NORMAL_OCT32) { /* no -32768 */
        if ((v & 0xffff) == 0x8000) v ^= 1;
        if (v >> 16 == 0x8000) v ^= 0x10000;
    }
    return v & mask[kind];
}

enum { STYLES = 8 };

/* `table` different values spread over what the kind has; which of them follow each other is the style. */
static void fill(stream *s, const uint32_t *table, uint64_t n, int style, uint64_t *seed)
{
    uint64_t run = 0;
    for (uint64_t i = 0; i < s->count; i++) {
        uint64_t k = 0;
        switch (style) {
        case 0: k = n - 1; break;                                                /* one value */
        case 1: k = i % 2 % n; break;                                            /* two, alternating */
        case 2: k = i % n; break;                                                /* all different, as far as they go */
        case 3: k = test_random(seed) % n; break;                                /* noise */
        case 4:                                                                  /* runs */
            if (test_random(seed) % 20 == 0) run = test_random(seed) % n;
            k = run;
            break;
        case 5: k = (i / 50 + test_random(seed) % 3) % n; break;                 /* drifting */
        case 6: k = (i % 1024 < 500 ? 0 : test_random(seed)) % n; break;         /* half quiet */
        default: k = (i / 90 * 7 + (test_random(seed) % 30 == 0 ? test_random(seed) % 5 : 0)) % n; break; /* runs with specks */
        }
        s->v[i] = table[k];
    }
}

static int compare_u32(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

static uint64_t make_table(svo_channel_kind kind, uint64_t n, bool near, uint64_t *seed, uint32_t *table)
{
    for (uint64_t i = 0; i < n; i++) {
        uint32_t v = near ? (uint32_t)(i % 7 | i / 7 % 5 << 8 | i / 35 << 16) + 0x302010 : (uint32_t)test_random(seed);
        table[i] = valid(kind, v);
    }
    qsort(table, n, sizeof *table, compare_u32);
    uint64_t kept = 0;
    for (uint64_t i = 0; i < n; i++)
        if (i == 0 || table[i] != table[kept - 1]) table[kept++] = table[i];
    return kept;
}

static const uint64_t counts[] = {0, 1, 2, 15, 16, 17, 31, 32, 33, 1008, 1009, 1023, 1024, 1025, 1040, 2047, 2048, 2049, 5000, 66000};
static const svo_channel_kind kinds[] = {SVO_KIND_COLOR_SRGB8, SVO_KIND_NORMAL_OCT32, SVO_KIND_UNORM8, SVO_KIND_ID16, SVO_KIND_ID32};

/* All kinds, counts, table sizes and styles; tables that hold all values or only a part of them. */
TEST(exact_at_all_sizes)
{
    static const uint64_t tables[] = {1, 2, 3, 16, 17, 64, 65, 100, 257, 1024, 4097, 40000};
    uint64_t seed = 1;
    uint32_t *table = malloc(4 * 40000);
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
        for (size_t t = 0; t < sizeof tables / sizeof *tables; t++)
            for (int style = 0; style < STYLES; style++) {
                if (counts[c] > 60000 && (t + (size_t)style) % 5 != 0) continue;
                svo_channel_kind kind = kinds[(t + c + (size_t)style) % 5];
                stream s = {malloc(counts[c] * 4 + 4), counts[c], kind};
                uint64_t n = make_table(kind, tables[t], (c + t) % 2 == 0, &seed, table);
                fill(&s, table, n, style, &seed);
                uint64_t bytes = check_stream(&s, table, n, (svo_palette_goal){0}), superblocks = (counts[c] + 1023) / 1024;
                if (style == 0 && n <= 4096) CHECK_U64(bytes, 14 * superblocks + (superblocks != 0 ? 8 : 0) + 8);
                check_stream(&s, table, (n + 1) / 2, (svo_palette_goal){0}); /* the rest is not in the table */
                /* never more than raw values, a lattice, a map and headers */
                CHECK(bytes <= superblocks * (12 + 2 + 13 + 1024 * svo_channel_stride(kind)) + 16);
                free(s.v);
                if (test_failed()) break;
            }
    free(table);
}

/* Smooth and noisy colours and normals: the bound holds for every value, and more error never costs more bytes by much. */
TEST(bounds_hold)
{
    static const double bounds[] = {0.01, 0.3, 1, 3, 10, 60};
    uint64_t seed = 3;
    for (int kind = 0; kind < 2; kind++)
        for (int style = 0; style < 5; style++) {
            stream s = {malloc(4 * 1100), style == 4 ? 1025 : 1100, kinds[kind]};
            for (uint64_t i = 0; i < s.count; i++) {
                double x = (double)i / 40, noise = (double)(test_random(&seed) % 1000) / 1000;
                uint32_t v;
                if (kind == 0) {
                    double base[3] = {120 + 60 * sin(x / 9), 100 + 50 * sin(x / 7 + 1), 90 + 40 * sin(x / 5 + 2)}, amount = style == 0 ? 0 : style == 1 ? 12 : 60;
                    v = 0;
                    for (int k = 0; k < 3; k++) v |= (uint32_t)(base[k] + amount * (noise - 0.5)) << 8 * k;
                } else {
                    double a = x / 10 + (style == 0 ? 0 : 0.1 * noise), b = sin(x / 13) + (style < 2 ? 0 : noise);
                    float n[3] = {(float)(cos(a) * cos(b)), (float)(sin(a) * cos(b)), (float)sin(b)};
                    uint8_t bytes[4];
                    svo_oct32_encode(n, bytes);
                    memcpy(&v, bytes, 4);
                }
                s.v[i] = style == 3 ? valid(s.kind, (uint32_t)test_random(&seed)) : v;
            }
            uint32_t table[700];
            for (size_t t = 0; t < 700; t++) table[t] = s.v[t * (s.count / 700)];
            qsort(table, 700, sizeof *table, compare_u32);
            uint64_t n = 0, last = UINT64_MAX;
            for (size_t t = 0; t < 700; t++)
                if (t == 0 || table[t] != table[n - 1]) table[n++] = table[t];
            for (size_t b = 0; b < sizeof bounds / sizeof *bounds && !test_failed(); b++)
                for (int price = 0; price < 3; price++) {
                    svo_palette_goal goal = {bounds[b], price == 0 ? 0 : price == 1 ? 3 : 0.02, price == 2 && kind == 0};
                    uint64_t bytes = check_stream(&s, table, n, goal);
                    if (price == 0 && last != UINT64_MAX) CHECK_MSG((double)bytes <= 1.05 * (double)last, "kind %d style %d bound %g: %llu bytes, %llu with a smaller bound", kind, style, bounds[b], (unsigned long long)bytes, (unsigned long long)last);
                    if (price == 0) last = bytes;
                }
            free(s.v);
        }
}

/* Sizes that follow from the format by hand: 1024 values alternating between two, table of 4096 (12 bits): entry 12,
 * header 2, data (1024 + 24) / 8 = 131, base 8, padding 8. */
TEST(size_by_hand)
{
    uint32_t table[4096];
    for (uint32_t i = 0; i < 4096; i++) table[i] = i * 2654435761u >> 8;
    stream s = {malloc(4096), 1024, SVO_KIND_COLOR_SRGB8};
    for (uint64_t i = 0; i < 1024; i++) s.v[i] = table[i % 2 ? 4095 : 7];
    CHECK_U64(check_stream(&s, table, 4096, (svo_palette_goal){0}), 12 + 2 + 131 + 16);
    /* half one value, half noise of 12 bits: two headers, 768 bytes of noise */
    for (uint64_t i = 0; i < 1024; i++) s.v[i] = table[i < 512 ? 5 : i * 2654435761u >> 9 & 4095];
    CHECK_U64(check_stream(&s, table, 4096, (svo_palette_goal){0}), 12 + 4 + 768 + 16);
    free(s.v);
}

/* Any change of a bit is refused or leaves all values readable (the sanitizers watch). */
static void damage(svo_channel_kind kind, svo_palette_goal goal, uint64_t seed)
{
    uint32_t table[100];
    uint64_t n = make_table(kind, 100, true, &seed, table);
    stream s = {malloc(4 * 1500), 1500, kind};
    for (int part = 0; part < 3; part++) {
        stream third = {s.v + 500 * part, 500, kind};
        fill(&third, table, n, part == 0 ? 5 : part == 1 ? 7 : 3, &seed);
    }
    encoded e;
    encode(&s, table, n * 3 / 4, goal, 1, &e);
    uint64_t refused = 0, tried = 0, sum = 0;
    for (uint64_t bit = 0; bit < 8 * (e.directory.size + e.payload.size); bit++, tried++) {
        svo_buffer *b = bit < 8 * e.directory.size ? &e.directory : &e.payload;
        uint64_t at = b == &e.directory ? bit : bit - 8 * e.directory.size;
        b->data[at / 8] ^= (uint8_t)(1u << at % 8);
        svo_error err = {0};
        if (svo_palette_check(&e.p, NULL, &err) == SVO_OK) {
            for (uint64_t i = 0; i < s.count; i++) {
                uint32_t v = svo_palette_value(&e.p, i);
                sum += v;
                if (kind == SVO_KIND_NORMAL_OCT32 && ((v & 0xffff) == 0x8000 || v >> 16 == 0x8000)) test_fail(__FILE__, __LINE__, "-32768");
            }
        } else {
            refused++;
        }
        b->data[at / 8] ^= (uint8_t)(1u << at % 8);
    }
    CHECK(refused > 8 * e.directory.size / 2 && refused < tried && sum != 0);
    svo_palette p = e.p;
    svo_error err = {0};
    p.superblock_count = 1;
    CHECK_RESULT(svo_palette_check(&p, NULL, &err), SVO_INVALID_DATA);
    p = e.p;
    for (uint64_t size = 0; size < e.payload.size; size++) {
        /* a copy of its own, so that reading behind it is seen */
        uint8_t *copy = malloc(size + 1);
        memcpy(copy, e.payload.data, size);
        p.payload = copy, p.payload_size = size;
        CHECK_RESULT(svo_palette_check(&p, NULL, &err), SVO_INVALID_DATA);
        free(copy);
    }
    p = e.p;
    p.table_count = 0;
    CHECK_RESULT(svo_palette_check(&p, NULL, &err), SVO_INVALID_DATA);
    encoded_free(&e);
    free(s.v);
}
TEST(damaged_colors) { damage(SVO_KIND_COLOR_SRGB8, (svo_palette_goal){0}, 2); }
TEST(damaged_bounded_colors) { damage(SVO_KIND_COLOR_SRGB8, (svo_palette_goal){2, 0.1, false}, 3); }
TEST(damaged_normals) { damage(SVO_KIND_NORMAL_OCT32, (svo_palette_goal){1, 0.1, false}, 4); }
TEST(damaged_bytes) { damage(SVO_KIND_UNORM8, (svo_palette_goal){0}, 5); }
TEST(damaged_labels) { damage(SVO_KIND_ID16, (svo_palette_goal){0}, 6); }
TEST(damaged_wide_labels) { damage(SVO_KIND_ID32, (svo_palette_goal){0}, 7); }

/* Every colour that there is, each once, in an order that keeps neighbours near (as surfaces do) and in one that does not. */
static void give_all(void *user, uint64_t first, uint32_t n, uint32_t *values)
{
    uint32_t factor = *(const uint32_t *)user;
    for (uint32_t i = 0; i < n; i++) values[i] = ((uint32_t)first + i) * factor & 0xffffff;
}

TEST(every_color_once)
{
    static const uint32_t factors[] = {1, 0x9e3779b1u};
    uint32_t table[1] = {0};
    for (int f = 0; f < 2; f++) {
        svo_error err = {0};
        svo_buffer directory, payload;
        svo_buffer_init(&directory, NULL);
        svo_buffer_init(&payload, NULL);
        svo_palette_job job = {.kind = SVO_KIND_COLOR_SRGB8, .count = 1 << 24, .source = give_all, .user = (void *)(uintptr_t)&factors[f],
                               .table = table, .table_count = 1, .threads = 2};
        CHECK_OK(svo_palette_encode(&job, &directory, &payload, NULL, &err));
        uint8_t bytes[3] = {0, 0, 0};
        svo_palette p = {SVO_KIND_COLOR_SRGB8, 1 << 24, bytes, 1, directory.data, directory.size / SVO_PALETTE_ENTRY, payload.data, payload.size, NULL};
        CHECK_OK(svo_palette_check(&p, NULL, &err));
        for (uint64_t i = 0; i < 1 << 24; i += 97) {
            uint32_t want;
            give_all((void *)(uintptr_t)&factors[f], i, 1, &want);
            CHECK_U64(svo_palette_value(&p, i), want);
        }
        /* 3 bytes a value are never much exceeded, and not reached where neighbours are near */
        CHECK(directory.size + payload.size < (f == 0 ? 3u << 24 : 28u << 21));
        svo_buffer_free(&directory);
        svo_buffer_free(&payload);
    }
}

/* YCoCg-R comes back for every colour of a coarse grid and every colour beside its planes. */
/* Long stretches of one value, some beginning inside a superblock; then their records damaged. */
TEST(repeats_are_left_out)
{
    enum { COUNT = 300001 };
    const uint32_t table[] = {7, 100, 200};
    uint64_t seed = 8;
    svo_error err = {0};
    encoded e;
    stream s = {malloc(COUNT * sizeof *s.v), COUNT, SVO_KIND_UNORM8};
    for (uint64_t i = 0, run = 0; i < COUNT; i++, run--) {
        if (run == 0) run = 1 + (i % 3 == 0 ? test_random(&seed) % 40 : test_random(&seed) % 20000), s.v[i] = table[test_random(&seed) % 3];
        else s.v[i] = s.v[i - 1];
    }
    encode(&s, table, 3, (svo_palette_goal){0}, 1, &e);
    uint64_t words = 0;
    check_repeats(&s, &e, &words);
    CHECK_U64(words, (COUNT / SVO_SUPERBLOCK + 64) / 64);
    CHECK(e.p.superblock_count < COUNT / SVO_SUPERBLOCK / 2);
    for (uint64_t bit = 0; bit < 8 * words * SVO_PALETTE_ENTRY && !test_failed(); bit++) {
        e.directory.data[bit / 8] ^= (uint8_t)(1u << bit % 8);
        CHECK(svo_palette_check(&e.p, NULL, &err) == SVO_INVALID_DATA);
        e.directory.data[bit / 8] ^= (uint8_t)(1u << bit % 8);
    }
    CHECK_OK(svo_palette_check(&e.p, NULL, &err));
    encoded_free(&e);
    free(s.v);
}

TEST(lattices_of_one_point_are_exact)
{
    static const uint32_t at[] = {0, 1, 2, 63, 64, 100, 127, 128, 129, 200, 254, 255};
    for (uint32_t i = 0; i < 12 * 12 * 12; i++) {
        uint32_t v = at[i % 12] | at[i / 12 % 12] << 8 | at[i / 144] << 16;
        svo_lattice l = {.n = {1, 1, 1}, .step = {1, 1, 1}};
        svo_lattice_split(SVO_KIND_COLOR_SRGB8, v, l.low);
        CHECK_U64(svo_lattice_point(SVO_KIND_COLOR_SRGB8, &l, 0), v);
    }
}
