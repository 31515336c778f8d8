/* Attributes of inner nodes: exact integer sums over the finest voxels below, and the values that follow from them. */
#include <math.h>
#include <string.h>

#include "svoi_dag.h"

static const double scale = 34359738368.0; /* 2^35 */

static double to_double(svoi_wide v)
{
    int64_t low = (int64_t)v;
    return low == v ? (double)low : (double)v; /* nearly always the fast one */
}

void svoi_sum_add(svoi_sum *to, const svoi_sum *s)
{
    if (to->n == 0) {
        *to = *s;
        return;
    }
    for (int i = 0; i < 3; i++) to->s[i] += s->s[i];
    to->n += s->n;
    to->uniform = to->uniform && s->uniform && to->first == s->first;
}

void svoi_sum_value(const svoi_sum *s, svo_channel_kind kind, uint8_t *out)
{
    uint32_t stride = svo_channel_stride(kind);
    svoi_store_value(out, stride, s->first); /* also where normals cancel */
    if (s->uniform || s->n == 0) return;
    double n = (double)s->n;
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8:
        for (int i = 0; i < 3; i++) out[i] = svo_linear_to_srgb((float)(to_double(s->s[i]) / (n * scale)));
        break;
    case SVO_KIND_NORMAL_OCT32: {
        double x = to_double(s->s[0]), y = to_double(s->s[1]), z = to_double(s->s[2]);
        double l = sqrt(x * x + y * y + z * z);
        if (!(l > 1e-6 * n * scale)) return;
        float v[3] = {(float)(x / l), (float)(y / l), (float)(z / l)};
        svo_oct32_encode(v, out);
        break;
    }
    case SVO_KIND_UNORM8: out[0] = (uint8_t)((2 * (uint64_t)s->s[0] + s->n) / (2 * s->n)); break;
    case SVO_KIND_ID16:
    case SVO_KIND_ID32: break;
    }
}

void svoi_sum_values(svo_channel_kind kind, const uint32_t *values, uint32_t count, svoi_sum *sum)
{
    int64_t s[3] = {0, 0, 0}, last[3] = {0, 0, 0};
    bool uniform = true;
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t value = values[i];
        uniform = uniform && value == values[0];
        if (kind == SVO_KIND_COLOR_SRGB8) {
            for (int k = 0; k < 3; k++) s[k] += (int64_t)((double)svo_srgb_to_linear((uint8_t)(value >> 8 * k)) * scale);
        } else if (kind == SVO_KIND_NORMAL_OCT32) {
            uint8_t bytes[4];
            float normal[3];
            memcpy(bytes, &value, sizeof bytes);
            if (i == 0 || value != values[i - 1]) {
                svo_oct32_decode(bytes, normal);
                for (int k = 0; k < 3; k++) last[k] = (int64_t)llrint((double)normal[k] * scale);
            }
            for (int k = 0; k < 3; k++) s[k] += last[k];
        } else {
            s[0] += value;
        }
    }
    *sum = (svoi_sum){.s = {s[0], s[1], s[2]}, .n = count, .first = values[0], .uniform = uniform};
}

/* --- labels --- */

void svoi_labels_free(svoi_labels *l)
{
    svo_free(l->a, l->label, l->capacity, sizeof *l->label);
    *l = (svoi_labels){.a = l->a};
}

static bool labels_reserve(svoi_labels *l, uint64_t need)
{
    if (need <= l->capacity) return true;
    uint64_t want = need + need / 2 + 8;
    svoi_label *to = svo_alloc(l->a, want, sizeof *to);
    if (to == NULL) return false;
    if (l->count != 0) memcpy(to, l->label, (size_t)l->count * sizeof *to);
    svo_free(l->a, l->label, l->capacity, sizeof *to);
    l->label = to;
    l->capacity = want;
    return true;
}

/* Merge the ascending lists [begin, middle) and [middle, count) of l in place; `spare` is scratch. */
static bool labels_join(svoi_labels *l, uint64_t begin, uint64_t middle, svoi_labels *spare)
{
    spare->count = 0;
    if (!labels_reserve(spare, middle - begin)) return false;
    memcpy(spare->label, l->label + begin, (size_t)(middle - begin) * sizeof *l->label);
    const svoi_label *p = spare->label, *p_end = p + (middle - begin), *q = l->label + middle, *q_end = l->label + l->count;
    svoi_label *to = l->label + begin; /* never overtakes q: at most one output for each input taken */
    while (p < p_end && q < q_end) {
        if (p->id == q->id) {
            svoi_label both = {p->voxels + q->voxels, p->id};
            *to++ = both;
            p++, q++;
        } else if (p->id < q->id) {
            *to++ = *p++;
        } else {
            *to++ = *q++;
        }
    }
    while (p < p_end) *to++ = *p++;
    while (q < q_end) *to++ = *q++;
    l->count = (uint64_t)(to - l->label);
    return true;
}

bool svoi_labels_merge(svoi_labels *to, const svoi_label *more, uint64_t count)
{
    uint64_t middle = to->count;
    if (!labels_reserve(to, middle + count)) return false;
    if (count != 0) memcpy(to->label + middle, more, (size_t)count * sizeof *more);
    to->count += count;
    if (middle == 0 || count == 0) return true;
    svoi_labels spare = {.a = to->a};
    bool ok = labels_join(to, 0, middle, &spare);
    svoi_labels_free(&spare);
    return ok;
}

void svoi_labels_value(const svoi_label *l, uint64_t count, svo_channel_kind kind, uint8_t *out)
{
    uint64_t best = 0;
    for (uint64_t i = 1; i < count; i++)
        if (l[i].voxels > l[best].voxels) best = i; /* ascending ids: a tie stays with the smaller */
    svoi_store_value(out, svo_channel_stride(kind), l[best].id);
}

/* --- one channel of one chunk --- */

typedef struct walk {
    const svo_chunk *c;
    svo_channel_kind kind;
    uint32_t stride;
    const uint8_t *in; /* next finest voxel's value */
    const uint8_t *mask;
    bool averaged; /* nodes of the lowest two levels have no attributes of their own */
    uint8_t *out; /* next attribute */
    uint32_t last_value; /* cache of the decoded normal */
    int64_t last[3];
    svoi_labels stack, spare; /* of labels: lists of the open nodes, one behind another */
    bool failed;
    int64_t linear[256];
} walk;

static void sum_voxels(walk *w, uint32_t n, svoi_sum *sum)
{
    const uint8_t *v = w->in;
    uint32_t stride = w->stride, first = svoi_load_value(v, stride);
    int64_t s[3] = {0, 0, 0};
    bool uniform = true;
    for (uint32_t i = 0; i < n; i++, v += stride) {
        uint32_t value = svoi_load_value(v, stride);
        if (value != first) uniform = false;
        switch (w->kind) {
        case SVO_KIND_COLOR_SRGB8:
            s[0] += w->linear[v[0]];
            s[1] += w->linear[v[1]];
            s[2] += w->linear[v[2]];
            break;
        case SVO_KIND_NORMAL_OCT32:
            if (value != w->last_value) {
                float normal[3];
                svo_oct32_decode(v, normal);
                for (int j = 0; j < 3; j++) w->last[j] = (int64_t)llrint((double)normal[j] * scale);
                w->last_value = value;
            }
            for (int j = 0; j < 3; j++) s[j] += w->last[j];
            break;
        case SVO_KIND_UNORM8: s[0] += v[0]; break;
        case SVO_KIND_ID16:
        case SVO_KIND_ID32: break;
        }
    }
    *sum = (svoi_sum){.s = {s[0], s[1], s[2]}, .n = n, .first = first, .uniform = uniform};
}

/* Copies of the next value, of a full leaf: one, or those of an octant, which has attributes of its own and of its voxels. */
static void put_full(walk *w, uint32_t height, bool lod)
{
    uint32_t copies = height != 1 ? 1 : lod ? 9 : 8;
    for (uint32_t i = 0; i < copies; i++, w->out += w->stride) memcpy(w->out, w->in, w->stride);
    w->in += w->stride;
}

/* The sum over all voxels of a full leaf of the next value. */
static void sum_full(walk *w, uint32_t height, svoi_sum *sum)
{
    sum_voxels(w, 1, sum);
    sum->n = (uint64_t)1 << 3 * height;
    for (int i = 0; i < 3; i++) sum->s[i] *= (svoi_wide)sum->n;
}

/* Of an inner node. */
static bool has_own(const walk *w, uint32_t level) { return !w->averaged || level + 2 < w->c->depth; }

/* Depth is bounded by SVO_CHUNK_LEVELS. */
static void walk_sums(walk *w, uint32_t level, svoi_sum *sum)
{
    uint32_t mask = *w->mask++, k = (uint32_t)__builtin_popcount(mask);
    if (mask == 0) {
        sum_full(w, w->c->depth - level, sum);
        put_full(w, w->c->depth - level, !w->averaged);
        return;
    }
    uint8_t *own = w->out;
    const bool stored = has_own(w, level);
    if (stored) w->out += w->stride;
    if (level + 1 == w->c->depth) {
        sum_voxels(w, k, sum);
        memcpy(w->out, w->in, (size_t)k * w->stride);
        w->in += (size_t)k * w->stride;
        w->out += (size_t)k * w->stride;
    } else {
        walk_sums(w, level + 1, sum);
        for (uint32_t i = 1; i < k; i++) {
            svoi_sum child;
            walk_sums(w, level + 1, &child);
            svoi_sum_add(sum, &child);
        }
    }
    if (stored) svoi_sum_value(sum, w->kind, own);
}

/* Leaves the node's list on top of the stack. */
static void walk_labels(walk *w, uint32_t level)
{
    uint32_t mask = *w->mask++, k = (uint32_t)__builtin_popcount(mask);
    if (mask == 0) {
        uint32_t height = w->c->depth - level;
        if (!labels_reserve(&w->stack, w->stack.count + 1)) w->failed = true;
        else w->stack.label[w->stack.count++] = (svoi_label){(uint64_t)1 << 3 * height, svoi_load_value(w->in, w->stride)};
        put_full(w, height, !w->averaged);
        return;
    }
    uint8_t *own = w->out;
    uint64_t begin = w->stack.count;
    const bool stored = has_own(w, level);
    if (stored) w->out += w->stride;
    for (uint32_t i = 0; i < k && !w->failed; i++) {
        uint64_t middle = w->stack.count;
        if (level + 1 == w->c->depth) {
            if (!labels_reserve(&w->stack, middle + 1)) w->failed = true;
            else w->stack.label[w->stack.count++] = (svoi_label){1, svoi_load_value(w->in, w->stride)};
            memcpy(w->out, w->in, w->stride);
            w->in += w->stride;
            w->out += w->stride;
        } else {
            walk_labels(w, level + 1);
        }
        if (i != 0 && !w->failed && !labels_join(&w->stack, begin, middle, &w->spare)) w->failed = true;
    }
    if (!w->failed && stored) svoi_labels_value(w->stack.label + begin, w->stack.count - begin, w->kind, own);
}

/* The values alone, in order. */
static void walk_values(walk *w)
{
    const svo_chunk *c = w->c;
    uint8_t left[SVO_CHUNK_LEVELS + 1];
    uint32_t l = 0, levels = c->depth - c->level;
    if (c->node_count == 0) {
        memcpy(w->out, w->in, w->stride);
        return;
    }
    for (uint64_t i = 0; i < c->node_count; i++) {
        uint32_t k = (uint32_t)__builtin_popcount(c->masks[i]);
        if (k != 0 && l + 1 < levels) {
            left[l++] = (uint8_t)k;
            continue;
        }
        if (k == 0) put_full(w, levels - l, false);
        memcpy(w->out, w->in, (size_t)k * w->stride);
        w->out += (size_t)k * w->stride;
        w->in += (size_t)k * w->stride;
        while (l > 0 && --left[l - 1] == 0) l--;
    }
}

svo_result svoi_chunk_attributes(const svo_chunk *c, uint32_t channel, svo_channel_kind kind, bool lod, bool averaged,
                                 uint32_t virtual_levels, uint8_t *out, svoi_sum *sum, svoi_labels *labels)
{
    walk w = {.c = c, .kind = kind, .stride = svo_channel_stride(kind), .in = c->channels[channel], .mask = c->masks, .averaged = averaged};
    if (averaged) virtual_levels = 0; /* they are the brick, or its first octant */
    w.out = out;
    if (!lod) {
        walk_values(&w);
        return SVO_OK;
    }
    if (kind == SVO_KIND_COLOR_SRGB8)
        for (uint32_t i = 0; i < 256; i++) w.linear[i] = (int64_t)((double)svo_srgb_to_linear((uint8_t)i) * scale);
    if (kind == SVO_KIND_NORMAL_OCT32) w.last[2] = (int64_t)scale; /* value 0 is +Z */
    uint8_t *root = out + (size_t)virtual_levels * w.stride;
    w.out = root;
    w.stack.a = w.spare.a = labels->a;
    if (c->node_count == 0) { /* a full leaf, or depth 0: the voxel is the root */
        uint32_t height = c->depth - c->level;
        memcpy(root, w.in, w.stride);
        if (svoi_is_label(kind)) w.failed = !svoi_labels_merge(labels, &(svoi_label){(uint64_t)1 << 3 * height, svoi_load_value(w.in, w.stride)}, 1);
        else sum_full(&w, height, sum);
    } else if (svoi_is_label(kind)) {
        walk_labels(&w, c->level);
        if (!w.failed) {
            svoi_labels_free(labels);
            *labels = w.stack;
            w.stack = (svoi_labels){.a = labels->a};
        }
    } else {
        walk_sums(&w, c->level, sum);
    }
    svoi_labels_free(&w.stack);
    svoi_labels_free(&w.spare);
    if (w.failed) return SVO_OUT_OF_MEMORY;
    for (uint32_t i = 0; i < virtual_levels; i++) memcpy(out + (size_t)i * w.stride, root, w.stride);
    return SVO_OK;
}
