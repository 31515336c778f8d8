/* PNG, JPEG (and BMP, TGA) images in, PNG out. */
#ifndef FMT_IMAGE_H
#define FMT_IMAGE_H

#include "fmt_file.h"
#include "svo_mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Decode bytes of any supported format to RGBA8 (16-bit samples are rounded to 8; palette, grey and tRNS expanded;
 * gAMA and ICC ignored as glTF asks). Dimensions are checked against max_pixels (0 = 2^28) before memory is taken. */
svo_result fmt_image_decode(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const svo_allocator *a, svo_image *out, svo_error *err);
/* The same with pixels in the pager (may be NULL) where they are too many to be kept in memory. mapped: the bytes are a mapped file, and do not
 * stay in memory. */
svo_result fmt_image_decode_paged(const uint8_t *bytes, uint64_t size, bool mapped, uint64_t max_pixels, const svo_allocator *a, svo_pager *pager, svo_image *out,
                                  svo_error *err);
svo_result fmt_image_read(const char *path, uint64_t max_pixels, const svo_allocator *a, svo_image *out, svo_error *err);
/* Do the bytes begin as some image, one that is read or one that is not? (TGA has no signature: what could be one is.) */
bool fmt_image_is_known(const uint8_t *bytes, uint64_t size);
/* False for a JPEG and for a PNG that states no alpha: all their pixels are opaque. */
bool fmt_image_can_have_alpha(const uint8_t *bytes, uint64_t size);
void fmt_image_free(const svo_allocator *a, svo_image *image);

/* 8-bit PNG with `channels` (3 RGB or 4 RGBA) interleaved, row 0 on top; sRGB chunk set. Deterministic. */
svo_result fmt_png_write(fmt_output *out, const uint8_t *pixels, uint32_t width, uint32_t height, uint32_t channels, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
