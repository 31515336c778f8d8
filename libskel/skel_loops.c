/* No loops that go around nothing. */
#include <math.h>
#include <string.h>

#include "skeli_curve.h"

/* --- loops around nothing ----------------------------------------------------------------------------------------- */

bool skeli_mostly_inside(const skeli_surface *surface, const skeli_curve *c)
{
    double inside = 0, total = 0;
    for (uint64_t b = 0; b < c->bones; b++) {
        const double *x = c->position + 3 * (uint64_t)c->bone[2 * b], *y = c->position + 3 * (uint64_t)c->bone[2 * b + 1];
        double foot, length = skeli_segment_distance(x, y, y, &foot);
        for (int i = 0; i < 8; i++) {
            double p[3];
            for (int k = 0; k < 3; k++) p[k] = x[k] + (y[k] - x[k]) * (i + 0.5) / 8;
            if (skeli_surface_inside(surface, p)) inside += length;
            total += length;
        }
    }
    if (c->bones == 0) {
        for (uint32_t j = 0; j < c->joints; j++) inside += skeli_surface_inside(surface, c->position + 3 * (uint64_t)j);
        total = c->joints;
    }
    return inside > 0.6 * total;
}

/* Is the cone from the middle of a closed path to its sides inside the solid? Rays of the cone are walked where the surface is not near. */
static bool filled(const skeli_surface *surface, const skeli_curve *c, const uint32_t *path, uint32_t n)
{
    double middle[3] = {0, 0, 0}, total = 0;
    for (uint32_t i = 0; i < n; i++) {
        const double *a = c->position + 3 * (uint64_t)path[i], *b = c->position + 3 * (uint64_t)path[(i + 1) % n];
        double foot, length = skeli_segment_distance(a, b, b, &foot);
        for (int k = 0; k < 3; k++) middle[k] += length * (a[k] + b[k]) / 2;
        total += length;
    }
    if (!(total > 0)) return true;
    for (int k = 0; k < 3; k++) middle[k] /= total;
    uint32_t in = 0, all = 0;
    for (uint32_t i = 0; i < n; i++) {
        const double *a = c->position + 3 * (uint64_t)path[i], *b = c->position + 3 * (uint64_t)path[(i + 1) % n];
        for (int e = 0; e < 4; e++)
            for (int f = 0; f < 8; f++) {
                double p[3], t = (e + 0.5) / 4, r = f / 8.0;
                for (int k = 0; k < 3; k++) p[k] = middle[k] + r * (a[k] + t * (b[k] - a[k]) - middle[k]);
                in += skeli_surface_inside(surface, p);
                all++;
            }
    }
    return in * 20 >= all * 19;
}

/* Shortest way from bone b's first joint to its second without b; the path as joints. 0: none. */
static uint32_t shortest_cycle(const skeli_curve *c, const skeli_fans *fans, uint64_t b, double *reach, uint32_t *before, bool *done, uint32_t *path)
{
    uint32_t from = c->bone[2 * b], to = c->bone[2 * b + 1];
    for (uint32_t j = 0; j < c->joints; j++) {
        reach[j] = INFINITY;
        done[j] = false;
    }
    reach[from] = 0;
    before[from] = SVO_NONE;
    for (;;) { /* few joints: no heap */
        uint32_t at = SVO_NONE;
        for (uint32_t j = 0; j < c->joints; j++)
            if (!done[j] && reach[j] < INFINITY && (at == SVO_NONE || reach[j] < reach[at])) at = j;
        if (at == SVO_NONE) return 0;
        if (at == to) break;
        done[at] = true;
        for (uint32_t k = fans->start[at]; k < fans->start[at + 1]; k++) {
            uint32_t e = fans->bone[k], x = c->bone[2 * (uint64_t)e] == at ? c->bone[2 * (uint64_t)e + 1] : c->bone[2 * (uint64_t)e];
            double foot, d;
            if (e == b) continue;
            d = reach[at] + skeli_segment_distance(c->position + 3 * (uint64_t)at, c->position + 3 * (uint64_t)x, c->position + 3 * (uint64_t)x, &foot);
            if (d >= reach[x]) continue;
            reach[x] = d;
            before[x] = at;
        }
    }
    uint32_t n = 0;
    for (uint32_t j = to; j != SVO_NONE; j = before[j]) path[n++] = j;
    return n;
}

enum { LOOP_JOINTS = 2000 }; /* beyond, cycles are not searched: their number and cost grow with the square */

svo_result skeli_close_false_loops(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, skeli_curve *c, svo_error *err)
{
    if (c->joints > LOOP_JOINTS) return SVO_OK;
    for (uint32_t round = 0; round < 64; round++) {
        skeli_fans fans;
        SVO_TRY(skeli_fans_make(pool, c, &fans, err));
        uint32_t *before = skeli_take(pool, c->joints, sizeof *before), *path = skeli_take(pool, c->joints, sizeof *path);
        uint32_t *into = skeli_take(pool, c->joints, sizeof *into), *parent = skeli_take(pool, c->joints, sizeof *parent);
        double *reach = skeli_take(pool, c->joints, sizeof *reach);
        bool *done = skeli_take(pool, c->joints, sizeof *done), found = false;
        if (before == NULL || path == NULL || into == NULL || parent == NULL || reach == NULL || done == NULL) return skeli_no_memory(err);
        for (uint32_t j = 0; j < c->joints; j++) into[j] = parent[j] = j;
        for (uint64_t b = 0; b < c->bones && !found; b++) { /* bones that close a loop of a spanning forest */
            uint32_t p = skeli_root(parent, c->bone[2 * b]), q = skeli_root(parent, c->bone[2 * b + 1]);
            if (p != q) {
                parent[p > q ? p : q] = p > q ? q : p;
                continue;
            }
            uint32_t n = shortest_cycle(c, &fans, b, reach, before, done, path);
            if (n < 3 || !filled(surface, c, path, n)) continue;
            double middle[3] = {0, 0, 0};
            uint32_t least = path[0];
            for (uint32_t i = 0; i < n; i++) {
                least = path[i] < least ? path[i] : least;
                for (int k = 0; k < 3; k++) middle[k] += c->position[3 * (uint64_t)path[i] + (uint64_t)k] / n;
            }
            for (uint32_t i = 0; i < n; i++) into[path[i]] = least;
            memcpy(c->position + 3 * (uint64_t)least, middle, sizeof middle);
            found = true;
        }
        svo_result result = found ? skeli_curve_merge(pool, mesh, c, into, err) : SVO_OK;
        skeli_give(pool, before);
        skeli_give(pool, path);
        skeli_give(pool, into);
        skeli_give(pool, parent);
        skeli_give(pool, reach);
        skeli_give(pool, done);
        skeli_fans_free(pool, &fans);
        if (!found || result != SVO_OK) return result;
    }
    return SVO_OK;
}
