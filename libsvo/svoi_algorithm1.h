/* Internal: Algorithm 1 with the bits of a table index given. Not installed. */
#ifndef SVOI_ALGORITHM1_H
#define SVOI_ALGORITHM1_H

#include "svo_algorithm1.h"
#include "svoi_palette.h"

/* svo_algorithm1 on numbers below `distinct` that stand for entries of a table whose indices have `table_bits`. */
svo_result svoi_algorithm1(const uint32_t *index, uint64_t count, uint64_t distinct, uint32_t table_bits, uint32_t directory_bits, uint32_t threads,
                           const svo_allocator *a, svo_algorithm1_result *out, svo_error *err);

#endif
