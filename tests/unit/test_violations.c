/* A packed octree with several violations at once: each of them is named, not the first alone. */
#include <stdlib.h>
#include <string.h>

#include "rules_agree.h"
#include "svo_dag.h"
#include "test.h"
#include "trees.h"

static void build(const tree *t, svo_geometry geometry, svo_packed **p)
{
    svo_error err = {0};
    svo_dag_builder *b;
    *p = NULL;
    svo_dag_options o = svo_default_dag_options();
    o.geometry = geometry, o.lod = true, o.threads = 1;
    CHECK_OK(svo_dag_builder_create(&t->info, &o, &b, &err));
    CHECK_OK(tree_feed(t, 1, svo_dag_builder_sink(b), &err));
    CHECK_OK(svo_dag_builder_finish(b, p, NULL, &err));
}

static void list(const svo_view *v, rules_text *t)
{
    svo_rules rules = {rules_append, t, 0};
    svo_error err = {0};
    t->all[0] = 0, t->used = 0, t->count = 0;
    svo_result r = svo_view_violations(v, NULL, UINT64_MAX, &rules, &err);
    CHECK(r == SVO_OK && rules.count == t->count);
}

/* Bits of the geometry that break one rule each, of those that hide no other: sizes, skips and turns. Then all of them together. */
static void all_in_one_go(svo_geometry geometry, uint8_t *(*bytes)(const svo_view *), uint64_t bits, svo_packed *p)
{
    enum { MOST = 24 };
    const svo_view *v = svo_packed_view(p);
    static rules_text text, all;
    static char said[MOST][240];
    uint64_t flipped[MOST], seed = 77;
    uint32_t found = 0, sizes = 0;
    uint8_t *b = bytes(v);
    list(v, &text);
    CHECK_U64(text.count, 0);
    for (uint64_t tries = 0; tries < 20000 && found < MOST && !test_failed(); tries++) {
        uint64_t i = test_random(&seed) % bits;
        b[i / 8] ^= (uint8_t)(1 << i % 8);
        list(v, &text);
        b[i / 8] ^= (uint8_t)(1 << i % 8);
        bool alone = text.count == 1 && text.used < sizeof said[0];
        if (!alone || (strncmp(text.all, "DAG-06: level", 13) != 0 && strncmp(text.all, "DAG-16", 6) != 0 && strncmp(text.all, "DAG-19", 6) != 0)) continue;
        bool known = false;
        for (uint32_t k = 0; k < found; k++) known = known || strcmp(said[k], text.all) == 0;
        bool size = text.all[5] == '6' && text.all[4] == '0';
        if (known || (size ? sizes : found - sizes) == MOST / 2) continue;
        memcpy(said[found], text.all, text.used + 1);
        sizes += size;
        flipped[found++] = i;
    }
    CHECK_MSG(found >= 8 && sizes != 0 && sizes != found, "geometry %d: only %u bits that break one rule, %u of them sizes", (int)geometry, found, sizes);
    for (uint32_t k = 0; k < found; k++) b[flipped[k] / 8] ^= (uint8_t)(1 << flipped[k] % 8);
    list(v, &all);
    for (uint32_t k = 0; k < found; k++) CHECK_MSG(strstr(all.all, said[k]) != NULL, "geometry %d: \"%s\" is not among\n%s", (int)geometry, said[k], all.all);
    CHECK_U64(all.count, found);
}

static uint8_t *bytes_of_fast(const svo_view *v) { return (uint8_t *)(uintptr_t)v->fast.tree; }
static uint8_t *bytes_of_best(const svo_view *v) { return (uint8_t *)(uintptr_t)v->best_stream; }

TEST(all_violations_of_layout_2)
{
    uint64_t seed = 21;
    tree t;
    tree_random(&t, 8, 1, &seed);
    svo_packed *p;
    build(&t, SVO_GEOMETRY_FAST, &p);
    if (p != NULL) all_in_one_go(SVO_GEOMETRY_FAST, bytes_of_fast, 8 * svo_packed_view(p)->fast.tree_bytes, p);
    svo_packed_free(p);
    tree_free(&t);
}

TEST(all_violations_of_layout_3)
{
    uint64_t seed = 22;
    tree t;
    tree_random(&t, 8, 1, &seed);
    svo_packed *p;
    build(&t, SVO_GEOMETRY_BEST, &p);
    if (p != NULL) all_in_one_go(SVO_GEOMETRY_BEST, bytes_of_best, 8 * svo_packed_view(p)->best_stream_bytes, p);
    svo_packed_free(p);
    tree_free(&t);
}

/* A pool whose nodes cannot be told apart does not hide what is wrong in others: an empty mask in the one, a wrong skip above. */
TEST(broken_pool_hides_no_other)
{
    uint64_t seed = 23;
    tree t;
    tree_random(&t, 8, 1, &seed);
    svo_packed *p;
    build(&t, SVO_GEOMETRY_FAST, &p);
    tree_free(&t);
    if (p == NULL) return;
    static rules_text text;
    static char said[sizeof text.all];
    const svo_view *v = svo_packed_view(p);
    uint8_t *b = bytes_of_fast(v);
    const svo_view_fast_level *low = NULL;
    for (uint32_t l = v->brick_level; l-- > 1 && low == NULL;)
        if (v->fast.level[l].pool_count > 1) low = &v->fast.level[l];
    CHECK(low != NULL && low->begin > 0);
    if (low == NULL) return;
    bool found = false;
    for (uint64_t tries = 0; tries < 6000 && !found; tries++) {
        uint64_t i = test_random(&seed) % low->begin;
        b[i / 8] ^= (uint8_t)(1 << i % 8);
        list(v, &text);
        found = text.count == 1 && strncmp(text.all, "DAG-19", 6) == 0;
        if (!found) b[i / 8] ^= (uint8_t)(1 << i % 8);
    }
    CHECK(found);
    memcpy(said, text.all, text.used + 1);
    b[low->begin / 8] = 0;
    list(v, &text);
    CHECK_MSG(text.count == 2 && strstr(text.all, "DAG-04") != NULL && strstr(text.all, said) != NULL, "\"%s\" and an empty mask are not\n%s", said, text.all);
    svo_packed_free(p);
}
