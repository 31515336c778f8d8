/* What importers do with a mesh that is larger than memory: the file is read window by window; vertices and faces of a window
 * go to spilled arrays; at the end faces are resolved piece by piece into triangles with corners of their own (svo_soup.h).
 * A piece's corners are sorted by vertex number before the vertex arrays are read, so that each piece reads the arrays at
 * most once from the beginning to the end, whatever the order of indices. Internal to formats/. */
#ifndef IMPORT_STORE_H
#define IMPORT_STORE_H

#include "import_common.h"
#include "svo_soup.h"

enum { STORE_POSITIONS, STORE_NORMALS, STORE_UVS, STORE_COLORS, STORE_ARRAYS };

/* How stored colours become linear: c / scale, sRGB to linear; alpha (of four components) as PLY and OFF mean it. */
typedef struct import_store {
    const import_context *c;
    svo_spill_file array[STORE_ARRAYS];
    uint64_t count[STORE_ARRAYS];
    uint32_t width[STORE_ARRAYS]; /* bytes an element */
    svo_spill_file faces;
    svo_buffer pieces;
    uint64_t corners_at_a_time;
    bool wide;            /* some position does not fit floats */
    double vertex_scale, face_scale; /* of colours */
    float most_vertex, most_face;    /* largest colour component seen */
    bool use_face_colors; /* those of faces count, not those of vertices */
    bool fanned, bad_color;
} import_store;

/* Faces of one part. Optional arrays are NULL. */
typedef struct store_faces {
    uint32_t part;           /* what they belong to, where there are no images */
    const uint32_t *corners; /* per_corner (1: v, 3: v, vt, vn) each; SVO_NONE where a corner has none */
    uint32_t per_corner;
    const uint32_t *sizes; /* >= 3 each */
    const float *uvs;      /* 2 a corner */
    const float *colors;   /* 4 a face */
    const uint32_t *images; /* a face: its part */
    uint64_t corner_count, face_count;
} store_faces;

/* color_width: floats of a vertex colour, 3 or 4. */
void store_init(import_store *s, const import_context *c, uint32_t color_width);
void store_free(import_store *s);
svo_result store_values(import_store *s, int array, const void *values, uint64_t count, svo_error *err);
svo_result store_add_faces(import_store *s, const store_faces *f, svo_error *err);

/* Resolve all faces: parts[i] gets the triangles of part i with the layout given. Corners without a texture coordinate or normal
 * get zeros. SVO_INVALID_DATA for a corner that refers to a position that does not exist. */
svo_result store_resolve(import_store *s, svo_part *parts, const svo_soup_layout *layouts, uint32_t part_count, svo_error *err);

#endif
