#include "svo_bones.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"
#include "svo_task.h"

/* A node and its list: range[at .. at + count) of a pool. */
typedef struct entry {
    uint64_t code;
    uint32_t at;
    uint16_t pool, count; /* count ALL: any weights of all bones */
} entry;
#define ALL UINT16_MAX

struct svo_bones {
    const svo_allocator *allocator;
    uint32_t depth, pools;
    svo_buffer level[SVO_MAX_DEPTH + 1]; /* entry, ascending codes */
    svo_buffer *pool;                    /* svo_bone_range; one a thread */
};

/* A voxel's own weights: greatest first, those of weight 0 at the end. */
typedef struct bound { uint64_t code; uint32_t bone[SVO_SKIN_BONES]; uint8_t weight[SVO_SKIN_BONES]; } bound;

static const entry *entries(const svo_bones *b, uint32_t level, uint64_t *count)
{
    *count = b->level[level].size / sizeof(entry);
    return (const entry *)(const void *)b->level[level].data;
}

svo_bone_list svo_bones_at(const svo_bones *b, uint32_t level, const uint32_t cell[3])
{
    uint64_t count, low = 0, code = svo_morton_encode(cell[0], cell[1], cell[2]);
    const entry *e = entries(b, level, &count);
    while (count > 1) { /* the last one that is not above */
        uint64_t half = count / 2;
        if (e[low + half].code <= code) low += half;
        count -= half;
    }
    if (count == 0 || e[low].code != code || e[low].count == ALL) return (svo_bone_list){NULL, 0};
    return (svo_bone_list){(const svo_bone_range *)(const void *)b->pool[e[low].pool].data + e[low].at, e[low].count};
}

void svo_bones_free(svo_bones *b)
{
    if (b == NULL) return;
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) svo_buffer_free(&b->level[l]);
    for (uint32_t i = 0; b->pool != NULL && i < b->pools; i++) svo_buffer_free(&b->pool[i]);
    svo_free(b->allocator, b->pool, b->pools, sizeof *b->pool);
    svo_free(b->allocator, b, 1, sizeof *b);
}

/* ---- voxels ---------------------------------------------------------------------------------------------------------- */

typedef struct collecting {
    const svo_view *view;
    uint32_t label[SVO_SKIN_BONES], weight[SVO_SKIN_BONES]; /* channels; SVO_MAX_CHANNELS: none */
    svo_buffer *to;
    bool ok;
} collecting;

static uint32_t channel_of(const svo_view *v, const char *name, bool label)
{
    uint32_t c = svo_view_find_channel(v, name);
    if (c >= v->channel_count) return SVO_MAX_CHANNELS;
    uint32_t kind = v->channels[c].channel.kind;
    bool fits = label ? kind == SVO_KIND_ID16 || kind == SVO_KIND_ID32 : kind == SVO_KIND_UNORM8;
    return fits ? c : SVO_MAX_CHANNELS;
}

static void find_channels(collecting *c)
{
    static const char *const labels[] = {"bone", "bone1", "bone2", "bone3"}, *const weights[] = {"", "weight1", "weight2", "weight3"};
    for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) {
        c->label[i] = channel_of(c->view, labels[i], true);
        c->weight[i] = i == 0 ? SVO_MAX_CHANNELS : channel_of(c->view, weights[i], false);
    }
}

static uint32_t label_at(const svo_view *v, uint32_t channel, uint64_t index)
{
    uint8_t value[SVO_MAX_STRIDE] = {0};
    uint32_t label;
    svo_view_attribute(v, channel, index, value);
    memcpy(&label, value, sizeof label);
    return v->channels[channel].channel.kind == SVO_KIND_ID16 && label == SVO_SKIN_REST ? SVO_NO_BONE : label;
}

static bound bound_at(const collecting *c, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    bound b = {.code = svo_morton_encode(x, y, z)};
    uint32_t left = 255, n = 1;
    b.bone[0] = label_at(c->view, c->label[0], index);
    for (uint32_t i = 1; i < SVO_SKIN_BONES; i++) {
        uint8_t value[SVO_MAX_STRIDE] = {0};
        if (c->label[i] == SVO_MAX_CHANNELS || c->weight[i] == SVO_MAX_CHANNELS) continue;
        svo_view_attribute(c->view, c->weight[i], index, value);
        uint32_t weight = value[0] < left ? value[0] : left; /* (no more than there is) */
        if (weight == 0) continue;
        b.bone[n] = label_at(c->view, c->label[i], index);
        b.weight[n++] = (uint8_t)weight;
        left -= weight;
    }
    b.weight[0] = (uint8_t)left;
    return b;
}

static bool collect(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    collecting *c = user;
    bound b = bound_at(c, x, y, z, index);
    return c->ok = svo_buffer_append(c->to, &b, sizeof b) != NULL;
}

/* ---- lists ------------------------------------------------------------------------------------------------------------ */

typedef struct list {
    uint32_t count;  /* more than SVO_BONE_LIST_MOST: ALL */
    uint32_t merged; /* weights or lists that went in */
    svo_bone_range range[SVO_BONE_LIST_MOST];
} list;

/* Widen the ranges by those of n bones, each once; bones that are in one of both only have been 0 in the other. */
static void merge(list *l, const svo_bone_range *more, uint32_t n)
{
    bool seen[SVO_BONE_LIST_MOST] = {false};
    if (l->count == ALL) return;
    uint32_t before = l->count;
    for (uint32_t i = 0; i < n; i++) {
        uint32_t k = 0;
        while (k < before && l->range[k].bone != more[i].bone) k++;
        if (k == before) {
            if (l->count == SVO_BONE_LIST_MOST) {
                l->count = ALL;
                return;
            }
            l->range[l->count] = more[i];
            if (l->merged != 0) l->range[l->count].low = 0;
            l->count++;
            continue;
        }
        seen[k] = true;
        if (more[i].low < l->range[k].low) l->range[k].low = more[i].low;
        if (more[i].high > l->range[k].high) l->range[k].high = more[i].high;
    }
    for (uint32_t k = 0; k < before; k++)
        if (!seen[k]) l->range[k].low = 0;
    l->merged++;
}

static void merge_bound(list *l, const bound *b)
{
    svo_bone_range own[SVO_SKIN_BONES];
    uint32_t n = 0;
    for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) {
        uint32_t k = 0;
        if (b->weight[i] == 0) continue;
        while (k < n && own[k].bone != b->bone[i]) k++;
        if (k == n) own[n++] = (svo_bone_range){.bone = b->bone[i]};
        own[k].low = own[k].high = (uint8_t)(own[k].high + b->weight[i]);
    }
    merge(l, own, n);
}

/* Where a list is in a pool; the same place as the last one where it is the same. */
static bool put(svo_buffer *pool, const list *l, const entry *last, uint64_t code, uint16_t number, entry *out)
{
    *out = (entry){code, 0, number, l->count == ALL ? ALL : (uint16_t)l->count};
    if (l->count == ALL) return true;
    size_t bytes = l->count * sizeof l->range[0];
    if (last != NULL && last->count == l->count && memcmp((const svo_bone_range *)(const void *)pool->data + last->at, l->range, bytes) == 0) {
        out->at = last->at;
        return true;
    }
    out->at = (uint32_t)(pool->size / sizeof l->range[0]);
    return pool->size / sizeof l->range[0] < UINT32_MAX - SVO_BONE_LIST_MOST && svo_buffer_append(pool, l->range, bytes) != NULL;
}

/* ---- the finest level ------------------------------------------------------------------------------------------------- */

typedef struct spreading { svo_bones *b; const bound *from; entry *to; uint64_t count; uint32_t size; } spreading;

static const bound *find(const bound *e, uint64_t count, uint64_t code)
{
    uint64_t low = 0;
    while (count > 1) {
        uint64_t half = count / 2;
        if (e[low + half].code <= code) low += half;
        count -= half;
    }
    return count == 1 && e[low].code == code ? &e[low] : NULL;
}

/* A neighbour of voxel i: near it in the array if they have one parent. */
static const bound *neighbour(const spreading *s, uint64_t i, uint32_t x, uint32_t y, uint32_t z)
{
    uint64_t code = svo_morton_encode(x, y, z), own = s->from[i].code;
    if (code >> 3 != own >> 3) return find(s->from, s->count, code);
    uint64_t k = i;
    while (k > 0 && s->from[k].code > code) k--;
    while (k + 1 < s->count && s->from[k].code < code) k++;
    return s->from[k].code == code ? &s->from[k] : NULL;
}

static bool same_weights(const bound *a, const bound *b) { return memcmp(a->bone, b->bone, sizeof a->bone) == 0 && memcmp(a->weight, b->weight, sizeof a->weight) == 0; }

static svo_result spread(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    const spreading *s = user;
    const entry *last = NULL;
    for (uint64_t i = begin; i < end; i++) {
        uint32_t x, y, z;
        list l = {.count = 0, .merged = 0};
        svo_morton_decode(s->from[i].code, &x, &y, &z);
        merge_bound(&l, &s->from[i]);
        for (uint32_t n = 0; n < 27; n++) {
            uint32_t u = x + n % 3 - 1, v = y + n / 3 % 3 - 1, w = z + n / 9 - 1; /* (below 0 wraps to a large number) */
            if (n == 13 || u >= s->size || v >= s->size || w >= s->size) continue;
            const bound *other = neighbour(s, i, u, v, w);
            if (other != NULL && !same_weights(other, &s->from[i])) merge_bound(&l, other);
        }
        if (!put(&s->b->pool[worker], &l, last, s->from[i].code, (uint16_t)worker, &s->to[i])) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the bones of an octree");
        last = &s->to[i];
    }
    return SVO_OK;
}

static bool build_parents(svo_bones *b)
{
    for (uint32_t l = b->depth; l-- > 0;) {
        uint64_t count, i = 0;
        const entry *e = entries(b, l + 1, &count), *last = NULL;
        entry now;
        while (i < count) {
            uint64_t code = e[i].code >> 3;
            list all = {.count = 0, .merged = 0};
            for (; i < count && e[i].code >> 3 == code; i++) {
                if (e[i].count == ALL) all.count = ALL;
                else merge(&all, (const svo_bone_range *)(const void *)b->pool[e[i].pool].data + e[i].at, e[i].count);
            }
            if (!put(&b->pool[b->pools - 1], &all, last != NULL && last->count != ALL ? last : NULL, code, (uint16_t)(b->pools - 1), &now)) return false;
            last = svo_buffer_append(&b->level[l], &now, sizeof now);
            if (last == NULL) return false;
        }
    }
    return true;
}

svo_result svo_bones_make(const svo_view *view, uint32_t threads, const svo_allocator *a, svo_bones **out, svo_error *err)
{
    collecting c = {.view = view, .ok = true};
    *out = NULL;
    find_channels(&c);
    if (view->empty || c.label[0] == SVO_MAX_CHANNELS) return SVO_OK;
    if (view->nodes[view->depth] > (uint64_t)1 << 26) return svo_fail(err, SVO_LIMIT, "an octree that moves by bones has more than 2^26 voxels");
    svo_bones *b = svo_calloc(a, 1, sizeof *b);
    svo_buffer plain;
    svo_buffer_init(&plain, a);
    if (b == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the bones of an octree");
    threads = threads != 0 ? threads : svo_processor_count();
    b->allocator = a;
    b->depth = view->depth;
    b->pools = threads + 1; /* the last one for the levels above */
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) svo_buffer_init(&b->level[l], a);
    b->pool = svo_calloc(a, b->pools, sizeof *b->pool);
    for (uint32_t i = 0; b->pool != NULL && i < b->pools; i++) svo_buffer_init(&b->pool[i], a);
    c.to = &plain;
    svo_view_voxels(view, collect, &c);
    svo_result result = SVO_OK;
    uint64_t count = plain.size / sizeof(bound);
    bool ok = c.ok && b->pool != NULL && svo_buffer_append(&b->level[b->depth], NULL, count * sizeof(entry)) != NULL;
    if (ok) {
        spreading s = {b, (const bound *)(const void *)plain.data, (entry *)(void *)b->level[b->depth].data, count, 1u << b->depth};
        result = svo_parallel_for(threads, count, 0, spread, &s, err);
        svo_buffer_free(&plain);
        ok = result == SVO_OK && build_parents(b);
    }
    svo_buffer_free(&plain);
    if (result == SVO_OK && !ok) result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the bones of an octree");
    if (result != SVO_OK) {
        svo_bones_free(b);
        return result;
    }
    *out = b;
    return SVO_OK;
}

/* ---- extents ---------------------------------------------------------------------------------------------------------- */

typedef struct measuring {
    collecting channels;
    svo_buffer boxes; /* 6 doubles a label */
    double rest[6];
    bool ok;
} measuring;

static void grow(double box[6], const uint32_t cell[3])
{
    for (int k = 0; k < 3; k++) box[k] = fmin(box[k], cell[k]), box[3 + k] = fmax(box[3 + k], (double)cell[k] + 1);
}

static const double nothing[6] = {INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY};

static bool measure(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    measuring *m = user;
    const uint32_t cell[3] = {x, y, z};
    bound b = bound_at(&m->channels, x, y, z, index);
    for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) {
        if (b.weight[i] == 0) continue;
        if (b.bone[i] >= SVO_SKIN_REST) {
            grow(m->rest, cell);
            continue;
        }
        while (m->boxes.size / sizeof nothing <= b.bone[i])
            if (svo_buffer_append(&m->boxes, nothing, sizeof nothing) == NULL) return m->ok = false;
        grow((double *)(void *)m->boxes.data + 6 * (uint64_t)b.bone[i], cell);
    }
    return true;
}

svo_result svo_extent_make(const svo_view *view, bool with_bones, const svo_allocator *a, svo_extent *out, svo_error *err)
{
    bool any;
    uint32_t low[3], high[3];
    svo_extent e = {.allocator = a};
    SVO_TRY(svo_view_grid_bounds(view, a, &any, low, high, err));
    for (int k = 0; k < 3 && any; k++) e.low[k] = low[k], e.high[k] = (double)high[k] + 1;
    measuring m = {.channels = {.view = view}, .ok = true};
    if (with_bones) find_channels(&m.channels);
    if (any && with_bones && m.channels.label[0] != SVO_MAX_CHANNELS && view->nodes[view->depth] <= (uint64_t)1 << 24) {
        memcpy(m.rest, nothing, sizeof nothing);
        svo_buffer_init(&m.boxes, a);
        svo_view_voxels(view, measure, &m);
        e.bones = (uint32_t)(m.boxes.size / sizeof nothing);
        if (m.ok) e.box = svo_alloc(a, (uint64_t)e.bones + 1, sizeof nothing);
        if (e.box != NULL) {
            if (e.bones != 0) memcpy(e.box, m.boxes.data, m.boxes.size);
            memcpy(e.box + 6 * (uint64_t)e.bones, m.rest, sizeof nothing);
        }
        svo_buffer_free(&m.boxes);
        if (e.box == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the bones of an octree");
    }
    *out = e;
    return SVO_OK;
}

void svo_extent_free(svo_extent *e)
{
    svo_free(e->allocator, e->box, (uint64_t)e->bones + 1, sizeof nothing);
    e->box = NULL;
}
