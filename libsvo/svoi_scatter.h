/* Triangles binned to ranges of units outside of memory: what the voxelizer does when snapped triangles and lists do not fit.
 *
 * The triangles are read twice. The first reading adds up, for each cell of a coarse grid, what the triangles that meet it cost
 * in memory; consecutive cells (Morton order) are joined to bins that fit. The second writes each triangle to every bin that
 * it meets, once a bin, as a record of its own (svo_soup.h) behind the number of its group. All bins share one file: each
 * has a write buffer, and full buffers become blocks of the file. A bin that is still too large is the source of another round. */
#ifndef SVOI_SCATTER_H
#define SVOI_SCATTER_H

#include "svo_bin.h"
#include "svo_soup.h"

/* What does not change between rounds. */
typedef struct svoi_scatter_plan {
    const svo_placement *placement;
    const svo_soup_layout *layouts; /* by group */
    svo_grid grid;
    uint32_t unit_level; /* of the nodes that are never cut (svoi_unit_levels) */
    const svo_spill *spill;
    const svo_allocator *allocator;
    uint32_t threads;
    uint64_t bin_cost;  /* bytes of memory that a bin may take when it is loaded */
    uint32_t max_bins;  /* of a round: bounds the write buffers */
    uint32_t max_cells; /* of a round's coarse grid */
} svoi_scatter_plan;

/* Units first <= code < end. */
typedef struct svoi_bin {
    uint64_t first, end;
    uint64_t triangles, cost;
    uint32_t first_block, last_block; /* UINT32_MAX: none */
    bool too_large;                   /* costs more than it may */
} svoi_bin;

typedef struct svoi_scattered svoi_scattered;

/* Bin the triangles of the placement (from == NULL) or of one bin of an earlier round, which gives its space back as it is read.
 * `report` (may be NULL) receives what the first reading says of the triangles. */
svo_result svoi_scatter(const svoi_scatter_plan *plan, svoi_scattered *from, const svoi_bin *bin, uint64_t first, uint64_t end,
                        svoi_scattered **out, svo_bins_report *report, svo_error *err);
void svoi_scattered_free(svoi_scattered *s);
uint32_t svoi_scattered_count(const svoi_scattered *s);
const svoi_bin *svoi_scattered_bin(const svoi_scattered *s, uint32_t number);

/* A part of a bin: blocks one after the other, up to a cost. */
typedef struct svoi_bin_part {
    uint32_t block, blocks;
} svoi_bin_part;
/* The whole bin. */
svoi_bin_part svoi_bin_whole(const svoi_scattered *s, const svoi_bin *bin);
/* Cut a bin into parts that cost no more than `cost` (or are one block). Appends svoi_bin_part. */
svo_result svoi_bin_parts(const svoi_scattered *s, const svoi_bin *bin, uint64_t cost, svo_buffer *parts, svo_error *err);
/* Its triangles as a mesh in memory that shares materials and images with the placement's mesh; free it with svoi_submesh_free. */
svo_result svoi_bin_load(const svoi_scattered *s, const svoi_bin_part *part, svo_mesh *out, svo_error *err);
void svoi_submesh_free(svo_mesh *mesh);

/* Bytes of memory that a triangle of a loaded bin takes: arrays, snapped record, lists. */
uint64_t svoi_triangle_cost(const svo_soup_layout *layout);
/* svo_placement_bounds for placements some of whose parts lie outside of memory. */
svo_result svoi_bounds(const svo_placement *p, uint32_t threads, const svo_allocator *a, bool *any, double low[3], double high[3], svo_error *err);
/* Layouts of all groups, by group (allocated; group_count elements; NULL without groups). */
svo_result svoi_layouts(const svo_placement *p, svo_soup_layout **out, svo_error *err);

#endif
