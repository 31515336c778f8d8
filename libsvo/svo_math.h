/* Small double-precision vectors and 4x4 matrices. Matrices are row-major and act on column vectors: p' = M p. */
#ifndef SVO_MATH_H
#define SVO_MATH_H

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct svo_vec3 { double x, y, z; } svo_vec3;
typedef struct svo_mat4 { double m[16]; } svo_mat4; /* m[4 * row + column] */

static inline svo_vec3 svo_v3(double x, double y, double z) { svo_vec3 v = {x, y, z}; return v; }
static inline svo_vec3 svo_add(svo_vec3 a, svo_vec3 b) { return svo_v3(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline svo_vec3 svo_sub(svo_vec3 a, svo_vec3 b) { return svo_v3(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline svo_vec3 svo_scale(svo_vec3 a, double s) { return svo_v3(a.x * s, a.y * s, a.z * s); }
static inline double svo_dot(svo_vec3 a, svo_vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline svo_vec3 svo_cross(svo_vec3 a, svo_vec3 b)
{
    return svo_v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
double svo_length(svo_vec3 a);
/* Unit vector; the zero vector (or one that is not finite) gives zero. Does not overflow for large components. */
svo_vec3 svo_normalize(svo_vec3 a);

svo_mat4 svo_mat4_identity(void);
svo_mat4 svo_mat4_mul(svo_mat4 a, svo_mat4 b);
svo_vec3 svo_mat4_point(const svo_mat4 *m, svo_vec3 p);  /* affine: the last row is taken as 0 0 0 1 */
svo_vec3 svo_mat4_vector(const svo_mat4 *m, svo_vec3 v); /* without translation */
/* Determinant of the upper-left 3x3. */
double svo_mat4_det3(const svo_mat4 *m);
/* Normals map by the cofactor matrix of the upper-left 3x3 (= det * inverse transpose), which exists for singular
 * matrices too. Result is not normalised; a reflection keeps the side that the mapped surface has. */
svo_vec3 svo_mat4_normal(const svo_mat4 *m, svo_vec3 n);
/* Inverse of an affine matrix; false (and *out untouched) when it is singular or not finite. */
bool svo_mat4_affine_inverse(const svo_mat4 *m, svo_mat4 *out);
/* Translation * rotation (unit quaternion x y z w, normalised here; zero = identity) * scale. */
svo_mat4 svo_mat4_trs(const double t[3], const double q[4], const double s[3]);

#ifdef __cplusplus
}
#endif
#endif
