/* The one entry of all targets: memory is limited, and every verdict must be one that a damaged file may get. */
#include "fuzz.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static svo_result verdict;
static svo_error verdict_error;

svo_result fuzz_verdict(svo_error *err)
{
    *err = verdict_error;
    return verdict;
}

void fuzz_fail(const char *format, ...)
{
    va_list list;
    va_start(list, format);
    fputs("fuzz: ", stderr);
    vfprintf(stderr, format, list);
    fputc('\n', stderr);
    va_end(list);
    abort();
}

static bool allowed(svo_result r)
{
    return r == SVO_OK || r == SVO_INVALID_DATA || r == SVO_UNSUPPORTED || r == SVO_LIMIT || (r == SVO_IO && fuzz_this.opens_files);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size > FUZZ_MAX_BYTES) return 0;
    void *copy; /* exactly as large as the input, so that a sanitizer sees a read past the end */
    if (posix_memalign(&copy, 64, size != 0 ? size : 1) != 0) abort();
    if (size != 0) memcpy(copy, data, size);
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, fuzz_this.memory, NULL);
    verdict_error = (svo_error){0};
    verdict = fuzz_this.read(copy, size, &limit.base, &verdict_error);
    free(copy);
    const char *name = svo_result_name(verdict);
    if (svo_limit_in_use(&limit) != 0) fuzz_fail("%llu bytes leaked after %s", (unsigned long long)svo_limit_in_use(&limit), name);
    if (!allowed(verdict))
        fuzz_fail("%s (%s), peak %llu bytes", name, verdict_error.message, (unsigned long long)svo_limit_peak(&limit));
    if (verdict != SVO_OK && (verdict_error.code != verdict || verdict_error.message[0] == '\0')) fuzz_fail("%s without a message", name);
    return 0;
}
