/* Outputs: written out of sight and given their name at the end. */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include "fmt_file.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "fmt_spill.h"
#include "fmti_cleanup.h"

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "svokit maps its files in place and runs on little-endian machines only"
#endif

enum { BUFFER_SIZE = 1 << 18 };

typedef enum sink {
    SINK_UNNAMED, /* O_TMPFILE: linked at commit, gone by itself otherwise */
    SINK_NAMED,   /* a file `temporary` beside the target, renamed at commit */
    SINK_DIRECT,  /* stdout, a device, a fifo: written as it comes */
    SINK_MEMORY
} sink;

struct fmt_output {
    sink sink;
    int fd;
    bool force, close_fd, failed;
    char path[PATH_MAX]; /* the target, symbolic links followed */
    char temporary[PATH_MAX];
    svo_buffer *memory;
    uint64_t offset;
    size_t used;
    uint8_t buffer[BUFFER_SIZE];
};

static svo_result io_fail(svo_error *err, const char *path, const char *what, int code)
{
    if (code == ENOSPC || code == EDQUOT)
        return svo_fail(err, SVO_IO, "%s: cannot %s: %s; free some space or choose another place", path, what, strerror(code));
    return svo_fail(err, SVO_IO, "%s: cannot %s: %s", path, what, strerror(code));
}

static svo_result exists_fail(svo_error *err, const char *path)
{
    return svo_fail(err, SVO_IO, "%s exists already; give --force to replace it", path);
}

/* A name beside the target that nothing has yet; the number of attempts is bounded. `use` is called with it until it
 * returns something else than EEXIST. */
static int with_fresh_name(fmt_output *o, int (*use)(fmt_output *o, const char *name))
{
    for (unsigned attempt = 0; attempt < 1000; attempt++) {
        if (!fmti_temporary_name(o->path, attempt, o->temporary, sizeof o->temporary)) return ENAMETOOLONG;
        int code = use(o, o->temporary);
        if (code != EEXIST) return code;
    }
    return EEXIST;
}

static int create_named(fmt_output *o, const char *name)
{
    o->fd = open(name, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (o->fd < 0) return errno;
    if (fmti_temporary_claim(o->fd, name)) return 0;
    close(o->fd);
    o->fd = -1;
    return EEXIST;
}

static int link_unnamed(fmt_output *o, const char *name)
{
    char self[64];
    snprintf(self, sizeof self, "/proc/self/fd/%d", o->fd);
    return linkat(AT_FDCWD, self, AT_FDCWD, name, AT_SYMLINK_FOLLOW) != 0 ? errno : 0;
}

static svo_result open_target(fmt_output *o, const char *path, svo_error *err)
{
    struct stat s;
    mode_t old_mode = 0;
    if (snprintf(o->path, sizeof o->path, "%s", path) >= (int)sizeof o->path) return io_fail(err, path, "create the file", ENAMETOOLONG);
    if (stat(path, &s) == 0) {
        if (S_ISDIR(s.st_mode)) return svo_fail(err, SVO_IO, "%s is a folder, not a file", path);
        if (!S_ISREG(s.st_mode)) { /* a device or a fifo is written, never replaced */
            o->sink = SINK_DIRECT;
            o->fd = open(path, O_WRONLY | O_CLOEXEC);
            return o->fd < 0 ? io_fail(err, path, "open it for writing", errno) : SVO_OK;
        }
        if (!o->force) return exists_fail(err, path);
        char real[PATH_MAX];
        if (realpath(path, real) != NULL) memcpy(o->path, real, strlen(real) + 1); /* keep a symbolic link, replace what it names */
        old_mode = s.st_mode & 07777;
    } else if (errno != ENOENT) {
        return io_fail(err, path, "create the file", errno);
    } else if (!o->force && lstat(path, &s) == 0) {
        return exists_fail(err, path);
    }
    char folder[PATH_MAX];
    fmt_folder_of(o->path, folder, sizeof folder);
    if (access(folder, F_OK) != 0) return svo_fail(err, SVO_IO, "%s: the folder %s does not exist", path, folder);
    fmt_output_remove_leftovers(o->path);
    o->fd = -1;
#ifdef O_TMPFILE
    if (access("/proc/self/fd", X_OK) == 0) {
        o->sink = SINK_UNNAMED;
        o->fd = open(folder, O_TMPFILE | O_WRONLY | O_CLOEXEC, 0666);
    }
#endif
    if (o->fd < 0) {
        o->sink = SINK_NAMED;
        int code = with_fresh_name(o, create_named);
        if (code != 0) return io_fail(err, path, "create the file", code);
        fmti_temporary_remember(o->temporary);
    }
    if (old_mode != 0 && fchmod(o->fd, old_mode) != 0) { /* not worth failing for */
    }
    return SVO_OK;
}

svo_result fmt_output_open(const char *path, bool force, fmt_output **out, svo_error *err)
{
    SVO_ASSERT(path != NULL && out != NULL);
    if (path[0] == 0) return svo_fail(err, SVO_INVALID_ARGUMENT, "the name of the output is empty");
    fmt_output *o = svo_alloc(NULL, 1, sizeof *o);
    if (o == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "%s: no memory for the output buffer", path);
    memset(o, 0, offsetof(fmt_output, buffer));
    o->force = force;
    o->fd = -1;
    if (strcmp(path, "-") == 0) {
        if (isatty(STDOUT_FILENO)) {
            svo_free(NULL, o, 1, sizeof *o);
            return svo_fail(err, SVO_INVALID_ARGUMENT, "binary data is not written to a terminal; redirect it or name a file with -o");
        }
        o->sink = SINK_DIRECT;
        o->fd = STDOUT_FILENO;
        strcpy(o->path, "stdout");
        *out = o;
        return SVO_OK;
    }
    svo_result r = open_target(o, path, err);
    if (r != SVO_OK) {
        svo_free(NULL, o, 1, sizeof *o);
        return r;
    }
    o->close_fd = true;
    *out = o;
    return SVO_OK;
}

svo_result fmt_output_open_memory(svo_buffer *to, fmt_output **out, svo_error *err)
{
    fmt_output *o = svo_alloc(NULL, 1, sizeof *o);
    if (o == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the output buffer");
    memset(o, 0, offsetof(fmt_output, buffer));
    o->sink = SINK_MEMORY;
    o->fd = -1;
    o->memory = to;
    strcpy(o->path, "memory");
    to->size = 0;
    *out = o;
    return SVO_OK;
}

static svo_result write_all(fmt_output *o, const uint8_t *bytes, size_t size, svo_error *err)
{
    if (o->sink == SINK_MEMORY) {
        if (svo_buffer_append(o->memory, bytes, size) == NULL)
            return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %zu more bytes of output", size);
        return SVO_OK;
    }
    while (size != 0) {
        ssize_t n = write(o->fd, bytes, size < (1u << 30) ? size : 1u << 30);
        if (n < 0) {
            if (errno == EINTR) continue;
            if (errno == EAGAIN || errno == EWOULDBLOCK) { /* somebody made our stdout non-blocking */
                struct pollfd p = {.fd = o->fd, .events = POLLOUT};
                poll(&p, 1, -1);
                continue;
            }
            if (errno == EPIPE) return svo_fail(err, SVO_IO, "%s: the reader of the pipe has gone", o->path);
            return io_fail(err, o->path, "write", errno);
        }
        bytes += n;
        size -= (size_t)n;
    }
    return SVO_OK;
}

static svo_result flush(fmt_output *o, svo_error *err)
{
    size_t n = o->used;
    o->used = 0;
    return write_all(o, o->buffer, n, err);
}

svo_result fmt_output_write(fmt_output *o, const void *bytes, size_t size, svo_error *err)
{
    if (size == 0) return SVO_OK;
    svo_result r = SVO_OK;
    if (size > sizeof o->buffer - o->used) r = flush(o, err);
    if (r == SVO_OK && size >= sizeof o->buffer) {
        r = write_all(o, bytes, size, err);
    } else if (r == SVO_OK) {
        memcpy(o->buffer + o->used, bytes, size);
        o->used += size;
    }
    if (r != SVO_OK) {
        o->failed = true;
        return r;
    }
    o->offset += size;
    return SVO_OK;
}

svo_result fmt_output_align(fmt_output *o, uint32_t align, svo_error *err)
{
    static const uint8_t zeros[4096];
    SVO_ASSERT(align != 0 && align <= sizeof zeros);
    size_t over = (size_t)(o->offset % align);
    return over == 0 ? SVO_OK : fmt_output_write(o, zeros, align - over, err);
}

uint64_t fmt_output_offset(const fmt_output *o) { return o->offset; }

static void release(fmt_output *o)
{
    if (o->sink == SINK_NAMED) fmti_temporary_forget(o->temporary);
    if (o->close_fd && o->fd >= 0) close(o->fd);
    svo_free(NULL, o, 1, sizeof *o);
}

void fmt_output_discard(fmt_output *o)
{
    if (o == NULL) return;
    if (o->sink == SINK_NAMED) unlink(o->temporary);
    if (o->sink == SINK_MEMORY) o->memory->size = 0;
    release(o);
}

/* Name a file that has a temporary name, without replacing anything. */
static int rename_new(const char *from, const char *to)
{
#ifdef RENAME_NOREPLACE
    if (renameat2(AT_FDCWD, from, AT_FDCWD, to, RENAME_NOREPLACE) == 0) return 0;
    if (errno != EINVAL && errno != ENOSYS) return errno;
#endif
    if (link(from, to) == 0) {
        unlink(from);
        return 0;
    }
    if (errno != EPERM && errno != ENOSYS && errno != EOPNOTSUPP) return errno;
    struct stat s; /* a file system without links: the check and the rename cannot be one step */
    if (lstat(to, &s) == 0) return EEXIST;
    return rename(from, to) != 0 ? errno : 0;
}

static int give_name(fmt_output *o)
{
    if (o->sink == SINK_UNNAMED) {
        int code = link_unnamed(o, o->path);
        if (code != EEXIST || !o->force) return code;
        fmti_temporary_claim(o->fd, NULL); /* it has no name yet: nobody else can have the lock */
        code = with_fresh_name(o, link_unnamed); /* there is no linkat that replaces */
        if (code != 0) return code;
        fmti_temporary_remember(o->temporary);
        if (rename(o->temporary, o->path) != 0) {
            code = errno;
            unlink(o->temporary);
        }
        fmti_temporary_forget(o->temporary);
        return code;
    }
    if (!o->force) return rename_new(o->temporary, o->path);
    return rename(o->temporary, o->path) != 0 ? errno : 0;
}

svo_result fmt_output_commit(fmt_output *o, svo_error *err)
{
    if (o->failed) {
        svo_result r = svo_fail(err, SVO_IO, "%s: not kept, because an earlier write failed", o->path);
        fmt_output_discard(o);
        return r;
    }
    svo_result r = flush(o, err);
    if (r == SVO_OK && (o->sink == SINK_UNNAMED || o->sink == SINK_NAMED)) {
        /* Network file systems report a full disk only when the file is closed; a second descriptor asks for that now. */
        int copy = dup(o->fd);
        if (copy >= 0 && close(copy) != 0 && errno != EINTR) r = io_fail(err, o->path, "write", errno);
        if (r == SVO_OK) {
            int code = give_name(o);
            if (code == EEXIST) r = exists_fail(err, o->path);
            else if (code != 0) r = io_fail(err, o->path, "create the file", code);
        }
    }
    if (r != SVO_OK) {
        fmt_output_discard(o);
        return r;
    }
    if (o->close_fd && o->sink == SINK_DIRECT) {
        int fd = o->fd;
        o->fd = -1;
        if (close(fd) != 0 && errno != EINTR) r = io_fail(err, o->path, "write", errno);
    }
    release(o);
    return r;
}
