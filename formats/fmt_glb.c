#include "fmti_glb.h"

#include <stdlib.h>
#include <string.h>

#include "fmt_memory.h"

void fmt_glb_begin(fmt_glb *g, const svo_allocator *a)
{
    uint64_t failures = fmt_json_failures();
    *g = (fmt_glb){.json_failures = failures, .root = json_pack("{s:{s:s,s:s}}", "asset", "version", "2.0", "generator", "svokit " SVO_VERSION_STRING), .views = json_array(), .accessors = json_array()};
    svo_buffer_init(&g->bytes, a);
    g->failed = g->root == NULL || g->views == NULL || g->accessors == NULL;
}

uint8_t *fmt_glb_array(fmt_glb *g, uint64_t count, uint32_t stride, int component, const char *type, int target, uint64_t *accessor)
{
    SVO_ASSERT(stride % 4 == 0 && count > 0);
    size_t offset = g->bytes.size;
    *accessor = json_array_size(g->accessors);
    if (g->failed || count > (UINT32_MAX - (1u << 24) - offset) / stride) {
        g->failed = true;
        return NULL;
    }
    uint8_t *p = svo_buffer_append(&g->bytes, NULL, count * stride);
    json_t *view = json_pack("{s:i,s:I,s:I}", "buffer", 0, "byteOffset", (json_int_t)offset, "byteLength", (json_int_t)(count * stride));
    if (view != NULL && target != GLB_NO_TARGET) json_object_set_new(view, "target", json_integer(target));
    json_t *a = json_pack("{s:I,s:i,s:I,s:s}", "bufferView", (json_int_t)json_array_size(g->views), "componentType", component, "count", (json_int_t)count, "type", type);
    g->failed = json_array_append_new(g->views, view) != 0 || json_array_append_new(g->accessors, a) != 0 || p == NULL;
    return g->failed ? NULL : p;
}

bool fmt_glb_view(fmt_glb *g, const void *bytes, uint64_t size, uint64_t *view)
{
    static const uint8_t zero[4] = {0};
    size_t offset = g->bytes.size;
    *view = json_array_size(g->views);
    if (g->failed || size > UINT32_MAX - (1u << 24) - offset || svo_buffer_append(&g->bytes, bytes, size) == NULL ||
        (size % 4 != 0 && svo_buffer_append(&g->bytes, zero, 4 - size % 4) == NULL)) {
        g->failed = true;
        return false;
    }
    g->failed = json_array_append_new(g->views, json_pack("{s:i,s:I,s:I}", "buffer", 0, "byteOffset", (json_int_t)offset, "byteLength", (json_int_t)size)) != 0;
    return !g->failed;
}

uint64_t fmt_glb_accessor(fmt_glb *g, uint64_t count, int component, const char *type, bool normalized)
{
    json_t *a = json_pack("{s:i,s:I,s:s}", "componentType", component, "count", (json_int_t)count, "type", type);
    if (a != NULL && normalized) json_object_set_new(a, "normalized", json_true());
    uint64_t at = json_array_size(g->accessors);
    g->failed |= json_array_append_new(g->accessors, a) != 0;
    return at;
}

void fmt_glb_extension(fmt_glb *g, const char *name, bool required)
{
    static const char *const lists[] = {"extensionsUsed", "extensionsRequired"};
    for (int i = 0; i < (required ? 2 : 1); i++) {
        json_t *list = json_object_get(g->root, lists[i]);
        if (list == NULL && (list = json_array()) != NULL) json_object_set_new(g->root, lists[i], list);
        bool there = false;
        for (size_t k = 0; k < json_array_size(list); k++) there |= strcmp(json_string_value(json_array_get(list, k)), name) == 0;
        if (!there) g->failed |= json_array_append_new(list, json_string(name)) != 0;
    }
}

void fmt_glb_bounds(fmt_glb *g, uint64_t accessor, const float *low, const float *high, int n)
{
    json_t *a = json_array_get(g->accessors, accessor);
    double l[4], h[4];
    for (int k = 0; k < n; k++) {
        l[k] = low[k];
        h[k] = high[k];
    }
    json_object_set_new(a, "min", fmt_glb_vector(l, n));
    json_object_set_new(a, "max", fmt_glb_vector(h, n));
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

svo_result fmt_glb_write(fmt_glb *g, fmt_output *out, svo_error *err)
{
    char *text = NULL;
    if (!g->failed) {
        json_object_set(g->root, "accessors", g->accessors);
        json_object_set(g->root, "bufferViews", g->views);
        json_object_set_new(g->root, "buffers", json_pack("[{s:I}]", "byteLength", (json_int_t)g->bytes.size));
        text = json_dumps(g->root, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(17));
    }
    if (fmt_json_failures() != g->json_failures) { /* parts may be missing */
        free(text);
        text = NULL;
    }
    if (text == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write glTF, or the model is larger than a .glb file can be (4 GB)");
    size_t n = strlen(text);
    uint8_t head[12];
    fmt_store32(head, 0x46546c67); /* "glTF" */
    fmt_store32(head + 4, 2);
    fmt_store32(head + 8, (uint32_t)(12 + 8 + ((n + 3) & ~(size_t)3) + 8 + ((g->bytes.size + 3) & ~(size_t)3)));
    svo_result r = fmt_output_write(out, head, 12, err);
    if (r == SVO_OK) r = write_chunk(out, 0x4e4f534a, text, n, ' ', err);
    if (r == SVO_OK) r = write_chunk(out, 0x004e4942, g->bytes.data, g->bytes.size, 0, err);
    free(text);
    return r;
}

void fmt_glb_end(fmt_glb *g)
{
    json_decref(g->root);
    json_decref(g->views);
    json_decref(g->accessors);
    svo_buffer_free(&g->bytes);
}

json_t *fmt_glb_vector(const double *v, int n)
{
    json_t *a = json_array();
    for (int k = 0; k < n; k++) json_array_append_new(a, json_real(v[k]));
    return a;
}

void fmt_glb_put_f32(uint8_t *p, float v)
{
    uint32_t bits;
    memcpy(&bits, &v, 4);
    fmt_store32(p, bits);
}
