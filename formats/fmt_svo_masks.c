/* Level by level, row by row, a decision for every child of an existing node: see docs/format/masks.md. */
#include <pthread.h>
#include <string.h>

#include "fmti_svo_masks.h"

enum {
    COUNT_MOST = 63,
    P_LEAST = 32, /* probabilities stay away from 0 and 1 by this much of 65536 */
    FULL_CONTEXTS = 64,
    LOGGED = 4096, /* decisions after which undoing slot by slot costs more than a copy of the model */
    BEYOND = 4     /* zero bytes that the encoder leaves out at its end */
};

/* --- tables: logistic function and its inverse, adaptation rates ----------------------------------------------- */

static struct { int16_t stretch[4096]; uint16_t squash[4096], rate[COUNT_MOST + 1]; } tables;

static void make_tables(void)
{
    /* 65536 / (1 + exp(-(i - 16) / 2)), rounded */
    static const int32_t knot[33] = {22, 36, 60, 98, 162, 267, 439, 720, 1179, 1921, 3108, 4971, 7812, 11955, 17625, 24743,
                                     32768, 40793, 47911, 53581, 57724, 60565, 62428, 63615, 64357, 64816, 65097, 65269, 65374, 65438, 65476, 65500, 65514};
    for (int32_t i = 0; i < 4096; i++) {
        int32_t k = i >> 7, w = i & 127;
        tables.squash[i] = (uint16_t)(knot[k] + (((knot[k + 1] - knot[k]) * w + 64) >> 7));
    }
    int32_t d = -2047;
    for (int32_t q = 0; q < 4096; q++) {
        while (d < 2047 && tables.squash[d + 2048] < 16 * q + 8) d++;
        tables.stretch[q] = (int16_t)d;
    }
    for (uint32_t n = 0; n <= COUNT_MOST; n++) tables.rate[n] = (uint16_t)(655360 / (10 * n + 11));
}

static void need_tables(void)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, make_tables);
}

/* --- range coder: 32 bits, carries resolved by the encoder -------------------------------------------------------- */

typedef struct coder {
    uint32_t range;
    /* decoding */
    uint32_t code;
    const uint8_t *in, *end;
    uint32_t beyond; /* bytes read after the end */
    /* encoding */
    uint64_t low;
    uint64_t pending;
    uint8_t cache;
    bool first, failed;
    svo_buffer *out;
} coder;

static void put(coder *c, uint8_t b)
{
    if (c->first) c->first = false; /* it is always 0 */
    else if (svo_buffer_append(c->out, &b, 1) == NULL) c->failed = true;
}

static void shift_low(coder *c)
{
    if ((uint32_t)c->low < 0xff000000u || c->low >> 32 != 0) {
        uint8_t carry = (uint8_t)(c->low >> 32), b = c->cache;
        for (; c->pending != 0; c->pending--) {
            put(c, (uint8_t)(b + carry));
            b = 0xff;
        }
        c->cache = (uint8_t)(c->low >> 24);
    }
    c->pending++;
    c->low = (c->low & 0x00ffffff) << 8;
}

static uint8_t next_byte(coder *c)
{
    if (c->in != c->end) return *c->in++;
    c->beyond++;
    return 0;
}

/* The range has fallen below 2^24, but not below 2^13 (P_LEAST): one or two bytes follow. */
static inline void decode_more(coder *c)
{
    if (c->end - c->in < 2) { /* near the end: byte by byte */
        while (c->range < 1u << 24) {
            c->code = c->code << 8 | next_byte(c);
            c->range <<= 8;
        }
        return;
    }
    uint32_t bytes = c->range < 1u << 16 ? 2 : c->range < 1u << 24, two = (uint32_t)c->in[0] << 8 | c->in[1];
    c->code = c->code << 8 * bytes | two >> (16 - 8 * bytes);
    c->range <<= 8 * bytes;
    c->in += bytes;
}

/* p: probability of 1, of 65536. Without branches: which way they went would be guessed wrong too often. */
static inline uint32_t decode_bit(coder *c, uint32_t p)
{
    uint32_t bound = (c->range >> 16) * p, bit = c->code < bound, zero = bit - 1; /* zero: all bits set where it is 0 */
    c->code -= bound & zero;
    c->range = bound + ((c->range - 2 * bound) & zero);
    decode_more(c);
    return bit;
}

static inline void encode_bit(coder *c, uint32_t bit, uint32_t p)
{
    uint32_t bound = (c->range >> 16) * p;
    if (bit != 0) {
        c->range = bound;
    } else {
        c->low += bound;
        c->range -= bound;
    }
    while (c->range < 1u << 24) {
        c->range <<= 8;
        shift_low(c);
    }
}

/* End with the number in the range that has the most zero bytes behind, and leave those out. */
static void encode_end(coder *c, size_t begin)
{
    c->low = (c->low + c->range - 1) & ~(uint64_t)0xffffff;
    for (int i = 0; i < 5; i++) shift_low(c);
    for (int i = 0; i < BEYOND && c->out->size > begin && c->out->data[c->out->size - 1] == 0; i++) c->out->size--;
}

/* --- a subtree in work --------------------------------------------------------------------------------------------- */

typedef struct scratch {
    struct scratch *next;
    fmti_masks_model model; /* equal to the prior between calls */
    fmti_grid nodes[FMTI_MASKS_LEVELS + 1], full[FMTI_MASKS_LEVELS + 1]; /* zero between calls */
    bool has_full;
    uint16_t full_p[FULL_CONTEXTS];
    uint64_t found, most; /* nodes that have masks: decoded so far, and how many there should be */
    uint32_t decisions;
    uint16_t log[LOGGED][FMTI_MASKS_MODELS];
    size_t grid_bytes;
    uint8_t grids[];
} scratch;

typedef enum mode { ENCODE, DECODE, LEARN } mode;

/* `bits` bits of a row from x - before on. */
static inline uint32_t window(const uint8_t *row, uint32_t x, uint32_t before, uint32_t bits)
{
    uint32_t w, at = x + FMTI_GRID_PAD_BITS - before;
    memcpy(&w, row + (at >> 3), 4);
    return w >> (at & 7) & ((1u << bits) - 1);
}

static inline uint32_t bit_at(const uint8_t *row, uint32_t x) { return row[(x + FMTI_GRID_PAD_BITS) >> 3] >> (x & 7) & 1u; }

/* What is known around a child: coarse nodes around its parent, nodes of its own level that were coded before. Windows
 * begin before the first of the two children in a row. */
typedef struct around {
    uint32_t ahead;          /* 13 coarse neighbours that lie ahead */
    uint32_t y1, y2;         /* rows y-1 and y-2: x-6.., x-2.. */
    uint32_t z1[5];          /* layer z-1, rows y-2 .. y+2: from x-2, but y from x-4 */
    uint32_t z2[3];          /* layer z-2, rows y-1 .. y+1, from x-1 */
    uint32_t before;         /* coded bits of the row; bit 0 is x-1 */
} around;

typedef struct contexts { uint64_t c[FMTI_MASKS_MODELS]; uint32_t near; } contexts;

static inline contexts make_contexts(const around *a, uint32_t dx, uint32_t octant)
{
    uint32_t near = (a->before & 1) | (a->y1 >> (5 + dx) & 7) << 1 | (a->z1[1] >> (1 + dx) & 7) << 4 | (a->z1[2] >> (3 + dx) & 7) << 7 |
                    (a->z1[3] >> (1 + dx) & 7) << 10;
    uint32_t wide = (a->before >> 1 & 1) | (a->y2 >> (1 + dx) & 7) << 1 | (a->y1 >> (4 + dx) & 1) << 4 | (a->y1 >> (8 + dx) & 1) << 5 |
                    (a->z1[0] >> (1 + dx) & 7) << 6 | (a->z1[4] >> (1 + dx) & 7) << 9 | (a->z1[1] >> dx & 1) << 12 | (a->z1[1] >> (4 + dx) & 1) << 13 |
                    (a->z1[2] >> (2 + dx) & 1) << 14 | (a->z1[2] >> (6 + dx) & 1) << 15 | (a->z1[3] >> dx & 1) << 16 | (a->z1[3] >> (4 + dx) & 1) << 17;
    uint32_t far = (a->z2[0] >> dx & 7) | (a->z2[1] >> dx & 7) << 3 | (a->z2[2] >> dx & 7) << 6;
    uint32_t faces = a->ahead >> 12 | (a->ahead >> 10 & 1) << 1 | (a->ahead >> 4 & 1) << 2;
    contexts c = {{near | octant << 13, near | (uint64_t)wide << 13 | (uint64_t)far << 31 | (uint64_t)octant << 40,
                   near | (uint64_t)a->ahead << 13 | (uint64_t)octant << 26,
                   (a->before & 255) | (uint64_t)(a->y1 >> dx & 0x1fff) << 8 | (uint64_t)(a->z1[2] >> dx & 0x1ff) << 21 | (uint64_t)faces << 30 |
                       (uint64_t)octant << 33},
                  near};
    return c;
}

/* Code one decision with the model and let the model learn it. `bit` is given but for DECODE. */
static inline uint32_t model_bit(fmti_masks_model *m, scratch *s, coder *c, const contexts *x, uint32_t set, uint32_t bit, const mode how)
{
    uint32_t *slot[FMTI_MASKS_MODELS];
    int32_t in[FMTI_MASKS_MODELS], *w = m->weight[set];
    int64_t sum = 0;
    const bool logged = how != LEARN && s->decisions < LOGGED;
    for (uint32_t k = 0; k < FMTI_MASKS_MODELS; k++) {
        uint64_t h = (x->c[k] + 1) * (0x9e3779b97f4a7c15u + 2 * k);
        uint32_t at = k == 0 ? (uint32_t)x->c[0] : (uint32_t)(h >> 48), tag = k == 0 ? 0 : (uint32_t)(h >> 40) & 255;
        slot[k] = &m->slot[k][at];
        if (logged) s->log[s->decisions][k] = (uint16_t)at;
        uint32_t v = *slot[k];
        if ((v & 255) != tag) v = *slot[k] = 1u << 31 | tag; /* another context had it */
        in[k] = (v >> 8 & 63) != 0 ? tables.stretch[v >> 20] : 0;
        sum += (int64_t)in[k] * w[k];
    }
    if (logged) s->decisions++;
    int32_t d = sum < -2047 * 65536 ? -2047 : sum > 2047 * 65536 ? 2047 : (int32_t)(sum >> 16);
    uint32_t p = tables.squash[d + 2048];
    p = p < P_LEAST ? P_LEAST : p > 65536 - P_LEAST ? 65536 - P_LEAST : p;
    if (how == DECODE) bit = decode_bit(c, p);
    else if (how == ENCODE) encode_bit(c, bit, p);
    int32_t error = (int32_t)(bit << 16) - (int32_t)p, target = bit != 0 ? (1 << 18) - 1 : 0;
    for (uint32_t k = 0; k < FMTI_MASKS_MODELS; k++) {
        int32_t to = w[k] + ((in[k] * error + 16384) >> 15);
        w[k] = to < -(1 << 20) ? -(1 << 20) : to > 1 << 20 ? 1 << 20 : to;
        uint32_t v = *slot[k], n = v >> 8 & 63;
        int32_t q = (int32_t)(v >> 14);
        q += (int32_t)((int64_t)(target - q) * tables.rate[n] >> 16);
        *slot[k] = (uint32_t)q << 14 | (n < COUNT_MOST ? n + 1 : n) << 8 | (v & 255);
    }
    return bit;
}

/* Is a node that exists a full leaf? Only asked in subtrees that have some. */
static uint32_t code_full(scratch *s, coder *c, uint32_t level, uint32_t far, uint32_t x, uint32_t y, uint32_t z, uint32_t near, mode how)
{
    const fmti_grid *f = &s->full[level];
    int32_t iy = (int32_t)y, iz = (int32_t)z;
    uint8_t *row = fmti_grid_row(f, iy, iz);
    uint32_t i = bit_at(row, x - 1) | bit_at(fmti_grid_row(f, iy - 1, iz), x) << 1 | bit_at(fmti_grid_row(f, iy, iz - 1), x) << 2 |
                 (near == 0x1fff ? 8u : 0) | far << 4;
    int32_t p = s->full_p[i];
    uint32_t bit = bit_at(row, x);
    if (how == DECODE) bit = decode_bit(c, (uint32_t)p);
    else encode_bit(c, bit, (uint32_t)p);
    p += ((bit != 0 ? 65536 : 0) - p) >> 4;
    s->full_p[i] = (uint16_t)(p < P_LEAST ? P_LEAST : p > 65536 - P_LEAST ? 65536 - P_LEAST : p);
    if (bit != 0) fmti_grid_set(f, x, y, z);
    return bit;
}

/* All children of the nodes of `level` that lie in one row of children. */
static inline __attribute__((always_inline)) void code_row(fmti_masks_model *m, scratch *s, coder *c, const fmti_grid *nodes, uint32_t level,
                                                           uint32_t levels, uint32_t y, uint32_t z, const uint64_t parents[2], const mode how)
{
    const fmti_grid *coarse = &nodes[level], *fine = &nodes[level + 1];
    const int32_t Y = (int32_t)(y >> 1), Z = (int32_t)(z >> 1), iy = (int32_t)y, iz = (int32_t)z;
    const uint32_t far = levels - 1 - level > 3 ? 3 : levels - 1 - level, side = (y & 1) << 1 | (z & 1) << 2;
    const uint8_t *cx = fmti_grid_row(coarse, Y, Z), *cy = fmti_grid_row(coarse, Y + 1, Z), *cz[3], *y1 = fmti_grid_row(fine, iy - 1, iz),
                  *y2 = fmti_grid_row(fine, iy - 2, iz), *z1[5], *z2[3];
    for (int32_t i = 0; i < 3; i++) cz[i] = fmti_grid_row(coarse, Y - 1 + i, Z + 1);
    for (int32_t i = 0; i < 5; i++) z1[i] = fmti_grid_row(fine, iy - 2 + i, iz - 1);
    for (int32_t i = 0; i < 3; i++) z2[i] = fmti_grid_row(fine, iy - 1 + i, iz - 2);
    uint8_t *row = fmti_grid_row(fine, iy, iz);
    const uint8_t *full = how != LEARN && s->has_full ? fmti_grid_row(&s->full[level], Y, Z) : NULL;
    uint64_t coded[2] = {0, 0};
    around a = {0};
    uint32_t reached = 0; /* a.before ends here */
    for (uint32_t half = 0; half < 2; half++)
        for (uint64_t left = parents[half]; left != 0; left &= left - 1) {
            const uint32_t X = 64 * half + (uint32_t)__builtin_ctzll(left), x = 2 * X;
            a.before = x - reached > 16 ? 0 : a.before << (x - reached);
            reached = x + 2;
            if (full != NULL && bit_at(full, X) != 0) { /* its children are full as well: nothing to code */
                a.before = a.before << 2 | 3;
                coded[x >> 6] |= (uint64_t)3 << (x & 63);
                if (how == ENCODE) row[(x + FMTI_GRID_PAD_BITS) >> 3] |= (uint8_t)(3u << (x & 7));
                fmti_grid_row(&s->full[level + 1], iy, iz)[(x + FMTI_GRID_PAD_BITS) >> 3] |= (uint8_t)(3u << (x & 7));
                continue;
            }
            a.ahead = window(cz[0], X, 1, 3) | window(cz[1], X, 1, 3) << 3 | window(cz[2], X, 1, 3) << 6 | window(cy, X, 1, 3) << 9 | bit_at(cx, X + 1) << 12;
            a.y1 = window(y1, x, 6, 15);
            a.y2 = window(y2, x, 2, 6);
            for (uint32_t i = 0; i < 5; i++) a.z1[i] = i == 2 ? window(z1[i], x, 4, 10) : window(z1[i], x, 2, 6);
            for (uint32_t i = 0; i < 3; i++) a.z2[i] = window(z2[i], x, 1, 4);
            for (uint32_t dx = 0; dx < 2; dx++) {
                const uint32_t octant = side | dx;
                uint32_t bit = 1;
                contexts t = make_contexts(&a, dx, octant);
                /* the last child exists where no other does */
                if (octant != 7 || (a.before & 1) != 0 || (a.y1 >> 6 & 3) != 0 || (a.z1[1] >> 2 & 3) != 0 || (a.z1[2] >> 4 & 3) != 0) {
                    const uint32_t set = (far * 8 + octant) * 16 + (uint32_t)__builtin_popcount(t.near);
                    bit = model_bit(m, s, c, &t, set, how == DECODE ? 0 : bit_at(row, x + dx), how);
                }
                a.before = a.before << 1 | bit;
                coded[x >> 6] |= (uint64_t)bit << ((x + dx) & 63);
                if (how == DECODE && level + 1 < levels) s->found += bit;
                if (full != NULL && bit != 0 && level + 1 < levels) code_full(s, c, level + 1, far, x + dx, y, z, t.near, how);
            }
        }
    if (how == DECODE) memcpy(row + 1, coded, sizeof coded);
}

static inline __attribute__((always_inline)) void code_levels(fmti_masks_model *m, scratch *s, coder *c, const fmti_grid *nodes, uint32_t levels,
                                                              const mode how)
{
    for (uint32_t level = 0; level < levels; level++) {
        const uint32_t size = 1u << level;
        for (uint32_t z = 0; z < 2 * size; z++)
            for (uint32_t Y = 0; Y < size; Y++) {
                uint64_t parents[2];
                memcpy(parents, fmti_grid_row(&nodes[level], (int32_t)Y, (int32_t)(z >> 1)) + 1, sizeof parents);
                if ((parents[0] | parents[1]) == 0) continue;
                code_row(m, s, c, nodes, level, levels, 2 * Y, z, parents, how);
                code_row(m, s, c, nodes, level, levels, 2 * Y + 1, z, parents, how);
                if (how == DECODE && (c->beyond > BEYOND || s->found >= s->most)) return;
            }
    }
}

/* Kept apart, so that each is compiled for its mode. */
static __attribute__((noinline)) void encode_levels(scratch *s, coder *c, uint32_t levels) { code_levels(&s->model, s, c, s->nodes, levels, ENCODE); }
static __attribute__((noinline)) void decode_levels(scratch *s, coder *c, uint32_t levels) { code_levels(&s->model, s, c, s->nodes, levels, DECODE); }

void fmti_masks_learn(fmti_masks_model *m, const fmti_grid *nodes, uint32_t levels)
{
    need_tables();
    code_levels(m, NULL, NULL, nodes, levels, LEARN);
}

/* --- masks <-> grids ----------------------------------------------------------------------------------------------- */

typedef struct place { uint32_t x, y, z; } place;

static inline place child(place p, uint32_t octant)
{
    place c = {2 * p.x + (octant & 1), 2 * p.y + (octant >> 1 & 1), 2 * p.z + (octant >> 2)};
    return c;
}

static void masks_to_grids(scratch *s, uint32_t levels, const uint8_t *masks)
{
    place at[FMTI_MASKS_LEVELS + 1] = {{0, 0, 0}};
    uint32_t left[FMTI_MASKS_LEVELS + 1], l = 0;
    uint64_t i = 0;
    fmti_grid_set(&s->nodes[0], 0, 0, 0);
    left[0] = masks[i++];
    for (;;) {
        while (left[l] == 0) {
            if (l == 0) return;
            l--;
        }
        place p = child(at[l], (uint32_t)__builtin_ctz(left[l]));
        left[l] &= left[l] - 1;
        fmti_grid_set(&s->nodes[l + 1], p.x, p.y, p.z);
        if (l + 1 == levels) continue;
        uint8_t mask = masks[i++];
        if (mask == 0) {
            fmti_grid_set(&s->full[l + 1], p.x, p.y, p.z);
            s->has_full = true;
            continue;
        }
        l++;
        at[l] = p;
        left[l] = mask;
    }
}

static inline uint32_t mask_at(const fmti_grid *g, place p)
{
    int32_t y = (int32_t)(2 * p.y), z = (int32_t)(2 * p.z);
    uint32_t at = (2 * p.x + FMTI_GRID_PAD_BITS) >> 3, shift = 2 * p.x & 7;
    return (fmti_grid_row(g, y, z)[at] >> shift & 3u) | (fmti_grid_row(g, y + 1, z)[at] >> shift & 3u) << 2 |
           (fmti_grid_row(g, y, z + 1)[at] >> shift & 3u) << 4 | (fmti_grid_row(g, y + 1, z + 1)[at] >> shift & 3u) << 6;
}

/* False when there are more or fewer than `count`. */
static bool grids_to_masks(const scratch *s, uint32_t levels, uint8_t *masks, uint64_t count)
{
    place at[FMTI_MASKS_LEVELS] = {{0, 0, 0}};
    uint32_t left[FMTI_MASKS_LEVELS], l = 0;
    uint64_t i = 0;
    left[0] = mask_at(&s->nodes[1], at[0]);
    masks[i++] = (uint8_t)left[0];
    for (;;) {
        while (l + 1 == levels || left[l] == 0) {
            if (l == 0) return i == count;
            l--;
        }
        place p = child(at[l], (uint32_t)__builtin_ctz(left[l]));
        left[l] &= left[l] - 1;
        if (i == count) return false;
        if (s->has_full && bit_at(fmti_grid_row(&s->full[l + 1], (int32_t)p.y, (int32_t)p.z), p.x) != 0) {
            masks[i++] = 0;
            continue;
        }
        l++;
        at[l] = p;
        left[l] = mask_at(&s->nodes[l + 1], p);
        masks[i++] = (uint8_t)left[l];
    }
}

/* --- pool ---------------------------------------------------------------------------------------------------------- */

struct fmti_masks_pool {
    pthread_mutex_t lock;
    const svo_allocator *allocator;
    scratch *kept;
};

svo_result fmti_masks_pool_new(const svo_allocator *a, fmti_masks_pool **out, svo_error *err)
{
    fmti_masks_pool *p = svo_calloc(a, 1, sizeof *p);
    if (p == NULL || pthread_mutex_init(&p->lock, NULL) != 0) {
        svo_free(a, p, 1, sizeof *p);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the codec of masks");
    }
    p->allocator = a;
    *out = p;
    return SVO_OK;
}

static size_t grids_size(void)
{
    size_t size = 0;
    for (uint32_t l = 0; l <= FMTI_MASKS_LEVELS; l++) size += 2 * fmti_grid_bytes(1u << l);
    return size;
}

void fmti_masks_pool_free(fmti_masks_pool *p)
{
    if (p == NULL) return;
    while (p->kept != NULL) {
        scratch *s = p->kept;
        p->kept = s->next;
        svo_free(p->allocator, s, 1, sizeof *s + s->grid_bytes);
    }
    pthread_mutex_destroy(&p->lock);
    svo_free(p->allocator, p, 1, sizeof *p);
}

static scratch *take(fmti_masks_pool *p)
{
    need_tables();
    const fmti_masks_model *prior = fmti_masks_prior();
    pthread_mutex_lock(&p->lock);
    scratch *s = p->kept;
    if (s != NULL) p->kept = s->next;
    pthread_mutex_unlock(&p->lock);
    if (s == NULL) {
        size_t grids = grids_size();
        s = svo_calloc(p->allocator, 1, sizeof *s + grids);
        if (s == NULL) return NULL;
        s->grid_bytes = grids;
        uint8_t *at = s->grids;
        for (uint32_t l = 0; l <= FMTI_MASKS_LEVELS; l++) {
            s->nodes[l] = (fmti_grid){at, 1u << l};
            s->full[l] = (fmti_grid){at + fmti_grid_bytes(1u << l), 1u << l};
            at += 2 * fmti_grid_bytes(1u << l);
        }
        memcpy(&s->model, prior, sizeof *prior);
    }
    s->has_full = false;
    s->decisions = 0;
    for (uint32_t i = 0; i < FULL_CONTEXTS; i++) s->full_p[i] = 32768;
    fmti_grid_set(&s->nodes[0], 0, 0, 0);
    return s;
}

/* Undo what the call did. */
static void give(fmti_masks_pool *p, scratch *s, uint32_t levels)
{
    const fmti_masks_model *prior = fmti_masks_prior();
    if (s->decisions < LOGGED) {
        for (uint32_t i = 0; i < s->decisions; i++)
            for (uint32_t k = 0; k < FMTI_MASKS_MODELS; k++) s->model.slot[k][s->log[i][k]] = prior->slot[k][s->log[i][k]];
        memcpy(s->model.weight, prior->weight, sizeof prior->weight);
    } else {
        memcpy(&s->model, prior, sizeof *prior);
    }
    for (uint32_t l = 0; l <= levels; l++) {
        memset(s->nodes[l].bits, 0, fmti_grid_bytes(1u << l));
        if (s->has_full) memset(s->full[l].bits, 0, fmti_grid_bytes(1u << l));
    }
    pthread_mutex_lock(&p->lock);
    s->next = p->kept;
    p->kept = s;
    pthread_mutex_unlock(&p->lock);
}

enum { HAS_FULL_P = 1024 };

svo_result fmti_masks_encode(fmti_masks_pool *p, uint32_t levels, const uint8_t *masks, uint64_t count, svo_buffer *to, svo_error *err)
{
    SVO_ASSERT(levels >= 1 && levels <= FMTI_MASKS_LEVELS && count >= 1);
    (void)count;
    scratch *s = take(p);
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to code masks");
    masks_to_grids(s, levels, masks);
    size_t begin = to->size;
    coder c = {.range = UINT32_MAX, .pending = 1, .first = true, .out = to};
    encode_bit(&c, s->has_full, HAS_FULL_P);
    encode_levels(s, &c, levels);
    encode_end(&c, begin);
    give(p, s, levels);
    return c.failed ? svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for coded masks") : SVO_OK;
}

svo_result fmti_masks_decode(fmti_masks_pool *p, uint32_t levels, const uint8_t *bytes, uint64_t size, uint8_t *masks, uint64_t count, svo_error *err)
{
    SVO_ASSERT(levels >= 1 && levels <= FMTI_MASKS_LEVELS);
    if (count == 0) return svo_fail(err, SVO_INVALID_DATA, "no masks (SVO-07)");
    scratch *s = take(p);
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to decode masks");
    coder c = {.range = UINT32_MAX, .in = bytes, .end = bytes + size};
    for (int i = 0; i < 4; i++) c.code = c.code << 8 | next_byte(&c);
    s->has_full = decode_bit(&c, HAS_FULL_P) != 0;
    s->found = 0;
    s->most = count;
    decode_levels(s, &c, levels);
    const char *why = NULL;
    if (c.beyond > BEYOND) why = "the coded masks end too early (SVO-12)";
    else if (s->found >= count) why = "more coded masks than stated (SVO-12)";
    else if (c.in != c.end) why = "bytes after the coded masks (SVO-12)";
    else if (!grids_to_masks(s, levels, masks, count)) why = "the coded masks are not as many as stated (SVO-12)";
    give(p, s, levels);
    return why != NULL ? svo_fail(err, SVO_INVALID_DATA, "%s", why) : SVO_OK;
}
