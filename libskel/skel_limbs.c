/* Which branches of the curve are limbs. */
#include <math.h>
#include <string.h>

#include "skeli_curve.h"

enum { RAYS = SKELI_CIRCLE, WIDTHS = 5 };
#define FAR (4.0 * SKEL_LATTICE)
#define STICKS_OUT 1.6 /* way to the tip by the radius at the root of a branch; more is a limb */
/* What sticks out less of the ball at its root is one too where that is so many times its half width long and so many omega. Whether the contraction finds such limbs is chance, so those it has found
 * go, and those are made that keep clear of the threshold: what is short must be the more slender. */
#define CLEARLY_SLENDER 2.5
#define SHORT_SLENDER 4.0
#define SHORT 5.0 /* omega */
#define CLEARLY_OUT 1.75
#define SLENDER 1.0 /* once they are in the middle */
#define OUT 0.75

double skeli_half_width(const skeli_surface *s, const double p[3], const double along[3])
{
    double u[3], v[3], r[RAYS], widest = 0;
    skeli_across(along, u, v);
    for (int i = 0; i < RAYS; i++) {
        const double c = skeli_circle[i][0], e = skeli_circle[i][1], ray[3] = {c * u[0] + e * v[0], c * u[1] + e * v[1], c * u[2] + e * v[2]};
        r[i] = skeli_surface_ray(s, p, ray, FAR);
    }
    for (int i = 0; i < RAYS / 2; i++) widest = fmax(widest, (r[i] + r[i + RAYS / 2]) / 2);
    return widest;
}

bool skeli_is_limb(const skeli_surface *s, double omega, skeli_limb which, double most, const double *point, uint32_t count, double *ratio)
{
    double way = 0;
    for (uint32_t i = 1; i < count; i++) way += skeli_apart(point + 3 * ((uint64_t)i - 1), point + 3 * (uint64_t)i);
    const double tip = skeli_surface_distance(s, point, FAR, NULL), root = skeli_surface_distance(s, point + 3 * ((uint64_t)count - 1), FAR, NULL), out = fmin(way + tip - root, most);
    *ratio = (way + tip) / root;
    if (which == SKELI_LIMB_FOUND || !(out > 0)) return *ratio >= STICKS_OUT;
    double along[3] = {0, 0, 0}, at[3 * WIDTHS], length = 0, hw = 0;
    for (int w = 0; w < WIDTHS; w++) { /* points of what is outside of the ball */
        double left = fmin(fmax(out * (w + 0.5) / WIDTHS - tip, 0), way);
        for (uint32_t i = 1; i < count; i++) {
            const double *a = point + 3 * ((uint64_t)i - 1), *b = point + 3 * (uint64_t)i, piece = skeli_apart(a, b);
            const double f = piece > 0 ? fmin(left / piece, 1) : 0;
            for (int k = 0; k < 3; k++) at[3 * w + k] = a[k] + f * (b[k] - a[k]);
            if (left <= piece) break;
            left -= piece;
        }
    }
    for (int k = 0; k < 3; k++) {
        along[k] = at[3 * (WIDTHS - 1) + k] - at[k];
        length += along[k] * along[k];
    }
    if (!(length > 0)) return which == SKELI_LIMB_ANY && *ratio >= STICKS_OUT;
    for (int k = 0; k < 3; k++) along[k] /= sqrt(length);
    for (int w = 0; w < WIDTHS; w++) hw += skeli_half_width(s, at + 3 * (ptrdiff_t)w, along) / WIDTHS;
    const bool sticks_out = *ratio >= STICKS_OUT;
    return which == SKELI_LIMB_NEW ? out >= CLEARLY_OUT * omega && out >= (out < SHORT * omega ? SHORT_SLENDER : CLEARLY_SLENDER) * hw : sticks_out || (out >= OUT * omega && out >= SLENDER * hw);
}

/* Joints from an end up to and with the next one that has not two bones. */
static uint32_t walk(const skeli_curve *c, const skeli_fans *fans, uint32_t end, uint32_t *joint, double *point)
{
    uint32_t n = 0, bone = fans->bone[fans->start[end]], at = end;
    for (;;) {
        memcpy(point + 3 * (uint64_t)n, c->position + 3 * (uint64_t)at, 3 * sizeof *point);
        joint[n++] = at;
        if (n > 1) {
            if (fans->start[at + 1] - fans->start[at] != 2) return n;
            bone = fans->bone[fans->start[at]] == bone ? fans->bone[fans->start[at] + 1] : fans->bone[fans->start[at]];
        }
        at = skeli_other_end(c, bone, at);
    }
}

/* A chain from an end to a branch is dropped when the way along it to the surface beyond its end is little longer than the radius of the ball around the
 * branch (after growing: and what sticks out of that ball is little longer than it is wide): then it shows a bump of that ball. Neither rule has a scale. A whole curve without a branch that is no longer than its
 * ball becomes a point. */
svo_result skeli_drop_stubs(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *s, double omega, skeli_limb which, skeli_curve *c, svo_error *err)
{
    for (;;) {
        skeli_fans fans;
        SVO_TRY(skeli_fans_make(pool, c, &fans, err));
        uint32_t *into = skeli_take(pool, c->joints, sizeof *into), *joint = skeli_take(pool, c->joints, sizeof *joint), *shortest = skeli_take(pool, c->joints, sizeof *shortest), drop = 0;
        double *point = skeli_take(pool, 3 * (uint64_t)c->joints, sizeof *point), least = INFINITY;
        if (into == NULL || joint == NULL || shortest == NULL || point == NULL) return skeli_no_memory(err);
        for (uint32_t j = 0; j < c->joints; j++) into[j] = j;
        for (uint32_t end = 0; end < c->joints; end++) {
            if (fans.start[end + 1] - fans.start[end] != 1) continue;
            const uint32_t n = walk(c, &fans, end, joint, point), at = joint[n - 1];
            const double *root_at = point + 3 * ((uint64_t)n - 1);
            double ratio;
            bool limb = skeli_is_limb(s, omega, which, INFINITY, point, n, &ratio);
            if (fans.start[at + 1] - fans.start[at] == 1) { /* a path; it is dropped from its thinner end */
                const double tip = skeli_surface_distance(s, point, FAR, NULL), root = skeli_surface_distance(s, root_at, FAR, NULL);
                double way = ratio * root - tip;
                ratio = (way + tip + root) / (2 * fmax(tip, root));
                limb = ratio >= STICKS_OUT || root < tip;
            }
            if (limb || ratio >= least || !skeli_surface_inside(s, point) || !skeli_surface_inside(s, root_at)) continue;
            least = ratio;
            drop = n;
            memcpy(shortest, joint, n * sizeof *joint);
        }
        for (uint32_t i = 0; i + 1 < drop; i++) into[shortest[i]] = shortest[drop - 1];
        svo_result result = drop > 0 ? skeli_curve_merge(pool, mesh, c, into, err) : SVO_OK;
        skeli_give(pool, into);
        skeli_give(pool, joint);
        skeli_give(pool, shortest);
        skeli_give(pool, point);
        skeli_fans_free(pool, &fans);
        if (drop == 0 || result != SVO_OK) return result;
    }
}
