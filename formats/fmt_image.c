#include "fmt_image.h"

#include <string.h>

#include "image_internal.h"
#include "svo_texture.h"

static const uint64_t DEFAULT_MAX_PIXELS = (uint64_t)1 << 28;

svo_result image_allocate(const char *kind, uint64_t width, uint64_t height, uint64_t max_pixels, const image_memory *memory,
                          svo_image *out, svo_error *err)
{
    if (width == 0 || height == 0 || width > INT32_MAX || height > INT32_MAX)
        return svo_fail(err, SVO_INVALID_DATA, "%s image of %llu x %llu pixels", kind, (unsigned long long)width, (unsigned long long)height);
    if (height > max_pixels / width)
        return svo_fail(err, SVO_LIMIT, "%s image is %llu x %llu pixels; at most %llu pixels are accepted", kind,
                        (unsigned long long)width, (unsigned long long)height, (unsigned long long)max_pixels);
    /* What it takes later, filtered levels included: 4 bytes a pixel and a third of 8, and a third of one for alpha. */
    if (memory->pager != NULL && !svo_pager_keeps(memory->pager, 7 * width * height)) {
        svo_result r = svo_paged_create(memory->pager, 4 * width * height, &out->paged, err);
        if (r != SVO_OK) return r == SVO_LIMIT ? SVO_OUT_OF_MEMORY : r; /* not a limit of images */
        out->pixels = out->paged->data;
    } else {
        out->pixels = svo_alloc_texels(memory->a, width * height, 4);
        if (out->pixels != NULL) memset(out->pixels, 0, (size_t)(width * height) * 4);
    }
    if (out->pixels == NULL)
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a %s image of %llu x %llu pixels", kind,
                        (unsigned long long)width, (unsigned long long)height);
    out->width = (uint32_t)width;
    out->height = (uint32_t)height;
    return SVO_OK;
}

typedef svo_result (*decoder)(const uint8_t *, uint64_t, uint64_t, const image_memory *, svo_image *, svo_error *);

static bool starts(const uint8_t *bytes, uint64_t size, uint64_t at, const char *text, uint64_t length)
{
    return at <= size && length <= size - at && memcmp(bytes + at, text, length) == 0;
}

/* The decoder for these bytes, or NULL and the name of a format that is recognised but not read. */
static decoder sniff(const uint8_t *b, uint64_t n, const char **name)
{
    static const struct { uint32_t at, length; const char *magic, *name; decoder fn; } known[] = {
        {0, 8, "\x89PNG\r\n\x1a\n", "PNG", image_decode_png},
        {0, 3, "\xff\xd8\xff", "JPEG", image_decode_jpeg},
        {8, 4, "WEBP", "WebP", NULL},
        {0, 12, "\xabKTX 20\xbb\r\n\x1a\n", "KTX2 (Basis Universal)", NULL},
        {0, 12, "\xabKTX 11\xbb\r\n\x1a\n", "KTX", NULL},
        {0, 4, "DDS ", "DDS", NULL},
        {0, 4, "GIF8", "GIF", NULL},
        {0, 4, "II*\0", "TIFF", NULL},
        {0, 4, "MM\0*", "TIFF", NULL},
        {0, 4, "8BPS", "PSD", NULL},
        {0, 4, "v/1\x01", "OpenEXR", NULL},
        {0, 10, "#?RADIANCE", "Radiance HDR", NULL},
        {4, 8, "ftypavif", "AVIF", NULL},
        {4, 8, "ftypheic", "HEIF", NULL},
        {0, 12, "\0\0\0\x0cjP  \r\n\x87\n", "JPEG 2000", NULL},
        {0, 4, "qoif", "QOI", NULL},
        {0, 2, "BM", "BMP", image_decode_bmp},
    };
    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        if (!starts(b, n, known[i].at, known[i].magic, known[i].length)) continue;
        *name = known[i].name;
        return known[i].fn;
    }
    *name = NULL;
    return image_looks_like_tga(b, n) ? image_decode_tga : NULL;
}

svo_result fmt_image_decode_paged(const uint8_t *bytes, uint64_t size, bool mapped, uint64_t max_pixels, const svo_allocator *a, svo_pager *pager, svo_image *out,
                                  svo_error *err)
{
    const image_memory memory = {a, pager, mapped && pager != NULL};
    if (size == 0) return svo_fail(err, SVO_INVALID_DATA, "the image is empty");
    const char *name;
    decoder fn = sniff(bytes, size, &name);
    if (fn == NULL && name != NULL)
        return svo_fail(err, SVO_UNSUPPORTED, "%s images are not supported; PNG, JPEG, BMP and TGA are", name);
    if (fn == NULL) return svo_fail(err, SVO_INVALID_DATA, "not an image of a known format (PNG, JPEG, BMP and TGA are read)");
    svo_image image = {0};
    svo_result r = fn(bytes, size, max_pixels != 0 ? max_pixels : DEFAULT_MAX_PIXELS, &memory, &image, err);
    if (r != SVO_OK) {
        fmt_image_free(a, &image);
        return r;
    }
    if (memory.mapped) fmt_bytes_forget(bytes, size);
    uint8_t all = 255;
    for (uint32_t y = 0; y < image.height; y++) {
        svo_image_touch(&image, 0, y, image.width);
        const uint8_t *row = image.pixels + 4 * (uint64_t)y * image.width;
        for (uint32_t x = 0; x < image.width; x++) all &= row[4 * (uint64_t)x + 3];
    }
    image.has_alpha = all != 255;
    *out = image;
    return SVO_OK;
}

svo_result fmt_image_decode(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const svo_allocator *a, svo_image *out, svo_error *err)
{
    return fmt_image_decode_paged(bytes, size, false, max_pixels, a, NULL, out, err);
}

bool fmt_image_is_known(const uint8_t *bytes, uint64_t size)
{
    const char *name;
    return size != 0 && (sniff(bytes, size, &name) != NULL || name != NULL);
}

bool fmt_image_can_have_alpha(const uint8_t *bytes, uint64_t size)
{
    const char *name;
    decoder fn = size != 0 ? sniff(bytes, size, &name) : NULL;
    if (fn == image_decode_jpeg) return false;
    if (fn != image_decode_png || size < 33) return true;
    if (bytes[25] & 4) return true; /* colour type */
    for (uint64_t at = 8; size - at >= 12;) {
        const uint64_t length = (uint64_t)bytes[at] << 24 | (uint64_t)bytes[at + 1] << 16 | (uint64_t)bytes[at + 2] << 8 | bytes[at + 3];
        if (memcmp(bytes + at + 4, "tRNS", 4) == 0) return true;
        if (memcmp(bytes + at + 4, "IDAT", 4) == 0) return false; /* it would come before */
        if (length > size - at - 12) return true;
        at += 12 + length;
    }
    return true;
}

svo_result fmt_image_read(const char *path, uint64_t max_pixels, const svo_allocator *a, svo_image *out, svo_error *err)
{
    fmt_bytes file;
    SVO_TRY(fmt_bytes_open(path, 0, a, &file, err));
    svo_result r = fmt_image_decode(file.data, file.size, max_pixels, a, out, err);
    fmt_bytes_close(&file);
    if (r == SVO_OK) return r;
    svo_error inner = {0};
    if (err != NULL) inner = *err;
    return svo_fail(err, r, "%s: %s", path, inner.message);
}

void fmt_image_free(const svo_allocator *a, svo_image *image)
{
    if (image == NULL) return;
    svo_string_free(a, image->name);
    svo_image_free_pixels(a, image);
    memset(image, 0, sizeof *image);
}
