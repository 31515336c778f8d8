/* svo-build: many assets from one manifest. */
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "build.h"
#include "fmt_file.h"
#include "svo_task.h"

static const char *const engines[] = {"none", "ninja", "sh", "slurm", NULL};

/* Folder of this program, where its siblings are. */
static bool own_folder(char *out, size_t size)
{
    ssize_t n = readlink("/proc/self/exe", out, size - 1);
    if (n <= 0) return false;
    out[n] = 0;
    char *slash = strrchr(out, '/');
    if (slash == NULL) return false;
    *slash = 0;
    return true;
}

static void report(cli *c, const build_totals *t, uint32_t steps)
{
    json_t *o = cli_section(c, "output");
    cli_put_u64(o, "steps", steps);
    cli_put_u64(o, "built", t->built);
    cli_put_u64(o, "current", t->current);
    cli_put_u64(o, "stale", t->stale);
    cli_put_u64(o, "bad_input", t->bad_input);
    cli_put_u64(o, "bad_luck", t->bad_luck);
    cli_put_u64(o, "skipped", t->skipped);
    cli_put_u64(o, "step_peak_rss_bytes", t->peak);
}

int main(int argc, char **argv)
{
    int engine = 0;
    char folder[4096];
    build_options b = {.retries = 1};
    cli_option options[] = {
        {.name = "jobs", .letter = 'j', .kind = CLI_U64, .value = &b.jobs, .argument = "N", .max = 1024, .help = "Steps to run at a time, 0 = one for each processor; --threads are divided among them."},
        {.name = "retries", .kind = CLI_U64, .value = &b.retries, .argument = "N", .max = 100, .help = "How often a step that failed by bad luck (disk, memory, a signal) is tried again."},
        {.name = "dry-run", .letter = 'n', .kind = CLI_FLAG, .value = &b.dry_run, .help = "Say what is out of date and run nothing."},
        {.name = "emit", .kind = CLI_CHOICE, .value = &engine, .argument = "ENGINE", .choices = engines, .help = "Write the commands for another engine to -o OUT or stdout, and run nothing."},
        {.name = "tools", .kind = CLI_TEXT, .value = &b.tools, .argument = "DIR", .no_default = true, .help = "Folder of the other tools; by default that of svo-build."},
    };
    cli_tool tool = {
        .name = "svo-build",
        .summary = "Build the assets of a manifest: what is out of date, in parallel, within a memory budget.",
        .synopsis = "MANIFEST.json [-j N] [--memory SIZE] [--dry-run] [--emit ninja|sh|slurm]",
        .options = options,
        .option_count = sizeof options / sizeof options[0],
        .details = "Prints one JSON line a step. A run that was killed is continued by the next one. --memory is for all steps together.\n"
                   "Exit code: 0 all is built; 3 some inputs are bad (trying again will not help); 4 something failed by bad luck (try again); 1, 2, 3 for the command line, the disk, the manifest.",
        .example = "svo-build assets.json -j 8 --memory 32G > results.jsonl\nsvo-build assets.json --emit ninja -o build.ninja && ninja",
        .min_inputs = 1, .max_inputs = 1, .has_output = true, .output_optional = true};
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    if (c.output != NULL && engine == 0) return cli_usage(&c, "-o goes with --emit; outputs of assets are named in the manifest");
    if (engine != 0 && b.dry_run) return cli_usage(&c, "--emit and --dry-run exclude each other");
    if (b.tools == NULL) {
        if (!own_folder(folder, sizeof folder)) return cli_usage(&c, "the folder of the tools is not known; name it with --tools");
        b.tools = folder;
    }
    uint64_t processors = svo_processor_count();
    if (b.jobs == 0) b.jobs = processors;
    b.threads = engine != 0 ? c.threads : c.threads != 0 ? c.threads : processors;
    b.memory = c.memory;
    build_plan plan;
    build_totals totals = {0};
    svo_error err = {0};
    cli_phase(&c, "plan");
    svo_result r = cli_about(c.inputs[0], build_plan_read(c.inputs[0], &plan, &err), &err);
    if (r != SVO_OK) return cli_end(&c, r, &err);
    cli_phase(&c, engine != 0 ? "emit" : "build");
    r = engine != 0 ? build_emit(&c, &plan, &b, (build_engine)(engine - 1), &err) : build_run(&c, &plan, &b, &totals, &err);
    cli_phase(&c, NULL);
    uint32_t steps = plan.count;
    build_plan_free(&plan);
    if (engine != 0 || r != SVO_OK) return cli_end(&c, r, &err);
    report(&c, &totals, steps);
    cli_info(&c, "%u steps: %llu built, %llu current, %llu out of date, %llu bad inputs, %llu failed by bad luck, %llu skipped", steps, (unsigned long long)totals.built,
             (unsigned long long)totals.current, (unsigned long long)totals.stale, (unsigned long long)totals.bad_input, (unsigned long long)totals.bad_luck,
             (unsigned long long)totals.skipped);
    return cli_end_code(&c, totals.bad_luck != 0 ? 4 : totals.bad_input != 0 ? 3 : 0);
}
