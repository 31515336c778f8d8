/* Memory: an allocator per object, a limit that is part of it, checked sizes, growable arrays. */
#ifndef SVO_ALLOC_H
#define SVO_ALLOC_H

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Both functions must be callable from several threads at once. `size` and `align` given to free are those of
 * the allocation. alloc returns NULL on failure; align is a power of two, at most 4096. */
typedef struct svo_allocator {
    void *(*alloc)(void *user, size_t size, size_t align);
    void (*free)(void *user, void *ptr, size_t size, size_t align);
    void *user;
} svo_allocator;

/* The C library's allocator. A NULL `const svo_allocator *` means this one everywhere in svokit. */
const svo_allocator *svo_default_allocator(void);

/* An allocator that refuses to hold more than `limit` bytes at a time and remembers its high-water mark.
 * Thread-safe. It must outlive everything allocated from it. `fail_at` (1-based, 0 = never) makes the n-th
 * allocation and all later ones fail: for tests. */
typedef struct svo_limit_allocator {
    svo_allocator base; /* pass &x->base where an allocator is asked for */
    const svo_allocator *parent;
    uint64_t limit;
    uint64_t in_use, peak, count; /* read with svo_limit_* below; written atomically */
    uint64_t fail_at;
} svo_limit_allocator;

void svo_limit_allocator_init(svo_limit_allocator *a, uint64_t limit, const svo_allocator *parent);
uint64_t svo_limit_in_use(const svo_limit_allocator *a);
uint64_t svo_limit_peak(const svo_limit_allocator *a);

/* count * size bytes (checked for overflow), 64-byte aligned, not cleared; NULL when it cannot be had or is 0. */
void *svo_alloc(const svo_allocator *a, uint64_t count, size_t size);
/* The same, cleared. */
void *svo_calloc(const svo_allocator *a, uint64_t count, size_t size);
/* Free what svo_alloc(a, count, size) gave. ptr may be NULL. */
void svo_free(const svo_allocator *a, void *ptr, uint64_t count, size_t size);

/* a * b into *out; false on overflow. */
bool svo_mul_size(uint64_t a, uint64_t b, size_t *out);

/* A growable byte array. Zero-initialise with svo_buffer_init; `data` is 64-byte aligned. */
typedef struct svo_buffer {
    const svo_allocator *allocator;
    uint8_t *data;
    size_t size, capacity; /* bytes */
} svo_buffer;

void svo_buffer_init(svo_buffer *b, const svo_allocator *a);
void svo_buffer_free(svo_buffer *b); /* leaves an empty, usable buffer */
/* Make room for `extra` more bytes (capacity grows by half at least). False when out of memory. */
bool svo_buffer_reserve(svo_buffer *b, size_t extra);
/* Append; `bytes` may be NULL to append zeros. Returns where they were put, NULL when out of memory. */
void *svo_buffer_append(svo_buffer *b, const void *bytes, size_t size);

#ifdef __cplusplus
}
#endif
#endif
