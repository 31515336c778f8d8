/* Steps of shading for processors with AVX2, eight lanes at a time; what they do is what the code beside their calls does, to the bit. */
#ifndef SVOI_SHADE_AVX2_H
#define SVOI_SHADE_AVX2_H

#include "svoi_lanes.h"

bool svoi_avx2_has(void);
void svoi_avx2_hold_back(bool held); /* say that it is not there, in tests: while no other thread runs */

/* Where texels are: 16-bit numbers, four a texel, or (texels NULL) bytes, of which the first three stand for the numbers in `stored` and the fourth for 65535. */
typedef struct svoi_texels { const uint16_t *texels; const uint8_t *pixels; const float *stored; } svoi_texels;

/* Inner voxels whose plans have the shape of step `first`, as sort_lanes of svo_shade_taps.c has them. Reads up to a multiple of eight. */
svoi_sorted_lanes svoi_avx2_sort(const svoi_inner_texture *f, const svoi_lanes *l, uint32_t first, const float *cx, const float *cy, float width, float height);
/* Means of the readings of inner voxels `lanes` (bits), whose plans have the shape of n, all inside a level of width w. cx, cy and the lanes' steps are read, and
 * out written, up to a multiple of eight; the first three components, of other lanes unchanged unless `lanes` is all. */
void svoi_avx2_read(const svoi_texels *from, uint32_t w, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES]);
/* Add the readings of a footprint, of texels from `origin` on; readings of even numbers to the first eight sums, the others to the rest. */
void svoi_avx2_footprint(const svoi_texels *from, uint64_t origin, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16]);
/* Linear colours to sRGB, three bytes a colour: `steps` is svoi_srgb_steps(). Reads and writes up to a multiple of eight colours, and eight bytes more. */
void svoi_avx2_colors(const uint32_t *steps, const float *r, const float *g, const float *b, uint32_t count, uint8_t *out);
/* The same values to all voxels `bits` of a brick, whose voxels `among` have the numbers from `rank` on. Of colours and normals, up to 32 bytes behind the
 * last value are read and written as they are. */
void svoi_avx2_write(const svo_shade_layout *layout, const svoi_values *v, uint64_t bits, uint64_t among, uint32_t rank, uint8_t *const channels[SVO_MAX_CHANNELS]);
/* svoi_wide_add and svoi_wide_add_flat of svoi_shade_wide.h. */
void svoi_avx2_add(const uint32_t *weight, const uint32_t *target, uint32_t count, int32_t color[3][SVOI_LANES], int32_t normal[3][SVOI_LANES], uint64_t *sums);
void svoi_avx2_add_flat(const uint32_t *weight, const uint32_t *target, uint32_t count, uint32_t fields, const int32_t *factor, uint32_t key_field, uint64_t direction, uint64_t *sums);

#endif
