/* --up and --unit: what a file does not say about its axes and lengths (OBJ, PLY, STL, OFF and clouds of points state neither). Our files are +Y up, in metres, as glTF. */
#ifndef CLI_AXES_H
#define CLI_AXES_H

#include "cli.h"
#include "svo_mesh.h"

extern const char *const cli_axes_ups[]; /* for CLI_CHOICE: y (as it is) -y x -x z -z */

typedef struct cli_axes {
    int up;           /* of cli_axes_ups: the input's axis that points up */
    const char *unit; /* NULL: lengths as they are; m km cm mm in ft, or metres as a number: the input's unit of length */
    double metres;    /* set by cli_take_axes; 1 without a unit */
    svo_mat4 matrix;  /* the same: a turn and a scale, no translation */
} cli_axes;

/* Fill in what is set by it. A usage exit code when `unit` is none, -1 to go on. */
int cli_take_axes(cli *c, cli_axes *a);
bool cli_axes_given(const cli_axes *a);
/* Into the options of a provenance, where they were given. */
void cli_put_axes(json_t *how, const cli_axes *a);
/* Turn and scale all instances and cameras. */
void cli_turn_mesh(const cli_axes *a, svo_mesh *mesh);

#endif
