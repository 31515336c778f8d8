/* Scratch memory and linear-time sorting for libskel. */
#include "skeli_internal.h"

#include <string.h>

void *skeli_take(skeli_pool *p, uint64_t count, size_t size)
{
    SVO_ASSERT(p->count < SKELI_POOL_BLOCKS);
    if (p->count == SKELI_POOL_BLOCKS) return NULL;
    if (count == 0) count = 1;
    void *data = svo_alloc(p->allocator, count, size);
    if (data == NULL) return NULL;
    p->block[p->count].data = data;
    p->block[p->count].count = count;
    p->block[p->count++].size = size;
    return data;
}

void skeli_give(skeli_pool *p, void *data)
{
    for (uint32_t i = p->count; data != NULL && i-- > 0;) {
        if (p->block[i].data != data) continue;
        svo_free(p->allocator, data, p->block[i].count, p->block[i].size);
        p->block[i] = p->block[--p->count];
        return;
    }
}

void skeli_pool_free(skeli_pool *p)
{
    while (p->count > 0) skeli_give(p, p->block[p->count - 1].data);
}

svo_result skeli_no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while building the skeleton"); }

void skeli_sort_by64(uint32_t *order, uint32_t *scratch, uint64_t count, const uint64_t *key, uint32_t bits)
{
    enum { DIGIT = 11, BUCKETS = 1 << DIGIT };
    uint64_t start[BUCKETS];
    uint32_t *from = order, *to = scratch;
    for (uint32_t shift = 0; shift < bits; shift += DIGIT) {
        memset(start, 0, sizeof start);
        for (uint64_t i = 0; i < count; i++) start[key[order[i]] >> shift & (BUCKETS - 1)]++; /* what is sorted may be a part of what has keys */
        uint64_t sum = 0;
        bool one = false;
        for (uint32_t b = 0; b < BUCKETS; b++) {
            uint64_t n = start[b];
            one |= n == count;
            start[b] = sum;
            sum += n;
        }
        if (one) continue; /* all keys agree in this digit */
        for (uint64_t i = 0; i < count; i++) to[start[key[from[i]] >> shift & (BUCKETS - 1)]++] = from[i];
        uint32_t *t = from;
        from = to;
        to = t;
    }
    if (from != order) memcpy(order, from, count * sizeof *order);
}

/* One stable counting sort by element `by` of each tuple. */
static inline void sort_by(const uint32_t *from, uint32_t *to, uint64_t count, uint32_t width, uint32_t by, uint32_t n, uint32_t *bucket)
{
    memset(bucket, 0, ((size_t)n + 1) * sizeof *bucket);
    for (uint64_t i = 0; i < count; i++) bucket[from[i * width + by] + 1]++;
    for (uint32_t k = 0; k < n; k++) bucket[k + 1] += bucket[k];
    for (uint64_t i = 0; i < count; i++) {
        const uint32_t *t = from + i * width;
        memcpy(to + (uint64_t)bucket[t[by]]++ * width, t, width * sizeof *t);
    }
}

static inline uint64_t sort_unique(uint32_t *tuples, uint64_t count, uint32_t width, uint32_t n, uint32_t *scratch, uint32_t *bucket)
{
    if (count == 0) return 0;
    uint32_t *from = tuples, *to = scratch;
    for (uint32_t by = width; by-- > 0;) {
        sort_by(from, to, count, width, by, n, bucket);
        uint32_t *t = from;
        from = to;
        to = t;
    }
    uint64_t kept = 0;
    for (uint64_t i = 0; i < count; i++) {
        if (kept > 0 && memcmp(from + i * width, tuples + (kept - 1) * width, width * sizeof *tuples) == 0) continue;
        memmove(tuples + kept * width, from + i * width, width * sizeof *tuples);
        kept++;
    }
    return kept;
}

/* Copies and comparisons of a width that is known are single instructions. */
uint64_t skeli_sort_unique(uint32_t *tuples, uint64_t count, uint32_t width, uint32_t n, uint32_t *scratch, uint32_t *bucket)
{
    return width == 2 ? sort_unique(tuples, count, 2, n, scratch, bucket) : width == 3 ? sort_unique(tuples, count, 3, n, scratch, bucket) : sort_unique(tuples, count, width, n, scratch, bucket);
}
