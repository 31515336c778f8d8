/* The skin that all tools share: options from one table (parsing, --help, ranges, defaults), exit codes, messages,
 * phases and the JSON report. docs/tools/common.md is the user's side of it.
 *
 *     int main(int argc, char **argv)
 *     {
 *         cli_option options[] = {{.name = "depth", .kind = CLI_U64, .value = &depth, ...}, ...};
 *         cli_tool tool = {.name = "svo-x", ..., .options = options, .option_count = ...};
 *         cli c;
 *         int code = cli_begin(&c, &tool, argc, argv);
 *         if (code >= 0) return code;
 *         if (wrong combination) return cli_usage(&c, "--this needs --that");
 *         svo_error err = {0};
 *         return cli_end(&c, run(&c, &err), &err);
 *     }
 *
 * All functions belong to the main thread. */
#ifndef CLI_H
#define CLI_H

#include <stdio.h>

#include <jansson.h>

#include "svo_base.h"
#include "svo_stream.h"

typedef enum cli_kind {
    CLI_FLAG,   /* bool * */
    CLI_TEXT,   /* const char **, not empty */
    CLI_U64,    /* uint64_t *, decimal, min..max */
    CLI_DOUBLE, /* double *, min..max, finite */
    CLI_SIZE,   /* uint64_t *, bytes with K M G T (powers of 1024), min..max */
    CLI_CHOICE, /* int *, index into choices */
    CLI_VEC3    /* double[3], "x,y,z", finite */
} cli_kind;

/* One option. The default is what *value holds before parsing; the help text prints it from there. */
typedef struct cli_option {
    const char *name; /* without "--" */
    char letter;      /* 0 = none */
    cli_kind kind;
    void *value;
    const char *argument; /* placeholder in the help, e.g. "D"; NULL for flags */
    const char *help;     /* one sentence */
    double min, max;      /* U64, DOUBLE, SIZE; both 0 = unlimited; max may be INFINITY */
    const char *const *choices; /* NULL-terminated */
    bool *seen;           /* set when given; may be NULL */
    bool no_default;      /* do not print a default; null in the report unless given */
    const char *group;    /* heading in the help; NULL = "Options" */
} cli_option;

typedef struct cli_tool {
    const char *name, *summary; /* "svo-dump", one sentence */
    const char *synopsis;       /* after the name: "FILE [--json] ..."; a line for each way to call it */
    const cli_option *options;
    size_t option_count;
    const char *details; /* more paragraphs for the help, may be NULL; lines are wrapped, "\n" starts a new one */
    const char *example; /* one or more command lines */
    int min_inputs, max_inputs; /* positional arguments; max -1 = any number */
    bool has_output;            /* takes -o OUT, which must then be given */
    bool output_optional;       /* the tool itself checks whether -o is needed */
} cli_tool;

struct fmt_output;

/* State of a run. Common options: -h --help, --version, -o --output, -f --force, -q --quiet, -v --verbose,
 * --threads N, --memory SIZE, --report R.json, --progress, --no-progress, --config FILE, --no-config. `--` ends options. Options may also be set by a file and by
 * the environment (docs/tools/common.md). */
typedef struct cli {
    const cli_tool *tool;
    const char **inputs; /* point into argv; "-" is stdin */
    int input_count;
    const char *output; /* NULL if not given */
    const char *report;
    bool force, quiet, progress, no_progress;
    int verbose;
    uint64_t threads; /* 0 = all */
    uint64_t memory;  /* bytes, 0 = no limit */
    svo_warnings warnings;
    json_t *json;     /* the report being built */
    double started, phase_started;
    const char *phase;
    /* private */
    const char *config;
    bool no_config;
    char *settings; /* text of the configuration file: options point into it */
    struct fmt_output *report_file;
    double progress_at, progress_begin, progress_from; /* seconds; fraction at progress_begin */
    char progress_what[64];
    uint64_t progress_done;
    bool progress_shown; /* a line that the next message must clear */
} cli;

/* Parse the text of an option's value as the command line does (sizes with K, M ...); false with a reason in why. */
bool cli_parse_text(const cli_option *o, const char *text, char why[200]);

/* Put the input's name before the message of a failure, unless it is there. Returns r. */
svo_result cli_about(const char *path, svo_result r, svo_error *err);

/* Parse, ignore SIGPIPE, open the report. Returns -1 to go on, otherwise the exit code to leave with: 0 after --help
 * and --version, 1 after a usage error, 2 when the report cannot be written; what is wrong has been printed and
 * nothing needs freeing. An output or report that is one of the inputs (also through a link) is a usage error. */
int cli_begin(cli *c, const cli_tool *tool, int argc, char **argv);

/* A usage error found by the tool itself: prints one line and "see --help", frees, returns 1. */
int cli_usage(cli *c, const char *format, ...) SVO_PRINTF(2, 3);

/* End the running phase (if any) and begin the next (NULL: none). Seconds go to phases[] of the report; a name that
 * comes again adds to its first entry. `name` must stay valid. */
void cli_phase(cli *c, const char *name);

/* Report sections. They are JSON objects that the tool fills: input, output, errors, and any other name. Borrowed. */
json_t *cli_section(cli *c, const char *name);
/* Set key in an object; numbers that are not finite become null. Bytes that are not UTF-8 become U+FFFD. */
void cli_put_u64(json_t *object, const char *key, uint64_t value);
void cli_put_f64(json_t *object, const char *key, double value);
void cli_put_text(json_t *object, const char *key, const char *value);
/* An entry of a list `left_out`: what of a channel is not in a file, how many values, and the bytes they would take. None for 0 values. */
void cli_put_saving(json_t *list, const char *what, const char *channel, uint64_t values, uint64_t bytes);
/* A JSON string from bytes that may not be UTF-8. New reference. */
json_t *cli_text(const char *value);

/* stderr, prefixed "tool: ". Info is silent under -q; verbose needs -v. */
void cli_info(const cli *c, const char *format, ...) SVO_PRINTF(2, 3);
/* An error beside the one that ends the run, to stderr. */
void cli_error(const cli *c, const char *format, ...) SVO_PRINTF(2, 3);
/* text without what a terminal would obey: control characters and bytes that are not UTF-8 become \xNN. Names of files, and those inside
 * models, come from strangers. Messages go through it by themselves; results for people that print such names must. */
void cli_write_plain(FILE *to, const char *text);
void cli_verbose(const cli *c, const char *format, ...) SVO_PRINTF(2, 3);
/* Progress on stderr with the time it took so far and the time that is left by it: at a terminal 6 times a second in place, with --progress elsewhere a line a
 * second; not under -q or --no-progress. `what` names one stretch of work; fraction < 0 = unknown. */
void cli_progress(cli *c, const char *what, double fraction);
/* The same with "done of total". Shown at once when all are done. */
void cli_progress_steps(cli *c, const char *what, uint64_t done, uint64_t total, double fraction);
/* Is there anybody to tell? */
bool cli_progress_wanted(const cli *c);
/* Chunks on their way through a sink or a source, told as progress: by the part of space that is done, or by the bytes read of `bytes` (0: unknown). Without
 * progress the inner one is returned as it is. *w must outlive it. */
typedef struct cli_watch {
    cli *c;
    const char *what;
    svo_chunk_sink sink;
    svo_chunk_source source;
    uint64_t bytes, total;
    _Atomic uint64_t reached;
    _Atomic uint32_t level;
} cli_watch;
svo_chunk_sink cli_watch_sink(cli_watch *w, cli *c, const char *what, svo_chunk_sink inner);
svo_chunk_source cli_watch_source(cli_watch *w, cli *c, const char *what, uint64_t bytes, svo_chunk_source inner);

/* JSON text for META: tool, version, options that influence the result (an object, stolen) and inputs (an array of
 * cli_provenance_input, stolen; may be NULL). Sorted keys, one line; NULL when out of memory; freed with free(). */
char *cli_provenance(const cli *c, json_t *options, json_t *inputs);
/* The same with what was left out (an array, stolen; NULL: it does not say). */
char *cli_provenance_with(const cli *c, json_t *options, json_t *inputs, json_t *left_out);
/* {"name": last part of path, "hash": hash}. hash may be NULL (left out). New reference. */
json_t *cli_provenance_input(const char *path, const char *hash);
/* The options as given and by default, {"depth": 8, ...}: those of the tool (common = false) or the common ones. New
 * reference. */
json_t *cli_options_json(const cli *c, bool common);

/* Print warnings (unless -q) and, on failure, "tool: error: message"; write the report (also on failure, so that a
 * pipeline sees why; its own failure is an I/O error, as is one of stdout); free; return the exit code. err may be
 * NULL when result is SVO_OK. */
int cli_end(cli *c, svo_result result, const svo_error *err);
/* The same with a given exit code (svo-compare's 7). */
int cli_end_code(cli *c, int exit_code);

#endif
