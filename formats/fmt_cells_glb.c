/* Faces of cells as GLB: a mesh for each set of cells, perhaps with Draco, and nodes that place them. */
#include <string.h>

#include "draco_faces.h"
#include "fmt_cells.h"
#include "fmti_cells.h"
#include "svo_channel.h"
#include "svo_math.h"

/* What a mesh is made of: faces in the grid, or bent ones. */
typedef struct quads {
    const fmt_cell_face *flat;
    const fmt_bent_face *bent; /* NULL: flat ones */
} quads;

static void corner_of(const quads *q, uint64_t i, float out[3])
{
    if (q->bent != NULL) {
        memcpy(out, q->bent[i / 4].corner[i % 4], 3 * sizeof *out);
        return;
    }
    uint32_t p[3];
    fmt_cell_corner(&q->flat[i / 4], i % 4, p);
    for (int k = 0; k < 3; k++) out[k] = (float)p[k];
}

/* Across both diagonals; of a face without area any unit vector does, which glTF asks for. */
static void normal_of(const quads *q, uint64_t face, float out[3])
{
    if (q->bent == NULL) {
        const fmt_cell_face *f = &q->flat[face];
        for (int k = 0; k < 3; k++) out[k] = k != f->axis ? 0 : f->up ? 1.0f : -1.0f;
        return;
    }
    const float (*c)[3] = q->bent[face].corner;
    double a[3], b[3];
    for (int k = 0; k < 3; k++) a[k] = (double)c[2][k] - (double)c[0][k], b[k] = (double)c[3][k] - (double)c[1][k];
    const svo_vec3 n = svo_normalize(svo_cross(svo_v3(a[0], a[1], a[2]), svo_v3(b[0], b[1], b[2])));
    out[0] = (float)n.x, out[1] = (float)n.y, out[2] = (float)n.z;
    if (svo_dot(n, n) == 0) out[2] = 1;
}

static void fill_vertices(const quads *q, uint64_t count, uint8_t *position, uint8_t *normal, uint8_t *color, float low[3], float high[3])
{
    for (uint64_t i = 0; i < 4 * count; i++) {
        const uint8_t *rgb = q->bent != NULL ? q->bent[i / 4].rgb : q->flat[i / 4].rgb;
        float p[3], n[3];
        if (position != NULL) corner_of(q, i, p);
        if (normal != NULL) normal_of(q, i / 4, n);
        for (int k = 0; k < 3; k++) {
            if (normal != NULL) fmt_glb_put_f32(normal + 12 * i + 4 * k, n[k]);
            if (color != NULL) {
                uint32_t linear = (uint32_t)(svo_srgb_to_linear(rgb[k]) * 65535.0f + 0.5f);
                color[8 * i + 2 * k] = (uint8_t)linear, color[8 * i + 2 * k + 1] = (uint8_t)(linear >> 8);
            }
            if (position == NULL) continue;
            fmt_glb_put_f32(position + 12 * i + 4 * k, p[k]);
            if (i == 0 || p[k] < low[k]) low[k] = p[k];
            if (i == 0 || p[k] > high[k]) high[k] = p[k];
        }
        if (color != NULL) color[8 * i + 6] = color[8 * i + 7] = 255; /* alpha: rows must be multiples of 4 bytes */
    }
}

static json_t *primitive(json_t *attributes, uint64_t index)
{
    return json_pack("{s:o,s:I,s:i}", "attributes", attributes, "indices", (json_int_t)index, "material", 0);
}

static json_t *plain(fmt_glb *g, const quads *f, uint64_t count, bool colored)
{
    uint64_t position = 0, normal = 0, color = 0, index = 0;
    float low[3] = {0}, high[3] = {0};
    uint8_t *p = fmt_glb_array(g, 4 * count, 12, GLB_F32, "VEC3", GLB_ARRAY_BUFFER, &position);
    if (p == NULL) return NULL;
    fill_vertices(f, count, p, NULL, NULL, low, high);
    fmt_glb_bounds(g, position, low, high, 3);
    if ((p = fmt_glb_array(g, 4 * count, 12, GLB_F32, "VEC3", GLB_ARRAY_BUFFER, &normal)) == NULL) return NULL;
    fill_vertices(f, count, NULL, p, NULL, low, high);
    json_t *attributes = json_pack("{s:I,s:I}", "POSITION", (json_int_t)position, "NORMAL", (json_int_t)normal);
    if (colored) {
        p = fmt_glb_array(g, 4 * count, 8, GLB_U16, "VEC4", GLB_ARRAY_BUFFER, &color);
        if (p != NULL) {
            fill_vertices(f, count, NULL, NULL, p, low, high);
            json_object_set_new(json_array_get(g->accessors, color), "normalized", json_true());
            json_object_set_new(attributes, "COLOR_0", json_integer((json_int_t)color));
        }
    }
    p = g->failed ? NULL : fmt_glb_array(g, 6 * count, 4, GLB_U32, "SCALAR", GLB_ELEMENT_ARRAY_BUFFER, &index);
    static const uint32_t order[6] = {0, 1, 2, 0, 2, 3};
    for (uint64_t i = 0; p != NULL && i < 6 * count; i++) fmt_store32(p + 4 * i, (uint32_t)(4 * (i / 6)) + order[i % 6]);
    return primitive(attributes, index);
}

/* An accessor without bytes: those are Draco's. */
static uint64_t described(fmt_glb *g, uint64_t count, int component, const char *type)
{
    json_array_append_new(g->accessors, json_pack("{s:i,s:I,s:s}", "componentType", component, "count", (json_int_t)count, "type", type));
    return json_array_size(g->accessors) - 1;
}

static svo_result packed(fmt_cells_glb *s, const fmt_cell_face *f, uint64_t count, bool colored, json_t **out, svo_error *err)
{
    fmt_glb *g = &s->g;
    svo_buffer bytes;
    fmt_draco_mesh told;
    svo_buffer_init(&bytes, g->bytes.allocator);
    svo_result r = fmt_draco_faces(f, count, colored, s->draco, &bytes, &told, err);
    if (r == SVO_OK && bytes.size > UINT32_MAX - (1u << 24) - g->bytes.size) r = svo_fail(err, SVO_LIMIT, "more than a .glb file can hold (4 GB); export a coarser level");
    const size_t offset = g->bytes.size, size = bytes.size;
    if (r == SVO_OK && (svo_buffer_append(&g->bytes, bytes.data, size) == NULL || svo_buffer_append(&g->bytes, NULL, (4 - size % 4) % 4 + 4) == NULL))
        r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the compressed mesh");
    svo_buffer_free(&bytes);
    if (r != SVO_OK) return r;
    g->bytes.size = offset + (size + 3) / 4 * 4;
    json_array_append_new(g->views, json_pack("{s:i,s:I,s:I}", "buffer", 0, "byteOffset", (json_int_t)offset, "byteLength", (json_int_t)size));
    const json_int_t view = (json_int_t)json_array_size(g->views) - 1;
    const uint64_t position = described(g, told.points, GLB_F32, "VEC3"), normal = described(g, told.points, GLB_F32, "VEC3");
    fmt_glb_bounds(g, position, told.low, told.high, 3);
    json_t *attributes = json_pack("{s:I,s:I}", "POSITION", (json_int_t)position, "NORMAL", (json_int_t)normal);
    json_t *ids = json_pack("{s:i,s:i}", "POSITION", (int)told.position, "NORMAL", (int)told.normal);
    if (colored) {
        const uint64_t color = described(g, told.points, GLB_U16, "VEC4");
        json_object_set_new(json_array_get(g->accessors, color), "normalized", json_true());
        json_object_set_new(attributes, "COLOR_0", json_integer((json_int_t)color));
        json_object_set_new(ids, "COLOR_0", json_integer((int)told.color));
    }
    *out = primitive(attributes, described(g, 3 * told.triangles, GLB_U32, "SCALAR"));
    json_object_set_new(*out, "extensions", json_pack("{s:{s:I,s:o}}", "KHR_draco_mesh_compression", "bufferView", view, "attributes", ids));
    s->report.draco_bytes += size;
    s->report.bits = told.bits > s->report.bits ? told.bits : s->report.bits;
    s->report.position_error = told.position_error > s->report.position_error ? told.position_error : s->report.position_error;
    s->report.normal_error = told.normal_error > s->report.normal_error ? told.normal_error : s->report.normal_error;
    return SVO_OK;
}

svo_result fmt_cells_glb_begin(bool draco, uint32_t bits, const svo_allocator *a, fmt_cells_glb **out, svo_error *err)
{
    fmt_cells_glb *s = svo_calloc(a, 1, sizeof *s);
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the model");
    fmt_glb_begin(&s->g, a);
    s->draco = draco ? bits : UINT32_MAX;
    if (!s->g.failed) {
        json_object_set_new(s->g.root, "meshes", s->meshes = json_array());
        json_object_set_new(s->g.root, "nodes", s->nodes = json_array());
        json_object_set_new(s->g.root, "materials", json_pack("[{s:{s:i,s:i}}]", "pbrMetallicRoughness", "metallicFactor", 0, "roughnessFactor", 1));
        json_object_set_new(s->g.root, "scene", json_integer(0));
        if (draco) fmt_glb_extension(&s->g, "KHR_draco_mesh_compression", true);
    }
    *out = s;
    return SVO_OK;
}

static svo_result add_mesh(fmt_cells_glb *s, const quads *q, uint64_t faces, bool colored, const char *name, uint64_t *mesh, svo_error *err)
{
    json_t *p = NULL;
    svo_result r = SVO_OK;
    *mesh = UINT64_MAX;
    if (faces > UINT32_MAX / 36) r = svo_fail(err, SVO_LIMIT, "%llu faces are more than a .glb file can hold (4 GB); export a coarser level", (unsigned long long)faces);
    if (r == SVO_OK && faces != 0 && !s->g.failed) {
        if (s->draco != UINT32_MAX && q->bent == NULL) r = packed(s, q->flat, faces, colored, &p, err);
        else p = plain(&s->g, q, faces, colored);
    }
    if (p != NULL) {
        *mesh = json_array_size(s->meshes);
        json_array_append_new(s->meshes, json_pack("{s:[o]}", "primitives", p));
        if (name != NULL && name[0] != 0) json_object_set_new(json_array_get(s->meshes, *mesh), "name", json_string(name));
        s->report.faces += faces;
    }
    return r;
}

svo_result fmt_cells_glb_mesh(fmt_cells_glb *s, const fmt_cells *c, const char *name, uint64_t *mesh, svo_error *err)
{
    svo_buffer list;
    svo_buffer_init(&list, c->allocator);
    svo_result r = fmt_cells_faces(c, &list, err);
    const quads q = {.flat = (const fmt_cell_face *)(const void *)list.data};
    if (r == SVO_OK) r = add_mesh(s, &q, list.size / sizeof *q.flat, c->colored, name, mesh, err);
    svo_buffer_free(&list);
    return r;
}

svo_result fmt_cells_glb_bent(fmt_cells_glb *s, const fmt_bent_face *faces, uint64_t count, bool colored, const char *name, uint64_t *mesh, svo_error *err)
{
    const quads q = {.bent = faces};
    return add_mesh(s, &q, count, colored, name, mesh, err);
}

void fmt_cells_glb_node(fmt_cells_glb *s, uint64_t mesh, const double to_world[16], const char *name, const uint64_t *id)
{
    double column[16]; /* glTF's matrices are column-major */
    for (int i = 0; i < 16; i++) column[i] = to_world[i % 4 * 4 + i / 4];
    column[3] = column[7] = column[11] = 0, column[15] = 1;
    json_t *node = json_pack("{s:o}", "matrix", fmt_glb_vector(column, 16));
    if (name != NULL && name[0] != 0) json_object_set_new(node, "name", json_string(name));
    if (mesh != UINT64_MAX) json_object_set_new(node, "mesh", json_integer((json_int_t)mesh));
    if (id != NULL) json_object_set_new(node, "extras", json_pack("{s:I}", "id", (json_int_t)*id));
    json_array_append_new(s->nodes, node);
    s->report.nodes++;
}

svo_result fmt_cells_glb_end(fmt_cells_glb *s, fmt_output *out, fmt_cells_glb_report *report, svo_error *err)
{
    svo_result r = SVO_OK;
    if (!s->g.failed && s->report.faces == 0) r = svo_fail(err, SVO_UNSUPPORTED, "there are no voxels, and a .glb file cannot hold an empty mesh");
    if (!s->g.failed) {
        json_t *roots = json_array();
        for (uint64_t i = 0; i < s->report.nodes; i++) json_array_append_new(roots, json_integer((json_int_t)i));
        json_object_set_new(s->g.root, "scenes", json_pack("[{s:o}]", "nodes", roots));
    }
    if (r == SVO_OK) r = fmt_glb_write(&s->g, out, err);
    *report = s->report;
    return r;
}

void fmt_cells_glb_free(fmt_cells_glb *s)
{
    if (s == NULL) return;
    const svo_allocator *a = s->g.bytes.allocator;
    fmt_glb_end(&s->g);
    svo_free(a, s, 1, sizeof *s);
}
