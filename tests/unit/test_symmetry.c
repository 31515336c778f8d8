/* The 48 turns against brute force; the merged DAG against plain sets of voxels. */
#include <stdlib.h>
#include <string.h>

#include "svo_morton.h"
#include "svoi_symmetry.h"
#include "test.h"

/* --- turns ------------------------------------------------------------------------------------------------------- */

/* Turn g applied to a cell of a cube of n cells a side: what the tables are made of, from their definition. */
static void turn_cell(uint32_t g, uint32_t n, const uint32_t in[3], uint32_t out[3])
{
    static const uint32_t axes[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    for (uint32_t k = 0; k < 3; k++) out[axes[g >> 3][k]] = in[k];
    for (uint32_t k = 0; k < 3; k++)
        if (g >> k & 1) out[k] = n - 1 - out[k];
}

static uint64_t turn_code(uint32_t g, uint32_t levels, uint64_t code)
{
    uint32_t in[3], out[3];
    svo_morton_decode(code, &in[0], &in[1], &in[2]);
    turn_cell(g, 1u << levels, in, out);
    return svo_morton_encode(out[0], out[1], out[2]);
}

TEST(tables_follow_from_the_definition)
{
    for (uint32_t g = 0; g < SVOI_TURNS; g++) {
        for (uint32_t o = 0; o < 8; o++) CHECK_U64(svoi_turn_octant(g, o), turn_code(g, 1, o));
        for (uint32_t m = 0; m < 256; m++) {
            uint32_t want = 0;
            for (uint32_t o = 0; o < 8; o++) want |= (m >> o & 1) << turn_code(g, 1, o);
            CHECK_U64(svoi_turn_mask(g, m), want);
        }
        for (uint32_t h = 0; h < SVOI_TURNS; h++)
            for (uint32_t o = 0; o < 8; o++)
                CHECK_U64(svoi_turn_octant(svoi_turn_after(g, h), o), svoi_turn_octant(g, svoi_turn_octant(h, o)));
        CHECK_U64(svoi_turn_after(g, svoi_turn_inverse(g)), 0);
        CHECK_U64(svoi_turn_after(svoi_turn_inverse(g), g), 0);
    }
}

TEST(turns_form_groups)
{
    static const uint32_t size[3] = {SVOI_IDENTITY, SVOI_MIRRORS, SVOI_ALL};
    for (int i = 0; i < 3; i++)
        for (uint32_t g = 0; g < size[i]; g++)
            for (uint32_t h = 0; h < size[i]; h++) CHECK(svoi_turn_after(g, h) < size[i]);
}

static uint64_t turn_brick(uint32_t g, uint64_t bits)
{
    uint64_t out = 0;
    for (uint32_t b = 0; b < 64; b++) out |= (bits >> b & 1) << turn_code(g, 2, b);
    return out;
}

/* Bricks with all kinds of symmetry: orbits of a few voxels under random subgroups, and noise. */
static uint64_t random_brick(uint64_t *seed)
{
    uint64_t r = test_random(seed), bits = 0;
    uint32_t voxels = 1 + (uint32_t)(r & 7), g = (uint32_t)(r >> 8) % SVOI_TURNS, h = (uint32_t)(r >> 16) % SVOI_TURNS;
    if ((r >> 24 & 3) == 0) return test_random(seed) | 1;
    for (uint32_t i = 0; i < voxels; i++) bits |= (uint64_t)1 << (test_random(seed) & 63);
    for (int i = 0; i < 6 && (r >> 26 & 1); i++) bits |= turn_brick(g, bits) | turn_brick(h, bits);
    return bits;
}

TEST(bricks_turn_voxel_by_voxel)
{
    uint64_t seed = 1;
    for (int i = 0; i < 200; i++) {
        uint64_t bits = random_brick(&seed);
        for (uint32_t g = 0; g < SVOI_TURNS; g++) CHECK_U64(svoi_turn_brick(g, bits), turn_brick(g, bits));
    }
}

TEST(canonical_bricks_are_least_with_exact_stabilizers)
{
    static const svoi_group group[3] = {SVOI_IDENTITY, SVOI_MIRRORS, SVOI_ALL};
    uint64_t seed = 2;
    for (int i = 0; i < 6000; i++) {
        uint64_t bits = random_brick(&seed), best = bits, stays = 0, stabilizer;
        svoi_group n = group[i % 3];
        uint32_t turn, least = SVOI_TURNS;
        for (uint32_t g = 0; g < (uint32_t)n; g++) {
            uint64_t t = svoi_turn_brick(g, bits);
            if (t < best) best = t;
        }
        for (uint32_t g = (uint32_t)n; g-- > 0;) {
            stays |= (uint64_t)(svoi_turn_brick(g, best) == best) << g;
            if (svoi_turn_brick(g, best) == bits) least = g;
        }
        CHECK_U64(svoi_brick_canonical(n, bits, &turn, &stabilizer), best);
        CHECK_U64(turn, least);
        CHECK_U64(stabilizer, stays);
    }
}

/* --- merged DAGs ------------------------------------------------------------------------------------------------- */

enum { MAX_VOXELS = 1 << 17 };

typedef struct voxels {
    uint64_t code[MAX_VOXELS];
    uint32_t count;
} voxels;

static int compare_codes(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

static void sort_voxels(voxels *v)
{
    qsort(v->code, v->count, sizeof *v->code, compare_codes);
    uint32_t n = 0;
    for (uint32_t i = 0; i < v->count; i++)
        if (n == 0 || v->code[n - 1] != v->code[i]) v->code[n++] = v->code[i];
    v->count = n;
}

/* Copies of a few small clusters, each turned at random, in random cells of 2^cluster. */
static void random_voxels(voxels *v, uint32_t depth, uint32_t cluster, uint32_t group, uint64_t *seed)
{
    uint64_t pattern[3][24];
    v->count = 0;
    for (int p = 0; p < 3; p++)
        for (int i = 0; i < 24; i++) pattern[p][i] = test_random(seed) & (((uint64_t)1 << 3 * cluster) - 1) & (i < 12 ? ~(uint64_t)0 : (uint64_t)077);
    for (int copy = 0; copy < 40; copy++) {
        uint64_t cell = test_random(seed) & (((uint64_t)1 << 3 * (depth - cluster)) - 1);
        uint32_t g = (uint32_t)(test_random(seed) % group), p = (uint32_t)(test_random(seed) % 3);
        for (int i = 0; i < 24; i++) v->code[v->count++] = cell << 3 * cluster | turn_code(g, cluster, pattern[p][i]);
    }
    sort_voxels(v);
}

typedef struct tables {
    svoi_bricks bricks;
    svoi_nodes nodes[SVO_MAX_DEPTH];
    bool lod;
    uint32_t root;
} tables;

/* Subtree of the voxels [begin, end), whose codes agree above `levels`. Returns its number, *size its attributes. */
static uint32_t add_subtree(tables *t, uint32_t level, uint32_t levels, const uint64_t *begin, const uint64_t *end, uint64_t *size)
{
    uint32_t number = 0, refs[8], mask = 0, k = 0;
    if (levels == 2) {
        uint64_t bits = 0;
        for (const uint64_t *c = begin; c < end; c++) bits |= (uint64_t)1 << (*c & 63);
        if (svoi_bricks_insert(&t->bricks, bits, &number) != SVO_OK) abort();
        *size = svoi_brick_size(t->lod, bits);
        return number;
    }
    *size = t->lod;
    while (begin < end) {
        uint32_t o = (uint32_t)(*begin >> 3 * (levels - 1)) & 7;
        const uint64_t *next = begin;
        while (next < end && ((*next >> 3 * (levels - 1)) & 7) == o) next++;
        uint64_t below;
        refs[k++] = add_subtree(t, level + 1, levels - 1, begin, next, &below);
        mask |= 1u << o;
        *size += below;
        begin = next;
    }
    if (svoi_nodes_insert(&t->nodes[level], mask, refs, *size, &number) != SVO_OK) abort();
    return number;
}

static void make(svoi_symdag *d, const voxels *v, uint32_t depth, bool lod, svoi_group group, uint32_t threads)
{
    tables *t = calloc(1, sizeof *t);
    uint64_t size;
    t->lod = lod;
    uint32_t root = add_subtree(t, 0, depth, v->code, v->code + v->count, &size);
    svo_result r = svoi_symdag_make(d, t->nodes, &t->bricks, depth - 2, root, lod, lod, group, threads, NULL);
    free(t);
    CHECK(r == SVO_OK);
    CHECK_U64(svoi_symdag_size(d, 0, d->root), size);
}

/* All voxels below a stored node that appears turned by g, code prefix `at`. */
static void expand(const svoi_symdag *d, uint32_t level, uint32_t number, uint32_t g, uint64_t at, voxels *out)
{
    const svoi_symlevel *l = &d->level[level];
    if (level == d->brick_level) {
        uint64_t bits = turn_brick(g, l->bits[number]);
        for (; bits != 0; bits &= bits - 1) out->code[out->count++] = at << 6 | (uint64_t)__builtin_ctzll(bits);
        return;
    }
    const uint32_t *item = l->items + l->start[number];
    uint32_t k = 1;
    for (uint32_t o = 0; o < 8; o++)
        if (svoi_head_refs(item[0]) >> o & 1) {
            expand(d, level + 1, item[k], svoi_turn_after(g, l->turn[l->start[number] + k]), at << 3 | svoi_turn_octant(g, o), out);
            k++;
        }
}

static voxels input, output, part;

TEST(merged_trees_expand_to_the_same_voxels)
{
    static const svoi_group group[3] = {SVOI_IDENTITY, SVOI_MIRRORS, SVOI_ALL};
    uint64_t seed = 3;
    for (int i = 0; i < 60; i++) {
        uint32_t depth = 2 + (uint32_t)i % 8;
        random_voxels(&input, depth, depth < 4 ? depth : 2 + (uint32_t)i % 3, SVOI_ALL, &seed);
        svoi_symdag d;
        make(&d, &input, depth, i & 1, group[i % 3], 1 + (uint32_t)i % 3);
        output.count = 0;
        expand(&d, 0, d.root, d.root_turn, 0, &output);
        qsort(output.code, output.count, sizeof *output.code, compare_codes);
        CHECK_U64(output.count, input.count);
        CHECK(memcmp(output.code, input.code, input.count * sizeof *input.code) == 0);
        svoi_symdag_free(&d);
    }
}

/* How many subtrees of `levels` differ under the group, found from their voxels. */
static uint64_t count_orbits(const voxels *v, uint32_t levels, uint32_t group)
{
    enum { LIMIT = 512, LONG = 64 };
    static uint64_t seen[LIMIT][LONG];
    static uint32_t length[LIMIT];
    uint64_t orbits = 0;
    for (uint32_t begin = 0, end; begin < v->count; begin = end) {
        uint64_t best[LONG] = {0};
        for (end = begin; end < v->count && v->code[end] >> 3 * levels == v->code[begin] >> 3 * levels; end++) {}
        uint32_t n = end - begin;
        if (n > LONG) return UINT64_MAX;
        for (uint32_t g = 0; g < group; g++) {
            uint64_t code[LONG];
            for (uint32_t i = 0; i < n; i++) code[i] = turn_code(g, levels, v->code[begin + i] & (((uint64_t)1 << 3 * levels) - 1));
            qsort(code, n, sizeof *code, compare_codes);
            bool less = g == 0;
            for (uint32_t i = 0; i < n && !less; i++) {
                if (code[i] > best[i]) break;
                less = code[i] < best[i];
            }
            if (less) memcpy(best, code, n * sizeof *code);
        }
        uint64_t k = 0;
        while (k < orbits && !(length[k] == n && memcmp(seen[k], best, n * sizeof *best) == 0)) k++;
        if (k < orbits) continue;
        if (orbits == LIMIT) return UINT64_MAX;
        memcpy(seen[orbits], best, sizeof best);
        length[orbits++] = n;
    }
    return orbits;
}

TEST(everything_that_is_equal_is_merged)
{
    static const svoi_group group[3] = {SVOI_IDENTITY, SVOI_MIRRORS, SVOI_ALL};
    uint64_t seed = 4;
    for (int i = 0; i < 30; i++) {
        uint32_t depth = 6;
        random_voxels(&input, depth, 2 + (uint32_t)i % 3, (uint32_t)group[i / 3 % 3], &seed);
        svoi_symdag d;
        make(&d, &input, depth, true, group[i % 3], 1);
        for (uint32_t levels = 2; levels <= 4; levels++) {
            uint64_t orbits = count_orbits(&input, levels, (uint32_t)group[i % 3]);
            if (orbits != UINT64_MAX) CHECK_U64(d.level[depth - levels].count, orbits);
        }
        svoi_symdag_free(&d);
    }
}

/* Every reference reduced, every use counted, every size right, stabilizers exact where voxels can tell. */
TEST(stored_nodes_are_consistent)
{
    uint64_t seed = 5;
    for (int i = 0; i < 20; i++) {
        uint32_t depth = 4 + (uint32_t)i % 3;
        random_voxels(&input, depth, 3, SVOI_ALL, &seed);
        svoi_symdag d;
        svoi_group group = i & 1 ? SVOI_ALL : SVOI_MIRRORS;
        make(&d, &input, depth, i & 2, group, 1);
        for (uint32_t level = 0; level <= d.brick_level; level++) {
            const svoi_symlevel *l = &d.level[level], *above = &d.level[level - (level != 0)];
            uint32_t *uses = calloc(l->count, sizeof *uses);
            if (level == 0) uses[d.root]++;
            for (uint64_t w = 0; level != 0 && w < above->count; w++) {
                const uint32_t *item = above->items + above->start[w];
                for (uint32_t k = 0; k < (uint32_t)__builtin_popcount(svoi_head_refs(item[0])); k++) {
                    uses[item[1 + k]]++;
                    uint32_t t = above->turn[above->start[w] + 1 + k];
                    CHECK(d.least[l->stabilizer[item[1 + k]]][t] == t);
                }
            }
            for (uint32_t n = 0; n < l->count; n++) {
                CHECK_U64(l->uses[n], uses[n]);
                output.count = 0;
                expand(&d, level, n, 0, 0, &output);
                qsort(output.code, output.count, sizeof *output.code, compare_codes);
                uint64_t size = output.count;
                for (uint32_t up = 1; d.lod && up <= depth - level; up++)
                    for (uint32_t j = 0; j < output.count; j++) size += j == 0 || output.code[j] >> 3 * up != output.code[j - 1] >> 3 * up;
                CHECK_U64(svoi_symdag_size(&d, level, n), size);
                for (uint32_t g = 0; g < (uint32_t)group; g++) {
                    part.count = 0;
                    expand(&d, level, n, g, 0, &part);
                    qsort(part.code, part.count, sizeof *part.code, compare_codes);
                    bool stays = memcmp(part.code, output.code, output.count * sizeof *part.code) == 0;
                    CHECK_U64(svoi_symdag_stabilizer(&d, level, n) >> g & 1, stays);
                }
            }
            free(uses);
        }
        svoi_symdag_free(&d);
    }
}

static bool same_level(const svoi_symlevel *a, const svoi_symlevel *b)
{
    if (a->count != b->count || a->item_count != b->item_count) return false;
    bool same = memcmp(a->uses, b->uses, a->count * sizeof *a->uses) == 0 && memcmp(a->stabilizer, b->stabilizer, a->count) == 0;
    if (a->bits != NULL) same = same && memcmp(a->bits, b->bits, a->count * sizeof *a->bits) == 0;
    if (a->items != NULL)
        same = same && memcmp(a->items, b->items, a->item_count * sizeof *a->items) == 0 && memcmp(a->turn, b->turn, a->item_count) == 0 &&
               memcmp(a->start, b->start, a->count * sizeof *a->start) == 0 && memcmp(a->size, b->size, a->count * sizeof *a->size) == 0;
    return same;
}

TEST(threads_do_not_show)
{
    uint64_t seed = 6;
    input.count = 0;
    for (int i = 0; i < 100000; i++) input.code[input.count++] = test_random(&seed) & (((uint64_t)1 << 30) - 1);
    sort_voxels(&input);
    svoi_symdag one, four;
    make(&one, &input, 10, true, SVOI_ALL, 1);
    make(&four, &input, 10, true, SVOI_ALL, 4);
    CHECK_U64(one.root, four.root);
    CHECK_U64(one.root_turn, four.root_turn);
    CHECK_U64(one.subgroup_count, four.subgroup_count);
    CHECK(memcmp(one.subgroup, four.subgroup, sizeof one.subgroup) == 0);
    for (uint32_t l = 0; l <= one.brick_level; l++) CHECK(same_level(&one.level[l], &four.level[l]));
    svoi_symdag_free(&one);
    svoi_symdag_free(&four);
}

TEST(no_memory_leaves_nothing_behind)
{
    uint64_t seed = 7;
    random_voxels(&input, 6, 3, SVOI_ALL, &seed);
    for (uint64_t fail = 1;; fail++) {
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        tables *t = calloc(1, sizeof *t);
        t->bricks.a = &a.base;
        for (uint32_t i = 0; i < SVO_MAX_DEPTH; i++) t->nodes[i].a = &a.base;
        uint64_t size;
        uint32_t root = add_subtree(t, 0, 6, input.code, input.code + input.count, &size);
        svoi_symdag d;
        a.fail_at = a.count + fail;
        svo_result r = svoi_symdag_make(&d, t->nodes, &t->bricks, 4, root, true, true, SVOI_ALL, 1, &a.base);
        if (r == SVO_OK) svoi_symdag_free(&d);
        free(t);
        CHECK_U64(svo_limit_in_use(&a), 0);
        if (r == SVO_OK) break;
        CHECK(r == SVO_OUT_OF_MEMORY);
    }
}
