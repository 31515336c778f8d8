/* Internal to libsvo: large arrays of records that are sorted once and then read, in memory or in temporary files (svo_pager.h). The content does not
 * depend on which. */
#ifndef SVOI_SORTED_H
#define SVOI_SORTED_H

#include <string.h>

#include "svo_pager.h"

/* Where such arrays are made. */
typedef struct svoi_room {
    const svo_allocator *allocator;
    svo_pager *pager;    /* NULL: in memory */
    uint64_t run_bytes;  /* with a pager: memory that sorting may take at a time */
} svoi_room;

typedef struct svoi_store {
    const svo_allocator *allocator;
    svo_paged *paged;  /* NULL: in memory */
    uint8_t *data;
    uint64_t capacity; /* records */
    uint32_t stride;
} svoi_store;

/* Zeros. A store of nothing is fine, and so is freeing one that is all zeros. */
svo_result svoi_store_create(const svoi_room *room, uint64_t count, uint32_t stride, svoi_store *out, svo_error *err);
void svoi_store_free(svoi_store *s);

/* Record number i. It stays where it is until the store is freed. */
static inline void *svoi_at(const svoi_store *s, uint64_t i)
{
    uint8_t *p = s->data + i * s->stride;
    if (s->paged != NULL) svo_paged_touch(s->paged, p, s->stride);
    return p;
}

/* Order: the key (44 bits), then compare, which must tell apart all records whose order shows. */
enum { SVOI_SORT_BITS = 44 };
typedef struct svoi_order {
    uint64_t (*key)(const void *record, const void *user);
    int (*compare)(const void *a, const void *b);
    const void *user;
} svoi_order;

/* Records come in any order, and at most `total` of them. */
typedef struct svoi_sorter {
    const svoi_room *room;
    svoi_order order;
    uint32_t stride;
    uint64_t total, capacity, count; /* capacity: records of a run; count: in the run in hand */
    uint8_t *run;
    svo_buffer runs;  /* uint64_t: where each written run ends */
    svoi_store written;
    uint64_t written_count;
} svoi_sorter;

svo_result svoi_sorter_begin(svoi_sorter *s, const svoi_room *room, const svoi_order *order, uint32_t stride, uint64_t total, svo_error *err);
/* Room for at least one more record in the run (s->capacity - s->count of them), which is written away first where it is full. In memory
 * there is room for all of them from the beginning. Write records to s->run + s->count * s->stride and add to s->count. */
svo_result svoi_sorter_reserve(svoi_sorter *s, svo_error *err);
static inline svo_result svoi_sorter_put(svoi_sorter *s, const void *record, svo_error *err)
{
    if (s->count == s->capacity) SVO_TRY(svoi_sorter_reserve(s, err));
    memcpy(s->run + s->count++ * s->stride, record, s->stride);
    return SVO_OK;
}
/* The sorted records; the sorter is empty afterwards, also on failure. */
svo_result svoi_sorter_end(svoi_sorter *s, svoi_store *out, uint64_t *count, svo_error *err);
void svoi_sorter_drop(svoi_sorter *s);

#endif
