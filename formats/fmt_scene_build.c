#include "fmti_scene_build.h"

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

void fmti_entry_rig_free(const fmt_scene_build *b, fmti_entry *e)
{
    fmti_rigged_free(e->rigged);
    svo_free(b->allocator, e->rigged, 1, sizeof *e->rigged);
    svo_free(b->allocator, e->pose_of, e->pose_slots, sizeof *e->pose_of);
    e->rigged = NULL, e->pose_of = NULL;
    svo_mesh_free(&e->mesh);
    fmt_rig_free(&e->rig);
}

void fmt_scene_build_close(fmt_scene_build *b)
{
    if (b == NULL) return;
    svo_packed_scene_free(b->packed);
    for (uint32_t i = 0; b->entries != NULL && i < b->count; i++) {
        fmti_entry *e = &b->entries[i];
        if (e->svdag_open) fmt_svdag_close(&e->svdag);
        if (e->bytes.data != NULL) fmt_bytes_close(&e->bytes);
        svo_packed_free(e->packed);
        svo_string_free(b->allocator, e->name);
        svo_string_free(b->allocator, e->path);
        fmti_entry_rig_free(b, e);
    }
    svo_free(b->allocator, b->entries, b->count, sizeof *b->entries);
    svo_free(b->allocator, b->infos, b->count, sizeof *b->infos);
    svo_free(b->allocator, b->views, b->count, sizeof *b->views);
    svo_free(b->allocator, b->names, b->count, sizeof *b->names);
    fmt_scene_json_free(&b->json);
    svo_mesh_free(&b->mesh);
    svo_buffer_free(&b->places);
    svo_buffer_free(&b->place_names);
    svo_buffer_free(&b->poses);
    svo_buffer_free(&b->matrices);
    svo_buffer_free(&b->frames);
    fmt_rig_free(&b->rig);
    svo_free(b->allocator, b, 1, sizeof *b);
}

void fmti_scene_phase(const fmt_scene_build *b, const char *name)
{
    if (b->options.phase != NULL) b->options.phase(b->options.user, name);
}

void fmti_scene_progress(const fmt_scene_build *b, uint64_t done)
{
    if (b->options.progress != NULL) b->options.progress(b->options.user, done, b->count);
}

const char *fmti_last_part(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash != NULL ? slash + 1 : path;
}

/* Put the file's name before a message that does not have it. */
static svo_result about(const char *file, svo_result result, svo_error *err)
{
    if (err != NULL && result != SVO_OK && strstr(err->message, fmti_last_part(file)) == NULL) {
        svo_error inner = *err;
        svo_fail(err, result, "%.100s: %s", file, inner.message);
        err->chunk = inner.chunk, err->offset = inner.offset, err->index = inner.index;
    }
    return result;
}

svo_result fmti_scene_no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the tables of a scene"); }

svo_result fmti_scene_entries(fmt_scene_build *b, uint32_t count, svo_error *err)
{
    if (count == 0) return SVO_OK;
    b->entries = svo_calloc(b->allocator, count, sizeof *b->entries);
    b->infos = svo_calloc(b->allocator, count, sizeof *b->infos);
    b->views = svo_calloc(b->allocator, count, sizeof *b->views);
    b->names = svo_calloc(b->allocator, count, sizeof *b->names);
    b->count = count;
    return b->entries != NULL && b->infos != NULL && b->views != NULL && b->names != NULL ? SVO_OK : fmti_scene_no_memory(err);
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

static svo_result open_svdag(fmt_scene_build *b, fmti_entry *e, svo_error *err)
{
    SVO_TRY(fmt_svdag_open(e->bytes.data, e->bytes.size, b->allocator, &e->svdag, err));
    e->svdag_open = true;
    e->view = &e->svdag.view;
    e->info.source = "svdag";
    hex(e->svdag.container.content_hash, e->info.hash);
    return SVO_OK;
}

static svo_result open_svo(fmt_scene_build *b, fmti_entry *e, svo_error *err)
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

/* used and scale of every entry, from the places. */
void fmti_look_at_places(fmt_scene_build *b, const svo_place *places, uint64_t count)
{
    for (uint64_t i = 0; i < count; i++) {
        fmti_entry *e = &b->entries[places[i].asset];
        const double *t = places[i].transform;
        e->used = true;
        for (int k = 0; k < 3; k++) e->scale = fmax(e->scale, svo_length(svo_v3(t[k], t[4 + k], t[8 + k])));
    }
}

/* ---- a description in JSON ---- */

static svo_result open_bytes(const fmt_scene_build *b, const char *path, fmt_bytes *out, svo_error *err)
{
    SVO_TRY(fmt_bytes_open(path, 0, b->allocator, out, err));
    if (b->options.file_read != NULL && strcmp(path, "-") != 0) out->beside = b->options.file_read(b->options.file_read_user, path, out->data, out->size, out->mapped);
    return SVO_OK;
}

static svo_result open_file(fmt_scene_build *b, fmti_entry *e, svo_error *err)
{
    SVO_TRY(open_bytes(b, e->path, &e->bytes, err));
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

static svo_result measure_mesh(fmt_scene_build *b, fmti_entry *e, svo_error *err)
{
    svo_mesh mesh;
    fmt_import_options import = fmti_import_options(b, true);
    SVO_TRY(fmt_import_mesh(e->path, &import, &mesh, err));
    e->extent = fmti_mesh_extent(&mesh);
    svo_mesh_free(&mesh);
    return SVO_OK;
}

/* A mesh that poses move by its bones. One without skins and animations is as any other, its poses' bones move nothing. */
static svo_result load_rig(fmt_scene_build *b, fmti_entry *e, svo_error *err)
{
    fmt_import_options import = fmti_import_options(b, false);
    import.rig = &e->rig;
    SVO_TRY(fmt_import_mesh(e->path, &import, &e->mesh, err));
    e->extent = fmti_mesh_extent(&e->mesh);
    if (e->rig.skin_count == 0 && e->rig.animation_count == 0) {
        fmti_entry_rig_free(b, e);
        return e->has_clip ? svo_fail(err, SVO_INVALID_DATA, "a pose names an animation, but the file has none") : SVO_OK;
    }
    e->rigged = svo_calloc(b->allocator, 1, sizeof *e->rigged);
    if (e->rigged == NULL) return fmti_scene_no_memory(err);
    return fmti_rigged_make(e->rigged, &e->rig, &e->mesh, true, SVO_NONE, e->extent, b->allocator, err);
}

static svo_result build_mesh_file(fmt_scene_build *b, fmti_entry *e, double voxel, bool measured, svo_error *err)
{
    fmt_import_options import = fmti_import_options(b, false);
    if (e->rigged == NULL) SVO_TRY(fmt_import_mesh(e->path, &import, &e->mesh, err));
    uint32_t depth = b->options.depth;
    svo_result result = SVO_OK;
    if (!measured) e->extent = fmti_mesh_extent(&e->mesh);
    if (measured || b->options.voxel_size > 0) result = fmti_needed_depth(b, e, voxel, &depth, err);
    if (result == SVO_OK) result = fmti_build_mesh(b, e, &e->mesh, SVO_NONE, depth, err);
    fmti_entry_rig_free(b, e);
    return result;
}

/* Assets whose instances' poses have bones or name animations. */
static svo_result look_at_poses(fmt_scene_build *b, svo_error *err)
{
    const fmt_scene_json *j = &b->json;
    if (j->poses.count == 0) return SVO_OK;
    uint8_t *clip = svo_calloc(b->allocator, j->poses.count, 1);
    if (clip == NULL) return fmti_scene_no_memory(err);
    for (uint64_t i = 0; i < j->clip_count; i++) clip[j->clips[i].pose] = 1;
    for (uint64_t i = 0; i < j->place_count; i++) {
        uint32_t pose = j->places[i].pose;
        fmti_entry *e = &b->entries[j->places[i].asset];
        if (pose == 0) continue;
        e->has_clip = e->has_clip || clip[pose - 1] != 0;
        e->posed = e->posed || clip[pose - 1] != 0 || (j->poses.pose[pose - 1].flags & SVO_POSE_BONES) != 0;
    }
    svo_free(b->allocator, clip, j->poses.count, 1);
    return SVO_OK;
}

/* folder of `scene` + file */
static char *beside(const fmt_scene_build *b, const char *scene, const char *file)
{
    size_t folder = strcmp(scene, "-") == 0 ? 0 : (size_t)(fmti_last_part(scene) - scene);
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
    if (b->options.animation != NULL) return svo_fail(err, SVO_UNSUPPORTED, "a description states animations in its poses, --animation and --time are for glTF scenes");
    SVO_TRY(fmt_scene_json_parse(file->data, file->size, b->allocator, b->options.voxelize.warnings, j, err));
    SVO_TRY(fmti_scene_entries(b, j->asset_count, err));
    fmti_look_at_places(b, j->places, j->place_count);
    SVO_TRY(look_at_poses(b, err));
    uint32_t meshes = 0;
    for (uint32_t i = 0; i < b->count; i++) {
        fmti_entry *e = &b->entries[i];
        e->info.name = j->assets[i].name;
        e->info.file = j->assets[i].file;
        e->info.source = "";
        e->path = beside(b, path, j->assets[i].file);
        if (e->path == NULL) return fmti_scene_no_memory(err);
        if (!e->used) e->info.source_bytes = fmt_file_bytes(e->path);
        if (!e->used) continue;
        SVO_TRY(about(e->info.file, open_file(b, e, err), err));
        meshes += e->is_mesh;
        fmti_scene_progress(b, i + 1);
    }
    /* One mesh has the stated depth; of several the largest has, and all must be measured before the first is built. */
    bool measure = meshes > 1 && b->options.voxel_size == 0;
    b->input.poses = j->poses;
    for (uint32_t i = 0; i < b->count; i++) {
        fmti_entry *e = &b->entries[i];
        if (!e->is_mesh && e->has_clip) return svo_fail(err, SVO_INVALID_DATA, "%.60s: a pose names an animation, but only a glTF file has some", e->info.file);
        if (e->is_mesh && e->posed && !b->options.bake_skins) SVO_TRY(about(e->info.file, load_rig(b, e, err), err));
        else if (e->is_mesh && measure) SVO_TRY(about(e->info.file, measure_mesh(b, e, err), err));
    }
    SVO_TRY(fmti_scene_resolve_poses(b, err));
    SVO_TRY(fmti_scene_finish_poses(b, err));
    double voxel = fmti_scene_voxel(b);
    if (meshes != 0) fmti_scene_phase(b, "voxelize");
    for (uint32_t i = 0; i < b->count; i++) {
        if (b->entries[i].is_mesh) SVO_TRY(about(b->entries[i].info.file, build_mesh_file(b, &b->entries[i], voxel, measure, err), err));
        if (meshes != 0) fmti_scene_progress(b, i + 1);
    }
    if (measure) fmti_warn_coarse(b);
    b->input.place_count = j->place_count;
    b->input.places = j->places;
    b->input.names = j->names;
    b->input.names_size = j->names_size;
    b->input.has_camera = j->has_camera;
    b->input.camera_transform = j->camera_transform;
    b->input.camera_yfov = j->camera_yfov;
    return SVO_OK;
}

char *fmti_clean_name(const fmt_scene_build *b, const char *name)
{
    char *copy = svo_string_copy(b->allocator, name);
    if (copy != NULL) fmt_utf8_repair(copy);
    return copy;
}

/* ---- one octree file ---- */

static svo_result load_octree(fmt_scene_build *b, const char *path, svo_error *err)
{
    SVO_TRY(fmti_scene_entries(b, 1, err));
    fmti_entry *e = &b->entries[0];
    e->used = true;
    e->name = fmti_clean_name(b, strcmp(path, "-") == 0 ? "" : fmti_last_part(path));
    e->path = svo_string_copy(b->allocator, path);
    if (e->name == NULL || e->path == NULL) return fmti_scene_no_memory(err);
    e->info.name = e->name;
    e->info.file = fmti_last_part(path);
    SVO_TRY(open_file(b, e, err));
    svo_place place = {.transform = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
    if (svo_buffer_append(&b->places, &place, sizeof place) == NULL) return fmti_scene_no_memory(err);
    b->input.places = (const svo_place *)(const void *)b->places.data;
    b->input.place_count = 1;
    return SVO_OK;
}

static svo_result load(fmt_scene_build *b, const char *path, svo_error *err)
{
    fmt_bytes file;
    fmti_scene_phase(b, "read");
    SVO_TRY(open_bytes(b, path, &file, err));
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
    else result = fmti_load_mesh_scene(b, path, &file, err);
    fmt_bytes_close(&file);
    return about(strcmp(path, "-") == 0 ? "stdin" : path, result, err);
}

static svo_result pack(fmt_scene_build *b, svo_error *err)
{
    fmti_scene_phase(b, "pack");
    for (uint32_t i = 0; i < b->count; i++) {
        fmti_entry *e = &b->entries[i];
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
    if (b == NULL) return fmti_scene_no_memory(err);
    b->options = o;
    b->allocator = a;
    svo_buffer_init(&b->places, a);
    svo_buffer_init(&b->place_names, a);
    svo_buffer_init(&b->poses, a);
    svo_buffer_init(&b->matrices, a);
    svo_buffer_init(&b->frames, a);
    svo_result result = load(b, path, err);
    if (result == SVO_OK) result = about(path, pack(b, err), err);
    if (result != SVO_OK) {
        fmt_scene_build_close(b);
        return result;
    }
    *out = b;
    return SVO_OK;
}
