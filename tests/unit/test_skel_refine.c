/* Refinement of chosen bones: what is not chosen stays as it is, bit for bit; what is made anew is joined to it, with the same components and loops, and nearer to the surface. */
#include <stdio.h>

#include "fmt_import.h"
#include "skel_shapes.h"
#include "skel_skin.h"
#include "test.h"

static svo_error err;

static void parse_fails(const char *text, const char *says)
{
    skel_refine *list;
    uint32_t n;
    svo_error e = {0};
    CHECK_U64(skel_refine_parse(text, NULL, &list, &n, &e), SVO_INVALID_ARGUMENT);
    CHECK(strstr(e.message, says) != NULL);
}

TEST(text_is_read)
{
    skel_refine *list;
    uint32_t n;
    CHECK_OK(skel_refine_parse("3,7-12@0.01;ends@0.02;box:-1,-2,-3,4e0,5,6@4;ball:1,2,3,.5@0.5;thin:0.05@1e-2", NULL, &list, &n, &err));
    CHECK_U64(n, 5);
    CHECK(list[0].select == SKEL_SELECT_BONES && list[0].range_count == 2 && list[0].omega == 0.01);
    CHECK(list[0].range[0] == 3 && list[0].range[1] == 3 && list[0].range[2] == 7 && list[0].range[3] == 12);
    CHECK(list[1].select == SKEL_SELECT_ENDS && list[1].omega == 0.02);
    CHECK(list[2].select == SKEL_SELECT_BOX && list[2].where[1] == -2 && list[2].where[5] == 6 && list[2].omega == 4);
    CHECK(list[3].select == SKEL_SELECT_BALL && list[3].where[3] == 0.5);
    CHECK(list[4].select == SKEL_SELECT_THIN && list[4].where[0] == 0.05 && list[4].omega == 0.01);
    skel_refine_free(NULL, list, n);
    parse_fails("", "@");
    parse_fails("ends", "@");
    parse_fails("ends@", "no number");
    parse_fails("ends@0.01x", "no number");
    parse_fails("ends@0", "0.0001");
    parse_fails("ends@nan", "no number");
    parse_fails("ends@0.01;", "@");
    parse_fails("@0.01", "selects nothing");
    parse_fails("tips@0.01", "selects nothing");
    parse_fails("7-3@0.01", "selects nothing");
    parse_fails("1,,2@0.01", "selects nothing");
    parse_fails("99999999999@0.01", "selects nothing");
    parse_fails("box:1,2,3@0.01", "box:X0");
    parse_fails("ball:1,2,3,0@0.01", "ball:X");
    parse_fails("thin:-1@0.01", "thin:R");
}

/* --- helpers --------------------------------------------------------------------------------------------------------- */

typedef struct pair { skel_skeleton base, fine; skel_refine *list; uint32_t count; } pair;

static skel_options plain(double omega)
{
    skel_options o = skel_default_options();
    o.omega = omega;
    o.search = SKEL_SEARCH_GRID;
    o.threads = 1;
    return o;
}

static void refine(const svo_mesh *mesh, double omega, const char *text, pair *p)
{
    skel_options o = plain(omega);
    CHECK_OK(skel_build_mesh(mesh, &o, &p->base, &err));
    CHECK_OK(skel_refine_parse(text, NULL, &p->list, &p->count, &err));
    o.refine = p->list;
    o.refine_count = p->count;
    CHECK_OK(skel_build_mesh(mesh, &o, &p->fine, &err));
    CHECK_OK(skel_check(&p->fine, &err));
}

static void done(pair *p)
{
    skel_skeleton_free(&p->base);
    skel_skeleton_free(&p->fine);
    skel_refine_free(NULL, p->list, p->count);
}

typedef struct one_shape { svo_part part; svo_shape sh; svo_instance in; svo_mesh mesh; } one_shape;

static svo_mesh *mesh_of(const shape *s, one_shape *m)
{
    m->part = (svo_part){.material = SVO_NONE, .vertex_count = s->points, .triangle_count = s->triangles, .positions = s->p, .indices = s->t};
    m->sh = (svo_shape){.part_count = 1, .parts = &m->part};
    m->in = (svo_instance){.transform = svo_mat4_identity()};
    m->mesh = (svo_mesh){.shape_count = 1, .instance_count = 1, .shapes = &m->sh, .instances = &m->in};
    return &m->mesh;
}

/* The joint of b at the place of joint j of a, or SVO_NONE. */
static uint32_t same_place(const skel_skeleton *a, uint32_t j, const skel_skeleton *b)
{
    for (uint32_t i = 0; i < b->joint_count; i++)
        if (memcmp(a->joints[j].position, b->joints[i].position, sizeof a->joints[j].position) == 0) return i;
    return SVO_NONE;
}

static bool has_bone(const skel_skeleton *s, uint32_t a, uint32_t b)
{
    for (uint32_t i = 0; i < s->bone_count; i++)
        if ((s->bones[i].a == a && s->bones[i].b == b) || (s->bones[i].a == b && s->bones[i].b == a)) return true;
    return false;
}

/* Everything that holds for a refinement of the bones that `chosen` takes. */
static void check_pair(const pair *p, bool (*chosen)(const skel_skeleton *s, uint32_t bone))
{
    const skel_skeleton *s = &p->base, *f = &p->fine;
    uint32_t *to = malloc(s->joint_count * sizeof *to), kept = 0;
    uint8_t *out = calloc(s->joint_count, 1), *in = calloc(s->joint_count, 1); /* has bones that are not chosen, that are */
    uint32_t selected = 0;
    for (uint32_t b = 0; b < s->bone_count; b++) {
        bool c = chosen(s, b);
        selected += c;
        (c ? in : out)[s->bones[b].a] = (c ? in : out)[s->bones[b].b] = 1;
    }
    CHECK_U64(p->list[0].result.bones, selected);
    for (uint32_t j = 0; j < s->joint_count; j++) {
        to[j] = same_place(s, j, f);
        if (out[j] == 0 && in[j] != 0) continue;
        kept++;
        CHECK(to[j] != SVO_NONE);
        if (in[j] == 0 && to[j] != SVO_NONE) CHECK(memcmp(&s->joints[j].radius, &f->joints[to[j]].radius, sizeof(double)) == 0);
    }
    CHECK_U64(s->joint_count - kept, p->list[0].result.joints_removed);
    CHECK_U64(f->joint_count - kept, p->list[0].result.joints_added);
    for (uint32_t b = 0; b < s->bone_count; b++)
        if (!chosen(s, b)) CHECK(has_bone(f, to[s->bones[b].a], to[s->bones[b].b]));
    for (uint32_t i = 0; i < f->joint_count; i++) /* no joint twice */
        for (uint32_t j = 0; j < i; j++) CHECK(memcmp(f->joints[i].position, f->joints[j].position, sizeof f->joints[i].position) != 0);
    CHECK_U64(f->map_count, s->map_count);
    uint64_t moved = 0;
    for (uint64_t v = 0; v < s->map_count; v++) {
        CHECK((s->map[v] == SVO_NONE) == (f->map[v] == SVO_NONE));
        if (s->map[v] == SVO_NONE || in[s->map[v]] != 0) continue;
        moved += to[s->map[v]] != f->map[v];
    }
    CHECK_U64(moved, 0); /* surface of joints that the selection does not touch */
    CHECK_U64(f->report.components, s->report.components);
    CHECK_U64(f->report.loops, s->report.loops);
    CHECK(p->list[0].result.converged);
    free(to);
    free(in);
    free(out);
}

static double middle(const skel_skeleton *s, uint32_t bone, int k) { return 0.5 * (s->joints[s->bones[bone].a].position[k] + s->joints[s->bones[bone].b].position[k]); }
static bool right_half(const skel_skeleton *s, uint32_t bone) { return middle(s, bone, 0) >= 0; }
static bool far_right(const skel_skeleton *s, uint32_t bone) { return middle(s, bone, 0) >= 1; }
static bool every_bone(const skel_skeleton *s, uint32_t bone) { return (void)s, (void)bone, true; }

/* --- shapes ---------------------------------------------------------------------------------------------------------- */

TEST(one_arm_of_a_star)
{
    shape s = shape_star(4, 0.3, 60, 16);
    one_shape m;
    pair p;
    refine(mesh_of(&s, &m), 0.08, "box:1,-9,-9,9,9,9@0.02", &p);
    check_pair(&p, far_right);
    CHECK(p.list[0].result.joints_added > p.list[0].result.joints_removed);
    CHECK_U64(p.fine.report.ends, 3);
    CHECK_U64(p.fine.report.branches, 1);
    for (uint32_t j = 0; j < p.fine.joint_count; j++) { /* the new joints lie on the arm's axis too */
        const double *q = p.fine.joints[j].position;
        if (q[0] > 1) CHECK(hypot(q[1], q[2]) < 0.06);
    }
    done(&p);
    shape_free(&s);
}

TEST(half_of_a_ring_stays_a_ring)
{
    shape s = shape_torus(2, 0.3, 96, 16);
    one_shape m;
    pair p;
    refine(mesh_of(&s, &m), 0.1, "box:0,-9,-9,9,9,9@0.03", &p);
    CHECK_U64(p.base.report.loops, 1);
    check_pair(&p, right_half);
    done(&p);
    refine(mesh_of(&s, &m), 0.03, "box:0,-9,-9,9,9,9@0.1", &p); /* and the other way round: fewer joints */
    check_pair(&p, right_half);
    CHECK(p.list[0].result.joints_added < p.list[0].result.joints_removed);
    done(&p);
    refine(mesh_of(&s, &m), 0.1, "box:-9,-9,-9,9,9,9@0.03", &p); /* all of it: as if made so at once */
    check_pair(&p, every_bone);
    skel_options o = plain(0.03);
    skel_skeleton k;
    CHECK_OK(skel_build_mesh(&m.mesh, &o, &k, &err));
    CHECK(shape_curves_apart(&p.fine, &k) < 0.02);
    skel_skeleton_free(&k);
    done(&p);
    shape_free(&s);
}

TEST(all_but_one_bone_of_a_ring)
{
    shape s = shape_torus(2, 0.3, 96, 16);
    one_shape m;
    skel_options o = plain(0.1);
    skel_skeleton k;
    CHECK_OK(skel_build_mesh(mesh_of(&s, &m), &o, &k, &err));
    char text[64];
    snprintf(text, sizeof text, "1-%u@0.05", k.bone_count - 1);
    skel_skeleton_free(&k);
    pair p;
    refine(&m.mesh, 0.1, text, &p);
    CHECK_U64(p.fine.report.loops, 1);
    CHECK_U64(p.fine.report.components, 1);
    CHECK_U64(p.fine.report.ends, 0);
    done(&p);
    shape_free(&s);
}

TEST(parts_that_were_merged_stay_together)
{ /* four thin tubes side by side, nearer than omega, each open by a triangle (closed parts stay apart): one curve; each alone at the finer omega */
    shape s = {0};
    for (int i = 0; i < 4; i++) {
        shape t = shape_tube(4, 0.05, 80, 8);
        uint32_t base = (uint32_t)s.points;
        for (uint64_t v = 0; v < t.points; v++) shape_point(&s, t.p[3 * v], t.p[3 * v + 1] + 0.15 * (i & 1), t.p[3 * v + 2] + 0.15 * (i >> 1));
        for (uint64_t v = 0; v + 1 < t.triangles; v++) shape_triangle(&s, base + t.t[3 * v], base + t.t[3 * v + 1], base + t.t[3 * v + 2]);
        shape_free(&t);
    }
    one_shape m;
    pair p;
    refine(mesh_of(&s, &m), 0.12, "box:1,-9,-9,9,9,9@0.02", &p);
    check_pair(&p, far_right);
    CHECK(p.fine.report.ends > p.base.report.ends);
    CHECK(p.list[0].result.error_after < p.list[0].result.error_before);
    done(&p);
    shape_free(&s);
}

TEST(several_refinements)
{
    shape s = shape_star(4, 0.3, 60, 16);
    one_shape m;
    pair a, b, c;
    refine(mesh_of(&s, &m), 0.08, "box:1,-9,-9,9,9,9@0.02;box:-9,1,-9,0,9,9@0.04", &a);
    refine(&m.mesh, 0.08, "box:1,-9,-9,9,9,9@0.02", &b);
    refine(&m.mesh, 0.08, "box:-9,1,-9,0,9,9@0.04", &c);
    CHECK(a.list[0].result.bones > 0 && a.list[1].result.bones > 0);
    CHECK_U64(a.list[1].result.bones, c.list[0].result.bones);
    for (uint32_t j = 0; j < a.fine.joint_count; j++) /* the second one leaves what the first one made, but for what is joined to its own */
        if (a.fine.joints[j].position[0] > 1) CHECK(same_place(&a.fine, j, &b.fine) != SVO_NONE);
    CHECK(a.list[1].result.joints_added > a.list[1].result.joints_removed);
    CHECK_U64(a.fine.report.components, 1);
    CHECK_U64(a.fine.report.ends, 3);
    done(&a);
    done(&b);
    done(&c);
    refine(&m.mesh, 0.08, "0-2@0.02;0-2@0.04", &a); /* a bone that two select is the first one's */
    CHECK_U64(a.list[0].result.bones, 3);
    CHECK_U64(a.list[1].result.bones, 0);
    done(&a);
    shape_free(&s);
}

TEST(bones_that_are_not_there)
{
    shape s = shape_tube(4, 0.3, 60, 16);
    one_shape m;
    skel_options o = plain(0.08);
    skel_skeleton k;
    CHECK_OK(skel_refine_parse("0-999@0.02", NULL, &o.refine, &o.refine_count, &err));
    CHECK_U64(skel_build_mesh(mesh_of(&s, &m), &o, &k, &err), SVO_INVALID_ARGUMENT);
    CHECK(strstr(err.message, "no bone 999") != NULL);
    o.refine[0].omega = 0;
    CHECK_U64(skel_build_mesh(&m.mesh, &o, &k, &err), SVO_INVALID_ARGUMENT);
    skel_refine_free(NULL, o.refine, o.refine_count);
    shape_free(&s);
}

/* --- real models ------------------------------------------------------------------------------------------------------ */

static bool load(const char *file, svo_mesh *mesh)
{
    const char *path = test_model(file);
    const fmt_import_options o = {.skip_images = true};
    if (path == NULL) test_skip("%s is not there", file);
    return path != NULL && fmt_import_mesh(path, &o, mesh, &err) == SVO_OK;
}

static void check_real(const char *file, const char *text)
{
    svo_mesh mesh = {0};
    if (!load(file, &mesh)) return;
    pair p;
    refine(&mesh, 0.03, text, &p);
    CHECK(p.list[0].result.bones > 0);
    CHECK_U64(p.fine.report.components, p.base.report.components);
    CHECK_U64(p.fine.report.loops, p.base.report.loops);
    CHECK(p.list[0].result.error_after < p.list[0].result.error_before);

    CHECK_MSG(p.fine.report.reconstruction_mean < p.base.report.reconstruction_mean, "%g after %g", p.fine.report.reconstruction_mean, p.base.report.reconstruction_mean);
    /* the same for any number of threads */
    skel_options o = plain(0.03);
    skel_skeleton again;
    o.threads = 3;
    o.refine = p.list;
    o.refine_count = p.count;
    CHECK_OK(skel_build_mesh(&mesh, &o, &again, &err));
    CHECK(again.joint_count == p.fine.joint_count && memcmp(again.joints, p.fine.joints, again.joint_count * sizeof *again.joints) == 0);
    CHECK(again.map_count == p.fine.map_count && memcmp(again.map, p.fine.map, again.map_count * sizeof *again.map) == 0);
    skel_skeleton_free(&again);
    /* weights follow */
    skel_tree tree;
    skel_skin skin;
    const skel_skin_options w = {.influences = 4, .smoothing = 2};
    CHECK_OK(skel_tree_make(&p.fine, NULL, &tree, &err));
    CHECK_OK(skel_skin_make(&mesh, &p.fine, &tree, &w, &skin, &err));
    for (uint64_t v = 0; v < skin.count; v++) {
        double sum = 0;
        for (uint32_t k = 0; k < 4; k++) sum += skin.weight[4 * v + k];
        CHECK(fabs(sum - 1) <= 1e-6);
    }
    skel_skin_free(&skin);
    skel_tree_free(&tree);
    done(&p);
    svo_mesh_free(&mesh);
}

TEST(limbs_of_an_armadillo) { check_real("A_organic/armadillo/armadillo.obj", "ends@0.015"); }
TEST(fingers_of_a_hand) { check_real("A_organic/hand_closed/hand_closed.obj", "thin:0.06@0.015"); }
TEST(thin_parts_of_fertility) { check_real("A_organic/fertility/fertility.off", "thin:0.06@0.0125"); }
