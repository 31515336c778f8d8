/* Octrees as sorted lists of voxels with values: what the files and builders are tested against. */
#ifndef TREES_H
#define TREES_H

#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct tree {
    svo_tree_info info;
    uint64_t count;
    uint64_t *codes;                   /* ascending Morton codes of the finest voxels */
    uint8_t *values[SVO_MAX_CHANNELS]; /* count values a channel; NULL for constant ones */
    uint64_t capacity;
} tree;

/* Styles: 0 few scattered voxels and no channels, 1 clusters with every kind of channel, 2 voxels in the corners of the
 * grid with a constant and a varying channel. */
enum { TREE_STYLES = 3 };
void tree_random(tree *t, uint32_t depth, uint32_t style, uint64_t *seed);
/* Every voxel of the grid, one colour channel. */
void tree_full(tree *t, uint32_t depth, uint64_t *seed);
void tree_free(tree *t);

/* Give the tree to a sink chunk by chunk (encode in parallel, commit in order). */
svo_result tree_feed(const tree *t, uint32_t threads, svo_chunk_sink sink, svo_error *err);
/* The chunk that begins at voxel `first`; masks go to *masks. Returns the voxel after its last. */
uint64_t tree_chunk(const tree *t, uint64_t first, svo_buffer *masks, svo_chunk *chunk);
/* Fails the running test when the source does not give exactly this tree. */
void tree_check(const tree *t, const svo_tree_info *info, svo_chunk_source source);

/* The tree as a .svo file in memory, with provenance {"tool":"test"}; in the small form with packed values, in the fast form through zstd, or as
 * fmt_svo_writer_begin and fmt_svo_writer_small say. */
void tree_write_as(const tree *t, bool small, int level, uint32_t threads, svo_buffer *file, svo_tree_counts *counts);
void tree_write_small(const tree *t, uint32_t threads, svo_buffer *file, svo_tree_counts *counts);
void tree_write(const tree *t, uint32_t threads, svo_buffer *file, svo_tree_counts *counts);

#ifdef __cplusplus
}
#endif
#endif
