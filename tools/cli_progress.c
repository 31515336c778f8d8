/* How far a run is, and when it will be done. */
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "cli.h"
#include "svo_task.h"

enum { TERMINAL_RATE = 6, WAIT_FOR_ESTIMATE = 1 /* seconds */ };

/* "1:05", "2:03:00" */
static void clock_text(double seconds, char *out, size_t size)
{
    unsigned long long s = seconds > 0 && seconds < 1e9 ? (unsigned long long)(seconds + 0.5) : 0;
    if (s >= 3600) snprintf(out, size, "%llu:%02llu:%02llu", s / 3600, s / 60 % 60, s % 60);
    else snprintf(out, size, "%llu:%02llu", s / 60, s % 60);
}

bool cli_progress_wanted(const cli *c)
{
    if (c->quiet || c->no_progress) return false;
    return c->progress || isatty(STDERR_FILENO);
}

void cli_progress_steps(cli *c, const char *what, uint64_t done, uint64_t total, double fraction)
{
    if (!cli_progress_wanted(c)) return;
    bool terminal = isatty(STDERR_FILENO), begins = strcmp(c->progress_what, what) != 0, ends = total != 0 && done == total && c->progress_done != total;
    double now = svo_seconds();
    if (begins) {
        snprintf(c->progress_what, sizeof c->progress_what, "%s", what);
        c->progress_begin = now;
        c->progress_from = fraction > 0 ? fraction : 0;
    }
    if (!begins && !ends && now - c->progress_at < (terminal ? 1.0 / TERMINAL_RATE : 1)) return;
    c->progress_at = now;
    c->progress_done = done;
    c->progress_shown = terminal;
    char text[200], spent[32], left[32];
    size_t n = (size_t)snprintf(text, sizeof text, "%s", c->progress_what);
    if (total != 0 && n < sizeof text) n += (size_t)snprintf(text + n, sizeof text - n, " %llu of %llu", (unsigned long long)done, (unsigned long long)total);
    if (fraction >= 0 && n < sizeof text) n += (size_t)snprintf(text + n, sizeof text - n, " %3.0f%%", 100 * (fraction < 1 ? fraction : 1));
    double elapsed = now - c->progress_begin, made = fraction - c->progress_from;
    clock_text(elapsed, spent, sizeof spent);
    if (elapsed >= WAIT_FOR_ESTIMATE && n < sizeof text) {
        n += (size_t)snprintf(text + n, sizeof text - n, ", %s so far", spent);
        clock_text(made > 0 ? elapsed * (1 - fraction) / made : 0, left, sizeof left);
        if (made > 0.005 && fraction < 1 && n < sizeof text) snprintf(text + n, sizeof text - n, ", about %s left", left);
    }
    fprintf(stderr, terminal ? "\r\033[K%s: %s" : "%s: %s\n", c->tool->name, text);
    fflush(stderr);
}

void cli_progress(cli *c, const char *what, double fraction) { cli_progress_steps(c, what, 0, 0, fraction); }

/* --- chunks on their way --- */

/* Several chunks are encoded at once; the furthest counts. */
static svo_result watch_encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err)
{
    cli_watch *w = user;
    uint64_t end = svo_chunk_end(chunk), before = atomic_load_explicit(&w->reached, memory_order_relaxed);
    while (end > before && !atomic_compare_exchange_weak_explicit(&w->reached, &before, end, memory_order_relaxed, memory_order_relaxed)) {
    }
    atomic_store_explicit(&w->level, svo_chunk_level(chunk->depth), memory_order_relaxed);
    return w->sink.encode(w->sink.user, chunk, worker, blob, err);
}

static svo_result watch_commit(void *user, void *blob, svo_error *err)
{
    cli_watch *w = user;
    uint32_t level = atomic_load_explicit(&w->level, memory_order_relaxed);
    double all = (double)((uint64_t)1 << 3 * level);
    if (level != 0) cli_progress(w->c, w->what, (double)atomic_load_explicit(&w->reached, memory_order_relaxed) / all);
    return w->sink.commit(w->sink.user, blob, err);
}

static void watch_discard(void *user, void *blob)
{
    cli_watch *w = user;
    w->sink.discard(w->sink.user, blob);
}

svo_chunk_sink cli_watch_sink(cli_watch *w, cli *c, const char *what, svo_chunk_sink inner)
{
    if (!cli_progress_wanted(c)) return inner;
    *w = (cli_watch){.c = c, .what = what, .sink = inner};
    return (svo_chunk_sink){w, watch_encode, watch_commit, watch_discard};
}

static svo_result watch_fetch(void *user, svo_buffer *packed, bool *more, svo_error *err)
{
    cli_watch *w = user;
    svo_result r = w->source.fetch(w->source.user, packed, more, err);
    if (r != SVO_OK || !*more) return r;
    w->bytes += packed->size;
    cli_progress(w->c, w->what, w->total != 0 ? (double)w->bytes / (double)w->total : -1);
    return r;
}

static svo_result watch_decode(void *user, const svo_buffer *packed, svo_buffer *storage, svo_chunk *out, svo_error *err)
{
    cli_watch *w = user;
    return w->source.decode(w->source.user, packed, storage, out, err);
}

svo_chunk_source cli_watch_source(cli_watch *w, cli *c, const char *what, uint64_t bytes, svo_chunk_source inner)
{
    if (!cli_progress_wanted(c)) return inner;
    *w = (cli_watch){.c = c, .what = what, .total = bytes, .source = inner};
    return (svo_chunk_source){w, watch_fetch, watch_decode};
}
