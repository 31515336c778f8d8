/* svo-pack: a scene description, a glTF scene or a single asset to a packed, instanced scene. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "cli_quality.h"
#include "cli_sources.h"
#include "fmt_scene.h"
#include "fmt_scene_build.h"

typedef struct pack_options {
    uint64_t depth, page, budget;
    double voxel_size, view_distance;
    const char *color, *normal, *attributes, *animation;
    double time;
    int surface, fill, lod, skins;
    bool has_depth, has_size, has_distance, has_budget, has_animation, has_time, has_beside;
    const char *depfile;
    int beside;
} pack_options;

/* --view-distance: a voxel is at most a pixel of a picture of this height and field of view. */
#define VIEW_PIXELS 1080
#define VIEW_FOV 0.6981317007977318 /* 40 degrees, svo-render's own */

static const char *const surfaces[] = {"conservative", "thin", NULL};
static const char *const fills[] = {"surface", "solid", NULL};
static const char *const skins[] = {"pose", "bake", NULL};
static const char *const beside[] = {"D", NULL}; /* -MD */
static const char *const lods[] = {"all", "stored", "none", NULL};

static void next_phase(void *user, const char *name) { cli_phase(user, name); }

static void assets_done(void *user, uint64_t done, uint64_t total)
{
    cli *c = user;
    cli_progress_steps(c, strcmp(c->phase, "read") == 0 ? "reading assets" : "building assets", done, total, (double)done / (double)total);
}

/* The inputs for META: the scene itself and every file that was read for it. */
static json_t *inputs_of(const cli *c, const fmt_scene_build *b)
{
    json_t *inputs = json_array();
    uint32_t count;
    const fmt_scene_build_asset *assets = fmt_scene_build_assets(b, &count);
    json_array_append_new(inputs, cli_provenance_input(c->inputs[0], fmt_scene_build_hash(b)));
    for (uint32_t i = 0; i < count; i++)
        if (assets[i].hash[0] != 0 && strcmp(assets[i].hash, fmt_scene_build_hash(b)) != 0)
            json_array_append_new(inputs, cli_provenance_input(assets[i].file, assets[i].hash));
    return inputs;
}

static json_t *left_out(json_t *list, const char *what, uint64_t count, const char *unit, uint64_t bytes)
{
    json_t *o = json_object();
    cli_put_text(o, "what", what);
    cli_put_u64(o, unit, count);
    cli_put_u64(o, "bytes", bytes);
    json_array_append_new(list, o);
    return o;
}

/* What channels of one value would take with a value for every node that has attributes. */
static void report_constants(json_t *list, const svo_scene *s)
{
    uint64_t channels = 0, bytes = 0;
    for (uint32_t i = 0; i < s->asset_count; i++) {
        const svo_view *v = s->assets[i];
        uint64_t values = v->nodes[v->depth];
        for (uint32_t l = 0; v->lod && l < v->depth; l++) values += v->nodes[l];
        for (uint32_t c = 0; c < v->channel_count; c++)
            if (v->channels[c].encoding == SVO_ENCODING_CONSTANT) channels++, bytes += values * svo_channel_stride(v->channels[c].channel.kind);
    }
    if (channels != 0) cli_put_text(left_out(list, "channels without variation: one value is stored", channels, "channels", bytes), "bytes_of", "raw values");
}

static bool kept_mesh(const fmt_scene_build_asset *a) { return a->source != NULL && strcmp(a->source, "mesh") == 0 && a->packed.fate == SVO_PACK_KEPT; }

/* Headers, tables and alignment of a .svdag with colours and normals, which do not grow with levels, and by how much the rest grows: for 11 models at depths
 * 1 to 9 the estimate is 1.04 of the truth in the median, and 0.42 to 2.4 in four of five cases. */
#define FIXED_BYTES 1280
#define LEVEL_GROWTH 3.4

/* Meshes that are small in the scene have fewer levels than the largest. */
static void report_levels(json_t *list, const fmt_scene_build_asset *assets, uint32_t count, const uint64_t *bytes)
{
    uint32_t deepest = 0;
    uint64_t levels = 0;
    double saved = 0;
    for (uint32_t i = 0; i < count; i++)
        if (kept_mesh(&assets[i]) && assets[i].depth > deepest) deepest = assets[i].depth;
    for (uint32_t i = 0; i < count; i++) {
        if (!kept_mesh(&assets[i]) || assets[i].depth == deepest) continue;
        uint32_t fewer = deepest - assets[i].depth;
        double growth = 1;
        for (uint32_t l = 0; l < fewer; l++) growth *= LEVEL_GROWTH;
        levels += fewer;
        saved += fmax((double)bytes[assets[i].packed.packed] - FIXED_BYTES, 64) * (growth - 1);
    }
    if (levels != 0)
        cli_put_text(left_out(list, "levels of meshes that are small in the scene, below what the largest shows", levels, "levels", (uint64_t)saved), "bytes_of",
                     "estimate: 3.4 times as much a level, but for headers");
}

#define INSTANCE_BYTES 60 /* in the file, without a name */

static void report_left_out(json_t *list, const fmt_scene_build *b, const fmt_scene_build_asset *assets, uint32_t count, const uint64_t *bytes)
{
    const svo_pack_report *r = fmt_scene_build_report(b);
    uint64_t bones_left = 0;
    for (uint32_t i = 0; i < count; i++) {
        const fmt_scene_build_asset *a = &assets[i];
        json_t *o = NULL;
        bones_left += a->bones_left_out;
        if (a->packed.fate == SVO_PACK_UNUSED) o = left_out(list, "asset that no visible instance names", 1, "assets", a->source_bytes);
        if (a->packed.fate == SVO_PACK_EMPTY) o = left_out(list, "asset without voxels", 1, "assets", a->source_bytes);
        if (a->packed.fate == SVO_PACK_EQUAL) o = left_out(list, "asset equal to another one", 1, "assets", bytes[a->packed.packed]);
        if (o == NULL) continue;
        cli_put_text(o, "name", a->name);
        cli_put_text(o, "file", a->file);
        /* What is not built has no packed size: then it is that of the source file, 0 where the file holds other things too. */
        cli_put_text(o, "bytes_of", a->packed.fate == SVO_PACK_EQUAL ? "packed asset" : "source file");
    }
    const struct { const char *what; uint64_t count; } dropped[] = {{"instances of assets without voxels", r->dropped_empty},
                                                                    {"instances hidden by a scale of 0", r->dropped_hidden},
                                                                    {"instances with a singular transform", r->dropped_flat}};
    for (int i = 0; i < 3; i++)
        if (dropped[i].count != 0) left_out(list, dropped[i].what, dropped[i].count, "instances", dropped[i].count * INSTANCE_BYTES);
    const struct { const char *what; uint64_t count; const char *unit; uint64_t bytes; } poses[] = {
        {"poses that move nothing", r->poses_rest, "poses", r->poses_rest * sizeof(svo_pose)},
        {"poses equal to another one", r->poses_shared, "poses", r->poses_shared * sizeof(svo_pose)},
        {"bones that no pose moves, at the end of a pose's list", r->bones_rest, "matrices", r->bones_rest * 48},
        {"bones that no pose moves or no vertex follows", bones_left, "matrices", bones_left * 48},
        {"matrices of poses equal to others", r->matrices_shared, "matrices", r->matrices_shared * 48},
        {"channels bone of assets whose instances' poses have no bones", r->bone_channels, "channels", r->bone_channel_bytes}};
    for (size_t i = 0; i < sizeof poses / sizeof poses[0]; i++)
        if (poses[i].count != 0) left_out(list, poses[i].what, poses[i].count, poses[i].unit, poses[i].bytes);
    const svo_scene *s = fmt_scene_build_scene(b);
    report_constants(list, s);
    report_levels(list, assets, count, bytes);
    if (s->instance_name == NULL && s->instance_count != 0) left_out(list, "names of instances: none has one", s->instance_count, "instances", s->instance_count * 4);
}

/* The one of a list that says so; a new one where there is none. */
static json_t *find_what(json_t *list, const char *what)
{
    json_t *o;
    size_t i;
    json_array_foreach(list, i, o)
        if (strcmp(json_string_value(json_object_get(o, "what")), what) == 0) return o;
    o = json_object();
    cli_put_text(o, "what", what);
    json_array_append_new(list, o);
    return o;
}

/* Entries of report_left_out by what they are, without the names of assets: what, count and bytes_saved. New reference. */
static json_t *sum_up(const json_t *list)
{
    json_t *out = json_array();
    const json_t *entry, *value;
    const char *key;
    size_t i;
    json_array_foreach(list, i, entry) {
        json_t *to = find_what(out, json_string_value(json_object_get(entry, "what")));
        uint64_t count = 0;
        json_object_foreach((json_t *)(uintptr_t)entry, key, value)
            if (json_is_integer(value) && strcmp(key, "bytes") != 0) count = (uint64_t)json_integer_value(value); /* the other number */
        cli_put_u64(to, "count", (uint64_t)json_integer_value(json_object_get(to, "count")) + count);
        cli_put_u64(to, "bytes_saved", (uint64_t)json_integer_value(json_object_get(to, "bytes_saved")) + (uint64_t)json_integer_value(json_object_get(entry, "bytes")));
    }
    return out;
}

typedef struct telling { const cli *c; const fmt_scene_build *b; } telling;

/* The text for META: a fmt_scene_tell_fn. */
static char *tell_provenance(void *user, const uint64_t *asset_bytes)
{
    const telling *t = user;
    uint32_t count;
    const fmt_scene_build_asset *assets = fmt_scene_build_assets(t->b, &count);
    json_t *options = cli_options_json(t->c, false), *list = json_array();
    json_object_del(options, "depfile"), json_object_del(options, "depfile-beside"); /* the same bytes with and without */
    report_left_out(list, t->b, assets, count, asset_bytes);
    json_t *sums = sum_up(list);
    json_decref(list);
    return cli_provenance_with(t->c, options, inputs_of(t->c, t->b), sums);
}

static void report_scene(cli *c, const fmt_scene_build *b, const fmt_scene_bytes *bytes, const uint64_t *asset_bytes, uint64_t total)
{
    const svo_scene *s = fmt_scene_build_scene(b);
    const svo_pack_report *r = fmt_scene_build_report(b);
    uint32_t count;
    const fmt_scene_build_asset *assets = fmt_scene_build_assets(b, &count);
    json_t *input = cli_section(c, "input"), *output = cli_section(c, "output"), *parts = json_object(), *list = json_array(), *out = json_array();
    cli_put_text(input, "file", c->inputs[0]);
    cli_put_text(input, "hash", fmt_scene_build_hash(b));
    cli_put_u64(input, "assets", count);
    cli_put_u64(input, "instances", r->kept + r->dropped_empty + r->dropped_hidden + r->dropped_flat);
    cli_put_u64(output, "bytes", total);
    cli_put_u64(output, "assets", s->asset_count);
    cli_put_u64(output, "instances", s->instance_count);
    cli_put_u64(output, "pages", s->page_count);
    cli_put_u64(output, "posed_instances", r->posed);
    cli_put_u64(output, "poses", s->poses.count);
    cli_put_u64(output, "pose_matrices", s->poses.matrix_count);
    cli_put_u64(parts, "assets", bytes->assets);
    cli_put_u64(parts, "instances", bytes->instances);
    cli_put_u64(parts, "pages", bytes->pages);
    cli_put_u64(parts, "names", bytes->names);
    cli_put_u64(parts, "poses", bytes->poses);
    cli_put_u64(parts, "rest", bytes->rest);
    json_object_set_new(output, "bytes_by_part", parts);
    for (uint32_t i = 0; i < count; i++) {
        static const char *const fates[] = {"kept", "unused", "empty", "equal"};
        const fmt_scene_build_asset *a = &assets[i];
        bool stored = a->packed.fate == SVO_PACK_KEPT || a->packed.fate == SVO_PACK_EQUAL;
        json_t *o = json_object();
        cli_put_text(o, "name", a->name);
        cli_put_text(o, "file", a->file);
        cli_put_text(o, "source", a->source != NULL ? a->source : "");
        cli_put_text(o, "fate", fates[a->packed.fate]);
        cli_put_u64(o, "instances", a->packed.instances);
        if (stored) {
            cli_put_u64(o, "depth", a->depth);
            cli_put_u64(o, "voxels", a->voxels);
            cli_put_u64(o, "packed_as", a->packed.packed);
            cli_put_u64(o, "bytes", a->packed.fate == SVO_PACK_KEPT ? asset_bytes[a->packed.packed] : 0);
            if (a->bones != 0) {
                cli_put_u64(o, "bones", a->bones);
                cli_put_u64(o, "bones_kept", a->bones_kept);
            }
        }
        json_array_append_new(list, o);
    }
    json_object_set_new(output, "asset_list", list);
    report_left_out(out, b, assets, count, asset_bytes);
    json_object_set_new(output, "left_out", out);
    cli_put_f64(cli_section(c, "errors"), "instance_translation_max", r->translation_error);
    double low[3], high[3];
    if (svo_scene_bounds(s, low, high)) {
        json_t *box = json_array();
        for (int k = 0; k < 6; k++) json_array_append_new(box, json_real(k < 3 ? low[k] : high[k - 3]));
        json_object_set_new(output, "bounds", box);
    }
}

static svo_result write_scene(cli *c, const fmt_scene_build *b, const svo_allocator *a, fmt_output *out, svo_error *err)
{
    const svo_scene *s = fmt_scene_build_scene(b);
    fmt_scene_bytes bytes;
    uint64_t *asset_bytes = svo_calloc(a, s->asset_count, sizeof *asset_bytes), total;
    telling t = {c, b};
    svo_result result = asset_bytes == NULL && s->asset_count != 0 ? svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the report") : SVO_OK;
    cli_phase(c, "write");
    if (result == SVO_OK) result = fmt_scene_write_telling(out, s, tell_provenance, &t, a, &bytes, asset_bytes, err);
    total = fmt_output_offset(out);
    if (result == SVO_OK) result = fmt_output_commit(out, err);
    else fmt_output_discard(out);
    cli_phase(c, NULL);
    if (result == SVO_OK) {
        report_scene(c, b, &bytes, asset_bytes, total);
        cli_info(c, "%u assets, %llu instances in %u pages, %llu bytes", s->asset_count, (unsigned long long)s->instance_count, s->page_count,
                 (unsigned long long)total);
    }
    svo_free(a, asset_bytes, s->asset_count, sizeof *asset_bytes);
    return result;
}

/* Bytes of the scene at a depth; 0 in *bytes when an asset needs more levels than there are. */
static svo_result bytes_at(const cli *c, const fmt_scene_build_options *o, uint32_t depth, uint64_t *bytes, svo_error *err)
{
    fmt_scene_build_options trial = *o;
    svo_buffer file;
    fmt_scene_build *b;
    fmt_output *out;
    trial.depth = depth;
    trial.voxelize.warnings = trial.dag.warnings = NULL;
    trial.phase = NULL;
    trial.progress = NULL;
    svo_buffer_init(&file, o->dag.allocator);
    SVO_TRY(fmt_scene_build_open(c->inputs[0], &trial, &b, err));
    const svo_scene *s = fmt_scene_build_scene(b);
    telling t = {c, b};
    uint64_t *asset_bytes = svo_calloc(o->dag.allocator, s->asset_count, sizeof *asset_bytes);
    svo_result result = asset_bytes == NULL && s->asset_count != 0 ? svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the sizes of assets") : SVO_OK;
    if (result == SVO_OK) result = fmt_output_open_memory(&file, &out, err);
    if (result == SVO_OK) {
        result = fmt_scene_write_telling(out, s, tell_provenance, &t, o->dag.allocator, NULL, asset_bytes, err);
        if (result == SVO_OK) result = fmt_output_commit(out, err);
        else fmt_output_discard(out);
    }
    *bytes = file.size;
    svo_buffer_free(&file);
    svo_free(o->dag.allocator, asset_bytes, s->asset_count, sizeof *asset_bytes);
    fmt_scene_build_close(b);
    return result;
}

/* The greatest depth up to o->depth at which the scene takes at most `budget` bytes. From coarse to fine, as each level costs about what all coarser ones do
 * together, three times over. */
static svo_result fit_budget(cli *c, fmt_scene_build_options *o, uint64_t budget, svo_error *err)
{
    uint32_t best = 0, depth = o->depth < 5 ? 0 : 5;
    bool fits = false;
    uint64_t bytes = 0, before = 0;
    json_t *tried = json_array();
    cli_phase(c, "budget");
    for (; depth <= o->depth; depth++) {
        svo_result result = bytes_at(c, o, depth, &bytes, err);
        cli_progress_steps(c, "trying depths", depth, o->depth, -1);
        if (result != SVO_OK) {
            json_decref(tried);
            return result;
        }
        json_t *t = json_object();
        cli_put_u64(t, "depth", depth);
        cli_put_u64(t, "bytes", bytes);
        json_array_append_new(tried, t);
        if (bytes > budget) {
            if (fits || depth == 0) break;
            o->depth = depth - 1; /* too much even at the coarsest depth tried: look below it */
            depth = (uint32_t)-1;
            continue;
        }
        fits = true, best = depth;
        if (before != 0 && bytes - before > budget - bytes) break; /* the next level adds more than this one did */
        before = bytes;
    }
    json_object_set_new(cli_section(c, "output"), "budget_tried", tried);
    if (!fits) return svo_fail(err, SVO_LIMIT, "the scene takes %llu bytes with single voxels for its meshes: more than the %llu of --budget", (unsigned long long)bytes, (unsigned long long)budget);
    o->depth = best;
    cli_info(c, "depth %u for a budget of %llu bytes", best, (unsigned long long)budget);
    return SVO_OK;
}

static svo_result run(cli *c, fmt_scene_build_options *o, uint64_t budget, const char *depfile, svo_error *err)
{
    sources read = {.names_only = true};
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, c->memory != 0 ? c->memory : UINT64_MAX, NULL);
    o->voxelize.threads = o->dag.threads = (uint32_t)c->threads;
    o->voxelize.memory = o->dag.memory = c->memory;
    o->voxelize.allocator = o->dag.allocator = &limit.base;
    o->voxelize.warnings = o->dag.warnings = &c->warnings;
    o->phase = next_phase;
    o->progress = assets_done;
    o->user = c;
    fmt_output *out;
    SVO_TRY(fmt_output_open(c->output, c->force, &out, err));
    fmt_scene_build *b = NULL;
    svo_result result = budget != 0 ? fit_budget(c, o, budget, err) : SVO_OK;
    if (depfile != NULL) o->file_read = sources_add, o->file_read_user = &read;
    if (result == SVO_OK) result = fmt_scene_build_open(c->inputs[0], o, &b, err);
    if (result == SVO_OK) result = sources_check_depfile(&read, depfile, c->force, err);
    if (result != SVO_OK) {
        fmt_output_discard(out);
        fmt_scene_build_close(b);
        sources_free(&read);
        if (result == SVO_OUT_OF_MEMORY && c->memory != 0 && svo_limit_peak(&limit) > 0) {
            svo_error inner = *err;
            return svo_fail(err, SVO_LIMIT, "%s (--memory allows %llu bytes)", inner.message, (unsigned long long)c->memory);
        }
        return result;
    }
    result = write_scene(c, b, &limit.base, out, err);
    if (result == SVO_OK && depfile != NULL) result = sources_depfile(&read, depfile, c->output, c->force, err);
    fmt_scene_build_close(b);
    sources_free(&read);
    return result;
}

int main(int argc, char **argv)
{
    fmt_scene_build_options build = fmt_default_scene_build_options();
    pack_options o = {.depth = build.depth, .page = 1024, .color = "lossless", .normal = "lossless", .attributes = "auto"};
    const cli_option options[] = {
        {.name = "depth", .letter = 'd', .kind = CLI_U64, .value = &o.depth, .argument = "D", .min = 0, .max = SVO_MAX_DEPTH, .seen = &o.has_depth,
         .help = "Levels of the mesh that is largest in the scene; the others get as few as give voxels of that size.", .group = "Meshes"},
        {.name = "voxel-size", .kind = CLI_DOUBLE, .value = &o.voxel_size, .argument = "S", .min = 1e-300, .max = 1e300, .seen = &o.has_size,
         .no_default = true, .help = "Largest edge of a voxel in scene units, in place of --depth.", .group = "Meshes"},
        {.name = "view-distance", .kind = CLI_DOUBLE, .value = &o.view_distance, .argument = "D", .min = 1e-300, .max = 1e300, .seen = &o.has_distance,
         .no_default = true, .help = "Nearest distance that anything is seen from: voxels are as wide as a pixel there, 1080 pixels high at 40 degrees.", .group = "Meshes"},
        {.name = "budget", .kind = CLI_SIZE, .value = &o.budget, .argument = "SIZE", .min = 1, .max = (double)(UINT64_C(1) << 53), .seen = &o.has_budget, .no_default = true,
         .help = "Largest OUT: the greatest depth up to --depth (16) that fits.", .group = "Meshes"},
        {.name = "attributes", .kind = CLI_TEXT, .value = &o.attributes, .argument = "LIST",
         .help = "auto, none, or some of color,normal,emissive,metallic,roughness,material,coverage.", .group = "Meshes"},
        {.name = "surface", .kind = CLI_CHOICE, .value = &o.surface, .choices = surfaces, .argument = "KIND", .help = "Voxels a surface marks.", .group = "Meshes"},
        {.name = "fill", .kind = CLI_CHOICE, .value = &o.fill, .choices = fills, .argument = "KIND", .help = "Voxels inside.", .group = "Meshes"},
        {.name = "color", .kind = CLI_TEXT, .value = &o.color, .argument = "lossless|BITS|deltaE=X|mean=X|psnr=X",
         .help = "Colours: as they are, at most 2^BITS (1 to 16) different ones, every one within X in CIE94, or few bytes at a mean CIE94 or a PSNR (with deltaE=X after a comma: every one within it).", .group = "Meshes and .svo files"},
        {.name = "normal", .kind = CLI_TEXT, .value = &o.normal, .argument = "lossless|BITS|deg=X",
         .help = "Normals: as they are, BITS in all (4 to 32, even), or every one within X degrees.", .group = "Meshes and .svo files"},
        {.name = "lod", .kind = CLI_CHOICE, .value = &o.lod, .choices = lods, .argument = "KIND", .help = "Which inner nodes have attributes; all: those of 2x2x2 and 4x4x4 voxels are worked out when they are asked for; stored: all are in the file.",
         .group = "Meshes and .svo files"},
        {.name = "animation", .kind = CLI_TEXT, .value = &o.animation, .argument = "NAME|NUMBER", .seen = &o.has_animation, .no_default = true,
         .help = "glTF scenes: the animation that poses skins and moves nodes; the first one with --time alone.", .group = "Scene"},
        {.name = "time", .kind = CLI_DOUBLE, .value = &o.time, .argument = "S", .min = -1e9, .max = 1e9, .seen = &o.has_time,
         .help = "Time of the animation in seconds.", .group = "Scene"},
        {.name = "skins", .kind = CLI_CHOICE, .value = &o.skins, .choices = skins, .argument = "KIND",
         .help = "Skinned meshes: an octree with bones and a pose, or baked as they stand.", .group = "Scene"},
        {.name = "page", .kind = CLI_U64, .value = &o.page, .argument = "N", .min = 1, .max = 1 << 24, .help = "Most instances in a page.", .group = "Scene"},
        {.name = "depfile", .kind = CLI_TEXT, .value = &o.depfile, .argument = "FILE", .no_default = true, .help = "Write a rule for Make or Ninja that names every file read.", .group = "Builds"},
        {.name = "depfile-beside", .letter = 'M', .kind = CLI_CHOICE, .value = &o.beside, .choices = beside, .argument = "D", .seen = &o.has_beside, .no_default = true,
         .help = "-MD: write that rule into OUT.d, that is beside the output, with .d after its name.", .group = "Builds"},
    };
    const cli_tool tool = {
        .name = "svo-pack",
        .summary = "Pack a scene: assets that instances use, and the instances, grouped into pages.",
        .synopsis = "SCENE -o OUT.svscene [--depth D]",
        .options = options,
        .option_count = sizeof options / sizeof options[0],
        .details = "SCENE is a description in JSON (assets and instances of them), a glTF scene (its meshes become assets, its nodes and GPU "
                   "instances become instances), any other mesh, a .svo or a .svdag. docs/tools/svo-pack.md has the JSON format.\n"
                   "Assets of a description are .svdag, .svo or mesh files in the description's folder or below it.",
        .example = "svo-pack city.json -o city.svscene --depth 11 --report city-report.json\nsvo-pack scene.glb -o scene.svscene",
        .min_inputs = 1,
        .max_inputs = 1,
        .has_output = true,
    };
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    if (o.has_depth && o.has_size) return cli_usage(&c, "--depth and --voxel-size exclude each other");
    if (o.has_distance && (o.has_depth || o.has_size || o.has_budget)) return cli_usage(&c, "--view-distance excludes --depth, --voxel-size and --budget");
    if (o.has_budget && o.has_size) return cli_usage(&c, "--budget excludes --voxel-size");
    if (o.has_budget && strcmp(c.inputs[0], "-") == 0) return cli_usage(&c, "--budget reads the scene several times: it cannot come from stdin");
    if ((o.has_animation || o.has_time) && o.skins == 1) return cli_usage(&c, "--animation and --time pose skins: they exclude --skins bake");
    if ((code = cli_take_depfile(&c, o.has_beside, &o.depfile)) >= 0) return code;
    if (o.has_distance) o.voxel_size = 2 * o.view_distance * tan(0.5 * VIEW_FOV) / VIEW_PIXELS;
    if (o.has_budget && !o.has_depth) o.depth = 16;
    if ((code = cli_take_channels(&c, o.attributes, &build.voxelize.channels)) >= 0) return code;
    if ((code = cli_take_quality(&c, o.color, o.normal, &build.dag)) >= 0) return code;
    build.depth = (uint32_t)o.depth;
    build.voxel_size = o.has_size || o.has_distance ? o.voxel_size : 0;
    build.page_instances = (uint32_t)o.page;
    if (o.has_animation || o.has_time) build.animation = o.has_animation ? o.animation : "0";
    build.time = o.time;
    build.bake_skins = o.skins == 1;
    build.voxelize.surface = (svo_surface)o.surface;
    build.voxelize.fill = (svo_fill)o.fill;
    build.dag.lod = o.lod != 2;
    build.dag.averaged = o.lod == 0;
    svo_error err = {0};
    return cli_end(&c, run(&c, &build, o.has_budget ? o.budget : 0, o.depfile, &err), &err);
}
