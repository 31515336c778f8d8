/* Joints into the middle of the solid: where they are outside, where they are off the middle of their section, where an end stops short of its
 * tip, where a bone leaves the solid between its joints; and branches that do not stick out of the ball around their root are dropped. */
#include <math.h>
#include <string.h>

#include "skeli_curve.h"

enum { RAYS = SKELI_CIRCLE, CENTRE_STEPS = 4, END_STEPS = 6, BONE_ROUNDS = 4, MOST_PIECES = 32, BRANCH_STEPS = 40, RELAX_FIRST = 60, RELAX_GROWN = 24, RELAX_LAST = 100, RELAX_PULLED = 24 };
#define FAR (4.0 * SKEL_LATTICE)
#define FLAT_RAYS 2.0   /* a ray counts up to so many medians: one that runs along another limb says nothing about this one */
#define SHARP 0.5       /* cosine of the turn that centring does not make sharper */
#define TURNS_BACK (-0.3) /* cosine of the turn of a bone that is pulled inside */
#define SPACE 0.5       /* of the radius: joints of a chain are at least that far apart */
#define LONG_BONE 5.0   /* omega: straight limbs keep a joint now and then, for what is done with the bones afterwards */

static double length3(const double *d) { return sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]); }

static bool unit(double *d)
{
    double n = length3(d);
    for (int k = 0; k < 3; k++) d[k] = n > 0 ? d[k] / n : 0;
    return n > 0;
}

/* From a point outside through the nearest point of the surface into the solid: to the middle of what is found there. False when nothing is. */
static bool push_inside(const skeli_surface *s, double *p)
{
    double near[3], d[3], q[3];
    if (!(skeli_surface_distance(s, p, FAR, near) < FAR)) return false;
    for (int k = 0; k < 3; k++) d[k] = near[k] - p[k];
    if (!unit(d)) return false;
    for (int k = 0; k < 3; k++) q[k] = near[k] + 16 * d[k]; /* 2^-20 unit past the surface, which is finer than what inside can tell from outside */
    double depth = skeli_surface_ray(s, q, d, FAR);
    if (!(depth < FAR)) return false;
    for (int k = 0; k < 3; k++) q[k] += d[k] * depth / 2;
    if (!skeli_surface_inside(s, q)) return false;
    memcpy(p, q, sizeof q);
    return true;
}

static void push_joints_inside(const skeli_surface *s, skeli_curve *c)
{
    for (uint32_t j = 0; j < c->joints; j++)
        if (!skeli_surface_inside(s, c->position + 3 * (uint64_t)j)) push_inside(s, c->position + 3 * (uint64_t)j);
}

/* One step towards the middle of the section across d: on a circle, 2/n sum r d is exactly the way there. */
static bool centre_step(const skeli_surface *s, const double *d, double *p)
{
    double u[3], v[3], r[RAYS], sorted[RAYS], q[3];
    skeli_across(d, u, v);
    for (int i = 0; i < RAYS; i++) {
        double c = skeli_circle[i][0], e = skeli_circle[i][1];
        const double ray[3] = {c * u[0] + e * v[0], c * u[1] + e * v[1], c * u[2] + e * v[2]};
        r[i] = skeli_surface_ray(s, p, ray, FAR);
        int k = i;
        while (k > 0 && sorted[k - 1] > r[i]) {
            sorted[k] = sorted[k - 1];
            k--;
        }
        sorted[k] = r[i];
    }
    double most = FLAT_RAYS * sorted[RAYS / 2];
    memcpy(q, p, sizeof q);
    for (int i = 0; i < RAYS; i++) {
        double c = skeli_circle[i][0], e = skeli_circle[i][1], x = r[i] < most ? r[i] : most;
        for (int k = 0; k < 3; k++) q[k] += 2.0 / RAYS * x * (c * u[k] + e * v[k]);
    }
    double way = 0;
    for (int k = 0; k < 3; k++) way += (q[k] - p[k]) * (q[k] - p[k]);
    double limit = sorted[RAYS / 2] / 2, f = way > limit * limit ? limit / sqrt(way) : 1;
    for (int k = 0; k < 3; k++) q[k] = p[k] + f * (q[k] - p[k]);
    if (!skeli_surface_inside(s, q)) return false;
    memcpy(p, q, sizeof q);
    return true;
}

/* Cosine of the turn at b on the way from a to c. */
static double turn(const double *a, const double *b, const double *c)
{
    double u[3], v[3];
    for (int k = 0; k < 3; k++) {
        u[k] = b[k] - a[k];
        v[k] = c[k] - b[k];
    }
    return unit(u) && unit(v) ? u[0] * v[0] + u[1] * v[1] + u[2] * v[2] : -1;
}

/* Put joint i of a chain into the middle of its section, across the direction that the chain has over about its own width: over less, the direction of a
 * wide part's short bones would be noise. It is not moved where that makes the curve turn sharply. */
static void centre_joint(const skeli_surface *s, const skeli_curve *c, const uint32_t *chain, uint32_t n, uint32_t i)
{
    double *p = c->position + 3 * (uint64_t)chain[i], before[3], d[3];
    double radius = skeli_surface_distance(s, p, FAR, NULL);
    uint32_t low = i - 1, high = i + 1;
    while (low > 0 && skeli_apart(c->position + 3 * (uint64_t)chain[low], p) < 1.5 * radius) low--;
    while (high + 1 < n && skeli_apart(c->position + 3 * (uint64_t)chain[high], p) < 1.5 * radius) high++;
    const double *a = c->position + 3 * (uint64_t)chain[low], *b = c->position + 3 * (uint64_t)chain[high];
    for (int k = 0; k < 3; k++) d[k] = b[k] - a[k];
    if (!unit(d)) return;
    memcpy(before, p, sizeof before);
    if (!centre_step(s, d, p)) return;
    const double *x = c->position + 3 * (uint64_t)chain[i - 1], *y = c->position + 3 * (uint64_t)chain[i + 1];
    double from = 0, to = 0; /* it stays between its neighbours */
    for (int k = 0; k < 3; k++) {
        from += d[k] * (p[k] - x[k]);
        to += d[k] * (y[k] - p[k]);
    }
    bool sharp = from <= 0 || to <= 0 || (turn(x, p, y) < SHARP && turn(x, p, y) < turn(x, before, y));
    if (i > 1) {
        const double *w = c->position + 3 * (uint64_t)chain[i - 2];
        sharp |= turn(w, x, p) < SHARP && turn(w, x, p) < turn(w, x, before);
    }
    if (i + 2 < n) {
        const double *w = c->position + 3 * (uint64_t)chain[i + 2];
        sharp |= turn(p, y, w) < SHARP && turn(p, y, w) < turn(before, y, w);
    }
    if (sharp) memcpy(p, before, sizeof before);
}

/* Where limbs meet there is no section: a branch goes up the distance to the surface, but not out of the ball that it had. */
static void centre_branch(const skeli_surface *s, double *p)
{
    const double from[3] = {p[0], p[1], p[2]};
    double near[3], radius = skeli_surface_distance(s, p, FAR, near), start = radius, stride = radius / 4;
    if (!(radius < FAR) || !(radius > 0)) return;
    for (int step = 0; step < BRANCH_STEPS && stride > 0.02 * start; step++) {
        double q[3], next[3], d[3];
        for (int k = 0; k < 3; k++) d[k] = p[k] - near[k];
        if (!unit(d)) return;
        for (int k = 0; k < 3; k++) q[k] = p[k] + stride * d[k];
        double r = skeli_surface_distance(s, q, FAR, next);
        if (r > radius && skeli_apart(q, from) <= start && skeli_surface_inside(s, q)) {
            radius = r;
            memcpy(p, q, sizeof q);
            memcpy(near, next, sizeof next);
        } else {
            stride /= 2;
        }
    }
}

static svo_result centre_branches(skeli_pool *pool, const skeli_surface *s, skeli_curve *c, svo_error *err)
{
    skeli_fans fans;
    SVO_TRY(skeli_fans_make(pool, c, &fans, err));
    for (uint32_t j = 0; j < c->joints; j++) {
        uint32_t bones = fans.start[j + 1] - fans.start[j];
        double *p = c->position + 3 * (uint64_t)j;
        if (!skeli_surface_inside(s, p) && !push_inside(s, p)) continue;
        if (bones == 0 || bones > 2) centre_branch(s, p);
    }
    skeli_fans_free(pool, &fans);
    return SVO_OK;
}

static svo_result centre_chains(skeli_pool *pool, const skeli_surface *s, skeli_curve *c, svo_error *err)
{
    skeli_chains chains;
    push_joints_inside(s, c);
    SVO_TRY(skeli_chains_make(pool, c, &chains, err));
    for (int step = 0; step < CENTRE_STEPS; step++)
        for (uint32_t k = 0; k < chains.count; k++) {
            const uint32_t *chain = chains.joint + chains.start[k], n = chains.start[k + 1] - chains.start[k];
            for (uint32_t i = 1; i + 1 < n; i++) centre_joint(s, c, chain, n, i);
        }
    skeli_chains_free(pool, &chains);
    return SVO_OK;
}

/* Length of the straight way from a to b that is outside. */
static double way_outside(const skeli_surface *s, const double *a, const double *b, double omega)
{
    double length = skeli_apart(a, b);
    uint32_t pieces = (uint32_t)fmin(256, 4 * length / omega) + 2, outside = 0;
    for (uint32_t i = 0; i < pieces; i++) {
        double p[3];
        for (int k = 0; k < 3; k++) p[k] = a[k] + (b[k] - a[k]) * (i + 0.5) / pieces;
        outside += !skeli_surface_inside(s, p);
    }
    return length * outside / pieces;
}

/* Does another chain have the same two ends? */
static bool twin(const skeli_chains *chains, uint32_t chain)
{
    const uint32_t a = chains->joint[chains->start[chain]], b = chains->joint[chains->start[chain + 1] - 1];
    for (uint32_t k = 0; k < chains->count; k++) {
        const uint32_t c = chains->joint[chains->start[k]], d = chains->joint[chains->start[k + 1] - 1];
        if (k != chain && ((a == c && b == d) || (a == d && b == c))) return true;
    }
    return false;
}

/* Drop joints of chains that the curve does not need: those nearer to the last one that stays than half the width there (close: true), or those
 * within a tolerance of the straight way between others, or turn back. */
static svo_result thin_chains(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *s, double omega, bool close, skeli_curve *c, svo_error *err)
{
    skeli_chains chains;
    SVO_TRY(skeli_chains_make(pool, c, &chains, err));
    uint32_t *into = skeli_take(pool, c->joints, sizeof *into);
    if (into == NULL) return skeli_no_memory(err);
    for (uint32_t j = 0; j < c->joints; j++) into[j] = j;
    for (uint32_t k = 0; k < chains.count; k++) {
        const uint32_t *chain = chains.joint + chains.start[k], n = chains.start[k + 1] - chains.start[k];
        uint32_t least = chain[0] == chain[n - 1] ? 3 : twin(&chains, k) ? 2 : 1, kept = n - 1; /* bones that must stay: a loop needs three */
        for (uint32_t last = 0, i = 1; i + 1 < n; i++) {
            const double *a = c->position + 3 * (uint64_t)chain[last], *p = c->position + 3 * (uint64_t)chain[i];
            double radius = skeli_surface_distance(s, p, FAR, NULL);
            bool drop;
            if (close) {
                double space = fmax(omega, SPACE * radius);
                drop = skeli_apart(a, p) < space || (skeli_apart(p, c->position + 3 * (uint64_t)chain[n - 1]) < space);
            } else {
                double tolerance = fmin(fmax(omega / 8, radius / 60), omega / 4), foot;
                const double *b = c->position + 3 * (uint64_t)chain[i + 1];
                drop = way_outside(s, a, b, omega) <= way_outside(s, a, p, omega) + way_outside(s, p, b, omega);
                drop = drop && skeli_apart(a, b) <= fmax(LONG_BONE * omega, 3 * radius);
                bool spike = turn(a, p, b) < 0;
                for (uint32_t m = last + 1; m <= i && drop && !spike; m++)
                    drop = skeli_segment_distance(c->position + 3 * (uint64_t)chain[m], a, b, &foot) <= tolerance;
            }
            if (drop && kept > least) {
                into[chain[i]] = chain[last]; /* the nearer of the two that stay would do too; vertices are given out again below */
                kept--;
            } else {
                last = i;
            }
        }
        for (uint32_t i = 1; i + 1 < n; i++) { /* to the nearer one that stays */
            if (into[chain[i]] == chain[i]) continue;
            uint32_t low = i, high = i;
            while (low > 0 && into[chain[low]] != chain[low]) low--;
            while (high + 1 < n && into[chain[high]] != chain[high]) high++;
            const double *p = c->position + 3 * (uint64_t)chain[i];
            into[chain[i]] = skeli_apart(p, c->position + 3 * (uint64_t)chain[low]) <= skeli_apart(p, c->position + 3 * (uint64_t)chain[high]) ? chain[low] : chain[high];
        }
    }
    svo_result result = skeli_curve_merge(pool, mesh, c, into, err);
    skeli_give(pool, into);
    skeli_chains_free(pool, &chains);
    return result;
}

/* Direction of the curve at an end, over about the width there it has. False where the curve is too short to tell. */
static bool end_direction(const skeli_surface *s, const skeli_curve *c, const skeli_fans *fans, uint32_t end, double d[3])
{
    if (fans->start[end + 1] - fans->start[end] != 1) return false;
    const double *p = c->position + 3 * (uint64_t)end;
    double radius = skeli_surface_distance(s, p, FAR, NULL);
    uint32_t bone = fans->bone[fans->start[end]], at = skeli_other_end(c, bone, end);
    while (skeli_apart(c->position + 3 * (uint64_t)at, p) < radius && fans->start[at + 1] - fans->start[at] == 2) {
        bone = fans->bone[fans->start[at]] == bone ? fans->bone[fans->start[at] + 1] : fans->bone[fans->start[at]];
        at = skeli_other_end(c, bone, at);
    }
    for (int k = 0; k < 3; k++) d[k] = p[k] - c->position[3 * (uint64_t)at + (uint64_t)k];
    return length3(d) >= radius / 2 && unit(d);
}

/* Move ends on along their limb until the largest ball around them touches its tip; they are kept in the middle and do not turn back. */
static void reach_tips(const skeli_surface *s, const skeli_fans *fans, skeli_curve *c)
{
    for (uint32_t j = 0; j < c->joints; j++) {
        double d[3], *p = c->position + 3 * (uint64_t)j;
        if (!skeli_surface_inside(s, p) || !end_direction(s, c, fans, j, d)) continue;
        const double *last = c->position + 3 * (uint64_t)skeli_other_end(c, fans->bone[fans->start[j]], j);
        double first = skeli_surface_distance(s, p, FAR, NULL);
        for (int step = 0; step < END_STEPS; step++) {
            double radius = skeli_surface_distance(s, p, FAR, NULL), ahead = skeli_surface_ray(s, p, d, FAR), q[3];
            if (!(ahead < FAR) || ahead - radius < 0.1 * radius || radius > 1.2 * first) break; /* a tip does not widen */
            double stride = ahead - radius < radius ? (ahead - radius) / 2 : radius / 2;
            for (int k = 0; k < 3; k++) q[k] = p[k] + stride * d[k];
            if (!skeli_surface_inside(s, q)) break;
            centre_step(s, d, q);
            if (turn(last, p, q) < SHARP) break;
            memcpy(p, q, sizeof q);
        }
    }
}

/* Divide bones evenly, so that centring can bend them: no shorter than omega nor half the width they are in. */
static svo_result divide(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *s, double omega, skeli_curve *c, svo_error *err)
{
    uint32_t *count = skeli_take(pool, c->bones, sizeof *count);
    uint64_t *first = skeli_take(pool, c->bones, sizeof *first), n = 0;
    double *point = skeli_take(pool, 3 * c->bones * (MOST_PIECES - 1), sizeof *point);
    if (count == NULL || first == NULL || point == NULL) return skeli_no_memory(err);
    for (uint64_t b = 0; b < c->bones; b++) {
        const double *x = c->position + 3 * (uint64_t)c->bone[2 * b], *y = c->position + 3 * (uint64_t)c->bone[2 * b + 1];
        double middle[3], length = skeli_apart(x, y);
        for (int k = 0; k < 3; k++) middle[k] = (x[k] + y[k]) / 2;
        double space = fmax(omega, SPACE * skeli_surface_distance(s, middle, FAR, NULL)), pieces = floor(length / space);
        first[b] = n;
        count[b] = pieces < 2 ? 0 : pieces < MOST_PIECES ? (uint32_t)pieces - 1 : MOST_PIECES - 1;
        for (uint32_t i = 0; i < count[b]; i++, n++)
            for (uint64_t k = 0; k < 3; k++) point[3 * n + k] = x[k] + (y[k] - x[k]) * (i + 1) / (count[b] + 1);
    }
    svo_result result = skeli_curve_insert(pool, mesh, c, count, first, point, err);
    skeli_give(pool, count);
    skeli_give(pool, first);
    skeli_give(pool, point);
    return result;
}

/* Divide bones that leave the solid where they are farthest outside, and put that point inside. */
static svo_result pull_bones_in(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *s, double omega, skeli_curve *c, svo_error *err)
{
    for (int round = 0; round < BONE_ROUNDS; round++) {
        uint32_t *count = skeli_take(pool, c->bones, sizeof *count);
        uint64_t *first = skeli_take(pool, c->bones, sizeof *first), n = 0;
        double *point = skeli_take(pool, 3 * c->bones, sizeof *point);
        if (count == NULL || first == NULL || point == NULL) return skeli_no_memory(err);
        for (uint64_t b = 0; b < c->bones; b++) {
            const double *x = c->position + 3 * (uint64_t)c->bone[2 * b], *y = c->position + 3 * (uint64_t)c->bone[2 * b + 1];
            double foot, length = skeli_segment_distance(x, y, y, &foot), worst = 0, at[3] = {0, 0, 0};
            uint32_t pieces = length / omega < 32 ? (uint32_t)(8 * length / omega) + 2 : 256;
            first[b] = n;
            count[b] = 0;
            if (length < omega / 4) continue;
            for (uint32_t i = 0; i < pieces; i++) {
                double p[3];
                for (int k = 0; k < 3; k++) p[k] = x[k] + (y[k] - x[k]) * (i + 0.5) / pieces;
                if (skeli_surface_inside(s, p)) continue;
                double d = skeli_surface_distance(s, p, FAR, NULL);
                if (d <= worst) continue;
                worst = d;
                memcpy(at, p, sizeof at);
            }
            if (!(worst > 0) || !push_inside(s, at)) continue;
            /* not where the way would turn back: then the bone bridges a gap, and no point in between helps */
            if (turn(x, at, y) < TURNS_BACK) continue;
            memcpy(point + 3 * n++, at, sizeof at);
            count[b] = 1;
        }
        svo_result result = n > 0 ? skeli_curve_insert(pool, mesh, c, count, first, point, err) : SVO_OK;
        skeli_give(pool, count);
        skeli_give(pool, first);
        skeli_give(pool, point);
        if (n == 0 || result != SVO_OK) return result;
    }
    return SVO_OK;
}

/* An end that lies back on the way to its neighbour is no end: the neighbour is. */
static svo_result fold_back(skeli_pool *pool, const skeli_soup *mesh, skeli_curve *c, svo_error *err)
{
    for (bool found = true; found;) {
        skeli_fans fans;
        found = false;
        SVO_TRY(skeli_fans_make(pool, c, &fans, err));
        uint32_t *into = skeli_take(pool, c->joints, sizeof *into);
        if (into == NULL) return skeli_no_memory(err);
        for (uint32_t j = 0; j < c->joints; j++) into[j] = j;
        for (uint32_t end = 0; end < c->joints; end++) {
            if (fans.start[end + 1] - fans.start[end] != 1) continue;
            uint32_t bone = fans.bone[fans.start[end]], at = skeli_other_end(c, bone, end);
            if (fans.start[at + 1] - fans.start[at] != 2 || into[at] != at) continue;
            uint32_t before = skeli_other_end(c, fans.bone[fans.start[at]] == bone ? fans.bone[fans.start[at] + 1] : fans.bone[fans.start[at]], at);
            if (into[before] != before || turn(c->position + 3 * (uint64_t)before, c->position + 3 * (uint64_t)at, c->position + 3 * (uint64_t)end) >= 0) continue;
            into[end] = at;
            found = true;
        }
        svo_result result = found ? skeli_curve_merge(pool, mesh, c, into, err) : SVO_OK;
        skeli_give(pool, into);
        skeli_fans_free(pool, &fans);
        SVO_TRY(result);
    }
    return SVO_OK;
}

/* Joints into the middle, at most `rounds` of relaxing; ends to the tips; then branches that are no limbs go. */
static svo_result settle(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, int rounds, skeli_limb limbs, skeli_curve *c, svo_error *err)
{
    skeli_fans fans;
    SVO_TRY(centre_chains(pool, surface, c, err));
    SVO_TRY(skeli_split_branches(pool, surface, c, err));
    SVO_TRY(skeli_relax(pool, surface, rounds, c, err));
    SVO_TRY(skeli_fans_make(pool, c, &fans, err));
    reach_tips(surface, &fans, c);
    skeli_fans_free(pool, &fans);
    return skeli_drop_stubs(pool, mesh, surface, omega, limbs, c, err);
}

svo_result skeli_centre(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, skeli_curve *c, svo_error *err)
{
    SVO_TRY(fold_back(pool, mesh, c, err));
    SVO_TRY(centre_branches(pool, surface, c, err));
    SVO_TRY(divide(pool, mesh, surface, omega, c, err));
    SVO_TRY(thin_chains(pool, mesh, surface, omega, true, c, err));
    return settle(pool, mesh, surface, omega, RELAX_FIRST, SKELI_LIMB_FOUND, c, err);
}

svo_result skeli_finish(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, uint32_t threads, skeli_curve *c, svo_error *err)
{
    bool grown;
    SVO_TRY(skeli_grow(pool, mesh, surface, omega, threads, c, &grown, err));
    if (grown) SVO_TRY(settle(pool, mesh, surface, omega, RELAX_GROWN, SKELI_LIMB_ANY, c, err));
    SVO_TRY(divide(pool, mesh, surface, omega, c, err)); /* the ends are farther out now, and chains may have grown together */
    SVO_TRY(pull_bones_in(pool, mesh, surface, omega, c, err));
    push_joints_inside(surface, c);
    SVO_TRY(skeli_relax(pool, surface, RELAX_LAST, c, err));
    SVO_TRY(skeli_merge_branches(pool, mesh, omega, c, err));
    SVO_TRY(pull_bones_in(pool, mesh, surface, omega, c, err));
    SVO_TRY(skeli_relax(pool, surface, RELAX_PULLED, c, err)); /* points that were put inside lie near the surface */
    SVO_TRY(pull_bones_in(pool, mesh, surface, omega, c, err));
    SVO_TRY(thin_chains(pool, mesh, surface, omega, false, c, err));
    SVO_TRY(pull_bones_in(pool, mesh, surface, omega, c, err));
    return skeli_fit(pool, mesh, surface, omega, threads, c, err);
}
