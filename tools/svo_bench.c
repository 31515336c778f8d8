/* svo-bench: sweep a parameter over meshes and report error and bytes against run time. */
#define _GNU_SOURCE
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "bench.h"

static const char *const clocks[] = {"wall", "cpu", NULL};
static const char *const attribute_names[] = {"auto", "none", NULL};

enum { MAX_LIST_BYTES = 16 << 20, DOCUMENTS = 4 };

typedef struct tool_options {
    uint64_t depth, repeat;
    int sweep, attributes, clock;
    bool has_sweep, has_depth, has_attributes;
    const char *values, *list;
    const char *csv, *json, *svg, *html;
} tool_options;

/* A document: where it goes and what is in it. */
typedef struct document {
    const char *path;
    fmt_output *out;
    bench_text text;
} document;

/* --- models ------------------------------------------------------------------------------------------------------- */

static bool add_model(bench *b, const char *folder, size_t folder_length, const char *name, size_t length)
{
    bench_model *grown = realloc(b->models, ((size_t)b->model_count + 1) * sizeof *grown);
    if (grown == NULL) return false;
    b->models = grown;
    bench_model *m = &b->models[b->model_count];
    *m = (bench_model){0};
    if (asprintf(&m->path, "%.*s%.*s", (int)folder_length, folder, (int)length, name) < 0) return false;
    b->model_count++;
    return true;
}

/* One mesh a line, beside the list as in a scene; blank lines and lines that begin with # do not count. */
static svo_result read_list(bench *b, const char *path, svo_error *err)
{
    fmt_bytes bytes;
    SVO_TRY(fmt_bytes_open(path, MAX_LIST_BYTES, NULL, &bytes, err));
    const char *slash = strrchr(path, '/'), *text = (const char *)bytes.data;
    size_t folder = slash != NULL ? (size_t)(slash - path) + 1 : 0;
    svo_result r = SVO_OK;
    if (bytes.size > MAX_LIST_BYTES) r = svo_fail(err, SVO_LIMIT, "%s: larger than 16 MB; a list of meshes is text, one name a line", path);
    else if (bytes.size > 0 && memchr(text, 0, bytes.size) != NULL) r = svo_fail(err, SVO_INVALID_DATA, "%s: holds a NUL byte; a list of meshes is text, one name a line", path);
    for (uint64_t at = 0; r == SVO_OK && at < bytes.size;) {
        const char *end = memchr(text + at, '\n', bytes.size - at);
        uint64_t next = end != NULL ? (uint64_t)(end - text) + 1 : bytes.size, length = end != NULL ? next - 1 - at : next - at;
        if (length > 0 && text[at + length - 1] == '\r') length--;
        if (length > 4096) r = svo_fail(err, SVO_INVALID_DATA, "%s: a name of more than 4096 bytes", path);
        else if (length > 0 && text[at] != '#' && !add_model(b, path, text[at] == '/' ? 0 : folder, text + at, length))
            r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
        at = next;
    }
    fmt_bytes_close(&bytes);
    return r;
}

/* The last `parts` components of a path; NULL when it has no more of them than that and so is shown whole. */
static const char *tail(const char *path, uint32_t parts)
{
    for (const char *p = path + strlen(path); p > path; p--)
        if (p[-1] == '/' && parts-- <= 1) return p;
    return NULL;
}

static bool shares_tail(const bench *b, uint32_t model, const char *name)
{
    size_t n = strlen(name);
    for (uint32_t i = 0; i < b->model_count; i++) {
        size_t length = strlen(b->models[i].path);
        if (i == model || strcmp(b->models[i].path, b->models[model].path) == 0) continue;
        if (length >= n && strcmp(b->models[i].path + length - n, name) == 0) return true;
    }
    return false;
}

static svo_result name_models(bench *b, svo_error *err)
{
    for (uint32_t m = 0; m < b->model_count; m++) {
        const char *name = NULL;
        for (uint32_t parts = 1; name == NULL; parts++) {
            const char *end = tail(b->models[m].path, parts);
            if (end == NULL) name = b->models[m].path;
            else if (!shares_tail(b, m, end)) name = end;
        }
        json_t *clean = cli_text(name);
        b->models[m].owned = clean != NULL ? strdup(json_string_value(clean)) : NULL;
        b->models[m].name = b->models[m].owned;
        json_decref(clean);
        if (b->models[m].owned == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    }
    return SVO_OK;
}

/* --- outputs ------------------------------------------------------------------------------------------------------ */

static bool same_file(const char *a, const char *b)
{
    struct stat s, t;
    if (strcmp(a, b) == 0) return true;
    return stat(a, &s) == 0 && stat(b, &t) == 0 && S_ISREG(s.st_mode) && s.st_dev == t.st_dev && s.st_ino == t.st_ino;
}

/* What would overwrite what, as a sentence for the user; false when nothing would. */
static bool clash(const bench *b, const tool_options *o, const document docs[DOCUMENTS], char why[300])
{
    const char *outs[DOCUMENTS + 1] = {docs[0].path, docs[1].path, docs[2].path, docs[3].path, b->c->report};
    for (int i = 0; i < DOCUMENTS + 1; i++) {
        if (outs[i] == NULL) continue;
        for (int k = 0; k < i; k++)
            if (outs[k] != NULL && same_file(outs[i], outs[k])) return snprintf(why, 300, "two outputs name the same file, '%.200s'", outs[i]), true;
        bool input = o->list != NULL && strcmp(outs[i], "-") != 0 && same_file(outs[i], o->list);
        for (uint32_t m = 0; m < b->model_count && !input; m++) input = same_file(outs[i], b->models[m].path);
        if (input) return snprintf(why, 300, "'%.200s' would overwrite an input", outs[i]), true;
    }
    return false;
}

static svo_result open_documents(const bench *b, document docs[DOCUMENTS], svo_error *err)
{
    for (int i = 0; i < DOCUMENTS; i++)
        if (docs[i].path != NULL) SVO_TRY(fmt_output_open(docs[i].path, b->c->force, &docs[i].out, err));
    return SVO_OK;
}

static svo_result make_documents(const bench *b, document docs[DOCUMENTS], svo_error *err)
{
    if (docs[0].path != NULL) bench_write_csv(b, &docs[0].text);
    if (docs[1].path != NULL) {
        json_t *all = bench_json(b);
        char *text = json_dumps(all, JSON_INDENT(1) | JSON_REAL_PRECISION(17));
        if (text != NULL) bench_text_add(&docs[1].text, "%s\n", text);
        else docs[1].text.failed = true;
        free(text);
        json_decref(all);
    }
    if (docs[2].path != NULL) bench_write_svg(b, &docs[2].text);
    if (docs[3].path != NULL) bench_write_html(b, &docs[3].text);
    for (int i = 0; i < DOCUMENTS; i++)
        if (docs[i].text.failed) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    return SVO_OK;
}

/* A pipe, a device or stdout takes a document once; a file is replaced as a whole every time. */
static bool once_only(const char *path)
{
    struct stat s;
    return strcmp(path, "-") == 0 || (stat(path, &s) == 0 && !S_ISREG(s.st_mode));
}

static svo_result commit_documents(document docs[DOCUMENTS], bool last, svo_error *err)
{
    for (int i = 0; i < DOCUMENTS; i++) {
        document *d = &docs[i];
        if (d->path == NULL || (!last && once_only(d->path))) continue;
        if (d->out == NULL) SVO_TRY(fmt_output_open(d->path, true, &d->out, err)); /* our own, from the point before */
        SVO_TRY(fmt_output_write(d->out, d->text.bytes.data, d->text.bytes.size, err));
        fmt_output *out = d->out;
        d->out = NULL;
        SVO_TRY(fmt_output_commit(out, err));
    }
    return SVO_OK;
}

static svo_result write_documents(bench *b, document docs[DOCUMENTS], bool last, svo_error *err)
{
    for (int i = 0; i < DOCUMENTS; i++) docs[i].text.bytes.size = 0;
    bench_mark_fronts(b);
    SVO_TRY(make_documents(b, docs, err));
    return commit_documents(docs, last, err);
}

/* The documents as they are after each point, so that a sweep that is stopped leaves what it has measured. */
static void save_point(bench *b, void *user)
{
    svo_error err = {0};
    uint64_t good = 0;
    for (uint64_t i = 0; i < (uint64_t)b->model_count * b->value_count; i++) good += b->rows[i].result == SVO_OK;
    if (good == 0 || b->save_failed) return;
    b->save_failed = write_documents(b, user, false, &err) != SVO_OK;
    if (b->save_failed) svo_warn(&b->c->warnings, "the points so far could not be saved: %s", err.message);
}

static svo_result print_table(const bench *b, svo_error *err)
{
    bench_text text = {0};
    bench_write_table(b, &text);
    svo_result r = text.failed ? svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory") : SVO_OK;
    if (r == SVO_OK) fwrite(text.bytes.data, 1, text.bytes.size, stdout); /* cli_end looks at stdout's state */
    svo_buffer_free(&text.bytes);
    return r;
}

/* --- the run ------------------------------------------------------------------------------------------------------ */

/* The first failure becomes the tool's; the others are warnings. Returns how many rows have figures. */
static uint64_t judge(bench *b, svo_result *result, svo_error *err)
{
    uint64_t good = 0;
    *result = SVO_OK;
    for (uint32_t m = 0; m < b->model_count; m++) {
        const char *before = "";
        for (uint32_t v = 0; v < b->value_count; v++) {
            const bench_row *row = bench_row_at(b, m, v);
            if (row->result == SVO_OK) {
                good++;
            } else if (*result == SVO_OK) {
                *result = svo_fail(err, row->result, "%s", row->error);
                before = row->error;
            } else if (strcmp(before, row->error) != 0) {
                svo_warn(&b->c->warnings, "%s", row->error);
                before = row->error;
            }
        }
    }
    return good;
}

static void report(const bench *b, uint64_t good, const document docs[DOCUMENTS])
{
    json_t *in = cli_section(b->c, "input"), *out = cli_section(b->c, "output");
    cli_put_u64(in, "models", b->model_count);
    cli_put_u64(in, "values", b->value_count);
    cli_put_u64(out, "rows", (uint64_t)b->model_count * b->value_count);
    cli_put_u64(out, "rows_failed", (uint64_t)b->model_count * b->value_count - good);
    uint64_t bytes = 0;
    for (int i = 0; i < DOCUMENTS; i++) bytes += docs[i].text.bytes.size;
    cli_put_u64(out, "bytes", bytes);
    json_object_set_new(b->c->json, "host", bench_host(b->c));
    json_t *all = bench_json(b);
    json_object_set(b->c->json, "rows", json_object_get(all, "rows"));
    json_decref(all);
}

static svo_result run(bench *b, document docs[DOCUMENTS], svo_error *err)
{
    SVO_TRY(name_models(b, err));
    SVO_TRY(open_documents(b, docs, err));
    b->rows = calloc((size_t)b->model_count * b->value_count, sizeof *b->rows);
    if (b->rows == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    for (uint64_t i = 0; i < (uint64_t)b->model_count * b->value_count; i++) {
        b->rows[i].result = SVO_CANCELLED;
        strcpy(b->rows[i].error, "not measured yet");
        for (int k = 0; k < COL_COUNT; k++) b->rows[i].value[k] = NAN;
    }
    b->save = save_point;
    b->save_user = docs;
    for (uint32_t m = 0; m < b->model_count; m++) bench_measure(b, m);
    bench_mark_fronts(b);
    svo_result measured;
    svo_error first = {0};
    uint64_t good = judge(b, &measured, &first);
    cli_phase(b->c, "write");
    bool to_stdout = false;
    for (int i = 0; i < DOCUMENTS; i++) to_stdout |= docs[i].path != NULL && strcmp(docs[i].path, "-") == 0;
    if (!to_stdout && (b->c->report == NULL || strcmp(b->c->report, "-") != 0)) SVO_TRY(print_table(b, err));
    if (good > 0) { /* without any figure there is nothing to keep */
        SVO_TRY(write_documents(b, docs, true, err));
    }
    cli_phase(b->c, NULL);
    report(b, good, docs);
    if (measured != SVO_OK) *err = first;
    return measured;
}

static char *join_command(int argc, char **argv)
{
    bench_text t = {0};
    bench_text_add(&t, "svo-bench");
    for (int i = 1; i < argc; i++) bench_text_add(&t, " %s", argv[i]);
    json_t *clean = NULL;
    if (!t.failed && svo_buffer_append(&t.bytes, "", 1) != NULL) clean = cli_text((const char *)t.bytes.data);
    char *out = clean != NULL ? strdup(json_string_value(clean)) : NULL;
    json_decref(clean);
    svo_buffer_free(&t.bytes);
    return out;
}

/* Usage errors that only the whole command line shows; false with the sentence in why. */
static bool check_usage(bench *b, const tool_options *o, const document docs[DOCUMENTS], char why[300])
{
    char values_why[300];
    if (!o->has_sweep) return snprintf(why, 300, "--sweep is needed"), false;
    if (o->has_depth && (o->sweep == SWEEP_DEPTH || o->sweep == SWEEP_OMEGA || o->sweep == SWEEP_METHOD)) return snprintf(why, 300, "--depth belongs to the sweeps of color and normal"), false;
    if (o->has_attributes && o->sweep != SWEEP_DEPTH) return snprintf(why, 300, "--attributes belongs to the sweep of depth"), false;
    if (!bench_parse_values(b->sweep, o->values, b->values, &b->value_count, values_why)) return snprintf(why, 300, "--values: %.280s", values_why), false;
    if (b->c->input_count == 0 && o->list == NULL) return snprintf(why, 300, "no mesh given"), false;
    for (int i = 0; i < b->c->input_count; i++)
        if (strcmp(b->c->inputs[i], "-") == 0) return snprintf(why, 300, "meshes are read from files, not from stdin"), false;
    return !clash(b, o, docs, why);
}

static int finish(bench *b, document docs[DOCUMENTS], int code)
{
    for (int i = 0; i < DOCUMENTS; i++) {
        fmt_output_discard(docs[i].out);
        svo_buffer_free(&docs[i].text.bytes);
    }
    for (uint32_t m = 0; m < b->model_count; m++) {
        free(b->models[m].path);
        free(b->models[m].owned);
    }
    free(b->models);
    free(b->rows);
    free(b->command);
    return code;
}

int main(int argc, char **argv)
{
    tool_options o = {.depth = 8, .repeat = 3};
    cli_option options[] = {
        {.name = "sweep", .kind = CLI_CHOICE, .value = &o.sweep, .choices = bench_sweep_names, .argument = "WHAT", .seen = &o.has_sweep, .no_default = true,
         .help = "The parameter: octree depth, bits or bounds of colours or of normals, the skeleton's omega, or how the skeleton is made."},
        {.name = "values", .kind = CLI_TEXT, .value = &o.values, .argument = "LIST", .no_default = true,
         .help = "Numbers and ranges, e.g. 6..10,12 or 4..16:2; colours also deltaE=X, normals deg=X, both lossless; methods as fast@0.025,literal+grid@0.025."},
        {.name = "depth", .letter = 'd', .kind = CLI_U64, .value = &o.depth, .argument = "D", .max = SVO_MAX_DEPTH, .seen = &o.has_depth,
         .help = "Depth at which colours or normals are swept."},
        {.name = "attributes", .kind = CLI_CHOICE, .value = &o.attributes, .choices = attribute_names, .argument = "HOW", .seen = &o.has_attributes,
         .help = "Attributes in the sweep of depth, as in svo-voxelize: auto, or none for geometry alone."},
        {.name = "repeat", .kind = CLI_U64, .value = &o.repeat, .argument = "N", .min = 1, .max = BENCH_MAX_REPEAT, .help = "Runs of each point; times are medians."},
        {.name = "clock", .kind = CLI_CHOICE, .value = &o.clock, .choices = clocks, .argument = "WHICH",
         .help = "Time in the plot and for the Pareto front: wall, or cpu, the user time of all threads, which other work on the machine changes less."},
        {.name = "list", .kind = CLI_TEXT, .value = &o.list, .argument = "FILE", .no_default = true,
         .help = "More meshes, one a line, looked for beside FILE; lines that begin with # do not count."},
        {.name = "csv", .kind = CLI_TEXT, .value = &o.csv, .argument = "OUT.csv", .no_default = true, .group = "Output", .help = "Write a row for each point."},
        {.name = "json", .kind = CLI_TEXT, .value = &o.json, .argument = "OUT.json", .no_default = true, .group = "Output",
         .help = "Write the rows, the meaning of each column, and what the times depend on."},
        {.name = "svg", .kind = CLI_TEXT, .value = &o.svg, .argument = "OUT.svg", .no_default = true, .group = "Output",
         .help = "Plot error against run time and against bytes."},
        {.name = "html", .kind = CLI_TEXT, .value = &o.html, .argument = "OUT.html", .no_default = true, .group = "Output",
         .help = "Write all of that as one page: the command, the plots, the rows, what each column means, and the host."},
    };
    cli_tool tool = {
        .name = "svo-bench",
        .summary = "Sweep a parameter over meshes: error and bytes against run time, as a table and a plot.",
        .synopsis = "MESH... --sweep depth|color|normal|omega|method [--values LIST] [--csv OUT.csv] [--json OUT.json] [--svg OUT.svg] [--html OUT.html] [options]",
        .options = options,
        .option_count = sizeof options / sizeof *options,
        .details = "The table goes to stdout, unless a document or the report goes there (-). A mesh that fails is named in its rows, the others are measured, and the exit "
                   "status is that of the first failure. How long something takes never is a failure.",
        .example = "svo-bench horse.ply helmet.gltf --sweep depth --values 6..11 --csv depth.csv --svg depth.svg\n"
                   "svo-bench helmet.gltf --sweep color --depth 9 --values 4..14,deltaE=1 --svg color.svg",
        .min_inputs = 0,
        .max_inputs = -1,
    };
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    document docs[DOCUMENTS] = {{.path = o.csv}, {.path = o.json}, {.path = o.svg}, {.path = o.html}};
    bench b = {.c = &c, .sweep = (bench_sweep)o.sweep, .depth = o.depth, .repeat = o.repeat, .attributes = o.attributes, .cpu = o.clock == 1};
    svo_error err = {0};
    svo_result r = SVO_OK;
    char why[300];
    b.command = join_command(argc, argv);
    bool stored = b.command != NULL;
    for (int i = 0; i < c.input_count && stored; i++) stored = add_model(&b, "", 0, c.inputs[i], strlen(c.inputs[i]));
    if (!stored) r = svo_fail(&err, SVO_OUT_OF_MEMORY, "out of memory");
    if (r == SVO_OK && !check_usage(&b, &o, docs, why)) return finish(&b, docs, cli_usage(&c, "%s", why));
    if (r == SVO_OK && o.list != NULL) {
        r = read_list(&b, o.list, &err);
        /* again, with the meshes of the list */
        if (r == SVO_OK && clash(&b, &o, docs, why)) return finish(&b, docs, cli_usage(&c, "%s", why));
        if (r == SVO_OK && b.model_count == 0) r = svo_fail(&err, SVO_INVALID_DATA, "%s: names no mesh", o.list);
    }
    if (r == SVO_OK) r = run(&b, docs, &err);
    return finish(&b, docs, cli_end(&c, r, &err));
}
