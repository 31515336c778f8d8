/* The small form of .svo: coded masks of every shape of subtree, groups, full leaves, damaged streams. */
#include <stdlib.h>
#include <string.h>

#include "fmt_svo.h"
#include "fmti_svo_masks.h"
#include "svo_morton.h"
#include "test.h"
#include "trees.h"

static svo_error err;

static void open_file(const svo_buffer *file, fmt_input **in, fmt_svo_reader **r)
{
    CHECK_OK(fmt_input_open_memory(file->data, file->size, in, &err));
    CHECK_OK(fmt_svo_reader_open(*in, NULL, r, &err));
}

/* Through the small form; the bytes must not depend on threads. */
static void round_trip(const tree *t)
{
    svo_buffer one, many;
    svo_buffer_init(&one, NULL);
    svo_buffer_init(&many, NULL);
    svo_tree_counts written = {0};
    tree_write_small(t, 1, &one, &written);
    tree_write_small(t, 3, &many, NULL);
    CHECK(one.size == many.size && memcmp(one.data, many.data, one.size) == 0);
    if (test_failed()) return;
    fmt_input *in;
    fmt_svo_reader *r;
    open_file(&one, &in, &r);
    tree_check(t, fmt_svo_reader_info(r), fmt_svo_reader_source(r));
    CHECK(memcmp(fmt_svo_reader_counts(r), &written, sizeof written) == 0);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    svo_buffer_free(&one);
    svo_buffer_free(&many);
}

TEST(random_trees_come_back)
{
    static const uint32_t depths[] = {0, 1, 2, 3, 6, 7, 8, 9, 12, 20, 21};
    uint64_t seed = 5;
    for (size_t d = 0; d < sizeof depths / sizeof depths[0]; d++)
        for (uint32_t style = 0; style < TREE_STYLES; style++) {
            tree t;
            tree_random(&t, depths[d], style, &seed);
            round_trip(&t);
            tree_free(&t);
            if (test_failed()) return;
        }
}

TEST(every_voxel_of_the_grid)
{
    uint64_t seed = 6;
    for (uint32_t depth = 0; depth <= 7; depth += depth < 4 ? 1 : 3) {
        tree t;
        tree_full(&t, depth, &seed);
        round_trip(&t);
        tree_free(&t);
        if (test_failed()) return;
    }
}

/* --- subtrees without a file ----------------------------------------------------------------------------------------- */

typedef bool (*exists_fn)(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed);

/* Masks of the cells of a grid of 2^levels that exist, by a grid of levels in memory. */
static uint32_t build(const uint8_t *cells, uint32_t levels, uint32_t level, uint32_t x, uint32_t y, uint32_t z, svo_buffer *masks)
{
    if (level == levels) return cells[(z << levels | y) << levels | x];
    size_t at = masks->size;
    uint8_t mask = 0;
    if (svo_buffer_append(masks, &mask, 1) == NULL) abort();
    for (uint32_t i = 0; i < 8; i++)
        if (build(cells, levels, level + 1, 2 * x + (i & 1), 2 * y + (i >> 1 & 1), 2 * z + (i >> 2), masks) != 0) mask |= (uint8_t)(1u << i);
    if (mask == 0) masks->size = at;
    else masks->data[at] = mask;
    return mask;
}

/* Code and decode. */
static void code_cells(fmti_masks_pool *pool, uint32_t levels, exists_fn exists, uint64_t *seed, double *bits)
{
    uint32_t n = 1u << levels;
    uint8_t *cells = calloc((size_t)n * n, n);
    for (uint32_t z = 0; z < n; z++)
        for (uint32_t y = 0; y < n; y++)
            for (uint32_t x = 0; x < n; x++) cells[(z << levels | y) << levels | x] = exists(x, y, z, seed);
    svo_buffer masks, coded;
    svo_buffer_init(&masks, NULL);
    svo_buffer_init(&coded, NULL);
    if (build(cells, levels, 0, 0, 0, 0, &masks) != 0) {
        CHECK_OK(fmti_masks_encode(pool, levels, masks.data, masks.size, &coded, &err));
        uint8_t *back = malloc(masks.size);
        CHECK_OK(fmti_masks_decode(pool, levels, coded.data, coded.size, back, masks.size, &err));
        CHECK(memcmp(back, masks.data, masks.size) == 0);
        if (masks.size > 1) CHECK(fmti_masks_decode(pool, levels, coded.data, coded.size, back, masks.size - 1, &err) == SVO_INVALID_DATA);
        CHECK(fmti_masks_decode(pool, levels, coded.data, coded.size, back, 0, &err) == SVO_INVALID_DATA);
        free(back);
        *bits = 8.0 * (double)coded.size;
    }
    svo_buffer_free(&masks);
    svo_buffer_free(&coded);
    free(cells);
}

static bool all(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return (void)x, (void)y, (void)z, (void)seed, true; }
static bool checkerboard(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return (void)seed, (x ^ y ^ z) & 1; }
static bool corner(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return *seed == ((z & 1) << 2 | (y & 1) << 1 | (x & 1)) && x >> 1 == (*seed & 1) * (63u & x >> 1); }
static bool one_far(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return (void)seed, (x & y & z) == 1 && (x | y | z) == 1; }
static bool noise(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return (void)x, (void)y, (void)z, test_random(seed) % 3 == 0; }
static bool sparse(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return (void)x, (void)y, (void)z, test_random(seed) % 997 == 0; }
static bool wall(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return (void)y, (void)z, (void)seed, x == 17; }
static bool slope(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return (void)seed, abs((int)(3 * x + 5 * y) - (int)(7 * z)) <= 7; }
static bool bars(uint32_t x, uint32_t y, uint32_t z, uint64_t *seed) { return (void)seed, x % 20 == 19 && (y + z) % 3 == 0; }

TEST(all_shapes_of_subtrees_come_back)
{
    static const exists_fn shapes[] = {all, checkerboard, corner, one_far, noise, sparse, wall, slope, bars};
    fmti_masks_pool *pool;
    CHECK_OK(fmti_masks_pool_new(NULL, &pool, &err));
    uint64_t seed = 3;
    double bits;
    for (uint32_t levels = 1; levels <= 7; levels += levels < 3 ? 1 : 2)
        for (size_t i = 0; i < sizeof shapes / sizeof shapes[0]; i++) code_cells(pool, levels, shapes[i], &seed, &bits);
    fmti_masks_pool_free(pool);
}

/* What the model is for: surfaces take a fraction of a bit a voxel, nothing takes much more than a bit a decision. */
TEST(bits_a_voxel)
{
    static const struct { exists_fn exists; uint32_t levels; double voxels, most; } cases[] = {
        {slope, 7, 128 * 128 * 2, 0.25}, {wall, 7, 128 * 128, 0.05}, {all, 7, 128 * 128 * 128, 0.005}, {noise, 5, 32 * 32 * 32, 1.2} /* entropy of a third: 0.92 */};
    fmti_masks_pool *pool;
    CHECK_OK(fmti_masks_pool_new(NULL, &pool, &err));
    uint64_t seed = 3;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        double bits = 0;
        code_cells(pool, cases[i].levels, cases[i].exists, &seed, &bits);
        CHECK(bits > 0);
        CHECK(bits / cases[i].voxels < cases[i].most);
    }
    fmti_masks_pool_free(pool);
}

/* A stream does not depend on what was coded before it, however long that was. */
TEST(subtrees_are_independent)
{
    fmti_masks_pool *pool;
    CHECK_OK(fmti_masks_pool_new(NULL, &pool, &err));
    uint64_t seed = 9;
    double first = 0, small = 0, again = 0, other;
    code_cells(pool, 6, slope, &seed, &first);
    code_cells(pool, 3, slope, &seed, &small);
    code_cells(pool, 7, noise, &seed, &other);
    code_cells(pool, 6, slope, &seed, &again);
    CHECK(again == first);
    code_cells(pool, 3, slope, &seed, &again);
    CHECK(again == small);
    code_cells(pool, 2, noise, &seed, &other);
    code_cells(pool, 6, slope, &seed, &again);
    CHECK(again == first);
    fmti_masks_pool_free(pool);
}

TEST(any_bytes_are_decoded_or_refused)
{
    fmti_masks_pool *pool;
    CHECK_OK(fmti_masks_pool_new(NULL, &pool, &err));
    uint64_t seed = 77;
    uint8_t masks[600], bytes[256];
    uint32_t good = 0;
    for (uint32_t round = 0; round < 4000; round++) {
        uint64_t size = test_random(&seed) % sizeof bytes, count = 1 + test_random(&seed) % sizeof masks;
        for (uint64_t i = 0; i < size; i++) bytes[i] = (uint8_t)(round % 3 == 0 ? test_random(&seed) & test_random(&seed) : test_random(&seed));
        if (round % 5 == 0 && size != 0) bytes[0] = 0; /* with full leaves */
        svo_result r = fmti_masks_decode(pool, 1 + (uint32_t)(test_random(&seed) % 7), bytes, size, masks, count, &err);
        CHECK(r == SVO_OK || r == SVO_INVALID_DATA);
        good += r == SVO_OK;
    }
    CHECK(good < 400);
    fmti_masks_pool_free(pool);
}

/* --- groups and full leaves ------------------------------------------------------------------------------------------ */

/* More than 64 subtrees, in several groups by code, and by bytes; the fast form holds the same. */
TEST(groups_end_where_they_must)
{
    enum { SIDE = 10 };
    svo_tree_info info = {.depth = 11, .channel_count = 1, .channels = {{.name = "id", .kind = SVO_KIND_ID32}}};
    for (int i = 0; i < 16; i += 5) info.voxel_to_world[i] = 1;
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *out;
    fmt_svo_writer *w;
    CHECK_OK(fmt_output_open_memory(&file, &out, &err));
    CHECK_OK(fmt_svo_writer_begin(out, &info, NULL, 0, NULL, &w, &err));
    CHECK_OK(fmt_svo_writer_small(w, &err));
    svo_chunk_sink s = fmt_svo_writer_sink(w);
    static uint8_t masks[1 + 8 + 64 + 512 + 4096 + 32768 + 262144];
    static uint8_t ids[4 << 17];
    uint64_t seed = 1, chunks = 0;
    for (size_t i = 0; i < sizeof ids; i++) ids[i] = (uint8_t)test_random(&seed);
    for (uint64_t code = 3; code < 4096; code += 29, chunks++) {
        /* every fifth is a line of masks with 2^17 values that do not compress: 512 KiB, so three of them end a group */
        svo_chunk c = {.code = code, .level = 4, .depth = 11, .masks = masks, .channels = {ids}};
        bool large = chunks % 5 == 0 && chunks < 30;
        uint64_t n = 0;
        if (large) {
            static const uint8_t by_level[7] = {255, 255, 255, 255, 255, 15, 1};
            uint8_t left[7];
            uint32_t l = 0;
            for (;;) { /* depth-first */
                masks[n++] = by_level[l];
                if (l < 6) {
                    left[l] = (uint8_t)__builtin_popcount(by_level[l]);
                    l++;
                    continue;
                }
                while (l > 0 && --left[l - 1] == 0) l--;
                if (l == 0) break;
            }
            c.value_count = 8 * 8 * 8 * 8 * 8 * 4;
        } else {
            for (; n < 7; n++) masks[n] = 2;
            c.value_count = 1;
        }
        c.node_count = n;
        void *blob;
        CHECK_OK(s.encode(s.user, &c, 0, &blob, &err));
        CHECK_OK(s.commit(s.user, blob, &err));
        if (test_failed()) return;
    }
    svo_tree_counts counts;
    CHECK_OK(fmt_svo_writer_end(w, &counts, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    CHECK_U64(counts.chunks, chunks);

    fmt_container c;
    CHECK_OK(fmt_container_open(file.data, file.size, NULL, &c, &err));
    uint64_t groups = 0, inside = 0;
    for (uint32_t i = 0; i < c.chunk_count; i++) {
        if (c.chunks[i].type != FMT_FOURCC('G', 'R', 'U', 'P')) continue;
        groups++;
        inside += c.data[c.chunks[i].offset];
        CHECK(c.chunks[i].stored_size < (1 << 20) + 4096);
    }
    CHECK_U64(inside, chunks);
    CHECK(groups >= 64 && groups < 70); /* 64 of codes, and a few that were full */
    fmt_container_close(&c);

    fmt_input *in;
    fmt_svo_reader *r;
    open_file(&file, &in, &r);
    svo_chunk_source source = fmt_svo_reader_source(r);
    svo_buffer packed, storage;
    svo_buffer_init(&packed, NULL);
    svo_buffer_init(&storage, NULL);
    uint64_t code = 3, seen = 0;
    for (;; code += 29, seen++) {
        bool more;
        svo_chunk chunk;
        CHECK_OK(source.fetch(source.user, &packed, &more, &err));
        if (!more) break;
        CHECK_OK(source.decode(source.user, &packed, &storage, &chunk, &err));
        CHECK_U64(chunk.code, code);
        CHECK(memcmp(chunk.channels[0], ids, (size_t)chunk.value_count * 4) == 0);
        if (test_failed()) return;
    }
    CHECK_U64(seen, chunks);
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    svo_buffer_free(&file);
}

/* Full leaves of every level inside subtrees. */
TEST(full_leaves_come_back)
{
    fmti_masks_pool *pool;
    CHECK_OK(fmti_masks_pool_new(NULL, &pool, &err));
    uint64_t seed = 31;
    for (uint32_t round = 0; round < 200; round++) {
        uint32_t levels = 1 + (uint32_t)(test_random(&seed) % 7), l = 0;
        static uint8_t masks[300000], back[300000];
        uint8_t left[7];
        uint64_t n = 0, leaves = 1 + test_random(&seed) % 8;
        for (;;) { /* a random tree, full leaves with the probability leaves / 16 */
            uint8_t mask = (uint8_t)(1 + test_random(&seed) % 255);
            if (l > 2) mask &= (uint8_t)(test_random(&seed) | 1u << test_random(&seed) % 8);
            if (mask == 0) mask = 1;
            if (l > 0 && test_random(&seed) % 16 < leaves) mask = 0;
            masks[n++] = mask;
            if (mask != 0 && l + 1 < levels) {
                left[l++] = (uint8_t)__builtin_popcount(mask);
                continue;
            }
            while (l > 0 && --left[l - 1] == 0) l--;
            if (l == 0) break;
        }
        svo_buffer coded;
        svo_buffer_init(&coded, NULL);
        CHECK_OK(fmti_masks_encode(pool, levels, masks, n, &coded, &err));
        CHECK_OK(fmti_masks_decode(pool, levels, coded.data, coded.size, back, n, &err));
        CHECK(memcmp(masks, back, n) == 0);
        svo_buffer_free(&coded);
        if (test_failed()) return;
    }
    fmti_masks_pool_free(pool);
}
