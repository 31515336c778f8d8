/* Inside libskel: segments of triangles that are placed already (the map's order). */
#ifndef SKELI_SEGMENT_H
#define SKELI_SEGMENT_H

#include "skel_segment.h"

svo_result skeli_segments(const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles, const skel_skeleton *s, const svo_allocator *a, skel_segments *out,
                          svo_error *err);

#endif
