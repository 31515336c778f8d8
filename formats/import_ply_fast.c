/* PLY elements whose rows can be found without reading those before: binary rows of one size, ASCII rows of one line each.
 * They are read in parallel. Whatever is not as regular as that is left to the reader of one row after the other
 * (import_ply.c), which gives the same result and knows the errors. */
#include <string.h>

#include "fmt_container.h"
#include "import_ply.h"
#include "import_text.h"
#include "svo_task.h"

enum { GRAIN = 1 << 14 }; /* binary rows of a parallel block */

/* A block of lines of the ASCII part. */
typedef struct line_block {
    const char *begin, *end;
    uint64_t first, rows; /* lines that are not blank */
    svo_buffer corners, sizes; /* of faces */
    bool short_faces, extra;
} line_block;

typedef struct fast_job {
    ply_reader *r;
    const ply_element *e;
    import_soup *soup;
    uint64_t first, count, row_bytes;
    uint64_t vertices;
    uint32_t list_length;
    double *positions;
    float *normals, *uvs, *colors;
    uint32_t *corners;
    bool irregular; /* set by any thread */
    ply_lines *lines;
    const char *after; /* the end of the last row */
} fast_job;

struct ply_lines {
    line_block *block;
    uint64_t count, capacity, rows, next; /* next: first line of the next element */
};

static void give_up(fast_job *j) { __atomic_store_n(&j->irregular, true, __ATOMIC_RELAXED); }

double ply_load(const uint8_t *p, ply_type type, bool big)
{
    uint64_t bits;
    float f;
    double d;
    uint32_t single;
    switch (type) {
    case PLY_I8: return (int8_t)*p;
    case PLY_U8: return *p;
    case PLY_I16: return (int16_t)(big ? __builtin_bswap16(fmt_load16(p)) : fmt_load16(p));
    case PLY_U16: return big ? __builtin_bswap16(fmt_load16(p)) : fmt_load16(p);
    case PLY_I32: return (int32_t)(big ? __builtin_bswap32(fmt_load32(p)) : fmt_load32(p));
    case PLY_U32: return big ? __builtin_bswap32(fmt_load32(p)) : fmt_load32(p);
    case PLY_F32:
        single = big ? __builtin_bswap32(fmt_load32(p)) : fmt_load32(p);
        memcpy(&f, &single, sizeof f);
        return (double)f;
    case PLY_F64:
        bits = big ? __builtin_bswap64(fmt_load64(p)) : fmt_load64(p);
        memcpy(&d, &bits, sizeof d);
        return d;
    case PLY_NONE: break;
    }
    return 0;
}

static bool uses(const ply_element *e, ply_use use)
{
    for (uint32_t i = 0; i < e->property_count; i++)
        if (e->properties[i].use == use) return true;
    return false;
}

static bool only_scalars(const ply_element *e)
{
    for (uint32_t i = 0; i < e->property_count; i++)
        if (e->properties[i].list != PLY_NONE) return false;
    return e->property_count != 0;
}

/* --- vertices --- */

static svo_result make_arrays(fast_job *j, svo_error *err)
{
    const ply_element *e = j->e;
    import_soup *s = j->soup;
    size_t n = (size_t)e->count;
    bool normals = uses(e, PLY_NX) && uses(e, PLY_NY) && uses(e, PLY_NZ), uvs = uses(e, PLY_U) && uses(e, PLY_V);
    bool colors = uses(e, PLY_R) && uses(e, PLY_G) && uses(e, PLY_B);
    if (!svo_buffer_reserve(&s->positions, n * 3 * sizeof(double)) || (normals && !svo_buffer_reserve(&s->normals, n * 3 * sizeof(float))) ||
        (uvs && !svo_buffer_reserve(&s->uvs, n * 2 * sizeof(float))) || (colors && !svo_buffer_reserve(&s->colors, n * 4 * sizeof(float))))
        return import_no_memory(err);
    j->positions = (double *)(void *)s->positions.data;
    if (normals) j->normals = (float *)(void *)s->normals.data;
    if (uvs) j->uvs = (float *)(void *)s->uvs.data;
    if (colors) j->colors = (float *)(void *)s->colors.data;
    return SVO_OK;
}

static void have_arrays(fast_job *j)
{
    import_soup *s = j->soup;
    size_t n = (size_t)j->e->count;
    s->positions.size = n * 3 * sizeof(double);
    if (j->normals != NULL) s->normals.size = n * 3 * sizeof(float);
    if (j->uvs != NULL) s->uvs.size = n * 2 * sizeof(float);
    if (j->colors != NULL) s->colors.size = n * 4 * sizeof(float);
}

static inline void put_vertex(const fast_job *j, uint64_t row, const double v[PLY_VALUES])
{
    memcpy(j->positions + 3 * row, v + PLY_X, 3 * sizeof *v);
    for (uint64_t k = 0; k < 3 && j->normals != NULL; k++) j->normals[3 * row + k] = (float)v[PLY_NX + k];
    if (j->uvs != NULL) {
        j->uvs[2 * row] = (float)v[PLY_U];
        j->uvs[2 * row + 1] = 1 - (float)v[PLY_V];
    }
    for (uint64_t k = 0; k < 4 && j->colors != NULL; k++) j->colors[4 * row + k] = (float)v[PLY_R + k];
}

static svo_result binary_vertices(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    const fast_job *j = user;
    const ply_element *e = j->e;
    const bool big = j->r->big_endian;
    double v[PLY_VALUES + 1];
    v[PLY_A] = -1;
    for (uint64_t row = begin; row < end; row++) {
        const uint8_t *p = j->r->p + row * j->row_bytes;
        for (uint32_t i = 0; i < e->property_count; i++) {
            const ply_property *q = &e->properties[i];
            if (q->use < PLY_VALUES) v[q->use] = ply_load(p, q->type, big);
            p += ply_type_size(q->type);
        }
        put_vertex(j, row, v);
    }
    return SVO_OK;
}

/* --- faces --- */

/* Nothing but indices means anything. */
static bool plain_faces(const ply_element *e)
{
    uint32_t lists = 0;
    for (uint32_t i = 0; i < e->property_count; i++) {
        const ply_property *q = &e->properties[i];
        if (q->use == PLY_INDICES) lists++;
        else if (q->use != PLY_OTHER) return false;
        if (q->use == PLY_INDICES && (q->list == PLY_NONE || !ply_is_integer(q->type))) return false;
    }
    return lists == 1;
}

static svo_result binary_faces(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    fast_job *j = user;
    const ply_element *e = j->e;
    const bool big = j->r->big_endian;
    const uint32_t length = j->list_length;
    for (uint64_t row = begin; row < end; row++) {
        const uint8_t *p = j->r->p + row * j->row_bytes;
        for (uint32_t i = 0; i < e->property_count; i++) {
            const ply_property *q = &e->properties[i];
            if (q->list == PLY_NONE) {
                p += ply_type_size(q->type);
                continue;
            }
            if (ply_load(p, q->list, big) != (double)length) {
                give_up(j);
                return SVO_OK;
            }
            p += ply_type_size(q->list);
            uint32_t *to = j->corners + row * length;
            bool good = true;
            if (!big && (q->type == PLY_I32 || q->type == PLY_U32)) { /* nearly always; a negative index is above all vertices */
                for (uint32_t k = 0; k < length; k++, p += 4) {
                    to[k] = fmt_load32(p);
                    good &= to[k] < j->vertices;
                }
            } else {
                for (uint32_t k = 0; k < length; k++, p += ply_type_size(q->type)) {
                    double index = ply_load(p, q->type, big);
                    bool fits = index >= 0 && index < (double)j->vertices;
                    good &= fits;
                    to[k] = fits ? (uint32_t)index : 0;
                }
            }
            if (!good) {
                give_up(j);
                return SVO_OK;
            }
        }
    }
    return SVO_OK;
}

static svo_result read_binary(fast_job *j, bool faces, bool *done, svo_error *err)
{
    ply_reader *r = j->r;
    const ply_element *e = j->e;
    uint64_t left = (uint64_t)(r->end - r->p);
    if (faces) {
        /* The first row says how long its list is; the others must say the same. */
        const uint8_t *p = r->p;
        for (uint32_t i = 0; i < e->property_count; i++) {
            const ply_property *q = &e->properties[i];
            if (q->list == PLY_NONE) {
                j->row_bytes += ply_type_size(q->type);
                continue;
            }
            if (!ply_is_integer(q->list) || left < j->row_bytes + ply_type_size(q->list)) return SVO_OK;
            double length = ply_load(p + j->row_bytes, q->list, r->big_endian);
            if (!(length >= 3) || length > 255) return SVO_OK;
            j->list_length = (uint32_t)length;
            j->row_bytes += ply_type_size(q->list) + j->list_length * (uint64_t)ply_type_size(q->type);
        }
    } else {
        for (uint32_t i = 0; i < e->property_count; i++) j->row_bytes += ply_type_size(e->properties[i].type);
    }
    if (j->row_bytes == 0 || e->count > left / j->row_bytes) return SVO_OK;
    import_soup *s = j->soup;
    if (!faces) {
        SVO_TRY(make_arrays(j, err));
        SVO_TRY(svo_parallel_for(r->c->threads, e->count, GRAIN, binary_vertices, j, err));
        have_arrays(j);
    } else {
        uint64_t corners = e->count * j->list_length;
        if (!svo_buffer_reserve(&s->corners, (size_t)corners * sizeof(uint32_t)) || !svo_buffer_reserve(&s->sizes, (size_t)e->count * sizeof(uint32_t)))
            return import_no_memory(err);
        j->corners = (uint32_t *)(void *)s->corners.data;
        SVO_TRY(svo_parallel_for(r->c->threads, e->count, GRAIN, binary_faces, j, err));
        if (j->irregular) return SVO_OK;
        uint32_t *size = (uint32_t *)(void *)s->sizes.data;
        for (uint64_t i = 0; i < e->count; i++) size[i] = j->list_length;
        s->corners.size = (size_t)corners * sizeof(uint32_t);
        s->sizes.size = (size_t)e->count * sizeof(uint32_t);
    }
    r->p += e->count * j->row_bytes;
    *done = true;
    return SVO_OK;
}

/* --- ASCII: lines --- */

static svo_result count_lines(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    ply_lines *l = user;
    for (uint64_t i = begin; i < end; i++) {
        line_block *b = &l->block[i];
        for (const char *p = b->begin; p < b->end;) {
            const char *stop = memchr(p, '\n', (size_t)(b->end - p));
            if (stop == NULL) stop = b->end;
            b->rows += import_skip_blank(p, stop) < stop;
            p = stop < b->end ? stop + 1 : b->end;
        }
    }
    return SVO_OK;
}

static svo_result cut_lines(ply_reader *r, svo_error *err)
{
    ply_lines *l = svo_calloc(r->c->allocator, 1, sizeof *l);
    if (l == NULL) return import_no_memory(err);
    r->lines = l;
    const char *p = (const char *)r->p, *end = (const char *)r->end;
    uint64_t size = (uint64_t)(end - p), least = import_block_bytes(r->c, size);
    l->capacity = size / least + 1;
    l->block = svo_calloc(r->c->allocator, l->capacity, sizeof *l->block);
    if (l->block == NULL) return import_no_memory(err);
    while (p < end) {
        const char *stop = (uint64_t)(end - p) <= least ? NULL : memchr(p + least - 1, '\n', (size_t)(end - p) - least + 1);
        stop = stop != NULL ? stop + 1 : end;
        line_block *b = &l->block[l->count++];
        b->begin = p;
        b->end = stop;
        svo_buffer_init(&b->corners, r->c->allocator);
        svo_buffer_init(&b->sizes, r->c->allocator);
        p = stop;
    }
    SVO_TRY(svo_parallel_for(r->c->threads, l->count, 1, count_lines, l, err));
    for (uint64_t i = 0; i < l->count; i++) {
        l->block[i].first = l->rows;
        l->rows += l->block[i].rows;
    }
    return SVO_OK;
}

void ply_lines_free(ply_reader *r)
{
    ply_lines *l = r->lines;
    if (l == NULL) return;
    for (uint64_t i = 0; i < l->count; i++) {
        svo_buffer_free(&l->block[i].corners);
        svo_buffer_free(&l->block[i].sizes);
    }
    svo_free(r->c->allocator, l->block, l->capacity, sizeof *l->block);
    svo_free(r->c->allocator, l, 1, sizeof *l);
    r->lines = NULL;
}

/* A number on this line. */
static inline bool line_value(const char **p, const char *stop, double *v)
{
    const char *q = import_skip_blank(*p, stop), *after = q < stop ? import_double(q, stop, v) : NULL;
    if (after == NULL) return false;
    *p = after;
    return true;
}

static bool vertex_line(fast_job *j, line_block *b, uint64_t row, const char **at, const char *stop)
{
    (void)b;
    const ply_element *e = j->e;
    double v[PLY_VALUES + 1];
    v[PLY_A] = -1;
    for (uint32_t i = 0; i < e->property_count; i++) {
        ply_use use = e->properties[i].use;
        if (!line_value(at, stop, &v[use < PLY_VALUES ? use : PLY_VALUES])) return false;
    }
    put_vertex(j, row, v);
    return true;
}

static bool face_line(fast_job *j, line_block *b, uint64_t row, const char **at, const char *stop)
{
    (void)row;
    const ply_element *e = j->e;
    for (uint32_t i = 0; i < e->property_count; i++) {
        const ply_property *q = &e->properties[i];
        double v, length = 1;
        if (q->list != PLY_NONE && (!line_value(at, stop, &length) || !(length >= 0) || length > 255 || length != (double)(uint32_t)length)) return false;
        uint32_t n = (uint32_t)length;
        if (q->use != PLY_INDICES) {
            for (uint32_t k = 0; k < n; k++)
                if (!line_value(at, stop, &v)) return false;
            continue;
        }
        if (!svo_buffer_reserve(&b->corners, n * sizeof(uint32_t)) || !svo_buffer_reserve(&b->sizes, sizeof n)) return false;
        if (n == 0) { /* maybe no corner yet and no memory for any: there is nothing to point at */
            b->short_faces = true;
            continue;
        }
        uint32_t *to = (uint32_t *)(void *)(b->corners.data + b->corners.size);
        for (uint32_t k = 0; k < n; k++) {
            if (!line_value(at, stop, &v) || !(v >= 0) || v >= (double)j->vertices || v != (double)(uint32_t)v) return false;
            to[k] = (uint32_t)v;
        }
        if (n < 3) { /* a point or an edge */
            b->short_faces = true;
            continue;
        }
        memcpy(b->sizes.data + b->sizes.size, &n, sizeof n);
        b->sizes.size += sizeof n;
        b->corners.size += n * sizeof *to;
    }
    return true;
}

typedef bool (*row_fn)(fast_job *j, line_block *b, uint64_t row, const char **at, const char *stop);

static inline void read_lines(fast_job *j, uint64_t begin, uint64_t end, row_fn fn)
{
    for (uint64_t i = begin; i < end; i++) {
        line_block *b = &j->lines->block[i];
        uint64_t row = b->first, last = j->first + j->count;
        if (row + b->rows <= j->first || row >= last) continue;
        for (const char *p = b->begin; p < b->end && row < last;) {
            const char *stop = memchr(p, '\n', (size_t)(b->end - p));
            if (stop == NULL) stop = b->end;
            if (import_skip_blank(p, stop) < stop && row++ >= j->first) {
                if (!fn(j, b, row - 1 - j->first, &p, stop)) {
                    give_up(j);
                    return;
                }
                b->extra |= import_skip_blank(p, stop) < stop;
                if (row == last) j->after = stop;
            }
            p = stop < b->end ? stop + 1 : b->end;
        }
    }
}

static svo_result ascii_vertices(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    read_lines(user, begin, end, vertex_line);
    return SVO_OK;
}

static svo_result ascii_faces(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    read_lines(user, begin, end, face_line);
    return SVO_OK;
}

static svo_result gather_faces(fast_job *j, svo_error *err)
{
    import_soup *s = j->soup;
    size_t corners = 0, sizes = 0;
    for (uint64_t i = 0; i < j->lines->count; i++) {
        corners += j->lines->block[i].corners.size;
        sizes += j->lines->block[i].sizes.size;
    }
    if (!svo_buffer_reserve(&s->corners, corners) || !svo_buffer_reserve(&s->sizes, sizes)) return import_no_memory(err);
    for (uint64_t i = 0; i < j->lines->count; i++) {
        line_block *b = &j->lines->block[i];
        if (svo_buffer_append(&s->corners, b->corners.data, b->corners.size) == NULL ||
            svo_buffer_append(&s->sizes, b->sizes.data, b->sizes.size) == NULL)
            return import_no_memory(err);
        s->short_faces |= b->short_faces;
        svo_buffer_free(&b->corners);
        svo_buffer_free(&b->sizes);
    }
    return SVO_OK;
}

static svo_result read_ascii(fast_job *j, bool faces, bool *done, svo_error *err)
{
    ply_reader *r = j->r;
    ply_lines *l = r->lines;
    j->lines = l;
    j->first = l->next;
    j->count = j->e->count;
    if (j->count > l->rows - l->next) return SVO_OK;
    for (uint64_t i = 0; i < l->count; i++) l->block[i].extra = l->block[i].short_faces = false;
    if (!faces) SVO_TRY(make_arrays(j, err));
    SVO_TRY(svo_parallel_for(r->c->threads, l->count, 1, faces ? ascii_faces : ascii_vertices, j, err));
    if (j->irregular) return SVO_OK;
    if (faces) SVO_TRY(gather_faces(j, err));
    else have_arrays(j);
    for (uint64_t i = 0; i < l->count; i++)
        if (l->block[i].extra) {
            ply_warn_extra(r);
            break;
        }
    l->next += j->count;
    r->p = (const uint8_t *)j->after;
    *done = true;
    return SVO_OK;
}

svo_result ply_read_fast(ply_reader *r, const ply_element *e, bool *done, svo_error *err)
{
    *done = false;
    bool faces = e->kind == PLY_FACE;
    fast_job j = {.r = r, .e = e, .soup = &r->soup, .vertices = soup_vertex_count(&r->soup)};
    bool first_of_kind = faces ? r->soup.sizes.size == 0 : r->soup.positions.size == 0;
    bool regular = faces ? plain_faces(e) : e->kind == PLY_VERTEX && only_scalars(e) && uses(e, PLY_X) && uses(e, PLY_Y) && uses(e, PLY_Z);
    if (r->irregular || e->count == 0) return SVO_OK;
    if (!regular || !first_of_kind || e->count >= SVO_NONE) {
        r->irregular = r->ascii; /* lines are counted from the last regular element */
        return SVO_OK;
    }
    svo_result result = SVO_OK;
    if (r->ascii && r->lines == NULL) result = cut_lines(r, err);
    if (result == SVO_OK) result = r->ascii ? read_ascii(&j, faces, done, err) : read_binary(&j, faces, done, err);
    r->irregular = r->ascii && !*done;
    return result;
}
