/* Hash of a NUL-terminated string, for tables in memory. */
#ifndef SVO_TEXT_H
#define SVO_TEXT_H

#include <stdint.h>

/* FNV-1a with a final mix, so that low bits can select a slot. *size (may not be NULL) = bytes without the NUL. */
static inline uint64_t svo_text_hash(const char *text, uint64_t *size)
{
    uint64_t hash = 14695981039346656037u, n = 0;
    for (; text[n] != 0; n++) hash = (hash ^ (uint8_t)text[n]) * 1099511628211u;
    *size = n;
    hash ^= hash >> 32;
    hash *= 0x9e3779b97f4a7c15u;
    return hash ^ hash >> 29;
}

#endif
