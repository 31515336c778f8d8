#include "gltf_check.hpp"

#include <cmath>
#include <cstring>

using json = nlohmann::json;

namespace
{

const char *const supported_extensions[] = {
    "KHR_draco_mesh_compression", "KHR_mesh_quantization", "KHR_texture_transform", "EXT_mesh_gpu_instancing",
    "KHR_materials_unlit", "KHR_materials_emissive_strength", "KHR_materials_pbrSpecularGlossiness",
};
/* These change shading only; the base colour is right without them. */
const char *const harmless_extensions[] = {
    "KHR_lights_punctual", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_clearcoat", "KHR_materials_sheen",
    "KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_iridescence", "KHR_materials_anisotropy",
    "KHR_materials_dispersion", "KHR_materials_variants", "KHR_materials_diffuse_transmission", "KHR_xmp_json_ld", "KHR_xmp",
    "KHR_animation_pointer", "EXT_lights_image_based",
};

template <size_t N> bool listed(const char *const (&list)[N], const std::string &name)
{
    for (const char *s : list)
        if (name == s) return true;
    return false;
}

struct checker {
    gltf_document &d;
    json &root;
    std::string at; /* where in the JSON, for messages */

    [[noreturn]] void bad(const char *what, const char *key = "") const
    {
        svo_throw(SVO_INVALID_DATA, "%s: glTF %.80s%s%.40s: %s", d.path(), at.c_str(), *key != '\0' ? "/" : "", key, what);
    }

    static json *find(json &o, const char *key)
    {
        auto it = o.find(key);
        return it == o.end() ? nullptr : &*it;
    }

    /* Unsigned integer, default when absent. */
    uint64_t integer(json &o, const char *key, bool required, uint64_t fallback, uint64_t max)
    {
        json *v = find(o, key);
        if (v == nullptr) {
            if (required) bad("is missing", key);
            return fallback;
        }
        if (v->is_number_float()) {
            double x = v->get<double>();
            if (!(x >= 0 && x <= 9007199254740992.0) || x != std::floor(x)) bad("is not an unsigned integer", key);
            *v = static_cast<uint64_t>(x);
        }
        if (!v->is_number_unsigned()) bad("is not an unsigned integer", key);
        uint64_t x = v->get<uint64_t>();
        if (x > max) bad("is out of range", key);
        return x;
    }

    bool reference(json &o, const char *key, const char *array, bool required = false)
    {
        json *v = find(o, key);
        if (v == nullptr) {
            if (required) bad("is missing", key);
            return false;
        }
        uint64_t i = integer(o, key, true, 0, INT32_MAX - 1);
        if (i >= size_of(array)) bad("refers to something that does not exist", key);
        return true;
    }

    size_t size_of(const char *array)
    {
        json *v = find(root, array);
        return v != nullptr && v->is_array() ? v->size() : 0;
    }

    void numbers(json &o, const char *key, size_t count)
    {
        json *v = find(o, key);
        if (v == nullptr) return;
        if (!v->is_array() || v->size() != count) bad("has the wrong number of elements", key);
        for (json &x : *v)
            if (!x.is_number()) bad("is not made of numbers", key);
    }

    void number(json &o, const char *key)
    {
        json *v = find(o, key);
        if (v != nullptr && !v->is_number()) bad("is not a number", key);
    }

    void text(json &o, const char *key)
    {
        json *v = find(o, key);
        if (v == nullptr) return;
        if (!v->is_string()) bad("is not a string", key);
        if (v->get_ref<const std::string &>().find('\0') != std::string::npos) bad("holds a NUL", key);
    }

    void boolean(json &o, const char *key)
    {
        json *v = find(o, key);
        if (v != nullptr && !v->is_boolean()) bad("is not true or false", key);
    }

    json *object(json &o, const char *key)
    {
        json *v = find(o, key);
        if (v != nullptr && !v->is_object()) bad("is not an object", key);
        return v;
    }

    json *extension(json &o, const char *name)
    {
        json *all = object(o, "extensions");
        return all != nullptr ? object(*all, name) : nullptr;
    }

    /* Every element of a top-level array, which must be an object with a proper name. */
    template <class F> void each(const char *array, F f)
    {
        json *v = find(root, array);
        if (v == nullptr) return;
        at = array;
        if (!v->is_array()) bad("is not an array");
        if (v->size() >= INT32_MAX) bad("has too many elements");
        for (size_t i = 0; i < v->size(); i++) {
            at = std::string(array) + "/" + std::to_string(i);
            json &o = (*v)[i];
            if (!o.is_object()) bad("is not an object");
            text(o, "name");
            f(o);
        }
    }

    void texture_info(json &o, const char *key)
    {
        json *t = object(o, key);
        if (t == nullptr) return;
        reference(*t, "index", "textures", true);
        integer(*t, "texCoord", false, 0, INT32_MAX);
        if (json *x = extension(*t, "KHR_texture_transform")) {
            numbers(*x, "offset", 2);
            numbers(*x, "scale", 2);
            number(*x, "rotation");
            integer(*x, "texCoord", false, 0, INT32_MAX);
        }
    }

    void check_version();
    void check_extensions();
    void check_data();
    void accessor_fits(json &o);
    void check_meshes();
    void check_materials();
    void check_nodes();
    void check_forest();
};

void checker::check_version()
{
    at = "asset";
    json *asset = find(root, "asset");
    json *version = asset != nullptr && asset->is_object() ? find(*asset, "version") : nullptr;
    bool old_layout = find(root, "nodes") != nullptr && root["nodes"].is_object();
    if (version == nullptr || !version->is_string()) {
        if (old_layout) svo_throw(SVO_UNSUPPORTED, "%s: glTF 1.0 is not supported; convert it to glTF 2.0", d.path());
        bad("has no version");
    }
    auto parse = [this](const std::string &s, int *major, int *minor) {
        int used = 0;
        if (std::sscanf(s.c_str(), "%9d.%9d%n", major, minor, &used) != 2 || used != static_cast<int>(s.size()) || *major < 0)
            bad("is not a version number");
    };
    int major = 0, minor = 0;
    parse(version->get<std::string>(), &major, &minor);
    if (major != 2) svo_throw(SVO_UNSUPPORTED, "%s: glTF %d.%d is not supported; convert it to glTF 2.0", d.path(), major, minor);
    if (minor != 0) svo_warn(d.warnings(), "%s: glTF 2.%d is read as 2.0", d.path(), minor);
    if (json *least = find(*asset, "minVersion")) {
        if (!least->is_string()) bad("is not a string", "minVersion");
        int least_major = 0, least_minor = 0;
        parse(least->get<std::string>(), &least_major, &least_minor);
        if (least_major > 2 || (least_major == 2 && least_minor > 0))
            svo_throw(SVO_UNSUPPORTED, "%s: needs a reader of glTF %d.%d, this one knows 2.0", d.path(), least_major, least_minor);
        if (least_major < 2) bad("is below the version", "minVersion");
    }
}

void checker::check_extensions()
{
    for (const char *key : {"extensionsRequired", "extensionsUsed"}) {
        json *list = find(root, key);
        if (list == nullptr) continue;
        at = key;
        if (!list->is_array()) bad("is not an array");
        bool required = std::strcmp(key, "extensionsRequired") == 0;
        for (json &e : *list) {
            if (!e.is_string()) bad("is not made of strings");
            const std::string &name = e.get_ref<const std::string &>();
            if (listed(supported_extensions, name)) continue;
            if (listed(harmless_extensions, name)) {
                svo_warn(d.warnings(), "%s: glTF extension %.60s is ignored", d.path(), name.c_str());
                continue;
            }
            if (required) svo_throw(SVO_UNSUPPORTED, "%s: requires the glTF extension %.80s, which is not supported", d.path(), name.c_str());
            svo_warn(d.warnings(), "%s: glTF extension %.60s is not supported and was left out", d.path(), name.c_str());
        }
    }
}

/* Elements of an accessor against its buffer view; gltf_accessor checks again what it reads. */
void checker::accessor_fits(json &o)
{
    static const char *const names[] = {"SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"};
    static const uint64_t components[] = {1, 2, 3, 4, 4, 9, 16};
    uint64_t kind = o["componentType"].get<uint64_t>(), width = kind <= 5121 ? 1 : kind <= 5123 ? 2 : 4, element = width;
    for (size_t i = 0; i < 7; i++)
        if (o["type"] == names[i]) element = components[i] * width;
    json &view = root["bufferViews"][o["bufferView"].get<size_t>()];
    uint64_t size = view["byteLength"].get<uint64_t>(), offset = o.value("byteOffset", uint64_t{0}), count = o["count"].get<uint64_t>();
    uint64_t stride = view.value("byteStride", element);
    if (stride < element) bad("elements are larger than the byteStride of its buffer view");
    if (offset > size || element > size - offset || (count - 1) > (size - offset - element) / stride) bad("goes beyond its buffer view");
}

void checker::check_data()
{
    each("buffers", [this](json &o) {
        if (integer(o, "byteLength", true, 0, UINT64_MAX / 2) == 0) bad("is zero", "byteLength");
        text(o, "uri");
    });
    each("bufferViews", [this](json &o) {
        reference(o, "buffer", "buffers", true);
        uint64_t offset = integer(o, "byteOffset", false, 0, UINT64_MAX / 4);
        uint64_t length = integer(o, "byteLength", true, 0, UINT64_MAX / 4);
        if (length == 0) bad("is zero", "byteLength");
        uint64_t have = root["buffers"][o["buffer"].get<size_t>()]["byteLength"].get<uint64_t>();
        if (offset > have || length > have - offset) bad("goes beyond its buffer");
        uint64_t stride = integer(o, "byteStride", false, 4, 252);
        if (stride < 4 || stride % 4 != 0) bad("is not a multiple of 4 from 4 to 252", "byteStride");
    });
    each("accessors", [this](json &o) {
        static const char *const types[] = {"SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"};
        uint64_t component = integer(o, "componentType", true, 0, 5126);
        if (component < 5120 || component == 5124) bad("is not a component type of glTF", "componentType");
        if (integer(o, "count", true, 0, UINT64_MAX / 2) == 0) bad("is zero", "count");
        text(o, "type");
        json *type = find(o, "type");
        if (type == nullptr || !listed(types, type->get<std::string>())) bad("is not an accessor type of glTF", "type");
        bool view = reference(o, "bufferView", "bufferViews");
        if (integer(o, "byteOffset", false, 0, UINT64_MAX / 4) != 0 && !view) bad("without a bufferView", "byteOffset");
        boolean(o, "normalized");
        if (view) accessor_fits(o);
        json *sparse = object(o, "sparse");
        if (sparse == nullptr) return;
        uint64_t sparse_count = integer(*sparse, "count", true, 0, INT32_MAX);
        if (sparse_count == 0 || sparse_count > o["count"].get<uint64_t>()) bad("is zero or more than the accessor's", "sparse/count");
        json *indices = object(*sparse, "indices"), *values = object(*sparse, "values");
        if (indices == nullptr || values == nullptr) bad("lacks indices or values", "sparse");
        reference(*indices, "bufferView", "bufferViews", true);
        reference(*values, "bufferView", "bufferViews", true);
        integer(*indices, "byteOffset", false, 0, INT32_MAX);
        integer(*values, "byteOffset", false, 0, INT32_MAX);
        uint64_t kind = integer(*indices, "componentType", true, 0, 5126);
        if (kind != 5121 && kind != 5123 && kind != 5125) bad("is not an unsigned integer type", "sparse/indices/componentType");
    });
}

void checker::check_meshes()
{
    auto attributes = [this](json &o, const char *what, const char *array) {
        json *map = object(o, what);
        if (map == nullptr) bad("is missing", what);
        std::string outer = at;
        at += std::string("/") + what;
        for (auto &item : map->items()) {
            if (array != nullptr) reference(*map, item.key().c_str(), array);
            else integer(*map, item.key().c_str(), true, 0, INT32_MAX);
        }
        at = outer;
    };
    each("meshes", [&](json &o) {
        json *list = find(o, "primitives");
        if (list == nullptr || !list->is_array() || list->empty()) bad("is missing or empty", "primitives");
        std::string outer = at;
        for (size_t i = 0; i < list->size(); i++) {
            at = outer + "/primitives/" + std::to_string(i);
            json &p = (*list)[i];
            if (!p.is_object()) bad("is not an object");
            attributes(p, "attributes", "accessors");
            reference(p, "indices", "accessors");
            reference(p, "material", "materials");
            integer(p, "mode", false, 4, 6);
            if (json *targets = find(p, "targets")) {
                if (!targets->is_array()) bad("is not an array", "targets");
                for (json &t : *targets) {
                    if (!t.is_object()) bad("is not made of objects", "targets");
                    for (auto &item : t.items()) reference(t, item.key().c_str(), "accessors");
                }
            }
            if (json *draco = extension(p, "KHR_draco_mesh_compression")) {
                at += "/extensions/KHR_draco_mesh_compression";
                reference(*draco, "bufferView", "bufferViews", true);
                attributes(*draco, "attributes", nullptr);
            }
        }
    });
}

void checker::check_materials()
{
    each("images", [this](json &o) {
        text(o, "uri");
        text(o, "mimeType");
        bool view = reference(o, "bufferView", "bufferViews");
        if (view && find(o, "uri") != nullptr) bad("has both uri and bufferView");
    });
    each("samplers", [this](json &o) {
        for (const char *key : {"wrapS", "wrapT"}) {
            uint64_t w = integer(o, key, false, 10497, INT32_MAX);
            if (w != 10497 && w != 33071 && w != 33648) bad("is not a wrap mode", key);
        }
        integer(o, "magFilter", false, 0, INT32_MAX);
    });
    each("textures", [this](json &o) {
        reference(o, "source", "images");
        reference(o, "sampler", "samplers");
    });
    each("materials", [this](json &o) {
        json *pbr = object(o, "pbrMetallicRoughness");
        if (pbr != nullptr) {
            numbers(*pbr, "baseColorFactor", 4);
            number(*pbr, "metallicFactor");
            number(*pbr, "roughnessFactor");
            texture_info(*pbr, "baseColorTexture");
            texture_info(*pbr, "metallicRoughnessTexture");
        }
        numbers(o, "emissiveFactor", 3);
        texture_info(o, "emissiveTexture");
        texture_info(o, "normalTexture");
        texture_info(o, "occlusionTexture");
        number(o, "alphaCutoff");
        boolean(o, "doubleSided");
        text(o, "alphaMode");
        if (json *mode = find(o, "alphaMode")) {
            const std::string &s = mode->get_ref<const std::string &>();
            if (s != "OPAQUE" && s != "MASK" && s != "BLEND") bad("is not OPAQUE, MASK or BLEND", "alphaMode");
        }
        if (json *x = extension(o, "KHR_materials_emissive_strength")) number(*x, "emissiveStrength");
        if (json *x = extension(o, "KHR_materials_pbrSpecularGlossiness")) {
            numbers(*x, "diffuseFactor", 4);
            number(*x, "glossinessFactor");
            texture_info(*x, "diffuseTexture");
        }
    });
}

void checker::check_nodes()
{
    each("cameras", [this](json &o) {
        text(o, "type");
        if (json *p = object(o, "perspective")) number(*p, "yfov");
    });
    auto node_list = [this](json &o, const char *key) {
        json *list = find(o, key);
        if (list == nullptr) return;
        if (!list->is_array()) bad("is not an array", key);
        for (json &i : *list) {
            if (i.is_number_float() && i.get<double>() >= 0 && i.get<double>() == std::floor(i.get<double>()) && i.get<double>() < 4e9)
                i = static_cast<uint64_t>(i.get<double>());
            if (!i.is_number_unsigned() || i.get<uint64_t>() >= size_of("nodes")) bad("refers to a node that does not exist", key);
        }
    };
    each("skins", [&](json &o) {
        json *joints = find(o, "joints");
        if (joints == nullptr || !joints->is_array() || joints->empty()) bad("is missing or empty", "joints");
        node_list(o, "joints");
        reference(o, "inverseBindMatrices", "accessors");
    });
    each("nodes", [&](json &o) {
        reference(o, "mesh", "meshes");
        reference(o, "skin", "skins");
        reference(o, "camera", "cameras");
        numbers(o, "matrix", 16);
        numbers(o, "translation", 3);
        numbers(o, "rotation", 4);
        numbers(o, "scale", 3);
        if (find(o, "matrix") != nullptr && (find(o, "translation") != nullptr || find(o, "rotation") != nullptr || find(o, "scale") != nullptr))
            bad("has a matrix and also translation, rotation or scale");
        node_list(o, "children");
        if (json *x = extension(o, "EXT_mesh_gpu_instancing")) {
            json *map = object(*x, "attributes");
            if (map == nullptr) bad("has no attributes", "EXT_mesh_gpu_instancing");
            for (auto &item : map->items()) reference(*map, item.key().c_str(), "accessors");
        }
    });
    each("scenes", [&](json &o) { node_list(o, "nodes"); });
    at = "scene";
    if (reference(root, "scene", "scenes")) d.scene = static_cast<int>(root["scene"].get<uint64_t>());
}

/* Every node has at most one parent and no node is its own ancestor. */
void checker::check_forest()
{
    size_t n = size_of("nodes");
    d.parent.assign(n, -1);
    for (size_t i = 0; i < n; i++) {
        json *children = find(root["nodes"][i], "children");
        if (children == nullptr) continue;
        at = "nodes/" + std::to_string(i) + "/children";
        for (json &c : *children) {
            int &p = d.parent[c.get<size_t>()];
            if (p != -1) bad("names a node that already has a parent");
            p = static_cast<int>(i);
        }
    }
    std::vector<uint8_t> state(n, 0); /* 1: on the current way up, 2: known to end at a root */
    for (size_t i = 0; i < n; i++) {
        size_t k = i;
        for (; state[k] == 0; k = static_cast<size_t>(d.parent[k])) {
            state[k] = 1;
            if (d.parent[k] < 0) break;
        }
        if (state[k] == 1 && d.parent[k] >= 0) {
            at = "nodes/" + std::to_string(k);
            bad("is its own ancestor");
        }
        for (k = i; state[k] == 1; k = static_cast<size_t>(d.parent[k])) {
            state[k] = 2;
            if (d.parent[k] < 0) break;
        }
    }
    each("scenes", [this](json &o) {
        json *list = find(o, "nodes");
        if (list == nullptr) return;
        std::vector<uint64_t> seen;
        for (json &i : *list) {
            if (d.parent[i.get<size_t>()] >= 0) bad("names a node that is a child of another", "nodes");
            seen.push_back(i.get<uint64_t>());
        }
        std::sort(seen.begin(), seen.end());
        if (std::adjacent_find(seen.begin(), seen.end()) != seen.end()) bad("names a node twice", "nodes");
    });
}

} // namespace

nlohmann::json gltf_parse_json(const char *path, const char *text, uint64_t size)
{
    constexpr int max_depth = 64; /* real assets stay below 16; later passes recurse */
    auto bound = [path](int depth, json::parse_event_t, json &) {
        if (depth > max_depth) svo_throw(SVO_INVALID_DATA, "%s: JSON is nested deeper than %d", path, max_depth);
        return true;
    };
    try {
        return json::parse(text, text + size, bound);
    } catch (const json::exception &e) {
        svo_throw(SVO_INVALID_DATA, "%s: not valid JSON: %.150s", path, e.what());
    }
}

void gltf_check(gltf_document &d, json &root)
{
    checker c{d, root, ""};
    if (!root.is_object()) svo_throw(SVO_INVALID_DATA, "%s: glTF JSON is not an object", d.path());
    c.check_version();
    c.check_extensions();
    c.check_data();
    c.check_meshes();
    c.check_materials();
    c.check_nodes();
    c.check_forest();
}
