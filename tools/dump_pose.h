/* Scenes with poses, for what does not deform: which assets appear under which pose, and a scene in which each of these is an octree of its own. */
#ifndef DUMP_POSE_H
#define DUMP_POSE_H

#include "cli.h"
#include "svo_resample.h"

/* Pairs of asset and pose (SVO_NO_POSE: as it is) that some instance has, each once, ascending. */
typedef struct dump_pair { uint32_t asset, pose; } dump_pair;
typedef struct dump_pairs {
    const svo_allocator *allocator;
    uint64_t count, capacity;
    dump_pair *pair;
} dump_pairs;

/* rest: as if no instance had a pose. */
svo_result dump_pairs_find(const svo_scene *s, bool rest, const svo_allocator *a, dump_pairs *out, svo_error *err);
/* The pair of an instance of that scene. */
uint64_t dump_pairs_index(const dump_pairs *p, const svo_scene *s, bool rest, uint64_t instance);
void dump_pairs_free(dump_pairs *p);

typedef struct dump_baked {
    svo_scene scene;  /* without poses: an asset for each pair; the source's instances, pages and names. Borrows from the source. */
    uint64_t posed;   /* instances that had a pose and look so */
    uint64_t rested;  /* that had one and stand as if they had not: numbers do not reach so far, or there are more than 2^13 pairs (then all) */
    uint64_t coarser; /* of the posed: made of nodes above the finest voxels, for their number (2^21 a pair, 2^24 in all, about) */
    const svo_allocator *allocator;
    dump_pairs pairs;
    svo_unposed **octree; /* of each pair; NULL: its asset as it is */
    const svo_view **view;
    uint32_t *finest; /* of each pair: the level that all but a thousandth of its cells reach at most */
    const char **name;
    char *names;
    uint64_t names_size;
    uint32_t *asset;
} dump_baked;

/* Every pose resampled to cells (svo_unpose, method EMIT) in the coordinates of its asset's mesh, so that the instances' transforms stay what they are. Does not depend on the number of
 * threads. Memory: about 300 bytes a node of the largest pair, up to 2 KiB where its pose
 * stretches nodes, and the octrees. */
svo_result dump_bake(cli *c, const svo_scene *s, bool rest, const svo_allocator *a, dump_baked *out, svo_error *err);
/* A zeroed one is fine. */
void dump_baked_free(dump_baked *p);

#endif
