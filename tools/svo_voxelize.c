/* svo-voxelize: meshes to a sparse voxel octree with attributes. */
#include <malloc.h>
#include <stdlib.h>
#include <stdio.h>
#include <string.h>

#include "cli_quality.h"
#include "cli_sources.h"
#include "fmt_import.h"
#include "fmt_spill.h"
#include "fmt_svo.h"
#include "svo_shard.h"
#include "svo_voxelize.h"
#include "voxelize_cells.h"
#include "voxelize_estimate.h"
#include "voxelize_join.h"
#include "voxelize_points.h"
#include "voxelize_shard.h"

static const char *const fills[] = {"surface", "solid", NULL};
static const char *const disks[] = {"fast", "small", NULL};
static const char *const beside[] = {"D", NULL}; /* -MD */
static const char *const surfaces[] = {"conservative", "thin", NULL};

static const uint64_t MOST_PAGES = (uint64_t)1 << 30; /* bytes of textures in temporary files that are in memory at a time */

typedef struct tool_options {
    uint64_t depth;
    double voxel_size;
    bool has_depth, has_size;
    int fill, surface, disk;
    const char *attributes;
    uint64_t level; /* 0: packed values; else zstd's */
    uint32_t channels;
    const char *shard, *depfile;
    int beside;
    bool has_beside;
    uint32_t shard_index, shard_count; /* 0 = not sharded */
    uint64_t reference;                /* voxels */
    bool key;
    const char *temp;
    uint64_t temp_size;
    bool dry_run, ignore_free_space;
    double threshold;
    bool has_threshold;
    const char *columns, *raw;
    uint64_t min_points;
    bool has_min_points;
    cli_axes axes;
} tool_options;

/* Textures that no channel reads. */
static uint32_t unread(uint32_t channels)
{
    if (channels & SVO_WANT_AUTO) return 0; /* the materials say what there is */
    return (channels & (SVO_WANT_COLOR | SVO_WANT_COVERAGE) ? 0 : FMT_WITHOUT_COLOR) | (channels & SVO_WANT_EMISSIVE ? 0 : FMT_WITHOUT_EMISSIVE) |
           (channels & (SVO_WANT_METALLIC | SVO_WANT_ROUGHNESS) ? 0 : FMT_WITHOUT_METALLIC_ROUGHNESS);
}

/* Import all inputs into one mesh; *inputs receives their names and content hashes. */
static svo_result import_all(cli *c, uint32_t channels, const svo_allocator *a, const fmt_spill *spill, svo_pager *pager, svo_mesh *out, json_t *inputs, sources *read, svo_error *err)
{
    uint32_t count = (uint32_t)c->input_count, done = 0;
    svo_mesh *meshes = calloc(count, sizeof *meshes);
    if (meshes == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    svo_result r = SVO_OK;
    for (; r == SVO_OK && done < count; done++) {
        size_t first = read->count;
        fmt_import_options o = {.allocator = a, .threads = (uint32_t)c->threads, .without = unread(channels), .warnings = &c->warnings, .file_read = sources_add, .file_read_user = read,
                                .spill = spill != NULL ? fmt_spill_files(spill) : NULL, .memory = c->memory, .pager = pager};
        r = fmt_import_mesh(c->inputs[done], &o, &meshes[done], err);
        if (r == SVO_OK && read->failed) {
            svo_mesh_free(&meshes[done]);
            r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
        }
        if (r != SVO_OK) break;
        sources_settle(read);
        json_array_append_new(inputs, cli_provenance_input(c->inputs[done], read->list[first].hash));
    }
    if (r == SVO_OK && count == 1) {
        *out = meshes[0];
        done = 0;
    } else if (r == SVO_OK) {
        r = join_meshes(meshes, count, a, out, err);
    }
    for (uint32_t i = 0; i < done; i++) svo_mesh_free(&meshes[i]);
    free(meshes);
    return r;
}

static void report_input(cli *c, const svo_mesh *mesh)
{
    svo_mesh_counts n = svo_mesh_count(mesh);
    json_t *o = cli_section(c, "input");
    cli_put_u64(o, "files", (uint64_t)c->input_count);
    cli_put_u64(o, "vertices", n.vertices);
    cli_put_u64(o, "triangles", n.triangles);
    cli_put_u64(o, "placed_triangles", n.placed_triangles);
    cli_put_u64(o, "instances", mesh->instance_count);
    cli_put_u64(o, "materials", mesh->material_count);
    cli_put_u64(o, "images", mesh->image_count);
    cli_put_u64(o, "bytes", n.bytes);
    cli_put_u64(o, "spilled_triangles", n.spilled_triangles);
    cli_put_u64(o, "spilled_bytes", n.spilled_bytes);
    cli_put_u64(o, "paged_images", n.paged_images);
    cli_put_u64(o, "paged_bytes", n.paged_bytes);
}

/* Against dense samples of the surface. */
static void report_attributes(json_t *errors, const svo_tree_info *info, const svo_voxelize_report *v)
{
    if (v->reference_voxels == 0) return;
    json_t *o = json_object(), *channels = json_array();
    cli_put_u64(o, "voxels", v->reference_voxels);
    cli_put_u64(o, "samples_per_voxel", SVO_REFERENCE_POINTS);
    for (uint32_t i = 0; i < info->channel_count; i++) {
        const svo_channel_error *e = &v->attribute_errors[i];
        if (info->channels[i].constant) continue;
        json_t *channel = json_object();
        const uint32_t kind = info->channels[i].kind;
        cli_put_text(channel, "name", info->channels[i].name);
        cli_put_text(channel, "unit", kind == SVO_KIND_COLOR_SRGB8 ? "delta E (CIE94)" : kind == SVO_KIND_NORMAL_OCT32 ? "degrees" :
                                      kind == SVO_KIND_UNORM8 ? "of the range 0..1" : "share of voxels");
        cli_put_u64(channel, "voxels", e->voxels);
        cli_put_f64(channel, "mean", e->mean);
        cli_put_f64(channel, "max", e->max);
        json_array_append_new(channels, channel);
    }
    json_object_set_new(o, "channels", channels);
    json_object_set_new(errors, "attributes", o);
}

static void report_output(cli *c, const svo_tree_info *info, const svo_voxelize_report *v, uint64_t bytes)
{
    json_t *o = cli_section(c, "output"), *levels = json_array(), *channels = json_array();
    uint64_t nodes = 0, voxels = v->counts.nodes[info->depth];
    for (uint32_t l = 0; l <= info->depth; l++) {
        nodes += v->counts.nodes[l];
        json_t *level = json_object();
        cli_put_u64(level, "level", l);
        cli_put_u64(level, "nodes", v->counts.nodes[l]);
        json_array_append_new(levels, level);
    }
    for (uint32_t i = 0; i < info->channel_count; i++) {
        json_t *channel = json_object();
        cli_put_text(channel, "name", info->channels[i].name);
        json_object_set_new(channel, "constant", json_boolean(info->channels[i].constant));
        json_array_append_new(channels, channel);
    }
    cli_put_u64(o, "bytes", bytes);
    cli_put_u64(o, "depth", info->depth);
    cli_put_f64(o, "voxel_size", info->voxel_to_world[0]);
    cli_put_u64(o, "voxels", voxels);
    cli_put_u64(o, "nodes", nodes);
    cli_put_u64(o, "chunks", v->counts.chunks);
    cli_put_f64(o, "bytes_per_voxel", voxels != 0 ? (double)bytes / (double)voxels : 0);
    cli_put_u64(o, "masked_voxels", v->masked_voxels);
    json_object_set_new(o, "levels", levels);
    json_object_set_new(o, "attributes", channels);
    double seconds = v->seconds_setup + v->seconds_voxels;
    cli_put_f64(o, "voxels_per_second", seconds > 0 ? (double)voxels / seconds : 0);
    cli_put_u64(o, "working_memory_bytes", v->peak_bytes);
    if (info->fill == SVO_FILL_SOLID) {
        cli_put_u64(o, "full_leaves", v->counts.full_leaves);
        cli_put_u64(o, "values", v->counts.values);
        json_t *s = cli_section(c, "solid");
        cli_put_text(s, "inside_by", v->solid_triangles_open != 0 ? "generalised winding number" : v->solid_triangles_even != 0 ? "winding number, parity where it cannot be oriented" : "winding number");
        cli_put_u64(s, "triangles_oriented", v->solid_triangles_oriented);
        cli_put_u64(s, "triangles_even", v->solid_triangles_even);
        cli_put_u64(s, "triangles_open", v->solid_triangles_open);
        cli_put_u64(s, "triangles_turned", v->solid_triangles_turned);
        cli_put_u64(s, "boundary_edges", v->solid_boundary_edges);
        cli_put_u64(s, "points_asked", v->solid_asked);
        cli_put_u64(s, "points_ambiguous", v->solid_ambiguous);
        cli_put_f64(s, "ambiguous_share", v->solid_asked != 0 ? (double)v->solid_ambiguous / (double)v->solid_asked : 0);
        json_object_set_new(s, "in_temporary_files", json_boolean(v->solid_paged));
        cli_put_f64(s, "seconds_prepare", v->seconds_solid);
    }

    json_t *e = cli_section(c, "errors");
    cli_put_text(e, "unit", "voxel");
    cli_put_f64(e, "snap_mean", v->snap_mean);
    cli_put_f64(e, "snap_max", v->snap_max);
    cli_put_f64(e, "centre_to_surface_mean", v->distance_mean);
    cli_put_f64(e, "centre_to_surface_max", v->distance_max);
    cli_put_u64(e, "centre_to_surface_samples", v->distance_samples);
    report_attributes(e, info, v);
    cli_put_u64(e, "triangles_not_finite", v->skipped_not_finite);
    cli_put_u64(e, "triangles_degenerate", v->degenerate);
}

static void report_spill(cli *c, const fmt_spill *spill, const svo_voxelize_report *v)
{
    fmt_spill_counts n = fmt_spill_count(spill);
    json_t *o = cli_section(c, "temporary_files");
    cli_put_text(o, "folder", fmt_spill_folder(spill));
    json_object_set_new(o, "used", json_boolean(n.files != 0));
    cli_put_u64(o, "files", n.files);
    cli_put_u64(o, "files_at_a_time", n.files_peak);
    cli_put_u64(o, "bytes_peak", n.bytes_peak);
    cli_put_u64(o, "bytes_written", n.bytes_written);
    cli_put_u64(o, "bytes_read", n.bytes_read);
    cli_put_u64(o, "bins", v->spill_bins);
    cli_put_u64(o, "rounds", v->spill_rounds);
    cli_put_u64(o, "split_units", v->split_units);
}

/* What is decided before the first voxel. */
typedef struct job {
    svo_voxelize_options options;
    svo_tree_info info;
    char *provenance;
    fmt_spill *spill; /* NULL without --memory */
    uint8_t key[16]; /* of the whole job, not of a shard */
    svo_shard shard;
} job;

/* The provenance, and the key: a hash of it, of what else decides the bytes and of all files read. */
static svo_result identify(cli *c, const tool_options *o, json_t *inputs, const sources *read, job *j, svo_error *err)
{
    json_t *how = json_object();
    if (o->has_size) cli_put_f64(how, "voxel_size", o->voxel_size);
    else cli_put_u64(how, "depth", o->depth);
    cli_put_text(how, "surface", surfaces[o->surface]);
    cli_put_text(how, "fill", fills[o->fill]);
    cli_put_text(how, "attributes", o->attributes);
    cli_put_axes(how, &o->axes);
    j->provenance = cli_provenance(c, how, json_incref(inputs));
    char *what = j->provenance != NULL ? malloc(strlen(j->provenance) + 64) : NULL;
    if (what == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    sprintf(what, "%s\nformat 1.0 level %u disk %s", j->provenance, (unsigned)o->level, disks[o->disk]);
    svo_result r = sources_key(read, what, j->key, err);
    free(what);
    return r;
}

static svo_result print_key(const tool_options *o, const job *j, svo_error *err)
{
    uint8_t key[16], bytes[24];
    memcpy(key, j->key, 16);
    if (o->shard_count != 0) { /* the output of a shard is another one */
        memcpy(bytes, j->key, 16);
        fmt_store32(bytes + 16, o->shard_index);
        fmt_store32(bytes + 20, o->shard_count);
        sources none = {0};
        char what[2 * sizeof bytes + 1];
        for (size_t i = 0; i < sizeof bytes; i++) sprintf(what + 2 * i, "%02x", bytes[i]);
        SVO_TRY(sources_key(&none, what, key, err));
    }
    for (int i = 0; i < 16; i++) printf("%02x", key[i]);
    printf("\n");
    return SVO_OK;
}

static svo_result plan(cli *c, const tool_options *o, const svo_mesh *mesh, svo_limit_allocator *limit, job *j, svo_error *err)
{
    svo_voxelize_options *v = &j->options;
    *v = svo_default_voxelize_options();
    v->depth = (uint32_t)o->depth;
    v->voxel_size = o->has_size ? o->voxel_size : 0;
    v->surface = (svo_surface)o->surface;
    v->fill = (svo_fill)o->fill;
    v->channels = o->channels;
    v->threads = (uint32_t)c->threads;
    v->reference_voxels = c->report != NULL ? (uint32_t)o->reference : 0;
    v->allocator = &limit->base;
    v->warnings = &c->warnings;
    v->spill = j->spill != NULL ? fmt_spill_files(j->spill) : NULL;
    if (c->memory != 0) {
        uint64_t used = svo_limit_in_use(limit);
        if (used >= c->memory)
            return svo_fail(err, SVO_LIMIT, "the mesh alone takes %llu MB, more than --memory allows", (unsigned long long)(used / 1000000));
        v->memory = c->memory - used;
    }
    cli_phase(c, "plan");
    SVO_TRY(svo_voxelize_plan(mesh, v, &j->info, err));
    if (o->shard_count == 0) return SVO_OK;
    SVO_TRY(svo_shard_plan(mesh, v, &j->info, o->shard_index, o->shard_count, &j->shard, err));
    v->has_range = true;
    v->first_code = j->shard.first_code;
    v->end_code = j->shard.end_code;
    json_t *s = cli_section(c, "shard");
    cli_put_u64(s, "index", j->shard.index);
    cli_put_u64(s, "count", j->shard.count);
    cli_put_u64(s, "first_code", j->shard.first_code);
    cli_put_u64(s, "end_code", j->shard.end_code);
    cli_put_f64(s, "estimated_share", j->shard.share);
    return SVO_OK;
}

/* Before anything is written: what it will take (all that --dry-run does), and whether the disk has room for it. */
static svo_result estimate(cli *c, const tool_options *o, const svo_mesh *mesh, const job *j, svo_limit_allocator *limit, svo_error *err)
{
    estimate_input in = {.mesh = mesh, .options = &j->options, .info = &j->info, .spill = j->spill, .allocator = &limit->base, .level = (int)o->level,
                         .small = o->disk != 0, .seconds_before = svo_seconds() - c->started};
    if (!o->dry_run) return o->ignore_free_space ? SVO_OK : estimate_check_disk(c, &in, c->output, err);
    run_estimate e;
    SVO_TRY(estimate_run(c, &in, &e, err));
    estimate_print(c, &e, c->output, j->spill);
    return SVO_OK;
}

static svo_result write_tree(cli *c, const tool_options *o, const svo_mesh *mesh, const job *j, svo_limit_allocator *limit, svo_error *err)
{
    fmt_output *out = NULL;
    fmt_svo_writer *writer = NULL;
    svo_result r = fmt_output_open(c->output, c->force, &out, err);
    if (r == SVO_OK) r = fmt_svo_writer_begin(out, &j->info, j->provenance, (int)o->level, &limit->base, &writer, err);
    if (r == SVO_OK && o->disk != 0) r = fmt_svo_writer_small(writer, err);
    if (r == SVO_OK && o->shard_count != 0) {
        fmt_svo_shard shard = {j->shard.index, j->shard.count, j->shard.first_code, j->shard.end_code, {0}};
        memcpy(shard.job, j->key, sizeof shard.job);
        r = fmt_svo_writer_shard(writer, &shard, err);
    }
    svo_voxelize_report report = {0};
    if (r == SVO_OK) {
        cli_phase(c, "voxelize");
        cli_watch watch;
        svo_chunk_sink sink = cli_watch_sink(&watch, c, "voxelizing", fmt_svo_writer_sink(writer));
        r = svo_voxelize(mesh, &j->options, &j->info, &sink, &report, err);
    }
    if (r == SVO_OK && j->options.reference_voxels != 0) { /* it was the end of the phase */
        c->phase_started += report.seconds_reference;
        cli_phase(c, "reference");
        c->phase_started -= report.seconds_reference;
    }
    uint64_t bytes = 0;
    if (r == SVO_OK) {
        cli_phase(c, "write");
        r = fmt_svo_writer_end(writer, NULL, err);
        writer = NULL;
    }
    if (r == SVO_OK) {
        bytes = fmt_output_offset(out);
        r = fmt_output_commit(out, err);
        out = NULL;
    }
    fmt_svo_writer_discard(writer);
    fmt_output_discard(out);
    if (r != SVO_OK) return r;
    report_output(c, &j->info, &report, bytes);
    if (j->spill != NULL) report_spill(c, j->spill, &report);
    cli_verbose(c, "%llu voxels at depth %u, %llu bytes", (unsigned long long)report.counts.nodes[j->info.depth], j->info.depth, (unsigned long long)bytes);
    return SVO_OK;
}

static svo_result run(cli *c, const tool_options *o, svo_error *err)
{
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, c->memory != 0 ? c->memory : UINT64_MAX, NULL);
    svo_mesh mesh = {0};
    sources read = {0};
    job j = {0};
    json_t *inputs = json_array();
    if (c->memory != 0) {
        /* Blocks go back to the system when they are freed, and no thread keeps a heap of its own: what is charged is what is resident. */
        mallopt(M_MMAP_THRESHOLD, 1 << 17);
        mallopt(M_TRIM_THRESHOLD, 1 << 17);
        mallopt(M_ARENA_MAX, 1);
        fmt_spill_options s = {.folder = o->temp, .beside = c->output, .limit = o->temp_size};
        svo_result opened = fmt_spill_open(&s, &j.spill, err);
        if (opened != SVO_OK) {
            json_decref(inputs);
            return opened;
        }
        if (fmt_spill_in_memory(j.spill)) svo_warn(&c->warnings, "temporary files in %s would lie in memory (tmpfs); choose a disk with --temp", fmt_spill_folder(j.spill));
    }
    read.beside = c->threads != 1 && c->memory == 0; /* within --memory what has been hashed is given back at once */
    svo_pager *pager = NULL;
    svo_result r = SVO_OK;
    if (j.spill != NULL) r = svo_pager_create(fmt_spill_files(j.spill), c->memory / 8 < MOST_PAGES ? c->memory / 8 : MOST_PAGES, c->memory / 4, &limit.base, &pager, err);
    cli_phase(c, "import");
    if (r == SVO_OK) r = import_all(c, o->channels, &limit.base, j.spill, pager, &mesh, inputs, &read, err);
    if (r == SVO_OK) {
        cli_turn_mesh(&o->axes, &mesh);
        report_input(c, &mesh);
        r = identify(c, o, inputs, &read, &j, err);
        if (r == SVO_OK && o->key) {
            r = print_key(o, &j, err);
        } else {
            if (r == SVO_OK) r = plan(c, o, &mesh, &limit, &j, err);
            if (r == SVO_OK) r = estimate(c, o, &mesh, &j, &limit, err);
            if (r == SVO_OK && !o->dry_run) r = sources_check_depfile(&read, o->depfile, c->force, err);
            if (r == SVO_OK && !o->dry_run) r = write_tree(c, o, &mesh, &j, &limit, err);
            if (r == SVO_OK && !o->dry_run && o->depfile != NULL) r = sources_depfile(&read, o->depfile, c->output, c->force, err);
        }
        svo_mesh_free(&mesh);
    }
    svo_pager_free(pager);
    fmt_spill_close(j.spill);
    free(j.provenance);
    sources_free(&read);
    json_decref(inputs);
    cli_phase(c, NULL);
    if (r == SVO_OUT_OF_MEMORY && c->memory != 0) {
        char why[200];
        snprintf(why, sizeof why, "%.199s", err != NULL ? err->message : "");
        r = svo_fail(err, SVO_LIMIT, "--memory is too small: %s", why);
    }
    return r;
}

int main(int argc, char **argv)
{
    tool_options o = {.depth = 10, .attributes = "auto", .reference = 2048, .min_points = 1};
    cli_option options[] = {
        {.name = "depth", .letter = 'd', .kind = CLI_U64, .value = &o.depth, .argument = "D", .max = SVO_MAX_DEPTH, .seen = &o.has_depth, .no_default = true,
         .help = "The longest side of the bounding box becomes 2^D voxels."},
        {.name = "voxel-size", .kind = CLI_DOUBLE, .value = &o.voxel_size, .argument = "S", .min = 1e-90, .max = 1e90, .seen = &o.has_size, .no_default = true,
         .help = "Edge of a voxel, instead of --depth, in the mesh's units (in metres with --unit); the grid lies on multiples of S."},
        {.name = "up", .kind = CLI_CHOICE, .value = &o.axes.up, .choices = cli_axes_ups, .argument = "AXIS", .help = "The axis of the input that points up; it becomes +Y, by quarter turns."},
        {.name = "unit", .kind = CLI_TEXT, .value = &o.axes.unit, .argument = "U", .no_default = true,
         .help = "The input's unit of length, m km cm mm in ft or a number of metres: lengths become metres. Without it they stay as they are."},
        {.name = "fill", .kind = CLI_CHOICE, .value = &o.fill, .choices = fills, .argument = "HOW", .help = "Voxels of the surface, or of the inside too."},
        {.name = "surface", .kind = CLI_CHOICE, .value = &o.surface, .choices = surfaces, .argument = "HOW",
         .help = "conservative: every voxel that the surface touches; thin: those whose centre lines it crosses."},
        {.name = "attributes", .kind = CLI_TEXT, .value = &o.attributes, .argument = "LIST",
         .help = "auto: normals, and what the materials say; none; or a list of color,normal,emissive,metallic,roughness,material,coverage."},
        {.name = "level", .kind = CLI_U64, .value = &o.level, .argument = "L", .max = 19, .help = "0: values packed, fast; 1 to 19: everything through zstd at that level."},
        {.name = "reference", .kind = CLI_U64, .value = &o.reference, .argument = "N", .max = 1000000,
         .help = "With --report: voxels whose attributes are compared with 4096 samples each of the surface inside them."},
        {.name = "disk", .kind = CLI_CHOICE, .value = &o.disk, .choices = disks, .argument = "FORM",
         .help = "Form of the file: fast to read and write, or small (geometry about a third of the bytes, 10 times the time)."},
        {.name = "threshold", .kind = CLI_DOUBLE, .value = &o.threshold, .argument = "X", .seen = &o.has_threshold, .no_default = true,
         .help = "Of a volume: cells with at least this value are voxels; without it, those above 0."},
        {.name = "raw", .kind = CLI_TEXT, .value = &o.raw, .argument = "SPEC", .no_default = true,
         .help = "The input is samples without a header: WxHxD:TYPE[:big][:OFFSET], x fastest, TYPE i8 u8 i16 u16 i32 u32 i64 u64 f32 f64 rgba; --voxel-size is the edge of a cell."},
        {.name = "columns", .kind = CLI_TEXT, .value = &o.columns, .argument = "LIST", .no_default = true,
         .help = "Of points as text: what each column is, of x y z r g b nx ny nz i and -, such as x,y,z,-,r,g,b; guessed without it."},
        {.name = "min-points", .kind = CLI_U64, .value = &o.min_points, .argument = "N", .min = 1, .max = 4294967295.0, .seen = &o.has_min_points,
         .help = "Of points: how many a cell must hold to become a voxel."},
        {.name = "shard", .kind = CLI_TEXT, .value = &o.shard, .argument = "i/N", .no_default = true,
         .help = "Make only part i of N (1..N) of the octree, to be joined by svo-merge; auto takes i and N from a Slurm job array."},
        {.name = "temp", .kind = CLI_TEXT, .value = &o.temp, .argument = "DIR", .no_default = true,
         .help = "With --memory: folder for temporary files; by default TMPDIR if it is set, else that of the output."},
        {.name = "temp-size", .kind = CLI_SIZE, .value = &o.temp_size, .argument = "SIZE",
         .help = "Most that temporary files may take; 0 is no limit but the disk's."},
        {.name = "dry-run", .kind = CLI_FLAG, .value = &o.dry_run,
         .help = "Print what the run will take (voxels, bytes, memory, temporary files, seconds), from a trial at a coarse depth, and make nothing."},
        {.name = "ignore-free-space", .kind = CLI_FLAG, .value = &o.ignore_free_space,
         .help = "Begin also where the output is not expected to fit on its disk."},
        {.name = "depfile", .kind = CLI_TEXT, .value = &o.depfile, .argument = "FILE", .no_default = true,
         .help = "Write a rule for Make or Ninja that names every file read."},
        {.name = "depfile-beside", .letter = 'M', .kind = CLI_CHOICE, .value = &o.beside, .choices = beside, .argument = "D", .seen = &o.has_beside, .no_default = true,
         .help = "-MD: write that rule into OUT.d, that is beside the output, with .d after its name."},
        {.name = "key", .kind = CLI_FLAG, .value = &o.key,
         .help = "Print a hash of all that decides the output (inputs, options, version) and make nothing."},
    };
    cli_tool tool = {
        .name = "svo-voxelize",
        .summary = "Turn meshes into a sparse voxel octree with attributes.",
        .synopsis = "IN... -o OUT.svo (--depth D | --voxel-size S) [options]",
        .options = options,
        .option_count = sizeof options / sizeof *options,
        .details = "Reads .gltf .glb .obj .ply .stl .off .drc; several inputs are placed together in one grid. Vertices are snapped to 1/128 voxel, "
                   "then the voxels are exactly those that the triangles meet. Voxels of .vox, binvox and NRRD files (one alone) are taken as they are. "
                   "Points (PLY without faces, .xyz, .pts) make every cell that holds one a voxel, with the mean of their colours, normals and intensities.",
        .example = "svo-voxelize model.glb -o model.svo --depth 10\nsvo-voxelize a.obj b.obj -o both.svo --voxel-size 0.01 --attributes none",
        .min_inputs = 1,
        .max_inputs = -1,
        .has_output = true,
        .output_optional = true,
    };
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    if (c.output == NULL && !o.key && !o.dry_run) return cli_usage(&c, "no output given (-o OUT)");
    char why[200];
    if (o.shard != NULL && !parse_shard(o.shard, &o.shard_index, &o.shard_count, why, sizeof why)) return cli_usage(&c, "--shard: %s", why);
    if (!o.key && !o.dry_run && (code = cli_take_depfile(&c, o.has_beside, &o.depfile)) >= 0) return code;
    if ((code = cli_take_axes(&c, &o.axes)) >= 0) return code;
    svo_error err = {0};
    if (o.temp != NULL && !o.key) { /* a folder that could not be used is refused also where nothing would be put there */
        fmt_spill_options s = {.folder = o.temp, .beside = c.output};
        fmt_spill *spill;
        svo_result usable = fmt_spill_open(&s, &spill, &err);
        if (usable != SVO_OK) return cli_end(&c, usable, &err);
        fmt_spill_close(spill);
    }
    if (o.raw != NULL || voxelize_is_cells(c.inputs[0])) {
        if (cli_axes_given(&o.axes)) return cli_usage(&c, "--up and --unit are for meshes and points; the format of voxels says both");
        if (c.input_count != 1 || (o.has_size && o.raw == NULL) || o.fill != 0 || o.surface != 0 || o.shard != NULL || o.dry_run)
            return cli_usage(&c, "a file of voxels is taken alone and as it is, without --voxel-size, --fill, --surface, --shard and --dry-run");
        cells_options cells = {.depth = (uint32_t)o.depth, .temp_size = o.temp_size, .has_depth = o.has_depth, .raw = o.raw, .raw_size = o.has_size ? o.voxel_size : 0, .small = o.disk != 0, .key = o.key, .threshold = o.has_threshold ? &o.threshold : NULL,
                               .attributes = o.attributes, .depfile = o.depfile, .level = (int)o.level};
        svo_result taken = voxelize_cells(&c, &cells, &err);
        return cli_end(&c, taken, &err);
    }
    if (o.has_threshold) return cli_usage(&c, "--threshold is for volumes");
    if (o.has_depth == o.has_size) return cli_usage(&c, o.has_depth ? "--depth and --voxel-size exclude each other" : "one of --depth and --voxel-size is needed");
    const int points = voxelize_are_points(&c);
    if (points < 0) return cli_usage(&c, "points and meshes are not voxelized together; svo-pack places the results in one scene");
    if (points > 0) {
        if (o.fill != 0 || o.surface != 0 || o.shard != NULL || o.dry_run)
            return cli_usage(&c, "points have no surface: they are taken without --fill, --surface, --shard and --dry-run");
        points_options p = {.depth = (uint32_t)o.depth, .voxel_size = o.has_size ? o.voxel_size : 0, .least = o.min_points, .small = o.disk != 0, .key = o.key, .attributes = o.attributes,
                            .columns = o.columns, .axes = &o.axes, .depfile = o.depfile, .temp = o.temp, .temp_size = o.temp_size, .level = (int)o.level};
        svo_result taken = voxelize_points(&c, &p, &err);
        return cli_end(&c, taken, &err);
    }
    if (o.columns != NULL || o.has_min_points) return cli_usage(&c, "--columns and --min-points are for points");
    if (strstr(o.attributes, "bone") != NULL)
        return cli_usage(&c, "a bone channel is made by svo-skeleton --bind");
    if ((code = cli_take_channels(&c, o.attributes, &o.channels)) >= 0) return code;
    for (int i = 0; i < c.input_count; i++)
        if (strcmp(c.inputs[i], "-") == 0) return cli_usage(&c, "meshes are read from files, not from stdin");
    svo_result r = run(&c, &o, &err);
    return cli_end(&c, r, &err);
}
