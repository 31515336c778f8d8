/* Voxels as a binary little-endian PLY point cloud. */
#include "dump.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* Bytes of a row at most: 12 + 24 + 8 + 16 channels of 12. */
enum { ROW_MAX = 12 + 24 + 8 + 12 * SVO_MAX_CHANNELS, ROWS = 1024 };

struct dump_ply {
    fmt_output *out;
    uint64_t count, written;
    uint32_t channel_count;
    bool instances;
    const double *to_world;
    const svo_mat4 *normals;
    uint32_t instance;
    svo_channel channels[SVO_MAX_CHANNELS];
    size_t used;
    uint8_t rows[ROW_MAX * ROWS];
};

static svo_result line(fmt_output *o, svo_error *err, const char *format, ...) SVO_PRINTF(3, 4);
static svo_result line(fmt_output *o, svo_error *err, const char *format, ...)
{
    char text[200];
    va_list args;
    va_start(args, format);
    int n = vsnprintf(text, sizeof text, format, args);
    va_end(args);
    return fmt_output_write(o, text, (size_t)n, err);
}

static svo_result channel_properties(fmt_output *o, const svo_channel *c, svo_error *err)
{
    static const char *const rgb[3] = {"red", "green", "blue"}, *const xyz[3] = {"nx", "ny", "nz"};
    const char *n = c->name;
    switch (c->kind) {
    case SVO_KIND_COLOR_SRGB8:
    case SVO_KIND_NORMAL_OCT32: {
        bool color = c->kind == SVO_KIND_COLOR_SRGB8, plain = strcmp(n, color ? "color" : "normal") == 0;
        for (int i = 0; i < 3; i++)
            SVO_TRY(line(o, err, "property %s %s%s%s\n", color ? "uchar" : "float", plain ? "" : n, plain ? "" : "_", color ? rgb[i] : xyz[i]));
        return SVO_OK;
    }
    case SVO_KIND_UNORM8: return line(o, err, "property uchar %s\n", n);
    case SVO_KIND_ID16: return line(o, err, "property ushort %s\n", n);
    case SVO_KIND_ID32: return line(o, err, "property uint %s\n", n);
    }
    return svo_fail(err, SVO_UNSUPPORTED, "channel %s is of a kind that --voxels does not know", n);
}

static svo_result header(dump_ply *p, svo_error *err)
{
    SVO_TRY(line(p->out, err, "ply\nformat binary_little_endian 1.0\ncomment voxels: grid coordinates, centre, attributes\nelement vertex %llu\n",
                 (unsigned long long)p->count));
    SVO_TRY(line(p->out, err, "property uint vx\nproperty uint vy\nproperty uint vz\nproperty double x\nproperty double y\nproperty double z\n"));
    for (uint32_t i = 0; i < p->channel_count; i++) SVO_TRY(channel_properties(p->out, &p->channels[i], err));
    if (p->instances) SVO_TRY(line(p->out, err, "property uint instance\n"));
    return line(p->out, err, "end_header\n");
}

svo_result dump_ply_begin(const dump_job *j, uint64_t count, const svo_channel *channels, uint32_t channel_count, bool instances,
                          dump_ply **out, svo_error *err)
{
    if (count > j->limit)
        return svo_fail(err, SVO_LIMIT, "%llu voxels are more than the %llu that --voxels may write; raise --limit", (unsigned long long)count,
                        (unsigned long long)j->limit);
    dump_ply *p = svo_alloc(NULL, 1, sizeof *p);
    if (p == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the point cloud's buffer");
    memset(p, 0, offsetof(dump_ply, rows));
    p->count = count;
    p->channel_count = channel_count;
    p->instances = instances;
    memcpy(p->channels, channels, channel_count * sizeof *channels);
    svo_result r = fmt_output_open(j->voxels, j->c->force, &p->out, err);
    if (r == SVO_OK) r = header(p, err);
    if (r != SVO_OK) {
        dump_ply_discard(p);
        return r;
    }
    *out = p;
    return SVO_OK;
}

static uint8_t *put(uint8_t *to, const void *bytes, size_t n)
{
    memcpy(to, bytes, n);
    return to + n;
}

void dump_ply_place(dump_ply *p, const double voxel_to_world[16], const svo_mat4 *normals, uint32_t instance)
{
    p->to_world = voxel_to_world;
    p->normals = normals;
    p->instance = instance;
}

svo_result dump_ply_voxel(dump_ply *p, uint32_t x, uint32_t y, uint32_t z, const uint8_t *const *values, svo_error *err)
{
    if (p->written == p->count) return svo_fail(err, SVO_INVALID_DATA, "the file states %llu voxels and holds more", (unsigned long long)p->count);
    uint8_t *to = p->rows + p->used;
    const double *m = p->to_world;
    const uint32_t grid[3] = {x, y, z};
    to = put(to, grid, sizeof grid);
    for (int i = 0; i < 3; i++) {
        double v = m[4 * i] * (x + 0.5) + m[4 * i + 1] * (y + 0.5) + m[4 * i + 2] * (z + 0.5) + m[4 * i + 3];
        to = put(to, &v, sizeof v);
    }
    for (uint32_t i = 0; i < p->channel_count; i++) {
        const svo_channel *c = &p->channels[i];
        const uint8_t *value = c->constant ? c->value : values[i];
        if (c->kind == SVO_KIND_NORMAL_OCT32) {
            float n[3];
            svo_oct32_decode(value, n);
            if (p->normals != NULL) {
                svo_vec3 v = svo_normalize(svo_mat4_normal(p->normals, svo_v3(n[0], n[1], n[2])));
                n[0] = (float)v.x, n[1] = (float)v.y, n[2] = (float)v.z;
            }
            to = put(to, n, sizeof n);
        } else {
            to = put(to, value, svo_channel_stride(c->kind));
        }
    }
    if (p->instances) to = put(to, &p->instance, sizeof p->instance);
    p->used = (size_t)(to - p->rows);
    p->written++;
    if (p->used + ROW_MAX <= sizeof p->rows) return SVO_OK;
    size_t n = p->used;
    p->used = 0;
    return fmt_output_write(p->out, p->rows, n, err);
}

svo_result dump_ply_end(dump_ply *p, svo_error *err)
{
    svo_result r = SVO_OK;
    if (p->written != p->count)
        r = svo_fail(err, SVO_INVALID_DATA, "the file states %llu voxels and holds %llu", (unsigned long long)p->count, (unsigned long long)p->written);
    if (r == SVO_OK) r = fmt_output_write(p->out, p->rows, p->used, err);
    if (r == SVO_OK) {
        fmt_output *out = p->out;
        p->out = NULL;
        r = fmt_output_commit(out, err);
    }
    dump_ply_discard(p);
    return r;
}

void dump_ply_discard(dump_ply *p)
{
    if (p == NULL) return;
    fmt_output_discard(p->out);
    svo_free(NULL, p, 1, sizeof *p);
}
