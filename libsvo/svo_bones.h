/* Which bones move which nodes of an octree with a channel `bone`: what a node's image must hold. */
#ifndef SVO_BONES_H
#define SVO_BONES_H

#include "svo_view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* For each node of levels 0 .. depth the set of labels of its voxels and of the voxels that touch one of them (face, edge or corner). A voxel whose neighbours have other
 * labels is mapped by their matrices too and takes the bounds of all (figure 16 has two: those of its extreme corners; two neighbours along an axis share no
 * extreme corner, so two would leave gaps). So where two voxels touch, the images of what they share are in both boxes. Sets are bits of label mod 63; bit 63 is
 * "no bone", and is set for labels from 63 on too, as they may rest: a skeleton of more than 63 bones gives looser boxes. */
typedef struct svo_bones svo_bones;
/* NULL in *out when the view has no channel `bone` of labels, or is empty. Memory: 16 bytes a node; time: 26 searches a voxel. SVO_LIMIT for octrees of more than
 * 2^26 voxels. */
svo_result svo_bones_make(const svo_view *view, uint32_t threads, const svo_allocator *a, svo_bones **out, svo_error *err);
void svo_bones_free(svo_bones *b);

#define SVO_BONES_NONE ((uint64_t)1 << 63)
/* The set of a node; 0 where there is none. */
uint64_t svo_bones_set(const svo_bones *b, uint32_t level, const uint32_t cell[3]);

#ifdef __cplusplus
}
#endif
#endif
