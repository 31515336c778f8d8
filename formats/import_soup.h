/* Vertices and polygons as PLY and OFF list them, before they become parts. Internal to formats/. */
#ifndef IMPORT_SOUP_H
#define IMPORT_SOUP_H

#include "import_store.h"

/* Optional arrays are empty or complete. Colours are linear RGBA, uvs have their origin at the top left. */
typedef struct import_soup {
    svo_buffer positions;   /* double 3 a vertex */
    svo_buffer normals;     /* float 3 a vertex */
    svo_buffer uvs;         /* float 2 a vertex */
    svo_buffer colors;      /* float 4 a vertex */
    svo_buffer corners;     /* uint32_t, < vertex count always */
    svo_buffer sizes;       /* uint32_t corners of each face */
    svo_buffer corner_uvs;  /* float 2 a corner */
    svo_buffer face_colors; /* float 4 a face */
    svo_buffer face_images; /* uint32_t a face: index into images */
    svo_buffer images;      /* char *: texture files; each becomes a material */
    import_store *store;    /* not NULL: soup_flush moves the arrays above there, but images */
    bool any_face_color, any_corner_uvs, any_face_images; /* in the store */
    bool short_faces;       /* some had fewer than three corners and were left out */
} import_soup;

void soup_init(import_soup *s, const import_context *c);
void soup_free(import_soup *s);
/* Spill from now on. `c` must outlive the soup. */
svo_result soup_spill(import_soup *s, const import_context *c, svo_error *err);
/* What has been read since the last time goes to the store; nothing happens without one. */
svo_result soup_flush(import_soup *s, svo_error *err);
uint64_t soup_vertex_count(const import_soup *s); /* with those in the store */
/* (With a store, colours are as in the file, and the store's scales say what they mean.) One mesh of it: shared vertices where faces carry nothing of their own, else one vertex a corner. Vertex colours win
 * over face colours. */
svo_result soup_build(import_soup *s, const import_context *c, svo_mesh *mesh, svo_error *err);

#endif
