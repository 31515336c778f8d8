#include "svoi_sorted.h"

enum { DIGIT = 11, PASSES = SVOI_SORT_BITS / DIGIT, LEAST_RUN = 4096, MOST_STRIDE = 64 };

static svo_result no_memory(uint64_t count, svo_error *err)
{
    return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to sort %llu triangles or edges", (unsigned long long)count);
}

svo_result svoi_store_create(const svoi_room *room, uint64_t count, uint32_t stride, svoi_store *out, svo_error *err)
{
    *out = (svoi_store){.allocator = room->allocator, .capacity = count, .stride = stride};
    if (count == 0) return SVO_OK;
    if (room->pager != NULL) {
        size_t bytes;
        if (!svo_mul_size(count, stride, &bytes)) return no_memory(count, err);
        SVO_TRY(svo_paged_create(room->pager, bytes, &out->paged, err));
        out->data = out->paged->data;
        return SVO_OK;
    }
    out->data = svo_calloc(room->allocator, count, stride);
    return out->data != NULL ? SVO_OK : no_memory(count, err);
}

void svoi_store_free(svoi_store *s)
{
    if (s->paged != NULL) svo_paged_free(s->paged);
    else svo_free(s->allocator, s->data, s->capacity, s->stride);
    *s = (svoi_store){0};
}

/* --- a run -------------------------------------------------------------------------------------------------------- */

typedef struct scratch { uint64_t *keys; uint32_t *order, *other; } scratch;

static inline bool before(const svoi_sorter *s, const scratch *c, uint32_t a, uint32_t b)
{
    if (c->keys[a] != c->keys[b]) return c->keys[a] < c->keys[b];
    return s->order.compare(s->run + (uint64_t)a * s->stride, s->run + (uint64_t)b * s->stride) < 0;
}

/* Records begin .. end of `order` have one key: order them by what compare says. A heap, so that 100,000 of them take no square of time. */
static void sort_equal(const svoi_sorter *s, const scratch *c, uint64_t begin, uint64_t end)
{
    uint32_t *o = c->order + begin;
    const uint64_t n = end - begin;
    if (n < 16) {
        for (uint64_t i = 1; i < n; i++) {
            const uint32_t x = o[i];
            uint64_t k = i;
            for (; k > 0 && before(s, c, x, o[k - 1]); k--) o[k] = o[k - 1];
            o[k] = x;
        }
        return;
    }
    for (uint64_t start = n / 2, last = n; last > 1;) {
        uint32_t x;
        uint64_t at;
        if (start > 0) {
            at = --start;
            x = o[at];
        } else {
            x = o[--last];
            o[last] = o[0];
            at = 0;
        }
        for (uint64_t child; (child = 2 * at + 1) < last; at = child) {
            if (child + 1 < last && before(s, c, o[child], o[child + 1])) child++;
            if (!before(s, c, x, o[child])) break;
            o[at] = o[child];
        }
        o[at] = x;
    }
}

static void radix(const svoi_sorter *s, scratch *c, uint64_t *start)
{
    const uint64_t n = s->count;
    for (uint32_t pass = 0; pass < PASSES; pass++) {
        const uint32_t shift = pass * DIGIT;
        memset(start, 0, sizeof *start << DIGIT);
        for (uint64_t i = 0; i < n; i++) start[c->keys[i] >> shift & ((1u << DIGIT) - 1)]++;
        uint64_t total = 0;
        for (uint32_t d = 0; d < 1u << DIGIT; d++) {
            const uint64_t here = start[d];
            start[d] = total;
            total += here;
        }
        for (uint64_t i = 0; i < n; i++) c->other[start[c->keys[c->order[i]] >> shift & ((1u << DIGIT) - 1)]++] = c->order[i];
        uint32_t *swap = c->order;
        c->order = c->other;
        c->other = swap;
    }
}

/* Bring the run's records into order, in place. */
static svo_result sort_run(svoi_sorter *s, svo_error *err)
{
    const svo_allocator *a = s->room->allocator;
    const uint64_t n = s->count;
    if (n < 2) return SVO_OK;
    scratch c = {svo_alloc(a, n, sizeof *c.keys), svo_alloc(a, n, sizeof *c.order), svo_alloc(a, n, sizeof *c.other)};
    uint64_t *start = svo_alloc(a, (uint64_t)1 << DIGIT, sizeof *start);
    const bool ok = c.keys != NULL && c.order != NULL && c.other != NULL && start != NULL;
    if (ok) {
        for (uint64_t i = 0; i < n; i++) c.keys[i] = s->order.key(s->run + i * s->stride, s->order.user), c.order[i] = (uint32_t)i;
        radix(s, &c, start);
        for (uint64_t i = 0; i < n;) {
            uint64_t end = i + 1;
            while (end < n && c.keys[c.order[end]] == c.keys[c.order[i]]) end++;
            if (end - i > 1) sort_equal(s, &c, i, end);
            i = end;
        }
        for (uint64_t i = 0; i < n; i++) { /* along the cycles of the permutation */
            uint8_t kept[MOST_STRIDE];
            if (c.order[i] == i) continue;
            memcpy(kept, s->run + i * s->stride, s->stride);
            uint64_t at = i;
            while (c.order[at] != i) {
                const uint64_t from = c.order[at];
                memcpy(s->run + at * s->stride, s->run + from * s->stride, s->stride);
                c.order[at] = (uint32_t)at;
                at = from;
            }
            memcpy(s->run + at * s->stride, kept, s->stride);
            c.order[at] = (uint32_t)at;
        }
    }
    svo_free(a, c.keys, n, sizeof *c.keys);
    svo_free(a, c.order, n, sizeof *c.order);
    svo_free(a, c.other, n, sizeof *c.other);
    svo_free(a, start, (uint64_t)1 << DIGIT, sizeof *start);
    return ok ? SVO_OK : no_memory(n, err);
}

/* --- runs --------------------------------------------------------------------------------------------------------- */

svo_result svoi_sorter_begin(svoi_sorter *s, const svoi_room *room, const svoi_order *order, uint32_t stride, uint64_t total, svo_error *err)
{
    SVO_ASSERT(stride <= MOST_STRIDE);
    *s = (svoi_sorter){.room = room, .order = *order, .stride = stride, .total = total, .capacity = total};
    svo_buffer_init(&s->runs, room->allocator);
    if (room->pager != NULL) {
        uint64_t most = room->run_bytes / (stride + 2 * sizeof(uint64_t));
        if (most < LEAST_RUN) most = LEAST_RUN;
        if (s->capacity > most) s->capacity = most;
    }
    if (s->capacity > UINT32_MAX) return svo_fail(err, SVO_LIMIT, "more than 4294967295 triangles or edges cannot be sorted in memory; give --memory so that they are sorted in parts");
    if (total == 0) return SVO_OK;
    s->run = svo_alloc(room->allocator, s->capacity, stride);
    return s->run != NULL ? SVO_OK : no_memory(s->capacity, err);
}

void svoi_sorter_drop(svoi_sorter *s)
{
    if (s->room == NULL) return;
    svo_free(s->room->allocator, s->run, s->capacity, s->stride);
    svo_buffer_free(&s->runs);
    svoi_store_free(&s->written);
    *s = (svoi_sorter){0};
}

static svo_result write_run(svoi_sorter *s, svo_error *err)
{
    if (s->count == 0) return SVO_OK;
    SVO_TRY(sort_run(s, err));
    if (s->written.data == NULL) SVO_TRY(svoi_store_create(s->room, s->total, s->stride, &s->written, err));
    SVO_ASSERT(s->written_count + s->count <= s->total);
    for (uint64_t i = 0; i < s->count; i++) memcpy(svoi_at(&s->written, s->written_count + i), s->run + i * s->stride, s->stride);
    s->written_count += s->count;
    s->count = 0;
    return svo_buffer_append(&s->runs, &s->written_count, sizeof s->written_count) != NULL ? SVO_OK : no_memory(s->total, err);
}

svo_result svoi_sorter_reserve(svoi_sorter *s, svo_error *err)
{
    if (s->count < s->capacity) return SVO_OK;
    SVO_ASSERT(s->room->pager != NULL); /* else there is room for all */
    return write_run(s, err);
}

/* The next record of a run. */
typedef struct head {
    uint64_t key, at, end;
    uint8_t record[MOST_STRIDE];
} head;

static bool read_head(const svoi_sorter *s, head *h)
{
    if (h->at == h->end) return false;
    memcpy(h->record, svoi_at(&s->written, h->at++), s->stride);
    h->key = s->order.key(h->record, s->order.user);
    return true;
}

static bool head_before(const svoi_sorter *s, const head *a, const head *b)
{
    return a->key != b->key ? a->key < b->key : s->order.compare(a->record, b->record) < 0;
}

static void sift(const svoi_sorter *s, head **heap, uint64_t n, uint64_t at)
{
    head *x = heap[at];
    for (uint64_t child; (child = 2 * at + 1) < n; at = child) {
        if (child + 1 < n && head_before(s, heap[child + 1], heap[child])) child++;
        if (!head_before(s, heap[child], x)) break;
        heap[at] = heap[child];
    }
    heap[at] = x;
}

static svo_result merge(svoi_sorter *s, svoi_store *out, svo_error *err)
{
    const svo_allocator *a = s->room->allocator;
    const uint64_t *ends = (const uint64_t *)(const void *)s->runs.data, runs = s->runs.size / sizeof *ends;
    head *heads = svo_calloc(a, runs, sizeof *heads), **heap = svo_alloc(a, runs, sizeof *heap);
    svo_result r = heads != NULL && heap != NULL ? svoi_store_create(s->room, s->written_count, s->stride, out, err) : no_memory(s->written_count, err);
    uint64_t n = 0;
    for (uint64_t i = 0; r == SVO_OK && i < runs; i++) {
        heads[i].at = i == 0 ? 0 : ends[i - 1];
        heads[i].end = ends[i];
        if (read_head(s, &heads[i])) heap[n++] = &heads[i];
    }
    for (uint64_t i = n / 2; r == SVO_OK && i-- > 0;) sift(s, heap, n, i);
    for (uint64_t i = 0; r == SVO_OK && n != 0; i++) {
        memcpy(svoi_at(out, i), heap[0]->record, s->stride);
        if (!read_head(s, heap[0])) heap[0] = heap[--n];
        if (n != 0) sift(s, heap, n, 0);
    }
    svo_free(a, heads, runs, sizeof *heads);
    svo_free(a, heap, runs, sizeof *heap);
    return r;
}

svo_result svoi_sorter_end(svoi_sorter *s, svoi_store *out, uint64_t *count, svo_error *err)
{
    svo_result r;
    *out = (svoi_store){0};
    *count = 0;
    if (s->room->pager == NULL) {
        r = sort_run(s, err);
        if (r == SVO_OK && s->run != NULL) {
            *out = (svoi_store){.allocator = s->room->allocator, .data = s->run, .capacity = s->capacity, .stride = s->stride};
            *count = s->count;
            s->run = NULL;
        }
    } else {
        r = write_run(s, err);
        svo_free(s->room->allocator, s->run, s->capacity, s->stride);
        s->run = NULL;
        const uint64_t written = s->written_count;
        if (r == SVO_OK && s->runs.size == sizeof(uint64_t)) {
            *out = s->written;
            s->written = (svoi_store){0};
        } else if (r == SVO_OK && written != 0) {
            r = merge(s, out, err);
        }
        if (r == SVO_OK) *count = written;
        else svoi_store_free(out);
    }
    svoi_sorter_drop(s);
    return r;
}
