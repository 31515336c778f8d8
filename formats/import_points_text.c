/* Points as lines of numbers: .xyz, .pts and their kin, and the rows of ASCII PLY. */
#include "import_points.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "import_text.h"
#include "svo_task.h"

enum { PIECE = 1 << 16, PIECES = 16, GUESS_ROWS = 1000, GUESS_COLUMNS = 10 };

static const char *const names[POINT_SLOTS] = {"x", "y", "z", "r", "g", "b", "nx", "ny", "nz", "i"};

static bool separator(char c) { return import_blank(c) || c == ',' || c == ';'; }

/* The next word of a line; its end, or NULL when there is none. A comma between two words is no word. */
static const char *next_word(const char **p, const char *end)
{
    while (*p < end && separator(**p)) (*p)++;
    const char *stop = *p;
    while (stop < end && !separator(*stop)) stop++;
    return stop > *p ? stop : NULL;
}

static uint32_t count_words(const char *p, const char *end, uint32_t most)
{
    uint32_t n = 0;
    for (const char *stop; n < most && (stop = next_word(&p, end)) != NULL; p = stop) n++;
    return n;
}

/* Is the line a row? Not blank lines; in free text not comments, counts (a number alone) and names either. */
static bool is_row(const point_rows *rows, const char *p, const char *end)
{
    p = import_skip_blank(p, end);
    if (p == end) return false;
    if (!rows->free_text) return true;
    if (!(import_digit(*p) || *p == '-' || *p == '+' || *p == '.' || *p == 'n' || *p == 'N' || *p == 'i' || *p == 'I')) return false;
    if (*p == 'n' || *p == 'N' || *p == 'i' || *p == 'I') { /* nan and inf are numbers, a heading is not */
        double v;
        const char *word = p, *stop = next_word(&word, end);
        if (stop == NULL || import_double(word, stop, &v) != stop) return false;
    }
    return count_words(p, end, 2) == 2;
}

/* --- columns --- */

static svo_result asked_columns(point_rows *rows, const char *asked, svo_error *err)
{
    for (const char *p = asked;; p++) {
        const size_t n = strcspn(p, ",");
        int slot = -1;
        for (int k = 0; k < POINT_SLOTS; k++)
            if (strlen(names[k]) == n && memcmp(names[k], p, n) == 0) slot = k;
        if ((slot < 0 && !(n == 1 && *p == '-')) || (slot >= 0 && rows->has[slot]) || rows->column_count == PLY_MAX_PROPERTIES)
            return svo_fail(err, SVO_INVALID_ARGUMENT, "--columns %.60s: wants x y z r g b nx ny nz i, each at most once, or -, with commas between", asked);
        rows->columns[rows->column_count++] = (point_column){slot, PLY_F64, 0};
        if (slot >= 0) rows->has[slot] = true;
        p += n;
        if (*p == 0) break;
    }
    if (!rows->has[POINT_X] || !rows->has[POINT_Y] || !rows->has[POINT_Z]) return svo_fail(err, SVO_INVALID_ARGUMENT, "--columns %.60s: wants x, y and z", asked);
    return SVO_OK;
}

/* What three columns after the place hold: normals have negative values or length 1, colours are none of that. */
static bool are_normals(const double *v, uint64_t rows, uint32_t columns, uint32_t first)
{
    bool unit = true;
    for (uint64_t i = 0; i < rows; i++) {
        const double *n = v + i * columns + first;
        const double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        if (n[0] < 0 || n[1] < 0 || n[2] < 0) return true;
        if (!(fabs(length - 1) < 0.01)) unit = false;
    }
    return unit;
}

static void guess(point_rows *rows, const double *v, uint64_t count, uint32_t columns)
{
    static const char *const forms[] = {"x,y,z", "x,y,z,i", "x,y,z,r,g,b", "x,y,z,nx,ny,nz", "x,y,z,i,r,g,b", "x,y,z,r,g,b,nx,ny,nz", "x,y,z,nx,ny,nz,r,g,b", "x,y,z,i,r,g,b,nx,ny,nz"};
    int form = 0;
    if (columns == 4) form = 1;
    else if (columns == 6) form = are_normals(v, count, columns, 3) ? 3 : 2;
    else if (columns == 7) form = 4;
    else if (columns == 9) form = are_normals(v, count, columns, 3) && !are_normals(v, count, columns, 6) ? 6 : 5;
    else if (columns == 10) form = 7;
    (void)asked_columns(rows, forms[form], NULL);
}

svo_result import_points_columns(point_rows *rows, const char *path, const uint8_t *data, uint64_t size, const char *asked, char told[48], svo_error *err)
{
    if (asked != NULL) {
        SVO_TRY(asked_columns(rows, asked, err));
    } else {
        double v[GUESS_ROWS * GUESS_COLUMNS];
        uint64_t count = 0;
        uint32_t columns = 0;
        for (const char *p = (const char *)data, *end = p + size; p < end && count < GUESS_ROWS;) {
            const char *stop = import_line_end(p, end), *q = p;
            const bool row = is_row(rows, p, stop);
            p = stop < end ? stop + 1 : end;
            if (!row) continue;
            if (columns == 0) {
                columns = count_words(q, stop, GUESS_COLUMNS + 1);
                if (columns < 3) return svo_fail(err, SVO_INVALID_DATA, "%s: a line of %u numbers is no point", path, columns);
                if (columns > GUESS_COLUMNS) columns = 3;
            }
            uint32_t k = 0;
            for (const char *word; k < columns && (word = next_word(&q, stop)) != NULL; q = word, k++)
                if (import_double(q, word, &v[count * columns + k]) != word) break;
            if (k < columns) break; /* the reading of all says what is wrong */
            count++;
        }
        guess(rows, v, count, columns);
    }
    told[0] = 0;
    for (uint32_t i = 0; i < rows->column_count; i++) {
        const char *name = rows->columns[i].slot >= 0 ? names[rows->columns[i].slot] : "-";
        const size_t n = strlen(told);
        if (n + strlen(name) + 2 < 48) snprintf(told + n, 48 - n, "%s%s", n != 0 ? "," : "", name);
    }
    return SVO_OK;
}

/* --- rows --- */

typedef struct piece {
    const char *begin, *end;
    uint64_t first, rows;
} piece;

typedef struct text_job {
    const point_rows *rows;
    const char *path, *base;
    uint64_t most;
    point_raw *out;
    piece pieces[PIECES + 1];
} text_job;

static svo_result count_rows(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    text_job *j = user;
    for (uint64_t i = begin; i < end; i++) {
        piece *p = &j->pieces[i];
        for (const char *q = p->begin, *stop; q < p->end; q = stop < p->end ? stop + 1 : p->end) {
            stop = import_line_end(q, p->end);
            p->rows += is_row(j->rows, q, stop);
        }
    }
    return SVO_OK;
}

static bool read_row(const point_rows *rows, const char *p, const char *end, point_raw *out)
{
    for (uint32_t k = 0; k < rows->column_count; k++) {
        const char *stop = next_word(&p, end);
        double v;
        if (stop == NULL) return false;
        const int slot = rows->columns[k].slot;
        if (slot >= 0) {
            if (import_double(p, stop, &v) != stop) return false;
            if (slot <= POINT_Z) out->at[slot] = v;
            else out->more[slot - POINT_R] = (float)v;
        }
        p = stop;
    }
    return true;
}

static svo_result read_rows(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    const text_job *j = user;
    for (uint64_t i = begin; i < end; i++) {
        const piece *p = &j->pieces[i];
        uint64_t row = p->first;
        for (const char *q = p->begin, *stop; q < p->end && row < j->most; q = stop < p->end ? stop + 1 : p->end) {
            stop = import_line_end(q, p->end);
            if (!is_row(j->rows, q, stop)) continue;
            if (!read_row(j->rows, q, stop, &j->out[row++]))
                return svo_fail(err, SVO_INVALID_DATA, "%s: byte %llu: a line that is not a point of %u numbers", j->path, (unsigned long long)(q - j->base), j->rows->column_count);
        }
    }
    return SVO_OK;
}

svo_result import_points_text(const point_rows *rows, const char *path, const uint8_t *base, const uint8_t **at, const uint8_t *end, uint64_t *left, uint32_t threads,
                              svo_buffer *out, svo_error *err)
{
    text_job j = {.rows = rows, .path = path, .base = (const char *)base};
    const char *p = (const char *)*at, *last = (const char *)end;
    uint64_t count = 0, total = 0;
    while (total == 0 && p < last && *left != 0) { /* windows without a row are passed over */
        for (count = 0; count < PIECES && p < last; count++) {
            piece *n = &j.pieces[count];
            n->rows = 0;
            n->begin = p;
            n->end = last - p <= PIECE ? last : import_line_end(p + PIECE, last);
            p = n->end < last ? n->end + 1 : last;
        }
        SVO_TRY(svo_parallel_for(threads, count, 1, count_rows, &j, err));
        for (uint64_t i = 0; i < count; i++) {
            j.pieces[i].first = total;
            total += j.pieces[i].rows;
        }
    }
    j.most = total < *left ? total : *left;
    if (j.most == 0 && !rows->free_text && *left != 0) return svo_fail(err, SVO_INVALID_DATA, "%s: the file ends before its last point", path);
    if (j.most != 0) {
        j.out = svo_buffer_append(out, NULL, j.most * sizeof *j.out);
        if (j.out == NULL) return import_no_memory(err);
        SVO_TRY(svo_parallel_for(threads, count, 1, read_rows, &j, err));
    }
    *left -= j.most;
    *at = (const uint8_t *)p;
    return SVO_OK;
}
