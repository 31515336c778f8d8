/* HEAD and SHRD of .svo and the channel records. */
#include <math.h>
#include <string.h>

#include "fmti_svo.h"
#include "svo_math.h"

static void store_f64(uint8_t *p, double v)
{
    uint64_t bits;
    memcpy(&bits, &v, 8);
    fmt_store64(p, bits);
}

uint32_t fmti_voxel_bytes(const svo_tree_info *info)
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < info->channel_count; i++)
        if (!info->channels[i].constant) n += svo_channel_stride(info->channels[i].kind);
    return n;
}

static bool good_name(const char name[16])
{
    size_t n = 0;
    while (n < 16 && ((name[n] >= 'a' && name[n] <= 'z') || (name[n] >= '0' && name[n] <= '9') || name[n] == '_')) n++;
    if (n == 0 || n == 16) return false;
    for (size_t i = n; i < 16; i++)
        if (name[i] != 0) return false;
    return true;
}

static const char *check_channel(const svo_channel *c)
{
    if (!good_name(c->name)) return "a channel's name is not of the form [a-z0-9_]+ (SVO-04)";
    uint32_t stride = svo_channel_stride(c->kind);
    if (stride == 0) return "a channel is of unknown kind (SVO-04)";
    for (uint32_t i = c->constant ? stride : 0; i < SVO_MAX_STRIDE; i++)
        if (c->value[i] != 0) return "a channel's value has bytes beyond its kind's size (SVO-04)";
    if (c->constant && c->kind == SVO_KIND_NORMAL_OCT32 && (fmt_load16(c->value) == 0x8000 || fmt_load16(c->value + 2) == 0x8000))
        return "a constant normal holds -32768 (SVO-09)";
    return NULL;
}

const char *fmti_check_info(const svo_tree_info *info)
{
    if (info->depth > SVO_MAX_DEPTH) return "the depth is more than 21 (SVO-02)";
    if (info->surface != SVO_SURFACE_CONSERVATIVE && info->surface != SVO_SURFACE_THIN) return "unknown kind of surface (SVO-02)";
    if (info->fill != SVO_FILL_SURFACE && info->fill != SVO_FILL_SOLID) return "unknown kind of fill (SVO-02)";
    if (info->channel_count > SVO_MAX_CHANNELS) return "more than 16 channels (SVO-02)";
    const double *m = info->voxel_to_world;
    for (int i = 0; i < 16; i++)
        if (!isfinite(m[i])) return "voxel_to_world is not finite (SVO-03)";
    if (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1) return "the last row of voxel_to_world is not 0 0 0 1 (SVO-03)";
    svo_mat4 matrix, inverse;
    memcpy(matrix.m, m, sizeof matrix.m);
    if (!svo_mat4_affine_inverse(&matrix, &inverse)) return "voxel_to_world has no inverse (SVO-03)";
    for (uint32_t i = 0; i < info->channel_count; i++) {
        const char *why = check_channel(&info->channels[i]);
        if (why != NULL) return why;
        for (uint32_t k = 0; k < i; k++)
            if (strcmp(info->channels[i].name, info->channels[k].name) == 0) return "two channels have the same name (SVO-04)";
    }
    return NULL;
}

void fmti_store_channel(const svo_channel *c, uint8_t *b)
{
    memset(b, 0, FMTI_SVO_CHANNEL_RECORD);
    memcpy(b, c->name, 16);
    fmt_store32(b + 16, (uint32_t)c->kind);
    fmt_store32(b + 20, c->constant ? 1 : 0);
    if (c->constant) memcpy(b + 24, c->value, SVO_MAX_STRIDE);
}

const char *fmti_parse_channel(const uint8_t *b, svo_channel *c)
{
    svo_channel n;
    memset(&n, 0, sizeof n);
    uint32_t kind = fmt_load32(b + 16), flags = fmt_load32(b + 20);
    if (svo_channel_stride(kind) == 0) return "a channel is of unknown kind (SVO-04)";
    if ((flags & ~1u) != 0) return "a channel has unknown flags (SVO-04)";
    memcpy(n.name, b, 16);
    n.kind = (svo_channel_kind)kind;
    n.constant = (flags & 1) != 0;
    memcpy(n.value, b + 24, SVO_MAX_STRIDE);
    const char *why = check_channel(&n);
    if (why == NULL) *c = n;
    return why;
}

size_t fmti_store_head(const svo_tree_info *info, uint8_t *b)
{
    memset(b, 0, FMTI_SVO_HEAD_MAX);
    fmt_store32(b, info->depth);
    fmt_store32(b + 4, svo_chunk_level(info->depth));
    b[8] = (uint8_t)info->surface;
    b[9] = (uint8_t)info->fill;
    fmt_store16(b + 10, (uint16_t)info->channel_count);
    for (int i = 0; i < 16; i++) store_f64(b + 16 + 8 * i, info->voxel_to_world[i]);
    for (uint32_t i = 0; i < info->channel_count; i++)
        fmti_store_channel(&info->channels[i], b + FMTI_SVO_HEAD_FIXED + FMTI_SVO_CHANNEL_RECORD * i);
    return FMTI_SVO_HEAD_FIXED + FMTI_SVO_CHANNEL_RECORD * (size_t)info->channel_count;
}

svo_result fmti_parse_head(const fmt_chunk *chunk, const uint8_t *bytes, uint64_t size, svo_tree_info *info, svo_error *err)
{
    uint64_t at = chunk->offset;
    fmt_cursor c = fmt_cursor_make(bytes, size);
    svo_tree_info n;
    memset(&n, 0, sizeof n);
    n.depth = fmt_cursor_u32(&c);
    uint32_t level = fmt_cursor_u32(&c);
    uint8_t surface = fmt_cursor_u8(&c), fill = fmt_cursor_u8(&c);
    n.channel_count = fmt_cursor_u16(&c);
    uint32_t zero = fmt_cursor_u32(&c);
    for (int i = 0; i < 16; i++) n.voxel_to_world[i] = fmt_cursor_f64(&c);
    if (!c.ok) return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "too short (SVO-02)");
    if (zero != 0) return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at + 12, "a reserved field is not 0 (CON-03)");
    if (surface > SVO_SURFACE_THIN || fill > SVO_FILL_SOLID)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at + 8, "unknown kind of surface or fill (SVO-02)");
    n.surface = (svo_surface)surface;
    n.fill = (svo_fill)fill;
    if (n.depth > SVO_MAX_DEPTH || level != svo_chunk_level(n.depth))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "depth %u with chunks at level %u (SVO-02)", n.depth, level);
    if (n.channel_count > SVO_MAX_CHANNELS || size != FMTI_SVO_HEAD_FIXED + FMTI_SVO_CHANNEL_RECORD * (uint64_t)n.channel_count)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at + 10, "%u channels in %llu bytes (SVO-02)", n.channel_count, (unsigned long long)size);
    for (uint32_t i = 0; i < n.channel_count; i++) {
        const char *why = fmti_parse_channel(fmt_cursor_take(&c, FMTI_SVO_CHANNEL_RECORD), &n.channels[i]);
        if (why != NULL) return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at + FMTI_SVO_HEAD_FIXED + FMTI_SVO_CHANNEL_RECORD * (uint64_t)i, "%s", why);
    }
    const char *why = fmti_check_info(&n);
    if (why != NULL) return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "%s", why);
    *info = n;
    return SVO_OK;
}

void fmti_store_shard(const fmt_svo_shard *s, uint8_t *to)
{
    fmt_store32(to, s->index);
    fmt_store32(to + 4, s->count);
    fmt_store64(to + 8, s->first_code);
    fmt_store64(to + 16, s->end_code);
    memcpy(to + 24, s->job, sizeof s->job);
}

svo_result fmti_parse_shard(const fmt_chunk *c, const uint8_t *bytes, uint64_t size, uint32_t depth, fmt_svo_shard *shard, svo_error *err)
{
    if ((c->flags & FMT_CHUNK_CRITICAL) != 0 || c->codec != FMT_CODEC_NONE || c->id != 0 || c->element_count != 0 || c->element_stride != 0 ||
        size != FMTI_SVO_SHARD_SIZE)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "wrong flags, codec, id, element fields or size (SVO-10)");
    fmt_svo_shard s = {.index = fmt_load32(bytes), .count = fmt_load32(bytes + 4), .first_code = fmt_load64(bytes + 8), .end_code = fmt_load64(bytes + 16)};
    memcpy(s.job, bytes + 24, sizeof s.job);
    if (s.count == 0 || s.count > FMT_SVO_MAX_SHARDS || s.index == 0 || s.index > s.count)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset, "there is no shard %u of %u (SVO-10)", s.index, s.count);
    if (s.first_code > s.end_code || s.end_code > (uint64_t)1 << 3 * svo_chunk_level(depth))
        return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset + 8, "no range of codes: %llx to %llx (SVO-10)", (unsigned long long)s.first_code,
                              (unsigned long long)s.end_code);
    *shard = s;
    return SVO_OK;
}
