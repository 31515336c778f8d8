/* Packing a channel: as a constant, as blocks within its goal, or raw. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_algorithm1.h"
#include "svo_quantize.h"
#include "svo_task.h"
#include "svoi_dag.h"
#include "svoi_palette.h"

/* A table entry costs its bytes once and widens every index; a value this rare is better held by a lattice. */
enum { RARE = 4, SMALL_TABLE = 4096 };
/* Beyond this many different values none are listed (but colours, of which there are at most 2^24): the list would outgrow what it describes. */
enum { LISTED = (1 << 17) - 1, TABLE_BITS = 12, GOAL_TABLE = 1 << 14 };

typedef struct source {
    const svoi_values *values;
    const svoi_distinct *distinct; /* with `mapped`: */
    const uint32_t *mapped;        /* what distinct values become; NULL: themselves */
    svo_error *err;                /* of the first read that failed */
    bool failed;
} source;

static void give_values(void *user, uint64_t first, uint32_t n, uint32_t *out)
{
    source *s = user;
    uint32_t stride = s->values->stride, last = 0, last_mapped = 0;
    uint8_t buffer[4 * SVO_SUPERBLOCK];
    svo_error inner = {0};
    SVO_ASSERT(n <= SVO_SUPERBLOCK);
    const uint8_t *p = svoi_values_get(s->values, first, n, buffer, &inner); /* superblocks do not straddle pages */
    if (p == NULL) {
        if (!__atomic_exchange_n(&s->failed, true, __ATOMIC_RELAXED)) *s->err = inner;
        memset(out, 0, n * sizeof *out);
        return;
    }
    for (uint32_t i = 0; i < n; i++, p += stride) {
        uint32_t value = svoi_load_value(p, stride);
        if (s->mapped != NULL) {
            if (i == 0 || value != last) last = value, last_mapped = s->mapped[svoi_distinct_index(s->distinct, value)];
            value = last_mapped;
        }
        out[i] = value;
    }
}

static void make_constant(svo_packed *p, uint32_t channel, uint32_t value, svo_dag_channel_report *report)
{
    svo_view_channel *c = &p->view.channels[channel];
    c->encoding = SVO_ENCODING_CONSTANT;
    c->channel.constant = true;
    memset(c->channel.value, 0, sizeof c->channel.value);
    svoi_store_value(c->channel.value, svo_channel_stride(c->channel.kind), value);
    report->left_out = true;
    report->bytes = 0;
}

/* Copy as they are, after mapping; the pages are given back on the way. */
static svo_result pack_raw(svo_packed *p, uint32_t channel, svoi_values *values, const source *s, svo_error *err)
{
    svo_buffer *raw = &p->raw[channel];
    uint32_t stride = values->stride;
    svoi_allow_output(p, values->count * stride);
    if (!svo_buffer_reserve(raw, (size_t)values->count * stride)) return svoi_no_memory(p, "attributes", err);
    for (uint64_t page = 0; page < values->page_count; page++) {
        uint64_t left = values->count - (page << SVOI_PAGE_BITS), n = left < SVOI_PAGE ? left : SVOI_PAGE;
        const uint8_t *from = svoi_values_get(values, page << SVOI_PAGE_BITS, n, raw->data + raw->size, err);
        if (from == NULL) return SVO_IO;
        uint8_t *to = raw->data + raw->size; /* the same place, if it was read */
        if (to != from) memcpy(to, from, (size_t)n * stride);
        raw->size += (size_t)n * stride;
        if (s->mapped != NULL)
            for (uint64_t i = 0; i < n; i++)
                svoi_store_value(to + i * stride, stride, s->mapped[svoi_distinct_index(s->distinct, svoi_load_value(to + i * stride, stride))]);
        svoi_values_drop(values, page);
    }
    p->view.channels[channel].encoding = SVO_ENCODING_RAW;
    p->view.channels[channel].raw = raw->data;
    return SVO_OK;
}

/* --- tables ------------------------------------------------------------------------------------------------------ */

typedef struct entry { uint64_t times; uint32_t value; } entry;

static int most_frequent_first(const void *a, const void *b)
{
    const entry *x = a, *y = b;
    if (x->times != y->times) return x->times > y->times ? -1 : 1;
    return (x->value > y->value) - (x->value < y->value);
}

/* The distinct values among mapped[], most frequent first, so that those of whole blocks fit the headers. Rare ones are
 * left out where there are many, but for Algorithm 1, which has nothing else to hold them. *table has room for `count`. */
static svo_result make_table(const svo_packed *p, bool all, const uint32_t *mapped, const uint64_t *times, uint64_t count, uint32_t *table,
                             uint64_t *table_count, uint64_t *kept_values, svo_error *err)
{
    svoi_distinct kept = {.a = &p->memory.base};
    bool ok = true, different = true;
    for (uint64_t i = 1; i < count && different; i++) different = mapped[i - 1] < mapped[i]; /* nothing was mapped to the same */
    for (uint64_t i = 0; i < count && ok && !different; i++) ok = svoi_distinct_add(&kept, mapped[i], times[i]);
    const uint64_t n = different ? count : kept.count;
    const uint32_t *value = different ? mapped : kept.value;
    const uint64_t *how_often = different ? times : kept.times;
    uint64_t room = all ? n : 0, taken = 0;
    for (uint64_t i = 0; i < n && !all && n > SMALL_TABLE; i++) room += how_often[i] >= RARE;
    if (!all && room < SMALL_TABLE) room = n; /* some rare ones are taken as well */
    entry *e = ok ? svo_alloc(kept.a, room, sizeof *e) : NULL;
    if (e != NULL) {
        for (uint64_t i = 0; i < n; i++)
            if (room == n || how_often[i] >= RARE) e[taken++] = (entry){how_often[i], value[i]};
        qsort(e, (size_t)taken, sizeof *e, most_frequent_first);
        uint64_t k = 0;
        while (k < taken && (all || k < SMALL_TABLE || e[k].times >= RARE)) table[k] = e[k].value, k++;
        *table_count = k;
        *kept_values = n;
    }
    svo_free(kept.a, e, room, sizeof *e);
    svoi_distinct_free(&kept);
    return e != NULL ? SVO_OK : svoi_no_memory(p, "quantisation", err);
}

/* --- channels ---------------------------------------------------------------------------------------------------- */

typedef struct packing {
    svo_packed *p;
    uint32_t channel;
    svoi_values *values;
    svoi_distinct distinct;
    uint32_t *mapped, *table;
    uint64_t room, table_room;
    bool algorithm1;
    const svo_dag_options *options;
    svo_dag_channel_report *report;
} packing;

/* For so many values, and a table of no more than `most` entries. */
static svo_result take_room(packing *k, uint64_t count, uint64_t most, svo_error *err)
{
    const svo_allocator *a = &k->p->memory.base;
    k->room = count;
    k->table_room = count < most ? count : most;
    k->mapped = svo_alloc(a, count, sizeof *k->mapped);
    k->table = svo_alloc(a, k->table_room, sizeof *k->table);
    return k->mapped != NULL && k->table != NULL ? SVO_OK : svoi_no_memory(k->p, "attributes", err);
}

static svo_result encode(packing *k, source *s, uint64_t table_count, svo_palette_goal goal, svo_palette_stats *stats, svo_error *err)
{
    svo_packed *p = k->p;
    svo_view_channel *c = &p->view.channels[k->channel];
    svo_buffer *directory = &p->directory[k->channel], *payload = &p->payload[k->channel], *table = &p->table[k->channel];
    uint32_t stride = k->values->stride;
    svo_palette_job job = {.kind = c->channel.kind, .count = k->values->count, .source = give_values, .user = s,
                           .table = k->table, .table_count = table_count, .goal = goal, .threads = k->options->threads,
                           .allocator = &p->memory.base};
    svo_error read = {0};
    s->err = &read;
    svo_result r = k->algorithm1 ? svo_algorithm1_encode(&job, directory, payload, err) : svoi_palette_encode(&job, &p->memory, directory, payload, stats, err);
    if (s->failed) return svo_fail(err, read.code, "%s", read.message);
    svoi_used used = {0};
    const uint64_t payload_before = payload->size;
    if (r == SVO_OK && !k->algorithm1) r = svoi_palette_drop_unused(c->channel.kind, table_count, directory, payload, &used, &p->memory.base, err);
    if (k->algorithm1) used.count = table_count; /* its palettes name all */
    if (r == SVO_OK && used.count == 0) used.bit[0] = used.count = 1; /* lattices alone: a table has an entry */
    if (r == SVO_OK && svo_buffer_append(table, NULL, (size_t)used.count * stride) == NULL) r = SVO_OUT_OF_MEMORY;
    uint8_t *to = table->data;
    for (uint64_t i = 0; i < table_count && r == SVO_OK; i++) {
        if (!k->algorithm1 && (used.bit[i / 64] >> i % 64 & 1) == 0) continue;
        svoi_store_value(to, stride, k->table[i]);
        to += stride;
    }
    k->report->unused_entries = table_count - used.count;
    k->report->unused_bytes = k->report->unused_entries * stride + (payload_before - payload->size);
    table_count = used.count;
    svoi_used_free(&used, &p->memory.base);
    if (r == SVO_OUT_OF_MEMORY) return svoi_no_memory(p, "attributes", err);
    if (r != SVO_OK) return r;
    c->encoding = k->algorithm1 ? SVO_ENCODING_LONG_BLOCKS : SVO_ENCODING_BLOCKS;
    c->table = table->data;
    c->table_count = table_count;
    c->directory = directory->data;
    c->superblock_count = directory->size / (k->algorithm1 ? SVO_ALGORITHM1_ENTRY : SVO_PALETTE_ENTRY);
    c->payload = payload->data;
    c->payload_size = payload->size;
    c->repeats = NULL;
    if (!k->algorithm1) {
        const svo_palette blocks = svo_view_palette(&p->view, k->channel);
        const uint64_t before = directory->size + payload->size;
        uint64_t words = 0;
        r = svoi_palette_skip_repeats(&blocks, directory, payload, &words, err);
        if (r != SVO_OK) return r == SVO_OUT_OF_MEMORY ? svoi_no_memory(p, "attributes", err) : r;
        k->report->repeated_superblocks = c->superblock_count - (directory->size / SVO_PALETTE_ENTRY - words);
        k->report->repeated_bytes = before - directory->size - payload->size;
        if (words != 0) c->repeats = directory->data;
        c->directory = directory->data + words * SVO_PALETTE_ENTRY;
        c->superblock_count = directory->size / SVO_PALETTE_ENTRY - words;
        c->payload = payload->data;
        c->payload_size = payload->size;
    }
    k->report->bytes = table->size + directory->size + payload->size;
    return SVO_OK;
}

static svo_result correct(packing *k, double bound, svo_error *err)
{
    return svoi_correct_averages(k->p, k->channel, k->values, bound, k->options->threads, k->report, err);
}

static void forget_blocks(packing *k)
{
    svo_view_channel *c = &k->p->view.channels[k->channel];
    svo_buffer_free(&k->p->table[k->channel]);
    svo_buffer_free(&k->p->directory[k->channel]);
    svo_buffer_free(&k->p->payload[k->channel]);
    c->table = c->payload = c->directory = c->repeats = NULL;
    c->table_count = c->superblock_count = c->payload_size = 0;
    k->report->unused_entries = k->report->unused_bytes = k->report->repeated_superblocks = k->report->repeated_bytes = 0;
}

/* The table says all that is needed of the values. */
static void forget_list(packing *k)
{
    const svo_allocator *a = &k->p->memory.base;
    svoi_distinct_free(&k->distinct);
    svo_free(a, k->mapped, k->room, sizeof *k->mapped);
    k->mapped = NULL;
}

/* Values are mapped one by one, by a number of bits or not at all, and then stored exactly. */
static svo_result pack_exactly(packing *k, svo_error *err)
{
    const svoi_distinct *d = &k->distinct;
    svo_channel_kind kind = k->p->view.channels[k->channel].channel.kind;
    k->algorithm1 = k->options->algorithm1;
    svo_quantize_result q = {0};
    const bool colors = kind == SVO_KIND_COLOR_SRGB8;
    if (colors) svoi_distinct_seal(&k->distinct);
    svo_result r = svo_quantize(kind, d->value, d->times, d->count, k->options, &k->p->memory.base, k->mapped, &q, err);
    if (r == SVO_OK && colors && q.lossy && !svoi_colors_reopen(&k->distinct)) r = SVO_OUT_OF_MEMORY;
    if (r == SVO_OUT_OF_MEMORY) return svoi_no_memory(k->p, "quantisation", err);
    if (r != SVO_OK) return r;
    k->report->error_mean = q.error_mean;
    k->report->error_max = q.error_max;
    uint64_t table_count = 0, kept = 0;
    SVO_TRY(make_table(k->p, k->algorithm1, k->mapped, d->times, d->count, k->table, &table_count, &kept, err));
    k->report->distinct_out = kept;
    if (kept == 1) {
        make_constant(k->p, k->channel, k->mapped[0], k->report);
        return SVO_OK;
    }
    source s = {k->values, d, q.lossy ? k->mapped : NULL, NULL, false};
    if (!q.lossy) forget_list(k);
    SVO_TRY(encode(k, &s, table_count, (svo_palette_goal){0}, NULL, err));
    if (q.lossy) SVO_TRY(correct(k, 0, err));
    uint64_t raw = k->values->count * k->values->stride;
    if (k->report->bytes < raw) return SVO_OK;
    forget_blocks(k);
    k->report->bytes = raw;
    return pack_raw(k->p, k->channel, k->values, &s, err);
}

/* Bits of a table: fine enough for the errors that are allowed, and no finer. */
static uint32_t table_bits_for(svo_palette_goal goal)
{
    double unit = goal.squares ? 0.25 / (goal.price + 1e-9) : 8 / (goal.price + 1e-9), scale = goal.bound < unit ? goal.bound : unit;
    return scale <= 0.75 ? 14 : scale <= 1.5 ? 13 : scale <= 2.5 ? 12 : 11;
}

static svo_result make_goal_table(packing *k, svo_palette_goal goal, uint64_t *table_count, svo_error *err)
{
    const svoi_distinct *d = &k->distinct;
    svo_dag_options o = {.color_bits = table_bits_for(goal), .normal_bits = 12, .threads = k->options->threads};
    svo_quantize_result q = {0};
    uint64_t kept = 0;
    svo_result r = svo_quantize(k->p->view.channels[k->channel].channel.kind, d->value, d->times, d->count, &o, &k->p->memory.base, k->mapped, &q, err);
    if (r == SVO_OUT_OF_MEMORY) return svoi_no_memory(k->p, "quantisation", err);
    if (r != SVO_OK) return r;
    return make_table(k->p, false, k->mapped, d->times, d->count, k->table, table_count, &kept, err);
}

/* Some superblocks, evenly spread. */
typedef struct sample { source of; uint64_t stride; } sample;

static void give_sample(void *user, uint64_t first, uint32_t n, uint32_t *out)
{
    sample *s = user;
    give_values(&s->of, first * s->stride, n, out);
}

static double quality(const svo_palette_stats *stats, bool squares, uint64_t count)
{
    return squares ? stats->square_sum / 3 / (double)count : stats->error_sum / (double)count;
}

/* The price at which a sample has the mean error that is aimed at: errors fall as prices rise. */
static svo_result find_price(packing *k, svo_palette_goal *goal, double aim, uint64_t *table_count, svo_error *err)
{
    enum { SAMPLE = 128, STEPS = 7 };
    uint64_t superblocks = k->values->count / SVO_SUPERBLOCK, taken = superblocks < SAMPLE ? superblocks : SAMPLE;
    svo_error read = {0};
    sample s = {{k->values, NULL, NULL, &read, false}, taken != 0 ? superblocks / taken : 1};
    double low = goal->squares ? 1e-4 : 0.02, high = goal->squares ? 20 : 200;
    uint64_t count = taken * SVO_SUPERBLOCK;
    goal->price = sqrt(low * high);
    if (count == 0) {
        goal->price = high; /* too few values to be worth saving on */
        return make_goal_table(k, *goal, table_count, err);
    }
    for (int step = 0; step < STEPS; step++) {
        svo_buffer directory, payload;
        svo_palette_stats stats;
        svo_buffer_init(&directory, &k->p->memory.base);
        svo_buffer_init(&payload, &k->p->memory.base);
        if (step == 0 || step == STEPS / 2) SVO_TRY(make_goal_table(k, *goal, table_count, err));
        svo_palette_job job = {.kind = SVO_KIND_COLOR_SRGB8, .count = count, .source = give_sample, .user = &s, .table = k->table,
                               .table_count = *table_count, .goal = *goal, .threads = k->options->threads, .allocator = &k->p->memory.base};
        svo_result r = svo_palette_encode(&job, &directory, &payload, &stats, err);
        svo_buffer_free(&directory);
        svo_buffer_free(&payload);
        if (s.of.failed) return svo_fail(err, read.code, "%s", read.message);
        if (r == SVO_OUT_OF_MEMORY) return svoi_no_memory(k->p, "attributes", err);
        if (r != SVO_OK) return r;
        if (quality(&stats, goal->squares, count) > aim) low = goal->price;
        else high = goal->price;
        goal->price = sqrt(low * high);
    }
    return make_goal_table(k, *goal, table_count, err);
}

static svo_result report_within(packing *k, const svo_palette_stats *stats, svo_palette_goal goal, svo_error *err)
{
    k->report->distinct_out = k->p->view.channels[k->channel].table_count;
    k->report->error_mean = stats->error_sum / (double)k->values->count;
    k->report->error_max = stats->error_max;
    if (stats->error_max > goal.bound) return svo_fail(err, SVO_RUNTIME, "an error of %.9g is above the bound of %.9g", stats->error_max, goal.bound);
    return correct(k, goal.bound, err);
}

/* Blocks chosen by what they cost, each value within a bound. */
static svo_result pack_within(packing *k, svo_palette_goal goal, double aim, svo_error *err)
{
    enum { ROUNDS = 3 };
    uint64_t table_count = 0;
    svo_palette_stats stats;
    svoi_distinct_seal(&k->distinct);
    if (aim > 0) SVO_TRY(find_price(k, &goal, aim, &table_count, err));
    else SVO_TRY(make_goal_table(k, goal, &table_count, err));
    forget_list(k);
    for (int round = 0;; round++) {
        source s = {k->values, NULL, NULL, NULL, false};
        SVO_TRY(encode(k, &s, table_count, goal, &stats, err));
        double reached = quality(&stats, goal.squares, k->values->count);
        if (!(aim > 0) || reached <= aim || round + 1 == ROUNDS) break;
        goal.price *= pow(reached / aim, goal.squares ? 1.1 : 1.6) * 1.03; /* the sample was kinder than the whole */
        forget_blocks(k);
    }
    return report_within(k, &stats, goal, err);
}

/* With the table of k->distinct (or the first value alone where there are too many), smaller than raw or raw. */
static svo_result pack_listed(packing *k, bool many, svo_error *err)
{
    const svoi_distinct *d = &k->distinct;
    uint32_t first = svoi_load_value(k->values->first, k->values->stride);
    uint64_t table_count = 1, kept = d->count, raw = k->values->count * k->values->stride;
    SVO_TRY(take_room(k, many ? 1 : d->count, UINT64_MAX, err));
    k->table[0] = first;
    if (!many) SVO_TRY(make_table(k->p, false, d->value, d->times, d->count, k->table, &table_count, &kept, err));
    k->report->distinct_out = many ? 0 : kept;
    if (!many && kept == 1) {
        make_constant(k->p, k->channel, d->value[0], k->report);
        return SVO_OK;
    }
    source s = {k->values, NULL, NULL, NULL, false};
    SVO_TRY(encode(k, &s, table_count, (svo_palette_goal){0}, NULL, err));
    if (k->report->bytes < raw) return SVO_OK;
    forget_blocks(k);
    k->report->bytes = raw;
    return pack_raw(k->p, k->channel, k->values, &s, err);
}

/* A channel with more different values than are listed: memory does not grow with their number. */
static svo_result pack_many(packing *k, svo_palette_goal goal, svo_error *err)
{
    bool normals = k->p->view.channels[k->channel].channel.kind == SVO_KIND_NORMAL_OCT32;
    bool within = normals && goal.bound > 0;
    svoi_mapping m = {.bits = within ? TABLE_BITS : k->options->normal_bits, .write = !within, .many = true};
    if (normals && (within || m.bits != 0)) {
        svo_result r = svoi_values_map(k->values, k->options->threads, LISTED, &m, &k->distinct, err);
        if (r == SVO_OUT_OF_MEMORY) return svoi_no_memory(k->p, "attributes", err);
        if (r != SVO_OK) return r;
        k->report->error_mean = m.error_sum / (double)k->values->count;
        k->report->error_max = m.error_max;
    }
    if (!within) return pack_listed(k, m.many, err);
    uint64_t table_count = 0, kept = 0;
    SVO_TRY(take_room(k, k->distinct.count, UINT64_MAX, err));
    SVO_TRY(make_table(k->p, false, k->distinct.value, k->distinct.times, k->distinct.count, k->table, &table_count, &kept, err));
    source s = {k->values, NULL, NULL, NULL, false};
    svo_palette_stats stats;
    SVO_TRY(encode(k, &s, table_count, goal, &stats, err));
    return report_within(k, &stats, goal, err);
}

svo_result svoi_pack_channel(svo_packed *p, uint32_t channel, svoi_values *values, const svo_dag_options *options,
                             svo_dag_channel_report *report, svo_error *err)
{
    const svo_allocator *a = &p->memory.base;
    svo_view_channel *c = &p->view.channels[channel];
    svo_buffer *parts[] = {&p->raw[channel], &p->table[channel], &p->directory[channel], &p->payload[channel], &p->corrections[channel]};
    for (int i = 0; i < 5; i++) svo_buffer_init(parts[i], a);
    if (c->channel.constant || values->count == 0) { /* an empty octree has no values at all */
        report->distinct_in = report->distinct_out = c->channel.constant ? 1 : 0;
        make_constant(p, channel, svoi_load_value(c->channel.value, svo_channel_stride(c->channel.kind)), report);
        return SVO_OK;
    }
    packing k = {.p = p, .channel = channel, .values = values, .distinct = {.a = a}, .options = options, .report = report};
    bool many = false;
    svo_result gathered = svoi_values_distinct(values, options->threads, c->channel.kind == SVO_KIND_COLOR_SRGB8 ? UINT64_MAX : LISTED, &k.distinct, &many, err);
    if (gathered != SVO_OK) return gathered == SVO_OUT_OF_MEMORY ? svoi_no_memory(p, "attributes", err) : gathered;
    report->distinct_in = k.distinct.count;
    svo_palette_goal goal = {0};
    if (c->channel.kind == SVO_KIND_COLOR_SRGB8) goal.bound = options->color_delta_e;
    if (c->channel.kind == SVO_KIND_NORMAL_OCT32) goal.bound = options->normal_degrees;
    if (goal.bound > 0) goal.price = 0.1 / goal.bound; /* few bytes first, small errors second */
    double aim = 0;
    if (c->channel.kind == SVO_KIND_COLOR_SRGB8 && options->color_mean > 0) aim = options->color_mean;
    if (c->channel.kind == SVO_KIND_COLOR_SRGB8 && options->color_psnr > 0) aim = 255.0 * 255 / pow(10, options->color_psnr / 10), goal.squares = true;
    svo_result r = SVO_OK;
    if (many) {
        r = pack_many(&k, goal, err);
    } else {
        const bool within = goal.bound > 0 && k.distinct.count > 1;
        const bool clustered = c->channel.kind == SVO_KIND_COLOR_SRGB8 && options->color_bits != 0;
        r = take_room(&k, k.distinct.count, within ? GOAL_TABLE : clustered ? (uint64_t)1 << options->color_bits : UINT64_MAX, err);
        if (r == SVO_OK) r = within ? pack_within(&k, goal, aim, err) : pack_exactly(&k, err);
    }
    svo_free(a, k.mapped, k.room, sizeof *k.mapped);
    svo_free(a, k.table, k.table_room, sizeof *k.table);
    svoi_distinct_free(&k.distinct);
    svoi_values_free(values);
    return r;
}
