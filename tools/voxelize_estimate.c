#include "voxelize_estimate.h"

#include <limits.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include "fmt_svo.h"
#include "svo_estimate.h"
#include "svo_morton.h"
#include "svo_soup.h"

enum {
    TRIAL_DEPTH = 9,
    INSIDE_DEPTH = 5, /* of the first trial of the inside; others follow, up to TRIAL_DEPTH, while they are short */
    PARTS = 6, PART_VOXELS = 100000, /* tried at the job's own depth */
    LARGER = 16,
    VOXEL_BYTES = 24,  /* more than a voxel takes in a file, with every channel */
    RECORD_BYTES = 250, /* more than a triangle takes in temporary files */
    SOLID_MOST = 350,   /* the same of what tells inside from outside, where no edge is shared */
    SOLID_LEAST = 80    /* less than it takes where all are shared */
};

static const double PART_SECONDS = 0.05;
static const double INSIDE_SECONDS = 10;  /* a longer trial of the inside is not made, */
static const double LEAP_SECONDS = 1;     /* and where the next but one takes less than this, not the next */
static const double INSIDE_CERTAIN = 0.1; /* trials that take less than this do not tell how time grows */

/* A voxel of the trial, from which a part of the grid is chosen. */
typedef struct probes {
    svo_chunk_sink sink;
    pthread_mutex_t lock;
    svo_buffer codes; /* uint64_t: a voxel in the middle of each chunk, Morton code at the trial's depth */
    uint32_t depth;
} probes;

typedef struct middle { uint64_t index, code; } middle;

static bool find_middle(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    middle *m = user;
    if (index < m->index) return true;
    m->code = svo_morton_encode(x, y, z);
    return false;
}

static svo_result probe_encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err)
{
    probes *p = user;
    middle m = {.index = chunk->value_count / 2};
    svo_chunk_voxels(chunk, find_middle, &m);
    pthread_mutex_lock(&p->lock);
    bool ok = svo_buffer_append(&p->codes, &m.code, sizeof m.code) != NULL;
    pthread_mutex_unlock(&p->lock);
    if (!ok) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    return p->sink.encode(p->sink.user, chunk, worker, blob, err);
}
static svo_result probe_commit(void *user, void *blob, svo_error *err) { return ((probes *)user)->sink.commit(((probes *)user)->sink.user, blob, err); }
static void probe_discard(void *user, void *blob) { ((probes *)user)->sink.discard(((probes *)user)->sink.user, blob); }

static int by_code(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return x < y ? -1 : x > y;
}

typedef struct trial { uint64_t nodes[SVO_MAX_DEPTH + 1], bytes; double seconds, seconds_setup, seconds_voxels; uint32_t depth; } trial;

/* The job at another depth, or a part of it (first < end), into memory. */
static svo_result try_depth(const estimate_input *in, svo_fill fill, uint32_t depth, uint64_t first, uint64_t end, probes *probe, trial *out, svo_error *err)
{
    svo_voxelize_options o = *in->options;
    svo_tree_info info;
    o.fill = fill;
    o.reference_voxels = 0;
    o.has_range = first < end;
    o.first_code = first;
    o.end_code = end;
    o.warnings = NULL;
    o.depth = depth;
    if (o.voxel_size != 0) o.voxel_size = ldexp(o.voxel_size, (int)in->info->depth - (int)depth);
    SVO_TRY(svo_voxelize_plan(in->mesh, &o, &info, err));
    const double started = svo_seconds();
    svo_buffer bytes;
    fmt_output *to = NULL;
    fmt_svo_writer *writer = NULL;
    svo_voxelize_report report = {0};
    svo_buffer_init(&bytes, in->allocator);
    svo_result r = fmt_output_open_memory(&bytes, &to, err);
    if (r == SVO_OK) r = fmt_svo_writer_begin(to, &info, "{}", in->level, in->allocator, &writer, err);
    if (r == SVO_OK && in->small) r = fmt_svo_writer_small(writer, err);
    if (r == SVO_OK) {
        svo_chunk_sink sink = fmt_svo_writer_sink(writer);
        if (probe != NULL) {
            probe->sink = sink;
            sink = (svo_chunk_sink){probe, probe_encode, probe_commit, probe_discard};
        }
        r = svo_voxelize(in->mesh, &o, &info, &sink, &report, err);
    }
    if (r == SVO_OK) {
        r = fmt_svo_writer_end(writer, NULL, err);
        writer = NULL;
    }
    if (r == SVO_OK) {
        *out = (trial){.bytes = fmt_output_offset(to), .seconds = svo_seconds() - started, .depth = info.depth, .seconds_setup = report.seconds_setup, .seconds_voxels = report.seconds_voxels};
        memcpy(out->nodes, report.counts.nodes, sizeof out->nodes);
    }
    fmt_svo_writer_discard(writer);
    fmt_output_discard(to);
    svo_buffer_free(&bytes);
    return r;
}

/* Bytes and seconds a voxel at the depth of the job itself, of a few parts of the grid around voxels of the trial. */
static svo_result try_parts(const estimate_input *in, const trial *coarse, const probes *probe, double voxels, double part_voxels, trial *out, svo_error *err)
{
    const uint32_t chunk_level = svo_chunk_level(in->info->depth);
    uint32_t level = chunk_level < coarse->depth ? chunk_level : coarse->depth;
    while (level > 0 && voxels / (double)coarse->nodes[level] < part_voxels) level--;
    const uint64_t *codes = (const uint64_t *)(const void *)probe->codes.data, count = probe->codes.size / sizeof *codes;
    uint64_t last = UINT64_MAX;
    memset(out, 0, sizeof *out);
    for (uint64_t i = 0; i < PARTS && i < count; i++) {
        uint64_t node = codes[(2 * i + 1) * count / (2 * PARTS)] >> 3 * (coarse->depth - level), wide = 3 * (chunk_level - level);
        trial t;
        if (node == last) continue;
        last = node;
        SVO_TRY(try_depth(in, SVO_FILL_SURFACE, in->info->depth, node << wide, (node + 1) << wide, NULL, &t, err));
        for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) out->nodes[l] += t.nodes[l];
        out->bytes += t.bytes;
        out->seconds += t.seconds;
        out->seconds_voxels += t.seconds_voxels;
        out->seconds_setup = t.seconds_setup; /* once in the job */
    }
    return SVO_OK;
}

static bool is_solid(const estimate_input *in) { return in->info->fill == SVO_FILL_SOLID; }

/* Of the surface. A solid is estimated as one with an inside, of which trials of their own are made. */
static svo_result trials(const estimate_input *in, uint32_t at, probes *probe, run_estimate *e, trial *fine, svo_error *err)
{
    SVO_TRY(try_depth(in, SVO_FILL_SURFACE, at, 0, 0, probe, fine, err));
    qsort(probe->codes.data, probe->codes.size / 8, 8, by_code);
    e->depth = fine->depth;
    e->trial_voxels = fine->nodes[fine->depth];
    e->trial_seconds = fine->seconds;
    return SVO_OK;
}

/* Nodes of a level over 4^level tend to a constant as 1 - k 2^-level does (folds and neighbours that share voxels become rare): two
 * levels of the trial give the constant. */
static double surface_nodes(const trial *fine, uint32_t level)
{
    const double voxels = (double)fine->nodes[fine->depth];
    if (level <= fine->depth) return (double)fine->nodes[level];
    double most = fine->depth > 0 && voxels > 0 ? 2 - 4 * (double)fine->nodes[fine->depth - 1] / voxels : 1;
    if (most < 0.5) most = 0.5;
    if (most > 2) most = 2;
    const double below = ldexp(1, -(int)(level - fine->depth));
    return voxels / (below * below) * (most - (most - 1) * below);
}

/* What the inside makes of a surface. */
typedef struct inside {
    uint32_t depth;
    double volume;  /* in voxels of that depth */
    double bytes;   /* times those of the surface */
    double seconds; /* more for each voxel of the surface: beside it lies what is asked and listed, while what triangles cost is shared by more and more voxels */
    double everywhere; /* seconds more that grow as the volume does: around meshes that are open, where no place is inside or outside for sure */
    double setup;   /* seconds more, once */
} inside;

/* Measured: what the inside takes grows by 3.6 from depth 9 to 10 and to 11 while voxels of the surface grow by 4; deeper it is taken to follow them. */
static double inside_seconds(const inside *i, uint32_t depth, double surface)
{
    return i->seconds * pow(0.9, fmin(3, (double)depth - i->depth)) * surface + ldexp(i->everywhere, 3 * (int)(depth - i->depth));
}

static svo_result try_inside(const estimate_input *in, const trial *surface, run_estimate *e, trial *last, inside *out, svo_error *err)
{
    trial solid, shell = *surface;
    const uint32_t most = in->info->depth < TRIAL_DEPTH ? in->info->depth : TRIAL_DEPTH; /* as asked for: of whole voxels of a given size a level more may come of it */
    uint32_t depth = INSIDE_DEPTH < most ? INSIDE_DEPTH : most, levels = 0; /* since the trial before */
    double before = 0, took = 0;
    for (uint32_t trials = 0;; trials++, depth += levels) {
        SVO_TRY(try_depth(in, SVO_FILL_SOLID, depth, 0, 0, NULL, &solid, err));
        if (depth != most) SVO_TRY(try_depth(in, SVO_FILL_SURFACE, depth, 0, 0, NULL, &shell, err));
        else shell = *surface;
        e->trial_seconds += solid.seconds + (depth != most ? shell.seconds : 0);
        before = took;
        took = fmax(0, solid.seconds_voxels - shell.seconds_voxels);
        const uint32_t left = most - depth;
        if (left == 0 || (trials != 0 && 8 * took > INSIDE_SECONDS)) break;
        levels = left > 1 && 64 * took < LEAP_SECONDS ? 2 : 1;
    }
    const double voxels = (double)shell.nodes[shell.depth];
    /* Half of what the voxels of the surface hold is inside. */
    *out = (inside){.depth = solid.depth, .volume = (double)solid.nodes[solid.depth] - voxels / 2, .setup = fmax(0, solid.seconds_setup - shell.seconds_setup)};
    if (solid.nodes[solid.depth] == shell.nodes[shell.depth]) out->volume = 0; /* nothing is inside */
    out->bytes = shell.bytes > 0 ? (double)solid.bytes / (double)shell.bytes : 1;
    /* a part that grows by 4 a level, and one by 8: two trials tell both */
    double beside = took;
    if (levels != 0 && took >= INSIDE_CERTAIN) beside = fmin(took, fmax(0, (ldexp(before, 3 * (int)levels) - took) / (ldexp(1, (int)levels) - 1)));
    out->seconds = voxels > 0 ? beside / voxels : 0;
    out->everywhere = took - beside;
    e->inside_depth = solid.depth;
    *last = solid;
    return SVO_OK;
}

/* Nodes of a level of the job. */
static double level_nodes(const trial *fine, const inside *i, uint32_t level)
{
    const double surface = surface_nodes(fine, level);
    return i == NULL || i->volume <= 0 ? surface : fmax(surface, ldexp(i->volume, 3 * ((int)level - (int)i->depth)) + surface / 2);
}

svo_result estimate_run(cli *c, const estimate_input *in, run_estimate *out, svo_error *err)
{
    run_estimate e = {0};
    const uint32_t depth = in->info->depth;
    trial fine = {0}, part = {0};
    inside within;
    double area = 0, size = in->info->voxel_to_world[0], voxels, nodes = 0, surface;
    SVO_TRY(svo_estimate_area(in->mesh, in->options->threads, &area, err));
    e.voxels_by_area = area / (size * size);
    cli_phase(c, "trial");
    probes probe = {.depth = depth};
    svo_buffer_init(&probe.codes, in->allocator);
    pthread_mutex_init(&probe.lock, NULL);
    svo_result r = trials(in, depth < TRIAL_DEPTH ? depth : TRIAL_DEPTH, &probe, &e, &fine, err);
    surface = surface_nodes(&fine, depth);
    if (r == SVO_OK && depth > fine.depth) r = try_parts(in, &fine, &probe, surface, PART_VOXELS, &part, err);
    /* Where parts take so little time that beginning them counts, larger ones say more. */
    if (r == SVO_OK && depth > fine.depth && part.seconds_voxels < PART_SECONDS && PARTS * LARGER * (double)PART_VOXELS < surface / 2) {
        e.trial_seconds += part.seconds;
        r = try_parts(in, &fine, &probe, surface, LARGER * (double)PART_VOXELS, &part, err);
    }
    bool apart = is_solid(in);
    trial solid;
    if (r == SVO_OK && apart) r = try_inside(in, &fine, &e, &solid, &within, err);
    if (r == SVO_OK && apart && within.depth == depth) { /* that was the job */
        apart = false;
        e.inside_depth = 0;
        fine = solid;
        surface = (double)fine.nodes[depth];
        e.trial_voxels = fine.nodes[depth];
    }
    pthread_mutex_destroy(&probe.lock);
    svo_buffer_free(&probe.codes);
    if (r != SVO_OK) return r;
    const trial *t = part.nodes[depth] != 0 ? &part : &fine;
    const double tried = (double)t->nodes[t == &part ? depth : fine.depth];
    e.part_voxels = part.nodes[depth];
    e.trial_seconds += part.seconds;
    for (uint32_t l = 0; l <= depth; l++) nodes += level_nodes(&fine, apart ? &within : NULL, l);
    voxels = level_nodes(&fine, apart ? &within : NULL, depth);
    e.voxels = (uint64_t)(voxels + 0.5);
    e.nodes = (uint64_t)(nodes + 0.5);
    e.bytes = tried > 0 ? (uint64_t)((double)t->bytes / tried * surface * (apart ? within.bytes : 1)) : fine.bytes;
    e.seconds = in->seconds_before + t->seconds_setup + (apart ? within.setup : 0) +
                (tried > 0 ? t->seconds_voxels / tried * surface + (apart ? inside_seconds(&within, depth, surface) : 0) : t->seconds_voxels);
    e.temporary = in->spill != NULL ? fmt_spill_count(in->spill).bytes_peak : 0;
    struct rusage usage;
    if (getrusage(RUSAGE_SELF, &usage) == 0) e.memory = (uint64_t)usage.ru_maxrss * 1024;
    *out = e;
    return SVO_OK;
}

static bool disk_of(const char *path, char folder[PATH_MAX], uint64_t *left, char mount[80])
{
    fmt_folder_of(path, folder, PATH_MAX);
    return strcmp(path, "-") != 0 && fmt_disk_free(folder, left, mount, 80);
}

void estimate_print(cli *c, const run_estimate *e, const char *output, const fmt_spill *spill)
{
    json_t *o = cli_section(c, "estimate");
    cli_put_u64(o, "voxels", e->voxels);
    cli_put_u64(o, "nodes", e->nodes);
    cli_put_u64(o, "bytes", e->bytes);
    cli_put_u64(o, "temporary_bytes", e->temporary);
    cli_put_u64(o, "memory_bytes", e->memory);
    cli_put_f64(o, "seconds", e->seconds);
    cli_put_f64(o, "voxels_by_area", e->voxels_by_area);
    cli_put_u64(o, "trial_depth", e->depth);
    cli_put_u64(o, "trial_voxels", e->trial_voxels);
    cli_put_u64(o, "part_voxels", e->part_voxels);
    if (e->inside_depth != 0) cli_put_u64(o, "inside_depth", e->inside_depth);
    cli_put_f64(o, "trial_seconds", e->trial_seconds);
    char folder[PATH_MAX], mount[80];
    uint64_t left;
    bool disk = output != NULL && disk_of(output, folder, &left, mount);
    printf("voxels       %llu\n", (unsigned long long)e->voxels);
    printf("nodes        %llu\n", (unsigned long long)e->nodes);
    printf("output       %.1f MB\n", (double)e->bytes / 1e6);
    printf("temporary    %.1f MB%s%s\n", (double)e->temporary / 1e6, spill != NULL ? " in " : "", spill != NULL ? fmt_spill_folder(spill) : "");
    printf("memory       %.1f MB\n", (double)e->memory / 1e6);
    printf("time         %.1f s\n", e->seconds);
    if (disk) printf("free disk    %.1f MB at %s\n", (double)left / 1e6, mount);
    char of_inside[80] = "";
    if (e->inside_depth != 0) snprintf(of_inside, sizeof of_inside, " These are of the surface; inside: the solid at depth %u.", e->inside_depth);
    printf("basis        voxels, nodes: the job at depth %u (%llu voxels), extrapolated; by the area of the surface alone: %.4g voxels.\n"
           "             output, time: parts of the job (%llu voxels), extrapolated; temporary, memory: what these took.%s All that in %.2f s.\n",
           e->depth, (unsigned long long)e->trial_voxels, e->voxels_by_area, (unsigned long long)(e->part_voxels != 0 ? e->part_voxels : e->trial_voxels),
           of_inside, e->trial_seconds);
}

/* Does what tells inside from outside lie in temporary files for sure? (svo_voxelize.c has it in memory where 200 bytes a triangle are less than half.) */
static bool is_paged(const estimate_input *in, double triangles)
{
    for (uint32_t i = 0; i < in->mesh->shape_count; i++)
        for (uint32_t p = 0; p < in->mesh->shapes[i].part_count; p++)
            if (in->mesh->shapes[i].parts[p].soup != NULL) return true;
    return in->options->memory != 0 && triangles * 400 > (double)in->options->memory;
}

svo_result estimate_check_disk(cli *c, const estimate_input *in, const char *output, svo_error *err)
{
    char folder[PATH_MAX], mount[80] = "", temp_mount[80] = "";
    uint64_t left = UINT64_MAX, temp_left = UINT64_MAX;
    struct stat s;
    bool file = output != NULL && strcmp(output, "-") != 0 && (stat(output, &s) != 0 || S_ISREG(s.st_mode)) && disk_of(output, folder, &left, mount);
    if (in->spill != NULL) fmt_disk_free(fmt_spill_folder(in->spill), &temp_left, temp_mount, sizeof temp_mount);
    double area = 0, size = in->info->voxel_to_world[0], triangles = (double)svo_mesh_count(in->mesh).placed_triangles;
    SVO_TRY(svo_estimate_area(in->mesh, in->options->threads, &area, err));
    double most = file ? (area / (size * size) + 8 * triangles) * VOXEL_BYTES * (is_solid(in) ? 2 : 1) : 0;
    const double temporary = in->spill != NULL ? triangles * (is_solid(in) ? RECORD_BYTES + SOLID_MOST : RECORD_BYTES) : 0;
    /* What tells inside from outside needs no trial, which would write it. */
    const double least = is_solid(in) && in->spill != NULL && is_paged(in, triangles) ? triangles * SOLID_LEAST : 0;
    if (least > (double)temp_left)
        return svo_fail(err, SVO_LIMIT, "temporary files of the solid will take more than %.1f MB, but %.60s has %.1f MB free; choose another place with --temp, allow more --memory, or "
                        "give --ignore-free-space", least / 1e6, temp_mount, (double)temp_left / 1e6);
    if (most + temporary < (double)(left < temp_left ? left : temp_left)) return SVO_OK;
    run_estimate e;
    svo_error inner = {0};
    const svo_result tried = estimate_run(c, in, &e, &inner);
    if (tried == SVO_IO && temporary > (double)temp_left) /* the trial is smaller than the job, but for the triangles */
        return svo_fail(err, SVO_LIMIT, "temporary files do not fit on %.60s, which has %.1f MB free (%.80s); choose another place with --temp, or give --ignore-free-space", temp_mount,
                        (double)temp_left / 1e6, inner.message);
    if (tried != SVO_OK) {
        if (err != NULL) *err = inner;
        return tried;
    }
    uint64_t held = in->spill != NULL ? fmt_spill_count(in->spill).bytes_now : 0, extra = e.temporary > held ? e.temporary - held : 0;
    bool same = strcmp(mount, temp_mount) == 0;
    if (file && e.bytes + (same ? extra : 0) > left)
        return svo_fail(err, SVO_LIMIT, "the output will take about %.1f MB and temporary files %.1f MB, but %.60s has %.1f MB free; make space, choose "
                        "another place, or give --ignore-free-space", (double)e.bytes / 1e6, same ? (double)extra / 1e6 : 0, mount, (double)left / 1e6);
    if (extra > temp_left)
        return svo_fail(err, SVO_LIMIT, "temporary files will take about %.1f MB more, but %.60s has %.1f MB free; choose another place with --temp, or "
                        "give --ignore-free-space", (double)extra / 1e6, temp_mount, (double)temp_left / 1e6);
    return SVO_OK;
}
