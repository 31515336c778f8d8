/* Light by way of other surfaces: single-bounce colour bleeding with stratified rays, and mirror reflections from stored
 * normals (Dado et al. 2016, section 2.5.6). Random numbers follow from pixel, sample and ray, so pictures do not depend on threads. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "svoi_render.h"

static double random_unit(uint64_t *state) /* splitmix64 */
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

/* A direction of the hemisphere around n, weighted by the cosine, for u, v in [0, 1) (Malley: a disc, lifted). */
static svo_vec3 around(svo_vec3 n, double u, double v)
{
    /* any axes (Duff et al. 2017) */
    double sign = n.z >= 0 ? 1 : -1, a = -1 / (sign + n.z), b = n.x * n.y * a;
    svo_vec3 s = {1 + sign * n.x * n.x * a, sign * b, -sign * n.x}, t = {b, sign + n.y * n.y * a, -n.y};
    double radius = sqrt(u), angle = 6.283185307179586 * v;
    svo_vec3 in_plane = svo_add(svo_scale(s, radius * cos(angle)), svo_scale(t, radius * sin(angle)));
    return svo_add(in_plane, svo_scale(n, sqrt(1 - u)));
}

/* Light from what rays have hit, into w->more_light, and what of it was seen through; ray i is rays[i] here and of[i] in the list of all. */
static void add_light(const renderer *r, worker *w, const svo_scene_ray *rays, const uint32_t *of, uint32_t count, float *seen)
{
    const svo_render_options *o = r->o;
    float direct[TILE_PIXELS];
    svo_vec3 normals[TILE_PIXELS];
    for (uint32_t i = 0; i < count; i++) {
        const svo_scene_hit *hit = &w->more_hits[i];
        direct[i] = 0;
        if (!hit->node.hit) continue;
        w->stats.secondary_hits++;
        normals[i] = svoi_render_normal(r, &rays[i], hit);
        direct[i] = (float)fmax(0, svo_dot(normals[i], r->light));
    }
    if (o->shadows) svoi_render_shadows(r, w, rays, w->more_hits, normals, count, direct);
    float albedo[TILE_PIXELS][3], emissive[TILE_PIXELS][3];
    for (uint32_t i = 0; i < count; i++)
        for (int c = 0; c < 3; c++) albedo[i][c] = 0.6f, emissive[i][c] = 0;
    svoi_render_colors(r, offsetof(asset_channels, color), w->more_hits, count, albedo);
    svoi_render_colors(r, offsetof(asset_channels, emissive), w->more_hits, count, emissive);
    for (uint32_t i = 0; i < count; i++) {
        const svo_scene_hit *hit = &w->more_hits[i];
        const uint32_t k = of[i];
        const float sky = svoi_sky(svo_normalize(rays[i].direction));
        if (!hit->node.hit) {
            for (int c = 0; c < 3; c++) w->more_light[k][c] += seen[k] * sky;
            seen[k] = 0;
            continue;
        }
        const float light = (float)(o->ambient * (0.75 + 0.25 * normals[i].y) + (1 - o->ambient) * direct[i]);
        const float cover = r->see_through ? svoi_render_pass(r, &w->more[k], hit, normals[i]) : 1;
        for (int c = 0; c < 3; c++) w->more_light[k][c] += seen[k] * cover * (albedo[i][c] * light + emissive[i][c]);
        seen[k] *= 1 - cover;
    }
}

/* Light that comes along the first `count` rays of w->more, into w->more_light: from surfaces their own light and what they
 * reflect of the sun and, evenly, of the sky; from elsewhere the sky. What covers only a part lets the rest through, front to back. */
static void gather(const renderer *r, worker *w, uint32_t count)
{
    svo_scene_ray rays[TILE_PIXELS];
    uint32_t of[TILE_PIXELS], n = count;
    float seen[TILE_PIXELS];
    memset(w->more_light, 0, count * sizeof *w->more_light);
    for (uint32_t i = 0; i < count; i++) of[i] = i, seen[i] = 1;
    while (n != 0) {
        uint32_t kept = 0;
        for (uint32_t i = 0; i < n; i++) rays[i] = w->more[of[i]];
        svo_scene_trace(r->bvh, rays, n, w->more_hits);
        w->stats.secondary += n;
        add_light(r, w, rays, of, n, seen);
        for (uint32_t i = 0; i < n; i++)
            if (seen[of[i]] >= SVOI_DARK) of[kept++] = of[i];
        n = kept;
    }
}

static float unorm(const svo_view *v, uint32_t channel, uint64_t index, float otherwise)
{
    uint8_t value[SVO_MAX_STRIDE];
    if (channel == SVO_MAX_CHANNELS) return otherwise;
    svo_view_attribute(v, channel, index, value);
    return (float)value[0] / 255;
}

static float reflectance(const renderer *r, const svo_scene_hit *hit)
{
    const svo_view *v = svo_bvh_view(r->bvh, hit->item);
    const asset_channels *c = &r->channels[svo_bvh_item(r->bvh, hit->item)->asset];
    if (c->metallic == SVO_MAX_CHANNELS && c->roughness == SVO_MAX_CHANNELS) return (float)r->o->reflectance;
    return unorm(v, c->metallic, hit->node.attribute, 0) * (1 - unorm(v, c->roughness, hit->node.attribute, 0));
}

/* A ray that leaves the surface at the hit of pixel i. What is smaller than a sample for the eye need not be finer here. */
static svo_scene_ray leaving(const renderer *r, const worker *w, uint32_t i, svo_vec3 direction)
{
    svo_scene_ray ray = {.direction = direction, .t_min = 0, .t_max = INFINITY};
    ray.origin = svo_render_shadow_origin(r->bvh, &w->hits[i], w->normals[i]);
    ray.offset = w->rays[i].spread * w->hits[i].node.t;
    return ray;
}

void svoi_render_secondary(const renderer *r, worker *w, uint32_t x0, uint32_t y0, uint32_t nx, uint32_t count, uint32_t sample)
{
    const svo_render_options *o = r->o;
    const uint32_t strata = o->bounce * o->bounce;
    memset(w->around, 0, sizeof w->around);
    memset(w->mirrored, 0, sizeof w->mirrored);
    /* rays of the same stratum of neighbouring pixels go together: they are the most alike */
    for (uint32_t stratum = 0; stratum < strata; stratum++) {
        uint32_t n = 0;
        for (uint32_t i = 0; i < count; i++) {
            if (!w->hits[i].node.hit) continue;
            uint64_t seed = ((uint64_t)(y0 + i / nx) << 32 | (x0 + i % nx)) * 0xd1342543de82ef95u + (uint64_t)sample * strata + stratum;
            double u = (stratum % o->bounce + random_unit(&seed)) / o->bounce, v = (stratum / o->bounce + random_unit(&seed)) / o->bounce;
            w->more[n] = leaving(r, w, i, around(w->normals[i], u, v));
            w->more_pixel[n++] = i;
        }
        gather(r, w, n);
        for (uint32_t i = 0; i < n; i++)
            for (int k = 0; k < 3; k++) w->around[w->more_pixel[i]][k] += w->more_light[i][k] / (float)strata;
    }
    if (!o->reflections) return;
    uint32_t n = 0;
    for (uint32_t i = 0; i < count; i++) {
        if (!w->hits[i].node.hit) continue;
        float share = reflectance(r, &w->hits[i]);
        svo_vec3 d = svo_normalize(w->rays[i].direction), m = w->normals[i];
        double cosine = svo_dot(d, m);
        if (!(share > 0) || !(cosine < 0)) continue; /* (a stored normal may lean a little away from the viewer) */
        w->mirrored[i][3] = share;
        w->more[n] = leaving(r, w, i, svo_sub(d, svo_scale(m, 2 * cosine)));
        w->more_pixel[n++] = i;
    }
    gather(r, w, n);
    for (uint32_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) w->mirrored[w->more_pixel[i]][k] = w->more_light[i][k];
}
