/* Meshes that libskel makes, as binary PLY. */
#include <stdio.h>
#include <string.h>

#include "fmt_skel.h"

/* Rows are gathered and written in blocks. */
typedef struct rows { fmt_output *out; uint8_t data[1 << 15]; size_t size; } rows;

static svo_result flush(rows *r, svo_error *err)
{
    size_t n = r->size;
    r->size = 0;
    return n > 0 ? fmt_output_write(r->out, r->data, n, err) : SVO_OK;
}

static svo_result put(rows *r, const void *data, size_t size, svo_error *err)
{
    if (r->size + size > sizeof r->data) SVO_TRY(flush(r, err));
    memcpy(r->data + r->size, data, size);
    r->size += size;
    return SVO_OK;
}

static svo_result put_triangle(rows *r, const uint32_t c[3], svo_error *err)
{
    uint8_t three = 3;
    SVO_TRY(put(r, &three, 1, err));
    return put(r, c, 12, err);
}

svo_result fmt_export_closed_ply(fmt_output *out, const skel_closed *c, svo_error *err)
{
    rows r = {.out = out};
    char head[400];
    int n = snprintf(head, sizeof head,
                     "ply\nformat binary_little_endian 1.0\nelement vertex %llu\nproperty double x\nproperty double y\nproperty double z\nproperty uchar invented\n"
                     "element face %llu\nproperty list uchar uint vertex_indices\nend_header\n",
                     (unsigned long long)c->vertex_count, (unsigned long long)c->triangle_count);
    SVO_TRY(put(&r, head, (size_t)n, err));
    for (uint64_t v = 0; v < c->vertex_count; v++) {
        SVO_TRY(put(&r, c->position + 3 * v, 24, err));
        SVO_TRY(put(&r, c->invented + v, 1, err));
    }
    for (uint64_t t = 0; t < c->triangle_count; t++) SVO_TRY(put_triangle(&r, c->corner + 3 * t, err));
    return flush(&r, err);
}

/* --- segments -------------------------------------------------------------------------------------------------------- */

/* Vertices of the file: one for each segment that a vertex of the model has triangles of, so that colours end at borders. */
typedef struct corners {
    const svo_allocator *allocator;
    uint64_t vertices, room, count;
    uint32_t *head;  /* of each vertex of the model: its last one in the file, or SVO_NONE */
    uint32_t *next;  /* of each in the file: the one before of the same vertex */
    uint32_t *vertex, *segment;
    uint32_t *index; /* 3 for each triangle of the model */
} corners;

static void corners_free(corners *c)
{
    svo_free(c->allocator, c->head, c->vertices, sizeof *c->head);
    svo_free(c->allocator, c->next, c->room, sizeof *c->next);
    svo_free(c->allocator, c->vertex, c->room, sizeof *c->vertex);
    svo_free(c->allocator, c->segment, c->room, sizeof *c->segment);
    svo_free(c->allocator, c->index, c->room, sizeof *c->index);
}

static svo_result corners_make(corners *c, const skel_segments *s, svo_error *err)
{
    *c = (corners){.allocator = s->allocator, .vertices = s->vertex_count, .room = 3 * s->triangle_count};
    c->head = svo_alloc(c->allocator, c->vertices, sizeof *c->head);
    c->next = svo_alloc(c->allocator, c->room, sizeof *c->next);
    c->vertex = svo_alloc(c->allocator, c->room, sizeof *c->vertex);
    c->segment = svo_alloc(c->allocator, c->room, sizeof *c->segment);
    c->index = svo_alloc(c->allocator, c->room, sizeof *c->index);
    if (c->head == NULL || c->next == NULL || c->vertex == NULL || c->segment == NULL || c->index == NULL) {
        corners_free(c);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the segments");
    }
    memset(c->head, 0xff, c->vertices * sizeof *c->head);
    for (uint64_t i = 0; i < c->room; i++) {
        uint32_t g = s->segment_of[i / 3], v = s->corner[i], at;
        if (g == SVO_NONE) continue;
        for (at = c->head[v]; at != SVO_NONE && c->segment[at] != g;) at = c->next[at];
        if (at == SVO_NONE) {
            at = (uint32_t)c->count++;
            c->next[at] = c->head[v];
            c->head[v] = at;
            c->vertex[at] = v;
            c->segment[at] = g;
        }
        c->index[i] = at;
    }
    return SVO_OK;
}

static svo_result put_color(rows *r, uint32_t color, svo_error *err)
{
    const uint8_t rgb[3] = {(uint8_t)(color >> 16), (uint8_t)(color >> 8), (uint8_t)color};
    return put(r, rgb, 3, err);
}

static svo_result put_segments(rows *r, const skel_segments *s, const corners *c, svo_error *err)
{
    char head[600];
    uint64_t faces = 0;
    for (uint64_t t = 0; t < s->triangle_count; t++) faces += s->segment_of[t] != SVO_NONE;
    int n = snprintf(head, sizeof head,
                     "ply\nformat binary_little_endian 1.0\nelement vertex %llu\nproperty double x\nproperty double y\nproperty double z\n"
                     "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty int segment\n"
                     "element face %llu\nproperty list uchar uint vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
                     "property int segment\nproperty int bone\nend_header\n",
                     (unsigned long long)c->count, (unsigned long long)faces);
    SVO_TRY(put(r, head, (size_t)n, err));
    for (uint64_t v = 0; v < c->count; v++) {
        SVO_TRY(put(r, s->position + 3 * (uint64_t)c->vertex[v], 24, err));
        SVO_TRY(put_color(r, s->segment[c->segment[v]].color, err));
        SVO_TRY(put(r, &c->segment[v], 4, err));
    }
    for (uint64_t t = 0; t < s->triangle_count; t++) {
        if (s->segment_of[t] == SVO_NONE) continue;
        SVO_TRY(put_triangle(r, c->index + 3 * t, err));
        SVO_TRY(put_color(r, s->segment[s->segment_of[t]].color, err));
        SVO_TRY(put(r, &s->segment_of[t], 4, err));
        SVO_TRY(put(r, &s->bone_of[t], 4, err)); /* none is -1 */
    }
    return flush(r, err);
}

svo_result fmt_export_segments_ply(fmt_output *out, const skel_segments *s, svo_error *err)
{
    rows r = {.out = out};
    corners c;
    SVO_TRY(corners_make(&c, s, err));
    svo_result result = put_segments(&r, s, &c, err);
    corners_free(&c);
    return result;
}
