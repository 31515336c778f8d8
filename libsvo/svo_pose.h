/* Poses: how an instance's shape is deformed before it is placed. A pose maps points of the asset's mesh coordinates to points of
 * the same coordinates:
 *     posed(p) = bend(twist(matrix * bone(p)))
 * each part being there only if its flag is set. Every part is continuous in p (bones: see svo_deform.h), so a shape never tears. */
#ifndef SVO_POSE_H
#define SVO_POSE_H

#include "svo_math.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_NO_POSE UINT32_MAX

enum {
    SVO_POSE_TWIST = 1,  /* turns slices across twist_axis about the line through the pivot along it */
    SVO_POSE_BEND = 2,   /* bends the line through the pivot along bend_axis to an arc of the same length, towards bend_towards */
    SVO_POSE_MATRIX = 4, /* shear, scale, anything affine; may be singular or mirror */
    SVO_POSE_BONES = 8,  /* a matrix for each bone of the channel `bone` */
    SVO_POSE_FLAGS = 15
};

/* As it lies in a file (POSE, docs/format/svscene.md). Axes are 0, 1, 2 for x, y, z. Positions along an axis are relative to the pivot; the
 * angle (radians) grows evenly from 0 at `from` to the whole at `to` and stays the same beyond both ends, so that what lies outside
 * follows as a rigid piece. Fields of parts that are not there are 0. */
typedef struct svo_pose {
    uint32_t flags;
    uint8_t twist_axis, bend_axis, bend_towards, zero;
    float pivot[3];
    float twist_from, twist_to, twist_angle; /* from < to */
    float bend_from, bend_to, bend_angle;    /* from < to; bend_towards != bend_axis */
    uint32_t matrix;                         /* number of a matrix */
    uint32_t bone_first, bone_count;         /* matrices of bones 0 .. bone_count - 1; bones beyond them rest */
    uint32_t unused[2];                      /* 0 */
} svo_pose;

/* All poses of a scene. Matrices are 3x4, row-major, mesh coordinates to mesh coordinates, finite. */
typedef struct svo_poses {
    uint32_t count;
    const svo_pose *pose;
    uint64_t matrix_count;
    const float *matrix; /* 12 each */
} svo_poses;

/* What is wrong with a pose (static text), NULL when nothing is. */
const char *svo_pose_fault(const svo_poses *all, const svo_pose *pose);

/* Does it leave every point where it is? */
bool svo_pose_is_rest(const svo_poses *all, const svo_pose *pose);

/* Matrix number i of a set in double precision. */
svo_mat4 svo_pose_matrix(const svo_poses *all, uint64_t i);

/* Matrix m (12 floats) for coordinates that are moved by `shift` (p' = p + shift), in place. The rounding is that of single precision at the size of the
 * coordinates. (A pose's pivot moves with the coordinates: add the shift to it.) */
void svo_pose_shift(float *m, const double shift[3]);
bool svo_pose_matrix_is_identity(const float *m);

/* A pose as people state it has positions in mesh coordinates (the pivot, from and to), NaN where they follow from the bounds of the shape: the pivot is
 * their middle, a range their extent along the axis. This makes it one as above; a range without length gets one of 1. */
void svo_pose_resolve(svo_pose *pose, const double low[3], const double high[3]);
/* Stated: nothing but NaNs and flags 0. */
svo_pose svo_pose_stated(void);

#ifdef __cplusplus
}
#endif
#endif
