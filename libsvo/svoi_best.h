/* Internal to libsvo: layout 3 ("best") of a packed octree, docs/format/svdag.md. Not installed.
 *
 * Below, a "block" is a node of level T-3: 8x8x8 voxels, whose children are bricks of 4x4x4. Nodes with one parent are
 * written inside it, depth first; nodes with more than one are in a pool a level. Everything inside a pool's entry is turned
 * into the frame of that entry, so only references to pools and to bricks of the dictionary have turns. */
#ifndef SVOI_BEST_H
#define SVOI_BEST_H

#include "svoi_bits.h"
#include "svoi_huffman.h"
#include "svoi_symmetry.h"

enum {
    SVOI_CLASSES = 32,     /* at most; class 0: none yet, the last one: a brick that is written out */
    SVOI_CORNERS = 40,     /* contexts of an octant in its parent's mask, at most */
    SVOI_ID_LONGEST = 24,  /* bits of a brick's number in its class */
    SVOI_CLASS_FAST = 7, SVOI_TURN_FAST = 6, SVOI_MASK_FAST = 8, SVOI_ID_FAST = 8,
    SVOI_TIERS = 4
};

/* An octant of a node as seen from it: `turn` takes it to octant 0 and makes the mask the least that is then possible
 * (the least such turn); `corner` numbers these masks, ascending. */
typedef struct svoi_corner { uint8_t turn, corner; } svoi_corner;
typedef struct svoi_corners {
    svoi_corner of[256][8];
    uint8_t mask[SVOI_CORNERS]; /* of a corner */
    uint32_t count;
} svoi_corners;
void svoi_corners_make(svoi_corners *c);

/* The contexts in which symbols are coded, in the order of the file. */
typedef enum svoi_context_kind {
    SVOI_CONTEXT_CLASS,       /* class of a brick, after that of the brick before */
    SVOI_CONTEXT_CLASS_FIRST, /* of the first brick of a block, by corner */
    SVOI_CONTEXT_TURN,        /* turn of a brick, after that of the brick before that has one */
    SVOI_CONTEXT_TURN_FIRST,  /* of the first one in a block, seen from its octant, by corner */
    SVOI_CONTEXT_MASK,        /* child mask of a block inside its parent, seen from its octant, by corner */
    SVOI_CONTEXT_OCTANTS,     /* octants of a brick that is written out */
    SVOI_CONTEXT_OCTANT,      /* voxels of such an octant, seen from it, by corner */
    SVOI_CONTEXT_KINDS
} svoi_context_kind;

/* Where the contexts of each kind begin in one array of all, and how many symbols each of them has. */
typedef struct svoi_contexts {
    uint32_t first[SVOI_CONTEXT_KINDS + 1];
    uint32_t symbols[SVOI_CONTEXT_KINDS];
} svoi_contexts;
enum { SVOI_CONTEXTS = SVOI_CLASSES + SVOI_CORNERS + SVOI_TURNS + SVOI_CORNERS + SVOI_CORNERS + 1 + SVOI_CORNERS };
svoi_contexts svoi_contexts_make(uint32_t classes, uint32_t corners);

/* --- the head of a node above the blocks ------------------------------------------------------------------------- */

/* Chunk LVLS: one record a level 0 .. T-3. */
typedef struct svoi_best_level {
    uint64_t first;   /* byte of the stream at which the level's pool begins */
    uint64_t entries; /* of the pool */
    uint64_t nodes;   /* stored in all, with those inside others */
    uint8_t tier[SVOI_TIERS]; /* bits of a reference into this level's pool */
    uint32_t zero;
} svoi_best_level;
_Static_assert(sizeof(svoi_best_level) == SVO_BEST_LEVEL_BYTES, "a record of the file");

/* Bits of a field that holds the width of others, in a node `above` levels above the blocks: there, blocks and their
 * sizes are small. */
static inline uint32_t svoi_best_field(uint32_t above) { return above == 1 ? 4 : 6; }

/* What is made of the file's chunks once, so that it can be traversed; a few hundred KiB, whatever the file holds. */
typedef struct svoi_best {
    const uint8_t *stream;
    uint64_t stream_bits; /* without its guard */
    const svoi_best_level *level;
    const uint64_t *dictionary;
    uint32_t block_level; /* T - 3 */
    bool lod, brick_lod, numbered, solid; /* brick_lod: inside bricks too; solid: nodes may have full leaves */
    uint32_t root_turn, classes;
    uint64_t attribute_count;
    uint32_t class_first[SVOI_CLASSES]; /* in the dictionary */
    uint32_t class_count[SVOI_CLASSES];
    svoi_corners corners;
    svoi_contexts contexts;
    bool used[SVOI_CONTEXTS];
    uint32_t id_below[SVOI_CLASSES][SVOI_ID_LONGEST + 1]; /* 24 bits below this hold a number of this length or shorter */
    int32_t id_rank[SVOI_CLASSES][SVOI_ID_LONGEST + 1];
    uint8_t id_fast[SVOI_CLASSES][1 << SVOI_ID_FAST]; /* length by the first bits; SVOI_ID_SLOW: longer */
    uint16_t class_fast[SVOI_CLASSES + SVOI_CORNERS][1 << SVOI_CLASS_FAST];
    uint16_t turn_fast[SVOI_TURNS + SVOI_CORNERS][1 << SVOI_TURN_FAST];
    uint16_t mask_fast[SVOI_CORNERS][1 << SVOI_MASK_FAST];
    uint16_t octants_fast[1][1 << SVOI_MASK_FAST];
    uint16_t octant_fast[SVOI_CORNERS][1 << SVOI_MASK_FAST];
    svoi_huffman code[SVOI_CONTEXTS];
} svoi_best;
enum { SVOI_ID_SLOW = 0xff };

/* Tables from the chunks that the view names; checks the chunks' own form (the stream: svoi_best_validate). */
svo_result svoi_best_open(const svo_view *v, const svo_allocator *a, svoi_best **out, svo_error *err);
void svoi_best_close(svoi_best *b, const svo_allocator *a);

/* --- reading ----------------------------------------------------------------------------------------------------- */

/* A node in the stream: the first bit after its mask, and the mask, in the frame of the pool's entry it lies in. */
typedef struct svoi_best_node {
    uint64_t at;
    uint32_t mask;
} svoi_best_node;

/* Cursors hold both in one number. */
static inline uint64_t svoi_best_pack(svoi_best_node n) { return (uint64_t)n.mask << 56 | n.at; }
static inline svoi_best_node svoi_best_unpack(uint64_t packed)
{
    svoi_best_node n = {packed & (((uint64_t)1 << 56) - 1), (uint32_t)(packed >> 56)};
    return n;
}

/* The fields of a node above the blocks. Slots count the children that are no full leaves, in octant order. */
typedef struct svoi_best_head {
    uint32_t full, refs;    /* of the mask: full leaves, and the others */
    uint32_t shared;        /* bit (slots - 1 - slot): the child is in a pool */
    uint32_t slots, shared_count;
    uint32_t skip_width, size_width;
    uint64_t skips, sizes, tags, values, inside; /* first bits of the fields, and of what is written of the children */
} svoi_best_head;
svoi_best_head svoi_best_read_head(const svoi_best *b, uint32_t level, svoi_best_node n);

/* Child of a node above the blocks, no full leaf; *turn takes its frame to that of the node. */
svoi_best_node svoi_best_child(const svoi_best *b, uint32_t level, svoi_best_node n, const svoi_best_head *h, uint32_t octant, uint32_t *turn);

/* The bricks of a block by octant of its frame: a brick is `turn` applied to bits. Full leaves: bits ~0. */
typedef struct svoi_best_block {
    uint64_t bits[8];
    uint8_t turn[8];
    uint32_t full;
} svoi_best_block;
/* All of them, or just one octant. */
void svoi_best_read_block(const svoi_best *b, svoi_best_node n, svoi_best_block *out);
void svoi_best_read_brick(const svoi_best *b, svoi_best_node n, uint32_t octant, svoi_best_block *out);
/* The same with checks: false when it is no block; *end is the bit after it. */
bool svoi_best_check_block(const svoi_best *b, svoi_best_node n, svoi_best_block *out, uint64_t *end);
/* Mask of a block that is written inside its parent, from its octant there, with checks: false when it is none. */
bool svoi_best_check_mask(const svoi_best *b, uint32_t parent_mask, uint32_t octant, uint64_t *at, uint32_t *mask);

/* --- entries of pools by number ---------------------------------------------------------------------------------- */

/* For passes over all stored nodes: which entry a reference means. */
typedef struct svoi_best_pool {
    uint64_t bytes, entries;
    uint64_t *bit;    /* set for a byte of the pool at which an entry begins */
    uint64_t *before; /* entries in the words of `bit` before this one */
    uint64_t words;
    uint64_t *size, *times; /* the pass's own, of an entry */
} svoi_best_pool;
bool svoi_best_pool_alloc(svoi_best_pool *p, const svo_allocator *a); /* bytes is set; false: out of memory */
void svoi_best_pool_free(svoi_best_pool *p, const svo_allocator *a);
static inline void svoi_best_pool_begin(svoi_best_pool *p, uint64_t byte) { p->bit[byte / 64] |= (uint64_t)1 << byte % 64; }
void svoi_best_pool_end(svoi_best_pool *p); /* all entries have begun */
/* Number of the entry that begins at this byte; UINT64_MAX: none. */
static inline uint64_t svoi_best_entry_at(const svoi_best_pool *p, uint64_t byte)
{
    if (byte >= p->bytes || !(p->bit[byte / 64] >> byte % 64 & 1)) return UINT64_MAX;
    return p->before[byte / 64] + (uint64_t)__builtin_popcountll(p->bit[byte / 64] & (((uint64_t)1 << byte % 64) - 1));
}
static inline uint64_t svoi_best_entry_of(const svoi_best *b, const svoi_best_pool *pools, uint32_t level, svoi_best_node n)
{
    return svoi_best_entry_at(&pools[level], n.at / 8 - 1 - b->level[level].first);
}

/* Box of all finest voxels, both ends inclusive. False: out of memory. */
bool svoi_best_bounds(const svo_view *v, const svo_allocator *a, uint32_t low[3], uint32_t high[3]);

/* Rules DAG-12.. of the stream; counts octree nodes. */
svo_result svoi_best_validate(const svo_view *v, const svo_allocator *a, svo_rules *rules, svo_error *err);

#endif
