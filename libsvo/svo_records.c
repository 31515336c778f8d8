/* Records of the stored nodes between the cells of the upper level and the blocks. */
#include "svoi_fast.h"

static void set_child(svoi_record *to, uint32_t o, uint64_t at, uint32_t turn)
{
    to->child[o] = (uint32_t)at << 6 | turn;
    to->high |= (uint32_t)(at >> SVOI_RECORD_BITS) << 4 * o;
}

/* Children as they lie in the file: positions in place of numbers. False: something does not fit. */
static bool fill_fast(const svo_view *v, uint32_t level, svoi_record *to)
{
    svoi_fast_node n = svoi_fast_open(v, level, to->at);
    const bool blocks = level + 2 == v->brick_level;
    const uint32_t bits = v->fast.level[level].size_bits;
    uint64_t inner = n.inner;
    to->high = 0;
    for (uint32_t m = n.mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), slot = svoi_fast_slot(n.refs, o), turn = 0;
        to->size[o] = 1;
        to->child[o] = SVOI_RECORD_FULL;
        if (!(n.refs >> o & 1)) continue;
        bool walked = blocks && (n.tags >> 2 * slot & 3) == 0;
        uint64_t at = walked ? inner : svoi_fast_find(v, level, &n, slot, &turn), size = 1, end;
        if (blocks) {
            svoi_fast_block b = svoi_fast_open_block(v, at);
            if (!v->unnumbered) size = (v->lod ? 1 : 0) + svoi_fast_bricks_size(v, &b, 0xff, &end); /* 1 + 8 * 73 at most */
            else end = svoi_fast_block_end(v, &b);
            if (walked) inner = end;
        } else if (bits != 0) {
            size = svoi_fast_bits64(v, n.sizes + bits * (uint32_t)__builtin_popcount(n.mask & ((1u << o) - 1)), bits);
        }
        if (size > UINT16_MAX) return false;
        to->size[o] = (uint16_t)size;
        set_child(to, o, at, turn);
    }
    return true;
}

/* to->mask[0]: the node's own. */
static bool fill_best(const svo_view *v, uint32_t level, svoi_record *to)
{
    const svoi_best *b = v->best;
    svoi_best_node n = {to->at, to->mask[0]};
    svoi_best_head h = svoi_best_read_head(b, level, n);
    uint64_t rest = to->total - (v->lod ? 1 : 0), at = h.sizes;
    to->mask[0] = 0, to->high = 0;
    for (uint32_t m = n.mask; m != 0; m &= m - 1) {
        uint32_t o = (uint32_t)__builtin_ctz(m), turn;
        uint64_t size = v->unnumbered ? 1 : (m & (m - 1)) == 0 ? rest : svoi_bits_get(b->stream, at, h.size_width);
        rest -= size;
        at += h.size_width;
        if (size > UINT16_MAX) return false;
        to->size[o] = (uint16_t)size;
        to->child[o] = SVOI_RECORD_FULL;
        if (h.full >> o & 1) continue;
        svoi_best_node c = svoi_best_child(b, level, n, &h, o, &turn);
        set_child(to, o, c.at, svoi_turn_inverse(turn));
        to->mask[o] = (uint8_t)c.mask;
    }
    return true;
}

/* Which positions begin a node of one level, and how many before. */
typedef struct places {
    uint64_t *bit, words;
    uint32_t *before;
} places;

static void places_add(places *p, uint64_t at) { p->bit[at / 64] |= (uint64_t)1 << at % 64; }
static uint64_t places_count(places *p)
{
    uint64_t n = 0;
    for (uint64_t i = 0; i < p->words; i++) p->before[i] = (uint32_t)n, n += (uint64_t)__builtin_popcountll(p->bit[i]);
    return n;
}
static uint32_t places_number(const places *p, uint64_t at)
{
    return p->before[at / 64] + (uint32_t)__builtin_popcountll(p->bit[at / 64] & (((uint64_t)1 << at % 64) - 1));
}

/* A child, or a cell, whose record is `number`. */
static uint32_t link_record(svoi_record *record, uint64_t number, uint64_t at, uint32_t mask, uint64_t total, uint32_t turn)
{
    svoi_record *n = &record[number];
    n->at = (uint32_t)at;
    n->mask[0] = (uint8_t)mask;
    n->total = (uint32_t)total;
    return (uint32_t)number << 6 | turn;
}

/* Records level by level: those of the cells, then their children. */
static bool fill_levels(svoi_top *t, const svo_view *v, places *p)
{
    const bool best = v->layout == SVO_LAYOUT_BEST;
    uint64_t first = 0, count;
    for (uint64_t i = 0; i < t->cell_count; i++)
        if (t->cell[i].place != SVOI_TOP_FULL) places_add(p, svoi_top_node_at(t->cell[i].place).at);
    count = places_count(p);
    if (count > t->record_count) return false;
    for (uint64_t i = 0; i < t->cell_count; i++) {
        t->record_cell[i].child = SVOI_RECORD_FULL;
        if (t->cell[i].place == SVOI_TOP_FULL) continue;
        svoi_best_node n = svoi_top_node_at(t->cell[i].place);
        uint64_t size = t->size != NULL ? t->size[i] : 0;
        if (size > UINT32_MAX) return false;
        uint32_t turn = svoi_top_turn(t->cell[i].place);
        t->record_cell[i].child = link_record(t->record, places_number(p, n.at), n.at, n.mask, size, best ? svoi_turn_inverse(turn) : turn);
    }
    for (uint32_t level = t->level;; level++) {
        for (uint64_t i = first; i < first + count; i++)
            if (!(best ? fill_best(v, level, &t->record[i]) : fill_fast(v, level, &t->record[i]))) return false;
        if (level + 2 == v->brick_level) break;
        memset(p->bit, 0, p->words * sizeof *p->bit);
        for (uint64_t i = first; i < first + count; i++)
            for (uint32_t o = 0; o < 8; o++)
                if (t->record[i].size[o] != 0 && t->record[i].child[o] != SVOI_RECORD_FULL) places_add(p, svoi_record_at(&t->record[i], o));
        uint64_t next = first + count, below = places_count(p);
        if (below > t->record_count - next) return false;
        for (uint64_t i = first; i < next; i++) {
            svoi_record *n = &t->record[i];
            for (uint32_t o = 0; o < 8; o++) {
                if (n->size[o] == 0 || n->child[o] == SVOI_RECORD_FULL) continue;
                const uint64_t at = svoi_record_at(n, o);
                n->child[o] = link_record(t->record, next + places_number(p, at), at, n->mask[o], n->size[o], n->child[o] & 63);
                n->high &= ~(15u << 4 * o);
            }
        }
        first = next, count = below;
    }
    t->bottom = first;
    return first + count == t->record_count;
}

/* Cells and steps of 8 and 16 bytes in place of the others. False: attributes do not fit. */
static bool shrink_top(svoi_top *t)
{
    for (uint64_t i = 0, children; i < t->node_count; i++) {
        const svoi_top_node *n = &t->node[i];
        t->record_step[i] = (svoi_record_step){n->mask, n->first};
        children = (uint64_t)__builtin_popcountll(n->mask);
        if (i < t->last_step) continue;
        uint64_t least = t->cell[n->first].attribute;
        if (least >> 40 != 0) return false;
        t->record_step[i].link |= least << 24;
        for (uint64_t k = n->first; k < n->first + children; k++) {
            if (t->cell[k].attribute - least > UINT32_MAX) return false;
            t->record_cell[k].attribute = (uint32_t)(t->cell[k].attribute - least);
        }
    }
    return true;
}

static void make_buckets(svoi_top *t)
{
    uint64_t next = t->bottom;
    for (uint64_t i = 0; i < t->bucket_count; i++) {
        while (next < t->record_count - 1 && t->record[next].at < i << SVOI_RECORD_SHIFT) next++;
        t->bucket[i] = (uint32_t)next;
    }
}

static uint64_t records_count(const svo_view *v, uint32_t level)
{
    uint64_t count = 0;
    for (uint32_t l = level; l + 2 <= v->brick_level; l++) count += svo_view_stored(v, l);
    return count;
}

static uint64_t tree_bits(const svo_view *v) { return 8 * (v->layout == SVO_LAYOUT_BEST ? v->best_stream_bytes : v->fast.tree_bytes); }

bool svoi_records_fit(const svo_view *v, uint32_t level, uint64_t most)
{
    const uint64_t count = records_count(v, level);
    return count != 0 && count <= most && tree_bits(v) >> (SVOI_RECORD_BITS + SVOI_RECORD_MORE) == 0;
}

void svoi_records_make(svoi_top *t, const svo_view *v, const svo_allocator *a)
{
    const uint64_t bits = tree_bits(v), count = records_count(v, t->level);
    t->record_count = count;
    t->bucket_count = (bits >> SVOI_RECORD_SHIFT) + 1;
    t->record = svo_calloc(a, count, sizeof *t->record);
    t->record_step = svo_alloc(a, t->node_count, sizeof *t->record_step);
    t->record_cell = svo_alloc(a, t->cell_count, sizeof *t->record_cell);
    t->bucket = svo_alloc(a, t->bucket_count, sizeof *t->bucket);
    places p = {NULL, bits / 64 + 1, NULL};
    p.bit = svo_calloc(a, p.words, sizeof *p.bit);
    p.before = svo_alloc(a, p.words, sizeof *p.before);
    bool ok = t->record != NULL && t->record_step != NULL && t->record_cell != NULL && t->bucket != NULL && p.bit != NULL && p.before != NULL;
    ok = ok && fill_levels(t, v, &p) && shrink_top(t);
    svo_free(a, p.bit, p.words, sizeof *p.bit);
    svo_free(a, p.before, p.words, sizeof *p.before);
    if (ok) make_buckets(t);
    else svoi_records_free(t, a);
}

void svoi_records_free(svoi_top *t, const svo_allocator *a)
{
    svo_free(a, t->record, t->record_count, sizeof *t->record);
    svo_free(a, t->record_step, t->node_count, sizeof *t->record_step);
    svo_free(a, t->record_cell, t->cell_count, sizeof *t->record_cell);
    svo_free(a, t->bucket, t->bucket_count, sizeof *t->bucket);
    t->record = NULL, t->record_step = NULL, t->record_cell = NULL, t->bucket = NULL;
}
