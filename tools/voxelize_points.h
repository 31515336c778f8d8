/* svo-voxelize of clouds of points. */
#ifndef VOXELIZE_POINTS_H
#define VOXELIZE_POINTS_H

#include "cli_axes.h"

typedef struct points_options {
    uint32_t depth;
    double voxel_size; /* 0: by depth */
    uint64_t least;    /* points that make a voxel */
    bool small, key;
    const char *attributes, *columns, *depfile, *temp;
    const cli_axes *axes;
    uint64_t temp_size;
    int level;
} points_options;

/* Are the inputs points? -1: some are, some are not. */
int voxelize_are_points(const cli *c);
/* All inputs, in one grid, to c->output; with key: print the content key and make nothing. */
svo_result voxelize_points(cli *c, const points_options *o, svo_error *err);

#endif
