/* Averaged views: what the averages that readers work out differ from those of the exact values, and the few that must be
 * stored because they are not within the channel's bound. */
#include <string.h>

#include "svo_task.h"
#include "svoi_dag.h"
#include "svoi_palette.h"

enum { JOBS = 4096, WINDOW = SVO_SUPERBLOCK };

typedef struct job {
    svo_view_node node;
    svo_buffer corrections;
    double sum, max;
    uint64_t count;
} job;

typedef struct run {
    const svo_view *v;
    uint32_t channel, level;
    svo_channel_kind kind;
    const svoi_values *values;
    double bound; /* 0: nothing is corrected */
    job *jobs;
    uint64_t count;
} run;

/* One worker's view of a stretch of values: exact, and as a reader sees them. */
typedef struct window {
    const run *r;
    job *j;
    uint64_t first; /* UINT64_MAX: nothing yet */
    uint32_t exact[WINDOW], stored[WINDOW];
    svo_result result;
    svo_error *err;
} window;

static bool look_at(window *w, uint64_t first)
{
    if (first == w->first) return true;
    const svoi_values *values = w->r->values;
    const uint64_t left = values->count - first;
    const uint32_t n = left < WINDOW ? (uint32_t)left : WINDOW;
    uint8_t buffer[4 * WINDOW];
    const uint8_t *p = svoi_values_get(values, first, n, buffer, w->err); /* windows do not straddle pages */
    if (p == NULL) {
        w->result = SVO_IO;
        return false;
    }
    for (uint32_t i = 0; i < n; i++, p += values->stride) w->exact[i] = svoi_load_value(p, values->stride);
    svo_view_values(w->r->v, w->r->channel, first, n, w->stored);
    w->first = first;
    return true;
}

/* svo_view_average_fn */
static bool compare(void *user, uint64_t attribute)
{
    window *w = user;
    const run *r = w->r;
    const uint32_t count = svo_average_voxels(attribute);
    const uint64_t index = svo_average_first(attribute);
    uint32_t exact[64], stored[64];
    for (uint32_t done = 0; done < count;) {
        const uint32_t at = (uint32_t)((index + done) % WINDOW), n = count - done < WINDOW - at ? count - done : WINDOW - at;
        if (!look_at(w, index + done - at)) return false;
        memcpy(exact + done, w->exact + at, n * sizeof *exact);
        memcpy(stored + done, w->stored + at, n * sizeof *stored);
        done += n;
    }
    w->j->count++;
    if (memcmp(exact, stored, count * sizeof *exact) == 0) return true;
    const uint32_t value = svoi_average(r->kind, exact, count);
    double error = svoi_error_of(r->kind, value, svoi_average(r->kind, stored, count));
    if (r->bound > 0 && error > r->bound) {
        uint8_t entry[SVO_CORRECTION];
        const uint64_t key = index << 6 | (count - 1);
        memcpy(entry, &key, sizeof key);
        memcpy(entry + 8, &value, sizeof value);
        if (svo_buffer_append(&w->j->corrections, entry, sizeof entry) == NULL) {
            w->result = SVO_OUT_OF_MEMORY;
            return false;
        }
        error = 0;
    }
    w->j->sum += error;
    if (error > w->j->max) w->j->max = error;
    return true;
}

static svo_result work(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    const run *r = user;
    window w = {.r = r, .first = UINT64_MAX, .err = err};
    (void)worker;
    for (uint64_t i = begin; i < end && w.result == SVO_OK; i++) {
        w.j = &r->jobs[i];
        svo_view_averages(r->v, r->level, w.j->node, compare, &w);
    }
    return w.result;
}

/* Nodes of the deepest level with at most JOBS of them, in depth-first order; full leaves above them have no averages. */
static bool make_jobs(run *r, const svo_allocator *a, job **room)
{
    const svo_view *v = r->v;
    while (r->level < v->brick_level && v->nodes[r->level + 1] <= JOBS) r->level++;
    const uint64_t most = v->depth < 2 ? 1 : v->nodes[r->level]; /* virtual levels: the root alone */
    *room = r->jobs = svo_calloc(a, most, sizeof *r->jobs);
    if (r->jobs == NULL) return false;
    svo_view_node stack[SVO_MAX_DEPTH + 1];
    uint8_t left[SVO_MAX_DEPTH + 1] = {0};
    uint32_t level = 0;
    stack[0] = svo_view_root(v);
    if (level == r->level) {
        r->jobs[r->count++].node = stack[0];
    } else {
        left[0] = svo_view_mask(v, 0, stack[0]);
        for (;;) {
            while (left[level] == 0 && level != 0) level--;
            if (left[level] == 0) break;
            const uint32_t octant = (uint32_t)__builtin_ctz(left[level]);
            left[level] &= (uint8_t)(left[level] - 1);
            const svo_view_node child = svo_view_child(v, level, stack[level], octant);
            if (child.full) continue;
            if (level + 1 == r->level) {
                r->jobs[r->count++].node = child;
                continue;
            }
            stack[++level] = child;
            left[level] = svo_view_mask(v, level, child);
        }
    }
    for (uint64_t i = 0; i < r->count; i++) svo_buffer_init(&r->jobs[i].corrections, a);
    return true;
}

svo_result svoi_correct_averages(svo_packed *p, uint32_t channel, const svoi_values *values, double bound, uint32_t threads,
                                 svo_dag_channel_report *report, svo_error *err)
{
    svo_view *v = &p->view;
    const svo_allocator *a = &p->memory.base;
    svo_buffer *out = &p->corrections[channel];
    job *room;
    if (!v->averaged || v->unnumbered || v->empty) return SVO_OK;
    run r = {.v = v, .channel = channel, .kind = v->channels[channel].channel.kind, .values = values, .bound = bound};
    if (!make_jobs(&r, a, &room)) return svoi_no_memory(p, "averages", err);
    const uint64_t jobs = v->depth < 2 ? 1 : v->nodes[r.level];
    svo_result result = svo_parallel_for(threads, r.count, 0, work, &r, err);
    if (result == SVO_OUT_OF_MEMORY) result = svoi_no_memory(p, "averages", err);
    double sum = report->error_mean * (double)values->count;
    uint64_t count = values->count;
    for (uint64_t i = 0; i < r.count; i++) {
        job *j = &r.jobs[i];
        if (result == SVO_OK && j->corrections.size != 0 && svo_buffer_append(out, j->corrections.data, j->corrections.size) == NULL)
            result = svoi_no_memory(p, "averages", err);
        svo_buffer_free(&j->corrections);
        sum += j->sum;
        count += j->count;
        if (j->max > report->error_max) report->error_max = j->max;
    }
    svo_free(a, room, jobs, sizeof *room);
    if (result != SVO_OK) return result;
    report->error_mean = sum / (double)count;
    report->corrections = out->size / SVO_CORRECTION;
    v->channels[channel].corrections = out->data;
    v->channels[channel].correction_count = report->corrections;
    report->bytes += out->size;
    return SVO_OK;
}
