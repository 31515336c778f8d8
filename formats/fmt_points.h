/* Files of points: PLY without faces, and text with a point a line (.xyz .pts .xyzn .xyzrgb .asc). docs/tools/formats.md says what is taken from them. */
#ifndef FMT_POINTS_H
#define FMT_POINTS_H

#include "fmt_file.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Is it one, by its first bytes (PLY) or its name (text)? False also for what cannot be read. */
bool fmt_is_points(const char *path);

typedef struct fmt_point {
    double at[3];
    float color[3];  /* linear light, 0..1 */
    float normal[3]; /* as in the file: any length */
    float intensity; /* as in the file */
    uint32_t has;    /* SVO_SAMPLE_ bits: what this point has; not a colour that is NaN, a normal of no length */
} fmt_point;

typedef struct fmt_points_options {
    const char *columns; /* of text: names x y z r g b nx ny nz i, or - for what is not wanted, with commas between; NULL: guessed */
    uint32_t threads;    /* 0 = all; the result does not depend on it */
    const svo_allocator *allocator;
    svo_warnings *warnings; /* may be NULL */
    fmt_file_read_fn file_read; /* as in fmt_import_options */
    void *file_read_user;
} fmt_points_options;

/* What is in a file, from a first reading of all of it. */
typedef struct fmt_points_survey {
    uint64_t points, not_finite; /* not_finite: without a place; they are left out */
    double low[3], high[3];      /* of the others, when there are any */
    bool has_color, has_normal, has_intensity;
    bool one_color;
    float color[3]; /* of the first point, linear */
    double intensity_low, intensity_high; /* of finite ones */
    bool intensity_bytes;                 /* stored as unsigned bytes */
    char columns[48];                     /* how the columns of a text were taken; "" of PLY */
} fmt_points_survey;

typedef struct fmt_points fmt_points;
/* Map a file and read all of it once. SVO_IO; SVO_INVALID_DATA for a damaged file or a row that is none, SVO_UNSUPPORTED for a PLY whose points have lists,
 * SVO_INVALID_ARGUMENT for columns that are not there; SVO_OUT_OF_MEMORY. *out is freed by fmt_points_close, also after an error of the second reading. */
svo_result fmt_points_open(const char *path, const fmt_points_options *options, fmt_points **out, svo_error *err);
const fmt_points_survey *fmt_points_seen(const fmt_points *p);

/* The second reading: the next of the finite points, in the order of the file; *count 0 at the end. They stay valid until the next call, and take at most
 * FMT_POINTS_WINDOW bytes unless a line of text is longer than that. */
#define FMT_POINTS_WINDOW ((uint64_t)32 << 20)
svo_result fmt_points_next(fmt_points *p, const fmt_point **out, uint64_t *count, svo_error *err);
/* SVO_IO when the file has changed since it was opened. */
svo_result fmt_points_unchanged(const fmt_points *p, svo_error *err);
void fmt_points_close(fmt_points *p);

#ifdef __cplusplus
}
#endif
#endif
