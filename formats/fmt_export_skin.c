/* A mesh with its skeleton as skinned binary glTF 2.0, and the curve as SWC. Everything lies relative to the middle of the joints' box, which the node above
 * the joints holds, so that a large offset costs no precision. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fmti_draco.h"
#include "fmti_glb.h"
#include "fmt_skel.h"

typedef struct skinned {
    fmt_glb g;
    const svo_mesh *mesh;
    const skel_skeleton *s;
    const skel_tree *tree;
    const skel_skin *skin;
    double middle[3];
    uint64_t dropped; /* triangles with a corner that is not finite */
    bool plain;       /* a part has no material: it takes the one after the mesh's */
    uint32_t draco;   /* bits of positions; 0: plain arrays, weights as 32-bit floats */
    fmt_draco_report report;
} skinned;

static void find_middle(skinned *k)
{
    for (int e = 0; e < 3; e++) {
        double low = k->s->joints[0].position[e], high = low;
        for (uint32_t j = 1; j < k->s->joint_count; j++) {
            low = fmin(low, k->s->joints[j].position[e]);
            high = fmax(high, k->s->joints[j].position[e]);
        }
        k->middle[e] = 0.5 * low + 0.5 * high;
    }
}

static float clamped(float v) { return v > 0 ? (v < 1 ? v : 1) : 0; }

/* --- one primitive ------------------------------------------------------------------------------------------------- */

/* False for a vertex that is not finite (or not in 32-bit floats): it is stored at the middle and no triangle has it. */
static bool vertex(const skinned *k, const svo_part *part, const svo_mat4 *m, uint64_t v, float out[3])
{
    const double *p = part->positions + 3 * v;
    svo_vec3 q = svo_mat4_point(m, svo_v3(p[0], p[1], p[2]));
    out[0] = (float)(q.x - k->middle[0]);
    out[1] = (float)(q.y - k->middle[1]);
    out[2] = (float)(q.z - k->middle[2]);
    return isfinite(out[0]) && isfinite(out[1]) && isfinite(out[2]);
}

static void put_positions(skinned *k, const svo_part *part, const svo_mat4 *m, json_t *attributes)
{
    uint64_t accessor;
    uint8_t *p = fmt_glb_array(&k->g, part->vertex_count, 12, GLB_F32, "VEC3", GLB_ARRAY_BUFFER, &accessor);
    if (p == NULL) return;
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint64_t v = 0; v < part->vertex_count; v++) {
        float at[3];
        if (!vertex(k, part, m, v, at)) memset(at, 0, sizeof at);
        for (int e = 0; e < 3; e++, p += 4) {
            low[e] = fminf(low[e], at[e]);
            high[e] = fmaxf(high[e], at[e]);
            fmt_glb_put_f32(p, at[e]);
        }
    }
    fmt_glb_bounds(&k->g, accessor, low, high, 3);
    json_object_set_new(attributes, "POSITION", json_integer((json_int_t)accessor));
}

static void put_normals(skinned *k, const svo_part *part, const svo_mat4 *m, json_t *attributes)
{
    uint64_t accessor;
    uint8_t *p = part->normals == NULL ? NULL : fmt_glb_array(&k->g, part->vertex_count, 12, GLB_F32, "VEC3", GLB_ARRAY_BUFFER, &accessor);
    if (p == NULL) return;
    for (uint64_t v = 0; v < part->vertex_count; v++, p += 12) {
        const float *n = part->normals + 3 * v;
        svo_vec3 q = svo_normalize(svo_mat4_normal(m, svo_v3(n[0], n[1], n[2])));
        if (!(svo_dot(q, q) > 0.5)) q = svo_v3(0, 1, 0); /* glTF has no zero normals */
        fmt_glb_put_f32(p, (float)q.x);
        fmt_glb_put_f32(p + 4, (float)q.y);
        fmt_glb_put_f32(p + 8, (float)q.z);
    }
    json_object_set_new(attributes, "NORMAL", json_integer((json_int_t)accessor));
}

static void put_colors(skinned *k, const svo_part *part, json_t *attributes)
{
    uint64_t accessor;
    uint8_t *p = part->colors == NULL ? NULL : fmt_glb_array(&k->g, part->vertex_count, 16, GLB_F32, "VEC4", GLB_ARRAY_BUFFER, &accessor);
    if (p == NULL) return;
    for (uint64_t i = 0; i < 4 * part->vertex_count; i++, p += 4) fmt_glb_put_f32(p, clamped(part->colors[i]));
    json_object_set_new(attributes, "COLOR_0", json_integer((json_int_t)accessor));
}

/* How many sets of texture coordinates a part is written with: those that it has and those that its material looks at, from 0 on without gaps. */
static uint32_t uv_sets(const skinned *k, const svo_part *part)
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < SVO_MAX_UV_SETS; i++)
        if (part->uvs[i] != NULL) n = i + 1;
    if (part->material == SVO_NONE) return n;
    const svo_material *m = &k->mesh->materials[part->material];
    const svo_texture *const all[] = {&m->base_color_texture, &m->emissive_texture, &m->metallic_roughness_texture};
    for (int i = 0; i < 3; i++)
        if (all[i]->image != SVO_NONE && all[i]->uv_set >= n) n = all[i]->uv_set + 1;
    return n;
}

static void put_uvs(skinned *k, const svo_part *part, uint32_t set, json_t *attributes)
{
    uint64_t accessor;
    char name[24];
    const float *uv = part->uvs[set];
    uint8_t *p = fmt_glb_array(&k->g, part->vertex_count, 8, GLB_F32, "VEC2", GLB_ARRAY_BUFFER, &accessor);
    for (uint64_t i = 0; p != NULL && uv != NULL && i < 2 * part->vertex_count; i++) fmt_glb_put_f32(p + 4 * i, isfinite(uv[i]) ? uv[i] : 0);
    snprintf(name, sizeof name, "TEXCOORD_%u", set);
    json_object_set_new(attributes, name, json_integer((json_int_t)accessor));
}

/* A vertex's weights in steps of 1/255 that add up to 1, and none of them a step away from what it is: the largest remainders are rounded up. */
static void weights_in_bytes(skinned *k, uint64_t vertex, uint8_t out[SKEL_MAX_INFLUENCES])
{
    const uint32_t per = k->skin->influences;
    const float *w = k->skin->weight + vertex * per;
    double rest[SKEL_MAX_INFLUENCES];
    int left = 255;
    for (uint32_t i = 0; i < per; i++) {
        double x = 255.0 * (double)w[i];
        out[i] = (uint8_t)fmin(255, floor(x));
        rest[i] = x - out[i];
        left -= out[i];
    }
    for (; left > 0; left--) {
        uint32_t best = 0;
        for (uint32_t i = 1; i < per; i++)
            if (rest[i] > rest[best]) best = i;
        out[best]++;
        rest[best] -= 1;
    }
    for (uint32_t i = 0; i < per; i++) k->report.weight_error = fmax(k->report.weight_error, fabs(out[i] / 255.0 - (double)w[i]));
}

/* Influences 4 set .. 4 set + 3 of each vertex; base: number of the part's first vertex in the map. */
static void put_influences(skinned *k, const svo_part *part, uint64_t base, uint32_t set, json_t *attributes)
{
    uint64_t joints, weights, n = part->vertex_count;
    const uint32_t per = k->skin->influences;
    char name[16];
    uint8_t *p = fmt_glb_array(&k->g, n, 8, GLB_U16, "VEC4", GLB_ARRAY_BUFFER, &joints);
    for (uint64_t i = 0; p != NULL && i < 4 * n; i++, p += 2) {
        uint64_t at = 4 * set + i % 4;
        fmt_store16(p, at < per ? (uint16_t)k->skin->joint[(base + i / 4) * per + at] : 0);
    }
    p = k->draco > 0 ? fmt_glb_array(&k->g, n, 4, GLB_U8, "VEC4", GLB_ARRAY_BUFFER, &weights) : fmt_glb_array(&k->g, n, 16, GLB_F32, "VEC4", GLB_ARRAY_BUFFER, &weights);
    for (uint64_t v = 0; p != NULL && k->draco > 0 && v < n; v++) {
        uint8_t w[SKEL_MAX_INFLUENCES];
        weights_in_bytes(k, base + v, w);
        for (uint64_t i = 0; i < 4; i++) p[4 * v + i] = 4 * set + i < per ? w[4 * set + i] : 0;
    }
    for (uint64_t i = 0; p != NULL && k->draco == 0 && i < 4 * n; i++, p += 4) {
        uint64_t at = 4 * set + i % 4;
        fmt_glb_put_f32(p, at < per ? k->skin->weight[(base + i / 4) * per + at] : 0);
    }
    snprintf(name, sizeof name, "JOINTS_%u", set);
    json_object_set_new(attributes, name, json_integer((json_int_t)joints));
    snprintf(name, sizeof name, "WEIGHTS_%u", set);
    json_object_set_new(attributes, name, json_integer((json_int_t)weights));
}

/* Indices of the triangles that are finite; false when there is none. A mirroring transform turns them round. */
static bool put_indices(skinned *k, const svo_part *part, const svo_mat4 *m, uint64_t *accessor)
{
    uint64_t kept = 0, t = 0;
    bool flip = svo_mat4_det3(m) < 0;
    float at[3];
    for (uint64_t pass = 0; pass < 2; pass++) {
        uint8_t *p = NULL;
        if (pass == 1) {
            k->dropped += part->triangle_count - kept;
            if (kept == 0 || (p = fmt_glb_array(&k->g, 3 * kept, 4, GLB_U32, "SCALAR", GLB_ELEMENT_ARRAY_BUFFER, accessor)) == NULL) return false;
        }
        for (t = 0; t < part->triangle_count; t++) {
            const uint32_t *c = part->indices + 3 * t;
            if (!vertex(k, part, m, c[0], at) || !vertex(k, part, m, c[1], at) || !vertex(k, part, m, c[2], at)) continue;
            if (pass == 0) {
                kept++;
                continue;
            }
            fmt_store32(p, c[0]);
            fmt_store32(p + 4, c[flip ? 2 : 1]);
            fmt_store32(p + 8, c[flip ? 1 : 2]);
            p += 12;
        }
    }
    return true;
}

static json_t *primitive(skinned *k, const svo_part *part, const svo_mat4 *m, uint64_t base)
{
    uint64_t indices;
    if (!put_indices(k, part, m, &indices)) return NULL;
    json_t *attributes = json_object();
    put_positions(k, part, m, attributes);
    put_normals(k, part, m, attributes);
    put_colors(k, part, attributes);
    for (uint32_t set = 0, n = uv_sets(k, part); set < n; set++) put_uvs(k, part, set, attributes);
    for (uint32_t set = 0; 4 * set < k->skin->influences; set++) put_influences(k, part, base, set, attributes);
    json_t *p = json_pack("{s:o,s:I}", "attributes", attributes, "indices", (json_int_t)indices);
    if (p != NULL) json_object_set_new(p, "material", json_integer(part->material != SVO_NONE ? part->material : k->mesh->material_count));
    k->plain |= part->material == SVO_NONE;
    k->g.failed |= p == NULL;
    return p;
}

/* --- Draco ---------------------------------------------------------------------------------------------------------- */

static json_int_t number_of(const json_t *o, const char *name) { return json_integer_value(json_object_get(o, name)); }

/* An attribute as it lies in the plain file. */
static fmt_draco_attribute plain_attribute(const fmt_glb *g, const char *name, json_int_t accessor, uint32_t bits)
{
    static const struct { const char *name; fmt_draco_kind kind; uint32_t bits; } kinds[] = {
        {"POSITION", FMT_DRACO_POSITION, 0}, {"NORMAL", FMT_DRACO_NORMAL, 10}, {"COLOR", FMT_DRACO_COLOR, 10}, {"TEXCOORD", FMT_DRACO_TEXCOORD, 12}};
    const json_t *a = json_array_get(g->accessors, (size_t)accessor), *view = json_array_get(g->views, (size_t)number_of(a, "bufferView"));
    const char *type = json_string_value(json_object_get(a, "type"));
    json_int_t component = number_of(a, "componentType");
    fmt_draco_attribute out = {.kind = FMT_DRACO_GENERIC, .components = (uint32_t)(type[3] - '0'), .values = g->bytes.data + number_of(view, "byteOffset"),
                               .type = component == GLB_F32 ? FMT_DRACO_F32 : component == GLB_U16 ? FMT_DRACO_U16 : FMT_DRACO_U8};
    for (int i = 0; i < 4; i++) {
        if (strncmp(name, kinds[i].name, strlen(kinds[i].name)) != 0) continue;
        out.kind = kinds[i].kind;
        out.bits = kinds[i].bits == 0 || (kinds[i].kind == FMT_DRACO_TEXCOORD && bits > 12) ? bits : kinds[i].bits;
    }
    return out;
}

static void count_errors(skinned *k, const fmt_draco_arrays *mesh)
{
    fmt_draco_report *r = &k->report;
    r->measured &= mesh->measured;
    for (uint32_t i = 0; i < mesh->attribute_count; i++) {
        const fmt_draco_attribute *a = &mesh->attribute[i];
        double *to = a->kind == FMT_DRACO_POSITION ? &r->position_error : a->kind == FMT_DRACO_NORMAL ? &r->normal_error : a->kind == FMT_DRACO_COLOR ? &r->color_error : &r->uv_error;
        if (a->kind != FMT_DRACO_GENERIC) *to = fmax(*to, a->error);
    }
}

/* The primitive p of the plain file `from`, compressed, into k->g. */
static svo_result compress(skinned *k, const fmt_glb *from, json_t *p, svo_error *err)
{
    fmt_draco_arrays mesh = {.measured = false};
    json_t *attributes = json_object_get(p, "attributes"), *ids = json_object(), *value;
    const json_t *indices = json_array_get(from->accessors, (size_t)number_of(p, "indices"));
    const json_t *index_view = json_array_get(from->views, (size_t)number_of(indices, "bufferView"));
    const char *name;
    svo_buffer bytes;
    uint64_t view;
    mesh.corner = (const uint32_t *)(const void *)(from->bytes.data + number_of(index_view, "byteOffset"));
    mesh.triangles = (uint64_t)number_of(indices, "count") / 3;
    json_object_foreach(attributes, name, value) {
        if (mesh.attribute_count == FMT_DRACO_ATTRIBUTES) break;
        mesh.vertices = (uint64_t)number_of(json_array_get(from->accessors, (size_t)json_integer_value(value)), "count");
        json_object_set_new(ids, name, json_integer(mesh.attribute_count));
        mesh.attribute[mesh.attribute_count++] = plain_attribute(from, name, json_integer_value(value), k->draco);
    }
    svo_buffer_init(&bytes, k->s->allocator);
    svo_result r = fmt_draco_pack(&mesh, &bytes, err);
    if (r == SVO_OK && fmt_glb_view(&k->g, bytes.data, bytes.size, &view)) {
        k->report.plain_bytes += from->bytes.size;
        k->report.bytes += bytes.size;
        count_errors(k, &mesh);
        json_object_foreach(attributes, name, value) {
            const json_t *a = json_array_get(from->accessors, (size_t)json_integer_value(value));
            const fmt_draco_attribute *d = &mesh.attribute[number_of(ids, name)];
            uint64_t accessor = fmt_glb_accessor(&k->g, mesh.decoded_vertices, (int)number_of(a, "componentType"), json_string_value(json_object_get(a, "type")), d->type == FMT_DRACO_U8);
            float low[4], high[4];
            for (int e = 0; e < 4; e++) {
                low[e] = (float)d->low[e];
                high[e] = (float)d->high[e];
            }
            if (d->kind == FMT_DRACO_POSITION) fmt_glb_bounds(&k->g, accessor, low, high, 3);
            json_integer_set(value, (json_int_t)accessor);
        }
        json_object_set_new(p, "indices", json_integer((json_int_t)fmt_glb_accessor(&k->g, 3 * mesh.decoded_triangles, GLB_U32, "SCALAR", false)));
        json_object_set_new(p, "extensions", json_pack("{s:{s:I,s:O}}", "KHR_draco_mesh_compression", "bufferView", (json_int_t)view, "attributes", ids));
    }
    json_decref(ids);
    svo_buffer_free(&bytes);
    return r;
}

/* A primitive is made in a file of its own, and what is in that is compressed. */
static svo_result compressed_primitive(skinned *k, const svo_part *part, const svo_mat4 *m, uint64_t base, json_t **out, svo_error *err)
{
    fmt_glb whole = k->g, plain;
    fmt_glb_begin(&k->g, k->s->allocator);
    *out = primitive(k, part, m, base);
    plain = k->g;
    k->g = whole;
    k->g.failed |= plain.failed;
    svo_result r = *out != NULL && !k->g.failed ? compress(k, &plain, *out, err) : SVO_OK;
    fmt_glb_end(&plain);
    return r;
}

static svo_result primitives(skinned *k, json_t *list, svo_error *err)
{
    uint64_t base = 0;
    for (uint32_t i = 0; i < k->mesh->instance_count; i++) {
        const svo_instance *in = &k->mesh->instances[i];
        const svo_shape *shape = &k->mesh->shapes[in->shape];
        for (uint32_t n = 0; n < shape->part_count; n++) {
            const svo_part *part = &shape->parts[n];
            json_t *p = NULL;
            if (k->draco > 0) SVO_TRY(compressed_primitive(k, part, &in->transform, base, &p, err));
            else p = primitive(k, part, &in->transform, base);
            if (p != NULL) k->g.failed |= json_array_append_new(list, p) != 0;
            base += part->vertex_count;
        }
    }
    return SVO_OK;
}

/* --- nodes, skin ------------------------------------------------------------------------------------------ */

/* Node 0 holds all roots, joint j is node j + 1, the mesh is the last one. */
static json_t *nodes(skinned *k)
{
    const skel_skeleton *s = k->s;
    json_t *list = json_array(), *roots = json_array();
    json_array_append_new(list, json_pack("{s:s,s:o,s:o}", "name", "skeleton", "translation", fmt_glb_vector(k->middle, 3), "children", roots));
    for (uint32_t j = 0; j < s->joint_count; j++) {
        uint32_t parent = k->tree->parent[j];
        double at[3];
        char name[24];
        for (int e = 0; e < 3; e++) at[e] = s->joints[j].position[e] - (parent != SVO_NONE ? s->joints[parent].position[e] : k->middle[e]);
        snprintf(name, sizeof name, "joint_%" PRIu32, j);
        json_array_append_new(list, json_pack("{s:s,s:o,s:{s:f}}", "name", name, "translation", fmt_glb_vector(at, 3), "extras", "radius", s->joints[j].radius));
    }
    for (uint32_t i = 0; i < s->joint_count; i++) { /* parents come first, so children are listed in that order */
        uint32_t j = k->tree->order[i], parent = k->tree->parent[j];
        json_t *node = json_array_get(list, parent == SVO_NONE ? 0 : parent + 1), *children = json_object_get(node, "children");
        if (children == NULL) {
            children = json_array();
            json_object_set_new(node, "children", children);
        }
        json_array_append_new(children, json_integer((json_int_t)j + 1));
    }
    json_array_append_new(list, json_pack("{s:s,s:i,s:i}", "name", "skin", "mesh", 0, "skin", 0));
    return list;
}

static json_t *skin(skinned *k)
{
    const skel_skeleton *s = k->s;
    uint64_t accessor = 0;
    uint8_t *p = fmt_glb_array(&k->g, s->joint_count, 64, GLB_F32, "MAT4", GLB_NO_TARGET, &accessor);
    json_t *joints = json_array();
    for (uint32_t j = 0; j < s->joint_count; j++) {
        json_array_append_new(joints, json_integer((json_int_t)j + 1));
        for (int e = 0; p != NULL && e < 16; e++, p += 4) { /* columns: identity, then the translation from the joint; vertices lie relative to the middle */
            float v = e % 5 == 0 ? 1 : 0;
            if (e >= 12 && e < 15) v = (float)(k->middle[e - 12] - s->joints[j].position[e - 12]);
            fmt_glb_put_f32(p, v);
        }
    }
    return json_pack("[{s:s,s:I,s:i,s:o}]", "name", "skeleton", "inverseBindMatrices", (json_int_t)accessor, "skeleton", 0, "joints", joints);
}

svo_result fmt_export_skinned_glb(fmt_output *out, const svo_mesh *mesh, const skel_skeleton *s, const skel_tree *tree, const skel_skin *weights, uint32_t draco_bits,
                                  fmt_draco_report *report, svo_warnings *warnings, svo_error *err)
{
    if (s->joint_count > UINT16_MAX) return svo_fail(err, SVO_LIMIT, "a glTF skin takes 65535 joints, the skeleton has %u; use a larger omega", s->joint_count);
    if (draco_bits > 24) return svo_fail(err, SVO_INVALID_ARGUMENT, "Draco takes positions of at most 24 bits here, not %u", draco_bits);
    skinned k = {.mesh = mesh, .s = s, .tree = tree, .skin = weights, .draco = draco_bits, .report.measured = true};
    fmt_glb_begin(&k.g, s->allocator);
    find_middle(&k);
    json_t *list = json_array();
    svo_result r = primitives(&k, list, err);
    if (r == SVO_OK && !k.g.failed && json_array_size(list) == 0) r = svo_fail(err, SVO_LIMIT, "no triangle of the model fits the 32-bit floats of glTF");
    json_t *rest = json_pack("{s:i,s:[{s:[i,I]}],s:o,s:[{s:s,s:o}],s:o}", "scene", 0, "scenes", "nodes", 0, (json_int_t)s->joint_count + 1, "nodes", nodes(&k), "meshes",
                             "name", "skin", "primitives", list, "skins", skin(&k));
    k.g.failed |= rest == NULL || json_object_update_missing(k.g.root, rest) != 0;
    json_decref(rest);
    if (draco_bits > 0) fmt_glb_extension(&k.g, "KHR_draco_mesh_compression", true);
    if (r == SVO_OK && !k.g.failed) r = fmt_glb_materials(&k.g, mesh, k.plain, warnings, err);
    if (r == SVO_OK) r = fmt_glb_write(&k.g, out, err);
    fmt_glb_end(&k.g);
    if (report != NULL) *report = k.report;
    if (r == SVO_OK && k.dropped > 0) svo_warn(warnings, "%llu triangles with corners that are not finite are not in the .glb", (unsigned long long)k.dropped);
    return r;
}

/* --- SWC ------------------------------------------------------------------------------------------------------------ */

static svo_result put_text(fmt_output *out, svo_error *err, const char *text, int n) { return n < 0 ? svo_fail(err, SVO_INVALID_ARGUMENT, "no text") : fmt_output_write(out, text, (size_t)n, err); }

svo_result fmt_export_skel_swc(fmt_output *out, const skel_skeleton *s, const skel_tree *tree, svo_error *err)
{
    char line[200];
    uint32_t *number = svo_alloc(s->allocator, s->joint_count, sizeof *number);
    if (number == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the curve");
    svo_result r = put_text(out, err, line, snprintf(line, sizeof line, "# svokit " SVO_VERSION_STRING ": number type x y z radius parent; type 0, %u trees\n", tree->root_count));
    if (r == SVO_OK && tree->loop_count > 0)
        r = put_text(out, err, line, snprintf(line, sizeof line, "# %u bones that close a loop are left out: SWC holds trees\n", tree->loop_count));
    for (uint32_t i = 0; r == SVO_OK && i < s->joint_count; i++) {
        uint32_t j = tree->order[i], parent = tree->parent[j];
        const skel_joint *q = &s->joints[j];
        number[j] = i + 1;
        r = put_text(out, err, line, snprintf(line, sizeof line, "%" PRIu32 " 0 %.17g %.17g %.17g %.17g %lld\n", i + 1, q->position[0], q->position[1], q->position[2], q->radius,
                                              parent == SVO_NONE ? -1LL : (long long)number[parent]));
    }
    svo_free(s->allocator, number, s->joint_count, sizeof *number);
    return r;
}
