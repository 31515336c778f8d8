/* Tokens of text formats (OBJ, MTL, PLY, STL, OFF): internal to formats/. All work on [p, end) without a terminator. */
#ifndef IMPORT_TEXT_H
#define IMPORT_TEXT_H

#include <string.h>

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* [begin, end) is a decimal number without a leading '+'; correctly rounded. `huge` says to which side a value
 * out of range goes (infinity or zero). False when it is no number. */
bool import_number_slow(const char *begin, const char *end, bool huge, double *out);

/* Up to `most` finite numbers of a terminated text; blanks, commas and brackets are between them. Returns how many, -1 when there is something else or more. */
int import_numbers(const char *text, double *out, int most);

static inline bool import_blank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }
static inline bool import_space(char c) { return import_blank(c) || c == '\n'; }
static inline bool import_digit(char c) { return c >= '0' && c <= '9'; }

/* The newline that ends the line of p, or `end`. */
static inline const char *import_line_end(const char *p, const char *end)
{
    const char *stop = (const char *)memchr(p, '\n', (size_t)(end - p));
    return stop != NULL ? stop : end;
}

static inline const char *import_skip_blank(const char *p, const char *end)
{
    while (p < end && import_blank(*p)) p++;
    return p;
}
static inline const char *import_skip_space(const char *p, const char *end)
{
    while (p < end && import_space(*p)) p++;
    return p;
}
static inline const char *import_token_end(const char *p, const char *end)
{
    while (p < end && !import_space(*p)) p++;
    return p;
}

/* One token as a double; returns its end, or NULL when [p, token end) is not a number. Accepts what programs print:
 * leading '+', "nan", "inf", and the old Microsoft forms "1.#QNAN", "-1.#IND", "1.#INF". Digits beyond what a double
 * holds are rounded correctly. */
const char *import_odd_double(const char *p, const char *end, double *out);

static inline const char *import_double(const char *p, const char *end, double *out)
{
    static const double power[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                   1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    const char *q = p;
    bool negative = q < end && *q == '-';
    if (negative) q++;
    uint64_t mantissa = 0;
    int digits = 0, exponent = 0;
    const char *first = q;
    for (; q < end && import_digit(*q); q++) mantissa = mantissa * 10 + (uint64_t)(*q - '0');
    digits = (int)(q - first > 64 ? 64 : q - first);
    if (q < end && *q == '.') {
        const char *point = ++q;
        for (; q < end && import_digit(*q); q++) mantissa = mantissa * 10 + (uint64_t)(*q - '0');
        if (q - point > 64) return import_odd_double(p, end, out);
        exponent = -(int)(q - point);
        digits += (int)(q - point);
    }
    if (digits == 0 || digits > 18) return import_odd_double(p, end, out);
    if (q < end && (*q == 'e' || *q == 'E')) {
        const char *e = q + 1;
        bool minus = e < end && *e == '-';
        if (e < end && (*e == '-' || *e == '+')) e++;
        int value = 0;
        const char *start = e;
        for (; e < end && import_digit(*e) && value < 10000; e++) value = value * 10 + (*e - '0');
        if (e == start || (e < end && import_digit(*e))) return import_odd_double(p, end, out);
        exponent += minus ? -value : value;
        q = e;
    }
    if (q < end && !import_space(*q)) return import_odd_double(p, end, out);
    /* Clinger: both operands exact, so one rounding. */
    if (mantissa > (1ull << 53) || exponent < -22 || exponent > 22) return import_odd_double(p, end, out);
    double v = exponent < 0 ? (double)mantissa / power[-exponent] : (double)mantissa * power[exponent];
    *out = negative ? -v : v;
    return q;
}

/* An integer at p (no leading blanks); returns the first character after its digits, NULL when there is none or it
 * does not fit 62 bits. */
static inline const char *import_integer(const char *p, const char *end, int64_t *out)
{
    bool negative = p < end && *p == '-';
    if (p < end && (*p == '-' || *p == '+')) p++;
    const char *first = p;
    int64_t v = 0;
    for (; p < end && import_digit(*p); p++) {
        if (v > INT64_MAX / 20 - 9) return NULL;
        v = v * 10 + (*p - '0');
    }
    if (p == first) return NULL;
    *out = negative ? -v : v;
    return p;
}

/* Does [p, end) start with the word and then a blank, a line end or nothing? Returns what follows the word, else NULL. */
const char *import_word(const char *p, const char *end, const char *word);
/* The same without regard to ASCII case. */
const char *import_word_nocase(const char *p, const char *end, const char *word);

#ifdef __cplusplus
}
#endif
#endif
