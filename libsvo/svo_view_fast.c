/* Layout 2 ("fast") node by node. */
#include "svoi_fast.h"
#include "svo_morton.h"

svo_view_node svo_view_fast_root(const svo_view *v)
{
    return (svo_view_node){.at = v->fast.level[0].begin, .symmetry = v->root};
}

uint32_t svo_view_fast_mask(const svo_view *v, uint32_t level, svo_view_node node)
{
    uint64_t w = svoi_fast_peek(v, node.at);
    uint32_t back = svoi_turn_inverse(node.symmetry), mask = svoi_turn_mask(back, w & 0xff);
    (void)level;
    return v->fast.full ? mask | svoi_turn_mask(back, w >> 8 & 0xff) << 8 : mask;
}

svo_view_node svo_view_fast_child(const svo_view *v, uint32_t level, svo_view_node node, uint32_t octant)
{
    uint32_t stored = svoi_turn_octant(node.symmetry, octant), turn = node.symmetry;
    uint32_t earlier = svoi_turn_mask(node.symmetry, (1u << octant) - 1);
    uint64_t end;
    svo_view_node child = {.attribute = node.attribute};
    if (!v->unnumbered && v->lod) child.attribute++;
    if (level + 1 == v->brick_level) {
        svoi_fast_block b = svoi_fast_open_block(v, node.at);
        if (!v->unnumbered) child.attribute += svoi_fast_bricks_size(v, &b, earlier, &end);
        child.full = !(b.refs >> stored & 1);
        if (child.full) return child;
        uint64_t brick = svoi_fast_brick(v, &b, svoi_fast_slot(b.refs, stored), &turn);
        turn = svoi_turn_after(turn, node.symmetry);
        child.at = svoi_turn_brick(svoi_turn_inverse(turn), brick);
        return child;
    }
    svoi_fast_node n = svoi_fast_open(v, level, node.at);
    if (!v->unnumbered) child.attribute += svoi_fast_children_size(v, level, node.at, &n, earlier);
    child.full = !(n.refs >> stored & 1);
    if (child.full) return child;
    child.at = svoi_fast_find(v, level, &n, svoi_fast_slot(n.refs, stored), &turn);
    child.symmetry = turn;
    return child;
}

/* One pass from the root to a voxel. What it does is svo_view_fast_child again and again, without what only a walk needs. */
bool svo_view_fast_voxel(const svo_view *v, uint32_t x, uint32_t y, uint32_t z, uint64_t *index)
{
    const bool count = index != NULL && !v->unnumbered;
    uint32_t turn = v->root, bit = v->tree_depth - 1;
    uint32_t level = 0;
    uint64_t at = v->fast.level[0].begin, attribute = 0, brick, end;
    if (v->top != NULL && v->top->record != NULL) {
        svoi_record_block found;
        if (!svoi_records_descend(v, x, y, z, count, &found)) return false;
        attribute = found.attribute;
        if (found.full) goto full;
        at = found.at, turn = found.turn, bit = 2;
        goto block;
    }
    if (v->top != NULL) {
        const svoi_top_cell *cell = svoi_top_find(v->top, x, y, z);
        if (cell == NULL) return false;
        attribute = cell->attribute;
        if (cell->place == SVOI_TOP_FULL) goto full;
        level = v->top->level, bit -= level;
        at = svoi_top_node_at(cell->place).at, turn = svoi_top_turn(cell->place);
    }
    for (; level + 1 < v->brick_level; level++, bit--) {
        uint32_t octant = (x >> bit & 1) | (y >> bit & 1) << 1 | (z >> bit & 1) << 2;
        uint32_t stored = svoi_turn_octant(turn, octant);
        svoi_fast_node n = svoi_fast_open(v, level, at);
        if (!(n.mask >> stored & 1)) return false;
        if (count) attribute += (v->lod ? 1 : 0) + svoi_fast_children_size(v, level, at, &n, svoi_turn_mask(turn, (1u << octant) - 1));
        if (!(n.refs >> stored & 1)) goto full;
        at = svoi_fast_find(v, level, &n, svoi_fast_slot(n.refs, stored), &turn);
    }
block:;
    uint32_t b = (uint32_t)svo_morton_encode(x & 3, y & 3, z & 3);
    uint32_t octant = (x >> bit & 1) | (y >> bit & 1) << 1 | (z >> bit & 1) << 2, change;
    uint32_t stored = svoi_turn_octant(turn, octant);
    svoi_fast_block k = svoi_fast_open_block(v, at);
    if (!(k.mask >> stored & 1)) return false;
    if (count) attribute += (v->lod ? 1 : 0) + svoi_fast_bricks_size(v, &k, svoi_turn_mask(turn, (1u << octant) - 1), &end);
    if (!(k.refs >> stored & 1)) goto full;
    brick = svoi_fast_brick(v, &k, svoi_fast_slot(k.refs, stored), &change);
    turn = svoi_turn_after(change, turn);
    if (!(brick >> (8 * svoi_turn_octant(turn, b >> 3) + svoi_turn_octant(turn, b & 7)) & 1)) return false;
    if (count) *index = svoi_turned_voxel(svo_view_brick_lod(v), brick, turn, attribute, b);
    else if (index != NULL) *index = 0;
    return true;
full:
    if (index != NULL) *index = attribute;
    return true;
}
