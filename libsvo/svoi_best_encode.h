/* Internal to libsvo: parts of the writer of layout 3 (svoi_best.h). Not installed. */
#ifndef SVOI_BEST_ENCODE_H
#define SVOI_BEST_ENCODE_H

#include "svoi_best.h"

/* A brick, and the one before it in its block (the number of bricks where it is the first). */
typedef struct svoi_brick_pair { uint32_t before, brick; } svoi_brick_pair;

/* Divide the bricks into classes 1 .. classes - 2. class_of[i] == classes - 1 stays: such bricks are in no class. False: out
 * of memory. */
bool svoi_best_classes(const svo_allocator *a, const svoi_symlevel *bricks, const svoi_brick_pair *pair, uint64_t pairs, uint32_t classes,
                       uint8_t *class_of);

/* Where the bits of a stream went. */
typedef struct svoi_best_stats {
    uint64_t bits[SVOI_CONTEXT_KINDS + 1]; /* symbols by context; the last one: numbers of bricks */
    uint64_t heads;                        /* of nodes above the blocks, with: */
    uint64_t skips, counts, references;
} svoi_best_stats;

/* The chunks of the layout. */
typedef struct svoi_best_parts {
    svo_buffer stream, levels, codes, dictionary;
} svoi_best_parts;
void svoi_best_parts_free(svoi_best_parts *p);

/* Needs brick_level >= 1. `classes`: 3 (all bricks in one class) .. SVOI_CLASSES. `numbered`: attributes are indexed, sizes of subtrees are written. stats may be NULL.
 * SVO_OUT_OF_MEMORY without a message. */
enum { SVOI_BEST_CLASSES = 24 };
svo_result svoi_best_encode(const svoi_symdag *d, bool numbered, uint32_t classes, const svo_allocator *a, svoi_best_parts *out, svoi_best_stats *stats);

/* Widths of the four tiers of references that take the fewest bits in all; uses[w]: references whose place has w bits. */
void svoi_best_choose_tiers(const uint64_t uses[65], uint8_t tier[SVOI_TIERS]);
/* Tier of a reference to `place`: the first with enough bits. */
uint32_t svoi_best_tier_of(const uint8_t tier[SVOI_TIERS], uint64_t place);
/* Lengths of the codes of one context, as in the chunk CODE. */
void svoi_best_write_lengths(svoi_bit_writer *w, const uint8_t *length, uint32_t n);

#endif
