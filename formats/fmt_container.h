/* The container that all our files share; docs/format/container.md is normative. */
#ifndef FMT_CONTAINER_H
#define FMT_CONTAINER_H

#include "fmt_file.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FMT_FOURCC(a, b, c, d) ((uint32_t)(uint8_t)(a) | (uint32_t)(uint8_t)(b) << 8 | (uint32_t)(uint8_t)(c) << 16 | (uint32_t)(uint8_t)(d) << 24)

typedef enum fmt_kind {
    FMT_KIND_SVO = FMT_FOURCC('S', 'V', 'O', ' '),
    FMT_KIND_SVDAG = FMT_FOURCC('S', 'V', 'D', 'G'),
    FMT_KIND_SKEL = FMT_FOURCC('S', 'K', 'E', 'L'),
    FMT_KIND_SCENE = FMT_FOURCC('S', 'C', 'N', 'E')
} fmt_kind;

/* The kind that the first bytes of a file (20 are enough) claim: a fmt_kind or a number that is none of them, such as
 * UINT32_MAX where the file ends before it. 0 when they are not those of a container: no mesh or image begins as ours do. */
uint32_t fmt_container_kind(const uint8_t *data, uint64_t size);

enum {
    FMT_CHUNK_CRITICAL = 1,     /* a reader that does not know the type must refuse the file */
    FMT_CODEC_NONE = 0,
    FMT_CODEC_ZSTD = 1,
    FMT_CODEC_PACKED = 2        /* as the chunk's type says */
};

/* One chunk as its header and the table describe it. */
typedef struct fmt_chunk {
    uint32_t type;
    uint16_t flags, codec;
    uint64_t offset;       /* of the payload in the file, 64-byte aligned */
    uint64_t stored_size;  /* bytes in the file */
    uint64_t decoded_size; /* after the codec */
    uint64_t element_count;
    uint32_t element_stride;
    uint64_t id;   /* meaning depends on type: Morton code, level, channel ... */
    uint64_t hash; /* XXH3-64 of the stored bytes */
} fmt_chunk;

/* Four printable characters and a NUL. */
void fmt_fourcc_text(uint32_t type, char out[5]);

/* SVO_UNSUPPORTED, naming the chunk, when it is critical and its type is not among `types` (CON-09). */
svo_result fmt_chunk_known(const fmt_chunk *chunk, const uint32_t *types, size_t count, svo_error *err);
/* Is this an optional chunk of unknown type, to be skipped? */
static inline bool fmt_chunk_skip(const fmt_chunk *chunk, const uint32_t *types, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (types[i] == chunk->type) return false;
    return (chunk->flags & FMT_CHUNK_CRITICAL) == 0;
}

/* An error about a place in a file: "chunk TREE at byte 4096: what (CON-07)"; sets chunk, offset. Returns code. */
svo_result fmt_chunk_fail(svo_error *err, svo_result code, uint32_t type, uint64_t offset, const char *format, ...) SVO_PRINTF(5, 6);

#define FMT_TYPE_META FMT_FOURCC('M', 'E', 'T', 'A')
#define FMT_TYPE_TABLE FMT_FOURCC('T', 'A', 'B', 'L')
/* Longest META text that readers take, bytes. */
#define FMT_META_MAX ((uint64_t)1 << 24)

/* --- writing: strictly sequential, so pipes get the same bytes as files --- */
typedef struct fmt_writer fmt_writer;
/* Write the header of a file of `kind` to `out`, which is borrowed and must outlive *writer. SVO_IO or
 * SVO_OUT_OF_MEMORY. End with fmt_writer_end or fmt_writer_discard; one thread at a time. */
svo_result fmt_writer_begin(fmt_output *out, fmt_kind kind, uint16_t major, uint16_t minor, fmt_writer **writer, svo_error *err);
/* Fills offset and hash of *chunk and writes header and payload. `stored` are the bytes as they go into the file,
 * already compressed if codec says so. type, flags, codec, stored_size, decoded_size, element_*, id are the caller's. */
svo_result fmt_writer_chunk(fmt_writer *w, fmt_chunk *chunk, const void *stored, svo_error *err);
/* A META chunk with this JSON text; nothing when it is NULL or empty. SVO_INVALID_ARGUMENT when it is not a JSON object. */
svo_result fmt_writer_meta(fmt_writer *w, const char *json, svo_error *err);
/* Table and footer. The output itself is committed by the caller. Frees the writer in any case. */
svo_result fmt_writer_end(fmt_writer *w, svo_error *err);
void fmt_writer_discard(fmt_writer *w);

/* --- reading a mapped file --- */
typedef struct fmt_container {
    const uint8_t *data;
    uint64_t size;
    fmt_kind kind;
    uint16_t major, minor;
    uint32_t chunk_count;
    fmt_chunk *chunks; /* in file order */
    const svo_allocator *allocator;
    uint8_t content_hash[16];
} fmt_container;
/* Checks header, footer, table, every chunk header against the table, alignment, overlap, gaps. Payload hashes are
 * checked by fmt_container_payload. `data` must stay alive and be 64-byte aligned. */
svo_result fmt_container_open(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_container *out, svo_error *err);
void fmt_container_close(fmt_container *c);
/* First chunk of a type (and id, if any_id is false), NULL if none. */
const fmt_chunk *fmt_container_find(const fmt_container *c, uint32_t type, bool any_id, uint64_t id);
/* Checks the hash of a stored chunk (codec NONE) and returns its bytes in place; SVO_INVALID_DATA on a mismatch. */
svo_result fmt_container_payload(const fmt_container *c, const fmt_chunk *chunk, const uint8_t **bytes, svo_error *err);
/* The same with any codec: the bytes are as stored, stored_size of them. */
svo_result fmt_container_stored(const fmt_container *c, const fmt_chunk *chunk, const uint8_t **bytes, svo_error *err);

/* Bytes by type of chunk, in order of first appearance, the table included; types beyond `capacity` are summed in the
 * last one, with type 0. The `bytes` sum to the file's size less 128 (header and footer). Returns how many. */
typedef struct fmt_section {
    uint32_t type;
    uint64_t chunks, bytes /* with headers and padding */, payload, decoded;
} fmt_section;
uint32_t fmt_container_sections(const fmt_container *c, fmt_section *out, uint32_t capacity);

/* The text of the META chunk, NUL-terminated ("" when there is none), checked (CON-12). Freed with fmt_meta_free. */
svo_result fmt_container_meta(const fmt_container *c, const svo_allocator *a, char **text, svo_error *err);
void fmt_meta_free(const svo_allocator *a, char *text);
/* Check a META payload (CON-12) and copy it to a NUL-terminated text. */
svo_result fmt_meta_text(const fmt_chunk *chunk, const uint8_t *bytes, uint64_t size, const svo_allocator *a, char **text, svo_error *err);

/* --- reading a stream (a pipe, or a file too large to map) --- */
typedef struct fmt_stream fmt_stream;
svo_result fmt_stream_open(fmt_input *in, const svo_allocator *a, fmt_stream **out, fmt_kind *kind, uint16_t *major, svo_error *err);
/* Next chunk header; *more false after the table and footer have been read and agree with what was seen. */
svo_result fmt_stream_next(fmt_stream *s, fmt_chunk *chunk, bool *more, svo_error *err);
/* Its payload (exactly once after next, or it is skipped but still hashed); hash checked; replaces *to. The size is
 * believed only as far as bytes really arrive. */
svo_result fmt_stream_payload(fmt_stream *s, const fmt_chunk *chunk, svo_buffer *to, svo_error *err);
/* After next has said that there is no more: the footer's content hash. */
void fmt_stream_content_hash(const fmt_stream *s, uint8_t out[16]);
void fmt_stream_close(fmt_stream *s);

/* zstd, for chunk payloads. A pool keeps contexts for reuse by any thread. Decoding demands one frame that holds
 * exactly decoded_size bytes, replaces *to and never allocates more; encoding is deterministic for a level and
 * replaces *to. pool may be NULL (a context is made for the call). */
typedef struct fmt_zstd_pool fmt_zstd_pool;
svo_result fmt_zstd_pool_new(fmt_zstd_pool **out, svo_error *err);
void fmt_zstd_pool_free(fmt_zstd_pool *p);
svo_result fmt_zstd_encode(fmt_zstd_pool *p, const void *bytes, size_t size, int level, svo_buffer *to, svo_error *err);
svo_result fmt_zstd_decode(fmt_zstd_pool *p, const void *stored, size_t stored_size, uint64_t decoded_size, svo_buffer *to, svo_error *err);
/* The same to a place with room for decoded_size bytes. */
svo_result fmt_zstd_decode_to(fmt_zstd_pool *p, const void *stored, size_t stored_size, void *to, uint64_t decoded_size, svo_error *err);

/* Encoding to a place with room for `capacity` bytes: how many were written, 0 where they do not fit or memory is missing. */
size_t fmt_zstd_encode_to(fmt_zstd_pool *p, const void *bytes, size_t size, int level, void *to, size_t capacity);

/* Explicit little-endian loads and stores. */
static inline uint16_t fmt_load16(const uint8_t *p) { return (uint16_t)(p[0] | p[1] << 8); }
static inline uint32_t fmt_load32(const uint8_t *p) { return (uint32_t)fmt_load16(p) | (uint32_t)fmt_load16(p + 2) << 16; }
static inline uint64_t fmt_load64(const uint8_t *p) { return (uint64_t)fmt_load32(p) | (uint64_t)fmt_load32(p + 4) << 32; }
static inline void fmt_store16(uint8_t *p, uint16_t v) { p[0] = (uint8_t)v; p[1] = (uint8_t)(v >> 8); }
static inline void fmt_store32(uint8_t *p, uint32_t v) { fmt_store16(p, (uint16_t)v); fmt_store16(p + 2, (uint16_t)(v >> 16)); }
static inline void fmt_store64(uint8_t *p, uint64_t v) { fmt_store32(p, (uint32_t)v); fmt_store32(p + 4, (uint32_t)(v >> 32)); }

/* A bounds-checked cursor with a sticky `ok`: after a failed load everything reads as 0. */
typedef struct fmt_cursor { const uint8_t *data; uint64_t size, at; bool ok; } fmt_cursor;
static inline fmt_cursor fmt_cursor_make(const void *data, uint64_t size) { fmt_cursor c = {(const uint8_t *)data, size, 0, true}; return c; }
const uint8_t *fmt_cursor_take(fmt_cursor *c, uint64_t size); /* NULL when it does not fit */
uint8_t fmt_cursor_u8(fmt_cursor *c);
uint16_t fmt_cursor_u16(fmt_cursor *c);
uint32_t fmt_cursor_u32(fmt_cursor *c);
uint64_t fmt_cursor_u64(fmt_cursor *c);
double fmt_cursor_f64(fmt_cursor *c);

#ifdef __cplusplus
}
#endif
#endif
