/* Faces of cells, merged, and as PLY; as GLB in fmt_cells_glb.c. */
#include <stdio.h>
#include <string.h>

#include "fmt_cells.h"
#include "fmt_container.h"
#include "fmti_cells.h"

/* --- faces --- */

typedef struct keyed { uint64_t key; uint32_t value, unused; } keyed;

enum { DIGIT = 11, BINS = 1 << DIGIT };

/* By key, stable; `other` is scratch. Returns where the result is. Digits that all keys share are skipped. */
static keyed *sort_keys(keyed *from, keyed *other, uint64_t count)
{
    for (uint32_t shift = 0; shift < 64; shift += DIGIT) {
        uint64_t bins[BINS] = {0}, sum = 0;
        for (uint64_t i = 0; i < count; i++) bins[from[i].key >> shift & (BINS - 1)]++;
        if (count != 0 && bins[from[0].key >> shift & (BINS - 1)] == count) continue;
        for (uint32_t b = 0; b < BINS; b++) {
            uint64_t n = bins[b];
            bins[b] = sum;
            sum += n;
        }
        for (uint64_t i = 0; i < count; i++) other[bins[from[i].key >> shift & (BINS - 1)]++] = from[i];
        keyed *t = from;
        from = other;
        other = t;
    }
    return from;
}

typedef struct mesher {
    const fmt_cells *c;
    keyed *a, *b;
    svo_buffer *out;
    bool apart; /* one cell a face */
    svo_buffer rows[2]; /* numbers of the faces that end in the last row, in this row */
} mesher;

static fmt_cell_face *face(const mesher *m, uint32_t i) { return (fmt_cell_face *)(void *)m->out->data + i; }

/* Turn sorted unit faces (key: slice, v, u) of one side into rectangles. */
static svo_result merge(mesher *m, const keyed *unit, uint64_t count, uint8_t axis, uint8_t up, svo_error *err)
{
    static const uint64_t mask = (1 << 21) - 1;
    svo_buffer *last = &m->rows[0], *now = &m->rows[1];
    last->size = now->size = 0;
    size_t candidate = 0;
    uint64_t row = UINT64_MAX;
    for (uint64_t i = 0; i < count;) {
        uint64_t key = unit[i].key, end = i + 1;
        while (!m->apart && end < count && unit[end].key == unit[end - 1].key + 1 && unit[end].value == unit[i].value && (unit[end].key & mask) != 0) end++;
        if (key >> 21 != row) { /* a new row: what was this row is the last one, if it is right below */
            svo_buffer *t = last;
            last = now, now = t;
            if (key >> 21 != row + 1 || (key >> 21 & mask) == 0) last->size = 0;
            now->size = 0;
            candidate = 0;
            row = key >> 21;
        }
        uint32_t low = (uint32_t)(key & mask), high = low + (uint32_t)(end - i), number;
        const uint32_t *earlier = (const uint32_t *)(const void *)last->data;
        while (candidate < last->size / 4 && face(m, earlier[candidate])->low[0] < low) candidate++;
        fmt_cell_face *f = candidate < last->size / 4 ? face(m, earlier[candidate]) : NULL;
        if (!m->apart && f != NULL && f->low[0] == low && f->high[0] == high && memcmp(f->rgb, &unit[i].value, 4) == 0) {
            f->high[1]++;
            number = earlier[candidate];
        } else {
            uint32_t v = (uint32_t)(key >> 21 & mask);
            fmt_cell_face n = {.slice = (uint32_t)(key >> 42) + up, .low = {low, v}, .high = {high, v + 1}, .axis = axis, .up = up};
            memcpy(n.rgb, &unit[i].value, 4);
            if (m->out->size / sizeof n >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "more than 2^32 faces; export a coarser level");
            number = (uint32_t)(m->out->size / sizeof n);
            if (svo_buffer_append(m->out, &n, sizeof n) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the faces");
        }
        if (svo_buffer_append(now, &number, sizeof number) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the faces");
        i = end;
    }
    return SVO_OK;
}

/* Faces across one axis: cells in order along it tell which have a neighbour. */
static svo_result across(mesher *m, uint8_t axis, svo_error *err)
{
    const fmt_cells *c = m->c;
    uint32_t u = (axis + 1u) % 3, v = (axis + 2u) % 3;
    for (uint8_t up = 0; up < 2; up++) {
        for (uint64_t i = 0; i < c->count; i++) {
            const uint32_t *at = c->cell[i].at;
            m->a[i] = (keyed){(uint64_t)at[v] << 42 | (uint64_t)at[u] << 21 | at[axis], (uint32_t)i, 0};
        }
        keyed *lines = sort_keys(m->a, m->b, c->count), *faces = lines == m->a ? m->b : m->a;
        uint64_t count = 0;
        for (uint64_t i = 0; i < c->count; i++) {
            uint64_t key = lines[i].key, mask = (1 << 21) - 1;
            bool covered = up ? i + 1 < c->count && lines[i + 1].key == key + 1 && (lines[i + 1].key & mask) != 0
                              : i > 0 && lines[i - 1].key + 1 == key && (key & mask) != 0;
            if (covered) continue;
            keyed f = {(key & mask) << 42 | (key >> 42) << 21 | (key >> 21 & mask), 0, 0};
            memcpy(&f.value, c->cell[lines[i].value].rgb, 4);
            faces[count++] = f;
        }
        keyed *sorted = sort_keys(faces, lines, count);
        SVO_TRY(merge(m, sorted, count, axis, up, err));
    }
    return SVO_OK;
}

svo_result fmti_cells_faces(const fmt_cells *c, bool apart, svo_buffer *out, svo_error *err)
{
    if (c->count == 0) return SVO_OK;
    if (c->count > UINT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu cells are too many for a mesh; export a coarser level", (unsigned long long)c->count);
    mesher m = {.c = c, .out = out, .apart = apart};
    m.a = svo_alloc(c->allocator, c->count, sizeof *m.a);
    m.b = svo_alloc(c->allocator, c->count, sizeof *m.b);
    for (int i = 0; i < 2; i++) svo_buffer_init(&m.rows[i], c->allocator);
    svo_result r = m.a != NULL && m.b != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the faces of %llu cells", (unsigned long long)c->count);
    for (uint8_t axis = 0; axis < 3 && r == SVO_OK; axis++) r = across(&m, axis, err);
    for (int i = 0; i < 2; i++) svo_buffer_free(&m.rows[i]);
    svo_free(c->allocator, m.a, c->count, sizeof *m.a);
    svo_free(c->allocator, m.b, c->count, sizeof *m.b);
    return r;
}

svo_result fmt_cells_faces(const fmt_cells *c, svo_buffer *out, svo_error *err) { return fmti_cells_faces(c, false, out, err); }

/* Corner k of a face, counter-clockwise from outside (where the grid is right-handed). */
static void corner(const fmt_cell_face *f, uint32_t k, uint32_t out[3])
{
    if (!f->up) k = 3 - k;
    out[f->axis] = f->slice;
    out[(f->axis + 1) % 3] = k == 1 || k == 2 ? f->high[0] : f->low[0];
    out[(f->axis + 2) % 3] = k >= 2 ? f->high[1] : f->low[1];
}

/* --- PLY --- */

void fmt_cell_corner(const fmt_cell_face *f, uint32_t k, uint32_t out[3]) { corner(f, k, out); }

static svo_result write_vertices(const fmt_cells_placed *p, bool colored, fmt_output *out, svo_error *err)
{
    const double *m = p->to_world;
    const double det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) + m[2] * (m[4] * m[9] - m[5] * m[8]);
    for (uint64_t i = 0; i < p->count; i++) {
        uint8_t row[4 * 27];
        size_t at = 0;
        for (uint32_t k = 0; k < 4; k++) {
            const uint32_t turned = det < 0 ? 3 - k : k;
            uint32_t cell[3] = {0};
            double c[3];
            if (p->bent == NULL) corner(&p->faces[i], turned, cell);
            for (int r = 0; r < 3; r++) c[r] = p->bent == NULL ? (double)cell[r] : (double)p->bent[i].corner[turned][r];
            for (int r = 0; r < 3; r++, at += 8) {
                double w = m[4 * r] * c[0] + m[4 * r + 1] * c[1] + m[4 * r + 2] * c[2] + m[4 * r + 3];
                memcpy(row + at, &w, 8);
            }
            if (colored) {
                memcpy(row + at, p->bent == NULL ? p->faces[i].rgb : p->bent[i].rgb, 3);
                at += 3;
            }
        }
        SVO_TRY(fmt_output_write(out, row, at, err));
    }
    return SVO_OK;
}

svo_result fmt_cells_placed_ply(const fmt_cells_placed *list, uint64_t placed, bool colored, fmt_output *out, svo_error *err)
{
    char head[400];
    uint64_t count = 0;
    for (uint64_t i = 0; i < placed; i++) {
        count += list[i].count;
        if (count > UINT32_MAX / 4) return svo_fail(err, SVO_LIMIT, "more than 2^30 faces; export a coarser level");
    }
    int n = snprintf(head, sizeof head, "ply\nformat binary_little_endian 1.0\ncomment faces of voxels\nelement vertex %llu\nproperty double x\nproperty double y\n"
                     "property double z\n%selement face %llu\nproperty list uchar uint vertex_indices\nend_header\n", (unsigned long long)(4 * count),
                     colored ? "property uchar red\nproperty uchar green\nproperty uchar blue\n" : "", (unsigned long long)count);
    SVO_TRY(fmt_output_write(out, head, (size_t)n, err));
    for (uint64_t i = 0; i < placed; i++) SVO_TRY(write_vertices(&list[i], colored, out, err));
    for (uint64_t i = 0; i < count; i++) {
        uint8_t row[17] = {4};
        for (uint32_t k = 0; k < 4; k++) fmt_store32(row + 1 + 4 * k, (uint32_t)(4 * i + k));
        SVO_TRY(fmt_output_write(out, row, sizeof row, err));
    }
    return SVO_OK;
}
