/* Chunks of voxels to a packed octree: hash-consed geometry, decoupled and compressed attributes. */
#ifndef SVO_DAG_H
#define SVO_DAG_H

#include "svo_spill.h"
#include "svo_view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What is merged, and how it is laid out. All are lossless and read through svo_view.h. */
typedef enum svo_geometry {
    SVO_GEOMETRY_FAST,      /* subtrees equal under any of the 48 symmetries of the cube; layout fast */
    SVO_GEOMETRY_SVDAG,     /* equal subtrees; layout plain */
    SVO_GEOMETRY_SYMMETRIC, /* subtrees that are equal or mirror images; layout best */
    SVO_GEOMETRY_BEST,      /* as fast; layout best, the fewest bytes */
} svo_geometry;

/* How values of a channel are reduced. All zero: lossless. Colours: a table of 2^bits entries clustered in CIELAB
 * (Dado et al. 2016, section 2.4.3); normals: octahedral with bits in all. With a bound instead of bits, every attribute (inner nodes too)
 * is within it. Other kinds are always lossless. */
typedef struct svo_dag_options {
    svo_geometry geometry;
    bool lod;              /* give inner nodes the averages of what is below */
    bool averaged;         /* with lod: do not store those of bricks (4x4x4) and their octants, which readers work out from the voxels' values as
                              they are stored; with a bound, those that would be beyond it are stored as corrections */
    uint32_t color_bits;   /* 0 or 1..16 */
    double color_delta_e;  /* > 0: largest CIE94 difference of any attribute; color_bits must be 0 */
    double color_mean;     /* > 0, with color_delta_e: aim at this mean CIE94 difference, with few bytes */
    double color_psnr;     /* > 0, with color_delta_e: aim at this PSNR of sRGB bytes in dB, with few bytes */
    uint32_t normal_bits;  /* 0 or 4..32 (even) */
    double normal_degrees; /* > 0: largest angle of any attribute; normal_bits must be 0 */
    bool algorithm1;       /* palettes of Algorithm 1 (svo_algorithm1.h) instead of blocks, to compare with; not with a bound */
    uint32_t threads;      /* 0 = all */
    uint64_t memory;       /* 0 = no limit; more is SVO_LIMIT. Grows by 1.5 times the bytes of the result, which it does not mean */
    /* Where attribute values wait that are more than `value_memory` bytes (0: a quarter of `memory`, an eighth below 64 MiB, or 256 MiB without a limit); NULL: they wait in
     * memory. The result does not depend on it. Errors: those of the spill. */
    const svo_spill *spill;
    uint64_t value_memory;
    const svo_allocator *allocator;
    svo_warnings *warnings;
    /* Called when another part of the work begins: "geometry" (laying out), "attributes" (packing). May be NULL. */
    void (*phase)(void *user, const char *name);
    void *phase_user;
} svo_dag_options;
svo_dag_options svo_default_dag_options(void); /* lod, averaged, lossless */

typedef struct svo_dag_channel_report {
    char name[16];
    uint64_t bytes, distinct_in, distinct_out; /* 0: 2^17 or more, not counted (colours always are) */
    double error_mean, error_max; /* delta E CIE94 for colours, degrees for normals, value units else; over all attributes (of normals by bits that are too many to be listed: those stored) */
    uint64_t corrections;         /* averaged: those that are stored */
    uint64_t unused_entries, unused_bytes; /* table entries that no block names, left out; what that saved, narrower indices included */
    uint64_t repeated_superblocks, repeated_bytes; /* superblocks that only repeat the value before them, left out; what that saved */
    bool left_out;                /* turned out constant and stored once */
} svo_dag_channel_report;

typedef struct svo_dag_report {
    svo_tree_counts counts;          /* of the octree */
    uint64_t unique[SVO_MAX_DEPTH + 1]; /* distinct nodes a level, down to the bricks' level */
    uint64_t geometry_bytes, attribute_bytes, attributes;
    uint32_t channel_count;
    svo_dag_channel_report channels[SVO_MAX_CHANNELS];
    uint64_t peak_bytes;       /* of memory charged to `memory` */
    double seconds_read;       /* until the last chunk was in: reading, averaging and merging */
    double seconds_geometry;   /* laying out the merged nodes */
    double seconds_attributes; /* quantising and packing */
} svo_dag_report;

/* A packed octree in memory; `view` points into it. */
typedef struct svo_packed svo_packed;
const svo_view *svo_packed_view(const svo_packed *p);
void svo_packed_free(svo_packed *p);

/* Builder as a sink for chunks (for instance straight from svo_voxelize). The average of an inner node is that of the
 * finest voxels below it: colours in linear light, normals as vectors, unorms linearly, labels by majority (ties: the
 * smaller); sums are exact integers (svoi_sum), so neither threads nor chunks show. Where all values are equal it is
 * that value; where normals cancel it is the first voxel's. */
typedef struct svo_dag_builder svo_dag_builder;
svo_result svo_dag_builder_create(const svo_tree_info *info, const svo_dag_options *options, svo_dag_builder **out, svo_error *err);
svo_chunk_sink svo_dag_builder_sink(svo_dag_builder *b);
/* Ends the build; frees the builder, also on failure. report may be NULL. */
svo_result svo_dag_builder_finish(svo_dag_builder *b, svo_packed **out, svo_dag_report *report, svo_error *err);
void svo_dag_builder_free(svo_dag_builder *b);

/* The same from a source of chunks, reading and decoding on all threads. */
svo_result svo_dag_build(const svo_tree_info *info, const svo_chunk_source *source, const svo_dag_options *options,
                         svo_packed **out, svo_dag_report *report, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
