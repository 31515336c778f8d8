// Loaded before the C library (LD_PRELOAD) by tests/cli/test_allocations.py: lets the n-th allocation of a process fail, in our code and in every library below it.
//   FAIL_MALLOC_AT=N      allocation N (from 1) returns NULL; 0 or unset: none
//   FAIL_MALLOC_ON=1      every later one does as well
//   FAIL_MALLOC_COUNT=F   at exit the number of allocations is written to the file F
// Needs glibc, whose allocator stays reachable under its __libc_ names. Counts are atomic, so which thread meets the failure may differ from run to run.
#include <errno.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);

static atomic_ulong count;
static unsigned long fail_at;
static int fail_on;

__attribute__((constructor)) static void start(void)
{
    const char *at = getenv("FAIL_MALLOC_AT"), *on = getenv("FAIL_MALLOC_ON");
    fail_at = at ? strtoul(at, NULL, 10) : 0;
    fail_on = on && *on == '1';
    atomic_store(&count, 0);
}

__attribute__((destructor)) static void finish(void)
{
    const char *path = getenv("FAIL_MALLOC_COUNT");
    unsigned long n = atomic_load(&count);
    fail_at = 0;
    FILE *f = path ? fopen(path, "w") : NULL;
    if (f) {
        fprintf(f, "%lu\n", n);
        fclose(f);
    }
}

static int fails(void)
{
    unsigned long n = atomic_fetch_add(&count, 1) + 1;
    if (fail_at == 0 || (fail_on ? n < fail_at : n != fail_at)) return 0;
    errno = ENOMEM;
    return 1;
}

void *malloc(size_t bytes) { return fails() ? NULL : __libc_malloc(bytes); }

void *calloc(size_t n, size_t bytes) { return fails() ? NULL : __libc_calloc(n, bytes); }

void *realloc(void *p, size_t bytes) { return fails() ? NULL : __libc_realloc(p, bytes); }

void *memalign(size_t alignment, size_t bytes) { return fails() ? NULL : __libc_memalign(alignment, bytes); }

void *aligned_alloc(size_t alignment, size_t bytes) { return fails() ? NULL : __libc_memalign(alignment, bytes); }

int posix_memalign(void **p, size_t alignment, size_t bytes)
{
    if (fails()) return ENOMEM;
    void *q = __libc_memalign(alignment, bytes);
    if (!q) return ENOMEM;
    *p = q;
    return 0;
}
