/* Internal to libsvo: rays that go the same way, traced together. Not installed. Included by one file for each kind of processor
 * (svo_rays_beam*.c), after svoi_wide_*.h, which says what 16 doubles are there.
 *
 * A packet of up to 64 rays has one beam around it: a pyramid along the axis of their largest component, bounded by two straight
 * lines on each of the other two axes. The lines join the extremes of all rays at both ends of the packet's way; between the ends the
 * least position of straight rays is concave and the largest convex, so the lines are outside of all of them. A node of 4x4x4 cells is
 * compared with the beam at once: which cells it touches is a mask of 64 bits, and what it has in common with the node's own mask is
 * visited, nearest first. So the way down is shared by all rays, and empty space costs nothing but nodes that the beam
 * touches. It ends where cells become narrower than the beam, or small enough for some ray to stop at: there each ray is
 * on its own, from the first non-empty cell that it meets.
 *
 * Beams are a little too wide, which costs time and nothing else: rays are tested against a cell with the same doubles, in the same order of operations, as
 * svo_raycast does it. All rays of a packet have the same signs, so cells are met in one order (ascending in all mirrored coordinates), and
 * the first cell of which a ray meets the interval is its nearest. */
#ifndef SVOI_RAYS_BEAM_H
#define SVOI_RAYS_BEAM_H

#include <math.h>
#include <string.h>

enum {
    GROUPS = SVOI_RAYS_PACKET / 16,
    MARGIN = 2048, /* units: more than floats round */
    /* Measured (bench_rays): */
    WIDE = 2,     /* rays part where the packet is wider than so many cells; */
    WIDE_ANY = 4, /* those of which is asked only whether they hit, than so many */
    NARROW = 2 /* a packet of at most so many finest voxels stays together in bricks */
};
#define WIDEST 0.125 /* a packet is not made when it is wider than this part of the root */

INLINE double least(double a, double b) { return a < b ? a : b; }
INLINE double most(double a, double b) { return a > b ? a : b; }

/* Extremes of some rays at the two ends of a packet's way. */
typedef struct ends { double v[2][2], w[2][2]; /* [end][low, high] */ } ends;

/* A beam as `touch` wants it: per axis low bounds of the four layers of cells across the way, then high ones. */
typedef struct beam {
    _Alignas(32) float offset[2][8], slope[2][8], layer[2][8];
    /* The four lines as `beside` wants them: low and high of v, then of w, high ones with the other sign. */
    _Alignas(16) float line_offset[4], line_slope[4];
} beam;

typedef struct way {
    uint32_t axis[3]; /* the packet's main axis, then the two others */
    double from, to;  /* along the main axis */
    int32_t low, high; /* the same, ascending, rounded outwards */
    double limit, limit_slope; /* level of detail: largest limit of any ray at `from`, and its growth */
    double width, width_slope; /* of the beam, likewise */
    uint64_t layers[4]; /* cells of the layers of the main axis */
    const uint64_t *below[3]; /* by axis of `axis`: cells whose coordinate is less than i */
    uint32_t flip;  /* of cell numbers, to the order of the rays */
    uint8_t negative; /* bit k: direction[k] < 0 */
    /* Where `beside` finds the sides of a box: high and low of v, of w, then low and high of u; their fields in a node's box, and the axes. */
    _Alignas(32) int32_t box_field[8], box_axis[8];
} way;

/* Cells of a node of 4x4x4 whose coordinate on an axis is below 0 .. 4. */
static const uint64_t below[3][8] = {
    {0, 0x1111111111111111u, 0x3333333333333333u, 0x7777777777777777u, ~(uint64_t)0, ~(uint64_t)0, ~(uint64_t)0, ~(uint64_t)0},
    {0, 0x000f000f000f000fu, 0x00ff00ff00ff00ffu, 0x0fff0fff0fff0fffu, ~(uint64_t)0, ~(uint64_t)0, ~(uint64_t)0, ~(uint64_t)0},
    {0, 0x000000000000ffffu, 0x00000000ffffffffu, 0x0000ffffffffffffu, ~(uint64_t)0, ~(uint64_t)0, ~(uint64_t)0, ~(uint64_t)0}};

static void make_beam(const way *y, const ends *e, beam *b)
{
    double length = y->to - y->from;
    for (int k = 0; k < 2; k++)
        for (int side = 0; side < 2; side++) {
            double a = k == 0 ? e->v[0][side] : e->w[0][side], z = k == 0 ? e->v[1][side] : e->w[1][side];
            double slope = length != 0 ? (z - a) / length : 0;
            if (length == 0 && (side == 0 ? z < a : z > a)) a = z;
            double offset = a - slope * y->from + (side == 0 ? -MARGIN : MARGIN);
            bool far = side == 0 ? slope < 0 : slope > 0; /* which end of a layer has the extreme */
            for (int i = 0; i < 4; i++) {
                b->offset[k][4 * side + i] = (float)offset;
                b->slope[k][4 * side + i] = (float)slope;
                b->layer[k][4 * side + i] = (float)slope * (float)(i + far) + (float)side; /* cells below high + 1 */
            }
            b->line_offset[2 * k + side] = (float)(side == 0 ? offset : -offset);
            b->line_slope[2 * k + side] = (float)(side == 0 ? slope : -slope);
        }
}

INLINE int32_t clamp4(int32_t x) { return x < 0 ? 0 : x > 4 ? 4 : x; }

/* Cells of the node at `corner` that the beam may touch; cells have an edge of 2^s. */
INLINE uint64_t touched(const way *y, const beam *b, const int32_t corner[3], uint32_t s)
{
    int32_t u = corner[y->axis[0]];
    uint64_t along = y->below[0][clamp4(((y->high - u) >> s) + 1)] & ~y->below[0][clamp4((y->low - u) >> s)];
    return along & touch(y->below[1], y->below[2], y->layers, b->offset[0], b->slope[0], b->layer[0], (float)u, (float)corner[y->axis[1]], (float)corner[y->axis[2]],
                         (float)(1.0 / (double)((uint32_t)1 << s)));
}

/* Does the beam miss the box of what is in a node at `corner` with edge 2^s? */
INLINE bool beside(const way *y, const beam *b, uint32_t box, const int32_t corner[3], uint32_t s)
{
    const __m256i further = _mm256_setr_epi32(1, 0, 1, 0, 0, 1, 0, 0); /* high sides are inclusive */
    __m256i at = _mm256_permutevar8x32_epi32(_mm256_castsi128_si256(_mm_setr_epi32(corner[0], corner[1], corner[2], 0)), _mm256_load_si256((const __m256i *)y->box_axis));
    __m256i side = _mm256_and_si256(_mm256_srlv_epi32(_mm256_set1_epi32((int32_t)box), _mm256_load_si256((const __m256i *)y->box_field)), _mm256_set1_epi32(15));
    __m256 sides = _mm256_cvtepi32_ps(_mm256_add_epi32(at, _mm256_sll_epi32(_mm256_add_epi32(side, further), _mm_cvtsi32_si128((int)s - 4))));
    __m128 across = _mm_xor_ps(_mm256_castps256_ps128(sides), _mm_setr_ps(0, -0.0f, 0, -0.0f)), along = _mm256_extractf128_ps(sides, 1);
    __m128 first = _mm_max_ps(_mm_shuffle_ps(along, along, 0x00), _mm_set1_ps((float)y->low)), last = _mm_min_ps(_mm_shuffle_ps(along, along, 0x55), _mm_set1_ps((float)y->high));
    __m128 slope = _mm_load_ps(b->line_slope);
    __m128 least_line = _mm_fmadd_ps(slope, _mm_blendv_ps(first, last, slope), _mm_load_ps(b->line_offset));
    return _mm_movemask_ps(_mm_or_ps(_mm_cmpgt_ps(least_line, across), _mm_cmpgt_ps(first, last))) != 0;
}

INLINE uint64_t swap_bits(uint64_t m, uint64_t lower, unsigned by) { return (m >> by & lower) | (m & lower) << by; }

/* The mask with cell c at c ^ flip. */
INLINE uint64_t mirrored(uint64_t m, uint32_t flip)
{
    if (flip & 3) m = swap_bits(swap_bits(m, 0x5555555555555555u, 1), 0x3333333333333333u, 2);
    if (flip & 12) m = swap_bits(swap_bits(m, 0x0f0f0f0f0f0f0f0fu, 4), 0x00ff00ff00ff00ffu, 8);
    if (flip & 48) m = swap_bits(swap_bits(m, 0x0000ffff0000ffffu, 16), 0x00000000ffffffffu, 32);
    return m;
}

/* ---- making packets ---------------------------------------------------------------------------------------------------- */

typedef struct packet {
    const svo_rays *r;
    svoi_ray_batch *b;
    uint32_t first, count, groups; /* rays of the batch, and in 16s */
    uint32_t active[GROUPS];       /* rays that have not met anything */
    way y;
    ends ends[GROUPS];
    beam beam, group[GROUPS];
    bool ready[GROUPS]; /* group[g] is made */
} packet;

/* A beam around all active rays, and its width. */
static void join(packet *p)
{
    way *y = &p->y;
    ends e;
    bool any = false;
    for (uint32_t g = 0; g < p->groups; g++) {
        if (p->active[g] == 0) continue;
        const ends *f = &p->ends[g];
        if (!any) e = *f;
        for (int i = 0; i < 2; i++) {
            e.v[i][0] = least(e.v[i][0], f->v[i][0]), e.v[i][1] = most(e.v[i][1], f->v[i][1]);
            e.w[i][0] = least(e.w[i][0], f->w[i][0]), e.w[i][1] = most(e.w[i][1], f->w[i][1]);
        }
        any = true;
    }
    if (!any) return;
    double a = most(e.v[0][1] - e.v[0][0], e.w[0][1] - e.w[0][0]), z = most(e.v[1][1] - e.v[1][0], e.w[1][1] - e.w[1][0]), length = fabs(y->to - y->from);
    y->width = a;
    y->width_slope = length > 0 ? (z - a) / length : 0;
    make_beam(y, &e, &p->beam);
}

/* Rays first .. first + count of a batch as a packet; false if they do not go the same way. */
static bool make_packet(packet *p, const svo_rays *r, bool lod, svoi_ray_batch *b, uint32_t first, uint32_t count)
{
    way *y = &p->y;
    p->r = r, p->b = b, p->first = first, p->count = count;
    p->groups = (count + 15) / 16;
    /* the rays after the last are copies of it, so that extremes need no masks */
    for (uint32_t i = first + count; i < first + 16 * p->groups; i++) {
        uint32_t last = first + count - 1;
        for (int k = 0; k < 3; k++) b->in.o[k][i] = b->in.o[k][last], b->in.d[k][i] = b->in.d[k][last], b->in.inv[k][i] = b->in.inv[k][last];
        b->in.t[i] = b->in.t[last], b->in.t_max[i] = b->in.t_max[last];
        if (lod) b->in.spread[i] = b->in.spread[last], b->in.offset[i] = b->in.offset[last];
    }
    y->negative = 0, y->flip = 0;
    double size[3];
    for (int k = 0; k < 3; k++) {
        bool negative = b->in.d[k][first] < 0;
        y->negative |= (uint8_t)(negative << k);
        y->flip |= negative ? 3u << 2 * k : 0;
        size[k] = fabs(b->in.d[k][first]);
        for (uint32_t g = 0; g < p->groups; g++)
            if (wide_signs(wide_load(&b->in.d[k][first + 16 * g])) != (negative ? 0xffffu : 0)) return false;
    }
    uint32_t u = size[0] >= size[1] ? (size[0] >= size[2] ? 0 : 2) : size[1] >= size[2] ? 1 : 2, v = u == 0 ? 1 : 0, w = u == 2 ? 1 : 2;
    y->axis[0] = u, y->axis[1] = v, y->axis[2] = w;
    const bool back = y->negative >> u & 1;
    const int32_t *side = back ? (lod ? r->root_low : r->low) : (lod ? r->root_high : r->high);
    wide start = wide_set(0), end = start, steep = start;
    for (uint32_t g = 0; g < p->groups; g++) {
        uint32_t i = first + 16 * g;
        wide o = wide_load(&b->in.o[u][i]), d = wide_load(&b->in.d[u][i]);
        wide a = wide_add(o, wide_mul(d, wide_load(&b->in.t[i]))), z = wide_add(o, wide_mul(d, wide_load(&b->in.t_max[i])));
        start = g == 0 ? a : back ? wide_max(start, a) : wide_min(start, a);
        end = g == 0 ? z : back ? wide_min(end, z) : wide_max(end, z);
        wide across = wide_max(wide_abs(wide_load(&b->in.d[v][i])), wide_abs(wide_load(&b->in.d[w][i])));
        steep = wide_max(steep, wide_mul(across, wide_abs(wide_load(&b->in.inv[u][i]))));
    }
    if (!(wide_most(steep) <= 4)) return false;
    y->from = back ? wide_most(start) : wide_least(start);
    y->to = back ? most(wide_least(end), side[u]) : least(wide_most(end), side[u]);
    if (!(back ? y->to <= y->from : y->from <= y->to)) y->to = y->from;
    y->low = (int32_t)most(least(y->from, y->to), 0) - 1, y->high = (int32_t)least(most(y->from, y->to), 0x1p30) + 1;
    wide limit[2] = {wide_set(0), wide_set(0)};
    for (uint32_t g = 0; g < p->groups; g++) {
        uint32_t i = first + 16 * g;
        wide ou = wide_load(&b->in.o[u][i]), inv = wide_load(&b->in.inv[u][i]);
        wide ov = wide_load(&b->in.o[v][i]), dv = wide_load(&b->in.d[v][i]), ow = wide_load(&b->in.o[w][i]), dw = wide_load(&b->in.d[w][i]);
        for (int k = 0; k < 2; k++) {
            wide t = wide_mul(wide_sub(wide_set(k == 0 ? y->from : y->to), ou), inv);
            wide at_v = wide_add(ov, wide_mul(dv, t)), at_w = wide_add(ow, wide_mul(dw, t));
            p->ends[g].v[k][0] = wide_least(at_v), p->ends[g].v[k][1] = wide_most(at_v);
            p->ends[g].w[k][0] = wide_least(at_w), p->ends[g].w[k][1] = wide_most(at_w);
            if (lod) limit[k] = wide_max(limit[k], wide_add(wide_mul(wide_load(&b->in.spread[i]), t), wide_load(&b->in.offset[i])));
        }
        uint32_t rest = count - 16 * g;
        p->active[g] = rest >= 16 ? 0xffff : (1u << rest) - 1;
        p->ready[g] = false;
    }
    join(p);
    if (!(least(y->width, y->width + y->width_slope * fabs(y->to - y->from)) <= WIDEST * 0x1p30)) return false;
    if (lod) {
        double a = wide_most(limit[0]), z = wide_most(limit[1]), length = fabs(y->to - y->from);
        y->limit = most(a, 0);
        y->limit_slope = length > 0 ? most(0, z - a) / length : 0;
        if (length == 0) y->limit = most(y->limit, z);
    }
    for (uint32_t i = 0; i < 3; i++) y->below[i] = below[y->axis[i]];
    static const uint8_t order[8] = {1, 1, 2, 2, 0, 0, 0, 0}, high[8] = {1, 0, 1, 0, 0, 1, 0, 0};
    for (uint32_t i = 0; i < 8; i++) y->box_axis[i] = (int32_t)y->axis[order[i]], y->box_field[i] = 4 * y->box_axis[i] + 12 * high[i];
    for (uint32_t i = 0; i < 4; i++) y->layers[i] = y->below[0][i + 1] & ~y->below[0][i];
    return true;
}

/* ---- traversal --------------------------------------------------------------------------------------------------------- */

typedef struct frame {
    uint64_t cells; /* in the order of the rays: still to be visited */
    uint64_t mask;
    uint32_t unit, child; /* the node's, and that of its first child */
    uint32_t base;        /* number of its attribute, where numbers are wanted */
    int32_t corner[3];
} frame;

/* From where the rays leave a node; before where they enter it. */
INLINE double far_side(const way *y, const int32_t corner[3], uint32_t s)
{
    double u = corner[y->axis[0]];
    double far = y->negative >> y->axis[0] & 1 ? least(y->from, most(y->to, u)) : most(y->from, least(y->to, u + (double)((uint32_t)1 << s)));
    return fabs(far - y->from);
}

INLINE void corner_of(const int32_t corner[3], uint32_t cell, uint32_t s, int32_t out[3])
{
    out[0] = corner[0] + (int32_t)((cell & 3) << s);
    out[1] = corner[1] + (int32_t)((cell >> 2 & 3) << s);
    out[2] = corner[2] + (int32_t)((cell >> 4) << s);
}

INLINE void enter_node(packet *p, frame *f, uint32_t unit, const int32_t corner[3], uint32_t s)
{
    const uint64_t *node = p->r->units + unit;
    f->mask = node[0];
    f->child = (uint32_t)node[1];
    f->unit = unit;
    f->base = p->b->numbers && f->unit != 0 ? f[-1].base + (p->r->before[unit] >> 1) : 0;
    memcpy(f->corner, corner, sizeof f->corner);
    f->cells = mirrored(touched(&p->y, &p->beam, corner, s) & f->mask, p->y.flip);
}

/* Box of what is in the node at `unit`, or the brick, at `corner` with edge 2^s. */
INLINE void content_box(const svo_rays *r, uint32_t unit, const int32_t corner[3], uint32_t s, int32_t low[3], int32_t high[3])
{
    if (s > r->fraction + 2) {
        const uint32_t box = (uint32_t)(r->units[unit + 1] >> 32);
        for (int k = 0; k < 3; k++) {
            low[k] = corner[k] + (int32_t)((box >> 4 * k & 15) << (s - 4));
            high[k] = corner[k] + (int32_t)(((box >> (4 * k + 12) & 15) + 1) << (s - 4));
        }
        return;
    }
    const uint64_t brick = r->units[unit];
    uint64_t rows = brick | brick >> 32, x = rows | rows >> 16;
    uint32_t z = (uint32_t)((brick & 0xffff) != 0) | (uint32_t)((brick & 0xffff0000) != 0) << 1 | (uint32_t)((brick >> 32 & 0xffff) != 0) << 2 | (uint32_t)(brick >> 48 != 0) << 3;
    uint32_t y = (uint32_t)((x & 0xf) != 0) | (uint32_t)((x & 0xf0) != 0) << 1 | (uint32_t)((x & 0xf00) != 0) << 2 | (uint32_t)((x & 0xf000) != 0) << 3;
    x |= x >> 8;
    const uint32_t layers[3] = {(uint32_t)(x | x >> 4) & 15, y, z};
    for (int k = 0; k < 3; k++) {
        low[k] = corner[k] + (int32_t)((uint32_t)__builtin_ctz(layers[k]) << r->fraction);
        high[k] = corner[k] + (int32_t)((uint32_t)(32 - __builtin_clz(layers[k])) << r->fraction);
    }
}

/* Has the box of what is in the node or brick no empty voxel, as far as that is known? Then a ray hits where it enters the box. */
INLINE bool is_solid(const svo_rays *r, uint32_t unit, uint32_t s, const int32_t low[3], const int32_t high[3])
{
    if (s == r->fraction + 4) return r->units[unit + 1] >> 32 & SVOI_RAYS_SOLID;
    const uint32_t sides = (uint32_t)((high[0] - low[0]) >> r->fraction) * (uint32_t)((high[1] - low[1]) >> r->fraction) * (uint32_t)((high[2] - low[2]) >> r->fraction);
    return s == r->fraction + 2 && (uint32_t)__builtin_popcountll(r->units[unit]) == sides;
}

/* The rays `met` of the 16 from `i` on are blocked. */
INLINE void keep_blocked(svoi_ray_batch *b, uint32_t i, uint32_t met)
{
    for (; met != 0; met &= met - 1) {
        const uint32_t ray = (uint32_t)b->in.ray[i + (uint32_t)__builtin_ctz(met)];
        b->blocked[ray / 8] |= (uint8_t)(1u << ray % 8);
    }
}

/* The rays `met` of the 16 from `i` on hit what is in the node or brick at `unit` with edge 2^s, a child of `f`, where they enter its box. */
INLINE void keep_entered(packet *p, uint32_t i, uint32_t met, wide in, const wide plane[3], const int32_t side[3], uint32_t s, uint32_t unit, const frame *f)
{
    const svo_rays *r = p->r;
    svoi_ray_batch *b = p->b;
    uint32_t from = b->found;
    find_rays(b, i, met, in, plane, side, (int32_t)r->fraction, p->y.negative);
    if (!b->numbers) return;
    const uint32_t above = f->base + (r->before[unit] >> 1);
    for (; from < b->found; from++) {
        uint32_t brick = unit, base = above;
        if (b->state[from] == SVOI_RAY_DOUBT) continue;
        if (s == r->fraction + 4) {
            const uint32_t shift = r->fraction + 2, x = (uint32_t)b->at[0][from] >> shift & 3, y = (uint32_t)b->at[1][from] >> shift & 3, z = (uint32_t)b->at[2][from] >> shift & 3;
            brick = (uint32_t)r->units[unit + 1] + (uint32_t)__builtin_popcountll(r->units[unit] & (((uint64_t)1 << (x | y << 2 | z << 4)) - 1));
            base += r->before[brick] >> 1;
        }
        b->node_found[from] = (int32_t)brick, b->base[from] = (int32_t)base;
    }
}

/* Rays that meet what is in the node or brick at `corner` with edge 2^s go on alone from there. With `any`, it is asked only whether they hit: they are to be
 * traced from there to where they leave it, and stay in the packet. What has no voxels for a ray costs it nothing this way: neither the way down to where it
 * begins nor the empty space beyond. True if no ray is left. */
INLINE bool set_out(packet *p, bool lod, bool any, const frame *stack, const frame *f, const int32_t corner[3], uint32_t s, uint32_t unit)
{
    svoi_ray_batch *b = p->b;
    int32_t low[3], high[3];
    uint32_t before = 0, after = 0;
    bool solid = false;
    if (lod) /* nodes that are small enough count as full */
        for (int k = 0; k < 3; k++) low[k] = corner[k], high[k] = corner[k] + (int32_t)((uint32_t)1 << s);
    else {
        content_box(p->r, unit, corner, s, low, high);
        solid = is_solid(p->r, unit, s, low, high);
    }
    for (uint32_t g = 0; g < p->groups; g++) {
        if (p->active[g] == 0) continue;
        before++;
        uint32_t i = p->first + 16 * g;
        wide in = wide_load(&b->in.t[i]), out = wide_set(INFINITY), plane[3], t_max = wide_load(&b->in.t_max[i]);
        int32_t side[3];
        for (int k = 0; k < 3; k++) {
            const bool back = p->y.negative >> k & 1;
            wide o = wide_load(&b->in.o[k][i]), inv = wide_load(&b->in.inv[k][i]);
            plane[k] = wide_mul(wide_sub(wide_set(back ? high[k] : low[k]), o), inv);
            side[k] = back ? high[k] - 1 : low[k];
            in = wide_max(plane[k], in);
            out = wide_min(wide_mul(wide_sub(wide_set(back ? low[k] : high[k]), o), inv), out);
        }
        uint32_t met = wide_less(in, out) & wide_at_most(in, t_max) & p->active[g];
        if (met != 0 && solid) {
            if (any) keep_blocked(b, i, met);
            else keep_entered(p, i, met, in, plane, side, s, unit, f);
            p->active[g] &= ~met;
        } else if (met != 0) {
            if (any) t_max = wide_min(t_max, wide_before(out)); /* hits in the box are before `out` */
            uint32_t to = b->starts;
            start_rays(b, lod, i, met, in, t_max, plane, side, (1 << p->r->fraction) - 1);
            for (uint32_t k = 0; k < SVOI_RAYS_LEVELS && !any; k++) {
                if (p->r->fraction + 2 * k < s || k >= p->r->levels) continue;
                uint32_t above = p->r->levels - 1 - k; /* frame of that level */
                for (uint32_t j = to; j < b->starts; j += 16) wide_fill(&b->stack[k][j], (int32_t)stack[above].unit);
            }
            for (uint32_t j = to; j < b->starts; j += 16) wide_fill(&b->s[j], (int32_t)s - 2), wide_fill(&b->node[j], (int32_t)unit);
            if (!any) p->active[g] &= ~met;
        }
        after += p->active[g] != 0;
    }
    if (after != 0 && after != before) join(p);
    return after == 0;
}

/* Trace what has been put aside; rays that are blocked, or must be looked at by svo_raycast, leave the packet. True if none is left. */
static bool settle(packet *p, bool lod)
{
    svoi_ray_batch *b = p->b;
    uint32_t left = 0;
    svoi_rays_settle(p->r, lod, b);
    for (uint32_t g = 0; g < p->groups; g++) {
        for (uint32_t rest = p->active[g]; rest != 0; rest &= rest - 1) {
            uint32_t lane = (uint32_t)__builtin_ctz(rest), ray = (uint32_t)b->in.ray[p->first + 16 * g + lane];
            if ((b->unsure[ray / 8] | b->blocked[ray / 8]) >> ray % 8 & 1) p->active[g] &= ~(1u << lane);
        }
        left |= p->active[g];
    }
    if (left != 0) join(p);
    return left == 0;
}

/* A narrow packet's rays against the voxels of the brick at `unit`, `above` being the number of its parent's attribute, 16 with a beam of their own at a time. True if no ray is left. */
static bool visit_brick(packet *p, uint32_t unit, uint32_t above, const int32_t corner[3])
{
    const uint64_t brick = p->r->units[unit];
    const uint32_t base = p->b->numbers ? above + (p->r->before[unit] >> 1) : 0;
    const uint32_t s = p->r->fraction;
    svoi_ray_batch *b = p->b;
    uint32_t before = 0, after = 0;
    const uint64_t full = mirrored(brick, p->y.flip);
    for (uint32_t g = 0; g < p->groups; g++) {
        if (p->active[g] == 0) continue;
        before++;
        if (!p->ready[g]) make_beam(&p->y, &p->ends[g], &p->group[g]), p->ready[g] = true;
        uint64_t cells = mirrored(touched(&p->y, &p->group[g], corner, s), p->y.flip) & full;
        uint32_t i = p->first + 16 * g;
        for (; cells != 0 && p->active[g] != 0; cells &= cells - 1) {
            int32_t at[3];
            corner_of(corner, (uint32_t)__builtin_ctzll(cells) ^ p->y.flip, s, at);
            wide in = wide_load(&b->in.t[i]), out = wide_set(INFINITY), plane[3];
            for (int k = 0; k < 3; k++) {
                int32_t size = (int32_t)1 << s, forward = p->y.negative >> k & 1 ? 0 : size;
                wide o = wide_load(&b->in.o[k][i]), inv = wide_load(&b->in.inv[k][i]);
                plane[k] = wide_mul(wide_sub(wide_set(at[k] + size - forward), o), inv);
                in = wide_max(plane[k], in);
                out = wide_min(wide_mul(wide_sub(wide_set(at[k] + forward), o), inv), out);
            }
            uint32_t hits = wide_less(in, out) & wide_at_most(in, wide_load(&b->in.t_max[i])) & p->active[g];
            if (hits == 0) continue;
            keep_found(b, i, hits, in, plane, p->y.negative, at, (int32_t)s + 1, (int32_t)unit, (int32_t)base);
            p->active[g] &= ~hits;
        }
        after += p->active[g] != 0;
    }
    if (after != 0 && after != before) join(p);
    return after == 0;
}

INLINE void traverse(packet *p, bool lod, bool any)
{
    const svo_rays *r = p->r;
    svoi_ray_batch *b = p->b;
    frame stack[SVOI_RAYS_LEVELS], *f = stack;
    uint32_t s = SVOI_RAYS_BITS - 2;
    enter_node(p, f, 0, (const int32_t[3]){0, 0, 0}, s);
    for (;;) {
        if (f->cells == 0) {
            if (f == stack) return;
            f--, s += 2;
            continue;
        }
        /* Whether something is in the way does not depend on the order. From the far end, rays to a light from inside of something meet its hull at once. */
        uint32_t next = any ? 63 - (uint32_t)__builtin_clzll(f->cells) : (uint32_t)__builtin_ctzll(f->cells), cell = next ^ p->y.flip;
        f->cells ^= (uint64_t)1 << next;
        int32_t at[3];
        corner_of(f->corner, cell, s, at);
        uint32_t rank = (uint32_t)__builtin_popcountll(f->mask & (((uint64_t)1 << cell) - 1));
        uint32_t child = f->child + (s == r->fraction + 2 ? rank : 2 * rank);
        double far = far_side(&p->y, at, s), narrow = (double)((uint32_t)1 << (s - 2));
        bool alone = s == r->fraction + 2 || p->y.width + p->y.width_slope * far > (any ? WIDE_ANY : WIDE) * narrow;
        if (lod) alone |= (p->y.limit + p->y.limit_slope * far) * 1.000001 + 1 >= narrow;
        if (!lod && s > r->fraction + 2 && beside(&p->y, &p->beam, (uint32_t)(r->units[child + 1] >> 32), at, s)) continue;
        const bool solid = !lod && s == r->fraction + 4 && (r->units[child + 1] >> 32 & SVOI_RAYS_SOLID);
        if (!alone && !solid) {
            s -= 2;
            f++;
            enter_node(p, f, child, at, s);
        } else if (s == r->fraction + 2 && p->y.width + p->y.width_slope * far <= NARROW * (double)((uint32_t)1 << r->fraction) &&
                   !(lod && (p->y.limit + p->y.limit_slope * far) * 1.000001 + 1 >= (double)((uint32_t)2 << r->fraction))) {
            if (visit_brick(p, child, f->base, at)) return;
        } else if (set_out(p, lod, any, stack, f, at, s, child)) return;
        if (any && b->starts + b->found + SVOI_RAYS_PACKET > SVOI_RAYS_BATCH && settle(p, lod)) return;
    }
}

/* Trace rays first .. first + count of the batch, at most SVOI_RAYS_PACKET; false, and nothing done, where they do not go the same way. */
static bool trace_packet(const svo_rays *r, bool lod, bool any, svoi_ray_batch *b, uint32_t first, uint32_t count)
{
    packet p;
    if (r->levels < 2 || !make_packet(&p, r, lod, b, first, count)) return false;
    /* a ray may stop at a cell of the root: nothing to share */
    if (lod && (p.y.limit + p.y.limit_slope * fabs(p.y.to - p.y.from)) * 1.000001 + 1 >= (double)((uint32_t)1 << (SVOI_RAYS_BITS - 2))) return false;
    if (any && lod) traverse(&p, true, true);
    else if (any) traverse(&p, false, true);
    else if (lod) traverse(&p, true, false);
    else traverse(&p, false, false);
    return true;
}

#endif
