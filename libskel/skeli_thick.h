/* Inside libskel: which live vertices belong to parts that are thick beside omega. */
#ifndef SKELI_THICK_H
#define SKELI_THICK_H

#include "skeli_internal.h"

enum { SKELI_MOST_DOUBLINGS = 3 };

/* How far each live vertex can move before it meets another part of the surface on either side (lattice steps): way (count). */
svo_result skeli_ways(skeli_pool *pool, const skeli_state *s, uint32_t threads, float *way, svo_error *err);
/* How often balls may be doubled without reaching through a part; returns how many are. */
uint32_t skeli_doublings(const float *way, uint32_t count, double omega, uint8_t *doublings);

#endif
