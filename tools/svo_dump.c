/* svo-dump: what is in a file, is it valid, and its voxels as a point cloud. */
#include <stdio.h>
#include <string.h>

#include "dump.h"

static svo_result dump_kind(dump_job *j, svo_error *err)
{
    uint32_t kind = fmt_container_kind(j->data, j->size);
    if (j->source != NULL && kind != FMT_KIND_SVDAG) return svo_fail(err, SVO_UNSUPPORTED, "--source is for .svdag files");
    if (kind == FMT_KIND_SVO) return dump_svo(j, err);
    if (kind == FMT_KIND_SVDAG) return dump_svdag(j, err);
    if (kind == FMT_KIND_SCENE) return dump_scene(j, err);
    if (kind == FMT_KIND_SKEL) return dump_skel(j, err);
    fmt_container c; /* says what is wrong with the header; another kind with a good header is refused there */
    SVO_TRY(fmt_container_open(j->data, j->size, j->allocator, &c, err));
    fmt_container_close(&c);
    return svo_fail(err, SVO_UNSUPPORTED, "a file of this kind cannot be read by this version");
}

static svo_result dump_bytes(dump_job *j, svo_error *err)
{
    SVO_TRY(dump_kind(j, err));
    if (j->has_tree || j->histogram) SVO_TRY(dump_inside(j, err));
    if (j->export.path != NULL) SVO_TRY(dump_export_file(j, err));
    return j->html != NULL ? dump_html(j, err) : SVO_OK;
}

/* Read one file. *messages (NULL: not wanted) receives what is wrong with it, j->json of a damaged one what is left where that is asked for. */
static svo_result dump_file(dump_job *j, bool partial, json_t **messages, uint64_t *suppressed, svo_error *err)
{
    fmt_bytes b;
    svo_result r = fmt_bytes_open_spooled(j->path, &b, err);
    if (r != SVO_OK) return r;
    j->data = b.data;
    j->size = b.size;
    r = dump_bytes(j, err);
    if (messages != NULL) *messages = dump_violations(j, r, err, suppressed);
    if (partial && r == SVO_INVALID_DATA) {
        json_decref(j->json);
        j->json = dump_partial(j, r, err);
    }
    fmt_bytes_close(&b);
    if (r == SVO_OK || r == SVO_IO || r == SVO_LIMIT) return r; /* the last two are about the output, which the message names */
    svo_error inner = err != NULL ? *err : (svo_error){0};
    svo_fail(err, r, "%.100s: %s", strcmp(j->path, "-") == 0 ? "stdin" : j->path, inner.message);
    if (err != NULL) {
        err->chunk = inner.chunk;
        err->offset = inner.offset;
        err->index = inner.index;
    }
    return r;
}

/* The verdict of --validate as JSON. */
static json_t *verdict(const dump_job *j, svo_result r, json_t *messages, uint64_t suppressed)
{
    json_t *o = json_object();
    cli_put_text(o, "file", strcmp(j->path, "-") == 0 ? "stdin" : j->path);
    json_object_set_new(o, "valid", json_boolean(r == SVO_OK));
    json_object_set(o, "messages", messages);
    if (suppressed != 0) cli_put_u64(o, "suppressed", suppressed);
    json_t *source = json_object_get(j->json, "source");
    if (json_is_object(source)) json_object_set(o, "source", source); /* a skeleton's is a text */
    return o;
}

/* Messages but the one that is the run's error, on stderr. */
static void print_messages(const dump_job *j, const json_t *messages, uint64_t suppressed, const char *known)
{
    const json_t *m;
    size_t i;
    json_array_foreach(messages, i, m) {
        const char *text = json_string_value(json_object_get(m, "message"));
        if (strstr(known, text) == NULL) cli_error(j->c, "%.100s: %s", strcmp(j->path, "-") == 0 ? "stdin" : j->path, text);
    }
    if (suppressed != 0) cli_error(j->c, "%.100s: %llu more", j->path, (unsigned long long)suppressed);
}

typedef struct dump_options { bool json, validate, quick, partial, table, has_tree, histogram; uint64_t tree; const char *voxels, *source, *html; uint64_t limit, html_size; dump_export export; int volume; } dump_options;

/* All files; the first failure is returned, further ones are printed. Text is printed file by file, JSON at the end. */
static svo_result run(cli *c, const dump_options *o, svo_error *err)
{
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, c->memory != 0 ? c->memory : UINT64_MAX, NULL);
    json_t *all = json_array();
    svo_result first = SVO_OK;
    bool text = !o->json && (o->voxels == NULL || strcmp(o->voxels, "-") != 0) && (o->html == NULL || strcmp(o->html, "-") != 0);
    cli_phase(c, o->validate ? "validate" : "dump");
    if (o->table) dump_print_row(NULL);
    for (int i = 0; i < c->input_count; i++) {
        svo_error e = {0};
        dump_job j = {.c = c, .path = c->inputs[i], .allocator = &limit.base, .quick = o->quick && !o->validate && o->voxels == NULL,
                      .voxels = o->voxels, .limit = o->limit, .source = o->source, .html = o->html, .html_size = o->html_size,
                      .export = o->export, .has_tree = o->has_tree, .histogram = o->histogram, .tree = o->tree, .json = json_object()};
        j.export.rgba = o->volume == 1;
        j.export.limit = o->limit;
        json_t *messages = NULL;
        uint64_t suppressed = 0;
        svo_result r = dump_file(&j, o->partial, o->validate ? &messages : NULL, &suppressed, &e);
        bool left = o->partial && r == SVO_INVALID_DATA; /* j.json tells what can be read */
        if (o->validate && !o->json && r != SVO_OK) print_messages(&j, messages, suppressed, e.message);
        if (r != SVO_OK) {
            if (first == SVO_OK) first = r, *err = e;
            else cli_error(c, "%s", e.message);
        }
        if (o->validate && o->json) json_array_append_new(all, verdict(&j, r, messages, suppressed));
        else if ((r == SVO_OK || left) && o->json) json_array_append(all, j.json);
        else if (r == SVO_OK && o->validate) cli_write_plain(stdout, strcmp(j.path, "-") == 0 ? "stdin" : j.path), puts(": valid");
        else if ((r == SVO_OK || left) && o->table) dump_print_row(j.json);
        else if ((r == SVO_OK || left) && text) dump_print(&j);
        if (r == SVO_OK) json_object_set(cli_section(c, "input"), strcmp(j.path, "-") == 0 ? "stdin" : j.path, j.json);
        json_decref(messages);
        json_decref(j.json);
    }
    if (o->json && (first == SVO_OK || o->validate || (o->partial && json_array_size(all) != 0))) {
        json_t *what = c->input_count == 1 ? json_array_get(all, 0) : all;
        json_dumpf(what, stdout, JSON_INDENT(1) | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(17));
        putchar('\n');
    }
    json_decref(all);
    return first;
}

static const char *const volumes[] = {"filled", "rgba", NULL};

int main(int argc, char **argv)
{
    dump_options o = {.limit = (uint64_t)1 << 31, .html_size = (uint64_t)16 << 20};
    cli_option options[] = {
        {.name = "json", .kind = CLI_FLAG, .value = &o.json, .help = "Print JSON: an object, or an array for several files."},
        {.name = "validate", .kind = CLI_FLAG, .value = &o.validate, .help = "Check every rule of the format and print a verdict instead of a summary: everything that is wrong, with the rule's id."},
        {.name = "partial", .kind = CLI_FLAG, .value = &o.partial, .help = "Of a damaged file, print what can be read and where the damage is (exit code 3 all the same)."},
        {.name = "table", .kind = CLI_FLAG, .value = &o.table, .help = "Print one line a file."},
        {.name = "tree", .kind = CLI_U64, .value = &o.tree, .argument = "LEVEL", .max = SVO_MAX_DEPTH, .seen = &o.has_tree, .no_default = true,
         .help = "List the nodes from the root to this level: cell, kind, mask of children, number of its attribute, where it is stored."},
        {.name = "histogram", .kind = CLI_FLAG, .value = &o.histogram, .help = "Count nodes by level and number of children, and voxels by the values of each channel."},
        {.name = "source", .kind = CLI_TEXT, .value = &o.source, .argument = "SRC.svo", .no_default = true,
         .help = "With --validate of a .svdag: hold it against the octree it was made from: voxels, attributes and the error bounds it promises."},
        {.name = "voxels", .kind = CLI_TEXT, .value = &o.voxels, .argument = "OUT.ply", .no_default = true,
         .help = "Write every finest voxel to a binary PLY point cloud; - is stdout, then nothing else is printed."},
        {.name = "limit", .kind = CLI_U64, .value = &o.limit, .argument = "N", .help = "Most voxels that --voxels and --export write, and most nodes that --histogram visits."},
        {.name = "export", .kind = CLI_TEXT, .value = &o.export.path, .argument = "OUT", .no_default = true, .group = "Export",
         .help = "Write the voxels for other programs, by the ending of OUT: .ply or .glb (mesh of their faces), .vox, .nrrd, .raw, .vdb, .nvdb."},
        {.name = "level", .kind = CLI_U64, .value = &o.export.level, .argument = "L", .max = SVO_MAX_DEPTH, .seen = &o.export.has_level, .no_default = true, .group = "Export",
         .help = "Export the nodes of this level as voxels instead of the finest ones; of a scene, of each asset that is deeper."},
        {.name = "low", .kind = CLI_VEC3, .value = o.export.low, .argument = "x,y,z", .seen = &o.export.has_low, .no_default = true, .group = "Export",
         .help = "First cell of the box to export, in cells of the exported level."},
        {.name = "high", .kind = CLI_VEC3, .value = o.export.high, .argument = "x,y,z", .seen = &o.export.has_high, .no_default = true, .group = "Export",
         .help = "Last cell of the box to export."},
        {.name = "volume", .kind = CLI_CHOICE, .value = &o.volume, .argument = "WHAT", .choices = volumes, .group = "Export",
         .help = "What a cell of a .nrrd or .raw volume is: a byte (255 in voxels), or red, green, blue and 255."},
        {.name = "draco", .kind = CLI_U64, .value = &o.export.draco, .argument = "BITS", .max = 24, .seen = &o.export.has_draco, .no_default = true, .group = "Export",
         .help = "Compress the meshes of a .glb (KHR_draco_mesh_compression), positions with this many bits; 0: the fewest with an error of at most an eighth of a voxel."},
        {.name = "instancing", .kind = CLI_FLAG, .value = &o.export.instancing, .group = "Export",
         .help = "Scenes as .glb: instances of one asset as one node (EXT_mesh_gpu_instancing), without their names and numbers."},
        {.name = "rest", .kind = CLI_FLAG, .value = &o.export.rest, .group = "Export",
         .help = "Scenes, of --html too: every instance as it is without its pose, so that each asset is written once."},
        {.name = "html", .kind = CLI_TEXT, .value = &o.html, .argument = "OUT.html", .no_default = true,
         .help = "Write one page that draws the octree or scene in a browser (WebGL 2), without a server or network; - is stdout."},
        {.name = "html-size", .kind = CLI_SIZE, .value = &o.html_size, .argument = "SIZE", .min = 1 << 17, .max = 1u << 30,
         .help = "Most bytes of that page; where it would grow over this it shows a coarser level."},
        {.name = "quick", .kind = CLI_FLAG, .value = &o.quick, .help = "Check hashes only; leave out what needs decoding, such as bounds."},
    };
    cli_tool tool = {
        .name = "svo-dump",
        .summary = "Show what is in a file of this toolchain, check it, and write its voxels as points.",
        .synopsis = "FILE... [--json] [--validate] [--voxels OUT.ply] [--html OUT.html] [--export OUT.glb]",
        .options = options,
        .option_count = sizeof options / sizeof options[0],
        .details = "FILE is a .svo, .svdag, .svscene or .skel, told apart by content; - is stdin.\n"
                   "A damaged file ends with exit code 3 and a message that names the chunk, the byte and the rule that is broken.",
        .example = "svo-dump bunny.svo\nsvo-dump --json bunny.svdag\nsvo-dump bunny.svdag --voxels bunny.ply\nsvo-dump city.svscene --html city.html\nsvo-dump bunny.svo --export bunny.vox --level 8",
        .min_inputs = 1,
        .max_inputs = -1,
    };
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    if (o.voxels != NULL && c.input_count != 1) return cli_usage(&c, "--voxels takes one FILE");
    if (o.voxels != NULL && o.validate) return cli_usage(&c, "--voxels and --validate exclude each other (--voxels validates as well)");
    if (o.table && (o.json || o.validate)) return cli_usage(&c, "--table excludes --json and --validate");
    if ((o.has_tree || o.histogram) && (o.table || o.validate)) return cli_usage(&c, "--tree and --histogram exclude --table and --validate");
    if (o.partial && o.validate) return cli_usage(&c, "--partial and --validate exclude each other (--validate names every damage)");
    if (o.source != NULL && (!o.validate || c.input_count != 1)) return cli_usage(&c, "--source takes one FILE and --validate");
    if (o.source != NULL && strcmp(o.source, "-") == 0) return cli_usage(&c, "--source is a file, it is read twice");
    if (o.voxels != NULL && o.json && strcmp(o.voxels, "-") == 0) return cli_usage(&c, "--json and --voxels - would both write to stdout");
    if (o.export.path == NULL && (o.export.has_level || o.export.has_low || o.export.has_high || o.export.has_draco || o.export.instancing || o.volume != 0))
        return cli_usage(&c, "--level, --low, --high, --draco, --instancing and --volume need --export");
    if (o.export.path == NULL && o.html == NULL && o.export.rest) return cli_usage(&c, "--rest needs --export or --html");
    if (o.export.path != NULL && (c.input_count != 1 || o.validate)) return cli_usage(&c, "--export takes one FILE and excludes --validate");
    if (o.html != NULL && (c.input_count != 1 || o.validate)) return cli_usage(&c, "--html takes one FILE and excludes --validate");
    if (o.html != NULL && strcmp(o.html, "-") == 0 && (o.json || (o.voxels != NULL && strcmp(o.voxels, "-") == 0)))
        return cli_usage(&c, "--html - and another output would both write to stdout");
    svo_error err = {0};
    svo_result r = run(&c, &o, &err);
    return cli_end(&c, r, &err);
}
