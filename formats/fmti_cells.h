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

/* fmt_cells_faces, perhaps with each face of a cell apart. */
svo_result fmti_cells_faces(const fmt_cells *c, bool apart, svo_buffer *out, svo_error *err);

#endif
