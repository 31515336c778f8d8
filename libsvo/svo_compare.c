#include "svo_compare.h"

#include <math.h>
#include <string.h>

#include "svo_color.h"
#include "svo_morton.h"

/* --- one voxel --- */

enum { LAB_BITS = 12 };

/* Colours come again and again, so their CIELAB values are kept: a direct-mapped cache by a hash of the colour. */
typedef struct lab_cache {
    struct { uint32_t key; float lab[3]; } entry[1 << LAB_BITS]; /* key: colour + 1, 0 = empty */
} lab_cache;

static const float *lab_of(lab_cache *cache, const uint8_t *rgb)
{
    uint32_t key = ((uint32_t)rgb[0] << 16 | (uint32_t)rgb[1] << 8 | rgb[2]) + 1;
    uint32_t slot = key * 2654435761u >> (32 - LAB_BITS);
    if (cache->entry[slot].key != key) {
        svo_srgb8_to_lab(rgb, cache->entry[slot].lab);
        cache->entry[slot].key = key;
    }
    return cache->entry[slot].lab;
}

static double degrees_between(const uint8_t *a, const uint8_t *b)
{
    float u[3], v[3];
    svo_oct32_decode(a, u);
    svo_oct32_decode(b, v);
    svo_vec3 p = svo_v3(u[0], u[1], u[2]), q = svo_v3(v[0], v[1], v[2]);
    return atan2(svo_length(svo_cross(p, q)), svo_dot(p, q)) * (180 / 3.14159265358979323846); /* exact near 0, unlike acos */
}

static double value_error(lab_cache *cache, svo_channel_kind kind, const uint8_t *a, const uint8_t *b)
{
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: {
        float reference[3]; /* the second look-up may take the first one's slot */
        memcpy(reference, lab_of(cache, a), sizeof reference);
        return svo_delta_e94(reference, lab_of(cache, b));
    }
    case SVO_KIND_NORMAL_OCT32: return degrees_between(a, b);
    case SVO_KIND_UNORM8: return fabs((double)a[0] - b[0]) / 255;
    case SVO_KIND_ID16:
    case SVO_KIND_ID32: break;
    }
    return 1;
}

/* --- streams --- */

typedef struct side {
    const svo_tree_info *info;
    const svo_chunk_source *source;
    svo_buffer packed, storage;
    svo_chunk chunk;
    bool more;
    uint64_t voxels;
    uint64_t chunk_voxels;
    bool fresh;      /* nothing of the chunk has been compared */
    uint64_t *begin; /* Morton codes of the first voxel of each value of the chunk, and of the one behind its last */
    uint64_t *end;
    uint64_t capacity, count, at; /* values: room, listed (0: not yet), compared */
} side;

typedef struct comparer {
    side a, b;
    const svo_compare_options *options;
    svo_compare_result *out;
    uint32_t pair_a[2 * SVO_MAX_CHANNELS], pair_b[2 * SVO_MAX_CHANNELS]; /* channel numbers, for comparable channels */
    double sum[2 * SVO_MAX_CHANNELS];
    bool has_first;
    lab_cache lab;
} comparer;

static svo_result next_chunk(comparer *c, side *s, svo_error *err)
{
    SVO_TRY(s->source->fetch(s->source->user, &s->packed, &s->more, err));
    if (!s->more) return SVO_OK;
    SVO_TRY(s->source->decode(s->source->user, &s->packed, &s->storage, &s->chunk, err));
    svo_tree_counts counts = {0};
    SVO_TRY(svo_chunk_check(s->info, &s->chunk, &counts, err));
    s->chunk_voxels = counts.nodes[s->info->depth];
    s->voxels += s->chunk_voxels;
    s->fresh = true;
    s->count = s->at = 0;
    uint64_t total = c->a.voxels + c->b.voxels;
    if (c->options->max_voxels != 0 && total > c->options->max_voxels)
        return svo_fail(err, SVO_LIMIT, "more than %llu voxels to compare", (unsigned long long)c->options->max_voxels);
    if (c->options->progress != NULL && !c->options->progress(c->options->user, total))
        return svo_fail(err, SVO_CANCELLED, "cancelled");
    return SVO_OK;
}

static bool list_value(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    side *s = user;
    s->begin[index] = svo_morton_encode(low[0], low[1], low[2]);
    s->end[index] = s->begin[index] + (uint64_t)size * size * size;
    return true;
}

/* The runs of voxels that the chunk's values stand for, ascending. */
static svo_result list_values(side *s, const svo_allocator *a, svo_error *err)
{
    uint64_t n = s->chunk.value_count;
    if (s->count != 0) return SVO_OK;
    if (s->capacity < n) {
        svo_free(a, s->begin, 2 * s->capacity, sizeof *s->begin);
        s->capacity = 0;
        s->begin = svo_alloc(a, 2 * n, sizeof *s->begin);
        if (s->begin == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
        s->capacity = n;
    }
    s->end = s->begin + s->capacity;
    svo_chunk_values(&s->chunk, list_value, s);
    s->count = n;
    return SVO_OK;
}

static const uint8_t *value_of(const side *s, uint32_t channel, uint64_t index, uint32_t stride)
{
    const svo_channel *ch = &s->info->channels[channel];
    return ch->constant ? ch->value : s->chunk.channels[channel] + index * stride;
}

/* `voxels` of them from `code` on. */
static void compare_values(comparer *c, uint64_t ia, uint64_t ib, uint64_t code, uint64_t voxels)
{
    for (uint32_t i = 0; i < c->out->channel_count; i++) {
        svo_compare_channel *ch = &c->out->channels[i];
        if (!ch->comparable) continue;
        uint32_t stride = svo_channel_stride(ch->kind);
        const uint8_t *va = value_of(&c->a, c->pair_a[i], ia, stride), *vb = value_of(&c->b, c->pair_b[i], ib, stride);
        if (memcmp(va, vb, stride) == 0) continue;
        double e = value_error(&c->lab, ch->kind, va, vb);
        c->sum[i] += e * (double)voxels;
        if (ch->different == 0 || e > ch->max) ch->max = e, ch->worst = code;
        ch->different += voxels;
    }
}

static void only_one(comparer *c, bool in_a, uint64_t code, uint64_t count)
{
    if (in_a) c->out->only_a += count;
    else c->out->only_b += count;
    if (c->has_first && c->out->first <= code) return;
    c->has_first = true;
    c->out->first = code;
    c->out->first_in_a = in_a;
}

/* Are two chunks the same, bit for bit? */
static bool same_chunks(const comparer *c)
{
    const side *a = &c->a, *b = &c->b;
    const svo_chunk *ka = &a->chunk, *kb = &b->chunk;
    bool same = ka->code == kb->code && ka->level == kb->level && ka->node_count == kb->node_count && ka->value_count == kb->value_count &&
                (ka->node_count == 0 || memcmp(ka->masks, kb->masks, ka->node_count) == 0);
    for (uint32_t i = 0; same && i < c->out->channel_count; i++) {
        if (!c->out->channels[i].comparable) continue;
        uint32_t stride = svo_channel_stride(c->out->channels[i].kind);
        const svo_channel *ca = &a->info->channels[c->pair_a[i]], *cb = &b->info->channels[c->pair_b[i]];
        if (ca->constant && cb->constant) same = memcmp(ca->value, cb->value, stride) == 0;
        else if (ca->constant || cb->constant) same = false;
        else same = memcmp(ka->channels[c->pair_a[i]], kb->channels[c->pair_b[i]], ka->value_count * stride) == 0;
    }
    return same;
}

/* One step along both streams: runs of voxels that only one has, or that both have with one value each. */
static svo_result compare_runs(comparer *c, svo_error *err)
{
    side *a = &c->a, *b = &c->b;
    SVO_TRY(list_values(a, c->options->allocator, err));
    SVO_TRY(list_values(b, c->options->allocator, err));
    a->fresh = b->fresh = false;
    while (a->at < a->count && b->at < b->count) {
        uint64_t *from_a = &a->begin[a->at], *from_b = &b->begin[b->at], end_a = a->end[a->at], end_b = b->end[b->at];
        if (*from_a != *from_b) {
            bool first_a = *from_a < *from_b;
            uint64_t *from = first_a ? from_a : from_b, end = first_a ? end_a : end_b, other = first_a ? *from_b : *from_a;
            if (end > other) end = other;
            only_one(c, first_a, *from, end - *from);
            *from = end;
        } else {
            uint64_t end = end_a < end_b ? end_a : end_b, n = end - *from_a;
            c->out->both += n;
            compare_values(c, a->at, b->at, *from_a, n);
            *from_a = *from_b = end;
        }
        a->at += *from_a == end_a;
        b->at += *from_b == end_b;
    }
    return SVO_OK;
}

/* All that is left of a chunk is in one octree only. */
static svo_result only_rest(comparer *c, side *s, svo_error *err)
{
    SVO_TRY(list_values(s, c->options->allocator, err));
    for (; s->at < s->count; s->at++) only_one(c, s == &c->a, s->begin[s->at], s->end[s->at] - s->begin[s->at]);
    return SVO_OK;
}

static svo_result compare_streams(comparer *c, svo_error *err)
{
    side *a = &c->a, *b = &c->b;
    SVO_TRY(next_chunk(c, a, err));
    SVO_TRY(next_chunk(c, b, err));
    while (a->more || b->more) {
        bool comparable = c->out->same_depth;
        if (!comparable) {
            if (a->more) SVO_TRY(next_chunk(c, a, err));
            if (b->more) SVO_TRY(next_chunk(c, b, err));
        } else if (a->more && b->more && a->fresh && b->fresh && same_chunks(c)) {
            c->out->both += a->chunk_voxels;
            SVO_TRY(next_chunk(c, a, err));
            SVO_TRY(next_chunk(c, b, err));
        } else if (!b->more || (a->more && svo_chunk_end(&a->chunk) <= svo_chunk_first(&b->chunk))) {
            SVO_TRY(only_rest(c, a, err));
            SVO_TRY(next_chunk(c, a, err));
        } else if (!a->more || svo_chunk_end(&b->chunk) <= svo_chunk_first(&a->chunk)) {
            SVO_TRY(only_rest(c, b, err));
            SVO_TRY(next_chunk(c, b, err));
        } else {
            SVO_TRY(compare_runs(c, err));
            /* one of them has come to its end; so has the other where they cover the same */
            bool end_a = a->at == a->count, end_b = b->at == b->count;
            if (end_a) SVO_TRY(next_chunk(c, a, err));
            if (end_b) SVO_TRY(next_chunk(c, b, err));
        }
    }
    return SVO_OK;
}

static void match_channels(comparer *c)
{
    const svo_tree_info *a = c->a.info, *b = c->b.info;
    svo_compare_result *out = c->out;
    for (uint32_t i = 0; i < a->channel_count + b->channel_count; i++) {
        const svo_channel *ch = i < a->channel_count ? &a->channels[i] : &b->channels[i - a->channel_count];
        uint32_t ia = 0, ib = 0;
        while (ia < a->channel_count && memcmp(a->channels[ia].name, ch->name, sizeof ch->name) != 0) ia++;
        while (ib < b->channel_count && memcmp(b->channels[ib].name, ch->name, sizeof ch->name) != 0) ib++;
        bool in_a = ia < a->channel_count, in_b = ib < b->channel_count;
        if (i >= a->channel_count && in_a) continue; /* has been listed */
        uint32_t n = out->channel_count++;
        svo_compare_channel *to = &out->channels[n];
        memcpy(to->name, ch->name, sizeof to->name);
        to->in_a = in_a, to->in_b = in_b, to->kind = ch->kind;
        to->comparable = in_a && in_b && a->channels[ia].kind == b->channels[ib].kind;
        c->pair_a[n] = ia, c->pair_b[n] = ib;
    }
}

static void compare_transforms(const svo_tree_info *a, const svo_tree_info *b, svo_compare_result *out)
{
    out->same_transform = true;
    for (int i = 0; i < 16; i++) out->same_transform &= a->voxel_to_world[i] == b->voxel_to_world[i];
    svo_mat4 ma, mb;
    memcpy(ma.m, a->voxel_to_world, sizeof ma.m);
    memcpy(mb.m, b->voxel_to_world, sizeof mb.m);
    double n = (double)((uint64_t)1 << a->depth);
    for (int i = 0; i < 8; i++) {
        svo_vec3 p = svo_v3(i & 1 ? n : 0, i & 2 ? n : 0, i & 4 ? n : 0);
        double d = svo_length(svo_sub(svo_mat4_point(&ma, p), svo_mat4_point(&mb, p)));
        if (d > out->transform_distance) out->transform_distance = d;
    }
}

svo_result svo_compare_trees(const svo_tree_info *a, const svo_chunk_source *source_a, const svo_tree_info *b,
                             const svo_chunk_source *source_b, const svo_compare_options *options, svo_compare_result *out,
                             svo_error *err)
{
    svo_compare_result result = {.same_depth = a->depth == b->depth};
    comparer *c = svo_calloc(options->allocator, 1, sizeof *c);
    if (c == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    c->a.info = a, c->a.source = source_a;
    c->b.info = b, c->b.source = source_b;
    c->options = options;
    c->out = &result;
    side *sides[2] = {&c->a, &c->b};
    for (int i = 0; i < 2; i++) {
        svo_buffer_init(&sides[i]->packed, options->allocator);
        svo_buffer_init(&sides[i]->storage, options->allocator);
    }
    if (result.same_depth) {
        match_channels(c);
        compare_transforms(a, b, &result);
    }
    svo_result r = compare_streams(c, err);
    result.voxels_a = c->a.voxels;
    result.voxels_b = c->b.voxels;
    for (uint32_t i = 0; i < result.channel_count; i++)
        result.channels[i].mean = result.both > 0 ? c->sum[i] / (double)result.both : 0;
    for (int i = 0; i < 2; i++) {
        svo_buffer_free(&sides[i]->packed);
        svo_buffer_free(&sides[i]->storage);
        svo_free(options->allocator, sides[i]->begin, 2 * sides[i]->capacity, sizeof *sides[i]->begin);
    }
    svo_free(options->allocator, c, 1, sizeof *c);
    if (r == SVO_OK) *out = result;
    return r;
}
