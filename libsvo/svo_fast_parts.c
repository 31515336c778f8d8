/* Where the bits of layout 2 are. */
#include "svoi_fast.h"

enum { CODE_SHORT, CODE_LONG, CODE_TURNED, CODE_LITERAL };

static uint64_t count_block(const svo_view *v, uint64_t at, svo_view_fast_parts *to)
{
    svoi_fast_block b = svoi_fast_open_block(v, at);
    uint32_t slots = (uint32_t)__builtin_popcount(b.refs);
    to->tags += 2 * slots;
    to->masks += b.codes - at - 2 * slots;
    uint32_t least = SVO_FAST_LITERAL;
    for (uint32_t t = 0; t < 4; t++)
        if (v->fast.code_bits[b.mode][t] < least) least = v->fast.code_bits[b.mode][t];
    for (uint32_t k = 0; k < slots; k++) {
        uint32_t tag = b.tags >> 2 * k & 3, ids = v->fast.id_bits[b.mode][tag], bits = v->fast.code_bits[b.mode][tag];
        uint32_t kind = ids == SVO_FAST_LITERAL ? CODE_LITERAL : bits != ids ? CODE_TURNED : bits == least ? CODE_SHORT : CODE_LONG;
        to->codes[kind] += bits;
        to->bricks[kind]++;
    }
    return svoi_fast_block_end(v, &b);
}

/* At most SVO_MAX_DEPTH deep. Returns the bit after the node. */
static uint64_t count_node(const svo_view *v, uint32_t level, uint64_t at, svo_view_fast_parts *parts)
{
    svo_view_fast_parts *to = &parts[level];
    if (level + 1 == v->brick_level) return count_block(v, at, to);
    svoi_fast_node n = svoi_fast_open(v, level, at);
    uint32_t tags = 2 * (uint32_t)__builtin_popcount(n.refs);
    to->tags += tags;
    to->masks += n.skips - at - tags;
    to->skips += n.sizes - n.skips;
    to->sizes += n.codes - n.sizes;
    to->references += n.inner - n.codes;
    at = n.inner;
    for (uint32_t i = 0; i < n.inner_count; i++) at = count_node(v, level + 1, at, parts);
    return at;
}

void svo_view_fast_count(const svo_view *v, svo_view_fast_parts out[SVO_MAX_DEPTH])
{
    memset(out, 0, SVO_MAX_DEPTH * sizeof *out);
    for (uint32_t l = 0; l < v->brick_level; l++) {
        uint64_t p = v->fast.level[l].begin;
        for (uint64_t k = 0; k < v->fast.level[l].pool_count; k++) p = (count_node(v, l, p, out) + 7) & ~(uint64_t)7;
    }
    for (uint32_t l = 0; l < v->brick_level; l++) {
        svo_view_fast_parts *p = &out[l];
        uint64_t bits = p->masks + p->tags + p->skips + p->sizes + p->references;
        for (int k = 0; k < 4; k++) bits += p->codes[k];
        p->bytes = (bits + 7) / 8;
    }
}
