/* The files that a run has read: for the provenance, the content key and depfiles. */
#ifndef CLI_SOURCES_H
#define CLI_SOURCES_H

#include "cli.h"

typedef struct source {
    char *path; /* as opened */
    char *hash; /* 33 bytes; after sources_settle; NULL with names_only */
    struct sources_work *work; /* NULL: hashed already */
} source;

typedef struct sources {
    source *list;
    size_t count, capacity;
    bool names_only; /* for depfiles alone: nothing is hashed, and there is no key */
    bool beside; /* large files are hashed on a thread more while they are read */
    bool failed; /* out of memory; checked once, at the end */
} sources;

/* fmt_import_options.file_read with a sources as user. */
struct svo_async *sources_add(void *user, const char *path, const uint8_t *bytes, uint64_t size, bool mapped);
/* Wait for all hashes. */
void sources_settle(const sources *s);
void sources_free(sources *s);

/* Hash of everything that decides the bytes of an output: `what` (options and versions as text) and the content and the
 * last name of every file read. 16 bytes. */
svo_result sources_key(const sources *s, const char *what, uint8_t key[16], svo_error *err);

/* --depfile FILE and -MD (`beside`), which is OUT.d: *path becomes the name of the file, NULL: none is wanted. Returns an exit code after wrong use, else -1. One file a process. */
int cli_take_depfile(cli *c, bool beside, const char **path);

/* Could a depfile be written there (NULL: none is)? Asked when all is read, before the output appears: else a run that fails for the depfile alone would have replaced it. */
svo_result sources_check_depfile(const sources *s, const char *path, bool force, svo_error *err);
/* "target: file file ..." for Make and Ninja. Refuses to replace one of the files, or another file without force. */
svo_result sources_depfile(const sources *s, const char *path, const char *target, bool force, svo_error *err);

#endif
