/* OpenEXR pictures out: channels of 32-bit floats or integers, not compressed. */
#ifndef FMT_EXR_H
#define FMT_EXR_H

#include "fmt_file.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { FMT_EXR_CHANNELS = 32 };
typedef enum fmt_exr_kind { FMT_EXR_FLOAT, FMT_EXR_UINT } fmt_exr_kind;

/* One channel: value of pixel x, y is the 4 bytes at values + 4 * stride * (y * width + x), row 0 on top. */
typedef struct fmt_exr_channel {
    const char *name; /* at most 31 letters; "R", "Z", "N.X", ... */
    fmt_exr_kind kind;
    const void *values;
    uint32_t stride;
} fmt_exr_channel;

/* Channels in any order (the file has them by name), at most FMT_EXR_CHANNELS. Deterministic. */
svo_result fmt_exr_write(fmt_output *out, uint32_t width, uint32_t height, const fmt_exr_channel *channels, uint32_t count, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
