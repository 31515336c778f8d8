/* Internal to libsvo: Huffman codes of limited length, canonical. Not installed.
 *
 * Codes are given to symbols in the order of (length, symbol), highest bit first. A code in which one symbol occurs has
 * length 0: it takes no bits. */
#ifndef SVOI_HUFFMAN_H
#define SVOI_HUFFMAN_H

#include "svo_alloc.h"

enum {
    SVOI_HUFFMAN_LONGEST = 15,       /* of alphabets with at most 256 symbols */
    SVOI_HUFFMAN_SYMBOLS = 256,
    SVOI_HUFFMAN_UNUSED = 0xff,      /* length of a symbol that does not occur */
};

/* Lengths, at most `limit`, of the code with the least sum of weight * length (nearly the least where the limit matters).
 * Weight 0: SVOI_HUFFMAN_UNUSED. False: out of memory. */
bool svoi_huffman_lengths(const svo_allocator *a, const uint64_t *weight, uint32_t n, uint32_t limit, uint8_t *length);

/* Codes for these lengths. */
void svoi_huffman_codes(const uint8_t *length, uint32_t n, uint32_t *code);

/* To decode with: the code of a symbol is looked up by its first bits in a table of `fast_bits`, whose entries are symbol << 4 |
 * length or SVOI_HUFFMAN_SLOW; then by length. */
enum { SVOI_HUFFMAN_SLOW = 0xffff };
typedef struct svoi_huffman {
    uint32_t below[SVOI_HUFFMAN_LONGEST + 2]; /* 16 bits below this have a code of this length or shorter */
    int32_t rank[SVOI_HUFFMAN_LONGEST + 1];   /* place in `symbol` less the code */
    uint8_t symbol[SVOI_HUFFMAN_SYMBOLS];
} svoi_huffman;

/* False when the lengths are no code that uses all its bits (the last symbol's code all ones), or none is used. */
bool svoi_huffman_decoder(const uint8_t *length, uint32_t n, uint32_t fast_bits, uint16_t *fast, svoi_huffman *h);

/* Symbol << 4 | length from the top 16 bits of a string. */
uint32_t svoi_huffman_slow(const svoi_huffman *h, uint32_t top16);

#endif
