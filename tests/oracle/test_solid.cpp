// Solids against CGAL's inside test: every voxel that the surface does not touch is there if and only if its centre is inside. Damaged meshes
// against the winding number summed over all triangles.
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/repair_polygon_soup.h>
#include <CGAL/Side_of_triangle_mesh.h>
#include <CGAL/Surface_mesh.h>

#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "fmt_import.h"
#include "voxel_set.h"

namespace {

using K = CGAL::Exact_predicates_inexact_constructions_kernel;
using Mesh = CGAL::Surface_mesh<K::Point_3>;
using Inside = CGAL::Side_of_triangle_mesh<Mesh, K>;
using V = std::array<double, 3>;
using Triangle = std::array<V, 3>;
using Soup = std::vector<Triangle>;

Soup sphere(const V &c, double r, int rings, bool inward = false)
{
    Soup s;
    const double pi = 3.14159265358979323846;
    auto at = [&](int i, int j) {
        double t = pi * i / rings, p = 2 * pi * (j % (2 * rings)) / (2 * rings);
        if (i == 0) return V{c[0], c[1], c[2] + r};
        if (i == rings) return V{c[0], c[1], c[2] - r};
        return V{c[0] + r * std::sin(t) * std::cos(p), c[1] + r * std::sin(t) * std::sin(p), c[2] + r * std::cos(t)};
    };
    auto add = [&](const V &a, const V &b, const V &d) { s.push_back(inward ? Triangle{a, d, b} : Triangle{a, b, d}); };
    for (int j = 0; j < 2 * rings; j++)
        for (int i = 0; i < rings; i++) {
            if (i + 1 < rings) add(at(i, j), at(i + 1, j), at(i + 1, j + 1));
            if (i > 0) add(at(i, j), at(i + 1, j + 1), at(i, j + 1));
        }
    return s;
}

Soup box(const V &lo, const V &hi)
{
    static const int f[12][3] = {{0, 2, 3}, {0, 3, 1}, {4, 5, 7}, {4, 7, 6}, {0, 1, 5}, {0, 5, 4}, {2, 6, 7}, {2, 7, 3}, {0, 4, 6}, {0, 6, 2}, {1, 3, 7}, {1, 7, 5}};
    Soup s;
    for (auto &t : f) {
        Triangle x;
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < 3; i++) x[k][i] = t[k] >> i & 1 ? hi[i] : lo[i];
        s.push_back(x);
    }
    return s;
}

Soup turned(Soup s)
{
    for (Triangle &t : s) std::swap(t[1], t[2]);
    return s;
}

struct Body {
    Soup soup;
    int sign; // what its orientation makes of it
};

void voxelize(const Soup &soup, uint32_t depth, svo_fill fill, svo_surface surface, voxel_set *out, double low[3], double *size)
{
    std::vector<double> p;
    for (const Triangle &t : soup)
        for (const V &v : t) p.insert(p.end(), v.begin(), v.end());
    loose_mesh m;
    loose_make(&m, p.data(), soup.size());
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = depth;
    o.fill = fill;
    o.surface = surface;
    o.channels = 0;
    o.threads = 2;
    svo_error err = {};
    CHECK_OK(voxel_run(&m.mesh, &o, true, out, &err));
    CHECK(out->ordered);
    CHECK_U64(out->report.counts.nodes[depth], out->count);
    CHECK(memcmp(&out->report.counts, &out->counts, sizeof out->counts) == 0);
    *size = out->info.voxel_to_world[0];
    for (int i = 0; i < 3; i++) low[i] = out->info.voxel_to_world[4 * i + 3];
    loose_free(&m);
}

std::vector<char> cells(const voxel_set &s, uint32_t depth)
{
    std::vector<char> c(size_t(1) << 3 * depth, 0);
    for (uint64_t i = 0; i < s.count; i++) c[s.codes[i]]++;
    return c;
}

template <class Expected>
void check_solid(const Soup &all, uint32_t depth, svo_surface surface, const char *what, Expected expected, uint64_t stride = 1)
{
    voxel_set shell, solid;
    double low[3], size;
    voxelize(all, depth, SVO_FILL_SURFACE, surface, &shell, low, &size);
    if (!test_failed()) voxelize(all, depth, SVO_FILL_SOLID, surface, &solid, low, &size);
    if (test_failed()) return;
    std::vector<char> a = cells(shell, depth), b = cells(solid, depth);
    uint64_t wrong = 0, filled = 0, seed = 5, first = 0;
    for (uint64_t code = 0; code < a.size(); code++) {
        CHECK_MSG(b[code] <= 1, "%s: a voxel is there twice", what);
        if (a[code]) {
            CHECK_MSG(b[code], "%s depth %u: a surface voxel is missing", what, depth);
            continue;
        }
        if (stride > 1 && test_random(&seed) % stride != 0) continue;
        uint32_t x[3];
        svo_morton_decode(code, &x[0], &x[1], &x[2]);
        V p;
        for (int k = 0; k < 3; k++) p[k] = low[k] + (x[k] + 0.5) * size;
        int e = expected(p);
        if (e < 0) continue; // not to be decided
        filled += uint64_t(e);
        if (e != int(b[code]) && wrong++ == 0) first = code;
    }
    CHECK_MSG(wrong == 0, "%s depth %u %s: %llu voxels on the wrong side, the first has code %llx (%llu inside)", what, depth, surface == SVO_SURFACE_THIN ? "thin" : "conservative",
              (unsigned long long)wrong, (unsigned long long)first, (unsigned long long)filled);
    voxel_free(&shell);
    voxel_free(&solid);
}

// Inside of the bodies: the sum of their signs is not 0.
void against_cgal(const std::vector<Body> &bodies, const std::vector<uint32_t> &depths, const char *what)
{
    Soup all;
    std::vector<std::unique_ptr<Mesh>> meshes;
    std::vector<std::unique_ptr<Inside>> tests;
    for (const Body &b : bodies) {
        all.insert(all.end(), b.soup.begin(), b.soup.end());
        std::vector<K::Point_3> points;
        std::vector<std::vector<std::size_t>> polygons;
        for (const Triangle &t : b.soup) {
            polygons.push_back({points.size(), points.size() + 1, points.size() + 2});
            for (const V &v : t) points.emplace_back(v[0], v[1], v[2]);
        }
        namespace PMP = CGAL::Polygon_mesh_processing;
        PMP::repair_polygon_soup(points, polygons);
        PMP::orient_polygon_soup(points, polygons);
        meshes.push_back(std::make_unique<Mesh>());
        PMP::polygon_soup_to_polygon_mesh(points, polygons, *meshes.back());
        CHECK_MSG(CGAL::is_closed(*meshes.back()), "%s: not closed for CGAL", what);
        tests.push_back(std::make_unique<Inside>(*meshes.back()));
    }
    for (uint32_t depth : depths)
        for (svo_surface surface : {SVO_SURFACE_CONSERVATIVE, SVO_SURFACE_THIN}) {
            if (test_failed()) return;
            check_solid(all, depth, surface, what, [&](const V &p) {
                int sum = 0;
                for (size_t i = 0; i < bodies.size(); i++)
                    if ((*tests[i])(K::Point_3(p[0], p[1], p[2])) == CGAL::ON_BOUNDED_SIDE) sum += bodies[i].sign;
                return int(sum != 0);
            });
        }
}

double winding(const Soup &s, const V &p)
{
    double sum = 0;
    for (const Triangle &t : s) {
        double v[3][3], l[3];
        for (int i = 0; i < 3; i++) {
            for (int k = 0; k < 3; k++) v[i][k] = t[i][k] - p[k];
            l[i] = std::sqrt(v[i][0] * v[i][0] + v[i][1] * v[i][1] + v[i][2] * v[i][2]);
        }
        auto dot = [&](int i, int j) { return v[i][0] * v[j][0] + v[i][1] * v[j][1] + v[i][2] * v[j][2]; };
        double det = v[0][0] * (v[1][1] * v[2][2] - v[1][2] * v[2][1]) - v[0][1] * (v[1][0] * v[2][2] - v[1][2] * v[2][0]) +
                     v[0][2] * (v[1][0] * v[2][1] - v[1][1] * v[2][0]);
        sum += std::atan2(det, l[0] * l[1] * l[2] + dot(0, 1) * l[2] + dot(1, 2) * l[0] + dot(2, 0) * l[1]);
    }
    return sum / 6.283185307179586;
}

// Away from 1/2 the winding number of the mesh as it is decides.
void against_winding(const Soup &s, uint32_t depth, svo_surface surface, const char *what, uint64_t stride)
{
    check_solid(s, depth, surface, what, [&](const V &p) {
        double w = winding(s, p);
        return std::fabs(w - 0.5) < 0.02 ? -1 : int(w > 0.5);
    }, stride);
}

Soup load(const char *path)
{
    Soup s;
    fmt_import_options o = {};
    svo_mesh mesh = {};
    svo_error err = {};
    if (fmt_import_mesh(path, &o, &mesh, &err) != SVO_OK) {
        test_fail(__FILE__, __LINE__, "%s: %s", path, err.message);
        return s;
    }
    for (uint32_t i = 0; i < mesh.instance_count; i++) {
        const svo_shape &shape = mesh.shapes[mesh.instances[i].shape];
        for (uint32_t k = 0; k < shape.part_count; k++)
            for (uint64_t t = 0; t < shape.parts[k].triangle_count; t++) {
                Triangle x;
                for (int c = 0; c < 3; c++)
                    for (int a = 0; a < 3; a++) x[c][a] = shape.parts[k].positions[3 * uint64_t(shape.parts[k].indices[3 * t + c]) + a];
                s.push_back(x);
            }
    }
    svo_mesh_free(&mesh);
    return s;
}

TEST(one_body)
{
    against_cgal({{sphere({0, 0, 0}, 1, 12), 1}}, {1, 2, 3, 5, 6}, "sphere");
    against_cgal({{box({0, 0, 0}, {1, 0.7, 0.33}), 1}}, {1, 2, 3, 5, 6}, "box");
    against_cgal({{turned(box({0, 0, 0}, {1, 0.7, 0.33})), -1}}, {5}, "box inside out");
}

// Face planes, edges and vertices right above centres of voxels: rays that graze are decided by the tie rule.
TEST(faces_on_the_grid)
{
    for (int i = 0; i < 4; i++) {
        double a = i / 8.0 / 256;
        against_cgal({{box({0, 0, 0}, {1, 1, 1}), 1}, {box({0.25 + a, 0.25, 0.25}, {0.75, 0.75 - a, 0.5 + a}), 1}}, {4, 5}, "boxes on the grid");
    }
    Soup s; // an octahedron with edges along diagonals of the grid
    const V c[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    for (int k = 0; k < 8; k++) {
        const V &x = c[k & 1], &y = c[2 + (k >> 1 & 1)], &z = c[4 + (k >> 2)];
        bool odd = ((k & 1) + (k >> 1 & 1) + (k >> 2)) % 2 != 0;
        s.push_back(odd ? Triangle{x, z, y} : Triangle{x, y, z});
    }
    against_cgal({{s, 1}}, {3, 4, 5, 6}, "octahedron");
}

TEST(several_bodies)
{
    against_cgal({{sphere({0, 0, 0}, 1, 10), 1}, {sphere({0, 0, 0}, 0.5, 10, true), -1}}, {5, 6}, "cavity");
    against_cgal({{sphere({0, 0, 0}, 1, 10), 1}, {sphere({0, 0, 0}, 0.5, 10), 1}}, {5}, "a solid in a solid");
    against_cgal({{sphere({0, 0, 0}, 1, 10), 1}, {sphere({0.1, 0, 0}, 0.7, 10, true), -1}, {sphere({0.1, 0, 0.1}, 0.4, 10), 1}}, {6}, "shells");
    against_cgal({{sphere({0, 0, 0}, 1, 10), 1}, {sphere({0.9, 0.2, 0.1}, 1, 10), 1}, {box({0.5, -2, -0.1}, {0.6, 2, 0.1}), 1}}, {6}, "overlaps stay full");
    against_cgal({{sphere({0, 0, 0}, 1, 10, true), -1}, {sphere({0, 0, 0}, 0.5, 10), 1}}, {5}, "cavity, inside out");
}

// A random rotation, scale and place.
struct Motion {
    double m[3][3], t[3];
    explicit Motion(uint64_t *seed, double scale)
    {
        double q[4], n = 0;
        for (double &x : q) x = test_random_unit(seed) - 0.5, n += x * x;
        for (double &x : q) x /= std::sqrt(n);
        const double r[3][3] = {{1 - 2 * (q[1] * q[1] + q[2] * q[2]), 2 * (q[0] * q[1] - q[2] * q[3]), 2 * (q[0] * q[2] + q[1] * q[3])},
                                {2 * (q[0] * q[1] + q[2] * q[3]), 1 - 2 * (q[0] * q[0] + q[2] * q[2]), 2 * (q[1] * q[2] - q[0] * q[3])},
                                {2 * (q[0] * q[2] - q[1] * q[3]), 2 * (q[1] * q[2] + q[0] * q[3]), 1 - 2 * (q[0] * q[0] + q[1] * q[1])}};
        for (int i = 0; i < 3; i++) {
            t[i] = test_random_unit(seed) - 0.5;
            for (int k = 0; k < 3; k++) m[i][k] = r[i][k] * scale;
        }
    }
    Soup operator()(Soup s) const
    {
        for (Triangle &x : s)
            for (V &v : x) {
                const V o = v;
                for (int i = 0; i < 3; i++) v[i] = m[i][0] * o[0] + m[i][1] * o[1] + m[i][2] * o[2] + t[i];
            }
        return s;
    }
};

// A tube along the (p, q) torus knot, with triangles of all shapes.
Soup knot(int p, int q, double thickness, int along, int around)
{
    const double turn = 6.283185307179586;
    auto centre = [&](double t) {
        const double r = 2 + std::cos(q * t);
        return V{r * std::cos(p * t), r * std::sin(p * t), -std::sin(q * t)};
    };
    auto at = [&](int i, int j) {
        const double t = turn * (i % along) / along, a = turn * (j % around) / around, h = 1e-4;
        const V c = centre(t), before = centre(t - h), behind = centre(t + h);
        V d, u, v;
        for (int k = 0; k < 3; k++) d[k] = behind[k] - before[k], u[k] = k == 2 ? c[k] : c[k] * 0.5;
        auto cross = [](const V &x, const V &y) { return V{x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]}; };
        auto unit = [](V x) {
            const double l = std::sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
            for (double &e : x) e /= l;
            return x;
        };
        v = unit(cross(d, u));
        u = unit(cross(v, d));
        V out;
        for (int k = 0; k < 3; k++) out[k] = c[k] + thickness * (std::cos(a) * u[k] + std::sin(a) * v[k]);
        return out;
    };
    Soup s;
    for (int i = 0; i < along; i++)
        for (int j = 0; j < around; j++) {
            s.push_back({at(i, j), at(i, j + 1), at(i + 1, j + 1)});
            s.push_back({at(i, j), at(i + 1, j + 1), at(i + 1, j)});
        }
    return s;
}

// Does the soup look outwards? (signed volume)
int sign_of(const Soup &s)
{
    double volume = 0;
    for (const Triangle &t : s)
        volume += t[0][0] * (t[1][1] * t[2][2] - t[1][2] * t[2][1]) + t[0][1] * (t[1][2] * t[2][0] - t[1][0] * t[2][2]) + t[0][2] * (t[1][0] * t[2][1] - t[1][1] * t[2][0]);
    return volume > 0 ? 1 : -1;
}

TEST(random_bodies)
{
    uint64_t seed = 11;
    for (int round = 0; round < 4; round++) {
        const Motion a(&seed, 1), b(&seed, 0.9), c(&seed, 0.3);
        const uint32_t depth = 5 + uint32_t(round) % 2;
        // boxes in boxes, each turned by itself: overlapping, and one with a cavity
        against_cgal({{a(box({-1, -1, -1}, {1, 1, 1})), 1}, {b(box({-1, -0.4, -0.7}, {1, 0.4, 0.7})), 1}}, {depth}, "rotated boxes");
        const Soup outer = a(box({-2, -2, -2}, {2, 2, 2})), inner = turned(a(c(box({-1, -1, -1}, {1, 1, 1}))));
        against_cgal({{outer, 1}, {inner, -1}}, {depth}, "a rotated box with a cavity");
        against_cgal({{sphere({0, 0, 0}, 1, 9), 1}, {b(sphere({0, 0, 0}, 1, 7)), 1}}, {depth}, "two spheres");
        Soup k = a(knot(2, 3, 0.3 + 0.05 * round, 60, 6));
        const int sign = sign_of(k);
        against_cgal({{k, sign}}, {depth}, "torus knot");
        against_cgal({{k, sign}, {sign > 0 ? b(sphere({1, 0, 0}, 1.5, 6)) : turned(b(sphere({1, 0, 0}, 1.5, 6))), sign}}, {depth}, "a sphere across a torus knot");
    }
}

// A tube so thick that it passes through itself: inside where it winds round a point at all.
TEST(self_intersecting)
{
    uint64_t seed = 3;
    for (int round = 0; round < 2; round++) {
        Soup s = Motion(&seed, 1)(knot(2, 3, 0.9, 48, 7));
        if (sign_of(s) < 0) s = turned(s);
        for (svo_surface surface : {SVO_SURFACE_CONSERVATIVE, SVO_SURFACE_THIN}) {
            if (test_failed()) return;
            against_winding(s, 5, surface, "thick knot", 3);
        }
    }
}

// Triangles cut out at random, some of them turned: rims of all sizes, also ones that touch.
TEST(random_holes)
{
    uint64_t seed = 29;
    for (int round = 0; round < 3; round++) {
        Soup whole = Motion(&seed, 1)(round == 2 ? knot(2, 3, 0.45, 40, 6) : sphere({0, 0, 0}, 1, 10)), s;
        if (sign_of(whole) < 0) whole = turned(whole);
        const uint64_t keep = 4 + uint64_t(round) * 6;
        for (const Triangle &t : whole)
            if (test_random(&seed) % keep != 0) s.push_back(t);
        against_winding(s, 6, SVO_SURFACE_CONSERVATIVE, "random holes", 40);
        if (test_failed()) return;
    }
}

TEST(faces_that_look_the_other_way_are_turned)
{
    Soup s = sphere({0, 0, 0}, 1, 10), in = sphere({0, 0, 0}, 0.5, 8, true);
    for (size_t i = 0; i < s.size(); i += 5) std::swap(s[i][1], s[i][2]);
    for (size_t i = 0; i < in.size(); i += 7) std::swap(in[i][1], in[i][2]);
    against_cgal({{s, 1}, {in, -1}}, {5, 6}, "flipped faces");
}

TEST(real_closed_models)
{
    const char *const models[] = {"A_organic/armadillo/armadillo.obj", "A_organic/bunny_closed/bunny_hr.obj", "A_organic/fertility/fertility.off"};
    int found = 0;
    for (const char *m : models) {
        const char *path = test_model(m);
        if (path == nullptr) continue;
        found++;
        Soup s = load(path);
        if (test_failed()) return;
        against_cgal({{s, 1}}, {6}, m);
    }
    if (found == 0) test_skip("no real models");
}

TEST(holes)
{
    Soup s = sphere({0, 0, 0}, 1, 12);
    for (uint32_t depth : {3u, 5u, 6u})
        for (svo_surface surface : {SVO_SURFACE_CONSERVATIVE, SVO_SURFACE_THIN}) {
            if (test_failed()) return;
            against_winding(Soup(s.begin() + 1, s.end()), depth, surface, "one triangle missing", depth > 5 ? 5 : 1);
            against_winding(Soup(s.begin() + 60, s.end()), depth, surface, "a hole", depth > 5 ? 5 : 1);
            against_winding(Soup(s.begin() + 300, s.end()), depth, surface, "less than a half", depth > 5 ? 5 : 1);
        }
    /* a cavity with a hole, in a closed sphere */
    Soup in = sphere({0.1, 0, 0}, 0.6, 12, true), all = sphere({0, 0, 0}, 1, 12);
    all.insert(all.end(), in.begin() + 30, in.end());
    against_winding(all, 6, SVO_SURFACE_CONSERVATIVE, "an open cavity", 5);
}

TEST(real_damaged_models)
{
    const char *const models[] = {"B_damaged/many_small_holes/many_small_holes.ply", "B_damaged/mech_holes_shark/mech-holes-shark.off", "A_organic/chinese_dragon_10kv/ChineseDragon-10kv.off"};
    int found = 0;
    for (const char *m : models) {
        const char *path = test_model(m);
        if (path == nullptr) continue;
        found++;
        Soup s = load(path);
        if (test_failed()) return;
        against_winding(s, 6, SVO_SURFACE_CONSERVATIVE, m, 200);
    }
    if (found == 0) test_skip("no real models");
}

} // namespace
