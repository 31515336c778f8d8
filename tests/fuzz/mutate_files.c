/* Changed copies of our files, for tests/cli/test_accepted.py:  mutate_files SEED COUNT OUT FILE...
 * COUNT copies of each FILE are written to the folder OUT, as I_J.EXT: copy J of file I. The mutator is that of the fuzz targets, so that most copies
 * have right sizes and hashes and break, or do not break, the rules of their kind. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"

enum { MOST = 1 << 20 };

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
            uint64_t own = (seed * 1000003 + (uint64_t)i) * 1000003 + j;
            fuzz_havoc_seed(own);
            memcpy(copy, whole, size);
            size_t n = LLVMFuzzerCustomMutator(copy, size, sizeof copy, (unsigned int)(own * 0x9e3779b97f4a7c15u >> 32));
            snprintf(path, sizeof path, "%s/%d_%lu%s", argv[3], i - 4, j, end);
            if (!write_file(path, copy, n)) return fprintf(stderr, "%s cannot be written\n", path), 2;
        }
    }
    return 0;
}
