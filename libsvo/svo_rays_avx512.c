/* 16 rays in one stream of instructions, for processors with AVX-512 (see docs/design/003-ray-casting.md).
 *
 * Each lane is a ray in a cell of a node. A round has no branches but those that all lanes take together: every lane loads its
 * node; one whose cell is filled goes down to the child; all others leave their cell, the empty 2x2x2 block of cells
 * around it, or, where what is left of the ray misses the box of what is in the node, the whole node, through the nearest far
 * planes, and find the node they are in then on a stack. When few lanes are left, the empty ones are given new rays.
 *
 * Why the hits are those of svo_raycast: which planes are nearest is decided with the same doubles. Which cell the ray
 * is in along the other axes follows from origin + t * direction in fixed point, whose error is far below one unit (2^-30 of
 * the root); a position within a unit of a plane of finest voxels is not trusted, and the ray gets SVOI_RAY_DOUBT. */
#include <string.h>

#include "svoi_rays.h"

#ifdef SVOI_HAVE_AVX512
#include <immintrin.h>
#include <math.h>

#define INLINE static inline __attribute__((always_inline))

/* Lanes are refilled when this many or fewer are left: each time costs about as much as a round. */
#ifndef REFILL
#define REFILL 8
#endif
/* Where rays begin it is worth a look how far they can hit anything while so many of 16 may find out: measured. */
#ifndef WORTH
#define WORTH 6
#endif

bool svoi_rays_have_avx512(void)
{
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512vpopcntdq") &&
           __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("fma");
}

/* ---- making rays ready -------------------------------------------------------------------------------------------- */

static const double far_enough = 0x1p40; /* fixed-point units: beyond, the positions' error would come near to one unit */

/* The first eight doubles of eight rays: origins, directions, t_min, t_max. Rays from `count` on are copies of the last. */
INLINE void load_rays(const svo_ray *rays, uint32_t count, __m512d field[8])
{
    __m512d row[8], a[8], c[8];
    for (uint32_t i = 0; i < 8; i++) row[i] = _mm512_loadu_pd(rays[i < count ? i : count - 1].origin);
    for (int i = 0; i < 4; i++) a[i] = _mm512_unpacklo_pd(row[2 * i], row[2 * i + 1]), a[4 + i] = _mm512_unpackhi_pd(row[2 * i], row[2 * i + 1]);
    for (int odd = 0; odd < 8; odd += 4) {
        c[0] = _mm512_shuffle_f64x2(a[odd], a[odd + 1], 0x88), c[1] = _mm512_shuffle_f64x2(a[odd + 2], a[odd + 3], 0x88);
        c[2] = _mm512_shuffle_f64x2(a[odd], a[odd + 1], 0xdd), c[3] = _mm512_shuffle_f64x2(a[odd + 2], a[odd + 3], 0xdd);
        const int f = odd / 4;
        field[f] = _mm512_shuffle_f64x2(c[0], c[1], 0x88), field[f + 4] = _mm512_shuffle_f64x2(c[0], c[1], 0xdd);
        field[f + 2] = _mm512_shuffle_f64x2(c[2], c[3], 0x88), field[f + 6] = _mm512_shuffle_f64x2(c[2], c[3], 0xdd);
    }
}

INLINE __m512d absolute(__m512d x) { return _mm512_abs_pd(x); }

/* As prepare. Without `lod`, no ray is taken to have a level of detail; false where one has. */
INLINE bool prepare(const svo_rays *r, bool lod, const svo_ray *rays, uint32_t count, svoi_ray_batch *b)
{
    const double scale = ldexp(1, (int)r->fraction), root_size = ldexp(1, (int)r->view->tree_depth);
    const __m512d zero = _mm512_setzero_pd(), one = _mm512_set1_pd(1);
    const int32_t *low_side = lod ? r->root_low : r->low, *high_side = lod ? r->root_high : r->high;
    const __m256i unit_mask = _mm256_set1_epi32((1 << r->fraction) - 1), one_i = _mm256_set1_epi32(1);
    __m128d cones[2] = {_mm_setzero_pd(), _mm_setzero_pd()};
    uint32_t kept = 0;
    for (uint32_t i = 0; i < count; i += 8) {
        __mmask8 lanes = count - i >= 8 ? 0xff : (__mmask8)((1u << (count - i)) - 1), usual, entering[3], negative[3];
        __m512d field[8], o[3], d[3], inv[3], near[3], spread = zero, offset = zero;
        for (uint32_t k = 0; k < 8 * sizeof *rays; k += 64) __builtin_prefetch((const char *)&rays[i + SVOI_RAYS_BATCH] + k); /* of the next batch */
        load_rays(rays + i, count - i, field);
        for (uint32_t k = 0; !lod && k < 8; k++) cones[k & 1] = _mm_max_pd(_mm_loadu_pd(&rays[i + k < count ? i + k : i].spread), cones[k & 1]); /* of NaN and a number the second */
        const __m512d t_min = field[6], t_max = field[7];
        __m512d t = t_min, leave = _mm512_set1_pd(INFINITY);
        for (int k = 0; k < 3; k++) {
            o[k] = _mm512_mul_pd(field[k], _mm512_set1_pd(scale)), d[k] = _mm512_mul_pd(field[3 + k], _mm512_set1_pd(scale));
            inv[k] = _mm512_div_pd(one, d[k]);
            negative[k] = _mm512_movepi64_mask(_mm512_castpd_si512(d[k]));
            __m512d low = _mm512_mul_pd(_mm512_sub_pd(_mm512_set1_pd(low_side[k]), o[k]), inv[k]);
            __m512d high = _mm512_mul_pd(_mm512_sub_pd(_mm512_set1_pd(high_side[k]), o[k]), inv[k]);
            near[k] = _mm512_mask_mov_pd(low, negative[k], high);
            leave = _mm512_min_pd(leave, _mm512_mask_mov_pd(high, negative[k], low));
            t = _mm512_max_pd(near[k], t);
        }
        /* NaN fails the sums; 1 / d, and planes times that, are normal floats */
        const __m512d far = _mm512_add_pd(_mm512_add_pd(absolute(o[0]), absolute(o[1])), absolute(o[2])), fast = _mm512_add_pd(_mm512_add_pd(absolute(d[0]), absolute(d[1])), absolute(d[2]));
        usual = _mm512_mask_cmp_pd_mask(lanes, far, _mm512_set1_pd(far_enough), _CMP_LE_OQ);
        usual = _mm512_mask_cmp_pd_mask(usual, fast, _mm512_set1_pd(0x1p90), _CMP_LE_OQ);
        usual = _mm512_mask_cmp_pd_mask(usual, _mm512_min_pd(_mm512_min_pd(absolute(d[0]), absolute(d[1])), absolute(d[2])), _mm512_set1_pd(0x1p-90), _CMP_GE_OQ);
        usual = _mm512_mask_cmp_pd_mask(usual, absolute(t_min), _mm512_set1_pd(0x1p300), _CMP_LE_OQ);
        usual = _mm512_mask_cmp_pd_mask(usual, t_max, t_max, _CMP_ORD_Q);
        if (lod) {
            const __m256i at = _mm256_mullo_epi32(_mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7), _mm256_set1_epi32((int)(sizeof *rays / 8)));
            spread = _mm512_mask_i32gather_pd(zero, lanes, at, &rays[i].spread, 8), offset = _mm512_mask_i32gather_pd(zero, lanes, at, &rays[i].offset, 8);
            /* the root itself is not a cell of any node: where it is small enough the ray is left to svo_raycast */
            __m512d limit = _mm512_add_pd(_mm512_mul_pd(spread, t), offset);
            usual = _mm512_mask_cmp_pd_mask(usual, limit, _mm512_set1_pd(root_size), _CMP_LT_OQ);
        }
        __mmask8 meets = _mm512_mask_cmp_pd_mask(_mm512_mask_cmp_pd_mask(usual, t, leave, _CMP_LT_OQ), t, t_max, _CMP_LE_OQ), doubt = lanes & ~usual;
        __m256i q[3];
        for (int k = 0; k < 3; k++) {
            entering[k] = _mm512_cmp_pd_mask(near[k], t, _CMP_GE_OQ);
            q[k] = _mm512_cvttpd_epi32(_mm512_fmadd_pd(d[k], t, o[k]));
            __m256i edge = _mm256_and_si256(_mm256_add_epi32(q[k], one_i), unit_mask);
            /* at t = 0 the ray is at its origin; where that is a whole number of units, nothing has been rounded: on a plane it is in the cell before it */
            const __mmask8 exact = _mm512_mask_cmp_pd_mask(_mm512_cmp_pd_mask(t, zero, _CMP_EQ_OQ), _mm512_cvtepi32_pd(q[k]), o[k], _CMP_EQ_OQ);
            doubt |= _mm256_mask_cmple_epu32_mask(meets & (__mmask8)~(entering[k] | exact), edge, one_i);
            q[k] = _mm256_mask_sub_epi32(q[k], exact & negative[k], q[k], one_i);
            __m256i side = _mm256_mask_mov_epi32(_mm256_set1_epi32(low_side[k]), negative[k], _mm256_set1_epi32(high_side[k] - 1));
            q[k] = _mm256_mask_mov_epi32(q[k], entering[k], side);
        }
        meets &= (__mmask8)~doubt;
        __m256i number = _mm256_add_epi32(_mm256_set1_epi32((int)i), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
        b->unsure[i / 8] = doubt;
        if (meets != 0xff) { /* close the ranks */
            for (int k = 0; k < 3; k++) {
                o[k] = _mm512_maskz_compress_pd(meets, o[k]), d[k] = _mm512_maskz_compress_pd(meets, d[k]), inv[k] = _mm512_maskz_compress_pd(meets, inv[k]);
                q[k] = _mm256_maskz_compress_epi32(meets, q[k]);
            }
            if (lod) spread = _mm512_maskz_compress_pd(meets, spread), offset = _mm512_maskz_compress_pd(meets, offset);
            t = _mm512_maskz_compress_pd(meets, t);
            number = _mm256_maskz_compress_epi32(meets, number);
        }
        for (int k = 0; k < 3; k++) {
            _mm512_storeu_pd(&b->in.o[k][kept], o[k]);
            _mm512_storeu_pd(&b->in.d[k][kept], d[k]);
            _mm512_storeu_pd(&b->in.inv[k][kept], inv[k]);
            _mm256_storeu_si256((__m256i *)&b->in.q[k][kept], q[k]);
        }
        if (lod) {
            _mm512_storeu_pd(&b->in.spread[kept], _mm512_mul_pd(spread, _mm512_set1_pd(scale)));
            _mm512_storeu_pd(&b->in.offset[kept], _mm512_mul_pd(offset, _mm512_set1_pd(scale)));
        }
        _mm512_storeu_pd(&b->in.t[kept], t);
        _mm512_storeu_pd(&b->in.t_max[kept], _mm512_maskz_compress_pd(meets, t_max));
        _mm256_storeu_si256((__m256i *)&b->in.ray[kept], number);
        kept += (uint32_t)__builtin_popcount(meets);
    }
    b->count = kept;
    return _mm_movemask_pd(_mm_cmpgt_pd(_mm_max_pd(cones[0], cones[1]), _mm_setzero_pd())) == 0;
}

bool svoi_rays_prepare_avx512(const svo_rays *r, const svo_ray *rays, uint32_t count, svoi_ray_batch *b)
{
    if (prepare(r, false, rays, count, b) || !r->view->lod) return false;
    prepare(r, true, rays, count, b);
    return true;
}

/* ---- traversal ---------------------------------------------------------------------------------------------------- */

/* 16 doubles. */
typedef struct pair { __m512d a, b; } pair;

typedef struct lanes {
    pair o[3], d[3], inv[3], t, t_max, spread, offset;
    __m512i q[3];        /* where the ray is */
    __m512i s;           /* log2 of the edge of the node's cells */
    __m512i node;        /* its unit */
    __m512i ray, state;  /* state: of lanes that have finished, see svoi_ray_batch */
    __m512i positive[3]; /* -1 where the direction is positive, else 0 */
    __m512i backward[3]; /* -1 where it is negative, else 0 */
    __m512 step[3];      /* 1 / direction, for tests that need not be exact */
} lanes;

INLINE __m512d low_doubles(__m512i x) { return _mm512_cvtepi32_pd(_mm512_castsi512_si256(x)); }
INLINE __m512d high_doubles(__m512i x) { return _mm512_cvtepi32_pd(_mm512_extracti64x4_epi64(x, 1)); }
INLINE __mmask16 both(__mmask8 a, __mmask8 b) { return (__mmask16)(a | (uint32_t)b << 8); }
INLINE __m512i word(int x) { return _mm512_set1_epi32(x); }
INLINE __m512i choose(__mmask16 m, __m512i yes, __m512i no) { return _mm512_mask_mov_epi32(no, m, yes); }

/* The 16 bytes at `units + at` of every lane, as four words. Loads and shuffles take half the time of gathers. */
INLINE void load_nodes(const uint64_t *units, __m512i at, __m512i out[4])
{
    _Alignas(64) uint32_t i[16];
    _mm512_store_si512(i, at);
    __asm__ volatile("" : : "r"(i) : "memory"); /* through memory: faster than taking the register apart */
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
INLINE void fill(lanes *l, const svoi_ray_list *from, bool lod, __mmask16 m, uint32_t next)
{
    uint32_t low_count = (uint32_t)__builtin_popcount(m & 0xff);
    for (int k = 0; k < 3; k++) {
        l->o[k] = fill_pair(l->o[k], &from->o[k][next], m, low_count);
        l->d[k] = fill_pair(l->d[k], &from->d[k][next], m, low_count);
        l->inv[k] = fill_pair(l->inv[k], &from->inv[k][next], m, low_count);
        l->q[k] = _mm512_mask_expand_epi32(l->q[k], m, _mm512_loadu_si512(&from->q[k][next]));
        __mmask16 negative = both(_mm512_movepi64_mask(_mm512_castpd_si512(l->d[k].a)), _mm512_movepi64_mask(_mm512_castpd_si512(l->d[k].b)));
        l->backward[k] = _mm512_movm_epi32(negative);
        l->positive[k] = _mm512_movm_epi32((__mmask16)~negative);
        l->step[k] = _mm512_insertf32x8(_mm512_castps256_ps512(_mm512_cvtpd_ps(l->inv[k].a)), _mm512_cvtpd_ps(l->inv[k].b), 1);
    }
    l->t = fill_pair(l->t, &from->t[next], m, low_count);
    l->t_max = fill_pair(l->t_max, &from->t_max[next], m, low_count);
    if (lod) {
        l->spread = fill_pair(l->spread, &from->spread[next], m, low_count);
        l->offset = fill_pair(l->offset, &from->offset[next], m, low_count);
    }
    l->ray = _mm512_mask_expand_epi32(l->ray, m, _mm512_loadu_si512(&from->ray[next]));
}

/* spread * t + offset */
INLINE pair limit_at(const lanes *l, pair t)
{
    pair p = {_mm512_add_pd(_mm512_mul_pd(l->spread.a, t.a), l->offset.a), _mm512_add_pd(_mm512_mul_pd(l->spread.b, t.b), l->offset.b)};
    return p;
}
/* Lanes where 2^s is at most the limit. */
INLINE __mmask16 within(__m512i s, pair limit)
{
    __m512i e = _mm512_add_epi32(s, word(1023)); /* exponent of a double */
    __m512d a = _mm512_castsi512_pd(_mm512_slli_epi64(_mm512_cvtepi32_epi64(_mm512_castsi512_si256(e)), 52));
    __m512d b = _mm512_castsi512_pd(_mm512_slli_epi64(_mm512_cvtepi32_epi64(_mm512_extracti64x4_epi64(e, 1)), 52));
    return both(_mm512_cmp_pd_mask(a, limit.a, _CMP_LE_OQ), _mm512_cmp_pd_mask(b, limit.b, _CMP_LE_OQ));
}

/* Lanes that miss the box of what is inside their node from here on. The box is made a little larger: by two units for the
 * position, and for the rounding of floats. With a level of detail, nodes count as full that are small enough where the ray leaves the node
 * or before, so the box is widened to whole nodes of that size. */
INLINE __mmask16 misses_box(const lanes *l, __m512i box, bool lod)
{
    __m512i s = l->s, sub = _mm512_sub_epi32(s, word(2)), keep = _mm512_sllv_epi32(word(-1), _mm512_add_epi32(s, word(2)));
    __m512i margin = _mm512_add_epi32(_mm512_srlv_epi32(word(1 << 15), _mm512_sub_epi32(word(30), s)), word(2));
    __m512i beyond = _mm512_add_epi32(_mm512_sllv_epi32(word(1), sub), margin), field = word(15);
    __m512i corner[3];
    for (int k = 0; k < 3; k++) corner[k] = _mm512_sub_epi32(_mm512_and_si512(l->q[k], keep), l->q[k]);
    if (lod) {
        __m512 leave = _mm512_set1_ps(INFINITY);
        __m512i size = _mm512_sllv_epi32(word(1), _mm512_add_epi32(s, word(2)));
        for (int k = 0; k < 3; k++) {
            __m512i far = _mm512_add_epi32(corner[k], _mm512_and_si512(size, l->positive[k]));
            leave = _mm512_min_ps(leave, _mm512_mul_ps(_mm512_cvtepi32_ps(far), l->step[k]));
        }
        leave = _mm512_mul_ps(leave, _mm512_set1_ps(1.0001f));
        pair t = {_mm512_add_pd(l->t.a, _mm512_cvtps_pd(_mm512_castps512_ps256(leave))), _mm512_add_pd(l->t.b, _mm512_cvtps_pd(_mm512_extractf32x8_ps(leave, 1)))};
        pair limit = limit_at(l, t);
        __m512i whole = _mm512_maskz_mov_epi32(within(_mm512_sub_epi32(s, word(1)), limit), word(0x111));
        whole = choose(within(s, limit), word(0x333), whole);
        whole = choose(within(_mm512_add_epi32(s, word(1)), limit), word(0x777), whole);
        box = _mm512_or_si512(_mm512_andnot_si512(whole, box), _mm512_slli_epi32(whole, 12));
    }
    __m512 enter = _mm512_setzero_ps(), leave = _mm512_set1_ps(INFINITY);
    for (int k = 0; k < 3; k++) {
        __m512i low = _mm512_and_si512(_mm512_srli_epi32(box, (unsigned)(4 * k)), field), high = _mm512_and_si512(_mm512_srli_epi32(box, (unsigned)(4 * k + 12)), field);
        low = _mm512_add_epi32(_mm512_sub_epi32(corner[k], margin), _mm512_sllv_epi32(low, sub));
        high = _mm512_add_epi32(_mm512_add_epi32(corner[k], beyond), _mm512_sllv_epi32(high, sub));
        __m512 a = _mm512_mul_ps(_mm512_cvtepi32_ps(low), l->step[k]), b = _mm512_mul_ps(_mm512_cvtepi32_ps(high), l->step[k]);
        enter = _mm512_max_ps(_mm512_min_ps(a, b), enter);
        leave = _mm512_min_ps(_mm512_max_ps(a, b), leave);
    }
    return _mm512_cmp_ps_mask(enter, leave, _CMP_GT_OQ);
}

/* 16 lanes with their stack, and what the parts of a round hand on. */
typedef struct group {
    lanes l;
    __m512i stack[SVOI_RAYS_LEVELS]; /* nodes on the way down, from the finest */
    __mmask16 active, finished, missed, down, go;
    __m512i node[4], w, block, bit, child;
    __mmask16 upper;
    __m512i out[3];
    pair t[3], nearest;
} group;

/* Results of lanes that have finished with something to tell. */
INLINE void flush(const group *g, const svo_rays *r, bool lod, __mmask16 m, svoi_ray_batch *b)
{
    const lanes *l = &g->l;
    const uint32_t low_count = (uint32_t)__builtin_popcount(m & 0xff);
    _mm512_storeu_si512(&b->found_ray[b->found], _mm512_maskz_compress_epi32(m, l->ray));
    _mm512_storeu_si512(&b->state[b->found], _mm512_maskz_compress_epi32(m, l->state));
    for (int k = 0; k < 3; k++) _mm512_storeu_si512(&b->at[k][b->found], _mm512_maskz_compress_epi32(m, l->q[k]));
    if (!lod) {
        /* A ray in a finest voxel is where it entered it, or where it began: the last plane that it has crossed is the voxel's. */
        const __m512i size = word(1 << r->fraction), keep = word(-(1 << r->fraction));
        __m512i face = word(SVO_FACE_INSIDE);
        for (int k = 2; k >= 0; k--) {
            const __m512i near = _mm512_add_epi32(_mm512_and_si512(l->q[k], keep), _mm512_and_si512(l->backward[k], size));
            const __mmask16 entered = both(_mm512_cmp_pd_mask(_mm512_mul_pd(_mm512_sub_pd(low_doubles(near), l->o[k].a), l->inv[k].a), l->t.a, _CMP_GE_OQ),
                                           _mm512_cmp_pd_mask(_mm512_mul_pd(_mm512_sub_pd(high_doubles(near), l->o[k].b), l->inv[k].b), l->t.b, _CMP_GE_OQ));
            face = choose(entered, _mm512_sub_epi32(word(2 * k), l->backward[k]), face);
        }
        _mm512_storeu_si512(&b->face_found[b->found], _mm512_maskz_compress_epi32(m, face));
        _mm512_storeu_pd(&b->t_found[b->found], _mm512_maskz_compress_pd((__mmask8)m, l->t.a));
        _mm512_storeu_pd(&b->t_found[b->found + low_count], _mm512_maskz_compress_pd((__mmask8)(m >> 8), l->t.b));
    }
    if (b->numbers) {
        /* of the node itself, and of those above it but the root */
        const __mmask16 hit = _mm512_mask_cmpneq_epi32_mask(m, l->state, word(SVOI_RAY_DOUBT));
        const __m512i zero = _mm512_setzero_si512();
        __m512i sum = _mm512_srli_epi32(_mm512_mask_i32gather_epi32(zero, hit, l->node, r->before, 4), 1);
        for (uint32_t k = 1; k + 1 < r->levels; k++) {
            __mmask16 above = _mm512_mask_cmplt_epi32_mask(hit, l->s, word((int)(r->fraction + 2 * k)));
            sum = _mm512_add_epi32(sum, _mm512_srli_epi32(_mm512_mask_i32gather_epi32(zero, above, g->stack[k], r->before, 4), 1));
        }
        _mm512_storeu_si512(&b->node_found[b->found], _mm512_maskz_compress_epi32(m, l->node));
        _mm512_storeu_si512(&b->base[b->found], _mm512_maskz_compress_epi32(m, sum));
    }
    b->found += (uint32_t)__builtin_popcount(m);
}

/* New rays where few are left; false when there is nothing to do any more. */
INLINE bool refill(group *g, const svo_rays *r, svoi_ray_batch *b, bool lod, bool start, uint32_t *next)
{
    if (__builtin_popcount(g->active) > REFILL) return true;
    uint32_t rest = (start ? b->starts : b->count) - *next;
    if (rest == 0) return g->active != 0;
    if (g->finished != 0) flush(g, r, lod, g->finished, b);
    g->finished = 0;
    __mmask16 empty = (__mmask16)~g->active;
    uint32_t space = (uint32_t)__builtin_popcount(empty), taken = space < rest ? space : rest;
    __mmask16 m = (__mmask16)_pdep_u32((1u << taken) - 1, empty);
    fill(&g->l, start ? &b->start : &b->in, lod, m, *next);
    g->l.s = _mm512_mask_expand_epi32(g->l.s, m, _mm512_loadu_si512(&b->s[*next]));
    g->l.node = _mm512_mask_expand_epi32(g->l.node, m, _mm512_loadu_si512(&b->node[*next]));
    for (uint32_t k = 1; k < r->levels; k++) g->stack[k] = _mm512_mask_expand_epi32(g->stack[k], m, _mm512_loadu_si512(&b->stack[k][*next]));
    *next += taken;
    g->active |= m;
    return true;
}

/* The cell, and whether it is filled. */
INLINE void look(group *g, const svo_rays *r)
{
    const __m512i three = word(3), s = g->l.s;
    __mmask16 brick = _mm512_cmpeq_epi32_mask(s, word((int)r->fraction));
    g->missed &= (__mmask16)~brick;
    __m512i x = _mm512_and_si512(_mm512_srlv_epi32(g->l.q[0], s), three), y = _mm512_and_si512(_mm512_srlv_epi32(g->l.q[1], s), three);
    __m512i z = _mm512_and_si512(_mm512_srlv_epi32(g->l.q[2], s), three);
    __m512i c = _mm512_ternarylogic_epi32(x, _mm512_slli_epi32(y, 2), _mm512_slli_epi32(z, 4), 0xfe);
    g->upper = _mm512_cmpge_epi32_mask(z, word(2));
    g->w = choose(g->upper, g->node[1], g->node[0]);
    g->block = _mm512_and_si512(_mm512_srlv_epi32(g->w, _mm512_and_si512(c, word(0x0a))), word(0x00330033));
    g->bit = _mm512_sllv_epi32(word(1), _mm512_and_si512(c, word(31)));
}

/* Who has hit, who goes down, and to which child: as many further as there are filled cells before it. */
INLINE void decide(group *g, const svo_rays *r, bool lod)
{
    const __m512i one = word(1), s = g->l.s;
    __mmask16 here = g->active & (__mmask16)~g->missed, filled = _mm512_mask_test_epi32_mask(here, g->w, g->bit);
    __mmask16 hit = _mm512_mask_cmpeq_epi32_mask(filled, s, word((int)r->fraction));
    if (lod) {
        /* blocks of 2x2x2 cells, then cells, that are small enough and not empty */
        pair limit = limit_at(&g->l, g->l.t);
        __mmask16 stop2 = _mm512_mask_test_epi32_mask(here, g->block, g->block) & within(_mm512_add_epi32(s, one), limit);
        hit = (hit | (filled & within(s, limit))) & (__mmask16)~stop2;
        g->l.state = _mm512_mask_add_epi32(g->l.state, stop2, s, word(2));
        g->active &= (__mmask16)~stop2;
        g->finished |= stop2;
        filled &= (__mmask16)~stop2;
    }
    g->l.state = _mm512_mask_add_epi32(g->l.state, hit, s, one);
    g->finished |= hit;
    g->active &= (__mmask16)~hit;
    g->down = filled & (__mmask16)~hit;
    g->go = g->active & (__mmask16)~g->down;
    __m512i rank = _mm512_popcnt_epi32(_mm512_and_si512(g->w, _mm512_sub_epi32(g->bit, one)));
    rank = _mm512_mask_add_epi32(rank, g->upper, rank, _mm512_popcnt_epi32(g->node[0]));
    rank = _mm512_mask_slli_epi32(rank, _mm512_cmpneq_epi32_mask(s, word((int)r->fraction + 2)), rank, 1);
    g->child = _mm512_add_epi32(g->node[2], rank);
}

/* Where the ray leaves the cell, the empty block of 2x2x2 cells, or the whole node. */
INLINE void leave(group *g)
{
    __m512i s = g->l.s, edge = _mm512_mask_add_epi32(s, _mm512_testn_epi32_mask(g->block, g->block), s, word(1));
    edge = _mm512_mask_add_epi32(edge, g->missed, s, word(2));
    __m512i size = _mm512_sllv_epi32(word(1), edge), keep = _mm512_sllv_epi32(word(-1), edge);
    for (int k = 0; k < 3; k++) {
        g->out[k] = _mm512_add_epi32(_mm512_and_si512(g->l.q[k], keep), _mm512_and_si512(size, g->l.positive[k]));
        g->t[k].a = _mm512_mul_pd(_mm512_sub_pd(low_doubles(g->out[k]), g->l.o[k].a), g->l.inv[k].a);
        g->t[k].b = _mm512_mul_pd(_mm512_sub_pd(high_doubles(g->out[k]), g->l.o[k].b), g->l.inv[k].b);
    }
    g->nearest.a = _mm512_min_pd(_mm512_min_pd(g->t[0].a, g->t[1].a), g->t[2].a);
    g->nearest.b = _mm512_min_pd(_mm512_min_pd(g->t[0].b, g->t[1].b), g->t[2].b);
}

/* Take the step: the next node and the place in it. */
INLINE void step(group *g, const svo_rays *r)
{
    const __m512i one = word(1), unit_mask = word((1 << r->fraction) - 1), s = g->l.s;
    const pair nearest = g->nearest;
    const __mmask16 go = g->go, down = g->down;
    g->l.t.a = _mm512_mask_mov_pd(g->l.t.a, (__mmask8)go, nearest.a);
    g->l.t.b = _mm512_mask_mov_pd(g->l.t.b, (__mmask8)(go >> 8), nearest.b);
    __mmask16 late = both(_mm512_cmp_pd_mask(nearest.a, g->l.t_max.a, _CMP_GT_OQ), _mm512_cmp_pd_mask(nearest.b, g->l.t_max.b, _CMP_GT_OQ)), doubt = 0;
    __m512i changed = _mm512_setzero_si512();
    for (int k = 0; k < 3; k++) {
        __mmask16 through = both(_mm512_cmp_pd_mask(g->t[k].a, nearest.a, _CMP_LE_OQ), _mm512_cmp_pd_mask(g->t[k].b, nearest.b, _CMP_LE_OQ));
        __m256i e = _mm512_cvttpd_epi32(_mm512_fmadd_pd(g->l.d[k].a, nearest.a, g->l.o[k].a));
        __m256i f = _mm512_cvttpd_epi32(_mm512_fmadd_pd(g->l.d[k].b, nearest.b, g->l.o[k].b));
        __m512i to = _mm512_inserti64x4(_mm512_castsi256_si512(e), f, 1);
        doubt |= (__mmask16)~through & _mm512_cmple_epu32_mask(_mm512_and_si512(_mm512_add_epi32(to, one), unit_mask), one);
        to = _mm512_mask_add_epi32(to, through, g->out[k], g->l.backward[k]);
        changed = _mm512_ternarylogic_epi32(changed, to, g->l.q[k], 0xf6); /* changed | (to ^ q) */
        g->l.q[k] = choose(go, to, g->l.q[k]);
    }
    __m512i top = _mm512_sub_epi32(word(31), _mm512_lzcnt_epi32(changed));
    /* the highest bit that changed names the ancestor */
    __mmask16 up = _mm512_mask_cmpgt_epi32_mask(go, top, _mm512_add_epi32(s, one));
    __m512i to_s = _mm512_mask_and_epi32(_mm512_mask_sub_epi32(s, down, s, word(2)), up, top, word(SVOI_RAYS_BITS)); /* even */
    __m512i to_node = choose(down, g->child, g->l.node);
    for (uint32_t k = 1; k < r->levels; k++) {
        __m512i level = word((int)(r->fraction + 2 * k)), kept = choose(_mm512_cmpeq_epi32_mask(s, level), g->l.node, g->stack[k]);
        g->stack[k] = kept;
        to_node = choose(_mm512_mask_cmpeq_epi32_mask(up, to_s, level), kept, to_node);
    }
    g->l.s = to_s;
    g->l.node = to_node;
    doubt &= go & (__mmask16)~late;
    __mmask16 gone = go & (late | (_mm512_cmpge_epi32_mask(top, word(SVOI_RAYS_BITS)) & (__mmask16)~doubt));
    g->active &= (__mmask16)~(gone | doubt);
    g->l.state = choose(doubt, word(SVOI_RAY_DOUBT), g->l.state);
    g->finished |= doubt;
}

/* The way down to where rays begin, all levels with all lanes. What is found out on the way about where a ray can hit anything at all makes t_max smaller: rays that leave a
 * surface miss what is in every node around them, one after the other. */
INLINE void begin(const svo_rays *r, bool lod, svoi_ray_list *l, svoi_ray_batch *b, uint32_t i, uint32_t count)
{
    const __m512i one = word(1), three = word(3), field = word(15);
    const __m512i q[3] = {_mm512_loadu_si512(&l->q[0][i]), _mm512_loadu_si512(&l->q[1][i]), _mm512_loadu_si512(&l->q[2][i])};
    __mmask16 down = count >= 16 ? 0xffff : (__mmask16)((1u << count) - 1), alone = down, positive[3];
    __m512i node = _mm512_setzero_si512(), at = word(SVOI_RAYS_BITS - 2);
    __m512 step[3], reach = _mm512_set1_ps(INFINITY); /* alone: no hits but in this node; then they are at most so far away */
    pair limit = {_mm512_setzero_pd(), _mm512_setzero_pd()}, t = {_mm512_loadu_pd(&l->t[i]), _mm512_loadu_pd(&l->t[i + 8])};
    for (int k = 0; k < 3; k++) {
        step[k] = _mm512_insertf32x8(_mm512_castps256_ps512(_mm512_cvtpd_ps(_mm512_loadu_pd(&l->inv[k][i]))), _mm512_cvtpd_ps(_mm512_loadu_pd(&l->inv[k][i + 8])), 1);
        positive[k] = (__mmask16)~_mm512_movepi32_mask(_mm512_castps_si512(step[k]));
    }
    if (lod) {
        limit.a = _mm512_add_pd(_mm512_mul_pd(_mm512_loadu_pd(&l->spread[i]), t.a), _mm512_loadu_pd(&l->offset[i]));
        limit.b = _mm512_add_pd(_mm512_mul_pd(_mm512_loadu_pd(&l->spread[i + 8]), t.b), _mm512_loadu_pd(&l->offset[i + 8]));
    }
    for (uint32_t level = r->levels - 1, s = SVOI_RAYS_BITS - 2; level > 0; level--, s -= 2) {
        __m512i units[4];
        load_nodes(r->units, node, units);
        if (!lod && __builtin_popcount(alone) >= WORTH) {
            /* as in misses_box */
            const int32_t size = (int32_t)1 << s, margin = (1 << 15 >> (30 - s)) + 2;
            const __m512i keep = word(-(4 * size)), keep_cell = word(-size);
            __m512 enter = _mm512_setzero_ps(), leave = _mm512_set1_ps(INFINITY), leave_cell = leave;
            for (int k = 0; k < 3; k++) {
                const __m512i corner = _mm512_sub_epi32(_mm512_and_si512(q[k], keep), q[k]), cell = _mm512_sub_epi32(_mm512_and_si512(q[k], keep_cell), q[k]);
                __m512i low = _mm512_and_si512(_mm512_srli_epi32(units[3], (unsigned)(4 * k)), field), high = _mm512_and_si512(_mm512_srli_epi32(units[3], (unsigned)(4 * k + 12)), field);
                low = _mm512_add_epi32(_mm512_sub_epi32(corner, word(margin)), _mm512_slli_epi32(low, s - 2));
                high = _mm512_add_epi32(_mm512_add_epi32(corner, word(margin + size / 4)), _mm512_slli_epi32(high, s - 2));
                const __m512i far = _mm512_add_epi32(cell, _mm512_mask_mov_epi32(word(2), positive[k], word(size - 2)));
                const __m512 x = _mm512_mul_ps(_mm512_cvtepi32_ps(low), step[k]), y = _mm512_mul_ps(_mm512_cvtepi32_ps(high), step[k]);
                enter = _mm512_max_ps(_mm512_min_ps(x, y), enter);
                leave = _mm512_min_ps(_mm512_max_ps(x, y), leave);
                leave_cell = _mm512_min_ps(_mm512_mul_ps(_mm512_cvtepi32_ps(far), step[k]), leave_cell);
            }
            const __mmask16 missed = _mm512_mask_cmp_ps_mask(down, enter, leave, _CMP_GT_OQ);
            down &= (__mmask16)~missed;
            alone &= down | missed;
            reach = _mm512_mask_min_ps(reach, alone, reach, leave);
            reach = _mm512_mask_mov_ps(reach, alone & missed, _mm512_setzero_ps());
            alone &= _mm512_cmp_ps_mask(reach, _mm512_mul_ps(leave_cell, _mm512_set1_ps(0.99999f)), _CMP_LE_OQ);
        }
        const __m512i x = _mm512_and_si512(_mm512_srli_epi32(q[0], s), three), y = _mm512_and_si512(_mm512_srli_epi32(q[1], s), three), z = _mm512_and_si512(_mm512_srli_epi32(q[2], s), three);
        const __m512i c = _mm512_ternarylogic_epi32(x, _mm512_slli_epi32(y, 2), _mm512_slli_epi32(z, 4), 0xfe), bit = _mm512_sllv_epi32(one, _mm512_and_si512(c, word(31)));
        const __mmask16 upper = _mm512_cmpge_epi32_mask(z, word(2));
        const __m512i w = choose(upper, units[1], units[0]);
        down = _mm512_mask_test_epi32_mask(down, w, bit);
        if (lod) down &= (__mmask16)~within(word((int)s), limit); /* one that is small enough may be a hit */
        alone &= down;
        if (down == 0) break;
        __m512i rank = _mm512_popcnt_epi32(_mm512_and_si512(w, _mm512_sub_epi32(bit, one)));
        rank = _mm512_mask_add_epi32(rank, upper, rank, _mm512_popcnt_epi32(units[0]));
        if (level > 1) rank = _mm512_slli_epi32(rank, 1);
        _mm512_storeu_si512(&b->stack[level][i], node);
        node = _mm512_mask_add_epi32(node, down, units[2], rank);
        at = _mm512_mask_sub_epi32(at, down, at, word(2));
    }
    _mm512_storeu_si512(&b->s[i], at);
    _mm512_storeu_si512(&b->node[i], node);
    if (lod) return;
    reach = _mm512_mul_ps(reach, _mm512_set1_ps(1.00001f));
    t.a = _mm512_min_pd(_mm512_add_pd(t.a, _mm512_cvtps_pd(_mm512_castps512_ps256(reach))), _mm512_loadu_pd(&l->t_max[i]));
    t.b = _mm512_min_pd(_mm512_add_pd(t.b, _mm512_cvtps_pd(_mm512_extractf32x8_ps(reach, 1))), _mm512_loadu_pd(&l->t_max[i + 8]));
    _mm512_storeu_pd(&l->t_max[i], t.a), _mm512_storeu_pd(&l->t_max[i + 8], t.b);
}

void svoi_rays_begin_avx512(const svo_rays *r, bool lod, svoi_ray_list *l, svoi_ray_batch *b, uint32_t first, uint32_t count)
{
    for (uint32_t i = 0; i < count; i += 16) lod ? begin(r, true, l, b, first + i, count - i) : begin(r, false, l, b, first + i, count - i);
}

/* Two groups take turns part by part: while one waits for its last result the other works. */
enum { GROUPS = 2 };

/* Rays that a packet has brought to a node where their cells are filled go down, as in `begin`. */
INLINE void sink(const svo_rays *r, svoi_ray_batch *b)
{
    const __m512i one = word(1), three = word(3), brick = word((int)r->fraction);
    for (uint32_t i = 0; i < b->starts; i += 16) {
        const svoi_ray_list *l = &b->start;
        const __m512i q[3] = {_mm512_loadu_si512(&l->q[0][i]), _mm512_loadu_si512(&l->q[1][i]), _mm512_loadu_si512(&l->q[2][i])};
        __m512i s = _mm512_loadu_si512(&b->s[i]), node = _mm512_loadu_si512(&b->node[i]);
        __mmask16 down = b->starts - i >= 16 ? 0xffff : (__mmask16)((1u << (b->starts - i)) - 1);
        while ((down = _mm512_mask_cmpneq_epi32_mask(down, s, brick)) != 0) {
            __m512i units[4];
            load_nodes(r->units, _mm512_maskz_mov_epi32(down, node), units);
            const __m512i x = _mm512_and_si512(_mm512_srlv_epi32(q[0], s), three), y = _mm512_and_si512(_mm512_srlv_epi32(q[1], s), three), z = _mm512_and_si512(_mm512_srlv_epi32(q[2], s), three);
            const __m512i c = _mm512_ternarylogic_epi32(x, _mm512_slli_epi32(y, 2), _mm512_slli_epi32(z, 4), 0xfe), bit = _mm512_sllv_epi32(one, _mm512_and_si512(c, word(31)));
            const __mmask16 upper = _mm512_cmpge_epi32_mask(z, word(2));
            const __m512i w = choose(upper, units[1], units[0]);
            down = _mm512_mask_test_epi32_mask(down, w, bit);
            __m512i rank = _mm512_popcnt_epi32(_mm512_and_si512(w, _mm512_sub_epi32(bit, one)));
            rank = _mm512_mask_add_epi32(rank, upper, rank, _mm512_popcnt_epi32(units[0]));
            rank = _mm512_mask_slli_epi32(rank, _mm512_cmpneq_epi32_mask(s, word((int)r->fraction + 2)), rank, 1);
            for (uint32_t k = 1; k < r->levels; k++)
                _mm512_mask_storeu_epi32(&b->stack[k][i], _mm512_mask_cmpeq_epi32_mask(down, s, word((int)(r->fraction + 2 * k))), node);
            node = _mm512_mask_add_epi32(node, down, units[2], rank);
            s = _mm512_mask_sub_epi32(s, down, s, word(2));
        }
        _mm512_storeu_si512(&b->s[i], s);
        _mm512_storeu_si512(&b->node[i], node);
    }
}

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
        for (int i = 0; i < GROUPS; i++) load_nodes(r->units, g[i].l.node, g[i].node);
        for (int i = 0; i < GROUPS; i++) g[i].missed = misses_box(&g[i].l, g[i].node[3], lod);
        for (int i = 0; i < GROUPS; i++) look(&g[i], r);
        for (int i = 0; i < GROUPS; i++) leave(&g[i]);
        for (int i = 0; i < GROUPS; i++) decide(&g[i], r, lod);
        for (int i = 0; i < GROUPS; i++) step(&g[i], r);
    }
    for (int i = 0; i < GROUPS; i++)
        if (g[i].finished != 0) flush(&g[i], r, lod, g[i].finished, b);
}

void svoi_rays_trace_avx512(const svo_rays *r, bool lod, bool start, svoi_ray_batch *b)
{
    if (lod && start) trace(r, true, true, b);
    else if (lod) trace(r, true, false, b);
    else if (start) trace(r, false, true, b);
    else trace(r, false, false, b);
}
#else
bool svoi_rays_have_avx512(void) { return false; }
bool svoi_rays_prepare_avx512(const svo_rays *r, const svo_ray *rays, uint32_t count, svoi_ray_batch *b)
{
    (void)r, (void)rays, (void)count, (void)b;
    return false;
}
void svoi_rays_begin_avx512(const svo_rays *r, bool lod, svoi_ray_list *l, svoi_ray_batch *b, uint32_t first, uint32_t count) { (void)r, (void)lod, (void)l, (void)b, (void)first, (void)count; }
void svoi_rays_trace_avx512(const svo_rays *r, bool lod, bool start, svoi_ray_batch *b) { (void)r, (void)lod, (void)start, (void)b; }
#endif
