/* Internal to libsvo: what rays remember of layout 2 ("fast"). Not installed.
 *
 * A node is kept as it stands in the world, so that a step to a child is one look into an array: keys are a place in the
 * string of bits together with the product of turns that leads there. Children are found when they are first asked for;
 * so are the attributes that come before them, which only hits need. Every level above the blocks has slots of its own:
 * of the nodes on the way down to a cell there is one a level, so none of them can drive out another, and the slots
 * themselves can be kept on the traversal's stack. */
#ifndef SVOI_RAY_FAST_H
#define SVOI_RAY_FAST_H

#include "svoi_fast.h"

enum {
    SVOI_KEPT_BLOCK_BITS = 7, SVOI_KEPT_NEAR_BITS = 5, SVOI_KEPT_FAR_BITS = 2, /* slots: blocks, 16^3 and 32^3, all above */
    SVOI_KEPT_BLOCKS = 1 << SVOI_KEPT_BLOCK_BITS,
    SVOI_KEPT_NODES = (2 << SVOI_KEPT_NEAR_BITS) + (SVO_MAX_DEPTH << SVOI_KEPT_FAR_BITS)
};

typedef struct svoi_kept_key {
    const svo_view *owner; /* NULL: nothing */
    uint64_t place;        /* bit position and turn */
} svoi_kept_key;

/* 8^3 voxels. Octants are those of the world. */
typedef struct svoi_kept_block {
    svoi_fast_block block;
    uint32_t mask; /* full leaves in bits 8..15 */
    uint8_t have, numbered; /* children whose brick, whose `before` is known */
    uint16_t before[8];     /* attributes from the node's own to the child's */
    uint64_t brick[8];
} svoi_kept_block;

/* 16^3 voxels and more. */
typedef struct svoi_kept_node {
    svoi_fast_node node;
    uint32_t mask;
    uint8_t have, numbered;
    uint8_t turn[8];
    uint64_t child[8], before[8];
} svoi_kept_node;

typedef struct svoi_kept {
    bool ready, few; /* ready: keys are set; few: one slot a level, for few rays, which would not pay for clearing more */
    svoi_kept_key block_key[SVOI_KEPT_BLOCKS], node_key[SVOI_KEPT_NODES];
    svoi_kept_block block[SVOI_KEPT_BLOCKS];
    svoi_kept_node node[SVOI_KEPT_NODES];
} svoi_kept;

static inline void svoi_kept_clear(svoi_kept *k)
{
    memset(k->block_key, 0, k->few ? sizeof *k->block_key : sizeof k->block_key);
    memset(k->node_key, 0, k->few ? SVO_MAX_DEPTH * sizeof *k->node_key : sizeof k->node_key);
    k->ready = true;
}

static inline uint64_t svoi_kept_hash(uint64_t place) { return place * 0x9e3779b97f4a7c15u; }

/* Slot of a block, read if it is not there. */
static inline uint32_t svoi_keep_block(svoi_kept *k, const svo_view *v, uint64_t at, uint32_t turn)
{
    uint64_t place = at << 6 | turn;
    uint32_t slot = k->few ? 0 : (uint32_t)(svoi_kept_hash(place) >> (64 - SVOI_KEPT_BLOCK_BITS));
    if (k->block_key[slot].place == place && k->block_key[slot].owner == v) return slot;
    svoi_kept_block *b = &k->block[slot];
    b->block = svoi_fast_open_block(v, at);
    b->have = b->numbered = 0;
    uint32_t back = svoi_turn_inverse(turn);
    b->mask = svoi_turn_mask(back, b->block.mask);
    if (v->fast.full) b->mask |= svoi_turn_mask(back, b->block.mask & ~b->block.refs) << 8;
    k->block_key[slot] = (svoi_kept_key){v, place};
    return slot;
}

/* Slot of a node of a level above the blocks. */
static inline uint32_t svoi_keep_node(svoi_kept *k, const svo_view *v, uint32_t level, uint64_t at, uint32_t turn)
{
    uint64_t place = at << 6 | turn;
    uint32_t above = v->brick_level - 2 - level, slot = above; /* above nodes of 16^3 */
    if (!k->few && above < 2) slot = (above << SVOI_KEPT_NEAR_BITS) + (uint32_t)(svoi_kept_hash(place) >> (64 - SVOI_KEPT_NEAR_BITS));
    else if (!k->few)
        slot = (2u << SVOI_KEPT_NEAR_BITS) + (above << SVOI_KEPT_FAR_BITS) + (uint32_t)(svoi_kept_hash(place) >> (64 - SVOI_KEPT_FAR_BITS));
    if (k->node_key[slot].place == place && k->node_key[slot].owner == v) return slot;
    svoi_kept_node *n = &k->node[slot];
    n->node = svoi_fast_open(v, level, at);
    n->have = n->numbered = 0;
    uint32_t back = svoi_turn_inverse(turn);
    n->mask = svoi_turn_mask(back, n->node.mask);
    if (v->fast.full) n->mask |= svoi_turn_mask(back, n->node.mask & ~n->node.refs) << 8;
    k->node_key[slot] = (svoi_kept_key){v, place};
    return slot;
}

/* Brick of a child that is no full leaf. */
static inline uint64_t svoi_kept_brick(svoi_kept *k, const svo_view *v, uint32_t slot, uint32_t octant)
{
    svoi_kept_block *b = &k->block[slot];
    if (!(b->have >> octant & 1)) {
        uint32_t turn = k->block_key[slot].place & 63, change;
        uint64_t brick = svoi_fast_brick(v, &b->block, svoi_fast_slot(b->block.refs, svoi_turn_octant(turn, octant)), &change);
        b->brick[octant] = svoi_turn_brick(svoi_turn_inverse(svoi_turn_after(change, turn)), brick);
        b->have |= (uint8_t)(1u << octant);
    }
    return b->brick[octant];
}

/* Where a child that is no full leaf begins; *turn from the world to its frame. */
static inline uint64_t svoi_kept_child(svoi_kept *k, const svo_view *v, uint32_t level, uint32_t slot, uint32_t octant, uint32_t *turn)
{
    svoi_kept_node *n = &k->node[slot];
    if (!(n->have >> octant & 1)) {
        uint32_t t = k->node_key[slot].place & 63;
        n->child[octant] = svoi_fast_find(v, level, &n->node, svoi_fast_slot(n->node.refs, svoi_turn_octant(t, octant)), &t);
        n->turn[octant] = (uint8_t)t;
        n->have |= (uint8_t)(1u << octant);
    }
    *turn = n->turn[octant];
    return n->child[octant];
}

/* Attributes from a node's own to its child's. */
static inline uint64_t svoi_kept_block_before(svoi_kept *k, const svo_view *v, uint32_t slot, uint32_t octant)
{
    svoi_kept_block *b = &k->block[slot];
    if (!(b->numbered >> octant & 1)) {
        uint64_t end;
        uint32_t earlier = svoi_turn_mask(k->block_key[slot].place & 63, (1u << octant) - 1);
        b->before[octant] = (uint16_t)((v->lod ? 1 : 0) + svoi_fast_bricks_size(v, &b->block, earlier, &end)); /* 1 + 7 * 73 at most */
        b->numbered |= (uint8_t)(1u << octant);
    }
    return b->before[octant];
}
static inline uint64_t svoi_kept_before(svoi_kept *k, const svo_view *v, uint32_t level, uint32_t slot, uint32_t octant)
{
    svoi_kept_node *n = &k->node[slot];
    if (!(n->numbered >> octant & 1)) {
        uint32_t earlier = svoi_turn_mask(k->node_key[slot].place & 63, (1u << octant) - 1);
        n->before[octant] = (v->lod ? 1 : 0) + svoi_fast_children_size(v, level, k->node_key[slot].place >> 6, &n->node, earlier);
        n->numbered |= (uint8_t)(1u << octant);
    }
    return n->before[octant];
}

#endif
