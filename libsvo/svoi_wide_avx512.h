/* Internal to libsvo: 16 doubles, and a beam against a node, with AVX-512. Not installed. */
#ifndef SVOI_WIDE_AVX512_H
#define SVOI_WIDE_AVX512_H

#include <immintrin.h>
#include <stdint.h>

#define INLINE static inline __attribute__((always_inline))

typedef struct wide { __m512d a, b; } wide;

INLINE wide wide_load(const double *p) { return (wide){_mm512_loadu_pd(p), _mm512_loadu_pd(p + 8)}; }
INLINE wide wide_set(double x) { return (wide){_mm512_set1_pd(x), _mm512_set1_pd(x)}; }
INLINE wide wide_add(wide x, wide y) { return (wide){_mm512_add_pd(x.a, y.a), _mm512_add_pd(x.b, y.b)}; }
INLINE wide wide_sub(wide x, wide y) { return (wide){_mm512_sub_pd(x.a, y.a), _mm512_sub_pd(x.b, y.b)}; }
INLINE wide wide_mul(wide x, wide y) { return (wide){_mm512_mul_pd(x.a, y.a), _mm512_mul_pd(x.b, y.b)}; }
INLINE wide wide_min(wide x, wide y) { return (wide){_mm512_min_pd(x.a, y.a), _mm512_min_pd(x.b, y.b)}; }
INLINE wide wide_max(wide x, wide y) { return (wide){_mm512_max_pd(x.a, y.a), _mm512_max_pd(x.b, y.b)}; }
INLINE wide wide_abs(wide x) { return (wide){_mm512_abs_pd(x.a), _mm512_abs_pd(x.b)}; }
INLINE uint32_t wide_less(wide x, wide y) { return _mm512_cmp_pd_mask(x.a, y.a, _CMP_LT_OQ) | (uint32_t)_mm512_cmp_pd_mask(x.b, y.b, _CMP_LT_OQ) << 8; }
INLINE uint32_t wide_at_most(wide x, wide y) { return _mm512_cmp_pd_mask(x.a, y.a, _CMP_LE_OQ) | (uint32_t)_mm512_cmp_pd_mask(x.b, y.b, _CMP_LE_OQ) << 8; }
INLINE uint32_t wide_signs(wide x) { return _mm512_movepi64_mask(_mm512_castpd_si512(x.a)) | (uint32_t)_mm512_movepi64_mask(_mm512_castpd_si512(x.b)) << 8; }
/* The largest double below x; x is not -infinity. */
INLINE __m512d before8(__m512d x)
{
    const __m512i one = _mm512_set1_epi64(1), bits = _mm512_castpd_si512(x);
    __m512i y = _mm512_mask_sub_epi64(_mm512_add_epi64(bits, one), _mm512_cmp_pd_mask(x, _mm512_setzero_pd(), _CMP_GT_OQ), bits, one);
    return _mm512_mask_mov_pd(_mm512_castsi512_pd(y), _mm512_cmp_pd_mask(x, _mm512_setzero_pd(), _CMP_EQ_OQ), _mm512_set1_pd(-0x1p-1074));
}
INLINE wide wide_before(wide x) { return (wide){before8(x.a), before8(x.b)}; }
INLINE double wide_least(wide x) { return _mm512_reduce_min_pd(_mm512_min_pd(x.a, x.b)); }
INLINE double wide_most(wide x) { return _mm512_reduce_max_pd(_mm512_max_pd(x.a, x.b)); }

/* Cells between the bounds: of axis v from floor(low) to floor(high), of w the same, in each of four layers. Bounds of layer i are those
 * at u; offset, slope and layer are of v, those of w follow 8 floats later. */
INLINE uint64_t touch(const uint64_t *below_v, const uint64_t *below_w, const uint64_t *layers, const float *offset, const float *slope, const float *layer,
                      float u, float v, float w, float scale)
{
    const __m512i zero = _mm512_setzero_si512(), four = _mm512_set1_epi64(4);
    __m256 at = _mm256_set1_ps(u), unit = _mm256_set1_ps(scale);
    __m256 x = _mm256_fmadd_ps(_mm256_load_ps(slope), at, _mm256_sub_ps(_mm256_load_ps(offset), _mm256_set1_ps(v)));
    __m256 y = _mm256_fmadd_ps(_mm256_load_ps(slope + 8), at, _mm256_sub_ps(_mm256_load_ps(offset + 8), _mm256_set1_ps(w)));
    x = _mm256_fmadd_ps(x, unit, _mm256_load_ps(layer));
    y = _mm256_fmadd_ps(y, unit, _mm256_load_ps(layer + 8));
    __m512i i = _mm512_cvt_roundps_epi64(x, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC), j = _mm512_cvt_roundps_epi64(y, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
    i = _mm512_permutexvar_epi64(_mm512_max_epi64(_mm512_min_epi64(i, four), zero), _mm512_loadu_si512(below_v));
    j = _mm512_permutexvar_epi64(_mm512_max_epi64(_mm512_min_epi64(j, four), zero), _mm512_loadu_si512(below_w));
    __m256i rows = _mm256_andnot_si256(_mm512_castsi512_si256(i), _mm512_extracti64x4_epi64(i, 1));
    __m256i columns = _mm256_andnot_si256(_mm512_castsi512_si256(j), _mm512_extracti64x4_epi64(j, 1));
    __m256i cells = _mm256_ternarylogic_epi64(rows, columns, _mm256_loadu_si256((const __m256i *)layers), 0x80);
    __m128i half = _mm_or_si128(_mm256_castsi256_si128(cells), _mm256_extracti128_si256(cells, 1));
    return (uint64_t)_mm_cvtsi128_si64(_mm_or_si128(half, _mm_unpackhi_epi64(half, half)));
}

INLINE void wide_fill(int32_t *to, int32_t x) { _mm512_storeu_si512(to, _mm512_set1_epi32(x)); }

INLINE void keep_doubles(double *to, __mmask16 m, wide x)
{
    _mm512_storeu_pd(to, _mm512_maskz_compress_pd((__mmask8)m, x.a));
    _mm512_storeu_pd(to + __builtin_popcount(m & 0xff), _mm512_maskz_compress_pd((__mmask8)(m >> 8), x.b));
}
INLINE void keep_words(int32_t *to, __mmask16 m, __m512i x) { _mm512_storeu_si512(to, _mm512_maskz_compress_epi32(m, x)); }

/* The rays `hits` of the 16 from `i` on have met a cell of a node, which they enter at `in` through the first plane for which plane[k] == in. */
INLINE void keep_found(svoi_ray_batch *b, uint32_t i, uint32_t hits, wide in, const wide plane[3], uint8_t negative, const int32_t at[3], int32_t state, int32_t node, int32_t base)
{
    __m512i face = _mm512_set1_epi32(SVO_FACE_INSIDE);
    for (int k = 2; k >= 0; k--) face = _mm512_mask_mov_epi32(face, (__mmask16)wide_at_most(in, plane[k]), _mm512_set1_epi32(2 * k + (negative >> k & 1)));
    keep_doubles(&b->t_found[b->found], (__mmask16)hits, in);
    keep_words(&b->face_found[b->found], (__mmask16)hits, face);
    keep_words(&b->found_ray[b->found], (__mmask16)hits, _mm512_loadu_si512(&b->in.ray[i]));
    wide_fill(&b->state[b->found], state);
    for (int k = 0; k < 3; k++) wide_fill(&b->at[k][b->found], at[k]);
    wide_fill(&b->node_found[b->found], node), wide_fill(&b->base[b->found], base);
    b->found += (uint32_t)__builtin_popcount(hits);
}

/* Fixed-point positions of the 16 rays from `i` on where they enter something at `in`, through the planes for which plane[k] == in; side[k] is the cell before such a
 * plane. Those for which it is not certain in which finest voxel they are then; with `trust`, a ray that begins there is where the list says, perhaps on a plane. */
INLINE __mmask16 enter_at(const svoi_ray_batch *b, uint32_t i, wide in, const wide plane[3], const int32_t side[3], int32_t unit_mask, bool trust, __m512i q[3])
{
    const __m512i one = _mm512_set1_epi32(1);
    const wide t = wide_load(&b->in.t[i]);
    const __mmask16 begin = trust ? (__mmask16)wide_at_most(in, t) : 0; /* where the ray begins its place is known */
    __mmask16 doubt = 0;
    for (int k = 0; k < 3; k++) {
        wide d = wide_load(&b->in.d[k][i]), o = wide_load(&b->in.o[k][i]);
        __mmask16 through = (__mmask16)wide_at_most(in, plane[k]);
        __m256i x = _mm512_cvttpd_epi32(_mm512_fmadd_pd(d.a, in.a, o.a)), y = _mm512_cvttpd_epi32(_mm512_fmadd_pd(d.b, in.b, o.b));
        q[k] = _mm512_inserti64x4(_mm512_castsi256_si512(x), y, 1);
        q[k] = _mm512_mask_loadu_epi32(q[k], begin, &b->in.q[k][i]);
        doubt |= (__mmask16)~(through | begin) & _mm512_cmple_epu32_mask(_mm512_and_si512(_mm512_add_epi32(q[k], one), _mm512_set1_epi32(unit_mask)), one);
        q[k] = _mm512_mask_mov_epi32(q[k], through, _mm512_set1_epi32(side[k]));
    }
    return doubt;
}

INLINE void keep_doubt(svoi_ray_batch *b, __mmask16 m, __m512i ray)
{
    keep_words(&b->found_ray[b->found], m, ray);
    wide_fill(&b->state[b->found], SVOI_RAY_DOUBT);
    b->found += (uint32_t)__builtin_popcount(m);
}

/* The rays `met` of the 16 from `i` on hit a finest voxel where they enter something; see enter_at. Neither node_found nor base is set. */
INLINE void find_rays(svoi_ray_batch *b, uint32_t i, uint32_t met, wide in, const wide plane[3], const int32_t side[3], int32_t fraction, uint8_t negative)
{
    __m512i q[3], ray = _mm512_loadu_si512(&b->in.ray[i]), face = _mm512_set1_epi32(SVO_FACE_INSIDE);
    const __mmask16 doubt = (__mmask16)met & enter_at(b, i, in, plane, side, (1 << fraction) - 1, false, q), m = (__mmask16)met & (__mmask16)~doubt;
    if (doubt != 0) keep_doubt(b, doubt, ray);
    for (int k = 2; k >= 0; k--) face = _mm512_mask_mov_epi32(face, (__mmask16)wide_at_most(in, plane[k]), _mm512_set1_epi32(2 * k + (negative >> k & 1)));
    keep_doubles(&b->t_found[b->found], m, in);
    keep_words(&b->face_found[b->found], m, face);
    keep_words(&b->found_ray[b->found], m, ray);
    wide_fill(&b->state[b->found], fraction + 1);
    for (int k = 0; k < 3; k++) keep_words(&b->at[k][b->found], m, q[k]);
    b->found += (uint32_t)__builtin_popcount(m);
}

/* The rays `met` of the 16 from `i` on set out at `in`, and end at t_max, through the planes for which plane[k] == in; see enter_at. Where it is not
 * certain in which finest voxel they are they count as found, in doubt. */
INLINE void start_rays(svoi_ray_batch *b, bool lod, uint32_t i, uint32_t met, wide in, wide t_max, const wide plane[3], const int32_t side[3], int32_t unit_mask)
{
    __m512i q[3], ray = _mm512_loadu_si512(&b->in.ray[i]);
    const __mmask16 doubt = (__mmask16)met & enter_at(b, i, in, plane, side, unit_mask, true, q), m = (__mmask16)met & (__mmask16)~doubt;
    if (doubt != 0) keep_doubt(b, doubt, ray);
    uint32_t to = b->starts;
    for (int k = 0; k < 3; k++) {
        keep_doubles(&b->start.o[k][to], m, wide_load(&b->in.o[k][i]));
        keep_doubles(&b->start.d[k][to], m, wide_load(&b->in.d[k][i]));
        keep_doubles(&b->start.inv[k][to], m, wide_load(&b->in.inv[k][i]));
        keep_words(&b->start.q[k][to], m, q[k]);
    }
    keep_doubles(&b->start.t[to], m, in);
    keep_doubles(&b->start.t_max[to], m, t_max);
    if (lod) keep_doubles(&b->start.spread[to], m, wide_load(&b->in.spread[i])), keep_doubles(&b->start.offset[to], m, wide_load(&b->in.offset[i]));
    keep_words(&b->start.ray[to], m, ray);
    b->starts += (uint32_t)__builtin_popcount(m);
}

#endif
