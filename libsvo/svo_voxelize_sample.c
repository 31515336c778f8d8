/* Which voxels are compared with the reference, and the triangles that meet them. */
#include "svoi_voxelize.h"

#include <stdlib.h>
#include <string.h>

static uint64_t hash_of(uint64_t code)
{
    code ^= code >> 31;
    code *= 0x7fb5d329728ea185u;
    code ^= code >> 27;
    code *= 0x81dadef4bc2dd44du;
    return code ^ code >> 33;
}

void svoi_samples_init(svoi_samples *s, const svo_allocator *a)
{
    svo_buffer_init(&s->list, a);
    svo_buffer_init(&s->triangles, a);
}

void svoi_samples_free(svoi_samples *s)
{
    svo_buffer_free(&s->list);
    svo_buffer_free(&s->triangles);
}

static int by_order(const void *a, const void *b)
{
    const svoi_sample *x = a, *y = b;
    return (x->order > y->order) - (x->order < y->order); /* hashes of different codes are different: the hash is a bijection */
}
static int by_code(const void *a, const void *b)
{
    const svoi_sample *x = a, *y = b;
    return (x->code > y->code) - (x->code < y->code);
}

static svoi_sample *find(const svoi_scan *s, uint32_t code)
{
    if (!(s->sample_bricks[code >> 12] >> (code >> 6 & 63) & 1)) return NULL;
    const svoi_sample key = {.code = s->it->code << 3 * s->r->levels | code};
    return bsearch(&key, s->sample, s->sample_count, sizeof key, by_code);
}

static void count_voxel(svoi_scan *s, uint32_t code)
{
    svoi_sample *at = find(s, code);
    if (at != NULL) at->count++;
}

/* `first` runs through the sample's triangles. */
static void note_voxel(svoi_scan *s, uint32_t code)
{
    svoi_sample *at = find(s, code);
    if (at != NULL && at->count <= SVOI_REFERENCE_TRIANGLES) memcpy(s->it->samples.triangles.data + 4 * at->first++, &s->triangle, 4);
}

static void visit_all(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3], svoi_voxel_fn fn)
{
    const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
    for (uint64_t i = 0; i < s->it->list.size / 4; i++) {
        svo_record record;
        s->triangle = list[i];
        svoi_load_triangle(s, list[i], &record);
        svoi_visit_voxels(s, i, &record, box_lo, box_hi, fn);
    }
}

void svoi_samples_take(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3])
{
    svoi_run *r = s->r;
    const svo_block *b = s->w->block;
    const uint64_t limit = __atomic_load_n(&r->sample_limit, __ATOMIC_RELAXED);
    svo_buffer *list = &s->it->samples.list, *triangles = &s->it->samples.triangles;
    list->size = triangles->size = 0;
    memset(s->sample_bricks, 0, sizeof s->sample_bricks);
    /* One slot in each brick is a candidate, so all voxels are equally likely. */
    for (uint32_t i = 0; i < 512; i++)
        for (uint64_t used = b->used[i]; used != 0; used &= used - 1) {
            uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(used);
            uint64_t order = hash_of(s->it->code << 3 * r->levels | brick << 6);
            if (order >= limit || !(b->bricks[brick] >> (order & 63) & 1)) continue;
            svoi_sample sample = {.order = order, .code = s->it->code << 3 * r->levels | brick << 6 | (order & 63)};
            if (svo_buffer_append(list, &sample, sizeof sample) == NULL) return;
        }
    uint64_t count = list->size / sizeof(svoi_sample), most = r->sample_count;
    if (count == 0) return;
    s->sample = (svoi_sample *)(void *)list->data;
    qsort(s->sample, count, sizeof *s->sample, by_order);
    if (count > most) count = most;
    list->size = count * sizeof *s->sample;
    s->sample_count = (uint32_t)count;
    qsort(s->sample, count, sizeof *s->sample, by_code);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t local = (uint32_t)s->sample[i].code & ((1u << 3 * r->levels) - 1);
        uint64_t index = svo_block_index(b, local);
        s->sample_bricks[local >> 12] |= (uint64_t)1 << (local >> 6 & 63);
        for (uint32_t c = 0; c < r->info->channel_count; c++) {
            uint32_t stride = svo_channel_stride(r->info->channels[c].kind);
            if (!r->info->channels[c].constant) memcpy(s->sample[i].values[c], s->channels[c] + index * stride, stride);
        }
    }
    visit_all(s, box_lo, box_hi, count_voxel);
    uint64_t first = 0;
    for (uint32_t i = 0; i < count; i++) {
        s->sample[i].first = first;
        if (s->sample[i].count <= SVOI_REFERENCE_TRIANGLES) first += s->sample[i].count;
    }
    if (svo_buffer_append(triangles, NULL, 4 * first) == NULL) {
        list->size = 0;
        return;
    }
    visit_all(s, box_lo, box_hi, note_voxel);
    for (uint32_t i = 0; i < count; i++) {
        if (s->sample[i].count <= SVOI_REFERENCE_TRIANGLES) s->sample[i].first -= s->sample[i].count;
        else s->sample[i].count = 0; /* too many to be looked at */
    }
}

/* Keep the smallest hashes, and their triangles. */
static void shrink(svoi_run *r)
{
    svoi_samples *s = &r->samples, kept;
    svoi_sample *list = (svoi_sample *)(void *)s->list.data;
    uint64_t count = s->list.size / sizeof *list;
    qsort(list, count, sizeof *list, by_order);
    if (count <= r->sample_count) return;
    count = r->sample_count;
    svoi_samples_init(&kept, r->allocator);
    for (uint64_t i = 0; i < count; i++) {
        svoi_sample one = list[i];
        one.first = kept.triangles.size / 4;
        if (svo_buffer_append(&kept.triangles, s->triangles.data + 4 * list[i].first, 4 * (uint64_t)one.count) == NULL ||
            svo_buffer_append(&kept.list, &one, sizeof one) == NULL) {
            svoi_samples_free(&kept);
            return;
        }
    }
    svoi_samples_free(s);
    *s = kept;
    __atomic_store_n(&r->sample_limit, ((svoi_sample *)(void *)s->list.data)[count - 1].order, __ATOMIC_RELAXED);
}

void svoi_samples_merge(svoi_run *r, const svoi_samples *more)
{
    svoi_samples *s = &r->samples;
    const svoi_sample *list = (const svoi_sample *)(const void *)more->list.data;
    uint64_t count = more->list.size / sizeof *list, base = s->triangles.size / 4;
    if (count == 0 || svo_buffer_append(&s->triangles, more->triangles.data, more->triangles.size) == NULL) return;
    for (uint64_t i = 0; i < count; i++) {
        svoi_sample one = list[i];
        one.first += base;
        if (svo_buffer_append(&s->list, &one, sizeof one) == NULL) return;
    }
    if (s->list.size / sizeof *list >= 2 * (uint64_t)r->sample_count) shrink(r);
}

svo_result svoi_samples_measure(svoi_run *r, uint32_t threads, svo_error *err)
{
    shrink(r);
    const svoi_samples *s = &r->samples;
    uint64_t count = s->list.size / sizeof(svoi_sample);
    if (count > r->sample_count) count = r->sample_count;
    return svoi_reference_measure(&r->placement, &r->grid, r->info, (const svoi_sample *)(const void *)s->list.data, count,
                                  (const uint32_t *)(const void *)s->triangles.data, threads, r->allocator, r->report->attribute_errors,
                                  &r->report->reference_voxels, err);
}
