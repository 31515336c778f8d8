#include "svoi_tritree.h"

#include <string.h>

#include "svo_morton.h"

enum { KEY_BITS = 14, DIGIT = 11, PASSES = 4 };

uint64_t svoi_tree_key(const int32_t p[3], uint32_t lattice_bits)
{
    uint32_t c[3];
    for (int k = 0; k < 3; k++)
        c[k] = lattice_bits > KEY_BITS ? (uint32_t)p[k] >> (lattice_bits - KEY_BITS) : (uint32_t)p[k] << (KEY_BITS - lattice_bits);
    return svo_morton_encode(c[0], c[1], c[2]);
}

/* Stable, so that equal keys stay in the order of the items. */
static bool sort(uint32_t *order, uint64_t count, const uint64_t *keys, const svo_allocator *a)
{
    uint32_t *other = svo_alloc(a, count, sizeof *other), *from = order, *to = other;
    uint64_t *start = svo_alloc(a, (uint64_t)1 << DIGIT, sizeof *start);
    bool ok = other != NULL && start != NULL;
    for (uint32_t pass = 0; ok && pass < PASSES; pass++) {
        uint32_t shift = pass * DIGIT;
        memset(start, 0, sizeof *start << DIGIT);
        for (uint64_t i = 0; i < count; i++) start[keys[from[i]] >> shift & ((1u << DIGIT) - 1)]++;
        uint64_t total = 0;
        for (uint32_t d = 0; d < 1u << DIGIT; d++) {
            uint64_t n = start[d];
            start[d] = total;
            total += n;
        }
        for (uint64_t i = 0; i < count; i++) to[start[keys[from[i]] >> shift & ((1u << DIGIT) - 1)]++] = from[i];
        uint32_t *swap = from;
        from = to;
        to = swap;
    }
    /* an even number of passes: the result is in `order` */
    svo_free(a, other, count, sizeof *other);
    svo_free(a, start, (uint64_t)1 << DIGIT, sizeof *start);
    return ok;
}

static void join(svoi_box *to, const svoi_box *more)
{
    for (int k = 0; k < 3; k++) {
        if (more->low[k] < to->low[k]) to->low[k] = more->low[k];
        if (more->high[k] > to->high[k]) to->high[k] = more->high[k];
    }
}

bool svoi_tree_build(svoi_tree *t, uint32_t *order, uint64_t count, const uint64_t *keys, svoi_box_fn box, void *user, const svo_allocator *a)
{
    *t = (svoi_tree){.allocator = a, .count = count, .order = order};
    if (count == 0) return true;
    if (!sort(order, count, keys, a)) return false;
    uint64_t size = (count + SVOI_TREE_LEAF - 1) / SVOI_TREE_LEAF;
    for (;;) {
        t->first[t->levels] = t->node_count;
        t->size[t->levels++] = size;
        t->node_count += size;
        if (size == 1) break;
        size = (size + 1) / 2;
    }
    t->box = svo_alloc(a, t->node_count, sizeof *t->box);
    if (t->box == NULL) return false;
    for (uint64_t i = 0; i < t->size[0]; i++) {
        uint64_t begin, end;
        svoi_tree_items(t, (svoi_tree_node){0, (uint32_t)i}, &begin, &end);
        box(user, order[begin], &t->box[i]);
        for (uint64_t k = begin + 1; k < end; k++) {
            svoi_box more;
            box(user, order[k], &more);
            join(&t->box[i], &more);
        }
    }
    for (uint32_t l = 1; l < t->levels; l++)
        for (uint64_t i = 0; i < t->size[l]; i++) {
            const svoi_box *child = &t->box[t->first[l - 1] + 2 * i];
            svoi_box *to = &t->box[t->first[l] + i];
            *to = child[0];
            if (2 * i + 1 < t->size[l - 1]) join(to, &child[1]);
        }
    return true;
}

void svoi_tree_free(svoi_tree *t)
{
    svo_free(t->allocator, t->order, t->count, sizeof *t->order);
    svo_free(t->allocator, t->box, t->node_count, sizeof *t->box);
    *t = (svoi_tree){.allocator = t->allocator};
}
