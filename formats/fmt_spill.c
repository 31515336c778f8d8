#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include "fmt_spill.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statfs.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "fmt_container.h"
#include "fmt_file.h"

enum { LOOK_EVERY = 64 << 20 }; /* bytes between looks at the free space */

typedef struct spilled {
    int fd;
    uint64_t high, discarded; /* highest offset written, bytes given back below it; under the lock */
} spilled;

struct fmt_spill {
    svo_spill files;
    pthread_mutex_t lock;
    fmt_spill_counts counts; /* under the lock, as is `looked` */
    uint64_t limit, reserve, files_now, looked;
    fmt_zstd_pool *codec;
    char folder[PATH_MAX];
};

void fmt_folder_of(const char *path, char *folder, size_t size)
{
    const char *slash = strrchr(path, '/');
    size_t n = slash == NULL ? 0 : slash == path ? 1 : (size_t)(slash - path);
    if (slash == NULL || n >= size) {
        memcpy(folder, ".", 2);
        return;
    }
    memcpy(folder, path, n);
    folder[n] = 0;
}

/* The highest folder above `folder` that lies on the same file system. */
static void mount_point(const char *folder, char *mount, size_t size)
{
    char path[PATH_MAX];
    struct stat s, above;
    if (realpath(folder, path) == NULL || stat(path, &s) != 0) {
        snprintf(mount, size, "%s", folder);
        return;
    }
    for (char *slash; (slash = strrchr(path, '/')) != NULL && path[1] != 0;) {
        char keep = slash == path ? slash[1] : slash[0];
        char *cut = slash == path ? slash + 1 : slash;
        *cut = 0;
        if (stat(path, &above) != 0 || above.st_dev != s.st_dev) {
            *cut = keep;
            break;
        }
    }
    snprintf(mount, size, "%s", path);
}

bool fmt_disk_free(const char *folder, uint64_t *bytes, char *mount, size_t mount_size)
{
    struct statvfs s;
    if (statvfs(folder, &s) != 0) return false;
    *bytes = (uint64_t)s.f_bavail * (uint64_t)s.f_frsize;
    if (mount != NULL) mount_point(folder, mount, mount_size);
    return true;
}

/* A file without a name, for reading and writing; -1 and errno. */
static int unnamed_file(const char *folder)
{
#ifdef O_TMPFILE
    int fd = open(folder, O_TMPFILE | O_RDWR | O_CLOEXEC | O_EXCL, 0600);
    if (fd >= 0) return fd;
    if (errno != EOPNOTSUPP && errno != EISDIR && errno != EINVAL) return -1; /* those: the file system cannot */
#endif
    char name[PATH_MAX];
    if (snprintf(name, sizeof name, "%s/svokit-XXXXXX", folder) >= (int)sizeof name) {
        errno = ENAMETOOLONG;
        return -1;
    }
    int named = mkostemp(name, O_CLOEXEC);
    if (named >= 0) unlink(name);
    return named;
}

svo_result fmt_scratch_file(int *fd, svo_error *err)
{
    const char *folder = getenv("TMPDIR");
    if (folder == NULL || folder[0] == 0) folder = "/tmp";
    *fd = unnamed_file(folder);
    if (*fd < 0) return svo_fail(err, SVO_IO, "cannot create a temporary file in %s (TMPDIR): %s", folder, strerror(errno));
    return SVO_OK;
}

/* --- the table of functions ----------------------------------------------------------------------------------- */

static svo_result full(const fmt_spill *s, uint64_t now, uint64_t more, const char *why, svo_error *err)
{
    char mount[80];
    uint64_t left = 0;
    if (!fmt_disk_free(s->folder, &left, mount, sizeof mount)) snprintf(mount, sizeof mount, "?");
    return svo_fail(err, SVO_IO, "temporary files in %.60s: %s: the file system at %.40s has %llu bytes left, the run holds %llu there and needs %llu more; "
                    "choose another place (--temp)", s->folder, why, mount, (unsigned long long)left, (unsigned long long)now,
                    (unsigned long long)more);
}

/* Take what a write up to `end` adds, before it is done: the limit always, the disk every now and then. */
static svo_result charge(fmt_spill *s, spilled *f, uint64_t end, svo_error *err)
{
    pthread_mutex_lock(&s->lock);
    svo_result r = SVO_OK;
    uint64_t more = end > f->high ? end - f->high : 0, now = s->counts.bytes_now;
    bool look = false;
    if (s->limit != 0 && more > s->limit - (now < s->limit ? now : s->limit)) {
        r = svo_fail(err, SVO_LIMIT, "temporary files would take more than the %llu bytes allowed (they hold %llu, %llu more are needed)",
                     (unsigned long long)s->limit, (unsigned long long)now, (unsigned long long)more);
    } else {
        f->high += more;
        s->counts.bytes_now += more;
        if (s->counts.bytes_now > s->counts.bytes_peak) s->counts.bytes_peak = s->counts.bytes_now;
        s->looked += more;
        look = more != 0 && s->looked >= LOOK_EVERY;
        if (look) s->looked = 0;
    }
    pthread_mutex_unlock(&s->lock);
    if (r != SVO_OK || !look) return r;
    uint64_t left;
    if (fmt_disk_free(s->folder, &left, NULL, 0) && left < s->reserve + more) return full(s, now, more, "no space is left", err);
    return SVO_OK;
}

static svo_result spill_create(void *user, void **file, svo_error *err)
{
    fmt_spill *s = user;
    spilled *f = malloc(sizeof *f);
    if (f == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    *f = (spilled){.fd = unnamed_file(s->folder)};
    if (f->fd < 0) {
        int code = errno;
        free(f);
        if (code == ENOSPC || code == EDQUOT) return full(s, fmt_spill_count(s).bytes_now, 1, strerror(code), err);
        return svo_fail(err, SVO_IO, "cannot create a temporary file in %.150s: %s; choose another place (--temp)", s->folder, strerror(code));
    }
    pthread_mutex_lock(&s->lock);
    s->counts.files++;
    if (++s->files_now > s->counts.files_peak) s->counts.files_peak = s->files_now;
    pthread_mutex_unlock(&s->lock);
    *file = f;
    return SVO_OK;
}

static svo_result spill_write(void *user, void *file, uint64_t offset, const void *bytes, uint64_t size, svo_error *err)
{
    fmt_spill *s = user;
    spilled *f = file;
    if (offset > INT64_MAX || size > INT64_MAX - offset) return svo_fail(err, SVO_LIMIT, "a temporary file of more than 2^63 bytes");
    SVO_TRY(charge(s, f, offset + size, err));
    const uint8_t *p = bytes;
    for (uint64_t done = 0; done < size;) {
        uint64_t piece = size - done < 1u << 30 ? size - done : 1u << 30;
        ssize_t n = pwrite(f->fd, p + done, (size_t)piece, (off_t)(offset + done));
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && (errno == ENOSPC || errno == EDQUOT || errno == EFBIG)) {
            int code = errno;
            fmt_spill_counts c = fmt_spill_count(s);
            return full(s, c.bytes_now - (size - done), size - done, strerror(code), err);
        }
        if (n < 0) return svo_fail(err, SVO_IO, "temporary files in %.150s: cannot write: %s", s->folder, strerror(errno));
        done += (uint64_t)n;
    }
    pthread_mutex_lock(&s->lock);
    s->counts.bytes_written += size;
    pthread_mutex_unlock(&s->lock);
    return SVO_OK;
}

static svo_result spill_read(void *user, void *file, uint64_t offset, void *bytes, uint64_t size, svo_error *err)
{
    fmt_spill *s = user;
    const spilled *f = file;
    uint8_t *p = bytes;
    for (uint64_t done = 0; done < size;) {
        uint64_t piece = size - done < 1u << 30 ? size - done : 1u << 30;
        ssize_t n = pread(f->fd, p + done, (size_t)piece, (off_t)(offset + done));
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return svo_fail(err, SVO_IO, "temporary files in %.150s: cannot read: %s", s->folder, strerror(errno));
        if (n == 0) return svo_fail(err, SVO_IO, "temporary files in %.150s: a read beyond the end", s->folder);
        done += (uint64_t)n;
    }
    pthread_mutex_lock(&s->lock);
    s->counts.bytes_read += size;
    pthread_mutex_unlock(&s->lock);
    return SVO_OK;
}

static void spill_discard(void *user, void *file, uint64_t offset, uint64_t size)
{
#ifdef FALLOC_FL_PUNCH_HOLE
    enum { PAGE = 4096 }; /* holes are made of whole blocks */
    fmt_spill *s = user;
    spilled *f = file;
    uint64_t begin = (offset + PAGE - 1) / PAGE * PAGE, end = (offset + size) / PAGE * PAGE;
    if (begin >= end || fallocate(f->fd, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, (off_t)begin, (off_t)(end - begin)) != 0) return;
    pthread_mutex_lock(&s->lock);
    if (end - begin <= f->high - f->discarded) {
        f->discarded += end - begin;
        s->counts.bytes_now -= end - begin;
    }
    pthread_mutex_unlock(&s->lock);
#else
    (void)user, (void)file, (void)offset, (void)size;
#endif
}

static void spill_close(void *user, void *file)
{
    fmt_spill *s = user;
    spilled *f = file;
    close(f->fd);
    pthread_mutex_lock(&s->lock);
    s->counts.bytes_now -= f->high - f->discarded;
    s->files_now--;
    pthread_mutex_unlock(&s->lock);
    free(f);
}

/* Space is taken before anything is mapped: a write to a mapping that the disk has no room for would end the process. */
static svo_result spill_map(void *user, void *file, uint64_t offset, uint64_t size, void **data, svo_error *err)
{
    fmt_spill *s = user;
    spilled *f = file;
    if (offset > INT64_MAX || size > INT64_MAX - offset) return svo_fail(err, SVO_LIMIT, "a temporary file of more than 2^63 bytes");
    SVO_TRY(charge(s, f, offset + size, err));
    int code;
    do code = posix_fallocate(f->fd, (off_t)offset, (off_t)size);
    while (code == EINTR);
    if (code == ENOSPC || code == EDQUOT || code == EFBIG) return full(s, fmt_spill_count(s).bytes_now - size, size, strerror(code), err);
    if (code != 0) return svo_fail(err, SVO_IO, "temporary files in %.150s: cannot take space: %s", s->folder, strerror(code));
    void *p = size <= SIZE_MAX ? mmap(NULL, (size_t)size, PROT_READ | PROT_WRITE, MAP_SHARED, f->fd, (off_t)offset) : MAP_FAILED;
    if (p == MAP_FAILED) return svo_fail(err, SVO_IO, "temporary files in %.150s: cannot map: %s", s->folder, strerror(errno));
    /* Else large folios are made as it is read, and since Linux 6.18 one of them is mapped as a whole at a touch: more than the 64 KiB that pagers count. */
    madvise(p, (size_t)size, MADV_RANDOM);
    *data = p;
    return SVO_OK;
}

static void spill_fetch(void *user, void *data, uint64_t size)
{
    (void)user;
    madvise(data, (size_t)size, MADV_WILLNEED);
}

static void spill_unmap(void *user, void *data, uint64_t size)
{
    (void)user;
    munmap(data, (size_t)size);
}

static uint32_t spill_compress(void *user, const void *bytes, uint32_t size, void *to, uint32_t capacity)
{
    fmt_spill *s = user;
    return (uint32_t)fmt_zstd_encode_to(s->codec, bytes, size, 1, to, capacity);
}

static svo_result spill_decompress(void *user, const void *packed, uint32_t packed_size, void *bytes, uint32_t size, svo_error *err)
{
    fmt_spill *s = user;
    svo_error why = {0};
    svo_result r = fmt_zstd_decode_to(s->codec, packed, packed_size, bytes, size, &why);
    if (r == SVO_OUT_OF_MEMORY) return svo_fail(err, r, "%s", why.message);
    if (r != SVO_OK) return svo_fail(err, SVO_IO, "temporary files in %.150s: not what was written is read: %.200s", s->folder, why.message);
    return SVO_OK;
}

static void spill_forget(void *user, void *data, uint64_t size)
{
    (void)user;
    fmt_bytes_forget(data, size);
}

/* --- the object ----------------------------------------------------------------------------------------------- */

svo_result fmt_spill_open(const fmt_spill_options *o, fmt_spill **out, svo_error *err)
{
    fmt_spill *s = calloc(1, sizeof *s);
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    const char *folder = o->folder, *temp = getenv("TMPDIR");
    char beside[PATH_MAX] = "/tmp";
    if (o->beside != NULL && strcmp(o->beside, "-") != 0) fmt_folder_of(o->beside, beside, sizeof beside);
    if (folder == NULL) folder = temp != NULL && temp[0] != 0 ? temp : beside;
    struct stat st;
    const char *why = NULL;
    if (strlen(folder) >= sizeof s->folder) why = "the name is too long";
    else if (stat(folder, &st) != 0) why = strerror(errno);
    else if (!S_ISDIR(st.st_mode)) why = "it is not a folder";
    else if (access(folder, W_OK | X_OK) != 0) why = strerror(errno);
    if (why != NULL) {
        free(s);
        return svo_fail(err, SVO_IO, "%.150s cannot hold temporary files: %s; choose another place (--temp)", folder, why);
    }
    svo_result r = fmt_zstd_pool_new(&s->codec, err);
    if (r != SVO_OK) {
        free(s);
        return r;
    }
    memcpy(s->folder, folder, strlen(folder) + 1);
    s->limit = o->limit;
    s->reserve = o->reserve;
    s->looked = LOOK_EVERY; /* look at the first write */
    pthread_mutex_init(&s->lock, NULL);
    s->files = (svo_spill){s, spill_create, spill_write, spill_read, spill_discard, spill_close, spill_map, spill_unmap, spill_forget, spill_fetch,
                           spill_compress, spill_decompress};
    *out = s;
    return SVO_OK;
}

void fmt_spill_close(fmt_spill *s)
{
    if (s == NULL) return;
    SVO_ASSERT(s->files_now == 0);
    pthread_mutex_destroy(&s->lock);
    fmt_zstd_pool_free(s->codec);
    free(s);
}

const svo_spill *fmt_spill_files(const fmt_spill *s) { return &s->files; }
const char *fmt_spill_folder(const fmt_spill *s) { return s->folder; }

bool fmt_spill_in_memory(const fmt_spill *s)
{
    struct statfs f;
    return statfs(s->folder, &f) == 0 && ((unsigned long)f.f_type == 0x01021994ul /* tmpfs */ || (unsigned long)f.f_type == 0x858458f6ul /* ramfs */);
}

fmt_spill_counts fmt_spill_count(const fmt_spill *s)
{
    fmt_spill *open = (fmt_spill *)(uintptr_t)s;
    pthread_mutex_lock(&open->lock);
    fmt_spill_counts c = s->counts;
    pthread_mutex_unlock(&open->lock);
    return c;
}
