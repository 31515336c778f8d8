/* Internal to libsvo: making layout 2 ("fast"). svo_layout_fast.c has pools and the writing of nodes, svo_layout_fast_bricks.c what is below: the dictionary of
 * bricks, turns and codes of blocks. Not installed. */
#ifndef SVOI_LAYOUT_FAST_H
#define SVOI_LAYOUT_FAST_H

#include "svoi_fast.h"

enum { SVOI_FAST_INSIDE = UINT32_MAX, SVOI_FAST_TURN_BITS = 6, SVOI_FAST_PADDING = 8 };

typedef struct svoi_fast_writer {
    svo_packed *p;
    const svo_allocator *a;
    svoi_symdag *d;
    svo_view_fast *f;
    uint32_t bottom; /* level of the bricks */
    bool numbered, full;
    /* bricks */
    uint32_t *rank;  /* number in the dictionary, or SVOI_FAST_INSIDE */
    uint32_t dictionary;
    uint64_t (*coset)[SVOI_TURNS]; /* [subgroup][turn]: the turns that mean the same */
    uint8_t order[SVOI_TURNS];     /* place of a change of turn in f->turn */
    /* blocks: the level above */
    uint8_t *block_turn; /* turns the block's bricks to the block, all of them together */
    uint8_t *change;     /* parallel to items: what is left for this brick, as an index of f->turn */
    uint16_t *block_bits;
    /* levels above the blocks */
    uint64_t *bits[SVO_MAX_DEPTH];
    uint32_t *place[SVO_MAX_DEPTH]; /* in the pool, in bytes, or SVOI_FAST_INSIDE */
    uint32_t *pool[SVO_MAX_DEPTH];  /* numbers in order */
    uint8_t *tree;
} svoi_fast_writer;

static inline uint32_t svoi_fast_bits_for(uint64_t count) { return count < 2 ? 0 : 64 - (uint32_t)__builtin_clzll(count - 1); }
static inline uint32_t svoi_fast_length(uint64_t value) { return value == 0 ? 0 : 64 - (uint32_t)__builtin_clzll(value); }

/* Numbers of the chosen ones, the most used first, then by number; chosen: SVOI_FAST_INSIDE where it is not. False: out of memory. */
bool svoi_fast_sort(const svo_allocator *a, const uint32_t *uses, uint64_t count, const uint32_t *chosen, uint32_t *out);
/* The dictionary: bricks with several uses. */
svo_result svoi_fast_dictionary(svoi_fast_writer *w, svo_error *err);
/* Turns, changes, codes and sizes of the blocks. */
svo_result svoi_fast_blocks(svoi_fast_writer *w, uint32_t threads, svo_error *err);
/* Tag of a brick's code in a block of this mode. */
uint32_t svoi_fast_tag(const svoi_fast_writer *w, uint32_t mode, uint32_t rank, uint32_t change);
/* The mode in which a block takes fewer bits; *bits of its codes. */
uint32_t svoi_fast_mode(const svoi_fast_writer *w, uint64_t number, uint64_t *bits);

#endif
