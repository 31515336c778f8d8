/* The view's accessors against brute force, the arithmetic of bricks, and that validation proves each rule. */
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "svo_morton.h"
#include "svo_view.h"
#include "test.h"

TEST(brick_arithmetic)
{
    uint64_t seed = 1;
    for (int round = 0; round < 2000; round++) {
        uint64_t brick = test_random(&seed) & (round % 3 ? test_random(&seed) & test_random(&seed) : ~(uint64_t)0);
        for (int lod = 0; lod < 2; lod++) {
            uint64_t next = 1000 + (lod ? 1 : 0); /* the brick's own index is 1000 */
            for (uint32_t a = 0; a < 8; a++) {
                if (!(brick >> 8 * a & 0xff)) continue;
                CHECK((svo_brick_octants(brick) >> 8 * a & 0xff) == 1);
                CHECK_U64(svo_brick_octant(lod != 0, brick, 1000, a), next);
                if (lod) next++;
                for (uint32_t b = 8 * a; b < 8 * a + 8; b++) {
                    if (!(brick >> b & 1)) continue;
                    CHECK_U64(svo_brick_voxel(lod != 0, brick, 1000, b), next);
                    next++;
                }
            }
        }
    }
}

typedef struct list { uint64_t codes[4096], indices[4096], count, stop; } list;

static bool collect(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    list *l = user;
    if (l->count == l->stop) return false;
    l->codes[l->count] = svo_morton_encode(x, y, z);
    l->indices[l->count++] = index;
    return true;
}

static int compare_codes(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

TEST(voxels_by_place_and_by_walk)
{
    uint64_t seed = 2;
    for (uint32_t depth = 0; depth <= 21; depth++) {
        uint64_t codes[300], side = (uint64_t)1 << depth;
        for (int i = 0; i < 300; i++)
            codes[i] = svo_morton_encode((uint32_t)(test_random(&seed) % (side < 30 ? side : 30)), (uint32_t)(test_random(&seed) % side),
                                         (uint32_t)(test_random(&seed) % side));
        packer_options o = {.lod = depth % 2 != 0, .share = true, .offset_words = 1 + depth % 2};
        svo_view *v = packer_make(depth, codes, 300, &o);
        svo_error err = {0};
        CHECK_OK(svo_view_validate(v, NULL, &err));
        qsort(codes, 300, 8, compare_codes);
        list l = {.stop = 4096};
        CHECK(svo_view_voxels(v, collect, &l));
        uint64_t unique = 0;
        for (int i = 0; i < 300; i++) {
            if (i != 0 && codes[i] == codes[i - 1]) continue;
            uint32_t x, y, z;
            uint64_t index;
            svo_morton_decode(codes[i], &x, &y, &z);
            CHECK_U64(l.codes[unique], codes[i]);
            CHECK(svo_view_voxel(v, x, y, z, &index) && svo_view_voxel(v, x, y, z, NULL));
            CHECK_U64(l.indices[unique], index);
            unique++;
        }
        CHECK_U64(l.count, unique);
        for (int i = 0; i < 300; i++) { /* cells that are no voxels, near and far */
            uint64_t code = i % 2 ? codes[i] ^ 1 : test_random(&seed) & (((uint64_t)1 << 3 * depth) - 1);
            if (code >> 3 * depth != 0 || bsearch(&code, codes, 300, 8, compare_codes) != NULL) continue;
            uint32_t x, y, z;
            svo_morton_decode(code, &x, &y, &z);
            CHECK(!svo_view_voxel(v, x, y, z, NULL));
        }
        l.count = 0;
        l.stop = unique / 2;
        CHECK(svo_view_voxels(v, collect, &l) == (unique == 0)); /* stopped on the way */
        CHECK_U64(l.count, unique / 2);
        packer_free(v);
    }
}

TEST(channels_by_name)
{
    svo_view v = {.channel_count = 2};
    strcpy(v.channels[0].channel.name, "color");
    strcpy(v.channels[1].channel.name, "normal");
    CHECK_U64(svo_view_find_channel(&v, "normal"), 1);
    CHECK_U64(svo_view_find_channel(&v, "norm"), SVO_MAX_CHANNELS);
    CHECK_U64(svo_view_find_channel(&v, ""), SVO_MAX_CHANNELS);
}

/* Change one number of a good view; validation must say so, and name the rule. */
static void refused(svo_view *v, const char *rule)
{
    svo_error err = {0};
    svo_result r = svo_view_validate(v, NULL, &err);
    CHECK_MSG(r == SVO_INVALID_DATA && strstr(err.message, rule) != NULL, "%s: %s, %s", rule, svo_result_name(r), err.message);
}

TEST(each_rule_is_proved)
{
    uint64_t seed = 3, codes[200];
    for (int i = 0; i < 200; i++) codes[i] = test_random(&seed) & 0x3ffff; /* depth 6 */
    for (int lod = 0; lod < 2; lod++) {
        packer_options o = {.lod = lod != 0, .share = true};
        svo_view *v = packer_make(6, codes, 200, &o);
        svo_error err = {0};
        CHECK_OK(svo_view_validate(v, NULL, &err));
#define WITH(field, value, rule)      \
    do {                              \
        svo_view keep_ = *v;          \
        v->field = value;             \
        refused(v, rule);             \
        *v = keep_;                   \
    } while (0)
        WITH(depth, 22, "DAG-02");
        WITH(tree_depth, 7, "DAG-02");
        WITH(brick_level, 3, "DAG-02");
        WITH(channel_count, 17, "DAG-02");
        WITH(empty, true, "DAG-07");
        WITH(lod, !v->lod, "DAG-06");
        WITH(root, v->root + 1, "DAG-05");
        WITH(root, 0xffffffff, "DAG-05");
        WITH(attribute_count, v->attribute_count + 1, "DAG-06");
        WITH(nodes[2], v->nodes[2] + 1, "DAG-07");
        WITH(nodes[7], 1, "DAG-07");
        WITH(brick_count, v->brick_count - 1, "DAG-05");
        WITH(brick_count, 0, "DAG-05");
        WITH(levels[1].word_count, v->levels[1].word_count - 1, "DAG-03");
        WITH(levels[1].node_count, v->levels[1].node_count - 1, "DAG-07");
        WITH(levels[2].offset_words, 3, "DAG-03");
        WITH(levels[3].word_count, 0, "DAG-07");
        /* every word of every level: refused, or (a reference to another subtree of the same size) as sound a tree */
        uint64_t accepted = 0, tried = 0;
        for (uint32_t l = 0; l < v->brick_level; l++) {
            uint32_t *words = (uint32_t *)(uintptr_t)v->levels[l].words;
            for (uint64_t w = 0; w < v->levels[l].word_count; w++) {
                uint32_t keep = words[w], bit = 1u << test_random(&seed) % 32;
                words[w] ^= bit;
                tried++;
                if (svo_view_validate(v, NULL, &err) == SVO_OK) {
                    list seen = {.stop = 4096};
                    accepted++;
                    CHECK(svo_view_voxels(v, collect, &seen));
                    CHECK_U64(seen.count, v->nodes[6]);
                    for (uint64_t i = 0; i < seen.count; i++) {
                        CHECK(seen.indices[i] < v->attribute_count && seen.codes[i] >> 18 == 0);
                        if (i != 0) CHECK(seen.indices[i] > seen.indices[i - 1] && seen.codes[i] > seen.codes[i - 1]);
                    }
                }
                words[w] = keep;
            }
        }
        CHECK_MSG(accepted < tried / 5, "%llu of %llu changes accepted", (unsigned long long)accepted, (unsigned long long)tried);
        uint64_t *bricks = (uint64_t *)(uintptr_t)v->bricks, keep = bricks[0];
        bricks[0] = 0;
        refused(v, "DAG-04");
        bricks[0] = keep;
        packer_free(v);
    }
    /* depth 1: voxels outside the low corner */
    codes[0] = 3;
    svo_view *v = packer_make(1, codes, 1, NULL);
    *(uint64_t *)(uintptr_t)v->bricks = 1 << 8;
    refused(v, "DAG-04");
    packer_free(v);
}

/* Time and memory follow the stored nodes, not the 8^21 voxels that they describe. */
TEST(huge_but_small)
{
    svo_view *v = packer_solid(21, true);
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, 10000, NULL);
    svo_error err = {0};
    CHECK_OK(svo_view_validate(v, &limit.base, &err));
    CHECK_U64(svo_limit_in_use(&limit), 0);
    CHECK_U64(v->nodes[21], (uint64_t)1 << 63);
    packer_free(v);
}

static void some_value(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    (void)user, (void)channel;
    out[0] = (uint8_t)x, out[1] = (uint8_t)y, out[2] = (uint8_t)z, out[3] = 0;
}

TEST(normals_and_constants_are_checked)
{
    uint64_t codes[3] = {0, 5, 9};
    packer_options o = {.channel_count = 1, .value = some_value};
    strcpy(o.channels[0].name, "normal");
    o.channels[0].kind = SVO_KIND_NORMAL_OCT32;
    svo_view *v = packer_make(3, codes, 3, &o);
    svo_error err = {0};
    CHECK_OK(svo_view_validate(v, NULL, &err));
    uint8_t *raw = (uint8_t *)(uintptr_t)v->channels[0].raw;
    raw[6] = 0, raw[7] = 0x80;
    refused(v, "DAG-10");
    v->channels[0].encoding = SVO_ENCODING_CONSTANT;
    CHECK_OK(svo_view_validate(v, NULL, &err));
    memcpy(v->channels[0].channel.value, "\0\x80", 2);
    refused(v, "DAG-10");
    v->channels[0].encoding = (svo_encoding)7;
    refused(v, "DAG-02");
    packer_free(v);
}
