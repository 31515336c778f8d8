#include "import_text.h"

#include <math.h>
#include <string.h>
#include <strings.h>

static bool is_token(const char *p, const char *end, const char *text)
{
    size_t n = strlen(text);
    return (size_t)(end - p) == n && strncasecmp(p, text, n) == 0;
}

const char *import_odd_double(const char *p, const char *end, double *out)
{
    const char *stop = import_token_end(p, end);
    const char *q = p;
    bool negative = q < stop && *q == '-';
    if (q < stop && (*q == '-' || *q == '+')) q++;
    double v;
    if (is_token(q, stop, "nan") || is_token(q, stop, "1.#QNAN") || is_token(q, stop, "1.#IND") || is_token(q, stop, "nan(ind)")) {
        v = NAN;
    } else if (is_token(q, stop, "inf") || is_token(q, stop, "infinity") || is_token(q, stop, "1.#INF")) {
        v = INFINITY;
    } else {
        /* Where does the first digit that counts stand? It decides between overflow and underflow. */
        int64_t magnitude = 0, exponent = 0;
        bool seen = false, point = false, any = false;
        const char *s = q;
        for (; s < stop && (import_digit(*s) || *s == '.'); s++) {
            if (*s == '.') {
                if (point) return NULL;
                point = true;
                continue;
            }
            any = true;
            seen = seen || *s != '0';
            if (!point && seen) magnitude++;
            if (point && !seen) magnitude--;
        }
        if (!any) return NULL;
        if (s < stop) {
            if (*s != 'e' && *s != 'E') return NULL;
            const char *e = s + 1;
            bool minus = e < stop && *e == '-';
            if (e < stop && (*e == '-' || *e == '+')) e++;
            if (e == stop) return NULL;
            for (; e < stop; e++) {
                if (!import_digit(*e)) return NULL;
                if (exponent < 1000000000) exponent = exponent * 10 + (*e - '0');
            }
            if (minus) exponent = -exponent;
        }
        if (!import_number_slow(q, stop, seen && magnitude + exponent > 0, &v)) return NULL;
    }
    *out = negative ? -v : v;
    return stop;
}

const char *import_word(const char *p, const char *end, const char *word)
{
    size_t n = strlen(word);
    if ((size_t)(end - p) < n || memcmp(p, word, n) != 0) return NULL;
    p += n;
    return p == end || import_space(*p) ? p : NULL;
}

const char *import_word_nocase(const char *p, const char *end, const char *word)
{
    size_t n = strlen(word);
    if ((size_t)(end - p) < n || strncasecmp(p, word, n) != 0) return NULL;
    p += n;
    return p == end || import_space(*p) ? p : NULL;
}

int import_numbers(const char *text, double *out, int most)
{
    for (int n = 0;;) {
        text += strspn(text, " \t,()");
        if (*text == 0) return n;
        size_t length = strcspn(text, " \t,()");
        if (n == most || !import_number_slow(text, text + length, false, &out[n]) || !isfinite(out[n])) return -1;
        text += length;
        n++;
    }
}
