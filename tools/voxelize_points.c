#include "voxelize_points.h"

#include <malloc.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli_sources.h"
#include "fmt_points.h"
#include "fmt_spill.h"
#include "fmt_svo.h"
#include "svo_bin.h"
#include "svo_morton.h"
#include "svo_samples.h"

enum { BATCH = 1 << 12 };

int voxelize_are_points(const cli *c)
{
    int points = 0;
    for (int i = 0; i < c->input_count; i++) points += fmt_is_points(c->inputs[i]);
    return points == 0 ? 0 : points == c->input_count ? 1 : -1;
}

typedef struct job {
    cli *c;
    const points_options *o;
    svo_limit_allocator limit;
    fmt_points **clouds;
    int open;
    sources read;
    char *provenance;
    fmt_spill *spill; /* NULL without --memory */
    svo_grid grid;
    svo_tree_info info;
    fmt_points_survey all; /* of the clouds together */
    double intensity_low, intensity_range;
} job;

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory"); }

/* From the file's axes and unit. */
static void turn(const job *j, const double from[3], double to[3])
{
    const svo_vec3 v = svo_mat4_vector(&j->o->axes->matrix, svo_v3(from[0], from[1], from[2]));
    to[0] = v.x, to[1] = v.y, to[2] = v.z;
}

/* --- what there is --- */

static void join(fmt_points_survey *to, const fmt_points_survey *s, bool first)
{
    const bool any = s->points > s->not_finite, had = to->points > to->not_finite;
    for (int k = 0; k < 3 && any; k++) {
        if (!had || s->low[k] < to->low[k]) to->low[k] = s->low[k];
        if (!had || s->high[k] > to->high[k]) to->high[k] = s->high[k];
    }
    if (s->has_intensity) {
        if (!to->has_intensity || s->intensity_low < to->intensity_low) to->intensity_low = s->intensity_low;
        if (!to->has_intensity || s->intensity_high > to->intensity_high) to->intensity_high = s->intensity_high;
    }
    to->one_color = first ? s->one_color && s->has_color : to->one_color && s->one_color && s->has_color && memcmp(to->color, s->color, sizeof s->color) == 0;
    if (first) memcpy(to->color, s->color, sizeof to->color);
    to->intensity_bytes = (first || to->intensity_bytes) && s->intensity_bytes;
    to->points += s->points;
    to->not_finite += s->not_finite;
    to->has_color |= s->has_color;
    to->has_normal |= s->has_normal;
    to->has_intensity |= s->has_intensity;
}

static svo_result open_all(job *j, json_t *inputs, svo_error *err)
{
    cli *c = j->c;
    for (int i = 0; i < c->input_count; i++) {
        const size_t file = j->read.count;
        fmt_points_options o = {.columns = j->o->columns, .threads = (uint32_t)c->threads, .allocator = &j->limit.base, .warnings = &c->warnings,
                                .file_read = sources_add, .file_read_user = &j->read};
        SVO_TRY(fmt_points_open(c->inputs[i], &o, &j->clouds[i], err));
        j->open++;
        if (j->read.failed) return no_memory(err);
        json_array_append_new(inputs, cli_provenance_input(c->inputs[i], j->read.list[file].hash));
        const fmt_points_survey *s = fmt_points_seen(j->clouds[i]);
        if (s->columns[0] != 0) cli_verbose(c, "%s: columns are %s", c->inputs[i], s->columns);
        join(&j->all, s, i == 0);
    }
    /* Quarter turns and a scale map bounds to bounds, number by number. */
    double corner[2][3];
    turn(j, j->all.low, corner[0]);
    turn(j, j->all.high, corner[1]);
    for (int k = 0; k < 3; k++) j->all.low[k] = fmin(corner[0][k], corner[1][k]), j->all.high[k] = fmax(corner[0][k], corner[1][k]);
    return SVO_OK;
}

static bool wanted(const char *list, const char *name)
{
    const size_t n = strlen(name);
    for (const char *p = list; p != NULL; p = strchr(p, ',')) {
        p += *p == ',';
        if (strncmp(p, name, n) == 0 && (p[n] == ',' || p[n] == 0)) return true;
    }
    return false;
}

static svo_result add_channel(job *j, const char *name, svo_channel_kind kind, bool there, svo_error *err)
{
    const char *list = j->o->attributes;
    const bool automatic = strcmp(list, "auto") == 0;
    if (!automatic && !wanted(list, name)) return SVO_OK;
    if (!there) return automatic ? SVO_OK : svo_fail(err, SVO_INVALID_ARGUMENT, "--attributes: the points have no %s", name);
    svo_channel *c = &j->info.channels[j->info.channel_count++];
    strcpy(c->name, name);
    c->kind = kind;
    return SVO_OK;
}

static svo_result check_attributes(const char *list, svo_error *err)
{
    static const char *const names[] = {"color", "normal", "intensity"};
    if (strcmp(list, "auto") == 0 || strcmp(list, "none") == 0) return SVO_OK;
    for (const char *p = list;; p++) {
        const size_t n = strcspn(p, ",");
        bool known = false;
        for (size_t k = 0; k < sizeof names / sizeof *names; k++) known |= strlen(names[k]) == n && memcmp(names[k], p, n) == 0;
        if (!known) return svo_fail(err, SVO_INVALID_ARGUMENT, "--attributes of points: auto, none, or a list of color,normal,intensity");
        p += n;
        if (*p == 0) return SVO_OK;
    }
}

static svo_result plan(job *j, svo_error *err)
{
    const fmt_points_survey *s = &j->all;
    const bool any = s->points > s->not_finite;
    memset(&j->info, 0, sizeof j->info);
    SVO_TRY(svo_grid_plan(any, s->low, s->high, j->o->depth, j->o->voxel_size, &j->grid, err));
    j->info.depth = j->grid.depth;
    for (int k = 0; k < 3; k++) {
        j->info.voxel_to_world[5 * k] = j->grid.size;
        j->info.voxel_to_world[4 * k + 3] = j->grid.origin[k];
    }
    j->info.voxel_to_world[15] = 1;
    SVO_TRY(add_channel(j, "color", SVO_KIND_COLOR_SRGB8, s->has_color, err));
    if (j->info.channel_count == 1 && s->one_color) {
        svo_channel *c = &j->info.channels[0];
        c->constant = true;
        for (int k = 0; k < 3; k++) c->value[k] = svo_linear_to_srgb(s->color[k]);
    }
    SVO_TRY(add_channel(j, "normal", SVO_KIND_NORMAL_OCT32, s->has_normal, err));
    SVO_TRY(add_channel(j, "intensity", SVO_KIND_UNORM8, s->has_intensity, err));
    /* Bytes and values in 0..1 mean what they say, others go from the smallest to the largest. */
    j->intensity_low = 0;
    if (s->intensity_bytes) {
        j->intensity_range = 255;
    } else if (s->intensity_low >= 0 && s->intensity_high <= 1) {
        j->intensity_range = 1;
    } else {
        j->intensity_low = s->intensity_low;
        j->intensity_range = s->intensity_high - s->intensity_low;
    }
    return SVO_OK;
}

static svo_result identify(job *j, json_t *inputs, uint8_t key[16], svo_error *err)
{
    const points_options *o = j->o;
    json_t *how = json_object();
    if (o->voxel_size != 0) cli_put_f64(how, "voxel_size", o->voxel_size);
    else cli_put_u64(how, "depth", o->depth);
    if (o->columns != NULL) cli_put_text(how, "columns", o->columns);
    if (o->least > 1) cli_put_u64(how, "min_points", o->least);
    cli_put_text(how, "attributes", o->attributes);
    cli_put_axes(how, o->axes);
    j->provenance = cli_provenance(j->c, how, json_incref(inputs));
    char *what = j->provenance != NULL ? malloc(strlen(j->provenance) + 80) : NULL;
    if (what == NULL) return no_memory(err);
    sprintf(what, "%s\npoints, format 1.0 level %d disk %d", j->provenance, o->level, o->small);
    svo_result r = sources_key(&j->read, what, key, err);
    free(what);
    return r;
}

/* --- from points to samples --- */

static uint16_t unit16(double v) { return v > 0 ? v < 1 ? (uint16_t)(v * 65535 + 0.5) : 65535 : 0; }

static void sample_of(const job *j, const fmt_point *p, svo_sample *s)
{
    uint32_t cell[3];
    double at[3];
    turn(j, p->at, at);
    svo_grid_cell(&j->grid, at, cell);
    *s = (svo_sample){.code = svo_morton_encode(cell[0], cell[1], cell[2]), .has = (uint16_t)p->has};
    for (int k = 0; k < 3; k++) s->color[k] = unit16((double)p->color[k]);
    if (p->has & SVO_SAMPLE_NORMAL) {
        const double own[3] = {(double)p->normal[0], (double)p->normal[1], (double)p->normal[2]};
        double v[3];
        turn(j, own, v);
        const svo_vec3 n = svo_normalize(svo_v3(v[0], v[1], v[2]));
        v[0] = n.x, v[1] = n.y, v[2] = n.z;
        for (int k = 0; k < 3; k++) s->normal[k] = (int16_t)floor(v[k] * 32767 + 0.5);
    }
    if (p->has & SVO_SAMPLE_VALUE) s->value = unit16(j->intensity_range > 0 ? ((double)p->intensity - j->intensity_low) / j->intensity_range : 0);
}

static svo_result collect(job *j, svo_samples *samples, svo_error *err)
{
    svo_sample batch[BATCH];
    uint64_t done = 0;
    for (int i = 0; i < j->open; i++) {
        for (;;) {
            const fmt_point *points;
            uint64_t count;
            SVO_TRY(fmt_points_next(j->clouds[i], &points, &count, err));
            if (count == 0) break;
            for (uint64_t at = 0; at < count; at += BATCH) {
                const uint64_t n = count - at < BATCH ? count - at : BATCH;
                for (uint64_t k = 0; k < n; k++) sample_of(j, &points[at + k], &batch[k]);
                SVO_TRY(svo_samples_put(samples, batch, n, err));
            }
            done += count;
            cli_progress(j->c, "points", (double)done / (double)j->all.points);
        }
        SVO_TRY(fmt_points_unchanged(j->clouds[i], err));
    }
    return SVO_OK;
}

static void report(job *j, const svo_tree_counts *counts, const svo_samples_report *r, uint64_t bytes)
{
    json_t *in = cli_section(j->c, "input"), *out = cli_section(j->c, "output"), *channels = json_array();
    cli_put_u64(in, "files", (uint64_t)j->c->input_count);
    cli_put_u64(in, "points", j->all.points);
    cli_put_u64(in, "points_not_finite", j->all.not_finite);
    if (j->all.has_intensity) {
        cli_put_f64(in, "intensity_of_0", j->intensity_low);
        cli_put_f64(in, "intensity_of_1", j->intensity_low + j->intensity_range);
    }
    uint64_t nodes = 0;
    for (uint32_t l = 0; l <= j->info.depth; l++) nodes += counts->nodes[l];
    for (uint32_t i = 0; i < j->info.channel_count; i++) {
        json_t *channel = json_object();
        cli_put_text(channel, "name", j->info.channels[i].name);
        json_object_set_new(channel, "constant", json_boolean(j->info.channels[i].constant));
        json_array_append_new(channels, channel);
    }
    cli_put_u64(out, "bytes", bytes);
    cli_put_u64(out, "depth", j->info.depth);
    cli_put_f64(out, "voxel_size", j->grid.size);
    cli_put_u64(out, "voxels", r->cells);
    cli_put_u64(out, "nodes", nodes);
    cli_put_f64(out, "bytes_per_voxel", r->cells != 0 ? (double)bytes / (double)r->cells : 0);
    cli_put_f64(out, "points_per_voxel_mean", r->cells != 0 ? (double)r->samples / (double)(r->cells + r->dropped_cells) : 0);
    cli_put_u64(out, "points_per_voxel_max", r->most);
    cli_put_u64(out, "voxels_below_min_points", r->dropped_cells);
    cli_put_u64(out, "normals_that_cancel", r->canceled_normals);
    json_object_set_new(out, "attributes", channels);
    if (j->spill != NULL) {
        const fmt_spill_counts n = fmt_spill_count(j->spill);
        json_t *t = cli_section(j->c, "temporary_files");
        cli_put_text(t, "folder", fmt_spill_folder(j->spill));
        json_object_set_new(t, "used", json_boolean(n.files != 0));
        cli_put_u64(t, "bytes_peak", n.bytes_peak);
        cli_put_u64(t, "bytes_written", n.bytes_written);
        cli_put_u64(t, "runs", r->runs);
    }
    cli_verbose(j->c, "%llu points to %llu voxels at depth %u, %llu bytes", (unsigned long long)j->all.points, (unsigned long long)r->cells, j->info.depth,
                (unsigned long long)bytes);
}

static svo_result write_tree(job *j, svo_samples *samples, svo_error *err)
{
    fmt_output *out = NULL;
    fmt_svo_writer *writer = NULL;
    svo_tree_counts counts = {0};
    svo_samples_report told = {0};
    SVO_TRY(fmt_output_open(j->c->output, j->c->force, &out, err));
    svo_result r = fmt_svo_writer_begin(out, &j->info, j->provenance, j->o->level, &j->limit.base, &writer, err);
    if (r == SVO_OK && j->o->small) r = fmt_svo_writer_small(writer, err);
    if (r == SVO_OK) {
        svo_chunk_sink sink = fmt_svo_writer_sink(writer);
        r = svo_samples_emit(samples, &j->info, &sink, &told, err);
    }
    if (r == SVO_OK) {
        r = fmt_svo_writer_end(writer, &counts, err);
        writer = NULL;
    }
    fmt_svo_writer_discard(writer);
    const uint64_t bytes = fmt_output_offset(out);
    if (r == SVO_OK) {
        r = fmt_output_commit(out, err);
        out = NULL;
    }
    fmt_output_discard(out);
    if (r == SVO_OK) report(j, &counts, &told, bytes);
    return r;
}

static svo_result make(job *j, svo_error *err)
{
    cli *c = j->c;
    uint64_t left = 0;
    if (c->memory != 0) {
        const uint64_t used = svo_limit_in_use(&j->limit) + 2 * FMT_POINTS_WINDOW; /* rows as they are and as points */
        left = c->memory > used ? c->memory - used : 0;
        fmt_spill_options s = {.folder = j->o->temp, .beside = c->output, .limit = j->o->temp_size};
        SVO_TRY(fmt_spill_open(&s, &j->spill, err));
        if (left < (uint64_t)64 << 20) return svo_fail(err, SVO_LIMIT, "points need a --memory of %llu MB at least", (unsigned long long)((used >> 20) + 64));
    }
    svo_samples_options o = {.depth = j->info.depth, .least = j->o->least, .memory = left, .spill = j->spill != NULL ? fmt_spill_files(j->spill) : NULL, .allocator = &j->limit.base};
    svo_samples *samples = NULL;
    SVO_TRY(svo_samples_create(&o, &samples, err));
    cli_phase(c, "voxelize");
    svo_result r = collect(j, samples, err);
    cli_phase(c, "write");
    if (r == SVO_OK) r = write_tree(j, samples, err);
    svo_samples_free(samples);
    return r;
}

static svo_result run(job *j, json_t *inputs, svo_error *err)
{
    cli *c = j->c;
    uint8_t key[16];
    j->clouds = calloc((size_t)c->input_count, sizeof *j->clouds);
    if (j->clouds == NULL) return no_memory(err);
    SVO_TRY(check_attributes(j->o->attributes, err));
    cli_phase(c, "import");
    SVO_TRY(open_all(j, inputs, err));
    SVO_TRY(identify(j, inputs, key, err));
    if (j->o->key) {
        char hex[33];
        fmt_hash_text(key, hex);
        puts(hex);
        return SVO_OK;
    }
    cli_phase(c, "plan");
    SVO_TRY(plan(j, err));
    SVO_TRY(sources_check_depfile(&j->read, j->o->depfile, c->force, err));
    SVO_TRY(make(j, err));
    return j->o->depfile != NULL ? sources_depfile(&j->read, j->o->depfile, c->output, c->force, err) : SVO_OK;
}

svo_result voxelize_points(cli *c, const points_options *o, svo_error *err)
{
    job j = {.c = c, .o = o};
    json_t *inputs = json_array();
    if (c->memory != 0) { /* as for meshes: what is charged is what is resident */
        mallopt(M_MMAP_THRESHOLD, 1 << 17);
        mallopt(M_TRIM_THRESHOLD, 1 << 17);
        mallopt(M_ARENA_MAX, 1);
    }
    svo_limit_allocator_init(&j.limit, c->memory != 0 ? c->memory : UINT64_MAX, NULL);
    svo_result r = run(&j, inputs, err);
    for (int i = 0; i < j.open; i++) fmt_points_close(j.clouds[i]);
    fmt_spill_close(j.spill);
    free(j.clouds);
    free(j.provenance);
    sources_free(&j.read);
    json_decref(inputs);
    cli_phase(c, NULL);
    if (r == SVO_OUT_OF_MEMORY && c->memory != 0) r = svo_fail(err, SVO_LIMIT, "the points do not fit into --memory");
    return r;
}
