#include "svo_soup.h"

#include <string.h>

svo_soup_layout svo_soup_layout_make(bool wide, bool normals, const bool uvs[SVO_MAX_UV_SETS], bool colors)
{
    svo_soup_layout l = {.wide = wide, .normals = normals, .colors = colors};
    l.stride = (wide ? 72u : 36u) + (normals ? 36u : 0u) + (colors ? 48u : 0u);
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) {
        l.uvs[u] = uvs[u];
        l.stride += uvs[u] ? 24u : 0u;
    }
    return l;
}

svo_soup_layout svo_soup_layout_of(const svo_part *part)
{
    if (part->soup != NULL) return part->soup->layout;
    bool uvs[SVO_MAX_UV_SETS], wide = false;
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) uvs[u] = part->uvs[u] != NULL;
    for (uint64_t i = 0; i < 3 * part->vertex_count && !wide; i++) {
        double v = part->positions[i];
        wide = v == v && (double)(float)v != v; /* a NaN is as good in a float */
    }
    return svo_soup_layout_make(wide, part->normals != NULL, uvs, part->colors != NULL);
}

void svo_soup_pack(const svo_soup_layout *l, const svo_part *part, uint64_t local, uint8_t *to)
{
    const uint32_t *index = part->indices + 3 * local;
    for (int k = 0; k < 3; k++) {
        const double *p = part->positions + 3 * (uint64_t)index[k];
        float f[3] = {(float)p[0], (float)p[1], (float)p[2]};
        size_t n = l->wide ? 24 : 12;
        memcpy(to, l->wide ? (const void *)p : f, n);
        to += n;
    }
    for (int k = 0; k < 3 && l->normals; k++, to += 12) memcpy(to, part->normals + 3 * (uint64_t)index[k], 12);
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++)
        for (int k = 0; k < 3 && l->uvs[u]; k++, to += 8) memcpy(to, part->uvs[u] + 2 * (uint64_t)index[k], 8);
    for (int k = 0; k < 3 && l->colors; k++, to += 16) memcpy(to, part->colors + 4 * (uint64_t)index[k], 16);
}

void svo_soup_corners(const svo_soup_layout *l, const uint8_t *record, double corner[9])
{
    if (l->wide) {
        memcpy(corner, record, 72);
        return;
    }
    float f[9];
    memcpy(f, record, sizeof f);
    for (int i = 0; i < 9; i++) corner[i] = (double)f[i];
}

void svo_soup_unpack(const svo_soup_layout *l, const uint8_t *record, svo_part *part, uint64_t local)
{
    svo_soup_corners(l, record, part->positions + 9 * local);
    record += l->wide ? 72 : 36;
    if (l->normals) {
        memcpy(part->normals + 9 * local, record, 36);
        record += 36;
    }
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++)
        if (l->uvs[u]) {
            memcpy(part->uvs[u] + 6 * local, record, 24);
            record += 24;
        }
    if (l->colors) memcpy(part->colors + 12 * local, record, 48);
}

struct svo_soup_file {
    const svo_allocator *allocator;
    svo_spill_file file;
    uint64_t references;
};

svo_result svo_soup_file_create(const svo_spill *spill, const svo_allocator *a, svo_soup_file **out, svo_error *err)
{
    svo_soup_file *f = svo_calloc(a, 1, sizeof *f);
    if (f == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    f->allocator = a;
    f->references = 1;
    svo_result r = svo_spill_open(spill, &f->file, err);
    if (r != SVO_OK) {
        svo_free(a, f, 1, sizeof *f);
        return r;
    }
    *out = f;
    return SVO_OK;
}

void svo_soup_file_release(svo_soup_file *f)
{
    if (f == NULL || --f->references != 0) return;
    svo_spill_close(&f->file);
    svo_free(f->allocator, f, 1, sizeof *f);
}

/* Do all corners so far have one colour? */
static void note_colors(struct svo_soup *s, const uint8_t *records, uint64_t count, bool first)
{
    const uint32_t stride = s->layout.stride;
    if (!s->layout.colors) return;
    if (first) memcpy(s->color, records + stride - 48, sizeof s->color);
    for (uint64_t i = 0; i < count && !s->many_colors; i++)
        for (uint32_t k = 0; k < 3; k++) s->many_colors |= memcmp(records + (i + 1) * stride - 48 + 16 * k, s->color, sizeof s->color) != 0;
}

svo_result svo_soup_append(svo_part *part, svo_soup_file *file, const svo_soup_layout *layout, const svo_allocator *a, const uint8_t *records,
                           uint64_t count, svo_error *err)
{
    if (count == 0) return SVO_OK;
    if (part->soup == NULL) {
        struct svo_soup *s = svo_calloc(a, 1, sizeof *s);
        if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
        s->allocator = a;
        s->file = file;
        s->layout = *layout;
        svo_buffer_init(&s->pieces, a);
        file->references++;
        part->soup = s;
    }
    struct svo_soup *s = part->soup;
    SVO_ASSERT(s->file == file && s->layout.stride == layout->stride);
    svo_soup_piece piece = {file->file.size, count};
    if (svo_buffer_append(&s->pieces, &piece, sizeof piece) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    svo_result r = svo_spill_append(&file->file, records, count * layout->stride, err);
    if (r != SVO_OK) {
        s->pieces.size -= sizeof piece;
        return r;
    }
    note_colors(s, records, count, part->triangle_count == 0);
    part->triangle_count += count;
    part->vertex_count = 3 * part->triangle_count;
    return SVO_OK;
}

void svo_soup_free(struct svo_soup *s)
{
    if (s == NULL) return;
    svo_soup_file_release(s->file);
    svo_buffer_free(&s->pieces);
    svo_free(s->allocator, s, 1, sizeof *s);
}

svo_result svo_soup_read(const struct svo_soup *s, const svo_soup_piece *piece, uint64_t first, uint64_t count, uint8_t *to, svo_error *err)
{
    SVO_ASSERT(first <= piece->count && count <= piece->count - first);
    return svo_spill_read(&s->file->file, piece->offset + first * s->layout.stride, to, count * s->layout.stride, err);
}

svo_result svo_soup_triangles(const struct svo_soup *s, uint64_t begin, uint64_t end, svo_soup_triangle_fn fn, void *user, svo_error *err)
{
    enum { AT_A_TIME = 1024 };
    const svo_soup_piece *pieces = (const svo_soup_piece *)(const void *)s->pieces.data;
    const uint32_t stride = s->layout.stride;
    uint8_t *records = svo_alloc(s->allocator, AT_A_TIME, stride);
    if (records == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    svo_result r = SVO_OK;
    for (uint64_t p = begin; r == SVO_OK && p < end; p++)
        for (uint64_t first = 0; r == SVO_OK && first < pieces[p].count; first += AT_A_TIME) {
            uint64_t n = pieces[p].count - first < AT_A_TIME ? pieces[p].count - first : AT_A_TIME;
            r = svo_soup_read(s, &pieces[p], first, n, records, err);
            for (uint64_t i = 0; r == SVO_OK && i < n; i++) {
                double corner[9];
                svo_soup_corners(&s->layout, records + i * stride, corner);
                fn(user, corner);
            }
        }
    svo_free(s->allocator, records, AT_A_TIME, stride);
    return r;
}
