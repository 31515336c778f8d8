/* The table of stored nodes of 16^3 voxels. */
#include "svoi_fast.h"

/* One of them: its children's sizes and where they begin. Returns the bit after it. */
static uint64_t note(const svo_view *v, uint64_t at, svoi_near_node *to)
{
    const uint32_t level = v->brick_level - 2;
    svoi_fast_node n = svoi_fast_open(v, level, at);
    *to = (svoi_near_node){.at = (uint32_t)at};
    uint64_t inner = n.inner;
    for (uint32_t m = n.mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), slot = svoi_fast_slot(n.refs, o), turn = 0;
        to->size[o] = 1; /* of a full leaf */
        if (!(n.refs >> o & 1)) continue;
        bool inside = (n.tags >> 2 * slot & 3) == 0;
        uint64_t begin = inside ? inner : svoi_fast_find(v, level, &n, slot, &turn), end;
        svoi_fast_block b = svoi_fast_open_block(v, begin);
        to->size[o] = (uint16_t)((v->lod ? 1 : 0) + svoi_fast_bricks_size(v, &b, 0xff, &end)); /* 1 + 8 * 73 at most */
        if (inside) to->begin[o] = (uint16_t)(begin - at), inner = end; /* 8 blocks of at most 23 + 8 * 72 bits */
    }
    return inner;
}

typedef struct notes {
    const svo_view *v;
    svoi_near_node *next;
} notes;

/* At most SVO_MAX_DEPTH deep. Returns the bit after the node. */
static uint64_t note_inside(notes *t, uint32_t level, uint64_t at)
{
    const svo_view *v = t->v;
    if (level + 2 == v->brick_level) return note(v, at, t->next++);
    svoi_fast_node n = svoi_fast_open(v, level, at);
    at = n.inner;
    for (uint32_t i = 0; i < n.inner_count; i++) at = note_inside(t, level + 1, at);
    return at;
}

void svoi_near_make(svoi_top *t, const svo_view *v, const svo_allocator *a)
{
    if (v->brick_level < 2) return;
    const svo_view_fast_level *l = &v->fast.level[v->brick_level - 2];
    uint64_t bits = 8 * v->fast.tree_bytes, count = l->node_count;
    if (count == 0 || count > SVOI_NEAR_NODES || bits >> 26 != 0) return;
    t->near_count = count;
    t->bucket_count = (bits >> SVOI_NEAR_SHIFT) + 1;
    t->near = svo_alloc(a, count, sizeof *t->near);
    t->bucket = svo_alloc(a, t->bucket_count, sizeof *t->bucket);
    if (t->near == NULL || t->bucket == NULL) {
        svo_free(a, t->near, count, sizeof *t->near);
        t->near = NULL;
        return;
    }
    notes to = {v, t->near};
    for (uint32_t level = 0; level + 1 < v->brick_level; level++) {
        uint64_t p = v->fast.level[level].begin;
        for (uint64_t k = 0; k < v->fast.level[level].pool_count; k++) p = (note_inside(&to, level, p) + 7) & ~(uint64_t)7;
    }
    SVO_ASSERT(to.next == t->near + count);
    uint64_t next = 0;
    for (uint64_t i = 0; i < t->bucket_count; i++) {
        while (next < count - 1 && t->near[next].at < i << SVOI_NEAR_SHIFT) next++;
        t->bucket[i] = (uint32_t)next;
    }
}
