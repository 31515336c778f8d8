/* Materials, textures and images of a mesh in a binary glTF file. Images are stored as PNG; only those that a material looks into. */
#include <math.h>
#include <string.h>

#include "fmt_image.h"
#include "fmti_glb.h"

typedef struct materials {
    fmt_glb *g;
    const svo_mesh *mesh;
    json_t *images, *samplers, *textures;
    int *image_of; /* image of the mesh -> of the file, -1: not there yet */
    bool transforms; /* KHR_texture_transform is used */
    uint64_t sheared, missing;
} materials;

static float clamped(float v) { return v > 0 ? (v < 1 ? v : 1) : 0; }

/* --- images --------------------------------------------------------------------------------------------------------- */

static svo_result put_png(const svo_image *image, const svo_allocator *a, svo_buffer *to, svo_error *err)
{
    fmt_output *out;
    const uint64_t pixels = (uint64_t)image->width * image->height;
    const uint32_t channels = image->has_alpha ? 4 : 3;
    uint8_t *packed = svo_alloc(a, pixels, channels);
    if (packed == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to store a texture");
    for (uint32_t y = 0; y < image->height; y++) {
        svo_image_touch(image, 0, y, image->width);
        for (uint64_t x = 0; x < image->width; x++) memcpy(packed + channels * (y * (uint64_t)image->width + x), image->pixels + 4 * (y * (uint64_t)image->width + x), channels);
    }
    svo_result r = fmt_output_open_memory(to, &out, err);
    if (r == SVO_OK) {
        r = fmt_png_write(out, packed, image->width, image->height, channels, err);
        if (r == SVO_OK) r = fmt_output_commit(out, err);
        else fmt_output_discard(out);
    }
    svo_free(a, packed, pixels, channels);
    return r;
}

static svo_result put_image(materials *m, uint32_t image, svo_error *err)
{
    svo_buffer png;
    uint64_t view;
    if (m->image_of[image] >= 0) return SVO_OK;
    svo_buffer_init(&png, m->g->bytes.allocator);
    svo_result r = put_png(&m->mesh->images[image], m->g->bytes.allocator, &png, err);
    if (r == SVO_OK && fmt_glb_view(m->g, png.data, png.size, &view)) {
        m->image_of[image] = (int)json_array_size(m->images);
        json_array_append_new(m->images, json_pack("{s:I,s:s}", "bufferView", (json_int_t)view, "mimeType", "image/png"));
    }
    svo_buffer_free(&png);
    return r;
}

/* --- textures ------------------------------------------------------------------------------------------------------- */

/* The place of an equal element, or of the new one. */
static int place_in(json_t *list, json_t *element)
{
    for (size_t i = 0; i < json_array_size(list); i++)
        if (json_equal(json_array_get(list, i), element)) {
            json_decref(element);
            return (int)i;
        }
    json_array_append_new(list, element);
    return (int)json_array_size(list) - 1;
}

/* A = T * R * S of KHR_texture_transform; false where A shears. */
static bool decompose(const double a[6], double offset[2], double scale[2], double *angle)
{
    scale[0] = hypot(a[0], a[3]);
    *angle = scale[0] > 0 ? atan2(-a[3], a[0]) : 0;
    scale[1] = a[1] * sin(*angle) + a[4] * cos(*angle);
    offset[0] = a[2];
    offset[1] = a[5];
    double most = fmax(fmax(fabs(a[0]), fabs(a[1])), fmax(fabs(a[3]), fabs(a[4])));
    return fabs(a[1] - sin(*angle) * scale[1]) <= 1e-9 * most && fabs(a[4] - cos(*angle) * scale[1]) <= 1e-9 * most;
}

static svo_result put_texture(materials *m, const svo_texture *t, json_t *to, const char *name, svo_error *err)
{
    static const int wraps[] = {10497, 33071, 33648};
    static const double identity[6] = {1, 0, 0, 0, 1, 0};
    if (t->image == SVO_NONE || m->mesh->images == NULL) return SVO_OK;
    if (m->mesh->images[t->image].pixels == NULL) {
        m->missing++;
        return SVO_OK;
    }
    SVO_TRY(put_image(m, t->image, err));
    int sampler = place_in(m->samplers, json_pack("{s:i,s:i,s:i,s:i}", "magFilter", t->nearest ? 9728 : 9729, "minFilter", t->nearest ? 9984 : 9987, "wrapS", wraps[t->wrap_u], "wrapT",
                                                  wraps[t->wrap_v]));
    int texture = place_in(m->textures, json_pack("{s:i,s:i}", "source", m->image_of[t->image], "sampler", sampler));
    json_t *o = json_pack("{s:i}", "index", texture);
    if (o == NULL) return SVO_OK; /* said when the file is written */
    if (t->uv_set != 0) json_object_set_new(o, "texCoord", json_integer(t->uv_set));
    if (memcmp(t->transform, identity, sizeof identity) != 0) {
        double offset[2], scale[2], angle;
        if (!decompose(t->transform, offset, scale, &angle)) m->sheared++;
        json_t *x = json_pack("{s:o,s:o,s:f}", "offset", fmt_glb_vector(offset, 2), "scale", fmt_glb_vector(scale, 2), "rotation", angle);
        json_object_set_new(o, "extensions", json_pack("{s:o}", "KHR_texture_transform", x));
        m->transforms = true;
    }
    json_object_set_new(to, name, o);
    return SVO_OK;
}

static svo_result put_material(materials *m, const svo_material *from, json_t *list, svo_error *err)
{
    static const char *const modes[] = {"OPAQUE", "MASK", "BLEND"};
    double base[4], emissive[3], strength = 1;
    for (int e = 0; e < 4; e++) base[e] = clamped(from->base_color[e]);
    for (int e = 0; e < 3; e++) strength = from->emissive[e] > strength ? from->emissive[e] : strength;
    if (!isfinite(strength)) strength = 1;
    for (int e = 0; e < 3; e++) emissive[e] = clamped((float)(from->emissive[e] / strength));
    json_t *pbr = json_pack("{s:o,s:f,s:f}", "baseColorFactor", fmt_glb_vector(base, 4), "metallicFactor", (double)clamped(from->metallic), "roughnessFactor", (double)clamped(from->roughness));
    json_t *o = json_pack("{s:o,s:o,s:s,s:b}", "pbrMetallicRoughness", pbr, "emissiveFactor", fmt_glb_vector(emissive, 3), "alphaMode", modes[from->alpha_mode], "doubleSided",
                          (int)from->double_sided);
    json_t *name = from->name != NULL ? json_string(from->name) : NULL; /* NULL where it is not UTF-8 */
    if (o == NULL) return SVO_OK;
    json_array_append_new(list, o);
    if (name != NULL) json_object_set_new(o, "name", name);
    if (from->alpha_mode == SVO_ALPHA_MASK && from->alpha_cutoff >= 0) json_object_set_new(o, "alphaCutoff", json_real(from->alpha_cutoff));
    if (strength > 1) json_object_set_new(o, "extensions", json_pack("{s:{s:f}}", "KHR_materials_emissive_strength", "emissiveStrength", strength));
    if (strength > 1) fmt_glb_extension(m->g, "KHR_materials_emissive_strength", false);
    SVO_TRY(put_texture(m, &from->base_color_texture, pbr, "baseColorTexture", err));
    SVO_TRY(put_texture(m, &from->metallic_roughness_texture, pbr, "metallicRoughnessTexture", err));
    m->missing += from->opacity_texture.image != SVO_NONE; /* glTF has alpha in the base colour alone */
    return put_texture(m, &from->emissive_texture, o, "emissiveTexture", err);
}

svo_result fmt_glb_materials(fmt_glb *g, const svo_mesh *mesh, bool plain, svo_warnings *warnings, svo_error *err)
{
    if (mesh->material_count == 0 && !plain) return SVO_OK;
    materials m = {.g = g, .mesh = mesh, .images = json_array(), .samplers = json_array(), .textures = json_array()};
    json_t *list = json_array();
    const svo_allocator *a = g->bytes.allocator;
    uint32_t n = mesh->image_count > 0 ? mesh->image_count : 1;
    m.image_of = svo_alloc(a, n, sizeof *m.image_of);
    svo_result r = m.image_of == NULL ? svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to store materials") : SVO_OK;
    for (uint32_t i = 0; r == SVO_OK && i < n; i++) m.image_of[i] = -1;
    for (uint32_t i = 0; r == SVO_OK && i < mesh->material_count; i++) r = put_material(&m, &mesh->materials[i], list, err);
    if (r == SVO_OK && plain) {
        svo_material white = svo_material_default();
        white.double_sided = true;
        r = put_material(&m, &white, list, err);
    }
    svo_free(a, m.image_of, n, sizeof *m.image_of);
    json_object_set_new(g->root, "materials", list);
    struct { const char *name; json_t *list; } const all[] = {{"images", m.images}, {"samplers", m.samplers}, {"textures", m.textures}};
    for (int i = 0; i < 3; i++) {
        if (json_array_size(all[i].list) > 0) json_object_set(g->root, all[i].name, all[i].list); /* glTF has no empty lists */
        json_decref(all[i].list);
    }
    if (m.transforms) fmt_glb_extension(g, "KHR_texture_transform", false);
    if (m.sheared > 0) svo_warn(warnings, "%llu texture transforms shear, which glTF has not; they look otherwise in the .glb", (unsigned long long)m.sheared);
    if (m.missing > 0) svo_warn(warnings, "%llu textures are not in the .glb (not loaded, or opacity apart from colour)", (unsigned long long)m.missing);
    return r;
}
