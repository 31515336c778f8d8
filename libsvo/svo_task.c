#define _GNU_SOURCE
#include "svo_task.h"

#include <pthread.h>
#include <sched.h>
#include <stdlib.h>
#include <string.h>

#include "svoi_thread_pool.h"

uint32_t svo_processor_count(void)
{
    cpu_set_t set;
    CPU_ZERO(&set);
    if (sched_getaffinity(0, sizeof set, &set) != 0) return 1;
    int n = CPU_COUNT(&set);
    return n > 0 ? (uint32_t)n : 1;
}

enum { SVOI_MAX_THREADS = 256 };

static uint32_t clamp_threads(uint32_t threads)
{
    if (threads == 0) threads = svo_processor_count();
    return threads > SVOI_MAX_THREADS ? SVOI_MAX_THREADS : threads;
}

/* --- parallel for --------------------------------------------------------------------------------------------- */

typedef struct loop {
    uint64_t count, grain, next; /* next: first item not yet claimed (atomic) */
    svo_range_fn fn;
    void *user;
    pthread_mutex_t lock; /* guards the three below */
    uint64_t failed_at;
    svo_result result;
    svo_error error;
} loop;

typedef struct loop_worker {
    loop *loop;
    uint32_t index;
} loop_worker;

static void loop_run(loop *l, uint32_t worker)
{
    for (;;) {
        uint64_t begin = __atomic_fetch_add(&l->next, l->grain, __ATOMIC_RELAXED);
        if (begin >= l->count) return;
        uint64_t end = l->count - begin < l->grain ? l->count : begin + l->grain;
        svo_error err = {0};
        svo_result r = l->fn(l->user, begin, end, worker, &err);
        if (r != SVO_OK) {
            pthread_mutex_lock(&l->lock);
            if (l->result == SVO_OK || begin < l->failed_at) {
                l->result = r;
                l->failed_at = begin;
                l->error = err;
            }
            pthread_mutex_unlock(&l->lock);
            /* Blocks are claimed in job, so every block before this one has been claimed and will be finished. */
            __atomic_store_n(&l->next, l->count, __ATOMIC_RELAXED);
            return;
        }
    }
}

static void loop_job(void *arg)
{
    loop_worker *w = arg;
    loop_run(w->loop, w->index);
}

svo_result svo_parallel_for(uint32_t threads, uint64_t count, uint64_t grain, svo_range_fn fn, void *user, svo_error *err)
{
    if (count == 0) return SVO_OK;
    threads = clamp_threads(threads);
    if (grain == 0) {
        grain = count / ((uint64_t)threads * 4);
        if (grain == 0) grain = 1;
    }
    uint64_t blocks = (count - 1) / grain + 1;
    if (blocks < threads) threads = (uint32_t)blocks;
    if (count > UINT64_MAX / 2 || grain > UINT64_MAX / 4 / SVOI_MAX_THREADS)
        return svo_fail(err, SVO_LIMIT, "a loop over %llu items is too long", (unsigned long long)count);

    loop l = {.count = count, .grain = grain, .fn = fn, .user = user};
    pthread_mutex_init(&l.lock, NULL);
    svoi_pool_job job[SVOI_MAX_THREADS];
    loop_worker worker[SVOI_MAX_THREADS];
    uint32_t started = 1;
    for (; started < threads; started++) {
        worker[started] = (loop_worker){&l, started};
        job[started] = (svoi_pool_job){.fn = loop_job, .arg = &worker[started]};
        if (!svoi_pool_start(&job[started])) break; /* fewer will do */
    }
    loop_run(&l, 0);
    for (uint32_t i = 1; i < started; i++) svoi_pool_wait(&job[i]);
    pthread_mutex_destroy(&l.lock);
    if (l.result != SVO_OK && err != NULL) *err = l.error;
    return l.result;
}

/* --- beside --------------------------------------------------------------------------------------------------- */

struct svo_async {
    svoi_pool_job job;
    bool ended;
};

svo_async *svo_async_start(void (*fn)(void *user), void *user)
{
    svo_async *b = malloc(sizeof *b);
    if (b != NULL) {
        *b = (svo_async){.job = {.fn = fn, .arg = user}};
        if (svoi_pool_start(&b->job)) return b;
        free(b);
    }
    fn(user);
    return NULL;
}

void svo_async_wait(svo_async *b)
{
    if (b == NULL || b->ended) return;
    svoi_pool_wait(&b->job);
    b->ended = true;
}

void svo_async_free(svo_async *b)
{
    svo_async_wait(b);
    free(b);
}

/* --- ordered pipeline ----------------------------------------------------------------------------------------- */

typedef enum slot_state { SLOT_FREE, SLOT_BUSY, SLOT_DONE } slot_state;

typedef struct pipe_run {
    const svo_pipeline *p;
    uint8_t *items;
    slot_state *state;
    uint32_t window;
    pthread_mutex_t lock;
    pthread_cond_t wake;
    uint64_t produced, started, committed;
    uint32_t ready; /* items to have produced before they are worked on */
    bool producing, committing, ended;
    svo_result result;
    uint64_t failed_at;
    svo_error error;
} pipe_run;

typedef struct pipe_worker {
    pipe_run *run;
    uint32_t index;
} pipe_worker;

/* Lock held. The failure of the earliest item wins, so that the outcome does not depend on timing. */
static void pipe_failed(pipe_run *r, svo_result result, uint64_t at, const svo_error *err)
{
    if (r->result == SVO_OK || at < r->failed_at) {
        r->result = result;
        r->failed_at = at;
        r->error = *err;
    }
    r->ended = true;
}

static void pipe_work(pipe_run *r, uint32_t worker)
{
    const svo_pipeline *p = r->p;
    pthread_mutex_lock(&r->lock);
    for (;;) {
        /* Commit first: it frees slots. */
        uint64_t at = r->committed;
        if (!r->committing && at < r->produced && r->state[at % r->window] == SLOT_DONE) {
            bool skip = r->result != SVO_OK && at >= r->failed_at;
            r->committing = true;
            svo_result result = SVO_OK;
            svo_error err = {0};
            if (!skip) {
                pthread_mutex_unlock(&r->lock);
                result = p->commit(p->user, r->items + (at % r->window) * p->item_size, &err);
                pthread_mutex_lock(&r->lock);
            }
            if (result != SVO_OK) pipe_failed(r, result, at, &err);
            r->state[at % r->window] = SLOT_FREE;
            r->committed++;
            r->committing = false;
            pthread_cond_broadcast(&r->wake);
            continue;
        }
        /* Then keep some items ready, so that nobody waits while one takes long to produce. */
        if (!r->ended && !r->producing && r->produced - r->committed < r->window && r->produced - r->started < r->ready) {
            uint64_t id = r->produced;
            void *item = r->items + (id % r->window) * p->item_size;
            r->producing = true;
            pthread_mutex_unlock(&r->lock);
            svo_error err = {0};
            bool more = true;
            svo_result result = p->produce(p->user, item, &more, &err);
            pthread_mutex_lock(&r->lock);
            r->producing = false;
            if (result != SVO_OK) pipe_failed(r, result, id, &err);
            if (result != SVO_OK || !more) {
                r->ended = true;
            } else {
                r->state[id % r->window] = SLOT_BUSY;
                r->produced++;
            }
            pthread_cond_broadcast(&r->wake);
            continue;
        }
        if (r->started < r->produced) {
            uint64_t id = r->started++;
            void *item = r->items + (id % r->window) * p->item_size;
            bool skip = r->result != SVO_OK && id >= r->failed_at;
            if (!skip) {
                svo_error err = {0};
                pthread_mutex_unlock(&r->lock);
                svo_result result = p->work(p->user, item, worker, &err);
                pthread_mutex_lock(&r->lock);
                if (result != SVO_OK) pipe_failed(r, result, id, &err);
            }
            r->state[id % r->window] = SLOT_DONE;
            pthread_cond_broadcast(&r->wake);
            continue;
        }
        if (r->ended && !r->producing && r->committed == r->produced) break;
        pthread_cond_wait(&r->wake, &r->lock);
    }
    pthread_mutex_unlock(&r->lock);
}

static void pipe_job(void *arg)
{
    pipe_worker *w = arg;
    pipe_work(w->run, w->index);
}

svo_result svo_pipeline_run(const svo_pipeline *p, svo_error *err)
{
    uint32_t threads = clamp_threads(p->threads);
    pipe_run r = {.p = p, .window = p->window != 0 ? p->window : threads * 4};
    r.ready = r.window < 2 * threads ? (r.window + 1) / 2 : r.window > 4 * threads ? r.window / 2 : threads;
    r.items = calloc(r.window, p->item_size != 0 ? p->item_size : 1);
    r.state = calloc(r.window, sizeof *r.state);
    if (r.items == NULL || r.state == NULL) {
        free(r.items);
        free(r.state);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a pipeline of %u items", r.window);
    }
    pthread_mutex_init(&r.lock, NULL);
    pthread_cond_init(&r.wake, NULL);
    svoi_pool_job job[SVOI_MAX_THREADS];
    pipe_worker worker[SVOI_MAX_THREADS];
    uint32_t started = 1;
    for (; started < threads; started++) {
        worker[started] = (pipe_worker){&r, started};
        job[started] = (svoi_pool_job){.fn = pipe_job, .arg = &worker[started]};
        if (!svoi_pool_start(&job[started])) break;
    }
    pipe_work(&r, 0);
    for (uint32_t i = 1; i < started; i++) svoi_pool_wait(&job[i]);
    if (p->destroy != NULL)
        for (uint32_t i = 0; i < r.window; i++) p->destroy(p->user, r.items + (size_t)i * p->item_size);
    pthread_cond_destroy(&r.wake);
    pthread_mutex_destroy(&r.lock);
    free(r.items);
    free(r.state);
    if (r.result != SVO_OK && err != NULL) *err = r.error;
    return r.result;
}
