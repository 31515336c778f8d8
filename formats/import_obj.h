/* The OBJ importer's inner data: what the file says, before it becomes parts. Internal to formats/. */
#ifndef IMPORT_OBJ_H
#define IMPORT_OBJ_H

#include "import_common.h"

/* Zero-based indices; SVO_NONE where a corner has no texture coordinate or normal. */
typedef struct obj_corner {
    uint32_t v, vt, vn;
} obj_corner;

/* Everything drawn with one material name, in file order. */
typedef struct obj_group {
    char *material; /* NULL: before any usemtl */
    svo_buffer corners; /* obj_corner */
    svo_buffer sizes;   /* uint32_t corners of each face */
    uint32_t resolved;  /* index into the materials */
} obj_group;

typedef struct obj_file {
    const import_context *context;
    svo_buffer positions; /* double 3 */
    svo_buffer colors;    /* float 3 of the first vertices as in the file, empty when there is none */
    svo_buffer uvs;       /* float 2, v as in the file */
    svo_buffer normals;   /* float 3 */
    svo_buffer groups;    /* obj_group */
    svo_buffer slots;     /* uint32_t: hash table over groups by name */
    svo_buffer libraries; /* char *: mtllib names, each once */
    svo_buffer joined;    /* a line put together from continued ones */
    uint32_t current;     /* group */
    bool large_colors;    /* a component above 1 was seen */
} obj_file;

/* Materials of a library, by name (the last of the same name counts). */
typedef struct mtl_set {
    svo_buffer list; /* svo_material, name never NULL */
    import_images images;
} mtl_set;

void mtl_init(mtl_set *set, const import_context *c);
void mtl_free(mtl_set *set);
svo_result mtl_read(mtl_set *set, const import_context *c, const uint8_t *bytes, uint64_t size, svo_error *err);

/* Triangulate, unify corners, build the parts; takes materials and images over. */
svo_result obj_build(obj_file *f, mtl_set *materials, svo_mesh *mesh, svo_error *err);

#endif
