/* Filtered texture reading: averages over footprints in linear light. */
#ifndef SVO_TEXTURE_H
#define SVO_TEXTURE_H

#include "svo_alloc.h"
#include "svo_mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How the numbers of an image are meant. */
typedef enum svo_texel {
    SVO_TEXEL_COLOR = 0,         /* sRGB colour, alpha ignored (reads as 1) */
    SVO_TEXEL_COLOR_ALPHA = 1,   /* sRGB colour weighted by alpha, so that hidden texels do not bleed; linear alpha */
    SVO_TEXEL_LINEAR = 2         /* three linear numbers, alpha ignored (reads as 1) */
} svo_texel;

/* An image with its mip levels. Level 0 is the image itself; a texel of level l+1 is the exact area average of the texels
 * below it (sizes are halved and rounded down, so parts of texels count as parts), kept as 16-bit linear numbers.
 * For COLOR_ALPHA there is also the largest alpha below each texel. Read-only after creation. */
typedef struct svo_pyramid {
    const svo_image *image;
    svo_texel kind;
    uint32_t levels;
    uint32_t width[32], height[32];
    float share_x[32], share_y[32]; /* of the image's width and height */
    uint16_t *texels[32]; /* 4 a texel; [0] is NULL but after svo_pyramid_expand; COLOR_ALPHA: premultiplied */
    uint8_t *most[32];    /* COLOR_ALPHA: largest alpha; [0] is NULL (the image itself) */
    float linear[256];   /* of a byte of level 0: of sRGB, or byte / 255 */
    float stored[256];   /* the same as the other levels hold it: whole numbers up to 65535 */
    uint8_t halves[2][256]; /* their lower and upper bytes */
    const svo_allocator *allocator;
    bool outside;     /* the image is paged, */
    svo_paged *paged; /* and levels 1.. are in this */
} svo_pyramid;

/* The image is borrowed. SVO_OUT_OF_MEMORY. */
svo_result svo_pyramid_create(const svo_image *image, svo_texel kind, const svo_allocator *a, svo_pyramid *out, svo_error *err);
void svo_pyramid_free(svo_pyramid *p);
/* Keep an image without alpha, of which all is in memory, as 16-bit linear numbers too (8 bytes a texel, alpha 65535), where memory allows it: readings of
 * many texels are quicker, and the same. */
void svo_pyramid_expand(svo_pyramid *p);
/* The image alone, with no levels above it: nothing is allocated, nothing needs to be freed. */
void svo_pyramid_finest(const svo_image *image, svo_texel kind, svo_pyramid *out);

/* Bilinear in the level, linear between levels; level <= 0 is the image itself, read to the nearest texel where the
 * texture says so. u, v as in svo_mesh.h (wrapped here; not finite reads as 0). out: linear RGBA, colours premultiplied for COLOR_ALPHA. */
void svo_pyramid_sample(const svo_pyramid *p, const svo_texture *how, double u, double v, double level, float out[4]);

/* An upper bound of alpha over the texels that [u0, u1] x [v0, v1] touches (nearest texels, no filter), exact when that
 * is at most 4 x 4 texels. COLOR_ALPHA only. */
float svo_pyramid_most_alpha(const svo_pyramid *p, const svo_texture *how, double u0, double u1, double v0, double v1);

/* Memory for many texels, as svo_alloc gives it, in large pages where the system has them: they are read here and there. */
void *svo_alloc_texels(const svo_allocator *a, uint64_t count, size_t size);

#ifdef __cplusplus
}
#endif
#endif
