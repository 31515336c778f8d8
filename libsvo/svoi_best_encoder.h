/* Internal to libsvo: the state of the writer of layout 3. Not installed. */
#ifndef SVOI_BEST_ENCODER_H
#define SVOI_BEST_ENCODER_H

#include "svoi_best_encode.h"

typedef enum svoi_best_pass { PASS_COUNT, PASS_SIZE, PASS_WRITE } svoi_best_pass;

typedef struct svoi_best_encoder {
    const svo_allocator *a;
    const svoi_symdag *d;
    uint32_t block_level, classes;
    bool numbered, solid;
    svoi_corners corners;
    svoi_contexts contexts;
    /* of each stored node of levels 0 .. block_level */
    uint8_t *frame[SVO_MAX_DEPTH]; /* turn from the stored node to the frame it is written in */
    uint64_t *bits[SVO_MAX_DEPTH]; /* size of what is written for it, without its mask */
    uint64_t *place[SVO_MAX_DEPTH]; /* byte of a shared node in its pool */
    uint64_t pool_bytes[SVO_MAX_DEPTH], shared[SVO_MAX_DEPTH];
    uint32_t *order[SVO_MAX_DEPTH]; /* shared nodes of a level as they lie in its pool */
    uint8_t tier[SVO_MAX_DEPTH][SVOI_TIERS];
    /* of each brick */
    uint8_t *class_of;
    uint32_t *id; /* in its class */
    uint32_t class_count[SVOI_CLASSES], class_first[SVOI_CLASSES];
    uint32_t *dictionary; /* numbers of bricks */
    uint64_t dictionary_count;
    uint8_t *id_length; /* by place in the dictionary */
    uint32_t *id_code;
    /* codes */
    svoi_best_pass pass;
    uint64_t (*weight)[SVOI_HUFFMAN_SYMBOLS];
    uint8_t (*length)[SVOI_HUFFMAN_SYMBOLS];
    uint32_t (*code)[SVOI_HUFFMAN_SYMBOLS];
    uint8_t (*turn_cost)[SVOI_TURNS]; /* of turn contexts, to choose among turns that mean the same */
    bool costs;
    uint64_t size; /* PASS_SIZE */
    svoi_bit_writer out;
    svoi_best_stats stats;
} svoi_best_encoder;

/* svo_best_dictionary.c; false: out of memory. The bricks of each class in order, most used first; the codes of their numbers. */
bool svoi_best_make_dictionary(svoi_best_encoder *e);
bool svoi_best_make_id_codes(svoi_best_encoder *e);

#endif
