/* Hash-consing: distinct bricks and distinct nodes of a level, open addressing with linear probing. Contents are
 * compared on a hit of the tag, so a collision costs time and nothing else. */
#include <string.h>

#include "svoi_dag.h"

static uint64_t mix(uint64_t h)
{
    h ^= h >> 32;
    h *= 0xd6e8feb86659fd93u;
    h ^= h >> 32;
    h *= 0xd6e8feb86659fd93u;
    h ^= h >> 32;
    return h;
}

static uint64_t hash_node(uint32_t mask, const uint32_t *refs, uint32_t k)
{
    uint64_t h = mask;
    for (uint32_t i = 0; i < k; i++) h = (h ^ refs[i]) * 0x9e3779b97f4a7c15u, h ^= h >> 29;
    return mix(h);
}

/* Move an array to a larger block; *capacity counts elements. */
static bool grow(const svo_allocator *a, void **data, uint64_t *capacity, uint64_t count, uint64_t need, size_t size)
{
    if (need <= *capacity) return true;
    uint64_t want = *capacity + *capacity / 2 + 16;
    if (want < need) want = need;
    void *to = svo_alloc(a, want, size);
    if (to == NULL && want > need) to = svo_alloc(a, want = need, size);
    if (to == NULL) return false;
    if (count != 0) memcpy(to, *data, (size_t)count * size);
    svo_free(a, *data, *capacity, size);
    *data = to;
    *capacity = want;
    return true;
}

static void place(uint64_t *slots, uint64_t slot_count, uint64_t hash, uint32_t number)
{
    uint64_t i = hash & (slot_count - 1);
    while (slots[i] != 0) i = (i + 1) & (slot_count - 1);
    slots[i] = (hash & 0xffffffff00000000u) | (number + (uint64_t)1);
}

/* A table twice as large (load at most 2/3), empty; the caller places what there is. */
static uint64_t *more_slots(const svo_allocator *a, uint64_t slot_count, uint64_t *wanted)
{
    *wanted = slot_count == 0 ? 32 : slot_count * 2;
    return svo_calloc(a, *wanted, sizeof(uint64_t));
}

svo_result svoi_bricks_insert(svoi_bricks *b, uint64_t bits, uint32_t *number)
{
    if ((b->count + 1) * 3 > b->slot_count * 2) {
        uint64_t wanted, *slots = more_slots(b->a, b->slot_count, &wanted);
        if (slots == NULL) return SVO_OUT_OF_MEMORY;
        for (uint64_t i = 0; i < b->count; i++) place(slots, wanted, mix(b->bits[i]), (uint32_t)i);
        svo_free(b->a, b->slots, b->slot_count, sizeof *slots);
        b->slots = slots;
        b->slot_count = wanted;
    }
    uint64_t hash = mix(bits), i = hash & (b->slot_count - 1);
    for (; b->slots[i] != 0; i = (i + 1) & (b->slot_count - 1)) {
        uint32_t n = (uint32_t)b->slots[i] - 1;
        if ((b->slots[i] ^ hash) >> 32 == 0 && b->bits[n] == bits) {
            *number = n;
            return SVO_OK;
        }
    }
    if (b->count >= UINT32_MAX) return SVO_LIMIT;
    void *data = b->bits;
    if (!grow(b->a, &data, &b->capacity, b->count, b->count + 1, sizeof *b->bits)) return SVO_OUT_OF_MEMORY;
    b->bits = data;
    b->bits[b->count] = bits;
    b->slots[i] = (hash & 0xffffffff00000000u) | (b->count + 1);
    *number = (uint32_t)b->count++;
    return SVO_OK;
}

void svoi_bricks_seal(svoi_bricks *b)
{
    svo_free(b->a, b->slots, b->slot_count, sizeof *b->slots);
    b->slots = NULL;
    b->slot_count = 0;
}

void svoi_bricks_free(svoi_bricks *b)
{
    svoi_bricks_seal(b);
    svo_free(b->a, b->bits, b->capacity, sizeof *b->bits);
    *b = (svoi_bricks){.a = b->a};
}

static uint64_t hash_stored(const svoi_nodes *n, uint64_t number)
{
    const uint32_t *item = n->items + n->start[number];
    return hash_node(item[0], item + 1, svoi_node_refs(item[0]));
}

static bool nodes_reserve(svoi_nodes *n, uint32_t k)
{
    void *items = n->items, *start = n->start, *size = n->size;
    bool ok = grow(n->a, &items, &n->item_capacity, n->item_count, n->item_count + 1 + k, sizeof *n->items) &&
              grow(n->a, &start, &n->start_capacity, n->count, n->count + 1, sizeof *n->start) &&
              grow(n->a, &size, &n->size_capacity, n->count, n->count + 1, sizeof *n->size);
    n->items = items, n->start = start, n->size = size;
    return ok;
}

svo_result svoi_nodes_insert(svoi_nodes *n, uint32_t mask, const uint32_t *refs, uint64_t size, uint32_t *number)
{
    uint32_t k = svoi_node_refs(mask);
    if ((n->count + 1) * 3 > n->slot_count * 2) {
        uint64_t wanted, *slots = more_slots(n->a, n->slot_count, &wanted);
        if (slots == NULL) return SVO_OUT_OF_MEMORY;
        for (uint64_t i = 0; i < n->count; i++) place(slots, wanted, hash_stored(n, i), (uint32_t)i);
        svo_free(n->a, n->slots, n->slot_count, sizeof *slots);
        n->slots = slots;
        n->slot_count = wanted;
    }
    uint64_t hash = hash_node(mask, refs, k), i = hash & (n->slot_count - 1);
    for (; n->slots[i] != 0; i = (i + 1) & (n->slot_count - 1)) {
        if ((n->slots[i] ^ hash) >> 32 != 0) continue;
        uint32_t old = (uint32_t)n->slots[i] - 1;
        const uint32_t *item = n->items + n->start[old];
        if (item[0] == mask && (k == 0 || memcmp(item + 1, refs, k * sizeof *refs) == 0)) {
            *number = old;
            return SVO_OK;
        }
    }
    if (n->count >= UINT32_MAX || n->item_count > UINT32_MAX - 16) return SVO_LIMIT;
    if (!nodes_reserve(n, k)) return SVO_OUT_OF_MEMORY;
    uint32_t *item = n->items + n->item_count;
    item[0] = mask;
    if (k != 0) memcpy(item + 1, refs, k * sizeof *refs);
    n->start[n->count] = (uint32_t)n->item_count;
    n->size[n->count] = size;
    n->item_count += 1 + k;
    n->slots[i] = (hash & 0xffffffff00000000u) | (n->count + 1);
    *number = (uint32_t)n->count++;
    return SVO_OK;
}

void svoi_nodes_seal(svoi_nodes *n)
{
    svo_free(n->a, n->slots, n->slot_count, sizeof *n->slots);
    n->slots = NULL;
    n->slot_count = 0;
}

void svoi_nodes_free(svoi_nodes *n)
{
    svoi_nodes_seal(n);
    svo_free(n->a, n->items, n->item_capacity, sizeof *n->items);
    svo_free(n->a, n->start, n->start_capacity, sizeof *n->start);
    svo_free(n->a, n->size, n->size_capacity, sizeof *n->size);
    *n = (svoi_nodes){.a = n->a};
}
