/* A pose of a scene description. */
#ifndef FMTI_POSE_JSON_H
#define FMTI_POSE_JSON_H

#include <jansson.h>

#include "svo_alloc.h"
#include "svo_pose.h"

/* Where and why a pose is refused; static text. */
typedef struct fmti_pose_fault { char key[64]; const char *what; } fmti_pose_fault;

/* Bones have numbers below this. */
enum { FMTI_POSE_BONES = 65536 };

/* The time of an animation that a pose asks for. */
typedef struct fmti_pose_clip {
    bool given;
    char animation[128]; /* name or number; "": the first one */
    double time;         /* seconds */
} fmti_pose_clip;

/* Parse a JSON object as docs/tools/svo-pack.md says, as stated (svo_pose_resolve). Matrices are appended to `matrices` (12 floats each). SVO_INVALID_DATA with
 * *fault, or SVO_OUT_OF_MEMORY. `name` (may be NULL): where the value of the key "name" goes, which is refused without it. */
svo_result fmti_pose_parse(const json_t *o, svo_buffer *matrices, svo_pose *out, fmti_pose_clip *clip, const char **name, fmti_pose_fault *fault);

#endif
