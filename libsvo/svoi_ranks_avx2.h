/* Internal to libsvo: lanes of a mask side by side, with AVX2, which has no instruction for it. Not installed. */
#ifndef SVOI_RANKS_AVX2_H
#define SVOI_RANKS_AVX2_H

#include <immintrin.h>
#include <stdint.h>

#define INLINE static inline __attribute__((always_inline))

/* By mask of four lanes: where those of the mask come from when the ranks are closed, as words of a register of doubles and as bytes of one of words. */
#define LANE2(l) 2 * (l), 2 * (l) + 1
#define LANE4(l) 4 * (l), 4 * (l) + 1, 4 * (l) + 2, 4 * (l) + 3
#define RANKS(of, a, b, c, d) {of(a), of(b), of(c), of(d)}
#define ALL_RANKS(of) \
    {RANKS(of, 0, 0, 0, 0), RANKS(of, 0, 0, 0, 0), RANKS(of, 1, 0, 0, 0), RANKS(of, 0, 1, 0, 0), RANKS(of, 2, 0, 0, 0), RANKS(of, 0, 2, 0, 0), RANKS(of, 1, 2, 0, 0), RANKS(of, 0, 1, 2, 0), \
     RANKS(of, 3, 0, 0, 0), RANKS(of, 0, 3, 0, 0), RANKS(of, 1, 3, 0, 0), RANKS(of, 0, 1, 3, 0), RANKS(of, 2, 3, 0, 0), RANKS(of, 0, 2, 3, 0), RANKS(of, 1, 2, 3, 0), RANKS(of, 0, 1, 2, 3)}
static const _Alignas(32) int32_t double_ranks[16][8] = ALL_RANKS(LANE2);
static const _Alignas(16) int8_t word_ranks[16][16] = ALL_RANKS(LANE4);

INLINE __m256d close_doubles(__m256d x, __m256i ranks) { return _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(_mm256_castpd_si256(x), ranks)); }
INLINE __m128i close_words(__m128i x, __m128i ranks) { return _mm_shuffle_epi8(x, ranks); }

/* A mask of doubles as one of words. */
INLINE __m128i mask_words(__m256d mask)
{
    return _mm_castps_si128(_mm_shuffle_ps(_mm_castpd_ps(_mm256_castpd256_pd128(mask)), _mm_castpd_ps(_mm256_extractf128_pd(mask, 1)), 0x88));
}

#endif
