/* Algorithm 1 of Dado et al. 2016 against the printed algorithm, done literally. */
#include <stdio.h>
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

/* Blocks that just save something, or just do not, at every place between noise; blocks that touch, and such with a stranger inside. */
TEST(shortest_blocks_at_every_place)
{
    uint32_t v[700];
    uint64_t seed = 9;
    for (uint32_t w = 0; w < 4 && !test_failed(); w++)
        for (uint32_t more = 0; more < 3; more++) {
            uint32_t length = (12u << w) + 64 + more; /* a table of 4096, 64 bits an entry of the directory */
            for (uint32_t at = 0; at + length <= 420 && !test_failed(); at += w == 0 ? 1 : 7) {
                for (uint32_t i = 0; i < 700; i++) v[i] = (uint32_t)test_random(&seed) & 4095;
                for (uint32_t i = 0; i < length; i++) v[at + i] = 100 + i % (1u << w);
                for (uint32_t i = 0; i < 90; i++) v[at + length + i] = 7 + (i == at % 90 ? 1000 : 0);
                compare(v, 700, 4096, 1 + at % 3);
            }
        }
}

/* One value, two in turn, and every value another. */
TEST(one_value_two_in_turn_and_all_different)
{
    uint32_t v[3000];
    for (uint32_t kind = 0; kind < 3; kind++)
        for (uint32_t n = 1; n < 3000; n = n < 200 ? n + 1 : n + 397) {
            for (uint32_t i = 0; i < n; i++) v[i] = kind == 0 ? 3 : kind == 1 ? i & 1 : i;
            compare(v, n, 4096, 2);
            if (test_failed()) return;
        }
}

/* --- blocks in a file -------------------------------------------------------------------------------------------- */

typedef struct stream { uint32_t *v; uint64_t count; } stream;

static void give(void *user, uint64_t first, uint32_t n, uint32_t *values) { memcpy(values, ((const stream *)user)->v + first, n * sizeof *values); }

typedef struct coded { svo_buffer directory, payload; svo_palette p; } coded;

static void encode(const stream *s, svo_channel_kind kind, const uint32_t *table, uint64_t table_count, const uint8_t *bytes, uint32_t threads, coded *c)
{
    svo_error err = {0};
    svo_buffer_init(&c->directory, NULL);
    svo_buffer_init(&c->payload, NULL);
    svo_palette_job job = {.kind = kind, .count = s->count, .source = give, .user = (void *)(uintptr_t)s, .table = table, .table_count = table_count, .threads = threads};
    CHECK_OK(svo_algorithm1_encode(&job, &c->directory, &c->payload, &err));
    c->p = (svo_palette){kind, s->count, bytes, table_count, c->directory.data, c->directory.size / SVO_ALGORITHM1_ENTRY, c->payload.data, c->payload.size, NULL};
}

static void coded_free(coded *c)
{
    svo_buffer_free(&c->directory);
    svo_buffer_free(&c->payload);
}

/* Runs of few values in some places, noise in others. */
static void fill(stream *s, const uint32_t *table, uint64_t table_count, uint64_t *seed)
{
    uint32_t value = table[0];
    for (uint64_t i = 0; i < s->count; i++) {
        uint64_t local = i / 5000 % 3 == 0 ? table_count : table_count < 7 ? table_count : 7;
        if (test_random(seed) % (1 + i / 3000 % 9) == 0) value = table[(i / 20000 + test_random(seed) % local) % table_count];
        s->v[i] = value;
    }
}

TEST(every_value_comes_back_around_groups)
{
    static const uint64_t counts[] = {1, 2, 1023, 1025, 70000, SVO_ALGORITHM1_GROUP - 1, SVO_ALGORITHM1_GROUP, SVO_ALGORITHM1_GROUP + 1, 2 * SVO_ALGORITHM1_GROUP + 4321};
    static const uint64_t tables[] = {1, 2, 3, 255, 257, 70000};
    static const svo_channel_kind kinds[] = {SVO_KIND_COLOR_SRGB8, SVO_KIND_ID32, SVO_KIND_ID16, SVO_KIND_NORMAL_OCT32, SVO_KIND_UNORM8};
    uint64_t seed = 11;
    stream s = {.v = malloc(sizeof *s.v * counts[8])};
    uint32_t *table = malloc(sizeof *table * 70000);
    uint8_t *bytes = malloc(4 * 70000);
    for (size_t k = 0; k < sizeof counts / sizeof *counts * 2 && !test_failed(); k++) {
        svo_channel_kind kind = kinds[k % 5];
        uint64_t n = tables[(k * 5 + k / 6) % 6];
        uint32_t stride = svo_channel_stride(kind);
        if (stride == 1 && n > 256) n = 256;
        if (stride == 2 && n > 65536) n = 65536;
        for (uint64_t i = 0; i < n; i++) {
            table[i] = (uint32_t)(i * 2654435761u) & 0xffffff; /* different ones: odd factors */
            if (stride <= 2) table[i] = (uint32_t)i;
            if (kind == SVO_KIND_NORMAL_OCT32) table[i] = (uint32_t)i;
            memcpy(bytes + i * stride, &table[i], stride);
        }
        s.count = counts[k % 9];
        fill(&s, table, n, &seed);
        coded c, d;
        svo_error err = {0};
        encode(&s, kind, table, n, bytes, 1, &c);
        encode(&s, kind, table, n, bytes, 3, &d);
        CHECK(c.directory.size == d.directory.size && memcmp(c.directory.data, d.directory.data, c.directory.size) == 0);
        CHECK(c.payload.size == d.payload.size && memcmp(c.payload.data, d.payload.data, c.payload.size) == 0);
        svo_palette_stats stats;
        if (svo_algorithm1_check(&c.p, &stats, &err) != SVO_OK) test_fail(__FILE__, __LINE__, "%s", err.message);
        for (uint64_t i = 0; i < s.count && !test_failed(); i++) CHECK_U64(svo_algorithm1_value(&c.p, i), s.v[i]);
        coded_free(&c);
        coded_free(&d);
    }
    free(s.v), free(table), free(bytes);
}

typedef struct said { char all[4000]; size_t used; uint32_t count; } said;
static bool note(void *user, const svo_error *e)
{
    said *t = user;
    int n = snprintf(t->all + t->used, sizeof t->all - t->used, "%s\n", e->message);
    if (n > 0 && (size_t)n < sizeof t->all - t->used) t->used += (size_t)n;
    t->count++;
    return true;
}

/* Groups, numbers, indices and the end are wrong at once: each is named. */
TEST(all_violations_of_long_blocks)
{
    enum { COUNT = 2 * SVO_ALGORITHM1_GROUP + 3000, TABLE = 300 };
    uint64_t seed = 5;
    uint32_t table[TABLE];
    uint8_t bytes[TABLE * 2];
    stream s = {.v = malloc(sizeof *s.v * COUNT), .count = COUNT};
    for (uint32_t i = 0; i < TABLE; i++) {
        table[i] = i;
        memcpy(bytes + 2 * (size_t)i, &i, 2);
    }
    fill(&s, table, TABLE, &seed);
    coded c;
    svo_error err = {0};
    encode(&s, SVO_KIND_ID16, table, TABLE, bytes, 1, &c);
    said t = {.used = 0};
    svo_rules rules = {note, &t, 0};
    CHECK_OK(svo_algorithm1_check_all(&c.p, NULL, &rules, &err));
    CHECK_U64(t.count, 0);
    uint64_t second, third;
    memcpy(&second, c.payload.data + 24, 8);
    memcpy(&third, c.payload.data + 48, 8);
    c.directory.data[2] ^= 0x40;               /* group 0: place of the first block's numbers */
    c.directory.data[8 * third + 7] ^= 0x80;   /* group 2: reserved bits */
    c.payload.data[c.payload.size - 1] = 1;    /* padding */
    uint64_t palettes;
    memcpy(&palettes, c.payload.data + 24 + 16, 8);
    c.payload.data[palettes] = c.payload.data[palettes + 1] = 0xff; /* group 1: 9 bits of an index, 511 */
    CHECK_OK(svo_algorithm1_check_all(&c.p, NULL, &rules, &err));
    CHECK_MSG(strstr(t.all, "group 0 of long blocks: a block's numbers are not behind") != NULL && strstr(t.all, "group 1 of long blocks: an index is outside") != NULL &&
                  strstr(t.all, "group 2 of long blocks: its blocks are not in order") != NULL && strstr(t.all, "padding is not 0") != NULL, "%s", t.all);
    CHECK(second < third && rules.count == t.count);
    coded_free(&c);
    free(s.v);
}

/* Whatever a bit does, the blocks are refused or every value can be read. */
TEST(damaged_long_blocks)
{
    enum { COUNT = 6000, TABLE = 300 };
    uint64_t seed = 3;
    uint32_t table[TABLE], refused = 0;
    uint8_t bytes[TABLE * 2];
    stream s = {.v = malloc(sizeof *s.v * COUNT), .count = COUNT};
    for (uint32_t i = 0; i < TABLE; i++) {
        table[i] = i;
        memcpy(bytes + 2 * (size_t)i, &i, 2);
    }
    fill(&s, table, TABLE, &seed);
    coded c;
    svo_error err = {0};
    encode(&s, SVO_KIND_ID16, table, TABLE, bytes, 1, &c);
    uint64_t sum = 0;
    for (int round = 0; round < 3000; round++) {
        svo_buffer *b = round % 2 == 0 ? &c.directory : &c.payload;
        uint64_t at = test_random(&seed) % (round % 4 == 1 ? 24 * 8 : 8 * b->size);
        b->data[at / 8] ^= (uint8_t)(1u << at % 8);
        if (svo_algorithm1_check(&c.p, NULL, &err) != SVO_OK) refused++;
        else
            for (uint64_t i = 0; i < COUNT; i++) sum += svo_algorithm1_value(&c.p, i);
        b->data[at / 8] ^= (uint8_t)(1u << at % 8);
    }
    CHECK(refused > 1000 && sum != 0);
    for (uint64_t cut = 0; cut < c.p.payload_size; cut++) {
        svo_palette p = c.p;
        p.payload_size = cut;
        CHECK(svo_algorithm1_check(&p, NULL, &err) != SVO_OK);
    }
    for (uint64_t cut = 0; cut < c.p.superblock_count; cut++) {
        svo_palette p = c.p;
        p.superblock_count = cut;
        CHECK(svo_algorithm1_check(&p, NULL, &err) != SVO_OK);
    }
    CHECK_OK(svo_algorithm1_check(&c.p, NULL, &err));
    coded_free(&c);
    free(s.v);
}
