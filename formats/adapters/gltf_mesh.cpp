/* Primitives of a glTF mesh to parts: modes, indices, attributes, Draco, bind-pose skinning. */
#include "gltf_rig.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace
{

/* What a morph target adds to an attribute. */
struct displacement {
    std::unique_ptr<gltf_accessor> accessor;
    double weight;
};

/* The attributes of one primitive, wherever they come from. */
struct source {
    std::unique_ptr<gltf_accessor> accessor;
    std::vector<displacement> morphs;
    const draco_attribute *draco = nullptr;
    int draco_type = 0;
    bool draco_normalized = false;

    bool present() const { return accessor != nullptr || draco != nullptr; }
    int components() const { return draco != nullptr ? draco->components : accessor->components(); }
    void get(uint64_t i, double *out) const
    {
        if (draco == nullptr) {
            accessor->get(i, out);
        } else {
            for (int k = 0; k < draco->components; k++) {
                double v = static_cast<double>(draco->values[i * static_cast<uint64_t>(draco->components) + static_cast<uint64_t>(k)]);
                out[k] = draco->integral ? gltf_component_value(v, draco_type, draco_normalized) : v;
            }
        }
        for (const displacement &m : morphs) {
            double by[4];
            m.accessor->get(i, by);
            for (int k = 0; k < m.accessor->components(); k++) out[k] += m.weight * by[k];
        }
    }
};

/* All attributes that a part is made of. */
struct attributes {
    source positions, normals, uvs[SVO_MAX_UV_SETS], colors;
    struct binding { source joints, weights; };
    std::vector<binding> bindings;
};

struct primitive_reader {
    gltf_document &d;
    const tinygltf::Primitive &p;
    std::string where;
    const std::vector<double> &morph; /* weights of morph targets; those that are not there are 0 */
    const gltf_skinning *skinning;
    int index_accessor; /* -1: none */
    fmt_rig_part *rig_part; /* where influences go; NULL: vertices are skinned */

    uint64_t vertex_count = 0;
    std::vector<uint32_t> indices; /* of triangles, already unrolled */
    std::vector<draco_attribute> draco;
    uint64_t draco_points = 0;
    bool is_draco = false;
    gltf_reserve reserve, unpacked; /* indices; what Draco makes */

    [[noreturn]] void bad(const char *why) const { svo_throw(SVO_INVALID_DATA, "%s: %s: %s", d.path(), where.c_str(), why); }

    void decode_draco(const tinygltf::Value &extension)
    {
        is_draco = true;
        const tinygltf::Value &map = extension.Get("attributes");
        for (const auto &item : p.attributes) {
            if (!map.Has(item.first)) continue;
            draco_attribute a{};
            a.id = static_cast<uint32_t>(map.Get(item.first).GetNumberAsInt());
            draco.push_back(a);
        }
        uint64_t size = 0;
        const uint8_t *bytes = gltf_view_bytes(d, extension.Get("bufferView").GetNumberAsInt(), &size, nullptr);
        unpacked.take(d.context, draco_cost(d.path(), bytes, size), (where + ", as Draco data,").c_str());
        std::sort(draco.begin(), draco.end(), [](const draco_attribute &a, const draco_attribute &b) { return a.id < b.id; });
        draco_decode_mesh(d.path(), bytes, size, &indices, &draco_points, &draco);
        gltf_charge(d, draco_points + indices.size());
        d.total_bytes += draco_points; /* what Draco unpacked is data of the file, too */
    }

    /* NULL source when the primitive has no such attribute. */
    source find(const char *name, int min_components, int max_components)
    {
        source s;
        auto it = p.attributes.find(name);
        if (it == p.attributes.end()) return s;
        std::string what = where + ", " + name;
        if (is_draco) {
            const tinygltf::Value &map = p.extensions.at("KHR_draco_mesh_compression").Get("attributes");
            if (map.Has(name)) {
                uint32_t id = static_cast<uint32_t>(map.Get(name).GetNumberAsInt());
                for (const draco_attribute &a : draco)
                    if (a.id == id) s.draco = &a;
                const tinygltf::Accessor &a = d.model.accessors.at(static_cast<size_t>(it->second));
                s.draco_type = a.componentType;
                s.draco_normalized = a.normalized;
                if (s.draco->components < min_components || s.draco->components > max_components) bad("a Draco attribute has the wrong type");
                return s;
            }
        }
        s.accessor = std::make_unique<gltf_accessor>(d, it->second, what.c_str(), min_components, max_components);
        if (s.accessor->count() != vertex_count) bad("attributes have different lengths");
        if (s.accessor->component_type() == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT) bad("an attribute of 32-bit integers");
        return s;
    }

    const source &displaced(source &s, const char *name);
    void check_targets() const;
    std::unique_ptr<gltf_accessor> open_indices();
    uint64_t triangles_of(uint64_t n);
    template <class F> void unroll(uint64_t triangles, const gltf_accessor *from, F &&each);
    void read_indices();
    void check_range(const uint32_t *t, size_t n) const;
    bool prepare();
    void check();
    attributes open();
    void build(svo_part *part);
    void spill(svo_part *part);
    void fill(svo_part *part, const attributes &a, const std::vector<uint32_t> &keep, uint64_t n);
    std::vector<std::pair<uint32_t, double>> bound(const attributes &a, uint64_t vertex) const;
    void skin(svo_part *part, const attributes &a, const std::vector<uint32_t> &kept, uint64_t n);
    void influence(const attributes &a, const std::vector<uint32_t> &kept, uint64_t n);
};

/* Morph targets, those that have no weight too, have an element for each vertex. */
void primitive_reader::check_targets() const
{
    for (const auto &target : p.targets)
        for (const auto &item : target)
            if (d.model.accessors.at(static_cast<size_t>(item.second)).count != vertex_count) bad("a morph target has another number of vertices");
}

/* Add the morph targets of an attribute that have a weight (glTF 2.0, 3.7.2.2). */
const source &primitive_reader::displaced(source &s, const char *name)
{
    for (size_t i = 0; s.present() && i < p.targets.size() && i < morph.size(); i++) {
        auto it = p.targets[i].find(name);
        if (it == p.targets[i].end() || morph[i] == 0) continue;
        /* Targets of colours may lack alpha. */
        const int least = std::strcmp(name, "COLOR_0") == 0 ? 3 : s.components();
        auto a = std::make_unique<gltf_accessor>(d, it->second, (where + ", morph target " + std::to_string(i) + ", " + name).c_str(), least, s.components());
        if (a->component_type() == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT) bad("a morph target of 32-bit integers");
        gltf_charge(d, vertex_count); /* a file can name the same data in many targets */
        s.morphs.push_back({std::move(a), morph[i]});
    }
    return s;
}

/* The index accessor, NULL where vertices are taken in order. */
std::unique_ptr<gltf_accessor> primitive_reader::open_indices()
{
    if (index_accessor < 0) return nullptr;
    auto a = std::make_unique<gltf_accessor>(d, index_accessor, (where + ", indices").c_str(), 1, 1);
    int t = a->component_type();
    if (t != TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE && t != TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT && t != TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT)
        bad("indices are not unsigned integers");
    return a;
}

/* Triangles that n indices make. */
uint64_t primitive_reader::triangles_of(uint64_t n)
{
    if (n > UINT32_MAX) svo_throw(SVO_LIMIT, "%s: %s: more than 2^32 indices", d.path(), where.c_str());
    if (p.mode == TINYGLTF_MODE_TRIANGLES && n % 3 != 0)
        svo_warn(d.warnings(), "%s: %s: indices are no multiple of three; the rest is left out", d.path(), where.c_str());
    return p.mode == TINYGLTF_MODE_TRIANGLES ? n / 3 : n >= 3 ? n - 2 : 0;
}

/* Call each(corners) for the triangles that indices (from the accessor, or 0, 1, 2 ...) make. */
template <class F> void primitive_reader::unroll(uint64_t triangles, const gltf_accessor *from, F &&each)
{
    auto get = [&](uint64_t i) -> uint32_t { return from != nullptr ? from->get_index(i) : static_cast<uint32_t>(i); };
    gltf_charge(d, 3 * triangles);
    const bool list = p.mode == TINYGLTF_MODE_TRIANGLES, strip = p.mode == TINYGLTF_MODE_TRIANGLE_STRIP;
    for (uint64_t i = 0; i < triangles; i++) {
        /* Strips turn every second triangle; fans share vertex 0 (specification, 3.7.2.1). */
        uint64_t a = list ? 3 * i : strip ? i : 0, b = list ? 3 * i + 1 : strip ? i + 1 + (i & 1) : i + 1;
        uint64_t c = list ? 3 * i + 2 : strip ? i + 2 - (i & 1) : i + 2;
        const uint32_t t[3] = {get(a), get(b), get(c)};
        each(t);
    }
}

void primitive_reader::read_indices()
{
    if (is_draco) {
        if (p.mode == TINYGLTF_MODE_TRIANGLES || p.mode == TINYGLTF_MODE_TRIANGLE_STRIP) return; /* decoded as triangles in any case */
        bad("Draco data in a mode that is not triangles");
    }
    std::unique_ptr<gltf_accessor> a = open_indices();
    const uint64_t triangles = triangles_of(a != nullptr ? a->count() : vertex_count);
    reserve.take(d.context, 6 * triangles * sizeof(uint32_t), where.c_str()); /* also for the vertices to keep */
    indices.reserve(3 * triangles);
    unroll(triangles, a.get(), [this](const uint32_t *t) { indices.insert(indices.end(), t, t + 3); });
}

void primitive_reader::check_range(const uint32_t *t, size_t n) const
{
    for (size_t i = 0; i < n; i++)
        if (t[i] >= vertex_count)
            svo_throw(SVO_INVALID_DATA, "%s: %s: index %u, but there are %llu vertices", d.path(), where.c_str(), t[i],
                      (unsigned long long)vertex_count);
}

attributes primitive_reader::open()
{
    attributes a;
    a.positions = find("POSITION", 3, 3);
    a.normals = find("NORMAL", 3, 3);
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) a.uvs[u] = find(("TEXCOORD_" + std::to_string(u)).c_str(), 2, 2);
    a.colors = find("COLOR_0", 3, 4);
    displaced(a.positions, "POSITION");
    displaced(a.normals, "NORMAL");
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) displaced(a.uvs[u], ("TEXCOORD_" + std::to_string(u)).c_str());
    displaced(a.colors, "COLOR_0");
    for (int s = 0; skinning != nullptr && s < 4; s++) {
        attributes::binding one;
        one.joints = find(("JOINTS_" + std::to_string(s)).c_str(), 4, 4);
        one.weights = find(("WEIGHTS_" + std::to_string(s)).c_str(), 4, 4);
        if (!one.joints.present() || !one.weights.present()) break;
        a.bindings.push_back(std::move(one));
    }
    if (skinning != nullptr && a.bindings.empty())
        svo_warn(d.warnings(), "%s: %s has a skin but no joints and weights; taken as it is, at the origin", d.path(), where.c_str());
    return a;
}

/* Vertices keep[0 .. n) (all, where it is empty) into the part's arrays, which are there for all attributes that are present. */
void primitive_reader::fill(svo_part *part, const attributes &a, const std::vector<uint32_t> &keep, uint64_t n)
{
    auto vertex = [&](uint64_t i) -> uint64_t { return keep.empty() ? i : keep[i]; };
    double v[16];
    for (uint64_t i = 0; i < n; i++) {
        a.positions.get(vertex(i), v);
        std::memcpy(part->positions + 3 * i, v, 3 * sizeof(double));
    }
    for (uint64_t i = 0; a.normals.present() && i < n; i++) {
        a.normals.get(vertex(i), v);
        if (!a.normals.morphs.empty()) { /* sums of unit vectors are none */
            svo_vec3 unit = svo_normalize(svo_v3(v[0], v[1], v[2]));
            v[0] = unit.x, v[1] = unit.y, v[2] = unit.z;
        }
        for (uint64_t k = 0; k < 3; k++) part->normals[3 * i + k] = static_cast<float>(v[k]);
    }
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++)
        for (uint64_t i = 0; a.uvs[u].present() && i < n; i++) {
            a.uvs[u].get(vertex(i), v);
            part->uvs[u][2 * i] = static_cast<float>(v[0]);
            part->uvs[u][2 * i + 1] = static_cast<float>(v[1]);
        }
    for (uint64_t i = 0; a.colors.present() && i < n; i++) {
        v[3] = 1;
        a.colors.get(vertex(i), v);
        /* Linear, 0..1 by the specification; what is not a number is white. */
        for (uint64_t k = 0; k < 4; k++) part->colors[4 * i + k] = std::isnan(v[k]) ? 1.0f : static_cast<float>(std::clamp(v[k], 0.0, 1.0));
    }
    if (a.bindings.empty()) return;
    if (rig_part != nullptr) influence(a, keep, n);
    else skin(part, a, keep, n);
}

/* Arrays for n vertices. */
void allocate(const gltf_document &d, svo_part *part, const attributes &a, uint64_t n)
{
    part->positions = gltf_array<double>(d, n, 3);
    if (a.normals.present()) part->normals = gltf_array<float>(d, n, 3);
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++)
        if (a.uvs[u].present()) part->uvs[u] = gltf_array<float>(d, n, 2);
    if (a.colors.present()) part->colors = gltf_array<float>(d, n, 4);
}

/* Joints and weights of a vertex, weights adding up to 1. Bound to nothing: the first joint carries it. */
std::vector<std::pair<uint32_t, double>> primitive_reader::bound(const attributes &a, uint64_t vertex) const
{
    std::vector<std::pair<uint32_t, double>> all;
    double total = 0;
    for (const attributes::binding &s : a.bindings) {
        double joint[4], weight[4];
        s.joints.get(vertex, joint);
        s.weights.get(vertex, weight);
        for (int k = 0; k < 4; k++) {
            if (weight[k] == 0) continue;
            if (!(joint[k] >= 0 && joint[k] < static_cast<double>(skinning->joint_count))) bad("a joint index is out of range");
            all.emplace_back(static_cast<uint32_t>(joint[k]), weight[k]);
            total += weight[k];
        }
    }
    if (!(std::fabs(total) > 0) || !std::isfinite(total)) return {{0, 1.0}};
    for (auto &one : all) one.second /= total;
    return all;
}

/* As the nodes stand: vertex = sum of weight * joint matrix * vertex. The instance then stands at the origin (a skinned node's own
 * transform has no effect). */
void primitive_reader::skin(svo_part *part, const attributes &a, const std::vector<uint32_t> &kept, uint64_t n)
{
    for (uint64_t i = 0; i < n; i++) {
        svo_mat4 m{};
        for (const auto &one : bound(a, kept.empty() ? i : kept[i]))
            for (int e = 0; e < 16; e++) m.m[e] += one.second * skinning->joints[one.first].m[e];
        svo_vec3 q = svo_mat4_point(&m, svo_v3(part->positions[3 * i], part->positions[3 * i + 1], part->positions[3 * i + 2]));
        part->positions[3 * i] = q.x, part->positions[3 * i + 1] = q.y, part->positions[3 * i + 2] = q.z;
        if (part->normals == nullptr) continue;
        float *o = part->normals + 3 * i;
        svo_vec3 normal = svo_normalize(
            svo_mat4_normal(&m, svo_v3(static_cast<double>(o[0]), static_cast<double>(o[1]), static_cast<double>(o[2]))));
        o[0] = static_cast<float>(normal.x), o[1] = static_cast<float>(normal.y), o[2] = static_cast<float>(normal.z);
    }
}

/* The four greatest influences of each vertex. */
void primitive_reader::influence(const attributes &a, const std::vector<uint32_t> &kept, uint64_t n)
{
    rig_part->influences = gltf_array<svo_influence>(d, n);
    rig_part->vertex_count = n;
    for (uint64_t i = 0; i < n; i++) {
        std::vector<std::pair<uint32_t, double>> all = bound(a, kept.empty() ? i : kept[i]);
        for (size_t k = 0; k < all.size(); k++) /* a joint that is named twice */
            for (size_t l = k + 1; l < all.size(); l++)
                if (all[l].first == all[k].first) all[k].second += all[l].second, all[l].second = 0;
        std::stable_sort(all.begin(), all.end(), [](const auto &x, const auto &y) { return x.second > y.second; });
        if (all.size() > SVO_SKIN_BONES && all[SVO_SKIN_BONES].second > 0)
            svo_warn(d.warnings(), "%s: %s has vertices of more than %u bones; the greatest count", d.path(), where.c_str(), SVO_SKIN_BONES);
        svo_influence &to = rig_part->influences[i];
        for (size_t k = 0; k < SVO_SKIN_BONES; k++) {
            bool there = k < all.size() && all[k].second > 0;
            to.bone[k] = there ? static_cast<uint16_t>(all[k].first) : static_cast<uint16_t>(SVO_SKIN_REST);
            to.weight[k] = there ? static_cast<float>(all[k].second) : 0;
        }
    }
}

/* Indices and their range; false when there is nothing to draw. */
bool primitive_reader::prepare()
{
    auto extension = p.extensions.find("KHR_draco_mesh_compression");
    if (extension != p.extensions.end()) decode_draco(extension->second);
    auto position = p.attributes.find("POSITION");
    if (position == p.attributes.end()) {
        svo_warn(d.warnings(), "%s: %s has no positions; left out", d.path(), where.c_str());
        return false;
    }
    vertex_count = is_draco ? draco_points : d.model.accessors.at(static_cast<size_t>(position->second)).count;
    if (vertex_count >= UINT32_MAX) svo_throw(SVO_LIMIT, "%s: %s: more than 2^32 vertices", d.path(), where.c_str());
    check_targets();
    if (d.spilling && !is_draco) return true; /* indices are read and checked on the way */
    read_indices();
    check_range(indices.data(), indices.size());
    return true;
}

void primitive_reader::check()
{
    if (!prepare()) return;
    if (d.spilling && !is_draco) {
        std::unique_ptr<gltf_accessor> a = open_indices();
        unroll(triangles_of(a != nullptr ? a->count() : vertex_count), a.get(), [this](const uint32_t *t) { check_range(t, 3); });
    }
    find("POSITION", 3, 3);
    find("NORMAL", 3, 3);
    find("COLOR_0", 3, 4);
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) {
        find(("TEXCOORD_" + std::to_string(u)).c_str(), 2, 2);
        find(("JOINTS_" + std::to_string(u)).c_str(), 4, 4);
        find(("WEIGHTS_" + std::to_string(u)).c_str(), 4, 4);
    }
}

void primitive_reader::build(svo_part *part)
{
    part->material = p.material >= 0 ? static_cast<uint32_t>(p.material) : SVO_NONE;
    if (!prepare()) return;
    if (d.spilling && !is_draco) {
        spill(part);
        return;
    }
    /* Meshes that share one large vertex buffer take only what they use; so memory follows the indices. */
    std::vector<uint32_t> keep;
    if (vertex_count > indices.size()) {
        keep = indices;
        std::sort(keep.begin(), keep.end());
        keep.erase(std::unique(keep.begin(), keep.end()), keep.end());
        for (uint32_t &i : indices) i = static_cast<uint32_t>(std::lower_bound(keep.begin(), keep.end(), i) - keep.begin());
    }
    uint64_t n = keep.empty() && !indices.empty() ? vertex_count : keep.size();
    if (n == 0) return;
    gltf_charge(d, n);
    part->vertex_count = n;
    part->triangle_count = indices.size() / 3;
    const attributes a = open();
    allocate(d, part, a, n);
    fill(part, a, keep, n);
    part->indices = gltf_array<uint32_t>(d, part->triangle_count, 3);
    std::memcpy(part->indices, indices.data(), indices.size() * sizeof(uint32_t));
}

/* A part of triangles with corners of their own, made some at a time. */
struct batch {
    const gltf_document &d;
    svo_part part{};
    std::vector<uint32_t> corners;
    uint8_t *records = nullptr;
    uint64_t bytes = 0;

    enum : uint64_t { TRIANGLES = 4096 };
    batch(const gltf_document &doc, const attributes &a, uint32_t stride) : d(doc)
    {
        part.vertex_count = 3 * TRIANGLES;
        part.triangle_count = TRIANGLES;
        try {
            allocate(d, &part, a, part.vertex_count);
            part.indices = gltf_array<uint32_t>(d, TRIANGLES, 3);
            for (uint32_t i = 0; i < 3 * TRIANGLES; i++) part.indices[i] = i;
            corners.reserve(3 * TRIANGLES);
            bytes = TRIANGLES * stride;
            records = gltf_array<uint8_t>(d, bytes);
        } catch (...) {
            release();
            throw;
        }
    }
    ~batch() { release(); }
    batch(const batch &) = delete;
    batch &operator=(const batch &) = delete;
    void release()
    {
        import_part_free(d.context->allocator, &part);
        svo_free(d.context->allocator, records, bytes, 1);
    }
};

void primitive_reader::spill(svo_part *part)
{
    const attributes a = open();
    bool uvs[SVO_MAX_UV_SETS];
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) uvs[u] = a.uvs[u].present();
    const bool wide = !a.bindings.empty() || !a.positions.morphs.empty() || !a.positions.accessor->fits_floats();
    const svo_soup_layout layout = svo_soup_layout_make(wide, a.normals.present(), uvs, a.colors.present());
    svo_error err{};
    if (d.soup == nullptr) svo_check(svo_soup_file_create(d.context->spill, d.context->allocator, &d.soup, &err), err);
    batch b(d, a, layout.stride);
    auto flush = [&] {
        const uint64_t n = b.corners.size() / 3;
        if (n == 0) return;
        fill(&b.part, a, b.corners, 3 * n);
        for (uint64_t i = 0; i < n; i++) svo_soup_pack(&layout, &b.part, i, b.records + i * layout.stride);
        svo_check(svo_soup_append(part, d.soup, &layout, d.context->allocator, b.records, n, &err), err);
        b.corners.clear();
    };
    std::unique_ptr<gltf_accessor> index = open_indices();
    unroll(triangles_of(index != nullptr ? index->count() : vertex_count), index.get(), [&](const uint32_t *t) {
        check_range(t, 3);
        b.corners.insert(b.corners.end(), t, t + 3);
        if (b.corners.size() == 3 * batch::TRIANGLES) flush();
    });
    flush();
}

primitive_reader reader_of(gltf_document &d, int mesh, uint32_t i, const std::vector<double> &morph, const gltf_skinning *skinning)
{
    fmt_rig_part *keep = skinning != nullptr && skinning->keep != nullptr ? &skinning->keep->parts[i] : nullptr;
    return primitive_reader{d, d.model.meshes[static_cast<size_t>(mesh)].primitives[i],
                            "mesh " + std::to_string(mesh) + ", primitive " + std::to_string(i), morph, skinning,
                            d.indices.at(static_cast<size_t>(mesh)).at(i), keep, 0, {}, {}, 0, false, {}, {}};
}

} // namespace

void gltf_charge(gltf_document &d, uint64_t elements)
{
    uint64_t limit = (uint64_t{1} << 24) + 64 * std::min(d.total_bytes, UINT64_MAX / 128);
    if (elements > limit || d.elements > limit - elements)
        svo_throw(SVO_LIMIT, "%s: the meshes name the same data so often that they are far larger than the file", d.path());
    d.elements += elements;
}

void gltf_build_parts(gltf_document &d, int mesh, const std::vector<double> &morph, const gltf_skinning *skinning, svo_shape *shape)
{
    const tinygltf::Mesh &m = d.model.meshes.at(static_cast<size_t>(mesh));
    shape->name = gltf_copy(d, m.name.empty() ? "mesh " + std::to_string(mesh) : m.name);
    uint32_t count = static_cast<uint32_t>(m.primitives.size());
    if (count == 0) return;
    shape->parts = gltf_array<svo_part>(d, count);
    std::memset(static_cast<void *>(shape->parts), 0, count * sizeof(svo_part));
    shape->part_count = count;
    for (uint32_t i = 0; i < count; i++) {
        const tinygltf::Primitive &p = m.primitives[i];
        shape->parts[i].material = p.material >= 0 ? static_cast<uint32_t>(p.material) : SVO_NONE;
        if (p.mode < TINYGLTF_MODE_TRIANGLES) svo_warn(d.warnings(), "%s: points and lines are left out", d.path());
        else reader_of(d, mesh, i, morph, skinning).build(&shape->parts[i]);
    }
}

void gltf_check_mesh(gltf_document &d, int mesh)
{
    const tinygltf::Mesh &m = d.model.meshes.at(static_cast<size_t>(mesh));
    for (uint32_t i = 0; i < m.primitives.size(); i++)
        if (m.primitives[i].mode >= TINYGLTF_MODE_TRIANGLES) reader_of(d, mesh, i, {}, nullptr).check();
}
