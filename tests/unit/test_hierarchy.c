/* Cells of mixed levels to an octree, against inserting them one by one into a dense grid. */
#include "svo_hierarchy.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_alloc.h"
#include "svo_morton.h"
#include "test.h"

static int compare(const void *a, const void *b)
{
    const svo_sample *x = a, *y = b;
    if (x->code != y->code) return x->code < y->code ? -1 : 1;
    if (x->level != y->level) return x->level < y->level ? -1 : 1;
    return x->value < y->value ? -1 : x->value > y->value; /* values ascend in the input: stable */
}

static svo_sample random_sample(uint64_t *seed, uint32_t depth, uint32_t least_level, uint32_t value)
{
    uint32_t level = least_level + (uint32_t)(test_random(seed) % (depth - least_level + 1)), up = depth - level;
    uint64_t cells = (uint64_t)1 << 3 * level;
    return (svo_sample){(test_random(seed) % cells) << 3 * up, value, level};
}

TEST(sorts_like_qsort)
{
    static const uint32_t sizes[] = {0, 1, 2, 47, 48, 49, 1000, 70000};
    svo_error err = {0};
    for (size_t n = 0; n < sizeof sizes / sizeof sizes[0]; n++)
        for (uint32_t depth = 2; depth <= 21; depth += 19) {
            uint64_t seed = n + depth;
            uint32_t count = sizes[n];
            svo_sample *a = malloc((count + 1) * sizeof *a), *b = malloc((count + 1) * sizeof *b), *scratch = malloc((count + 1) * sizeof *a);
            for (uint32_t i = 0; i < count; i++) b[i] = a[i] = random_sample(&seed, depth, 0, i);
            qsort(b, count, sizeof *b, compare);
            CHECK_OK(svo_sort_samples(a, scratch, count, 2, &err));
            CHECK(memcmp(a, b, count * sizeof *a) == 0);
            free(a);
            free(b);
            free(scratch);
        }
}

/* Level of the coarsest sample that holds a cell, or -1: insertion one by one. */
static void insert_all(const svo_sample *s, uint64_t count, uint32_t depth, int8_t *grid)
{
    uint64_t cells = (uint64_t)1 << 3 * depth;
    memset(grid, -1, cells);
    for (uint64_t i = 0; i < count; i++)
        for (uint64_t c = s[i].code; c < s[i].code + ((uint64_t)1 << 3 * (depth - s[i].level)); c++)
            if (grid[c] < 0 || grid[c] > (int8_t)s[i].level) grid[c] = (int8_t)s[i].level;
}

/* A channel that counts the samples of a cell and of finer ones inside it, and says where the cell is stored. */
static void count_samples(void *user, const svo_sample *s, uint64_t count, uint32_t level, uint8_t *value)
{
    const uint64_t end = s[0].code + ((uint64_t)1 << 3 * (*(const uint32_t *)user - s[0].level));
    for (uint64_t i = 1; i < count; i++) CHECK(s[i].code >= s[0].code && s[i].code < end);
    CHECK(level >= s[0].level);
    value[0] = (uint8_t)level, value[1] = (uint8_t)count, value[2] = (uint8_t)(count >> 8), value[3] = (uint8_t)s[0].level;
}

TEST(equals_insertion_one_by_one)
{
    svo_error err = {0};
    for (uint32_t depth = 2; depth <= 5; depth++)
        for (uint32_t round = 0; round < 12; round++) {
            uint64_t seed = 100 * depth + round;
            uint32_t count = round == 0 ? 1 : (uint32_t)(test_random(&seed) % 400), least = round % 3 == 0 ? 0 : depth - round % 3;
            svo_sample *s = malloc((count + 1) * sizeof *s), *copy = malloc((count + 1) * sizeof *s);
            uint8_t *values = malloc(4 * (count + 1));
            for (uint32_t i = 0; i < count; i++) {
                copy[i] = s[i] = random_sample(&seed, depth, round == 0 ? 0 : least, i);
                if (round == 0) copy[i] = s[i] = (svo_sample){0, 0, 0}; /* the whole cube */
                memcpy(values + 4 * i, &i, 4);
            }
            svo_hierarchy_input in = {.depth = depth, .sample_count = count, .samples = s, .value_count = count, .channel_count = 1};
            in.channels[0] = (svo_channel){.name = "bone", .kind = SVO_KIND_ID32};
            in.values[0] = values;
            svo_hierarchy_merge merge = {.channel = 1, .merge = count_samples, .user = &depth};
            in.channel_count = 2, in.channels[1] = (svo_channel){.name = "material", .kind = SVO_KIND_ID32}, in.values[1] = values, in.merge = &merge;
            for (int k = 0; k < 4; k++) in.voxel_to_world[5 * k] = 1;
            svo_hierarchy *h;
            svo_hierarchy_report r;
            CHECK_OK(svo_hierarchy_build(&in, 2, NULL, &h, &r, &err));
            const svo_view *v = svo_hierarchy_view(h);
            CHECK_OK(svo_view_validate(v, NULL, &err));
            int8_t *grid = malloc((size_t)1 << 3 * depth);
            insert_all(copy, count, depth, grid);
            uint64_t voxels = 0;
            for (uint64_t c = 0; c < (uint64_t)1 << 3 * depth; c++) {
                uint32_t x, y, z;
                uint64_t index = 0;
                svo_morton_decode(c, &x, &y, &z);
                bool there = svo_view_voxel(v, x, y, z, &index);
                CHECK(there == (grid[c] >= 0));
                if (!there) continue;
                voxels++;
                uint32_t value;
                svo_view_attribute(v, 0, index, (uint8_t *)&value);
                CHECK(value < count);
                CHECK_U64(copy[value].level, (uint64_t)grid[c]); /* the value is one of a sample of that level, there */
                CHECK_U64(copy[value].code >> 3 * (depth - copy[value].level), c >> 3 * (depth - copy[value].level));
                uint8_t merged[4];
                uint32_t inside = 0;
                const uint32_t level = copy[value].level;
                svo_view_attribute(v, 1, index, merged);
                for (uint32_t i = 0; i < count; i++) inside += copy[i].level >= level && copy[i].code >> 3 * (depth - level) == c >> 3 * (depth - level);
                CHECK_U64(merged[3], level);
                CHECK_U64(merged[1] + 256u * merged[2], inside);
                CHECK_U64(merged[0], level == depth - 1 ? depth : level == 0 ? (depth == 2 ? 2 : 1) : level); /* (bricks hold finest voxels) */
            }
            CHECK_U64(v->nodes[depth], voxels);
            free(grid);
            svo_hierarchy_free(h);
            free(s);
            free(copy);
            free(values);
        }
}

TEST(deepest_tree_and_no_memory)
{
    svo_error err = {0};
    svo_sample s[3] = {{0, 0, 21}, {((uint64_t)1 << 63) - 1, 1, 21}, {(uint64_t)7 << 60, 2, 1}};
    uint8_t values[9] = {1, 2, 3, 4, 5, 6, 7, 8, 9};
    svo_hierarchy_input in = {.depth = 21, .sample_count = 3, .samples = s, .value_count = 3, .channel_count = 1};
    in.channels[0] = (svo_channel){.name = "color", .kind = SVO_KIND_COLOR_SRGB8};
    in.values[0] = values;
    for (int k = 0; k < 4; k++) in.voxel_to_world[5 * k] = 1;
    svo_hierarchy *h;
    CHECK_OK(svo_hierarchy_build(&in, 1, NULL, &h, NULL, &err));
    CHECK_OK(svo_view_validate(svo_hierarchy_view(h), NULL, &err));
    CHECK(svo_view_voxel(svo_hierarchy_view(h), 0, 0, 0, NULL));
    CHECK(svo_view_voxel(svo_hierarchy_view(h), 0x1fffff, 0x1fffff, 0x1fffff, NULL));
    CHECK(svo_view_voxel(svo_hierarchy_view(h), 0x100000, 0x100000, 0x100000, NULL));
    CHECK(!svo_view_voxel(svo_hierarchy_view(h), 1, 0, 0, NULL));
    svo_hierarchy_free(h);
    for (uint64_t fail = 1; fail < 40; fail++) {
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = fail;
        svo_result r = svo_hierarchy_build(&in, 1, &a.base, &h, NULL, &err);
        if (r == SVO_OK) svo_hierarchy_free(h);
        else CHECK_RESULT(r, SVO_OUT_OF_MEMORY);
        CHECK_U64(svo_limit_in_use(&a), 0);
    }
}
