/* Threads that wait for work. They are detached and end by themselves when there is none for a second, so nothing has to close them. */
#define _GNU_SOURCE
#include "svoi_thread_pool.h"

#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <time.h>

enum { IDLE_SECONDS = 1 };

typedef struct worker {
    pthread_cond_t wake;
    svoi_pool_job *job; /* NULL: none yet */
    struct worker *next; /* waiting */
} worker;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t ended = PTHREAD_COND_INITIALIZER; /* some job is done */
static worker *waiting;                                   /* the last that came is the first to go: its caches are warm */
static pthread_once_t once = PTHREAD_ONCE_INIT;

/* A child of fork has one thread. What waited in the parent is lost to it, a few hundred bytes. */
static void in_child(void)
{
    static const pthread_mutex_t fresh_lock = PTHREAD_MUTEX_INITIALIZER;
    static const pthread_cond_t fresh_ended = PTHREAD_COND_INITIALIZER;
    lock = fresh_lock;
    ended = fresh_ended;
    waiting = NULL;
}
static void watch_forks(void) { (void)pthread_atfork(NULL, NULL, in_child); }

/* Lock held: is there work within the time? If not, the worker is no longer among those that wait. */
static bool wait_for_job(worker *w)
{
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_sec += IDLE_SECONDS;
    w->next = waiting;
    waiting = w;
    int code = 0;
    while (w->job == NULL && code != ETIMEDOUT) code = pthread_cond_timedwait(&w->wake, &lock, &until);
    if (w->job != NULL) return true;
    worker **at = &waiting;
    while (*at != w) at = &(*at)->next;
    *at = w->next;
    return false;
}

static void *worker_thread(void *arg)
{
    worker *w = arg;
    pthread_mutex_lock(&lock);
    do {
        svoi_pool_job *j = w->job;
        pthread_mutex_unlock(&lock);
        j->fn(j->arg);
        pthread_mutex_lock(&lock);
        w->job = NULL;
        j->done = true; /* from here on it may be gone */
        pthread_cond_broadcast(&ended);
    } while (wait_for_job(w));
    pthread_mutex_unlock(&lock);
    pthread_cond_destroy(&w->wake);
    free(w);
    return NULL;
}

static bool new_worker(svoi_pool_job *job)
{
    worker *w = malloc(sizeof *w);
    if (w == NULL) return false;
    *w = (worker){.job = job};
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&w->wake, &monotonic);
    pthread_condattr_destroy(&monotonic);
    pthread_attr_t detached;
    pthread_attr_init(&detached);
    pthread_attr_setdetachstate(&detached, PTHREAD_CREATE_DETACHED);
    pthread_t thread;
    const int code = pthread_create(&thread, &detached, worker_thread, w);
    pthread_attr_destroy(&detached);
    if (code == 0) return true;
    pthread_cond_destroy(&w->wake);
    free(w);
    return false;
}

bool svoi_pool_start(svoi_pool_job *job)
{
    pthread_once(&once, watch_forks);
    job->done = false;
    pthread_mutex_lock(&lock);
    worker *w = waiting;
    if (w != NULL) {
        waiting = w->next;
        w->job = job;
        pthread_cond_signal(&w->wake);
    }
    pthread_mutex_unlock(&lock);
    return w != NULL || new_worker(job);
}

void svoi_pool_wait(svoi_pool_job *job)
{
    pthread_mutex_lock(&lock);
    while (!job->done) pthread_cond_wait(&ended, &lock);
    pthread_mutex_unlock(&lock);
}
