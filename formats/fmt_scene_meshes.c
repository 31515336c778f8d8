/* Meshes to octrees, and a mesh file as a scene: its shapes are assets, its instances are instances. */
#include <math.h>
#include <string.h>

#include "fmt_utf8.h"
#include "fmti_scene_build.h"

#define COARSE_DEPTH 3u /* assets below this get a warning */
#define PI 3.14159265358979323846

fmt_import_options fmti_import_options(const fmt_scene_build *b, bool skip_images)
{
    fmt_import_options o = {.allocator = b->allocator, .skip_images = skip_images, .threads = b->options.voxelize.threads,
                            .warnings = skip_images ? NULL : b->options.voxelize.warnings, .file_read = b->options.file_read, .file_read_user = b->options.file_read_user};
    return o;
}

/* Longest edge of the bounds of what a mesh places; 0 when there is nothing. */
double fmti_mesh_extent(const svo_mesh *mesh)
{
    double low[3], high[3], extent = 0;
    if (!svo_mesh_bounds(mesh, low, high)) return 0;
    for (int k = 0; k < 3; k++) extent = fmax(extent, high[k] - low[k]);
    return extent;
}

/* Voxels with the bones that move them. */
static svo_result build_with_bones(fmti_entry *e, const svo_mesh *mesh, uint32_t shape, const svo_voxelize_options *o, const svo_dag_options *dag, const svo_tree_info *info,
                                   svo_dag_builder **builder, svo_error *err)
{
    fmti_skin bound;
    svo_skin *skin = NULL;
    svo_voxelize_report report;
    SVO_TRY(fmti_skin_make(e->rigged, shape, &bound, err));
    svo_result result = svo_skin_create(&bound.mesh, info, o->allocator, &skin, err);
    if (result == SVO_OK) result = svo_dag_builder_create(svo_skin_info(skin), dag, builder, err);
    if (result == SVO_OK) {
        svo_chunk_sink sink = svo_dag_builder_sink(*builder), with_bones = svo_skin_sink(skin, &sink);
        result = svo_voxelize(mesh, o, info, &with_bones, &report, err);
        if (result != SVO_OK) svo_dag_builder_free(*builder);
    }
    svo_skin_free(skin);
    fmti_skin_free(&bound);
    return result;
}

svo_result fmti_build_mesh(fmt_scene_build *b, fmti_entry *e, const svo_mesh *mesh, uint32_t shape, uint32_t depth, svo_error *err)
{
    svo_voxelize_options o = b->options.voxelize;
    o.depth = depth;
    o.voxel_size = 0;
    svo_tree_info info;
    SVO_TRY(svo_voxelize_plan(mesh, &o, &info, err));
    svo_dag_builder *builder;
    if (e->rigged != NULL && e->rigged->kept != 0) SVO_TRY(build_with_bones(e, mesh, shape, &o, &b->options.dag, &info, &builder, err));
    else {
        SVO_TRY(svo_dag_builder_create(&info, &b->options.dag, &builder, err));
        svo_chunk_sink sink = svo_dag_builder_sink(builder);
        svo_voxelize_report report;
        svo_result result = svo_voxelize(mesh, &o, &info, &sink, &report, err);
        if (result != SVO_OK) {
            svo_dag_builder_free(builder);
            return result;
        }
    }
    SVO_TRY(svo_dag_builder_finish(builder, &e->packed, NULL, err));
    e->view = svo_packed_view(e->packed);
    return SVO_OK;
}

/* Levels that an asset needs for voxels of at most `voxel` in the scene. */
svo_result fmti_needed_depth(const fmt_scene_build *b, const fmti_entry *e, double voxel, uint32_t *depth, svo_error *err)
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

void fmti_warn_coarse(const fmt_scene_build *b)
{
    uint32_t coarse = 0;
    for (uint32_t i = 0; i < b->count; i++) {
        const fmti_entry *e = &b->entries[i];
        coarse += e->is_mesh && e->view != NULL && !e->view->empty && e->view->depth < COARSE_DEPTH;
    }
    if (coarse != 0)
        svo_warn(b->options.voxelize.warnings, "%u of the meshes are less than %u voxels large at the scene's voxel size; a greater depth (--depth, --view-distance or --budget) shows more of them",
                 coarse, 1u << COARSE_DEPTH);
}

double fmti_scene_voxel(const fmt_scene_build *b)
{
    if (b->options.voxel_size > 0) return b->options.voxel_size;
    double largest = 0;
    for (uint32_t i = 0; i < b->count; i++)
        if (b->entries[i].used && b->entries[i].is_mesh) largest = fmax(largest, b->entries[i].extent * b->entries[i].scale);
    return ldexp(largest, -(int)b->options.depth);
}

/* ---- a mesh file as a scene: its shapes are assets, its instances are instances ---- */

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
        if (name == NULL) return fmti_scene_no_memory(err);
        fmt_utf8_repair(name);
    }
    return svo_buffer_append(&b->places, &place, sizeof place) != NULL ? SVO_OK : fmti_scene_no_memory(err);
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
static void one_shape(svo_mesh *mesh, uint32_t shape, fmti_entry *e)
{
    e->alone = *mesh;
    e->place = (svo_instance){.name = mesh->shapes[shape].name, .shape = 0, .transform = svo_mat4_identity()};
    e->alone.shape_count = e->alone.instance_count = 1;
    e->alone.shapes = mesh->shapes + shape;
    e->alone.instances = &e->place;
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
    if (b->entries[i].rigged != NULL) return NULL;
    for (uint32_t k = 0; k < i; k++)
        if (b->entries[k].rigged == NULL && b->entries[k].packed != NULL && b->entries[k].info.depth == b->entries[i].info.depth && same_shape(&b->mesh.shapes[k], &b->mesh.shapes[i]))
            return b->entries[k].view;
    return NULL;
}

/* The pose of every shape with a skin, at the time that is asked for. */
static svo_result pose_shapes(fmt_scene_build *b, svo_error *err)
{
    const fmt_scene_build_options *o = &b->options;
    const svo_pose none = svo_pose_stated();
    uint32_t animation = o->animation != NULL ? fmt_rig_find(&b->rig, o->animation) : SVO_NONE, frame, pose;
    for (uint32_t i = 0; i < b->rig.shape_count; i++) {
        fmti_entry *e = &b->entries[i];
        if (!e->used || b->rig.shapes[i].skin == SVO_NONE) continue;
        e->rigged = svo_calloc(b->allocator, 1, sizeof *e->rigged);
        if (e->rigged == NULL) return fmti_scene_no_memory(err);
        SVO_TRY(fmti_rigged_make(e->rigged, &b->rig, &e->alone, false, i, e->extent, b->allocator, err));
        SVO_TRY(fmti_rigged_frame(e->rigged, animation, o->time, &frame, err));
        SVO_TRY(fmti_scene_add_pose(b, e, &none, frame, &pose, err));
        svo_place *places = (svo_place *)(void *)b->places.data;
        for (uint64_t k = 0; k < b->input.place_count; k++)
            if (places[k].asset == i) places[k].pose = pose;
    }
    return fmti_scene_finish_poses(b, err);
}

svo_result fmti_load_mesh_scene(fmt_scene_build *b, const char *path, const fmt_bytes *file, svo_error *err)
{
    fmt_import_options import = fmti_import_options(b, false);
    if (!b->options.bake_skins) import.rig = &b->rig;
    import.animation = b->options.animation;
    import.time = b->options.time;
    SVO_TRY(fmt_import_mesh(path, &import, &b->mesh, err));
    SVO_TRY(fmti_scene_entries(b, b->mesh.shape_count, err));
    if (svo_buffer_append(&b->place_names, "", 1) == NULL) return fmti_scene_no_memory(err);
    for (uint64_t i = 0; i < b->mesh.instance_count; i++) SVO_TRY(add_mesh_instance(b, i, err));
    b->input.places = (const svo_place *)(const void *)b->places.data;
    b->input.place_count = b->mesh.instance_count;
    b->input.names = (const char *)b->place_names.data;
    b->input.names_size = b->place_names.size;
    if (b->mesh.camera_count != 0) take_camera(b);
    fmti_look_at_places(b, b->input.places, b->input.place_count);
    for (uint32_t i = 0; i < b->count; i++) {
        fmti_entry *e = &b->entries[i];
        e->name = fmti_clean_name(b, b->mesh.shapes[i].name);
        if (e->name == NULL) return fmti_scene_no_memory(err);
        e->info.name = e->name;
        e->info.file = fmti_last_part(path);
        e->info.source = "mesh";
        memcpy(e->info.hash, b->hash, sizeof e->info.hash);
        e->info.source_bytes = b->count == 1 ? file->size : 0;
        e->is_mesh = true;
        one_shape(&b->mesh, i, e);
        e->extent = fmti_mesh_extent(&e->alone);
    }
    SVO_TRY(pose_shapes(b, err));
    double voxel = fmti_scene_voxel(b);
    fmti_scene_phase(b, "voxelize");
    for (uint32_t i = 0; i < b->count; i++) {
        fmti_entry *e = &b->entries[i];
        if (!e->used) continue;
        SVO_TRY(fmti_needed_depth(b, e, voxel, &e->info.depth, err));
        e->view = built_before(b, i);
        if (e->view == NULL) SVO_TRY(fmti_build_mesh(b, e, &e->alone, i, e->info.depth, err));
        fmti_scene_progress(b, i + 1);
    }
    fmti_scene_progress(b, b->count);
    fmti_warn_coarse(b);
    for (uint32_t i = 0; i < b->count; i++) fmti_entry_rig_free(b, &b->entries[i]);
    svo_mesh_free(&b->mesh);
    return SVO_OK;
}

