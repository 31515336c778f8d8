/* Rays that go the same way, with AVX-512: svoi_rays_beam.h. */
#include "svoi_rays.h"

#ifdef SVOI_HAVE_AVX512
#include "svoi_wide_avx512.h"

#include "svoi_rays_beam.h"

bool svoi_rays_packet_avx512(const svo_rays *r, bool lod, bool any, svoi_ray_batch *b, uint32_t first, uint32_t count) { return trace_packet(r, lod, any, b, first, count); }
#else
bool svoi_rays_packet_avx512(const svo_rays *r, bool lod, bool any, svoi_ray_batch *b, uint32_t first, uint32_t count)
{
    (void)r, (void)lod, (void)any, (void)b, (void)first, (void)count;
    return false;
}
#endif
