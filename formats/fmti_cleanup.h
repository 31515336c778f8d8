/* Temporary files that must not outlive the process. Only for file systems without O_TMPFILE; elsewhere an unfinished
 * output has no name at all. This is the one place with state for the whole process: a signal handler has no other way
 * to reach it. */
#ifndef FMTI_CLEANUP_H
#define FMTI_CLEANUP_H

/* path must stay valid until it is forgotten. Beyond 64 paths at a time further ones are not remembered. Thread-safe. */
void fmti_temporary_remember(const char *path);
void fmti_temporary_forget(const char *path);

#endif
