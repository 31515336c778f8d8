/* Inside libskel: a curve from the solid itself, where the contraction's has not as many loops as the solid has handles. */
#ifndef SKELI_CELLS_H
#define SKELI_CELLS_H

#include "skeli_curve.h"

/* Replace the curve by one with want->components components and want->genus loops (of a closed surface), with its ends where c has ends, and joints at points
 * of a grid (lattice steps). differs: c has other numbers of them; if it has not, it is replaced only where the contraction has put the ends of several limbs together. *done says
 * whether it was replaced: several grids are tried, of up to 2^26 places (a few bytes each, of the pool); where none has such a curve, c stays as it is. The result does not
 * depend on `threads`. Errors: SVO_OUT_OF_MEMORY. */
svo_result skeli_curve_of_cells(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, const skeli_genus *want, bool differs, uint32_t threads, skeli_curve *c, bool *done,
                                svo_error *err);

#endif
