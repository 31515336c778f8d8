#include "svoi_algorithm1.h"

#include <stdlib.h>
#include <string.h>

#include "svo_task.h"

enum { LARGE = 4 /* widths of phase one: 0..3 */, WIDTHS = 9 /* of phase two: 0..8 */, PIECES = 64 };

typedef struct part { uint32_t begin, end; } part; /* runs */
typedef struct found { uint32_t begin, end, bits; } found;

typedef struct list {
    found *at;
    uint64_t count, capacity;
} list;

typedef struct state {
    const svo_allocator *a;
    const uint32_t *index;
    uint64_t count, table_count;
    uint32_t directory_bits, table_bits;
    uint32_t runs;
    uint32_t *value;  /* of each run */
    uint64_t *start;  /* of each run, and the end of the last */
    uint32_t *reach[WIDTHS]; /* runs from i to reach[w][i] hold at most 2^w different values */
    uint32_t leaves;  /* a power of two */
    uint32_t *best[LARGE]; /* a tree over runs: from which the largest block begins */
    part *stack;      /* what is left to do before pieces are given to threads */
    uint64_t stack_count, stack_capacity;
    list *lists;      /* of each piece */
} state;

static bool add(const state *s, list *l, uint32_t begin, uint32_t end, uint32_t bits)
{
    if (l->count == l->capacity) {
        uint64_t capacity = l->capacity * 2 + 64;
        found *at = svo_alloc(s->a, capacity, sizeof *at);
        if (at == NULL) return false;
        if (l->count != 0) memcpy(at, l->at, (size_t)l->count * sizeof *at);
        svo_free(s->a, l->at, l->capacity, sizeof *at);
        l->at = at, l->capacity = capacity;
    }
    l->at[l->count++] = (found){begin, end, bits};
    return true;
}

static bool push(const state *s, part **stack, uint64_t *count, uint64_t *capacity, part p)
{
    if (p.begin >= p.end) return true;
    if (*count == *capacity) {
        uint64_t more = *capacity * 2 + 256;
        part *at = svo_alloc(s->a, more, sizeof *at);
        if (at == NULL) return false;
        if (*count != 0) memcpy(at, *stack, (size_t)*count * sizeof *at);
        svo_free(s->a, *stack, *capacity, sizeof *at);
        *stack = at, *capacity = more;
    }
    (*stack)[(*count)++] = p;
    return true;
}

/* --- windows and the tree of maxima ------------------------------------------------------------------------------ */

static uint64_t length(const state *s, uint32_t w, uint32_t i) { return i == UINT32_MAX ? 0 : s->start[s->reach[w][i]] - s->start[i]; }

static uint32_t longer(const state *s, uint32_t w, uint32_t x, uint32_t y)
{
    uint64_t a = length(s, w, x), b = length(s, w, y);
    return a > b || (a == b && x < y) ? x : y;
}

static svo_result make_width(state *s, uint32_t w, svo_error *err)
{
    uint32_t *times = svo_calloc(s->a, s->table_count, sizeof *times), distinct = 0, end = 0;
    s->reach[w] = svo_alloc(s->a, s->runs, sizeof *s->reach[w]);
    if (w < LARGE) s->best[w] = svo_alloc(s->a, 2 * (uint64_t)s->leaves, sizeof *s->best[w]);
    if (times == NULL || s->reach[w] == NULL || (w < LARGE && s->best[w] == NULL)) {
        svo_free(s->a, times, s->table_count, sizeof *times);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    }
    for (uint32_t i = 0; i < s->runs; i++) {
        for (; end < s->runs; end++) {
            if (times[s->value[end]] == 0) {
                if (distinct == 1u << w) break;
                distinct++;
            }
            times[s->value[end]]++;
        }
        s->reach[w][i] = end;
        if (--times[s->value[i]] == 0) distinct--;
    }
    svo_free(s->a, times, s->table_count, sizeof *times);
    if (w >= LARGE) return SVO_OK;
    for (uint32_t i = 0; i < s->leaves; i++) s->best[w][s->leaves + i] = i < s->runs ? i : UINT32_MAX;
    for (uint32_t i = s->leaves; i-- > 1;) s->best[w][i] = longer(s, w, s->best[w][2 * i], s->best[w][2 * i + 1]);
    return SVO_OK;
}

static svo_result make_widths(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    for (uint64_t w = begin; w < end; w++) SVO_TRY(make_width(user, (uint32_t)w, err));
    return SVO_OK;
}

/* The largest block of at most 2^w values inside the part. */
static part largest(const state *s, part p, uint32_t w)
{
    /* from `cut` on blocks are cut off by the end of the part: the first of those is the largest */
    uint32_t low = p.begin, high = p.end;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (s->reach[w][middle] < p.end) low = middle + 1;
        else high = middle;
    }
    uint32_t cut = low, best = UINT32_MAX;
    for (uint32_t l = p.begin + s->leaves, r = cut + s->leaves; l < r; l >>= 1, r >>= 1) {
        if (l & 1) best = longer(s, w, best, s->best[w][l++]);
        if (r & 1) best = longer(s, w, best, s->best[w][--r]);
    }
    if (cut < p.end && (best == UINT32_MAX || s->start[p.end] - s->start[cut] > length(s, w, best))) return (part){cut, p.end};
    return (part){best, s->reach[w][best]};
}

/* --- the two phases ---------------------------------------------------------------------------------------------- */

static uint64_t memory(const state *s, uint64_t n, uint32_t w) { return n * w + ((uint64_t)s->table_bits << w) + s->directory_bits; }

/* FindRemainingBlocks */
static bool remaining(const state *s, part p, list *l)
{
    while (p.begin < p.end) {
        double least = 0;
        uint32_t bits = 0, end = 0;
        for (uint32_t w = 0; w < WIDTHS; w++) {
            uint32_t to = s->reach[w][p.begin] < p.end ? s->reach[w][p.begin] : p.end;
            uint64_t n = s->start[to] - s->start[p.begin];
            double each = (double)memory(s, n, w) / (double)n;
            if (w == 0 || each < least) least = each, bits = w, end = to;
        }
        if (!add(s, l, p.begin, end, bits)) return false;
        p.begin = end;
    }
    return true;
}

/* One step of FindLargeBlocks: a block, or nothing (then the part is for phase two). */
static bool large(const state *s, part p, part *block, uint32_t *bits)
{
    for (uint32_t w = 0; w < LARGE; w++) {
        *block = largest(s, p, w);
        uint64_t n = s->start[block->end] - s->start[block->begin];
        *bits = w;
        if (memory(s, n, w) < n * (w + 1)) return true;
    }
    return false;
}

static svo_result do_piece(state *s, part first, list *l, svo_error *err)
{
    part *stack = NULL, block;
    uint64_t count = 0, capacity = 0;
    uint32_t bits;
    bool ok = push(s, &stack, &count, &capacity, first);
    while (ok && count != 0) {
        part p = stack[--count];
        if (!large(s, p, &block, &bits)) ok = remaining(s, p, l);
        else
            ok = add(s, l, block.begin, block.end, bits) && push(s, &stack, &count, &capacity, (part){p.begin, block.begin}) &&
                 push(s, &stack, &count, &capacity, (part){block.end, p.end});
    }
    svo_free(s->a, stack, capacity, sizeof *stack);
    return ok ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
}

static svo_result do_pieces(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    state *s = user;
    for (uint64_t i = begin; i < end; i++) SVO_TRY(do_piece(s, s->stack[i], &s->lists[i], err));
    return SVO_OK;
}

/* Parts are independent once they are cut: cut the largest ones here until there are enough for all threads. */
static svo_result partition(state *s, uint32_t threads, list *head, svo_error *err)
{
    bool ok = push(s, &s->stack, &s->stack_count, &s->stack_capacity, (part){0, s->runs});
    for (uint64_t step = 0; ok && s->stack_count != 0 && s->stack_count < PIECES && step < 4 * PIECES; step++) {
        uint64_t pick = 0;
        for (uint64_t i = 1; i < s->stack_count; i++)
            if (s->stack[i].end - s->stack[i].begin > s->stack[pick].end - s->stack[pick].begin) pick = i;
        part p = s->stack[pick], block;
        uint32_t bits;
        if (!large(s, p, &block, &bits)) break;
        s->stack[pick] = s->stack[--s->stack_count];
        ok = add(s, head, block.begin, block.end, bits) && push(s, &s->stack, &s->stack_count, &s->stack_capacity, (part){p.begin, block.begin}) &&
             push(s, &s->stack, &s->stack_count, &s->stack_capacity, (part){block.end, p.end});
    }
    s->lists = ok ? svo_calloc(s->a, s->stack_count + 1, sizeof *s->lists) : NULL;
    if (s->lists == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    return svo_parallel_for(threads, s->stack_count, 1, do_pieces, s, err);
}

/* --- palettes ---------------------------------------------------------------------------------------------------- */

static int compare_found(const void *a, const void *b)
{
    const found *x = a, *y = b;
    return (x->begin > y->begin) - (x->begin < y->begin);
}

static int compare_u32(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

typedef struct shelf {
    uint64_t *slots, slot_count; /* place of a palette's entries; of each also its number */
    uint64_t *number;
    uint64_t *seen;              /* table index -> stamp */
    uint64_t stamp;
} shelf;


/* The palette of runs [begin, end), shared with an equal one. Stored as its length, then its entries. */
static uint64_t put_palette(const state *s, shelf *sh, svo_algorithm1_result *r, uint64_t *used, uint32_t begin, uint32_t end, uint64_t *number)
{
    uint32_t *to = r->palettes + *used + 1, n = 0;
    sh->stamp++;
    for (uint32_t i = begin; i < end; i++)
        if (sh->seen[s->value[i]] != sh->stamp) {
            sh->seen[s->value[i]] = sh->stamp;
            to[n++] = s->value[i];
        }
    qsort(to, n, sizeof *to, compare_u32);
    to[-1] = n;
    uint64_t hash = n;
    for (uint32_t i = 0; i < n; i++) hash = (hash ^ to[i]) * 0x9e3779b97f4a7c15u, hash ^= hash >> 29;
    for (uint64_t i = hash & (sh->slot_count - 1);; i = (i + 1) & (sh->slot_count - 1)) {
        if (sh->slots[i] == 0) {
            sh->slots[i] = *used + 1;
            *used += n + 1;
            sh->number[i] = *number = r->palette_count++;
            r->palette_entries += n;
            return sh->slots[i];
        }
        uint64_t at = sh->slots[i] - 1;
        if (r->palettes[at] == n && memcmp(r->palettes + at + 1, to, n * sizeof *to) == 0) {
            *number = sh->number[i];
            return at + 1;
        }
    }
}

static svo_result collect(state *s, list *head, svo_algorithm1_result *r, svo_error *err)
{
    for (uint64_t i = 0; i < s->stack_count; i++)
        for (uint64_t k = 0; k < s->lists[i].count; k++)
            if (!add(s, head, s->lists[i].at[k].begin, s->lists[i].at[k].end, s->lists[i].at[k].bits))
                return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    if (head->count != 0) qsort(head->at, (size_t)head->count, sizeof *head->at, compare_found);
    uint64_t entries = 1;
    for (uint64_t i = 0; i < head->count; i++) {
        uint64_t most = (uint64_t)1 << head->at[i].bits, runs = head->at[i].end - head->at[i].begin;
        entries += 1 + (most < runs ? most : runs);
    }
    shelf sh = {.slot_count = 64};
    while (sh.slot_count < 2 * head->count) sh.slot_count *= 2;
    r->capacity[0] = head->count, r->capacity[1] = entries + 512;
    r->blocks = svo_alloc(s->a, r->capacity[0], sizeof *r->blocks);
    r->palettes = svo_alloc(s->a, r->capacity[1], sizeof *r->palettes);
    sh.slots = svo_calloc(s->a, sh.slot_count, sizeof *sh.slots);
    sh.number = svo_calloc(s->a, sh.slot_count, sizeof *sh.number);
    sh.seen = svo_calloc(s->a, s->table_count, sizeof *sh.seen);
    svo_result result = SVO_OK;
    if ((head->count != 0 && r->blocks == NULL) || r->palettes == NULL || sh.slots == NULL || sh.number == NULL || sh.seen == NULL) {
        result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    } else {
        uint64_t used = 0;
        for (uint64_t i = 0; i < head->count; i++) {
            const found *f = &head->at[i];
            svo_algorithm1_block *b = &r->blocks[i];
            b->begin = s->start[f->begin];
            b->palette = put_palette(s, &sh, r, &used, f->begin, f->end, &b->palette_number);
            b->bits = f->bits;
            r->bits += (s->start[f->end] - s->start[f->begin]) * f->bits + s->directory_bits;
        }
        r->block_count = head->count;
        r->bits += r->palette_entries * s->table_bits;
    }
    svo_free(s->a, sh.slots, sh.slot_count, sizeof *sh.slots);
    svo_free(s->a, sh.number, sh.slot_count, sizeof *sh.number);
    svo_free(s->a, sh.seen, s->table_count, sizeof *sh.seen);
    return result;
}

static svo_result find_runs(state *s, svo_error *err)
{
    uint64_t runs = 0;
    for (uint64_t i = 0; i < s->count; i++) runs += i == 0 || s->index[i] != s->index[i - 1];
    if (runs >= UINT32_MAX / 2) return svo_fail(err, SVO_LIMIT, "more than 2^31 runs of values");
    s->runs = (uint32_t)runs;
    s->value = svo_alloc(s->a, runs, sizeof *s->value);
    s->start = svo_alloc(s->a, runs + 1, sizeof *s->start);
    if ((runs != 0 && s->value == NULL) || s->start == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    runs = 0;
    for (uint64_t i = 0; i < s->count; i++)
        if (i == 0 || s->index[i] != s->index[i - 1]) s->value[runs] = s->index[i], s->start[runs++] = i;
    s->start[runs] = s->count;
    s->leaves = 1;
    while (s->leaves < s->runs) s->leaves *= 2;
    return SVO_OK;
}

svo_result svo_algorithm1(const uint32_t *index, uint64_t count, uint64_t table_count, uint32_t directory_bits, uint32_t threads,
                          const svo_allocator *a, svo_algorithm1_result *out, svo_error *err)
{
    return svoi_algorithm1(index, count, table_count, svo_palette_table_bits(table_count), directory_bits, threads, a, out, err);
}

svo_result svoi_algorithm1(const uint32_t *index, uint64_t count, uint64_t table_count, uint32_t table_bits, uint32_t directory_bits, uint32_t threads,
                           const svo_allocator *a, svo_algorithm1_result *out, svo_error *err)
{
    state s = {.a = a, .index = index, .count = count, .table_count = table_count, .directory_bits = directory_bits, .table_bits = table_bits};
    list head = {0};
    svo_algorithm1_result r = {0};
    *out = r;
    if (count == 0) return SVO_OK;
    svo_result result = find_runs(&s, err);
    if (result == SVO_OK) result = svo_parallel_for(threads, WIDTHS, 1, make_widths, &s, err);
    if (result == SVO_OK) result = partition(&s, threads, &head, err);
    if (result == SVO_OK) result = collect(&s, &head, &r, err);
    for (uint64_t i = 0; s.lists != NULL && i < s.stack_count; i++) svo_free(a, s.lists[i].at, s.lists[i].capacity, sizeof(found));
    svo_free(a, s.lists, s.stack_count + 1, sizeof *s.lists);
    svo_free(a, head.at, head.capacity, sizeof(found));
    svo_free(a, s.stack, s.stack_capacity, sizeof *s.stack);
    for (uint32_t w = 0; w < WIDTHS; w++) svo_free(a, s.reach[w], s.runs, sizeof(uint32_t));
    for (uint32_t w = 0; w < LARGE; w++) svo_free(a, s.best[w], 2 * (uint64_t)s.leaves, sizeof(uint32_t));
    svo_free(a, s.value, s.runs, sizeof *s.value);
    svo_free(a, s.start, (uint64_t)s.runs + 1, sizeof *s.start);
    if (result == SVO_OK) *out = r;
    else svo_algorithm1_free(&r, a);
    return result;
}

void svo_algorithm1_free(svo_algorithm1_result *r, const svo_allocator *a)
{
    svo_free(a, r->blocks, r->capacity[0], sizeof *r->blocks);
    svo_free(a, r->palettes, r->capacity[1], sizeof *r->palettes);
    *r = (svo_algorithm1_result){0};
}
