/* The kinds of block, each fitted to the values at hand: svoi_lossy.h. */
#include <math.h>

#include "svoi_lossy.h"

static bool fits(const svoi_lossy_state *s, const svoi_item *it, uint32_t entry, float distance2)
{
    const svoi_points *t = s->t;
    if (t->squares) distance2 = svoi_distance2(&s->check[it->id], s->check_weights[it->id], &t->check[entry]);
    return distance2 <= t->bound2;
}

/* Cost of items [low, high) with one entry; INFINITY when one is not within the bound. */
static float entry_cost(const svoi_lossy_state *s, uint32_t low, uint32_t high, uint32_t entry)
{
    const svoi_point *q = &s->t->table[entry];
    float sum = 0;
    for (uint32_t i = low; i < high; i++) {
        const svoi_item *it = &s->item[i];
        float d = svoi_distance2(&it->p, it->w, q);
        if (!fits(s, it, entry, d)) return INFINITY;
        sum += svoi_cost(s->t, d) * it->count;
    }
    return sum;
}

/* --- clusters ---------------------------------------------------------------------------------------------------- */

typedef struct cluster {
    uint32_t low, high;  /* items */
    float middle[3];     /* where it is cut */
    float least[3], most[3]; /* a box around its items */
    int axis;
    float spread;        /* how much there is to gain by cutting it */
    uint32_t entry;
    float cost;          /* INFINITY: the entry is not within the bound of all items */
} cluster;

static bool valid(const cluster *c) { return c->cost < INFINITY; }

/* Take the entry if it is better. */
static void try_entry(svoi_lossy_state *s, cluster *c, uint32_t entry)
{
    if (entry == c->entry) return;
    float cost = entry_cost(s, c->low, c->high, entry);
    if (cost < c->cost) c->entry = entry, c->cost = cost;
}

/* Middle and axis of the largest range: where to cut what no entry can hold. */
static float aim_at_middle(cluster *c, float scale)
{
    float largest = -1;
    for (int k = 0; k < 3; k++) {
        float range = (c->most[k] - c->least[k]) * (k != 0 ? scale : 1);
        c->middle[k] = (c->least[k] + c->most[k]) / 2;
        if (range > largest) largest = range, c->axis = k;
    }
    return largest;
}

/* The box around the items. True when no entry is within the bound of all: CIE94 is at least the difference in a
 * component, those of chroma times the square root of wh + wd. */
static bool too_wide(const svoi_lossy_state *s, cluster *c)
{
    float least[4], most[4], scale = INFINITY;
    for (int k = 0; k < 4; k++) least[k] = most[k] = s->item[c->low].p.x[k];
    for (uint32_t i = c->low; i < c->high; i++) {
        const svoi_item *it = &s->item[i];
        float w = it->w.wh + it->w.wd;
        scale = w < scale ? w : scale;
        for (int k = 0; k < 4; k++) { /* four, so that they are taken at once */
            least[k] = it->p.x[k] < least[k] ? it->p.x[k] : least[k];
            most[k] = it->p.x[k] > most[k] ? it->p.x[k] : most[k];
        }
    }
    for (int k = 0; k < 3; k++) c->least[k] = least[k], c->most[k] = most[k];
    if (s->t->squares) return false; /* the bound is not in these components */
    float range = aim_at_middle(c, sqrtf(scale));
    c->spread = range;
    return range * range > 4.01f * s->t->bound2;
}

/* Mean and axis of largest variance; returns the mean weight of chroma's components. */
static float find_mean(const svoi_item *it, uint32_t n, cluster *c)
{
    float weight = 0, wh = 0, sum[4] = {0, 0, 0, 0}, square[4] = {0, 0, 0, 0}, largest = -1;
    svoi_point o = it->p;
    for (uint32_t i = 0; i < n; i++) {
        float count = it[i].count;
        weight += count;
        wh += count * it[i].w.wh;
        for (int k = 0; k < 4; k++) {
            float x = it[i].p.x[k] - o.x[k];
            sum[k] += count * x;
            square[k] += count * x * x;
        }
    }
    wh /= weight;
    c->spread = 0;
    for (int k = 0; k < 3; k++) {
        float mean = sum[k] / weight, variance = square[k] - sum[k] * mean;
        c->middle[k] = o.x[k] + mean;
        if (k != 0) variance *= wh;
        c->spread += variance;
        if (variance > largest) largest = variance, c->axis = k;
    }
    return wh;
}

/* Where to cut a cluster, and the best entry for its items. */
static void measure(svoi_lossy_state *s, cluster *c)
{
    const svoi_item *it = s->item + c->low;
    uint32_t n = c->high - c->low;
    c->cost = INFINITY;
    c->entry = UINT32_MAX;
    if (n == 1) {
        c->entry = s->own[it->id];
        if (s->own_fits[it->id]) c->cost = svoi_cost(s->t, svoi_distance2(&it->p, it->w, &s->t->table[c->entry])) * it->count;
        c->spread = 0;
        for (int k = 0; k < 3; k++) c->least[k] = c->most[k] = it->p.x[k];
        return;
    }
    if (too_wide(s, c)) return;
    float wh = find_mean(it, n, c), least = INFINITY;
    uint32_t nearest = 0;
    for (uint32_t i = 0; i < n; i++) {
        float d = 0;
        for (int k = 0; k < 3; k++) {
            float x = it[i].p.x[k] - c->middle[k];
            d += x * x;
        }
        if (d < least) least = d, nearest = i;
    }
    try_entry(s, c, svoi_near(s->t, &s->near, c->middle));
    try_entry(s, c, s->own[it[nearest].id]);
    if (valid(c)) return;
    aim_at_middle(c, sqrtf(wh)); /* the best place that there is */
    try_entry(s, c, svoi_near(s->t, &s->near, c->middle));
}

/* Items on the lower side of the cut come first; false when all are on one side. */
static bool cut(svoi_lossy_state *s, cluster *c, cluster *upper)
{
    uint32_t i = c->low;
    const int axis = c->axis;
    const float middle = c->middle[axis];
    for (uint32_t j = c->low; j < c->high; j++) { /* without a branch: which side is nothing that could be foretold */
        svoi_item t = s->item[j];
        s->item[j] = s->item[i];
        s->item[i] = t;
        i += t.p.x[axis] < middle;
    }
    if (i == c->low || i == c->high) return false;
    *upper = (cluster){.low = i, .high = c->high};
    c->high = i;
    return true;
}

/* --- one entry, raw ---------------------------------------------------------------------------------------------- */

void svoi_try_one(svoi_lossy_state *s, svoi_node *n)
{
    if (s->t->count == 0) return;
    cluster c = {.low = 0, .high = s->items};
    if (s->items > 1) {
        /* two values too far apart for any entry: the farthest from the first, roughly */
        float limit = 4 * s->t->bound2;
        for (uint32_t i = 1; i < s->items && !s->t->squares; i++)
            if (svoi_distance2(&s->item[0].p, s->item[0].w, &s->item[i].p) > 1.5f * limit) return;
    }
    measure(s, &c);
    if (!valid(&c)) return;
    bool wide = c.entry >= 4096;
    float cost = (float)(SVOI_HEADER_BITS + (wide ? svoi_whole_bytes(s->table_bits) : 0)) + c.cost;
    if (!(cost < n->cost)) return;
    svoi_take(n, cost, wide ? SVO_BLOCK_ONE_WIDE : SVO_BLOCK_ONE);
    n->entries = 1;
    n->entry[0] = (uint16_t)c.entry;
}

void svoi_try_raw(svoi_lossy_state *s, svoi_node *n)
{
    float cost = (float)(SVOI_HEADER_BITS + svoi_whole_bytes(s->length * s->table_bits));
    if (s->t->count == 0 || !(cost < n->cost)) return;
    for (uint32_t i = 0; i < s->items; i++) {
        const svoi_item *it = &s->item[i];
        if (!s->own_fits[it->id]) return;
        cost += svoi_cost(s->t, svoi_distance2(&it->p, it->w, &s->t->table[s->own[it->id]])) * it->count;
    }
    if (cost < n->cost) svoi_take(n, cost, SVO_BLOCK_RAW);
}

/* --- palettes ---------------------------------------------------------------------------------------------------- */

static uint32_t width_of(uint32_t entries) { return entries > 2 ? 32 - (uint32_t)__builtin_clz(entries - 1) : 1; }

void svoi_palette_candidates(const svoi_lossy_state *s, const svoi_node *n, svoi_candidates *c)
{
    c->count = n->entries;
    for (uint32_t i = 0; i < n->entries; i++) svoi_candidate_set(c, i, &s->t->table[n->entry[i]], &s->t->check[n->entry[i]]);
    svoi_candidates_fill(c);
}

static void keep_entries(svoi_node *n, const cluster *c, uint32_t count)
{
    n->entries = count;
    for (uint32_t i = 0; i < count; i++) n->entry[i] = (uint16_t)c[i].entry;
}

static uint32_t count_changes(const svoi_lossy_state *s)
{
    uint32_t changes = 1, last = s->label[s->run_id[0]];
    for (uint32_t r = 1; r < s->runs; r++) {
        uint32_t label = s->label[s->run_id[r]];
        changes += label != last;
        last = label;
    }
    return changes;
}

/* With runs: an estimate from the labels first, then the best runs for these entries. */
static void try_runs(svoi_lossy_state *s, const cluster *c, uint32_t k, float error, svoi_node *n)
{
    uint32_t width = width_of(k), fixed = SVOI_HEADER_BITS + 8 + k * s->table_bits + s->length;
    float estimate = (float)(fixed + count_changes(s) * width) + error;
    if (estimate > 1.2f * n->cost) return;
    svoi_node with = {.entries = 0};
    svoi_candidates candidates;
    keep_entries(&with, c, k);
    svoi_palette_candidates(s, &with, &candidates);
    float cost = svoi_runs_cost(s, &candidates, width, n->cost - (float)fixed - 4, NULL) + (float)fixed + 4; /* rounding to bytes */
    if (!(cost < n->cost)) return;
    svoi_take(n, cost, SVO_BLOCK_PALETTE_RUNS + width - 2);
    keep_entries(n, c, k);
}

static bool worth_trying_runs(uint32_t k) { return k <= 4 || k == 6 || k == 8 || k == 12 || k == 16 || k == 24 || k == 32 || k == 48 || k == 64; }

static void add_entry(svoi_node *n, uint32_t entry)
{
    for (uint32_t i = 0; i < n->entries; i++)
        if (n->entry[i] == entry) return;
    if (n->entries < SVOI_LOSSY_ENTRIES) n->entry[n->entries++] = (uint16_t)entry;
}

static uint32_t first_of_most(const uint32_t *x, uint32_t k)
{
    uint32_t most = 0, i = 0;
    for (uint32_t j = 0; j < k; j++) most = x[j] > most ? x[j] : most;
    while (x[i] != most) i++;
    return i;
}

static uint32_t count_left(const uint64_t *covers, const uint64_t *left, uint32_t words)
{
    uint32_t n = 0;
    for (uint32_t w = 0; w < words; w++) n += (uint32_t)__builtin_popcountll(covers[w] & left[w]);
    return n;
}

/* Fewer entries than clusters: from theirs and those between two of them, always the one that covers most of what is left. */
static void try_cover(svoi_lossy_state *s, const cluster *c, uint32_t k, svoi_node *n)
{
    svoi_node all = {.entries = 0}, with = {.entries = 0};
    svoi_candidates candidates;
    float reach = 2 * sqrtf(s->t->bound2), wh = sqrtf(s->item[0].w.wh + s->item[0].w.wd);
    for (uint32_t i = 0; i < k; i++) add_entry(&all, c[i].entry);
    for (uint32_t i = 0; i < k; i++)
        for (uint32_t j = i + 1; j < k && all.entries < SVOI_LOSSY_ENTRIES; j++) {
            float middle[3];
            bool far = false;
            for (int a = 0; a < 3; a++) {
                float low = c[i].least[a] < c[j].least[a] ? c[i].least[a] : c[j].least[a], high = c[i].most[a] > c[j].most[a] ? c[i].most[a] : c[j].most[a];
                middle[a] = (low + high) / 2;
                far = far || (high - low) * (a != 0 ? wh : 1) > reach;
            }
            if (!far) add_entry(&all, svoi_near(s->t, &s->near, middle));
        }
    svoi_palette_candidates(s, &all, &candidates);
    uint64_t covers[SVOI_LOSSY_ENTRIES][SVO_SUPERBLOCK / 64], left[SVO_SUPERBLOCK / 64];
    uint32_t words = (s->items + 63) / 64, most[SVOI_LOSSY_ENTRIES]; /* most: no fewer than it covers of what is left */
    svoi_covered(s, &candidates, covers);
    for (uint32_t w = 0; w < words; w++) left[w] = ~(uint64_t)0 >> (s->items - 64 * w < 64 ? 64 - (s->items - 64 * w) : 0);
    for (uint32_t q = 0; q < all.entries; q++) most[q] = count_left(covers[q], left, words);
    for (uint32_t rest = s->items; rest != 0;) {
        uint32_t best = 0, count;
        for (;;) { /* the first of those that cover most: counts only fall, so one that is still the most when counted anew is it */
            best = first_of_most(most, all.entries);
            count = count_left(covers[best], left, words);
            if (count == most[best]) break;
            most[best] = count;
        }
        if (count == 0 || with.entries + 1 >= k) return;
        with.entry[with.entries++] = all.entry[best];
        rest -= count;
        for (uint32_t w = 0; w < words; w++) left[w] &= ~covers[best][w];
    }
    svoi_palette_candidates(s, &with, &candidates);
    uint32_t entries = with.entries, width = width_of(entries);
    float error = svoi_plain_cost(s, &candidates, n->cost, NULL);
    if (!(error < INFINITY) || entries < 2) return;
    float cost = (float)(SVOI_HEADER_BITS + svoi_whole_bytes(entries * s->table_bits + s->length * width)) + error;
    if (cost < n->cost) {
        svoi_take(n, cost, SVO_BLOCK_PALETTE + width - 1);
        n->entries = entries;
        memcpy(n->entry, with.entry, sizeof n->entry);
    }
    if (entries < 3) return;
    float fixed = (float)(SVOI_HEADER_BITS + 8 + entries * s->table_bits + s->length);
    if (fixed + error + (float)(count_changes(s) * width) > 1.5f * n->cost) return;
    cost = svoi_runs_cost(s, &candidates, width, n->cost - fixed - 4, NULL) + fixed + 4;
    if (cost < n->cost) {
        svoi_take(n, cost, SVO_BLOCK_PALETTE_RUNS + width - 2);
        n->entries = entries;
        memcpy(n->entry, with.entry, sizeof n->entry);
    }
}

static float total_cost(const cluster *c, uint32_t k)
{
    float sum = 0;
    for (uint32_t i = 0; i < k; i++) sum += c[i].cost;
    return sum;
}

/* Bits that palettes of `k` entries and more take at least. */
static uint32_t least_bits(const svoi_lossy_state *s, uint32_t k)
{
    uint32_t width = width_of(k), plain = s->length * width, runs = 8 + s->length + s->segments * width;
    return SVOI_HEADER_BITS + k * s->table_bits + (plain < runs || k < 3 ? plain : runs);
}

/* Which cluster to cut: those that no entry holds first, the widest of these; 0: one item alone. */
static uint32_t urgency(const cluster *c)
{
    uint32_t bits = 0;
    float spread = c->spread > 0 ? c->spread : 0;
    memcpy(&bits, &spread, sizeof bits); /* of floats that are not negative, in their order */
    return c->high - c->low > 1 ? (bits + 1) | (uint32_t)!valid(c) << 31 : 0;
}

void svoi_try_palettes(svoi_lossy_state *s, svoi_node *n)
{
    if (s->t->count == 0 || (float)least_bits(s, 2) >= n->cost) return;
    for (uint32_t i = 0; i < s->items && s->t->kind == SVO_KIND_NORMAL_OCT32; i++)
        if (!s->own_fits[s->item[i].id]) return; /* no entry is near enough */
    cluster c[SVOI_LOSSY_ENTRIES];
    c[0] = (cluster){.low = 0, .high = s->items};
    measure(s, &c[0]);
    for (uint32_t i = 0; i < s->items; i++) s->label[s->item[i].id] = 0;
    uint32_t k = 1, invalid = !valid(&c[0]), urgent[SVOI_LOSSY_ENTRIES] = {urgency(&c[0])};
    uint8_t saved[SVO_SUPERBLOCK];
    bool covered = false;
    while (k < SVOI_LOSSY_ENTRIES) {
        uint32_t pick = first_of_most(urgent, k);
        if (urgent[pick] == 0 || (invalid != 0 && valid(&c[pick]))) return; /* an entry alone is not within the bound */
        bool was_valid = valid(&c[pick]);
        if (!cut(s, &c[pick], &c[k])) {
            c[pick].spread = 0;
            urgent[pick] = urgency(&c[pick]);
            if (!was_valid) return;
            bool more = false;
            for (uint32_t i = 0; i < k; i++) more = more || c[i].spread > 0;
            if (!more) return;
            continue;
        }
        measure(s, &c[pick]);
        measure(s, &c[k]);
        urgent[pick] = urgency(&c[pick]), urgent[k] = urgency(&c[k]);
        for (uint32_t i = c[k].low; i < c[k].high; i++) s->label[s->item[i].id] = (uint8_t)k;
        invalid = invalid - !was_valid + !valid(&c[pick]) + !valid(&c[k]);
        k++;
        /* before the first cover, which may do with far fewer entries, only what none could mend ends it */
        if ((float)least_bits(s, covered ? k : (k + 1) / 2) >= n->cost) return;
        if (invalid != 0) continue;
        if (!covered && k > 2) {
            for (uint32_t i = 0; i < s->items; i++) saved[i] = s->label[s->item[i].id];
            try_cover(s, c, k, n);
            for (uint32_t i = 0; i < s->items; i++) s->label[s->item[i].id] = saved[i];
        }
        covered = true;
        uint32_t width = width_of(k);
        float error = total_cost(c, k), cost = (float)(SVOI_HEADER_BITS + svoi_whole_bytes(k * s->table_bits + s->length * width)) + error;
        if (cost < n->cost) {
            svoi_take(n, cost, SVO_BLOCK_PALETTE + width - 1);
            keep_entries(n, c, k);
        }
        if (k > 2 && worth_trying_runs(k)) try_runs(s, c, k, error, n);
        if (!(error > 0)) return;
    }
}

/* --- lines ------------------------------------------------------------------------------------------------------- */

void svoi_line_candidates(const svoi_lossy_state *s, const svoi_node *n, uint32_t width, svoi_candidates *c)
{
    const uint32_t *table = s->e->job->table;
    c->count = 1u << width;
    for (uint32_t i = 0; i < c->count; i++) {
        uint32_t value = svo_line_point(s->t->kind, table[n->entry[0]], table[n->entry[1]], i, c->count - 1);
        svoi_point p = svoi_point_of(s->t->kind, s->t->squares, value), check = s->t->squares ? svoi_point_of(s->t->kind, false, value) : p;
        svoi_candidate_set(c, i, &p, &check);
    }
    svoi_candidates_fill(c);
}

/* Mean and direction of the largest variance. */
static bool principal_axis(const svoi_lossy_state *s, float mean[3], float v[3])
{
    float weight = 0, sum[3] = {0, 0, 0}, m[6] = {0, 0, 0, 0, 0, 0};
    svoi_point o = s->item[0].p;
    for (uint32_t i = 0; i < s->items; i++) {
        float n = s->item[i].count, x = s->item[i].p.x[0] - o.x[0], y = s->item[i].p.x[1] - o.x[1], z = s->item[i].p.x[2] - o.x[2];
        weight += n;
        sum[0] += n * x, sum[1] += n * y, sum[2] += n * z;
        m[0] += n * x * x, m[1] += n * x * y, m[2] += n * x * z, m[3] += n * y * y, m[4] += n * y * z, m[5] += n * z * z;
    }
    for (int k = 0; k < 3; k++) mean[k] = sum[k] / weight;
    m[0] -= sum[0] * mean[0], m[1] -= sum[0] * mean[1], m[2] -= sum[0] * mean[2];
    m[3] -= sum[1] * mean[1], m[4] -= sum[1] * mean[2], m[5] -= sum[2] * mean[2];
    for (int k = 0; k < 3; k++) mean[k] += o.x[k];
    if (m[0] >= m[3] && m[0] >= m[5]) v[0] = m[0], v[1] = m[1], v[2] = m[2];
    else if (m[3] >= m[5]) v[0] = m[1], v[1] = m[3], v[2] = m[4];
    else v[0] = m[2], v[1] = m[4], v[2] = m[5];
    for (int i = 0; i < 5; i++) {
        float x = m[0] * v[0] + m[1] * v[1] + m[2] * v[2], y = m[1] * v[0] + m[3] * v[1] + m[4] * v[2], z = m[2] * v[0] + m[4] * v[1] + m[5] * v[2];
        float l = sqrtf(x * x + y * y + z * z);
        if (!(l > 1e-6f)) return false;
        v[0] = x / l, v[1] = y / l, v[2] = z / l;
    }
    return true;
}

void svoi_try_lines(svoi_lossy_state *s, svoi_node *n)
{
    if (s->t->count == 0 || s->items < 3) return;
    float mean[3], v[3], low = INFINITY, high = -INFINITY, end[2][3];
    uint32_t fixed = SVOI_HEADER_BITS + 2 * s->table_bits;
    if ((float)(fixed + s->length) >= n->cost || !principal_axis(s, mean, v)) return;
    float off = 0; /* farthest from the line, squared, with the weights of CIE94 */
    for (uint32_t i = 0; i < s->items; i++) {
        const svoi_item *it = &s->item[i];
        float d[3], at = 0, beside[3];
        for (int k = 0; k < 3; k++) d[k] = it->p.x[k] - mean[k], at += d[k] * v[k];
        for (int k = 0; k < 3; k++) beside[k] = d[k] - at * v[k];
        float far = beside[0] * beside[0] + (it->w.wh + it->w.wd) * (beside[1] * beside[1] + beside[2] * beside[2]);
        if (far > off) off = far;
        if (at < low) low = at;
        if (at > high) high = at;
    }
    if (!s->t->squares && off > s->t->bound2) return;
    for (int k = 0; k < 3; k++) end[0][k] = mean[k] + v[k] * low, end[1][k] = mean[k] + v[k] * high;
    svoi_node line = {.entries = 2};
    for (int i = 0; i < 2; i++) line.entry[i] = (uint16_t)svoi_near(s->t, &s->near, end[i]);
    if (line.entry[0] == line.entry[1]) return;
    for (uint32_t width = 2; width <= 4; width++) {
        float least = (float)(fixed + s->length);
        if (fminf(least + (float)(s->segments * width), (float)(fixed + s->length * width)) >= n->cost) return;
        svoi_candidates c;
        svoi_line_candidates(s, &line, width, &c);
        float error = svoi_plain_cost(s, &c, n->cost, NULL);
        if (!(error < INFINITY)) continue;
        float cost = (float)(SVOI_HEADER_BITS + svoi_whole_bytes(2 * s->table_bits + s->length * width)) + error;
        if (cost < n->cost) {
            svoi_take(n, cost, SVO_BLOCK_LINE + width - 2);
            n->entries = 2, n->entry[0] = line.entry[0], n->entry[1] = line.entry[1];
        }
        if (least + error + (float)(count_changes(s) * width) > 1.25f * n->cost) continue;
        cost = svoi_runs_cost(s, &c, width, n->cost - least - 4, NULL) + least + 4;
        if (cost < n->cost) {
            svoi_take(n, cost, SVO_BLOCK_LINE_RUNS + width - 2);
            n->entries = 2, n->entry[0] = line.entry[0], n->entry[1] = line.entry[1];
        }
    }
}
