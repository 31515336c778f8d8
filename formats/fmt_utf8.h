/* UTF-8 as files must hold it. */
#ifndef FMT_UTF8_H
#define FMT_UTF8_H

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Bytes of the well-formed character at `text`, of which `size` >= 1 bytes may be read; 0 if there is none. */
uint64_t fmt_utf8_character(const char *text, uint64_t size);

/* Well-formed UTF-8 (Unicode table 3-7: no overlong forms, no surrogates, nothing above U+10FFFF)? NUL bytes count as
 * characters like others. */
bool fmt_utf8_valid(const char *text, uint64_t size);

/* Replace every byte that is not part of well-formed UTF-8 by '?', in place. */
void fmt_utf8_repair(char *text);

#ifdef __cplusplus
}
#endif
#endif
