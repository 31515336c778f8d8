#define _GNU_SOURCE
#include "cli_sources.h"

#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <xxhash.h>

#include "fmt_file.h"
#include "svo_task.h"

enum { HASHED_BESIDE = 4 << 20 }; /* bytes: what takes longer than waking a thread */

typedef struct sources_work {
    const uint8_t *bytes;
    uint64_t size;
    bool mapped;
    char *hash;
    svo_async *beside;
} sources_work;

static void hash_source(void *user)
{
    const sources_work *w = user;
    fmt_hash_file(w->bytes, w->size, w->mapped, w->hash);
}

struct svo_async *sources_add(void *user, const char *path, const uint8_t *bytes, uint64_t size, bool mapped)
{
    sources *s = user;
    if (s->count == s->capacity) {
        size_t capacity = s->capacity != 0 ? 2 * s->capacity : 16;
        source *list = realloc(s->list, capacity * sizeof *list);
        if (list == NULL) {
            s->failed = true;
            return NULL;
        }
        s->list = list;
        s->capacity = capacity;
    }
    source n = {.path = strdup(path), .hash = s->names_only ? NULL : malloc(33)};
    if (n.path == NULL || (n.hash == NULL && !s->names_only)) {
        free(n.path);
        free(n.hash);
        s->failed = true;
        return NULL;
    }
    sources_work now = {.bytes = bytes, .size = size, .mapped = mapped, .hash = n.hash};
    if (s->names_only) {
        s->list[s->count++] = n;
        return NULL;
    }
    if (s->beside && size >= HASHED_BESIDE) {
        sources_settle(s); /* one thread more, not one a file */
        n.work = malloc(sizeof *n.work);
    }
    if (n.work != NULL) {
        *n.work = now;
        n.work->beside = svo_async_start(hash_source, n.work);
    } else {
        hash_source(&now);
    }
    s->list[s->count++] = n;
    return n.work != NULL ? n.work->beside : NULL;
}

void sources_settle(const sources *s)
{
    for (size_t i = 0; i < s->count; i++)
        if (s->list[i].work != NULL) svo_async_wait(s->list[i].work->beside);
}

void sources_free(sources *s)
{
    for (size_t i = 0; i < s->count; i++) {
        if (s->list[i].work != NULL) svo_async_free(s->list[i].work->beside);
        free(s->list[i].work);
        free(s->list[i].path);
        free(s->list[i].hash);
    }
    free(s->list);
    memset(s, 0, sizeof *s);
}

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the list of files read"); }

svo_result sources_key(const sources *s, const char *what, uint8_t key[16], svo_error *err)
{
    svo_buffer text;
    svo_buffer_init(&text, NULL);
    sources_settle(s);
    bool ok = !s->failed && svo_buffer_append(&text, what, strlen(what) + 1) != NULL;
    for (size_t i = 0; ok && i < s->count; i++) {
        const char *slash = strrchr(s->list[i].path, '/'), *name = slash != NULL ? slash + 1 : s->list[i].path;
        ok = svo_buffer_append(&text, s->list[i].hash, 33) != NULL && svo_buffer_append(&text, name, strlen(name) + 1) != NULL;
    }
    if (ok) {
        XXH128_canonical_t c;
        XXH128_canonicalFromHash(&c, XXH3_128bits(text.data, text.size));
        memcpy(key, c.digest, 16);
    }
    svo_buffer_free(&text);
    return ok ? SVO_OK : no_memory(err);
}

/* A name as Make and Ninja read it: blanks and '#' behind a backslash (backslashes before a blank doubled), '$' doubled. */
static bool append_escaped(svo_buffer *to, const char *name)
{
    for (const char *p = name; *p != 0; p++) {
        const char *put = NULL;
        if (*p == '$') put = "$";
        else if (*p == '#') put = "\\";
        else if (*p == ' ' || *p == '\t') {
            for (const char *q = p; q > name && q[-1] == '\\'; q--)
                if (svo_buffer_append(to, "\\", 1) == NULL) return false;
            put = "\\";
        }
        if (put != NULL && svo_buffer_append(to, put, 1) == NULL) return false;
        if (svo_buffer_append(to, p, 1) == NULL) return false;
    }
    return true;
}

static int by_path(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

static svo_result depfile_text(const sources *s, const char *target, svo_buffer *text, svo_error *err)
{
    char **paths = calloc(s->count + 1, sizeof *paths);
    if (paths == NULL) return no_memory(err);
    bool ok = append_escaped(text, target) && svo_buffer_append(text, ":", 1) != NULL, broken = strchr(target, '\n') != NULL;
    for (size_t i = 0; i < s->count; i++) paths[i] = s->list[i].path;
    qsort(paths, s->count, sizeof *paths, by_path);
    for (size_t i = 0; i < s->count; i++) {
        if (i != 0 && strcmp(paths[i], paths[i - 1]) == 0) continue;
        broken |= strchr(paths[i], '\n') != NULL;
        ok = ok && svo_buffer_append(text, " \\\n  ", 5) != NULL && append_escaped(text, paths[i]);
    }
    ok = ok && svo_buffer_append(text, "\n", 1) != NULL;
    free(paths);
    if (!ok) return no_memory(err);
    return broken ? svo_fail(err, SVO_UNSUPPORTED, "--depfile: a file name with a line break cannot be written down for Make") : SVO_OK;
}

static svo_result spares_sources(const sources *s, const char *path, svo_error *err)
{
    struct stat old, other;
    if (s->failed) return no_memory(err);
    if (stat(path, &old) == 0 && S_ISREG(old.st_mode))
        for (size_t i = 0; i < s->count; i++)
            if (stat(s->list[i].path, &other) == 0 && other.st_dev == old.st_dev && other.st_ino == old.st_ino)
                return svo_fail(err, SVO_INVALID_ARGUMENT, "--depfile %.100s would overwrite a file that was read", path);
    return SVO_OK;
}

svo_result sources_check_depfile(const sources *s, const char *path, bool force, svo_error *err)
{
    fmt_output *out;
    if (path == NULL) return SVO_OK;
    SVO_TRY(spares_sources(s, path, err));
    SVO_TRY(fmt_output_open(path, force, &out, err));
    fmt_output_discard(out);
    return SVO_OK;
}

svo_result sources_depfile(const sources *s, const char *path, const char *target, bool force, svo_error *err)
{
    SVO_TRY(spares_sources(s, path, err));
    svo_buffer text;
    svo_buffer_init(&text, NULL);
    fmt_output *out = NULL;
    svo_result r = depfile_text(s, target, &text, err);
    if (r == SVO_OK) r = fmt_output_open(path, force, &out, err);
    if (r == SVO_OK) r = fmt_output_write(out, text.data, text.size, err);
    if (r == SVO_OK) {
        r = fmt_output_commit(out, err);
        out = NULL;
    }
    fmt_output_discard(out);
    svo_buffer_free(&text);
    return r;
}

int cli_take_depfile(cli *c, bool beside, const char **path)
{
    enum { LONGEST = 4096 };
    static char name[LONGEST + 3];
    if (beside && *path != NULL) return cli_usage(c, "--depfile and -MD exclude each other");
    if (beside) {
        if (strlen(c->output) > LONGEST) return cli_usage(c, "the name of the output is too long");
        *path = strcat(strcpy(name, c->output), ".d");
    }
    if (*path != NULL && strcmp(c->output, "-") == 0) return cli_usage(c, "--depfile needs an output with a name");
    if (*path != NULL && strcmp(c->output, *path) == 0) return cli_usage(c, "-o and --depfile name the same file");
    return -1;
}
