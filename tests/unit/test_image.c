/* Image reading against libpng's and libjpeg's writers, against stb_image as a second reader, and against damage. */
#define _GNU_SOURCE
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jpeglib.h>
#include <png.h>

#define STB_IMAGE_IMPLEMENTATION
#define STB_IMAGE_STATIC
#define STBI_NO_STDIO
#define STBI_NO_LINEAR
#define STBI_NO_HDR
#pragma GCC diagnostic ignored "-Wunused-function" /* stb declares more than it defines */
#include <stb/stb_image.h>

#include "fmt_container.h"
#include "fmt_image.h"
#include "test.h"

/* --- making images --- */

static void png_take(png_structp png, png_bytep from, size_t count)
{
    if (svo_buffer_append(png_get_io_ptr(png), from, count) == NULL) abort();
}
static void png_no_flush(png_structp png) { (void)png; }

typedef struct png_recipe {
    int color_type, depth;
    bool interlaced, transparent; /* tRNS */
    bool junk;                    /* gAMA that must be ignored, a text chunk */
    uint32_t width, height;
} png_recipe;

/* Sample s (0..2^depth-1) of channel k at x, y. */
static uint32_t sample(const png_recipe *r, uint32_t x, uint32_t y, uint32_t k)
{
    uint64_t state = (uint64_t)y * 977 + x * 31 + k * 7 + 1;
    uint32_t v = (uint32_t)(test_random(&state) & ((1u << r->depth) - 1));
    if (r->color_type == PNG_COLOR_TYPE_PALETTE) v %= 13u < (1u << r->depth) ? 13u : 1u << r->depth;
    return v;
}

static void palette_entry(uint32_t i, uint8_t rgba[4])
{
    rgba[0] = (uint8_t)(i * 17), rgba[1] = (uint8_t)(255 - i * 5), rgba[2] = (uint8_t)(i * i), rgba[3] = (uint8_t)(i < 4 ? i * 60 : 255);
}

static uint32_t channels_of(int color_type)
{
    return color_type == PNG_COLOR_TYPE_RGB ? 3 : color_type == PNG_COLOR_TYPE_RGB_ALPHA ? 4 : color_type == PNG_COLOR_TYPE_GRAY_ALPHA ? 2 : 1;
}

static void make_png(const png_recipe *r, svo_buffer *to)
{
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);
    png_set_write_fn(png, to, png_take, png_no_flush);
    png_set_IHDR(png, info, r->width, r->height, r->depth, r->color_type, r->interlaced ? PNG_INTERLACE_ADAM7 : PNG_INTERLACE_NONE, 0, 0);
    if (r->color_type == PNG_COLOR_TYPE_PALETTE) {
        png_color colors[256];
        png_byte alpha[256];
        uint32_t n = 13u < (1u << r->depth) ? 13u : 1u << r->depth;
        for (uint32_t i = 0; i < n; i++) {
            uint8_t e[4];
            palette_entry(i, e);
            colors[i] = (png_color){e[0], e[1], e[2]};
            alpha[i] = e[3];
        }
        png_set_PLTE(png, info, colors, (int)n);
        if (r->transparent) png_set_tRNS(png, info, alpha, n < 4 ? (int)n : 4, NULL);
    } else if (r->transparent) {
        png_color_16 key = {0};
        key.gray = key.red = (png_uint_16)sample(r, 0, 0, 0);
        key.green = (png_uint_16)sample(r, 0, 0, 1), key.blue = (png_uint_16)sample(r, 0, 0, 2);
        png_set_tRNS(png, info, NULL, 0, &key);
    }
    if (r->junk) {
        png_text text = {.compression = PNG_TEXT_COMPRESSION_zTXt, .key = (char *)"Comment", .text = (char *)"nothing"};
        png_set_gAMA(png, info, 0.2);
        png_set_text(png, info, &text, 1);
    }
    png_write_info(png, info);
    int passes = png_set_interlace_handling(png);
    uint32_t ch = channels_of(r->color_type);
    for (int p = 0; p < passes; p++) {
        for (uint32_t y = 0; y < r->height; y++) {
            uint8_t row[4096] = {0};
            for (uint32_t x = 0; x < r->width; x++) {
                for (uint32_t k = 0; k < ch; k++) {
                    uint32_t v = sample(r, x, y, k), at = x * ch + k;
                    if (r->depth == 16) row[2 * at] = (uint8_t)(v >> 8), row[2 * at + 1] = (uint8_t)v;
                    else if (r->depth == 8) row[at] = (uint8_t)v;
                    else row[at * (uint32_t)r->depth / 8] |= (uint8_t)(v << (8 - r->depth - (int)(at * (uint32_t)r->depth % 8)));
                }
            }
            png_write_row(png, row);
        }
    }
    png_write_end(png, info);
    png_destroy_write_struct(&png, &info);
}

/* What the pixel must decode to, from the definition of PNG. */
static void expected_pixel(const png_recipe *r, uint32_t x, uint32_t y, uint8_t rgba[4])
{
    uint32_t ch = channels_of(r->color_type), top = (1u << r->depth) - 1, v[4];
    bool key = r->transparent && r->color_type != PNG_COLOR_TYPE_PALETTE;
    for (uint32_t k = 0; k < ch; k++) {
        v[k] = sample(r, x, y, k);
        key &= v[k] == sample(r, 0, 0, k);
    }
    if (r->color_type == PNG_COLOR_TYPE_PALETTE) {
        palette_entry(v[0], rgba);
        if (!r->transparent) rgba[3] = 255;
        return;
    }
    for (uint32_t k = 0; k < ch; k++) v[k] = (v[k] * 255 * 2 + top) / (2 * top); /* rounded */
    bool grey = ch <= 2;
    rgba[0] = (uint8_t)v[0], rgba[1] = (uint8_t)v[grey ? 0 : 1], rgba[2] = (uint8_t)v[grey ? 0 : 2];
    rgba[3] = ch == 2 || ch == 4 ? (uint8_t)v[ch - 1] : key ? 0 : 255;
}

static void smooth_pixel(uint32_t x, uint32_t y, uint8_t rgb[3])
{
    rgb[0] = (uint8_t)(40 + 3 * x), rgb[1] = (uint8_t)(200 - 2 * y), rgb[2] = (uint8_t)(90 + x + y);
}

enum { SMOOTH = 40 };

static void make_jpeg(J_COLOR_SPACE space, bool progressive, bool many_scans, int components, svo_buffer *to)
{
    struct jpeg_compress_struct info;
    struct jpeg_error_mgr errors;
    info.err = jpeg_std_error(&errors);
    jpeg_create_compress(&info);
    unsigned char *out = NULL;
    unsigned long size = 0;
    jpeg_mem_dest(&info, &out, &size);
    info.image_width = info.image_height = SMOOTH;
    info.input_components = components;
    info.in_color_space = space;
    jpeg_set_defaults(&info);
    jpeg_set_quality(&info, 97, TRUE);
    if (progressive) jpeg_simple_progression(&info);
    static jpeg_scan_info scans[127];
    if (many_scans) {
        scans[0] = (jpeg_scan_info){.comps_in_scan = 1};
        for (int i = 1; i < 64; i++) {
            scans[i] = (jpeg_scan_info){.comps_in_scan = 1, .Ss = i, .Se = i, .Ah = 0, .Al = 1};
            scans[63 + i] = (jpeg_scan_info){.comps_in_scan = 1, .Ss = i, .Se = i, .Ah = 1, .Al = 0};
        }
        info.scan_info = scans;
        info.num_scans = 127;
    }
    jpeg_start_compress(&info, TRUE);
    for (uint32_t y = 0; y < SMOOTH; y++) {
        uint8_t row[SMOOTH * 4];
        for (uint32_t x = 0; x < SMOOTH; x++) {
            uint8_t rgb[3];
            smooth_pixel(x, y, rgb);
            for (int k = 0; k < components; k++) row[x * (uint32_t)components + (uint32_t)k] = rgb[k % 3];
        }
        JSAMPROW rows = row;
        jpeg_write_scanlines(&info, &rows, 1);
    }
    jpeg_finish_compress(&info);
    svo_buffer_append(to, out, size);
    jpeg_destroy_compress(&info);
    free(out);
}

static void put32(svo_buffer *b, uint32_t v) { uint8_t t[4]; fmt_store32(t, v); svo_buffer_append(b, t, 4); }
static void put16(svo_buffer *b, uint32_t v) { uint8_t t[2]; fmt_store16(t, (uint16_t)v); svo_buffer_append(b, t, 2); }

/* Random pixels; for BI_BITFIELDS 5-6-5 in 16 bits. */
static void make_bmp(uint32_t bits, bool top_down, bool fields, uint32_t w, uint32_t h, svo_buffer *to)
{
    uint32_t palette = bits <= 8 ? 1u << bits : 0, stride = (w * bits + 31) / 32 * 4, offset = 54 + 4 * palette + (fields ? 12 : 0);
    svo_buffer_append(to, "BM", 2);
    put32(to, offset + stride * h), put32(to, 0), put32(to, offset), put32(to, 40), put32(to, w);
    put32(to, top_down ? (uint32_t)-(int32_t)h : h), put16(to, 1), put16(to, bits), put32(to, fields ? 3 : 0);
    put32(to, stride * h), put32(to, 2835), put32(to, 2835), put32(to, 0), put32(to, 0);
    if (fields) put32(to, 0xf800), put32(to, 0x07e0), put32(to, 0x001f);
    uint64_t state = bits;
    for (uint32_t i = 0; i < palette; i++) put32(to, (uint32_t)test_random(&state) & 0xffffff);
    for (uint32_t i = 0; i < stride * h; i++) {
        uint8_t v = (uint8_t)test_random(&state);
        /* in 32 bits the fourth byte means nothing, but stb_image takes it for alpha unless it is always 0 */
        if (bits == 32 && i % 4 == 3) v = 0;
        svo_buffer_append(to, &v, 1);
    }
}

static void make_tga(uint32_t type, uint32_t bits, uint32_t descriptor, uint32_t w, uint32_t h, svo_buffer *to)
{
    bool mapped = (type & 7) == 1;
    uint8_t head[18] = {2, mapped, (uint8_t)type, 0, 0, 0, (uint8_t)(mapped ? 1 : 0), (uint8_t)(mapped ? 24 : 0)};
    fmt_store16(head + 12, (uint16_t)w), fmt_store16(head + 14, (uint16_t)h);
    head[16] = (uint8_t)bits, head[17] = (uint8_t)descriptor;
    svo_buffer_append(to, head, 18);
    svo_buffer_append(to, "id", 2);
    uint64_t state = type * 100 + bits;
    for (int i = 0; mapped && i < 256 * 3; i++) { uint8_t v = (uint8_t)test_random(&state); svo_buffer_append(to, &v, 1); }
    uint64_t left = (uint64_t)w * h, step = (bits + 7) / 8;
    while (left > 0) {
        uint64_t run = left;
        bool repeat = false;
        if (type >= 8) {
            run = 1 + test_random(&state) % 128;
            if (run > left) run = left;
            repeat = test_random(&state) & 1;
            uint8_t packet = (uint8_t)((run - 1) | (repeat ? 128 : 0));
            svo_buffer_append(to, &packet, 1);
        }
        for (uint64_t i = 0; i < (repeat ? 1 : run) * step; i++) { uint8_t v = (uint8_t)test_random(&state); svo_buffer_append(to, &v, 1); }
        left -= run;
    }
}

/* --- right pixels --- */

TEST(png_of_every_kind_decodes_to_the_definition)
{
    static const struct { int type, depths[6]; } kinds[] = {
        {PNG_COLOR_TYPE_GRAY, {1, 2, 4, 8, 16, 0}}, {PNG_COLOR_TYPE_RGB, {8, 16, 0}}, {PNG_COLOR_TYPE_PALETTE, {1, 2, 4, 8, 0}},
        {PNG_COLOR_TYPE_GRAY_ALPHA, {8, 16, 0}}, {PNG_COLOR_TYPE_RGB_ALPHA, {8, 16, 0}}};
    int made = 0;
    for (size_t t = 0; t < 5; t++) {
        for (const int *depth = kinds[t].depths; *depth != 0; depth++) {
            for (int variant = 0; variant < 8; variant++) {
                png_recipe r = {kinds[t].type, *depth, variant & 1, variant & 2, variant & 4, 37, 23};
                if (r.transparent && (r.color_type & PNG_COLOR_MASK_ALPHA)) continue;
                svo_buffer file;
                svo_buffer_init(&file, NULL);
                make_png(&r, &file);
                svo_image image = {0};
                svo_error err = {0};
                CHECK_OK(fmt_image_decode(file.data, file.size, 0, NULL, &image, &err));
                CHECK(image.width == 37 && image.height == 23);
                bool alpha = false;
                for (uint32_t y = 0; y < 23; y++) {
                    for (uint32_t x = 0; x < 37; x++) {
                        uint8_t want[4], *got = image.pixels + 4 * (y * 37 + x);
                        expected_pixel(&r, x, y, want);
                        alpha |= want[3] < 255;
                        CHECK_MSG(memcmp(want, got, 4) == 0, "type %d depth %d variant %d at %u,%u: %u %u %u %u, expected %u %u %u %u",
                                  r.color_type, r.depth, variant, x, y, got[0], got[1], got[2], got[3], want[0], want[1], want[2], want[3]);
                    }
                }
                CHECK(image.has_alpha == alpha);
                CHECK(fmt_image_can_have_alpha(file.data, file.size) == (r.transparent || (r.color_type & PNG_COLOR_MASK_ALPHA) != 0));
                for (uint64_t n = 0; n < file.size; n++) CHECK(fmt_image_can_have_alpha(file.data, n) || (!alpha && n > 33));
                fmt_image_free(NULL, &image);
                svo_buffer_free(&file);
                made++;
            }
        }
    }
    CHECK(made > 60);
}

static int worst_difference(const svo_image *image, const uint8_t *other)
{
    int worst = 0;
    for (size_t i = 0; i < 4 * (size_t)image->width * image->height; i++) {
        int d = abs(image->pixels[i] - other[i]);
        if (d > worst) worst = d;
    }
    return worst;
}

/* Decodes both ways; the largest difference, or -1 when one of the two refused. */
static int against_stb(const svo_buffer *file)
{
    svo_image image = {0};
    svo_error err = {0};
    int w, h, n, worst = -1;
    if (fmt_image_decode(file->data, file->size, 0, NULL, &image, &err) != SVO_OK) {
        fprintf(stderr, "refused: %s\n", err.message);
        return -1;
    }
    stbi_uc *other = stbi_load_from_memory(file->data, (int)file->size, &w, &h, &n, 4);
    if (other != NULL && (uint32_t)w == image.width && (uint32_t)h == image.height) worst = worst_difference(&image, other);
    stbi_image_free(other);
    fmt_image_free(NULL, &image);
    return worst;
}

TEST(jpeg_baseline_progressive_and_grey)
{
    for (int kind = 0; kind < 4; kind++) {
        svo_buffer file;
        svo_buffer_init(&file, NULL);
        int components = kind >= 2 ? 1 : 3;
        make_jpeg(components == 1 ? JCS_GRAYSCALE : JCS_RGB, kind & 1, false, components, &file);
        int worst = against_stb(&file);
        CHECK_MSG(worst >= 0 && worst <= 4, "kind %d: %d from stb_image", kind, worst);
        svo_image image = {0};
        svo_error err = {0};
        CHECK_OK(fmt_image_decode(file.data, file.size, 0, NULL, &image, &err));
        CHECK(!fmt_image_can_have_alpha(file.data, file.size));
        CHECK(!image.has_alpha && image.width == SMOOTH && image.height == SMOOTH);
        for (uint32_t y = 0; y < SMOOTH; y++) {
            for (uint32_t x = 0; x < SMOOTH; x++) {
                uint8_t want[3];
                smooth_pixel(x, y, want);
                for (int k = 0; k < 3; k++)
                    CHECK(abs(image.pixels[4 * (y * SMOOTH + x) + (uint32_t)k] - want[components == 1 ? 0 : k]) <= 8);
            }
        }
        fmt_image_free(NULL, &image);
        svo_buffer_free(&file);
    }
}

TEST(bmp_and_tga_agree_with_a_second_reader)
{
    static const uint32_t bits[] = {1, 4, 8, 16, 24, 32};
    for (int i = 0; i < 6; i++) {
        for (int variant = 0; variant < 4; variant++) {
            if ((variant & 2) && bits[i] != 16) continue;
            svo_buffer file;
            svo_buffer_init(&file, NULL);
            make_bmp(bits[i], variant & 1, variant & 2, 19, 11, &file);
            int worst = against_stb(&file);
            /* stb widens 5 and 6 bits by repetition, we round: one step apart at most */
            CHECK_MSG(worst >= 0 && worst <= (bits[i] == 16 ? 1 : 0), "bmp %u bits, variant %d: %d", bits[i], variant, worst);
            svo_buffer_free(&file);
        }
    }
    static const struct { uint32_t type, bits, descriptor; } tga[] = {
        {1, 8, 0}, {2, 16, 0}, {2, 24, 0}, {2, 24, 32}, {2, 32, 8}, {2, 32, 40}, {3, 8, 0}, {9, 8, 0}, {10, 24, 0}, {10, 32, 40}, {11, 8, 32}};
    for (size_t i = 0; i < sizeof tga / sizeof *tga; i++) {
        svo_buffer file;
        svo_buffer_init(&file, NULL);
        make_tga(tga[i].type, tga[i].bits, tga[i].descriptor, 33, 21, &file);
        int worst = against_stb(&file);
        CHECK_MSG(worst >= 0 && worst <= (tga[i].bits == 16 ? 1 : 0), "tga type %u, %u bits: %d", tga[i].type, tga[i].bits, worst);
        svo_buffer_free(&file);
    }
}

TEST(tga_from_right_to_left)
{
    /* 2 x 1, true colour 24 bits, B G R; the first stored pixel is the right one */
    static const uint8_t file[] = {0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 1, 0, 24, 16 | 32, 1, 2, 3, 4, 5, 6};
    static const uint8_t want[] = {6, 5, 4, 255, 3, 2, 1, 255};
    svo_image image = {0};
    svo_error err = {0};
    CHECK_OK(fmt_image_decode(file, sizeof file, 0, NULL, &image, &err));
    CHECK(image.width == 2 && memcmp(image.pixels, want, 8) == 0);
    fmt_image_free(NULL, &image);
}

TEST(png_round_trip_is_exact_deterministic_and_srgb)
{
    for (uint32_t channels = 3; channels <= 4; channels++) {
        uint8_t pixels[31 * 17 * 4];
        uint64_t state = 5;
        for (size_t i = 0; i < sizeof pixels; i++) pixels[i] = (uint8_t)test_random(&state);
        char path[2][300];
        svo_error err = {0};
        fmt_bytes file[2];
        for (int i = 0; i < 2; i++) {
            snprintf(path[i], sizeof path[i], "%s/round%u-%d.png", test_folder(), channels, i);
            fmt_output *out;
            CHECK_OK(fmt_output_open(path[i], false, &out, &err));
            CHECK_OK(fmt_png_write(out, pixels, 31, 17, channels, &err));
            CHECK_OK(fmt_output_commit(out, &err));
            CHECK_OK(fmt_bytes_open(path[i], 0, NULL, &file[i], &err));
        }
        CHECK(file[0].size == file[1].size && memcmp(file[0].data, file[1].data, file[0].size) == 0);
        CHECK(memmem(file[0].data, file[0].size, "sRGB", 4) != NULL);
        for (int i = 0; i < 2; i++) fmt_bytes_close(&file[i]);
        svo_image image = {0};
        CHECK_OK(fmt_image_read(path[0], 0, NULL, &image, &err));
        CHECK(image.width == 31 && image.height == 17);
        for (size_t i = 0; i < 31 * 17; i++) {
            CHECK(memcmp(image.pixels + 4 * i, pixels + channels * i, channels) == 0);
            CHECK(channels == 4 || image.pixels[4 * i + 3] == 255);
        }
        fmt_image_free(NULL, &image);
    }
}

/* --- refusals --- */

static void refused(const void *bytes, uint64_t size, svo_result expected, const char *word)
{
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, 1 << 20, NULL);
    svo_image image = {0};
    svo_error err = {0};
    CHECK_RESULT(fmt_image_decode(bytes, size, 0, &limit.base, &image, &err), expected);
    CHECK_MSG(strstr(err.message, word) != NULL, "'%s' does not name '%s'", err.message, word);
    CHECK(image.pixels == NULL);
    CHECK_U64(svo_limit_in_use(&limit), 0);
}

TEST(other_formats_are_refused_by_name)
{
    refused("RIFF\x10\0\0\0WEBPVP8 ", 16, SVO_UNSUPPORTED, "WebP");
    refused("\xabKTX 20\xbb\r\n\x1a\n....", 16, SVO_UNSUPPORTED, "KTX2");
    refused("DDS |...", 8, SVO_UNSUPPORTED, "DDS");
    refused("GIF89a..", 8, SVO_UNSUPPORTED, "GIF");
    refused("hello, this is not an image at all", 34, SVO_INVALID_DATA, "PNG, JPEG");
    refused("", 0, SVO_INVALID_DATA, "empty");
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    make_jpeg(JCS_CMYK, false, false, 4, &file);
    refused(file.data, file.size, SVO_UNSUPPORTED, "CMYK");
    svo_buffer_free(&file);
    make_jpeg(JCS_GRAYSCALE, true, true, 1, &file);
    refused(file.data, file.size, SVO_LIMIT, "scans");
    svo_buffer_free(&file);
}

static uint32_t png_crc(const uint8_t *p, size_t n)
{
    uint32_t c = 0xffffffffu;
    for (size_t i = 0; i < n; i++) {
        c ^= p[i];
        for (int k = 0; k < 8; k++) c = (c & 1) != 0 ? 0xedb88320u ^ c >> 1 : c >> 1;
    }
    return ~c;
}

static void be32(uint8_t *p, uint32_t v)
{
    p[0] = (uint8_t)(v >> 24), p[1] = (uint8_t)(v >> 16), p[2] = (uint8_t)(v >> 8), p[3] = (uint8_t)v;
}

TEST(tiny_files_that_claim_to_be_huge)
{
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    png_recipe r = {PNG_COLOR_TYPE_RGB, 8, false, false, false, 4, 4};
    make_png(&r, &file);
    static const struct { uint32_t w, h; svo_result expected; const char *word; } claims[] = {
        {0x7fffffff, 0x7fffffff, SVO_LIMIT, "268435456"}, {1u << 20, 1u << 20, SVO_LIMIT, "268435456"}, {1, 0x7fffffff, SVO_LIMIT, "268435456"},
        {0x80000000u, 0x80000000u, SVO_INVALID_DATA, "PNG"}, {16384, 16384, SVO_INVALID_DATA, "too short"},
        {0, 4, SVO_INVALID_DATA, "PNG"}, {8000, 1, SVO_INVALID_DATA, "PNG"}};
    for (size_t i = 0; i < sizeof claims / sizeof *claims; i++) {
        be32(file.data + 16, claims[i].w), be32(file.data + 20, claims[i].h);
        be32(file.data + 29, png_crc(file.data + 12, 17));
        refused(file.data, file.size, claims[i].expected, claims[i].word);
    }
    svo_buffer_free(&file);
    for (int progressive = 0; progressive < 2; progressive++) {
        make_jpeg(JCS_RGB, progressive, false, 3, &file);
        uint8_t *frame = NULL;
        for (size_t i = 2; i + 9 < file.size && frame == NULL; i++)
            if (file.data[i] == 0xff && file.data[i + 1] == (progressive ? 0xc2 : 0xc0)) frame = file.data + i;
        CHECK(frame != NULL);
        frame[5] = frame[7] = 0xff, frame[6] = frame[8] = 0xdc;
        refused(file.data, file.size, SVO_LIMIT, "65500");
        frame[5] = frame[7] = 0x3f, frame[6] = frame[8] = 0xff;
        refused(file.data, file.size, SVO_INVALID_DATA, "too short");
        svo_buffer_free(&file);
    }
    make_bmp(24, false, false, 4, 4, &file);
    fmt_store32(file.data + 18, 0x7fffffff), fmt_store32(file.data + 22, 0x7fffffff);
    refused(file.data, file.size, SVO_INVALID_DATA, "too short");
    fmt_store32(file.data + 22, 0x80000000u);
    refused(file.data, file.size, SVO_INVALID_DATA, "too short");
    svo_buffer_free(&file);
    make_tga(10, 24, 0, 4, 4, &file);
    fmt_store16(file.data + 12, 0xffff), fmt_store16(file.data + 14, 0xffff);
    refused(file.data, file.size, SVO_INVALID_DATA, "too short");
    svo_buffer_free(&file);
}

/* --- damage --- */

static int sample_count;
static svo_buffer samples[16];

static svo_buffer *next_sample(void)
{
    svo_buffer_init(&samples[sample_count], NULL);
    return &samples[sample_count++];
}

static void make_samples(void)
{
    if (sample_count > 0) return;
    make_png(&(png_recipe){PNG_COLOR_TYPE_RGB, 8, false, true, true, 13, 9}, next_sample());
    make_png(&(png_recipe){PNG_COLOR_TYPE_PALETTE, 4, true, true, false, 13, 9}, next_sample());
    make_png(&(png_recipe){PNG_COLOR_TYPE_RGB_ALPHA, 16, true, false, false, 13, 9}, next_sample());
    make_jpeg(JCS_RGB, false, false, 3, next_sample());
    make_jpeg(JCS_RGB, true, false, 3, next_sample());
    make_jpeg(JCS_GRAYSCALE, false, false, 1, next_sample());
    make_bmp(4, false, false, 13, 9, next_sample());
    make_bmp(16, true, true, 13, 9, next_sample());
    make_tga(9, 8, 0, 13, 9, next_sample());
    make_tga(10, 32, 8, 13, 9, next_sample());
    make_tga(2, 24, 0, 13, 9, next_sample());
}

/* Any result is fine but a crash, a leak, more memory than the limit or an unexpected code. */
static svo_result try_decode(const uint8_t *bytes, uint64_t size, uint64_t fail_at)
{
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, 64 << 20, NULL);
    limit.fail_at = fail_at;
    svo_image image = {0};
    svo_error err = {0};
    uint8_t *exact = malloc(size > 0 ? size : 1); /* so that ASan sees a read past the end */
    memcpy(exact, bytes, size);
    svo_result result = fmt_image_decode(exact, size, 1 << 22, &limit.base, &image, &err);
    free(exact);
    if (result == SVO_OK ? image.pixels == NULL : err.message[0] == 0 || err.code != result) result = SVO_RUNTIME;
    fmt_image_free(&limit.base, &image);
    return svo_limit_in_use(&limit) == 0 ? result : SVO_RUNTIME;
}

TEST(every_truncation_is_refused)
{
    make_samples();
    for (int s = 0; s < sample_count; s++) {
        CHECK(try_decode(samples[s].data, samples[s].size, 0) == SVO_OK);
        /* PNG's end mark and JPEG's carry no pixels; without them an image is complete */
        uint64_t spare = samples[s].data[0] == 0x89 ? 12 : samples[s].data[0] == 0xff ? 4 : 0;
        for (uint64_t n = 0; n < samples[s].size - spare; n++) {
            svo_result r = try_decode(samples[s].data, n, 0);
            CHECK_MSG(r == SVO_INVALID_DATA || r == SVO_UNSUPPORTED, "sample %d cut to %llu bytes: %s", s, (unsigned long long)n, svo_result_name(r));
        }
    }
}

TEST(flipped_bytes_never_crash)
{
    make_samples();
    uint64_t state = 42;
    int refusals = 0;
    for (int s = 0; s < sample_count; s++) {
        uint8_t *copy = malloc(samples[s].size);
        for (int round = 0; round < 1500; round++) {
            memcpy(copy, samples[s].data, samples[s].size);
            uint64_t flips = 1 + test_random(&state) % 4;
            for (uint64_t f = 0; f < flips; f++) copy[test_random(&state) % samples[s].size] ^= (uint8_t)(1 + test_random(&state) % 255);
            if (samples[s].data[0] == 0x89 && round % 2 == 0) be32(copy + 29, png_crc(copy + 12, 17)); /* past the checksum */
            svo_result r = try_decode(copy, samples[s].size, 0);
            refusals += r != SVO_OK;
            CHECK_MSG(r == SVO_OK || r == SVO_INVALID_DATA || r == SVO_UNSUPPORTED || r == SVO_LIMIT || r == SVO_OUT_OF_MEMORY,
                      "sample %d round %d: %s", s, round, svo_result_name(r));
        }
        free(copy);
    }
    CHECK(refusals > 1000);
}

TEST(every_failing_allocation_is_reported)
{
    make_samples();
    for (int s = 0; s < sample_count; s++) {
        int n = 1;
        while (n < 100 && try_decode(samples[s].data, samples[s].size, (uint64_t)n) == SVO_OUT_OF_MEMORY) n++;
        CHECK_MSG(n > 1 && n < 100 && try_decode(samples[s].data, samples[s].size, (uint64_t)n) == SVO_OK, "sample %d, allocation %d", s, n);
    }
}
