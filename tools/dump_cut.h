/* An octree cut at a level: its nodes from the root down to there, depth first, leaves with their attributes. Pages and exports are made of it. */
#ifndef DUMP_CUT_H
#define DUMP_CUT_H

#include "svo_view.h"

/* A node of the cut. `values[i]` is the value of the view's channel i (of a constant channel too); NULL for inner nodes. */
typedef struct dump_cut_node {
    uint32_t level;      /* 0 .. the cut's */
    uint32_t cell[3];    /* at that level */
    uint8_t mask;        /* of children; 0 for leaves */
    bool leaf;           /* at the cut's level, or a full leaf above it */
    const uint8_t *const *values;
} dump_cut_node;

/* SVO_CANCELLED from fn stops the walk and is returned without a message. */
typedef svo_result (*dump_cut_fn)(void *user, const dump_cut_node *node, svo_error *err);

/* The tree's depth T is v->tree_depth (2 where the depth is less; cells are of the same size there), level <= T. Nodes of levels above the cut's come in depth-first order,
 * parents before children, so that those of one level are in Morton order. Leaves above the finest level have the averages that are stored, or, where the octree has none, those of the
 * voxels below, computed. No memory of its own. An empty octree has no node. */
svo_result dump_cut(const svo_view *v, uint32_t level, dump_cut_fn fn, void *user, svo_error *err);

#endif
