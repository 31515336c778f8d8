/* The node forest of the drawn scene to shapes, instances and cameras. */
#include "gltf_rig.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <tuple>

namespace
{

struct scene_builder {
    gltf_document &d;
    svo_mesh *mesh;
    std::vector<svo_mat4> world;
    std::vector<svo_shape> shapes; /* owned until finish() */
    std::vector<svo_instance> instances;
    std::vector<svo_camera> cameras;
    uint32_t animation = SVO_NONE;
    /* A mesh as it is drawn: weights of its morph targets, no zeros at the end; -1: no skin. */
    struct drawn_mesh {
        int mesh, skin;
        std::vector<double> morph;
        bool operator<(const drawn_mesh &o) const { return std::tie(mesh, skin, morph) < std::tie(o.mesh, o.skin, o.morph); }
    };
    std::map<drawn_mesh, uint32_t> known; /* -> shape */
    fmt_rig own{}, *rig; /* the caller's or our own */
    std::vector<fmt_rig_shape> rig_shapes; /* owned until finish() */
    std::vector<uint32_t> nodes;           /* of each instance */
    uint32_t node_now = 0;

    scene_builder(gltf_document &doc, svo_mesh *out) : d(doc), mesh(out), rig(doc.context->rig != nullptr ? doc.context->rig : &own) {}
    scene_builder(const scene_builder &) = delete;
    scene_builder &operator=(const scene_builder &) = delete;
    ~scene_builder()
    {
        const svo_allocator *a = d.context->allocator;
        for (svo_shape &s : shapes) {
            for (uint32_t i = 0; i < s.part_count; i++) import_part_free(a, &s.parts[i]);
            svo_free(a, s.parts, s.part_count, sizeof(svo_part));
            svo_string_free(a, s.name);
        }
        for (svo_instance &i : instances) svo_string_free(a, i.name);
        for (svo_camera &c : cameras) svo_string_free(a, c.name);
        for (fmt_rig_shape &s : rig_shapes) {
            for (uint32_t i = 0; i < s.part_count; i++) svo_free(a, s.parts[i].influences, s.parts[i].vertex_count, sizeof(svo_influence));
            svo_free(a, s.parts, s.part_count, sizeof(fmt_rig_part));
        }
        fmt_rig_free(&own);
    }

    /* Nodes below the roots in depth-first order of the file, without recursion; sets their world transforms. */
    std::vector<int> walk(const std::vector<int> &roots)
    {
        std::vector<int> order, stack(roots.rbegin(), roots.rend());
        while (!stack.empty()) {
            int i = stack.back();
            stack.pop_back();
            order.push_back(i);
            const std::vector<int> &c = d.model.nodes[static_cast<size_t>(i)].children;
            stack.insert(stack.end(), c.rbegin(), c.rend());
        }
        return order;
    }

    void transforms()
    {
        size_t n = d.model.nodes.size();
        std::vector<int> roots;
        for (size_t i = 0; i < n; i++)
            if (d.parent[i] < 0) roots.push_back(static_cast<int>(i));
        /* all nodes: joints may stand outside the scene */
        gltf_build_rig(d, walk(roots), rig);
        const import_context *c = d.context;
        if (c->rig != nullptr && c->animation != nullptr) {
            animation = fmt_rig_find(rig, c->animation);
            if (animation == SVO_NONE) svo_throw(SVO_INVALID_DATA, "%s: there is no animation '%.60s'; the file has %u", d.path(), c->animation, rig->animation_count);
        }
        world.resize(n);
        fmt_rig_world(rig, animation, c->time, world.data());
    }

    std::vector<int> scene_roots()
    {
        const std::vector<tinygltf::Scene> &scenes = d.model.scenes;
        if (d.scene >= 0) return scenes.at(static_cast<size_t>(d.scene)).nodes;
        if (!scenes.empty()) {
            if (scenes.size() > 1) svo_warn(d.warnings(), "%s: no default scene of %zu; the first is taken", d.path(), scenes.size());
            return scenes[0].nodes;
        }
        std::vector<int> roots;
        for (size_t i = 0; i < d.parent.size(); i++)
            if (d.parent[i] < 0) roots.push_back(static_cast<int>(i));
        if (!roots.empty()) svo_warn(d.warnings(), "%s: no scene; all nodes are taken", d.path());
        return roots;
    }

    gltf_skinning skinning(int skin)
    {
        gltf_skinning out;
        out.joint_count = rig->skins[skin].joint_count;
        if (d.context->rig != nullptr) return out;
        for (uint32_t j = 0; j < rig->skins[skin].joint_count; j++) out.joints.push_back(fmt_rig_joint(rig, static_cast<uint32_t>(skin), j, world.data()));
        return out;
    }

    bool is_bound(int mesh_index) const
    {
        for (const tinygltf::Primitive &p : d.model.meshes.at(static_cast<size_t>(mesh_index)).primitives)
            if (p.attributes.count("JOINTS_0") != 0 && p.attributes.count("WEIGHTS_0") != 0) return true;
        return false;
    }

    /* Weights of the morph targets of a node: the animation's, else the node's, else the mesh's. */
    std::vector<double> morph_of(const tinygltf::Node &n)
    {
        const tinygltf::Mesh &m = d.model.meshes.at(static_cast<size_t>(n.mesh));
        const size_t targets = m.primitives.empty() ? 0 : m.primitives[0].targets.size();
        const std::vector<double> &stated = !n.weights.empty() ? n.weights : m.weights;
        if (!stated.empty() && stated.size() != targets)
            svo_warn(d.warnings(), "%s: mesh %d has %zu morph targets, but %zu weights", d.path(), n.mesh, targets, stated.size());
        std::vector<double> out(stated.begin(), stated.begin() + static_cast<std::ptrdiff_t>(std::min(stated.size(), targets)));
        if (const fmt_rig_track *t = fmt_rig_weights_track(rig, animation, node_now)) {
            out.resize(t->width);
            fmt_rig_weights(t, d.context->time, out.data());
        }
        for (double w : out)
            if (!std::isfinite(w)) svo_throw(SVO_INVALID_DATA, "%s: a weight of a morph target of mesh %d is not finite", d.path(), n.mesh);
        while (!out.empty() && out.back() == 0) out.pop_back();
        return out;
    }

    uint32_t shape(int mesh_index, int skin, const std::vector<double> &morph)
    {
        auto it = known.find({mesh_index, skin, morph});
        if (it != known.end()) return it->second;
        shapes.push_back(svo_shape{});
        rig_shapes.push_back(fmt_rig_shape{SVO_NONE, 0, nullptr});
        if (skin >= 0) {
            gltf_skinning s = skinning(skin);
            size_t primitives = d.model.meshes.at(static_cast<size_t>(mesh_index)).primitives.size();
            if (d.context->rig == nullptr) svo_warn(d.warnings(), "%s: skins are taken in their bind pose", d.path());
            else if (is_bound(mesh_index)) {
                if (s.joint_count >= SVO_SKIN_REST) svo_throw(SVO_LIMIT, "%s: a skin has more than %u joints", d.path(), SVO_SKIN_REST - 1);
                fmt_rig_shape &r = rig_shapes.back();
                r.parts = gltf_array<fmt_rig_part>(d, primitives);
                std::memset(static_cast<void *>(r.parts), 0, primitives * sizeof(fmt_rig_part));
                r.part_count = static_cast<uint32_t>(primitives);
                r.skin = static_cast<uint32_t>(skin);
                s.keep = &r;
            }
            gltf_build_parts(d, mesh_index, morph, &s, &shapes.back());
        } else {
            gltf_build_parts(d, mesh_index, morph, nullptr, &shapes.back());
        }
        uint32_t index = static_cast<uint32_t>(shapes.size() - 1);
        known[{mesh_index, skin, morph}] = index;
        return index;
    }

    /* Where a mesh with a skin stands: its node's own transform has no effect. */
    svo_mat4 skinned_place(uint32_t shape_index) const
    {
        uint32_t skin = rig_shapes[shape_index].skin;
        return skin != SVO_NONE ? fmt_rig_place(rig, skin) : svo_mat4_identity();
    }

    void add_instance(const std::string &name, uint32_t shape_index, const svo_mat4 &transform)
    {
        if (instances.size() >= UINT32_MAX - 1) svo_throw(SVO_LIMIT, "%s: more than 2^32 instances", d.path());
        instances.push_back(svo_instance{nullptr, shape_index, transform});
        instances.back().name = gltf_copy(d, name);
        nodes.push_back(node_now);
    }

    /* EXT_mesh_gpu_instancing: one transform per element, below the node. */
    void add_gpu_instances(const tinygltf::Node &n, const svo_mat4 &node_world, uint32_t shape_index, const tinygltf::Value &extension)
    {
        const tinygltf::Value &map = extension.Get("attributes");
        std::unique_ptr<gltf_accessor> part[3];
        static const char *const names[3] = {"TRANSLATION", "ROTATION", "SCALE"};
        uint64_t count = 0;
        bool any = false;
        for (int k = 0; k < 3; k++) {
            if (!map.IsObject() || !map.Has(names[k])) continue;
            int want = k == 1 ? 4 : 3;
            part[k] = std::make_unique<gltf_accessor>(d, map.Get(names[k]).GetNumberAsInt(), names[k], want, want);
            if (any && part[k]->count() != count)
                svo_throw(SVO_INVALID_DATA, "%s: instance attributes of node '%.60s' have different lengths", d.path(), n.name.c_str());
            count = part[k]->count();
            any = true;
        }
        if (!any) { /* only custom attributes: their length is the number of instances, all in one place */
            svo_warn(d.warnings(), "%s: instances without transforms are drawn once", d.path());
            add_instance(n.name, shape_index, node_world);
            return;
        }
        gltf_charge(d, count);
        instances.reserve(instances.size() + count);
        for (uint64_t i = 0; i < count; i++) {
            double t[3] = {0, 0, 0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
            if (part[0]) part[0]->get(i, t);
            if (part[1]) part[1]->get(i, q);
            if (part[2]) part[2]->get(i, s);
            add_instance(n.name, shape_index, svo_mat4_mul(node_world, svo_mat4_trs(t, q, s)));
        }
    }

    void add_camera(const tinygltf::Node &n, const svo_mat4 &node_world)
    {
        const tinygltf::Camera &c = d.model.cameras.at(static_cast<size_t>(n.camera));
        if (c.type != "perspective" || !(c.perspective.yfov > 0) || !(c.perspective.yfov < 3.2)) {
            svo_warn(d.warnings(), "%s: only perspective cameras are used", d.path());
            return;
        }
        cameras.push_back(svo_camera{nullptr, node_world, c.perspective.yfov});
        cameras.back().name = gltf_copy(d, c.name.empty() ? n.name : c.name);
    }

    void build()
    {
        transforms();
        for (int i : walk(scene_roots())) {
            const tinygltf::Node &n = d.model.nodes[static_cast<size_t>(i)];
            const svo_mat4 &w = world[static_cast<size_t>(i)];
            node_now = static_cast<uint32_t>(i);
            if (n.camera >= 0) add_camera(n, w);
            if (n.mesh < 0) continue;
            uint32_t s = shape(n.mesh, n.skin, morph_of(n));
            auto x = n.extensions.find("EXT_mesh_gpu_instancing");
            if (x != n.extensions.end() && n.skin < 0) add_gpu_instances(n, w, s, x->second);
            else add_instance(n.name, s, n.skin >= 0 ? skinned_place(s) : w);
        }
    }

    template <class T> static void move(gltf_document &doc, std::vector<T> &from, T **to, uint32_t *count)
    {
        if (from.empty()) return;
        *to = gltf_array<T>(doc, from.size());
        std::memcpy(static_cast<void *>(*to), from.data(), from.size() * sizeof(T));
        *count = static_cast<uint32_t>(from.size());
        from.clear();
    }

    void finish()
    {
        std::vector<bool> used(d.model.materials.size(), false);
        for (const svo_shape &s : shapes)
            for (uint32_t i = 0; i < s.part_count; i++)
                if (s.parts[i].material != SVO_NONE && s.parts[i].triangle_count != 0) used[s.parts[i].material] = true;
        gltf_build_materials(d, used, mesh);
        std::vector<bool> drawn(d.model.meshes.size(), false);
        for (const auto &k : known) drawn[static_cast<size_t>(k.first.mesh)] = true;
        for (size_t i = 0; i < drawn.size(); i++)
            if (!drawn[i]) gltf_check_mesh(d, static_cast<int>(i));
        move(d, shapes, &mesh->shapes, &mesh->shape_count);
        move(d, instances, &mesh->instances, &mesh->instance_count);
        move(d, cameras, &mesh->cameras, &mesh->camera_count);
        if (d.context->rig == nullptr) return;
        move(d, rig_shapes, &rig->shapes, &rig->shape_count);
        move(d, nodes, &rig->instance_node, &rig->instance_count);
    }
};

} // namespace

extern "C" svo_result import_gltf(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    return svo_guard(err, [&]() -> svo_result {
        gltf_document d;
        d.context = c;
        mesh->allocator = c->allocator;
        gltf_load(d, bytes, size);
        scene_builder b(d, mesh);
        b.build();
        b.finish();
        return SVO_OK;
    });
}
