/* Wavefront OBJ, the text. Own parser: correctly rounded doubles, any line length, counts bounded by the bytes. */
#include "import_obj.h"

#include <string.h>

#include "import_text.h"

static uint64_t count_of(const svo_buffer *b, size_t elem) { return b->size / elem; }

static void obj_init(obj_file *f, const import_context *c)
{
    memset(f, 0, sizeof *f);
    f->context = c;
    svo_buffer *all[] = {&f->positions, &f->colors, &f->uvs, &f->normals, &f->groups, &f->slots, &f->libraries, &f->joined};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_init(all[i], c->allocator);
    f->current = SVO_NONE;
}

static void obj_free(obj_file *f)
{
    const svo_allocator *a = f->context->allocator;
    obj_group *group = (obj_group *)(void *)f->groups.data;
    for (uint64_t i = 0; i < count_of(&f->groups, sizeof *group); i++) {
        svo_string_free(a, group[i].material);
        svo_buffer_free(&group[i].corners);
        svo_buffer_free(&group[i].sizes);
    }
    char **library = (char **)(void *)f->libraries.data;
    for (uint64_t i = 0; i < count_of(&f->libraries, sizeof *library); i++) svo_string_free(a, library[i]);
    svo_buffer *all[] = {&f->positions, &f->colors, &f->uvs, &f->normals, &f->groups, &f->slots, &f->libraries, &f->joined};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_free(all[i]);
}

static svo_result bad_line(const obj_file *f, uint64_t line, const char *what, svo_error *err)
{
    return svo_fail(err, SVO_INVALID_DATA, "%s:%llu: %s", f->context->path, (unsigned long long)line, what);
}

/* --- groups by material name --- */

static uint32_t hash_name(const char *name, size_t n)
{
    uint32_t h = 2166136261u;
    for (size_t i = 0; i < n; i++) h = (h ^ (uint8_t)name[i]) * 16777619u;
    return h ^ h >> 15;
}

static svo_result grow_slots(obj_file *f, svo_error *err)
{
    uint64_t groups = count_of(&f->groups, sizeof(obj_group)), size = count_of(&f->slots, sizeof(uint32_t));
    if (2 * (groups + 1) <= size) return SVO_OK;
    size = size == 0 ? 64 : 2 * size;
    f->slots.size = 0;
    uint32_t *slot = svo_buffer_append(&f->slots, NULL, (size_t)size * sizeof *slot);
    if (slot == NULL) return import_no_memory(err);
    memset(slot, 0xff, (size_t)size * sizeof *slot);
    const obj_group *group = (const obj_group *)(void *)f->groups.data;
    for (uint32_t i = 0; i < groups; i++) {
        const char *name = group[i].material != NULL ? group[i].material : "";
        uint64_t at = hash_name(name, strlen(name)) & (size - 1);
        while (slot[at] != SVO_NONE) at = (at + 1) & (size - 1);
        slot[at] = i;
    }
    return SVO_OK;
}

static svo_result use_material(obj_file *f, const char *name, size_t n, bool named, svo_error *err)
{
    SVO_TRY(grow_slots(f, err));
    const char *nul = memchr(name, '\0', n);
    if (nul != NULL) n = (size_t)(nul - name);
    uint32_t *slot = (uint32_t *)(void *)f->slots.data;
    uint64_t mask = count_of(&f->slots, sizeof *slot) - 1;
    uint64_t at = hash_name(name, n) & mask;
    for (; slot[at] != SVO_NONE; at = (at + 1) & mask) {
        const obj_group *g = (const obj_group *)(void *)f->groups.data + slot[at];
        if ((g->material != NULL) != named) continue;
        const char *other = g->material != NULL ? g->material : "";
        if (strlen(other) == n && memcmp(other, name, n) == 0) {
            f->current = slot[at];
            return SVO_OK;
        }
    }
    obj_group group = {.resolved = SVO_NONE};
    svo_buffer_init(&group.corners, f->context->allocator);
    svo_buffer_init(&group.sizes, f->context->allocator);
    if (named) {
        group.material = svo_alloc(f->context->allocator, n + 1, 1);
        if (group.material == NULL) return import_no_memory(err);
        memcpy(group.material, name, n);
        group.material[n] = '\0';
    }
    if (svo_buffer_append(&f->groups, &group, sizeof group) == NULL) {
        svo_string_free(f->context->allocator, group.material);
        return import_no_memory(err);
    }
    f->current = slot[at] = (uint32_t)(count_of(&f->groups, sizeof group) - 1);
    return SVO_OK;
}

/* --- lines --- */

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

static svo_result read_vertex(obj_file *f, const char *p, const char *end, uint64_t line, svo_error *err)
{
    double v[8];
    uint32_t n = read_numbers(p, end, v, 8);
    if (n == SVO_NONE) return bad_line(f, line, "a vertex has something that is not a number", err);
    if (n < 3) return bad_line(f, line, "a vertex has fewer than three coordinates", err);
    if (count_of(&f->positions, 3 * sizeof(double)) >= SVO_NONE - 1) return bad_line(f, line, "more than 2^32 vertices", err);
    if (svo_buffer_append(&f->positions, v, 3 * sizeof(double)) == NULL) return import_no_memory(err);
    if (n < 6) return SVO_OK; /* a fourth number is a rational weight, which polygons do not use */
    const double *rgb = v + n - (n == 8 ? 5 : 3);
    uint64_t vertices = count_of(&f->positions, 3 * sizeof(double)), colors = count_of(&f->colors, 3 * sizeof(float));
    for (; colors + 1 < vertices; colors++) {
        static const float white[3] = {1, 1, 1};
        if (svo_buffer_append(&f->colors, white, sizeof white) == NULL) return import_no_memory(err);
    }
    float c[3] = {(float)rgb[0], (float)rgb[1], (float)rgb[2]};
    f->large_colors = f->large_colors || rgb[0] > 1 || rgb[1] > 1 || rgb[2] > 1;
    return svo_buffer_append(&f->colors, c, sizeof c) != NULL ? SVO_OK : import_no_memory(err);
}

static svo_result read_floats(obj_file *f, svo_buffer *to, uint32_t want, uint32_t least, const char *p, const char *end, uint64_t line,
                              svo_error *err)
{
    double v[3] = {0, 0, 0};
    uint32_t n = read_numbers(p, end, v, want);
    if (n == SVO_NONE || n < least) return bad_line(f, line, "a texture coordinate or normal is not made of numbers", err);
    float x[3] = {(float)v[0], (float)v[1], (float)v[2]};
    if (to->size / (want * sizeof(float)) >= SVO_NONE - 1) return bad_line(f, line, "more than 2^32 texture coordinates or normals", err);
    return svo_buffer_append(to, x, want * sizeof(float)) != NULL ? SVO_OK : import_no_memory(err);
}

/* 1-based or negative (from the end) to zero-based. Whether it exists is known at the end of the file only. */
static bool index_of(int64_t i, uint64_t count, uint32_t *out)
{
    int64_t zero = i > 0 ? i - 1 : (int64_t)count + i;
    if (i == 0 || zero < 0 || zero >= (int64_t)SVO_NONE) return false;
    *out = (uint32_t)zero;
    return true;
}

/* One "v", "v/vt", "v//vn" or "v/vt/vn"; NULL when it is broken. */
static const char *read_corner(const obj_file *f, const char *p, const char *end, obj_corner *c)
{
    int64_t i;
    *c = (obj_corner){SVO_NONE, SVO_NONE, SVO_NONE};
    p = import_integer(p, end, &i);
    if (p == NULL || !index_of(i, count_of(&f->positions, 3 * sizeof(double)), &c->v)) return NULL;
    if (p == end || *p != '/') return p;
    p++;
    if (p < end && (import_digit(*p) || *p == '-' || *p == '+')) {
        p = import_integer(p, end, &i);
        if (p == NULL || !index_of(i, count_of(&f->uvs, 2 * sizeof(float)), &c->vt)) return NULL;
    }
    if (p == end || *p != '/') return p;
    p++;
    if (p < end && (import_digit(*p) || *p == '-' || *p == '+')) {
        p = import_integer(p, end, &i);
        if (p == NULL || !index_of(i, count_of(&f->normals, 3 * sizeof(float)), &c->vn)) return NULL;
    }
    return p;
}

static svo_result read_face(obj_file *f, const char *p, const char *end, uint64_t line, svo_error *err)
{
    if (f->current == SVO_NONE) SVO_TRY(use_material(f, "", 0, false, err));
    obj_group *g = (obj_group *)(void *)f->groups.data + f->current;
    size_t before = g->corners.size;
    uint32_t n = 0;
    for (;;) {
        p = import_skip_blank(p, end);
        if (p == end || *p == '#') break;
        obj_corner c;
        p = read_corner(f, p, end, &c);
        if (p == NULL || (p < end && !import_blank(*p))) return bad_line(f, line, "a face has something that is not a vertex reference", err);
        if (svo_buffer_append(&g->corners, &c, sizeof c) == NULL) return import_no_memory(err);
        n++;
    }
    if (n < 3) {
        g->corners.size = before;
        svo_warn(f->context->warnings, "%s: faces with fewer than three corners are left out", f->context->path);
        return SVO_OK;
    }
    return svo_buffer_append(&g->sizes, &n, sizeof n) != NULL ? SVO_OK : import_no_memory(err);
}

static svo_result add_library(obj_file *f, const char *p, const char *end, svo_error *err)
{
    char **have = (char **)(void *)f->libraries.data;
    size_t n = (size_t)(end - p), count = f->libraries.size / sizeof *have;
    for (size_t i = 0; i < count; i++)
        if (strlen(have[i]) == n && memcmp(have[i], p, n) == 0) return SVO_OK;
    if (count >= 256) return svo_fail(err, SVO_LIMIT, "%s: more than 256 material libraries", f->context->path);
    if (memchr(p, '\0', n) != NULL) return SVO_OK;
    char *name = svo_alloc(f->context->allocator, n + 1, 1);
    if (name == NULL) return import_no_memory(err);
    memcpy(name, p, n);
    name[n] = '\0';
    if (svo_buffer_append(&f->libraries, &name, sizeof name) == NULL) {
        svo_string_free(f->context->allocator, name);
        return import_no_memory(err);
    }
    return SVO_OK;
}

static const char *trim_end(const char *p, const char *end)
{
    while (end > p && import_space(end[-1])) end--;
    return end;
}

static svo_result read_line(obj_file *f, const char *p, const char *end, uint64_t line, svo_error *err)
{
    p = import_skip_blank(p, end);
    if (p == end) return SVO_OK;
    const char *rest;
    switch (*p) {
    case 'v':
        if (end - p < 2) return SVO_OK;
        if (import_blank(p[1])) return read_vertex(f, p + 2, end, line, err);
        if (end - p > 2 && p[1] == 't' && import_blank(p[2])) return read_floats(f, &f->uvs, 2, 1, p + 3, end, line, err);
        if (end - p > 2 && p[1] == 'n' && import_blank(p[2])) return read_floats(f, &f->normals, 3, 3, p + 3, end, line, err);
        return SVO_OK;
    case 'f':
        rest = import_word(p, end, "f");
        if (rest == NULL) rest = import_word(p, end, "fo"); /* an old name of the same */
        return rest != NULL ? read_face(f, rest, end, line, err) : SVO_OK;
    case 'u':
        rest = import_word(p, end, "usemtl");
        if (rest == NULL) return SVO_OK;
        rest = import_skip_blank(rest, end);
        end = trim_end(rest, end);
        return use_material(f, rest, (size_t)(end - rest), true, err);
    case 'm':
        rest = import_word(p, end, "mtllib");
        if (rest == NULL) return SVO_OK;
        rest = import_skip_blank(rest, end);
        end = trim_end(rest, end);
        return end > rest ? add_library(f, rest, end, err) : SVO_OK;
    case 'p':
    case 'l':
        if (import_word(p, end, "p") != NULL || import_word(p, end, "l") != NULL)
            svo_warn(f->context->warnings, "%s: points and lines are left out", f->context->path);
        return SVO_OK;
    case 'c':
    case 's':
        if (import_word(p, end, "curv") != NULL || import_word(p, end, "surf") != NULL || import_word(p, end, "cstype") != NULL)
            svo_warn(f->context->warnings, "%s: free-form curves and surfaces are left out", f->context->path);
        return SVO_OK;
    default: return SVO_OK;
    }
}

static svo_result read_lines(obj_file *f, const char *p, const char *end, svo_error *err)
{
    for (uint64_t line = 1; p < end; line++) {
        const char *stop = memchr(p, '\n', (size_t)(end - p));
        if (stop == NULL) stop = end;
        const char *last = trim_end(p, stop);
        if (last == p || last[-1] != '\\') {
            SVO_TRY(read_line(f, p, stop, line, err));
            p = stop < end ? stop + 1 : end;
            continue;
        }
        /* continued on the next line */
        uint64_t first = line;
        f->joined.size = 0;
        for (;;) {
            bool more = last > p && last[-1] == '\\';
            size_t n = (size_t)(last - p) - (more ? 1 : 0);
            if ((n != 0 && svo_buffer_append(&f->joined, p, n) == NULL) || svo_buffer_append(&f->joined, " ", 1) == NULL)
                return import_no_memory(err);
            p = stop < end ? stop + 1 : end;
            if (!more || p == end) break;
            line++;
            stop = memchr(p, '\n', (size_t)(end - p));
            if (stop == NULL) stop = end;
            last = trim_end(p, stop);
        }
        const char *text = (const char *)f->joined.data;
        SVO_TRY(read_line(f, text, text + f->joined.size, first, err));
    }
    return SVO_OK;
}

/* --- libraries --- */

static svo_result read_library(obj_file *f, mtl_set *materials, const char *name, bool *found, svo_error *err)
{
    const import_context *c = f->context;
    char path[IMPORT_PATH_MAX];
    *found = import_find(c, name, path);
    if (!*found) return SVO_OK;
    fmt_bytes bytes;
    svo_error why = {0};
    svo_result r = import_open(c, path, &bytes, &why);
    if (r == SVO_OUT_OF_MEMORY) return import_no_memory(err);
    if (r != SVO_OK) {
        svo_warn(c->warnings, "%s: material library '%.80s' could not be read: %.100s", c->path, name, why.message);
        return SVO_OK;
    }
    r = mtl_read(materials, c, bytes.data, bytes.size, err);
    fmt_bytes_close(&bytes);
    return r;
}

static svo_result read_libraries(obj_file *f, mtl_set *materials, svo_error *err)
{
    char **name = (char **)(void *)f->libraries.data;
    for (uint64_t i = 0; i < count_of(&f->libraries, sizeof *name); i++) {
        bool found = false;
        SVO_TRY(read_library(f, materials, name[i], &found, err));
        if (found) continue;
        /* Names with blanks are more common than several libraries on a line, so that was tried first. */
        bool any = false;
        char *p = name[i];
        for (char *q; *p != '\0'; p = q) {
            p += strspn(p, " \t");
            q = p + strcspn(p, " \t");
            char keep = *q;
            *q = '\0';
            bool one = false;
            svo_result r = *p != '\0' && !(p == name[i] && keep == '\0') ? read_library(f, materials, p, &one, err) : SVO_OK;
            any = any || one;
            *q = keep;
            SVO_TRY(r);
        }
        if (!any) svo_warn(f->context->warnings, "%s: material library '%.120s' is missing; its materials are white", f->context->path, name[i]);
    }
    return SVO_OK;
}

/* UTF-16 files exist (text editors wrote them); everything that matters in them is ASCII, the rest is names. */
static svo_result from_utf16(svo_buffer *to, const uint8_t *p, uint64_t size, bool big, svo_error *err)
{
    for (uint64_t i = 0; i + 1 < size; i += 2) {
        uint32_t u = big ? (uint32_t)(p[i] << 8 | p[i + 1]) : (uint32_t)(p[i + 1] << 8 | p[i]);
        if (u >= 0xd800 && u < 0xdc00 && i + 3 < size) {
            uint32_t w = big ? (uint32_t)(p[i + 2] << 8 | p[i + 3]) : (uint32_t)(p[i + 3] << 8 | p[i + 2]);
            if (w >= 0xdc00 && w < 0xe000) u = 0x10000 + ((u - 0xd800) << 10) + (w - 0xdc00), i += 2;
        }
        uint8_t out[4];
        size_t n = u < 0x80 ? 1 : u < 0x800 ? 2 : u < 0x10000 ? 3 : 4;
        if (n == 1) out[0] = (uint8_t)u;
        else {
            for (size_t k = n - 1; k > 0; k--, u >>= 6) out[k] = (uint8_t)(0x80 | (u & 0x3f));
            out[0] = (uint8_t)((n == 2 ? 0xc0 : n == 3 ? 0xe0 : 0xf0) | u);
        }
        if (svo_buffer_append(to, out, n) == NULL) return import_no_memory(err);
    }
    return SVO_OK;
}

svo_result import_obj(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    obj_file f;
    mtl_set materials;
    svo_buffer text;
    obj_init(&f, c);
    mtl_init(&materials, c);
    svo_buffer_init(&text, c->allocator);
    svo_result r = SVO_OK;
    const char *p = (const char *)bytes;
    if (size >= 2 && ((bytes[0] == 0xff && bytes[1] == 0xfe) || (bytes[0] == 0xfe && bytes[1] == 0xff))) {
        r = from_utf16(&text, bytes + 2, size - 2, bytes[0] == 0xfe, err);
        p = (const char *)text.data;
        size = text.size;
    } else if (size >= 3 && memcmp(bytes, "\xef\xbb\xbf", 3) == 0) {
        p += 3;
        size -= 3;
    }
    if (r == SVO_OK && size != 0) r = read_lines(&f, p, p + size, err);
    if (r == SVO_OK) r = read_libraries(&f, &materials, err);
    if (r == SVO_OK) r = obj_build(&f, &materials, mesh, err);
    obj_free(&f);
    mtl_free(&materials);
    svo_buffer_free(&text);
    return r;
}
