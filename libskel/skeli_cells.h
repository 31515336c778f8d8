/* Inside libskel: a curve from the solid itself, where the contraction's has not as many loops as the solid has handles. */
#ifndef SKELI_CELLS_H
#define SKELI_CELLS_H

#include "skeli_curve.h"

/* Replace the curve by one with want->components components and want->genus loops (of a closed surface) that has its ends where c has ends inside, and joints at the points of a grid. Where its topology does not differ from that, only if the
 * contraction has put ends of several limbs together. *done says whether a grid that is not too large
 * has such a curve; else c stays as it is. */
svo_result skeli_curve_of_cells(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, const skeli_genus *want, bool differs, uint32_t threads, skeli_curve *c, bool *done,
                                svo_error *err);

#endif
