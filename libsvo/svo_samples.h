/* Samples of space to voxels: points of a scan, cells of a volume. Given in any order and number, sorted by Morton code (through temporary
 * files where they do not fit in memory), those of a cell averaged, the cells handed on as an octree.
 *
 * Sums are integers, so that the result does not depend on the order of samples, on memory or on threads. */
#ifndef SVO_SAMPLES_H
#define SVO_SAMPLES_H

#include "svo_spill.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { SVO_SAMPLE_COLOR = 1, SVO_SAMPLE_NORMAL = 2, SVO_SAMPLE_VALUE = 4 };

typedef struct svo_sample {
    uint64_t code;     /* of its cell, at the grid's depth */
    uint16_t color[3]; /* linear light, 65535 = 1 */
    int16_t normal[3]; /* unit, 32767 = 1 */
    uint16_t value;    /* 65535 = 1 */
    uint16_t has;      /* SVO_SAMPLE_ bits: which of them mean something */
} svo_sample;

typedef struct svo_samples_options {
    uint32_t depth;         /* of the grid; all codes are below 8^depth */
    uint64_t least;         /* samples that make a cell; fewer are noise. 0 counts as 1 */
    uint64_t memory;        /* bytes to hold, 0 = no limit */
    const svo_spill *spill; /* for what does not fit; NULL: SVO_LIMIT then */
    const svo_allocator *allocator;
} svo_samples_options;

typedef struct svo_samples svo_samples;
/* Freed by svo_samples_free. One thread. */
svo_result svo_samples_create(const svo_samples_options *o, svo_samples **out, svo_error *err);
/* `count` samples, copied. SVO_LIMIT when they do not fit and there is no spill (or no room in it), SVO_IO of temporary files, SVO_OUT_OF_MEMORY. */
svo_result svo_samples_put(svo_samples *s, const svo_sample *sample, uint64_t count, svo_error *err);

typedef struct svo_samples_report {
    uint64_t samples, cells, dropped_cells; /* dropped: with fewer samples than the least */
    uint64_t most;                          /* samples in one cell that was kept */
    uint64_t runs;                          /* sorted parts that went to temporary files */
    uint64_t canceled_normals;              /* cells whose normals, as they are signed, come to nothing */
} svo_samples_report;

/* Hand on the octree; once, after the last put. Channels of info that are not constant are filled by their kind: SVO_KIND_COLOR_SRGB8 with the mean in linear
 * light, SVO_KIND_NORMAL_OCT32 with the mean direction (where opposite signs leave less than 1 % of the length, of the normals turned to one side),
 * SVO_KIND_UNORM8 with the mean value. At most one of each kind. A cell without a sample that has one is white, +Z, 0.
 * Errors of the sink and of temporary files; SVO_OUT_OF_MEMORY. */
svo_result svo_samples_emit(svo_samples *s, const svo_tree_info *info, const svo_chunk_sink *sink, svo_samples_report *report, svo_error *err);
void svo_samples_free(svo_samples *s);

#ifdef __cplusplus
}
#endif
#endif
