/* What all importers share: the context of one import, files beside the model, images, polygons, exact-size arrays.
 * Internal to formats/. */
#ifndef IMPORT_COMMON_H
#define IMPORT_COMMON_H

#include "fmt_file.h"
#include "fmt_import.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { IMPORT_PATH_MAX = 4096 };

typedef struct import_context {
    const char *path;              /* as the user gave it, for messages */
    char folder[IMPORT_PATH_MAX];  /* with a trailing '/', "" for the current folder */
    const svo_allocator *allocator;
    svo_warnings *warnings;
    uint64_t max_file_bytes, max_image_pixels;
    uint32_t threads;     /* 0 = all */
    uint64_t block_bytes; /* as in fmt_import_options */
    bool skip_images;
    uint32_t without; /* FMT_WITHOUT_... */
    fmt_file_read_fn file_read; /* may be NULL */
    void *file_read_user;
    const svo_spill *spill; /* may be NULL */
    uint64_t memory;        /* what a spilling import may take, about */
    struct fmt_rig *rig;    /* may be NULL */
    const char *animation;  /* may be NULL */
    double time;
    svo_pager *pager;       /* may be NULL */
    bool spilling;          /* read window by window into the spill */
    bool mapped;            /* the model's bytes are a mapped file */
    svo_buffer *opened;     /* import_opened: every file that was opened, to look at again in the end; NULL: not noted */
} import_context;

typedef struct import_opened {
    char *path;
    fmt_bytes file; /* what it was when it was opened; without its bytes */
} import_opened;

/* --- files beside the model --- */
/* `reference` as a path below the model's folder. '\' counts as '/'. INVALID_DATA for what would leave the folder
 * ("..", absolute, drive letter, URL) or is empty or too long. */
svo_result import_resolve(const import_context *c, const char *reference, char path[IMPORT_PATH_MAX], svo_error *err);
/* A forgiving look-up for OBJ and PLY, whose references are typed by hand or by other systems: the path as it is, then
 * without regard to case, then its last component beside the model (also for references that leave the folder).
 * False when there is no such file; never a path outside the folder. */
bool import_find(const import_context *c, const char *reference, char path[IMPORT_PATH_MAX]);

/* fmt_bytes_open within the context's limits, and tell file_read. All importers open files with it alone. */
svo_result import_open(const import_context *c, const char *path, fmt_bytes *out, svo_error *err);
/* SVO_IO when one of the files opened so far has changed since. */
svo_result import_unchanged(const import_context *c, svo_error *err);
void import_opened_free(svo_buffer *opened);

/* Least part of a text of `size` bytes that is read on its own: not so small that the bookkeeping of blocks counts. */
uint64_t import_block_bytes(const import_context *c, uint64_t size);

/* A spilling import has read the model's bytes up to p: they need not stay in memory. */
void import_forget(const import_context *c, const void *begin, const void *p);

/* --- images --- */
typedef struct import_images {
    svo_buffer list; /* svo_image */
    svo_buffer keys; /* import_image_key, also for images that failed */
} import_images;
void import_images_init(import_images *images, const import_context *c);
void import_images_free(import_images *images);
/* An encoded image, and what became of it: SVO_IO where there is no room for temporary files. mapped: as in fmt_bytes. */
typedef struct import_image_job {
    const uint8_t *bytes;
    uint64_t size;
    bool mapped;
    svo_image image; /* set where result is SVO_OK */
    svo_result result;
    svo_error why;
} import_image_job;
/* Decode them, several at a time. With a pager one after the other: what it keeps in memory depends on the order. */
void import_images_decode(const import_context *c, import_image_job *jobs, uint64_t count);
/* Append a decoded image, which is taken over, also on failure. *index is its place. */
svo_result import_image_add(import_images *images, const import_context *c, const char *name, svo_image *image, uint32_t *index, svo_error *err);
/* The image that a reference names, read once; SVO_NONE with a warning when it is missing or broken. Only want of memory and of room for
 * temporary files are errors. alpha_only: SVO_NONE, too, where it has no alpha, if that can be told without decoding it. */
svo_result import_image_find(import_images *images, const import_context *c, const char *reference, bool alpha_only, uint32_t *index, svo_error *err);
/* Read what will be asked for in this way, all at a time. */
typedef struct import_wish { const char *reference; bool alpha_only; } import_wish;
svo_result import_images_read(import_images *images, const import_context *c, const import_wish *wishes, uint64_t count, svo_error *err);
/* Move into the mesh. */
svo_result import_images_finish(import_images *images, svo_mesh *mesh, svo_error *err);

/* --- arrays --- */
svo_result import_no_memory(svo_error *err);
/* The buffer's content in an array of exactly count elements of elem bytes, as svo_mesh_free expects (NULL for 0);
 * the buffer is emptied. */
svo_result import_exact(svo_buffer *b, size_t elem, void **out, uint64_t *count, svo_error *err);

/* A mesh of one shape with one instance at the origin, of parts that are taken over (array allocated with exactly
 * part_count elements). mesh->allocator is set; name is the file's last component. On failure the parts are freed. */
svo_result import_single_shape(const import_context *c, svo_part *parts, uint32_t part_count, svo_mesh *mesh, svo_error *err);
void import_part_free(const svo_allocator *a, svo_part *part);

/* --- polygons --- */
/* n >= 3 corners with positions 3 * corner index doubles each; writes n - 2 triangles of corner numbers 0..n-1.
 * Rule: a triangle as it is; a quad is cut from its first corner unless that leaves the quad, then by the other
 * diagonal; larger polygons as a fan from the first corner where they are convex on the plane in which their area is
 * largest, else by ear clipping on that plane. Where ears run out (self-crossing, flat) or the work is beyond a bound
 * of 1024 tests a corner, the rest becomes a fan and *fanned is set. `scratch` is reused between calls. */
svo_result import_triangulate(const double *positions, uint32_t n, uint32_t *triangles, svo_buffer *scratch, bool *fanned,
                              svo_error *err);

/* sRGB (0..1, clamped; NaN gives 1) to linear. */
float import_srgb_to_linear(double v);

/* --- the formats; `bytes` is the whole file --- */
typedef svo_result import_reader(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err);
import_reader import_obj, import_ply, import_stl, import_off;
/* C++ adapters */
import_reader import_gltf, import_drc;

#ifdef __cplusplus
}
#endif
#endif
