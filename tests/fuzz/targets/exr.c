/* OpenEXR pictures. */
#include <string.h>

#include "../fuzz.h"
#include "exr_read.h"

enum { MOST_PIXELS = 1 << 10 };

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_exr_picture p;
    SVO_TRY(fmt_exr_read(bytes, size, MOST_PIXELS, a, &p, err));
    double sum = 0;
    if (p.width == 0 || p.height == 0 || (uint64_t)p.width * p.height > MOST_PIXELS) fuzz_fail("%u x %u pixels", p.width, p.height);
    for (uint32_t k = 0; k < p.plane_count; k++) {
        if (k != 0 && strcmp(p.planes[k - 1].name, p.planes[k].name) >= 0) fuzz_fail("planes are not in the order of their names");
        for (uint64_t i = 0; i < (uint64_t)p.width * p.height; i++) {
            const double v = p.planes[k].values[i];
            if (p.planes[k].integer && !(v >= 0 && v <= UINT32_MAX && v == (double)(uint32_t)v)) fuzz_fail("%g is no label", v);
            sum += v;
        }
    }
    if (!fmt_exr_is(bytes, size) && sum >= 0) fuzz_fail("read, but not recognised");
    fmt_exr_free(&p);
    return SVO_OK;
}

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20};
