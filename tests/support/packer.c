#include "packer.h"

#include <stdlib.h>
#include <string.h>

#include "svo_morton.h"

typedef struct words { uint32_t *data; uint64_t count, capacity, nodes; uint64_t *starts; } words;

typedef struct packer {
    svo_view view; /* first: freed through it */
    packer_options options;
    words levels[SVO_MAX_DEPTH];
    uint64_t *bricks, brick_capacity;
    uint8_t *values[SVO_MAX_CHANNELS];
    uint64_t value_capacity;
    const uint64_t *codes;
} packer;

static void *grow(void *p, uint64_t size)
{
    p = realloc(p, size != 0 ? size : 1);
    if (p == NULL) abort();
    return p;
}

static int compare_codes(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

/* The channel values of an entry over codes [begin, end). */
static void set_values(packer *p, uint64_t index, uint64_t begin, uint64_t end)
{
    if (index >= p->value_capacity) {
        p->value_capacity = 2 * index + 64;
        for (uint32_t c = 0; c < p->options.channel_count; c++)
            p->values[c] = grow(p->values[c], p->value_capacity * SVO_MAX_STRIDE);
    }
    for (uint32_t c = 0; c < p->options.channel_count; c++) {
        svo_channel_kind kind = p->options.channels[c].kind;
        uint32_t stride = svo_channel_stride(kind);
        svo_average average = {0};
        uint8_t value[SVO_MAX_STRIDE], first[SVO_MAX_STRIDE] = {0};
        for (uint64_t i = begin; i < end; i++) {
            uint32_t x, y, z;
            svo_morton_decode(p->codes[i], &x, &y, &z);
            p->options.value(p->options.user, c, x, y, z, value);
            if (i == begin) memcpy(first, value, sizeof first);
            svo_average_add(&average, kind, value, 1);
        }
        if (end - begin > 1) svo_average_get(&average, kind, first, first);
        memcpy(p->values[c] + index * stride, first, stride);
    }
}

static uint32_t add_brick(packer *p, uint64_t brick)
{
    svo_view *v = &p->view;
    if (p->options.share)
        for (uint64_t i = 0; i < v->brick_count; i++)
            if (p->bricks[i] == brick) return (uint32_t)i;
    if (v->brick_count == p->brick_capacity) {
        p->brick_capacity = 2 * p->brick_capacity + 16;
        p->bricks = grow(p->bricks, p->brick_capacity * 8);
    }
    p->bricks[v->brick_count] = brick;
    return (uint32_t)v->brick_count++;
}

static uint32_t add_node(packer *p, uint32_t level, const uint32_t *node, uint32_t count)
{
    words *w = &p->levels[level];
    if (p->options.share)
        for (uint64_t i = 0; i < w->nodes; i++)
            if (w->starts[i] + count <= w->count && memcmp(w->data + w->starts[i], node, count * 4) == 0) return (uint32_t)w->starts[i];
    if (w->count + count > w->capacity) {
        w->capacity = 2 * w->capacity + 64;
        w->data = grow(w->data, w->capacity * 4);
        w->starts = grow(w->starts, w->capacity * 8);
    }
    memcpy(w->data + w->count, node, count * 4);
    w->starts[w->nodes++] = w->count;
    w->count += count;
    return (uint32_t)(w->count - count);
}

/* Pack codes [begin, end), which lie in one node of `level`, with its first attribute at *next; returns its reference. */
static uint32_t pack(packer *p, uint32_t level, uint64_t begin, uint64_t end, uint64_t *next)
{
    svo_view *v = &p->view;
    uint64_t start = *next;
    /* A tree of depth < 2 hangs below virtual levels: user level = tree level - (T - depth). */
    uint32_t above = v->tree_depth - v->depth;
    if (level >= above) v->nodes[level - above]++;
    if (level == v->tree_depth) {
        set_values(p, (*next)++, begin, end);
        return 0;
    }
    if (v->lod && (!v->averaged || level < v->brick_level)) set_values(p, (*next)++, begin, end);
    uint32_t shift = 3 * (v->tree_depth - 1 - level), mask = 0, k = 0, refs[8];
    uint64_t offsets[8];
    for (uint64_t i = begin; i < end;) {
        uint32_t octant = (uint32_t)(p->codes[i] >> shift & 7);
        uint64_t j = i + 1;
        while (j < end && (p->codes[j] >> shift & 7) == octant) j++;
        mask |= 1u << octant;
        offsets[k] = *next - start;
        refs[k++] = pack(p, level + 1, i, j, next);
        i = j;
    }
    if (level > v->brick_level) return 0;
    if (level == v->brick_level) {
        uint64_t brick = 0;
        for (uint64_t i = begin; i < end; i++) brick |= (uint64_t)1 << (p->codes[i] & 63);
        return add_brick(p, brick);
    }
    uint32_t node[24], count = 0;
    node[count++] = mask;
    for (uint32_t i = 0; i < k; i++) node[count++] = refs[i];
    for (uint32_t i = 1; i < k && !v->unnumbered; i++) {
        node[count++] = (uint32_t)offsets[i];
        if (v->levels[level].offset_words == 2) node[count++] = (uint32_t)(offsets[i] >> 32);
    }
    return add_node(p, level, node, count);
}

static void begin_view(svo_view *v, uint32_t depth, bool lod, const double *voxel_to_world)
{
    v->layout = SVO_LAYOUT_PLAIN;
    v->depth = depth;
    v->tree_depth = depth < 2 ? 2 : depth;
    v->brick_level = v->tree_depth - 2;
    v->lod = lod;
    for (int i = 0; i < 16; i++) v->voxel_to_world[i] = voxel_to_world ? voxel_to_world[i] : i % 5 == 0;
}

svo_view *packer_make(uint32_t depth, const uint64_t *codes, uint64_t count, const packer_options *options)
{
    static const packer_options none;
    packer *p = calloc(1, sizeof *p);
    if (p == NULL) abort();
    p->options = options ? *options : none;
    svo_view *v = &p->view;
    begin_view(v, depth, p->options.lod, p->options.voxel_to_world);
    v->unnumbered = p->options.unnumbered;
    v->averaged = v->lod && p->options.averaged;
    for (uint32_t l = 0; l < v->brick_level; l++) v->levels[l].offset_words = v->unnumbered ? 0 : p->options.offset_words == 2 ? 2 : 1;
    uint64_t *sorted = grow(NULL, count * 8), unique = 0, next = 0;
    if (count != 0) memcpy(sorted, codes, count * 8);
    qsort(sorted, count, 8, compare_codes);
    for (uint64_t i = 0; i < count; i++)
        if (i == 0 || sorted[i] != sorted[i - 1]) sorted[unique++] = sorted[i];
    p->codes = sorted;
    v->empty = unique == 0;
    if (!v->empty) v->root = pack(p, 0, 0, unique, &next);
    v->attribute_count = next;
    for (uint32_t l = 0; l < v->brick_level; l++) {
        v->levels[l].words = p->levels[l].data;
        v->levels[l].word_count = p->levels[l].count, v->levels[l].node_count = p->levels[l].nodes;
    }
    v->bricks = p->bricks;
    v->channel_count = p->options.channel_count;
    for (uint32_t c = 0; c < v->channel_count; c++) {
        v->channels[c].channel = p->options.channels[c];
        v->channels[c].encoding = p->options.channels[c].constant ? SVO_ENCODING_CONSTANT : SVO_ENCODING_RAW;
        v->channels[c].raw = p->options.channels[c].constant ? NULL : p->values[c];
    }
    free(sorted);
    return v;
}

svo_view *packer_solid(uint32_t depth, bool lod)
{
    packer *p = calloc(1, sizeof *p);
    if (p == NULL) abort();
    svo_view *v = &p->view;
    begin_view(v, depth, lod, NULL);
    if (depth < 2) abort();
    p->options.share = true;
    v->root = add_brick(p, ~(uint64_t)0);
    v->bricks = p->bricks;
    uint64_t entries = lod ? 73 : 64, nodes = 1;
    for (uint32_t l = v->brick_level; l-- > 0;) {
        uint32_t node[24] = {0xff}, count = 9;
        for (uint32_t i = 0; i < 8; i++) node[1 + i] = v->root;
        for (uint64_t i = 1; i < 8; i++) {
            uint64_t offset = i * entries + (lod ? 1 : 0);
            node[count++] = (uint32_t)offset;
            node[count++] = (uint32_t)(offset >> 32);
        }
        v->levels[l].offset_words = 2;
        v->root = add_node(p, l, node, count);
        v->levels[l].words = p->levels[l].data;
        v->levels[l].word_count = p->levels[l].count, v->levels[l].node_count = 1;
        entries = 8 * entries + (lod ? 1 : 0);
    }
    v->attribute_count = entries;
    for (uint32_t l = 0; l <= depth; l++, nodes *= 8) v->nodes[l] = nodes;
    return v;
}

void packer_free(svo_view *view)
{
    if (view == NULL) return;
    packer *p = (packer *)view;
    for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) free(p->levels[l].data), free(p->levels[l].starts);
    for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) free(p->values[c]);
    free(p->bricks);
    free(p);
}
