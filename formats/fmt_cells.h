/* Cells of a grid, to be written in the formats of other programs: as a mesh of their faces, as voxels, as a dense volume. docs/tools/svo-dump.md
 * says what becomes of axes, colours and sizes. */
#ifndef FMT_CELLS_H
#define FMT_CELLS_H

#include "fmt_file.h"
#include "svo_alloc.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct fmt_cell {
    uint32_t at[3]; /* < 2^21 each; no cell twice */
    uint8_t rgb[4]; /* sRGB; the last one 255 */
} fmt_cell;

typedef struct fmt_cells {
    const fmt_cell *cell; /* borrowed */
    uint64_t count;
    uint32_t low[3], high[3]; /* part of the grid that is wanted, both inclusive; all cells lie in it */
    double to_world[16];      /* cell corners to the world, row-major, affine */
    bool colored;             /* the colours mean something */
    const svo_allocator *allocator;
} fmt_cells;

/* Faces between a cell and what is no cell, those of one plane and colour that form a rectangle merged row by row. Corners of neighbouring rectangles need not
 * meet (T-junctions). Same cells in any order, same faces. */
typedef struct fmt_cell_face {
    uint32_t slice;      /* the plane's coordinate */
    uint32_t low[2], high[2]; /* along the axes after `axis`, cyclically; corners */
    uint8_t axis, up;    /* up: the outside is on the side of larger coordinates */
    uint8_t rgb[4];
} fmt_cell_face;
/* Memory: 40 bytes a cell beside the faces. *out holds fmt_cell_face. */
svo_result fmt_cells_faces(const fmt_cells *c, svo_buffer *out, svo_error *err);

/* Corner k (0..3) of a face, counter-clockwise from outside (where the grid is right-handed). */
void fmt_cell_corner(const fmt_cell_face *f, uint32_t k, uint32_t out[3]);

/* Where a corner `at` of cell number `cell` goes; called with every corner of every cell that is part of a face of any. False: a guess, used only where no cell knows better. */
typedef struct fmt_cells_bend {
    bool (*corner)(void *user, uint64_t cell, const uint32_t at[3], double out[3]);
    void *user;
    bool mirrored; /* it turns the shape inside out: corners of faces go the other way round */
} fmt_cells_bend;
/* A face of one cell after that. */
typedef struct fmt_bent_face {
    float corner[4][3]; /* counter-clockwise from outside */
    uint8_t rgb[4];
} fmt_bent_face;
/* A face for each side of a cell that no other cell covers, none merged. A corner goes to the middle of its images by all cells that touch it, so faces that
 * shared an edge share its image. Memory: 40 to 80 bytes a corner beside that of fmt_cells_faces and the faces. *out holds fmt_bent_face; SVO_INVALID_DATA where an image is not finite. */
svo_result fmt_cells_bent_faces(const fmt_cells *c, const fmt_cells_bend *bend, svo_buffer *out, svo_error *err);

/* Faces and where they are. */
typedef struct fmt_cells_placed {
    const fmt_cell_face *faces; /* either these */
    const fmt_bent_face *bent;  /* or these; the other one NULL */
    uint64_t count;
    double to_world[16];
} fmt_cells_placed;
/* The faces of all `placed` entries of the list as quads with their corners in the world (double) and sRGB colours. Binary little-endian PLY. SVO_IO where writing
 * fails. The list is borrowed. */
svo_result fmt_cells_placed_ply(const fmt_cells_placed *list, uint64_t placed, bool colored, fmt_output *out, svo_error *err);

/* Triangles in grid coordinates, under nodes whose matrices lead to the world; COLOR_0 linear in 16 bits; flat normals. A .glb has at most 4 GB. */
typedef struct fmt_cells_glb_report {
    uint64_t faces, nodes;
    uint64_t draco_bytes;  /* with Draco, all below: */
    uint32_t bits;         /* of positions, at most */
    double position_error; /* of a corner as it is decoded, in cells, at most */
    double normal_error;   /* degrees */
} fmt_cells_glb_report;
typedef struct fmt_cells_glb fmt_cells_glb;
/* A model in the making, in memory until its end; freed by fmt_cells_glb_free. draco: meshes by KHR_draco_mesh_compression, positions of `bits` bits (0: the fewest with an error of at most an eighth of a cell). */
svo_result fmt_cells_glb_begin(bool draco, uint32_t bits, const svo_allocator *a, fmt_cells_glb **out, svo_error *err);
/* The faces of cells, whose to_world is not used, as a mesh; *mesh is its number, UINT64_MAX when there are no faces. SVO_LIMIT where
 * the file would have more than 4 GB, SVO_INVALID_ARGUMENT for too few bits, SVO_RUNTIME when Draco fails, SVO_OUT_OF_MEMORY. */
svo_result fmt_cells_glb_mesh(fmt_cells_glb *g, const fmt_cells *c, const char *name, uint64_t *mesh, svo_error *err);
/* The same of faces that have been bent, in the coordinates of the places of the mesh; never compressed. */
svo_result fmt_cells_glb_bent(fmt_cells_glb *g, const fmt_bent_face *faces, uint64_t count, bool colored, const char *name, uint64_t *mesh, svo_error *err);
/* A place for a mesh. name and id (in the node's extras) may be NULL. */
void fmt_cells_glb_node(fmt_cells_glb *g, uint64_t mesh, const double to_world[16], const char *name, const uint64_t *id);
/* Where a mesh is, without shear, as EXT_mesh_gpu_instancing says it: beside the translation of the node that has it. */
typedef struct fmt_cells_place { float translation[3], rotation[4] /* unit quaternion x y z w */, scale[3]; } fmt_cells_place;
/* False, and nothing is set, where the matrix is sheared (by more than 1e-5 in the cosine of two axes) or flat. A mirror image has a negative scale. */
bool fmt_cells_place_of(const double to_world[16], const double origin[3], fmt_cells_place *out);
/* A mesh at many places beside `origin`, by one node: without names and ids. Floats, so origin should be near the places. */
void fmt_cells_glb_places(fmt_cells_glb *g, uint64_t mesh, const double origin[3], const fmt_cells_place *places, uint64_t count);
/* Write the file; once. *report (may be NULL) is filled in. SVO_UNSUPPORTED without any face (a .glb cannot hold
 * an empty mesh); SVO_OUT_OF_MEMORY also where an earlier node could not be added; SVO_IO. */
svo_result fmt_cells_glb_end(fmt_cells_glb *g, fmt_output *out, fmt_cells_glb_report *report, svo_error *err);
void fmt_cells_glb_free(fmt_cells_glb *g);

/* MagicaVoxel: models of at most 256^3, +Z up, centred over the origin. More than 255 colours are reduced (median cut, then five rounds of k-means, in CIE L*a*b*);
 * the differences are CIE94, graphic arts, as everywhere. */
typedef struct fmt_vox_report {
    uint64_t models, colors; /* colours before the reduction */
    double delta_mean, delta_max;
} fmt_vox_report;
svo_result fmt_cells_vox(const fmt_cells *c, fmt_output *out, fmt_vox_report *report, svo_error *err);

/* All cells of low..high, x fastest, one byte (0 or 255) or four (R G B 255, or 0 0 0 0). With a NRRD header ("raw" has none). Memory: the
 * volume. */
svo_result fmt_cells_dense(const fmt_cells *c, bool rgba, bool header, fmt_output *out, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
