/* Bounds of placed triangles, in memory or not. */
#include <math.h>
#include <string.h>

#include "svo_task.h"
#include "svoi_scatter.h"

enum { MAX_WORKERS = 256 };

typedef struct bounds { double low[3], high[3]; } bounds;

typedef struct bounds_job {
    const svo_part *part;
    const svo_mat4 *transform;
    bounds of[MAX_WORKERS];
} bounds_job;

static void add(bounds *b, const svo_vec3 v[3])
{
    double zero = 0; /* NaN where something is not finite */
    for (int k = 0; k < 3; k++) zero += v[k].x * 0 + v[k].y * 0 + v[k].z * 0;
    if (!(zero == 0)) return;
    for (int k = 0; k < 3; k++) {
        const double c[3] = {v[k].x, v[k].y, v[k].z};
        for (int i = 0; i < 3; i++) {
            if (c[i] < b->low[i]) b->low[i] = c[i];
            if (c[i] > b->high[i]) b->high[i] = c[i];
        }
    }
}

typedef struct placed_bounds { const svo_mat4 *transform; bounds *of; } placed_bounds;

static void add_corners(void *user, const double c[9])
{
    const placed_bounds *b = user;
    svo_vec3 v[3];
    for (int k = 0; k < 3; k++) v[k] = svo_mat4_point(b->transform, svo_v3(c[3 * k], c[3 * k + 1], c[3 * k + 2]));
    add(b->of, (const svo_vec3 *)v);
}

static svo_result piece_bounds(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    bounds_job *job = user;
    placed_bounds b = {job->transform, &job->of[worker]};
    return svo_soup_triangles(job->part->soup, begin, end, add_corners, &b, err);
}

static void join(bounds *to, const bounds *from)
{
    for (int i = 0; i < 3; i++) {
        if (from->low[i] < to->low[i]) to->low[i] = from->low[i];
        if (from->high[i] > to->high[i]) to->high[i] = from->high[i];
    }
}

/* The groups that are in memory, as a placement of their own. */
static svo_result resident_bounds(const svo_placement *p, uint32_t threads, const svo_allocator *a, bounds *all, svo_error *err)
{
    svo_placement part = {.mesh = p->mesh, .allocator = a};
    part.groups = svo_alloc(a, p->group_count, sizeof *part.groups);
    if (part.groups == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %llu placed parts", (unsigned long long)p->group_count);
    for (uint64_t g = 0; g < p->group_count; g++) {
        if (p->groups[g].part->soup != NULL) continue;
        part.groups[part.group_count] = p->groups[g];
        part.groups[part.group_count++].first = part.triangle_count;
        part.triangle_count += p->groups[g].part->triangle_count;
    }
    bounds b;
    bool any = false;
    svo_result r = part.triangle_count != 0 ? svo_placement_bounds(&part, threads, &any, b.low, b.high, err) : SVO_OK;
    if (r == SVO_OK && any) join(all, &b);
    svo_free(a, part.groups, p->group_count, sizeof *part.groups);
    return r;
}

svo_result svoi_bounds(const svo_placement *p, uint32_t threads, const svo_allocator *a, bool *any, double low[3], double high[3], svo_error *err)
{
    bool spilled = false;
    for (uint64_t g = 0; g < p->group_count; g++) spilled |= p->groups[g].part->soup != NULL;
    if (!spilled) return svo_placement_bounds(p, threads, any, low, high, err);
    bounds all = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    bounds_job job;
    svo_result r = resident_bounds(p, threads, a, &all, err);
    for (uint64_t g = 0; r == SVO_OK && g < p->group_count; g++) {
        job.part = p->groups[g].part;
        if (job.part->soup == NULL) continue;
        job.transform = &p->mesh->instances[p->groups[g].instance].transform;
        const bounds none = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
        for (int w = 0; w < MAX_WORKERS; w++) job.of[w] = none;
        r = svo_parallel_for(threads, job.part->soup->pieces.size / sizeof(svo_soup_piece), 0, piece_bounds, &job, err);
        for (int w = 0; w < MAX_WORKERS; w++) join(&all, &job.of[w]);
    }
    if (r != SVO_OK) return r;
    *any = all.low[0] <= all.high[0];
    memcpy(low, all.low, sizeof all.low);
    memcpy(high, all.high, sizeof all.high);
    return SVO_OK;
}
