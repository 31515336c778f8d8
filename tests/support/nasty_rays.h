/* Rays of every nasty kind for tests of ray casters. */
#ifndef NASTY_RAYS_H
#define NASTY_RAYS_H

#include <math.h>

#include "svo_raycast.h"
#include "test.h"

/* A ray of kind `kind`, aimed so that it often meets the grid. */
enum { KINDS = 12 };
static inline svo_ray nasty_ray(uint64_t *s, uint32_t depth, uint32_t kind)
{
    double n = ldexp(1, (int)depth);
    svo_ray r = {.t_min = 0, .t_max = INFINITY};
    double target[3];
    for (int k = 0; k < 3; k++) {
        r.origin[k] = (test_random_unit(s) * 3 - 1) * n;
        target[k] = test_random_unit(s) * n;
    }
    for (int k = 0; k < 3; k++) r.direction[k] = target[k] - r.origin[k];
    uint32_t axis = (uint32_t)(test_random(s) % 3);
    switch (kind) {
    case 0: break;
    case 1: /* begins inside the grid */
        for (int k = 0; k < 3; k++) r.origin[k] = test_random_unit(s) * n;
        break;
    case 2: /* parallel to an axis, in general position */
        for (uint32_t k = 0; k < 3; k++)
            if (k != axis) r.direction[k] = test_random(s) & 1 ? 0.0 : -0.0, r.origin[k] = target[k];
        break;
    case 3: /* along an edge of the grid: integer coordinates */
        for (uint32_t k = 0; k < 3; k++)
            if (k != axis) r.direction[k] = 0, r.origin[k] = floor(test_random_unit(s) * (n + 1));
        break;
    case 4: /* in a face: one zero component at an integer */
        r.direction[axis] = 0;
        r.origin[axis] = floor(test_random_unit(s) * (n + 1));
        break;
    case 5: /* diagonals through corners */
        for (int k = 0; k < 3; k++) {
            r.origin[k] = floor(r.origin[k]);
            r.direction[k] = (double)(int)(test_random(s) % 3) - 1;
        }
        break;
    case 6: /* begins on a face, an edge or a corner */
        for (int k = 0; k < 3; k++)
            if (test_random(s) & 1) r.origin[k] = floor(target[k]);
            else r.origin[k] = target[k];
        for (int k = 0; k < 3; k++) r.direction[k] = test_random_unit(s) - 0.5;
        break;
    case 7: /* tiny components, denormal ones too */
        r.origin[axis] = target[axis];
        r.direction[axis] = ldexp(test_random_unit(s) - 0.5, -(int)(test_random(s) % 1074));
        break;
    case 8: /* an interval of t */
        r.t_min = test_random_unit(s);
        r.t_max = r.t_min + 0.3 * test_random_unit(s);
        break;
    case 9: /* t_min where a voxel begins or ends, t_max the same */
        for (int k = 0; k < 3; k++) r.direction[k] = (test_random(s) & 1 ? 1 : -1) * ldexp(1, (int)(test_random(s) % 3));
        for (int k = 0; k < 3; k++) r.origin[k] = floor(r.origin[k]);
        r.t_min = floor(test_random_unit(s) * n);
        r.t_max = test_random(s) & 1 ? r.t_min : INFINITY;
        break;
    case 10: /* points on the surface of the grid, both ends */
        r.origin[axis] = test_random(s) & 1 ? n : 0;
        for (int k = 0; k < 3; k++) r.direction[k] = test_random_unit(s) - 0.5;
        break;
    case 11: /* integer origin and direction: meets many edges exactly */
        for (int k = 0; k < 3; k++) {
            r.origin[k] = floor(r.origin[k]);
            r.direction[k] = (double)(int)(test_random(s) % 9) - 4;
        }
        break;
    }
    return r;
}

#endif
