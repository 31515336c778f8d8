/* Distinct colours of a stream: a bit for each of 2^24, counted by two passes over the values. */
#include "svo_task.h"
#include "svoi_dag.h"

typedef struct colors { const svoi_values *values; svoi_distinct *to; } colors;

/* Runs of the page's values: marked first (`times` NULL), then counted. Numbers only grow, so no order of threads shows. */
static svo_result visit_page(const colors *c, uint64_t page, uint8_t *buffer, uint64_t *times, svo_error *err)
{
    uint64_t first = page << SVOI_PAGE_BITS, left = c->values->count - first, n = left < SVOI_PAGE ? left : SVOI_PAGE;
    const uint8_t *p = svoi_values_get(c->values, first, n, buffer, err);
    if (p == NULL) return SVO_IO;
    for (uint64_t i = 0; i < n;) {
        uint32_t value = svoi_load_value(p + 3 * i, 3);
        uint64_t end = i + 1, *bit = &c->to->bit[value / 64], mask = (uint64_t)1 << value % 64;
        while (end < n && svoi_load_value(p + 3 * end, 3) == value) end++;
        if (times != NULL) (void)__atomic_add_fetch(&times[svoi_distinct_index(c->to, value)], end - i, __ATOMIC_RELAXED);
        else if ((__atomic_load_n(bit, __ATOMIC_RELAXED) & mask) == 0) (void)__atomic_or_fetch(bit, mask, __ATOMIC_RELAXED);
        i = end;
    }
    return SVO_OK;
}

static svo_result visit_pages(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    const colors *c = user;
    uint8_t *buffer = svo_alloc(c->values->a, SVOI_PAGE, 3);
    svo_result r = buffer != NULL ? SVO_OK : SVO_OUT_OF_MEMORY;
    for (uint64_t page = begin; page < end && r == SVO_OK; page++) r = visit_page(c, page, buffer, c->to->times, err);
    svo_free(c->values->a, buffer, SVOI_PAGE, 3);
    return r;
}

static bool take_bits(svoi_distinct *d)
{
    d->bit = svo_calloc(d->a, SVOI_COLORS / 64, sizeof *d->bit);
    d->before = svo_alloc(d->a, SVOI_COLORS / 64, sizeof *d->before);
    return d->bit != NULL && d->before != NULL;
}

static uint64_t count_marked(svoi_distinct *d)
{
    uint64_t count = 0;
    for (uint32_t w = 0; w < SVOI_COLORS / 64; w++) {
        d->before[w] = (uint32_t)count;
        count += (uint32_t)__builtin_popcountll(d->bit[w]);
    }
    return count;
}

bool svoi_colors_reopen(svoi_distinct *d)
{
    if (!take_bits(d)) return false;
    for (uint64_t i = 0; i < d->count; i++) d->bit[d->value[i] / 64] |= (uint64_t)1 << d->value[i] % 64;
    count_marked(d);
    return true;
}

/* Places of the marked colours, and room for their numbers. */
static bool list_marked(svoi_distinct *d)
{
    d->capacity = d->count = count_marked(d);
    d->value = svo_alloc(d->a, d->count, sizeof *d->value);
    d->times = svo_calloc(d->a, d->count, sizeof *d->times);
    if (d->value == NULL || d->times == NULL) return false;
    uint64_t n = 0;
    for (uint32_t w = 0; w < SVOI_COLORS / 64; w++)
        for (uint64_t m = d->bit[w]; m != 0; m &= m - 1) d->value[n++] = 64 * w + (uint32_t)__builtin_ctzll(m);
    return true;
}

svo_result svoi_colors_distinct(const svoi_values *values, uint32_t threads, svoi_distinct *out, svo_error *err)
{
    svoi_distinct d = {.a = values->a};
    colors c = {values, &d};
    svo_result r = take_bits(&d) ? svo_parallel_for(threads, values->page_count, 4, visit_pages, &c, err) : SVO_OUT_OF_MEMORY;
    if (r == SVO_OK && !list_marked(&d)) r = SVO_OUT_OF_MEMORY;
    if (r == SVO_OK) r = svo_parallel_for(threads, values->page_count, 4, visit_pages, &c, err);
    if (r != SVO_OK) svoi_distinct_free(&d);
    else *out = d;
    return r;
}
