#include "svoi_huffman.h"

#include <stdlib.h>
#include <string.h>

typedef struct leaf { uint64_t weight; uint32_t symbol, parent; } leaf;
typedef struct inner { uint64_t weight; uint32_t parent, depth; } inner;

static int compare_leaves(const void *a, const void *b)
{
    const leaf *x = a, *y = b;
    if (x->weight != y->weight) return x->weight < y->weight ? -1 : 1;
    return (x->symbol > y->symbol) - (x->symbol < y->symbol);
}

/* Two queues: leaves by weight, and inner nodes, whose weights ascend as they are made. Returns the longest length. */
static uint32_t build(leaf *l, uint32_t n, inner *in)
{
    uint32_t next_leaf = 0, next_inner = 0, longest = 0;
    for (uint32_t i = 0; i + 1 < n; i++) {
        in[i].weight = 0;
        for (int side = 0; side < 2; side++) {
            if (next_leaf < n && (next_inner == i || l[next_leaf].weight <= in[next_inner].weight)) {
                in[i].weight += l[next_leaf].weight;
                l[next_leaf++].parent = i;
            } else {
                in[i].weight += in[next_inner].weight;
                in[next_inner++].parent = i;
            }
        }
    }
    in[n - 2].depth = 0;
    for (uint32_t i = n - 2; i-- > 0;) in[i].depth = in[in[i].parent].depth + 1;
    for (uint32_t i = 0; i < n; i++)
        if (in[l[i].parent].depth + 1 > longest) longest = in[l[i].parent].depth + 1;
    return longest;
}

bool svoi_huffman_lengths(const svo_allocator *a, const uint64_t *weight, uint32_t n, uint32_t limit, uint8_t *length)
{
    leaf *l = svo_alloc(a, n, sizeof *l);
    inner *in = svo_alloc(a, n, sizeof *in);
    bool ok = l != NULL && in != NULL;
    uint32_t used = 0;
    for (uint32_t i = 0; i < n && ok; i++) {
        length[i] = SVOI_HUFFMAN_UNUSED;
        if (weight[i] != 0) l[used++] = (leaf){.weight = weight[i], .symbol = i};
    }
    if (ok && used == 1) {
        length[l[0].symbol] = 0;
    } else if (ok && used > 1) {
        qsort(l, used, sizeof *l, compare_leaves);
        SVO_ASSERT(used <= 1u << limit);
        /* flattening the weights keeps their order; in the end they are all 1 and the code as short as it can be */
        while (build(l, used, in) > limit)
            for (uint32_t i = 0; i < used; i++) l[i].weight = l[i].weight / 2 + 1;
        for (uint32_t i = 0; i < used; i++) length[l[i].symbol] = (uint8_t)(in[l[i].parent].depth + 1);
    }
    svo_free(a, l, n, sizeof *l);
    svo_free(a, in, n, sizeof *in);
    return ok;
}

void svoi_huffman_codes(const uint8_t *length, uint32_t n, uint32_t *code)
{
    uint32_t count[33] = {0}, next[33] = {0};
    for (uint32_t i = 0; i < n; i++)
        if (length[i] <= 32) count[length[i]]++;
    for (uint32_t l = 2; l <= 32; l++) next[l] = (next[l - 1] + count[l - 1]) << 1;
    for (uint32_t i = 0; i < n; i++) code[i] = length[i] <= 32 && length[i] != 0 ? next[length[i]]++ : 0;
}

bool svoi_huffman_decoder(const uint8_t *length, uint32_t n, uint32_t fast_bits, uint16_t *fast, svoi_huffman *h)
{
    uint32_t count[SVOI_HUFFMAN_LONGEST + 1] = {0}, used = 0, code = 0, place = 0;
    memset(h, 0, sizeof *h);
    for (uint32_t i = 0; i < n; i++) {
        if (length[i] == SVOI_HUFFMAN_UNUSED) continue;
        if (length[i] > SVOI_HUFFMAN_LONGEST) return false;
        count[length[i]]++;
        used++;
    }
    if (used == 0 || (count[0] != 0 && used != 1)) return false;
    for (uint32_t i = 0; i < 1u << fast_bits; i++) fast[i] = SVOI_HUFFMAN_SLOW;
    if (count[0] != 0) {
        for (uint32_t i = 0; i < n; i++)
            if (length[i] == 0) h->symbol[0] = (uint8_t)i;
        for (uint32_t i = 0; i < 1u << fast_bits; i++) fast[i] = (uint16_t)(h->symbol[0] << 4);
        return true; /* the slow way is never taken */
    }
    for (uint32_t l = 1; l <= SVOI_HUFFMAN_LONGEST; l++) {
        code <<= 1;
        h->rank[l] = (int32_t)place - (int32_t)code;
        for (uint32_t i = 0; i < n; i++) {
            if (length[i] != l) continue;
            if (code >> l != 0) return false;
            if (l <= fast_bits)
                for (uint32_t k = 0; k < 1u << (fast_bits - l); k++) fast[(code << (fast_bits - l)) + k] = (uint16_t)(i << 4 | l);
            h->symbol[place++] = (uint8_t)i;
            code++;
        }
        h->below[l] = code << (16 - l);
    }
    return code == 1u << SVOI_HUFFMAN_LONGEST;
}

uint32_t svoi_huffman_slow(const svoi_huffman *h, uint32_t top16)
{
    uint32_t l = 1;
    while (l < SVOI_HUFFMAN_LONGEST && top16 >= h->below[l]) l++;
    return (uint32_t)h->symbol[(uint32_t)((int32_t)(top16 >> (16 - l)) + h->rank[l]) & 0xff] << 4 | l;
}
