/* Internal to libsvo: tables that make looking up a voxel faster. They are made once when a view is opened, are bounded
 * whatever the file holds, and change no result. Not installed.
 *
 * 1. The cells of one upper level, by place, so that a look-up need not begin at the root: a 64-ary tree with a mask a node, each step two levels: a step is one look into a node of 16 bytes. It leads to the
 * cells of `level`, in the order of the grid, each with what the layout needs to go on from there.
 * 2. For layout fast, the stored nodes of 16^3 voxels: the sizes of their children, which the file leaves to be counted, and
 * where they begin. */
#ifndef SVOI_TOP_H
#define SVOI_TOP_H

#include "svo_morton.h"
#include "svoi_best.h"

enum { SVOI_TOP_CELLS = 1 << 16, SVOI_NEAR_NODES = 80000, SVOI_NEAR_SHIFT = 8 }; /* at most */

typedef struct svoi_top_node {
    uint64_t mask;  /* children: 4x4x4 cells in Morton order */
    uint64_t first; /* number of the first child in the next step's nodes, after the last step in the cells */
} svoi_top_node;

typedef struct svoi_top_cell {
    uint64_t place;     /* svoi_top_place, or SVOI_TOP_FULL */
    uint64_t attribute; /* index of the cell's node */
} svoi_top_cell;
#define SVOI_TOP_FULL UINT64_MAX /* inside a full leaf, whose attribute it has */

/* A stored node of 16^3 voxels. Its children, by stored octant. */
typedef struct svoi_near_node {
    uint32_t at;       /* bit position; ascending in the table */
    uint16_t size[8];  /* attributes; 0: no child */
    uint16_t begin[8]; /* position less the node's; 0: in a pool, or a full leaf */
} svoi_near_node;

typedef struct svoi_top {
    uint32_t level, shift; /* of the cells; tree_depth - level */
    uint32_t steps;
    uint64_t node_count, cell_count;
    svoi_top_node *node; /* of all steps, the root first */
    svoi_top_cell *cell;
    uint64_t *size; /* layout best: attributes of the cell's subtree */
    svoi_near_node *near; /* NULL: none */
    uint32_t *bucket;     /* number of the first node at or behind bit i << SVOI_NEAR_SHIFT */
    uint64_t near_count, bucket_count;
} svoi_top;

/* The cell that holds a voxel; NULL: it is empty. */
static inline const svoi_top_cell *svoi_top_find(const svoi_top *t, uint32_t x, uint32_t y, uint32_t z)
{
    uint64_t code = svo_morton_encode(x >> t->shift, y >> t->shift, z >> t->shift), at = 0;
    for (uint32_t shift = 6 * t->steps; shift != 0;) {
        shift -= 6;
        const svoi_top_node *n = &t->node[at];
        uint32_t bit = code >> shift & 63;
        if (!(n->mask >> bit & 1)) return NULL;
        at = n->first + (uint64_t)__builtin_popcountll(n->mask & (((uint64_t)1 << bit) - 1));
    }
    return &t->cell[at];
}

/* The node of 16^3 voxels that begins at this bit. */
static inline const svoi_near_node *svoi_near_find(const svoi_top *t, uint64_t at)
{
    const svoi_near_node *n = &t->near[t->bucket[at >> SVOI_NEAR_SHIFT]];
    while (n->at != (uint32_t)at) n++;
    return n;
}
/* Attributes of its children in the stored octants of `which`. */
static inline uint32_t svoi_near_size(const svoi_near_node *n, uint32_t which)
{
    uint32_t size = 0;
    for (uint32_t o = 0; o < 8; o++) size += n->size[o] & (0u - (which >> o & 1));
    return size;
}

/* Positions have 50 bits here; in layout fast the 8 of the mask are 0. */
enum { SVOI_TOP_PLACE_BITS = 50 };
static inline uint64_t svoi_top_place(svoi_best_node n, uint32_t turn) { return n.at << 14 | n.mask << 6 | turn; }
static inline uint32_t svoi_top_turn(uint64_t place) { return place & 63; }
static inline svoi_best_node svoi_top_node_at(uint64_t place) { return (svoi_best_node){place >> 14, place >> 6 & 0xff}; }

/* At most `cells` of them. NULL when the octree has no upper level worth it, or there is no memory. */
svoi_top *svoi_top_make(const svo_view *v, uint64_t cells, const svo_allocator *a);
/* Table 2 of a view of layout fast; none without memory. */
void svoi_near_make(svoi_top *t, const svo_view *v, const svo_allocator *a);
void svoi_top_free(svoi_top *t, const svo_allocator *a);

#endif
