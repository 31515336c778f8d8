/* What a tool does when memory runs out where nobody can report it. */
#define _GNU_SOURCE
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "cli_internal.h"
#include "fmt_file.h"
#include "fmt_memory.h"

/* Unfinished outputs have no name or are removed here; the report is not written. */
static _Noreturn void end(const char *text)
{
    fmt_output_remove_temporaries();
    ssize_t unused = write(STDERR_FILENO, program_invocation_short_name, strlen(program_invocation_short_name));
    unused = write(STDERR_FILENO, text, strlen(text));
    (void)unused;
    _exit(svo_result_exit_code(SVO_OUT_OF_MEMORY));
}

static void on_terminate(bool out_of_memory)
{
    end(out_of_memory ? ": error: out of memory in a library\n" : ": error: a library gave up\n");
}

/* Reports and listings are built by hundreds of calls to jansson, and a member that could not be allocated would just be missing from them: a document with a
 * hole is worse than none. These are small allocations; where one fails there is nothing left to go on with. */
static void *json_memory(size_t bytes)
{
    void *p = malloc(bytes);
    if (p == NULL && bytes > 0) end(": error: out of memory for JSON\n");
    return p;
}

void cli_watch_memory(void)
{
    json_set_alloc_funcs(json_memory, free);
    fmt_set_terminate(on_terminate);
}
