/* Attribute channels: what a voxel carries beside its existence. */
#ifndef SVO_CHANNEL_H
#define SVO_CHANNEL_H

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_MAX_CHANNELS 16u
#define SVO_MAX_STRIDE 8u

/* Numbers are those in the files. */
typedef enum svo_channel_kind {
    SVO_KIND_COLOR_SRGB8 = 1,  /* 3 bytes R G B, sRGB encoded; averaged in linear light */
    SVO_KIND_NORMAL_OCT32 = 2, /* 4 bytes: two little-endian snorm16, octahedral; world space, unit */
    SVO_KIND_UNORM8 = 3,       /* 1 byte, value / 255, linear */
    SVO_KIND_ID16 = 4,         /* 2 bytes little-endian, a label: never averaged, majority wins, ties to the smaller */
    SVO_KIND_ID32 = 5          /* 4 bytes little-endian, a label */
} svo_channel_kind;

/* Bytes of one value; 0 for a number that is no kind. */
uint32_t svo_channel_stride(uint32_t kind);

/* Names are those of --attributes: color, normal, emissive, metallic, roughness, material, coverage, bone. A constant channel
 * has the same value in every voxel, which is stored here once and nowhere else. */
typedef struct svo_channel {
    char name[16]; /* NUL-padded, [a-z0-9_]+ */
    svo_channel_kind kind;
    bool constant;
    uint8_t value[SVO_MAX_STRIDE]; /* of a constant channel; 0 otherwise */
} svo_channel;

/* sRGB transfer function (IEC 61966-2-1), 8 bits to linear [0,1] and back (clamped, rounded to nearest). */
float svo_srgb_to_linear(uint8_t v);
uint8_t svo_linear_to_srgb(float v);

/* Octahedral unit vectors (Meyer et al. 2010), 2 x snorm16. Encoding picks the best of the four neighbouring codes;
 * the error is below 0.004 degrees. A zero or non-finite vector encodes as +Z (0, 0). */
void svo_oct32_encode(const float n[3], uint8_t out[4]);
void svo_oct32_decode(const uint8_t in[4], float n[3]); /* unit length */

/* Accumulates values of one kind as the tools average them: colours in linear light, normals as vectors, unorms
 * linearly, ids by greatest weight. Zero-initialise. */
typedef struct svo_average {
    double sum[3];
    double weight;
    uint64_t id[8]; /* candidate ids; a ninth different one replaces the lightest */
    double id_weight[8];
} svo_average;
void svo_average_add(svo_average *a, svo_channel_kind kind, const uint8_t *value, double weight);
/* Result; `fallback` (a value of the kind) is returned when nothing with weight > 0 was added or normals cancel. */
void svo_average_get(const svo_average *a, svo_channel_kind kind, const uint8_t *fallback, uint8_t *out);

#ifdef __cplusplus
}
#endif
#endif
