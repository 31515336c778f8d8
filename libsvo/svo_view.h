/* A packed octree as it lies in memory or in a mapped .svdag: read-only, traversed in place.
 *
 * Geometry, layout 1 ("plain"). Let T = max(depth, 2). Levels 0 .. T-3 are arrays of 32-bit words holding nodes; level
 * T-2 is an array of 64-bit bricks, each a 4x4x4 block of finest voxels whose bit 8a+b is child b of octant a (Morton
 * order). A node at word w of its level is
 *     words[w]                      bits 0..7 child mask; bits 8..15 which of these children are full leaves (reserved:
 *                                   0 in every file so far); other bits 0
 *     words[w+1 .. w+r]             r references, one for each child that is no full leaf, in octant order: a word index of
 *                                   a node of the next level, or a brick index when the next level is T-2
 *     words[w+1+r ..]               k-1 attribute offsets of children 1..k-1 of k = popcount(mask), each offset_words
 *                                   words (little end first); none when attributes are not numbered
 * Identical subtrees are stored once. A reference goes to the next level only, so there are no cycles.
 * An octree of depth < 2 lies in the low corner of a tree of depth 2; the levels above its root are virtual.
 *
 * Everything else reads a packed octree through svo_view_root, svo_view_mask, svo_view_child and svo_view_brick, which hide
 * the layout. A full leaf stands for a whole subtree of finest voxels that have one attribute together; the accessors show
 * it as if it were expanded, and svo_view_full tells.
 *
 * Attributes are numbered in depth-first order of the octree (Dado et al. 2016, section 2.4.1), children in the order of
 * their octants in the grid: also where a layout stores subtrees mirrored or turned, so that the index of a node is the
 * same in every layout and so are the attributes as they are stored. (Sizes of subtrees do not change under symmetry, so
 * prefix sums over them do in any order.) With lod, every node counts: a node at index i has its first child at i + 1.
 * Without, only finest voxels count and the first child is at i. The offset of a later child is its index minus its
 * parent's. Inside a brick the same rule holds (brick, octant, voxels) and the offsets follow from bit counts:
 * svo_brick_octant, svo_brick_voxel. Where no channel varies, nothing is numbered and no index means anything.
 *
 * Averaged views (lod, but cheaper): bricks and their octants have no entries; what they have are the averages of their finest
 * voxels' values, which lie one behind another. The attribute of such a node is the index of its first voxel with the number of
 * voxels less 1 above it (svo_average_of), so that a node's attribute is one number in all views: svo_view_attribute takes it. */
#ifndef SVO_VIEW_H
#define SVO_VIEW_H

#include "svo_channel.h"
#include "svo_palette.h"
#include "svo_stream.h"
#include "svo_rules.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum svo_layout { SVO_LAYOUT_PLAIN = 1, SVO_LAYOUT_FAST = 2, SVO_LAYOUT_BEST = 3 } svo_layout;

typedef struct svo_view_level {
    const uint32_t *words;
    uint64_t word_count, node_count;
    uint32_t offset_words; /* 1 or 2; 0 when attributes are not numbered */
} svo_view_level;

enum { SVO_BEST_LEVEL_BYTES = 32 };

/* Layout 2 ("fast"): subtrees that are equal under any of the 48 symmetries of the cube are stored once, nodes with one
 * parent inside it, in depth-first order, nodes with several in a pool of their level, most used first, and bricks once
 * under all symmetries, named by codes of few widths. Everything but the dictionary of bricks is one string of bits; see
 * docs/format/svdag.md. Levels 0 .. brick_level - 1. */
typedef struct svo_view_fast_level {
    uint64_t begin, end;   /* of the pool, as bit positions that are multiples of 8; the root is alone in that of level 0 */
    uint64_t pool_count;   /* nodes in the pool */
    uint64_t node_count;   /* nodes stored, in the pool or inside others */
    uint8_t code_bits[4];  /* reference of class 1..3 to the pool of the next level; [0] unused */
    uint8_t skip_bits;     /* position of a node that is stored inside; 0 above the bricks' level: walked over */
    uint8_t size_bits;     /* attributes of a child; 0 where unnumbered, and in the last two levels, where bricks are counted */
} svo_view_fast_level;

enum { SVO_FAST_LITERAL = 64 }; /* id_bits of a brick that is written out */
typedef struct svo_view_fast {
    const uint8_t *tree;
    uint64_t tree_bytes;      /* the last 8 are padding */
    bool full;                /* nodes say which children are full leaves */
    uint8_t code_bits[2][4];  /* a brick's code in a block of mode 0, 1 with tag 0..3: a number in the dictionary ... */
    uint8_t id_bits[2][4];    /* ... of so many bits, and above it an index of turn[] */
    uint8_t turn[48];         /* turns between the frame of a block's bricks and a brick's, frequent ones first; turn[0] is none */
    svo_view_fast_level level[SVO_MAX_DEPTH];
} svo_view_fast;

/* How a channel's values are stored. */
typedef enum svo_encoding {
    SVO_ENCODING_CONSTANT = 0, /* svo_channel.value */
    SVO_ENCODING_RAW = 1,      /* attribute_count * stride bytes */
    SVO_ENCODING_BLOCKS = 2,   /* blocks over a value table, see svo_palette.h */
    SVO_ENCODING_LONG_BLOCKS = 3 /* blocks of any length over a value table, see svo_algorithm1.h */
} svo_encoding;

typedef struct svo_view_channel {
    svo_channel channel;
    svo_encoding encoding;
    const uint8_t *raw; /* RAW */
    /* BLOCKS */
    const uint8_t *table; /* table_count values of the channel's kind */
    uint64_t table_count;
    const uint8_t *directory; /* SVO_PALETTE_ENTRY bytes a superblock, see svo_palette.h; of long blocks SVO_ALGORITHM1_ENTRY bytes a block */
    uint64_t superblock_count; /* that have an entry; long blocks: blocks */
    const uint8_t *repeats;    /* blocks: NULL, or the records of svo_palette.repeats, directly before the directory */
    const uint8_t *payload;
    uint64_t payload_size;
    /* averaged views: averages that are stored, since those of the values as they are read are not within the channel's bound */
    const uint8_t *corrections; /* SVO_CORRECTION bytes each: u64 first voxel * 64 + voxels - 1, ascending; u32 value */
    uint64_t correction_count;
} svo_view_channel;

typedef struct svo_view {
    uint32_t depth;       /* as the user gave it */
    uint32_t tree_depth;  /* T */
    uint32_t brick_level; /* T - 2 */
    bool empty;           /* no voxel: everything below is zero */
    bool lod;             /* inner nodes have attributes */
    bool averaged;        /* with lod: those of bricks and of their octants are averages that are worked out */
    bool unnumbered;      /* no channel varies, so that attributes have no numbers: every index is 0 */
    svo_layout layout;
    /* layout plain */
    uint32_t root;        /* word index in level 0, or brick index when brick_level == 0 */
    svo_view_level levels[SVO_MAX_DEPTH]; /* levels 0 .. brick_level - 1 */
    svo_view_fast fast; /* layout fast; root is the turn of the root */
    const uint64_t *bricks; /* layouts fast and best: the dictionary */
    uint64_t brick_count;
    /* layout best (docs/format/svdag.md): its chunks, and the tables that are made of them once; root is the turn of the root */
    const uint8_t *best_stream, *best_codes;
    uint64_t best_stream_bytes, best_code_bytes;
    const struct svoi_best_level *best_levels; /* 0 .. brick_level - 1, SVO_BEST_LEVEL_BYTES each */
    struct svoi_best *best;
    struct svoi_top *top; /* svo_view_accelerate; NULL: none */
    uint64_t attribute_count;
    uint64_t nodes[SVO_MAX_DEPTH + 1]; /* octree nodes a level, 0..depth, shared ones counted as often as they appear */
    double voxel_to_world[16];
    svo_surface surface;
    svo_fill fill;
    uint32_t channel_count;
    svo_view_channel channels[SVO_MAX_CHANNELS];
} svo_view;

/* A node, or a brick where the level is brick_level. */
typedef struct svo_view_node {
    uint64_t at;        /* where it is stored; what this means is the layout's business */
    uint64_t attribute; /* index of the node itself with lod, of its first finest voxel without */
    uint32_t symmetry;  /* takes the frame in which it is stored to the world's: 0 (none) in layout plain */
    bool full;          /* inside a full leaf: every finest voxel is there, and all have this one attribute */
    uint64_t size;      /* attributes of its subtree, where the layout needs them to number its children */
} svo_view_node;

/* For layout best. */
svo_view_node svo_view_best_root(const svo_view *v);
uint32_t svo_view_best_mask(const svo_view *v, svo_view_node node); /* full leaves in bits 8..15 */
bool svo_view_best_voxel(const svo_view *v, uint32_t x, uint32_t y, uint32_t z, uint64_t *index); /* as svo_view_voxel */
svo_view_node svo_view_best_child(const svo_view *v, uint32_t level, svo_view_node node, uint32_t octant);

/* For layout fast. */
svo_view_node svo_view_fast_root(const svo_view *v);
uint32_t svo_view_fast_mask(const svo_view *v, uint32_t level, svo_view_node node); /* full leaves in bits 8..15 */
svo_view_node svo_view_fast_child(const svo_view *v, uint32_t level, svo_view_node node, uint32_t octant);
bool svo_view_fast_voxel(const svo_view *v, uint32_t x, uint32_t y, uint32_t z, uint64_t *index);

/* The root of an octree that is not empty. */
static inline svo_view_node svo_view_root(const svo_view *v)
{
    if (v->layout == SVO_LAYOUT_FAST) return svo_view_fast_root(v);
    if (v->layout == SVO_LAYOUT_BEST) return svo_view_best_root(v);
    svo_view_node n = {v->root, 0, 0, false, 0};
    return n;
}

/* Non-empty children of a node above the bricks. */
static inline uint8_t svo_view_mask(const svo_view *v, uint32_t level, svo_view_node node)
{
    if (node.full) return 0xff;
    if (v->layout == SVO_LAYOUT_FAST) return (uint8_t)svo_view_fast_mask(v, level, node);
    if (v->layout == SVO_LAYOUT_BEST) return (uint8_t)svo_view_best_mask(v, node);
    return (uint8_t)v->levels[level].words[node.at];
}

/* Those of its children that are full leaves. */
static inline uint8_t svo_view_full(const svo_view *v, uint32_t level, svo_view_node node)
{
    if (node.full) return 0xff;
    if (v->layout == SVO_LAYOUT_FAST) return (uint8_t)(svo_view_fast_mask(v, level, node) >> 8);
    if (v->layout == SVO_LAYOUT_BEST) return (uint8_t)(svo_view_best_mask(v, node) >> 8);
    return (uint8_t)(v->levels[level].words[node.at] >> 8);
}

/* Child of a node above the bricks. `octant` must be in its mask. */
static inline svo_view_node svo_view_child(const svo_view *v, uint32_t level, svo_view_node node, uint32_t octant)
{
    if (node.full) return node;
    if (v->layout == SVO_LAYOUT_FAST) return svo_view_fast_child(v, level, node, octant);
    if (v->layout == SVO_LAYOUT_BEST) return svo_view_best_child(v, level, node, octant);
    const svo_view_level *l = &v->levels[level];
    const uint32_t *w = l->words + node.at;
    uint32_t mask = w[0] & 0xffu, full = w[0] >> 8, stored = mask & ~full, below = (1u << octant) - 1;
    uint32_t r = (uint32_t)__builtin_popcount(stored), slot = (uint32_t)__builtin_popcount(mask & below);
    svo_view_node child = {0, node.attribute, 0, (full >> octant & 1) != 0, 0};
    if (!child.full) child.at = w[1 + (uint32_t)__builtin_popcount(stored & below)];
    if (l->offset_words == 0) return child;
    if (slot == 0) child.attribute += v->lod ? 1 : 0;
    else if (l->offset_words == 1) child.attribute += w[1 + r + slot - 1];
    else child.attribute += w[1 + r + 2 * (slot - 1)] | (uint64_t)w[2 + r + 2 * (slot - 1)] << 32;
    return child;
}

/* The 4x4x4 block of a node at brick_level. */
static inline uint64_t svo_view_brick(const svo_view *v, svo_view_node node)
{
    if (node.full) return ~(uint64_t)0;
    return v->layout == SVO_LAYOUT_PLAIN ? v->bricks[node.at] : node.at;
}

/* Attributes of nodes without an entry: the average of `voxels` (1 to 64) values from index `first` on. Of one voxel, that is its own. */
enum { SVO_AVERAGE_SHIFT = 58, SVO_CORRECTION = 12 };
static inline uint64_t svo_average_of(uint64_t first, uint32_t voxels) { return first | (uint64_t)(voxels - 1) << SVO_AVERAGE_SHIFT; }
static inline uint64_t svo_average_first(uint64_t attribute) { return attribute & (((uint64_t)1 << SVO_AVERAGE_SHIFT) - 1); }
static inline uint32_t svo_average_voxels(uint64_t attribute) { return (uint32_t)(attribute >> SVO_AVERAGE_SHIFT) + 1; }

/* Have bricks and their octants entries of their own? The `lod` of the functions that count inside bricks. */
static inline bool svo_view_brick_lod(const svo_view *v) { return v->lod && !v->averaged; }

/* Bit 8a set for every octant a of the brick that is not empty. */
static inline uint64_t svo_brick_octants(uint64_t brick)
{
    brick |= brick >> 4;
    brick |= brick >> 2;
    brick |= brick >> 1;
    return brick & 0x0101010101010101u;
}

/* Attribute index of octant a (0..7, not empty) of a brick at attribute index i: of the octant node with lod, of its
 * first voxel without. */
static inline uint64_t svo_brick_octant(bool lod, uint64_t brick, uint64_t i, uint32_t a)
{
    uint64_t below = ((uint64_t)1 << (8 * a)) - 1;
    i += (uint64_t)__builtin_popcountll(brick & below);
    if (lod) i += 1 + (uint64_t)__builtin_popcountll(svo_brick_octants(brick) & below);
    return i;
}

/* Attribute index of voxel bit b (0..63, set) of a brick at attribute index i. */
static inline uint64_t svo_brick_voxel(bool lod, uint64_t brick, uint64_t i, uint32_t b)
{
    uint64_t below = ((uint64_t)1 << b) - 1;
    i += (uint64_t)__builtin_popcountll(brick & below);
    /* itself: the brick's entry, and one for every non-empty octant up to and including its own */
    if (lod) i += 1 + (uint64_t)__builtin_popcountll(svo_brick_octants(brick) & (((uint64_t)2 << (8 * (b / 8))) - 1));
    return i;
}

/* The same for a node at brick_level and the brick it holds, whatever the numbering. */
static inline uint64_t svo_view_brick_octant(const svo_view *v, svo_view_node node, uint64_t brick, uint32_t a)
{
    if (node.full || v->unnumbered) return node.attribute;
    uint64_t i = svo_brick_octant(svo_view_brick_lod(v), brick, node.attribute, a);
    return v->averaged ? svo_average_of(i, (uint32_t)__builtin_popcountll(brick >> 8 * a & 0xff)) : i;
}
static inline uint64_t svo_view_brick_voxel(const svo_view *v, svo_view_node node, uint64_t brick, uint32_t b)
{
    return node.full || v->unnumbered ? node.attribute : svo_brick_voxel(svo_view_brick_lod(v), brick, node.attribute, b);
}
/* The attribute of a node of any level up to brick_level, as svo_view_attribute takes it. */
static inline uint64_t svo_view_node_attribute(const svo_view *v, uint32_t level, svo_view_node node)
{
    if (level != v->brick_level || !v->averaged || node.full || v->unnumbered) return node.attribute;
    return svo_average_of(node.attribute, (uint32_t)__builtin_popcountll(svo_view_brick(v, node)));
}

/* Nodes (bricks) of a level 0..brick_level as they are stored. */
uint64_t svo_view_stored(const svo_view *v, uint32_t level);

/* The parts of the stored geometry: returns their number. */
typedef struct svo_view_section {
    char type[5];   /* of the file's chunk */
    uint32_t level; /* SVO_MAX_DEPTH + 1: of no level in particular */
    uint64_t bytes;
} svo_view_section;
enum { SVO_VIEW_SECTIONS = SVO_MAX_DEPTH + 8 };
uint32_t svo_view_sections(const svo_view *v, svo_view_section out[SVO_VIEW_SECTIONS]);

/* Layout fast: where the bits of TREE are, for the nodes of a level 0 .. brick_level - 1, in its pool or inside others. */
typedef struct svo_view_fast_parts {
    uint64_t bytes;      /* all of the level's own fields (not: of the nodes inside), rounded up */
    uint64_t masks, tags, skips, sizes, references; /* bits; masks: full leaves, a block's mode and turn too */
    uint64_t codes[4];   /* blocks: bits of bricks' codes with the narrow, the wide number; with a turn as well; written out */
    uint64_t bricks[4];  /* how many bricks have these */
} svo_view_fast_parts;
void svo_view_fast_count(const svo_view *v, svo_view_fast_parts out[SVO_MAX_DEPTH]);

/* A total order of stored geometries (not of the voxels that they describe): 0 when they are the same bytes. */
int svo_view_compare_geometry(const svo_view *a, const svo_view *b);

/* Smallest box of finest voxels, both ends inclusive; *any is false for an empty octree. Linear in the stored nodes. */
svo_result svo_view_grid_bounds(const svo_view *v, const svo_allocator *a, bool *any, uint32_t low[3], uint32_t high[3], svo_error *err);

/* Make the tables that a layout needs to be traversed (layout best), from the file's own; nothing for others. For views that
 * were filled in from a file, before svo_view_validate; svo_view_release frees them. */
svo_result svo_view_prepare(svo_view *v, const svo_allocator *a, svo_error *err);
void svo_view_release(svo_view *v, const svo_allocator *a);

/* Make tables that svo_view_voxel uses where the layout is fast or best: of an upper level by place, of the stored nodes
 * between it and the blocks of 8^3 voxels or, where they are many, of sizes of blocks (layout fast). They take at most 35 MiB or 1.8 times the
 * stored geometry. One walk over the cells of that level, one over the stored nodes. Only for views that are valid. Without memory there are no tables; results are the same. svo_view_release
 * frees them. Opened files and built octrees have them. */
void svo_view_accelerate(svo_view *v, const svo_allocator *a);

/* Decoded value (stride bytes) of a channel at an attribute index < attribute_count, or of an average. Constant time. */
void svo_view_attribute(const svo_view *v, uint32_t channel, uint64_t index, uint8_t *out);
/* Values (as numbers) of the indices first .. first + count - 1, all < attribute_count: faster than one by one. */
void svo_view_values(const svo_view *v, uint32_t channel, uint64_t first, uint32_t count, uint32_t *values);

/* Averaged views: the attributes of the bricks and octants below a node of `level` that are averages of two voxels or more, each
 * different set of voxels once (a brick whose voxels are in one octant: of both), in order of their first voxel, then of their size. */
typedef bool (*svo_view_average_fn)(void *user, uint64_t attribute);
bool svo_view_averages(const svo_view *v, uint32_t level, svo_view_node node, svo_view_average_fn fn, void *user); /* false: stopped */

/* Elements of the chunk ADIR: entries of the directory, with the records of `repeats`. */
static inline uint64_t svo_view_directory_elements(const svo_view *v, const svo_view_channel *c)
{
    return c->superblock_count + (c->repeats != NULL ? svo_palette_repeat_words(v->attribute_count) : 0);
}

/* The blocks of a channel with SVO_ENCODING_BLOCKS or SVO_ENCODING_LONG_BLOCKS. */
svo_palette svo_view_palette(const svo_view *v, uint32_t channel);

/* Index of the channel with this name, SVO_MAX_CHANNELS if there is none. */
uint32_t svo_view_find_channel(const svo_view *v, const char *name);

/* Is grid cell x, y, z (< 2^depth) a voxel? If so *index is its attribute index. index may be NULL. */
bool svo_view_voxel(const svo_view *v, uint32_t x, uint32_t y, uint32_t z, uint64_t *index);

/* Walk all finest voxels in depth-first order; false when fn stopped it. */
typedef bool (*svo_view_voxel_fn)(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index);
bool svo_view_voxels(const svo_view *v, svo_view_voxel_fn fn, void *user);

/* Prove that every traversal stays inside the arrays and that all indices are < attribute_count: references point to
 * node starts of the next level, masks are not 0, offsets equal the counts of the subtrees, level counts match,
 * palette blocks lie inside the payload. Linear time; memory a few bytes a node. Run on every file before use. */
svo_result svo_view_validate(const svo_view *v, const svo_allocator *a, svo_error *err);
/* The same, but violations go to `rules`, and what does not hang on them is checked as well. Bit i of `usable`: the arrays of channel i can be
 * read. SVO_OK with a count of 0: valid. */
svo_result svo_view_violations(const svo_view *v, const svo_allocator *a, uint64_t usable, svo_rules *rules, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
