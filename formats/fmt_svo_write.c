/* .svo writer: chunks are laid out and compressed by any thread and written in order. */
#include <string.h>

#include "fmti_svo.h"
#include "fmti_svo_masks.h"

struct fmt_svo_writer {
    fmt_writer *writer;
    fmt_zstd_pool *pool;
    fmti_masks_pool *masks; /* NULL: everything goes through zstd */
    const svo_allocator *allocator;
    svo_tree_info info;
    char *provenance;
    int level;      /* of zstd */
    bool packs;     /* values that are not constant */
    uint32_t voxel_bytes;
    svo_tree_counts counts;
    fmti_items items;
    bool has_previous;
    uint64_t previous, end; /* codes at the chunk level that the last item covers: previous .. end - 1 */
};

typedef struct blob {
    fmt_chunk chunk;
    svo_tree_counts counts; /* of this chunk alone */
    uint32_t level;
    uint64_t first, end;    /* codes at the chunk level that it covers */
    svo_buffer stored;      /* payload of a TREE chunk, or a record of a FULL chunk */
} blob;

svo_result fmt_svo_writer_begin(fmt_output *out, const svo_tree_info *info, const char *provenance, int level, const svo_allocator *a,
                                fmt_svo_writer **writer, svo_error *err)
{
    const char *why = fmti_check_info(info);
    if (why != NULL) return svo_fail(err, SVO_INVALID_ARGUMENT, "the octree cannot be written: %s", why);
    fmt_svo_writer *w = svo_calloc(a, 1, sizeof *w);
    if (w == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a .svo writer");
    w->allocator = a;
    w->info = *info;
    w->level = level != 0 ? level : 3;
    w->voxel_bytes = fmti_voxel_bytes(info);
    w->packs = level == 0 && w->voxel_bytes != 0;
    fmti_items_init(&w->items, info, a);
    svo_result r = SVO_OK;
    if (provenance != NULL && provenance[0] != 0) r = fmti_svo_set_provenance(w, provenance, err);
    if (r == SVO_OK) r = fmt_zstd_pool_new(&w->pool, err);
    if (r == SVO_OK) r = fmt_writer_begin(out, FMT_KIND_SVO, 1, 0, &w->writer, err);
    if (r == SVO_OK) {
        uint8_t head[FMTI_SVO_HEAD_MAX];
        size_t size = fmti_store_head(info, head);
        fmt_chunk c = {.type = FMTI_SVO_HEAD, .flags = FMT_CHUNK_CRITICAL, .stored_size = size, .decoded_size = size};
        r = fmt_writer_chunk(w->writer, &c, head, err);
    }
    if (r != SVO_OK) {
        fmt_svo_writer_discard(w);
        return r;
    }
    *writer = w;
    return SVO_OK;
}

svo_result fmt_svo_writer_shard(fmt_svo_writer *w, const fmt_svo_shard *shard, svo_error *err)
{
    uint8_t bytes[FMTI_SVO_SHARD_SIZE];
    SVO_ASSERT(!w->has_previous && shard->index >= 1 && shard->index <= shard->count && shard->first_code <= shard->end_code);
    fmti_store_shard(shard, bytes);
    fmt_chunk c = {.type = FMTI_SVO_SHRD, .stored_size = sizeof bytes, .decoded_size = sizeof bytes};
    return fmt_writer_chunk(w->writer, &c, bytes, err);
}

svo_result fmt_svo_writer_small(fmt_svo_writer *w, svo_error *err)
{
    SVO_ASSERT(!w->has_previous);
    return w->masks == NULL ? fmti_masks_pool_new(w->allocator, &w->masks, err) : SVO_OK;
}

svo_result fmti_svo_set_provenance(fmt_svo_writer *w, const char *provenance, svo_error *err)
{
    size_t n = strlen(provenance) + 1;
    if (w->provenance != NULL) svo_free(w->allocator, w->provenance, strlen(w->provenance) + 1, 1);
    w->provenance = svo_alloc(w->allocator, n, 1);
    if (w->provenance == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the provenance");
    memcpy(w->provenance, provenance, n);
    return SVO_OK;
}

/* Values of one channel to byte planes. */
static void to_planes(const uint8_t *values, uint64_t count, uint32_t stride, uint8_t *planes)
{
    for (uint32_t b = 0; b < stride; b++) {
        uint8_t *plane = planes + b * count;
        for (uint64_t i = 0; i < count; i++) plane[i] = values[i * stride + b];
    }
}

static svo_result bad_normal(const svo_chunk *chunk, svo_error *err)
{
    return svo_fail(err, SVO_INVALID_DATA, "chunk %llx: a normal holds -32768 (SVO-09)", (unsigned long long)chunk->code);
}

static svo_result fill_record(fmt_svo_writer *w, const svo_chunk *chunk, blob *b, svo_error *err)
{
    uint8_t place[8];
    fmt_store64(place, fmti_place(chunk->level, chunk->code));
    bool ok = svo_buffer_append(&b->stored, place, sizeof place) != NULL;
    for (uint32_t i = 0; i < w->info.channel_count && ok; i++) {
        const svo_channel *c = &w->info.channels[i];
        if (c->constant) continue;
        if (c->kind == SVO_KIND_NORMAL_OCT32 && fmti_bad_normals(chunk->channels[i], 1)) return bad_normal(chunk, err);
        ok = svo_buffer_append(&b->stored, chunk->channels[i], svo_channel_stride(c->kind)) != NULL;
    }
    b->chunk.type = FMTI_SVO_FULL;
    return ok ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a full leaf");
}

/* Masks, counts and planes of values, as a zstd frame holds them. */
static void lay_out(const svo_tree_info *info, const svo_chunk *chunk, uint8_t *at)
{
    fmt_store64(at, chunk->node_count);
    fmt_store64(at + 8, chunk->value_count);
    at += 16;
    if (chunk->node_count != 0) memcpy(at, chunk->masks, (size_t)chunk->node_count);
    at += chunk->node_count;
    for (uint32_t i = 0; i < info->channel_count; i++) {
        if (info->channels[i].constant) continue;
        const uint32_t stride = svo_channel_stride(info->channels[i].kind);
        to_planes(chunk->channels[i], chunk->value_count, stride, at);
        at += stride * chunk->value_count;
    }
}

/* Everything, or the values alone, as one zstd frame. */
static svo_result zip(fmt_svo_writer *w, const svo_chunk *chunk, bool masks, svo_buffer *to, svo_error *err)
{
    const uint64_t size = 16 + chunk->node_count + chunk->value_count * w->voxel_bytes, skipped = masks ? 0 : 16 + chunk->node_count;
    uint8_t *plain = svo_alloc(w->allocator, size, 1);
    if (plain == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to lay out a chunk of %llu bytes", (unsigned long long)size);
    lay_out(&w->info, chunk, plain);
    svo_result r = fmt_zstd_encode(w->pool, plain + skipped, (size_t)(size - skipped), w->level, to, err);
    svo_free(w->allocator, plain, size, 1);
    return r;
}

/* The size of the masks' zstd frame, that frame, packed values. */
static svo_result pack_tree(fmt_svo_writer *w, const svo_chunk *chunk, svo_buffer *to, svo_error *err)
{
    svo_buffer zipped;
    uint8_t size[4];
    svo_buffer_init(&zipped, w->allocator);
    svo_result r = chunk->node_count != 0 ? fmt_zstd_encode(w->pool, chunk->masks, (size_t)chunk->node_count, w->level, &zipped, err) : SVO_OK;
    fmt_store32(size, (uint32_t)zipped.size);
    if (r == SVO_OK && (svo_buffer_append(to, size, sizeof size) == NULL || (zipped.size != 0 && svo_buffer_append(to, zipped.data, zipped.size) == NULL)))
        r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a chunk");
    svo_buffer_free(&zipped);
    return r == SVO_OK ? fmti_svo_pack(&w->info, chunk, w->allocator, to, err) : r;
}

/* Masks through the context model, values apart. */
static svo_result code_apart(fmt_svo_writer *w, const svo_chunk *chunk, svo_buffer *to, uint64_t *coded, svo_error *err)
{
    if (chunk->node_count != 0)
        SVO_TRY(fmti_masks_encode(w->masks, w->info.depth - svo_chunk_level(w->info.depth), chunk->masks, chunk->node_count, to, err));
    *coded = to->size;
    if (w->packs) return fmti_svo_pack(&w->info, chunk, w->allocator, to, err);
    if (w->voxel_bytes == 0) return SVO_OK;
    svo_buffer zipped;
    svo_buffer_init(&zipped, w->allocator);
    svo_result r = zip(w, chunk, false, &zipped, err);
    if (r == SVO_OK && svo_buffer_append(to, zipped.data, zipped.size) == NULL) r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a chunk");
    svo_buffer_free(&zipped);
    return r;
}

static svo_result fill_blob(fmt_svo_writer *w, const svo_chunk *chunk, blob *b, svo_error *err)
{
    const svo_tree_info *info = &w->info;
    SVO_TRY(svo_chunk_check(info, chunk, &b->counts, err));
    b->level = chunk->level;
    b->first = svo_chunk_first(chunk);
    b->end = svo_chunk_end(chunk);
    if (svo_chunk_full(chunk)) return fill_record(w, chunk, b, err);
    for (uint32_t i = 0; i < info->channel_count; i++)
        if (!info->channels[i].constant && info->channels[i].kind == SVO_KIND_NORMAL_OCT32 && fmti_bad_normals(chunk->channels[i], chunk->value_count))
            return bad_normal(chunk, err);
    uint64_t coded = 0;
    const bool small = w->masks != NULL;
    if (small) SVO_TRY(code_apart(w, chunk, &b->stored, &coded, err));
    else SVO_TRY(w->packs ? pack_tree(w, chunk, &b->stored, err) : zip(w, chunk, true, &b->stored, err));
    b->chunk = (fmt_chunk){.type = small ? FMTI_SVO_GRUP : FMTI_SVO_TREE, .flags = FMT_CHUNK_CRITICAL,
                           .codec = w->packs ? FMT_CODEC_PACKED : small ? FMT_CODEC_NONE : FMT_CODEC_ZSTD, .stored_size = b->stored.size,
                           .element_stride = (uint32_t)coded, .decoded_size = 16 + chunk->node_count + chunk->value_count * w->voxel_bytes,
                           .element_count = chunk->value_count, .id = chunk->code};
    return SVO_OK;
}

static void discard_blob(void *user, void *p)
{
    fmt_svo_writer *w = user;
    blob *b = p;
    if (b == NULL) return;
    svo_buffer_free(&b->stored);
    svo_free(w->allocator, b, 1, sizeof *b);
}

static svo_result encode(void *user, const svo_chunk *chunk, uint32_t worker, void **out, svo_error *err)
{
    (void)worker;
    fmt_svo_writer *w = user;
    blob *b = svo_calloc(w->allocator, 1, sizeof *b);
    if (b == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a chunk");
    svo_buffer_init(&b->stored, w->allocator);
    svo_result r = fill_blob(w, chunk, b, err);
    if (r != SVO_OK) {
        discard_blob(w, b);
        return r;
    }
    /* Many encoded chunks may wait to be written: keep what they need, not what compression might have needed. */
    if (b->stored.capacity - b->stored.size > b->stored.capacity / 4) {
        svo_buffer exact;
        svo_buffer_init(&exact, w->allocator);
        if (svo_buffer_append(&exact, b->stored.data, b->stored.size) != NULL) {
            svo_buffer_free(&b->stored);
            b->stored = exact;
        }
    }
    *out = b;
    return SVO_OK;
}

static svo_result commit(void *user, void *p, svo_error *err)
{
    fmt_svo_writer *w = user;
    blob *b = p;
    svo_result r = SVO_OK;
    if (w->has_previous && b->first < w->end)
        r = svo_fail(err, SVO_RUNTIME, "chunks were given out of order: %llx after %llx", (unsigned long long)b->first, (unsigned long long)w->previous);
    if (r == SVO_OK) r = fmti_items_put(&w->items, w->writer, &b->chunk, b->stored.data, err);
    if (r == SVO_OK) {
        svo_counts_ancestors(&w->counts, svo_chunk_level(w->info.depth), b->level, w->has_previous, w->previous, b->first);
        svo_counts_add(&w->counts, &b->counts);
        w->has_previous = true;
        w->previous = b->first;
        w->end = b->end;
    }
    discard_blob(w, b);
    return r;
}

svo_chunk_sink fmt_svo_writer_sink(fmt_svo_writer *w)
{
    svo_chunk_sink s = {w, encode, commit, discard_blob};
    return s;
}

svo_result fmti_svo_finish(fmt_writer *w, uint32_t depth, const svo_tree_counts *counts, const char *provenance, svo_error *err)
{
    uint8_t stat[8 * (SVO_MAX_DEPTH + 4)];
    uint64_t size = 8 * ((uint64_t)depth + 4);
    fmt_store64(stat, counts->chunks);
    fmt_store64(stat + 8, counts->full_leaves);
    fmt_store64(stat + 16, counts->values);
    for (uint32_t l = 0; l <= depth; l++) fmt_store64(stat + 24 + 8 * l, counts->nodes[l]);
    fmt_chunk c = {.type = FMTI_SVO_STAT, .flags = FMT_CHUNK_CRITICAL, .stored_size = size, .decoded_size = size};
    svo_result r = fmt_writer_chunk(w, &c, stat, err);
    if (r == SVO_OK) r = fmt_writer_meta(w, provenance, err);
    if (r == SVO_OK) return fmt_writer_end(w, err);
    fmt_writer_discard(w);
    return r;
}

svo_result fmt_svo_writer_end(fmt_svo_writer *w, svo_tree_counts *counts, svo_error *err)
{
    svo_result r = fmti_items_flush(&w->items, w->writer, err);
    if (r != SVO_OK) {
        fmt_svo_writer_discard(w);
        return r;
    }
    fmt_writer *writer = w->writer;
    w->writer = NULL;
    r = fmti_svo_finish(writer, w->info.depth, &w->counts, w->provenance, err);
    if (r == SVO_OK && counts != NULL) *counts = w->counts;
    fmt_svo_writer_discard(w);
    return r;
}

void fmt_svo_writer_discard(fmt_svo_writer *w)
{
    if (w == NULL) return;
    fmt_writer_discard(w->writer);
    fmt_zstd_pool_free(w->pool);
    fmti_items_free(&w->items);
    fmti_masks_pool_free(w->masks);
    if (w->provenance != NULL) svo_free(w->allocator, w->provenance, strlen(w->provenance) + 1, 1);
    svo_free(w->allocator, w, 1, sizeof *w);
}
