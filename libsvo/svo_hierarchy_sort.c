/* Radix sort of samples: one pass over the highest bits that differ makes buckets, and threads sort these from the lowest digit up. */
#include <string.h>

#include "svo_alloc.h"
#include "svo_hierarchy.h"
#include "svo_task.h"

enum { TOP_BITS = 11, DIGIT_BITS = 11, SMALL = 48 };

typedef struct sorting {
    svo_sample *from, *to; /* buckets are in `from`; results go to `to` */
    const uint64_t *start; /* of buckets, and the end */
    uint32_t bits;         /* below the buckets' digit */
} sorting;

static inline bool after(const svo_sample *a, const svo_sample *b) { return a->code != b->code ? a->code > b->code : a->level > b->level; }

static void insertion(svo_sample *s, uint64_t n)
{
    for (uint64_t i = 1; i < n; i++) {
        svo_sample x = s[i];
        uint64_t j = i;
        for (; j > 0 && after(&s[j - 1], &x); j--) s[j] = s[j - 1];
        s[j] = x;
    }
}

/* One pass from a to b by `digit` = code >> shift & mask, or the level. */
static void pass(const svo_sample *a, svo_sample *b, uint64_t n, uint32_t shift, uint32_t bits, bool level)
{
    uint64_t count[1 << DIGIT_BITS] = {0}, mask = ((uint64_t)1 << bits) - 1, sum = 0;
    for (uint64_t i = 0; i < n; i++) count[level ? a[i].level : a[i].code >> shift & mask]++;
    for (uint64_t d = 0; d <= mask; d++) {
        uint64_t c = count[d];
        count[d] = sum;
        sum += c;
    }
    for (uint64_t i = 0; i < n; i++) b[count[level ? a[i].level : a[i].code >> shift & mask]++] = a[i];
}

static void sort_bucket(svo_sample *from, svo_sample *to, uint64_t n, uint32_t bits)
{
    if (n <= SMALL) {
        memcpy(to, from, n * sizeof *to);
        insertion(to, n);
        return;
    }
    svo_sample *a = from, *b = to, *t;
    bool levels = false;
    for (uint64_t i = 1; i < n && !levels; i++) levels = a[i].level != a[0].level;
    if (levels) pass(a, b, n, 0, 5, true), t = a, a = b, b = t;
    for (uint32_t shift = 0; shift < bits; shift += DIGIT_BITS) {
        pass(a, b, n, shift, bits - shift < DIGIT_BITS ? bits - shift : DIGIT_BITS, false);
        t = a, a = b, b = t;
    }
    if (a != to) memcpy(to, a, n * sizeof *to);
}

static svo_result sort_buckets(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    const sorting *s = user;
    for (uint64_t i = begin; i < end; i++)
        sort_bucket(s->from + s->start[i], s->to + s->start[i], s->start[i + 1] - s->start[i], s->bits);
    return SVO_OK;
}

svo_result svo_sort_samples(svo_sample *samples, svo_sample *scratch, uint64_t count, uint32_t threads, svo_error *err)
{
    if (count < 2) return SVO_OK;
    uint64_t differ = 0;
    for (uint64_t i = 1; i < count; i++) differ |= samples[i].code ^ samples[0].code;
    uint32_t bits = differ != 0 ? 64 - (uint32_t)__builtin_clzll(differ) : 0, top = bits < TOP_BITS ? bits : TOP_BITS, shift = bits - top;
    uint64_t start[(1 << TOP_BITS) + 1] = {0}, at[1 << TOP_BITS], mask = ((uint64_t)1 << top) - 1;
    for (uint64_t i = 0; i < count; i++) start[(samples[i].code >> shift & mask) + 1]++;
    for (uint64_t d = 0; d <= mask; d++) {
        at[d] = start[d];
        start[d + 1] += start[d];
    }
    for (uint64_t i = 0; i < count; i++) scratch[at[samples[i].code >> shift & mask]++] = samples[i];
    sorting s = {scratch, samples, start, shift};
    return svo_parallel_for(threads, mask + 1, 8, sort_buckets, &s, err);
}
