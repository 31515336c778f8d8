/* Internal to libsvo: ray casting with a memory of what was decoded. Not installed. */
#ifndef SVOI_RAYCAST_H
#define SVOI_RAYCAST_H

#include "svo_raycast.h"
#include "svoi_best.h"
#include "svoi_ray_fast.h"

/* Nodes and blocks of layouts fast and best that rays met last, decoded: neighbouring rays meet the same ones, so that most
 * steps are a look into an array. For one thread and for as long as the views live. Layout plain does not use it. */
enum { SVOI_CACHE_BITS = 7, SVOI_CACHE_SMALL_BITS = 3 };

typedef struct svoi_cached_node {
    svoi_best_head head;
    uint64_t child[8]; /* packed, by octant of the node's frame */
    uint8_t turn[8];
    uint32_t have; /* children that have been looked up */
} svoi_cached_node;

typedef struct svoi_cache_key {
    const svoi_best *owner;
    uint64_t at; /* packed; 0: nothing */
} svoi_cache_key;

typedef struct svoi_ray_cache {
    uint32_t bits; /* entries in use, as a power of two: fewer for few rays, which would not pay for clearing more */
    svoi_cache_key node_key[1 << SVOI_CACHE_BITS], block_key[1 << SVOI_CACHE_BITS];
    svoi_cached_node node[1 << SVOI_CACHE_BITS];
    svoi_best_block block[1 << SVOI_CACHE_BITS];
    svoi_kept fast;
} svoi_ray_cache;

static inline void svoi_ray_cache_init(svoi_ray_cache *c, uint64_t rays)
{
    c->bits = rays < 16 ? SVOI_CACHE_SMALL_BITS : SVOI_CACHE_BITS;
    memset(c->node_key, 0, sizeof *c->node_key << c->bits);
    memset(c->block_key, 0, sizeof *c->block_key << c->bits);
    c->fast.ready = false; /* cleared by the first ray that needs it */
    c->fast.few = rays < 16;
}

/* As svo_raycast and svo_ray_blocked. */
void svoi_raycast(const svo_view *view, svoi_ray_cache *cache, const svo_ray *rays, uint32_t count, svo_hit *hits);
bool svoi_ray_blocked(const svo_view *view, svoi_ray_cache *cache, const svo_ray *ray);

/* A node that a ray has met: its level in the tree of svo_view.tree_depth, its corner in finest voxels. */
typedef struct svoi_ray_place {
    uint32_t tree_level;
    int32_t corner[3];
} svoi_ray_place;
/* Its attribute index. */
uint64_t svoi_ray_attribute(const svo_view *view, svoi_ray_cache *cache, const svoi_ray_place *at);

#endif
