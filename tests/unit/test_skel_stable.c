/* The same skeleton for the same shape: turned, with noise, at another resolution, with faces lost; on real models. */
#include "skel_models.h"
#include "test.h"

static svo_error err;

static void skeleton(const shape *s, double omega, skel_skeleton *out)
{
    skel_options o = skel_default_options();
    o.omega = omega;
    o.search = SKEL_SEARCH_GRID;
    CHECK_OK(shape_skeleton(s, &o, out, &err));
}

static void turn(double *p, uint64_t stride, uint64_t count, const double axis[3], double degrees)
{
    double n = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]), a[3] = {axis[0] / n, axis[1] / n, axis[2] / n};
    double c = cos(degrees * SHAPE_TAU / 360), e = sin(degrees * SHAPE_TAU / 360);
    for (uint64_t i = 0; i < count; i++) {
        double *x = (double *)((char *)p + i * stride), along = a[0] * x[0] + a[1] * x[1] + a[2] * x[2], q[3];
        for (int k = 0; k < 3; k++)
            q[k] = x[k] * c + (a[(k + 1) % 3] * x[(k + 2) % 3] - a[(k + 2) % 3] * x[(k + 1) % 3]) * e + a[k] * along * (1 - c);
        memcpy(x, q, sizeof q);
    }
}

/* Hausdorff distance in percent of the model's size. */
static double apart(const skel_skeleton *a, const skel_skeleton *b, double *mean)
{
    skel_distance d;
    skel_curve_distance(a, b, &d);
    *mean = 100 * fmax(d.mean[0], d.mean[1]) / a->report.unit;
    return 100 * fmax(d.max[0], d.max[1]) / a->report.unit;
}

static void turned(const char *model, double omega, const double axis[3], double degrees, double most)
{
    shape s;
    if (!shape_of_model(model, &s)) {
        test_skip("no %s", model);
        return;
    }
    skel_skeleton a, b;
    skeleton(&s, omega, &a);
    turn(s.p, 3 * sizeof *s.p, s.points, axis, degrees);
    skeleton(&s, omega, &b);
    turn(b.joints[0].position, sizeof *b.joints, b.joint_count, axis, -degrees);
    double mean, worst = apart(&a, &b, &mean);
    CHECK_MSG(worst <= most && mean <= 0.5, "%g %% Hausdorff, %g %% mean", worst, mean);
    CHECK_U64(a.report.loops, b.report.loops);
    skel_skeleton_free(&a);
    skel_skeleton_free(&b);
    shape_free(&s);
}

static const double up[3] = {0, 0, 1}, side[3] = {1, 0, 0}, odd[3] = {0.3, -0.8, 0.52};

TEST(rotation_by_37_degrees) { turned("A_organic/horse/horse.ply", 0.025, up, 37, 2); }
TEST(rotation_by_37_degrees_and_a_small_omega) { turned("A_organic/horse/horse.ply", 0.0125, up, 37, 2); }
TEST(rotation_about_the_side) { turned("A_organic/horse/horse.ply", 0.025, side, 37, 2); }
TEST(rotation_by_an_odd_angle) { turned("A_organic/horse/horse.ply", 0.025, odd, 101.3, 2); }
TEST(rotation_of_a_human) { turned("A_organic/human_neutral/human_neutral.obj", 0.025, odd, 37, 4); }

static void noise(double omega, double size, double most, double most_mean)
{
    shape s;
    if (!shape_of_model("A_organic/horse/horse.ply", &s)) {
        test_skip("no A_organic/horse/horse.ply");
        return;
    }
    skel_skeleton a, b;
    skeleton(&s, omega, &a);
    uint64_t seed = 1;
    for (uint64_t i = 0; i < 3 * s.points; i++) {
        seed = seed * 6364136223846793005u + 1442695040888963407u;
        s.p[i] += size * a.report.unit * (2 * (double)(seed >> 11) * 0x1p-53 - 1);
    }
    skeleton(&s, omega, &b);
    double mean, worst = apart(&a, &b, &mean);
    CHECK_MSG(worst <= most && mean <= most_mean, "%g %% Hausdorff, %g %% mean", worst, mean);
    CHECK_U64(a.report.ends, b.report.ends);
    skel_skeleton_free(&a);
    skel_skeleton_free(&b);
    shape_free(&s);
}
TEST(noise_of_0_3_percent) { noise(0.025, 0.003, 3, 0.5); }
TEST(noise_of_0_3_percent_and_a_small_omega) { noise(0.0125, 0.003, 3, 0.5); }
TEST(noise_of_1_percent) { noise(0.025, 0.01, 4, 0.7); }

/* Every triangle divided into four: the same surface with four times the triangles. */
TEST(two_resolutions)
{
    shape s, f = {0};
    if (!shape_of_model("A_organic/human_neutral/human_neutral.obj", &s)) {
        test_skip("no A_organic/human_neutral/human_neutral.obj");
        return;
    }
    for (uint64_t t = 0; t < s.triangles; t++) {
        uint32_t c[6];
        for (int k = 0; k < 3; k++) {
            const double *p = s.p + 3 * (uint64_t)s.t[3 * t + (uint64_t)k], *q = s.p + 3 * (uint64_t)s.t[3 * t + (uint64_t)((k + 1) % 3)];
            c[k] = shape_point(&f, p[0], p[1], p[2]);
            c[3 + k] = shape_point(&f, (p[0] + q[0]) / 2, (p[1] + q[1]) / 2, (p[2] + q[2]) / 2);
        }
        shape_triangle(&f, c[0], c[3], c[5]);
        shape_triangle(&f, c[3], c[1], c[4]);
        shape_triangle(&f, c[5], c[4], c[2]);
        shape_triangle(&f, c[3], c[4], c[5]);
    }
    skel_skeleton a, b;
    skeleton(&s, 0.025, &a);
    skeleton(&f, 0.025, &b);
    double mean, worst = apart(&a, &b, &mean);
    CHECK_MSG(worst <= 5.5 && mean <= 0.7, "%g %% Hausdorff, %g %% mean", worst, mean);
    CHECK_U64(a.report.ends, b.report.ends);
    skel_skeleton_free(&a);
    skel_skeleton_free(&b);
    shape_free(&s);
    shape_free(&f);
}

/* 10 % of the faces, and half of the model. */
TEST(faces_lost)
{
    shape s;
    if (!shape_of_model("A_organic/horse/horse.ply", &s)) {
        test_skip("no A_organic/horse/horse.ply");
        return;
    }
    skel_skeleton a, b;
    skeleton(&s, 0.025, &a);
    uint64_t kept = 0, seed = 3;
    for (uint64_t t = 0; t < s.triangles; t++) {
        seed = seed * 6364136223846793005u + 1442695040888963407u;
        if ((seed >> 33) % 10 != 0) memmove(s.t + 3 * kept++, s.t + 3 * t, 3 * sizeof *s.t);
    }
    s.triangles = kept;
    skeleton(&s, 0.025, &b);
    double mean, worst = apart(&a, &b, &mean);
    CHECK_MSG(worst <= 6 && mean <= 2, "%g %% Hausdorff, %g %% mean", worst, mean);
    skel_skeleton_free(&b);
    kept = 0;
    for (uint64_t t = 0; t < s.triangles; t++)
        if (s.p[3 * (uint64_t)s.t[3 * t] + 2] > a.report.centre[2]) memmove(s.t + 3 * kept++, s.t + 3 * t, 3 * sizeof *s.t);
    s.triangles = kept;
    skeleton(&s, 0.025, &b);
    CHECK_OK(skel_check(&b, &err));
    CHECK(b.report.unreferenced > 1000 && b.joint_count > 5 && b.report.quality.length_inside > 50);
    skel_skeleton_free(&a);
    skel_skeleton_free(&b);
    shape_free(&s);
}
