/* Blocks: a channel's values in few bits, read at random in constant time. docs/format/svdag.md, "Palette blocks", is
 * normative; this is what became of Dado et al. 2016, section 2.4.2.
 *
 * Values are cut into superblocks of 1024, each of which is cut into blocks that begin at multiples of 16. A 64-bit map
 * marks the begins, so that the block of a value is found by counting bits, not by searching. A block is one value, or a
 * palette of table entries with 1 to 8 bits a value, or points on a line between two table entries, or points of a
 * lattice (which needs no table, and so can hold anything), or table indices as they are; the numbers that choose among
 * these are stored for each value, or for each change with one bit a value that says where changes are. */
#ifndef SVO_PALETTE_H
#define SVO_PALETTE_H

#include <string.h>

#include "svo_alloc.h"
#include "svo_rules.h"
#include "svo_channel.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_SUPERBLOCK 1024u
#define SVO_GRANULE 16u
#define SVO_PALETTE_ENTRY 12u   /* bytes of a superblock's entry in the directory: u64 map, u32 offset */
#define SVO_PALETTE_GROUP 65536u /* superblocks whose offsets count from one base */
#define SVO_PALETTE_PADDING 8u  /* zero bytes at the end of the payload, so that 8-byte loads stay inside */

/* Numbers in the files. */
enum {
    SVO_BLOCK_ONE = 0,       /* and 1: one table entry, its index in the header (12 bits) */
    SVO_BLOCK_ONE_WIDE = 2,  /* one table entry */
    SVO_BLOCK_RAW = 3,       /* a table index for each value */
    SVO_BLOCK_BOX = 4,       /* lattice points */
    SVO_BLOCK_BOX_RUNS = 5,
    SVO_BLOCK_LINE = 6,      /* + bits - 2: points between two table entries, 2 to 4 bits */
    SVO_BLOCK_LINE_RUNS = 9,
    SVO_BLOCK_PALETTE = 12,  /* + bits - 1: 1 to 8 bits */
    SVO_BLOCK_PALETTE_RUNS = 20, /* + bits - 2: 2 to 8 bits */
    SVO_BLOCK_MODES = 27
};

/* What people call a mode, e.g. "palette 3 bits with runs"; "?" for a number that is none. */
void svo_block_name(uint32_t mode, char *out, size_t size);

/* Blocks as they lie in a file or in memory. Checked with svo_palette_check before anything is read from them. */
typedef struct svo_palette {
    svo_channel_kind kind;
    uint64_t count;          /* values */
    const uint8_t *table;    /* table_count values of the kind */
    uint64_t table_count;    /* may be 0 */
    const uint8_t *directory; /* SVO_PALETTE_ENTRY bytes for each superblock that is there */
    uint64_t superblock_count; /* of them */
    const uint8_t *payload;
    uint64_t payload_size;
    /* NULL: the directory has every superblock. Else SVO_PALETTE_ENTRY bytes for each 64 superblocks: u64, of which a bit is set where one has an
     * entry, and u32 entries before; one without an entry has in all places the last value of the superblock before it. */
    const uint8_t *repeats;
} svo_palette;

/* Superblocks of `count` values, and records of `repeats` for them. */
static inline uint64_t svo_palette_superblocks(uint64_t count) { return count / SVO_SUPERBLOCK + (count % SVO_SUPERBLOCK != 0); }
static inline uint64_t svo_palette_repeat_words(uint64_t count) { return (svo_palette_superblocks(count) + 63) / 64; }

/* Bits of a table index: ceil(log2(table_count)). */
static inline uint32_t svo_palette_table_bits(uint64_t table_count)
{
    return table_count > 1 ? 64 - (uint32_t)__builtin_clzll(table_count - 1) : 0;
}

/* `width` (0..57) bits from bit `bit` of p on, lowest first. Reads 8 bytes. */
static inline uint64_t svo_palette_bits(const uint8_t *p, uint64_t bit, uint32_t width)
{
    uint64_t v;
    memcpy(&v, p + bit / 8, sizeof v);
    return v >> bit % 8 & (((uint64_t)1 << width) - 1);
}

/* Value i (its little-endian bytes as a number). i < count is the caller's duty. */
uint32_t svo_palette_value(const svo_palette *p, uint64_t i);
/* The same for values index[0 .. count), in any order, several at a time so that memory is waited for once. */
void svo_palette_values(const svo_palette *p, const uint64_t *index, uint32_t count, uint32_t *values);

/* Values first .. first + count - 1, each block looked up once. */
void svo_palette_range(const svo_palette *p, uint64_t first, uint32_t count, uint32_t *values);

/* A lattice: `n` steps of `step` from `low` in each component. Colours: Y, Co, Cg of YCoCg-R; normals: the two
 * octahedral coordinates; one component otherwise. */
typedef struct svo_lattice {
    int32_t low[3];
    uint64_t n[3];
    uint32_t step[3];
    uint32_t bits; /* of a point's number: ceil(log2(n0 n1 n2)) */
} svo_lattice;
uint32_t svo_lattice_components(svo_channel_kind kind);
/* Components of a value. */
void svo_lattice_split(svo_channel_kind kind, uint32_t value, int32_t c[3]);
uint32_t svo_lattice_point(svo_channel_kind kind, const svo_lattice *l, uint32_t number);
uint32_t svo_lattice_header_bits(svo_channel_kind kind);

/* Point `number` of 0 .. most on the line from a to b: each component rounded to nearest. */
uint32_t svo_line_point(svo_channel_kind kind, uint32_t a, uint32_t b, uint32_t number, uint32_t most);

/* Give `n` values beginning at value `first` (a multiple of 1024; n is 1024 but at the end). */
typedef void (*svo_palette_source)(void *user, uint64_t first, uint32_t n, uint32_t *values);

/* What the blocks are to be like. Without a bound every value comes back as it is. */
typedef struct svo_palette_goal {
    double bound; /* > 0: largest CIE94 difference (colours; the value is the reference) or angle in degrees (normals) */
    double price; /* bits that one value's error is worth: per unit of CIE94 or degree, or (squares) per squared sRGB byte */
    bool squares; /* colours: the error is the squared difference of sRGB bytes, not CIE94 */
} svo_palette_goal;

typedef struct svo_palette_stats {
    uint64_t blocks[SVO_BLOCK_MODES], values[SVO_BLOCK_MODES], bits[SVO_BLOCK_MODES]; /* by mode; bits without headers */
    double error_sum, error_max, square_sum; /* over all values: CIE94 or degrees; squared differences of bytes (colours) */
} svo_palette_stats;

typedef struct svo_palette_job {
    svo_channel_kind kind;
    uint64_t count;
    svo_palette_source source; /* called from several threads for different ranges */
    void *user;
    const uint32_t *table; /* distinct values; without a bound it must hold every value */
    uint64_t table_count;
    svo_palette_goal goal;
    uint32_t threads;
    const svo_allocator *allocator;
} svo_palette_job;

/* Encode; directory and payload are appended to (payload with its padding; it must be empty). The bytes do not depend on
 * the number of threads. stats may be NULL. */
svo_result svo_palette_encode(const svo_palette_job *job, svo_buffer *directory, svo_buffer *payload, svo_palette_stats *stats,
                              svo_error *err);

/* Prove that svo_palette_value is safe for all values < count. Linear time. Fills the counts of `stats` (may be NULL). */
svo_result svo_palette_check(const svo_palette *p, svo_palette_stats *stats, svo_error *err);
/* The same, but superblocks that break the rule go to `rules` (NULL: as above), and the check goes on with the next one that the directory names. */
svo_result svo_palette_check_all(const svo_palette *p, svo_palette_stats *stats, svo_rules *rules, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
