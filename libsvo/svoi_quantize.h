/* Internal: the colour half of svo_quantize. Not installed. */
#ifndef SVOI_QUANTIZE_H
#define SVOI_QUANTIZE_H

#include "svo_quantize.h"

typedef struct svoi_colors {
    const svo_allocator *a;
    uint32_t threads;
    const uint32_t *rgb;   /* distinct, ascending, 0x00BBGGRR */
    const uint64_t *times;
    float (*lab)[3];
    uint64_t count;
} svoi_colors;

/* At most `colors` representatives: variance cut, then k-means in CIELAB. mapped[i] becomes the representative of
 * colour i. */
svo_result svoi_cluster_colors(const svoi_colors *c, uint32_t colors, uint32_t *mapped, svo_error *err);

/* Representatives are colours that occur; every colour is within `bound` (CIE94, itself the reference) of its own. */
svo_result svoi_cover_colors(const svoi_colors *c, double bound, uint32_t *mapped, svo_error *err);

static inline void svoi_rgb_bytes(uint32_t v, uint8_t rgb[3])
{
    rgb[0] = (uint8_t)v, rgb[1] = (uint8_t)(v >> 8), rgb[2] = (uint8_t)(v >> 16);
}

#endif
