#include "svoi_reference.h"

#include <math.h>
#include <string.h>

#include "svo_color.h"
#include "svo_morton.h"
#include "svo_task.h"
#include "svo_texture.h"

/* The part of a triangle in the voxel: corners with their barycentric coordinates. */
typedef struct part_polygon { uint32_t count; double at[10][3], b[10][3]; } part_polygon;

/* The side sign * (x - at) >= 0 of an axis. */
static void cut(const part_polygon *in, int axis, double at, double sign, part_polygon *out)
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < in->count && n + 1 < 10; i++) {
        uint32_t j = i + 1 < in->count ? i + 1 : 0;
        double from = sign * (in->at[i][axis] - at), to = sign * (in->at[j][axis] - at);
        if (from >= 0) {
            memcpy(out->at[n], in->at[i], sizeof out->at[n]);
            memcpy(out->b[n], in->b[i], sizeof out->b[n]);
            n++;
        }
        if ((from >= 0) == (to >= 0)) continue;
        double t = from / (from - to);
        for (int k = 0; k < 3; k++) {
            out->at[n][k] = in->at[i][k] + (in->at[j][k] - in->at[i][k]) * t;
            out->b[n][k] = in->b[i][k] + (in->b[j][k] - in->b[i][k]) * t;
        }
        n++;
    }
    out->count = n;
}

/* Area of the fan of corners 0, k, k + 1. */
static double fan_area(const part_polygon *p, uint32_t k)
{
    double a[3], b[3], n[3];
    for (int i = 0; i < 3; i++) a[i] = p->at[k][i] - p->at[0][i], b[i] = p->at[k + 1][i] - p->at[0][i];
    for (int i = 0; i < 3; i++) n[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
    return 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

typedef struct reference_sums {
    double area, color_weight, color[3], normal[3], emissive[3], metallic, roughness, coverage;
} reference_sums;

typedef struct measure {
    const svo_placement *placement;
    const svo_grid *grid;
    const svo_tree_info *info;
    const svoi_sample *samples;
    const uint32_t *triangles;
    svo_pyramid *pyramids; /* 3 an image, of the finest level alone */
    double (*errors)[SVO_MAX_CHANNELS]; /* a sample; negative: nothing to compare */
    bool color, emissive, surface;      /* channels that are compared: colour, emissive, metallic or roughness */
} measure;

static bool read_image(const measure *m, const svo_part *part, const uint32_t *vertex, const double b[3], const svo_texture *how, svo_texel kind, double out[4])
{
    for (int i = 0; i < 4; i++) out[i] = 1;
    if (how->image == SVO_NONE || how->image >= m->placement->mesh->image_count) return false;
    const float *set = part->uvs[how->uv_set];
    double u = 0, v = 0;
    for (int k = 0; k < 3 && set != NULL; k++) u += b[k] * (double)set[2 * (uint64_t)vertex[k]], v += b[k] * (double)set[2 * (uint64_t)vertex[k] + 1];
    float texel[4];
    svo_pyramid_sample(&m->pyramids[3 * (uint64_t)how->image + (uint64_t)kind], how, how->transform[0] * u + how->transform[1] * v + how->transform[2],
                       how->transform[3] * u + how->transform[4] * v + how->transform[5], -1, texel);
    for (int i = 0; i < 4; i++) out[i] = (double)texel[i];
    return true;
}

static double clamp01(double x) { return x > 0 ? x < 1 ? x : 1 : 0; }

/* What a triangle looks like, and its points' normals. */
typedef struct surface {
    const svo_part *part;
    const svo_material *material;
    const uint32_t *vertex;
    svo_vec3 normal[3], face;
    uint32_t label;
} surface;

static void add_point(const measure *m, const surface *s, const double b[3], double share, reference_sums *sums, double *most_alpha)
{
    const svo_material *mat = s->material;
    double color[4] = {1, 1, 1, 1}, texel[4], alpha = 1;
    const bool weighted = mat->alpha_mode != SVO_ALPHA_OPAQUE;
    if (s->part->colors != NULL)
        for (int i = 0; i < 4; i++) {
            color[i] = 0;
            for (int k = 0; k < 3; k++) color[i] += b[k] * (double)s->part->colors[4 * (uint64_t)s->vertex[k] + (uint64_t)i];
        }
    for (int i = 0; i < 4; i++) color[i] *= (double)mat->base_color[i];
    if ((m->color || weighted) && read_image(m, s->part, s->vertex, b, &mat->base_color_texture, weighted ? SVO_TEXEL_COLOR_ALPHA : SVO_TEXEL_COLOR, texel)) {
        for (int i = 0; i < 3; i++) color[i] *= weighted && texel[3] > 0 ? texel[i] / texel[3] : texel[i];
        color[3] *= texel[3];
    }
    if (weighted && read_image(m, s->part, s->vertex, b, &mat->opacity_texture, SVO_TEXEL_LINEAR, texel)) color[3] *= texel[0];
    if (weighted) alpha = clamp01(color[3]);
    if (alpha > *most_alpha) *most_alpha = alpha;
    sums->area += share;
    sums->color_weight += share * alpha;
    for (int i = 0; i < 3; i++) sums->color[i] += share * alpha * clamp01(color[i]);
    sums->coverage += share * alpha;
    svo_vec3 n = svo_add(svo_add(svo_scale(s->normal[0], b[0]), svo_scale(s->normal[1], b[1])), svo_scale(s->normal[2], b[2]));
    double length = svo_length(n);
    if (!(length > 1e-9)) n = s->face, length = 1;
    sums->normal[0] += share * n.x / length;
    sums->normal[1] += share * n.y / length;
    sums->normal[2] += share * n.z / length;
    if (m->emissive) {
        read_image(m, s->part, s->vertex, b, &mat->emissive_texture, SVO_TEXEL_COLOR, texel);
        for (int i = 0; i < 3; i++) sums->emissive[i] += share * clamp01((double)mat->emissive[i] * texel[i]);
    }
    if (!m->surface) return;
    read_image(m, s->part, s->vertex, b, &mat->metallic_roughness_texture, SVO_TEXEL_LINEAR, texel);
    sums->roughness += share * clamp01((double)mat->roughness * texel[1]);
    sums->metallic += share * clamp01((double)mat->metallic * texel[2]);
}

/* Spread n points over a polygon: evenly along the fan's area, by the plastic number across. */
static void add_polygon(const measure *m, const surface *s, const part_polygon *p, double area, uint32_t n, reference_sums *sums, double *most_alpha)
{
    double begin = 0, end = fan_area(p, 1), u = 0.5, v = 0.5;
    uint32_t k = 1;
    for (uint32_t i = 0; i < n; i++) {
        double at = (i + 0.5) / n * area;
        while (at > end && k + 2 < p->count) begin = end, k++, end = begin + fan_area(p, k);
        u += 0.7548776662466927, v += 0.5698402909980532;
        u -= u >= 1, v -= v >= 1;
        double root = sqrt(u), w[3] = {1 - root, root * (1 - v), root * v}, b[3];
        for (int c = 0; c < 3; c++) b[c] = w[0] * p->b[0][c] + w[1] * p->b[k][c] + w[2] * p->b[k + 1][c];
        add_point(m, s, b, area / n, sums, most_alpha);
    }
}

static void surface_of(const measure *m, const svo_group *g, uint64_t local, const double corner[3][3], const svo_material *fallback, surface *out)
{
    const svo_mesh *mesh = m->placement->mesh;
    const svo_mat4 *transform = &mesh->instances[g->instance].transform;
    out->part = g->part;
    out->material = g->part->material < mesh->material_count ? &mesh->materials[g->part->material] : fallback;
    out->label = g->part->material < mesh->material_count ? g->part->material : UINT16_MAX;
    out->vertex = g->part->indices + 3 * local;
    double a[3], b[3];
    for (int i = 0; i < 3; i++) a[i] = corner[1][i] - corner[0][i], b[i] = corner[2][i] - corner[0][i];
    out->face = svo_normalize(svo_v3(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]));
    if (svo_mat4_det3(transform) < 0) out->face = svo_scale(out->face, -1);
    double longest = 0;
    for (int k = 0; k < 3 && g->part->normals != NULL; k++) {
        const float *n = g->part->normals + 3 * (uint64_t)out->vertex[k];
        out->normal[k] = svo_mat4_normal(transform, svo_normalize(svo_v3((double)n[0], (double)n[1], (double)n[2])));
        longest = fmax(longest, svo_length(out->normal[k]));
    }
    bool usable = longest > 0 && isfinite(longest);
    for (int k = 0; k < 3; k++) out->normal[k] = usable ? svo_scale(out->normal[k], 1 / longest) : out->face;
}

/* Add what the triangle has in the voxel, and its area to its material's. */
static double polygon_of(const measure *m, uint32_t triangle, const double cell[3], double corner[3][3], part_polygon *out)
{
    const svo_placement *p = m->placement;
    const svo_group *g = &p->groups[svo_placement_group(p, triangle)];
    svo_vec3 v[3];
    svo_placement_world(p, g, triangle - g->first, v);
    part_polygon other = {.count = 3};
    for (int k = 0; k < 3; k++) {
        const double world[3] = {v[k].x, v[k].y, v[k].z};
        for (int i = 0; i < 3; i++) other.at[k][i] = corner[k][i] = (world[i] - m->grid->origin[i]) / m->grid->size - cell[i];
        for (int i = 0; i < 3; i++) other.b[k][i] = i == k;
    }
    for (int axis = 0; axis < 3; axis++) {
        cut(&other, axis, 0, 1, out);
        cut(out, axis, 1, -1, &other);
    }
    *out = other;
    double area = 0;
    for (uint32_t k = 1; k + 1 < out->count; k++) area += fan_area(out, k);
    return area;
}

static double compare(const measure *m, const svo_channel *c, const uint8_t *value, const reference_sums *r, uint32_t label)
{
    (void)m;
    if (c->kind == SVO_KIND_COLOR_SRGB8) {
        const bool emissive = strcmp(c->name, "emissive") == 0;
        double weight = emissive ? r->area : r->color_weight;
        if (!(weight > 0.02 * r->area)) return -1; /* nearly invisible: it has no colour to speak of */
        uint8_t expected[3];
        for (int i = 0; i < 3; i++) expected[i] = svo_linear_to_srgb((float)((emissive ? r->emissive[i] : r->color[i]) / weight));
        float a[3], b[3];
        svo_srgb8_to_lab(expected, a);
        svo_srgb8_to_lab(value, b);
        return svo_delta_e94(a, b);
    }
    if (c->kind == SVO_KIND_NORMAL_OCT32) {
        float n[3];
        svo_oct32_decode(value, n);
        double x = (double)n[0], y = (double)n[1], z = (double)n[2];
        double length = sqrt(r->normal[0] * r->normal[0] + r->normal[1] * r->normal[1] + r->normal[2] * r->normal[2]);
        if (!(length > 0.01 * r->area)) return -1; /* the sides cancel: no direction is right */
        double dot = (r->normal[0] * x + r->normal[1] * y + r->normal[2] * z) / length;
        double cx = r->normal[1] * z - r->normal[2] * y, cy = r->normal[2] * x - r->normal[0] * z, cz = r->normal[0] * y - r->normal[1] * x;
        return atan2(sqrt(cx * cx + cy * cy + cz * cz) / length, dot) * (180 / 3.14159265358979323846);
    }
    if (c->kind == SVO_KIND_ID16) return (uint32_t)value[0] + 256 * (uint32_t)value[1] != label;
    double expected = strcmp(c->name, "metallic") == 0 ? r->metallic : strcmp(c->name, "coverage") == 0 ? r->coverage : r->roughness;
    return fabs(expected / r->area - value[0] / 255.0);
}

static svo_result measure_voxels(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    const measure *m = user;
    const svo_material fallback = svo_material_default();
    for (uint64_t v = begin; v < end; v++) {
        const svoi_sample *s = &m->samples[v];
        const uint32_t *triangles = m->triangles + s->first;
        uint32_t x, y, z, label = UINT32_MAX;
        svo_morton_decode(s->code, &x, &y, &z);
        const double cell[3] = {x, y, z};
        double corner[3][3], whole = 0, best = 0;
        part_polygon polygon;
        for (uint32_t t = 0; t < s->count; t++) whole += polygon_of(m, triangles[t], cell, corner, &polygon);
        reference_sums r = {0};
        struct { uint32_t label; double area; } labels[16];
        uint32_t label_count = 0;
        for (uint32_t t = 0; t < s->count && whole > 0; t++) {
            double area = polygon_of(m, triangles[t], cell, corner, &polygon), most_alpha = 0;
            if (!(area > 0)) continue;
            const svo_group *g = &m->placement->groups[svo_placement_group(m->placement, triangles[t])];
            surface facet;
            surface_of(m, g, triangles[t] - g->first, (const double(*)[3])corner, &fallback, &facet);
            uint32_t points = (uint32_t)ceil(area / whole * SVO_REFERENCE_POINTS);
            reference_sums before = r;
            add_polygon(m, &facet, &polygon, area, points, &r, &most_alpha);
            if (facet.material->alpha_mode == SVO_ALPHA_MASK && most_alpha < (double)facet.material->alpha_cutoff) {
                r = before; /* nothing of it is visible here */
                continue;
            }
            uint32_t k = 0;
            while (k < label_count && labels[k].label != facet.label) k++;
            if (k == label_count && k < 16) labels[label_count++].label = facet.label, labels[k].area = 0;
            if (k < 16) labels[k].area += area;
        }
        for (uint32_t k = 0; k < label_count; k++)
            if (labels[k].area > best || (labels[k].area == best && labels[k].label < label)) best = labels[k].area, label = labels[k].label;
        for (uint32_t c = 0; c < m->info->channel_count; c++)
            m->errors[v][c] = m->info->channels[c].constant || !(r.area > 0) ? -1 : compare(m, &m->info->channels[c], s->values[c], &r, label);
    }
    return SVO_OK;
}

svo_result svoi_reference_measure(const svo_placement *p, const svo_grid *g, const svo_tree_info *info, const svoi_sample *samples, uint64_t count,
                                  const uint32_t *triangles, uint32_t threads, const svo_allocator *a, svo_channel_error *out, uint64_t *measured,
                                  svo_error *err)
{
    const svo_mesh *mesh = p->mesh;
    measure m = {.placement = p, .grid = g, .info = info, .samples = samples, .triangles = triangles};
    memset(out, 0, info->channel_count * sizeof *out);
    for (uint32_t c = 0; c < info->channel_count; c++) {
        const char *name = info->channels[c].name;
        if (info->channels[c].constant) continue;
        m.color |= strcmp(name, "color") == 0 || strcmp(name, "coverage") == 0;
        m.emissive |= strcmp(name, "emissive") == 0;
        m.surface |= strcmp(name, "metallic") == 0 || strcmp(name, "roughness") == 0;
    }
    *measured = 0;
    if (count == 0) return SVO_OK;
    uint64_t pyramids = 3 * (uint64_t)mesh->image_count;
    m.pyramids = svo_calloc(a, pyramids + 1, sizeof *m.pyramids);
    m.errors = svo_calloc(a, count, sizeof *m.errors);
    svo_result r = SVO_OK;
    if (m.pyramids == NULL || m.errors == NULL) r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the reference of attributes");
    if (r == SVO_OK) {
        for (uint64_t i = 0; i < pyramids; i++) svo_pyramid_finest(&mesh->images[i / 3], (svo_texel)(i % 3), &m.pyramids[i]);
        r = svo_parallel_for(threads, count, 8, measure_voxels, &m, err);
    }
    for (uint64_t v = 0; r == SVO_OK && v < count; v++) {
        bool any = false;
        for (uint32_t c = 0; c < info->channel_count; c++) {
            double e = m.errors[v][c];
            if (!(e >= 0)) continue;
            any = true;
            out[c].voxels++;
            out[c].mean += e;
            if (e > out[c].max) out[c].max = e;
        }
        *measured += any;
    }
    for (uint32_t c = 0; c < info->channel_count; c++)
        if (out[c].voxels != 0) out[c].mean /= (double)out[c].voxels;
    svo_free(a, m.pyramids, pyramids + 1, sizeof *m.pyramids);
    svo_free(a, m.errors, count, sizeof *m.errors);
    return r;
}
