/* The manifest, and the steps that follow from it. */
#define _GNU_SOURCE
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "build.h"
#include "fmt_file.h"

const char *const build_tools[BUILD_KINDS] = {"svo-voxelize", "svo-compress", "svo-pack"};
const char *const build_words[BUILD_KINDS] = {"voxelize", "compress", "pack"};
static const char *const endings[BUILD_KINDS] = {"svo", "svdag", "svscene"};

enum { MANIFEST_BYTES = 1 << 28, STEPS = 1 << 22 };

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the manifest"); }

static char *text(const char *format, ...) SVO_PRINTF(1, 2);
static char *text(const char *format, ...)
{
    char *out;
    va_list args;
    va_start(args, format);
    int n = vasprintf(&out, format, args);
    va_end(args);
    return n < 0 ? NULL : out;
}

/* Keys of an object must be among `known` (NULL-terminated). */
static svo_result check_keys(const json_t *o, const char *where, const char *const *known, svo_error *err)
{
    const char *key;
    json_t *v;
    json_object_foreach((json_t *)(uintptr_t)o, key, v) {
        (void)v;
        bool found = false;
        for (int i = 0; known[i] != NULL && !found; i++) found = strcmp(known[i], key) == 0;
        if (!found) return svo_fail(err, SVO_INVALID_DATA, "%.60s: unknown key \"%.60s\"", where, key);
    }
    return SVO_OK;
}

static svo_result check_name(const char *name, svo_error *err)
{
    bool good = name != NULL && name[0] != 0 && name[0] != '.' && name[0] != '-' && strlen(name) <= 200;
    for (const char *p = name; good && *p != 0; p++) good = *p != '/' && *p != '\\' && (unsigned char)*p >= ' ' && *p != 127;
    return good ? SVO_OK : svo_fail(err, SVO_INVALID_DATA, "\"%.60s\" is no name of an asset: 1 to 200 characters, no / or \\, not . or - first", name != NULL ? name : "");
}

/* "--name=value" of a JSON value; NULL with *err. *none where the value says that it is not given. */
static char *option_text(const char *where, const char *name, const json_t *v, bool *none, svo_error *err)
{
    static const char *const own[] = {"output", "report", "threads", "memory", "force", "depfile", "depfile-beside", "key", "shard", "dry-run", "quiet", "verbose",
                                      "help", "version", "progress", "no-progress", "config", "no-config"};
    *none = json_is_false(v) || json_is_null(v);
    for (size_t i = 0; i < sizeof own / sizeof own[0]; i++)
        if (strcmp(own[i], name) == 0) {
            svo_fail(err, SVO_INVALID_DATA, "%.60s: svo-build sets --%s itself (memory is a key of the asset)", where, name);
            return NULL;
        }
    char *out = NULL;
    if (*none || json_is_true(v)) out = text("--%s", name);
    else if (json_is_integer(v)) out = text("--%s=%lld", name, (long long)json_integer_value(v));
    else if (json_is_real(v)) out = text("--%s=%.17g", name, json_real_value(v));
    else if (json_is_string(v)) out = text("--%s=%s", name, json_string_value(v));
    else {
        svo_fail(err, SVO_INVALID_DATA, "%.60s: --%.60s must be a text, a number, true or false", where, name);
        return NULL;
    }
    if (out == NULL) no_memory(err);
    return out;
}

/* Options of `defaults` overlaid with those of the asset, in the order of their names, so that the order in the manifest does not matter. */
static svo_result set_options(build_step *s, const json_t *defaults, const json_t *own, svo_error *err)
{
    json_t *all = json_is_object(defaults) ? json_copy((json_t *)(uintptr_t)defaults) : json_object();
    if (json_is_object(own)) json_object_update(all, (json_t *)(uintptr_t)own);
    size_t n = json_object_size(all), at = 0;
    const char **names = calloc(n + 1, sizeof *names);
    s->options = calloc(n + 1, sizeof *s->options);
    svo_result r = names != NULL && s->options != NULL ? SVO_OK : no_memory(err);
    const char *key;
    json_t *v;
    if (r == SVO_OK) json_object_foreach(all, key, v) {
        (void)v;
        size_t k = at++;
        for (; k > 0 && strcmp(names[k - 1], key) > 0; k--) names[k] = names[k - 1];
        names[k] = key;
    }
    for (size_t i = 0; i < n && r == SVO_OK; i++) {
        bool none;
        char *o = option_text(s->asset, names[i], json_object_get(all, names[i]), &none, err);
        if (o == NULL) r = err != NULL ? err->code : SVO_INVALID_DATA;
        else if (none) free(o);
        else s->options[s->option_count++] = o;
    }
    free(names);
    json_decref(all);
    return r;
}

static svo_result add_step(build_plan *p, build_kind kind, const char *name, build_step **out, svo_error *err)
{
    if (p->count == STEPS) return svo_fail(err, SVO_LIMIT, "more than %d steps; make several manifests", (int)STEPS);
    if (p->count == p->capacity) {
        uint32_t capacity = p->capacity * 2 + 64;
        build_step *steps = realloc(p->steps, capacity * sizeof *steps);
        if (steps == NULL) return no_memory(err);
        p->steps = steps;
        p->capacity = capacity;
    }
    build_step *s = &p->steps[p->count++];
    memset(s, 0, sizeof *s);
    s->kind = kind;
    s->asset = name;
    s->first_need = -1;
    s->output = text("%s/%s.%s", p->folder, name, endings[kind]);
    s->state_path = text("%s/%s.%s.state", p->work, name, build_words[kind]);
    s->log = text("%s/%s.%s.log", p->work, name, build_words[kind]);
    s->report = text("%s/%s.%s.report.json", p->work, name, build_words[kind]);
    s->depfile = text("%s/%s.%s.d", p->work, name, build_words[kind]);
    *out = s;
    return s->output != NULL && s->state_path != NULL && s->log != NULL && s->report != NULL && s->depfile != NULL ? SVO_OK : no_memory(err);
}

static char *join(const char *base, const char *path) { return path[0] == '/' ? text("%s", path) : text("%s/%s", base, path); }

static svo_result set_inputs(build_step *s, const char *base, const json_t *input, svo_error *err)
{
    size_t n = json_is_array(input) ? json_array_size(input) : 1;
    s->inputs = calloc(n + 1, sizeof *s->inputs);
    if (s->inputs == NULL) return no_memory(err);
    for (size_t i = 0; i < n; i++) {
        const json_t *v = json_is_array(input) ? json_array_get(input, i) : input;
        if (!json_is_string(v) || json_string_length(v) == 0 || strlen(json_string_value(v)) != json_string_length(v))
            return svo_fail(err, SVO_INVALID_DATA, "%.60s: \"input\" is a file name, or a list of them", s->asset);
        s->inputs[s->input_count] = join(base, json_string_value(v));
        if (s->inputs[s->input_count++] == NULL) return no_memory(err);
    }
    return n != 0 ? SVO_OK : svo_fail(err, SVO_INVALID_DATA, "%.60s: no input", s->asset);
}

static svo_result set_memory(build_step *s, const json_t *asset, svo_error *err)
{
    const json_t *v = json_object_get(asset, "memory");
    if (v == NULL) return SVO_OK;
    cli_option o = {.name = "memory", .kind = CLI_SIZE, .value = &s->memory};
    char why[200];
    if (json_is_string(v) && cli_parse_text(&o, json_string_value(v), why)) return SVO_OK;
    return svo_fail(err, SVO_INVALID_DATA, "%.60s: \"memory\" is a size such as \"2G\"", s->asset);
}

static svo_result is_options(const json_t *v, const char *where, const char *key, bool can_be_false, svo_error *err)
{
    if (v == NULL || json_is_object(v) || (can_be_false && json_is_false(v))) return SVO_OK;
    return svo_fail(err, SVO_INVALID_DATA, "%.60s: \"%s\" is an object of options%s", where, key, can_be_false ? ", or false" : "");
}

static svo_result add_asset(build_plan *p, const char *base, const json_t *defaults, const json_t *asset, svo_error *err)
{
    static const char *const keys[] = {"name", "input", "voxelize", "compress", "memory", NULL};
    const char *name = json_string_value(json_object_get(asset, "name"));
    SVO_TRY(check_name(name, err));
    SVO_TRY(check_keys(asset, name, keys, err));
    const json_t *compress = json_object_get(asset, "compress"), *voxelize = json_object_get(asset, "voxelize");
    SVO_TRY(is_options(voxelize, name, "voxelize", false, err));
    SVO_TRY(is_options(compress, name, "compress", true, err));
    if (json_object_get(asset, "input") == NULL) return svo_fail(err, SVO_INVALID_DATA, "%.60s: \"input\" is missing", name);
    build_step *s;
    SVO_TRY(add_step(p, BUILD_VOXELIZE, name, &s, err));
    SVO_TRY(set_inputs(s, base, json_object_get(asset, "input"), err));
    SVO_TRY(set_options(s, json_object_get(defaults, "voxelize"), voxelize, err));
    SVO_TRY(set_memory(s, asset, err));
    if (json_is_false(compress) || (compress == NULL && json_is_false(json_object_get(defaults, "compress")))) return SVO_OK;
    int64_t first = p->count - 1;
    uint64_t memory = s->memory;
    SVO_TRY(add_step(p, BUILD_COMPRESS, name, &s, err));
    s->inputs = calloc(2, sizeof *s->inputs);
    if (s->inputs == NULL || (s->inputs[0] = text("%s", p->steps[first].output)) == NULL) return no_memory(err);
    s->input_count = 1;
    s->first_need = first, s->need_count = 1;
    s->memory = memory;
    return set_options(s, json_object_get(defaults, "compress"), compress, err);
}

/* A scene is packed when all assets of the manifest are there: which of them it names is its own business. */
static svo_result add_scene(build_plan *p, const char *base, uint32_t assets, const json_t *scene, svo_error *err)
{
    static const char *const keys[] = {"name", "file", "pack", "memory", NULL};
    const char *name = json_string_value(json_object_get(scene, "name"));
    SVO_TRY(check_name(name, err));
    SVO_TRY(check_keys(scene, name, keys, err));
    SVO_TRY(is_options(json_object_get(scene, "pack"), name, "pack", false, err));
    if (json_object_get(scene, "file") == NULL) return svo_fail(err, SVO_INVALID_DATA, "%.60s: \"file\" is missing", name);
    build_step *s;
    SVO_TRY(add_step(p, BUILD_PACK, name, &s, err));
    s->first_need = 0, s->need_count = assets;
    SVO_TRY(set_inputs(s, base, json_object_get(scene, "file"), err));
    SVO_TRY(set_memory(s, scene, err));
    return set_options(s, NULL, json_object_get(scene, "pack"), err);
}

static int by_text(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

static svo_result check_outputs(const build_plan *p, svo_error *err)
{
    const char **all = calloc(p->count + 1, sizeof *all);
    if (all == NULL) return no_memory(err);
    for (uint32_t i = 0; i < p->count; i++) all[i] = p->steps[i].output;
    qsort(all, p->count, sizeof *all, by_text);
    svo_result r = SVO_OK;
    for (uint32_t i = 1; i < p->count && r == SVO_OK; i++)
        if (strcmp(all[i], all[i - 1]) == 0) r = svo_fail(err, SVO_INVALID_DATA, "two assets would write %.150s; names must differ", all[i]);
    free(all);
    return r;
}

static svo_result make_steps(build_plan *p, const char *base, svo_error *err)
{
    static const char *const keys[] = {"output", "defaults", "assets", "scenes", NULL}, *const kinds[] = {"voxelize", "compress", NULL};
    const json_t *m = p->manifest, *defaults = json_object_get(m, "defaults"), *list = json_object_get(m, "assets"), *scenes = json_object_get(m, "scenes"), *v;
    size_t i;
    if (!json_is_object(m)) return svo_fail(err, SVO_INVALID_DATA, "a manifest is a JSON object");
    SVO_TRY(check_keys(m, "manifest", keys, err));
    SVO_TRY(is_options(defaults, "manifest", "defaults", false, err));
    if (defaults != NULL) SVO_TRY(check_keys(defaults, "defaults", kinds, err));
    SVO_TRY(is_options(json_object_get(defaults, "voxelize"), "defaults", "voxelize", false, err));
    SVO_TRY(is_options(json_object_get(defaults, "compress"), "defaults", "compress", true, err));
    const json_t *output = json_object_get(m, "output");
    if (output != NULL && (!json_is_string(output) || json_string_length(output) == 0)) return svo_fail(err, SVO_INVALID_DATA, "\"output\" is the name of a folder");
    p->folder = join(base, output != NULL ? json_string_value(output) : ".");
    p->work = p->folder != NULL ? text("%s/.svo-build", p->folder) : NULL;
    if (p->work == NULL) return no_memory(err);
    if (!json_is_array(list)) return svo_fail(err, SVO_INVALID_DATA, "\"assets\" is a list");
    json_array_foreach(list, i, v) {
        if (!json_is_object(v)) return svo_fail(err, SVO_INVALID_DATA, "asset %zu is no object", i);
        SVO_TRY(add_asset(p, base, defaults, v, err));
    }
    if (scenes != NULL && !json_is_array(scenes)) return svo_fail(err, SVO_INVALID_DATA, "\"scenes\" is a list");
    uint32_t assets = p->count;
    json_array_foreach(scenes, i, v) {
        if (!json_is_object(v)) return svo_fail(err, SVO_INVALID_DATA, "scene %zu is no object", i);
        SVO_TRY(add_scene(p, base, assets, v, err));
    }
    return check_outputs(p, err);
}

svo_result build_plan_read(const char *path, build_plan *out, svo_error *err)
{
    fmt_bytes b;
    json_error_t where;
    memset(out, 0, sizeof *out);
    SVO_TRY(fmt_bytes_open(path, MANIFEST_BYTES, NULL, &b, err));
    if (b.size == 0) { /* which the parser calls wrong arguments */
        fmt_bytes_close(&b);
        return svo_fail(err, SVO_INVALID_DATA, "the file is empty");
    }
    const uint64_t mark = b.size >= 3 && memcmp(b.data, "\xef\xbb\xbf", 3) == 0 ? 3 : 0; /* which some editors put before UTF-8 */
    out->manifest = json_loadb((const char *)b.data + mark, b.size - mark, JSON_REJECT_DUPLICATES, &where);
    fmt_bytes_close(&b);
    if (out->manifest == NULL) return svo_fail(err, SVO_INVALID_DATA, "line %d, column %d: %.120s", where.line, where.column, where.text);
    const char *slash = strrchr(path, '/');
    char *base = slash == NULL ? text(".") : slash == path ? text("/") : text("%.*s", (int)(slash - path), path);
    svo_result r = base != NULL ? make_steps(out, base, err) : no_memory(err);
    free(base);
    if (r != SVO_OK) build_plan_free(out);
    return r;
}

static void free_list(char **list, uint32_t count)
{
    for (uint32_t i = 0; list != NULL && i < count; i++) free(list[i]);
    free(list);
}

void build_plan_free(build_plan *p)
{
    for (uint32_t i = 0; i < p->count; i++) {
        build_step *s = &p->steps[i];
        free_list(s->inputs, s->input_count);
        free_list(s->options, s->option_count);
        char *const all[] = {s->output, s->state_path, s->log, s->report, s->depfile};
        for (size_t k = 0; k < sizeof all / sizeof all[0]; k++) free(all[k]);
    }
    free(p->steps);
    free(p->folder);
    free(p->work);
    json_decref(p->manifest);
    memset(p, 0, sizeof *p);
}

char **build_arguments(const build_step *s, const char *tool_path, uint64_t threads, uint64_t memory, bool bookkeeping)
{
    char **a = calloc(s->input_count + s->option_count + 16u, sizeof *a);
    uint32_t n = 0;
    if (a == NULL) return NULL;
    a[n++] = text("%s", tool_path);
    for (uint32_t i = 0; i < s->option_count; i++) a[n++] = text("%s", s->options[i]);
    a[n++] = text("--output=%s", s->output);
    a[n++] = text("--force");
    a[n++] = text("--quiet");
    a[n++] = text("--no-config"); /* the manifest alone says what is made */
    if (s->kind != BUILD_COMPRESS) a[n++] = text("--depfile=%s", s->depfile);
    if (bookkeeping) a[n++] = text("--report=%s", s->report);
    if (threads != 0) a[n++] = text("--threads=%llu", (unsigned long long)threads);
    if (memory != 0) a[n++] = text("--memory=%llu", (unsigned long long)memory);
    a[n++] = text("--");
    for (uint32_t i = 0; i < s->input_count; i++) a[n++] = text("%s", s->inputs[i]);
    for (uint32_t i = 0; i < n; i++) {
        if (a[i] != NULL) continue;
        for (uint32_t k = 0; k < n; k++) free(a[k]);
        free(a);
        return NULL;
    }
    return a;
}

void build_arguments_free(char **a)
{
    for (char **p = a; p != NULL && *p != NULL; p++) free(*p);
    free(a);
}
