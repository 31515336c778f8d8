/* Internal: the state of choosing blocks within a bound, for one worker. Not installed. */
#ifndef SVOI_LOSSY_H
#define SVOI_LOSSY_H

#include "svoi_points.h"

enum { SVOI_SEEN = 2048, SVOI_LOSSY_ENTRIES = 64, SVOI_NONE = 31 /* no mode */ };

/* A different value of the block. */
typedef struct svoi_item {
    svoi_point p;
    svoi_weights w;
    float count; /* times it occurs in the block */
    uint32_t id; /* of the superblock's different values */
} svoi_item;

/* The best way found to store a dyadic range. */
typedef struct svoi_node {
    float cost; /* bits, the header and the worth of the error included */
    uint32_t mode, entries;
    uint16_t entry[SVOI_LOSSY_ENTRIES];
    svo_lattice lattice;
} svoi_node;

/* What was found out about a value: a pure function of it. */
enum { SVOI_KNOWN_BITS = 11 };
typedef struct svoi_known {
    svoi_point point, check;
    svoi_weights weights, check_weights;
    uint32_t value, own;
    bool own_fits, is;
} svoi_known;

typedef struct svoi_lossy_state {
    const svoi_encoder *e;
    const svoi_points *t;
    uint32_t table_bits;
    /* the superblock */
    const uint32_t *v;
    uint32_t distinct;
    uint16_t id[SVO_SUPERBLOCK]; /* of every value, in the arrays below */
    uint32_t value[SVO_SUPERBLOCK], own[SVO_SUPERBLOCK]; /* own: a table entry that is near */
    bool own_fits[SVO_SUPERBLOCK];                       /* within the bound */
    svoi_point point[SVO_SUPERBLOCK], check[SVO_SUPERBLOCK];
    svoi_weights weights[SVO_SUPERBLOCK], check_weights[SVO_SUPERBLOCK];
    svoi_node node[SVOI_LEVELS][SVOI_GRANULES];
    /* the block looked at */
    uint32_t begin, length, items, runs;
    uint32_t segments; /* no fewer runs hold its values within the bound */
    svoi_item item[SVO_SUPERBLOCK];
    uint16_t run_id[SVO_SUPERBLOCK], run_length[SVO_SUPERBLOCK];
    uint16_t row[SVO_SUPERBLOCK];    /* of a value of the block in `error`; by id */
    uint8_t label[SVO_SUPERBLOCK];   /* palette entry of a value of the block; by id */
    uint32_t mark[SVO_SUPERBLOCK], marks; /* by id: in this block when equal to marks */
    float error[SVO_SUPERBLOCK][SVOI_LOSSY_ENTRIES];
    uint64_t allowed[SVO_SUPERBLOCK]; /* of each item */
    float tail[SVO_SUPERBLOCK + 1];   /* of each run and those behind it: what they add at least to a cost by runs */
    uint64_t changed[SVO_SUPERBLOCK]; /* of each run: bit q set when number q begins there */
    uint8_t before[SVO_SUPERBLOCK];   /* of each run: the number that a change comes from */
    uint32_t stamp;
    struct { uint32_t stamp, key, value; } slot[SVOI_SEEN];
    svoi_near_cache near;
    svoi_known known[1 << SVOI_KNOWN_BITS];
} svoi_lossy_state;

/* Candidates that numbers stand for: palette entries, or points of a line. Component by component, so that one item is
 * measured against many at a time; filled up to a multiple of SVOI_LANES with copies of the first. */
enum { SVOI_LANES = 8 };
typedef struct svoi_candidates {
    uint32_t count;
    float p[4][SVOI_LOSSY_ENTRIES], check[4][SVOI_LOSSY_ENTRIES];
} svoi_candidates;

static inline void svoi_candidate_set(svoi_candidates *c, uint32_t i, const svoi_point *p, const svoi_point *check)
{
    for (int k = 0; k < 4; k++) c->p[k][i] = p->x[k], c->check[k][i] = check->x[k];
}

static inline void svoi_candidates_fill(svoi_candidates *c)
{
    for (uint32_t i = c->count; i % SVOI_LANES != 0; i++)
        for (int k = 0; k < 4; k++) c->p[k][i] = c->p[k][0], c->check[k][i] = c->check[k][0];
}

static inline float svoi_cost(const svoi_points *t, float distance2) { return t->price * (t->squares ? distance2 : __builtin_sqrtf(distance2)); }

static inline uint32_t svoi_whole_bytes(uint32_t bits) { return (bits + 7) & ~7u; }
static inline void svoi_take(svoi_node *n, float cost, uint32_t mode) { n->cost = cost, n->mode = mode, n->entries = 0; }

/* svo_palette_kinds.c, svo_palette_lattice.c: each puts what is better than `n` into it. */
void svoi_try_one(svoi_lossy_state *s, svoi_node *n);
void svoi_try_palettes(svoi_lossy_state *s, svoi_node *n);
void svoi_try_lines(svoi_lossy_state *s, svoi_node *n);
void svoi_try_lattice(svoi_lossy_state *s, svoi_node *n);
void svoi_try_raw(svoi_lossy_state *s, svoi_node *n);

/* Least cost of the block's values by runs of candidates, `width` bits a change; INFINITY when one has no candidate
 * within the bound, or when it is not below `limit`. With `number` not NULL the numbers of all values go there. */
float svoi_runs_cost(svoi_lossy_state *s, const svoi_candidates *c, uint32_t width, float limit, uint32_t *number);
/* The same with a number for each value, each the best for itself; the bits of the numbers are not counted. */
float svoi_plain_cost(svoi_lossy_state *s, const svoi_candidates *c, float limit, uint32_t *number);
/* Of each candidate: bit i of its words is set when it is within the bound of item i. */
void svoi_covered(const svoi_lossy_state *s, const svoi_candidates *c, uint64_t (*covers)[SVO_SUPERBLOCK / 64]);
void svoi_palette_candidates(const svoi_lossy_state *s, const svoi_node *n, svoi_candidates *c);
void svoi_line_candidates(const svoi_lossy_state *s, const svoi_node *n, uint32_t width, svoi_candidates *c);
uint32_t svoi_lattice_number(svo_channel_kind kind, const svo_lattice *l, uint32_t value);

#endif
