/* What is measured on a skeleton: its topology, how far the surface is from it, and the rules a valid one keeps. */
#include "skeli_internal.h"

#include <math.h>
#include <string.h>

void skeli_topology(skel_skeleton *s, uint32_t *parent)
{
    for (uint32_t j = 0; j < s->joint_count; j++) parent[j] = j;
    for (uint32_t b = 0; b < s->bone_count; b++) {
        uint32_t p = skeli_root(parent, s->bones[b].a), q = skeli_root(parent, s->bones[b].b);
        if (p != q) parent[p > q ? p : q] = p > q ? q : p;
    }
    uint32_t components = 0;
    for (uint32_t j = 0; j < s->joint_count; j++) {
        uint32_t r = skeli_root(parent, j);
        s->joints[j].component = r == j ? components++ : s->joints[r].component;
    }
    memset(parent, 0, s->joint_count * sizeof *parent);
    for (uint32_t b = 0; b < s->bone_count; b++) {
        parent[s->bones[b].a]++;
        parent[s->bones[b].b]++;
    }
    skel_report *r = &s->report;
    r->components = components;
    r->ends = r->branches = r->isolated = 0;
    for (uint32_t j = 0; j < s->joint_count; j++) {
        r->isolated += parent[j] == 0;
        r->ends += parent[j] == 1;
        r->branches += parent[j] >= 3;
    }
    r->loops = s->bone_count + components - s->joint_count;
}

void skel_components(const skel_skeleton *s, skel_component *out)
{
    memset(out, 0, s->report.components * sizeof *out);
    for (uint32_t j = 0; j < s->joint_count; j++) out[s->joints[j].component].joints++;
    for (uint32_t b = 0; b < s->bone_count; b++) out[s->joints[s->bones[b].a].component].bones++;
    uint32_t n = s->joint_count, *degree = svo_calloc(s->allocator, n, sizeof *degree);
    if (degree != NULL) {
        for (uint32_t b = 0; b < s->bone_count; b++) {
            degree[s->bones[b].a]++;
            degree[s->bones[b].b]++;
        }
        for (uint32_t j = 0; j < n; j++) {
            skel_component *c = &out[s->joints[j].component];
            c->ends += degree[j] == 1;
            c->branches += degree[j] >= 3;
        }
        svo_free(s->allocator, degree, n, sizeof *degree);
    }
    for (uint32_t c = 0; c < s->report.components; c++) out[c].loops = out[c].bones + 1 - out[c].joints;
}

/* --- distance of the surface -------------------------------------------------------------------------------------- */

double skeli_segment_distance(const double *p, const double *a, const double *b, double *foot)
{
    double ab[3], ap[3], along = 0, length2 = 0;
    for (int k = 0; k < 3; k++) {
        ab[k] = b[k] - a[k];
        ap[k] = p[k] - a[k];
        along += ab[k] * ap[k];
        length2 += ab[k] * ab[k];
    }
    double t = length2 > 0 ? along / length2 : 0;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    *foot = t;
    double d2 = 0;
    for (int k = 0; k < 3; k++) {
        double d = ap[k] - t * ab[k];
        d2 += d * d;
    }
    return sqrt(d2);
}

/* Bones of each joint (the other end), as a table. */
typedef struct neighbours { uint32_t *start, *joint; } neighbours;

static svo_result neighbours_make(skeli_pool *pool, const skel_skeleton *s, neighbours *n, svo_error *err)
{
    n->start = skeli_take(pool, (uint64_t)s->joint_count + 2, sizeof *n->start);
    n->joint = skeli_take(pool, 2 * (uint64_t)s->bone_count, sizeof *n->joint);
    if (n->start == NULL || n->joint == NULL) return skeli_no_memory(err);
    memset(n->start, 0, ((size_t)s->joint_count + 2) * sizeof *n->start);
    for (uint32_t b = 0; b < s->bone_count; b++) {
        n->start[s->bones[b].a + 2]++;
        n->start[s->bones[b].b + 2]++;
    }
    for (uint32_t j = 0; j < s->joint_count; j++) n->start[j + 2] += n->start[j + 1];
    for (uint32_t b = 0; b < s->bone_count; b++) {
        n->joint[n->start[s->bones[b].a + 1]++] = s->bones[b].b;
        n->joint[n->start[s->bones[b].b + 1]++] = s->bones[b].a;
    }
    return SVO_OK;
}

static double curve_distance(const skel_skeleton *s, const neighbours *n, uint32_t joint, const double *p, uint32_t *other, double *foot)
{
    const double *a = s->joints[joint].position;
    double best = skeli_segment_distance(p, a, a, foot);
    *other = joint;
    *foot = 0;
    for (uint32_t k = n->start[joint]; k < n->start[joint + 1]; k++) {
        double t, d = skeli_segment_distance(p, a, s->joints[n->joint[k]].position, &t);
        if (d >= best) continue;
        best = d;
        *other = n->joint[k];
        *foot = t;
    }
    return best;
}

svo_result skeli_measure(skeli_pool *pool, const skeli_soup *mesh, const uint32_t *joint_of, const double *known, skel_skeleton *out, svo_error *err)
{
    uint32_t n = mesh->vertex_count;
    skel_report *r = &out->report;
    double *original = skeli_take(pool, 3 * (uint64_t)n, sizeof *original), *ring = skeli_take(pool, n, sizeof *ring);
    double *weight = skeli_take(pool, out->joint_count, sizeof *weight), *distance = skeli_take(pool, n, sizeof *distance);
    double *foot = skeli_take(pool, n, sizeof *foot);
    uint32_t *other = skeli_take(pool, n, sizeof *other);
    neighbours nb;
    if (original == NULL || ring == NULL || weight == NULL || distance == NULL || foot == NULL || other == NULL) return skeli_no_memory(err);
    SVO_TRY(neighbours_make(pool, out, &nb, err));
    for (uint64_t i = 0; i < 3 * (uint64_t)n; i++) original[i] = mesh->position[i];
    skeli_rings(mesh, original, ring);
    double area = 0, low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t v = 0; v < n; v++) {
        area += ring[v];
        for (uint64_t k = 0; k < 3; k++) {
            double x = original[3 * (uint64_t)v + k];
            low[k] = x < low[k] ? x : low[k];
            high[k] = x > high[k] ? x : high[k];
            original[3 * (uint64_t)v + k] = r->centre[k] + r->unit * (x / SKEL_LATTICE);
        }
    }
    double diagonal2 = 0;
    for (int k = 0; k < 3; k++) diagonal2 += (high[k] - low[k]) * (high[k] - low[k]);
    double diagonal = sqrt(diagonal2) * (r->unit / SKEL_LATTICE), percent = diagonal > 0 ? 100 / diagonal : 0;

    memset(weight, 0, out->joint_count * sizeof *weight);
    for (uint32_t v = 0; v < n; v++) {
        uint32_t j = joint_of[v];
        double w = area > 0 ? ring[v] : 1;
        distance[v] = curve_distance(out, &nb, j, original + 3 * (uint64_t)v, &other[v], &foot[v]);
        weight[j] += w;
        out->joints[j].radius += w * distance[v];
    }
    for (uint32_t j = 0; j < out->joint_count; j++)
        if (weight[j] > 0) out->joints[j].radius /= weight[j];
    for (uint32_t j = 0; j < out->joint_count; j++) { /* a joint without surface of its own takes the mean of its neighbours */
        double sum = 0;
        uint32_t count = 0;
        if (weight[j] > 0) continue;
        for (uint32_t k = nb.start[j]; k < nb.start[j + 1]; k++)
            if (weight[nb.joint[k]] > 0) {
                sum += out->joints[nb.joint[k]].radius;
                count++;
            }
        out->joints[j].radius = count > 0 ? sum / count : 0;
    }
    for (uint32_t j = 0; known != NULL && j < out->joint_count; j++)
        if (known[j] >= 0) out->joints[j].radius = known[j];
    double total = 0, sum = 0, error = 0;
    for (uint32_t v = 0; v < n; v++) {
        double w = area > 0 ? ring[v] : 1;
        double radius = out->joints[joint_of[v]].radius * (1 - foot[v]) + out->joints[other[v]].radius * foot[v];
        double e = fabs(distance[v] - radius) * percent, d = distance[v] * percent;
        total += w;
        sum += w * d;
        error += w * e;
        if (d > r->surface_distance_max) r->surface_distance_max = d;
        if (e > r->reconstruction_max) r->reconstruction_max = e;
    }
    r->surface_distance_mean = total > 0 ? sum / total : 0;
    r->reconstruction_mean = total > 0 ? error / total : 0;
    skeli_give(pool, original);
    skeli_give(pool, ring);
    skeli_give(pool, weight);
    skeli_give(pool, distance);
    skeli_give(pool, foot);
    skeli_give(pool, other);
    skeli_give(pool, nb.start);
    skeli_give(pool, nb.joint);
    return SVO_OK;
}

/* --- rules -------------------------------------------------------------------------------------------------------- */

static svo_result check_numbers(const skel_skeleton *s, svo_rules *rules, svo_error *err)
{
    const skel_report *r = &s->report;
    const double positive[] = {r->omega, r->unit};
    const double at_least_0[] = {r->delta, r->final_movement_sum, r->final_movement_max, r->thinness_error, r->surface_distance_mean,
                                 r->surface_distance_max, r->reconstruction_mean, r->reconstruction_max};
    for (size_t i = 0; i < sizeof positive / sizeof *positive; i++)
        if (!isfinite(positive[i]) || !(positive[i] > 0)) SVO_TRY(svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "omega and unit must be finite and positive (SKL-03)"), err));
    for (size_t i = 0; i < sizeof at_least_0 / sizeof *at_least_0; i++)
        if (!isfinite(at_least_0[i]) || !(at_least_0[i] >= 0))
            SVO_TRY(svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "number %zu of the report is negative or not finite (SKL-03)", i), err));
    for (int k = 0; k < 3; k++)
        if (!isfinite(r->centre[k])) SVO_TRY(svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "the centre is not finite (SKL-03)"), err));
    if (s->joint_count == 0) return svo_fail(err, SVO_INVALID_DATA, "there is no joint (SKL-04)");
    for (uint32_t j = 0; j < s->joint_count; j++) {
        const skel_joint *q = &s->joints[j];
        if (!isfinite(q->position[0]) || !isfinite(q->position[1]) || !isfinite(q->position[2]) || !isfinite(q->radius) || !(q->radius >= 0))
            SVO_TRY(svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "joint %u is not finite or has a negative radius (SKL-03)", j), err));
    }
    return SVO_OK;
}

static svo_result check_graph(const skel_skeleton *s, svo_rules *rules, svo_error *err)
{
    bool whole = true;
    for (uint32_t b = 0; b < s->bone_count; b++) {
        const skel_bone *q = &s->bones[b], *p = q - 1;
        if (q->a >= q->b || q->b >= s->joint_count) {
            SVO_TRY(svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "bone %u joins %u and %u of %u joints (SKL-05)", b, q->a, q->b, s->joint_count), err));
            whole = false;
        } else if (b > 0 && (p->a > q->a || (p->a == q->a && p->b >= q->b))) {
            SVO_TRY(svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "bone %u is not in ascending order (SKL-05)", b), err));
        }
    }
    if (!whole) return SVO_OK; /* components and counts follow from the bones */
    uint32_t n = s->joint_count, *parent = svo_alloc(s->allocator, n, sizeof *parent);
    skel_joint *joints = svo_alloc(s->allocator, n, sizeof *joints);
    svo_result result = SVO_OK;
    if (parent == NULL || joints == NULL) {
        result = skeli_no_memory(err);
    } else {
        skel_skeleton copy = *s;
        copy.joints = joints;
        memcpy(joints, s->joints, n * sizeof *joints);
        skeli_topology(&copy, parent);
        const skel_report *x = &copy.report, *y = &s->report;
        for (uint32_t j = 0; j < n && result == SVO_OK; j++)
            if (joints[j].component != s->joints[j].component || (j > 0 && joints[j].component < joints[j - 1].component))
                result = svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "joint %u is said to be in component %u, but is in %u (SKL-06)", j, s->joints[j].component,
                                                   joints[j].component), err);
        if (result == SVO_OK && (x->components != y->components || x->ends != y->ends || x->branches != y->branches || x->loops != y->loops ||
                                 x->isolated != y->isolated))
            result = svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "the stored counts of components, ends, branches and loops are not those of the bones (SKL-08)"), err);
    }
    svo_free(s->allocator, parent, n, sizeof *parent);
    svo_free(s->allocator, joints, n, sizeof *joints);
    return result;
}

svo_result skel_check(const skel_skeleton *s, svo_error *err) { return skel_check_all(s, NULL, err); }

svo_result skel_check_all(const skel_skeleton *s, svo_rules *rules, svo_error *err)
{
    svo_error here = {0};
    if (rules != NULL && err == NULL) err = &here;
    SVO_TRY(svo_go_on(rules, check_numbers(s, rules, err), err));
    if (s->joint_count == 0) return SVO_OK;
    SVO_TRY(check_graph(s, rules, err));
    uint64_t mapped = 0;
    for (uint64_t i = 0; i < s->map_count; i++) {
        if (s->map[i] == SVO_NONE) continue;
        if (s->map[i] >= s->joint_count)
            SVO_TRY(svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "element %llu of the map is joint %u of %u (SKL-07)", (unsigned long long)i, s->map[i], s->joint_count), err));
        mapped++;
    }
    if (mapped != s->report.mapped_count || s->report.input_count != s->map_count)
        SVO_TRY(svo_go_on(rules, svo_fail(err, SVO_INVALID_DATA, "%llu elements of the map have a joint, but HEAD says %llu (SKL-07)", (unsigned long long)mapped,
                                          (unsigned long long)s->report.mapped_count), err));
    return SVO_OK;
}
