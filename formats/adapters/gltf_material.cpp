/* glTF materials, textures and images. Only images that a used material looks into are decoded. */
#include "gltf_document.hpp"

#include "fmt_image.h"

#include <cmath>
#include <cstring>

namespace
{

struct builder {
    gltf_document &d;
    import_images images;
    std::vector<uint32_t> place; /* of each image of the file, in `images` */
    std::vector<bool> tried;
    std::vector<bool> opaque; /* was wanted for its alpha alone, and has none */
    std::vector<import_image_job> jobs;        /* images that were decoded together, */
    std::vector<std::unique_ptr<gltf_bytes>> fetched; /* their bytes, where no buffer has them, */
    std::vector<size_t> job_of;                /* and which they are: of each image of the file, SIZE_MAX: none */

    explicit builder(gltf_document &doc)
        : d(doc), place(doc.images.size(), SVO_NONE), tried(doc.images.size(), false), opaque(doc.images.size(), false), job_of(doc.images.size(), SIZE_MAX)
    {
        import_images_init(&images, d.context);
    }
    ~builder()
    {
        for (import_image_job &j : jobs)
            if (j.result == SVO_OK) fmt_image_free(d.context->allocator, &j.image);
        import_images_free(&images);
    }
    builder(const builder &) = delete;
    builder &operator=(const builder &) = delete;

    bool without(uint32_t what) const { return (d.context->without & what) != 0; }

    /* The encoded bytes of an image; `keep` receives them where no buffer of the file has them. */
    import_image_job encoded(size_t i, std::unique_ptr<gltf_bytes> *keep)
    {
        const gltf_image &from = d.images[i];
        import_image_job j{};
        j.result = SVO_INVALID_DATA; /* until it is decoded */
        j.mapped = d.context->mapped;
        if (from.buffer_view >= 0) {
            j.bytes = gltf_view_bytes(d, from.buffer_view, &j.size, nullptr);
        } else if (!from.uri.empty()) {
            *keep = gltf_fetch(d, from.uri);
            j.bytes = (*keep)->data;
            j.size = (*keep)->size;
            j.mapped = (*keep)->mapped.mapped;
        } else {
            svo_throw(SVO_INVALID_DATA, "it has neither uri nor bufferView");
        }
        return j;
    }

    /* Decode an image together with others, later. What cannot be had is told when it is asked for. */
    void prepare(int index, bool alpha_only)
    {
        if (index < 0 || static_cast<size_t>(index) >= d.model.textures.size()) return;
        const int source = d.model.textures[static_cast<size_t>(index)].source;
        if (source < 0 || static_cast<size_t>(source) >= d.images.size() || job_of[static_cast<size_t>(source)] != SIZE_MAX) return;
        svo_error why{};
        svo_guard(&why, [&]() -> svo_result {
            std::unique_ptr<gltf_bytes> keep;
            const import_image_job j = encoded(static_cast<size_t>(source), &keep);
            if (alpha_only && !fmt_image_can_have_alpha(j.bytes, j.size)) {
                opaque[static_cast<size_t>(source)] = true;
                return SVO_OK;
            }
            fetched.push_back(std::move(keep));
            jobs.push_back(j);
            job_of[static_cast<size_t>(source)] = jobs.size() - 1;
            return SVO_OK;
        });
    }

    void prepare(const tinygltf::Material &from)
    {
        each_texture(from, [this](svo_texture svo_material::*, int index, int, const tinygltf::ExtensionMap &, bool alpha_only) { prepare(index, alpha_only); });
    }

    void decode() { import_images_decode(d.context, jobs.data(), jobs.size()); }

    uint32_t image(int index, bool alpha_only)
    {
        size_t i = static_cast<size_t>(index);
        if (d.context->skip_images || tried[i] || (alpha_only && opaque[i])) return place[i];
        const gltf_image &from = d.images[i];
        svo_error why{};
        bool opened = false;
        svo_result r = svo_guard(&why, [&]() -> svo_result {
            std::unique_ptr<gltf_bytes> keep;
            import_image_job one{}, *j = job_of[i] != SIZE_MAX ? &jobs[job_of[i]] : &one;
            if (j == &one) {
                one = encoded(i, &keep);
                opaque[i] = alpha_only && !fmt_image_can_have_alpha(one.bytes, one.size);
                if (opaque[i]) return SVO_OK;
                import_images_decode(d.context, &one, 1);
            }
            opened = true;
            tried[i] = true;
            if (j->result != SVO_OK) {
                why = j->why;
                return j->result;
            }
            j->result = SVO_INVALID_DATA; /* the image has another owner from here on */
            return import_image_add(&images, d.context, from.name.c_str(), &j->image, &place[i], &why);
        });
        if (alpha_only && opaque[i]) return SVO_NONE;
        tried[i] = true;
        if (r == SVO_OUT_OF_MEMORY) svo_throw(r, "%s: texture %zu (%.60s): %s", d.path(), i, from.name.c_str(), why.message);
        if (r == SVO_IO && opened) svo_throw(r, "%s", why.message); /* of temporary files */
        if (r != SVO_OK) {
            place[i] = SVO_NONE;
            svo_warn(d.warnings(), "%s: image %zu could not be used (%.120s); the material's colour is used alone", d.path(), i, why.message);
        }
        return place[i];
    }

    svo_texture texture(int index, int uv_set, const tinygltf::ExtensionMap &extensions, bool alpha_only)
    {
        svo_texture t = svo_texture_none();
        if (index < 0) return t;
        const tinygltf::Texture &from = d.model.textures.at(static_cast<size_t>(index));
        auto x = extensions.find("KHR_texture_transform");
        if (x != extensions.end()) {
            if (x->second.Has("texCoord")) uv_set = x->second.Get("texCoord").GetNumberAsInt();
            transform(x->second, t.transform);
        }
        if (uv_set < 0 || uv_set >= static_cast<int>(SVO_MAX_UV_SETS)) {
            svo_warn(d.warnings(), "%s: TEXCOORD_%d is not supported; the texture is left out", d.path(), uv_set);
            return svo_texture_none();
        }
        t.uv_set = static_cast<uint32_t>(uv_set);
        if (from.source < 0) {
            const char *why = "it names no image";
            if (from.extensions.count("EXT_texture_webp") != 0) why = "WebP without a fallback";
            if (from.extensions.count("KHR_texture_basisu") != 0) why = "KTX2/Basis without a fallback";
            svo_warn(d.warnings(), "%s: texture %d could not be used (%s); the material's colour is used alone", d.path(), index, why);
            return svo_texture_none();
        }
        t.image = image(from.source, alpha_only);
        if (t.image == SVO_NONE) return svo_texture_none();
        if (from.sampler >= 0) {
            const tinygltf::Sampler &s = d.model.samplers.at(static_cast<size_t>(from.sampler));
            t.wrap_u = wrap(s.wrapS);
            t.wrap_v = wrap(s.wrapT);
            t.nearest = s.magFilter == TINYGLTF_TEXTURE_FILTER_NEAREST;
        }
        return t;
    }

    static svo_wrap wrap(int mode)
    {
        return mode == TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE ? SVO_WRAP_CLAMP
               : mode == TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT ? SVO_WRAP_MIRROR : SVO_WRAP_REPEAT;
    }

    /* Translation * rotation * scale. v points down, so "counter-clockwise" turns from +v towards +u: what all viewers do,
     * though the extension's sample code has the other sign (KhronosGroup/glTF#1563). */
    static void transform(const tinygltf::Value &x, double out[6])
    {
        auto pair = [&x](const char *key, double fallback, double v[2]) {
            v[0] = v[1] = fallback;
            if (!x.Has(key)) return;
            for (int k = 0; k < 2; k++) v[k] = x.Get(key).Get(k).GetNumberAsDouble();
        };
        double offset[2], scale[2];
        pair("offset", 0, offset);
        pair("scale", 1, scale);
        double angle = x.Has("rotation") ? x.Get("rotation").GetNumberAsDouble() : 0;
        double c = std::cos(angle), s = std::sin(angle);
        double m[6] = {c * scale[0], s * scale[1], offset[0], -s * scale[0], c * scale[1], offset[1]};
        std::memcpy(out, m, sizeof m);
    }

    /* The old workflow, where a material has it and no values of the new one. */
    static const tinygltf::Value *specular_glossiness(const tinygltf::Material &from)
    {
        auto x = from.extensions.find("KHR_materials_pbrSpecularGlossiness");
        return x != from.extensions.end() && from.values.empty() ? &x->second : nullptr;
    }

    /* The textures that a material is made of: each(where it goes, index, set of coordinates, extensions, alpha only). A later one for the
     * same place replaces the earlier. Without colours, only what cuts a surface out is read. */
    template <class F> void each_texture(const tinygltf::Material &from, F each) const
    {
        const bool alpha_only = without(FMT_WITHOUT_COLOR), reads_base = !alpha_only || from.alphaMode == "MASK";
        const tinygltf::PbrMetallicRoughness &pbr = from.pbrMetallicRoughness;
        auto one = [&](svo_texture svo_material::*to, const tinygltf::TextureInfo &t, bool alpha) { each(to, t.index, t.texCoord, t.extensions, alpha); };
        if (reads_base) one(&svo_material::base_color_texture, pbr.baseColorTexture, alpha_only);
        if (!without(FMT_WITHOUT_METALLIC_ROUGHNESS)) one(&svo_material::metallic_roughness_texture, pbr.metallicRoughnessTexture, false);
        if (!without(FMT_WITHOUT_EMISSIVE)) one(&svo_material::emissive_texture, from.emissiveTexture, false);
        const tinygltf::Value *x = specular_glossiness(from);
        if (!reads_base || x == nullptr || !x->Has("diffuseTexture") || !x->Get("diffuseTexture").Has("index")) return;
        const tinygltf::Value &t = x->Get("diffuseTexture");
        tinygltf::ExtensionMap extensions;
        if (t.Has("extensions") && t.Get("extensions").Has("KHR_texture_transform"))
            extensions["KHR_texture_transform"] = t.Get("extensions").Get("KHR_texture_transform");
        each(&svo_material::base_color_texture, t.Get("index").GetNumberAsInt(), t.Has("texCoord") ? t.Get("texCoord").GetNumberAsInt() : 0, extensions, alpha_only);
    }

    /* Its diffuse colour stands for the base colour, which is right for everything but metals. */
    void values_of_specular_glossiness(const tinygltf::Value &x, svo_material *m)
    {
        svo_warn(d.warnings(), "%s: specular-glossiness materials: the diffuse colour is taken as base colour", d.path());
        if (x.Has("diffuseFactor"))
            for (int k = 0; k < 4; k++) m->base_color[k] = static_cast<float>(x.Get("diffuseFactor").Get(k).GetNumberAsDouble());
        m->roughness = 1 - static_cast<float>(x.Has("glossinessFactor") ? x.Get("glossinessFactor").GetNumberAsDouble() : 1);
    }

    void material(const tinygltf::Material &from, bool used, svo_material *m)
    {
        const tinygltf::PbrMetallicRoughness &pbr = from.pbrMetallicRoughness;
        for (size_t k = 0; k < 4; k++) m->base_color[k] = static_cast<float>(pbr.baseColorFactor.at(k));
        m->metallic = static_cast<float>(pbr.metallicFactor);
        m->roughness = static_cast<float>(pbr.roughnessFactor);
        double strength = 1;
        auto x = from.extensions.find("KHR_materials_emissive_strength");
        if (x != from.extensions.end() && x->second.Has("emissiveStrength")) strength = x->second.Get("emissiveStrength").GetNumberAsDouble();
        for (size_t k = 0; k < 3; k++) m->emissive[k] = static_cast<float>(from.emissiveFactor.at(k) * strength);
        m->alpha_mode = from.alphaMode == "MASK" ? SVO_ALPHA_MASK : from.alphaMode == "BLEND" ? SVO_ALPHA_BLEND : SVO_ALPHA_OPAQUE;
        m->alpha_cutoff = static_cast<float>(from.alphaCutoff);
        m->double_sided = from.doubleSided;
        if (!used) return;
        each_texture(from, [this, m](svo_texture svo_material::*to, int index, int uv_set, const tinygltf::ExtensionMap &extensions, bool alpha_only) {
            m->*to = texture(index, uv_set, extensions, alpha_only);
        });
        if (const tinygltf::Value *old = specular_glossiness(from)) values_of_specular_glossiness(*old, m);
    }
};

} // namespace

void gltf_build_materials(gltf_document &d, const std::vector<bool> &used, svo_mesh *mesh)
{
    size_t n = d.model.materials.size();
    builder b(d);
    if (!d.context->skip_images && d.context->pager == nullptr) {
        for (size_t i = 0; i < n; i++)
            if (used[i]) b.prepare(d.model.materials[i]);
        b.decode();
    }
    if (n != 0) {
        mesh->materials = gltf_array<svo_material>(d, n);
        for (size_t i = 0; i < n; i++) mesh->materials[i] = svo_material_default();
        mesh->material_count = static_cast<uint32_t>(n);
        for (size_t i = 0; i < n; i++) {
            mesh->materials[i].name = gltf_copy(d, d.model.materials[i].name);
            b.material(d.model.materials[i], used[i], &mesh->materials[i]);
        }
    }
    svo_error err{};
    svo_check(import_images_finish(&b.images, mesh, &err), err);
}
