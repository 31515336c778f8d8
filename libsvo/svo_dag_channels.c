/* Attribute streams: paged values, distinct values. */
#include <stdlib.h>
#include <string.h>

#include "svo_task.h"
#include "svoi_dag.h"

/* --- paged values --- */

bool svoi_values_append(svoi_values *v, const uint8_t *values, uint64_t count)
{
    while (count != 0) {
        uint64_t at = v->count & (SVOI_PAGE - 1);
        if (at == 0) {
            if (v->page_count == v->page_capacity) {
                uint64_t capacity = v->page_capacity + v->page_capacity / 2 + 8;
                uint8_t **page = svo_alloc(v->a, capacity, sizeof *page);
                if (page == NULL) return false;
                if (v->page_count != 0) memcpy(page, v->page, (size_t)v->page_count * sizeof *page);
                svo_free(v->a, v->page, v->page_capacity, sizeof *page);
                v->page = page;
                v->page_capacity = capacity;
            }
            v->page[v->page_count] = svo_alloc(v->a, SVOI_PAGE, v->stride);
            if (v->page[v->page_count] == NULL) return false;
            v->page_count++;
        }
        uint64_t n = SVOI_PAGE - at < count ? SVOI_PAGE - at : count;
        uint8_t *to = v->page[v->page_count - 1] + at * v->stride;
        if (values != NULL) {
            memcpy(to, values, (size_t)n * v->stride);
            values += n * v->stride;
        } else {
            memset(to, 0, (size_t)n * v->stride);
        }
        v->count += n;
        count -= n;
    }
    return true;
}

void svoi_values_free(svoi_values *v)
{
    for (uint64_t i = 0; i < v->page_count; i++) svo_free(v->a, v->page[i], SVOI_PAGE, v->stride);
    svo_free(v->a, v->page, v->page_capacity, sizeof *v->page);
    *v = (svoi_values){.a = v->a, .stride = v->stride};
}

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
    svo_free(d->a, d->slots, d->slot_count, sizeof *d->slots);
    *d = (svoi_distinct){.a = d->a};
}

/* Each worker gathers the distinct values of the pages it gets; the union of these sets is the same for any split. */
typedef struct gather {
    const svoi_values *values;
    svoi_distinct *set;
} gather;

static svo_result gather_pages(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    gather *g = user;
    svoi_distinct *d = &g->set[worker];
    uint32_t stride = g->values->stride;
    for (uint64_t page = begin; page < end; page++) {
        uint64_t left = g->values->count - (page << SVOI_PAGE_BITS), n = left < SVOI_PAGE ? left : SVOI_PAGE;
        const uint8_t *p = g->values->page[page];
        for (uint64_t i = 0; i < n;) {
            uint32_t value = svoi_load_value(p + i * stride, stride);
            uint64_t run = i + 1;
            while (run < n && svoi_load_value(p + run * stride, stride) == value) run++;
            if (!svoi_distinct_add(d, value, run - i)) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
            i = run;
        }
    }
    return SVO_OK;
}

enum { MAX_WORKERS = 256 };

svo_result svoi_values_distinct(const svoi_values *values, uint32_t threads, svoi_distinct *out)
{
    if (threads == 0) threads = svo_processor_count();
    if (threads > MAX_WORKERS) threads = MAX_WORKERS;
    svoi_distinct set[MAX_WORKERS];
    for (uint32_t i = 0; i < threads; i++) set[i] = (svoi_distinct){.a = values->a};
    gather g = {values, set};
    svo_result r = svo_parallel_for(threads, values->page_count, 4, gather_pages, &g, NULL);
    for (uint32_t i = 1; i < threads; i++) {
        for (uint64_t j = 0; j < set[i].count && r == SVO_OK; j++)
            if (!svoi_distinct_add(&set[0], set[i].value[j], set[i].times[j])) r = SVO_OUT_OF_MEMORY;
        svoi_distinct_free(&set[i]);
    }
    if (r == SVO_OK && !svoi_distinct_sort(&set[0])) r = SVO_OUT_OF_MEMORY;
    if (r != SVO_OK) svoi_distinct_free(&set[0]);
    else *out = set[0];
    return r;
}
