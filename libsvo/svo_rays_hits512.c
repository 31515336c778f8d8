/* What 16 rays at a time have found, as svo_raycast tells it, with AVX-512: 8 hits at a time. */
#include <stddef.h>

#include "svoi_rays.h"

#ifdef SVOI_HAVE_AVX512
#include <immintrin.h>
#include <math.h>

#define INLINE static inline __attribute__((always_inline))

/* Places in a ray, in doubles, and in a hit. */
enum { ORIGIN = 0, DIRECTION = 3, T_MIN = 6, SPREAD = 8, OFFSET = 9, RAY = 10 };
_Static_assert(sizeof(svo_ray) == 8 * RAY && offsetof(svo_ray, direction) == 8 * DIRECTION && offsetof(svo_ray, t_min) == 8 * T_MIN &&
                   offsetof(svo_ray, spread) == 8 * SPREAD && offsetof(svo_ray, offset) == 8 * OFFSET,
               "layout of svo_ray");
_Static_assert(sizeof(svo_hit) == 32 && offsetof(svo_hit, attribute) == 8 && offsetof(svo_hit, cell) == 16 && offsetof(svo_hit, level) == 28 &&
                   offsetof(svo_hit, face) == 29 && offsetof(svo_hit, hit) == 30,
               "layout of svo_hit");

/* t, numbers of attributes, cells and flags of 8 hits, and the hits. */
INLINE void put_hits(svoi_ray_batch *b, uint32_t j, uint32_t count, __m512d enter, __m512i attribute, const __m256i cell[3], __m256i flags, svo_hit *hits)
{
    enter = _mm512_add_pd(enter, _mm512_setzero_pd()); /* no negative zero */
    /* rows t, attribute, cells 0 and 1, cell 2 and the rest; to columns */
    const __m512i first = _mm512_or_si512(_mm512_cvtepu32_epi64(cell[0]), _mm512_slli_epi64(_mm512_cvtepu32_epi64(cell[1]), 32));
    const __m512i second = _mm512_or_si512(_mm512_cvtepu32_epi64(cell[2]), _mm512_slli_epi64(_mm512_cvtepu32_epi64(flags), 32));
    const __m512i ta = _mm512_unpacklo_epi64(_mm512_castpd_si512(enter), attribute), tb = _mm512_unpackhi_epi64(_mm512_castpd_si512(enter), attribute);
    const __m512i ca = _mm512_unpacklo_epi64(first, second), cb = _mm512_unpackhi_epi64(first, second);
    _Alignas(64) uint64_t out[4][8]; /* hits 0 4, 1 5, 2 6, 3 7 */
    const __m512i low = _mm512_setr_epi64(0, 1, 8, 9, 4, 5, 12, 13), high = _mm512_setr_epi64(2, 3, 10, 11, 6, 7, 14, 15);
    _mm512_store_si512(out[0], _mm512_permutex2var_epi64(ta, low, ca));
    _mm512_store_si512(out[1], _mm512_permutex2var_epi64(tb, low, cb));
    _mm512_store_si512(out[2], _mm512_permutex2var_epi64(ta, high, ca));
    _mm512_store_si512(out[3], _mm512_permutex2var_epi64(tb, high, cb));
    for (uint32_t i = 0; i < count; i++)
        _mm256_storeu_si256((__m256i *)&hits[b->found_ray[j + i]], _mm256_load_si256((const __m256i *)&out[i & 3][i & 4]));
}

/* Numbers of the attributes of 8 finest voxels, those of `sure`: as number_of in svo_rays.c. */
INLINE __m512i finest_numbers(const svo_rays *r, const svoi_ray_batch *b, uint32_t j, __mmask8 sure, const __m256i cell[3])
{
    const __m256i node = _mm256_maskz_loadu_epi32(sure, &b->node_found[j]), three = _mm256_set1_epi32(3);
    const __m256i x = _mm256_and_si256(cell[0], three), y = _mm256_slli_epi32(_mm256_and_si256(cell[1], three), 2), z = _mm256_slli_epi32(_mm256_and_si256(cell[2], three), 4);
    const __m256i in_brick = _mm256_ternarylogic_epi32(x, y, z, 0xfe);
    const __m512i mask = _mm512_i32gather_epi64(node, r->units, 8), earlier = _mm512_i32gather_epi64(in_brick, r->earlier, 8);
    __m512i inside = _mm512_popcnt_epi64(_mm512_and_si512(mask, earlier));
    if (svo_view_brick_lod(r->view)) { /* of blocks of 2x2x2 voxels too */
        __m512i blocks = _mm512_or_si512(mask, _mm512_srli_epi64(mask, 1));
        blocks = _mm512_or_si512(blocks, _mm512_srli_epi64(blocks, 4));
        blocks = _mm512_or_si512(blocks, _mm512_srli_epi64(blocks, 16));
        const __m512i before = _mm512_i32gather_epi64(_mm256_and_si256(in_brick, _mm256_set1_epi32(42)), r->earlier, 8);
        blocks = _mm512_and_si512(_mm512_and_si512(blocks, _mm512_set1_epi64(0x0000050500000505)), before);
        inside = _mm512_add_epi64(inside, _mm512_add_epi64(_mm512_popcnt_epi64(blocks), _mm512_set1_epi64(2)));
    }
    const __m256i full = _mm256_i32gather_epi32((const int *)r->before, node, 4); /* a full leaf's voxels have its attribute */
    const __mmask8 own = _mm256_mask_testn_epi32_mask(sure, full, _mm256_set1_epi32(1));
    const __m512i base = _mm512_maskz_cvtepu32_epi64(sure, _mm256_loadu_si256((const __m256i *)&b->base[j]));
    return _mm512_mask_add_epi64(base, own, base, inside);
}

/* Of finest voxels, whose t and face are known. */
static void finest_hits(const svo_rays *r, svoi_ray_batch *b, svo_hit *hits)
{
    for (uint32_t j = 0; j < b->found; j += 8) {
        const uint32_t count = b->found - j < 8 ? b->found - j : 8;
        __m256i cell[3];
        const __mmask8 lanes = (__mmask8)((1u << count) - 1);
        b->again[j / 8] = lanes & _mm256_cmpeq_epi32_mask(_mm256_loadu_si256((const __m256i *)&b->state[j]), _mm256_set1_epi32(SVOI_RAY_DOUBT));
        for (int k = 0; k < 3; k++) cell[k] = _mm256_srai_epi32(_mm256_loadu_si256((const __m256i *)&b->at[k][j]), (int)r->fraction);
        const __m256i flags = _mm256_or_si256(_mm256_slli_epi32(_mm256_loadu_si256((const __m256i *)&b->face_found[j]), 8), _mm256_set1_epi32((int)r->view->depth + (1 << 16)));
        const __m512i attribute = b->numbers ? finest_numbers(r, b, j, lanes & (__mmask8)~b->again[j / 8], cell) : _mm512_setzero_si512();
        put_hits(b, j, count, _mm512_loadu_pd(&b->t_found[j]), attribute, cell, flags, hits);
    }
}

void svoi_rays_hits_avx512(const svo_rays *r, bool lod, svoi_ray_batch *b, svo_hit *hits)
{
    if (!lod) {
        finest_hits(r, b, hits);
        b->numbered = b->numbers;
        return;
    }
    const double *rays = (const double *)b->rays;
    const __m512d zero = _mm512_setzero_pd();
    for (uint32_t j = 0; j < b->found; j += 8) {
        const uint32_t count = b->found - j < 8 ? b->found - j : 8;
        const __mmask8 lanes = (__mmask8)((1u << count) - 1);
        const __m256i state = _mm256_loadu_si256((const __m256i *)&b->state[j]);
        __mmask8 again = lanes & _mm256_cmpeq_epi32_mask(state, _mm256_set1_epi32(SVOI_RAY_DOUBT));
        const __mmask8 sure = lanes & (__mmask8)~again;
        /* log2 of the node's edge in finest voxels; 0 where it is not known */
        const __m256i above = _mm256_maskz_sub_epi32(sure, state, _mm256_set1_epi32(1 + (int)r->fraction));
        const __m256i size = _mm256_sllv_epi32(_mm256_set1_epi32(1), above), at = _mm256_mullo_epi32(_mm256_loadu_si256((const __m256i *)&b->found_ray[j]), _mm256_set1_epi32(RAY));
        __m512d enter = _mm512_set1_pd(-INFINITY);
        __m256i cell[3], face = _mm256_setzero_si256();
        for (int k = 0; k < 3; k++) {
            const __m512d origin = _mm512_mask_i32gather_pd(zero, lanes, at, rays + ORIGIN + k, 8), direction = _mm512_mask_i32gather_pd(_mm512_set1_pd(1), lanes, at, rays + DIRECTION + k, 8);
            const __m512d inv = _mm512_div_pd(_mm512_set1_pd(1), direction);
            const __mmask8 negative = _mm512_cmp_pd_mask(inv, zero, _CMP_LT_OQ);
            cell[k] = _mm256_srav_epi32(_mm256_srai_epi32(_mm256_loadu_si256((const __m256i *)&b->at[k][j]), (int)r->fraction), above);
            const __m256i corner = _mm256_sllv_epi32(cell[k], above), near = _mm256_mask_add_epi32(corner, negative, corner, size);
            const __m512d t = _mm512_mul_pd(_mm512_sub_pd(_mm512_cvtepi32_pd(near), origin), inv);
            const __mmask8 later = _mm512_cmp_pd_mask(t, enter, _CMP_GT_OQ);
            enter = _mm512_mask_mov_pd(enter, later, t);
            face = _mm256_mask_add_epi32(face, later, _mm256_set1_epi32(2 * k), _mm256_maskz_set1_epi32(negative, 1));
        }
        const __m512d t_min = _mm512_mask_i32gather_pd(zero, lanes, at, rays + T_MIN, 8);
        const __mmask8 inside = _mm512_cmp_pd_mask(enter, t_min, _CMP_LT_OQ);
        enter = _mm512_mask_mov_pd(enter, inside, t_min);
        face = _mm256_mask_mov_epi32(face, inside, _mm256_set1_epi32(SVO_FACE_INSIDE));
        /* the kernel may see that a node is small enough only after the ray has entered it, and then it was not when it counted */
        const __m512d spread = _mm512_mask_i32gather_pd(zero, lanes, at, rays + SPREAD, 8), offset = _mm512_mask_i32gather_pd(zero, lanes, at, rays + OFFSET, 8);
        const __mmask8 small = _mm512_cmp_pd_mask(_mm512_cvtepi32_pd(size), _mm512_add_pd(_mm512_mul_pd(spread, enter), offset), _CMP_LE_OQ);
        again |= sure & (__mmask8)~small & _mm256_test_epi32_mask(above, above);
        b->again[j / 8] = again;
        __m256i flags = _mm256_sub_epi32(_mm256_set1_epi32((int)r->view->depth + (1 << 16)), above);
        flags = _mm256_or_si256(flags, _mm256_slli_epi32(face, 8));
        put_hits(b, j, count, enter, _mm512_setzero_si512(), cell, flags, hits);
    }
}
#else
void svoi_rays_hits_avx512(const svo_rays *r, bool lod, svoi_ray_batch *b, svo_hit *hits) { (void)r, (void)lod, (void)b, (void)hits; }
#endif
