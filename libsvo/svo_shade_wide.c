#include "svoi_shade_wide.h"

#include <string.h>

#if defined(__x86_64__) && defined(__AVX512F__) && defined(__AVX512VL__) && defined(__AVX512DQ__) && defined(__AVX512BW__) && defined(__BMI2__)
#include <immintrin.h>

/* Numbers of the bits that are set, from `first` on. */
static inline uint32_t positions(uint64_t bits, uint32_t first, uint32_t n, uint32_t *out)
{
    __m512i number = _mm512_add_epi32(_mm512_set1_epi32((int32_t)first), _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15));
    for (; bits != 0; bits >>= 16, number = _mm512_add_epi32(number, _mm512_set1_epi32(16))) {
        _mm512_storeu_si512(out + n, _mm512_maskz_compress_epi32((__mmask16)bits, number));
        n += (uint32_t)__builtin_popcountll(bits & 0xffff);
    }
    return n;
}

uint32_t svoi_wide_expand(uint64_t bits, uint64_t among, uint32_t brick, uint32_t rank, uint32_t n, uint32_t *code, uint32_t *target)
{
    positions(_pext_u64(bits, among), rank, n, target);
    return positions(bits, brick << 6, n, code);
}

void svoi_wide_write(const svo_shade_layout *layout, const svoi_values *v, uint64_t bits, uint64_t among, uint32_t rank, uint8_t *const channels[SVO_MAX_CHANNELS])
{
    const uint64_t set = _pext_u64(bits, among);
    const uint32_t colors[2] = {layout->color, layout->emissive}, bytes[3] = {layout->metallic, layout->roughness, layout->coverage};
    if (layout->normal < SVO_MAX_CHANNELS) {
        uint32_t normal;
        uint8_t *to = channels[layout->normal] + 4 * (uint64_t)rank;
        memcpy(&normal, v->of[layout->normal], 4);
        for (uint64_t rest = set; rest != 0; rest >>= 16, to += 64) _mm512_mask_storeu_epi32(to, (__mmask16)rest, _mm512_set1_epi32((int32_t)normal));
    }
    for (int n = 0; n < 2; n++) {
        if (colors[n] >= SVO_MAX_CHANNELS) continue;
        uint8_t row[64], *to = channels[colors[n]] + 3 * (uint64_t)rank;
        for (uint32_t i = 0; i < 64; i++) row[i] = v->of[colors[n]][i % 3];
        const __m512i value = _mm512_loadu_si512(row);
        /* 21 values at a time, a bit for each of their bytes */
        for (uint64_t rest = set; rest != 0; rest >>= 21, to += 63) _mm512_mask_storeu_epi8(to, 7 * _pdep_u64(rest, 0x1249249249249249u), value);
    }
    for (int n = 0; n < 3; n++)
        if (bytes[n] < SVO_MAX_CHANNELS) _mm512_mask_storeu_epi8(channels[bytes[n]] + rank, set, _mm512_set1_epi8((char)v->of[bytes[n]][0]));
}

/* Two texels of each of two places. */
static inline __m512 load_pairs(const uint16_t *a, const uint16_t *b)
{
    const __m256i both = _mm256_inserti128_si256(_mm256_castsi128_si256(_mm_loadu_si128((const __m128i *)(const void *)a)), _mm_loadu_si128((const __m128i *)(const void *)b), 1);
    return _mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(both));
}

void svoi_wide_taps(const uint16_t *texels, uint32_t w, const uint32_t *texel, const float *fx, const float *fy, uint32_t count, float *sums)
{
    const __m512i side = _mm512_setr_epi32(8, 8, 8, 8, 0, 0, 0, 0, 9, 9, 9, 9, 1, 1, 1, 1), row = _mm512_setr_epi32(0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1);
    for (uint32_t k = 0; k < count; k += 8) {
        const __m256 right = _mm256_loadu_ps(fx + k);
        const __m512 across = _mm512_insertf32x8(_mm512_castps256_ps512(right), _mm256_sub_ps(_mm256_set1_ps(1), right), 1);
        const __m512 down = _mm512_castps256_ps512(_mm256_loadu_ps(fy + k));
        for (uint32_t j = 0; j < 8; j += 2) {
            const uint16_t *a = texels + 4 * (uint64_t)texel[k + j], *b = texels + 4 * (uint64_t)texel[k + j + 1];
            const __m512i at = _mm512_set1_epi32((int32_t)j);
            const __m512 upper = load_pairs(a, b), lower = load_pairs(a + 4 * (uint64_t)w, b + 4 * (uint64_t)w);
            const __m512 value = _mm512_add_ps(upper, _mm512_mul_ps(_mm512_sub_ps(lower, upper), _mm512_permutexvar_ps(_mm512_add_epi32(row, at), down)));
            float *sum = sums + 8 * (uint64_t)(k + j);
            _mm512_storeu_ps(sum, _mm512_add_ps(_mm512_loadu_ps(sum), _mm512_mul_ps(value, _mm512_permutexvar_ps(_mm512_add_epi32(side, at), across))));
        }
    }
}
void svoi_wide_footprint(const uint16_t *texels, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    /* readings along and across, by number: the last one counts up first */
    const __m512i side = _mm512_setr_epi32(16, 16, 16, 16, 0, 0, 0, 0, 17, 17, 17, 17, 1, 1, 1, 1), row = _mm512_setr_epi32(0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1);
    const uint32_t count = n->along * n->across;
    const __m512 wide = _mm512_set1_ps((float)n->across), one = _mm512_set1_ps(1);
    __m512 number = _mm512_setr_ps(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15), sum = _mm512_loadu_ps(sums);
    for (uint32_t first = 0; first < count; first += 16, number = _mm512_add_ps(number, _mm512_set1_ps(16))) {
        const uint32_t left = count - first < 16 ? count - first : 16;
        /* small whole numbers: a half more, divided and rounded down, is right */
        const __m512 i = _mm512_roundscale_ps(_mm512_div_ps(_mm512_add_ps(number, _mm512_set1_ps(0.5f)), wide), 9), j = _mm512_sub_ps(number, _mm512_mul_ps(i, wide));
        const __m512 px = _mm512_add_ps(_mm512_add_ps(_mm512_set1_ps(x), _mm512_mul_ps(i, _mm512_set1_ps(n->step[0]))), _mm512_mul_ps(j, _mm512_set1_ps(n->side[0])));
        const __m512 py = _mm512_add_ps(_mm512_add_ps(_mm512_set1_ps(y), _mm512_mul_ps(i, _mm512_set1_ps(n->step[1]))), _mm512_mul_ps(j, _mm512_set1_ps(n->side[1])));
        const __m512i ix = _mm512_cvttps_epi32(px), iy = _mm512_cvttps_epi32(py);
        const __m512 fx = _mm512_sub_ps(px, _mm512_cvtepi32_ps(ix)), fy = _mm512_sub_ps(py, _mm512_cvtepi32_ps(iy)), rx = _mm512_sub_ps(one, fx);
        uint32_t texel[16];
        _mm512_storeu_si512(texel, _mm512_add_epi32(_mm512_mullo_epi32(iy, _mm512_set1_epi32((int32_t)w)), ix));
        for (uint32_t k = 0; k < left; k += 2) {
            const bool both = k + 1 < left;
            const uint16_t *a = texels + 4 * (uint64_t)texel[k], *b = both ? texels + 4 * (uint64_t)texel[k + 1] : a;
            const __m512i at = _mm512_set1_epi32((int32_t)k);
            const __m512 upper = load_pairs(a, b), lower = load_pairs(a + 4 * (uint64_t)w, b + 4 * (uint64_t)w);
            const __m512 value = _mm512_add_ps(upper, _mm512_mul_ps(_mm512_sub_ps(lower, upper), _mm512_permutexvar_ps(_mm512_add_epi32(row, at), fy)));
            const __m512 weighted = _mm512_mul_ps(value, _mm512_permutex2var_ps(fx, _mm512_add_epi32(side, at), rx));
            sum = _mm512_mask_add_ps(sum, both ? 0xffff : 0x00ff, sum, weighted);
        }
    }
    _mm512_storeu_ps(sums, sum);
}
#else /* never called: svoi_clip_has_wide says so */
uint32_t svoi_wide_expand(uint64_t bits, uint64_t among, uint32_t brick, uint32_t rank, uint32_t n, uint32_t *code, uint32_t *target)
{
    (void)bits, (void)among, (void)brick, (void)rank, (void)code, (void)target;
    return n;
}
void svoi_wide_write(const svo_shade_layout *layout, const svoi_values *v, uint64_t bits, uint64_t among, uint32_t rank, uint8_t *const channels[SVO_MAX_CHANNELS])
{
    (void)layout, (void)v, (void)bits, (void)among, (void)rank, (void)channels;
}
void svoi_wide_taps(const uint16_t *texels, uint32_t w, const uint32_t *texel, const float *fx, const float *fy, uint32_t count, float *sums)
{
    (void)texels, (void)w, (void)texel, (void)fx, (void)fy, (void)count, (void)sums;
}
void svoi_wide_footprint(const uint16_t *texels, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    (void)texels, (void)w, (void)n, (void)x, (void)y, (void)sums;
}
#endif
