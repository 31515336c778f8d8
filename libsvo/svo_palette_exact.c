/* Blocks that give every value back: costs of all dyadic ranges from one pass, exactly counted, then the cheapest
 * partition bottom-up. */
#include "svoi_palette.h"

enum { SEEN = 2048 /* slots, a power of two > 1024 */, MAX_COMPONENTS = 3 };

typedef struct range {
    uint16_t distinct;
    bool missing; /* some value is not in the table */
    int64_t low[MAX_COMPONENTS], high[MAX_COMPONENTS];
} range;

typedef struct exact {
    const svoi_encoder *e;
    const uint32_t *v;
    uint32_t index[SVO_SUPERBLOCK];      /* in the table */
    uint16_t changes[SVO_SUPERBLOCK + 1]; /* values before i that differ from the one before them */
    range range[SVOI_LEVELS][SVOI_GRANULES];
    uint32_t stamp;
    struct { uint32_t stamp, key, value; } slot[SEEN]; /* valid when its stamp is the current one */
} exact;

static uint32_t *seen_find(exact *s, uint32_t key, bool *found)
{
    uint32_t i = (key * 2654435761u) >> 21;
    while (s->slot[i].stamp == s->stamp && s->slot[i].key != key) i = (i + 1) & (SEEN - 1);
    *found = s->slot[i].stamp == s->stamp;
    s->slot[i].stamp = s->stamp;
    s->slot[i].key = key;
    return &s->slot[i].value;
}

static void *exact_create(const svoi_encoder *e, const svo_allocator *a)
{
    exact *s = svo_calloc(a, 1, sizeof *s);
    if (s != NULL) s->e = e;
    return s;
}

static void exact_destroy(void *state, const svo_allocator *a) { svo_free(a, state, 1, sizeof(exact)); }

/* Components as the lattice has them; labels are unsigned. */
static void split(svo_channel_kind kind, uint32_t value, int64_t c[MAX_COMPONENTS])
{
    int32_t part[3];
    svo_lattice_split(kind, value, part);
    for (int i = 0; i < MAX_COMPONENTS; i++) c[i] = part[i];
    if (kind == SVO_KIND_ID32) c[0] = value;
}

static void look(exact *s)
{
    svo_channel_kind kind = s->e->job->kind;
    uint32_t components = svo_lattice_components(kind);
    memset(s->range, 0, sizeof s->range);
    s->stamp++;
    s->changes[0] = 0;
    int64_t c[MAX_COMPONENTS] = {0};
    for (uint32_t i = 0; i < SVO_SUPERBLOCK; i++) {
        bool found, same = i != 0 && s->v[i] == s->v[i - 1];
        s->index[i] = same ? s->index[i - 1] : svoi_table_index(s->e, s->v[i]);
        s->changes[i + 1] = (uint16_t)(s->changes[i] + !same);
        range *r = &s->range[0][i / SVO_GRANULE];
        if (!same) split(kind, s->v[i], c);
        if (i % SVO_GRANULE == 0)
            for (uint32_t k = 0; k < components; k++) r->low[k] = r->high[k] = c[k];
        for (uint32_t k = 0; k < components; k++) {
            if (c[k] < r->low[k]) r->low[k] = c[k];
            if (c[k] > r->high[k]) r->high[k] = c[k];
        }
        if (s->index[i] == SVOI_NO_INDEX) r->missing = true;
        /* A value counts in those ranges that hold no earlier equal one: ranges of 16 << k that hold i but not *last,
         * which are those with a differing bit at or above 4 + k. */
        uint32_t *last = seen_find(s, s->v[i], &found), differ = found ? (*last ^ i) >> 4 : SVOI_GRANULES;
        for (uint32_t k = 0; k < SVOI_LEVELS && differ >> k != 0; k++) s->range[k][i >> (4 + k)].distinct++;
        *last = i;
    }
    for (uint32_t k = 1; k < SVOI_LEVELS; k++)
        for (uint32_t i = 0; i < (uint32_t)SVOI_GRANULES >> k; i++) {
            range *r = &s->range[k][i];
            const range *x = &s->range[k - 1][2 * i], *y = x + 1;
            r->missing = x->missing || y->missing;
            for (uint32_t c2 = 0; c2 < components; c2++) {
                r->low[c2] = x->low[c2] < y->low[c2] ? x->low[c2] : y->low[c2];
                r->high[c2] = x->high[c2] > y->high[c2] ? x->high[c2] : y->high[c2];
            }
        }
}

static void fit_lattice(const exact *s, const range *r, svo_lattice *l)
{
    *l = (svo_lattice){.n = {1, 1, 1}, .step = {1, 1, 1}};
    for (uint32_t k = 0; k < svo_lattice_components(s->e->job->kind); k++) {
        uint32_t low = (uint32_t)r->low[k];
        memcpy(&l->low[k], &low, sizeof low);
        l->n[k] = (uint64_t)(r->high[k] - r->low[k]) + 1;
    }
    svoi_lattice_width(l);
}

static void consider(uint32_t bits, uint32_t mode, uint32_t *best, uint32_t *best_mode)
{
    bits = (bits + 7) & ~7u;
    if (bits < *best) *best = bits, *best_mode = mode;
}

/* Cheapest way to store values [begin, begin + length); ties go to the simpler one. Returns bits without the header. */
static uint32_t best_mode(const exact *s, const range *r, uint32_t begin, uint32_t length, uint32_t *mode)
{
    uint32_t b = s->e->table_bits, best = UINT32_MAX;
    uint32_t runs = 1u + s->changes[begin + length] - s->changes[begin + 1];
    if (r->distinct == 1 && !r->missing) {
        *mode = s->index[begin] < 4096 ? SVO_BLOCK_ONE : SVO_BLOCK_ONE_WIDE;
        return *mode == SVO_BLOCK_ONE ? 0 : (b + 7) & ~7u;
    }
    if (!r->missing) {
        uint32_t width = r->distinct > 1 ? 32 - (uint32_t)__builtin_clz(r->distinct - 1u) : 1;
        if (width <= 8) {
            consider(length * width + r->distinct * b, SVO_BLOCK_PALETTE + width - 1, &best, mode);
            if (width >= 2) consider(8 + r->distinct * b + length + runs * width, SVO_BLOCK_PALETTE_RUNS + width - 2, &best, mode);
        }
        consider(length * b, SVO_BLOCK_RAW, &best, mode);
    }
    svo_lattice l;
    fit_lattice(s, r, &l);
    consider(s->e->lattice_bits + length * l.bits, SVO_BLOCK_BOX, &best, mode);
    consider(s->e->lattice_bits + length + runs * l.bits, SVO_BLOCK_BOX_RUNS, &best, mode);
    return best;
}

static uint64_t exact_choose(void *state, const uint32_t *v)
{
    exact *s = state;
    s->v = v;
    look(s);
    uint32_t cost[SVOI_GRANULES], mode;
    uint64_t map = ~(uint64_t)0;
    for (uint32_t i = 0; i < SVOI_GRANULES; i++)
        cost[i] = SVOI_HEADER_BITS + best_mode(s, &s->range[0][i], i * SVO_GRANULE, SVO_GRANULE, &mode);
    for (uint32_t k = 1; k < SVOI_LEVELS; k++)
        for (uint32_t i = 0; i < (uint32_t)SVOI_GRANULES >> k; i++) {
            uint32_t begin = i << k, granules = 1u << k;
            uint32_t whole = SVOI_HEADER_BITS + best_mode(s, &s->range[k][i], begin * SVO_GRANULE, granules * SVO_GRANULE, &mode);
            uint32_t split_cost = cost[2 * i] + cost[2 * i + 1];
            cost[i] = whole <= split_cost ? whole : split_cost;
            if (whole <= split_cost) map &= ~((((uint64_t)1 << (granules - 1)) - 1) << (begin + 1));
        }
    return map;
}

static void exact_block(void *state, uint32_t first, uint32_t end, svoi_block *out)
{
    exact *s = state;
    uint32_t begin = first * SVO_GRANULE, length = (end - first) * SVO_GRANULE, level = (uint32_t)__builtin_ctz(end - first);
    const range *r = &s->range[level][first >> level];
    best_mode(s, r, begin, length, &out->mode);
    out->entries = 0;
    if (out->mode < SVO_BLOCK_RAW) {
        out->entry[out->entries++] = s->index[begin];
    } else if (out->mode == SVO_BLOCK_RAW) {
        memcpy(out->number, s->index + begin, length * sizeof *out->number);
    } else if (out->mode < SVO_BLOCK_LINE) {
        fit_lattice(s, r, &out->lattice);
        for (uint32_t i = 0; i < length; i++) {
            int64_t c[MAX_COMPONENTS];
            split(s->e->job->kind, s->v[begin + i], c);
            uint64_t number = 0;
            for (uint32_t k = svo_lattice_components(s->e->job->kind); k-- > 0;)
                number = number * out->lattice.n[k] + (uint64_t)(c[k] - r->low[k]);
            out->number[i] = (uint32_t)number;
        }
    } else {
        s->stamp++;
        for (uint32_t i = 0; i < length; i++) {
            bool found;
            uint32_t *number = seen_find(s, s->v[begin + i], &found);
            if (!found) {
                *number = out->entries;
                out->entry[out->entries++] = s->index[begin + i];
            }
            out->number[i] = *number;
        }
    }
}

const svoi_chooser svoi_exact = {exact_create, exact_destroy, exact_choose, exact_block};
