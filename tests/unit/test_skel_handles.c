/* As many loops as handles, and as many components as parts, on closed surfaces whose genus is known from how they are made: also where handles are much thicker than their holes are wide, or parts
 * and limbs nearer to each other than omega. */
#include <math.h>

#include "skel_models.h"
#include "test.h"

static svo_error err;

/* --- surfaces f = 0 by marching tetrahedra --------------------------------------------------------------------------- */

typedef double (*field)(const double p[3]);

/* Cubes of the grid as six tetrahedra around a diagonal, the same for all; a point on an edge is made once. */
static shape surface_of(field f, const double low[3], const double high[3], int n)
{
    static const uint8_t tetrahedron[6][4] = {{0, 1, 3, 7}, {0, 3, 2, 7}, {0, 2, 6, 7}, {0, 6, 4, 7}, {0, 4, 5, 7}, {0, 5, 1, 7}};
    const double longest = fmax(high[0] - low[0], fmax(high[1] - low[1], high[2] - low[2])), step = longest / n;
    int m[3];
    for (int k = 0; k < 3; k++) m[k] = (int)ceil((high[k] - low[k]) / step) + 2;
    const size_t points = (size_t)m[0] * (size_t)m[1] * (size_t)m[2];
    double *value = malloc(points * sizeof *value);
    uint32_t *made = malloc(7 * points * sizeof *made); /* by lower point and direction */
    memset(made, 0xff, 7 * points * sizeof *made);
    shape s = {0};
    for (size_t i = 0; i < points; i++) {
        const size_t at[3] = {i % (size_t)m[0], i / (size_t)m[0] % (size_t)m[1], i / (size_t)m[0] / (size_t)m[1]};
        double p[3];
        for (int k = 0; k < 3; k++) p[k] = low[k] + step * ((double)at[k] - 0.5);
        value[i] = f(p);
    }
    for (int z = 0; z + 1 < m[2]; z++)
        for (int y = 0; y + 1 < m[1]; y++)
            for (int x = 0; x + 1 < m[0]; x++)
                for (int t = 0; t < 6; t++) {
                    size_t at[4];
                    uint32_t in[4], out[4], ins = 0, outs = 0, q[4];
                    for (uint32_t c = 0; c < 4; c++) {
                        const int k = tetrahedron[t][c];
                        at[c] = ((size_t)(z + (k >> 2)) * (size_t)m[1] + (size_t)(y + (k >> 1 & 1))) * (size_t)m[0] + (size_t)(x + (k & 1));
                        if (value[at[c]] < 0) in[ins++] = c;
                        else out[outs++] = c;
                    }
                    if (ins == 0 || outs == 0) continue;
                    uint32_t corners = 0;
                    const uint32_t order[4][2] = {{0, 0}, {0, 1}, {1, 1}, {1, 0}}; /* of a square: around it */
                    for (uint32_t e = 0; e < ins * outs; e++) {
                        const uint32_t a = in[ins == 2 && outs == 2 ? order[e][0] : e / outs], b = out[ins == 2 && outs == 2 ? order[e][1] : e % outs];
                        const int ka = tetrahedron[t][a], kb = tetrahedron[t][b];
                        uint32_t *known = &made[7 * (at[a] < at[b] ? at[a] : at[b]) + (size_t)((ka ^ kb) - 1)];
                        if (*known == UINT32_MAX) {
                            const double g = value[at[a]] / (value[at[a]] - value[at[b]]);
                            double p[3];
                            const int base[3] = {x, y, z};
                            for (int k = 0; k < 3; k++) p[k] = low[k] + step * (base[k] - 0.5 + (1 - g) * (ka >> k & 1) + g * (kb >> k & 1));
                            *known = shape_point(&s, p[0], p[1], p[2]);
                        }
                        q[corners++] = *known;
                    }
                    for (uint32_t c = 1; c + 1 < corners; c++) { /* facing away from the points inside */
                        const double *a = s.p + 3 * q[0], *b = s.p + 3 * q[c], *d = s.p + 3 * q[c + 1];
                        double u[3], v[3], to = 0;
                        const int ka = tetrahedron[t][in[0]];
                        const int base[3] = {x, y, z};
                        for (int k = 0; k < 3; k++) {
                            u[k] = b[k] - a[k];
                            v[k] = d[k] - a[k];
                        }
                        for (int k = 0; k < 3; k++) to += (u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]) * (low[k] + step * (base[k] - 0.5 + (ka >> k & 1)) - a[k]);
                        shape_triangle(&s, q[0], to < 0 ? q[c] : q[c + 1], to < 0 ? q[c + 1] : q[c]);
                    }
                }
    free(value);
    free(made);
    return s;
}

static double ring(const double p[3], double x, double big)
{
    const double r = hypot(p[0] - x, p[1]) - big;
    return hypot(r, p[2]);
}

static int rings;
static double thickness;
static double chain_of_rings(const double p[3])
{
    double d = INFINITY;
    for (int i = 0; i < rings; i++) d = fmin(d, ring(p, 2.0 * i, 1));
    return d - thickness;
}

/* A plate with five by two holes. */
static double plate(const double p[3])
{
    double d = fmax(fabs(p[2]) - thickness, fmax(fabs(p[0] - 4) - 5.01, fabs(p[1] - 1) - 2.01));
    for (int i = 0; i < 10; i++) d = fmax(d, 0.55 - hypot(p[0] - 2 * (i % 5), p[1] - 2 * (i / 5)));
    return d;
}

static double box(const double p[3], double x0, double y0, double z0, double x1, double y1, double z1)
{
    return fmax(fmax(fmax(x0 - p[0], p[0] - x1), fmax(y0 - p[1], p[1] - y1)), fmax(z0 - p[2], p[2] - z1));
}

/* --- checks ---------------------------------------------------------------------------------------------------------- */

static void loops(shape *s, double omega, uint64_t genus, uint32_t components, uint32_t ends)
{
    skel_options o = skel_default_options();
    o.omega = omega;
    o.search = SKEL_SEARCH_GRID;
    skel_skeleton a;
    CHECK_OK(shape_skeleton(s, &o, &a, &err));
    CHECK_OK(skel_check(&a, &err));
    const skel_quality *q = &a.report.quality;
    CHECK(q->genus_known);
    CHECK_U64(q->genus, genus);
    CHECK_U64(q->surface_components, components);
    CHECK_U64(a.report.loops, genus);
    CHECK_U64(a.report.components, components);
    CHECK_MSG(a.report.ends <= ends, "%u ends", a.report.ends);
    CHECK_MSG(q->length_inside >= 99 && q->joints_inside >= 99, "%g %% of the curve, %g %% of the joints inside", q->length_inside, q->joints_inside);
    skel_skeleton_free(&a);
    shape_free(s);
}

static void tori(int count, double thick, double omega)
{
    rings = count;
    thickness = thick;
    const double low[3] = {-1 - thick, -1 - thick, -thick}, high[3] = {2 * count - 1 + thick, 1 + thick, thick};
    shape s = surface_of(chain_of_rings, low, high, 24 * count + 24);
    loops(&s, omega, (uint64_t)count, 1, 0);
}

TEST(thin_torus) { tori(1, 0.15, 0.025); }
TEST(fat_torus) { tori(1, 0.85, 0.025); }
TEST(fat_torus_and_a_large_omega) { tori(1, 0.85, 0.2); }
TEST(thin_double_torus) { tori(2, 0.12, 0.025); }
TEST(fat_double_torus) { tori(2, 0.75, 0.025); }
TEST(thin_triple_torus) { tori(3, 0.15, 0.025); }
TEST(fat_triple_torus) { tori(3, 0.7, 0.025); }

static void genus_10(double thick, double omega)
{
    thickness = thick;
    const double low[3] = {-1.01, -1.01, -thick}, high[3] = {9.01, 3.01, thick};
    shape s = surface_of(plate, low, high, 90);
    loops(&s, omega, 10, 1, 4 /* its corners */);
}

TEST(thin_plate_of_genus_10) { genus_10(0.26, 0.025); }
TEST(fat_plate_of_genus_10) { genus_10(1.21, 0.025); }
TEST(plate_of_genus_10_and_a_large_omega) { genus_10(0.61, 0.1); }

/* A tube around a (2, 3) torus knot: one loop, whose strands pass each other. */
TEST(trefoil_knot)
{
    enum { N = 240, M = 12 };
    shape s = {0};
    for (int i = 0; i < N; i++) {
        double c[3][3]; /* points of the knot at and beside i */
        for (int k = 0; k < 3; k++) {
            const double t = SHAPE_TAU * (i + 0.5 * (k - 1)) / N, r = 2 + cos(3 * t);
            c[k][0] = r * cos(2 * t);
            c[k][1] = r * sin(2 * t);
            c[k][2] = sin(3 * t);
        }
        const double t = SHAPE_TAU * i / N;
        double out[3] = {cos(3 * t) * cos(2 * t), cos(3 * t) * sin(2 * t), sin(3 * t)}, along[3], n = 0, dot = 0, side[3];
        for (int k = 0; k < 3; k++) n += (c[2][k] - c[0][k]) * (c[2][k] - c[0][k]);
        for (int k = 0; k < 3; k++) along[k] = (c[2][k] - c[0][k]) / sqrt(n);
        for (int k = 0; k < 3; k++) dot += out[k] * along[k];
        for (int k = 0; k < 3; k++) out[k] -= dot * along[k];
        n = sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]);
        for (int k = 0; k < 3; k++) out[k] /= n;
        for (int k = 0; k < 3; k++) side[k] = along[(k + 1) % 3] * out[(k + 2) % 3] - along[(k + 2) % 3] * out[(k + 1) % 3];
        for (int j = 0; j < M; j++) {
            const double a = 0.35 * cos(SHAPE_TAU * j / M), b = 0.35 * sin(SHAPE_TAU * j / M);
            shape_point(&s, c[1][0] + a * out[0] + b * side[0], c[1][1] + a * out[1] + b * side[1], c[1][2] + a * out[2] + b * side[2]);
        }
    }
    for (int i = 0; i < N; i++)
        for (int j = 0; j < M; j++) {
            const uint32_t a = (uint32_t)(i * M + j), b = (uint32_t)(i * M + (j + 1) % M), c = (uint32_t)((i + 1) % N * M + j), d = (uint32_t)((i + 1) % N * M + (j + 1) % M);
            shape_triangle(&s, a, b, c);
            shape_triangle(&s, b, d, c);
        }
    loops(&s, 0.025, 1, 1, 0);
}

static void of_model(const char *model, double omega, uint64_t genus, uint32_t components)
{
    shape s;
    if (!shape_of_model(model, &s)) {
        test_skip("no %s", model);
        return;
    }
    skel_options o = skel_default_options();
    o.omega = omega;
    o.search = SKEL_SEARCH_GRID;
    skel_skeleton a;
    CHECK_OK(shape_skeleton(&s, &o, &a, &err));
    CHECK(a.report.quality.genus_known);
    CHECK_U64(a.report.quality.genus, genus);
    CHECK_U64(a.report.loops, genus);
    CHECK_U64(a.report.components, components);
    CHECK(a.report.quality.length_inside >= 99);
    skel_skeleton_free(&a);
    shape_free(&s);
}

TEST(three_holes) { of_model("E_formats/off_quads/3holes.off", 0.025, 3, 1); }
TEST(three_holes_and_a_larger_omega) { of_model("E_formats/off_quads/3holes.off", 0.05, 3, 1); }
TEST(boeing) { of_model("B_damaged/boeing/boeing.off", 0.025, 10, 1); }
TEST(camel) { of_model("A_organic/camel/camel.off", 0.025, 0, 1); }
TEST(elephant) { of_model("A_organic/elephant/elephant.off", 0.025, 3, 1); }

/* --- parts that are near each other ------------------------------------------------------------------------------------ */

static double two_rods(const double p[3]) { return fmin(box(p, 0.01, 0.01, 0.01, 4, 0.3, 0.3), box(p, 0.01, 0.36, 0.01, 4, 0.66, 0.3)); }

TEST(rods_nearer_than_omega)
{
    const double low[3] = {0, 0, 0}, high[3] = {4, 0.66, 0.3};
    shape s = surface_of(two_rods, low, high, 160);
    skel_options o = skel_default_options();
    o.omega = 0.12;
    o.search = SKEL_SEARCH_GRID;
    skel_skeleton a;
    CHECK_OK(shape_skeleton(&s, &o, &a, &err));
    CHECK_U64(a.report.quality.surface_components, 2);
    CHECK_U64(a.report.components, 2);
    CHECK_U64(a.report.ends, 4);
    CHECK_U64(a.report.loops, 0);
    CHECK(a.report.quality.length_inside >= 99);
    skel_skeleton_free(&a);
    shape_free(&s);
}
