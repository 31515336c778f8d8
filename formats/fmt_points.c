/* Points: what their two readings share. Windows of rows are read in parallel; import_points_text.c reads those of text. */
#include "fmt_points.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "import_points.h"
#include "import_text.h"
#include "svo_samples.h"
#include "svo_task.h"

enum { ROWS = 1 << 16, GRAIN = 1 << 12 };

struct fmt_points {
    fmt_points_options o;
    import_context context;
    fmt_bytes file;
    point_rows rows;
    const uint8_t *data, *p;
    uint64_t left; /* rows of a PLY */
    double scale;  /* what a colour of 1 is in the file */
    float linear[256];
    svo_buffer raw, points;
    fmt_points_survey seen;
};

/* --- is it one? --- */

static bool ply_of_points(const ply_reader *r)
{
    bool points = false;
    for (uint32_t i = 0; i < r->element_count; i++) {
        const ply_element *e = &r->elements[i];
        if ((e->kind == PLY_FACE || e->kind == PLY_TRISTRIPS) && e->count != 0) return false;
        points |= e->kind == PLY_VERTEX && e->count != 0;
    }
    return points;
}

static bool text_name(const char *path)
{
    static const char *const names[] = {"xyz", "pts", "xyzn", "xyzrgb", "asc"};
    const char *dot = strrchr(path, '.');
    for (size_t i = 0; dot != NULL && i < sizeof names / sizeof *names; i++)
        if (strcasecmp(dot + 1, names[i]) == 0) return true;
    return false;
}

static svo_result read_header(fmt_points *f, ply_reader *r, svo_error *err)
{
    r->c = &f->context;
    r->p = f->file.data;
    r->end = f->file.data + f->file.size;
    soup_init(&r->soup, &f->context);
    svo_result result = ply_read_header(r, err);
    soup_free(&r->soup); /* names of textures */
    return result;
}

static bool begins_ply(const fmt_bytes *b) { return b->size > 4 && memcmp(b->data, "ply", 3) == 0 && import_space((char)b->data[3]); }

bool fmt_is_points(const char *path)
{
    fmt_points f = {0};
    bool is = text_name(path);
    if (is || strcmp(path, "-") == 0 || fmt_bytes_open(path, 1, NULL, &f.file, NULL) != SVO_OK) return is; /* what cannot be mapped is not read twice */
    ply_reader *r = svo_calloc(NULL, 1, sizeof *r);
    f.context.path = path;
    if (r != NULL && f.file.mapped && begins_ply(&f.file)) is = read_header(&f, r, NULL) == SVO_OK && ply_of_points(r);
    svo_free(NULL, r, 1, sizeof *r);
    fmt_bytes_close(&f.file);
    return is;
}

/* --- columns --- */

static int slot_of(ply_use use)
{
    switch (use) {
    case PLY_X: case PLY_Y: case PLY_Z: return POINT_X + (int)(use - PLY_X);
    case PLY_R: case PLY_G: case PLY_B: return POINT_R + (int)(use - PLY_R);
    case PLY_NX: case PLY_NY: case PLY_NZ: return POINT_NX + (int)(use - PLY_NX);
    case PLY_INTENSITY: return POINT_I;
    default: return -1;
    }
}

static svo_result columns_of_ply(fmt_points *f, const ply_reader *r, svo_error *err)
{
    const char *path = f->context.path;
    point_rows *rows = &f->rows;
    const ply_element *e = NULL;
    for (uint32_t i = 0; i < r->element_count && e == NULL; i++) {
        if (r->elements[i].kind == PLY_VERTEX) e = &r->elements[i];
        else if (r->elements[i].count != 0) return svo_fail(err, SVO_UNSUPPORTED, "%s: PLY element %s before the points", path, r->elements[i].name);
    }
    SVO_ASSERT(e != NULL);
    rows->ascii = r->ascii;
    rows->big = r->big_endian;
    rows->column_count = e->property_count;
    uint64_t stride = 0;
    for (uint32_t i = 0; i < e->property_count; i++) {
        const ply_property *q = &e->properties[i];
        if (q->list != PLY_NONE) return svo_fail(err, SVO_UNSUPPORTED, "%s: points with a list are not read", path);
        const int slot = slot_of(q->use);
        rows->columns[i] = (point_column){slot, q->type, (uint32_t)stride};
        if (slot >= 0) rows->has[slot] = true;
        if (slot == POINT_R) f->scale = q->type == PLY_U16 ? 65535 : ply_is_integer(q->type) ? 255 : 1;
        if (slot == POINT_I) f->seen.intensity_bytes = q->type == PLY_U8;
        stride += ply_type_size(q->type);
    }
    rows->stride = stride;
    f->left = e->count;
    f->data = r->p;
    const uint64_t least = r->ascii ? 2 * (uint64_t)e->property_count : stride, there = (uint64_t)(f->file.data + f->file.size - r->p) + (r->ascii ? 1 : 0);
    if (!rows->has[POINT_X] || !rows->has[POINT_Y] || !rows->has[POINT_Z]) return svo_fail(err, SVO_INVALID_DATA, "%s: PLY vertices have no x, y and z", path);
    if (e->count > there / least)
        return svo_fail(err, SVO_INVALID_DATA, "%s: the PLY header counts %llu points, more than the file can hold", path, (unsigned long long)e->count);
    return SVO_OK;
}

/* --- rows --- */

typedef struct binary_job {
    const point_rows *rows;
    const uint8_t *p;
    point_raw *out;
} binary_job;

static svo_result binary_rows(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    const binary_job *j = user;
    for (uint64_t i = begin; i < end; i++) {
        const uint8_t *p = j->p + i * j->rows->stride;
        for (uint32_t k = 0; k < j->rows->column_count; k++) {
            const point_column *c = &j->rows->columns[k];
            if (c->slot < 0) continue;
            const double v = ply_load(p + c->offset, c->type, j->rows->big);
            if (c->slot <= POINT_Z) j->out[i].at[c->slot] = v;
            else j->out[i].more[c->slot - POINT_R] = (float)v;
        }
    }
    return SVO_OK;
}

/* The next rows as they are in the file; *count 0 at the end. */
static svo_result next_rows(fmt_points *f, const point_raw **out, uint64_t *count, svo_error *err)
{
    const uint8_t *begin = f->p, *end = f->file.data + f->file.size;
    f->raw.size = 0;
    if (f->rows.ascii) {
        SVO_TRY(import_points_text(&f->rows, f->context.path, f->file.data, &f->p, end, &f->left, f->o.threads, &f->raw, err));
    } else {
        const uint64_t n = f->left < ROWS ? f->left : ROWS;
        binary_job j = {&f->rows, f->p, n != 0 ? svo_buffer_append(&f->raw, NULL, n * sizeof(point_raw)) : NULL};
        if (n != 0 && j.out == NULL) return import_no_memory(err);
        SVO_TRY(svo_parallel_for(f->o.threads, n, GRAIN, binary_rows, &j, err));
        f->p += n * f->rows.stride;
        f->left -= n;
    }
    if (f->file.mapped && f->p > begin) fmt_bytes_forget(begin, (uint64_t)(f->p - begin));
    *out = (const point_raw *)(const void *)f->raw.data;
    *count = f->raw.size / sizeof(point_raw);
    return SVO_OK;
}

static bool is_finite3(const double *v) { return isfinite(v[0]) && isfinite(v[1]) && isfinite(v[2]); }

static float to_linear(const fmt_points *f, float v)
{
    if (f->scale == 255 && v >= 0 && v <= 255 && v == (float)(uint8_t)v) return f->linear[(uint8_t)v];
    return import_srgb_to_linear((double)v / f->scale);
}

static void convert(const fmt_points *f, const point_raw *r, fmt_point *p)
{
    const fmt_points_survey *s = &f->seen;
    *p = (fmt_point){.at = {r->at[0], r->at[1], r->at[2]}};
    const float *c = r->more, *n = r->more + 3, i = r->more[6];
    if (s->has_color && !isnan(c[0]) && !isnan(c[1]) && !isnan(c[2])) {
        p->has |= SVO_SAMPLE_COLOR;
        for (int k = 0; k < 3; k++) p->color[k] = to_linear(f, c[k]);
    }
    if (s->has_normal && isfinite(n[0]) && isfinite(n[1]) && isfinite(n[2]) && (n[0] != 0 || n[1] != 0 || n[2] != 0)) {
        p->has |= SVO_SAMPLE_NORMAL;
        memcpy(p->normal, n, sizeof p->normal);
    }
    if (s->has_intensity && isfinite(i)) {
        p->has |= SVO_SAMPLE_VALUE;
        p->intensity = i;
    }
}

/* --- the first reading --- */

static void survey_row(fmt_points *f, const point_raw *r, point_raw *first, float *most)
{
    fmt_points_survey *s = &f->seen;
    s->points++;
    if (!is_finite3(r->at)) {
        s->not_finite++;
        return;
    }
    const bool begins = s->points - s->not_finite == 1;
    for (int k = 0; k < 3; k++) {
        if (begins || r->at[k] < s->low[k]) s->low[k] = r->at[k];
        if (begins || r->at[k] > s->high[k]) s->high[k] = r->at[k];
    }
    if (begins) *first = *r;
    for (int k = 0; k < 3; k++) {
        if (r->more[k] > *most) *most = r->more[k];
        if (r->more[k] != first->more[k]) s->one_color = false;
    }
    const double i = (double)r->more[6];
    if (!isfinite(i)) return;
    if (i < s->intensity_low) s->intensity_low = i;
    if (i > s->intensity_high) s->intensity_high = i;
}

static svo_result survey(fmt_points *f, svo_error *err)
{
    fmt_points_survey *s = &f->seen;
    const bool *has = f->rows.has;
    s->has_color = has[POINT_R] && has[POINT_G] && has[POINT_B];
    s->has_normal = has[POINT_NX] && has[POINT_NY] && has[POINT_NZ];
    s->has_intensity = has[POINT_I];
    s->one_color = true;
    s->intensity_low = INFINITY;
    s->intensity_high = -INFINITY;
    const uint64_t left = f->left;
    point_raw first = {0};
    float most = 0;
    f->p = f->data;
    for (;;) {
        const point_raw *rows;
        uint64_t n;
        SVO_TRY(next_rows(f, &rows, &n, err));
        if (n == 0) break;
        for (uint64_t i = 0; i < n; i++) survey_row(f, &rows[i], &first, &most);
    }
    if (!(s->intensity_low <= s->intensity_high)) s->intensity_low = s->intensity_high = 0;
    if (s->points == 0) return svo_fail(err, SVO_INVALID_DATA, "%s: no points in it", f->context.path);
    if (s->has_color && f->scale == 1 && most > 1) {
        f->scale = most > 255 ? 65535 : 255;
        if (!f->rows.ascii) svo_warn(f->o.warnings, "%s: colours exceed 1; all are taken as 0..%g", f->context.path, f->scale);
    }
    for (int k = 0; k < 256; k++) f->linear[k] = import_srgb_to_linear(k / 255.0);
    for (int k = 0; k < 3; k++) s->color[k] = to_linear(f, first.more[k]);
    if (s->not_finite != 0)
        svo_warn(f->o.warnings, "%s: %llu points have a coordinate that is no number; they are left out", f->context.path, (unsigned long long)s->not_finite);
    f->p = f->data;
    f->left = left;
    return SVO_OK;
}

/* --- the interface --- */

static svo_result open_rows(fmt_points *f, svo_error *err)
{
    if (f->file.size == 0) return svo_fail(err, SVO_INVALID_DATA, "%s: the file is empty", f->context.path);
    if (!begins_ply(&f->file)) {
        f->data = f->file.data;
        f->left = UINT64_MAX;
        f->rows.free_text = f->rows.ascii = true;
        return import_points_columns(&f->rows, f->context.path, f->file.data, f->file.size, f->o.columns, f->seen.columns, err);
    }
    if (f->o.columns != NULL) return svo_fail(err, SVO_INVALID_ARGUMENT, "%s: --columns is for text; a PLY file names its columns itself", f->context.path);
    ply_reader *r = svo_calloc(f->o.allocator, 1, sizeof *r);
    if (r == NULL) return import_no_memory(err);
    svo_result result = read_header(f, r, err);
    if (result == SVO_OK && !ply_of_points(r)) result = svo_fail(err, SVO_INVALID_DATA, "%s: a mesh, or nothing; not points", f->context.path);
    if (result == SVO_OK) result = columns_of_ply(f, r, err);
    svo_free(f->o.allocator, r, 1, sizeof *r);
    return result;
}

svo_result fmt_points_open(const char *path, const fmt_points_options *options, fmt_points **out, svo_error *err)
{
    fmt_points *f = svo_calloc(options->allocator, 1, sizeof *f);
    if (f == NULL) return import_no_memory(err);
    f->o = *options;
    f->scale = 1;
    f->context.path = path;
    f->context.allocator = options->allocator;
    f->context.warnings = options->warnings;
    svo_buffer_init(&f->raw, options->allocator);
    svo_buffer_init(&f->points, options->allocator);
    svo_result r = fmt_bytes_open(path, 1, NULL, &f->file, err);
    if (r == SVO_LIMIT || (r == SVO_OK && f->file.size != 0 && !f->file.mapped))
        r = svo_fail(err, SVO_UNSUPPORTED, "%s: points are read twice, from a file and not from a pipe", path);
    if (r == SVO_OK && f->o.file_read != NULL) f->file.beside = f->o.file_read(f->o.file_read_user, path, f->file.data, f->file.size, f->file.mapped);
    if (r == SVO_OK) r = open_rows(f, err);
    if (r == SVO_OK) r = survey(f, err);
    if (r == SVO_OK) *out = f;
    else fmt_points_close(f);
    return r;
}

const fmt_points_survey *fmt_points_seen(const fmt_points *p) { return &p->seen; }

svo_result fmt_points_next(fmt_points *f, const fmt_point **out, uint64_t *count, svo_error *err)
{
    *count = 0;
    while (*count == 0) {
        const point_raw *rows;
        uint64_t n;
        SVO_TRY(next_rows(f, &rows, &n, err));
        if (n == 0) return SVO_OK;
        f->points.size = 0;
        fmt_point *to = svo_buffer_append(&f->points, NULL, n * sizeof *to);
        if (to == NULL) return import_no_memory(err);
        for (uint64_t i = 0; i < n; i++)
            if (is_finite3(rows[i].at)) convert(f, &rows[i], &to[(*count)++]);
        *out = to;
    }
    return SVO_OK;
}

svo_result fmt_points_unchanged(const fmt_points *f, svo_error *err) { return fmt_bytes_unchanged(f->context.path, &f->file, err); }

void fmt_points_close(fmt_points *f)
{
    if (f == NULL) return;
    fmt_bytes_close(&f->file);
    svo_buffer_free(&f->raw);
    svo_buffer_free(&f->points);
    svo_free(f->o.allocator, f, 1, sizeof *f);
}
