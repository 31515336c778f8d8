/* Algorithm 1: svo_algorithm1.h. Phase one looks only at zones, places where a block that saves something may lie: such a block is longer than a
 * palette costs, so it holds one of the probes that lie a little closer to each other, and no probe with more than eight values lies in it. */
#include "svoi_algorithm1.h"

#include <stdlib.h>
#include <string.h>
#ifdef __AVX2__
#include <immintrin.h>
#endif

#include "svo_task.h"

enum { LARGE = 4 /* widths of phase one: 0..3 */, WIDTHS = 9 /* of phase two: 0..8 */, LEAF = 16 /* runs */, PROBE = 32, MOST_WORKERS = 256 };

typedef struct part { uint32_t begin, end; } part; /* runs */
typedef struct found { uint64_t begin, end; uint32_t bits; } found; /* values */
typedef struct gap { uint64_t begin, end; } gap; /* values */

typedef struct list {
    found *at;
    uint64_t count, capacity;
} list;

/* What a worker looks at: the runs of a zone, and a part of them. */
typedef struct scratch {
    uint32_t room, runs;
    uint32_t *value;  /* of each run */
    uint64_t *start;  /* of each run, and where the last one ends */
    uint32_t *reach[LARGE]; /* runs from i to reach[w][i] hold at most 2^w different values */
    uint32_t origin, leaves; /* of the trees: a run, and a power of two */
    uint32_t *best[LARGE]; /* from which run of a leaf, or of all below, the largest block begins */
    part *stack;      /* what is left to do */
    uint64_t stack_count, stack_capacity;
} scratch;

typedef struct state {
    const svo_allocator *a;
    const uint32_t *index;
    uint64_t count, table_count;
    uint32_t directory_bits, table_bits, threads;
    uint32_t probe, step; /* values of a probe, and from one to the next */
    uint64_t probes;
    uint8_t *hot;     /* of each probe: at most eight values, perhaps */
    gap *zones;
    uint64_t zone_count, zone_capacity;
    scratch *scratches; /* of each worker */
    list *lists;
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

static bool push(const state *s, scratch *z, part p)
{
    if (p.begin >= p.end) return true;
    if (z->stack_count == z->stack_capacity) {
        uint64_t more = z->stack_capacity * 2 + 256;
        part *at = svo_alloc(s->a, more, sizeof *at);
        if (at == NULL) return false;
        if (z->stack_count != 0) memcpy(at, z->stack, (size_t)z->stack_count * sizeof *at);
        svo_free(s->a, z->stack, z->stack_capacity, sizeof *z->stack);
        z->stack = at, z->stack_capacity = more;
    }
    z->stack[z->stack_count++] = p;
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

/* --- windows and the tree of maxima ------------------------------------------------------------------------------ */

static uint64_t count_runs(const uint32_t *v, uint64_t n)
{
    uint64_t runs = 1;
    for (uint64_t i = 1; i < n; i++) runs += v[i] != v[i - 1];
    return runs;
}

/* Elements of a tree over so many runs: leaves are a power of two. */
static uint64_t nodes_of(uint32_t runs) { return 4 * ((uint64_t)runs / LEAF + 1); }

static void forget_room(const state *s, scratch *z)
{
    for (uint32_t w = 0; w < LARGE; w++) {
        svo_free(s->a, z->reach[w], z->room, sizeof *z->reach[w]);
        svo_free(s->a, z->best[w], nodes_of(z->room), sizeof *z->best[w]);
        z->reach[w] = z->best[w] = NULL;
    }
    svo_free(s->a, z->value, z->room, sizeof *z->value);
    svo_free(s->a, z->start, z->room, sizeof *z->start);
    z->value = NULL, z->start = NULL, z->room = 0;
}

/* Memory for a zone: of runs, which a worker uses again for the next. */
static bool make_room(const state *s, scratch *z, uint32_t runs)
{
    if (runs <= z->room) return true;
    forget_room(s, z);
    uint32_t room = 1024;
    while (room < runs) room = room < UINT32_MAX / 4 ? 2 * room : runs;
    z->room = room;
    z->value = svo_alloc(s->a, room, sizeof *z->value);
    z->start = svo_alloc(s->a, room, sizeof *z->start);
    bool ok = z->value != NULL && z->start != NULL;
    for (uint32_t w = 0; w < LARGE; w++) {
        z->reach[w] = svo_alloc(s->a, room, sizeof *z->reach[w]);
        z->best[w] = svo_alloc(s->a, nodes_of(room), sizeof *z->best[w]);
        ok = ok && z->reach[w] != NULL && z->best[w] != NULL;
    }
    return ok;
}

/* Runs of a zone and where it ends. */
static void find_runs(const state *s, gap g, scratch *z)
{
    const uint32_t *v = s->index;
    uint32_t at = 0;
    z->value[0] = v[g.begin], z->start[0] = g.begin;
    for (uint64_t i = g.begin + 1; i < g.end; i++) { /* without a branch: the next run's place is written until it begins */
        z->value[at + 1] = v[i], z->start[at + 1] = i;
        at += v[i] != v[i - 1];
    }
    z->runs = at + 1;
    z->start[z->runs] = g.end;
}

/* reach: backwards, with the nine different values that come next, in order of where each comes first. A run's value goes to the front, and those
 * before its old place, or all if it was none of the nine, move back by one. */
#ifdef __AVX2__
static void find_reach(scratch *z)
{
    static const uint32_t back[9][8] = {{0, 1, 2, 3, 4, 5, 6, 7}, {0, 0, 2, 3, 4, 5, 6, 7}, {0, 0, 1, 3, 4, 5, 6, 7}, {0, 0, 1, 2, 4, 5, 6, 7}, {0, 0, 1, 2, 3, 5, 6, 7},
                                        {0, 0, 1, 2, 3, 4, 6, 7}, {0, 0, 1, 2, 3, 4, 5, 7}, {0, 0, 1, 2, 3, 4, 5, 6}, {0, 0, 1, 2, 3, 4, 5, 6}};
    __m256i values = _mm256_set1_epi32(-1), places = _mm256_set1_epi32((int)z->runs);
    uint32_t ninth = z->runs;
    for (uint32_t i = z->runs; i-- > 0;) {
        const __m256i v = _mm256_set1_epi32((int)z->value[i]);
        const uint32_t old = (uint32_t)__builtin_ctz((uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpeq_epi32(values, v))) | 256);
        const __m256i order = _mm256_loadu_si256((const __m256i *)back[old]);
        const uint32_t eighth = (uint32_t)_mm256_extract_epi32(places, 7);
        ninth = old == 8 ? eighth : ninth;
        values = _mm256_blend_epi32(_mm256_permutevar8x32_epi32(values, order), v, 1);
        places = _mm256_blend_epi32(_mm256_permutevar8x32_epi32(places, order), _mm256_set1_epi32((int)i), 1);
        z->reach[0][i] = i + 1;
        z->reach[1][i] = (uint32_t)_mm256_extract_epi32(places, 2);
        z->reach[2][i] = (uint32_t)_mm256_extract_epi32(places, 4);
        z->reach[3][i] = ninth;
    }
}
#else
static void find_reach(scratch *z)
{
    uint32_t values[9], places[9];
    for (int q = 0; q < 9; q++) values[q] = UINT32_MAX, places[q] = z->runs;
    for (uint32_t i = z->runs; i-- > 0;) {
        uint32_t value = z->value[i], place = i;
        for (int q = 0; q < 9; q++) {
            const uint32_t v = values[q], at = places[q];
            values[q] = value, places[q] = place;
            if (v == z->value[i]) break;
            value = v, place = at;
        }
        for (uint32_t w = 0; w < LARGE; w++) z->reach[w][i] = places[1 << w];
    }
}
#endif

static uint64_t length(const scratch *z, uint32_t w, uint32_t i) { return i == UINT32_MAX ? 0 : z->start[z->reach[w][i]] - z->start[i]; }

static uint32_t longer(const scratch *z, uint32_t w, uint32_t x, uint32_t y)
{
    uint64_t a = length(z, w, x), b = length(z, w, y);
    return a > b || (a == b && x < y) ? x : y;
}

/* The first of the longest of runs [from, to), or `best` if that is longer or as long and before them. */
static uint32_t longest(const scratch *z, uint32_t w, uint32_t from, uint32_t to, uint32_t best)
{
    uint64_t most = length(z, w, best);
    for (uint32_t i = from; i < to; i++) {
        uint64_t n = z->start[z->reach[w][i]] - z->start[i];
        if (n > most) most = n, best = i;
    }
    return best;
}

/* Trees over the runs of a part, a leaf for every LEAF of them. */
static void make_trees(scratch *z, part p)
{
    uint32_t count = (p.end - p.begin + LEAF - 1) / LEAF;
    z->leaves = 1;
    while (z->leaves < count) z->leaves *= 2;
    z->origin = p.begin;
    for (uint32_t w = 0; w < LARGE; w++) {
        uint32_t *best = z->best[w];
        for (uint32_t i = 0; i < z->leaves; i++) {
            uint32_t from = p.begin + i * LEAF, to = from + LEAF < p.end ? from + LEAF : p.end;
            best[z->leaves + i] = i < count ? longest(z, w, from, to, UINT32_MAX) : UINT32_MAX;
        }
        for (uint32_t i = z->leaves; i-- > 1;) best[i] = longer(z, w, best[2 * i], best[2 * i + 1]);
    }
}

/* The largest block of at most 2^w values inside the part. */
static part largest(const scratch *z, part p, uint32_t w)
{
    /* from `cut` on blocks are cut off by the end of the part: the first of those is the largest */
    uint32_t low = p.begin, high = p.end;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (z->reach[w][middle] < p.end) low = middle + 1;
        else high = middle;
    }
    const uint32_t cut = low, first = (p.begin - z->origin + LEAF - 1) / LEAF, last = (cut - z->origin) / LEAF;
    uint32_t best = UINT32_MAX;
    if (first >= last) {
        best = longest(z, w, p.begin, cut, best);
    } else {
        best = longest(z, w, p.begin, z->origin + first * LEAF, best);
        uint32_t inside = UINT32_MAX;
        for (uint32_t l = first + z->leaves, r = last + z->leaves; l < r; l >>= 1, r >>= 1) {
            if (l & 1) inside = longer(z, w, inside, z->best[w][l++]);
            if (r & 1) inside = longer(z, w, inside, z->best[w][--r]);
        }
        best = longer(z, w, best, inside);
        best = longest(z, w, z->origin + last * LEAF, cut, best);
    }
    if (cut < p.end && (best == UINT32_MAX || z->start[p.end] - z->start[cut] > length(z, w, best))) return (part){cut, p.end};
    return (part){best, z->reach[w][best]};
}

/* --- the two phases ---------------------------------------------------------------------------------------------- */

static uint64_t memory(const state *s, uint64_t n, uint32_t w) { return n * w + ((uint64_t)s->table_bits << w) + s->directory_bits; }

/* Values of the shortest block of w bits that saves something. */
static uint64_t shortest(const state *s, uint32_t w) { return ((uint64_t)s->table_bits << w) + s->directory_bits + 1; }

/* One step of FindLargeBlocks: a block, or nothing (then the part is for phase two). */
static bool large(const state *s, const scratch *z, part p, part *block, uint32_t *bits)
{
    for (uint32_t w = 0; w < LARGE && z->start[p.end] - z->start[p.begin] >= shortest(s, w); w++) {
        *block = largest(z, p, w);
        *bits = w;
        if (z->start[block->end] - z->start[block->begin] >= shortest(s, w)) return true;
    }
    return false;
}

static int compare_found(const void *a, const void *b)
{
    const found *x = a, *y = b;
    return (x->begin > y->begin) - (x->begin < y->begin);
}

/* Its blocks, in order. */
static bool do_part(const state *s, scratch *z, part p, list *l)
{
    part block;
    uint32_t bits;
    const uint64_t first = l->count;
    make_trees(z, p);
    bool ok = push(s, z, p);
    while (ok && z->stack_count != 0) {
        p = z->stack[--z->stack_count];
        if (large(s, z, p, &block, &bits))
            ok = add(s, l, z->start[block.begin], z->start[block.end], bits) && push(s, z, (part){p.begin, block.begin}) && push(s, z, (part){block.end, p.end});
    }
    if (l->count > first + 1) qsort(l->at + first, (size_t)(l->count - first), sizeof *l->at, compare_found);
    return ok;
}

/* Blocks that save something lie side by side in parts that have nothing to do with each other. */
static bool do_zone(const state *s, scratch *z, list *l)
{
    part p = {0, 0};
    bool ok = true;
    for (uint32_t i = 0; i < z->runs && ok; i++) {
        uint32_t to = 0;
        for (uint32_t w = 0; w < LARGE; w++)
            if (length(z, w, i) >= shortest(s, w)) to = z->reach[w][i]; /* the farthest: reach grows with w */
        if (to == 0) continue;
        if (i >= p.end) {
            if (p.begin < p.end) ok = do_part(s, z, p, l);
            p = (part){i, to};
        }
        if (to > p.end) p.end = to;
    }
    if (ok && p.begin < p.end) ok = do_part(s, z, p, l);
    return ok;
}

static svo_result do_zones(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    state *s = user;
    scratch *z = &s->scratches[worker];
    for (uint64_t i = begin; i < end; i++) {
        uint64_t runs = count_runs(s->index + s->zones[i].begin, s->zones[i].end - s->zones[i].begin);
        if (runs >= UINT32_MAX / 2) return svo_fail(err, SVO_LIMIT, "more than 2^31 runs of values");
        if (!make_room(s, z, (uint32_t)runs + 1)) return no_memory(err);
        find_runs(s, s->zones[i], z);
        find_reach(z);
        if (!do_zone(s, z, &s->lists[worker])) return no_memory(err);
    }
    return SVO_OK;
}

/* What is in *head and what the workers found, all of them in order, in *head. */
static bool gather(state *s, list *head)
{
    const list *from[MOST_WORKERS + 1] = {head};
    uint64_t at[MOST_WORKERS + 1] = {0}, count = head->count;
    list all = {0};
    for (uint32_t i = 0; i < s->threads; i++) from[i + 1] = &s->lists[i], count += s->lists[i].count;
    if (count != 0 && (all.at = svo_alloc(s->a, count, sizeof *all.at)) == NULL) return false;
    all.capacity = count;
    while (all.count < count) { /* from the list that is first, up to where another is */
        uint64_t least = UINT64_MAX, next = UINT64_MAX;
        uint32_t pick = 0;
        for (uint32_t i = 0; i <= s->threads; i++) {
            uint64_t begin = at[i] < from[i]->count ? from[i]->at[at[i]].begin : UINT64_MAX;
            if (begin < least) next = least, least = begin, pick = i;
            else if (begin < next) next = begin;
        }
        while (at[pick] < from[pick]->count && from[pick]->at[at[pick]].begin < next) all.at[all.count++] = from[pick]->at[at[pick]++];
    }
    for (uint32_t i = 0; i < s->threads; i++) s->lists[i].count = 0;
    svo_free(s->a, head->at, head->capacity, sizeof *head->at);
    *head = all;
    return true;
}

/* Zones are independent. */
static svo_result phase_one(state *s, list *head, svo_error *err)
{
    SVO_TRY(find_zones(s, err));
    SVO_TRY(svo_parallel_for(s->threads, s->zone_count, 1, do_zones, s, err));
    return gather(s, head) ? SVO_OK : no_memory(err);
}

static void forget_phase_one(state *s)
{
    for (uint32_t i = 0; i < s->threads; i++) {
        scratch *z = &s->scratches[i];
        forget_room(s, z);
        svo_free(s->a, z->stack, z->stack_capacity, sizeof *z->stack);
    }
    svo_free(s->a, s->zones, s->zone_capacity, sizeof *s->zones);
    svo_free(s->a, s->hot, s->probes + 1, 1);
    s->zones = NULL, s->hot = NULL, s->scratches = NULL;
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
    scratch scratches[MOST_WORKERS] = {0};
    svo_algorithm1_result r = {0};
    *out = r;
    if (count == 0) return SVO_OK;
    if (s.threads > MOST_WORKERS) s.threads = MOST_WORKERS;
    s.lists = lists, s.scratches = scratches;
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
