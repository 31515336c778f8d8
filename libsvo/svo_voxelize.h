/* Triangles to voxels: exact surface voxelization with attributes, streamed chunk by chunk. */
#ifndef SVO_VOXELIZE_H
#define SVO_VOXELIZE_H

#include "svo_mesh.h"
#include "svo_spill.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Channels that can be asked for, as bits. */
enum {
    SVO_WANT_COLOR = 1, SVO_WANT_NORMAL = 2, SVO_WANT_EMISSIVE = 4, SVO_WANT_METALLIC = 8, SVO_WANT_ROUGHNESS = 16,
    SVO_WANT_MATERIAL = 32, SVO_WANT_COVERAGE = 64,
    SVO_WANT_AUTO = 1 << 30 /* normal, and every other channel but material in which the mesh says something; coverage for BLEND alone */
};

typedef struct svo_voxelize_options {
    uint32_t depth;     /* 0..SVO_MAX_DEPTH; used when voxel_size is 0 */
    double voxel_size;  /* > 0: edge of a voxel in mesh units; the depth follows from the bounds, and the grid is
                           aligned to multiples of voxel_size, so that equal sizes of different meshes fit together */
    svo_surface surface;
    svo_fill fill;
    uint32_t channels; /* SVO_WANT_ bits, 0 = geometry only */
    uint32_t threads;  /* 0 = all */
    uint64_t memory;   /* bytes the call may hold besides the mesh, 0 = no limit; more is SVO_LIMIT */
    /* Where triangles go that do not fit in `memory` (svo_spill.h), also those of parts that are spilled already, for which it
     * must be given. NULL: nowhere, then too little memory is SVO_LIMIT. */
    const svo_spill *spill;
    /* When has_range: only chunks with first_code <= code < end_code, with the bytes that a whole run gives them. What the
     * report says of triangles is of the whole mesh, what it says of voxels of the range. */
    bool has_range;
    uint64_t first_code, end_code;
    /* Voxels whose attributes are compared with dense samples of the surface inside them; 0 = none. A fixed choice, whatever the threads. */
    uint32_t reference_voxels;
    const svo_allocator *allocator;
    svo_warnings *warnings; /* may be NULL */
} svo_voxelize_options;

/* Zero-filled options with depth 10, conservative surface, automatic channels. */
svo_voxelize_options svo_default_voxelize_options(void);

#define SVO_REFERENCE_POINTS 4096 /* samples of a voxel that is compared with the reference */

/* Of one channel, over the voxels where it can be told: CIE94 units of colours, degrees of normals, the share of voxels with another id,
 * and fractions of the whole range of the rest. */
typedef struct svo_channel_error {
    uint64_t voxels;
    double mean, max;
} svo_channel_error;

/* Measured, not assumed; lengths in voxels unless they say otherwise. */
typedef struct svo_voxelize_report {
    uint64_t triangles;           /* placed, that is with instances */
    uint64_t skipped_not_finite;  /* triangles with a NaN or infinite corner */
    uint64_t degenerate;          /* triangles that are a segment or a point after the snap; they still mark voxels */
    double snap_mean, snap_max;   /* distance a vertex moved by the snap to the lattice */
    uint64_t masked_voxels;       /* voxels removed by alpha MASK */
    double distance_mean, distance_max; /* voxel centre to the nearest triangle in the voxel; of a fixed sample of voxels */
    uint64_t distance_samples;
    svo_tree_counts counts;
    /* solid: how inside was told from outside (svo_winding.h), 0 with fill surface */
    uint64_t solid_triangles_oriented, solid_triangles_even, solid_triangles_open; /* by the part they belong to */
    uint64_t solid_triangles_turned;          /* against the orientation that they came with */
    uint64_t solid_boundary_edges;            /* where open parts end */
    uint64_t solid_asked, solid_ambiguous;    /* points asked, and those whose winding number is between 0.4 and 0.6 */
    bool solid_paged;                         /* what tells inside from outside lay in temporary files */
    double seconds_solid;                     /* of setup: to prepare that */
    uint64_t peak_bytes;          /* of memory charged to `memory` */
    bool spilled;                 /* triangles went through the spill: */
    uint64_t spill_bins;          /* parts that were voxelized one after the other */
    uint32_t spill_rounds;        /* times that triangles were binned, at most, before they were in such a part */
    uint64_t split_units;         /* chunks, or parts of the only chunk, whose triangles alone did not fit */
    svo_channel_error attribute_errors[SVO_MAX_CHANNELS]; /* in the order of the info's channels; SVO_REFERENCE_POINTS a voxel */
    uint64_t reference_voxels;                            /* that were compared; none when spilled */
    double seconds_setup, seconds_voxels, seconds_reference;
} svo_voxelize_report;

/* The grid, the snap lattice and the channels that svo_voxelize will use for this mesh: call it first, hand the info to
 * the sink's owner, then svo_voxelize with the same arguments. An empty mesh gives the unit grid. SVO_LIMIT when
 * voxel_size asks for more than SVO_MAX_DEPTH levels. */
svo_result svo_voxelize_plan(const svo_mesh *mesh, const svo_voxelize_options *options, svo_tree_info *info, svo_error *err);

/* Voxelize into the sink. The voxel set is exact: vertices are snapped to odd multiples of 2^-8 voxel (see
 * docs/design), after which a voxel is marked if and only if its closed cube meets the closed triangle (conservative).
 * The chunks do not depend on threads, memory, triangle order or compiler. */
svo_result svo_voxelize(const svo_mesh *mesh, const svo_voxelize_options *options, const svo_tree_info *info,
                        const svo_chunk_sink *sink, svo_voxelize_report *report, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
