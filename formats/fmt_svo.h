/* .svo: an octree as a stream of independently compressed chunks; docs/format/svo.md is normative. */
#ifndef FMT_SVO_H
#define FMT_SVO_H

#include "fmt_container.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writer. Give fmt_svo_sink's result to the voxelizer; then fmt_svo_writer_end. `provenance` is JSON text (tool,
 * version, options, inputs with hashes; no paths, times or thread counts) and may be NULL. level is zstd's (0 = 3). */
typedef struct fmt_svo_writer fmt_svo_writer;
svo_result fmt_svo_writer_begin(fmt_output *out, const svo_tree_info *info, const char *provenance, int level,
                                const svo_allocator *a, fmt_svo_writer **writer, svo_error *err);
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
svo_chunk_source fmt_svo_reader_source(fmt_svo_reader *r);
const svo_tree_counts *fmt_svo_reader_counts(const fmt_svo_reader *r);
void fmt_svo_reader_content_hash(const fmt_svo_reader *r, uint8_t out[16]);
void fmt_svo_reader_close(fmt_svo_reader *r);

#ifdef __cplusplus
}
#endif
#endif
