/* Damaged small files of every format: truncations, flips, inserted numbers. The bytes end where their memory ends, so a
 * sanitizer sees any read beyond; memory is limited; what is accepted must satisfy all rules of svo_mesh.h. */
#include <stdlib.h>

#include "fmt_rig.h"
#include "import_check.h"
#include "import_common.h"

static import_context context(const svo_allocator *a)
{
    import_context c = {.path = "damaged", .allocator = a, .max_file_bytes = 1 << 20, .max_image_pixels = 1 << 16};
    snprintf(c.folder, sizeof c.folder, "%s/", test_folder());
    return c;
}

static uint32_t accepted;

static void feed(import_reader *reader, const char *what, uint64_t round, const uint8_t *bytes, size_t size)
{
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, 64 << 20, NULL);
    import_context c = context(&limit.base);
    uint8_t *copy = malloc(size != 0 ? size : 1);
    memcpy(copy, bytes, size);
    svo_mesh mesh = {.allocator = &limit.base};
    svo_error err = {0};
    svo_result r = reader(&c, copy, size, &mesh, &err);
    const char *fault = r == SVO_OK ? import_mesh_fault(&mesh) : NULL;
    accepted += r == SVO_OK;
    svo_mesh_free(&mesh);
    free(copy);
    CHECK_MSG(fault == NULL, "%s, round %llu: %s", what, (unsigned long long)round, fault);
    CHECK_MSG(r == SVO_OK || r == SVO_INVALID_DATA || r == SVO_UNSUPPORTED || r == SVO_LIMIT || r == SVO_IO, "%s, round %llu: %s (%s)", what,
              (unsigned long long)round, svo_result_name(r), err.message);
    CHECK_MSG(r == SVO_OK || err.message[0] != '\0', "%s, round %llu: no message", what, (unsigned long long)round);
    CHECK_MSG(svo_limit_in_use(&limit) == 0, "%s, round %llu: leaks", what, (unsigned long long)round);
}

static void damage(import_reader *reader, const char *what, const uint8_t *bytes, size_t size, bool text, uint32_t rounds)
{
    static const char *const pieces[] = {"-1", "4294967295", "1e999", "nan", "99999999999999999999", "0", "-", "\"", "{", "[", "\n", "/", "1/2/3", "#", "\\"};
    accepted = 0;
    feed(reader, what, 0, bytes, size);
    CHECK_MSG(accepted == 1, "%s: the good file is refused", what);
    size_t step = size / 1500 + 1;
    for (size_t n = 0; n < size && !test_failed(); n += step) feed(reader, what, n, bytes, n);
    uint64_t seed = 7;
    uint8_t *copy = malloc(size + 64);
    for (uint64_t round = 0; round < rounds && !test_failed(); round++) {
        size_t now = size;
        memcpy(copy, bytes, size);
        uint64_t changes = 1 + test_random(&seed) % 4;
        for (uint64_t k = 0; k < changes; k++) {
            size_t at = (size_t)(test_random(&seed) % now);
            switch (test_random(&seed) % (text ? 4 : 3)) {
            case 0: copy[at] ^= (uint8_t)(1u << test_random(&seed) % 8); break;
            case 1: copy[at] = (uint8_t)test_random(&seed); break;
            case 2: {
                static const uint8_t values[] = {0, 1, 0x7f, 0x80, 0xff};
                for (size_t i = at; i < at + 4 && i < now; i++) copy[i] = values[test_random(&seed) % 5];
                break;
            }
            default: {
                const char *piece = pieces[test_random(&seed) % (sizeof pieces / sizeof *pieces)];
                size_t n = strlen(piece);
                if (now + n > size + 64) break;
                memmove(copy + at + n, copy + at, now - at);
                memcpy(copy + at, piece, n);
                now += n;
            }
            }
        }
        feed(reader, what, round, copy, now);
    }
    free(copy);
}

static const char obj_text[] = "mtllib a.mtl\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0\nv 0.5 2.5e-1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n"
                               "usemtl one\nf 1/1/1 2/2/1 3/3/1 4//1\nusemtl two\nf -1 -2 -3\nf 1 2 3 4 5 \\\n 1\nl 1 2\n";

TEST(obj) { damage(import_obj, "obj", (const uint8_t *)obj_text, sizeof obj_text - 1, true, 4000); }

static const char ply_text[] = "ply\nformat ascii 1.0\ncomment TextureFile none.png\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
                               "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\nproperty list uchar int vertex_indices\n"
                               "property list uchar float texcoord\nend_header\n0 0 0 255 0 0\n1 0 0 0 255 0\n1 1 0 0 0 255\n0 1 0 9 9 9\n"
                               "4 0 1 2 3 8 0 0 1 0 1 1 0 1\n3 0 1 2 6 0 0 1 0 1 1\n";

TEST(ply_ascii) { damage(import_ply, "ply", (const uint8_t *)ply_text, sizeof ply_text - 1, true, 4000); }

TEST(ply_binary)
{
    for (int big = 0; big < 2; big++) {
        uint8_t bytes[1024];
        int n = snprintf((char *)bytes, sizeof bytes,
                         "ply\nformat binary_%s_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
                         "element face 2\nproperty list uchar int vertex_indices\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n",
                         big ? "big" : "little");
        size_t size = (size_t)n;
        const float xyz[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
        for (int i = 0; i < 9; i++) {
            uint8_t b[4];
            memcpy(b, &xyz[i], 4);
            for (int k = 0; k < 4; k++) bytes[size++] = b[big ? 3 - k : k];
        }
        const uint8_t counts[2] = {3, 3};
        for (int f = 0; f < 2; f++) {
            bytes[size++] = counts[f];
            for (uint8_t i = 0; i < 3; i++)
                for (int k = 0; k < 4; k++) bytes[size++] = k == (big ? 3 : 0) ? i : 0;
        }
        for (int k = 0; k < 4; k++) bytes[size++] = 0; /* an empty strip list */
        damage(import_ply, big ? "ply big-endian" : "ply little-endian", bytes, size, false, 3000);
    }
}

static const char stl_text[] = "solid a\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   vertex 0 1e0 0\n  endloop\n endfacet\nendsolid a\n";
TEST(stl_ascii) { damage(import_stl, "stl", (const uint8_t *)stl_text, sizeof stl_text - 1, true, 3000); }

TEST(stl_binary)
{
    uint8_t bytes[84 + 150] = {0};
    bytes[80] = 3;
    for (size_t i = 84; i < sizeof bytes; i++) bytes[i] = (uint8_t)(i * 37);
    damage(import_stl, "stl", bytes, sizeof bytes, false, 2000);
}

static const char off_text[] = "NCOFF\n# comment\n4 2 0\n0 0 0 0 0 1 255 0 0 255\n1 0 0 0 0 1 0 255 0 255\n1 1 0 0 0 1 0 0 255 255\n0 1 0 0 0 1 9 9 9 255\n"
                               "4 0 1 2 3 0.5 0.5 0.5\n3 0 1 2\n";
TEST(off) { damage(import_off, "off", (const uint8_t *)off_text, sizeof off_text - 1, true, 4000); }

static const char gltf_text[] =
    "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0,2]}],\"nodes\":[{\"mesh\":0,\"children\":[1],\"scale\":[1,-1,1]},"
    "{\"mesh\":0,\"translation\":[1,2,3],\"rotation\":[0,0,0,1]},{\"mesh\":0,\"skin\":0,\"extensions\":{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":0}}}}],"
    "\"skins\":[{\"joints\":[1]}],"
    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"COLOR_0\":2},\"indices\":1,\"material\":0,\"mode\":4},{\"attributes\":{\"POSITION\":3},\"mode\":5}]}],"
    "\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,0.5,0.25,1],\"baseColorTexture\":{\"index\":0,\"texCoord\":0,"
    "\"extensions\":{\"KHR_texture_transform\":{\"offset\":[0.5,0.5],\"rotation\":1.5,\"scale\":[2,2]}}}}}],"
    "\"textures\":[{\"source\":0,\"sampler\":0}],\"samplers\":[{\"wrapS\":33071}],\"images\":[{\"uri\":\"data:image/png;base64,iVBORw0KGgo=\"}],"
    "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":1,\"componentType\":5121,\"count\":3,\"type\":\"SCALAR\"},"
    "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},"
    "{\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"sparse\":{\"count\":2,\"indices\":{\"bufferView\":1,\"componentType\":5121},\"values\":{\"bufferView\":0}}}],"
    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,\"byteLength\":3}],"
    "\"buffers\":[{\"byteLength\":39,\"uri\":\"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAEC\"}]}";

/* A skin of two joints and an animation; accessors without data are zeros. */
static const char rig_text[] =
    "{\"asset\":{\"version\":\"2.0\"},\"accessors\":[{\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"componentType\":5121,\"count\":3,\"type\":\"VEC4\"},"
    "{\"componentType\":5126,\"count\":3,\"type\":\"VEC4\"},{\"componentType\":5126,\"count\":1,\"type\":\"SCALAR\"},{\"componentType\":5126,\"count\":2,\"type\":\"MAT4\"},"
    "{\"componentType\":5126,\"count\":1,\"type\":\"VEC4\"},{\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}],"
    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"JOINTS_0\":1,\"WEIGHTS_0\":2}}]}],\"skins\":[{\"joints\":[1,2],\"inverseBindMatrices\":4}],"
    "\"nodes\":[{\"mesh\":0,\"skin\":0},{\"children\":[2],\"scale\":[2,2,2]},{\"translation\":[0,1,0]}],\"animations\":[{\"name\":\"a\",\"samplers\":[{\"input\":3,\"output\":5},"
    "{\"input\":3,\"output\":6,\"interpolation\":\"CUBICSPLINE\"}],\"channels\":[{\"sampler\":0,\"target\":{\"node\":1,\"path\":\"rotation\"}},"
    "{\"sampler\":1,\"target\":{\"node\":2,\"path\":\"translation\"}}]}],\"scenes\":[{\"nodes\":[0,1]}],\"scene\":0}";

/* The importer with nodes, skins and animations, posed at a time; every reference of the rig must hold. */
static svo_result import_rigged(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    import_context with = *c;
    fmt_rig rig = {0};
    with.rig = &rig;
    with.animation = "0";
    with.time = 0.5;
    svo_result r = import_gltf(&with, bytes, size, mesh, err);
    svo_mat4 *world = r == SVO_OK ? calloc(rig.node_count + 1, sizeof *world) : NULL;
    for (uint32_t a = 0; r == SVO_OK && a < rig.animation_count; a++) fmt_rig_world(&rig, a, 0.25, world);
    for (uint32_t s = 0; r == SVO_OK && s < rig.shape_count; s++) {
        const fmt_rig_shape *shape = &rig.shapes[s];
        if (shape->skin != SVO_NONE && (shape->skin >= rig.skin_count || shape->part_count != mesh->shapes[s].part_count)) abort();
        for (uint32_t p = 0; p < shape->part_count; p++)
            for (uint64_t v = 0; shape->parts[p].influences != NULL && v < shape->parts[p].vertex_count; v++)
                for (int k = 0; k < 4; k++)
                    if (shape->parts[p].influences[v].weight[k] > 0 && shape->parts[p].influences[v].bone[k] >= rig.skins[shape->skin].joint_count) abort();
    }
    free(world);
    fmt_rig_free(&rig);
    return r;
}

TEST(gltf_with_a_rig) { damage(import_rigged, "rig", (const uint8_t *)rig_text, sizeof rig_text - 1, true, 4000); }

TEST(gltf) { damage(import_gltf, "gltf", (const uint8_t *)gltf_text, sizeof gltf_text - 1, true, 4000); }

static void damage_model(import_reader *reader, const char *relative, uint32_t rounds)
{
    const char *path = test_models() != NULL ? test_model(relative) : NULL;
    if (path == NULL) {
        test_skip("no folder of real models");
        return;
    }
    fmt_bytes bytes;
    svo_error err = {0};
    CHECK_OK(fmt_bytes_open(path, 0, NULL, &bytes, &err));
    damage(reader, relative, bytes.data, (size_t)bytes.size, false, rounds);
    fmt_bytes_close(&bytes);
}

TEST(glb) { damage_model(import_gltf, "D_gltf/features/box_vertex_colors/BoxVertexColors.glb", 3000); }
TEST(glb_draco) { damage_model(import_gltf, "D_gltf/features/draco_box/Box_Draco.glb", 4000); }

/* The Draco stream of that box is the last 118 bytes' buffer view; feed it to the .drc reader as well. */
TEST(drc)
{
    const char *path = test_models() != NULL ? test_model("D_gltf/features/draco_box/Box_Draco.glb") : NULL;
    if (path == NULL) {
        test_skip("no folder of real models");
        return;
    }
    fmt_bytes bytes;
    svo_error err = {0};
    CHECK_OK(fmt_bytes_open(path, 0, NULL, &bytes, &err));
    uint64_t at = 0;
    while (at + 5 < bytes.size && memcmp(bytes.data + at, "DRACO", 5) != 0) at++;
    CHECK(at + 5 < bytes.size);
    damage(import_drc, "drc", bytes.data + at, (size_t)(bytes.size - at), false, 4000);
    fmt_bytes_close(&bytes);
}

/* --- the n-th allocation fails --- */

static void fail_each(import_reader *reader, const char *what, const char *text)
{
    for (uint64_t n = 1; n < 10000; n++) {
        svo_limit_allocator limit;
        svo_limit_allocator_init(&limit, 64 << 20, NULL);
        limit.fail_at = n;
        import_context c = context(&limit.base);
        svo_mesh mesh = {.allocator = &limit.base};
        svo_error err = {0};
        svo_result r = reader(&c, (const uint8_t *)text, strlen(text), &mesh, &err);
        const char *fault = r == SVO_OK ? import_mesh_fault(&mesh) : NULL;
        svo_mesh_free(&mesh);
        CHECK_MSG(svo_limit_in_use(&limit) == 0, "%s: leaks when allocation %llu fails", what, (unsigned long long)n);
        CHECK_MSG(r == SVO_OK || r == SVO_OUT_OF_MEMORY, "%s, allocation %llu: %s (%s)", what, (unsigned long long)n, svo_result_name(r), err.message);
        CHECK_MSG(fault == NULL, "%s, allocation %llu: %s", what, (unsigned long long)n, fault);
        if (r == SVO_OK && limit.count < n) return; /* it was never reached: all have failed once */
    }
    test_fail(__FILE__, __LINE__, "%s: does not end", what);
}

TEST(allocations_fail)
{
    static const uint8_t pixel[4] = {1, 2, 3, 128};
    CHECK(import_put_text("a.mtl", "newmtl one\nKd 1 0 0\nmap_Kd p.png\nnewmtl two\nmap_d p.png\n") != NULL);
    CHECK(import_put_png("p.png", pixel, 1, 1) && import_put_png("none.png", pixel, 1, 1));
    fail_each(import_obj, "obj", obj_text);
    fail_each(import_ply, "ply", ply_text);
    fail_each(import_stl, "stl", stl_text);
    fail_each(import_off, "off", off_text);
    fail_each(import_gltf, "gltf", gltf_text);
    fail_each(import_rigged, "rig", rig_text);
}

/* --- claims and depth --- */

TEST(counts_are_claims)
{
    static const struct { import_reader *reader; const char *text; } cases[] = {
        {import_ply, "ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"},
        {import_ply, "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nproperty float y\nproperty float z\nend_header\n"},
        {import_ply, "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uint int vertex_index\n"
                     "end_header\n0 0 0\n4000000000 0 0 0\n"},
        {import_off, "OFF\n1000000000 1000000000 0\n0 0 0\n"},
        {import_off, "OFF\n1 1 0\n0 0 0\n4000000000 0 0 0\n"},
        {import_gltf, "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],"
                      "\"accessors\":[{\"componentType\":5126,\"count\":4000000000,\"type\":\"VEC3\"}]}"},
        {import_gltf, "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":4000000000000,\"uri\":\"data:,a\"}]}"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        svo_limit_allocator limit;
        svo_limit_allocator_init(&limit, 1 << 20, NULL);
        import_context c = context(&limit.base);
        svo_mesh mesh = {.allocator = &limit.base};
        svo_error err = {0};
        svo_result r = cases[i].reader(&c, (const uint8_t *)cases[i].text, strlen(cases[i].text), &mesh, &err);
        svo_mesh_free(&mesh);
        CHECK_MSG(r == SVO_INVALID_DATA || r == SVO_LIMIT, "case %zu: %s (%s)", i, svo_result_name(r), err.message);
    }
}

TEST(json_depth_is_bounded)
{
    size_t n = 4 << 20;
    char *text = malloc(n);
    memset(text, '[', n);
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, 1 << 20, NULL);
    import_context c = context(&limit.base);
    svo_mesh mesh = {.allocator = &limit.base};
    svo_error err = {0};
    svo_result r = import_gltf(&c, (const uint8_t *)text, n, &mesh, &err);
    free(text);
    CHECK_RESULT(r, SVO_INVALID_DATA);
    CHECK(strstr(err.message, "nested") != NULL);
}

/* Meshes that all name the same accessors must not cost more than the file is worth. */
TEST(repeated_data_is_bounded)
{
    svo_buffer text;
    svo_buffer_init(&text, NULL);
    const char *head = "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}],\"accessors\":[{\"componentType\":5126,\"count\":1000000,\"type\":\"VEC3\"}],"
                       "\"meshes\":[{\"primitives\":[";
    svo_buffer_append(&text, head, strlen(head));
    for (int i = 0; i < 2000; i++) {
        const char *one = i == 0 ? "{\"attributes\":{\"POSITION\":0}}" : ",{\"attributes\":{\"POSITION\":0}}";
        svo_buffer_append(&text, one, strlen(one));
    }
    svo_buffer_append(&text, "]}]}", 4);
    import_context c = context(NULL);
    svo_mesh mesh = {0};
    svo_error err = {0};
    svo_result r = import_gltf(&c, text.data, text.size, &mesh, &err);
    svo_buffer_free(&text);
    svo_mesh_free(&mesh);
    CHECK_RESULT(r, SVO_LIMIT);
}

/* --- paths --- */

TEST(paths_stay_in_the_folder)
{
    static const char *const bad[] = {"../a.bin", "a/../../b", "/etc/passwd", "C:/x", "http://x/y", "file:///etc/passwd", "..", "a/..", "~/x", "..\\a", ""};
    import_context c = context(NULL);
    char path[IMPORT_PATH_MAX];
    svo_error err;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) CHECK_RESULT(import_resolve(&c, bad[i], path, &err), SVO_INVALID_DATA);
    CHECK_OK(import_resolve(&c, "sub/a.bin", path, &err));
    CHECK(strncmp(path, c.folder, strlen(c.folder)) == 0);
    /* and through glTF, percent-encoded */
    static const char *const uris[] = {"../../../../../../etc/passwd", "%2e%2e/x.bin", "/etc/passwd", "%2Fetc%2Fpasswd", "file:///etc/passwd", "a%00b"};
    for (size_t i = 0; i < sizeof uris / sizeof *uris; i++) {
        char text[512];
        snprintf(text, sizeof text, "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":1,\"uri\":\"%s\"}]}", uris[i]);
        svo_mesh mesh = {0};
        svo_result r = import_gltf(&c, (const uint8_t *)text, strlen(text), &mesh, &err);
        svo_mesh_free(&mesh);
        CHECK_RESULT(r, SVO_INVALID_DATA);
    }
    /* a forgiving look-up never leaves either */
    CHECK(!import_find(&c, "/etc/passwd", path));
    CHECK(!import_find(&c, "../../../../../../../../etc/passwd", path));
}
