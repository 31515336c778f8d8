/* Faces of voxels as Draco bytes. */
#ifndef DRACO_FACES_H
#define DRACO_FACES_H

#include "fmt_cells.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What is in the bytes, as they are decoded again. */
typedef struct fmt_draco_mesh {
    uint64_t points, triangles;
    uint32_t bits;                    /* of positions */
    uint32_t position, normal, color; /* unique ids of the attributes */
    float low[3], high[3];            /* of the positions */
    double position_error;            /* of a corner, in cells, at most */
    double normal_error;              /* degrees, at most */
} fmt_draco_mesh;

/* The triangles of count >= 1 faces: positions in cells, `bits` each (0: the fewest with an error of at most an eighth of a cell; too few to tell neighbours apart is
 * SVO_INVALID_ARGUMENT), normals, linear colours of 16 bits without loss. The bytes are decoded again: every triangle must be there. Draco takes memory of its own,
 * about 300 bytes a face. Appends to *out. SVO_RUNTIME when Draco fails or gives back other triangles, SVO_OUT_OF_MEMORY. */
svo_result fmt_draco_faces(const fmt_cell_face *faces, uint64_t count, bool colored, uint32_t bits, svo_buffer *out, fmt_draco_mesh *told, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
