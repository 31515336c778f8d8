/* Internal to libsvo: the lanes of a mask compressed, that is side by side in memory, with AVX2, which has no instruction for it. Not installed. */
#ifndef SVOI_COMPRESS_AVX2_H
#define SVOI_COMPRESS_AVX2_H

#include <immintrin.h>
#include <stdint.h>

#define INLINE static inline __attribute__((always_inline))

/* By mask of four lanes: which lanes come first, as words of a register of doubles and as bytes of one of words. */
#define LANE2(l) 2 * (l), 2 * (l) + 1
#define LANE4(l) 4 * (l), 4 * (l) + 1, 4 * (l) + 2, 4 * (l) + 3
#define ORDER(of, a, b, c, d) {of(a), of(b), of(c), of(d)}
#define ALL_ORDERS(of) \
    {ORDER(of, 0, 0, 0, 0), ORDER(of, 0, 0, 0, 0), ORDER(of, 1, 0, 0, 0), ORDER(of, 0, 1, 0, 0), ORDER(of, 2, 0, 0, 0), ORDER(of, 0, 2, 0, 0), ORDER(of, 1, 2, 0, 0), ORDER(of, 0, 1, 2, 0), \
     ORDER(of, 3, 0, 0, 0), ORDER(of, 0, 3, 0, 0), ORDER(of, 1, 3, 0, 0), ORDER(of, 0, 1, 3, 0), ORDER(of, 2, 3, 0, 0), ORDER(of, 0, 2, 3, 0), ORDER(of, 1, 2, 3, 0), ORDER(of, 0, 1, 2, 3)}
static const _Alignas(32) int32_t double_order[16][8] = ALL_ORDERS(LANE2);
static const _Alignas(16) int8_t word_order[16][16] = ALL_ORDERS(LANE4);

/* Lanes `m` of four doubles, of four words, and of four floats, to `to` and on; all four are written. */
INLINE void keep_doubles(double *to, uint32_t m, __m256d x)
{
    const __m256i order = _mm256_load_si256((const __m256i *)double_order[m]);
    _mm256_storeu_pd(to, _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(_mm256_castpd_si256(x), order)));
}
INLINE void keep_words(int32_t *to, uint32_t m, __m128i x) { _mm_storeu_si128((__m128i *)to, _mm_shuffle_epi8(x, _mm_load_si128((const __m128i *)word_order[m]))); }
INLINE void keep_floats(float *to, uint32_t m, __m128 x) { _mm_storeu_ps(to, _mm_castsi128_ps(_mm_shuffle_epi8(_mm_castps_si128(x), _mm_load_si128((const __m128i *)word_order[m])))); }

/* A mask of doubles as one of words. */
INLINE __m128i mask_words(__m256d mask)
{
    return _mm_castps_si128(_mm_shuffle_ps(_mm_castpd_ps(_mm256_castpd256_pd128(mask)), _mm_castpd_ps(_mm256_extractf128_pd(mask, 1)), 0x88));
}

#endif
