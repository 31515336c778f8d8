/* PLY's header and its scalar values. Internal to formats/. */
#ifndef IMPORT_PLY_H
#define IMPORT_PLY_H

#include "import_soup.h"

typedef enum ply_type { PLY_NONE, PLY_I8, PLY_U8, PLY_I16, PLY_U16, PLY_I32, PLY_U32, PLY_F32, PLY_F64 } ply_type;

enum { PLY_MAX_ELEMENTS = 32, PLY_MAX_PROPERTIES = 128 };

/* What a property means to us; slots 0..11 are values of a vertex in this order. */
typedef enum ply_use {
    PLY_X, PLY_Y, PLY_Z, PLY_NX, PLY_NY, PLY_NZ, PLY_U, PLY_V, PLY_R, PLY_G, PLY_B, PLY_A, PLY_VALUES,
    PLY_INDICES, PLY_TEXCOORD, PLY_TEXNUMBER, PLY_STRIPS, PLY_INTENSITY, PLY_OTHER
} ply_use;

typedef struct ply_property {
    ply_type list;  /* type of the length; PLY_NONE: a scalar */
    ply_type type;
    ply_use use;
} ply_property;

typedef enum ply_kind { PLY_VERTEX, PLY_FACE, PLY_TRISTRIPS, PLY_SKIPPED } ply_kind;

typedef struct ply_element {
    ply_kind kind;
    char name[32];
    uint64_t count;
    uint32_t property_count;
    ply_property properties[PLY_MAX_PROPERTIES];
} ply_element;

typedef struct ply_lines ply_lines;

typedef struct ply_reader {
    const import_context *c;
    import_soup soup;
    const uint8_t *p, *end;
    bool ascii, big_endian;
    uint32_t element_count;
    ply_element elements[PLY_MAX_ELEMENTS];
    svo_buffer list; /* double: values of the list just read */
    ply_lines *lines; /* of ASCII rows, once an element was read by them */
    uint64_t first_row; /* of the window that is read */
    bool irregular;   /* ASCII rows are not one a line from here on */
} ply_reader;

/* Reads up to and with end_header; texture files go into soup.images. */
svo_result ply_read_header(ply_reader *r, svo_error *err);
uint32_t ply_type_size(ply_type t);
bool ply_is_integer(ply_type t);
/* A binary value; big: big-endian. */
double ply_load(const uint8_t *p, ply_type type, bool big);

/* Read the vertices or faces at r->p in parallel. *done is false, and r->p and the soup are as before, when that is not possible. */
svo_result ply_read_fast(ply_reader *r, const ply_element *e, bool *done, svo_error *err);
void ply_lines_free(ply_reader *r);
void ply_warn_extra(const ply_reader *r); /* more on a line than the header says */

#endif
