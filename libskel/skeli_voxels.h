/* Inside libskel: the cells of an octree's level and the closed surface around them (skel_voxels.c, skel_voxels_boundary.c, skel_voxels_fit.c). */
#ifndef SKELI_VOXELS_H
#define SKELI_VOXELS_H

#include "skeli_internal.h"

/* Occupied cells of one level in Morton order, and how many finest voxels each holds. */
typedef struct cells {
    const svo_allocator *allocator;
    svo_buffer code, voxels; /* u32, u32 */
    svo_buffer normal;       /* float[3] of each cell, sums over its voxels; empty without normals */
    uint32_t channel;        /* of normals; SVO_NONE: none */
    const svo_chunk *chunk;  /* being read */
    uint32_t level, shift;   /* shift: levels between the cells and the finest voxels */
    uint64_t count, total;
    bool failed, too_many;
} cells;

static inline uint32_t *codes(const cells *c) { return (uint32_t *)(void *)c->code.data; }
static inline uint32_t *counts(const cells *c) { return (uint32_t *)(void *)c->voxels.data; }
static inline float *normals(const cells *c) { return (float *)(void *)c->normal.data; }
/* Index of the first cell with this code; UINT64_MAX: none. */
static inline uint64_t find_cell(const cells *c, uint32_t code)
{
    uint64_t low = 0, high = c->count;
    while (low < high) {
        uint64_t middle = (low + high) / 2;
        if (codes(c)[middle] < code) low = middle + 1;
        else high = middle;
    }
    return low < c->count && codes(c)[low] == code ? low : UINT64_MAX;
}

/* From a cell to the one beside it on each of its sides; UINT32_MAX steps back. */
static const uint32_t side_step[6][3] = {{UINT32_MAX, 0, 0}, {1, 0, 0}, {0, UINT32_MAX, 0}, {0, 1, 0}, {0, 0, UINT32_MAX}, {0, 0, 1}};

/* Bits of an n^3 grid, rows of words along x. */
typedef struct bits {
    uint32_t n, words;
    uint64_t last;      /* valid bits of a row's last word */
    uint64_t *occupied, *outside;
} bits;

/* Corners of the grid that the boundary uses, by number of the corner and group of sides: 0, or where there are several, one more than the first side. */
typedef struct corners {
    uint64_t *key;   /* UINT64_MAX = empty slot */
    uint32_t *index;
    uint64_t mask;
    uint32_t count;
    uint32_t side; /* n + 1 */
} corners;

typedef struct boundary {
    corners corner;
    double *position; /* of the cells' grid until the end of skeli_voxels_boundary, then of the world */
    float *normal;    /* 6 a point, in between: the sum of the unit normals of the cells at it, and of the directions of the sides at it */
    uint32_t *triangle;
    uint64_t points, triangles;
} boundary;

/* What is outside of the cells, and the boundary there, as triangles in the world (of the pool). SVO_LIMIT beyond 2 * max_vertices sides, SVO_OUT_OF_MEMORY. */
svo_result skeli_voxels_boundary(skeli_pool *pool, const cells *c, const double *to_world, uint64_t max_vertices, bits *grid, boundary *out, svo_error *err);
/* Move points of the boundary (in the cells' grid) to where the surface was that the cells were made of, as far as normals tell. */
void skeli_voxels_fit(const bits *grid, boundary *b);
/* Points of the boundary at the corners of the cell at p. Returns how many. */
uint32_t skeli_voxels_points(const cells *c, const bits *grid, const boundary *b, const uint32_t p[3], uint32_t points[24]);

#endif
