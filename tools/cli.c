#define _GNU_SOURCE
#include "cli.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cli_internal.h"
#include "fmt_file.h"
#include "fmt_utf8.h"

size_t cli_common_options(cli *c, bool *help, bool *version, cli_option out[CLI_MAX_COMMON])
{
    size_t n = 0;
    if (c->tool->has_output)
        out[n++] = (cli_option){.name = "output", .letter = 'o', .kind = CLI_TEXT, .value = &c->output, .argument = "OUT",
                                .help = "File to write; - is stdout.", .no_default = true};
    out[n++] = (cli_option){.name = "force", .letter = 'f', .kind = CLI_FLAG, .value = &c->force,
                            .help = "Replace files that exist."};
    out[n++] = (cli_option){.name = "threads", .kind = CLI_U64, .value = &c->threads, .argument = "N", .max = 1024,
                            .help = "Threads to use, 0 = one for each processor; results do not depend on it."};
    out[n++] = (cli_option){.name = "memory", .kind = CLI_SIZE, .value = &c->memory, .argument = "SIZE",
                            .help = "Keep memory below this, with K, M, G or T for powers of 1024; 0 = no limit."};
    out[n++] = (cli_option){.name = "report", .kind = CLI_TEXT, .value = &c->report, .argument = "R.json", .no_default = true,
                            .help = "Write a JSON report (also on failure); - is stdout."};
    out[n++] = (cli_option){.name = "quiet", .letter = 'q', .kind = CLI_FLAG, .value = &c->quiet, .help = "Print errors only."};
    out[n++] = (cli_option){.name = "verbose", .letter = 'v', .kind = CLI_FLAG, .value = &c->verbose,
                            .help = "Say more; may be repeated."};
    out[n++] = (cli_option){.name = "progress", .kind = CLI_FLAG, .value = &c->progress,
                            .help = "Say how far long work is also where stderr is no terminal: a line a second."};
    out[n++] = (cli_option){.name = "no-progress", .kind = CLI_FLAG, .value = &c->no_progress,
                            .help = "No progress line at a terminal."};
    out[n++] = (cli_option){.name = "config", .kind = CLI_TEXT, .value = &c->config, .argument = "FILE", .no_default = true,
                            .help = "Take options from this file, not from that of SVOKIT_CONFIG or ~/.config/svokit.conf."};
    out[n++] = (cli_option){.name = "no-config", .kind = CLI_FLAG, .value = &c->no_config, .help = "No options from a file or the environment: the command line alone."};
    out[n++] = (cli_option){.name = "help", .letter = 'h', .kind = CLI_FLAG, .value = help, .help = "Print this help; --help=man prints it as a manual page, --help=bash the completion of bash."};
    out[n++] = (cli_option){.name = "version", .kind = CLI_FLAG, .value = version, .help = "Print the version."};
    for (size_t i = 0; i < n; i++) out[i].group = "Common options";
    return n;
}

/* --- messages --- */

/* Characters that a terminal obeys instead of showing: controls, ends of lines (U+2028, U+2029), and marks that turn the direction of what follows (U+061C, U+200E, U+200F, U+202A to
 * U+202E, U+2066 to U+2069), by which a name can look like another. */
static bool unshown(const char *text, size_t n)
{
    const unsigned char *c = (const unsigned char *)text;
    if (n == 1) return c[0] < 0x20 || c[0] == 0x7f;
    if (n == 2) return (c[0] == 0xc2 && c[1] < 0xa0) || (c[0] == 0xd8 && c[1] == 0x9c);
    if (n != 3 || c[0] != 0xe2) return false;
    return c[1] == 0x80 ? c[2] == 0x8e || c[2] == 0x8f || (c[2] >= 0xa8 && c[2] <= 0xae) : c[1] == 0x81 && c[2] >= 0xa6 && c[2] <= 0xa9;
}

void cli_write_plain(FILE *to, const char *text)
{
    const size_t length = strlen(text);
    for (size_t i = 0; i < length;) {
        size_t n = fmt_utf8_character(text + i, length - i);
        bool control = n == 0 || unshown(text + i, n);
        if (n == 0) n = 1;
        if (!control) fwrite(text + i, 1, n, to);
        for (size_t k = 0; control && k < n; k++) fprintf(to, "\\x%02x", (unsigned char)text[i + k]);
        i += n;
    }
}

void cli_say(const cli *c, const char *kind, const char *text)
{
    fprintf(stderr, "%s%s: %s", c->progress_shown ? "\r\033[K" : "", c->tool->name, kind);
    cli_write_plain(stderr, text);
    fputc('\n', stderr);
}

static void say(const cli *c, const char *format, va_list args)
{
    char text[1000];
    vsnprintf(text, sizeof text, format, args);
    cli_say(c, "", text);
}

svo_result cli_about(const char *path, svo_result r, svo_error *err)
{
    if (r == SVO_OK || err == NULL) return r;
    const char *name = strcmp(path, "-") == 0 ? "stdin" : path;
    if (strstr(err->message, name) != NULL) return r;
    svo_error inner = *err;
    svo_fail(err, r, "%.100s: %s", name, inner.message);
    err->chunk = inner.chunk, err->offset = inner.offset, err->index = inner.index;
    return r;
}

void cli_info(const cli *c, const char *format, ...)
{
    if (c->quiet) return;
    va_list args;
    va_start(args, format);
    say(c, format, args);
    va_end(args);
}

void cli_error(const cli *c, const char *format, ...)
{
    char text[1000];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    cli_say(c, "error: ", text);
}

void cli_verbose(const cli *c, const char *format, ...)
{
    if (c->quiet || c->verbose == 0) return;
    va_list args;
    va_start(args, format);
    say(c, format, args);
    va_end(args);
}

/* --- leaving --- */

static void release(cli *c)
{
    fmt_output_discard(c->report_file);
    c->report_file = NULL;
    free(c->inputs);
    c->inputs = NULL;
    free(c->settings);
    c->settings = NULL;
    json_decref(c->json);
    c->json = NULL;
}

/* Print the failure, write the report, free. */
static int leave(cli *c, int code, const char *failure, const char *failure_name)
{
    svo_error err = {0};
    for (uint32_t i = 0; !c->quiet && i < c->warnings.count; i++) {
        char text[320];
        cli_warning_text(&c->warnings, i, text, sizeof text);
        cli_say(c, "warning: ", text);
    }
    if (c->warnings.suppressed > 0) cli_info(c, "%llu more warnings", (unsigned long long)c->warnings.suppressed);
    /* What was printed is a result too: a full disk behind stdout must not look like success. */
    if ((fflush(stdout) != 0 || ferror(stdout)) && (code == 0 || code == CLI_MAX_EXIT_CODE)) {
        svo_fail(&err, SVO_IO, "stdout could not be written: %s", strerror(errno));
        code = svo_result_exit_code(SVO_IO);
        failure = err.message, failure_name = svo_result_name(SVO_IO);
    }
    if (failure != NULL) cli_say(c, "error: ", failure);
    else if (c->progress_shown) fputs("\r\033[K", stderr);
    svo_error report_err = {0};
    bool written = cli_report_write(c, code, failure, failure_name, &report_err);
    if (written && c->report != NULL && strcmp(c->report, "-") == 0 && fflush(stdout) != 0)
        written = svo_fail(&report_err, SVO_IO, "the report could not be written to stdout: %s", strerror(errno)) == SVO_OK;
    if (!written) {
        cli_say(c, "error: ", report_err.message);
        if (code == 0 || code == CLI_MAX_EXIT_CODE) code = svo_result_exit_code(report_err.code);
    }
    release(c);
    return code;
}

static int usage_error(cli *c, const char *text)
{
    char line[1100];
    snprintf(line, sizeof line, "%s; see %s --help", text, c->tool->name);
    return leave(c, 1, line, svo_result_name(SVO_INVALID_ARGUMENT));
}

int cli_usage(cli *c, const char *format, ...)
{
    char text[1000];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    return usage_error(c, text);
}

int cli_end_code(cli *c, int exit_code)
{
    return leave(c, exit_code, NULL, NULL);
}

int cli_end(cli *c, svo_result result, const svo_error *err)
{
    if (result == SVO_OK) return leave(c, 0, NULL, NULL);
    const char *message = err != NULL && err->message[0] != 0 ? err->message : svo_result_text(result);
    if (c->json != NULL && err != NULL && (err->chunk | err->offset | err->index) != 0) {
        json_t *place = cli_section(c, "error_place");
        if (err->chunk != 0) {
            char type[5] = {0};
            for (int i = 0; i < 4; i++) type[i] = (char)(err->chunk >> (8 * i) & 0x7f);
            cli_put_text(place, "chunk", type);
        }
        cli_put_u64(place, "offset", err->offset);
        cli_put_u64(place, "index", err->index);
    }
    return leave(c, svo_result_exit_code(result), message, svo_result_name(result));
}

/* --- parsing --- */

typedef struct parser {
    cli *c;
    cli_option common[CLI_MAX_COMMON];
    size_t common_count;
    char problem[CLI_PROBLEM]; /* usage error, empty if none */
    bool no_report;    /* the error concerns the report's own name */
} parser;

static const cli_option *find(const parser *p, const char *name, size_t length, char letter)
{
    const cli_option *tables[2] = {p->c->tool->options, p->common};
    size_t counts[2] = {p->c->tool->option_count, p->common_count};
    for (int t = 0; t < 2; t++) {
        for (size_t i = 0; i < counts[t]; i++) {
            const cli_option *o = &tables[t][i];
            if (name != NULL ? strlen(o->name) == length && memcmp(o->name, name, length) == 0 : o->letter == letter) return o;
        }
    }
    return NULL;
}

/* Take the value of an option; `shown` is the option as the user wrote it. */
static bool take(parser *p, const cli_option *o, const char *shown, const char *value)
{
    if (o->value == &p->c->verbose) {
        p->c->verbose++;
        return true;
    }
    char why[200];
    if (!cli_parse_value(o, value, why)) {
        snprintf(p->problem, sizeof p->problem, "%s: '%.200s' %s", shown, value, why);
        return false;
    }
    if (o->seen != NULL) *o->seen = true;
    return true;
}

static bool is_choice(const cli_option *o, const char *word)
{
    if (o->kind != CLI_CHOICE) return false;
    for (const char *const *c = o->choices; *c != NULL; c++)
        if (strcmp(*c, word) == 0) return true;
    return false;
}

/* The value of an option that stands in the next word. A word that looks like an option is more likely a forgotten
 * value than a file name; numbers may be negative, and so may choices. */
static const char *next_value(parser *p, const cli_option *o, const char *shown, int argc, char **argv, int *i)
{
    const char *next = *i + 1 < argc ? argv[*i + 1] : NULL;
    bool like_option = next != NULL && next[0] == '-' && next[1] != 0 && (o->kind == CLI_TEXT || o->kind == CLI_CHOICE) && !is_choice(o, next);
    if (next == NULL || like_option) {
        snprintf(p->problem, sizeof p->problem, "%s needs a value", shown);
        return NULL;
    }
    ++*i;
    return next;
}

static bool parse_long(parser *p, int argc, char **argv, int *i)
{
    const char *name = argv[*i] + 2, *equals = strchr(name, '=');
    size_t length = equals != NULL ? (size_t)(equals - name) : strlen(name);
    const cli_option *o = find(p, name, length, 0);
    char shown[120];
    snprintf(shown, sizeof shown, "--%.*s", length < 100 ? (int)length : 100, name);
    if (o == NULL) {
        snprintf(p->problem, sizeof p->problem, "unknown option '%s'", shown);
        return false;
    }
    if (o->kind == CLI_FLAG) {
        if (equals == NULL) return take(p, o, shown, "");
        snprintf(p->problem, sizeof p->problem, "%s takes no value", shown);
        return false;
    }
    const char *value = equals != NULL ? equals + 1 : next_value(p, o, shown, argc, argv, i);
    return value != NULL && take(p, o, shown, value);
}

/* -q, -fq, -o OUT, -oOUT */
static bool parse_short(parser *p, int argc, char **argv, int *i)
{
    for (const char *letters = argv[*i] + 1; *letters != 0; letters++) {
        const cli_option *o = find(p, NULL, 0, *letters);
        char shown[3] = {'-', *letters, 0};
        if (o == NULL) {
            snprintf(p->problem, sizeof p->problem, "unknown option '%.100s'", letters == argv[*i] + 1 ? argv[*i] : shown);
            return false;
        }
        if (o->kind == CLI_FLAG) {
            if (!take(p, o, shown, "")) return false;
            continue;
        }
        const char *value = letters[1] != 0 ? letters + 1 : next_value(p, o, shown, argc, argv, i);
        return value != NULL && take(p, o, shown, value);
    }
    return true;
}

static bool parse_words(parser *p, int argc, char **argv)
{
    bool only_inputs = false;
    for (int i = 1; i < argc; i++) {
        const char *word = argv[i];
        if (only_inputs || word[0] != '-' || word[1] == 0) {
            p->c->inputs[p->c->input_count++] = word;
        } else if (strcmp(word, "--") == 0) {
            only_inputs = true;
        } else if (!(word[1] == '-' ? parse_long(p, argc, argv, &i) : parse_short(p, argc, argv, &i))) {
            return false;
        }
    }
    return true;
}

static bool same_file(const char *a, const char *b)
{
    struct stat s, t;
    bool there_a = strcmp(a, "-") != 0 && stat(a, &s) == 0, there_b = strcmp(b, "-") != 0 && stat(b, &t) == 0;
    if (!there_a || !there_b) return strcmp(a, b) == 0;
    return S_ISREG(s.st_mode) && s.st_dev == t.st_dev && s.st_ino == t.st_ino;
}

/* Rules between the words; false with p->problem filled. */
static bool check_words(parser *p)
{
    cli *c = p->c;
    const cli_tool *t = c->tool;
    int stdins = 0;
    for (int i = 0; i < c->input_count; i++) {
        if (c->inputs[i][0] == 0) return snprintf(p->problem, sizeof p->problem, "an input name is empty"), false;
        stdins += strcmp(c->inputs[i], "-") == 0;
    }
    if (c->input_count < t->min_inputs) {
        if (t->min_inputs == 1 || c->input_count == 0) snprintf(p->problem, sizeof p->problem, "no input given");
        else snprintf(p->problem, sizeof p->problem, "%d inputs needed, %d given", t->min_inputs, c->input_count);
        return false;
    }
    if (t->max_inputs >= 0 && c->input_count > t->max_inputs) {
        snprintf(p->problem, sizeof p->problem, "too many inputs: '%.200s' is one more than %d", c->inputs[t->max_inputs], t->max_inputs);
        return false;
    }
    if (stdins > 1) return snprintf(p->problem, sizeof p->problem, "stdin (-) can be read once only"), false;
    if (t->has_output && !t->output_optional && c->output == NULL) return snprintf(p->problem, sizeof p->problem, "no output given (-o OUT)"), false;
    if (c->report != NULL && c->output != NULL && same_file(c->report, c->output)) {
        p->no_report = true;
        return snprintf(p->problem, sizeof p->problem, "-o and --report name the same file"), false;
    }
    for (int i = 0; i < c->input_count; i++) {
        if (strcmp(c->inputs[i], "-") == 0) continue;
        const char *outs[2] = {c->output, c->report};
        for (int k = 0; k < 2; k++) {
            if (outs[k] == NULL || !same_file(c->inputs[i], outs[k])) continue;
            p->no_report = k == 1;
            snprintf(p->problem, sizeof p->problem, "'%.200s' would overwrite an input", outs[k]);
            return false;
        }
    }
    return true;
}

/* A descriptor 0..2 that the caller closed would be given to the next file opened, and talk would end up in it. */
static void fill_standard_descriptors(void)
{
    for (int fd = 0; fd <= 2; fd++)
        if (fcntl(fd, F_GETFD) == -1 && errno == EBADF && open("/dev/null", fd == 0 ? O_RDONLY : O_WRONLY) != fd) _exit(2);
}

/* An interrupted run leaves nothing behind: unfinished outputs have no name, or are removed here. */
static void on_signal(int number)
{
    fmt_output_remove_temporaries();
    raise(number); /* the handler is reset: ends the process as if there were none */
}

/* A mapped file was shortened by somebody else, or its disk fails. There is nothing to go back to: say so and end. */
static void on_bus_error(int number)
{
    static const char text[] = "error: a file that is read was shortened meanwhile, or its disk failed\n";
    (void)number;
    fmt_output_remove_temporaries();
    ssize_t unused = write(STDERR_FILENO, text, sizeof text - 1);
    (void)unused;
    _exit(svo_result_exit_code(SVO_IO));
}

static void set_signals(void)
{
    struct sigaction bus = {.sa_handler = on_bus_error, .sa_flags = (int)SA_RESETHAND};
    sigemptyset(&bus.sa_mask);
    sigaction(SIGBUS, &bus, NULL);
    signal(SIGPIPE, SIG_IGN); /* a reader that has gone is an I/O error */
    static const int ends[] = {SIGHUP, SIGINT, SIGTERM};
    for (size_t i = 0; i < sizeof ends / sizeof *ends; i++) {
        struct sigaction action = {.sa_handler = on_signal, .sa_flags = (int)SA_RESETHAND}, old;
        sigemptyset(&action.sa_mask);
        /* ignored by nohup and the like: stays so */
        if (sigaction(ends[i], NULL, &old) == 0 && old.sa_handler != SIG_IGN) sigaction(ends[i], &action, NULL);
    }
}

int cli_begin(cli *c, const cli_tool *tool, int argc, char **argv)
{
    memset(c, 0, sizeof *c);
    fill_standard_descriptors();
    set_signals();
    cli_watch_memory();
    c->tool = tool;
    c->started = c->phase_started = svo_seconds();
    c->json = json_object();
    c->inputs = calloc((size_t)argc + 1, sizeof *c->inputs);
    bool help = false, version = false;
    parser p = {.c = c};
    p.common_count = cli_common_options(c, &help, &version, p.common);
    if (c->json == NULL || c->inputs == NULL) {
        cli_say(c, "error: ", "out of memory");
        release(c);
        return svo_result_exit_code(SVO_OUT_OF_MEMORY);
    }
    /* Before parsing changes what is printed as the default. */
    for (int i = 1; i < argc && strcmp(argv[i], "--") != 0; i++) {
        if (strcmp(argv[i], "--help") == 0 || strcmp(argv[i], "-h") == 0) {
            cli_print_help(stdout, tool, p.common, p.common_count);
            return leave(c, 0, NULL, NULL);
        }
        if (strcmp(argv[i], "--help=man") == 0 || strcmp(argv[i], "--help=bash") == 0) {
            (argv[i][7] == 'm' ? cli_print_man : cli_print_bash)(stdout, tool, p.common, p.common_count);
            return leave(c, 0, NULL, NULL);
        }
        if (strcmp(argv[i], "--version") == 0) {
            printf("%s %s (svokit)\n", tool->name, SVO_VERSION_STRING);
            return leave(c, 0, NULL, NULL);
        }
    }
    svo_error err = {0};
    if (!cli_settings(c, p.common, p.common_count, argc, argv, p.problem, &err))
        return p.problem[0] != 0 ? usage_error(c, p.problem) : leave(c, svo_result_exit_code(err.code), err.message, svo_result_name(err.code));
    bool sound = parse_words(&p, argc, argv);
    if (help) { /* inside a bundle: -qh */
        cli_print_help(stdout, tool, p.common, p.common_count);
        c->report = NULL;
        return leave(c, 0, NULL, NULL);
    }
    if (sound) sound = check_words(&p);
    else p.no_report = true; /* the rest of the command line was not read: write nothing anywhere */
    cli_put_text(c->json, "tool", tool->name);
    cli_put_text(c->json, "version", SVO_VERSION_STRING);
    cli_report_options(c);
    cli_section(c, "input");
    cli_section(c, "output");
    cli_section(c, "errors");
    json_object_set_new(c->json, "phases", json_array());
    if (p.no_report) c->report = NULL;
    if (!cli_report_open(c, &err)) {
        c->report = NULL;
        return leave(c, svo_result_exit_code(err.code), err.message, svo_result_name(err.code));
    }
    return sound ? -1 : usage_error(c, p.problem);
}
