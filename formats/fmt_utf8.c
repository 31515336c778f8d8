#include "fmt_utf8.h"

#include <string.h>

uint64_t fmt_utf8_character(const char *text, uint64_t size)
{
    const unsigned char *p = (const unsigned char *)text;
    unsigned char c = p[0], low = 0x80, high = 0xbf; /* limits of the second byte */
    uint64_t n;
    if (c < 0x80) return 1;
    if (c >= 0xc2 && c <= 0xdf) n = 2;
    else if (c >= 0xe0 && c <= 0xef) {
        n = 3;
        if (c == 0xe0) low = 0xa0;
        if (c == 0xed) high = 0x9f;
    } else if (c >= 0xf0 && c <= 0xf4) {
        n = 4;
        if (c == 0xf0) low = 0x90;
        if (c == 0xf4) high = 0x8f;
    } else return 0;
    if (size < n || p[1] < low || p[1] > high) return 0;
    for (uint64_t i = 2; i < n; i++)
        if (p[i] < 0x80 || p[i] > 0xbf) return 0;
    return n;
}

bool fmt_utf8_valid(const char *text, uint64_t size)
{
    for (uint64_t i = 0; i < size;) {
        uint64_t n = fmt_utf8_character(text + i, size - i);
        if (n == 0) return false;
        i += n;
    }
    return true;
}

void fmt_utf8_repair(char *text)
{
    uint64_t size = strlen(text);
    for (uint64_t i = 0; i < size;) {
        uint64_t n = fmt_utf8_character(text + i, size - i);
        if (n == 0) text[i] = '?', n = 1;
        i += n;
    }
}
