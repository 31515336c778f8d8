/* The help text, printed from the option table. */
#include <string.h>

#include "cli_internal.h"

enum { WIDTH = 100, COLUMN = 30 };

/* Print text wrapped to WIDTH; the cursor is at column `at`, further lines begin at `indent`. "\n" begins a line. */
static void wrap(FILE *to, const char *text, int at, int indent)
{
    bool line_start = true;
    while (*text != 0) {
        if (*text == '\n') {
            fputc('\n', to);
            text++;
            at = 0;
            line_start = true;
            continue;
        }
        if (*text == ' ' && !line_start) {
            text++;
            continue;
        }
        size_t length = strcspn(text, " \n");
        if (length == 0) length = strspn(text, " "); /* indentation inside the text is kept */
        if (!line_start && at + 1 + (int)length > WIDTH) {
            fputc('\n', to);
            at = 0;
            line_start = true;
        }
        if (at == 0) at += fprintf(to, "%*s", indent, "");
        if (!line_start) at += fprintf(to, " ");
        at += fprintf(to, "%.*s", (int)length, text);
        line_start = *text == ' ';
        text += length;
    }
    fputc('\n', to);
}

static void print_option(FILE *to, const cli_option *o)
{
    char left[120], text[700], range[200], value[200];
    int n = o->letter != 0 ? snprintf(left, sizeof left, "  -%c, --%s", o->letter, o->name)
                           : snprintf(left, sizeof left, "      --%s", o->name);
    if (o->kind != CLI_FLAG)
        n += snprintf(left + n, sizeof left - (size_t)n, " %s", o->argument != NULL ? o->argument : "VALUE");
    fputs(left, to);
    if (n + 2 > COLUMN) {
        fputc('\n', to);
        n = 0;
    }
    fprintf(to, "%*s", COLUMN - n, "");
    cli_range_text(o, range, sizeof range);
    value[0] = 0;
    if (!o->no_default && o->kind != CLI_FLAG) cli_value_text(o, value, sizeof value);
    snprintf(text, sizeof text, "%s%s%s%s%s%s%s", o->help, range[0] || value[0] ? " (" : "", range,
             range[0] && value[0] ? "; " : "", value[0] ? "default " : "", value, range[0] || value[0] ? ")" : "");
    wrap(to, text, COLUMN, COLUMN);
}

static void print_group(FILE *to, const char *group, const cli_option *options, size_t count)
{
    fprintf(to, "\n%s:\n", group);
    for (size_t i = 0; i < count; i++)
        if (strcmp(options[i].group != NULL ? options[i].group : "Options", group) == 0) print_option(to, &options[i]);
}

static void print_exit_codes(FILE *to)
{
    fputs("\nExit status:\n", to);
    for (int code = 0; code < CLI_MAX_EXIT_CODE; code++) {
        fprintf(to, "  %d  ", code);
        bool first = true;
#define PRINT(name, number, exit_code, text)           \
        if ((exit_code) == code) {                     \
            fprintf(to, "%s%s", first ? "" : ", ", text); \
            first = false;                             \
        }
        SVO_RESULT_MAP(PRINT)
#undef PRINT
        fputc('\n', to);
    }
    fputs("  7  the inputs differ (svo-compare)\n", to);
}

void cli_print_help(FILE *to, const cli_tool *tool, const cli_option *common, size_t common_count)
{
    char text[700];
    snprintf(text, sizeof text, "%s: %s", tool->name, tool->summary);
    wrap(to, text, 0, 0);
    fputc('\n', to);
    for (const char *p = tool->synopsis; *p != 0;) {
        const size_t length = strcspn(p, "\n");
        snprintf(text, sizeof text, "%.*s", (int)length, p);
        const int at = fprintf(to, "%-6s %s ", p == tool->synopsis ? "Usage:" : "", tool->name);
        wrap(to, text, at, at);
        p += length + (p[length] == '\n');
    }
    for (size_t i = 0; i < tool->option_count; i++) { /* groups in the order of their first option */
        const char *group = tool->options[i].group != NULL ? tool->options[i].group : "Options";
        bool known = false;
        for (size_t k = 0; k < i && !known; k++)
            known = strcmp(tool->options[k].group != NULL ? tool->options[k].group : "Options", group) == 0;
        if (!known) print_group(to, group, tool->options, tool->option_count);
    }
    print_group(to, "Common options", common, common_count);
    if (tool->details != NULL) {
        fputc('\n', to);
        wrap(to, tool->details, 0, 0);
    }
    if (tool->example != NULL) {
        fputs("\nExample:\n", to);
        for (const char *p = tool->example; *p != 0;) {
            size_t length = strcspn(p, "\n");
            fprintf(to, "  %.*s\n", (int)length, p);
            p += length + (p[length] == '\n');
        }
    }
    print_exit_codes(to);
}
