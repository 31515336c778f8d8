/* Internal to libsvo: of the surface voxels of a block, the one nearest to a voxel or leaf that is inside. */
#ifndef SVOI_SOLID_NEAR_H
#define SVOI_SOLID_NEAR_H

#include "svo_block.h"

typedef struct svoi_near {
    const svo_block *block;
    uint32_t levels;
    int32_t corner[3], grid;
    uint32_t brick;    /* in hand */
    int32_t low[3];    /* its low corner */
    uint32_t last;     /* voxel found last */
    bool loaded;       /* what follows is about the brick: */
    uint64_t set[27];  /* surface at each voxel of the brick plus a step (x + 3 y + 9 z of steps plus one), in linear order */
    uint8_t step[64];  /* of each voxel that is no surface, in linear order: the shortest of the steps that reach surface */
    bool border;       /* the brick lies at a face of the block */
} svoi_near;

/* The block as in svo_solid_fill; grid: its side in voxels. */
void svoi_near_begin(svoi_near *n, const svo_block *block, uint32_t levels, const int32_t corner[3], int32_t grid);
/* Code of the surface voxel whose middle is nearest to that of the node (2^height voxels an axis from `code` on, none of them surface; height
 * <= 3). A leaf's may be farther than the nearest by up to half of
 * its side. False when a block beside this one may hold one that is nearer than that (by more than one voxel, where the node is a voxel). Nodes of a block have to be asked in one order, whatever the threads are. */
bool svoi_near_voxel(svoi_near *n, uint32_t code, uint32_t height, uint32_t *out);

#endif
