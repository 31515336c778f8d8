/* A skeleton's curve as binary glTF 2.0: one node at the middle of the curve, its mesh with a LINES primitive for the bones and a POINTS primitive for
 * joints without bones, both over one list of f32 positions. */
#include <math.h>
#include <string.h>

#include "fmti_glb.h"
#include "fmt_skel.h"

/* Positions relative to the middle of their box, so that a large offset costs no precision. */
static svo_result put_positions(fmt_glb *g, const skel_skeleton *s, double middle[3], svo_error *err)
{
    double low[3], high[3];
    float least[3] = {INFINITY, INFINITY, INFINITY}, most[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (int k = 0; k < 3; k++) low[k] = high[k] = s->joints[0].position[k];
    for (uint32_t j = 1; j < s->joint_count; j++)
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], s->joints[j].position[k]);
            high[k] = fmax(high[k], s->joints[j].position[k]);
        }
    uint64_t accessor;
    uint8_t *p = fmt_glb_array(g, s->joint_count, 12, GLB_F32, "VEC3", GLB_ARRAY_BUFFER, &accessor);
    if (p == NULL) return SVO_OK; /* said when it is written */
    for (int k = 0; k < 3; k++) middle[k] = 0.5 * low[k] + 0.5 * high[k];
    for (uint32_t j = 0; j < s->joint_count; j++)
        for (int k = 0; k < 3; k++, p += 4) {
            float v = (float)(s->joints[j].position[k] - middle[k]);
            least[k] = fminf(least[k], v);
            most[k] = fmaxf(most[k], v);
            fmt_glb_put_f32(p, v);
        }
    for (int k = 0; k < 3; k++)
        if (!isfinite(least[k]) || !isfinite(most[k])) return svo_fail(err, SVO_LIMIT, "the curve is too large for the 32-bit floats of glTF");
    fmt_glb_bounds(g, accessor, least, most, 3);
    return SVO_OK;
}

static void add_primitive(json_t *primitives, uint64_t accessor, int mode)
{
    json_array_append_new(primitives, json_pack("{s:{s:i},s:I,s:i}", "attributes", "POSITION", 0, "indices", (json_int_t)accessor, "mode", mode));
}

static svo_result describe(fmt_glb *g, const skel_skeleton *s, svo_error *err)
{
    double middle[3] = {0, 0, 0};
    uint64_t accessor, loose = 0, n = s->joint_count;
    json_t *primitives = json_array();
    svo_result r = put_positions(g, s, middle, err);
    uint8_t *used = svo_calloc(s->allocator, n, 1), *p;
    if (r == SVO_OK && used == NULL) r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the curve");
    if (r == SVO_OK && s->bone_count > 0 && (p = fmt_glb_array(g, 2 * (uint64_t)s->bone_count, 4, GLB_U32, "SCALAR", GLB_ELEMENT_ARRAY_BUFFER, &accessor)) != NULL) {
        for (uint32_t b = 0; b < s->bone_count; b++, p += 8) {
            fmt_store32(p, s->bones[b].a);
            fmt_store32(p + 4, s->bones[b].b);
            used[s->bones[b].a] = used[s->bones[b].b] = 1;
        }
        add_primitive(primitives, accessor, GLB_LINES);
    }
    for (uint32_t j = 0; r == SVO_OK && j < n; j++) loose += used[j] == 0;
    if (loose > 0 && (p = fmt_glb_array(g, loose, 4, GLB_U32, "SCALAR", GLB_ELEMENT_ARRAY_BUFFER, &accessor)) != NULL) {
        for (uint32_t j = 0; j < n; j++) {
            if (used[j]) continue;
            fmt_store32(p, j);
            p += 4;
        }
        add_primitive(primitives, accessor, GLB_POINTS);
    }
    svo_free(s->allocator, used, n, 1);
    json_t *rest = json_pack("{s:i,s:[{s:[i]}],s:[{s:s,s:i,s:o}],s:[{s:s,s:o}]}", "scene", 0, "scenes", "nodes", 0, "nodes", "name", "skeleton", "mesh", 0,
                             "translation", fmt_glb_vector(middle, 3), "meshes", "name", "skeleton", "primitives", primitives);
    g->failed |= rest == NULL || json_object_update_missing(g->root, rest) != 0;
    json_decref(rest);
    return r;
}

svo_result fmt_export_skel_glb(fmt_output *out, const skel_skeleton *s, svo_error *err)
{
    SVO_ASSERT(s->joint_count > 0);
    fmt_glb g;
    fmt_glb_begin(&g, s->allocator);
    svo_result r = describe(&g, s, err);
    if (r == SVO_OK) r = fmt_glb_write(&g, out, err);
    fmt_glb_end(&g);
    return r;
}
