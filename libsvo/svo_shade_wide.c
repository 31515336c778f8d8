#include "svoi_shade_wide.h"

#include <string.h>

#if defined(__x86_64__) && defined(__AVX512F__) && defined(__AVX512VL__) && defined(__AVX512DQ__) && defined(__AVX512BW__) && defined(__BMI2__)
#include <immintrin.h>

#include "svoi_shade_kernel.h"

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

void svoi_wide_codes(const svo_block *b, const uint32_t *codes, uint32_t count, svoi_lanes *shared, svoi_lanes *alone)
{
    uint32_t n = shared->count, m = alone->count;
    const uint64_t *const words[2] = {b->bricks, b->complex};
    const uint32_t *const ranks[2] = {b->rank, b->complex_rank};
    for (uint32_t i = 0; i < count; i++) { /* gathers are slower */
        const uint32_t code = codes[i], brick = code >> 6, bit = code & 63, met = b->complex[brick] >> bit & 1;
        shared->code[n] = alone->code[m] = code;
        shared->target[n] = alone->target[m] = ranks[met][brick] + (uint32_t)__builtin_popcountll(_bzhi_u64(words[met][brick], bit));
        n += met;
        m += met ^ 1;
    }
    shared->count = n;
    alone->count = m;
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


/* Every third bit. */
static inline __m512i compact(__m512i x)
{
    x = _mm512_and_si512(x, _mm512_set1_epi32(0x249249));
    x = _mm512_and_si512(_mm512_or_si512(x, _mm512_srli_epi32(x, 2)), _mm512_set1_epi32(0x0c30c3));
    x = _mm512_and_si512(_mm512_or_si512(x, _mm512_srli_epi32(x, 4)), _mm512_set1_epi32(0x00f00f));
    return _mm512_and_si512(_mm512_or_si512(x, _mm512_srli_epi32(x, 8)), _mm512_set1_epi32(0xff));
}

void svoi_wide_footprint(const uint16_t *texels, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    const texel_source from = {texels};
    read_footprint(&from, w, n, x, y, sums);
}

void svoi_wide_read(const uint16_t *texels, uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, bool wraps,
                    const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    const texel_source from = {texels};
    read_inner(&from, w, h, f, n, l, lanes, wraps, cx, cy, scale, out);
}

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

/* Neither loads nor stores reach into the next voxel's sums: what follows would have to wait for them. */
void svoi_wide_add_flat(const uint32_t *weight, const uint32_t *target, uint32_t count, uint32_t fields, const int32_t *factor, uint32_t key_field, uint64_t direction, uint64_t *sums)
{
    const __mmask8 key_lane = key_field < fields ? (__mmask8)(1u << (key_field - 1)) : 0;
    const __m512i by = _mm512_cvtepi32_epi64(_mm256_loadu_si256((const __m256i *)(const void *)(factor + 1)));
    for (uint32_t i = 0; i < count; i++) {
        uint64_t *to = sums + (uint64_t)fields * target[i];
        const uint64_t w = weight[i], key = w << 36 | direction;
        to[0] += w;
        if (fields == 5) {
            const __m256i old = _mm256_loadu_si256((const __m256i *)(const void *)(to + 1)), sum = _mm256_add_epi64(old, _mm256_mul_epi32(_mm512_castsi512_si256(by), _mm256_set1_epi64x((int64_t)w)));
            _mm256_storeu_si256((__m256i *)(void *)(to + 1), _mm256_mask_max_epu64(sum, key_lane, old, _mm256_set1_epi64x((int64_t)key)));
        } else {
            const __m512i old = _mm512_loadu_si512(to + 1), sum = _mm512_add_epi64(old, _mm512_mul_epi32(by, _mm512_set1_epi64((int64_t)w)));
            _mm512_storeu_si512(to + 1, _mm512_mask_max_epu64(sum, key_lane, old, _mm512_set1_epi64((int64_t)key)));
        }
    }
}

void svoi_wide_place(uint32_t x, uint32_t y, uint32_t z, svoi_lanes *l)
{
    for (uint32_t i = 0; i < l->count; i += 16) {
        const __m512i code = _mm512_loadu_si512(l->code + i);
        _mm512_storeu_ps(l->clip.x + i, _mm512_cvtepi32_ps(compact(_mm512_srli_epi32(code, x))));
        _mm512_storeu_ps(l->clip.y + i, _mm512_cvtepi32_ps(compact(_mm512_srli_epi32(code, y))));
        _mm512_storeu_ps(l->clip.z + i, _mm512_cvtepi32_ps(compact(_mm512_srli_epi32(code, z))));
    }
}
#else /* never called: svoi_clip_has_wide says so */
void svoi_wide_add_flat(const uint32_t *weight, const uint32_t *target, uint32_t count, uint32_t fields, const int32_t *factor, uint32_t key_field, uint64_t direction, uint64_t *sums)
{
    (void)weight, (void)target, (void)count, (void)fields, (void)factor, (void)key_field, (void)direction, (void)sums;
}
void svoi_wide_codes(const svo_block *b, const uint32_t *codes, uint32_t count, svoi_lanes *shared, svoi_lanes *alone)
{
    (void)b, (void)codes, (void)count, (void)shared, (void)alone;
}
void svoi_wide_place(uint32_t x, uint32_t y, uint32_t z, svoi_lanes *l)
{
    (void)x, (void)y, (void)z, (void)l;
}
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
void svoi_wide_read(const uint16_t *texels, uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, bool wraps,
                    const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    (void)texels, (void)w, (void)h, (void)f, (void)n, (void)l, (void)lanes, (void)wraps, (void)cx, (void)cy, (void)scale, (void)out;
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
