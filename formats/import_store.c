#include "import_store.h"

#include <math.h>
#include <string.h>

#include "svo_task.h"

enum {
    CORNER_COST = 160,          /* bytes of memory a corner that is resolved takes, about */
    LEAST_CORNERS = 1 << 12,
    WINDOW = 1 << 18,           /* bytes of a vertex array read at a time */
    RECORDS = 4096              /* triangles written at a time */
};

typedef struct store_piece {
    uint64_t offset, corner_count, face_count;
    uint32_t part, per_corner;
    bool sizes, uvs, colors, images;
} store_piece;

void store_init(import_store *s, const import_context *c, uint32_t color_width)
{
    memset(s, 0, sizeof *s);
    s->c = c;
    s->width[STORE_POSITIONS] = 24;
    s->width[STORE_NORMALS] = 12;
    s->width[STORE_UVS] = 8;
    s->width[STORE_COLORS] = 4 * color_width;
    s->vertex_scale = s->face_scale = 1;
    s->corners_at_a_time = c->memory / 4 / CORNER_COST;
    if (s->corners_at_a_time < LEAST_CORNERS) s->corners_at_a_time = LEAST_CORNERS;
    svo_buffer_init(&s->pieces, c->allocator);
}

void store_free(import_store *s)
{
    for (int i = 0; i < STORE_ARRAYS; i++) svo_spill_close(&s->array[i]);
    svo_spill_close(&s->faces);
    svo_buffer_free(&s->pieces);
}

static svo_result append(import_store *s, svo_spill_file *f, const void *bytes, uint64_t size, svo_error *err)
{
    if (size == 0) return SVO_OK;
    if (f->spill == NULL) SVO_TRY(svo_spill_open(s->c->spill, f, err));
    return svo_spill_append(f, bytes, size, err);
}

static void most(float *to, const float *c, uint64_t count, uint32_t width)
{
    for (uint64_t i = 0; i < count; i++)
        for (uint32_t k = 0; k < 3; k++)
            if (c[width * i + k] > *to) *to = c[width * i + k];
}

svo_result store_values(import_store *s, int array, const void *values, uint64_t count, svo_error *err)
{
    if (array == STORE_POSITIONS) {
        const double *v = values;
        for (uint64_t i = 0; i < 3 * count && !s->wide; i++) s->wide = v[i] == v[i] && (double)(float)v[i] != v[i];
    }
    if (array == STORE_COLORS) most(&s->most_vertex, values, count, s->width[array] / 4);
    SVO_TRY(append(s, &s->array[array], values, count * s->width[array], err));
    s->count[array] += count;
    return SVO_OK;
}

svo_result store_add_faces(import_store *s, const store_faces *f, svo_error *err)
{
    if (f->colors != NULL) most(&s->most_face, f->colors, f->face_count, 4);
    uint64_t corner = 0;
    for (uint64_t face = 0; face < f->face_count;) {
        store_piece p = {.offset = s->faces.size, .part = f->part, .per_corner = f->per_corner, .uvs = f->uvs != NULL, .colors = f->colors != NULL,
                         .images = f->images != NULL};
        uint64_t first = face, corners = 0;
        while (face < f->face_count && (corners == 0 || corners + f->sizes[face] <= s->corners_at_a_time)) {
            p.sizes |= f->sizes[face] != 3;
            corners += f->sizes[face++];
        }
        p.corner_count = corners;
        p.face_count = face - first;
        SVO_TRY(append(s, &s->faces, f->corners + f->per_corner * corner, corners * f->per_corner * 4, err));
        if (p.sizes) SVO_TRY(append(s, &s->faces, f->sizes + first, p.face_count * 4, err));
        if (p.uvs) SVO_TRY(append(s, &s->faces, f->uvs + 2 * corner, corners * 8, err));
        if (p.colors) SVO_TRY(append(s, &s->faces, f->colors + 4 * first, p.face_count * 16, err));
        if (p.images) SVO_TRY(append(s, &s->faces, f->images + first, p.face_count * 4, err));
        if (svo_buffer_append(&s->pieces, &p, sizeof p) == NULL) return import_no_memory(err);
        corner += corners;
    }
    return SVO_OK;
}

/* --- resolving ------------------------------------------------------------------------------------------------ */

typedef struct resolver {
    import_store *s;
    svo_buffer corners, sizes, uvs, colors, images; /* of the piece, as stored */
    svo_buffer values[STORE_ARRAYS];                /* of its corners */
    svo_buffer keys, other;                         /* uint64_t: index << 32 | corner, sorted */
    svo_buffer window, triangles, faces, scratch, records;
    svo_soup_file *file;
} resolver;

static bool resize(svo_buffer *b, uint64_t size)
{
    b->size = 0;
    return size == 0 || svo_buffer_append(b, NULL, (size_t)size) != NULL;
}

static svo_result load(resolver *r, svo_buffer *to, uint64_t *offset, uint64_t size, svo_error *err)
{
    if (!resize(to, size)) return import_no_memory(err);
    SVO_TRY(svo_spill_read(&r->s->faces, *offset, to->data, size, err));
    *offset += size;
    return SVO_OK;
}

/* By the upper 32 bits, least digits first; stable. */
static uint64_t *sort_keys(uint64_t *a, uint64_t *b, uint64_t n)
{
    enum { BITS = 11, DIGITS = 3 };
    for (int d = 0; d < DIGITS; d++) {
        uint64_t at[1 << BITS] = {0};
        const int shift = 32 + BITS * d;
        for (uint64_t i = 0; i < n; i++) at[a[i] >> shift & ((1 << BITS) - 1)]++;
        uint64_t sum = 0;
        for (uint32_t i = 0; i < 1 << BITS; i++) {
            uint64_t c = at[i];
            at[i] = sum;
            sum += c;
        }
        for (uint64_t i = 0; i < n; i++) b[at[a[i] >> shift & ((1 << BITS) - 1)]++] = a[i];
        uint64_t *swap = a;
        a = b;
        b = swap;
    }
    return a;
}

/* values[array][corner] = the stored element number index[stride * corner], or zeros where there is none such. */
static svo_result gather(resolver *r, int array, const uint32_t *index, uint32_t stride, uint64_t n, svo_error *err)
{
    const uint32_t width = r->s->width[array];
    const uint64_t count = r->s->count[array], at_a_time = WINDOW / width;
    /* A colour that is not there: a pattern that no file gives. */
    if (!resize(&r->values[array], n * width) || !resize(&r->keys, n * 8) || !resize(&r->other, n * 8) || !resize(&r->window, WINDOW)) return import_no_memory(err);
    if (array == STORE_COLORS && n != 0) memset(r->values[array].data, 0xff, (size_t)(n * width));
    uint64_t *keys = (uint64_t *)(void *)r->keys.data, used = 0;
    for (uint64_t i = 0; i < n; i++)
        if (index[stride * i] < count) keys[used++] = (uint64_t)index[stride * i] << 32 | i;
    keys = sort_keys(keys, (uint64_t *)(void *)r->other.data, used);
    uint64_t begin = 0, end = 0; /* elements in the window */
    for (uint64_t i = 0; i < used; i++) {
        uint64_t element = keys[i] >> 32;
        if (element >= end) {
            /* As far as the keys go without a gap that is worth skipping. */
            uint64_t last = element, k = i;
            while (k < used && (keys[k] >> 32) < element + at_a_time && (keys[k] >> 32) - last < 512) last = keys[k++] >> 32;
            begin = element;
            end = last + 1;
            SVO_TRY(svo_spill_read(&r->s->array[array], begin * width, r->window.data, (end - begin) * width, err));
        }
        memcpy(r->values[array].data + (keys[i] & UINT32_MAX) * width, r->window.data + (element - begin) * width, width);
    }
    return SVO_OK;
}

static void convert_color(const resolver *r, const float *from, uint32_t width, double scale, float to[4])
{
    import_store *s = r->s;
    static const uint8_t missing[4] = {0xff, 0xff, 0xff, 0xff};
    if (memcmp(from, missing, sizeof missing) == 0) {
        to[0] = to[1] = to[2] = to[3] = 1;
        return;
    }
    for (uint32_t k = 0; k < 3; k++) {
        s->bad_color |= !isfinite(from[k]);
        to[k] = import_srgb_to_linear(width == 3 ? (double)(from[k] * (float)(1 / scale)) : (double)from[k] / scale);
    }
    double alpha = width == 3 ? 1 : (double)from[3] / scale;
    to[3] = alpha < 0 ? 1 : alpha <= 1 ? (float)alpha : 1;
}

/* Corner numbers of all triangles, and the face of each triangle. */
static svo_result cut_faces(resolver *r, const store_piece *p, svo_error *err)
{
    uint64_t triangles = p->corner_count - 2 * p->face_count;
    if (!resize(&r->triangles, triangles * 12) || !resize(&r->faces, triangles * 4)) return import_no_memory(err);
    uint32_t *out = (uint32_t *)(void *)r->triangles.data, *face = (uint32_t *)(void *)r->faces.data;
    const uint32_t *sizes = (const uint32_t *)(const void *)r->sizes.data;
    const double *positions = (const double *)(const void *)r->values[STORE_POSITIONS].data;
    uint32_t base = 0;
    for (uint32_t f = 0; f < p->face_count; f++) {
        uint32_t n = p->sizes ? sizes[f] : 3;
        SVO_TRY(import_triangulate(positions + 3 * (uint64_t)base, n, out, &r->scratch, &r->s->fanned, err));
        for (uint32_t k = 0; k < 3 * (n - 2); k++) *out++ += base;
        for (uint32_t k = 0; k < n - 2; k++) *face++ = f;
        base += n;
    }
    return SVO_OK;
}

static uint8_t *put_record(const resolver *r, const store_piece *p, const svo_soup_layout *l, const uint32_t corner[3], uint32_t face, uint8_t *to)
{
    for (int k = 0; k < 3; k++) {
        const double *v = (const double *)(const void *)r->values[STORE_POSITIONS].data + 3 * (uint64_t)corner[k];
        float f[3] = {(float)v[0], (float)v[1], (float)v[2]};
        size_t n = l->wide ? 24 : 12;
        memcpy(to, l->wide ? (const void *)v : f, n);
        to += n;
    }
    for (int k = 0; k < 3 && l->normals; k++, to += 12) memcpy(to, r->values[STORE_NORMALS].data + 12 * (uint64_t)corner[k], 12);
    for (int k = 0; k < 3 && l->uvs[0]; k++, to += 8) {
        const uint8_t *from = p->uvs ? r->uvs.data : r->values[STORE_UVS].data;
        memcpy(to, from + 8 * (uint64_t)corner[k], 8);
    }
    for (int k = 0; k < 3 && l->colors; k++, to += 16) {
        const bool of_face = p->colors && r->s->use_face_colors;
        const uint32_t width = of_face ? 4 : r->s->width[STORE_COLORS] / 4;
        const float *from = (const float *)(const void *)(of_face ? r->colors.data + 16 * (uint64_t)face : r->values[STORE_COLORS].data + 4 * width * (uint64_t)corner[k]);
        float c[4];
        convert_color(r, from, width, of_face ? r->s->face_scale : r->s->vertex_scale, c);
        memcpy(to, c, 16);
    }
    return to;
}

/* The triangles of the piece that belong to one part (image SVO_NONE: all). */
static svo_result emit(resolver *r, const store_piece *p, uint32_t image, svo_part *part, const svo_soup_layout *l, svo_error *err)
{
    const uint32_t *corner = (const uint32_t *)(const void *)r->triangles.data, *face = (const uint32_t *)(const void *)r->faces.data;
    const uint32_t *images = (const uint32_t *)(const void *)r->images.data;
    uint64_t triangles = r->triangles.size / 12, count = 0;
    if (!resize(&r->records, (uint64_t)RECORDS * l->stride)) return import_no_memory(err);
    uint8_t *to = r->records.data;
    for (uint64_t t = 0; t < triangles; t++) {
        if (image != SVO_NONE && images[face[t]] != image) continue;
        to = put_record(r, p, l, corner + 3 * t, face[t], to);
        if (++count < RECORDS) continue;
        SVO_TRY(svo_soup_append(part, r->file, l, r->s->c->allocator, r->records.data, count, err));
        to = r->records.data;
        count = 0;
    }
    return svo_soup_append(part, r->file, l, r->s->c->allocator, r->records.data, count, err);
}

static svo_result resolve_piece(resolver *r, const store_piece *p, svo_part *parts, const svo_soup_layout *layouts, uint32_t part_count, svo_error *err)
{
    import_store *s = r->s;
    uint64_t offset = p->offset;
    SVO_TRY(load(r, &r->corners, &offset, p->corner_count * p->per_corner * 4, err));
    SVO_TRY(load(r, &r->sizes, &offset, p->sizes ? p->face_count * 4 : 0, err));
    SVO_TRY(load(r, &r->uvs, &offset, p->uvs ? p->corner_count * 8 : 0, err));
    SVO_TRY(load(r, &r->colors, &offset, p->colors ? p->face_count * 16 : 0, err));
    SVO_TRY(load(r, &r->images, &offset, p->images ? p->face_count * 4 : 0, err));
    svo_spill_discard(&s->faces, p->offset, offset - p->offset);
    const uint32_t *index = (const uint32_t *)(const void *)r->corners.data, stride = p->per_corner;
    for (uint64_t i = 0; i < p->corner_count; i++)
        if (index[stride * i] >= s->count[STORE_POSITIONS])
            return svo_fail(err, SVO_INVALID_DATA, "%s: a face refers to vertex %lu of %llu", s->c->path, (unsigned long)index[stride * i] + 1,
                            (unsigned long long)s->count[STORE_POSITIONS]);
    bool normals = false, uvs = false, colors = false;
    for (uint32_t i = 0; i < part_count; i++)
        if (p->images || i == p->part) normals |= layouts[i].normals, uvs |= layouts[i].uvs[0], colors |= layouts[i].colors;
    SVO_TRY(gather(r, STORE_POSITIONS, index, stride, p->corner_count, err));
    if (normals) SVO_TRY(gather(r, STORE_NORMALS, stride == 3 ? index + 2 : index, stride, p->corner_count, err));
    if (uvs && !p->uvs) SVO_TRY(gather(r, STORE_UVS, stride == 3 ? index + 1 : index, stride, p->corner_count, err));
    if (colors && !s->use_face_colors) SVO_TRY(gather(r, STORE_COLORS, index, stride, p->corner_count, err));
    SVO_TRY(cut_faces(r, p, err));
    if (!p->images) return emit(r, p, SVO_NONE, &parts[p->part], &layouts[p->part], err);
    for (uint32_t i = 0; i < part_count; i++) SVO_TRY(emit(r, p, i, &parts[i], &layouts[i], err));
    return SVO_OK;
}

svo_result store_resolve(import_store *s, svo_part *parts, const svo_soup_layout *layouts, uint32_t part_count, svo_error *err)
{
    resolver r = {.s = s};
    svo_buffer *all[] = {&r.corners, &r.sizes, &r.uvs, &r.colors, &r.images, &r.values[0], &r.values[1], &r.values[2], &r.values[3],
                         &r.keys, &r.other, &r.window, &r.triangles, &r.faces, &r.scratch, &r.records};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_init(all[i], s->c->allocator);
    const store_piece *pieces = (const store_piece *)(const void *)s->pieces.data;
    uint64_t count = s->pieces.size / sizeof *pieces;
    svo_result result = count != 0 ? svo_soup_file_create(s->c->spill, s->c->allocator, &r.file, err) : SVO_OK;
    for (uint64_t i = 0; result == SVO_OK && i < count; i++) result = resolve_piece(&r, &pieces[i], parts, layouts, part_count, err);
    svo_soup_file_release(r.file);
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_free(all[i]);
    return result;
}
