/* svo-merge: the shards of one voxelization joined to the file that a single run would have made. */
#define _GNU_SOURCE
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "cli.h"
#include "fmt_svo.h"

typedef struct names {
    const char **list; /* point into argv or into bytes */
    uint64_t count;
    char *bytes; /* of --list */
} names;

/* The inputs, or the lines of --list. */
static svo_result collect(const cli *c, const char *list, names *n, svo_error *err)
{
    uint64_t lines = 0, size = 0;
    if (list != NULL) {
        fmt_bytes file;
        SVO_TRY(fmt_bytes_open(list, (uint64_t)1 << 30, NULL, &file, err));
        size = file.size;
        n->bytes = malloc(size + 1);
        if (n->bytes != NULL && size != 0) memcpy(n->bytes, file.data, size);
        fmt_bytes_close(&file);
        if (n->bytes == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the list of shards");
        n->bytes[size] = 0;
        if (memchr(n->bytes, 0, size) != NULL) return svo_fail(err, SVO_INVALID_DATA, "%s: a list of names, one a line, is needed", list);
        for (uint64_t i = 0; i < size; i++) lines += n->bytes[i] == '\n';
    }
    n->list = calloc((size_t)c->input_count + lines + 2, sizeof *n->list);
    if (n->list == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the list of shards");
    for (int i = 0; i < c->input_count; i++) n->list[n->count++] = c->inputs[i];
    for (char *at = n->bytes; at != NULL;) {
        char *end = strchr(at, '\n');
        if (end != NULL) *end = 0;
        if (at[0] != 0) n->list[n->count++] = at;
        at = end != NULL ? end + 1 : NULL;
    }
    if (n->count == 0) return svo_fail(err, SVO_INVALID_DATA, "%s names no shards", list);
    struct stat out, in;
    bool exists = strcmp(c->output, "-") != 0 && stat(c->output, &out) == 0;
    for (uint64_t i = 0; i < n->count; i++) {
        if (strcmp(n->list[i], "-") == 0) return svo_fail(err, SVO_INVALID_ARGUMENT, "shards are read twice, so not from stdin");
        if (stat(n->list[i], &in) != 0) continue; /* told when it is opened */
        if (!S_ISREG(in.st_mode) && !S_ISDIR(in.st_mode))
            return svo_fail(err, SVO_INVALID_ARGUMENT, "%s: shards are read twice, so only from regular files", n->list[i]);
        if (exists && in.st_dev == out.st_dev && in.st_ino == out.st_ino)
            return svo_fail(err, SVO_INVALID_ARGUMENT, "%s would overwrite an input", c->output);
    }
    return SVO_OK;
}

static void report(cli *c, const fmt_svo_merge_report *m, uint64_t bytes)
{
    json_t *in = cli_section(c, "input"), *out = cli_section(c, "output");
    cli_put_u64(in, "shards", m->shards);
    cli_put_u64(in, "bytes", m->bytes_read);
    cli_put_u64(out, "bytes", bytes);
    cli_put_u64(out, "depth", m->info.depth);
    cli_put_u64(out, "chunks", m->counts.chunks);
    cli_put_u64(out, "voxels", m->counts.nodes[m->info.depth]);
}

static const char *const disks[] = {"fast", "small", NULL};

typedef struct tool_options {
    const char *list;
    int disk;
    bool has_disk;
    uint64_t level;
} tool_options;

typedef struct told { cli *c; uint64_t bytes; } told; /* of the file that is recoded; 0: unknown */

static void shards_done(void *user, uint64_t done, uint64_t total) { cli_progress_steps(((told *)user)->c, "merging", done, total, (double)done / (double)total); }

static void bytes_read(void *user, uint64_t done, uint64_t total)
{
    const told *t = user;
    (void)total;
    cli_progress(t->c, "recoding", t->bytes != 0 ? (double)done / (double)t->bytes : -1);
}

/* One octree to another form. */
static svo_result recode(cli *c, const tool_options *o, const char *path, fmt_output *out, const svo_allocator *a, fmt_svo_merge_report *m, svo_error *err)
{
    fmt_input *in = NULL;
    struct stat st;
    told t = {c, stat(path, &st) == 0 && S_ISREG(st.st_mode) ? (uint64_t)st.st_size : 0};
    fmt_svo_recode_options r = {.small = o->disk != 0, .level = (int)o->level, .threads = (uint32_t)c->threads, .allocator = a, .watch = {bytes_read, &t}};
    SVO_TRY(fmt_input_open(path, &in, err));
    svo_error inner = {0};
    svo_result result = fmt_svo_recode(in, out, &r, &m->counts, &m->info, &inner);
    if (result != SVO_OK) svo_fail(err, result, "%.90s: %s", path, inner.message);
    m->shards = 1;
    m->bytes_read = fmt_input_offset(in);
    fmt_input_close(in);
    return result;
}

static svo_result run(cli *c, const tool_options *o, svo_error *err)
{
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, c->memory != 0 ? c->memory : UINT64_MAX, NULL);
    names n = {0};
    fmt_output *out = NULL;
    fmt_svo_merge_report m = {0};
    cli_phase(c, o->has_disk ? "recode" : "merge");
    svo_result r = collect(c, o->list, &n, err);
    if (r == SVO_OK && o->has_disk && n.count != 1)
        r = svo_fail(err, SVO_INVALID_ARGUMENT, "--disk takes one octree; merge the shards first");
    if (r == SVO_OK) r = fmt_output_open(c->output, c->force, &out, err);
    if (r == SVO_OK && o->has_disk) r = recode(c, o, n.list[0], out, &limit.base, &m, err);
    else if (r == SVO_OK) r = fmt_svo_merge(n.list, n.count, out, &limit.base, &(fmt_svo_watch){shards_done, &(told){c, 0}}, &m, err);
    if (r == SVO_OK) {
        report(c, &m, fmt_output_offset(out));
        r = fmt_output_commit(out, err);
        out = NULL;
    }
    fmt_output_discard(out);
    free(n.list);
    free(n.bytes);
    cli_phase(c, NULL);
    if (r == SVO_OUT_OF_MEMORY && c->memory != 0) {
        char why[200];
        snprintf(why, sizeof why, "%.199s", err->message);
        r = svo_fail(err, SVO_LIMIT, "--memory is too small: %s", why);
    }
    return r;
}

int main(int argc, char **argv)
{
    tool_options o = {0};
    cli_option options[] = {
        {.name = "list", .kind = CLI_TEXT, .value = &o.list, .argument = "FILE", .no_default = true,
         .help = "Names of more shards, one a line; - is stdin. For more of them than a command line holds."},
        {.name = "disk", .kind = CLI_CHOICE, .value = &o.disk, .choices = disks, .argument = "FORM", .seen = &o.has_disk, .no_default = true,
         .help = "Write the one octree (or shard) that is given again, fast to read or small."},
        {.name = "level", .kind = CLI_U64, .value = &o.level, .argument = "L", .max = 19, .help = "With --disk: 0 packs values, 1 to 19 compresses everything with zstd."},
    };
    cli_tool tool = {
        .name = "svo-merge",
        .summary = "Join the shards of a voxelization to one octree.",
        .synopsis = "SHARD... -o OUT.svo [options]\nIN.svo -o OUT.svo --disk fast|small",
        .options = options,
        .option_count = sizeof options / sizeof *options,
        .details = "Takes all the files that svo-voxelize --shard 1/N to N/N wrote, in any order, and writes the bytes that one run without --shard would have "
                   "written. A shard that is missing, there twice or of another job is an error. Chunks are copied without decoding them.",
        .example = "svo-merge part-*.svo -o model.svo\nls parts/*.svo | svo-merge --list - -o model.svo",
        .min_inputs = 0,
        .max_inputs = -1,
        .has_output = true,
    };
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    if (c.input_count == 0 && o.list == NULL) return cli_usage(&c, "no input given");
    svo_error err = {0};
    svo_result r = run(&c, &o, &err);
    return cli_end(&c, r, &err);
}
