/* Rays that go the same way, with AVX2: svoi_rays_beam.h. */
#include "svoi_rays.h"

#ifdef SVOI_HAVE_AVX2
#include "svoi_wide_avx2.h"

#include "svoi_rays_beam.h"

bool svoi_rays_packet_avx2(const svo_rays *r, bool lod, bool any, svoi_ray_batch *b, uint32_t first, uint32_t count) { return trace_packet(r, lod, any, b, first, count); }
#endif
