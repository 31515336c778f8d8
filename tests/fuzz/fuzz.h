/* What a fuzz target is: how to read bytes and use all that was read. The same source is linked with libFuzzer or AFL++
 * (SVO_BUILD_FUZZERS) and with fuzz_replay.c, which runs stored files through it in every build. */
#ifndef FUZZ_H
#define FUZZ_H

#include "svo_alloc.h"

typedef struct fuzz_target {
    /* Read and use; free everything. `bytes` are 64-byte aligned and end where their memory ends. Calls fuzz_fail where
     * something was accepted that is not sound. */
    svo_result (*read)(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err);
    uint64_t memory;   /* limit of `a`; an input of at most FUZZ_MAX_BYTES must not reach it */
    bool opens_files;  /* SVO_IO is a possible verdict: the input may name files that are not there */
} fuzz_target;

/* Each target defines it. */
extern const fuzz_target fuzz_this;

#define FUZZ_MAX_BYTES 65536u

/* Say what is wrong and abort. */
void fuzz_fail(const char *format, ...) SVO_PRINTF(1, 2);
/* Verdict on the input that LLVMFuzzerTestOneInput was called with last. */
svo_result fuzz_verdict(svo_error *err);

/* libFuzzer's entries. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed);
size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size);
/* Where LLVMFuzzerMutate is ours (fuzz_havoc.c): what follows depends on the seed alone. */
void fuzz_havoc_seed(uint64_t seed);

#endif
