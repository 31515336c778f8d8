/* Which bones move which nodes of an octree with the channels of svo_skin.h, and how much: what a node's image must hold. */
#ifndef SVO_BONES_H
#define SVO_BONES_H

#include "svo_skin.h"
#include "svo_view.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_NO_BONE UINT32_MAX

/* A bone's weight in a node, in 255ths, from the least to the most that it has anywhere there. */
typedef struct svo_bone_range {
    uint32_t bone; /* SVO_NO_BONE: what rests */
    uint8_t low, high, zero[2];
} svo_bone_range;

/* Each bone once. Any weights in the ranges that add up to 255 are meant. NULL: any weights of all bones. */
typedef struct svo_bone_list { const svo_bone_range *range; uint32_t count; } svo_bone_list;
enum { SVO_BONE_LIST_MOST = 64 }; /* lists that would be longer are NULL */

/* For each node of levels 0 .. depth the ranges of the weights of its voxels and of the voxels that touch one of them (face, edge or corner). Figure 16 of the thesis
 * maps a voxel by the two matrices at its extreme corners; but two neighbours along an axis share no extreme corner, so that would leave gaps. Here a voxel takes the
 * bounds of its images under its own weights, those of its neighbours and all between them. So where two voxels touch, the images of what they share, under the weights
 * of both, are in both boxes; and the box of a node holds those of the nodes below it. */
typedef struct svo_bones svo_bones;
/* NULL in *out when the view has no channel `bone` of labels, or is empty. Without channels of weights a voxel follows its one bone. Memory: 16 bytes a node, and about
 * 8 for each bone of a voxel whose neighbours in the file have others; time: 26 searches a voxel. SVO_LIMIT for octrees of more than 2^26 voxels. */
svo_result svo_bones_make(const svo_view *view, uint32_t threads, const svo_allocator *a, svo_bones **out, svo_error *err);
void svo_bones_free(svo_bones *b);

/* Of a node of the octree at a level (0: the root), its cell in units of that level. Valid as long as `b` is. */
svo_bone_list svo_bones_at(const svo_bones *b, uint32_t level, const uint32_t cell[3]);

/* Where the voxels of an asset are in its grid, and those that follow each bone: what bounds of posed instances are made of. */
typedef struct svo_extent {
    const svo_allocator *allocator;
    double low[3], high[3]; /* of all voxels, their whole cubes; 0 to 0 for an empty view */
    uint32_t bones;         /* boxes for labels 0 .. bones - 1, and one for all others and what rests; 0: bones are not told apart */
    double *box;            /* (bones + 1) * 6: low, high; infinite and negative infinite where nothing follows it */
} svo_extent;
/* with_bones: tell them apart, which takes a walk over all voxels; without channels of bones or with more than 2^24 voxels they are not. Boxes in grid
 * coordinates. Freed by svo_extent_free; SVO_OUT_OF_MEMORY. */
svo_result svo_extent_make(const svo_view *view, bool with_bones, const svo_allocator *a, svo_extent *out, svo_error *err);
void svo_extent_free(svo_extent *e);

#ifdef __cplusplus
}
#endif
#endif
