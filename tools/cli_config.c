/* Options by file and by environment: docs/tools/common.md, "Settings". What comes later wins: the file's lines for all tools, its lines for this tool,
 * SVOKIT_OPTION, SVO_TOOL_OPTION; the command line is parsed after all of them. */
#include <ctype.h>
#include <stdlib.h>
#include <string.h>

#include "cli_internal.h"
#include "fmt_file.h"

extern char **environ;

enum { CONFIG_BYTES = 1 << 20, NAME_BYTES = 64 };

/* Sections a file may have; that of another tool is not looked into. */
static const char *const tool_names[] = {"svo-bench", "svo-build", "svo-compare", "svo-compress", "svo-dump", "svo-merge", "svo-pack", "svo-render", "svo-skeleton", "svo-voxelize"};

typedef struct settings {
    cli *c;
    const cli_option *common;
    size_t common_count;
    char *problem;
} settings;

static bool wrong(settings *s, const char *where, const char *key, const char *why)
{
    snprintf(s->problem, CLI_PROBLEM, "%.250s: %.100s%s%.220s", where, key, key[0] != 0 ? ": " : "", why);
    return false;
}

static const cli_option *find(const cli_option *table, size_t count, const char *name)
{
    for (size_t i = 0; i < count; i++)
        if (strcmp(table[i].name, name) == 0) return &table[i];
    return NULL;
}

/* What one run is about is said on its command line. */
static bool is_setting(const char *name)
{
    static const char *const own[] = {"output", "force", "report", "help", "version", "config", "no-config"};
    for (size_t i = 0; i < sizeof own / sizeof own[0]; i++)
        if (strcmp(own[i], name) == 0) return false;
    return true;
}

static bool take(settings *s, const cli_option *o, const char *value, const char *where)
{
    char why[200] = "is not true or false", text[460];
    bool yes = strcmp(value, "true") == 0, good;
    if (!is_setting(o->name)) return wrong(s, where, o->name, "is for the command line alone");
    if (o->value == &s->c->verbose) {
        uint64_t count = 0;
        cli_option number = {.name = "verbose", .kind = CLI_U64, .value = &count, .max = 9};
        good = cli_parse_value(&number, value, why);
        if (good) s->c->verbose = (int)count;
    } else if (o->kind == CLI_FLAG) {
        good = yes || strcmp(value, "false") == 0;
        if (good) *(bool *)o->value = yes;
    } else {
        good = cli_parse_value(o, value, why);
    }
    if (!good) {
        snprintf(text, sizeof text, "'%.200s' %s", value, why);
        return wrong(s, where, o->name, text);
    }
    if (o->seen != NULL) *o->seen = o->kind != CLI_FLAG || yes;
    json_t *list = json_object_get(s->c->json, "settings");
    if (list == NULL) json_object_set_new(s->c->json, "settings", list = json_array());
    json_t *note = json_object();
    cli_put_text(note, "option", o->name);
    cli_put_text(note, "value", value);
    cli_put_text(note, "from", where);
    json_array_append_new(list, note);
    return true;
}

/* --- the file --- */

static char *trim(char *text)
{
    size_t n;
    while (isspace((unsigned char)*text)) text++;
    for (n = strlen(text); n > 0 && isspace((unsigned char)text[n - 1]); n--) text[n - 1] = 0;
    return text;
}

static bool known_section(const char *name)
{
    for (size_t i = 0; i < sizeof tool_names / sizeof tool_names[0]; i++)
        if (strcmp(tool_names[i], name) == 0) return true;
    return false;
}

/* One line; `section` is that of the lines before it, "" for all tools. pass 0 takes what all tools share, pass 1 what is this tool's. */
static bool take_line(settings *s, char *line, const char *where, char *section, int pass)
{
    const cli_tool *tool = s->c->tool;
    line = trim(line);
    if (line[0] == 0 || line[0] == '#' || line[0] == ';') return true;
    size_t n = strlen(line);
    if (line[0] == '[') {
        bool closed = line[n - 1] == ']';
        if (closed) line[n - 1] = 0;
        const char *name = trim(line + 1);
        if (!closed || !known_section(name)) return wrong(s, where, "", "a section is the name of a tool: [svo-voxelize]");
        strcpy(section, name);
        return true;
    }
    char *equals = strchr(line, '=');
    if (equals == NULL) return wrong(s, where, "", "a line is OPTION = VALUE, [svo-NAME] or a comment");
    *equals = 0;
    const char *key = trim(line), *value = trim(equals + 1);
    bool all = section[0] == 0, mine = strcmp(section, tool->name) == 0;
    if (!all && !mine) return true;
    const cli_option *o = find(s->common, s->common_count, key);
    if (o == NULL && mine) o = find(tool->options, tool->option_count, key);
    if (o == NULL)
        return all && is_setting(key) ? wrong(s, where, key, "no option of all tools; those of one tool stand below a line [svo-NAME]") : wrong(s, where, key, is_setting(key) ? "unknown option" : "is for the command line alone");
    return pass != (mine ? 1 : 0) || take(s, o, value, where);
}

static bool take_file(settings *s, const char *path, bool must_be_there, svo_error *err)
{
    fmt_bytes b;
    svo_result r = fmt_bytes_open(path, CONFIG_BYTES, NULL, &b, err);
    if (r == SVO_IO && !must_be_there) {
        *err = (svo_error){0};
        return true;
    }
    if (r != SVO_OK) return false;
    if (b.size > CONFIG_BYTES) {
        fmt_bytes_close(&b);
        return svo_fail(err, SVO_LIMIT, "%.150s: a file of settings has at most %d bytes", path, (int)CONFIG_BYTES) == SVO_OK;
    }
    char *text = malloc(2 * (size_t)b.size + 2); /* values point into it: one copy a pass */
    s->c->settings = text;
    if (text == NULL) svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %.150s", path);
    bool good = text != NULL && (b.size == 0 || memchr(b.data, 0, b.size) == NULL || wrong(s, path, "", "holds a NUL byte"));
    for (int pass = 0; good && pass < 2; pass++) {
        char section[NAME_BYTES] = "", where[300], *line = text + (size_t)pass * (b.size + 1);
        if (b.size != 0) memcpy(line, b.data, b.size);
        line[b.size] = 0;
        for (unsigned number = 1; good && line != NULL; number++) {
            char *end = strchr(line, '\n');
            if (end != NULL) *end++ = 0;
            snprintf(where, sizeof where, "%.250s:%u", path, number);
            good = take_line(s, line, where, section, pass);
            line = end;
        }
    }
    fmt_bytes_close(&b);
    return good;
}

/* --- the environment --- */

/* SVO_VOXELIZE_TEMP_SIZE of "svo-voxelize" and "temp-size". */
static void variable_name(const char *prefix, const char *option, char out[2 * NAME_BYTES])
{
    snprintf(out, 2 * NAME_BYTES, "%.60s_%.60s", prefix, option);
    for (char *p = out; *p != 0; p++) *p = *p == '-' ? '_' : (char)toupper((unsigned char)*p);
}

static bool take_variables(settings *s, const char *prefix, const cli_option *table, size_t count)
{
    char name[2 * NAME_BYTES], where[2 * NAME_BYTES + 20];
    for (size_t i = 0; i < count; i++) {
        variable_name(prefix, table[i].name, name);
        const char *value = is_setting(table[i].name) ? getenv(name) : NULL;
        snprintf(where, sizeof where, "environment, %s", name);
        if (value != NULL && !take(s, &table[i], value, where)) return false;
    }
    return true;
}

/* Variables of this tool that are no option of it. Those of SVOKIT_ are not looked through: others, tests for one, have some too. */
static bool check_variables(settings *s)
{
    char prefix[2 * NAME_BYTES], name[2 * NAME_BYTES];
    variable_name(s->c->tool->name, "", prefix);
    size_t n = strlen(prefix);
    const cli_option *const tables[2] = {s->c->tool->options, s->common};
    const size_t counts[2] = {s->c->tool->option_count, s->common_count};
    for (char **e = environ; *e != NULL; e++) {
        if (strncmp(*e, prefix, n) != 0) continue;
        bool known = false;
        for (int t = 0; t < 2 && !known; t++)
            for (size_t i = 0; i < counts[t] && !known; i++) {
                variable_name(s->c->tool->name, tables[t][i].name, name);
                size_t length = strlen(name);
                known = is_setting(tables[t][i].name) && strncmp(*e, name, length) == 0 && (*e)[length] == '=';
            }
        const char *equals = strchr(*e, '=');
        char shown[NAME_BYTES];
        snprintf(shown, sizeof shown, "%.*s", equals != NULL && equals - *e < NAME_BYTES ? (int)(equals - *e) : NAME_BYTES - 1, *e);
        if (!known) return wrong(s, "environment", shown, "there is no such option, or it is for the command line alone");
    }
    return true;
}

/* --- together --- */

/* Before the command line is parsed: what it says of the settings themselves. */
static const char *named_file(int argc, char **argv, bool *none)
{
    const char *file = NULL;
    for (int i = 1; i < argc && strcmp(argv[i], "--") != 0; i++) {
        if (strcmp(argv[i], "--no-config") == 0) *none = true;
        if (strncmp(argv[i], "--config=", 9) == 0) file = argv[i] + 9;
        else if (strcmp(argv[i], "--config") == 0 && i + 1 < argc) file = argv[++i];
    }
    return file;
}

bool cli_settings(cli *c, const cli_option *common, size_t common_count, int argc, char **argv, char problem[CLI_PROBLEM], svo_error *err)
{
    settings s = {c, common, common_count, problem};
    bool none = false;
    const char *file = named_file(argc, argv, &none), *home = getenv("XDG_CONFIG_HOME"), *folder = "";
    char path[4096];
    if (none) return true;
    bool named = true;
    if (file == NULL) file = getenv("SVOKIT_CONFIG"); /* empty: no file */
    if (file == NULL) {
        named = false;
        if (home == NULL || home[0] != '/') home = getenv("HOME"), folder = "/.config";
        if (home != NULL && home[0] == '/' && (size_t)snprintf(path, sizeof path, "%s%s/svokit.conf", home, folder) < sizeof path) file = path;
    }
    if (file != NULL && file[0] != 0 && !take_file(&s, file, named, err)) return false;
    return take_variables(&s, "svokit", common, common_count) && take_variables(&s, c->tool->name, common, common_count) &&
           take_variables(&s, c->tool->name, c->tool->options, c->tool->option_count) && check_variables(&s);
}
