/* Truevision TGA: colour-mapped, true colour and grey, plain or run-length coded. */
#include "fmt_container.h"
#include "image_internal.h"

typedef struct tga {
    uint32_t type; /* 1 mapped, 2 true colour, 3 grey */
    bool packed, right_to_left, top_down;
    uint32_t width, height, bits, alpha_bits;
    uint32_t map_first, map_count, map_bits;
    const uint8_t *map;
} tga;

static svo_result bad(svo_error *err, const char *why) { return svo_fail(err, SVO_INVALID_DATA, "TGA image: %s", why); }

/* Header fields that are possible at all; used both to recognise a TGA file and to refuse a bad one. */
static bool header_fields(const uint8_t *h, tga *t)
{
    uint32_t type = h[2], map_type = h[1];
    t->packed = type >= 8;
    t->type = type & 7;
    t->map_first = fmt_load16(h + 3);
    t->map_count = fmt_load16(h + 5);
    t->map_bits = h[7];
    t->width = fmt_load16(h + 12);
    t->height = fmt_load16(h + 14);
    t->bits = h[16];
    t->alpha_bits = h[17] & 15;
    t->right_to_left = (h[17] & 16) != 0;
    t->top_down = (h[17] & 32) != 0;
    if (type > 11 || t->type < 1 || t->type > 3 || map_type > 1 || (h[17] & 0xc0) != 0 || t->alpha_bits > 8) return false;
    if (t->width == 0 || t->height == 0) return false;
    if (map_type == 1 && t->map_bits != 15 && t->map_bits != 16 && t->map_bits != 24 && t->map_bits != 32) return false;
    switch (t->type) {
    case 1: return map_type == 1 && (t->bits == 8 || t->bits == 16);
    case 2: return t->bits == 15 || t->bits == 16 || t->bits == 24 || t->bits == 32;
    default: return t->bits == 8;
    }
}

bool image_looks_like_tga(const uint8_t *bytes, uint64_t size)
{
    tga t = {0};
    return size >= 18 && header_fields(bytes, &t);
}

/* Colour of `bits` bits at p: BGR, BGRA, or 5 bits each. */
static void color(const uint8_t *p, uint32_t bits, uint32_t alpha_bits, uint8_t to[4])
{
    to[3] = 255;
    if (bits <= 16) {
        uint32_t v = fmt_load16(p);
        for (int k = 0; k < 3; k++) to[k] = (uint8_t)(((v >> (10 - 5 * k) & 31) * 255 + 15) / 31);
        if (bits == 16 && alpha_bits == 1) to[3] = (v & 0x8000) != 0 ? 255 : 0;
        return;
    }
    for (int k = 0; k < 3; k++) to[k] = p[2 - k];
    if (bits == 32 && alpha_bits > 0) to[3] = p[3];
}

/* A stored pixel to RGBA; false when it points outside the colour map. */
static bool convert(const tga *t, const uint8_t *p, uint8_t to[4])
{
    if (t->type == 2) {
        color(p, t->bits, t->alpha_bits, to);
    } else if (t->type == 3) {
        to[0] = to[1] = to[2] = p[0];
        to[3] = 255;
    } else {
        uint32_t index = t->bits == 8 ? p[0] : fmt_load16(p);
        if (index < t->map_first || index - t->map_first >= t->map_count) return false;
        color(t->map + (size_t)(index - t->map_first) * ((t->map_bits + 7) / 8), t->map_bits, t->map_bits == 32 ? 8 : t->alpha_bits, to);
    }
    return true;
}

static uint8_t *place(const tga *t, svo_image *out, uint64_t i)
{
    uint64_t x = i % t->width, y = i / t->width;
    if (t->right_to_left) x = t->width - 1 - x;
    if (!t->top_down) y = t->height - 1 - y;
    svo_image_touch(out, (uint32_t)x, (uint32_t)y, 1);
    return out->pixels + 4 * (y * t->width + x);
}

static svo_result unpack(const tga *t, fmt_cursor *c, svo_image *out, svo_error *err)
{
    uint64_t count = (uint64_t)t->width * t->height, step = (t->bits + 7) / 8;
    for (uint64_t i = 0; i < count;) {
        uint64_t run = count;
        bool repeat = false;
        if (t->packed) {
            uint8_t head = fmt_cursor_u8(c);
            run = (head & 127u) + 1u;
            repeat = head >= 128;
        }
        if (run > count - i) return bad(err, "a run goes past the end of the image");
        const uint8_t *p = fmt_cursor_take(c, repeat ? step : run * step);
        if (p == NULL) return bad(err, "the file ends inside the image");
        for (uint64_t k = 0; k < run; k++, i++)
            if (!convert(t, repeat ? p : p + k * step, place(t, out, i))) return bad(err, "a pixel points outside the colour map");
    }
    return SVO_OK;
}

svo_result image_decode_tga(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory, svo_image *out,
                            svo_error *err)
{
    tga t = {0};
    if (size < 18 || !header_fields(bytes, &t)) return bad(err, "the header is not valid");
    fmt_cursor c = fmt_cursor_make(bytes, size);
    fmt_cursor_take(&c, 18 + (uint64_t)bytes[0]);
    if (bytes[1] == 1) {
        t.map = fmt_cursor_take(&c, (uint64_t)t.map_count * ((t.map_bits + 7) / 8));
        if (t.map == NULL) return bad(err, "the file ends inside the colour map");
    }
    if (!c.ok) return bad(err, "the file ends inside the header");
    /* A packet holds at most 128 pixels and takes two bytes at least. */
    uint64_t pixels = (uint64_t)t.width * t.height, left = size - c.at, step = (t.bits + 7) / 8;
    if (t.packed ? pixels / 128 > left : pixels > left / step) return bad(err, "the file is too short for the size it states");
    SVO_TRY(image_allocate("TGA", t.width, t.height, max_pixels, memory, out, err));
    return unpack(&t, &c, out, err);
}
