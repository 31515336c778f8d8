/* One .svo to the other form: chunks are decoded, checked and coded again on all threads. */
#include <string.h>

#include "fmti_svo.h"
#include "svo_task.h"

typedef struct recode {
    const fmt_svo_recode_options *options;
    fmt_svo_reader *reader;
    fmt_svo_writer *writer;
    svo_chunk_source source;
    svo_chunk_sink sink;
    bool begun;
    fmt_input *in;
} recode;

typedef struct item {
    svo_buffer packed, storage;
    void *blob;
} item;

/* What the reader knows when it has fetched for the first time. */
static svo_result begin(recode *c, svo_error *err)
{
    if (c->begun) return SVO_OK;
    c->begun = true;
    const fmt_svo_shard *shard = fmt_svo_reader_shard(c->reader);
    return shard != NULL ? fmt_svo_writer_shard(c->writer, shard, err) : SVO_OK;
}

static svo_result produce(void *user, void *p, bool *more, svo_error *err)
{
    recode *c = user;
    item *it = p;
    it->packed.allocator = it->storage.allocator = c->options->allocator;
    SVO_TRY(c->source.fetch(c->source.user, &it->packed, more, err));
    if (c->options->watch.tell != NULL) c->options->watch.tell(c->options->watch.user, fmt_input_offset(c->in), 0);
    return begin(c, err); /* nothing is committed before the first item has been worked on */
}

static svo_result work(void *user, void *p, uint32_t worker, svo_error *err)
{
    recode *c = user;
    item *it = p;
    svo_chunk chunk;
    SVO_TRY(c->source.decode(c->source.user, &it->packed, &it->storage, &chunk, err));
    return c->sink.encode(c->sink.user, &chunk, worker, &it->blob, err);
}

static svo_result commit(void *user, void *p, svo_error *err)
{
    recode *c = user;
    item *it = p;
    void *blob = it->blob;
    it->blob = NULL;
    return c->sink.commit(c->sink.user, blob, err);
}

static void destroy(void *user, void *p)
{
    recode *c = user;
    item *it = p;
    if (it->blob != NULL) c->sink.discard(c->sink.user, it->blob);
    svo_buffer_free(&it->packed);
    svo_buffer_free(&it->storage);
}

svo_result fmt_svo_recode(fmt_input *in, fmt_output *out, const fmt_svo_recode_options *options, svo_tree_counts *counts, svo_tree_info *info, svo_error *err)
{
    recode c = {.options = options, .in = in};
    SVO_TRY(fmt_svo_reader_open(in, options->allocator, &c.reader, err));
    svo_result r = fmt_svo_writer_begin(out, fmt_svo_reader_info(c.reader), NULL, options->level, options->allocator, &c.writer, err);
    if (r == SVO_OK && options->small) r = fmt_svo_writer_small(c.writer, err);
    if (r == SVO_OK) {
        c.source = fmt_svo_reader_source(c.reader);
        c.sink = fmt_svo_writer_sink(c.writer);
        svo_pipeline p = {.threads = options->threads, .item_size = sizeof(item), .user = &c, .produce = produce, .work = work, .commit = commit, .destroy = destroy};
        r = svo_pipeline_run(&p, err);
    }
    if (r == SVO_OK) r = fmti_svo_set_provenance(c.writer, fmt_svo_reader_provenance(c.reader), err);
    if (r == SVO_OK) {
        if (info != NULL) *info = *fmt_svo_reader_info(c.reader);
        fmt_svo_writer *w = c.writer;
        c.writer = NULL;
        r = fmt_svo_writer_end(w, counts, err);
    }
    fmt_svo_writer_discard(c.writer);
    fmt_svo_reader_close(c.reader);
    return r;
}
