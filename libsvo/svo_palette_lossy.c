/* Blocks within a bound: each dyadic range gets the cheapest of several kinds, cost being bits plus the worth of the
 * error; then the cheapest partition bottom-up. A range is not looked at when no kind could beat its halves. */
#include <math.h>
#ifdef __SSE__
#include <immintrin.h>
#endif

#include "svo_quantize.h"
#include "svoi_lossy.h"

static void *lossy_create(const svoi_encoder *e, const svo_allocator *a)
{
    svoi_lossy_state *s = svo_calloc(a, 1, sizeof *s);
    if (s == NULL) return NULL;
    s->e = e;
    s->t = e->points;
    s->table_bits = e->table_bits;
    return s;
}

static void lossy_destroy(void *state, const svo_allocator *a) { svo_free(a, state, 1, sizeof(svoi_lossy_state)); }

/* --- the superblock's values ------------------------------------------------------------------------------------- */

static void know_value(svoi_lossy_state *s, uint32_t id, uint32_t value)
{
    const svoi_points *t = s->t;
    s->value[id] = value;
    s->point[id] = svoi_point_of(t->kind, t->squares, value);
    s->weights[id] = svoi_weights_of(t->kind, t->squares, &s->point[id]);
    s->check[id] = t->squares ? svoi_point_of(t->kind, false, value) : s->point[id];
    s->check_weights[id] = t->squares ? svoi_weights_of(t->kind, false, &s->check[id]) : s->weights[id];
    s->own[id] = svoi_table_index(s->e, value);
    if (s->own[id] == SVOI_NO_INDEX && t->kind == SVO_KIND_NORMAL_OCT32) s->own[id] = svoi_table_index(s->e, svo_quantize_normal(value, 12));
    if (s->own[id] == SVOI_NO_INDEX && t->count != 0) s->own[id] = svoi_near(t, &s->near, s->point[id].x);
    s->own_fits[id] = t->count != 0 && svoi_distance2(&s->check[id], s->check_weights[id], &t->check[s->own[id]]) <= t->bound2;
}

static void know_values(svoi_lossy_state *s, const uint32_t *v)
{
    s->v = v;
    s->distinct = 0;
    s->stamp++;
    for (uint32_t i = 0; i < SVO_SUPERBLOCK; i++) {
        if (i != 0 && v[i] == v[i - 1]) {
            s->id[i] = s->id[i - 1];
            continue;
        }
        uint32_t at = (v[i] * 2654435761u) >> 21;
        while (s->slot[at].stamp == s->stamp && s->slot[at].key != v[i]) at = (at + 1) & (SVOI_SEEN - 1);
        if (s->slot[at].stamp != s->stamp) {
            s->slot[at].stamp = s->stamp;
            s->slot[at].key = v[i];
            s->slot[at].value = s->distinct;
            know_value(s, s->distinct++, v[i]);
        }
        s->id[i] = (uint16_t)s->slot[at].value;
    }
}

/* A run goes on while its values are near enough to the first for one entry to hold both: no coding has fewer. */
static uint32_t count_segments(const svoi_lossy_state *s)
{
    if (s->t->squares) return 1;
    uint32_t segments = 1, first = s->run_id[0];
    for (uint32_t r = 1; r < s->runs; r++) {
        uint32_t id = s->run_id[r];
        if (svoi_distance2(&s->point[first], s->weights[first], &s->point[id]) <= 4.5f * s->t->bound2) continue;
        segments++;
        first = id;
    }
    return segments;
}

/* The different values and the runs of a block. */
static void gather(svoi_lossy_state *s, uint32_t begin, uint32_t length)
{
    s->begin = begin, s->length = length, s->items = s->runs = 0;
    s->marks++;
    for (uint32_t i = begin; i < begin + length; i++) {
        uint32_t id = s->id[i];
        if (s->runs != 0 && s->run_id[s->runs - 1] == id) {
            s->run_length[s->runs - 1]++;
            s->item[s->row[id]].count += 1;
            continue;
        }
        s->run_id[s->runs] = (uint16_t)id;
        s->run_length[s->runs++] = 1;
        if (s->mark[id] != s->marks) {
            s->mark[id] = s->marks;
            s->row[id] = (uint16_t)s->items;
            s->item[s->items++] = (svoi_item){s->point[id], s->weights[id], 1, id};
        } else {
            s->item[s->row[id]].count += 1;
        }
    }
    s->segments = count_segments(s);
}

/* --- numbers ----------------------------------------------------------------------------------------------------- */

/* Squared errors of an item with all candidates, `count` (a multiple of SVOI_LANES) of them; INFINITY where the bound is broken. */
static void item_squares(const svoi_lossy_state *s, const svoi_item *it, const svoi_candidates *c, uint32_t count, float *restrict square)
{
    const svoi_points *t = s->t;
    float x0 = it->p.x[0], x1 = it->p.x[1], x2 = it->p.x[2], x3 = it->p.x[3], wh = it->w.wh, wd = it->w.wd, bound2 = t->bound2;
    if (!t->squares) {
        for (uint32_t i = 0; i < count; i += SVOI_LANES)
            for (uint32_t q = i; q < i + SVOI_LANES; q++) {
                float a = x0 - c->p[0][q], b = x1 - c->p[1][q], d = x2 - c->p[2][q], e = x3 - c->p[3][q];
                float d2 = a * a + wh * (b * b + d * d) + wd * (e * e);
                square[q] = d2 <= bound2 ? (d2 > 0 ? d2 : 0) : INFINITY;
            }
        return;
    }
    const svoi_point *k = &s->check[it->id];
    svoi_weights w = s->check_weights[it->id];
    for (uint32_t i = 0; i < count; i += SVOI_LANES)
        for (uint32_t q = i; q < i + SVOI_LANES; q++) {
            float a = x0 - c->p[0][q], b = x1 - c->p[1][q], d = x2 - c->p[2][q];
            float e = k->x[0] - c->check[0][q], f = k->x[1] - c->check[1][q], g = k->x[2] - c->check[2][q], h = k->x[3] - c->check[3][q];
            float d2 = e * e + w.wh * (f * f + g * g) + w.wd * (h * h), cost = a * a + b * b + d * d;
            square[q] = d2 <= bound2 ? cost : INFINITY;
        }
}

/* Bit q: number q of `count` is at most `most`. */
#ifdef __SSE__
static uint64_t at_most(const float *x, uint32_t count, float most)
{
    uint64_t mask = 0;
    for (uint32_t i = 0; i < count; i += 4) mask |= (uint64_t)(uint32_t)_mm_movemask_ps(_mm_cmple_ps(_mm_loadu_ps(x + i), _mm_set1_ps(most))) << i;
    return mask;
}
#else
static uint64_t at_most(const float *x, uint32_t count, float most)
{
    uint64_t mask = 0;
    for (uint32_t i = 0; i < count; i++) mask |= (uint64_t)(x[i] <= most) << i;
    return mask;
}
#endif

/* The least of the lanes, which are used up. */
static float fold(float lane[SVOI_LANES])
{
    for (uint32_t half = SVOI_LANES / 2; half != 0; half /= 2)
        for (uint32_t j = 0; j < half; j++) lane[j] = lane[j + half] < lane[j] ? lane[j + half] : lane[j];
    return lane[0];
}

static float least_of(const float *x, uint32_t count)
{
    float lane[SVOI_LANES];
    for (uint32_t j = 0; j < SVOI_LANES; j++) lane[j] = x[j];
    for (uint32_t i = SVOI_LANES; i < count; i += SVOI_LANES)
        for (uint32_t j = 0; j < SVOI_LANES; j++) lane[j] = x[i + j] < lane[j] ? x[i + j] : lane[j];
    return fold(lane);
}

static uint32_t padded(uint32_t count) { return (count + SVOI_LANES - 1) & ~(uint32_t)(SVOI_LANES - 1); }

void svoi_allowed(const svoi_lossy_state *s, const svoi_candidates *c, uint64_t *mask)
{
    float square[SVOI_LOSSY_ENTRIES];
    uint32_t count = padded(c->count);
    for (uint32_t i = 0; i < s->items; i++) {
        item_squares(s, &s->item[i], c, count, square);
        mask[i] = at_most(square, count, 1e30f) & (~(uint64_t)0 >> (64 - c->count)); /* not the copies behind */
    }
}

float svoi_plain_cost(svoi_lossy_state *s, const svoi_candidates *c, float limit, uint32_t *number)
{
    float sum = 0, square[SVOI_LOSSY_ENTRIES];
    uint32_t count = padded(c->count);
    for (uint32_t i = 0; i < s->items; i++) {
        const svoi_item *it = &s->item[i];
        item_squares(s, it, c, count, square);
        float least = least_of(square, count);
        if (!(least < INFINITY)) return INFINITY;
        s->label[it->id] = (uint8_t)__builtin_ctzll(at_most(square, count, least));
        sum += svoi_cost(s->t, least) * it->count;
        if (!(sum < limit)) return INFINITY;
    }
    if (number != NULL)
        for (uint32_t i = 0; i < s->length; i++) number[i] = s->label[s->id[s->begin + i]];
    return sum;
}

static void trace_runs(const svoi_lossy_state *s, uint32_t last, uint32_t *number)
{
    uint32_t at = s->length;
    for (uint32_t r = s->runs; r-- > 0;) {
        for (uint32_t i = 0; i < s->run_length[r]; i++) number[--at] = last;
        if (s->changed[r] >> last & 1) last = s->before[r];
    }
}

/* Rows of `error`: squared errors of each item with each candidate; masks of those within the bound in `allowed`. */
static void item_rows(svoi_lossy_state *s, const svoi_candidates *c, uint32_t k)
{
    for (uint32_t i = 0; i < s->items; i++) {
        s->row[s->item[i].id] = (uint16_t)i;
        item_squares(s, &s->item[i], c, k, s->error[i]);
        s->allowed[i] = at_most(s->error[i], k, 1e30f);
    }
}

/* From squared errors to costs; the least of each row in `least`. */
static void item_costs(svoi_lossy_state *s, uint32_t k, float *least)
{
    float price = s->t->price;
    for (uint32_t i = 0; i < s->items; i++) {
        float *error = s->error[i], lane[SVOI_LANES];
        for (uint32_t j = 0; j < SVOI_LANES; j++) lane[j] = INFINITY;
        for (uint32_t q = 0; q < k; q += SVOI_LANES)
            for (uint32_t j = 0; j < SVOI_LANES; j++) { /* where the square is not finite, nor is the root */
                float e = s->t->squares ? error[q + j] : __builtin_sqrtf(error[q + j]);
                e = error[q + j] < INFINITY ? price * e : INFINITY;
                error[q + j] = e;
                lane[j] = e < lane[j] ? e : lane[j];
            }
        least[i] = fold(lane);
    }
}

/* tail[r]: what runs r and later add at least to the cost up to the run before: their least errors, and `width` bits
 * for each change that they cannot do without. Greedy from the end, a run of numbers as long as one candidate allows. */
static void fill_tails(svoi_lossy_state *s, const float *least, uint32_t width)
{
    uint64_t together = 0;
    float changes = 0, errors = 0;
    s->tail[s->runs] = 0;
    for (uint32_t r = s->runs; r-- > 0;) {
        uint32_t row = s->row[s->run_id[r]];
        if ((together & s->allowed[row]) == 0) {
            if (together != 0) changes += (float)width; /* the run behind begins with a change, whatever is before it */
            together = ~(uint64_t)0;
        }
        together &= s->allowed[row];
        if (least != NULL) errors += least[row] * s->run_length[r];
        s->tail[r] = (changes + errors) * 0.9999f; /* sums differ by their order */
    }
}

float svoi_runs_cost(svoi_lossy_state *s, const svoi_candidates *c, uint32_t width, float limit, uint32_t *number)
{
    uint32_t k = padded(c->count);
    float cost[SVOI_LOSSY_ENTRIES], least = 0, item_least[SVO_SUPERBLOCK];
    item_rows(s, c, k);
    if (limit < INFINITY) {
        fill_tails(s, NULL, width);
        if (!(s->tail[0] + (float)width < limit)) return INFINITY;
    }
    item_costs(s, k, item_least);
    if (limit < INFINITY) {
        fill_tails(s, item_least, width);
        if (!(s->tail[0] + (float)width < limit)) return INFINITY;
    }
    uint32_t from = 0;
    for (uint32_t q = 0; q < k; q++) cost[q] = INFINITY;
    for (uint32_t r = 0; r < s->runs; r++) {
        const float *error = s->error[s->row[s->run_id[r]]];
        float times = s->run_length[r], change = least + (float)width, lane[SVOI_LANES];
        if (number != NULL) {
            s->changed[r] = ~at_most(cost, k, change);
            s->before[r] = (uint8_t)from;
        }
        for (uint32_t j = 0; j < SVOI_LANES; j++) lane[j] = INFINITY;
        for (uint32_t q = 0; q < k; q += SVOI_LANES)
            for (uint32_t j = 0; j < SVOI_LANES; j++) {
                float kept = change < cost[q + j] ? change : cost[q + j], now = kept + error[q + j] * times;
                cost[q + j] = now;
                lane[j] = now < lane[j] ? now : lane[j];
            }
        least = fold(lane);
        if (!(least + (limit < INFINITY ? s->tail[r + 1] : 0) < limit)) return INFINITY;
        if (number != NULL) {
            from = 0;
            while (cost[from] != least) from++;
        }
    }
    if (number != NULL) trace_runs(s, from, number);
    return least;
}

/* --- the partition ----------------------------------------------------------------------------------------------- */

static bool is_lattice(const svoi_node *n) { return n->mode == SVO_BLOCK_BOX || n->mode == SVO_BLOCK_BOX_RUNS; }

/* Fill `n`, whose cost is what has to be beaten; false when nothing does. */
static bool look(svoi_lossy_state *s, uint32_t begin, uint32_t length, svoi_node *n, float limit, bool lattice)
{
    n->cost = limit;
    n->mode = SVOI_NONE;
    gather(s, begin, length);
    svoi_try_one(s, n);
    bool small = s->t->price < 0.15f && length == SVO_GRANULE && s->t->kind == SVO_KIND_COLOR_SRGB8; /* seldom worth a palette of its own, never the search */
    if (!small && s->items > 1 && n->cost > SVOI_HEADER_BITS + (float)length) {
        svoi_try_palettes(s, n);
        svoi_try_lines(s, n);
    }
    if (lattice) svoi_try_lattice(s, n);
    svoi_try_raw(s, n);
    return n->mode != SVOI_NONE;
}

static uint64_t lossy_choose(void *state, const uint32_t *v)
{
    svoi_lossy_state *s = state;
    know_values(s, v);
    float cost[SVOI_GRANULES];
    uint32_t blocks[SVOI_GRANULES];
    bool lattice[SVOI_GRANULES]; /* worth trying: some part is one already */
    uint64_t map = ~(uint64_t)0;
    for (uint32_t i = 0; i < SVOI_GRANULES; i++) {
        look(s, i * SVO_GRANULE, SVO_GRANULE, &s->node[0][i], INFINITY, true);
        cost[i] = s->node[0][i].cost;
        blocks[i] = 1;
        lattice[i] = is_lattice(&s->node[0][i]);
    }
    for (uint32_t k = 1; k < SVOI_LEVELS; k++)
        for (uint32_t i = 0; i < (uint32_t)SVOI_GRANULES >> k; i++) {
            uint32_t begin = i << k, granules = 1u << k;
            svoi_node *n = &s->node[k][i];
            cost[i] = cost[2 * i] + cost[2 * i + 1];
            blocks[i] = blocks[2 * i] + blocks[2 * i + 1];
            lattice[i] = lattice[2 * i] || lattice[2 * i + 1];
            n->mode = SVOI_NONE;
            if (blocks[i] > 6 || !look(s, begin * SVO_GRANULE, granules * SVO_GRANULE, n, cost[i], lattice[i])) continue;
            lattice[i] = is_lattice(n);
            cost[i] = n->cost;
            blocks[i] = 1;
            map &= ~((((uint64_t)1 << (granules - 1)) - 1) << (begin + 1));
        }
    return map;
}

static void lossy_block(void *state, uint32_t first, uint32_t end, svoi_block *out)
{
    svoi_lossy_state *s = state;
    uint32_t level = (uint32_t)__builtin_ctz(end - first), width;
    svoi_node *n = &s->node[level][first >> level];
    gather(s, first * SVO_GRANULE, (end - first) * SVO_GRANULE);
    if (n->mode == SVOI_NONE) look(s, first * SVO_GRANULE, (end - first) * SVO_GRANULE, n, INFINITY, true);
    svoi_candidates c;
    out->mode = n->mode;
    out->entries = n->entries;
    for (uint32_t i = 0; i < n->entries; i++) out->entry[i] = n->entry[i];
    if (n->mode < SVO_BLOCK_RAW) return;
    if (n->mode == SVO_BLOCK_RAW) {
        for (uint32_t i = 0; i < s->length; i++) out->number[i] = s->own[s->id[s->begin + i]];
    } else if (n->mode < SVO_BLOCK_LINE) {
        out->lattice = n->lattice;
        for (uint32_t i = 0; i < s->length; i++) out->number[i] = svoi_lattice_number(s->t->kind, &n->lattice, s->v[s->begin + i]);
    } else if (n->mode < SVO_BLOCK_PALETTE) {
        bool runs = n->mode >= SVO_BLOCK_LINE_RUNS;
        width = n->mode - (runs ? SVO_BLOCK_LINE_RUNS : SVO_BLOCK_LINE) + 2;
        svoi_line_candidates(s, n, width, &c);
        if (runs) svoi_runs_cost(s, &c, width, INFINITY, out->number);
        else svoi_plain_cost(s, &c, INFINITY, out->number);
    } else {
        bool runs = n->mode >= SVO_BLOCK_PALETTE_RUNS;
        width = n->mode - (runs ? SVO_BLOCK_PALETTE_RUNS - 2 : SVO_BLOCK_PALETTE - 1);
        svoi_palette_candidates(s, n, &c);
        if (runs) svoi_runs_cost(s, &c, width, INFINITY, out->number);
        else svoi_plain_cost(s, &c, INFINITY, out->number);
        if (!runs) { /* a palette ends with the largest number that occurs */
            uint32_t most = 0;
            for (uint32_t i = 0; i < s->length; i++) most = out->number[i] > most ? out->number[i] : most;
            out->entries = most + 1;
        }
    }
}

const svoi_chooser svoi_lossy = {lossy_create, lossy_destroy, lossy_choose, lossy_block};
