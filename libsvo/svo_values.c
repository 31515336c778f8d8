/* Attribute streams as pages: in memory, or compressed unit by unit in a temporary file. */
#include <string.h>

#include "svoi_dag.h"

enum { READ_UNITS = 8 }; /* units read at a time */

/* One that was set after its page had gone to the file. */
typedef struct late_value {
    uint64_t index;
    uint32_t next; /* of the same page, as in svoi_page.late */
    uint8_t value[4];
} late_value;

static uint64_t page_bytes(const svoi_values *v) { return (uint64_t)SVOI_PAGE * v->stride; }

/* Bytes of a unit as they are; 0 beyond the last value. */
static uint32_t unit_bytes(const svoi_values *v, uint64_t page, uint32_t unit)
{
    const uint64_t first = (page << SVOI_PAGE_BITS) + (uint64_t)unit * SVO_SUPERBLOCK, left = v->count > first ? v->count - first : 0;
    return (uint32_t)(left < SVO_SUPERBLOCK ? left : SVO_SUPERBLOCK) * v->stride;
}

static void forget_page(svoi_values *v, svoi_page *page)
{
    if (page->data == NULL) return;
    svo_free(v->a, page->data, SVOI_PAGE, v->stride);
    page->data = NULL;
    if (v->store != NULL) v->store->resident -= page_bytes(v);
}

/* Compresses the units of a page in its own memory. Returns its bytes. */
static uint32_t compress_page(const svoi_values *v, uint64_t page, uint8_t *data, uint16_t *size)
{
    const svo_spill *spill = v->store->spill;
    uint32_t to = 0;
    for (uint32_t u = 0; u < SVOI_PAGE_UNITS; u++) {
        uint8_t *from = data + (size_t)u * SVO_SUPERBLOCK * v->stride, packed[4 * SVO_SUPERBLOCK];
        const uint32_t bytes = unit_bytes(v, page, u);
        const uint32_t n = bytes > 1 && spill->compress != NULL ? spill->compress(spill->user, from, bytes, packed, bytes - 1) : 0;
        if (n != 0) memcpy(data + to, packed, n);
        else memmove(data + to, from, bytes);
        size[u] = (uint16_t)(n != 0 ? n : bytes);
        to += size[u];
    }
    return to;
}

static svo_result write_page(svoi_values *v, uint64_t page, uint8_t *data, svo_error *err)
{
    svoi_page *p = &v->page[page];
    const uint32_t bytes = compress_page(v, page, data, p->size);
    p->offset = __atomic_fetch_add(&v->file_bytes, bytes, __ATOMIC_RELAXED);
    return svo_spill_write(&v->file, p->offset, data, bytes, err);
}

static uint32_t bytes_before(const svoi_page *p, uint32_t unit)
{
    uint32_t sum = 0;
    for (uint32_t u = 0; u < unit; u++) sum += p->size[u];
    return sum;
}

static svo_result spill_page(svoi_values *v, uint64_t page, svo_error *err)
{
    svoi_page *p = &v->page[page];
    if (p->data == NULL) return SVO_OK;
    if (v->file.spill == NULL) SVO_TRY(svo_spill_open(v->store->spill, &v->file, err));
    SVO_TRY(write_page(v, page, p->data, err));
    forget_page(v, p);
    return SVO_OK;
}

svo_result svoi_values_spill(svoi_values *v, svo_error *err)
{
    if (v->store == NULL || v->store->spill == NULL) return SVO_OK;
    for (uint64_t i = 0; i < v->page_count; i++) SVO_TRY(spill_page(v, i, err));
    return SVO_OK;
}

static svo_result add_page(svoi_values *v, svo_error *err)
{
    if (v->page_count == v->page_capacity) {
        uint64_t capacity = v->page_capacity + v->page_capacity / 2 + 8;
        svoi_page *page = svo_alloc(v->a, capacity, sizeof *page);
        if (page == NULL) return SVO_OUT_OF_MEMORY;
        if (v->page_count != 0) memcpy(page, v->page, (size_t)v->page_count * sizeof *page);
        svo_free(v->a, v->page, v->page_capacity, sizeof *page);
        v->page = page;
        v->page_capacity = capacity;
    }
    bool can_spill = v->store != NULL && v->store->spill != NULL;
    if (can_spill && v->page_count != 0 && v->store->resident + page_bytes(v) > v->store->budget) SVO_TRY(spill_page(v, v->page_count - 1, err));
    uint8_t *data = svo_alloc(v->a, SVOI_PAGE, v->stride);
    if (data == NULL && can_spill) { /* others need memory as well: give all of it back */
        SVO_TRY(svoi_values_spill(v, err));
        data = svo_alloc(v->a, SVOI_PAGE, v->stride);
    }
    if (data == NULL) return SVO_OUT_OF_MEMORY;
    v->page[v->page_count++] = (svoi_page){.data = data};
    if (v->store != NULL) v->store->resident += page_bytes(v);
    return SVO_OK;
}

static void look_at(svoi_values *v, const uint8_t *values, uint64_t count)
{
    if (!v->any) memcpy(v->first, values, v->stride);
    v->any = true;
    for (uint64_t i = 0; i < count && !v->varies; i++) v->varies = memcmp(values + i * v->stride, v->first, v->stride) != 0;
}

svo_result svoi_values_append(svoi_values *v, const uint8_t *values, uint64_t count, svo_error *err)
{
    if (values != NULL && count != 0) look_at(v, values, count);
    while (count != 0) {
        uint64_t at = v->count & (SVOI_PAGE - 1);
        if (at == 0) SVO_TRY(add_page(v, err));
        uint64_t n = SVOI_PAGE - at < count ? SVOI_PAGE - at : count;
        uint8_t *to = v->page[v->page_count - 1].data + at * v->stride;
        if (values != NULL) {
            memcpy(to, values, (size_t)n * v->stride);
            values += n * v->stride;
        } else {
            memset(to, 0, (size_t)n * v->stride);
        }
        v->count += n;
        count -= n;
    }
    return SVO_OK;
}

static svo_result set_late(svoi_values *v, uint64_t i, const uint8_t *value)
{
    svoi_page *p = &v->page[i >> SVOI_PAGE_BITS];
    late_value *late = (late_value *)v->late.data;
    for (uint32_t k = p->late; k != 0; k = late[k - 1].next)
        if (late[k - 1].index == i) {
            memcpy(late[k - 1].value, value, v->stride);
            return SVO_OK;
        }
    if (v->late.data == NULL) svo_buffer_init(&v->late, v->a);
    late_value l = {.index = i, .next = p->late};
    memcpy(l.value, value, v->stride);
    if (v->late.size / sizeof l == UINT32_MAX || svo_buffer_append(&v->late, &l, sizeof l) == NULL) return SVO_OUT_OF_MEMORY;
    p->late = (uint32_t)(v->late.size / sizeof l);
    return SVO_OK;
}

svo_result svoi_values_set(svoi_values *v, uint64_t i, const uint8_t *value)
{
    look_at(v, value, 1);
    uint8_t *data = v->page[i >> SVOI_PAGE_BITS].data;
    if (data == NULL) return set_late(v, i, value);
    memcpy(data + (i & (SVOI_PAGE - 1)) * v->stride, value, v->stride);
    return SVO_OK;
}

static svo_result decode_unit(const svoi_values *v, uint64_t page, uint32_t unit, const uint8_t *packed, uint8_t *to, svo_error *err)
{
    const uint32_t bytes = unit_bytes(v, page, unit), n = v->page[page].size[unit];
    if (n == bytes) memcpy(to, packed, bytes);
    else return v->store->spill->decompress(v->store->spill->user, packed, n, to, bytes, err);
    return SVO_OK;
}

/* `n` values from number `at` of the page on, all of them in units `begin` .. `end` - 1, to their place in `buffer`, where value `first` of the page is the first. */
static svo_result read_units(const svoi_values *v, uint64_t page, uint32_t begin, uint32_t end, uint32_t first, uint32_t n, uint8_t *buffer, svo_error *err)
{
    const svoi_page *p = &v->page[page];
    const uint32_t before = bytes_before(p, begin);
    uint8_t packed[READ_UNITS * 4 * SVO_SUPERBLOCK];
    SVO_TRY(svo_spill_read(&v->file, p->offset + before, packed, bytes_before(p, end) - before, err));
    const uint8_t *from = packed;
    for (uint32_t u = begin; u < end; from += p->size[u++]) {
        const uint32_t start = u * SVO_SUPERBLOCK, stop = start + unit_bytes(v, page, u) / v->stride;
        const uint32_t low = start > first ? start : first, high = stop < first + n ? stop : first + n;
        uint8_t *to = buffer + (size_t)(low - first) * v->stride, whole[4 * SVO_SUPERBLOCK];
        if (low == start && high == stop) {
            SVO_TRY(decode_unit(v, page, u, from, to, err));
        } else {
            SVO_TRY(decode_unit(v, page, u, from, whole, err));
            memcpy(to, whole + (size_t)(low - start) * v->stride, (size_t)(high - low) * v->stride);
        }
    }
    return SVO_OK;
}

const uint8_t *svoi_values_get(const svoi_values *v, uint64_t first, uint64_t n, uint8_t *buffer, svo_error *err)
{
    const uint64_t page = first >> SVOI_PAGE_BITS;
    const svoi_page *p = &v->page[page];
    const uint32_t at = (uint32_t)(first & (SVOI_PAGE - 1)), end = (uint32_t)((at + n + SVO_SUPERBLOCK - 1) / SVO_SUPERBLOCK);
    SVO_ASSERT(n <= SVOI_PAGE - at && first + n <= v->count);
    if (p->data != NULL) return p->data + (size_t)at * v->stride;
    for (uint32_t u = at / SVO_SUPERBLOCK; u < end; u += READ_UNITS)
        if (read_units(v, page, u, end - u < READ_UNITS ? end : u + READ_UNITS, at, (uint32_t)n, buffer, err) != SVO_OK) return NULL;
    const late_value *late = (const late_value *)v->late.data;
    for (uint32_t k = p->late; k != 0; k = late[k - 1].next) {
        const late_value *l = &late[k - 1];
        if (l->index >= first && l->index - first < n) memcpy(buffer + (l->index - first) * v->stride, l->value, v->stride);
    }
    return buffer;
}

svo_result svoi_values_put(svoi_values *v, uint64_t page, uint8_t *values, svo_error *err)
{
    svoi_page *p = &v->page[page];
    const uint64_t first = page << SVOI_PAGE_BITS, left = v->count - first, n = left < SVOI_PAGE ? left : SVOI_PAGE;
    if (p->data != NULL) {
        memcpy(p->data, values, (size_t)n * v->stride);
        return SVO_OK;
    }
    svo_spill_discard(&v->file, p->offset, bytes_before(p, SVOI_PAGE_UNITS));
    p->late = 0;
    return write_page(v, page, values, err);
}

void svoi_values_drop(svoi_values *v, uint64_t page)
{
    svoi_page *p = &v->page[page];
    if (p->data != NULL) forget_page(v, p);
    else svo_spill_discard(&v->file, p->offset, bytes_before(p, SVOI_PAGE_UNITS));
}

void svoi_values_free(svoi_values *v)
{
    for (uint64_t i = 0; i < v->page_count; i++) forget_page(v, &v->page[i]);
    svo_free(v->a, v->page, v->page_capacity, sizeof *v->page);
    svo_buffer_free(&v->late);
    svo_spill_close(&v->file);
    *v = (svoi_values){.a = v->a, .stride = v->stride, .store = v->store};
}
