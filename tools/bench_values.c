/* svo-bench: the list of values that --values takes. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"

typedef struct rule {
    const char *otherwise;    /* the default list */
    double least, most, step; /* of numbers; whole numbers in multiples of step, or step 0: any number */
    const char *bound;        /* "deltaE" in "deltaE=1"; NULL = there is none */
    const char *what;
} rule;

static const rule rules[] = {
    [SWEEP_DEPTH] = {"6..10", 0, SVO_MAX_DEPTH, 1, NULL, "whole numbers from 0 to 21"},
    [SWEEP_COLOR] = {"4..14", 1, 16, 1, "deltaE", "bits from 1 to 16, deltaE=X with X above 0, or lossless"},
    [SWEEP_NORMAL] = {"8..24", 4, 32, 2, "deg", "even numbers of bits from 4 to 32, deg=X with X above 0, or lossless"},
    [SWEEP_OMEGA] = {"0.2,0.1,0.05,0.035,0.025,0.015", 1e-4, 4, 0, NULL, "numbers from 0.0001 to 4"},
    [SWEEP_METHOD] = {"fast@0.05,fast@0.025,fast@0.0125,fast+grid@0.05,fast+grid@0.025,fast+grid@0.0125,literal+grid@0.05,literal+grid@0.025,"
                      "fast+delta@0.025,fast+centroid@0.025,fast+contracted@0.025", 1e-4, 4, 0, NULL,
                      "words of fast, literal, flann, grid, inside, centroid, contracted, delta with + between, @ and omega from 0.0001 to 4, as literal+grid@0.025"},
};

static bool add(bench_value out[BENCH_MAX_VALUES], uint32_t *count, bench_value_kind kind, double number, const char *bound)
{
    if (*count == BENCH_MAX_VALUES) return false;
    bench_value *v = &out[(*count)++];
    v->kind = kind;
    v->number = number;
    if (kind == VALUE_LOSSLESS) snprintf(v->label, sizeof v->label, "lossless");
    else snprintf(v->label, sizeof v->label, "%s%s%.6g", kind == VALUE_BOUND ? bound : "", kind == VALUE_BOUND ? "=" : "", number);
    return true;
}

static bool parse_number(const rule *r, const char *text, double *out)
{
    char *end;
    if ((text[0] < '0' || text[0] > '9') && text[0] != '.') return false; /* no blanks, signs, inf, nan */
    *out = strtod(text, &end);
    return end != text && *end == 0 && strpbrk(text, "xXpP") == NULL && *out >= r->least && *out <= r->most && (r->step == 0 || fmod(*out, r->step) == 0);
}

/* "A..B" or "A..B:STEP"; -1 = no range, 0 = wrong, 1 = right, 2 = too many. */
static int parse_range(const rule *r, char *item, bench_value out[BENCH_MAX_VALUES], uint32_t *count)
{
    char *dots = strstr(item, ".."), *colon = strchr(item, ':');
    if (r->step == 0 || dots == NULL) return -1;
    double from, to, step = r->step;
    *dots = 0;
    if (colon != NULL) {
        *colon = 0;
        rule steps = *r;
        steps.least = r->step;
        if (!parse_number(&steps, colon + 1, &step)) return 0;
    }
    if (!parse_number(r, item, &from) || !parse_number(r, dots + 2, &to) || from > to) return 0;
    for (double x = from; x <= to; x += step)
        if (!add(out, count, VALUE_NUMBER, x, NULL)) return 2;
    return 1;
}

bool bench_parse_values(bench_sweep sweep, const char *text, bench_value out[BENCH_MAX_VALUES], uint32_t *count, char why[300])
{
    const rule *r = &rules[sweep];
    if (text == NULL) text = r->otherwise;
    *count = 0;
    for (const char *at = text;;) {
        size_t length = strcspn(at, ","), bound = r->bound != NULL ? strlen(r->bound) : 0;
        char item[64];
        bool fits = length < sizeof item, good = false, room = true;
        double x;
        snprintf(item, sizeof item, "%.*s", fits ? (int)length : 40, at);
        char shown[64];
        memcpy(shown, item, sizeof item);
        int range = fits ? parse_range(r, item, out, count) : 0;
        if (sweep == SWEEP_METHOD) {
            bench_value m;
            good = fits && bench_parse_method(item, &m);
            room = !good || *count < BENCH_MAX_VALUES;
            if (good && room) out[(*count)++] = m;
        } else if (range >= 0) {
            good = range > 0;
            room = range != 2;
        } else if (bound != 0 && strcmp(item, "lossless") == 0) {
            good = true;
            room = add(out, count, VALUE_LOSSLESS, 0, NULL);
        } else if (bound != 0 && strncmp(item, r->bound, bound) == 0 && item[bound] == '=') {
            rule any = {.least = 1e-6, .most = 1e6};
            good = parse_number(&any, item + bound + 1, &x);
            room = !good || add(out, count, VALUE_BOUND, x, r->bound);
        } else {
            good = parse_number(r, item, &x);
            room = !good || add(out, count, VALUE_NUMBER, x, NULL);
        }
        if (!good) return snprintf(why, 300, "'%s' is none of the values of this sweep: %s", shown, r->what), false;
        if (!room) return snprintf(why, 300, "more than %d values", BENCH_MAX_VALUES), false;
        if (at[length] == 0) break;
        at += length + 1;
    }
    for (uint32_t i = 0; i < *count; i++)
        for (uint32_t k = 0; k < i; k++)
            if (strcmp(out[i].label, out[k].label) == 0) return snprintf(why, 300, "'%s' comes twice", out[i].label), false;
    return true;
}
