/* JPEG through libjpeg(-turbo): baseline and progressive, grey and colour. libjpeg reports errors by longjmp:
 * everything that must survive one lives in `job`. */
#include <setjmp.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include <jpeglib.h>
#include <jerror.h>

#include "image_internal.h"

/* A progressive file may hold any number of scans, each of which costs a pass over the whole image; encoders make
 * about ten. */
enum { MAX_SCANS = 100 };

typedef struct jpeg_job {
    struct jpeg_decompress_struct info;
    struct jpeg_error_mgr errors;
    struct jpeg_source_mgr source;
    struct jpeg_progress_mgr progress;
    jmp_buf jump;
    svo_result result;
    char message[JMSG_LENGTH_MAX];
    bool ended;      /* the bytes did not end with the end mark */
    uint64_t charge; /* bytes accounted for libjpeg's own memory */
    void *charged;
} jpeg_job;

static jpeg_job *job_of(j_common_ptr info) { return (jpeg_job *)info->client_data; }

static void on_error(j_common_ptr info)
{
    jpeg_job *job = job_of(info);
    info->err->format_message(info, job->message);
    switch (info->err->msg_code) {
    case JERR_OUT_OF_MEMORY:
    case JERR_NO_BACKING_STORE: job->result = SVO_OUT_OF_MEMORY; break;
    case JERR_SOF_UNSUPPORTED:
    case JERR_BAD_PRECISION:
    case JERR_ARITH_NOTIMPL:
    case JERR_CCIR601_NOTIMPL:
    case JERR_FRACT_SAMPLE_NOTIMPL:
    case JERR_CONVERSION_NOTIMPL: job->result = SVO_UNSUPPORTED; break;
    default: job->result = SVO_INVALID_DATA;
    }
    longjmp(job->jump, 1);
}

static void stop(jpeg_job *job, svo_result result, const char *why)
{
    job->result = result;
    snprintf(job->message, sizeof job->message, "%s", why);
    longjmp(job->jump, 1);
}

/* libjpeg goes on with grey pixels where data are missing or damaged, and only warns. That would be a wrong picture. */
static void on_message(j_common_ptr info, int level)
{
    if (level >= 0) return;
    switch (info->err->msg_code) {
    case JWRN_EXTRANEOUS_DATA: /* harmless: pixels are all there */
    case JWRN_ADOBE_XFORM:
    case JWRN_JFIF_MAJOR:
    case JWRN_TOO_MUCH_DATA: return;
    default: on_error(info);
    }
}

static void no_output(j_common_ptr info) { (void)info; }
static void source_start(j_decompress_ptr info) { (void)info; }

/* After the last byte an end mark is supplied: a file that only lacks that is complete, and where pixels are missing
 * the entropy decoder complains. */
static boolean source_fill(j_decompress_ptr info)
{
    static const JOCTET end[2] = {0xff, JPEG_EOI};
    job_of((j_common_ptr)info)->ended = true;
    info->src->next_input_byte = end;
    info->src->bytes_in_buffer = 2;
    return TRUE;
}

static void source_skip(j_decompress_ptr info, long count)
{
    if (count <= 0) return;
    if ((size_t)count > info->src->bytes_in_buffer) {
        source_fill(info);
        return;
    }
    info->src->next_input_byte += count;
    info->src->bytes_in_buffer -= (size_t)count;
}

static void on_progress(j_common_ptr info)
{
    jpeg_job *job = job_of(info);
    if (info->is_decompressor && job->info.input_scan_number > MAX_SCANS)
        stop(job, SVO_LIMIT, "more than 100 progressive scans");
}

static bool read_rows(jpeg_job *job, const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory,
                      svo_image *out, svo_error *err)
{
    struct jpeg_decompress_struct *info = &job->info;
    if (setjmp(job->jump)) return false;
    jpeg_create_decompress(info);
    info->client_data = job;
    job->source = (struct jpeg_source_mgr){.next_input_byte = bytes, .bytes_in_buffer = size, .init_source = source_start,
        .fill_input_buffer = source_fill, .skip_input_data = source_skip, .resync_to_restart = jpeg_resync_to_restart,
        .term_source = source_start};
    info->src = &job->source;
    job->progress.progress_monitor = on_progress;
    info->progress = &job->progress;
    jpeg_read_header(info, TRUE);
    if (info->arith_code) stop(job, SVO_UNSUPPORTED, "arithmetic coding is not supported");
    if (info->jpeg_color_space == JCS_CMYK || info->jpeg_color_space == JCS_YCCK || info->num_components == 4)
        stop(job, SVO_UNSUPPORTED, "CMYK colours are not supported; convert the image to RGB");
    uint64_t pixels = (uint64_t)info->image_width * info->image_height;
    /* A Huffman code has at least one bit, and a component at most 1/16 of the image's blocks of 64 pixels fewer. */
    if (pixels <= max_pixels && pixels / (64 * 16 * 8) > size) stop(job, SVO_INVALID_DATA, "the file is too short for the size it states");
    job->result = image_allocate("JPEG", info->image_width, info->image_height, max_pixels, memory, out, err);
    if (job->result != SVO_OK) return false;
    if (jpeg_has_multiple_scans(info)) { /* libjpeg will hold all coefficients; it does not know the allocator */
        job->charge = 2 * pixels * (uint64_t)info->num_components;
        job->charged = svo_alloc(memory->a, job->charge, 1);
        if (job->charged == NULL) {
            snprintf(job->message, sizeof job->message, "a progressive file of %u x %u pixels takes %.1f MB while it is decoded", info->image_width, info->image_height, (double)job->charge / 1e6);
            job->result = SVO_OUT_OF_MEMORY;
            longjmp(job->jump, 1);
        }
    }
    info->dct_method = JDCT_ISLOW;
    info->out_color_space = JCS_EXT_RGBA;
    jpeg_start_decompress(info);
    if (job->charged != NULL && job->ended) stop(job, SVO_INVALID_DATA, "the file ends before the last scan");
    while (info->output_scanline < info->output_height) {
        svo_image_touch(out, 0, info->output_scanline, info->image_width);
        JSAMPROW row = out->pixels + 4 * (size_t)info->image_width * info->output_scanline;
        jpeg_read_scanlines(info, &row, 1);
    }
    return true;
}

svo_result image_decode_jpeg(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const image_memory *memory, svo_image *out,
                             svo_error *err)
{
    const svo_allocator *a = memory->a;
    jpeg_job *job = svo_calloc(a, 1, sizeof *job);
    if (job == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for reading a JPEG image");
    job->info.err = jpeg_std_error(&job->errors);
    job->info.client_data = job;
    job->errors.error_exit = on_error;
    job->errors.emit_message = on_message;
    job->errors.output_message = no_output;
    read_rows(job, bytes, size, max_pixels, memory, out, err);
    svo_result result = job->result;
    if (result != SVO_OK && job->message[0] != 0) svo_fail(err, result, "JPEG image: %s", job->message);
    jpeg_destroy_decompress(&job->info);
    svo_free(a, job->charged, job->charge, 1);
    svo_free(a, job, 1, sizeof *job);
    return result;
}
