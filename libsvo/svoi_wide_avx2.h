/* Internal to libsvo: 16 doubles, and a beam against a node, with AVX2: what svoi_wide_avx512.h has. Not installed. */
#ifndef SVOI_WIDE_AVX2_H
#define SVOI_WIDE_AVX2_H

#include <immintrin.h>
#include <stdint.h>

#define INLINE static inline __attribute__((always_inline))

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

/* Faces through which 16 rays enter something at `in`: of the first plane for which plane[k] == in. */
INLINE void enter_faces(wide in, const wide plane[3], uint8_t negative, uint8_t face[16])
{
    const uint32_t x = wide_at_most(in, plane[0]), y = wide_at_most(in, plane[1]), z = wide_at_most(in, plane[2]);
    const uint32_t back[3] = {negative & 1, negative >> 1 & 1, negative >> 2 & 1};
    for (uint32_t l = 0; l < 16; l++)
        face[l] = (uint8_t)(x >> l & 1 ? SVO_FACE_LOW_X + back[0] : y >> l & 1 ? SVO_FACE_LOW_Y + back[1] : z >> l & 1 ? SVO_FACE_LOW_Z + back[2] : SVO_FACE_INSIDE);
}

/* The rays `hits` of the 16 from `i` on have met a cell of a node, which they enter at `in` through the first plane for which plane[k] == in. */
INLINE void keep_found(svoi_ray_batch *b, uint32_t i, uint32_t hits, wide in, const wide plane[3], uint8_t negative, const int32_t at[3], int32_t state, int32_t node, int32_t base)
{
    _Alignas(32) double enter[16];
    uint8_t face[16];
    for (int h = 0; h < 4; h++) _mm256_store_pd(enter + 4 * h, in.v[h]);
    enter_faces(in, plane, negative, face);
    for (; hits != 0; hits &= hits - 1, b->found++) {
        const uint32_t lane = (uint32_t)__builtin_ctz(hits);
        b->found_ray[b->found] = b->in.ray[i + lane], b->t_found[b->found] = enter[lane], b->face_found[b->found] = face[lane];
        b->state[b->found] = state, b->node_found[b->found] = node, b->base[b->found] = base;
        for (int k = 0; k < 3; k++) b->at[k][b->found] = at[k];
    }
}

/* Fixed-point positions of 16 rays from `i` on where they enter something at `in`, through the planes for which plane[k] == in; side[k] is the cell before such
 * a plane. Those for which it is not certain in which finest voxel they are then; with `trust`, a ray that begins there is where the list says, perhaps on a plane. */
INLINE uint32_t enter_at(const svoi_ray_batch *b, uint32_t i, wide in, const wide plane[3], const int32_t side[3], int32_t unit_mask, bool trust, int32_t q[3][16])
{
    const uint32_t begin = trust ? wide_at_most(in, wide_load(&b->in.t[i])) : 0; /* where the ray begins its place is known */
    uint32_t doubt = 0;
    for (int k = 0; k < 3; k++) {
        const uint32_t through = wide_at_most(in, plane[k]);
        for (int h = 0; h < 4; h++)
            _mm_store_si128((__m128i *)&q[k][4 * h], _mm256_cvttpd_epi32(_mm256_fmadd_pd(_mm256_loadu_pd(&b->in.d[k][i + 4 * (uint32_t)h]), in.v[h], _mm256_loadu_pd(&b->in.o[k][i + 4 * (uint32_t)h]))));
        for (uint32_t lane = 0; lane < 16; lane++) {
            if (through >> lane & 1) q[k][lane] = side[k];
            else if (begin >> lane & 1) q[k][lane] = b->in.q[k][i + lane];
            else doubt |= (uint32_t)(((q[k][lane] + 1) & unit_mask) <= 1) << lane;
        }
    }
    return doubt;
}

/* The rays `met` of the 16 from `i` on hit a finest voxel where they enter something; see enter_at. Neither node_found nor base is set. */
INLINE void find_rays(svoi_ray_batch *b, uint32_t i, uint32_t met, wide in, const wide plane[3], const int32_t side[3], int32_t fraction, uint8_t negative)
{
    _Alignas(16) int32_t q[3][16];
    const uint32_t doubt = enter_at(b, i, in, plane, side, (1 << fraction) - 1, false, q);
    _Alignas(32) double enter[16];
    uint8_t face[16];
    for (int h = 0; h < 4; h++) _mm256_store_pd(enter + 4 * h, in.v[h]);
    enter_faces(in, plane, negative, face);
    for (; met != 0; met &= met - 1, b->found++) {
        const uint32_t lane = (uint32_t)__builtin_ctz(met);
        b->found_ray[b->found] = b->in.ray[i + lane], b->t_found[b->found] = enter[lane], b->face_found[b->found] = face[lane];
        b->state[b->found] = doubt >> lane & 1 ? SVOI_RAY_DOUBT : fraction + 1;
        for (int k = 0; k < 3; k++) b->at[k][b->found] = q[k][lane];
    }
}

/* The rays `met` of the 16 from `i` on set out at `in`, and end at t_max, through the planes for which plane[k] == in; see enter_at. Where it is not
 * certain in which finest voxel they are they count as found, in doubt. */
INLINE void start_rays(svoi_ray_batch *b, bool lod, uint32_t i, uint32_t met, wide in, wide t_max, const wide plane[3], const int32_t side[3], int32_t unit_mask)
{
    _Alignas(32) double enter[16], leave[16];
    _Alignas(16) int32_t q[3][16];
    const uint32_t doubt = enter_at(b, i, in, plane, side, unit_mask, true, q);
    for (int h = 0; h < 4; h++) _mm256_store_pd(enter + 4 * h, in.v[h]), _mm256_store_pd(leave + 4 * h, t_max.v[h]);
    for (; met != 0; met &= met - 1) {
        const uint32_t lane = (uint32_t)__builtin_ctz(met), from = i + lane, to = b->starts;
        for (int k = 0; k < 3; k++) {
            b->start.q[k][to] = q[k][lane];
            b->start.o[k][to] = b->in.o[k][from], b->start.d[k][to] = b->in.d[k][from], b->start.inv[k][to] = b->in.inv[k][from];
        }
        if (doubt >> lane & 1) {
            b->found_ray[b->found] = b->in.ray[from], b->state[b->found] = SVOI_RAY_DOUBT;
            b->found++;
            continue;
        }
        b->start.t[to] = enter[lane], b->start.t_max[to] = leave[lane];
        if (lod) b->start.spread[to] = b->in.spread[from], b->start.offset[to] = b->in.offset[from];
        b->start.ray[to] = b->in.ray[from];
        b->starts++;
    }
}

#endif
