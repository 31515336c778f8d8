/* The JSON report and the provenance text. */
#define _GNU_SOURCE
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include "cli_internal.h"
#include "fmt_file.h"
#include "fmt_utf8.h"

json_t *cli_text(const char *value)
{
    json_t *direct = json_string(value);
    if (direct != NULL) return direct;
    size_t length = strlen(value), at = 0;
    char *copy = malloc(3 * length + 1);
    if (copy == NULL) return NULL;
    for (size_t i = 0; i < length;) {
        size_t n = fmt_utf8_character(value + i, length - i);
        if (n > 0) memcpy(copy + at, value + i, n), at += n, i += n;
        else memcpy(copy + at, "\xef\xbf\xbd", 3), at += 3, i++; /* U+FFFD */
    }
    json_t *text = json_stringn(copy, at);
    free(copy);
    return text;
}

void cli_put_u64(json_t *object, const char *key, uint64_t value)
{
    json_object_set_new(object, key, value <= INT64_MAX ? json_integer((json_int_t)value) : json_real((double)value));
}

void cli_put_f64(json_t *object, const char *key, double value)
{
    json_object_set_new(object, key, isfinite(value) ? json_real(value) : json_null());
}

void cli_put_text(json_t *object, const char *key, const char *value)
{
    json_object_set_new(object, key, value != NULL ? cli_text(value) : json_null());
}

void cli_put_saving(json_t *list, const char *what, const char *channel, uint64_t values, uint64_t bytes)
{
    if (values == 0) return;
    json_t *o = json_object();
    cli_put_text(o, "what", what);
    cli_put_text(o, "channel", channel);
    cli_put_u64(o, "values", values);
    cli_put_u64(o, "bytes_saved", bytes);
    json_array_append_new(list, o);
}

json_t *cli_section(cli *c, const char *name)
{
    json_t *section = json_object_get(c->json, name);
    if (section == NULL) {
        json_object_set_new(c->json, name, json_object());
        section = json_object_get(c->json, name);
    }
    return section;
}

void cli_phase(cli *c, const char *name)
{
    double now = svo_seconds();
    if (c->phase != NULL) {
        json_t *phases = json_object_get(c->json, "phases"), *entry = NULL;
        for (size_t i = 0; i < json_array_size(phases) && entry == NULL; i++) {
            json_t *e = json_array_get(phases, i);
            const char *earlier = json_string_value(json_object_get(e, "name"));
            if (earlier != NULL && strcmp(earlier, c->phase) == 0) entry = e;
        }
        double before = 0;
        if (entry == NULL) {
            entry = json_object();
            cli_put_text(entry, "name", c->phase);
            json_array_append_new(phases, entry);
        } else {
            before = json_real_value(json_object_get(entry, "seconds"));
        }
        cli_put_f64(entry, "seconds", before + now - c->phase_started);
    }
    c->phase = name;
    c->phase_started = now;
}

static json_t *option_value(const cli_option *o)
{
    bool given = o->seen != NULL && *o->seen;
    if (o->no_default && o->seen != NULL && !given) return json_null();
    switch (o->kind) {
    case CLI_FLAG: return json_boolean(*(const bool *)o->value);
    case CLI_TEXT: return *(const char **)o->value != NULL ? cli_text(*(const char **)o->value) : json_null();
    case CLI_U64:
    case CLI_SIZE: return json_integer((json_int_t)*(const uint64_t *)o->value);
    case CLI_DOUBLE: return isfinite(*(const double *)o->value) ? json_real(*(const double *)o->value) : json_null();
    case CLI_CHOICE: return cli_text(o->choices[*(const int *)o->value]);
    case CLI_VEC3: {
        const double *v = (const double *)o->value;
        return json_pack("[f,f,f]", v[0], v[1], v[2]);
    }
    }
    return json_null();
}

json_t *cli_options_json(const cli *c, bool common)
{
    json_t *out = json_object();
    if (common) {
        bool help, version;
        cli_option table[CLI_MAX_COMMON];
        size_t count = cli_common_options((cli *)(uintptr_t)c, &help, &version, table);
        for (size_t i = 0; i < count; i++)
            if (table[i].value != &help && table[i].value != &version && table[i].value != &c->verbose) /* a count, not a flag */
                json_object_set_new(out, table[i].name, option_value(&table[i]));
        json_object_set_new(out, "verbose", json_integer(c->verbose));
    } else {
        for (size_t i = 0; i < c->tool->option_count; i++)
            json_object_set_new(out, c->tool->options[i].name, option_value(&c->tool->options[i]));
    }
    return out;
}

void cli_report_options(cli *c)
{
    json_t *options = cli_options_json(c, false), *common = cli_options_json(c, true);
    json_object_update_missing(options, common);
    json_decref(common);
    json_object_set_new(c->json, "options", options);
    json_t *inputs = json_array();
    for (int i = 0; i < c->input_count; i++) json_array_append_new(inputs, cli_text(c->inputs[i]));
    json_object_set_new(c->json, "inputs", inputs);
}

/* High-water mark of resident memory. /proc speaks of this program alone; getrusage would also count what the parent
 * held between fork and exec. */
static uint64_t peak_rss(void)
{
    FILE *f = fopen("/proc/self/status", "re");
    if (f != NULL) {
        char line[256];
        unsigned long long kib = 0;
        bool found = false;
        while (!found && fgets(line, sizeof line, f) != NULL) found = sscanf(line, "VmHWM: %llu kB", &kib) == 1;
        fclose(f);
        if (found) return kib * 1024;
    }
    struct rusage usage;
    return getrusage(RUSAGE_SELF, &usage) == 0 ? (uint64_t)usage.ru_maxrss * 1024 : 0;
}

/* Is the file at path a report of ours (or empty)? Then it may be replaced without --force, so that a pipeline can run
 * again; anything else there is somebody's data. */
static bool replaceable(const char *path)
{
    struct stat s;
    if (stat(path, &s) != 0) return true; /* nothing there */
    if (!S_ISREG(s.st_mode)) return false;
    if (s.st_size == 0) return true;
    if (s.st_size > 64 << 20) return false;
    json_t *old = json_load_file(path, JSON_REJECT_DUPLICATES, NULL);
    const char *tool = json_string_value(json_object_get(old, "tool"));
    bool ours = tool != NULL && strncmp(tool, "svo-", 4) == 0 && json_object_get(old, "wall_seconds") != NULL;
    json_decref(old);
    return ours;
}

bool cli_report_open(cli *c, svo_error *err)
{
    if (c->report == NULL || strcmp(c->report, "-") == 0) return true;
    return fmt_output_open(c->report, c->force || replaceable(c->report), &c->report_file, err) == SVO_OK;
}

void cli_warning_text(const svo_warnings *w, uint32_t i, char *out, size_t size)
{
    unsigned long long times = w->line[i].times;
    if (times > 1) snprintf(out, size, "%s (%llu times)", w->line[i].text, times);
    else snprintf(out, size, "%s", w->line[i].text);
}

static json_t *warnings_json(const svo_warnings *w)
{
    json_t *list = json_array();
    char text[320];
    for (uint32_t i = 0; i < w->count; i++) {
        cli_warning_text(w, i, text, sizeof text);
        json_array_append_new(list, cli_text(text));
    }
    if (w->suppressed > 0) {
        snprintf(text, sizeof text, "%llu more warnings were not recorded", (unsigned long long)w->suppressed);
        json_array_append_new(list, cli_text(text));
    }
    return list;
}

bool cli_report_write(cli *c, int exit_code, const char *failure, const char *failure_name, svo_error *err)
{
    if (c->report == NULL) return true;
    cli_phase(c, NULL);
    cli_put_f64(c->json, "wall_seconds", svo_seconds() - c->started);
    cli_put_u64(c->json, "peak_rss_bytes", peak_rss());
    cli_put_u64(c->json, "exit_code", (uint64_t)exit_code);
    json_object_set_new(c->json, "warnings", warnings_json(&c->warnings));
    if (failure != NULL) {
        cli_put_text(c->json, "error", failure);
        cli_put_text(c->json, "error_code", failure_name);
    }
    char *text = json_dumps(c->json, JSON_SORT_KEYS | JSON_INDENT(2) | JSON_REAL_PRECISION(17));
    if (text == NULL) {
        svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the report");
        return false;
    }
    svo_result result = SVO_OK;
    if (c->report_file == NULL) {
        if (fputs(text, stdout) < 0 || fputc('\n', stdout) < 0)
            result = svo_fail(err, SVO_IO, "the report could not be written to stdout: %s", strerror(errno));
    } else {
        result = fmt_output_write(c->report_file, text, strlen(text), err);
        if (result == SVO_OK) result = fmt_output_write(c->report_file, "\n", 1, err);
        if (result == SVO_OK) result = fmt_output_commit(c->report_file, err);
        else fmt_output_discard(c->report_file);
        c->report_file = NULL;
    }
    free(text);
    return result == SVO_OK;
}

json_t *cli_provenance_input(const char *path, const char *hash)
{
    const char *slash = strrchr(path, '/');
    json_t *entry = json_object();
    cli_put_text(entry, "name", slash != NULL ? slash + 1 : path);
    if (hash != NULL) cli_put_text(entry, "hash", hash);
    return entry;
}

char *cli_provenance(const cli *c, json_t *options, json_t *inputs) { return cli_provenance_with(c, options, inputs, NULL); }

char *cli_provenance_with(const cli *c, json_t *options, json_t *inputs, json_t *left_out)
{
    json_t *out = json_object();
    cli_put_text(out, "tool", c->tool->name);
    cli_put_text(out, "version", SVO_VERSION_STRING);
    json_object_set_new(out, "options", options != NULL ? options : json_object());
    json_object_set_new(out, "inputs", inputs != NULL ? inputs : json_array());
    if (left_out != NULL) json_object_set_new(out, "left_out", left_out);
    char *text = json_dumps(out, JSON_SORT_KEYS | JSON_COMPACT | JSON_REAL_PRECISION(17));
    json_decref(out);
    return text;
}
