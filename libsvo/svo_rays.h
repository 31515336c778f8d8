/* Many rays against one packed octree, 16 or 8 at a time.
 *
 * svo_raycast walks the packed octree as it lies in the file, one ray after the other. A svo_rays is a second form of the same
 * octree, made for speed: two levels at once as 64-bit masks (4x4x4 cells a node, children side by side), each inner node with
 * the box of what is inside it, so that rays pass most nodes by. Where the processor has AVX-512, 16 rays go
 * through it in one stream of instructions, where it has AVX2 8; elsewhere rays go through the packed octree as svo_raycast's do.
 *
 * Hits are those of svo_raycast, bit for bit, on every processor: plane parameters are the same doubles, and a ray that
 * comes so near to an edge that the kernel cannot be certain (docs/design/003-ray-casting.md) is given to svo_raycast. */
#ifndef SVO_RAYS_H
#define SVO_RAYS_H

#include "svo_raycast.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum svo_ray_kernel {
    SVO_KERNEL_AUTO = 0,     /* the best that this processor can run */
    SVO_KERNEL_PORTABLE = 1, /* one ray at a time */
    SVO_KERNEL_AVX512 = 2,   /* 16 rays; where the processor cannot, the best that it can */
    SVO_KERNEL_AVX2 = 3      /* 8 rays; where the processor cannot, PORTABLE */
} svo_ray_kernel;

typedef struct svo_rays_options {
    svo_ray_kernel kernel;
    uint64_t memory; /* bytes of the second form at most; one that would be larger is not kept, and rays go through the file's. 0: 2^30 */
    const svo_allocator *allocator;
} svo_rays_options;
svo_rays_options svo_default_rays_options(void);

typedef struct svo_rays_report {
    svo_ray_kernel kernel;  /* that will be used */
    uint64_t bytes;         /* of the second form; 0 where there is none */
    uint64_t nodes, bricks; /* 4x4x4 nodes above the finest, bricks of finest voxels */
    double seconds;         /* to make it */
} svo_rays_report;

/* The view is borrowed and must outlive the result. Time and memory are linear in the stored nodes (8 bytes a brick and
 * 16 a node, half as much again where attributes are numbered; each is stored about as often as in the file's plain layout). report may be NULL. Fails only for want of memory. */
typedef struct svo_rays svo_rays;
svo_result svo_rays_build(const svo_view *view, const svo_rays_options *options, svo_rays **out, svo_rays_report *report, svo_error *err);
void svo_rays_free(svo_rays *rays);

/* As svo_raycast: hits[i] belongs to rays[i]. Any number of threads at a time. */
void svo_rays_cast(const svo_rays *r, const svo_ray *rays, uint64_t count, svo_hit *hits);
/* As svo_ray_blocked: blocked[i] tells whether rays[i] hits anything. */
void svo_rays_blocked(const svo_rays *r, const svo_ray *rays, uint64_t count, bool *blocked);

/* Values of a channel at hits: out + i * stride is what svo_view_attribute gives for hits[i].attribute, and 0 where hits[i].hit is false. Several at
 * a time; neighbouring hits of one node are looked up once. For hits of svo_raycast too. */
void svo_rays_values(const svo_view *view, uint32_t channel, const svo_hit *hits, uint64_t count, uint8_t *out);

const char *svo_ray_kernel_name(svo_ray_kernel kernel);

#ifdef __cplusplus
}
#endif
#endif
