/* Classes of bricks: the class of a brick says what to expect of the next one. Found as the classes of a Markov chain
 * whose likelihood is the greatest, by moving one brick after another to where it fits best. All in integers, so that the
 * result is the same everywhere. */
#include <stdlib.h>

#include "svoi_best_encode.h"

enum { ROUNDS = 6, FRACTION = 8 /* bits of a logarithm behind the point */ };

/* log2(v) * 2^FRACTION of v >= 1, rounded down: the mantissa is squared to find bit after bit. */
static int32_t log2_fixed(uint64_t v)
{
    uint32_t whole = 63 - (uint32_t)__builtin_clzll(v);
    uint64_t m = whole > 31 ? v >> (whole - 31) : v << (31 - whole); /* [2^31, 2^32) */
    int32_t r = (int32_t)whole;
    for (int i = 0; i < FRACTION; i++) {
        m = m * m >> 31;
        r = r * 2 + (m >> 32 != 0);
        if (m >> 32 != 0) m >>= 1;
    }
    return r;
}

/* Bricks before and after each other: pairs, and for each brick where its own begin. */
typedef struct links {
    uint32_t *first; /* bricks + 3 */
    uint32_t *other;
    uint64_t count;
} links;

static bool links_make(const svo_allocator *a, links *l, const svoi_brick_pair *pair, uint64_t pairs, uint64_t bricks, bool next)
{
    l->first = svo_calloc(a, bricks + 3, sizeof *l->first);
    l->other = svo_alloc(a, pairs + 1, sizeof *l->other);
    l->count = pairs + 1;
    if (l->first == NULL || l->other == NULL) return false;
    for (uint64_t i = 0; i < pairs; i++) l->first[(next ? pair[i].before : pair[i].brick) + 2]++;
    for (uint64_t i = 2; i < bricks + 3; i++) l->first[i] += l->first[i - 1];
    for (uint64_t i = 0; i < pairs; i++) {
        uint32_t *at = &l->first[(next ? pair[i].before : pair[i].brick) + 1];
        l->other[(*at)++] = next ? pair[i].brick : pair[i].before;
    }
    return true;
}

static void links_free(const svo_allocator *a, links *l, uint64_t bricks)
{
    svo_free(a, l->first, bricks + 3, sizeof *l->first);
    svo_free(a, l->other, l->count, sizeof *l->other);
}

/* A first guess: bricks of like octants and numbers of voxels together, classes of like use. */
typedef struct keyed { uint32_t key, brick; } keyed;

static int compare_keyed(const void *a, const void *b)
{
    const keyed *x = a, *y = b;
    if (x->key != y->key) return x->key < y->key ? -1 : 1;
    return (x->brick > y->brick) - (x->brick < y->brick);
}

static bool first_guess(const svo_allocator *a, const svoi_symlevel *bricks, uint32_t classes, uint8_t *class_of)
{
    uint64_t n = 0, uses = 0, before = 0;
    keyed *k = svo_alloc(a, bricks->count + 1, sizeof *k);
    if (k == NULL) return false;
    for (uint32_t i = 0; i < bricks->count; i++) {
        if (class_of[i] == classes - 1) continue;
        uint64_t octants = svo_brick_octants(bricks->bits[i]);
        k[n++] = (keyed){(uint32_t)(octants * 0x0102040810204080u >> 56) << 7 | (uint32_t)__builtin_popcountll(bricks->bits[i]), i};
        uses += bricks->uses[i];
    }
    qsort(k, (size_t)n, sizeof *k, compare_keyed);
    for (uint64_t i = 0, c = 1; i < n; i++) {
        if (i == 0 || k[i].key != k[i - 1].key) c = 1 + before * (classes - 2) / (uses + 1);
        class_of[k[i].brick] = (uint8_t)c;
        before += bricks->uses[k[i].brick];
    }
    svo_free(a, k, bricks->count + 1, sizeof *k);
    return true;
}

typedef struct model {
    int32_t after[SVOI_CLASSES][SVOI_CLASSES];  /* [class before][class]: log likelihood */
    int32_t before[SVOI_CLASSES][SVOI_CLASSES]; /* [class after][class] */
    int32_t own[SVOI_CLASSES];                  /* of one brick in its class, a use */
} model;

static void model_make(model *m, const svoi_brick_pair *pair, uint64_t pairs, uint32_t classes, const uint8_t *class_of, uint64_t bricks)
{
    static const uint64_t some = 1; /* no pair is impossible */
    uint64_t n[SVOI_CLASSES][SVOI_CLASSES] = {{0}}, row[SVOI_CLASSES] = {0}, column[SVOI_CLASSES] = {0};
    for (uint64_t i = 0; i < pairs; i++) n[pair[i].before == bricks ? 0 : class_of[pair[i].before]][class_of[pair[i].brick]] += 16;
    for (uint32_t p = 0; p < classes; p++)
        for (uint32_t c = 0; c < classes; c++) n[p][c] += some, row[p] += n[p][c], column[c] += n[p][c];
    for (uint32_t p = 0; p < classes; p++)
        for (uint32_t c = 0; c < classes; c++) m->before[c][p] = m->after[p][c] = log2_fixed(n[p][c]) - log2_fixed(row[p]);
    for (uint32_t c = 0; c < classes; c++) m->own[c] = log2_fixed(column[c]);
}

bool svoi_best_classes(const svo_allocator *a, const svoi_symlevel *bricks, const svoi_brick_pair *pair, uint64_t pairs, uint32_t classes,
                       uint8_t *class_of)
{
    if (!first_guess(a, bricks, classes, class_of)) return false;
    if (classes < 4) return true;
    links next = {0}, previous = {0};
    model *m = svo_alloc(a, 1, sizeof *m);
    bool ok = m != NULL && links_make(a, &next, pair, pairs, bricks->count, true) && links_make(a, &previous, pair, pairs, bricks->count, false);
    for (int round = 0; round < ROUNDS && ok; round++) {
        model_make(m, pair, pairs, classes, class_of, bricks->count);
        for (uint64_t i = 0; i < bricks->count; i++) {
            if (class_of[i] == classes - 1) continue;
            int64_t score[SVOI_CLASSES];
            int64_t uses = previous.first[i + 1] - previous.first[i];
            for (uint32_t c = 0; c < SVOI_CLASSES; c++) score[c] = -uses * m->own[c < classes ? c : 0];
            for (uint32_t j = next.first[i]; j < next.first[i + 1]; j++) {
                const int32_t *row = m->before[class_of[next.other[j]]];
                for (uint32_t c = 0; c < SVOI_CLASSES; c++) score[c] += row[c];
            }
            for (uint32_t j = previous.first[i]; j < previous.first[i + 1]; j++) {
                uint32_t p = previous.other[j];
                const int32_t *row = m->after[p == bricks->count ? 0 : class_of[p]];
                for (uint32_t c = 0; c < SVOI_CLASSES; c++) score[c] += row[c];
            }
            uint32_t best = 1;
            for (uint32_t c = 2; c + 1 < classes; c++)
                if (score[c] > score[best]) best = c;
            class_of[i] = (uint8_t)best;
        }
    }
    links_free(a, &next, bricks->count);
    links_free(a, &previous, bricks->count);
    svo_free(a, m, 1, sizeof *m);
    return ok;
}
