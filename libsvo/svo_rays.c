#include "svo_rays.h"

#include <math.h>
#include <string.h>

#include "svoi_rays.h"

const char *svo_ray_kernel_name(svo_ray_kernel kernel)
{
    switch (kernel) {
    case SVO_KERNEL_AUTO: return "auto";
    case SVO_KERNEL_PORTABLE: return "portable";
    case SVO_KERNEL_AVX512: return "avx512";
    case SVO_KERNEL_AVX2: return "avx2";
    }
    return "?";
}

/* Log2 of the edge of the node that was found, in finest voxels. */
static uint32_t edge_of(const svo_rays *r, int32_t state) { return (uint32_t)state - 1 - r->fraction; }

static svoi_ray_place place_of(const svo_rays *r, const svoi_ray_batch *b, uint32_t j)
{
    const uint32_t above = edge_of(r, b->state[j]);
    svoi_ray_place place = {.tree_level = r->view->tree_depth - above};
    for (uint32_t k = 0; k < 3; k++) place.corner[k] = b->at[k][j] >> r->fraction & -((int32_t)1 << above);
    return place;
}

/* False where the node that was found is not what svo_raycast finds: the kernel may see that a node is small enough only after the
 * ray has entered it, and then it was not when it counted. */
static bool small_enough(const svo_rays *r, const svoi_ray_batch *b, uint32_t j)
{
    const svo_ray *ray = &b->rays[b->found_ray[j]];
    const svoi_ray_place place = place_of(r, b, j);
    const double size = (double)((uint32_t)1 << edge_of(r, b->state[j]));
    double enter = ray->t_min;
    for (uint32_t k = 0; k < 3; k++) {
        const double inv = 1 / ray->direction[k], p = place.corner[k] + (inv < 0 ? size : 0);
        enter = fmax(enter, (p - ray->origin[k]) * inv);
    }
    return size == 1 || size <= ray->spread * enter + ray->offset;
}

/* Number of the attribute of a node that was found: as a cell of the node (or brick) at `unit`, or a block of 2x2x2 cells; `base` is the
 * number of that node's own attribute. */
static uint64_t number_of(const svo_rays *r, svoi_ray_cache *cache, const svoi_ray_batch *b, uint32_t j)
{
    const int32_t state = b->state[j], at[3] = {b->at[0][j], b->at[1][j], b->at[2][j]};
    const uint32_t unit = (uint32_t)b->node_found[j], base = (uint32_t)b->base[j];
    svoi_ray_place place;
    if (!b->numbers) {
        place = place_of(r, b, j);
        return svoi_ray_attribute(r->view, cache, &place);
    }
    if (r->before[unit] & 1) return base; /* a full leaf: all that is inside has its attribute */
    const bool brick_lod = svo_view_brick_lod(r->view), averaged = r->view->averaged;
    const uint32_t above = edge_of(r, state), s = r->fraction + (above & ~1u);
    const uint64_t mask = r->units[unit];
    uint32_t cell = ((uint32_t)at[0] >> s & 3) | ((uint32_t)at[1] >> s & 3) << 2 | ((uint32_t)at[2] >> s & 3) << 4;
    const bool block = above & 1;
    if (block) cell &= 42;
    if (above <= 1) {
        uint64_t blocks = mask | mask >> 1;
        blocks |= blocks >> 4;
        blocks |= blocks >> 16;
        uint32_t number = base + (uint32_t)__builtin_popcountll(mask & r->earlier[cell]);
        if (brick_lod) number += 2 - block + (uint32_t)__builtin_popcountll(blocks & 0x0000050500000505u & r->earlier[cell & 42]);
        return block && averaged ? svo_average_of(number, (uint32_t)__builtin_popcountll(mask >> cell & 0x330033)) : number;
    }
    uint32_t first = cell; /* of the block: in depth-first order, its own number being the one before */
    while (block && !(mask >> first & 1)) first += first & 1 ? first & 4 ? 16 - 5 : 3 : 1;
    uint64_t child = (uint32_t)r->units[unit + 1], rank = (uint64_t)__builtin_popcountll(mask & (((uint64_t)1 << first) - 1));
    const bool brick = s == r->fraction + 2;
    uint32_t before = r->before[child + (brick ? rank : 2 * rank)];
    if (averaged && brick && !block && !(before & 1)) return svo_average_of(base + (before >> 1), (uint32_t)__builtin_popcountll(r->units[child + rank]));
    if (block && (before & 1)) { /* perhaps the block is a full leaf */
        place = place_of(r, b, j);
        return svoi_ray_attribute(r->view, cache, &place);
    }
    return base + (before >> 1) - block;
}

/* Rays that no packet takes. */
static void start_alone(const svo_rays *r, bool lod, svoi_ray_batch *b, uint32_t first, uint32_t count)
{
    const svoi_ray_list *in = &b->in;
    svoi_ray_list *to = &b->start;
    uint32_t n = b->starts;
    for (int k = 0; k < 3; k++) {
        memcpy(&to->o[k][n], &in->o[k][first], count * sizeof(double));
        memcpy(&to->d[k][n], &in->d[k][first], count * sizeof(double));
        memcpy(&to->inv[k][n], &in->inv[k][first], count * sizeof(double));
        memcpy(&to->q[k][n], &in->q[k][first], count * sizeof(int32_t));
    }
    memcpy(&to->t[n], &in->t[first], count * sizeof(double));
    memcpy(&to->t_max[n], &in->t_max[first], count * sizeof(double));
    if (lod) memcpy(&to->spread[n], &in->spread[first], count * sizeof(double)), memcpy(&to->offset[n], &in->offset[first], count * sizeof(double));
    memcpy(&to->ray[n], &in->ray[first], count * sizeof(int32_t));
    r->code->begin(r, lod, to, b, n, count);
    b->starts += count;
}

/* Bring packets of rays as far as they go together. True if there are any; then all rays are in `start`. */
static bool trace_packets(const svo_rays *r, bool lod, svoi_ray_batch *b)
{
    uint32_t alone = 0; /* rays before the first packet are moved when there is one */
    bool any = false;
    b->starts = 0;
    for (uint32_t i = 0; i < b->count;) {
        uint32_t n = b->count - i < SVOI_RAYS_PACKET ? b->count - i : SVOI_RAYS_PACKET;
        bool together = n >= 8 && r->code->packet(r, lod, false, b, i, n);
        if (together && !any) any = true, start_alone(r, lod, b, 0, alone);
        else if (!together && any) start_alone(r, lod, b, i, n);
        else if (!together) alone += n;
        i += n;
    }
    if (!any) r->code->begin(r, lod, &b->in, b, 0, b->count);
    return any;
}

void svoi_rays_settle(const svo_rays *r, bool lod, svoi_ray_batch *b)
{
    r->code->trace(r, lod, true, b);
    for (uint32_t j = 0; j < b->found; j++) {
        const uint32_t i = (uint32_t)b->found_ray[j];
        const bool sure = b->state[j] != SVOI_RAY_DOUBT && (!lod || small_enough(r, b, j));
        (sure ? b->blocked : b->unsure)[i / 8] |= (uint8_t)(1u << i % 8);
    }
    b->starts = b->found = 0;
}

/* At most SVOI_RAYS_BATCH rays. */
static void blocked_batch(const svo_rays *r, svoi_ray_cache *cache, svoi_ray_batch *b, const svo_ray *rays, uint32_t count, bool *blocked)
{
    const bool lod = r->code->prepare(r, rays, count, b);
    b->rays = rays;
    b->found = b->starts = 0;
    b->numbers = false;
    memset(b->blocked, 0, sizeof b->blocked);
    for (uint32_t i = 0, n; i < b->count; i += n) {
        n = b->count - i < SVOI_RAYS_PACKET ? b->count - i : SVOI_RAYS_PACKET;
        if (b->starts + b->found + SVOI_RAYS_PACKET > SVOI_RAYS_BATCH) svoi_rays_settle(r, lod, b);
        if (n < 8 || !r->code->packet(r, lod, true, b, i, n)) start_alone(r, lod, b, i, n);
    }
    svoi_rays_settle(r, lod, b);
    for (uint32_t i = 0; i < count; i++) {
        blocked[i] = b->blocked[i / 8] >> i % 8 & 1;
        if (!blocked[i] && (b->unsure[i / 8] >> i % 8 & 1)) blocked[i] = svoi_ray_blocked(r->view, cache, &rays[i]);
    }
}

/* At most SVOI_RAYS_BATCH rays. */
static void cast_batch(const svo_rays *r, svoi_ray_cache *cache, svoi_ray_batch *b, const svo_ray *rays, uint32_t count, svo_hit *hits)
{
    bool lod = r->code->prepare(r, rays, count, b);
    b->found = 0;
    b->rays = rays;
    b->numbers = r->before != NULL;
    b->numbered = false;
    bool start = trace_packets(r, lod, b);
    r->code->trace(r, lod, start, b);
    if (b->found < count) memset(hits, 0, count * sizeof *hits); /* padding too: hits can be compared as bytes */
    for (uint32_t i = 0; i < (count + 7) / 8; i++)
        for (uint32_t rest = b->unsure[i]; rest != 0; rest &= rest - 1) {
            uint32_t ray = 8 * i + (uint32_t)__builtin_ctz(rest);
            svoi_raycast(r->view, cache, &rays[ray], 1, &hits[ray]);
        }
    r->code->hits(r, lod, b, hits);
    for (uint32_t j = 0; j < b->found; j += 8)
        for (uint32_t rest = b->again[j / 8]; rest != 0; rest &= rest - 1) {
            const uint32_t i = (uint32_t)b->found_ray[j + (uint32_t)__builtin_ctz(rest)];
            svoi_raycast(r->view, cache, &rays[i], 1, &hits[i]);
        }
    for (uint32_t j = 0; j < b->found && !r->view->unnumbered && !b->numbered; j++)
        if (!(b->again[j / 8] >> j % 8 & 1)) hits[b->found_ray[j]].attribute = number_of(r, cache, b, j);
}

static void trace_all(const svo_rays *r, const svo_ray *rays, uint64_t count, svo_hit *hits, bool *blocked)
{
    svoi_ray_cache cache;
    svoi_ray_batch batch;
    svoi_ray_cache_init(&cache, count);
    memset(batch.stack, 0, sizeof batch.stack); /* lanes without a ray read nodes too: what is there must be one */
    bool small = r->view->depth < 2; /* its virtual levels are svo_raycast's business */
    for (uint64_t i = 0; i < count; i += SVOI_RAYS_BATCH) {
        uint32_t n = count - i < SVOI_RAYS_BATCH ? (uint32_t)(count - i) : SVOI_RAYS_BATCH;
        svo_hit *h = hits != NULL ? hits + i : NULL;
        bool *b = blocked != NULL ? blocked + i : NULL;
        if (r->code != NULL && !small && h != NULL) cast_batch(r, &cache, &batch, rays + i, n, h);
        else if (r->code != NULL && !small) blocked_batch(r, &cache, &batch, rays + i, n, b);
        else if (h != NULL) svoi_raycast(r->view, &cache, rays + i, n, h);
        else
            for (uint32_t k = 0; k < n; k++) b[k] = svoi_ray_blocked(r->view, &cache, &rays[i + k]);
    }
}

void svo_rays_cast(const svo_rays *r, const svo_ray *rays, uint64_t count, svo_hit *hits) { trace_all(r, rays, count, hits, NULL); }

void svo_rays_blocked(const svo_rays *r, const svo_ray *rays, uint64_t count, bool *blocked) { trace_all(r, rays, count, NULL, blocked); }
