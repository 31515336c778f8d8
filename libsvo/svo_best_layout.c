/* Parts of the writer of layout 3 that know nothing of the octree, and the layout as a whole. */
#include "svoi_best_encode.h"

/* Widths of the four tiers of references that take the fewest bits in all. uses[w]: references whose place has w bits. */
void svoi_best_choose_tiers(const uint64_t uses[65], uint8_t tier[SVOI_TIERS])
{
    uint32_t most = 0;
    uint64_t up_to[65], sum = 0, least = UINT64_MAX;
    for (uint32_t w = 0; w <= 64; w++) {
        sum += uses[w];
        up_to[w] = sum;
        if (uses[w] != 0) most = w;
    }
    for (uint32_t a = 0; a <= most; a++)
        for (uint32_t b = a; b <= most; b++)
            for (uint32_t c = b; c <= most; c++) {
                uint64_t bits = up_to[a] * a + (up_to[b] - up_to[a]) * b + (up_to[c] - up_to[b]) * c + (sum - up_to[c]) * most;
                if (bits >= least) continue;
                least = bits;
                tier[0] = (uint8_t)a, tier[1] = (uint8_t)b, tier[2] = (uint8_t)c, tier[3] = (uint8_t)most;
            }
}

/* Tier of a reference to `place`: the first with enough bits. */
uint32_t svoi_best_tier_of(const uint8_t tier[SVOI_TIERS], uint64_t place)
{
    uint32_t t = 0;
    while (svoi_bit_width(place) > tier[t]) t++;
    return t;
}

/* Lengths of one context: as a list of the symbols that occur, or all of them, whichever is shorter. */
void svoi_best_write_lengths(svoi_bit_writer *w, const uint8_t *length, uint32_t n)
{
    uint32_t used = 0, symbol_bits = svoi_bit_width(n - 1);
    for (uint32_t i = 0; i < n; i++) used += length[i] != SVOI_HUFFMAN_UNUSED;
    svoi_bits_put(w, used != 0, 1);
    if (used == 0) return;
    bool list = symbol_bits + used * (symbol_bits + 4) < n * 4 || used == 1;
    svoi_bits_put(w, list, 1);
    if (list) svoi_bits_put(w, used - 1, symbol_bits);
    for (uint32_t i = 0; i < n; i++) {
        bool is = length[i] != SVOI_HUFFMAN_UNUSED;
        if (list && is) svoi_bits_put(w, i, symbol_bits);
        if (is || !list) svoi_bits_put(w, is ? length[i] : 0, 4); /* 0 in a list of one; else an unused symbol */
    }
}

void svoi_best_parts_free(svoi_best_parts *p)
{
    svo_buffer_free(&p->stream);
    svo_buffer_free(&p->levels);
    svo_buffer_free(&p->codes);
    svo_buffer_free(&p->dictionary);
}

svo_result svoi_layout_best(svo_packed *p, svoi_nodes *levels, svoi_bricks *bricks, bool mirrors, uint32_t threads, svo_error *err)
{
    const svo_allocator *a = &p->memory.base;
    svo_view *v = &p->view;
    svoi_symdag d;
    svo_result r = svoi_symdag_make(&d, levels, bricks, v->brick_level, v->root, v->lod, svo_view_brick_lod(v), mirrors ? SVOI_MIRRORS : SVOI_ALL, threads, a);
    svoi_best_parts parts;
    if (r == SVO_OK) {
        r = svoi_best_encode(&d, !v->unnumbered, SVOI_BEST_CLASSES, a, &parts, NULL);
        v->root = d.root_turn;
        svoi_symdag_free(&d);
    }
    if (r != SVO_OK) return svoi_no_memory(p, "geometry", err);
    p->best_stream = parts.stream, p->best_levels = parts.levels, p->best_codes = parts.codes, p->bricks = parts.dictionary;
    v->layout = SVO_LAYOUT_BEST;
    v->best_stream = parts.stream.data, v->best_stream_bytes = parts.stream.size;
    v->best_codes = parts.codes.data, v->best_code_bytes = parts.codes.size;
    v->best_levels = (const svoi_best_level *)(const void *)parts.levels.data;
    v->bricks = (const uint64_t *)(const void *)parts.dictionary.data;
    v->brick_count = parts.dictionary.size / 8;
    r = svo_view_prepare(v, a, err);
    return r == SVO_OUT_OF_MEMORY ? svoi_no_memory(p, "geometry", err) : r;
}
