/* OFF of Geomview: [ST][C][N]OFF in ASCII. Tokens, not lines, except where the format needs lines: colours after a face
 * end with the line. */
#include <math.h>
#include <string.h>

#include "import_soup.h"
#include "import_text.h"

typedef struct off_reader {
    const import_context *c;
    import_soup soup;
    const char *p, *start, *end;
    bool has_st, has_color, has_normal;
    int color_components; /* a vertex */
    bool fractions;       /* a colour token with a point was seen: 0..1, else 0..255 */
    const char *forgotten; /* text before it has been given back */
} off_reader;

static svo_result bad(const off_reader *r, const char *what, svo_error *err)
{
    uint64_t line = 1;
    for (const char *p = r->start; p < r->p; p++) line += *p == '\n';
    return svo_fail(err, SVO_INVALID_DATA, "%s:%llu: %s", r->c->path, (unsigned long long)line, what);
}

/* To the next token, over lines and comments. */
static void next(off_reader *r)
{
    for (;;) {
        r->p = import_skip_space(r->p, r->end);
        if (r->p == r->end || *r->p != '#') return;
        const char *stop = memchr(r->p, '\n', (size_t)(r->end - r->p));
        r->p = stop != NULL ? stop : r->end;
    }
}

/* A comment may follow a token without a blank. */
static const char *token_end(const char *p, const char *end)
{
    while (p < end && !import_space(*p) && *p != '#') p++;
    return p;
}

static bool number(off_reader *r, double *v)
{
    next(r);
    if (r->p == r->end) return false;
    const char *q = import_double(r->p, token_end(r->p, r->end), v);
    if (q == NULL) return false;
    r->p = q;
    return true;
}

static bool count(off_reader *r, uint64_t *v)
{
    next(r);
    int64_t i;
    const char *q = r->p < r->end ? import_integer(r->p, r->end, &i) : NULL;
    if (q == NULL || i < 0 || (q < r->end && !import_space(*q) && *q != '#')) return false;
    *v = (uint64_t)i;
    r->p = q;
    return true;
}

/* Tokens left on the line, comment excluded. */
static int tokens_on_line(const off_reader *r)
{
    int n = 0;
    for (const char *p = r->p;;) {
        p = import_skip_blank(p, r->end);
        if (p == r->end || *p == '\n' || *p == '#') return n;
        p = token_end(p, r->end);
        n++;
    }
}

static svo_result read_header(off_reader *r, uint64_t *vertices, uint64_t *faces, svo_error *err)
{
    next(r);
    const char *q = r->p;
    while (q < r->end && *q != '\0' && strchr("STCN4n", *q) != NULL) q++;
    if (r->end - q >= 3 && memcmp(q, "OFF", 3) == 0) {
        for (const char *k = r->p; k < q; k++) {
            r->has_st = r->has_st || *k == 'S' || *k == 'T';
            r->has_color = r->has_color || *k == 'C';
            r->has_normal = r->has_normal || *k == 'N';
            if (*k == '4' || *k == 'n')
                return svo_fail(err, SVO_UNSUPPORTED, "%s: OFF in other than three dimensions is not supported", r->c->path);
        }
        r->p = q + 3;
        const char *rest = import_skip_blank(r->p, r->end);
        if (import_word(rest, r->end, "BINARY") != NULL)
            return svo_fail(err, SVO_UNSUPPORTED, "%s: binary OFF is not supported; save it as ASCII", r->c->path);
    } /* else: the key word is optional */
    uint64_t edges;
    if (!count(r, vertices) || !count(r, faces)) return bad(r, "the header has no counts", err);
    if (tokens_on_line(r) > 0 && !count(r, &edges)) return bad(r, "the header has no counts", err);
    /* "0 0 0\n" is the least a vertex can take, "0\n" a face. */
    uint64_t left = (uint64_t)(r->end - r->p);
    if (*vertices > left / 5 || *faces > left / 2 || *vertices >= SVO_NONE)
        return svo_fail(err, SVO_INVALID_DATA, "%s: the header counts more vertices or faces than the file can hold", r->c->path);
    return SVO_OK;
}

static bool has_point(const char *p, const char *end)
{
    for (end = token_end(p, end); p < end; p++)
        if (*p == '.' || *p == 'e' || *p == 'E') return true;
    return false;
}

static bool read_color(off_reader *r, int components, float rgba[4])
{
    double v;
    rgba[3] = -1; /* none: set when the scale is known */
    for (int k = 0; k < components; k++) {
        next(r);
        r->fractions = r->fractions || has_point(r->p, r->end);
        if (!number(r, &v)) return false;
        rgba[k] = (float)v;
    }
    return true;
}

static svo_result read_vertex(off_reader *r, svo_error *err)
{
    double v[3];
    float n[3], rgba[4], uv[2];
    for (int k = 0; k < 3; k++)
        if (!number(r, &v[k])) return bad(r, "a vertex is not made of numbers, or is missing", err);
    if (svo_buffer_append(&r->soup.positions, v, sizeof v) == NULL) return import_no_memory(err);
    if (r->has_normal) {
        for (int k = 0; k < 3; k++) {
            if (!number(r, &v[k])) return bad(r, "a normal is not three numbers", err);
            n[k] = (float)v[k];
        }
        if (svo_buffer_append(&r->soup.normals, n, sizeof n) == NULL) return import_no_memory(err);
    }
    if (r->color_components > 0) {
        if (!read_color(r, r->color_components, rgba)) return bad(r, "a colour is not made of numbers", err);
        if (svo_buffer_append(&r->soup.colors, rgba, sizeof rgba) == NULL) return import_no_memory(err);
    }
    if (r->has_st) {
        for (int k = 0; k < 2; k++) {
            if (!number(r, &v[k])) return bad(r, "a texture coordinate is not two numbers", err);
            uv[k] = k == 0 ? (float)v[k] : 1 - (float)v[k];
        }
        if (svo_buffer_append(&r->soup.uvs, uv, sizeof uv) == NULL) return import_no_memory(err);
    }
    return SVO_OK;
}

static svo_result read_face(off_reader *r, uint64_t vertices, svo_error *err)
{
    uint64_t n, i;
    if (!count(r, &n)) return bad(r, "a face is missing or has no corner count", err);
    if (n > (uint64_t)(r->end - r->p) / 2) return bad(r, "a face has more corners than the file can hold", err);
    for (uint64_t k = 0; k < n; k++) {
        if (!count(r, &i)) return bad(r, "a face has something that is not a vertex number", err);
        if (i >= vertices) return bad(r, "a face refers to a vertex that does not exist", err);
        uint32_t index = (uint32_t)i;
        if (n >= 3 && svo_buffer_append(&r->soup.corners, &index, sizeof index) == NULL) return import_no_memory(err);
    }
    int extra = tokens_on_line(r);
    float rgba[4] = {NAN, NAN, NAN, -1};
    if (extra == 3 || extra == 4) {
        if (!read_color(r, extra, rgba)) return bad(r, "a face colour is not made of numbers", err);
    } else if (extra != 0) {
        svo_warn(r->c->warnings, "%s: colour map numbers of faces are not read", r->c->path);
        for (int k = 0; k < extra; k++) r->p = token_end(import_skip_blank(r->p, r->end), r->end);
    }
    if (n < 3) {
        r->soup.short_faces = true;
        return SVO_OK;
    }
    uint32_t size = (uint32_t)n;
    if (svo_buffer_append(&r->soup.sizes, &size, sizeof size) == NULL || svo_buffer_append(&r->soup.face_colors, rgba, sizeof rgba) == NULL)
        return import_no_memory(err);
    return SVO_OK;
}

/* Raw values to linear; sRGB by practice. Returns whether any colour was there. */
static bool to_linear(svo_buffer *colors, double scale)
{
    float *c = (float *)(void *)colors->data;
    bool any = false;
    for (size_t i = 0; i < colors->size / (4 * sizeof *c); i++, c += 4) {
        any = any || !isnan(c[0]);
        for (int k = 0; k < 3; k++) c[k] = import_srgb_to_linear((double)c[k] / scale);
        double alpha = c[3] < 0 ? 1 : (double)c[3] / scale;
        c[3] = alpha <= 1 ? (float)alpha : 1;
    }
    return any;
}

/* A spilling import moves what it has read to the store now and then. */
static svo_result flush(off_reader *r, svo_error *err)
{
    if (r->soup.store == NULL || (uint64_t)(r->p - r->forgotten) < r->c->memory / 64) return SVO_OK;
    SVO_TRY(soup_flush(&r->soup, err));
    import_forget(r->c, r->forgotten, r->p);
    r->forgotten = r->p;
    return SVO_OK;
}

static svo_result read_all(off_reader *r, svo_error *err)
{
    uint64_t vertices, faces;
    SVO_TRY(read_header(r, &vertices, &faces, err));
    next(r);
    /* How many colour components there are (3 or 4, also in files that do not say C) shows on the first vertex's line. */
    int extra = tokens_on_line(r) - 3 - (r->has_normal ? 3 : 0) - (r->has_st ? 2 : 0);
    if (vertices > 0) r->color_components = extra == 3 || extra == 4 ? extra : r->has_color ? 4 : 0;
    for (uint64_t i = 0; i < vertices; i++) {
        SVO_TRY(read_vertex(r, err));
        SVO_TRY(flush(r, err));
    }
    bool fractions = r->fractions;
    r->fractions = false;
    for (uint64_t i = 0; i < faces; i++) {
        SVO_TRY(read_face(r, vertices, err));
        SVO_TRY(flush(r, err));
    }
    if (r->soup.store != NULL) {
        r->soup.store->vertex_scale = fractions ? 1 : 255;
        r->soup.store->face_scale = r->fractions ? 1 : 255;
    } else {
        to_linear(&r->soup.colors, fractions ? 1 : 255);
    }
    if (r->soup.store == NULL && !to_linear(&r->soup.face_colors, r->fractions ? 1 : 255)) svo_buffer_free(&r->soup.face_colors);
    next(r);
    if (r->p < r->end) svo_warn(r->c->warnings, "%s: what follows the last face is ignored", r->c->path);
    return SVO_OK;
}

svo_result import_off(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    off_reader r = {.c = c, .p = (const char *)bytes, .start = (const char *)bytes, .end = (const char *)bytes + size};
    soup_init(&r.soup, c);
    r.forgotten = r.p;
    svo_result result = c->spilling ? soup_spill(&r.soup, c, err) : SVO_OK;
    if (result == SVO_OK) result = read_all(&r, err);
    if (result == SVO_OK) result = soup_build(&r.soup, c, mesh, err);
    soup_free(&r.soup);
    return result;
}
