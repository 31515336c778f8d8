/* Internal to libsvo: the parts of validation that belong to one layout, and their bounds. Not installed. */
#ifndef SVOI_VIEW_H
#define SVOI_VIEW_H

#include "svo_view.h"

/* Geometry of layout 2, where the octree is not empty: every rule, and that `nodes` and attribute_count are right. */
svo_result svoi_fast_validate(const svo_view *v, const svo_allocator *a, svo_rules *rules, svo_error *err);
/* Value of an attribute that is an average (of a channel that varies). */
uint32_t svoi_view_average(const svo_view *v, uint32_t channel, uint64_t attribute);

svo_result svoi_fast_bounds(const svo_view *v, const svo_allocator *a, uint32_t low[3], uint32_t high[3], svo_error *err);

#endif
