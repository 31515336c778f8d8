/* Files that hold voxels already: MagicaVoxel's .vox, binvox. Dense volumes are in fmt_volume.h. */
#ifndef FMT_IMPORT_VOXELS_H
#define FMT_IMPORT_VOXELS_H

#include "fmt_cells.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Do these bytes begin as one of them? */
bool fmt_is_voxels(const uint8_t *data, uint64_t size);

typedef struct fmt_voxels {
    svo_buffer cells; /* fmt_cell, in Morton order, none twice */
    uint32_t side;    /* all coordinates are below */
    bool colored;
    double to_world[16];
} fmt_voxels;

/* Read one. .vox: the first frame of every visible model, where its nodes
 * put it, +Z up turned to +Y up. Memory: 16 bytes a voxel, twice while they are sorted. At most 2^31 voxels. Freed with svo_buffer_free(&out->cells). */
svo_result fmt_import_voxels(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_voxels *out, svo_error *err);

/* Give them as an octree: info says depth (2^depth >= side) and the channels, none or one of kind COLOR_SRGB8. */
svo_result fmt_voxels_emit(const fmt_voxels *v, const svo_tree_info *info, const svo_chunk_sink *sink, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
