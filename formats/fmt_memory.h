/* Memory that runs out inside a library below: jansson drops what it could not allocate without saying so, and C++ destructors that allocate end in
 * std::terminate. Our own allocations go through svo_allocator and need none of this. */
#ifndef FMT_MEMORY_H
#define FMT_MEMORY_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* How many allocations of jansson have failed in this process. The first call puts a counting step in front of the allocation functions that jansson has then
 * (json_get_alloc_funcs), so an application that sets its own does so before. Where the number has grown over a call, what jansson returned is not to be
 * believed: a NULL is no verdict on the text, a value may lack members. Thread-safe; a failure in another thread counts as well. */
uint64_t fmt_json_failures(void);

/* Calls `handler` in place of abort where C++ code cannot go on: out_of_memory when std::bad_alloc is in flight. It must not return, and may only do what a
 * signal handler may. For programs; a library leaves the process to its owner. */
void fmt_set_terminate(void (*handler)(bool out_of_memory));

#ifdef __cplusplus
}
#endif

#endif
