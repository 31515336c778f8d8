/* A mutator for images: what is still a row of PNG chunks gets the right checksums, so that the decoder sees the change. */
#include <string.h>

#include "fuzz.h"

static uint32_t crc(const uint8_t *p, size_t n)
{
    uint32_t c = UINT32_MAX;
    for (size_t i = 0; i < n; i++) {
        c ^= p[i];
        for (int k = 0; k < 8; k++) c = (c & 1) != 0 ? c >> 1 ^ 0xedb88320u : c >> 1;
    }
    return ~c;
}

static uint32_t load(const uint8_t *p) { return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3]; }

size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    size_t n = LLVMFuzzerMutate(data, size, max_size);
    if (seed % 16 == 0 || n < 8 || memcmp(data, "\x89PNG\r\n\x1a\n", 8) != 0) return n;
    for (size_t at = 8; n - at >= 12;) {
        uint32_t length = load(data + at);
        if (length > n - at - 12) break;
        uint32_t c = crc(data + at + 4, (size_t)length + 4);
        uint8_t *to = data + at + 8 + length;
        for (int k = 0; k < 4; k++) to[k] = (uint8_t)(c >> (24 - 8 * k));
        at += 12 + (size_t)length;
    }
    return n;
}
