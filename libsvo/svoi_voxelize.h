/* Between the two halves of the voxelizer: svo_voxelize.c marks voxels and runs the pipeline, svo_voxelize_shade.c gives the marked
 * voxels of a chunk their attributes. */
#ifndef SVOI_VOXELIZE_H
#define SVOI_VOXELIZE_H

#include "svo_bin.h"
#include "svo_block.h"
#include "svo_distance.h"
#include "svo_raster.h"
#include "svo_shade.h"
#include "svo_solid.h"
#include "svo_soup.h"
#include "svo_voxelize.h"
#include "svoi_lanes.h"
#include "svoi_reference.h"

enum { SVOI_MAX_WORKERS = 256 };

/* Scratch of a worker. */
typedef struct svoi_worker {
    svo_block *block;
    svo_buffer masks, sums, values, ids;
    svo_buffer visits, codes, starts; /* what each triangle meets: svo_block_visit of large ones, local Morton codes of voxels (uint32_t) of others; svoi_start */
    /* of solids */
    svo_solid *solid;
    svo_buffer entries, sources, filled; /* uint32_t a value: what it is, and the surface voxel it takes after; values with the inside */
    svo_facet nearest;                   /* the last facet that a value was read from */
    svo_winding_hit hit;                 /* its triangle, or SVO_NONE: none yet */
    struct svoi_single *single;          /* what that facet points to when triangles do not lie in memory */
} svoi_worker;

/* Where what a triangle meets begins; its end is the next one's. */
typedef struct svoi_start { uint32_t visit, code; } svoi_start;

/* One chunk that is made of up to 64 units, which come in ascending Morton order. */
enum { SVOI_JOIN_LEVELS = 2, SVOI_JOIN_UNITS = 64 };
typedef struct svoi_join {
    uint64_t used; /* bit: unit */
    size_t start[SVOI_JOIN_UNITS + 1]; /* of a used unit's masks; the next one's is its end */
    uint64_t value_count;
    svo_buffer masks, chunk, channels[SVO_MAX_CHANNELS];
} svoi_join;

/* Levels below the root of a unit: a chunk, or a part of the only chunk of a small octree. */
uint32_t svoi_unit_levels(uint32_t depth);
void svoi_join_init(svoi_join *j, const svo_allocator *a);
void svoi_join_free(svoi_join *j);
svo_result svoi_join_add(svoi_join *j, const svo_tree_info *info, uint64_t code, const svo_chunk *unit, svo_error *err);
/* The chunk; it lives as long as the join. */
svo_result svoi_join_chunk(svoi_join *j, const svo_tree_info *info, svo_chunk *out, svo_error *err);
/* Voxels that are compared with a reference in the end: those whose codes have the smallest hashes. */
typedef struct svoi_samples {
    svo_buffer list, triangles; /* svoi_sample; uint32_t */
} svoi_samples;

typedef struct svoi_run {
    const svo_tree_info *info;
    const svo_chunk_sink *sink;
    const svo_allocator *allocator;
    svo_voxelize_report *report;
    svo_grid grid;
    svo_placement placement;
    svo_bins *bins;
    svo_shader *shader; /* NULL without channels that vary */
    bool masks;         /* some material cuts voxels away, so shading is asked first */
    const svo_limit_allocator *limit; /* where memory is limited, else NULL */
    uint64_t memory, part_cost;       /* that limit; what a part of a unit's triangles may take of it */
    bool alone;                       /* one worker */
    svo_winding *winding; /* of solids, else NULL; of all triangles, also where the run has those of a bin */
    struct svoi_far *far; /* NULL: the numbers that the winding knows are those of the run's placement */
    svo_solid_counts asked; /* by the thread that makes items */
    uint32_t most_visits;  /* (triangle, brick) pairs of a chunk that are remembered, and a fourth of the (triangle, voxel) pairs; with more they are found again */
    uint64_t slice_voxels; /* voxels averaged at a time: bounds the memory for sums */
    svoi_worker workers[SVOI_MAX_WORKERS];
    bool started, has_previous;
    uint64_t previous;
    uint32_t levels; /* of a unit */
    bool joins;      /* units are parts of one chunk */
    svoi_join join;
    svoi_samples samples;
    uint32_t sample_count; /* kept at most; 0: none are taken */
    uint64_t sample_limit; /* hashes that are not below it need not be looked at; atomic */
    double began;
} svoi_run;

/* The triangles of a unit in parts, of which one at a time is in memory: `enter` makes part `number` (< count) the one that the
 * run's placement, bins and shader mean, and replaces the list. NULL where a unit's triangles are in memory together. */
typedef struct svoi_parts {
    void *user;
    uint32_t count;
    uint64_t triangles; /* of all parts */
    /* `list` must be the same buffer in every call, untouched between them. */
    svo_result (*enter)(void *user, uint32_t number, svo_buffer *list, svo_error *err);
} svoi_parts;

/* One unit on its way through the pipeline. */
typedef struct svoi_item {
    uint64_t code;
    uint32_t level;  /* of `code`: that of units; less for full leaves */
    bool full;       /* an empty node that is inside */
    svo_tree_counts tree; /* what it holds */
    svo_solid_counts asked;
    svo_buffer list; /* uint32_t triangle numbers */
    svo_buffer copy; /* masks and values of a unit that waits to be joined */
    svo_chunk unit;  /* points into copy */
    void *blob;
    bool has_blob, first;
    svo_block_counts counts;
    uint64_t masked;
    svo_distances distances; /* of one small cube in it, chosen by its code */
    svoi_samples samples;
    const svoi_parts *parts; /* usually NULL */
    svoi_run *owner; /* set once the slot has been used */
} svoi_item;

/* What the row functions need about the triangle in hand. */
typedef struct svoi_scan {
    svoi_run *r;
    svoi_worker *w;
    svoi_item *it;
    svo_facet facet;
    svo_polygon whole; /* the facet */
    bool recording; /* visits of all triangles so far are in the worker's buffers */
    bool by_brick;  /* the triangle in hand is a large one */
    svo_block_visits visits;             /* in the worker's buffer; there is room for a row's while fewer than visit_room are in it */
    uint32_t visit_room, code_count, code_room;
    int32_t corner_axis[3];
    const svo_shade_layout *layout;
    uint32_t shift;
    uint64_t slice_begin, slice_end; /* complex voxels averaged now */
    bool first_slice, one_slice;
    bool wide, eight; /* there is AVX-512; AVX2 alone */
    bool flat_ready;
    svo_contribution flat; /* of a flat facet, made when first used, and what a voxel has that it has alone */
    svoi_values flat_values;
    svoi_lanes shared, alone; /* voxels of the facet that wait for their values: met by others too, or not */
    svoi_lanes batch;         /* in hand */
    bool inner_ready, has_inner;
    float inner_reach[3];     /* of the facet's edges into bricks of inner voxels alone */
    svoi_inner inner;         /* of the facet; then voxels that it has alone wait once more: those that no edge reaches, and the others */
    svoi_wait wait_inner, wait_edge;
    uint8_t *channels[SVO_MAX_CHANNELS];
    uint64_t *sums;
    uint32_t triangle;   /* number in the placement */
    svoi_sample *sample; /* while samples are taken: those of the chunk by code, and how many */
    uint32_t sample_count;
    uint64_t sample_bricks[512]; /* bit i of word j: brick 64 j + i holds one */
} svoi_scan;

/* A triangle of the list, relative to the block; the triangle in hand made ready (its record's q as svoi_load_triangle gives it). */
void svoi_load_triangle(const svoi_scan *s, uint32_t triangle, svo_record *record);
void svoi_load_facet(svoi_scan *s, uint32_t triangle, const svo_record *record);
/* Does alpha MASK leave something of the facet in a voxel? */
bool svoi_visible(svoi_scan *s, const int32_t cell[3]);

/* Loop over the parts of a unit's triangles: there is one, the list, unless the unit is worked on in parts. */
static inline uint32_t svoi_part_count(const svoi_scan *s) { return s->it->parts != NULL ? s->it->parts->count : 1; }
svo_result svoi_enter_part(svoi_scan *s, uint32_t number, svo_error *err);
/* Triangles of all parts. */
static inline uint64_t svoi_triangle_count(const svoi_scan *s) { return s->it->parts != NULL ? s->it->parts->triangles : s->it->list.size / 4; }

/* Run the units of the bins that the run holds through the pipeline. */
svo_result svoi_run_chunks(svoi_run *r, uint32_t threads, svo_error *err);
/* One unit whose triangles come in parts. */
svo_result svoi_run_chunk_parts(svoi_run *r, uint64_t code, const svoi_parts *parts, svo_error *err);
/* Memory that a worker needs, about, and the part of it that can be smaller. */
uint64_t svoi_worker_bytes(const svoi_run *r);
uint64_t svoi_scratch_bytes(const svoi_run *r);
/* Complex voxels averaged at a time. Where one worker is alone with a limit of memory as many as what is left has room for, because each time costs a visit
 * to all triangles, or a reading of them where they come in parts. */
uint64_t svoi_slice(const svoi_run *r, bool parts);
/* The inside of solids in first <= code < end (codes of units), where no triangle is but some are beside. */
svo_result svoi_run_gap(svoi_run *r, uint64_t first, uint64_t end, uint32_t threads, svo_error *err);
/* Voxelize the units first <= code < end of the run's placement in bins that fit in `memory` (0: any) besides what is allocated. */
svo_result svoi_voxelize_spilled(svoi_run *r, const svo_voxelize_options *o, uint64_t first, uint64_t end, uint64_t memory, uint32_t threads, svo_bins_report *report,
                                 svo_error *err);

/* Give the voxels of the worker's block (after svo_block_emit) their values, in s->channels. */
svo_result svoi_shade_chunk(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3], svo_error *err);

/* A function of a voxel that the triangle in hand meets and that exists. */
typedef void (*svoi_voxel_fn)(svoi_scan *s, uint32_t code);
/* Call it for triangle number i of the chunk's list. */
void svoi_visit_voxels(svoi_scan *s, uint64_t i, const svo_record *record, const int32_t box_lo[3], const int32_t box_hi[3], svoi_voxel_fn fn);

/* Samples of the chunk in hand, from its values (s->channels); then, in the order of chunks, with those of all before it. Both give
 * up silently when out of memory: then fewer voxels are compared. */
void svoi_samples_init(svoi_samples *s, const svo_allocator *a);
void svoi_samples_free(svoi_samples *s);
void svoi_samples_take(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3]);
void svoi_samples_merge(svoi_run *r, const svoi_samples *more);
svo_result svoi_samples_measure(svoi_run *r, uint32_t threads, svo_error *err);

/* Solids: the chunk of the worker's block (marked, and its surface shaded) with what is inside, or of an item that is full as a whole. Masks and
 * values are the worker's; the item's `tree` is filled. *any false: nothing there. */
svo_result svoi_solid_chunk(svoi_scan *s, uint32_t levels, svo_chunk *chunk, bool *any, svo_error *err);
svo_bin_side svoi_solid_side(void *run, uint64_t code, uint32_t level);
/* Reading single triangles of the whole placement while the run has those of a bin (svo_voxelize_far.c). */
svo_result svoi_far_create(const svo_placement *whole, const svo_soup_layout *layouts, const svo_allocator *a, struct svoi_far **out, svo_error *err);
void svoi_far_free(struct svoi_far *f);
/* Make the worker's facet that of a triangle. */
svo_result svoi_far_facet(svoi_run *r, svoi_worker *w, uint32_t triangle, svo_error *err);
void svoi_far_free_single(const svoi_run *r, svoi_worker *w);

#endif
