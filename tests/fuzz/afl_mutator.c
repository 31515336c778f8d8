/* AFL++'s custom mutator interface to LLVMFuzzerCustomMutator: a shared object for AFL_CUSTOM_MUTATOR_LIBRARY (docs/fuzzing.md).
 * It is loaded into afl-fuzz, which is neither instrumented nor sanitized, and so is everything that is linked into it. */
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"

typedef struct mutator { uint64_t seed; uint8_t *bytes; size_t room; } mutator;

void *afl_custom_init(void *afl, unsigned int seed);
size_t afl_custom_fuzz(void *data, uint8_t *from, size_t size, uint8_t **out, uint8_t *other, size_t other_size, size_t max_size);
void afl_custom_deinit(void *data);

void *afl_custom_init(void *afl, unsigned int seed)
{
    (void)afl;
    mutator *m = calloc(1, sizeof *m);
    if (m != NULL) m->seed = seed;
    return m;
}

/* 0 bytes: this input is left out. */
size_t afl_custom_fuzz(void *data, uint8_t *from, size_t size, uint8_t **out, uint8_t *other, size_t other_size, size_t max_size)
{
    (void)other, (void)other_size;
    mutator *m = data;
    if (max_size > FUZZ_MAX_BYTES) max_size = FUZZ_MAX_BYTES;
    if (m->bytes == NULL || m->room < max_size) {
        free(m->bytes);
        m->bytes = malloc(m->room = max_size);
        if (m->bytes == NULL) abort();
    }
    *out = m->bytes;
    if (size > max_size) size = max_size;
    memcpy(m->bytes, from, size);
    fuzz_havoc_seed(++m->seed);
    return LLVMFuzzerCustomMutator(m->bytes, size, max_size, (unsigned int)(m->seed * 2654435761u));
}

void afl_custom_deinit(void *data)
{
    mutator *m = data;
    free(m->bytes);
    free(m);
}
