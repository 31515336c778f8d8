/* Distinct values of attribute streams. */
#include <stdlib.h>
#include <string.h>

#include "svo_quantize.h"
#include "svo_task.h"
#include "svoi_dag.h"

/* --- distinct values --- */

static uint64_t slot_of(uint32_t value, uint64_t slot_count)
{
    return (value * 0x9e3779b97f4a7c15u) >> 20 & (slot_count - 1);
}

static void place(uint64_t *slots, uint64_t slot_count, uint32_t value, uint64_t index)
{
    uint64_t i = slot_of(value, slot_count);
    while (slots[i] != 0) i = (i + 1) & (slot_count - 1);
    slots[i] = (uint64_t)value << 32 | (index + 1);
}

static bool distinct_grow(svoi_distinct *d)
{
    uint64_t slot_count = d->slot_count != 0 ? d->slot_count * 2 : 256, capacity = slot_count / 2;
    uint64_t *slots = svo_calloc(d->a, slot_count, sizeof *slots), *times = svo_alloc(d->a, capacity, sizeof *times);
    uint32_t *value = svo_alloc(d->a, capacity, sizeof *value);
    if (slots == NULL || times == NULL || value == NULL) {
        svo_free(d->a, slots, slot_count, sizeof *slots);
        svo_free(d->a, times, capacity, sizeof *times);
        svo_free(d->a, value, capacity, sizeof *value);
        return false;
    }
    if (d->count != 0) {
        memcpy(times, d->times, (size_t)d->count * sizeof *times);
        memcpy(value, d->value, (size_t)d->count * sizeof *value);
    }
    uint64_t count = d->count;
    svoi_distinct_free(d);
    *d = (svoi_distinct){.a = d->a, .value = value, .times = times, .count = count, .capacity = capacity, .slots = slots, .slot_count = slot_count};
    for (uint64_t i = 0; i < count; i++) place(slots, slot_count, value[i], i);
    return true;
}

bool svoi_distinct_add(svoi_distinct *d, uint32_t value, uint64_t times)
{
    if (d->count == d->capacity && !distinct_grow(d)) return false; /* half of the slots at most are taken */
    uint64_t i = slot_of(value, d->slot_count);
    for (; d->slots[i] != 0; i = (i + 1) & (d->slot_count - 1)) {
        if (d->slots[i] >> 32 == value) {
            d->times[(uint32_t)d->slots[i] - 1] += times;
            return true;
        }
    }
    d->value[d->count] = value;
    d->times[d->count] = times;
    d->slots[i] = (uint64_t)value << 32 | (d->count + 1);
    d->count++;
    return true;
}

uint32_t svoi_distinct_index(const svoi_distinct *d, uint32_t value)
{
    if (d->bit != NULL) return d->before[value / 64] + (uint32_t)__builtin_popcountll(d->bit[value / 64] & (((uint64_t)1 << value % 64) - 1));
    uint64_t i = slot_of(value, d->slot_count);
    while (d->slots[i] >> 32 != value || d->slots[i] == 0) i = (i + 1) & (d->slot_count - 1);
    return (uint32_t)d->slots[i] - 1;
}

typedef struct pair { uint64_t times; uint32_t value; } pair;

static int compare_pairs(const void *a, const void *b)
{
    uint32_t x = ((const pair *)a)->value, y = ((const pair *)b)->value;
    return (x > y) - (x < y);
}

bool svoi_distinct_sort(svoi_distinct *d)
{
    if (d->count == 0) return true;
    pair *p = svo_alloc(d->a, d->count, sizeof *p);
    if (p == NULL) return false;
    for (uint64_t i = 0; i < d->count; i++) p[i] = (pair){d->times[i], d->value[i]};
    qsort(p, (size_t)d->count, sizeof *p, compare_pairs);
    memset(d->slots, 0, (size_t)d->slot_count * sizeof *d->slots);
    for (uint64_t i = 0; i < d->count; i++) {
        d->value[i] = p[i].value;
        d->times[i] = p[i].times;
        place(d->slots, d->slot_count, p[i].value, i);
    }
    svo_free(d->a, p, d->count, sizeof *p);
    return true;
}

void svoi_distinct_free(svoi_distinct *d)
{
    svo_free(d->a, d->value, d->capacity, sizeof *d->value);
    svo_free(d->a, d->times, d->capacity, sizeof *d->times);
    svoi_distinct_seal(d);
    *d = (svoi_distinct){.a = d->a};
}

void svoi_distinct_seal(svoi_distinct *d)
{
    svo_free(d->a, d->slots, d->slot_count, sizeof *d->slots);
    svo_free(d->a, d->bit, SVOI_COLORS / 64, sizeof *d->bit);
    svo_free(d->a, d->before, SVOI_COLORS / 64, sizeof *d->before);
    d->slots = d->bit = NULL;
    d->before = NULL;
    d->slot_count = 0;
}

/* Each worker gathers the distinct values of the pages it gets; the union of these sets is the same for any split. */
typedef struct gather {
    svoi_values *values;
    svoi_distinct *set;
    uint64_t most;
    uint32_t many; /* atomic: a set has more than `most` */
    svoi_mapping *mapping;                     /* NULL: values as they are */
    struct page_error { double sum, most; bool lossy; } *errors; /* of each page */
} gather;

static svo_result add_run(gather *g, svoi_distinct *d, uint32_t value, uint64_t times)
{
    if (__atomic_load_n(&g->many, __ATOMIC_RELAXED)) return SVO_OK;
    if (!svoi_distinct_add(d, value, times)) return SVO_OUT_OF_MEMORY;
    if (d->count <= g->most) return SVO_OK;
    svoi_distinct_free(d);
    __atomic_store_n(&g->many, 1, __ATOMIC_RELAXED);
    return SVO_OK;
}

/* One page; `buffer` and `mapped` have room for one. */
static svo_result gather_page(gather *g, uint64_t page, uint8_t *buffer, uint8_t *mapped, svoi_distinct *d, svo_error *err)
{
    uint32_t stride = g->values->stride;
    uint64_t first = page << SVOI_PAGE_BITS, left = g->values->count - first, n = left < SVOI_PAGE ? left : SVOI_PAGE;
    const uint8_t *p = svoi_values_get(g->values, first, n, buffer, err);
    if (p == NULL) return SVO_IO;
    struct page_error e = {0};
    for (uint64_t i = 0; i < n;) {
        uint32_t value = svoi_load_value(p + i * stride, stride), to = value;
        uint64_t end = i + 1;
        while (end < n && svoi_load_value(p + end * stride, stride) == value) end++;
        if (g->mapping != NULL) {
            to = svo_quantize_normal(value, g->mapping->bits);
            double angle = to != value ? svo_normal_degrees(value, to) : 0;
            e.sum += angle * (double)(end - i);
            e.most = angle > e.most ? angle : e.most;
            e.lossy = e.lossy || to != value;
            for (uint64_t k = i; g->mapping->write && k < end; k++) memcpy(mapped + 4 * k, &to, 4);
        }
        SVO_TRY(add_run(g, d, to, end - i));
        i = end;
    }
    if (g->mapping == NULL) return SVO_OK;
    g->errors[page] = e;
    return g->mapping->write ? svoi_values_put(g->values, page, mapped, err) : SVO_OK;
}

static svo_result gather_pages(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    gather *g = user;
    const svo_allocator *a = g->values->a;
    size_t half = (size_t)SVOI_PAGE * g->values->stride;
    uint8_t *buffer = svo_alloc(a, 2, half);
    svo_result r = buffer != NULL ? SVO_OK : SVO_OUT_OF_MEMORY;
    for (uint64_t page = begin; page < end && r == SVO_OK; page++)
        if (g->mapping != NULL || !__atomic_load_n(&g->many, __ATOMIC_RELAXED)) r = gather_page(g, page, buffer, buffer + half, &g->set[worker], err);
    svo_free(a, buffer, 2, half);
    return r;
}

enum { MAX_WORKERS = 256 };

static svo_result gather_all(gather *g, uint32_t threads, svoi_distinct *out, svo_error *err)
{
    if (threads == 0) threads = svo_processor_count();
    if (threads > MAX_WORKERS) threads = MAX_WORKERS;
    svoi_distinct set[MAX_WORKERS];
    for (uint32_t i = 0; i < threads; i++) set[i] = (svoi_distinct){.a = g->values->a};
    g->set = set;
    svo_result r = svo_parallel_for(threads, g->values->page_count, 4, gather_pages, g, err);
    for (uint32_t i = 1; i < threads; i++) {
        for (uint64_t j = 0; j < set[i].count && r == SVO_OK; j++) r = add_run(g, &set[0], set[i].value[j], set[i].times[j]);
        svoi_distinct_free(&set[i]);
    }
    if (r == SVO_OK && g->many) svoi_distinct_free(&set[0]);
    else if (r == SVO_OK && !svoi_distinct_sort(&set[0])) r = SVO_OUT_OF_MEMORY;
    if (r != SVO_OK) svoi_distinct_free(&set[0]);
    else *out = set[0];
    return r;
}

svo_result svoi_values_distinct(const svoi_values *values, uint32_t threads, uint64_t most, svoi_distinct *out, bool *many, svo_error *err)
{
    if (values->stride == 3) {
        *many = false;
        return svoi_colors_distinct(values, threads, out, err);
    }
    svoi_values same = *values; /* only read */
    gather g = {.values = &same, .most = most};
    svo_result r = gather_all(&g, threads, out, err);
    *many = g.many != 0;
    return r;
}

svo_result svoi_values_map(svoi_values *values, uint32_t threads, uint64_t most, svoi_mapping *m, svoi_distinct *out, svo_error *err)
{
    SVO_ASSERT(values->stride == 4);
    gather g = {.values = values, .most = most, .mapping = m, .errors = svo_calloc(values->a, values->page_count, sizeof *g.errors)};
    if (g.errors == NULL) return SVO_OUT_OF_MEMORY;
    svo_result r = gather_all(&g, threads, out, err);
    m->many = g.many != 0;
    m->lossy = false;
    m->error_sum = m->error_max = 0;
    uint32_t mapped = svo_quantize_normal(svoi_load_value(values->first, 4), m->bits);
    if (m->write) memcpy(values->first, &mapped, 4);
    for (uint64_t i = 0; i < values->page_count; i++) {
        m->error_sum += g.errors[i].sum;
        m->error_max = g.errors[i].most > m->error_max ? g.errors[i].most : m->error_max;
        m->lossy = m->lossy || g.errors[i].lossy;
    }
    svo_free(values->a, g.errors, values->page_count, sizeof *g.errors);
    return r;
}
