/* What a step made, and of what: the state file beside the outputs. */
#define _GNU_SOURCE
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "build.h"
#include "fmt_file.h"

enum { STATE_VERSION = 2, STATE_BYTES = 1 << 26 };

static bool file_stamp(const char *path, uint64_t *size, int64_t time[2])
{
    struct stat st;
    if (stat(path, &st) != 0 || !S_ISREG(st.st_mode)) return false;
    *size = (uint64_t)st.st_size;
    time[0] = st.st_mtim.tv_sec;
    time[1] = st.st_mtim.tv_nsec;
    return true;
}

static bool file_hash(const char *path, char hex[33])
{
    fmt_bytes b;
    if (fmt_bytes_open(path, 0, NULL, &b, NULL) != SVO_OK) return false;
    fmt_hash_file(b.data, b.size, b.mapped, hex);
    fmt_bytes_close(&b);
    return true;
}

/* {"path", "size", "seconds", "nanoseconds", "hash"}; NULL when the file cannot be read. */
static json_t *describe(const char *path)
{
    uint64_t size, again;
    int64_t time[2], after[2];
    char hex[33];
    if (!file_stamp(path, &size, time) || !file_hash(path, hex) || !file_stamp(path, &again, after)) return NULL;
    if (size != again || memcmp(time, after, sizeof time) != 0) return NULL; /* it is being written */
    json_t *o = json_object();
    cli_put_text(o, "path", path);
    cli_put_u64(o, "size", size);
    json_object_set_new(o, "seconds", json_integer(time[0]));
    json_object_set_new(o, "nanoseconds", json_integer(time[1]));
    cli_put_text(o, "hash", hex);
    return o;
}

/* Is the file what was noted? *touched: only its time is another one. */
static bool same_file(const json_t *note, bool *touched)
{
    const char *path = json_string_value(json_object_get(note, "path")), *hash = json_string_value(json_object_get(note, "hash"));
    uint64_t size;
    int64_t time[2];
    char hex[33];
    if (path == NULL || hash == NULL || !file_stamp(path, &size, time)) return false;
    if (size != (uint64_t)json_integer_value(json_object_get(note, "size"))) return false;
    if (time[0] == json_integer_value(json_object_get(note, "seconds")) && time[1] == json_integer_value(json_object_get(note, "nanoseconds"))) return true;
    *touched = true;
    return file_hash(path, hex) && strcmp(hex, hash) == 0;
}

/* What is asked for, in one text. */
static char *wish(const build_step *s)
{
    json_t *o = json_object(), *inputs = json_array(), *options = json_array();
    for (uint32_t i = 0; i < s->input_count; i++) json_array_append_new(inputs, cli_text(s->inputs[i]));
    for (uint32_t i = 0; i < s->option_count; i++) json_array_append_new(options, cli_text(s->options[i]));
    cli_put_text(o, "tool", build_tools[s->kind]);
    cli_put_text(o, "version", SVO_VERSION_STRING);
    cli_put_text(o, "output", s->output);
    json_object_set_new(o, "inputs", inputs);
    json_object_set_new(o, "options", options);
    char *text = json_dumps(o, JSON_COMPACT | JSON_SORT_KEYS);
    json_decref(o);
    return text;
}

/* Of the wish without the output's place, and of the content of the files read. */
static void set_key(build_step *s, const json_t *files)
{
    json_t *o = json_object(), *options = json_array(), *hashes = json_array(), *f;
    size_t i;
    for (uint32_t k = 0; k < s->option_count; k++) json_array_append_new(options, cli_text(s->options[k]));
    json_array_foreach(files, i, f) {
        const char *path = json_string_value(json_object_get(f, "path")), *slash = path != NULL ? strrchr(path, '/') : NULL;
        json_array_append_new(hashes, json_pack("[s,O]", slash != NULL ? slash + 1 : path != NULL ? path : "", json_object_get(f, "hash")));
    }
    cli_put_text(o, "tool", build_tools[s->kind]);
    cli_put_text(o, "version", SVO_VERSION_STRING);
    json_object_set_new(o, "options", options);
    json_object_set_new(o, "files", hashes);
    char *text = json_dumps(o, JSON_COMPACT | JSON_SORT_KEYS);
    json_decref(o);
    if (text != NULL) fmt_hash_hex(text, strlen(text), s->key);
    free(text);
}

static svo_result write_state(const build_step *s, const json_t *state, svo_error *err)
{
    char *text = json_dumps(state, JSON_INDENT(1) | JSON_SORT_KEYS);
    if (text == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a state file");
    fmt_output *out;
    svo_result r = fmt_output_open(s->state_path, true, &out, err);
    if (r == SVO_OK) {
        r = fmt_output_write(out, text, strlen(text), err);
        if (r == SVO_OK) r = fmt_output_commit(out, err);
        else fmt_output_discard(out);
    }
    free(text);
    return r;
}

/* Note the new times of files whose content is the same. */
static void refresh(build_step *s, json_t *state)
{
    json_t *files = json_object_get(state, "files"), *f;
    size_t i;
    json_array_foreach(files, i, f) {
        json_t *now = describe(json_string_value(json_object_get(f, "path")));
        if (now == NULL) return;
        json_array_set_new(files, i, now);
    }
    json_t *output = describe(s->output);
    if (output == NULL) return;
    json_object_set_new(state, "made", output);
    write_state(s, state, NULL); /* it only saves time later: failure is no harm */
}

bool build_step_current(build_step *s)
{
    fmt_bytes b;
    if (fmt_bytes_open(s->state_path, STATE_BYTES, NULL, &b, NULL) != SVO_OK) return false;
    json_t *state = json_loadb((const char *)b.data, b.size, 0, NULL), *f;
    fmt_bytes_close(&b);
    if (state == NULL) return false;
    char *wanted = wish(s);
    const char *had = json_string_value(json_object_get(state, "wish"));
    json_t *files = json_object_get(state, "files"), *made = json_object_get(state, "made");
    bool touched = false;
    bool current = wanted != NULL && had != NULL && strcmp(wanted, had) == 0 && json_integer_value(json_object_get(state, "state")) == STATE_VERSION &&
                   json_array_size(files) != 0 && json_is_object(made) && same_file(made, &touched);
    size_t i;
    json_array_foreach(files, i, f) current = current && same_file(f, &touched);
    if (current) set_key(s, files);
    if (current && touched) refresh(s, state);
    free(wanted);
    json_decref(state);
    return current;
}

/* Append what a depfile names behind its colon: words in Make's way ("\ " and "$$"). */
static void read_depfile(const char *path, json_t *paths)
{
    fmt_bytes b;
    if (fmt_bytes_open(path, STATE_BYTES, NULL, &b, NULL) != SVO_OK) return;
    char *word = malloc(b.size + 1);
    size_t n = 0;
    bool behind = false;
    for (uint64_t i = 0; word != NULL && i <= b.size; i++) {
        char c = i < b.size ? (char)b.data[i] : '\n', next = i + 1 < b.size ? (char)b.data[i + 1] : 0;
        if (c == '\\' && next == '\n') {
            i++;
            c = ' ';
        } else if ((c == '\\' && (next == ' ' || next == '\t' || next == '#')) || (c == '$' && next == '$')) {
            word[n++] = next;
            i++;
            continue;
        }
        if (c != ' ' && c != '\t' && c != '\n' && c != '\r') {
            word[n++] = c;
            continue;
        }
        if (n == 0) continue;
        word[n] = 0;
        if (behind) json_array_append_new(paths, json_string(word));
        else if (word[n - 1] == ':') behind = true;
        n = 0;
    }
    free(word);
    fmt_bytes_close(&b);
}

svo_result build_step_note(build_step *s, svo_error *err)
{
    json_t *paths = json_array(), *files = json_array(), *state = json_object(), *p;
    svo_result r = SVO_OK;
    size_t i;
    read_depfile(s->depfile, paths);
    if (json_array_size(paths) == 0)
        for (uint32_t k = 0; k < s->input_count; k++) json_array_append_new(paths, json_string(s->inputs[k]));
    json_array_foreach(paths, i, p) {
        json_t *f = json_is_string(p) ? describe(json_string_value(p)) : NULL;
        if (f == NULL) r = svo_fail(err, SVO_IO, "%.150s cannot be read, or changes while it is read", json_is_string(p) ? json_string_value(p) : "a file that is not named in UTF-8");
        else json_array_append_new(files, f);
        if (r != SVO_OK) break;
    }
    json_t *made = r == SVO_OK ? describe(s->output) : NULL;
    if (r == SVO_OK && made == NULL) r = svo_fail(err, SVO_IO, "%.150s cannot be read, or changes while it is read", s->output);
    if (r == SVO_OK) {
        char *text = wish(s);
        set_key(s, files);
        cli_put_u64(state, "state", STATE_VERSION);
        cli_put_text(state, "wish", text != NULL ? text : "");
        cli_put_text(state, "key", s->key);
        json_object_set(state, "files", files);
        json_object_set_new(state, "made", made);
        free(text);
        r = write_state(s, state, err);
    }
    json_decref(paths);
    json_decref(files);
    json_decref(state);
    return r;
}
