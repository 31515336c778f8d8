/* Readings of textures 16 at a time, for the files that read texels of 16 bits (svo_shade_wide.c) and of bytes (SVOI_TEXEL_BYTES, svo_shade_bytes.c). */
#ifndef SVOI_SHADE_KERNEL_H
#define SVOI_SHADE_KERNEL_H

#include <immintrin.h>
#include <string.h>

#include "svoi_shade_wide.h"

#ifdef SVOI_TEXEL_BYTES
/* The same of bytes: the table's 16-bit numbers by their lower and upper halves, looked up 64 at a time. */
typedef struct texel_source { const uint8_t *pixels; __m512i low[4], high[4]; } texel_source;

static inline __m512 to_floats(__m256i a) { return _mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(a)); }

static inline __m512i look_up(const __m512i table[4], __m512i byte)
{
    return _mm512_mask_blend_epi8(_mm512_movepi8_mask(byte), _mm512_permutex2var_epi8(table[0], byte, table[1]), _mm512_permutex2var_epi8(table[2], byte, table[3]));
}

/* Eight places, two texels each. */
static inline void convert(const texel_source *from, __m512i bytes, __m512 out[4])
{
    const __m512i opaque = _mm512_set1_epi64((int64_t)0xffff000000000000u);
    const __m512i low = look_up(from->low, bytes), high = look_up(from->high, bytes);
    const __m512i even = _mm512_or_si512(_mm512_unpacklo_epi8(low, high), opaque), odd = _mm512_or_si512(_mm512_unpackhi_epi8(low, high), opaque);
    const __m512i first = _mm512_permutex2var_epi64(even, _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11), odd), second = _mm512_permutex2var_epi64(even, _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15), odd);
    out[0] = to_floats(_mm512_castsi512_si256(first)), out[1] = to_floats(_mm512_extracti64x4_epi64(first, 1));
    out[2] = to_floats(_mm512_castsi512_si256(second)), out[3] = to_floats(_mm512_extracti64x4_epi64(second, 1));
}

static inline __m128i load_row(const texel_source *from, uint32_t a, uint32_t b)
{
    return _mm_unpacklo_epi64(_mm_loadl_epi64((const __m128i *)(const void *)(from->pixels + 4 * (uint64_t)a)), _mm_loadl_epi64((const __m128i *)(const void *)(from->pixels + 4 * (uint64_t)b)));
}
static inline __m512i join(__m128i a, __m128i b, __m128i c, __m128i d)
{
    return _mm512_inserti64x4(_mm512_castsi256_si512(_mm256_inserti128_si256(_mm256_castsi128_si256(a), b, 1)), _mm256_inserti128_si256(_mm256_castsi128_si256(c), d, 1), 1);
}
static inline void load_rows(const texel_source *from, const uint32_t *at, uint32_t w, __m512 out[4])
{
    convert(from, join(load_row(from, at[0] + w, at[1] + w), load_row(from, at[2] + w, at[3] + w), load_row(from, at[4] + w, at[5] + w), load_row(from, at[6] + w, at[7] + w)), out);
}

static inline __m128i load_end(const texel_source *from, const uint32_t *l, const uint32_t *r)
{
    uint32_t texel[4];
    memcpy(&texel[0], from->pixels + 4 * (uint64_t)l[0], 4);
    memcpy(&texel[1], from->pixels + 4 * (uint64_t)r[0], 4);
    memcpy(&texel[2], from->pixels + 4 * (uint64_t)l[1], 4);
    memcpy(&texel[3], from->pixels + 4 * (uint64_t)r[1], 4);
    return _mm_setr_epi32((int32_t)texel[0], (int32_t)texel[1], (int32_t)texel[2], (int32_t)texel[3]);
}
static inline void load_ends(const texel_source *from, const uint32_t *l, const uint32_t *r, __m512 out[4])
{
    convert(from, join(load_end(from, l, r), load_end(from, l + 2, r + 2), load_end(from, l + 4, r + 4), load_end(from, l + 6, r + 6)), out);
}
#else
/* Where texels are: 16-bit numbers, four a texel. Loads are of eight places at once, two texels of four numbers of each, two places a vector. */
typedef struct texel_source { const uint16_t *texels; } texel_source;

static inline __m512 to_floats(__m128i a, __m128i b) { return _mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(_mm256_inserti128_si256(_mm256_castsi128_si256(a), b, 1))); }

/* Neighbours in a row. */
static inline void load_rows(const texel_source *from, const uint32_t *at, uint32_t w, __m512 out[4])
{
    for (uint32_t k = 0; k < 4; k++) {
        const uint16_t *a = from->texels + 4 * ((uint64_t)at[2 * k] + w), *b = from->texels + 4 * ((uint64_t)at[2 * k + 1] + w);
        out[k] = to_floats(_mm_loadu_si128((const __m128i *)(const void *)a), _mm_loadu_si128((const __m128i *)(const void *)b));
    }
}

static inline __m128i load_end(const texel_source *from, uint32_t left, uint32_t right)
{
    return _mm_unpacklo_epi64(_mm_loadl_epi64((const __m128i *)(const void *)(from->texels + 4 * (uint64_t)left)), _mm_loadl_epi64((const __m128i *)(const void *)(from->texels + 4 * (uint64_t)right)));
}
/* Any two texels. */
static inline void load_ends(const texel_source *from, const uint32_t *l, const uint32_t *r, __m512 out[4])
{
    for (uint32_t k = 0; k < 8; k += 2) out[k / 2] = to_floats(load_end(from, l[k], r[k]), load_end(from, l[k + 1], r[k + 1]));
}
#endif

/* A table of 32 numbers. */
typedef struct table { __m512 low, high; } table;
static inline table load_table(const float *t) { return (table){_mm512_loadu_ps(t), _mm512_loadu_ps(t + 16)}; }
static inline __m512 look(const table *t, __m512i at) { return _mm512_permutex2var_ps(t->low, at, t->high); }

static inline void read_footprint(const texel_source *from, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
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
        const __m512i texel = _mm512_maskz_mov_epi32((__mmask16)((1u << left) - 1), _mm512_add_epi32(_mm512_mullo_epi32(iy, _mm512_set1_epi32((int32_t)w)), ix));
        uint32_t place[16];
        __m512 uppers[4], lowers[4];
        _mm512_storeu_si512(place, texel);
        for (uint32_t k = 0; k < left; k += 2) {
            if (k % 8 == 0) load_rows(from, place + k, 0, uppers), load_rows(from, place + k, w, lowers);
            const bool both = k + 1 < left;
            const __m512i at = _mm512_set1_epi32((int32_t)k);
            const __m512 upper = uppers[k / 2 % 4], lower = lowers[k / 2 % 4];
            const __m512 value = _mm512_add_ps(upper, _mm512_mul_ps(_mm512_sub_ps(lower, upper), _mm512_permutexvar_ps(_mm512_add_epi32(row, at), fy)));
            const __m512 weighted = _mm512_mul_ps(value, _mm512_permutex2var_ps(fx, _mm512_add_epi32(side, at), rx));
            sum = _mm512_mask_add_ps(sum, both ? 0xffff : 0x00ff, sum, weighted);
        }
    }
    _mm512_storeu_ps(sums, sum);
}

/* Numbers that may be one period out. */
static inline __m512i around(__m512i i, __m512i n)
{
    i = _mm512_mask_add_epi32(i, _mm512_movepi32_mask(i), i, n);
    return _mm512_mask_sub_epi32(i, _mm512_cmpge_epi32_mask(i, n), i, n);
}

/* 16 lanes, each with all its readings. */
static inline void read_lanes(const texel_source *from, uint32_t w, uint32_t h, const svoi_tap_plan *n, bool wraps, __m512 x0, __m512 y0, const __m512 step[2],
                              const __m512 side[2], __m512 sum[8])
{
    const __m512i left = _mm512_setr_epi32(16, 16, 16, 16, 0, 0, 0, 0, 17, 17, 17, 17, 1, 1, 1, 1), both = _mm512_setr_epi32(0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1);
    const __m512i columns = _mm512_set1_epi32((int32_t)w), rows = _mm512_set1_epi32((int32_t)h), one = _mm512_set1_epi32(1);
    for (int k = 0; k < 8; k++) sum[k] = _mm512_setzero_ps();
    for (uint32_t i = 0; i < n->along; i++)
        for (uint32_t j = 0; j < n->across; j++) {
            const __m512 a = _mm512_set1_ps((float)i), c = _mm512_set1_ps((float)j);
            const __m512 x = _mm512_add_ps(x0, _mm512_add_ps(_mm512_mul_ps(a, step[0]), _mm512_mul_ps(c, side[0])));
            const __m512 y = _mm512_add_ps(y0, _mm512_add_ps(_mm512_mul_ps(a, step[1]), _mm512_mul_ps(c, side[1])));
            const __m512 whole_x = wraps ? _mm512_roundscale_ps(x, 9) : x, whole_y = wraps ? _mm512_roundscale_ps(y, 9) : y;
            __m512i ix = _mm512_cvttps_epi32(whole_x), iy = _mm512_cvttps_epi32(whole_y);
            const __m512 fx = _mm512_sub_ps(x, _mm512_cvtepi32_ps(ix)), fy = _mm512_sub_ps(y, _mm512_cvtepi32_ps(iy)), rx = _mm512_sub_ps(_mm512_set1_ps(1), fx);
            uint32_t at[4][16]; /* upper left, upper right, lower left, lower right */
            if (wraps) {
                ix = around(ix, columns), iy = around(iy, rows);
                __m512i jx = _mm512_add_epi32(ix, one), jy = _mm512_add_epi32(iy, one);
                jx = _mm512_maskz_mov_epi32(_mm512_cmplt_epi32_mask(jx, columns), jx), jy = _mm512_maskz_mov_epi32(_mm512_cmplt_epi32_mask(jy, rows), jy);
                const __m512i upper = _mm512_mullo_epi32(iy, columns), lower = _mm512_mullo_epi32(jy, columns);
                _mm512_storeu_si512(at[0], _mm512_add_epi32(upper, ix));
                _mm512_storeu_si512(at[1], _mm512_add_epi32(upper, jx));
                _mm512_storeu_si512(at[2], _mm512_add_epi32(lower, ix));
                _mm512_storeu_si512(at[3], _mm512_add_epi32(lower, jx));
            } else {
                _mm512_storeu_si512(at[0], _mm512_add_epi32(_mm512_mullo_epi32(iy, columns), ix));
            }
            __m512 top[4], bottom[4];
            for (uint32_t k = 0; k < 8; k++) {
                const __m512i shift = _mm512_set1_epi32((int32_t)(2 * k));
                if (k % 4 == 0 && wraps) load_ends(from, at[0] + 2 * k, at[1] + 2 * k, top), load_ends(from, at[2] + 2 * k, at[3] + 2 * k, bottom);
                if (k % 4 == 0 && !wraps) load_rows(from, at[0] + 2 * k, 0, top), load_rows(from, at[0] + 2 * k, w, bottom);
                const __m512 value = _mm512_add_ps(top[k % 4], _mm512_mul_ps(_mm512_sub_ps(bottom[k % 4], top[k % 4]), _mm512_permutexvar_ps(_mm512_add_epi32(both, shift), fy)));
                sum[k] = _mm512_add_ps(sum[k], _mm512_mul_ps(value, _mm512_permutex2var_ps(fx, _mm512_add_epi32(left, shift), rx)));
            }
        }
}

/* Means of three components. */
static inline void means_of(const __m512 sum[8], float scale, __m512 out[3])
{
    const __m512 by = _mm512_set1_ps(scale);
    __m512 quad[4]; /* four lanes each */
    for (int k = 0; k < 4; k++) {
        const __m512 a = sum[2 * k], b = sum[2 * k + 1];
        quad[k] = _mm512_mul_ps(_mm512_add_ps(_mm512_shuffle_f32x4(a, b, 0x88), _mm512_shuffle_f32x4(a, b, 0xdd)), by);
    }
    const __m512i two[2] = {_mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29), _mm512_setr_epi32(2, 6, 10, 14, 18, 22, 26, 30, 0, 0, 0, 0, 0, 0, 0, 0)};
    const __m512 first = _mm512_permutex2var_ps(quad[0], two[0], quad[1]), second = _mm512_permutex2var_ps(quad[2], two[0], quad[3]);
    out[0] = _mm512_shuffle_f32x4(first, second, 0x44);
    out[1] = _mm512_shuffle_f32x4(first, second, 0xee);
    out[2] = _mm512_shuffle_f32x4(_mm512_permutex2var_ps(quad[0], two[1], quad[1]), _mm512_permutex2var_ps(quad[2], two[1], quad[3]), 0x44);
}

static inline void read_inner(const texel_source *from, uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, bool wraps,
                    const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    const table back_x = load_table(f->back_x), back_y = load_table(f->back_y), step_x = load_table(f->step_x), step_y = load_table(f->step_y);
    const table side_x = load_table(f->side_x), side_y = load_table(f->side_y);
    const uint64_t whole = l->count < 64 ? ((uint64_t)1 << l->count) - 1 : UINT64_MAX;
    float at_x[SVOI_LANES + 16], at_y[SVOI_LANES + 16], mean[3][SVOI_LANES];
    uint32_t row[SVOI_LANES + 16], count = 0;
    const bool all = lanes == whole;
    for (uint32_t i = 0; i < l->count; i += 16) {
        const __mmask16 m = all ? 0xffff : (__mmask16)(lanes >> i);
        const __m512i step = _mm512_maskz_compress_epi32(m, _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i *)(const void *)(l->step + i))));
        _mm512_storeu_si512(row + count, step);
        _mm512_storeu_ps(at_x + count, _mm512_sub_ps(_mm512_maskz_compress_ps(m, _mm512_loadu_ps(cx + i)), look(&back_x, step)));
        _mm512_storeu_ps(at_y + count, _mm512_sub_ps(_mm512_maskz_compress_ps(m, _mm512_loadu_ps(cy + i)), look(&back_y, step)));
        count += (uint32_t)__builtin_popcount(m);
    }
    if (all) count = l->count;
    float(*to)[SVOI_LANES] = all ? out : mean;
    for (uint32_t i = 0; i < count; i += 16) {
        const __mmask16 m = count - i < 16 ? (__mmask16)((1u << (count - i)) - 1) : 0xffff; /* the rest reads the first texel */
        const __m512i r = _mm512_loadu_si512(row + i);
        const __m512 step[2] = {_mm512_maskz_mov_ps(m, look(&step_x, r)), _mm512_maskz_mov_ps(m, look(&step_y, r))}, side[2] = {_mm512_maskz_mov_ps(m, look(&side_x, r)), _mm512_maskz_mov_ps(m, look(&side_y, r))};
        const __m512 x = _mm512_maskz_loadu_ps(m, at_x + i), y = _mm512_maskz_loadu_ps(m, at_y + i);
        __m512 sum[8], means[3];
        if (wraps) read_lanes(from, w, h, n, true, x, y, step, side, sum);
        else read_lanes(from, w, h, n, false, x, y, step, side, sum);
        means_of(sum, scale, means);
        for (int c = 0; c < 3; c++) _mm512_storeu_ps(to[c] + i, means[c]);
    }
    if (all) return;
    count = 0;
    for (uint32_t i = 0; i < l->count; i += 16) {
        const __mmask16 m = (__mmask16)(lanes >> i);
        for (int c = 0; c < 3; c++) _mm512_storeu_ps(out[c] + i, _mm512_mask_expandloadu_ps(_mm512_loadu_ps(out[c] + i), m, mean[c] + count));
        count += (uint32_t)__builtin_popcount(m);
    }
}

#endif
