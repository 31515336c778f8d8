/* Layout 1 ("plain"): the merged nodes as 32-bit words, see svo_view.h. */
#include <string.h>

#include "svoi_dag.h"

/* 0 where nothing is numbered. The last offset of each node, which is its largest, decides whether the level needs 64 bits. */
static uint32_t offset_words(const svo_view *v, const svoi_nodes *n, const uint64_t *child_size)
{
    const uint64_t *bricks = v->bricks;
    bool brick_lod = svo_view_brick_lod(v);
    if (v->unnumbered) return 0;
    for (uint64_t i = 0; i < n->count; i++) {
        const uint32_t *item = n->items + n->start[i];
        uint32_t last = item[svoi_node_refs(item[0])];
        bool full = item[0] >> 8 > (item[0] & 0xff & ~(item[0] >> 8)); /* the last child is a full leaf */
        uint64_t size = full ? 1 : child_size != NULL ? child_size[last] : svoi_brick_size(brick_lod, bricks[last]);
        if (n->size[i] - size > UINT32_MAX) return 2;
    }
    return 1;
}

static void emit_node(uint32_t *w, const uint32_t *item, uint32_t ow, const uint32_t *child_position, const uint64_t *child_size,
                      const uint64_t *bricks, bool lod, bool brick_lod)
{
    uint32_t r = svoi_node_refs(item[0]), refs = 0;
    uint64_t offset = lod ? 1 : 0;
    w[0] = item[0];
    uint32_t *o = w + 1 + r;
    for (uint32_t m = item[0] & 0xff; m != 0; m &= m - 1) {
        if (m != (item[0] & 0xff) && ow != 0) { /* not the first child */
            *o++ = (uint32_t)offset;
            if (ow == 2) *o++ = (uint32_t)(offset >> 32);
        }
        if (item[0] >> 8 >> __builtin_ctz(m) & 1) {
            offset++;
            continue;
        }
        uint32_t ref = item[1 + refs];
        w[1 + refs++] = child_position != NULL ? child_position[ref] : ref;
        offset += child_size != NULL ? child_size[ref] : svoi_brick_size(brick_lod, bricks[ref]);
    }
}

/* On success *position (level->count) says where each node went; the caller frees it. */
static svo_result emit_level(svo_packed *p, uint32_t level, const svoi_nodes *n, const uint32_t *child_position,
                             const uint64_t *child_size, uint32_t **position, svo_error *err)
{
    const svo_allocator *a = &p->memory.base;
    svo_view_level *l = &p->view.levels[level];
    const uint64_t *bricks = p->view.bricks;
    uint32_t ow = offset_words(&p->view, n, child_size);
    uint64_t words = 0;
    uint32_t *at = svo_alloc(a, n->count + 1, sizeof *at); /* a level may be empty: full leaves above it */
    if (at == NULL) return svoi_no_memory(p, "geometry", err);
    for (uint64_t i = 0; i < n->count; i++) {
        uint32_t mask = n->items[n->start[i]], k = (uint32_t)__builtin_popcount(mask & 0xff);
        at[i] = (uint32_t)words;
        words += 1 + svoi_node_refs(mask) + (k - 1) * (uint64_t)ow;
    }
    svo_result r = SVO_OK;
    if (words > UINT32_MAX) r = svo_fail(err, SVO_LIMIT, "level %u has more than 2^32 words of distinct nodes", level);
    else if (!svo_buffer_reserve(&p->words[level], (size_t)words * 4)) r = svoi_no_memory(p, "geometry", err);
    if (r != SVO_OK) {
        svo_free(a, at, n->count + 1, sizeof *at);
        return r;
    }
    uint32_t *w = (uint32_t *)(void *)p->words[level].data;
    for (uint64_t i = 0; i < n->count; i++)
        emit_node(w + at[i], n->items + n->start[i], ow, child_position, child_size, bricks, p->view.lod, svo_view_brick_lod(&p->view));
    p->words[level].size = (size_t)words * 4;
    *l = (svo_view_level){.words = w, .word_count = words, .node_count = n->count, .offset_words = ow};
    *position = at;
    return SVO_OK;
}

svo_result svoi_layout_plain(svo_packed *p, svoi_nodes *levels, svoi_bricks *bricks, svo_error *err)
{
    const svo_allocator *a = &p->memory.base;
    p->view.layout = SVO_LAYOUT_PLAIN;
    svo_buffer_init(&p->bricks, a);
    if (!svo_buffer_reserve(&p->bricks, (size_t)bricks->count * 8)) return svoi_no_memory(p, "geometry", err);
    if (bricks->count != 0) memcpy(p->bricks.data, bricks->bits, (size_t)bricks->count * 8);
    p->bricks.size = (size_t)bricks->count * 8;
    p->view.bricks = (const uint64_t *)(const void *)p->bricks.data;
    p->view.brick_count = bricks->count;
    svoi_bricks_free(bricks);

    uint32_t *position = NULL; /* of the level below */
    uint64_t positions = 0;
    svo_result r = SVO_OK;
    uint32_t bottom = p->view.brick_level;
    for (uint32_t level = bottom; level-- > 0 && r == SVO_OK;) {
        bool above_bricks = level + 1 == bottom;
        uint32_t *next = NULL;
        svo_buffer_init(&p->words[level], a);
        r = emit_level(p, level, &levels[level], position, above_bricks ? NULL : levels[level + 1].size, &next, err);
        svo_free(a, position, positions, sizeof *position);
        position = next;
        positions = levels[level].count + 1;
        if (!above_bricks) svoi_nodes_free(&levels[level + 1]);
    }
    if (r == SVO_OK && bottom != 0) p->view.root = position[p->view.root];
    svo_free(a, position, positions, sizeof *position);
    return r;
}
