/* How good a curve is: inside, centred, and how much of the model its inscribed balls give back. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "skeli_geometry.h"
#include "skeli_surface.h"
#include "svo_task.h"

enum { RAYS = SKELI_CIRCLE, RAY_SAMPLES = 600, MAX_SAMPLES = 200000, SURFACE_SAMPLES = 20000, BLOCK = 64, GAP_BLOCK = 256 };
#define SPACING 0.004 /* units */

typedef struct sample { double at[3], along[3], length, radius, off; bool inside; } sample;

typedef struct measuring {
    const skeli_surface *surface;
    const skeli_soup *mesh;
    sample *samples;
    uint64_t count, ray_step, vertex_step;
    double *gap; /* of each vertex_step-th vertex of the mesh to the balls */
    uint32_t *near; /* of each worker: numbers of samples */
} measuring;

static double off_centre(const skeli_surface *s, const sample *p)
{
    double u[3], v[3], sum[3] = {0, 0, 0}, total = 0;
    skeli_across(p->along, u, v);
    for (int i = 0; i < RAYS; i++) {
        double c = skeli_circle[i][0], e = skeli_circle[i][1];
        const double d[3] = {c * u[0] + e * v[0], c * u[1] + e * v[1], c * u[2] + e * v[2]};
        double r = skeli_surface_ray(s, p->at, d, 2.0 * SKEL_LATTICE);
        for (int k = 0; k < 3; k++) sum[k] += r * d[k];
        total += r;
    }
    return total > 0 ? 2 * sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]) / total : 0;
}

static svo_result look(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    measuring *m = user;
    for (uint64_t i = begin; i < end; i++) {
        sample *p = &m->samples[i];
        p->inside = skeli_surface_inside(m->surface, p->at);
        p->radius = skeli_surface_distance(m->surface, p->at, 4.0 * SKEL_LATTICE, NULL);
        p->off = p->inside && p->length > 0 && i % m->ray_step == 0 ? off_centre(m->surface, p) : -1;
    }
    return SVO_OK;
}

/* Samples whose balls could be nearest to one of the vertices first, first + 1 .. (every vertex_step-th of the mesh): vertices lie together, in Morton order, so most samples are refused for
 * all of them at once. */
static uint64_t near_samples(const measuring *m, uint64_t first, uint64_t count, uint32_t *near)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, middle[3], reach2 = 0, best = INFINITY;
    for (uint64_t i = first; i < first + count; i++)
        for (int k = 0; k < 3; k++) {
            const double x = m->mesh->position[3 * i * m->vertex_step + (uint64_t)k];
            low[k] = x < low[k] ? x : low[k];
            high[k] = x > high[k] ? x : high[k];
        }
    for (int k = 0; k < 3; k++) {
        middle[k] = (low[k] + high[k]) / 2;
        reach2 += (high[k] - middle[k]) * (high[k] - middle[k]);
    }
    const double reach = sqrt(reach2);
    uint64_t found = 0;
    for (int pass = 0; pass < 2; pass++) {
        const double most = fmax(best, 0) + 2 * reach + 1 + 1e-6 * reach; /* a ball that covers the middle may not cover all; a lattice step of slack for rounding */
        for (uint64_t k = 0; k < m->count; k++) {
            const sample *p = &m->samples[k];
            const double x = middle[0] - p->at[0], y = middle[1] - p->at[1], z = middle[2] - p->at[2], d2 = x * x + y * y + z * z, r = p->inside ? p->radius : 0;
            if (pass == 0 && d2 < (best + r) * (best + r) && best + r > 0) best = sqrt(d2) - r;
            if (pass == 1 && d2 <= (most + r) * (most + r)) near[found++] = (uint32_t)k;
        }
    }
    return found;
}

static svo_result gaps(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)err;
    measuring *m = user;
    uint32_t *near = m->near + worker * m->count;
    for (uint64_t first = begin; first < end; first += BLOCK) {
        const uint64_t count = end - first < BLOCK ? end - first : BLOCK, samples = near_samples(m, first, count, near);
        for (uint64_t i = first; i < first + count; i++) {
            const int32_t *q = m->mesh->position + 3 * i * m->vertex_step;
            double best = INFINITY;
            for (uint64_t k = 0; k < samples && best > 0; k++) {
                const sample *p = &m->samples[near[k]];
                double x = q[0] - p->at[0], y = q[1] - p->at[1], z = q[2] - p->at[2], d2 = x * x + y * y + z * z, r = p->inside ? p->radius : 0;
                if (d2 >= (best + r) * (best + r)) continue;
                double d = sqrt(d2) - r;
                best = d > 0 ? d : 0;
            }
            m->gap[i] = best;
        }
    }
    return SVO_OK;
}

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/* Samples of all bones, the middle of each piece; a joint without bones is a sample without length. */
static svo_result take_samples(skeli_pool *pool, const double *joint, uint32_t joints, const uint32_t *bone, uint64_t bones, measuring *m, svo_error *err)
{
    uint8_t *used = skeli_take(pool, joints, 1);
    if (used == NULL) return skeli_no_memory(err);
    memset(used, 0, joints);
    double total = 0;
    for (uint64_t b = 0; b < bones; b++) {
        double foot;
        used[bone[2 * b]] = used[bone[2 * b + 1]] = 1;
        total += skeli_segment_distance(joint + 3 * (uint64_t)bone[2 * b], joint + 3 * (uint64_t)bone[2 * b + 1], joint + 3 * (uint64_t)bone[2 * b + 1], &foot);
    }
    double step = SPACING * SKEL_LATTICE;
    if (total > step * MAX_SAMPLES) step = total / MAX_SAMPLES;
    uint64_t room = (uint64_t)(total / step) + 1 + bones + joints;
    m->samples = skeli_take(pool, room, sizeof *m->samples);
    if (m->samples == NULL) return skeli_no_memory(err);
    for (uint64_t b = 0; b < bones; b++) {
        const double *a = joint + 3 * (uint64_t)bone[2 * b], *c = joint + 3 * (uint64_t)bone[2 * b + 1];
        double foot, length = skeli_segment_distance(a, c, c, &foot);
        uint64_t n = (uint64_t)(length / step) + 1;
        for (uint64_t i = 0; i < n && length > 0; i++) {
            sample *p = &m->samples[m->count++];
            *p = (sample){.length = length / (double)n};
            for (int k = 0; k < 3; k++) {
                p->at[k] = a[k] + (c[k] - a[k]) * ((double)i + 0.5) / (double)n;
                p->along[k] = (c[k] - a[k]) / length;
            }
        }
    }
    for (uint32_t j = 0; j < joints; j++)
        if (!used[j]) {
            m->samples[m->count] = (sample){.along = {1, 0, 0}};
            memcpy(m->samples[m->count++].at, joint + 3 * (uint64_t)j, 3 * sizeof *joint);
        }
    SVO_ASSERT(m->count <= room);
    skeli_give(pool, used);
    return SVO_OK;
}

static svo_result sum_up(skeli_pool *pool, const measuring *m, const double *joint, uint32_t joints, double diagonal, skel_quality *q, svo_error *err)
{
    const double percent = diagonal > 0 ? 100 / diagonal : 0;
    double *off = skeli_take(pool, m->count, sizeof *off), length = 0, inside = 0, farthest = 0;
    if (off == NULL) return skeli_no_memory(err);
    uint64_t n = 0;
    for (uint64_t i = 0; i < m->count; i++) {
        const sample *p = &m->samples[i];
        length += p->length;
        if (p->inside) inside += p->length;
        else farthest = fmax(farthest, p->radius);
        if (p->off >= 0) off[n++] = p->off;
    }
    qsort(off, n, sizeof *off, by_value);
    if (n > 0) {
        q->off_centre_median = off[n / 2];
        q->off_centre_p95 = off[n * 95 / 100];
    }
    uint32_t in = 0;
    for (uint32_t j = 0; j < joints; j++) in += skeli_surface_inside(m->surface, joint + 3 * (uint64_t)j);
    q->samples = m->count;
    q->joints_inside = joints > 0 ? 100.0 * in / joints : 0;
    q->length_inside = length > 0 ? 100 * (inside / length) : q->joints_inside;
    q->outside_max = farthest * percent;
    skeli_give(pool, off);
    return SVO_OK;
}

/* Area-weighted over vertices of the tessellated mesh. */
static svo_result balls(skeli_pool *pool, measuring *m, double diagonal, uint32_t threads, skel_quality *q, svo_error *err)
{
    const uint64_t n = m->mesh->vertex_count;
    m->vertex_step = n / SURFACE_SAMPLES + 1;
    uint64_t count = (n + m->vertex_step - 1) / m->vertex_step;
    if (threads == 0) threads = svo_processor_count();
    const uint64_t blocks = (count + GAP_BLOCK - 1) / GAP_BLOCK; /* no more of them can be at work, and each takes a list of all samples */
    if (threads > blocks) threads = (uint32_t)blocks;
    m->gap = skeli_take(pool, count, sizeof *m->gap);
    m->near = skeli_take(pool, threads * m->count, sizeof *m->near);
    double *position = skeli_take(pool, 3 * n, sizeof *position), *ring = skeli_take(pool, n, sizeof *ring), sum = 0, total = 0;
    if (m->gap == NULL || m->near == NULL || position == NULL || ring == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < 3 * n; i++) position[i] = m->mesh->position[i];
    skeli_rings(m->mesh, position, ring);
    SVO_TRY(svo_parallel_for(threads, count, GAP_BLOCK, gaps, m, err));
    for (uint64_t i = 0; i < count; i++) {
        sum += ring[i * m->vertex_step] * m->gap[i];
        total += ring[i * m->vertex_step];
        q->balls_max = fmax(q->balls_max, m->gap[i]);
    }
    const double percent = diagonal > 0 ? 100 / diagonal : 0;
    q->balls_mean = total > 0 ? sum / total * percent : 0;
    q->balls_max *= percent;
    skeli_give(pool, m->gap);
    skeli_give(pool, m->near);
    skeli_give(pool, position);
    skeli_give(pool, ring);
    return SVO_OK;
}

svo_result skeli_quality(skeli_pool *pool, const skeli_surface *surface, const skeli_soup *mesh, const double *joint, uint32_t joints, const uint32_t *bone, uint64_t bones,
                         uint32_t threads, skel_quality *q, svo_error *err)
{
    measuring m = {.surface = surface, .mesh = mesh};
    const skeli_genus genus = surface->genus;
    memset(q, 0, sizeof *q);
    SVO_TRY(take_samples(pool, joint, joints, bone, bones, &m, err));
    m.ray_step = m.count / RAY_SAMPLES + 1;
    SVO_TRY(svo_parallel_for(threads, m.count, 64, look, &m, err));
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, diagonal2 = 0;
    for (uint64_t i = 0; i < 3 * (uint64_t)mesh->vertex_count; i++) {
        low[i % 3] = fmin(low[i % 3], mesh->position[i]);
        high[i % 3] = fmax(high[i % 3], mesh->position[i]);
    }
    for (int k = 0; k < 3; k++) diagonal2 += (high[k] - low[k]) * (high[k] - low[k]);
    SVO_TRY(sum_up(pool, &m, joint, joints, sqrt(diagonal2), q, err));
    SVO_TRY(balls(pool, &m, sqrt(diagonal2), threads, q, err));
    q->surface_components = genus.components;
    q->surface_closed = genus.closed;
    q->genus_known = genus.known;
    q->genus = genus.known ? genus.genus : 0;
    q->measured = true;
    skeli_give(pool, m.samples);
    return SVO_OK;
}

svo_result skeli_quality_of(skeli_pool *pool, const skeli_surface *surface, const skeli_soup *mesh, const skel_skeleton *s, const double centre[3], double unit, uint32_t threads,
                            skel_quality *q, svo_error *err)
{
    double *joint = skeli_take(pool, 3 * (uint64_t)s->joint_count, sizeof *joint);
    uint32_t *bone = skeli_take(pool, 2 * (uint64_t)s->bone_count, sizeof *bone);
    if (joint == NULL || bone == NULL) return skeli_no_memory(err);
    for (uint64_t j = 0; j < s->joint_count; j++)
        for (uint64_t k = 0; k < 3; k++) joint[3 * j + k] = (s->joints[j].position[k] - centre[k]) / unit * SKEL_LATTICE;
    for (uint64_t b = 0; b < s->bone_count; b++) {
        bone[2 * b] = s->bones[b].a;
        bone[2 * b + 1] = s->bones[b].b;
    }
    SVO_TRY(skeli_quality(pool, surface, mesh, joint, s->joint_count, bone, s->bone_count, threads, q, err));
    skeli_give(pool, joint);
    skeli_give(pool, bone);
    return SVO_OK;
}

/* --- two curves --------------------------------------------------------------------------------------------------- */

static double nearest_on(const skel_skeleton *s, const double *p)
{
    double best = INFINITY, foot;
    for (uint32_t b = 0; b < s->bone_count; b++) best = fmin(best, skeli_segment_distance(p, s->joints[s->bones[b].a].position, s->joints[s->bones[b].b].position, &foot));
    for (uint32_t j = 0; j < s->joint_count && (s->bone_count == 0 || s->report.isolated > 0); j++)
        best = fmin(best, skeli_segment_distance(p, s->joints[j].position, s->joints[j].position, &foot));
    return best;
}

#define MOST_PAIRS 2e9

/* Means weigh samples by length; joints alone count where there is no length at all. */
static void one_way(const skel_skeleton *from, const skel_skeleton *to, double *mean, double *max)
{
    double total = 0, sum = 0, foot, step = SPACING * from->report.unit, joints = 0;
    for (uint32_t b = 0; b < from->bone_count; b++) {
        const double *p = from->joints[from->bones[b].a].position, *q = from->joints[from->bones[b].b].position;
        total += skeli_segment_distance(p, q, q, &foot);
    }
    double most = MOST_PAIRS / ((double)to->bone_count + to->joint_count + 1);
    if (total / step > most) step = total / most;
    *max = 0;
    for (uint32_t b = 0; b < from->bone_count; b++) {
        const double *p = from->joints[from->bones[b].a].position, *q = from->joints[from->bones[b].b].position;
        double length = skeli_segment_distance(p, q, q, &foot);
        uint64_t n = (uint64_t)fmin(length / step, 1e9) + 1;
        for (uint64_t i = 0; i <= n; i++) {
            double x[3];
            for (int k = 0; k < 3; k++) x[k] = p[k] + (q[k] - p[k]) * (double)i / (double)n;
            double d = nearest_on(to, x);
            sum += d * length / (double)n * (i == 0 || i == n ? 0.5 : 1);
            *max = fmax(*max, d);
        }
    }
    for (uint32_t j = 0; j < from->joint_count && (from->bone_count == 0 || from->report.isolated > 0); j++) {
        double d = nearest_on(to, from->joints[j].position);
        joints += d;
        *max = fmax(*max, d);
    }
    *mean = total > 0 ? sum / total : joints / from->joint_count;
}

void skel_curve_distance(const skel_skeleton *a, const skel_skeleton *b, skel_distance *out)
{
    one_way(a, b, &out->mean[0], &out->max[0]);
    one_way(b, a, &out->mean[1], &out->max[1]);
}
