/* The OBJ importer's inner data: what the file says, before it becomes parts. Internal to formats/. */
#ifndef IMPORT_OBJ_H
#define IMPORT_OBJ_H

#include "import_store.h"

/* Zero-based indices; SVO_NONE where a corner has no texture coordinate or normal. */
typedef struct obj_corner {
    uint32_t v, vt, vn;
} obj_corner;

/* Everything drawn with one material name, in file order. */
typedef struct obj_group {
    char *material; /* NULL: before any usemtl */
    obj_corner *corners;
    uint32_t *sizes; /* corners of each face */
    uint64_t corner_count, face_count;
    uint32_t resolved; /* index into the materials */
    /* what has gone to the store */
    uint64_t stored_faces;
    uint32_t least_vt, least_vn;
} obj_group;

/* Numbers of the file that corners refer to. */
enum { OBJ_V, OBJ_VT, OBJ_VN, OBJ_KINDS };
typedef struct obj_values {
    double *positions; /* 3 each */
    float *uvs;        /* 2 each, v as in the file */
    float *normals;    /* 3 each */
    uint64_t count[OBJ_KINDS];
    uint64_t origin[OBJ_KINDS]; /* number of the first: those before are in the store */
} obj_values;

/* What is left out, told once a file. */
typedef enum obj_oddity { OBJ_SHORT_FACES, OBJ_POINTS, OBJ_CURVES, OBJ_ODDITIES } obj_oddity;

/* A line that is kept for later, and the faces after it: each block begins with an OBJ_INHERIT. */
typedef enum obj_event_kind { OBJ_INHERIT, OBJ_USEMTL, OBJ_MTLLIB } obj_event_kind;
typedef struct obj_event {
    obj_event_kind kind;
    size_t name, length;     /* in obj_block.names */
    uint64_t corners, faces; /* of the block before it */
    uint64_t to_corner, to_face; /* where they go in their group */
    uint32_t group;
} obj_event;

/* A part of the text that begins at a line which does not continue another, so that blocks can be read in parallel: first
 * all are counted, which places their numbers in the arrays of the whole, then all are read. */
typedef struct obj_block {
    const import_context *context;
    const char *begin, *end;
    uint64_t first_line, lines; /* 1-based; lines in the block */
    uint64_t count[OBJ_KINDS], first[OBJ_KINDS], done[OBJ_KINDS];
    uint64_t face_lines;
    const obj_values *values;
    svo_buffer corners; /* obj_corner */
    svo_buffer sizes;   /* uint32_t corners of each face */
    svo_buffer colors;  /* float 3 of the block's first vertices, empty when none has a colour */
    svo_buffer events;  /* obj_event */
    svo_buffer names;
    svo_buffer joined;  /* a line put together from continued ones */
    bool large_colors;  /* a component above 1 was seen */
    obj_oddity odd[OBJ_ODDITIES]; /* in the order of their first line */
    uint32_t odd_count;
} obj_block;

void obj_block_init(obj_block *b, const import_context *c);
void obj_block_free(obj_block *b);
/* Where the line that [p, ...) is in, and what continues it, ends. */
const char *obj_line_end(const char *begin, const char *p, const char *end);
svo_result obj_block_count(obj_block *b, svo_error *err);
svo_result obj_block_read(obj_block *b, svo_error *err);

typedef struct obj_file {
    const import_context *context;
    obj_values values;
    float *colors;        /* 3 each of the first vertices, NULL when there is none */
    uint64_t color_count;
    svo_buffer groups;    /* obj_group */
    svo_buffer slots;     /* uint32_t: hash table over groups by name */
    svo_buffer libraries; /* char *: mtllib names, each once */
    uint32_t current;     /* group */
    bool large_colors;
    bool told[OBJ_ODDITIES];
    uint64_t lines;       /* before the text that is read */
    import_store *store;  /* NULL: everything stays in memory */
    uint32_t most_vt, most_vn; /* that any corner in the store refers to */
} obj_file;

/* Materials of a library, by name (the last of the same name counts). */
typedef struct mtl_set {
    svo_buffer list; /* svo_material, name never NULL */
    import_images images;
} mtl_set;

void mtl_init(mtl_set *set, const import_context *c);
void mtl_free(mtl_set *set);
svo_result mtl_read(mtl_set *set, const import_context *c, const uint8_t *bytes, uint64_t size, svo_error *err);

/* A spilling import: what a window of the text gave goes to the store; then the mesh of all of it. */
svo_result obj_spill_window(obj_file *f, svo_error *err);
svo_result obj_build_spilled(obj_file *f, mtl_set *materials, svo_mesh *mesh, svo_error *err);
/* The last definition of a name counts, as with programs that read the library line by line. SVO_NONE: none. */
uint32_t obj_find_material(const mtl_set *set, const char *name);
/* Triangulate, unify corners, build the parts; takes materials and images over. */
svo_result obj_build(obj_file *f, mtl_set *materials, svo_mesh *mesh, svo_error *err);

#endif
