/* Internal to libsvo: the 48 symmetries of the cube, and an octree DAG in which subtrees that are equal up to one of
 * them are stored once. Not installed.
 *
 * A "turn" g = 8 p + f maps octants to octants: it permutes the axes by p (0..5) and then mirrors the axes whose bits are
 * set in f (0..7). Turn 0 is the identity, turns 0..7 are the mirrors, and a brick of 4x4x4 voxels is turned by doing the
 * same to its octants and to the voxels inside them. A reference (number, turn) means the stored subtree `number`, turned: what
 * is octant s of the stored node is octant turn(s) of the subtree that is meant. Layout 3 stores these turns; layout 2 their inverses, from
 * the frame of the node that refers to that of the stored one (docs/format/svdag.md, "Turns"). */
#ifndef SVOI_SYMMETRY_H
#define SVOI_SYMMETRY_H

#include "svoi_dag.h"

enum { SVOI_TURNS = 48, SVOI_SUBGROUPS = 98 }; /* the group of 48 has 98 subgroups */

/* How many of the turns a DAG may use; the first n are a group for these n only. */
typedef enum svoi_group { SVOI_IDENTITY = 1, SVOI_MIRRORS = 8, SVOI_ALL = 48 } svoi_group;

typedef struct svoi_turn_table {
    uint8_t octant[SVOI_TURNS][8]; /* where an octant goes */
    uint8_t axes_after[6][6];      /* product of two permutations of axes */
    uint8_t axes_inverse[6];
    uint8_t axes_mask[6][256]; /* where the bits of a child mask go */
    uint8_t mirror_mask[8][256];
} svoi_turn_table;
extern const svoi_turn_table svoi_turns;

static inline uint32_t svoi_turn_octant(uint32_t turn, uint32_t octant) { return svoi_turns.octant[turn][octant]; }
/* The turn that does b and then a. */
static inline uint32_t svoi_turn_after(uint32_t a, uint32_t b)
{
    return (uint32_t)svoi_turns.axes_after[a >> 3][b >> 3] << 3 | svoi_turns.octant[a][b & 7];
}
static inline uint32_t svoi_turn_inverse(uint32_t turn)
{
    uint32_t back = (uint32_t)svoi_turns.axes_inverse[turn >> 3] << 3;
    return back | svoi_turns.octant[back][turn & 7];
}
static inline uint32_t svoi_turn_mask(uint32_t turn, uint32_t mask)
{
    return svoi_turns.mirror_mask[turn & 7][svoi_turns.axes_mask[turn >> 3][mask]];
}

/* Exchange the bits of `mask` with those `shift` places above. */
static inline uint64_t svoi_exchange(uint64_t bits, uint32_t shift, uint64_t mask)
{
    uint64_t x = (bits ^ bits >> shift) & mask;
    return bits ^ x ^ x << shift;
}
/* Bricks mirrored along an axis, and with two axes exchanged: both Morton bits of an axis at once. */
static inline uint64_t svoi_brick_mirror_x(uint64_t b) { return svoi_exchange(svoi_exchange(b, 1, 0x5555555555555555u), 8, 0x00ff00ff00ff00ffu); }
static inline uint64_t svoi_brick_mirror_y(uint64_t b) { return svoi_exchange(svoi_exchange(b, 2, 0x3333333333333333u), 16, 0x0000ffff0000ffffu); }
static inline uint64_t svoi_brick_mirror_z(uint64_t b) { return svoi_exchange(svoi_exchange(b, 4, 0x0f0f0f0f0f0f0f0fu), 32, 0x00000000ffffffffu); }
static inline uint64_t svoi_brick_exchange_xy(uint64_t b) { return svoi_exchange(svoi_exchange(b, 1, 0x2222222222222222u), 8, 0x0000ff000000ff00u); }
static inline uint64_t svoi_brick_exchange_yz(uint64_t b) { return svoi_exchange(svoi_exchange(b, 2, 0x0c0c0c0c0c0c0c0cu), 16, 0x00000000ffff0000u); }

/* Octant by octant: sixteen loads that wait for nothing, where exchanges would be a long chain or branches that nobody can predict. */
static inline uint64_t svoi_turn_brick(uint32_t turn, uint64_t b)
{
    const uint8_t *axes = svoi_turns.axes_mask[turn >> 3], *mirror = svoi_turns.mirror_mask[turn & 7], *octant = svoi_turns.octant[turn];
    uint64_t out = 0;
    for (uint32_t o = 0; o < 8; o++) out |= (uint64_t)mirror[axes[b >> 8 * o & 0xff]] << 8 * octant[o];
    return out;
}

/* svo_brick_voxel of a brick that lies turned: `turn` takes it from the grid to `stored`; b is the voxel's bit in the grid. */
static inline uint64_t svoi_turned_voxel(bool lod, uint64_t stored, uint32_t turn, uint64_t i, uint32_t b)
{
    const uint64_t ones = 0x0101010101010101u;
    uint32_t own = 8 * svoi_turn_octant(turn, b >> 3);
    uint64_t before = svoi_turn_mask(turn, (1u << (b >> 3)) - 1) * ones & 0x8040201008040201u; /* octants before b's own ... */
    before = ((before + 0x7f * ones) >> 7 & ones) * 255;                                      /* ... whole bytes of them */
    uint64_t inside = (uint64_t)svoi_turn_mask(turn, (1u << (b & 7)) - 1) << own;
    if (lod) i += 1 + (uint64_t)__builtin_popcountll(svo_brick_octants(stored) & (before | (uint64_t)0xff << own));
    return i + (uint64_t)__builtin_popcountll(stored & (before | inside));
}

/* The smallest brick that turns of the group make of `bits`; *turn takes it back to `bits` (the least such turn), bit g
 * of *stabilizer is set when turn g leaves the result as it is. */
uint64_t svoi_brick_canonical(svoi_group group, uint64_t bits, uint32_t *turn, uint64_t *stabilizer);

/* --- the DAG ----------------------------------------------------------------------------------------------------- */

/* Stored nodes of a level. Bricks (level brick_level) have `bits`; other levels have items: a head (bits 0..7 child mask,
 * bits 8..15 the children among them that are full leaves) and a number for each child that is not full, in octant
 * order, with its turn at the same place of `turn`. Turns are the least of those that mean the same. Numbers follow first
 * appearance in the octree's depth-first order. */
typedef struct svoi_symlevel {
    uint64_t count;
    uint64_t *bits;
    uint32_t *items;
    uint8_t *turn;
    uint32_t *start;     /* of a node in items and turn */
    uint64_t *size;      /* attributes of a subtree; bricks: svoi_brick_size */
    uint32_t *uses;      /* references in stored nodes, the root's included; UINT32_MAX means that many or more */
    uint8_t *stabilizer; /* index in svoi_symdag.subgroup */
    uint64_t capacity, item_count, item_capacity;
} svoi_symlevel;

typedef struct svoi_symdag {
    const svo_allocator *a;
    svoi_group group;
    bool lod, brick_lod; /* attributes of inner nodes: above bricks, of bricks and inside */
    uint32_t brick_level;
    uint32_t root, root_turn; /* the octree is root_turn applied to the stored root */
    svoi_symlevel level[SVO_MAX_DEPTH];
    uint32_t subgroup_count;
    uint64_t subgroup[SVOI_SUBGROUPS];            /* bit g: turn g is in it */
    uint8_t least[SVOI_SUBGROUPS][SVOI_TURNS];    /* least turn g s with s in the subgroup */
} svoi_symdag;

static inline uint32_t svoi_head_mask(uint32_t head) { return head & 0xff; }
static inline uint32_t svoi_head_full(uint32_t head) { return head >> 8 & 0xff; }
/* Children that have a reference. */
static inline uint32_t svoi_head_refs(uint32_t head) { return head & ~(head >> 8) & 0xff; }

/* Turns that mean the same for this node as `turn` are turn * s, s in its stabilizer. */
static inline uint64_t svoi_symdag_stabilizer(const svoi_symdag *d, uint32_t level, uint32_t number)
{
    return d->subgroup[d->level[level].stabilizer[number]];
}
static inline uint64_t svoi_symdag_size(const svoi_symdag *d, uint32_t level, uint32_t number)
{
    return level == d->brick_level ? svoi_brick_size(d->brick_lod, d->level[level].bits[number]) : d->level[level].size[number];
}

/* Merge what is equal under the group, bottom-up. `nodes` (levels 0 .. brick_level - 1) and `bricks` are the builder's
 * tables and are freed on the way, also on failure; `root` is a number in level 0 (or of a brick). The result does not
 * depend on threads. SVO_OUT_OF_MEMORY or SVO_LIMIT without a message. */
svo_result svoi_symdag_make(svoi_symdag *d, svoi_nodes *nodes, svoi_bricks *bricks, uint32_t brick_level, uint32_t root, bool lod, bool brick_lod,
                            svoi_group group, uint32_t threads, const svo_allocator *a);
void svoi_symdag_free_level(svoi_symdag *d, uint32_t level);
void svoi_symdag_free(svoi_symdag *d);

#endif
