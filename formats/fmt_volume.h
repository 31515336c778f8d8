/* Dense volumes: NRRD (with its data in the file or beside it, raw, gzip or text) and raw samples without a header. The cells whose value reaches a threshold become
 * voxels, chunk by chunk from the mapped samples, so that memory does not grow with the volume. docs/tools/svo-voxelize.md says what is taken. */
#ifndef FMT_VOLUME_H
#define FMT_VOLUME_H

#include "fmt_file.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Do these bytes begin as a NRRD header? */
bool fmt_is_nrrd(const uint8_t *data, uint64_t size);

typedef struct fmt_volume_options {
    const char *raw;         /* "WxHxD:TYPE[:little|:big][:OFFSET]", x fastest; NULL: a NRRD file */
    double raw_size;         /* edge of a cell of it; 0: 1 */
    const double *threshold; /* cells of at least this exist; NULL: above 0 */
    uint32_t threads;        /* 0 = all */
    bool mapped;             /* the bytes given are of a mapped file */
    uint64_t memory;         /* mapped samples that were used are dropped from memory where they are more than half of this; 0 = never */
    uint64_t temporary;      /* bytes that packed samples (gzip, text) may have when they are unpacked to a temporary file; more is SVO_LIMIT; 0: any */
    const svo_allocator *allocator;
    fmt_file_read_fn file_read; /* of the file with the data, where it is another one */
    void *file_read_user;
} fmt_volume_options;

typedef struct fmt_volume_facts {
    uint64_t size[3];
    uint64_t samples, voxels;
    uint32_t side;      /* all voxels have coordinates below */
    double low, high;   /* of all samples that are numbers; of their alpha where they are colours */
    bool colored;       /* red, green, blue, alpha; alpha decides */
    bool one_color;
    uint8_t color[3];   /* of the first voxel */
    double to_world[16];
} fmt_volume_facts;

typedef struct fmt_volume fmt_volume;
/* `path` is for messages, and the folder of detached data, which must not lie elsewhere. The bytes are borrowed. The samples are read once for the facts.
 * SVO_INVALID_DATA, SVO_UNSUPPORTED (an encoding, type or dimension that is not taken), SVO_INVALID_ARGUMENT (of `raw`), SVO_LIMIT (more than 2^21 cells a side),
 * SVO_IO (detached data); *out is freed by fmt_volume_close. */
svo_result fmt_volume_open(const char *path, const uint8_t *bytes, uint64_t size, const fmt_volume_options *options, fmt_volume **out, svo_error *err);
const fmt_volume_facts *fmt_volume_about(const fmt_volume *v);
/* Hand on the octree: 2^depth >= side. Channels that are not constant: SVO_KIND_COLOR_SRGB8 (of colours), and SVO_KIND_UNORM8 of the values, from their smallest
 * to their largest. One thread at a time hands on; the chunks do not depend on `threads`. Errors are those of the sink, and
 * SVO_OUT_OF_MEMORY. */
svo_result fmt_volume_emit(const fmt_volume *v, const svo_tree_info *info, const svo_chunk_sink *sink, svo_error *err);
void fmt_volume_close(fmt_volume *v);

#ifdef __cplusplus
}
#endif
#endif
