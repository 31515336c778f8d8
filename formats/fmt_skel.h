/* .skel: a curve skeleton with the map from the model to its joints; docs/format/skel.md is normative. */
#ifndef FMT_SKEL_H
#define FMT_SKEL_H

#include "fmt_container.h"
#include "skel_build.h"
#include "skel_segment.h"
#include "skel_skin.h"
#include "skel_solid.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Write a skeleton. `provenance` is JSON text (no paths, times, thread counts) or NULL. The output is committed by the
 * caller. SVO_INVALID_ARGUMENT when the skeleton breaks a rule. */
svo_result fmt_skel_write(fmt_output *out, const skel_skeleton *s, const char *provenance, svo_error *err);

/* Read a whole .skel (64-byte aligned bytes, borrowed for the call) and check every rule. Of the report, what the file
 * holds is filled in. *provenance (may be NULL) is the JSON text of META or "", freed with fmt_meta_free(a, ...). */
svo_result fmt_skel_read(const uint8_t *data, uint64_t size, const svo_allocator *a, skel_skeleton *out, char **provenance,
                         svo_error *err);

/* Everything that is wrong with the file goes to `rules`, as in fmt_svdag_violations. */
svo_result fmt_skel_violations(const uint8_t *data, uint64_t size, const svo_allocator *a, svo_rules *rules, svo_error *err);

/* The curve as text (`v x y z`, `l a b` for each bone, `p a` for a joint without bones), numbers with 17 digits. */
svo_result fmt_export_skel_obj(fmt_output *out, const skel_skeleton *s, svo_error *err);

/* The curve as binary glTF 2.0: one mesh, one primitive of mode LINES with f32 positions (relative to the node's
 * translation, so that a large offset costs no precision), and one of mode POINTS for joints without bones. */
svo_result fmt_export_skel_glb(fmt_output *out, const skel_skeleton *s, svo_error *err);

/* What Draco made of a mesh. */
typedef struct fmt_draco_report {
    uint64_t plain_bytes, bytes; /* of vertices and triangles, before (weights in 4 bytes) and after */
    bool measured; /* errors but the weights' were measured on what is decoded; else they are what the quantization allows */
    double position_error; /* largest distance, in the model's coordinates */
    double normal_error;   /* degrees */
    double uv_error, color_error, weight_error; /* largest difference of a number */
} fmt_draco_report;

/* The mesh with its skeleton as skinned binary glTF 2.0: joints are nodes joint_0, joint_1 ... in the trees of `tree` (each with its radius in extras) below
 * one node "skeleton"; inverse bind matrices; JOINTS_0 and WEIGHTS_0 (and _1 for more than 4 influences). Instances are placed in the world. Normals, vertex
 * colours, texture coordinates and materials are kept with their textures (base colour, metallic-roughness, emissive; as PNG).
 * draco_bits 8 to 24: the mesh is compressed by Draco (KHR_draco_mesh_compression), positions to so many bits, joints exactly, weights in bytes that add up to 255;
 * *report (may be NULL) tells the errors. 0: it is not. SVO_LIMIT beyond 65535 joints, 4 GB or 32-bit floats. */
svo_result fmt_export_skinned_glb(fmt_output *out, const svo_mesh *mesh, const skel_skeleton *s, const skel_tree *tree, const skel_skin *weights, uint32_t draco_bits,
                                  fmt_draco_report *report, svo_warnings *warnings, svo_error *err);

/* The curve as SWC: number, type 0, x y z, radius, parent or -1. Bones that close a loop are left out and counted in a comment. */
svo_result fmt_export_skel_swc(fmt_output *out, const skel_skeleton *s, const skel_tree *tree, svo_error *err);

/* A reconstructed surface as binary PLY: x y z (double), invented (uchar: 1 where a hole was closed); triangles. */
svo_result fmt_export_closed_ply(fmt_output *out, const skel_closed *c, svo_error *err);

/* The surface in segments as binary PLY: vertices (x y z double, red green blue, segment; one for each segment that meets there), triangles (with red green blue, segment,
 * bone or -1). Triangles that the skeleton dropped are left out. */
svo_result fmt_export_segments_ply(fmt_output *out, const skel_segments *s, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
