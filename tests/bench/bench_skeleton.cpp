// Curves of this library beside those of CGAL's Mean_curvature_flow_skeletonization, measured by the same code (skel_measure_quality), as CSV.
//
//     bench_skeleton [--cgal] [--stability] [--method fast|literal] [--save FOLDER] OMEGA[,OMEGA...] MODEL...
//
// OMEGA may be "default". With --stability the model is turned, given noise and divided, and rows are: model,omega,change,hausdorff,mean,loops,ends, distances in percent of
// the model's unit (about its longest side) after the change was undone, loops and ends before and after. Otherwise rows: model,triangles,genus,tool,cpu_s,joints,components,ends,branches,loops,inside,balls_mean,balls_max,off_centre,sweeps
// cpu_s: user and system seconds of this process for the curve alone (one thread, no reading, no measuring); inside: percent of the curve's length; balls: surface
// to the union of the inscribed balls, percent of the bounding box's diagonal; off_centre: the median.
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/repair_polygon_soup.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/boost/graph/helpers.h>
#include <CGAL/extract_mean_curvature_flow_skeleton.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <cmath>
#include <cstring>
#include <ctime>
#include <map>
#include <string>
#include <vector>

#include "fmt_import.h"
#include "skel_build.h"

namespace {

using K = CGAL::Simple_cartesian<double>;
using Mesh = CGAL::Surface_mesh<K::Point_3>;
using Curve = CGAL::Mean_curvature_flow_skeletonization<Mesh>::Skeleton;

double seconds(clock_t since) { return static_cast<double>(clock() - since) / CLOCKS_PER_SEC; }

struct Row {
    std::string model, tool;
    std::size_t triangles;
    double cpu;
    skel_skeleton curve;
    skel_quality quality;
};

void print(const Row &r)
{
    const skel_report &c = r.curve.report;
    const skel_quality &q = r.quality;
    std::string genus = q.genus_known ? std::to_string(q.genus) : "open";
    std::printf("%s,%zu,%s,%s,%.2f,%u,%u,%u,%u,%u,%.2f,%.3f,%.2f,%.3f,%llu\n", r.model.c_str(), r.triangles, genus.c_str(), r.tool.c_str(), r.cpu, r.curve.joint_count, c.components,
                c.ends, c.branches, c.loops, q.length_inside, q.balls_mean, q.balls_max, q.off_centre_median, static_cast<unsigned long long>(c.iterations));
    std::fflush(stdout);
}

// What skel_measure_quality does not count: the graph.
void count(skel_skeleton &s)
{
    std::vector<uint32_t> degree(s.joint_count), parent(s.joint_count);
    for (uint32_t j = 0; j < s.joint_count; j++) parent[j] = j;
    auto root = [&](uint32_t j) {
        while (parent[j] != j) j = parent[j] = parent[parent[j]];
        return j;
    };
    s.report.components = s.joint_count;
    for (uint32_t b = 0; b < s.bone_count; b++) {
        uint32_t x = root(s.bones[b].a), y = root(s.bones[b].b);
        degree[s.bones[b].a]++;
        degree[s.bones[b].b]++;
        if (x == y) continue;
        parent[x] = y;
        s.report.components--;
    }
    s.report.loops = s.bone_count + s.report.components - s.joint_count;
    for (uint32_t d : degree) {
        s.report.ends += d == 1;
        s.report.branches += d > 2;
    }
}

void save(const char *folder, const Row &r)
{
    if (folder == nullptr) return;
    std::string path = std::string(folder) + "/" + r.model + "." + r.tool + ".obj";
    FILE *f = std::fopen(path.c_str(), "w");
    if (f == nullptr) return;
    for (uint32_t j = 0; j < r.curve.joint_count; j++)
        std::fprintf(f, "v %.9g %.9g %.9g\n", r.curve.joints[j].position[0], r.curve.joints[j].position[1], r.curve.joints[j].position[2]);
    for (uint32_t b = 0; b < r.curve.bone_count; b++) std::fprintf(f, "l %u %u\n", r.curve.bones[b].a + 1, r.curve.bones[b].b + 1);
    std::fclose(f);
}

std::size_t triangles_of(const svo_mesh &m)
{
    std::size_t n = 0;
    for (uint32_t i = 0; i < m.instance_count; i++)
        for (uint32_t p = 0; p < m.shapes[m.instances[i].shape].part_count; p++) n += m.shapes[m.instances[i].shape].parts[p].triangle_count;
    return n;
}

// The first shape as CGAL's mesh, its soup repaired and oriented. CGAL's skeleton needs it closed and in one component.
bool cgal_mesh(const svo_mesh &m, Mesh &out)
{
    std::vector<K::Point_3> points;
    std::vector<std::vector<std::size_t>> faces;
    for (uint32_t p = 0; p < m.shapes[0].part_count; p++) {
        const svo_part &part = m.shapes[0].parts[p];
        std::size_t base = points.size();
        for (uint64_t v = 0; v < part.vertex_count; v++) points.emplace_back(part.positions[3 * v], part.positions[3 * v + 1], part.positions[3 * v + 2]);
        for (uint64_t t = 0; t < part.triangle_count; t++)
            faces.push_back({base + part.indices[3 * t], base + part.indices[3 * t + 1], base + part.indices[3 * t + 2]});
    }
    namespace PMP = CGAL::Polygon_mesh_processing;
    PMP::repair_polygon_soup(points, faces);
    PMP::orient_polygon_soup(points, faces);
    if (!PMP::is_polygon_soup_a_polygon_mesh(faces)) return false;
    PMP::polygon_soup_to_polygon_mesh(points, faces, out);
    return CGAL::is_closed(out);
}

void run_cgal(const std::string &name, const svo_mesh &mesh, const char *folder)
{
    Mesh m;
    if (!cgal_mesh(mesh, m)) {
        std::fprintf(stderr, "%s: no closed mesh for CGAL\n", name.c_str());
        return;
    }
    clock_t since = clock();
    Curve curve;
    CGAL::extract_mean_curvature_flow_skeleton(m, curve);
    double cpu = seconds(since);
    std::vector<skel_joint> joints;
    std::vector<skel_bone> bones;
    for (auto v : CGAL::make_range(vertices(curve))) {
        skel_joint j = {};
        j.position[0] = curve[v].point.x();
        j.position[1] = curve[v].point.y();
        j.position[2] = curve[v].point.z();
        joints.push_back(j);
    }
    for (auto e : CGAL::make_range(edges(curve))) {
        auto a = static_cast<uint32_t>(source(e, curve)), b = static_cast<uint32_t>(target(e, curve));
        bones.push_back({std::min(a, b), std::max(a, b)});
    }
    Row r{name, "cgal", triangles_of(mesh), cpu, {}, {}};
    r.curve.joint_count = static_cast<uint32_t>(joints.size());
    r.curve.bone_count = static_cast<uint32_t>(bones.size());
    r.curve.joints = joints.data();
    r.curve.bones = bones.data();
    count(r.curve);
    svo_error err = {};
    if (skel_measure_quality(&mesh, &r.curve, 1, nullptr, &r.quality, &err) != SVO_OK) {
        std::fprintf(stderr, "%s: %s\n", name.c_str(), err.message);
        return;
    }
    print(r);
    save(folder, r);
}

void run_ours(const std::string &name, const svo_mesh &mesh, const std::string &omega, skel_method method, const char *folder)
{
    skel_options o = skel_default_options();
    if (omega != "default") o.omega = std::atof(omega.c_str());
    o.method = method;
    o.search = SKEL_SEARCH_GRID;
    o.threads = 1;
    o.skip_quality = true;
    svo_error err = {};
    Row r{name, omega, triangles_of(mesh), 0, {}, {}};
    clock_t since = clock();
    svo_result result = skel_build_mesh(&mesh, &o, &r.curve, &err);
    r.cpu = seconds(since);
    if (result == SVO_OK) result = skel_measure_quality(&mesh, &r.curve, 1, nullptr, &r.quality, &err);
    if (result != SVO_OK) {
        std::fprintf(stderr, "%s: %s\n", name.c_str(), err.message);
        return;
    }
    print(r);
    save(folder, r);
    skel_skeleton_free(&r.curve);
}

// --- the same shape otherwise ---

using Points = std::vector<std::array<double, 3>>;

void rotate(std::array<double, 3> &p, const std::array<double, 3> &axis, double degrees)
{
    double n = std::sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]), c = std::cos(degrees * M_PI / 180), s = std::sin(degrees * M_PI / 180), along = 0;
    std::array<double, 3> a, q;
    for (std::size_t k = 0; k < 3; k++) {
        a[k] = axis[k] / n;
        along += a[k] * p[k];
    }
    for (std::size_t k = 0; k < 3; k++) q[k] = p[k] * c + (a[(k + 1) % 3] * p[(k + 2) % 3] - a[(k + 2) % 3] * p[(k + 1) % 3]) * s + a[k] * along * (1 - c);
    p = q;
}

skel_skeleton curve_of(const Points &points, const std::vector<uint32_t> &triangles, double omega)
{
    skel_options o = skel_default_options();
    if (omega > 0) o.omega = omega;
    o.search = SKEL_SEARCH_GRID;
    o.skip_quality = true;
    svo_part part = {};
    part.material = SVO_NONE;
    part.vertex_count = points.size();
    part.triangle_count = triangles.size() / 3;
    part.positions = const_cast<double *>(points.data()->data());
    part.indices = const_cast<uint32_t *>(triangles.data());
    svo_shape shape = {};
    shape.part_count = 1;
    shape.parts = &part;
    svo_instance instance = {};
    instance.transform = svo_mat4_identity();
    svo_mesh mesh = {};
    mesh.shape_count = mesh.instance_count = 1;
    mesh.shapes = &shape;
    mesh.instances = &instance;
    skel_skeleton s = {};
    svo_error err = {};
    if (skel_build_mesh(&mesh, &o, &s, &err) != SVO_OK) {
        std::fprintf(stderr, "%s\n", err.message);
        std::exit(1);
    }
    return s;
}

void run_stability(const std::string &name, const svo_mesh &mesh, const std::string &omega, const char *folder)
{
    double w = omega == "default" ? 0 : std::atof(omega.c_str());
    Points points;
    std::vector<uint32_t> triangles;
    for (uint32_t p = 0; p < mesh.shapes[0].part_count; p++) {
        const svo_part &part = mesh.shapes[0].parts[p];
        auto base = static_cast<uint32_t>(points.size());
        for (uint64_t v = 0; v < part.vertex_count; v++) points.push_back({part.positions[3 * v], part.positions[3 * v + 1], part.positions[3 * v + 2]});
        for (uint64_t c = 0; c < 3 * part.triangle_count; c++) triangles.push_back(base + part.indices[c]);
    }
    skel_skeleton a = curve_of(points, triangles, w);
    save(folder, Row{name, omega, 0, 0, a, {}});
    auto compare = [&](const std::string &what, skel_skeleton &b) {
        skel_distance d;
        skel_curve_distance(&a, &b, &d);
        Row row{name, omega + " " + what, 0, 0, b, {}};
        save(folder, row);
        std::printf("%s,%s,%s,%.2f,%.3f,%u %u,%u %u\n", name.c_str(), omega.c_str(), what.c_str(), 100 * std::max(d.max[0], d.max[1]) / a.report.unit,
                    100 * std::max(d.mean[0], d.mean[1]) / a.report.unit, a.report.loops, b.report.loops, a.report.ends, b.report.ends);
        std::fflush(stdout);
        skel_skeleton_free(&b);
    };
    const std::array<double, 3> axes[] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0.3, -0.8, 0.52}};
    const double angles[] = {37, 37, 37, 101.3};
    const char *const names[] = {"37 about x", "37 about y", "37 about z", "101.3 about an odd axis"};
    for (int i = 0; i < 4; i++) {
        Points turned = points;
        for (auto &p : turned) rotate(p, axes[i], angles[i]);
        skel_skeleton b = curve_of(turned, triangles, w);
        for (uint32_t j = 0; j < b.joint_count; j++) {
            std::array<double, 3> p = {b.joints[j].position[0], b.joints[j].position[1], b.joints[j].position[2]};
            rotate(p, axes[i], -angles[i]);
            std::copy(p.begin(), p.end(), b.joints[j].position);
        }
        compare(names[i], b);
    }
    const double sizes[] = {1e-7, 1e-5, 0.001, 0.003, 0.01};
    for (double size : sizes) {
        Points noisy = points;
        uint64_t seed = 1;
        for (auto &p : noisy)
            for (double &x : p) {
                seed = seed * 6364136223846793005u + 1442695040888963407u;
                x += size * a.report.unit * (2 * static_cast<double>(seed >> 11) * 0x1p-53 - 1);
            }
        skel_skeleton b = curve_of(noisy, triangles, w);
        char what[64];
        std::snprintf(what, sizeof what, "noise %g %%", 100 * size);
        compare(what, b);
    }
    Points finer = points; // every triangle as four
    std::map<std::pair<uint32_t, uint32_t>, uint32_t> middles;
    std::vector<uint32_t> four;
    for (std::size_t t = 0; t < triangles.size(); t += 3) {
        uint32_t c[3], m[3];
        for (std::size_t k = 0; k < 3; k++) c[k] = triangles[t + k];
        for (int k = 0; k < 3; k++) {
            auto key = std::minmax(c[k], c[(k + 1) % 3]);
            auto found = middles.emplace(key, static_cast<uint32_t>(finer.size()));
            if (found.second) finer.push_back({(points[key.first][0] + points[key.second][0]) / 2, (points[key.first][1] + points[key.second][1]) / 2, (points[key.first][2] + points[key.second][2]) / 2});
            m[k] = found.first->second;
        }
        four.insert(four.end(), {c[0], m[0], m[2], m[0], c[1], m[1], m[2], m[1], c[2], m[0], m[1], m[2]});
    }
    skel_skeleton b = curve_of(finer, four, w);
    compare("4 times the triangles", b);
    skel_skeleton_free(&a);
}

} // namespace

int main(int argc, char **argv)
{
    bool cgal = false, stability = false;
    const char *folder = nullptr;
    skel_method method = SKEL_METHOD_FAST;
    int i = 1;
    for (; i < argc && std::strncmp(argv[i], "--", 2) == 0; i++) {
        if (std::strcmp(argv[i], "--cgal") == 0) cgal = true;
        else if (std::strcmp(argv[i], "--stability") == 0) stability = true;
        else if (std::strcmp(argv[i], "--save") == 0 && i + 1 < argc) folder = argv[++i];
        else if (std::strcmp(argv[i], "--method") == 0 && i + 1 < argc) method = std::strcmp(argv[++i], "literal") == 0 ? SKEL_METHOD_LITERAL : SKEL_METHOD_FAST;
        else break;
    }
    if (i + 1 >= argc) {
        std::fprintf(stderr, "usage: bench_skeleton [--cgal] [--stability] [--method fast|literal] [--save FOLDER] OMEGA[,OMEGA...] MODEL...\n");
        return 1;
    }
    std::vector<std::string> omegas;
    for (const char *p = argv[i++]; *p != 0;) {
        const char *end = std::strchr(p, ',');
        if (end == nullptr) end = p + std::strlen(p);
        omegas.emplace_back(p, end);
        p = *end == ',' ? end + 1 : end;
    }
    std::printf("%s\n", stability ? "model,omega,change,hausdorff,mean,loops,ends" : "model,triangles,genus,tool,cpu_s,joints,components,ends,branches,loops,inside,balls_mean,balls_max,off_centre,sweeps");
    for (; i < argc; i++) {
        svo_mesh mesh;
        svo_error err = {};
        fmt_import_options o = {};
        o.skip_images = true;
        if (fmt_import_mesh(argv[i], &o, &mesh, &err) != SVO_OK) {
            std::fprintf(stderr, "%s: %s\n", argv[i], err.message);
            continue;
        }
        std::string name = argv[i];
        name = name.substr(name.find_last_of('/') + 1);
        name = name.substr(0, name.find_last_of('.'));
        for (const std::string &omega : omegas)
            if (stability) run_stability(name, mesh, omega, folder);
            else if (omega != "none") run_ours(name, mesh, omega, method, folder);
        if (cgal) run_cgal(name, mesh, folder);
        svo_mesh_free(&mesh);
    }
    return 0;
}
