/* Outputs and inputs: nothing appears before it is complete, nothing is lost, nothing is left behind. */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "fmt_file.h"
#include "test.h"

static svo_error err;
static char folder[200], target[256];

/* A fresh folder with nothing in it, and the path of a file in it. */
static void fresh(void)
{
    static int number;
    snprintf(folder, sizeof folder, "%s/%d", test_folder(), number++);
    if (mkdir(folder, 0777) != 0) abort();
    snprintf(target, sizeof target, "%s/target.bin", folder);
}

static int entries(void)
{
    DIR *d = opendir(folder);
    int n = 0;
    for (struct dirent *e = readdir(d); e != NULL; e = readdir(d)) n += e->d_name[0] != '.' || strlen(e->d_name) > 2;
    closedir(d);
    return n;
}

static void put(const char *path, const char *text)
{
    FILE *f = fopen(path, "wb");
    if (f == NULL || fputs(text, f) < 0 || fclose(f) != 0) abort();
}

static bool holds(const char *path, const char *text)
{
    char got[100] = {0};
    FILE *f = fopen(path, "rb");
    if (f == NULL) return false;
    size_t n = fread(got, 1, sizeof got - 1, f);
    fclose(f);
    return n == strlen(text) && memcmp(got, text, n) == 0;
}

TEST(nothing_appears_before_commit)
{
    fresh();
    fmt_output *o = NULL;
    CHECK_OK(fmt_output_open(target, false, &o, &err));
    CHECK_OK(fmt_output_write(o, "new", 3, &err));
    CHECK(access(target, F_OK) != 0);
    CHECK_U64(fmt_output_offset(o), 3);
    CHECK_OK(fmt_output_commit(o, &err));
    CHECK(holds(target, "new"));
    CHECK_U64(entries(), 1);
}

TEST(a_discarded_output_leaves_nothing)
{
    fresh();
    static uint8_t big[1 << 20];
    fmt_output *o = NULL;
    CHECK_OK(fmt_output_open(target, false, &o, &err));
    CHECK_OK(fmt_output_write(o, big, sizeof big, &err));
    fmt_output_discard(o);
    fmt_output_discard(NULL);
    CHECK_U64(entries(), 0);
}

TEST(an_existing_file_needs_force)
{
    fresh();
    put(target, "old");
    fmt_output *o = NULL;
    CHECK_RESULT(fmt_output_open(target, false, &o, &err), SVO_IO);
    CHECK(strstr(err.message, "--force") != NULL);
    CHECK_OK(fmt_output_open(target, true, &o, &err));
    CHECK_OK(fmt_output_write(o, "new", 3, &err));
    CHECK(holds(target, "old"));
    fmt_output_discard(o);
    CHECK(holds(target, "old"));
    CHECK(chmod(target, 0640) == 0);
    CHECK_OK(fmt_output_open(target, true, &o, &err));
    CHECK_OK(fmt_output_write(o, "newer", 5, &err));
    CHECK_OK(fmt_output_commit(o, &err));
    CHECK(holds(target, "newer"));
    struct stat s;
    CHECK(stat(target, &s) == 0 && (s.st_mode & 07777) == 0640);
    CHECK_U64(entries(), 1);
}

TEST(a_file_that_appears_meanwhile_is_not_replaced)
{
    fresh();
    fmt_output *o = NULL;
    CHECK_OK(fmt_output_open(target, false, &o, &err));
    CHECK_OK(fmt_output_write(o, "mine", 4, &err));
    put(target, "theirs");
    CHECK_RESULT(fmt_output_commit(o, &err), SVO_IO);
    CHECK(holds(target, "theirs"));
    CHECK_U64(entries(), 1);
}

TEST(a_symbolic_link_stays_one)
{
    fresh();
    char link[256];
    struct stat s;
    put(target, "old");
    snprintf(link, sizeof link, "%s/link", folder);
    CHECK(symlink("target.bin", link) == 0);
    fmt_output *o = NULL;
    CHECK_RESULT(fmt_output_open(link, false, &o, &err), SVO_IO);
    CHECK_OK(fmt_output_open(link, true, &o, &err));
    CHECK_OK(fmt_output_write(o, "new", 3, &err));
    CHECK_OK(fmt_output_commit(o, &err));
    CHECK(lstat(link, &s) == 0 && S_ISLNK(s.st_mode) && holds(target, "new"));
    CHECK(unlink(target) == 0); /* now it leads nowhere: still not overwritten without force */
    CHECK_RESULT(fmt_output_open(link, false, &o, &err), SVO_IO);
    CHECK_U64(entries(), 1);
}

TEST(bad_places_are_refused)
{
    fresh();
    fmt_output *o = NULL;
    char path[300];
    snprintf(path, sizeof path, "%s/none/x", folder);
    CHECK_RESULT(fmt_output_open(path, false, &o, &err), SVO_IO);
    CHECK_RESULT(fmt_output_open(folder, true, &o, &err), SVO_IO);
    CHECK_RESULT(fmt_output_open("", true, &o, &err), SVO_INVALID_ARGUMENT);
    put(target, "a file");
    snprintf(path, sizeof path, "%s/x", target);
    CHECK_RESULT(fmt_output_open(path, false, &o, &err), SVO_IO);
}

TEST(a_full_device_is_an_error)
{
    static uint8_t big[1 << 19];
    fmt_output *o = NULL;
    if (access("/dev/full", W_OK) != 0) {
        test_skip("no /dev/full");
        return;
    }
    CHECK_OK(fmt_output_open("/dev/full", false, &o, &err));
    CHECK_RESULT(fmt_output_write(o, big, sizeof big, &err), SVO_IO);
    CHECK_RESULT(fmt_output_commit(o, &err), SVO_IO);
    CHECK_OK(fmt_output_open("/dev/full", false, &o, &err));
    CHECK_OK(fmt_output_write(o, big, 10, &err)); /* still in the buffer */
    CHECK_RESULT(fmt_output_commit(o, &err), SVO_IO);
}

/* Run in a child process; its exit code. */
static int in_child(void (*fn)(void))
{
    fflush(NULL);
    pid_t pid = fork();
    if (pid == 0) {
        fn();
        _exit(0);
    }
    int status = 0;
    waitpid(pid, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 100 + WTERMSIG(status);
}

static void write_beyond_the_limit(void)
{
    static uint8_t big[1 << 20];
    struct rlimit limit = {100000, 100000};
    signal(SIGXFSZ, SIG_IGN);
    fmt_output *o = NULL;
    if (setrlimit(RLIMIT_FSIZE, &limit) != 0) _exit(77);
    if (fmt_output_open(target, true, &o, &err) != SVO_OK) _exit(1);
    if (fmt_output_write(o, big, sizeof big, &err) != SVO_IO) _exit(2);
    if (fmt_output_commit(o, &err) != SVO_IO) _exit(3);
}

TEST(a_full_disk_leaves_the_old_file)
{
    fresh();
    put(target, "old");
    CHECK_U64(in_child(write_beyond_the_limit), 0);
    CHECK(holds(target, "old"));
    CHECK_U64(entries(), 1);
}

static void die_while_writing(void)
{
    static uint8_t big[1 << 20];
    fmt_output *o = NULL;
    if (fmt_output_open(target, true, &o, &err) != SVO_OK) _exit(1);
    if (fmt_output_write(o, big, sizeof big, &err) != SVO_OK) _exit(2);
    kill(getpid(), SIGKILL);
}

TEST(even_a_killed_program_leaves_nothing)
{
    fresh();
#ifdef O_TMPFILE
    int fd = open(folder, O_TMPFILE | O_WRONLY, 0600);
#else
    int fd = -1;
#endif
    if (fd < 0) {
        test_skip("this file system has no unnamed files");
        return;
    }
    close(fd);
    put(target, "old");
    CHECK_U64(in_child(die_while_writing), 100 + SIGKILL);
    CHECK(holds(target, "old"));
    CHECK_U64(entries(), 1);
}

/* What a process leaves that is killed between naming a temporary file and renaming it: the file, without the lock that ends with the process. */
TEST(leftovers_of_killed_programs_go_with_the_next_output)
{
    char left[8][300];
    for (int force = 0; force < 2; force++) {
        fresh();
        if (force) put(target, "old");
        for (int i = 0; i < 8; i++) snprintf(left[i], sizeof left[i], "%s.svokit-part-%d", target, i);
        put(left[0], "half");
        put(left[3], "half"); /* its neighbours came to their end */
        fmt_output *o = NULL;
        CHECK_OK(fmt_output_open(target, force != 0, &o, &err));
        CHECK(access(left[3], F_OK) != 0);
        CHECK_OK(fmt_output_write(o, "new", 3, &err));
        CHECK_OK(fmt_output_commit(o, &err));
        CHECK(holds(target, "new"));
        CHECK_U64(entries(), 1);
    }
}

TEST(names_that_are_not_ours_stay)
{
    fresh();
    char theirs[300];
    snprintf(theirs, sizeof theirs, "%s.part-0", target); /* what downloads in parts are called */
    put(theirs, "theirs");
    fmt_output *o = NULL;
    CHECK_OK(fmt_output_open(target, false, &o, &err));
    CHECK_OK(fmt_output_commit(o, &err));
    CHECK(holds(theirs, "theirs"));
    CHECK_U64(entries(), 2);
}

TEST(files_of_others_at_work_stay)
{
    fresh();
    char theirs[300], folder_there[300];
    snprintf(theirs, sizeof theirs, "%s.svokit-part-0", target);
    snprintf(folder_there, sizeof folder_there, "%s.svokit-part-1", target);
    put(target, "old");
    put(theirs, "theirs");
    CHECK(mkdir(folder_there, 0777) == 0);
    int fd = open(theirs, O_RDWR | O_CLOEXEC);
    CHECK(fd >= 0 && flock(fd, LOCK_EX | LOCK_NB) == 0);
    fmt_output *a = NULL, *b = NULL;
    CHECK_OK(fmt_output_open(target, true, &a, &err));
    CHECK_OK(fmt_output_open(target, true, &b, &err)); /* two at a time, in one process or two */
    CHECK_OK(fmt_output_write(a, "first", 5, &err));
    CHECK_OK(fmt_output_write(b, "second", 6, &err));
    CHECK_OK(fmt_output_commit(a, &err));
    CHECK(holds(target, "first"));
    CHECK_OK(fmt_output_commit(b, &err));
    CHECK(holds(target, "second"));
    CHECK(holds(theirs, "theirs"));
    CHECK_U64(entries(), 3);
    close(fd);
    fmt_output_remove_leftovers(target);
    CHECK_U64(entries(), 2); /* a folder is nobody's output */
    CHECK(rmdir(folder_there) == 0);
}

TEST(a_reader_that_goes_away_is_an_error)
{
    int ends[2];
    char path[64];
    static uint8_t big[1 << 20];
    fmt_output *o = NULL;
    signal(SIGPIPE, SIG_IGN);
    CHECK(pipe(ends) == 0);
    snprintf(path, sizeof path, "/dev/fd/%d", ends[1]);
    CHECK_OK(fmt_output_open(path, false, &o, &err));
    close(ends[0]);
    CHECK_RESULT(fmt_output_write(o, big, sizeof big, &err), SVO_IO);
    CHECK(strstr(err.message, "pipe") != NULL);
    fmt_output_discard(o);
    close(ends[1]);
}

TEST(alignment_pads_with_zeros)
{
    svo_buffer b;
    svo_buffer_init(&b, NULL);
    fmt_output *o = NULL;
    CHECK_OK(fmt_output_open_memory(&b, &o, &err));
    CHECK_OK(fmt_output_write(o, "abc", 3, &err));
    CHECK_OK(fmt_output_align(o, 64, &err));
    CHECK_OK(fmt_output_align(o, 64, &err));
    CHECK_U64(fmt_output_offset(o), 64);
    CHECK_OK(fmt_output_commit(o, &err));
    CHECK(b.size == 64 && b.data[2] == 'c' && b.data[3] == 0 && b.data[63] == 0);
    svo_buffer_free(&b);
}

/* A pipe that gives `size` bytes, a few at a time. */
static int dribble(const uint8_t *bytes, size_t size)
{
    int ends[2];
    if (pipe(ends) != 0) abort();
    fflush(NULL);
    if (fork() == 0) {
        close(ends[0]);
        for (size_t at = 0, n = 1; at < size; at += n, n = n % 4000 + 7)
            if (write(ends[1], bytes + at, size - at < n ? size - at : n) < 0) _exit(1);
        _exit(0);
    }
    close(ends[1]);
    return ends[0];
}

TEST(pipes_and_files_read_alike)
{
    static uint8_t bytes[700001], got[sizeof bytes + 1];
    uint64_t seed = 3;
    for (size_t i = 0; i < sizeof bytes; i++) bytes[i] = (uint8_t)test_random(&seed);
    char path[64];
    for (int way = 0; way < 3; way++) {
        int fd = dribble(bytes, sizeof bytes);
        snprintf(path, sizeof path, "/dev/fd/%d", fd);
        if (way == 0) { /* a stream in pieces of odd sizes */
            fmt_input *in;
            size_t n, at = 0;
            CHECK_OK(fmt_input_open(path, &in, &err));
            for (size_t want = 1; at < sizeof got; want = want * 3 % 300007 + 1) {
                CHECK_OK(fmt_input_read(in, got + at, want < sizeof got - at ? want : sizeof got - at, &n, &err));
                at += n;
                CHECK_U64(fmt_input_offset(in), at);
                if (n == 0) break;
            }
            CHECK(at == sizeof bytes && memcmp(got, bytes, at) == 0);
            fmt_input_close(in);
        } else {
            fmt_bytes b;
            if (way == 1) CHECK_OK(fmt_bytes_open(path, 0, NULL, &b, &err));
            else CHECK_OK(fmt_bytes_open_spooled(path, &b, &err));
            CHECK(b.size == sizeof bytes && memcmp(b.data, bytes, sizeof bytes) == 0 && (uintptr_t)b.data % 64 == 0);
            CHECK(b.mapped == (way == 2));
            fmt_bytes_close(&b);
        }
        close(fd);
        wait(NULL);
    }
    int fd = dribble(bytes, 5000);
    fmt_bytes b;
    snprintf(path, sizeof path, "/dev/fd/%d", fd);
    CHECK_RESULT(fmt_bytes_open(path, 4999, NULL, &b, &err), SVO_LIMIT);
    close(fd);
    wait(NULL);
}

TEST(files_are_mapped)
{
    fresh();
    fmt_bytes b;
    CHECK_RESULT(fmt_bytes_open(target, 0, NULL, &b, &err), SVO_IO);
    CHECK_RESULT(fmt_bytes_open(folder, 0, NULL, &b, &err), SVO_IO);
    put(target, "");
    CHECK_OK(fmt_bytes_open(target, 0, NULL, &b, &err));
    CHECK_U64(b.size, 0);
    fmt_bytes_close(&b);
    put(target, "some bytes");
    CHECK_OK(fmt_bytes_open(target, 0, NULL, &b, &err));
    CHECK(b.mapped && b.size == 10 && memcmp(b.data, "some bytes", 10) == 0);
    fmt_bytes_close(&b);
}

TEST(hashes_are_those_of_xxh3)
{
    char hex[33];
    fmt_hash_hex(NULL, 0, hex); /* the published value of the empty input */
    CHECK_MSG(strcmp(hex, "99aa06d3014798d86001c324468d497f") == 0, "%s", hex);
}
