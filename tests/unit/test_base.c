/* The foundations: result codes, sizes, limits, loops, pipeline, matrices, Morton codes, colours, normals, chunks. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "svo_alloc.h"
#include "svo_channel.h"
#include "svo_math.h"
#include "svo_morton.h"
#include "svo_stream.h"
#include "svo_task.h"
#include "test.h"

TEST(result_codes_are_distinct_and_have_exit_codes)
{
    bool seen[64] = {false};
#define CASE(name, number, exit_code, text)                  \
    CHECK(number >= 0 && number < 64 && !seen[number]);      \
    seen[number] = true;                                     \
    CHECK(exit_code >= 0 && exit_code <= 6);                 \
    CHECK_U64(svo_result_exit_code(SVO_##name), exit_code);  \
    CHECK(strcmp(svo_result_name(SVO_##name), #name) == 0);
    SVO_RESULT_MAP(CASE)
#undef CASE
    CHECK(strcmp(svo_result_text((svo_result)99), "unknown result") == 0);
}

TEST(fail_may_wrap_its_own_message)
{
    svo_error err = {0};
    svo_fail(&err, SVO_IO, "inner");
    CHECK(svo_fail(&err, SVO_IO, "outer: %s", err.message) == SVO_IO);
    CHECK(strcmp(err.message, "outer: inner") == 0);
}

TEST(sizes_do_not_wrap)
{
    size_t s;
    CHECK(!svo_mul_size(UINT64_MAX, 2, &s));
    CHECK(!svo_mul_size((uint64_t)1 << 62, 4, &s));
    CHECK(svo_mul_size(1000, 24, &s) && s == 24000);
    CHECK(svo_alloc(NULL, UINT64_MAX / 2, 8) == NULL);
}

TEST(limit_allocator_holds_its_limit)
{
    svo_limit_allocator a;
    svo_limit_allocator_init(&a, 1000, NULL);
    void *p = svo_alloc(&a.base, 600, 1);
    CHECK(p != NULL);
    CHECK(svo_alloc(&a.base, 401, 1) == NULL);
    void *q = svo_alloc(&a.base, 400, 1);
    CHECK(q != NULL);
    svo_free(&a.base, p, 600, 1);
    svo_free(&a.base, q, 400, 1);
    CHECK_U64(svo_limit_in_use(&a), 0);
    CHECK_U64(svo_limit_peak(&a), 1000);
}

TEST(buffers_grow_and_take_nothing)
{
    svo_buffer b;
    svo_buffer_init(&b, NULL);
    CHECK(svo_buffer_append(&b, NULL, 0) != NULL && b.size == 0);
    for (uint32_t i = 0; i < 1000; i++) CHECK(svo_buffer_append(&b, &i, sizeof i) != NULL);
    CHECK_U64(b.size, 4000);
    CHECK(((const uint32_t *)(const void *)b.data)[999] == 999);
    svo_buffer_free(&b);
    CHECK(b.data == NULL && b.size == 0);
}

static svo_result count_items(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    uint8_t *hits = user;
    for (uint64_t i = begin; i < end; i++) __atomic_add_fetch(&hits[i], 1, __ATOMIC_RELAXED);
    return SVO_OK;
}

static svo_result fail_from_700(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)user, (void)worker;
    return end > 700 ? svo_fail(err, SVO_INVALID_DATA, "block %llu", (unsigned long long)begin) : SVO_OK;
}

TEST(parallel_for_visits_each_item_once_and_reports_the_first_failure)
{
    static uint8_t hits[1003];
    for (uint32_t threads = 1; threads <= 7; threads += 3) {
        memset(hits, 0, sizeof hits);
        svo_error err;
        CHECK_OK(svo_parallel_for(threads, sizeof hits, 10, count_items, hits, &err));
        for (size_t i = 0; i < sizeof hits; i++) CHECK(hits[i] == 1);
        CHECK_RESULT(svo_parallel_for(threads, 1003, 10, fail_from_700, NULL, &err), SVO_INVALID_DATA);
        CHECK_MSG(strcmp(err.message, "block 700") == 0, "%s", err.message);
    }
}

typedef struct pipe_test { uint64_t made, limit, sum, next, fail_work, fail_commit; } pipe_test;
static svo_result pt_produce(void *u, void *item, bool *more, svo_error *err)
{
    (void)err;
    pipe_test *t = u;
    if (t->made == t->limit) { *more = false; return SVO_OK; }
    *(uint64_t *)item = t->made++;
    return SVO_OK;
}
static svo_result pt_work(void *u, void *item, uint32_t worker, svo_error *err)
{
    (void)worker;
    pipe_test *t = u;
    uint64_t *v = item;
    if (*v >= t->fail_work) return svo_fail(err, SVO_RUNTIME, "item %llu", (unsigned long long)*v);
    for (volatile uint64_t i = 0; i < (*v * 7919) % 500; i++) {}
    return SVO_OK;
}
static svo_result pt_commit(void *u, void *item, svo_error *err)
{
    pipe_test *t = u;
    uint64_t v = *(uint64_t *)item;
    if (v != t->next) return svo_fail(err, SVO_RUNTIME, "out of order");
    t->next++;
    t->sum += v;
    if (v >= t->fail_commit) return svo_fail(err, SVO_IO, "commit %llu", (unsigned long long)v);
    return SVO_OK;
}

TEST(pipeline_commits_in_order_and_stops_at_the_first_failure)
{
    for (uint32_t threads = 1; threads <= 7; threads += 3) {
        svo_error err;
        pipe_test t = {.limit = 2000, .fail_work = UINT64_MAX, .fail_commit = UINT64_MAX};
        svo_pipeline p = {.threads = threads, .item_size = 8, .user = &t, .produce = pt_produce, .work = pt_work, .commit = pt_commit};
        CHECK_OK(svo_pipeline_run(&p, &err));
        CHECK_U64(t.sum, 1999u * 2000u / 2);
        pipe_test f = {.limit = 2000, .fail_work = 77, .fail_commit = UINT64_MAX};
        p.user = &f;
        CHECK_RESULT(svo_pipeline_run(&p, &err), SVO_RUNTIME);
        CHECK_MSG(strcmp(err.message, "item 77") == 0, "%s", err.message);
        CHECK_U64(f.next, 77);
        pipe_test g = {.limit = 2000, .fail_work = UINT64_MAX, .fail_commit = 500};
        p.user = &g;
        CHECK_RESULT(svo_pipeline_run(&p, &err), SVO_IO);
        CHECK_U64(g.next, 501);
    }
}

static void count_beside(void *user) { *(uint32_t *)user += 1; }

/* A loop in a loop, so that some threads that wait for work are taken while others work. */
static svo_result count_nested(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    for (uint64_t i = begin; i < end; i++) SVO_TRY(svo_parallel_for(3, 64, 1, count_items, (uint8_t *)user + 64 * i, err));
    return SVO_OK;
}

TEST(threads_that_stay_do_each_piece_of_work_once)
{
    svo_error err;
    for (uint32_t round = 0; round < 200; round++) {
        static uint8_t hits[16 * 64];
        memset(hits, 0, sizeof hits);
        uint32_t beside = 0;
        svo_async *b = svo_async_start(count_beside, &beside);
        CHECK_OK(svo_parallel_for(4, 16, 1, count_nested, hits, &err));
        svo_async_wait(b);
        svo_async_wait(b);
        CHECK_U64(beside, 1);
        svo_async_free(b);
        for (uint32_t i = 0; i < sizeof hits; i++) CHECK(hits[i] == 1);
    }
    svo_async_wait(NULL);
    svo_async_free(NULL);
}

#if !defined(__SANITIZE_THREAD__)
TEST(a_child_process_has_threads_of_its_own)
{
    svo_error err;
    uint8_t hits[1003] = {0};
    CHECK_OK(svo_parallel_for(4, sizeof hits, 10, count_items, hits, &err)); /* now some wait */
    const pid_t child = fork();
    if (child == 0) _exit(svo_parallel_for(4, sizeof hits, 10, count_items, hits, &err) == SVO_OK && hits[0] == 2 && hits[1002] == 2 ? 0 : 1);
    CHECK(child > 0);
    int status = -1;
    CHECK(waitpid(child, &status, 0) == child);
    CHECK(status == 0);
}
#endif

TEST(morton_round_trip_and_order)
{
    uint64_t state = 1;
    for (int i = 0; i < 100000; i++) {
        uint32_t x = (uint32_t)test_random(&state) & 0x1fffff, y = (uint32_t)test_random(&state) & 0x1fffff,
                 z = (uint32_t)test_random(&state) & 0x1fffff, a, b, c;
        uint64_t code = svo_morton_encode(x, y, z);
        svo_morton_decode(code, &a, &b, &c);
        CHECK(a == x && b == y && c == z && code >> 63 == 0);
        uint64_t slow = 0;
        for (int k = 0; k < 21; k++)
            slow |= (uint64_t)(x >> k & 1) << 3 * k | (uint64_t)(y >> k & 1) << (3 * k + 1) | (uint64_t)(z >> k & 1) << (3 * k + 2);
        CHECK(slow == code);
    }
}

TEST(srgb_matches_its_definition)
{
    for (int i = 0; i < 256; i++) {
        double c = i / 255.0, linear = c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4);
        CHECK(fabs(svo_srgb_to_linear((uint8_t)i) - linear) < 1e-7);
        CHECK_U64(svo_linear_to_srgb(svo_srgb_to_linear((uint8_t)i)), i);
    }
    for (int i = 0; i <= 100000; i++) {
        double l = i / 100000.0, s = l <= 0.0031308049535603713 ? 12.92 * l : 1.055 * pow(l, 1 / 2.4) - 0.055;
        double e = fabs(s * 255 - svo_linear_to_srgb((float)l));
        CHECK_MSG(e <= 0.5 + 1e-4, "%g: %g", l, e);
    }
    CHECK(svo_linear_to_srgb(NAN) == 0 && svo_linear_to_srgb(-1) == 0 && svo_linear_to_srgb(INFINITY) == 255);
}

TEST(octahedral_normals_stay_within_their_bound)
{
    uint64_t state = 5;
    double worst = 0;
    for (int i = 0; i < 200000; i++) {
        svo_vec3 v = svo_v3(test_random_unit(&state) * 2 - 1, test_random_unit(&state) * 2 - 1, test_random_unit(&state) * 2 - 1);
        if (i % 5 == 0) v.x = 0;
        if (i % 7 == 0) v.y *= 1e-6;
        v = svo_normalize(v);
        if (svo_length(v) == 0) continue;
        float n[3] = {(float)v.x, (float)v.y, (float)v.z}, d[3];
        uint8_t code[4];
        svo_oct32_encode(n, code);
        svo_oct32_decode(code, d);
        svo_vec3 c = svo_cross(v, svo_v3(d[0], d[1], d[2]));
        double angle = asin(fmin(1, svo_length(c))) * 180 / 3.14159265358979;
        if (angle > worst) worst = angle;
        CHECK(svo_dot(v, svo_v3(d[0], d[1], d[2])) > 0);
    }
    CHECK_MSG(worst < 0.004, "%g degrees", worst);
    float bad[3] = {NAN, 0, 0}, d[3];
    uint8_t code[4];
    svo_oct32_encode(bad, code);
    svo_oct32_decode(code, d);
    CHECK(d[0] == 0 && d[1] == 0 && d[2] == 1);
}

TEST(averages_by_kind)
{
    const uint8_t black[3] = {0, 0, 0}, white[3] = {255, 255, 255};
    svo_average a = {0};
    svo_average_add(&a, SVO_KIND_COLOR_SRGB8, black, 1);
    svo_average_add(&a, SVO_KIND_COLOR_SRGB8, white, 1);
    uint8_t out[8];
    svo_average_get(&a, SVO_KIND_COLOR_SRGB8, black, out);
    CHECK_U64(out[0], 188); /* half the light, not half the code */
    svo_average id = {0};
    const uint8_t one[2] = {1, 0}, two[2] = {2, 0};
    svo_average_add(&id, SVO_KIND_ID16, two, 1);
    svo_average_add(&id, SVO_KIND_ID16, one, 1);
    svo_average_get(&id, SVO_KIND_ID16, two, out);
    CHECK_U64(out[0], 1);
    svo_average n = {0};
    float up[3] = {0, 1, 0}, down[3] = {0, -1, 0};
    uint8_t u[4], d[4], fallback[4] = {1, 2, 3, 4};
    svo_oct32_encode(up, u), svo_oct32_encode(down, d);
    svo_average_add(&n, SVO_KIND_NORMAL_OCT32, u, 1);
    svo_average_add(&n, SVO_KIND_NORMAL_OCT32, d, 1);
    svo_average_get(&n, SVO_KIND_NORMAL_OCT32, fallback, out);
    CHECK(memcmp(out, fallback, 4) == 0);
}

TEST(matrices_invert_and_map_normals)
{
    uint64_t state = 9;
    for (int i = 0; i < 1000; i++) {
        double t[3], q[4], s[3];
        for (int k = 0; k < 3; k++) t[k] = test_random_unit(&state) * 20 - 10, s[k] = test_random_unit(&state) * 4 - 2;
        for (int k = 0; k < 4; k++) q[k] = test_random_unit(&state) - 0.5;
        svo_mat4 m = svo_mat4_trs(t, q, s), inverse;
        CHECK(svo_mat4_affine_inverse(&m, &inverse));
        svo_mat4 one = svo_mat4_mul(m, inverse);
        for (int k = 0; k < 16; k++) CHECK(fabs(one.m[k] - (k % 5 == 0)) < 1e-6);
        svo_vec3 a = svo_v3(1, 2, 3), b = svo_v3(-2, 1, 0.5), n = svo_cross(a, b);
        svo_vec3 mapped = svo_mat4_normal(&m, n);
        CHECK(fabs(svo_dot(mapped, svo_mat4_vector(&m, a))) < 1e-6 * svo_length(mapped));
        /* it stays on the side of the surface on which n was */
        CHECK(svo_dot(mapped, svo_mat4_vector(&m, n)) > 0);
    }
    svo_mat4 flat = svo_mat4_identity();
    flat.m[0] = 0;
    CHECK(!svo_mat4_affine_inverse(&flat, &flat));
    CHECK(svo_length(svo_normalize(svo_v3(1e300, 1e300, 0))) > 0.999 && svo_length(svo_normalize(svo_v3(1e-310, 0, 0))) > 0.999);
}

typedef struct voxel_list { uint32_t at[64][3]; uint64_t count; } voxel_list;
static bool list_voxel(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    voxel_list *l = user;
    if (index != l->count || l->count == 64) return false;
    l->at[l->count][0] = x, l->at[l->count][1] = y, l->at[l->count++][2] = z;
    return true;
}

TEST(chunk_check_accepts_good_masks_and_refuses_bad_ones)
{
    svo_error err;
    svo_tree_info info = {.depth = 2};
    uint8_t masks[] = {0x81, 0x01, 0xff};
    svo_chunk c = {.depth = 2, .node_count = 3, .value_count = 9, .masks = masks};
    svo_tree_counts counts = {0};
    CHECK_OK(svo_chunk_check(&info, &c, &counts, &err));
    CHECK(counts.nodes[0] == 1 && counts.nodes[1] == 2 && counts.nodes[2] == 9);
    voxel_list l = {0};
    svo_chunk_voxels(&c, list_voxel, &l);
    CHECK(l.count == 9 && l.at[0][0] == 0 && l.at[8][0] == 3 && l.at[8][2] == 3 && l.at[1][0] == 2 && l.at[1][1] == 2);
    svo_chunk bad = c;
    bad.node_count = 2;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    bad = c, bad.value_count = 8;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    bad = c, bad.code = 1;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    uint8_t more[] = {0x81, 0x01, 0xff, 0x01};
    bad = c, bad.masks = more, bad.node_count = 4;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    masks[0] = 0;
    CHECK_RESULT(svo_chunk_check(&info, &c, NULL, &err), SVO_INVALID_DATA);
}

static bool list_value(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    voxel_list *l = user;
    if (index != l->count) return false;
    l->at[l->count][0] = low[0] + 100 * size, l->at[l->count][1] = low[1], l->at[l->count++][2] = low[2];
    return true;
}

TEST(full_leaves_have_one_value_each)
{
    svo_error err;
    svo_tree_info info = {.depth = 2};
    uint8_t masks[] = {0x83, 0x00, 0x01, 0x00};
    svo_chunk c = {.depth = 2, .node_count = 4, .value_count = 3, .masks = masks};
    svo_tree_counts counts = {0};
    CHECK_OK(svo_chunk_check(&info, &c, &counts, &err));
    CHECK(counts.nodes[0] == 1 && counts.nodes[1] == 3 && counts.nodes[2] == 17 && counts.full_leaves == 2 && counts.values == 3 && counts.chunks == 1);
    voxel_list l = {0};
    CHECK(svo_chunk_values(&c, list_value, &l));
    CHECK(l.count == 3 && l.at[0][0] == 200 && l.at[1][0] == 102 && l.at[2][0] == 202 && l.at[2][1] == 2 && l.at[2][2] == 2);
    svo_chunk bad = c;
    bad.value_count = 17;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    bad = c, bad.node_count = 3;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    bad = c, bad.node_count = 0, bad.value_count = 1; /* the root itself */
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    /* above the cut */
    info.depth = 21;
    svo_chunk top = {.depth = 21, .level = 1, .code = 5, .value_count = 1};
    counts = (svo_tree_counts){0};
    CHECK_OK(svo_chunk_check(&info, &top, &counts, &err));
    CHECK(counts.nodes[1] == 1 && counts.nodes[21] == (uint64_t)1 << 60 && counts.chunks == 0 && counts.values == 1);
    CHECK(svo_chunk_first(&top) == (uint64_t)5 << 39 && svo_chunk_end(&top) == (uint64_t)6 << 39);
    bad = top, bad.code = 8;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    bad = top, bad.level = 0, bad.code = 0;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    bad = top, bad.level = 15;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
    bad = top, bad.masks = masks, bad.node_count = 4, bad.value_count = 3;
    CHECK_RESULT(svo_chunk_check(&info, &bad, NULL, &err), SVO_INVALID_DATA);
}

TEST(single_voxel_tree)
{
    svo_error err;
    svo_tree_info info = {.depth = 0};
    svo_chunk c = {.value_count = 1};
    svo_tree_counts counts = {0};
    CHECK_OK(svo_chunk_check(&info, &c, &counts, &err));
    CHECK(counts.nodes[0] == 1);
    voxel_list l = {0};
    svo_chunk_voxels(&c, list_voxel, &l);
    CHECK(l.count == 1);
}
