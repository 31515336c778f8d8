/* Inside formats: a mesh to Draco bytes, for glTF's KHR_draco_mesh_compression. */
#ifndef FMTI_DRACO_H
#define FMTI_DRACO_H

#include "svo_alloc.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum fmt_draco_kind { FMT_DRACO_POSITION, FMT_DRACO_NORMAL, FMT_DRACO_COLOR, FMT_DRACO_TEXCOORD, FMT_DRACO_GENERIC } fmt_draco_kind;
typedef enum fmt_draco_type { FMT_DRACO_F32, FMT_DRACO_U8, FMT_DRACO_U16 } fmt_draco_type;

enum { FMT_DRACO_ATTRIBUTES = 12 };

/* Numbers are kept as they are with bits 0, and integers always. The unique id of an attribute is its place in the list. */
typedef struct fmt_draco_attribute {
    fmt_draco_kind kind;
    fmt_draco_type type;
    uint32_t components, bits;
    const void *values; /* components * vertices */
    /* Of the numbers that a decoder gives: */
    double low[4], high[4];
    double error; /* largest difference; normals: of directions, in degrees; positions: distance */
} fmt_draco_attribute;

typedef struct fmt_draco_arrays {
    uint64_t vertices, triangles;
    const uint32_t *corner; /* 3 each */
    uint32_t attribute_count;
    fmt_draco_attribute attribute[FMT_DRACO_ATTRIBUTES]; /* the first one is the position */
    /* What a decoder gives: vertices without triangles and triangles without area may be missing, vertices that are equal in everything be one. */
    uint64_t decoded_vertices, decoded_triangles;
    bool measured; /* errors are differences between decoded and given numbers; else what the quantization allows */
} fmt_draco_arrays;

/* Append the bytes to *to (a multiple of 4 is not seen to), decode them again and measure. Meshes that Draco's edgebreaker refuses are written sequentially.
 * SVO_LIMIT from 2^31 vertices or triangles on; SVO_RUNTIME when Draco fails; SVO_OUT_OF_MEMORY. One thread. */
svo_result fmt_draco_pack(fmt_draco_arrays *mesh, svo_buffer *to, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
