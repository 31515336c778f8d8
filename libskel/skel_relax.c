/* The curve's place in the solid. The contraction says which limbs there are and how they hang together, but where it leaves joints depends on the last bit of
 * its input. So joints move to where the curve is shortest in a space that is expensive near the surface: the sum over bones of length / d^4, d the
 * distance to the surface, has its minimum on ridges of d, and its three-way balance of pulls puts branches in one place whatever they came from. */
#include <math.h>
#include <string.h>

#include "skeli_curve.h"

#define FAR (4.0 * SKEL_LATTICE)
/* Each round turns by the golden angle, whose cosine and sine these are: directions that never repeat find a way along a crease of d, which fixed ones do not. */
#define GOLDEN_COSINE (-0.7373688780783197)
#define GOLDEN_SINE 0.6754902942615238
#define FIRST_STEP 0.25          /* of d */
#define LAST_STEP 0.01
#define LARGEST_STEP 0.5
#define SLACK 1e-9 /* more than rounding makes of a distance */
enum { SEEN = 12 };

/* 1 / d^4. Divisions and roots alone, as in all of this file: sin, pow and the like may differ in their last bits from one C library, or processor, to the next,
 * and joints would with them. */
static double price(double d) { return 1 / (d * d * d * d); }

/* The distance that has a price. */
static double clearance(double f) { return sqrt(sqrt(1 / f)); }

typedef struct relaxing {
    const skeli_surface *surface;
    const skeli_curve *curve;
    skeli_fans fans;
    double *d, *near, *price, *step; /* distance to the surface, its nearest point, price there, step / d */
    double *seen;                    /* of each joint, SEEN points of the surface that were nearest to where it was or might have gone: what one of them refuses needs no search */
    uint8_t *next_seen;              /* that is replaced */
    double cosine, sine; /* of the turn of this round's directions */
} relaxing;

static uint32_t neighbour(const relaxing *r, uint32_t joint, uint32_t k)
{
    const uint32_t *b = r->curve->bone + 2 * (uint64_t)r->fans.bone[k];
    return b[0] == joint ? b[1] : b[0];
}

/* What the bones of a joint at p cost is sum * (price at p) + rest. */
static double pull(const relaxing *r, uint32_t joint, const double *p, double *rest)
{
    double sum = 0;
    *rest = 0;
    for (uint32_t k = r->fans.start[joint]; k < r->fans.start[joint + 1]; k++) {
        uint32_t n = neighbour(r, joint, k);
        double length = skeli_apart(p, r->curve->position + 3 * (uint64_t)n);
        sum += length;
        *rest += length * r->price[n];
    }
    return sum;
}

/* Is one of the points seen from joint j no farther from q than `least`? Else *most is lowered to a little more than the nearest one's distance; a little, so that the search still finds the point that is the nearest. */
static bool refused(const relaxing *r, uint32_t j, const double *q, double least, double *most)
{
    for (uint64_t i = 0; i < SEEN; i++) {
        const double d = skeli_apart(q, r->seen + 3 * (SEEN * (uint64_t)j + i));
        if (d * (1 + SLACK) < least) return true;
        if (d * (1 + SLACK) < *most) *most = d * (1 + SLACK);
    }
    return false;
}

/* Joints of chains move across it, others anywhere. A step is shorter than d, so it cannot leave the solid. */
static bool relax_joint(relaxing *r, uint32_t j)
{
    double *p = r->curve->position + 3 * (uint64_t)j, u[3], v[3], w[3] = {0, 0, 0}, to[3], to_near[3], to_d = 0, rest;
    double now = pull(r, j, p, &rest) * r->price[j], best;
    now += rest;
    best = now;
    uint32_t degree = r->fans.start[j + 1] - r->fans.start[j];
    const double *a = r->curve->position + 3 * (uint64_t)neighbour(r, j, r->fans.start[j]);
    const double *b = r->curve->position + 3 * (uint64_t)neighbour(r, j, r->fans.start[j] + 1);
    double n = skeli_apart(a, b);
    if (!(n > 0)) return false;
    for (int k = 0; k < 3; k++) w[k] = (b[k] - a[k]) / n;
    skeli_across(w, u, v);
    const double to_side[6][3] = {{r->cosine, r->sine, 0}, {-r->sine, r->cosine, 0}, {-r->cosine, -r->sine, 0}, {r->sine, -r->cosine, 0}, {0, 0, 1}, {0, 0, -1}}; /* of u, v, w */
    double step = r->step[j] * r->d[j], *near = r->near + 3 * (uint64_t)j;
    int directions = degree == 2 ? 4 : 6;
    for (int i = 0; i < directions; i++) {
        double q[3];
        for (int k = 0; k < 3; k++) q[k] = p[k] + step * (to_side[i][0] * u[k] + to_side[i][1] * v[k] + to_side[i][2] * w[k]);
        /* how far the surface must be for this to pay, and how far it is at most */
        double sum = pull(r, j, q, &rest), most = skeli_apart(q, near), next[3];
        if (!(best > rest) || !(sum > 0)) continue;
        double least = clearance((best - rest) / sum);
        if (!(most > least)) continue;
        if (refused(r, j, q, least, &most)) continue;
        memcpy(next, near, sizeof next);
        double d = skeli_surface_clearance(r->surface, q, least, most, next);
        if (d < most) {
            memcpy(r->seen + 3 * (SEEN * (uint64_t)j + r->next_seen[j]), next, sizeof next);
            r->next_seen[j] = (uint8_t)((r->next_seen[j] + 1) % SEEN);
        }
        if (!(d > least)) continue;
        best = sum * price(d) + rest;
        to_d = d;
        memcpy(to, q, sizeof to);
        memcpy(to_near, next, sizeof to_near);
    }
    if (!(best < now)) {
        r->step[j] /= 2;
        return false;
    }
    memcpy(p, to, sizeof to);
    memcpy(near, to_near, sizeof to_near);
    r->d[j] = to_d;
    r->price[j] = price(to_d);
    r->step[j] = fmin(LARGEST_STEP, r->step[j] * 1.4);
    return true;
}

svo_result skeli_relax(skeli_pool *pool, const skeli_surface *surface, int rounds, skeli_curve *c, svo_error *err)
{
    relaxing r = {.surface = surface, .curve = c, .cosine = 1, .sine = 0};
    SVO_TRY(skeli_fans_make(pool, c, &r.fans, err));
    r.d = skeli_take(pool, c->joints, sizeof *r.d);
    r.near = skeli_take(pool, 3 * (uint64_t)c->joints, sizeof *r.near);
    r.price = skeli_take(pool, c->joints, sizeof *r.price);
    r.step = skeli_take(pool, c->joints, sizeof *r.step);
    r.seen = skeli_take(pool, 3 * SEEN * (uint64_t)c->joints, sizeof *r.seen);
    r.next_seen = skeli_take(pool, c->joints, sizeof *r.next_seen);
    if (r.d == NULL || r.near == NULL || r.price == NULL || r.step == NULL || r.seen == NULL || r.next_seen == NULL) return skeli_no_memory(err);
    for (uint32_t j = 0; j < c->joints; j++) {
        r.d[j] = fmax(skeli_surface_distance(surface, c->position + 3 * (uint64_t)j, FAR, r.near + 3 * (uint64_t)j), 1);
        if (!skeli_surface_inside(surface, c->position + 3 * (uint64_t)j)) r.d[j] = 1;
        r.price[j] = price(r.d[j]);
        r.step[j] = FIRST_STEP;
        r.next_seen[j] = 0;
        for (uint64_t i = 0; i < SEEN; i++) memcpy(r.seen + 3 * (SEEN * (uint64_t)j + i), r.near + 3 * (uint64_t)j, 3 * sizeof *r.seen);
    }
    for (int round = 0; round < rounds; round++) {
        bool moved = false;
        for (uint32_t j = 0; j < c->joints; j++) {
            if (r.fans.start[j + 1] - r.fans.start[j] < 2 || r.d[j] <= 1) continue;
            if (r.step[j] < LAST_STEP) { /* its neighbours move on */
                if (round % 8 == 0) r.step[j] = 4 * LAST_STEP;
                else continue;
            }
            moved |= relax_joint(&r, j);
        }
        const double turned = r.cosine * GOLDEN_COSINE - r.sine * GOLDEN_SINE;
        r.sine = r.cosine * GOLDEN_SINE + r.sine * GOLDEN_COSINE;
        r.cosine = turned;
        if (!moved && round % 8 == 7) break;
    }
    skeli_give(pool, r.d);
    skeli_give(pool, r.near);
    skeli_give(pool, r.price);
    skeli_give(pool, r.step);
    skeli_give(pool, r.seen);
    skeli_give(pool, r.next_seen);
    skeli_fans_free(pool, &r.fans);
    return SVO_OK;
}

/* --- branches of more than three bones ----------------------------------------------------------------------------- */

/* The two bones of a joint that leave it in the most similar directions, and the mean of those. */
static void closest_pair(const skeli_curve *c, const skeli_fans *fans, uint32_t joint, uint32_t pair[2], double along[3])
{
    const double *p = c->position + 3 * (uint64_t)joint;
    double best = -2;
    for (uint32_t x = fans->start[joint]; x < fans->start[joint + 1]; x++)
        for (uint32_t y = x + 1; y < fans->start[joint + 1]; y++) {
            double d[2][3], cosine = 0;
            for (int e = 0; e < 2; e++) {
                const uint32_t *b = c->bone + 2 * (uint64_t)fans->bone[e == 0 ? x : y];
                const double *q = c->position + 3 * (uint64_t)(b[0] == joint ? b[1] : b[0]);
                double n = skeli_apart(p, q);
                for (int k = 0; k < 3; k++) d[e][k] = n > 0 ? (q[k] - p[k]) / n : 0;
            }
            for (int k = 0; k < 3; k++) cosine += d[0][k] * d[1][k];
            if (!(cosine > best)) continue;
            best = cosine;
            pair[0] = fans->bone[x];
            pair[1] = fans->bone[y];
            for (int k = 0; k < 3; k++) along[k] = (d[0][k] + d[1][k]) / 2;
        }
}

/* One contraction leaves two branches where another leaves one of four bones. So those are taken apart here: the two bones with the most similar directions get a branch of
 * their own, and where relaxing finds that it was one place, they are merged again. */
svo_result skeli_split_branches(skeli_pool *pool, const skeli_surface *surface, skeli_curve *c, svo_error *err)
{
    for (bool found = true; found;) {
        skeli_fans fans;
        SVO_TRY(skeli_fans_make(pool, c, &fans, err));
        uint32_t more = 0, n = c->joints;
        for (uint32_t j = 0; j < n; j++) more += fans.start[j + 1] - fans.start[j] > 3;
        found = more > 0;
        double *position = found ? skeli_take(pool, 3 * ((uint64_t)n + more), sizeof *position) : NULL;
        uint32_t *bone = found ? skeli_take(pool, 2 * (c->bones + more), sizeof *bone) : NULL;
        if (found) {
            if (position == NULL || bone == NULL) return skeli_no_memory(err);
            memcpy(position, c->position, 3 * (uint64_t)n * sizeof *position);
            memcpy(bone, c->bone, 2 * c->bones * sizeof *bone);
            for (uint32_t j = 0; j < n; j++) {
                if (fans.start[j + 1] - fans.start[j] <= 3) continue;
                uint32_t pair[2] = {0, 0};
                double along[3] = {0, 0, 0}, d = skeli_surface_distance(surface, c->position + 3 * (uint64_t)j, FAR, NULL);
                closest_pair(c, &fans, j, pair, along);
                for (uint64_t k = 0; k < 3; k++) position[3 * (uint64_t)c->joints + k] = c->position[3 * (uint64_t)j + k] + 0.1 * d * along[k];
                for (int e = 0; e < 2; e++) {
                    uint32_t *b = bone + 2 * (uint64_t)pair[e];
                    b[b[0] == j ? 0 : 1] = c->joints;
                }
                bone[2 * c->bones] = j;
                bone[2 * c->bones++ + 1] = c->joints++;
            }
            skeli_give(pool, c->position);
            skeli_give(pool, c->bone);
            c->position = position;
            c->bone = bone;
        }
        skeli_fans_free(pool, &fans);
    }
    return SVO_OK;
}

/* Would a loop become one bone that is there twice, or nothing, if p and q (roots of what is merged already) were one? */
static bool closes_loop(const skeli_curve *c, uint32_t *into, uint32_t p, uint32_t q)
{
    uint32_t direct = 0;
    for (uint64_t b = 0; b < c->bones; b++) {
        const uint32_t x = skeli_root(into, c->bone[2 * b]), y = skeli_root(into, c->bone[2 * b + 1]);
        direct += (x == p && y == q) || (x == q && y == p);
        if ((x == p) == (y == p)) continue;
        const uint32_t beside = x == p ? y : x; /* of p: is it beside q too? */
        for (uint64_t e = 0; e < c->bones && beside != q; e++) {
            const uint32_t u = skeli_root(into, c->bone[2 * e]), v = skeli_root(into, c->bone[2 * e + 1]);
            if ((u == beside && v == q) || (u == q && v == beside)) return true;
        }
    }
    return direct > 1;
}

svo_result skeli_merge_branches(skeli_pool *pool, const skeli_soup *mesh, double nearer, skeli_curve *c, svo_error *err)
{
    skeli_fans fans;
    SVO_TRY(skeli_fans_make(pool, c, &fans, err));
    uint32_t *into = skeli_take(pool, c->joints, sizeof *into);
    if (into == NULL) return skeli_no_memory(err);
    for (uint32_t j = 0; j < c->joints; j++) into[j] = j;
    for (uint64_t b = 0; b < c->bones; b++) {
        uint32_t x = c->bone[2 * b], y = c->bone[2 * b + 1];
        bool branches = fans.start[x + 1] - fans.start[x] > 2 && fans.start[y + 1] - fans.start[y] > 2;
        if (!branches || skeli_apart(c->position + 3 * (uint64_t)x, c->position + 3 * (uint64_t)y) >= nearer) continue;
        uint32_t p = skeli_root(into, x), q = skeli_root(into, y);
        if (p != q && !closes_loop(c, into, p, q)) into[p > q ? p : q] = p > q ? q : p;
    }
    svo_result result = skeli_curve_merge(pool, mesh, c, into, err);
    skeli_give(pool, into);
    skeli_fans_free(pool, &fans);
    return result;
}
