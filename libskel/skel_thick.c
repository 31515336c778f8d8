/* Where the contraction may take long steps. A part that is many omega thick takes thousands of sweeps at steps of a fraction of omega, and nothing of it can come within
 * omega of anything else before it is thin. So balls there become 2, 4 or 8 times as wide, and vertices are clustered to match; what is thinner than that is left alone.
 * How thick parts are is measured once, where the surface is still smooth, and used up by what vertices move: later, folds would hide it. */
#include "skeli_thick.h"

#include <math.h>
#include <string.h>

#include "skeli_surface.h"
#include "svo_task.h"

#define ROOM 4.0   /* way through the part by the radius of the ball, at least */
#define GRADE 1.0  /* the way through grows along the surface no faster than that */
#define FAR (4.0 * SKEL_LATTICE)
#define START 16.0 /* lattice steps that a ray begins off its vertex */
enum { PASSES = 8, BLOCK = 256 };

typedef struct looking {
    const skeli_state *s;
    const skeli_surface *surface;
    float *way;
} looking;

/* Across the largest triangle of each vertex, to both sides: one is through the part, the other through what may lie beside it. */
static svo_result look(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    const looking *l = user;
    const skeli_state *s = l->s;
    for (uint64_t i = begin; i < end; i++) {
        double n[3] = {0, 0, 0}, most = 0;
        for (uint32_t k = s->incident_start[i]; k < s->incident_start[i + 1]; k++) {
            const uint32_t *c = s->corner + 3 * (uint64_t)s->incident[k];
            double u[3], v[3], x[3], l2 = 0;
            for (int e = 0; e < 3; e++) {
                u[e] = s->position[3 * (uint64_t)c[1] + (uint64_t)e] - s->position[3 * (uint64_t)c[0] + (uint64_t)e];
                v[e] = s->position[3 * (uint64_t)c[2] + (uint64_t)e] - s->position[3 * (uint64_t)c[0] + (uint64_t)e];
            }
            for (int e = 0; e < 3; e++) {
                x[e] = u[(e + 1) % 3] * v[(e + 2) % 3] - u[(e + 2) % 3] * v[(e + 1) % 3];
                l2 += x[e] * x[e];
            }
            if (!(l2 > most)) continue;
            most = l2;
            for (int e = 0; e < 3; e++) n[e] = x[e] / sqrt(l2);
        }
        l->way[i] = 0;
        if (!(most > 0)) continue;
        double least = FAR;
        for (int side = -1; side <= 1; side += 2) {
            double p[3], d[3];
            for (int e = 0; e < 3; e++) {
                d[e] = side * n[e];
                p[e] = s->position[3 * i + (uint64_t)e] + START * d[e];
            }
            least = skeli_surface_ray(l->surface, p, d, least);
        }
        l->way[i] = (float)least;
    }
    return SVO_OK;
}

/* A vertex beside a thin part is in reach of it. Passes forth and back over vertices that lie together. */
static void grade(const skeli_state *s, float *way)
{
    bool changed = true;
    for (int pass = 0; pass < PASSES && changed; pass++) {
        changed = false;
        for (uint64_t k = 0; k < s->count; k++) {
            const uint64_t i = pass % 2 == 0 ? k : s->count - 1 - k;
            const double *p = s->position + 3 * i;
            for (uint64_t e = s->edge_start[i]; e < s->edge_start[i + 1]; e++) {
                const uint64_t j = s->edge[2 * e + 1];
                const double *q = s->position + 3 * j, x = q[0] - p[0], y = q[1] - p[1], z = q[2] - p[2], most = way[j] + GRADE * sqrt(x * x + y * y + z * z);
                if (!((float)most < way[i])) continue;
                way[i] = (float)most;
                changed = true;
            }
        }
    }
}

svo_result skeli_ways(skeli_pool *pool, const skeli_state *s, uint32_t threads, float *way, svo_error *err)
{
    skeli_soup soup = {.vertex_count = s->count, .triangle_count = s->triangle_count, .corner = s->corner};
    skeli_surface surface = {0};
    looking l = {.s = s, .surface = &surface, .way = way};
    soup.position = skeli_take(pool, 3 * (uint64_t)s->count, sizeof *soup.position);
    if (soup.position == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < 3 * (uint64_t)s->count; i++) soup.position[i] = (int32_t)s->position[i];
    SVO_TRY(skeli_surface_tree(pool, &soup, &surface, err));
    SVO_TRY(svo_parallel_for(s->count < 2 * BLOCK ? 1 : threads, s->count, BLOCK, look, &l, err));
    grade(s, way);
    skeli_give(pool, surface.box);
    skeli_give(pool, surface.four);
    skeli_give(pool, soup.position);
    return SVO_OK;
}

uint32_t skeli_doublings(const float *way, uint32_t count, double omega, uint8_t *doublings)
{
    uint32_t thick = 0;
    for (uint32_t i = 0; i < count; i++) {
        doublings[i] = 0;
        while (doublings[i] < SKELI_MOST_DOUBLINGS && way[i] >= ROOM * omega * (double)(2u << doublings[i])) doublings[i]++;
        thick += doublings[i] > 0;
    }
    return thick;
}
