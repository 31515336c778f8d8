/* Internal to libsvo: the parts of the DAG builder. Not installed.
 *
 * While building, a node is (mask, references; full leaves have none) where a reference is the NUMBER of a node of the next level, or of a
 * brick; numbers are given in order of first appearance in the octree's depth-first order. The layout of the packed
 * file (word positions, offsets) is made from that at the end, so that other layouts can be made from the same. */
#ifndef SVOI_DAG_H
#define SVOI_DAG_H

#include "svo_dag.h"
#include "svo_spill.h"
#include "svoi_palette.h"

/* --- distinct bricks, distinct nodes of a level ------------------------------------------------------------------ */

typedef struct svoi_bricks {
    const svo_allocator *a;
    uint64_t *bits;
    uint64_t count, capacity;
    uint64_t *slots; /* high half: tag of the hash, low half: number + 1 (0 = empty) */
    uint64_t slot_count;
} svoi_bricks;

typedef struct svoi_nodes {
    const svo_allocator *a;
    uint32_t *items; /* mask (full leaves in bits 8..15), references */
    uint64_t item_count, item_capacity;
    uint32_t *start; /* of a node in items */
    uint64_t start_capacity;
    uint64_t *size; /* attributes of a node's subtree, itself included where it has one */
    uint64_t size_capacity;
    uint64_t count;
    uint64_t *slots;
    uint64_t slot_count;
} svoi_nodes;

/* Number of the brick, new or old. SVO_OUT_OF_MEMORY, or SVO_LIMIT when 32 bits do not suffice. */
svo_result svoi_bricks_insert(svoi_bricks *b, uint64_t bits, uint32_t *number);
void svoi_bricks_free(svoi_bricks *b);
/* Children of a node that are no full leaves, so that it has references to them. */
static inline uint32_t svoi_node_refs(uint32_t mask) { return (uint32_t)__builtin_popcount(mask & 0xff & ~(mask >> 8)); }
/* `mask` has the full leaves among the children in bits 8..15; `size` must follow from mask and refs. */
svo_result svoi_nodes_insert(svoi_nodes *n, uint32_t mask, const uint32_t *refs, uint64_t size, uint32_t *number);
void svoi_nodes_free(svoi_nodes *n);
/* The hash tables are not needed any more. */
void svoi_bricks_seal(svoi_bricks *b);
void svoi_nodes_seal(svoi_nodes *n);

/* Attributes of a brick's subtree. */
static inline uint64_t svoi_brick_size(bool lod, uint64_t bits)
{
    uint64_t n = (uint64_t)__builtin_popcountll(bits);
    return lod ? n + 1 + (uint64_t)__builtin_popcountll(svo_brick_octants(bits)) : n;
}

/* --- averages ---------------------------------------------------------------------------------------------------- */

/* What is known of the finest voxels below a node, exactly: integers, so that no order of summation shows.
 * Colours: linear light * 2^35, which is exact for the 256 float values of svo_srgb_to_linear; normals: components *
 * 2^35, rounded; unorms: the value. 128 bits, so that 2^63 voxels fit. */
__extension__ typedef __int128 svoi_wide;
typedef struct svoi_sum {
    svoi_wide s[3];
    uint64_t n;     /* finest voxels */
    uint32_t first; /* value of the first one (little-endian bytes) */
    bool uniform;   /* all values are equal */
} svoi_sum;

/* Labels below a node, ascending, each with its finest voxels. */
typedef struct svoi_label { uint64_t voxels; uint32_t id; } svoi_label;
typedef struct svoi_labels {
    const svo_allocator *a;
    svoi_label *label;
    uint64_t count, capacity;
} svoi_labels;
bool svoi_labels_merge(svoi_labels *to, const svoi_label *more, uint64_t count); /* false: out of memory */
void svoi_labels_free(svoi_labels *l);

static inline bool svoi_is_label(svo_channel_kind k) { return k == SVO_KIND_ID16 || k == SVO_KIND_ID32; }
void svoi_sum_add(svoi_sum *to, const svoi_sum *s);
/* The average as a value of the kind. */
void svoi_sum_value(const svoi_sum *s, svo_channel_kind kind, uint8_t *out);
void svoi_labels_value(const svoi_label *l, uint64_t count, svo_channel_kind kind, uint8_t *out);

/* One channel of one chunk: all attributes in stored order (svo_dag.h: with `virtual_levels` copies of the root's in
 * front), and the sum or labels of the whole chunk for the levels above. Without lod only the values are copied; averaged: the
 * lowest two levels of inner nodes have no attributes. */
svo_result svoi_chunk_attributes(const svo_chunk *c, uint32_t channel, svo_channel_kind kind, bool lod, bool averaged,
                                 uint32_t virtual_levels, uint8_t *out, svoi_sum *sum, svoi_labels *labels);
/* The average of 1 to 64 values (numbers), as a number. */
void svoi_sum_values(svo_channel_kind kind, const uint32_t *values, uint32_t count, svoi_sum *sum); /* colours, normals, unorms */
uint32_t svoi_average(svo_channel_kind kind, const uint32_t *values, uint32_t count);

/* --- attribute streams ------------------------------------------------------------------------------------------- */

/* What the channels of a builder hold together: beyond `budget` bytes full pages go to files. */
typedef struct svoi_store {
    const svo_spill *spill; /* NULL: everything stays in memory */
    uint64_t budget, resident;
} svoi_store;

/* All values of a channel, in pages, so that growing copies nothing. A page in the file is compressed unit by unit (a superblock each), so that one
 * can be read without the others. */
enum { SVOI_PAGE_BITS = 16, SVOI_PAGE = 1 << SVOI_PAGE_BITS, SVOI_PAGE_UNITS = SVOI_PAGE / SVO_SUPERBLOCK };
typedef struct svoi_page {
    uint8_t *data;   /* NULL: in the file */
    uint64_t offset; /* there */
    uint32_t late;   /* newest of its values that were set since: its number in svoi_values.late + 1, 0: none */
    uint16_t size[SVOI_PAGE_UNITS]; /* of the units in the file; where it is that of the values, they are stored as they are */
} svoi_page;
typedef struct svoi_values {
    const svo_allocator *a;
    uint32_t stride;
    uint64_t count;
    svoi_page *page;
    uint64_t page_count, page_capacity;
    svo_buffer late; /* values that were set when their page was in the file: svo_values.c */
    svoi_store *store;
    svo_spill_file file;
    uint64_t file_bytes; /* atomic: where the next page goes */
    bool any, varies;    /* of the values that were given: is there one, are there two different ones? */
    uint8_t first[4];
} svoi_values;
/* `values` NULL appends zeros, to be replaced by svoi_values_set. SVO_OUT_OF_MEMORY without a message, or an error of the spill. */
svo_result svoi_values_append(svoi_values *v, const uint8_t *values, uint64_t count, svo_error *err);
/* SVO_OUT_OF_MEMORY without a message. */
svo_result svoi_values_set(svoi_values *v, uint64_t i, const uint8_t *value);
/* All pages to the file, if there may be one; nothing can be appended then. */
svo_result svoi_values_spill(svoi_values *v, svo_error *err);
/* `n` values of one page from number `first` on: in place, or read to `buffer` (n * stride bytes). NULL when that fails. Several threads may. */
const uint8_t *svoi_values_get(const svoi_values *v, uint64_t first, uint64_t n, uint8_t *buffer, svo_error *err);
/* Replace all values of a page; what `values` holds is lost. Several threads may, on different pages. */
svo_result svoi_values_put(svoi_values *v, uint64_t page, uint8_t *values, svo_error *err);
/* The page will not be needed again. */
void svoi_values_drop(svoi_values *v, uint64_t page);
void svoi_values_free(svoi_values *v);

static inline uint32_t svoi_load_value(const uint8_t *p, uint32_t stride)
{
    uint32_t v = p[0];
    if (stride > 1) v |= (uint32_t)p[1] << 8;
    if (stride > 2) v |= (uint32_t)p[2] << 16;
    if (stride > 3) v |= (uint32_t)p[3] << 24;
    return v;
}
static inline void svoi_store_value(uint8_t *p, uint32_t stride, uint32_t v)
{
    for (uint32_t i = 0; i < stride; i++) p[i] = (uint8_t)(v >> 8 * i);
}

/* --- distinct values --------------------------------------------------------------------------------------------- */

typedef struct svoi_distinct {
    const svo_allocator *a;
    uint32_t *value;
    uint64_t *times;
    uint64_t count, capacity;
    uint64_t *slots; /* high half: value, low half: index + 1 */
    uint64_t slot_count;
    uint64_t *bit;    /* colours instead: which occur, SVOI_COLORS bits, */
    uint32_t *before; /* and how many do before each 64 of them */
} svoi_distinct;
enum { SVOI_COLORS = 1 << 24 };
bool svoi_distinct_add(svoi_distinct *d, uint32_t value, uint64_t times);
/* Sort by value and renumber. */
bool svoi_distinct_sort(svoi_distinct *d);
/* Index of a value that is in it. */
uint32_t svoi_distinct_index(const svoi_distinct *d, uint32_t value);
void svoi_distinct_free(svoi_distinct *d);
/* Indices will not be asked for any more. */
void svoi_distinct_seal(svoi_distinct *d);
/* All of a stream, sorted; SVO_OUT_OF_MEMORY without a message, or an error of the spill. When there are more than `most`, *many becomes true
 * and *out has none. */
svo_result svoi_values_distinct(const svoi_values *values, uint32_t threads, uint64_t most, svoi_distinct *out, bool *many, svo_error *err);

/* The same for colours, however many: where 24 bits say everything, a bit for each is less than lists of threads that are joined. */
svo_result svoi_colors_distinct(const svoi_values *values, uint32_t threads, svoi_distinct *out, svo_error *err);

/* Indices of colours will be asked for again, after svoi_distinct_seal; false: out of memory. */
bool svoi_colors_reopen(svoi_distinct *d);

/* Every normal to the grid of `bits` (svo_quantize_normal), without a list of what occurs: with `write` in place. The distinct results go to *out as above. */
typedef struct svoi_mapping {
    uint32_t bits;
    bool write, many, lossy;
    double error_sum, error_max; /* degrees; added up in an order that does not depend on threads */
} svoi_mapping;
svo_result svoi_values_map(svoi_values *values, uint32_t threads, uint64_t most, svoi_mapping *m, svoi_distinct *out, svo_error *err);

/* --- the result -------------------------------------------------------------------------------------------------- */

struct svo_packed {
    svo_limit_allocator memory; /* everything below is charged to it; the struct itself comes from its parent */
    uint64_t limit;             /* what was asked for; the allocator's grows with the output */
    svo_view view;
    svo_buffer words[SVO_MAX_DEPTH], tree, bricks, raw[SVO_MAX_CHANNELS], table[SVO_MAX_CHANNELS], directory[SVO_MAX_CHANNELS],
        payload[SVO_MAX_CHANNELS], corrections[SVO_MAX_CHANNELS];
    svo_buffer best_stream, best_levels, best_codes; /* layout best */
};

/* Layout 1 from the tables of levels 0 .. brick_level - 1, which are freed on the way. */
svo_result svoi_layout_plain(svo_packed *p, svoi_nodes *levels, svoi_bricks *bricks, svo_error *err);

/* Layout 3 from the same; needs brick_level >= 1. `mirrors`: no other symmetries. */
svo_result svoi_layout_best(svo_packed *p, svoi_nodes *levels, svoi_bricks *bricks, bool mirrors, uint32_t threads, svo_error *err);

/* Layout 2 ("fast") from the same, on `threads` threads; brick_level must not be 0. */
svo_result svoi_layout_fast(svo_packed *p, svoi_nodes *nodes, svoi_bricks *bricks, uint32_t threads, svo_error *err);

/* Quantise and encode one channel into the packed view; frees the values. */
svo_result svoi_pack_channel(svo_packed *p, uint32_t channel, svoi_values *values, const svo_dag_options *options,
                             svo_dag_channel_report *report, svo_error *err);

/* Averaged views: once the channel's blocks are there, compare the averages of them with those of `values` (exact), add what they differ to the
 * report, and with a bound (> 0) store those that are beyond it. */
svo_result svoi_correct_averages(svo_packed *p, uint32_t channel, const svoi_values *values, double bound, uint32_t threads,
                                 svo_dag_channel_report *report, svo_error *err);

/* What is written does not count against the limit: `bytes` of output are there, and may take half as much again on their way. */
static inline void svoi_allow_output(svo_packed *p, uint64_t bytes) { svoi_limit_raise(&p->memory, bytes + bytes / 2); }

/* SVO_LIMIT when a limit was asked for, else SVO_OUT_OF_MEMORY, with a message. */
svo_result svoi_no_memory(const svo_packed *p, const char *what, svo_error *err);

#endif
