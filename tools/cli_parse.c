/* Option values: text to number and back. */
#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "cli_internal.h"

static bool limited(const cli_option *o) { return o->min != 0 || o->max != 0; }

static bool parse_digits(const char **text, uint64_t *out)
{
    const char *p = *text;
    uint64_t v = 0;
    if (!isdigit((unsigned char)*p)) return false;
    for (; isdigit((unsigned char)*p); p++) {
        uint64_t digit = (uint64_t)(*p - '0');
        if (v > (UINT64_MAX - digit) / 10) return false;
        v = v * 10 + digit;
    }
    *text = p;
    *out = v;
    return true;
}

/* A decimal number; strtod alone would also take blanks, hexadecimals, "nan" and "infinity". */
static bool parse_double(const char **text, double *out)
{
    const char *p = *text + (**text == '-' || **text == '+');
    if (!isdigit((unsigned char)*p) && !(*p == '.' && isdigit((unsigned char)p[1]))) return false;
    if (p[0] == '0' && (p[1] == 'x' || p[1] == 'X')) return false;
    char *end;
    double v = strtod(*text, &end);
    if (!isfinite(v)) return false;
    *text = end;
    *out = v;
    return true;
}

static bool in_range(const cli_option *o, double v, char why[200])
{
    if (!limited(o) || (v >= o->min && v <= o->max)) return true;
    char range[120];
    cli_range_text(o, range, sizeof range);
    snprintf(why, 200, "is not in the range %s", range);
    return false;
}

static bool parse_size(const char *text, uint64_t *out, char why[200])
{
    static const char form[] = "is not a size (a number, then K, M, G or T for powers of 1024)";
    const char *p = text;
    uint64_t whole;
    double fraction = 0;
    if (!parse_digits(&p, &whole)) goto bad;
    if (*p == '.') {
        double scale = 0.1;
        if (!isdigit((unsigned char)p[1])) goto bad;
        for (p++; isdigit((unsigned char)*p); p++, scale /= 10) fraction += scale * (*p - '0');
    }
    static const char letters[] = "KMGT";
    const char *letter = *p != 0 ? strchr(letters, toupper((unsigned char)*p)) : NULL;
    uint32_t shift = 0;
    if (letter != NULL) {
        shift = 10 * (uint32_t)(letter - letters + 1);
        p++;
        if (p[0] == 'i' && p[1] == 'B') p += 2;
    } else if (*p == 'B') {
        p++;
    }
    if (*p != 0 || (fraction != 0 && shift == 0)) goto bad;
    if (whole >= (uint64_t)1 << (63 - shift)) {
        snprintf(why, 200, "is too large");
        return false;
    }
    *out = (whole << shift) + (uint64_t)(fraction * (double)((uint64_t)1 << shift));
    return true;
bad:
    snprintf(why, 200, "%s", form);
    return false;
}

static bool parse_vec3(const char *text, double out[3])
{
    double v[3];
    for (int i = 0; i < 3; i++) {
        if (!parse_double(&text, &v[i]) || *text != (i < 2 ? ',' : 0)) return false;
        text++;
    }
    memcpy(out, v, sizeof v);
    return true;
}

bool cli_parse_value(const cli_option *o, const char *text, char why[200])
{
    switch (o->kind) {
    case CLI_FLAG: *(bool *)o->value = true; return true;
    case CLI_TEXT:
        if (*text == 0) {
            snprintf(why, 200, "must not be empty");
            return false;
        }
        *(const char **)o->value = text;
        return true;
    case CLI_U64: {
        uint64_t v;
        const char *p = text;
        if (!parse_digits(&p, &v) || *p != 0) {
            snprintf(why, 200, "is not a whole number");
            return false;
        }
        if (!in_range(o, (double)v, why)) return false;
        *(uint64_t *)o->value = v;
        return true;
    }
    case CLI_DOUBLE: {
        double v;
        const char *p = text;
        if (!parse_double(&p, &v) || *p != 0) {
            snprintf(why, 200, "is not a number");
            return false;
        }
        if (!in_range(o, v, why)) return false;
        *(double *)o->value = v;
        return true;
    }
    case CLI_SIZE: {
        uint64_t v;
        if (!parse_size(text, &v, why) || !in_range(o, (double)v, why)) return false;
        *(uint64_t *)o->value = v;
        return true;
    }
    case CLI_CHOICE: {
        for (int i = 0; o->choices[i] != NULL; i++) {
            if (strcmp(o->choices[i], text) == 0) {
                *(int *)o->value = i;
                return true;
            }
        }
        char range[120];
        cli_range_text(o, range, sizeof range);
        snprintf(why, 200, "is not one of %s", range);
        return false;
    }
    case CLI_VEC3:
        if (parse_vec3(text, (double *)o->value)) return true;
        snprintf(why, 200, "is not three numbers x,y,z");
        return false;
    }
    return false;
}

bool cli_parse_text(const cli_option *o, const char *text, char why[200]) { return cli_parse_value(o, text, why); }

static void size_text(uint64_t v, char *out, size_t size)
{
    static const char letters[] = "TGMK";
    for (int i = 0; i < 4; i++) {
        uint64_t unit = (uint64_t)1 << (10 * (4 - i));
        if (v >= unit && v % unit == 0) {
            snprintf(out, size, "%llu%c", (unsigned long long)(v / unit), letters[i]);
            return;
        }
    }
    snprintf(out, size, "%llu", (unsigned long long)v);
}

/* A number as short as it can be. */
static void number_text(const cli_option *o, double v, char *out, size_t size)
{
    if (o->kind == CLI_SIZE && v >= 0 && v < 0x1p63) size_text((uint64_t)v, out, size);
    else snprintf(out, size, "%.10g", v);
}

void cli_range_text(const cli_option *o, char *out, size_t size)
{
    out[0] = 0;
    if (o->kind == CLI_CHOICE) {
        size_t at = 0;
        for (int i = 0; o->choices[i] != NULL && at < size; i++)
            at += (size_t)snprintf(out + at, size - at, "%s%s", i > 0 ? "|" : "", o->choices[i]);
    } else if ((o->kind == CLI_U64 || o->kind == CLI_DOUBLE || o->kind == CLI_SIZE) && limited(o)) {
        char low[40], high[40];
        number_text(o, o->min, low, sizeof low);
        number_text(o, o->max, high, sizeof high);
        if (isinf(o->max)) snprintf(out, size, "%s or more", low);
        else if (isinf(o->min)) snprintf(out, size, "%s or less", high);
        else snprintf(out, size, "%s..%s", low, high);
    }
}

void cli_value_text(const cli_option *o, char *out, size_t size)
{
    const double *d = (const double *)o->value;
    switch (o->kind) {
    case CLI_FLAG: snprintf(out, size, "%s", *(const bool *)o->value ? "on" : "off"); break;
    case CLI_TEXT: snprintf(out, size, "%s", *(const char **)o->value != NULL ? *(const char **)o->value : ""); break;
    case CLI_U64: snprintf(out, size, "%llu", (unsigned long long)*(const uint64_t *)o->value); break;
    case CLI_DOUBLE: snprintf(out, size, "%.10g", *d); break;
    case CLI_SIZE: size_text(*(const uint64_t *)o->value, out, size); break;
    case CLI_CHOICE: snprintf(out, size, "%s", o->choices[*(const int *)o->value]); break;
    case CLI_VEC3: snprintf(out, size, "%.10g,%.10g,%.10g", d[0], d[1], d[2]); break;
    }
}
