/* Making the second form of an octree: see svoi_rays.h. */
#include <string.h>

#include "svoi_rays.h"

/* A 4x4x4 node as it is in the file, once; `children` of the level below follow in the order of bits. */
typedef struct node {
    svo_view_node view;
    uint64_t mask;
    uint64_t first_child; /* in the level's list of children; of nodes whose children are bricks: the unit of the first */
    uint64_t units;       /* where its children's block is */
    uint32_t box;
} node;

typedef struct level {
    node *nodes;
    uint64_t count, capacity;
    uint32_t *children; /* numbers in the next level */
    uint32_t *before;   /* of each child, see svoi_rays.h */
    uint64_t child_count, child_capacity, before_capacity;
    uint32_t *table; /* hash of the views: number + 1 */
    uint64_t table_size;
} level;

typedef struct builder {
    const svo_view *view;
    const svo_allocator *allocator;
    uint64_t limit, used; /* bytes */
    level levels[SVOI_RAYS_LEVELS];
    uint64_t *bricks; /* blocks of bricks, one after the other */
    uint64_t brick_count, brick_capacity;
    uint32_t *brick_before;
    uint64_t brick_before_capacity;
    bool numbers; /* attributes are numbered, in 31 bits */
    uint32_t count; /* levels, bricks included */
} builder;

typedef enum outcome { DONE, TOO_LARGE, NO_MEMORY } outcome;

static outcome grow(builder *b, void **data, uint64_t *capacity, uint64_t needed, size_t size)
{
    if (needed <= *capacity) return DONE;
    uint64_t larger = *capacity + *capacity / 2 + 1024;
    if (larger < needed) larger = needed;
    if (larger * size > b->limit) return TOO_LARGE;
    void *p = svo_alloc(b->allocator, larger, size);
    if (p == NULL) return NO_MEMORY;
    if (*capacity != 0) memcpy(p, *data, *capacity * size);
    svo_free(b->allocator, *data, *capacity, size);
    *data = p;
    *capacity = larger;
    return DONE;
}

static uint64_t hash(svo_view_node v)
{
    uint64_t h = (v.at ^ (uint64_t)v.symmetry << 58 ^ (uint64_t)v.full << 57) * 0x9e3779b97f4a7c15u;
    return h ^ h >> 32;
}
static bool same(const svo_view_node *a, const svo_view_node *b)
{
    return a->full == b->full && (a->full || (a->at == b->at && a->symmetry == b->symmetry));
}

static outcome grow_table(builder *b, level *l)
{
    uint64_t size = l->table_size == 0 ? 1024 : 4 * l->table_size;
    if (size * sizeof *l->table > b->limit) return TOO_LARGE;
    uint32_t *table = svo_calloc(b->allocator, size, sizeof *table);
    if (table == NULL) return NO_MEMORY;
    for (uint64_t i = 0; i < l->count; i++) {
        uint64_t slot = hash(l->nodes[i].view) & (size - 1);
        while (table[slot] != 0) slot = (slot + 1) & (size - 1);
        table[slot] = (uint32_t)i + 1;
    }
    svo_free(b->allocator, l->table, l->table_size, sizeof *table);
    l->table = table;
    l->table_size = size;
    return DONE;
}

/* Number of a node in its level, new if it has not been met. */
static outcome number_of(builder *b, level *l, svo_view_node v, uint32_t *number)
{
    outcome o = DONE;
    if (v.full) v.at = 0, v.symmetry = 0, v.size = 0;
    v.attribute = 0; /* numbers count from that of the node */
    if (2 * (l->count + 1) > l->table_size && (o = grow_table(b, l)) != DONE) return o;
    uint64_t slot = hash(v) & (l->table_size - 1);
    for (; l->table[slot] != 0; slot = (slot + 1) & (l->table_size - 1))
        if (same(&l->nodes[l->table[slot] - 1].view, &v)) {
            *number = l->table[slot] - 1;
            return DONE;
        }
    if (l->count == UINT32_MAX - 1) return TOO_LARGE;
    if ((o = grow(b, (void **)&l->nodes, &l->capacity, l->count + 1, sizeof *l->nodes)) != DONE) return o;
    l->nodes[l->count].view = v;
    l->table[slot] = (uint32_t)++l->count;
    *number = (uint32_t)l->count - 1;
    return DONE;
}

/* Bit of svoi_rays.h of a cell given as two octants, the coarser first. */
static uint32_t cell_bit(uint32_t a, uint32_t b)
{
    uint32_t x = (a & 1) << 1 | (b & 1), y = (a & 2) | (b >> 1 & 1), z = (a >> 1 & 2) | (b >> 2 & 1);
    return x | y << 2 | z << 4;
}

/* A brick's bits in the order of svoi_rays.h. */
static uint64_t brick_mask(uint64_t morton)
{
    uint64_t mask = 0;
    while (morton != 0) {
        uint32_t bit = (uint32_t)__builtin_ctzll(morton);
        morton &= morton - 1;
        mask |= (uint64_t)1 << cell_bit(bit >> 3, bit & 7);
    }
    return mask;
}

/* The non-empty grandchildren of a node of the octree's level `at` (-1: virtual, with the root as its first octant), by bit. */
static uint64_t expand(const svo_view *v, int32_t at, svo_view_node n, svo_view_node cells[64])
{
    uint64_t mask = 0;
    uint32_t outer = at < 0 ? 1 : svo_view_mask(v, (uint32_t)at, n);
    for (uint32_t a = 0; a < 8; a++) {
        if (!(outer >> a & 1)) continue;
        svo_view_node child = at < 0 ? n : svo_view_child(v, (uint32_t)at, n, a);
        uint32_t inner = svo_view_mask(v, (uint32_t)(at + 1), child);
        for (uint32_t c = 0; c < 8; c++) {
            if (!(inner >> c & 1)) continue;
            uint32_t bit = cell_bit(a, c);
            cells[bit] = svo_view_child(v, (uint32_t)(at + 1), child, c);
            mask |= (uint64_t)1 << bit;
        }
    }
    return mask;
}

/* Smallest box of the cells of a mask, inclusive, as x y z low and high. */
static void mask_box(uint64_t mask, uint32_t low[3], uint32_t high[3])
{
    uint64_t plane[3] = {0x1111111111111111u, 0x000f000f000f000fu, 0xffffu};
    for (uint32_t k = 0; k < 3; k++) {
        low[k] = 4, high[k] = 0;
        for (uint32_t i = 0; i < 4; i++)
            if (mask & plane[k] << (i << 2 * k)) {
                if (low[k] == 4) low[k] = i;
                high[k] = i;
            }
    }
}
static uint32_t pack_box(const uint32_t low[3], const uint32_t high[3])
{
    return low[0] | low[1] << 4 | low[2] << 8 | high[0] << 12 | high[1] << 16 | high[2] << 20;
}
static void add_box(uint32_t low[3], uint32_t high[3], uint32_t bit, const uint32_t inner_low[3], const uint32_t inner_high[3])
{
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t cell = 4 * (bit >> 2 * k & 3), a = cell + inner_low[k], b = cell + inner_high[k];
        if (a < low[k]) low[k] = a;
        if (b > high[k]) high[k] = b;
    }
}

static uint32_t before_of(svo_view_node child) { return (uint32_t)child.attribute << 1 | child.full; }

/* All distinct nodes, from the root downwards. */
static outcome collect(builder *b)
{
    const svo_view *v = b->view;
    int32_t at = (int32_t)v->tree_depth - 2 * (int32_t)b->count; /* octree level of the root node: 0 or -1 */
    outcome o;
    uint32_t number;
    if (b->count == 1) return DONE;
    if ((o = number_of(b, &b->levels[0], svo_view_root(v), &number)) != DONE) return o;
    for (uint32_t i = 0; i + 1 < b->count; i++, at += 2) {
        level *l = &b->levels[i];
        bool bricks = i + 2 == b->count;
        for (uint64_t k = 0; k < l->count; k++) {
            svo_view_node cells[64];
            uint64_t mask = expand(v, at, l->nodes[k].view, cells), count = (uint64_t)__builtin_popcountll(mask), rest = mask;
            node *n = &l->nodes[k];
            n->mask = mask;
            if (bricks) {
                uint32_t low[3] = {16, 16, 16}, high[3] = {0, 0, 0}, voxels = 0;
                if ((o = grow(b, (void **)&b->bricks, &b->brick_capacity, b->brick_count + count, 8)) != DONE) return o;
                if (b->numbers && (o = grow(b, (void **)&b->brick_before, &b->brick_before_capacity, b->brick_count + count, 4)) != DONE) return o;
                n->first_child = b->brick_count;
                for (; rest != 0; rest &= rest - 1) {
                    uint32_t bit = (uint32_t)__builtin_ctzll(rest), inner_low[3], inner_high[3];
                    uint64_t brick = brick_mask(svo_view_brick(v, cells[bit]));
                    if (b->numbers) b->brick_before[b->brick_count] = before_of(cells[bit]);
                    b->bricks[b->brick_count++] = brick;
                    mask_box(brick, inner_low, inner_high);
                    add_box(low, high, bit, inner_low, inner_high);
                    voxels += (uint32_t)__builtin_popcountll(brick);
                }
                n->box = pack_box(low, high);
                if (voxels == (high[0] - low[0] + 1) * (high[1] - low[1] + 1) * (high[2] - low[2] + 1)) n->box |= SVOI_RAYS_SOLID;
                continue;
            }
            if ((o = grow(b, (void **)&l->children, &l->child_capacity, l->child_count + count, sizeof *l->children)) != DONE) return o;
            if (b->numbers && (o = grow(b, (void **)&l->before, &l->before_capacity, l->child_count + count, sizeof *l->before)) != DONE) return o;
            n = &l->nodes[k];
            n->first_child = l->child_count;
            for (; rest != 0; rest &= rest - 1) {
                svo_view_node child = cells[__builtin_ctzll(rest)];
                if (b->numbers) l->before[l->child_count] = before_of(child);
                if ((o = number_of(b, &b->levels[i + 1], child, &number)) != DONE) return o;
                l->children[l->child_count++] = number;
            }
        }
        svo_free(b->allocator, l->table, l->table_size, sizeof *l->table);
        l->table = NULL, l->table_size = 0;
    }
    return DONE;
}

/* Boxes from those of the children. */
static void fit_boxes(builder *b)
{
    for (uint32_t i = b->count - 1; i-- > 0;) {
        level *l = &b->levels[i];
        if (i + 2 == b->count) continue;
        for (uint64_t k = 0; k < l->count; k++) {
            node *n = &l->nodes[k];
            uint32_t low[3] = {16, 16, 16}, high[3] = {0, 0, 0};
            uint64_t rest = n->mask;
            for (uint64_t c = n->first_child; rest != 0; rest &= rest - 1, c++) {
                uint32_t box = b->levels[i + 1].nodes[l->children[c]].box, inner_low[3], inner_high[3];
                for (uint32_t j = 0; j < 3; j++) inner_low[j] = box >> (4 * j + 2) & 3, inner_high[j] = box >> (4 * j + 14) & 3;
                add_box(low, high, (uint32_t)__builtin_ctzll(rest), inner_low, inner_high);
            }
            n->box = pack_box(low, high);
        }
    }
}

static void put_node(uint64_t *unit, const node *n)
{
    unit[0] = n->mask;
    unit[1] = n->units | (uint64_t)n->box << 32;
}

/* Blocks in the order of levels and nodes; bricks last, as they are. */
static outcome lay_out(builder *b, svo_rays *r)
{
    uint64_t at = 2;
    uint32_t parents = b->count - 1;
    for (uint32_t i = 0; i < parents; i++) {
        level *l = &b->levels[i];
        bool bricks = i + 2 == b->count;
        for (uint64_t k = 0; k < l->count; k++) {
            l->nodes[k].units = bricks ? at + l->nodes[k].first_child : at + 2 * l->nodes[k].first_child;
        }
        at += bricks ? b->brick_count : 2 * l->child_count;
        r->nodes += l->count;
    }
    r->bricks = b->brick_count;
    r->unit_count = at;
    r->unit_capacity = at + SVOI_RAYS_PAD;
    if (at > UINT32_MAX || r->unit_capacity * 8 > b->limit) return TOO_LARGE;
    r->units = svo_alloc(b->allocator, r->unit_capacity, 8);
    if (r->units == NULL) return NO_MEMORY;
    memset(r->units + at, 0, SVOI_RAYS_PAD * 8);
    put_node(r->units, &b->levels[0].nodes[0]);
    if (b->numbers) {
        if (r->unit_capacity * 12 > b->limit) return TOO_LARGE;
        r->before = svo_calloc(b->allocator, r->unit_capacity, sizeof *r->before);
        if (r->before == NULL) return NO_MEMORY;
        memcpy(r->before + at - b->brick_count, b->brick_before, b->brick_count * sizeof *r->before);
    }
    at = 2;
    for (uint32_t i = 0; i + 1 < parents; i++) {
        level *l = &b->levels[i];
        for (uint64_t c = 0; c < l->child_count; c++, at += 2) {
            put_node(r->units + at, &b->levels[i + 1].nodes[l->children[c]]);
            if (b->numbers) r->before[at] = l->before[c];
        }
    }
    memcpy(r->units + at, b->bricks, b->brick_count * 8);
    return DONE;
}

static void set_order(svo_rays *r)
{
    for (uint32_t a = 0; a < 64; a++)
        for (uint32_t b = 0; b < a; b++) r->earlier[cell_bit(a >> 3, a & 7)] |= (uint64_t)1 << cell_bit(b >> 3, b & 7);
}

/* Bounds of everything, for rays that pass by. */
static void set_bounds(svo_rays *r, uint32_t box)
{
    for (uint32_t k = 0; k < 3; k++) {
        r->low[k] = (int32_t)((box >> 4 * k & 15) << (SVOI_RAYS_BITS - 4));
        r->high[k] = (int32_t)(((box >> (4 * k + 12) & 15) + 1) << (SVOI_RAYS_BITS - 4));
        r->root_low[k] = 0;
        r->root_high[k] = (int32_t)1 << (r->view->tree_depth + r->fraction);
    }
}

static outcome build(builder *b, svo_rays *r)
{
    outcome o = collect(b);
    if (o != DONE) return o;
    set_order(r);
    if (b->count > 1) {
        fit_boxes(b);
        set_bounds(r, b->levels[0].nodes[0].box);
        return lay_out(b, r);
    }
    set_bounds(r, pack_box((const uint32_t[3]){0, 0, 0}, (const uint32_t[3]){15, 15, 15}));
    r->unit_count = 2;
    r->unit_capacity = 2 + SVOI_RAYS_PAD;
    r->units = svo_calloc(b->allocator, r->unit_capacity, 8);
    if (r->units == NULL) return NO_MEMORY;
    r->units[0] = brick_mask(svo_view_brick(b->view, svo_view_root(b->view)));
    r->bricks = 1;
    if (!b->numbers) return DONE;
    r->before = svo_calloc(b->allocator, r->unit_capacity, sizeof *r->before);
    if (r->before == NULL) return NO_MEMORY;
    r->before[0] = before_of(svo_view_root(b->view));
    return DONE;
}

/* The tables are here and not with their kernels so that only functions that the processor can run are ever entered. */
static const svoi_rays_code *choose_code(svo_ray_kernel wanted, svo_ray_kernel *chosen)
{
#if defined(SVO_COMPILED_AVX512) && defined(__x86_64__)
    static const svoi_rays_code avx512 = {svoi_rays_prepare_avx512, svoi_rays_begin_avx512, svoi_rays_trace_avx512, svoi_rays_hits_avx512, svoi_rays_packet_avx512};
    if ((wanted == SVO_KERNEL_AUTO || wanted == SVO_KERNEL_AVX512) && svoi_rays_have_avx512()) {
        *chosen = SVO_KERNEL_AVX512;
        return &avx512;
    }
#endif
#if defined(SVO_COMPILED_AVX2) && defined(__x86_64__)
    static const svoi_rays_code avx2 = {svoi_rays_prepare_avx2, svoi_rays_begin_avx2, svoi_rays_trace_avx2, svoi_rays_hits_avx2, svoi_rays_packet_avx2};
    if (wanted != SVO_KERNEL_PORTABLE && svoi_rays_have_avx2()) {
        *chosen = SVO_KERNEL_AVX2;
        return &avx2;
    }
#endif
    (void)wanted;
    *chosen = SVO_KERNEL_PORTABLE;
    return NULL;
}

svo_rays_options svo_default_rays_options(void)
{
    svo_rays_options o = {.memory = (uint64_t)1 << 30};
    return o;
}

svo_result svo_rays_build(const svo_view *view, const svo_rays_options *options, svo_rays **out, svo_rays_report *report, svo_error *err)
{
    svo_rays_options o = options != NULL ? *options : svo_default_rays_options();
    double start = svo_seconds();
    svo_rays *r = svo_calloc(o.allocator, 1, sizeof *r);
    if (r == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    r->view = view;
    r->allocator = o.allocator;
    r->code = choose_code(view->empty ? SVO_KERNEL_PORTABLE : o.kernel, &r->kernel);
    if (r->code != NULL) {
        builder b = {.view = view, .allocator = o.allocator, .limit = o.memory != 0 ? o.memory : (uint64_t)1 << 30};
        b.count = r->levels = (view->tree_depth + 1) / 2;
        b.numbers = !view->unnumbered && view->attribute_count >> 31 == 0;
        r->fraction = SVOI_RAYS_BITS - 2 * r->levels;
        outcome done = build(&b, r);
        for (uint32_t i = 0; i < SVOI_RAYS_LEVELS; i++) {
            level *l = &b.levels[i];
            svo_free(b.allocator, l->nodes, l->capacity, sizeof *l->nodes);
            svo_free(b.allocator, l->children, l->child_capacity, sizeof *l->children);
            svo_free(b.allocator, l->before, l->before_capacity, sizeof *l->before);
            svo_free(b.allocator, l->table, l->table_size, sizeof *l->table);
        }
        svo_free(b.allocator, b.bricks, b.brick_capacity, 8);
        svo_free(b.allocator, b.brick_before, b.brick_before_capacity, sizeof *b.brick_before);
        if (done == NO_MEMORY) {
            svo_rays_free(r);
            return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the form of an octree that rays traverse");
        }
        if (done == TOO_LARGE) r->kernel = SVO_KERNEL_PORTABLE, r->code = NULL, r->nodes = r->bricks = 0;
    }
    if (report != NULL) *report = (svo_rays_report){r->kernel, r->unit_capacity * (r->before != NULL ? 12 : 8), r->nodes, r->bricks, svo_seconds() - start};
    *out = r;
    return SVO_OK;
}

void svo_rays_free(svo_rays *r)
{
    if (r == NULL) return;
    svo_free(r->allocator, r->units, r->unit_capacity, 8);
    svo_free(r->allocator, r->before, r->unit_capacity, sizeof *r->before);
    svo_free(r->allocator, r, 1, sizeof *r);
}
