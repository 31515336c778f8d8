/* 8 rays in one stream of instructions, for processors with AVX2: svo_rays_avx512.c with what is there. What those instructions lack is made of others: masks
 * are vectors, bits are counted by table, the highest bit comes from a float's exponent; and lanes are kept in memory, which 16
 * registers would not hold anyway. */
#include <math.h>
#include <string.h>

#include "svoi_rays.h"

#ifdef SVOI_HAVE_AVX2
#include <immintrin.h>

#define INLINE static inline __attribute__((always_inline))

bool svoi_rays_have_avx2(void) { return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("popcnt"); }

/* ---- traversal ---------------------------------------------------------------------------------------------------- */

/* Lanes are refilled when REFILL or fewer are left. Where rays begin it is worth a look how far they can hit anything while WORTH of 8 may find out. */
enum { LANES = 8, REFILL = 5, WORTH = 3 };

typedef struct pair { __m256d a, b; } pair; /* 8 doubles */

typedef struct group {
    _Alignas(32) double o[3][LANES], d[3][LANES], inv[3][LANES], t[LANES], t_max[LANES], spread[LANES], offset[LANES];
    _Alignas(32) int32_t q[3][LANES], s[LANES], node[LANES], ray[LANES], state[LANES], positive[3][LANES], backward[3][LANES], stack[SVOI_RAYS_LEVELS][LANES];
    _Alignas(32) float step[3][LANES];
    uint32_t active, finished; /* bit l: lane l */
    __m256i w, lower, block, bit, child, missed, live, down, out[3]; /* what the parts of a round hand on */
    pair leaves[3], nearest;
} group;

INLINE __m256i words(const int32_t *p) { return _mm256_load_si256((const __m256i *)p); }
INLINE void put(int32_t *p, __m256i x) { _mm256_store_si256((__m256i *)p, x); }
INLINE __m256i any_words(const int32_t *p) { return _mm256_loadu_si256((const __m256i *)p); } /* of any alignment, as are those below */
INLINE void put_any(int32_t *p, __m256i x) { _mm256_storeu_si256((__m256i *)p, x); }
INLINE pair any_doubles(const double *p) { return (pair){_mm256_loadu_pd(p), _mm256_loadu_pd(p + 4)}; }
INLINE pair doubles(const double *p) { return (pair){_mm256_load_pd(p), _mm256_load_pd(p + 4)}; }
INLINE __m256i word(int x) { return _mm256_set1_epi32(x); }
INLINE __m256i choose(__m256i m, __m256i yes, __m256i no) { return _mm256_blendv_epi8(no, yes, m); }
INLINE uint32_t bits(__m256i m) { return (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(m)); }
INLINE __m256i mask_of(uint32_t bit)
{
    const __m256i each = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    return _mm256_cmpeq_epi32(_mm256_and_si256(word((int)bit), each), each);
}
INLINE __m256i both(__m256d a, __m256d b) /* masks of doubles to one of words */
{
    __m256 m = _mm256_shuffle_ps(_mm256_castpd_ps(a), _mm256_castpd_ps(b), 0x88);
    return _mm256_permute4x64_epi64(_mm256_castps_si256(m), 0xd8);
}
INLINE pair to_doubles(__m256i x) { return (pair){_mm256_cvtepi32_pd(_mm256_castsi256_si128(x)), _mm256_cvtepi32_pd(_mm256_extracti128_si256(x, 1))}; }
/* Bits of x and y together. */
INLINE __m256i count_bits(__m256i x, __m256i y)
{
    const __m256i nibble = _mm256_set1_epi8(15), table = _mm256_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4, 0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4);
    const __m256i a = _mm256_add_epi8(_mm256_shuffle_epi8(table, _mm256_and_si256(x, nibble)), _mm256_shuffle_epi8(table, _mm256_and_si256(_mm256_srli_epi16(x, 4), nibble)));
    const __m256i b = _mm256_add_epi8(_mm256_shuffle_epi8(table, _mm256_and_si256(y, nibble)), _mm256_shuffle_epi8(table, _mm256_and_si256(_mm256_srli_epi16(y, 4), nibble)));
    return _mm256_madd_epi16(_mm256_maddubs_epi16(_mm256_add_epi8(a, b), _mm256_set1_epi8(1)), _mm256_set1_epi16(1));
}
/* Number of the highest bit; of 0 less than 0, of negative numbers 30 or 31. */
INLINE __m256i highest_bit(__m256i x)
{
    x = _mm256_andnot_si256(_mm256_srli_epi32(x, 1), x); /* so that rounding does not carry */
    __m256i e = _mm256_srli_epi32(_mm256_castps_si256(_mm256_cvtepi32_ps(x)), 23);
    return _mm256_sub_epi32(_mm256_and_si256(e, word(255)), word(127));
}

/* The 16 bytes at `units + at` of every lane, as four words. */
INLINE void load_nodes(const uint64_t *units, const int32_t *at, __m256i out[4])
{
#define TWO(k) _mm256_inserti128_si256(_mm256_castsi128_si256(_mm_loadu_si128((const __m128i *)(units + (uint32_t)at[k]))), _mm_loadu_si128((const __m128i *)(units + (uint32_t)at[(k) + 4])), 1)
    __m256i r0 = TWO(0), r1 = TWO(1), r2 = TWO(2), r3 = TWO(3);
#undef TWO
    __m256i a = _mm256_unpacklo_epi32(r0, r1), b = _mm256_unpackhi_epi32(r0, r1), c = _mm256_unpacklo_epi32(r2, r3), d = _mm256_unpackhi_epi32(r2, r3);
    out[0] = _mm256_unpacklo_epi64(a, c), out[1] = _mm256_unpackhi_epi64(a, c);
    out[2] = _mm256_unpacklo_epi64(b, d), out[3] = _mm256_unpackhi_epi64(b, d);
}

/* Results of lanes that have finished with something to tell. */
static void flush(const group *g, const svo_rays *r, bool lod, svoi_ray_batch *b)
{
    _Alignas(32) int32_t face[LANES];
    if (!lod) {
        /* A ray in a finest voxel is where it entered it, or where it began: the last plane that it has crossed is the voxel's. */
        const __m256i size = word(1 << r->fraction), keep = word(-(1 << r->fraction));
        const pair now = doubles(g->t);
        __m256i f = word(SVO_FACE_INSIDE);
        for (int k = 2; k >= 0; k--) {
            const __m256i back = words(g->backward[k]);
            const pair p = to_doubles(_mm256_add_epi32(_mm256_and_si256(words(g->q[k]), keep), _mm256_and_si256(back, size))), o = doubles(g->o[k]), inv = doubles(g->inv[k]);
            const __m256i entered = both(_mm256_cmp_pd(_mm256_mul_pd(_mm256_sub_pd(p.a, o.a), inv.a), now.a, _CMP_GE_OQ), _mm256_cmp_pd(_mm256_mul_pd(_mm256_sub_pd(p.b, o.b), inv.b), now.b, _CMP_GE_OQ));
            f = choose(entered, _mm256_sub_epi32(word(2 * k), back), f);
        }
        put(face, f);
    }
    for (uint32_t rest = g->finished; rest != 0; rest &= rest - 1, b->found++) {
        const uint32_t lane = (uint32_t)__builtin_ctz(rest), to = b->found;
        b->found_ray[to] = g->ray[lane], b->state[to] = g->state[lane];
        for (int k = 0; k < 3; k++) b->at[k][to] = g->q[k][lane];
        if (!lod) b->t_found[to] = g->t[lane], b->face_found[to] = face[lane];
        if (!b->numbers || g->state[lane] == SVOI_RAY_DOUBT) continue;
        uint32_t sum = r->before[(uint32_t)g->node[lane]] >> 1;
        for (uint32_t k = 1; k + 1 < r->levels; k++)
            if (g->s[lane] < (int32_t)(r->fraction + 2 * k)) sum += r->before[(uint32_t)g->stack[k][lane]] >> 1;
        b->node_found[to] = g->node[lane], b->base[to] = (int32_t)sum;
    }
}

/* New rays where few are left; false when there is nothing to do any more. */
static bool refill(group *g, const svo_rays *r, svoi_ray_batch *b, bool lod, bool start, uint32_t *next)
{
    if (__builtin_popcount(g->active) > REFILL) return true;
    const svoi_ray_list *from = start ? &b->start : &b->in;
    const uint32_t end = start ? b->starts : b->count;
    if (*next == end) return g->active != 0;
    if (g->finished != 0) flush(g, r, lod, b);
    g->finished = 0;
    for (uint32_t empty = ~g->active & 0xff; empty != 0 && *next < end; ++*next) {
        const uint32_t l = (uint32_t)__builtin_ctz(empty), i = *next;
        if (b->s[i] < 0) continue; /* `begin` has found that it hits nothing */
        empty &= empty - 1;
        for (int k = 0; k < 3; k++) {
            const bool negative = signbit(from->d[k][i]);
            g->o[k][l] = from->o[k][i], g->d[k][l] = from->d[k][i], g->inv[k][l] = from->inv[k][i];
            g->step[k][l] = (float)from->inv[k][i];
            g->q[k][l] = from->q[k][i];
            g->backward[k][l] = -(int32_t)negative, g->positive[k][l] = -(int32_t)!negative;
        }
        g->t[l] = from->t[i], g->t_max[l] = from->t_max[i], g->spread[l] = from->spread[i], g->offset[l] = from->offset[i];
        g->ray[l] = from->ray[i];
        g->s[l] = b->s[i];
        g->node[l] = b->node[i];
        for (uint32_t k = 1; k < r->levels; k++) g->stack[k][l] = b->stack[k][i];
        g->active |= 1u << l;
    }
    return true;
}

INLINE pair limit_at(const group *g, pair t)
{
    pair spread = doubles(g->spread), offset = doubles(g->offset);
    return (pair){_mm256_add_pd(_mm256_mul_pd(spread.a, t.a), offset.a), _mm256_add_pd(_mm256_mul_pd(spread.b, t.b), offset.b)};
}
/* Lanes where 2^s is at most the limit. */
INLINE __m256i within(__m256i s, pair limit)
{
    __m256i e = _mm256_add_epi32(s, word(1023)); /* exponent of a double */
    __m256d a = _mm256_castsi256_pd(_mm256_slli_epi64(_mm256_cvtepi32_epi64(_mm256_castsi256_si128(e)), 52));
    __m256d b = _mm256_castsi256_pd(_mm256_slli_epi64(_mm256_cvtepi32_epi64(_mm256_extracti128_si256(e, 1)), 52));
    return both(_mm256_cmp_pd(a, limit.a, _CMP_LE_OQ), _mm256_cmp_pd(b, limit.b, _CMP_LE_OQ));
}

/* Lanes that miss the box of what is inside their node from here on; see svo_rays_avx512.c. */
INLINE __m256i misses_box(const group *g, __m256i box, bool lod)
{
    __m256i s = words(g->s), sub = _mm256_sub_epi32(s, word(2)), keep = _mm256_sllv_epi32(word(-1), _mm256_add_epi32(s, word(2)));
    __m256i margin = _mm256_add_epi32(_mm256_srlv_epi32(word(1 << 15), _mm256_sub_epi32(word(30), s)), word(2));
    __m256i beyond = _mm256_add_epi32(_mm256_sllv_epi32(word(1), sub), margin), field = word(15), corner[3];
    __m256 steps[3];
    for (int k = 0; k < 3; k++) {
        __m256i q = words(g->q[k]);
        corner[k] = _mm256_sub_epi32(_mm256_and_si256(q, keep), q);
        steps[k] = _mm256_load_ps(g->step[k]);
    }
    if (lod) {
        __m256 leave = _mm256_set1_ps(INFINITY);
        __m256i size = _mm256_sllv_epi32(word(1), _mm256_add_epi32(s, word(2)));
        for (int k = 0; k < 3; k++) {
            __m256i far = _mm256_add_epi32(corner[k], _mm256_and_si256(size, words(g->positive[k])));
            leave = _mm256_min_ps(leave, _mm256_mul_ps(_mm256_cvtepi32_ps(far), steps[k]));
        }
        leave = _mm256_mul_ps(leave, _mm256_set1_ps(1.0001f));
        pair now = doubles(g->t), t = {_mm256_add_pd(now.a, _mm256_cvtps_pd(_mm256_castps256_ps128(leave))), _mm256_add_pd(now.b, _mm256_cvtps_pd(_mm256_extractf128_ps(leave, 1)))};
        pair limit = limit_at(g, t);
        __m256i whole = _mm256_and_si256(within(_mm256_sub_epi32(s, word(1)), limit), word(0x111));
        whole = choose(within(s, limit), word(0x333), whole);
        whole = choose(within(_mm256_add_epi32(s, word(1)), limit), word(0x777), whole);
        box = _mm256_or_si256(_mm256_andnot_si256(whole, box), _mm256_slli_epi32(whole, 12));
    }
    __m256 enter = _mm256_setzero_ps(), leave = _mm256_set1_ps(INFINITY);
    for (int k = 0; k < 3; k++) {
        __m256i low = _mm256_and_si256(_mm256_srli_epi32(box, 4 * k), field), high = _mm256_and_si256(_mm256_srli_epi32(box, 4 * k + 12), field);
        low = _mm256_add_epi32(_mm256_sub_epi32(corner[k], margin), _mm256_sllv_epi32(low, sub));
        high = _mm256_add_epi32(_mm256_add_epi32(corner[k], beyond), _mm256_sllv_epi32(high, sub));
        __m256 a = _mm256_mul_ps(_mm256_cvtepi32_ps(low), steps[k]), b = _mm256_mul_ps(_mm256_cvtepi32_ps(high), steps[k]);
        enter = _mm256_max_ps(_mm256_min_ps(a, b), enter);
        leave = _mm256_min_ps(_mm256_max_ps(a, b), leave);
    }
    return _mm256_castps_si256(_mm256_cmp_ps(enter, leave, _CMP_GT_OQ));
}

/* The cells that lanes are in, of nodes whose cells have an edge of 2^s: number, the half of the node's mask that it is in, the bit there, and the cells before that half. */
typedef struct cells { __m256i number, w, bit, lower; } cells;
INLINE cells cells_at(__m256i qx, __m256i qy, __m256i qz, __m256i s, const __m256i node[4])
{
    const __m256i one = word(1), three = word(3);
    const __m256i x = _mm256_and_si256(_mm256_srlv_epi32(qx, s), three), y = _mm256_and_si256(_mm256_srlv_epi32(qy, s), three), z = _mm256_and_si256(_mm256_srlv_epi32(qz, s), three);
    const __m256i number = _mm256_or_si256(_mm256_or_si256(x, _mm256_slli_epi32(y, 2)), _mm256_slli_epi32(z, 4)), upper = _mm256_cmpgt_epi32(z, one);
    return (cells){number, choose(upper, node[1], node[0]), _mm256_sllv_epi32(one, _mm256_and_si256(number, word(31))), _mm256_and_si256(upper, node[0])};
}

/* A round in the parts of svo_rays_avx512.c. The cell, whether it is filled, and whether the ray misses what is in the node. */
INLINE void look(group *g, const svo_rays *r, bool lod)
{
    const __m256i s = words(g->s);
    __m256i node[4];
    load_nodes(r->units, g->node, node);
    const cells c = cells_at(words(g->q[0]), words(g->q[1]), words(g->q[2]), s, node);
    g->w = c.w;
    g->child = node[2];
    g->lower = c.lower;
    g->block = _mm256_and_si256(_mm256_srlv_epi32(c.w, _mm256_and_si256(c.number, word(0x0a))), word(0x00330033));
    g->bit = c.bit;
    g->missed = _mm256_andnot_si256(_mm256_cmpeq_epi32(s, word((int)r->fraction)), misses_box(g, node[3], lod));
}

/* Where the ray leaves the cell, the empty block of 2x2x2 cells, or the whole node. */
INLINE void leave(group *g)
{
    const __m256i s = words(g->s), edge = choose(g->missed, _mm256_add_epi32(s, word(2)), _mm256_sub_epi32(s, _mm256_cmpeq_epi32(g->block, _mm256_setzero_si256())));
    const __m256i size = _mm256_sllv_epi32(word(1), edge), keep = _mm256_sllv_epi32(word(-1), edge);
    for (int k = 0; k < 3; k++) {
        const __m256i out = _mm256_add_epi32(_mm256_and_si256(words(g->q[k]), keep), _mm256_and_si256(size, words(g->positive[k])));
        const pair p = to_doubles(out), o = doubles(g->o[k]), inv = doubles(g->inv[k]);
        g->out[k] = out;
        g->leaves[k] = (pair){_mm256_mul_pd(_mm256_sub_pd(p.a, o.a), inv.a), _mm256_mul_pd(_mm256_sub_pd(p.b, o.b), inv.b)};
    }
    g->nearest = (pair){_mm256_min_pd(_mm256_min_pd(g->leaves[0].a, g->leaves[1].a), g->leaves[2].a), _mm256_min_pd(_mm256_min_pd(g->leaves[0].b, g->leaves[1].b), g->leaves[2].b)};
}

/* Units of the child behind the bits of `w` below `bit` and those of `lower`, `first` being that of the first child; the children of `single` nodes are bricks. */
INLINE __m256i child_of(__m256i first, __m256i w, __m256i bit, __m256i lower, __m256i single)
{
    const __m256i rank = count_bits(_mm256_and_si256(w, _mm256_sub_epi32(bit, word(1))), lower);
    return _mm256_add_epi32(first, choose(single, rank, _mm256_slli_epi32(rank, 1)));
}

/* Who has hit, who goes down, and to which child. */
INLINE void decide(group *g, const svo_rays *r, bool lod)
{
    const __m256i zero = _mm256_setzero_si256(), one = word(1), s = words(g->s), brick = _mm256_cmpeq_epi32(s, word((int)r->fraction));
    __m256i active = mask_of(g->active), here = _mm256_andnot_si256(g->missed, active);
    __m256i filled = _mm256_andnot_si256(_mm256_cmpeq_epi32(_mm256_and_si256(g->w, g->bit), zero), here), hit = _mm256_and_si256(filled, brick), state = words(g->state);
    if (lod) {
        const pair limit = limit_at(g, doubles(g->t));
        const __m256i stop2 = _mm256_and_si256(_mm256_andnot_si256(_mm256_cmpeq_epi32(g->block, zero), here), within(_mm256_add_epi32(s, one), limit));
        hit = _mm256_andnot_si256(stop2, _mm256_or_si256(hit, _mm256_and_si256(filled, within(s, limit))));
        state = choose(stop2, _mm256_add_epi32(s, word(2)), state);
        active = _mm256_andnot_si256(stop2, active);
        g->finished |= bits(stop2);
        filled = _mm256_andnot_si256(stop2, filled);
    }
    put(g->state, choose(hit, _mm256_add_epi32(s, one), state));
    g->finished |= bits(hit);
    active = _mm256_andnot_si256(hit, active);
    g->live = active;
    g->down = _mm256_andnot_si256(hit, filled);
    g->child = child_of(g->child, g->w, g->bit, g->lower, _mm256_cmpeq_epi32(s, word((int)r->fraction + 2)));
}

/* Take the step: the next node and the place in it. */
INLINE void step(group *g, const svo_rays *r)
{
    const __m256i zero = _mm256_setzero_si256(), one = word(1), s = words(g->s), down = g->down, active = g->live, go = _mm256_andnot_si256(down, active);
    const pair now = doubles(g->t), nearest = g->nearest, t_max = doubles(g->t_max);
    _mm256_store_pd(g->t, _mm256_blendv_pd(now.a, nearest.a, _mm256_castsi256_pd(_mm256_cvtepi32_epi64(_mm256_castsi256_si128(go)))));
    _mm256_store_pd(g->t + 4, _mm256_blendv_pd(now.b, nearest.b, _mm256_castsi256_pd(_mm256_cvtepi32_epi64(_mm256_extracti128_si256(go, 1)))));
    const __m256i late = both(_mm256_cmp_pd(nearest.a, t_max.a, _CMP_GT_OQ), _mm256_cmp_pd(nearest.b, t_max.b, _CMP_GT_OQ)), unit_mask = word((1 << r->fraction) - 1);
    __m256i doubt = zero, changed = zero;
    for (int k = 0; k < 3; k++) {
        const pair leaves = g->leaves[k], o = doubles(g->o[k]), d = doubles(g->d[k]);
        const __m256i through = both(_mm256_cmp_pd(leaves.a, nearest.a, _CMP_LE_OQ), _mm256_cmp_pd(leaves.b, nearest.b, _CMP_LE_OQ)), q = words(g->q[k]);
        __m256i to = _mm256_inserti128_si256(_mm256_castsi128_si256(_mm256_cvttpd_epi32(_mm256_fmadd_pd(d.a, nearest.a, o.a))), _mm256_cvttpd_epi32(_mm256_fmadd_pd(d.b, nearest.b, o.b)), 1);
        const __m256i edge_far = _mm256_cmpgt_epi32(_mm256_and_si256(_mm256_add_epi32(to, one), unit_mask), one);
        doubt = _mm256_or_si256(doubt, _mm256_andnot_si256(_mm256_or_si256(through, edge_far), word(-1)));
        to = choose(through, _mm256_add_epi32(g->out[k], words(g->backward[k])), to);
        changed = _mm256_or_si256(changed, _mm256_xor_si256(to, q));
        put(g->q[k], choose(go, to, q));
    }
    const __m256i top = highest_bit(changed), up = _mm256_and_si256(go, _mm256_cmpgt_epi32(top, _mm256_add_epi32(s, one)));
    __m256i to_s = _mm256_sub_epi32(s, _mm256_and_si256(down, word(2))), to_node = choose(down, g->child, words(g->node));
    to_s = choose(up, _mm256_and_si256(top, word(SVOI_RAYS_BITS)), to_s); /* even */
    for (uint32_t k = 1; k < r->levels; k++) {
        const __m256i level = word((int)(r->fraction + 2 * k)), kept = choose(_mm256_cmpeq_epi32(s, level), words(g->node), words(g->stack[k]));
        put(g->stack[k], kept);
        to_node = choose(_mm256_and_si256(up, _mm256_cmpeq_epi32(to_s, level)), kept, to_node);
    }
    put(g->s, to_s);
    put(g->node, to_node);
    doubt = _mm256_andnot_si256(late, _mm256_and_si256(doubt, go));
    const __m256i outside = _mm256_andnot_si256(doubt, _mm256_cmpgt_epi32(top, word(SVOI_RAYS_BITS - 1)));
    const __m256i gone = _mm256_and_si256(go, _mm256_or_si256(late, outside));
    g->active = bits(_mm256_andnot_si256(_mm256_or_si256(gone, doubt), active));
    put(g->state, choose(doubt, word(SVOI_RAY_DOUBT), words(g->state)));
    g->finished |= bits(doubt);
}

/* The way down to where rays begin, all levels with all lanes; see svo_rays_avx512.c. */
INLINE void begin(const svo_rays *r, bool lod, svoi_ray_list *l, svoi_ray_batch *b, uint32_t i, uint32_t count)
{
    const __m256i field = word(15);
    const __m256i q[3] = {any_words(&l->q[0][i]), any_words(&l->q[1][i]), any_words(&l->q[2][i])};
    __m256i down = _mm256_cmpgt_epi32(word((int)count), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7)), alone = down, positive[3];
    _Alignas(32) int32_t node[LANES] = {0};
    __m256i at = word(SVOI_RAYS_BITS - 2);
    __m256 step[3], reach = _mm256_set1_ps(INFINITY); /* alone: no hits but in this node; then they are at most so far away */
    pair limit = {_mm256_setzero_pd(), _mm256_setzero_pd()}, t = any_doubles(&l->t[i]);
    for (int k = 0; k < 3; k++) {
        const pair inv = any_doubles(&l->inv[k][i]);
        step[k] = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm256_cvtpd_ps(inv.a)), _mm256_cvtpd_ps(inv.b), 1);
        positive[k] = _mm256_xor_si256(_mm256_srai_epi32(_mm256_castps_si256(step[k]), 31), word(-1));
    }
    if (lod) {
        const pair spread = any_doubles(&l->spread[i]), offset = any_doubles(&l->offset[i]);
        limit = (pair){_mm256_add_pd(_mm256_mul_pd(spread.a, t.a), offset.a), _mm256_add_pd(_mm256_mul_pd(spread.b, t.b), offset.b)};
    }
    for (uint32_t level = r->levels - 1, s = SVOI_RAYS_BITS - 2; level > 0; level--, s -= 2) {
        const __m128i finer = _mm_cvtsi32_si128((int)s - 2);
        __m256i units[4];
        load_nodes(r->units, node, units);
        if (!lod && __builtin_popcount(bits(alone)) >= WORTH) {
            /* as in misses_box */
            const int32_t size = (int32_t)1 << s, margin = (1 << 15 >> (30 - s)) + 2;
            const __m256i keep = word(-(4 * size)), keep_cell = word(-size);
            __m256 enter = _mm256_setzero_ps(), leave = _mm256_set1_ps(INFINITY), leave_cell = leave;
            for (int k = 0; k < 3; k++) {
                const __m256i corner = _mm256_sub_epi32(_mm256_and_si256(q[k], keep), q[k]), cell = _mm256_sub_epi32(_mm256_and_si256(q[k], keep_cell), q[k]);
                __m256i low = _mm256_and_si256(_mm256_srli_epi32(units[3], 4 * k), field), high = _mm256_and_si256(_mm256_srli_epi32(units[3], 4 * k + 12), field);
                low = _mm256_add_epi32(_mm256_sub_epi32(corner, word(margin)), _mm256_sll_epi32(low, finer));
                high = _mm256_add_epi32(_mm256_add_epi32(corner, word(margin + size / 4)), _mm256_sll_epi32(high, finer));
                const __m256i far = _mm256_add_epi32(cell, choose(positive[k], word(size - 2), word(2)));
                const __m256 x = _mm256_mul_ps(_mm256_cvtepi32_ps(low), step[k]), y = _mm256_mul_ps(_mm256_cvtepi32_ps(high), step[k]);
                enter = _mm256_max_ps(_mm256_min_ps(x, y), enter);
                leave = _mm256_min_ps(_mm256_max_ps(x, y), leave);
                leave_cell = _mm256_min_ps(_mm256_mul_ps(_mm256_cvtepi32_ps(far), step[k]), leave_cell);
            }
            const __m256i missed = _mm256_and_si256(down, _mm256_castps_si256(_mm256_cmp_ps(enter, leave, _CMP_GT_OQ)));
            down = _mm256_andnot_si256(missed, down);
            alone = _mm256_and_si256(alone, _mm256_or_si256(down, missed));
            reach = _mm256_blendv_ps(reach, _mm256_min_ps(reach, leave), _mm256_castsi256_ps(alone));
            reach = _mm256_andnot_ps(_mm256_castsi256_ps(_mm256_and_si256(alone, missed)), reach);
            alone = _mm256_and_si256(alone, _mm256_castps_si256(_mm256_cmp_ps(reach, _mm256_mul_ps(leave_cell, _mm256_set1_ps(0.99999f)), _CMP_LE_OQ)));
        }
        const cells c = cells_at(q[0], q[1], q[2], word((int)s), units);
        down = _mm256_andnot_si256(_mm256_cmpeq_epi32(_mm256_and_si256(c.w, c.bit), _mm256_setzero_si256()), down);
        if (lod) down = _mm256_andnot_si256(within(word((int)s), limit), down); /* one that is small enough may be a hit */
        alone = _mm256_and_si256(alone, down);
        if (bits(down) == 0) break;
        const __m256i here = words(node), child = child_of(units[2], c.w, c.bit, c.lower, word(level == 1 ? -1 : 0));
        put_any(&b->stack[level][i], here);
        put(node, choose(down, child, here));
        at = _mm256_sub_epi32(at, _mm256_and_si256(down, word(2)));
    }
    put_any(&b->s[i], _mm256_or_si256(at, _mm256_castps_si256(_mm256_cmp_ps(reach, _mm256_setzero_ps(), _CMP_EQ_OQ)))); /* negative: hits nothing */
    put_any(&b->node[i], words(node));
    if (lod) return;
    reach = _mm256_mul_ps(reach, _mm256_set1_ps(1.00001f));
    const pair t_max = any_doubles(&l->t_max[i]);
    _mm256_storeu_pd(&l->t_max[i], _mm256_min_pd(_mm256_add_pd(t.a, _mm256_cvtps_pd(_mm256_castps256_ps128(reach))), t_max.a));
    _mm256_storeu_pd(&l->t_max[i + 4], _mm256_min_pd(_mm256_add_pd(t.b, _mm256_cvtps_pd(_mm256_extractf128_ps(reach, 1))), t_max.b));
}

void svoi_rays_begin_avx2(const svo_rays *r, bool lod, svoi_ray_list *l, svoi_ray_batch *b, uint32_t first, uint32_t count)
{
    for (uint32_t i = 0; i < count; i += LANES) lod ? begin(r, true, l, b, first + i, count - i) : begin(r, false, l, b, first + i, count - i);
}

/* Rays that a packet has brought to a node where their cells are filled go down, as in `begin`. */
static void sink(const svo_rays *r, svoi_ray_batch *b)
{
    const __m256i zero = _mm256_setzero_si256(), brick = word((int)r->fraction);
    for (uint32_t i = 0; i < b->starts; i += LANES) {
        const svoi_ray_list *l = &b->start;
        const __m256i q[3] = {any_words(&l->q[0][i]), any_words(&l->q[1][i]), any_words(&l->q[2][i])};
        __m256i s = any_words(&b->s[i]), node = any_words(&b->node[i]), down = _mm256_cmpgt_epi32(word((int)(b->starts - i)), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
        down = _mm256_andnot_si256(_mm256_cmpgt_epi32(zero, s), down); /* but those that hit nothing */
        while (down = _mm256_andnot_si256(_mm256_cmpeq_epi32(s, brick), down), bits(down) != 0) {
            _Alignas(32) int32_t places[LANES];
            __m256i units[4];
            put(places, _mm256_and_si256(down, node));
            load_nodes(r->units, places, units);
            const cells c = cells_at(q[0], q[1], q[2], s, units);
            down = _mm256_andnot_si256(_mm256_cmpeq_epi32(_mm256_and_si256(c.w, c.bit), zero), down);
            const __m256i child = child_of(units[2], c.w, c.bit, c.lower, _mm256_cmpeq_epi32(s, word((int)r->fraction + 2)));
            for (uint32_t k = 1; k < r->levels; k++)
                _mm256_maskstore_epi32(&b->stack[k][i], _mm256_and_si256(down, _mm256_cmpeq_epi32(s, word((int)(r->fraction + 2 * k)))), node);
            node = choose(down, child, node);
            s = _mm256_sub_epi32(s, _mm256_and_si256(down, word(2)));
        }
        put_any(&b->s[i], s);
        put_any(&b->node[i], node);
    }
}

/* Two groups take turns part by part: while one waits for its last result the other works. */
enum { GROUPS = 2 };

INLINE void trace(const svo_rays *r, bool lod, bool start, svoi_ray_batch *b)
{
    group g[GROUPS];
    uint32_t next = 0;
    memset(g, 0, sizeof g);
    if (start && !lod) sink(r, b);
    for (;;) {
        bool more = false;
        for (int i = 0; i < GROUPS; i++) more |= refill(&g[i], r, b, lod, start, &next);
        if (!more) break;
        for (int i = 0; i < GROUPS; i++) look(&g[i], r, lod);
        for (int i = 0; i < GROUPS; i++) leave(&g[i]);
        for (int i = 0; i < GROUPS; i++) decide(&g[i], r, lod);
        for (int i = 0; i < GROUPS; i++) step(&g[i], r);
    }
    for (int i = 0; i < GROUPS; i++)
        if (g[i].finished != 0) flush(&g[i], r, lod, b);
}

void svoi_rays_trace_avx2(const svo_rays *r, bool lod, bool start, svoi_ray_batch *b)
{
    if (lod) trace(r, true, start, b);
    else trace(r, false, start, b);
}
#else
bool svoi_rays_have_avx2(void) { return false; }
#endif
