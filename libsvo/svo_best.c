/* Layout 3: the tables made of a file's chunks. */
#include "svoi_top.h"

#include <string.h>

void svoi_corners_make(svoi_corners *c)
{
    uint8_t number[256]; /* of a least mask */
    bool seen[256] = {false};
    memset(c, 0, sizeof *c);
    for (uint32_t mask = 1; mask < 256; mask++)
        for (uint32_t m = mask; m != 0; m &= m - 1) {
            uint32_t o = (uint32_t)__builtin_ctz(m), least = 256;
            for (uint32_t g = 0; g < SVOI_TURNS; g++) {
                uint32_t t = svoi_turn_mask(g, mask);
                if (svoi_turn_octant(g, o) != 0 || t >= least) continue;
                least = t;
                c->of[mask][o].turn = (uint8_t)g;
            }
            seen[least] = true;
            c->of[mask][o].corner = (uint8_t)least; /* its number follows when all are known */
        }
    for (uint32_t mask = 0; mask < 256; mask++) {
        if (!seen[mask]) continue;
        SVO_ASSERT(c->count < SVOI_CORNERS);
        c->mask[c->count] = (uint8_t)mask;
        number[mask] = (uint8_t)c->count++;
    }
    for (uint32_t mask = 1; mask < 256; mask++)
        for (uint32_t m = mask; m != 0; m &= m - 1) {
            svoi_corner *of = &c->of[mask][__builtin_ctz(m)];
            of->corner = number[of->corner];
        }
}

svoi_contexts svoi_contexts_make(uint32_t classes, uint32_t corners)
{
    const uint32_t count[SVOI_CONTEXT_KINDS] = {classes, corners, SVOI_TURNS, corners, corners, 1, corners};
    const uint32_t symbols[SVOI_CONTEXT_KINDS] = {classes, classes, SVOI_TURNS, SVOI_TURNS, 256, 256, 256};
    svoi_contexts c = {.first = {0}};
    for (uint32_t k = 0; k < SVOI_CONTEXT_KINDS; k++) {
        c.first[k + 1] = c.first[k] + count[k];
        c.symbols[k] = symbols[k];
    }
    return c;
}

/* --- tables from the file ---------------------------------------------------------------------------------------- */

typedef struct code_reader {
    const uint8_t *bytes;
    uint64_t at, end; /* bits */
} code_reader;

/* Beyond the end come zeros, which end nothing: the caller sees at > end. */
static uint32_t read_bits(code_reader *r, uint32_t n)
{
    if (r->at > r->end) return 0;
    uint32_t v = (uint32_t)svoi_bits_get(r->bytes, r->at, n);
    r->at += n;
    return v;
}

static svo_result bad_codes(svo_error *err, const char *why) { return svo_fail(err, SVO_INVALID_DATA, "DAG-13: code tables: %s", why); }

/* Lengths of a context; *used: does it occur at all? */
static bool read_lengths(code_reader *r, uint32_t n, uint8_t *length, bool *used)
{
    uint32_t symbol_bits = svoi_bit_width(n - 1);
    memset(length, SVOI_HUFFMAN_UNUSED, SVOI_HUFFMAN_SYMBOLS);
    *used = read_bits(r, 1);
    if (!*used) return true;
    if (read_bits(r, 1)) {
        uint32_t count = read_bits(r, symbol_bits) + 1, next = 0;
        for (uint32_t i = 0; i < count; i++) {
            uint32_t symbol = read_bits(r, symbol_bits), l = read_bits(r, 4);
            if (symbol < next || symbol >= n || (l == 0) != (count == 1)) return false;
            length[symbol] = (uint8_t)l;
            next = symbol + 1;
        }
    } else {
        for (uint32_t i = 0; i < n; i++) {
            uint32_t l = read_bits(r, 4);
            if (l != 0) length[i] = (uint8_t)l;
        }
    }
    return r->at <= r->end;
}

static uint16_t *fast_table(svoi_best *b, uint32_t kind, uint32_t i, uint32_t *bits)
{
    *bits = SVOI_MASK_FAST;
    switch (kind) {
    case SVOI_CONTEXT_CLASS: *bits = SVOI_CLASS_FAST; return b->class_fast[i];
    case SVOI_CONTEXT_CLASS_FIRST: *bits = SVOI_CLASS_FAST; return b->class_fast[b->classes + i];
    case SVOI_CONTEXT_TURN: *bits = SVOI_TURN_FAST; return b->turn_fast[i];
    case SVOI_CONTEXT_TURN_FIRST: *bits = SVOI_TURN_FAST; return b->turn_fast[SVOI_TURNS + i];
    case SVOI_CONTEXT_MASK: return b->mask_fast[i];
    case SVOI_CONTEXT_OCTANTS: return b->octants_fast[i];
    default: return b->octant_fast[i];
    }
}

static svo_result read_contexts(svoi_best *b, code_reader *r, svo_error *err)
{
    for (uint32_t kind = 0; kind < SVOI_CONTEXT_KINDS; kind++) {
        bool zero_is_none = kind != SVOI_CONTEXT_TURN && kind != SVOI_CONTEXT_TURN_FIRST; /* class 0 and the mask 0 */
        for (uint32_t c = b->contexts.first[kind]; c < b->contexts.first[kind + 1]; c++) {
            uint8_t length[SVOI_HUFFMAN_SYMBOLS];
            uint32_t n = b->contexts.symbols[kind], bits;
            uint16_t *fast = fast_table(b, kind, c - b->contexts.first[kind], &bits);
            if (!read_lengths(r, n, length, &b->used[c])) return bad_codes(err, "a list of symbols is out of order or too long");
            if (!b->used[c]) continue;
            if (zero_is_none && length[0] != SVOI_HUFFMAN_UNUSED) return bad_codes(err, "symbol 0 has a code where it means nothing");
            if (!svoi_huffman_decoder(length, n, bits, fast, &b->code[c])) return bad_codes(err, "lengths that make no complete code");
        }
    }
    return SVO_OK;
}

/* Numbers of a class ascend with the length of their codes, so lengths are counts. */
static bool read_ids(svoi_best *b, code_reader *r, uint32_t class, uint64_t *bricks)
{
    uint32_t longest = read_bits(r, 5), code = 0;
    uint64_t n = 0;
    if (longest > SVOI_ID_LONGEST) return false;
    b->class_first[class] = (uint32_t)*bricks;
    memset(b->id_fast[class], SVOI_ID_SLOW, sizeof b->id_fast[class]);
    for (uint32_t l = 0; l <= SVOI_ID_LONGEST; l++) {
        uint32_t count = l <= longest ? read_bits(r, read_bits(r, 5)) : 0;
        if (l == 0) {
            if (count > 1 || (count == 1 && longest != 0)) return false;
            if (count == 1) memset(b->id_fast[class], 0, sizeof b->id_fast[class]);
            n = count;
            continue;
        }
        code <<= 1;
        b->id_rank[class][l] = (int32_t)(n - code);
        if (count > (1u << l) - code) return false;
        if (l <= SVOI_ID_FAST)
            for (uint32_t i = code << (SVOI_ID_FAST - l); i < (code + count) << (SVOI_ID_FAST - l); i++) b->id_fast[class][i] = (uint8_t)l;
        code += count;
        n += count;
        b->id_below[class][l] = code << (SVOI_ID_LONGEST - l);
    }
    b->class_count[class] = (uint32_t)n;
    *bricks += n;
    return r->at <= r->end && (n < 2 ? longest == 0 : code == 1u << SVOI_ID_LONGEST) && *bricks <= UINT32_MAX;
}

static svo_result read_codes(svoi_best *b, const svo_view *v, svo_error *err)
{
    code_reader r = {v->best_codes, 0, 8 * (v->best_code_bytes - SVOI_BITS_GUARD)};
    uint64_t bricks = 0;
    b->classes = read_bits(&r, 8);
    uint32_t flags = read_bits(&r, 8);
    if (b->classes < 3 || b->classes > SVOI_CLASSES) return bad_codes(err, "number of classes out of range");
    if (flags > 1) return bad_codes(err, "unknown flags");
    b->solid = flags & 1;
    b->contexts = svoi_contexts_make(b->classes, b->corners.count);
    SVO_TRY(read_contexts(b, &r, err));
    for (uint32_t c = 1; c + 1 < b->classes; c++)
        if (!read_ids(b, &r, c, &bricks)) return bad_codes(err, "lengths of brick numbers that make no complete code");
    if (bricks != v->brick_count) return bad_codes(err, "number of bricks is not that of the dictionary");
    r.at = (r.at + 7) & ~(uint64_t)7;
    if (r.at != r.end) return bad_codes(err, "too short or too long");
    for (uint32_t i = 0; i < SVOI_BITS_GUARD; i++)
        if (v->best_codes[r.end / 8 + i] != 0) return bad_codes(err, "the guard behind them is not 0");
    return SVO_OK;
}

svo_result svoi_best_open(const svo_view *v, const svo_allocator *a, svoi_best **out, svo_error *err)
{
    if (v->brick_level < 1) return svo_fail(err, SVO_INVALID_DATA, "DAG-02: layout 3 needs a depth of 3 or more");
    if (v->best_code_bytes < SVOI_BITS_GUARD || v->best_stream_bytes < SVOI_BITS_GUARD || v->best_stream_bytes >> 52 != 0)
        return svo_fail(err, SVO_INVALID_DATA, "DAG-12: stream or code tables are too short");
    if (v->root >= SVOI_TURNS) return svo_fail(err, SVO_INVALID_DATA, "DAG-12: the root's turn is none");
    svoi_best *b = svo_calloc(a, 1, sizeof *b);
    if (b == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (code tables)");
    b->stream = v->best_stream;
    b->stream_bits = 8 * (v->best_stream_bytes - SVOI_BITS_GUARD);
    b->level = v->best_levels;
    b->dictionary = v->bricks;
    b->block_level = v->brick_level - 1;
    b->lod = v->lod;
    b->brick_lod = svo_view_brick_lod(v);
    b->numbered = !v->unnumbered;
    b->root_turn = v->root;
    b->attribute_count = v->attribute_count;
    svoi_corners_make(&b->corners);
    svo_result r = read_codes(b, v, err);
    if (r == SVO_OK) *out = b;
    else svoi_best_close(b, a);
    return r;
}

void svoi_best_close(svoi_best *b, const svo_allocator *a) { svo_free(a, b, 1, sizeof *b); }

svo_result svo_view_prepare(svo_view *v, const svo_allocator *a, svo_error *err)
{
    return v->layout == SVO_LAYOUT_BEST && !v->empty ? svoi_best_open(v, a, &v->best, err) : SVO_OK;
}

void svo_view_release(svo_view *v, const svo_allocator *a)
{
    svoi_best_close(v->best, a);
    svoi_top_free(v->top, a);
    v->best = NULL;
    v->top = NULL;
}
