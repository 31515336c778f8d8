/* OpenEXR, the simplest kind: one part of scan lines, not compressed (https://openexr.com/en/latest/OpenEXRFileLayout.html). */
#include "fmt_exr.h"

#include <string.h>

typedef struct header {
    uint8_t bytes[4096];
    size_t size;
} header;

static void put(header *h, const void *bytes, size_t size)
{
    SVO_ASSERT(size <= sizeof h->bytes - h->size);
    memcpy(h->bytes + h->size, bytes, size);
    h->size += size;
}
static void put_text(header *h, const char *text) { put(h, text, strlen(text) + 1); }
static void put_u32(header *h, uint32_t x) { put(h, &x, 4); }
static void put_float(header *h, float x) { put(h, &x, 4); }
static void attribute(header *h, const char *name, const char *type, uint32_t size)
{
    put_text(h, name);
    put_text(h, type);
    put_u32(h, size);
}

svo_result fmt_exr_write(fmt_output *out, uint32_t width, uint32_t height, const fmt_exr_channel *channels, uint32_t count, svo_error *err)
{
    const fmt_exr_channel *sorted[FMT_EXR_CHANNELS];
    header h = {.size = 0};
    uint32_t list = 1;
    if (count < 1 || count > FMT_EXR_CHANNELS || width < 1 || height < 1 || width > 65536 || height > 65536)
        return svo_fail(err, SVO_INVALID_ARGUMENT, "an EXR picture of %u x %u pixels and %u channels", width, height, count);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t k = i;
        for (; k > 0 && strcmp(sorted[k - 1]->name, channels[i].name) > 0; k--) sorted[k] = sorted[k - 1];
        sorted[k] = &channels[i];
        if (strlen(channels[i].name) > 31) return svo_fail(err, SVO_INVALID_ARGUMENT, "names of EXR channels have at most 31 letters");
        list += (uint32_t)strlen(channels[i].name) + 1 + 16;
    }
    put_u32(&h, 20000630);
    put_u32(&h, 2);
    attribute(&h, "channels", "chlist", list);
    for (uint32_t i = 0; i < count; i++) {
        put_text(&h, sorted[i]->name);
        put_u32(&h, sorted[i]->kind == FMT_EXR_FLOAT ? 2 : 0);
        put_u32(&h, 0); /* not perceptually linear; three reserved bytes */
        put_u32(&h, 1);
        put_u32(&h, 1);
    }
    put(&h, "", 1);
    attribute(&h, "compression", "compression", 1);
    put(&h, "", 1); /* none */
    for (int i = 0; i < 2; i++) {
        attribute(&h, i == 0 ? "dataWindow" : "displayWindow", "box2i", 16);
        put_u32(&h, 0), put_u32(&h, 0), put_u32(&h, width - 1), put_u32(&h, height - 1);
    }
    attribute(&h, "lineOrder", "lineOrder", 1);
    put(&h, "", 1); /* increasing */
    attribute(&h, "pixelAspectRatio", "float", 4);
    put_float(&h, 1);
    attribute(&h, "screenWindowCenter", "v2f", 8);
    put_float(&h, 0), put_float(&h, 0);
    attribute(&h, "screenWindowWidth", "float", 4);
    put_float(&h, 1);
    put(&h, "", 1);
    SVO_TRY(fmt_output_write(out, h.bytes, h.size, err));
    uint64_t line = 8 + (uint64_t)count * width * 4, at = h.size + 8 * (uint64_t)height;
    for (uint32_t y = 0; y < height; y++, at += line) SVO_TRY(fmt_output_write(out, &at, 8, err));
    for (uint32_t y = 0; y < height; y++) {
        uint32_t start[2] = {y, count * width * 4}, piece[1024];
        SVO_TRY(fmt_output_write(out, start, 8, err));
        for (uint32_t i = 0; i < count; i++) {
            const uint32_t *values = (const uint32_t *)sorted[i]->values + (uint64_t)y * width * sorted[i]->stride;
            for (uint32_t x = 0; x < width; x += 1024) {
                uint32_t n = width - x < 1024 ? width - x : 1024;
                for (uint32_t k = 0; k < n; k++) piece[k] = values[(uint64_t)(x + k) * sorted[i]->stride];
                SVO_TRY(fmt_output_write(out, piece, 4 * (size_t)n, err));
            }
        }
    }
    return SVO_OK;
}
