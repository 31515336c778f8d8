/* Algorithm 1 of Dado et al. 2016: blocks of any length with palettes of table indices, found greedily. The yardstick that
 * svo_palette.h is measured against. The blocks are those of the printed algorithm (ties: the first position), but the
 * largest block is not found by trying all pairs: probes rule out most places where runs are short, elsewhere there are windows over runs and a tree of
 * maxima. Time is O(n log n). */
#ifndef SVO_ALGORITHM1_H
#define SVO_ALGORITHM1_H

#include "svo_alloc.h"
#include "svo_palette.h"
#include "svo_rules.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct svo_algorithm1_block {
    uint64_t begin;   /* first value; the block ends where the next one begins */
    uint64_t palette; /* where the entries of its palette begin in `palettes` */
    uint64_t palette_number; /* palettes before it there */
    uint32_t bits;    /* of a palette index, 0..8 */
} svo_algorithm1_block;

typedef struct svo_algorithm1_result {
    svo_algorithm1_block *blocks; /* ascending */
    uint64_t block_count;
    uint32_t *palettes; /* of each its number of entries, then table indices, ascending; equal palettes are stored once */
    uint64_t palette_count, palette_entries;
    uint64_t bits; /* indices, palettes and directory, without the table */
    uint64_t capacity[2]; /* of the arrays */
    double seconds_large; /* wall time of phase one, for benches */
} svo_algorithm1_result;

/* Table indices index[0 .. count), all below table_count; an entry of the directory has `directory_bits`. */
svo_result svo_algorithm1(const uint32_t *index, uint64_t count, uint64_t table_count, uint32_t directory_bits, uint32_t threads,
                          const svo_allocator *a, svo_algorithm1_result *out, svo_error *err);
void svo_algorithm1_free(svo_algorithm1_result *r, const svo_allocator *a);

/* The same as an encoding of a channel (docs/format/svdag.md, "Long blocks"): groups of 2^18 values, each coded by itself. Of svo_palette,
 * `directory` has superblock_count entries of SVO_ALGORITHM1_ENTRY bytes, one for each block. */
#define SVO_ALGORITHM1_GROUP_BITS 18u
#define SVO_ALGORITHM1_GROUP ((uint32_t)1 << SVO_ALGORITHM1_GROUP_BITS)
#define SVO_ALGORITHM1_ENTRY 8u

/* Encode job->count (not 0) values, all of them in the table; the goal is not looked at. Directory and payload must be empty. The bytes do not
 * depend on the number of threads. */
svo_result svo_algorithm1_encode(const svo_palette_job *job, svo_buffer *directory, svo_buffer *payload, svo_error *err);
/* Prove that svo_algorithm1_value is safe for all values < count. Linear time. Blocks of no bits are counted in `stats` (may be NULL) as
 * SVO_BLOCK_ONE, others as palettes. */
svo_result svo_algorithm1_check(const svo_palette *p, svo_palette_stats *stats, svo_error *err);
/* The same, but violations go to `rules` (NULL: the first ends it), and what does not hang on them is checked as well. */
svo_result svo_algorithm1_check_all(const svo_palette *p, svo_palette_stats *stats, svo_rules *rules, svo_error *err);
uint32_t svo_algorithm1_value(const svo_palette *p, uint64_t i);

#ifdef __cplusplus
}
#endif
#endif
