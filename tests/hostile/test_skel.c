/* Damaged .skel files are refused with a message, or what is read from them keeps every rule. */
#include "fmt_skel.h"
#include "hostile.h"
#include "skel_shapes.h"
#include "test.h"

static svo_result read_skel(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    (void)user;
    skel_skeleton s;
    char *meta;
    SVO_TRY(fmt_skel_read(bytes, size, a, &s, &meta, err));
    /* Rules once more, independently of skel_check. */
    uint64_t mapped = 0;
    for (uint64_t i = 0; i < s.map_count; i++) {
        if (s.map[i] != SVO_NONE && s.map[i] >= s.joint_count) test_fail(__FILE__, __LINE__, "map out of range accepted");
        mapped += s.map[i] != SVO_NONE;
    }
    if (mapped != s.report.mapped_count) test_fail(__FILE__, __LINE__, "a wrong count of the map accepted");
    for (uint32_t b = 0; b < s.bone_count; b++) {
        if (s.bones[b].a >= s.bones[b].b || s.bones[b].b >= s.joint_count) test_fail(__FILE__, __LINE__, "a bad bone accepted");
        else if (s.joints[s.bones[b].a].component != s.joints[s.bones[b].b].component) test_fail(__FILE__, __LINE__, "a bone between components accepted");
        if (b > 0 && memcmp(&s.bones[b], &s.bones[b - 1], sizeof *s.bones) == 0) test_fail(__FILE__, __LINE__, "a double bone accepted");
    }
    for (uint32_t j = 0; j < s.joint_count; j++) {
        const skel_joint *q = &s.joints[j];
        if (!isfinite(q->position[0] + q->position[1] + q->position[2]) || !(q->radius >= 0) || q->component >= s.report.components)
            test_fail(__FILE__, __LINE__, "a bad joint accepted");
    }
    if (s.report.loops != s.bone_count + s.report.components - s.joint_count) test_fail(__FILE__, __LINE__, "a wrong number of loops accepted");
    skel_component *c = malloc((size_t)s.report.components * sizeof *c);
    skel_components(&s, c);
    free(c);
    fmt_meta_free(a, meta);
    skel_skeleton_free(&s);
    return SVO_OK;
}

TEST(damaged)
{
    svo_error err = {0};
    shape m = shape_star(2, 0.18, 20, 8);
    for (int k = 0; k < 3; k++) shape_point(&m, 9, 9, 9 + 0.01 * k);
    shape_point(&m, NAN, 0, 0);
    shape_triangle(&m, (uint32_t)m.points - 4, (uint32_t)m.points - 3, (uint32_t)m.points - 2);
    skel_options o = skel_default_options();
    o.omega = 0.05;
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    CHECK(s.report.components >= 2);
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    fmt_output *out;
    CHECK_OK(fmt_output_open_memory(&file, &out, &err));
    CHECK_OK(fmt_skel_write(out, &s, "{\"tool\":\"test\"}", &err));
    CHECK_OK(fmt_output_commit(out, &err));
    hostile_case c = {.read = read_skel, .bytes = file.data, .size = file.size, .rounds = 1500, .seed = 77};
    hostile_run(&c);
    svo_buffer_free(&file);
    skel_skeleton_free(&s);
    shape_free(&m);
}
