#include "svo_deform.h"

#include <float.h>
#include <math.h>
#include <string.h>

typedef struct box { double low[3], high[3]; } box;

static const double identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
static const box empty_box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

/* Join the image of [low, high] under the rows of m (Arvo 1990, figure 15). */
static inline void join(box *b, const double m[12], const double low[3], const double high[3])
{
    for (int i = 0; i < 3; i++) {
        const double *r = m + 4 * i;
        double p0 = r[0] * low[0], q0 = r[0] * high[0], p1 = r[1] * low[1], q1 = r[1] * high[1], p2 = r[2] * low[2], q2 = r[2] * high[2];
        double least = r[3] + (p0 < q0 ? p0 : q0) + (p1 < q1 ? p1 : q1) + (p2 < q2 ? p2 : q2);
        double most = r[3] + (p0 < q0 ? q0 : p0) + (p1 < q1 ? q1 : p1) + (p2 < q2 ? q2 : p2);
        /* (written so that NaN stays) */
        if (!(least >= b->low[i])) b->low[i] = least;
        if (!(most <= b->high[i])) b->high[i] = most;
    }
}

void svo_deform_two(const svo_mat4 a[2], const double low[3], const double high[3], double out_low[3], double out_high[3])
{
    box b = empty_box;
    join(&b, a[0].m, low, high);
    join(&b, a[1].m, low, high);
    memcpy(out_low, b.low, sizeof b.low);
    memcpy(out_high, b.high, sizeof b.high);
}

/* ---- slices -------------------------------------------------------------------------------------------------------- */

static double angle_at(const svo_slices *s, double at)
{
    if (at <= s->from) return 0;
    if (at >= s->to) return s->angle;
    return s->angle * ((at - s->from) / (s->to - s->from));
}

/* out = m * (the slice's own matrix). A twist turns columns u and v. */
static void twist_slice(const svo_slices *s, double at, const double m[12], double out[12])
{
    double angle = angle_at(s, at), c = cos(angle), n = sin(angle);
    for (int i = 0; i < 3; i++) {
        const double *r = m + 4 * i;
        double *w = out + 4 * i;
        w[s->axis] = r[s->axis];
        w[s->u] = c * r[s->u] + n * r[s->v];
        w[s->v] = c * r[s->v] - n * r[s->u];
        w[3] = r[3];
    }
}

/* Where the bent line is at `at`, and the directions there: the point (x on u, at on axis) goes to
 * u: x c + shift_u, axis: -x n + shift_axis. */
static void bend_at(const svo_slices *s, double at, double *c, double *n, double *shift_u, double *shift_axis)
{
    double angle = angle_at(s, at);
    *c = cos(angle), *n = sin(angle);
    if (at <= s->from) {
        *shift_u = 0, *shift_axis = at;
        return;
    }
    double length = fmin(at, s->to) - s->from, beyond = fmax(at - s->to, 0);
    /* (1 - cos a) / a and sin a / a, from the half angle so that small angles lose nothing */
    double half = 0.5 * angle, sinc = fabs(half) < 1e-8 ? 1 : sin(half) / half;
    double across = sinc * sin(half), along = sinc * cos(half);
    *shift_u = length * across + beyond * *n;
    *shift_axis = s->from + length * along + beyond * *c;
}

static void bend_slice(const svo_slices *s, double at, const double m[12], double out[12])
{
    double c, n, su, sa;
    bend_at(s, at, &c, &n, &su, &sa);
    for (int i = 0; i < 3; i++) {
        const double *r = m + 4 * i;
        double *w = out + 4 * i;
        w[s->v] = r[s->v];
        w[s->axis] = 0;
        w[s->u] = c * r[s->u] - n * r[s->axis];
        w[3] = r[3] + su * r[s->u] + sa * r[s->axis];
    }
}

static inline void multiply(const double a[12], const double b[12], double out[12])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++)
            out[4 * i + j] = a[4 * i] * b[j] + a[4 * i + 1] * b[4 + j] + a[4 * i + 2] * b[8 + j] + (j == 3 ? a[4 * i + 3] : 0);
}

/* Interval of one row over a box. */
static inline void row_range(const double r[4], const double low[3], const double high[3], double *least, double *most)
{
    double a = r[3], b = r[3];
    for (int k = 0; k < 3; k++) {
        double p = r[k] * low[k], q = r[k] * high[k];
        a += p < q ? p : q;
        b += p < q ? q : p;
    }
    *least = a, *most = b;
}

static inline double farthest(double low, double high)
{
    const double a = fabs(low), b = fabs(high);
    return a > b || b != b ? a : b; /* as fmax */
}

static void make_slice(const svo_slices *s, bool twist, double at, const double in[12], const double out[12], svo_slice *to)
{
    double slice[12];
    to->angle = angle_at(s, at);
    if (twist) twist_slice(s, at, out, slice);
    else bend_slice(s, at, out, slice);
    multiply(slice, in, to->all);
}

/* The slice at `at`: one that is kept, or made in *room. */
static const svo_slice *slice_at(svo_slice_cache *kept, const svo_slices *s, bool twist, double at, const double in[12], const double out[12], svo_slice *room)
{
    if (kept == NULL) {
        make_slice(s, twist, at, in, out, room);
        return room;
    }
    uint64_t bits;
    memcpy(&bits, &at, sizeof bits);
    svo_slice *to = &kept->slice[(bits * 0x9e3779b97f4a7c15u + (twist ? 1u : 0u)) >> 56];
    if (to->map == kept->map && to->at == at && to->twist == twist) return to;
    make_slice(s, twist, at, in, out, to);
    to->map = kept->map, to->at = at, to->twist = twist;
    return to;
}

/* Image of a box under out * slices * in. Between two slices every coordinate of a point is within second derivative * length^2 / 8 of the
 * straight line between its images in both, and never farther than the arc's diameter. kept: of these matrices; NULL: none. */
static box through_slices(svo_slice_cache *kept, const svo_slices *s, bool twist, const double in[12], const double out[12], const double low[3], const double high[3])
{
    double at[4], first, last;
    row_range(in + 4 * s->axis, low, high, &first, &last);
    uint32_t n = 0;
    at[n++] = first;
    if (first < s->from && s->from < last) at[n++] = s->from;
    if (first < s->to && s->to < last) at[n++] = s->to;
    if (last > first) at[n++] = last;
    double u0, u1, v0, v1, radius, rate = s->angle / (s->to - s->from);
    row_range(in + 4 * s->u, low, high, &u0, &u1);
    if (twist) {
        row_range(in + 4 * s->v, low, high, &v0, &v1);
        radius = sqrt(farthest(u0, u1) * farthest(u0, u1) + farthest(v0, v1) * farthest(v0, v1));
    } else radius = farthest(1 - rate * u0, 1 - rate * u1) / fabs(rate); /* of the arc; infinite when straight */
    box b = empty_box;
    double away = 0, angle = 0;
    for (uint32_t i = 0; i < n; i++) {
        svo_slice room;
        const svo_slice *slice = slice_at(kept, s, twist, at[i], in, out, &room);
        join(&b, slice->all, low, high);
        const double turn = fabs(slice->angle - angle);
        angle = slice->angle;
        if (i != 0 && turn != 0) away = fmax(away, fmin(radius * turn * turn / 8, 2 * radius));
    }
    if (!(away == 0)) {
        uint32_t p = s->u, q = twist ? s->v : s->axis;
        for (int i = 0; i < 3; i++) {
            double w = away * sqrt(out[4 * i + (int)p] * out[4 * i + (int)p] + out[4 * i + (int)q] * out[4 * i + (int)q]);
            b.low[i] -= w, b.high[i] += w;
        }
    }
    return b;
}

/* ---- an instance ---------------------------------------------------------------------------------------------------- */

static svo_slices slices(uint32_t axis, uint32_t u, float from, float to, float angle)
{
    return (svo_slices){.axis = axis, .u = u, .v = 3 - axis - u, .from = from, .to = to, .angle = angle};
}

svo_deform svo_deform_make(const svo_poses *poses, const svo_pose *pose, const svo_mat4 *grid_to_mesh, const svo_mat4 *mesh_to_target)
{
    svo_deform d = {.poses = poses, .grid = *grid_to_mesh, .out = *mesh_to_target};
    svo_mat4 after = svo_mat4_identity();
    if (pose != NULL) {
        d.flags = pose->flags;
        if ((d.flags & SVO_POSE_MATRIX) != 0) after = svo_pose_matrix(poses, pose->matrix);
        if ((d.flags & SVO_POSE_TWIST) != 0)
            d.twist = slices(pose->twist_axis, (pose->twist_axis + 1u) % 3, pose->twist_from, pose->twist_to, pose->twist_angle);
        if ((d.flags & SVO_POSE_BEND) != 0) d.bend = slices(pose->bend_axis, pose->bend_towards, pose->bend_from, pose->bend_to, pose->bend_angle);
        if ((d.flags & (SVO_POSE_TWIST | SVO_POSE_BEND)) != 0) {
            svo_mat4 back = svo_mat4_identity();
            for (int k = 0; k < 3; k++) after.m[4 * k + 3] -= pose->pivot[k], back.m[4 * k + 3] = pose->pivot[k];
            d.out = svo_mat4_mul(*mesh_to_target, back);
        }
        d.bone_first = pose->bone_first, d.bone_count = pose->bone_count;
    }
    d.in = (d.flags & SVO_POSE_BONES) != 0 ? after : svo_mat4_mul(after, *grid_to_mesh);
    return d;
}

/* Grid to the pose's coordinates before twist and bend. */
static svo_mat4 inner(const svo_deform *d, uint32_t bone)
{
    if ((d->flags & SVO_POSE_BONES) == 0) return d->in;
    if (bone >= d->bone_count) return svo_mat4_mul(d->in, d->grid);
    svo_mat4 b = svo_pose_matrix(d->poses, (uint64_t)d->bone_first + bone);
    return svo_mat4_mul(d->in, svo_mat4_mul(b, d->grid));
}

static svo_vec3 slices_point(const svo_slices *s, bool twist, svo_vec3 p)
{
    double q[3] = {p.x, p.y, p.z}, r[3] = {p.x, p.y, p.z};
    if (twist) {
        double angle = angle_at(s, q[s->axis]), c = cos(angle), n = sin(angle);
        r[s->u] = c * q[s->u] - n * q[s->v];
        r[s->v] = n * q[s->u] + c * q[s->v];
    } else {
        double c, n, su, sa;
        bend_at(s, q[s->axis], &c, &n, &su, &sa);
        r[s->u] = c * q[s->u] + su;
        r[s->axis] = sa - n * q[s->u];
    }
    return svo_v3(r[0], r[1], r[2]);
}

static svo_vec3 point_after(const svo_deform *d, const svo_mat4 *in, svo_vec3 p)
{
    p = svo_mat4_point(in, p);
    if ((d->flags & SVO_POSE_TWIST) != 0) p = slices_point(&d->twist, true, p);
    if ((d->flags & SVO_POSE_BEND) != 0) p = slices_point(&d->bend, false, p);
    return svo_mat4_point(&d->out, p);
}

svo_vec3 svo_deform_point(const svo_deform *d, uint32_t bone, svo_vec3 p)
{
    svo_mat4 in = inner(d, bone);
    return point_after(d, &in, p);
}

/* From the box in the pose's coordinates (after `in`) to the target: twist, bend, out. Rounding of the sums, here and of whoever maps a point, is allowed for. */
static void box_after(const svo_deform *d, const double in[12], const double low[3], const double high[3], double out_low[3], double out_high[3])
{
    box b;
    svo_slice_cache *kept = (d->flags & SVO_POSE_BONES) == 0 ? d->kept : NULL; /* each bone has an `in` of its own */
    switch (d->flags & (SVO_POSE_TWIST | SVO_POSE_BEND)) {
    case SVO_POSE_TWIST: b = through_slices(kept, &d->twist, true, in, d->out.m, low, high); break;
    case SVO_POSE_BEND: b = through_slices(kept, &d->bend, false, in, d->out.m, low, high); break;
    case SVO_POSE_TWIST | SVO_POSE_BEND: {
        box t = through_slices(kept, &d->twist, true, in, identity, low, high);
        b = through_slices(NULL, &d->bend, false, identity, d->out.m, t.low, t.high); /* twisted bounds are all different */
        break;
    }
    default: {
        double all[12];
        multiply(d->out.m, in, all);
        b = empty_box;
        join(&b, all, low, high);
    }
    }
    for (int i = 0; i < 3; i++) {
        double slack = 64 * DBL_EPSILON * farthest(b.low[i], b.high[i]);
        out_low[i] = b.low[i] - slack;
        out_high[i] = b.high[i] + slack;
    }
}

void svo_deform_box(const svo_deform *d, uint32_t bone, const double low[3], const double high[3], double out_low[3], double out_high[3])
{
    svo_mat4 in = inner(d, bone);
    box_after(d, in.m, low, high, out_low, out_high);
}

/* ---- several bones ---------------------------------------------------------------------------------------------------- */

/* The most (sign 1) or the least (sign -1) of the sum of weight * value, for weights in the ranges that add up to 1: what is left of 1 beside the least weights goes to the
 * largest values first. */
static double extreme_sum(const svo_bone_range *range, uint32_t n, const double *value, double sign)
{
    bool taken[SVO_BONE_LIST_MOST] = {false};
    double sum = 0;
    int left = 255;
    for (uint32_t i = 0; i < n; i++) {
        left -= range[i].low;
        if (range[i].low != 0) sum += range[i].low * value[i];
    }
    while (left > 0) {
        uint32_t best = n;
        for (uint32_t i = 0; i < n; i++)
            if (!taken[i] && (best == n || sign * value[i] > sign * value[best])) best = i;
        if (best == n) break;
        int more = range[best].high - range[best].low;
        if (more > left) more = left;
        if (more != 0) sum += more * value[best];
        taken[best] = true;
        left -= more;
    }
    return sum / 255;
}

/* Bounds of the images of a box under `rows` * the bones' matrices. */
static box blended(const svo_deform *d, svo_bone_list list, const svo_mat4 *rows, const double low[3], const double high[3])
{
    box b = empty_box, image[SVO_BONE_LIST_MOST];
    if (list.range == NULL) { /* any weights: the images under each bone, and what rests */
        for (uint32_t i = 0; i <= d->bone_count; i++) {
            double m[12];
            svo_mat4 in = inner(d, i);
            multiply(rows->m, in.m, m);
            join(&b, m, low, high);
        }
        return b;
    }
    for (uint32_t i = 0; i < list.count; i++) {
        double m[12];
        svo_mat4 in = inner(d, list.range[i].bone);
        multiply(rows->m, in.m, m);
        image[i] = empty_box;
        join(&image[i], m, low, high);
    }
    if (list.count == 1) return image[0];
    for (int k = 0; k < 3; k++) {
        double value[SVO_BONE_LIST_MOST];
        for (uint32_t i = 0; i < list.count; i++) value[i] = image[i].low[k];
        b.low[k] = extreme_sum(list.range, list.count, value, -1);
        for (uint32_t i = 0; i < list.count; i++) value[i] = image[i].high[k];
        b.high[k] = extreme_sum(list.range, list.count, value, 1);
    }
    return b;
}

void svo_deform_blended_box(const svo_deform *d, svo_bone_list list, const double low[3], const double high[3], double out_low[3], double out_high[3])
{
    if ((d->flags & SVO_POSE_BONES) == 0 || list.count == 1) {
        svo_deform_box(d, list.count == 1 ? list.range[0].bone : SVO_NO_BONE, low, high, out_low, out_high);
        return;
    }
    static const svo_mat4 none = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
    if ((d->flags & (SVO_POSE_TWIST | SVO_POSE_BEND)) == 0) {
        box b = blended(d, list, &d->out, low, high);
        for (int i = 0; i < 3; i++) {
            double slack = 64 * DBL_EPSILON * farthest(b.low[i], b.high[i]);
            out_low[i] = b.low[i] - slack, out_high[i] = b.high[i] + slack;
        }
        return;
    }
    /* Twist and bend are of the blended point: bounds before them, widened by rounding, go through them. */
    box b = blended(d, list, &none, low, high);
    for (int i = 0; i < 3; i++) {
        double slack = 64 * DBL_EPSILON * farthest(b.low[i], b.high[i]);
        b.low[i] -= slack, b.high[i] += slack;
    }
    box_after(d, identity, b.low, b.high, out_low, out_high);
}

/* The matrix for weights in the middle of the ranges. */
static svo_mat4 middle(const svo_deform *d, svo_bone_list list)
{
    if ((d->flags & SVO_POSE_BONES) == 0 || list.range == NULL || list.count == 1) return inner(d, list.count == 1 ? list.range[0].bone : SVO_NO_BONE);
    svo_mat4 sum = {{0}};
    double total = 0;
    for (uint32_t i = 0; i < list.count; i++) total += list.range[i].low + list.range[i].high;
    for (uint32_t i = 0; i < list.count; i++) {
        svo_mat4 m = inner(d, list.range[i].bone);
        for (int k = 0; k < 16; k++) sum.m[k] += (list.range[i].low + list.range[i].high) / total * m.m[k];
    }
    return sum;
}

svo_vec3 svo_deform_blended_point(const svo_deform *d, svo_bone_list list, svo_vec3 p)
{
    svo_mat4 in = middle(d, list);
    return point_after(d, &in, p);
}

/* ---- normals ----------------------------------------------------------------------------------------------------------- */

/* n in mesh coordinates as a covector of the grid: times the transposed map. */
static svo_vec3 covector(const svo_deform *d, svo_vec3 n)
{
    const double *m = d->grid.m;
    return svo_v3(m[0] * n.x + m[4] * n.y + m[8] * n.z, m[1] * n.x + m[5] * n.y + m[9] * n.z, m[2] * n.x + m[6] * n.y + m[10] * n.z);
}

/* What twist or bend makes of directions at q (its derivative there). */
static void slices_directions(const svo_slices *s, bool twist, svo_vec3 q, svo_vec3 direction[3])
{
    const double p[3] = {q.x, q.y, q.z}, at = p[s->axis], rate = at >= s->from && at < s->to ? s->angle / (s->to - s->from) : 0;
    const double angle = angle_at(s, at), c = cos(angle), n = sin(angle);
    const double pu = c * p[s->u] - n * p[s->v], pv = n * p[s->u] + c * p[s->v], length = 1 - rate * p[s->u]; /* the point after a twist; of a bend's inner sides, which are shorter */
    for (int k = 0; k < 3; k++) {
        double d[3] = {direction[k].x, direction[k].y, direction[k].z};
        const double du = d[s->u], dv = d[s->v], along = d[s->axis];
        if (twist) {
            d[s->u] = c * du - n * dv - along * rate * pv;
            d[s->v] = n * du + c * dv + along * rate * pu;
        } else {
            d[s->u] = c * du + along * length * n;
            d[s->axis] = along * length * c - n * du;
        }
        direction[k] = svo_v3(d[0], d[1], d[2]);
    }
}

static svo_vec3 direction_after(const svo_mat4 *m, svo_vec3 v)
{
    const double *a = m->m;
    return svo_v3(a[0] * v.x + a[1] * v.y + a[2] * v.z, a[4] * v.x + a[5] * v.y + a[6] * v.z, a[8] * v.x + a[9] * v.y + a[10] * v.z);
}

/* Images of the grid's three planes at p, as vectors at right angles to them as long as the image of half an edge times half an edge is large. Returns whether the map reflects. */
static bool planes_after(const svo_deform *d, const svo_mat4 *in, svo_vec3 p, double edge, svo_vec3 plane[3])
{
    svo_vec3 column[3], q = svo_mat4_point(in, p);
    const double h = 0.5 * edge;
    for (int k = 0; k < 3; k++) column[k] = svo_v3(h * in->m[k], h * in->m[4 + k], h * in->m[8 + k]);
    if ((d->flags & SVO_POSE_TWIST) != 0) slices_directions(&d->twist, true, q, column);
    if ((d->flags & SVO_POSE_BEND) != 0) {
        if ((d->flags & SVO_POSE_TWIST) != 0) q = slices_point(&d->twist, true, q);
        slices_directions(&d->bend, false, q, column);
    }
    for (int k = 0; k < 3; k++) column[k] = direction_after(&d->out, column[k]);
    plane[0] = svo_cross(column[1], column[2]), plane[1] = svo_cross(column[2], column[0]), plane[2] = svo_cross(column[0], column[1]);
    return svo_dot(column[0], plane[0]) < 0;
}

static svo_vec3 on_planes(const svo_vec3 plane[3], svo_vec3 g)
{
    return svo_add(svo_scale(plane[0], g.x), svo_add(svo_scale(plane[1], g.y), svo_scale(plane[2], g.z)));
}

static svo_vec3 normal_after(const svo_deform *d, const svo_mat4 *in, svo_vec3 p, double edge, svo_vec3 n)
{
    svo_vec3 plane[3];
    double sign = planes_after(d, in, p, edge, plane) ? -1 : 1; /* a reflection keeps the side */
    return svo_normalize(svo_scale(on_planes(plane, covector(d, n)), sign));
}

svo_vec3 svo_deform_normal(const svo_deform *d, uint32_t bone, svo_vec3 p, double edge, svo_vec3 n)
{
    svo_mat4 in = inner(d, bone);
    return normal_after(d, &in, p, edge, n);
}

svo_vec3 svo_deform_blended_normal(const svo_deform *d, svo_bone_list list, svo_vec3 p, double edge, svo_vec3 n)
{
    svo_mat4 in = middle(d, list);
    return normal_after(d, &in, p, edge, n);
}

double svo_deform_blended_area(const svo_deform *d, svo_bone_list list, svo_vec3 p, double edge, svo_vec3 n, bool thin)
{
    svo_mat4 in = middle(d, list);
    svo_vec3 plane[3], g = covector(d, n);
    planes_after(d, &in, p, edge, plane);
    const double x = fabs(g.x), y = fabs(g.y), z = fabs(g.z), thick = thin ? fmax(x, fmax(y, z)) : x + y + z;
    if (thick == 0) return 4.0 / 3 * (svo_length(plane[0]) + svo_length(plane[1]) + svo_length(plane[2]));
    return 4 * svo_length(on_planes(plane, g)) / thick; /* planes are of a quarter of a face */
}
