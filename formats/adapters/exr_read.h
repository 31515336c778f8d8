/* OpenEXR pictures in, by the OpenEXR library. */
#ifndef EXR_READ_H
#define EXR_READ_H

#include "svo_alloc.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct fmt_exr_plane {
    char name[256];
    bool integer; /* unsigned 32 bits; else a float of 32 or 16 bits */
    double *values; /* width * height, row 0 on top */
} fmt_exr_plane;

/* Planes by name. Channels that are subsampled have the nearest sample below and left of each pixel. */
typedef struct fmt_exr_picture {
    const svo_allocator *allocator;
    uint32_t width, height, plane_count;
    fmt_exr_plane *planes;
} fmt_exr_picture;

/* Is this the beginning of one? */
bool fmt_exr_is(const uint8_t *head, uint64_t size);

/* `bytes` (borrowed) is a whole file with scan lines or tiles, in any compression; of several parts the first. The data window is the picture. SVO_INVALID_DATA for damaged files,
 * SVO_UNSUPPORTED for deep pictures and where OpenEXR was not there when svokit was built, SVO_LIMIT beyond 65536 pixels a side or max_pixels (0 = 2^28) in all. Memory: 8 bytes a pixel and plane in `a`,
 * and what the library takes for a row of blocks. One thread; not for several at once (the library's limits are global). */
svo_result fmt_exr_read(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const svo_allocator *a, fmt_exr_picture *out, svo_error *err);
void fmt_exr_free(fmt_exr_picture *p);

#ifdef __cplusplus
}
#endif
#endif
