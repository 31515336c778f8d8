// Edges split by OpenMesh, the longest first, in place of skel_tessellate.c. In a library of its own, which svo-skeleton alone links, so that libsvoskel needs no OpenMesh.
#include "cxx_guard.hpp"
#include "skel_repair.h"

#ifdef SVO_HAVE_OPENMESH
#include <OpenMesh/Core/System/omstream.hh>

#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>

#include <cmath>
#include <queue>
#include <vector>

namespace {

struct traits : OpenMesh::DefaultTraits {
    using Point = OpenMesh::Vec3d;
    using Normal = OpenMesh::Vec3d;
    VertexAttributes(OpenMesh::Attributes::None);
    FaceAttributes(OpenMesh::Attributes::None);
    EdgeAttributes(OpenMesh::Attributes::None);
    HalfedgeAttributes(OpenMesh::Attributes::PrevHalfedge);
};
using mesh_type = OpenMesh::TriMesh_ArrayKernelT<traits>;

// A vertex with its share of three edges and two faces, what growing arrays hold twice for a while, and of the queue.
constexpr uint64_t bytes_per_point = 600;

struct long_edge {
    double squared;
    int edge;
    bool operator<(const long_edge &o) const { return squared != o.squared ? squared < o.squared : edge > o.edge; }
};

double squared_length(const mesh_type &m, OpenMesh::EdgeHandle e)
{
    auto h = m.halfedge_handle(e, 0);
    return (m.point(m.to_vertex_handle(h)) - m.point(m.from_vertex_handle(h))).sqrnorm();
}

[[noreturn]] void too_many(uint64_t max_points)
{
    svo_throw(SVO_LIMIT, "edges below omega need more than %llu vertices; choose a larger omega or raise the limit on vertices", static_cast<unsigned long long>(max_points));
}

} // namespace

extern "C" bool skel_have_openmesh(void) { return true; }

extern "C" svo_result skel_split_openmesh(skel_prepared *p, double length, uint64_t max_points, uint64_t memory, skel_split_report *out, svo_error *err)
{
    return svo_guard(err, [&] {
        const double since = svo_seconds();
        skel_split_report report = {};
        const svo_part &part = p->part;
        if (max_points > INT32_MAX - 1) max_points = INT32_MAX - 1;
        if (memory != 0 && max_points > memory / bytes_per_point) max_points = memory / bytes_per_point;
        if (part.vertex_count > max_points) too_many(max_points);
        omerr().disable(); // it says of every triangle that it is refused
        mesh_type m;
        m.reserve(part.vertex_count, 3 * part.triangle_count / 2, part.triangle_count);
        for (uint64_t i = 0; i < part.vertex_count; i++) m.add_vertex(OpenMesh::Vec3d(part.positions[3 * i], part.positions[3 * i + 1], part.positions[3 * i + 2]));
        std::vector<OpenMesh::VertexHandle> corner(3);
        for (uint64_t t = 0; t < part.triangle_count; t++) {
            const uint32_t *c = part.indices + 3 * t;
            for (std::size_t k = 0; k < 3; k++) corner[k] = OpenMesh::VertexHandle(static_cast<int>(c[k]));
            const bool distinct = c[0] != c[1] && c[1] != c[2] && c[2] != c[0];
            if (distinct && m.add_face(corner).is_valid()) continue;
            report.triangles_apart++;
            if (m.n_vertices() + 3 > max_points) too_many(max_points);
            for (std::size_t k = 0; k < 3; k++) { // a point that nothing else has yet can stay
                if (m.is_isolated(corner[k]) && !(k > 0 && corner[k] == corner[0]) && !(k > 1 && corner[k] == corner[1])) continue;
                const OpenMesh::Vec3d at = m.point(corner[k]); // a copy: the points move while their array grows
                corner[k] = m.add_vertex(at);
            }
            if (!m.add_face(corner).is_valid()) svo_throw(SVO_RUNTIME, "--tessellate openmesh: a triangle of its own is refused");
        }
        const double least = length * length;
        std::priority_queue<long_edge> queue;
        auto look = [&](OpenMesh::EdgeHandle e) {
            const double l = squared_length(m, e);
            if (l >= least) queue.push({l, e.idx()});
        };
        for (auto e : m.edges()) look(e);
        while (!queue.empty()) {
            const long_edge top = queue.top();
            queue.pop();
            const OpenMesh::EdgeHandle e(top.edge);
            if (squared_length(m, e) != top.squared) continue; // it was split since then, and its half has its own entry
            if (m.n_vertices() >= max_points) too_many(max_points);
            auto h = m.halfedge_handle(e, 0);
            const auto v = m.split(e, 0.5 * (m.point(m.to_vertex_handle(h)) + m.point(m.from_vertex_handle(h))));
            report.splits++;
            for (auto around : m.ve_range(v)) look(around);
        }
        const uint64_t points = m.n_vertices(), triangles = m.n_faces();
        double *position = static_cast<double *>(svo_alloc(p->allocator, 3 * points, sizeof *position));
        uint32_t *index = static_cast<uint32_t *>(svo_alloc(p->allocator, 3 * triangles, sizeof *index));
        if (position == nullptr || index == nullptr) {
            svo_free(p->allocator, position, 3 * points, sizeof *position);
            svo_free(p->allocator, index, 3 * triangles, sizeof *index);
            throw std::bad_alloc();
        }
        for (uint64_t i = 0; i < points; i++)
            for (unsigned k = 0; k < 3; k++) position[3 * i + k] = m.point(OpenMesh::VertexHandle(static_cast<int>(i)))[k];
        uint64_t at = 0;
        for (auto f : m.faces())
            for (auto v : m.fv_range(f)) index[at++] = static_cast<uint32_t>(v.idx());
        skel_prepared_replace(p, position, points, index, triangles);
        report.seconds = svo_seconds() - since;
        *out = report;
        return SVO_OK;
    });
}
#else
extern "C" bool skel_have_openmesh(void) { return false; }

extern "C" svo_result skel_split_openmesh(skel_prepared *, double, uint64_t, uint64_t, skel_split_report *, svo_error *err)
{
    return svo_fail(err, SVO_UNSUPPORTED, "this svo-skeleton was built without OpenMesh (libopenmesh-dev, -DSVO_WITH_OPENMESH=ON); use --tessellate own");
}
#endif
