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
    uint32_t *codes; /* of the chunk's voxels, below its root */
    uint64_t capacity;
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
    if (counts.full_leaves != 0) return svo_fail(err, SVO_UNSUPPORTED, "full leaves of solid octrees cannot be compared");
    s->voxels += s->chunk.value_count;
    uint64_t total = c->a.voxels + c->b.voxels;
    if (c->options->max_voxels != 0 && total > c->options->max_voxels)
        return svo_fail(err, SVO_LIMIT, "more than %llu voxels to compare", (unsigned long long)c->options->max_voxels);
    if (c->options->progress != NULL && !c->options->progress(c->options->user, total))
        return svo_fail(err, SVO_CANCELLED, "cancelled");
    return SVO_OK;
}

/* Morton codes of a chunk's voxels relative to its root, 21 bits, ascending. */
static svo_result list_codes(side *s, const svo_allocator *a, svo_error *err)
{
    const svo_chunk *k = &s->chunk;
    if (s->capacity < k->value_count) {
        svo_free(a, s->codes, s->capacity, sizeof *s->codes);
        s->capacity = 0;
        s->codes = svo_alloc(a, k->value_count, sizeof *s->codes);
        if (s->codes == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
        s->capacity = k->value_count;
    }
    uint32_t levels = k->depth - k->level, l = 0, code[SVO_CHUNK_LEVELS + 1] = {0};
    uint8_t left[SVO_CHUNK_LEVELS + 1];
    uint64_t n = 0;
    if (levels == 0) {
        s->codes[0] = 0;
        return SVO_OK;
    }
    for (uint64_t i = 0; i < k->node_count; i++) { /* l: level of this node, code[l]: its code */
        uint8_t mask = k->masks[i];
        if (l + 1 == levels) {
            for (uint32_t m = mask; m != 0; m &= m - 1) s->codes[n++] = code[l] << 3 | (uint32_t)__builtin_ctz(m);
            while (l > 0 && left[l - 1] == 0) l--;
            if (l == 0) break;
        } else {
            left[l++] = mask;
        }
        uint32_t octant = (uint32_t)__builtin_ctz(left[l - 1]);
        left[l - 1] &= (uint8_t)(left[l - 1] - 1);
        code[l] = code[l - 1] << 3 | octant;
    }
    return SVO_OK;
}

static const uint8_t *value_of(const side *s, uint32_t channel, uint64_t index, uint32_t stride)
{
    const svo_channel *ch = &s->info->channels[channel];
    return ch->constant ? ch->value : s->chunk.channels[channel] + index * stride;
}

static void compare_voxel(comparer *c, uint64_t ia, uint64_t ib, uint64_t code)
{
    for (uint32_t i = 0; i < c->out->channel_count; i++) {
        svo_compare_channel *ch = &c->out->channels[i];
        if (!ch->comparable) continue;
        uint32_t stride = svo_channel_stride(ch->kind);
        const uint8_t *va = value_of(&c->a, c->pair_a[i], ia, stride), *vb = value_of(&c->b, c->pair_b[i], ib, stride);
        if (memcmp(va, vb, stride) == 0) continue;
        double e = value_error(&c->lab, ch->kind, va, vb);
        c->sum[i] += e;
        if (ch->different == 0 || e > ch->max) ch->max = e, ch->worst = code;
        ch->different++;
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

static svo_result compare_chunks(comparer *c, svo_error *err)
{
    side *a = &c->a, *b = &c->b;
    const svo_chunk *ka = &a->chunk, *kb = &b->chunk;
    uint64_t high = ka->code << (3 * (ka->depth - ka->level));
    bool same_shape = ka->node_count == kb->node_count && (ka->node_count == 0 || memcmp(ka->masks, kb->masks, ka->node_count) == 0);
    bool same_values = same_shape;
    for (uint32_t i = 0; same_values && i < c->out->channel_count; i++) {
        if (!c->out->channels[i].comparable) continue;
        uint32_t stride = svo_channel_stride(c->out->channels[i].kind);
        const svo_channel *ca = &a->info->channels[c->pair_a[i]], *cb = &b->info->channels[c->pair_b[i]];
        if (ca->constant && cb->constant) same_values = memcmp(ca->value, cb->value, stride) == 0;
        else if (ca->constant || cb->constant) same_values = false;
        else same_values = memcmp(ka->channels[c->pair_a[i]], kb->channels[c->pair_b[i]], ka->value_count * stride) == 0;
    }
    if (same_values) {
        c->out->both += ka->value_count;
        return SVO_OK;
    }
    SVO_TRY(list_codes(a, c->options->allocator, err));
    SVO_TRY(list_codes(b, c->options->allocator, err));
    uint64_t i = 0, j = 0;
    while (i < ka->value_count || j < kb->value_count) {
        if (j == kb->value_count || (i < ka->value_count && a->codes[i] < b->codes[j])) {
            only_one(c, true, high | a->codes[i], 1);
            i++;
        } else if (i == ka->value_count || b->codes[j] < a->codes[i]) {
            only_one(c, false, high | b->codes[j], 1);
            j++;
        } else {
            c->out->both++;
            compare_voxel(c, i, j, high | a->codes[i]);
            i++, j++;
        }
    }
    return SVO_OK;
}

static svo_result compare_streams(comparer *c, svo_error *err)
{
    side *a = &c->a, *b = &c->b;
    SVO_TRY(next_chunk(c, a, err));
    SVO_TRY(next_chunk(c, b, err));
    while (a->more || b->more) {
        bool comparable = c->out->same_depth;
        bool take_a = a->more && (!b->more || a->chunk.code <= b->chunk.code);
        bool take_b = b->more && (!a->more || b->chunk.code <= a->chunk.code);
        if (comparable && take_a && take_b) {
            SVO_TRY(compare_chunks(c, err));
        } else if (comparable) {
            side *s = take_a ? a : b;
            SVO_TRY(list_codes(s, c->options->allocator, err));
            uint64_t high = s->chunk.code << (3 * (s->chunk.depth - s->chunk.level));
            only_one(c, take_a, high | s->codes[0], s->chunk.value_count);
        }
        if (take_a) SVO_TRY(next_chunk(c, a, err));
        if (take_b) SVO_TRY(next_chunk(c, b, err));
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
        svo_free(options->allocator, sides[i]->codes, sides[i]->capacity, sizeof *sides[i]->codes);
    }
    svo_free(options->allocator, c, 1, sizeof *c);
    if (r == SVO_OK) *out = result;
    return r;
}
