/* Skinning weights. */
#include "skel_skin.h"

#include <math.h>
#include <string.h>

#include "skeli_internal.h"

skel_skin_options skel_default_skin_options(void)
{
    return (skel_skin_options){.influences = 4, .smoothing = 8};
}

/* --- distinct points and their edges -------------------------------------------------------------------------------- */

typedef struct web {
    uint64_t vertices;  /* of the map */
    uint32_t count;     /* distinct points */
    uint32_t *point_of; /* of each vertex */
    double *position;   /* of each vertex, then of each point; 3 each */
    uint64_t edge_count;
    uint32_t *edge;  /* (from, to), both directions, sorted, distinct */
    uint64_t *start; /* count + 1 */
} web;

static uint64_t point_hash(const double *p)
{
    uint64_t h = 0, bits;
    for (int k = 0; k < 3; k++) {
        double v = p[k] + 0.0; /* -0 and 0 are one place */
        memcpy(&bits, &v, sizeof bits);
        h = (h ^ bits) * 0x9e3779b97f4a7c15u;
        h ^= h >> 31;
    }
    return h;
}

static svo_result find_points(skeli_pool *pool, web *w, svo_error *err)
{
    uint64_t capacity = 64;
    while (capacity < 2 * w->vertices) capacity *= 2;
    uint32_t *slot = skeli_take(pool, capacity, sizeof *slot);
    if (slot == NULL) return skeli_no_memory(err);
    memset(slot, 0xff, capacity * sizeof *slot);
    for (uint64_t v = 0; v < w->vertices; v++) {
        const double *p = w->position + 3 * v;
        uint64_t i = point_hash(p) & (capacity - 1);
        while (slot[i] != SVO_NONE && memcmp(w->position + 3 * (uint64_t)slot[i], p, 3 * sizeof *p) != 0) i = (i + 1) & (capacity - 1);
        if (slot[i] == SVO_NONE) { /* points are numbered in order of first vertices, so they can move down in place */
            slot[i] = w->count;
            memmove(w->position + 3 * (uint64_t)w->count++, p, 3 * sizeof *p);
        }
        w->point_of[v] = slot[i];
    }
    skeli_give(pool, slot);
    return SVO_OK;
}

/* map: of the skeleton; triangles with a corner that was dropped tie nothing together. */
static svo_result make_web(skeli_pool *pool, const svo_mesh *mesh, const uint32_t *map, uint64_t vertices, web *w, svo_error *err)
{
    uint64_t triangles = svo_mesh_count(mesh).placed_triangles, base = 0, n = 0;
    *w = (web){.vertices = vertices};
    w->point_of = skeli_take(pool, vertices, sizeof *w->point_of);
    w->position = skeli_take(pool, 3 * vertices, sizeof *w->position);
    w->edge = skeli_take(pool, 12 * triangles, sizeof *w->edge);
    if (w->point_of == NULL || w->position == NULL || w->edge == NULL) return skeli_no_memory(err);
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
        for (uint32_t k = 0; k < shape->part_count; k++)
            for (uint64_t v = 0; v < shape->parts[k].vertex_count; v++) {
                const double *p = shape->parts[k].positions + 3 * v;
                svo_vec3 q = svo_mat4_point(&mesh->instances[i].transform, svo_v3(p[0], p[1], p[2]));
                const double at[3] = {q.x + 0.0, q.y + 0.0, q.z + 0.0};
                memcpy(w->position + 3 * base++, at, sizeof at);
            }
    }
    SVO_ASSERT(base == vertices);
    SVO_TRY(find_points(pool, w, err));
    base = 0;
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
        for (uint32_t k = 0; k < shape->part_count; k++) {
            const svo_part *part = &shape->parts[k];
            for (uint64_t t = 0; t < part->triangle_count; t++) {
                const uint32_t *corner = part->indices + 3 * t;
                if (map[base + corner[0]] == SVO_NONE || map[base + corner[1]] == SVO_NONE || map[base + corner[2]] == SVO_NONE) continue;
                for (uint32_t c = 0; c < 3; c++) {
                    uint32_t a = w->point_of[base + corner[c]], b = w->point_of[base + corner[(c + 1) % 3]];
                    if (a == b) continue;
                    w->edge[2 * n] = w->edge[2 * n + 3] = a;
                    w->edge[2 * n + 1] = w->edge[2 * n + 2] = b;
                    n += 2;
                }
            }
            base += part->vertex_count;
        }
    }
    uint32_t *scratch = skeli_take(pool, 2 * n, sizeof *scratch), *bucket = skeli_take(pool, (uint64_t)w->count + 1, sizeof *bucket);
    w->start = skeli_take(pool, (uint64_t)w->count + 1, sizeof *w->start);
    if (scratch == NULL || bucket == NULL || w->start == NULL) return skeli_no_memory(err);
    w->edge_count = skeli_sort_unique(w->edge, n, 2, w->count, scratch, bucket);
    memset(w->start, 0, ((uint64_t)w->count + 1) * sizeof *w->start);
    for (uint64_t e = 0; e < w->edge_count; e++) w->start[w->edge[2 * e] + 1]++;
    for (uint32_t p = 0; p < w->count; p++) w->start[p + 1] += w->start[p];
    skeli_give(pool, scratch);
    skeli_give(pool, bucket);
    return SVO_OK;
}

/* --- weights ------------------------------------------------------------------------------------------------------- */

typedef struct weights {
    uint32_t per; /* entries of a point, descending by weight, ties by joint; unused: joint 0, weight 0 */
    uint32_t *joint;
    double *weight;
} weights;

/* Sums by joint for one point at a time. */
typedef struct blend {
    double *sum;       /* of each joint; 0 but for those in `touched` */
    uint32_t *touched; /* joint numbers */
    uint32_t count;
} blend;

static void blend_add(blend *b, uint32_t joint, double weight)
{
    if (!(weight > 0)) return;
    if (b->sum[joint] == 0) b->touched[b->count++] = joint;
    b->sum[joint] += weight;
}

/* The largest sums, made to add up to 1; the blend is empty afterwards. */
static void blend_take(blend *b, const weights *w, uint64_t point)
{
    uint32_t *joint = w->joint + point * w->per, kept = 0;
    double *weight = w->weight + point * w->per, total = 0;
    memset(joint, 0, w->per * sizeof *joint);
    memset(weight, 0, w->per * sizeof *weight);
    for (uint32_t i = 0; i < b->count; i++) {
        uint32_t j = b->touched[i], at = kept;
        double s = b->sum[j];
        b->sum[j] = 0;
        while (at > 0 && (s > weight[at - 1] || (s == weight[at - 1] && j < joint[at - 1]))) at--;
        if (at == w->per) continue;
        if (kept < w->per) kept++;
        for (uint32_t k = kept - 1; k > at; k--) {
            weight[k] = weight[k - 1];
            joint[k] = joint[k - 1];
        }
        weight[at] = s;
        joint[at] = j;
    }
    b->count = 0;
    for (uint32_t k = 0; k < kept; k++) total += weight[k];
    for (uint32_t k = 0; k < kept; k++) weight[k] /= total;
}

/* A point of joint j follows j and the other joint of its nearest bone, by where the foot of its perpendicular lies. */
static void begin_weights(const web *w, const skel_skeleton *s, const uint32_t *start, const uint32_t *other, const uint32_t *joint_of, blend *b, const weights *out)
{
    for (uint32_t p = 0; p < w->count; p++) {
        uint32_t j = joint_of[p], to = j;
        const double *x = w->position + 3 * (uint64_t)p, *a = s->joints[j].position;
        double nearest = INFINITY, foot = 0;
        for (uint32_t k = start[j]; k < start[j + 1]; k++) {
            const double *c = s->joints[other[k]].position;
            double along = 0, length2 = 0, d2 = 0;
            for (int e = 0; e < 3; e++) {
                along += (c[e] - a[e]) * (x[e] - a[e]);
                length2 += (c[e] - a[e]) * (c[e] - a[e]);
            }
            double t = length2 > 0 ? along / length2 : 0;
            t = t < 0 ? 0 : t > 1 ? 1 : t;
            for (int e = 0; e < 3; e++) {
                double d = x[e] - a[e] - t * (c[e] - a[e]);
                d2 += d * d;
            }
            if (d2 < nearest) {
                nearest = d2;
                foot = t;
                to = other[k];
            }
        }
        if (!(foot >= 0 && foot <= 1)) foot = 0; /* where squares overflow */
        blend_add(b, j, 1 - foot);
        blend_add(b, to, foot);
        blend_take(b, out, p);
    }
}

/* One round: half of a point's own weights, half of the mean of its neighbours'. */
static void average(const web *w, const weights *from, blend *b, const weights *to)
{
    for (uint32_t p = 0; p < w->count; p++) {
        uint64_t degree = w->start[p + 1] - w->start[p];
        double own = degree > 0 ? 0.5 : 1, each = degree > 0 ? 0.5 / (double)degree : 0;
        for (uint32_t k = 0; k < from->per; k++) blend_add(b, from->joint[(uint64_t)p * from->per + k], own * from->weight[(uint64_t)p * from->per + k]);
        for (uint64_t e = w->start[p]; e < w->start[p + 1]; e++) {
            uint64_t q = (uint64_t)w->edge[2 * e + 1] * from->per;
            for (uint32_t k = 0; k < from->per; k++) blend_add(b, from->joint[q + k], each * from->weight[q + k]);
        }
        blend_take(b, to, p);
    }
}

static svo_result make(skeli_pool *pool, const svo_mesh *mesh, const skel_skeleton *s, const skel_tree *tree, const skel_skin_options *o, skel_skin *out, svo_error *err)
{
    web w;
    SVO_TRY(make_web(pool, mesh, s->map, s->map_count, &w, err));
    uint64_t n = s->joint_count, entries = (uint64_t)w.count * SKEL_MAX_INFLUENCES;
    uint32_t *start = skeli_take(pool, n + 2, sizeof *start), *other = skeli_take(pool, 2 * (uint64_t)s->bone_count, sizeof *other);
    uint32_t *joint_of = skeli_take(pool, w.count, sizeof *joint_of);
    blend b = {skeli_take(pool, n, sizeof *b.sum), skeli_take(pool, n, sizeof *b.touched), 0};
    /* while averaging, 8 are kept whatever was asked for: what is cut off in the end would else be lost in each round */
    weights now = {SKEL_MAX_INFLUENCES, skeli_take(pool, entries, sizeof *now.joint), skeli_take(pool, entries, sizeof *now.weight)};
    weights next = {SKEL_MAX_INFLUENCES, skeli_take(pool, entries, sizeof *next.joint), skeli_take(pool, entries, sizeof *next.weight)};
    if (start == NULL || other == NULL || joint_of == NULL || b.sum == NULL || b.touched == NULL || now.joint == NULL || now.weight == NULL ||
        next.joint == NULL || next.weight == NULL)
        return skeli_no_memory(err);
    memset(start, 0, (n + 2) * sizeof *start);
    for (uint64_t i = 0; i < s->bone_count; i++) {
        start[s->bones[i].a + 2]++;
        start[s->bones[i].b + 2]++;
    }
    for (uint64_t j = 0; j < n; j++) start[j + 2] += start[j + 1];
    for (uint64_t i = 0; i < s->bone_count; i++) {
        other[start[s->bones[i].a + 1]++] = s->bones[i].b;
        other[start[s->bones[i].b + 1]++] = s->bones[i].a;
    }
    for (uint32_t p = 0; p < w.count; p++) joint_of[p] = tree->order[0]; /* the first root, for what was dropped */
    for (uint64_t v = w.vertices; v-- > 0;)
        if (s->map[v] != SVO_NONE) joint_of[w.point_of[v]] = s->map[v];
    memset(b.sum, 0, n * sizeof *b.sum);
    begin_weights(&w, s, start, other, joint_of, &b, &now);
    for (uint32_t i = 0; i < o->smoothing; i++) {
        average(&w, &now, &b, &next);
        weights swap = now;
        now = next;
        next = swap;
    }
    out->count = w.vertices;
    out->influences = o->influences;
    out->joint = svo_calloc(out->allocator, w.vertices * o->influences, sizeof *out->joint);
    out->weight = svo_calloc(out->allocator, w.vertices * o->influences, sizeof *out->weight);
    if (out->joint == NULL || out->weight == NULL) return skeli_no_memory(err);
    for (uint64_t v = 0; v < w.vertices; v++) {
        const uint32_t *j = now.joint + (uint64_t)w.point_of[v] * now.per;
        const double *x = now.weight + (uint64_t)w.point_of[v] * now.per;
        double total = 0;
        uint32_t used = 0;
        for (uint32_t k = 0; k < o->influences; k++) total += x[k];
        for (uint32_t k = 0; k < o->influences; k++) {
            float f = (float)(x[k] / total);
            out->weight[v * o->influences + k] = f;
            out->joint[v * o->influences + k] = f > 0 ? j[k] : 0;
            used += f > 0;
        }
        if (used > out->most) out->most = used;
    }
    return SVO_OK;
}

svo_result skel_skin_make(const svo_mesh *mesh, const skel_skeleton *s, const skel_tree *tree, const skel_skin_options *o, skel_skin *out, svo_error *err)
{
    if (o->influences < 1 || o->influences > SKEL_MAX_INFLUENCES) return svo_fail(err, SVO_INVALID_ARGUMENT, "a vertex takes 1 to 8 influences, not %u", o->influences);
    uint64_t vertices = 0;
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
        for (uint32_t k = 0; k < shape->part_count; k++) vertices += shape->parts[k].vertex_count;
    }
    if (s->report.source != SKEL_SOURCE_MESH || vertices != s->map_count)
        return svo_fail(err, SVO_INVALID_ARGUMENT, "the skeleton has a map of %llu elements, the mesh %llu vertices: it was not built from this mesh",
                        (unsigned long long)s->map_count, (unsigned long long)vertices);
    skel_skin k = {.allocator = o->allocator};
    skeli_pool pool = {.allocator = o->allocator};
    svo_result r = make(&pool, mesh, s, tree, o, &k, err);
    skeli_pool_free(&pool);
    if (r == SVO_OK) *out = k;
    else skel_skin_free(&k);
    return r;
}

void skel_skin_free(skel_skin *s)
{
    svo_free(s->allocator, s->joint, s->count * s->influences, sizeof *s->joint);
    svo_free(s->allocator, s->weight, s->count * s->influences, sizeof *s->weight);
    memset(s, 0, sizeof *s);
}
