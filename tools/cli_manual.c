/* The manual page and the completion of bash, printed from the option table like --help: `--help=man`, `--help=bash`. */
#include <ctype.h>
#include <string.h>

#include "cli_internal.h"

/* Text for roff: no line begins with a control character, and hyphens can be copied as such. */
static void roff(FILE *to, const char *text)
{
    bool start = true;
    for (; *text != 0; text++) {
        if (start && (*text == '.' || *text == '\'')) fputs("\\&", to);
        if (*text == '\\') fputs("\\e", to);
        else if (*text == '-') fputs("\\-", to);
        else fputc(*text, to);
        start = *text == '\n';
    }
}

static void man_option(FILE *to, const cli_option *o)
{
    char range[200] = "", value[200] = "";
    fputs(".TP\n", to);
    if (o->letter != 0) fprintf(to, "\\fB\\-%c\\fR, ", o->letter);
    fputs("\\fB\\-\\-", to);
    roff(to, o->name);
    fputs("\\fR", to);
    if (o->kind != CLI_FLAG) {
        fputs(" \\fI", to);
        roff(to, o->argument != NULL ? o->argument : "VALUE");
        fputs("\\fR", to);
    }
    fputc('\n', to);
    roff(to, o->help);
    cli_range_text(o, range, sizeof range);
    if (!o->no_default && o->kind != CLI_FLAG) cli_value_text(o, value, sizeof value);
    if (range[0] != 0 || value[0] != 0) {
        fputs(" (", to);
        roff(to, range);
        if (range[0] != 0 && value[0] != 0) fputs("; ", to);
        if (value[0] != 0) fputs("default ", to);
        roff(to, value);
        fputc(')', to);
    }
    fputc('\n', to);
}

static const char *group_of(const cli_option *o) { return o->group != NULL ? o->group : "Options"; }

static void man_group(FILE *to, const char *group, const cli_option *options, size_t count)
{
    fputs(".SS ", to);
    roff(to, group);
    fputc('\n', to);
    for (size_t i = 0; i < count; i++)
        if (strcmp(group_of(&options[i]), group) == 0) man_option(to, &options[i]);
}

/* Paragraphs; lines that begin with a blank are kept as they are. */
static void man_text(FILE *to, const char *text)
{
    while (*text != 0) {
        char line[2048];
        size_t length = strcspn(text, "\n");
        snprintf(line, sizeof line, "%.*s", (int)length, text);
        fputs(line[0] == ' ' ? ".PP\n.nf\n" : ".PP\n", to);
        roff(to, line);
        fputs(line[0] == ' ' ? "\n.fi\n" : "\n", to);
        text += length + (text[length] == '\n');
    }
}

void cli_print_man(FILE *to, const cli_tool *tool, const cli_option *common, size_t common_count)
{
    fputs(".TH ", to);
    for (const char *p = tool->name; *p != 0; p++) fputc(toupper((unsigned char)*p), to);
    fprintf(to, " 1 \"\" \"svokit %s\" \"svokit\"\n.SH NAME\n", SVO_VERSION_STRING);
    roff(to, tool->name);
    fputs(" \\- ", to);
    char summary[400];
    snprintf(summary, sizeof summary, "%s", tool->summary);
    size_t n = strlen(summary);
    if (n != 0 && summary[n - 1] == '.') summary[n - 1] = 0;
    if (summary[0] != 0 && islower((unsigned char)summary[1])) summary[0] = (char)tolower((unsigned char)summary[0]);
    roff(to, summary);
    fputs("\n.SH SYNOPSIS\n", to);
    for (const char *p = tool->synopsis; *p != 0;) {
        char line[700];
        const size_t length = strcspn(p, "\n");
        snprintf(line, sizeof line, "%.*s", (int)length, p);
        fputs(p == tool->synopsis ? ".B " : ".PP\n.B ", to);
        roff(to, tool->name);
        fputc('\n', to);
        roff(to, line);
        fputc('\n', to);
        p += length + (p[length] == '\n');
    }
    fputs(".SH DESCRIPTION\n", to);
    roff(to, tool->summary);
    fputc('\n', to);
    if (tool->details != NULL) man_text(to, tool->details);
    fputs(".SH OPTIONS\n", to);
    for (size_t i = 0; i < tool->option_count; i++) { /* groups in the order of their first option */
        bool known = false;
        for (size_t k = 0; k < i && !known; k++) known = strcmp(group_of(&tool->options[k]), group_of(&tool->options[i])) == 0;
        if (!known) man_group(to, group_of(&tool->options[i]), tool->options, tool->option_count);
    }
    man_group(to, "Common options", common, common_count);
    fputs(".SH EXIT STATUS\n", to);
    for (int code = 0; code < CLI_MAX_EXIT_CODE; code++) {
        bool first = true;
        fprintf(to, ".TP\n\\fB%d\\fR\n", code);
#define PRINT(name, number, exit_code, text) \
    if ((exit_code) == code) {               \
        fputs(first ? "" : ", ", to);        \
        roff(to, text);                      \
        first = false;                       \
    }
        SVO_RESULT_MAP(PRINT)
#undef PRINT
        fputc('\n', to);
    }
    fputs(".TP\n\\fB7\\fR\nthe inputs differ (svo\\-compare)\n", to);
    if (tool->example != NULL) {
        fputs(".SH EXAMPLES\n.nf\n", to);
        roff(to, tool->example);
        fputs("\n.fi\n", to);
    }
    fputs(".SH SEE ALSO\n", to);
    static const char *const all[] = {"svo-voxelize", "svo-compress", "svo-merge", "svo-skeleton", "svo-pack", "svo-render", "svo-dump", "svo-compare", "svo-bench", "svo-build"};
    bool first = true;
    for (size_t i = 0; i < sizeof all / sizeof all[0]; i++) {
        if (strcmp(all[i], tool->name) == 0) continue;
        fputs(first ? "\\fB" : ",\n\\fB", to);
        roff(to, all[i]);
        fputs("\\fR(1)", to);
        first = false;
    }
    fputc('\n', to);
}

static void put_words(FILE *to, const cli_option *options, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        fprintf(to, " --%s", options[i].name);
        if (options[i].letter != 0) fprintf(to, " -%c", options[i].letter);
    }
}

static void put_case(FILE *to, const cli_option *o)
{
    if (o->kind == CLI_FLAG) return;
    fprintf(to, "    --%s", o->name);
    if (o->letter != 0) fprintf(to, "|-%c", o->letter);
    fputs(") ", to);
    if (o->kind == CLI_CHOICE) {
        fputs("COMPREPLY=($(compgen -W \"", to);
        for (int i = 0; o->choices[i] != NULL; i++) fprintf(to, "%s%s", i > 0 ? " " : "", o->choices[i]);
        fputs("\" -- \"$word\"));", to);
    } else if (o->kind == CLI_TEXT) {
        fputs("COMPREPLY=($(compgen -f -- \"$word\"));", to);
    } else {
        fputs("COMPREPLY=();", to);
    }
    fputs(" return;;\n", to);
}

void cli_print_bash(FILE *to, const cli_tool *tool, const cli_option *common, size_t common_count)
{
    char name[64];
    size_t n = 0;
    for (; tool->name[n] != 0 && n < sizeof name - 1; n++) name[n] = tool->name[n] == '-' ? '_' : tool->name[n];
    name[n] = 0;
    fprintf(to, "# bash completion of %s, made by %s --help=bash\n_%s()\n{\n    local word=\"${COMP_WORDS[COMP_CWORD]}\" before=\"${COMP_WORDS[COMP_CWORD - 1]}\"\n", tool->name, tool->name, name);
    fputs("    if [ \"$word\" = = ]; then word=\n    elif [ \"$before\" = = ]; then before=\"${COMP_WORDS[COMP_CWORD - 2]}\"\n    fi\n    case \"$before\" in\n", to);
    for (size_t i = 0; i < tool->option_count; i++) put_case(to, &tool->options[i]);
    for (size_t i = 0; i < common_count; i++) put_case(to, &common[i]);
    fputs("    esac\n    case \"$word\" in\n    -*) COMPREPLY=($(compgen -W \"", to);
    put_words(to, tool->options, tool->option_count);
    put_words(to, common, common_count);
    fprintf(to, "\" -- \"$word\"));;\n    *) COMPREPLY=($(compgen -f -- \"$word\"));;\n    esac\n}\ncomplete -o filenames -F _%s %s\n", name, tool->name);
}
