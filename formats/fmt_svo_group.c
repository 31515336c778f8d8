/* GRUP chunks of .svo: subtrees with entropy-coded masks, up to 64 of them under one chunk header. */
#include <string.h>

#include "fmti_svo.h"

enum { GROUP_CODES = 6 /* bits of a code that differ inside a group */, GROUP_BYTES = 1 << 20, VARINT_MOST = 5 };

static size_t store_varint(uint8_t *to, uint64_t v)
{
    size_t n = 0;
    for (; v >= 128; v >>= 7) to[n++] = (uint8_t)(v | 128);
    to[n++] = (uint8_t)v;
    return n;
}

/* At most 35 bits, and no longer than needed. */
static bool load_varint(fmt_cursor *c, uint64_t *v)
{
    *v = 0;
    for (uint32_t i = 0; i < VARINT_MOST; i++) {
        uint8_t b = fmt_cursor_u8(c);
        *v |= (uint64_t)(b & 127) << 7 * i;
        if (b < 128) return c->ok && (b != 0 || i == 0);
    }
    return false;
}

void fmti_items_init(fmti_items *t, const svo_tree_info *info, const svo_allocator *a)
{
    fmti_full_init(&t->full, info, a);
    t->group = (fmti_group){.voxel_bytes = fmti_voxel_bytes(info)};
    svo_buffer_init(&t->group.records, a);
    svo_buffer_init(&t->group.streams, a);
}

void fmti_items_free(fmti_items *t)
{
    fmti_full_free(&t->full);
    svo_buffer_free(&t->group.records);
    svo_buffer_free(&t->group.streams);
}

static svo_result group_flush(fmti_group *g, fmt_writer *w, svo_error *err)
{
    if (g->count == 0) return SVO_OK;
    g->records.data[0] = (uint8_t)g->count;
    if (svo_buffer_append(&g->records, g->streams.data, g->streams.size) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a group of chunks");
    uint64_t size = g->records.size;
    fmt_chunk c = {.type = FMTI_SVO_GRUP, .flags = FMT_CHUNK_CRITICAL, .codec = g->codec, .stored_size = size, .decoded_size = size, .element_count = g->values, .id = g->first};
    svo_result r = fmt_writer_chunk(w, &c, g->records.data, err);
    g->records.size = g->streams.size = 0;
    g->count = 0;
    return r;
}

static svo_result group_add(fmti_group *g, fmt_writer *w, const fmt_chunk *c, const uint8_t *bytes, svo_error *err)
{
    if (g->count != 0 && (c->codec != g->codec || c->id >> GROUP_CODES != g->first >> GROUP_CODES || g->streams.size + c->stored_size > GROUP_BYTES)) SVO_TRY(group_flush(g, w, err));
    uint8_t record[1 + 4 * 10], *at = record;
    if (g->count == 0) {
        g->first = c->id;
        g->codec = c->codec;
        g->values = 0;
        *at++ = 0; /* the count, when it is known */
    }
    *at++ = (uint8_t)(c->id & ((1u << GROUP_CODES) - 1));
    at += store_varint(at, c->decoded_size - 16 - c->element_count * g->voxel_bytes);
    at += store_varint(at, c->element_count);
    at += store_varint(at, c->element_stride);
    if (g->voxel_bytes != 0) at += store_varint(at, c->stored_size - c->element_stride);
    if (svo_buffer_append(&g->records, record, (size_t)(at - record)) == NULL || svo_buffer_append(&g->streams, bytes, (size_t)c->stored_size) == NULL)
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a group of chunks");
    g->values += c->element_count;
    g->count++;
    return SVO_OK;
}

svo_result fmti_items_flush(fmti_items *t, fmt_writer *w, svo_error *err)
{
    SVO_TRY(fmti_full_flush(&t->full, w, err));
    return group_flush(&t->group, w, err);
}

svo_result fmti_items_put(fmti_items *t, fmt_writer *w, fmt_chunk *c, const uint8_t *bytes, svo_error *err)
{
    if (c->type == FMTI_SVO_FULL) {
        SVO_TRY(group_flush(&t->group, w, err));
        return fmti_full_add(&t->full, w, bytes, err);
    }
    if (c->type == FMTI_SVO_GRUP) {
        SVO_TRY(fmti_full_flush(&t->full, w, err));
        return group_add(&t->group, w, c, bytes, err);
    }
    SVO_TRY(fmti_items_flush(t, w, err));
    return fmt_writer_chunk(w, c, bytes, err);
}

svo_result fmti_group_parse(const fmt_chunk *c, const svo_buffer *payload, uint32_t voxel_bytes, fmt_chunk *out, uint32_t *count, svo_error *err)
{
    uint64_t at = c->offset - 64, values = 0;
    fmt_cursor in = fmt_cursor_make(payload->data, payload->size);
    uint32_t n = fmt_cursor_u8(&in);
    if (n == 0 || n > FMTI_GROUP_MOST) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "a group of %u subtrees (SVO-12)", n);
    for (uint32_t i = 0; i < n; i++) {
        uint64_t masks, own, coded, zipped = 0, low = fmt_cursor_u8(&in);
        bool ok = load_varint(&in, &masks) && load_varint(&in, &own) && load_varint(&in, &coded);
        if (ok && voxel_bytes != 0) ok = load_varint(&in, &zipped);
        if (!ok || low >> GROUP_CODES != 0 || coded > payload->size || zipped > payload->size)
            return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "bad record of subtree %u (SVO-12)", i);
        out[i] = (fmt_chunk){.type = c->type, .flags = c->flags, .codec = c->codec, .offset = c->offset, .id = c->id >> GROUP_CODES << GROUP_CODES | low, .element_count = own,
                             .element_stride = (uint32_t)coded, .stored_size = coded + zipped, .decoded_size = 16 + masks + own * voxel_bytes};
        values += own;
    }
    uint64_t left = in.size - in.at;
    for (uint32_t i = 0; i < n; i++) {
        if (out[i].stored_size > left) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "it ends inside subtree %u (SVO-12)", i);
        left -= out[i].stored_size;
    }
    if (left != 0) return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "bytes after the last subtree (SVO-12)");
    if (out[0].id != c->id || values != c->element_count)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, at, "id or element count differs from the records' (SVO-12)");
    *count = n;
    return SVO_OK;
}
