#include "svo_pager.h"

#include <pthread.h>
#include <string.h>

enum { MAP_ALIGN = 1 << SVO_PAGE_SHIFT };

struct svo_pager {
    const svo_allocator *allocator;
    const svo_spill *spill;
    svo_spill_file file;
    uint64_t most, resident; /* pieces; resident is atomic and counts touches since the last time that all were dropped */
    uint64_t keep, budget;   /* bytes; budget: size of the charge */
    void *charge;            /* never touched, so it takes nothing but its place in the allocator's account */
    pthread_mutex_t lock;    /* of the list, the file's size and the charge */
    svo_paged *list;
};

svo_result svo_pager_create(const svo_spill *spill, uint64_t resident, uint64_t keep, const svo_allocator *a, svo_pager **out, svo_error *err)
{
    SVO_ASSERT(spill->map != NULL);
    svo_pager *p = svo_calloc(a, 1, sizeof *p);
    if (p == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    p->allocator = a;
    p->spill = spill;
    p->most = resident >> SVO_PAGE_SHIFT;
    if (p->most < 16) p->most = 16;
    p->budget = p->most << SVO_PAGE_SHIFT;
    p->keep = keep;
    pthread_mutex_init(&p->lock, NULL);
    *out = p;
    return SVO_OK;
}

void svo_pager_free(svo_pager *p)
{
    if (p == NULL) return;
    SVO_ASSERT(p->list == NULL);
    svo_spill_close(&p->file);
    svo_free(p->allocator, p->charge, p->budget, 1);
    pthread_mutex_destroy(&p->lock);
    svo_free(p->allocator, p, 1, sizeof *p);
}

bool svo_pager_keeps(svo_pager *p, uint64_t bytes)
{
    pthread_mutex_lock(&p->lock);
    bool keeps = bytes <= p->keep;
    if (keeps) p->keep -= bytes;
    pthread_mutex_unlock(&p->lock);
    return keeps;
}

/* Under the lock. First the marks, then the pages: what is touched in between counts though it may go at once. */
static void drop_all(svo_pager *p)
{
    __atomic_store_n(&p->resident, 0, __ATOMIC_RELAXED);
    for (svo_paged *a = p->list; a != NULL; a = a->next) {
        bool any = false;
        for (uint64_t i = 0; i < a->pieces; i++)
            if (__atomic_load_n(&a->touched[i], __ATOMIC_RELAXED)) {
                __atomic_store_n(&a->touched[i], 0, __ATOMIC_RELAXED);
                any = true;
            }
        if (any) p->spill->forget(p->spill->user, a->data, a->size);
    }
}

void svoi_paged_miss(svo_paged *a, uint64_t piece)
{
    svo_pager *p = a->pager;
    if (__atomic_exchange_n(&a->touched[piece], 1, __ATOMIC_RELAXED)) return;
    if (!a->borrowed && p->spill->fetch != NULL) {
        const uintptr_t data = (uintptr_t)a->data, begin = (a->first + piece) << SVO_PAGE_SHIFT, end = begin + MAP_ALIGN;
        const uintptr_t from = begin > data ? begin : data, to = end < data + a->size ? end : data + a->size;
        p->spill->fetch(p->spill->user, a->data + (from - data), to - from);
    }
    if (__atomic_add_fetch(&p->resident, 1, __ATOMIC_RELAXED) < p->most) return;
    pthread_mutex_lock(&p->lock);
    if (__atomic_load_n(&p->resident, __ATOMIC_RELAXED) >= p->most) drop_all(p);
    pthread_mutex_unlock(&p->lock);
}

/* Under the lock. */
static svo_result pay(svo_pager *p, svo_error *err)
{
    if (p->charge == NULL) p->charge = svo_alloc(p->allocator, p->budget, 1);
    return p->charge != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no %.1f MB are left for textures and buffers that wait in temporary files", (double)p->budget / 1e6);
}

static svo_result add(svo_pager *p, svo_paged *a, svo_error *err)
{
    a->pager = p;
    a->first = (uintptr_t)a->data >> SVO_PAGE_SHIFT;
    a->pieces = (((uintptr_t)a->data + (uintptr_t)a->size - 1) >> SVO_PAGE_SHIFT) - a->first + 1;
    a->touched = svo_calloc(p->allocator, a->pieces, 1);
    if (a->touched == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    a->next = p->list;
    a->link = &p->list;
    if (p->list != NULL) p->list->link = &a->next;
    p->list = a;
    return SVO_OK;
}

svo_result svo_paged_create(svo_pager *p, uint64_t size, svo_paged **out, svo_error *err)
{
    if (size == 0 || size > INT64_MAX / 2) return svo_fail(err, SVO_LIMIT, "an array of %llu bytes cannot be paged", (unsigned long long)size);
    svo_paged *a = svo_calloc(p->allocator, 1, sizeof *a);
    if (a == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    a->size = (size + MAP_ALIGN - 1) / MAP_ALIGN * MAP_ALIGN;
    pthread_mutex_lock(&p->lock);
    svo_result r = pay(p, err);
    if (r == SVO_OK && p->file.file == NULL) r = svo_spill_open(p->spill, &p->file, err);
    void *data = NULL;
    a->offset = p->file.size;
    if (r == SVO_OK) r = p->spill->map(p->spill->user, p->file.file, a->offset, a->size, &data, err);
    if (r == SVO_OK) {
        a->data = data;
        r = add(p, a, err);
        if (r != SVO_OK) p->spill->unmap(p->spill->user, data, a->size);
        p->file.size += a->size;
    }
    pthread_mutex_unlock(&p->lock);
    if (r == SVO_OK) *out = a;
    else svo_free(p->allocator, a, 1, sizeof *a);
    return r;
}

svo_result svo_paged_borrow(svo_pager *p, const void *data, uint64_t size, svo_paged **out, svo_error *err)
{
    svo_paged *a = svo_calloc(p->allocator, 1, sizeof *a);
    if (a == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    a->data = (uint8_t *)(uintptr_t)data;
    a->size = size;
    a->borrowed = true;
    pthread_mutex_lock(&p->lock);
    svo_result r = pay(p, err);
    if (r == SVO_OK) r = add(p, a, err);
    pthread_mutex_unlock(&p->lock);
    if (r == SVO_OK) *out = a;
    else svo_free(p->allocator, a, 1, sizeof *a);
    return r;
}

void svo_paged_free(svo_paged *a)
{
    if (a == NULL) return;
    svo_pager *p = a->pager;
    pthread_mutex_lock(&p->lock);
    *a->link = a->next;
    if (a->next != NULL) a->next->link = a->link;
    if (a->borrowed) {
        p->spill->forget(p->spill->user, a->data, a->size);
    } else {
        p->spill->unmap(p->spill->user, a->data, a->size);
        svo_spill_discard(&p->file, a->offset, a->size);
    }
    svo_free(p->allocator, a->touched, a->pieces, 1);
    pthread_mutex_unlock(&p->lock);
    svo_free(p->allocator, a, 1, sizeof *a);
}
