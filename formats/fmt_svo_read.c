/* .svo reader over a sequential input. fetch takes stored bytes in order, decode does the work and may run in parallel. */
#include <pthread.h>
#include <string.h>

#include "fmti_svo.h"
#include "fmti_svo_masks.h"
#include "svo_rules.h"

struct fmt_svo_reader {
    fmt_stream *stream;
    fmt_zstd_pool *pool;
    fmti_masks_pool *masks;
    const svo_allocator *allocator;
    svo_tree_info info;
    char *provenance;
    uint32_t voxel_bytes;
    bool has_previous;
    uint64_t previous, end; /* codes at the chunk level that the last item covers: previous .. end - 1 */
    svo_tree_counts fetched; /* chunks, levels above the cut, and values as the chunk headers say */
    uint64_t items;          /* handed out by fetch */
    svo_buffer full;         /* a FULL chunk in hand */
    size_t full_at;
    fmt_chunk full_chunk;
    svo_buffer group; /* a GRUP chunk in hand: its payload, its subtrees, where the next one's bytes begin */
    fmt_chunk subtree[FMTI_GROUP_MOST];
    uint32_t subtrees, subtree_next;
    size_t group_at;
    svo_tree_counts stat;
    bool has_stat, ended, has_shard;
    svo_rules *rules; /* all violations are wanted: what breaks a rule is left out and reading goes on; NULL */
    bool holes;       /* something was left out, so counts mean nothing */
    fmt_svo_shard shard;
    fmt_chunk stat_chunk;
    /* What decode has seen. STAT is compared by whoever comes last, the end of the stream or the last decode. */
    pthread_mutex_t lock;
    svo_tree_counts decoded;
    uint64_t decoded_items;
};

static const uint32_t known_types[] = {FMTI_SVO_HEAD, FMTI_SVO_SHRD, FMTI_SVO_TREE, FMTI_SVO_FULL, FMTI_SVO_GRUP, FMTI_SVO_STAT, FMT_TYPE_META};
enum { KNOWN = sizeof known_types / sizeof known_types[0] };

/* "SVDAG", not the four bytes, for people. */
static const char *kind_name(fmt_kind kind)
{
    switch (kind) {
    case FMT_KIND_SVO: return ".svo";
    case FMT_KIND_SVDAG: return ".svdag";
    case FMT_KIND_SKEL: return ".skel";
    case FMT_KIND_SCENE: return ".svscene";
    }
    return "unknown";
}

static svo_result need(const fmt_chunk *c, uint16_t codec, svo_error *err)
{
    if ((c->flags & FMT_CHUNK_CRITICAL) == 0 || c->codec != codec || c->element_stride != 0 || (c->type != FMTI_SVO_TREE && (c->id != 0 || c->element_count != 0)))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "wrong flags, codec, id or element fields (SVO-01)");
    return SVO_OK;
}

static svo_result read_head(fmt_svo_reader *r, svo_error *err)
{
    fmt_chunk c = {0};
    bool more = false;
    do { /* optional chunks of later versions may come first */
        SVO_TRY(fmt_stream_next(r->stream, &c, &more, err));
        if (more) SVO_TRY(fmt_chunk_known(&c, known_types, KNOWN, err));
    } while (more && fmt_chunk_skip(&c, known_types, KNOWN));
    if (!more) return svo_fail(err, SVO_INVALID_DATA, "the file has no HEAD chunk (SVO-01)");
    if (c.type != FMTI_SVO_HEAD) return fmt_chunk_fail(err, SVO_INVALID_DATA, c.type, c.offset - 64, "HEAD must come first (SVO-01)");
    SVO_TRY(need(&c, FMT_CODEC_NONE, err));
    if (c.stored_size > FMTI_SVO_HEAD_MAX) return fmt_chunk_fail(err, SVO_INVALID_DATA, c.type, c.offset - 64, "too long (SVO-02)");
    svo_buffer b;
    svo_buffer_init(&b, r->allocator);
    svo_result result = fmt_stream_payload(r->stream, &c, &b, err);
    if (result == SVO_OK) result = fmti_parse_head(&c, b.data, b.size, &r->info, err);
    svo_buffer_free(&b);
    return result;
}

svo_result fmt_svo_reader_open(fmt_input *in, const svo_allocator *a, fmt_svo_reader **out, svo_error *err)
{
    fmt_svo_reader *r = svo_calloc(a, 1, sizeof *r);
    if (r == NULL || pthread_mutex_init(&r->lock, NULL) != 0) {
        svo_free(a, r, 1, sizeof *r);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a .svo reader");
    }
    r->allocator = a;
    svo_buffer_init(&r->full, a);
    svo_buffer_init(&r->group, a);
    fmt_kind kind = FMT_KIND_SVO;
    uint16_t major;
    svo_result result = fmt_stream_open(in, a, &r->stream, &kind, &major, err);
    if (result == SVO_OK && kind != FMT_KIND_SVO) result = svo_fail(err, SVO_INVALID_DATA, "this is a %s file; a .svo is needed here", kind_name(kind));
    if (result == SVO_OK) result = fmt_zstd_pool_new(&r->pool, err);
    if (result == SVO_OK) result = fmti_masks_pool_new(a, &r->masks, err);
    if (result == SVO_OK) result = read_head(r, err);
    if (result != SVO_OK) {
        fmt_svo_reader_close(r);
        return result;
    }
    r->voxel_bytes = fmti_voxel_bytes(&r->info);
    *out = r;
    return SVO_OK;
}

const svo_tree_info *fmt_svo_reader_info(const fmt_svo_reader *r) { return &r->info; }
const char *fmt_svo_reader_provenance(const fmt_svo_reader *r) { return r->provenance != NULL ? r->provenance : ""; }
const svo_tree_counts *fmt_svo_reader_counts(const fmt_svo_reader *r) { return &r->stat; }
void fmt_svo_reader_content_hash(const fmt_svo_reader *r, uint8_t out[16]) { fmt_stream_content_hash(r->stream, out); }

const fmt_svo_shard *fmt_svo_reader_shard(const fmt_svo_reader *r) { return r->has_shard ? &r->shard : NULL; }

static svo_result stat_fail(const fmt_svo_reader *r, const char *what, uint64_t stat, uint64_t seen, svo_error *err)
{
    return fmt_chunk_fail(err, SVO_INVALID_DATA, FMTI_SVO_STAT, r->stat_chunk.offset, "it states %llu %s, the file has %llu (SVO-08)",
                          (unsigned long long)stat, what, (unsigned long long)seen);
}

/* What becomes of a violation by something that is then left out. */
static svo_result leave_out(fmt_svo_reader *r, svo_result result, const svo_error *err)
{
    r->holes |= result != SVO_OK;
    return svo_go_on(r->rules, result, err);
}

/* Call with the lock held, when the stream has ended and all its chunks have been decoded. */
static svo_result compare_levels(const fmt_svo_reader *r, svo_error *err)
{
    if (r->holes) return SVO_OK;
    char what[32] = "nodes of level ";
    for (uint32_t l = svo_chunk_level(r->info.depth); l <= r->info.depth; l++) {
        if (r->stat.nodes[l] == r->decoded.nodes[l]) continue;
        what[15] = (char)('0' + l / 10);
        what[16] = (char)('0' + l % 10);
        SVO_TRY(svo_go_on(r->rules, stat_fail(r, what, r->stat.nodes[l], r->decoded.nodes[l], err), err));
    }
    if (r->stat.full_leaves != r->decoded.full_leaves) return stat_fail(r, "full leaves", r->stat.full_leaves, r->decoded.full_leaves, err);
    return SVO_OK;
}

static svo_result read_stat(fmt_svo_reader *r, const fmt_chunk *c, svo_buffer *scratch, svo_error *err)
{
    SVO_TRY(need(c, FMT_CODEC_NONE, err));
    if (r->has_stat) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "a second STAT (SVO-01)");
    if (c->stored_size != 8 * ((uint64_t)r->info.depth + 4))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "%llu bytes for depth %u (SVO-08)", (unsigned long long)c->stored_size, r->info.depth);
    SVO_TRY(fmt_stream_payload(r->stream, c, scratch, err));
    r->has_stat = true;
    r->stat_chunk = *c;
    r->stat.chunks = fmt_load64(scratch->data);
    r->stat.full_leaves = fmt_load64(scratch->data + 8);
    r->stat.values = fmt_load64(scratch->data + 16);
    for (uint32_t l = 0; l <= r->info.depth; l++) r->stat.nodes[l] = fmt_load64(scratch->data + 24 + 8 * l);
    if (r->holes) return SVO_OK;
    if (r->stat.chunks != r->fetched.chunks) SVO_TRY(svo_go_on(r->rules, stat_fail(r, "chunks", r->stat.chunks, r->fetched.chunks, err), err));
    for (uint32_t l = 0; l < svo_chunk_level(r->info.depth); l++)
        if (r->stat.nodes[l] != r->fetched.nodes[l])
            SVO_TRY(svo_go_on(r->rules, stat_fail(r, "nodes above the chunks", r->stat.nodes[l], r->fetched.nodes[l], err), err));
    if (r->stat.values != r->fetched.values) SVO_TRY(svo_go_on(r->rules, stat_fail(r, "values", r->stat.values, r->fetched.values, err), err));
    return SVO_OK;
}

static svo_result read_meta(fmt_svo_reader *r, const fmt_chunk *c, svo_buffer *scratch, svo_error *err)
{
    if (!r->has_stat) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "META before STAT (SVO-01)");
    if (r->provenance != NULL) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "a second META chunk (CON-12)");
    if (c->stored_size > FMT_META_MAX) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "longer than 16 MiB (CON-12)");
    SVO_TRY(fmt_stream_payload(r->stream, c, scratch, err));
    return fmt_meta_text(c, scratch->data, scratch->size, r->allocator, &r->provenance, err);
}

static svo_result read_shard(fmt_svo_reader *r, const fmt_chunk *c, svo_buffer *scratch, svo_error *err)
{
    if (r->has_shard || r->has_stat || r->has_previous)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "it may come once, before the first TREE and FULL (SVO-10)");
    if (c->stored_size > FMTI_SVO_SHARD_SIZE) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "too long (SVO-10)");
    SVO_TRY(fmt_stream_payload(r->stream, c, scratch, err));
    SVO_TRY(fmti_parse_shard(c, scratch->data, scratch->size, r->info.depth, &r->shard, err));
    r->has_shard = true;
    return SVO_OK;
}

/* A TREE chunk's header, or what a GRUP chunk says of a subtree, against what is known, before its bytes are read: SVO-05, SVO-06. */
static svo_result check_tree(fmt_svo_reader *r, const fmt_chunk *c, svo_error *err)
{
    uint64_t at = c->offset - 64;
    uint32_t level = svo_chunk_level(r->info.depth), levels = r->info.depth - level;
    if (c->type == FMTI_SVO_TREE) SVO_TRY(need(c, c->codec == FMT_CODEC_PACKED && r->voxel_bytes != 0 ? FMT_CODEC_PACKED : FMT_CODEC_ZSTD, err));
    if (c->id >> 3 * level != 0) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "code %llx lies outside the grid (SVO-05)", (unsigned long long)c->id);
    if (r->has_previous && c->id < r->end)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "code %llx comes after %llx (SVO-05)", (unsigned long long)c->id, (unsigned long long)r->previous);
    if (r->has_shard && (c->id < r->shard.first_code || c->id >= r->shard.end_code))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "code %llx lies outside the shard (SVO-10)", (unsigned long long)c->id);
    uint64_t voxels = c->element_count /* values */, most_voxels = (uint64_t)1 << 3 * levels, most_masks = (most_voxels - 1) / 7;
    if (voxels == 0 || voxels > most_voxels) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "%llu values in a chunk (SVO-06)", (unsigned long long)voxels);
    uint64_t rest = 16 + voxels * r->voxel_bytes;
    if (c->decoded_size < rest || c->decoded_size - rest > most_masks)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "%llu bytes for %llu values (SVO-06)", (unsigned long long)c->decoded_size, (unsigned long long)voxels);
    return SVO_OK;
}

/* A FULL chunk as a whole, before its records are handed out. */
static svo_result check_full(fmt_svo_reader *r, const fmt_chunk *c, svo_error *err)
{
    uint64_t at = c->offset - 64;
    if ((c->flags & FMT_CHUNK_CRITICAL) == 0 || c->codec != FMT_CODEC_NONE || c->element_stride != 8 + r->voxel_bytes || c->element_count == 0 ||
        c->element_count > FMTI_FULL_MOST)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "wrong flags, codec or element fields (SVO-11)");
    SVO_TRY(fmt_stream_payload(r->stream, c, &r->full, err));
    r->full_chunk = *c;
    r->full_at = 0;
    return SVO_OK;
}

/* The next record of the FULL chunk in hand: its place is checked here, its values by decode. */
static svo_result next_full(fmt_svo_reader *r, svo_buffer *packed, svo_error *err)
{
    const fmt_chunk *c = &r->full_chunk;
    const uint8_t *record = r->full.data + r->full_at;
    uint32_t cut = svo_chunk_level(r->info.depth), level = 0;
    uint64_t code = 0, at = c->offset + r->full_at;
    if (!fmti_parse_place(fmt_load64(record), cut, &level, &code))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "%llx is no place of a full leaf (SVO-11)", (unsigned long long)fmt_load64(record));
    uint64_t first = code << 3 * (cut - level), end = (code + 1) << 3 * (cut - level);
    if (r->full_at == 0 && first != c->id)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "its first full leaf begins at %llx, not at its id (SVO-11)", (unsigned long long)first);
    if (r->has_previous && first < r->end)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "code %llx comes after %llx (SVO-05)", (unsigned long long)first, (unsigned long long)r->previous);
    if (r->has_shard && (first < r->shard.first_code || end > r->shard.end_code))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "code %llx lies outside the shard (SVO-10)", (unsigned long long)first);
    packed->size = 0;
    fmt_chunk own = *c;
    own.stored_size = own.decoded_size = c->element_stride;
    own.element_count = 1;
    if (svo_buffer_append(packed, record, c->element_stride) == NULL || svo_buffer_append(packed, &own, sizeof own) == NULL)
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a chunk");
    r->full_at += c->element_stride;
    svo_counts_ancestors(&r->fetched, cut, level, r->has_previous, r->previous, first);
    fmti_count_full(&r->fetched, level, cut);
    r->fetched.values++;
    r->has_previous = true;
    r->previous = first;
    r->end = end;
    return SVO_OK;
}

static void count_item(fmt_svo_reader *r)
{
    pthread_mutex_lock(&r->lock);
    r->items++;
    pthread_mutex_unlock(&r->lock);
}

/* Count a subtree whose bytes are in *packed; its description travels behind them. */
static svo_result give_tree(fmt_svo_reader *r, const fmt_chunk *c, svo_buffer *packed, svo_error *err)
{
    uint32_t level = svo_chunk_level(r->info.depth);
    if (svo_buffer_append(packed, c, sizeof *c) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a chunk");
    svo_counts_ancestors(&r->fetched, level, level, r->has_previous, r->previous, c->id);
    r->fetched.values += c->element_count;
    r->fetched.chunks++;
    r->has_previous = true;
    r->previous = c->id;
    r->end = c->id + 1;
    count_item(r);
    return SVO_OK;
}

/* A GRUP chunk as a whole, before its subtrees are handed out. */
static svo_result check_group(fmt_svo_reader *r, const fmt_chunk *c, svo_error *err)
{
    const bool codec = c->codec == FMT_CODEC_NONE || (c->codec == FMT_CODEC_PACKED && r->voxel_bytes != 0 && c->decoded_size == c->stored_size);
    if ((c->flags & FMT_CHUNK_CRITICAL) == 0 || !codec || c->element_stride != 0)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "wrong flags, codec, size or element fields (SVO-01)");
    SVO_TRY(fmt_stream_payload(r->stream, c, &r->group, err));
    r->subtrees = r->subtree_next = 0;
    SVO_TRY(fmti_group_parse(c, &r->group, r->voxel_bytes, r->subtree, &r->subtrees, err));
    r->group_at = r->group.size;
    for (uint32_t i = 0; i < r->subtrees; i++) r->group_at -= (size_t)r->subtree[i].stored_size;
    return SVO_OK;
}

static svo_result next_subtree(fmt_svo_reader *r, svo_buffer *packed, svo_error *err)
{
    const fmt_chunk *c = &r->subtree[r->subtree_next++];
    SVO_TRY(check_tree(r, c, err));
    packed->size = 0;
    if (svo_buffer_append(packed, r->group.data + r->group_at, (size_t)c->stored_size) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a chunk");
    r->group_at += (size_t)c->stored_size;
    return give_tree(r, c, packed, err);
}

static svo_result fetch_end(fmt_svo_reader *r, svo_error *err)
{
    if (!r->has_stat) return leave_out(r, svo_fail(err, SVO_INVALID_DATA, "the file has no STAT chunk (SVO-01)"), err);
    svo_result result = SVO_OK;
    pthread_mutex_lock(&r->lock);
    if (!r->ended && r->decoded_items == r->items) result = compare_levels(r, err);
    r->ended = true;
    pthread_mutex_unlock(&r->lock);
    return result;
}

/* A chunk whose header has been read; *gave: a subtree is in *packed. */
static svo_result take_chunk(fmt_svo_reader *r, const fmt_chunk *c, svo_buffer *packed, bool *gave, svo_error *err)
{
    uint64_t at = c->offset - 64;
    SVO_TRY(fmt_chunk_known(c, known_types, KNOWN, err));
    if (c->type == FMTI_SVO_HEAD) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "a second HEAD (SVO-01)");
    if (c->type == FMTI_SVO_STAT) return read_stat(r, c, packed, err);
    if (c->type == FMTI_SVO_SHRD) return read_shard(r, c, packed, err);
    if (c->type == FMT_TYPE_META) return read_meta(r, c, packed, err);
    if (c->type == FMTI_SVO_TREE) {
        if (r->has_stat) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "TREE after STAT (SVO-01)");
        SVO_TRY(check_tree(r, c, err));
        SVO_TRY(fmt_stream_payload(r->stream, c, packed, err));
        SVO_TRY(give_tree(r, c, packed, err));
        *gave = true;
    } else if (c->type == FMTI_SVO_GRUP) {
        if (r->has_stat) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "GRUP after STAT (SVO-01)");
        return check_group(r, c, err);
    } else if (c->type == FMTI_SVO_FULL) {
        if (r->has_stat) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "FULL after STAT (SVO-01)");
        return check_full(r, c, err);
    }
    return SVO_OK;
}

static svo_result fetch(void *user, svo_buffer *packed, bool *more, svo_error *err)
{
    fmt_svo_reader *r = user;
    for (bool gave = false; !gave;) {
        if (r->full_at < r->full.size) {
            const size_t here = r->full_at;
            svo_result result = next_full(r, packed, err);
            SVO_TRY(leave_out(r, result, err));
            gave = result == SVO_OK;
            if (gave) count_item(r);
            else r->full_at = here + r->full_chunk.element_stride;
        } else if (r->subtree_next < r->subtrees) {
            const uint64_t stored = r->subtree[r->subtree_next].stored_size;
            svo_result result = next_subtree(r, packed, err);
            SVO_TRY(leave_out(r, result, err));
            gave = result == SVO_OK;
            if (!gave) r->group_at += (size_t)stored;
        } else {
            fmt_chunk c;
            bool any = false;
            SVO_TRY(fmt_stream_next(r->stream, &c, &any, err));
            if (!any) {
                *more = false;
                return fetch_end(r, err);
            }
            svo_result result = take_chunk(r, &c, packed, &gave, err);
            SVO_TRY(leave_out(r, result, err));
            if (result != SVO_OK) gave = false, r->subtrees = r->subtree_next = 0, r->full.size = r->full_at = 0;
        }
    }
    *more = true;
    return SVO_OK;
}

static void from_planes(const uint8_t *planes, uint64_t count, uint32_t stride, uint8_t *values)
{
    for (uint32_t b = 0; b < stride; b++) {
        const uint8_t *plane = planes + b * count;
        for (uint64_t i = 0; i < count; i++) values[i * stride + b] = plane[i];
    }
}

bool fmti_bad_normals(const uint8_t *values, uint64_t count)
{
    enum { LANES = 16 };
    typedef uint16_t lanes __attribute__((vector_size(2 * LANES)));
    const lanes worst = (lanes){0} + 0x8000;
    lanes bad = {0};
    uint16_t any = 0;
    uint64_t i = 0;
    for (; i + LANES <= 2 * count; i += LANES) {
        lanes n;
        memcpy(&n, values + 2 * i, sizeof n);
        bad |= (lanes)(n == worst);
    }
    for (uint32_t k = 0; k < LANES; k++) any |= bad[k];
    for (; i < 2 * count; i++) {
        uint16_t n;
        memcpy(&n, values + 2 * i, 2);
        any |= (uint16_t)(n == 0x8000);
    }
    return any != 0;
}

/* Where values go: behind the masks, or behind the payload as a zstd frame holds it. */
static uint64_t values_begin(const fmt_svo_reader *r, const fmt_chunk *c)
{
    uint64_t size = c->decoded_size;
    if (c->codec == FMT_CODEC_PACKED) size -= c->element_count * r->voxel_bytes;
    return (size + 63) / 64 * 64;
}

/* Masks are behind the counts at the front of the storage, values are in their places or, after zstd, still in planes. */
static svo_result unpack(const fmt_svo_reader *r, const fmt_chunk *c, svo_buffer *storage, uint8_t *const places[SVO_MAX_CHANNELS], svo_chunk *out, svo_error *err)
{
    const svo_tree_info *info = &r->info;
    uint64_t at = c->offset - 64, masks = fmt_load64(storage->data), voxels = fmt_load64(storage->data + 8), values = 16 + masks;
    svo_chunk n = {.code = c->id, .level = svo_chunk_level(info->depth), .depth = info->depth, .node_count = masks, .value_count = voxels};
    n.masks = storage->data + 16;
    for (uint32_t i = 0; i < info->channel_count; i++) {
        const svo_channel *channel = &info->channels[i];
        if (channel->constant) continue;
        uint32_t stride = svo_channel_stride(channel->kind);
        const uint8_t *planes = storage->data + values;
        n.channels[i] = places[i];
        if (c->codec != FMT_CODEC_PACKED) {
            if (stride == 1) n.channels[i] = planes; /* one plane is the values */
            else from_planes(planes, voxels, stride, places[i]);
        }
        if (channel->kind == SVO_KIND_NORMAL_OCT32 && fmti_bad_normals(n.channels[i], voxels))
            SVO_TRY(svo_go_on(r->rules, fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "code %llx: a normal of channel \"%s\" holds -32768 (SVO-09)", (unsigned long long)c->id, channel->name), err));
        values += stride * voxels;
    }
    *out = n;
    return SVO_OK;
}

/* A full leaf from its record. */
static svo_result unpack_record(const svo_tree_info *info, const fmt_chunk *c, const uint8_t *record, svo_buffer *storage, svo_chunk *out, svo_error *err)
{
    svo_chunk n = {.depth = info->depth, .value_count = 1};
    size_t at = 8;
    storage->size = 0;
    if (svo_buffer_append(storage, record, c->element_stride) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a full leaf");
    if (!fmti_parse_place(fmt_load64(record), svo_chunk_level(info->depth), &n.level, &n.code))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset, "no place of a full leaf (SVO-11)");
    for (uint32_t i = 0; i < info->channel_count; i++) {
        if (info->channels[i].constant) continue;
        n.channels[i] = storage->data + at;
        if (info->channels[i].kind == SVO_KIND_NORMAL_OCT32 && (fmt_load16(n.channels[i]) == 0x8000 || fmt_load16(n.channels[i] + 2) == 0x8000))
            return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset, "code %llx: a normal holds -32768 (SVO-09)", (unsigned long long)n.code);
        at += svo_channel_stride(info->channels[i].kind);
    }
    *out = n;
    return SVO_OK;
}

size_t fmti_svo_packed(const svo_buffer *packed, fmt_chunk *chunk)
{
    SVO_ASSERT(packed->size >= sizeof *chunk);
    size_t stored = packed->size - sizeof *chunk;
    memcpy(chunk, packed->data + stored, sizeof *chunk);
    return stored;
}

/* What is not one zstd frame, a subtree of a GRUP chunk or a TREE chunk with packed values, to masks behind their counts and values. */
static svo_result decode_apart(fmt_svo_reader *r, const fmt_chunk *c, const uint8_t *bytes, uint64_t stored, svo_buffer *storage,
                               uint8_t *const places[SVO_MAX_CHANNELS], svo_error *err)
{
    const uint64_t values = c->element_count * r->voxel_bytes, masks = c->decoded_size - 16 - values;
    uint64_t coded = c->element_stride;
    if (c->type == FMTI_SVO_TREE) {
        if (stored < 4 || fmt_load32(bytes) > stored - 4) return svo_fail(err, SVO_INVALID_DATA, "it ends inside the masks (SVO-13)");
        coded = fmt_load32(bytes);
        bytes += 4, stored -= 4;
    }
    if ((masks == 0) != (r->info.depth == 0) || (masks == 0 && coded != 0))
        return svo_fail(err, SVO_INVALID_DATA, "%llu masks at depth %u (SVO-07)", (unsigned long long)masks, r->info.depth);
    fmt_store64(storage->data, masks);
    fmt_store64(storage->data + 8, c->element_count);
    if (masks != 0 && c->type == FMTI_SVO_TREE) SVO_TRY(fmt_zstd_decode_to(r->pool, bytes, (size_t)coded, storage->data + 16, masks, err));
    else if (masks != 0) SVO_TRY(fmti_masks_decode(r->masks, r->info.depth - svo_chunk_level(r->info.depth), bytes, coded, storage->data + 16, masks, err));
    if (c->codec == FMT_CODEC_PACKED) return fmti_svo_unpack(&r->info, bytes + coded, stored - coded, c->element_count, r->allocator, places, err);
    return values == 0 ? SVO_OK : fmt_zstd_decode_to(r->pool, bytes + coded, (size_t)(stored - coded), storage->data + 16 + masks, values, err);
}

static svo_result decode_tree(fmt_svo_reader *r, const fmt_chunk *chunk, const svo_buffer *packed, size_t stored, svo_buffer *storage, svo_chunk *out,
                              svo_error *err)
{
    const fmt_chunk c = *chunk;
    uint64_t at = c.offset - 64, size = values_begin(r, &c), place[SVO_MAX_CHANNELS] = {0};
    uint8_t *places[SVO_MAX_CHANNELS];
    for (uint32_t i = 0; i < r->info.channel_count; i++) {
        place[i] = size;
        if (!r->info.channels[i].constant) size += (svo_channel_stride(r->info.channels[i].kind) * c.element_count + 7) / 8 * 8;
    }
    /* A bit of 64 values' flags is stored at least. */
    if (c.codec == FMT_CODEC_PACKED && c.element_count / 64 > stored) return fmt_chunk_fail(err, SVO_INVALID_DATA, c.type, at, "too short for its values (SVO-13)");
    storage->size = 0;
    if (!svo_buffer_reserve(storage, (size_t)size + 1))
        return fmt_chunk_fail(err, SVO_OUT_OF_MEMORY, c.type, at, "no memory for %llu decoded bytes", (unsigned long long)size);
    for (uint32_t i = 0; i < r->info.channel_count; i++) places[i] = storage->data + place[i];
    svo_error inner = {0};
    const bool apart = c.type == FMTI_SVO_GRUP || c.codec == FMT_CODEC_PACKED;
    svo_result result = apart ? decode_apart(r, &c, packed->data, stored, storage, places, &inner)
                              : fmt_zstd_decode(r->pool, packed->data, stored, c.decoded_size, storage, &inner);
    if (result != SVO_OK) return fmt_chunk_fail(err, result, c.type, at, "%s", inner.message);
    uint64_t masks = fmt_load64(storage->data), voxels = fmt_load64(storage->data + 8);
    if (voxels != c.element_count || masks != c.decoded_size - 16 - voxels * r->voxel_bytes)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c.type, at, "%llu masks and %llu values do not make %llu bytes (SVO-06)", (unsigned long long)masks,
                              (unsigned long long)voxels, (unsigned long long)c.decoded_size);
    if (masks == 0 && r->info.depth != 0) return fmt_chunk_fail(err, SVO_INVALID_DATA, c.type, at, "no masks: a full leaf belongs into FULL (SVO-07)");
    return unpack(r, &c, storage, places, out, err);
}

void fmti_svo_reader_rules(fmt_svo_reader *r, svo_rules *rules) { r->rules = rules; }
void fmti_svo_reader_left_out(fmt_svo_reader *r) { r->holes = true; }

static svo_result decode(void *user, const svo_buffer *packed, svo_buffer *storage, svo_chunk *out, svo_error *err)
{
    fmt_svo_reader *r = user;
    fmt_chunk c;
    svo_chunk n;
    svo_tree_counts counts = {0};
    svo_error inner = {0};
    size_t stored = fmti_svo_packed(packed, &c);
    if (c.type == FMTI_SVO_FULL) SVO_TRY(unpack_record(&r->info, &c, packed->data, storage, &n, err));
    else SVO_TRY(decode_tree(r, &c, packed, stored, storage, &n, err));
    if (svo_chunk_check(&r->info, &n, &counts, &inner) != SVO_OK)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c.type, c.offset - 64, "%s (SVO-07)", inner.message);
    svo_result result = SVO_OK;
    pthread_mutex_lock(&r->lock);
    r->decoded_items++;
    svo_counts_add(&r->decoded, &counts);
    if (r->ended && r->decoded_items == r->items) result = compare_levels(r, err);
    pthread_mutex_unlock(&r->lock);
    if (result == SVO_OK) *out = n;
    return result;
}

svo_chunk_source fmt_svo_reader_source(fmt_svo_reader *r)
{
    svo_chunk_source s = {r, fetch, decode};
    return s;
}

void fmt_svo_reader_close(fmt_svo_reader *r)
{
    if (r == NULL) return;
    fmt_stream_close(r->stream);
    fmt_zstd_pool_free(r->pool);
    fmti_masks_pool_free(r->masks);
    svo_buffer_free(&r->group);
    fmt_meta_free(r->allocator, r->provenance);
    svo_buffer_free(&r->full);
    pthread_mutex_destroy(&r->lock);
    svo_free(r->allocator, r, 1, sizeof *r);
}
