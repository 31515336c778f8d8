/* A block of 128^3 voxels as bits, in Morton order: what a worker marks, and the chunk that is made of it.
 *
 * A brick is a 64-bit word of 4^3 voxels; bit and brick numbers are the low and high parts of the local Morton code. */
#ifndef SVO_BLOCK_H
#define SVO_BLOCK_H

#include "svo_alloc.h"
#include "svo_raster.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_BLOCK_BRICKS 32768u
#define SVO_BLOCK_ROW_VISITS 1024u /* a row meets no more bricks: one for every four columns and four voxels of theirs */

typedef struct svo_block {
    uint64_t bricks[SVO_BLOCK_BRICKS];
    uint64_t used[512];                   /* bit i of word j: brick 64 j + i is not empty */
    uint64_t complex[SVO_BLOCK_BRICKS];   /* voxels whose attributes have to be averaged */
    uint64_t masked[SVO_BLOCK_BRICKS];    /* voxels that alpha MASK took something from */
    uint64_t dirty[512];                  /* bricks of `masked` or `complex` to be cleared */
    uint32_t rank[SVO_BLOCK_BRICKS];         /* after svo_block_emit: voxels in the bricks before (of used bricks only) */
    uint32_t complex_rank[SVO_BLOCK_BRICKS]; /* the same for complex voxels */
    uint32_t spread[3][SVO_RASTER_SIZE];     /* Morton bits of a local coordinate */
} svo_block;

typedef struct svo_block_counts {
    uint64_t nodes[8]; /* non-empty nodes of size 128, 64 .. 1 */
    uint64_t complex;
} svo_block_counts;

void svo_block_init(svo_block *b);  /* all empty */
void svo_block_clear(svo_block *b); /* in the time of what was marked */

/* Row functions: mark what a scan finds; `complex` of voxels marked before (mark_flat) or of all (mark_shaded). */
void svo_block_mark(svo_block *b, const svo_raster_row *row);
void svo_block_mark_flat(svo_block *b, const svo_raster_row *row);
void svo_block_mark_shaded(svo_block *b, const svo_raster_row *row);

/* What one triangle meets in one brick. A triangle's visits are remembered brick by brick, so that its voxels can be looked at again without a scan,
 * and marks are made once a visit instead of once a voxel. Bits of a triangle's visits to the same brick are apart. */
typedef struct svo_block_visit { uint64_t bits; uint32_t brick; } svo_block_visit;
typedef struct svo_block_visits {
    svo_block_visit *at;     /* room for SVO_BLOCK_ROW_VISITS more before each row */
    uint32_t first, count;   /* visits of the triangle in hand begin at `first` */
    uint32_t open[64];       /* the last visit by four columns and parity of the brick along w, if it is the triangle's: rows that follow add to it */
} svo_block_visits;
/* Remember a row; nothing is marked. */
void svo_block_remember(const svo_block *b, const svo_raster_row *row, svo_block_visits *v);
/* Mark what a triangle's visits say; `complex` of voxels that were marked before. */
void svo_block_meet(svo_block *b, const svo_block_visit *v, uint32_t count);

/* Local Morton code of column (u, v) of a row; or in spread[w][at] for a voxel. */
static inline uint32_t svo_block_column(const svo_block *b, const svo_raster_row *row, int32_t u)
{
    return b->spread[row->u][u] | b->spread[row->v][row->at_v];
}

static inline void svo_block_set(svo_block *b, uint32_t code)
{
    uint64_t *brick = &b->bricks[code >> 6];
    if (*brick == 0) b->used[code >> 12] |= (uint64_t)1 << (code >> 6 & 63);
    *brick |= (uint64_t)1 << (code & 63);
}

/* Number of a marked voxel among all (among the complex ones) in Morton order. */
static inline uint32_t svo_block_index(const svo_block *b, uint32_t code)
{
    return b->rank[code >> 6] + (uint32_t)__builtin_popcountll(b->bricks[code >> 6] & (((uint64_t)1 << (code & 63)) - 1));
}
static inline uint32_t svo_block_complex_index(const svo_block *b, uint32_t code)
{
    return b->complex_rank[code >> 6] + (uint32_t)__builtin_popcountll(b->complex[code >> 6] & (((uint64_t)1 << (code & 63)) - 1));
}

/* Child masks in depth-first preorder from size 128 down (7 levels) appended to `masks`; ranks and counts filled. False
 * when out of memory. An empty block appends nothing. */
bool svo_block_emit(svo_block *b, svo_buffer *masks, svo_block_counts *counts);

#ifdef __cplusplus
}
#endif
#endif
