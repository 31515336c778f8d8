/* Skins: how a mesh moves with bones, carried over to voxels.
 *
 * A vertex follows up to four bones: its image is the sum of weight * (bone's matrix * vertex). A voxel takes the weights at the point of the surface that is nearest
 * to its centre. They are stored as channels of the octree: `bone`, `bone1` .. `bone3` (labels, 0xffff: a bone that rests) and `weight1` .. `weight3` (of the
 * last three, in 255ths; that of `bone` is what is left). Only as many as a voxel can need are there. */
#ifndef SVO_SKIN_H
#define SVO_SKIN_H

#include "svo_math.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_SKIN_BONES 4u
#define SVO_SKIN_REST 0xffffu

/* What moves a vertex. Weights are not negative; bones of weight 0 mean nothing. Where all are 0 the vertex rests. */
typedef struct svo_influence {
    uint16_t bone[SVO_SKIN_BONES]; /* SVO_SKIN_REST: stays where it is */
    float weight[SVO_SKIN_BONES];
} svo_influence;

/* Triangles in the coordinates of the octree's mesh. Triangles with a corner that is not finite are left out. Borrowed. */
typedef struct svo_skin_mesh {
    uint64_t vertex_count, triangle_count; /* below 2^32 */
    const double *positions;               /* 3 a vertex */
    const svo_influence *influences;       /* one a vertex */
    const uint32_t *indices;               /* 3 a triangle, below vertex_count */
} svo_skin_mesh;

typedef struct svo_skin svo_skin;
/* `info` is the octree's, without the channels; room for them must be there (else SVO_LIMIT; SVO_OUT_OF_MEMORY). Freed by svo_skin_free, after its sinks are done. Keeps a pointer to the arrays of `mesh`. Memory: about 50 bytes a triangle. */
svo_result svo_skin_create(const svo_skin_mesh *mesh, const svo_tree_info *info, const svo_allocator *a, svo_skin **out, svo_error *err);
void svo_skin_free(svo_skin *s);

/* The octree's info with the channels, for whoever takes what svo_skin_sink gives. */
const svo_tree_info *svo_skin_info(const svo_skin *s);
/* A sink that adds the channels to each chunk and hands it to `to`. Both must outlive it. The chunks do not depend on threads. */
svo_chunk_sink svo_skin_sink(svo_skin *s, const svo_chunk_sink *to);

/* Weights of four slots in 255ths that add up to 255, greatest first (ties: the lower bone), from up to SVO_SKIN_CANDIDATES pairs; equal bones are added up and the
 * smallest are dropped. Returns the weight that was dropped, in 1. All weights 0: rest. */
enum { SVO_SKIN_CANDIDATES = 16 };
double svo_skin_pick(const uint16_t *bones, const double *weights, uint32_t count, uint16_t out_bone[SVO_SKIN_BONES], uint8_t out_weight[SVO_SKIN_BONES]);

/* The point of the mesh that is nearest to `grid` (grid coordinates: voxels): its triangle and its barycentric weights (of sum 1) at the three corners. By any
 * number of threads at a time. False when there is no triangle. `near` (UINT32_MAX: none) is a triangle that is
 * likely to be close. */
bool svo_skin_nearest(const svo_skin *s, const double grid[3], uint32_t near, uint32_t *triangle, double weight[3]);

/* Is a channel one of those above? */
bool svo_skin_is_channel(const char *name);

#ifdef __cplusplus
}
#endif
#endif
