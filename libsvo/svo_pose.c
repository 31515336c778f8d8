#include "svo_pose.h"

#include <math.h>
#include <string.h>

_Static_assert(sizeof(svo_pose) == 64, "a pose lies in memory as POSE elements do");

static bool range_fault(float from, float to, float angle)
{
    return !isfinite(from) || !isfinite(to) || !isfinite(angle) || !(from < to) || !isfinite(to - from);
}

const char *svo_pose_fault(const svo_poses *all, const svo_pose *p)
{
    static const float none[3] = {0, 0, 0};
    if ((p->flags & ~(uint32_t)SVO_POSE_FLAGS) != 0) return "unknown flags";
    if (p->zero != 0 || p->unused[0] != 0 || p->unused[1] != 0) return "fields that must be 0 are not";
    for (int k = 0; k < 3; k++)
        if (!isfinite(p->pivot[k])) return "the pivot is not finite";
    if ((p->flags & SVO_POSE_TWIST) != 0) {
        if (p->twist_axis > 2) return "the axis of the twist is not 0, 1 or 2";
        if (range_fault(p->twist_from, p->twist_to, p->twist_angle)) return "the twist is not finite, or its range is empty";
    } else if (p->twist_axis != 0 || memcmp(&p->twist_from, none, sizeof none) != 0) return "fields of a twist that is not there are not 0";
    if ((p->flags & SVO_POSE_BEND) != 0) {
        if (p->bend_axis > 2 || p->bend_towards > 2 || p->bend_axis == p->bend_towards) return "the axes of the bend are not two of 0, 1, 2";
        if (range_fault(p->bend_from, p->bend_to, p->bend_angle)) return "the bend is not finite, or its range is empty";
    } else if (p->bend_axis != 0 || p->bend_towards != 0 || memcmp(&p->bend_from, none, sizeof none) != 0) return "fields of a bend that is not there are not 0";
    if ((p->flags & SVO_POSE_MATRIX) != 0) {
        if (p->matrix >= all->matrix_count) return "there is no such matrix";
    } else if (p->matrix != 0) return "the number of a matrix that is not there is not 0";
    if ((p->flags & SVO_POSE_BONES) != 0) {
        if (p->bone_count == 0 || p->bone_first > all->matrix_count || p->bone_count > all->matrix_count - p->bone_first)
            return "there are no such matrices for the bones";
    } else if (p->bone_first != 0 || p->bone_count != 0) return "bones that are not there have matrices";
    return NULL;
}

bool svo_pose_matrix_is_identity(const float *m)
{
    static const float identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
    for (int i = 0; i < 12; i++)
        if (m[i] != identity[i]) return false;
    return true;
}

bool svo_pose_is_rest(const svo_poses *all, const svo_pose *p)
{
    if ((p->flags & SVO_POSE_TWIST) != 0 && p->twist_angle != 0) return false;
    if ((p->flags & SVO_POSE_BEND) != 0 && p->bend_angle != 0) return false;
    if ((p->flags & SVO_POSE_MATRIX) != 0 && !svo_pose_matrix_is_identity(all->matrix + 12 * (uint64_t)p->matrix)) return false;
    for (uint64_t b = 0; b < p->bone_count; b++)
        if (!svo_pose_matrix_is_identity(all->matrix + 12 * (p->bone_first + b))) return false;
    return true;
}

svo_mat4 svo_pose_matrix(const svo_poses *all, uint64_t i)
{
    svo_mat4 m = svo_mat4_identity();
    for (int k = 0; k < 12; k++) m.m[k] = all->matrix[12 * i + (uint64_t)k];
    return m;
}

/* M for p becomes T M T^-1 for p + shift. */
void svo_pose_shift(float *m, const double shift[3])
{
    double moved[3];
    for (int i = 0; i < 3; i++) {
        const float *r = m + 4 * i;
        moved[i] = r[3] + shift[i] - (r[0] * shift[0] + r[1] * shift[1] + r[2] * shift[2]);
    }
    for (int i = 0; i < 3; i++) m[4 * i + 3] = (float)moved[i];
}

svo_pose svo_pose_stated(void)
{
    return (svo_pose){.pivot = {NAN, NAN, NAN}, .twist_from = NAN, .twist_to = NAN, .bend_from = NAN, .bend_to = NAN};
}

static void resolve_range(float *from, float *to, double low, double high, double pivot)
{
    *from = (float)((isnan(*from) ? low : *from) - pivot), *to = (float)((isnan(*to) ? high : *to) - pivot);
    if (!(*from < *to)) *to = fmaxf(nextafterf(*from, INFINITY), *from + 1);
}

void svo_pose_resolve(svo_pose *p, const double low[3], const double high[3])
{
    bool twist = (p->flags & SVO_POSE_TWIST) != 0, bend = (p->flags & SVO_POSE_BEND) != 0;
    for (int k = 0; k < 3; k++)
        if (!twist && !bend) p->pivot[k] = 0;
        else if (isnan(p->pivot[k])) p->pivot[k] = (float)(0.5 * (low[k] + high[k]));
    if (twist) resolve_range(&p->twist_from, &p->twist_to, low[p->twist_axis], high[p->twist_axis], p->pivot[p->twist_axis]);
    else p->twist_from = p->twist_to = p->twist_angle = 0;
    if (bend) resolve_range(&p->bend_from, &p->bend_to, low[p->bend_axis], high[p->bend_axis], p->pivot[p->bend_axis]);
    else p->bend_from = p->bend_to = p->bend_angle = 0;
}
