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

/* Every third bit. */
static inline __m512i compact(__m512i x)
{
    x = _mm512_and_si512(x, _mm512_set1_epi32(0x249249));
    x = _mm512_and_si512(_mm512_or_si512(x, _mm512_srli_epi32(x, 2)), _mm512_set1_epi32(0x0c30c3));
    x = _mm512_and_si512(_mm512_or_si512(x, _mm512_srli_epi32(x, 4)), _mm512_set1_epi32(0x00f00f));
    return _mm512_and_si512(_mm512_or_si512(x, _mm512_srli_epi32(x, 8)), _mm512_set1_epi32(0xff));
}

/* A table of 32 numbers. */
typedef struct table { __m512 low, high; } table;
static inline table load_table(const float *t) { return (table){_mm512_loadu_ps(t), _mm512_loadu_ps(t + 16)}; }
static inline __m512 look(const table *t, __m512i at) { return _mm512_permutex2var_ps(t->low, at, t->high); }

void svoi_wide_places(const svo_facet *t, const svoi_inner *in, svoi_lanes *l)
{
    const uint32_t ax = (t->axis + 1) % 3, ay = (t->axis + 2) % 3, az = t->axis;
    const __m512 gx = _mm512_set1_ps(t->clipper.gradient[0]), gy = _mm512_set1_ps(t->clipper.gradient[1]), height = _mm512_set1_ps(t->clipper.height);
    const __m512 from = _mm512_set1_ps(in->from), per_height = _mm512_set1_ps(in->per_height), bx = _mm512_set1_ps(in->base[0]), by = _mm512_set1_ps(in->base[1]);
    const __m512 half = _mm512_set1_ps(0.5f), zero = _mm512_setzero_ps(), last = _mm512_set1_ps((float)SVOI_INNER_STEPS), plus = _mm512_set1_ps(1), minus = _mm512_set1_ps(-1);
    const table tx = load_table(in->x), ty = load_table(in->y);
    for (uint32_t i = 0; i < l->count; i += 16) {
        const __m512i code = _mm512_loadu_si512(l->code + i);
        __m512 x = _mm512_add_ps(_mm512_cvtepi32_ps(compact(_mm512_srli_epi32(code, ax))), half), y = _mm512_add_ps(_mm512_cvtepi32_ps(compact(_mm512_srli_epi32(code, ay))), half);
        if (in->steps == 1) {
            _mm512_storeu_ps(l->offset_x + i, _mm512_sub_ps(x, bx));
            _mm512_storeu_ps(l->offset_y + i, _mm512_sub_ps(y, by));
            _mm_storeu_si128((__m128i *)(void *)(l->step + i), _mm_setzero_si128());
            continue;
        }
        __m512 z = _mm512_add_ps(_mm512_cvtepi32_ps(compact(_mm512_srli_epi32(code, az))), half);
        z = _mm512_sub_ps(_mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(gx, x), _mm512_mul_ps(gy, y)), height), z);
        const __m512 side = _mm512_mask_blend_ps(_mm512_cmp_ps_mask(z, zero, _CMP_LT_OQ), plus, minus);
        const __m512 above = _mm512_mul_ps(_mm512_sub_ps(_mm512_mul_ps(z, side), from), per_height);
        __m512 row = _mm512_maskz_mov_ps(_mm512_cmp_ps_mask(above, zero, _CMP_GT_OQ), above);
        row = _mm512_mask_blend_ps(_mm512_cmp_ps_mask(row, last, _CMP_GE_OQ), row, last);
        const __m512i step = _mm512_cvttps_epi32(row), next = _mm512_add_epi32(step, _mm512_set1_epi32(1));
        const __m512 rest = _mm512_sub_ps(row, _mm512_cvtepi32_ps(step)), x0 = look(&tx, step), y0 = look(&ty, step);
        x = _mm512_add_ps(_mm512_sub_ps(x, bx), _mm512_mul_ps(side, _mm512_add_ps(x0, _mm512_mul_ps(_mm512_sub_ps(look(&tx, next), x0), rest))));
        y = _mm512_add_ps(_mm512_sub_ps(y, by), _mm512_mul_ps(side, _mm512_add_ps(y0, _mm512_mul_ps(_mm512_sub_ps(look(&ty, next), y0), rest))));
        _mm512_storeu_ps(l->offset_x + i, x);
        _mm512_storeu_ps(l->offset_y + i, y);
        _mm_storeu_si128((__m128i *)(void *)(l->step + i), _mm512_cvtepi32_epi8(_mm512_cvttps_epi32(_mm512_add_ps(row, half))));
    }
}

svoi_sorted_lanes svoi_wide_sort(const svoi_inner_texture *f, const svoi_lanes *l, uint32_t steps, const float *cx, const float *cy, float width, float height)
{
    const table reach_x = load_table(f->reach_x), reach_y = load_table(f->reach_y);
    const __m512 zero = _mm512_setzero_ps(), one = _mm512_set1_ps(1), all_x = _mm512_set1_ps(width), all_y = _mm512_set1_ps(height), last_x = _mm512_set1_ps(width - 1), last_y = _mm512_set1_ps(height - 1);
    svoi_sorted_lanes r = {0, 0, 0};
    for (uint32_t i = 0; i < l->count; i += 16) {
        const __mmask16 there = l->count - i < 16 ? (__mmask16)((1u << (l->count - i)) - 1) : 0xffff;
        const __m512i step = _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i *)(const void *)(l->step + i)));
        const __mmask16 asked = _mm512_mask_test_epi32_mask(there, _mm512_sllv_epi32(_mm512_set1_epi32(1), step), _mm512_set1_epi32((int32_t)steps));
        const __m512 x = _mm512_loadu_ps(cx + i), y = _mm512_loadu_ps(cy + i), ex = look(&reach_x, step), ey = look(&reach_y, step);
        __mmask16 in = _mm512_mask_cmp_ps_mask(asked, _mm512_sub_ps(x, ex), zero, _CMP_GT_OQ);
        in = _mm512_mask_cmp_ps_mask(in, _mm512_sub_ps(y, ey), zero, _CMP_GT_OQ);
        in = _mm512_mask_cmp_ps_mask(in, _mm512_add_ps(x, ex), last_x, _CMP_LT_OQ);
        in = _mm512_mask_cmp_ps_mask(in, _mm512_add_ps(y, ey), last_y, _CMP_LT_OQ);
        __mmask16 near = _mm512_mask_cmp_ps_mask(asked & (__mmask16)~in, _mm512_add_ps(ex, one), all_x, _CMP_LT_OQ);
        near = _mm512_mask_cmp_ps_mask(near, _mm512_add_ps(ey, one), all_y, _CMP_LT_OQ);
        r.inside |= (uint64_t)in << i;
        r.near |= (uint64_t)near << i;
        r.far |= (uint64_t)(asked & (__mmask16) ~(in | near)) << i;
    }
    return r;
}

/* Two texels of a row, and of another. */
static inline __m512 load_corners(const uint16_t *texels, uint32_t a_left, uint32_t a_right, uint32_t b_left, uint32_t b_right)
{
    const __m128i a = _mm_unpacklo_epi64(_mm_loadl_epi64((const __m128i *)(const void *)(texels + 4 * (uint64_t)a_left)), _mm_loadl_epi64((const __m128i *)(const void *)(texels + 4 * (uint64_t)a_right)));
    const __m128i b = _mm_unpacklo_epi64(_mm_loadl_epi64((const __m128i *)(const void *)(texels + 4 * (uint64_t)b_left)), _mm_loadl_epi64((const __m128i *)(const void *)(texels + 4 * (uint64_t)b_right)));
    return _mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(_mm256_inserti128_si256(_mm256_castsi128_si256(a), b, 1)));
}

/* Numbers that may be one period out. */
static inline __m512i around(__m512i i, __m512i n)
{
    i = _mm512_mask_add_epi32(i, _mm512_movepi32_mask(i), i, n);
    return _mm512_mask_sub_epi32(i, _mm512_cmpge_epi32_mask(i, n), i, n);
}

/* 16 lanes, each with all its readings. */
static inline void read_lanes(const uint16_t *texels, uint32_t w, uint32_t h, const svoi_tap_plan *n, const bool wraps, __m512 x0, __m512 y0, const __m512 step[2],
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
            for (uint32_t k = 0; k < 8; k++) {
                const uint32_t p = 2 * k, q = p + 1;
                const __m512i shift = _mm512_set1_epi32((int32_t)p);
                __m512 top, bottom;
                if (wraps) {
                    top = load_corners(texels, at[0][p], at[1][p], at[0][q], at[1][q]);
                    bottom = load_corners(texels, at[2][p], at[3][p], at[2][q], at[3][q]);
                } else {
                    const uint16_t *s = texels + 4 * (uint64_t)at[0][p], *t = texels + 4 * (uint64_t)at[0][q];
                    top = load_pairs(s, t), bottom = load_pairs(s + 4 * (uint64_t)w, t + 4 * (uint64_t)w);
                }
                const __m512 value = _mm512_add_ps(top, _mm512_mul_ps(_mm512_sub_ps(bottom, top), _mm512_permutexvar_ps(_mm512_add_epi32(both, shift), fy)));
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

void svoi_wide_read(const uint16_t *texels, uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, bool wraps,
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
        if (wraps) read_lanes(texels, w, h, n, true, x, y, step, side, sum);
        else read_lanes(texels, w, h, n, false, x, y, step, side, sum);
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

void svoi_wide_colors(const uint32_t *steps, const float *r, const float *g, const float *b, uint32_t count, uint8_t *out)
{
    const float *from[3] = {r, g, b};
    const __m512 least = _mm512_set1_ps(0x1p-13f), most = _mm512_set1_ps(0x1.fffffep-1f);
    /* three of four bytes, in each quarter and then together */
    const __m512i squeeze = _mm512_broadcast_i32x4(_mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1));
    const __m512i join = _mm512_setr_epi32(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 3, 7, 11, 15);
    for (uint32_t i = 0; i < count; i += 16, out += 48) {
        __m512i pixel = _mm512_setzero_si512();
        for (int k = 2; k >= 0; k--) {
            const __m512i bits = _mm512_castps_si512(_mm512_min_ps(_mm512_max_ps(_mm512_loadu_ps(from[k] + i), least), most));
            const __m512i step = _mm512_i32gather_epi32(_mm512_sub_epi32(_mm512_srli_epi32(bits, 16), _mm512_set1_epi32(0x3900)), steps, 4);
            const __mmask16 over = _mm512_cmpge_epu32_mask(_mm512_and_si512(bits, _mm512_set1_epi32(0xffff)), _mm512_and_si512(step, _mm512_set1_epi32(0x1ffff)));
            const __m512i value = _mm512_srli_epi32(step, 17);
            pixel = _mm512_or_si512(_mm512_slli_epi32(pixel, 8), _mm512_mask_add_epi32(value, over, value, _mm512_set1_epi32(1)));
        }
        _mm512_storeu_si512(out, _mm512_permutexvar_epi32(join, _mm512_shuffle_epi8(pixel, squeeze)));
    }
}

/* A bit for each value whose number does not follow the one before; count at most 64. */
static inline uint64_t find_breaks(const uint32_t *index, uint32_t count)
{
    uint64_t breaks = 1;
    for (uint32_t i = 1; i < count; i += 16) {
        const __m512i here = _mm512_loadu_si512(index + i), before = _mm512_loadu_si512(index + i - 1);
        breaks |= (uint64_t)_mm512_cmpneq_epi32_mask(here, _mm512_add_epi32(before, _mm512_set1_epi32(1))) << i;
    }
    return breaks;
}

static inline uint64_t low_bits(uint32_t n) { return _bzhi_u64(UINT64_MAX, n); }

void svoi_wide_put(const uint8_t *values, uint32_t stride, const uint32_t *index, uint32_t count, uint8_t *out)
{
    const uint32_t most = 64 / stride;
    uint64_t breaks = find_breaks(index, count);
    if (4 * (uint32_t)__builtin_popcountll(breaks & low_bits(count)) > count) { /* hardly any runs */
        if (stride == 4)
            for (uint32_t i = 0; i < count; i++) memcpy(out + 4 * (uint64_t)index[i], values + 4 * i, 4);
        else
            for (uint32_t i = 0; i < count; i++)
                for (uint32_t k = 0; k < stride; k++) out[stride * (uint64_t)index[i] + k] = values[stride * i + k];
        return;
    }
    for (uint32_t at = 0; at < count;) {
        breaks &= breaks - 1;
        uint32_t end = breaks != 0 ? (uint32_t)__builtin_ctzll(breaks) : count;
        if (end > count) end = count;
        uint8_t *to = out + (uint64_t)stride * index[at];
        for (; at < end; at += most, to += stride * most) {
            const uint32_t n = end - at < most ? end - at : most;
            _mm512_mask_storeu_epi8(to, low_bits(stride * n), _mm512_loadu_si512(values + stride * at));
        }
        at = end;
    }
}

/* Eight rows of eight to eight columns. */
static inline void turn(__m256i r[8])
{
    __m256i a[8], b[8];
    for (int i = 0; i < 8; i += 2) a[i] = _mm256_unpacklo_epi32(r[i], r[i + 1]), a[i + 1] = _mm256_unpackhi_epi32(r[i], r[i + 1]);
    for (int i = 0; i < 8; i += 4) {
        b[i] = _mm256_unpacklo_epi64(a[i], a[i + 2]), b[i + 1] = _mm256_unpackhi_epi64(a[i], a[i + 2]);
        b[i + 2] = _mm256_unpacklo_epi64(a[i + 1], a[i + 3]), b[i + 3] = _mm256_unpackhi_epi64(a[i + 1], a[i + 3]);
    }
    for (int i = 0; i < 4; i++) r[i] = _mm256_permute2x128_si256(b[i], b[i + 4], 0x20), r[i + 4] = _mm256_permute2x128_si256(b[i], b[i + 4], 0x31);
}

void svoi_wide_add(const uint32_t *weight, const uint32_t *target, uint32_t count, int32_t color[3][SVOI_LANES], int32_t normal[3][SVOI_LANES], uint64_t *sums)
{
    for (uint32_t i = 0; i < count; i += 8) {
        uint64_t keys[8];
        __m256i row[8] = {_mm256_set1_epi32(1)}, part[3];
        for (int k = 0; k < 3; k++) {
            row[1 + k] = _mm256_loadu_si256((const __m256i *)(const void *)(color[k] + i));
            row[4 + k] = _mm256_loadu_si256((const __m256i *)(const void *)(normal[k] + i));
            part[k] = _mm256_srli_epi32(_mm256_add_epi32(row[4 + k], _mm256_set1_epi32(32768)), 4);
        }
        row[7] = _mm256_setzero_si256();
        const __m512i direction = _mm512_or_si512(_mm512_or_si512(_mm512_cvtepu32_epi64(part[0]), _mm512_slli_epi64(_mm512_cvtepu32_epi64(part[1]), 12)), _mm512_slli_epi64(_mm512_cvtepu32_epi64(part[2]), 24));
        const __m512i weights = _mm512_cvtepu32_epi64(_mm256_loadu_si256((const __m256i *)(const void *)(weight + i)));
        _mm512_storeu_si512(keys, _mm512_or_si512(_mm512_slli_epi64(weights, 36), direction));
        turn(row);
        for (uint32_t k = 0; k < 8 && i + k < count; k++) {
            uint64_t *to = sums + 9 * (uint64_t)target[i + k];
            const __m512i product = _mm512_mul_epi32(_mm512_cvtepi32_epi64(row[k]), _mm512_set1_epi64((int64_t)weight[i + k]));
            const __m512i old = _mm512_loadu_si512(to + 1), sum = _mm512_add_epi64(old, product);
            to[0] += weight[i + k];
            _mm512_storeu_si512(to + 1, _mm512_mask_max_epu64(sum, 0x80, old, _mm512_set1_epi64((int64_t)keys[k])));
        }
    }
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
void svoi_wide_footprint(const uint16_t *texels, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    (void)texels, (void)w, (void)n, (void)x, (void)y, (void)sums;
}
void svoi_wide_places(const svo_facet *t, const svoi_inner *in, svoi_lanes *l)
{
    (void)t, (void)in, (void)l;
}
svoi_sorted_lanes svoi_wide_sort(const svoi_inner_texture *f, const svoi_lanes *l, uint32_t steps, const float *cx, const float *cy, float width, float height)
{
    (void)f, (void)l, (void)steps, (void)cx, (void)cy, (void)width, (void)height;
    return (svoi_sorted_lanes){0, 0, 0};
}
void svoi_wide_read(const uint16_t *texels, uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, bool wraps,
                    const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    (void)texels, (void)w, (void)h, (void)f, (void)n, (void)l, (void)lanes, (void)wraps, (void)cx, (void)cy, (void)scale, (void)out;
}
void svoi_wide_colors(const uint32_t *steps, const float *r, const float *g, const float *b, uint32_t count, uint8_t *out)
{
    (void)steps, (void)r, (void)g, (void)b, (void)count, (void)out;
}
void svoi_wide_put(const uint8_t *values, uint32_t stride, const uint32_t *index, uint32_t count, uint8_t *out)
{
    (void)values, (void)stride, (void)index, (void)count, (void)out;
}
void svoi_wide_add(const uint32_t *weight, const uint32_t *target, uint32_t count, int32_t color[3][SVOI_LANES], int32_t normal[3][SVOI_LANES], uint64_t *sums)
{
    (void)weight, (void)target, (void)count, (void)color, (void)normal, (void)sums;
}
#endif
