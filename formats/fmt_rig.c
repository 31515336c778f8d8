#include "fmt_rig.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

void fmt_rig_free(fmt_rig *r)
{
    if (r == NULL) return;
    const svo_allocator *a = r->allocator;
    for (uint32_t i = 0; r->skins != NULL && i < r->skin_count; i++) {
        svo_free(a, r->skins[i].joints, r->skins[i].joint_count, sizeof(uint32_t));
        svo_free(a, r->skins[i].inverse_bind, r->skins[i].joint_count, sizeof(svo_mat4));
    }
    for (uint32_t i = 0; r->animations != NULL && i < r->animation_count; i++) {
        fmt_rig_animation *n = &r->animations[i];
        for (uint32_t k = 0; n->tracks != NULL && k < n->track_count; k++) {
            fmt_rig_track *t = &n->tracks[k];
            svo_free(a, t->times, t->count, sizeof(float));
            svo_free(a, t->values, t->count, (size_t)t->width * (t->interpolation == FMT_RIG_CUBIC ? 3 : 1) * sizeof(float));
        }
        svo_free(a, n->tracks, n->track_count, sizeof *n->tracks);
        svo_string_free(a, n->name);
    }
    for (uint32_t i = 0; r->shapes != NULL && i < r->shape_count; i++) {
        fmt_rig_shape *s = &r->shapes[i];
        for (uint32_t k = 0; s->parts != NULL && k < s->part_count; k++) svo_free(a, s->parts[k].influences, s->parts[k].vertex_count, sizeof(svo_influence));
        svo_free(a, s->parts, s->part_count, sizeof *s->parts);
    }
    svo_free(a, r->nodes, r->node_count, sizeof *r->nodes);
    svo_free(a, r->order, r->node_count, sizeof *r->order);
    svo_free(a, r->skins, r->skin_count, sizeof *r->skins);
    svo_free(a, r->animations, r->animation_count, sizeof *r->animations);
    svo_free(a, r->shapes, r->shape_count, sizeof *r->shapes);
    svo_free(a, r->instance_node, r->instance_count, sizeof *r->instance_node);
    memset(r, 0, sizeof *r);
}

uint32_t fmt_rig_find(const fmt_rig *r, const char *name)
{
    for (uint32_t i = 0; i < r->animation_count; i++)
        if (strcmp(r->animations[i].name, name) == 0) return i;
    char *end;
    if (name[0] < '0' || name[0] > '9' || strlen(name) > 9) return SVO_NONE;
    unsigned long number = strtoul(name, &end, 10);
    return *end == 0 && number < r->animation_count ? (uint32_t)number : SVO_NONE;
}

/* ---- a track at a time (glTF 2.0, appendix C) --------------------------------------------------------------------------- */

static void normalize4(double q[4])
{
    double n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int k = 0; k < 4; k++) q[k] = n > 0 ? q[k] / n : k == 3;
}

static void slerp(const double a[4], const double b[4], double t, double out[4])
{
    double cosine = 0, sign = 1, from = 1 - t, to = t;
    for (int k = 0; k < 4; k++) cosine += a[k] * b[k];
    if (cosine < 0) cosine = -cosine, sign = -1; /* the shorter way round */
    if (cosine < 1 - 1e-9) {
        double angle = acos(fmin(cosine, 1)), s = sin(angle);
        from = sin((1 - t) * angle) / s, to = sin(t * angle) / s;
    }
    for (int k = 0; k < 4; k++) out[k] = from * a[k] + sign * to * b[k];
}

static void track_at(const fmt_rig_track *t, double time, double *out)
{
    const uint64_t width = t->width, stride = width * (t->interpolation == FMT_RIG_CUBIC ? 3 : 1);
    uint64_t at = 0, count = t->count; /* the last key that is not after the time */
    while (count > 1) {
        uint64_t half = count / 2;
        if ((double)t->times[at + half] <= time) at += half;
        count -= half;
    }
    const float *value = t->values + at * stride + (t->interpolation == FMT_RIG_CUBIC ? width : 0);
    for (uint64_t k = 0; k < width; k++) out[k] = (double)value[k];
    double length = at + 1 < t->count ? (double)t->times[at + 1] - (double)t->times[at] : 0, u = time - (double)t->times[at];
    if (t->interpolation != FMT_RIG_STEP && u > 0 && length > 0) {
        const float *next = value + stride;
        u /= length;
        if (t->interpolation == FMT_RIG_CUBIC) {
            double u2 = u * u, u3 = u2 * u;
            for (uint64_t k = 0; k < width; k++) { /* out-tangent of the key, in-tangent of the next one */
                double leave = length * (double)value[width + k], arrive = length * (double)t->values[(at + 1) * stride + k];
                out[k] = (2 * u3 - 3 * u2 + 1) * out[k] + (u3 - 2 * u2 + u) * leave + (3 * u2 - 2 * u3) * (double)next[k] + (u3 - u2) * arrive;
            }
        } else if (t->part == FMT_RIG_ROTATION) {
            double a[4], b[4];
            for (int k = 0; k < 4; k++) a[k] = out[k], b[k] = (double)next[k];
            normalize4(a);
            normalize4(b);
            slerp(a, b, u, out);
        } else
            for (uint64_t k = 0; k < width; k++) out[k] = (1 - u) * out[k] + u * (double)next[k];
    }
    if (t->part == FMT_RIG_ROTATION) normalize4(out);
}

static svo_mat4 local(const fmt_rig_node *n) { return n->has_matrix ? n->matrix : svo_mat4_trs(n->part[0], n->part[1], n->part[2]); }

void fmt_rig_world(const fmt_rig *r, uint32_t animation, double time, svo_mat4 *world)
{
    for (uint32_t i = 0; i < r->node_count; i++) world[i] = local(&r->nodes[i]);
    if (animation != SVO_NONE) {
        const fmt_rig_animation *n = &r->animations[animation];
        for (uint32_t i = 0; i < n->track_count; i++) { /* all tracks of a node stand together (the importer sorts them) */
            fmt_rig_node moved = r->nodes[n->tracks[i].node];
            uint32_t node = n->tracks[i].node;
            for (; i < n->track_count && n->tracks[i].node == node; i++)
                if (n->tracks[i].part != FMT_RIG_WEIGHTS) track_at(&n->tracks[i], time, moved.part[n->tracks[i].part]);
            i--;
            world[node] = local(&moved);
        }
    }
    for (uint32_t i = 0; i < r->node_count; i++) {
        uint32_t n = r->order[i];
        if (r->nodes[n].parent != SVO_NONE) world[n] = svo_mat4_mul(world[r->nodes[n].parent], world[n]);
    }
}

const fmt_rig_track *fmt_rig_weights_track(const fmt_rig *r, uint32_t animation, uint32_t node)
{
    if (animation == SVO_NONE) return NULL;
    const fmt_rig_animation *n = &r->animations[animation];
    uint32_t at = 0, end = n->track_count; /* the node's last track: weights are the last part */
    while (at < end) {
        uint32_t half = at + (end - at) / 2;
        if (n->tracks[half].node <= node) at = half + 1;
        else end = half;
    }
    if (at == 0 || n->tracks[at - 1].node != node || n->tracks[at - 1].part != FMT_RIG_WEIGHTS) return NULL;
    return &n->tracks[at - 1];
}

void fmt_rig_weights(const fmt_rig_track *t, double time, double *weights) { track_at(t, time, weights); }

svo_mat4 fmt_rig_joint(const fmt_rig *r, uint32_t skin, uint32_t joint, const svo_mat4 *world)
{
    return svo_mat4_mul(world[r->skins[skin].joints[joint]], r->skins[skin].inverse_bind[joint]);
}

static svo_mat4 world_of(const fmt_rig *r, uint32_t node)
{
    svo_mat4 m = local(&r->nodes[node]);
    for (uint32_t p = r->nodes[node].parent; p != SVO_NONE; p = r->nodes[p].parent) m = svo_mat4_mul(local(&r->nodes[p]), m);
    return m;
}

svo_mat4 fmt_rig_place(const fmt_rig *r, uint32_t skin)
{
    const fmt_rig_skin *s = &r->skins[skin];
    for (uint32_t j = 0; j < s->joint_count; j++) {
        svo_mat4 m = svo_mat4_mul(world_of(r, s->joints[j]), s->inverse_bind[j]), inverse;
        if (svo_mat4_affine_inverse(&m, &inverse)) return m;
    }
    return svo_mat4_identity();
}
