/* Temporary files: what is written is what is read, from several threads; limits; a full disk; nothing left behind. */
#include <dirent.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

#include "fmt_spill.h"
#include "svo_task.h"
#include "test.h"

static uint32_t entries(const char *folder)
{
    DIR *d = opendir(folder);
    uint32_t n = 0;
    for (struct dirent *e; d != NULL && (e = readdir(d)) != NULL;) n += e->d_name[0] != '.';
    if (d != NULL) closedir(d);
    return n;
}

enum { PIECE = 4099, PIECES = 400 };

static void fill(uint8_t *bytes, uint64_t number)
{
    uint64_t state = number + 1;
    for (uint32_t i = 0; i < PIECE; i++) bytes[i] = (uint8_t)test_random(&state);
}

static svo_result write_pieces(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    uint8_t bytes[PIECE];
    for (uint64_t i = begin; i < end; i++) {
        fill(bytes, i);
        SVO_TRY(svo_spill_write(user, i * PIECE, bytes, PIECE, err));
    }
    return SVO_OK;
}

static svo_result check_pieces(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    uint8_t bytes[PIECE], expected[PIECE];
    for (uint64_t i = begin; i < end; i++) {
        uint64_t at = (i * 7919) % PIECES;
        fill(expected, at);
        SVO_TRY(svo_spill_read(user, at * PIECE, bytes, PIECE, err));
        if (memcmp(bytes, expected, PIECE) != 0) return svo_fail(err, SVO_RUNTIME, "piece %d differs", (int)at);
    }
    return SVO_OK;
}

TEST(threads_write_and_read_one_file)
{
    svo_error err = {0};
    fmt_spill *s = NULL;
    svo_spill_file f = {0};
    uint32_t before = entries(test_folder());
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder()}, &s, &err));
    CHECK_OK(svo_spill_open(fmt_spill_files(s), &f, &err));
    CHECK_OK(svo_parallel_for(4, PIECES, 1, write_pieces, &f, &err));
    CHECK_OK(svo_parallel_for(4, PIECES, 1, check_pieces, &f, &err));
    CHECK_U64(entries(test_folder()), before); /* it has no name */
    fmt_spill_counts c = fmt_spill_count(s);
    CHECK_U64(c.files, 1);
    CHECK_U64(c.files_peak, 1);
    CHECK_U64(c.bytes_written, (uint64_t)PIECE * PIECES);
    CHECK_U64(c.bytes_read, (uint64_t)PIECE * PIECES);
    CHECK_U64(c.bytes_now, (uint64_t)PIECE * PIECES);
    svo_spill_discard(&f, 0, (uint64_t)PIECE * PIECES / 2);
    CHECK(fmt_spill_count(s).bytes_now <= c.bytes_now);
    svo_spill_close(&f);
    c = fmt_spill_count(s);
    CHECK_U64(c.bytes_now, 0);
    CHECK_U64(c.bytes_peak, (uint64_t)PIECE * PIECES);
    fmt_spill_close(s);
}

/* Writers with neighbouring ranges and buffers of odd sizes; readers that consume. */
TEST(writers_and_readers)
{
    svo_error err = {0};
    fmt_spill *s = NULL;
    svo_spill_file f = {0};
    enum { WRITERS = 5, RANGE = 100003 };
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder()}, &s, &err));
    CHECK_OK(svo_spill_open(fmt_spill_files(s), &f, &err));
    svo_spill_writer w[WRITERS];
    uint8_t buffers[WRITERS][777], bytes[2000], expected[2000];
    uint64_t state = 1, given[WRITERS] = {0};
    for (uint32_t i = 0; i < WRITERS; i++) svo_spill_writer_init(&w[i], &f, (uint64_t)i * RANGE, buffers[i], 1 + 194 * i);
    for (bool more = true; more;) {
        more = false;
        for (uint32_t i = 0; i < WRITERS; i++) {
            uint64_t n = test_random(&state) % sizeof bytes;
            if (n > RANGE - given[i]) n = RANGE - given[i];
            for (uint64_t k = 0; k < n; k++) bytes[k] = (uint8_t)((given[i] + k) * 31 + i);
            CHECK_OK(svo_spill_put(&w[i], bytes, n, &err));
            given[i] += n;
            CHECK_U64(svo_spill_tell(&w[i]), (uint64_t)i * RANGE + given[i]);
            more |= given[i] < RANGE;
        }
    }
    for (uint32_t i = 0; i < WRITERS; i++) CHECK_OK(svo_spill_flush(&w[i], &err));
    for (uint32_t i = 0; i < WRITERS; i++) {
        svo_spill_reader r;
        svo_spill_reader_init(&r, &f, (uint64_t)i * RANGE, (uint64_t)(i + 1) * RANGE, true, buffers[i], 1 + 194 * i);
        for (uint64_t at = 0; at < RANGE;) {
            uint64_t n = test_random(&state) % sizeof bytes;
            if (n > RANGE - at) n = RANGE - at;
            CHECK_OK(svo_spill_get(&r, bytes, n, &err));
            for (uint64_t k = 0; k < n; k++) expected[k] = (uint8_t)((at + k) * 31 + i);
            CHECK(memcmp(bytes, expected, n) == 0);
            at += n;
            CHECK_U64(svo_spill_left(&r), RANGE - at);
        }
    }
    svo_spill_close(&f);
    fmt_spill_close(s);
}

TEST(a_limit_is_kept_and_space_comes_back)
{
    svo_error err = {0};
    fmt_spill *s = NULL;
    svo_spill_file f = {0}, g = {0};
    static uint8_t bytes[1 << 16];
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder(), .limit = 3 << 16}, &s, &err));
    CHECK_OK(svo_spill_open(fmt_spill_files(s), &f, &err));
    CHECK_OK(svo_spill_open(fmt_spill_files(s), &g, &err));
    CHECK_OK(svo_spill_append(&f, bytes, sizeof bytes, &err));
    CHECK_OK(svo_spill_append(&f, bytes, sizeof bytes, &err));
    CHECK_OK(svo_spill_append(&g, bytes, sizeof bytes, &err));
    CHECK_RESULT(svo_spill_append(&g, bytes, 1, &err), SVO_LIMIT);
    CHECK_OK(svo_spill_write(&f, 0, bytes, sizeof bytes, &err)); /* what is there already costs nothing */
    svo_spill_close(&f);
    CHECK_OK(svo_spill_append(&g, bytes, sizeof bytes, &err));
    CHECK_U64(fmt_spill_count(s).bytes_peak, 3 << 16);
    CHECK_U64(fmt_spill_count(s).files_peak, 2);
    svo_spill_close(&g);
    fmt_spill_close(s);
}

/* A limit on the size of files stands for a full disk: both are told by the write. */
TEST(a_full_disk_is_an_io_error_that_names_the_place)
{
    svo_error err = {0};
    fmt_spill *s = NULL;
    svo_spill_file f = {0};
    static uint8_t bytes[1 << 16];
    struct rlimit old, few;
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder()}, &s, &err));
    CHECK_OK(svo_spill_open(fmt_spill_files(s), &f, &err));
    CHECK(getrlimit(RLIMIT_FSIZE, &old) == 0);
    few = old;
    few.rlim_cur = 100000;
    void (*handler)(int) = signal(SIGXFSZ, SIG_IGN);
    CHECK(setrlimit(RLIMIT_FSIZE, &few) == 0);
    svo_result first = svo_spill_append(&f, bytes, sizeof bytes, &err), second = svo_spill_append(&f, bytes, sizeof bytes, &err);
    setrlimit(RLIMIT_FSIZE, &old);
    signal(SIGXFSZ, handler);
    CHECK_U64(first, SVO_OK);
    CHECK_RESULT(second, SVO_IO);
    CHECK_MSG(strstr(err.message, test_folder()) != NULL && strstr(err.message, "--temp") != NULL, "%s", err.message);
    svo_spill_close(&f);
    fmt_spill_close(s);
}

TEST(places_that_cannot_hold_files_are_refused)
{
    svo_error err = {0};
    fmt_spill *s = NULL;
    CHECK_RESULT(fmt_spill_open(&(fmt_spill_options){.folder = "/nonexistent/folder"}, &s, &err), SVO_IO);
    CHECK_RESULT(fmt_spill_open(&(fmt_spill_options){.folder = "/dev/null"}, &s, &err), SVO_IO);
    CHECK(strstr(err.message, "/dev/null") != NULL);
    /* A reserve larger than any disk: refused at the first write. */
    svo_spill_file f = {0};
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder(), .reserve = UINT64_MAX / 2}, &s, &err));
    CHECK_OK(svo_spill_open(fmt_spill_files(s), &f, &err));
    CHECK_RESULT(svo_spill_append(&f, "x", 1, &err), SVO_IO);
    svo_spill_close(&f);
    fmt_spill_close(s);
}

TEST(the_place_is_the_option_then_tmpdir_then_beside_the_output)
{
    svo_error err = {0};
    fmt_spill *s = NULL;
    char output[600];
    snprintf(output, sizeof output, "%s/x.svo", test_folder());
    const char *old = getenv("TMPDIR");
    char keep[600];
    snprintf(keep, sizeof keep, "%s", old != NULL ? old : "");
    unsetenv("TMPDIR");
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.beside = output}, &s, &err));
    CHECK(strcmp(fmt_spill_folder(s), test_folder()) == 0);
    fmt_spill_close(s);
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.beside = "-"}, &s, &err));
    CHECK(strcmp(fmt_spill_folder(s), "/tmp") == 0);
    fmt_spill_close(s);
    setenv("TMPDIR", "/", 1);
    svo_result r = fmt_spill_open(&(fmt_spill_options){.beside = output}, &s, &err);
    if (r == SVO_OK) { /* a user who may write there */
        CHECK(strcmp(fmt_spill_folder(s), "/") == 0);
        fmt_spill_close(s);
    }
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder(), .beside = "y"}, &s, &err));
    CHECK(strcmp(fmt_spill_folder(s), test_folder()) == 0);
    fmt_spill_close(s);
    if (old != NULL) setenv("TMPDIR", keep, 1);
    else unsetenv("TMPDIR");
}
