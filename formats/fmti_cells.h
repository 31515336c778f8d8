/* Inside formats: the .glb of cells as it is put together (fmt_cells_glb.c, fmt_cells_places.c). */
#ifndef FMTI_CELLS_H
#define FMTI_CELLS_H

#include "fmt_cells.h"
#include "fmti_glb.h"

struct fmt_cells_glb {
    fmt_glb g;
    uint32_t draco;
    json_t *meshes, *nodes; /* borrowed from the root */
    fmt_cells_glb_report report;
};

#endif
