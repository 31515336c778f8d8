/* What a ray of light passes: voxels that cover only a part of what is behind them (the channel "coverage"), and for shadow rays the
 * voxels of the surface that they leave. See docs/design/003-ray-casting.md. */
#include "svoi_render.h"

#include <math.h>
#include <string.h>

/* Move the ray's begin behind a node that it has met; returns the way inside, in units of t. */
static double pass(const renderer *r, svo_scene_ray *ray, const svo_scene_hit *hit)
{
    svo_ray grid = svo_bvh_grid_ray(r->bvh, hit->item, ray);
    double enter, leave = hit->node.t;
    svo_ray_node(svo_bvh_view(r->bvh, hit->item), &grid, hit->node.level, hit->node.cell, &enter, &leave);
    double next = nextafter(fmax(hit->node.t, ray->t_min), INFINITY);
    ray->t_min = leave > next ? leave : next;
    return fmax(leave - hit->node.t, 0);
}

/* Unit normal n of the scene as a covector of an item's grid, normalised. */
static svo_vec3 grid_normal(const renderer *r, uint32_t item, svo_vec3 n)
{
    double m[9];
    svo_bvh_from_grid(r->bvh, item, m);
    return svo_normalize(svo_v3(m[0] * n.x + m[3] * n.y + m[6] * n.z, m[1] * n.x + m[4] * n.y + m[7] * n.z, m[2] * n.x + m[5] * n.y + m[8] * n.z));
}

float svoi_render_pass(const renderer *r, svo_scene_ray *ray, const svo_scene_hit *hit, svo_vec3 normal)
{
    const svo_placed *p = svo_bvh_item(r->bvh, hit->item);
    const svo_view *v = svo_bvh_view(r->bvh, hit->item);
    const uint32_t channel = r->channels[p->asset].coverage;
    uint8_t value[SVO_MAX_STRIDE];
    if (channel == SVO_MAX_CHANNELS) return 1;
    svo_view_attribute(v, channel, hit->node.attribute, value);
    if (value[0] == 255) return 1;
    double way = pass(r, ray, hit), edge = ldexp(1, (int)(v->depth - hit->node.level));
    svo_ray grid = svo_bvh_grid_ray(r->bvh, hit->item, ray);
    svo_vec3 g = grid_normal(r, hit->item, normal), d = svo_v3(grid.direction[0], grid.direction[1], grid.direction[2]);
    double thick = v->surface == SVO_SURFACE_THIN ? fmax(fabs(g.x), fmax(fabs(g.y), fabs(g.z))) : fabs(g.x) + fabs(g.y) + fabs(g.z);
    double share = way * fabs(svo_dot(d, g)) / (thick * edge); /* of one surface */
    return (float)(1 - pow(1 - value[0] / 255.0, share));
}

/* ---- shadows -------------------------------------------------------------------------------------------------------- */

/* The surface that a shadow ray leaves: voxels of the same item whose centres are near the plane through that of the hit node, and whose stored
 * normals agree. Without stored normals there is no such surface, and the ray begins above all voxels that it could have. */
typedef struct surface {
    uint32_t item;
    double centre[3], edge, reach; /* in the grid */
    svo_vec3 g;
    float normal[3]; /* as stored */
    double until;    /* t at which the ray is above the surface; 0: no surface */
} surface;

static bool stored_normal(const renderer *r, const svo_scene_hit *hit, float out[3])
{
    const uint32_t channel = r->channels[svo_bvh_item(r->bvh, hit->item)->asset].normal;
    uint8_t value[SVO_MAX_STRIDE];
    if (channel == SVO_MAX_CHANNELS) return false;
    svo_view_attribute(svo_bvh_view(r->bvh, hit->item), channel, hit->node.attribute, value);
    svo_oct32_decode(value, out);
    return out[0] * out[0] + out[1] * out[1] + out[2] * out[2] > 0.5f;
}

static double centre_of(const svo_view *v, const svo_hit *hit, double at[3])
{
    double edge = ldexp(1, (int)(v->depth - hit->level));
    for (int k = 0; k < 3; k++) at[k] = (hit->cell[k] + 0.5) * edge;
    return edge;
}

/* A ray towards the light from a hit with unit normal n, whose cosine with it is above 0. */
static svo_scene_ray leave_surface(const renderer *r, const svo_scene_hit *hit, svo_vec3 n, surface *s)
{
    svo_scene_ray ray = {.direction = r->light, .t_min = 0, .t_max = INFINITY};
    *s = (surface){.item = hit->item};
    if (!stored_normal(r, hit, s->normal)) {
        ray.origin = svo_render_shadow_origin(r->bvh, hit, n);
        return ray;
    }
    const svo_placed *p = svo_bvh_item(r->bvh, hit->item);
    double m[9], at[3];
    s->edge = centre_of(svo_bvh_view(r->bvh, hit->item), &hit->node, s->centre);
    s->g = grid_normal(r, hit->item, n);
    s->reach = 0.5 * (fabs(s->g.x) + fabs(s->g.y) + fabs(s->g.z));
    const double g[3] = {s->g.x, s->g.y, s->g.z};
    for (int k = 0; k < 3; k++) at[k] = s->centre[k] + s->reach * s->edge * g[k];
    svo_bvh_from_grid(r->bvh, hit->item, m);
    ray.origin = svo_v3(p->origin[0] + m[0] * at[0] + m[1] * at[1] + m[2] * at[2], p->origin[1] + m[3] * at[0] + m[4] * at[1] + m[5] * at[2],
                        p->origin[2] + m[6] * at[0] + m[7] * at[1] + m[8] * at[2]);
    svo_ray grid = svo_bvh_grid_ray(r->bvh, hit->item, &ray);
    double rate = grid.direction[0] * g[0] + grid.direction[1] * g[1] + grid.direction[2] * g[2];
    s->until = 2 * s->reach * s->edge / rate;
    if (!(s->until > 0 && s->until < INFINITY)) s->until = 0, ray.origin = svo_render_shadow_origin(r->bvh, hit, n);
    return ray;
}

static bool same_surface(const renderer *r, const surface *s, const svo_scene_hit *hit)
{
    double at[3];
    float n[3];
    if (!(hit->node.t < s->until) || hit->item != s->item) return false;
    double edge = centre_of(svo_bvh_view(r->bvh, hit->item), &hit->node, at);
    double height = (at[0] - s->centre[0]) * s->g.x + (at[1] - s->centre[1]) * s->g.y + (at[2] - s->centre[2]) * s->g.z;
    if (fabs(height) > s->reach * (edge + s->edge) * 1.000001) return false;
    return stored_normal(r, hit, n) && n[0] * s->normal[0] + n[1] * s->normal[1] + n[2] * s->normal[2] > 0.75f;
}

/* Follow rays through what lets light pass, from their begin on; light[i] is multiplied by what arrives. */
static void follow(const renderer *r, svo_scene_ray *rays, const surface *surfaces, uint32_t count, float *light)
{
    svo_scene_hit hits[TILE_PIXELS];
    svo_scene_ray live[TILE_PIXELS];
    uint32_t of[TILE_PIXELS], n = count;
    for (uint32_t i = 0; i < count; i++) of[i] = i;
    while (n != 0) {
        uint32_t kept = 0;
        for (uint32_t i = 0; i < n; i++) live[i] = rays[of[i]];
        svo_scene_trace(r->bvh, live, n, hits);
        for (uint32_t i = 0; i < n; i++) {
            const uint32_t k = of[i];
            if (!hits[i].node.hit) continue;
            if (same_surface(r, &surfaces[k], &hits[i])) pass(r, &rays[k], &hits[i]);
            else {
                svo_scene_ray ray = rays[k];
                light[k] *= r->see_through ? 1 - svoi_render_pass(r, &rays[k], &hits[i], svoi_render_normal(r, &ray, &hits[i])) : 0;
                if (light[k] < SVOI_DARK) light[k] = 0;
            }
            if (light[k] > 0 && rays[k].t_min < rays[k].t_max) of[kept++] = k;
        }
        n = kept;
    }
}

void svoi_render_shadows(const renderer *r, worker *w, const svo_scene_ray *from, const svo_scene_hit *hits, const svo_vec3 *normals, uint32_t count, float *direct)
{
    surface surfaces[TILE_PIXELS];
    uint32_t of[TILE_PIXELS], n = 0, left = 0;
    bool blocked[TILE_PIXELS];
    float light[TILE_PIXELS];
    svo_scene_ray *rays = w->shadow_rays;
    for (uint32_t i = 0; i < count; i++) {
        if (!(direct[i] > 0)) continue;
        rays[n] = leave_surface(r, &hits[i], normals[i], &surfaces[n]);
        rays[n].offset = from[i].spread * hits[i].node.t + from[i].offset; /* nodes that look no larger than a sample from the eye */
        of[n++] = i;
    }
    w->stats.shadow += n;
    svo_scene_blocked_many(r->bvh, rays, n, blocked);
    for (uint32_t i = 0; i < n; i++) {
        if (!blocked[i]) continue;
        rays[left] = rays[i], surfaces[left] = surfaces[i], of[left++] = of[i];
    }
    if (!r->see_through) { /* above the surface everything stops light */
        n = left, left = 0;
        for (uint32_t i = 0; i < n; i++) rays[i].t_min = surfaces[i].until;
        svo_scene_blocked_many(r->bvh, rays, n, blocked);
        for (uint32_t i = 0; i < n; i++) {
            if (blocked[i] || surfaces[i].until == 0) {
                direct[of[i]] = 0;
                w->stats.blocked++;
                continue;
            }
            rays[i].t_min = 0, rays[i].t_max = surfaces[i].until;
            rays[left] = rays[i], surfaces[left] = surfaces[i], of[left++] = of[i];
        }
    }
    for (uint32_t i = 0; i < left; i++) light[i] = 1;
    follow(r, rays, surfaces, left, light);
    for (uint32_t i = 0; i < left; i++) {
        direct[of[i]] *= light[i];
        w->stats.blocked += light[i] == 0;
    }
}
