#include "fmt_memory.h"

#include <jansson.h>
#include <pthread.h>
#include <stdatomic.h>

static pthread_once_t once = PTHREAD_ONCE_INIT;
static json_malloc_t below_malloc;
static atomic_ullong failures;

static void *counting_malloc(size_t bytes)
{
    void *p = below_malloc(bytes);
    if (p == NULL && bytes > 0) atomic_fetch_add(&failures, 1);
    return p;
}

static void watch(void)
{
    json_free_t below_free;
    json_get_alloc_funcs(&below_malloc, &below_free);
    json_set_alloc_funcs(counting_malloc, below_free);
}

uint64_t fmt_json_failures(void)
{
    pthread_once(&once, watch);
    return atomic_load(&failures);
}
