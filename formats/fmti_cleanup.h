/* Temporary files that must not outlive the process: beside an output where the file system has no O_TMPFILE (elsewhere an
 * unfinished output has no name at all), and for the moment in which one file takes the place of another.
 *
 * They are called PATH.svokit-part-0, PATH.svokit-part-1, ... Who makes one holds a lock (flock) on it, which ends with its process however that
 * ends: a file of such a name without a lock was left by a process that was killed. */
#ifndef FMTI_CLEANUP_H
#define FMTI_CLEANUP_H

#include <stdbool.h>
#include <stddef.h>

/* For the signal handler: the one place with state for the whole process, since it has no other way to reach it. path must stay valid
 * until it is forgotten. Beyond 64 paths at a time further ones are not remembered. Thread-safe. */
void fmti_temporary_remember(const char *path);
void fmti_temporary_forget(const char *path);

/* PATH.svokit-part-NUMBER; false: longer than size. */
bool fmti_temporary_name(const char *path, unsigned number, char *out, size_t size);
/* Lock a file that was just made. name: what it must still be called, or NULL. False: another process took it for a leftover. */
bool fmti_temporary_claim(int fd, const char *name);

#endif
