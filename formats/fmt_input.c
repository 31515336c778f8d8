/* Inputs: mapped files, sequential streams, memory; and content hashes. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include "fmt_file.h"
#include "svo_task.h"

enum { READ_SIZE = 1 << 18 };

static const char *shown(const char *path) { return strcmp(path, "-") == 0 ? "stdin" : path; }

static svo_result open_for_reading(const char *path, int *fd, struct stat *s, svo_error *err)
{
    if (path[0] == 0) return svo_fail(err, SVO_INVALID_ARGUMENT, "the name of the input is empty");
    *fd = strcmp(path, "-") == 0 ? STDIN_FILENO : open(path, O_RDONLY | O_CLOEXEC);
    if (*fd < 0 || fstat(*fd, s) != 0) {
        int code = errno;
        if (*fd > STDIN_FILENO) close(*fd);
        return svo_fail(err, SVO_IO, "%s: cannot open: %s", shown(path), strerror(code));
    }
    if (S_ISDIR(s->st_mode)) {
        if (*fd != STDIN_FILENO) close(*fd);
        return svo_fail(err, SVO_IO, "%s is a folder, not a file", shown(path));
    }
    if (*fd == STDIN_FILENO && isatty(STDIN_FILENO))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "binary data is not read from a terminal; redirect a file or name one");
    return SVO_OK;
}

static svo_result read_some(int fd, const char *name, void *to, size_t size, size_t *got, svo_error *err)
{
    for (;;) {
        ssize_t n = read(fd, to, size < (1u << 30) ? size : 1u << 30);
        if (n >= 0) {
            *got = (size_t)n;
            return SVO_OK;
        }
        if (errno != EINTR) return svo_fail(err, SVO_IO, "%s: cannot read: %s", name, strerror(errno));
    }
}

static svo_result read_whole(int fd, const char *name, uint64_t max_bytes, fmt_bytes *out, svo_error *err)
{
    svo_buffer b;
    svo_buffer_init(&b, out->allocator);
    for (;;) {
        size_t got = 0;
        if (!svo_buffer_reserve(&b, READ_SIZE)) {
            svo_buffer_free(&b);
            return svo_fail(err, SVO_OUT_OF_MEMORY, "%s: no memory to read more than %zu bytes", name, b.size);
        }
        svo_result r = read_some(fd, name, b.data + b.size, b.capacity - b.size, &got, err);
        if (r == SVO_OK && max_bytes != 0 && b.size + got > max_bytes)
            r = svo_fail(err, SVO_LIMIT, "%s: longer than the limit of %llu bytes for what cannot be mapped", name, (unsigned long long)max_bytes);
        if (r != SVO_OK) {
            svo_buffer_free(&b);
            return r;
        }
        if (got == 0) break;
        b.size += got;
    }
    if (b.size == 0) {
        svo_buffer_free(&b);
        return SVO_OK;
    }
    out->data = b.data;
    out->size = b.size;
    out->capacity = b.capacity;
    return SVO_OK;
}

svo_result fmt_bytes_open(const char *path, uint64_t max_bytes, const svo_allocator *a, fmt_bytes *out, svo_error *err)
{
    int fd = -1;
    struct stat s;
    SVO_TRY(open_for_reading(path, &fd, &s, err));
    fmt_bytes b = {.allocator = a};
    svo_result r = SVO_OK;
    if (S_ISREG(s.st_mode) && s.st_size > 0 && (uint64_t)s.st_size <= SIZE_MAX && (fd != STDIN_FILENO || lseek(fd, 0, SEEK_CUR) == 0)) {
        void *p = mmap(NULL, (size_t)s.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
        if (p != MAP_FAILED) {
            b.data = p;
            b.size = (uint64_t)s.st_size;
            b.mapped = true;
        }
    }
    b.modified[0] = s.st_mtim.tv_sec;
    b.modified[1] = s.st_mtim.tv_nsec;
    b.inode = S_ISREG(s.st_mode) ? (uint64_t)s.st_ino : 0;
    b.device = (uint64_t)s.st_dev;
    if (!b.mapped) r = read_whole(fd, shown(path), max_bytes, &b, err);
    if (fd != STDIN_FILENO) close(fd);
    if (r == SVO_OK) *out = b;
    return r;
}

/* Copy what is left of `from` to `to`. */
static svo_result spool(int from, const char *name, int to, uint8_t *piece, uint64_t *size, svo_error *err)
{
    for (;;) {
        size_t got = 0;
        SVO_TRY(read_some(from, name, piece, READ_SIZE, &got, err));
        if (got == 0) return SVO_OK;
        *size += got;
        for (size_t done = 0; done < got;) {
            ssize_t n = write(to, piece + done, got - done);
            if (n < 0 && errno != EINTR) return svo_fail(err, SVO_IO, "cannot write a temporary file (TMPDIR): %s", strerror(errno));
            if (n > 0) done += (size_t)n;
        }
    }
}

svo_result fmt_bytes_open_spooled(const char *path, fmt_bytes *out, svo_error *err)
{
    int fd = -1, scratch = -1;
    struct stat s;
    SVO_TRY(open_for_reading(path, &fd, &s, err));
    if (S_ISREG(s.st_mode) && (fd != STDIN_FILENO || lseek(fd, 0, SEEK_CUR) == 0)) {
        if (fd != STDIN_FILENO) close(fd);
        return fmt_bytes_open(path, 0, NULL, out, err);
    }
    fmt_bytes b = {0};
    uint8_t *piece = svo_alloc(NULL, READ_SIZE, 1);
    svo_result r = piece != NULL ? fmt_scratch_file(&scratch, err) : svo_fail(err, SVO_OUT_OF_MEMORY, "%s: no memory for the input buffer", shown(path));
    if (r == SVO_OK) r = spool(fd, shown(path), scratch, piece, &b.size, err);
    if (r == SVO_OK && b.size != 0) {
        void *p = b.size <= SIZE_MAX ? mmap(NULL, (size_t)b.size, PROT_READ, MAP_PRIVATE, scratch, 0) : MAP_FAILED;
        if (p == MAP_FAILED) r = svo_fail(err, SVO_IO, "%s: cannot map its copy: %s", shown(path), strerror(errno));
        else b.data = p, b.mapped = true;
    }
    svo_free(NULL, piece, READ_SIZE, 1);
    if (scratch >= 0) close(scratch);
    if (fd != STDIN_FILENO) close(fd);
    if (r == SVO_OK) *out = b;
    return r;
}

svo_result fmt_bytes_unchanged(const char *path, const fmt_bytes *b, svo_error *err)
{
    struct stat s;
    svo_async_wait(b->beside);
    /* Another file under the name does not matter: the one that was opened is still there. */
    if (b->inode == 0 || stat(path, &s) != 0 || (uint64_t)s.st_ino != b->inode || (uint64_t)s.st_dev != b->device) return SVO_OK;
    if ((uint64_t)s.st_size == b->size && s.st_mtim.tv_sec == b->modified[0] && s.st_mtim.tv_nsec == b->modified[1]) return SVO_OK;
    return svo_fail(err, SVO_IO, "%s changed while it was read; try again when it is complete", path);
}

uint64_t fmt_file_bytes(const char *path)
{
    struct stat s;
    return stat(path, &s) == 0 && S_ISREG(s.st_mode) ? (uint64_t)s.st_size : 0;
}

void fmt_bytes_forget(const void *bytes, uint64_t size)
{
    const uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE), begin = ((uintptr_t)bytes + page - 1) / page * page, end = ((uintptr_t)bytes + (uintptr_t)size) / page * page;
    if (begin < end) (void)madvise((void *)begin, end - begin, MADV_DONTNEED);
}

void fmt_bytes_close(fmt_bytes *b)
{
    if (b == NULL || b->data == NULL) return;
    svo_async_wait(b->beside);
    if (b->mapped) munmap((void *)(uintptr_t)b->data, (size_t)b->size);
    else svo_free(b->allocator, (void *)(uintptr_t)b->data, b->capacity, 1);
    memset(b, 0, sizeof *b);
}

struct fmt_input {
    int fd; /* -1: memory */
    bool ended;
    uint64_t offset;
    const uint8_t *next; /* what has been read but not yet given */
    uint64_t left;
    char name[256]; /* for messages */
    uint8_t buffer[READ_SIZE];
};

static fmt_input *input_new(int fd)
{
    fmt_input *in = svo_alloc(NULL, 1, sizeof *in);
    if (in == NULL) return NULL;
    memset(in, 0, offsetof(fmt_input, buffer));
    in->fd = fd;
    return in;
}

svo_result fmt_input_open(const char *path, fmt_input **out, svo_error *err)
{
    int fd = -1;
    struct stat s;
    SVO_TRY(open_for_reading(path, &fd, &s, err));
    fmt_input *in = input_new(fd);
    if (in == NULL) {
        if (fd != STDIN_FILENO) close(fd);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "%s: no memory for the input buffer", shown(path));
    }
    strncpy(in->name, shown(path), sizeof in->name - 1);
    if (S_ISREG(s.st_mode)) (void)posix_fadvise(fd, 0, 0, POSIX_FADV_SEQUENTIAL);
    *out = in;
    return SVO_OK;
}

svo_result fmt_input_open_memory(const void *bytes, uint64_t size, fmt_input **out, svo_error *err)
{
    fmt_input *in = input_new(-1);
    if (in == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the input buffer");
    strcpy(in->name, "memory");
    in->next = bytes;
    in->left = size;
    in->ended = true;
    *out = in;
    return SVO_OK;
}

svo_result fmt_input_read(fmt_input *in, void *to, size_t size, size_t *got, svo_error *err)
{
    uint8_t *p = to;
    size_t done = 0;
    while (done < size) {
        if (in->left != 0) {
            size_t n = size - done < in->left ? size - done : (size_t)in->left;
            memcpy(p + done, in->next, n);
            in->next += n;
            in->left -= n;
            done += n;
            continue;
        }
        if (in->ended) break;
        size_t n = 0;
        bool direct = size - done >= sizeof in->buffer;
        SVO_TRY(read_some(in->fd, in->name, direct ? p + done : in->buffer, direct ? size - done : sizeof in->buffer, &n, err));
        if (n == 0) {
            in->ended = true;
        } else if (direct) {
            done += n;
        } else {
            in->next = in->buffer;
            in->left = n;
        }
    }
    in->offset += done;
    *got = done;
    return SVO_OK;
}

uint64_t fmt_input_offset(const fmt_input *in) { return in->offset; }

void fmt_input_close(fmt_input *in)
{
    if (in == NULL) return;
    if (in->fd > STDIN_FILENO) close(in->fd);
    svo_free(NULL, in, 1, sizeof *in);
}

void fmt_hash_text(const uint8_t hash[16], char out[33])
{
    static const char digits[] = "0123456789abcdef";
    for (int i = 0; i < 16; i++) {
        out[2 * i] = digits[hash[i] >> 4];
        out[2 * i + 1] = digits[hash[i] & 15];
    }
    out[32] = 0;
}

void fmt_hash_hex(const void *bytes, uint64_t size, char out[33])
{
    XXH128_canonical_t c;
    XXH128_canonicalFromHash(&c, XXH3_128bits(size != 0 ? bytes : "", (size_t)size));
    fmt_hash_text(c.digest, out);
}

void fmt_hash_file(const void *bytes, uint64_t size, bool mapped, char out[33])
{
    enum { AT_A_TIME = 8 << 20 };
    XXH3_state_t *state = mapped && size > AT_A_TIME ? XXH3_createState() : NULL;
    if (state == NULL) {
        fmt_hash_hex(bytes, size, out);
        return;
    }
    XXH3_128bits_reset(state);
    const uint8_t *p = bytes;
    for (uint64_t n; size != 0; size -= n, p += n) {
        n = size < AT_A_TIME ? size : AT_A_TIME;
        XXH3_128bits_update(state, p, (size_t)n);
        fmt_bytes_forget(p, n);
    }
    XXH128_canonical_t c;
    XXH128_canonicalFromHash(&c, XXH3_128bits_digest(state));
    XXH3_freeState(state);
    fmt_hash_text(c.digest, out);
}
