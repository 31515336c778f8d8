/* The skin that all tools share: options from one table (parsing, --help, ranges, defaults), exit codes, messages,
 * phases and the JSON report. */
#ifndef CLI_H
#define CLI_H

#include <jansson.h>

#include "svo_base.h"

typedef enum cli_kind {
    CLI_FLAG,   /* bool * */
    CLI_TEXT,   /* const char ** */
    CLI_U64,    /* uint64_t *, decimal, min..max */
    CLI_DOUBLE, /* double *, min..max, finite */
    CLI_SIZE,   /* uint64_t *, bytes with K M G T (powers of 1024) */
    CLI_CHOICE, /* int *, index into choices */
    CLI_VEC3    /* double[3], "x,y,z" */
} cli_kind;

/* One option. The default is what *value holds before parsing; the help text prints it from there. */
typedef struct cli_option {
    const char *name; /* without "--" */
    char letter;      /* 0 = none */
    cli_kind kind;
    void *value;
    const char *argument; /* placeholder in the help, e.g. "D"; NULL for flags */
    const char *help;     /* one sentence */
    double min, max;      /* U64 and DOUBLE; both 0 = unlimited */
    const char *const *choices; /* NULL-terminated */
    bool *seen;           /* set when given; may be NULL */
    bool no_default;      /* do not print a default */
    const char *group;    /* heading in the help; NULL = "Options" */
} cli_option;

typedef struct cli_tool {
    const char *name, *summary; /* "svo-dump", one sentence */
    const char *synopsis;       /* after the name: "FILE [--json] ..." */
    const cli_option *options;
    size_t option_count;
    const char *details; /* more paragraphs for the help, may be NULL */
    const char *example; /* one or more command lines */
    int min_inputs, max_inputs; /* positional arguments; max -1 = any number */
    bool has_output;            /* takes -o OUT */
} cli_tool;

/* State of a run. Common options: -h --help, --version, -o --output, -f --force, -q --quiet, -v --verbose,
 * --threads N, --memory SIZE, --report R.json, --no-progress. `--` ends options. */
typedef struct cli {
    const cli_tool *tool;
    const char **inputs; /* point into argv */
    int input_count;
    const char *output; /* NULL if not given */
    const char *report;
    bool force, quiet, no_progress;
    int verbose;
    uint64_t threads; /* 0 = all */
    uint64_t memory;  /* bytes, 0 = no limit */
    svo_warnings warnings;
    json_t *json;     /* the report being built */
    double started, phase_started;
    const char *phase;
} cli;

/* Parse. Returns -1 to go on, otherwise the exit code to leave with (0 after --help, 1 after a usage error, which
 * has been printed). */
int cli_begin(cli *c, const cli_tool *tool, int argc, char **argv);

/* A usage error found by the tool itself: prints one line and "see --help", frees, returns 1. */
int cli_usage(cli *c, const char *format, ...) SVO_PRINTF(2, 3);

/* End the running phase (if any) and begin the next (NULL: none). Seconds go to phases[] of the report. */
void cli_phase(cli *c, const char *name);

/* Report sections. They are JSON objects that the tool fills: input, output, errors, and any other name. Borrowed. */
json_t *cli_section(cli *c, const char *name);
/* Set key in an object; numbers that are not finite become null. */
void cli_put_u64(json_t *object, const char *key, uint64_t value);
void cli_put_f64(json_t *object, const char *key, double value);
void cli_put_text(json_t *object, const char *key, const char *value);

/* stderr, prefixed "tool: ". Info is silent under -q; verbose needs -v. */
void cli_info(const cli *c, const char *format, ...) SVO_PRINTF(2, 3);
void cli_verbose(const cli *c, const char *format, ...) SVO_PRINTF(2, 3);
/* Progress at a terminal only, at most 6 times a second, not under -q. */
void cli_progress(cli *c, const char *what, double fraction);

/* JSON text for META: tool, version, options that influence the result (given as an object, stolen) and inputs
 * (base name and content hash). Sorted keys; freed with free(). */
char *cli_provenance(const cli *c, json_t *options, json_t *inputs);

/* Print warnings and, on failure, "tool: error: message"; write the report (also on failure, so that a pipeline sees
 * why; its own failure is an I/O error); free; return the exit code. err may be NULL when result is SVO_OK. */
int cli_end(cli *c, svo_result result, const svo_error *err);
/* The same with a given exit code (svo-compare's 7). */
int cli_end_code(cli *c, int exit_code);

#endif
