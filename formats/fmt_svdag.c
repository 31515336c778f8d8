#include "fmt_svdag.h"

#include <string.h>

#include "fmti_svo.h"
#include "svo_algorithm1.h"

#define HEAD FMT_FOURCC('H', 'E', 'A', 'D')
#define NODE FMT_FOURCC('N', 'O', 'D', 'E')
#define BRCK FMT_FOURCC('B', 'R', 'C', 'K')
#define LVLS FMT_FOURCC('L', 'V', 'L', 'S')
#define CODE FMT_FOURCC('C', 'O', 'D', 'E')
#define TREE FMT_FOURCC('T', 'R', 'E', 'E')
#define ARAW FMT_FOURCC('A', 'R', 'A', 'W')
#define ATBL FMT_FOURCC('A', 'T', 'B', 'L')
#define ADIR FMT_FOURCC('A', 'D', 'I', 'R')
#define APAY FMT_FOURCC('A', 'P', 'A', 'Y')
#define ACOR FMT_FOURCC('A', 'C', 'O', 'R')

enum { HEAD_FIXED = 336, RECORD = 48, NODE_HEAD = 4 /* words */ };
enum { FLAG_LOD = 1, FLAG_UNNUMBERED = 2, FLAG_AVERAGED = 4 };
enum { ENCODING_REPEATS = 4 }; /* blocks without repeated superblocks */
enum { CODE_FIXED = 72, CODE_LEVEL = 32, CODE_FULL = 1 }; /* layout 2 */

static const uint32_t known[] = {HEAD, NODE, BRCK, LVLS, CODE, TREE, ARAW, ATBL, ADIR, APAY, ACOR, FMT_TYPE_META};
enum { KNOWN = sizeof known / sizeof known[0] };

/* --- writing ----------------------------------------------------------------------------------------------------- */

static void store_f64(uint8_t *p, double v)
{
    uint64_t bits;
    memcpy(&bits, &v, 8);
    fmt_store64(p, bits);
}

static size_t store_head(const svo_view *v, uint8_t *b)
{
    memset(b, 0, HEAD_FIXED + RECORD * SVO_MAX_CHANNELS);
    fmt_store32(b, v->depth);
    fmt_store32(b + 4, (uint32_t)v->layout);
    b[8] = (uint8_t)v->surface;
    b[9] = (uint8_t)v->fill;
    fmt_store16(b + 10, (uint16_t)v->channel_count);
    fmt_store32(b + 12, (v->lod ? FLAG_LOD : 0) | (v->unnumbered ? FLAG_UNNUMBERED : 0) | (v->averaged ? FLAG_AVERAGED : 0));
    for (int i = 0; i < 16; i++) store_f64(b + 16 + 8 * i, v->voxel_to_world[i]);
    fmt_store64(b + 144, v->attribute_count);
    fmt_store32(b + 152, v->root);
    for (uint32_t i = 0; i <= SVO_MAX_DEPTH; i++) fmt_store64(b + 160 + 8 * i, v->nodes[i]);
    for (uint32_t i = 0; i < v->channel_count; i++) {
        uint8_t *r = b + HEAD_FIXED + RECORD * i;
        fmti_store_channel(&v->channels[i].channel, r);
        fmt_store32(r + 32, v->channels[i].repeats != NULL ? ENCODING_REPEATS : (uint32_t)v->channels[i].encoding);
        fmt_store32(r + 36, (uint32_t)v->channels[i].correction_count);
        if (v->channels[i].encoding >= SVO_ENCODING_BLOCKS) fmt_store64(r + 40, v->channels[i].table_count);
    }
    return HEAD_FIXED + RECORD * (size_t)v->channel_count;
}

static svo_result put(fmt_writer *w, uint32_t type, uint64_t id, uint64_t count, uint32_t stride, const void *bytes, svo_error *err)
{
    fmt_chunk c = {.type = type, .flags = FMT_CHUNK_CRITICAL, .stored_size = count * stride, .decoded_size = count * stride,
                   .element_count = count, .element_stride = stride, .id = id};
    return fmt_writer_chunk(w, &c, bytes, err);
}

static svo_result put_level(fmt_writer *w, const svo_view_level *l, uint32_t level, svo_error *err)
{
    /* Head and words are one payload; a level is copied once so that they lie behind each other. */
    uint64_t words = l->word_count + NODE_HEAD;
    uint32_t *copy = svo_alloc(NULL, words, sizeof *copy);
    if (copy == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory writing level %u", level);
    copy[0] = l->offset_words;
    copy[1] = 0;
    copy[2] = (uint32_t)l->node_count;
    copy[3] = (uint32_t)(l->node_count >> 32);
    memcpy(copy + NODE_HEAD, l->words, (size_t)l->word_count * sizeof *copy);
    svo_result r = put(w, NODE, level, words, 4, copy, err);
    svo_free(NULL, copy, words, sizeof *copy);
    return r;
}

static svo_result put_best(fmt_writer *w, const svo_view *v, svo_error *err)
{
    SVO_TRY(put(w, LVLS, 0, v->brick_level, SVO_BEST_LEVEL_BYTES, v->best_levels, err));
    SVO_TRY(put(w, CODE, 0, v->best_code_bytes, 1, v->best_codes, err));
    return put(w, TREE, 0, v->best_stream_bytes, 1, v->best_stream, err);
}

static svo_result put_fast(fmt_writer *w, const svo_view *v, svo_error *err)
{
    uint8_t code[CODE_FIXED + CODE_LEVEL * SVO_MAX_DEPTH] = {0};
    const svo_view_fast *f = &v->fast;
    memcpy(code, f->id_bits, 8);
    memcpy(code + 8, f->code_bits, 8);
    memcpy(code + 16, f->turn, 48);
    fmt_store64(code + 64, f->full ? CODE_FULL : 0);
    for (uint32_t l = 0; l < v->brick_level; l++) {
        uint8_t *b = code + CODE_FIXED + CODE_LEVEL * l;
        fmt_store64(b, (f->level[l].end - f->level[l].begin) / 8);
        fmt_store64(b + 8, f->level[l].pool_count);
        fmt_store64(b + 16, f->level[l].node_count);
        memcpy(b + 24, f->level[l].code_bits, 4);
        b[28] = f->level[l].skip_bits;
        b[29] = f->level[l].size_bits;
    }
    size_t size = CODE_FIXED + CODE_LEVEL * (size_t)v->brick_level;
    fmt_chunk c = {.type = CODE, .flags = FMT_CHUNK_CRITICAL, .stored_size = size, .decoded_size = size};
    SVO_TRY(fmt_writer_chunk(w, &c, code, err));
    return put(w, TREE, 0, f->tree_bytes, 1, f->tree, err);
}

static uint32_t entry_bytes(const svo_view_channel *c) { return c->encoding == SVO_ENCODING_BLOCKS ? SVO_PALETTE_ENTRY : SVO_ALGORITHM1_ENTRY; }

static svo_result put_channel(fmt_writer *w, const svo_view *v, uint32_t i, svo_error *err)
{
    const svo_view_channel *c = &v->channels[i];
    uint32_t stride = svo_channel_stride(c->channel.kind);
    if (c->encoding == SVO_ENCODING_CONSTANT) return SVO_OK;
    if (c->encoding == SVO_ENCODING_RAW) {
        SVO_TRY(put(w, ARAW, i, v->attribute_count, stride, c->raw, err));
    } else {
        SVO_TRY(put(w, ATBL, i, c->table_count, stride, c->table, err));
        SVO_TRY(put(w, ADIR, i, svo_view_directory_elements(v, c), entry_bytes(c), c->repeats != NULL ? c->repeats : c->directory, err));
        SVO_TRY(put(w, APAY, i, c->payload_size, 1, c->payload, err));
    }
    return c->correction_count != 0 ? put(w, ACOR, i, c->correction_count, SVO_CORRECTION, c->corrections, err) : SVO_OK;
}

static svo_result put_all(fmt_writer *w, const svo_view *v, const char *provenance, svo_error *err)
{
    uint8_t head[HEAD_FIXED + RECORD * SVO_MAX_CHANNELS];
    size_t size = store_head(v, head);
    fmt_chunk c = {.type = HEAD, .flags = FMT_CHUNK_CRITICAL, .stored_size = size, .decoded_size = size};
    SVO_TRY(fmt_writer_chunk(w, &c, head, err));
    if (!v->empty) {
        if (v->layout == SVO_LAYOUT_FAST) SVO_TRY(put_fast(w, v, err));
        else if (v->layout == SVO_LAYOUT_BEST) SVO_TRY(put_best(w, v, err));
        else for (uint32_t l = 0; l < v->brick_level; l++) SVO_TRY(put_level(w, &v->levels[l], l, err));
        SVO_TRY(put(w, BRCK, 0, v->brick_count, 8, v->bricks, err));
    }
    for (uint32_t i = 0; i < v->channel_count; i++) SVO_TRY(put_channel(w, v, i, err));
    return fmt_writer_meta(w, provenance, err);
}

svo_result fmt_svdag_write(fmt_output *out, const svo_view *view, const char *provenance, svo_error *err)
{
    fmt_writer *w;
    SVO_TRY(fmt_writer_begin(out, FMT_KIND_SVDAG, 1, 0, &w, err));
    svo_result r = put_all(w, view, provenance, err);
    if (r == SVO_OK) return fmt_writer_end(w, err);
    fmt_writer_discard(w);
    return r;
}

/* --- reading ----------------------------------------------------------------------------------------------------- */

typedef struct reader {
    const fmt_container *c;
    uint32_t next; /* chunk */
    svo_error *err;
    svo_rules *rules; /* NULL: the first violation is enough */
    uint64_t usable;  /* channels whose arrays were found whole, a bit each */
    bool repeats[SVO_MAX_CHANNELS]; /* of channels: encoding 4 */
} reader;

static svo_result go_on(reader *r, svo_result result) { return svo_go_on(r->rules, result, r->err); }

static svo_result bad(reader *r, const fmt_chunk *c, const char *why)
{
    return fmt_chunk_fail(r->err, SVO_INVALID_DATA, c->type, c->offset, "%s", why);
}

/* The next chunk, which must be of this type and id; its payload, hash checked. stride 0: any. */
static svo_result take(reader *r, uint32_t type, uint64_t id, uint32_t stride, const fmt_chunk **chunk, const uint8_t **bytes)
{
    while (r->next < r->c->chunk_count && fmt_chunk_skip(&r->c->chunks[r->next], known, KNOWN)) r->next++;
    char name[5];
    fmt_fourcc_text(type, name);
    if (r->next == r->c->chunk_count) return svo_fail(r->err, SVO_INVALID_DATA, "chunk %s is missing (DAG-01)", name);
    const fmt_chunk *c = &r->c->chunks[r->next];
    if (c->type != type || c->id != id)
        return fmt_chunk_fail(r->err, SVO_INVALID_DATA, c->type, c->offset, "chunk %s %llu must come here (DAG-01)", name, (unsigned long long)id);
    if (c->codec != FMT_CODEC_NONE || c->flags != FMT_CHUNK_CRITICAL) return bad(r, c, "it must be critical and not compressed (DAG-01)");
    if (stride != 0 && c->element_stride != stride) return bad(r, c, "wrong element stride (DAG-08)");
    SVO_TRY(fmt_container_payload(r->c, c, bytes, r->err));
    r->next++;
    *chunk = c;
    return SVO_OK;
}

static svo_result parse_record(reader *r, const fmt_chunk *chunk, const uint8_t *b, svo_view_channel *c, bool *repeats)
{
    const char *why = fmti_parse_channel(b, &c->channel);
    if (why != NULL) return bad(r, chunk, why);
    uint32_t encoding = fmt_load32(b + 32);
    c->table_count = fmt_load64(b + 40);
    if (encoding > ENCODING_REPEATS) return bad(r, chunk, "unknown encoding of a channel (DAG-02)");
    c->encoding = encoding == ENCODING_REPEATS ? SVO_ENCODING_BLOCKS : (svo_encoding)encoding;
    *repeats = encoding == ENCODING_REPEATS;
    c->correction_count = fmt_load32(b + 36);
    if (c->channel.constant != (c->encoding == SVO_ENCODING_CONSTANT)) return bad(r, chunk, "constant flag and encoding of a channel disagree (DAG-02)");
    if ((c->encoding >= SVO_ENCODING_BLOCKS) != (c->table_count != 0)) return bad(r, chunk, "table size and encoding of a channel disagree (DAG-02)");
    return SVO_OK;
}

/* SVO_CANCELLED: violations went to r->rules, and what follows cannot be told. */
static svo_result parse_head(reader *r, svo_view *v)
{
    const fmt_chunk *chunk;
    const uint8_t *b;
    SVO_TRY(take(r, HEAD, 0, 0, &chunk, &b));
    if (chunk->stored_size < HEAD_FIXED || chunk->element_stride != 0 || chunk->element_count != 0) return bad(r, chunk, "HEAD is too short (DAG-02)");
    uint32_t layout = fmt_load32(b + 4), flags = fmt_load32(b + 12);
    if (layout != SVO_LAYOUT_PLAIN && layout != SVO_LAYOUT_FAST && layout != SVO_LAYOUT_BEST)
        return fmt_chunk_fail(r->err, SVO_UNSUPPORTED, HEAD, chunk->offset + 4, "layout %u is not known; use a newer version (DAG-01)", layout);
    if ((flags & ~(uint32_t)(FLAG_LOD | FLAG_UNNUMBERED | FLAG_AVERAGED)) != 0 || (flags & (FLAG_LOD | FLAG_AVERAGED)) == FLAG_AVERAGED || fmt_load32(b + 156) != 0) SVO_TRY(go_on(r, bad(r, chunk, "reserved fields are not 0 (DAG-02)")));
    svo_tree_info info;
    bool whole = true;
    memset(&info, 0, sizeof info);
    info.depth = fmt_load32(b);
    info.surface = (svo_surface)b[8];
    info.fill = (svo_fill)b[9];
    info.channel_count = fmt_load16(b + 10);
    for (int i = 0; i < 16; i++) {
        uint64_t bits = fmt_load64(b + 16 + 8 * i);
        memcpy(&info.voxel_to_world[i], &bits, 8);
    }
    if (info.channel_count > SVO_MAX_CHANNELS || chunk->stored_size != HEAD_FIXED + RECORD * (uint64_t)info.channel_count)
        return bad(r, chunk, "size of HEAD and number of channels disagree (DAG-02)");
    for (uint32_t i = 0; i < info.channel_count; i++) {
        svo_result one = parse_record(r, chunk, b + HEAD_FIXED + RECORD * i, &v->channels[i], &r->repeats[i]);
        SVO_TRY(go_on(r, one));
        whole = whole && one == SVO_OK;
        info.channels[i] = v->channels[i].channel;
    }
    if (!whole) return SVO_CANCELLED;
    const char *why = fmti_check_info(&info);
    if (why != NULL) return bad(r, chunk, why);
    v->depth = info.depth;
    v->tree_depth = info.depth < 2 ? 2 : info.depth;
    v->brick_level = v->tree_depth - 2;
    v->layout = (svo_layout)layout;
    v->lod = (flags & FLAG_LOD) != 0;
    v->averaged = (flags & FLAG_AVERAGED) != 0;
    v->unnumbered = (flags & FLAG_UNNUMBERED) != 0;
    v->root = fmt_load32(b + 152);
    v->attribute_count = fmt_load64(b + 144);
    v->empty = fmt_load64(b + 160) == 0;
    for (uint32_t i = 0; i <= SVO_MAX_DEPTH; i++) v->nodes[i] = fmt_load64(b + 160 + 8 * i);
    memcpy(v->voxel_to_world, info.voxel_to_world, sizeof v->voxel_to_world);
    v->surface = info.surface;
    v->fill = info.fill;
    v->channel_count = info.channel_count;
    return SVO_OK;
}

static svo_result parse_fast(reader *r, svo_view *v)
{
    const fmt_chunk *chunk;
    const uint8_t *b;
    svo_view_fast *f = &v->fast;
    SVO_TRY(take(r, CODE, 0, 0, &chunk, &b));
    if (chunk->stored_size != CODE_FIXED + CODE_LEVEL * (uint64_t)v->brick_level || chunk->element_stride != 0 || chunk->element_count != 0)
        return bad(r, chunk, "wrong size (DAG-17)");
    memcpy(f->id_bits, b, 8);
    memcpy(f->code_bits, b + 8, 8);
    memcpy(f->turn, b + 16, 48);
    if (fmt_load64(b + 64) > CODE_FULL) SVO_TRY(go_on(r, bad(r, chunk, "reserved fields are not 0 (DAG-17)")));
    f->full = fmt_load64(b + 64) == CODE_FULL;
    uint64_t at = 0;
    for (uint32_t l = 0; l < v->brick_level; l++) {
        const uint8_t *p = b + CODE_FIXED + CODE_LEVEL * l;
        svo_view_fast_level *to = &f->level[l];
        uint64_t bytes = fmt_load64(p);
        if (bytes > (uint64_t)1 << 48 || fmt_load16(p + 30) != 0) return bad(r, chunk, "size of a pool out of range, or a reserved field is not 0 (DAG-17)");
        to->begin = at;
        to->end = at += 8 * bytes;
        to->pool_count = fmt_load64(p + 8);
        to->node_count = fmt_load64(p + 16);
        memcpy(to->code_bits, p + 24, 4);
        to->skip_bits = p[28];
        to->size_bits = p[29];
    }
    SVO_TRY(take(r, TREE, 0, 1, &chunk, &f->tree));
    f->tree_bytes = chunk->stored_size;
    return SVO_OK;
}

static svo_result parse_geometry(reader *r, svo_view *v)
{
    const fmt_chunk *chunk;
    const uint8_t *b;
    if (v->empty) return SVO_OK;
    if (v->layout == SVO_LAYOUT_FAST) SVO_TRY(parse_fast(r, v));
    if (v->layout == SVO_LAYOUT_BEST) {
        SVO_TRY(take(r, LVLS, 0, SVO_BEST_LEVEL_BYTES, &chunk, &b));
        if (chunk->element_count != v->brick_level) return bad(r, chunk, "wrong number of levels (DAG-12)");
        v->best_levels = (const struct svoi_best_level *)(const void *)b;
        SVO_TRY(take(r, CODE, 0, 1, &chunk, &v->best_codes));
        v->best_code_bytes = chunk->stored_size;
        SVO_TRY(take(r, TREE, 0, 1, &chunk, &v->best_stream));
        v->best_stream_bytes = chunk->stored_size;
    }
    for (uint32_t l = 0; l < v->brick_level && v->layout == SVO_LAYOUT_PLAIN; l++) {
        SVO_TRY(take(r, NODE, l, 4, &chunk, &b));
        if (chunk->element_count < NODE_HEAD) return bad(r, chunk, "too short (DAG-03)");
        if (fmt_load32(b + 4) != 0) SVO_TRY(go_on(r, bad(r, chunk, "a reserved field is not 0 (DAG-03)")));
        v->levels[l] = (svo_view_level){.words = (const uint32_t *)(const void *)b + NODE_HEAD, .word_count = chunk->element_count - NODE_HEAD,
                                        .node_count = fmt_load64(b + 8), .offset_words = fmt_load32(b)};
    }
    SVO_TRY(take(r, BRCK, 0, 8, &chunk, &b));
    v->bricks = (const uint64_t *)(const void *)b;
    v->brick_count = chunk->element_count;
    return SVO_OK;
}

static svo_result parse_corrections(reader *r, svo_view_channel *c, uint32_t i)
{
    const fmt_chunk *chunk;
    if (c->correction_count == 0) return SVO_OK;
    SVO_TRY(take(r, ACOR, i, SVO_CORRECTION, &chunk, &c->corrections));
    if (chunk->element_count == c->correction_count) return SVO_OK;
    r->usable &= ~((uint64_t)1 << i);
    return go_on(r, bad(r, chunk, "wrong number of corrections (DAG-08)"));
}

static svo_result parse_channel(reader *r, svo_view *v, uint32_t i)
{
    svo_view_channel *c = &v->channels[i];
    uint32_t stride = svo_channel_stride(c->channel.kind);
    const fmt_chunk *chunk;
    if (c->encoding == SVO_ENCODING_CONSTANT) return SVO_OK;
    if (c->encoding == SVO_ENCODING_RAW) {
        SVO_TRY(take(r, ARAW, i, stride, &chunk, &c->raw));
        if (chunk->element_count == v->attribute_count) return parse_corrections(r, c, i);
        r->usable &= ~((uint64_t)1 << i);
        SVO_TRY(go_on(r, bad(r, chunk, "wrong number of values (DAG-08)")));
        return parse_corrections(r, c, i);
    }
    SVO_TRY(take(r, ATBL, i, stride, &chunk, &c->table));
    if (chunk->element_count != c->table_count) {
        r->usable &= ~((uint64_t)1 << i);
        SVO_TRY(go_on(r, bad(r, chunk, "wrong number of table entries (DAG-08)")));
    }
    SVO_TRY(take(r, ADIR, i, entry_bytes(c), &chunk, &c->directory));
    c->superblock_count = chunk->element_count;
    if (r->repeats[i]) {
        const uint64_t words = svo_palette_repeat_words(v->attribute_count);
        if (words > chunk->element_count) { /* (the channel is then not looked at) */
            r->usable &= ~((uint64_t)1 << i);
            SVO_TRY(go_on(r, bad(r, chunk, "too few elements (DAG-08)")));
        } else {
            c->repeats = c->directory;
            c->directory += words * SVO_PALETTE_ENTRY;
            c->superblock_count -= words;
        }
    }
    SVO_TRY(take(r, APAY, i, 1, &chunk, &c->payload));
    c->payload_size = chunk->stored_size;
    return parse_corrections(r, c, i);
}

/* Chunks follow each other: where those of a channel are not in their places, nor are those of the next. */
static svo_result parse_channels(reader *r, svo_view *v)
{
    for (uint32_t i = 0; i < v->channel_count; i++) {
        svo_result one = parse_channel(r, v, i);
        SVO_TRY(go_on(r, one));
        if (one == SVO_OK) continue;
        r->usable &= ((uint64_t)1 << i) - 1;
        return SVO_OK;
    }
    return SVO_OK;
}

static svo_result parse(reader *r, fmt_svdag *f)
{
    svo_view *v = &f->view;
    for (uint32_t i = 0; i < r->c->chunk_count; i++) SVO_TRY(fmt_chunk_known(&r->c->chunks[i], known, KNOWN, r->err));
    SVO_TRY(parse_head(r, v));
    SVO_TRY(parse_geometry(r, v));
    uint64_t before = r->rules != NULL ? r->rules->count : 0;
    SVO_TRY(parse_channels(r, v));
    if (r->rules == NULL || r->rules->count == before) /* (else the rest is not in its place for a reason that is known) */
        for (; r->next < r->c->chunk_count; r->next++) {
            const fmt_chunk *c = &r->c->chunks[r->next];
            if (c->type != FMT_TYPE_META && !fmt_chunk_skip(c, known, KNOWN)) SVO_TRY(go_on(r, bad(r, c, "a chunk too many or in the wrong place (DAG-01, DAG-08)")));
        }
    /* payloads that nobody reads are checked too, so that damage is never passed on */
    for (uint32_t i = 0; i < r->c->chunk_count; i++) {
        const uint8_t *bytes;
        if (fmt_chunk_skip(&r->c->chunks[i], known, KNOWN) && r->c->chunks[i].codec == FMT_CODEC_NONE)
            SVO_TRY(go_on(r, fmt_container_payload(r->c, &r->c->chunks[i], &bytes, r->err)));
    }
    SVO_TRY(go_on(r, fmt_container_meta(r->c, f->allocator, &f->provenance, r->err)));
    SVO_TRY(svo_view_prepare(v, f->allocator, r->err));
    return svo_view_violations(v, f->allocator, r->usable, r->rules, r->err);
}

svo_result fmt_svdag_open(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_svdag *out, svo_error *err)
{
    fmt_svdag f;
    memset(&f, 0, sizeof f);
    f.allocator = a;
    SVO_TRY(fmt_container_open(data, size, a, &f.container, err));
    reader r = {.c = &f.container, .err = err, .usable = UINT64_MAX};
    svo_result result = f.container.kind == FMT_KIND_SVDAG ? parse(&r, &f) : svo_fail(err, SVO_INVALID_DATA, "not a .svdag file but another kind of svokit file");
    if (result != SVO_OK) {
        fmt_svdag_close(&f);
        return result;
    }
    svo_view_accelerate(&f.view, a);
    *out = f;
    return SVO_OK;
}

svo_result fmt_svdag_violations(const uint8_t *data, uint64_t size, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    fmt_svdag f;
    svo_error here = {0};
    if (err == NULL) err = &here;
    memset(&f, 0, sizeof f);
    f.allocator = a;
    reader r = {.c = &f.container, .err = err, .rules = rules, .usable = UINT64_MAX};
    svo_result result = fmt_container_open(data, size, a, &f.container, err);
    if (result == SVO_OK) result = f.container.kind == FMT_KIND_SVDAG ? parse(&r, &f) : svo_fail(err, SVO_INVALID_DATA, "not a .svdag file but another kind of svokit file");
    fmt_svdag_close(&f);
    result = svo_go_on(rules, result, err);
    return result == SVO_CANCELLED ? SVO_OK : result;
}

void fmt_svdag_close(fmt_svdag *f)
{
    if (f == NULL) return;
    fmt_meta_free(f->allocator, f->provenance);
    svo_view_release(&f->view, f->allocator);
    fmt_container_close(&f->container);
    memset(f, 0, sizeof *f);
}
