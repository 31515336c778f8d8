/* Voxels of a large triangle that none of its edges reaches: most of them, where triangles are much larger than voxels. What the plane leaves of
 * such a voxel depends on one number, its height over the voxel's centre, so nothing is clipped: centroids, covariances and
 * with them the ways to read textures come from a table of 17 heights (svoi_lanes.h). Whether a voxel is one depends on the triangle and the voxel alone. */
#include <math.h>
#include <string.h>

#include "svo_morton.h"
#include "svoi_lanes.h"
#include "svoi_shade.h"
#include "svoi_shade_wide.h"

/* A triangle with less area than this (in voxels, seen along its axis) has too few inner voxels to make a table for. */
static const double least_area = 24;

/* Texel coordinates stay within this, so that single precision has 1/256 texel left. */
static const double most_texels = 65536;

static bool find_texture(svo_facet *t, uint32_t slot, const svo_texture *how, const svo_pyramid *p, svoi_inner *in)
{
    svoi_inner_texture *out = &in->texture[slot];
    if (p == NULL) return true;
    if (how->nearest) return false;
    const svo_facet_texture *f = svoi_facet_texture(t, slot, how, p);
    const double dx = (double)in->base[0] - t->corner[0][(t->axis + 1) % 3], dy = (double)in->base[1] - t->corner[0][(t->axis + 2) % 3];
    const svo_wrap wrap[2] = {how->wrap_u, how->wrap_v};
    const uint32_t size[2] = {p->width[0], p->height[0]};
    for (int k = 0; k < 2; k++) {
        double at = f->corner[0][k] + dx * f->per_x[k] + dy * f->per_y[k];
        if (wrap[k] == SVO_WRAP_REPEAT) at -= floor(at / size[k]) * size[k];
        if (!(fabs(at) + 128 * (fabs(f->per_x[k]) + fabs(f->per_y[k])) < most_texels)) return false;
        out->at[k] = (float)at;
        out->per_x[k] = (float)f->per_x[k];
        out->per_y[k] = (float)f->per_y[k];
    }
    svoi_inner_plan(f, p, in, out);
    return true;
}

/* Centroids and covariances, of planes that are higher and higher over the voxel's centre. */
static void make_table(const svoi_clipper *clipper, svoi_inner *out)
{
    svoi_clipper c = *clipper;
    svoi_clip_batch b;
    const float slope = fabsf(c.gradient[0]) + fabsf(c.gradient[1]), last = 0.5f + 0.5f * slope;
    out->from = slope < 1 ? 0.5f - 0.5f * slope : 0;
    out->steps = slope < 1e-3f ? 1 : SVOI_INNER_STEPS + 1;
    out->per_height = out->steps > 1 ? SVOI_INNER_STEPS / (last - out->from) : 0;
    c.height = 0;
    for (int k = 0; k < 3; k++) { /* no edges */
        c.edge[k].begin = c.edge[k].end = 0;
        c.edge[k].offset = 1e4f;
    }
    for (uint32_t i = 0; i < out->steps; i++) {
        b.x[i] = b.y[i] = -0.5f;
        b.z[i] = -0.5f - (out->from + (float)i * (last - out->from) * (1.0f / SVOI_INNER_STEPS));
    }
    svoi_clip(&c, &b, out->steps, true);
    for (uint32_t i = 0; i < out->steps; i++) {
        out->x[i] = b.cx[i], out->y[i] = b.cy[i];
        out->xx[i] = b.xx[i], out->xy[i] = b.xy[i], out->yy[i] = b.yy[i];
    }
    if (out->steps > 1) { /* nothing is left at the end */
        const uint32_t n = SVOI_INNER_STEPS;
        out->x[n] = fmaxf(-0.5f, fminf(0.5f, 2 * out->x[n - 1] - out->x[n - 2]));
        out->y[n] = fmaxf(-0.5f, fminf(0.5f, 2 * out->y[n - 1] - out->y[n - 2]));
        out->xx[n] = out->xy[n] = out->yy[n] = 0;
    }
    out->x[out->steps] = out->x[out->steps - 1];
    out->y[out->steps] = out->y[out->steps - 1];
}

/* A value at the corners as a linear function of the place. */
static void linear(const svo_facet *t, const svoi_inner *in, double a, double b, double c, float out[3])
{
    const double dx = (double)in->base[0] - t->corner[0][(t->axis + 1) % 3], dy = (double)in->base[1] - t->corner[0][(t->axis + 2) % 3];
    const double per_x = (b - a) * t->per_x[0] + (c - a) * t->per_x[1], per_y = (b - a) * t->per_y[0] + (c - a) * t->per_y[1];
    out[0] = (float)(a + (dx * per_x + dy * per_y));
    out[1] = (float)per_x;
    out[2] = (float)per_y;
}

bool svoi_inner_make(const svo_shader *s, svo_facet *t, svoi_inner *out)
{
    const shade_material *m = svoi_material_of(s, t->material);
    if (t->flat || !t->clips || t->inside || m->alpha_matters || t->normal[t->axis] == 0) return false;
    if (!(fabs(t->normal[t->axis]) > 2 * least_area)) return false;
    const uint32_t x = (t->axis + 1) % 3, y = (t->axis + 2) % 3;
    out->base[0] = (float)fmin(fmax(t->corner[0][x], 0), 128);
    out->base[1] = (float)fmin(fmax(t->corner[0][y], 0), 128);
    make_table(&t->clipper, out);
    if (!find_texture(t, BASE, &m->m.base_color_texture, m->base, out) || !find_texture(t, EMISSIVE, &m->m.emissive_texture, m->emissive, out) ||
        !find_texture(t, METALLIC_ROUGHNESS, &m->m.metallic_roughness_texture, m->metallic_roughness, out))
        return false;
    for (int k = 0; k < 3 && s->layout.normal < SVO_MAX_CHANNELS; k++) linear(t, out, t->corner_normal[0][k], t->corner_normal[1][k], t->corner_normal[2][k], out->normal[k]);
    for (int k = 0; k < 3 && s->layout.color < SVO_MAX_CHANNELS; k++) {
        const double base = (double)m->m.base_color[k];
        const float *c = t->part->colors;
        if (c == NULL) linear(t, out, base, base, base, out->color[k]);
        else
            linear(t, out, base * (double)c[4 * (uint64_t)t->vertex[0] + (uint64_t)k], base * (double)c[4 * (uint64_t)t->vertex[1] + (uint64_t)k],
                   base * (double)c[4 * (uint64_t)t->vertex[2] + (uint64_t)k], out->color[k]);
    }
    return true;
}

/* How far an edge reaches to a voxel's centre. */
static inline float reach_of(const svoi_clip_edge *e) { return 0.501f * (fabsf(e->a[0]) + fabsf(e->a[1])) - e->offset; }

void svoi_inner_bricks(const svo_facet *t, float reach[3])
{
    /* from a brick's centre to its voxels', and more than what rounding can do */
    for (int k = 0; k < 3; k++) reach[k] = reach_of(&t->clipper.edge[k]) + 1.5f * (fabsf(t->clipper.edge[k].a[0]) + fabsf(t->clipper.edge[k].a[1])) + 0.01f;
}

bool svoi_inner_brick(const svo_facet *t, const float reach[3], uint32_t brick)
{
    const svoi_clip_edge *e = t->clipper.edge;
    const float x = (float)(4 * (int32_t)svo_morton_compact(brick >> (t->axis + 1) % 3) + 2), y = (float)(4 * (int32_t)svo_morton_compact(brick >> (t->axis + 2) % 3) + 2);
    return (e[0].a[0] * x + e[0].a[1] * y >= reach[0]) & (e[1].a[0] * x + e[1].a[1] * y >= reach[1]) & (e[2].a[0] * x + e[2].a[1] * y >= reach[2]);
}

void svoi_inner_find(const svo_facet *t, svoi_lanes *l, uint8_t inner[SVOI_LANES])
{
    const svoi_clip_edge *e = t->clipper.edge;
    float reach[3];
    svoi_lanes_place(t, l);
    for (int k = 0; k < 3; k++) reach[k] = reach_of(&e[k]);
    const float ax = e[0].a[0], ay = e[0].a[1], bx = e[1].a[0], by = e[1].a[1], cx = e[2].a[0], cy = e[2].a[1];
    for (uint32_t i = 0, n = (l->count + 7) & ~7u; i < n; i++) {
        const float x = l->clip.x[i] + 0.5f, y = l->clip.y[i] + 0.5f;
        inner[i] = (uint8_t)((ax * x + ay * y >= reach[0]) & (bx * x + by * y >= reach[1]) & (cx * x + cy * y >= reach[2]));
    }
}

enum { LANES = 8 };
typedef float lanes __attribute__((vector_size(4 * LANES)));
typedef int32_t whole __attribute__((vector_size(4 * LANES)));
typedef float quad __attribute__((vector_size(16)));

/* Rows of the table, and centroids. */
static void find_centroids(const svo_facet *t, const svoi_inner *in, uint32_t n, svoi_lanes *l)
{
    const float gx = t->clipper.gradient[0], gy = t->clipper.gradient[1], height = t->clipper.height, from = in->from, per_height = in->per_height;
    const float bx = in->base[0], by = in->base[1];
    if (in->steps == 1) {
        for (uint32_t i = 0; i < n; i++) {
            l->offset_x[i] = l->clip.x[i] + 0.5f - bx;
            l->offset_y[i] = l->clip.y[i] + 0.5f - by;
            l->step[i] = 0;
        }
        return;
    }
    /* rows of the table: where they begin, and how far it is to the next */
    quad rows[SVOI_INNER_STEPS + 1];
    for (uint32_t k = 0; k <= SVOI_INNER_STEPS; k++) rows[k] = (quad){in->x[k], in->y[k], in->x[k + 1] - in->x[k], in->y[k + 1] - in->y[k]};
    const lanes zero = {0}, last = zero + (float)SVOI_INNER_STEPS, one = zero + 1;
    for (uint32_t i = 0; i < n; i += LANES) {
        lanes x, y, z, column_x[2], column_y[2];
        memcpy(&x, l->clip.x + i, sizeof x);
        memcpy(&y, l->clip.y + i, sizeof y);
        memcpy(&z, l->clip.z + i, sizeof z);
        x += 0.5f, y += 0.5f;
        z = gx * x + gy * y + height - (z + 0.5f);
        const whole below = z < zero;
        const lanes side = (lanes)((whole)one | (below & INT32_MIN)), above = (z * side - from) * per_height;
        lanes row = (lanes)((whole)above & (above > zero));
        const whole far = row >= last;
        row = (lanes)(((whole)row & ~far) | ((whole)last & far));
        const whole step = __builtin_convertvector(row, whole), nearest = __builtin_convertvector(row + 0.5f, whole);
        const lanes rest = row - __builtin_convertvector(step, lanes);
        /* a row a lane, to a column a number */
        for (int h = 0; h < 2; h++) {
            const quad *a = &rows[step[4 * h]], *b = &rows[step[4 * h + 1]], *c = &rows[step[4 * h + 2]], *d = &rows[step[4 * h + 3]];
            column_x[h] = (lanes){(*a)[0], (*b)[0], (*c)[0], (*d)[0], (*a)[2], (*b)[2], (*c)[2], (*d)[2]};
            column_y[h] = (lanes){(*a)[1], (*b)[1], (*c)[1], (*d)[1], (*a)[3], (*b)[3], (*c)[3], (*d)[3]};
        }
        const lanes x0 = __builtin_shufflevector(column_x[0], column_x[1], 0, 1, 2, 3, 8, 9, 10, 11), dx = __builtin_shufflevector(column_x[0], column_x[1], 4, 5, 6, 7, 12, 13, 14, 15);
        const lanes y0 = __builtin_shufflevector(column_y[0], column_y[1], 0, 1, 2, 3, 8, 9, 10, 11), dy = __builtin_shufflevector(column_y[0], column_y[1], 4, 5, 6, 7, 12, 13, 14, 15);
        x = (x - bx) + side * (x0 + dx * rest);
        y = (y - by) + side * (y0 + dy * rest);
        memcpy(l->offset_x + i, &x, sizeof x);
        memcpy(l->offset_y + i, &y, sizeof y);
        for (int k = 0; k < LANES; k++) l->step[i + (uint32_t)k] = (uint8_t)nearest[k];
    }
}

static void clamp_unit(float *v, uint32_t n)
{
    for (uint32_t i = 0; i < n; i++) {
        float x = v[i] > 0 ? v[i] : 0;
        v[i] = x < 1 ? x : 1;
    }
}

static void find_normals(const svo_facet *t, const svoi_inner *in, uint32_t n, svoi_lanes *l)
{
    float face[3], all[3];
    svoi_plain_normals(t, face, all);
    l->one_normal = !t->smooth;
    if (!t->smooth) {
        for (int k = 0; k < 3; k++) l->normal[k][0] = all[k];
        return;
    }
    const float(*c)[3] = in->normal;
    const float x0 = c[0][0], x1 = c[0][1], x2 = c[0][2], y0 = c[1][0], y1 = c[1][1], y2 = c[1][2], z0 = c[2][0], z1 = c[2][1], z2 = c[2][2];
    for (uint32_t i = 0; i < n; i++) {
        const float dx = l->offset_x[i], dy = l->offset_y[i];
        const float x = x0 + (dx * x1 + dy * x2), y = y0 + (dx * y1 + dy * y2), z = z0 + (dx * z1 + dy * z2);
        const float square = x * x + y * y + z * z, inverse = 1 / sqrtf(square > 1e-12f ? square : 1);
        const bool none = !(square > 1e-12f); /* they cancel: the face */
        l->normal[0][i] = none ? face[0] : x * inverse;
        l->normal[1][i] = none ? face[1] : y * inverse;
        l->normal[2][i] = none ? face[2] : z * inverse;
    }
}

void svoi_inner_values(const svo_shader *s, svo_facet *t, const svoi_inner *in, svoi_lanes *l)
{
    const shade_material *m = svoi_material_of(s, t->material);
    const svo_shade_layout *layout = &s->layout;
    const uint32_t n = (l->count + 7) & ~7u;
    float texel[4][SVOI_LANES];
    if (svoi_clip_has_wide()) {
        svoi_wide_places(t, in, l);
    } else {
        svoi_lanes_place(t, l);
        find_centroids(t, in, n, l);
    }
    if (layout->color < SVO_MAX_CHANNELS) {
        if (m->base != NULL) svoi_inner_read(&in->texture[BASE], &m->m.base_color_texture, m->base, l, texel);
        for (int k = 0; k < 3; k++) {
            const float at = in->color[k][0], per_x = in->color[k][1], per_y = in->color[k][2];
            for (uint32_t i = 0; i < n; i++) l->color[k][i] = at + (l->offset_x[i] * per_x + l->offset_y[i] * per_y);
            if (m->base != NULL)
                for (uint32_t i = 0; i < n; i++) l->color[k][i] *= texel[k][i];
            clamp_unit(l->color[k], n);
        }
    }
    if (layout->coverage < SVO_MAX_CHANNELS)
        for (uint32_t i = 0; i < n; i++) l->coverage[i] = 1;
    if (layout->normal < SVO_MAX_CHANNELS) find_normals(t, in, n, l);
    if (layout->emissive < SVO_MAX_CHANNELS) {
        if (m->emissive != NULL) svoi_inner_read(&in->texture[EMISSIVE], &m->m.emissive_texture, m->emissive, l, texel);
        for (int k = 0; k < 3; k++) {
            for (uint32_t i = 0; i < l->count; i++) l->emissive[k][i] = m->m.emissive[k] * (m->emissive != NULL ? texel[k][i] : 1);
            clamp_unit(l->emissive[k], l->count);
        }
    }
    if (layout->metallic < SVO_MAX_CHANNELS || layout->roughness < SVO_MAX_CHANNELS) {
        const bool read = m->metallic_roughness != NULL;
        if (read) svoi_inner_read(&in->texture[METALLIC_ROUGHNESS], &m->m.metallic_roughness_texture, m->metallic_roughness, l, texel);
        for (uint32_t i = 0; i < l->count; i++) l->roughness[i] = m->m.roughness * (read ? texel[1][i] : 1);
        for (uint32_t i = 0; i < l->count; i++) l->metallic[i] = m->m.metallic * (read ? texel[2][i] : 1);
        clamp_unit(l->roughness, l->count);
        clamp_unit(l->metallic, l->count);
    }
}
