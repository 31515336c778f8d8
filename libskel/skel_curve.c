/* From the contracted vertices to joints and bones (Willcocks 2013, section 5.5, Postprocessing), with the clean-up that the text leaves out: what is
 * still a triangle after the weld becomes one joint, and corners of it that lead nowhere are folded into it. */
#include "skeli_cells.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static int by_three(const void *a, const void *b)
{
    const uint32_t *x = a, *y = b;
    for (int k = 0; k < 3; k++)
        if (x[k] != y[k]) return x[k] < y[k] ? -1 : 1;
    return 0;
}

/* Weld whatever is nearer than omega, heaviest first, and map the mesh to the groups. */
static svo_result weld_all(skeli_pool *pool, const skeli_soup *mesh, const skeli_state *s, const skel_options *o, skeli_curve *c, svo_error *err)
{
    uint32_t n = s->count;
    uint32_t *order = skeli_take(pool, n, sizeof *order), *scratch = skeli_take(pool, n, sizeof *scratch);
    uint32_t *label = skeli_take(pool, n, sizeof *label);
    uint64_t *key = skeli_take(pool, n, sizeof *key);
    if (order == NULL || scratch == NULL || label == NULL || key == NULL) return skeli_no_memory(err);
    for (uint32_t i = 0; i < n; i++) {
        order[i] = i;
        key[i] = UINT32_MAX - s->weight[i];
    }
    skeli_sort_by64(order, scratch, n, key, 32);
    SVO_TRY(skeli_weld(pool->allocator, s->position, n, order, o->omega * SKEL_LATTICE, label, &c->welded, err));
    for (uint32_t v = 0; v < mesh->vertex_count; v++) c->joint_of[v] = label[s->live[v]];
    /* contracted positions */
    c->position = skeli_take(pool, 3 * (uint64_t)c->welded, sizeof *c->position);
    double *weight = skeli_take(pool, c->welded, sizeof *weight);
    if (c->position == NULL || weight == NULL) return skeli_no_memory(err);
    memset(c->position, 0, 3 * (uint64_t)c->welded * sizeof *c->position);
    memset(weight, 0, c->welded * sizeof *weight);
    for (uint32_t i = 0; i < n; i++) {
        weight[label[i]] += s->weight[i];
        for (uint64_t k = 0; k < 3; k++) c->position[3 * (uint64_t)label[i] + k] += s->weight[i] * s->position[3 * (uint64_t)i + k];
    }
    for (uint32_t j = 0; j < c->welded; j++)
        for (uint64_t k = 0; k < 3; k++) c->position[3 * (uint64_t)j + k] /= weight[j];
    skeli_give(pool, order);
    skeli_give(pool, scratch);
    skeli_give(pool, label);
    skeli_give(pool, key);
    skeli_give(pool, weight);
    c->joints = c->welded;
    return SVO_OK;
}

/* Distinct pairs and distinct leftover triangles of joints. */
static svo_result connect(skeli_pool *pool, const skeli_soup *mesh, skeli_curve *c, svo_error *err)
{
    uint64_t f = mesh->triangle_count;
    c->bone = skeli_take(pool, 6 * f, sizeof *c->bone);
    c->triangle = skeli_take(pool, 3 * f, sizeof *c->triangle);
    uint32_t *scratch = skeli_take(pool, 6 * f, sizeof *scratch), *bucket = skeli_take(pool, (uint64_t)c->joints + 1, sizeof *bucket);
    if (c->bone == NULL || c->triangle == NULL || scratch == NULL || bucket == NULL) return skeli_no_memory(err);
    for (uint64_t t = 0; t < f; t++) {
        uint32_t j[3];
        for (int k = 0; k < 3; k++) j[k] = c->joint_of[mesh->corner[3 * t + (uint64_t)k]];
        for (int k = 0; k < 3; k++) {
            uint32_t a = j[k], b = j[(k + 1) % 3];
            if (a == b) continue;
            c->bone[2 * c->bones] = a < b ? a : b;
            c->bone[2 * c->bones++ + 1] = a < b ? b : a;
        }
        if (j[0] == j[1] || j[1] == j[2] || j[2] == j[0]) continue;
        uint32_t *to = c->triangle + 3 * c->triangles++;
        memcpy(to, j, sizeof j);
        for (int pass = 0; pass < 2; pass++) /* three elements: two passes sort them */
            for (int k = 0; k < 2; k++)
                if (to[k] > to[k + 1]) {
                    uint32_t x = to[k];
                    to[k] = to[k + 1];
                    to[k + 1] = x;
                }
    }
    c->bones = skeli_sort_unique(c->bone, c->bones, 2, c->joints, scratch, bucket);
    c->triangles = skeli_sort_unique(c->triangle, c->triangles, 3, c->joints, scratch, bucket);
    skeli_give(pool, scratch);
    skeli_give(pool, bucket);
    return SVO_OK;
}

/* Group leftover triangles that share a bone; drop their bones; connect the corners of each group to one new joint. */
static svo_result replace_triangles(skeli_pool *pool, skeli_curve *c, svo_error *err)
{
    if (c->triangles == 0) return SVO_OK;
    uint64_t n = c->triangles;
    uint32_t *side = skeli_take(pool, 9 * n, sizeof *side); /* (a, b, triangle) */
    uint32_t *parent = skeli_take(pool, n, sizeof *parent), *group = skeli_take(pool, n, sizeof *group);
    uint32_t *corner = skeli_take(pool, 9 * n, sizeof *corner); /* (group, corner, 0) */
    uint32_t *bone = skeli_take(pool, 2 * (c->bones + 3 * n), sizeof *bone);
    if (side == NULL || parent == NULL || group == NULL || corner == NULL || bone == NULL) return skeli_no_memory(err);
    for (uint32_t t = 0; t < n; t++) {
        parent[t] = t;
        const uint32_t *j = c->triangle + 3 * (uint64_t)t;
        const uint32_t sides[9] = {j[0], j[1], t, j[0], j[2], t, j[1], j[2], t};
        memcpy(side + 9 * (uint64_t)t, sides, sizeof sides);
    }
    qsort(side, 3 * n, 3 * sizeof *side, by_three);
    for (uint64_t i = 1; i < 3 * n; i++) {
        const uint32_t *x = side + 3 * (i - 1), *y = side + 3 * i;
        if (x[0] != y[0] || x[1] != y[1]) continue;
        uint32_t p = skeli_root(parent, x[2]), q = skeli_root(parent, y[2]);
        if (p != q) parent[p > q ? p : q] = p > q ? q : p;
    }
    for (uint32_t t = 0; t < n; t++) { /* roots have the smallest number, so they come first */
        uint32_t r = skeli_root(parent, t);
        group[t] = r == t ? c->groups++ : group[r];
    }
    /* bones that are no side of a leftover triangle */
    uint64_t kept = 0, at = 0;
    for (uint64_t b = 0; b < c->bones; b++) {
        const uint32_t *e = c->bone + 2 * b;
        while (at < 3 * n && (side[3 * at] < e[0] || (side[3 * at] == e[0] && side[3 * at + 1] < e[1]))) at++;
        if (at < 3 * n && side[3 * at] == e[0] && side[3 * at + 1] == e[1]) continue;
        memcpy(bone + 2 * kept++, e, 2 * sizeof *e);
    }
    for (uint32_t t = 0; t < n; t++)
        for (int k = 0; k < 3; k++) {
            uint32_t *to = corner + 3 * (3 * (uint64_t)t + (uint64_t)k);
            to[0] = group[t];
            to[1] = c->triangle[3 * (uint64_t)t + (uint64_t)k];
            to[2] = 0;
        }
    qsort(corner, 3 * n, 3 * sizeof *corner, by_three);
    for (uint64_t i = 0; i < 3 * n; i++) {
        if (i > 0 && by_three(corner + 3 * i, corner + 3 * (i - 1)) == 0) continue;
        bone[2 * kept] = corner[3 * i + 1];
        bone[2 * kept++ + 1] = c->welded + corner[3 * i];
    }
    skeli_give(pool, side);
    skeli_give(pool, parent);
    skeli_give(pool, group);
    skeli_give(pool, corner);
    skeli_give(pool, c->bone);
    c->bone = bone;
    c->bones = kept;
    c->joints = c->welded + c->groups;
    double *position = skeli_take(pool, 3 * (uint64_t)c->joints, sizeof *position);
    if (position == NULL) return skeli_no_memory(err);
    memcpy(position, c->position, 3 * (uint64_t)c->welded * sizeof *position);
    skeli_give(pool, c->position);
    c->position = position;
    return SVO_OK;
}

/* Centre each welded joint: move it from where it was contracted to towards the area-weighted centroid (plain mean where there is no
 * area) of the surface that is mapped to it. The centroid is the centre of a surface that lies around the joint, but of a cap, as ends have it,
 * it is a point near the cap: so an end goes less of the way, the more one-sided its surface is (displacement over mean distance). */
#define AROUND 0.65    /* up to here all of it */
#define ONE_SIDED 0.9 /* from here on nothing */

static svo_result place_centroids(skeli_pool *pool, const skeli_soup *mesh, const double *ring, skeli_curve *c, svo_error *err)
{
    enum { AREA, CENTROID, COUNT = 4, MEAN, DISTANCE = 8, AREA_DISTANCE, COLUMNS };
    double *sum = skeli_take(pool, COLUMNS * (uint64_t)c->welded, sizeof *sum);
    uint32_t *degree = skeli_take(pool, c->joints, sizeof *degree);
    if (sum == NULL || degree == NULL) return skeli_no_memory(err);
    memset(degree, 0, c->joints * sizeof *degree);
    for (uint64_t i = 0; i < 2 * c->bones; i++) degree[c->bone[i]]++;
    memset(sum, 0, COLUMNS * (uint64_t)c->welded * sizeof *sum);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        double *s = sum + COLUMNS * (uint64_t)c->joint_of[v], distance2 = 0;
        const double *at = c->position + 3 * (uint64_t)c->joint_of[v];
        s[AREA] += ring[v];
        s[COUNT] += 1;
        for (int k = 0; k < 3; k++) {
            double x = mesh->position[3 * (uint64_t)v + (uint64_t)k];
            s[CENTROID + k] += ring[v] * x;
            s[MEAN + k] += x;
            distance2 += (x - at[k]) * (x - at[k]);
        }
        s[DISTANCE] += sqrt(distance2);
        s[AREA_DISTANCE] += ring[v] * sqrt(distance2);
    }
    for (uint32_t j = 0; j < c->welded; j++) {
        const double *s = sum + COLUMNS * (uint64_t)j;
        double *at = c->position + 3 * (uint64_t)j, to[3], moved2 = 0;
        bool area = s[AREA] > 0;
        for (int k = 0; k < 3; k++) {
            to[k] = area ? s[CENTROID + k] / s[AREA] : s[MEAN + k] / s[COUNT];
            moved2 += (to[k] - at[k]) * (to[k] - at[k]);
        }
        double distance = area ? s[AREA_DISTANCE] / s[AREA] : s[DISTANCE] / s[COUNT];
        double one_sided = distance > 0 ? sqrt(moved2) / distance : 0, f = (ONE_SIDED - one_sided) / (ONE_SIDED - AROUND);
        f = degree[j] > 1 || f > 1 ? 1 : f < 0 ? 0 : f;
        for (int k = 0; k < 3; k++) at[k] += f * (to[k] - at[k]);
    }
    skeli_give(pool, sum);
    skeli_give(pool, degree);
    return SVO_OK;
}

/* New joints go to the middle of their corners; a corner whose only bone leads there is folded into it. */
static svo_result fold_leaves(skeli_pool *pool, const skeli_soup *mesh, skeli_curve *c, svo_error *err)
{
    uint32_t *degree = skeli_take(pool, c->joints, sizeof *degree), *into = skeli_take(pool, c->joints, sizeof *into);
    double *sum = skeli_take(pool, 4 * ((uint64_t)c->groups + 1), sizeof *sum);
    if (degree == NULL || into == NULL || sum == NULL) return skeli_no_memory(err);
    memset(degree, 0, c->joints * sizeof *degree);
    memset(sum, 0, 4 * ((uint64_t)c->groups + 1) * sizeof *sum);
    for (uint64_t b = 0; b < c->bones; b++) {
        uint32_t from = c->bone[2 * b], to = c->bone[2 * b + 1];
        degree[from]++;
        degree[to]++;
        if (to < c->welded) continue;
        double *s = sum + 4 * (uint64_t)(to - c->welded);
        s[0] += 1;
        for (int k = 0; k < 3; k++) s[1 + k] += c->position[3 * (uint64_t)from + (uint64_t)k];
    }
    for (uint32_t g = 0; g < c->groups; g++)
        for (int k = 0; k < 3; k++) c->position[3 * (uint64_t)(c->welded + g) + (uint64_t)k] = sum[4 * (uint64_t)g + 1 + (uint64_t)k] / sum[4 * (uint64_t)g];
    for (uint32_t j = 0; j < c->joints; j++) into[j] = j;
    uint64_t kept = 0;
    for (uint64_t b = 0; b < c->bones; b++) {
        uint32_t from = c->bone[2 * b], to = c->bone[2 * b + 1];
        if (to >= c->welded && degree[from] == 1) {
            into[from] = to;
            continue;
        }
        c->bone[2 * kept] = from;
        c->bone[2 * kept++ + 1] = to;
    }
    c->bones = kept;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) c->joint_of[v] = into[c->joint_of[v]];
    /* number what is left without gaps */
    uint32_t n = 0;
    for (uint32_t j = 0; j < c->joints; j++) {
        if (into[j] != j) continue;
        memmove(c->position + 3 * (uint64_t)n, c->position + 3 * (uint64_t)j, 3 * sizeof *c->position);
        degree[j] = n++;
    }
    for (uint64_t i = 0; i < 2 * c->bones; i++) c->bone[i] = degree[c->bone[i]];
    for (uint32_t v = 0; v < mesh->vertex_count; v++) c->joint_of[v] = degree[c->joint_of[v]];
    c->joints = n;
    skeli_give(pool, degree);
    skeli_give(pool, into);
    skeli_give(pool, sum);
    return SVO_OK;
}

/* Order joints by component and write them out. */
static svo_result emit(skeli_pool *pool, const skeli_soup *mesh, skeli_curve *c, skel_skeleton *out, svo_error *err)
{
    uint32_t n = c->joints;
    uint32_t *parent = skeli_take(pool, (uint64_t)n + 1, sizeof *parent), *order = skeli_take(pool, n, sizeof *order);
    uint32_t *place = skeli_take(pool, (uint64_t)n + 1, sizeof *place), *scratch = skeli_take(pool, 2 * c->bones + n, sizeof *scratch);
    uint64_t *key = skeli_take(pool, n, sizeof *key);
    if (parent == NULL || order == NULL || place == NULL || scratch == NULL || key == NULL) return skeli_no_memory(err);
    for (uint32_t j = 0; j < n; j++) parent[j] = order[j] = j;
    for (uint64_t b = 0; b < c->bones; b++) {
        uint32_t p = skeli_root(parent, c->bone[2 * b]), q = skeli_root(parent, c->bone[2 * b + 1]);
        if (p != q) parent[p > q ? p : q] = p > q ? q : p;
    }
    for (uint32_t j = 0; j < n; j++) key[j] = skeli_root(parent, j);
    skeli_sort_by64(order, scratch, n, key, 32);
    for (uint32_t k = 0; k < n; k++) place[order[k]] = k;
    out->joints = svo_calloc(out->allocator, n, sizeof *out->joints);
    out->bones = c->bones > 0 ? svo_alloc(out->allocator, c->bones, sizeof *out->bones) : NULL;
    if (out->joints == NULL || (c->bones > 0 && out->bones == NULL)) {
        svo_free(out->allocator, out->joints, n, sizeof *out->joints);
        svo_free(out->allocator, out->bones, c->bones, sizeof *out->bones);
        out->joints = NULL;
        out->bones = NULL;
        return skeli_no_memory(err);
    }
    out->joint_count = n;
    out->bone_count = (uint32_t)c->bones;
    const skel_report *r = &out->report;
    for (uint32_t j = 0; j < n; j++)
        for (int k = 0; k < 3; k++)
            out->joints[place[j]].position[k] = r->centre[k] + r->unit * (c->position[3 * (uint64_t)j + (uint64_t)k] / SKEL_LATTICE);
    for (uint64_t b = 0; b < c->bones; b++) {
        uint32_t x = place[c->bone[2 * b]], y = place[c->bone[2 * b + 1]];
        c->bone[2 * b] = x < y ? x : y;
        c->bone[2 * b + 1] = x < y ? y : x;
    }
    uint64_t bones = skeli_sort_unique(c->bone, c->bones, 2, n, scratch, parent);
    SVO_ASSERT(bones == c->bones);
    out->bone_count = (uint32_t)bones;
    for (uint64_t b = 0; b < bones; b++) out->bones[b] = (skel_bone){c->bone[2 * b], c->bone[2 * b + 1]};
    for (uint32_t v = 0; v < mesh->vertex_count; v++) c->joint_of[v] = place[c->joint_of[v]];
    skeli_topology(out, parent);
    skeli_give(pool, parent);
    skeli_give(pool, order);
    skeli_give(pool, place);
    skeli_give(pool, scratch);
    skeli_give(pool, key);
    return SVO_OK;
}

/* Into the middle of the solid; and where the surface is closed and the curve has not its handles and parts, one that has, from the solid's cells, with the ends that the contraction found. */
static svo_result place_inside(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, const skel_options *o, bool inside, skeli_curve *c, skel_report *r, svo_error *err)
{
    const double omega = o->omega * SKEL_LATTICE;
    const skeli_genus *g = &surface->genus;
    if (inside) SVO_TRY(skeli_centre(pool, mesh, surface, omega, c, err));
    if (g->known) {
        SVO_TRY(skeli_curve_betti(pool, c, &r->contracted_components, &r->contracted_loops, err));
        const bool differs = r->contracted_components != g->components || r->contracted_loops != g->genus;
        SVO_TRY(skeli_curve_of_cells(pool, mesh, surface, g, differs, o->threads, c, &r->rebuilt, err));
        if (r->rebuilt) SVO_TRY(skeli_centre(pool, mesh, surface, omega, c, err));
    }
    return inside || r->rebuilt ? skeli_finish(pool, mesh, surface, omega, o->threads, c, err) : SVO_OK;
}

svo_result skeli_extract(skeli_pool *pool, const skeli_soup *mesh, const skeli_state *s, const skeli_surface *surface, const skel_options *options,
                         skel_skeleton *out, uint32_t *joint_of, svo_error *err)
{
    skeli_curve c = {.joint_of = joint_of};
    SVO_TRY(weld_all(pool, mesh, s, options, &c, err));
    SVO_TRY(connect(pool, mesh, &c, err));
    out->report.leftover_triangles = (uint32_t)c.triangles;
    SVO_TRY(replace_triangles(pool, &c, err));
    double *original = skeli_take(pool, 3 * (uint64_t)mesh->vertex_count, sizeof *original);
    double *ring = skeli_take(pool, mesh->vertex_count, sizeof *ring);
    if (original == NULL || ring == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < 3 * (uint64_t)mesh->vertex_count; i++) original[i] = mesh->position[i];
    skeli_rings(mesh, original, ring);
    skeli_give(pool, original);
    if (options->place != SKEL_PLACE_CONTRACTED) SVO_TRY(place_centroids(pool, mesh, ring, &c, err));
    SVO_TRY(fold_leaves(pool, mesh, &c, err));
    bool inside = surface != NULL && skeli_mostly_inside(surface, &c);
    if (inside) SVO_TRY(skeli_close_false_loops(pool, mesh, surface, &c, err));
    if (surface != NULL && options->place == SKEL_PLACE_INSIDE) SVO_TRY(place_inside(pool, mesh, surface, options, inside, &c, &out->report, err));
    skeli_give(pool, ring);
    SVO_TRY(emit(pool, mesh, &c, out, err));
    return SVO_OK;
}
