/* Algorithm 1 of Dado et al. 2016: blocks of any length with palettes of table indices, found greedily. The yardstick that
 * svo_palette.h is measured against. The blocks are those of the printed algorithm (ties: the first position), but the
 * largest block is found from windows over runs and a tree of maxima, not by trying all pairs: time is O(n log n). */
#ifndef SVO_ALGORITHM1_H
#define SVO_ALGORITHM1_H

#include "svo_alloc.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct svo_algorithm1_block {
    uint64_t begin;   /* first value; the block ends where the next one begins */
    uint64_t palette; /* where the entries of its palette begin in `palettes` */
    uint32_t bits;    /* of a palette index, 0..8 */
} svo_algorithm1_block;

typedef struct svo_algorithm1_result {
    svo_algorithm1_block *blocks; /* ascending */
    uint64_t block_count;
    uint32_t *palettes; /* of each its number of entries, then table indices, ascending; equal palettes are stored once */
    uint64_t palette_count, palette_entries;
    uint64_t bits; /* indices, palettes and directory, without the table */
    uint64_t capacity[2]; /* of the arrays */
} svo_algorithm1_result;

/* Table indices index[0 .. count), all below table_count; an entry of the directory has `directory_bits`. */
svo_result svo_algorithm1(const uint32_t *index, uint64_t count, uint64_t table_count, uint32_t directory_bits, uint32_t threads,
                          const svo_allocator *a, svo_algorithm1_result *out, svo_error *err);
void svo_algorithm1_free(svo_algorithm1_result *r, const svo_allocator *a);

#ifdef __cplusplus
}
#endif
#endif
