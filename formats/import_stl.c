/* STL, binary and ASCII. Vertices stay unshared and facet normals are not taken: they say nothing that the triangle does
 * not say, and many files have them wrong. */
#include <string.h>

#include "fmt_container.h"
#include "import_common.h"
#include "import_text.h"
#include "svo_soup.h"
#include "svo_task.h"

enum { GRAIN = 1 << 14, SPILL_AT = 1 << 20 }; /* triangles of a parallel block; bytes that are spilled at a time */

static svo_result make_mesh(const import_context *c, double *positions, uint64_t triangles, svo_mesh *mesh, svo_error *err)
{
    const svo_allocator *a = c->allocator;
    svo_part *part = svo_calloc(a, 1, sizeof *part);
    uint32_t *indices = svo_alloc(a, triangles, 3 * sizeof *indices);
    if (part == NULL || indices == NULL) {
        svo_free(a, part, 1, sizeof *part);
        svo_free(a, indices, triangles, 3 * sizeof *indices);
        svo_free(a, positions, 3 * triangles, 3 * sizeof *positions);
        return import_no_memory(err);
    }
    for (uint64_t i = 0; i < 3 * triangles; i++) indices[i] = (uint32_t)i;
    *part = (svo_part){.material = SVO_NONE, .vertex_count = 3 * triangles, .triangle_count = triangles, .positions = positions, .indices = indices};
    return import_single_shape(c, part, 1, mesh, err);
}

typedef struct binary_job {
    const uint8_t *records;
    double *positions;
    bool attributes; /* set by any thread */
} binary_job;

static svo_result binary_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    binary_job *j = user;
    bool attributes = false;
    for (uint64_t i = begin; i < end; i++) {
        const uint8_t *p = j->records + 50 * i;
        float v[9];
        memcpy(v, p + 12, sizeof v);
        for (uint64_t k = 0; k < 9; k++) j->positions[9 * i + k] = (double)v[k];
        attributes |= p[48] != 0 || p[49] != 0;
    }
    if (attributes) __atomic_store_n(&j->attributes, true, __ATOMIC_RELAXED);
    return SVO_OK;
}

/* The spilling way: records of a soup hold the same nine floats. */
static svo_result spill_binary(const import_context *c, const uint8_t *records, uint64_t n, svo_mesh *mesh, svo_error *err)
{
    const bool none[SVO_MAX_UV_SETS] = {false};
    const svo_soup_layout layout = svo_soup_layout_make(false, false, none, false);
    svo_soup_file *file = NULL;
    svo_part *part = svo_calloc(c->allocator, 1, sizeof *part);
    uint8_t *out = svo_alloc(c->allocator, GRAIN, layout.stride);
    bool attributes = false;
    svo_result r = part != NULL && out != NULL ? svo_soup_file_create(c->spill, c->allocator, &file, err) : import_no_memory(err);
    for (uint64_t first = 0; r == SVO_OK && first < n; first += GRAIN) {
        uint64_t count = n - first < GRAIN ? n - first : GRAIN;
        const uint8_t *p = records + 50 * first;
        for (uint64_t i = 0; i < count; i++) {
            memcpy(out + 36 * i, p + 50 * i + 12, 36);
            attributes |= p[50 * i + 48] != 0 || p[50 * i + 49] != 0;
        }
        part->material = SVO_NONE;
        r = svo_soup_append(part, file, &layout, c->allocator, out, count, err);
        import_forget(c, p, p + 50 * count);
    }
    svo_soup_file_release(file);
    svo_free(c->allocator, out, GRAIN, layout.stride);
    if (r == SVO_OK && attributes) svo_warn(c->warnings, "%s: STL attribute bytes (colours of some programs) are not read", c->path);
    if (r == SVO_OK) return import_single_shape(c, part, 1, mesh, err);
    if (part != NULL) import_part_free(c->allocator, part);
    svo_free(c->allocator, part, 1, sizeof *part);
    return r;
}

static svo_result read_binary(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    if (size < 84) return svo_fail(err, SVO_INVALID_DATA, "%s: neither ASCII STL nor long enough for binary STL", c->path);
    uint64_t n = fmt_load32(bytes + 80), have = (size - 84) / 50;
    if (n > have)
        return svo_fail(err, SVO_INVALID_DATA, "%s: the STL header says %llu triangles, there are bytes for %llu", c->path,
                        (unsigned long long)n, (unsigned long long)have);
    if (n < have)
        return svo_fail(err, SVO_INVALID_DATA, "%s: the STL header says %llu triangles, but %llu follow", c->path, (unsigned long long)n,
                        (unsigned long long)have);
    if (size != 84 + 50 * n) svo_warn(c->warnings, "%s: bytes after the last triangle are ignored", c->path);
    if (n == 0) return import_single_shape(c, NULL, 0, mesh, err);
    if (c->spilling) return spill_binary(c, bytes + 84, n, mesh, err);
    if (3 * n >= SVO_NONE) return svo_fail(err, SVO_LIMIT, "%s: more than 2^32 corners", c->path);
    double *positions = svo_alloc(c->allocator, 3 * n, 3 * sizeof *positions);
    if (positions == NULL) return import_no_memory(err);
    binary_job j = {.records = bytes + 84, .positions = positions};
    svo_result r = svo_parallel_for(c->threads, n, GRAIN, binary_block, &j, err);
    if (r != SVO_OK) {
        svo_free(c->allocator, positions, 3 * n, 3 * sizeof *positions);
        return r;
    }
    if (j.attributes) svo_warn(c->warnings, "%s: STL attribute bytes (colours of some programs) are not read", c->path);
    return make_mesh(c, positions, n, mesh, err);
}

typedef struct stl_text {
    svo_part *spill;       /* NULL: positions stay in memory */
    svo_soup_file *file;
    const char *forgotten; /* text before it has been given back */
    const import_context *c;
    const char *p, *start, *end;
    svo_buffer positions; /* double 3 a corner, three a triangle */
    svo_buffer loop;      /* double 3: corners of the current loop */
    svo_buffer scratch;
    bool open, fanned;    /* between "outer loop" and "endloop" */
    uint64_t solids;      /* "solid" minus "endsolid" */
    bool part, irregular; /* a block of the text; it cannot be read alone */
} stl_text;

static svo_result bad(const stl_text *t, const char *what, svo_error *err)
{
    uint64_t line = 1;
    for (const char *p = t->start; p < t->p; p++) line += *p == '\n';
    return svo_fail(err, SVO_INVALID_DATA, "%s:%llu: %s", t->c->path, (unsigned long long)line, what);
}

static void skip_line(stl_text *t)
{
    const char *stop = memchr(t->p, '\n', (size_t)(t->end - t->p));
    t->p = stop != NULL ? stop + 1 : t->end;
}

/* What has been read goes to the spill. */
static svo_result spill_text(stl_text *t, svo_error *err)
{
    const bool none[SVO_MAX_UV_SETS] = {false};
    const svo_soup_layout layout = svo_soup_layout_make(true, false, none, false); /* the same nine doubles */
    SVO_TRY(svo_soup_append(t->spill, t->file, &layout, t->c->allocator, t->positions.data, t->positions.size / layout.stride, err));
    t->positions.size = 0;
    import_forget(t->c, t->forgotten, t->p);
    t->forgotten = t->p;
    return SVO_OK;
}

static svo_result end_loop(stl_text *t, svo_error *err)
{
    uint64_t n = t->loop.size / (3 * sizeof(double));
    if (n < 3) return bad(t, "a facet has fewer than three vertices", err);
    const double *p = (const double *)(void *)t->loop.data;
    if (n == 3) {
        if (svo_buffer_append(&t->positions, p, 9 * sizeof *p) == NULL) return import_no_memory(err);
    } else { /* against the format's rules, but there is one way to read it */
        svo_buffer triangles;
        svo_buffer_init(&triangles, t->c->allocator);
        uint32_t *out = n < SVO_NONE ? svo_buffer_append(&triangles, NULL, (size_t)(n - 2) * 3 * sizeof *out) : NULL;
        svo_result r = out != NULL ? import_triangulate(p, (uint32_t)n, out, &t->scratch, &t->fanned, err) : import_no_memory(err);
        for (uint64_t i = 0; r == SVO_OK && i < 3 * (n - 2); i++)
            if (svo_buffer_append(&t->positions, p + 3 * (uint64_t)out[i], 3 * sizeof *p) == NULL) r = import_no_memory(err);
        svo_buffer_free(&triangles);
        SVO_TRY(r);
    }
    t->loop.size = 0;
    t->open = false;
    return t->spill != NULL && t->positions.size >= SPILL_AT ? spill_text(t, err) : SVO_OK;
}

static svo_result read_vertex(stl_text *t, svo_error *err)
{
    double v[3];
    if (!t->open) return bad(t, "a vertex outside of a loop", err);
    for (int k = 0; k < 3; k++) {
        const char *q = import_skip_space(t->p, t->end);
        const char *after = q < t->end ? import_double(q, t->end, &v[k]) : NULL;
        if (after == NULL) return bad(t, "a vertex is not three numbers", err);
        t->p = after;
    }
    return svo_buffer_append(&t->loop, v, sizeof v) != NULL ? SVO_OK : import_no_memory(err);
}

static svo_result read_text(stl_text *t, svo_error *err)
{
    for (;;) {
        t->p = import_skip_space(t->p, t->end);
        if (t->p == t->end) break;
        const char *q;
        if ((q = import_word_nocase(t->p, t->end, "vertex")) != NULL) {
            t->p = q;
            SVO_TRY(read_vertex(t, err));
        } else if ((q = import_word_nocase(t->p, t->end, "outer")) != NULL || (q = import_word_nocase(t->p, t->end, "endfacet")) != NULL) {
            t->p = q;
        } else if ((q = import_word_nocase(t->p, t->end, "loop")) != NULL) {
            if (t->open) return bad(t, "a loop within a loop", err);
            t->open = true;
            t->p = q;
        } else if ((q = import_word_nocase(t->p, t->end, "endloop")) != NULL) {
            if (!t->open) return bad(t, "endloop without loop", err);
            SVO_TRY(end_loop(t, err));
            t->p = q;
        } else if ((q = import_word_nocase(t->p, t->end, "facet")) != NULL) {
            if (t->open) return bad(t, "a facet within a loop", err);
            t->p = import_skip_space(q, t->end);
            for (int k = 0; k < 4; k++) { /* "normal" and three numbers, which are not used */
                t->irregular |= t->p == t->end;
                t->p = import_skip_space(import_token_end(t->p, t->end), t->end);
            }
        } else if (import_word_nocase(t->p, t->end, "solid") != NULL) {
            t->solids++;
            skip_line(t);
        } else if (import_word_nocase(t->p, t->end, "endsolid") != NULL) {
            if (t->open || t->solids == 0) return bad(t, "endsolid in a wrong place", err);
            t->solids--;
            skip_line(t);
        } else {
            return bad(t, "not a word of ASCII STL", err);
        }
    }
    if (!t->part && (t->open || t->solids != 0)) return svo_fail(err, SVO_INVALID_DATA, "%s: the file ends within a solid", t->c->path);
    return SVO_OK;
}

/* --- blocks of text, which end with a line "endfacet" --- */

typedef struct stl_blocks {
    stl_text *list;
    uint64_t count, capacity;
    bool irregular; /* set by any thread */
} stl_blocks;

static void text_init(stl_text *t, const import_context *c, const char *start, const char *p, const char *end)
{
    *t = (stl_text){.c = c, .p = p, .start = start, .end = end};
    svo_buffer_init(&t->positions, c->allocator);
    svo_buffer_init(&t->loop, c->allocator);
    svo_buffer_init(&t->scratch, c->allocator);
}

static void text_free(stl_text *t)
{
    svo_buffer_free(&t->positions);
    svo_buffer_free(&t->loop);
    svo_buffer_free(&t->scratch);
}

/* The end of the first line "endfacet" that begins at p or later. */
static const char *facet_end(const char *p, const char *end)
{
    while (p < end) {
        const char *stop = memchr(p, '\n', (size_t)(end - p));
        if (stop == NULL) return end;
        const char *word = import_word_nocase(import_skip_blank(p, stop), stop, "endfacet");
        p = stop + 1;
        if (word != NULL && import_skip_blank(word, stop) == stop) return p;
    }
    return end;
}

static bool cut_blocks(stl_blocks *b, const import_context *c, const char *p, const char *end)
{
    uint64_t size = (uint64_t)(end - p), least = import_block_bytes(c, size);
    b->capacity = size / least + 1;
    b->list = svo_calloc(c->allocator, b->capacity, sizeof *b->list);
    if (b->list == NULL) return false;
    const char *start = p;
    while (p < end) {
        const char *line = (uint64_t)(end - p) <= least ? NULL : memchr(p + least - 1, '\n', (size_t)(end - p) - least + 1);
        const char *stop = line != NULL ? facet_end(line + 1, end) : end;
        stl_text *t = &b->list[b->count++];
        text_init(t, c, start, p, stop);
        t->part = true;
        t->solids = p > start;
        p = stop;
    }
    return true;
}

static svo_result read_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    stl_blocks *b = user;
    for (uint64_t i = begin; i < end; i++) {
        stl_text *t = &b->list[i];
        svo_error unused;
        /* One solid, from the first block to the last. */
        bool good = read_text(t, &unused) == SVO_OK && !t->open && !t->irregular && t->solids == (i + 1 < b->count);
        if (!good) __atomic_store_n(&b->irregular, true, __ATOMIC_RELAXED);
    }
    return SVO_OK;
}

/* All blocks on their own; false, with nothing told, where that cannot be done. */
static bool read_blocks(const import_context *c, const char *p, const char *end, svo_buffer *positions, bool *fanned)
{
    stl_blocks b = {0};
    svo_error unused;
    size_t size = 0;
    bool good = cut_blocks(&b, c, p, end) && b.count > 1 && svo_parallel_for(c->threads, b.count, 1, read_block, &b, &unused) == SVO_OK && !b.irregular;
    for (uint64_t i = 0; i < b.count; i++) size += b.list[i].positions.size;
    good = good && svo_buffer_reserve(positions, size);
    for (uint64_t i = 0; i < b.count; i++) {
        if (good) svo_buffer_append(positions, b.list[i].positions.data, b.list[i].positions.size);
        if (good) *fanned |= b.list[i].fanned;
        text_free(&b.list[i]);
    }
    svo_free(c->allocator, b.list, b.capacity, sizeof *b.list);
    return good;
}

static svo_result read_ascii(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    stl_text t;
    const char *p = (const char *)bytes;
    text_init(&t, c, p, p, p + size);
    svo_result r = SVO_OK;
    if (c->spilling) {
        t.forgotten = p;
        t.spill = svo_calloc(c->allocator, 1, sizeof *t.spill);
        r = t.spill != NULL ? svo_soup_file_create(c->spill, c->allocator, &t.file, err) : import_no_memory(err);
        if (r == SVO_OK) t.spill->material = SVO_NONE;
        if (r == SVO_OK) r = read_text(&t, err);
        if (r == SVO_OK) r = spill_text(&t, err);
        if (r == SVO_OK && t.fanned) svo_warn(c->warnings, "%s: some polygons cross themselves; they were cut as fans", c->path);
        svo_soup_file_release(t.file);
        text_free(&t);
        if (r == SVO_OK) return import_single_shape(c, t.spill, 1, mesh, err);
        if (t.spill != NULL) import_part_free(c->allocator, t.spill);
        svo_free(c->allocator, t.spill, 1, sizeof *t.spill);
        return r;
    }
    if (!read_blocks(c, p, p + size, &t.positions, &t.fanned)) r = read_text(&t, err);
    uint64_t n = 0;
    void *positions = NULL;
    if (r == SVO_OK && t.fanned) svo_warn(c->warnings, "%s: some polygons cross themselves; they were cut as fans", c->path);
    if (r == SVO_OK && t.positions.size / (3 * sizeof(double)) >= SVO_NONE) r = svo_fail(err, SVO_LIMIT, "%s: more than 2^32 corners", c->path);
    if (r == SVO_OK) r = import_exact(&t.positions, 3 * sizeof(double), &positions, &n, err);
    if (r == SVO_OK) r = n != 0 ? make_mesh(c, positions, n / 3, mesh, err) : import_single_shape(c, NULL, 0, mesh, err);
    text_free(&t);
    return r;
}

svo_result import_stl(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    /* Binary files may begin with "solid" too: their size decides, else a NUL does. */
    if (size >= 84 && size == 84 + 50 * (uint64_t)fmt_load32(bytes + 80)) return read_binary(c, bytes, size, mesh, err);
    const char *p = (const char *)bytes, *end = p + size;
    const char *word = import_skip_space(p, end);
    bool text = import_word_nocase(word, end, "solid") != NULL && memchr(p, '\0', size < 1024 ? size : 1024) == NULL;
    return text ? read_ascii(c, bytes, size, mesh, err) : read_binary(c, bytes, size, mesh, err);
}
