/* Writing blocks: superblocks on all threads, in batches whose bytes are joined in order. */
#include <math.h>

#include "svo_color.h"
#include "svo_task.h"
#include "svoi_palette.h"

enum { BATCH = 64 /* superblocks a task */, CACHE = 4096 };

/* --- the table --------------------------------------------------------------------------------------------------- */

static uint64_t slot_of(uint32_t value, uint64_t slot_count) { return (value * 0x9e3779b97f4a7c15u) >> 20 & (slot_count - 1); }

uint32_t svoi_table_index(const svoi_encoder *e, uint32_t value)
{
    if (e->slot_count == 0) return SVOI_NO_INDEX;
    for (uint64_t i = slot_of(value, e->slot_count);; i = (i + 1) & (e->slot_count - 1)) {
        if (e->slots[i] == 0) return SVOI_NO_INDEX;
        if (e->slots[i] >> 32 == value) return (uint32_t)e->slots[i] - 1;
    }
}

bool svoi_table_fill(svoi_encoder *e)
{
    const svo_palette_job *j = e->job;
    e->slot_count = 64;
    while (e->slot_count < 2 * j->table_count) e->slot_count *= 2;
    e->slots = svo_calloc(j->allocator, e->slot_count, sizeof *e->slots);
    if (e->slots == NULL) return false;
    for (uint64_t k = 0; k < j->table_count; k++) {
        uint64_t i = slot_of(j->table[k], e->slot_count);
        while (e->slots[i] != 0) i = (i + 1) & (e->slot_count - 1);
        e->slots[i] = (uint64_t)j->table[k] << 32 | (k + 1);
    }
    return true;
}

/* --- errors ------------------------------------------------------------------------------------------------------ */

double svoi_error_of(svo_channel_kind kind, uint32_t value, uint32_t other)
{
    uint8_t a[4], b[4];
    if (value == other) return 0;
    for (int i = 0; i < 4; i++) a[i] = (uint8_t)(value >> 8 * i), b[i] = (uint8_t)(other >> 8 * i);
    if (kind == SVO_KIND_COLOR_SRGB8) {
        float x[3], y[3];
        svo_srgb8_to_lab(a, x);
        svo_srgb8_to_lab(b, y);
        return svo_delta_e94(x, y);
    }
    if (kind == SVO_KIND_NORMAL_OCT32) {
        float x[3], y[3];
        svo_oct32_decode(a, x);
        svo_oct32_decode(b, y);
        double c[3], s = 0, d = 0;
        for (int i = 0; i < 3; i++) {
            int k = (i + 1) % 3, m = (i + 2) % 3;
            c[i] = (double)x[k] * y[m] - (double)x[m] * y[k];
            s += c[i] * c[i];
            d += (double)x[i] * y[i];
        }
        return atan2(sqrt(s), d) * (180 / 3.14159265358979323846);
    }
    return value > other ? value - other : other - value;
}

/* --- blocks ------------------------------------------------------------------------------------------------------ */

static uint32_t number_width(const svoi_block *b, bool *runs)
{
    uint32_t m = b->mode;
    *runs = m == SVO_BLOCK_BOX_RUNS || (m >= SVO_BLOCK_LINE_RUNS && m < SVO_BLOCK_PALETTE) || m >= SVO_BLOCK_PALETTE_RUNS;
    if (m < SVO_BLOCK_LINE) return b->lattice.bits;
    if (m < SVO_BLOCK_LINE_RUNS) return m - SVO_BLOCK_LINE + 2;
    if (m < SVO_BLOCK_PALETTE) return m - SVO_BLOCK_LINE_RUNS + 2;
    return m < SVO_BLOCK_PALETTE_RUNS ? m - SVO_BLOCK_PALETTE + 1 : m - SVO_BLOCK_PALETTE_RUNS + 2;
}

static void put_numbers(svoi_bits *w, const svoi_block *b)
{
    bool runs;
    uint32_t width = number_width(b, &runs);
    if (runs)
        for (uint32_t i = 0; i < b->length; i++) svoi_put(w, i == 0 || b->number[i] != b->number[i - 1], 1);
    for (uint32_t i = 0; i < b->length; i++)
        if (!runs || i == 0 || b->number[i] != b->number[i - 1]) svoi_put(w, b->number[i], width);
}

static void put_entries(svoi_bits *w, const svoi_block *b, uint32_t table_bits)
{
    for (uint32_t i = 0; i < b->entries; i++) svoi_put(w, b->entry[i], table_bits);
}

static void write_block(svoi_bits *w, svo_channel_kind kind, const svoi_block *b, uint32_t table_bits)
{
    if (b->mode == SVO_BLOCK_ONE_WIDE) {
        put_entries(w, b, table_bits);
    } else if (b->mode == SVO_BLOCK_RAW) {
        for (uint32_t i = 0; i < b->length; i++) svoi_put(w, b->number[i], table_bits);
    } else if (b->mode < SVO_BLOCK_LINE) {
        svoi_put_lattice(w, kind, &b->lattice);
        put_numbers(w, b);
    } else if (b->mode < SVO_BLOCK_PALETTE) {
        put_entries(w, b, table_bits);
        put_numbers(w, b);
    } else if (b->mode < SVO_BLOCK_PALETTE_RUNS) {
        put_numbers(w, b);
        put_entries(w, b, table_bits);
    } else {
        svoi_put(w, b->entries - 1, 8);
        put_entries(w, b, table_bits);
        put_numbers(w, b);
    }
    svoi_put_end(w);
}

/* What a reader will see in place of value i of the block. */
static uint32_t block_value(const svoi_encoder *e, const svoi_block *b, uint32_t i)
{
    const uint32_t *table = e->job->table;
    if (b->mode < SVO_BLOCK_RAW) return table[b->entry[0]];
    if (b->mode == SVO_BLOCK_RAW) return table[b->number[i]];
    if (b->mode < SVO_BLOCK_LINE) return svo_lattice_point(e->job->kind, &b->lattice, b->number[i]);
    if (b->mode < SVO_BLOCK_PALETTE) {
        bool runs;
        uint32_t width = number_width(b, &runs);
        return svo_line_point(e->job->kind, table[b->entry[0]], table[b->entry[1]], b->number[i], (1u << width) - 1);
    }
    return table[b->entry[b->number[i]]];
}

/* --- superblocks ------------------------------------------------------------------------------------------------- */

typedef struct worker {
    const svoi_encoder *e;
    const svoi_chooser *chooser;
    void *state;
    svoi_block block;
    struct { uint64_t key; double error; } cache[CACHE];
    uint32_t values[SVO_SUPERBLOCK];
    uint8_t out[SVOI_SUPERBLOCK_MAX];
} worker;

static double cached_error(worker *w, uint32_t value, uint32_t other)
{
    if (value == other) return 0;
    uint64_t key = (uint64_t)value << 32 | other;
    uint32_t slot = (uint32_t)((key * 0x9e3779b97f4a7c15u) >> 52);
    if (w->cache[slot].key != key || value == 0) {
        w->cache[slot].key = key;
        w->cache[slot].error = svoi_error_of(w->e->job->kind, value, other);
    }
    return w->cache[slot].error;
}

static void measure(worker *w, uint32_t first, uint32_t n, svo_palette_stats *stats)
{
    for (uint32_t i = 0; i < w->block.length && first + i < n; i++) {
        uint32_t value = w->values[first + i], other = block_value(w->e, &w->block, i);
        double error = cached_error(w, value, other);
        stats->error_sum += error;
        if (error > stats->error_max) stats->error_max = error;
        if (w->e->job->kind == SVO_KIND_COLOR_SRGB8 && value != other)
            for (uint32_t k = 0; k < 24; k += 8) {
                int32_t d = (int32_t)(value >> k & 255) - (int32_t)(other >> k & 255);
                stats->square_sum += d * d;
            }
    }
}

/* Write the blocks of `map`; 0 when one would begin out of a header's reach. */
static uint32_t write_superblock(worker *w, uint64_t map, uint32_t n, svo_palette_stats *stats)
{
    uint32_t blocks = (uint32_t)__builtin_popcountll(map);
    svoi_bits bits = {.p = w->out + 2 * blocks};
    svo_palette_stats local = *stats;
    for (uint32_t i = 0; i < blocks; i++) {
        uint32_t begin = (uint32_t)__builtin_ctzll(map), at = (uint32_t)(bits.p - w->out);
        map &= map - 1;
        uint32_t end = map != 0 ? (uint32_t)__builtin_ctzll(map) : SVOI_GRANULES;
        svoi_block *b = &w->block;
        w->chooser->block(w->state, begin, end, b);
        b->length = (end - begin) * SVO_GRANULE;
        uint16_t header;
        if (b->mode < SVO_BLOCK_ONE_WIDE) {
            header = (uint16_t)(b->entry[0] >> 11 | (b->entry[0] & 2047) << 5);
            b->mode = b->entry[0] >> 11;
        } else {
            if (at > SVOI_REACH) return 0;
            header = (uint16_t)(b->mode | at << 5);
            write_block(&bits, w->e->job->kind, b, w->e->table_bits);
        }
        memcpy(w->out + 2 * i, &header, sizeof header);
        local.blocks[b->mode]++;
        local.values[b->mode] += b->length;
        local.bits[b->mode] += 8 * (uint64_t)((uint32_t)(bits.p - w->out) - at);
        measure(w, begin * SVO_GRANULE, n, &local);
    }
    *stats = local;
    return (uint32_t)(bits.p - w->out);
}

typedef struct run {
    svoi_encoder e;
    uint64_t superblocks;
    uint8_t *directory;  /* offsets count from the batch's own bytes at first */
    svo_buffer *bytes;   /* a batch */
    svo_palette_stats *stats;
    svo_limit_allocator *limit;
} run;

/* `scratch` is used for what is not known to be needed longer. */
static svo_result encode_batch(run *r, worker *w, uint64_t batch, svo_buffer *scratch, svo_error *err)
{
    const svo_palette_job *j = r->e.job;
    uint64_t last = (batch + 1) * BATCH < r->superblocks ? (batch + 1) * BATCH : r->superblocks;
    scratch->size = 0;
    for (uint64_t s = batch * BATCH; s < last; s++) {
        uint64_t first = s * SVO_SUPERBLOCK, left = j->count - first;
        uint32_t n = left < SVO_SUPERBLOCK ? (uint32_t)left : SVO_SUPERBLOCK;
        j->source(j->user, first, n, w->values);
        for (uint32_t i = n; i < SVO_SUPERBLOCK; i++) w->values[i] = w->values[n - 1];
        uint64_t map = w->chooser->choose(w->state, w->values);
        uint32_t size = write_superblock(w, map, n, &r->stats[batch]);
        if (size == 0) {
            map = 1;
            size = write_superblock(w, map, n, &r->stats[batch]);
        }
        uint8_t *entry = r->directory + s * SVO_PALETTE_ENTRY;
        uint32_t offset = (uint32_t)scratch->size;
        memcpy(entry, &map, sizeof map);
        memcpy(entry + 8, &offset, sizeof offset);
        if (svo_buffer_append(scratch, w->out, size) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    }
    svoi_limit_raise(r->limit, scratch->size + scratch->size / 2);
    return svo_buffer_append(&r->bytes[batch], scratch->data, scratch->size) != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
}

static svo_result encode_batches(void *user, uint64_t begin, uint64_t end, uint32_t number, svo_error *err)
{
    (void)number;
    run *r = user;
    const svo_allocator *a = r->e.job->allocator;
    worker *w = svo_calloc(a, 1, sizeof *w);
    if (w == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    w->e = &r->e;
    w->chooser = r->e.points != NULL ? &svoi_lossy : &svoi_exact;
    w->state = w->chooser->create(&r->e, a);
    svo_result result = w->state == NULL ? svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)") : SVO_OK;
    svo_buffer scratch;
    svo_buffer_init(&scratch, a);
    for (uint64_t batch = begin; batch < end && result == SVO_OK; batch++) result = encode_batch(r, w, batch, &scratch, err);
    svo_buffer_free(&scratch);
    if (w->state != NULL) w->chooser->destroy(w->state, a);
    svo_free(a, w, 1, sizeof *w);
    return result;
}

static void add_stats(svo_palette_stats *to, const svo_palette_stats *s)
{
    for (int i = 0; i < SVO_BLOCK_MODES; i++) to->blocks[i] += s->blocks[i], to->values[i] += s->values[i], to->bits[i] += s->bits[i];
    to->error_sum += s->error_sum;
    to->square_sum += s->square_sum;
    if (s->error_max > to->error_max) to->error_max = s->error_max;
}

/* Batches behind each other; offsets from the bases of their groups. */
static void join(run *r, uint64_t batches, uint64_t groups, svo_buffer *payload, svo_palette_stats *stats)
{
    svo_buffer_append(payload, NULL, (size_t)groups * 8);
    uint64_t base = 0;
    for (uint64_t i = 0; i < batches; i++) {
        uint64_t last = (i + 1) * BATCH < r->superblocks ? (i + 1) * BATCH : r->superblocks;
        if (i * BATCH % SVO_PALETTE_GROUP == 0) {
            base = payload->size;
            memcpy(payload->data + i * BATCH / SVO_PALETTE_GROUP * 8, &base, sizeof base);
        }
        for (uint64_t s = i * BATCH; s < last; s++) {
            uint8_t *at = r->directory + s * SVO_PALETTE_ENTRY + 8;
            uint32_t offset;
            memcpy(&offset, at, sizeof offset);
            offset += (uint32_t)(payload->size - base);
            memcpy(at, &offset, sizeof offset);
        }
        svo_buffer_append(payload, r->bytes[i].data, r->bytes[i].size);
        svo_buffer_free(&r->bytes[i]);
        if (stats != NULL) add_stats(stats, &r->stats[i]);
    }
    svo_buffer_append(payload, NULL, SVO_PALETTE_PADDING);
}

static svo_result encode(run *r, svo_buffer *directory, svo_buffer *payload, svo_palette_stats *stats, svo_error *err)
{
    const svo_palette_job *j = r->e.job;
    uint64_t batches = (r->superblocks + BATCH - 1) / BATCH, groups = (r->superblocks + SVO_PALETTE_GROUP - 1) / SVO_PALETTE_GROUP, total = 0;
    r->bytes = svo_calloc(j->allocator, batches, sizeof *r->bytes);
    r->stats = svo_calloc(j->allocator, batches, sizeof *r->stats);
    r->directory = svo_buffer_append(directory, NULL, (size_t)(r->superblocks * SVO_PALETTE_ENTRY));
    svo_result result = SVO_OK;
    if (batches != 0 && (r->bytes == NULL || r->stats == NULL || r->directory == NULL))
        result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    if (result == SVO_OK) {
        for (uint64_t i = 0; i < batches; i++) svo_buffer_init(&r->bytes[i], j->allocator);
        result = svo_parallel_for(j->threads, batches, batches < 64 ? 1 : 4, encode_batches, r, err);
    }
    if (result == SVO_OK) {
        for (uint64_t i = 0; i < batches; i++) total += r->bytes[i].size;
        svoi_limit_raise(r->limit, total - total / 2 + 8 * groups + SVO_PALETTE_PADDING); /* joining needs no memory twice: pages of the whole are touched as those of batches are given back */
        if (!svo_buffer_reserve(payload, (size_t)(total + 8 * groups + SVO_PALETTE_PADDING)))
            result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    }
    if (result == SVO_OK) join(r, batches, groups, payload, stats);
    svoi_limit_raise(r->limit, 0 - (total - total / 2));
    if (r->bytes != NULL)
        for (uint64_t i = 0; i < batches; i++) svo_buffer_free(&r->bytes[i]);
    svo_free(j->allocator, r->bytes, batches, sizeof *r->bytes);
    svo_free(j->allocator, r->stats, batches, sizeof *r->stats);
    return result;
}

svo_result svo_palette_encode(const svo_palette_job *job, svo_buffer *directory, svo_buffer *payload, svo_palette_stats *stats,
                              svo_error *err)
{
    return svoi_palette_encode(job, NULL, directory, payload, stats, err);
}

svo_result svoi_palette_encode(const svo_palette_job *job, svo_limit_allocator *limit, svo_buffer *directory, svo_buffer *payload,
                               svo_palette_stats *stats, svo_error *err)
{
    SVO_ASSERT(payload->size == 0);
    run r = {.limit = limit, .e = {.job = job, .table_bits = svo_palette_table_bits(job->table_count), .lattice_bits = svo_lattice_header_bits(job->kind)},
             .superblocks = (job->count + SVO_SUPERBLOCK - 1) / SVO_SUPERBLOCK};
    if (job->table_count > (uint64_t)1 << 31) return svo_fail(err, SVO_LIMIT, "a channel's table has more than 2^31 values");
    if (stats != NULL) *stats = (svo_palette_stats){0};
    if (!svoi_table_fill(&r.e)) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    svo_result result = job->goal.bound > 0 ? svoi_lossy_prepare(&r.e, err) : SVO_OK;
    if (result == SVO_OK) result = encode(&r, directory, payload, stats, err);
    svoi_lossy_release(&r.e);
    svo_free(job->allocator, r.e.slots, r.e.slot_count, sizeof *r.e.slots);
    return result;
}
