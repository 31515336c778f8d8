/* Three steps on their own: fitting joints to the surface (skel_fit.c), growing limbs that the curve has not (skel_grow.c), and where the surface was that voxels were made of (skel_voxels_fit.c). */
#include "skel_shapes.h"
#include "skeli_curve.h"
#include "skeli_voxels.h"
#include "test.h"

static svo_error err;

enum { MOST_JOINTS = 256 };
#define OMEGA 0.02

/* A model and a curve in it, in the lattice. */
typedef struct scene {
    skeli_pool pool;
    skeli_soup soup, mesh;
    skeli_surface surface;
    skel_report report;
    skeli_curve curve;
} scene;

static void scene_make(scene *s, const shape *m)
{
    *s = (scene){.report = {.omega = OMEGA, .normalize = SKEL_NORMALIZE_BALL}};
    uint32_t *remap = skeli_take(&s->pool, m->points, sizeof *remap);
    CHECK_OK(skeli_soup_make(&s->pool, m->p, m->points, m->t, m->triangles, &s->report, &s->soup, remap, &err));
    uint32_t *moved = skeli_take(&s->pool, s->soup.vertex_count, sizeof *moved);
    CHECK_OK(skeli_tessellate(&s->pool, &s->soup, OMEGA * SKEL_LATTICE, 1000000, &s->mesh, moved, &err));
    CHECK_OK(skeli_surface_make(&s->pool, &s->soup, m->p, m->points, m->t, m->triangles, remap, &s->report, 1, &s->surface, &err));
}

static void scene_free(scene *s)
{
    skeli_surface_free(&s->surface);
    skeli_pool_free(&s->pool);
}

/* A path through points of the model. */
static void path(scene *s, const double (*p)[3], uint32_t joints)
{
    skeli_curve *c = &s->curve;
    *c = (skeli_curve){.joints = joints, .welded = joints, .bones = joints - 1};
    c->position = skeli_take(&s->pool, 3 * joints, sizeof *c->position);
    c->bone = skeli_take(&s->pool, 2 * joints, sizeof *c->bone);
    c->joint_of = skeli_take(&s->pool, s->mesh.vertex_count, sizeof *c->joint_of);
    for (uint32_t j = 0; j < joints; j++)
        for (int k = 0; k < 3; k++) c->position[3 * j + (uint32_t)k] = (p[j][k] - s->report.centre[k]) / s->report.unit * SKEL_LATTICE;
    for (uint32_t j = 0; j + 1 < joints; j++) c->bone[2 * j] = j, c->bone[2 * j + 1] = j + 1;
    memset(c->joint_of, 0, s->mesh.vertex_count * sizeof *c->joint_of);
}

static double balls_mean(scene *s)
{
    skel_quality q;
    const svo_result r = skeli_quality(&s->pool, &s->surface, &s->mesh, s->curve.position, s->curve.joints, s->curve.bone, s->curve.bones, 1, &q, &err);
    return r == SVO_OK ? q.balls_mean : NAN; /* no check holds for that */
}

static void joint_in_model(const scene *s, uint32_t j, double p[3])
{
    for (uint32_t k = 0; k < 3; k++) p[k] = s->curve.position[3 * j + k] / SKEL_LATTICE * s->report.unit + s->report.centre[k];
}

/* About (1, 2, 2), whose length is 3. */
static void turn(double *p, uint64_t count, double degrees)
{
    const double a[3] = {1.0 / 3, 2.0 / 3, 2.0 / 3}, c = cos(degrees * SHAPE_TAU / 360), e = sin(degrees * SHAPE_TAU / 360);
    for (uint64_t i = 0; i < count; i++) {
        double *x = p + 3 * i, along = a[0] * x[0] + a[1] * x[1] + a[2] * x[2], q[3];
        for (int k = 0; k < 3; k++) q[k] = x[k] * c + (a[(k + 1) % 3] * x[(k + 2) % 3] - a[(k + 2) % 3] * x[(k + 1) % 3]) * e + a[k] * along * (1 - c);
        memcpy(x, q, sizeof q);
    }
}

/* --- fitting ---------------------------------------------------------------------------------------------------------- */

/* Joints of a tube of radius 0.25, each up to `off` radii from the axis. */
static uint32_t beside_the_axis(double (*p)[3], double off, uint64_t *seed)
{
    for (uint32_t j = 0; j < 9; j++) {
        const double u = test_random_unit(seed) * SHAPE_TAU, r = off * 0.25 * test_random_unit(seed);
        p[j][0] = 0.25 + 3.5 * j / 8;
        p[j][1] = r * cos(u);
        p[j][2] = r * sin(u);
    }
    return 9;
}

TEST(fitting_lowers_the_error_and_stays_near)
{
    shape m = shape_tube(4, 0.25, 60, 32);
    uint64_t seed = 5;
    for (int turned = 0; turned < 4 && !test_failed(); turned++) {
        double p[MOST_JOINTS][3];
        const uint32_t n = beside_the_axis(p, 0.3, &seed);
        shape t = {0};
        for (uint64_t i = 0; i < m.points; i++) shape_point(&t, m.p[3 * i], m.p[3 * i + 1], m.p[3 * i + 2]);
        for (uint64_t i = 0; i < m.triangles; i++) shape_triangle(&t, m.t[3 * i], m.t[3 * i + 1], m.t[3 * i + 2]);
        turn(t.p, t.points, 37 * turned);
        turn(p[0], n, 37 * turned);
        scene s;
        scene_make(&s, &t);
        path(&s, (const double(*)[3])p, n);
        const double before = balls_mean(&s);
        CHECK_OK(skeli_fit(&s.pool, &s.mesh, &s.surface, OMEGA * SKEL_LATTICE, 1, &s.curve, &err));
        const double after = balls_mean(&s);
        CHECK_MSG(after < 0.97 * before, "%g before, %g after", before, after);
        double first = 0, second = 0;
        turn(p[0], n, -37 * turned);
        for (uint32_t j = 0; j < n; j++) {
            double q[3];
            joint_in_model(&s, j, q);
            turn(q, 1, -37 * turned);
            first += hypot(p[j][1], p[j][2]) / n;
            second += hypot(q[1], q[2]) / n;
            CHECK_MSG(hypot(hypot(q[0] - p[j][0], q[1] - p[j][1]), q[2] - p[j][2]) <= 0.1201 * 0.25, "joint %u has gone too far", j);
        }
        CHECK_MSG(second < 0.8 * first, "%g from the axis before, %g after", first, second);
        scene_free(&s);
        shape_free(&t);
    }
    shape_free(&m);
}

/* What is in the middle already stays there: the axis of a tube, the circle of a torus. */
TEST(fitting_leaves_what_fits)
{
    double p[MOST_JOINTS][3];
    uint64_t seed = 1;
    shape m = shape_tube(4, 0.25, 60, 32);
    const uint32_t n = beside_the_axis(p, 0, &seed);
    scene s;
    scene_make(&s, &m);
    path(&s, (const double(*)[3])p, n);
    const double before = balls_mean(&s);
    CHECK_OK(skeli_fit(&s.pool, &s.mesh, &s.surface, OMEGA * SKEL_LATTICE, 1, &s.curve, &err));
    CHECK_MSG(balls_mean(&s) <= before * 1.0001, "%g before, %g after", before, balls_mean(&s));
    for (uint32_t j = 0; j < n; j++) {
        double q[3];
        joint_in_model(&s, j, q);
        CHECK_MSG(hypot(q[1], q[2]) < 0.02 * 0.25, "joint %u is %g from the axis", j, hypot(q[1], q[2]));
    }
    scene_free(&s);
    shape_free(&m);
}

TEST(fitting_with_any_number_of_threads)
{
    shape m = shape_tube(4, 0.25, 60, 32);
    double p[MOST_JOINTS][3], one[3 * MOST_JOINTS];
    for (uint32_t threads = 1; threads <= 5; threads += 2) {
        uint64_t seed = 11;
        const uint32_t n = beside_the_axis(p, 0.3, &seed);
        scene s;
        scene_make(&s, &m);
        path(&s, (const double(*)[3])p, n);
        CHECK_OK(skeli_fit(&s.pool, &s.mesh, &s.surface, OMEGA * SKEL_LATTICE, threads, &s.curve, &err));
        if (threads == 1) memcpy(one, s.curve.position, 3 * n * sizeof *one);
        CHECK(memcmp(one, s.curve.position, 3 * n * sizeof *one) == 0);
        scene_free(&s);
    }
    shape_free(&m);
}

/* --- growing ---------------------------------------------------------------------------------------------------------- */

/* The curve ends in the middle of a tube: what is beyond is a limb, whatever way the tube is turned, and gets a branch, not yet quite in its middle. A curve that covers the tube gets none. */
TEST(growing_along_a_tube)
{
    for (int turned = 0; turned < 4 && !test_failed(); turned++)
        for (uint32_t threads = 1; threads <= 5; threads += 4) {
            shape m = shape_tube(4, 0.25, 60, 32);
            turn(m.p, m.points, 37 * turned);
            for (int whole = 0; whole < 2; whole++) {
                double p[MOST_JOINTS][3], farthest = 0;
                for (int j = 0; j < 6; j++) p[j][0] = 0.25 + (whole ? 3.5 : 1.75) * j / 5, p[j][1] = p[j][2] = 0;
                turn(p[0], 6, 37 * turned);
                scene s;
                bool grown;
                uint32_t components;
                uint64_t loops;
                scene_make(&s, &m);
                path(&s, (const double(*)[3])p, 6);
                const double before = balls_mean(&s);
                CHECK_OK(skeli_grow(&s.pool, &s.mesh, &s.surface, OMEGA * SKEL_LATTICE, threads, &s.curve, &grown, &err));
                CHECK(grown == !whole);
                CHECK_OK(skeli_curve_betti(&s.pool, &s.curve, &components, &loops, &err));
                CHECK(components == 1 && loops == 0);
                for (uint32_t j = 0; j < s.curve.joints; j++) {
                    double q[3];
                    joint_in_model(&s, j, q);
                    turn(q, 1, -37 * turned);
                    CHECK_MSG(hypot(q[1], q[2]) < (j < 6 ? 1e-6 : q[0] < 3.5 ? 0.5 * 0.25 : 0.25), "joint %u is %g from the axis", j, hypot(q[1], q[2]));
                    farthest = fmax(farthest, q[0]);
                }
                if (whole) CHECK_U64(s.curve.joints, 6);
                CHECK_MSG(farthest > 3.5 && farthest < 4, "the curve ends at %g", farthest);
                if (!whole) CHECK_MSG(balls_mean(&s) < before / 4, "%g before, %g after", before, balls_mean(&s));
                for (uint32_t v = 0; v < s.mesh.vertex_count; v++) CHECK(s.curve.joint_of[v] < s.curve.joints);
                scene_free(&s);
            }
            shape_free(&m);
        }
}

/* All steps after the contraction on the curve of half a tube: a path to both ends, in the middle but for those, whose balls touch the flat sides. */
TEST(grown_limbs_are_put_into_the_middle)
{
    shape m = shape_tube(4, 0.25, 60, 32);
    for (int turned = 0; turned < 3 && !test_failed(); turned++) {
        double p[MOST_JOINTS][3], least = INFINITY, most = -INFINITY;
        for (int j = 0; j < 6; j++) p[j][0] = 0.25 + 1.75 * j / 5, p[j][1] = p[j][2] = 0;
        shape t = {0};
        for (uint64_t i = 0; i < m.points; i++) shape_point(&t, m.p[3 * i], m.p[3 * i + 1], m.p[3 * i + 2]);
        for (uint64_t i = 0; i < m.triangles; i++) shape_triangle(&t, m.t[3 * i], m.t[3 * i + 1], m.t[3 * i + 2]);
        turn(t.p, t.points, 101 * turned);
        turn(p[0], 6, 101 * turned);
        scene s;
        scene_make(&s, &t);
        path(&s, (const double(*)[3])p, 6);
        CHECK_OK(skeli_finish(&s.pool, &s.mesh, &s.surface, OMEGA * SKEL_LATTICE, 2, &s.curve, &err));
        for (uint32_t j = 0; j < s.curve.joints; j++) {
            double q[3];
            joint_in_model(&s, j, q);
            turn(q, 1, -101 * turned);
            if (q[0] > 0.3 && q[0] < 3.6) CHECK_MSG(hypot(q[1], q[2]) < 0.05 * 0.25, "joint %u at %g is %g from the axis", j, q[0], hypot(q[1], q[2]));
            least = fmin(least, q[0]);
            most = fmax(most, q[0]);
        }
        CHECK_U64(s.curve.bones, s.curve.joints - 1);
        CHECK_MSG(least < 0.3 && most > 3.6, "from %g to %g", least, most);
        scene_free(&s);
        shape_free(&t);
    }
    shape_free(&m);
}

/* A ball has no limb; nor has a curve of one joint. */
TEST(growing_nothing)
{
    shape m = shape_sphere(1, 30, 60);
    for (uint32_t n = 1; n <= 2; n++) {
        const double p[2][3] = {{-0.05, 0, 0}, {0.05, 0, 0}};
        scene s;
        bool grown;
        scene_make(&s, &m);
        path(&s, p, n);
        CHECK_OK(skeli_grow(&s.pool, &s.mesh, &s.surface, OMEGA * SKEL_LATTICE, 1, &s.curve, &grown, &err));
        CHECK(!grown);
        CHECK_U64(s.curve.joints, n);
        scene_free(&s);
    }
    shape_free(&m);
}

/* A ring whose curve is an arc of a third: the rest is covered, by at most two branches that come from both ends and stay in the middle. */
TEST(growing_around_a_torus)
{
    shape m = shape_torus(1, 0.2, 80, 40);
    double p[MOST_JOINTS][3];
    for (int j = 0; j < 9; j++) p[j][0] = cos(SHAPE_TAU * j / 24), p[j][1] = sin(SHAPE_TAU * j / 24), p[j][2] = 0;
    scene s;
    bool grown;
    scene_make(&s, &m);
    path(&s, (const double(*)[3])p, 9);
    const double before = balls_mean(&s);
    CHECK_OK(skeli_grow(&s.pool, &s.mesh, &s.surface, OMEGA * SKEL_LATTICE, 2, &s.curve, &grown, &err));
    CHECK(grown);
    for (uint32_t j = 0; j < s.curve.joints; j++) {
        double q[3];
        joint_in_model(&s, j, q);
        CHECK_MSG(hypot(hypot(q[0], q[1]) - 1, q[2]) < 0.35 * 0.2, "joint %u is %g from the circle", j, hypot(hypot(q[0], q[1]) - 1, q[2]));
    }
    CHECK_MSG(balls_mean(&s) < before / 4, "%g before, %g after", before, balls_mean(&s));
    scene_free(&s);
    shape_free(&m);
}

/* --- voxels ------------------------------------------------------------------------------------------------------------ */

enum { SIDE = 24 };

/* Cells that the plane n.x = t meets, what is beyond it is outside, and the corners between the two as points of a boundary with that normal. */
TEST(planes_are_found_again)
{
    uint64_t seed = 3;
    for (int trial = 0; trial < 200 && !test_failed(); trial++) {
        static uint64_t occupied[SIDE * SIDE], outside[SIDE * SIDE];
        static double position[3 * SIDE * SIDE * SIDE];
        static float normal[6 * SIDE * SIDE * SIDE];
        double n[3], length = 0, h = 0;
        for (int k = 0; k < 3; k++) n[k] = test_random_unit(&seed) * 2 - 1, length += n[k] * n[k];
        for (int k = 0; k < 3; k++) n[k] /= sqrt(length), h += fabs(n[k]) / 2;
        const double t = (n[0] + n[1] + n[2]) * SIDE / 2 + test_random_unit(&seed) - 0.5;
        const bits grid = {.n = SIDE, .words = 1, .last = (1u << SIDE) - 1, .occupied = occupied, .outside = outside};
        boundary b = {.position = position, .normal = normal};
        memset(occupied, 0, sizeof occupied);
        memset(outside, 0, sizeof outside);
        for (uint32_t z = 0; z < SIDE; z++)
            for (uint32_t y = 0; y < SIDE; y++)
                for (uint32_t x = 0; x < SIDE; x++) {
                    const double d = n[0] * (x + 0.5) + n[1] * (y + 0.5) + n[2] * (z + 0.5) - t;
                    if (fabs(d) <= h) occupied[z * SIDE + y] |= (uint64_t)1 << x;
                    else if (d > 0) outside[z * SIDE + y] |= (uint64_t)1 << x;
                }
        for (int z = 4; z < SIDE - 4; z++)
            for (int y = 4; y < SIDE - 4; y++)
                for (int x = 4; x < SIDE - 4; x++) {
                    float side[3] = {0, 0, 0}; /* of sides at this corner between what is occupied and what is outside */
                    uint32_t sides = 0;
                    for (int i = 0; i < 8; i++) {
                        const int c[3] = {x - (i & 1), y - (i >> 1 & 1), z - (i >> 2 & 1)};
                        if (!(occupied[c[2] * SIDE + c[1]] >> c[0] & 1)) continue;
                        for (int k = 0; k < 3; k++) {
                            int e[3] = {c[0], c[1], c[2]};
                            e[k] += (i >> k & 1) ? 1 : -1; /* the other cell at the corner on this axis */
                            if (!(outside[e[2] * SIDE + e[1]] >> e[0] & 1)) continue;
                            side[k] += (i >> k & 1) ? 1 : -1;
                            sides++;
                        }
                    }
                    if (sides == 0) continue;
                    const double p[3] = {x, y, z};
                    memcpy(position + 3 * b.points, p, sizeof p);
                    for (int k = 0; k < 3; k++) normal[6 * b.points + (uint64_t)k] = (float)(n[k] * sides), normal[6 * b.points + 3 + (uint64_t)k] = side[k];
                    b.points++;
                }
        CHECK(b.points > 50);
        static double before[3 * SIDE * SIDE * SIDE];
        memcpy(before, position, 3 * b.points * sizeof *before);
        skeli_voxels_fit(&grid, &b);
        double stairs = 0, mean = 0;
        for (uint64_t i = 0; i < b.points; i++) {
            double was = -t, is = -t;
            for (uint64_t k = 0; k < 3; k++) {
                was += n[k] * before[3 * i + k], is += n[k] * position[3 * i + k];
                CHECK_MSG(fabs(position[3 * i + k] - before[3 * i + k]) <= 0.4901, "a point has gone %g cells", position[3 * i + k] - before[3 * i + k]);
            }
            stairs += fabs(was) / (double)b.points;
            mean += fabs(is) / (double)b.points;
        }
        CHECK_MSG(mean < 0.6 * stairs, "normal %g %g %g: %g cells before, %g after", n[0], n[1], n[2], stairs, mean);
        memcpy(position, before, 3 * b.points * sizeof *before); /* normals that disagree move nothing */
        for (uint64_t i = 0; i < b.points; i++)
            for (uint64_t k = 0; k < 3; k++) normal[6 * i + k] *= 0.1f;
        skeli_voxels_fit(&grid, &b);
        CHECK(memcmp(position, before, 3 * b.points * sizeof *before) == 0);
    }
}
