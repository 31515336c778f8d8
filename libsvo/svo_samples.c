#include "svo_samples.h"

#include <math.h>
#include <string.h>

enum { LEAST_BUFFER = 1 << 12, MOST_BUFFER = 1 << 20, LEAST_SAMPLES = 1 << 12 };

typedef struct run {
    uint64_t begin, end; /* bytes of the file */
} run;

struct svo_samples {
    svo_samples_options o;
    svo_buffer samples, scratch;
    uint64_t most; /* samples in memory at a time; UINT64_MAX: any */
    svo_spill_file file;
    svo_buffer runs;
    uint64_t count;
};

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the points"); }

svo_result svo_samples_create(const svo_samples_options *o, svo_samples **out, svo_error *err)
{
    svo_samples *s = svo_calloc(o->allocator, 1, sizeof *s);
    if (s == NULL) return no_memory(err);
    s->o = *o;
    s->most = UINT64_MAX;
    svo_buffer_init(&s->samples, o->allocator);
    svo_buffer_init(&s->scratch, o->allocator);
    svo_buffer_init(&s->runs, o->allocator);
    /* Half for samples and the space to sort them; what emitting needs besides (a chunk has at most 128^3 cells) is in the other half. */
    if (o->memory != 0) s->most = o->memory / 2 / (2 * sizeof(svo_sample));
    if (s->most < LEAST_SAMPLES) s->most = LEAST_SAMPLES;
    *out = s;
    return SVO_OK;
}

void svo_samples_free(svo_samples *s)
{
    if (s == NULL) return;
    svo_buffer_free(&s->samples);
    svo_buffer_free(&s->scratch);
    svo_buffer_free(&s->runs);
    svo_spill_close(&s->file);
    svo_free(s->o.allocator, s, 1, sizeof *s);
}

/* --- sorting --- */

/* By code, 11 bits a pass, stable; passes in which all digits are equal are left out. */
static svo_result sort_samples(svo_samples *s, svo_error *err)
{
    enum { BITS = 11, BINS = 1 << BITS };
    const uint64_t n = s->samples.size / sizeof(svo_sample);
    if (n < 2) return SVO_OK;
    if (s->scratch.size < s->samples.size && svo_buffer_append(&s->scratch, NULL, s->samples.size - s->scratch.size) == NULL) return no_memory(err);
    svo_sample *from = (svo_sample *)(void *)s->samples.data, *to = (svo_sample *)(void *)s->scratch.data;
    for (uint32_t shift = 0; shift < 3 * s->o.depth; shift += BITS) {
        uint64_t at[BINS] = {0}, sum = 0;
        for (uint64_t i = 0; i < n; i++) at[from[i].code >> shift & (BINS - 1)]++;
        if (at[from[0].code >> shift & (BINS - 1)] == n) continue;
        for (uint32_t b = 0; b < BINS; b++) {
            uint64_t here = at[b];
            at[b] = sum;
            sum += here;
        }
        for (uint64_t i = 0; i < n; i++) to[at[from[i].code >> shift & (BINS - 1)]++] = from[i];
        svo_sample *other = from;
        from = to;
        to = other;
    }
    if ((uint8_t *)from != s->samples.data) { /* the sorted ones are in the scratch */
        svo_buffer swap = s->samples;
        const size_t size = s->samples.size;
        s->samples = s->scratch;
        s->samples.size = size;
        s->scratch = swap;
    }
    return SVO_OK;
}

static svo_result flush_run(svo_samples *s, svo_error *err)
{
    if (s->samples.size == 0) return SVO_OK;
    if (s->o.spill == NULL) return svo_fail(err, SVO_LIMIT, "the points do not fit in memory");
    SVO_TRY(sort_samples(s, err));
    if (s->file.spill == NULL) SVO_TRY(svo_spill_open(s->o.spill, &s->file, err));
    run r = {s->file.size, s->file.size + s->samples.size};
    SVO_TRY(svo_spill_append(&s->file, s->samples.data, s->samples.size, err));
    if (svo_buffer_append(&s->runs, &r, sizeof r) == NULL) return no_memory(err);
    s->samples.size = 0;
    return SVO_OK;
}

svo_result svo_samples_put(svo_samples *s, const svo_sample *sample, uint64_t count, svo_error *err)
{
    s->count += count;
    while (count != 0) {
        uint64_t have = s->samples.size / sizeof *sample, room = s->most - have, n = count < room ? count : room;
        if (s->o.memory != 0 && s->samples.capacity == 0 && count > 0) { /* no growth by copying, which would take twice as much */
            if (!svo_buffer_reserve(&s->samples, s->most * sizeof *sample) || !svo_buffer_reserve(&s->scratch, s->most * sizeof *sample)) return no_memory(err);
        }
        if (svo_buffer_append(&s->samples, sample, n * sizeof *sample) == NULL) return no_memory(err);
        sample += n;
        count -= n;
        if (have + n == s->most) SVO_TRY(flush_run(s, err));
    }
    return SVO_OK;
}

/* --- reading in order --- */

typedef struct source {
    svo_spill_reader reader;
    svo_sample next;
} source;

typedef struct merge {
    const svo_sample *memory; /* all, when nothing was spilled */
    uint64_t left;
    source *sources;
    uint32_t *heap; /* of sources, the smallest code first */
    uint64_t source_count, heap_count;
    svo_buffer buffers;
} merge;

static void sift(merge *m, uint64_t i)
{
    for (;;) {
        uint64_t least = i;
        for (uint64_t c = 2 * i + 1; c <= 2 * i + 2 && c < m->heap_count; c++)
            if (m->sources[m->heap[c]].next.code < m->sources[m->heap[least]].next.code) least = c;
        if (least == i) return;
        uint32_t swap = m->heap[i];
        m->heap[i] = m->heap[least];
        m->heap[least] = swap;
        i = least;
    }
}

static void end_merge(svo_samples *s, merge *m)
{
    svo_free(s->o.allocator, m->sources, m->source_count, sizeof *m->sources);
    svo_free(s->o.allocator, m->heap, m->source_count, sizeof *m->heap);
    svo_buffer_free(&m->buffers);
}

static svo_result begin_merge(svo_samples *s, merge *m, svo_error *err)
{
    svo_buffer_init(&m->buffers, s->o.allocator);
    if (s->runs.size == 0) {
        SVO_TRY(sort_samples(s, err));
        svo_buffer_free(&s->scratch);
        m->memory = (const svo_sample *)(const void *)s->samples.data;
        m->left = s->samples.size / sizeof *m->memory;
        return SVO_OK;
    }
    SVO_TRY(flush_run(s, err));
    svo_buffer_free(&s->samples);
    svo_buffer_free(&s->scratch);
    const uint64_t n = s->runs.size / sizeof(run);
    const run *runs = (const run *)(const void *)s->runs.data;
    uint64_t size = s->o.memory / 4 / n;
    size = size < LEAST_BUFFER ? LEAST_BUFFER : size > MOST_BUFFER ? MOST_BUFFER : size;
    m->sources = svo_calloc(s->o.allocator, n, sizeof *m->sources);
    m->heap = svo_calloc(s->o.allocator, n, sizeof *m->heap);
    m->source_count = n;
    if (m->sources == NULL || m->heap == NULL || svo_buffer_append(&m->buffers, NULL, n * size) == NULL) return no_memory(err);
    for (uint64_t i = 0; i < n; i++) {
        source *from = &m->sources[i];
        svo_spill_reader_init(&from->reader, &s->file, runs[i].begin, runs[i].end, true, m->buffers.data + i * size, (uint32_t)size);
        SVO_TRY(svo_spill_get(&from->reader, &from->next, sizeof from->next, err)); /* no run is empty */
        m->heap[m->heap_count++] = (uint32_t)i;
    }
    for (uint64_t i = m->heap_count; i-- > 0;) sift(m, i);
    return SVO_OK;
}

static svo_result next_sample(merge *m, svo_sample *out, bool *more, svo_error *err)
{
    *more = m->memory != NULL ? m->left != 0 : m->heap_count != 0;
    if (!*more) return SVO_OK;
    if (m->memory != NULL) {
        *out = *m->memory++;
        m->left--;
        return SVO_OK;
    }
    source *from = &m->sources[m->heap[0]];
    *out = from->next;
    if (svo_spill_left(&from->reader) >= sizeof from->next) SVO_TRY(svo_spill_get(&from->reader, &from->next, sizeof from->next, err));
    else m->heap[0] = m->heap[--m->heap_count];
    sift(m, 0);
    return SVO_OK;
}

/* --- cells --- */

typedef struct sums {
    uint64_t count, colors, normals, values;
    uint64_t color[3], value;
    int64_t normal[3], turned[3]; /* turned: each normal to the side where its last component that is not 0 is positive */
} sums;

static void add(sums *t, const svo_sample *s)
{
    t->count++;
    if (s->has & SVO_SAMPLE_COLOR) {
        t->colors++;
        for (int k = 0; k < 3; k++) t->color[k] += s->color[k];
    }
    if (s->has & SVO_SAMPLE_NORMAL) {
        t->normals++;
        const int last = s->normal[2] != 0 ? 2 : s->normal[1] != 0 ? 1 : 0, sign = s->normal[last] < 0 ? -1 : 1;
        for (int k = 0; k < 3; k++) t->normal[k] += s->normal[k], t->turned[k] += sign * s->normal[k];
    }
    if (s->has & SVO_SAMPLE_VALUE) {
        t->values++;
        t->value += s->value;
    }
}

static void normal_of(const sums *t, uint8_t out[4], bool *canceled)
{
    double n[3] = {(double)t->normal[0], (double)t->normal[1], (double)t->normal[2]};
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    *canceled = t->normals != 0 && length < 0.01 * 32767 * (double)t->normals;
    if (*canceled) {
        for (int k = 0; k < 3; k++) n[k] = (double)t->turned[k];
        length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    }
    float f[3] = {0, 0, 1};
    for (int k = 0; k < 3 && length > 0; k++) f[k] = (float)(n[k] / length);
    svo_oct32_encode(f, out);
}

/* One chunk that is being collected. */
typedef struct gatherer {
    const svo_tree_info *info;
    const svo_chunk_sink *sink;
    uint32_t level, shift;
    uint64_t chunk;
    svo_buffer codes, masks, values[SVO_MAX_CHANNELS];
    svo_samples_report report;
} gatherer;

/* Masks of a node of `level` and below, depth first; its voxels are [begin, end). At most SVO_CHUNK_LEVELS deep. */
static bool add_masks(gatherer *g, uint32_t level, uint64_t begin, uint64_t end)
{
    if (level == g->info->depth) return true;
    const uint64_t *code = (const uint64_t *)(const void *)g->codes.data;
    const uint32_t shift = 3 * (g->info->depth - level - 1);
    uint64_t first[9], i = begin;
    uint8_t mask = 0;
    for (uint32_t o = 0; o < 8; o++) {
        first[o] = i;
        while (i < end && (code[i] >> shift & 7) == o) i++;
        if (i > first[o]) mask = (uint8_t)(mask | 1u << o);
    }
    first[8] = i;
    if (svo_buffer_append(&g->masks, &mask, 1) == NULL) return false;
    for (uint32_t o = 0; o < 8; o++)
        if (first[o + 1] > first[o] && !add_masks(g, level + 1, first[o], first[o + 1])) return false;
    return true;
}

static svo_result end_chunk(gatherer *g, svo_error *err)
{
    const uint64_t count = g->codes.size / sizeof(uint64_t);
    if (count == 0) return SVO_OK;
    g->masks.size = 0;
    if (!add_masks(g, g->level, 0, count)) return no_memory(err);
    svo_chunk chunk = {.code = g->chunk, .level = g->level, .depth = g->info->depth, .node_count = g->masks.size, .value_count = count, .masks = g->masks.data};
    for (uint32_t i = 0; i < g->info->channel_count; i++)
        if (!g->info->channels[i].constant) chunk.channels[i] = g->values[i].data;
    void *blob = NULL;
    SVO_TRY(g->sink->encode(g->sink->user, &chunk, 0, &blob, err));
    SVO_TRY(g->sink->commit(g->sink->user, blob, err));
    g->codes.size = 0;
    for (uint32_t i = 0; i < g->info->channel_count; i++) g->values[i].size = 0;
    return SVO_OK;
}

static svo_result put_cell(gatherer *g, uint64_t code, const sums *t, svo_error *err)
{
    if (g->codes.size != 0 && code >> g->shift != g->chunk) SVO_TRY(end_chunk(g, err));
    g->chunk = code >> g->shift;
    g->report.cells++;
    if (t->count > g->report.most) g->report.most = t->count;
    bool ok = svo_buffer_append(&g->codes, &code, sizeof code) != NULL;
    for (uint32_t i = 0; i < g->info->channel_count && ok; i++) {
        const svo_channel *c = &g->info->channels[i];
        uint8_t v[SVO_MAX_STRIDE] = {255, 255, 255};
        bool canceled = false;
        if (c->constant) continue;
        if (c->kind == SVO_KIND_COLOR_SRGB8) {
            for (int k = 0; k < 3 && t->colors != 0; k++) v[k] = svo_linear_to_srgb((float)((double)t->color[k] / (65535.0 * (double)t->colors)));
        } else if (c->kind == SVO_KIND_NORMAL_OCT32) {
            normal_of(t, v, &canceled);
        } else {
            SVO_ASSERT(c->kind == SVO_KIND_UNORM8);
            v[0] = t->values != 0 ? (uint8_t)((double)t->value / (257.0 * (double)t->values) + 0.5) : 0;
        }
        g->report.canceled_normals += canceled;
        ok = svo_buffer_append(&g->values[i], v, svo_channel_stride(c->kind)) != NULL;
    }
    return ok ? SVO_OK : no_memory(err);
}

static svo_result emit_all(svo_samples *s, gatherer *g, merge *m, svo_error *err)
{
    const uint64_t least = s->o.least != 0 ? s->o.least : 1;
    SVO_TRY(begin_merge(s, m, err));
    svo_sample next;
    bool more;
    SVO_TRY(next_sample(m, &next, &more, err));
    while (more) {
        const uint64_t code = next.code;
        sums t = {0};
        while (more && next.code == code) {
            add(&t, &next);
            SVO_TRY(next_sample(m, &next, &more, err));
        }
        if (t.count < least) g->report.dropped_cells++;
        else SVO_TRY(put_cell(g, code, &t, err));
    }
    return end_chunk(g, err);
}

svo_result svo_samples_emit(svo_samples *s, const svo_tree_info *info, const svo_chunk_sink *sink, svo_samples_report *report, svo_error *err)
{
    SVO_ASSERT(info->depth == s->o.depth);
    gatherer g = {.info = info, .sink = sink, .level = svo_chunk_level(info->depth)};
    g.shift = 3 * (info->depth - g.level);
    svo_buffer_init(&g.codes, s->o.allocator);
    svo_buffer_init(&g.masks, s->o.allocator);
    for (uint32_t i = 0; i < SVO_MAX_CHANNELS; i++) svo_buffer_init(&g.values[i], s->o.allocator);
    merge m = {0};
    svo_result r = emit_all(s, &g, &m, err);
    end_merge(s, &m);
    svo_buffer_free(&g.codes);
    svo_buffer_free(&g.masks);
    for (uint32_t i = 0; i < SVO_MAX_CHANNELS; i++) svo_buffer_free(&g.values[i]);
    g.report.samples = s->count;
    g.report.runs = s->runs.size / sizeof(run);
    if (report != NULL) *report = g.report;
    return r;
}
