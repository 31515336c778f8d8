/* Skeletons of shapes whose curve is known, of degenerate and damaged ones, and what must not change the result. */
#include "skel_shapes.h"
#include "test.h"

static svo_error err;

static skel_options options(double omega)
{
    skel_options o = skel_default_options();
    o.omega = omega;
    o.search = SKEL_SEARCH_GRID; /* equal to FLANN (test_skel_radius and flann_and_grid below), and faster under sanitizers */
    o.threads = 1;
    return o;
}

/* Every skeleton, whatever it came from, keeps the rules, maps every vertex it kept, and reports sane numbers. */
static void check_sane(const skel_skeleton *s)
{
    CHECK_OK(skel_check(s, &err));
    CHECK(s->report.thinness_error >= 0 && s->report.surface_distance_mean <= s->report.surface_distance_max);
    CHECK_U64(s->report.mapped_count, s->report.input_count - s->report.not_finite - s->report.unreferenced);
    skel_component c[4096];
    CHECK(s->report.components <= 4096);
    skel_components(s, c);
    uint64_t joints = 0, bones = 0, loops = 0, ends = 0;
    for (uint32_t i = 0; i < s->report.components; i++) {
        joints += c[i].joints;
        bones += c[i].bones;
        loops += c[i].loops;
        ends += c[i].ends;
    }
    CHECK_U64(joints, s->joint_count);
    CHECK_U64(bones, s->bone_count);
    CHECK_U64(loops, s->report.loops);
    CHECK_U64(ends, s->report.ends);
}

static bool same(const skel_skeleton *a, const skel_skeleton *b)
{
    return a->joint_count == b->joint_count && a->bone_count == b->bone_count &&
           memcmp(a->joints, b->joints, a->joint_count * sizeof *a->joints) == 0 &&
           (a->bone_count == 0 || memcmp(a->bones, b->bones, a->bone_count * sizeof *a->bones) == 0) &&
           a->report.iterations == b->report.iterations;
}

static void tube(skel_method method)
{
    shape m = shape_tube(4, 0.25, 80, 24);
    skel_options o = options(0.03);
    o.method = method;
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK(s.report.converged);
    CHECK(s.report.thinness_error < 1);
    CHECK_U64(s.report.components, 1);
    CHECK_U64(s.report.loops, 0);
    CHECK_U64(s.report.ends, 2);
    CHECK_U64(s.report.branches, 0);
    double low = 9, high = -9;
    for (uint32_t j = 0; j < s.joint_count; j++) {
        const double *p = s.joints[j].position;
        CHECK_MSG(hypot(p[1], p[2]) < 0.02, "joint %u is %g off the axis", j, hypot(p[1], p[2]));
        CHECK_MSG(s.joints[j].radius > 0.15 && s.joints[j].radius < 0.3, "radius %g", s.joints[j].radius);
        low = fmin(low, p[0]);
        high = fmax(high, p[0]);
    }
    CHECK_MSG(low < 0.6 && high > 3.4, "the curve runs from %g to %g of 0 to 4", low, high);
    CHECK(s.report.reconstruction_mean < 1);
    for (uint64_t i = 0; i < s.map_count; i++) /* a vertex belongs to a joint beside it */
        CHECK(fabs(s.joints[s.map[i]].position[0] - m.p[3 * i]) < 0.7);
    skel_skeleton_free(&s);
    shape_free(&m);
}
TEST(tube_fast) { tube(SKEL_METHOD_FAST); }
TEST(tube_literal) { tube(SKEL_METHOD_LITERAL); }

/* (The literal iteration has nothing to break the symmetry of an exact ring, which then shrinks to a point: it is not asked here.) */
TEST(torus)
{
    shape m = shape_torus(1, 0.2, 90, 20);
    skel_options o = options(0.04);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.report.components, 1);
    CHECK_U64(s.report.loops, 1);
    CHECK_U64(s.report.ends, 0);
    CHECK_U64(s.report.branches, 0);
    for (uint32_t j = 0; j < s.joint_count; j++) {
        const double *p = s.joints[j].position;
        CHECK_MSG(hypot(hypot(p[0], p[1]) - 1, p[2]) < 0.2, /* inside the solid */ "joint %u at %g %g %g", j, p[0], p[1], p[2]);
    }
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(star_has_three_ends_and_a_branch)
{
    shape m = shape_star(2, 0.18, 50, 16);
    skel_options o = options(0.04);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.report.components, 1);
    CHECK_U64(s.report.ends, 3);
    CHECK_U64(s.report.branches, 1);
    CHECK_U64(s.report.loops, 0);
    skel_skeleton_free(&s);
    shape_free(&m);
}

static double shape_length(const double *p) { return sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]); }

TEST(sphere_is_a_point_or_a_short_curve)
{
    shape m = shape_sphere(1, 24, 48);
    skel_options o = options(0.05);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.report.components, 1);
    CHECK_U64(s.report.loops, 0);
    CHECK_MSG(s.joint_count <= 4, "%u joints", s.joint_count);
    for (uint32_t j = 0; j < s.joint_count; j++)
        CHECK(shape_length(s.joints[j].position) < 0.65);
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(plate)
{
    shape m = {0};
    int n = 30;
    for (int y = 0; y <= n; y++)
        for (int x = 0; x <= n; x++) shape_point(&m, x, y, 0);
    for (int y = 0; y < n; y++)
        for (int x = 0; x < n; x++) {
            uint32_t a = (uint32_t)(y * (n + 1) + x), b = a + (uint32_t)n + 1;
            shape_triangle(&m, a, a + 1, b);
            shape_triangle(&m, a + 1, b + 1, b);
        }
    skel_options o = options(0.06);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.report.components, 1);
    for (uint32_t j = 0; j < s.joint_count; j++) { /* stays in the plate */
        const double *p = s.joints[j].position;
        CHECK(fabs(p[2]) < 1e-5 && p[0] > -1e-5 && p[0] < n + 1e-5 && p[1] > -1e-5 && p[1] < n + 1e-5);
    }
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(one_triangle)
{
    shape m = {0};
    shape_point(&m, 0, 0, 0);
    shape_point(&m, 3, 0, 0);
    shape_point(&m, 0, 1, 0);
    shape_triangle(&m, 0, 1, 2);
    for (double omega = 1e-2; omega <= 4; omega *= 2) {
        skel_options o = options(omega);
        skel_skeleton s;
        CHECK_OK(shape_skeleton(&m, &o, &s, &err));
        check_sane(&s);
        CHECK_U64(s.report.components, 1);
        skel_skeleton_free(&s);
        if (test_failed()) break;
    }
    shape_free(&m);
}

TEST(two_triangles_sharing_a_vertex)
{
    shape m = {0};
    double p[5][3] = {{0, 0, 0}, {2, 0.5, 0}, {2, -0.5, 0}, {-2, 0, 0.5}, {-2, 0, -0.5}};
    for (int i = 0; i < 5; i++) shape_point(&m, p[i][0], p[i][1], p[i][2]);
    shape_triangle(&m, 0, 1, 2);
    shape_triangle(&m, 0, 3, 4);
    skel_options o = options(0.05);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.report.components, 1);
    CHECK_U64(s.report.mapped_count, 5);
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(all_vertices_equal)
{
    shape m = {0};
    for (int i = 0; i < 100000; i++) shape_point(&m, 5, 6, 7);
    for (uint32_t i = 0; i + 2 < 100000; i += 3) shape_triangle(&m, i, i + 1, i + 2);
    skel_options o = options(0.025);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.joint_count, 1);
    CHECK_U64(s.bone_count, 0);
    CHECK_U64(s.report.isolated, 1);
    CHECK(s.joints[0].position[0] == 5 && s.joints[0].position[1] == 6 && s.joints[0].position[2] == 7 && s.joints[0].radius == 0);
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(many_coincident_vertices_on_a_tube)
{
    shape m = shape_tube(4, 0.25, 40, 12), plain = shape_tube(4, 0.25, 40, 12);
    uint32_t base = (uint32_t)m.points;
    for (uint32_t i = 0; i < 100000; i++) shape_point(&m, 2, 0.25, 0); /* tube vertex 20 * 12 */
    for (uint32_t i = 0; i + 2 < 100000; i += 2) shape_triangle(&m, base + i, base + i + 1, 0);
    shape_triangle(&plain, 240, 240, 0);
    skel_options o = options(0.03);
    skel_skeleton s, t;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_OK(shape_skeleton(&plain, &o, &t, &err));
    CHECK(same(&s, &t));
    skel_skeleton_free(&s);
    skel_skeleton_free(&t);
    shape_free(&m);
    shape_free(&plain);
}

/* Much finer than omega: welded before the first sweep, which must not change what the curve says. */
TEST(dense_input_gives_the_curve_of_a_coarse_one)
{
    shape coarse = shape_torus(1, 0.2, 90, 20), dense = shape_torus(1, 0.2, 900, 200);
    skel_options o = options(0.06);
    skel_skeleton a, b;
    CHECK_OK(shape_skeleton(&coarse, &o, &a, &err));
    CHECK_OK(shape_skeleton(&dense, &o, &b, &err));
    check_sane(&b);
    CHECK(b.report.converged);
    CHECK_U64(b.report.components, 1);
    CHECK_U64(b.report.loops, a.report.loops);
    CHECK_U64(b.report.ends, a.report.ends);
    double omega = 0.06 * b.report.unit; /* in the mesh's units */
    CHECK_MSG(shape_curves_apart(&a, &b) < omega, "%g apart, omega is %g", shape_curves_apart(&a, &b), omega);
    skel_skeleton_free(&a);
    skel_skeleton_free(&b);
    shape_free(&coarse);
    shape_free(&dense);
}

/* Two finely tessellated tubes whose skins are nearer to each other than clusters are wide: they are not connected, so no cluster spans both. */
TEST(dense_neighbours_are_not_clustered_together)
{
    shape s = shape_tube(1, 0.05, 240, 64);
    const uint32_t base = (uint32_t)s.points;
    const uint64_t triangles = s.triangles;
    for (uint32_t i = 0; i < base; i++) shape_point(&s, s.p[3 * i], s.p[3 * i + 1] + 0.105, s.p[3 * i + 2]);
    for (uint64_t i = 0; i < triangles; i++) shape_triangle(&s, base + s.t[3 * i], base + s.t[3 * i + 1], base + s.t[3 * i + 2]);
    skel_options o = options(0.03); /* clusters reach 0.015, the gap is 0.005 */
    skel_skeleton k;
    CHECK_OK(shape_skeleton(&s, &o, &k, &err));
    check_sane(&k);
    CHECK_U64(k.report.components, 2);
    CHECK_U64(k.report.ends, 4);
    CHECK_U64(k.report.loops, 0);
    for (uint32_t i = 0; i < 2 * base; i++) CHECK((k.joints[k.map[i]].position[1] > 0.0525) == (i >= base));
    skel_skeleton_free(&k);
    shape_free(&s);
}

TEST(fan_at_one_vertex)
{
    shape m = {0};
    const int n = 20000;
    uint32_t centre = shape_point(&m, 0, 0.3, 0);
    for (int i = 0; i < n; i++) shape_point(&m, cos(2 * 3.14159265358979 * i / n), 0, sin(2 * 3.14159265358979 * i / n));
    for (int i = 0; i < n; i++) shape_triangle(&m, centre, centre + 1 + (uint32_t)i, centre + 1 + (uint32_t)((i + 1) % n));
    skel_options o = options(0.2);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.report.components, 1);
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(needles)
{
    shape m = shape_tube(4, 0.25, 40, 12);
    uint64_t seed = 5;
    for (int i = 0; i < 200; i++) { /* aspect 1e12, and no area at all */
        double x = 4 * test_random_unit(&seed), e = i % 2 ? 1e-12 : 0;
        uint32_t a = shape_point(&m, x, 0.25, 0), b = shape_point(&m, x + 0.8, 0.25, 0), c = shape_point(&m, x + 0.4, 0.25, e);
        shape_triangle(&m, a, b, c);
    }
    for (int method = 0; method < 2; method++) {
        skel_options o = options(0.03);
        o.method = (skel_method)method;
        skel_skeleton s;
        CHECK_OK(shape_skeleton(&m, &o, &s, &err));
        check_sane(&s);
        skel_skeleton_free(&s);
        if (test_failed()) break;
    }
    shape_free(&m);
}

TEST(not_finite_and_unreferenced)
{
    shape m = shape_tube(4, 0.25, 40, 12), clean = shape_tube(4, 0.25, 40, 12);
    uint32_t a = shape_point(&m, NAN, 0, 0), b = shape_point(&m, 0, INFINITY, 0);
    shape_triangle(&m, 0, 1, a);
    shape_triangle(&m, b, a, 7);
    for (int i = 0; i < 20; i++) shape_point(&m, 1e6 * i, 5e5, 1e7); /* isolated, far away */
    skel_options o = options(0.03);
    svo_warnings w = {0};
    o.warnings = &w;
    skel_skeleton s, t;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.report.not_finite, 2);
    CHECK_U64(s.report.unreferenced, 20);
    CHECK_U64(w.count, 2);
    CHECK(s.map[a] == SVO_NONE && s.map[b] == SVO_NONE && s.map[b + 1] == SVO_NONE);
    CHECK_OK(shape_skeleton(&clean, &o, &t, &err));
    CHECK(same(&s, &t));
    skel_skeleton_free(&s);
    skel_skeleton_free(&t);
    shape_free(&m);
    shape_free(&clean);
}

/* They would make the box a million times as wide as the model, and omega with it. */
TEST(isolated_points_far_away)
{
    shape m = shape_tube(4, 0.25, 40, 12), clean = shape_tube(4, 0.25, 40, 12);
    for (int i = 0; i < 20; i++) shape_point(&m, 1e7 * (i - 7), 3e6 * (i % 3), -1e7);
    skel_options o = options(0.03);
    skel_skeleton s, t;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    CHECK_OK(shape_skeleton(&clean, &o, &t, &err));
    check_sane(&s);
    CHECK_U64(s.report.unreferenced, 20);
    CHECK(same(&s, &t));
    for (uint64_t i = 0; i < 20; i++) CHECK(s.map[clean.points + i] == SVO_NONE);
    skel_skeleton_free(&s);
    skel_skeleton_free(&t);
    shape_free(&m);
    shape_free(&clean);
}

/* Vertices without a triangle, more than those with one, before and between them. */
TEST(many_unreferenced_vertices)
{
    shape m = shape_tube(4, 0.25, 40, 12), n = {0};
    for (uint64_t i = 0; i < m.points; i++) {
        shape_point(&n, 9 - (double)(i % 7), (double)(i % 11), 3);
        shape_point(&n, m.p[3 * i], m.p[3 * i + 1], m.p[3 * i + 2]);
        shape_point(&n, 0.1 * (double)(i % 5), 0, 0);
    }
    for (uint64_t t = 0; t < m.triangles; t++) shape_triangle(&n, 3 * m.t[3 * t] + 1, 3 * m.t[3 * t + 1] + 1, 3 * m.t[3 * t + 2] + 1);
    skel_options o = options(0.05);
    skel_skeleton a, b;
    CHECK_OK(shape_skeleton(&m, &o, &a, &err));
    CHECK_OK(shape_skeleton(&n, &o, &b, &err));
    check_sane(&b);
    CHECK(same(&a, &b));
    CHECK_U64(b.report.unreferenced, 2 * m.points);
    for (uint64_t i = 0; i < m.points; i++) CHECK(b.map[3 * i + 1] == a.map[i] && b.map[3 * i] == SVO_NONE);
    skel_skeleton_free(&a);
    skel_skeleton_free(&b);
    shape_free(&m);
    shape_free(&n);
}

TEST(nothing_to_contract)
{
    shape m = {0};
    skel_options o = options(0.03);
    skel_skeleton s = {0};
    CHECK_RESULT(shape_skeleton(&m, &o, &s, &err), SVO_INVALID_DATA);
    shape_point(&m, NAN, NAN, NAN);
    shape_triangle(&m, 0, 0, 0);
    CHECK_RESULT(shape_skeleton(&m, &o, &s, &err), SVO_INVALID_DATA);
    CHECK(s.joints == NULL);
    shape_free(&m);
}

TEST(options_out_of_range)
{
    shape m = shape_tube(4, 0.25, 10, 6);
    skel_skeleton s = {0};
    const double bad[] = {0, -1, 5, 1e-5, NAN, INFINITY};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        skel_options o = options(bad[i]);
        CHECK_RESULT(shape_skeleton(&m, &o, &s, &err), SVO_INVALID_ARGUMENT);
    }
    skel_options o = options(0.03);
    o.delta = -1;
    CHECK_RESULT(shape_skeleton(&m, &o, &s, &err), SVO_INVALID_ARGUMENT);
    o = options(1e-4);
    o.max_vertices = 100000;
    CHECK_RESULT(shape_skeleton(&m, &o, &s, &err), SVO_LIMIT);
    shape_free(&m);
}

/* Neither unsharing vertices nor permuting triangles and corners changes a bit of the skeleton. */
TEST(soup_equals_shared)
{
    shape m = shape_star(2, 0.18, 40, 12), soup = {0};
    uint64_t seed = 8;
    for (uint64_t i = 0; i < m.triangles; i++) {
        uint64_t t = (i * 7919) % m.triangles, turn = test_random(&seed) % 3;
        uint32_t c[3];
        for (uint64_t k = 0; k < 3; k++) {
            const double *p = m.p + 3 * (uint64_t)m.t[3 * t + (k + turn) % 3];
            c[k] = shape_point(&soup, p[0], p[1], p[2]);
        }
        shape_triangle(&soup, c[0], c[1], c[2]);
    }
    skel_options o = options(0.04);
    skel_skeleton s, t;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    CHECK_OK(shape_skeleton(&soup, &o, &t, &err));
    CHECK(same(&s, &t));
    check_sane(&t);
    skel_skeleton_free(&s);
    skel_skeleton_free(&t);
    shape_free(&m);
    shape_free(&soup);
}

TEST(threads_and_search_change_nothing)
{
    shape m = shape_star(2, 0.18, 80, 24); /* enough vertices that threads are really used */
    for (int method = 0; method < 2; method++) {
        skel_options o = options(0.05);
        o.method = (skel_method)method;
        o.max_iterations = method == 0 ? 0 : 12;
        skel_skeleton first;
        CHECK_OK(shape_skeleton(&m, &o, &first, &err));
        for (uint32_t threads = 1; threads <= 7; threads = threads * 2 + (threads == 2) * 3)
            for (int search = 0; search < 2; search++) {
                o.threads = threads;
                o.search = (skel_search)search;
                skel_skeleton s;
                CHECK_OK(shape_skeleton(&m, &o, &s, &err));
                CHECK_MSG(same(&first, &s) && memcmp(first.map, s.map, s.map_count * sizeof *s.map) == 0 &&
                              first.report.final_movement_sum == s.report.final_movement_sum,
                          "%u threads, search %d, method %d", threads, search, method);
                skel_skeleton_free(&s);
            }
        skel_skeleton_free(&first);
    }
    shape_free(&m);
}

/* Powers of two and exact offsets change no rounding; others at most the last lattice step, 6e-8 of the size, from which contraction can take another
 * path: then the curves may be half an omega apart on average, with the same ends, branches and loops. */
static void moved(double scale, double shift, bool exact)
{
    shape m = shape_star(2, 0.18, 40, 12), n = shape_star(2, 0.18, 40, 12);
    for (uint64_t i = 0; i < 3 * m.points; i++) { /* coordinates that survive the shift */
        m.p[i] = rint(m.p[i] * 4096) / 4096;
        n.p[i] = m.p[i] * scale + shift;
    }
    skel_options o = options(0.04);
    skel_skeleton s, t;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    CHECK_OK(shape_skeleton(&n, &o, &t, &err));
    check_sane(&t);
    CHECK_U64(s.report.ends, t.report.ends);
    CHECK_U64(s.report.branches, t.report.branches);
    CHECK_U64(s.report.loops, t.report.loops);
    for (uint32_t j = 0; j < t.joint_count; j++)
        for (int k = 0; k < 3; k++) t.joints[j].position[k] = (t.joints[j].position[k] - shift) / scale;
    double apart = shape_curves_apart(&s, &t) / s.report.unit;
    CHECK_MSG(apart < (exact ? 2e-7 : 0.02), "curves are %g units apart", apart);
    if (exact) CHECK_U64(s.report.iterations, t.report.iterations);
    skel_skeleton_free(&s);
    skel_skeleton_free(&t);
    shape_free(&m);
    shape_free(&n);
}
TEST(scaled_by_a_power_of_two) { moved(0x1p-20, 0, true); }
TEST(scaled_to_a_millionth) { moved(1e-6, 0, false); }
TEST(scaled_to_1e30) { moved(1e30, 0, false); }
TEST(offset_by_1e9) { moved(1, 1e9, false); }
TEST(offset_by_1e9_and_scaled_by_1e6) { moved(1e6, 1e9, false); }

/* Doubles near 1e9 are 1.2e-7 apart, so of a model of 4e-6 only some thirty steps a side are left: triangles are lost, but what is left has a skeleton inside its box. */
TEST(offset_1e9_and_scale_1e_6)
{
    shape m = shape_star(2, 0.18, 40, 12);
    double low[3], high[3];
    for (uint64_t i = 0; i < 3 * m.points; i++) {
        m.p[i] = m.p[i] * 1e-6 + 1e9;
        low[i % 3] = i < 3 || m.p[i] < low[i % 3] ? m.p[i] : low[i % 3];
        high[i % 3] = i < 3 || m.p[i] > high[i % 3] ? m.p[i] : high[i % 3];
    }
    skel_options o = options(0.04);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK(s.joint_count >= 2);
    CHECK_U64(s.report.components, 1);
    for (uint32_t j = 0; j < s.joint_count; j++)
        for (int k = 0; k < 3; k++) CHECK(s.joints[j].position[k] >= low[k] - 2.4e-7 && s.joints[j].position[k] <= high[k] + 2.4e-7); /* two steps */
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(rotation_keeps_the_topology)
{
    shape m = shape_star(2, 0.18, 40, 12), n = shape_star(2, 0.18, 40, 12);
    double a = 37 * SHAPE_TAU / 360, c = cos(a), d = sin(a);
    for (uint64_t i = 0; i < m.points; i++) { /* about z, then about x */
        const double *p = m.p + 3 * i;
        double x = c * p[0] - d * p[1], y = d * p[0] + c * p[1];
        n.p[3 * i] = x;
        n.p[3 * i + 1] = c * y - d * p[2];
        n.p[3 * i + 2] = d * y + c * p[2];
    }
    skel_options o = options(0.04);
    skel_skeleton s, t;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    CHECK_OK(shape_skeleton(&n, &o, &t, &err));
    CHECK_MSG(fabs(s.report.unit / t.report.unit - 1) < 1e-9, "unit %.17g and %.17g", s.report.unit, t.report.unit);
    CHECK_U64(s.report.tessellated_vertices, t.report.tessellated_vertices);
    CHECK_U64(s.report.ends, t.report.ends);
    CHECK_U64(s.report.branches, t.report.branches);
    CHECK_U64(s.report.loops, t.report.loops);
    skel_skeleton_free(&s);
    skel_skeleton_free(&t);
    shape_free(&m);
    shape_free(&n);
}

/* From what makes a mesh of a hundred thousand vertices to what is larger than the model. */
TEST(omega_from_2e_3_to_1)
{
    const double omega[] = {2e-3, 5e-3, 0.02, 0.1, 0.5, 1};
    shape m = shape_tube(4, 0.05, 80, 12);
    for (int i = 0; i < 6; i++) {
        skel_options o = options(omega[i]);
        if (i == 0) o.max_iterations = 3; /* it is enough to begin: every length must fit the lattice */
        skel_skeleton s;
        CHECK_OK(shape_skeleton(&m, &o, &s, &err));
        CHECK_OK(skel_check(&s, &err));
        CHECK_U64(s.report.components, 1);
        if (i > 0) CHECK_MSG(s.report.converged && s.report.loops == 0 && s.report.ends <= 2, "omega %g: %u ends", omega[i], s.report.ends);
        skel_skeleton_free(&s);
    }
    shape_free(&m);
}

/* The cap is reported, not silent; the sum criterion stops as the seed says. */
TEST(not_converged_is_said)
{
    shape m = shape_tube(4, 0.25, 40, 12);
    skel_options o = options(0.03);
    svo_warnings w = {0};
    o.warnings = &w;
    o.max_iterations = 3;
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK(!s.report.converged);
    CHECK_U64(s.report.iterations, 3);
    CHECK_U64(w.count, 1);
    CHECK(s.report.final_movement_max > 1e-3 * 0.03);
    skel_skeleton_free(&s);
    o.max_iterations = 0;
    o.delta = 0.05;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    CHECK(s.report.converged && s.report.final_movement_sum < 0.05);
    skel_skeleton_free(&s);
    shape_free(&m);
}

TEST(parts_apart_give_components)
{
    shape m = {0};
    for (int i = 0; i < 50; i++) {
        shape t = shape_tube(1, 0.1, 10, 8);
        uint32_t base = (uint32_t)m.points;
        for (uint64_t k = 0; k < t.points; k++) shape_point(&m, t.p[3 * k] + 2 * (i % 10), t.p[3 * k + 1] + i / 10, t.p[3 * k + 2]);
        for (uint64_t k = 0; k < t.triangles; k++) shape_triangle(&m, base + t.t[3 * k], base + t.t[3 * k + 1], base + t.t[3 * k + 2]);
        shape_free(&t);
    }
    skel_options o = options(0.012);
    skel_skeleton s;
    CHECK_OK(shape_skeleton(&m, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.report.components, 50);
    skel_skeleton_free(&s);
    shape_free(&m);
}

/* Every allocation that can fail does once: an error, no leak (the sanitizer's business), no crash. */
TEST(out_of_memory)
{
    shape m = shape_tube(4, 0.25, 12, 8);
    for (uint64_t at = 1;; at++) {
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = at;
        skel_options o = options(0.1);
        o.allocator = &a.base;
        o.max_iterations = 12;
        skel_skeleton s = {0};
        svo_result r = shape_skeleton(&m, &o, &s, &err);
        if (r == SVO_OK) {
            CHECK(at > 20);
            skel_skeleton_free(&s);
            CHECK_U64(svo_limit_in_use(&a), 0);
            break;
        }
        CHECK_U64(r, SVO_OUT_OF_MEMORY);
        CHECK_U64(svo_limit_in_use(&a), 0);
    }
    shape_free(&m);
}

static bool stop(void *user, double fraction)
{
    (void)fraction;
    return ++*(int *)user < 5;
}
TEST(cancelled)
{
    shape m = shape_tube(4, 0.25, 12, 8);
    skel_options o = options(0.05);
    int calls = 0;
    o.progress = stop;
    o.user = &calls;
    skel_skeleton s = {0};
    CHECK_RESULT(shape_skeleton(&m, &o, &s, &err), SVO_CANCELLED);
    CHECK_U64(calls, 5);
    shape_free(&m);
}

/* Instances: placed twice, the map counts twice, in order. */
TEST(instances)
{
    shape m = shape_tube(1, 0.1, 10, 8);
    svo_part part = {.material = SVO_NONE, .vertex_count = m.points, .triangle_count = m.triangles, .positions = m.p, .indices = m.t};
    svo_shape sh = {.part_count = 1, .parts = &part};
    svo_instance in[2] = {{.transform = svo_mat4_identity()}, {.transform = svo_mat4_identity()}};
    in[1].transform.m[7] = 3;
    in[1].transform.m[0] = -1; /* mirrored */
    svo_mesh mesh = {.shape_count = 1, .instance_count = 2, .shapes = &sh, .instances = in};
    skel_options o = options(0.02);
    skel_skeleton s;
    CHECK_OK(skel_build_mesh(&mesh, &o, &s, &err));
    check_sane(&s);
    CHECK_U64(s.map_count, 2 * m.points);
    CHECK_U64(s.report.components, 2);
    for (uint64_t i = 0; i < s.map_count; i++) {
        double y = s.joints[s.map[i]].position[1];
        CHECK(fabs(y - (i < m.points ? 0 : 3)) < 0.1);
    }
    skel_skeleton_free(&s);
    shape_free(&m);
}
