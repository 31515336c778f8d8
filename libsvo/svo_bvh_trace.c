/* Rays through the hierarchy and into the grids of instances. */
#include <math.h>
#include <string.h>

#include "svoi_bvh.h"
#include "svoi_raycast.h"

const svo_placed *svo_bvh_item(const svo_bvh *b, uint32_t item) { return &b->placed[item]; }

const svo_view *svo_bvh_view(const svo_bvh *b, uint32_t item) { return b->scene->assets[b->placed[item].asset]; }

svo_ray svo_bvh_grid_ray(const svo_bvh *b, uint32_t item, const svo_scene_ray *ray)
{
    const svo_placed *p = &b->placed[item];
    const double *m = p->to_grid;
    double x = ray->origin.x - p->origin[0], y = ray->origin.y - p->origin[1], z = ray->origin.z - p->origin[2];
    svo_ray r;
    for (int k = 0; k < 3; k++) {
        r.origin[k] = m[3 * k] * x + m[3 * k + 1] * y + m[3 * k + 2] * z;
        r.direction[k] = m[3 * k] * ray->direction.x + m[3 * k + 1] * ray->direction.y + m[3 * k + 2] * ray->direction.z;
    }
    r.t_min = ray->t_min, r.t_max = ray->t_max;
    r.spread = ray->spread / p->stretch, r.offset = ray->offset / p->stretch;
    return r;
}

void svo_bvh_from_grid(const svo_bvh *b, uint32_t item, double m[9])
{
    svo_mat4 full = svoi_grid_to_scene(b->scene, b->placed[item].page, b->placed[item].instance);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) m[3 * i + j] = full.m[4 * i + j];
}

svo_vec3 svo_bvh_face_normal(const svo_bvh *b, const svo_scene_hit *hit)
{
    if (hit->node.face == SVO_FACE_INSIDE) return svo_v3(0, 0, 0);
    /* Covectors map by the transpose of the inverse: the rows of to_grid. This keeps the outer side outside when the
     * transform mirrors. */
    const double *row = &b->placed[hit->item].to_grid[3 * (hit->node.face / 2)];
    return svo_normalize(svo_scale(svo_v3(row[0], row[1], row[2]), hit->node.face & 1 ? 1 : -1));
}

/* A ray made ready for boxes. */
typedef struct slab_ray { double o[3], inv[3]; } slab_ray;

static bool make_slab_ray(const svo_bvh *b, const svo_scene_ray *ray, slab_ray *s)
{
    double o[3] = {ray->origin.x, ray->origin.y, ray->origin.z}, d[3] = {ray->direction.x, ray->direction.y, ray->direction.z};
    for (int k = 0; k < 3; k++) {
        if (!isfinite(o[k]) || !isfinite(d[k])) return false;
        s->o[k] = o[k] - b->centre[k];
        /* Finite, so that 0 * inv is 0; boxes are a little too large, so being exactly on a plane does not matter. */
        s->inv[k] = 1 / d[k];
        if (!isfinite(s->inv[k])) s->inv[k] = d[k] < 0 ? -0x1p1000 : 0x1p1000;
    }
    return true;
}

/* Where the ray enters the box; INFINITY when it misses it between t_min and t_max. */
static inline double box_enter(const svoi_bvh_node *n, const slab_ray *s, double t_min, double t_max)
{
    for (int k = 0; k < 3; k++) {
        double a = (n->low[k] - s->o[k]) * s->inv[k], b = (n->high[k] - s->o[k]) * s->inv[k];
        double enter = a < b ? a : b, leave = (a < b ? b : a);
        leave += 0x1p-50 * fabs(leave); /* rounding of far origins */
        t_min = enter > t_min ? enter : t_min;
        t_max = leave < t_max ? leave : t_max;
    }
    return t_min <= t_max ? t_min : INFINITY;
}

/* Visit leaves front to back. With `any` the first hit ends the search. */
static inline __attribute__((always_inline)) bool traverse(const svo_bvh *b, svoi_ray_cache *cache, const svo_scene_ray *ray, bool any, svo_scene_hit *best)
{
    slab_ray s;
    if (b->placed_count == 0 || !make_slab_ray(b, ray, &s)) return false;
    struct { uint32_t node; double enter; } stack[SVOI_BVH_STACK];
    uint32_t top = 0, at = 0;
    bool found = false;
    double t_max = ray->t_max, enter = box_enter(&b->nodes[0], &s, ray->t_min, t_max);
    uint64_t instance = 0;
    if (enter == INFINITY) return false;
    for (;;) {
        const svoi_bvh_node *n = &b->nodes[at];
        if (n->count == 0) {
            double e0 = box_enter(n[0].first + b->nodes, &s, ray->t_min, t_max), e1 = box_enter(n[0].first + 1 + b->nodes, &s, ray->t_min, t_max);
            uint32_t closer = n->first + (e1 < e0), further = n->first + !(e1 < e0);
            double close = e1 < e0 ? e1 : e0, far = e1 < e0 ? e0 : e1;
            if (close != INFINITY) {
                if (far != INFINITY) stack[top].node = further, stack[top++].enter = far;
                at = closer;
                continue;
            }
        } else {
            for (uint32_t i = n->first; i < n->first + n->count; i++) {
                svo_ray r = svo_bvh_grid_ray(b, i, ray);
                r.t_max = t_max;
                const svo_view *view = b->scene->assets[b->placed[i].asset];
                if (any) {
                    if (svoi_ray_blocked(view, cache, &r)) return true;
                    continue;
                }
                svo_hit hit;
                svoi_raycast(view, cache, &r, 1, &hit);
                if (!hit.hit || (found && hit.t == t_max && b->placed[i].instance > instance)) continue;
                found = true;
                t_max = hit.t;
                instance = b->placed[i].instance;
                best->node = hit;
                best->item = i;
            }
        }
        /* Boxes at the same t are still visited: the lowest instance wins there. */
        do {
            if (top == 0) return found;
            at = stack[--top].node;
        } while (stack[top].enter > t_max);
    }
}

/* The one instance's grid, many rays at a time: hits or blocked is NULL. */
static void trace_single(const svo_bvh *b, const svo_scene_ray *rays, uint32_t count, svo_scene_hit *hits, bool *blocked)
{
    enum { SOME = 256 };
    svo_ray grid[SOME];
    svo_hit found[SOME];
    for (uint32_t i = 0; i < count; i += SOME) {
        uint32_t n = count - i < SOME ? count - i : SOME;
        for (uint32_t k = 0; k < n; k++) grid[k] = svo_bvh_grid_ray(b, 0, &rays[i + k]);
        if (blocked != NULL) {
            svo_rays_blocked(b->single, grid, n, blocked + i);
            continue;
        }
        svo_rays_cast(b->single, grid, n, found);
        for (uint32_t k = 0; k < n; k++) {
            memset(&hits[i + k], 0, sizeof hits[i + k]);
            if (found[k].hit) hits[i + k].node = found[k];
        }
    }
}

enum { FEW = 4 }; /* rays that are not worth the lanes */

void svo_scene_trace(const svo_bvh *b, const svo_scene_ray *rays, uint32_t count, svo_scene_hit *hits)
{
    if (b->single != NULL && count > FEW) {
        trace_single(b, rays, count, hits, NULL);
        return;
    }
    svoi_ray_cache cache;
    svoi_ray_cache_init(&cache, count);
    for (uint32_t i = 0; i < count; i++) {
        memset(&hits[i], 0, sizeof hits[i]);
        traverse(b, &cache, &rays[i], false, &hits[i]);
    }
}

void svo_scene_blocked_many(const svo_bvh *b, const svo_scene_ray *rays, uint32_t count, bool *blocked)
{
    if (b->single != NULL && count > FEW) {
        trace_single(b, rays, count, NULL, blocked);
        return;
    }
    svo_scene_hit unused;
    svoi_ray_cache cache;
    svoi_ray_cache_init(&cache, count);
    for (uint32_t i = 0; i < count; i++) blocked[i] = traverse(b, &cache, &rays[i], true, &unused);
}

bool svo_scene_blocked(const svo_bvh *b, const svo_scene_ray *ray)
{
    bool blocked;
    svo_scene_blocked_many(b, ray, 1, &blocked);
    return blocked;
}
