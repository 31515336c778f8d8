/* Sizes of blocks that several nodes of 16^3 voxels refer to (layout fast). */
#include "svoi_fast.h"

/* All children: those that lie inside are walked over. Leaves *p behind the node. */
static svoi_size count_children(const svo_view *v, const svoi_fast_node *n, uint64_t *p)
{
    const svo_view_fast_level *l = &v->fast.level[v->brick_level - 2];
    uint64_t inner = n->inner, codes = n->codes;
    uint32_t tags = n->tags;
    svoi_size out = {{0}};
    for (uint32_t m = n->mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), tag = tags & 3;
        uint64_t at = inner, end;
        out.size[o] = 1;
        if (!(n->refs >> o & 1)) continue;
        tags >>= 2;
        if (tag != 0) {
            at = l[1].begin + (svoi_fast_bits(v, codes, l->code_bits[tag]) >> 6) * 8;
            codes += l->code_bits[tag];
        }
        svoi_fast_block b = svoi_fast_open_block(v, at);
        out.size[o] = (uint16_t)((v->lod ? 1 : 0) + svoi_fast_bricks_size(v, &b, 0xff, &end));
        if (tag == 0) inner = end;
    }
    *p = inner;
    return out;
}

static void add_node(svoi_sizes *t, const svo_view *v, const svoi_fast_node *n, uint64_t *p)
{
    const uint64_t begin = *p;
    if (n->inner == n->codes || (n->mask & (n->mask - 1)) == 0) { /* no reference: its blocks lie beside it, and are quickly counted */
        uint64_t at = n->inner;
        for (uint32_t i = 0; i < (uint32_t)__builtin_popcount(n->refs); i++) {
            if ((n->tags >> 2 * i & 3) != 0) continue;
            svoi_fast_block b = svoi_fast_open_block(v, at);
            at = svoi_fast_block_end(v, &b);
        }
        *p = at;
        return;
    }
    SVO_ASSERT(t->count < t->capacity);
    svoi_size *to = &t->size[t->count];
    *to = count_children(v, n, p);
    uint32_t key = svoi_size_key(begin);
    to->size[0] |= (uint16_t)key;
    to->size[1] |= (uint16_t)(key >> 16);
    /* buckets up to the node's are of nodes from this one on */
    for (uint64_t bucket = begin >> t->shift; t->bucket_count <= bucket; t->bucket_count++) t->bucket[t->bucket_count] = (uint32_t)t->count;
    t->count++;
}

/* Every stored node from `level` down that lies in the node at *p, in order of position. At most SVO_MAX_DEPTH deep. Leaves *p behind it. */
static void walk(svoi_sizes *t, const svo_view *v, uint32_t level, uint64_t *p)
{
    svoi_fast_node n = svoi_fast_open(v, level, *p);
    if (level + 2 == v->brick_level) {
        add_node(t, v, &n, p);
        return;
    }
    *p = n.inner;
    for (uint32_t i = 0; i < n.inner_count; i++) walk(t, v, level + 1, p);
}

void svoi_sizes_make(svoi_sizes *t, const svo_view *v, const svo_allocator *a)
{
    const uint32_t last = v->brick_level - 2;
    const uint64_t bits = 8 * v->fast.tree_bytes, capacity = v->fast.level[last].node_count;
    if (capacity == 0 || capacity > UINT32_MAX) return;
    t->shift = 6;
    while (t->shift < SVOI_SIZE_SHIFT && bits >> t->shift > 2 * capacity) t->shift++;
    const uint64_t buckets = (bits >> t->shift) + 2;
    if (sizeof *t->size * capacity + sizeof *t->bucket * buckets > v->fast.tree_bytes) return;
    t->capacity = capacity;
    t->size = svo_alloc(a, capacity, sizeof *t->size);
    t->bucket = svo_alloc(a, buckets, sizeof *t->bucket);
    if (t->size != NULL && t->bucket != NULL) {
        for (uint32_t l = 0; l <= last; l++) {
            uint64_t p = v->fast.level[l].begin;
            for (uint64_t k = 0; k < v->fast.level[l].pool_count; k++, p = (p + 7) & ~(uint64_t)7) walk(t, v, l, &p);
        }
        while (t->bucket_count < buckets) t->bucket[t->bucket_count++] = (uint32_t)t->count;
        return;
    }
    t->bucket_count = buckets;
    svoi_sizes_free(t, a);
}

void svoi_sizes_free(svoi_sizes *t, const svo_allocator *a)
{
    svo_free(a, t->size, t->capacity, sizeof *t->size);
    svo_free(a, t->bucket, t->bucket_count, sizeof *t->bucket);
    *t = (svoi_sizes){0};
}
