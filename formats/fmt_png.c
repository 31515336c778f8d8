/* PNG through libpng. libpng reports errors by longjmp: everything that must survive one lives in `job`, outside the
 * frames that are jumped over. */
#include <png.h>
#include <setjmp.h>
#include <stdio.h>
#include <string.h>

#include "image_internal.h"

typedef struct png_job {
    const svo_allocator *a;
    const uint8_t *bytes;
    uint64_t size, at, forgotten;
    bool mapped;
    fmt_output *to;
    svo_result result; /* of a callback, SVO_OK if the failure is libpng's own */
    svo_error *err;
    char message[160];
} png_job;

static void on_error(png_structp png, png_const_charp message)
{
    png_job *job = png_get_error_ptr(png);
    snprintf(job->message, sizeof job->message, "%s", message);
    png_longjmp(png, 1);
}

static void on_warning(png_structp png, png_const_charp message) { (void)png, (void)message; }

/* libpng frees without telling the size, so it is kept in front. */
enum { HEAD = 64, FORGET = 4 << 20 };

static png_voidp on_malloc(png_structp png, png_alloc_size_t size)
{
    png_job *job = png_get_mem_ptr(png);
    if (size > SIZE_MAX - HEAD) return NULL;
    uint8_t *p = svo_alloc(job->a, size + HEAD, 1);
    if (p == NULL) return NULL;
    uint64_t total = size + HEAD;
    memcpy(p, &total, sizeof total);
    return p + HEAD;
}

static void on_free(png_structp png, png_voidp ptr)
{
    png_job *job = png_get_mem_ptr(png);
    if (ptr == NULL) return;
    uint8_t *p = (uint8_t *)ptr - HEAD;
    uint64_t total;
    memcpy(&total, p, sizeof total);
    svo_free(job->a, p, total, 1);
}

static void on_read(png_structp png, png_bytep to, size_t count)
{
    png_job *job = png_get_io_ptr(png);
    if (count > job->size - job->at) png_error(png, "the file ends inside the image");
    memcpy(to, job->bytes + job->at, count);
    job->at += count;
    if (job->mapped && job->at - job->forgotten >= FORGET) {
        fmt_bytes_forget(job->bytes + job->forgotten, job->at - job->forgotten);
        job->forgotten = job->at;
    }
}

/* Reads into out->pixels; false after an error. */
static bool read_rows(png_structp png, png_infop info, png_job *job, uint64_t max_pixels, const image_memory *memory, svo_image *out)
{
    if (setjmp(png_jmpbuf(png))) return false;
    /* Only what decides about pixels is looked at; in particular no colour profile is ever unpacked. */
    static const png_byte ignored[] = "gAMA\0cHRM\0iCCP\0sRGB\0tEXt\0zTXt\0iTXt\0eXIf\0pHYs\0tIME\0hIST\0sPLT\0bKGD\0oFFs\0pCAL\0sCAL\0sBIT";
    png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, NULL, 0);
    png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, ignored, (int)(sizeof ignored / 5));
    png_set_user_limits(png, 0x7fffffff, 0x7fffffff);
    png_set_chunk_malloc_max(png, 1 << 20);
    png_set_read_fn(png, job, on_read);
    png_read_info(png, info);
    png_uint_32 width = png_get_image_width(png, info), height = png_get_image_height(png, info);
    /* deflate cannot shrink by more than 1032, so a small file cannot hold a large image */
    uint64_t packed_row = ((uint64_t)width * png_get_channels(png, info) * png_get_bit_depth(png, info) + 7) / 8 + 1;
    if (height > max_pixels / width || packed_row / 1032 <= job->size / height) {
        job->result = image_allocate("PNG", width, height, max_pixels, memory, out, job->err);
        if (job->result != SVO_OK) return false;
    } else {
        png_error(png, "the file is too short for the size it states");
    }
    png_set_expand(png);
    png_set_scale_16(png);
    png_set_gray_to_rgb(png);
    png_set_add_alpha(png, 0xff, PNG_FILLER_AFTER);
    int passes = png_set_interlace_handling(png);
    png_read_update_info(png, info);
    if (png_get_rowbytes(png, info) != 4 * (size_t)width) png_error(png, "unexpected row size");
    for (int pass = 0; pass < passes; pass++)
        for (png_uint_32 y = 0; y < height; y++) {
            svo_image_touch(out, 0, y, width);
            png_read_row(png, out->pixels + 4 * (size_t)width * y, NULL);
        }
    return true;
}

svo_result image_decode_png(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory, svo_image *out,
                            svo_error *err)
{
    png_job job = {.a = memory->a, .bytes = bytes, .size = size, .mapped = memory->mapped, .result = SVO_OK, .err = err};
    png_structp png = png_create_read_struct_2(PNG_LIBPNG_VER_STRING, &job, on_error, on_warning, &job, on_malloc, on_free);
    png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
    if (info == NULL) {
        png_destroy_read_struct(&png, &info, NULL);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for reading a PNG image");
    }
    bool good = read_rows(png, info, &job, max_pixels, memory, out);
    png_destroy_read_struct(&png, &info, NULL);
    if (good || job.result != SVO_OK) return job.result;
    if (strstr(job.message, "memory") != NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "PNG image: %s", job.message);
    return svo_fail(err, SVO_INVALID_DATA, "PNG image: %s", job.message);
}

static void on_write(png_structp png, png_bytep from, size_t count)
{
    png_job *job = png_get_io_ptr(png);
    job->result = fmt_output_write(job->to, from, count, job->err);
    if (job->result != SVO_OK) png_error(png, "write");
}

static void on_flush(png_structp png) { (void)png; }

static bool write_rows(png_structp png, png_infop info, png_job *job, const uint8_t *pixels, uint32_t width, uint32_t height,
                       uint32_t channels)
{
    if (setjmp(png_jmpbuf(png))) return false;
    png_set_user_limits(png, 0x7fffffff, 0x7fffffff);
    png_set_write_fn(png, job, on_write, on_flush);
    png_set_IHDR(png, info, width, height, 8, channels == 4 ? PNG_COLOR_TYPE_RGB_ALPHA : PNG_COLOR_TYPE_RGB,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_BASE, PNG_FILTER_TYPE_BASE);
    png_set_sRGB(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    png_write_info(png, info);
    for (uint32_t y = 0; y < height; y++) png_write_row(png, pixels + (size_t)y * width * channels);
    png_write_end(png, info);
    return true;
}

svo_result fmt_png_write(fmt_output *out, const uint8_t *pixels, uint32_t width, uint32_t height, uint32_t channels, svo_error *err)
{
    SVO_ASSERT(channels == 3 || channels == 4);
    if (width == 0 || height == 0 || width > INT32_MAX || height > INT32_MAX)
        return svo_fail(err, SVO_INVALID_ARGUMENT, "a PNG image cannot be %u x %u pixels", width, height);
    png_job job = {.to = out, .result = SVO_OK, .err = err};
    png_structp png = png_create_write_struct_2(PNG_LIBPNG_VER_STRING, &job, on_error, on_warning, &job, on_malloc, on_free);
    png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
    if (info == NULL) {
        png_destroy_write_struct(&png, &info);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for writing a PNG image");
    }
    bool good = write_rows(png, info, &job, pixels, width, height, channels);
    png_destroy_write_struct(&png, &info);
    if (good || job.result != SVO_OK) return job.result;
    return svo_fail(err, SVO_RUNTIME, "PNG image: %s", job.message);
}
