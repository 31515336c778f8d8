/* Attribute streams: paged values, distinct values, and packing a channel as a constant, raw, or palette blocks. */
#include <stdlib.h>
#include <string.h>

#include "svo_palette.h"
#include "svo_quantize.h"
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

static svo_result distinct_values(const svoi_values *values, uint32_t threads, svoi_distinct *out)
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

/* --- packing --- */

typedef struct source {
    const svoi_values *values;
    const svoi_distinct *distinct;
    const uint32_t *index; /* of a distinct value in the table; NULL: its own number */
} source;

static void give_indices(void *user, uint64_t first, uint32_t n, uint32_t *indices)
{
    const source *s = user;
    uint32_t stride = s->values->stride, last = 0, last_index = 0;
    const uint8_t *p = svoi_values_at(s->values, first); /* superblocks do not straddle pages */
    for (uint32_t i = 0; i < n; i++, p += stride) {
        uint32_t value = svoi_load_value(p, stride);
        if (i == 0 || value != last) {
            last = value;
            last_index = svoi_distinct_index(s->distinct, value);
            if (s->index != NULL) last_index = s->index[last_index];
        }
        indices[i] = last_index;
    }
}

static void make_constant(svo_packed *p, uint32_t channel, uint32_t value, svo_dag_channel_report *report)
{
    svo_view_channel *c = &p->view.channels[channel];
    c->encoding = SVO_ENCODING_CONSTANT;
    c->channel.constant = true;
    memset(c->channel.value, 0, sizeof c->channel.value);
    svoi_store_value(c->channel.value, svo_channel_stride(c->channel.kind), value);
    report->left_out = true;
    report->bytes = 0;
}

/* Distinct values that survive quantisation, ascending, as the table; index[i] is where distinct value i went. */
static svo_result make_table(svo_packed *p, uint32_t channel, const uint32_t *mapped, uint64_t count, uint32_t *index,
                             uint64_t *table_count, svo_error *err)
{
    svoi_distinct kept = {.a = &p->memory.base};
    svo_buffer *table = &p->table[channel];
    uint32_t stride = svo_channel_stride(p->view.channels[channel].channel.kind);
    bool ok = true;
    for (uint64_t i = 0; i < count && ok; i++) ok = svoi_distinct_add(&kept, mapped[i], 1);
    ok = ok && svoi_distinct_sort(&kept) && svo_buffer_reserve(table, (size_t)kept.count * stride);
    if (ok) {
        for (uint64_t i = 0; i < kept.count; i++) svoi_store_value(table->data + i * stride, stride, kept.value[i]);
        table->size = (size_t)kept.count * stride;
        for (uint64_t i = 0; i < count; i++) index[i] = svoi_distinct_index(&kept, mapped[i]);
        *table_count = kept.count;
    }
    svoi_distinct_free(&kept);
    return ok ? SVO_OK : svoi_no_memory(p, "quantisation", err);
}

/* Copy as they are, after mapping; the pages are given back on the way. */
static svo_result pack_raw(svo_packed *p, uint32_t channel, svoi_values *values, const svoi_distinct *distinct,
                           const uint32_t *mapped, svo_error *err)
{
    svo_buffer *raw = &p->raw[channel];
    uint32_t stride = values->stride;
    if (!svo_buffer_reserve(raw, (size_t)values->count * stride)) return svoi_no_memory(p, "attributes", err);
    for (uint64_t page = 0; page < values->page_count; page++) {
        uint64_t left = values->count - (page << SVOI_PAGE_BITS), n = left < SVOI_PAGE ? left : SVOI_PAGE;
        uint8_t *from = values->page[page];
        if (mapped != NULL)
            for (uint64_t i = 0; i < n; i++)
                svoi_store_value(from + i * stride, stride, mapped[svoi_distinct_index(distinct, svoi_load_value(from + i * stride, stride))]);
        svo_buffer_append(raw, from, (size_t)n * stride);
        svo_free(values->a, from, SVOI_PAGE, stride);
        values->page[page] = NULL;
    }
    p->view.channels[channel].encoding = SVO_ENCODING_RAW;
    p->view.channels[channel].raw = raw->data;
    return SVO_OK;
}

static svo_result pack_blocks(svo_packed *p, uint32_t channel, const source *s, uint64_t table_count, uint32_t threads, svo_error *err)
{
    svo_view_channel *c = &p->view.channels[channel];
    svo_buffer *directory = &p->directory[channel], *payload = &p->payload[channel], *table = &p->table[channel];
    svo_result r = svo_palette_encode(s->values->count, table_count, give_indices, (void *)(uintptr_t)s, threads, directory, payload, NULL, err);
    if (r == SVO_OUT_OF_MEMORY) return svoi_no_memory(p, "attributes", err);
    if (r != SVO_OK) return r;
    c->encoding = SVO_ENCODING_BLOCKS;
    c->table = table->data;
    c->table_count = table_count;
    c->directory = (const uint64_t *)(const void *)directory->data;
    c->superblock_count = directory->size / 8;
    c->payload = payload->data;
    c->payload_size = payload->size;
    return SVO_OK;
}

static svo_result pack_distinct(svo_packed *p, uint32_t channel, svoi_values *values, const svoi_distinct *d, uint32_t *mapped,
                                uint32_t *index, const svo_dag_options *options, svo_dag_channel_report *report, svo_error *err)
{
    svo_view_channel *c = &p->view.channels[channel];
    for (uint64_t i = 0; i < d->count; i++) mapped[i] = d->value[i];
    svo_quantize_result q = {0};
    svo_result r = svo_quantize(c->channel.kind, d->value, d->times, d->count, options, &p->memory.base, mapped, &q, err);
    if (r == SVO_OUT_OF_MEMORY) return svoi_no_memory(p, "quantisation", err);
    if (r != SVO_OK) return r;
    report->error_mean = q.error_mean;
    report->error_max = q.error_max;
    uint64_t table_count = 0;
    SVO_TRY(make_table(p, channel, mapped, d->count, index, &table_count, err));
    report->distinct_out = table_count;
    if (table_count == 1) {
        make_constant(p, channel, mapped[0], report);
        svo_buffer_free(&p->table[channel]);
        return SVO_OK;
    }
    source s = {values, d, index};
    SVO_TRY(pack_blocks(p, channel, &s, table_count, options->threads, err));
    report->bytes = p->table[channel].size + p->directory[channel].size + p->payload[channel].size;
    uint64_t raw = values->count * values->stride;
    if (report->bytes < raw) return SVO_OK;
    svo_buffer_free(&p->table[channel]);
    svo_buffer_free(&p->directory[channel]);
    svo_buffer_free(&p->payload[channel]);
    c->table = c->payload = NULL;
    c->directory = NULL;
    c->table_count = c->superblock_count = c->payload_size = 0;
    report->bytes = raw;
    return pack_raw(p, channel, values, d, q.lossy ? mapped : NULL, err);
}

svo_result svoi_pack_channel(svo_packed *p, uint32_t channel, svoi_values *values, const svo_dag_options *options,
                             svo_dag_channel_report *report, svo_error *err)
{
    const svo_allocator *a = &p->memory.base;
    svo_view_channel *c = &p->view.channels[channel];
    svo_buffer *parts[] = {&p->raw[channel], &p->table[channel], &p->directory[channel], &p->payload[channel]};
    for (int i = 0; i < 4; i++) svo_buffer_init(parts[i], a);
    if (c->channel.constant || values->count == 0) { /* an empty octree has no values at all */
        report->distinct_in = report->distinct_out = c->channel.constant ? 1 : 0;
        make_constant(p, channel, svoi_load_value(c->channel.value, svo_channel_stride(c->channel.kind)), report);
        return SVO_OK;
    }
    svoi_distinct d = {.a = a};
    if (distinct_values(values, options->threads, &d) != SVO_OK) return svoi_no_memory(p, "attributes", err);
    report->distinct_in = d.count;
    uint32_t *mapped = svo_alloc(a, d.count, sizeof *mapped), *index = svo_alloc(a, d.count, sizeof *index);
    svo_result r = mapped == NULL || index == NULL ? svoi_no_memory(p, "attributes", err)
                                                   : pack_distinct(p, channel, values, &d, mapped, index, options, report, err);
    svo_free(a, mapped, d.count, sizeof *mapped);
    svo_free(a, index, d.count, sizeof *index);
    svoi_distinct_free(&d);
    svoi_values_free(values);
    return r;
}
