#include "svoi_raycast.h"

#include <math.h>
#include <string.h>

/* The kernel walks cells front to back (after Laine and Karras 2010): the current cell is a child slot of the node `ref` of
 * some level; a filled slot is entered, an empty one is left through its nearest far plane. Positions are integers, so
 * the ancestor to return to is known from the highest bit that a step changes. The last two levels are one 64-bit brick
 * with its own small walk. Every decision compares plane parameters of one function (svo_raycast.h), whose values
 * grow along the ray; this is what makes the result exact rather than nearly right. */

#define INLINE static inline __attribute__((always_inline))

/* A ray made ready for one view. */
typedef struct line {
    double o[3], inv[3];
    double base, unit; /* the caller's t is (t + base) * unit: see make_line */
    double t_min, t_max, spread, offset;
    uint32_t negative; /* bit k: direction[k] < 0 */
} line;

typedef svoi_ray_place place;

INLINE double plane(const line *l, int axis, int32_t p) { return ((double)p - l->o[axis]) * l->inv[axis]; }
INLINE double least(double a, double b, double c)
{
    double m = a < b ? a : b;
    return m < c ? m : c;
}
INLINE double greatest(double a, double b, double c)
{
    double m = a > b ? a : b;
    return m > c ? m : c;
}

/* Near and far planes of a cell. */
INLINE double near_plane(const line *l, int axis, int32_t p, int32_t size)
{
    return plane(l, axis, l->negative >> axis & 1 ? p + size : p);
}
INLINE double far_plane(const line *l, int axis, int32_t p, int32_t size)
{
    return plane(l, axis, l->negative >> axis & 1 ? p : p + size);
}
INLINE double cell_enter(const line *l, const int32_t p[3], int32_t size)
{
    return greatest(near_plane(l, 0, p[0], size), near_plane(l, 1, p[1], size), near_plane(l, 2, p[2], size));
}

static bool make_line(const svo_view *v, const svo_ray *ray, line *l)
{
    if (v->empty) return false;
    double origin[3], direction[3], big = 0, far = 0;
    for (int k = 0; k < 3; k++) {
        origin[k] = ray->origin[k], direction[k] = ray->direction[k];
        if (!isfinite(origin[k]) || !isfinite(direction[k])) return false;
        big = fmax(big, fabs(direction[k]));
        far = fmax(far, fabs(origin[k]));
    }
    l->base = 0, l->unit = 1;
    l->t_min = ray->t_min, l->t_max = ray->t_max;
    l->spread = v->lod ? ray->spread : 0, l->offset = v->lod ? ray->offset : 0;
    if (big > 0 && (big < 0x1p-300 || big > 0x1p300)) {
        /* Reciprocals would overflow or lose bits; a power of two costs none. */
        int e;
        frexp(big, &e);
        for (int k = 0; k < 3; k++) direction[k] = ldexp(direction[k], -e);
        l->unit = ldexp(1, -e);
        l->t_min /= l->unit, l->t_max /= l->unit, l->spread *= l->unit;
    }
    if (far > 0x1p40 && big > 0) {
        /* p - origin would lose the cells: begin where the ray comes to the grid. */
        double size = (double)((int32_t)1 << v->tree_depth), enter = -INFINITY;
        for (int k = 0; k < 3; k++)
            if (direction[k] != 0) {
                double t = ((direction[k] > 0 ? 0 : size) - origin[k]) / direction[k];
                if (isfinite(t)) enter = fmax(enter, t);
            }
        if (isfinite(enter)) {
            for (int k = 0; k < 3; k++) {
                origin[k] += direction[k] * enter;
                if (!isfinite(origin[k])) return false;
            }
            l->base = enter;
            l->t_min -= enter, l->t_max -= enter;
            l->offset += l->spread * enter;
        }
    }
    l->negative = 0;
    for (int k = 0; k < 3; k++) {
        double inv = 1 / direction[k];
        if (!isfinite(inv)) {
            /* Parallel to the planes: -infinity for those at or below the origin, +infinity for those above, never 0 * infinity. */
            l->o[k] = floor(origin[k]) + 0.5;
            l->inv[k] = INFINITY;
        } else {
            l->o[k] = origin[k];
            l->inv[k] = inv;
            if (direction[k] < 0) l->negative |= 1u << k;
        }
    }
    return true;
}

/* Morton bits of a coordinate 0..3 of a brick. */
static const uint8_t brick_x[4] = {0, 1, 8, 9}, brick_y[4] = {0, 2, 16, 18}, brick_z[4] = {0, 4, 32, 36};

/* First voxel of a brick met at or after t. On success *bit is its Morton bit. `leave` are the brick's far planes. */
INLINE bool walk_brick(const line *l, uint64_t brick, const int32_t p[3], double t, const double leave[3], uint32_t *bit)
{
    /* far planes of the four slabs of an axis, in the ray's order */
    double slab[3][4];
    uint32_t i[3];
    for (int k = 0; k < 3; k++) {
        bool down = l->negative >> k & 1;
        slab[k][0] = plane(l, k, down ? p[k] + 3 : p[k] + 1);
        slab[k][1] = plane(l, k, p[k] + 2);
        slab[k][2] = plane(l, k, down ? p[k] + 1 : p[k] + 3);
        slab[k][3] = leave[k];
        i[k] = (uint32_t)(slab[k][0] <= t) + (uint32_t)(slab[k][1] <= t) + (uint32_t)(slab[k][2] <= t);
    }
    const uint32_t flip = l->negative * 9; /* mirrors both bits of an axis */
    for (;;) {
        uint32_t b = (uint32_t)(brick_x[i[0]] | brick_y[i[1]] | brick_z[i[2]]) ^ flip;
        double x = slab[0][i[0]], y = slab[1][i[1]], z = slab[2][i[2]], next = least(x, y, z);
        if ((brick >> b & 1) && t < next) {
            *bit = b;
            return t <= l->t_max;
        }
        t = next;
        i[0] += x <= t, i[1] += y <= t, i[2] += z <= t;
        if ((i[0] | i[1] | i[2]) & 4) return false;
    }
}

/* The non-empty children of one node in the order of the ray. */
typedef struct eight {
    double centre[3], leave[3], t;
    int32_t corner[3], half;
    uint32_t mask, at; /* at: child to look at next, bit k = the further half of axis k; 8 = done */
} eight;

static eight eight_begin(const line *l, uint32_t mask, const int32_t corner[3], int32_t half, double t, const double leave[3])
{
    eight e = {.t = t, .half = half, .mask = mask, .at = 0};
    for (int k = 0; k < 3; k++) {
        e.corner[k] = corner[k];
        e.leave[k] = leave[k];
        e.centre[k] = plane(l, k, corner[k] + half);
        e.at |= (uint32_t)(e.centre[k] <= t) << k;
    }
    return e;
}

static bool eight_next(const line *l, eight *e, uint32_t *octant, double *t, int32_t corner[3], double leave[3])
{
    while (e->at != 8) {
        uint32_t at = e->at, step = 0;
        for (int k = 0; k < 3; k++) leave[k] = at >> k & 1 ? e->leave[k] : e->centre[k];
        double enter = e->t, next = least(leave[0], leave[1], leave[2]);
        for (int k = 0; k < 3; k++) step |= (uint32_t)(leave[k] <= next) << k;
        e->at = at & step ? 8 : at | step;
        e->t = next;
        *octant = at ^ l->negative;
        if (!(e->mask >> *octant & 1) || !(enter < next)) continue;
        for (int k = 0; k < 3; k++) corner[k] = e->corner[k] + (*octant >> k & 1 ? e->half : 0);
        *t = enter;
        return true;
    }
    return false;
}

INLINE bool small_enough(const line *l, int32_t size, double t) { return (double)size <= l->spread * t + l->offset; }

/* A brick that is not small enough itself, but whose octants may be. */
static bool walk_brick_lod(const line *l, uint64_t brick, const int32_t p[3], double t, const double leave[3],
                           uint32_t brick_level, place *found)
{
    uint32_t mask = 0, octant, voxel;
    for (uint32_t a = 0; a < 8; a++) mask |= (uint32_t)((brick >> 8 * a & 0xff) != 0) << a;
    eight outer = eight_begin(l, mask, p, 2, t, leave);
    int32_t corner[3];
    double out[3], voxel_out[3];
    while (eight_next(l, &outer, &octant, &t, corner, out)) {
        if (!(t <= l->t_max)) return false;
        if (small_enough(l, 2, t)) {
            found->tree_level = brick_level + 1;
            memcpy(found->corner, corner, sizeof corner);
            return true;
        }
        eight inner = eight_begin(l, (uint32_t)(brick >> 8 * octant & 0xff), corner, 1, t, out);
        if (eight_next(l, &inner, &voxel, &t, found->corner, voxel_out)) {
            found->tree_level = brick_level + 2;
            return t <= l->t_max;
        }
    }
    return false;
}

/* A node on the way down: where it is stored (layout fast: its slot in the memory), its children in the world with the full leaves among them in bits 8..15. */
typedef struct spot {
    uint64_t at;
    uint32_t mask, turn;
} spot;

INLINE uint32_t cache_slot(const svoi_ray_cache *c, uint64_t at) { return (uint32_t)((at * 0x9e3779b97f4a7c15u) >> (64 - c->bits)); }

INLINE const svoi_best_block *cached_block(svoi_ray_cache *c, const svoi_best *b, uint64_t at)
{
    uint32_t i = cache_slot(c, at);
    if (c->block_key[i].at != at || c->block_key[i].owner != b) {
        svoi_best_read_block(b, svoi_best_unpack(at), &c->block[i]);
        c->block_key[i] = (svoi_cache_key){b, at};
    }
    return &c->block[i];
}

/* Child of a node above the blocks in the frame of the node; *turn from its own frame to that. */
INLINE uint64_t cached_child(svoi_ray_cache *c, const svoi_best *b, uint32_t level, uint64_t at, uint32_t octant, uint32_t *turn)
{
    uint32_t i = cache_slot(c, at);
    svoi_cached_node *n = &c->node[i];
    if (c->node_key[i].at != at || c->node_key[i].owner != b) {
        n->head = svoi_best_read_head(b, level, svoi_best_unpack(at));
        n->have = 0;
        c->node_key[i] = (svoi_cache_key){b, at};
    }
    if (!(n->have >> octant & 1)) {
        n->child[octant] = svoi_best_pack(svoi_best_child(b, level, svoi_best_unpack(at), &n->head, octant, turn));
        n->turn[octant] = (uint8_t)*turn;
        n->have |= 1u << octant;
    }
    *turn = n->turn[octant];
    return n->child[octant];
}

/* The same as svo_view_mask and svo_view_child, without attributes. A child at the bricks' level is the brick itself.
 * `layout` is a constant of the callers. */
INLINE spot spot_of(const svo_view *v, svoi_ray_cache *c, svo_layout layout, uint32_t level, uint64_t at, uint32_t turn)
{
    spot s = {at, 0, turn};
    if (layout == SVO_LAYOUT_FAST && level + 1 == v->brick_level) {
        s.at = svoi_keep_block(&c->fast, v, at, turn);
        s.mask = c->fast.block[s.at].mask;
    } else if (layout == SVO_LAYOUT_FAST) {
        s.at = svoi_keep_node(&c->fast, v, level, at, turn);
        s.mask = c->fast.node[s.at].mask;
    } else if (layout == SVO_LAYOUT_BEST && !v->best->solid) s.mask = svoi_turn_mask(turn, (uint32_t)(at >> 56));
    else if (layout == SVO_LAYOUT_BEST) s.mask = svo_view_best_mask(v, (svo_view_node){.at = at, .symmetry = turn});
    else s.mask = v->levels[level].words[at];
    return s;
}

INLINE uint64_t spot_child(const svo_view *v, svoi_ray_cache *c, svo_layout layout, uint32_t level, spot s, uint32_t octant, uint32_t *turn)
{
    if (layout == SVO_LAYOUT_FAST)
        return level + 1 == v->brick_level ? svoi_kept_brick(&c->fast, v, (uint32_t)s.at, octant)
                                           : svoi_kept_child(&c->fast, v, level, (uint32_t)s.at, octant, turn);
    if (layout == SVO_LAYOUT_BEST) {
        uint32_t stored = svoi_turn_octant(svoi_turn_inverse(s.turn), octant), change;
        if (level + 1 == v->brick_level) {
            const svoi_best_block *b = cached_block(c, v->best, s.at);
            return svoi_turn_brick(svoi_turn_after(s.turn, b->turn[stored]), b->bits[stored]);
        }
        uint64_t child = cached_child(c, v->best, level, s.at, stored, &change);
        *turn = svoi_turn_after(s.turn, change);
        return child;
    }
    uint32_t stored = s.mask & ~(s.mask >> 8) & ((1u << octant) - 1);
    uint32_t child = v->levels[level].words[s.at + 1 + (uint32_t)__builtin_popcount(stored)];
    return level + 1 == v->brick_level ? v->bricks[child] : child;
}

/* Inside a full leaf the cells are all there: the first node met is the one that holds the ray at t. */
static void walk_full(const svo_view *v, const line *l, bool lod, int32_t size, double t, place *found)
{
    while (size > 1 && !(lod && size <= (int32_t)1 << v->depth && small_enough(l, size, t))) {
        size >>= 1;
        found->tree_level++;
        for (int k = 0; k < 3; k++) {
            bool further = plane(l, k, found->corner[k] + size) <= t;
            if (further != (l->negative >> k & 1)) found->corner[k] += size;
        }
    }
}

/* First node met. `lod` and `layout` are constants of the callers. */
INLINE bool trace(const svo_view *v, svoi_ray_cache *c, const line *l, bool lod, svo_layout layout, place *found)
{
    const uint32_t tree_depth = v->tree_depth, brick_level = v->brick_level;
    const bool stop_brick = v->depth >= 2, stop_octant = v->depth >= 1; /* levels above the root of a small octree are virtual */
    const uint32_t negative = l->negative;
    const double ox = l->o[0], oy = l->o[1], oz = l->o[2], ix = l->inv[0], iy = l->inv[1], iz = l->inv[2];
    spot stack[SVO_MAX_DEPTH], node = {0, 0, 0};
    uint32_t level = 0, octant = 0; /* the node, and the child that is the current cell */
    int32_t size = (int32_t)1 << tree_depth, p[3] = {0, 0, 0};
    double out[3]; /* far planes of the cell */
    for (int k = 0; k < 3; k++) out[k] = far_plane(l, k, 0, size);
    double enter = cell_enter(l, p, size), t = enter > l->t_min ? enter : l->t_min;
    if (!(t < least(out[0], out[1], out[2]) && t <= l->t_max)) return false;
    bool filled = true; /* the root fills its cell */
    svo_view_node root = svo_view_root(v);
    uint64_t child = brick_level == 0 ? svo_view_brick(v, root) : root.at;
    uint32_t child_level = 0, turn = root.symmetry;

    for (;;) {
        if (filled) {
            if (lod && child_level <= brick_level && (child_level < brick_level || stop_brick) && small_enough(l, size, t) &&
                t < least(out[0], out[1], out[2])) {
                found->tree_level = child_level;
                memcpy(found->corner, p, sizeof p);
                return true;
            }
            if (child_level != 0 && (node.mask >> 8 >> octant & 1) != 0) {
                if (t < least(out[0], out[1], out[2])) {
                    found->tree_level = child_level;
                    memcpy(found->corner, p, sizeof p);
                    walk_full(v, l, lod, size, t, found);
                    return true;
                }
            } else if (child_level == brick_level) {
                uint64_t brick = child;
                uint32_t bit;
                if (lod && stop_octant && small_enough(l, 2, least(out[0], out[1], out[2]))) {
                    if (walk_brick_lod(l, brick, p, t, out, brick_level, found)) return true;
                } else if (walk_brick(l, brick, p, t, out, &bit)) {
                    found->tree_level = tree_depth;
                    found->corner[0] = p[0] + (int32_t)((bit & 1) | (bit >> 2 & 2));
                    found->corner[1] = p[1] + (int32_t)((bit >> 1 & 1) | (bit >> 3 & 2));
                    found->corner[2] = p[2] + (int32_t)((bit >> 2 & 1) | (bit >> 4 & 2));
                    return true;
                }
                if (brick_level == 0) return false;
            } else {
                /* go down: the child that holds the ray at t */
                if (child_level != 0) stack[level] = node;
                level = child_level;
                node = spot_of(v, c, layout, level, child, turn);
                size >>= 1;
                double cx = ((double)(p[0] + size) - ox) * ix, cy = ((double)(p[1] + size) - oy) * iy,
                       cz = ((double)(p[2] + size) - oz) * iz;
                bool bx = cx <= t, by = cy <= t, bz = cz <= t;
                octant = ((uint32_t)bx | (uint32_t)by << 1 | (uint32_t)bz << 2) ^ negative;
                out[0] = bx ? out[0] : cx, out[1] = by ? out[1] : cy, out[2] = bz ? out[2] : cz;
                p[0] += octant & 1 ? size : 0, p[1] += octant & 2 ? size : 0, p[2] += octant & 4 ? size : 0;
                goto look;
            }
        }
        /* leave the cell through its nearest far planes */
        t = least(out[0], out[1], out[2]);
        if (!(t <= l->t_max)) return false;
        uint32_t change = 0;
        for (int k = 0; k < 3; k++) {
            int32_t to = p[k] + (out[k] <= t ? (negative >> k & 1 ? -size : size) : 0);
            change |= (uint32_t)(to ^ p[k]);
            p[k] = to;
        }
        /* the highest bit that changed names the common ancestor */
        uint32_t top = 31 - (uint32_t)__builtin_clz(change);
        if (top >= tree_depth) return false;
        int32_t cell = (int32_t)1 << top;
        if (cell != size) {
            size = cell;
            level = tree_depth - 1 - top;
            node = stack[level];
            for (int k = 0; k < 3; k++) p[k] &= -size;
        }
        octant = ((uint32_t)p[0] >> top & 1) | ((uint32_t)p[1] >> top & 1) << 1 | ((uint32_t)p[2] >> top & 1) << 2;
        for (int k = 0; k < 3; k++) out[k] = far_plane(l, k, p[k], size);
    look:;
        filled = node.mask >> octant & 1;
        child_level = level + 1;
        if (filled && !(node.mask >> 8 >> octant & 1)) child = spot_child(v, c, layout, level, node, octant, &turn);
    }
}

static bool find(const svo_view *v, svoi_ray_cache *c, const svo_ray *ray, line *l, place *found)
{
    if (!make_line(v, ray, l)) return false;
    bool lod = l->spread > 0 || l->offset > 0;
    if (v->layout == SVO_LAYOUT_FAST && !c->fast.ready) svoi_kept_clear(&c->fast);
    if (v->layout == SVO_LAYOUT_FAST) return lod ? trace(v, c, l, true, SVO_LAYOUT_FAST, found) : trace(v, c, l, false, SVO_LAYOUT_FAST, found);
    if (v->layout == SVO_LAYOUT_BEST) return lod ? trace(v, c, l, true, SVO_LAYOUT_BEST, found) : trace(v, c, l, false, SVO_LAYOUT_BEST, found);
    return lod ? trace(v, c, l, true, SVO_LAYOUT_PLAIN, found) : trace(v, c, l, false, SVO_LAYOUT_PLAIN, found);
}

bool svoi_ray_blocked(const svo_view *view, svoi_ray_cache *cache, const svo_ray *ray)
{
    line l;
    place found;
    return find(view, cache, ray, &l, &found);
}

bool svo_ray_blocked(const svo_view *view, const svo_ray *ray)
{
    svoi_ray_cache cache;
    svoi_ray_cache_init(&cache, 1);
    return svoi_ray_blocked(view, &cache, ray);
}

/* Node of level min(tree_level, brick_level) that holds a place of layout fast, which a ray has just met. */
static svo_view_node fast_node_at(const svo_view *v, svoi_kept *k, const place *at)
{
    svo_view_node node = svo_view_root(v);
    uint32_t bit = v->tree_depth - 1;
    uint32_t x = (uint32_t)at->corner[0], y = (uint32_t)at->corner[1], z = (uint32_t)at->corner[2];
    for (uint32_t level = 0; level < v->brick_level && level < at->tree_level; level++, bit--) {
        uint32_t octant = (x >> bit & 1) | (y >> bit & 1) << 1 | (z >> bit & 1) << 2, slot;
        if (level + 1 == v->brick_level) {
            slot = svoi_keep_block(k, v, node.at, node.symmetry);
            node.attribute += svoi_kept_block_before(k, v, slot, octant);
            node.full = k->block[slot].mask >> 8 >> octant & 1;
            if (!node.full) node.at = svoi_kept_brick(k, v, slot, octant);
        } else {
            slot = svoi_keep_node(k, v, level, node.at, node.symmetry);
            node.attribute += svoi_kept_before(k, v, level, slot, octant);
            node.full = k->node[slot].mask >> 8 >> octant & 1;
            if (!node.full) node.at = svoi_kept_child(k, v, level, slot, octant, &node.symmetry);
        }
        if (node.full) break;
    }
    return node;
}

/* Attribute index of a node that is known to exist. */
uint64_t svoi_ray_attribute(const svo_view *v, svoi_ray_cache *c, const place *at)
{
    if (v->unnumbered) return 0;
    if (v->layout == SVO_LAYOUT_FAST && !c->fast.ready) svoi_kept_clear(&c->fast);
    if (v->layout == SVO_LAYOUT_BEST && at->tree_level == v->tree_depth) {
        uint64_t index = 0;
        svo_view_best_voxel(v, (uint32_t)at->corner[0], (uint32_t)at->corner[1], (uint32_t)at->corner[2], &index);
        return index;
    }
    svo_view_node node = svo_view_root(v);
    uint32_t x = (uint32_t)at->corner[0], y = (uint32_t)at->corner[1], z = (uint32_t)at->corner[2];
    if (v->layout == SVO_LAYOUT_FAST) node = fast_node_at(v, &c->fast, at);
    else {
        uint32_t bit = v->tree_depth - 1, level = 0;
        for (; level < v->brick_level && level < at->tree_level; level++, bit--)
            node = svo_view_child(v, level, node, (x >> bit & 1) | (y >> bit & 1) << 1 | (z >> bit & 1) << 2);
    }
    if (at->tree_level <= v->brick_level) return svo_view_node_attribute(v, at->tree_level, node);
    uint64_t brick = svo_view_brick(v, node);
    uint32_t a = (x >> 1 & 1) | (y >> 1 & 1) << 1 | (z >> 1 & 1) << 2, b = (x & 1) | (y & 1) << 1 | (z & 1) << 2;
    if (at->tree_level == v->tree_depth) return svo_view_brick_voxel(v, node, brick, 8 * a + b);
    return svo_view_brick_octant(v, node, brick, a);
}

void svo_raycast(const svo_view *view, const svo_ray *rays, uint32_t count, svo_hit *hits)
{
    svoi_ray_cache cache;
    svoi_ray_cache_init(&cache, count);
    svoi_raycast(view, &cache, rays, count, hits);
}

void svoi_raycast(const svo_view *view, svoi_ray_cache *cache, const svo_ray *rays, uint32_t count, svo_hit *hits)
{
    for (uint32_t i = 0; i < count; i++) {
        line l;
        place at;
        svo_hit *hit = &hits[i];
        memset(hit, 0, sizeof *hit);
        if (!find(view, cache, &rays[i], &l, &at)) continue;
        uint32_t above = view->tree_depth - at.tree_level;
        int32_t size = (int32_t)1 << above;
        double enter = -INFINITY;
        uint32_t face = 0;
        for (uint32_t k = 0; k < 3; k++) {
            double t = near_plane(&l, (int)k, at.corner[k], size);
            if (t > enter) enter = t, face = 2 * k + (l.negative >> k & 1);
            hit->cell[k] = (uint32_t)at.corner[k] >> above;
        }
        if (enter < l.t_min) enter = l.t_min, face = SVO_FACE_INSIDE;
        hit->hit = true;
        hit->t = (enter + l.base) * l.unit;
        hit->face = (uint8_t)face;
        hit->level = (uint8_t)(view->depth - above);
        hit->attribute = svoi_ray_attribute(view, cache, &at);
    }
}

bool svo_ray_node(const svo_view *view, const svo_ray *ray, uint32_t level, const uint32_t cell[3], double *enter, double *leave)
{
    line l;
    if (!make_line(view, ray, &l)) return false;
    int32_t size = (int32_t)1 << (view->depth - level), corner[3];
    for (int k = 0; k < 3; k++) corner[k] = (int32_t)cell[k] * size;
    double in = cell_enter(&l, corner, size);
    double out = least(far_plane(&l, 0, corner[0], size), far_plane(&l, 1, corner[1], size), far_plane(&l, 2, corner[2], size));
    *enter = (in + l.base) * l.unit;
    *leave = (out + l.base) * l.unit;
    return in < out;
}
