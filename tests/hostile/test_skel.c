/* Damaged .skel files are refused with a message, or what is read from them keeps every rule. */
#include "fmt_skel.h"
#include "hostile.h"
#include "rules_agree.h"
#include "skel_shapes.h"
#include "test.h"

static svo_result read_skel(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    (void)user;
    skel_skeleton s;
    char *meta;
    svo_result r = fmt_skel_read(bytes, size, a, &s, &meta, err);
    const char *differ = rules_agree(fmt_skel_violations, bytes, size, a, r, err, true);
    if (differ != NULL) test_fail(__FILE__, __LINE__, "%s", differ);
    if (r != SVO_OK) return r;
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
    /* violations that do not hang on each other are all found in one go */
    hostile_file f;
    svo_buffer bad;
    svo_buffer_init(&bad, NULL);
    hostile_parse(file.data, file.size, &f);
    CHECK(f.count >= 4 && s.joint_count > 3);
    memset(f.chunks[1].payload.data + 24, 0xff, 8);                    /* radius of joint 0 */
    f.chunks[1].payload.data[3 * 40 + 32] ^= 0x40;                     /* component of joint 3 */
    f.chunks[1].payload.data[2 * 40 + 36] = 1;                         /* reserved */
    memset(f.chunks[3].payload.data, 0xee, 4);                         /* element 0 of the map */
    memset(f.chunks[0].payload.data + 255, 1, 1);                      /* reserved */
    for (int i = 0; i < 4; i++) hostile_touch(&f.chunks[i]);
    hostile_build(&f, &bad);
    const rules_text *all = rules_all(fmt_skel_violations, bad.data, bad.size);
    static const char *const wanted[] = {"joint 0 is not finite", "joint 3 is said", "reserved bytes are not 0 (SKL-02)", "element 0 of the map"};
    for (int i = 0; i < 4; i++) CHECK_MSG(strstr(all->all, wanted[i]) != NULL, "\"%s\" is not among\n%s", wanted[i], all->all);
    hostile_free(&f);
    svo_buffer_free(&bad);
    svo_buffer_free(&file);
    skel_skeleton_free(&s);
    shape_free(&m);
}
