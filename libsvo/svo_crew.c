/* Threads that wait for work. They are detached and end by themselves when there is none for a second, so nothing has to close them. */
#define _GNU_SOURCE
#include "svoi_crew.h"

#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <time.h>

enum { IDLE_SECONDS = 1 };

typedef struct hand {
    pthread_cond_t wake;
    svoi_order *order; /* NULL: none yet */
    struct hand *next; /* waiting */
} hand;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t ended = PTHREAD_COND_INITIALIZER; /* some order is done */
static hand *waiting;                                   /* the last that came is the first to go: its caches are warm */
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

/* Lock held: is there work within the time? If not, the hand is no longer among those that wait. */
static bool wait_for_order(hand *h)
{
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_sec += IDLE_SECONDS;
    h->next = waiting;
    waiting = h;
    int code = 0;
    while (h->order == NULL && code != ETIMEDOUT) code = pthread_cond_timedwait(&h->wake, &lock, &until);
    if (h->order != NULL) return true;
    hand **at = &waiting;
    while (*at != h) at = &(*at)->next;
    *at = h->next;
    return false;
}

static void *hand_thread(void *arg)
{
    hand *h = arg;
    pthread_mutex_lock(&lock);
    do {
        svoi_order *o = h->order;
        pthread_mutex_unlock(&lock);
        o->fn(o->arg);
        pthread_mutex_lock(&lock);
        h->order = NULL;
        o->done = true; /* from here on it may be gone */
        pthread_cond_broadcast(&ended);
    } while (wait_for_order(h));
    pthread_mutex_unlock(&lock);
    pthread_cond_destroy(&h->wake);
    free(h);
    return NULL;
}

static bool new_hand(svoi_order *order)
{
    hand *h = malloc(sizeof *h);
    if (h == NULL) return false;
    *h = (hand){.order = order};
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&h->wake, &monotonic);
    pthread_condattr_destroy(&monotonic);
    pthread_attr_t detached;
    pthread_attr_init(&detached);
    pthread_attr_setdetachstate(&detached, PTHREAD_CREATE_DETACHED);
    pthread_t thread;
    const int code = pthread_create(&thread, &detached, hand_thread, h);
    pthread_attr_destroy(&detached);
    if (code == 0) return true;
    pthread_cond_destroy(&h->wake);
    free(h);
    return false;
}

bool svoi_crew_start(svoi_order *order)
{
    pthread_once(&once, watch_forks);
    order->done = false;
    pthread_mutex_lock(&lock);
    hand *h = waiting;
    if (h != NULL) {
        waiting = h->next;
        h->order = order;
        pthread_cond_signal(&h->wake);
    }
    pthread_mutex_unlock(&lock);
    return h != NULL || new_hand(order);
}

void svoi_crew_wait(svoi_order *order)
{
    pthread_mutex_lock(&lock);
    while (!order->done) pthread_cond_wait(&ended, &lock);
    pthread_mutex_unlock(&lock);
}
