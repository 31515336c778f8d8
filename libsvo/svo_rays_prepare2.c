/* Before and after the traversal, for processors with AVX2: rays made ready, four at a time, and what they hit, as svo_raycast tells it. What is decided here is decided
 * with the same doubles as in svo_rays_avx512.c. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "svoi_rays.h"

#ifdef SVOI_HAVE_AVX2
#include "svoi_compress_avx2.h"

_Static_assert(sizeof(svo_ray) == 80 && offsetof(svo_ray, direction) == 24 && offsetof(svo_ray, t_min) == 48 && offsetof(svo_ray, t_max) == 56 && offsetof(svo_ray, spread) == 64 &&
                   offsetof(svo_ray, offset) == 72,
               "layout of svo_ray");

static const double far_enough = 0x1p40; /* fixed-point units: beyond, the positions' error would come near to one unit */

INLINE __m256d absolute(__m256d x) { return _mm256_andnot_pd(_mm256_set1_pd(-0.0), x); }
INLINE uint32_t bits(__m256d mask) { return (uint32_t)_mm256_movemask_pd(mask); }
/* The upper halves of doubles, with their signs. */
INLINE __m128i upper(__m256d x) { return _mm_castps_si128(_mm_shuffle_ps(_mm_castpd_ps(_mm256_castpd256_pd128(x)), _mm_castpd_ps(_mm256_extractf128_pd(x, 1)), 0xdd)); }

/* Four rows of doubles as columns. */
INLINE void transpose(const __m256d row[4], __m256d column[4])
{
    const __m256d a = _mm256_unpacklo_pd(row[0], row[1]), b = _mm256_unpackhi_pd(row[0], row[1]), c = _mm256_unpacklo_pd(row[2], row[3]), d = _mm256_unpackhi_pd(row[2], row[3]);
    column[0] = _mm256_permute2f128_pd(a, c, 0x20), column[1] = _mm256_permute2f128_pd(b, d, 0x20);
    column[2] = _mm256_permute2f128_pd(a, c, 0x31), column[3] = _mm256_permute2f128_pd(b, d, 0x31);
}

/* As svoi_rays_prepare_avx2. Without `lod`, no ray is taken to have a level of detail; false where one has. */
INLINE bool prepare(const svo_rays *r, bool lod, const svo_ray *rays, uint32_t count, svoi_ray_batch *b)
{
    const double scale = ldexp(1, (int)r->fraction), root_size = ldexp(1, (int)r->view->tree_depth);
    const __m256d zero = _mm256_setzero_pd(), one = _mm256_set1_pd(1), scales = _mm256_set1_pd(scale);
    const int32_t *low_side = lod ? r->root_low : r->low, *high_side = lod ? r->root_high : r->high;
    const __m128i unit_mask = _mm_set1_epi32((1 << r->fraction) - 1), one_i = _mm_set1_epi32(1);
    __m128d cones = _mm_setzero_pd();
    uint32_t kept = 0;
    memset(b->unsure, 0, sizeof b->unsure);
    for (uint32_t i = 0; i < count; i += 4) {
        const uint32_t lanes = count - i >= 4 ? 15 : (1u << (count - i)) - 1;
        const double *at[4];
        __m256d row[2][4], field[8], o[3], d[3], inv[3], near[3], spread = zero, offset = zero;
        for (uint32_t k = 0; k < 4; k++) at[k] = rays[i + k < count ? i + k : count - 1].origin; /* those after the last are copies of it */
        for (uint32_t k = 0; k < 4; k++) row[0][k] = _mm256_loadu_pd(at[k]), row[1][k] = _mm256_loadu_pd(at[k] + 4);
        transpose(row[0], field), transpose(row[1], field + 4);
        if (lod) {
            const __m128d p[4] = {_mm_loadu_pd(at[0] + 8), _mm_loadu_pd(at[1] + 8), _mm_loadu_pd(at[2] + 8), _mm_loadu_pd(at[3] + 8)};
            const __m256d even = _mm256_insertf128_pd(_mm256_castpd128_pd256(p[0]), p[2], 1), odd = _mm256_insertf128_pd(_mm256_castpd128_pd256(p[1]), p[3], 1);
            spread = _mm256_unpacklo_pd(even, odd), offset = _mm256_unpackhi_pd(even, odd);
        } else
            for (uint32_t k = 0; k < 4; k++) cones = _mm_max_pd(_mm_loadu_pd(at[k] + 8), cones); /* of NaN and a number the second */
        const __m256d t_min = field[6], t_max = field[7];
        __m256d t = t_min, leave = _mm256_set1_pd(INFINITY);
        for (int k = 0; k < 3; k++) {
            o[k] = _mm256_mul_pd(field[k], scales), d[k] = _mm256_mul_pd(field[3 + k], scales);
            inv[k] = _mm256_div_pd(one, d[k]);
            const __m256d low = _mm256_mul_pd(_mm256_sub_pd(_mm256_set1_pd(low_side[k]), o[k]), inv[k]), high = _mm256_mul_pd(_mm256_sub_pd(_mm256_set1_pd(high_side[k]), o[k]), inv[k]);
            near[k] = _mm256_blendv_pd(low, high, d[k]); /* by the sign of d */
            leave = _mm256_min_pd(leave, _mm256_blendv_pd(high, low, d[k]));
            t = _mm256_max_pd(near[k], t);
        }
        /* NaN fails the sums; 1 / d, and planes times that, are normal floats */
        const __m256d distance = _mm256_add_pd(_mm256_add_pd(absolute(o[0]), absolute(o[1])), absolute(o[2])), fast = _mm256_add_pd(_mm256_add_pd(absolute(d[0]), absolute(d[1])), absolute(d[2]));
        const __m256d slow = _mm256_min_pd(_mm256_min_pd(absolute(d[0]), absolute(d[1])), absolute(d[2]));
        __m256d usual = _mm256_and_pd(_mm256_cmp_pd(distance, _mm256_set1_pd(far_enough), _CMP_LE_OQ), _mm256_cmp_pd(fast, _mm256_set1_pd(0x1p90), _CMP_LE_OQ));
        usual = _mm256_and_pd(_mm256_and_pd(usual, _mm256_cmp_pd(slow, _mm256_set1_pd(0x1p-90), _CMP_GE_OQ)), _mm256_cmp_pd(absolute(t_min), _mm256_set1_pd(0x1p300), _CMP_LE_OQ));
        usual = _mm256_and_pd(usual, _mm256_cmp_pd(t_max, t_max, _CMP_ORD_Q));
        /* the root itself is not a cell of any node: where it is small enough the ray is left to svo_raycast */
        if (lod) usual = _mm256_and_pd(usual, _mm256_cmp_pd(_mm256_add_pd(_mm256_mul_pd(spread, t), offset), _mm256_set1_pd(root_size), _CMP_LT_OQ));
        uint32_t meets = lanes & bits(_mm256_and_pd(usual, _mm256_and_pd(_mm256_cmp_pd(t, leave, _CMP_LT_OQ), _mm256_cmp_pd(t, t_max, _CMP_LE_OQ)))), doubt = lanes & ~bits(usual);
        if (meets == 0) {
            b->unsure[i / 8] |= (uint8_t)(doubt << i % 8);
            continue;
        }
        const __m256d begins = _mm256_cmp_pd(t, zero, _CMP_EQ_OQ);
        __m128i q[3], number = _mm_add_epi32(_mm_set1_epi32((int)i), _mm_setr_epi32(0, 1, 2, 3));
        for (int k = 0; k < 3; k++) {
            const __m256d entering = _mm256_cmp_pd(near[k], t, _CMP_GE_OQ);
            q[k] = _mm256_cvttpd_epi32(_mm256_fmadd_pd(d[k], t, o[k]));
            const __m128i edge = _mm_and_si128(_mm_add_epi32(q[k], one_i), unit_mask);
            /* at t = 0 the ray is at its origin; where that is a whole number of units, nothing has been rounded: on a plane it is in the cell before it */
            const __m256d exact = _mm256_and_pd(begins, _mm256_cmp_pd(_mm256_cvtepi32_pd(q[k]), o[k], _CMP_EQ_OQ));
            doubt |= meets & ~bits(_mm256_or_pd(entering, exact)) & ~(uint32_t)_mm_movemask_ps(_mm_castsi128_ps(_mm_cmpgt_epi32(edge, one_i)));
            const __m128i negative = _mm_srai_epi32(upper(d[k]), 31), side = _mm_blendv_epi8(_mm_set1_epi32(low_side[k]), _mm_set1_epi32(high_side[k] - 1), negative);
            q[k] = _mm_add_epi32(q[k], _mm_and_si128(mask_words(exact), negative));
            q[k] = _mm_blendv_epi8(q[k], side, mask_words(entering));
        }
        meets &= ~doubt;
        b->unsure[i / 8] |= (uint8_t)(doubt << i % 8);
        for (int k = 0; k < 3; k++) {
            keep_doubles(&b->in.o[k][kept], meets, o[k]);
            keep_doubles(&b->in.d[k][kept], meets, d[k]);
            keep_doubles(&b->in.inv[k][kept], meets, inv[k]);
            keep_words(&b->in.q[k][kept], meets, q[k]);
        }
        if (lod) keep_doubles(&b->in.spread[kept], meets, _mm256_mul_pd(spread, scales)), keep_doubles(&b->in.offset[kept], meets, _mm256_mul_pd(offset, scales));
        keep_doubles(&b->in.t[kept], meets, t);
        keep_doubles(&b->in.t_max[kept], meets, t_max);
        keep_words(&b->in.ray[kept], meets, number);
        kept += (uint32_t)__builtin_popcount(meets);
    }
    b->count = kept;
    return _mm_movemask_pd(_mm_cmpgt_pd(cones, _mm_setzero_pd())) == 0;
}

bool svoi_rays_prepare_avx2(const svo_rays *r, const svo_ray *rays, uint32_t count, svoi_ray_batch *b)
{
    if (prepare(r, false, rays, count, b) || !r->view->lod) return false;
    prepare(r, true, rays, count, b);
    return true;
}

/* Of finest voxels, whose t and face are known. */
static void finest_hits(const svo_rays *r, svoi_ray_batch *b, svo_hit *hits)
{
    for (uint32_t j = 0; j < b->found; j++) {
        svo_hit *hit = &hits[b->found_ray[j]];
        memset(hit, 0, sizeof *hit); /* padding too: hits can be compared as bytes */
        b->again[j / 8] |= (uint8_t)((b->state[j] == SVOI_RAY_DOUBT) << j % 8);
        hit->t = b->t_found[j] + 0.0; /* no negative zero */
        for (uint32_t k = 0; k < 3; k++) hit->cell[k] = (uint32_t)(b->at[k][j] >> r->fraction);
        hit->face = (uint8_t)b->face_found[j], hit->level = (uint8_t)r->view->depth, hit->hit = true;
    }
}

void svoi_rays_hits_avx2(const svo_rays *r, bool lod, svoi_ray_batch *b, svo_hit *hits)
{
    memset(b->again, 0, sizeof b->again);
    if (!lod) {
        finest_hits(r, b, hits);
        return;
    }
    for (uint32_t j = 0; j < b->found; j++) {
        const svo_ray *ray = &b->rays[b->found_ray[j]];
        svo_hit *hit = &hits[b->found_ray[j]];
        if (b->state[j] == SVOI_RAY_DOUBT) {
            b->again[j / 8] |= (uint8_t)(1u << j % 8);
            continue;
        }
        memset(hit, 0, sizeof *hit);
        const uint32_t above = (uint32_t)b->state[j] - 1 - r->fraction;
        const double size = (double)((uint32_t)1 << above);
        double enter = -INFINITY;
        uint32_t face = 0;
        for (uint32_t k = 0; k < 3; k++) {
            const int32_t corner = b->at[k][j] >> r->fraction & -((int32_t)1 << above);
            const double inv = 1 / ray->direction[k], p = corner + (inv < 0 ? size : 0), t = (p - ray->origin[k]) * inv;
            if (t > enter) enter = t, face = 2 * k + (inv < 0);
            hit->cell[k] = (uint32_t)corner >> above;
        }
        if (enter < ray->t_min) enter = ray->t_min, face = SVO_FACE_INSIDE;
        /* the kernel may see that a node is small enough only after the ray has entered it, and then it was not when it counted */
        if (above != 0 && !(size <= ray->spread * enter + ray->offset)) b->again[j / 8] |= (uint8_t)(1u << j % 8);
        hit->t = enter + 0.0; /* no negative zero */
        hit->face = (uint8_t)face, hit->level = (uint8_t)(r->view->depth - above), hit->hit = true;
    }
}
#endif
