// CGAL's repair of polygon soups. CGAL's Polygon_mesh_processing is GPL, so this is in no library that is installed: svo-skeleton alone links it, where the
// build has it.
#include "cxx_guard.hpp"
#include "skel_repair.h"

#ifdef SVO_HAVE_CGAL
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/repair_polygon_soup.h>
#include <CGAL/Simple_cartesian.h>

#include <algorithm>
#include <array>
#include <vector>

namespace {

namespace pmp = CGAL::Polygon_mesh_processing;
using kernel = CGAL::Simple_cartesian<double>;
using point = kernel::Point_3;
using triangle = std::array<std::size_t, 3>;

// What one triangle takes at most while neighbours are found and turned: its share of sets of edges and of lists of triangles.
constexpr uint64_t bytes_per_triangle = 700;

struct counter : pmp::Default_orientation_visitor {
    counter(skel_repair_report *report, std::vector<std::array<std::size_t, 2>> *list) : out(report), edges(list) {}
    void non_manifold_edge(std::size_t a, std::size_t b, std::size_t) { edges->push_back({std::min(a, b), std::max(a, b)}); } // told more than once
    void non_manifold_vertex(std::size_t, std::size_t) { out->vertices_nonmanifold++; }
    void polygon_orientation_reversed(std::size_t) { out->triangles_turned++; }
    skel_repair_report *out;
    std::vector<std::array<std::size_t, 2>> *edges;
};

// A block of the allocator that goes back unless it is handed on.
template <class T> struct block {
    block(const svo_allocator *a, uint64_t n) : allocator(a), count(n), data(static_cast<T *>(svo_alloc(a, n, sizeof(T))))
    {
        if (data == nullptr) throw std::bad_alloc();
    }
    block(const block &) = delete;
    block &operator=(const block &) = delete;
    ~block() { svo_free(allocator, data, count, sizeof(T)); }
    T *release()
    {
        T *d = data;
        data = nullptr;
        return d;
    }
    const svo_allocator *allocator;
    uint64_t count;
    T *data;
};

bool before(const double *a, const double *b) { return a[0] != b[0] ? a[0] < b[0] : a[1] != b[1] ? a[1] < b[1] : a[2] < b[2]; }

} // namespace

extern "C" bool skel_have_cgal(void) { return true; }

extern "C" svo_result skel_repair_cgal(skel_prepared *p, uint64_t memory, skel_repair_report *out, svo_error *err)
{
    return svo_guard(err, [&] {
        const double since = svo_seconds();
        skel_repair_report report = {};
        const svo_part &part = p->part;
        const uint64_t places = p->places;
        if (memory != 0 && part.triangle_count > memory / bytes_per_triangle)
            return svo_fail(err, SVO_LIMIT, "--repair cgal of %llu triangles takes up to %llu MB, which is more than --memory leaves; use --repair own",
                            static_cast<unsigned long long>(part.triangle_count), static_cast<unsigned long long>(part.triangle_count * bytes_per_triangle >> 20));
        std::vector<point> points;
        points.reserve(places);
        for (uint64_t i = 0; i < places; i++) points.emplace_back(part.positions[3 * i], part.positions[3 * i + 1], part.positions[3 * i + 2]);
        std::vector<triangle> triangles(part.triangle_count);
        for (uint64_t t = 0; t < part.triangle_count; t++) triangles[t] = {part.indices[3 * t], part.indices[3 * t + 1], part.indices[3 * t + 2]};
        auto line = [](const triangle &t) { return t[0] == t[1] || t[1] == t[2] || t[2] == t[0]; };
        auto end = std::remove_if(triangles.begin(), triangles.end(), line);
        report.triangles_degenerate = static_cast<uint64_t>(triangles.end() - end);
        triangles.erase(end, triangles.end());
        if (triangles.empty()) return svo_fail(err, SVO_INVALID_DATA, "--repair cgal leaves nothing: all triangles have two corners at one place; use --repair own");
        report.triangles_duplicate = pmp::merge_duplicate_polygons_in_polygon_soup(points, triangles);
        report.points_unused = pmp::remove_isolated_points_in_polygon_soup(points, triangles);
        const std::size_t sound = points.size();
        std::vector<std::array<std::size_t, 2>> edges;
        pmp::orient_polygon_soup(points, triangles, CGAL::parameters::visitor(counter(&report, &edges)));
        std::sort(edges.begin(), edges.end());
        report.edges_nonmanifold = static_cast<uint64_t>(std::unique(edges.begin(), edges.end()) - edges.begin());
        report.points_added = points.size() - sound;
        report.manifold = pmp::is_polygon_soup_a_polygon_mesh(triangles);

        // Back to the places, which are sorted; then what was added where the surface was cut apart.
        const uint64_t total = places + report.points_added;
        if (total >= INT32_MAX) return svo_fail(err, SVO_LIMIT, "--repair cgal makes more than 2^31 points of the model; use --repair own");
        block<double> position(p->allocator, 3 * total);
        block<uint32_t> corner(p->allocator, 3 * triangles.size());
        std::copy(part.positions, part.positions + 3 * places, position.data);
        std::vector<uint32_t> where(points.size());
        for (std::size_t i = 0; i < points.size(); i++) {
            const double x[3] = {points[i].x(), points[i].y(), points[i].z()};
            uint64_t low = 0, high = places;
            while (low < high) {
                const uint64_t middle = (low + high) / 2;
                if (before(position.data + 3 * middle, x)) low = middle + 1;
                else high = middle;
            }
            if (low == places || before(x, position.data + 3 * low)) svo_throw(SVO_RUNTIME, "--repair cgal: a point of the model moved");
            if (i >= sound) {
                low = places + (i - sound);
                std::copy(x, x + 3, position.data + 3 * low);
            }
            where[i] = static_cast<uint32_t>(low);
        }
        for (std::size_t t = 0; t < triangles.size(); t++)
            for (std::size_t k = 0; k < 3; k++) corner.data[3 * t + k] = where[triangles[t][k]];
        skel_prepared_replace(p, position.release(), total, corner.release(), triangles.size());
        report.seconds = svo_seconds() - since;
        *out = report;
        return SVO_OK;
    });
}
#else
extern "C" bool skel_have_cgal(void) { return false; }

extern "C" svo_result skel_repair_cgal(skel_prepared *, uint64_t, skel_repair_report *, svo_error *err)
{
    return svo_fail(err, SVO_UNSUPPORTED, "this svo-skeleton was built without CGAL (libcgal-dev, -DSVO_WITH_CGAL=ON); use --repair own");
}
#endif
