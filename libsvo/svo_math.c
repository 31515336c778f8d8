#include "svo_math.h"

#include <math.h>
#include <string.h>

double svo_length(svo_vec3 a) { return hypot(hypot(a.x, a.y), a.z); }

svo_vec3 svo_normalize(svo_vec3 a)
{
    double big = fmax(fabs(a.x), fmax(fabs(a.y), fabs(a.z)));
    if (!(big > 0) || !isfinite(big)) return svo_v3(0, 0, 0);
    /* Scale by a power of two first: exact, and squares neither overflow nor vanish. */
    int e;
    frexp(big, &e);
    svo_vec3 b = svo_v3(ldexp(a.x, -e), ldexp(a.y, -e), ldexp(a.z, -e));
    return svo_scale(b, 1.0 / sqrt(svo_dot(b, b)));
}

svo_mat4 svo_mat4_identity(void)
{
    svo_mat4 m = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
    return m;
}

svo_mat4 svo_mat4_mul(svo_mat4 a, svo_mat4 b)
{
    svo_mat4 r;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            double s = 0;
            for (int k = 0; k < 4; k++) s += a.m[4 * i + k] * b.m[4 * k + j];
            r.m[4 * i + j] = s;
        }
    return r;
}

svo_vec3 svo_mat4_point(const svo_mat4 *m, svo_vec3 p)
{
    const double *a = m->m;
    return svo_v3(a[0] * p.x + a[1] * p.y + a[2] * p.z + a[3], a[4] * p.x + a[5] * p.y + a[6] * p.z + a[7],
                  a[8] * p.x + a[9] * p.y + a[10] * p.z + a[11]);
}

svo_vec3 svo_mat4_vector(const svo_mat4 *m, svo_vec3 v)
{
    const double *a = m->m;
    return svo_v3(a[0] * v.x + a[1] * v.y + a[2] * v.z, a[4] * v.x + a[5] * v.y + a[6] * v.z,
                  a[8] * v.x + a[9] * v.y + a[10] * v.z);
}

static void cofactors(const double *a, double c[9])
{
    c[0] = a[5] * a[10] - a[6] * a[9], c[1] = a[6] * a[8] - a[4] * a[10], c[2] = a[4] * a[9] - a[5] * a[8];
    c[3] = a[2] * a[9] - a[1] * a[10], c[4] = a[0] * a[10] - a[2] * a[8], c[5] = a[1] * a[8] - a[0] * a[9];
    c[6] = a[1] * a[6] - a[2] * a[5], c[7] = a[2] * a[4] - a[0] * a[6], c[8] = a[0] * a[5] - a[1] * a[4];
}

double svo_mat4_det3(const svo_mat4 *m)
{
    double c[9];
    cofactors(m->m, c);
    return m->m[0] * c[0] + m->m[1] * c[1] + m->m[2] * c[2];
}

svo_vec3 svo_mat4_normal(const svo_mat4 *m, svo_vec3 n)
{
    double c[9];
    cofactors(m->m, c);
    /* The cofactor matrix maps cross products of mapped edges; a reflection turns the winding, so undo its sign. */
    double sign = m->m[0] * c[0] + m->m[1] * c[1] + m->m[2] * c[2] < 0 ? -1 : 1;
    return svo_v3(sign * (c[0] * n.x + c[1] * n.y + c[2] * n.z), sign * (c[3] * n.x + c[4] * n.y + c[5] * n.z),
                  sign * (c[6] * n.x + c[7] * n.y + c[8] * n.z));
}

bool svo_mat4_affine_inverse(const svo_mat4 *m, svo_mat4 *out)
{
    const double *a = m->m;
    double c[9];
    cofactors(a, c);
    double det = a[0] * c[0] + a[1] * c[1] + a[2] * c[2];
    if (det == 0 || !isfinite(det) || !isfinite(1 / det)) return false;
    svo_mat4 r = svo_mat4_identity();
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) r.m[4 * i + j] = c[3 * j + i] / det;
    svo_vec3 t = svo_mat4_vector(&r, svo_v3(a[3], a[7], a[11]));
    r.m[3] = -t.x, r.m[7] = -t.y, r.m[11] = -t.z;
    for (int i = 0; i < 16; i++)
        if (!isfinite(r.m[i])) return false;
    *out = r;
    return true;
}

svo_mat4 svo_mat4_trs(const double t[3], const double q[4], const double s[3])
{
    double x = q[0], y = q[1], z = q[2], w = q[3];
    double n = x * x + y * y + z * z + w * w;
    double k = n > 0 && isfinite(n) ? 2 / n : 0;
    double r[9] = {1 - k * (y * y + z * z), k * (x * y - z * w), k * (x * z + y * w),
                   k * (x * y + z * w), 1 - k * (x * x + z * z), k * (y * z - x * w),
                   k * (x * z - y * w), k * (y * z + x * w), 1 - k * (x * x + y * y)};
    svo_mat4 m = svo_mat4_identity();
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) m.m[4 * i + j] = r[3 * i + j] * s[j];
        m.m[4 * i + 3] = t[i];
    }
    return m;
}
