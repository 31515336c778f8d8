/* For qsort. */
#ifndef SVOI_COMPARE_H
#define SVOI_COMPARE_H

#include <stdint.h>

static inline int svoi_compare_u64(const void *a, const void *b)
{
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

#endif
