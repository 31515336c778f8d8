/* Shared by the cli_*.c files only. */
#ifndef CLI_INTERNAL_H
#define CLI_INTERNAL_H

#include <stdio.h>

#include "cli.h"

enum { CLI_MAX_COMMON = 14, CLI_MAX_EXIT_CODE = 7, CLI_PROBLEM = 600 };

/* The common options, bound to c. Returns their number. help and version are bound to *help and *version. */
size_t cli_common_options(cli *c, bool *help, bool *version, cli_option out[CLI_MAX_COMMON]);

/* Parse the text of one value; false with a reason in why. */
bool cli_parse_value(const cli_option *o, const char *text, char why[200]);
/* Take options from the configuration file and the environment, before the command line is parsed. False: a usage error is in problem, or else *err has what failed. */
bool cli_settings(cli *c, const cli_option *common, size_t common_count, int argc, char **argv, char problem[CLI_PROBLEM], svo_error *err);
/* Text of an option's range ("0..21", "a|b|c"), empty when there is none, and of its present value. */
void cli_range_text(const cli_option *o, char *out, size_t size);
void cli_value_text(const cli_option *o, char *out, size_t size);

void cli_print_help(FILE *to, const cli_tool *tool, const cli_option *common, size_t common_count);

/* The manual page in roff, and bash's completion. */
void cli_print_man(FILE *to, const cli_tool *tool, const cli_option *common, size_t common_count);
void cli_print_bash(FILE *to, const cli_tool *tool, const cli_option *common, size_t common_count);

/* Open c->report; false with *err filled. */
bool cli_report_open(cli *c, svo_error *err);
/* Complete and write it (or discard when it was never opened); false with *err filled. */
bool cli_report_write(cli *c, int exit_code, const char *failure, const char *failure_name, svo_error *err);
void cli_report_options(cli *c);
/* Line i of w, with the number of times where that is not 1. */
void cli_warning_text(const svo_warnings *w, uint32_t i, char *out, size_t size);

/* Called once before anything else: ends the tool with exit code 4 and a message where memory runs out inside jansson or a C++ destructor. */
void cli_watch_memory(void);

/* stderr line with prefix, clearing a progress line first. */
void cli_say(const cli *c, const char *kind, const char *text);

#endif
