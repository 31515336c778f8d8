/* Threads: parallel loops whose results do not depend on the number of workers. */
#ifndef SVO_TASK_H
#define SVO_TASK_H

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Work on the items [begin, end). `worker` is in [0, thread count) and is held by one thread at a time, so it can
 * select per-worker scratch memory. Returning anything but SVO_OK stops the loop early. */
typedef svo_result (*svo_range_fn)(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err);

/* Run fn over [0, count) in blocks of `grain` items (0 = choose), claimed atomically by up to `threads` threads
 * (0 = all processors). The calling thread is worker 0; one thread runs inline. Each block goes to exactly one
 * worker; which one is not defined, so write results to slots that belong to the items.
 * The first failing block by index decides the returned code and *err, whatever the timing. */
svo_result svo_parallel_for(uint32_t threads, uint64_t count, uint64_t grain, svo_range_fn fn, void *user, svo_error *err);

/* Run fn(user) beside what the caller does meanwhile, on a thread more. NULL where there is no thread or no memory for it: then it has been run already.
 * svo_async_wait returns when it has ended, also when called again; svo_async_free waits too. NULL is fine for both. */
typedef struct svo_async svo_async;
svo_async *svo_async_start(void (*fn)(void *user), void *user);
void svo_async_wait(svo_async *b);
void svo_async_free(svo_async *b);

/* Processors this process may run on, at least 1. */
uint32_t svo_processor_count(void);

/* Ordered pipeline: `produce` is called by one thread at a time, in order, to describe the next item (set *more
 * false when there is none); `work` runs on the item in parallel; `commit` is called by one thread at a time, in the
 * order of production. At most `window` items (0 = 4 per thread) are between produce and commit, which bounds memory. With more than 4
 * a thread, half of them are kept ready, so that the others go on while a thread that produces or commits is not running: short items need that.
 * Items are `item_size` bytes of storage reused after commit (zeroed once, at the start).
 * On a failure nothing later is committed, the rest is drained without work, and the failure first in item order
 * is returned. */
typedef struct svo_pipeline {
    uint32_t threads, window;
    size_t item_size;
    void *user;
    svo_result (*produce)(void *user, void *item, bool *more, svo_error *err);
    svo_result (*work)(void *user, void *item, uint32_t worker, svo_error *err);
    svo_result (*commit)(void *user, void *item, svo_error *err);
    void (*destroy)(void *user, void *item); /* once per slot at the end, may be NULL */
} svo_pipeline;
svo_result svo_pipeline_run(const svo_pipeline *p, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
