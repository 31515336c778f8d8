/* Rows of points, between fmt_points.c and the reader of text. Internal to formats/. */
#ifndef IMPORT_POINTS_H
#define IMPORT_POINTS_H

#include "import_ply.h"

/* What a column can hold. */
enum { POINT_X, POINT_Y, POINT_Z, POINT_R, POINT_G, POINT_B, POINT_NX, POINT_NY, POINT_NZ, POINT_I, POINT_SLOTS };

typedef struct point_column {
    int slot; /* -1: none */
    ply_type type;
    uint32_t offset;
} point_column;

typedef struct point_rows {
    bool ascii, big;
    bool free_text; /* no PLY: comments, counts and names between the rows */
    bool has[POINT_SLOTS];
    uint32_t column_count;
    uint64_t stride;
    point_column columns[PLY_MAX_PROPERTIES];
} point_rows;

/* A row as it is in the file; what it does not have is 0. */
typedef struct point_raw {
    double at[3];
    float more[7]; /* r g b nx ny nz i */
} point_raw;

/* What the columns of a text are: as asked for, or guessed from its first thousand rows; `told` receives it as text. */
svo_result import_points_columns(point_rows *rows, const char *path, const uint8_t *data, uint64_t size, const char *asked, char told[48], svo_error *err);
/* Read the lines of about a mebibyte from *p on and move it; at most *left rows, which is lowered. Nothing is appended at the end only; for a PLY, an end before *left is 0 is
 * SVO_INVALID_DATA. */
svo_result import_points_text(const point_rows *rows, const char *path, const uint8_t *base, const uint8_t **p, const uint8_t *end, uint64_t *left, uint32_t threads,
                              svo_buffer *out, svo_error *err);

#endif
