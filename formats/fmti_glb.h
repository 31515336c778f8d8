/* Inside formats: a binary glTF 2.0 file as it is put together. One buffer; views and accessors in order of their making. */
#ifndef FMTI_GLB_H
#define FMTI_GLB_H

#include <jansson.h>

#include "fmt_container.h"
#include "fmt_file.h"
#include "svo_mesh.h"

enum {
    GLB_ARRAY_BUFFER = 34962, GLB_ELEMENT_ARRAY_BUFFER = 34963, GLB_NO_TARGET = 0,
    GLB_U8 = 5121, GLB_U16 = 5123, GLB_U32 = 5125, GLB_F32 = 5126,
    GLB_POINTS = 0, GLB_LINES = 1
};

typedef struct fmt_glb {
    svo_buffer bytes;
    json_t *root, *views, *accessors; /* root: {asset, ...}; all NULL when out of memory */
    uint64_t json_failures; /* fmt_json_failures() at the beginning */
    bool failed;
} fmt_glb;

void fmt_glb_begin(fmt_glb *g, const svo_allocator *a);
/* Room for `count` elements of `stride` bytes (a multiple of 4), zeroed, in a view of their own, with an accessor; NULL when out of memory or when
 * the file gets larger than 32 bits can say (then failed is set). Where pointers: valid until the next call. *accessor is its number. */
uint8_t *fmt_glb_array(fmt_glb *g, uint64_t count, uint32_t stride, int component, const char *type, int target, uint64_t *accessor);
/* Bytes in a view of their own, without accessor; false (and failed is set) as above. */
bool fmt_glb_view(fmt_glb *g, const void *bytes, uint64_t size, uint64_t *view);
/* An accessor without a view, for what an extension decodes. */
uint64_t fmt_glb_accessor(fmt_glb *g, uint64_t count, int component, const char *type, bool normalized);
/* Name an extension in extensionsUsed (and, where no reader can do without it, extensionsRequired). */
void fmt_glb_extension(fmt_glb *g, const char *name, bool required);
/* Bounds of an accessor, which positions must have; low and high have `n` numbers. */
void fmt_glb_bounds(fmt_glb *g, uint64_t accessor, const float *low, const float *high, int n);
/* Write header, JSON and buffer, after "accessors", "bufferViews" and "buffers" were added to root. */
svo_result fmt_glb_write(fmt_glb *g, fmt_output *out, svo_error *err);
void fmt_glb_end(fmt_glb *g);

/* (fmt_export_materials.c) Materials as glTF has them: factors, textures with their transforms, images as PNG. plain: one more, white and not metallic, for parts without
 * material (glTF's own default is metal, which is black where nothing is around it). */
svo_result fmt_glb_materials(fmt_glb *g, const svo_mesh *mesh, bool plain, svo_warnings *warnings, svo_error *err);

json_t *fmt_glb_vector(const double *v, int n);
void fmt_glb_put_f32(uint8_t *p, float v);

#endif
