/* Shared by the image decoders. A decoder fills width, height and pixels (RGBA8, from `a`); out is zeroed before and
 * freed by the caller on failure. */
#ifndef IMAGE_INTERNAL_H
#define IMAGE_INTERNAL_H

#include "fmt_image.h"

/* Where pixels and what a decoder needs come from. */
typedef struct image_memory {
    const svo_allocator *a;
    svo_pager *pager; /* of pixels that are too many to be kept; may be NULL */
    bool mapped;      /* the bytes are a mapped file, of which no more should stay in memory than has to */
} image_memory;

/* width * height against the limit, then zeroed memory for the pixels. `kind` names the format in messages. Rows are touched (svo_image_touch) before
 * they are written. */
svo_result image_allocate(const char *kind, uint64_t width, uint64_t height, uint64_t max_pixels, const image_memory *memory,
                          svo_image *out, svo_error *err);

svo_result image_decode_png(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory, svo_image *out,
                            svo_error *err);
svo_result image_decode_jpeg(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory, svo_image *out,
                             svo_error *err);
svo_result image_decode_bmp(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory, svo_image *out,
                            svo_error *err);
/* TGA has no signature: can these bytes begin one? */
bool image_looks_like_tga(const uint8_t *bytes, uint64_t size);
svo_result image_decode_tga(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory, svo_image *out,
                            svo_error *err);

#endif
