#include "import_soup.h"

#include <math.h>
#include <string.h>

void soup_init(import_soup *s, const import_context *c)
{
    memset(s, 0, sizeof *s);
    svo_buffer *all[] = {&s->positions, &s->normals, &s->uvs, &s->colors, &s->corners, &s->sizes,
                         &s->corner_uvs, &s->face_colors, &s->face_images, &s->images};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_init(all[i], c->allocator);
}

void soup_free(import_soup *s)
{
    char **name = (char **)(void *)s->images.data;
    if (s->store != NULL) {
        const svo_allocator *a = s->store->c->allocator;
        store_free(s->store);
        svo_free(a, s->store, 1, sizeof *s->store);
    }
    for (size_t i = 0; i < s->images.size / sizeof *name; i++) svo_string_free(s->images.allocator, name[i]);
    svo_buffer *all[] = {&s->positions, &s->normals, &s->uvs, &s->colors, &s->corners, &s->sizes,
                         &s->corner_uvs, &s->face_colors, &s->face_images, &s->images};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_free(all[i]);
}

uint64_t soup_vertex_count(const import_soup *s)
{
    return s->positions.size / (3 * sizeof(double)) + (s->store != NULL ? s->store->count[STORE_POSITIONS] : 0);
}

svo_result soup_spill(import_soup *s, const import_context *c, svo_error *err)
{
    s->store = svo_calloc(c->allocator, 1, sizeof *s->store);
    if (s->store == NULL) return import_no_memory(err);
    store_init(s->store, c, 4);
    return SVO_OK;
}

svo_result soup_flush(import_soup *s, svo_error *err)
{
    if (s->store == NULL) return SVO_OK;
    svo_buffer *values[STORE_ARRAYS] = {&s->positions, &s->normals, &s->uvs, &s->colors};
    for (int i = 0; i < STORE_ARRAYS; i++) {
        SVO_TRY(store_values(s->store, i, values[i]->data, values[i]->size / s->store->width[i], err));
        values[i]->size = 0;
    }
    store_faces f = {.per_corner = 1, .corners = (const uint32_t *)(const void *)s->corners.data, .sizes = (const uint32_t *)(const void *)s->sizes.data};
    f.corner_count = s->corners.size / sizeof(uint32_t);
    f.face_count = s->sizes.size / sizeof(uint32_t);
    if (s->corner_uvs.size != 0) f.uvs = (const float *)(const void *)s->corner_uvs.data;
    if (s->face_colors.size != 0) f.colors = (const float *)(const void *)s->face_colors.data;
    if (s->face_images.size > 0 && s->images.size > sizeof(char *)) f.images = (const uint32_t *)(const void *)s->face_images.data;
    for (uint64_t i = 0; f.colors != NULL && i < f.face_count && !s->any_face_color; i++) s->any_face_color = !isnan(f.colors[4 * i]);
    s->any_corner_uvs |= f.uvs != NULL;
    s->any_face_images |= f.images != NULL;
    SVO_TRY(store_add_faces(s->store, &f, err));
    s->corners.size = s->sizes.size = s->corner_uvs.size = s->face_colors.size = s->face_images.size = 0;
    return SVO_OK;
}

typedef struct soup_builder {
    import_soup *s;
    const import_context *c;
    bool unshared, face_colors, triangular; /* triangular: no face has more than three corners */
    svo_buffer triangles; /* uint32_t: corner numbers */
    svo_buffer polygon, scratch;
    bool fanned;
} soup_builder;

/* Corner numbers of the triangles of faces with this image (SVO_NONE: all faces). */
static svo_result cut(soup_builder *b, uint32_t image, svo_error *err)
{
    const uint32_t *size = (const uint32_t *)(void *)b->s->sizes.data, *corner = (const uint32_t *)(void *)b->s->corners.data;
    const uint32_t *face_image = (const uint32_t *)(void *)b->s->face_images.data;
    const double *position = (const double *)(void *)b->s->positions.data;
    uint64_t faces = b->s->sizes.size / sizeof *size, base = 0;
    b->triangles.size = 0;
    for (uint64_t f = 0; f < faces; base += size[f], f++) {
        uint32_t n = size[f];
        if (image != SVO_NONE && face_image[f] != image) continue;
        uint32_t *out = svo_buffer_append(&b->triangles, NULL, (size_t)(n - 2) * 3 * sizeof *out);
        if (out == NULL) return import_no_memory(err);
        if (n == 3) {
            for (uint32_t k = 0; k < 3; k++) out[k] = (uint32_t)base + k;
            continue;
        }
        b->polygon.size = 0;
        double *p = svo_buffer_append(&b->polygon, NULL, (size_t)n * 3 * sizeof *p);
        if (p == NULL) return import_no_memory(err);
        for (uint32_t k = 0; k < n; k++) memcpy(p + 3 * (size_t)k, position + 3 * (uint64_t)corner[base + k], 3 * sizeof *p);
        SVO_TRY(import_triangulate(p, n, out, &b->scratch, &b->fanned, err));
        for (size_t k = 0; k < 3 * (size_t)(n - 2); k++) out[k] += (uint32_t)base;
    }
    return SVO_OK;
}

static svo_result make_arrays(soup_builder *b, svo_part *part, bool uvs, svo_error *err)
{
    const svo_allocator *a = b->c->allocator;
    uint64_t n = part->vertex_count;
    bool normals = b->s->normals.size != 0, colors = b->s->colors.size != 0 || b->face_colors;
    part->positions = svo_alloc(a, n, 3 * sizeof(double));
    part->indices = svo_alloc(a, part->triangle_count, 3 * sizeof(uint32_t));
    if (normals) part->normals = svo_alloc(a, n, 3 * sizeof(float));
    if (uvs) part->uvs[0] = svo_alloc(a, n, 2 * sizeof(float));
    if (colors) part->colors = svo_alloc(a, n, 4 * sizeof(float));
    bool ok = part->positions != NULL && part->indices != NULL && (!normals || part->normals != NULL) &&
              (!uvs || part->uvs[0] != NULL) && (!colors || part->colors != NULL);
    return ok ? SVO_OK : import_no_memory(err);
}

/* Vertices as in the file: the soup's arrays become the part's. */
static svo_result shared_part(soup_builder *b, svo_part *part, svo_error *err)
{
    import_soup *s = b->s;
    const uint32_t *corner = (const uint32_t *)(void *)s->corners.data, *t = (const uint32_t *)(void *)b->triangles.data;
    uint64_t vertices = soup_vertex_count(s), count;
    void *array;
    part->vertex_count = vertices;
    if (b->triangular) {
        SVO_TRY(import_exact(&s->corners, 3 * sizeof *t, &array, &part->triangle_count, err));
        part->indices = array;
    } else {
        uint64_t triangles = b->triangles.size / (3 * sizeof *t);
        part->indices = svo_alloc(b->c->allocator, triangles, 3 * sizeof *t);
        if (part->indices == NULL) return import_no_memory(err);
        part->triangle_count = triangles;
        for (uint64_t i = 0; i < 3 * triangles; i++) part->indices[i] = corner[t[i]];
    }
    SVO_TRY(import_exact(&s->positions, 3 * sizeof(double), &array, &count, err));
    part->positions = array;
    SVO_TRY(import_exact(&s->normals, 3 * sizeof(float), &array, &count, err));
    part->normals = array;
    SVO_TRY(import_exact(&s->uvs, 2 * sizeof(float), &array, &count, err));
    part->uvs[0] = array;
    SVO_TRY(import_exact(&s->colors, 4 * sizeof(float), &array, &count, err));
    part->colors = array;
    return SVO_OK;
}

/* The face of each corner, for colours of faces. */
static svo_result corner_faces(soup_builder *b, svo_buffer *to, svo_error *err)
{
    const uint32_t *size = (const uint32_t *)(void *)b->s->sizes.data;
    uint32_t *face = svo_buffer_append(to, NULL, b->s->corners.size);
    if (face == NULL) return import_no_memory(err);
    for (uint32_t f = 0; f < b->s->sizes.size / sizeof *size; f++)
        for (uint32_t k = 0; k < size[f]; k++) *face++ = f;
    return SVO_OK;
}

/* One vertex a triangle corner. */
static svo_result unshared_part(soup_builder *b, const uint32_t *face, svo_part *part, svo_error *err)
{
    const import_soup *s = b->s;
    const uint32_t *corner = (const uint32_t *)(void *)s->corners.data, *t = (const uint32_t *)(void *)b->triangles.data;
    bool corner_uvs = s->corner_uvs.size != 0;
    part->triangle_count = b->triangles.size / (3 * sizeof *t);
    part->vertex_count = 3 * part->triangle_count;
    if (part->vertex_count >= SVO_NONE) return svo_fail(err, SVO_LIMIT, "%s: more than 2^32 corners", b->c->path);
    SVO_TRY(make_arrays(b, part, corner_uvs || s->uvs.size != 0, err));
    for (uint64_t i = 0; i < part->vertex_count; i++) {
        uint64_t from = t[i], v = corner[t[i]];
        part->indices[i] = (uint32_t)i;
        memcpy(part->positions + 3 * i, s->positions.data + v * 3 * sizeof(double), 3 * sizeof(double));
        if (part->normals != NULL) memcpy(part->normals + 3 * i, s->normals.data + v * 3 * sizeof(float), 3 * sizeof(float));
        if (part->uvs[0] != NULL) {
            const uint8_t *uv = corner_uvs ? s->corner_uvs.data + from * 2 * sizeof(float) : s->uvs.data + v * 2 * sizeof(float);
            memcpy(part->uvs[0] + 2 * i, uv, 2 * sizeof(float));
        }
        if (part->colors != NULL) {
            const uint8_t *c = b->face_colors ? s->face_colors.data + (uint64_t)face[from] * 4 * sizeof(float)
                                              : s->colors.data + v * 4 * sizeof(float);
            memcpy(part->colors + 4 * i, c, 4 * sizeof(float));
        }
    }
    return SVO_OK;
}

/* A material for each texture file. */
static svo_result make_materials(soup_builder *b, svo_mesh *mesh, svo_error *err)
{
    char **name = (char **)(void *)b->s->images.data;
    uint32_t n = (uint32_t)(b->s->images.size / sizeof *name);
    if (n == 0) return SVO_OK;
    mesh->materials = svo_alloc(b->c->allocator, n, sizeof(svo_material));
    if (mesh->materials == NULL) return import_no_memory(err);
    mesh->material_count = n;
    for (uint32_t i = 0; i < n; i++) mesh->materials[i] = svo_material_default();
    import_images images;
    import_images_init(&images, b->c);
    svo_result r = SVO_OK;
    for (uint32_t i = 0; i < n && r == SVO_OK; i++) {
        svo_material *m = &mesh->materials[i];
        m->double_sided = true;
        m->name = svo_string_copy(b->c->allocator, name[i]);
        r = m->name == NULL ? import_no_memory(err) : b->c->without & FMT_WITHOUT_COLOR ? SVO_OK : import_image_find(&images, b->c, name[i], false, &m->base_color_texture.image, err);
    }
    if (r == SVO_OK) r = import_images_finish(&images, mesh, err);
    import_images_free(&images);
    return r;
}

static svo_result make_parts(soup_builder *b, svo_buffer *parts, svo_error *err)
{
    import_soup *s = b->s;
    uint32_t images = (uint32_t)(s->images.size / sizeof(char *));
    bool split = s->face_images.size != 0 && images > 1;
    svo_buffer faces;
    svo_buffer_init(&faces, b->c->allocator);
    svo_result r = b->face_colors ? corner_faces(b, &faces, err) : SVO_OK;
    for (uint32_t i = 0; r == SVO_OK && i < (split ? images : 1); i++) {
        svo_part part = {.material = images > 0 ? i : SVO_NONE};
        if (b->triangular && !b->unshared) {
            if (s->sizes.size == 0) continue;
        } else {
            r = cut(b, split ? i : SVO_NONE, err);
            if (r != SVO_OK || b->triangles.size == 0) continue;
        }
        r = b->unshared ? unshared_part(b, (const uint32_t *)(void *)faces.data, &part, err) : shared_part(b, &part, err);
        if (r == SVO_OK && svo_buffer_append(parts, &part, sizeof part) == NULL) r = import_no_memory(err);
        if (r != SVO_OK) import_part_free(b->c->allocator, &part);
    }
    svo_buffer_free(&faces);
    return r;
}

/* The mesh of what is in the store. */
static svo_result build_spilled(soup_builder *b, svo_mesh *mesh, svo_error *err)
{
    import_soup *s = b->s;
    import_store *store = s->store;
    const svo_allocator *a = b->c->allocator;
    uint32_t images = (uint32_t)(s->images.size / sizeof(char *)), count = s->any_face_images ? images : 1, used = 0;
    bool uvs[SVO_MAX_UV_SETS] = {s->any_corner_uvs || store->count[STORE_UVS] != 0};
    store->use_face_colors = s->any_face_color && store->count[STORE_COLORS] == 0;
    const svo_soup_layout layout = svo_soup_layout_make(store->wide, store->count[STORE_NORMALS] != 0, uvs, store->use_face_colors || store->count[STORE_COLORS] != 0);
    svo_part *all = svo_calloc(a, count, sizeof *all), *kept = NULL;
    svo_soup_layout *layouts = svo_alloc(a, count, sizeof *layouts);
    svo_result r = all != NULL && layouts != NULL ? SVO_OK : import_no_memory(err);
    for (uint32_t i = 0; r == SVO_OK && i < count; i++) {
        all[i].material = images > 0 ? i : SVO_NONE;
        layouts[i] = layout;
    }
    if (r == SVO_OK) r = store_resolve(store, all, layouts, count, err);
    b->fanned = store->fanned;
    for (uint32_t i = 0; r == SVO_OK && i < count; i++) used += all[i].triangle_count != 0;
    if (r == SVO_OK && used != 0 && (kept = svo_calloc(a, used, sizeof *kept)) == NULL) r = import_no_memory(err);
    for (uint32_t i = 0, k = 0; all != NULL && i < count; i++) {
        if (r == SVO_OK && all[i].triangle_count != 0) kept[k++] = all[i];
        else import_part_free(a, &all[i]);
    }
    svo_free(a, all, count, sizeof *all);
    svo_free(a, layouts, count, sizeof *layouts);
    return r == SVO_OK ? import_single_shape(b->c, kept, used, mesh, err) : r;
}

svo_result soup_build(import_soup *s, const import_context *c, svo_mesh *mesh, svo_error *err)
{
    soup_builder b = {.s = s, .c = c};
    svo_buffer parts;
    svo_buffer_init(&b.triangles, c->allocator);
    svo_buffer_init(&b.polygon, c->allocator);
    svo_buffer_init(&b.scratch, c->allocator);
    svo_buffer_init(&parts, c->allocator);
    if (s->store != NULL) {
        svo_result spilled = soup_flush(s, err);
        if (s->short_faces) svo_warn(c->warnings, "%s: faces with fewer than three corners are left out", c->path);
        if (spilled == SVO_OK) spilled = make_materials(&b, mesh, err);
        if (spilled == SVO_OK) spilled = build_spilled(&b, mesh, err);
        if (b.fanned) svo_warn(c->warnings, "%s: some polygons cross themselves; they were cut as fans", c->path);
        return spilled;
    }
    b.face_colors = s->face_colors.size != 0 && s->colors.size == 0;
    b.unshared = b.face_colors || s->corner_uvs.size != 0 || s->face_images.size != 0;
    const uint32_t *size = (const uint32_t *)(const void *)s->sizes.data;
    b.triangular = true;
    for (uint64_t i = 0; i < s->sizes.size / sizeof *size; i++) b.triangular &= size[i] == 3;
    if (s->short_faces) svo_warn(c->warnings, "%s: faces with fewer than three corners are left out", c->path);
    svo_result r = s->corners.size / sizeof(uint32_t) < SVO_NONE ? SVO_OK : svo_fail(err, SVO_LIMIT, "%s: more than 2^32 corners", c->path);
    if (r == SVO_OK) r = make_materials(&b, mesh, err);
    if (r == SVO_OK) r = make_parts(&b, &parts, err);
    if (b.fanned) svo_warn(c->warnings, "%s: some polygons cross themselves; they were cut as fans", c->path);
    uint64_t count = 0;
    void *list = NULL;
    if (r == SVO_OK) r = import_exact(&parts, sizeof(svo_part), &list, &count, err);
    if (r == SVO_OK) r = import_single_shape(c, list, (uint32_t)count, mesh, err);
    svo_part *part = (svo_part *)(void *)parts.data;
    for (size_t i = 0; i < parts.size / sizeof *part; i++) import_part_free(c->allocator, &part[i]);
    svo_buffer_free(&b.triangles);
    svo_buffer_free(&b.polygon);
    svo_buffer_free(&b.scratch);
    svo_buffer_free(&parts);
    return r;
}
