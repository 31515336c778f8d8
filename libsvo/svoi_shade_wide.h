/* Steps of shading for processors with AVX-512 (svoi_clip_has_wide); what they do is what the code beside their calls does, to the bit. */
#ifndef SVOI_SHADE_WIDE_H
#define SVOI_SHADE_WIDE_H

#include "svo_block.h"
#include "svoi_lanes.h"

/* Codes of a brick's voxels `bits`, and their numbers from `rank` on among the brick's voxels `among`, to code[n] and target[n] on. Returns n and how
 * many there are. Writes up to 16 more. */
uint32_t svoi_wide_expand(uint64_t bits, uint64_t among, uint32_t brick, uint32_t rank, uint32_t n, uint32_t *code, uint32_t *target);
/* Codes of up to 64 marked voxels of a block to those that are averaged and to the others, behind the fewer than 64 that wait there, each with its number among its kind. */
void svoi_wide_codes(const svo_block *b, const uint32_t *codes, uint32_t count, svoi_lanes *shared, svoi_lanes *alone);
/* The same values to all voxels `bits` of a brick, whose voxels `among` have the numbers from `rank` on. */
void svoi_wide_write(const svo_shade_layout *layout, const svoi_values *v, uint64_t bits, uint64_t among, uint32_t rank, uint8_t *const channels[SVO_MAX_CHANNELS]);
/* Add the readings of a footprint, of texels from (0, 0) on; readings of even numbers to the first eight sums, the others to the rest. */
void svoi_wide_footprint(const uint16_t *texels, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16]);

/* Offsets and rows of the table of inner voxels: find_centroids in svo_shade_inner.c, with svoi_lanes_place before it. Writes up to a multiple of 16. */
void svoi_wide_places(const svo_facet *t, const svoi_inner *in, svoi_lanes *l);
/* Inner voxels whose step is among the bits `steps`, as sort_lanes of svo_shade_taps.c has them. */
svoi_sorted_lanes svoi_wide_sort(const svoi_inner_texture *f, const svoi_lanes *l, uint32_t steps, const float *cx, const float *cy, float width, float height);
/* Means of the readings of inner voxels `lanes` (bits), whose plans have the shape of n: of 16-bit texels of a level of w x h, all inside, or (`wraps`) less than a
 * period away. cx, cy and the lanes' steps are read, and out written, up to a multiple of 16; the first three components, of other lanes unchanged
 * unless `lanes` is all. */
void svoi_wide_read(const uint16_t *texels, uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l, uint64_t lanes, bool wraps,
                    const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES]);
/* Values of `stride` bytes, `count` of them and up to 64 bytes behind readable, to the values with the numbers in index. */
void svoi_wide_put(const uint8_t *values, uint32_t stride, const uint32_t *index, uint32_t count, uint8_t *out);
/* Linear colours to sRGB, three bytes a colour: `steps` is svoi_srgb_steps(). Reads and writes up to a multiple of 16 colours, and 16 bytes more. */
void svoi_wide_colors(const uint32_t *steps, const float *r, const float *g, const float *b, uint32_t count, uint8_t *out);

/* Add contributions to sums of nine: weight; weight and three colours times it; three normals times it, and the largest contribution. Weights are below 2^28.
 * Reads up to a multiple of eight. */
void svoi_wide_add(const uint32_t *weight, const uint32_t *target, uint32_t count, int32_t color[3][SVOI_LANES], int32_t normal[3][SVOI_LANES], uint64_t *sums);
/* The same of a triangle that looks the same everywhere: factor[k] times the weight to each of 5 or 9 fields (the first is the weight), and to the one that is a key the
 * greatest of what was there and weight << 36 | direction. `factor` has 9 entries. */
void svoi_wide_add_flat(const uint32_t *weight, const uint32_t *target, uint32_t count, uint32_t fields, const int32_t *factor, uint32_t key_field, uint64_t direction, uint64_t *sums);
/* Codes to whole coordinates: their bits from x, y and z on, every third. A multiple of 16 is written. */
void svoi_wide_place(uint32_t x, uint32_t y, uint32_t z, svoi_lanes *l);

/* svoi_wide_footprint and svoi_wide_read of images of bytes (four a texel, the fourth taken for 65535), by the lower and the upper bytes of the numbers that
 * they stand for, and whether there is such a thing. Numbers of texels are below 2^31, and eight bytes are read at each. */
bool svoi_bytes_has_wide(void);
void svoi_bytes_footprint(const uint8_t *pixels, const uint8_t halves[2][256], uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16]);
void svoi_bytes_read(const uint8_t *pixels, const uint8_t halves[2][256], uint32_t w, uint32_t h, const svoi_inner_texture *f, const svoi_tap_plan *n, const svoi_lanes *l,
                     uint64_t lanes, bool wraps, const float *cx, const float *cy, float scale, float (*out)[SVOI_LANES]);

#endif
