/* PLY: ASCII and binary of both byte orders, any elements and properties. */
#include "import_ply.h"

#include <math.h>
#include <string.h>

#include "fmt_container.h"
#include "import_text.h"

static svo_result bad(const ply_reader *r, const ply_element *e, uint64_t row, const char *what, svo_error *err)
{
    return svo_fail(err, SVO_INVALID_DATA, "%s: PLY element %s %llu: %s", r->c->path, e->name, (unsigned long long)(r->first_row + row), what);
}

static bool read_value(ply_reader *r, ply_type type, double *v)
{
    if (r->ascii) {
        const char *end = (const char *)r->end, *p = import_skip_space((const char *)r->p, end);
        const char *after = p < end ? import_double(p, end, v) : NULL;
        if (after == NULL) return false;
        r->p = (const uint8_t *)after;
        return true;
    }
    uint32_t n = ply_type_size(type);
    if ((uint64_t)(r->end - r->p) < n) return false;
    *v = ply_load(r->p, type, r->big_endian);
    r->p += n;
    return true;
}

/* A list into r->list; false when it is cut off or its length is impossible. */
static bool read_list(ply_reader *r, const ply_property *q, uint64_t *count, bool *no_memory)
{
    double length;
    if (!read_value(r, q->list, &length) || !(length >= 0) || length != floor(length)) return false;
    uint64_t left = (uint64_t)(r->end - r->p), least = r->ascii ? 2 : ply_type_size(q->type);
    if (length > (double)(left + 1) || (uint64_t)length > (left + 1) / least) return false;
    *count = (uint64_t)length;
    r->list.size = 0;
    double *v = *count != 0 ? svo_buffer_append(&r->list, NULL, (size_t)*count * sizeof *v) : NULL;
    *no_memory = *count != 0 && v == NULL;
    for (uint64_t i = 0; i < *count && !*no_memory; i++)
        if (!read_value(r, q->type, &v[i])) return false;
    return !*no_memory;
}

/* Bytes that one row takes at least, so that counts can be compared with what is left. */
static uint64_t least_row(const ply_reader *r, const ply_element *e)
{
    uint64_t n = 0;
    for (uint32_t i = 0; i < e->property_count; i++) {
        const ply_property *q = &e->properties[i];
        n += r->ascii ? 2 : ply_type_size(q->list != PLY_NONE ? q->list : q->type);
    }
    return n;
}

static bool has(const ply_element *e, ply_use use, ply_type *type)
{
    for (uint32_t i = 0; i < e->property_count; i++)
        if (e->properties[i].use == use) {
            if (type != NULL) *type = e->properties[i].type;
            return true;
        }
    return false;
}

/* What divides a colour value: integers by their range (wider ones hold 0..255 in practice), floats stand for 0..1. */
static double color_scale(ply_type type)
{
    return type == PLY_U16 ? 65535 : ply_is_integer(type) ? 255 : 1;
}

static void colors_to_linear(ply_reader *r, svo_buffer *colors, ply_type type)
{
    if (r->soup.store != NULL) { /* when all have been read */
        *(colors == &r->soup.colors ? &r->soup.store->vertex_scale : &r->soup.store->face_scale) = color_scale(type);
        return;
    }
    float *c = (float *)(void *)colors->data;
    size_t n = colors->size / sizeof *c;
    double scale = color_scale(type);
    for (size_t i = 0; i < n && scale == 1; i++)
        if (i % 4 != 3 && c[i] > 1) {
            scale = 255;
            svo_warn(r->c->warnings, "%s: colours exceed 1; all are taken as 0..255", r->c->path);
        }
    for (size_t i = 0; i < n; i++) {
        double v = (double)c[i] / scale;
        if (i % 4 != 3) c[i] = import_srgb_to_linear(v);
        else c[i] = c[i] < 0 ? 1 : v <= 1 ? (float)v : 1;
    }
}

void ply_warn_extra(const ply_reader *r)
{
    svo_warn(r->c->warnings, "%s: values beyond what the PLY header names are ignored", r->c->path);
}

/* An ASCII row is a line. Some writers put more on it than their header says; that is skipped. */
static void end_row(ply_reader *r)
{
    if (!r->ascii) return;
    const char *end = (const char *)r->end, *p = import_skip_blank((const char *)r->p, end);
    if (p < end && *p != '\n') {
        ply_warn_extra(r);
        const char *stop = memchr(p, '\n', (size_t)(end - p));
        p = stop != NULL ? stop : end;
    }
    r->p = (const uint8_t *)p;
}

static svo_result read_vertices(ply_reader *r, const ply_element *e, svo_error *err)
{
    bool xyz = has(e, PLY_X, NULL) && has(e, PLY_Y, NULL) && has(e, PLY_Z, NULL);
    bool normals = has(e, PLY_NX, NULL) && has(e, PLY_NY, NULL) && has(e, PLY_NZ, NULL);
    bool uvs = has(e, PLY_U, NULL) && has(e, PLY_V, NULL);
    ply_type color = PLY_NONE;
    bool colors = has(e, PLY_R, &color) && has(e, PLY_G, NULL) && has(e, PLY_B, NULL);
    if (!xyz) return svo_fail(err, SVO_INVALID_DATA, "%s: PLY vertices have no x, y and z", r->c->path);
    if (e->count >= SVO_NONE) return svo_fail(err, SVO_LIMIT, "%s: more than 2^32 vertices", r->c->path);
    import_soup *s = &r->soup;
    bool done;
    SVO_TRY(ply_read_fast(r, e, &done, err));
    for (uint64_t row = 0; row < e->count && !done; row++) {
        double v[PLY_VALUES];
        v[PLY_A] = -1; /* none */
        for (uint32_t i = 0; i < e->property_count; i++) {
            const ply_property *q = &e->properties[i];
            double other;
            uint64_t count;
            bool no_memory = false;
            bool ok = q->list != PLY_NONE ? read_list(r, q, &count, &no_memory) : read_value(r, q->type, q->use < PLY_VALUES ? &v[q->use] : &other);
            if (no_memory) return import_no_memory(err);
            if (!ok) return bad(r, e, row, "not a number, or the file ends", err);
        }
        end_row(r);
        float n[3] = {0}, uv[2] = {0}, c[4] = {0};
        if (svo_buffer_append(&s->positions, v, 3 * sizeof *v) == NULL) return import_no_memory(err);
        for (int k = 0; k < 3 && normals; k++) n[k] = (float)v[PLY_NX + k];
        if (normals && svo_buffer_append(&s->normals, n, sizeof n) == NULL) return import_no_memory(err);
        if (uvs) uv[0] = (float)v[PLY_U], uv[1] = 1 - (float)v[PLY_V];
        if (uvs && svo_buffer_append(&s->uvs, uv, sizeof uv) == NULL) return import_no_memory(err);
        for (int k = 0; k < 4 && colors; k++) c[k] = (float)v[PLY_R + k];
        if (colors && svo_buffer_append(&s->colors, c, sizeof c) == NULL) return import_no_memory(err);
    }
    if (colors) colors_to_linear(r, &s->colors, color);
    return SVO_OK;
}

/* What one face row said. */
typedef struct face_row {
    uint64_t corners, uv_values;
    float color[4];
    uint32_t image;
} face_row;

static svo_result read_face_row(ply_reader *r, const ply_element *e, uint64_t row, face_row *f, svo_error *err)
{
    import_soup *s = &r->soup;
    uint64_t vertices = soup_vertex_count(s);
    *f = (face_row){.color = {0, 0, 0, -1}};
    for (uint32_t i = 0; i < e->property_count; i++) {
        const ply_property *q = &e->properties[i];
        double v = 0;
        uint64_t count = 0;
        bool no_memory = false;
        bool ok = q->list != PLY_NONE ? read_list(r, q, &count, &no_memory) : read_value(r, q->type, &v);
        if (no_memory) return import_no_memory(err);
        if (!ok) return bad(r, e, row, "not a number, a list that is too long, or the file ends", err);
        const double *list = (const double *)(void *)r->list.data;
        if (q->use == PLY_INDICES) {
            f->corners = count;
            uint32_t *to = count != 0 ? svo_buffer_append(&s->corners, NULL, (size_t)count * sizeof *to) : NULL;
            if (count != 0 && to == NULL) return import_no_memory(err);
            for (uint64_t k = 0; k < count; k++) {
                if (!(list[k] >= 0) || list[k] >= (double)vertices || list[k] != floor(list[k]))
                    return bad(r, e, row, "refers to a vertex that does not exist", err);
                to[k] = (uint32_t)list[k];
            }
        } else if (q->use == PLY_TEXCOORD) {
            f->uv_values = count;
            float *to = count != 0 ? svo_buffer_append(&s->corner_uvs, NULL, (size_t)count * sizeof *to) : NULL;
            if (count != 0 && to == NULL) return import_no_memory(err);
            for (uint64_t k = 0; k < count; k++) to[k] = k % 2 == 0 ? (float)list[k] : 1 - (float)list[k];
        } else if (q->use == PLY_TEXNUMBER) {
            uint32_t images = (uint32_t)(s->images.size / sizeof(char *));
            f->image = v >= 0 && v < images ? (uint32_t)v : 0;
        } else if (q->use >= PLY_R && q->use <= PLY_A) {
            f->color[q->use - PLY_R] = (float)v;
        }
    }
    end_row(r);
    return SVO_OK;
}

static svo_result read_faces(ply_reader *r, const ply_element *e, svo_error *err)
{
    ply_type color = PLY_NONE;
    bool colors = has(e, PLY_R, &color) && has(e, PLY_G, NULL) && has(e, PLY_B, NULL);
    bool uvs = has(e, PLY_TEXCOORD, NULL), images = has(e, PLY_TEXNUMBER, NULL) && uvs;
    bool indices = has(e, PLY_INDICES, NULL);
    import_soup *s = &r->soup;
    if (!indices && e->count != 0) svo_warn(r->c->warnings, "%s: PLY faces without vertex indices are left out", r->c->path);
    bool done;
    SVO_TRY(ply_read_fast(r, e, &done, err));
    for (uint64_t row = 0; row < e->count && !done; row++) {
        size_t corners = s->corners.size, corner_uvs = s->corner_uvs.size;
        face_row f;
        SVO_TRY(read_face_row(r, e, row, &f, err));
        if (f.corners < 3) { /* a point or an edge */
            s->corners.size = corners;
            s->corner_uvs.size = corner_uvs;
            s->short_faces = s->short_faces || indices;
            continue;
        }
        if (uvs && f.uv_values != 2 * f.corners) { /* none (0), or not in pairs */
            if (f.uv_values != 0) svo_warn(r->c->warnings, "%s: texture coordinates that are not one pair a corner are ignored", r->c->path);
            s->corner_uvs.size = corner_uvs;
            if (svo_buffer_append(&s->corner_uvs, NULL, (size_t)f.corners * 2 * sizeof(float)) == NULL) return import_no_memory(err);
        }
        if (f.corners >= SVO_NONE) return svo_fail(err, SVO_LIMIT, "%s: a face has more than 2^32 corners", r->c->path);
        uint32_t size = (uint32_t)f.corners;
        if (svo_buffer_append(&s->sizes, &size, sizeof size) == NULL ||
            (colors && svo_buffer_append(&s->face_colors, f.color, sizeof f.color) == NULL) ||
            (images && svo_buffer_append(&s->face_images, &f.image, sizeof f.image) == NULL))
            return import_no_memory(err);
    }
    if (colors) colors_to_linear(r, &s->face_colors, color);
    return SVO_OK;
}

static svo_result add_triangle(import_soup *s, const uint32_t t[3], svo_error *err)
{
    uint32_t three = 3;
    bool ok = svo_buffer_append(&s->corners, t, 3 * sizeof *t) != NULL && svo_buffer_append(&s->sizes, &three, sizeof three) != NULL;
    return ok ? SVO_OK : import_no_memory(err);
}

/* Stanford's strips: indices with -1 between strips. */
static svo_result read_strips(ply_reader *r, const ply_element *e, svo_error *err)
{
    uint64_t vertices = soup_vertex_count(&r->soup);
    for (uint64_t row = 0; row < e->count; row++)
        for (uint32_t i = 0; i < e->property_count; i++) {
            const ply_property *q = &e->properties[i];
            uint64_t count = 0;
            double v;
            bool no_memory = false;
            bool ok = q->list != PLY_NONE ? read_list(r, q, &count, &no_memory) : read_value(r, q->type, &v);
            if (no_memory) return import_no_memory(err);
            if (!ok) return bad(r, e, row, "not a number, a list that is too long, or the file ends", err);
            const double *list = (const double *)(void *)r->list.data;
            uint32_t strip[3] = {0};
            uint64_t length = 0;
            for (uint64_t k = 0; q->use == PLY_STRIPS && k < count; k++) {
                if (list[k] == -1) {
                    length = 0;
                    continue;
                }
                if (!(list[k] >= 0) || list[k] >= (double)vertices || list[k] != floor(list[k]))
                    return bad(r, e, row, "refers to a vertex that does not exist", err);
                strip[0] = strip[1], strip[1] = strip[2], strip[2] = (uint32_t)list[k];
                if (++length < 3) continue;
                uint32_t turned[3] = {strip[1], strip[0], strip[2]};
                SVO_TRY(add_triangle(&r->soup, length % 2 == 1 ? strip : turned, err));
            }
        }
    return SVO_OK;
}

static svo_result skip_element(ply_reader *r, const ply_element *e, svo_error *err)
{
    for (uint64_t row = 0; row < e->count && e->property_count != 0; row++)
        for (uint32_t i = 0; i < e->property_count; i++) {
            const ply_property *q = &e->properties[i];
            double v;
            uint64_t count;
            bool no_memory = false;
            bool ok = q->list != PLY_NONE ? read_list(r, q, &count, &no_memory) : read_value(r, q->type, &v);
            if (no_memory) return import_no_memory(err);
            if (!ok) return bad(r, e, row, "not a number, a list that is too long, or the file ends", err);
            if (i + 1 == e->property_count) end_row(r);
        }
    return SVO_OK;
}

/* All rows at once, or in windows that go to the store. */
static svo_result read_rows(ply_reader *r, const ply_element *e, svo_result (*read)(ply_reader *, const ply_element *, svo_error *), svo_error *err)
{
    enum { ROW = 64 }; /* bytes of memory of a usual row */
    if (r->soup.store == NULL || e->count == 0) return read(r, e, err);
    if (e->count >= SVO_NONE && e->kind == PLY_VERTEX) return svo_fail(err, SVO_LIMIT, "%s: more than 2^32 vertices", r->c->path);
    uint64_t rows = r->c->memory / 32 / ROW + 1;
    ply_element window = *e;
    for (r->first_row = 0; r->first_row < e->count; r->first_row += window.count) {
        const uint8_t *begin = r->p;
        window.count = e->count - r->first_row < rows ? e->count - r->first_row : rows;
        SVO_TRY(read(r, &window, err));
        SVO_TRY(soup_flush(&r->soup, err));
        import_forget(r->c, begin, r->p);
    }
    r->first_row = 0;
    return SVO_OK;
}

/* Colours of numbers that are not integers: beyond 1 they are 0..255. */
static void choose_scales(ply_reader *r)
{
    import_store *s = r->soup.store;
    if (s == NULL) return;
    const float most[2] = {s->most_vertex, s->most_face};
    double *scale[2] = {&s->vertex_scale, &s->face_scale};
    for (int i = 0; i < 2; i++) {
        if (*scale[i] != 1 || !(most[i] > 1)) continue;
        *scale[i] = 255;
        svo_warn(r->c->warnings, "%s: colours exceed 1; all are taken as 0..255", r->c->path);
    }
}

static svo_result read_elements(ply_reader *r, svo_error *err)
{
    bool vertices = false, faces = false;
    for (uint32_t i = 0; i < r->element_count; i++) {
        const ply_element *e = &r->elements[i];
        uint64_t least = least_row(r, e), left = (uint64_t)(r->end - r->p) + 1;
        if (least != 0 && e->count > left / least)
            return svo_fail(err, SVO_INVALID_DATA, "%s: the PLY header counts %llu of element %s, more than the file can hold", r->c->path,
                            (unsigned long long)e->count, e->name);
        if ((e->kind == PLY_FACE || e->kind == PLY_TRISTRIPS) && e->count != 0 && !vertices)
            return svo_fail(err, SVO_INVALID_DATA, "%s: PLY faces before vertices", r->c->path);
        switch (e->kind) {
        case PLY_VERTEX: vertices = true; SVO_TRY(read_rows(r, e, read_vertices, err)); break;
        case PLY_FACE: faces = e->count != 0; SVO_TRY(read_rows(r, e, read_faces, err)); break;
        case PLY_TRISTRIPS:
            r->irregular = true;
            if (faces) { /* the same surface twice */
                SVO_TRY(skip_element(r, e, err));
                break;
            }
            SVO_TRY(read_rows(r, e, read_strips, err));
            break;
        case PLY_SKIPPED:
            r->irregular |= r->ascii && e->count != 0;
            SVO_TRY(skip_element(r, e, err));
            break;
        }
    }
    if (r->ascii) r->p = (const uint8_t *)import_skip_space((const char *)r->p, (const char *)r->end);
    if (r->p < r->end) svo_warn(r->c->warnings, "%s: bytes after the last PLY element are ignored", r->c->path);
    return SVO_OK;
}

svo_result import_ply(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    ply_reader *r = svo_calloc(c->allocator, 1, sizeof *r);
    if (r == NULL) return import_no_memory(err);
    r->c = c;
    r->p = bytes;
    r->end = bytes + size;
    soup_init(&r->soup, c);
    svo_buffer_init(&r->list, c->allocator);
    svo_result result = c->spilling ? soup_spill(&r->soup, c, err) : SVO_OK;
    if (result == SVO_OK) result = ply_read_header(r, err);
    r->irregular |= c->spilling && r->ascii; /* rows are read one after the other, so that the text need not stay in memory */
    if (result == SVO_OK) result = read_elements(r, err);
    choose_scales(r);
    if (result == SVO_OK) result = soup_build(&r->soup, c, mesh, err);
    ply_lines_free(r);
    soup_free(&r->soup);
    svo_buffer_free(&r->list);
    svo_free(c->allocator, r, 1, sizeof *r);
    return result;
}
