#define _GNU_SOURCE
#include "test.h"

#include <ftw.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MAX_TESTS = 512 };
static struct { const char *name; test_fn fn; } tests[MAX_TESTS];
static int test_count;
static bool failed, skipped;
static char folder[64];

void test_register(const char *name, test_fn fn)
{
    if (test_count == MAX_TESTS) abort();
    tests[test_count].name = name;
    tests[test_count++].fn = fn;
}

void test_fail(const char *file, int line, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    failed = true;
    fprintf(stderr, "%s:%d: ", file, line);
    vfprintf(stderr, format, args);
    fputc('\n', stderr);
    va_end(args);
}

bool test_failed(void) { return failed; }

void test_skip(const char *format, ...)
{
    va_list args;
    va_start(args, format);
    skipped = true;
    fputs("  skipped: ", stdout);
    vprintf(format, args);
    putchar('\n');
    va_end(args);
}

const char *test_models(void)
{
    const char *given = getenv("SVOKIT_MODELS");
    if (given == NULL || *given == 0) given = getenv("SVOKIT_MODELS_DEFAULT");
    if (given == NULL || access(given, R_OK) != 0) return NULL;
    return given;
}

const char *test_model(const char *relative)
{
    static char path[4096];
    const char *base = test_models();
    if (base == NULL) return NULL;
    snprintf(path, sizeof path, "%s/%s", base, relative);
    return access(path, R_OK) == 0 ? path : NULL;
}

uint64_t test_random(uint64_t *state)
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return z ^ z >> 31;
}

double test_random_unit(uint64_t *state) { return (double)(test_random(state) >> 11) * 0x1p-53; }

static int remove_entry(const char *path, const struct stat *s, int flag, struct FTW *f)
{
    (void)s, (void)flag, (void)f;
    return remove(path);
}

static void remove_folder(void) { nftw(folder, remove_entry, 16, FTW_DEPTH | FTW_PHYS); }

const char *test_folder(void)
{
    if (folder[0] == 0) {
        strcpy(folder, "/tmp/svokit-test-XXXXXX");
        if (mkdtemp(folder) == NULL) abort();
        atexit(remove_folder);
    }
    return folder;
}

int main(int argc, char **argv)
{
    int run = 0, bad = 0, skips = 0;
    setvbuf(stdout, NULL, _IOLBF, 0);
    for (int i = 0; i < test_count; i++) {
        bool wanted = argc < 2;
        for (int a = 1; a < argc; a++) wanted |= strstr(tests[i].name, argv[a]) != NULL;
        if (!wanted) continue;
        failed = skipped = false;
        double start = svo_seconds();
        tests[i].fn();
        printf("%-7s %-56s %7.3f s\n", failed ? "FAILED" : skipped ? "skipped" : "ok", tests[i].name, svo_seconds() - start);
        run++, bad += failed, skips += skipped && !failed;
    }
    printf("%d tests, %d failed, %d skipped\n", run, bad, skips);
    if (bad != 0 || run == 0) return 1;
    return skips == run ? 77 : 0;
}
