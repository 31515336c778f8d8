/* What a run of svo-voxelize will take: voxels, bytes, memory, temporary files, seconds. */
#ifndef VOXELIZE_ESTIMATE_H
#define VOXELIZE_ESTIMATE_H

#include "cli.h"
#include "fmt_spill.h"
#include "svo_voxelize.h"

typedef struct estimate_input {
    const svo_mesh *mesh;
    const svo_voxelize_options *options; /* of the run */
    const svo_tree_info *info;           /* planned */
    const fmt_spill *spill;              /* may be NULL */
    const svo_allocator *allocator;
    int level;       /* zstd's */
    bool small;      /* the small encoding */
    double seconds_before; /* import and plan */
} estimate_input;

typedef struct run_estimate {
    uint32_t depth;        /* of the trial: a coarser grid, or the grid itself where it is not large */
    uint64_t trial_voxels, part_voxels; /* part: of what was tried at the job's own depth */
    double trial_seconds;
    uint32_t inside_depth; /* of the last trial of the inside of a solid; 0: none was made */
    double voxels_by_area;
    uint64_t voxels, nodes, bytes, temporary, memory;
    double seconds;
} run_estimate;

/* Tries the job at a coarse depth and extrapolates. */
svo_result estimate_run(cli *c, const estimate_input *in, run_estimate *out, svo_error *err);
void estimate_print(cli *c, const run_estimate *e, const char *output, const fmt_spill *spill);
/* SVO_LIMIT when the output and the temporary files do not fit on their disks. Tries the job only where that is in question. */
svo_result estimate_check_disk(cli *c, const estimate_input *in, const char *output, svo_error *err);

#endif
