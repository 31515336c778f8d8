/* The 48 turns as constant tables, and the merging of subtrees that are equal under them.
 *
 * A node's canonical form is the least of its turned forms, ordered by child mask and then by the children's references,
 * whose turns are reduced by the child's stabilizer. Because references are exact (two subtrees are equal under a turn just
 * when their reduced references name the same number), so is the merging, level by level, for any group. Only turns that
 * make the mask least have to be tried: of 48, six on average. */
#include "svoi_symmetry.h"

#include <string.h>

#include "svo_task.h"

/* --- tables ------------------------------------------------------------------------------------------------------ */

/* Octant o with axis k moved to p_k, mirrored by f. */
#define OCTANT(p0, p1, p2, f, o) ((((o)&1) << (p0) | ((o) >> 1 & 1) << (p1) | ((o) >> 2 & 1) << (p2)) ^ (f))
#define OCTANTS(p0, p1, p2, f)                                                                                       \
    {OCTANT(p0, p1, p2, f, 0), OCTANT(p0, p1, p2, f, 1), OCTANT(p0, p1, p2, f, 2), OCTANT(p0, p1, p2, f, 3),         \
     OCTANT(p0, p1, p2, f, 4), OCTANT(p0, p1, p2, f, 5), OCTANT(p0, p1, p2, f, 6), OCTANT(p0, p1, p2, f, 7)}
#define MIRRORS(p0, p1, p2)                                                                                          \
    OCTANTS(p0, p1, p2, 0), OCTANTS(p0, p1, p2, 1), OCTANTS(p0, p1, p2, 2), OCTANTS(p0, p1, p2, 3),                  \
        OCTANTS(p0, p1, p2, 4), OCTANTS(p0, p1, p2, 5), OCTANTS(p0, p1, p2, 6), OCTANTS(p0, p1, p2, 7)

/* A mask moves as the sum of its bits. */
#define BIT(p0, p1, p2, f, m, o) (((m) >> (o)&1) << OCTANT(p0, p1, p2, f, o))
#define MASK(p0, p1, p2, f, m)                                                                                       \
    (BIT(p0, p1, p2, f, m, 0) | BIT(p0, p1, p2, f, m, 1) | BIT(p0, p1, p2, f, m, 2) | BIT(p0, p1, p2, f, m, 3) |     \
     BIT(p0, p1, p2, f, m, 4) | BIT(p0, p1, p2, f, m, 5) | BIT(p0, p1, p2, f, m, 6) | BIT(p0, p1, p2, f, m, 7))
#define MASKS_4(p0, p1, p2, f, m)                                                                                    \
    MASK(p0, p1, p2, f, m), MASK(p0, p1, p2, f, (m) + 1), MASK(p0, p1, p2, f, (m) + 2), MASK(p0, p1, p2, f, (m) + 3)
#define MASKS_16(p0, p1, p2, f, m)                                                                                   \
    MASKS_4(p0, p1, p2, f, m), MASKS_4(p0, p1, p2, f, (m) + 4), MASKS_4(p0, p1, p2, f, (m) + 8), MASKS_4(p0, p1, p2, f, (m) + 12)
#define MASKS_64(p0, p1, p2, f, m)                                                                                   \
    MASKS_16(p0, p1, p2, f, m), MASKS_16(p0, p1, p2, f, (m) + 16), MASKS_16(p0, p1, p2, f, (m) + 32), MASKS_16(p0, p1, p2, f, (m) + 48)
#define MASKS(p0, p1, p2, f)                                                                                         \
    {MASKS_64(p0, p1, p2, f, 0), MASKS_64(p0, p1, p2, f, 64), MASKS_64(p0, p1, p2, f, 128), MASKS_64(p0, p1, p2, f, 192)}

const svoi_turn_table svoi_turns = {
    .octant = {MIRRORS(0, 1, 2), MIRRORS(0, 2, 1), MIRRORS(1, 0, 2), MIRRORS(1, 2, 0), MIRRORS(2, 0, 1), MIRRORS(2, 1, 0)},
    .axes_after = {{0, 1, 2, 3, 4, 5}, {1, 0, 4, 5, 2, 3}, {2, 3, 0, 1, 5, 4}, {3, 2, 5, 4, 0, 1}, {4, 5, 1, 0, 3, 2}, {5, 4, 3, 2, 1, 0}},
    .axes_inverse = {0, 1, 2, 4, 3, 5},
    .axes_mask = {MASKS(0, 1, 2, 0), MASKS(0, 2, 1, 0), MASKS(1, 0, 2, 0), MASKS(1, 2, 0, 0), MASKS(2, 0, 1, 0), MASKS(2, 1, 0, 0)},
    .mirror_mask = {MASKS(0, 1, 2, 0), MASKS(0, 1, 2, 1), MASKS(0, 1, 2, 2), MASKS(0, 1, 2, 3), MASKS(0, 1, 2, 4),
                    MASKS(0, 1, 2, 5), MASKS(0, 1, 2, 6), MASKS(0, 1, 2, 7)},
};

/* --- bricks ------------------------------------------------------------------------------------------------------ */

/* The group is walked so that each step is one mirror, or one exchange of axes between two rounds of eight mirrors. */
uint64_t svoi_brick_canonical(svoi_group group, uint64_t bits, uint32_t *turn, uint64_t *stabilizer)
{
    static const uint8_t axes[6] = {0, 2, 4, 5, 3, 1}; /* xy and yz exchanged in turns, done after what was done before */
    uint64_t best = bits, to_best = 1, b = bits; /* turns that make `best` of `bits` */
    uint32_t rounds = group == SVOI_ALL ? 6 : 1, mirrors = group == SVOI_IDENTITY ? 1 : 8, f = 0;
    for (uint32_t round = 0; round < rounds; round++) {
        if (round != 0) {
            /* exchanging axes exchanges the mirrors done so far */
            b = round & 1 ? svoi_brick_exchange_xy(b) : svoi_brick_exchange_yz(b);
            f = svoi_turns.octant[round & 1 ? 16 : 8][f];
        }
        for (uint32_t i = 0; i < mirrors; i++) {
            if (i != 0) {
                uint32_t axis = (uint32_t)__builtin_ctz(i);
                b = axis == 0 ? svoi_brick_mirror_x(b) : axis == 1 ? svoi_brick_mirror_y(b) : svoi_brick_mirror_z(b);
                f ^= 1u << axis;
            }
            if (b > best) continue;
            uint64_t bit = (uint64_t)1 << (8 * (uint32_t)axes[round] + f);
            to_best = b == best ? to_best | bit : bit;
            best = b;
        }
    }
    /* g s = h for turns g, h that make the same of it, s = g^-1 h: so best is left alone by h g^-1 */
    uint32_t first_back = svoi_turn_inverse((uint32_t)__builtin_ctzll(to_best)), least = SVOI_TURNS;
    uint64_t stays = 0;
    for (uint64_t s = to_best; s != 0; s &= s - 1) {
        uint32_t g = (uint32_t)__builtin_ctzll(s), back = svoi_turn_inverse(g);
        stays |= (uint64_t)1 << svoi_turn_after(g, first_back);
        if (back < least) least = back;
    }
    *turn = least;
    *stabilizer = stays;
    return best;
}

/* --- storage ----------------------------------------------------------------------------------------------------- */

/* A level never has more nodes than it had before merging: its arrays are made for these and cut afterwards. */
static bool level_alloc(const svo_allocator *a, svoi_symlevel *l, uint64_t count, uint64_t items)
{
    l->capacity = count;
    l->item_capacity = items;
    l->uses = svo_calloc(a, count, sizeof *l->uses);
    l->stabilizer = svo_alloc(a, count, sizeof *l->stabilizer);
    bool ok = l->uses != NULL && l->stabilizer != NULL;
    if (items == 0) {
        l->bits = svo_alloc(a, count, sizeof *l->bits);
        return ok && l->bits != NULL;
    }
    l->items = svo_alloc(a, items, sizeof *l->items);
    l->turn = svo_alloc(a, items, sizeof *l->turn);
    l->start = svo_alloc(a, count, sizeof *l->start);
    l->size = svo_alloc(a, count, sizeof *l->size);
    return ok && l->items != NULL && l->turn != NULL && l->start != NULL && l->size != NULL;
}

static void level_free(const svo_allocator *a, svoi_symlevel *l)
{
    svo_free(a, l->bits, l->capacity, sizeof *l->bits);
    svo_free(a, l->items, l->item_capacity, sizeof *l->items);
    svo_free(a, l->turn, l->item_capacity, sizeof *l->turn);
    svo_free(a, l->start, l->capacity, sizeof *l->start);
    svo_free(a, l->size, l->capacity, sizeof *l->size);
    svo_free(a, l->uses, l->capacity, sizeof *l->uses);
    svo_free(a, l->stabilizer, l->capacity, sizeof *l->stabilizer);
    *l = (svoi_symlevel){0};
}

/* Give back what merging has left unused. Where there is no room for a copy the level stays as it is. */
static void level_cut(const svo_allocator *a, svoi_symlevel *l)
{
    svoi_symlevel cut = {.count = l->count, .item_count = l->item_count};
    if (l->count > l->capacity - l->capacity / 8 || !level_alloc(a, &cut, l->count, l->item_count)) {
        level_free(a, &cut);
        return;
    }
    memcpy(cut.uses, l->uses, (size_t)l->count * sizeof *l->uses);
    memcpy(cut.stabilizer, l->stabilizer, (size_t)l->count);
    if (l->bits != NULL) memcpy(cut.bits, l->bits, (size_t)l->count * sizeof *l->bits);
    if (l->items != NULL) {
        memcpy(cut.items, l->items, (size_t)l->item_count * sizeof *l->items);
        memcpy(cut.turn, l->turn, (size_t)l->item_count);
        memcpy(cut.start, l->start, (size_t)l->count * sizeof *l->start);
        memcpy(cut.size, l->size, (size_t)l->count * sizeof *l->size);
    }
    level_free(a, l);
    *l = cut;
}

void svoi_symdag_free_level(svoi_symdag *d, uint32_t level) { level_free(d->a, &d->level[level]); }

void svoi_symdag_free(svoi_symdag *d)
{
    for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) level_free(d->a, &d->level[l]);
}

static uint8_t subgroup_index(svoi_symdag *d, uint64_t stabilizer)
{
    for (uint32_t i = 0; i < d->subgroup_count; i++)
        if (d->subgroup[i] == stabilizer) return (uint8_t)i;
    SVO_ASSERT(d->subgroup_count < SVOI_SUBGROUPS);
    uint32_t i = d->subgroup_count++;
    d->subgroup[i] = stabilizer;
    for (uint32_t g = 0; g < SVOI_TURNS; g++) {
        uint32_t least = SVOI_TURNS;
        for (uint64_t s = stabilizer; s != 0; s &= s - 1) {
            uint32_t same = svoi_turn_after(g, (uint32_t)__builtin_ctzll(s));
            if (same < least) least = same;
        }
        d->least[i][g] = (uint8_t)least;
    }
    return (uint8_t)i;
}

/* --- merging a level --------------------------------------------------------------------------------------------- */

/* Where the nodes of a level before merging went. */
typedef struct moved {
    uint32_t *number;
    uint8_t *turn;
    uint64_t count;
} moved;

static bool moved_alloc(const svo_allocator *a, moved *m, uint64_t count)
{
    *m = (moved){svo_alloc(a, count, sizeof *m->number), svo_alloc(a, count, sizeof *m->turn), count};
    return m->number != NULL && m->turn != NULL;
}

static void moved_free(const svo_allocator *a, moved *m)
{
    svo_free(a, m->number, m->count, sizeof *m->number);
    svo_free(a, m->turn, m->count, sizeof *m->turn);
    *m = (moved){0};
}

/* A node in canonical form; `back` turns it into the node it was made of. */
typedef struct canonical {
    uint64_t bits; /* of a brick */
    uint64_t stabilizer, hash;
    uint32_t head, number[8];
    uint8_t turn[8], back;
} canonical;

enum { BLOCK = 1024 };

typedef struct block {
    uint64_t begin, end;
    canonical *item;
} block;

typedef struct merge {
    svoi_symdag *d;
    uint32_t level;
    const svoi_nodes *nodes;   /* or */
    const svoi_bricks *bricks;
    const moved *below;
    moved *out;
    uint64_t count, next;
    uint64_t *slots, slot_mask; /* high half: tag of the hash, low half: number + 1 */
    uint64_t to_least[256];     /* turns that make a mask the least it can be */
    const svo_allocator *a;
} merge;

static uint64_t mix(uint64_t h, uint64_t v)
{
    h = (h ^ v) * 0x9e3779b97f4a7c15u;
    return h ^ h >> 32;
}

/* Children as numbers that compare: absent < full < references by number and turn. */
static uint64_t slot_value(const merge *m, const uint32_t *number, const uint8_t *turn, uint32_t full, uint32_t mask, uint32_t o, uint32_t g)
{
    if (!(mask >> o & 1)) return 0;
    if (full >> o & 1) return 1;
    const svoi_symlevel *l = &m->d->level[m->level + 1];
    return ((uint64_t)number[o] << 6 | m->d->least[l->stabilizer[number[o]]][svoi_turn_after(g, turn[o])]) + 2;
}

static void canonical_node(const merge *m, const uint32_t *item, canonical *c)
{
    uint32_t head = item[0], mask = svoi_head_mask(head), full = svoi_head_full(head), number[8] = {0};
    uint8_t turn[8] = {0};
    for (uint32_t s = svoi_head_refs(head), k = 1; s != 0; s &= s - 1, k++) {
        uint32_t o = (uint32_t)__builtin_ctz(s);
        number[o] = m->below->number[item[k]];
        turn[o] = m->below->turn[item[k]];
    }
    uint64_t best[8] = {0}, to_best = 0;
    for (uint64_t s = m->to_least[mask]; s != 0; s &= s - 1) {
        uint32_t g = (uint32_t)__builtin_ctzll(s), back = svoi_turn_inverse(g), o = 0;
        uint64_t v = 0;
        bool less = to_best == 0;
        for (; o < 8; o++) {
            v = slot_value(m, number, turn, full, mask, svoi_turn_octant(back, o), g);
            if (!less && v > best[o]) break;
            less |= v < best[o];
            if (less) best[o] = v, to_best = 0;
        }
        if (o == 8) to_best |= (uint64_t)1 << g;
    }
    uint32_t first_back = svoi_turn_inverse((uint32_t)__builtin_ctzll(to_best)), least = SVOI_TURNS;
    c->stabilizer = 0;
    for (uint64_t s = to_best; s != 0; s &= s - 1) {
        uint32_t g = (uint32_t)__builtin_ctzll(s), back = svoi_turn_inverse(g);
        c->stabilizer |= (uint64_t)1 << svoi_turn_after(g, first_back);
        if (back < least) least = back;
    }
    c->back = (uint8_t)least;
    c->head = 0;
    uint32_t k = 0;
    for (uint32_t o = 0; o < 8; o++) {
        c->head |= (uint32_t)(best[o] != 0) << o | (uint32_t)(best[o] == 1) << (8 + o);
        if (best[o] < 2) continue;
        c->number[k] = (uint32_t)((best[o] - 2) >> 6);
        c->turn[k++] = (uint8_t)((best[o] - 2) & 63);
    }
    c->hash = mix(0, c->head);
    for (uint32_t i = 0; i < k; i++) c->hash = mix(c->hash, (uint64_t)c->number[i] << 6 | c->turn[i]);
}

static void canonical_brick(const merge *m, uint64_t bits, canonical *c)
{
    uint32_t back;
    c->bits = svoi_brick_canonical(m->d->group, bits, &back, &c->stabilizer);
    c->back = (uint8_t)back;
    c->hash = mix(mix(0, c->bits), c->bits >> 32);
}

static svo_result merge_produce(void *user, void *p, bool *more, svo_error *err)
{
    (void)err;
    merge *m = user;
    block *b = p;
    *more = m->next < m->count;
    b->begin = m->next;
    b->end = m->count - m->next < BLOCK ? m->count : m->next + BLOCK;
    m->next = b->end;
    return SVO_OK;
}

static svo_result merge_work(void *user, void *p, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    const merge *m = user;
    block *b = p;
    if (b->item == NULL) b->item = svo_alloc(m->a, BLOCK, sizeof *b->item);
    if (b->item == NULL) return SVO_OUT_OF_MEMORY;
    for (uint64_t i = b->begin; i < b->end; i++) {
        canonical *c = &b->item[i - b->begin];
        if (m->bricks != NULL) canonical_brick(m, m->bricks->bits[i], c);
        else canonical_node(m, m->nodes->items + m->nodes->start[i], c);
    }
    return SVO_OK;
}

static void merge_destroy(void *user, void *p)
{
    const merge *m = user;
    block *b = p;
    svo_free(m->a, b->item, BLOCK, sizeof *b->item);
}

static bool same_node(const svoi_symlevel *l, uint32_t n, const canonical *c, uint32_t k)
{
    const uint32_t *item = l->items + l->start[n];
    return item[0] == c->head && memcmp(item + 1, c->number, k * sizeof *item) == 0 && memcmp(l->turn + l->start[n] + 1, c->turn, k) == 0;
}

/* A node that is new in its level; it counts as a use of its children. */
static void add_node(merge *m, svoi_symlevel *l, const canonical *c, uint32_t k)
{
    svoi_symlevel *below = &m->d->level[m->level + 1];
    uint64_t size = (uint64_t)__builtin_popcount(svoi_head_full(c->head)) + (m->d->lod ? 1 : 0);
    l->start[l->count] = (uint32_t)l->item_count; /* there were no more words before merging */
    l->items[l->item_count] = c->head;
    l->turn[l->item_count] = 0;
    for (uint32_t i = 0; i < k; i++) {
        l->items[l->item_count + 1 + i] = c->number[i];
        l->turn[l->item_count + 1 + i] = c->turn[i];
        size += svoi_symdag_size(m->d, m->level + 1, c->number[i]);
        uint32_t *uses = &below->uses[c->number[i]];
        *uses += *uses != UINT32_MAX;
    }
    l->size[l->count] = size;
    l->item_count += 1 + k;
}

static svo_result merge_commit(void *user, void *p, svo_error *err)
{
    (void)err;
    merge *m = user;
    const block *b = p;
    svoi_symlevel *l = &m->d->level[m->level];
    for (uint64_t i = b->begin; i < b->end; i++) {
        const canonical *c = &b->item[i - b->begin];
        if (i + 8 < b->end) __builtin_prefetch(&m->slots[b->item[i + 8 - b->begin].hash & m->slot_mask]);
        uint32_t k = m->bricks != NULL ? 0 : (uint32_t)__builtin_popcount(svoi_head_refs(c->head)), n = 0;
        uint64_t at = c->hash & m->slot_mask;
        bool found = false;
        for (; m->slots[at] != 0 && !found; at = (at + 1) & m->slot_mask) {
            n = (uint32_t)m->slots[at] - 1;
            found = (m->slots[at] ^ c->hash) >> 32 == 0 && (m->bricks != NULL ? l->bits[n] == c->bits : same_node(l, n, c, k));
        }
        if (!found) {
            n = (uint32_t)l->count;
            if (m->bricks != NULL) l->bits[n] = c->bits;
            else add_node(m, l, c, k);
            l->stabilizer[n] = subgroup_index(m->d, c->stabilizer);
            m->slots[at] = (c->hash & 0xffffffff00000000u) | ++l->count;
        }
        m->out->number[i] = n;
        m->out->turn[i] = c->back;
    }
    return SVO_OK;
}

static void masks_to_least(svoi_group group, uint64_t to_least[256])
{
    for (uint32_t mask = 0; mask < 256; mask++) {
        uint32_t least = 256;
        for (uint32_t g = 0; g < (uint32_t)group; g++) {
            uint32_t t = svoi_turn_mask(g, mask);
            if (t < least) least = t, to_least[mask] = 0;
            if (t == least) to_least[mask] |= (uint64_t)1 << g;
        }
    }
}

static svo_result merge_level(merge *m, uint32_t threads)
{
    svoi_symlevel *l = &m->d->level[m->level];
    m->count = m->bricks != NULL ? m->bricks->count : m->nodes->count;
    m->next = 0;
    *m->out = (moved){0};
    if (m->count == 0) return SVO_OK; /* all above are full leaves */
    uint64_t slots = 64;
    while (slots * 2 < m->count * 3) slots *= 2;
    m->slot_mask = slots - 1;
    m->slots = svo_calloc(m->a, slots, sizeof *m->slots);
    svo_result r = SVO_OUT_OF_MEMORY;
    if (m->slots != NULL && moved_alloc(m->a, m->out, m->count) &&
        level_alloc(m->a, l, m->count, m->bricks != NULL ? 0 : m->nodes->item_count)) {
        svo_pipeline p = {.threads = m->count < 8 * BLOCK ? 1 : threads, .item_size = sizeof(block), .user = m, .produce = merge_produce,
                          .work = merge_work, .commit = merge_commit, .destroy = merge_destroy};
        r = svo_pipeline_run(&p, NULL);
    }
    svo_free(m->a, m->slots, slots, sizeof *m->slots);
    if (r == SVO_OK) level_cut(m->a, l);
    return r;
}

svo_result svoi_symdag_make(svoi_symdag *d, svoi_nodes *nodes, svoi_bricks *bricks, uint32_t brick_level, uint32_t root, bool lod, bool brick_lod,
                            svoi_group group, uint32_t threads, const svo_allocator *a)
{
    *d = (svoi_symdag){.a = a, .group = group, .lod = lod, .brick_lod = brick_lod, .brick_level = brick_level};
    moved map[2] = {0};
    merge m = {.d = d, .level = brick_level, .bricks = bricks, .a = a, .out = &map[0]};
    masks_to_least(group, m.to_least);
    svo_result r = merge_level(&m, threads);
    svoi_bricks_free(bricks);
    m.bricks = NULL;
    for (uint32_t level = brick_level; level-- > 0;) {
        if (r == SVO_OK) {
            m.level = level;
            m.nodes = &nodes[level];
            m.below = m.out;
            m.out = &map[m.out == &map[0]];
            r = merge_level(&m, threads);
            moved_free(a, m.below == &map[0] ? &map[0] : &map[1]);
        }
        svoi_nodes_free(&nodes[level]);
    }
    if (r == SVO_OK) {
        d->root = m.out->number[root];
        d->root_turn = m.out->turn[root];
        d->level[0].uses[d->root]++;
    }
    moved_free(a, &map[0]);
    moved_free(a, &map[1]);
    if (r != SVO_OK) svoi_symdag_free(d);
    return r;
}
