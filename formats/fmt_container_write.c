/* Container writer: strictly front to back. The table grows in memory up to a bound and then in an unnamed temporary
 * file, so that a file of any number of chunks is written in bounded memory. */
#define _GNU_SOURCE
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "fmti_container.h"

enum { TABLE_IN_MEMORY = 1 << 20 };

struct fmt_writer {
    fmt_output *out;
    XXH3_state_t content, table_hash;
    uint64_t count;
    svo_buffer table; /* elements not yet spilled */
    FILE *spill;
    bool failed;
};

svo_result fmt_writer_begin(fmt_output *out, fmt_kind kind, uint16_t major, uint16_t minor, fmt_writer **writer, svo_error *err)
{
    SVO_ASSERT(fmt_output_offset(out) == 0);
    uint8_t header[FMTI_BLOCK] = {0};
    memcpy(header, fmti_signature, 8);
    fmt_store16(header + 8, major);
    fmt_store16(header + 10, minor);
    fmt_store32(header + 12, FMTI_BLOCK);
    fmt_store32(header + 16, (uint32_t)kind);
    fmt_store64(header + 56, XXH3_64bits(header, FMTI_HEADER_HASHED));
    fmt_writer *w = svo_calloc(NULL, 1, sizeof *w);
    if (w == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a file writer");
    w->out = out;
    svo_buffer_init(&w->table, NULL);
    XXH3_128bits_reset(&w->content);
    XXH3_64bits_reset(&w->table_hash);
    svo_result r = fmt_output_write(out, header, sizeof header, err);
    if (r != SVO_OK) {
        fmt_writer_discard(w);
        return r;
    }
    *writer = w;
    return SVO_OK;
}

static svo_result spill_table(fmt_writer *w, svo_error *err)
{
    if (w->spill == NULL) {
        int fd = -1;
        SVO_TRY(fmt_scratch_file(&fd, err));
        w->spill = fdopen(fd, "w+b");
        if (w->spill == NULL) {
            close(fd);
            return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a temporary file");
        }
    }
    if (fwrite(w->table.data, 1, w->table.size, w->spill) != w->table.size)
        return svo_fail(err, SVO_IO, "cannot write a temporary file (TMPDIR): %s", strerror(errno));
    w->table.size = 0;
    return SVO_OK;
}

static svo_result write_chunk(fmt_writer *w, fmt_chunk *c, const void *stored, svo_error *err)
{
    uint8_t element[8 + FMTI_BLOCK];
    uint64_t at = fmt_output_offset(w->out);
    c->offset = at + FMTI_BLOCK;
    c->hash = XXH3_64bits(c->stored_size != 0 ? stored : "", (size_t)c->stored_size);
    fmt_store64(element, at);
    fmti_store_chunk(c, element + 8);
    SVO_TRY(fmt_output_write(w->out, element + 8, FMTI_BLOCK, err));
    SVO_TRY(fmt_output_write(w->out, stored, (size_t)c->stored_size, err));
    SVO_TRY(fmt_output_align(w->out, FMTI_BLOCK, err));
    if (c->type == FMT_TYPE_TABLE) return SVO_OK;
    fmti_content_add(&w->content, c);
    XXH3_64bits_update(&w->table_hash, element, FMTI_BLOCK);
    if (w->table.size >= TABLE_IN_MEMORY) SVO_TRY(spill_table(w, err));
    if (svo_buffer_append(&w->table, element, FMTI_BLOCK) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the table of chunks");
    w->count++;
    return SVO_OK;
}

svo_result fmt_writer_chunk(fmt_writer *w, fmt_chunk *c, const void *stored, svo_error *err)
{
    SVO_ASSERT(c->type != FMT_TYPE_TABLE && (c->codec != FMT_CODEC_NONE || c->stored_size == c->decoded_size));
    SVO_ASSERT(c->element_stride == 0 || c->element_count * c->element_stride == c->decoded_size);
    svo_result r = write_chunk(w, c, stored, err);
    if (r != SVO_OK) w->failed = true;
    return r;
}

/* The table's payload, from the temporary file and from memory. */
static svo_result write_table(fmt_writer *w, svo_error *err)
{
    if (w->spill != NULL) {
        if (fflush(w->spill) != 0 || fseek(w->spill, 0, SEEK_SET) != 0)
            return svo_fail(err, SVO_IO, "cannot write a temporary file (TMPDIR): %s", strerror(errno));
        uint64_t left = w->count * FMTI_BLOCK - w->table.size;
        uint8_t piece[1 << 14];
        while (left != 0) {
            size_t n = left < sizeof piece ? (size_t)left : sizeof piece;
            if (fread(piece, 1, n, w->spill) != n) return svo_fail(err, SVO_IO, "cannot read a temporary file (TMPDIR) back: %s", strerror(errno));
            SVO_TRY(fmt_output_write(w->out, piece, n, err));
            left -= n;
        }
    }
    return fmt_output_write(w->out, w->table.data, w->table.size, err);
}

static svo_result finish(fmt_writer *w, svo_error *err)
{
    if (w->failed) return svo_fail(err, SVO_IO, "the file is not finished, because an earlier write failed");
    uint64_t at = fmt_output_offset(w->out), bytes = w->count * FMTI_BLOCK;
    fmt_chunk t = {.type = FMT_TYPE_TABLE, .flags = FMT_CHUNK_CRITICAL, .stored_size = bytes, .decoded_size = bytes,
                   .element_count = w->count, .element_stride = FMTI_BLOCK, .hash = XXH3_64bits_digest(&w->table_hash)};
    uint8_t block[FMTI_BLOCK];
    fmti_store_chunk(&t, block);
    SVO_TRY(fmt_output_write(w->out, block, sizeof block, err));
    SVO_TRY(write_table(w, err));
    memset(block, 0, sizeof block);
    fmt_store64(block, at);
    fmt_store64(block + 8, w->count);
    fmt_store64(block + 16, fmt_output_offset(w->out) + FMTI_BLOCK);
    fmti_content_get(&w->content, block + 24);
    fmt_store64(block + 48, XXH3_64bits(block, FMTI_FOOTER_HASHED));
    memcpy(block + 56, fmti_end_mark, 8);
    return fmt_output_write(w->out, block, sizeof block, err);
}

svo_result fmt_writer_end(fmt_writer *w, svo_error *err)
{
    svo_result r = finish(w, err);
    fmt_writer_discard(w);
    return r;
}

void fmt_writer_discard(fmt_writer *w)
{
    if (w == NULL) return;
    if (w->spill != NULL) fclose(w->spill);
    svo_buffer_free(&w->table);
    svo_free(NULL, w, 1, sizeof *w);
}
