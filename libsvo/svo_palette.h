/* Palette blocks: a channel's values as short indices, read at random in constant time (Dado et al. 2016, section
 * 2.4.2, with another partition). docs/format/svdag.md, "Palette blocks", is normative.
 *
 * Values are indices into a table. They are cut into superblocks of 1024, each of which is cut into blocks that begin
 * at multiples of 16. A 64-bit map marks the begins, so that the block of a value is found by counting bits, not by
 * searching. A block is constant, or has a palette of table indices and 1 to 6 bits a value, or is table indices as
 * they are. The encoder merges blocks of 16 bottom-up wherever that takes fewer bits, exactly counted. */
#ifndef SVO_PALETTE_H
#define SVO_PALETTE_H

#include <string.h>

#include "svo_alloc.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_SUPERBLOCK 1024u
#define SVO_GRANULE 16u
#define SVO_PALETTE_CONSTANT ((uint64_t)1 << 63) /* of a directory entry: low 32 bits are the index of all values */
#define SVO_PALETTE_PADDING 8u                   /* zero bytes at the end of the payload, so that 8-byte loads stay inside */

/* Bits of a table index: ceil(log2(table_count)). */
static inline uint32_t svo_palette_table_bits(uint64_t table_count)
{
    return table_count > 1 ? 64 - (uint32_t)__builtin_clzll(table_count - 1) : 0;
}

/* `width` (0..32) bits from bit `bit` of p on, lowest first. Reads 8 bytes. */
static inline uint32_t svo_palette_bits(const uint8_t *p, uint64_t bit, uint32_t width)
{
    uint64_t v;
    memcpy(&v, p + bit / 8, sizeof v);
    return (uint32_t)(v >> bit % 8 & (((uint64_t)1 << width) - 1));
}

/* Table index of value i. The arrays must have been checked (svo_palette_check). */
static inline uint32_t svo_palette_index(const uint64_t *directory, const uint8_t *payload, uint32_t table_bits, uint64_t i)
{
    uint64_t entry = directory[i / SVO_SUPERBLOCK], map;
    if (entry & SVO_PALETTE_CONSTANT) return (uint32_t)entry;
    const uint8_t *s = payload + entry;
    memcpy(&map, s, sizeof map);
    uint32_t granule = (uint32_t)(i / SVO_GRANULE) & 63;
    uint64_t upto = ~(uint64_t)0 >> (63 - granule), below = map & upto, above = map & ~upto;
    uint32_t block = (uint32_t)__builtin_popcountll(below) - 1, begin = 63 - (uint32_t)__builtin_clzll(below);
    uint16_t header;
    memcpy(&header, s + 8 + 2 * block, sizeof header);
    const uint8_t *data = s + (header >> 3);
    uint32_t mode = header & 7;
    if (mode == 0) return svo_palette_bits(data, 0, table_bits);
    uint32_t at = (uint32_t)(i % SVO_SUPERBLOCK) - begin * SVO_GRANULE;
    if (mode == 7) return svo_palette_bits(data, (uint64_t)at * table_bits, table_bits);
    uint32_t end = above != 0 ? (uint32_t)__builtin_ctzll(above) : 64;
    uint64_t palette = (uint64_t)(end - begin) * SVO_GRANULE * mode;
    return svo_palette_bits(data, palette + (uint64_t)svo_palette_bits(data, (uint64_t)at * mode, mode) * table_bits, table_bits);
}

/* Give `n` table indices beginning at value `first` (a multiple of 1024; n is 1024 but at the end). */
typedef void (*svo_palette_source)(void *user, uint64_t first, uint32_t n, uint32_t *indices);

typedef struct svo_palette_stats {
    uint64_t constant_superblocks;
    uint64_t blocks[8]; /* by mode */
} svo_palette_stats;

/* Encode `count` values; directory and payload are appended to (payload with its padding). The source is called from
 * several threads for different ranges. The bytes do not depend on the number of threads. stats may be NULL. */
svo_result svo_palette_encode(uint64_t count, uint64_t table_count, svo_palette_source source, void *user, uint32_t threads,
                              svo_buffer *directory, svo_buffer *payload, svo_palette_stats *stats, svo_error *err);

/* Prove that svo_palette_index is safe and < table_count for all values < count. Linear time. */
svo_result svo_palette_check(uint64_t count, uint64_t table_count, const uint64_t *directory, uint64_t superblocks,
                             const uint8_t *payload, uint64_t payload_size, svo_palette_stats *stats, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
