/* Shared by the .svo writer and reader. Not installed. */
#ifndef FMTI_SVO_H
#define FMTI_SVO_H

#include "fmt_svo.h"

#define FMTI_SVO_HEAD FMT_FOURCC('H', 'E', 'A', 'D')
#define FMTI_SVO_TREE FMT_FOURCC('T', 'R', 'E', 'E')
#define FMTI_SVO_FULL FMT_FOURCC('F', 'U', 'L', 'L')
#define FMTI_SVO_STAT FMT_FOURCC('S', 'T', 'A', 'T')

#define FMTI_SVO_GRUP FMT_FOURCC('G', 'R', 'U', 'P')
#define FMTI_SVO_SHRD FMT_FOURCC('S', 'H', 'R', 'D')

enum { FMTI_SVO_SHARD_SIZE = 40, FMTI_FULL_MOST = 4096 /* records of a FULL chunk */, FMTI_SVO_HEAD_FIXED = 144, FMTI_SVO_CHANNEL_RECORD = 32, FMTI_SVO_HEAD_MAX = 144 + 32 * 16 };

/* Channel record of 32 bytes, used by .svo and .svdag. Parsing checks SVO-04 but for equal names. */
void fmti_store_channel(const svo_channel *c, uint8_t *bytes);
/* NULL when it is good, else why not. */
const char *fmti_parse_channel(const uint8_t *bytes, svo_channel *c);
/* SVO-02, SVO-03, SVO-04 on a struct; NULL when it is good, else why not, with the rule. */
const char *fmti_check_info(const svo_tree_info *info);

/* HEAD; to has FMTI_SVO_HEAD_MAX bytes. Returns its size. */
size_t fmti_store_head(const svo_tree_info *info, uint8_t *to);
svo_result fmti_parse_head(const fmt_chunk *chunk, const uint8_t *bytes, uint64_t size, svo_tree_info *info, svo_error *err);

/* Replace what fmt_svo_writer_begin was given. */
svo_result fmti_svo_set_provenance(fmt_svo_writer *w, const char *provenance, svo_error *err);

/* STAT, META (unless provenance is NULL or empty), table and footer. Frees the writer in any case. */
svo_result fmti_svo_finish(fmt_writer *w, uint32_t depth, const svo_tree_counts *counts, const char *provenance, svo_error *err);

/* SHRD; to has FMTI_SVO_SHARD_SIZE bytes. */
void fmti_store_shard(const fmt_svo_shard *shard, uint8_t *to);
svo_result fmti_parse_shard(const fmt_chunk *chunk, const uint8_t *bytes, uint64_t size, uint32_t depth, fmt_svo_shard *shard, svo_error *err);
/* The description of the chunk in a buffer that a reader's fetch filled; returns how many stored bytes stand before it. */
size_t fmti_svo_packed(const svo_buffer *packed, fmt_chunk *chunk);

/* A full leaf that covers a chunk or more is a record: u64 place (its code with a bit 1 in front, so that the level is told by the bit's position),
 * then one value of every channel that is not constant. */
uint64_t fmti_place(uint32_t level, uint64_t code);
bool fmti_parse_place(uint64_t place, uint32_t chunk_level, uint32_t *level, uint64_t *code);

/* Records wait here until the next TREE chunk, so that a run of them shares a FULL chunk, whoever brought them. */
typedef struct fmti_full {
    svo_buffer records;
    uint32_t chunk_level, stride;
} fmti_full;
void fmti_full_init(fmti_full *f, const svo_tree_info *info, const svo_allocator *a);
void fmti_full_free(fmti_full *f);
svo_result fmti_full_add(fmti_full *f, fmt_writer *w, const uint8_t *record, svo_error *err);
svo_result fmti_full_flush(fmti_full *f, fmt_writer *w, svo_error *err);

/* Subtrees with coded masks wait here, so that up to 64 of them share a GRUP chunk, whoever brought them. On its way one of them is described
 * by a fmt_chunk of type GRUP: id its code, element_count its values, decoded_size as of a TREE chunk, element_stride the bytes of its coded
 * masks, behind which stand its compressed values up to stored_size; codec: PACKED values, or NONE. */
enum { FMTI_GROUP_MOST = 64 };
typedef struct fmti_group {
    svo_buffer records, streams;
    uint32_t count, voxel_bytes;
    uint16_t codec;
    uint64_t first, values;
} fmti_group;

/* What waits before it is written. */
typedef struct fmti_items {
    fmti_full full;
    fmti_group group;
} fmti_items;
void fmti_items_init(fmti_items *t, const svo_tree_info *info, const svo_allocator *a);
void fmti_items_free(fmti_items *t);
/* A TREE chunk, a record of a FULL chunk or a subtree of a GRUP chunk, in the octree's order. */
svo_result fmti_items_put(fmti_items *t, fmt_writer *w, fmt_chunk *c, const uint8_t *bytes, svo_error *err);
/* After the last one. */
svo_result fmti_items_flush(fmti_items *t, fmt_writer *w, svo_error *err);

/* The subtrees of a GRUP chunk (SVO-12); their numbers are checked against the payload's length alone. out has FMTI_GROUP_MOST elements. */
svo_result fmti_group_parse(const fmt_chunk *c, const svo_buffer *payload, uint32_t voxel_bytes, fmt_chunk *out, uint32_t *count, svo_error *err);

/* Count what a full leaf has on the levels from its own to `end` - 1. */
void fmti_count_full(svo_tree_counts *counts, uint32_t level, uint32_t end);

/* Bytes of all channels that are not constant, one voxel. */
uint32_t fmti_voxel_bytes(const svo_tree_info *info);

/* Does one of `count` octahedral normals (two int16 each) have the component -32768, which none may have? */
bool fmti_bad_normals(const uint8_t *values, uint64_t count);

/* The values of all channels that are not constant, one after the other. */
svo_result fmti_svo_pack(const svo_tree_info *info, const svo_chunk *chunk, const svo_allocator *a, svo_buffer *to, svo_error *err);
/* Back: `bytes` is filled by them. to[i]: room for channel i. */
svo_result fmti_svo_unpack(const svo_tree_info *info, const uint8_t *bytes, uint64_t size, uint64_t count, const svo_allocator *a, uint8_t *const to[SVO_MAX_CHANNELS],
                           svo_error *err);

/* (fmt_svo_rules.c) From now on violations of the file's rules go to `rules`, what breaks them is left out, and reading goes on, in one thread. */
void fmti_svo_reader_rules(fmt_svo_reader *r, struct svo_rules *rules);
/* Decode refused a subtree, so the counts of STAT cannot be compared. */
void fmti_svo_reader_left_out(fmt_svo_reader *r);

#endif
