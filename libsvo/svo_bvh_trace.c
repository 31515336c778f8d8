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

/* ---- many rays at a time ------------------------------------------------------------------------------------------------ */

enum { SOME = 256, FEW = 4 /* rays that are not worth the lanes */ };

/* A batch on its way through the hierarchy. `hits` or `blocked` is NULL. */
typedef struct stream {
    const svo_bvh *b;
    svoi_ray_cache *cache;
    const svo_scene_ray *rays;
    svo_scene_hit *hits;
    bool *blocked;
    slab_ray slab[SOME];
    double t_max[SOME];
    svo_ray grid[SOME];
    svo_hit found[SOME];
    bool dark[SOME];
    uint16_t list[(SVOI_BVH_STACK + 2) * SOME]; /* rays that go into the nodes on the stack, parents first */
} stream;

/* Some rays against one instance. */
static void stream_item(stream *s, uint32_t item, const uint16_t *list, uint32_t count)
{
    const svo_bvh *b = s->b;
    const svo_rays *fast = count > FEW ? b->rays[b->placed[item].asset] : NULL;
    const svo_view *view = svo_bvh_view(b, item);
    for (uint32_t k = 0; k < count; k++) {
        s->grid[k] = svo_bvh_grid_ray(b, item, &s->rays[list[k]]);
        s->grid[k].t_max = s->t_max[list[k]];
    }
    if (s->blocked != NULL) {
        if (fast != NULL) svo_rays_blocked(fast, s->grid, count, s->dark);
        else
            for (uint32_t k = 0; k < count; k++) s->dark[k] = !s->blocked[list[k]] && svoi_ray_blocked(view, s->cache, &s->grid[k]);
        for (uint32_t k = 0; k < count; k++) s->blocked[list[k]] |= s->dark[k];
        return;
    }
    if (fast != NULL) svo_rays_cast(fast, s->grid, count, s->found);
    else svoi_raycast(view, s->cache, s->grid, count, s->found);
    for (uint32_t k = 0; k < count; k++) {
        svo_scene_hit *best = &s->hits[list[k]];
        const svo_hit *hit = &s->found[k];
        if (!hit->hit || (best->node.hit && hit->t == s->t_max[list[k]] && b->placed[item].instance > b->placed[best->item].instance)) continue;
        s->t_max[list[k]] = hit->t;
        best->node = *hit;
        best->item = item;
    }
}

/* The first `count` rays of the list, which should go the same way: nodes are visited in the order of the first of them, which matters for the time only. */
static void stream_traverse(stream *s, uint32_t count)
{
    struct { uint32_t node, first, count; } stack[SVOI_BVH_STACK + 2];
    uint32_t top = 0;
    stack[top].node = 0, stack[top].first = 0, stack[top++].count = count;
    while (top != 0) {
        top--;
        const svoi_bvh_node *n = &s->b->nodes[stack[top].node];
        const uint16_t *from = s->list + stack[top].first;
        uint32_t first = stack[top].first + stack[top].count, kept = 0, all = stack[top].count;
        uint16_t *to = s->list + first;
        for (uint32_t k = 0; k < all; k++) {
            uint16_t i = from[k];
            if (s->blocked != NULL && s->blocked[i]) continue;
            if (box_enter(n, &s->slab[i], s->rays[i].t_min, s->t_max[i]) != INFINITY) to[kept++] = i;
        }
        if (kept == 0) continue;
        if (n->count != 0) {
            for (uint32_t i = n->first; i < n->first + n->count; i++) stream_item(s, i, to, kept);
            continue;
        }
        const svoi_bvh_node *child = s->b->nodes + n->first;
        const slab_ray *r = &s->slab[to[0]];
        double e0 = box_enter(child, r, s->rays[to[0]].t_min, INFINITY), e1 = box_enter(child + 1, r, s->rays[to[0]].t_min, INFINITY);
        uint32_t closer = e1 < e0;
        for (uint32_t k = 0; k < 2; k++) {
            stack[top].node = n->first + (k == 0 ? !closer : closer);
            stack[top].first = first, stack[top++].count = kept;
        }
    }
}

static void trace_stream(const svo_bvh *b, svoi_ray_cache *cache, const svo_scene_ray *rays, uint32_t count, svo_scene_hit *hits, bool *blocked)
{
    stream s;
    uint8_t octant[SOME];
    s.b = b, s.cache = cache, s.rays = rays, s.hits = hits, s.blocked = blocked;
    for (uint32_t i = 0; i < count; i++) {
        if (hits != NULL) memset(&hits[i], 0, sizeof hits[i]);
        else blocked[i] = false;
        const svo_vec3 d = rays[i].direction;
        octant[i] = (uint8_t)((d.x < 0) | (d.y < 0) << 1 | (d.z < 0) << 2);
        s.t_max[i] = rays[i].t_max;
        if (!make_slab_ray(b, &rays[i], &s.slab[i])) octant[i] = 8;
    }
    for (uint8_t o = 0; o < 8; o++) {
        uint32_t n = 0;
        for (uint32_t i = 0; i < count; i++)
            if (octant[i] == o) s.list[n++] = (uint16_t)i;
        if (n != 0) stream_traverse(&s, n);
    }
}

/* Any number of rays; hits or blocked is NULL. */
static void trace_many(const svo_bvh *b, const svo_scene_ray *rays, uint32_t count, svo_scene_hit *hits, bool *blocked)
{
    svoi_ray_cache cache;
    svoi_ray_cache_init(&cache, count);
    svo_scene_hit unused;
    if (b->rays != NULL && b->placed_count != 0 && count > FEW) {
        for (uint32_t i = 0; i < count; i += SOME) {
            uint32_t n = count - i < SOME ? count - i : SOME;
            trace_stream(b, &cache, rays + i, n, hits != NULL ? hits + i : NULL, blocked != NULL ? blocked + i : NULL);
        }
        return;
    }
    for (uint32_t i = 0; i < count; i++) {
        if (blocked != NULL) blocked[i] = traverse(b, &cache, &rays[i], true, &unused);
        else {
            memset(&hits[i], 0, sizeof hits[i]);
            traverse(b, &cache, &rays[i], false, &hits[i]);
        }
    }
}

void svo_scene_trace(const svo_bvh *b, const svo_scene_ray *rays, uint32_t count, svo_scene_hit *hits) { trace_many(b, rays, count, hits, NULL); }

void svo_scene_blocked_many(const svo_bvh *b, const svo_scene_ray *rays, uint32_t count, bool *blocked) { trace_many(b, rays, count, NULL, blocked); }

bool svo_scene_blocked(const svo_bvh *b, const svo_scene_ray *ray)
{
    bool blocked;
    svo_scene_blocked_many(b, ray, 1, &blocked);
    return blocked;
}
