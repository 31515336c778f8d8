/* Spilling: how libsvo puts what does not fit in memory somewhere else without doing file I/O itself. The caller gives a
 * table of functions (formats/fmt_spill.h has one that uses unnamed temporary files); here are the buffered writer and
 * reader on top of it. */
#ifndef SVO_SPILL_H
#define SVO_SPILL_H

#include "svo_alloc.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A place for scratch files. All functions may be called from several threads at once, also on one file as long as the
 * ranges of bytes differ (or are all read). A file begins empty; reading a range that was never written is an error of the
 * calling program. Failures: SVO_IO (disk full, damaged disk), SVO_LIMIT (over a limit that was set), SVO_OUT_OF_MEMORY. */
typedef struct svo_spill {
    void *user;
    svo_result (*create)(void *user, void **file, svo_error *err);
    svo_result (*write)(void *user, void *file, uint64_t offset, const void *bytes, uint64_t size, svo_error *err);
    svo_result (*read)(void *user, void *file, uint64_t offset, void *bytes, uint64_t size, svo_error *err);
    /* The range will not be read again: give its space back. A hint; may be NULL. */
    void (*discard)(void *user, void *file, uint64_t offset, uint64_t size);
    void (*close)(void *user, void *file); /* and throw the content away */
    /* Bytes [offset, offset + size) of a file as memory to be read and written, zeros at first; both are multiples of 64 KiB. Their space on
     * the disk is taken at once. unmap leaves the space to discard. forget: drop the pages of a mapping from this process's
     * memory, until they are used again; also of mappings of other files, by any thread. NULL: not supported. */
    svo_result (*map)(void *user, void *file, uint64_t offset, uint64_t size, void **data, svo_error *err);
    void (*unmap)(void *user, void *data, uint64_t size);
    void (*forget)(void *user, void *data, uint64_t size);
    /* Bytes of a mapping will be used soon; both are multiples of the size of a page. A hint; may be NULL. */
    void (*fetch)(void *user, void *data, uint64_t size);
    /* Lossless compression of what is written, for callers that want less on the disk: returns the bytes put to `to`, at most `capacity`, or 0
     * where they would be more (or memory is missing). decompress gives exactly `size` bytes, or fails with SVO_IO. Both NULL: not supported. */
    uint32_t (*compress)(void *user, const void *bytes, uint32_t size, void *to, uint32_t capacity);
    svo_result (*decompress)(void *user, const void *packed, uint32_t packed_size, void *bytes, uint32_t size, svo_error *err);
} svo_spill;

/* One file of a spill. Zero-initialised: not open, and closing it does nothing. */
typedef struct svo_spill_file {
    const svo_spill *spill;
    void *file;
    uint64_t size; /* bytes appended so far; kept by svo_spill_append alone */
} svo_spill_file;

svo_result svo_spill_open(const svo_spill *spill, svo_spill_file *out, svo_error *err);
void svo_spill_close(svo_spill_file *f); /* leaves a zeroed, closed one */
svo_result svo_spill_write(const svo_spill_file *f, uint64_t offset, const void *bytes, uint64_t size, svo_error *err);
svo_result svo_spill_read(const svo_spill_file *f, uint64_t offset, void *bytes, uint64_t size, svo_error *err);
void svo_spill_discard(const svo_spill_file *f, uint64_t offset, uint64_t size);
/* Write at the end; not thread-safe on one file. */
svo_result svo_spill_append(svo_spill_file *f, const void *bytes, uint64_t size, svo_error *err);

/* A write buffer that goes to consecutive offsets from `begin`. Several may share a file, each with a range of its own
 * (what a scatter into bins needs): the file's size is not touched then. Not thread-safe on one writer. */
typedef struct svo_spill_writer {
    const svo_spill_file *file;
    uint64_t offset; /* of the first byte that is still in the buffer */
    uint8_t *buffer;
    uint32_t used, capacity;
} svo_spill_writer;
/* `buffer` is borrowed until the last flush. */
void svo_spill_writer_init(svo_spill_writer *w, const svo_spill_file *f, uint64_t begin, uint8_t *buffer, uint32_t capacity);
svo_result svo_spill_put(svo_spill_writer *w, const void *bytes, uint64_t size, svo_error *err);
svo_result svo_spill_flush(svo_spill_writer *w, svo_error *err);
/* Where the next byte goes. */
static inline uint64_t svo_spill_tell(const svo_spill_writer *w) { return w->offset + w->used; }

/* A sequential reader of [begin, end). */
typedef struct svo_spill_reader {
    const svo_spill_file *file;
    uint64_t next, end; /* not yet in the buffer */
    uint8_t *buffer;
    uint32_t at, filled, capacity;
    bool consume; /* discard what has been read */
} svo_spill_reader;
/* `buffer` is borrowed. With `consume`, the space of what was read is given back as reading goes on. */
void svo_spill_reader_init(svo_spill_reader *r, const svo_spill_file *f, uint64_t begin, uint64_t end, bool consume, uint8_t *buffer,
                           uint32_t capacity);
/* Exactly `size` bytes; asking for more than is left is an error of the calling program. */
svo_result svo_spill_get(svo_spill_reader *r, void *bytes, uint64_t size, svo_error *err);
static inline uint64_t svo_spill_left(const svo_spill_reader *r) { return r->end - r->next + (r->filled - r->at); }

#ifdef __cplusplus
}
#endif
#endif
