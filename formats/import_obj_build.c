/* From what an OBJ file says to parts: polygons cut, (v, vt, vn) corners unified into vertices, one part a material. */
#include "import_obj.h"

#include <math.h>
#include <string.h>


typedef struct builder {
    const obj_file *file;
    const import_context *context;
    uint64_t position_count, uv_count, normal_count, color_count;
    bool fanned, bad_uv, bad_normal, bad_color;
    /* Per position, the first unified vertex of the current part; valid where stamp equals the part's number. */
    uint32_t *head, *stamp;
    svo_buffer corners;   /* obj_corner: unified vertices of the part */
    svo_buffer chain;     /* uint32_t: next unified vertex with the same position */
    svo_buffer triangles; /* uint32_t: corner numbers, then vertices */
    svo_buffer polygon, scratch, local;
} builder;

static svo_result check_corners(builder *b, const obj_group *g, svo_error *err)
{
    obj_corner *c = (obj_corner *)(void *)g->corners.data;
    uint64_t n = g->corners.size / sizeof *c;
    for (uint64_t i = 0; i < n; i++) {
        if (c[i].v >= b->position_count)
            return svo_fail(err, SVO_INVALID_DATA, "%s: a face refers to vertex %lu of %llu", b->context->path, (unsigned long)c[i].v + 1,
                            (unsigned long long)b->position_count);
        if (c[i].vt != SVO_NONE && c[i].vt >= b->uv_count) c[i].vt = SVO_NONE, b->bad_uv = true;
        if (c[i].vn != SVO_NONE && c[i].vn >= b->normal_count) c[i].vn = SVO_NONE, b->bad_normal = true;
    }
    return SVO_OK;
}

/* Corner numbers of all triangles of the group. */
static svo_result cut_polygons(builder *b, const obj_group *g, svo_error *err)
{
    const uint32_t *size = (const uint32_t *)(void *)g->sizes.data;
    const obj_corner *corner = (const obj_corner *)(void *)g->corners.data;
    const double *positions = (const double *)(void *)b->file->positions.data;
    uint64_t faces = g->sizes.size / sizeof *size, corners = g->corners.size / sizeof *corner;
    b->triangles.size = 0;
    if (corners >= SVO_NONE) return svo_fail(err, SVO_LIMIT, "%s: more than 2^32 face corners with one material", b->context->path);
    if (!svo_buffer_reserve(&b->triangles, (size_t)(corners - 2 * faces) * 3 * sizeof(uint32_t))) return import_no_memory(err);
    uint32_t base = 0;
    for (uint64_t f = 0; f < faces; base += size[f], f++) {
        uint32_t n = size[f];
        uint32_t *out = svo_buffer_append(&b->triangles, NULL, (size_t)(n - 2) * 3 * sizeof *out);
        if (out == NULL) return import_no_memory(err);
        if (n == 3) {
            out[0] = base, out[1] = base + 1, out[2] = base + 2;
            continue;
        }
        b->polygon.size = 0;
        double *p = svo_buffer_append(&b->polygon, NULL, (size_t)n * 3 * sizeof *p);
        if (p == NULL) return import_no_memory(err);
        for (uint32_t k = 0; k < n; k++) memcpy(p + 3 * (size_t)k, positions + 3 * (size_t)corner[base + k].v, 3 * sizeof *p);
        SVO_TRY(import_triangulate(p, n, out, &b->scratch, &b->fanned, err));
        for (size_t k = 0; k < 3 * (size_t)(n - 2); k++) out[k] += base;
    }
    return SVO_OK;
}

/* Replace corner numbers by vertex numbers, in order of first use. */
static svo_result unify(builder *b, const obj_group *g, uint32_t part_number, svo_error *err)
{
    const obj_corner *corner = (const obj_corner *)(void *)g->corners.data;
    uint32_t *index = (uint32_t *)(void *)b->triangles.data;
    uint64_t n = b->triangles.size / sizeof *index;
    b->corners.size = b->chain.size = 0;
    for (uint64_t i = 0; i < n; i++) {
        obj_corner c = corner[index[i]];
        if (b->stamp[c.v] != part_number) b->stamp[c.v] = part_number, b->head[c.v] = SVO_NONE;
        const obj_corner *have = (const obj_corner *)(void *)b->corners.data;
        const uint32_t *next = (const uint32_t *)(void *)b->chain.data;
        uint32_t at = b->head[c.v], steps = 0;
        /* A position with very many different corners (a hostile or odd file) is not searched to the end; an
         * unshared vertex is as right. */
        while (at != SVO_NONE && (have[at].vt != c.vt || have[at].vn != c.vn)) at = ++steps < 256 ? next[at] : SVO_NONE;
        if (at == SVO_NONE) {
            at = (uint32_t)(b->corners.size / sizeof c);
            if (svo_buffer_append(&b->corners, &c, sizeof c) == NULL || svo_buffer_append(&b->chain, &b->head[c.v], sizeof(uint32_t)) == NULL)
                return import_no_memory(err);
            b->head[c.v] = at;
        }
        index[i] = at;
    }
    return SVO_OK;
}

static svo_result fill_part(builder *b, const obj_group *g, svo_part *part, svo_error *err)
{
    const svo_allocator *a = b->context->allocator;
    const obj_corner *c = (const obj_corner *)(void *)b->corners.data;
    uint64_t n = b->corners.size / sizeof *c;
    bool uvs = false, normals = false;
    for (uint64_t i = 0; i < n; i++) uvs = uvs || c[i].vt != SVO_NONE, normals = normals || c[i].vn != SVO_NONE;
    bool colors = b->color_count != 0;
    part->material = g->resolved;
    part->vertex_count = n;
    part->triangle_count = b->triangles.size / (3 * sizeof(uint32_t));
    part->positions = svo_alloc(a, n, 3 * sizeof(double));
    part->indices = svo_alloc(a, part->triangle_count, 3 * sizeof(uint32_t));
    if (uvs) part->uvs[0] = svo_alloc(a, n, 2 * sizeof(float));
    if (normals) part->normals = svo_alloc(a, n, 3 * sizeof(float));
    if (colors) part->colors = svo_alloc(a, n, 4 * sizeof(float));
    if (part->positions == NULL || part->indices == NULL || (uvs && part->uvs[0] == NULL) || (normals && part->normals == NULL) ||
        (colors && part->colors == NULL))
        return import_no_memory(err);
    memcpy(part->indices, b->triangles.data, (size_t)part->triangle_count * 3 * sizeof(uint32_t));
    const double *position = (const double *)(void *)b->file->positions.data;
    const float *uv = (const float *)(void *)b->file->uvs.data, *normal = (const float *)(void *)b->file->normals.data;
    const float *color = (const float *)(void *)b->file->colors.data;
    float scale = b->file->large_colors ? 1 / 255.0f : 1;
    for (uint64_t i = 0; i < n; i++) {
        memcpy(part->positions + 3 * i, position + 3 * (uint64_t)c[i].v, 3 * sizeof(double));
        if (uvs) {
            bool has = c[i].vt != SVO_NONE;
            part->uvs[0][2 * i] = has ? uv[2 * (uint64_t)c[i].vt] : 0;
            part->uvs[0][2 * i + 1] = has ? 1 - uv[2 * (uint64_t)c[i].vt + 1] : 0;
        }
        if (normals) {
            if (c[i].vn != SVO_NONE) memcpy(part->normals + 3 * i, normal + 3 * (uint64_t)c[i].vn, 3 * sizeof(float));
            else memset(part->normals + 3 * i, 0, 3 * sizeof(float));
        }
        for (int k = 0; colors && k < 3; k++) {
            float v = c[i].v < b->color_count ? color[3 * (uint64_t)c[i].v + (uint64_t)k] : 1;
            b->bad_color = b->bad_color || !isfinite(v);
            part->colors[4 * i + (uint64_t)k] = c[i].v < b->color_count ? import_srgb_to_linear((double)(v * scale)) : 1;
        }
        if (colors) part->colors[4 * i + 3] = 1;
    }
    return SVO_OK;
}

/* The last definition of a name counts, as with programs that read the library line by line. */
static uint32_t find_material(const mtl_set *set, const char *name)
{
    const svo_material *m = (const svo_material *)(void *)set->list.data;
    for (uint64_t i = set->list.size / sizeof *m; i > 0; i--)
        if (strcmp(m[i - 1].name, name) == 0) return (uint32_t)(i - 1);
    return SVO_NONE;
}

static svo_result build_parts(builder *b, mtl_set *materials, svo_buffer *parts, svo_error *err)
{
    obj_group *group = (obj_group *)(void *)b->file->groups.data;
    uint32_t groups = (uint32_t)(b->file->groups.size / sizeof *group);
    if ((uint64_t)groups * (materials->list.size / sizeof(svo_material)) > 1000000000u)
        return svo_fail(err, SVO_LIMIT, "%s: too many material names", b->context->path);
    for (uint32_t g = 0; g < groups; g++) {
        if (group[g].sizes.size == 0) continue;
        SVO_TRY(check_corners(b, &group[g], err));
        if (group[g].material != NULL) {
            group[g].resolved = find_material(materials, group[g].material);
            if (group[g].resolved == SVO_NONE)
                svo_warn(b->context->warnings, "%s: material '%.80s' is not defined; it is white", b->context->path, group[g].material);
        }
        SVO_TRY(cut_polygons(b, &group[g], err));
        SVO_TRY(unify(b, &group[g], g, err));
        svo_part part = {0};
        svo_result r = fill_part(b, &group[g], &part, err);
        if (r == SVO_OK && svo_buffer_append(parts, &part, sizeof part) == NULL) r = import_no_memory(err);
        if (r != SVO_OK) {
            import_part_free(b->context->allocator, &part);
            return r;
        }
        svo_buffer_free(&group[g].corners);
        svo_buffer_free(&group[g].sizes);
    }
    return SVO_OK;
}

static svo_result finish(builder *b, mtl_set *materials, svo_buffer *parts, svo_mesh *mesh, svo_error *err)
{
    uint64_t count;
    void *list;
    SVO_TRY(import_exact(&materials->list, sizeof(svo_material), &list, &count, err));
    mesh->materials = list, mesh->material_count = (uint32_t)count;
    SVO_TRY(import_images_finish(&materials->images, mesh, err));
    SVO_TRY(import_exact(parts, sizeof(svo_part), &list, &count, err));
    return import_single_shape(b->context, list, (uint32_t)count, mesh, err);
}

static void warn_about(const builder *b)
{
    svo_warnings *w = b->context->warnings;
    const char *path = b->context->path;
    if (b->fanned) svo_warn(w, "%s: some polygons cross themselves; they were cut as fans", path);
    if (b->bad_uv) svo_warn(w, "%s: faces refer to texture coordinates that do not exist; those corners have none", path);
    if (b->bad_normal) svo_warn(w, "%s: faces refer to normals that do not exist; those corners have none", path);
    if (b->bad_color) svo_warn(w, "%s: vertex colours that are not numbers are taken as white", path);
    if (b->file->large_colors) svo_warn(w, "%s: vertex colours exceed 1; all are taken as 0..255", path);
}

svo_result obj_build(obj_file *f, mtl_set *materials, svo_mesh *mesh, svo_error *err)
{
    const svo_allocator *a = f->context->allocator;
    builder b = {.file = f, .context = f->context};
    b.position_count = f->positions.size / (3 * sizeof(double));
    b.uv_count = f->uvs.size / (2 * sizeof(float));
    b.normal_count = f->normals.size / (3 * sizeof(float));
    b.color_count = f->colors.size / (3 * sizeof(float));
    svo_buffer parts, *all[] = {&b.corners, &b.chain, &b.triangles, &b.polygon, &b.scratch, &b.local, &parts};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_init(all[i], a);
    svo_result r = SVO_OK;
    if (b.position_count != 0) {
        b.head = svo_alloc(a, b.position_count, sizeof(uint32_t));
        b.stamp = svo_alloc(a, b.position_count, sizeof(uint32_t));
        if (b.head == NULL || b.stamp == NULL) r = import_no_memory(err);
        else memset(b.stamp, 0xff, (size_t)b.position_count * sizeof(uint32_t));
    }
    if (r == SVO_OK) r = build_parts(&b, materials, &parts, err);
    if (r == SVO_OK) warn_about(&b);
    if (r == SVO_OK) r = finish(&b, materials, &parts, mesh, err);
    svo_part *part = (svo_part *)(void *)parts.data;
    for (uint64_t i = 0; i < parts.size / sizeof *part; i++) import_part_free(a, &part[i]);
    svo_free(a, b.head, b.position_count, sizeof(uint32_t));
    svo_free(a, b.stamp, b.position_count, sizeof(uint32_t));
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_free(all[i]);
    return r;
}
