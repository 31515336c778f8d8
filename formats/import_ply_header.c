#include <string.h>

#include "import_ply.h"
#include "import_text.h"

uint32_t ply_type_size(ply_type t)
{
    static const uint8_t size[] = {0, 1, 1, 2, 2, 4, 4, 4, 8};
    return size[t];
}

bool ply_is_integer(ply_type t) { return t >= PLY_I8 && t <= PLY_U32; }

static svo_result bad(const ply_reader *r, const char *what, svo_error *err)
{
    return svo_fail(err, SVO_INVALID_DATA, "%s: PLY header: %s", r->c->path, what);
}

static ply_type read_type(const char *p, size_t n)
{
    static const struct { const char *name; ply_type type; } table[] = {
        {"char", PLY_I8},    {"int8", PLY_I8},   {"uchar", PLY_U8},   {"uint8", PLY_U8},    {"short", PLY_I16},   {"int16", PLY_I16},
        {"ushort", PLY_U16}, {"uint16", PLY_U16}, {"int", PLY_I32},    {"int32", PLY_I32},   {"uint", PLY_U32},    {"uint32", PLY_U32},
        {"float", PLY_F32},  {"float32", PLY_F32}, {"double", PLY_F64}, {"float64", PLY_F64},
    };
    for (size_t i = 0; i < sizeof table / sizeof *table; i++)
        if (strlen(table[i].name) == n && memcmp(table[i].name, p, n) == 0) return table[i].type;
    return PLY_NONE;
}

static ply_use use_of(ply_kind kind, const char *p, size_t n, bool list)
{
    static const struct { const char *name; ply_use use; } values[] = {
        {"x", PLY_X}, {"y", PLY_Y}, {"z", PLY_Z}, {"nx", PLY_NX}, {"ny", PLY_NY}, {"nz", PLY_NZ},
        {"u", PLY_U}, {"s", PLY_U}, {"texture_u", PLY_U}, {"v", PLY_V}, {"t", PLY_V}, {"texture_v", PLY_V},
        {"red", PLY_R}, {"r", PLY_R}, {"diffuse_red", PLY_R}, {"green", PLY_G}, {"g", PLY_G}, {"diffuse_green", PLY_G},
        {"blue", PLY_B}, {"b", PLY_B}, {"diffuse_blue", PLY_B}, {"alpha", PLY_A}, {"a", PLY_A},
        {"intensity", PLY_INTENSITY}, {"scalar_Intensity", PLY_INTENSITY}, {"scalar_intensity", PLY_INTENSITY}, {"reflectance", PLY_INTENSITY},
    }, lists[] = {{"vertex_indices", PLY_INDICES}, {"vertex_index", PLY_INDICES}, {"texcoord", PLY_TEXCOORD}};
    if (list) {
        for (size_t i = 0; i < sizeof lists / sizeof *lists; i++)
            if (strlen(lists[i].name) == n && memcmp(lists[i].name, p, n) == 0)
                return kind == PLY_FACE ? lists[i].use : kind == PLY_TRISTRIPS && lists[i].use == PLY_INDICES ? PLY_STRIPS : PLY_OTHER;
        return PLY_OTHER;
    }
    if (kind == PLY_FACE && ((n == 9 && memcmp(p, "texnumber", 9) == 0))) return PLY_TEXNUMBER;
    for (size_t i = 0; i < sizeof values / sizeof *values; i++)
        if (strlen(values[i].name) == n && memcmp(values[i].name, p, n) == 0)
            return kind == PLY_VERTEX || (kind == PLY_FACE && values[i].use >= PLY_R) ? values[i].use : PLY_OTHER;
    return PLY_OTHER;
}

static const char *word(const char **p, const char *end, size_t *n)
{
    const char *start = import_skip_blank(*p, end);
    *p = import_token_end(start, end);
    *n = (size_t)(*p - start);
    return start;
}

static svo_result read_element(ply_reader *r, const char *p, const char *end, svo_error *err)
{
    if (r->element_count == PLY_MAX_ELEMENTS) return bad(r, "too many elements", err);
    ply_element *e = &r->elements[r->element_count];
    memset(e, 0, sizeof *e);
    size_t n;
    const char *name = word(&p, end, &n);
    if (n == 0) return bad(r, "an element has no name", err);
    memcpy(e->name, name, n < sizeof e->name ? n : sizeof e->name - 1);
    e->kind = strcmp(e->name, "vertex") == 0 ? PLY_VERTEX : strcmp(e->name, "face") == 0 ? PLY_FACE
              : strcmp(e->name, "tristrips") == 0 ? PLY_TRISTRIPS : PLY_SKIPPED;
    for (uint32_t i = 0; i < r->element_count; i++)
        if (e->kind != PLY_SKIPPED && r->elements[i].kind == e->kind) return bad(r, "an element appears twice", err);
    int64_t count;
    p = import_skip_blank(p, end);
    const char *after = p < end ? import_integer(p, end, &count) : NULL;
    if (after == NULL || count < 0 || import_skip_blank(after, end) != end) return bad(r, "an element has no proper count", err);
    e->count = (uint64_t)count;
    r->element_count++;
    return SVO_OK;
}

static svo_result read_property(ply_reader *r, const char *p, const char *end, svo_error *err)
{
    if (r->element_count == 0) return bad(r, "a property before any element", err);
    ply_element *e = &r->elements[r->element_count - 1];
    if (e->property_count == PLY_MAX_PROPERTIES) return bad(r, "too many properties", err);
    ply_property q = {PLY_NONE, PLY_NONE, PLY_OTHER};
    size_t n;
    const char *w = word(&p, end, &n);
    if (n == 4 && memcmp(w, "list", 4) == 0) {
        w = word(&p, end, &n);
        q.list = read_type(w, n);
        if (!ply_is_integer(q.list)) return bad(r, "a list has no integer length type", err);
        w = word(&p, end, &n);
    }
    q.type = read_type(w, n);
    if (q.type == PLY_NONE) return bad(r, "a property has no known type", err);
    w = word(&p, end, &n);
    if (n == 0) return bad(r, "a property has no name", err);
    q.use = use_of(e->kind, w, n, q.list != PLY_NONE);
    for (uint32_t i = 0; i < e->property_count; i++)
        if (q.use != PLY_OTHER && e->properties[i].use == q.use) {
            if (q.use < PLY_U) return bad(r, "a property appears twice", err);
            q.use = PLY_OTHER; /* two names for one thing, such as s and u: the first counts */
        }
    e->properties[e->property_count++] = q;
    return SVO_OK;
}

/* "comment TextureFile name" of MeshLab. */
static svo_result read_comment(ply_reader *r, const char *p, const char *end, svo_error *err)
{
    p = import_skip_blank(p, end);
    const char *name = import_word_nocase(p, end, "TextureFile");
    if (name == NULL) return SVO_OK;
    name = import_skip_blank(name, end);
    while (end > name && import_space(end[-1])) end--;
    size_t n = (size_t)(end - name);
    if (n == 0 || memchr(name, '\0', n) != NULL || r->soup.images.size / sizeof(char *) >= 4096) return SVO_OK;
    char *copy = svo_alloc(r->c->allocator, n + 1, 1);
    if (copy == NULL) return import_no_memory(err);
    memcpy(copy, name, n);
    copy[n] = '\0';
    if (svo_buffer_append(&r->soup.images, &copy, sizeof copy) == NULL) {
        svo_string_free(r->c->allocator, copy);
        return import_no_memory(err);
    }
    return SVO_OK;
}

static svo_result read_format(ply_reader *r, const char *p, const char *end, svo_error *err)
{
    const char *after;
    p = import_skip_blank(p, end);
    if ((after = import_word(p, end, "ascii")) != NULL) r->ascii = true;
    else if ((after = import_word(p, end, "binary_little_endian")) != NULL) r->big_endian = false;
    else if ((after = import_word(p, end, "binary_big_endian")) != NULL) r->big_endian = true;
    else return bad(r, "unknown format", err);
    if (import_word(import_skip_blank(after, end), end, "1.0") == NULL)
        return svo_fail(err, SVO_UNSUPPORTED, "%s: only PLY 1.0 is supported", r->c->path);
    return SVO_OK;
}

svo_result ply_read_header(ply_reader *r, svo_error *err)
{
    const char *p = import_skip_space((const char *)r->p, (const char *)r->end), *end = (const char *)r->end;
    p = import_word(p, end, "ply");
    if (p == NULL) return svo_fail(err, SVO_INVALID_DATA, "%s: does not begin with 'ply'", r->c->path);
    /* Lines end as the first one does: data may begin with any byte, also with a line feed. */
    while (p < end && (*p == ' ' || *p == '\t')) p++;
    bool cr = p < end && *p == '\r';
    bool crlf = cr && p + 1 < end && p[1] == '\n';
    char stop_char = cr && !crlf ? '\r' : '\n';
    bool format = false;
    const char *stop = memchr(p, stop_char, (size_t)(end - p));
    for (p = stop != NULL ? stop + 1 : end; p < end; p = stop + 1) {
        stop = memchr(p, stop_char, (size_t)(end - p));
        if (stop == NULL) break;
        const char *q = import_skip_blank(p, stop), *last = stop, *rest;
        while (last > q && import_space(last[-1])) last--;
        if (import_word(q, last, "end_header") != NULL) {
            r->p = (const uint8_t *)stop + 1;
            return format ? SVO_OK : bad(r, "no format line", err);
        }
        if (q == last || import_word(q, last, "obj_info") != NULL) continue;
        if ((rest = import_word(q, last, "comment")) != NULL) SVO_TRY(read_comment(r, rest, last, err));
        else if ((rest = import_word(q, last, "format")) != NULL) {
            format = true;
            SVO_TRY(read_format(r, rest, last, err));
        } else if ((rest = import_word(q, last, "element")) != NULL) SVO_TRY(read_element(r, rest, last, err));
        else if ((rest = import_word(q, last, "property")) != NULL) SVO_TRY(read_property(r, rest, last, err));
        else if (r->element_count == 0) /* Blender 2.4x forgot the word "comment"; later a line may be a damaged property */
            svo_warn(r->c->warnings, "%s: PLY header: a line that is not known is ignored", r->c->path);
        else return bad(r, "a line that is not known", err);
    }
    return bad(r, "no end_header", err);
}
