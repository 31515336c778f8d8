/* Internal to libsvo: reading layout 2 ("fast") in place. docs/format/svdag.md has the bits. Not installed.
 *
 * A turn in this file takes octants of the frame above to octants of the frame below (svoi_symmetry.h has the group), so
 * that going down from the root the product of all turns says where a world octant is stored. */
#ifndef SVOI_FAST_H
#define SVOI_FAST_H

#include <string.h>

#include "svoi_symmetry.h"
#include "svoi_top.h"

/* Bits from p up, the lowest first; at least 57 of them are valid. */
static inline uint64_t svoi_fast_peek(const svo_view *v, uint64_t p)
{
    uint64_t w;
    memcpy(&w, v->fast.tree + (p >> 3), 8);
    return w >> (p & 7);
}
static inline uint64_t svoi_fast_bits(const svo_view *v, uint64_t p, uint32_t n) /* n <= 57 */
{
    return svoi_fast_peek(v, p) & (((uint64_t)1 << n) - 1);
}
static inline uint64_t svoi_fast_bits64(const svo_view *v, uint64_t p, uint32_t n) /* n <= 64 */
{
    if (n <= 57) return svoi_fast_bits(v, p, n);
    return svoi_fast_bits(v, p, 32) | svoi_fast_bits(v, p + 32, n - 32) << 32;
}

/* Tags are pairs of bits, one for each child that is no full leaf, in the order of the stored octants. */
static inline uint32_t svoi_tags_some(uint32_t tags) { return (tags | tags >> 1) & 0x5555; }
static inline uint32_t svoi_tags_width(uint32_t tags, const uint8_t width[4])
{
    uint32_t low = tags & 0x5555, high = tags >> 1 & 0x5555;
    return (uint32_t)__builtin_popcount(low & ~high) * width[1] + (uint32_t)__builtin_popcount(high & ~low) * width[2] +
           (uint32_t)__builtin_popcount(low & high) * width[3];
}

/* --- writing: widths of bricks' codes ----------------------------------------------------------------------------- */

typedef struct svoi_code_class { uint32_t ids, turns; } svoi_code_class; /* bits of a brick's number, of the index of its change */
enum { SVOI_CODE_TURNS = 7 };
/* Classes of which every brick takes the narrowest that can say it: the last one, with `widest` and 6 bits, says everything, the `free` (2 or 3)
 * before it are those that take the fewest bits. count: bricks by bits of their number and of the index. */
void svoi_fast_classes(uint64_t count[33][SVOI_CODE_TURNS], uint32_t widest, uint32_t free, svoi_code_class *out);

/* --- nodes of 16^3 voxels and more ------------------------------------------------------------------------------- */

/* Where the parts of a node are, as bit positions. */
typedef struct svoi_fast_node {
    uint32_t mask, refs; /* children; those that are no full leaves */
    uint32_t tags, inner_count;
    uint64_t skips, sizes, codes, inner;
} svoi_fast_node;

static inline svoi_fast_node svoi_fast_open(const svo_view *v, uint32_t level, uint64_t p)
{
    const svo_view_fast_level *l = &v->fast.level[level];
    svoi_fast_node n;
    uint64_t w = svoi_fast_peek(v, p);
    n.mask = n.refs = w & 0xff;
    p += 8, w >>= 8;
    if (v->fast.full) n.refs &= ~(uint32_t)w, p += 8, w >>= 8;
    uint32_t r = (uint32_t)__builtin_popcount(n.refs);
    n.tags = (uint32_t)w & ((1u << 2 * r) - 1);
    p += 2 * r;
    n.inner_count = r - (uint32_t)__builtin_popcount(svoi_tags_some(n.tags));
    n.skips = p;
    if (n.inner_count > 1) p += (n.inner_count - 1) * l->skip_bits;
    n.sizes = p;
    p += (uint32_t)__builtin_popcount(n.mask) * l->size_bits;
    n.codes = p;
    n.inner = p + svoi_tags_width(n.tags, l->code_bits);
    return n;
}

/* --- nodes of 8^3 voxels ----------------------------------------------------------------------------------------- */

typedef struct svoi_fast_block {
    uint32_t mask, refs, mode, turn, tags;
    uint64_t codes;
} svoi_fast_block;

static inline svoi_fast_block svoi_fast_open_block(const svo_view *v, uint64_t p)
{
    svoi_fast_block b;
    uint64_t w = svoi_fast_peek(v, p);
    b.mask = b.refs = w & 0xff;
    p += 8, w >>= 8;
    if (v->fast.full) b.refs &= ~(uint32_t)w, p += 8, w >>= 8;
    uint32_t r = (uint32_t)__builtin_popcount(b.refs);
    b.mode = w & 1;
    b.turn = w >> 1 & 63;
    b.tags = (uint32_t)(w >> 7) & ((1u << 2 * r) - 1);
    b.codes = p + 7 + 2 * r;
    return b;
}

/* Bits of the codes of the first `slots` bricks. */
static inline uint32_t svoi_fast_codes(const svo_view *v, const svoi_fast_block *b, uint32_t slots)
{
    const uint8_t *width = v->fast.code_bits[b->mode];
    uint32_t tags = b->tags & ((1u << 2 * slots) - 1);
    return svoi_tags_width(tags, width) + (slots - (uint32_t)__builtin_popcount(svoi_tags_some(tags))) * width[0];
}

static inline uint64_t svoi_fast_block_end(const svo_view *v, const svoi_fast_block *b)
{
    return b->codes + svoi_fast_codes(v, b, (uint32_t)__builtin_popcount(b->refs));
}

/* The brick of a slot as it is stored; *turn (the block's frame to the brick's). */
static inline uint64_t svoi_fast_brick(const svo_view *v, const svoi_fast_block *b, uint32_t slot, uint32_t *turn)
{
    uint32_t tag = b->tags >> 2 * slot & 3, ids = v->fast.id_bits[b->mode][tag];
    uint64_t p = b->codes + svoi_fast_codes(v, b, slot);
    *turn = b->turn;
    if (ids == SVO_FAST_LITERAL) return svoi_fast_bits64(v, p, 64);
    uint64_t code = svoi_fast_bits(v, p, v->fast.code_bits[b->mode][tag]);
    uint32_t change = v->fast.turn[code >> ids];
    if (change != 0) *turn = svoi_turn_after(change, b->turn);
    return v->bricks[code & (((uint64_t)1 << ids) - 1)];
}

/* --- going down -------------------------------------------------------------------------------------------------- */

/* Slot of a stored octant among the children that are no full leaves. */
static inline uint32_t svoi_fast_slot(uint32_t refs, uint32_t octant)
{
    return (uint32_t)__builtin_popcount(refs & ((1u << octant) - 1));
}

/* Where the node in a slot of a node of `level` begins; *turn is multiplied by that of the reference. */
static inline uint64_t svoi_fast_find(const svo_view *v, uint32_t level, const svoi_fast_node *n, uint32_t slot, uint32_t *turn)
{
    const svo_view_fast_level *l = &v->fast.level[level];
    uint32_t below = n->tags & ((1u << 2 * slot) - 1), tag = n->tags >> 2 * slot & 3;
    if (tag != 0) {
        uint64_t code = svoi_fast_bits(v, n->codes + svoi_tags_width(below, l->code_bits), l->code_bits[tag]);
        uint32_t t = (uint32_t)code & 63;
        if (t != 0) *turn = svoi_turn_after(t, *turn);
        return l[1].begin + (code >> 6) * 8;
    }
    uint32_t before = slot - (uint32_t)__builtin_popcount(svoi_tags_some(below));
    if (before == 0) return n->inner;
    if (l->skip_bits != 0) return n->inner + svoi_fast_bits(v, n->skips + (before - 1) * l->skip_bits, l->skip_bits);
    uint64_t p = n->inner; /* blocks are short: walk over them */
    for (; before != 0; before--) {
        svoi_fast_block b = svoi_fast_open_block(v, p);
        p = svoi_fast_block_end(v, &b);
    }
    return p;
}

/* Up to eight pairs of bits, one to a byte. */
static inline uint64_t svoi_tags_bytes(uint32_t tags)
{
    uint64_t t = tags;
    t = (t | t << 24) & 0x000000ff000000ffu;
    t = (t | t << 12) & 0x000f000f000f000fu;
    return (t | t << 6) & 0x0303030303030303u;
}

/* Attributes of a brick with a code of `ids` bits for its number at bit p. */
static inline uint32_t svoi_fast_brick_size(const svo_view *v, uint64_t p, uint32_t ids)
{
    if (ids == SVO_FAST_LITERAL) return (uint32_t)svoi_brick_size(svo_view_brick_lod(v), svoi_fast_bits64(v, p, 64));
    uint64_t id = svoi_fast_bits(v, p, ids);
    return v->top != NULL && v->top->brick != NULL ? v->top->brick[id] : (uint32_t)svoi_brick_size(svo_view_brick_lod(v), v->bricks[id]);
}

/* Attributes of a block's children in the stored octants of `which`; *end: the bit after the block. */
static inline uint64_t svoi_fast_bricks_size(const svo_view *v, const svoi_fast_block *b, uint32_t which, uint64_t *end)
{
    const uint8_t *width = v->fast.code_bits[b->mode], *ids = v->fast.id_bits[b->mode];
    uint64_t size = (uint64_t)__builtin_popcount(which & b->mask & ~b->refs);
    uint32_t all = svoi_fast_codes(v, b, (uint32_t)__builtin_popcount(b->refs));
    *end = b->codes + all;
    if (all < 256) { /* where the codes begin, one to a byte: loads that do not wait for each other */
        uint64_t t = svoi_tags_bytes(b->tags), low = t & 0x0101010101010101u, high = t >> 1 & 0x0101010101010101u;
        uint64_t at = width[0] * (uint64_t)0x0101010101010101u + low * ((uint64_t)width[1] - width[0]) + high * ((uint64_t)width[2] - width[0]) +
                      (low & high) * ((uint64_t)width[3] + width[0] - width[1] - width[2]);
        at = at * 0x0101010101010101u << 8;
        for (uint32_t m = which & b->refs; m != 0; m &= m - 1) {
            uint32_t slot = (uint32_t)__builtin_popcount(b->refs & ((m & (0u - m)) - 1)), tag = b->tags >> 2 * slot & 3;
            size += svoi_fast_brick_size(v, b->codes + (at >> 8 * slot & 255), ids[tag]);
        }
        return size;
    }
    uint64_t p = b->codes;
    for (uint32_t left = b->refs, tags = b->tags; left != 0; left &= left - 1, tags >>= 2) {
        uint32_t tag = tags & 3;
        if (which & left & (0u - left)) size += svoi_fast_brick_size(v, p, ids[tag]);
        p += width[tag];
    }
    return size;
}

/* Attributes of a node's children in the stored octants of `which`; the node begins at bit `begin`. */
static inline uint64_t svoi_fast_children_size(const svo_view *v, uint32_t level, uint64_t begin, const svoi_fast_node *n, uint32_t which)
{
    uint32_t bits = v->fast.level[level].size_bits;
    uint64_t size = 0;
    which &= n->mask;
    if (bits != 0) {
        for (; which != 0; which &= which - 1)
            size += svoi_fast_bits64(v, n->sizes + bits * (uint32_t)__builtin_popcount(n->mask & ((which & (0u - which)) - 1)), bits);
        return size;
    }
    if (v->top != NULL && v->top->record != NULL) return svoi_record_size(svoi_record_find(v->top, begin), which);
    if (v->top != NULL && v->top->sizes.size != NULL && n->inner != n->codes) {
        const svoi_size *known = svoi_sizes_find(&v->top->sizes, begin);
        if (known != NULL) return svoi_size_sum(known->size, which, (1 << SVOI_SIZE_BITS) - 1);
    }
    /* of nodes of 16^3: their children are blocks, whose bricks are counted */
    uint64_t inner = n->inner, codes = n->codes;
    const svo_view_fast_level *l = &v->fast.level[level];
    for (uint32_t left = n->mask, tags = n->tags; which != 0; left &= left - 1) {
        uint32_t bit = left & (0u - left), tag = tags & 3;
        if (!(n->refs & bit)) {
            size += (which & bit) != 0;
            which &= ~bit;
            continue;
        }
        tags >>= 2;
        uint64_t p = inner, end;
        if (tag != 0) {
            p = l[1].begin + (svoi_fast_bits(v, codes, l->code_bits[tag]) >> 6) * 8;
            codes += l->code_bits[tag];
            if (!(which & bit)) continue;
        }
        svoi_fast_block b = svoi_fast_open_block(v, p);
        if (which & bit) size += (v->lod ? 1 : 0) + svoi_fast_bricks_size(v, &b, 0xff, &end);
        else end = svoi_fast_block_end(v, &b);
        if (tag == 0) inner = end;
        which &= ~bit;
    }
    return size;
}

#endif
