#include "trees.h"

#include <stdlib.h>
#include <string.h>

#include "fmt_svo.h"
#include "svo_morton.h"
#include "svo_task.h"
#include "test.h"

static int compare_codes(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return x < y ? -1 : x > y;
}

static void set_channel(tree *t, const char *name, svo_channel_kind kind)
{
    svo_channel *c = &t->info.channels[t->info.channel_count++];
    strncpy(c->name, name, sizeof c->name - 1);
    c->kind = kind;
}

/* Sort, drop duplicates, fill the channels. */
static void finish(tree *t, uint64_t *seed)
{
    qsort(t->codes, t->count, sizeof *t->codes, compare_codes);
    uint64_t n = 0;
    for (uint64_t i = 0; i < t->count; i++)
        if (n == 0 || t->codes[n - 1] != t->codes[i]) t->codes[n++] = t->codes[i];
    t->count = n;
    for (uint32_t c = 0; c < t->info.channel_count; c++) {
        const svo_channel *channel = &t->info.channels[c];
        if (channel->constant) continue;
        uint32_t stride = svo_channel_stride(channel->kind);
        t->values[c] = malloc(t->capacity * stride + 1);
        for (uint64_t i = 0; i < t->count * stride; i++) {
            uint8_t v = (uint8_t)test_random(seed);
            if (channel->kind == SVO_KIND_NORMAL_OCT32 && i % 2 == 1 && v == 0x80) v = 0x81;
            t->values[c][i] = v;
        }
    }
}

static void begin(tree *t, uint32_t depth, uint64_t capacity)
{
    static const double matrix[16] = {0.5, 0, 0, -3, 0, 0.25, 0.125, 4, 0, 0, 2, 1e6, 0, 0, 0, 1};
    memset(t, 0, sizeof *t);
    t->info.depth = depth;
    memcpy(t->info.voxel_to_world, matrix, sizeof matrix);
    t->capacity = capacity;
    t->codes = malloc(capacity * sizeof *t->codes);
}

void tree_random(tree *t, uint32_t depth, uint32_t style, uint64_t *seed)
{
    uint64_t side = (uint64_t)1 << depth;
    begin(t, depth, 4096);
    if (style == 0) {
        t->count = 1 + test_random(seed) % 100;
        for (uint64_t i = 0; i < t->count; i++) t->codes[i] = test_random(seed) & (((uint64_t)1 << 3 * depth) - 1);
    } else if (style == 1) {
        t->info.surface = SVO_SURFACE_THIN;
        set_channel(t, "color", SVO_KIND_COLOR_SRGB8);
        set_channel(t, "normal", SVO_KIND_NORMAL_OCT32);
        set_channel(t, "metallic", SVO_KIND_UNORM8);
        set_channel(t, "material", SVO_KIND_ID16);
        set_channel(t, "bone", SVO_KIND_ID32);
        t->count = t->capacity;
        uint64_t at[3] = {0, 0, 0};
        for (uint64_t i = 0; i < t->count; i++) {
            for (int k = 0; k < 3; k++) {
                if (i % 300 == 0) at[k] = test_random(seed);
                at[k] = (at[k] + test_random(seed) % 3 + side - 1) % side;
            }
            t->codes[i] = svo_morton_encode((uint32_t)at[0], (uint32_t)at[1], (uint32_t)at[2]);
        }
    } else {
        t->info.fill = SVO_FILL_SOLID;
        set_channel(t, "roughness", SVO_KIND_UNORM8);
        t->info.channels[0].constant = true;
        t->info.channels[0].value[0] = 77;
        set_channel(t, "emissive", SVO_KIND_COLOR_SRGB8);
        t->count = 8;
        for (uint32_t i = 0; i < 8; i++) {
            uint32_t last = (uint32_t)(side - 1);
            t->codes[i] = svo_morton_encode(i & 1 ? last : 0, i & 2 ? last : 0, i & 4 ? last : 0);
        }
    }
    finish(t, seed);
}

void tree_full(tree *t, uint32_t depth, uint64_t *seed)
{
    uint64_t n = (uint64_t)1 << 3 * depth;
    begin(t, depth, n);
    set_channel(t, "color", SVO_KIND_COLOR_SRGB8);
    for (uint64_t i = 0; i < n; i++) t->codes[i] = i;
    t->count = n;
    finish(t, seed);
}

void tree_free(tree *t)
{
    free(t->codes);
    for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) free(t->values[c]);
    memset(t, 0, sizeof *t);
}

uint64_t tree_chunk(const tree *t, uint64_t first, svo_buffer *masks, svo_chunk *chunk)
{
    uint32_t depth = t->info.depth, level = svo_chunk_level(depth), levels = depth - level;
    uint64_t code = t->codes[first] >> 3 * levels, end = first;
    size_t open[SVO_CHUNK_LEVELS] = {0}; /* where the mask of the current node of each level is */
    masks->size = 0;
    while (end < t->count && t->codes[end] >> 3 * levels == code) {
        uint64_t v = t->codes[end];
        /* the highest level at which this voxel's path leaves the one before */
        uint32_t from = 0;
        if (end != first)
            while (from + 1 < levels && v >> 3 * (levels - 1 - from) == t->codes[end - 1] >> 3 * (levels - 1 - from)) from++;
        for (uint32_t l = from; l < levels; l++) {
            bool fresh = end == first || l > from;
            if (fresh) {
                open[l] = masks->size;
                svo_buffer_append(masks, NULL, 1);
            }
            masks->data[open[l]] |= (uint8_t)(1u << (v >> 3 * (levels - 1 - l) & 7));
        }
        end++;
    }
    svo_chunk c = {.code = code, .level = level, .depth = depth, .node_count = masks->size, .value_count = end - first, .masks = masks->data};
    for (uint32_t i = 0; i < t->info.channel_count; i++)
        if (!t->info.channels[i].constant) c.channels[i] = t->values[i] + first * svo_channel_stride(t->info.channels[i].kind);
    *chunk = c;
    return end;
}

typedef struct feed { const tree *t; svo_chunk_sink sink; uint64_t next; } feed;
typedef struct feed_item { uint64_t first; void *blob; } feed_item;

static svo_result feed_produce(void *user, void *item, bool *more, svo_error *err)
{
    (void)err;
    feed *f = user;
    feed_item *i = item;
    uint32_t shift = 3 * (f->t->info.depth - svo_chunk_level(f->t->info.depth));
    if (f->next == f->t->count) {
        *more = false;
        return SVO_OK;
    }
    i->first = f->next;
    while (f->next < f->t->count && f->t->codes[f->next] >> shift == f->t->codes[i->first] >> shift) f->next++;
    return SVO_OK;
}

static svo_result feed_work(void *user, void *item, uint32_t worker, svo_error *err)
{
    feed *f = user;
    feed_item *i = item;
    svo_buffer masks;
    svo_buffer_init(&masks, NULL);
    svo_chunk c;
    tree_chunk(f->t, i->first, &masks, &c);
    svo_result r = f->sink.encode(f->sink.user, &c, worker, &i->blob, err);
    svo_buffer_free(&masks);
    return r;
}

static svo_result feed_commit(void *user, void *item, svo_error *err)
{
    feed *f = user;
    feed_item *i = item;
    void *blob = i->blob;
    i->blob = NULL;
    return f->sink.commit(f->sink.user, blob, err);
}

static void feed_destroy(void *user, void *item)
{
    feed *f = user;
    feed_item *i = item;
    if (i->blob != NULL) f->sink.discard(f->sink.user, i->blob);
}

svo_result tree_feed(const tree *t, uint32_t threads, svo_chunk_sink sink, svo_error *err)
{
    feed f = {t, sink, 0};
    svo_pipeline p = {.threads = threads, .item_size = sizeof(feed_item), .user = &f, .produce = feed_produce, .work = feed_work,
                      .commit = feed_commit, .destroy = feed_destroy};
    return svo_pipeline_run(&p, err);
}

typedef struct check { const tree *t; uint64_t at; bool same; } check;

static bool check_voxel(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    check *c = user;
    c->same = c->same && c->at + index < c->t->count && c->t->codes[c->at + index] == svo_morton_encode(x, y, z);
    return c->same;
}

void tree_check(const tree *t, const svo_tree_info *info, svo_chunk_source source)
{
    svo_error err = {0};
    CHECK(memcmp(info, &t->info, sizeof *info) == 0);
    svo_buffer packed, storage;
    svo_buffer_init(&packed, NULL);
    svo_buffer_init(&storage, NULL);
    check c = {t, 0, true};
    for (;;) {
        bool more = false;
        svo_chunk chunk;
        CHECK_OK(source.fetch(source.user, &packed, &more, &err));
        if (!more) break;
        CHECK_OK(source.decode(source.user, &packed, &storage, &chunk, &err));
        svo_chunk_voxels(&chunk, check_voxel, &c);
        CHECK(c.same && c.at + chunk.value_count <= t->count);
        for (uint32_t i = 0; i < info->channel_count; i++) {
            uint32_t stride = svo_channel_stride(info->channels[i].kind);
            if (info->channels[i].constant) CHECK(chunk.channels[i] == NULL);
            else CHECK(memcmp(chunk.channels[i], t->values[i] + c.at * stride, chunk.value_count * stride) == 0);
        }
        c.at += chunk.value_count;
    }
    CHECK_U64(c.at, t->count);
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
}

void tree_write_as(const tree *t, bool small, int level, uint32_t threads, svo_buffer *file, svo_tree_counts *counts)
{
    svo_error err = {0};
    fmt_output *out;
    fmt_svo_writer *w;
    CHECK_OK(fmt_output_open_memory(file, &out, &err));
    CHECK_OK(fmt_svo_writer_begin(out, &t->info, "{\"tool\":\"test\"}", level, NULL, &w, &err));
    if (small) CHECK_OK(fmt_svo_writer_small(w, &err));
    CHECK_OK(tree_feed(t, threads, fmt_svo_writer_sink(w), &err));
    CHECK_OK(fmt_svo_writer_end(w, counts, &err));
    CHECK_OK(fmt_output_commit(out, &err));
}

void tree_write(const tree *t, uint32_t threads, svo_buffer *file, svo_tree_counts *counts) { tree_write_as(t, false, 3, threads, file, counts); }

void tree_write_small(const tree *t, uint32_t threads, svo_buffer *file, svo_tree_counts *counts) { tree_write_as(t, true, 0, threads, file, counts); }
