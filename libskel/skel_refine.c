/* Refinement (Willcocks 2013, section 5.6): the surface of chosen bones, and of those around them, is contracted again at another omega; the curve that this gives
 * takes the place of the chosen bones. */
#include <math.h>
#include <string.h>

#include "skeli_geometry.h"
#include "skeli_refine.h"

/* What one refinement works on; all arrays are in its own pool. */
typedef struct part {
    skeli_pool pool;
    skeli_model *m;
    const skel_options *o;
    double omega; /* of this refinement */
    skeli_spokes spokes;
    uint8_t *selected;    /* of each bone */
    uint32_t *bone_group; /* of each selected bone */
    uint32_t groups;
    double *reach;        /* of each joint: how far along the curve it is from where the selection ends */
    uint32_t *owner;      /* of each joint: the joint at which it ends there */
    uint32_t *bone_of;    /* of each vertex of the mesh: its bone */
    uint8_t *state;       /* of each vertex of the mesh: OUT, BESIDE, IN */
    skeli_soup cut, fine; /* the surface of the part, as it was and tessellated again */
    uint32_t *to_cut;     /* vertex of the mesh -> of cut */
    uint32_t *to_fine;    /* vertex of cut -> of fine */
    uint32_t *from;       /* vertex of fine -> the vertex of the mesh that it was, or that is nearest along the edges */
    uint32_t *curve_of;   /* vertex of fine -> joint of curve */
    skel_skeleton curve;
} part;

enum { OUT = 0, BESIDE = 1, IN = 2 };

static void vertex_position(const skeli_model *m, uint32_t v, double p[3])
{
    const skel_report *r = &m->s->report;
    for (uint32_t k = 0; k < 3; k++) p[k] = r->centre[k] + r->unit * ((double)m->mesh.position[3 * (uint64_t)v + k] / SKEL_LATTICE);
}

/* --- selection ------------------------------------------------------------------------------------------------------- */

/* Groups of selected bones that share joints, in order of their first bones. */
static svo_result group_bones(part *p, svo_error *err)
{
    const skel_skeleton *s = p->m->s;
    uint32_t *set = skeli_take(&p->pool, s->joint_count, sizeof *set), *number = skeli_take(&p->pool, s->joint_count, sizeof *number);
    if (set == NULL || number == NULL) return skeli_no_memory(err);
    for (uint32_t j = 0; j < s->joint_count; j++) {
        set[j] = j;
        number[j] = SVO_NONE;
    }
    for (uint32_t b = 0; b < s->bone_count; b++) {
        if (!p->selected[b]) continue;
        uint32_t x = skeli_root(set, s->bones[b].a), y = skeli_root(set, s->bones[b].b);
        if (x != y) set[x > y ? x : y] = x > y ? y : x;
    }
    for (uint32_t b = 0; b < s->bone_count; b++) {
        if (!p->selected[b]) continue;
        uint32_t root = skeli_root(set, s->bones[b].a);
        if (number[root] == SVO_NONE) number[root] = p->groups++;
        p->bone_group[b] = number[root];
    }
    return SVO_OK;
}

/* Bones beside the selection, as far along the curve as its limbs are thick: the curve of a cut surface is wrong near the cut. */
static double margin(const part *p, uint32_t border)
{
    const skel_report *r = &p->m->s->report;
    return 2 * p->m->s->joints[border].radius + 4 * fmax(r->omega, p->omega) * r->unit;
}

static void find_reach(part *p)
{
    const skel_skeleton *s = p->m->s;
    for (uint32_t j = 0; j < s->joint_count; j++) {
        bool some = false, all = true;
        for (uint32_t k = p->spokes.start[j]; k < p->spokes.start[j + 1]; k++) {
            some |= p->selected[p->spokes.bone[k]];
            all &= p->selected[p->spokes.bone[k]] != 0;
        }
        p->reach[j] = some && !all ? 0 : INFINITY;
        p->owner[j] = some && !all ? j : SVO_NONE;
    }
    for (bool more = true; more;) { /* ends since distances fall; there are few bones within the margin */
        more = false;
        for (uint32_t b = 0; b < s->bone_count; b++) {
            if (p->selected[b]) continue;
            const double *x = s->joints[s->bones[b].a].position, *y = s->joints[s->bones[b].b].position;
            double length = skeli_apart_far(x, y);
            for (int turn = 0; turn < 2; turn++) {
                uint32_t from = turn ? s->bones[b].b : s->bones[b].a, to = turn ? s->bones[b].a : s->bones[b].b;
                if (p->owner[from] == SVO_NONE || p->reach[from] > margin(p, p->owner[from]) || !(p->reach[from] + length < p->reach[to])) continue;
                p->reach[to] = p->reach[from] + length;
                p->owner[to] = p->owner[from];
                more = true;
            }
        }
    }
}

/* The owner of the bone's surface beside the selection, SVO_NONE when it is too far. */
static uint32_t bone_owner(const part *p, uint32_t bone)
{
    uint32_t a = p->m->s->bones[bone].a, b = p->m->s->bones[bone].b, near = p->reach[a] <= p->reach[b] ? a : b;
    return p->owner[near] != SVO_NONE && p->reach[near] < margin(p, p->owner[near]) ? p->owner[near] : SVO_NONE;
}

static uint32_t nearest_bone(const part *p, uint32_t joint, const double *at)
{
    const skel_skeleton *s = p->m->s;
    double best = INFINITY, foot;
    uint32_t bone = SVO_NONE;
    for (uint32_t k = p->spokes.start[joint]; k < p->spokes.start[joint + 1]; k++) {
        uint32_t b = p->spokes.bone[k];
        double d = skeli_segment_distance(at, s->joints[s->bones[b].a].position, s->joints[s->bones[b].b].position, &foot);
        if (d >= best) continue;
        best = d;
        bone = b;
    }
    return bone;
}

/* The surface of the selection, that of the bones beside it, and what of the rest shares a triangle with the selection's. */
static svo_result mark(part *p, svo_error *err)
{
    const skeli_model *m = p->m;
    const skeli_soup *mesh = &m->mesh;
    p->bone_of = skeli_take(&p->pool, mesh->vertex_count, sizeof *p->bone_of);
    p->state = skeli_take(&p->pool, mesh->vertex_count, 1);
    if (p->bone_of == NULL || p->state == NULL) return skeli_no_memory(err);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        double at[3];
        vertex_position(m, v, at);
        uint32_t b = p->bone_of[v] = nearest_bone(p, m->joint_of[v], at);
        p->state[v] = b == SVO_NONE ? OUT : p->selected[b] ? IN : bone_owner(p, b) != SVO_NONE ? BESIDE : OUT;
    }
    return SVO_OK;
}

static bool is_part(const part *p, uint64_t triangle)
{
    const uint32_t *c = p->m->mesh.corner + 3 * triangle;
    uint8_t a = p->state[c[0]], b = p->state[c[1]], d = p->state[c[2]];
    return a == IN || b == IN || d == IN || (a == BESIDE && b == BESIDE && d == BESIDE);
}

/* --- the part's own curve ---------------------------------------------------------------------------------------------- */

static svo_result cut_out(part *p, svo_error *err)
{
    const skeli_soup *mesh = &p->m->mesh;
    uint64_t n = 0, dropped;
    uint32_t *corner = skeli_take(&p->pool, 3 * (uint64_t)mesh->triangle_count, sizeof *corner);
    p->to_cut = skeli_take(&p->pool, mesh->vertex_count, sizeof *p->to_cut);
    if (corner == NULL || p->to_cut == NULL) return skeli_no_memory(err);
    for (uint64_t t = 0; t < mesh->triangle_count; t++)
        if (is_part(p, t)) memcpy(corner + 3 * n++, mesh->corner + 3 * t, 3 * sizeof *corner);
    memset(&p->cut, 0, sizeof p->cut);
    if (n == 0) return SVO_OK;
    SVO_TRY(skeli_canonical(&p->pool, mesh->position, mesh->vertex_count, corner, n, &p->cut, p->to_cut, &dropped, err));
    skeli_give(&p->pool, corner);
    p->to_fine = skeli_take(&p->pool, p->cut.vertex_count, sizeof *p->to_fine);
    if (p->to_fine == NULL) return skeli_no_memory(err);
    uint64_t most = p->o->max_vertices != 0 ? p->o->max_vertices : 8000000;
    return skeli_tessellate(&p->pool, &p->cut, p->omega * SKEL_LATTICE, most, &p->fine, p->to_fine, err);
}

/* New vertices take after the old one that is fewest edges away (of those the one that is reached first in the order of the old ones). */
static svo_result find_origins(part *p, svo_error *err)
{
    const skeli_soup *f = &p->fine;
    uint32_t n = f->vertex_count, done = 0, known = 0;
    uint32_t *start = skeli_take(&p->pool, (uint64_t)n + 2, sizeof *start), *fan = skeli_take(&p->pool, 3 * (uint64_t)f->triangle_count, sizeof *fan);
    uint32_t *queue = skeli_take(&p->pool, n, sizeof *queue);
    p->from = skeli_take(&p->pool, n, sizeof *p->from);
    if (start == NULL || fan == NULL || queue == NULL || p->from == NULL) return skeli_no_memory(err);
    memset(start, 0, ((uint64_t)n + 2) * sizeof *start);
    for (uint64_t i = 0; i < 3 * (uint64_t)f->triangle_count; i++) start[f->corner[i] + 2]++;
    for (uint32_t v = 0; v < n; v++) start[v + 2] += start[v + 1];
    for (uint64_t i = 0; i < 3 * (uint64_t)f->triangle_count; i++) fan[start[f->corner[i] + 1]++] = (uint32_t)(i / 3);
    memset(p->from, 0xff, n * sizeof *p->from);
    for (uint32_t v = 0; v < p->m->mesh.vertex_count; v++) {
        if (p->to_cut[v] == SVO_NONE) continue;
        uint32_t to = p->to_fine[p->to_cut[v]];
        if (to == SVO_NONE || p->from[to] != SVO_NONE) continue;
        p->from[to] = v;
        queue[known++] = to;
    }
    for (; done < known; done++)
        for (uint32_t k = start[queue[done]]; k < start[queue[done] + 1]; k++)
            for (uint32_t e = 0; e < 3; e++) {
                uint32_t w = f->corner[3 * (uint64_t)fan[k] + e];
                if (p->from[w] != SVO_NONE) continue;
                p->from[w] = p->from[queue[done]];
                queue[known++] = w;
            }
    skeli_give(&p->pool, start);
    skeli_give(&p->pool, fan);
    skeli_give(&p->pool, queue);
    return known == n ? SVO_OK : svo_fail(err, SVO_INVALID_DATA, "the surface of the bones to refine could not be followed");
}

static svo_result contract_part(part *p, svo_error *err)
{
    const skel_report *r = &p->m->s->report;
    skel_options o = *p->o;
    skeli_state state;
    o.omega = p->omega;
    o.solid_divide = 0;
    o.keep_samples = false;
    p->curve = (skel_skeleton){.allocator = p->o->allocator};
    p->curve.report = (skel_report){.omega = p->omega, .unit = r->unit};
    memcpy(p->curve.report.centre, r->centre, sizeof r->centre);
    p->curve_of = skeli_take(&p->pool, p->fine.vertex_count, sizeof *p->curve_of);
    if (p->curve_of == NULL) return skeli_no_memory(err);
    SVO_TRY(skeli_contract(&p->pool, &p->fine, &o, NULL, &p->curve.report, &state, err));
    return skeli_extract(&p->pool, &p->fine, &state, p->m->surface, &o, &p->curve, p->curve_of, err);
}

/* --- joining ----------------------------------------------------------------------------------------------------------- */

/* A vertex of the selection belongs to its joint of the new curve, or, where that is not kept, to the nearest of what stands for it and its neighbours that are. */
static uint32_t new_joint(const part *p, const skeli_spokes *fans, const skeli_joined *joined, const skeli_part *k, uint32_t v, const double *at)
{
    const skel_skeleton *c = &p->curve;
    uint32_t base = p->m->s->joint_count, own = p->curve_of[v], best = joined->node[base + own];
    if (best != SVO_NONE) return best;
    double least = INFINITY;
    for (uint32_t i = fans->start[own]; i < fans->start[own + 1]; i++) {
        uint32_t b = fans->bone[i], to = joined->node[base + (c->bones[b].a == own ? c->bones[b].b : c->bones[b].a)];
        if (to == SVO_NONE) continue;
        double foot, d = skeli_segment_distance(at, joined->position + 3 * (uint64_t)to, joined->position + 3 * (uint64_t)to, &foot);
        if (d >= least) continue;
        least = d;
        best = to;
    }
    /* the kept joints that the group of bones ends at */
    for (uint32_t j = 0; j < base; j++) {
        if (p->owner[j] != j || joined->node[j] == SVO_NONE) continue;
        bool mine = false;
        for (uint32_t i = p->spokes.start[j]; i < p->spokes.start[j + 1]; i++) mine |= p->selected[p->spokes.bone[i]] && p->bone_group[p->spokes.bone[i]] == k->group_of[v];
        if (!mine) continue;
        double foot, d = skeli_segment_distance(at, p->m->s->joints[j].position, p->m->s->joints[j].position, &foot);
        if (d >= least) continue;
        least = d;
        best = joined->node[j];
    }
    if (best == SVO_NONE) best = 0; /* nothing of the component is left: all of it became part of another one */
    return best;
}

/* The mesh with the finer part in it, and the joints of its vertices; part_of: which of them are of the selection. */
static svo_result replace_mesh(part *p, const skeli_joined *joined, const skeli_part *k, uint8_t **part_of, svo_error *err)
{
    skeli_model *m = p->m;
    skeli_spokes fans;
    uint64_t vertices = m->mesh.vertex_count, points = vertices + p->fine.vertex_count, triangles = 0, dropped;
    SVO_TRY(skeli_spokes_make(&p->pool, &p->curve, &fans, err));
    int32_t *position = skeli_take(&p->pool, 3 * points, sizeof *position);
    uint32_t *corner = skeli_take(&p->pool, 3 * ((uint64_t)m->mesh.triangle_count + p->fine.triangle_count), sizeof *corner);
    uint32_t *remap = skeli_take(&p->pool, points, sizeof *remap);
    if (position == NULL || corner == NULL || remap == NULL) return skeli_no_memory(err);
    if (points >= INT32_MAX) return svo_fail(err, SVO_LIMIT, "the refined mesh has more than 2^31 vertices");
    memcpy(position, m->mesh.position, 3 * vertices * sizeof *position);
    memcpy(position + 3 * vertices, p->fine.position, 3 * (uint64_t)p->fine.vertex_count * sizeof *position);
    for (uint64_t t = 0; t < m->mesh.triangle_count; t++)
        if (!is_part(p, t)) memcpy(corner + 3 * triangles++, m->mesh.corner + 3 * t, 3 * sizeof *corner);
    for (uint64_t t = 0; t < p->fine.triangle_count; t++, triangles++)
        for (uint32_t e = 0; e < 3; e++) corner[3 * triangles + e] = (uint32_t)vertices + p->fine.corner[3 * t + e];
    skeli_soup mesh;
    SVO_TRY(skeli_canonical(m->pool, position, points, corner, triangles, &mesh, remap, &dropped, err));
    uint32_t *joint_of = skeli_take(m->pool, mesh.vertex_count, sizeof *joint_of);
    if (joint_of == NULL) return skeli_no_memory(err);
    memset(joint_of, 0xff, mesh.vertex_count * sizeof *joint_of);
    uint8_t *in = *part_of = skeli_take(&p->pool, mesh.vertex_count, 1);
    if (in == NULL) return skeli_no_memory(err);
    memset(in, 0, mesh.vertex_count);
    for (uint32_t v = 0; v < p->fine.vertex_count; v++) {
        uint32_t to = remap[vertices + v], from = p->from[v];
        if (to == SVO_NONE) continue;
        const int32_t *q = p->fine.position + 3 * (uint64_t)v;
        double at[3];
        for (int e = 0; e < 3; e++) at[e] = m->s->report.centre[e] + m->s->report.unit * ((double)q[e] / SKEL_LATTICE);
        in[to] = p->state[from] == IN;
        joint_of[to] = in[to] ? new_joint(p, &fans, joined, k, v, at) : joined->node[m->joint_of[from]];
    }
    for (uint32_t v = 0; v < vertices; v++)
        if (remap[v] != SVO_NONE && p->state[v] != IN) joint_of[remap[v]] = joined->node[m->joint_of[v]];
    for (uint32_t v = 0; v < m->soup_vertices; v++) {
        uint32_t old = m->moved[v], to = remap[old];
        if (to == SVO_NONE) to = remap[vertices + p->to_fine[p->to_cut[old]]];
        m->moved[v] = to;
    }
    skeli_give(m->pool, m->mesh.position);
    skeli_give(m->pool, m->mesh.corner);
    skeli_give(m->pool, m->joint_of);
    m->mesh = mesh;
    m->joint_of = joint_of;
    return SVO_OK;
}

/* Which refinement selects the bones that are left; new ones are nobody's. */
static void carry(const skel_skeleton *s, const uint8_t *selected, const skeli_joined *joined, const uint32_t *chosen, uint32_t *next)
{
    for (uint32_t b = 0; b < joined->bones; b++) next[b] = SVO_NONE;
    for (uint32_t b = 0; b < s->bone_count; b++) {
        if (selected[b] || chosen[b] == SVO_NONE) continue;
        uint32_t x = joined->node[s->bones[b].a], y = joined->node[s->bones[b].b], low = 0, high = joined->bones;
        if (x > y) {
            uint32_t t = x;
            x = y;
            y = t;
        }
        while (low < high) {
            uint32_t middle = low + (high - low) / 2;
            const uint32_t *q = joined->bone + 2 * (uint64_t)middle;
            if (q[0] < x || (q[0] == x && q[1] < y)) low = middle + 1;
            else high = middle;
        }
        next[low] = chosen[b];
    }
}

/* Joints and bones of the skeleton become those of the join. radius: of joints that stay, else negative. Where new bones begin at a joint it has less surface than before, of one side; its radius is that of all of it. */
static svo_result replace_curve(part *p, const skeli_joined *joined, double *radius, svo_error *err)
{
    skel_skeleton *s = p->m->s;
    const svo_allocator *a = s->allocator;
    skel_joint *joints = svo_calloc(a, joined->joints, sizeof *joints);
    skel_bone *bones = joined->bones > 0 ? svo_alloc(a, joined->bones, sizeof *bones) : NULL;
    uint32_t *parent = skeli_take(&p->pool, (uint64_t)joined->joints + 1, sizeof *parent);
    if (joints == NULL || (joined->bones > 0 && bones == NULL) || parent == NULL) {
        svo_free(a, joints, joined->joints, sizeof *joints);
        svo_free(a, bones, joined->bones, sizeof *bones);
        return skeli_no_memory(err);
    }
    for (uint32_t j = 0; j < joined->joints; j++) {
        memcpy(joints[j].position, joined->position + 3 * (uint64_t)j, sizeof joints[j].position);
        radius[j] = -1;
    }
    for (uint32_t j = 0; j < s->joint_count; j++)
        if (joined->node[j] != SVO_NONE) radius[joined->node[j]] = s->joints[j].radius;
    for (uint32_t b = 0; b < joined->bones; b++) bones[b] = (skel_bone){joined->bone[2 * (uint64_t)b], joined->bone[2 * (uint64_t)b + 1]};
    svo_free(a, s->joints, s->joint_count, sizeof *s->joints);
    svo_free(a, s->bones, s->bone_count, sizeof *s->bones);
    s->joints = joints;
    s->bones = bones;
    s->joint_count = joined->joints;
    s->bone_count = joined->bones;
    skeli_topology(s, parent);
    return SVO_OK;
}

static svo_result measure(part *p, const double *radius, svo_error *err)
{
    skel_skeleton *s = p->m->s;
    skel_report *r = &s->report;
    r->surface_distance_mean = r->surface_distance_max = r->reconstruction_mean = r->reconstruction_max = 0;
    r->tessellated_vertices = p->m->mesh.vertex_count;
    r->tessellated_triangles = p->m->mesh.triangle_count;
    r->leftover_triangles += p->curve.report.leftover_triangles;
    r->converged = r->converged && p->curve.report.converged;
    for (uint32_t j = 0; j < s->joint_count; j++) s->joints[j].radius = 0;
    return skeli_measure(&p->pool, &p->m->mesh, p->m->joint_of, radius, s, err); /* the surface of joints that are kept is the same, with more vertices next to the part */
}

/* Reconstruction error in the mean over vertices of the mesh in `which`, by the area around them, percent of the diagonal. */
static svo_result part_error(part *p, const uint8_t *which, double *out, svo_error *err)
{
    const skeli_model *m = p->m;
    const skeli_soup *mesh = &m->mesh;
    const skel_skeleton *s = m->s;
    skeli_spokes spokes;
    SVO_TRY(skeli_spokes_make(&p->pool, s, &spokes, err));
    double *at = skeli_take(&p->pool, 3 * (uint64_t)mesh->vertex_count, sizeof *at), *ring = skeli_take(&p->pool, mesh->vertex_count, sizeof *ring);
    if (at == NULL || ring == NULL) return skeli_no_memory(err);
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, sum = 0, area = 0;
    for (uint64_t i = 0; i < 3 * (uint64_t)mesh->vertex_count; i++) at[i] = mesh->position[i];
    skeli_rings(mesh, at, ring);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        double *q = at + 3 * (uint64_t)v;
        vertex_position(m, v, q);
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], q[k]);
            high[k] = fmax(high[k], q[k]);
        }
        if (!which[v]) continue;
        uint32_t j = m->joint_of[v];
        double best, radius = s->joints[j].radius, foot;
        best = skeli_segment_distance(q, s->joints[j].position, s->joints[j].position, &foot);
        for (uint32_t k = spokes.start[j]; k < spokes.start[j + 1]; k++) {
            const skel_bone *b = &s->bones[spokes.bone[k]];
            double d = skeli_segment_distance(q, s->joints[b->a].position, s->joints[b->b].position, &foot);
            if (d >= best) continue;
            best = d;
            radius = s->joints[b->a].radius * (1 - foot) + s->joints[b->b].radius * foot;
        }
        sum += ring[v] * fabs(best - radius);
        area += ring[v];
    }
    double diagonal = skeli_apart_far(low, high);
    *out = area > 0 && diagonal > 0 ? 100 * sum / area / diagonal : 0;
    skeli_give(&p->pool, spokes.start);
    skeli_give(&p->pool, spokes.bone);
    skeli_give(&p->pool, at);
    skeli_give(&p->pool, ring);
    return SVO_OK;
}

static svo_result join_part(part *p, uint32_t **chosen, struct skel_refined *result, svo_error *err)
{
    const skeli_model *m = p->m;
    uint32_t n = p->fine.vertex_count;
    uint8_t *inside = skeli_take(&p->pool, n, 1), *in = skeli_take(&p->pool, m->mesh.vertex_count, 1);
    uint32_t *owner = skeli_take(&p->pool, n, sizeof *owner), *group = skeli_take(&p->pool, n, sizeof *group);
    if (inside == NULL || in == NULL || owner == NULL || group == NULL) return skeli_no_memory(err);
    for (uint32_t v = 0; v < n; v++) {
        uint32_t from = p->from[v], bone = p->bone_of[from];
        inside[v] = p->state[from] == IN;
        owner[v] = p->state[from] == BESIDE ? bone_owner(p, bone) : SVO_NONE;
        group[v] = inside[v] ? p->bone_group[bone] : 0;
    }
    for (uint32_t v = 0; v < m->mesh.vertex_count; v++) in[v] = p->state[v] == IN;
    SVO_TRY(part_error(p, in, &result->error_before, err));
    const skeli_part k = {.base = m->s, .spokes = &p->spokes, .selected = p->selected, .bone_group = p->bone_group, .curve = &p->curve, .mesh = &p->fine,
                          .curve_of = p->curve_of, .inside = inside, .owner = owner, .group_of = group, .near = 0.5 * p->omega * m->s->report.unit};
    skeli_joined joined;
    SVO_TRY(skeli_join(&p->pool, &k, &joined, err));
    double *radius = skeli_take(&p->pool, joined.joints, sizeof *radius);
    uint32_t *next = skeli_take(m->pool, joined.bones, sizeof *next);
    if (radius == NULL || next == NULL) return skeli_no_memory(err);
    carry(m->s, p->selected, &joined, *chosen, next);
    skeli_give(m->pool, *chosen);
    *chosen = next;
    result->joints_removed = m->s->joint_count - joined.kept;
    result->joints_added = joined.joints - joined.kept;
    result->links = joined.links;
    result->iterations = p->curve.report.iterations;
    result->converged = p->curve.report.converged;
    uint8_t *part_of;
    SVO_TRY(replace_mesh(p, &joined, &k, &part_of, err));
    SVO_TRY(replace_curve(p, &joined, radius, err));
    SVO_TRY(measure(p, radius, err));
    return part_error(p, part_of, &result->error_after, err);
}

static svo_result run(part *p, uint32_t **chosen, skel_refine *r, uint32_t number, svo_error *err)
{
    const skel_skeleton *s = p->m->s;
    p->selected = skeli_take(&p->pool, s->bone_count, 1);
    p->bone_group = skeli_take(&p->pool, s->bone_count, sizeof *p->bone_group);
    p->reach = skeli_take(&p->pool, s->joint_count, sizeof *p->reach);
    p->owner = skeli_take(&p->pool, s->joint_count, sizeof *p->owner);
    if (p->selected == NULL || p->bone_group == NULL || p->reach == NULL || p->owner == NULL) return skeli_no_memory(err);
    r->result.converged = true;
    for (uint32_t b = 0; b < s->bone_count; b++) r->result.bones += p->selected[b] = (*chosen)[b] == number;
    if (r->result.bones == 0) return SVO_OK;
    SVO_TRY(skeli_spokes_make(&p->pool, s, &p->spokes, err));
    SVO_TRY(group_bones(p, err));
    find_reach(p);
    SVO_TRY(mark(p, err));
    SVO_TRY(cut_out(p, err));
    if (p->cut.triangle_count == 0) return SVO_OK; /* no surface is theirs */
    SVO_TRY(find_origins(p, err));
    SVO_TRY(contract_part(p, err));
    return join_part(p, chosen, &r->result, err);
}

svo_result skeli_refine(skeli_model *m, const skel_options *o, svo_error *err)
{
    uint32_t *chosen = skeli_take(m->pool, m->s->bone_count, sizeof *chosen);
    if (chosen == NULL) return skeli_no_memory(err);
    SVO_TRY(skeli_select(m->s, o->refine, o->refine_count, chosen, err));
    for (uint32_t i = 0; i < o->refine_count; i++) {
        part p = {.pool = {.allocator = o->allocator}, .m = m, .o = o, .omega = o->refine[i].omega};
        memset(&o->refine[i].result, 0, sizeof o->refine[i].result);
        svo_result r = run(&p, &chosen, &o->refine[i], i, err);
        skel_skeleton_free(&p.curve);
        skeli_pool_free(&p.pool);
        SVO_TRY(r);
        if (o->refine[i].result.bones == 0) svo_warn(o->warnings, "refinement %u selects no bone", i + 1);
        if (!o->refine[i].result.converged) svo_warn(o->warnings, "refinement %u did not converge in %llu sweeps", i + 1, (unsigned long long)o->refine[i].result.iterations);
    }
    skeli_give(m->pool, chosen);
    return SVO_OK;
}
