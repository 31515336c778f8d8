#include "svo_hierarchy.h"

#include <string.h>

#include "svo_task.h"

struct svo_hierarchy {
    svo_view view;
    const svo_allocator *allocator;
    svo_buffer words[SVO_MAX_DEPTH], bricks, values[SVO_MAX_CHANNELS];
};

/* A node of the level being worked on, or a full leaf. */
typedef struct item {
    uint64_t code; /* on its level */
    uint32_t ref;  /* word or brick; FULL */
    uint32_t first; /* number of its first value */
} item;
enum { FULL = UINT32_MAX };

typedef struct builder {
    const svo_hierarchy_input *in;
    svo_hierarchy *h;
    const svo_allocator *allocator;
    svo_buffer leaves[SVO_MAX_DEPTH + 1]; /* item: full leaves of a level */
    svo_buffer nodes[2];                  /* item */
    svo_buffer weights;                   /* double: of a cell's samples */
    uint64_t values;
} builder;

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the octree of deformed voxels"); }

const svo_view *svo_hierarchy_view(const svo_hierarchy *h) { return &h->view; }

void svo_hierarchy_free(svo_hierarchy *h)
{
    if (h == NULL) return;
    for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) svo_buffer_free(&h->words[l]);
    for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) svo_buffer_free(&h->values[c]);
    svo_buffer_free(&h->bricks);
    svo_free(h->allocator, h, 1, sizeof *h);
}

/* ---- values --------------------------------------------------------------------------------------------------------- */

/* Samples of a cell: its own are [begin, end), those of finer cells inside it [end, inside). */
typedef struct cell_samples { uint64_t begin, end, inside; } cell_samples;

static cell_samples samples_at(const svo_hierarchy_input *in, uint64_t begin)
{
    const svo_sample *s = in->samples;
    const uint64_t behind = s[begin].code + ((uint64_t)1 << 3 * (in->depth - s[begin].level));
    cell_samples c = {begin, begin + 1, 0};
    while (c.end < in->sample_count && s[c.end].code == s[begin].code && s[c.end].level == s[begin].level) c.end++;
    for (c.inside = c.end; c.inside < in->sample_count && s[c.inside].code < behind;) c.inside++;
    return c;
}

/* `times` copies of the value of a cell, which is stored as cells of `level`. */
static bool put_values(builder *b, cell_samples of, uint32_t level, uint32_t times)
{
    const uint64_t i = of.begin, end = of.end;
    const svo_hierarchy_input *in = b->in;
    double *weights = NULL;
    b->values += times;
    for (uint32_t c = 0; c < in->channel_count; c++) {
        svo_channel_kind kind = in->channels[c].kind;
        uint32_t stride = svo_channel_stride(kind);
        const uint8_t *first = in->values[c] + (uint64_t)in->samples[i].value * stride;
        uint8_t value[SVO_MAX_STRIDE];
        memcpy(value, first, stride);
        bool same = true;
        for (uint64_t k = i + 1; k < end && same; k++) same = memcmp(first, in->values[c] + (uint64_t)in->samples[k].value * stride, stride) == 0;
        if (!same) {
            svo_average sum = {0};
            if (weights == NULL && in->weigh != NULL) { /* once for all channels */
                b->weights.size = 0;
                weights = svo_buffer_append(&b->weights, NULL, (size_t)(end - i) * sizeof *weights);
                if (weights == NULL) return false;
                in->weigh(in->user, in->samples + i, end - i, weights);
            }
            for (uint64_t k = i; k < end; k++)
                svo_average_add(&sum, kind, in->values[c] + (uint64_t)in->samples[k].value * stride, weights != NULL ? weights[k - i] : 1);
            svo_average_get(&sum, kind, first, value);
        }
        if (in->merge != NULL && in->merge->channel == c) in->merge->merge(in->merge->user, in->samples + i, of.inside - i, level, value);
        for (uint32_t t = 0; t < times; t++)
            if (svo_buffer_append(&b->h->values[c], value, stride) == NULL) return false;
    }
    return true;
}

/* ---- cells to bricks and full leaves --------------------------------------------------------------------------------- */

static bool put_item(svo_buffer *to, uint64_t code, uint32_t ref, uint64_t first)
{
    item x = {code, ref, (uint32_t)first};
    return svo_buffer_append(to, &x, sizeof x) != NULL;
}

static svo_result take_cells(builder *b, svo_hierarchy_report *report, svo_error *err)
{
    const svo_hierarchy_input *in = b->in;
    svo_view *v = &b->h->view;
    uint32_t depth = in->depth;
    uint64_t brick = 0, brick_code = UINT64_MAX, brick_first = 0;
    cell_samples of;
    for (uint64_t i = 0; i < in->sample_count; i = of.inside) {
        const svo_sample *s = &in->samples[i];
        SVO_ASSERT(s->level <= depth && s->value < in->value_count && s->code >> 3 * depth == 0);
        uint64_t first = b->values;
        uint32_t below = depth - s->level;
        of = samples_at(in, i);
        report->cells++;
        uint32_t stored = s->level, times = 1;
        if (below == 1) stored = depth, times = 8;
        if (s->level == 0) stored = v->brick_level == 0 ? depth : 1, times = v->brick_level == 0 ? 64 : 8; /* see build */
        if (!put_values(b, of, stored, times)) return no_memory(err);
        if (below < 2) {
            if (s->code >> 6 != brick_code) {
                if (brick != 0 && (svo_buffer_append(&b->h->bricks, &brick, 8) == NULL || !put_item(&b->nodes[0], brick_code, (uint32_t)(v->brick_count++), brick_first)))
                    return no_memory(err);
                brick = 0, brick_code = s->code >> 6, brick_first = first;
            }
            brick |= (below == 1 ? (uint64_t)0xff : 1) << (s->code & 63);
            continue;
        }
        report->full_leaves++;
        if (!put_item(&b->leaves[s->level], s->code >> 3 * below, FULL, first)) return no_memory(err);
    }
    if (brick != 0 && (svo_buffer_append(&b->h->bricks, &brick, 8) == NULL || !put_item(&b->nodes[0], brick_code, (uint32_t)(v->brick_count++), brick_first)))
        return no_memory(err);
    if (b->values >= UINT32_MAX || v->brick_count >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "more than 2^32 - 1 deformed voxels");
    return SVO_OK;
}

/* ---- levels ---------------------------------------------------------------------------------------------------------- */

static void count_nodes(const builder *b, uint64_t nodes_of_level[SVO_MAX_DEPTH + 1])
{
    uint32_t depth = b->in->depth;
    for (uint32_t l = 0; l <= depth; l++)
        for (uint32_t at = l; at <= depth; at++) nodes_of_level[at] += b->leaves[l].size / sizeof(item) << 3 * (at - l);
    const uint64_t *bricks = (const uint64_t *)(const void *)b->h->bricks.data;
    for (uint64_t i = 0; i < b->h->view.brick_count; i++) {
        nodes_of_level[depth] += (uint64_t)__builtin_popcountll(bricks[i]);
        nodes_of_level[depth - 1] += (uint64_t)__builtin_popcountll(svo_brick_octants(bricks[i]));
    }
}

/* The nodes of `level` from those of the next level and the full leaves there, both in code order. */
static svo_result build_level(builder *b, uint32_t level, const svo_buffer *below, svo_buffer *to, svo_error *err)
{
    svo_hierarchy *h = b->h;
    const item *node = (const item *)(const void *)below->data, *leaf = (const item *)(const void *)b->leaves[level + 1].data;
    uint64_t n = below->size / sizeof *node, m = b->leaves[level + 1].size / sizeof *leaf, i = 0, j = 0, count = 0;
    bool numbered = b->in->channel_count != 0;
    to->size = 0;
    while (i < n || j < m) {
        item child[8];
        uint32_t k = 0, mask = 0, full = 0, refs = 0, w[1 + 8 + 7], words = 1;
        uint64_t parent = (j == m || (i < n && node[i].code < leaf[j].code) ? node[i].code : leaf[j].code) >> 3;
        for (;;) {
            bool has_node = i < n && node[i].code >> 3 == parent, has_leaf = j < m && leaf[j].code >> 3 == parent;
            if (!has_node && !has_leaf) break;
            child[k] = !has_leaf || (has_node && node[i].code < leaf[j].code) ? node[i++] : leaf[j++];
            mask |= 1u << (child[k].code & 7);
            if (child[k].ref == FULL) full |= 1u << (child[k].code & 7);
            else refs++;
            k++;
        }
        w[0] = mask | full << 8;
        for (uint32_t c = 0; c < k; c++)
            if (child[c].ref != FULL) w[words++] = child[c].ref;
        for (uint32_t c = 1; c < k && numbered; c++) w[words++] = child[c].first - child[0].first;
        if (!put_item(to, parent, (uint32_t)(h->words[level].size / 4), child[0].first) || svo_buffer_append(&h->words[level], w, 4 * words) == NULL)
            return no_memory(err);
        if (h->words[level].size / 4 > UINT32_MAX - 16) return svo_fail(err, SVO_LIMIT, "more than 2^32 words of nodes on level %u", level);
        count++;
    }
    h->view.levels[level] = (svo_view_level){.words = (const uint32_t *)(const void *)h->words[level].data, .word_count = h->words[level].size / 4,
                                             .node_count = count, .offset_words = numbered ? 1 : 0};
    h->view.nodes[level] += count;
    return SVO_OK;
}

static svo_result build(builder *b, svo_hierarchy_report *report, svo_error *err)
{
    svo_hierarchy *h = b->h;
    svo_view *v = &h->view;
    const svo_hierarchy_input *in = b->in;
    v->depth = v->tree_depth = in->depth;
    v->brick_level = in->depth - 2;
    v->layout = SVO_LAYOUT_PLAIN;
    v->unnumbered = in->channel_count == 0;
    memcpy(v->voxel_to_world, in->voxel_to_world, sizeof v->voxel_to_world);
    v->surface = SVO_SURFACE_CONSERVATIVE;
    v->fill = SVO_FILL_SURFACE;
    v->channel_count = in->channel_count;
    SVO_TRY(take_cells(b, report, err));
    count_nodes(b, v->nodes);
    v->bricks = (const uint64_t *)(const void *)h->bricks.data;
    v->nodes[v->brick_level] += v->brick_count;
    /* A cell that is the whole root has no parent to be a leaf of: the root's eight children are. */
    bool whole = b->leaves[0].size != 0;
    for (uint64_t c = 0; c < 8 && whole; c++)
        if (!put_item(&b->leaves[1], c, FULL, c)) return no_memory(err);
    svo_buffer *below = &b->nodes[0], *to = &b->nodes[1], *t;
    if (v->brick_level == 0 && whole) { /* all of 4^3 */
        uint64_t all = UINT64_MAX;
        if (svo_buffer_append(&h->bricks, &all, 8) == NULL) return no_memory(err);
        v->bricks = (const uint64_t *)(const void *)h->bricks.data;
        v->brick_count = 1;
    }
    for (uint32_t level = v->brick_level; level-- > 0;) {
        SVO_TRY(build_level(b, level, below, to, err));
        t = below, below = to, to = t;
    }
    if (whole) v->nodes[0] = 1;
    for (uint32_t c = 0; c < in->channel_count; c++) {
        v->channels[c].channel = in->channels[c];
        v->channels[c].encoding = SVO_ENCODING_RAW;
        v->channels[c].raw = h->values[c].data;
        report->bytes += h->values[c].size;
    }
    v->attribute_count = in->channel_count != 0 ? b->values : 0;
    for (uint32_t l = 0; l < v->brick_level; l++) report->bytes += h->words[l].size;
    report->bytes += h->bricks.size;
    report->voxels = v->nodes[in->depth];
    return SVO_OK;
}

static void make_empty(svo_hierarchy *h, const svo_hierarchy_input *in)
{
    svo_view *v = &h->view;
    v->empty = true;
    v->depth = v->tree_depth = in->depth;
    v->brick_level = in->depth - 2;
    v->layout = SVO_LAYOUT_PLAIN;
    v->unnumbered = true;
    memcpy(v->voxel_to_world, in->voxel_to_world, sizeof v->voxel_to_world);
    v->channel_count = in->channel_count;
    for (uint32_t c = 0; c < in->channel_count; c++) {
        v->channels[c].channel = in->channels[c];
        v->channels[c].channel.constant = true;
    }
}

svo_result svo_hierarchy_build(const svo_hierarchy_input *in, uint32_t threads, const svo_allocator *a, svo_hierarchy **out,
                               svo_hierarchy_report *report, svo_error *err)
{
    SVO_ASSERT(in->depth >= 2 && in->depth <= SVO_MAX_DEPTH);
    svo_hierarchy_report r = {.samples = in->sample_count};
    double began = svo_seconds();
    svo_sample *scratch = svo_alloc(a, in->sample_count, sizeof *scratch);
    svo_hierarchy *h = svo_calloc(a, 1, sizeof *h);
    svo_result result = h == NULL || (scratch == NULL && in->sample_count != 0) ? no_memory(err) : SVO_OK;
    if (result == SVO_OK) result = svo_sort_samples(in->samples, scratch, in->sample_count, threads, err);
    svo_free(a, scratch, in->sample_count, sizeof *scratch);
    if (result != SVO_OK) {
        svo_free(a, h, 1, sizeof *h);
        return result;
    }
    double sorted = svo_seconds();
    h->allocator = a;
    builder b = {.in = in, .h = h, .allocator = a};
    for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) svo_buffer_init(&h->words[l], a);
    for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) svo_buffer_init(&h->values[c], a);
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) svo_buffer_init(&b.leaves[l], a);
    svo_buffer_init(&h->bricks, a);
    svo_buffer_init(&b.nodes[0], a);
    svo_buffer_init(&b.nodes[1], a);
    svo_buffer_init(&b.weights, a);
    if (in->sample_count == 0) make_empty(h, in);
    else result = build(&b, &r, err);
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) svo_buffer_free(&b.leaves[l]);
    svo_buffer_free(&b.nodes[0]);
    svo_buffer_free(&b.nodes[1]);
    svo_buffer_free(&b.weights);
    if (result != SVO_OK) {
        svo_hierarchy_free(h);
        return result;
    }
    r.seconds_sort = sorted - began;
    r.seconds_build = svo_seconds() - sorted;
    if (report != NULL) *report = r;
    *out = h;
    return SVO_OK;
}
