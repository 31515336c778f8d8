/* A skeleton's curve as binary glTF 2.0: one node at the middle of the curve, its mesh with a LINES primitive for the bones and a POINTS primitive for
 * joints without bones, both over one list of f32 positions. */
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_skel.h"

enum { ARRAY_BUFFER = 34962, ELEMENT_ARRAY_BUFFER = 34963, FLOAT = 5126, UNSIGNED_INT = 5125, POINTS = 0, LINES = 1 };

typedef struct glb { svo_buffer bytes; uint32_t loose; double middle[3]; float low[3], high[3]; } glb;

static void put_f32(uint8_t *p, float v)
{
    uint32_t bits;
    memcpy(&bits, &v, 4);
    fmt_store32(p, bits);
}

/* Positions, indices of bones, indices of loose joints. */
static svo_result fill(const skel_skeleton *s, glb *g, svo_error *err)
{
    double low[3], high[3];
    for (int k = 0; k < 3; k++) low[k] = high[k] = s->joints[0].position[k];
    for (uint32_t j = 1; j < s->joint_count; j++)
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], s->joints[j].position[k]);
            high[k] = fmax(high[k], s->joints[j].position[k]);
        }
    uint8_t *used = svo_calloc(s->allocator, s->joint_count, 1);
    uint8_t *p = svo_buffer_append(&g->bytes, NULL, (size_t)s->joint_count * 12);
    if (used == NULL || p == NULL) goto no_memory;
    for (int k = 0; k < 3; k++) {
        g->middle[k] = 0.5 * low[k] + 0.5 * high[k];
        g->low[k] = INFINITY;
        g->high[k] = -INFINITY;
    }
    for (uint32_t j = 0; j < s->joint_count; j++)
        for (int k = 0; k < 3; k++, p += 4) {
            float v = (float)(s->joints[j].position[k] - g->middle[k]);
            g->low[k] = fminf(g->low[k], v);
            g->high[k] = fmaxf(g->high[k], v);
            put_f32(p, v);
        }
    for (int k = 0; k < 3; k++)
        if (!isfinite(g->low[k]) || !isfinite(g->high[k])) {
            svo_free(s->allocator, used, s->joint_count, 1);
            return svo_fail(err, SVO_LIMIT, "the curve is too large for the 32-bit floats of glTF");
        }
    for (uint32_t b = 0; b < s->bone_count; b++) {
        if ((p = svo_buffer_append(&g->bytes, NULL, 8)) == NULL) goto no_memory;
        fmt_store32(p, s->bones[b].a);
        fmt_store32(p + 4, s->bones[b].b);
        used[s->bones[b].a] = used[s->bones[b].b] = 1;
    }
    for (uint32_t j = 0; j < s->joint_count; j++) {
        if (used[j]) continue;
        if ((p = svo_buffer_append(&g->bytes, NULL, 4)) == NULL) goto no_memory;
        fmt_store32(p, j);
        g->loose++;
    }
    svo_free(s->allocator, used, s->joint_count, 1);
    if (g->bytes.size > UINT32_MAX - (1u << 20)) return svo_fail(err, SVO_LIMIT, "the curve is too large for a .glb file");
    return SVO_OK;
no_memory:
    svo_free(s->allocator, used, s->joint_count, 1);
    return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the curve");
}

static json_t *vector(const double v[3]) { return json_pack("[f,f,f]", v[0], v[1], v[2]); }

static void add_view(json_t *views, size_t offset, size_t size, int target)
{
    json_array_append_new(views, json_pack("{s:i,s:I,s:I,s:i}", "buffer", 0, "byteOffset", (json_int_t)offset, "byteLength", (json_int_t)size, "target", target));
}

static void add_indices(json_t *accessors, json_t *primitives, size_t view, uint64_t count, int mode)
{
    json_array_append_new(accessors, json_pack("{s:I,s:i,s:I,s:s}", "bufferView", (json_int_t)view, "componentType", UNSIGNED_INT, "count", (json_int_t)count, "type", "SCALAR"));
    json_array_append_new(primitives, json_pack("{s:{s:i},s:I,s:i}", "attributes", "POSITION", 0, "indices", (json_int_t)json_array_size(accessors) - 1, "mode", mode));
}

static char *describe(const skel_skeleton *s, const glb *g)
{
    json_t *views = json_array(), *accessors = json_array(), *primitives = json_array();
    size_t at = (size_t)s->joint_count * 12;
    double low[3], high[3];
    for (int k = 0; k < 3; k++) {
        low[k] = g->low[k];
        high[k] = g->high[k];
    }
    add_view(views, 0, at, ARRAY_BUFFER);
    json_array_append_new(accessors, json_pack("{s:i,s:i,s:I,s:s,s:o,s:o}", "bufferView", 0, "componentType", FLOAT, "count", (json_int_t)s->joint_count, "type",
                                               "VEC3", "min", vector(low), "max", vector(high)));
    if (s->bone_count > 0) {
        add_view(views, at, (size_t)s->bone_count * 8, ELEMENT_ARRAY_BUFFER);
        add_indices(accessors, primitives, json_array_size(views) - 1, 2 * (uint64_t)s->bone_count, LINES);
        at += (size_t)s->bone_count * 8;
    }
    if (g->loose > 0) {
        add_view(views, at, (size_t)g->loose * 4, ELEMENT_ARRAY_BUFFER);
        add_indices(accessors, primitives, json_array_size(views) - 1, g->loose, POINTS);
    }
    json_t *root = json_pack("{s:{s:s,s:s},s:i,s:[{s:[i]}],s:[{s:s,s:i,s:o}],s:[{s:s,s:o}],s:o,s:o,s:[{s:I}]}", "asset", "version", "2.0", "generator",
                             "svokit " SVO_VERSION_STRING, "scene", 0, "scenes", "nodes", 0, "nodes", "name", "skeleton", "mesh", 0, "translation",
                             vector(g->middle), "meshes", "name", "skeleton", "primitives", primitives, "accessors", accessors, "bufferViews", views, "buffers",
                             "byteLength", (json_int_t)g->bytes.size);
    char *text = root == NULL ? NULL : json_dumps(root, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(17));
    json_decref(root);
    return text;
}

static svo_result write_chunk(fmt_output *out, uint32_t type, const void *bytes, size_t size, char pad, svo_error *err)
{
    uint8_t head[8];
    char padding[4] = {pad, pad, pad, pad};
    fmt_store32(head, (uint32_t)((size + 3) & ~(size_t)3));
    fmt_store32(head + 4, type);
    SVO_TRY(fmt_output_write(out, head, 8, err));
    SVO_TRY(fmt_output_write(out, bytes, size, err));
    return fmt_output_write(out, padding, (4 - size % 4) % 4, err);
}

svo_result fmt_export_skel_glb(fmt_output *out, const skel_skeleton *s, svo_error *err)
{
    SVO_ASSERT(s->joint_count > 0);
    glb g = {0};
    svo_buffer_init(&g.bytes, s->allocator);
    svo_result result = fill(s, &g, err);
    char *text = result == SVO_OK ? describe(s, &g) : NULL;
    if (result == SVO_OK && text == NULL) result = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the curve");
    if (result == SVO_OK) {
        size_t n = strlen(text);
        uint8_t head[12];
        fmt_store32(head, 0x46546c67); /* "glTF" */
        fmt_store32(head + 4, 2);
        fmt_store32(head + 8, (uint32_t)(12 + 8 + ((n + 3) & ~(size_t)3) + 8 + ((g.bytes.size + 3) & ~(size_t)3)));
        result = fmt_output_write(out, head, 12, err);
        if (result == SVO_OK) result = write_chunk(out, 0x4e4f534a, text, n, ' ', err);
        if (result == SVO_OK) result = write_chunk(out, 0x004e4942, g.bytes.data, g.bytes.size, 0, err);
    }
    free(text);
    svo_buffer_free(&g.bytes);
    return result;
}
