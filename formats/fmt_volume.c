/* Samples to chunks: occupied cells as bits in Morton order, whose bytes are the masks above the voxels. */
#include "fmt_volume.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_container.h"
#include "import_text.h"
#include "import_volume.h"
#include "svo_morton.h"
#include "svo_task.h"

enum { SEGMENT = 256, BLOCKS = 256, MOST_SIDE = 1 << SVO_CHUNK_LEVELS };

struct fmt_volume {
    fmt_volume_options o;
    volume_samples s;
    fmt_volume_facts facts;
    bool has_threshold, forget;
    double threshold;
};

uint32_t volume_type_size(volume_type t)
{
    static const uint8_t size[] = {1, 1, 2, 2, 4, 4, 8, 8, 4, 8, 4};
    return size[t];
}

bool volume_sizes(const double *v, uint64_t out[3])
{
    for (int k = 0; k < 3; k++) {
        if (!(v[k] >= 1 && v[k] <= 1 << 21 && v[k] == floor(v[k]))) return false;
        out[k] = (uint64_t)v[k];
    }
    return true;
}

bool fmt_is_nrrd(const uint8_t *data, uint64_t size) { return size >= 8 && memcmp(data, "NRRD000", 7) == 0; }

/* --- values --- */

/* n samples as numbers; of colours their alpha. */
static void load(const volume_samples *s, const uint8_t *p, uint64_t n, double *out)
{
    const bool big = s->big;
    switch (s->type) {
    case VOLUME_I8: for (uint64_t i = 0; i < n; i++) out[i] = (int8_t)p[i]; break;
    case VOLUME_U8: for (uint64_t i = 0; i < n; i++) out[i] = p[i]; break;
    case VOLUME_RGBA: for (uint64_t i = 0; i < n; i++) out[i] = p[4 * i + 3]; break;
    case VOLUME_I16: for (uint64_t i = 0; i < n; i++) out[i] = (int16_t)(big ? __builtin_bswap16(fmt_load16(p + 2 * i)) : fmt_load16(p + 2 * i)); break;
    case VOLUME_U16: for (uint64_t i = 0; i < n; i++) out[i] = big ? __builtin_bswap16(fmt_load16(p + 2 * i)) : fmt_load16(p + 2 * i); break;
    case VOLUME_I32: for (uint64_t i = 0; i < n; i++) out[i] = (int32_t)(big ? __builtin_bswap32(fmt_load32(p + 4 * i)) : fmt_load32(p + 4 * i)); break;
    case VOLUME_U32: for (uint64_t i = 0; i < n; i++) out[i] = big ? __builtin_bswap32(fmt_load32(p + 4 * i)) : fmt_load32(p + 4 * i); break;
    case VOLUME_I64: for (uint64_t i = 0; i < n; i++) out[i] = (double)(int64_t)(big ? __builtin_bswap64(fmt_load64(p + 8 * i)) : fmt_load64(p + 8 * i)); break;
    case VOLUME_U64: for (uint64_t i = 0; i < n; i++) out[i] = (double)(big ? __builtin_bswap64(fmt_load64(p + 8 * i)) : fmt_load64(p + 8 * i)); break;
    case VOLUME_F32:
        for (uint64_t i = 0; i < n; i++) {
            const uint32_t u = big ? __builtin_bswap32(fmt_load32(p + 4 * i)) : fmt_load32(p + 4 * i);
            float f;
            memcpy(&f, &u, 4);
            out[i] = (double)f;
        }
        break;
    case VOLUME_F64:
        for (uint64_t i = 0; i < n; i++) {
            const uint64_t u = big ? __builtin_bswap64(fmt_load64(p + 8 * i)) : fmt_load64(p + 8 * i);
            memcpy(&out[i], &u, 8);
        }
        break;
    }
}

static bool exists(const fmt_volume *v, double value) { return v->has_threshold ? value >= v->threshold : value > 0; }

static const uint8_t *sample_at(const fmt_volume *v, uint64_t x, uint64_t y, uint64_t z)
{
    const uint64_t *n = v->s.size;
    return v->s.data + (x + n[0] * (y + n[1] * z)) * volume_type_size(v->s.type);
}

/* --- the facts --- */

typedef struct part {
    uint64_t voxels;
    uint32_t side;
    double low, high;
    bool one_color;
    uint8_t color[3];
} part;

typedef struct survey_job {
    const fmt_volume *v;
    part parts[BLOCKS];
} survey_job;

static void survey_segment(const fmt_volume *v, part *t, uint64_t x, uint64_t n, uint64_t y, uint64_t z)
{
    double values[SEGMENT];
    const uint8_t *p = sample_at(v, x, y, z);
    load(&v->s, p, n, values);
    for (uint64_t i = 0; i < n; i++) {
        if (values[i] < t->low) t->low = values[i];
        if (values[i] > t->high) t->high = values[i];
        if (!exists(v, values[i])) continue;
        const uint64_t far = x + i > y ? x + i > z ? x + i : z : y > z ? y : z;
        if (far + 1 > t->side) t->side = (uint32_t)far + 1;
        if (v->s.type == VOLUME_RGBA) {
            if (t->voxels == 0) memcpy(t->color, p + 4 * i, 3);
            else if (memcmp(t->color, p + 4 * i, 3) != 0) t->one_color = false;
        }
        t->voxels++;
    }
}

static svo_result survey_rows(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    survey_job *j = user;
    const fmt_volume *v = j->v;
    const uint64_t *n = v->s.size, rows = n[1] * n[2];
    for (uint64_t b = begin; b < end; b++) {
        part *t = &j->parts[b];
        *t = (part){.low = INFINITY, .high = -INFINITY, .one_color = true};
        const uint64_t first = rows / BLOCKS * b + (b < rows % BLOCKS ? b : rows % BLOCKS), last = first + rows / BLOCKS + (b < rows % BLOCKS);
        for (uint64_t row = first; row < last; row++)
            for (uint64_t x = 0; x < n[0]; x += SEGMENT) survey_segment(v, t, x, n[0] - x < SEGMENT ? n[0] - x : SEGMENT, row % n[1], row / n[1]);
        if (v->forget && first < last) fmt_bytes_forget(sample_at(v, 0, first % n[1], first / n[1]), (last - first) * n[0] * volume_type_size(v->s.type));
    }
    return SVO_OK;
}

static svo_result survey(fmt_volume *v, svo_error *err)
{
    survey_job *j = svo_calloc(v->o.allocator, 1, sizeof *j);
    if (j == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the volume");
    j->v = v;
    svo_result r = svo_parallel_for(v->o.threads, BLOCKS, 1, survey_rows, j, err);
    fmt_volume_facts *f = &v->facts;
    memcpy(f->size, v->s.size, sizeof f->size);
    memcpy(f->to_world, v->s.to_world, sizeof f->to_world);
    f->samples = f->size[0] * f->size[1] * f->size[2];
    f->colored = v->s.type == VOLUME_RGBA;
    f->one_color = true;
    f->low = INFINITY;
    f->high = -INFINITY;
    for (int b = 0; b < BLOCKS; b++) {
        const part *t = &j->parts[b];
        if (t->low < f->low) f->low = t->low;
        if (t->high > f->high) f->high = t->high;
        if (t->side > f->side) f->side = t->side;
        if (t->voxels == 0) continue;
        if (f->voxels == 0) memcpy(f->color, t->color, 3);
        f->one_color = f->one_color && t->one_color && memcmp(f->color, t->color, 3) == 0;
        f->voxels += t->voxels;
    }
    svo_free(v->o.allocator, j, 1, sizeof *j);
    return r;
}

/* --- raw samples --- */

static svo_result bad_raw(const char *text, svo_error *err)
{
    return svo_fail(err, SVO_INVALID_ARGUMENT, "--raw %.60s: wants WxHxD:TYPE, perhaps with :little or :big and :OFFSET; TYPE is i8 u8 i16 u16 i32 u32 i64 u64 f32 f64 or rgba", text);
}

static svo_result read_raw(fmt_volume *v, const uint8_t *bytes, uint64_t size, svo_error *err)
{
    static const char *const types[] = {"i8", "u8", "i16", "u16", "i32", "u32", "i64", "u64", "f32", "f64", "rgba"};
    volume_samples *s = &v->s;
    const char *text = v->o.raw, *p = text, *end = text + strlen(text);
    double sides[3];
    int64_t offset = 0;
    bool has_offset = false;
    for (int k = 0; k < 3; k++) {
        int64_t n;
        const char *after = p < end && import_digit(*p) ? import_integer(p, end, &n) : NULL;
        if (after == NULL || *after != (k < 2 ? 'x' : ':')) return bad_raw(text, err);
        sides[k] = (double)n;
        p = after + 1;
    }
    if (!volume_sizes(sides, s->size)) return svo_fail(err, SVO_INVALID_ARGUMENT, "--raw %.60s: a side has 1 to 2^21 samples", text);
    const size_t length = strcspn(p, ":");
    size_t type = 0;
    while (type < sizeof types / sizeof *types && !(strlen(types[type]) == length && memcmp(types[type], p, length) == 0)) type++;
    if (type == sizeof types / sizeof *types) return bad_raw(text, err);
    s->type = (volume_type)type;
    for (p += length; *p == ':'; p += strcspn(p, ":")) {
        p++;
        const char *stop = p + strcspn(p, ":");
        if (stop - p == 3 && memcmp(p, "big", 3) == 0) s->big = true;
        else if (stop - p == 6 && memcmp(p, "little", 6) == 0) s->big = false;
        else if (p < end && import_digit(*p) && import_integer(p, end, &offset) == stop) has_offset = true;
        else return bad_raw(text, err);
    }
    const uint64_t total = s->size[0] * s->size[1] * s->size[2], width = volume_type_size(s->type), there = (uint64_t)offset <= size ? size - (uint64_t)offset : 0;
    if (total > there / width || (!has_offset && there != total * width))
        return svo_fail(err, SVO_INVALID_DATA, "--raw says %llu x %llu x %llu samples of %llu bytes, %.0f bytes; there are %llu%s", (unsigned long long)s->size[0], (unsigned long long)s->size[1],
                        (unsigned long long)s->size[2], (unsigned long long)width, (double)total * (double)width, (unsigned long long)there, has_offset ? "" : " (with an :OFFSET more is taken)");
    s->data = bytes + offset;
    const double edge = v->o.raw_size > 0 ? v->o.raw_size : 1;
    for (int k = 0; k < 3; k++) s->to_world[5 * k] = edge;
    s->to_world[15] = 1;
    return SVO_OK;
}

/* --- chunks --- */

typedef struct worker {
    uint8_t *bits; /* of the chunk's cells in Morton order; behind them, bits of the levels above: has a node anything? */
    svo_buffer masks, values[SVO_MAX_CHANNELS];
} worker;

typedef struct emit_job {
    const fmt_volume *v;
    const svo_tree_info *info;
    const svo_chunk_sink *sink;
    uint32_t level, levels; /* of the chunks' roots; below them */
    const uint64_t *codes;
    uint64_t code_count, next;
    worker *workers;
    uint32_t spread[MOST_SIDE];
} emit_job;

typedef struct emit_item { uint64_t code; void *blob; } emit_item;

/* Bits of the cells of one chunk; false when there is none. */
static bool fill_bits(const emit_job *j, const uint32_t low[3], uint8_t *bits)
{
    const fmt_volume *v = j->v;
    const uint64_t side = (uint64_t)1 << j->levels, *size = v->s.size;
    uint64_t n[3];
    for (int k = 0; k < 3; k++) n[k] = size[k] - low[k] < side ? size[k] - low[k] : side;
    memset(bits, 0, ((size_t)1 << 3 * j->levels) / 8 + 1);
    bool any = false;
    double values[MOST_SIDE];
    for (uint64_t z = 0; z < n[2]; z++)
        for (uint64_t y = 0; y < n[1]; y++) {
            const uint32_t row = j->spread[y] << 1 | j->spread[z] << 2;
            load(&v->s, sample_at(v, low[0], low[1] + y, low[2] + z), n[0], values);
            for (uint64_t x = 0; x < n[0]; x++) {
                if (!exists(v, values[x])) continue;
                const uint32_t at = row | j->spread[x];
                bits[at >> 3] = (uint8_t)(bits[at >> 3] | 1u << (at & 7));
                any = true;
            }
        }
    return any;
}

/* Masks of the node of `level` (of the chunk: 0 is its root) and number `at`, and below, depth first. up[l]: masks of the nodes of level l. */
static bool put_masks(svo_buffer *masks, uint8_t *const *up, uint32_t level, uint32_t levels, uint64_t at)
{
    const uint8_t mask = up[level][at];
    if (svo_buffer_append(masks, &mask, 1) == NULL) return false;
    for (uint32_t o = 0; o < 8 && level + 1 < levels; o++)
        if (mask >> o & 1 && !put_masks(masks, up, level + 1, levels, 8 * at + o)) return false;
    return true;
}

static bool build_masks(const emit_job *j, worker *w)
{
    uint8_t *up[SVO_CHUNK_LEVELS + 1] = {0};
    if (j->levels == 0) return true;
    uint8_t *at = w->bits;
    for (uint32_t l = j->levels; l-- > 0;) { /* level l has 8^l nodes; their masks are the bits of the nodes of level l + 1 */
        up[l] = at;
        at += (size_t)1 << 3 * l;
        if (l == 0) break;
        memset(at, 0, ((size_t)1 << 3 * (l - 1)));
        for (size_t i = 0; i < (size_t)1 << 3 * l; i++)
            if (up[l][i] != 0) at[i >> 3] = (uint8_t)(at[i >> 3] | 1u << (i & 7));
    }
    return put_masks(&w->masks, up, 0, j->levels, 0);
}

static bool put_values(const emit_job *j, worker *w, const uint32_t low[3], uint64_t *count)
{
    const fmt_volume *v = j->v;
    const fmt_volume_facts *f = &v->facts;
    const double range = f->high > f->low && isfinite(f->high - f->low) ? f->high - f->low : 0;
    for (size_t byte = 0; byte < (((size_t)1 << 3 * j->levels) + 7) / 8; byte++) {
        if (w->bits[byte] == 0) continue;
        for (uint32_t bit = 0; bit < 8; bit++) {
            if (!(w->bits[byte] >> bit & 1)) continue;
            uint32_t x, y, z;
            (*count)++;
            svo_morton_decode((uint64_t)byte * 8 + bit, &x, &y, &z);
            for (uint32_t c = 0; c < j->info->channel_count; c++) {
                const svo_channel *channel = &j->info->channels[c];
                if (channel->constant) continue;
                const uint8_t *p = sample_at(v, low[0] + x, low[1] + y, low[2] + z);
                uint8_t value = 0;
                double d;
                if (channel->kind == SVO_KIND_UNORM8) {
                    load(&v->s, p, 1, &d);
                    value = (uint8_t)(range > 0 ? (d - f->low) / range * 255 + 0.5 : 0);
                    p = &value;
                }
                if (svo_buffer_append(&w->values[c], p, svo_channel_stride(channel->kind)) == NULL) return false;
            }
        }
    }
    return true;
}

static svo_result next_chunk(void *user, void *item, bool *more, svo_error *err)
{
    (void)err;
    emit_job *j = user;
    *more = j->next < j->code_count;
    if (*more) *(emit_item *)item = (emit_item){j->codes[j->next++], NULL};
    return SVO_OK;
}

static svo_result make_chunk(void *user, void *item, uint32_t worker_index, svo_error *err)
{
    const emit_job *j = user;
    emit_item *it = item;
    worker *w = &j->workers[worker_index];
    uint32_t low[3];
    svo_morton_decode(it->code << 3 * j->levels, &low[0], &low[1], &low[2]);
    const bool any = fill_bits(j, low, w->bits);
    svo_result r = SVO_OK;
    if (any) {
        uint64_t count = 0;
        w->masks.size = 0;
        for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) w->values[c].size = 0;
        if (!put_values(j, w, low, &count) || !build_masks(j, w)) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a part of the octree");
        svo_chunk chunk = {.code = it->code, .level = j->level, .depth = j->info->depth, .node_count = w->masks.size, .value_count = count, .masks = w->masks.data};
        for (uint32_t c = 0; c < j->info->channel_count; c++)
            if (!j->info->channels[c].constant) chunk.channels[c] = w->values[c].data;
        r = j->sink->encode(j->sink->user, &chunk, worker_index, &it->blob, err);
    }
    if (j->v->forget) {
        const uint64_t *n = j->v->s.size, side = (uint64_t)1 << j->levels, last = low[2] + side < n[2] ? low[2] + side : n[2];
        fmt_bytes_forget(sample_at(j->v, 0, 0, low[2]), (last - low[2]) * n[0] * n[1] * volume_type_size(j->v->s.type));
    }
    return r;
}

static svo_result commit_chunk(void *user, void *item, svo_error *err)
{
    const emit_job *j = user;
    emit_item *it = item;
    void *blob = it->blob;
    it->blob = NULL;
    return blob != NULL ? j->sink->commit(j->sink->user, blob, err) : SVO_OK;
}

static void destroy_chunk(void *user, void *item)
{
    const emit_job *j = user;
    emit_item *it = item;
    if (it->blob != NULL) j->sink->discard(j->sink->user, it->blob);
}

static int by_code(const void *a, const void *b)
{
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return x < y ? -1 : x > y;
}

/* Codes of all chunks that the volume meets, ascending. */
static svo_result list_chunks(emit_job *j, svo_buffer *codes, svo_error *err)
{
    uint32_t n[3];
    for (int k = 0; k < 3; k++) { /* no voxel lies beyond the side */
        const uint64_t size = j->v->s.size[k] < j->v->facts.side ? j->v->s.size[k] : j->v->facts.side;
        n[k] = (uint32_t)((size + ((uint64_t)1 << j->levels) - 1) >> j->levels);
    }
    for (uint32_t z = 0; z < n[2]; z++)
        for (uint32_t y = 0; y < n[1]; y++)
            for (uint32_t x = 0; x < n[0]; x++) {
                const uint64_t code = svo_morton_encode(x, y, z);
                if (svo_buffer_append(codes, &code, sizeof code) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the list of chunks");
            }
    j->codes = (const uint64_t *)(const void *)codes->data;
    j->code_count = codes->size / sizeof(uint64_t);
    if (j->code_count > 1) qsort(codes->data, j->code_count, sizeof(uint64_t), by_code);
    return SVO_OK;
}

svo_result fmt_volume_emit(const fmt_volume *v, const svo_tree_info *info, const svo_chunk_sink *sink, svo_error *err)
{
    emit_job j = {.v = v, .info = info, .sink = sink, .level = svo_chunk_level(info->depth)};
    j.levels = info->depth - j.level;
    for (uint32_t i = 0; i < MOST_SIDE; i++) j.spread[i] = (uint32_t)svo_morton_spread(i);
    const uint32_t threads = v->o.threads != 0 ? v->o.threads : svo_processor_count();
    const size_t bits = ((size_t)1 << 3 * j.levels) / 4 + 64; /* and the levels above, a seventh more */
    svo_buffer codes, blocks;
    svo_buffer_init(&codes, v->o.allocator);
    svo_buffer_init(&blocks, v->o.allocator);
    j.workers = svo_calloc(v->o.allocator, threads, sizeof *j.workers);
    uint8_t *all = svo_buffer_append(&blocks, NULL, bits * threads);
    svo_result r = j.workers != NULL && all != NULL ? list_chunks(&j, &codes, err) : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the volume");
    for (uint32_t i = 0; i < threads && j.workers != NULL; i++) {
        j.workers[i].bits = all + i * bits;
        svo_buffer_init(&j.workers[i].masks, v->o.allocator);
        for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) svo_buffer_init(&j.workers[i].values[c], v->o.allocator);
    }
    const svo_pipeline p = {.threads = threads, .item_size = sizeof(emit_item), .user = &j, .produce = next_chunk, .work = make_chunk, .commit = commit_chunk, .destroy = destroy_chunk};
    if (r == SVO_OK && j.code_count != 0) r = svo_pipeline_run(&p, err);
    for (uint32_t i = 0; i < threads && j.workers != NULL; i++) {
        svo_buffer_free(&j.workers[i].masks);
        for (uint32_t c = 0; c < SVO_MAX_CHANNELS; c++) svo_buffer_free(&j.workers[i].values[c]);
    }
    svo_free(v->o.allocator, j.workers, threads, sizeof *j.workers);
    svo_buffer_free(&blocks);
    svo_buffer_free(&codes);
    return r;
}

/* --- the interface --- */

svo_result fmt_volume_open(const char *path, const uint8_t *bytes, uint64_t size, const fmt_volume_options *options, fmt_volume **out, svo_error *err)
{
    fmt_volume *v = svo_calloc(options->allocator, 1, sizeof *v);
    if (v == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the volume");
    v->o = *options;
    v->has_threshold = options->threshold != NULL;
    if (v->has_threshold) v->threshold = *options->threshold;
    svo_result r = options->raw != NULL ? read_raw(v, bytes, size, err) : import_nrrd(path, bytes, size, options, &v->s, err);
    if (r == SVO_OK) {
        const bool mapped = v->s.mapped != NULL || v->s.file.mapped || (options->mapped && v->s.file.data == NULL);
        v->forget = mapped && options->memory != 0 && v->s.size[0] * v->s.size[1] * v->s.size[2] * volume_type_size(v->s.type) > options->memory / 2;
        r = survey(v, err);
    }
    if (r == SVO_OK) *out = v;
    else fmt_volume_close(v);
    return r;
}

const fmt_volume_facts *fmt_volume_about(const fmt_volume *v) { return &v->facts; }

void fmt_volume_close(fmt_volume *v)
{
    if (v == NULL) return;
    volume_samples_free(&v->s);
    svo_free(v->o.allocator, v, 1, sizeof *v);
}
