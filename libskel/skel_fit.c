/* The curve's balls against the surface. Relaxing (skel_relax.c) puts joints where the surface is far; what a curve is judged by is how far the surface is from the balls around it. The two agree along limbs, but
 * where limbs meet, at their ends and in wide parts a joint may do better a little off the ridge. So in the end joints move wherever that distance, the mean over the surface, falls; a move that takes more of the curve
 * out of the solid, or turns it sharply, is none. */
#include <math.h>
#include <string.h>

#include "skeli_curve.h"
#include "svo_task.h"

#define FAR (4.0 * SKEL_LATTICE)
enum { VERTICES = 3000, MOST_BALLS = 16, ROUNDS = 6, MOST_CELLS = 1 << 21, MOST_DEGREE = 8, SIDES = 6 };
#define SPACING 2.0      /* balls an omega */
#define FIRST_STEP 0.12  /* of the radius */
#define LAST_STEP 0.014
#define REACH 0.12       /* radii that a joint may move */
#define ANCHOR 0.6       /* what it costs to move by a radius, and */
#define LENGTH 0.3       /* what it costs to make the curve as long again, by the mean distance: without them the curve would be another one for every turn of the model */
#define OUTSIDE 20.0     /* what a part of the curve outside of the solid costs, by the mean distance */
#define SHARP 0.5        /* cosine of a turn that is not made sharper */
#define PAYS 1e-4        /* of the mean distance: gains that are less are left */

typedef struct ball { double near[3], radius; float at[3], r; } ball; /* radius: distance of the surface; r: of the ball, 0 outside */
typedef struct bone_balls { uint32_t count, outside; double length; ball ball[MOST_BALLS]; } bone_balls; /* of a bone */

typedef struct fitting {
    const skeli_surface *surface;
    skeli_curve *curve;
    skeli_fans fans;
    double spacing;
    uint64_t vertices;
    float *x, *y, *z; /* of each vertex that is looked at */
    double *weight;   /* sum 1 */
    bone_balls *bone;
    float *gap;   /* bones * vertices: to the balls of one bone */
    float *other; /* vertices: to those of all bones but a joint's */
    float *trial; /* SIDES * vertices */
    uint32_t threads;
    const double *start; /* joints, before they moved */
    double radius;       /* of the ball around the joint that is looked at */
    double outside, length; /* of the curve */
    double scale; /* what the penalty is measured by */
} fitting;

/* Balls along the way from a to b; `from`: those that were there, to begin the searches with, or NULL. */
static void place_balls(const fitting *f, const double *a, const double *b, const bone_balls *from, bone_balls *out)
{
    const double length = skeli_apart(a, b);
    out->length = length;
    out->count = from != NULL ? from->count : (uint32_t)fmin(length / f->spacing, MOST_BALLS - 1) + 1;
    out->outside = 0;
    for (uint32_t i = 0; i < out->count; i++) {
        ball *o = &out->ball[i];
        double p[3], most = FAR;
        for (int k = 0; k < 3; k++) p[k] = a[k] + (b[k] - a[k]) * (i + 0.5) / out->count;
        if (from != NULL) {
            memcpy(o->near, from->ball[i].near, sizeof o->near);
            most = skeli_apart(p, o->near);
        } else if (i > 0) {
            memcpy(o->near, out->ball[i - 1].near, sizeof o->near);
            most = skeli_apart(p, o->near);
        }
        o->radius = skeli_surface_distance(f->surface, p, most, o->near);
        const bool inside = skeli_surface_inside(f->surface, p);
        o->r = inside ? (float)o->radius : 0;
        for (int k = 0; k < 3; k++) o->at[k] = (float)p[k];
        out->outside += !inside;
        if (i > 0) { /* between two balls */
            for (int k = 0; k < 3; k++) p[k] = a[k] + (b[k] - a[k]) * i / out->count;
            out->outside += !skeli_surface_inside(f->surface, p);
        }
    }
}

/* Lower `row` to the gaps of the vertices to these balls. */
static void lower(const fitting *f, const bone_balls *p, float *row)
{
    for (uint32_t i = 0; i < p->count; i++) {
        const float x = p->ball[i].at[0], y = p->ball[i].at[1], z = p->ball[i].at[2], r = p->ball[i].r;
        for (uint64_t v = 0; v < f->vertices; v++) {
            const float dx = f->x[v] - x, dy = f->y[v] - y, dz = f->z[v] - z, d = sqrtf(dx * dx + dy * dy + dz * dz) - r;
            row[v] = d < row[v] ? d : row[v];
        }
    }
}

static double mean(const fitting *f, const float *row)
{
    double sum = 0;
    for (uint64_t v = 0; v < f->vertices; v++) sum += row[v] > 0 ? f->weight[v] * row[v] : 0;
    return sum;
}

static double outside_of(const bone_balls *p) { return p->length * p->outside / (2 * p->count - 1); }

static double turn(const double *a, const double *b, const double *c)
{
    double dot = 0;
    const double l = skeli_apart(a, b) * skeli_apart(b, c);
    for (int k = 0; k < 3; k++) dot += (b[k] - a[k]) * (c[k] - b[k]);
    return l > 0 ? dot / l : -1;
}

/* The sharpest turn of the ways through a joint of two bones and through such neighbours of it. */
static double sharpest(const fitting *f, uint32_t joint, const double *at)
{
    const skeli_curve *c = f->curve;
    const uint32_t *start = f->fans.start, *bone = f->fans.bone;
    double least = 1;
    if (start[joint + 1] - start[joint] == 2)
        least = turn(c->position + 3 * (uint64_t)skeli_other_end(c, bone[start[joint]], joint), at, c->position + 3 * (uint64_t)skeli_other_end(c, bone[start[joint] + 1], joint));
    for (uint32_t k = start[joint]; k < start[joint + 1]; k++) {
        const uint32_t n = skeli_other_end(c, bone[k], joint);
        if (start[n + 1] - start[n] != 2) continue;
        const uint32_t beyond = skeli_other_end(c, bone[start[n]] == bone[k] ? bone[start[n] + 1] : bone[start[n]], n);
        least = fmin(least, turn(at, c->position + 3 * (uint64_t)n, c->position + 3 * (uint64_t)beyond));
    }
    return least;
}

/* What it costs to be away from where the joint was. */
static double anchored(const fitting *f, uint32_t joint, const double *at)
{
    const double d = skeli_apart(at, f->start + 3 * (uint64_t)joint) / f->radius;
    return ANCHOR * f->scale * d * d;
}

/* A joint that may move, and where to. */
typedef struct side { double at[3], cost, outside; bone_balls bone[MOST_DEGREE]; } side; /* cost: INFINITY if it may not be there */
typedef struct moving {
    const fitting *f;
    uint32_t joint, degree;
    const uint32_t *bone;
    double outside, bent;
    side side[SIDES];
} moving;

/* What it would cost to be at each of these places. */
static svo_result cost_sides(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    moving *m = user;
    const fitting *f = m->f;
    const skeli_curve *c = f->curve;
    for (uint64_t s = begin; s < end; s++) {
        side *o = &m->side[s];
        const double *q = o->at;
        float *trial = f->trial + s * f->vertices;
        double more = 0;
        o->cost = INFINITY;
        o->outside = m->outside;
        if (skeli_apart(q, f->start + 3 * (uint64_t)m->joint) > REACH * f->radius || !skeli_surface_inside(f->surface, q)) continue;
        const double bends = sharpest(f, m->joint, q);
        if (bends < SHARP && bends < m->bent) continue;
        memcpy(trial, f->other, f->vertices * sizeof *trial);
        for (uint32_t k = 0; k < m->degree; k++) {
            const uint32_t bone = m->bone[k], *e = c->bone + 2 * (uint64_t)bone;
            place_balls(f, e[0] == m->joint ? q : c->position + 3 * (uint64_t)e[0], e[1] == m->joint ? q : c->position + 3 * (uint64_t)e[1], &f->bone[bone], &o->bone[k]);
            o->outside += outside_of(&o->bone[k]);
            more += o->bone[k].length - f->bone[bone].length;
            lower(f, &o->bone[k], trial);
        }
        o->cost = mean(f, trial) + OUTSIDE * f->scale * (o->outside / f->length) + LENGTH * f->scale * (more / f->length) + anchored(f, m->joint, q);
    }
    return SVO_OK;
}

/* Is anything gained by moving a joint by `step` in one of six directions (four in a chain), `turned` from a round to the next? */
static bool fit_joint(fitting *f, uint32_t joint, double step, const double turned[2])
{
    const skeli_curve *c = f->curve;
    const uint32_t first = f->fans.start[joint], degree = f->fans.start[joint + 1] - first;
    double *p = f->curve->position + 3 * (uint64_t)joint, along[3] = {1, 0, 0}, u[3], v[3];
    const double *a = c->position + 3 * (uint64_t)skeli_other_end(c, f->fans.bone[first], joint);
    const double *b = degree == 2 ? c->position + 3 * (uint64_t)skeli_other_end(c, f->fans.bone[first + 1], joint) : p;
    const double l = skeli_apart(a, b);
    moving m = {.f = f, .joint = joint, .degree = degree, .bone = f->fans.bone + first, .outside = f->outside};
    for (int k = 0; k < 3 && l > 0; k++) along[k] = (b[k] - a[k]) / l;
    skeli_across(along, u, v);
    for (uint64_t i = 0; i < f->vertices; i++) f->other[i] = INFINITY;
    for (uint64_t e = 0; e < c->bones; e++) {
        if (c->bone[2 * e] == joint || c->bone[2 * e + 1] == joint) continue;
        const float *gap = f->gap + e * f->vertices;
        for (uint64_t i = 0; i < f->vertices; i++) f->other[i] = gap[i] < f->other[i] ? gap[i] : f->other[i];
    }
    memcpy(f->trial, f->other, f->vertices * sizeof *f->trial);
    for (uint32_t k = 0; k < degree; k++) {
        const float *gap = f->gap + m.bone[k] * f->vertices;
        for (uint64_t i = 0; i < f->vertices; i++) f->trial[i] = gap[i] < f->trial[i] ? gap[i] : f->trial[i];
        m.outside -= outside_of(&f->bone[m.bone[k]]);
    }
    double best_cost = mean(f, f->trial) + OUTSIDE * f->scale * (f->outside / f->length) + anchored(f, joint, p) - PAYS * f->scale;
    m.bent = sharpest(f, joint, p);
    const double way[SIDES][3] = {{turned[0], turned[1], 0}, {-turned[1], turned[0], 0}, {-turned[0], -turned[1], 0}, {turned[1], -turned[0], 0}, {0, 0, 1}, {0, 0, -1}};
    const uint32_t sides = degree == 2 ? 4 : SIDES;
    for (uint32_t s = 0; s < sides; s++)
        for (int k = 0; k < 3; k++) m.side[s].at[k] = p[k] + step * (way[s][0] * u[k] + way[s][1] * v[k] + way[s][2] * along[k]);
    svo_parallel_for(f->threads, sides, 1, cost_sides, &m, NULL); /* it cannot fail: the costs do not */
    const side *best = NULL;
    for (uint32_t s = 0; s < sides; s++) {
        if (!(m.side[s].cost < best_cost)) continue;
        best_cost = m.side[s].cost;
        best = &m.side[s];
    }
    if (best == NULL) return false;
    memcpy(p, best->at, sizeof best->at);
    f->outside = best->outside;
    for (uint32_t k = 0; k < degree; k++) {
        float *gap = f->gap + m.bone[k] * f->vertices;
        f->bone[m.bone[k]] = best->bone[k];
        for (uint64_t i = 0; i < f->vertices; i++) gap[i] = INFINITY;
        lower(f, &best->bone[k], gap);
    }
    return true;
}

static svo_result begin(skeli_pool *pool, const skeli_soup *mesh, fitting *f, svo_error *err)
{
    const skeli_curve *c = f->curve;
    const uint64_t n = mesh->vertex_count, step = n / VERTICES + 1;
    double *position = skeli_take(pool, 3 * n, sizeof *position), *ring = skeli_take(pool, n, sizeof *ring), total = 0;
    f->vertices = (n + step - 1) / step;
    f->x = skeli_take(pool, f->vertices, sizeof *f->x);
    f->y = skeli_take(pool, f->vertices, sizeof *f->y);
    f->z = skeli_take(pool, f->vertices, sizeof *f->z);
    f->weight = skeli_take(pool, f->vertices, sizeof *f->weight);
    f->bone = skeli_take(pool, c->bones, sizeof *f->bone);
    f->gap = skeli_take(pool, c->bones * f->vertices, sizeof *f->gap);
    f->other = skeli_take(pool, f->vertices, sizeof *f->other);
    f->trial = skeli_take(pool, SIDES * f->vertices, sizeof *f->trial);
    if (position == NULL || ring == NULL || f->x == NULL || f->y == NULL || f->z == NULL || f->weight == NULL || f->bone == NULL || f->gap == NULL || f->other == NULL || f->trial == NULL)
        return skeli_no_memory(err);
    for (uint64_t i = 0; i < 3 * n; i++) position[i] = mesh->position[i];
    skeli_rings(mesh, position, ring);
    for (uint64_t v = 0; v < f->vertices; v++) {
        const int32_t *q = mesh->position + 3 * v * step;
        f->x[v] = (float)q[0];
        f->y[v] = (float)q[1];
        f->z[v] = (float)q[2];
        f->weight[v] = 0;
        for (uint64_t i = v * step; i < n && i < (v + 1) * step; i++) f->weight[v] += ring[i]; /* of those beside it too: they lie together */
        total += f->weight[v];
    }
    for (uint64_t v = 0; v < f->vertices; v++) f->weight[v] = total > 0 ? f->weight[v] / total : 1.0 / (double)f->vertices;
    for (uint64_t i = 0; i < c->bones * f->vertices; i++) f->gap[i] = INFINITY;
    for (uint64_t b = 0; b < c->bones; b++) {
        place_balls(f, c->position + 3 * (uint64_t)c->bone[2 * b], c->position + 3 * (uint64_t)c->bone[2 * b + 1], NULL, &f->bone[b]);
        lower(f, &f->bone[b], f->gap + b * f->vertices);
        f->length += f->bone[b].length;
        f->outside += outside_of(&f->bone[b]);
    }
    for (uint64_t i = 0; i < f->vertices; i++) f->other[i] = INFINITY;
    for (uint64_t b = 0; b < c->bones; b++)
        for (uint64_t i = 0; i < f->vertices; i++) f->other[i] = fminf(f->other[i], f->gap[b * f->vertices + i]);
    f->scale = mean(f, f->other);
    skeli_give(pool, position);
    skeli_give(pool, ring);
    return SVO_OK;
}

svo_result skeli_fit(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, uint32_t threads, skeli_curve *c, svo_error *err)
{
    fitting f = {.surface = surface, .curve = c, .spacing = omega / SPACING, .threads = threads};
    if (c->bones == 0 || mesh->vertex_count == 0 || c->bones * VERTICES > MOST_CELLS) return SVO_OK;
    SVO_TRY(skeli_fans_make(pool, c, &f.fans, err));
    SVO_TRY(begin(pool, mesh, &f, err));
    double *step = skeli_take(pool, c->joints, sizeof *step), turned[2] = {1, 0};
    double *start = skeli_take(pool, 3 * (uint64_t)c->joints, sizeof *start), *radius = skeli_take(pool, c->joints, sizeof *radius);
    if (step == NULL || start == NULL || radius == NULL) return skeli_no_memory(err);
    memcpy(start, c->position, 3 * (uint64_t)c->joints * sizeof *start);
    f.start = start;
    for (uint32_t j = 0; j < c->joints; j++) {
        step[j] = FIRST_STEP;
        radius[j] = skeli_surface_distance(surface, c->position + 3 * (uint64_t)j, FAR, NULL);
    }
    bool moved = f.length > 0 && f.scale > 0;
    for (int round = 0; round < ROUNDS && moved; round++) {
        moved = false;
        for (uint32_t j = 0; j < c->joints; j++) {
            const uint32_t degree = f.fans.start[j + 1] - f.fans.start[j];
            if (degree == 0 || degree > MOST_DEGREE || step[j] < LAST_STEP) continue;
            f.radius = radius[j];
            const bool better = fit_joint(&f, j, step[j] * radius[j], turned);
            if (!better) step[j] /= 2;
            moved = moved || better || step[j] >= LAST_STEP;
        }
        const double x = turned[0] * -0.7373688780783197 - turned[1] * 0.6754902942615238; /* by the golden angle, as in relaxing */
        turned[1] = turned[0] * 0.6754902942615238 + turned[1] * -0.7373688780783197;
        turned[0] = x;
    }
    void *const all[] = {f.x, f.y, f.z, f.weight, f.bone, f.gap, f.other, f.trial, step, start, radius};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) skeli_give(pool, all[i]);
    skeli_fans_free(pool, &f.fans);
    return SVO_OK;
}
