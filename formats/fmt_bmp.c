/* Windows bitmaps: 1, 4, 8, 16, 24 and 32 bits a pixel, not run-length coded. */
#include "fmt_container.h"
#include "image_internal.h"

typedef struct bmp {
    uint32_t width, height, bits;
    bool top_down;
    uint32_t mask[4]; /* R G B A, for 16 and 32 bits */
    const uint8_t *palette;
    uint32_t palette_count, palette_stride;
    const uint8_t *rows;
    uint64_t stride;
} bmp;

static svo_result bad(svo_error *err, const char *why) { return svo_fail(err, SVO_INVALID_DATA, "BMP image: %s", why); }

/* A channel of 1..32 bits scaled to 8; an absent one gives `absent`. */
static uint8_t channel(uint32_t pixel, uint32_t mask, uint8_t absent)
{
    if (mask == 0) return absent;
    uint32_t shift = (uint32_t)__builtin_ctz(mask), top = mask >> shift;
    uint64_t v = (pixel & mask) >> shift;
    return (uint8_t)((v * 255 + top / 2) / top);
}

static bool mask_is_run(uint32_t mask)
{
    if (mask == 0) return true;
    uint64_t m = mask >> __builtin_ctz(mask);
    return (m & (m + 1)) == 0;
}

static svo_result read_masks(bmp *b, fmt_cursor *c, uint32_t header, uint32_t compression, svo_error *err)
{
    static const uint32_t plain16[4] = {0x7c00, 0x03e0, 0x001f, 0}, plain32[4] = {0xff0000, 0xff00, 0xff, 0};
    for (int i = 0; i < 4; i++) b->mask[i] = b->bits == 16 ? plain16[i] : plain32[i];
    if (compression == 0) return SVO_OK;
    /* After a 40-byte header three masks (four with compression 6) follow; longer headers contain them. */
    int count = header >= 56 || compression == 6 ? 4 : 3;
    b->mask[3] = 0;
    for (int i = 0; i < count; i++) {
        b->mask[i] = fmt_cursor_u32(c);
        if (!mask_is_run(b->mask[i])) return bad(err, "a channel mask is not contiguous");
    }
    return c->ok ? SVO_OK : bad(err, "the file ends inside the header");
}

static svo_result read_header(bmp *b, const uint8_t *bytes, uint64_t size, svo_error *err)
{
    fmt_cursor c = fmt_cursor_make(bytes, size);
    fmt_cursor_take(&c, 10);
    uint32_t rows = fmt_cursor_u32(&c), header = fmt_cursor_u32(&c);
    if (!c.ok) return bad(err, "the file ends inside the header");
    uint32_t compression = 0, used = 0, planes;
    int64_t height;
    if (header == 12) {
        b->width = fmt_cursor_u16(&c);
        height = fmt_cursor_u16(&c);
        planes = fmt_cursor_u16(&c);
        b->bits = fmt_cursor_u16(&c);
        b->palette_stride = 3;
    } else if (header == 40 || header == 52 || header == 56 || header == 108 || header == 124) {
        b->width = fmt_cursor_u32(&c);
        height = (int32_t)fmt_cursor_u32(&c);
        planes = fmt_cursor_u16(&c);
        b->bits = fmt_cursor_u16(&c);
        compression = fmt_cursor_u32(&c);
        fmt_cursor_take(&c, 12);
        used = fmt_cursor_u32(&c);
        fmt_cursor_u32(&c);
        b->palette_stride = 4;
    } else {
        return svo_fail(err, SVO_UNSUPPORTED, "BMP image: header of %u bytes is not supported", header);
    }
    if (!c.ok) return bad(err, "the file ends inside the header");
    if (planes != 1) return bad(err, "planes is not 1");
    b->top_down = height < 0;
    b->height = (uint32_t)(height < 0 ? -height : height);
    bool indexed = b->bits == 1 || b->bits == 4 || b->bits == 8;
    bool masked = b->bits == 16 || b->bits == 32;
    if (!indexed && !masked && b->bits != 24) return bad(err, "unknown number of bits a pixel");
    if (compression == 1 || compression == 2 || compression == 4 || compression == 5)
        return svo_fail(err, SVO_UNSUPPORTED, "BMP image: compression %u is not supported", compression);
    if (compression != 0 && !(masked && (compression == 3 || compression == 6))) return bad(err, "unknown compression");
    if (masked) SVO_TRY(read_masks(b, &c, header, compression, err));
    if (indexed) {
        uint32_t most = 1u << b->bits;
        if (used > most) return bad(err, "the palette is too long");
        b->palette_count = used != 0 ? used : most;
        fmt_cursor p = fmt_cursor_make(bytes, size);
        fmt_cursor_take(&p, 14 + (uint64_t)header);
        b->palette = fmt_cursor_take(&p, (uint64_t)b->palette_count * b->palette_stride);
        if (b->palette == NULL) return bad(err, "the file ends inside the palette");
    }
    b->stride = ((uint64_t)b->width * b->bits + 31) / 32 * 4;
    if (rows < 14 + (uint64_t)header || rows > size) return bad(err, "the pixels begin outside the file");
    if (b->height != 0 && b->stride > (size - rows) / b->height) return bad(err, "the file is too short for the size it states");
    b->rows = bytes + rows;
    return SVO_OK;
}

static bool convert_pixel(const bmp *b, const uint8_t *row, uint32_t x, uint8_t *to)
{
    to[3] = 255;
    if (b->bits == 24) {
        for (int k = 0; k < 3; k++) to[k] = row[3 * (size_t)x + 2 - (size_t)k];
    } else if (b->bits >= 16) {
        uint32_t pixel = b->bits == 16 ? fmt_load16(row + 2 * (size_t)x) : fmt_load32(row + 4 * (size_t)x);
        for (int k = 0; k < 4; k++) to[k] = channel(pixel, b->mask[k], k == 3 ? 255 : 0);
    } else {
        uint32_t per_byte = 8 / b->bits, shift = 8 - b->bits * (x % per_byte + 1);
        uint32_t index = row[x / per_byte] >> shift & ((1u << b->bits) - 1);
        if (index >= b->palette_count) return false;
        const uint8_t *entry = b->palette + (size_t)index * b->palette_stride;
        for (int k = 0; k < 3; k++) to[k] = entry[2 - k];
    }
    return true;
}

svo_result image_decode_bmp(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory, svo_image *out,
                            svo_error *err)
{
    bmp b = {0};
    SVO_TRY(read_header(&b, bytes, size, err));
    SVO_TRY(image_allocate("BMP", b.width, b.height, max_pixels, memory, out, err));
    for (uint32_t y = 0; y < b.height; y++) {
        const uint8_t *row = b.rows + b.stride * (b.top_down ? y : b.height - 1 - y);
        svo_image_touch(out, 0, y, b.width);
        uint8_t *to = out->pixels + 4 * (size_t)b.width * y;
        for (uint32_t x = 0; x < b.width; x++)
            if (!convert_pixel(&b, row, x, to + 4 * (size_t)x)) return bad(err, "a pixel points outside the palette");
    }
    return SVO_OK;
}
