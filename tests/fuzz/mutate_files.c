/* Changed copies of our files, for tests/cli/test_accepted.py:  mutate_files SEED COUNT OUT FILE...
 * COUNT copies of each FILE are written to the folder OUT, as I_J.EXT: copy J of file I. The mutator is that of the fuzz targets, so that most copies
 * have right sizes and hashes and break, or do not break, the rules of their kind. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"

enum { MOST = 1 << 20 };

static uint64_t state;
static uint32_t below(uint32_t n)
{
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(state >> 33) % n;
}

/* In place of libFuzzer's: a bit, a byte, a value at the edge of its range, bytes taken out or put in. */
size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size)
{
    static const uint64_t edges[] = {0, 1, 2, 3, 7, 8, 47, 48, 255, 256, 32768, 65535, 65536, 0x7fffffff, 0x80000000, 0xffffffff, 0x3ff0000000000000, 0x7ff0000000000000, UINT64_MAX};
    if (size == 0) {
        if (max_size == 0) return 0;
        data[0] = (uint8_t)below(256);
        return 1;
    }
    size_t at = below((uint32_t)size), n = (size_t)1 << below(4);
    if (n > size - at) n = 1;
    switch (below(8)) {
    case 0:
    case 1: data[at] ^= (uint8_t)(1u << below(8)); break;
    case 2:
    case 3: data[at] = (uint8_t)below(256); break;
    case 4:
    case 5: memcpy(data + at, &edges[below(sizeof edges / sizeof edges[0])], n); break;
    case 6:
        memmove(data + at, data + at + n, size - at - n);
        return size - n;
    default:
        if (n > max_size - size) break;
        memmove(data + at + n, data + at, size - at);
        return size + n;
    }
    return size;
}

static size_t read_file(const char *path, uint8_t *to)
{
    FILE *f = fopen(path, "rb");
    if (f == NULL) return 0;
    size_t n = fread(to, 1, MOST, f);
    fclose(f);
    return n;
}

static bool write_file(const char *path, const uint8_t *bytes, size_t size)
{
    FILE *f = fopen(path, "wb");
    if (f == NULL) return false;
    bool good = fwrite(bytes, 1, size, f) == size;
    return fclose(f) == 0 && good;
}

int main(int argc, char **argv)
{
    if (argc < 5) return fprintf(stderr, "mutate_files SEED COUNT OUT FILE...\n"), 1;
    static uint8_t whole[MOST], copy[MOST];
    uint64_t seed = strtoull(argv[1], NULL, 10);
    unsigned long count = strtoul(argv[2], NULL, 10);
    for (int i = 4; i < argc; i++) {
        size_t size = read_file(argv[i], whole);
        const char *end = strrchr(argv[i], '.');
        if (size == 0 || end == NULL) return fprintf(stderr, "%s cannot be read\n", argv[i]), 2;
        for (unsigned long j = 0; j < count; j++) {
            char path[4096];
            state = (seed * 1000003 + (uint64_t)i) * 1000003 + j;
            for (int k = 0; k < 4; k++) below(2);
            memcpy(copy, whole, size);
            size_t n = LLVMFuzzerCustomMutator(copy, size, sizeof copy, below(UINT32_MAX));
            snprintf(path, sizeof path, "%s/%d_%lu%s", argv[3], i - 4, j, end);
            if (!write_file(path, copy, n)) return fprintf(stderr, "%s cannot be written\n", path), 2;
        }
    }
    return 0;
}
