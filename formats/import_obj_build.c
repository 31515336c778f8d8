/* From what an OBJ file says to parts: polygons cut, (v, vt, vn) corners unified into vertices, one part a material. */
#include "import_obj.h"

#include <math.h>
#include <string.h>

#include "svo_task.h"

enum { GRAIN = 1 << 16 }; /* corners or vertices of a parallel block */

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

/* One group, worked on in parallel. Flags are set atomically: which thread does it first does not matter. */
typedef struct group_job {
    builder *b;
    const obj_group *group;
    bool bad_uv, bad_normal, bad_color, has_uv, has_normal, polygons;
    uint32_t *first, *number; /* of a position: the triangle corner that uses it first; its vertex */
    uint64_t *firsts;         /* of a block: positions first used in it, then in the blocks before */
    svo_part *part;
} group_job;

static void set_flag(bool *flag, bool value)
{
    if (value && !__atomic_load_n(flag, __ATOMIC_RELAXED)) __atomic_store_n(flag, true, __ATOMIC_RELAXED);
}

static svo_result check_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    group_job *j = user;
    const builder *b = j->b;
    obj_corner *c = j->group->corners;
    bool bad_uv = false, bad_normal = false, has_uv = false, has_normal = false;
    for (uint64_t i = begin; i < end; i++) {
        if (c[i].v >= b->position_count)
            return svo_fail(err, SVO_INVALID_DATA, "%s: a face refers to vertex %lu of %llu", b->context->path, (unsigned long)c[i].v + 1,
                            (unsigned long long)b->position_count);
        if (c[i].vt != SVO_NONE && c[i].vt >= b->uv_count) c[i].vt = SVO_NONE, bad_uv = true;
        if (c[i].vn != SVO_NONE && c[i].vn >= b->normal_count) c[i].vn = SVO_NONE, bad_normal = true;
        has_uv |= c[i].vt != SVO_NONE;
        has_normal |= c[i].vn != SVO_NONE;
    }
    set_flag(&j->bad_uv, bad_uv);
    set_flag(&j->bad_normal, bad_normal);
    set_flag(&j->has_uv, has_uv);
    set_flag(&j->has_normal, has_normal);
    return SVO_OK;
}

static svo_result check_sizes(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    group_job *j = user;
    const uint32_t *size = j->group->sizes;
    bool polygons = false;
    for (uint64_t i = begin; i < end; i++) polygons |= size[i] != 3;
    set_flag(&j->polygons, polygons);
    return SVO_OK;
}

static svo_result count_corners(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    uint32_t *to = user;
    for (uint64_t i = begin; i < end; i++) to[i] = (uint32_t)i;
    return SVO_OK;
}

/* Corner numbers of all triangles of the group. */
static svo_result cut_polygons(builder *b, const group_job *j, svo_error *err)
{
    const obj_group *g = j->group;
    const uint32_t *size = g->sizes;
    const obj_corner *corner = g->corners;
    const double *positions = b->file->values.positions;
    uint64_t faces = g->face_count, corners = g->corner_count;
    b->triangles.size = 0;
    if (corners >= SVO_NONE) return svo_fail(err, SVO_LIMIT, "%s: more than 2^32 face corners with one material", b->context->path);
    if (!svo_buffer_reserve(&b->triangles, (size_t)(corners - 2 * faces) * 3 * sizeof(uint32_t))) return import_no_memory(err);
    if (!j->polygons) {
        b->triangles.size = (size_t)corners * sizeof(uint32_t);
        return svo_parallel_for(b->context->threads, corners, GRAIN, count_corners, b->triangles.data, err);
    }
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

/* --- vertices in the order of first use --- */

static svo_result first_uses(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    group_job *j = user;
    const obj_corner *corner = j->group->corners;
    const uint32_t *t = (const uint32_t *)(const void *)j->b->triangles.data;
    for (uint64_t i = begin; i < end; i++) {
        uint32_t *first = &j->first[corner[t[i]].v], have = __atomic_load_n(first, __ATOMIC_RELAXED);
        while (i < have && !__atomic_compare_exchange_n(first, &have, (uint32_t)i, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
    }
    return SVO_OK;
}

static svo_result count_firsts(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    group_job *j = user;
    const obj_corner *corner = j->group->corners;
    const uint32_t *t = (const uint32_t *)(const void *)j->b->triangles.data;
    uint64_t n = 0;
    for (uint64_t i = begin; i < end; i++) n += j->first[corner[t[i]].v] == i;
    j->firsts[begin / GRAIN] = n;
    return SVO_OK;
}

static svo_result number_firsts(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    group_job *j = user;
    const obj_corner *corner = j->group->corners;
    const uint32_t *t = (const uint32_t *)(const void *)j->b->triangles.data;
    obj_corner *to = (obj_corner *)(void *)j->b->corners.data;
    uint64_t n = j->firsts[begin / GRAIN];
    for (uint64_t i = begin; i < end; i++) {
        const obj_corner *c = &corner[t[i]];
        if (j->first[c->v] != i) continue;
        j->number[c->v] = (uint32_t)n;
        to[n++] = *c;
    }
    return SVO_OK;
}

static svo_result rename_corners(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    group_job *j = user;
    const obj_corner *corner = j->group->corners;
    uint32_t *t = (uint32_t *)(void *)j->b->triangles.data;
    for (uint64_t i = begin; i < end; i++) t[i] = j->number[corner[t[i]].v];
    return SVO_OK;
}

/* unify() where corners have positions alone, in parallel. False when there is no memory for it. */
static bool unify_positions(builder *b, group_job *j)
{
    const svo_allocator *a = b->context->allocator;
    uint64_t n = b->triangles.size / sizeof(uint32_t), blocks = (n + GRAIN - 1) / GRAIN, total = 0;
    uint32_t threads = b->context->threads;
    svo_error none;
    j->first = svo_alloc(a, b->position_count, sizeof *j->first);
    j->number = svo_alloc(a, b->position_count, sizeof *j->number);
    j->firsts = svo_alloc(a, blocks, sizeof *j->firsts);
    bool ok = j->first != NULL && j->number != NULL && j->firsts != NULL;
    if (ok) {
        memset(j->first, 0xff, (size_t)b->position_count * sizeof *j->first);
        ok = svo_parallel_for(threads, n, GRAIN, first_uses, j, &none) == SVO_OK && svo_parallel_for(threads, n, GRAIN, count_firsts, j, &none) == SVO_OK;
        for (uint64_t i = 0; i < blocks; i++) {
            uint64_t count = j->firsts[i];
            j->firsts[i] = total;
            total += count;
        }
        b->corners.size = 0;
        ok = ok && svo_buffer_append(&b->corners, NULL, (size_t)total * sizeof(obj_corner)) != NULL &&
             svo_parallel_for(threads, n, GRAIN, number_firsts, j, &none) == SVO_OK &&
             svo_parallel_for(threads, n, GRAIN, rename_corners, j, &none) == SVO_OK;
    }
    svo_free(a, j->first, b->position_count, sizeof *j->first);
    svo_free(a, j->number, b->position_count, sizeof *j->number);
    svo_free(a, j->firsts, blocks, sizeof *j->firsts);
    return ok;
}

/* Replace corner numbers by vertex numbers, in order of first use. */
static svo_result unify(builder *b, group_job *j, uint32_t part_number, svo_error *err)
{
    const obj_corner *corner = j->group->corners;
    uint32_t *index = (uint32_t *)(void *)b->triangles.data;
    uint64_t n = b->triangles.size / sizeof *index;
    /* Not where a table of all positions would cost more than the group. */
    if (!j->has_uv && !j->has_normal && n >= b->position_count && n >= GRAIN && unify_positions(b, j)) return SVO_OK;
    if (b->head == NULL) {
        b->head = svo_alloc(b->context->allocator, b->position_count, sizeof *b->head);
        b->stamp = svo_alloc(b->context->allocator, b->position_count, sizeof *b->stamp);
        if (b->head == NULL || b->stamp == NULL) return import_no_memory(err);
        memset(b->stamp, 0xff, (size_t)b->position_count * sizeof *b->stamp);
    }
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

static svo_result fill_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    group_job *j = user;
    const builder *b = j->b;
    const svo_part *part = j->part;
    const obj_corner *c = (const obj_corner *)(const void *)b->corners.data;
    const obj_values *values = &b->file->values;
    const float *color = b->file->colors;
    float scale = b->file->large_colors ? 1 / 255.0f : 1;
    bool bad_color = false;
    for (uint64_t i = begin; i < end; i++) {
        memcpy(part->positions + 3 * i, values->positions + 3 * (uint64_t)c[i].v, 3 * sizeof(double));
        if (part->uvs[0] != NULL) {
            bool has = c[i].vt != SVO_NONE;
            part->uvs[0][2 * i] = has ? values->uvs[2 * (uint64_t)c[i].vt] : 0;
            part->uvs[0][2 * i + 1] = has ? 1 - values->uvs[2 * (uint64_t)c[i].vt + 1] : 0;
        }
        if (part->normals != NULL) {
            if (c[i].vn != SVO_NONE) memcpy(part->normals + 3 * i, values->normals + 3 * (uint64_t)c[i].vn, 3 * sizeof(float));
            else memset(part->normals + 3 * i, 0, 3 * sizeof(float));
        }
        if (part->colors == NULL) continue;
        for (uint64_t k = 0; k < 3; k++) {
            float v = c[i].v < b->color_count ? color[3 * (uint64_t)c[i].v + k] : 1;
            bad_color |= !isfinite(v);
            part->colors[4 * i + k] = c[i].v < b->color_count ? import_srgb_to_linear((double)(v * scale)) : 1;
        }
        part->colors[4 * i + 3] = 1;
    }
    set_flag(&j->bad_color, bad_color);
    return SVO_OK;
}

static svo_result fill_part(builder *b, group_job *j, svo_error *err)
{
    const svo_allocator *a = b->context->allocator;
    svo_part *part = j->part;
    uint64_t n = b->corners.size / sizeof(obj_corner);
    bool colors = b->color_count != 0;
    part->material = j->group->resolved;
    part->vertex_count = n;
    part->triangle_count = b->triangles.size / (3 * sizeof(uint32_t));
    part->positions = svo_alloc(a, n, 3 * sizeof(double));
    part->indices = svo_alloc(a, part->triangle_count, 3 * sizeof(uint32_t));
    if (j->has_uv) part->uvs[0] = svo_alloc(a, n, 2 * sizeof(float));
    if (j->has_normal) part->normals = svo_alloc(a, n, 3 * sizeof(float));
    if (colors) part->colors = svo_alloc(a, n, 4 * sizeof(float));
    if (part->positions == NULL || part->indices == NULL || (j->has_uv && part->uvs[0] == NULL) || (j->has_normal && part->normals == NULL) ||
        (colors && part->colors == NULL))
        return import_no_memory(err);
    memcpy(part->indices, b->triangles.data, (size_t)part->triangle_count * 3 * sizeof(uint32_t));
    return svo_parallel_for(b->context->threads, n, GRAIN, fill_block, j, err);
}

static svo_result build_part(builder *b, obj_group *g, uint32_t number, svo_part *part, svo_error *err)
{
    group_job j = {.b = b, .group = g, .part = part};
    uint32_t threads = b->context->threads;
    SVO_TRY(svo_parallel_for(threads, g->corner_count, GRAIN, check_block, &j, err));
    SVO_TRY(svo_parallel_for(threads, g->face_count, GRAIN, check_sizes, &j, err));
    SVO_TRY(cut_polygons(b, &j, err));
    SVO_TRY(unify(b, &j, number, err));
    SVO_TRY(fill_part(b, &j, err));
    b->bad_uv |= j.bad_uv;
    b->bad_normal |= j.bad_normal;
    b->bad_color |= j.bad_color;
    return SVO_OK;
}

uint32_t obj_find_material(const mtl_set *set, const char *name)
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
    const svo_allocator *a = b->context->allocator;
    for (uint32_t i = 0; i < groups; i++) {
        obj_group *g = &group[i];
        if (g->face_count == 0) continue;
        if (g->material != NULL) {
            g->resolved = obj_find_material(materials, g->material);
            if (g->resolved == SVO_NONE)
                svo_warn(b->context->warnings, "%s: material '%.80s' is not defined; it is white", b->context->path, g->material);
        }
        svo_part part = {0};
        svo_result r = build_part(b, g, i, &part, err);
        if (r == SVO_OK && svo_buffer_append(parts, &part, sizeof part) == NULL) r = import_no_memory(err);
        if (r != SVO_OK) {
            import_part_free(a, &part);
            return r;
        }
        svo_free(a, g->corners, g->corner_count, sizeof *g->corners);
        svo_free(a, g->sizes, g->face_count, sizeof *g->sizes);
        g->corners = NULL, g->sizes = NULL;
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
    b.position_count = f->values.count[OBJ_V];
    b.uv_count = f->values.count[OBJ_VT];
    b.normal_count = f->values.count[OBJ_VN];
    b.color_count = f->color_count;
    svo_buffer parts, *all[] = {&b.corners, &b.chain, &b.triangles, &b.polygon, &b.scratch, &b.local, &parts};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_init(all[i], a);
    svo_result r = SVO_OK;
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
