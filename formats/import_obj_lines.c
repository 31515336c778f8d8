/* Wavefront OBJ, the text. Own parser: correctly rounded doubles, any line length, counts bounded by the bytes. */
#include <string.h>

#include "import_obj.h"
#include "import_text.h"

void obj_block_init(obj_block *b, const import_context *c)
{
    memset(b, 0, sizeof *b);
    b->context = c;
    svo_buffer *all[] = {&b->corners, &b->sizes, &b->colors, &b->events, &b->names, &b->joined};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_init(all[i], c->allocator);
}

void obj_block_free(obj_block *b)
{
    svo_buffer *all[] = {&b->corners, &b->sizes, &b->colors, &b->events, &b->names, &b->joined};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_free(all[i]);
}

static svo_result bad_line(const obj_block *b, uint64_t line, const char *what, svo_error *err)
{
    return svo_fail(err, SVO_INVALID_DATA, "%s:%llu: %s", b->context->path, (unsigned long long)(b->first_line + line), what);
}

static void note(obj_block *b, obj_oddity what)
{
    for (uint32_t i = 0; i < b->odd_count; i++)
        if (b->odd[i] == what) return;
    b->odd[b->odd_count++] = what;
}

static const char *trim_end(const char *p, const char *end)
{
    while (end > p && import_space(end[-1])) end--;
    return end;
}

/* --- lines --- */

typedef svo_result (*line_fn)(obj_block *b, const char *p, const char *end, uint64_t line, svo_error *err);

static inline svo_result each_line(obj_block *b, line_fn fn, svo_error *err)
{
    const char *p = b->begin, *end = b->end;
    uint64_t line = 0;
    for (; p < end; line++) {
        const char *stop = memchr(p, '\n', (size_t)(end - p));
        if (stop == NULL) stop = end;
        const char *last = trim_end(p, stop);
        if (last == p || last[-1] != '\\') {
            SVO_TRY(fn(b, p, stop, line, err));
            p = stop < end ? stop + 1 : end;
            continue;
        }
        /* continued on the next line */
        uint64_t first = line;
        b->joined.size = 0;
        for (;;) {
            bool more = last > p && last[-1] == '\\';
            size_t n = (size_t)(last - p) - (more ? 1 : 0);
            if ((n != 0 && svo_buffer_append(&b->joined, p, n) == NULL) || svo_buffer_append(&b->joined, " ", 1) == NULL)
                return import_no_memory(err);
            p = stop < end ? stop + 1 : end;
            if (!more || p == end) break;
            line++;
            stop = memchr(p, '\n', (size_t)(end - p));
            if (stop == NULL) stop = end;
            last = trim_end(p, stop);
        }
        const char *text = (const char *)b->joined.data;
        SVO_TRY(fn(b, text, text + b->joined.size, first, err));
    }
    b->lines = line;
    return SVO_OK;
}

const char *obj_line_end(const char *begin, const char *p, const char *end)
{
    for (;;) {
        const char *stop = p < end ? memchr(p, '\n', (size_t)(end - p)) : NULL;
        if (stop == NULL) return end;
        const char *last = trim_end(begin, stop);
        /* Trimming may have gone back over empty lines: then this one is empty, and continues nothing. */
        if (last == begin || last[-1] != '\\' || memchr(last, '\n', (size_t)(stop - last)) != NULL) return stop + 1;
        p = stop + 1;
    }
}

/* Which numbers a line gives: OBJ_V, OBJ_VT, OBJ_VN, or OBJ_KINDS. p is its first character, not blank; *rest what follows the word. */
static inline int number_line(const char *p, const char *end, const char **rest)
{
    if (end - p < 2 || *p != 'v') return OBJ_KINDS;
    *rest = p + 2;
    if (import_blank(p[1])) return OBJ_V;
    if (end - p < 3 || !import_blank(p[2])) return OBJ_KINDS;
    *rest = p + 3;
    return p[1] == 't' ? OBJ_VT : p[1] == 'n' ? OBJ_VN : OBJ_KINDS;
}

static svo_result count_line(obj_block *b, const char *p, const char *end, uint64_t line, svo_error *err)
{
    (void)line, (void)err;
    const char *rest;
    p = import_skip_blank(p, end);
    if (p == end) return SVO_OK;
    int kind = number_line(p, end, &rest);
    if (kind != OBJ_KINDS) b->count[kind]++;
    else b->face_lines += *p == 'f';
    return SVO_OK;
}

svo_result obj_block_count(obj_block *b, svo_error *err) { return each_line(b, count_line, err); }

/* Up to max numbers of a line; SVO_NONE when one is not a number. */
static uint32_t read_numbers(const char *p, const char *end, double *v, uint32_t max)
{
    uint32_t n = 0;
    while (n < max) {
        p = import_skip_blank(p, end);
        if (p == end || *p == '#') break;
        p = import_double(p, end, &v[n]);
        if (p == NULL) return SVO_NONE;
        n++;
    }
    return n;
}

static svo_result read_vertex(obj_block *b, const char *p, const char *end, uint64_t line, svo_error *err)
{
    double v[8];
    uint32_t n = read_numbers(p, end, v, 8);
    if (n == SVO_NONE) return bad_line(b, line, "a vertex has something that is not a number", err);
    if (n < 3) return bad_line(b, line, "a vertex has fewer than three coordinates", err);
    uint64_t at = b->done[OBJ_V]++;
    memcpy(b->values->positions + 3 * (b->first[OBJ_V] - b->values->origin[OBJ_V] + at), v, 3 * sizeof *v);
    if (n < 6) return SVO_OK; /* a fourth number is a rational weight, which polygons do not use */
    const double *rgb = v + n - (n == 8 ? 5 : 3);
    for (uint64_t colors = b->colors.size / (3 * sizeof(float)); colors < at; colors++) {
        static const float white[3] = {1, 1, 1};
        if (svo_buffer_append(&b->colors, white, sizeof white) == NULL) return import_no_memory(err);
    }
    float c[3] = {(float)rgb[0], (float)rgb[1], (float)rgb[2]};
    b->large_colors = b->large_colors || rgb[0] > 1 || rgb[1] > 1 || rgb[2] > 1;
    return svo_buffer_append(&b->colors, c, sizeof c) != NULL ? SVO_OK : import_no_memory(err);
}

static svo_result read_floats(obj_block *b, int kind, uint32_t want, uint32_t least, const char *p, const char *end, uint64_t line, svo_error *err)
{
    double v[3] = {0, 0, 0};
    uint32_t n = read_numbers(p, end, v, want);
    if (n == SVO_NONE || n < least) return bad_line(b, line, "a texture coordinate or normal is not made of numbers", err);
    float *to = (kind == OBJ_VT ? b->values->uvs : b->values->normals) + want * (b->first[kind] - b->values->origin[kind] + b->done[kind]++);
    for (uint32_t i = 0; i < want; i++) to[i] = (float)v[i];
    return SVO_OK;
}

/* 1-based or negative (from the last one read) to zero-based. Whether it exists is known at the end of the file only. */
static inline bool index_of(const obj_block *b, int kind, int64_t i, uint32_t *out)
{
    int64_t zero = i > 0 ? i - 1 : (int64_t)(b->first[kind] + b->done[kind]) + i;
    if (i == 0 || zero < 0 || zero >= (int64_t)SVO_NONE) return false;
    *out = (uint32_t)zero;
    return true;
}

/* One "v", "v/vt", "v//vn" or "v/vt/vn"; NULL when it is broken. */
static inline const char *read_corner(const obj_block *b, const char *p, const char *end, obj_corner *c)
{
    int64_t i;
    *c = (obj_corner){SVO_NONE, SVO_NONE, SVO_NONE};
    p = import_integer(p, end, &i);
    if (p == NULL || !index_of(b, OBJ_V, i, &c->v)) return NULL;
    if (p == end || *p != '/') return p;
    p++;
    if (p < end && (import_digit(*p) || *p == '-' || *p == '+')) {
        p = import_integer(p, end, &i);
        if (p == NULL || !index_of(b, OBJ_VT, i, &c->vt)) return NULL;
    }
    if (p == end || *p != '/') return p;
    p++;
    if (p < end && (import_digit(*p) || *p == '-' || *p == '+')) {
        p = import_integer(p, end, &i);
        if (p == NULL || !index_of(b, OBJ_VN, i, &c->vn)) return NULL;
    }
    return p;
}

static svo_result read_face(obj_block *b, const char *p, const char *end, uint64_t line, svo_error *err)
{
    size_t before = b->corners.size;
    uint32_t n = 0;
    for (;;) {
        p = import_skip_blank(p, end);
        if (p == end || *p == '#') break;
        obj_corner c;
        p = read_corner(b, p, end, &c);
        if (p == NULL || (p < end && !import_blank(*p))) return bad_line(b, line, "a face has something that is not a vertex reference", err);
        if (!svo_buffer_reserve(&b->corners, sizeof c)) return import_no_memory(err);
        memcpy(b->corners.data + b->corners.size, &c, sizeof c);
        b->corners.size += sizeof c;
        n++;
    }
    if (n < 3) {
        b->corners.size = before;
        note(b, OBJ_SHORT_FACES);
        return SVO_OK;
    }
    return svo_buffer_append(&b->sizes, &n, sizeof n) != NULL ? SVO_OK : import_no_memory(err);
}

static svo_result add_event(obj_block *b, obj_event_kind kind, const char *name, const char *end, svo_error *err)
{
    obj_event e = {.kind = kind, .name = b->names.size, .length = (size_t)(end - name)};
    e.corners = b->corners.size / sizeof(obj_corner);
    e.faces = b->sizes.size / sizeof(uint32_t);
    bool ok = svo_buffer_append(&b->names, name, e.length) != NULL && svo_buffer_append(&b->events, &e, sizeof e) != NULL;
    return ok ? SVO_OK : import_no_memory(err);
}

static svo_result read_line(obj_block *b, const char *p, const char *end, uint64_t line, svo_error *err)
{
    p = import_skip_blank(p, end);
    if (p == end) return SVO_OK;
    const char *rest;
    switch (*p) {
    case 'v':
        switch (number_line(p, end, &rest)) {
        case OBJ_V: return read_vertex(b, rest, end, line, err);
        case OBJ_VT: return read_floats(b, OBJ_VT, 2, 1, rest, end, line, err);
        case OBJ_VN: return read_floats(b, OBJ_VN, 3, 3, rest, end, line, err);
        default: return SVO_OK;
        }
    case 'f':
        rest = import_word(p, end, "f");
        if (rest == NULL) rest = import_word(p, end, "fo"); /* an old name of the same */
        return rest != NULL ? read_face(b, rest, end, line, err) : SVO_OK;
    case 'u':
        rest = import_word(p, end, "usemtl");
        if (rest == NULL) return SVO_OK;
        rest = import_skip_blank(rest, end);
        return add_event(b, OBJ_USEMTL, rest, trim_end(rest, end), err);
    case 'm':
        rest = import_word(p, end, "mtllib");
        if (rest == NULL) return SVO_OK;
        rest = import_skip_blank(rest, end);
        end = trim_end(rest, end);
        return end > rest ? add_event(b, OBJ_MTLLIB, rest, end, err) : SVO_OK;
    case 'p':
    case 'l':
        if (import_word(p, end, "p") != NULL || import_word(p, end, "l") != NULL) note(b, OBJ_POINTS);
        return SVO_OK;
    case 'c':
    case 's':
        if (import_word(p, end, "curv") != NULL || import_word(p, end, "surf") != NULL || import_word(p, end, "cstype") != NULL) note(b, OBJ_CURVES);
        return SVO_OK;
    default: return SVO_OK;
    }
}

svo_result obj_block_read(obj_block *b, svo_error *err)
{
    /* Most faces are triangles, and the shortest is "f 1 2 3". */
    uint64_t faces = (uint64_t)(b->end - b->begin) / 8 + 1;
    if (faces > b->face_lines) faces = b->face_lines;
    if (!svo_buffer_reserve(&b->corners, (size_t)faces * 3 * sizeof(obj_corner)) || !svo_buffer_reserve(&b->sizes, (size_t)faces * sizeof(uint32_t)))
        return import_no_memory(err);
    SVO_TRY(add_event(b, OBJ_INHERIT, "", "", err));
    return each_line(b, read_line, err);
}
