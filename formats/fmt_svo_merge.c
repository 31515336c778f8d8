/* Shards of one job joined: chunks are copied as they are stored. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmti_svo.h"

typedef struct entry {
    uint64_t path; /* number of its path */
    fmt_svo_shard shard;
} entry;

typedef struct merge {
    const char *const *paths;
    uint64_t count;
    const svo_allocator *allocator;
    entry *entries;
    uint8_t head[FMTI_SVO_HEAD_MAX]; /* of the first path */
    size_t head_size;
    fmt_writer *writer;
    char *provenance; /* of shard 1 */
    fmti_items items;
    bool has_items;
    bool has_chunks;
    uint64_t previous; /* code at the chunk level where the last item begins */
    fmt_svo_merge_report *report;
    const fmt_svo_watch *watch;
} merge;

/* The message with the file's name before it. */
static svo_result in_file(const char *path, const svo_error *inner, svo_result code, svo_error *err)
{
    size_t n = strlen(path);
    const char *tail = n > 90 ? path + n - 90 : path;
    if (strncmp(inner->message, path, n) == 0) svo_fail(err, code, "%s", inner->message);
    else svo_fail(err, code, "%s%s: %s", tail != path ? "..." : "", tail, inner->message);
    if (err != NULL) {
        err->chunk = inner->chunk;
        err->offset = inner->offset;
    }
    return code;
}

/* HEAD and SHRD at the front of a file; nothing behind them is read. */
static svo_result read_front(const char *path, const svo_allocator *a, uint8_t head[FMTI_SVO_HEAD_MAX], size_t *head_size, fmt_svo_shard *shard,
                             svo_error *err)
{
    fmt_input *in = NULL;
    fmt_stream *stream = NULL;
    fmt_kind kind = FMT_KIND_SVO;
    uint16_t major;
    svo_buffer b;
    svo_buffer_init(&b, a);
    svo_tree_info info = {0};
    bool has_head = false, has_shard = false;
    svo_result r = fmt_input_open(path, &in, err);
    if (r == SVO_OK) r = fmt_stream_open(in, a, &stream, &kind, &major, err);
    if (r == SVO_OK && kind != FMT_KIND_SVO) r = svo_fail(err, SVO_INVALID_DATA, "this is no .svo file");
    while (r == SVO_OK && !has_shard) {
        fmt_chunk c;
        bool more = false;
        r = fmt_stream_next(stream, &c, &more, err);
        if (r != SVO_OK) break;
        bool wanted = more && c.type == (has_head ? FMTI_SVO_SHRD : FMTI_SVO_HEAD);
        if (!wanted && more && (c.flags & FMT_CHUNK_CRITICAL) == 0) continue;
        if (!wanted) {
            r = svo_fail(err, SVO_INVALID_DATA, has_head ? "this is a whole octree, no shard of one" : "HEAD must come first (SVO-01)");
            break;
        }
        if (c.stored_size > FMTI_SVO_HEAD_MAX) r = fmt_chunk_fail(err, SVO_INVALID_DATA, c.type, c.offset - 64, "too long (SVO-02)");
        if (r == SVO_OK) r = fmt_stream_payload(stream, &c, &b, err);
        if (r != SVO_OK) break;
        if (has_head) {
            r = fmti_parse_shard(&c, b.data, b.size, info.depth, shard, err);
            has_shard = true;
        } else {
            r = fmti_parse_head(&c, b.data, b.size, &info, err);
            if (r != SVO_OK) break;
            memcpy(head, b.data, b.size);
            *head_size = b.size;
            has_head = true;
        }
    }
    svo_buffer_free(&b);
    fmt_stream_close(stream);
    fmt_input_close(in);
    return r;
}

static int by_index(const void *a, const void *b)
{
    const entry *x = a, *y = b;
    if (x->shard.index != y->shard.index) return x->shard.index < y->shard.index ? -1 : 1;
    return x->path < y->path ? -1 : x->path > y->path; /* so that messages do not depend on the sort */
}

static const char *last_part(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash != NULL ? slash + 1 : path;
}

/* Read the fronts of all files: they must belong together. */
static svo_result read_fronts(merge *m, svo_error *err)
{
    for (uint64_t i = 0; i < m->count; i++) {
        uint8_t head[FMTI_SVO_HEAD_MAX];
        size_t size = 0;
        svo_error inner = {0};
        entry *e = &m->entries[i];
        e->path = i;
        svo_result r = read_front(m->paths[i], m->allocator, head, &size, &e->shard, &inner);
        if (r != SVO_OK) return in_file(m->paths[i], &inner, r, err);
        if (i == 0) {
            memcpy(m->head, head, size);
            m->head_size = size;
        }
        const fmt_svo_shard *first = &m->entries[0].shard;
        if (memcmp(e->shard.job, first->job, sizeof first->job) != 0 || size != m->head_size || memcmp(head, m->head, size) != 0)
            return svo_fail(err, SVO_INVALID_DATA, "%.80s is a shard of another job than %.80s: other inputs, options or version", last_part(m->paths[i]),
                            last_part(m->paths[0]));
        if (e->shard.count != first->count)
            return svo_fail(err, SVO_INVALID_DATA, "%.80s is one of %u shards, %.80s one of %u", last_part(m->paths[i]), e->shard.count,
                            last_part(m->paths[0]), first->count);
    }
    return SVO_OK;
}

/* With the entries sorted: all there, each once, and their ranges cover everything. */
static svo_result check_complete(const merge *m, svo_error *err)
{
    for (uint64_t i = 1; i < m->count; i++)
        if (m->entries[i].shard.index == m->entries[i - 1].shard.index)
            return svo_fail(err, SVO_INVALID_DATA, "shard %u is there twice: %.70s and %.70s", m->entries[i].shard.index,
                            last_part(m->paths[m->entries[i - 1].path]), last_part(m->paths[m->entries[i].path]));
    uint32_t total = m->entries[0].shard.count;
    if (m->count != total) {
        char list[80];
        size_t at = 0;
        uint32_t missing = total - (uint32_t)m->count, named = 0;
        for (uint32_t want = 1, i = 0; want <= total && named < 8; want++) {
            if (i < m->count && m->entries[i].shard.index == want) i++;
            else at += (size_t)snprintf(list + at, sizeof list - at, "%s%u", named++ != 0 ? ", " : "", want);
        }
        return svo_fail(err, SVO_INVALID_DATA, "%u of %u shards missing: %s%s", missing, total, list, missing > named ? ", ..." : "");
    }
    uint64_t at = 0;
    for (uint64_t i = 0; i < m->count; i++) {
        const fmt_svo_shard *s = &m->entries[i].shard;
        if (s->first_code != at)
            return svo_fail(err, SVO_INVALID_DATA, "shard %u (%.80s) does not begin where the one before it ends: they were cut by different plans", s->index,
                            last_part(m->paths[m->entries[i].path]));
        at = s->end_code;
    }
    uint32_t chunk_level = fmt_load32(m->head + 4);
    if (at != (uint64_t)1 << 3 * chunk_level)
        return svo_fail(err, SVO_INVALID_DATA, "the last shard (%.80s) does not reach the end of the grid", last_part(m->paths[m->entries[m->count - 1].path]));
    return SVO_OK;
}

/* Copy the chunks of an open shard and add its counts. */
static svo_result copy_chunks(merge *m, fmt_svo_reader *reader, svo_buffer *packed, svo_error *err)
{
    svo_tree_counts *counts = &m->report->counts;
    const uint32_t level = svo_chunk_level(m->report->info.depth);
    svo_chunk_source source = fmt_svo_reader_source(reader);
    for (;;) {
        bool more = false;
        SVO_TRY(source.fetch(source.user, packed, &more, err));
        if (!more) break;
        fmt_chunk c;
        fmti_svo_packed(packed, &c);
        uint64_t first = c.id;
        if (c.type == FMTI_SVO_FULL) {
            uint32_t leaf = 0;
            uint64_t code = 0;
            fmti_parse_place(fmt_load64(packed->data), level, &leaf, &code); /* fetch has checked it */
            first = code << 3 * (level - leaf);
            svo_counts_ancestors(counts, level, leaf, m->has_chunks, m->previous, first);
            fmti_count_full(counts, leaf, level);
        } else {
            svo_counts_ancestors(counts, level, level, m->has_chunks, m->previous, first);
            counts->chunks++;
        }
        SVO_TRY(fmti_items_put(&m->items, m->writer, &c, packed->data, err));
        m->has_chunks = true;
        m->previous = first;
    }
    const svo_tree_counts *shard = fmt_svo_reader_counts(reader);
    for (uint32_t l = level; l <= m->report->info.depth; l++)
        if (__builtin_add_overflow(counts->nodes[l], shard->nodes[l], &counts->nodes[l]))
            return svo_fail(err, SVO_INVALID_DATA, "impossible counts (SVO-08)");
    if (__builtin_add_overflow(counts->full_leaves, shard->full_leaves, &counts->full_leaves) ||
        __builtin_add_overflow(counts->values, shard->values, &counts->values))
        return svo_fail(err, SVO_INVALID_DATA, "impossible counts (SVO-08)");
    return SVO_OK;
}

static svo_result copy_shard(merge *m, const entry *e, svo_buffer *packed, svo_error *err)
{
    fmt_input *in = NULL;
    fmt_svo_reader *reader = NULL;
    uint8_t head[FMTI_SVO_HEAD_MAX];
    svo_result r = fmt_input_open(m->paths[e->path], &in, err);
    if (r == SVO_OK) r = fmt_svo_reader_open(in, m->allocator, &reader, err);
    if (r == SVO_OK) {
        m->report->info = *fmt_svo_reader_info(reader);
        if (!m->has_items) fmti_items_init(&m->items, &m->report->info, m->allocator);
        m->has_items = true;
        if (fmti_store_head(&m->report->info, head) != m->head_size || memcmp(head, m->head, m->head_size) != 0)
            r = svo_fail(err, SVO_INVALID_DATA, "the file has changed while it was read");
    }
    if (r == SVO_OK) r = copy_chunks(m, reader, packed, err);
    if (r == SVO_OK) {
        const fmt_svo_shard *s = fmt_svo_reader_shard(reader);
        uint8_t was[FMTI_SVO_SHARD_SIZE], is[FMTI_SVO_SHARD_SIZE];
        fmti_store_shard(&e->shard, was);
        if (s != NULL) fmti_store_shard(s, is);
        if (s == NULL || memcmp(was, is, sizeof was) != 0) r = svo_fail(err, SVO_INVALID_DATA, "the file has changed while it was read");
    }
    if (r == SVO_OK) {
        const char *text = fmt_svo_reader_provenance(reader);
        m->report->bytes_read += fmt_input_offset(in);
        if (m->provenance == NULL) {
            m->provenance = svo_alloc(m->allocator, strlen(text) + 1, 1);
            if (m->provenance == NULL) r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the provenance");
            else strcpy(m->provenance, text);
        } else if (strcmp(m->provenance, text) != 0) {
            r = svo_fail(err, SVO_INVALID_DATA, "its META differs from that of shard 1");
        }
    }
    fmt_svo_reader_close(reader);
    fmt_input_close(in);
    return r;
}

static svo_result write_all(merge *m, fmt_output *out, svo_error *err)
{
    SVO_TRY(fmt_writer_begin(out, FMT_KIND_SVO, 1, 0, &m->writer, err));
    fmt_chunk c = {.type = FMTI_SVO_HEAD, .flags = FMT_CHUNK_CRITICAL, .stored_size = m->head_size, .decoded_size = m->head_size};
    SVO_TRY(fmt_writer_chunk(m->writer, &c, m->head, err));
    svo_buffer packed;
    svo_buffer_init(&packed, m->allocator);
    svo_result r = SVO_OK;
    for (uint64_t i = 0; r == SVO_OK && i < m->count; i++) {
        svo_error inner = {0};
        r = copy_shard(m, &m->entries[i], &packed, &inner);
        if (m->watch != NULL && m->watch->tell != NULL) m->watch->tell(m->watch->user, i + 1, m->count);
        if (r != SVO_OK) in_file(m->paths[m->entries[i].path], &inner, r, err);
    }
    svo_buffer_free(&packed);
    SVO_TRY(r);
    SVO_TRY(fmti_items_flush(&m->items, m->writer, err));
    fmt_writer *writer = m->writer;
    m->writer = NULL;
    return fmti_svo_finish(writer, m->report->info.depth, &m->report->counts, m->provenance, err);
}

svo_result fmt_svo_merge(const char *const *paths, uint64_t count, fmt_output *out, const svo_allocator *a, const fmt_svo_watch *watch, fmt_svo_merge_report *report,
                         svo_error *err)
{
    fmt_svo_merge_report unused;
    merge m = {.paths = paths, .count = count, .allocator = a, .watch = watch, .report = report != NULL ? report : &unused};
    memset(m.report, 0, sizeof *m.report);
    if (count == 0) return svo_fail(err, SVO_INVALID_ARGUMENT, "no shards to merge");
    m.entries = svo_calloc(a, count, sizeof *m.entries);
    if (m.entries == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %llu shards", (unsigned long long)count);
    svo_result r = read_fronts(&m, err);
    if (r == SVO_OK) {
        qsort(m.entries, (size_t)count, sizeof *m.entries, by_index);
        r = check_complete(&m, err);
    }
    if (r == SVO_OK) r = write_all(&m, out, err);
    m.report->shards = (uint32_t)count;
    fmt_writer_discard(m.writer);
    if (m.has_items) fmti_items_free(&m.items);
    if (m.provenance != NULL) svo_free(a, m.provenance, strlen(m.provenance) + 1, 1);
    svo_free(a, m.entries, count, sizeof *m.entries);
    return r;
}
