/* Which texel a corner sees, and in which light: an asymmetric image (four labelled corners) through glTF, OBJ and PLY,
 * with flips, transforms, wrap modes, factors and vertex colours. */
#include <math.h>

#include "import_check.h"
#include "svo_channel.h"

/* Top row red, green; bottom row blue, white. */
static const uint8_t image[16] = {255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 255, 255, 255, 255, 255};
static const uint8_t *const red = image, *const green = image + 4, *const blue = image + 8, *const white = image + 12;

static svo_warnings warnings;

static bool load_without(const char *path, uint32_t without, svo_mesh *mesh)
{
    svo_error err = {0};
    memset(&warnings, 0, sizeof warnings);
    fmt_import_options o = {.warnings = &warnings, .without = without};
    svo_result r = path != NULL ? fmt_import_mesh(path, &o, mesh, &err) : SVO_IO;
    if (r != SVO_OK) test_fail(__FILE__, __LINE__, "import: %s", err.message);
    return r == SVO_OK;
}

static bool load(const char *path, svo_mesh *mesh) { return load_without(path, 0, mesh); }

/* The vertex of the first part at (x, y), and what it sees. */
static bool sees(const svo_mesh *m, double x, double y, const uint8_t *expected)
{
    const svo_part *part = &m->shapes[0].parts[0];
    for (uint64_t v = 0; v < part->vertex_count; v++)
        if (part->positions[3 * v] == x && part->positions[3 * v + 1] == y) {
            uint8_t texel[4];
            import_texel(m, part, v, texel);
            if (memcmp(texel, expected, 4) == 0) return true;
            test_fail(__FILE__, __LINE__, "corner %g %g sees %u %u %u", x, y, texel[0], texel[1], texel[2]);
            return false;
        }
    test_fail(__FILE__, __LINE__, "no vertex at %g %g", x, y);
    return false;
}

/* A unit square: lower left is shown the image's lower left texel, and so on. */
static const char obj[] = "mtllib sub\\quad mat.MTL\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0.25 0.25\nvt 0.75 0.25\nvt 0.75 0.75\nvt 0.25 0.75\n"
                          "usemtl some thing\nf 1/1 2/2 3/3 4/4";

TEST(obj_corners)
{
    CHECK(import_put_png("Quad Image.png", image, 2, 2));
    CHECK(import_put_text("quad mat.mtl", "newmtl some thing\nKd 0.5 0.5 0.5\nmap_Kd C:\\textures\\quad image.PNG\nKe 0 1 0") != NULL);
    svo_mesh m;
    if (!load(import_put_text("quad.obj", obj), &m)) return;
    CHECK_U64(svo_mesh_count(&m).triangles, 2);
    CHECK_U64(m.image_count, 1);
    CHECK(sees(&m, 0, 0, blue) && sees(&m, 1, 0, white) && sees(&m, 1, 1, green) && sees(&m, 0, 1, red));
    const svo_material *x = &m.materials[m.shapes[0].parts[0].material];
    CHECK(fabs((double)x->base_color[0] - 0.21404114) < 1e-6); /* Kd is sRGB */
    CHECK(x->emissive[0] == 0 && x->emissive[1] == 1 && x->base_color_texture.wrap_u == SVO_WRAP_REPEAT);
    CHECK(x->alpha_mode == SVO_ALPHA_OPAQUE);
    svo_mesh_free(&m);
}

TEST(obj_texture_options)
{
    CHECK(import_put_png("Quad Image.png", image, 2, 2));
    /* shifted by half an image to the right, and to above 1 at the top, where clamping holds the last row */
    CHECK(import_put_text("quad mat.mtl", "newmtl some thing\nmap_Kd -blendu on -clamp on -s 1 1 1 -o 0.5 0.5 0 Quad Image.png\n") != NULL);
    svo_mesh m;
    if (!load(import_put_text("quad.obj", obj), &m)) return;
    CHECK(sees(&m, 0, 0, green) && sees(&m, 1, 0, green) && sees(&m, 1, 1, green) && sees(&m, 0, 1, green));
    svo_mesh_free(&m);
    CHECK(import_put_text("quad mat.mtl", "newmtl some thing\nmap_Kd -s 2 1 -o 0.5 0 Quad Image.png\n") != NULL);
    if (!load(import_put_text("quad.obj", obj), &m)) return;
    /* u' = 2 u + 0.5: 0.25 -> 1.0, 0.75 -> 2.0; repeated to 0 */
    CHECK(sees(&m, 0, 0, blue) && sees(&m, 1, 0, blue) && sees(&m, 1, 1, red));
    svo_mesh_free(&m);
}

TEST(obj_missing_files_warn)
{
    svo_mesh m;
    if (!load(import_put_text("lone.obj", "mtllib nowhere.mtl\nusemtl x\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3"), &m)) return;
    CHECK(import_has_warning(&warnings, "nowhere.mtl") && import_has_warning(&warnings, "'x'"));
    CHECK_U64(m.shapes[0].parts[0].material, SVO_NONE);
    svo_mesh_free(&m);
    CHECK(import_put_text("t.mtl", "newmtl x\nKd 1 0 0\nmap_Kd ../../gone.png\n") != NULL);
    if (!load(import_put_text("lone.obj", "mtllib t.mtl\nusemtl x\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3"), &m)) return;
    CHECK(import_has_warning(&warnings, "gone.png"));
    CHECK(m.materials[0].base_color_texture.image == SVO_NONE && m.materials[0].base_color[0] == 1);
    svo_mesh_free(&m);
}

TEST(obj_alpha)
{
    uint8_t holes[16];
    memcpy(holes, image, 16);
    holes[3] = 0;
    CHECK(import_put_png("holes.png", holes, 2, 2) && import_put_png("Quad Image.png", image, 2, 2));
    CHECK(import_put_text("t.mtl", "newmtl a\nmap_Kd holes.png\nnewmtl b\nmap_Kd Quad Image.png\nmap_d Quad Image.png\nnewmtl c\nd 0.25\nnewmtl e\nTr 0.25\n") != NULL);
    svo_mesh m;
    if (!load(import_put_text("a.obj", "mtllib t.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), &m)) return;
    CHECK_U64(m.material_count, 4);
    CHECK(m.materials[0].alpha_mode == SVO_ALPHA_MASK && m.materials[0].alpha_cutoff == 0.5f);
    CHECK(m.materials[1].alpha_mode == SVO_ALPHA_MASK && m.materials[1].opacity_texture.image != SVO_NONE);
    CHECK(m.materials[2].alpha_mode == SVO_ALPHA_BLEND && m.materials[2].base_color[3] == 0.25f);
    CHECK(m.materials[3].base_color[3] == 0.75f);
    svo_mesh_free(&m);
}

/* Textures that nobody reads are not opened: a missing one is not told. What cuts is read for its alpha, in every order of asking. */
TEST(textures_that_nobody_reads)
{
    const uint8_t cut[16] = {255, 0, 0, 255, 0, 255, 0, 0, 0, 0, 255, 255, 255, 255, 255, 255};
    const uint32_t all = FMT_WITHOUT_COLOR | FMT_WITHOUT_EMISSIVE | FMT_WITHOUT_METALLIC_ROUGHNESS;
    svo_mesh m;
    CHECK(import_put_png("cut.png", cut, 2, 2));
    CHECK(import_put_pixels("opaque.png", image, 3, 2, 2));
    CHECK(import_put_text("lazy.mtl", "newmtl a\nmap_Kd cut.png\nmap_Ke missing.png\nnewmtl b\nmap_Kd opaque.png\nnewmtl c\nmap_Kd cut.png\nmap_d opaque.png\nnewmtl d\nmap_Kd gone.png\nnewmtl e\nmap_Kd opaque.png\n") != NULL);
    const char *path = import_put_text("lazy.obj", "mtllib lazy.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\nusemtl b\nf 1/1 2/1 3/1\nusemtl c\nf 1/1 2/1 3/1\nusemtl d\nf 1/1 2/1 3/1\nusemtl e\nf 1/1 2/1 3/1\n");
    for (uint32_t without = 0; without <= all; without++) {
        if (!load_without(path, without, &m)) return;
        CHECK(import_mesh_fault(&m) == NULL);
        CHECK_U64(m.material_count, 5);
        const bool color = (without & FMT_WITHOUT_COLOR) == 0;
        const svo_material *x = m.materials;
        CHECK(x[0].alpha_mode == SVO_ALPHA_MASK && x[0].base_color_texture.image != SVO_NONE);
        CHECK(x[2].alpha_mode == SVO_ALPHA_MASK && x[2].opacity_texture.image != SVO_NONE && x[2].base_color_texture.image == x[0].base_color_texture.image);
        CHECK(x[1].alpha_mode == SVO_ALPHA_OPAQUE && x[3].alpha_mode == SVO_ALPHA_OPAQUE && x[4].alpha_mode == SVO_ALPHA_OPAQUE);
        if (color) CHECK(x[1].base_color_texture.image == x[2].opacity_texture.image && x[4].base_color_texture.image == x[1].base_color_texture.image);
        CHECK_U64(m.image_count, 2); /* opaque.png is map_d of c */
        CHECK_U64(warnings.count, 1 + ((without & FMT_WITHOUT_EMISSIVE) == 0)); /* gone.png might have cut */
        svo_mesh_free(&m);
    }
    if (!load_without(import_put_text("t.ply", "ply\nformat ascii 1.0\ncomment TextureFile missing.png\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
                                               "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n"), all, &m)) return;
    CHECK_U64(warnings.count, 0);
    svo_mesh_free(&m);
}

TEST(vertex_colors_are_srgb_in_obj_and_ply)
{
    svo_mesh m;
    if (!load(import_put_text("c.obj", "v 0 0 0 0.5 0 1\nv 1 0 0 1 1 1\nv 0 1 0\nf 1 2 3"), &m)) return;
    const float *c = m.shapes[0].parts[0].colors;
    CHECK(c != NULL && fabs((double)c[0] - 0.21404114) < 1e-6 && c[1] == 0 && c[2] == 1 && c[3] == 1 && c[8] == 1);
    svo_mesh_free(&m);
    if (!load(import_put_text("c.ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n"
                                       "property uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_index\nend_header\n"
                                       "0 0 0 128 0 255\n1 0 0 1 2 3\n0 1 0 4 5 6\n3 0 1 2\n"), &m)) return;
    c = m.shapes[0].parts[0].colors;
    CHECK(c != NULL && fabsf(c[0] - svo_srgb_to_linear(128)) < 1e-6f && c[1] == 0 && c[2] == 1);
    svo_mesh_free(&m);
}

/* As a file of CGAL has it: blank lines, comments at the end of lines and right after a token, three components. */
TEST(off_colors_and_comments)
{
    svo_mesh m;
    if (!load(import_put_text("c.off", "# first\n# second\nCOFF\n3 1 0\n\n-1 -1 0 1 0.0 0.0 #red\n0 -1 0 0.0 0.0 1#blue\n\n1 0 0 1 1 0#\n3 0 1 2 0 1.0 0#green\n"), &m)) return;
    const float *c = m.shapes[0].parts[0].colors;
    CHECK_U64(svo_mesh_count(&m).triangles, 1);
    CHECK_U64(warnings.count, 0);
    CHECK(c != NULL && c[1] >= 0);
    svo_mesh_free(&m);
    if (!load(import_put_text("d.off", "OFF# one triangle\n3 1 0#\n0 0 0#\n1 0 0\n0 1 0#3 4\n3 0 1 2#\n"), &m)) return;
    CHECK_U64(svo_mesh_count(&m).triangles, 1);
    svo_mesh_free(&m);
}

/* Blender 2.47 wrote its name without the word "comment". Where a line may have been a property it stays an error. */
TEST(ply_line_that_is_not_known)
{
    static const char body[] = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n%selement face 1\n"
                               "property list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    char text[600], late[400];
    snprintf(late, sizeof late, body, "");
    snprintf(text, sizeof text, "ply\nformat ascii 1.0\nCreated by Blender3D 247 - www.blender.org, source file: \n%s", late);
    svo_mesh m;
    if (!load(import_put_text("b.ply", text), &m)) return;
    CHECK_U64(svo_mesh_count(&m).triangles, 1);
    CHECK_U64(warnings.count, 1);
    svo_mesh_free(&m);
    snprintf(late, sizeof late, body, "proberty float w\n");
    snprintf(text, sizeof text, "ply\nformat ascii 1.0\n%s", late);
    svo_error err = {0};
    fmt_import_options o = {.warnings = &warnings};
    CHECK(fmt_import_mesh(import_put_text("l.ply", text), &o, &m, &err) == SVO_INVALID_DATA);
}

TEST(ply_face_texture_coordinates)
{
    CHECK(import_put_png("Quad Image.png", image, 2, 2));
    svo_mesh m;
    if (!load(import_put_text("t.ply", "ply\nformat ascii 1.0\ncomment TextureFile Quad Image.png\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
                                       "element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
                                       "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3 8 0.25 0.25 0.75 0.25 0.75 0.75 0.25 0.75\n"), &m)) return;
    CHECK(sees(&m, 0, 0, blue) && sees(&m, 1, 0, white) && sees(&m, 1, 1, green) && sees(&m, 0, 1, red));
    svo_mesh_free(&m);
}

/* --- glTF: the same square; uv (0,0) is the top left --- */

static bool load_gltf(const char *texture_info, const char *sampler, const char *node, svo_mesh *m)
{
    static char text[8192];
    if (!import_put_png("Quad Image.png", image, 2, 2)) return false;
    const float data[20] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0.25f, 0.75f, 0.75f, 0.75f, 0.75f, 0.25f, 0.25f, 0.25f};
    if (import_put("quad.bin", data, sizeof data) == NULL) return false;
    snprintf(text, sizeof text,
             "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[%s],"
             "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"TEXCOORD_1\":1},\"material\":0,\"mode\":6}]}],"
             "\"materials\":[{\"emissiveFactor\":[1,0.5,0],\"alphaMode\":\"MASK\",\"alphaCutoff\":0.25,\"doubleSided\":true,"
             "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":4}},"
             "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,0.25,0.125,0.75],\"metallicFactor\":0.5,\"roughnessFactor\":0.25,"
             "\"baseColorTexture\":{\"index\":0,%s}}}],"
             "\"textures\":[{\"source\":0,\"sampler\":0}],\"samplers\":[{%s}],\"images\":[{\"uri\":\"Quad%%20Image.png\"}],"
             "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},{\"bufferView\":1,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"}],"
             "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":32}],\"buffers\":[{\"byteLength\":80,\"uri\":\"quad.bin\"}]}",
             node, texture_info, sampler);
    return load(import_put_text("quad.gltf", text), m);
}

TEST(gltf_corners_and_factors)
{
    svo_mesh m;
    if (!load_gltf("\"texCoord\":1", "", "{\"mesh\":0}", &m)) return;
    CHECK_U64(svo_mesh_count(&m).triangles, 2);
    CHECK(sees(&m, 0, 0, blue) && sees(&m, 1, 0, white) && sees(&m, 1, 1, green) && sees(&m, 0, 1, red));
    const svo_material *x = &m.materials[0];
    CHECK(x->base_color[0] == 0.5f && x->base_color[1] == 0.25f && x->base_color[2] == 0.125f && x->base_color[3] == 0.75f); /* linear as they are */
    CHECK(x->emissive[0] == 4 && x->emissive[1] == 2 && x->metallic == 0.5f && x->roughness == 0.25f);
    CHECK(x->alpha_mode == SVO_ALPHA_MASK && x->alpha_cutoff == 0.25f && x->double_sided);
    svo_mesh_free(&m);
}

TEST(gltf_texture_transform_and_wrap)
{
    svo_mesh m;
    /* texCoord overridden by the extension; shifted half an image to the right: columns change places */
    if (!load_gltf("\"texCoord\":0,\"extensions\":{\"KHR_texture_transform\":{\"offset\":[0.5,0],\"texCoord\":1}}", "", "{\"mesh\":0}", &m)) return;
    CHECK(sees(&m, 0, 0, white) && sees(&m, 1, 0, blue) && sees(&m, 1, 1, red) && sees(&m, 0, 1, green));
    svo_mesh_free(&m);
    /* a mirrored repeat of the same shift shows the right column twice: 1.25 is 0.75 again */
    if (!load_gltf("\"texCoord\":1,\"extensions\":{\"KHR_texture_transform\":{\"offset\":[0.5,0]}}", "\"wrapS\":33648", "{\"mesh\":0}", &m)) return;
    CHECK(sees(&m, 0, 0, white) && sees(&m, 1, 0, white) && sees(&m, 1, 1, green) && sees(&m, 0, 1, green));
    svo_mesh_free(&m);
    if (!load_gltf("\"texCoord\":1,\"extensions\":{\"KHR_texture_transform\":{\"offset\":[-1,0]}}", "\"wrapS\":33071,\"magFilter\":9728", "{\"mesh\":0}", &m)) return;
    CHECK(sees(&m, 1, 0, blue) && sees(&m, 1, 1, red) && m.materials[0].base_color_texture.nearest);
    svo_mesh_free(&m);
    /* A quarter turn, counter-clockwise in a space whose v points down: (u, v) -> (v, -u). Lower left (0.25, 0.75) goes to
     * (0.75, -0.25), which repeats to (0.75, 0.75). */
    if (!load_gltf("\"texCoord\":1,\"extensions\":{\"KHR_texture_transform\":{\"rotation\":1.5707963267948966}}", "", "{\"mesh\":0}", &m)) return;
    CHECK(sees(&m, 0, 0, white) && sees(&m, 1, 0, green) && sees(&m, 1, 1, red) && sees(&m, 0, 1, blue));
    svo_mesh_free(&m);
}

/* The same of a glTF file: the first material is cut out by an image with alpha, the second (MASK too) has one without, the third is opaque, the fourth reads one for its emission. */
TEST(gltf_textures_that_nobody_reads)
{
    const uint8_t cut[16] = {255, 0, 0, 255, 0, 255, 0, 0, 0, 0, 255, 255, 255, 255, 255, 255};
    const float data[18] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 0, 1, 1};
    char primitives[1024] = "", text[4096];
    CHECK(import_put_png("cut.png", cut, 2, 2) && import_put_pixels("plain.png", image, 3, 2, 2) && import_put("lazy.bin", data, sizeof data) != NULL);
    for (int i = 0; i < 5; i++)
        snprintf(primitives + strlen(primitives), sizeof primitives - strlen(primitives), "%s{\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":1},\"material\":%d}", i > 0 ? "," : "", i);
    snprintf(text, sizeof text,
             "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[%s]}],"
             "\"materials\":[{\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}},{\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":1}}},"
             "{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":2}}},{\"emissiveTexture\":{\"index\":1}},{\"pbrMetallicRoughness\":{\"metallicRoughnessTexture\":{\"index\":2}}}],"
             "\"textures\":[{\"source\":0},{\"source\":1},{\"source\":2}],\"images\":[{\"uri\":\"cut.png\"},{\"uri\":\"plain.png\"},{\"uri\":\"missing.png\"}],"
             "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":1,\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"}],"
             "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,\"byteLength\":24}],\"buffers\":[{\"byteLength\":72,\"uri\":\"lazy.bin\"}]}", primitives);
    const char *path = import_put_text("lazy.gltf", text);
    for (uint32_t without = 0; without <= 7; without++) {
        svo_mesh m;
        if (!load_without(path, without, &m)) return;
        const bool color = (without & FMT_WITHOUT_COLOR) == 0, emissive = (without & FMT_WITHOUT_EMISSIVE) == 0, metallic = (without & FMT_WITHOUT_METALLIC_ROUGHNESS) == 0;
        const svo_material *x = m.materials;
        CHECK(import_mesh_fault(&m) == NULL);
        CHECK(x[0].alpha_mode == SVO_ALPHA_MASK && x[0].base_color_texture.image != SVO_NONE && m.images[x[0].base_color_texture.image].has_alpha);
        CHECK((x[1].base_color_texture.image != SVO_NONE) == color);
        CHECK((x[3].emissive_texture.image != SVO_NONE) == emissive);
        CHECK(x[1].alpha_mode == SVO_ALPHA_MASK && x[2].base_color_texture.image == SVO_NONE && x[4].metallic_roughness_texture.image == SVO_NONE);
        CHECK_U64(m.image_count, 1 + (color || emissive));
        CHECK_U64(warnings.count, color || metallic);
        svo_mesh_free(&m);
    }
}

TEST(gltf_nodes)
{
    svo_mesh m;
    if (!load_gltf("\"texCoord\":1", "", "{\"mesh\":0,\"children\":[1],\"scale\":[2,2,-2],\"translation\":[1,2,3]},{\"mesh\":0,\"name\":\"b\",\"rotation\":[0,0,0.7071067811865476,0.7071067811865476]}", &m)) return;
    CHECK_U64(m.shape_count, 1);
    CHECK_U64(m.instance_count, 2);
    CHECK(svo_mat4_det3(&m.instances[0].transform) == -8);
    svo_vec3 p = svo_mat4_point(&m.instances[1].transform, svo_v3(1, 0, 0)); /* turned to +Y, then scaled and moved */
    CHECK(fabs(p.x - 1) < 1e-12 && fabs(p.y - 4) < 1e-12 && fabs(p.z - 3) < 1e-12 && strcmp(m.instances[1].name, "b") == 0);
    CHECK_U64(svo_mesh_count(&m).placed_triangles, 4);
    svo_mesh_free(&m);
}

/* --- polygons --- */

static double area(const svo_part *part)
{
    double sum = 0;
    for (uint64_t t = 0; t < part->triangle_count; t++) {
        const double *a = part->positions + 3 * part->indices[3 * t], *b = part->positions + 3 * part->indices[3 * t + 1],
                     *c = part->positions + 3 * part->indices[3 * t + 2];
        sum += ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2;
    }
    return sum;
}

static double absolute_area(const svo_part *part)
{
    double sum = 0;
    for (uint64_t t = 0; t < part->triangle_count; t++) {
        svo_part one = *part;
        one.indices = part->indices + 3 * t;
        one.triangle_count = 1;
        sum += fabs(area(&one));
    }
    return sum;
}

/* Random star-shaped polygons, concave nearly always: the triangles cover exactly the polygon, so no triangle is turned. */
TEST(concave_polygons)
{
    uint64_t seed = 3;
    for (int round = 0; round < 200; round++) {
        static char text[1 << 16];
        uint32_t n = 4 + (uint32_t)(test_random(&seed) % 60);
        double x[64], y[64], polygon = 0;
        size_t used = 0;
        for (uint32_t i = 0; i < n; i++) {
            double r = 0.2 + test_random_unit(&seed), angle = 6.283185307179586 * i / n;
            x[i] = r * cos(angle), y[i] = r * sin(angle);
            used += (size_t)snprintf(text + used, sizeof text - used, "v %.17g %.17g 0\n", x[i], y[i]);
        }
        used += (size_t)snprintf(text + used, sizeof text - used, "f");
        for (uint32_t i = 0; i < n; i++) {
            polygon += (x[i] * y[(i + 1) % n] - y[i] * x[(i + 1) % n]) / 2;
            used += (size_t)snprintf(text + used, sizeof text - used, " %u", i + 1);
        }
        svo_mesh m;
        if (!load(import_put_text("poly.obj", text), &m)) return;
        const svo_part *part = &m.shapes[0].parts[0];
        CHECK_U64(part->triangle_count, n - 2);
        CHECK_MSG(fabs(area(part) - polygon) < 1e-12 && fabs(absolute_area(part) - polygon) < 1e-12, "round %d: %u corners, area %.17g, absolute %.17g, polygon %.17g",
                  round, n, area(part), absolute_area(part), polygon);
        svo_mesh_free(&m);
    }
}

/* --- glTF: instances and skins --- */

TEST(gltf_gpu_instances_with_quantised_rotation)
{
    /* one triangle; two instances: moved by (10, 0, 0) and by (0, 5, 0) with a half turn about Z (snorm16) */
    float data[15] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 10, 0, 0, 0, 5, 0};
    int16_t turns[8] = {0, 0, 0, 32767, 0, 0, 32767, 0};
    uint8_t bytes[76];
    memcpy(bytes, data, 60);
    memcpy(bytes + 60, turns, 16);
    CHECK(import_put("i.bin", bytes, sizeof bytes) != NULL);
    svo_mesh m;
    if (!load(import_put_text("i.gltf",
            "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"EXT_mesh_gpu_instancing\"],\"extensionsRequired\":[\"EXT_mesh_gpu_instancing\"],\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
            "\"nodes\":[{\"mesh\":0,\"scale\":[2,2,2],\"extensions\":{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":1,\"ROTATION\":2}}}}],"
            "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},"
            "{\"bufferView\":0,\"byteOffset\":36,\"componentType\":5126,\"count\":2,\"type\":\"VEC3\"},{\"bufferView\":1,\"componentType\":5122,\"normalized\":true,\"count\":2,\"type\":\"VEC4\"}],"
            "\"bufferViews\":[{\"buffer\":0,\"byteLength\":60},{\"buffer\":0,\"byteOffset\":60,\"byteLength\":16}],\"buffers\":[{\"byteLength\":76,\"uri\":\"i.bin\"}]}"), &m)) return;
    CHECK_U64(m.shape_count, 1);
    CHECK_U64(m.instance_count, 2);
    svo_vec3 a = svo_mat4_point(&m.instances[0].transform, svo_v3(1, 0, 0)), b = svo_mat4_point(&m.instances[1].transform, svo_v3(1, 0, 0));
    CHECK(a.x == 22 && a.y == 0 && fabs(b.x + 2) < 1e-9 && fabs(b.y - 10) < 1e-9);
    svo_mesh_free(&m);
}

TEST(gltf_skin_in_bind_pose)
{
    /* Three vertices bound to joint 1 (moved by +3 in x) with weights 0.5 (not normalised); the skinned node's own translation
     * must have no effect; no inverse bind matrices: identity. */
    uint8_t bytes[36 + 12 + 48];
    const float xyz[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0}, weights[12] = {0.5f, 0, 0, 0, 0.5f, 0, 0, 0, 0.5f, 0, 0, 0};
    const uint8_t joints[12] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
    memcpy(bytes, xyz, 36);
    memcpy(bytes + 36, joints, 12);
    memcpy(bytes + 48, weights, 48);
    CHECK(import_put("s.bin", bytes, sizeof bytes) != NULL);
    svo_mesh m;
    if (!load(import_put_text("s.gltf",
            "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0,1]}],\"nodes\":[{\"mesh\":0,\"skin\":0,\"translation\":[100,0,0]},"
            "{\"children\":[2],\"translation\":[1,0,0]},{\"translation\":[2,0,0]}],\"skins\":[{\"joints\":[1,2]}],"
            "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"JOINTS_0\":1,\"WEIGHTS_0\":2}}]}],"
            "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":1,\"componentType\":5121,\"count\":3,\"type\":\"VEC4\"},"
            "{\"bufferView\":2,\"componentType\":5126,\"count\":3,\"type\":\"VEC4\"}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,\"byteLength\":12},"
            "{\"buffer\":0,\"byteOffset\":48,\"byteLength\":48}],\"buffers\":[{\"byteLength\":96,\"uri\":\"s.bin\"}]}"), &m)) return;
    double low[3], high[3];
    CHECK(svo_mesh_bounds(&m, low, high));
    CHECK(low[0] == 3 && high[0] == 4 && low[1] == 0 && high[1] == 1);
    CHECK(import_has_warning(&warnings, "bind pose"));
    svo_mesh_free(&m);
}
