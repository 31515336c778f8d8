#include "svo_base.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

const char *svo_result_text(svo_result result)
{
    switch (result) {
#define SVO_RESULT_CASE(name, number, exit_code, text) \
    case SVO_##name: return text;
        SVO_RESULT_MAP(SVO_RESULT_CASE)
#undef SVO_RESULT_CASE
    }
    return "unknown result";
}

const char *svo_result_name(svo_result result)
{
    switch (result) {
#define SVO_RESULT_CASE(name, number, exit_code, text) \
    case SVO_##name: return #name;
        SVO_RESULT_MAP(SVO_RESULT_CASE)
#undef SVO_RESULT_CASE
    }
    return "UNKNOWN";
}

int svo_result_exit_code(svo_result result)
{
    switch (result) {
#define SVO_RESULT_CASE(name, number, exit_code, text) \
    case SVO_##name: return exit_code;
        SVO_RESULT_MAP(SVO_RESULT_CASE)
#undef SVO_RESULT_CASE
    }
    return 4;
}

svo_result svo_fail(svo_error *err, svo_result code, const char *format, ...)
{
    if (err != NULL) {
        /* Formatted aside first, so that a caller may wrap the message already in *err. */
        char text[sizeof err->message];
        va_list args;
        va_start(args, format);
        vsnprintf(text, sizeof text, format, args);
        va_end(args);
        memset(err, 0, sizeof *err);
        err->code = code;
        memcpy(err->message, text, sizeof text);
    }
    return code;
}

void svo_assert_failed(const char *expression, const char *file, int line)
{
    fprintf(stderr, "%s:%d: assertion failed: %s\n", file, line, expression);
    abort();
}

void svo_warn(svo_warnings *w, const char *format, ...)
{
    if (w == NULL) return;
    char text[sizeof w->line[0].text];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    for (uint32_t i = 0; i < w->count; i++) {
        if (strcmp(w->line[i].text, text) == 0) {
            w->line[i].times++;
            return;
        }
    }
    if (w->count == SVO_MAX_WARNINGS) {
        w->suppressed++;
        return;
    }
    w->line[w->count].times = 1;
    memcpy(w->line[w->count].text, text, sizeof text);
    w->count++;
}

double svo_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
