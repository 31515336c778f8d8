/* Threads that stay for the next loop. Creating one costs 20 microseconds, and much more where it follows the end of another: the system places a new thread
 * while the one that has just ended still seems to use the other processor, and moves it there milliseconds later. */
#ifndef SVOI_THREAD_POOL_H
#define SVOI_THREAD_POOL_H

#include <stdbool.h>

/* What a thread does; it lives from svoi_pool_start to the end of svoi_pool_wait. */
typedef struct svoi_pool_job {
    void (*fn)(void *arg);
    void *arg;
    bool done; /* guarded by the pool's lock */
} svoi_pool_job;

/* Have fn(arg) run by another thread, one that waits or a new one; false where none can be had: nothing is run then. Any thread may call it,
 * one that runs a job too. */
bool svoi_pool_start(svoi_pool_job *job);
/* Until it is done. */
void svoi_pool_wait(svoi_pool_job *job);

#endif
