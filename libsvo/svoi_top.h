/* Internal to libsvo: tables that make looking up a voxel faster. They are made once when a view is opened, are bounded
 * whatever the file holds, and change no result. Not installed.
 *
 * 1. The cells of one upper level, by place, so that a look-up need not begin at the root: a 64-ary tree with a mask a node, each step two levels: a step is one look into a node of 16 bytes. It leads to the
 * cells of `level`, in the order of the grid, each with what the layout needs to go on from there.
 * 2. All stored nodes from that level down to 16^3 voxels, where they are few enough: a record of one cache line each with the sizes of the
 * children and where they are, so that a look-up decodes nothing above the blocks (8^3). Then the cells of 1 name records and take 8 bytes.
 * 3. Else, in layout fast: of those nodes of 16^3 voxels that refer to blocks elsewhere, the sizes of the children, which a look-up would have to
 * visit to count their bricks. 16 bytes a node, found by its position.
 * 4. In layout fast: a byte for each brick of the dictionary, its attributes. */
#ifndef SVOI_TOP_H
#define SVOI_TOP_H

#include <string.h>

#include "svoi_best.h"

enum { SVOI_TOP_CELLS = 1 << 16, SVOI_RECORDS = 1 << 19, SVOI_RECORD_SHIFT = 8 }; /* at most */
enum { SVOI_RECORD_BITS = 26, SVOI_RECORD_MORE = 2 }; /* of a bit position: beside a turn, and apart from it (four bits would fit, but buckets grow with the tree) */
enum { SVOI_TOP_SHARE = 6 }; /* more cells where there are no records: one for each 64 bytes of the tree */

typedef struct svoi_top_node {
    uint64_t mask;  /* children: 4x4x4 cells in Morton order */
    uint64_t first; /* number of the first child in the next step's nodes, after the last step in the cells */
} svoi_top_node;

typedef struct svoi_top_cell {
    uint64_t place;     /* svoi_top_place, or SVOI_TOP_FULL */
    uint64_t attribute; /* index of the cell's node */
} svoi_top_cell;
#define SVOI_TOP_FULL UINT64_MAX /* inside a full leaf, whose attribute it has */

/* The same where there are records. */
typedef struct svoi_record_step {
    uint64_t mask;
    uint64_t link; /* bits 0..23 as svoi_top_node.first; above them, in the last step, the least attribute of the children */
} svoi_record_step;
typedef struct svoi_record_cell {
    uint32_t child;     /* as svoi_record.child */
    uint32_t attribute; /* less the step's */
} svoi_record_cell;

/* A stored node of 16^3 voxels or more; children by stored octant. */
typedef struct svoi_record {
    uint16_t size[8];  /* attributes of a child (1 where nothing is numbered); 0: no child */
    uint32_t child[8]; /* number of its record, of a block its bit position; shifted by 6, and below the turn from this frame to its own */
    uint8_t mask[8];   /* layout best: child mask of a block */
    uint32_t at;       /* bit position, ascending in a level */
    union {
        uint32_t total; /* layout best, until it is filled: attributes of the subtree */
        uint32_t high;  /* then: four bits a child, what a block's position has above SVOI_RECORD_BITS */
    };
} svoi_record;
#define SVOI_RECORD_FULL UINT32_MAX /* a full leaf */
_Static_assert(sizeof(svoi_record) == 64, "one cache line");

/* Sizes of the children of nodes of 16^3 voxels, where there are no records (layout fast). */
typedef struct svoi_size {
    uint16_t size[8]; /* bits 0..9: attributes of a child, 0: no child; above them in the first two: bits 0..5 and 6..11 of where the node begins */
} svoi_size;
typedef struct svoi_sizes {
    svoi_size *size; /* in order of position; NULL: none */
    uint32_t *bucket; /* number of the first at or behind bit i << shift; the last is their number */
    uint64_t count, capacity, bucket_count;
    uint32_t shift;
} svoi_sizes;
enum { SVOI_SIZE_BITS = 10, SVOI_SIZE_SHIFT = 12 }; /* a size is at most 1 + 8 * 73; the shift at most */

typedef struct svoi_top {
    uint32_t level, shift; /* of the cells; tree_depth - level */
    uint32_t steps;
    uint64_t node_count, cell_count, last_step; /* first node of the last step */
    svoi_top_node *node; /* of all steps, the root first */
    svoi_top_cell *cell; /* NULL: record_cell instead */
    uint64_t *size; /* layout best: attributes of the cell's subtree */
    svoi_record *record; /* NULL: none */
    svoi_record_step *record_step;
    svoi_record_cell *record_cell;
    uint64_t record_count, bottom; /* first record of 16^3 voxels */
    uint32_t *bucket;     /* number of the first of them at or behind bit i << SVOI_RECORD_SHIFT */
    uint64_t bucket_count;
    svoi_sizes sizes;
    uint8_t *brick; /* layout fast, numbered: attributes of each brick of the dictionary; NULL: none */
    uint64_t brick_count;
} svoi_top;

/* Place of a voxel's cell among the 64 of a step: two bits of each coordinate from bit k on. */
static inline uint32_t svoi_step_bit(uint32_t x, uint32_t y, uint32_t z, uint32_t k)
{
    static const uint8_t spread[3][4] = {{0, 1, 8, 9}, {0, 2, 16, 18}, {0, 4, 32, 36}};
    return (uint32_t)spread[0][x >> k & 3] | spread[1][y >> k & 3] | spread[2][z >> k & 3];
}

/* The cell that holds a voxel; NULL: it is empty. */
static inline const svoi_top_cell *svoi_top_find(const svoi_top *t, uint32_t x, uint32_t y, uint32_t z)
{
    uint64_t at = 0;
    for (uint32_t step = t->steps; step != 0;) {
        step--;
        const svoi_top_node *n = &t->node[at];
        uint32_t bit = svoi_step_bit(x, y, z, t->shift + 2 * step);
        if (!(n->mask >> bit & 1)) return NULL;
        at = n->first + (uint64_t)__builtin_popcountll(n->mask & (((uint64_t)1 << bit) - 1));
    }
    return &t->cell[at];
}

/* The record of a node of 16^3 voxels that begins at this bit. */
static inline const svoi_record *svoi_record_find(const svoi_top *t, uint64_t at)
{
    const svoi_record *n = &t->record[t->bucket[at >> SVOI_RECORD_SHIFT]];
    while (n->at != (uint32_t)at) n++;
    return n;
}
/* The sum of those of eight 16-bit numbers that `which` names, `lane` of each: four at once, added in pairs. */
static inline uint32_t svoi_size_sum(const void *sizes, uint32_t which, uint32_t lane)
{
    const uint64_t even = 0x0000ffff0000ffffu, ones = 0x0001000100010001u, bits = 0x0008000400020001u;
    uint64_t s[2];
    memcpy(s, sizes, sizeof s);
    for (uint32_t i = 0; i < 2; i++, which >>= 4) {
        uint64_t m = (which & 15) * ones & bits; /* one bit a lane */
        m = ((m + 0x7fff * ones) >> 15 & ones) * lane;
        s[i] &= m;
        s[i] = (s[i] & even) + (s[i] >> 16 & even);
    }
    s[0] += s[1];
    return (uint32_t)(s[0] + (s[0] >> 32));
}
/* Bit position of a child that is not a record. */
static inline uint64_t svoi_record_at(const svoi_record *n, uint32_t o) { return (uint64_t)(n->high >> 4 * o & 15) << SVOI_RECORD_BITS | n->child[o] >> 6; }
/* Attributes of its children in the stored octants of `which`. */
static inline uint32_t svoi_record_size(const svoi_record *n, uint32_t which) { return svoi_size_sum(n->size, which, 0xffff); }

/* The two words of the first sizes hold its position so. */
static inline uint32_t svoi_size_key(uint64_t at) { return (uint32_t)(at & 63) << SVOI_SIZE_BITS | (uint32_t)(at >> 6 & 63) << (16 + SVOI_SIZE_BITS); }
/* The sizes of a node of 16^3 voxels; NULL: they are not in the table. */
static inline const svoi_size *svoi_sizes_find(const svoi_sizes *t, uint64_t at)
{
    const uint32_t *b = &t->bucket[at >> t->shift], key = svoi_size_key(at);
    for (const svoi_size *n = &t->size[b[0]], *end = &t->size[b[1]]; n != end; n++) {
        uint32_t first;
        memcpy(&first, n->size, sizeof first);
        if ((first & svoi_size_key(~(uint64_t)0)) == key) return n;
    }
    return NULL;
}

/* From the root to the block (8^3) of a voxel, where there are records. */
typedef struct svoi_record_block {
    uint64_t attribute; /* of the block; where it lies in a full leaf, of that */
    uint64_t at;        /* bit position */
    uint32_t mask;
    uint32_t turn;      /* from the grid to the block's frame */
    bool full;
} svoi_record_block;
/* False: it is empty. Attributes only where they are counted. */
static inline bool svoi_records_descend(const svo_view *v, uint32_t x, uint32_t y, uint32_t z, bool count, svoi_record_block *out)
{
    const svoi_top *t = v->top;
    uint64_t at = 0, link = 0;
    for (uint32_t step = t->steps; step != 0;) {
        step--;
        const svoi_record_step *n = &t->record_step[at];
        uint32_t bit = svoi_step_bit(x, y, z, t->shift + 2 * step);
        if (!(n->mask >> bit & 1)) return false;
        link = n->link;
        at = (link & 0xffffff) + (uint64_t)__builtin_popcountll(n->mask & (((uint64_t)1 << bit) - 1));
    }
    const svoi_record_cell *cell = &t->record_cell[at];
    uint32_t child = cell->child, turn = child & 63;
    uint64_t attribute = (link >> 24) + cell->attribute;
    out->mask = 0, out->at = 0;
    for (uint32_t bit = t->shift; bit > 3 && child != SVOI_RECORD_FULL;) {
        bit--;
        const svoi_record *n = &t->record[child >> 6];
        uint32_t octant = (x >> bit & 1) | (y >> bit & 1) << 1 | (z >> bit & 1) << 2, stored = svoi_turn_octant(turn, octant);
        if (n->size[stored] == 0) return false;
        if (count) attribute += (v->lod ? 1 : 0) + svoi_record_size(n, svoi_turn_mask(turn, (1u << octant) - 1));
        child = n->child[stored];
        out->mask = n->mask[stored], out->at = svoi_record_at(n, stored);
        if (child == SVOI_RECORD_FULL) break; /* it has no turn */
        turn = svoi_turn_after(child & 63, turn);
    }
    out->attribute = attribute;
    out->turn = turn;
    out->full = child == SVOI_RECORD_FULL;
    return true;
}

/* Positions have 50 bits here; in layout fast the 8 of the mask are 0. */
enum { SVOI_TOP_PLACE_BITS = 50 };
static inline uint64_t svoi_top_place(svoi_best_node n, uint32_t turn) { return n.at << 14 | n.mask << 6 | turn; }
static inline uint32_t svoi_top_turn(uint64_t place) { return place & 63; }
static inline svoi_best_node svoi_top_node_at(uint64_t place) { return (svoi_best_node){place >> 14, place >> 6 & 0xff}; }

/* At most `cells` of them (more of a large tree that has no records) and at most `records`, where there are as few. NULL when the octree has no upper level worth it, or there is no memory. */
svoi_top *svoi_top_make(const svo_view *v, uint64_t cells, uint64_t records, const svo_allocator *a);
/* Table 2; none where the nodes are too many, or without memory. */
/* With cells of this level, are there nodes for records, at most so many, in a tree whose positions they can hold? */
bool svoi_records_fit(const svo_view *v, uint32_t level, uint64_t most);
void svoi_records_make(svoi_top *t, const svo_view *v, const svo_allocator *a); /* where they fit; without memory there are none */
void svoi_records_free(svoi_top *t, const svo_allocator *a);
/* Table 3; none where it would be larger than the tree, or without memory. */
void svoi_sizes_make(svoi_sizes *t, const svo_view *v, const svo_allocator *a);
void svoi_sizes_free(svoi_sizes *t, const svo_allocator *a);
void svoi_top_free(svoi_top *t, const svo_allocator *a);

#endif
