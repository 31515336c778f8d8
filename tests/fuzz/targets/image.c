/* PNG, JPEG, BMP and TGA, told apart by their bytes. */
#include "../fuzz.h"
#include "fmt_image.h"

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    svo_image image = {0};
    SVO_TRY(fmt_image_decode(bytes, size, 1 << 20, a, &image, err));
    uint8_t all = 255;
    if (image.width == 0 || image.height == 0 || (uint64_t)image.width * image.height > 1 << 20) fuzz_fail("%u x %u pixels", image.width, image.height);
    for (uint64_t i = 0; i < (uint64_t)image.width * image.height; i++) all &= image.pixels[4 * i + 3];
    if (image.has_alpha != (all != 255)) fuzz_fail("has_alpha is wrong");
    fmt_image_free(a, &image);
    return SVO_OK;
}

const fuzz_target fuzz_this = {.read = read, .memory = 32 << 20};
