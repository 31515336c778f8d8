/* svo-voxelize of files that hold voxels already, and of dense volumes. */
#ifndef VOXELIZE_CELLS_H
#define VOXELIZE_CELLS_H

#include "cli.h"

typedef struct cells_options {
    uint32_t depth; /* when has_depth; otherwise the smallest that holds all */
    bool has_depth, small, key;
    const double *threshold; /* NULL: above 0 */
    const char *raw; /* what the input is as samples without a header; NULL: by its content */
    double raw_size; /* edge of a cell of it, 0: 1 */
    const char *attributes, *depfile;
    uint64_t temp_size; /* of temporary files, 0: any */
    int level;
} cells_options;

/* Does the file begin as one of them? False also when it cannot be read. */
bool voxelize_is_cells(const char *path);
/* The only input to c->output; with key: print the content key and make nothing. */
svo_result voxelize_cells(cli *c, const cells_options *o, svo_error *err);

#endif
