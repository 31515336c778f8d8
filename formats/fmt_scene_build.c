#include "fmt_scene_build.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_import.h"
#include "fmt_scene_json.h"
#include "fmt_svdag.h"
#include "fmt_svo.h"
#include "fmt_utf8.h"

#define DEFAULT_DEPTH 10u
#define COARSE_DEPTH 3u /* assets below this get a warning */
#define PI 3.14159265358979323846

/* One asset of the source and what keeps its octree alive. */
typedef struct entry {
    fmt_scene_build_asset info;
    char *name, *path;
    bool used, is_mesh;
    double scale; /* longest image of a mesh axis under any instance */
    double extent; /* longest edge of the mesh's bounds */
    fmt_bytes bytes;
    fmt_svdag svdag;
    bool svdag_open;
    svo_packed *packed;
    const svo_view *view;
} entry;

struct fmt_scene_build {
    fmt_scene_build_options options;
    const svo_allocator *allocator;
    char hash[33];
    uint32_t count;
    entry *entries;
    fmt_scene_build_asset *infos;
    const svo_view **views;
    const char **names;
    fmt_scene_json json;
    svo_mesh mesh; /* of a mesh scene, until its assets are built */
    svo_buffer places, place_names;
    svo_pack_input input;
    svo_packed_scene *packed;
};

fmt_scene_build_options fmt_default_scene_build_options(void)
{
    fmt_scene_build_options o = {.depth = DEFAULT_DEPTH, .voxelize = svo_default_voxelize_options(), .dag = svo_default_dag_options()};
    return o;
}

const svo_scene *fmt_scene_build_scene(const fmt_scene_build *b) { return svo_packed_scene_get(b->packed); }
const svo_pack_report *fmt_scene_build_report(const fmt_scene_build *b) { return svo_packed_scene_report(b->packed); }
const char *fmt_scene_build_hash(const fmt_scene_build *b) { return b->hash; }
const fmt_scene_build_asset *fmt_scene_build_assets(const fmt_scene_build *b, uint32_t *count)
{
    *count = b->count;
    return b->infos;
}

void fmt_scene_build_close(fmt_scene_build *b)
{
    if (b == NULL) return;
    svo_packed_scene_free(b->packed);
    for (uint32_t i = 0; b->entries != NULL && i < b->count; i++) {
        entry *e = &b->entries[i];
        if (e->svdag_open) fmt_svdag_close(&e->svdag);
        if (e->bytes.data != NULL) fmt_bytes_close(&e->bytes);
        svo_packed_free(e->packed);
        svo_string_free(b->allocator, e->name);
        svo_string_free(b->allocator, e->path);
    }
    svo_free(b->allocator, b->entries, b->count, sizeof *b->entries);
    svo_free(b->allocator, b->infos, b->count, sizeof *b->infos);
    svo_free(b->allocator, b->views, b->count, sizeof *b->views);
    svo_free(b->allocator, b->names, b->count, sizeof *b->names);
    fmt_scene_json_free(&b->json);
    svo_mesh_free(&b->mesh);
    svo_buffer_free(&b->places);
    svo_buffer_free(&b->place_names);
    svo_free(b->allocator, b, 1, sizeof *b);
}

static void phase(const fmt_scene_build *b, const char *name)
{
    if (b->options.phase != NULL) b->options.phase(b->options.user, name);
}

static const char *last_part(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash != NULL ? slash + 1 : path;
}

/* Put the file's name before a message that does not have it. */
static svo_result about(const char *file, svo_result result, svo_error *err)
{
    if (err != NULL && result != SVO_OK && strstr(err->message, last_part(file)) == NULL) {
        svo_error inner = *err;
        svo_fail(err, result, "%.100s: %s", file, inner.message);
        err->chunk = inner.chunk, err->offset = inner.offset, err->index = inner.index;
    }
    return result;
}

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the tables of a scene"); }

static svo_result make_entries(fmt_scene_build *b, uint32_t count, svo_error *err)
{
    if (count == 0) return SVO_OK;
    b->entries = svo_calloc(b->allocator, count, sizeof *b->entries);
    b->infos = svo_calloc(b->allocator, count, sizeof *b->infos);
    b->views = svo_calloc(b->allocator, count, sizeof *b->views);
    b->names = svo_calloc(b->allocator, count, sizeof *b->names);
    b->count = count;
    return b->entries != NULL && b->infos != NULL && b->views != NULL && b->names != NULL ? SVO_OK : no_memory(err);
}

/* What a file is, by its first bytes. */
typedef enum content { CONTENT_OTHER, CONTENT_JSON, CONTENT_SVO, CONTENT_SVDAG, CONTENT_OURS } content;

static content content_of(const fmt_bytes *f)
{
    uint32_t kind = f->size >= 64 ? fmt_container_kind(f->data, f->size) : 0; /* a file shorter than a header is damaged, not of a kind */
    if (kind != 0) return kind == FMT_KIND_SVO ? CONTENT_SVO : kind == FMT_KIND_SVDAG ? CONTENT_SVDAG : CONTENT_OURS;
    uint64_t i = f->size >= 3 && memcmp(f->data, "\xef\xbb\xbf", 3) == 0 ? 3 : 0;
    while (i < f->size && isspace(f->data[i])) i++;
    return i < f->size && f->data[i] == '{' ? CONTENT_JSON : CONTENT_OTHER;
}

static bool has_extension(const char *path, const char *extension)
{
    size_t n = strlen(path), m = strlen(extension);
    if (n < m) return false;
    for (size_t i = 0; i < m; i++)
        if (tolower((unsigned char)path[n - m + i]) != extension[i]) return false;
    return true;
}

static void hex(const uint8_t bytes[16], char out[33])
{
    for (int i = 0; i < 16; i++) out[2 * i] = "0123456789abcdef"[bytes[i] >> 4], out[2 * i + 1] = "0123456789abcdef"[bytes[i] & 15];
    out[32] = 0;
}

/* ---- octree files ---- */

static svo_result open_svdag(fmt_scene_build *b, entry *e, svo_error *err)
{
    SVO_TRY(fmt_svdag_open(e->bytes.data, e->bytes.size, b->allocator, &e->svdag, err));
    e->svdag_open = true;
    e->view = &e->svdag.view;
    e->info.source = "svdag";
    hex(e->svdag.container.content_hash, e->info.hash);
    return SVO_OK;
}

static svo_result open_svo(fmt_scene_build *b, entry *e, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *reader;
    SVO_TRY(fmt_input_open_memory(e->bytes.data, e->bytes.size, &in, err));
    svo_result result = fmt_svo_reader_open(in, b->allocator, &reader, err);
    if (result == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(reader);
        result = svo_dag_build(fmt_svo_reader_info(reader), &source, &b->options.dag, &e->packed, NULL, err);
        uint8_t hash[16];
        if (result == SVO_OK) {
            fmt_svo_reader_content_hash(reader, hash);
            hex(hash, e->info.hash);
            e->view = svo_packed_view(e->packed);
            e->info.source = "svo";
        }
        fmt_svo_reader_close(reader);
    }
    fmt_input_close(in);
    return result;
}

/* ---- meshes ---- */

static fmt_import_options import_options(const fmt_scene_build *b, bool skip_images)
{
    fmt_import_options o = {.allocator = b->allocator, .skip_images = skip_images, .threads = b->options.voxelize.threads,
                            .warnings = skip_images ? NULL : b->options.voxelize.warnings};
    return o;
}

/* Longest edge of the bounds of what a mesh places; 0 when there is nothing. */
static double mesh_extent(const svo_mesh *mesh)
{
    double low[3], high[3], extent = 0;
    if (!svo_mesh_bounds(mesh, low, high)) return 0;
    for (int k = 0; k < 3; k++) extent = fmax(extent, high[k] - low[k]);
    return extent;
}

static svo_result build_mesh(fmt_scene_build *b, entry *e, const svo_mesh *mesh, uint32_t depth, svo_error *err)
{
    svo_voxelize_options o = b->options.voxelize;
    o.depth = depth;
    o.voxel_size = 0;
    svo_tree_info info;
    SVO_TRY(svo_voxelize_plan(mesh, &o, &info, err));
    svo_dag_builder *builder;
    SVO_TRY(svo_dag_builder_create(&info, &b->options.dag, &builder, err));
    svo_chunk_sink sink = svo_dag_builder_sink(builder);
    svo_voxelize_report report;
    svo_result result = svo_voxelize(mesh, &o, &info, &sink, &report, err);
    if (result != SVO_OK) {
        svo_dag_builder_free(builder);
        return result;
    }
    SVO_TRY(svo_dag_builder_finish(builder, &e->packed, NULL, err));
    e->view = svo_packed_view(e->packed);
    return SVO_OK;
}

/* Levels that an asset needs for voxels of at most `voxel` in the scene. */
static svo_result needed_depth(const fmt_scene_build *b, const entry *e, double voxel, uint32_t *depth, svo_error *err)
{
    double size = e->extent * e->scale * (1 - 1e-12); /* (an exact power of two must not tip over) */
    bool given = b->options.voxel_size > 0;
    uint32_t limit = given ? SVO_MAX_DEPTH : b->options.depth, d = 0;
    while (d < limit && ldexp(voxel, (int)d) < size) d++;
    if (given && ldexp(voxel, (int)d) < size)
        return svo_fail(err, SVO_LIMIT, "%.60s: a voxel size of %g needs more than %u levels", e->info.file, voxel, SVO_MAX_DEPTH);
    *depth = d;
    return SVO_OK;
}

static void warn_coarse(const fmt_scene_build *b)
{
    uint32_t coarse = 0;
    for (uint32_t i = 0; i < b->count; i++) {
        const entry *e = &b->entries[i];
        coarse += e->is_mesh && e->view != NULL && !e->view->empty && e->view->depth < COARSE_DEPTH;
    }
    if (coarse != 0)
        svo_warn(b->options.voxelize.warnings, "%u of the meshes are less than %u voxels large at the scene's voxel size; a greater depth shows more of them",
                 coarse, 1u << COARSE_DEPTH);
}

static double scene_voxel(const fmt_scene_build *b)
{
    if (b->options.voxel_size > 0) return b->options.voxel_size;
    double largest = 0;
    for (uint32_t i = 0; i < b->count; i++)
        if (b->entries[i].used && b->entries[i].is_mesh) largest = fmax(largest, b->entries[i].extent * b->entries[i].scale);
    return ldexp(largest, -(int)b->options.depth);
}

/* used and scale of every entry, from the places. */
static void look_at_places(fmt_scene_build *b, const svo_place *places, uint64_t count)
{
    for (uint64_t i = 0; i < count; i++) {
        entry *e = &b->entries[places[i].asset];
        const double *t = places[i].transform;
        e->used = true;
        for (int k = 0; k < 3; k++) e->scale = fmax(e->scale, svo_length(svo_v3(t[k], t[4 + k], t[8 + k])));
    }
}

/* ---- a description in JSON ---- */

static svo_result open_file(fmt_scene_build *b, entry *e, svo_error *err)
{
    SVO_TRY(fmt_bytes_open(e->path, 0, b->allocator, &e->bytes, err));
    e->info.source_bytes = e->bytes.size;
    switch (content_of(&e->bytes)) {
    case CONTENT_SVDAG: return open_svdag(b, e, err);
    case CONTENT_SVO: return open_svo(b, e, err);
    case CONTENT_OURS: return svo_fail(err, SVO_UNSUPPORTED, "an asset can be an .svdag, an .svo or a mesh, not another kind of svokit file");
    case CONTENT_JSON:
    case CONTENT_OTHER: break;
    }
    e->is_mesh = true;
    e->info.source = "mesh";
    fmt_hash_hex(e->bytes.data, e->bytes.size, e->info.hash);
    fmt_bytes_close(&e->bytes); /* (the importer opens it again, with the files beside it) */
    memset(&e->bytes, 0, sizeof e->bytes);
    return SVO_OK;
}

static svo_result measure_mesh(fmt_scene_build *b, entry *e, svo_error *err)
{
    svo_mesh mesh;
    fmt_import_options import = import_options(b, true);
    SVO_TRY(fmt_import_mesh(e->path, &import, &mesh, err));
    e->extent = mesh_extent(&mesh);
    svo_mesh_free(&mesh);
    return SVO_OK;
}

static svo_result build_mesh_file(fmt_scene_build *b, entry *e, double voxel, bool measured, svo_error *err)
{
    svo_mesh mesh;
    fmt_import_options import = import_options(b, false);
    SVO_TRY(fmt_import_mesh(e->path, &import, &mesh, err));
    uint32_t depth = b->options.depth;
    svo_result result = SVO_OK;
    if (!measured) e->extent = mesh_extent(&mesh);
    if (measured || b->options.voxel_size > 0) result = needed_depth(b, e, voxel, &depth, err);
    if (result == SVO_OK) result = build_mesh(b, e, &mesh, depth, err);
    svo_mesh_free(&mesh);
    return result;
}

/* folder of `scene` + file */
static char *beside(const fmt_scene_build *b, const char *scene, const char *file)
{
    size_t folder = strcmp(scene, "-") == 0 ? 0 : (size_t)(last_part(scene) - scene);
    char *joined = NULL, *text = malloc(folder + strlen(file) + 1);
    if (text == NULL) return NULL;
    memcpy(text, scene, folder);
    strcpy(text + folder, file);
    joined = svo_string_copy(b->allocator, text);
    free(text);
    return joined;
}

static svo_result load_description(fmt_scene_build *b, const char *path, const fmt_bytes *file, svo_error *err)
{
    fmt_scene_json *j = &b->json;
    SVO_TRY(fmt_scene_json_parse(file->data, file->size, b->allocator, b->options.voxelize.warnings, j, err));
    SVO_TRY(make_entries(b, j->asset_count, err));
    look_at_places(b, j->places, j->place_count);
    uint32_t meshes = 0;
    for (uint32_t i = 0; i < b->count; i++) {
        entry *e = &b->entries[i];
        e->info.name = j->assets[i].name;
        e->info.file = j->assets[i].file;
        e->info.source = "";
        if (!e->used) continue;
        e->path = beside(b, path, j->assets[i].file);
        if (e->path == NULL) return no_memory(err);
        SVO_TRY(about(e->info.file, open_file(b, e, err), err));
        meshes += e->is_mesh;
    }
    /* One mesh has the stated depth; of several the largest has, and all must be measured before the first is built. */
    bool measure = meshes > 1 && b->options.voxel_size == 0;
    for (uint32_t i = 0; i < b->count && measure; i++)
        if (b->entries[i].is_mesh) SVO_TRY(about(b->entries[i].info.file, measure_mesh(b, &b->entries[i], err), err));
    double voxel = scene_voxel(b);
    if (meshes != 0) phase(b, "voxelize");
    for (uint32_t i = 0; i < b->count; i++)
        if (b->entries[i].is_mesh) SVO_TRY(about(b->entries[i].info.file, build_mesh_file(b, &b->entries[i], voxel, measure, err), err));
    if (measure) warn_coarse(b);
    b->input.place_count = j->place_count;
    b->input.places = j->places;
    b->input.poses = j->poses;
    b->input.names = j->names;
    b->input.names_size = j->names_size;
    b->input.has_camera = j->has_camera;
    b->input.camera_transform = j->camera_transform;
    b->input.camera_yfov = j->camera_yfov;
    return SVO_OK;
}

/* ---- a mesh file as a scene: its shapes are assets, its instances are instances ---- */

static char *clean_name(const fmt_scene_build *b, const char *name)
{
    char *copy = svo_string_copy(b->allocator, name);
    if (copy != NULL) fmt_utf8_repair(copy);
    return copy;
}

static svo_result add_mesh_instance(fmt_scene_build *b, uint64_t index, svo_error *err)
{
    const svo_instance *instance = &b->mesh.instances[index];
    svo_place place = {.id = index, .asset = instance->shape};
    memcpy(place.transform, instance->transform.m, sizeof place.transform);
    size_t size = strlen(instance->name) + 1;
    if (size > 1) {
        if (b->place_names.size + size > UINT32_MAX) return svo_fail(err, SVO_LIMIT, "the names of instances take more than 4 GiB");
        place.name = (uint32_t)b->place_names.size;
        char *name = svo_buffer_append(&b->place_names, instance->name, size);
        if (name == NULL) return no_memory(err);
        fmt_utf8_repair(name);
    }
    return svo_buffer_append(&b->places, &place, sizeof place) != NULL ? SVO_OK : no_memory(err);
}

static void take_camera(fmt_scene_build *b)
{
    const svo_camera *camera = &b->mesh.cameras[0];
    svo_mat4 m = camera->transform, inverse;
    /* A camera has no size: what scale its node has is taken away. */
    for (int k = 0; k < 3; k++) {
        svo_vec3 axis = svo_normalize(svo_v3(m.m[k], m.m[4 + k], m.m[8 + k]));
        m.m[k] = axis.x, m.m[4 + k] = axis.y, m.m[8 + k] = axis.z;
    }
    if (!(camera->yfov > 0) || !(camera->yfov < PI) || !svo_mat4_affine_inverse(&m, &inverse)) {
        svo_warn(b->options.voxelize.warnings, "the camera is left out: its transform is singular or its field of view is not between 0 and pi");
        return;
    }
    b->input.has_camera = true;
    b->input.camera_transform = m;
    b->input.camera_yfov = camera->yfov;
}

/* A mesh that holds one shape of another, in its own coordinates. Borrows everything. */
static svo_mesh one_shape(svo_mesh *mesh, uint32_t shape, svo_instance *instance)
{
    svo_mesh one = *mesh;
    *instance = (svo_instance){.name = mesh->shapes[shape].name, .shape = 0, .transform = svo_mat4_identity()};
    one.shape_count = one.instance_count = 1;
    one.shapes = mesh->shapes + shape;
    one.instances = instance;
    return one;
}

static bool same_bytes(const void *a, const void *b, uint64_t size)
{
    return (a == NULL) == (b == NULL) && (a == NULL || size == 0 || memcmp(a, b, (size_t)size) == 0);
}

/* The same in everything that voxels are made of. */
static bool same_shape(const svo_shape *a, const svo_shape *b)
{
    if (a->part_count != b->part_count) return false;
    for (uint32_t p = 0; p < a->part_count; p++) {
        const svo_part *x = &a->parts[p], *y = &b->parts[p];
        uint64_t n = x->vertex_count;
        if (n != y->vertex_count || x->triangle_count != y->triangle_count || x->material != y->material) return false;
        if (!same_bytes(x->positions, y->positions, n * 24) || !same_bytes(x->indices, y->indices, x->triangle_count * 12) ||
            !same_bytes(x->normals, y->normals, n * 12) || !same_bytes(x->colors, y->colors, n * 16))
            return false;
        for (uint32_t k = 0; k < SVO_MAX_UV_SETS; k++)
            if (!same_bytes(x->uvs[k], y->uvs[k], n * 8)) return false;
    }
    return true;
}

/* The octree of an earlier shape that is the same at the same depth, or NULL. Exporters write copies of a mesh often;
 * packing merges their octrees anyhow, but building each takes time. */
static const svo_view *built_before(const fmt_scene_build *b, uint32_t i)
{
    for (uint32_t k = 0; k < i; k++)
        if (b->entries[k].packed != NULL && b->entries[k].info.depth == b->entries[i].info.depth && same_shape(&b->mesh.shapes[k], &b->mesh.shapes[i]))
            return b->entries[k].view;
    return NULL;
}

static svo_result load_mesh_scene(fmt_scene_build *b, const char *path, const fmt_bytes *file, svo_error *err)
{
    fmt_import_options import = import_options(b, false);
    SVO_TRY(fmt_import_mesh(path, &import, &b->mesh, err));
    SVO_TRY(make_entries(b, b->mesh.shape_count, err));
    if (svo_buffer_append(&b->place_names, "", 1) == NULL) return no_memory(err);
    for (uint64_t i = 0; i < b->mesh.instance_count; i++) SVO_TRY(add_mesh_instance(b, i, err));
    b->input.places = (const svo_place *)(const void *)b->places.data;
    b->input.place_count = b->mesh.instance_count;
    b->input.names = (const char *)b->place_names.data;
    b->input.names_size = b->place_names.size;
    if (b->mesh.camera_count != 0) take_camera(b);
    look_at_places(b, b->input.places, b->input.place_count);
    for (uint32_t i = 0; i < b->count; i++) {
        entry *e = &b->entries[i];
        e->name = clean_name(b, b->mesh.shapes[i].name);
        if (e->name == NULL) return no_memory(err);
        e->info.name = e->name;
        e->info.file = last_part(path);
        e->info.source = "mesh";
        memcpy(e->info.hash, b->hash, sizeof e->info.hash);
        e->info.source_bytes = b->count == 1 ? file->size : 0;
        e->is_mesh = true;
        svo_instance instance;
        svo_mesh one = one_shape(&b->mesh, i, &instance);
        e->extent = mesh_extent(&one);
    }
    double voxel = scene_voxel(b);
    phase(b, "voxelize");
    for (uint32_t i = 0; i < b->count; i++) {
        entry *e = &b->entries[i];
        if (!e->used) continue;
        svo_instance instance;
        svo_mesh one = one_shape(&b->mesh, i, &instance);
        SVO_TRY(needed_depth(b, e, voxel, &e->info.depth, err));
        e->view = built_before(b, i);
        if (e->view == NULL) SVO_TRY(build_mesh(b, e, &one, e->info.depth, err));
    }
    warn_coarse(b);
    svo_mesh_free(&b->mesh);
    return SVO_OK;
}

/* ---- one octree file ---- */

static svo_result load_octree(fmt_scene_build *b, const char *path, svo_error *err)
{
    SVO_TRY(make_entries(b, 1, err));
    entry *e = &b->entries[0];
    e->used = true;
    e->name = clean_name(b, strcmp(path, "-") == 0 ? "" : last_part(path));
    e->path = svo_string_copy(b->allocator, path);
    if (e->name == NULL || e->path == NULL) return no_memory(err);
    e->info.name = e->name;
    e->info.file = last_part(path);
    SVO_TRY(open_file(b, e, err));
    svo_place place = {.transform = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
    if (svo_buffer_append(&b->places, &place, sizeof place) == NULL) return no_memory(err);
    b->input.places = (const svo_place *)(const void *)b->places.data;
    b->input.place_count = 1;
    return SVO_OK;
}

static svo_result load(fmt_scene_build *b, const char *path, svo_error *err)
{
    fmt_bytes file;
    phase(b, "read");
    SVO_TRY(fmt_bytes_open(path, 0, b->allocator, &file, err));
    fmt_hash_hex(file.data, file.size, b->hash);
    content c = content_of(&file);
    svo_result result;
    if (file.size == 0) result = svo_fail(err, SVO_INVALID_DATA, "the file is empty");
    else if (c == CONTENT_OTHER && has_extension(path, ".json"))
        result = svo_fail(err, SVO_INVALID_DATA, "not a description of a scene: that is a JSON object, { \"assets\": [...], \"instances\": [...] }");
    else if (c == CONTENT_OURS) result = svo_fail(err, SVO_UNSUPPORTED, "this svokit file is no scene to pack: a description in JSON, a mesh, an .svo or an .svdag is");
    else if (c == CONTENT_JSON && !has_extension(path, ".gltf")) result = load_description(b, path, &file, err);
    else if (strcmp(path, "-") == 0) result = svo_fail(err, SVO_UNSUPPORTED, "only a description in JSON can come from stdin");
    else if (c == CONTENT_SVO || c == CONTENT_SVDAG) result = load_octree(b, path, err);
    else result = load_mesh_scene(b, path, &file, err);
    fmt_bytes_close(&file);
    return about(strcmp(path, "-") == 0 ? "stdin" : path, result, err);
}

static svo_result pack(fmt_scene_build *b, svo_error *err)
{
    phase(b, "pack");
    for (uint32_t i = 0; i < b->count; i++) {
        entry *e = &b->entries[i];
        b->views[i] = e->view;
        b->names[i] = e->info.name;
        if (e->view == NULL) continue;
        e->info.depth = e->view->depth;
        e->info.voxels = e->view->nodes[e->view->depth];
    }
    b->input.asset_count = b->count;
    b->input.assets = b->views;
    b->input.asset_names = b->names;
    svo_pack_options o = {.page_instances = b->options.page_instances, .threads = b->options.voxelize.threads, .allocator = b->allocator,
                          .warnings = b->options.voxelize.warnings};
    SVO_TRY(svo_pack(&b->input, &o, &b->packed, err));
    for (uint32_t i = 0; i < b->count; i++) {
        b->entries[i].info.packed = svo_packed_scene_report(b->packed)->assets[i];
        b->infos[i] = b->entries[i].info;
    }
    return SVO_OK;
}

svo_result fmt_scene_build_open(const char *path, const fmt_scene_build_options *options, fmt_scene_build **out, svo_error *err)
{
    fmt_scene_build_options o = options != NULL ? *options : fmt_default_scene_build_options();
    const svo_allocator *a = o.voxelize.allocator;
    fmt_scene_build *b = svo_calloc(a, 1, sizeof *b);
    if (b == NULL) return no_memory(err);
    b->options = o;
    b->allocator = a;
    svo_buffer_init(&b->places, a);
    svo_buffer_init(&b->place_names, a);
    svo_result result = load(b, path, err);
    if (result == SVO_OK) result = about(path, pack(b, err), err);
    if (result != SVO_OK) {
        fmt_scene_build_close(b);
        return result;
    }
    *out = b;
    return SVO_OK;
}
