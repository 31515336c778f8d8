/* Blocks in extreme cases: one colour, two that alternate, counts around the limits of blocks and of 32 bits, and threads that
 * share superblocks of many kinds (small enough to run under a thread sanitizer). All 2^24 colours are in test_palette.c. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_palette.h"
#include "test.h"

typedef uint32_t (*value_at)(uint64_t i);

static void give(void *user, uint64_t first, uint32_t n, uint32_t *values)
{
    value_at at = *(const value_at *)user;
    for (uint32_t i = 0; i < n; i++) values[i] = at(first + i);
}

typedef struct coded {
    svo_buffer directory, payload;
    uint8_t table[3 * 512];
    svo_palette p;
} coded;

static void code(value_at at, svo_channel_kind kind, uint64_t count, const uint32_t *table, uint64_t table_count, svo_palette_goal goal, uint32_t threads, coded *c)
{
    svo_error err = {0};
    uint32_t stride = svo_channel_stride(kind);
    svo_buffer_init(&c->directory, NULL);
    svo_buffer_init(&c->payload, NULL);
    svo_palette_job job = {.kind = kind, .count = count, .source = give, .user = &at, .table = table, .table_count = table_count, .goal = goal, .threads = threads};
    CHECK_OK(svo_palette_encode(&job, &c->directory, &c->payload, NULL, &err));
    for (uint64_t i = 0; i < table_count; i++) memcpy(c->table + stride * i, &table[i], stride);
    c->p = (svo_palette){kind, count, c->table, table_count, c->directory.data, c->directory.size / SVO_PALETTE_ENTRY, c->payload.data, c->payload.size, NULL};
    CHECK_OK(svo_palette_check(&c->p, NULL, &err));
}

static void coded_free(coded *c)
{
    svo_buffer_free(&c->directory);
    svo_buffer_free(&c->payload);
}

static uint32_t always(uint64_t i) { return (void)i, 0x336699; }
static uint32_t alternating(uint64_t i) { return i % 2 == 0 ? 0x336699 : 0xfedcba; }
static uint32_t hundreds(uint64_t i) { return 0x101010u + (uint32_t)(i / 3 % 300); }

static const svo_palette_goal goals[] = {{0}, {1, 0.1, false}};

/* A superblock of one value takes its entry in the directory and one header. */
TEST(one_color)
{
    static const uint32_t table[] = {0x336699};
    for (int g = 0; g < 2; g++)
        for (uint64_t count = 1; count < 20000; count = count * 7 + 3) {
            coded c;
            code(always, SVO_KIND_COLOR_SRGB8, count, table, 1, goals[g], 2, &c);
            uint64_t superblocks = (count + SVO_SUPERBLOCK - 1) / SVO_SUPERBLOCK;
            CHECK_U64(c.directory.size, SVO_PALETTE_ENTRY * superblocks);
            CHECK_U64(c.payload.size, 8 + 2 * superblocks + SVO_PALETTE_PADDING);
            CHECK_U64(svo_palette_value(&c.p, 0), 0x336699);
            CHECK_U64(svo_palette_value(&c.p, count - 1), 0x336699);
            coded_free(&c);
        }
}

/* With two entries in the table an index is one bit a value, and there is a header for each superblock. */
TEST(two_alternating_colors)
{
    static const uint32_t table[] = {0x336699, 0xfedcba};
    for (int g = 0; g < 2; g++) {
        coded c;
        uint64_t superblocks = 200;
        code(alternating, SVO_KIND_COLOR_SRGB8, superblocks * SVO_SUPERBLOCK, table, 2, goals[g], 2, &c);
        CHECK_U64(c.payload.size, 8 + superblocks * (2 + SVO_SUPERBLOCK / 8) + SVO_PALETTE_PADDING);
        for (uint64_t i = 0; i < c.p.count; i++) CHECK_U64(svo_palette_value(&c.p, i), alternating(i));
        coded_free(&c);
    }
}

TEST(counts_around_the_limits_of_blocks)
{
    uint32_t table[300];
    for (uint32_t i = 0; i < 300; i++) table[i] = 0x101010u + i;
    static const uint64_t limits[] = {SVO_GRANULE, 2 * SVO_GRANULE, SVO_SUPERBLOCK / 2, SVO_SUPERBLOCK, 2 * SVO_SUPERBLOCK, 64 * SVO_SUPERBLOCK};
    for (uint32_t k = 0; k < 6; k++)
        for (uint64_t count = limits[k] - 1; count <= limits[k] + 1; count++) {
            coded c;
            code(hundreds, SVO_KIND_COLOR_SRGB8, count, table, 300, goals[0], 2, &c);
            for (uint64_t i = 0; i < count; i++) CHECK_U64(svo_palette_value(&c.p, i), hundreds(i));
            coded_free(&c);
        }
}

/* More than 2^32 values, laid out by hand: superblocks of one value each, over several bases. */
TEST(more_than_2_to_the_32_values)
{
    enum { TABLE = 251 };
    uint64_t count = ((uint64_t)1 << 32) + 5000, superblocks = (count + SVO_SUPERBLOCK - 1) / SVO_SUPERBLOCK;
    uint64_t groups = (superblocks + SVO_PALETTE_GROUP - 1) / SVO_PALETTE_GROUP, size = 8 * groups + 2 * superblocks + SVO_PALETTE_PADDING;
    uint8_t *directory = calloc(superblocks, SVO_PALETTE_ENTRY), *payload = calloc(size, 1), table[TABLE];
    CHECK(directory != NULL && payload != NULL);
    for (uint32_t i = 0; i < TABLE; i++) table[i] = (uint8_t)(i + 3);
    for (uint64_t s = 0; s < superblocks; s++) {
        uint64_t base = 8 * groups + 2 * (s - s % SVO_PALETTE_GROUP), map = 1;
        uint32_t offset = (uint32_t)(2 * (s % SVO_PALETTE_GROUP));
        uint16_t header = (uint16_t)(s % TABLE << 5 | SVO_BLOCK_ONE);
        if (s % SVO_PALETTE_GROUP == 0) memcpy(payload + s / SVO_PALETTE_GROUP * 8, &base, 8);
        memcpy(directory + SVO_PALETTE_ENTRY * s, &map, 8);
        memcpy(directory + SVO_PALETTE_ENTRY * s + 8, &offset, 4);
        memcpy(payload + base + offset, &header, 2);
    }
    svo_error err = {0};
    svo_palette p = {SVO_KIND_UNORM8, count, table, TABLE, directory, superblocks, payload, size, NULL};
    CHECK_OK(svo_palette_check(&p, NULL, &err));
    for (uint64_t near = (uint64_t)1 << 20; near <= (uint64_t)1 << 32; near *= 2)
        for (uint64_t i = near - 1025; i <= near + 1025; i += 25) CHECK_U64(svo_palette_value(&p, i), i / SVO_SUPERBLOCK % TABLE + 3);
    CHECK_U64(svo_palette_value(&p, count - 1), (superblocks - 1) % TABLE + 3);
    p.count += SVO_SUPERBLOCK; /* one superblock short */
    CHECK_RESULT(svo_palette_check(&p, NULL, &err), SVO_INVALID_DATA);
    free(directory), free(payload);
}

/* Directions that are none become one that can be read, with and without a bound. */
TEST(nan_in_normals)
{
    static const float odd[][3] = {{NAN, NAN, NAN}, {NAN, 0, 1}, {INFINITY, 0, 0}, {-INFINITY, INFINITY, 1}, {0, 0, 0}, {1e-45f, 0, 0}, {3e38f, -3e38f, 3e38f}, {-0.0f, -0.0f, -0.0f}};
    for (int i = 0; i < 8; i++) {
        uint8_t bytes[4];
        float n[3];
        svo_oct32_encode(odd[i], bytes);
        svo_oct32_decode(bytes, n);
        int16_t u, v;
        memcpy(&u, bytes, 2);
        memcpy(&v, bytes + 2, 2);
        CHECK(u != INT16_MIN && v != INT16_MIN);
        CHECK(fabsf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] - 1) < 1e-5f);
    }
}

static uint32_t noise(uint64_t i)
{
    uint64_t x = (i + 1) * 0x9e3779b97f4a7c15u;
    x ^= x >> 29;
    uint32_t far = (uint32_t)(i / 300 * 2654435761u), v = (far & 0x3f3f3f3f) + ((uint32_t)x & 0x07070707); /* near ones, then others */
    return i / 2000 % 3 == 0 ? far & 0x3f3f3f3f : v;
}
static uint32_t noise_of_color(uint64_t i) { return noise(i) & 0xffffff; }

/* Several batches on four threads: the bytes are those of one. */
TEST(threads_give_the_same_bytes)
{
    static const svo_palette_goal bounds[] = {{0}, {2, 0.1, false}, {6, 0.05, true}};
    uint32_t table[256];
    for (uint32_t i = 0; i < 256; i++) table[i] = noise(i * 317);
    for (int g = 0; g < 5; g++) {
        bool color = g < 3;
        coded one, many;
        uint64_t count = 2 * 64 * SVO_SUPERBLOCK + 777; /* three batches */
        uint32_t own[256];
        for (uint32_t i = 0; i < 256; i++) own[i] = color ? table[i] & 0xffffff : table[i];
        svo_palette_goal goal = bounds[g % 3];
        svo_error err = {0};
        value_at at = color ? noise_of_color : noise;
        svo_channel_kind kind = color ? SVO_KIND_COLOR_SRGB8 : SVO_KIND_NORMAL_OCT32;
        coded *c[] = {&one, &many};
        uint64_t entries = goal.bound > 0 ? 256 : 1; /* without a bound lattices hold what the table does not */
        for (int k = 0; k < 2; k++) {
            svo_buffer_init(&c[k]->directory, NULL);
            svo_buffer_init(&c[k]->payload, NULL);
            svo_palette_job job = {.kind = kind, .count = count, .source = give, .user = &at, .table = own, .table_count = entries, .goal = goal, .threads = k == 0 ? 1 : 4};
            CHECK_OK(svo_palette_encode(&job, &c[k]->directory, &c[k]->payload, NULL, &err));
        }
        CHECK_U64(one.payload.size, many.payload.size);
        CHECK(memcmp(one.payload.data, many.payload.data, one.payload.size) == 0 && memcmp(one.directory.data, many.directory.data, one.directory.size) == 0);
        coded_free(&one);
        coded_free(&many);
    }
}
