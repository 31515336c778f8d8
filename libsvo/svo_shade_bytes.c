/* Readings of 8-bit images as they are, for processors that look up 64 bytes at a time (AVX-512 VBMI). */
#include "svoi_shade_wide.h"

#if defined(__x86_64__) && defined(__AVX512F__) && defined(__AVX512VL__) && defined(__AVX512DQ__) && defined(__AVX512BW__) && defined(__AVX512VBMI__)
#define SVOI_TEXEL_BYTES
#include "svoi_shade_kernel.h"

bool svoi_bytes_has_wide(void) { return svoi_clip_has_wide() && __builtin_cpu_supports("avx512vbmi"); }

static void make_source(const uint8_t *pixels, const uint8_t halves[2][256], texel_source *out)
{
    out->pixels = pixels;
    for (int i = 0; i < 4; i++) out->low[i] = _mm512_loadu_si512(halves[0] + 64 * i), out->high[i] = _mm512_loadu_si512(halves[1] + 64 * i);
}

void svoi_bytes_footprint(const uint8_t *pixels, const uint8_t halves[2][256], uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    texel_source from;
    make_source(pixels, halves, &from);
    read_footprint(&from, w, n, x, y, sums);
}

void svoi_bytes_read(const uint8_t *pixels, const uint8_t halves[2][256], uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l,
                     uint64_t lanes, bool wraps, const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    texel_source from;
    make_source(pixels, halves, &from);
    read_inner(&from, w, h, f, n, l, lanes, wraps, cx, cy, scale, out);
}
#else /* never called */
bool svoi_bytes_has_wide(void) { return false; }
void svoi_bytes_footprint(const uint8_t *pixels, const uint8_t halves[2][256], uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16])
{
    (void)pixels, (void)halves, (void)w, (void)n, (void)x, (void)y, (void)sums;
}
void svoi_bytes_read(const uint8_t *pixels, const uint8_t halves[2][256], uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l,
                     uint64_t lanes, bool wraps, const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES])
{
    (void)pixels, (void)halves, (void)w, (void)h, (void)f, (void)n, (void)l, (void)lanes, (void)wraps, (void)cx, (void)cy, (void)scale, (void)out;
}
#endif
