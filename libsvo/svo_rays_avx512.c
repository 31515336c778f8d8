/* 16 rays in one stream of instructions, for processors with AVX-512 (see docs/design/003-ray-casting.md).
 *
 * Each lane is a ray in a cell of a node. In every round lanes whose cell is filled go down to the child, unless the ray misses
 * the box of what is in it; all others leave their cell (or the empty 2x2x2 block of cells around it) through its nearest far
 * planes. When few lanes are left, the empty ones are given new rays.
 *
 * Why the hits are those of svo_raycast: which planes are nearest is decided with the same doubles. Which cell the ray
 * is in along the other axes follows from origin + t * direction in fixed point, whose error is far below one unit (2^-30 of
 * the root); a position within a unit of a plane of finest voxels is not trusted, and the ray gets SVOI_RAY_DOUBT. */
#include <string.h>

#include "svoi_rays.h"

#if defined(__x86_64__) && defined(__AVX512F__) && defined(__AVX512VL__) && defined(__AVX512DQ__) && defined(__AVX512BW__) && \
    defined(__AVX512VPOPCNTDQ__) && defined(__AVX512CD__)
#include <immintrin.h>
#include <math.h>

#define INLINE static inline __attribute__((always_inline))

/* Lanes are refilled when this many or fewer are left: each time costs about as much as a round. */
#ifndef REFILL
#define REFILL 6
#endif

bool svoi_rays_have_avx512(void)
{
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512vpopcntdq") &&
           __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("fma");
}

/* ---- making rays ready -------------------------------------------------------------------------------------------- */

static const double far_enough = 0x1p40; /* fixed-point units: beyond, the positions' error would come near to one unit */

/* Structure of arrays, in fixed-point units; the caller's numbers in `ray`. */
static void transpose(const svo_ray *rays, uint32_t count, double scale, svoi_ray_batch *b)
{
    for (uint32_t i = 0; i < count; i++) {
        const svo_ray *r = &rays[i];
        for (int k = 0; k < 3; k++) b->o[k][i] = r->origin[k] * scale, b->d[k][i] = r->direction[k] * scale;
        b->t[i] = r->t_min, b->t_max[i] = r->t_max;
        b->spread[i] = r->spread, b->offset[i] = r->offset;
    }
}

INLINE __m512d absolute(__m512d x) { return _mm512_abs_pd(x); }

void svoi_rays_prepare_avx512(const svo_rays *r, const svo_ray *rays, uint32_t count, bool lod, svoi_ray_batch *b)
{
    const double scale = ldexp(1, (int)r->fraction), root_size = ldexp(1, (int)r->view->tree_depth);
    const __m512d zero = _mm512_setzero_pd(), one = _mm512_set1_pd(1);
    const int32_t *low_side = lod ? r->root_low : r->low, *high_side = lod ? r->root_high : r->high;
    const __m256i unit_mask = _mm256_set1_epi32((1 << r->fraction) - 1), one_i = _mm256_set1_epi32(1);
    transpose(rays, count, scale, b);
    uint32_t kept = 0;
    for (uint32_t i = 0; i < count; i += 8) {
        __mmask8 lanes = count - i >= 8 ? 0xff : (__mmask8)((1u << (count - i)) - 1), usual = lanes, entering[3], negative[3];
        __m512d o[3], d[3], inv[3], near[3], t_min = _mm512_loadu_pd(&b->t[i]), t_max = _mm512_loadu_pd(&b->t_max[i]);
        __m512d t = t_min, leave = _mm512_set1_pd(INFINITY);
        for (int k = 0; k < 3; k++) {
            o[k] = _mm512_loadu_pd(&b->o[k][i]), d[k] = _mm512_loadu_pd(&b->d[k][i]);
            inv[k] = _mm512_div_pd(one, d[k]);
            /* NaN fails every one of these */
            usual &= _mm512_cmp_pd_mask(absolute(o[k]), _mm512_set1_pd(far_enough), _CMP_LE_OQ);
            usual &= _mm512_cmp_pd_mask(absolute(d[k]), _mm512_set1_pd(0x1p-300), _CMP_GE_OQ);
            usual &= _mm512_cmp_pd_mask(absolute(d[k]), _mm512_set1_pd(0x1p300), _CMP_LE_OQ);
            negative[k] = _mm512_cmp_pd_mask(d[k], zero, _CMP_LT_OQ);
            __m512d low = _mm512_mul_pd(_mm512_sub_pd(_mm512_set1_pd(low_side[k]), o[k]), inv[k]);
            __m512d high = _mm512_mul_pd(_mm512_sub_pd(_mm512_set1_pd(high_side[k]), o[k]), inv[k]);
            near[k] = _mm512_mask_mov_pd(low, negative[k], high);
            leave = _mm512_min_pd(leave, _mm512_mask_mov_pd(high, negative[k], low));
            t = _mm512_max_pd(near[k], t);
        }
        usual &= _mm512_cmp_pd_mask(absolute(t_min), _mm512_set1_pd(0x1p300), _CMP_LE_OQ);
        usual &= _mm512_cmp_pd_mask(t_max, t_max, _CMP_ORD_Q);
        if (lod) {
            __m512d spread = _mm512_loadu_pd(&b->spread[i]), offset = _mm512_loadu_pd(&b->offset[i]);
            /* the root itself is not a cell of any node: where it is small enough the ray is left to svo_raycast */
            __m512d limit = _mm512_add_pd(_mm512_mul_pd(spread, t), offset);
            usual &= _mm512_cmp_pd_mask(limit, _mm512_set1_pd(root_size), _CMP_LT_OQ);
        }
        __mmask8 meets = usual & _mm512_cmp_pd_mask(t, leave, _CMP_LT_OQ) & _mm512_cmp_pd_mask(t, t_max, _CMP_LE_OQ), doubt = lanes & ~usual;
        __m256i q[3];
        for (int k = 0; k < 3; k++) {
            entering[k] = _mm512_cmp_pd_mask(near[k], t, _CMP_GE_OQ);
            q[k] = _mm512_cvttpd_epi32(_mm512_fmadd_pd(d[k], t, o[k]));
            __m256i edge = _mm256_and_si256(_mm256_add_epi32(q[k], one_i), unit_mask);
            doubt |= meets & (__mmask8)~entering[k] & _mm256_cmple_epu32_mask(edge, one_i);
            __m256i side = _mm256_mask_mov_epi32(_mm256_set1_epi32(low_side[k]), negative[k], _mm256_set1_epi32(high_side[k] - 1));
            q[k] = _mm256_mask_mov_epi32(q[k], entering[k], side);
        }
        meets &= (__mmask8)~doubt;
        __m256i number = _mm256_add_epi32(_mm256_set1_epi32((int)i), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
        _mm256_storeu_si256((__m256i *)&b->state[i], _mm256_maskz_set1_epi32(doubt, SVOI_RAY_DOUBT));
        /* Close the ranks. Writing past `kept` is harmless: later rays are read before. */
        for (int k = 0; k < 3; k++) {
            _mm512_storeu_pd(&b->o[k][kept], _mm512_maskz_compress_pd(meets, o[k]));
            _mm512_storeu_pd(&b->d[k][kept], _mm512_maskz_compress_pd(meets, d[k]));
            _mm512_storeu_pd(&b->inv[k][kept], _mm512_maskz_compress_pd(meets, inv[k]));
            _mm256_storeu_si256((__m256i *)&b->q[k][kept], _mm256_maskz_compress_epi32(meets, q[k]));
        }
        if (lod) {
            _mm512_storeu_pd(&b->spread[kept], _mm512_maskz_compress_pd(meets, _mm512_mul_pd(_mm512_loadu_pd(&b->spread[i]), _mm512_set1_pd(scale))));
            _mm512_storeu_pd(&b->offset[kept], _mm512_maskz_compress_pd(meets, _mm512_mul_pd(_mm512_loadu_pd(&b->offset[i]), _mm512_set1_pd(scale))));
        }
        _mm512_storeu_pd(&b->t[kept], _mm512_maskz_compress_pd(meets, t));
        _mm512_storeu_pd(&b->t_max[kept], _mm512_maskz_compress_pd(meets, t_max));
        _mm256_storeu_si256((__m256i *)&b->ray[kept], _mm256_maskz_compress_epi32(meets, number));
        kept += (uint32_t)__builtin_popcount(meets);
    }
    b->count = kept;
}

/* ---- traversal ---------------------------------------------------------------------------------------------------- */

/* 16 doubles. */
typedef struct pair { __m512d a, b; } pair;

typedef struct lanes {
    pair o[3], d[3], inv[3], t, t_max, spread, offset;
    __m512i q[3];          /* where the ray is */
    __m512i s;             /* log2 of the edge of the node's cells */
    __m512i low, high, children, ray;
    __m512i positive[3];   /* -1 where the direction is positive, else 0 */
    __m512i backward[3];   /* -1 where it is negative, else 0 */
    __m512 step[3];        /* 1 / direction, for tests that need not be exact */
} lanes;

INLINE __m512d low_doubles(__m512i x) { return _mm512_cvtepi32_pd(_mm512_castsi512_si256(x)); }
INLINE __m512d high_doubles(__m512i x) { return _mm512_cvtepi32_pd(_mm512_extracti64x4_epi64(x, 1)); }
INLINE __mmask16 both(__mmask8 a, __mmask8 b) { return (__mmask16)(a | (uint32_t)b << 8); }

/* The unit of 16 bytes at `units + at` of every lane: four words. */
INLINE void load_nodes(const uint64_t *units, __m512i at, __m512i out[4])
{
    _Alignas(64) uint32_t i[16];
    _mm512_store_si512(i, at);
#define LOAD(k) _mm_loadu_si128((const __m128i *)(units + i[k]))
#define FOUR(k) _mm512_inserti32x4(_mm512_inserti32x4(_mm512_inserti32x4(_mm512_castsi128_si512(LOAD(k)), LOAD((k) + 4), 1), LOAD((k) + 8), 2), LOAD((k) + 12), 3)
    __m512i r0 = FOUR(0), r1 = FOUR(1), r2 = FOUR(2), r3 = FOUR(3);
#undef FOUR
#undef LOAD
    __m512i a = _mm512_unpacklo_epi32(r0, r1), b = _mm512_unpackhi_epi32(r0, r1), c = _mm512_unpacklo_epi32(r2, r3), d = _mm512_unpackhi_epi32(r2, r3);
    out[0] = _mm512_unpacklo_epi64(a, c), out[1] = _mm512_unpackhi_epi64(a, c);
    out[2] = _mm512_unpacklo_epi64(b, d), out[3] = _mm512_unpackhi_epi64(b, d);
}

INLINE pair fill_pair(pair p, const double *from, __mmask16 m, uint32_t low_count)
{
    p.a = _mm512_mask_expand_pd(p.a, (__mmask8)m, _mm512_loadu_pd(from));
    p.b = _mm512_mask_expand_pd(p.b, (__mmask8)(m >> 8), _mm512_loadu_pd(from + low_count));
    return p;
}

/* New rays for the lanes `m`, from number `next` of the batch on. */
INLINE void fill(lanes *l, const svoi_ray_batch *b, const uint64_t *root, bool lod, __mmask16 m, uint32_t next)
{
    uint32_t low_count = (uint32_t)__builtin_popcount(m & 0xff);
    for (int k = 0; k < 3; k++) {
        l->o[k] = fill_pair(l->o[k], &b->o[k][next], m, low_count);
        l->d[k] = fill_pair(l->d[k], &b->d[k][next], m, low_count);
        l->inv[k] = fill_pair(l->inv[k], &b->inv[k][next], m, low_count);
        l->q[k] = _mm512_mask_expand_epi32(l->q[k], m, _mm512_loadu_si512(&b->q[k][next]));
        __mmask16 negative = both(_mm512_movepi64_mask(_mm512_castpd_si512(l->d[k].a)), _mm512_movepi64_mask(_mm512_castpd_si512(l->d[k].b)));
        l->backward[k] = _mm512_movm_epi32(negative);
        l->positive[k] = _mm512_movm_epi32((__mmask16)~negative);
        l->step[k] = _mm512_insertf32x8(_mm512_castps256_ps512(_mm512_cvtpd_ps(l->inv[k].a)), _mm512_cvtpd_ps(l->inv[k].b), 1);
    }
    l->t = fill_pair(l->t, &b->t[next], m, low_count);
    l->t_max = fill_pair(l->t_max, &b->t_max[next], m, low_count);
    if (lod) {
        l->spread = fill_pair(l->spread, &b->spread[next], m, low_count);
        l->offset = fill_pair(l->offset, &b->offset[next], m, low_count);
    }
    l->ray = _mm512_mask_expand_epi32(l->ray, m, _mm512_loadu_si512(&b->ray[next]));
    l->s = _mm512_mask_mov_epi32(l->s, m, _mm512_set1_epi32(SVOI_RAYS_BITS - 2));
    l->low = _mm512_mask_mov_epi32(l->low, m, _mm512_set1_epi32((int)(uint32_t)root[0]));
    l->high = _mm512_mask_mov_epi32(l->high, m, _mm512_set1_epi32((int)(uint32_t)(root[0] >> 32)));
    l->children = _mm512_mask_mov_epi32(l->children, m, _mm512_set1_epi32((int)(uint32_t)root[1]));
}

/* Nodes on the way down, by half of s. */
typedef struct kept { __m512i low, high, children; } kept;

INLINE void push(kept *stack, const lanes *l, __mmask16 m)
{
    _Alignas(64) uint32_t s[16];
    _mm512_store_si512(s, l->s);
    while (m != 0) {
        uint32_t level = s[__builtin_ctz(m)];
        __mmask16 same = _mm512_mask_cmpeq_epi32_mask(m, l->s, _mm512_set1_epi32((int)level));
        kept *k = &stack[level / 2];
        _mm512_mask_store_epi32(&k->low, same, l->low);
        _mm512_mask_store_epi32(&k->high, same, l->high);
        _mm512_mask_store_epi32(&k->children, same, l->children);
        m &= (__mmask16)~same;
    }
}

INLINE void pop(const kept *stack, lanes *l, __mmask16 m)
{
    _Alignas(64) uint32_t s[16];
    _mm512_store_si512(s, l->s);
    while (m != 0) {
        uint32_t level = s[__builtin_ctz(m)];
        __mmask16 same = _mm512_mask_cmpeq_epi32_mask(m, l->s, _mm512_set1_epi32((int)level));
        const kept *k = &stack[level / 2];
        l->low = _mm512_mask_mov_epi32(l->low, same, k->low);
        l->high = _mm512_mask_mov_epi32(l->high, same, k->high);
        l->children = _mm512_mask_mov_epi32(l->children, same, k->children);
        m &= (__mmask16)~same;
    }
}

/* Lanes of `m` whose cell is small enough: 2^s <= spread * t + offset. */
INLINE __mmask16 small_enough(const lanes *l, __mmask16 m, __m512i s)
{
    __m512i e = _mm512_add_epi32(s, _mm512_set1_epi32(1023)); /* exponent of a double */
    __m512d size_a = _mm512_castsi512_pd(_mm512_slli_epi64(_mm512_cvtepi32_epi64(_mm512_castsi512_si256(e)), 52));
    __m512d size_b = _mm512_castsi512_pd(_mm512_slli_epi64(_mm512_cvtepi32_epi64(_mm512_extracti64x4_epi64(e, 1)), 52));
    __m512d a = _mm512_add_pd(_mm512_mul_pd(l->spread.a, l->t.a), l->offset.a), b = _mm512_add_pd(_mm512_mul_pd(l->spread.b, l->t.b), l->offset.b);
    return m & both(_mm512_cmp_pd_mask(size_a, a, _CMP_LE_OQ), _mm512_cmp_pd_mask(size_b, b, _CMP_LE_OQ));
}

/* Which lanes of `m` may meet something in the child of their cell: its box, a little larger. */
INLINE __mmask16 meets_box(const lanes *l, __mmask16 m, __m512i box)
{
    const __m512i fifteen = _mm512_set1_epi32(15), four = _mm512_set1_epi32(4);
    __m512i keep = _mm512_sllv_epi32(_mm512_set1_epi32(-1), l->s), sub = _mm512_sub_epi32(l->s, four);
    /* margin: two units for the position, and the rounding of floats */
    __m512i margin = _mm512_add_epi32(_mm512_srlv_epi32(_mm512_set1_epi32(1 << 13), _mm512_sub_epi32(_mm512_set1_epi32(30), l->s)), _mm512_set1_epi32(2));
    __m512i one = _mm512_sllv_epi32(_mm512_set1_epi32(1), sub);
    __m512 enter = _mm512_setzero_ps(), leave = _mm512_set1_ps(INFINITY);
    for (int k = 0; k < 3; k++) {
        __m512i corner = _mm512_sub_epi32(_mm512_and_si512(l->q[k], keep), l->q[k]);
        __m512i low = _mm512_and_si512(_mm512_srli_epi32(box, (unsigned)(4 * k)), fifteen), high = _mm512_and_si512(_mm512_srli_epi32(box, (unsigned)(4 * k + 12)), fifteen);
        low = _mm512_add_epi32(_mm512_sub_epi32(corner, margin), _mm512_sllv_epi32(low, sub));
        high = _mm512_add_epi32(_mm512_add_epi32(_mm512_add_epi32(corner, one), margin), _mm512_sllv_epi32(high, sub));
        __m512 a = _mm512_mul_ps(_mm512_cvtepi32_ps(low), l->step[k]), b = _mm512_mul_ps(_mm512_cvtepi32_ps(high), l->step[k]);
        enter = _mm512_max_ps(_mm512_min_ps(a, b), enter);
        leave = _mm512_min_ps(_mm512_max_ps(a, b), leave);
    }
    return m & (__mmask16)~_mm512_cmp_ps_mask(enter, leave, _CMP_GT_OQ);
}

INLINE void trace(const svo_rays *r, bool lod, svoi_ray_batch *b)
{
    const __m512i one = _mm512_set1_epi32(1), three = _mm512_set1_epi32(3), m31 = _mm512_set1_epi32(31), m32 = _mm512_set1_epi32(32);
    const __m512i minus_one = _mm512_set1_epi32(-1), finest = _mm512_set1_epi32((int)r->fraction), last_nodes = _mm512_set1_epi32((int)r->fraction + 2);
    const __m512i unit_mask = _mm512_set1_epi32((1 << r->fraction) - 1);
    const uint64_t *units = r->units;
    kept stack[SVOI_RAYS_BITS / 2];
    lanes l;
    __mmask16 active = 0;
    uint32_t next = 0;
    memset(&l, 0, sizeof l);
    for (;;) {
        if (__builtin_popcount(active) <= REFILL) {
            uint32_t rest = b->count - next;
            if (rest != 0) {
                __mmask16 empty = (__mmask16)~active;
                uint32_t space = (uint32_t)__builtin_popcount(empty), taken = space < rest ? space : rest;
                __mmask16 m = (__mmask16)_pdep_u32((1u << taken) - 1, empty);
                fill(&l, b, units, lod, m, next);
                next += taken;
                active |= m;
            } else if (active == 0) return;
        }
        /* the cell, and whether it is filled */
        __m512i s = l.s, x = _mm512_srlv_epi32(l.q[0], s), y = _mm512_srlv_epi32(l.q[1], s), z = _mm512_srlv_epi32(l.q[2], s);
        x = _mm512_and_si512(x, three), y = _mm512_slli_epi32(_mm512_and_si512(y, three), 2), z = _mm512_slli_epi32(_mm512_and_si512(z, three), 4);
        __m512i c = _mm512_or_si512(_mm512_or_si512(x, y), z);
        __mmask16 upper = _mm512_test_epi32_mask(c, m32);
        __m512i w = _mm512_mask_mov_epi32(l.low, upper, l.high), in_word = _mm512_and_si512(c, m31);
        __mmask16 filled = _mm512_mask_test_epi32_mask(active, _mm512_srlv_epi32(w, in_word), one), inside = 0;
        if (lod) {
            /* blocks of 2x2x2 cells, then cells, that are small enough and not empty */
            __m512i block = _mm512_srlv_epi32(w, _mm512_and_si512(c, _mm512_set1_epi32(0x0a)));
            __mmask16 some = _mm512_mask_test_epi32_mask(active, block, _mm512_set1_epi32(0x00330033));
            __mmask16 stop2 = small_enough(&l, some, _mm512_add_epi32(s, one));
            __mmask16 stop1 = small_enough(&l, filled & (__mmask16)~stop2, s);
            if (stop1 | stop2) {
                __m512i state = _mm512_mask_add_epi32(_mm512_add_epi32(s, one), stop2, s, _mm512_set1_epi32(2));
                __mmask16 stop = stop1 | stop2;
                _mm512_mask_i32scatter_epi32(b->state, stop, l.ray, state, 4);
                for (int k = 0; k < 3; k++) _mm512_mask_i32scatter_epi32(b->at[k], stop, l.ray, l.q[k], 4);
                active &= (__mmask16)~stop, filled &= (__mmask16)~stop;
            }
        }
        if (filled != 0) {
            __mmask16 hit = _mm512_mask_cmpeq_epi32_mask(filled, s, finest);
            if (hit != 0) {
                _mm512_mask_i32scatter_epi32(b->state, hit, l.ray, _mm512_add_epi32(s, one), 4);
                for (int k = 0; k < 3; k++) _mm512_mask_i32scatter_epi32(b->at[k], hit, l.ray, l.q[k], 4);
                active &= (__mmask16)~hit;
                filled &= (__mmask16)~hit;
            }
            if (filled != 0) {
                /* the child: as many further as there are filled cells before it */
                __m512i bit = _mm512_sllv_epi32(one, in_word), below = _mm512_and_si512(w, _mm512_sub_epi32(bit, one));
                __m512i rank = _mm512_popcnt_epi32(below);
                rank = _mm512_mask_add_epi32(rank, upper, rank, _mm512_popcnt_epi32(l.low));
                __mmask16 bricks = _mm512_cmpeq_epi32_mask(s, last_nodes);
                rank = _mm512_mask_slli_epi32(rank, (__mmask16)~bricks, rank, 1);
                __m512i child = _mm512_maskz_add_epi32(filled, l.children, rank), node[4];
                load_nodes(units, child, node);
                __mmask16 boxed = filled & (__mmask16)~bricks;
                inside = filled;
                if (boxed) {
                    if (lod) inside = filled;
                    else inside = (filled & bricks) | meets_box(&l, boxed, node[3]);
                }
                if (inside != 0) {
                    push(stack, &l, inside);
                    l.low = _mm512_mask_mov_epi32(l.low, inside, node[0]);
                    l.high = _mm512_mask_mov_epi32(l.high, inside, node[1]);
                    l.children = _mm512_mask_mov_epi32(l.children, inside, node[2]);
                    l.s = _mm512_mask_sub_epi32(s, inside, s, _mm512_set1_epi32(2));
                }
            }
        }
        __mmask16 go = active & (__mmask16)~inside;
        if (go == 0) continue;
        /* leave the cell, or the empty block of 2x2x2 */
        __m512i block = _mm512_srlv_epi32(w, _mm512_and_si512(c, _mm512_set1_epi32(0x0a)));
        __m512i edge = _mm512_mask_add_epi32(s, _mm512_testn_epi32_mask(block, _mm512_set1_epi32(0x00330033)), s, one);
        __m512i size = _mm512_sllv_epi32(one, edge), keep = _mm512_sllv_epi32(minus_one, edge), out[3];
        pair t[3], nearest;
        for (int k = 0; k < 3; k++) {
            out[k] = _mm512_add_epi32(_mm512_and_si512(l.q[k], keep), _mm512_and_si512(size, l.positive[k]));
            t[k].a = _mm512_mul_pd(_mm512_sub_pd(low_doubles(out[k]), l.o[k].a), l.inv[k].a);
            t[k].b = _mm512_mul_pd(_mm512_sub_pd(high_doubles(out[k]), l.o[k].b), l.inv[k].b);
        }
        nearest.a = _mm512_min_pd(_mm512_min_pd(t[0].a, t[1].a), t[2].a);
        nearest.b = _mm512_min_pd(_mm512_min_pd(t[0].b, t[1].b), t[2].b);
        l.t.a = _mm512_mask_mov_pd(l.t.a, (__mmask8)go, nearest.a);
        l.t.b = _mm512_mask_mov_pd(l.t.b, (__mmask8)(go >> 8), nearest.b);
        __mmask16 gone = both(_mm512_cmp_pd_mask(nearest.a, l.t_max.a, _CMP_GT_OQ), _mm512_cmp_pd_mask(nearest.b, l.t_max.b, _CMP_GT_OQ)), doubt = 0;
        __m512i changed = _mm512_setzero_si512();
        for (int k = 0; k < 3; k++) {
            __mmask16 through = both(_mm512_cmp_pd_mask(t[k].a, nearest.a, _CMP_LE_OQ), _mm512_cmp_pd_mask(t[k].b, nearest.b, _CMP_LE_OQ));
            __m256i a = _mm512_cvttpd_epi32(_mm512_fmadd_pd(l.d[k].a, nearest.a, l.o[k].a)), e = _mm512_cvttpd_epi32(_mm512_fmadd_pd(l.d[k].b, nearest.b, l.o[k].b));
            __m512i to = _mm512_inserti64x4(_mm512_castsi256_si512(a), e, 1);
            doubt |= (__mmask16)~through & _mm512_cmple_epu32_mask(_mm512_and_si512(_mm512_add_epi32(to, one), unit_mask), one);
            to = _mm512_mask_add_epi32(to, through, out[k], l.backward[k]);
            changed = _mm512_ternarylogic_epi32(changed, to, l.q[k], 0xf6); /* changed | (to ^ q) */
            l.q[k] = _mm512_mask_mov_epi32(l.q[k], go, to);
        }
        __m512i top = _mm512_sub_epi32(m31, _mm512_lzcnt_epi32(changed));
        doubt &= go & (__mmask16)~gone;
        gone = go & (__mmask16)~doubt & (gone | _mm512_cmpge_epi32_mask(top, _mm512_set1_epi32(SVOI_RAYS_BITS)));
        if (doubt) _mm512_mask_i32scatter_epi32(b->state, doubt, l.ray, _mm512_set1_epi32(SVOI_RAY_DOUBT), 4);
        active &= (__mmask16)~(gone | doubt);
        __mmask16 up = go & active & _mm512_cmpgt_epi32_mask(top, _mm512_add_epi32(s, one));
        if (up != 0) {
            l.s = _mm512_mask_and_epi32(l.s, up, top, _mm512_set1_epi32(~1));
            pop(stack, &l, up);
        }
    }
}

void svoi_rays_trace_avx512(const svo_rays *r, bool lod, svoi_ray_batch *b)
{
    if (lod) trace(r, true, b);
    else trace(r, false, b);
}
#else
bool svoi_rays_have_avx512(void) { return false; }
void svoi_rays_prepare_avx512(const svo_rays *r, const svo_ray *rays, uint32_t count, bool lod, svoi_ray_batch *b)
{
    (void)r, (void)rays, (void)count, (void)lod, (void)b;
}
void svoi_rays_trace_avx512(const svo_rays *r, bool lod, svoi_ray_batch *b) { (void)r, (void)lod, (void)b; }
#endif
