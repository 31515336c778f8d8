/* Child masks of one subtree under a context model and a range coder; docs/format/masks.md is normative. Not installed.
 * The decoder repeats the encoder's arithmetic step by step, so there is only integer arithmetic in the model. */
#ifndef FMTI_SVO_MASKS_H
#define FMTI_SVO_MASKS_H

#include "svo_alloc.h"

/* Working memory (2.7 MB for each call that runs at the same time), kept for the next call. Functions on one pool may run
 * in several threads. */
typedef struct fmti_masks_pool fmti_masks_pool;
svo_result fmti_masks_pool_new(const svo_allocator *a, fmti_masks_pool **out, svo_error *err);
void fmti_masks_pool_free(fmti_masks_pool *p);

/* Append the coded masks of a subtree of `levels` levels of inner nodes (1..7) to *to. The masks must have passed
 * svo_chunk_check. SVO_OUT_OF_MEMORY. */
svo_result fmti_masks_encode(fmti_masks_pool *p, uint32_t levels, const uint8_t *masks, uint64_t count, svo_buffer *to, svo_error *err);
/* Decode exactly `count` masks to `masks`. SVO_INVALID_DATA when the bytes hold more, fewer or end too early; what was
 * decoded may still be no good (values are not counted here). Time is linear in `count`. */
svo_result fmti_masks_decode(fmti_masks_pool *p, uint32_t levels, const uint8_t *bytes, uint64_t size, uint8_t *masks, uint64_t count, svo_error *err);

/* --- shared by the coder and the making of what it starts from --- */

enum {
    FMTI_MASKS_LEVELS = 7,
    FMTI_MASKS_MODELS = 4,
    FMTI_MASKS_SLOTS = 1 << 16,  /* a model */
    FMTI_MASKS_SETS = 4 * 8 * 16 /* of weights: distance to the finest level, octant, how many near neighbours exist */
};

/* Nodes of one level as bits: rows of x in 24 bytes, the first of which is padding, two rows and two layers of padding around. */
enum { FMTI_GRID_STRIDE = 24, FMTI_GRID_PAD = 2, FMTI_GRID_PAD_BITS = 8 };
typedef struct fmti_grid {
    uint8_t *bits;
    uint32_t size; /* nodes an axis */
} fmti_grid;
static inline size_t fmti_grid_bytes(uint32_t size)
{
    size_t n = size + 2 * FMTI_GRID_PAD;
    return n * n * FMTI_GRID_STRIDE + 16; /* windows are loaded as four bytes */
}
static inline uint8_t *fmti_grid_row(const fmti_grid *g, int32_t y, int32_t z)
{
    size_t n = g->size + 2 * FMTI_GRID_PAD;
    return g->bits + ((size_t)(z + FMTI_GRID_PAD) * n + (size_t)(y + FMTI_GRID_PAD)) * FMTI_GRID_STRIDE;
}
static inline void fmti_grid_set(const fmti_grid *g, uint32_t x, uint32_t y, uint32_t z)
{
    fmti_grid_row(g, (int32_t)y, (int32_t)z)[(x + FMTI_GRID_PAD_BITS) >> 3] |= (uint8_t)(1u << (x & 7));
}

/* A slot: probability of 1 (18 bits), times seen (6 bits), tag of its context (8 bits). */
typedef struct fmti_masks_model {
    uint32_t slot[FMTI_MASKS_MODELS][FMTI_MASKS_SLOTS];
    int32_t weight[FMTI_MASKS_SETS][FMTI_MASKS_MODELS]; /* 16 bits of fraction */
} fmti_masks_model;

/* What every subtree starts from: learnt from drawn shapes, once a process. */
const fmti_masks_model *fmti_masks_prior(void);
/* Let a model learn one subtree (level 0 .. levels in the grids), as coding it would. */
void fmti_masks_learn(fmti_masks_model *m, const fmti_grid *nodes, uint32_t levels);

#endif
