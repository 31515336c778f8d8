// Loaded before the C library (LD_PRELOAD) by tests/cli/test_build.py: a process that is about to rename a file is killed instead, as by kill -9 at that moment.
//   KILL_RENAME_OF=WORD   only when WORD is part of the old name
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

int rename(const char *from, const char *to)
{
    const char *word = getenv("KILL_RENAME_OF");
    if (word != NULL && strstr(from, word) != NULL) raise(SIGKILL);
    return (int)syscall(SYS_rename, from, to);
}
