#include "svo_bones.h"

#include <string.h>

#include "svo_morton.h"
#include "svo_task.h"

typedef struct entry { uint64_t code, set; } entry;

struct svo_bones {
    const svo_allocator *allocator;
    uint32_t depth;
    svo_buffer level[SVO_MAX_DEPTH + 1]; /* entry, ascending codes */
};

static const entry *entries(const svo_bones *b, uint32_t level, uint64_t *count)
{
    *count = b->level[level].size / sizeof(entry);
    return (const entry *)(const void *)b->level[level].data;
}

static uint64_t find(const entry *e, uint64_t count, uint64_t code)
{
    uint64_t low = 0;
    while (count > 1) { /* the last one that is not above */
        uint64_t half = count / 2;
        if (e[low + half].code <= code) low += half;
        count -= half;
    }
    return count == 1 && e[low].code == code ? e[low].set : 0;
}

uint64_t svo_bones_set(const svo_bones *b, uint32_t level, const uint32_t cell[3])
{
    uint64_t count;
    const entry *e = entries(b, level, &count);
    return find(e, count, svo_morton_encode(cell[0], cell[1], cell[2]));
}

void svo_bones_free(svo_bones *b)
{
    if (b == NULL) return;
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) svo_buffer_free(&b->level[l]);
    svo_free(b->allocator, b, 1, sizeof *b);
}

typedef struct collecting { const svo_view *view; uint32_t channel, kind; svo_buffer *to; bool ok; } collecting;

static bool collect(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    collecting *c = user;
    uint8_t value[SVO_MAX_STRIDE] = {0};
    uint32_t label = 0;
    svo_view_attribute(c->view, c->channel, index, value);
    memcpy(&label, value, c->kind == SVO_KIND_ID16 ? 2 : 4);
    bool none = label == (c->kind == SVO_KIND_ID16 ? 0xffffu : 0xffffffffu);
    entry e = {svo_morton_encode(x, y, z), none ? SVO_BONES_NONE : (uint64_t)1 << label % 63 | (label >= 63 ? SVO_BONES_NONE : 0)};
    return c->ok = svo_buffer_append(c->to, &e, sizeof e) != NULL;
}

typedef struct spreading { const entry *from; entry *to; uint64_t count; uint32_t size; } spreading;

/* The sets of a voxel and of all that touch it. */
static svo_result spread(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    const spreading *s = user;
    for (uint64_t i = begin; i < end; i++) {
        uint32_t x, y, z;
        uint64_t set = 0;
        svo_morton_decode(s->from[i].code, &x, &y, &z);
        for (uint32_t n = 0; n < 27; n++) {
            uint32_t u = x + n % 3 - 1, v = y + n / 3 % 3 - 1, w = z + n / 9 - 1; /* (below 0 wraps to a large number) */
            if (u >= s->size || v >= s->size || w >= s->size) continue;
            set |= n == 13 ? s->from[i].set : find(s->from, s->count, svo_morton_encode(u, v, w));
        }
        s->to[i] = (entry){s->from[i].code, set};
    }
    return SVO_OK;
}

static bool build_parents(svo_bones *b)
{
    for (uint32_t l = b->depth; l-- > 0;) {
        uint64_t count;
        const entry *e = entries(b, l + 1, &count);
        entry now = {e[0].code >> 3, 0};
        for (uint64_t i = 0; i < count; i++) {
            if (e[i].code >> 3 != now.code) {
                if (svo_buffer_append(&b->level[l], &now, sizeof now) == NULL) return false;
                now = (entry){e[i].code >> 3, 0};
            }
            now.set |= e[i].set;
        }
        if (svo_buffer_append(&b->level[l], &now, sizeof now) == NULL) return false;
    }
    return true;
}

svo_result svo_bones_make(const svo_view *view, uint32_t threads, const svo_allocator *a, svo_bones **out, svo_error *err)
{
    uint32_t channel = svo_view_find_channel(view, "bone");
    *out = NULL;
    if (view->empty || channel >= view->channel_count) return SVO_OK;
    uint32_t kind = view->channels[channel].channel.kind;
    if (kind != SVO_KIND_ID16 && kind != SVO_KIND_ID32) return SVO_OK;
    if (view->nodes[view->depth] > (uint64_t)1 << 26) return svo_fail(err, SVO_LIMIT, "an octree that moves by bones has more than 2^26 voxels");
    svo_bones *b = svo_calloc(a, 1, sizeof *b);
    svo_buffer plain;
    svo_buffer_init(&plain, a);
    if (b == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the bones of an octree");
    b->allocator = a;
    b->depth = view->depth;
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) svo_buffer_init(&b->level[l], a);
    collecting c = {view, channel, kind, &plain, true};
    svo_view_voxels(view, collect, &c);
    svo_result result = SVO_OK;
    bool ok = c.ok && svo_buffer_append(&b->level[b->depth], NULL, plain.size) != NULL;
    if (ok) {
        spreading s = {(const entry *)(const void *)plain.data, (entry *)(void *)b->level[b->depth].data, plain.size / sizeof(entry), 1u << b->depth};
        result = svo_parallel_for(threads, s.count, 0, spread, &s, err);
        ok = build_parents(b);
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
