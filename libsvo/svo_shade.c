#include "svoi_shade.h"

#include <math.h>
#include <string.h>

#include "svo_raster.h"
#include "svo_task.h"

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
                          .roughness = find_channel(info, "roughness"), .material = find_channel(info, "material"),
                          .coverage = find_channel(info, "coverage")};
    l.sum_weight = l.fields++;
    if (l.color < SVO_MAX_CHANNELS) l.sum_color = l.fields, l.fields += 4;   /* weight, r, g, b */
    if (l.normal < SVO_MAX_CHANNELS) l.sum_normal = l.fields, l.fields += 4; /* x, y, z, largest contribution */
    if (l.emissive < SVO_MAX_CHANNELS) l.sum_emissive = l.fields, l.fields += 3;
    if (l.metallic < SVO_MAX_CHANNELS) l.sum_metallic = l.fields++;
    if (l.roughness < SVO_MAX_CHANNELS) l.sum_roughness = l.fields++;
    if (l.coverage < SVO_MAX_CHANNELS) l.sum_coverage = l.fields++;
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
    s->image_count = mesh->image_count;
    s->material_count = mesh->material_count;
    s->instance_count = mesh->instance_count;
    svo_result r = SVO_OK;
    if (s->materials == NULL || (pyramids != 0 && (s->pyramids == NULL || wanted == NULL)) || (mesh->instance_count != 0 && s->mirrored == NULL))
        r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %u materials", mesh->material_count);
    if (r == SVO_OK) {
        const svo_shade_layout *l = &s->layout;
        bool color = l->color < SVO_MAX_CHANNELS, coverage = l->coverage < SVO_MAX_CHANNELS;
        for (uint32_t i = 0; i <= mesh->material_count; i++) {
            shade_material *m = &s->materials[i];
            m->m = i < mesh->material_count ? mesh->materials[i] : svo_material_default();
            m->alpha_matters = m->m.alpha_mode != SVO_ALPHA_OPAQUE;
            bool alpha = m->m.alpha_mode == SVO_ALPHA_MASK || ((color || coverage) && m->alpha_matters);
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

typedef struct expand_job { svo_shader *s; const uint8_t *wanted; } expand_job;
static svo_result expand_pyramids(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    expand_job *job = user;
    for (uint64_t i = begin; i < end; i++)
        if (job->wanted[i]) svo_pyramid_expand(&job->s->pyramids[i]);
    return SVO_OK;
}

/* About how many readings of the image itself a triangle takes, as if its voxels looked like squares in the texture: none where a coarser level will do. */
static double readings_of(const svo_shader *s, const svo_group *g, uint64_t local, const svo_texture *how, const svo_pyramid *p)
{
    const float *set = g->part->uvs[how->uv_set];
    const uint32_t *index = g->part->indices + 3 * local;
    svo_vec3 v[3];
    double t[3][2];
    if (set == NULL) return 0;
    svo_placement_world(s->placement, g, local, v);
    for (int k = 0; k < 3; k++) {
        const double x = (double)set[2 * (uint64_t)index[k]], y = (double)set[2 * (uint64_t)index[k] + 1];
        t[k][0] = (how->transform[0] * x + how->transform[1] * y) * p->width[0];
        t[k][1] = (how->transform[3] * x + how->transform[4] * y) * p->height[0];
    }
    const svo_vec3 normal = svo_cross(svo_sub(v[1], v[0]), svo_sub(v[2], v[0]));
    const double faces = 0.5 * svo_length(normal) / (s->grid.size * s->grid.size);
    const double texels = 0.5 * fabs((t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[1][1] - t[0][1]) * (t[2][0] - t[0][0]));
    const double breadth = sqrt(texels / faces), across = floor(0.8 * breadth) + 1;
    return breadth < 2 / 0.58 ? 1.5 * faces * across * across : 0; /* 1.5 voxels a face (not a number: 0) */
}

/* Readings of each image without alpha, from up to 1024 triangles a group. False where triangles are not in memory. */
static bool estimate_readings(const svo_shader *s, double *readings)
{
    for (uint64_t i = 0; i < s->placement->group_count; i++) {
        const svo_group *g = &s->placement->groups[i];
        if (g->part->soup != NULL) return false;
        const shade_material *m = svoi_material_of(s, g->part->material);
        const struct { const svo_pyramid *p; const svo_texture *how; } uses[4] = {{m->base, &m->m.base_color_texture}, {m->opacity, &m->m.opacity_texture},
            {m->emissive, &m->m.emissive_texture}, {m->metallic_roughness, &m->m.metallic_roughness_texture}};
        const uint64_t stride = g->part->triangle_count / 1024 + 1;
        for (int k = 0; k < 4; k++) {
            if (uses[k].p == NULL || uses[k].p->kind == SVO_TEXEL_COLOR_ALPHA) continue;
            double sum = 0;
            for (uint64_t local = 0; local < g->part->triangle_count; local += stride) sum += readings_of(s, g, local, uses[k].how, uses[k].p);
            readings[uses[k].p - s->pyramids] += sum * (double)stride;
        }
    }
    return true;
}

void svo_shader_expand(svo_shader *s, uint64_t bytes, uint32_t threads)
{
    const uint64_t pyramids = (uint64_t)s->image_count * 3;
    uint8_t *wanted = svo_calloc(s->allocator, pyramids, 1);
    double *readings = svo_calloc(s->allocator, pyramids, sizeof *readings);
    const bool known = readings != NULL && estimate_readings(s, readings);
    for (uint64_t i = 0; wanted != NULL && i < pyramids; i++) {
        const svo_pyramid *p = &s->pyramids[i];
        if (p->levels == 0 || p->kind == SVO_TEXEL_COLOR_ALPHA) continue;
        const uint64_t texels = (uint64_t)p->width[0] * p->height[0];
        if (known && readings[i] < 0.5 * (double)texels) continue; /* it would cost more than it saves */
        if (8 * texels > bytes) continue;
        bytes -= 8 * texels;
        wanted[i] = 1;
    }
    expand_job job = {s, wanted};
    if (wanted != NULL) svo_parallel_for(threads, pyramids, 1, expand_pyramids, &job, NULL);
    svo_free(s->allocator, wanted, pyramids, 1);
    svo_free(s->allocator, readings, pyramids, sizeof *readings);
}

svo_result svo_shader_rebind(svo_shader *s, const svo_placement *p, svo_error *err)
{
    const svo_mesh *mesh = p->mesh;
    bool *mirrored = svo_calloc(s->allocator, mesh->instance_count, sizeof *mirrored);
    if (mirrored == NULL && mesh->instance_count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %u instances", mesh->instance_count);
    for (uint32_t i = 0; i < mesh->instance_count; i++) mirrored[i] = svo_mat4_det3(&mesh->instances[i].transform) < 0;
    svo_free(s->allocator, s->mirrored, s->instance_count, sizeof *s->mirrored);
    s->mirrored = mirrored;
    s->instance_count = mesh->instance_count;
    s->placement = p;
    return SVO_OK;
}

void svo_shader_free(svo_shader *s)
{
    if (s == NULL) return;
    uint64_t pyramids = (uint64_t)s->image_count * 3;
    for (uint64_t i = 0; s->pyramids != NULL && i < pyramids; i++)
        if (s->pyramids[i].levels != 0) svo_pyramid_free(&s->pyramids[i]);
    svo_free(s->allocator, s->pyramids, pyramids, sizeof *s->pyramids);
    svo_free(s->allocator, s->materials, (uint64_t)s->material_count + 1, sizeof *s->materials);
    svo_free(s->allocator, s->mirrored, s->instance_count, sizeof *s->mirrored);
    svo_free(s->allocator, s, 1, sizeof *s);
}

/* --- triangles ------------------------------------------------------------------------------------------------ */

bool svo_facet_is_masked(const svo_shader *s, uint32_t group)
{
    const svo_part *part = s->placement->groups[group].part;
    const shade_material *m = svoi_material_of(s, part->material);
    return m->m.alpha_mode == SVO_ALPHA_MASK && (m->base != NULL || m->opacity != NULL || part->colors != NULL || m->m.base_color[3] < m->m.alpha_cutoff);
}

/* Is it the same everywhere? */
static bool is_flat(const svo_shader *s, const svo_part *part, uint64_t local, bool masks)
{
    const shade_material *m = svoi_material_of(s, part->material);
    const svo_shade_layout *l = &s->layout;
    if (m->base != NULL || m->opacity != NULL || m->emissive != NULL || m->metallic_roughness != NULL) return false;
    if (part->colors != NULL && (l->color < SVO_MAX_CHANNELS || l->coverage < SVO_MAX_CHANNELS || masks)) return false;
    if (part->normals != NULL && l->normal < SVO_MAX_CHANNELS) {
        const uint32_t *index = part->indices + 3 * local;
        const float *a = part->normals + 3 * (uint64_t)index[0], *b = part->normals + 3 * (uint64_t)index[1], *c = part->normals + 3 * (uint64_t)index[2];
        for (int i = 0; i < 3; i++)
            if (!(a[i] == b[i] && a[i] == c[i])) return false;
    }
    return true;
}

/* Normals of the corners. They are mapped before they are interpolated: the map is linear, so that is the same. */
static void corner_normals(const svo_shader *s, svo_facet *t)
{
    svo_vec3 face = svo_v3(t->face[0], t->face[1], t->face[2]);
    /* A mirroring transform turns the corners' order round; the front stays the front. */
    t->mirrored = s->mirrored[t->instance];
    if (t->mirrored) face = svo_scale(face, -1);
    svo_vec3 n[3] = {face, face, face};
    t->smooth = false;
    if (t->part->normals != NULL) {
        const svo_mat4 *m = &s->placement->mesh->instances[t->instance].transform;
        double longest = 0;
        for (int k = 0; k < 3; k++) {
            const float *v = t->part->normals + 3 * (uint64_t)t->vertex[k];
            const double x = (double)v[0], y = (double)v[1], z = (double)v[2], length = sqrt(x * x + y * y + z * z); /* squares of floats fit doubles */
            n[k] = svo_mat4_normal(m, length > 0 ? svo_v3(x / length, y / length, z / length) : svo_v3(0, 0, 0));
            longest = fmax(longest, fmax(fabs(n[k].x), fmax(fabs(n[k].y), fabs(n[k].z))));
        }
        bool usable = longest > 0 && isfinite(longest);
        for (int k = 0; k < 3; k++) n[k] = usable ? svo_scale(n[k], 1 / longest) : face;
        for (int k = 1; k < 3; k++) t->smooth |= usable && (n[k].x != n[0].x || n[k].y != n[0].y || n[k].z != n[0].z);
    }
    for (int k = 0; k < 3; k++) t->corner_normal[k][0] = n[k].x, t->corner_normal[k][1] = n[k].y, t->corner_normal[k][2] = n[k].z;
}

static void normal_of(double (*c)[3], double n[3])
{
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        n[k] = (c[1][i] - c[0][i]) * (c[2][j] - c[0][j]) - (c[1][j] - c[0][j]) * (c[2][i] - c[0][i]);
    }
}

void svo_facet_make(const svo_shader *s, uint32_t group, uint64_t local, const double block[3], const int32_t q[3][3], svo_facet *out)
{
    const svo_group *g = &s->placement->groups[group];
    out->part = g->part;
    out->instance = g->instance;
    out->material = g->part->material;
    out->masks = svo_facet_is_masked(s, group);
    out->flat = is_flat(s, g->part, local, out->masks);
    memcpy(out->vertex, g->part->indices + 3 * local, sizeof out->vertex);
    svo_vec3 v[3];
    svo_placement_world(s->placement, g, local, v);
    double (*c)[3] = out->corner;
    for (int k = 0; k < 3; k++) {
        c[k][0] = (v[k].x - s->grid.origin[0]) / s->grid.size - block[0];
        c[k][1] = (v[k].y - s->grid.origin[1]) / s->grid.size - block[1];
        c[k][2] = (v[k].z - s->grid.origin[2]) / s->grid.size - block[2];
    }
    normal_of(c, out->normal);
    svo_vec3 face = svo_normalize(svo_v3(out->normal[0], out->normal[1], out->normal[2]));
    out->face[0] = face.x, out->face[1] = face.y, out->face[2] = face.z;
    out->inside = true;
    for (int k = 0; k < 3; k++) out->inside &= q[0][k] >> 8 == q[1][k] >> 8 && q[0][k] >> 8 == q[2][k] >> 8;
    out->clips = false;
    if (!out->inside) {
        /* A little beside the planes of the grid, to the side that the snap prefers, and unequally, so that neither edges nor the
         * lines where the plane passes a layer coincide with sides of voxels, not even in models built of integers. */
        const double nudge[3] = {1e-4, 1.37e-4, 0.73e-4}, top = (double)(((uint64_t)1 << s->grid.depth) - 1);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) c[i][k] += c[i][k] + block[k] > top ? -nudge[k] : nudge[k];
        out->clips = svoi_clipper_make(&out->clipper, (const double(*)[3])c);
    }
    out->axis = fabs(out->normal[1]) > fabs(out->normal[0]) ? 1 : 0;
    if (fabs(out->normal[2]) > fabs(out->normal[out->axis])) out->axis = 2;
    out->length = sqrt(out->normal[0] * out->normal[0] + out->normal[1] * out->normal[1] + out->normal[2] * out->normal[2]);
    double n = out->normal[out->axis];
    if (n != 0) {
        uint32_t i = (out->axis + 1) % 3, j = (out->axis + 2) % 3;
        out->per_x[0] = (c[2][j] - c[0][j]) / n, out->per_y[0] = -(c[2][i] - c[0][i]) / n;
        out->per_x[1] = -(c[1][j] - c[0][j]) / n, out->per_y[1] = (c[1][i] - c[0][i]) / n;
    } else {
        out->per_x[0] = out->per_x[1] = out->per_y[0] = out->per_y[1] = 0;
    }
    for (int k = 0; k < 4; k++) out->texture[k].ready = false;
    if (s->layout.normal < SVO_MAX_CHANNELS) corner_normals(s, out);
}

bool svo_facet_reads_textures(const svo_shader *s, const svo_facet *t)
{
    const shade_material *m = svoi_material_of(s, t->material);
    return m->base != NULL || m->opacity != NULL || m->emissive != NULL || m->metallic_roughness != NULL;
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
void svoi_barycentric(const svo_facet *t, const double p[3], double b[3])
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
    double x = p[(t->axis + 1) % 3] - t->corner[0][(t->axis + 1) % 3], y = p[(t->axis + 2) % 3] - t->corner[0][(t->axis + 2) % 3];
    b[1] = x * t->per_x[0] + y * t->per_y[0];
    b[2] = x * t->per_x[1] + y * t->per_y[1];
    b[0] = 1 - b[1] - b[2];
    if (b[0] >= 0 && b[1] >= 0 && b[2] >= 0) return;
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        if (!(b[k] > 0)) b[k] = 0;
        sum += b[k];
    }
    for (int k = 0; k < 3; k++) b[k] = sum > 0 ? b[k] / sum : 1.0 / 3;
}

/* Centroid; the middle of its corners when it has no area, the voxel's middle when it is empty. */
static void centre_of(const svo_facet *t, const svo_polygon *polygon, const int32_t cell[3], double centre[3])
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
    for (int c = 0; c < 3; c++) {
        centre[c] = 0;
        if (polygon->count == 0) centre[c] = cell[c] + 0.5;
        else if (fabs(twice) > 1e-12) centre[c] = o[c] + sum[c] / (3 * twice);
        else
            for (uint32_t k = 0; k < polygon->count; k++) centre[c] += polygon->at[k][c] / polygon->count;
    }
}

void svo_facet_piece(const svo_facet *t, svo_piece *out)
{
    const uint32_t i = (t->axis + 1) % 3, j = (t->axis + 2) % 3;
    *out = (svo_piece){.area = 0.5 * t->length};
    for (int k = 0; k < 3; k++) out->centre[k] = (t->corner[0][k] + t->corner[1][k] + t->corner[2][k]) * (1.0 / 3);
    for (int k = 0; k < 3; k++) {
        double x = t->corner[k][i] - out->centre[i], y = t->corner[k][j] - out->centre[j];
        out->xx += x * x * (1.0 / 12);
        out->xy += x * y * (1.0 / 12);
        out->yy += y * y * (1.0 / 12);
    }
}

uint64_t svo_piece_weight(const svo_piece *piece, uint32_t shift)
{
    double weight = piece->area * (double)((uint64_t)1 << shift) + 0.5;
    return weight >= 1 ? (uint64_t)weight : 1;
}

/* --- contributions -------------------------------------------------------------------------------------------- */

bool svo_facet_visible(const svo_shader *s, svo_facet *t, const svo_polygon *polygon, const int32_t cell[3])
{
    if (!t->masks) return true;
    const shade_material *m = svoi_material_of(s, t->material);
    double centre[3], b[3];
    centre_of(t, polygon, cell, centre);
    double alpha = m->m.base_color[3];
    if (t->part->colors != NULL) {
        svoi_barycentric(t, centre, b);
        double vertex = 0;
        for (int k = 0; k < 3; k++) vertex += b[k] * t->part->colors[4 * (uint64_t)t->vertex[k] + 3];
        alpha *= vertex;
    }
    if (m->base != NULL) alpha *= svoi_most_alpha(t, BASE, &m->m.base_color_texture, m->base, polygon, centre);
    if (m->opacity != NULL) alpha *= svoi_most_alpha(t, OPACITY, &m->m.opacity_texture, m->opacity, polygon, centre);
    return alpha >= m->m.alpha_cutoff;
}

static uint16_t to16(double v) { return v > 0 ? v < 1 ? (uint16_t)(v * 65535 + 0.5) : 65535 : 0; }

static void normal_at(const svo_facet *t, const double b[3], int32_t out[3])
{
    double n[3];
    for (int i = 0; i < 3; i++)
        n[i] = t->smooth ? b[0] * t->corner_normal[0][i] + b[1] * t->corner_normal[1][i] + b[2] * t->corner_normal[2][i] : t->corner_normal[0][i];
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    if (!(length > 1e-9)) { /* they cancel: the face */
        double sign = t->mirrored ? -1 : 1;
        for (int i = 0; i < 3; i++) n[i] = sign * t->face[i];
        length = 1;
    }
    double k = length > 0 ? 32767 / length : 0;
    for (int i = 0; i < 3; i++) out[i] = (int32_t)floor(n[i] * k + 0.5);
}

void svo_contribution_weigh(svo_contribution *c, uint64_t weight)
{
    c->weight = c->color_weight = weight;
    if (c->alpha == 1) return;
    double w = (double)weight * c->alpha + 0.5;
    c->color_weight = w >= 1 ? (uint64_t)w : 1;
}

void svo_facet_contribution(const svo_shader *s, svo_facet *t, const svo_piece *piece, uint32_t shift, svo_contribution *out)
{
    const shade_material *m = svoi_material_of(s, t->material);
    const svo_shade_layout *l = &s->layout;
    double b[3];
    svoi_barycentric(t, piece->centre, b);
    memset(out, 0, sizeof *out);
    out->alpha = 1;
    if (l->color < SVO_MAX_CHANNELS || l->coverage < SVO_MAX_CHANNELS) {
        double c[4] = {m->m.base_color[0], m->m.base_color[1], m->m.base_color[2], m->m.base_color[3]};
        if (t->part->colors != NULL) {
            double v[4] = {0, 0, 0, 0};
            for (int k = 0; k < 3; k++)
                for (int i = 0; i < 4; i++) v[i] += b[k] * t->part->colors[4 * (uint64_t)t->vertex[k] + (uint64_t)i];
            for (int i = 0; i < 4; i++) c[i] *= v[i];
        }
        if (m->base != NULL) {
            float texel[4];
            svoi_read_texture(t, BASE, &m->m.base_color_texture, m->base, piece, texel);
            if (m->alpha_matters) svoi_unmultiply(t, &m->m.base_color_texture, m->base, piece, texel);
            for (int i = 0; i < 4; i++) c[i] *= texel[i];
        }
        if (m->opacity != NULL) {
            float texel[4];
            svoi_read_texture(t, OPACITY, &m->m.opacity_texture, m->opacity, piece, texel);
            c[3] *= texel[0];
        }
        for (int i = 0; i < 3; i++) out->color[i] = to16(c[i]);
        if (m->alpha_matters) out->alpha = c[3] > 0 ? c[3] < 1 ? c[3] : 1 : 0;
    }
    if (l->normal < SVO_MAX_CHANNELS) normal_at(t, b, out->normal);
    if (l->emissive < SVO_MAX_CHANNELS) {
        float texel[4] = {1, 1, 1, 1};
        if (m->emissive != NULL) svoi_read_texture(t, EMISSIVE, &m->m.emissive_texture, m->emissive, piece, texel);
        for (int i = 0; i < 3; i++) out->emissive[i] = to16((double)m->m.emissive[i] * (double)texel[i]);
    }
    if (l->metallic < SVO_MAX_CHANNELS || l->roughness < SVO_MAX_CHANNELS) {
        float texel[4] = {1, 1, 1, 1};
        if (m->metallic_roughness != NULL) svoi_read_texture(t, METALLIC_ROUGHNESS, &m->m.metallic_roughness_texture, m->metallic_roughness, piece, texel);
        out->roughness = to16((double)m->m.roughness * (double)texel[1]);
        out->metallic = to16((double)m->m.metallic * (double)texel[2]);
    }
    svo_contribution_weigh(out, svo_piece_weight(piece, shift));
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
    if (l->coverage < SVO_MAX_CHANNELS) sums[l->sum_coverage] += c->weight * to16(c->alpha);
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
    if (l->coverage < SVO_MAX_CHANNELS) values[l->coverage][0] = (uint8_t)((double)sums[l->sum_coverage] / weight * 255 + 0.5);
    if (l->roughness < SVO_MAX_CHANNELS) values[l->roughness][0] = (uint8_t)((double)sums[l->sum_roughness] / weight * 255 + 0.5);
}

void svo_facet_make_points(const svo_shader *s, uint64_t triangle, svo_facet *out)
{
    static const int32_t one_voxel[3][3] = {{0}}; /* nothing will be clipped */
    const double origin[3] = {0, 0, 0};
    uint32_t group = svo_placement_group(s->placement, triangle);
    svo_facet_make(s, group, triangle - s->placement->groups[group].first, origin, one_voxel, out);
}

void svo_facet_point(const svo_shader *s, svo_facet *t, const double barycentric_at[3], uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE])
{
    const double wide = 1.0 / 12; /* the variance of a voxel face */
    svo_piece piece = {.area = 1, .xx = wide, .yy = wide};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) piece.centre[i] += barycentric_at[k] * t->corner[k][i];
    svo_contribution c;
    uint64_t sums[32] = {0};
    svo_facet_contribution(s, t, &piece, 24, &c);
    svo_shade_add(&s->layout, &c, sums);
    svo_shade_value(&s->layout, sums, values);
    if (s->layout.material < SVO_MAX_CHANNELS) {
        uint32_t label = t->material < s->placement->mesh->material_count ? t->material : UINT16_MAX;
        values[s->layout.material][0] = (uint8_t)label;
        values[s->layout.material][1] = (uint8_t)(label >> 8);
    }
}
