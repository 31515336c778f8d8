/* Traversing layout 3. */
#include "svoi_top.h"

#define INLINE static inline __attribute__((always_inline))

/* --- symbols ----------------------------------------------------------------------------------------------------- */

/* Symbol << 4 | length at the top of `bits`. */
INLINE uint32_t symbol_of(const svoi_best *b, const uint16_t *fast, uint32_t fast_bits, uint32_t context, uint64_t bits)
{
    uint32_t e = fast[bits >> (64 - fast_bits)];
    return e != SVOI_HUFFMAN_SLOW ? e : svoi_huffman_slow(&b->code[context], (uint32_t)(bits >> 48));
}

INLINE uint32_t id_of(const svoi_best *b, uint32_t class, uint64_t bits, uint32_t *length)
{
    uint32_t l = b->id_fast[class][bits >> (64 - SVOI_ID_FAST)];
    if (l == SVOI_ID_SLOW) {
        uint32_t top = (uint32_t)(bits >> (64 - SVOI_ID_LONGEST));
        for (l = SVOI_ID_FAST + 1; l < SVOI_ID_LONGEST && top >= b->id_below[class][l]; l++) {}
    }
    *length = l;
    return (uint32_t)((int32_t)(bits >> 1 >> (63 - l)) + b->id_rank[class][l]);
}

/* --- nodes above the blocks -------------------------------------------------------------------------------------- */

/* Deposit the bits of a string of popcount(mask) bits, the first for the lowest bit of the mask. */
static uint32_t spread(uint32_t mask, uint32_t bits)
{
    uint32_t out = 0, k = (uint32_t)__builtin_popcount(mask);
    for (; mask != 0; mask &= mask - 1) out |= (bits >> --k & 1) << __builtin_ctz(mask);
    return out;
}

INLINE uint32_t read_full(const svoi_best *b, uint32_t mask, uint64_t *at)
{
    if (!b->solid) return 0;
    uint64_t bits = svoi_bits_peek(b->stream, *at);
    if (bits >> 63 == 0) {
        *at += 1;
        return 0;
    }
    uint32_t k = (uint32_t)__builtin_popcount(mask);
    *at += 1 + k;
    return spread(mask, (uint32_t)(bits << 1 >> (64 - k)));
}

INLINE svoi_best_head read_head(const svoi_best *b, uint32_t level, svoi_best_node n)
{
    svoi_best_head h;
    uint64_t at = n.at;
    uint32_t k = (uint32_t)__builtin_popcount(n.mask), field = svoi_best_field(b->block_level - level);
    h.full = read_full(b, n.mask, &at);
    h.refs = n.mask & ~h.full;
    h.slots = (uint32_t)__builtin_popcount(h.refs);
    uint64_t bits = svoi_bits_peek(b->stream, at);
    h.shared = h.slots == 0 ? 0 : (uint32_t)(bits >> (64 - h.slots));
    h.shared_count = (uint32_t)__builtin_popcount(h.shared);
    at += h.slots;
    uint32_t inside = h.slots - h.shared_count;
    h.skips = at;
    h.skip_width = 0;
    if (inside > 1) {
        h.skip_width = (uint32_t)(bits << h.slots >> (64 - field));
        h.skips += field;
        at = h.skips + (uint64_t)h.skip_width * (inside - 1);
    }
    h.sizes = at;
    h.size_width = 0;
    if (b->numbered && k > 1) {
        h.size_width = (uint32_t)svoi_bits_get(b->stream, at, field);
        h.sizes += field;
        at = h.sizes + (uint64_t)h.size_width * (k - 1);
    }
    h.tags = at;
    h.values = at + 2 * h.shared_count;
    h.inside = h.values;
    if (h.shared_count != 0) {
        uint64_t tags = svoi_bits_peek(b->stream, at);
        const uint8_t *tier = b->level[level + 1].tier;
        for (uint32_t i = 0; i < h.shared_count; i++, tags <<= 2) h.inside += 6u + tier[tags >> 62];
    }
    return h;
}

INLINE uint32_t read_mask(const svoi_best *b, uint32_t parent_mask, uint32_t octant, uint64_t *at)
{
    svoi_corner c = b->corners.of[parent_mask][octant];
    uint32_t e = symbol_of(b, b->mask_fast[c.corner], SVOI_MASK_FAST, b->contexts.first[SVOI_CONTEXT_MASK] + c.corner,
                           svoi_bits_peek(b->stream, *at));
    *at += e & 15;
    return svoi_turn_mask(svoi_turn_inverse(c.turn), e >> 4);
}

INLINE svoi_best_node child_of(const svoi_best *b, uint32_t level, svoi_best_node n, const svoi_best_head *h, uint32_t octant, uint32_t *turn)
{
    svoi_best_node child;
    uint32_t slot = (uint32_t)__builtin_popcount(h->refs & ((1u << octant) - 1));
    uint32_t before = (uint32_t)__builtin_popcount(h->shared >> (h->slots - slot)); /* shared ones before it */
    if (h->shared >> (h->slots - 1 - slot) & 1) {
        const svoi_best_level *l = &b->level[level + 1];
        uint64_t tags = svoi_bits_peek(b->stream, h->tags), at = h->values;
        for (uint32_t i = 0; i < before; i++, tags <<= 2) at += 6u + l->tier[tags >> 62];
        uint32_t width = l->tier[tags >> 62];
        uint64_t value = svoi_bits_get(b->stream, at, width);
        *turn = (uint32_t)svoi_bits_get(b->stream, at + width, 6);
        const uint64_t byte = l->first + value;
        child.mask = b->stream[byte];
        child.at = 8 * byte + 8;
        return child;
    }
    *turn = 0;
    child.at = h->inside;
    uint32_t i = slot - before;
    if (i != 0) child.at += svoi_bits_get(b->stream, h->skips + (uint64_t)h->skip_width * (i - 1), h->skip_width);
    if (level + 1 == b->block_level) {
        child.mask = read_mask(b, n.mask, octant, &child.at);
    } else {
        child.mask = (uint32_t)svoi_bits_get(b->stream, child.at, 8);
        child.at += 8;
    }
    return child;
}

svoi_best_head svoi_best_read_head(const svoi_best *b, uint32_t level, svoi_best_node n) { return read_head(b, level, n); }

svoi_best_node svoi_best_child(const svoi_best *b, uint32_t level, svoi_best_node n, const svoi_best_head *h, uint32_t octant, uint32_t *turn)
{
    return child_of(b, level, n, h, octant, turn);
}

/* --- blocks ------------------------------------------------------------------------------------------------------ */

/* What the symbols of a brick are coded after. */
typedef struct context {
    uint32_t class, turn; /* 0, SVOI_TURNS: none yet */
} context;

/* Voxels of a brick that is written out. */
INLINE bool read_voxels(const svoi_best *b, uint64_t *at, bool checked, uint64_t *bits)
{
    uint32_t c = b->contexts.first[SVOI_CONTEXT_OCTANTS];
    if (checked && (!b->used[c] || *at > b->stream_bits)) return false;
    uint32_t e = symbol_of(b, b->octants_fast[0], SVOI_MASK_FAST, c, svoi_bits_peek(b->stream, *at)), mask = e >> 4;
    *at += e & 15;
    *bits = 0;
    for (uint32_t m = mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        svoi_corner corner = b->corners.of[mask][o];
        c = b->contexts.first[SVOI_CONTEXT_OCTANT] + corner.corner;
        if (checked && (!b->used[c] || *at > b->stream_bits)) return false;
        e = symbol_of(b, b->octant_fast[corner.corner], SVOI_MASK_FAST, c, svoi_bits_peek(b->stream, *at));
        *at += e & 15;
        *bits |= (uint64_t)svoi_turn_mask(svoi_turn_inverse(corner.turn), e >> 4) << 8 * o;
    }
    return true;
}

/* The next brick of a block. Class, number and turn take at most 54 bits together: one load. */
INLINE bool read_brick(const svoi_best *b, uint64_t *at, context *x, svoi_corner corner, bool checked, bool wanted, uint64_t *brick,
                       uint8_t *brick_turn)
{
    uint32_t i = x->class == 0 ? b->classes + corner.corner : x->class; /* both kinds of contexts lie behind each other */
    if (checked && (*at > b->stream_bits || !b->used[i])) return false;
    uint64_t bits = svoi_bits_peek(b->stream, *at);
    uint32_t e = symbol_of(b, b->class_fast[i], SVOI_CLASS_FAST, i, bits), class = e >> 4, used = e & 15;
    x->class = class;
    if (class == b->classes - 1) {
        *at += used;
        *brick_turn = 0;
        return read_voxels(b, at, checked, brick);
    }
    uint32_t length, id = id_of(b, class, bits << used, &length);
    if (checked && id >= b->class_count[class]) return false;
    used += length;
    bool first = x->turn == SVOI_TURNS;
    i = first ? SVOI_TURNS + (uint32_t)corner.corner : x->turn;
    if (checked && !b->used[b->contexts.first[SVOI_CONTEXT_TURN] + i]) return false;
    e = symbol_of(b, b->turn_fast[i], SVOI_TURN_FAST, b->contexts.first[SVOI_CONTEXT_TURN] + i, bits << used);
    *at += used + (e & 15);
    x->turn = first ? svoi_turn_after(svoi_turn_inverse(corner.turn), e >> 4) : e >> 4;
    *brick_turn = (uint8_t)x->turn;
    if (wanted) *brick = b->dictionary[b->class_first[class] + id];
    return true;
}

INLINE bool read_block(const svoi_best *b, svoi_best_node n, bool checked, uint32_t wanted, svoi_best_block *out, uint64_t *end)
{
    uint64_t at = n.at;
    out->full = read_full(b, n.mask, &at);
    context x = {0, SVOI_TURNS};
    for (uint32_t m = n.mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        if (out->full >> o & 1) {
            out->bits[o] = ~(uint64_t)0;
            out->turn[o] = 0;
        } else if (!read_brick(b, &at, &x, b->corners.of[n.mask][o], checked, wanted == 8 || wanted == o, &out->bits[o], &out->turn[o])) {
            return false;
        }
        if (wanted == o) break;
    }
    *end = at;
    return !checked || at <= b->stream_bits;
}

void svoi_best_read_block(const svoi_best *b, svoi_best_node n, svoi_best_block *out)
{
    uint64_t end;
    read_block(b, n, false, 8, out, &end);
}

void svoi_best_read_brick(const svoi_best *b, svoi_best_node n, uint32_t octant, svoi_best_block *out)
{
    uint64_t end;
    read_block(b, n, false, octant, out, &end);
}

bool svoi_best_check_block(const svoi_best *b, svoi_best_node n, svoi_best_block *out, uint64_t *end)
{
    return n.at <= b->stream_bits && read_block(b, n, true, 8, out, end);
}

bool svoi_best_check_mask(const svoi_best *b, uint32_t parent_mask, uint32_t octant, uint64_t *at, uint32_t *mask)
{
    uint32_t corner = b->corners.of[parent_mask][octant].corner;
    if (*at > b->stream_bits || !b->used[b->contexts.first[SVOI_CONTEXT_MASK] + corner]) return false;
    *mask = read_mask(b, parent_mask, octant, at);
    return true;
}

/* --- the cursor -------------------------------------------------------------------------------------------------- */

svo_view_node svo_view_best_root(const svo_view *v)
{
    const svoi_best *b = v->best;
    uint64_t byte = b->level[0].first;
    svoi_best_node n = {8 * byte + 8, b->stream[byte]};
    svo_view_node root = {.at = svoi_best_pack(n), .size = b->attribute_count, .symmetry = b->root_turn};
    return root;
}

uint32_t svo_view_best_mask(const svo_view *v, svo_view_node node)
{
    const svoi_best *b = v->best;
    svoi_best_node n = svoi_best_unpack(node.at);
    uint64_t at = n.at;
    uint32_t full = read_full(b, n.mask, &at), mask = svoi_turn_mask(node.symmetry, n.mask);
    return full == 0 ? mask : mask | svoi_turn_mask(node.symmetry, full) << 8;
}

/* Attributes before a child, and its own: the sizes of the children in the order of their octants in the grid. `symmetry`
 * is from the node's frame to the grid, `size` that of the node. */
INLINE uint64_t before_child(const svoi_best *b, const svoi_best_head *h, uint32_t mask, uint32_t octant, uint32_t symmetry, uint64_t *size)
{
    uint32_t world = svoi_turn_octant(symmetry, octant);
    uint64_t rest = *size - (b->lod ? 1 : 0), before = b->lod ? 1 : 0, at = h->sizes;
    for (uint32_t m = mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        uint64_t one = (m & (m - 1)) == 0 ? rest : svoi_bits_get(b->stream, at, h->size_width);
        rest -= one;
        at += h->size_width;
        if (o == octant) *size = one;
        if (svoi_turn_octant(symmetry, o) < world) before += one;
    }
    return before;
}

/* The same for a brick of a block. */
INLINE uint64_t before_brick(const svoi_best *b, const svoi_best_block *block, uint32_t mask, uint32_t octant, uint32_t symmetry)
{
    uint32_t world = svoi_turn_octant(symmetry, octant);
    uint64_t before = b->lod ? 1 : 0;
    for (uint32_t m = mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m);
        if (svoi_turn_octant(symmetry, o) < world) before += block->full >> o & 1 ? 1 : svoi_brick_size(b->brick_lod, block->bits[o]);
    }
    return before;
}

static svo_view_node brick_of(const svo_view *v, svo_view_node node, svoi_best_node n, uint32_t octant)
{
    const svoi_best *b = v->best;
    svoi_best_block block;
    svo_view_node child = {.attribute = 0};
    if (b->numbered) svoi_best_read_block(b, n, &block);
    else svoi_best_read_brick(b, n, octant, &block);
    if (b->numbered) child.attribute = node.attribute + before_brick(b, &block, n.mask, octant, node.symmetry);
    child.full = block.full >> octant & 1;
    child.at = child.full ? 0 : svoi_turn_brick(svoi_turn_after(node.symmetry, block.turn[octant]), block.bits[octant]);
    return child;
}

svo_view_node svo_view_best_child(const svo_view *v, uint32_t level, svo_view_node node, uint32_t octant)
{
    const svoi_best *b = v->best;
    svoi_best_node n = svoi_best_unpack(node.at);
    uint32_t stored = svoi_turn_octant(svoi_turn_inverse(node.symmetry), octant), turn;
    if (level == b->block_level) return brick_of(v, node, n, stored);
    svoi_best_head h = svoi_best_read_head(b, level, n);
    svo_view_node child = {.full = h.full >> stored & 1};
    child.size = node.size;
    if (b->numbered) child.attribute = node.attribute + before_child(b, &h, n.mask, stored, node.symmetry, &child.size);
    if (child.full) return child;
    child.at = svoi_best_pack(svoi_best_child(b, level, n, &h, stored, &turn));
    child.symmetry = svoi_turn_after(node.symmetry, turn);
    return child;
}

/* --- a voxel by its place ---------------------------------------------------------------------------------------- */

INLINE uint32_t octant_at(uint32_t x, uint32_t y, uint32_t z, uint32_t bit) { return (x >> bit & 1) | (y >> bit & 1) << 1 | (z >> bit & 1) << 2; }

/* Turns the place rather than the nodes; without numbers it decodes no further than to the brick. */
INLINE bool find_voxel(const svo_view *v, uint32_t x, uint32_t y, uint32_t z, bool numbered, uint64_t *index)
{
    const svoi_best *b = v->best;
    svoi_best_node n = svoi_best_unpack(svo_view_best_root(v).at);
    uint32_t world = b->root_turn, to_stored = svoi_turn_inverse(world), bit = v->tree_depth - 1;
    uint64_t size = b->attribute_count, attribute = 0;
    uint32_t level = 0;
    if (v->top != NULL && v->top->record != NULL) {
        svoi_record_block found;
        if (!svoi_records_descend(v, x, y, z, numbered, &found)) return false;
        attribute = found.attribute;
        if (found.full) {
            *index = attribute;
            return true;
        }
        n = (svoi_best_node){found.at, found.mask}, to_stored = found.turn, world = svoi_turn_inverse(found.turn), level = b->block_level;
    } else if (v->top != NULL) {
        const svoi_top_cell *cell = svoi_top_find(v->top, x, y, z);
        if (cell == NULL) return false;
        attribute = cell->attribute;
        if (cell->place == SVOI_TOP_FULL) {
            *index = attribute;
            return true;
        }
        level = v->top->level, bit -= level;
        n = svoi_top_node_at(cell->place), world = svoi_top_turn(cell->place), to_stored = svoi_turn_inverse(world);
        if (numbered) size = v->top->size[cell - v->top->cell];
    }
    for (; level < b->block_level; level++, bit--) {
        uint32_t stored = svoi_turn_octant(to_stored, octant_at(x, y, z, bit)), turn;
        if (!(n.mask >> stored & 1)) return false;
        svoi_best_head h = read_head(b, level, n);
        if (numbered) attribute += before_child(b, &h, n.mask, stored, world, &size);
        if (h.full >> stored & 1) {
            *index = attribute;
            return true;
        }
        n = child_of(b, level, n, &h, stored, &turn);
        if (turn == 0) continue;
        to_stored = svoi_turn_after(svoi_turn_inverse(turn), to_stored);
        if (numbered) world = svoi_turn_after(world, turn);
    }
    uint32_t stored = svoi_turn_octant(to_stored, octant_at(x, y, z, 2));
    if (!(n.mask >> stored & 1)) return false;
    svoi_best_block block = {.full = 0};
    uint64_t end;
    read_block(b, n, false, numbered ? 8 : stored, &block, &end);
    uint32_t turn = block.turn[stored];
    if (numbered) attribute += before_brick(b, &block, n.mask, stored, world);
    to_stored = svoi_turn_after(svoi_turn_inverse(turn), to_stored);
    uint32_t a = svoi_turn_octant(to_stored, octant_at(x, y, z, 1)), voxel = svoi_turn_octant(to_stored, octant_at(x, y, z, 0));
    if (!(block.bits[stored] >> (8 * a + voxel) & 1)) return false;
    *index = 0;
    if (!numbered) return true;
    if (block.full >> stored & 1) *index = attribute;
    else *index = svoi_turned_voxel(b->brick_lod, block.bits[stored], to_stored, attribute, 8 * octant_at(x, y, z, 1) + octant_at(x, y, z, 0));
    return true;
}

bool svo_view_best_voxel(const svo_view *v, uint32_t x, uint32_t y, uint32_t z, uint64_t *index)
{
    uint64_t unused;
    if (index == NULL || !v->best->numbered) return find_voxel(v, x, y, z, false, index != NULL ? index : &unused);
    return find_voxel(v, x, y, z, true, index);
}
