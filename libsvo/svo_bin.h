/* Triangles placed in the grid, and the walk that hands them to subtrees in Morton order. */
#ifndef SVO_BIN_H
#define SVO_BIN_H

#include "svo_alloc.h"
#include "svo_mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Voxel (i, j, k) of the grid is origin + size * [i, i+1] x ... */
typedef struct svo_grid {
    double origin[3], size;
    uint32_t depth;
} svo_grid;

/* The grid of something with these bounds (any false: of nothing): its longest side is 2^depth voxels, or with a voxel_size > 0 voxels of that size on multiples of
 * it. SVO_LIMIT where the extent or the number of cells is beyond what can be. */
svo_result svo_grid_plan(bool any, const double low[3], const double high[3], uint32_t depth, double voxel_size, svo_grid *out, svo_error *err);
/* The cell that holds a point inside the bounds: floor((p - origin) / size) in exact arithmetic, clamped into the grid. */
void svo_grid_cell(const svo_grid *g, const double p[3], uint32_t cell[3]);

/* The snap: v = (p - origin) / size, q = 2 floor(128 v) + 1 in units of 1/256 voxel, clamped into the grid. */
void svo_grid_snap(const svo_grid *g, svo_vec3 p, int32_t q[3]);

/* Every part of every instance, in order; triangle numbers run through them. Instances are not expanded. */
typedef struct svo_group {
    uint64_t first; /* number of its first triangle */
    const svo_part *part;
    uint32_t instance;
    bool identity; /* the instance's transform changes nothing */
} svo_group;
typedef struct svo_placement {
    const svo_mesh *mesh;
    const svo_allocator *allocator;
    svo_group *groups;
    uint64_t group_count, triangle_count;
} svo_placement;
svo_result svo_placement_create(const svo_mesh *mesh, const svo_allocator *a, svo_placement *out, svo_error *err);
void svo_placement_free(svo_placement *p);
/* Group of a triangle number (binary search). */
uint32_t svo_placement_group(const svo_placement *p, uint64_t triangle);
/* World corners of triangle `local` of a group. One fixed expression, so that equal vertices give equal points. */
void svo_placement_world(const svo_placement *p, const svo_group *group, uint64_t local, svo_vec3 v[3]);
/* Bounds of all triangles whose corners are finite; false if there is none. */
svo_result svo_placement_bounds(const svo_placement *p, uint32_t threads, bool *any, double low[3], double high[3], svo_error *err);

/* A snapped triangle. */
typedef struct svo_record {
    int32_t q[3][3];
    uint32_t group;
} svo_record;

typedef struct svo_bins_report {
    uint64_t skipped, degenerate;
    double snap_sum, snap_max; /* voxels; over the 3 corners of every finite triangle */
} svo_bins_report;

/* Hands out non-empty subtrees at `level` in ascending Morton order, each with the triangles that may meet it. Memory: about 9
 * bytes a triangle, and 40 more when the snapped triangles are kept (done when `keep_bytes` allows). */
typedef struct svo_bins svo_bins;
svo_result svo_bins_create(const svo_placement *p, const svo_grid *g, uint32_t level, uint64_t keep_bytes, uint32_t threads,
                           const svo_allocator *a, svo_bins **out, svo_bins_report *report, svo_error *err);
/* Hand out only subtrees with first <= code < end, and spend nothing on the others. Before the first svo_bins_next. */
void svo_bins_limit(svo_bins *b, uint64_t first, uint64_t end);
/* Next subtree: its code, and its triangle numbers (uint32_t) in place of what `list` held. *more false at the end. */
svo_result svo_bins_next(svo_bins *b, uint64_t *code, svo_buffer *list, bool *more, svo_error *err);
/* With solids, nodes that no triangle meets matter too. Asked for each such node that has a sibling with triangles, from the largest
 * down: SVO_BIN_SPLIT asks for its children, or hands it out when its level is that of the subtrees. Called by the thread that calls
 * svo_bins_next_node. Set before the first call. */
typedef enum svo_bin_side { SVO_BIN_SKIP, SVO_BIN_FULL, SVO_BIN_SPLIT } svo_bin_side;
typedef svo_bin_side (*svo_empty_fn)(void *user, uint64_t code, uint32_t level);
void svo_bins_empty_nodes(svo_bins *b, svo_empty_fn fn, void *user);
/* Bins without triangles: ask the function for the largest nodes that lie in first <= code < end (codes at the level of subtrees), as if all of
 * them were empty ones with a sibling that is not. */
void svo_bins_gap(svo_bins *b, uint64_t first, uint64_t end);
/* Like svo_bins_next; *full: an empty node of *level (at most that of the subtrees) for which fn said SVO_BIN_FULL. */
svo_result svo_bins_next_node(svo_bins *b, uint64_t *code, uint32_t *level, bool *full, svo_buffer *list, bool *more, svo_error *err);
/* Snapped triangle by number; callable from any thread. */
void svo_bins_record(const svo_bins *b, uint32_t triangle, svo_record *out);
/* A hint that it will be asked for soon. */
void svo_bins_fetch(const svo_bins *b, uint32_t triangle);
void svo_bins_free(svo_bins *b);

#ifdef __cplusplus
}
#endif
#endif
