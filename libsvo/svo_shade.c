#include "svo_shade.h"

#include <math.h>
#include <string.h>

#include "svo_task.h"
#include "svo_texture.h"

enum { TEXTURES = 4 }; /* base colour, opacity, emissive, metallic-roughness */

typedef struct shade_material {
    svo_material m;
    const svo_pyramid *base, *opacity, *emissive, *metallic_roughness; /* NULL: not read */
    bool alpha_matters; /* colours are weighted by alpha (MASK, BLEND) */
} shade_material;

struct svo_shader {
    const svo_placement *placement;
    const svo_allocator *allocator;
    svo_grid grid;
    svo_shade_layout layout;
    shade_material *materials; /* material_count + 1: the last is the default */
    svo_pyramid *pyramids;     /* 3 an image, by svo_texel; levels 0: not built */
    bool *mirrored;            /* by instance: the transform turns triangles inside out */
};

/* --- set up --------------------------------------------------------------------------------------------------- */

static uint32_t find_channel(const svo_tree_info *info, const char *name)
{
    for (uint32_t i = 0; i < info->channel_count; i++)
        if (strcmp(info->channels[i].name, name) == 0) return info->channels[i].constant ? SVO_MAX_CHANNELS : i;
    return SVO_MAX_CHANNELS;
}

static svo_shade_layout make_layout(const svo_tree_info *info)
{
    svo_shade_layout l = {.color = find_channel(info, "color"), .normal = find_channel(info, "normal"),
                          .emissive = find_channel(info, "emissive"), .metallic = find_channel(info, "metallic"),
                          .roughness = find_channel(info, "roughness"), .material = find_channel(info, "material")};
    l.sum_weight = l.fields++;
    if (l.color < SVO_MAX_CHANNELS) l.sum_color = l.fields, l.fields += 4;   /* weight, r, g, b */
    if (l.normal < SVO_MAX_CHANNELS) l.sum_normal = l.fields, l.fields += 4; /* x, y, z, largest contribution */
    if (l.emissive < SVO_MAX_CHANNELS) l.sum_emissive = l.fields, l.fields += 3;
    if (l.metallic < SVO_MAX_CHANNELS) l.sum_metallic = l.fields++;
    if (l.roughness < SVO_MAX_CHANNELS) l.sum_roughness = l.fields++;
    return l;
}

const svo_shade_layout *svo_shader_layout(const svo_shader *s) { return &s->layout; }

/* Note that an image is wanted as `kind`; the pyramid is built later. */
static const svo_pyramid *want(svo_shader *s, uint8_t *wanted, const svo_texture *t, svo_texel kind)
{
    if (t->image == SVO_NONE || t->image >= s->placement->mesh->image_count) return NULL;
    uint64_t at = (uint64_t)t->image * 3 + kind;
    wanted[at] = 1;
    return &s->pyramids[at];
}

typedef struct pyramid_job { svo_shader *s; const uint8_t *wanted; } pyramid_job;
static svo_result build_pyramids(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    pyramid_job *job = user;
    for (uint64_t i = begin; i < end; i++)
        if (job->wanted[i])
            SVO_TRY(svo_pyramid_create(&job->s->placement->mesh->images[i / 3], (svo_texel)(i % 3), job->s->allocator, &job->s->pyramids[i], err));
    return SVO_OK;
}

svo_result svo_shader_create(const svo_placement *p, const svo_grid *g, const svo_tree_info *info, uint32_t threads,
                             const svo_allocator *a, svo_shader **out, svo_error *err)
{
    const svo_mesh *mesh = p->mesh;
    svo_shader *s = svo_calloc(a, 1, sizeof *s);
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    s->placement = p;
    s->allocator = a;
    s->grid = *g;
    s->layout = make_layout(info);
    uint64_t pyramids = (uint64_t)mesh->image_count * 3;
    uint8_t *wanted = svo_calloc(a, pyramids, 1);
    s->materials = svo_calloc(a, (uint64_t)mesh->material_count + 1, sizeof *s->materials);
    s->pyramids = svo_calloc(a, pyramids, sizeof *s->pyramids);
    s->mirrored = svo_calloc(a, mesh->instance_count, sizeof *s->mirrored);
    svo_result r = SVO_OK;
    if (s->materials == NULL || (pyramids != 0 && (s->pyramids == NULL || wanted == NULL)) || (mesh->instance_count != 0 && s->mirrored == NULL))
        r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %u materials", mesh->material_count);
    if (r == SVO_OK) {
        const svo_shade_layout *l = &s->layout;
        bool color = l->color < SVO_MAX_CHANNELS;
        for (uint32_t i = 0; i <= mesh->material_count; i++) {
            shade_material *m = &s->materials[i];
            m->m = i < mesh->material_count ? mesh->materials[i] : svo_material_default();
            m->alpha_matters = m->m.alpha_mode != SVO_ALPHA_OPAQUE;
            bool alpha = m->m.alpha_mode == SVO_ALPHA_MASK || (color && m->alpha_matters);
            if (color || alpha) m->base = want(s, wanted, &m->m.base_color_texture, m->alpha_matters ? SVO_TEXEL_COLOR_ALPHA : SVO_TEXEL_COLOR);
            if (alpha) m->opacity = want(s, wanted, &m->m.opacity_texture, SVO_TEXEL_LINEAR);
            if (l->emissive < SVO_MAX_CHANNELS) m->emissive = want(s, wanted, &m->m.emissive_texture, SVO_TEXEL_COLOR);
            if (l->metallic < SVO_MAX_CHANNELS || l->roughness < SVO_MAX_CHANNELS)
                m->metallic_roughness = want(s, wanted, &m->m.metallic_roughness_texture, SVO_TEXEL_LINEAR);
        }
        for (uint32_t i = 0; i < mesh->instance_count; i++) s->mirrored[i] = svo_mat4_det3(&mesh->instances[i].transform) < 0;
        pyramid_job job = {s, wanted};
        r = svo_parallel_for(threads, pyramids, 1, build_pyramids, &job, err);
    }
    svo_free(a, wanted, pyramids, 1);
    if (r != SVO_OK) {
        svo_shader_free(s);
        return r;
    }
    *out = s;
    return SVO_OK;
}

void svo_shader_free(svo_shader *s)
{
    if (s == NULL) return;
    const svo_mesh *mesh = s->placement->mesh;
    uint64_t pyramids = (uint64_t)mesh->image_count * 3;
    for (uint64_t i = 0; s->pyramids != NULL && i < pyramids; i++)
        if (s->pyramids[i].levels != 0) svo_pyramid_free(&s->pyramids[i]);
    svo_free(s->allocator, s->pyramids, pyramids, sizeof *s->pyramids);
    svo_free(s->allocator, s->materials, (uint64_t)mesh->material_count + 1, sizeof *s->materials);
    svo_free(s->allocator, s->mirrored, mesh->instance_count, sizeof *s->mirrored);
    svo_free(s->allocator, s, 1, sizeof *s);
}

/* --- triangles ------------------------------------------------------------------------------------------------ */

static const shade_material *material_of(const svo_shader *s, uint32_t material)
{
    uint32_t count = s->placement->mesh->material_count;
    return &s->materials[material < count ? material : count];
}

bool svo_facet_is_flat(const svo_shader *s, uint32_t group, uint64_t local, bool *masks)
{
    const svo_part *part = s->placement->groups[group].part;
    const shade_material *m = material_of(s, part->material);
    const svo_shade_layout *l = &s->layout;
    *masks = m->m.alpha_mode == SVO_ALPHA_MASK && (m->base != NULL || m->opacity != NULL || part->colors != NULL || m->m.base_color[3] < m->m.alpha_cutoff);
    if (m->base != NULL || m->opacity != NULL || m->emissive != NULL || m->metallic_roughness != NULL) return false;
    if (part->colors != NULL && (l->color < SVO_MAX_CHANNELS || *masks)) return false;
    if (part->normals != NULL && l->normal < SVO_MAX_CHANNELS) {
        const uint32_t *index = part->indices + 3 * local;
        const float *a = part->normals + 3 * (uint64_t)index[0], *b = part->normals + 3 * (uint64_t)index[1], *c = part->normals + 3 * (uint64_t)index[2];
        for (int i = 0; i < 3; i++)
            if (!(a[i] == b[i] && a[i] == c[i])) return false;
    }
    return true;
}

void svo_facet_make(const svo_shader *s, uint32_t group, uint64_t local, const double block[3], svo_facet *out)
{
    const svo_group *g = &s->placement->groups[group];
    out->part = g->part;
    out->instance = g->instance;
    out->material = g->part->material;
    out->flat = svo_facet_is_flat(s, group, local, &out->masks);
    memcpy(out->vertex, g->part->indices + 3 * local, sizeof out->vertex);
    svo_vec3 v[3];
    svo_placement_world(s->placement, g, local, v);
    for (int k = 0; k < 3; k++) {
        out->corner[k][0] = (v[k].x - s->grid.origin[0]) / s->grid.size - block[0];
        out->corner[k][1] = (v[k].y - s->grid.origin[1]) / s->grid.size - block[1];
        out->corner[k][2] = (v[k].z - s->grid.origin[2]) / s->grid.size - block[2];
    }
    double (*c)[3] = out->corner;
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        out->normal[k] = (c[1][i] - c[0][i]) * (c[2][j] - c[0][j]) - (c[1][j] - c[0][j]) * (c[2][i] - c[0][i]);
    }
    out->axis = fabs(out->normal[1]) > fabs(out->normal[0]) ? 1 : 0;
    if (fabs(out->normal[2]) > fabs(out->normal[out->axis])) out->axis = 2;
    out->length = sqrt(out->normal[0] * out->normal[0] + out->normal[1] * out->normal[1] + out->normal[2] * out->normal[2]);
}

/* --- polygons ------------------------------------------------------------------------------------------------- */

/* Sutherland-Hodgman against sign * (x[axis] - at) >= 0. */
static void cut(const svo_polygon *in, uint32_t axis, double at, double sign, svo_polygon *out)
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < in->count; i++) {
        const double *a = in->at[i], *b = in->at[i + 1 < in->count ? i + 1 : 0];
        double da = sign * (a[axis] - at), db = sign * (b[axis] - at);
        if (da >= 0 && n < 10) memcpy(out->at[n++], a, sizeof out->at[0]);
        if ((da >= 0) != (db >= 0) && n < 10) {
            double t = da / (da - db);
            for (int k = 0; k < 3; k++) out->at[n][k] = a[k] + (b[k] - a[k]) * t;
            out->at[n++][axis] = at;
        }
    }
    out->count = n;
}

void svo_polygon_slab(const svo_polygon *in, uint32_t axis, double low, svo_polygon *out)
{
    double least = INFINITY, most = -INFINITY;
    for (uint32_t i = 0; i < in->count; i++) {
        double x = in->at[i][axis];
        least = x < least ? x : least;
        most = x > most ? x : most;
    }
    bool below = least < low, above = most > low + 1;
    if (below && above) {
        svo_polygon half;
        cut(in, axis, low, 1, &half);
        cut(&half, axis, low + 1, -1, out);
    } else if (below) {
        cut(in, axis, low, 1, out);
    } else if (above) {
        cut(in, axis, low + 1, -1, out);
    } else {
        out->count = in->count;
        memcpy(out->at, in->at, in->count * sizeof in->at[0]);
    }
}

/* Where on the triangle a point (on its plane, or near) is. */
static void barycentric(const svo_facet *t, const double p[3], double b[3])
{
    double n = t->normal[t->axis];
    if (n == 0) {
        /* A segment or a point: along its longest axis. */
        uint32_t k = 0;
        double best = -1;
        uint32_t low = 0, high = 0;
        for (uint32_t i = 0; i < 3; i++) {
            uint32_t l = 0, h = 0;
            for (uint32_t c = 1; c < 3; c++) {
                if (t->corner[c][i] < t->corner[l][i]) l = c;
                if (t->corner[c][i] > t->corner[h][i]) h = c;
            }
            double extent = t->corner[h][i] - t->corner[l][i];
            if (extent > best) best = extent, k = i, low = l, high = h;
        }
        b[0] = b[1] = b[2] = 0;
        double x = best > 0 ? (p[k] - t->corner[low][k]) / best : 0;
        x = x > 0 ? x < 1 ? x : 1 : 0;
        b[low] += 1 - x;
        b[high] += x;
        return;
    }
    uint32_t i = (t->axis + 1) % 3, j = (t->axis + 2) % 3;
    const double (*c)[3] = t->corner;
    double x = p[i] - c[0][i], y = p[j] - c[0][j];
    b[1] = (x * (c[2][j] - c[0][j]) - y * (c[2][i] - c[0][i])) / n;
    b[2] = ((c[1][i] - c[0][i]) * y - (c[1][j] - c[0][j]) * x) / n;
    b[0] = 1 - b[1] - b[2];
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        if (!(b[k] > 0)) b[k] = 0;
        sum += b[k];
    }
    for (int k = 0; k < 3; k++) b[k] /= sum;
}

/* Area (voxel faces) and centroid; the middle of its corners when it has no area, the voxel's middle when it is empty. */
static double area_of(const svo_facet *t, const svo_polygon *polygon, const int32_t cell[3], double centre[3])
{
    uint32_t i = (t->axis + 1) % 3, j = (t->axis + 2) % 3;
    const double *o = polygon->at[0];
    double twice = 0, sum[3] = {0, 0, 0};
    for (uint32_t k = 2; k < polygon->count; k++) {
        const double *a = polygon->at[k - 1], *b = polygon->at[k];
        double cross = (a[i] - o[i]) * (b[j] - o[j]) - (a[j] - o[j]) * (b[i] - o[i]);
        twice += cross;
        for (int c = 0; c < 3; c++) sum[c] += cross * ((a[c] - o[c]) + (b[c] - o[c]));
    }
    if (polygon->count == 0) {
        for (int c = 0; c < 3; c++) centre[c] = cell[c] + 0.5;
        return 0;
    }
    double n = t->normal[t->axis];
    if (fabs(twice) > 1e-12) {
        for (int c = 0; c < 3; c++) centre[c] = o[c] + sum[c] / (3 * twice);
    } else {
        for (int c = 0; c < 3; c++) {
            centre[c] = 0;
            for (uint32_t k = 0; k < polygon->count; k++) centre[c] += polygon->at[k][c] / polygon->count;
        }
    }
    return n != 0 ? 0.5 * fabs(twice) * (t->length / fabs(n)) : 0;
}

/* --- reading textures ----------------------------------------------------------------------------------------- */

static void uv_at(const svo_facet *t, const svo_texture *how, const double b[3], double uv[2])
{
    const float *set = t->part->uvs[how->uv_set];
    double u = 0, v = 0;
    if (set != NULL)
        for (int k = 0; k < 3; k++) {
            u += b[k] * set[2 * (uint64_t)t->vertex[k]];
            v += b[k] * set[2 * (uint64_t)t->vertex[k] + 1];
        }
    uv[0] = how->transform[0] * u + how->transform[1] * v + how->transform[2];
    uv[1] = how->transform[3] * u + how->transform[4] * v + how->transform[5];
}

/* Average of a texture over a polygon: a fan of triangles about the centroid, each read at its own centroid in the mip
 * level where a texel has its size; one reading where the whole polygon is smaller than a texel. */
static void read_texture(const svo_facet *t, const svo_texture *how, const svo_pyramid *p, const svo_polygon *polygon,
                         const double centre[3], double area, float out[4])
{
    double corner[3][2], b[3], uv[2];
    for (int k = 0; k < 3; k++) {
        double unit[3] = {k == 0, k == 1, k == 2};
        uv_at(t, how, unit, corner[k]);
        corner[k][0] *= p->width[0];
        corner[k][1] *= p->height[0];
    }
    double texels = fabs((corner[1][0] - corner[0][0]) * (corner[2][1] - corner[0][1]) - (corner[1][1] - corner[0][1]) * (corner[2][0] - corner[0][0]));
    double density = t->length > 0 ? texels / t->length : 0; /* texels a voxel face */
    double footprint = density * area;
    barycentric(t, centre, b);
    if (polygon->count < 3 || !(area > 0) || (footprint < 0.25 && !how->nearest)) {
        uv_at(t, how, b, uv);
        double level = footprint > 1 ? 0.5 * log2(footprint) : 0;
        svo_pyramid_sample(p, how, uv[0], uv[1], level, out);
        return;
    }
    double sum[4] = {0, 0, 0, 0}, total = 0;
    uint32_t i = (t->axis + 1) % 3, j = (t->axis + 2) % 3;
    double scale = t->length / fabs(t->normal[t->axis]);
    for (uint32_t k = 0; k < polygon->count; k++) {
        const double *a = polygon->at[k], *c = polygon->at[k + 1 < polygon->count ? k + 1 : 0];
        double cross = fabs((a[i] - centre[i]) * (c[j] - centre[j]) - (a[j] - centre[j]) * (c[i] - centre[i]));
        if (!(cross > 0)) continue;
        double middle[3];
        for (int x = 0; x < 3; x++) middle[x] = (a[x] + c[x] + centre[x]) / 3;
        barycentric(t, middle, b);
        uv_at(t, how, b, uv);
        double part = 0.5 * cross * scale * density;
        float texel[4];
        svo_pyramid_sample(p, how, uv[0], uv[1], part > 1 ? 0.5 * log2(part) : 0, texel);
        for (int x = 0; x < 4; x++) sum[x] += cross * (double)texel[x];
        total += cross;
    }
    if (total > 0) {
        for (int x = 0; x < 4; x++) out[x] = (float)(sum[x] / total);
    } else {
        uv_at(t, how, b, uv);
        svo_pyramid_sample(p, how, uv[0], uv[1], 0, out);
    }
}

/* Largest alpha that a texture has anywhere in the polygon. */
static double most_alpha(const svo_facet *t, const svo_texture *how, const svo_pyramid *p, const svo_polygon *polygon, const double centre[3])
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, most = 0;
    bool color = p->kind == SVO_TEXEL_COLOR_ALPHA;
    for (uint32_t k = 0; k <= polygon->count; k++) {
        double b[3], uv[2];
        float texel[4];
        barycentric(t, k == polygon->count ? centre : polygon->at[k], b);
        uv_at(t, how, b, uv);
        svo_pyramid_sample(p, how, uv[0], uv[1], 0, texel);
        double alpha = color ? texel[3] : texel[0];
        if (alpha > most) most = alpha;
        for (int i = 0; i < 2; i++) {
            if (uv[i] < low[i]) low[i] = uv[i];
            if (uv[i] > high[i]) high[i] = uv[i];
        }
    }
    /* Smaller than a texel: the readings above have seen it all. Larger: look at every texel. */
    if (!color || ((high[0] - low[0]) * p->width[0] <= 1 && (high[1] - low[1]) * p->height[0] <= 1)) return most;
    double texels = svo_pyramid_most_alpha(p, how, low[0], high[0], low[1], high[1]);
    return texels > most ? texels : most;
}

/* --- contributions -------------------------------------------------------------------------------------------- */

bool svo_facet_visible(const svo_shader *s, const svo_facet *t, const svo_polygon *polygon, const int32_t cell[3])
{
    if (!t->masks) return true;
    const shade_material *m = material_of(s, t->material);
    double centre[3], b[3];
    area_of(t, polygon, cell, centre);
    double alpha = m->m.base_color[3];
    if (t->part->colors != NULL) {
        barycentric(t, centre, b);
        double vertex = 0;
        for (int k = 0; k < 3; k++) vertex += b[k] * t->part->colors[4 * (uint64_t)t->vertex[k] + 3];
        alpha *= vertex;
    }
    if (m->base != NULL) alpha *= most_alpha(t, &m->m.base_color_texture, m->base, polygon, centre);
    if (m->opacity != NULL) alpha *= most_alpha(t, &m->m.opacity_texture, m->opacity, polygon, centre);
    return alpha >= m->m.alpha_cutoff;
}

static uint16_t to16(double v) { return v > 0 ? v < 1 ? (uint16_t)(v * 65535 + 0.5) : 65535 : 0; }

static void normal_at(const svo_shader *s, const svo_facet *t, const double b[3], int32_t out[3])
{
    svo_vec3 n = {0, 0, 0};
    if (t->part->normals != NULL) {
        for (int k = 0; k < 3; k++) {
            const float *v = t->part->normals + 3 * (uint64_t)t->vertex[k];
            svo_vec3 unit = svo_normalize(svo_v3(v[0], v[1], v[2]));
            n = svo_add(n, svo_scale(unit, b[k]));
        }
        const svo_mat4 *m = &s->placement->mesh->instances[t->instance].transform;
        n = svo_normalize(svo_mat4_normal(m, n));
    }
    if (!(svo_dot(n, n) > 0.5)) { /* none, or they cancel */
        n = svo_normalize(svo_v3(t->normal[0], t->normal[1], t->normal[2]));
        /* A mirroring transform turns the corners' order round; the front stays the front. */
        if (s->mirrored[t->instance]) n = svo_scale(n, -1);
    }
    out[0] = (int32_t)floor(n.x * 32767 + 0.5);
    out[1] = (int32_t)floor(n.y * 32767 + 0.5);
    out[2] = (int32_t)floor(n.z * 32767 + 0.5);
}

uint64_t svo_facet_weight(const svo_shader *s, const svo_facet *t, const svo_polygon *polygon, const int32_t cell[3], uint32_t shift)
{
    if (!svo_facet_visible(s, t, polygon, cell)) return 0;
    double centre[3], weight = area_of(t, polygon, cell, centre) * (double)((uint64_t)1 << shift) + 0.5;
    return weight >= 1 ? (uint64_t)weight : 1;
}

bool svo_facet_contribution(const svo_shader *s, const svo_facet *t, const svo_polygon *polygon, const int32_t cell[3], uint32_t shift,
                              svo_contribution *out)
{
    if (!svo_facet_visible(s, t, polygon, cell)) return false;
    const shade_material *m = material_of(s, t->material);
    const svo_shade_layout *l = &s->layout;
    double centre[3], b[3];
    double area = area_of(t, polygon, cell, centre);
    barycentric(t, centre, b);
    memset(out, 0, sizeof *out);
    double weight = area * (double)((uint64_t)1 << shift) + 0.5;
    out->weight = out->color_weight = weight >= 1 ? (uint64_t)weight : 1;
    if (l->color < SVO_MAX_CHANNELS) {
        double c[4] = {m->m.base_color[0], m->m.base_color[1], m->m.base_color[2], m->m.base_color[3]};
        if (t->part->colors != NULL) {
            double v[4] = {0, 0, 0, 0};
            for (int k = 0; k < 3; k++)
                for (int i = 0; i < 4; i++) v[i] += b[k] * t->part->colors[4 * (uint64_t)t->vertex[k] + (uint64_t)i];
            for (int i = 0; i < 4; i++) c[i] *= v[i];
        }
        if (m->base != NULL) {
            float texel[4];
            read_texture(t, &m->m.base_color_texture, m->base, polygon, centre, area, texel);
            if (m->alpha_matters && texel[3] > 0)
                for (int i = 0; i < 3; i++) texel[i] /= texel[3]; /* stored premultiplied */
            for (int i = 0; i < 4; i++) c[i] *= texel[i];
        }
        if (m->opacity != NULL) {
            float texel[4];
            read_texture(t, &m->m.opacity_texture, m->opacity, polygon, centre, area, texel);
            c[3] *= texel[0];
        }
        for (int i = 0; i < 3; i++) out->color[i] = to16(c[i]);
        if (m->alpha_matters) {
            weight = (double)out->weight * (c[3] > 0 ? c[3] < 1 ? c[3] : 1 : 0) + 0.5;
            out->color_weight = weight >= 1 ? (uint64_t)weight : 1;
        }
    }
    if (l->normal < SVO_MAX_CHANNELS) normal_at(s, t, b, out->normal);
    if (l->emissive < SVO_MAX_CHANNELS) {
        float texel[4] = {1, 1, 1, 1};
        if (m->emissive != NULL) read_texture(t, &m->m.emissive_texture, m->emissive, polygon, centre, area, texel);
        for (int i = 0; i < 3; i++) out->emissive[i] = to16((double)m->m.emissive[i] * (double)texel[i]);
    }
    if (l->metallic < SVO_MAX_CHANNELS || l->roughness < SVO_MAX_CHANNELS) {
        float texel[4] = {1, 1, 1, 1};
        if (m->metallic_roughness != NULL) read_texture(t, &m->m.metallic_roughness_texture, m->metallic_roughness, polygon, centre, area, texel);
        out->roughness = to16((double)m->m.roughness * (double)texel[1]);
        out->metallic = to16((double)m->m.metallic * (double)texel[2]);
    }
    return true;
}

void svo_shade_add(const svo_shade_layout *l, const svo_contribution *c, uint64_t *sums)
{
    sums[l->sum_weight] += c->weight;
    if (l->color < SVO_MAX_CHANNELS) {
        uint64_t *f = sums + l->sum_color;
        f[0] += c->color_weight;
        for (int i = 0; i < 3; i++) f[1 + i] += c->color_weight * c->color[i];
    }
    if (l->normal < SVO_MAX_CHANNELS) {
        uint64_t *f = sums + l->sum_normal;
        /* two's complement: negative terms come out right after the sum is read back as signed */
        for (int i = 0; i < 3; i++) f[i] += c->weight * (uint64_t)(int64_t)c->normal[i];
        /* The largest contribution, for normals that cancel: 28 bits of weight over 3 x 12 bits of direction. */
        uint64_t weight = c->weight < 1 << 28 ? c->weight : (1 << 28) - 1, key = weight << 36;
        for (int i = 0; i < 3; i++) key |= (uint64_t)((uint32_t)(c->normal[i] + 32768) >> 4) << 12 * i;
        if (key > f[3]) f[3] = key;
    }
    if (l->emissive < SVO_MAX_CHANNELS)
        for (int i = 0; i < 3; i++) sums[l->sum_emissive + (uint32_t)i] += c->weight * c->emissive[i];
    if (l->metallic < SVO_MAX_CHANNELS) sums[l->sum_metallic] += c->weight * c->metallic;
    if (l->roughness < SVO_MAX_CHANNELS) sums[l->sum_roughness] += c->weight * c->roughness;
}

void svo_shade_value(const svo_shade_layout *l, const uint64_t *sums, uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE])
{
    double weight = (double)sums[l->sum_weight] * 65535;
    if (l->color < SVO_MAX_CHANNELS) {
        const uint64_t *f = sums + l->sum_color;
        for (int i = 0; i < 3; i++) values[l->color][i] = svo_linear_to_srgb((float)((double)f[1 + i] / ((double)f[0] * 65535)));
    }
    if (l->normal < SVO_MAX_CHANNELS) {
        const uint64_t *f = sums + l->sum_normal;
        svo_vec3 n = {(double)(int64_t)f[0], (double)(int64_t)f[1], (double)(int64_t)f[2]};
        double length = sqrt(svo_dot(n, n));
        if (length < 1e-3 * 32767 * (double)sums[l->sum_weight]) {
            double d[3];
            for (int i = 0; i < 3; i++) d[i] = (double)(f[3] >> 12 * i & 0xfff) * 16 + 8 - 32768;
            n = svo_v3(d[0], d[1], d[2]);
            length = sqrt(svo_dot(n, n));
        }
        float unit[3] = {(float)(n.x / length), (float)(n.y / length), (float)(n.z / length)};
        svo_oct32_encode(unit, values[l->normal]);
    }
    if (l->emissive < SVO_MAX_CHANNELS)
        for (uint32_t i = 0; i < 3; i++)
            values[l->emissive][i] = svo_linear_to_srgb((float)((double)sums[l->sum_emissive + i] / weight));
    if (l->metallic < SVO_MAX_CHANNELS) values[l->metallic][0] = (uint8_t)((double)sums[l->sum_metallic] / weight * 255 + 0.5);
    if (l->roughness < SVO_MAX_CHANNELS) values[l->roughness][0] = (uint8_t)((double)sums[l->sum_roughness] / weight * 255 + 0.5);
}
