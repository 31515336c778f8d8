/* Parts of svo-build: a manifest becomes steps (one run of a tool each), steps are compared with what is on disk, and those that are out of date are run. */
#ifndef BUILD_H
#define BUILD_H

#include "cli.h"

typedef enum build_kind { BUILD_VOXELIZE, BUILD_COMPRESS, BUILD_PACK, BUILD_KINDS } build_kind;
extern const char *const build_tools[BUILD_KINDS], *const build_words[BUILD_KINDS];

typedef enum build_state { BUILD_WAITING, BUILD_RUNNING, BUILD_CURRENT, BUILD_STALE, BUILD_BUILT, BUILD_FAILED, BUILD_SKIPPED } build_state;

/* One run of a tool. */
typedef struct build_step {
    build_kind kind;
    const char *asset;   /* name in the manifest; borrowed from it */
    char **inputs;       /* paths */
    uint32_t input_count;
    char **options;      /* "--depth=9" */
    uint32_t option_count;
    char *output, *state_path, *log, *report, *depfile;
    uint64_t memory;     /* bytes it may take, 0 = its share of the budget */
    int64_t first_need, need_count; /* steps whose outputs it reads: [first_need, first_need + need_count); -1: none */
    build_state state;
    uint32_t tries;
    bool alone;          /* its share of the budget was too little: it runs again with nothing beside it, and has all of the budget */
    uint64_t peak;       /* bytes resident at most, of the last try, as the system measured it */
    int pid;
    double started;
    double expected; /* seconds: of an earlier run of it; 0: not known */
    double took;     /* seconds of this run, once it has ended */
    char key[33];        /* of its inputs' content, options and version; empty before it is known */
} build_step;

typedef struct build_plan {
    json_t *manifest;
    char *folder;        /* of outputs */
    char *work;          /* folder of states, logs, reports, depfiles */
    build_step *steps;
    uint32_t count, capacity;
} build_plan;

/* Read a manifest: docs/tools/svo-build.md. Nothing is written. */
svo_result build_plan_read(const char *path, build_plan *out, svo_error *err);
void build_plan_free(build_plan *p);
/* Argument list of a step, NULL-terminated, to be freed with build_arguments_free. threads and memory 0: not given. `bookkeeping`: with --report. */
char **build_arguments(const build_step *s, const char *tool_path, uint64_t threads, uint64_t memory, bool bookkeeping);
void build_arguments_free(char **a);

/* Is what lies on disk what this step would make? By the state file of the run that made it: the same options and version, output as it was
 * written, and every file that was read with the content it had. A file whose size and time are those noted is not read again.
 * A file that cannot be read is no error: the step is out of date. */
bool build_step_current(build_step *s);
/* After a run: note what was made and read. Reads the depfile. */
svo_result build_step_note(build_step *s, svo_error *err);

typedef struct build_options {
    const char *tools;  /* folder */
    uint64_t jobs, threads, memory, retries;
    bool dry_run;
} build_options;

/* Run what is out of date and print one JSON line a step to stdout. Returns the exit code. */
typedef struct build_totals { uint64_t built, current, bad_input, bad_luck, skipped, stale, peak /* bytes resident, of one step */; } build_totals;
svo_result build_run(cli *c, build_plan *p, const build_options *o, build_totals *totals, svo_error *err);

/* Commands for another engine. */
typedef enum build_engine { BUILD_NINJA, BUILD_SH, BUILD_SLURM } build_engine;
svo_result build_emit(cli *c, const build_plan *p, const build_options *o, build_engine engine, svo_error *err);

#endif
