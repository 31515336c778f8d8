/* svo-compress: .svo -> .svdag. */
#include <malloc.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "cli_quality.h"
#include "fmt_spill.h"
#include "fmt_svdag.h"
#include "fmt_svo.h"
#include "svo_algorithm1.h"
#include "svo_dag.h"

enum { GEOMETRY_FAST = 1, PROGRAM = 6 << 20 /* bytes that the program and its libraries take beyond what is charged without being touched */ };
static const char *const geometry_names[] = {"svdag", "fast", "symmetric", "best", NULL};
static const svo_geometry geometries[] = {SVO_GEOMETRY_SVDAG, SVO_GEOMETRY_FAST, SVO_GEOMETRY_SYMMETRIC, SVO_GEOMETRY_BEST};
enum { LOD_ALL, LOD_STORED, LOD_NONE };
enum { PALETTES_BLOCKS = 0, PALETTES_ALGORITHM1 = 1 };
static const char *const palette_names[] = {"blocks", "algorithm1", NULL};
static const char *const lod_names[] = {"all", "stored", "none", NULL};

typedef struct arguments {
    int geometry, lod, palettes;
    const char *color, *normal, *temp;
} arguments;

typedef struct run {
    cli *c;
    const arguments *args;
    svo_dag_options options;
    svo_packed *packed;
    svo_dag_report report;
    char *provenance;
    uint64_t bytes_in, bytes_out;
    fmt_spill *spill;
} run;

static void enter_phase(void *user, const char *name) { cli_phase(user, name); }

/* META: what made this, from what, and how that was made. */
static svo_result make_provenance(run *r, const fmt_svo_reader *reader, svo_error *err)
{
    uint8_t hash[16];
    char hex[33];
    fmt_svo_reader_content_hash(reader, hash);
    fmt_hash_text(hash, hex);
    json_t *input = cli_provenance_input(r->c->inputs[0], hex), *inputs = json_array();
    json_t *source = json_loads(fmt_svo_reader_provenance(reader), 0, NULL);
    if (source != NULL) json_object_set_new(input, "provenance", source);
    json_array_append_new(inputs, input);
    json_t *how = cli_options_json(r->c, false);
    json_object_del(how, "temp"); /* a place, not a choice */
    r->provenance = cli_provenance(r->c, how, inputs);
    return r->provenance != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
}

static svo_result read_and_build(run *r, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *reader = NULL;
    SVO_TRY(fmt_input_open(r->c->inputs[0], &in, err));
    svo_result result = fmt_svo_reader_open(in, r->options.allocator, &reader, err);
    if (result == SVO_OK) {
        struct stat st;
        cli_watch watch;
        uint64_t bytes = strcmp(r->c->inputs[0], "-") != 0 && stat(r->c->inputs[0], &st) == 0 && S_ISREG(st.st_mode) ? (uint64_t)st.st_size : 0;
        svo_chunk_source source = cli_watch_source(&watch, r->c, "packing", bytes, fmt_svo_reader_source(reader));
        result = svo_dag_build(fmt_svo_reader_info(reader), &source, &r->options, &r->packed, &r->report, err);
    }
    if (result == SVO_OK && fmt_svo_reader_shard(reader) != NULL) {
        const fmt_svo_shard *s = fmt_svo_reader_shard(reader);
        svo_warn(&r->c->warnings, "%s is shard %u of %u: only its part of the octree is packed (svo-merge joins them)", r->c->inputs[0], s->index, s->count);
    }
    if (result == SVO_OK) result = make_provenance(r, reader, err);
    r->bytes_in = fmt_input_offset(in);
    fmt_svo_reader_close(reader);
    fmt_input_close(in);
    return cli_about(r->c->inputs[0], result, err);
}

/* --- report ------------------------------------------------------------------------------------------------------ */

static void add_section(json_t *sections, const char *type, int64_t number, const char *channel, uint64_t bytes)
{
    json_t *s = json_object();
    cli_put_text(s, "type", type);
    if (channel != NULL) cli_put_text(s, "channel", channel);
    else if (number >= 0) cli_put_u64(s, "level", (uint64_t)number);
    cli_put_u64(s, "bytes", bytes);
    json_array_append_new(sections, s);
}

static json_t *sections(const svo_view *v)
{
    json_t *all = json_array();
    svo_view_section parts[SVO_VIEW_SECTIONS];
    uint32_t count = svo_view_sections(v, parts);
    for (uint32_t i = 0; i < count; i++)
        add_section(all, parts[i].type, parts[i].level <= SVO_MAX_DEPTH ? (int64_t)parts[i].level : -1, NULL, parts[i].bytes);
    for (uint32_t i = 0; i < v->channel_count; i++) {
        const svo_view_channel *c = &v->channels[i];
        uint32_t stride = svo_channel_stride(c->channel.kind);
        if (c->encoding == SVO_ENCODING_RAW) add_section(all, "ARAW", -1, c->channel.name, v->attribute_count * stride);
        if (c->encoding != SVO_ENCODING_BLOCKS && c->encoding != SVO_ENCODING_LONG_BLOCKS) continue;
        add_section(all, "ATBL", -1, c->channel.name, c->table_count * stride);
        add_section(all, "ADIR", -1, c->channel.name, (c->encoding == SVO_ENCODING_BLOCKS ? SVO_PALETTE_ENTRY : SVO_ALGORITHM1_ENTRY) * svo_view_directory_elements(v, c));
        add_section(all, "APAY", -1, c->channel.name, c->payload_size);
        if (c->correction_count != 0) add_section(all, "ACOR", -1, c->channel.name, SVO_CORRECTION * c->correction_count);
    }
    return all;
}

static void report_errors(run *r, const svo_view *v)
{
    json_t *errors = cli_section(r->c, "errors");
    for (uint32_t i = 0; i < v->channel_count; i++) {
        const svo_dag_channel_report *ch = &r->report.channels[i];
        const char *unit = v->channels[i].channel.kind == SVO_KIND_COLOR_SRGB8     ? "delta E CIE94"
                           : v->channels[i].channel.kind == SVO_KIND_NORMAL_OCT32 ? "degrees"
                                                                                   : "value";
        json_t *e = json_object();
        cli_put_text(e, "unit", unit);
        cli_put_f64(e, "mean", ch->error_mean);
        cli_put_f64(e, "max", ch->error_max);
        json_object_set_new(errors, ch->name, e);
    }
}

/* What is not in the file: the plain values it would have taken, of table entries the bytes as they would have been stored. */
static json_t *left_out(const run *r, const svo_view *v, uint64_t nodes)
{
    json_t *all = json_array();
    for (uint32_t i = 0; i < v->channel_count; i++) {
        const svo_dag_channel_report *c = &r->report.channels[i];
        const uint32_t stride = svo_channel_stride(v->channels[i].channel.kind);
        if (c->left_out) {
            cli_put_saving(all, "channel that is the same everywhere", c->name, v->attribute_count, v->attribute_count * stride);
            continue;
        }
        const uint64_t stored = v->attribute_count + c->corrections, inner = nodes > stored ? nodes - stored : 0;
        cli_put_saving(all, v->lod ? "attributes of inner nodes that are averages or in full leaves" : "attributes of inner nodes", c->name, inner, inner * stride);
        cli_put_saving(all, "table entries that nothing names", c->name, c->unused_entries, c->unused_bytes);
        cli_put_saving(all, "superblocks of 1024 values that repeat the value before them", c->name, c->repeated_superblocks, c->repeated_bytes);
    }
    return all;
}

static void report(run *r, double seconds)
{
    const svo_view *v = svo_packed_view(r->packed);
    uint64_t nodes = 0, voxels = v->nodes[v->depth], plain = 0;
    json_t *in = cli_section(r->c, "input"), *out = cli_section(r->c, "output"), *levels = json_array(), *channels = json_array();
    for (uint32_t l = 0; l <= v->depth; l++) {
        json_t *level = json_object();
        nodes += v->nodes[l];
        cli_put_u64(level, "level", l);
        cli_put_u64(level, "nodes", v->nodes[l]);
        /* virtual levels above a tree of depth < 2 are left away; below the bricks nothing is shared for itself */
        if (v->depth >= 2 && l <= v->brick_level) cli_put_u64(level, "unique", r->report.unique[l]);
        json_array_append_new(levels, level);
        if (l < v->depth) plain += v->nodes[l];
    }
    for (uint32_t i = 0; i < v->channel_count; i++) {
        const svo_dag_channel_report *ch = &r->report.channels[i];
        static const char *const encodings[] = {"constant", "raw", "blocks", "long blocks"};
        json_t *o = json_object();
        cli_put_text(o, "name", ch->name);
        cli_put_text(o, "encoding", encodings[v->channels[i].encoding]);
        cli_put_u64(o, "bytes", ch->bytes);
        cli_put_u64(o, "distinct_in", ch->distinct_in);
        cli_put_u64(o, "distinct_out", ch->distinct_out);
        cli_put_u64(o, "corrections", ch->corrections);
        json_array_append_new(channels, o);
        if (!ch->left_out) plain += (v->lod ? nodes : v->attribute_count) * svo_channel_stride(v->channels[i].channel.kind);
    }
    cli_put_u64(in, "bytes", r->bytes_in);
    cli_put_u64(in, "chunks", r->report.counts.chunks);
    cli_put_u64(in, "depth", v->depth);
    cli_put_u64(in, "nodes", nodes);
    cli_put_u64(in, "voxels", voxels);
    cli_put_u64(out, "bytes", r->bytes_out);
    cli_put_u64(out, "geometry_bytes", r->report.geometry_bytes);
    cli_put_u64(out, "attribute_bytes", r->report.attribute_bytes);
    cli_put_u64(out, "attributes", v->attribute_count);
    cli_put_f64(out, "bytes_per_voxel", voxels != 0 ? (double)r->bytes_out / (double)voxels : NAN);
    cli_put_f64(out, "bytes_per_node", nodes != 0 ? (double)r->bytes_out / (double)nodes : NAN);
    cli_put_u64(out, "plain_svo_bytes", plain);
    cli_put_f64(out, "ratio_to_plain_svo", plain != 0 ? (double)r->bytes_out / (double)plain : NAN);
    json_object_set_new(out, "levels", levels);
    json_object_set_new(out, "sections", sections(v));
    json_object_set_new(out, "channels", channels);
    json_object_set_new(out, "left_out", left_out(r, v, nodes));
    report_errors(r, v);
    cli_put_f64(cli_section(r->c, "speed"), "nodes_per_second", seconds > 0 ? (double)nodes / seconds : NAN);
    cli_put_u64(cli_section(r->c, "memory"), "peak_bytes", r->report.peak_bytes);
    cli_put_u64(cli_section(r->c, "memory"), "temporary_bytes", fmt_spill_count(r->spill).bytes_peak);
    cli_info(r->c, "%llu voxels, %llu nodes -> %llu bytes (geometry %llu, attributes %llu): %.3f bytes a voxel, %.3f a node, %.2fx plain SVO",
             (unsigned long long)voxels, (unsigned long long)nodes, (unsigned long long)r->bytes_out,
             (unsigned long long)r->report.geometry_bytes, (unsigned long long)r->report.attribute_bytes,
             voxels != 0 ? (double)r->bytes_out / (double)voxels : 0, nodes != 0 ? (double)r->bytes_out / (double)nodes : 0,
             plain != 0 ? (double)r->bytes_out / (double)plain : 0);
    for (uint32_t i = 0; i < v->channel_count; i++)
        if (r->report.channels[i].error_max > 0)
            cli_info(r->c, "%s: error mean %.3f, max %.3f %s", r->report.channels[i].name, r->report.channels[i].error_mean,
                     r->report.channels[i].error_max, v->channels[i].channel.kind == SVO_KIND_COLOR_SRGB8 ? "delta E (CIE94)" : "degrees");
}

static svo_result compress(run *r, svo_error *err)
{
    fmt_output *out;
    double started = svo_seconds();
    cli_phase(r->c, "open");
    SVO_TRY(fmt_output_open(r->c->output, r->c->force, &out, err));
    cli_phase(r->c, "read"); /* and average, and merge: chunk by chunk */
    fmt_spill_options spill = {.folder = r->args->temp, .beside = r->c->output};
    svo_result result = fmt_spill_open(&spill, &r->spill, err);
    if (result == SVO_OK) {
        r->options.spill = fmt_spill_files(r->spill);
        result = read_and_build(r, err);
    }
    cli_phase(r->c, "write");
    if (result == SVO_OK) result = fmt_svdag_write(out, svo_packed_view(r->packed), r->provenance, err);
    r->bytes_out = fmt_output_offset(out);
    if (result != SVO_OK) {
        fmt_output_discard(out);
        return result;
    }
    SVO_TRY(fmt_output_commit(out, err));
    cli_phase(r->c, NULL);
    report(r, svo_seconds() - started);
    return SVO_OK;
}

int main(int argc, char **argv)
{
    arguments args = {.geometry = GEOMETRY_FAST, .lod = 0, .color = "lossless", .normal = "lossless"};
    const cli_option options[] = {
        {.name = "geometry", .kind = CLI_CHOICE, .value = &args.geometry, .argument = "MODE", .choices = geometry_names,
         .help = "How geometry is packed: svdag merges equal subtrees; symmetric mirror images as well; fast and best what is equal under the 48 symmetries of the cube. "
                 "fast takes about a fifth of the bytes of svdag and is read about as fast, best and symmetric take the fewest bytes."},
        {.name = "color", .kind = CLI_TEXT, .value = &args.color, .argument = "lossless|BITS|deltaE=X|mean=X|psnr=X",
         .help = "Colours: as they are; at most 2^BITS (1 to 16) different ones; every one within X in CIE94; or few bytes at a mean CIE94 or a PSNR (with deltaE=X after a comma: every one within it)."},
        {.name = "normal", .kind = CLI_TEXT, .value = &args.normal, .argument = "lossless|BITS|deg=X",
         .help = "Normals: as they are, BITS in all (4 to 32, even), or every one within X degrees."},
        {.name = "palettes", .kind = CLI_CHOICE, .value = &args.palettes, .argument = "MODE", .choices = palette_names,
         .help = "How values that vary are coded: blocks, each by what is cheapest for it, or the palettes of Algorithm 1 of Dado et al. 2016, to compare with (not within bounds; "
                 "channels with too many different values for a table stay as they are)."},
        {.name = "lod", .kind = CLI_CHOICE, .value = &args.lod, .argument = "all|stored|none", .choices = lod_names,
         .help = "Attributes of inner nodes: averages of what is below, or none. all: those of nodes of 2x2x2 and 4x4x4 voxels are worked out when they are asked for; stored: all are in the file, which is larger and a little faster to read."},
        {.name = "temp", .kind = CLI_TEXT, .value = &args.temp, .argument = "FOLDER", .no_default = true,
         .help = "Where temporary files go; without it TMPDIR, else the folder of the output."},
    };
    const cli_tool tool = {
        .name = "svo-compress", .summary = "Pack a sparse voxel octree so that it can be traversed in place.",
        .synopsis = "IN.svo -o OUT.svdag [--geometry svdag|symmetric|fast|best] [--color lossless|BITS|deltaE=X] [--normal lossless|BITS|deg=X] [--lod all|stored|none]",
        .options = options, .option_count = sizeof options / sizeof options[0],
        .details = "IN may be - for stdin, OUT may be - for stdout. Errors are measured over all attributes, inner nodes included, and go to the report.",
        .example = "svo-compress model.svo -o model.svdag --color 12 --normal deg=2 --report model.json",
        .min_inputs = 1, .max_inputs = 1, .has_output = true};
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    run r = {.c = &c, .args = &args, .options = svo_default_dag_options()};
    if ((code = cli_take_quality(&c, args.color, args.normal, &r.options)) >= 0) return code;
    r.options.lod = args.lod != LOD_NONE;
    r.options.averaged = args.lod == LOD_ALL;
    r.options.algorithm1 = args.palettes == PALETTES_ALGORITHM1;
    if (r.options.algorithm1 && (r.options.color_delta_e > 0 || r.options.normal_degrees > 0))
        return cli_usage(&c, "--palettes algorithm1 keeps no bounds: give --color and --normal as lossless or a number of bits");
    r.options.geometry = geometries[args.geometry];
    r.options.threads = (uint32_t)c.threads;
    if (c.memory != 0) {
        /* Blocks go back to the system when they are freed, and no thread keeps a heap of its own: what is charged is what is resident. */
        mallopt(M_MMAP_THRESHOLD, 1 << 16);
        mallopt(M_TRIM_THRESHOLD, 1 << 17);
        mallopt(M_ARENA_MAX, 1);
        r.options.memory = c.memory > 2 * PROGRAM ? c.memory - PROGRAM : c.memory / 2;
    }
    r.options.warnings = &c.warnings;
    r.options.phase = enter_phase;
    r.options.phase_user = &c;
    svo_error err = {0};
    svo_result result = compress(&r, &err);
    if (result == SVO_LIMIT && c.memory != 0) { /* the message has what is left for the work */
        const svo_error why = err;
        svo_fail(&err, result, "%s; --memory is %llu, the rest is for the program itself", why.message, (unsigned long long)c.memory);
    }
    svo_packed_free(r.packed);
    fmt_spill_close(r.spill);
    free(r.provenance);
    return cli_end(&c, result, &err);
}
