/* The builder against brute force: geometry against an independent packer, every attribute of every node against its
 * definition, in stored order. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "svo_color.h"
#include "svo_dag.h"
#include "svo_morton.h"
#include "test.h"
#include "trees.h"

static svo_packed *build(const tree *t, const svo_dag_options *o, svo_dag_report *report)
{
    svo_error err = {0};
    svo_dag_builder *b;
    svo_packed *p = NULL;
    if (svo_dag_builder_create(&t->info, o, &b, &err) != SVO_OK) {
        test_fail(__FILE__, __LINE__, "%s", err.message);
        return NULL;
    }
    if (tree_feed(t, o->threads, svo_dag_builder_sink(b), &err) != SVO_OK) {
        svo_dag_builder_free(b);
        test_fail(__FILE__, __LINE__, "%s", err.message);
        return NULL;
    }
    if (svo_dag_builder_finish(b, &p, report, &err) != SVO_OK) test_fail(__FILE__, __LINE__, "%s", err.message);
    return p;
}

static bool same_value(svo_channel_kind kind, const uint8_t *a, const uint8_t *b)
{
    if (kind != SVO_KIND_NORMAL_OCT32) return memcmp(a, b, svo_channel_stride(kind)) == 0;
    float x[3], y[3];
    svo_oct32_decode(a, x);
    svo_oct32_decode(b, y);
    double square = 0;
    for (int i = 0; i < 3; i++) square += ((double)x[i] - y[i]) * ((double)x[i] - y[i]);
    return sqrt(square) < 2e-4; /* 0.0115 degrees: two codes that differ by rounding */
}

static int compare_u32(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

/* Value of a node over the voxels [begin, end), by the definition. */
static void brute_value(const tree *t, uint32_t channel, uint64_t begin, uint64_t end, uint8_t *out)
{
    svo_channel_kind kind = t->info.channels[channel].kind;
    uint32_t stride = svo_channel_stride(kind);
    const uint8_t *v = t->values[channel] + begin * stride;
    if (kind == SVO_KIND_ID16 || kind == SVO_KIND_ID32) {
        uint32_t *id = calloc(end - begin, sizeof *id), best = 0;
        for (uint64_t i = 0; i < end - begin; i++) memcpy(&id[i], v + i * stride, stride);
        qsort(id, end - begin, sizeof *id, compare_u32);
        uint64_t most = 0;
        for (uint64_t i = 0, j; i < end - begin; i = j) {
            for (j = i; j < end - begin && id[j] == id[i];) j++;
            if (j - i > most) most = j - i, best = id[i];
        }
        memcpy(out, &best, stride);
        free(id);
        return;
    }
    svo_average a = {0};
    for (uint64_t i = 0; i < end - begin; i++) svo_average_add(&a, kind, v + i * stride, 1);
    svo_average_get(&a, kind, v, out);
}

/* Depth-first over the sorted voxels: checks all nodes' attributes and counts indices. */
static void check_node(const tree *t, const svo_view *v, uint32_t level, uint64_t begin, uint64_t end, uint64_t *next)
{
    const bool finest = level == v->tree_depth, average = v->averaged && level >= v->brick_level && !finest;
    if (finest || v->lod) {
        const uint64_t attribute = average ? svo_average_of(*next, (uint32_t)(end - begin)) : *next;
        for (uint32_t c = 0; c < t->info.channel_count; c++) {
            uint8_t want[SVO_MAX_STRIDE], got[SVO_MAX_STRIDE];
            svo_channel_kind kind = t->info.channels[c].kind;
            uint32_t stride = svo_channel_stride(kind);
            svo_view_attribute(v, c, attribute, got);
            if (t->info.channels[c].constant) memcpy(want, t->info.channels[c].value, stride);
            else if (end - begin == 1) memcpy(want, t->values[c] + begin * stride, stride);
            else brute_value(t, c, begin, end, want);
            bool same = end - begin == 1 ? memcmp(want, got, stride) == 0 : same_value(kind, want, got);
            CHECK_MSG(same, "depth %u level %u attribute %llu channel %u", v->depth, level, (unsigned long long)*next, c);
        }
        if (!average) (*next)++;
    }
    if (finest) {
        uint32_t x, y, z;
        uint64_t index;
        svo_morton_decode(t->codes[begin], &x, &y, &z);
        CHECK(svo_view_voxel(v, x, y, z, &index));
        CHECK_U64(index, v->unnumbered ? 0 : *next - 1);
        return;
    }
    uint32_t shift = 3 * (v->tree_depth - 1 - level);
    for (uint64_t i = begin, j; i < end && !test_failed(); i = j) {
        for (j = i + 1; j < end && t->codes[j] >> shift == t->codes[i] >> shift;) j++;
        check_node(t, v, level + 1, i, j, next);
    }
}

typedef struct walk { const tree *t; uint64_t at; bool same; } walk;

static bool walk_voxel(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    walk *w = user;
    (void)index;
    w->same = w->same && w->at < w->t->count && w->t->codes[w->at] == svo_morton_encode(x, y, z);
    w->at++;
    return w->same;
}

static void check_view(const tree *t, const svo_view *v)
{
    svo_error err = {0};
    CHECK_OK(svo_view_validate(v, NULL, &err));
    walk w = {t, 0, true};
    CHECK(svo_view_voxels(v, walk_voxel, &w) && w.same);
    CHECK_U64(w.at, t->count);
    uint64_t next = 0;
    if (t->count != 0) check_node(t, v, 0, 0, t->count, &next);
    CHECK_U64(next, v->attribute_count);
}

/* Numbers follow first appearance in both, so even the arrays are equal. */
static void check_geometry(const tree *t, const svo_view *v)
{
    packer_options o = {.lod = v->lod, .averaged = v->averaged, .unnumbered = v->unnumbered, .share = true};
    svo_view *p = packer_make(t->info.depth, t->codes, t->count, &o);
    CHECK_U64(p->attribute_count, v->attribute_count);
    CHECK_U64(p->root, v->root);
    CHECK(p->empty == v->empty);
    CHECK_U64(p->brick_count, v->brick_count);
    CHECK(v->brick_count == 0 || memcmp(p->bricks, v->bricks, 8 * v->brick_count) == 0);
    CHECK(memcmp(p->nodes, v->nodes, sizeof v->nodes) == 0);
    for (uint32_t l = 0; l < v->brick_level; l++) {
        CHECK_U64(p->levels[l].node_count, v->levels[l].node_count);
        CHECK_U64(p->levels[l].word_count, v->levels[l].word_count);
        CHECK(v->empty || memcmp(p->levels[l].words, v->levels[l].words, 4 * v->levels[l].word_count) == 0);
    }
    packer_free(p);
}

TEST(every_node_at_every_depth)
{
    static const uint32_t depths[] = {0, 1, 2, 3, 4, 6, 7, 8, 9, 12, 21};
    uint64_t seed = 1;
    for (uint32_t style = 0; style < TREE_STYLES; style++)
        for (size_t d = 0; d < sizeof depths / sizeof depths[0]; d++)
            for (int lod = 0; lod < 3; lod++) { /* 2: averaged */
                tree t;
                tree_random(&t, depths[d], style, &seed);
                svo_dag_options o = svo_default_dag_options();
                o.geometry = SVO_GEOMETRY_SVDAG; /* whose arrays are compared below; test_fast compares the layouts */
                o.lod = lod != 0;
                o.averaged = lod == 2;
                o.threads = 2;
                svo_dag_report report;
                svo_packed *p = build(&t, &o, &report);
                if (p == NULL) return;
                check_view(&t, svo_packed_view(p));
                check_geometry(&t, svo_packed_view(p));
                CHECK_U64(report.counts.nodes[depths[d]], t.count);
                svo_packed_free(p);
                tree_free(&t);
                if (test_failed()) return;
            }
}

/* Few different values, so that averages, palettes and majorities meet ties. */
TEST(few_values)
{
    uint64_t seed = 2;
    for (uint32_t depth = 0; depth <= 10; depth += 2)
        for (uint32_t different = 1; different <= 5; different++) {
            tree t;
            tree_random(&t, depth, 1, &seed);
            for (uint32_t c = 0; c < t.info.channel_count; c++) {
                uint32_t stride = svo_channel_stride(t.info.channels[c].kind);
                for (uint64_t i = 0; i < t.count; i++)
                    memset(t.values[c] + i * stride, (int)(test_random(&seed) % different) * 40, stride);
            }
            svo_dag_options o = svo_default_dag_options();
            svo_dag_report report;
            svo_packed *p = build(&t, &o, &report);
            if (p == NULL) return;
            check_view(&t, svo_packed_view(p));
            for (uint32_t c = 0; c < t.info.channel_count && different == 1; c++) {
                CHECK(report.channels[c].left_out && report.channels[c].bytes == 0);
                CHECK(svo_packed_view(p)->channels[c].encoding == SVO_ENCODING_CONSTANT);
            }
            svo_packed_free(p);
            tree_free(&t);
            if (test_failed()) return;
        }
}

TEST(solid_checkerboard_and_empty)
{
    for (uint32_t depth = 0; depth <= 5; depth++)
        for (int board = 0; board < 3; board++) { /* 2: empty */
            uint64_t seed = 3;
            tree t;
            tree_full(&t, depth, &seed);
            uint64_t n = 0;
            for (uint64_t i = 0; i < t.count; i++) {
                uint32_t x, y, z;
                svo_morton_decode(t.codes[i], &x, &y, &z);
                if (board == 0 || (board == 1 && (x + y + z) % 2 == 0)) {
                    t.codes[n] = t.codes[i];
                    memmove(t.values[0] + 3 * n, t.values[0] + 3 * i, 3);
                    n++;
                }
            }
            t.count = n;
            svo_dag_options o = svo_default_dag_options();
            o.geometry = SVO_GEOMETRY_SVDAG; /* whose arrays are compared below; test_fast compares the layouts */
            svo_packed *p = build(&t, &o, NULL);
            if (p == NULL) return;
            const svo_view *v = svo_packed_view(p);
            check_view(&t, v);
            check_geometry(&t, v);
            CHECK_U64(v->brick_count, n != 0);
            for (uint32_t l = 0; l < v->brick_level; l++) CHECK_U64(v->levels[l].node_count, n != 0);
            svo_packed_free(p);
            tree_free(&t);
            if (test_failed()) return;
        }
}

/* A solid block without attributes of depth 9: 64 equal chunks; offsets stay in 32 bits. Compared to the packer's. */
static svo_result solid_chunks(svo_dag_builder *b, uint32_t depth, uint64_t chunks, uint64_t *seed, svo_error *err)
{
    uint32_t levels = depth - svo_chunk_level(depth);
    uint64_t masks = 0, voxels = (uint64_t)1 << 3 * levels;
    for (uint32_t l = 0; l < levels; l++) masks += (uint64_t)1 << 3 * l;
    uint8_t *mask = malloc(masks);
    memset(mask, 0xff, masks);
    svo_chunk_sink s = svo_dag_builder_sink(b);
    svo_result r = SVO_OK;
    (void)seed;
    for (uint64_t i = 0; i < chunks && r == SVO_OK; i++) {
        svo_chunk c = {.code = i, .level = svo_chunk_level(depth), .depth = depth, .node_count = masks, .value_count = voxels, .masks = mask};
        void *blob;
        r = s.encode(s.user, &c, 0, &blob, err);
        if (r == SVO_OK) r = s.commit(s.user, blob, err);
    }
    free(mask);
    return r;
}

TEST(solid_block_of_many_chunks)
{
    svo_error err = {0};
    svo_tree_info info = {.depth = 9, .voxel_to_world = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
    for (int lod = 0; lod < 2; lod++) {
        svo_dag_options o = {.geometry = SVO_GEOMETRY_SVDAG, .lod = lod != 0};
        svo_dag_builder *b;
        svo_packed *p;
        CHECK_OK(svo_dag_builder_create(&info, &o, &b, &err));
        CHECK_OK(solid_chunks(b, 9, 64, NULL, &err));
        CHECK_OK(svo_dag_builder_finish(b, &p, NULL, &err));
        const svo_view *v = svo_packed_view(p);
        CHECK_OK(svo_view_validate(v, NULL, &err));
        svo_view *want = packer_solid(9, o.lod);
        CHECK_U64(v->attribute_count, want->attribute_count);
        CHECK(memcmp(v->nodes, want->nodes, sizeof v->nodes) == 0);
        for (uint32_t l = 0; l < v->brick_level; l++) {
            CHECK_U64(v->levels[l].node_count, 1);
            CHECK_U64(v->levels[l].offset_words, 0); /* no channel */
        }
        packer_free(want);
        svo_packed_free(p);
    }
}

static bool same_bytes(const void *a, const void *b, uint64_t n) { return n == 0 || memcmp(a, b, n) == 0; }

static void check_same(const svo_view *a, const svo_view *b)
{
    CHECK_U64(a->root, b->root);
    for (uint32_t l = 0; l < a->brick_level; l++) {
        CHECK_U64(a->levels[l].word_count, b->levels[l].word_count);
        CHECK(same_bytes(a->levels[l].words, b->levels[l].words, 4 * a->levels[l].word_count));
    }
    CHECK_U64(a->brick_count, b->brick_count);
    CHECK(a->averaged == b->averaged);
    CHECK(same_bytes(a->bricks, b->bricks, 8 * a->brick_count));
    for (uint32_t c = 0; c < a->channel_count; c++) {
        const svo_view_channel *x = &a->channels[c], *y = &b->channels[c];
        CHECK(x->encoding == y->encoding && x->table_count == y->table_count && x->payload_size == y->payload_size);
        uint32_t stride = svo_channel_stride(x->channel.kind);
        CHECK(x->correction_count == y->correction_count && same_bytes(x->corrections, y->corrections, SVO_CORRECTION * x->correction_count));
        if (x->encoding == SVO_ENCODING_RAW) CHECK(same_bytes(x->raw, y->raw, a->attribute_count * stride));
        if (x->encoding != SVO_ENCODING_BLOCKS) continue;
        CHECK(same_bytes(x->table, y->table, x->table_count * stride));
        CHECK(same_bytes(x->directory, y->directory, SVO_PALETTE_ENTRY * x->superblock_count));
        CHECK(same_bytes(x->payload, y->payload, x->payload_size));
    }
}

typedef struct bounded { const svo_view *exact, *view; uint32_t channel; double bound, worst; uint64_t beyond; } bounded;

static bool within(void *user, uint64_t attribute)
{
    bounded *b = user;
    uint8_t x[SVO_MAX_STRIDE], y[SVO_MAX_STRIDE];
    float p[3], q[3];
    svo_view plain = *b->view; /* as it would be read without corrections */
    plain.channels[b->channel].correction_count = 0;
    svo_view_attribute(b->exact, b->channel, attribute, x);
    for (int k = 0; k < 2; k++) {
        double error;
        svo_view_attribute(k == 0 ? b->view : &plain, b->channel, attribute, y);
        if (b->view->channels[b->channel].channel.kind == SVO_KIND_COLOR_SRGB8) {
            svo_srgb8_to_lab(x, p), svo_srgb8_to_lab(y, q);
            error = svo_delta_e94(p, q);
        } else {
            svo_oct32_decode(x, p), svo_oct32_decode(y, q);
            double s = 0;
            for (int i = 0; i < 3; i++) s += ((double)p[i] - q[i]) * ((double)p[i] - q[i]);
            error = 2 * asin(fmin(1, sqrt(s) / 2)) * 57.29577951308232;
        }
        if (k == 0 && error > b->worst) b->worst = error;
        if (k == 1 && error > b->bound * (1 + 1e-5)) b->beyond++;
    }
    return true;
}

/* Averages of values within a bound need not be within it: those that are not are stored, and no others. */
TEST(averages_are_within_the_bound)
{
    static const svo_geometry geometries[] = {SVO_GEOMETRY_SVDAG, SVO_GEOMETRY_FAST, SVO_GEOMETRY_BEST};
    uint64_t seed = 6, corrected = 0;
    for (uint32_t depth = 2; depth <= 8; depth += 2)
        for (int g = 0; g < 3; g++) {
            tree t;
            tree_random(&t, depth, 1, &seed);
            svo_dag_options o = svo_default_dag_options();
            o.geometry = geometries[g];
            svo_packed *exact = build(&t, &o, NULL);
            o.color_delta_e = 12, o.normal_degrees = 20;
            svo_dag_report report;
            svo_packed *p = build(&t, &o, &report);
            if (exact == NULL || p == NULL) return;
            const svo_view *v = svo_packed_view(p);
            for (uint32_t c = 0; c < v->channel_count && !test_failed(); c++) {
                const svo_channel_kind kind = v->channels[c].channel.kind;
                if (v->channels[c].channel.constant || (kind != SVO_KIND_COLOR_SRGB8 && kind != SVO_KIND_NORMAL_OCT32)) continue;
                bounded b = {svo_packed_view(exact), v, c, kind == SVO_KIND_COLOR_SRGB8 ? 12 : 20, 0, 0};
                CHECK(svo_view_averages(v, 0, svo_view_root(v), within, &b));
                CHECK_MSG(b.worst <= b.bound * (1 + 1e-5), "depth %u channel %u: %g", depth, c, b.worst);
                CHECK_U64(b.beyond, v->channels[c].correction_count);
                CHECK_U64(report.channels[c].corrections, v->channels[c].correction_count);
                CHECK(report.channels[c].error_max <= b.bound && report.channels[c].error_max >= b.worst * (1 - 1e-5));
                corrected += b.beyond;
            }
            svo_error err = {0};
            CHECK_OK(svo_view_validate(v, NULL, &err));
            svo_packed_free(p);
            svo_packed_free(exact);
            tree_free(&t);
            if (test_failed()) return;
        }
    CHECK_MSG(corrected > 0, "%llu corrections are no test", (unsigned long long)corrected);
}

TEST(threads_do_not_show)
{
    uint64_t seed = 4;
    static const uint32_t depths[] = {6, 9, 14};
    for (int d = 0; d < 3; d++) {
        tree t;
        tree_random(&t, depths[d], 1, &seed);
        svo_dag_options o = svo_default_dag_options();
        o.threads = 1;
        if (d == 1) o.color_delta_e = 12, o.normal_degrees = 20; /* with corrections */
        svo_packed *one = build(&t, &o, NULL);
        if (one == NULL) return;
        for (uint32_t threads = 2; threads <= 7; threads += 5) {
            o.threads = threads;
            svo_packed *p = build(&t, &o, NULL);
            if (p == NULL) return;
            check_same(svo_packed_view(one), svo_packed_view(p));
            svo_packed_free(p);
            if (test_failed()) return;
        }
        svo_packed_free(one);
        tree_free(&t);
    }
}

/* Each allocation fails once: a clean error, nothing left (the sanitizer watches), and no result. */
TEST(out_of_memory_everywhere)
{
    uint64_t seed = 5;
    tree t;
    tree_random(&t, 9, 1, &seed);
    t.count = 300;
    bool done = false;
    for (uint64_t n = 1; !done; n += 1 + n / 8) {
        svo_limit_allocator limit;
        svo_limit_allocator_init(&limit, UINT64_MAX, NULL);
        limit.fail_at = n;
        svo_dag_options o = {.lod = true, .threads = 1, .allocator = &limit.base};
        svo_error err = {0};
        svo_dag_builder *b;
        svo_packed *p;
        svo_result r = svo_dag_builder_create(&t.info, &o, &b, &err);
        if (r == SVO_OK) {
            r = tree_feed(&t, 1, svo_dag_builder_sink(b), &err);
            if (r != SVO_OK) svo_dag_builder_free(b);
            else if ((r = svo_dag_builder_finish(b, &p, NULL, &err)) == SVO_OK) {
                svo_packed_free(p);
                done = true;
            }
        }
        CHECK_MSG(r == SVO_OK || r == SVO_OUT_OF_MEMORY, "allocation %llu: %s", (unsigned long long)n, err.message);
        CHECK_U64(svo_limit_in_use(&limit), 0);
    }
    tree_free(&t);
}

TEST(memory_limit)
{
    uint64_t seed = 6;
    tree t;
    tree_random(&t, 9, 1, &seed);
    svo_dag_options o = {.lod = true, .threads = 1, .memory = 100000};
    svo_error err = {0};
    svo_dag_builder *b;
    svo_packed *p;
    CHECK_OK(svo_dag_builder_create(&t.info, &o, &b, &err));
    svo_result r = tree_feed(&t, 1, svo_dag_builder_sink(b), &err);
    if (r == SVO_OK) r = svo_dag_builder_finish(b, &p, NULL, &err);
    else svo_dag_builder_free(b);
    CHECK_RESULT(r, SVO_LIMIT);
    tree_free(&t);
}

TEST(chunks_out_of_order)
{
    uint64_t seed = 7;
    tree t;
    tree_random(&t, 12, 0, &seed);
    svo_error err = {0};
    svo_dag_options o = svo_default_dag_options();
    svo_dag_builder *b;
    CHECK_OK(svo_dag_builder_create(&t.info, &o, &b, &err));
    svo_chunk_sink s = svo_dag_builder_sink(b);
    svo_buffer masks;
    svo_buffer_init(&masks, NULL);
    svo_chunk c;
    tree_chunk(&t, 0, &masks, &c);
    void *one, *two;
    CHECK_OK(s.encode(s.user, &c, 0, &one, &err));
    CHECK_OK(s.encode(s.user, &c, 0, &two, &err));
    CHECK_OK(s.commit(s.user, one, &err));
    CHECK_RESULT(s.commit(s.user, two, &err), SVO_INVALID_DATA);
    svo_dag_builder_free(b);
    svo_buffer_free(&masks);
    tree_free(&t);
}
