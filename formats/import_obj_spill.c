/* OBJ files that are larger than memory: windows of the text go to spilled arrays, which become parts outside of memory. */
#include <string.h>

#include "import_obj.h"

static svo_result spill_colors(obj_file *f, svo_error *err)
{
    /* Vertices without a colour between those that have one are as bright as 1 is. */
    import_store *s = f->store;
    if (f->color_count == 0) return SVO_OK;
    float white[3 * 256];
    for (size_t i = 0; i < sizeof white / sizeof *white; i++) white[i] = 1;
    for (uint64_t have = s->count[STORE_COLORS]; have < f->values.origin[OBJ_V]; have = s->count[STORE_COLORS]) {
        uint64_t n = f->values.origin[OBJ_V] - have < 256 ? f->values.origin[OBJ_V] - have : 256;
        SVO_TRY(store_values(s, STORE_COLORS, white, n, err));
    }
    return store_values(s, STORE_COLORS, f->colors, f->color_count, err);
}

static svo_result spill_values(obj_file *f, svo_error *err)
{
    obj_values *v = &f->values;
    for (uint64_t i = 0; i < v->count[OBJ_VT]; i++) v->uvs[2 * i + 1] = 1 - v->uvs[2 * i + 1]; /* origin at the top */
    SVO_TRY(spill_colors(f, err));
    SVO_TRY(store_values(f->store, STORE_POSITIONS, v->positions, v->count[OBJ_V], err));
    SVO_TRY(store_values(f->store, STORE_UVS, v->uvs, v->count[OBJ_VT], err));
    SVO_TRY(store_values(f->store, STORE_NORMALS, v->normals, v->count[OBJ_VN], err));
    const svo_allocator *a = f->context->allocator;
    svo_free(a, v->positions, v->count[OBJ_V], 3 * sizeof(double));
    svo_free(a, v->uvs, v->count[OBJ_VT], 2 * sizeof(float));
    svo_free(a, v->normals, v->count[OBJ_VN], 3 * sizeof(float));
    svo_free(a, f->colors, f->color_count, 3 * sizeof(float));
    v->positions = NULL;
    v->uvs = v->normals = f->colors = NULL;
    f->color_count = 0;
    for (int k = 0; k < OBJ_KINDS; k++) {
        v->origin[k] += v->count[k];
        v->count[k] = 0;
    }
    return SVO_OK;
}

static void note(uint32_t index, uint32_t *least, uint32_t *most)
{
    if (index == SVO_NONE) return;
    if (index < *least) *least = index;
    if (index > *most) *most = index;
}

svo_result obj_spill_window(obj_file *f, svo_error *err)
{
    SVO_TRY(spill_values(f, err));
    obj_group *group = (obj_group *)(void *)f->groups.data;
    for (uint32_t i = 0; i < f->groups.size / sizeof *group; i++) {
        obj_group *g = &group[i];
        if (g->face_count == 0) continue;
        for (uint64_t k = 0; k < g->corner_count; k++) {
            note(g->corners[k].vt, &g->least_vt, &f->most_vt);
            note(g->corners[k].vn, &g->least_vn, &f->most_vn);
        }
        store_faces faces = {.part = i, .corners = &g->corners->v, .per_corner = 3, .sizes = g->sizes, .corner_count = g->corner_count, .face_count = g->face_count};
        SVO_TRY(store_add_faces(f->store, &faces, err));
        g->stored_faces += g->face_count;
        svo_free(f->context->allocator, g->corners, g->corner_count, sizeof *g->corners);
        svo_free(f->context->allocator, g->sizes, g->face_count, sizeof *g->sizes);
        g->corners = NULL;
        g->sizes = NULL;
        g->corner_count = g->face_count = 0;
    }
    return SVO_OK;
}

static void resolve_material(const obj_file *f, const mtl_set *materials, obj_group *g)
{
    if (g->material == NULL) return;
    g->resolved = obj_find_material(materials, g->material);
    if (g->resolved == SVO_NONE)
        svo_warn(f->context->warnings, "%s: material '%.80s' is not defined; it is white", f->context->path, g->material);
}

static void warn_about(const obj_file *f)
{
    const import_store *s = f->store;
    svo_warnings *w = f->context->warnings;
    const char *path = f->context->path;
    if (s->fanned) svo_warn(w, "%s: some polygons cross themselves; they were cut as fans", path);
    if (f->most_vt >= s->count[STORE_UVS] && f->most_vt != 0) svo_warn(w, "%s: faces refer to texture coordinates that do not exist; those corners have none", path);
    if (f->most_vn >= s->count[STORE_NORMALS] && f->most_vn != 0) svo_warn(w, "%s: faces refer to normals that do not exist; those corners have none", path);
    if (s->bad_color) svo_warn(w, "%s: vertex colours that are not numbers are taken as white", path);
    if (f->large_colors) svo_warn(w, "%s: vertex colours exceed 1; all are taken as 0..255", path);
}

static svo_result take_materials(mtl_set *materials, svo_mesh *mesh, svo_error *err)
{
    uint64_t count;
    void *list;
    SVO_TRY(import_exact(&materials->list, sizeof(svo_material), &list, &count, err));
    mesh->materials = list;
    mesh->material_count = (uint32_t)count;
    return import_images_finish(&materials->images, mesh, err);
}

svo_result obj_build_spilled(obj_file *f, mtl_set *materials, svo_mesh *mesh, svo_error *err)
{
    const svo_allocator *a = f->context->allocator;
    import_store *s = f->store;
    obj_group *group = (obj_group *)(void *)f->groups.data;
    uint32_t groups = (uint32_t)(f->groups.size / sizeof *group), used = 0;
    if ((uint64_t)groups * (materials->list.size / sizeof(svo_material)) > 1000000000u)
        return svo_fail(err, SVO_LIMIT, "%s: too many material names", f->context->path);
    svo_part *all = svo_calloc(a, groups, sizeof *all), *kept = NULL;
    svo_soup_layout *layouts = svo_alloc(a, groups, sizeof *layouts);
    svo_result r = groups == 0 || (all != NULL && layouts != NULL) ? SVO_OK : import_no_memory(err);
    s->vertex_scale = f->large_colors ? 255 : 1;
    for (uint32_t i = 0; r == SVO_OK && i < groups; i++) {
        if (group[i].stored_faces != 0) resolve_material(f, materials, &group[i]);
        const bool uvs[SVO_MAX_UV_SETS] = {group[i].least_vt < s->count[STORE_UVS]};
        layouts[i] = svo_soup_layout_make(s->wide, group[i].least_vn < s->count[STORE_NORMALS], uvs, s->count[STORE_COLORS] != 0);
        all[i].material = group[i].resolved;
    }
    if (r == SVO_OK) r = store_resolve(s, all, layouts, groups, err);
    if (r == SVO_OK) warn_about(f);
    if (r == SVO_OK) r = take_materials(materials, mesh, err);
    for (uint32_t i = 0; r == SVO_OK && i < groups; i++) used += all[i].triangle_count != 0;
    if (r == SVO_OK && used != 0 && (kept = svo_calloc(a, used, sizeof *kept)) == NULL) r = import_no_memory(err);
    for (uint32_t i = 0, k = 0; all != NULL && i < groups; i++) {
        if (r == SVO_OK && all[i].triangle_count != 0) kept[k++] = all[i];
        else import_part_free(a, &all[i]);
    }
    svo_free(a, all, groups, sizeof *all);
    svo_free(a, layouts, groups, sizeof *layouts);
    return r == SVO_OK ? import_single_shape(f->context, kept, used, mesh, err) : r;
}
