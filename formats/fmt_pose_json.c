#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fmti_pose_json.h"

#define PI 3.14159265358979323846

static svo_result wrong(fmti_pose_fault *f, const char *part, const char *key, const char *what)
{
    snprintf(f->key, sizeof f->key, "%.24s%s%.32s", part, part[0] != 0 ? "." : "", key);
    f->what = what;
    return SVO_INVALID_DATA;
}

static svo_result numbers(fmti_pose_fault *f, const char *part, const char *key, const json_t *v, size_t count, double *out)
{
    static const char *const expected[17] = {[1] = "a number in the range of single precision is expected", [3] = "an array of 3 numbers is expected",
                                             [4] = "an array of 4 numbers is expected", [16] = "an array of 16 numbers is expected"};
    if (count != 1 && (!json_is_array(v) || json_array_size(v) != count)) return wrong(f, part, key, expected[count]);
    for (size_t i = 0; i < count; i++) {
        const json_t *n = count == 1 ? v : json_array_get(v, i);
        if (!json_is_number(n) || !(fabs(json_number_value(n)) <= 3e38)) return wrong(f, part, key, expected[count]);
        out[i] = json_number_value(n);
    }
    return SVO_OK;
}

static svo_result axis(fmti_pose_fault *f, const char *part, const char *key, const json_t *v, uint8_t *out)
{
    const char *s = json_string_value(v);
    if (s == NULL || s[0] < 'x' || s[0] > 'z' || s[1] != 0) return wrong(f, part, key, "\"x\", \"y\" or \"z\" is expected");
    *out = (uint8_t)(s[0] - 'x');
    return SVO_OK;
}

/* Twist and bend share all keys but "towards". */
static svo_result turn(fmti_pose_fault *f, const char *part, const json_t *o, bool bend, svo_pose *p)
{
    uint8_t along = 1, towards = 0;
    bool has_angle = false, has_towards = false;
    double angle = 0, from = NAN, to = NAN, n;
    const char *key;
    json_t *v;
    if (!json_is_object(o)) return wrong(f, "", part, "an object is expected");
    json_object_foreach((json_t *)o, key, v)
    {
        if (strcmp(key, "axis") == 0) SVO_TRY(axis(f, part, key, v, &along));
        else if (bend && strcmp(key, "towards") == 0) {
            SVO_TRY(axis(f, part, key, v, &towards));
            has_towards = true;
        } else if (strcmp(key, "degrees") == 0 || strcmp(key, "radians") == 0) {
            if (has_angle) return wrong(f, part, key, "degrees exclude radians");
            SVO_TRY(numbers(f, part, key, v, 1, &n));
            angle = key[0] == 'd' ? n * PI / 180 : n;
            has_angle = true;
        } else if (strcmp(key, "from") == 0) SVO_TRY(numbers(f, part, key, v, 1, &from));
        else if (strcmp(key, "to") == 0) SVO_TRY(numbers(f, part, key, v, 1, &to));
        else return wrong(f, part, key, "unknown key");
    }
    if (!has_angle) return wrong(f, part, "degrees", "missing");
    if (isnan(from) != isnan(to) || from >= to) return wrong(f, part, "from", "from and to come together, from below to");
    if (bend && (!has_towards || towards == along)) return wrong(f, part, "towards", "an axis other than the one that is bent is expected");
    if (bend) {
        p->flags |= SVO_POSE_BEND;
        p->bend_axis = along, p->bend_towards = towards;
        p->bend_angle = (float)angle, p->bend_from = (float)from, p->bend_to = (float)to;
    } else {
        p->flags |= SVO_POSE_TWIST;
        p->twist_axis = along;
        p->twist_angle = (float)angle, p->twist_from = (float)from, p->twist_to = (float)to;
    }
    return SVO_OK;
}

/* {"xy": 0.5}: x moves with y. */
static svo_result shear(fmti_pose_fault *f, const json_t *o, svo_mat4 *m)
{
    const char *key;
    json_t *v;
    if (!json_is_object(o)) return wrong(f, "", "shear", "an object is expected");
    json_object_foreach((json_t *)o, key, v)
    {
        if (strlen(key) != 2 || key[0] < 'x' || key[0] > 'z' || key[1] < 'x' || key[1] > 'z' || key[0] == key[1])
            return wrong(f, "shear", key, "unknown key; \"xy\" moves x with y");
        SVO_TRY(numbers(f, "shear", key, v, 1, &m->m[4 * (key[0] - 'x') + (key[1] - 'x')]));
    }
    return SVO_OK;
}

static svo_result column_major(fmti_pose_fault *f, const char *part, const json_t *v, svo_mat4 *out)
{
    double n[16];
    SVO_TRY(numbers(f, part, "matrix", v, 16, n));
    if (n[3] != 0 || n[7] != 0 || n[11] != 0 || n[15] != 1)
        return wrong(f, part, "matrix", "is not affine: elements 3, 7, 11 and 15 (column-major) must be 0, 0, 0 and 1");
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) out->m[4 * i + j] = n[4 * j + i];
    return SVO_OK;
}

static svo_result store(const svo_mat4 *m, float *to, fmti_pose_fault *f, const char *part)
{
    for (int i = 0; i < 12; i++) {
        to[i] = (float)m->m[i];
        if (!isfinite(to[i])) return wrong(f, part, "matrix", "is beyond the range of single precision");
    }
    return SVO_OK;
}

static svo_mat4 translation(const double t[3], double sign)
{
    svo_mat4 m = svo_mat4_identity();
    for (int k = 0; k < 3; k++) m.m[4 * k + 3] = sign * t[k];
    return m;
}

static svo_result bone(fmti_pose_fault *f, const json_t *o, uint32_t *number, svo_mat4 *m)
{
    double t[3] = {0, 0, 0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1}, pivot[3] = {0, 0, 0};
    bool matrix = false, parts = false, has_number = false;
    const char *key;
    json_t *v;
    if (!json_is_object(o)) return wrong(f, "", "bones", "an array of objects is expected");
    json_object_foreach((json_t *)o, key, v)
    {
        if (strcmp(key, "bone") == 0) {
            if (!json_is_integer(v) || json_integer_value(v) < 0 || json_integer_value(v) >= FMTI_POSE_BONES)
                return wrong(f, "bones", key, "a bone's number from 0 to 65535 is expected");
            *number = (uint32_t)json_integer_value(v);
            has_number = true;
            continue;
        }
        if (strcmp(key, "matrix") == 0) {
            matrix = true;
            SVO_TRY(column_major(f, "bones", v, m));
            continue;
        }
        parts = true;
        if (strcmp(key, "translation") == 0) SVO_TRY(numbers(f, "bones", key, v, 3, t));
        else if (strcmp(key, "rotation") == 0) {
            SVO_TRY(numbers(f, "bones", key, v, 4, q));
            double n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
            if (!(n > 1e-30) || !(n < 1e30)) return wrong(f, "bones", key, "a unit quaternion x, y, z, w is expected");
        } else if (strcmp(key, "scale") == 0) SVO_TRY(numbers(f, "bones", key, v, 3, s));
        else if (strcmp(key, "pivot") == 0) SVO_TRY(numbers(f, "bones", key, v, 3, pivot));
        else return wrong(f, "bones", key, "unknown key");
    }
    if (!has_number) return wrong(f, "bones", "bone", "missing");
    if (matrix && parts) return wrong(f, "bones", "matrix", "excludes translation, rotation, scale and pivot");
    if (matrix) return SVO_OK;
    for (int k = 0; k < 3; k++) t[k] += pivot[k];
    *m = svo_mat4_trs(t, q, s);
    svo_mat4 back = translation(pivot, -1);
    *m = svo_mat4_mul(*m, back);
    return SVO_OK;
}

static svo_result bones(fmti_pose_fault *f, const json_t *list, svo_buffer *matrices, svo_pose *p)
{
    static const float identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
    size_t i;
    json_t *o;
    uint32_t count = 0, number = 0;
    if (!json_is_array(list)) return wrong(f, "", "bones", "an array of objects is expected");
    if (json_array_size(list) == 0) return SVO_OK;
    uint64_t first = matrices->size / sizeof identity;
    json_array_foreach((json_t *)list, i, o)
    {
        svo_mat4 m;
        float stored[12];
        SVO_TRY(bone(f, o, &number, &m));
        SVO_TRY(store(&m, stored, f, "bones"));
        while (count <= number) {
            if (svo_buffer_append(matrices, identity, sizeof identity) == NULL) return SVO_OUT_OF_MEMORY;
            count++;
        }
        memcpy(matrices->data + (first + number) * sizeof identity, stored, sizeof stored);
    }
    if (first + count >= UINT32_MAX) return wrong(f, "", "bones", "all poses together have more than 2^32 - 1 matrices");
    p->flags |= SVO_POSE_BONES;
    p->bone_first = (uint32_t)first, p->bone_count = count;
    return SVO_OK;
}

static svo_result animation(fmti_pose_fault *f, const json_t *v, fmti_pose_clip *clip)
{
    const char *name = json_string_value(v);
    clip->given = true;
    if (json_is_integer(v) && json_integer_value(v) >= 0 && json_integer_value(v) < 1000000000) snprintf(clip->animation, sizeof clip->animation, "%d", (int)json_integer_value(v));
    else if (name != NULL && name[0] != 0 && strlen(name) < sizeof clip->animation) memcpy(clip->animation, name, strlen(name) + 1);
    else return wrong(f, "", "animation", "the name of an animation (up to 127 bytes) or its number is expected");
    return SVO_OK;
}

svo_result fmti_pose_parse(const json_t *o, svo_buffer *matrices, svo_pose *out, fmti_pose_clip *clip, const char **name, fmti_pose_fault *fault)
{
    svo_pose p = svo_pose_stated();
    svo_mat4 scales = svo_mat4_identity(), shears = scales, matrix = scales;
    double pivot[3], factor[3];
    const char *key;
    *clip = (fmti_pose_clip){0};
    json_t *v;
    if (!json_is_object(o)) return wrong(fault, "", "", "an object is expected");
    json_object_foreach((json_t *)o, key, v)
    {
        if (name != NULL && strcmp(key, "name") == 0) *name = json_string_value(v);
        else if (strcmp(key, "twist") == 0) SVO_TRY(turn(fault, key, v, false, &p));
        else if (strcmp(key, "bend") == 0) SVO_TRY(turn(fault, key, v, true, &p));
        else if (strcmp(key, "scale") == 0) {
            SVO_TRY(numbers(fault, "", key, v, 3, factor));
            for (int k = 0; k < 3; k++) scales.m[5 * k] = factor[k];
            p.flags |= SVO_POSE_MATRIX;
        } else if (strcmp(key, "shear") == 0) {
            SVO_TRY(shear(fault, v, &shears));
            p.flags |= SVO_POSE_MATRIX;
        } else if (strcmp(key, "matrix") == 0) {
            SVO_TRY(column_major(fault, "", v, &matrix));
            p.flags |= SVO_POSE_MATRIX;
        } else if (strcmp(key, "pivot") == 0) {
            SVO_TRY(numbers(fault, "", key, v, 3, pivot));
            for (int k = 0; k < 3; k++) p.pivot[k] = (float)pivot[k];
        } else if (strcmp(key, "bones") == 0) SVO_TRY(bones(fault, v, matrices, &p));
        else if (strcmp(key, "animation") == 0) SVO_TRY(animation(fault, v, clip));
        else if (strcmp(key, "time") == 0) {
            SVO_TRY(numbers(fault, "", key, v, 1, &clip->time));
            clip->given = true;
        }
        else return wrong(fault, "", key, "unknown key");
    }
    if (clip->given && (p.flags & SVO_POSE_BONES) != 0) return wrong(fault, "", "animation", "animation and time exclude bones");
    if ((p.flags & SVO_POSE_MATRIX) != 0) {
        float stored[12];
        svo_mat4 m = svo_mat4_mul(matrix, svo_mat4_mul(shears, scales));
        SVO_TRY(store(&m, stored, fault, ""));
        uint64_t number = matrices->size / sizeof stored;
        if (number >= UINT32_MAX) return wrong(fault, "", "matrix", "all poses together have more than 2^32 - 1 matrices");
        p.matrix = (uint32_t)number;
        if (svo_buffer_append(matrices, stored, sizeof stored) == NULL) return SVO_OUT_OF_MEMORY;
    }
    *out = p;
    return SVO_OK;
}
