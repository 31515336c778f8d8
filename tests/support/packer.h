/* A simple packer of layout 1, independent of svo_dag: voxels in, arrays out. For tests of what reads a view. */
#ifndef PACKER_H
#define PACKER_H

#include "svo_view.h"

/* Value of channel `channel` in finest voxel x, y, z (stride bytes). */
typedef void (*packer_value_fn)(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out);

typedef struct packer_options {
    bool lod, unnumbered;
    bool averaged;         /* with lod: bricks and their octants have no attributes of their own */
    bool share;            /* identical nodes once (a linear search, for small octrees) */
    uint32_t offset_words; /* 1 or 2; 0 = 1 */
    const double *voxel_to_world; /* NULL: identity */
    uint32_t channel_count;
    svo_channel channels[SVO_MAX_CHANNELS]; /* stored raw, inner nodes averaged */
    packer_value_fn value;
    void *user;
} packer_options;

/* codes: count Morton codes in any order, duplicates allowed. Aborts when out of memory. Free with packer_free. */
svo_view *packer_make(uint32_t depth, const uint64_t *codes, uint64_t count, const packer_options *options);
void packer_free(svo_view *view);

/* The whole cube of 2^depth, depth <= 21, without attributes: one node a level. Inner nodes count as having attributes
 * when lod; indices are right. */
svo_view *packer_solid(uint32_t depth, bool lod);

#endif
