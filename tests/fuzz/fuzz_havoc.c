/* LLVMFuzzerMutate where libFuzzer's is not there (AFL++'s side, mutate_files): one small change a call. */
#include <string.h>

#include "fuzz.h"

static uint64_t state;

void fuzz_havoc_seed(uint64_t seed)
{
    state = seed * 1000003 + 12345;
    for (int k = 0; k < 2; k++) state = state * 6364136223846793005u + 1442695040888963407u;
}

static uint32_t below(uint32_t n)
{
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(state >> 33) % n;
}

size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size)
{
    static const uint64_t edges[] = {0, 1, 2, 3, 7, 8, 47, 48, 255, 256, 32768, 65535, 65536, 0x7fffffff, 0x80000000, 0xffffffff, 0x3ff0000000000000, 0x7ff0000000000000, UINT64_MAX};
    if (size == 0) {
        if (max_size == 0) return 0;
        data[0] = (uint8_t)below(256);
        return 1;
    }
    size_t at = below((uint32_t)size), n = (size_t)1 << below(4), from;
    if (n > size - at) n = 1;
    uint64_t word = 0;
    switch (below(11)) {
    case 0:
    case 1: data[at] ^= (uint8_t)(1u << below(8)); break;
    case 2:
    case 3: data[at] = (uint8_t)below(256); break;
    case 4:
    case 5: memcpy(data + at, &edges[below(sizeof edges / sizeof edges[0])], n); break;
    case 6: /* the neighbours of a number */
    case 7:
        memcpy(&word, data + at, n);
        word += below(2) != 0 ? 1 + below(35) : 0 - (uint64_t)(1 + below(35));
        memcpy(data + at, &word, n);
        break;
    case 8: /* what stands elsewhere in the data */
        n = 1 + below(size < 64 ? (uint32_t)size : 64);
        from = below((uint32_t)(size - n + 1));
        at = below((uint32_t)(size - n + 1));
        memmove(data + at, data + from, n);
        break;
    case 9:
        memmove(data + at, data + at + n, size - at - n);
        return size - n;
    default:
        if (n > max_size - size) break;
        memmove(data + at + n, data + at, size - at);
        return size + n;
    }
    return size;
}
