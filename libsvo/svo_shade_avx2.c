#include "svoi_shade_avx2.h"

#include <string.h>

#if defined(__x86_64__) && defined(__AVX2__) && defined(__BMI2__)
#include <immintrin.h>

static bool held_back = false;
void svoi_avx2_hold_back(bool held) { held_back = held; }
bool svoi_avx2_has(void) { return !held_back && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("popcnt"); }

#define INLINE static inline __attribute__((always_inline))

/* --- texels ------------------------------------------------------------------------------------------------------- */

/* Two neighbours in a row. */
INLINE __m256 load_two(const svoi_texels *from, bool bytes, uint64_t at)
{
    if (!bytes) return _mm256_cvtepi32_ps(_mm256_cvtepu16_epi32(_mm_loadu_si128((const __m128i *)(const void *)(from->texels + 4 * at))));
    const float *stored = from->stored;
    uint64_t t;
    memcpy(&t, from->pixels + 4 * at, 8);
    return _mm256_setr_ps(stored[t & 255], stored[t >> 8 & 255], stored[t >> 16 & 255], 65535, stored[t >> 32 & 255], stored[t >> 40 & 255], stored[t >> 48 & 255], 65535);
}

/* A bilinear reading: its left half and its right half, weighted. */
INLINE __m256 read_two(const svoi_texels *from, bool bytes, uint64_t at, uint32_t w, const float *fx, const float *rx, const float *fy)
{
    const __m256 upper = load_two(from, bytes, at), lower = load_two(from, bytes, at + w);
    const __m256 value = _mm256_add_ps(upper, _mm256_mul_ps(_mm256_sub_ps(lower, upper), _mm256_broadcast_ss(fy)));
    return _mm256_mul_ps(value, _mm256_blend_ps(_mm256_broadcast_ss(rx), _mm256_broadcast_ss(fx), 0xf0));
}

/* Eight places in texels, none negative: which texels, and where between them. */
typedef struct places { _Alignas(32) float fx[8], rx[8], fy[8]; _Alignas(32) uint32_t texel[8]; } places;
INLINE void find_places(__m256 x, __m256 y, uint32_t w, places *out)
{
    const __m256i ix = _mm256_cvttps_epi32(x), iy = _mm256_cvttps_epi32(y);
    const __m256 fx = _mm256_sub_ps(x, _mm256_cvtepi32_ps(ix));
    _mm256_store_ps(out->fx, fx);
    _mm256_store_ps(out->rx, _mm256_sub_ps(_mm256_set1_ps(1), fx));
    _mm256_store_ps(out->fy, _mm256_sub_ps(y, _mm256_cvtepi32_ps(iy)));
    _mm256_store_si256((__m256i *)(void *)out->texel, _mm256_add_epi32(_mm256_mullo_epi32(iy, _mm256_set1_epi32((int32_t)w)), ix));
}

/* --- footprints --------------------------------------------------------------------------------------------------- */

INLINE void read_footprint(const svoi_texels *from, bool bytes, uint64_t origin, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    const uint32_t count = n->along * n->across;
    const __m256 wide = _mm256_set1_ps((float)n->across), all_x = _mm256_set1_ps(x), all_y = _mm256_set1_ps(y), step_x = _mm256_set1_ps(n->step[0]), step_y = _mm256_set1_ps(n->step[1]);
    const __m256 side_x = _mm256_set1_ps(n->side[0]), side_y = _mm256_set1_ps(n->side[1]);
    __m256 number = _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7), even = _mm256_loadu_ps(sums), odd = _mm256_loadu_ps(sums + 8);
    for (uint32_t first = 0; first < count; first += 8, number = _mm256_add_ps(number, _mm256_set1_ps(8))) {
        const uint32_t left = count - first < 8 ? count - first : 8;
        places p;
        /* small whole numbers: a half more, divided and rounded down, is right */
        const __m256 i = _mm256_floor_ps(_mm256_div_ps(_mm256_add_ps(number, _mm256_set1_ps(0.5f)), wide)), j = _mm256_sub_ps(number, _mm256_mul_ps(i, wide));
        find_places(_mm256_add_ps(_mm256_add_ps(all_x, _mm256_mul_ps(i, step_x)), _mm256_mul_ps(j, side_x)),
                    _mm256_add_ps(_mm256_add_ps(all_y, _mm256_mul_ps(i, step_y)), _mm256_mul_ps(j, side_y)), w, &p);
        for (uint32_t k = 0; k + 1 < left; k += 2) {
            even = _mm256_add_ps(even, read_two(from, bytes, origin + p.texel[k], w, &p.fx[k], &p.rx[k], &p.fy[k]));
            odd = _mm256_add_ps(odd, read_two(from, bytes, origin + p.texel[k + 1], w, &p.fx[k + 1], &p.rx[k + 1], &p.fy[k + 1]));
        }
        if (left % 2 != 0) even = _mm256_add_ps(even, read_two(from, bytes, origin + p.texel[left - 1], w, &p.fx[left - 1], &p.rx[left - 1], &p.fy[left - 1]));
    }
    _mm256_storeu_ps(sums, even);
    _mm256_storeu_ps(sums + 8, odd);
}

void svoi_avx2_footprint(const svoi_texels *from, uint64_t origin, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    if (from->texels != NULL) read_footprint(from, false, origin, w, n, x, y, sums);
    else read_footprint(from, true, origin, w, n, x, y, sums);
}

/* --- inner voxels ------------------------------------------------------------------------------------------------- */

static inline uint32_t signs(__m256 x) { return (uint32_t)_mm256_movemask_ps(x); }

svoi_sorted_lanes svoi_avx2_sort(const svoi_inner_texture *f, const svoi_lanes *l, uint32_t first, const float *cx, const float *cy, float width, float height)
{
    const __m256 zero = _mm256_setzero_ps(), last_x = _mm256_set1_ps(width - 1), last_y = _mm256_set1_ps(height - 1);
    const __m256 most_x = _mm256_set1_ps(f->most_x[first]), most_y = _mm256_set1_ps(f->most_y[first]);
    const __m256i alike = _mm256_set1_epi32((int32_t)f->alike[first]), one = _mm256_set1_epi32(1);
    svoi_sorted_lanes r = {0, 0, 0};
    for (uint32_t i = 0; i < l->count; i += 8) {
        const uint32_t there = l->count - i < 8 ? (1u << (l->count - i)) - 1 : 0xff;
        const __m256i step = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)(l->step + i)));
        const __m256i other = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_sllv_epi32(one, step), alike), _mm256_setzero_si256());
        const uint32_t asked = there & ~signs(_mm256_castsi256_ps(other));
        const __m256 x = _mm256_loadu_ps(cx + i), y = _mm256_loadu_ps(cy + i);
        const __m256 in_x = _mm256_and_ps(_mm256_cmp_ps(_mm256_sub_ps(x, most_x), zero, _CMP_GT_OQ), _mm256_cmp_ps(_mm256_add_ps(x, most_x), last_x, _CMP_LT_OQ));
        const __m256 in_y = _mm256_and_ps(_mm256_cmp_ps(_mm256_sub_ps(y, most_y), zero, _CMP_GT_OQ), _mm256_cmp_ps(_mm256_add_ps(y, most_y), last_y, _CMP_LT_OQ));
        const uint32_t in = asked & signs(_mm256_and_ps(in_x, in_y));
        r.inside |= (uint64_t)in << i;
        for (uint32_t rest = asked & ~in; rest != 0; rest &= rest - 1) { /* those near an edge, by their own reach */
            const uint32_t k = i + (uint32_t)__builtin_ctz(rest), s = l->step[k];
            const float ex = f->reach_x[s], ey = f->reach_y[s];
            const uint64_t bit = (uint64_t)1 << k;
            if (cx[k] - ex > 0 && cy[k] - ey > 0 && cx[k] + ex < width - 1 && cy[k] + ey < height - 1) r.inside |= bit;
            else if (ex + 1 < width && ey + 1 < height) r.near |= bit;
            else r.far |= bit;
        }
    }
    return r;
}

/* Eight rows of eight to eight columns. */
INLINE void turn(__m256 r[8])
{
    __m256 a[8], b[8];
    for (int i = 0; i < 8; i += 2) a[i] = _mm256_unpacklo_ps(r[i], r[i + 1]), a[i + 1] = _mm256_unpackhi_ps(r[i], r[i + 1]);
    for (int i = 0; i < 8; i += 4) {
        b[i] = _mm256_shuffle_ps(a[i], a[i + 2], 0x44), b[i + 1] = _mm256_shuffle_ps(a[i], a[i + 2], 0xee);
        b[i + 2] = _mm256_shuffle_ps(a[i + 1], a[i + 3], 0x44), b[i + 3] = _mm256_shuffle_ps(a[i + 1], a[i + 3], 0xee);
    }
    for (int i = 0; i < 4; i++) r[i] = _mm256_permute2f128_ps(b[i], b[i + 4], 0x20), r[i + 4] = _mm256_permute2f128_ps(b[i], b[i + 4], 0x31);
}

/* Means of three components of eight lanes. */
INLINE void store_means(const __m256 sum[8], __m256 scale, float *r, float *g, float *b)
{
    __m256 q[4]; /* lanes k and k + 4 */
    for (int k = 0; k < 4; k++)
        q[k] = _mm256_mul_ps(_mm256_add_ps(_mm256_permute2f128_ps(sum[k], sum[k + 4], 0x20), _mm256_permute2f128_ps(sum[k], sum[k + 4], 0x31)), scale);
    const __m256 low[2] = {_mm256_unpacklo_ps(q[0], q[1]), _mm256_unpacklo_ps(q[2], q[3])}, high[2] = {_mm256_unpackhi_ps(q[0], q[1]), _mm256_unpackhi_ps(q[2], q[3])};
    _mm256_storeu_ps(r, _mm256_shuffle_ps(low[0], low[1], 0x44));
    _mm256_storeu_ps(g, _mm256_shuffle_ps(low[0], low[1], 0xee));
    _mm256_storeu_ps(b, _mm256_shuffle_ps(high[0], high[1], 0x44));
}

/* Lanes that are read: places of their middles, steps, and which they were. The rest of the last eight are at the first texel. */
typedef struct picked {
    uint32_t count;
    float x[SVOI_LANES + 8], y[SVOI_LANES + 8];
    uint8_t step[SVOI_LANES + 8], lane[SVOI_LANES + 8];
} picked;

static void pick(const svoi_lanes *l, uint64_t lanes, const float *cx, const float *cy, picked *out)
{
    uint32_t n = 0;
    for (uint32_t i = 0; lanes >> i != 0; i += 8) {
        const uint32_t m = lanes >> i & 0xff;
        const uint64_t bytes = _pdep_u64(m, 0x0101010101010101u) * 255, numbers = _pext_u64(0x0706050403020100u, bytes), own = numbers + i * 0x0101010101010101u;
        const __m256i order = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((int64_t)numbers));
        uint64_t steps;
        memcpy(&steps, l->step + i, 8);
        steps = _pext_u64(steps, bytes);
        memcpy(out->step + n, &steps, 8);
        memcpy(out->lane + n, &own, 8);
        _mm256_storeu_ps(out->x + n, _mm256_permutevar8x32_ps(_mm256_loadu_ps(cx + i), order));
        _mm256_storeu_ps(out->y + n, _mm256_permutevar8x32_ps(_mm256_loadu_ps(cy + i), order));
        n += (uint32_t)__builtin_popcount(m);
        if (i == 56) break;
    }
    out->count = n;
}

/* Readings of eight lanes. */
INLINE void read_eight(const svoi_texels *from, bool bytes, uint32_t w, const svoi_inner_texture *f, const svoi_tap_plan *n, uint32_t count, const float *x, const float *y, const uint8_t *step, __m256 sum[8])
{
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const __m256 there = _mm256_castsi256_ps(_mm256_cmpgt_epi32(_mm256_set1_epi32((int32_t)count), lane));
    __m256 at_x = _mm256_and_ps(_mm256_loadu_ps(x), there), at_y = _mm256_and_ps(_mm256_loadu_ps(y), there);
    places p;
    if (n->along * n->across == 1) {
        find_places(at_x, at_y, w, &p);
        for (int k = 0; k < 8; k++) sum[k] = read_two(from, bytes, p.texel[k], w, &p.fx[k], &p.rx[k], &p.fy[k]);
        return;
    }
    __m256 row[8]; /* from the middle back to the first reading, steps along and across */
    for (uint32_t k = 0; k < 8; k++) row[k] = _mm256_loadu_ps(f->row[k < count ? step[k] : SVOI_INNER_STEPS + 1]);
    turn(row);
    at_x = _mm256_sub_ps(at_x, row[0]), at_y = _mm256_sub_ps(at_y, row[1]);
    for (int k = 0; k < 8; k++) sum[k] = _mm256_setzero_ps();
    for (uint32_t i = 0; i < n->along; i++)
        for (uint32_t j = 0; j < n->across; j++) {
            const __m256 fi = _mm256_set1_ps((float)i), fj = _mm256_set1_ps((float)j);
            find_places(_mm256_add_ps(at_x, _mm256_add_ps(_mm256_mul_ps(fi, row[2]), _mm256_mul_ps(fj, row[4]))),
                        _mm256_add_ps(at_y, _mm256_add_ps(_mm256_mul_ps(fi, row[3]), _mm256_mul_ps(fj, row[5]))), w, &p);
            for (int k = 0; k < 8; k++) sum[k] = _mm256_add_ps(sum[k], read_two(from, bytes, p.texel[k], w, &p.fx[k], &p.rx[k], &p.fy[k]));
        }
}

INLINE void read_inner(const svoi_texels *from, bool bytes, uint32_t w, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    const __m256 by = _mm256_set1_ps(scale);
    __m256 sum[8];
    if (lanes == UINT64_MAX >> (64 - l->count)) { /* all */
        for (uint32_t i = 0; i < l->count; i += 8) {
            read_eight(from, bytes, w, f, n, l->count - i, cx + i, cy + i, l->step + i, sum);
            store_means(sum, by, out[0] + i, out[1] + i, out[2] + i);
        }
        return;
    }
    picked p;
    float mean[3][8];
    pick(l, lanes, cx, cy, &p);
    for (uint32_t i = 0; i < p.count; i += 8) {
        const uint32_t left = p.count - i < 8 ? p.count - i : 8;
        read_eight(from, bytes, w, f, n, left, p.x + i, p.y + i, p.step + i, sum);
        store_means(sum, by, mean[0], mean[1], mean[2]);
        for (uint32_t k = 0; k < left; k++)
            for (int c = 0; c < 3; c++) out[c][p.lane[i + k]] = mean[c][k];
    }
}

void svoi_avx2_read(const svoi_texels *from, uint32_t w, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    if (from->texels != NULL) read_inner(from, false, w, f, n, l, lanes, cx, cy, scale, out);
    else read_inner(from, true, w, f, n, l, lanes, cx, cy, scale, out);
}

/* --- bytes -------------------------------------------------------------------------------------------------------- */

void svoi_avx2_colors(const uint32_t *steps, const float *r, const float *g, const float *b, uint32_t count, uint8_t *out)
{
    const float *from[3] = {r, g, b};
    const __m256 least = _mm256_set1_ps(0x1p-13f), most = _mm256_set1_ps(0x1.fffffep-1f);
    const __m256i squeeze = _mm256_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1, 0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
    const __m256i join = _mm256_setr_epi32(0, 1, 2, 4, 5, 6, 3, 7);
    for (uint32_t i = 0; i < count; i += 8, out += 24) {
        __m256i pixel = _mm256_setzero_si256();
        for (int k = 2; k >= 0; k--) {
            const __m256i bits = _mm256_castps_si256(_mm256_min_ps(_mm256_max_ps(_mm256_loadu_ps(from[k] + i), least), most));
            const __m256i step = _mm256_i32gather_epi32((const int32_t *)(const void *)steps, _mm256_sub_epi32(_mm256_srli_epi32(bits, 16), _mm256_set1_epi32(0x3900)), 4);
            const __m256i under = _mm256_cmpgt_epi32(_mm256_and_si256(step, _mm256_set1_epi32(0x1ffff)), _mm256_and_si256(bits, _mm256_set1_epi32(0xffff)));
            /* one more, where it is not under */
            const __m256i value = _mm256_add_epi32(_mm256_add_epi32(_mm256_srli_epi32(step, 17), _mm256_set1_epi32(1)), under);
            pixel = _mm256_or_si256(_mm256_slli_epi32(pixel, 8), value);
        }
        _mm256_storeu_si256((__m256i *)(void *)out, _mm256_permutevar8x32_epi32(_mm256_shuffle_epi8(pixel, squeeze), join));
    }
}

/* Bits to bytes: 255 where a bit is set. */
INLINE __m256i to_bytes(uint32_t bits)
{
    const __m256i which = _mm256_setr_epi64x(0, 0x0101010101010101, 0x0202020202020202, 0x0303030303030303), bit = _mm256_set1_epi64x((int64_t)0x8040201008040201u);
    return _mm256_cmpeq_epi8(_mm256_and_si256(_mm256_shuffle_epi8(_mm256_set1_epi32((int32_t)bits), which), bit), bit);
}
INLINE void blend_to(uint8_t *to, __m256i value, __m256i mask)
{
    _mm256_storeu_si256((__m256i *)(void *)to, _mm256_blendv_epi8(_mm256_loadu_si256((const __m256i *)(const void *)to), value, mask));
}

void svoi_avx2_write(const svo_shade_layout *layout, const svoi_values *v, uint64_t bits, uint64_t among, uint32_t rank, uint8_t *const channels[SVO_MAX_CHANNELS])
{
    const uint64_t set = _pext_u64(bits, among);
    const uint32_t colors[2] = {layout->color, layout->emissive}, bytes[3] = {layout->metallic, layout->roughness, layout->coverage};
    if (layout->normal < SVO_MAX_CHANNELS) {
        const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
        int32_t normal;
        uint8_t *to = channels[layout->normal] + 4 * (uint64_t)rank;
        memcpy(&normal, v->of[layout->normal], 4);
        for (uint64_t rest = set; rest != 0; rest >>= 8, to += 32)
            blend_to(to, _mm256_set1_epi32(normal), _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32((int32_t)rest), bit), bit));
    }
    for (int n = 0; n < 2; n++) {
        if (colors[n] >= SVO_MAX_CHANNELS) continue;
        uint8_t row[32], *to = channels[colors[n]] + 3 * (uint64_t)rank;
        for (uint32_t i = 0; i < 32; i++) row[i] = v->of[colors[n]][i % 3];
        const __m256i value = _mm256_loadu_si256((const __m256i *)(const void *)row);
        /* ten values at a time, a bit for each of their bytes */
        for (uint64_t rest = set; rest != 0; rest >>= 10, to += 30) blend_to(to, value, to_bytes(7 * (uint32_t)_pdep_u64(rest & 0x3ff, 0x9249249)));
    }
    for (int n = 0; n < 3; n++)
        for (uint64_t rest = bytes[n] < SVO_MAX_CHANNELS ? set : 0; rest != 0; rest &= rest - 1) channels[bytes[n]][rank + (uint32_t)__builtin_ctzll(rest)] = v->of[bytes[n]][0];
}

/* --- sums --------------------------------------------------------------------------------------------------------- */

/* Four sums more; the fourth is the greater of itself and the key where key_lane says so. */
INLINE void add_four(uint64_t *to, __m256i by, __m256i weight, __m256i key, __m256i key_lane)
{
    const __m256i old = _mm256_loadu_si256((const __m256i *)(const void *)to), sum = _mm256_add_epi64(old, _mm256_mul_epi32(by, weight)), sign = _mm256_set1_epi64x(INT64_MIN);
    const __m256i greater = _mm256_cmpgt_epi64(_mm256_xor_si256(key, sign), _mm256_xor_si256(old, sign));
    _mm256_storeu_si256((__m256i *)(void *)to, _mm256_blendv_epi8(sum, _mm256_blendv_epi8(old, key, greater), key_lane));
}

void svoi_avx2_add(const uint32_t *weight, const uint32_t *target, uint32_t count, int32_t color[3][SVOI_LANES], int32_t normal[3][SVOI_LANES], uint64_t *sums)
{
    const __m256i last = _mm256_setr_epi64x(0, 0, 0, -1), none = _mm256_setzero_si256();
    for (uint32_t i = 0; i < count; i++) {
        uint64_t *to = sums + 9 * (uint64_t)target[i];
        const uint64_t w = weight[i];
        const int32_t x = normal[0][i], y = normal[1][i], z = normal[2][i];
        const uint64_t key = w << 36 | (uint64_t)((uint32_t)(x + 32768) >> 4) | (uint64_t)((uint32_t)(y + 32768) >> 4) << 12 | (uint64_t)((uint32_t)(z + 32768) >> 4) << 24;
        const __m256i by = _mm256_set1_epi64x((int64_t)w);
        to[0] += w;
        add_four(to + 1, _mm256_cvtepi32_epi64(_mm_setr_epi32(1, color[0][i], color[1][i], color[2][i])), by, none, none);
        add_four(to + 5, _mm256_cvtepi32_epi64(_mm_setr_epi32(x, y, z, 0)), by, _mm256_set1_epi64x((int64_t)key), last);
    }
}

void svoi_avx2_add_flat(const uint32_t *weight, const uint32_t *target, uint32_t count, uint32_t fields, const int32_t *factor, uint32_t key_field, uint64_t direction, uint64_t *sums)
{
    const __m256i low = _mm256_cvtepi32_epi64(_mm_loadu_si128((const __m128i *)(const void *)(factor + 1))), high = _mm256_cvtepi32_epi64(_mm_loadu_si128((const __m128i *)(const void *)(factor + 5)));
    const __m256i none = _mm256_setzero_si256(), last = _mm256_setr_epi64x(0, 0, 0, -1), key_low = key_field == 4 ? last : none, key_high = key_field == 8 ? last : none;
    for (uint32_t i = 0; i < count; i++) {
        uint64_t *to = sums + (uint64_t)fields * target[i];
        const uint64_t w = weight[i];
        const __m256i by = _mm256_set1_epi64x((int64_t)w), key = _mm256_set1_epi64x((int64_t)(w << 36 | direction));
        to[0] += w;
        add_four(to + 1, low, by, key, key_low);
        if (fields == 9) add_four(to + 5, high, by, key, key_high);
    }
}
#else /* never called */
void svoi_avx2_hold_back(bool held) { (void)held; }
bool svoi_avx2_has(void) { return false; }
svoi_sorted_lanes svoi_avx2_sort(const svoi_inner_texture *f, const svoi_lanes *l, uint32_t first, const float *cx, const float *cy, float width, float height)
{
    (void)f, (void)l, (void)first, (void)cx, (void)cy, (void)width, (void)height;
    return (svoi_sorted_lanes){0, 0, 0};
}
void svoi_avx2_read(const svoi_texels *from, uint32_t w, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    (void)from, (void)w, (void)f, (void)n, (void)l, (void)lanes, (void)cx, (void)cy, (void)scale, (void)out;
}
void svoi_avx2_footprint(const svoi_texels *from, uint64_t origin, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    (void)from, (void)origin, (void)w, (void)n, (void)x, (void)y, (void)sums;
}
void svoi_avx2_colors(const uint32_t *steps, const float *r, const float *g, const float *b, uint32_t count, uint8_t *out)
{
    (void)steps, (void)r, (void)g, (void)b, (void)count, (void)out;
}
void svoi_avx2_write(const svo_shade_layout *layout, const svoi_values *v, uint64_t bits, uint64_t among, uint32_t rank, uint8_t *const channels[SVO_MAX_CHANNELS])
{
    (void)layout, (void)v, (void)bits, (void)among, (void)rank, (void)channels;
}
void svoi_avx2_add(const uint32_t *weight, const uint32_t *target, uint32_t count, int32_t color[3][SVOI_LANES], int32_t normal[3][SVOI_LANES], uint64_t *sums)
{
    (void)weight, (void)target, (void)count, (void)color, (void)normal, (void)sums;
}
void svoi_avx2_add_flat(const uint32_t *weight, const uint32_t *target, uint32_t count, uint32_t fields, const int32_t *factor, uint32_t key_field, uint64_t direction, uint64_t *sums)
{
    (void)weight, (void)target, (void)count, (void)fields, (void)factor, (void)key_field, (void)direction, (void)sums;
}
#endif
