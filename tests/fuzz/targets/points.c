/* Clouds of points: PLY without faces, and whatever does not begin as a PLY as text. They are read from a file, here one in memory. */
#define _GNU_SOURCE
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

#include "../fuzz.h"
#include "fmt_points.h"

static svo_result read_points(const char *path, const svo_allocator *a, svo_error *err)
{
    const fmt_points_options o = {.threads = 1, .allocator = a};
    fmt_points *p;
    SVO_TRY(fmt_points_open(path, &o, &p, err));
    const fmt_points_survey *s = fmt_points_seen(p);
    uint64_t total = 0;
    svo_result r = SVO_OK;
    for (;;) {
        const fmt_point *list;
        uint64_t count;
        r = fmt_points_next(p, &list, &count, err);
        if (r != SVO_OK || count == 0) break;
        for (uint64_t i = 0; i < count; i++)
            for (int k = 0; k < 3; k++)
                if (!(list[i].at[k] >= s->low[k] && list[i].at[k] <= s->high[k] && list[i].color[k] >= 0 && list[i].color[k] <= 1)) fuzz_fail("point %llu is outside", (unsigned long long)i);
        total += count;
    }
    if (r == SVO_OK && total != s->points - s->not_finite) fuzz_fail("the second reading gives %llu points", (unsigned long long)total);
    if (r != SVO_OK) fuzz_fail("the second reading fails: %s", err != NULL ? err->message : "");
    fmt_points_close(p);
    return r;
}

static svo_result read_bytes(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    const int fd = memfd_create("points", MFD_CLOEXEC);
    char path[64];
    if (fd < 0 || (size != 0 && write(fd, bytes, size) != (ssize_t)size)) abort();
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    svo_result r = read_points(path, a, err);
    close(fd);
    return r;
}

const fuzz_target fuzz_this = {.read = read_bytes, .memory = 64 << 20};
