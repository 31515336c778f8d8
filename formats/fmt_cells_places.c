/* Many places of one mesh in a .glb: EXT_mesh_gpu_instancing. */
#include <math.h>
#include <string.h>

#include "fmt_cells.h"
#include "fmti_cells.h"
#include "svo_math.h"

/* A rotation (columns orthonormal, determinant 1) as a unit quaternion x y z w. From the largest of the four sums, so that nothing cancels. */
static void to_quaternion(const svo_vec3 c[3], double q[4])
{
    const double m[3][3] = {{c[0].x, c[1].x, c[2].x}, {c[0].y, c[1].y, c[2].y}, {c[0].z, c[1].z, c[2].z}};
    const double trace = m[0][0] + m[1][1] + m[2][2];
    int largest = 3;
    for (int k = 0; k < 3; k++)
        if (m[k][k] > (largest == 3 ? trace : m[largest][largest])) largest = k;
    if (largest == 3) {
        q[3] = sqrt(fmax(0, 1 + trace)) / 2;
        for (int k = 0; k < 3; k++) q[k] = (m[(k + 2) % 3][(k + 1) % 3] - m[(k + 1) % 3][(k + 2) % 3]) / (4 * q[3]);
    } else {
        const int a = largest, b = (a + 1) % 3, d = (a + 2) % 3;
        q[a] = sqrt(fmax(0, 1 + m[a][a] - m[b][b] - m[d][d])) / 2;
        q[b] = (m[b][a] + m[a][b]) / (4 * q[a]);
        q[d] = (m[d][a] + m[a][d]) / (4 * q[a]);
        q[3] = (m[d][b] - m[b][d]) / (4 * q[a]);
    }
    double n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int k = 0; k < 4; k++) q[k] /= n;
}

bool fmt_cells_place_of(const double to_world[16], const double origin[3], fmt_cells_place *out)
{
    const double *m = to_world;
    svo_vec3 c[3];
    double scale[3], q[4];
    for (int k = 0; k < 3; k++) {
        c[k] = svo_v3(m[k], m[4 + k], m[8 + k]);
        scale[k] = sqrt(svo_dot(c[k], c[k]));
        if (!(scale[k] > 0) || !isfinite(scale[k])) return false;
        c[k] = svo_normalize(c[k]);
    }
    for (int k = 0; k < 3; k++)
        if (fabs(svo_dot(c[k], c[(k + 1) % 3])) > 1e-5) return false;
    if (svo_dot(svo_cross(c[0], c[1]), c[2]) < 0) { /* a mirror image */
        scale[0] = -scale[0];
        c[0] = svo_scale(c[0], -1);
    }
    to_quaternion(c, q);
    for (int k = 0; k < 4; k++) out->rotation[k] = (float)q[k];
    for (int k = 0; k < 3; k++) out->translation[k] = (float)(m[4 * k + 3] - origin[k]), out->scale[k] = (float)scale[k];
    return true;
}

static uint64_t part(fmt_glb *g, const fmt_cells_place *p, uint64_t count, size_t offset, uint32_t width)
{
    uint64_t accessor = 0;
    uint8_t *to = fmt_glb_array(g, count, 4 * width, GLB_F32, width == 3 ? "VEC3" : "VEC4", GLB_NO_TARGET, &accessor);
    for (uint64_t i = 0; to != NULL && i < count; i++)
        for (uint32_t k = 0; k < width; k++) fmt_glb_put_f32(to + 4 * (width * i + k), ((const float *)(const void *)((const char *)&p[i] + offset))[k]);
    return accessor;
}

void fmt_cells_glb_places(fmt_cells_glb *s, uint64_t mesh, const double origin[3], const fmt_cells_place *places, uint64_t count)
{
    fmt_glb *g = &s->g;
    if (g->failed || count == 0) return;
    const uint64_t t = part(g, places, count, offsetof(fmt_cells_place, translation), 3), r = part(g, places, count, offsetof(fmt_cells_place, rotation), 4),
                   c = part(g, places, count, offsetof(fmt_cells_place, scale), 3);
    json_t *attributes = json_pack("{s:I,s:I,s:I}", "TRANSLATION", (json_int_t)t, "ROTATION", (json_int_t)r, "SCALE", (json_int_t)c);
    json_array_append_new(s->nodes, json_pack("{s:I,s:o,s:{s:{s:o}}}", "mesh", (json_int_t)mesh, "translation", fmt_glb_vector(origin, 3), "extensions", "EXT_mesh_gpu_instancing",
                                              "attributes", attributes));
    fmt_glb_extension(g, "EXT_mesh_gpu_instancing", true); /* without it a viewer would draw one of them, and wrongly */
    s->report.nodes++;
}
