/* Runs steps: as many at a time as jobs and memory allow, each as a process of its own. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "build.h"
#include "fmt_file.h"

extern char **environ;

typedef struct runner {
    cli *c;
    build_plan *p;
    const build_options *o;
    build_totals *totals;
    uint64_t jobs, budget, share, running, memory_used, finished;
    uint64_t threads; /* of each step */
    uint32_t *open;   /* steps that are not settled, in order */
    uint32_t open_count;
} runner;

static const char *state_word(build_state s)
{
    switch (s) {
    case BUILD_WAITING: return "waiting";
    case BUILD_RUNNING: return "running";
    case BUILD_CURRENT: return "current";
    case BUILD_STALE: return "stale";
    case BUILD_BUILT: return "built";
    case BUILD_FAILED: return "failed";
    case BUILD_SKIPPED: return "skipped";
    }
    return "?";
}

/* Will the same run fail again? A tool says so by its exit code: wrong options, a bad file, something unsupported, a limit. What the machine did (disk, memory,
 * a signal) may go better next time. */
static bool is_bad_input(int code) { return code == 1 || code == 3 || code == 5 || code == 6; }

/* The tool's own account of a failure. */
static json_t *read_report(const build_step *s)
{
    json_t *report = json_load_file(s->report, 0, NULL);
    return report;
}

static uint64_t memory_of(const runner *r, const build_step *s)
{
    if (s->alone) return r->budget;
    return r->budget == 0 ? s->memory : s->memory != 0 ? s->memory : r->share;
}

static void print_result(const runner *r, const build_step *s, int code, const char *why, double seconds)
{
    json_t *o = json_object();
    cli_put_text(o, "asset", s->asset);
    cli_put_text(o, "step", build_words[s->kind]);
    cli_put_text(o, "state", state_word(s->state));
    cli_put_text(o, "output", s->output);
    if (s->key[0] != 0) cli_put_text(o, "key", s->key);
    if (s->state == BUILD_BUILT || s->state == BUILD_FAILED) {
        cli_put_f64(o, "seconds", seconds);
        cli_put_u64(o, "tries", s->tries);
        uint64_t memory = memory_of(r, s);
        if (memory != 0) cli_put_u64(o, "memory", memory);
        if (s->peak != 0) cli_put_u64(o, "peak_rss_bytes", s->peak);
        json_t *report = read_report(s);
        if (report != NULL && s->state == BUILD_BUILT) {
            json_t *out = json_object_get(report, "output");
            if (json_object_get(out, "bytes") != NULL) json_object_set(o, "bytes", json_object_get(out, "bytes"));
            json_object_set_new(o, "warnings", json_integer((json_int_t)json_array_size(json_object_get(report, "warnings"))));
        }
        json_decref(report);
    }
    if (s->state == BUILD_FAILED) {
        json_object_set_new(o, "exit_code", code >= 0 ? json_integer(code) : json_null());
        if (code < 0) cli_put_u64(o, "signal", (uint64_t)-code);
        cli_put_text(o, "because", is_bad_input(code) ? "bad input" : "bad luck");
        cli_put_text(o, "log", s->log);
    }
    if (why != NULL) cli_put_text(o, "message", why);
    char *line = json_dumps(o, JSON_COMPACT | JSON_PRESERVE_ORDER);
    if (line != NULL) puts(line);
    fflush(stdout);
    free(line);
    json_decref(o);
}

static bool needs_settled(const runner *r, const build_step *s, bool *failed)
{
    *failed = false;
    for (int64_t i = s->first_need; i >= 0 && i < s->first_need + s->need_count; i++) {
        const build_step *n = &r->p->steps[i];
        if (n->state == BUILD_WAITING || n->state == BUILD_RUNNING) return false;
        if (n->state == BUILD_FAILED || n->state == BUILD_SKIPPED) *failed = true;
    }
    return true;
}

static bool needs_stale(const runner *r, const build_step *s)
{
    for (int64_t i = s->first_need; i >= 0 && i < s->first_need + s->need_count; i++)
        if (r->p->steps[i].state == BUILD_STALE) return true;
    return false;
}

static svo_result start(runner *r, build_step *s, svo_error *err)
{
    char tool[4096];
    snprintf(tool, sizeof tool, "%s/%s", r->o->tools, build_tools[s->kind]);
    char **arguments = build_arguments(s, tool, r->threads, memory_of(r, s), true);
    if (arguments == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory to start a step");
    int log = open(s->log, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (log < 0) {
        build_arguments_free(arguments);
        return svo_fail(err, SVO_IO, "%.150s cannot be written: %s", s->log, strerror(errno));
    }
    unlink(s->depfile), unlink(s->report); /* those of an earlier run say nothing about this one */
    fflush(NULL);
    pid_t parent = getpid(), pid = fork();
    if (pid == 0) { /* only calls that are safe between fork and exec */
        prctl(PR_SET_PDEATHSIG, SIGKILL); /* when this program is killed, its steps are too */
        if (getppid() != parent) _exit(127);
        int none = open("/dev/null", O_RDONLY);
        dup2(none, 0);
        dup2(log, 1);
        dup2(log, 2);
        signal(SIGPIPE, SIG_DFL);
        execve(arguments[0], arguments, environ);
        _exit(127);
    }
    int error = errno;
    close(log);
    build_arguments_free(arguments);
    if (pid < 0) return svo_fail(err, SVO_RUNTIME, "no process could be started: %s", strerror(error));
    s->pid = pid;
    s->started = svo_seconds();
    s->state = BUILD_RUNNING;
    s->tries++;
    r->running++;
    r->memory_used += memory_of(r, s);
    return SVO_OK;
}

/* A step has ended with an exit code, or minus a signal. */
static void settle(runner *r, build_step *s, int code)
{
    double seconds = svo_seconds() - s->started;
    s->took = seconds;
    svo_error inner = {0};
    char why[400] = "";
    if (code == 0) {
        svo_result noted = build_step_note(s, &inner);
        s->state = noted == SVO_OK ? BUILD_BUILT : BUILD_FAILED;
        if (noted != SVO_OK) snprintf(why, sizeof why, "%s", inner.message), code = svo_result_exit_code(noted);
    } else {
        s->state = BUILD_FAILED;
        json_t *report = read_report(s);
        const char *message = json_string_value(json_object_get(report, "error"));
        if (message != NULL) snprintf(why, sizeof why, "%s", message);
        else if (code == 127) snprintf(why, sizeof why, "%s could not be started from %.200s", build_tools[s->kind], r->o->tools);
        else if (code < 0) snprintf(why, sizeof why, "killed by signal %d (%s)", -code, strsignal(-code));
        else snprintf(why, sizeof why, "see its log");
        json_decref(report);
    }
    /* Over a limit, out of memory, or killed (by the system, where that ran out of memory): all of the budget may do. */
    if (s->state == BUILD_FAILED && (code == 4 || code == 6 || code == -SIGKILL) && !s->alone && memory_of(r, s) < r->budget && s->tries <= r->o->retries) {
        cli_verbose(r->c, "%s %s: %s; trying again with the whole budget", build_words[s->kind], s->asset, why);
        s->alone = true;
        s->state = BUILD_WAITING;
        return;
    }
    if (s->state == BUILD_FAILED && !is_bad_input(code) && s->tries <= r->o->retries) {
        cli_verbose(r->c, "%s %s: %s; trying again", build_words[s->kind], s->asset, why);
        s->state = BUILD_WAITING;
        return;
    }
    if (s->state == BUILD_BUILT) r->totals->built++;
    else if (is_bad_input(code)) r->totals->bad_input++;
    else r->totals->bad_luck++;
    r->finished++;
    print_result(r, s, code, why[0] != 0 ? why : NULL, seconds);
}

/* Wait for one step to end. */
static svo_result reap(runner *r, svo_error *err)
{
    int status;
    pid_t pid;
    struct rusage usage = {0};
    do pid = wait4(-1, &status, 0, &usage);
    while (pid < 0 && errno == EINTR);
    if (pid < 0) return svo_fail(err, SVO_RUNTIME, "waiting for a step failed: %s", strerror(errno));
    for (uint32_t i = 0; i < r->p->count; i++) {
        build_step *s = &r->p->steps[i];
        if (s->state != BUILD_RUNNING || s->pid != pid) continue;
        r->running--;
        r->memory_used -= memory_of(r, s);
        s->peak = (uint64_t)usage.ru_maxrss << 10;
        uint64_t memory = memory_of(r, s);
        if (memory != 0 && s->peak > memory) svo_warn(&r->c->warnings, "%s %s took %llu MiB of memory, more than its %llu", build_words[s->kind], s->asset,
                                                      (unsigned long long)(s->peak >> 20), (unsigned long long)(memory >> 20));
        if (s->peak > r->totals->peak) r->totals->peak = s->peak;
        settle(r, s, WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status));
        break;
    }
    return SVO_OK;
}

/* What a killed run left beside the files of a step. */
static void remove_leftovers(const build_step *s)
{
    const char *const files[] = {s->output, s->state_path, s->report, s->depfile};
    for (size_t i = 0; i < sizeof files / sizeof files[0]; i++) fmt_output_remove_leftovers(files[i]);
}

/* Look at one waiting step; *progress when its state changed. */
static svo_result consider(runner *r, build_step *s, bool *progress, svo_error *err)
{
    bool failed;
    if (!needs_settled(r, s, &failed)) return SVO_OK;
    if (failed) {
        s->state = BUILD_SKIPPED;
        r->totals->skipped++;
        r->finished++;
        print_result(r, s, 0, s->kind == BUILD_PACK ? "an asset failed" : "an earlier step of it failed", 0);
        return *progress = true, SVO_OK;
    }
    if (s->tries == 0 && !r->o->dry_run) remove_leftovers(s);
    if (s->tries == 0 && !needs_stale(r, s) && build_step_current(s)) {
        s->state = BUILD_CURRENT;
        r->totals->current++;
        r->finished++;
        print_result(r, s, 0, NULL, 0);
        return *progress = true, SVO_OK;
    }
    if (r->o->dry_run) {
        s->state = BUILD_STALE;
        r->totals->stale++;
        r->finished++;
        print_result(r, s, 0, NULL, 0);
        return *progress = true, SVO_OK;
    }
    uint64_t memory = memory_of(r, s);
    if (r->running >= r->jobs || (r->budget != 0 && r->running != 0 && r->memory_used + memory > r->budget)) return SVO_OK;
    SVO_TRY(start(r, s, err));
    return *progress = true, SVO_OK;
}

/* --- how far it is --- */

/* What the steps took when they last ran, by their reports. Read before any of these is replaced, and only where progress is shown. */
static void expect(runner *r)
{
    if (!cli_progress_wanted(r->c)) return;
    for (uint32_t i = 0; i < r->p->count; i++) {
        json_t *report = read_report(&r->p->steps[i]);
        r->p->steps[i].expected = json_number_value(json_object_get(report, "wall_seconds"));
        json_decref(report);
    }
}

/* Seconds of work of a step: measured now, else by an earlier run, else as the others of its kind. */
static void show_progress(runner *r)
{
    if (!cli_progress_wanted(r->c)) return;
    double sum[BUILD_KINDS] = {0}, known[BUILD_KINDS] = {0}, all_sum = 0, all_known = 0, done = 0, total = 0;
    for (uint32_t i = 0; i < r->p->count; i++) {
        const build_step *s = &r->p->steps[i];
        double seconds = s->took > 0 ? s->took : s->expected;
        if (seconds > 0) sum[s->kind] += seconds, known[s->kind]++, all_sum += seconds, all_known++;
    }
    double now = svo_seconds();
    for (uint32_t i = 0; i < r->p->count; i++) {
        const build_step *s = &r->p->steps[i];
        if (s->state == BUILD_CURRENT || s->state == BUILD_SKIPPED || s->state == BUILD_STALE) continue; /* no work */
        double seconds = s->took > 0 ? s->took : s->expected > 0 ? s->expected : known[s->kind] > 0 ? sum[s->kind] / known[s->kind] : all_known > 0 ? all_sum / all_known : 1;
        total += seconds;
        if (s->state == BUILD_BUILT || s->state == BUILD_FAILED) done += seconds;
        else if (s->state == BUILD_RUNNING) done += now - s->started < 0.95 * seconds ? now - s->started : 0.95 * seconds;
    }
    cli_progress_steps(r->c, "building", r->finished, r->p->count, total > 0 ? done / total : -1);
}

/* Look at all waiting steps. */
static svo_result sweep(runner *r, bool *progress, svo_error *err)
{
    uint32_t kept = 0;
    svo_result result = SVO_OK;
    for (uint32_t i = 0; i < r->open_count; i++) {
        build_step *s = &r->p->steps[r->open[i]];
        bool full = r->running >= r->jobs;
        if (s->state == BUILD_WAITING && result == SVO_OK && !full) result = consider(r, s, progress, err);
        if (s->state == BUILD_WAITING || s->state == BUILD_RUNNING) r->open[kept++] = r->open[i];
        if (i % 64 == 0) show_progress(r);
    }
    r->open_count = kept;
    show_progress(r);
    return result;
}

static svo_result loop(runner *r, svo_error *err)
{
    while (r->open_count != 0) {
        bool progress = false;
        SVO_TRY(sweep(r, &progress, err));
        if (r->running != 0 && (!progress || r->running >= r->jobs)) SVO_TRY(reap(r, err));
        else if (!progress && r->open_count != 0) return svo_fail(err, SVO_RUNTIME, "steps wait for each other"); /* cannot be */
    }
    return SVO_OK;
}

static svo_result make_folder(const char *path, svo_error *err)
{
    char part[4096];
    size_t n = strlen(path);
    if (n >= sizeof part) return svo_fail(err, SVO_INVALID_DATA, "the output folder's name is too long");
    for (size_t i = 1; i <= n; i++) {
        if (path[i] != '/' && path[i] != 0) continue;
        memcpy(part, path, i);
        part[i] = 0;
        if (mkdir(part, 0777) != 0 && errno != EEXIST) return svo_fail(err, SVO_IO, "folder %.150s cannot be made: %s", part, strerror(errno));
    }
    return SVO_OK;
}

static void stop_all(runner *r)
{
    for (uint32_t i = 0; i < r->p->count; i++) {
        build_step *s = &r->p->steps[i];
        if (s->state != BUILD_RUNNING) continue;
        kill(s->pid, SIGKILL);
        waitpid(s->pid, NULL, 0);
        s->state = BUILD_WAITING;
    }
}

svo_result build_run(cli *c, build_plan *p, const build_options *o, build_totals *totals, svo_error *err)
{
    runner r = {.c = c, .p = p, .o = o, .totals = totals, .jobs = o->jobs, .budget = o->memory, .share = o->jobs != 0 ? o->memory / o->jobs : 0};
    memset(totals, 0, sizeof *totals);
    r.threads = o->threads > o->jobs ? o->threads / o->jobs : 1;
    if (!o->dry_run) SVO_TRY(make_folder(p->work, err));
    char lock_path[4096];
    snprintf(lock_path, sizeof lock_path, "%s/lock", p->work);
    int lock = o->dry_run ? -1 : open(lock_path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (!o->dry_run && (lock < 0 || flock(lock, LOCK_EX | LOCK_NB) != 0)) {
        svo_result f = svo_fail(err, SVO_IO, errno == EWOULDBLOCK ? "another svo-build works in %.150s" : "%.150s cannot be written", p->work);
        if (lock >= 0) close(lock);
        return f;
    }
    r.open = calloc((size_t)p->count + 1, sizeof *r.open);
    svo_result result = r.open != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    for (uint32_t i = 0; result == SVO_OK && i < p->count; i++) r.open[i] = i;
    r.open_count = p->count;
    expect(&r);
    if (result == SVO_OK) result = loop(&r, err);
    if (result != SVO_OK) stop_all(&r);
    free(r.open);
    if (lock >= 0) close(lock);
    return result;
}
