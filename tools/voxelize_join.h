/* Several meshes as one, so that they are voxelized in one grid. */
#ifndef VOXELIZE_JOIN_H
#define VOXELIZE_JOIN_H

#include "svo_mesh.h"

/* Moves everything of meshes[0..count) (all from allocator a) into *out and empties them; on failure they stay as they are. */
svo_result join_meshes(svo_mesh *meshes, uint32_t count, const svo_allocator *a, svo_mesh *out, svo_error *err);

#endif
