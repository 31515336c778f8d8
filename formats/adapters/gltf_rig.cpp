/* Nodes, skins and animations of a glTF file to a fmt_rig. */
#include "gltf_rig.hpp"

#include "gltf_check.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace
{

[[noreturn]] void bad(const gltf_document &d, size_t animation, const char *why)
{
    svo_throw(SVO_INVALID_DATA, "%s: glTF animations/%zu: %s", d.path(), animation, why);
}

/* A reference; -1 where there is none. */
int reference(const gltf_document &d, size_t animation, const nlohmann::json &o, const char *key, size_t count)
{
    auto it = o.find(key);
    if (it == o.end()) return -1;
    if (!it->is_number_unsigned() || it->get<uint64_t>() >= count) bad(d, animation, (std::string(key) + " refers to something that does not exist").c_str());
    return static_cast<int>(it->get<uint64_t>());
}

std::string text(const gltf_document &d, size_t animation, const nlohmann::json &o, const char *key, const char *fallback)
{
    auto it = o.find(key);
    if (it == o.end()) return fallback;
    if (!it->is_string()) bad(d, animation, (std::string(key) + " is not a string").c_str());
    return it->get<std::string>();
}

const nlohmann::json &list(const gltf_document &d, size_t animation, const nlohmann::json &o, const char *key)
{
    auto it = o.find(key);
    if (it == o.end() || !it->is_array()) bad(d, animation, (std::string(key) + " is missing or no array").c_str());
    for (const nlohmann::json &e : *it)
        if (!e.is_object()) bad(d, animation, (std::string(key) + " is not made of objects").c_str());
    return *it;
}

/* Times and values of a track, checked. */
void fill_track(gltf_document &d, size_t animation, const gltf_track &from, fmt_rig_track *to)
{
    /* Weights come one to an element. */
    const int width = from.part == FMT_RIG_ROTATION ? 4 : from.part == FMT_RIG_WEIGHTS ? 1 : 3;
    const uint64_t elements = from.part == FMT_RIG_WEIGHTS ? gltf_target_count(d, from.node) : 1;
    const uint64_t per_key = elements * (from.interpolation == FMT_RIG_CUBIC ? 3 : 1);
    gltf_accessor in(d, from.input, "animation input", 1, 1), out(d, from.output, "animation output", width, width);
    if (in.component_type() != TINYGLTF_COMPONENT_TYPE_FLOAT) bad(d, animation, "times are not floats");
    if (in.count() == 0 || out.count() / per_key != in.count() || out.count() % per_key != 0) bad(d, animation, "a sampler has not as many values as its times need");
    gltf_charge(d, in.count() * (1 + per_key * static_cast<uint64_t>(width)));
    to->node = static_cast<uint32_t>(from.node);
    to->part = static_cast<uint8_t>(from.part);
    to->interpolation = static_cast<uint8_t>(from.interpolation);
    to->width = static_cast<uint32_t>(elements * static_cast<uint64_t>(width));
    to->count = in.count();
    to->times = gltf_array<float>(d, in.count());
    to->values = gltf_array<float>(d, in.count(), per_key * static_cast<size_t>(width));
    double v[4];
    for (uint64_t i = 0; i < in.count(); i++) {
        in.get(i, v);
        to->times[i] = static_cast<float>(v[0]);
        if (!std::isfinite(v[0]) || (i > 0 && !(to->times[i] > to->times[i - 1]))) bad(d, animation, "times do not increase");
    }
    for (uint64_t i = 0; i < out.count(); i++) {
        out.get(i, v);
        for (int k = 0; k < width; k++) {
            if (!std::isfinite(v[k])) bad(d, animation, "a value is not finite");
            to->values[i * static_cast<uint64_t>(width) + static_cast<uint64_t>(k)] = static_cast<float>(v[k]);
        }
    }
}

void fill_animations(gltf_document &d, fmt_rig *rig)
{
    if (d.animations.empty()) return;
    rig->animations = gltf_array<fmt_rig_animation>(d, d.animations.size());
    std::memset(static_cast<void *>(rig->animations), 0, d.animations.size() * sizeof(fmt_rig_animation));
    rig->animation_count = static_cast<uint32_t>(d.animations.size());
    for (size_t i = 0; i < d.animations.size(); i++) {
        fmt_rig_animation *to = &rig->animations[i];
        std::vector<gltf_track> &tracks = d.animations[i].tracks;
        to->name = gltf_copy(d, d.animations[i].name);
        const auto still = [&d](const gltf_track &t) { return t.part == FMT_RIG_WEIGHTS && gltf_target_count(d, t.node) == 0; };
        tracks.erase(std::remove_if(tracks.begin(), tracks.end(), still), tracks.end());
        /* by node and part; of two tracks of the same thing, which glTF forbids, the last one counts */
        std::stable_sort(tracks.begin(), tracks.end(), [](const gltf_track &a, const gltf_track &b) { return a.node != b.node ? a.node < b.node : a.part < b.part; });
        if (tracks.empty()) continue;
        to->tracks = gltf_array<fmt_rig_track>(d, tracks.size());
        std::memset(static_cast<void *>(to->tracks), 0, tracks.size() * sizeof(fmt_rig_track));
        to->track_count = static_cast<uint32_t>(tracks.size());
        to->begin = INFINITY;
        to->end = -INFINITY;
        for (size_t k = 0; k < tracks.size(); k++) {
            fill_track(d, i, tracks[k], &to->tracks[k]);
            to->begin = std::min(to->begin, static_cast<double>(to->tracks[k].times[0]));
            to->end = std::max(to->end, static_cast<double>(to->tracks[k].times[to->tracks[k].count - 1]));
        }
    }
}

void fill_skins(gltf_document &d, fmt_rig *rig)
{
    if (d.skins.empty()) return;
    rig->skins = gltf_array<fmt_rig_skin>(d, d.skins.size());
    std::memset(static_cast<void *>(rig->skins), 0, d.skins.size() * sizeof(fmt_rig_skin));
    rig->skin_count = static_cast<uint32_t>(d.skins.size());
    for (size_t i = 0; i < d.skins.size(); i++) {
        const gltf_skin &from = d.skins[i];
        fmt_rig_skin *to = &rig->skins[i];
        gltf_charge(d, 16 * from.joints.size());
        to->joint_count = static_cast<uint32_t>(from.joints.size());
        to->joints = gltf_array<uint32_t>(d, from.joints.size());
        to->inverse_bind = gltf_array<svo_mat4>(d, from.joints.size());
        for (size_t j = 0; j < from.joints.size(); j++) to->joints[j] = static_cast<uint32_t>(from.joints[j]);
        gltf_inverse_bind(d, static_cast<int>(i), to->inverse_bind);
    }
}

} // namespace

size_t gltf_target_count(const gltf_document &d, int node)
{
    const int mesh = d.model.nodes.at(static_cast<size_t>(node)).mesh;
    if (mesh < 0 || d.model.meshes.at(static_cast<size_t>(mesh)).primitives.empty()) return 0;
    return d.model.meshes.at(static_cast<size_t>(mesh)).primitives[0].targets.size();
}

void gltf_take_animations(gltf_document &d, const nlohmann::json &root)
{
    auto all = root.find("animations");
    if (all == root.end()) return;
    auto size_of = [&root](const char *key) { return root.contains(key) && root[key].is_array() ? root[key].size() : size_t{0}; };
    if (!all->is_array()) svo_throw(SVO_INVALID_DATA, "%s: glTF animations is not an array", d.path());
    for (size_t i = 0; i < all->size(); i++) {
        const nlohmann::json &o = (*all)[i];
        if (!o.is_object()) bad(d, i, "is not an object");
        gltf_animation animation;
        animation.name = text(d, i, o, "name", "");
        if (animation.name.find('\0') != std::string::npos) bad(d, i, "its name holds a NUL");
        const nlohmann::json &samplers = list(d, i, o, "samplers"), &channels = list(d, i, o, "channels");
        for (const nlohmann::json &c : channels) {
            auto target = c.find("target");
            if (target == c.end() || !target->is_object()) bad(d, i, "a channel has no target");
            gltf_track t;
            t.node = reference(d, i, *target, "node", size_of("nodes"));
            int sampler = reference(d, i, c, "sampler", samplers.size());
            const std::string path = text(d, i, *target, "path", "");
            if (sampler < 0) bad(d, i, "a channel has no sampler");
            if (t.node < 0) continue; /* what an extension moves */
            static const char *const parts[] = {"translation", "rotation", "scale", "weights"}, *const kinds[] = {"STEP", "LINEAR", "CUBICSPLINE"};
            t.part = t.interpolation = -1;
            for (int k = 0; k < 4; k++)
                if (path == parts[k]) t.part = k;
            if (t.part < 0) bad(d, i, "a channel's path is none of translation, rotation, scale and weights");
            const nlohmann::json &s = samplers[static_cast<size_t>(sampler)];
            const std::string kind = text(d, i, s, "interpolation", "LINEAR");
            for (int k = 0; k < 3; k++)
                if (kind == kinds[k]) t.interpolation = k;
            t.input = reference(d, i, s, "input", size_of("accessors"));
            t.output = reference(d, i, s, "output", size_of("accessors"));
            if (t.interpolation < 0) bad(d, i, "an interpolation is none of STEP, LINEAR and CUBICSPLINE");
            if (t.input < 0 || t.output < 0) bad(d, i, "a sampler has no input or no output");
            if (t.part != FMT_RIG_WEIGHTS && root["nodes"][static_cast<size_t>(t.node)].contains("matrix")) bad(d, i, "moves a node that has a matrix");
            animation.tracks.push_back(t);
        }
        d.animations.push_back(std::move(animation));
    }
}

void gltf_inverse_bind(gltf_document &d, int skin, svo_mat4 *out)
{
    const gltf_skin &s = d.skins.at(static_cast<size_t>(skin));
    if (s.inverse_bind_matrices < 0) {
        std::fill(out, out + s.joints.size(), svo_mat4_identity());
        return;
    }
    gltf_accessor inverse(d, s.inverse_bind_matrices, "inverse bind matrices", 16, 16);
    if (inverse.component_type() != TINYGLTF_COMPONENT_TYPE_FLOAT || inverse.count() < s.joints.size())
        svo_throw(SVO_INVALID_DATA, "%s: skin %d has too few or wrong inverse bind matrices", d.path(), skin);
    for (size_t j = 0; j < s.joints.size(); j++) {
        double v[16];
        inverse.get(j, v);
        for (int r = 0; r < 4; r++)
            for (int c = 0; c < 4; c++) out[j].m[4 * r + c] = v[4 * c + r];
    }
}

void gltf_build_rig(gltf_document &d, const std::vector<int> &order, fmt_rig *rig)
{
    const size_t n = d.model.nodes.size();
    rig->allocator = d.context->allocator;
    rig->node_count = static_cast<uint32_t>(n);
    if (n != 0) {
        rig->nodes = gltf_array<fmt_rig_node>(d, n);
        rig->order = gltf_array<uint32_t>(d, n);
    }
    for (size_t i = 0; i < n; i++) {
        const tinygltf::Node &from = d.model.nodes[i];
        fmt_rig_node node{};
        node.parent = d.parent[i] < 0 ? SVO_NONE : static_cast<uint32_t>(d.parent[i]);
        node.has_matrix = from.matrix.size() == 16; /* column-major */
        for (size_t r = 0; node.has_matrix && r < 4; r++)
            for (size_t c = 0; c < 4; c++) node.matrix.m[4 * r + c] = from.matrix[4 * c + r];
        node.part[FMT_RIG_ROTATION][3] = 1;
        std::fill(node.part[FMT_RIG_SCALE], node.part[FMT_RIG_SCALE] + 3, 1.0);
        if (from.translation.size() == 3) std::copy(from.translation.begin(), from.translation.end(), node.part[FMT_RIG_TRANSLATION]);
        if (from.rotation.size() == 4) std::copy(from.rotation.begin(), from.rotation.end(), node.part[FMT_RIG_ROTATION]);
        if (from.scale.size() == 3) std::copy(from.scale.begin(), from.scale.end(), node.part[FMT_RIG_SCALE]);
        rig->nodes[i] = node;
        rig->order[i] = static_cast<uint32_t>(order.at(i));
    }
    fill_skins(d, rig);
    fill_animations(d, rig);
}
