/* The bone of a point against brute force, and octrees with a bone channel: what they keep, what they gain, for any number of threads. */
#include "fmt_svo.h"
#include "skel_bind.h"
#include "skel_shapes.h"
#include "svo_morton.h"
#include "test.h"
#include "trees.h"

static svo_error err;

static void star(skel_skeleton *s)
{
    shape m = shape_star(1.5, 0.2, 40, 14);
    skel_options o = skel_default_options();
    o.omega = 0.05;
    o.search = SKEL_SEARCH_GRID;
    o.threads = 1;
    o.keep_samples = true;
    CHECK_OK(shape_skeleton(&m, &o, s, &err));
    shape_free(&m);
}

static double segment(const double *p, const double *a, const double *b)
{
    double t = 0, l = 0, d = 0;
    for (int k = 0; k < 3; k++) {
        t += (b[k] - a[k]) * (p[k] - a[k]);
        l += (b[k] - a[k]) * (b[k] - a[k]);
    }
    t = l > 0 ? fmin(1, fmax(0, t / l)) : 0;
    for (int k = 0; k < 3; k++) d += (p[k] - a[k] - t * (b[k] - a[k])) * (p[k] - a[k] - t * (b[k] - a[k]));
    return sqrt(d);
}

/* Joint of the nearest sample, by looking at all; then the nearest of its bones. */
static double brute(const skel_skeleton *s, const double *p, uint32_t *joint, double *bone_distance)
{
    double best = INFINITY;
    for (uint64_t i = 0; i < s->sample_count; i++) {
        const double *q = s->samples + 3 * i;
        double d = (p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) + (p[2] - q[2]) * (p[2] - q[2]);
        if (d >= best) continue;
        best = d;
        *joint = s->sample_joint[i];
    }
    *bone_distance = INFINITY;
    for (uint32_t b = 0; b < s->bone_count; b++)
        if (s->bones[b].a == *joint || s->bones[b].b == *joint)
            *bone_distance = fmin(*bone_distance, segment(p, s->joints[s->bones[b].a].position, s->joints[s->bones[b].b].position));
    return sqrt(best);
}

TEST(bone_of_a_point_equals_brute_force)
{
    skel_skeleton s;
    star(&s);
    CHECK(s.sample_count == s.report.tessellated_vertices);
    skel_binder *b;
    CHECK_OK(skel_binder_create(&s, NULL, &b, &err));
    uint64_t seed = 7;
    for (int i = 0; i < 20000; i++) {
        double p[3], distance, bone_distance;
        uint32_t joint = 0;
        for (int k = 0; k < 3; k++) p[k] = (double)(test_random(&seed) % 1000001) / 1e6 * (i % 10 == 0 ? 40 : 4) - (i % 10 == 0 ? 20 : 2);
        if (i % 5 == 0) memcpy(p, s.samples + 3 * (test_random(&seed) % s.sample_count), sizeof p); /* exactly on a sample */
        uint32_t bone = skel_binder_bone(b, p, &distance);
        double want = brute(&s, p, &joint, &bone_distance);
        CHECK(distance == want);
        CHECK(bone < s.bone_count && (s.bones[bone].a == joint || s.bones[bone].b == joint));
        double got = segment(p, s.joints[s.bones[bone].a].position, s.joints[s.bones[bone].b].position);
        CHECK(fabs(got - bone_distance) <= 1e-12 * (1 + got));
    }
    skel_binder_free(b);
    skel_skeleton_free(&s);
}

TEST(needs_samples)
{
    skel_skeleton s;
    star(&s);
    svo_free(s.allocator, s.samples, 3 * s.sample_count, sizeof *s.samples);
    svo_free(s.allocator, s.sample_joint, s.sample_count, sizeof *s.sample_joint);
    s.samples = NULL;
    s.sample_joint = NULL;
    s.sample_count = 0;
    skel_binder *b;
    CHECK_U64(skel_binder_create(&s, NULL, &b, &err), SVO_INVALID_ARGUMENT);
    skel_skeleton_free(&s);
}

/* A file in memory to a bound file in memory. */
static svo_result bind(const skel_skeleton *s, const svo_buffer *file, uint32_t threads, const svo_allocator *a, svo_buffer *out, skel_bind_report *report)
{
    fmt_input *in = NULL;
    fmt_output *to = NULL;
    fmt_svo_reader *reader = NULL;
    fmt_svo_writer *writer = NULL;
    skel_binder *b = NULL;
    svo_tree_info info;
    svo_result r = fmt_input_open_memory(file->data, file->size, &in, &err);
    if (r == SVO_OK) r = fmt_svo_reader_open(in, a, &reader, &err);
    if (r == SVO_OK) r = fmt_output_open_memory(out, &to, &err);
    if (r == SVO_OK) r = skel_bind_info(s, fmt_svo_reader_info(reader), &info, &err);
    if (r == SVO_OK) r = skel_binder_create(s, a, &b, &err);
    if (r == SVO_OK) r = fmt_svo_writer_begin(to, &info, NULL, 1, a, &writer, &err);
    if (r == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(reader);
        svo_chunk_sink sink = fmt_svo_writer_sink(writer);
        r = skel_bind_octree(b, fmt_svo_reader_info(reader), &source, &info, &sink, threads, a, report, &err);
    }
    if (r == SVO_OK) {
        r = fmt_svo_writer_end(writer, NULL, &err);
        writer = NULL;
    }
    if (r == SVO_OK) {
        r = fmt_output_commit(to, &err);
        to = NULL;
    }
    fmt_svo_writer_discard(writer);
    fmt_output_discard(to);
    skel_binder_free(b);
    if (reader != NULL) fmt_svo_reader_close(reader);
    if (in != NULL) fmt_input_close(in);
    return r;
}

/* Random octrees with every kind of channel: voxels and other channels stay as they are, the last channel holds the bone of each voxel's centre. */
TEST(octrees)
{
    skel_skeleton s;
    star(&s);
    skel_binder *b;
    CHECK_OK(skel_binder_create(&s, NULL, &b, &err));
    uint64_t seed = 3;
    for (uint32_t i = 0; i < 12; i++) {
        tree t;
        tree_random(&t, i, i % TREE_STYLES, &seed);
        for (int k = 0; k < 3; k++) {
            t.info.voxel_to_world[5 * k] = 3.2 / ldexp(1, (int)i);
            t.info.voxel_to_world[4 * k + 3] = -1.6;
        }
        svo_buffer file, bound[3];
        svo_buffer_init(&file, NULL);
        tree_write(&t, 1, &file, NULL);
        for (uint32_t n = 0; n < 3; n++) {
            skel_bind_report report;
            svo_buffer_init(&bound[n], NULL);
            CHECK_OK(bind(&s, &file, n == 2 ? 7 : n + 1, NULL, &bound[n], &report));
            CHECK_U64(report.counts.values, t.count);
            CHECK(bound[n].size == bound[0].size && memcmp(bound[n].data, bound[0].data, bound[0].size) == 0);
        }
        /* the tree with the channel, computed here */
        tree want = t;
        CHECK_OK(skel_bind_info(&s, &t.info, &want.info, &err));
        uint32_t last = want.info.channel_count - 1;
        CHECK_U64(want.info.channels[last].kind, SVO_KIND_ID16);
        uint8_t *bones = malloc(2 * t.count + 1);
        for (uint64_t v = 0; v < t.count; v++) {
            uint32_t x[3];
            double p[3];
            svo_morton_decode(t.codes[v], &x[0], &x[1], &x[2]);
            const double *m = t.info.voxel_to_world;
            for (int k = 0; k < 3; k++) p[k] = m[4 * k] * (x[0] + 0.5) + m[4 * k + 1] * (x[1] + 0.5) + m[4 * k + 2] * (x[2] + 0.5) + m[4 * k + 3];
            uint32_t bone = skel_binder_bone(b, p, NULL);
            bones[2 * v] = (uint8_t)bone;
            bones[2 * v + 1] = (uint8_t)(bone >> 8);
        }
        want.values[last] = bones;
        for (int again = 0; again < 2; again++) { /* binding what is bound replaces the channel */
            fmt_input *in;
            fmt_svo_reader *r;
            svo_buffer twice;
            svo_buffer_init(&twice, NULL);
            if (again) CHECK_OK(bind(&s, &bound[0], 2, NULL, &twice, NULL));
            CHECK_OK(fmt_input_open_memory(again ? twice.data : bound[0].data, again ? twice.size : bound[0].size, &in, &err));
            CHECK_OK(fmt_svo_reader_open(in, NULL, &r, &err));
            tree_check(&want, fmt_svo_reader_info(r), fmt_svo_reader_source(r));
            fmt_svo_reader_close(r);
            fmt_input_close(in);
            svo_buffer_free(&twice);
        }
        free(bones);
        svo_buffer_free(&file);
        for (uint32_t n = 0; n < 3; n++) svo_buffer_free(&bound[n]);
        tree_free(&t);
    }
    skel_binder_free(b);
    skel_skeleton_free(&s);
}

TEST(too_many_channels)
{
    skel_skeleton s = {.bone_count = 70000};
    svo_tree_info from = {.channel_count = SVO_MAX_CHANNELS}, to;
    for (uint32_t i = 0; i < SVO_MAX_CHANNELS; i++) from.channels[i] = (svo_channel){.name = {'a', (char)('a' + i)}, .kind = SVO_KIND_UNORM8};
    CHECK_U64(skel_bind_info(&s, &from, &to, &err), SVO_LIMIT);
    memcpy(from.channels[3].name, "bone", 5);
    CHECK_OK(skel_bind_info(&s, &from, &to, &err));
    CHECK_U64(to.channel_count, SVO_MAX_CHANNELS);
    CHECK_U64(to.channels[SVO_MAX_CHANNELS - 1].kind, SVO_KIND_ID32);
}

TEST(out_of_memory)
{
    skel_skeleton s;
    star(&s);
    tree t;
    uint64_t seed = 1;
    tree_random(&t, 5, 1, &seed);
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    tree_write(&t, 1, &file, NULL);
    for (uint64_t n = 1;; n++) {
        svo_limit_allocator a;
        svo_buffer out;
        skel_bind_report report;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = n;
        svo_buffer_init(&out, NULL);
        svo_result r = bind(&s, &file, 1, &a.base, &out, &report);
        svo_buffer_free(&out);
        CHECK_U64(svo_limit_in_use(&a), 0);
        if (r == SVO_OK) break;
        CHECK_U64(r, SVO_OUT_OF_MEMORY);
    }
    svo_buffer_free(&file);
    tree_free(&t);
    skel_skeleton_free(&s);
}
