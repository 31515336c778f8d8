/* svo-dump of a .svo: chunks are decoded by all threads and folded in order. */
#include <math.h>
#include <string.h>

#include "dump.h"
#include "fmt_svo.h"
#include "svo_task.h"

/* A bit for each value that a channel of up to 3 bytes can have. */
typedef struct seen { uint32_t *bits; uint64_t values; } seen;

typedef struct walk {
    const dump_job *job;
    const svo_tree_info *info;
    svo_chunk_source source;
    seen seen[SVO_MAX_CHANNELS];
    bool any;
    uint32_t low[3], high[3];
    uint64_t id_low[SVO_MAX_CHANNELS], id_high[SVO_MAX_CHANNELS];
    uint64_t values, expected_values, expected; /* expected: finest voxels */
    dump_ply *ply;
} walk;

typedef struct item {
    bool ready; /* buffers initialised */
    svo_buffer packed, storage;
    svo_chunk chunk;
    uint32_t low[3], high[3];
    uint64_t id_low[SVO_MAX_CHANNELS], id_high[SVO_MAX_CHANNELS];
} item;

static svo_result produce(void *user, void *p, bool *more, svo_error *err)
{
    walk *w = user;
    item *i = p;
    if (!i->ready) {
        svo_buffer_init(&i->packed, w->job->allocator);
        svo_buffer_init(&i->storage, w->job->allocator);
        i->ready = true;
    }
    return w->source.fetch(w->source.user, &i->packed, more, err);
}

static bool grow_bounds(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    (void)index;
    item *i = user;
    for (int k = 0; k < 3; k++) {
        if (low[k] < i->low[k]) i->low[k] = low[k];
        if (low[k] + size - 1 > i->high[k]) i->high[k] = low[k] + size - 1;
    }
    return true;
}

static uint64_t load_value(const uint8_t *v, uint32_t stride)
{
    uint64_t n = 0;
    for (uint32_t i = 0; i < stride; i++) n |= (uint64_t)v[i] << 8 * i;
    return n;
}

static void mark_values(walk *w, item *i)
{
    for (uint32_t c = 0; c < w->info->channel_count; c++) {
        const uint8_t *values = i->chunk.channels[c];
        if (values == NULL) continue;
        uint32_t stride = svo_channel_stride(w->info->channels[c].kind), *bits = w->seen[c].bits;
        i->id_low[c] = UINT64_MAX;
        i->id_high[c] = 0;
        for (uint64_t k = 0; k < i->chunk.value_count; k++) {
            uint64_t v = load_value(values + k * stride, stride);
            if (v < i->id_low[c]) i->id_low[c] = v;
            if (v > i->id_high[c]) i->id_high[c] = v;
            if (bits == NULL) continue;
            uint32_t bit = 1u << (v & 31);
            if ((__atomic_load_n(&bits[v >> 5], __ATOMIC_RELAXED) & bit) == 0) __atomic_fetch_or(&bits[v >> 5], bit, __ATOMIC_RELAXED);
        }
    }
}

static svo_result work(void *user, void *p, uint32_t worker, svo_error *err)
{
    (void)worker;
    walk *w = user;
    item *i = p;
    if (w->job->quick) return SVO_OK;
    SVO_TRY(w->source.decode(w->source.user, &i->packed, &i->storage, &i->chunk, err));
    memset(i->low, 0xff, sizeof i->low);
    memset(i->high, 0, sizeof i->high);
    svo_chunk_values(&i->chunk, grow_bounds, i);
    mark_values(w, i);
    return SVO_OK;
}

typedef struct rows { walk *w; const svo_chunk *chunk; svo_result result; svo_error *err; } rows;

static bool write_row(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    rows *r = user;
    const svo_tree_info *info = r->w->info;
    const uint8_t *values[SVO_MAX_CHANNELS] = {NULL};
    for (uint32_t c = 0; c < info->channel_count; c++)
        if (r->chunk->channels[c] != NULL) values[c] = r->chunk->channels[c] + index * svo_channel_stride(info->channels[c].kind);
    r->result = dump_ply_voxel(r->w->ply, x, y, z, values, r->err);
    return r->result == SVO_OK;
}

static svo_result commit(void *user, void *p, svo_error *err)
{
    walk *w = user;
    item *i = p;
    if (w->job->quick) return SVO_OK;
    for (int k = 0; k < 3; k++) {
        if (!w->any || i->low[k] < w->low[k]) w->low[k] = i->low[k];
        if (!w->any || i->high[k] > w->high[k]) w->high[k] = i->high[k];
    }
    for (uint32_t c = 0; c < w->info->channel_count; c++) {
        if (i->chunk.channels[c] == NULL) continue;
        if (!w->any || i->id_low[c] < w->id_low[c]) w->id_low[c] = i->id_low[c];
        if (!w->any || i->id_high[c] > w->id_high[c]) w->id_high[c] = i->id_high[c];
    }
    w->any = true;
    w->values += i->chunk.value_count;
    if (w->expected_values != 0) cli_progress(w->job->c, "reading", (double)w->values / (double)w->expected_values);
    if (w->ply == NULL) return SVO_OK;
    rows r = {w, &i->chunk, SVO_OK, err};
    svo_chunk_voxels(&i->chunk, write_row, &r);
    return r.result;
}

static void destroy(void *user, void *p)
{
    (void)user;
    item *i = p;
    if (!i->ready) return;
    svo_buffer_free(&i->packed);
    svo_buffer_free(&i->storage);
}

static uint64_t seen_words(const svo_channel *c)
{
    uint32_t stride = svo_channel_stride(c->kind);
    return c->constant || stride > 3 ? 0 : ((uint64_t)1 << 8 * stride) / 32;
}

static void put_attributes(const walk *w, json_t *o)
{
    json_t *list = json_array();
    for (uint32_t c = 0; c < w->info->channel_count; c++) {
        const svo_channel *channel = &w->info->channels[c];
        json_t *a = dump_channel(channel);
        uint64_t distinct = 0;
        for (uint64_t i = 0; w->seen[c].bits != NULL && i < seen_words(channel); i++) distinct += (uint64_t)__builtin_popcount(w->seen[c].bits[i]);
        if (channel->constant) distinct = 1;
        if (distinct != 0) cli_put_u64(a, "distinct", distinct);
        bool number = channel->kind == SVO_KIND_UNORM8 || channel->kind == SVO_KIND_ID16 || channel->kind == SVO_KIND_ID32;
        if (number && !channel->constant && w->any) {
            cli_put_u64(a, "min", w->id_low[c]);
            cli_put_u64(a, "max", w->id_high[c]);
        }
        json_array_append_new(list, a);
    }
    json_object_set_new(o, "attributes", list);
}

/* The numbers of finest voxels and of values, needed before the first row is written. The reader checks them at the end. */
static void read_stated(const fmt_container *c, walk *w)
{
    const fmt_chunk *stat = fmt_container_find(c, FMT_FOURCC('S', 'T', 'A', 'T'), true, 0);
    if (stat == NULL || stat->stored_size < 32) return;
    w->expected_values = fmt_load64(c->data + stat->offset + 16);
    w->expected = fmt_load64(c->data + stat->offset + stat->stored_size - 8);
}

static svo_result run(dump_job *j, walk *w, svo_error *err)
{
    for (uint32_t c = 0; c < w->info->channel_count && !j->quick; c++) {
        w->seen[c].values = seen_words(&w->info->channels[c]);
        if (w->seen[c].values == 0) continue;
        w->seen[c].bits = svo_calloc(j->allocator, w->seen[c].values, sizeof *w->seen[c].bits);
        if (w->seen[c].bits == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to count distinct values");
    }
    if (j->voxels != NULL) SVO_TRY(dump_ply_begin(j, w->expected, w->info->channels, w->info->channel_count, false, &w->ply, err));
    if (w->ply != NULL) dump_ply_place(w->ply, w->info->voxel_to_world, NULL, 0);
    svo_pipeline p = {.threads = (uint32_t)j->c->threads, .item_size = sizeof(item), .user = w, .produce = produce, .work = work,
                      .commit = commit, .destroy = destroy};
    SVO_TRY(svo_pipeline_run(&p, err));
    if (w->ply == NULL) return SVO_OK;
    dump_ply *ply = w->ply;
    w->ply = NULL;
    return dump_ply_end(ply, err);
}

static void put_shard(const fmt_svo_shard *s, json_t *o)
{
    json_t *shard = json_object();
    char job[33];
    fmt_hash_text(s->job, job);
    cli_put_u64(shard, "index", s->index);
    cli_put_u64(shard, "count", s->count);
    cli_put_u64(shard, "first_code", s->first_code);
    cli_put_u64(shard, "end_code", s->end_code);
    cli_put_text(shard, "job", job);
    json_object_set_new(o, "shard", shard);
}

svo_result dump_svo(dump_job *j, svo_error *err)
{
    fmt_container c;
    fmt_input *in = NULL;
    fmt_svo_reader *r = NULL;
    SVO_TRY(fmt_container_open(j->data, j->size, j->allocator, &c, err));
    walk w = {.job = j};
    read_stated(&c, &w);
    svo_result result = fmt_input_open_memory(j->data, j->size, &in, err);
    if (result == SVO_OK) result = fmt_svo_reader_open(in, j->allocator, &r, err);
    if (result == SVO_OK) {
        w.info = fmt_svo_reader_info(r);
        w.source = fmt_svo_reader_source(r);
        result = run(j, &w, err);
    }
    if (result == SVO_OK) {
        dump_container(j, &c);
        dump_grid(j->json, w.info->depth, w.info->voxel_to_world, w.info->surface, w.info->fill);
        if (!j->quick) dump_bounds(j->json, w.any, w.low, w.high, w.info->voxel_to_world);
        dump_counts(j->json, w.info->depth, fmt_svo_reader_counts(r)->nodes, j->size);
        cli_put_u64(j->json, "full_leaves", fmt_svo_reader_counts(r)->full_leaves);
        cli_put_u64(j->json, "values", fmt_svo_reader_counts(r)->values);
        if (fmt_svo_reader_shard(r) != NULL) put_shard(fmt_svo_reader_shard(r), j->json);
        put_attributes(&w, j->json);
        dump_sections(j, &c);
        dump_provenance(j->json, fmt_svo_reader_provenance(r));
    }
    for (uint32_t i = 0; i < SVO_MAX_CHANNELS; i++) svo_free(j->allocator, w.seen[i].bits, w.seen[i].values, sizeof *w.seen[i].bits);
    dump_ply_discard(w.ply);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    fmt_container_close(&c);
    return result;
}
