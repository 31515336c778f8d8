/* Temporary files for what does not fit in memory: without a name (O_TMPFILE, or created and unlinked at once), so that
 * nothing is left when a run is killed; charged against a limit and the free space of the file system; counted. */
#ifndef FMT_SPILL_H
#define FMT_SPILL_H

#include "svo_spill.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct fmt_spill_options {
    const char *folder; /* where to put them; NULL: TMPDIR if it is set, else the folder of `beside`, else /tmp */
    const char *beside; /* the output's name; NULL or "-": none */
    uint64_t limit;     /* bytes that all files together may hold at a time, 0 = no limit; more is SVO_LIMIT */
    uint64_t reserve;   /* bytes to leave free on the file system (for the output, say) */
} fmt_spill_options;

typedef struct fmt_spill fmt_spill;

/* Makes no file yet, but SVO_IO when the folder cannot hold any. All files must be closed before it is. */
svo_result fmt_spill_open(const fmt_spill_options *options, fmt_spill **out, svo_error *err);
void fmt_spill_close(fmt_spill *s);
/* Valid until fmt_spill_close. */
const svo_spill *fmt_spill_files(const fmt_spill *s);
const char *fmt_spill_folder(const fmt_spill *s);
/* Does the folder lie in memory (tmpfs), so that spilling saves none? */
bool fmt_spill_in_memory(const fmt_spill *s);

typedef struct fmt_spill_counts {
    uint64_t files, files_peak;             /* made in all; open at a time */
    uint64_t bytes_written, bytes_read;     /* in all */
    uint64_t bytes_now, bytes_peak;         /* held, by the highest offset written less what was discarded */
} fmt_spill_counts;
fmt_spill_counts fmt_spill_count(const fmt_spill *s);

/* Bytes that a new file in a folder may take (statvfs, for this user), and the mount point of its file system (may be
 * NULL). False when it cannot be told. */
bool fmt_disk_free(const char *folder, uint64_t *bytes, char *mount, size_t mount_size);
/* Folder of a path: everything up to the last '/', or ".". */
void fmt_folder_of(const char *path, char *folder, size_t size);

#ifdef __cplusplus
}
#endif
#endif
