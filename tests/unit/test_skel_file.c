/* .skel round trips, refusal of what breaks a rule, and the exported curves read back. */
#include <stdio.h>
#include <stdlib.h>

#include "fmt_skel.h"
#include "skel_shapes.h"
#include "test.h"

static svo_error err;

static svo_result build(const shape *m, double omega, skel_skeleton *s)
{
    skel_options o = skel_default_options();
    o.omega = omega;
    o.threads = 1;
    return shape_skeleton(m, &o, s, &err);
}

static void write(const skel_skeleton *s, const char *meta, svo_buffer *to)
{
    fmt_output *out;
    CHECK_OK(fmt_output_open_memory(to, &out, &err));
    CHECK_OK(fmt_skel_write(out, s, meta, &err));
    CHECK_OK(fmt_output_commit(out, &err));
}

static void round_trip(const skel_skeleton *s)
{
    svo_buffer a, b;
    svo_buffer_init(&a, NULL);
    svo_buffer_init(&b, NULL);
    write(s, "{\"tool\":\"test\"}", &a);
    if (test_failed()) return;
    skel_skeleton t;
    char *meta;
    CHECK_OK(fmt_skel_read(a.data, a.size, NULL, &t, &meta, &err));
    CHECK(strcmp(meta, "{\"tool\":\"test\"}") == 0);
    CHECK_U64(t.joint_count, s->joint_count);
    CHECK_U64(t.bone_count, s->bone_count);
    CHECK_U64(t.map_count, s->map_count);
    for (uint32_t j = 0; j < s->joint_count; j++) {
        for (int k = 0; k < 3; k++) CHECK(t.joints[j].position[k] == s->joints[j].position[k]);
        CHECK(t.joints[j].radius == s->joints[j].radius && t.joints[j].component == s->joints[j].component);
    }
    CHECK(s->bone_count == 0 || memcmp(s->bones, t.bones, s->bone_count * sizeof *s->bones) == 0);
    CHECK(memcmp(s->map, t.map, s->map_count * sizeof *s->map) == 0);
    const skel_report *x = &s->report, *y = &t.report;
    CHECK(x->converged == y->converged && x->omega == y->omega && x->unit == y->unit && x->iterations == y->iterations && x->ends == y->ends &&
          x->thinness_error == y->thinness_error && x->reconstruction_max == y->reconstruction_max && x->mapped_count == y->mapped_count &&
          x->tessellated_triangles == y->tessellated_triangles && x->voxel_depth == y->voxel_depth && x->centre[2] == y->centre[2]);
    write(&t, meta, &b);
    CHECK_U64(a.size, b.size);
    CHECK(memcmp(a.data, b.data, a.size) == 0);
    fmt_meta_free(NULL, meta);
    skel_skeleton_free(&t);
    svo_buffer_free(&a);
    svo_buffer_free(&b);
}

TEST(round_trips)
{
    shape m[3] = {shape_star(2, 0.18, 40, 12), shape_torus(1, 0.2, 40, 12), {0}};
    for (int k = 0; k < 3; k++) shape_point(&m[2], 1, 2, 3);
    shape_triangle(&m[2], 0, 1, 2); /* one joint, no bones */
    shape_point(&m[0], NAN, 0, 0);
    for (int i = 0; i < 3; i++) {
        skel_skeleton s;
        CHECK_OK(build(&m[i], 0.04, &s));
        round_trip(&s);
        skel_skeleton_free(&s);
        shape_free(&m[i]);
    }
}

TEST(rules_are_kept_by_the_writer)
{
    shape m = shape_star(2, 0.18, 40, 12);
    skel_skeleton s;
    CHECK_OK(build(&m, 0.04, &s));
    svo_buffer b;
    svo_buffer_init(&b, NULL);
    fmt_output *out;
    CHECK_OK(fmt_output_open_memory(&b, &out, &err));
    skel_bone bone = s.bones[1];
    s.bones[1] = s.bones[0];
    CHECK_RESULT(fmt_skel_write(out, &s, NULL, &err), SVO_INVALID_ARGUMENT);
    s.bones[1] = bone;
    s.joints[2].radius = NAN;
    CHECK_RESULT(fmt_skel_write(out, &s, NULL, &err), SVO_INVALID_ARGUMENT);
    s.joints[2].radius = 0;
    uint32_t to = s.map[5];
    s.map[5] = s.joint_count;
    CHECK_RESULT(fmt_skel_write(out, &s, NULL, &err), SVO_INVALID_ARGUMENT);
    s.map[5] = SVO_NONE;
    CHECK_RESULT(fmt_skel_write(out, &s, NULL, &err), SVO_INVALID_ARGUMENT);
    s.map[5] = to;
    s.report.loops++;
    CHECK_RESULT(fmt_skel_write(out, &s, NULL, &err), SVO_INVALID_ARGUMENT);
    s.report.loops--;
    s.joints[1].component++;
    CHECK_RESULT(fmt_skel_write(out, &s, NULL, &err), SVO_INVALID_ARGUMENT);
    s.joints[1].component--;
    CHECK_OK(fmt_skel_write(out, &s, NULL, &err));
    fmt_output_discard(out);
    svo_buffer_free(&b);
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(obj)
{
    shape m = shape_star(2, 0.18, 40, 12);
    skel_skeleton s;
    CHECK_OK(build(&m, 0.04, &s));
    svo_buffer b;
    svo_buffer_init(&b, NULL);
    fmt_output *out;
    CHECK_OK(fmt_output_open_memory(&b, &out, &err));
    CHECK_OK(fmt_export_skel_obj(out, &s, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    svo_buffer_append(&b, "", 1);
    uint32_t joints = 0, bones = 0;
    for (char *line = strtok((char *)b.data, "\n"); line != NULL; line = strtok(NULL, "\n")) {
        double x, y, z;
        unsigned p, q;
        if (sscanf(line, "v %lf %lf %lf", &x, &y, &z) == 3) {
            CHECK(x == s.joints[joints].position[0] && y == s.joints[joints].position[1] && z == s.joints[joints].position[2]);
            joints++;
        } else if (sscanf(line, "l %u %u", &p, &q) == 2) {
            CHECK(p == s.bones[bones].a + 1 && q == s.bones[bones].b + 1);
            bones++;
        } else {
            CHECK(line[0] == '#');
        }
    }
    CHECK_U64(joints, s.joint_count);
    CHECK_U64(bones, s.bone_count);
    svo_buffer_free(&b);
    skel_skeleton_free(&s);
    shape_free(&m);
}

/* Number after "key": in text, from `from` on. */
static double number(const char *text, const char *from, const char *key)
{
    char quoted[64];
    snprintf(quoted, sizeof quoted, "\"%s\":", key);
    const char *start = from != NULL ? strstr(text, from) : text, *at = start != NULL ? strstr(start, quoted) : NULL;
    return at != NULL ? strtod(at + strlen(quoted) + (at[strlen(quoted)] == '['), NULL) : NAN;
}

static void glb(double shift)
{
    shape m = shape_star(2, 0.18, 40, 12);
    for (uint64_t i = 0; i < 3 * m.points; i++) m.p[i] += shift;
    skel_skeleton s;
    CHECK_OK(build(&m, 0.04, &s));
    svo_buffer b;
    svo_buffer_init(&b, NULL);
    fmt_output *out;
    CHECK_OK(fmt_output_open_memory(&b, &out, &err));
    CHECK_OK(fmt_export_skel_glb(out, &s, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    CHECK(memcmp(b.data, "glTF\2\0\0\0", 8) == 0);
    CHECK_U64(fmt_load32(b.data + 8), b.size);
    uint32_t json = fmt_load32(b.data + 12);
    CHECK(json % 4 == 0 && memcmp(b.data + 16, "JSON", 4) == 0 && memcmp(b.data + 24 + json, "BIN\0", 4) == 0);
    CHECK_U64(fmt_load32(b.data + 20 + json) + json + 28, b.size);
    char *text = calloc(json + 1, 1);
    memcpy(text, b.data + 20, json);
    double middle[3];
    middle[0] = number(text, NULL, "translation");
    CHECK(fabs(middle[0] - shift) < 2);
    CHECK(number(text, "primitives", "mode") == 1);
    CHECK(number(text, "accessors", "count") == s.joint_count);
    CHECK(strstr(text, "\"mode\":0") == NULL);
    const uint8_t *bin = b.data + 28 + json;
    for (uint32_t j = 0; j < s.joint_count; j++) {
        uint32_t bits = fmt_load32(bin + 12 * j);
        float x;
        memcpy(&x, &bits, 4);
        CHECK_MSG(fabs(middle[0] + x - s.joints[j].position[0]) < 4e-7 + 4e-16 * fabs(shift), "joint %u: %.17g", j, middle[0] + x);
    }
    for (uint32_t i = 0; i < s.bone_count; i++) {
        const uint8_t *p = bin + 12 * s.joint_count + 8 * i;
        CHECK(fmt_load32(p) == s.bones[i].a && fmt_load32(p + 4) == s.bones[i].b);
    }
    free(text);
    svo_buffer_free(&b);
    skel_skeleton_free(&s);
    shape_free(&m);
}
TEST(glb_near) { glb(0); }
TEST(glb_far) { glb(1e6); }
