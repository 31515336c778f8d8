/* What is measured of a curve, on shapes where the figures are known; and that curves are in the middle of what they are curves of. */
#include "skel_shapes.h"
#include "test.h"

static svo_error err;

static svo_result measure(const shape *s, const double (*p)[3], uint32_t joints, bool closed, skel_quality *q)
{
    svo_part part = {.material = SVO_NONE, .vertex_count = s->points, .triangle_count = s->triangles, .positions = s->p, .indices = s->t};
    svo_shape sh = {.part_count = 1, .parts = &part};
    svo_instance in = {.transform = svo_mat4_identity()};
    svo_mesh mesh = {.shape_count = 1, .instance_count = 1, .shapes = &sh, .instances = &in};
    skel_joint joint[256] = {0};
    skel_bone bone[256] = {0};
    for (uint32_t j = 0; j < joints; j++) {
        memcpy(joint[j].position, p[j], sizeof p[j]);
        bone[j] = (skel_bone){j, j + 1};
    }
    if (closed) bone[joints - 1] = (skel_bone){0, joints - 1};
    skel_skeleton k = {.joint_count = joints, .joints = joint, .bone_count = joints - !closed, .bones = bone};
    return skel_measure_quality(&mesh, &k, 1, NULL, q, &err);
}

/* A line beside the axis of a tube. */
TEST(line_in_a_tube)
{
    shape m = shape_tube(4, 0.25, 80, 64);
    for (int i = 0; i <= 4; i++) {
        double e = 0.25 * i / 5;
        const double p[2][3] = {{0.25, e, 0}, {3.75, e, 0}};
        skel_quality q;
        CHECK_OK(measure(&m, p, 2, false, &q));
        CHECK(q.measured && q.genus_known && q.genus == 0 && q.surface_components == 1 && q.surface_closed == 1);
        CHECK(q.length_inside == 100 && q.joints_inside == 100 && q.outside_max == 0);
        double mean = 0; /* the rays' first harmonic is e / 2 for any e, their mean length an elliptic integral */
        for (int k = 0; k < 360; k++) mean += sqrt(0.25 * 0.25 - e * e * sin(SHAPE_TAU * k / 360) * sin(SHAPE_TAU * k / 360)) / 360;
        CHECK_MSG(fabs(q.off_centre_median - e / mean) < 0.01, "%g for %g", q.off_centre_median, e / mean);
        double diagonal = sqrt(16 + 0.25 + 0.25);
        if (i == 0) CHECK_MSG(q.balls_mean < 0.5, "%g", q.balls_mean); /* all but the rims of the flat ends */
        CHECK(q.balls_max <= 100 * (0.25 * sqrt(2) + 2 * e) / diagonal);
    }
    shape_free(&m);
}

TEST(line_that_leaves_a_tube)
{
    shape m = shape_tube(4, 0.25, 80, 64);
    skel_quality q;
    const double half[2][3] = {{2, 0, 0}, {6, 0, 0}}, beside[2][3] = {{0, 0, 1}, {4, 0, 1}};
    CHECK_OK(measure(&m, half, 2, false, &q));
    CHECK_MSG(fabs(q.length_inside - 50) < 1, "%g", q.length_inside);
    CHECK(q.joints_inside == 50);
    CHECK_MSG(fabs(q.outside_max - 200 / sqrt(16.5)) < 1, "%g", q.outside_max);
    CHECK_OK(measure(&m, beside, 2, false, &q));
    CHECK(q.length_inside == 0 && q.joints_inside == 0 && q.off_centre_median == 0);
    CHECK_MSG(fabs(q.outside_max - 75 / sqrt(16.5)) < 0.5, "%g", q.outside_max);
    shape_free(&m);
}

TEST(distance_of_two_curves)
{
    skel_joint p[3] = {{.position = {0, 0, 0}}, {.position = {4, 0, 0}}, {.position = {4, 3, 0}}}, q[2] = {{.position = {0, 1, 0}}, {.position = {4, 1, 0}}};
    skel_bone two[2] = {{0, 1}, {1, 2}};
    skel_skeleton a = {.joint_count = 3, .joints = p, .bone_count = 2, .bones = two}, b = {.joint_count = 2, .joints = q, .bone_count = 1, .bones = two};
    a.report.unit = b.report.unit = 4;
    skel_distance d;
    skel_curve_distance(&a, &b, &d);
    CHECK(fabs(d.max[0] - 2) < 1e-12 && fabs(d.max[1] - 1) < 1e-12);
    CHECK_MSG(fabs(d.mean[0] - (4 + 0.5 + 2) / 7) < 1e-3, "%g", d.mean[0]); /* 4 at 1; then 1 down to 0 and 0 up to 2 */
    CHECK_MSG(fabs(d.mean[1] - 3.5 / 4) < 1e-3, "%g", d.mean[1]);           /* 3 at 1; then 1 down to 0 */
    a.bone_count = 0; /* joints alone */
    a.report.isolated = 3;
    skel_curve_distance(&a, &b, &d);
    CHECK(fabs(d.mean[0] - 4.0 / 3) < 1e-12 && fabs(d.max[0] - 2) < 1e-12);
}

TEST(genus)
{
    skel_quality q;
    const double p[1][3] = {{0, 0, 0}};
    shape m = shape_torus(1, 0.2, 40, 12), t = shape_torus(1, 0.2, 30, 10);
    CHECK_OK(measure(&m, p, 1, false, &q));
    CHECK(q.genus_known && q.genus == 1 && q.surface_components == 1);
    uint32_t base = (uint32_t)m.points; /* a second one apart */
    for (uint64_t i = 0; i < t.points; i++) shape_point(&m, t.p[3 * i] + 5, t.p[3 * i + 1], t.p[3 * i + 2]);
    for (uint64_t i = 0; i < t.triangles; i++) shape_triangle(&m, base + t.t[3 * i], base + t.t[3 * i + 1], base + t.t[3 * i + 2]);
    CHECK_OK(measure(&m, p, 1, false, &q));
    CHECK(q.genus_known && q.genus == 2 && q.surface_components == 2 && q.surface_closed == 2);
    m.triangles--; /* a hole */
    CHECK_OK(measure(&m, p, 1, false, &q));
    CHECK(!q.genus_known && q.surface_components == 2 && q.surface_closed == 1);
    shape_free(&m);
    shape_free(&t);
}

/* A mirror turns a mesh inside out, its instance does not. */
TEST(mirrored_instance)
{
    shape s = shape_tube(4, 0.25, 40, 16);
    svo_part part = {.material = SVO_NONE, .vertex_count = s.points, .triangle_count = s.triangles, .positions = s.p, .indices = s.t};
    svo_shape sh = {.part_count = 1, .parts = &part};
    svo_instance in = {.transform = svo_mat4_identity()};
    in.transform.m[0] = -1;
    svo_mesh mesh = {.shape_count = 1, .instance_count = 1, .shapes = &sh, .instances = &in};
    skel_joint joint[2] = {{.position = {-0.5, 0, 0}}, {.position = {-3.5, 0, 0}}};
    skel_bone bone = {0, 1};
    skel_skeleton k = {.joint_count = 2, .joints = joint, .bone_count = 1, .bones = &bone};
    skel_quality q;
    CHECK_OK(skel_measure_quality(&mesh, &k, 1, NULL, &q, &err));
    CHECK_MSG(q.length_inside == 100, "%g %g", q.length_inside, q.joints_inside);
    shape_free(&s);
}

static shape bent_tube(double turn, double big, double small, int n, int m)
{
    shape s = {0};
    for (int i = 0; i <= n; i++)
        for (int j = 0; j < m; j++) {
            double u = turn * i / n, v = SHAPE_TAU * j / m, r = big + small * cos(v);
            shape_point(&s, r * cos(u), r * sin(u), small * sin(v));
        }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) {
            uint32_t a = (uint32_t)(i * m + j), b = (uint32_t)(i * m + (j + 1) % m), c = a + (uint32_t)m, d = b + (uint32_t)m;
            shape_triangle(&s, a, c, b);
            shape_triangle(&s, b, c, d);
        }
    uint32_t first = shape_point(&s, big, 0, 0), last = shape_point(&s, big * cos(turn), big * sin(turn), 0);
    for (int j = 0; j < m; j++) {
        shape_triangle(&s, first, (uint32_t)j, (uint32_t)((j + 1) % m));
        shape_triangle(&s, last, (uint32_t)(n * m + (j + 1) % m), (uint32_t)(n * m + j));
    }
    return s;
}

/* A limb bent by 200 degrees: the curve is nowhere farther than omega / 2 from the arc, and the arc nowhere far from it. */
TEST(bones_follow_a_bend)
{
    for (int k = 0; k < 2; k++) {
        double small = k ? 0.12 : 0.25;
        shape m = bent_tube(3.5, 1, small, 120, 24);
        skel_options o = skel_default_options();
        o.omega = 0.04;
        o.search = SKEL_SEARCH_GRID;
        skel_skeleton s;
        CHECK_OK(shape_skeleton(&m, &o, &s, &err));
        CHECK(s.report.ends == 2 && s.report.branches == 0 && s.report.loops == 0);
        CHECK(s.report.quality.length_inside == 100);
        CHECK_MSG(s.report.quality.off_centre_median < 0.1, "%g", s.report.quality.off_centre_median);
        double allowed = 0.5 * o.omega * s.report.unit, worst = 0;
        for (uint32_t b = 0; b < s.bone_count; b++)
            for (int i = 0; i <= 8; i++) {
                double p[3];
                for (int e = 0; e < 3; e++) p[e] = s.joints[s.bones[b].a].position[e] + (s.joints[s.bones[b].b].position[e] - s.joints[s.bones[b].a].position[e]) * i / 8;
                worst = fmax(worst, hypot(hypot(p[0], p[1]) - 1, p[2]));
            }
        CHECK_MSG(worst < allowed, "%g off the arc, omega / 2 is %g", worst, allowed);
        for (int i = 0; i <= 20; i++) { /* but for the ends, where it stops a ball's radius before */
            double u = 3.5 * (0.15 + 0.7 * i / 20);
            const double p[3] = {cos(u), sin(u), 0};
            CHECK(shape_curve_distance(&s, p) < allowed);
        }
        skel_skeleton_free(&s);
        shape_free(&m);
    }
}

/* One limb in three poses, of one length along its axis: one graph, and a curve of the same length. */
TEST(poses)
{
    double first = 0;
    for (int pose = 0; pose < 3; pose++) {
        const double turn = pose == 0 ? 0.4 : pose == 1 ? 1.6 : 3.2;
        shape m = bent_tube(turn, 4 / turn, 0.25, 120, 24);
        skel_options o = skel_default_options();
        o.omega = 0.03;
        o.search = SKEL_SEARCH_GRID;
        skel_skeleton s;
        CHECK_OK(shape_skeleton(&m, &o, &s, &err));
        CHECK(s.report.ends == 2 && s.report.branches == 0 && s.report.loops == 0 && s.report.components == 1);
        double length = 0;
        for (uint32_t b = 0; b < s.bone_count; b++) {
            const double *p = s.joints[s.bones[b].a].position, *q = s.joints[s.bones[b].b].position;
            length += sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) + (p[2] - q[2]) * (p[2] - q[2]));
        }
        if (pose == 0) first = length;
        CHECK_MSG(fabs(length / first - 1) < 0.05, "%g, %g in the first pose", length, first);
        skel_skeleton_free(&s);
        shape_free(&m);
    }
}

/* A bump that hardly sticks out of a ball is no branch; the ball with it stays a point or a short curve. */
TEST(bump_on_a_ball)
{
    shape m = shape_sphere(1, 40, 80);
    for (uint64_t i = 0; i < m.points; i++) {
        double *p = m.p + 3 * i, c = p[0] > 0.9 ? 1 + (p[0] - 0.9) * 2 : 1;
        for (int k = 0; k < 3; k++) p[k] *= c;
    }
    skel_options o = skel_default_options();
    o.omega = 0.03;
    o.search = SKEL_SEARCH_GRID;
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    CHECK_U64(s.report.branches, 0);
    CHECK_U64(s.report.loops, 0);
    CHECK(s.report.quality.length_inside == 100);
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(out_of_memory_is_told)
{
    shape m = shape_torus(1, 0.2, 40, 12);
    bool done = false;
    for (uint64_t budget = 1 << 14; budget < 1 << 26 && !done; budget = budget * 5 / 4) {
        svo_limit_allocator limit;
        svo_limit_allocator_init(&limit, budget, NULL);
        skel_options o = skel_default_options();
        o.omega = 0.06;
        o.search = SKEL_SEARCH_GRID;
        o.allocator = &limit.base;
        skel_skeleton s;
        svo_result r = shape_skeleton(&m, &o, &s, &err);
        CHECK(r == SVO_OK || r == SVO_OUT_OF_MEMORY || r == SVO_LIMIT);
        done = r == SVO_OK;
        if (done) skel_skeleton_free(&s);
    }
    CHECK(done);
    shape_free(&m);
}
