// The voxel set against CGAL's exact kernel: every voxel of small grids, every triangle after the snap, do_intersect on
// rational numbers. Triangles that are segments or points after the snap are given to CGAL as what they are.
#include <CGAL/Gmpq.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/intersections.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "fmt_import.h"
#include "svo_bin.h"
#include "svo_raster.h"
#include "voxel_set.h"

namespace {

using K = CGAL::Simple_cartesian<CGAL::Gmpq>;
using P = K::Point_3;
using Box = K::Iso_cuboid_3;

struct Oracle {
    enum Kind { POINT, SEGMENT, TRIANGLE } kind;
    P p[3];
    explicit Oracle(const int32_t q[3][3])
    {
        for (int i = 0; i < 3; i++) p[i] = P(q[i][0], q[i][1], q[i][2]);
        if (p[0] == p[1] && p[1] == p[2]) {
            kind = POINT;
        } else if (CGAL::collinear(p[0], p[1], p[2])) {
            kind = SEGMENT;
            std::sort(p, p + 3, [](const P &a, const P &b) { return CGAL::lexicographically_xyz_smaller(a, b); });
        } else {
            kind = TRIANGLE;
        }
    }
    bool meets(const Box &b) const
    {
        switch (kind) {
        case POINT: return !b.has_on_unbounded_side(p[0]);
        case SEGMENT: return CGAL::do_intersect(K::Segment_3(p[0], p[2]), b);
        default: return CGAL::do_intersect(K::Triangle_3(p[0], p[1], p[2]), b);
        }
    }
    bool meets(const K::Segment_3 &s) const
    {
        switch (kind) {
        case POINT: return s.has_on(p[0]);
        case SEGMENT: return CGAL::do_intersect(K::Segment_3(p[0], p[2]), s);
        default: return CGAL::do_intersect(K::Triangle_3(p[0], p[1], p[2]), s);
        }
    }
    bool cube(const int32_t a[3]) const { return meets(Box(P(a[0], a[1], a[2]), P(a[0] + 256, a[1] + 256, a[2] + 256))); }
    // one of the three lines through the centre of the voxel, from face to face
    bool cross(const int32_t a[3]) const
    {
        for (int k = 0; k < 3; k++) {
            int c[2][3];
            for (int i = 0; i < 3; i++) {
                c[0][i] = i == k ? a[i] : a[i] + 128;
                c[1][i] = i == k ? a[i] + 256 : a[i] + 128;
            }
            if (meets(K::Segment_3(P(c[0][0], c[0][1], c[0][2]), P(c[1][0], c[1][1], c[1][2])))) return true;
        }
        return false;
    }
};

// Independent of the library: v = (p - low) / (longest / 2^D), q = 2 floor(128 v) + 1, clamped.
void snap(const double p[3], const double low[3], double size, uint32_t depth, int32_t q[3])
{
    for (int i = 0; i < 3; i++) {
        double v = 2 * std::floor((p[i] - low[i]) / size * 128) + 1, most = std::ldexp(1.0, int(depth) + 8) - 1;
        q[i] = int32_t(std::min(std::max(v, 1.0), most));
    }
}

void check_mesh(const std::vector<double> &positions, uint32_t depth, svo_surface surface, const char *what)
{
    loose_mesh m;
    loose_make(&m, positions.data(), positions.size() / 9);
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = depth;
    o.surface = surface;
    o.channels = 0;
    o.threads = 2;
    voxel_set s;
    svo_error err = {};
    CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
    CHECK(s.ordered);
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, extent = 0;
    for (size_t i = 0; i < positions.size(); i++) {
        low[i % 3] = std::min(low[i % 3], positions[i]);
        high[i % 3] = std::max(high[i % 3], positions[i]);
    }
    for (int i = 0; i < 3; i++) extent = std::max(extent, high[i] - low[i]);
    double size = std::ldexp(extent > 0 ? extent : 1, -int(depth));
    const int32_t n = 1 << depth;
    std::vector<char> expected(size_t(n) * n * n, 0);
    for (size_t t = 0; t < positions.size() / 9; t++) {
        int32_t q[3][3], lo[3], hi[3];
        for (int c = 0; c < 3; c++) snap(&positions[9 * t + 3 * c], low, size, depth, q[c]);
        for (int k = 0; k < 3; k++) {
            lo[k] = std::max(0, std::min({q[0][k], q[1][k], q[2][k]}) / 256 - 1);
            hi[k] = std::min(n - 1, std::max({q[0][k], q[1][k], q[2][k]}) / 256 + 1);
        }
        Oracle oracle(q);
        for (int32_t z = lo[2]; z <= hi[2]; z++)
            for (int32_t y = lo[1]; y <= hi[1]; y++)
                for (int32_t x = lo[0]; x <= hi[0]; x++) {
                    char &e = expected[(size_t(z) * n + y) * n + x];
                    if (e) continue;
                    const int32_t a[3] = {x * 256, y * 256, z * 256}, b[3] = {a[0] + 256, a[1] + 256, a[2] + 256};
                    if (surface == SVO_SURFACE_CONSERVATIVE) {
                        e = oracle.cube(a);
                        CHECK_MSG(bool(e) == svo_raster_box(q, a, b), "%s: svo_raster_box", what);
                    } else {
                        e = oracle.cross(a);
                    }
                }
    }
    uint64_t count = 0;
    for (int32_t z = 0; z < n; z++)
        for (int32_t y = 0; y < n; y++)
            for (int32_t x = 0; x < n; x++) {
                bool e = expected[(size_t(z) * n + y) * n + x], found = voxel_find(&s, svo_morton_encode(x, y, z)) >= 0;
                count += e;
                CHECK_MSG(e == found, "%s, depth %u, surface %d: voxel %d %d %d is %d, expected %d", what, depth, int(surface), x, y, z, found, e);
            }
    CHECK_U64(count, s.count);
    CHECK_U64(count, s.report.counts.nodes[depth]);
    voxel_free(&s);
    loose_free(&m);
}

void corner(std::vector<double> &v, double x, double y, double z)
{
    v.push_back(x);
    v.push_back(y);
    v.push_back(z);
}

std::vector<double> random_triangles(uint64_t seed, int count, double size)
{
    std::vector<double> v;
    for (int i = 0; i < count; i++) {
        double c[3];
        for (double &x : c) x = test_random_unit(&seed);
        for (int k = 0; k < 3; k++) {
            double x = c[0] + size * test_random_unit(&seed), y = c[1] + size * test_random_unit(&seed), z = c[2] + size * test_random_unit(&seed);
            corner(v, x, y, z);
        }
    }
    return v;
}

void both(const std::vector<double> &v, uint32_t depth, const char *what)
{
    check_mesh(v, depth, SVO_SURFACE_CONSERVATIVE, what);
    if (!test_failed()) check_mesh(v, depth, SVO_SURFACE_THIN, what);
}

// The placed triangles of a model as the importer gives them.
std::vector<double> model_triangles(const char *path)
{
    std::vector<double> v;
    svo_mesh mesh;
    svo_error err = {};
    fmt_import_options o = {};
    o.skip_images = true;
    if (fmt_import_mesh(path, &o, &mesh, &err) != SVO_OK) return v;
    for (uint32_t i = 0; i < mesh.instance_count; i++) {
        const svo_shape &shape = mesh.shapes[mesh.instances[i].shape];
        for (uint32_t p = 0; p < shape.part_count; p++)
            for (uint64_t c = 0; c < 3 * shape.parts[p].triangle_count; c++) {
                const double *q = shape.parts[p].positions + 3 * uint64_t(shape.parts[p].indices[c]);
                svo_vec3 w = svo_mat4_point(&mesh.instances[i].transform, svo_v3(q[0], q[1], q[2]));
                corner(v, w.x, w.y, w.z);
            }
    }
    svo_mesh_free(&mesh);
    return v;
}

TEST(real_models)
{
    const char *const models[] = {"C_textured/spot_cow/spot_triangulated.obj", "B_damaged/boeing/boeing.off", "B_damaged/busted/busted.STL",
                                  "B_damaged/many_small_holes/many_small_holes.ply"};
    for (const char *name : models) {
        const char *path = test_model(name);
        if (path == nullptr) {
            test_skip("%s is not there (SVOKIT_MODELS)", name);
            return;
        }
        std::vector<double> v = model_triangles(path);
        CHECK_MSG(v.size() > 9 * 1000, "%s: %zu triangles", name, v.size() / 9);
        check_mesh(v, 5, SVO_SURFACE_CONSERVATIVE, name);
        if (!test_failed()) check_mesh(v, 4, SVO_SURFACE_THIN, name);
        if (test_failed()) return;
    }
}

TEST(random_triangles_of_all_sizes)
{
    for (uint32_t depth = 0; depth <= 5 && !test_failed(); depth++)
        for (int k = 0; k < 4 && !test_failed(); k++)
            both(random_triangles(depth * 10 + k, 6, k == 0 ? 1 : k == 1 ? 0.3 : k == 2 ? 0.05 : 0.001), depth, "random");
    if (!test_failed()) both(random_triangles(7, 2, 1), 6, "random, large");
}

TEST(one_triangle_at_a_time)
{
    for (int k = 0; k < 24 && !test_failed(); k++) both(random_triangles(1000 + k, 1, 1), 4, "single");
}

TEST(axis_aligned_and_on_grid_planes)
{
    // corners on multiples of 1/16 of the extent: grid planes, edges and corners everywhere
    uint64_t seed = 5;
    for (int k = 0; k < 9 && !test_failed(); k++) {
        std::vector<double> v;
        corner(v, 0, 0, 0); // fixes the extent
        corner(v, 16, 0, 0);
        corner(v, 0, 16, 16);
        for (int i = 0; i < 4; i++) {
            int axis = int(test_random(&seed) % 4);
            double plane = double(test_random(&seed) % 17);
            for (int c = 0; c < 3; c++) {
                double p[3];
                for (double &x : p) x = double(test_random(&seed) % 17);
                if (axis < 3) p[axis] = plane;
                corner(v, p[0], p[1], p[2]);
            }
        }
        both(v, 3 + k % 3, "on the grid");
    }
}

TEST(diagonal_planes_through_corners_of_voxels)
{
    // x - y, x + z ... constant: the plane passes exactly through voxel corners, every column is a tie
    uint64_t seed = 11;
    for (int k = 0; k < 9 && !test_failed(); k++) {
        std::vector<double> v;
        corner(v, 0, 0, 0);
        corner(v, 32, 0, 32);
        corner(v, 32, 32, 0);
        for (int i = 0; i < 3; i++) {
            double d = double(test_random(&seed) % 9);
            for (int c = 0; c < 3; c++) {
                double x = double(test_random(&seed) % 24), z = double(test_random(&seed) % 32);
                corner(v, x, x + d, k % 3 == 0 ? std::fmod(z + x, 32) : k % 2 ? z : x);
            }
        }
        both(v, 4 + k % 2, "diagonal");
    }
}

TEST(degenerate_triangles)
{
    uint64_t seed = 3;
    for (int k = 0; k < 9 && !test_failed(); k++) {
        std::vector<double> v;
        corner(v, 0, 0, 0);
        corner(v, 0, 0, 0);
        corner(v, 1, 1, 1); // a segment through voxel corners
        for (int i = 0; i < 5; i++) {
            double a[3], b[3];
            for (int c = 0; c < 3; c++) {
                a[c] = double(test_random(&seed) % 17) / 16;
                b[c] = k % 2 ? test_random_unit(&seed) : double(test_random(&seed) % 17) / 16;
            }
            double t = i % 3 == 0 ? 0.5 : i % 3 == 1 ? 0 : 1;
            corner(v, a[0], a[1], a[2]);
            corner(v, b[0], b[1], b[2]);
            corner(v, a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2]));
            for (int c = 0; c < 3; c++) corner(v, b[2], b[1], b[0]); // a point
        }
        both(v, 2 + k % 4, "degenerate");
    }
}

TEST(needles)
{
    uint64_t seed = 17;
    for (int k = 0; k < 8 && !test_failed(); k++) {
        std::vector<double> v;
        corner(v, 0, 0, 0);
        corner(v, 1, 0, 0);
        corner(v, 0, 1, 1);
        for (int i = 0; i < 4; i++) {
            double a[3], b[3];
            for (int c = 0; c < 3; c++) a[c] = test_random_unit(&seed), b[c] = test_random_unit(&seed);
            corner(v, a[0], a[1], a[2]);
            corner(v, b[0], b[1], b[2]);
            double thin = k % 2 ? 1e-12 : 0.01;
            corner(v, b[0] + thin, b[1] - thin, b[2]);
        }
        both(v, 3 + k % 3, "needle");
    }
}

TEST(extreme_extents_and_offsets)
{
    for (double scale : {1e-30, 1.0, 1e30})
        for (double offset : {0.0, 1e9}) {
            if (test_failed()) return;
            std::vector<double> v = random_triangles(23, 5, 0.5);
            for (double &x : v) x = (offset != 0 ? 1e-3 * x + offset : x) * scale;
            both(v, 4, "extreme");
        }
}

TEST(one_flat_axis)
{
    for (int axis = 0; axis < 3 && !test_failed(); axis++) {
        std::vector<double> v = random_triangles(31 + axis, 5, 0.5);
        for (size_t i = size_t(axis); i < v.size(); i += 3) v[i] = 0.25;
        both(v, 4, "flat");
    }
}

struct Found { std::vector<uint8_t> voxels; };

void mark(void *user, const svo_raster_row *r)
{
    Found &f = *static_cast<Found *>(user);
    for (int32_t a = r->u0; a <= r->u1; a++)
        for (int32_t w = r->lo[a]; w <= r->hi[a]; w++) {
            int32_t x[3];
            x[r->u] = a, x[r->v] = r->at_v, x[r->w] = w;
            f.voxels[(size_t(x[2]) * 128 + x[1]) * 128 + x[0]]++;
        }
}

// Blocks of deep grids, with triangles of up to 2^29 lattice units: against svo_raster_box, which the tests above compare
// with CGAL, and against CGAL itself at random voxels.
TEST(blocks_of_deep_grids)
{
    uint64_t seed = 99;
    Found found;
    for (int k = 0; k < 54 && !test_failed(); k++) {
        int32_t q[3][3], block[3];
        int bits = 12 + k % 18;
        for (int c = 0; c < 3; c++)
            for (int i = 0; i < 3; i++) q[c][i] = int32_t(test_random(&seed) >> (64 - bits)) | 1;
        if (k >= 36) // nearly in a plane x + y = const
            for (int c = 0; c < 3; c++) q[c][1] = std::max(1, (1 << bits) - q[c][0]) | 1;
        double u = test_random_unit(&seed), v = (1 - u) * test_random_unit(&seed);
        for (int i = 0; i < 3; i++) { // the block that holds a point of the triangle
            double p = q[0][i] + u * (double(q[1][i]) - q[0][i]) + v * (double(q[2][i]) - q[0][i]);
            block[i] = (int32_t(p) >> 15) << 15;
        }
        for (int c = 0; c < 3; c++)
            for (int i = 0; i < 3; i++) q[c][i] -= block[i];
        const int32_t lo[3] = {0, 0, 0}, hi[3] = {127, 127, 127};
        found.voxels.assign(128 * 128 * 128, 0);
        svo_raster_target cube = svo_raster_cube();
        svo_raster_scan(q, &cube, lo, hi, mark, &found);
        Oracle oracle(q);
        uint64_t met = 0;
        for (int32_t z = 0; z < 128; z++)
            for (int32_t y = 0; y < 128; y++)
                for (int32_t x = 0; x < 128; x++) {
                    int n = found.voxels[(size_t(z) * 128 + y) * 128 + x];
                    const int32_t a[3] = {x * 256, y * 256, z * 256}, b[3] = {a[0] + 256, a[1] + 256, a[2] + 256};
                    CHECK_MSG(n == int(svo_raster_box(q, a, b)), "block of a %d-bit triangle: voxel %d %d %d is marked %d times", bits, x, y, z, n);
                    met += uint64_t(n);
                    if (test_random(&seed) % (n ? 64 : 65536) == 0)
                        CHECK_MSG(oracle.cube(a) == bool(n), "CGAL disagrees at %d %d %d", x, y, z);
                }
        CHECK(met > 0);
    }
}

// The whole set of deep grids against CGAL: small triangles and long slivers all over a grid whose corners two points hold, so that coordinates
// of every size occur. The same set for another order of triangles, other threads and from ranges of chunks.
struct Grid { std::vector<double> v; std::vector<uint64_t> expected; };

Grid deep_grid(uint32_t depth, svo_surface surface, uint64_t *seed)
{
    Grid g;
    const double voxel = std::ldexp(1.0, -int(depth));
    for (int k = 0; k < 3; k++) corner(g.v, 0, 0, 0);
    for (int k = 0; k < 3; k++) corner(g.v, 1, 1, 1);
    for (int i = 0; i < 7; i++) {
        double c[3], size[3];
        const int along = i - 4;
        for (int k = 0; k < 3; k++) size[k] = std::min(0.5, (i < 4 ? 1 << i : along == k ? 200 : 1.2) * voxel);
        for (int k = 0; k < 3; k++) { // everywhere, at the far end, and beside a plane between chunks
            double where = i % 3 == 0 ? test_random_unit(seed) : i % 3 == 1 ? 1 - voxel : 0.5 - voxel;
            c[k] = std::min(where, 1 - size[k]);
        }
        for (int p = 0; p < 3; p++) {
            double q[3];
            for (int k = 0; k < 3; k++) q[k] = c[k] + size[k] * test_random_unit(seed);
            corner(g.v, q[0], q[1], q[2]);
        }
    }
    const double low[3] = {0, 0, 0};
    const int32_t n = int32_t(1) << depth;
    for (size_t t = 0; t < g.v.size() / 9; t++) {
        int32_t q[3][3], lo[3], hi[3];
        for (int c = 0; c < 3; c++) snap(&g.v[9 * t + 3 * c], low, voxel, depth, q[c]);
        for (int k = 0; k < 3; k++) {
            lo[k] = std::max(0, std::min({q[0][k], q[1][k], q[2][k]}) / 256 - 1);
            hi[k] = std::min(n - 1, std::max({q[0][k], q[1][k], q[2][k]}) / 256 + 1);
        }
        Oracle oracle(q);
        for (int32_t z = lo[2]; z <= hi[2]; z++)
            for (int32_t y = lo[1]; y <= hi[1]; y++)
                for (int32_t x = lo[0]; x <= hi[0]; x++) {
                    const int32_t a[3] = {x * 256, y * 256, z * 256};
                    if (surface == SVO_SURFACE_CONSERVATIVE ? oracle.cube(a) : oracle.cross(a)) g.expected.push_back(svo_morton_encode(x, y, z));
                }
    }
    std::sort(g.expected.begin(), g.expected.end());
    g.expected.erase(std::unique(g.expected.begin(), g.expected.end()), g.expected.end());
    return g;
}

std::vector<uint64_t> voxels_of(const std::vector<double> &v, const svo_voxelize_options &o)
{
    loose_mesh m;
    loose_make(&m, v.data(), v.size() / 9);
    voxel_set s;
    svo_error err = {};
    std::vector<uint64_t> codes;
    if (voxel_run(&m.mesh, &o, true, &s, &err) == SVO_OK && s.ordered) codes.assign(s.codes, s.codes + s.count);
    voxel_free(&s);
    loose_free(&m);
    return codes;
}

TEST(every_depth)
{
    uint64_t seed = 41;
    for (uint32_t depth = 1; depth <= SVO_MAX_DEPTH && !test_failed(); depth++)
        for (int surface = 0; surface < 2; surface++) {
            Grid g = deep_grid(depth, svo_surface(surface), &seed);
            svo_voxelize_options o = svo_default_voxelize_options();
            o.depth = depth;
            o.surface = svo_surface(surface);
            o.channels = 0;
            o.threads = 2;
            std::vector<uint64_t> found = voxels_of(g.v, o);
            CHECK_U64(g.expected.size(), found.size());
            CHECK_MSG(found == g.expected, "depth %u, surface %d: other voxels than CGAL's", depth, surface);
            std::vector<double> turned;
            for (size_t t = g.v.size() / 9; t-- > 0;)
                for (int c = 2; c >= 0; c--) turned.insert(turned.end(), &g.v[9 * t + 3 * c], &g.v[9 * t + 3 * c] + 3);
            o.threads = 1 + depth % 4;
            CHECK_MSG(voxels_of(turned, o) == found, "depth %u, surface %d: the order of triangles or corners matters", depth, surface);
            const uint64_t chunks = uint64_t(1) << 3 * svo_chunk_level(depth), cut = found[found.size() / 2] >> 3 * (depth - svo_chunk_level(depth));
            o.has_range = true;
            std::vector<uint64_t> parts;
            for (int i = 0; i < 2; i++) {
                o.first_code = i == 0 ? 0 : cut;
                o.end_code = i == 0 ? cut : chunks;
                std::vector<uint64_t> part = voxels_of(g.v, o);
                parts.insert(parts.end(), part.begin(), part.end());
            }
            CHECK_MSG(parts == found, "depth %u, surface %d: ranges of chunks give something else", depth, surface);
        }
}

} // namespace
