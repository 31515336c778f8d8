#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdio.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "fmt_file.h"
#include "fmti_cleanup.h"

enum { SLOTS = 64, NAMES = 8 /* that are looked at: so many runs would have to write the same file at a time to reach further ones */ };
static _Atomic(const char *) slots[SLOTS];

void fmti_temporary_remember(const char *path)
{
    for (int i = 0; i < SLOTS; i++) {
        const char *none = NULL;
        if (atomic_compare_exchange_strong(&slots[i], &none, path)) return;
    }
}

void fmti_temporary_forget(const char *path)
{
    for (int i = 0; i < SLOTS; i++) {
        const char *mine = path;
        if (atomic_compare_exchange_strong(&slots[i], &mine, NULL)) return;
    }
}

void fmt_output_remove_temporaries(void)
{
    for (int i = 0; i < SLOTS; i++) {
        const char *path = atomic_load(&slots[i]);
        if (path != NULL) unlink(path);
    }
}

bool fmti_temporary_name(const char *path, unsigned number, char *out, size_t size)
{
    int n = snprintf(out, size, "%s.svokit-part-%u", path, number);
    return n >= 0 && (size_t)n < size;
}

static bool is_called(int fd, const char *name)
{
    struct stat a, b;
    return fstat(fd, &a) == 0 && lstat(name, &b) == 0 && a.st_dev == b.st_dev && a.st_ino == b.st_ino;
}

bool fmti_temporary_claim(int fd, const char *name)
{
    if (flock(fd, LOCK_EX | LOCK_NB) != 0) return errno != EWOULDBLOCK; /* where there are no locks, nothing is taken for a leftover */
    return name == NULL || is_called(fd, name);
}

void fmt_output_remove_leftovers(const char *path)
{
    char name[PATH_MAX];
    struct stat s;
    for (unsigned i = 0; i < NAMES && fmti_temporary_name(path, i, name, sizeof name); i++) {
        if (lstat(name, &s) != 0 || !S_ISREG(s.st_mode)) continue;
        int fd = open(name, O_RDWR | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
        if (fd < 0) continue;
        /* With the lock held and the name as it was, its maker is gone: nobody else renames or removes it before the lock is given back. */
        if (flock(fd, LOCK_EX | LOCK_NB) == 0 && is_called(fd, name)) unlink(name);
        close(fd);
    }
}
