/* Cells of any level to an octree (Willcocks 2013, 4.2.1 to 4.2.3): Morton codes, a radix sort, cells that lie in coarser ones left out, and the nodes
 * above them level by level. A cell coarser than the finest level becomes a full leaf, so its level is preserved and traversal stops there. */
#ifndef SVO_HIERARCHY_H
#define SVO_HIERARCHY_H

#include "svo_view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A cell to fill. */
typedef struct svo_sample {
    uint64_t code;  /* Morton code of its low corner on the finest level */
    uint32_t value; /* < value_count */
    uint32_t level; /* 0 .. depth; bits of the code below it are 0 */
} svo_sample;

/* How one channel is made where averages would not do, as sums of what is in a cell. `samples`: all of a cell, and after them those of finer cells inside it (which have no cell of
 * their own); the cell is that of samples[0], and is stored as cells of `level`, which is its own or finer. `value` comes as the average of the cell's own. Called by one thread at a time. */
typedef struct svo_hierarchy_merge {
    uint32_t channel;
    void (*merge)(void *user, const svo_sample *samples, uint64_t count, uint32_t level, uint8_t *value);
    void *user;
} svo_hierarchy_merge;

typedef struct svo_hierarchy_input {
    uint32_t depth; /* 2 .. SVO_MAX_DEPTH */
    double voxel_to_world[16];
    uint64_t sample_count;
    svo_sample *samples; /* are sorted in place */
    uint64_t value_count;
    uint32_t channel_count;
    svo_channel channels[SVO_MAX_CHANNELS]; /* none constant */
    const uint8_t *values[SVO_MAX_CHANNELS]; /* value_count * stride bytes */
    const svo_hierarchy_merge *merge; /* NULL: all channels are averages */
    /* Weights of a cell's samples in its average, not negative; NULL: all weigh the same. Called by one thread at a time. */
    void (*weigh)(void *user, const svo_sample *samples, uint64_t count, double *weights);
    void *user; /* of weigh */
} svo_hierarchy_input;

typedef struct svo_hierarchy_report {
    uint64_t samples, cells; /* given; different ones that no coarser one holds */
    uint64_t voxels;         /* finest voxels, as view->nodes[depth] */
    uint64_t full_leaves;
    uint64_t bytes;          /* of the octree */
    double seconds_sort, seconds_build;
} svo_hierarchy_report;

/* An octree in memory, layout plain, inner nodes without attributes. Cells that several samples fill have the average of their values in the order given
 * (labels: the one of most weight), the first where nothing weighs anything. Equal inputs give equal octrees whatever the threads (0 = all). SVO_LIMIT beyond 2^32 - 1 values or words a level.
 * Memory: 16 bytes a sample besides the input, and the octree. */
typedef struct svo_hierarchy svo_hierarchy;
svo_result svo_hierarchy_build(const svo_hierarchy_input *input, uint32_t threads, const svo_allocator *a, svo_hierarchy **out,
                               svo_hierarchy_report *report, svo_error *err);
const svo_view *svo_hierarchy_view(const svo_hierarchy *h);
void svo_hierarchy_free(svo_hierarchy *h);

/* Sort by (code, level), stable. `scratch` has room for as many. */
svo_result svo_sort_samples(svo_sample *samples, svo_sample *scratch, uint64_t count, uint32_t threads, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
