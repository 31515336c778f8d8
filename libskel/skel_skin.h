/* What an animator needs of a skeleton: which joint is the parent of which, and how much each vertex follows each joint. */
#ifndef SKEL_SKIN_H
#define SKEL_SKIN_H

#include "skel_build.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Joints as a forest, one tree for each component: the shortest paths along the bones from its root, which is the joint nearest to the middle
 * of a longest such path (ties: the joint with more bones, then the lower number). Bones that would close a loop are in no tree. */
typedef struct skel_tree {
    const svo_allocator *allocator;
    uint32_t joint_count, root_count, loop_count; /* loop_count: bones that are in no tree */
    uint32_t *parent; /* of each joint, SVO_NONE for roots */
    uint32_t *order;  /* all joints, parents before children */
} skel_tree;
svo_result skel_tree_make(const skel_skeleton *s, const svo_allocator *a, skel_tree *out, svo_error *err);
void skel_tree_free(skel_tree *t);

typedef struct skel_skin_options {
    uint32_t influences; /* joints that may move a vertex, 1..8 */
    uint32_t smoothing;  /* rounds of averaging with neighbouring vertices; 0: between the two joints of the nearest bone alone */
    const svo_allocator *allocator;
} skel_skin_options;
skel_skin_options skel_default_skin_options(void); /* 4 influences, 8 rounds */

enum { SKEL_MAX_INFLUENCES = 8 };

/* Weights of every element of the skeleton's map (that is, of every vertex of the mesh as its instances place it). Of a vertex, weights descend,
 * ties by joint; they are >= 0 and their sum in double precision is 1 within 1e-6. Unused entries are joint 0 with weight 0. A vertex that was
 * dropped from the skeleton follows the first root. */
typedef struct skel_skin {
    const svo_allocator *allocator;
    uint64_t count;
    uint32_t influences;
    uint32_t *joint; /* count * influences */
    float *weight;   /* count * influences */
    uint32_t most;   /* largest number of influences of a vertex */
} skel_skin;

/* A vertex begins with the two joints of the nearest bone of its joint, in proportion to where the foot of its perpendicular lies; then weights are
 * averaged over the edges of the mesh (vertices at one place count as one, so that seams do not open), and the largest ones are kept.
 * mesh: the one the skeleton was built from, else SVO_INVALID_ARGUMENT. Time: smoothing * edges * influences. */
svo_result skel_skin_make(const svo_mesh *mesh, const skel_skeleton *s, const skel_tree *tree, const skel_skin_options *options, skel_skin *out, svo_error *err);
void skel_skin_free(skel_skin *s);

#ifdef __cplusplus
}
#endif
#endif
