/* Cells as .vdb and .nvdb: a library of its own (svovdb), so that nothing else needs OpenVDB. */
#ifndef CELLS_VDB_H
#define CELLS_VDB_H

#include "fmt_cells.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Is the library built in? Otherwise the two functions below end with SVO_NOT_BUILT. */
bool fmt_have_vdb(void);
bool fmt_have_nvdb(void);
/* OpenVDB: fog volume "density" (1 in cells) and, if colored, "color" (linear RGB). Cell centres at index coordinates. Deterministic: the file's random
 * identifier is replaced by one that follows from its content. NanoVDB: density alone. */
svo_result fmt_cells_vdb(const fmt_cells *c, fmt_output *out, svo_error *err);
svo_result fmt_cells_nvdb(const fmt_cells *c, fmt_output *out, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
