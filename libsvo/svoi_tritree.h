/* Internal to libsvo: a bounding volume hierarchy over items in Morton order. It is a complete binary tree over leaves of four items, so
 * that it needs no pointers and building is a sort. */
#ifndef SVOI_TRITREE_H
#define SVOI_TRITREE_H

#include "svo_alloc.h"

enum { SVOI_TREE_LEAF = 4, SVOI_TREE_LEVELS = 32, SVOI_TREE_STACK = 2 * SVOI_TREE_LEVELS };

typedef struct svoi_box { int32_t low[3], high[3]; } svoi_box;

typedef struct svoi_tree {
    const svo_allocator *allocator;
    uint64_t count, node_count;
    uint32_t *order;  /* items in the order of the leaves */
    svoi_box *box;    /* nodes, level by level from the leaves up */
    uint32_t levels;  /* 0 when there are no items; the root is the only node of level levels - 1 */
    uint64_t first[SVOI_TREE_LEVELS + 1], size[SVOI_TREE_LEVELS + 1]; /* nodes of a level */
} svoi_tree;

/* A node on a traversal's stack. */
typedef struct svoi_tree_node { uint32_t level; uint32_t at; } svoi_tree_node;

/* Sort `order` (count items, taken over, also on failure) by keys[item] (below 2^42) and make the boxes. */
typedef void (*svoi_box_fn)(void *user, uint32_t item, svoi_box *box);
bool svoi_tree_build(svoi_tree *t, uint32_t *order, uint64_t count, const uint64_t *keys, svoi_box_fn box, void *user, const svo_allocator *a);
void svoi_tree_free(svoi_tree *t);

/* Of any tree whose levels are numbered so; size[l]: nodes of level l, `count` items in all. */
static inline void svoi_leaf_range(uint64_t count, svoi_tree_node leaf, uint64_t *begin, uint64_t *end)
{
    *begin = (uint64_t)leaf.at * SVOI_TREE_LEAF;
    *end = *begin + SVOI_TREE_LEAF < count ? *begin + SVOI_TREE_LEAF : count;
}
static inline uint32_t svoi_two_below(const uint64_t *size, svoi_tree_node n, svoi_tree_node out[2])
{
    out[0].level = out[1].level = n.level - 1;
    out[0].at = 2 * n.at;
    out[1].at = 2 * n.at + 1;
    return (uint64_t)out[1].at < size[n.level - 1] ? 2 : 1;
}

static inline const svoi_box *svoi_tree_box(const svoi_tree *t, svoi_tree_node n) { return &t->box[t->first[n.level] + n.at]; }
/* Items of a leaf: order[begin .. end). */
static inline void svoi_tree_items(const svoi_tree *t, svoi_tree_node leaf, uint64_t *begin, uint64_t *end)
{
    svoi_leaf_range(t->count, leaf, begin, end);
}
/* Children of an inner node; returns 1 or 2. */
static inline uint32_t svoi_tree_children(const svoi_tree *t, svoi_tree_node n, svoi_tree_node out[2])
{
    return svoi_two_below(t->size, n, out);
}

/* Morton key of a lattice point, 14 bits an axis; `shift` brings the grid's lattice to 14 bits. */
uint64_t svoi_tree_key(const int32_t p[3], uint32_t lattice_bits);

#endif
