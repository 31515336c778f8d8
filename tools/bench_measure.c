/* svo-bench: running and timing the libraries. */
#define _GNU_SOURCE
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

#include "bench.h"
#include "fmt_import.h"
#include "fmt_svdag.h"
#include "fmt_svo.h"
#include "svo_dag.h"
#include "svo_voxelize.h"

/* What belongs to one model while it is measured. */
typedef struct work {
    bench *b;
    uint32_t model;
    svo_limit_allocator memory; /* everything, against --memory */
    svo_mesh mesh;
    double import_seconds;
    svo_buffer svo; /* the .svo being compressed */
    double voxelize_wall, voxelize_cpu;
    uint64_t voxelize_peak;
    svo_tree_info info;
    svo_voxelize_report voxelized;
    bench_watch watch;
    bench_literals *literals;
} work;

/* The high-water mark of resident memory, set back before each point. 0 where the system does not tell. */
static void reset_peak_rss(void)
{
    FILE *f = fopen("/proc/self/clear_refs", "w");
    if (f == NULL) return;
    fputs("5", f);
    fclose(f);
}

static uint64_t peak_rss(void)
{
    FILE *f = fopen("/proc/self/status", "r");
    char line[256];
    unsigned long long kilobytes = 0;
    while (f != NULL && fgets(line, sizeof line, f) != NULL)
        if (sscanf(line, "VmHWM: %llu kB", &kilobytes) == 1) break;
    if (f != NULL) fclose(f);
    return 1024 * (uint64_t)kilobytes;
}

static double user_seconds(void)
{
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    return (double)u.ru_utime.tv_sec + 1e-6 * (double)u.ru_utime.tv_usec;
}

void bench_watch_start(bench_watch *w)
{
    w->cpu_start = user_seconds();
    w->wall_start = svo_seconds();
}

void bench_watch_stop(bench_watch *w)
{
    w->wall[w->count] = svo_seconds() - w->wall_start;
    w->cpu[w->count] = user_seconds() - w->cpu_start;
    w->count++;
}

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double bench_median(double *v, uint32_t n)
{
    qsort(v, n, sizeof *v, by_size);
    return n % 2 == 1 ? v[n / 2] : (v[n / 2 - 1] + v[n / 2]) / 2;
}

/* What may still be taken under --memory: 0 (no limit) or at least one byte. */
static uint64_t memory_left(const work *w)
{
    if (w->b->c->memory == 0) return 0;
    uint64_t used = svo_limit_in_use(&w->memory);
    return used < w->b->c->memory ? w->b->c->memory - used : 1;
}

/* The first of repeated runs may warn, the others would say the same again. */
static svo_warnings *warnings_of(const work *w) { return w->watch.count == 0 ? &w->b->c->warnings : NULL; }

static uint64_t sum_nodes(const svo_tree_counts *counts, uint32_t depth)
{
    uint64_t n = 0;
    for (uint32_t l = 0; l <= depth; l++) n += counts->nodes[l];
    return n;
}

/* --- voxels ------------------------------------------------------------------------------------------------------- */

/* Mesh to a .svo in memory, once. */
static svo_result voxelize_once(work *w, uint32_t depth, uint32_t channels, svo_limit_allocator *charged, svo_error *err)
{
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = depth;
    o.channels = channels;
    o.threads = (uint32_t)w->b->c->threads;
    o.memory = memory_left(w);
    o.allocator = &charged->base;
    o.warnings = warnings_of(w);
    SVO_TRY(svo_voxelize_plan(&w->mesh, &o, &w->info, err));
    fmt_output *out;
    fmt_svo_writer *writer = NULL;
    SVO_TRY(fmt_output_open_memory(&w->svo, &out, err));
    svo_result r = fmt_svo_writer_begin(out, &w->info, NULL, 0, &charged->base, &writer, err);
    if (r == SVO_OK) {
        svo_chunk_sink sink = fmt_svo_writer_sink(writer);
        r = svo_voxelize(&w->mesh, &o, &w->info, &sink, &w->voxelized, err);
    }
    if (r == SVO_OK) {
        r = fmt_svo_writer_end(writer, NULL, err);
        writer = NULL;
    }
    fmt_svo_writer_discard(writer);
    if (r == SVO_OK) return fmt_output_commit(out, err);
    fmt_output_discard(out);
    return r;
}

static svo_result voxelize(work *w, uint32_t depth, uint32_t channels, svo_error *err)
{
    cli_phase(w->b->c, "voxelize");
    w->watch.count = 0;
    w->voxelize_peak = 0;
    for (uint64_t i = 0; i < w->b->repeat; i++) {
        svo_limit_allocator charged;
        svo_limit_allocator_init(&charged, UINT64_MAX, &w->memory.base);
        svo_buffer_free(&w->svo);
        bench_watch_start(&w->watch);
        SVO_TRY(voxelize_once(w, depth, channels, &charged, err));
        bench_watch_stop(&w->watch);
        if (svo_limit_peak(&charged) > w->voxelize_peak) w->voxelize_peak = svo_limit_peak(&charged);
    }
    w->voxelize_wall = bench_median(w->watch.wall, w->watch.count);
    w->voxelize_cpu = bench_median(w->watch.cpu, w->watch.count);
    return SVO_OK;
}

/* --- accuracy ----------------------------------------------------------------------------------------------------- */

enum { REFERENCE_VOXELS = 2048, REFERENCE_MAX_DEPTH = 12 };

static svo_result drop_encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err)
{
    (void)user, (void)chunk, (void)worker, (void)err;
    *blob = NULL;
    return SVO_OK;
}
static svo_result drop_commit(void *user, void *blob, svo_error *err)
{
    (void)user, (void)blob, (void)err;
    return SVO_OK;
}
static void drop_discard(void *user, void *blob) { (void)user, (void)blob; }

/* Colours and normals against the reference, in a run of its own that is not timed; left out at depths where that run would take long. */
static svo_result measure_attributes(work *w, uint32_t channels, double *v, svo_error *err)
{
    if (channels == 0 || w->info.depth > REFERENCE_MAX_DEPTH) return SVO_OK;
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = w->info.depth;
    o.channels = channels;
    o.threads = (uint32_t)w->b->c->threads;
    o.memory = memory_left(w);
    o.allocator = &w->memory.base;
    o.reference_voxels = REFERENCE_VOXELS;
    svo_chunk_sink sink = {NULL, drop_encode, drop_commit, drop_discard};
    svo_voxelize_report r;
    SVO_TRY(svo_voxelize(&w->mesh, &o, &w->info, &sink, &r, err));
    v[COL_REFERENCE_VOXELS] = (double)r.reference_voxels;
    for (uint32_t i = 0; i < w->info.channel_count; i++) {
        const svo_channel_error *e = &r.attribute_errors[i];
        bool color = strcmp(w->info.channels[i].name, "color") == 0, normal = strcmp(w->info.channels[i].name, "normal") == 0;
        if (e->voxels == 0 || (!color && !normal)) continue;
        v[color ? COL_COLOR_MEAN : COL_NORMAL_MEAN] = e->mean;
        v[color ? COL_COLOR_MAX : COL_NORMAL_MAX] = e->max;
    }
    return SVO_OK;
}

static svo_result measure_surface(work *w, double *v, svo_error *err)
{
    bench_surface s;
    SVO_TRY(bench_surface_distances(&w->mesh, &w->svo, &w->info, &w->memory.base, &s, err));
    v[COL_SURFACE_POINTS] = (double)s.count;
    if (s.count == 0) return SVO_OK;
    v[COL_SURFACE_VOXEL_MEAN] = s.mean;
    v[COL_SURFACE_VOXEL_MAX] = s.max;
    return SVO_OK;
}

/* The .svo in memory to a .svdag whose bytes are counted and dropped. */
static svo_result compress_once(work *w, const svo_dag_options *o, svo_dag_report *report, uint64_t *bytes, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *reader = NULL;
    fmt_output *out = NULL;
    svo_packed *packed = NULL;
    SVO_TRY(fmt_input_open_memory(w->svo.data, w->svo.size, &in, err));
    svo_result r = fmt_svo_reader_open(in, o->allocator, &reader, err);
    if (r == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(reader);
        r = svo_dag_build(fmt_svo_reader_info(reader), &source, o, &packed, report, err);
    }
    if (r == SVO_OK) r = fmt_output_open("/dev/null", true, &out, err);
    if (r == SVO_OK) r = fmt_svdag_write(out, svo_packed_view(packed), NULL, err);
    if (r == SVO_OK) *bytes = fmt_output_offset(out);
    fmt_output_discard(out);
    svo_packed_free(packed);
    fmt_svo_reader_close(reader);
    fmt_input_close(in);
    return r;
}

static void note_channel(work *w, const svo_dag_report *d, bench_row *row)
{
    const char *name = w->b->sweep == SWEEP_COLOR ? "color" : "normal";
    bool color = w->b->sweep == SWEEP_COLOR;
    for (uint32_t i = 0; i < d->channel_count; i++) {
        const svo_dag_channel_report *ch = &d->channels[i];
        if (strcmp(ch->name, name) != 0) continue;
        row->value[COL_CHANNEL_BYTES] = (double)ch->bytes;
        row->value[COL_CHANNEL_PER_VOXEL] = row->value[COL_VOXELS] > 0 ? (double)ch->bytes / row->value[COL_VOXELS] : NAN;
        row->value[COL_DISTINCT_IN] = (double)ch->distinct_in;
        row->value[COL_DISTINCT_OUT] = (double)ch->distinct_out;
        row->value[color ? COL_DELTA_E_MEAN : COL_DEGREES_MEAN] = ch->error_mean;
        row->value[color ? COL_DELTA_E_MAX : COL_DEGREES_MAX] = ch->error_max;
        if (ch->left_out) svo_warn(&w->b->c->warnings, "%s: %s is the same in all voxels, so there is nothing to sweep", w->b->models[w->model].path, name);
    }
}

/* Compress what voxelize left and fill in the row. */
static svo_result compress(work *w, const bench_value *value, bench_row *row, svo_error *err)
{
    cli_phase(w->b->c, "compress");
    svo_dag_options o = svo_default_dag_options();
    if (w->b->sweep == SWEEP_COLOR && value->kind == VALUE_NUMBER) o.color_bits = (uint32_t)value->number;
    if (w->b->sweep == SWEEP_COLOR && value->kind == VALUE_BOUND) o.color_delta_e = value->number;
    if (w->b->sweep == SWEEP_NORMAL && value->kind == VALUE_NUMBER) o.normal_bits = (uint32_t)value->number;
    if (w->b->sweep == SWEEP_NORMAL && value->kind == VALUE_BOUND) o.normal_degrees = value->number;
    o.threads = (uint32_t)w->b->c->threads;
    svo_dag_report d = {0};
    uint64_t bytes = 0, peak = 0;
    w->watch.count = 0;
    for (uint64_t i = 0; i < w->b->repeat; i++) {
        svo_limit_allocator charged;
        svo_limit_allocator_init(&charged, UINT64_MAX, &w->memory.base);
        o.allocator = &charged.base;
        o.memory = memory_left(w);
        o.warnings = warnings_of(w);
        bench_watch_start(&w->watch);
        SVO_TRY(compress_once(w, &o, &d, &bytes, err));
        bench_watch_stop(&w->watch);
        if (svo_limit_peak(&charged) > peak) peak = svo_limit_peak(&charged);
    }
    double *v = row->value, voxels = (double)w->voxelized.counts.nodes[w->info.depth], size = w->info.voxel_to_world[0];
    v[COL_DEPTH] = w->info.depth;
    v[COL_VOXELS] = voxels;
    v[COL_NODES] = (double)sum_nodes(&w->voxelized.counts, w->info.depth);
    v[COL_VOXELIZE_WALL] = w->voxelize_wall;
    v[COL_VOXELIZE_CPU] = w->voxelize_cpu;
    v[COL_COMPRESS_WALL] = bench_median(w->watch.wall, w->watch.count);
    v[COL_COMPRESS_CPU] = bench_median(w->watch.cpu, w->watch.count);
    v[COL_TOTAL_WALL] = v[COL_VOXELIZE_WALL] + v[COL_COMPRESS_WALL];
    v[COL_TOTAL_CPU] = v[COL_VOXELIZE_CPU] + v[COL_COMPRESS_CPU];
    v[COL_SVO_BYTES] = (double)w->svo.size;
    v[COL_SVDAG_BYTES] = (double)bytes;
    v[COL_SVO_PER_VOXEL] = voxels > 0 ? (double)w->svo.size / voxels : NAN;
    v[COL_SVDAG_PER_VOXEL] = voxels > 0 ? (double)bytes / voxels : NAN;
    v[COL_GEOMETRY_BYTES] = (double)d.geometry_bytes;
    v[COL_ATTRIBUTE_BYTES] = (double)d.attribute_bytes;
    v[COL_VOXEL_SIZE] = size;
    if (w->voxelized.distance_samples > 0) {
        v[COL_MEAN_VOXELS] = w->voxelized.distance_mean;
        v[COL_MAX_VOXELS] = w->voxelized.distance_max;
        v[COL_MEAN_WORLD] = w->voxelized.distance_mean * size;
        v[COL_MAX_WORLD] = w->voxelized.distance_max * size;
        v[COL_MEAN_PERCENT] = 100 * w->voxelized.distance_mean / ldexp(1, (int)w->info.depth);
        v[COL_MAX_PERCENT] = 100 * w->voxelized.distance_max / ldexp(1, (int)w->info.depth);
    }
    v[COL_BOUND_VOXELS] = sqrt(3) / 2;
    v[COL_BOUND_WORLD] = sqrt(3) / 2 * size;
    v[COL_SAMPLES] = (double)w->voxelized.distance_samples;
    v[COL_SNAP_MEAN] = w->voxelized.snap_mean;
    v[COL_SNAP_MAX] = w->voxelized.snap_max;
    v[COL_VOXELIZE_PEAK] = (double)w->voxelize_peak;
    v[COL_COMPRESS_PEAK] = (double)peak;
    note_channel(w, &d, row);
    return SVO_OK;
}

/* --- a model ------------------------------------------------------------------------------------------------------ */

static void fail_row(const bench *b, bench_row *row, svo_result r, const svo_error *err)
{
    if (r == SVO_OUT_OF_MEMORY && b->c->memory != 0) r = SVO_LIMIT;
    row->result = r;
    snprintf(row->error, sizeof row->error, "%s", err->message[0] != 0 ? err->message : svo_result_text(r));
    for (int i = 0; i < COL_COUNT; i++) row->value[i] = NAN;
}

static svo_result import(work *w, svo_error *err)
{
    cli_phase(w->b->c, "import");
    /* The textures' alpha decides which voxels there are; skeletons take the triangles alone. */
    fmt_import_options o = {.allocator = &w->memory.base, .threads = (uint32_t)w->b->c->threads, .skip_images = w->b->sweep == SWEEP_OMEGA || w->b->sweep == SWEEP_METHOD, .warnings = &w->b->c->warnings};
    double start = svo_seconds();
    SVO_TRY(fmt_import_mesh(w->b->models[w->model].path, &o, &w->mesh, err));
    w->import_seconds = svo_seconds() - start;
    return SVO_OK;
}

static svo_result measure_value(work *w, uint32_t i, bench_row *row, svo_error *err)
{
    const bench *b = w->b;
    const bench_value *value = &b->values[i];
    row->value[COL_TRIANGLES] = (double)svo_mesh_count(&w->mesh).placed_triangles;
    row->value[COL_IMPORT_WALL] = w->import_seconds;
    if (b->sweep == SWEEP_OMEGA || b->sweep == SWEEP_METHOD) {
        svo_result r = bench_skeleton(w->b, &w->mesh, &w->memory.base, value, &w->watch, &w->literals, row->value, err);
        if (peak_rss() != 0) row->value[COL_PEAK_RSS] = (double)peak_rss();
        return r;
    }
    if (b->sweep == SWEEP_DEPTH) {
        uint32_t channels = b->attributes == 0 ? SVO_WANT_AUTO : 0;
        SVO_TRY(voxelize(w, (uint32_t)value->number, channels, err));
    }
    SVO_TRY(compress(w, value, row, err));
    uint64_t rss = peak_rss();
    if (rss != 0) row->value[COL_PEAK_RSS] = (double)rss;
    if (b->sweep != SWEEP_DEPTH) return SVO_OK;
    cli_phase(b->c, "accuracy");
    SVO_TRY(measure_surface(w, row->value, err));
    return measure_attributes(w, b->attributes == 0 ? SVO_WANT_AUTO : 0, row->value, err);
}

void bench_measure(bench *b, uint32_t model)
{
    work *w = calloc(1, sizeof *w);
    svo_error err = {0};
    svo_result all = SVO_OK; /* a failure that leaves nothing to measure */
    if (w == NULL) {
        all = svo_fail(&err, SVO_OUT_OF_MEMORY, "out of memory");
    } else {
        w->b = b;
        w->model = model;
        svo_limit_allocator_init(&w->memory, b->c->memory != 0 ? b->c->memory : UINT64_MAX, NULL);
        svo_buffer_init(&w->svo, &w->memory.base);
        all = import(w, &err);
    }
    if (all == SVO_OK && (b->sweep == SWEEP_COLOR || b->sweep == SWEEP_NORMAL)) {
        all = voxelize(w, (uint32_t)b->depth, b->sweep == SWEEP_COLOR ? SVO_WANT_COLOR : SVO_WANT_NORMAL, &err);
    }
    for (uint32_t i = 0; i < b->value_count; i++) {
        bench_row *row = bench_row_at(b, model, i);
        for (int k = 0; k < COL_COUNT; k++) row->value[k] = NAN;
        svo_result r = all;
        row->result = SVO_OK;
        row->error[0] = 0;
        if (all == SVO_OK) {
            memset(&err, 0, sizeof err);
            reset_peak_rss();
            r = measure_value(w, i, row, &err);
        }
        if (r != SVO_OK) fail_row(b, row, r, &err);
        double done = (double)model + (double)(i + 1) / b->value_count;
        cli_progress(b->c, b->models[model].name, done / b->model_count);
        if (b->save != NULL) b->save(b, b->save_user);
    }
    cli_phase(b->c, NULL);
    if (w == NULL) return;
    bench_literals_free(w->literals);
    svo_buffer_free(&w->svo);
    svo_mesh_free(&w->mesh);
    free(w);
}

/* --- Pareto fronts ------------------------------------------------------------------------------------------------ */

static bool dominated(const bench *b, uint32_t model, const bench_row *row, bench_column cost, bench_column error)
{
    for (uint32_t i = 0; i < b->value_count; i++) {
        const bench_row *other = bench_row_at(b, model, i);
        if (other == row || other->result != SVO_OK) continue;
        double dc = other->value[cost] - row->value[cost], de = other->value[error] - row->value[error];
        if (dc <= 0 && de <= 0 && (dc < 0 || de < 0)) return true;
    }
    return false;
}

void bench_mark_fronts(bench *b)
{
    const bench_axes axes = bench_axes_of(b);
    for (uint32_t m = 0; m < b->model_count; m++) {
        for (uint32_t i = 0; i < b->value_count; i++) {
            bench_row *row = bench_row_at(b, m, i);
            bool measured = row->result == SVO_OK && isfinite(row->value[axes.error]);
            row->front_seconds = measured && !dominated(b, m, row, axes.seconds, axes.error);
            row->front_bytes = measured && !dominated(b, m, row, axes.bytes, axes.error);
        }
    }
}
