/* .svo: an octree as a stream of independently compressed chunks; docs/format/svo.md is normative. */
#ifndef FMT_SVO_H
#define FMT_SVO_H

#include "fmt_container.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writer. Give fmt_svo_sink's result to the voxelizer; then fmt_svo_writer_end. `provenance` is JSON text (tool,
 * version, options, inputs with hashes; no paths, times or thread counts) and may be NULL. level: 0 packs values with a codec of our own (masks
 * with zstd at level 3); 1..19 compresses both with zstd at that level. */
typedef struct fmt_svo_writer fmt_svo_writer;
svo_result fmt_svo_writer_begin(fmt_output *out, const svo_tree_info *info, const char *provenance, int level,
                                const svo_allocator *a, fmt_svo_writer **writer, svo_error *err);
/* Small instead of fast: masks through a context model (GRUP chunks), a third of their size under zstd at a tenth of its speed. Right after
 * fmt_svo_writer_begin. */
svo_result fmt_svo_writer_small(fmt_svo_writer *w, svo_error *err);
/* Which part of a job a file holds (chunk SHRD): the chunks with first_code <= code < end_code. */
typedef struct fmt_svo_shard {
    uint32_t index, count; /* 1 <= index <= count <= FMT_SVO_MAX_SHARDS */
    uint64_t first_code, end_code;
    uint8_t job[16]; /* the same in all shards of a job: a hash of its inputs and options */
} fmt_svo_shard;
#define FMT_SVO_MAX_SHARDS 100000u
/* Say that the file is a shard. Right after fmt_svo_writer_begin. */
svo_result fmt_svo_writer_shard(fmt_svo_writer *w, const fmt_svo_shard *shard, svo_error *err);
svo_chunk_sink fmt_svo_writer_sink(fmt_svo_writer *w);
/* Writes counts, table and footer, fills *counts (may be NULL) and frees the writer, also on failure. */
svo_result fmt_svo_writer_end(fmt_svo_writer *w, svo_tree_counts *counts, svo_error *err);
void fmt_svo_writer_discard(fmt_svo_writer *w);

/* Reader over a sequential input (borrowed). The source's fetch checks hashes and chunk order; decode checks the chunks.
 * The stored counts are compared when the end of the stream has been fetched and every chunk decoded once: by that fetch
 * or by that decode, whichever comes last. A consumer that leaves chunks undecoded gets the other checks alone. */
typedef struct fmt_svo_reader fmt_svo_reader;
svo_result fmt_svo_reader_open(fmt_input *in, const svo_allocator *a, fmt_svo_reader **out, svo_error *err);
const svo_tree_info *fmt_svo_reader_info(const fmt_svo_reader *r);
/* JSON text or "". Like counts and content hash it is valid after fetch has said that there is no more (META comes last). */
const char *fmt_svo_reader_provenance(const fmt_svo_reader *r);
/* NULL when the file is no shard, or before the first fetch. */
const fmt_svo_shard *fmt_svo_reader_shard(const fmt_svo_reader *r);
svo_chunk_source fmt_svo_reader_source(fmt_svo_reader *r);
const svo_tree_counts *fmt_svo_reader_counts(const fmt_svo_reader *r);
void fmt_svo_reader_content_hash(const fmt_svo_reader *r, uint8_t out[16]);
void fmt_svo_reader_close(fmt_svo_reader *r);

/* Every violation of docs/format/svo.md to `rules`, as far as it does not follow from another: of HEAD the first, every chunk header, record and place; of each subtree
 * what is wrong with its masks, and each channel of normals; the counts of STAT where nothing else is wrong. Returns as fmt_svdag_violations. */
struct svo_rules;
svo_result fmt_svo_violations(const uint8_t *data, uint64_t size, const svo_allocator *a, struct svo_rules *rules, svo_error *err);

/* Join all shards of one job, given in any order, to the file that one run would have written, byte by byte. Shards are
 * read one after the other and their chunks copied as they are stored, after their hashes and descriptions have been
 * checked; memory is a chunk and 64 bytes a shard. Every path is opened twice. SVO_INVALID_DATA, naming files, when a shard is missing,
 * there twice or of another job, or when an input is no shard. */
typedef struct fmt_svo_merge_report {
    svo_tree_info info;
    svo_tree_counts counts;
    uint32_t shards;
    uint64_t bytes_read;
} fmt_svo_merge_report;
/* Told from time to time: so much of `total` is done; total 0 = unknown. A NULL watch, or one without tell: nobody. */
typedef struct fmt_svo_watch {
    void (*tell)(void *user, uint64_t done, uint64_t total);
    void *user;
} fmt_svo_watch;
svo_result fmt_svo_merge(const char *const *paths, uint64_t count, fmt_output *out, const svo_allocator *a, const fmt_svo_watch *watch,
                         fmt_svo_merge_report *report, svo_error *err);

/* Write an octree, or a shard of one, again in the fast or the small form: the bytes are those that its maker would have written in that form
 * with the same level. HEAD, SHRD and META stay. counts and info may be NULL. */
typedef struct fmt_svo_recode_options {
    bool small;
    int level; /* as of fmt_svo_writer_begin */
    uint32_t threads;
    const svo_allocator *allocator;
    fmt_svo_watch watch; /* bytes read */
} fmt_svo_recode_options;
svo_result fmt_svo_recode(fmt_input *in, fmt_output *out, const fmt_svo_recode_options *options, svo_tree_counts *counts, svo_tree_info *info,
                          svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
