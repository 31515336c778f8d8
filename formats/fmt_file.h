/* Files as the tools use them: read by mapping or streaming, written beside and renamed. "-" is stdin or stdout. */
#ifndef FMT_FILE_H
#define FMT_FILE_H

#include "svo_alloc.h"

#ifdef __cplusplus
extern "C" {
#endif

/* An output. Nothing appears under `path` before fmt_output_commit; where the file system can (O_TMPFILE), nothing
 * appears anywhere, so that even kill -9 leaves no trace. Otherwise, and for the moment in which a file replaces another,
 * a temporary file PATH.svokit-part-N beside the target is used; what a killed process left of that kind, the next fmt_output_open of
 * the same path removes.
 * Writing is sequential and buffered; the offset is tracked for all sinks, pipes too. */
typedef struct fmt_output fmt_output;

/* A target that exists and is no regular file (a device, a fifo) is written directly and needs no force; a symbolic
 * link is kept and what it names is replaced. Programs that write to pipes should ignore SIGPIPE (the tools do): a reader
 * that has gone is then SVO_IO. */

/* Fails with SVO_IO when the directory is missing or not writable, or when `path` exists and !force (checked here and
 * again at commit); SVO_INVALID_ARGUMENT when `path` is "-" and stdout is a terminal. */
svo_result fmt_output_open(const char *path, bool force, fmt_output **out, svo_error *err);
/* An output into memory: *to is emptied and holds the bytes once committed. */
svo_result fmt_output_open_memory(svo_buffer *to, fmt_output **out, svo_error *err);
svo_result fmt_output_write(fmt_output *o, const void *bytes, size_t size, svo_error *err);
/* Write zero bytes up to a multiple of `align`. */
svo_result fmt_output_align(fmt_output *o, uint32_t align, svo_error *err);
uint64_t fmt_output_offset(const fmt_output *o);
/* Flush, give the file its name (replacing an old one only when force was given), close and free. On failure the
 * target is as it was before. */
svo_result fmt_output_commit(fmt_output *o, svo_error *err);
/* Throw away and free; NULL is fine. What has gone to a pipe or a device stays there. */
void fmt_output_discard(fmt_output *o);
/* Remove the temporary files of all outputs that are open in this process. Async-signal-safe: for a handler that then
 * ends the process. (Where O_TMPFILE works there are none.) */
void fmt_output_remove_temporaries(void);
/* Remove the temporary files that killed processes left beside `path`; those of processes that are at work stay. */
void fmt_output_remove_leftovers(const char *path);

/* A whole file, mapped read-only where it is a regular file, else read into memory (at most max_bytes, 0 = no limit;
 * more is SVO_LIMIT; a mapped file costs no memory and is not limited). 64-byte aligned.
 * A mapped file must not be shortened by others while it is used. An empty file gives size 0. */
typedef struct fmt_bytes {
    const uint8_t *data;
    uint64_t size;
    uint64_t capacity; /* allocated, when not mapped */
    bool mapped;
    int64_t modified[2]; /* seconds, nanoseconds: when it was opened; of files */
    uint64_t inode, device;
    const svo_allocator *allocator;
    struct svo_async *beside; /* reads the bytes on another thread (borrowed, may be NULL): waited for before they go or are said to be unchanged */
} fmt_bytes;
/* Told of a file that is about to be read. It may go on reading the bytes beside; then it gives what to wait for, which lives until the file is closed. */
typedef struct svo_async *(*fmt_file_read_fn)(void *user, const char *path, const uint8_t *bytes, uint64_t size, bool mapped);
svo_result fmt_bytes_open(const char *path, uint64_t max_bytes, const svo_allocator *a, fmt_bytes *out, svo_error *err);
/* The same, but what cannot be mapped (a pipe) goes through an unnamed temporary file in TMPDIR and is mapped from there,
 * so that it takes no memory. */
svo_result fmt_bytes_open_spooled(const char *path, fmt_bytes *out, svo_error *err);
void fmt_bytes_close(fmt_bytes *b);
/* SVO_IO when the file that was opened has another size or time of change now. */
svo_result fmt_bytes_unchanged(const char *path, const fmt_bytes *b, svo_error *err);
/* Size of a regular file, which is not opened; 0 when there is none. */
uint64_t fmt_file_bytes(const char *path);
/* Part of the bytes of a MAPPED file need not stay in this process's memory: they are read from the file again when they are
 * used again. */
void fmt_bytes_forget(const void *bytes, uint64_t size);
/* An unnamed file for scratch data, in TMPDIR or /tmp; read and write. Closed by the caller with close(). */
svo_result fmt_scratch_file(int *fd, svo_error *err);

/* A sequential input for streams that may be larger than memory. */
typedef struct fmt_input fmt_input;
svo_result fmt_input_open(const char *path, fmt_input **out, svo_error *err);
/* The same over bytes in memory (borrowed). */
svo_result fmt_input_open_memory(const void *bytes, uint64_t size, fmt_input **out, svo_error *err);
/* Read up to size bytes; *got < size only at the end. */
svo_result fmt_input_read(fmt_input *in, void *to, size_t size, size_t *got, svo_error *err);
uint64_t fmt_input_offset(const fmt_input *in);
void fmt_input_close(fmt_input *in);

/* A 16-byte hash as 32 lower-case hex digits and a NUL. */
void fmt_hash_text(const uint8_t hash[16], char out[33]);
/* The XXH3-128 of bytes, as such a text. */
void fmt_hash_hex(const void *bytes, uint64_t size, char out[33]);
/* The same of a file that may be mapped, which is not kept in memory for it. */
void fmt_hash_file(const void *bytes, uint64_t size, bool mapped, char out[33]);

#ifdef __cplusplus
}
#endif
#endif
