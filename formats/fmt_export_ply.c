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
