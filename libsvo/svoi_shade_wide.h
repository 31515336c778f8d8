/* Steps of shading for processors with AVX-512 (svoi_clip_has_wide); what they do is what the code beside their calls does, to the bit. */
#ifndef SVOI_SHADE_WIDE_H
#define SVOI_SHADE_WIDE_H

#include "svoi_lanes.h"

/* Codes of a brick's voxels `bits`, and their numbers from `rank` on among the brick's voxels `among`, to code[n] and target[n] on. Returns n and how
 * many there are. Writes up to 16 more. */
uint32_t svoi_wide_expand(uint64_t bits, uint64_t among, uint32_t brick, uint32_t rank, uint32_t n, uint32_t *code, uint32_t *target);
/* The same values to all voxels `bits` of a brick, whose voxels `among` have the numbers from `rank` on. */
void svoi_wide_write(const svo_shade_layout *layout, const svoi_values *v, uint64_t bits, uint64_t among, uint32_t rank, uint8_t *const channels[SVO_MAX_CHANNELS]);
/* Add bilinear readings of 16-bit texels, four components each, in rows of w: `count` (a multiple of 8) at texel[], fx[] and fy[] beyond it. Sums are eight
 * floats each: of the left and the right texels. */
void svoi_wide_taps(const uint16_t *texels, uint32_t w, const uint32_t *texel, const float *fx, const float *fy, uint32_t count, float *sums);
/* Add the readings of a footprint, of texels from (0, 0) on; readings of even numbers to the first eight sums, the others to the rest. */
void svoi_wide_footprint(const uint16_t *texels, uint32_t w, const svoi_tap_plan *n, float x, float y, float sums[16]);

#endif
