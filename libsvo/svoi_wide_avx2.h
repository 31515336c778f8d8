/* Internal to libsvo: 16 doubles, and a beam against a node, with AVX2: what svoi_wide_avx512.h has. Not installed. */
#ifndef SVOI_WIDE_AVX2_H
#define SVOI_WIDE_AVX2_H

#include "svoi_compress_avx2.h"

typedef struct wide { __m256d v[4]; } wide;

#define WIDE_OF(expression) \
    wide result; \
    for (int i = 0; i < 4; i++) result.v[i] = (expression); \
    return result

INLINE wide wide_load(const double *p) { WIDE_OF(_mm256_loadu_pd(p + 4 * i)); }
INLINE wide wide_set(double x) { WIDE_OF(_mm256_set1_pd(x)); }
INLINE wide wide_add(wide x, wide y) { WIDE_OF(_mm256_add_pd(x.v[i], y.v[i])); }
INLINE wide wide_sub(wide x, wide y) { WIDE_OF(_mm256_sub_pd(x.v[i], y.v[i])); }
INLINE wide wide_mul(wide x, wide y) { WIDE_OF(_mm256_mul_pd(x.v[i], y.v[i])); }
INLINE wide wide_min(wide x, wide y) { WIDE_OF(_mm256_min_pd(x.v[i], y.v[i])); }
INLINE wide wide_max(wide x, wide y) { WIDE_OF(_mm256_max_pd(x.v[i], y.v[i])); }
INLINE wide wide_abs(wide x) { WIDE_OF(_mm256_andnot_pd(_mm256_set1_pd(-0.0), x.v[i])); }
/* The largest double below x; x is not -infinity. */
INLINE __m256d before4(__m256d x)
{
    const __m256i one = _mm256_set1_epi64x(1), bits = _mm256_castpd_si256(x);
    const __m256d zero = _mm256_setzero_pd();
    __m256d y = _mm256_blendv_pd(_mm256_castsi256_pd(_mm256_add_epi64(bits, one)), _mm256_castsi256_pd(_mm256_sub_epi64(bits, one)), _mm256_cmp_pd(x, zero, _CMP_GT_OQ));
    return _mm256_blendv_pd(y, _mm256_set1_pd(-0x1p-1074), _mm256_cmp_pd(x, zero, _CMP_EQ_OQ));
}
INLINE wide wide_before(wide x) { WIDE_OF(before4(x.v[i])); }
#undef WIDE_OF

INLINE uint32_t wide_signs(wide x)
{
    uint32_t m = 0;
    for (int i = 0; i < 4; i++) m |= (uint32_t)_mm256_movemask_pd(x.v[i]) << 4 * i;
    return m;
}
INLINE uint32_t wide_less(wide x, wide y)
{
    uint32_t m = 0;
    for (int i = 0; i < 4; i++) m |= (uint32_t)_mm256_movemask_pd(_mm256_cmp_pd(x.v[i], y.v[i], _CMP_LT_OQ)) << 4 * i;
    return m;
}
INLINE uint32_t wide_at_most(wide x, wide y)
{
    uint32_t m = 0;
    for (int i = 0; i < 4; i++) m |= (uint32_t)_mm256_movemask_pd(_mm256_cmp_pd(x.v[i], y.v[i], _CMP_LE_OQ)) << 4 * i;
    return m;
}
INLINE double wide_least(wide x)
{
    __m256d m = _mm256_min_pd(_mm256_min_pd(x.v[0], x.v[1]), _mm256_min_pd(x.v[2], x.v[3]));
    __m128d h = _mm_min_pd(_mm256_castpd256_pd128(m), _mm256_extractf128_pd(m, 1));
    return _mm_cvtsd_f64(_mm_min_sd(h, _mm_unpackhi_pd(h, h)));
}
INLINE double wide_most(wide x)
{
    __m256d m = _mm256_max_pd(_mm256_max_pd(x.v[0], x.v[1]), _mm256_max_pd(x.v[2], x.v[3]));
    __m128d h = _mm_max_pd(_mm256_castpd256_pd128(m), _mm256_extractf128_pd(m, 1));
    return _mm_cvtsd_f64(_mm_max_sd(h, _mm_unpackhi_pd(h, h)));
}

/* Cells between the bounds: of axis v from floor(low) to floor(high), of w the same, in each of four layers. Bounds of layer i are those
 * at u; offset, slope and layer are of v, those of w follow 8 floats later. */
INLINE uint64_t touch(const uint64_t *below_v, const uint64_t *below_w, const uint64_t *layers, const float *offset, const float *slope, const float *layer,
                      float u, float v, float w, float scale)
{
    const __m256 zero = _mm256_setzero_ps(), four = _mm256_set1_ps(4);
    __m256 at = _mm256_set1_ps(u), unit = _mm256_set1_ps(scale);
    __m256 x = _mm256_fmadd_ps(_mm256_load_ps(slope), at, _mm256_sub_ps(_mm256_load_ps(offset), _mm256_set1_ps(v)));
    __m256 y = _mm256_fmadd_ps(_mm256_load_ps(slope + 8), at, _mm256_sub_ps(_mm256_load_ps(offset + 8), _mm256_set1_ps(w)));
    x = _mm256_fmadd_ps(x, unit, _mm256_load_ps(layer));
    y = _mm256_fmadd_ps(y, unit, _mm256_load_ps(layer + 8));
    _Alignas(32) int32_t i[8], j[8];
    _mm256_store_si256((__m256i *)i, _mm256_cvttps_epi32(_mm256_max_ps(_mm256_min_ps(x, four), zero)));
    _mm256_store_si256((__m256i *)j, _mm256_cvttps_epi32(_mm256_max_ps(_mm256_min_ps(y, four), zero)));
    uint64_t cells = 0;
    for (int k = 0; k < 4; k++) cells |= (below_v[i[4 + k]] & ~below_v[i[k]]) & (below_w[j[4 + k]] & ~below_w[j[k]]) & layers[k];
    return cells;
}

INLINE void wide_fill(int32_t *to, int32_t x)
{
    for (int i = 0; i < 16; i += 8) _mm256_storeu_si256((__m256i *)(to + i), _mm256_set1_epi32(x));
}

INLINE __m128i four_words(const int32_t *p) { return _mm_loadu_si128((const __m128i *)p); }
INLINE __m256d same(__m256d x, __m256d y) { return _mm256_cmp_pd(x, y, _CMP_LE_OQ); } /* x is nowhere below y */

/* Faces through which rays 4h to 4h + 3 of 16 enter something at `in`: of the first plane for which plane[k] == in. */
INLINE __m128i enter_faces(wide in, const wide plane[3], uint8_t negative, int h)
{
    __m128i face = _mm_set1_epi32(SVO_FACE_INSIDE);
    for (int k = 2; k >= 0; k--) face = _mm_blendv_epi8(face, _mm_set1_epi32(2 * k + (negative >> k & 1)), mask_words(same(in.v[h], plane[k].v[h])));
    return face;
}

/* The rays `hits` of the 16 from `i` on have met a cell of a node, which they enter at `in` through the first plane for which plane[k] == in. */
INLINE void keep_found(svoi_ray_batch *b, uint32_t i, uint32_t hits, wide in, const wide plane[3], uint8_t negative, const int32_t at[3], int32_t state, int32_t node, int32_t base)
{
    wide_fill(&b->state[b->found], state);
    for (int k = 0; k < 3; k++) wide_fill(&b->at[k][b->found], at[k]);
    wide_fill(&b->node_found[b->found], node), wide_fill(&b->base[b->found], base);
    for (int h = 0; h < 4; h++) {
        const uint32_t m = hits >> 4 * h & 15;
        if (m == 0) continue;
        keep_doubles(&b->t_found[b->found], m, in.v[h]);
        keep_words(&b->face_found[b->found], m, enter_faces(in, plane, negative, h));
        keep_words(&b->found_ray[b->found], m, four_words(&b->in.ray[i + 4 * (uint32_t)h]));
        b->found += (uint32_t)__builtin_popcount(m);
    }
}

/* Fixed-point positions of rays 4h to 4h + 3 of the 16 from `i` on where they enter something at `in`, through the planes for which plane[k] == in; side[k] is the cell before such
 * a plane. Those for which it is not certain in which finest voxel they are then; with `trust`, a ray that begins there is where the list says, perhaps on a plane. */
INLINE uint32_t enter_at(const svoi_ray_batch *b, uint32_t i, int h, wide in, const wide plane[3], const int32_t side[3], int32_t unit_mask, bool trust, __m128i q[3])
{
    const uint32_t from = i + 4 * (uint32_t)h;
    const __m128i one = _mm_set1_epi32(1);
    const __m128i begin = trust ? mask_words(same(in.v[h], _mm256_loadu_pd(&b->in.t[from]))) : _mm_setzero_si128(); /* where the ray begins its place is known */
    __m128i sure = _mm_set1_epi32(-1);
    for (int k = 0; k < 3; k++) {
        const __m128i through = mask_words(same(in.v[h], plane[k].v[h]));
        q[k] = _mm256_cvttpd_epi32(_mm256_fmadd_pd(_mm256_loadu_pd(&b->in.d[k][from]), in.v[h], _mm256_loadu_pd(&b->in.o[k][from])));
        const __m128i clear = _mm_cmpgt_epi32(_mm_and_si128(_mm_add_epi32(q[k], one), _mm_set1_epi32(unit_mask)), one);
        sure = _mm_and_si128(sure, _mm_or_si128(_mm_or_si128(through, begin), clear));
        q[k] = _mm_blendv_epi8(q[k], four_words(&b->in.q[k][from]), begin);
        q[k] = _mm_blendv_epi8(q[k], _mm_set1_epi32(side[k]), through);
    }
    return ~(uint32_t)_mm_movemask_ps(_mm_castsi128_ps(sure)) & 15;
}

INLINE void keep_doubt(svoi_ray_batch *b, uint32_t m, __m128i ray)
{
    keep_words(&b->found_ray[b->found], m, ray);
    _mm_storeu_si128((__m128i *)&b->state[b->found], _mm_set1_epi32(SVOI_RAY_DOUBT));
    b->found += (uint32_t)__builtin_popcount(m);
}

/* The rays `met` of the 16 from `i` on hit a finest voxel where they enter something; see enter_at. Neither node_found nor base is set. */
INLINE void find_rays(svoi_ray_batch *b, uint32_t i, uint32_t met, wide in, const wide plane[3], const int32_t side[3], int32_t fraction, uint8_t negative)
{
    for (int h = 0; h < 4; h++) {
        uint32_t m = met >> 4 * h & 15, doubt;
        __m128i q[3], ray = four_words(&b->in.ray[i + 4 * (uint32_t)h]);
        if (m == 0) continue;
        doubt = m & enter_at(b, i, h, in, plane, side, (1 << fraction) - 1, false, q);
        if (doubt != 0) keep_doubt(b, doubt, ray);
        m &= ~doubt;
        keep_doubles(&b->t_found[b->found], m, in.v[h]);
        keep_words(&b->face_found[b->found], m, enter_faces(in, plane, negative, h));
        keep_words(&b->found_ray[b->found], m, ray);
        _mm_storeu_si128((__m128i *)&b->state[b->found], _mm_set1_epi32(fraction + 1));
        for (int k = 0; k < 3; k++) keep_words(&b->at[k][b->found], m, q[k]);
        b->found += (uint32_t)__builtin_popcount(m);
    }
}

/* The rays `met` of the 16 from `i` on set out at `in`, and end at t_max, through the planes for which plane[k] == in; see enter_at. Where it is not
 * certain in which finest voxel they are they count as found, in doubt. */
INLINE void start_rays(svoi_ray_batch *b, bool lod, uint32_t i, uint32_t met, wide in, wide t_max, const wide plane[3], const int32_t side[3], int32_t unit_mask)
{
    for (int h = 0; h < 4; h++) {
        const uint32_t from = i + 4 * (uint32_t)h, to = b->starts;
        uint32_t m = met >> 4 * h & 15, doubt;
        __m128i q[3], ray = four_words(&b->in.ray[from]);
        if (m == 0) continue;
        doubt = m & enter_at(b, i, h, in, plane, side, unit_mask, true, q);
        if (doubt != 0) keep_doubt(b, doubt, ray);
        m &= ~doubt;
        for (int k = 0; k < 3; k++) {
            keep_doubles(&b->start.o[k][to], m, _mm256_loadu_pd(&b->in.o[k][from]));
            keep_doubles(&b->start.d[k][to], m, _mm256_loadu_pd(&b->in.d[k][from]));
            keep_doubles(&b->start.inv[k][to], m, _mm256_loadu_pd(&b->in.inv[k][from]));
            keep_words(&b->start.q[k][to], m, q[k]);
        }
        keep_doubles(&b->start.t[to], m, in.v[h]);
        keep_doubles(&b->start.t_max[to], m, t_max.v[h]);
        if (lod) keep_doubles(&b->start.spread[to], m, _mm256_loadu_pd(&b->in.spread[from])), keep_doubles(&b->start.offset[to], m, _mm256_loadu_pd(&b->in.offset[from]));
        keep_words(&b->start.ray[to], m, ray);
        b->starts += (uint32_t)__builtin_popcount(m);
    }
}

#endif
