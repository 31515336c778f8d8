/* Real models: the triangle counts that the folder's MANIFEST.md states, and verdicts on its malformed sets. */
#include <dirent.h>
#include <stdlib.h>
#include <sys/stat.h>

#include "import_check.h"

/* Where our answer differs from the list by intent. count -1: refused. */
static const struct { const char *path; int64_t count; svo_result result; const char *why; } exceptions[] = {
    {"D_gltf/features/khr_meshopt/meshopt-no-fallback.gltf", -1, SVO_UNSUPPORTED, "meshopt"},
    {"D_gltf/features/meshopt_no_fallback/meshopt-no-fallback.gltf", -1, SVO_UNSUPPORTED, "meshopt"},
    {"D_gltf/features/meshopt_bunny/bunny.glb", -1, SVO_UNSUPPORTED, "meshopt"},
    {"D_gltf/features/meshopt_japanese_garden/scene.glb", -1, SVO_UNSUPPORTED, "meshopt"},
    {"D_gltf/features/quant_pirate/pirate.glb", -1, SVO_UNSUPPORTED, "meshopt"},
    {"E_formats/obj_odd/number_formats.obj", -1, SVO_INVALID_DATA, "3.1+e2 is no number"},
    {"E_formats/ply_misc/issue623.ply", -1, SVO_INVALID_DATA, "rows lack the list that the header declares"},
    {"E_formats/off_misc/whitespace.off", 12, SVO_OK, "the list's counter could not read it"},
    {"E_formats/off_quads/inspired_mesh_quads_Smooth.off", 3676, SVO_OK, "an error of the list, corrected in its notes: 1838 quads"},
};

static void check_row(const char *relative, int64_t expected)
{
    svo_result want = SVO_OK;
    for (size_t i = 0; i < sizeof exceptions / sizeof *exceptions; i++)
        if (strcmp(exceptions[i].path, relative) == 0) expected = exceptions[i].count, want = exceptions[i].result;
    const char *path = test_model(relative);
    if (path == NULL) return; /* listed but not stored */
    struct stat s;
    if (stat(path, &s) != 0 || !S_ISREG(s.st_mode)) return;
    svo_mesh mesh;
    svo_error err = {0};
    fmt_import_options o = {.skip_images = true};
    svo_result r = fmt_import_mesh(path, &o, &mesh, &err);
    CHECK_MSG(r == want, "%s: %s, expected %s (%s)", relative, svo_result_name(r), svo_result_name(want), err.message);
    if (r != SVO_OK) return;
    uint64_t count = svo_mesh_count(&mesh).placed_triangles;
    const char *fault = import_mesh_fault(&mesh);
    svo_mesh_free(&mesh);
    CHECK_MSG(fault == NULL, "%s: %s", relative, fault);
    CHECK_MSG((int64_t)count == expected, "%s: %llu triangles, expected %lld", relative, (unsigned long long)count, (long long)expected);
}

TEST(counts_of_the_list)
{
    const char *list = test_models() != NULL ? test_model("MANIFEST.md") : NULL;
    if (list == NULL) {
        test_skip("no folder of real models");
        return;
    }
    FILE *f = fopen(list, "r");
    CHECK(f != NULL);
    static char line[1 << 16];
    uint32_t rows = 0;
    while (fgets(line, sizeof line, f) != NULL && !test_failed()) {
        char path[512] = "", source[1024], licence[1024], format[256], count[64];
        if (sscanf(line, "| %511[^|]| %1023[^|]| %1023[^|]| %255[^|]| %63[0-9]", path, source, licence, format, count) != 5) continue;
        for (size_t n = strlen(path); n > 0 && path[n - 1] == ' '; n--) path[n - 1] = '\0';
        if (strstr(path, "invalid") != NULL) continue;
        check_row(path, atoll(count));
        rows++;
    }
    fclose(f);
    if (!test_failed()) CHECK_MSG(rows > 200, "only %u rows were understood", rows);
}

/* --- malformed sets --- */

static uint32_t files_seen, files_refused;

static bool mesh_name(const char *name)
{
    static const char *const ends[] = {".gltf", ".glb", ".obj", ".ply", ".stl", ".off"};
    size_t n = strlen(name);
    for (size_t i = 0; i < sizeof ends / sizeof *ends; i++)
        if (n > strlen(ends[i]) && strcmp(name + n - strlen(ends[i]), ends[i]) == 0) return true;
    return false;
}

static void try_file(const char *path)
{
    static svo_warnings w;
    memset(&w, 0, sizeof w);
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, (uint64_t)1 << 30, NULL);
    fmt_import_options o = {.allocator = &limit.base, .warnings = &w};
    svo_mesh mesh;
    svo_error err = {0};
    svo_result r = fmt_import_mesh(path, &o, &mesh, &err);
    files_seen++;
    if (r == SVO_OK) {
        const char *fault = import_mesh_fault(&mesh);
        svo_mesh_free(&mesh);
        CHECK_MSG(fault == NULL, "%s: %s", path, fault);
    } else {
        files_refused++;
        CHECK_MSG(r == SVO_INVALID_DATA || r == SVO_UNSUPPORTED || r == SVO_IO, "%s: %s (%s)", path, svo_result_name(r), err.message);
        CHECK_MSG(err.code == r && err.message[0] != '\0', "%s: no message", path);
    }
    CHECK_U64(svo_limit_in_use(&limit), 0);
}

static void try_folder(const char *folder, int depth)
{
    DIR *d = opendir(folder);
    if (d == NULL) return;
    for (struct dirent *e; (e = readdir(d)) != NULL && !test_failed();) {
        if (e->d_name[0] == '.') continue;
        char path[4096];
        struct stat s;
        snprintf(path, sizeof path, "%s/%s", folder, e->d_name);
        if (stat(path, &s) != 0) continue;
        if (S_ISDIR(s.st_mode) && depth < 6) try_folder(path, depth + 1);
        else if (S_ISREG(s.st_mode) && mesh_name(e->d_name)) try_file(path);
    }
    closedir(d);
}

TEST(malformed_sets_never_crash)
{
    const char *const folders[] = {"D_gltf/invalid", "E_formats/invalid"};
    if (test_models() == NULL) {
        test_skip("no folder of real models");
        return;
    }
    for (size_t i = 0; i < 2; i++) {
        char folder[4096];
        const char *path = test_model(folders[i]);
        if (path == NULL) continue;
        snprintf(folder, sizeof folder, "%s", path);
        try_folder(folder, 0);
    }
    if (!test_failed()) CHECK_MSG(files_seen > 200 && files_refused > 100, "%u files, %u refused", files_seen, files_refused);
}

/* Those whose damage would give a wrong mesh, one of each kind. */
TEST(malformed_files_are_refused)
{
    static const struct { const char *path; svo_result result; } cases[] = {
        {"D_gltf/invalid/assimp_IndexOutOfRange/IndexOutOfRange.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/assimp_IndexOutOfRange/AllIndicesOutOfRange.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/assimp_IncorrectVertexArrays/Cube.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/assimp_MissingBin/BoxTextured.gltf", SVO_IO},
        {"D_gltf/invalid/assimp_RecursiveNodes/RecursiveNodes.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/assimp_wrongTypes/badArray.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/assimp_wrongTypes/badUint.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/gltf_v1_truck/CesiumMilkTruck.gltf", SVO_UNSUPPORTED},
        {"D_gltf/invalid/tinygltf/invalid-buffer-index.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/utf8_mangled/ferrari.glb", SVO_INVALID_DATA},
        {"D_gltf/invalid/utf8_mangled/gears.glb", SVO_INVALID_DATA},
        {"D_gltf/invalid/utf8_mangled/colored.stl", SVO_INVALID_DATA},
        {"D_gltf/invalid/utf8_mangled/dolphins_be.ply", SVO_INVALID_DATA},
        {"D_gltf/invalid/utf8_mangled/dolphins_le.ply", SVO_INVALID_DATA},
        {"D_gltf/invalid/validator/accessor/small_stride.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/validator/buffer_view/invalid_length.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/validator/glb/truncated_chunk_data.glb", SVO_INVALID_DATA},
        {"D_gltf/invalid/validator/node/node_loop.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/validator/mesh_data/index_buffer_oob.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/validator/mesh/accessor_unequal_count.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/validator/scene/unresolved_node.gltf", SVO_INVALID_DATA},
        {"D_gltf/invalid/validator_ok/mesh/valid.gltf", SVO_OK},
        {"D_gltf/invalid/validator_ok/glb/valid_buffer.glb", SVO_OK},
        {"D_gltf/invalid/validator_ok/node/valid.gltf", SVO_OK},
        {"D_gltf/invalid/validator_ok/accessor/valid.gltf", SVO_OK},
        {"D_gltf/invalid/validator_ok/skin/valid.gltf", SVO_OK},
        {"E_formats/invalid/assimp/OutOfMemory.off", SVO_INVALID_DATA},
        {"E_formats/invalid/corrupted_invalid_double.off", SVO_INVALID_DATA},
        {"E_formats/invalid/corrupted_invalid_facet_vertex.obj", SVO_INVALID_DATA},
        {"E_formats/invalid/corrupted_invalid_triangle_count.stl", SVO_INVALID_DATA},
        {"E_formats/invalid/truncated.ply", SVO_INVALID_DATA},
    };
    if (test_models() == NULL) {
        test_skip("no folder of real models");
        return;
    }
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const char *path = test_model(cases[i].path);
        if (path == NULL) continue;
        svo_mesh mesh;
        svo_error err = {0};
        svo_result r = fmt_import_mesh(path, NULL, &mesh, &err);
        if (r == SVO_OK) svo_mesh_free(&mesh);
        CHECK_MSG(r == cases[i].result, "%s: %s, expected %s (%s)", cases[i].path, svo_result_name(r), svo_result_name(cases[i].result),
                  err.message);
    }
}
