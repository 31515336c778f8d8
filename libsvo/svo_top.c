/* The table of the cells of an upper level. */
#include "svoi_fast.h"

#include <string.h>

typedef struct walk {
    svo_view_node node;
    uint64_t code;
    uint32_t left; /* children that are still to come */
} walk;

/* All cells of the level in Morton order, with their codes. */
static void list_cells(const svo_view *v, svoi_top *t, uint64_t *code)
{
    walk stack[SVO_MAX_DEPTH];
    uint64_t n = 0;
    uint32_t level = 0;
    stack[0] = (walk){svo_view_root(v), 0, 0};
    stack[0].left = svo_view_mask(v, 0, stack[0].node);
    for (;;) {
        if (level == t->level) {
            const svo_view_node *node = &stack[level].node;
            SVO_ASSERT(n < t->cell_count);
            code[n] = stack[level].code;
            svoi_best_node at = v->layout == SVO_LAYOUT_BEST ? svoi_best_unpack(node->at) : (svoi_best_node){node->at, 0};
            t->cell[n] = (svoi_top_cell){node->full ? SVOI_TOP_FULL : svoi_top_place(at, node->symmetry), node->attribute};
            if (t->size != NULL) t->size[n] = node->size;
            n++;
            level--;
        }
        while (stack[level].left == 0) {
            if (level-- == 0) {
                SVO_ASSERT(n == t->cell_count);
                return;
            }
        }
        uint32_t octant = (uint32_t)__builtin_ctz(stack[level].left);
        stack[level].left &= stack[level].left - 1;
        stack[level + 1] = (walk){svo_view_child(v, level, stack[level].node, octant), stack[level].code << 3 | octant, 0};
        level++;
        if (level < t->level) stack[level].left = svo_view_mask(v, level, stack[level].node);
    }
}

/* Nodes of the steps from the last to the first; the codes become those of the nodes. `node` is filled from its end. */
static void join_cells(svoi_top *t, uint64_t *code)
{
    uint64_t count = t->cell_count, end = t->node_count, below = 0; /* `below`: where the next step's nodes begin */
    for (uint32_t step = t->steps; step-- > 0;) {
        uint64_t parents = 0;
        for (uint64_t i = 0; i < count; i++) parents += i == 0 || code[i] >> 6 != code[i - 1] >> 6;
        svoi_top_node *n = t->node + (end - parents);
        uint64_t k = 0, last = 0;
        for (uint64_t i = 0; i < count; i++) {
            uint64_t bit = (uint64_t)1 << (code[i] & 63), parent = code[i] >> 6;
            if (i == 0 || parent != last) n[k++] = (svoi_top_node){0, below + i};
            n[k - 1].mask |= bit;
            code[k - 1] = last = parent;
        }
        count = parents;
        end -= parents;
        if (step + 1 == t->steps) t->last_step = end;
        below = end;
    }
    SVO_ASSERT(count == 1 && end == 0);
}

static uint64_t count_nodes(const svo_view *v, uint32_t level)
{
    uint64_t n = 1; /* the root's step may be of one level */
    while (level > 2) level -= 2, n += v->nodes[level];
    return n;
}

/* The deepest with at most so many cells, and nodes above them. */
static uint32_t choose_level(const svo_view *v, uint64_t cells, uint32_t lowest)
{
    uint32_t level = 0;
    while (level < lowest && v->nodes[level + 1] <= cells) level++;
    while (level >= 2 && count_nodes(v, level) > cells) level--;
    return level;
}

/* What records and their cells replace. */
static void free_wide(svoi_top *t, const svo_allocator *a)
{
    svo_free(a, t->size, t->cell_count, sizeof *t->size);
    svo_free(a, t->node, t->node_count, sizeof *t->node);
    svo_free(a, t->cell, t->cell_count, sizeof *t->cell);
    t->size = NULL, t->node = NULL, t->cell = NULL;
}

/* Without memory: none. */
static void make_bricks(svoi_top *t, const svo_view *v, const svo_allocator *a)
{
    t->brick_count = v->brick_count;
    t->brick = svo_alloc(a, v->brick_count, sizeof *t->brick);
    for (uint64_t i = 0; t->brick != NULL && i < v->brick_count; i++) t->brick[i] = (uint8_t)svoi_brick_size(svo_view_brick_lod(v), v->bricks[i]);
}

svoi_top *svoi_top_make(const svo_view *v, uint64_t cells, uint64_t records, const svo_allocator *a)
{
    if (v->empty || v->depth < 4 || (v->layout != SVO_LAYOUT_FAST && v->layout != SVO_LAYOUT_BEST)) return NULL;
    uint64_t bytes = v->layout == SVO_LAYOUT_FAST ? v->fast.tree_bytes : v->best_stream_bytes;
    const uint32_t lowest = v->brick_level < 4 ? v->brick_level - 1 : v->brick_level - 2; /* 16^3, so that there are records */
    uint32_t level = choose_level(v, cells, lowest);
    if (level >= 2 && !svoi_records_fit(v, level, records) && bytes >> SVOI_TOP_SHARE > cells) level = choose_level(v, bytes >> SVOI_TOP_SHARE, lowest);
    if (level < 2 || bytes >> (SVOI_TOP_PLACE_BITS - 3) != 0) return NULL;
    svoi_top *t = svo_calloc(a, 1, sizeof *t);
    if (t == NULL) return NULL;
    t->level = level;
    t->shift = v->tree_depth - level;
    t->steps = (level + 1) / 2;
    t->cell_count = v->nodes[level];
    t->node_count = count_nodes(v, level);
    t->cell = svo_alloc(a, t->cell_count, sizeof *t->cell);
    t->node = svo_alloc(a, t->node_count, sizeof *t->node);
    if (v->layout == SVO_LAYOUT_BEST && !v->unnumbered) t->size = svo_alloc(a, t->cell_count, sizeof *t->size);
    uint64_t *code = svo_alloc(a, t->cell_count, sizeof *code);
    bool ok = t->cell != NULL && t->node != NULL && code != NULL && (t->size != NULL || v->layout != SVO_LAYOUT_BEST || v->unnumbered);
    if (ok) {
        list_cells(v, t, code);
        join_cells(t, code);
    }
    svo_free(a, code, t->cell_count, sizeof *code);
    if (ok && svoi_records_fit(v, level, records)) svoi_records_make(t, v, a);
    if (!ok || t->record != NULL) free_wide(t, a);
    else if (v->layout == SVO_LAYOUT_FAST && !v->unnumbered) svoi_sizes_make(&t->sizes, v, a);
    if (ok && v->layout == SVO_LAYOUT_FAST && !v->unnumbered) make_bricks(t, v, a);
    if (ok) return t;
    svoi_top_free(t, a);
    return NULL;
}

void svo_view_accelerate(svo_view *v, const svo_allocator *a)
{
    svoi_top_free(v->top, a);
    v->top = NULL; /* what makes the tables reads the view */
    v->top = svoi_top_make(v, SVOI_TOP_CELLS, SVOI_RECORDS, a);
}

void svoi_top_free(svoi_top *t, const svo_allocator *a)
{
    if (t == NULL) return;
    svoi_records_free(t, a);
    svoi_sizes_free(&t->sizes, a);
    svo_free(a, t->brick, t->brick_count, sizeof *t->brick);
    free_wide(t, a);
    svo_free(a, t, 1, sizeof *t);
}
