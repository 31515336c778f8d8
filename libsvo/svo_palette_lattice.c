/* Blocks of lattice points, fitted to the values at hand: svoi_lossy.h. */
#include <math.h>

#include "svoi_lossy.h"

uint32_t svoi_lattice_number(svo_channel_kind kind, const svo_lattice *l, uint32_t value)
{
    int32_t c[3];
    uint64_t number = 0;
    svo_lattice_split(kind, value, c);
    for (uint32_t k = svo_lattice_components(kind); k-- > 0;) {
        int64_t step = l->step[k], at = (int64_t)c[k] - l->low[k] + step / 2;
        int64_t q = at < 0 ? 0 : at / step;
        if (q >= (int64_t)l->n[k]) q = (int64_t)l->n[k] - 1;
        number = number * l->n[k] + (uint64_t)q;
    }
    return (uint32_t)number;
}

static uint32_t value_of(svo_channel_kind kind, const int32_t c[3])
{
    svo_lattice l = {.low = {c[0], c[1], c[2]}, .n = {1, 1, 1}, .step = {1, 1, 1}};
    return svo_lattice_point(kind, &l, 0);
}

/* Steps so that the corner of a cell is at distance 1, were the space flat: h[k] in units of component k. */
static bool cell_shape(const svoi_lossy_state *s, const int32_t middle[3], bool check, float h[3])
{
    svo_channel_kind kind = s->t->kind;
    bool rgb = s->t->squares && !check;
    uint32_t components = svo_lattice_components(kind);
    int32_t delta = kind == SVO_KIND_NORMAL_OCT32 ? 128 : 4;
    svoi_point at = svoi_point_of(kind, rgb, value_of(kind, middle));
    svoi_weights w = svoi_weights_of(kind, rgb, &at);
    float d[3][4], worst = 0;
    for (uint32_t k = 0; k < components; k++) {
        int32_t a[3] = {middle[0], middle[1], middle[2]}, b[3] = {middle[0], middle[1], middle[2]};
        a[k] -= delta, b[k] += delta;
        svoi_point p = svoi_point_of(kind, rgb, value_of(kind, a)), q = svoi_point_of(kind, rgb, value_of(kind, b));
        float norm = svoi_distance2(&p, w, &q);
        if (!(norm > 0)) return false;
        h[k] = 2 * (float)delta / sqrtf(norm);
        for (int i = 0; i < 4; i++) d[k][i] = (q.x[i] - p.x[i]) / (2 * (float)delta) * h[k];
    }
    for (uint32_t signs = 0; signs < 4; signs++) { /* corners of a cell with half edges h */
        svoi_point corner = {{0, 0, 0, 0}}, zero = {{0, 0, 0, 0}};
        for (uint32_t k = 0; k < components; k++)
            for (int i = 0; i < 4; i++) corner.x[i] += (k != 0 && signs >> (k - 1) & 1 ? -1.0f : 1.0f) * d[k][i];
        float e = svoi_distance2(&corner, w, &zero);
        if (e > worst) worst = e;
    }
    if (!(worst > 0)) return false;
    for (uint32_t k = 0; k < components; k++) h[k] *= 2 / sqrtf(worst); /* whole edges */
    return true;
}

static void fit_lattice(const svoi_lossy_state *s, const int32_t low[3], const int32_t high[3], const float h[3], float scale, svo_lattice *l)
{
    svo_channel_kind kind = s->t->kind;
    *l = (svo_lattice){.n = {1, 1, 1}, .step = {1, 1, 1}};
    for (uint32_t k = 0; k < svo_lattice_components(kind); k++) {
        float edge = h[k] * scale;
        l->step[k] = svoi_step_of(kind, svoi_step_code(kind, edge < 1 ? 1 : edge > 30000 ? 30000 : (uint32_t)edge));
        int32_t range = high[k] - low[k], step = (int32_t)l->step[k], rest = range - 2 * (step / 2);
        l->n[k] = rest > 0 ? 1 + (uint64_t)(rest + step - 1) / (uint64_t)step : 1;
        l->low[k] = low[k] + (range - (int32_t)(l->n[k] - 1) * step) / 2;
    }
    svoi_lattice_width(l);
}

/* Error of all items, INFINITY when one is not within the bound. */
static float lattice_cost(const svoi_lossy_state *s, const svo_lattice *l)
{
    float sum = 0;
    for (uint32_t i = 0; i < s->items; i++) {
        const svoi_item *it = &s->item[i];
        uint32_t value = s->value[it->id], other = svo_lattice_point(s->t->kind, l, svoi_lattice_number(s->t->kind, l, value));
        if (value == other) continue;
        svoi_point p = svoi_point_of(s->t->kind, s->t->squares, other);
        float d = svoi_distance2(&it->p, it->w, &p);
        sum += svoi_cost(s->t, d) * it->count;
        if (s->t->squares) {
            p = svoi_point_of(s->t->kind, false, other);
            d = svoi_distance2(&s->check[it->id], s->check_weights[it->id], &p);
        }
        if (!(d <= s->t->bound2)) return INFINITY;
    }
    return sum;
}

/* The scale at which a little more error is worth a little fewer bits: for an error that grows with the scale, bits
 * falling by components / ln 2 for each e-fold. Corners are at 1, so the mean is about half of that (squares: a third). */
static float best_scale(const svoi_lossy_state *s)
{
    float bits = (float)svo_lattice_components(s->t->kind) / 0.6931472f;
    if (!(s->t->price > 0)) return INFINITY;
    return s->t->squares ? sqrtf(bits / (2 * s->t->price * 0.33f)) : bits / (s->t->price * 0.5f);
}

void svoi_try_lattice(svoi_lossy_state *s, svoi_node *n)
{
    svo_channel_kind kind = s->t->kind;
    uint32_t components = svo_lattice_components(kind), fixed = SVOI_HEADER_BITS + s->e->lattice_bits;
    if ((float)fixed >= n->cost) return;
    int32_t low[3] = {0}, high[3] = {0}, middle[3] = {0}, c[3];
    for (uint32_t i = 0; i < s->items; i++) {
        svo_lattice_split(kind, s->value[s->item[i].id], c);
        for (uint32_t k = 0; k < components; k++) {
            if (i == 0 || c[k] < low[k]) low[k] = c[k];
            if (i == 0 || c[k] > high[k]) high[k] = c[k];
        }
    }
    float h[3] = {1, 1, 1}, ch[3];
    for (uint32_t k = 0; k < components; k++) middle[k] = (low[k] + high[k]) / 2;
    float scale = 0, bound = sqrtf(s->t->bound2);
    if (cell_shape(s, middle, false, h)) {
        scale = s->t->squares ? INFINITY : bound;
        if (s->t->squares && cell_shape(s, middle, true, ch))
            for (uint32_t k = 0; k < components; k++) scale = fminf(scale, bound * ch[k] / h[k]);
        scale = fminf(scale, best_scale(s));
    }
    if (!(scale < 1e6f)) scale = 1e6f;
    for (int attempt = 0; attempt < 5; attempt++, scale = attempt == 4 ? 0 : scale * 0.85f) {
        svo_lattice l;
        fit_lattice(s, low, high, h, scale, &l);
        float plain = (float)(SVOI_HEADER_BITS + svoi_whole_bytes(s->e->lattice_bits + s->length * l.bits));
        float runs = (float)(SVOI_HEADER_BITS + svoi_whole_bytes(s->e->lattice_bits + s->length + s->runs * l.bits));
        float bits = plain <= runs ? plain : runs;
        if (bits >= n->cost || l.bits > 32) {
            if (attempt < 4 && n->mode == SVOI_NONE && n->cost == INFINITY) continue;
            return;
        }
        float error = lattice_cost(s, &l);
        if (!(error < INFINITY)) continue;
        if (bits + error < n->cost) {
            svoi_take(n, bits + error, plain <= runs ? SVO_BLOCK_BOX : SVO_BLOCK_BOX_RUNS);
            n->lattice = l;
        }
        return;
    }
}
