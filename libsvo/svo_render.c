#define _POSIX_C_SOURCE 200809L
#include "svoi_render.h"

#include <math.h>
#include <stddef.h>
#include <string.h>
#include <time.h>

#include "svo_task.h"

/* ---- cameras ------------------------------------------------------------------------------------------------------ */

static bool finite3(svo_vec3 v) { return isfinite(v.x) && isfinite(v.y) && isfinite(v.z); }

/* Right-handed axes from forward and a hint for up. */
static bool make_axes(svo_vec3 forward, svo_vec3 up, svo_eye *e)
{
    e->forward = svo_normalize(forward);
    if (svo_length(e->forward) == 0) return false;
    svo_vec3 hints[4] = {svo_normalize(up), {0, 1, 0}, {0, 0, 1}, {1, 0, 0}};
    for (int i = 0; i < 4; i++) {
        svo_vec3 right = svo_cross(e->forward, hints[i]);
        if (svo_length(right) < 1e-6) continue; /* (nearly) parallel: the next one is not */
        e->right = svo_normalize(right);
        e->up = svo_cross(e->right, e->forward);
        return true;
    }
    return false;
}

svo_result svo_eye_look(svo_vec3 position, svo_vec3 target, svo_vec3 up, double yfov, svo_eye *out, svo_error *err)
{
    svo_eye e = {.position = position, .yfov = yfov};
    if (!finite3(position) || !finite3(target) || !finite3(up) || !(yfov > 0 && yfov < 3.14159265))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "camera is not finite, or its field of view is not between 0 and 180 degrees");
    if (!make_axes(svo_sub(target, position), up, &e))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "camera and target are the same point: there is no direction to look in");
    *out = e;
    return SVO_OK;
}

svo_result svo_eye_from_transform(const svo_mat4 *m, double yfov, svo_eye *out, svo_error *err)
{
    svo_vec3 zero = {0, 0, 0};
    svo_vec3 position = svo_mat4_point(m, zero), forward = svo_mat4_vector(m, svo_v3(0, 0, -1)), up = svo_mat4_vector(m, svo_v3(0, 1, 0));
    svo_eye e = {.position = position, .yfov = yfov};
    if (!finite3(position) || !(yfov > 0 && yfov < 3.14159265) || !make_axes(forward, up, &e))
        return svo_fail(err, SVO_INVALID_DATA, "the scene's camera is not usable: its transform is singular or not finite, or its "
                                               "field of view is not between 0 and 180 degrees");
    *out = e;
    return SVO_OK;
}

/* Shift of the camera, at distance d, with equal margins left and right of the corners x at depths z. */
static double centred(const double x[8], const double z[8], double d)
{
    double low = x[0], high = x[0];
    for (int i = 1; i < 8; i++) low = fmin(low, x[i]), high = fmax(high, x[i]);
    for (int step = 0; step < 60; step++) {
        double s = 0.5 * (low + high), most = -INFINITY, least = INFINITY;
        for (int i = 0; i < 8; i++) {
            double slope = (x[i] - s) / (d - z[i]);
            most = fmax(most, slope), least = fmin(least, slope);
        }
        if (most + least > 0) low = s; /* more on the right: move there */
        else high = s;
    }
    return 0.5 * (low + high);
}

svo_eye svo_eye_frame(const double low_in[3], const double high_in[3], double aspect, double yfov)
{
    static const double unit_low[3] = {0, 0, 0}, unit_high[3] = {1, 1, 1};
    const double *low = low_in, *high = high_in;
    for (int k = 0; k < 3; k++)
        if (!isfinite(low[k]) || !isfinite(high[k]) || !(low[k] <= high[k])) low = unit_low, high = unit_high;
    svo_eye e = {.yfov = yfov};
    svo_vec3 centre = {0.5 * low[0] + 0.5 * high[0], 0.5 * low[1] + 0.5 * high[1], 0.5 * low[2] + 0.5 * high[2]};
    make_axes(svo_v3(-0.62, -0.42, -1), svo_v3(0, 1, 0), &e);
    double ty = tan(0.5 * yfov) * 0.92, tx = ty * aspect, near = -INFINITY, x[8], y[8], z[8];
    /* A corner is in sight of a camera shifted by s in its plane and d before the centre when |x - s| <= (d - z) tan, which is two
     * half planes in (s, d) a corner: d >= (x / tan + z) - s / tan and d >= (-x / tan + z) + s / tan. The nearest d is where
     * the outermost of both kinds meet. */
    double bound[4] = {-INFINITY, -INFINITY, -INFINITY, -INFINITY};
    for (int i = 0; i < 8; i++) {
        svo_vec3 c = svo_sub(svo_v3(i & 1 ? high[0] : low[0], i & 2 ? high[1] : low[1], i & 4 ? high[2] : low[2]), centre);
        x[i] = svo_dot(c, e.right), y[i] = svo_dot(c, e.up), z[i] = -svo_dot(c, e.forward);
        bound[0] = fmax(bound[0], x[i] / tx + z[i]), bound[1] = fmax(bound[1], -x[i] / tx + z[i]);
        bound[2] = fmax(bound[2], y[i] / ty + z[i]), bound[3] = fmax(bound[3], -y[i] / ty + z[i]);
        near = fmax(near, z[i]);
    }
    double dx = 0.5 * (bound[0] + bound[1]), dy = 0.5 * (bound[2] + bound[3]), d = fmax(dx, dy);
    double size = fmax(high[0] - low[0], fmax(high[1] - low[1], high[2] - low[2]));
    if (!(size > 0)) size = fmax(1e-3, 1e-6 * svo_length(centre)); /* a point: stand somewhere */
    d = fmax(d, near + 1e-3 * size);
    double sx = centred(x, z, d), sy = centred(y, z, d);
    e.position = svo_add(centre, svo_add(svo_scale(e.forward, -d), svo_add(svo_scale(e.right, sx), svo_scale(e.up, sy))));
    return e;
}

/* ---- rays --------------------------------------------------------------------------------------------------------- */

svo_render_options svo_default_render_options(void)
{
    svo_render_options o = {
        .width = 1280, .height = 720, .samples = 1, .light = {-0.45, 0.85, 0.65}, .shadows = true, .ambient = 0.35, .footprint = 1,
        .background_top = {0.50, 0.58, 0.68}, .background_bottom = {0.86, 0.87, 0.88},
    };
    static const double low[3] = {0, 0, 0}, high[3] = {1, 1, 1};
    o.eye = svo_eye_frame(low, high, 1280.0 / 720, 0.7);
    return o;
}

/* Extent of a sample on the plane at depth 1. */
static double sample_spread(const svo_render_options *o) { return 2 * tan(0.5 * o->eye.yfov) / ((double)o->height * o->samples); }

svo_scene_ray svo_render_ray(const svo_render_options *o, double x, double y)
{
    double half = tan(0.5 * o->eye.yfov), scale = 2 * half / o->height;
    svo_scene_ray r = {.origin = o->eye.position, .t_min = 0, .t_max = INFINITY, .spread = o->footprint * sample_spread(o)};
    double sx = (x - 0.5 * o->width) * scale, sy = (0.5 * o->height - y) * scale;
    r.direction = svo_add(o->eye.forward, svo_add(svo_scale(o->eye.right, sx), svo_scale(o->eye.up, sy)));
    return r;
}

/* A plane through a cube with unit normal n (in grid units) lies within |n|_1 / 2 of the cube's centre, measured along n,
 * and every cube it meets ends at most |n|_1 above it, where |n|_1 = |nx| + |ny| + |nz|. So 1.5 |n|_1 above the centre of
 * the hit node no node of that size on the plane is in the way of light from above. */
svo_vec3 svo_render_shadow_origin(const svo_bvh *bvh, const svo_scene_hit *hit, svo_vec3 n)
{
    const svo_placed *p = svo_bvh_item(bvh, hit->item);
    const svo_view *v = svo_bvh_view(bvh, hit->item);
    double m[9], edge = ldexp(1, (int)(v->depth - hit->node.level)), at[3], grid[3];
    svo_bvh_from_grid(bvh, hit->item, m);
    for (int k = 0; k < 3; k++) grid[k] = m[k] * n.x + m[3 + k] * n.y + m[6 + k] * n.z; /* covectors: transpose */
    svo_vec3 g = svo_normalize(svo_v3(grid[0], grid[1], grid[2]));
    double rise = 1.5 * (fabs(g.x) + fabs(g.y) + fabs(g.z)) * edge;
    at[0] = (hit->node.cell[0] + 0.5) * edge + rise * g.x;
    at[1] = (hit->node.cell[1] + 0.5) * edge + rise * g.y;
    at[2] = (hit->node.cell[2] + 0.5) * edge + rise * g.z;
    return svo_v3(p->origin[0] + m[0] * at[0] + m[1] * at[1] + m[2] * at[2], p->origin[1] + m[3] * at[0] + m[4] * at[1] + m[5] * at[2],
                  p->origin[2] + m[6] * at[0] + m[7] * at[1] + m[8] * at[2]);
}

/* ---- shading ------------------------------------------------------------------------------------------------------ */

double svoi_thread_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static uint32_t find_channel(const svo_view *v, const char *name, svo_channel_kind kind)
{
    uint32_t c = svo_view_find_channel(v, name);
    return c < v->channel_count && v->channels[c].channel.kind == kind ? c : SVO_MAX_CHANNELS;
}

void svoi_render_colors(const renderer *r, size_t field, const svo_scene_hit *hits, uint32_t count, float (*rgb)[3])
{
    svo_hit nodes[TILE_PIXELS];
    uint8_t values[TILE_PIXELS * 3];
    for (uint32_t first = 0, end; first < count; first = end) {
        /* neighbours are mostly of one asset */
        end = first + 1;
        if (!hits[first].node.hit) continue;
        const svo_view *v = svo_bvh_view(r->bvh, hits[first].item);
        const asset_channels *channels = &r->channels[svo_bvh_item(r->bvh, hits[first].item)->asset];
        nodes[0] = hits[first].node;
        for (; end < count; end++) {
            if (hits[end].node.hit && svo_bvh_view(r->bvh, hits[end].item) != v) break;
            nodes[end - first] = hits[end].node;
        }
        const uint32_t channel = *(const uint32_t *)((const char *)channels + field);
        if (channel == SVO_MAX_CHANNELS) continue;
        svo_rays_values(v, channel, nodes, end - first, values);
        for (uint32_t i = first; i < end; i++)
            for (uint32_t k = 0; k < 3 && hits[i].node.hit; k++) rgb[i][k] = svo_srgb_to_linear(values[3 * (i - first) + k]);
    }
}

/* Unit normal of the surface at a hit, towards the viewer where that is in doubt. */
svo_vec3 svoi_render_normal(const renderer *r, const svo_scene_ray *ray, const svo_scene_hit *hit)
{
    const svo_placed *p = svo_bvh_item(r->bvh, hit->item);
    const svo_view *v = svo_bvh_view(r->bvh, hit->item);
    svo_vec3 view = svo_normalize(ray->direction), n = {0, 0, 0};
    uint32_t channel = r->channels[p->asset].normal;
    if (channel != SVO_MAX_CHANNELS) {
        uint8_t value[SVO_MAX_STRIDE];
        float f[3];
        svo_view_attribute(v, channel, hit->node.attribute, value);
        svo_oct32_decode(value, f);
        svo_mat4 m = svo_scene_instance_transform(r->scene, p->page, p->instance);
        n = svo_normalize(svo_mat4_normal(&m, svo_v3(f[0], f[1], f[2])));
        /* Seen from behind: surfaces have two sides. Near the silhouette a stored normal may well lean a little away from
         * the viewer; turning it there would make bright and dark rims. */
        if (svo_dot(n, view) > 0.25) n = svo_scale(n, -1);
    }
    if (svo_dot(n, n) == 0) n = svo_bvh_face_normal(r->bvh, hit);
    if (svo_dot(n, n) == 0) n = svo_scale(view, -1);
    return n;
}

static void measure_stop(const renderer *r, const svo_scene_ray *ray, const svo_scene_hit *hit, svo_render_stats *s)
{
    const svo_view *v = svo_bvh_view(r->bvh, hit->item);
    double voxel = svo_bvh_item(r->bvh, hit->item)->stretch / (ray->spread / r->o->footprint); /* in samples at depth 1 */
    double edge = ldexp(voxel, (int)(v->depth - hit->node.level));
    if (hit->node.level < v->depth) s->stop_max = fmax(s->stop_max, edge / hit->node.t);
    if (hit->node.level == 0) return;
    svo_ray grid = svo_bvh_grid_ray(r->bvh, hit->item, ray);
    uint32_t parent[3];
    for (int k = 0; k < 3; k++) parent[k] = hit->node.cell[k] / 2;
    double enter, leave;
    if (svo_ray_node(v, &grid, hit->node.level - 1u, parent, &enter, &leave)) s->parent_min = fmin(s->parent_min, 2 * edge / fmax(enter, 0));
}

/* Where the rays of a tile go on behind what they have met and not been stopped by; false when there are none. The others have no hit then. */
static bool trace_behind(const renderer *r, worker *w, uint32_t count)
{
    uint32_t live = 0;
    for (uint32_t i = 0; i < count; i++) {
        bool more = w->hits[i].node.hit && w->cover[i] < 1;
        w->seen[i] *= 1 - w->cover[i];
        w->hits[i].node.hit = false;
        if (!more || w->seen[i] < SVOI_DARK) continue;
        w->more[live] = w->rays[i];
        w->more_pixel[live++] = i;
    }
    svo_scene_trace(r->bvh, w->more, live, w->more_hits);
    for (uint32_t k = 0; k < live; k++) w->hits[w->more_pixel[k]] = w->more_hits[k];
    w->stats.primary += live;
    return live != 0;
}

/* Light from the hits of a tile, added to the sums. */
static void shade_hits(const renderer *r, worker *w, uint32_t x0, uint32_t y0, uint32_t nx, uint32_t count, uint32_t sample)
{
    const svo_render_options *o = r->o;
    double t1 = svoi_thread_seconds();
    /* the cosine with the light, times the share of it that arrives */
    float direct[TILE_PIXELS];
    for (uint32_t i = 0; i < count; i++) {
        const svo_scene_hit *hit = &w->hits[i];
        direct[i] = 0;
        if (!hit->node.hit) continue;
        w->stats.hits++;
        w->stats.levels[hit->node.level]++;
        w->stats.inside += hit->node.face == SVO_FACE_INSIDE;
        const svo_view *v = svo_bvh_view(r->bvh, hit->item);
        w->stats.lod_stops += hit->node.level < v->depth;
        if (o->measure && o->footprint > 0 && v->lod) measure_stop(r, &w->rays[i], hit, &w->stats);
        w->normals[i] = svoi_render_normal(r, &w->rays[i], hit);
        direct[i] = (float)fmax(0, svo_dot(w->normals[i], r->light));
        w->cover[i] = 1;
    }
    double t2 = svoi_thread_seconds();
    if (o->shadows) svoi_render_shadows(r, w, w->rays, w->hits, w->normals, count, direct);
    double t3 = svoi_thread_seconds();
    w->stats.shadow_seconds += t3 - t2;
    if (o->bounce != 0 || o->reflections) svoi_render_secondary(r, w, x0, y0, nx, count, sample);
    double t4 = svoi_thread_seconds();
    w->stats.secondary_seconds += t4 - t3;
    float albedo[TILE_PIXELS][3], emissive[TILE_PIXELS][3];
    for (uint32_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) albedo[i][k] = 0.6f, emissive[i][k] = 0;
    svoi_render_colors(r, offsetof(asset_channels, color), w->hits, count, albedo);
    svoi_render_colors(r, offsetof(asset_channels, emissive), w->hits, count, emissive);
    for (uint32_t i = 0; i < count; i++) {
        const svo_scene_hit *hit = &w->hits[i];
        if (!hit->node.hit) continue;
        if (r->see_through) w->cover[i] = svoi_render_pass(r, &w->rays[i], hit, w->normals[i]);
        const float share = w->seen[i] * w->cover[i];
        /* the sky is brighter than the ground */
        float plain = (float)(0.75 + 0.25 * w->normals[i].y), ambient = (float)o->ambient;
        for (int k = 0; k < 3; k++) {
            float light = ambient * (o->bounce != 0 ? w->around[i][k] : plain) + (1 - ambient) * direct[i], out = albedo[i][k] * light;
            if (o->reflections) out += w->mirrored[i][3] * (w->mirrored[i][k] - out);
            w->sum[i][k] += share * (out + emissive[i][k]);
        }
        w->sum[i][3] += share;
    }
    w->stats.shade_seconds += t2 - t1 + svoi_thread_seconds() - t4;
}

/* One sample of every pixel of a tile: trace all, then all shadow rays, then add up; and again for what is seen through what they have met. */
static void sample_tile(const renderer *r, worker *w, uint32_t x0, uint32_t y0, uint32_t nx, uint32_t ny, uint32_t sample)
{
    const double sx = (sample % r->o->samples + 0.5) / r->o->samples, sy = (sample / r->o->samples + 0.5) / r->o->samples;
    const svo_render_options *o = r->o;
    uint32_t count = nx * ny;
    for (uint32_t i = 0; i < count; i++) w->rays[i] = svo_render_ray(o, x0 + i % nx + sx, y0 + i / nx + sy), w->seen[i] = 1;
    double t0 = svoi_thread_seconds();
    svo_scene_trace(r->bvh, w->rays, count, w->hits);
    w->stats.primary_seconds += svoi_thread_seconds() - t0;
    w->stats.primary += count;
    shade_hits(r, w, x0, y0, nx, count, sample);
    if (r->planes != NULL) memcpy(w->first_hits, w->hits, sizeof w->hits), memcpy(w->first_normals, w->normals, sizeof w->normals);
    while (r->see_through) {
        t0 = svoi_thread_seconds();
        bool more = trace_behind(r, w, count);
        w->stats.primary_seconds += svoi_thread_seconds() - t0;
        if (!more) break;
        shade_hits(r, w, x0, y0, nx, count, sample);
    }
}

static void store_planes(const renderer *r, const worker *w, uint32_t x0, uint32_t y0, uint32_t nx, uint32_t ny)
{
    const svo_render_planes *p = r->planes;
    for (uint32_t i = 0; i < nx * ny; i++) {
        const svo_scene_hit *hit = &w->first_hits[i];
        uint64_t at = (uint64_t)(y0 + i / nx) * r->o->width + x0 + i % nx;
        bool is = hit->node.hit;
        if (p->depth != NULL) p->depth[at] = is ? (float)hit->node.t : INFINITY;
        if (p->normal != NULL) {
            p->normal[3 * at] = is ? (float)w->first_normals[i].x : 0;
            p->normal[3 * at + 1] = is ? (float)w->first_normals[i].y : 0;
            p->normal[3 * at + 2] = is ? (float)w->first_normals[i].z : 0;
        }
        if (p->level != NULL) p->level[at] = is ? hit->node.level : UINT32_MAX;
        if (p->instance != NULL) p->instance[at] = is ? (uint32_t)r->scene->instance_id[svo_bvh_item(r->bvh, hit->item)->instance] : UINT32_MAX;
        if (p->bone == NULL) continue;
        uint32_t channel = is ? r->channels[svo_bvh_item(r->bvh, hit->item)->asset].bone : SVO_MAX_CHANNELS;
        p->bone[at] = UINT32_MAX;
        if (channel == SVO_MAX_CHANNELS) continue;
        uint8_t value[SVO_MAX_STRIDE];
        const svo_view *v = svo_bvh_view(r->bvh, hit->item);
        svo_view_attribute(v, channel, hit->node.attribute, value);
        p->bone[at] = (uint32_t)value[0] | (uint32_t)value[1] << 8;
        if (v->channels[channel].channel.kind == SVO_KIND_ID32) p->bone[at] |= (uint32_t)value[2] << 16 | (uint32_t)value[3] << 24;
    }
}

static void store_tile(const renderer *r, const worker *w, uint32_t x0, uint32_t y0, uint32_t nx, uint32_t ny)
{
    const svo_render_options *o = r->o;
    float total = (float)(o->samples * o->samples);
    for (uint32_t i = 0; i < nx * ny; i++) {
        uint32_t x = x0 + i % nx, y = y0 + i / nx;
        uint8_t *out = r->pixels + 4 * ((uint64_t)y * o->width + x);
        const float *s = w->sum[i];
        if (r->planes != NULL && r->planes->light != NULL)
            for (int k = 0; k < 4; k++) r->planes->light[4 * ((uint64_t)y * o->width + x) + (uint32_t)k] = s[k] / total;
        double height = (y + 0.5) / o->height;
        for (int k = 0; k < 3; k++) {
            float back = (float)(o->background_top[k] * (1 - height) + o->background_bottom[k] * height), c;
            if (o->transparent) c = s[3] > 0 ? s[k] / s[3] : 0;
            else c = (s[k] + (total - s[3]) * back) / total;
            out[k] = svo_linear_to_srgb(c);
        }
        out[3] = o->transparent ? (uint8_t)(255 * s[3] / total + 0.5f) : 255;
    }
}

static svo_result render_tiles(void *user, uint64_t begin, uint64_t end, uint32_t index, svo_error *err)
{
    (void)err;
    renderer *r = user;
    const svo_render_options *o = r->o;
    worker *w = &r->workers[index];
    for (uint64_t tile = begin; tile < end; tile++) {
        uint32_t x0 = (uint32_t)(tile % r->tiles_x) * TILE, y0 = (uint32_t)(tile / r->tiles_x) * TILE;
        uint32_t nx = o->width - x0 < TILE ? o->width - x0 : TILE, ny = o->height - y0 < TILE ? o->height - y0 : TILE;
        memset(w->sum, 0, sizeof w->sum);
        for (uint32_t i = 0; i < o->samples * o->samples; i++) {
            sample_tile(r, w, x0, y0, nx, ny, i);
            if (r->planes != NULL && i == o->samples * o->samples / 2) store_planes(r, w, x0, y0, nx, ny);
        }
        store_tile(r, w, x0, y0, nx, ny);
    }
    if (index == 0 && o->progress != NULL) o->progress(o->user, (double)end / (double)r->tiles);
    return SVO_OK;
}

void svo_render_add_stats(svo_render_stats *to, const svo_render_stats *s)
{
    to->primary += s->primary, to->hits += s->hits, to->shadow += s->shadow, to->blocked += s->blocked;
    to->secondary += s->secondary, to->secondary_hits += s->secondary_hits, to->secondary_seconds += s->secondary_seconds;
    to->inside += s->inside, to->lod_stops += s->lod_stops;
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) to->levels[l] += s->levels[l];
    to->primary_seconds += s->primary_seconds, to->shadow_seconds += s->shadow_seconds, to->shade_seconds += s->shade_seconds;
    to->stop_max = fmax(to->stop_max, s->stop_max);
    to->parent_min = fmin(to->parent_min, s->parent_min);
}

svo_result svo_render(const svo_bvh *bvh, const svo_scene *scene, const svo_render_options *o, uint8_t *pixels, svo_render_stats *stats,
                      svo_error *err)
{
    return svo_render_with_planes(bvh, scene, o, pixels, NULL, stats, err);
}

svo_result svo_render_with_planes(const svo_bvh *bvh, const svo_scene *scene, const svo_render_options *o, uint8_t *pixels,
                                  const svo_render_planes *planes, svo_render_stats *stats, svo_error *err)
{
    if (o->width < 1 || o->height < 1 || o->width > 65536 || o->height > 65536 || (uint64_t)o->width * o->height > (uint64_t)1 << 28)
        return svo_fail(err, SVO_LIMIT, "a picture of %u x %u pixels is over the limit of 65536 a side and 2^28 in all", o->width, o->height);
    renderer r = {.bvh = bvh, .scene = scene, .o = o, .pixels = pixels, .planes = planes, .light = svo_normalize(o->light)};
    if (o->samples < 1 || o->samples > 16 || svo_length(r.light) == 0 || !(o->ambient >= 0 && o->ambient <= 1) || !(o->footprint >= 0))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "samples (1..16), light (not 0), ambient (0..1) or footprint (at least 0) is out of range");
    if (o->bounce > 16 || !(o->reflectance >= 0 && o->reflectance <= 1))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "bounce (0..16) or reflectance (0..1) is out of range");
    r.tiles_x = (o->width + TILE - 1) / TILE;
    r.tiles = r.tiles_x * ((o->height + TILE - 1) / TILE);
    uint32_t threads = o->threads != 0 ? o->threads : svo_processor_count();
    if (threads > r.tiles) threads = (uint32_t)r.tiles;
    svo_result result = SVO_OK;
    r.workers = svo_calloc(o->allocator, threads, sizeof *r.workers);
    r.channels = scene->asset_count != 0 ? svo_alloc(o->allocator, scene->asset_count, sizeof *r.channels) : NULL;
    if (r.workers == NULL || (scene->asset_count != 0 && r.channels == NULL)) {
        result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %u threads", threads);
        goto done;
    }
    for (uint32_t i = 0; i < scene->asset_count; i++) {
        const svo_view *v = scene->assets[i];
        r.channels[i].color = find_channel(v, "color", SVO_KIND_COLOR_SRGB8);
        r.channels[i].normal = find_channel(v, "normal", SVO_KIND_NORMAL_OCT32);
        r.channels[i].emissive = find_channel(v, "emissive", SVO_KIND_COLOR_SRGB8);
        r.channels[i].metallic = find_channel(v, "metallic", SVO_KIND_UNORM8);
        r.channels[i].roughness = find_channel(v, "roughness", SVO_KIND_UNORM8);
        r.channels[i].bone = find_channel(v, "bone", SVO_KIND_ID16);
        if (r.channels[i].bone == SVO_MAX_CHANNELS) r.channels[i].bone = find_channel(v, "bone", SVO_KIND_ID32);
        uint32_t coverage = r.channels[i].coverage = find_channel(v, "coverage", SVO_KIND_UNORM8);
        if (coverage == SVO_MAX_CHANNELS || (v->channels[coverage].encoding == SVO_ENCODING_CONSTANT && v->channels[coverage].channel.value[0] == 255))
            r.channels[i].coverage = SVO_MAX_CHANNELS;
        else r.see_through = true;
    }
    svo_render_stats sum = {.parent_min = INFINITY};
    for (uint32_t t = 0; t < threads; t++) r.workers[t].stats.parent_min = INFINITY;
    if (o->progress != NULL) o->progress(o->user, 0);
    result = svo_parallel_for(threads, r.tiles, 4, render_tiles, &r, err);
    for (uint32_t t = 0; t < threads; t++) svo_render_add_stats(&sum, &r.workers[t].stats);
    if (result == SVO_OK && stats != NULL) *stats = sum;
done:
    if (r.workers != NULL) svo_free(o->allocator, r.workers, threads, sizeof *r.workers);
    if (r.channels != NULL) svo_free(o->allocator, r.channels, scene->asset_count, sizeof *r.channels);
    return result;
}
