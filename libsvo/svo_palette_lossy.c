/* Blocks within a bound: each dyadic range gets the cheapest of several kinds, cost being bits plus the worth of the
 * error; then the cheapest partition bottom-up. A range is not looked at when no kind could beat its halves. */
#include <math.h>
#ifdef __AVX2__
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
    svoi_known *k = &s->known[(value * 2654435761u) >> (32 - SVOI_KNOWN_BITS)];
    if (!k->is || k->value != value) { /* much the same values come back in superblock after superblock */
        k->is = true;
        k->value = value;
        k->point = svoi_point_of(t->kind, t->squares, value);
        k->weights = svoi_weights_of(t->kind, t->squares, &k->point);
        k->check = t->squares ? svoi_point_of(t->kind, false, value) : k->point;
        k->check_weights = t->squares ? svoi_weights_of(t->kind, false, &k->check) : k->weights;
        k->own = svoi_table_index(s->e, value);
        if (k->own == SVOI_NO_INDEX && t->kind == SVO_KIND_NORMAL_OCT32) k->own = svoi_table_index(s->e, svo_quantize_normal(value, 12));
        if (k->own == SVOI_NO_INDEX && t->count != 0) k->own = svoi_near(t, &s->near, k->point.x);
        k->own_fits = t->count != 0 && svoi_distance2(&k->check, k->check_weights, &t->check[k->own]) <= t->bound2;
    }
    s->value[id] = value;
    s->point[id] = k->point;
    s->weights[id] = k->weights;
    s->check[id] = k->check;
    s->check_weights[id] = k->check_weights;
    s->own[id] = k->own;
    s->own_fits[id] = k->own_fits;
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

/* Bit q: number q of `count` (a multiple of SVOI_LANES) is at most `most`. */
#ifdef __AVX2__
static uint64_t at_most(const float *x, uint32_t count, float most)
{
    uint64_t mask = 0;
    for (uint32_t i = 0; i < count; i += 8)
        mask |= (uint64_t)(uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(_mm256_loadu_ps(x + i), _mm256_set1_ps(most), _CMP_LE_OQ)) << i;
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

#ifdef __AVX2__
static inline float fold(__m256 v)
{
    __m128 m = _mm_min_ps(_mm256_castps256_ps128(v), _mm256_extractf128_ps(v, 1));
    m = _mm_min_ps(m, _mm_movehl_ps(m, m));
    return _mm_cvtss_f32(_mm_min_ss(m, _mm_shuffle_ps(m, m, 1)));
}

static float least_of(const float *x, uint32_t count)
{
    __m256 least = _mm256_loadu_ps(x);
    for (uint32_t i = 8; i < count; i += 8) least = _mm256_min_ps(least, _mm256_loadu_ps(x + i));
    return fold(least);
}
#else
static float least_of(const float *x, uint32_t count)
{
    float least = x[0];
    for (uint32_t i = 1; i < count; i++) least = x[i] < least ? x[i] : least;
    return least;
}
#endif

static uint32_t padded(uint32_t count) { return (count + SVOI_LANES - 1) & ~(uint32_t)(SVOI_LANES - 1); }

/* Bit i: the candidate is within the bound of item i of 64; components of points and weights by item. */
static uint64_t covered(float (*item)[64], uint32_t count, const float p[4], float bound2)
{
    uint64_t mask = 0;
#ifdef __AVX2__
    const __m256 x0 = _mm256_set1_ps(p[0]), x1 = _mm256_set1_ps(p[1]), x2 = _mm256_set1_ps(p[2]), x3 = _mm256_set1_ps(p[3]), most = _mm256_set1_ps(bound2);
    for (uint32_t i = 0; i < count; i += 8) {
        __m256 a = _mm256_sub_ps(_mm256_loadu_ps(item[0] + i), x0), b = _mm256_sub_ps(_mm256_loadu_ps(item[1] + i), x1);
        __m256 d = _mm256_sub_ps(_mm256_loadu_ps(item[2] + i), x2), e = _mm256_sub_ps(_mm256_loadu_ps(item[3] + i), x3);
        __m256 chroma = _mm256_mul_ps(_mm256_loadu_ps(item[4] + i), _mm256_add_ps(_mm256_mul_ps(b, b), _mm256_mul_ps(d, d)));
        __m256 d2 = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(a, a), chroma), _mm256_mul_ps(_mm256_loadu_ps(item[5] + i), _mm256_mul_ps(e, e)));
        mask |= (uint64_t)(uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(d2, most, _CMP_LE_OQ)) << i;
    }
#else
    for (uint32_t i = 0; i < count; i++) {
        float a = item[0][i] - p[0], b = item[1][i] - p[1], d = item[2][i] - p[2], e = item[3][i] - p[3];
        float d2 = a * a + item[4][i] * (b * b + d * d) + item[5][i] * (e * e);
        mask |= (uint64_t)(d2 <= bound2) << i;
    }
#endif
    return count < 64 ? mask & (((uint64_t)1 << count) - 1) : mask;
}

void svoi_covered(const svoi_lossy_state *s, const svoi_candidates *c, uint64_t (*covers)[SVO_SUPERBLOCK / 64])
{
    float item[6][64] = {{0}};
    for (uint32_t w = 0; 64 * w < s->items; w++) {
        uint32_t count = s->items - 64 * w < 64 ? s->items - 64 * w : 64;
        for (uint32_t i = 0; i < count; i++) {
            const svoi_item *it = &s->item[64 * w + i];
            const svoi_point *p = s->t->squares ? &s->check[it->id] : &it->p;
            const svoi_weights *weights = s->t->squares ? &s->check_weights[it->id] : &it->w;
            for (int k = 0; k < 4; k++) item[k][i] = p->x[k];
            item[4][i] = weights->wh, item[5][i] = weights->wd;
        }
        for (uint32_t q = 0; q < c->count; q++) {
            float p[4];
            for (int k = 0; k < 4; k++) p[k] = s->t->squares ? c->check[k][q] : c->p[k][q];
            covers[q][w] = covered(item, count, p, s->t->bound2);
        }
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

/* Cost of an item with each of `count` candidates (INFINITY: not within the bound); those within it in *allowed; returns the least. */
static float item_costs(const svoi_lossy_state *s, const svoi_item *it, const svoi_candidates *c, uint32_t count, float *restrict cost, uint64_t *allowed)
{
    item_squares(s, it, c, count, cost);
    *allowed = at_most(cost, count, 1e30f);
    float price = s->t->price;
#ifdef __AVX2__
    const __m256 prices = _mm256_set1_ps(price), none = _mm256_set1_ps(INFINITY), large = _mm256_set1_ps(1e30f);
    __m256 least = none;
    for (uint32_t q = 0; q < count; q += 8) {
        __m256 square = _mm256_loadu_ps(cost + q), e = _mm256_mul_ps(prices, s->t->squares ? square : _mm256_sqrt_ps(square));
        e = _mm256_blendv_ps(none, e, _mm256_cmp_ps(square, large, _CMP_LE_OQ));
        _mm256_storeu_ps(cost + q, e);
        least = _mm256_min_ps(least, e);
    }
    return fold(least);
#else
    float least = INFINITY;
    for (uint32_t q = 0; q < count; q++) {
        float e = s->t->squares ? cost[q] : __builtin_sqrtf(cost[q]);
        cost[q] = cost[q] <= 1e30f ? price * e : INFINITY;
        least = cost[q] < least ? cost[q] : least;
    }
    return least;
#endif
}

/* tail[r]: what runs r and later add at least to the cost up to the run before: their least errors, and `width` bits
 * for each change that they cannot do without. Greedy from the end, a run of numbers as long as one candidate allows. */
static void fill_tails(svoi_lossy_state *s, const uint16_t *row, const float *least, uint32_t width)
{
    uint64_t together = 0;
    float changes = 0, errors = 0;
    s->tail[s->runs] = 0;
    for (uint32_t r = s->runs; r-- > 0;) {
        uint64_t allowed = s->allowed[row[r]];
        if ((together & allowed) == 0) {
            if (together != 0) changes += (float)width; /* the run behind begins with a change, whatever is before it */
            together = ~(uint64_t)0;
        }
        together &= allowed;
        errors += least[row[r]] * s->run_length[r];
        s->tail[r] = (changes + errors) * 0.9999f; /* sums differ by their order */
    }
}

/* One run more: costs up to it by its number, given those up to the run before and their least with a change; returns the least. */
static inline float add_run(float *restrict cost, const float *restrict error, uint32_t k, float times, float change)
{
#ifdef __AVX2__
    const __m256 changes = _mm256_set1_ps(change), lengths = _mm256_set1_ps(times);
    __m256 least = _mm256_set1_ps(INFINITY);
    for (uint32_t q = 0; q < k; q += 8) {
        __m256 now = _mm256_add_ps(_mm256_min_ps(changes, _mm256_loadu_ps(cost + q)), _mm256_mul_ps(_mm256_loadu_ps(error + q), lengths));
        _mm256_storeu_ps(cost + q, now);
        least = _mm256_min_ps(least, now);
    }
    return fold(least);
#else
    float least = INFINITY;
    for (uint32_t q = 0; q < k; q++) {
        float kept = change < cost[q] ? change : cost[q], now = kept + error[q] * times;
        cost[q] = now;
        least = now < least ? now : least;
    }
    return least;
#endif
}

float svoi_runs_cost(svoi_lossy_state *s, const svoi_candidates *c, uint32_t width, float limit, uint32_t *number)
{
    uint32_t k = padded(c->count);
    float cost[SVOI_LOSSY_ENTRIES], least = 0, item_least[SVO_SUPERBLOCK];
    uint16_t row[SVO_SUPERBLOCK]; /* of each run */
    for (uint32_t i = 0; i < s->items; i++) {
        s->row[s->item[i].id] = (uint16_t)i;
        item_least[i] = item_costs(s, &s->item[i], c, k, s->error[i], &s->allowed[i]);
    }
    for (uint32_t r = 0; r < s->runs; r++) row[r] = s->row[s->run_id[r]];
    if (limit < INFINITY) {
        fill_tails(s, row, item_least, width);
        if (!(s->tail[0] + (float)width < limit)) return INFINITY;
    }
    uint32_t from = 0;
    for (uint32_t q = 0; q < k; q++) cost[q] = INFINITY;
    for (uint32_t r = 0; r < s->runs; r++) {
        float change = least + (float)width;
        if (number != NULL) {
            s->changed[r] = ~at_most(cost, k, change);
            s->before[r] = (uint8_t)from;
        }
        least = add_run(cost, s->error[row[r]], k, s->run_length[r], change);
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
