/* Filling a block: which of the voxels that the surface does not touch are inside, and the masks of surface and inside together.
 *
 * What the surface leaves empty is a set of octree nodes, and of voxels in the 4^3 bricks that it does touch. Neighbours that share a face
 * are on the same side of a closed surface, so the question is asked once for each connected part of the block, and its answer floods
 * the part. Near the boundary of open surfaces it is asked for smaller and smaller regions, in the end for single voxels. */
#ifndef SVO_SOLID_H
#define SVO_SOLID_H

#include "svo_block.h"
#include "svo_winding.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A voxel or full leaf of the chunk: local Morton code of its first voxel in bits 0..20, height in bits 21..23, bit 24 set when it is a voxel of
 * the surface. In the order of values. */
#define SVO_SOLID_SURFACE ((uint32_t)1 << 24)
static inline uint32_t svo_solid_code(uint32_t entry) { return entry & 0x1fffff; }
static inline uint32_t svo_solid_height(uint32_t entry) { return entry >> 21 & 7; }

typedef struct svo_solid_counts {
    uint64_t asked, ambiguous; /* points looked at; those with a winding number between 0.4 and 0.6 */
} svo_solid_counts;

/* Scratch of a worker; about 850 KB. Zero between calls. */
typedef struct svo_solid svo_solid;
svo_solid *svo_solid_create(const svo_allocator *a); /* NULL: out of memory */
void svo_solid_free(svo_solid *s);

/* Fill a block of 2^levels voxels an axis (the rest of it is not in the grid) whose low corner is at `corner` (voxels). Voxels of `block` are
 * walls, those in block->masked too (they are asked one by one). Appends masks of `levels` levels in depth-first preorder (svo_stream.h: 0 is a full
 * leaf) and, when entries is not NULL, an entry (uint32_t) for each value. *full: the block as a whole is one full leaf; then there are no masks and one entry. Nothing
 * is appended when nothing is there. root_full: may the whole be a full leaf? False when out of memory. */
bool svo_solid_fill(svo_solid *s, const svo_block *block, const svo_winding *w, const int32_t corner[3], uint32_t levels, bool root_full,
                    svo_buffer *masks, svo_buffer *entries, uint64_t *values, bool *full, svo_solid_counts *counts);

/* What is to be done with an empty node (no triangle meets it): size in voxels. Not called for the root. */
typedef enum svo_side { SVO_SIDE_OUTSIDE, SVO_SIDE_INSIDE, SVO_SIDE_MIXED } svo_side;
svo_side svo_solid_node(const svo_winding *w, const int32_t corner[3], int32_t size, svo_solid_counts *counts);

#ifdef __cplusplus
}
#endif
#endif
