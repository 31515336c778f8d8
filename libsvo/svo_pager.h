/* Arrays that are too large for memory but have to be read in any order (images and their filtered levels, buffers of a model): mapped
 * files, of which a bounded part is resident. Whoever reads or writes such an array says so before (svo_paged_touch); when more
 * than the allowed number of pieces has been touched, all of them are taken out of this process's memory, and come back from
 * the file when they are used again. */
#ifndef SVO_PAGER_H
#define SVO_PAGER_H

#include "svo_spill.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_PAGE_SHIFT 16u /* a piece: the system brings up to 64 KiB, aligned, into memory at a touch */

/* Touching is thread-safe; so are the making and freeing of arrays. */
typedef struct svo_pager svo_pager;

/* `resident` bytes at most stay in memory, and are charged to the allocator when the first array is made. `keep`: see
 * svo_pager_keeps. The spill must be able to map (svo_spill.map); it is borrowed. */
svo_result svo_pager_create(const svo_spill *spill, uint64_t resident, uint64_t keep, const svo_allocator *a, svo_pager **out, svo_error *err);
/* All its arrays must have been freed; NULL is fine. */
void svo_pager_free(svo_pager *p);
/* Is something of this size rather kept in memory as usual? As long as what was asked for adds up to `keep` bytes. */
bool svo_pager_keeps(svo_pager *p, uint64_t bytes);

typedef struct svo_paged {
    svo_pager *pager;
    uint8_t *data;
    uint64_t size, offset; /* offset: in the pager's file */
    uintptr_t first;       /* piece (address >> SVO_PAGE_SHIFT) of `data` */
    uint8_t *touched;      /* a byte a piece; atomic */
    uint64_t pieces;
    bool borrowed;
    struct svo_paged *next, **link; /* list of the pager's arrays */
} svo_paged;

/* An array of zeros. SVO_IO (disk full), SVO_LIMIT, SVO_OUT_OF_MEMORY. */
svo_result svo_paged_create(svo_pager *p, uint64_t size, svo_paged **out, svo_error *err);
/* The bytes of a file that somebody else has mapped, shared or private but never written to. They must stay until the array is freed. */
svo_result svo_paged_borrow(svo_pager *p, const void *data, uint64_t size, svo_paged **out, svo_error *err);
void svo_paged_free(svo_paged *a); /* NULL is fine */

void svoi_paged_miss(svo_paged *a, uint64_t piece);
/* Bytes [at, at + size) of the array are about to be used, in one go; size > 0. */
static inline void svo_paged_touch(svo_paged *a, const void *at, uint64_t size)
{
    uint64_t i = ((uintptr_t)at >> SVO_PAGE_SHIFT) - a->first, end = (((uintptr_t)at + (uintptr_t)size - 1) >> SVO_PAGE_SHIFT) - a->first;
    for (; i <= end; i++)
        if (!__atomic_load_n(&a->touched[i], __ATOMIC_RELAXED)) svoi_paged_miss(a, i);
}

#ifdef __cplusplus
}
#endif
#endif
