/* .skel: a curve skeleton with the map from the model to its joints; docs/format/skel.md is normative. */
#ifndef FMT_SKEL_H
#define FMT_SKEL_H

#include "fmt_container.h"
#include "skel_build.h"

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

/* The curve as text (`v x y z`, `l a b` for each bone, `p a` for a joint without bones), numbers with 17 digits. */
svo_result fmt_export_skel_obj(fmt_output *out, const skel_skeleton *s, svo_error *err);

/* The curve as binary glTF 2.0: one mesh, one primitive of mode LINES with f32 positions (relative to the node's
 * translation, so that a large offset costs no precision), and one of mode POINTS for joints without bones. */
svo_result fmt_export_skel_glb(fmt_output *out, const skel_skeleton *s, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
