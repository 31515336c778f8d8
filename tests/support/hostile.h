/* Damaged files for readers of our containers: truncations, flips with and without repaired hashes, changed payloads,
 * dropped, doubled and swapped chunks, failing allocations; input ending at an unmapped page, memory limited. */
#ifndef HOSTILE_H
#define HOSTILE_H

#include "fmt_container.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Read the bytes as a tool would and use everything that was read (walk it, decode it), with allocator `a`. Anything
 * but SVO_OK needs a message in *err. Where it answers SVO_OK it must have checked for itself that what it got is
 * sound (counts agree, coordinates lie in the grid ...): it fails the running test where that is not so. `bytes` are
 * 64-byte aligned. */
typedef svo_result (*hostile_reader)(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err);

typedef struct hostile_case {
    hostile_reader read;
    void *user;
    const uint8_t *bytes; /* a good file, which read must accept */
    uint64_t size;
    uint32_t rounds; /* of each kind of damage; 0 = 1500 */
    uint64_t memory; /* limit of the allocator; 0 = 256 MiB. A damaged file must not reach it. */
    uint64_t seed;
} hostile_case;

/* All of the below; fails the running test at the first misbehaviour and says how to repeat it. */
void hostile_run(const hostile_case *c);

void hostile_truncations(const hostile_case *c); /* every length up to 4 KiB files, else a sample; must all be refused */
void hostile_flips(const hostile_case *c);       /* no hash repaired: must all be refused */
void hostile_repaired_flips(const hostile_case *c);
void hostile_payloads(const hostile_case *c); /* changed after decompression, written back with right hashes */
void hostile_orders(const hostile_case *c);   /* chunks dropped, doubled, swapped, retyped */
void hostile_allocations(const hostile_case *c); /* the n-th allocation fails, for every n */

/* A container taken apart, so that a test can change anything and put it together again with right hashes. */
typedef struct hostile_chunk { fmt_chunk chunk; svo_buffer payload; /* decoded */ } hostile_chunk;
typedef struct hostile_file {
    fmt_kind kind;
    uint16_t major, minor;
    uint32_t count;
    hostile_chunk chunks[256];
} hostile_file;
/* The file must be good and have at most 255 chunks. */
void hostile_parse(const uint8_t *bytes, uint64_t size, hostile_file *out);
void hostile_free(hostile_file *f);
/* Sizes of a chunk whose `stored_size` is UINT64_MAX are taken from its payload (and it is compressed if its codec says
 * so); hostile_touch sets that. Other chunks keep their sizes, whatever the payload. */
void hostile_build(const hostile_file *f, svo_buffer *out);
static inline void hostile_touch(hostile_chunk *c) { c->chunk.stored_size = UINT64_MAX; }
hostile_chunk *hostile_find(hostile_file *f, uint32_t type);
void hostile_drop(hostile_file *f, uint32_t index);
void hostile_double(hostile_file *f, uint32_t index);
void hostile_swap(hostile_file *f, uint32_t a, uint32_t b);

/* Recompute all hashes and the table of a file whose chunk headers are where the (good) original has them. */
void hostile_repair(uint8_t *bytes, uint64_t size, const uint8_t *original);

#ifdef __cplusplus
}
#endif
#endif
