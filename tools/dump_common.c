/* JSON that the kinds of files share. */
#include "dump.h"

#include <math.h>
#include <string.h>

#include "svo_math.h"
#include "svo_scene.h"

json_t *dump_reals(const double *v, size_t n)
{
    json_t *a = json_array();
    for (size_t i = 0; i < n; i++) json_array_append_new(a, isfinite(v[i]) ? json_real(v[i]) : json_null());
    return a;
}

static json_t *integers(const uint32_t *v, size_t n)
{
    json_t *a = json_array();
    for (size_t i = 0; i < n; i++) json_array_append_new(a, json_integer(v[i]));
    return a;
}

const char *dump_kind_text(uint32_t kind)
{
    switch ((fmt_kind)kind) {
    case FMT_KIND_SVO: return "svo";
    case FMT_KIND_SVDAG: return "svdag";
    case FMT_KIND_SKEL: return "skel";
    case FMT_KIND_SCENE: return "svscene";
    }
    return "unknown";
}

void dump_container(dump_job *j, const fmt_container *c)
{
    char hex[33];
    cli_put_text(j->json, "file", strcmp(j->path, "-") == 0 ? "stdin" : j->path);
    cli_put_text(j->json, "format", dump_kind_text(c->kind));
    json_object_set_new(j->json, "version", json_sprintf("%u.%u", c->major, c->minor));
    cli_put_u64(j->json, "bytes", c->size);
    fmt_hash_text(c->content_hash, hex);
    cli_put_text(j->json, "content_hash", hex);
}

void dump_sections(dump_job *j, const fmt_container *c)
{
    enum { TYPES = 32 };
    fmt_section sections[TYPES];
    json_t *list = json_array();
    uint32_t n = fmt_container_sections(c, sections, TYPES);
    for (uint32_t i = 0; i < n; i++) {
        char name[5];
        json_t *s = json_object();
        fmt_fourcc_text(sections[i].type, name);
        cli_put_text(s, "type", sections[i].type != 0 ? name : "other");
        cli_put_u64(s, "chunks", sections[i].chunks);
        cli_put_u64(s, "bytes", sections[i].bytes);
        cli_put_u64(s, "payload_bytes", sections[i].payload);
        cli_put_u64(s, "decoded_bytes", sections[i].decoded);
        json_array_append_new(list, s);
    }
    json_t *frame = json_object();
    cli_put_text(frame, "type", "header and footer");
    cli_put_u64(frame, "bytes", 128);
    json_array_append_new(list, frame);
    json_object_set_new(j->json, "sections", list);
}

void dump_grid(json_t *o, uint32_t depth, const double m[16], svo_surface surface, svo_fill fill)
{
    double size[3], low[3], high[3], zero[3] = {0, 0, 0};
    svo_mat4 matrix;
    memcpy(matrix.m, m, sizeof matrix.m);
    for (int i = 0; i < 3; i++) size[i] = svo_length(svo_v3(m[i], m[4 + i], m[8 + i]));
    double side = ldexp(1, (int)depth), far[3] = {side, side, side};
    svo_box_transform(&matrix, zero, far, 0, low, high);
    cli_put_u64(o, "depth", depth);
    json_object_set_new(o, "voxel_to_world", dump_reals(m, 16));
    json_object_set_new(o, "voxel_size", dump_reals(size, 3));
    json_t *b = json_object();
    json_object_set_new(b, "low", dump_reals(low, 3));
    json_object_set_new(b, "high", dump_reals(high, 3));
    json_object_set_new(o, "grid_bounds", b);
    cli_put_text(o, "surface", surface == SVO_SURFACE_THIN ? "thin" : "conservative");
    cli_put_text(o, "fill", fill == SVO_FILL_SOLID ? "solid" : "surface");
}

void dump_counts(json_t *o, uint32_t depth, const uint64_t *nodes, uint64_t bytes)
{
    json_t *levels = json_array();
    uint64_t all = 0;
    for (uint32_t l = 0; l <= depth; l++) {
        json_t *level = json_object();
        cli_put_u64(level, "level", l);
        cli_put_u64(level, "nodes", nodes[l]);
        json_array_append_new(levels, level);
        all += nodes[l];
    }
    json_object_set_new(o, "levels", levels);
    cli_put_u64(o, "nodes", all);
    cli_put_u64(o, "voxels", nodes[depth]);
    cli_put_f64(o, "bytes_per_voxel", nodes[depth] != 0 ? (double)bytes / (double)nodes[depth] : NAN);
    cli_put_f64(o, "bytes_per_node", all != 0 ? (double)bytes / (double)all : NAN);
}

void dump_bounds(json_t *o, bool any, const uint32_t low[3], const uint32_t high[3], const double m[16])
{
    if (!any) {
        json_object_set_new(o, "voxel_bounds", json_null());
        json_object_set_new(o, "bounds", json_null());
        return;
    }
    double a[3], b[3], world_low[3], world_high[3];
    svo_mat4 matrix;
    memcpy(matrix.m, m, sizeof matrix.m);
    for (int i = 0; i < 3; i++) a[i] = low[i], b[i] = (double)high[i] + 1;
    svo_box_transform(&matrix, a, b, 0, world_low, world_high);
    json_t *grid = json_object(), *world = json_object();
    json_object_set_new(grid, "low", integers(low, 3));
    json_object_set_new(grid, "high", integers(high, 3));
    json_object_set_new(world, "low", dump_reals(world_low, 3));
    json_object_set_new(world, "high", dump_reals(world_high, 3));
    json_object_set_new(o, "voxel_bounds", grid);
    json_object_set_new(o, "bounds", world);
}

json_t *dump_value(svo_channel_kind kind, const uint8_t *v)
{
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: return json_pack("[i,i,i]", v[0], v[1], v[2]);
    case SVO_KIND_NORMAL_OCT32: {
        float n[3];
        svo_oct32_decode(v, n);
        return json_pack("[f,f,f]", (double)n[0], (double)n[1], (double)n[2]);
    }
    case SVO_KIND_UNORM8: return json_integer(v[0]);
    case SVO_KIND_ID16: return json_integer(fmt_load16(v));
    case SVO_KIND_ID32: return json_integer(fmt_load32(v));
    }
    return json_null();
}

json_t *dump_channel(const svo_channel *c)
{
    static const char *const kinds[] = {"?", "color_srgb8", "normal_oct32", "unorm8", "id16", "id32"};
    json_t *o = json_object();
    cli_put_text(o, "name", c->name);
    cli_put_text(o, "kind", c->kind <= SVO_KIND_ID32 ? kinds[c->kind] : kinds[0]);
    json_object_set_new(o, "constant", json_boolean(c->constant));
    if (c->constant) json_object_set_new(o, "value", dump_value(c->kind, c->value));
    return o;
}

void dump_provenance(json_t *o, const char *text)
{
    json_t *p = text[0] != 0 ? json_loads(text, 0, NULL) : NULL;
    json_object_set_new(o, "provenance", p != NULL ? p : json_null());
}
