/* Algorithm 1: svo_algorithm1.h. Phase one looks only at zones, places where a block that saves something may lie: such a block is longer than a
 * palette costs, so it holds one of the probes that lie a little closer to each other, and no probe with more than eight values lies in it. */
#include "svoi_algorithm1.h"

#include <stdlib.h>
#include <string.h>

#include "svo_task.h"

enum { LARGE = 4 /* widths of phase one: 0..3 */, WIDTHS = 9 /* of phase two: 0..8 */, PIECES = 64, PROBE = 32, MOST_WORKERS = 256 };

typedef struct part { uint32_t begin, end; } part; /* runs */
typedef struct found { uint64_t begin, end; uint32_t bits; } found; /* values */
typedef struct gap { uint64_t begin, end; } gap; /* values */

typedef struct list {
    found *at;
    uint64_t count, capacity;
} list;

typedef struct state {
    const svo_allocator *a;
    const uint32_t *index;
    uint64_t count, table_count;
    uint32_t directory_bits, table_bits, threads;
    uint32_t probe, step; /* values of a probe, and from one to the next */
    uint64_t probes;
    uint8_t *hot;     /* of each probe: at most eight values, perhaps */
    gap *zones;
    uint32_t *zone_run; /* of each zone its first run, and behind the last */
    uint64_t zone_count, zone_capacity;
    uint32_t runs;    /* of all zones, with an empty one behind those of each */
    uint32_t *value;  /* of each run */
    uint64_t *start;  /* of each run; the empty ones begin where their zones end */
    uint32_t *reach[LARGE]; /* runs from i to reach[w][i] hold at most 2^w different values */
    uint32_t leaves;  /* a power of two */
    uint32_t *best[LARGE]; /* a tree over runs: from which the largest block begins */
    part *stack;      /* what is left to do before pieces are given to threads */
    uint64_t stack_count, stack_capacity;
    list *lists;      /* of each worker */
    gap *gaps;        /* what phase one left */
    uint64_t gap_count;
} state;

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)"); }

static bool add(const state *s, list *l, uint64_t begin, uint64_t end, uint32_t bits)
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

/* --- zones ------------------------------------------------------------------------------------------------------- */

/* Bits of a set in which different values may be one: never more than there are. */
static inline uint64_t sketch(const uint32_t *v, uint32_t n)
{
    uint64_t set = 0;
    for (uint32_t i = 0; i < n; i++) set |= (uint64_t)1 << (v[i] * 2654435761u >> 26);
    return set;
}

static svo_result probe_some(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    state *s = user;
    const uint32_t half = s->probe / 2, rest = s->probe - half;
    for (uint64_t i = begin; i < end; i++) {
        const uint32_t *v = s->index + i * s->step;
        uint64_t set = sketch(v, half);
        bool hot = __builtin_popcountll(set) <= 1 << (LARGE - 1);
        s->hot[i] = hot && __builtin_popcountll(set | sketch(v + half, rest)) <= 1 << (LARGE - 1);
    }
    return SVO_OK;
}

static bool add_zone(state *s, gap z)
{
    if (s->zone_count != 0 && z.begin < s->zones[s->zone_count - 1].end) { /* they share a part of a probe */
        s->zones[s->zone_count - 1].end = z.end;
        return true;
    }
    if (s->zone_count == s->zone_capacity) {
        uint64_t capacity = s->zone_capacity * 2 + 64;
        gap *zones = svo_alloc(s->a, capacity, sizeof *zones);
        if (zones == NULL) return false;
        if (s->zone_count != 0) memcpy(zones, s->zones, (size_t)s->zone_count * sizeof *zones);
        svo_free(s->a, s->zones, s->zone_capacity, sizeof *zones);
        s->zones = zones, s->zone_capacity = capacity;
    }
    s->zones[s->zone_count++] = z;
    return true;
}

/* Between two probes that are not hot a block may begin with the second value of the one and end before the last of the other. */
static svo_result find_zones(state *s, svo_error *err)
{
    uint64_t shortest = (uint64_t)s->table_bits + s->directory_bits + 1; /* a block of one value that saves something; those of more are longer */
    s->probe = shortest < 2 * PROBE ? (uint32_t)(shortest + 1) / 2 : PROBE;
    s->step = (uint32_t)shortest - s->probe + 1;
    s->probes = s->count < s->probe ? 0 : (s->count - s->probe) / s->step + 1;
    s->hot = svo_alloc(s->a, s->probes + 1, 1);
    if (s->hot == NULL) return no_memory(err);
    SVO_TRY(svo_parallel_for(s->threads, s->probes, 4096, probe_some, s, err));
    s->hot[s->probes] = 0;
    for (uint64_t i = 0; i < s->probes;) {
        const uint8_t *next = memchr(s->hot + i, 1, (size_t)(s->probes - i));
        if (next == NULL) break;
        uint64_t first = (uint64_t)(next - s->hot), last = first;
        while (s->hot[last] != 0) last++;
        uint64_t begin = first != 0 ? (first - 1) * s->step + 1 : 0, end = last < s->probes ? last * s->step + s->probe - 1 : s->count;
        if (!add_zone(s, (gap){begin, end})) return no_memory(err);
        i = last;
    }
    return SVO_OK;
}

/* Is there a block in the zone that saves something? `times` is all 0 before and after. */
static bool worth_it(const state *s, gap z, uint32_t *times)
{
    const uint32_t *v = s->index;
    for (uint32_t w = 0; w < LARGE; w++) {
        const uint64_t shortest = ((uint64_t)s->table_bits << w) + s->directory_bits + 1;
        uint64_t begin = z.begin, end = z.begin;
        uint32_t distinct = 0;
        bool enough = false;
        for (; end < z.end && !enough; end++) {
            if (times[v[end]]++ == 0) distinct++;
            for (; distinct > 1u << w; begin++)
                if (--times[v[begin]] == 0) distinct--;
            enough = end + 1 - begin >= shortest;
        }
        for (; begin < end; begin++) times[v[begin]] = 0;
        if (enough) return true;
    }
    return false;
}

static svo_result look_at_zones(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    state *s = user;
    uint32_t *times = svo_calloc(s->a, s->table_count, sizeof *times);
    if (times == NULL) return no_memory(err);
    for (uint64_t z = begin; z < end; z++)
        if (!worth_it(s, s->zones[z], times)) s->zones[z].end = s->zones[z].begin;
    svo_free(s->a, times, s->table_count, sizeof *times);
    return SVO_OK;
}

static svo_result drop_zones(state *s, svo_error *err)
{
    SVO_TRY(svo_parallel_for(s->threads, s->zone_count, 1024, look_at_zones, s, err));
    uint64_t kept = 0;
    for (uint64_t z = 0; z < s->zone_count; z++)
        if (s->zones[z].begin < s->zones[z].end) s->zones[kept++] = s->zones[z];
    s->zone_count = kept;
    return SVO_OK;
}

static uint64_t count_runs(const uint32_t *v, uint64_t n)
{
    uint64_t runs = 1;
    for (uint64_t i = 1; i < n; i++) runs += v[i] != v[i - 1];
    return runs;
}

static svo_result count_zones(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    state *s = user;
    for (uint64_t z = begin; z < end; z++) {
        uint64_t runs = count_runs(s->index + s->zones[z].begin, s->zones[z].end - s->zones[z].begin) + 1;
        s->zone_run[z] = runs < UINT32_MAX / 2 ? (uint32_t)runs : UINT32_MAX / 2;
    }
    return SVO_OK;
}

static svo_result fill_zones(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    state *s = user;
    for (uint64_t z = begin; z < end; z++) {
        uint32_t at = s->zone_run[z], value = 0;
        gap g = s->zones[z];
        for (uint64_t i = g.begin; i < g.end; i++) {
            if (i != g.begin && s->index[i] == value) continue;
            s->value[at] = value = s->index[i];
            s->start[at++] = i;
        }
        s->value[at] = value, s->start[at] = g.end;
    }
    return SVO_OK;
}

static svo_result find_runs(state *s, svo_error *err)
{
    s->zone_run = svo_alloc(s->a, s->zone_count + 1, sizeof *s->zone_run);
    if (s->zone_run == NULL) return no_memory(err);
    SVO_TRY(svo_parallel_for(s->threads, s->zone_count, 16, count_zones, s, err));
    uint64_t runs = 0;
    for (uint64_t z = 0; z < s->zone_count; z++) {
        uint64_t some = s->zone_run[z];
        s->zone_run[z] = (uint32_t)runs;
        runs += some;
        if (runs >= UINT32_MAX / 2) return svo_fail(err, SVO_LIMIT, "more than 2^31 runs of values");
    }
    s->zone_run[s->zone_count] = s->runs = (uint32_t)runs;
    s->value = svo_alloc(s->a, runs, sizeof *s->value);
    s->start = svo_alloc(s->a, runs, sizeof *s->start);
    if (runs != 0 && (s->value == NULL || s->start == NULL)) return no_memory(err);
    s->leaves = 1;
    while (s->leaves < s->runs) s->leaves *= 2;
    return svo_parallel_for(s->threads, s->zone_count, 16, fill_zones, s, err);
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
    uint32_t *times = svo_calloc(s->a, s->table_count, sizeof *times);
    s->reach[w] = svo_alloc(s->a, s->runs, sizeof *s->reach[w]);
    s->best[w] = svo_alloc(s->a, 2 * (uint64_t)s->leaves, sizeof *s->best[w]);
    if (times == NULL || s->reach[w] == NULL || s->best[w] == NULL) {
        svo_free(s->a, times, s->table_count, sizeof *times);
        return no_memory(err);
    }
    for (uint64_t z = 0; z < s->zone_count; z++) {
        uint32_t first = s->zone_run[z], last = s->zone_run[z + 1] - 1, distinct = 0, end = first;
        for (uint32_t i = first; i < last; i++) {
            for (; end < last; end++) {
                if (times[s->value[end]] == 0) {
                    if (distinct == 1u << w) break;
                    distinct++;
                }
                times[s->value[end]]++;
            }
            s->reach[w][i] = end;
            if (--times[s->value[i]] == 0) distinct--;
        }
        s->reach[w][last] = last;
    }
    svo_free(s->a, times, s->table_count, sizeof *times);
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

static svo_result do_pieces(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    state *s = user;
    list *l = &s->lists[worker];
    part *stack = NULL, block;
    uint64_t count = 0, capacity = 0;
    uint32_t bits;
    bool ok = true;
    for (uint64_t i = begin; i < end && ok; i++) {
        ok = push(s, &stack, &count, &capacity, s->stack[i]);
        while (ok && count != 0) {
            part p = stack[--count];
            if (large(s, p, &block, &bits))
                ok = add(s, l, s->start[block.begin], s->start[block.end], bits) && push(s, &stack, &count, &capacity, (part){p.begin, block.begin}) &&
                     push(s, &stack, &count, &capacity, (part){block.end, p.end});
        }
    }
    svo_free(s->a, stack, capacity, sizeof *stack);
    return ok ? SVO_OK : no_memory(err);
}

static int compare_found(const void *a, const void *b)
{
    const found *x = a, *y = b;
    return (x->begin > y->begin) - (x->begin < y->begin);
}

/* What the workers found behind *head, in order. */
static bool gather(state *s, list *head)
{
    bool ok = true;
    for (uint32_t i = 0; i < s->threads && ok; i++) {
        for (uint64_t k = 0; k < s->lists[i].count && ok; k++) ok = add(s, head, s->lists[i].at[k].begin, s->lists[i].at[k].end, s->lists[i].at[k].bits);
        s->lists[i].count = 0;
    }
    if (ok && head->count != 0) qsort(head->at, (size_t)head->count, sizeof *head->at, compare_found);
    return ok;
}

/* Zones are independent, and so are parts once they are cut: cut the largest ones here until there are enough for all threads. */
static svo_result phase_one(state *s, list *head, svo_error *err)
{
    SVO_TRY(find_zones(s, err));
    SVO_TRY(drop_zones(s, err));
    if (s->zone_count == 0) return SVO_OK;
    SVO_TRY(find_runs(s, err));
    SVO_TRY(svo_parallel_for(s->threads, LARGE, 1, make_widths, s, err));
    bool ok = true;
    for (uint64_t z = 0; z < s->zone_count && ok; z++) ok = push(s, &s->stack, &s->stack_count, &s->stack_capacity, (part){s->zone_run[z], s->zone_run[z + 1] - 1});
    for (uint64_t step = 0; ok && s->threads > 1 && s->stack_count != 0 && s->stack_count < PIECES && step < 4 * PIECES; step++) {
        uint64_t pick = 0;
        for (uint64_t i = 1; i < s->stack_count; i++)
            if (s->stack[i].end - s->stack[i].begin > s->stack[pick].end - s->stack[pick].begin) pick = i;
        part p = s->stack[pick], block;
        uint32_t bits;
        s->stack[pick] = s->stack[--s->stack_count];
        if (large(s, p, &block, &bits))
            ok = add(s, head, s->start[block.begin], s->start[block.end], bits) && push(s, &s->stack, &s->stack_count, &s->stack_capacity, (part){p.begin, block.begin}) &&
                 push(s, &s->stack, &s->stack_count, &s->stack_capacity, (part){block.end, p.end});
    }
    if (!ok) return no_memory(err);
    SVO_TRY(svo_parallel_for(s->threads, s->stack_count, 16, do_pieces, s, err));
    return gather(s, head) ? SVO_OK : no_memory(err);
}

static void forget_phase_one(state *s)
{
    for (uint32_t w = 0; w < LARGE; w++) {
        svo_free(s->a, s->reach[w], s->runs, sizeof(uint32_t));
        svo_free(s->a, s->best[w], 2 * (uint64_t)s->leaves, sizeof(uint32_t));
        s->reach[w] = s->best[w] = NULL;
    }
    svo_free(s->a, s->stack, s->stack_capacity, sizeof *s->stack);
    svo_free(s->a, s->value, s->runs, sizeof *s->value);
    svo_free(s->a, s->start, s->runs, sizeof *s->start);
    svo_free(s->a, s->zone_run, s->zone_count + 1, sizeof *s->zone_run);
    svo_free(s->a, s->zones, s->zone_capacity, sizeof *s->zones);
    svo_free(s->a, s->hot, s->probes + 1, 1);
    s->stack = NULL, s->value = NULL, s->start = NULL, s->zone_run = NULL, s->zones = NULL, s->hot = NULL;
}

/* FindRemainingBlocks, from the first value of what is left. `seen` holds the stamp with which a table index was last met. A block of w bits a value
 * takes more than w bits a value: once one takes no more, wider ones are not looked for. */
static uint64_t next_block(const state *s, uint64_t begin, uint64_t end, uint64_t *seen, uint64_t stamp, uint32_t *bits)
{
    const uint32_t *v = s->index;
    uint64_t at = begin, to = end;
    uint32_t distinct = 0;
    double least = 0;
    for (uint32_t w = 0; w < WIDTHS && (w == 0 || (double)w < least); w++) {
        for (; at < end; at++) {
            if (seen[v[at]] == stamp) continue;
            if (distinct == 1u << w) break;
            seen[v[at]] = stamp;
            distinct++;
        }
        double each = (double)memory(s, at - begin, w) / (double)(at - begin);
        if (w == 0 || each < least) least = each, *bits = w, to = at;
    }
    return to;
}

static svo_result do_gaps(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    state *s = user;
    uint64_t *seen = svo_calloc(s->a, s->table_count, sizeof *seen), stamp = 0;
    bool ok = seen != NULL;
    for (uint64_t i = begin; i < end && ok; i++)
        for (gap g = s->gaps[i]; g.begin < g.end && ok;) {
            uint32_t bits = 0;
            uint64_t to = next_block(s, g.begin, g.end, seen, ++stamp, &bits);
            ok = add(s, &s->lists[worker], g.begin, to, bits);
            g.begin = to;
        }
    svo_free(s->a, seen, s->table_count, sizeof *seen);
    return ok ? SVO_OK : no_memory(err);
}

static svo_result phase_two(state *s, list *head, svo_error *err)
{
    s->gaps = svo_alloc(s->a, head->count + 1, sizeof *s->gaps);
    if (s->gaps == NULL) return no_memory(err);
    uint64_t at = 0, room = head->count + 1;
    for (uint64_t i = 0; i <= head->count; i++) {
        uint64_t end = i < head->count ? head->at[i].begin : s->count;
        if (at < end) s->gaps[s->gap_count++] = (gap){at, end};
        if (i < head->count) at = head->at[i].end;
    }
    uint64_t grain = s->gap_count / (4 * (uint64_t)s->threads) + 1;
    svo_result r = svo_parallel_for(s->threads, s->gap_count, grain < 256 ? grain : 256, do_gaps, s, err);
    svo_free(s->a, s->gaps, room, sizeof *s->gaps);
    if (r == SVO_OK && !gather(s, head)) r = no_memory(err);
    return r;
}

/* --- palettes ---------------------------------------------------------------------------------------------------- */

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
    uint64_t *set;               /* a bit for each table index, all 0 between uses */
} shelf;

/* Ascending; all different. */
static void sort_entries(shelf *sh, uint32_t *to, uint32_t n)
{
    uint32_t low = UINT32_MAX, high = 0, at = 0;
    for (uint32_t i = 0; i < n; i++) low = to[i] / 64 < low ? to[i] / 64 : low, high = to[i] / 64 > high ? to[i] / 64 : high;
    if (n < 2 || high - low > 16 * n) {
        if (n > 1) qsort(to, n, sizeof *to, compare_u32);
        return;
    }
    for (uint32_t i = 0; i < n; i++) sh->set[to[i] / 64] |= (uint64_t)1 << to[i] % 64;
    for (uint32_t k = low; k <= high; k++) {
        for (uint64_t bits = sh->set[k]; bits != 0; bits &= bits - 1) to[at++] = 64 * k + (uint32_t)__builtin_ctzll(bits);
        sh->set[k] = 0;
    }
}

/* The palette of values [begin, end), shared with an equal one. Stored as its length, then its entries. */
static uint64_t put_palette(const state *s, shelf *sh, svo_algorithm1_result *r, uint64_t *used, uint64_t begin, uint64_t end, uint64_t *number)
{
    uint32_t *to = r->palettes + *used + 1, n = 0;
    sh->stamp++;
    for (uint64_t i = begin; i < end; i++)
        if (sh->seen[s->index[i]] != sh->stamp) {
            sh->seen[s->index[i]] = sh->stamp;
            to[n++] = s->index[i];
        }
    sort_entries(sh, to, n);
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

static svo_result collect(const state *s, list *head, svo_algorithm1_result *r, svo_error *err)
{
    uint64_t entries = 1;
    for (uint64_t i = 0; i < head->count; i++) {
        uint64_t most = (uint64_t)1 << head->at[i].bits, values = head->at[i].end - head->at[i].begin;
        entries += 1 + (most < values ? most : values);
    }
    shelf sh = {.slot_count = 64};
    while (sh.slot_count < 2 * head->count) sh.slot_count *= 2;
    r->capacity[0] = head->count, r->capacity[1] = entries + 512;
    r->blocks = svo_alloc(s->a, r->capacity[0], sizeof *r->blocks);
    r->palettes = svo_alloc(s->a, r->capacity[1], sizeof *r->palettes);
    sh.slots = svo_calloc(s->a, sh.slot_count, sizeof *sh.slots);
    sh.number = svo_calloc(s->a, sh.slot_count, sizeof *sh.number);
    sh.seen = svo_calloc(s->a, s->table_count, sizeof *sh.seen);
    sh.set = svo_calloc(s->a, s->table_count / 64 + 1, sizeof *sh.set);
    svo_result result = SVO_OK;
    if ((head->count != 0 && r->blocks == NULL) || r->palettes == NULL || sh.slots == NULL || sh.number == NULL || sh.seen == NULL || sh.set == NULL) {
        result = no_memory(err);
    } else {
        uint64_t used = 0;
        for (uint64_t i = 0; i < head->count; i++) {
            const found *f = &head->at[i];
            svo_algorithm1_block *b = &r->blocks[i];
            b->begin = f->begin;
            b->palette = put_palette(s, &sh, r, &used, f->begin, f->end, &b->palette_number);
            b->bits = f->bits;
            r->bits += (f->end - f->begin) * f->bits + s->directory_bits;
        }
        r->block_count = head->count;
        r->bits += r->palette_entries * s->table_bits;
    }
    svo_free(s->a, sh.slots, sh.slot_count, sizeof *sh.slots);
    svo_free(s->a, sh.number, sh.slot_count, sizeof *sh.number);
    svo_free(s->a, sh.seen, s->table_count, sizeof *sh.seen);
    svo_free(s->a, sh.set, s->table_count / 64 + 1, sizeof *sh.set);
    return result;
}

svo_result svo_algorithm1(const uint32_t *index, uint64_t count, uint64_t table_count, uint32_t directory_bits, uint32_t threads,
                          const svo_allocator *a, svo_algorithm1_result *out, svo_error *err)
{
    return svoi_algorithm1(index, count, table_count, svo_palette_table_bits(table_count), directory_bits, threads, a, out, err);
}

svo_result svoi_algorithm1(const uint32_t *index, uint64_t count, uint64_t table_count, uint32_t table_bits, uint32_t directory_bits, uint32_t threads,
                           const svo_allocator *a, svo_algorithm1_result *out, svo_error *err)
{
    state s = {.a = a, .index = index, .count = count, .table_count = table_count, .directory_bits = directory_bits, .table_bits = table_bits,
               .threads = threads != 0 ? threads : svo_processor_count()};
    list head = {0}, lists[MOST_WORKERS] = {0};
    svo_algorithm1_result r = {0};
    *out = r;
    if (count == 0) return SVO_OK;
    if (s.threads > MOST_WORKERS) s.threads = MOST_WORKERS;
    s.lists = lists;
    double started = svo_seconds();
    svo_result result = phase_one(&s, &head, err);
    forget_phase_one(&s);
    r.seconds_large = svo_seconds() - started;
    if (result == SVO_OK) result = phase_two(&s, &head, err);
    if (result == SVO_OK) result = collect(&s, &head, &r, err);
    for (uint32_t i = 0; i < s.threads; i++) svo_free(a, lists[i].at, lists[i].capacity, sizeof(found));
    svo_free(a, head.at, head.capacity, sizeof(found));
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
