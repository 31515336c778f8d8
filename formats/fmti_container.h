/* Shared by the container's reader, stream reader and writer. Not installed. */
#ifndef FMTI_CONTAINER_H
#define FMTI_CONTAINER_H

#define XXH_STATIC_LINKING_ONLY /* states as members; xxhash 0.8 froze their layout */
#include <xxhash.h>

#include "fmt_container.h"

enum { FMTI_BLOCK = 64, FMTI_HEADER_HASHED = 56, FMTI_FOOTER_HASHED = 48 };

extern const uint8_t fmti_signature[8], fmti_end_mark[8];

/* The file header; checks CON-01..03. base: offset for messages. */
svo_result fmti_parse_header(const uint8_t *bytes, fmt_kind *kind, uint16_t *major, uint16_t *minor, svo_error *err);
/* A chunk header at `offset`; checks its hash (CON-06), zero fields (CON-03) and sizes (CON-08). */
svo_result fmti_parse_chunk(const uint8_t *bytes, uint64_t offset, fmt_chunk *chunk, svo_error *err);
void fmti_store_chunk(const fmt_chunk *chunk, uint8_t *bytes);

typedef struct fmti_footer { uint64_t table_offset, chunk_count, file_size; uint8_t content_hash[16]; } fmti_footer;
/* Checks hash, mark, zero fields (CON-03, CON-04). `offset` is the footer's. */
svo_result fmti_parse_footer(const uint8_t *bytes, uint64_t offset, fmti_footer *footer, svo_error *err);

/* Bytes of zero padding after a payload of this size. */
static inline uint64_t fmti_padding(uint64_t size) { return (FMTI_BLOCK - size % FMTI_BLOCK) % FMTI_BLOCK; }
static inline bool fmti_in_content_hash(uint32_t type) { return type != FMT_TYPE_META && type != FMT_TYPE_TABLE; }

/* Content hash, built chunk by chunk. */
static inline void fmti_content_add(XXH3_state_t *s, const fmt_chunk *c)
{
    uint8_t bytes[8];
    fmt_store64(bytes, c->hash);
    if (fmti_in_content_hash(c->type)) XXH3_128bits_update(s, bytes, 8);
}
static inline void fmti_content_get(const XXH3_state_t *s, uint8_t out[16])
{
    XXH128_canonical_t c;
    XXH128_canonicalFromHash(&c, XXH3_128bits_digest(s));
    for (int i = 0; i < 16; i++) out[i] = c.digest[i];
}

#endif
