#include "svo_estimate.h"

#include <math.h>

#include "svo_soup.h"
#include "svo_task.h"

enum { BLOCK = 1 << 14 /* triangles */ };

/* Sums by block (of a soup: by piece), added up in their order, so that the result does not depend on threads. */
typedef struct area_job {
    const svo_part *part;
    const svo_mat4 *transform;
    double *sum;
} area_job;

static double triangle_area(const area_job *job, const double c[9])
{
    svo_vec3 v[3];
    for (int k = 0; k < 3; k++) v[k] = svo_mat4_point(job->transform, svo_v3(c[3 * k], c[3 * k + 1], c[3 * k + 2]));
    double ax = v[1].x - v[0].x, ay = v[1].y - v[0].y, az = v[1].z - v[0].z, bx = v[2].x - v[0].x, by = v[2].y - v[0].y, bz = v[2].z - v[0].z;
    double area = (fabs(ay * bz - az * by) + fabs(az * bx - ax * bz) + fabs(ax * by - ay * bx)) / 2;
    return isfinite(area) ? area : 0;
}

static svo_result resident_area(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)err;
    (void)worker;
    area_job *job = user;
    for (uint64_t block = begin; block < end; block++) {
        const uint64_t first = block * BLOCK, left = job->part->triangle_count - first, last = first + (left < BLOCK ? left : BLOCK);
        double sum = 0;
        for (uint64_t t = first; t < last; t++) {
            double c[9];
            for (uint64_t k = 0; k < 9; k++) c[k] = job->part->positions[3 * (uint64_t)job->part->indices[3 * t + k / 3] + k % 3];
            sum += triangle_area(job, c);
        }
        job->sum[block] = sum;
    }
    return SVO_OK;
}

typedef struct spilled_sum { const area_job *job; double sum; } spilled_sum;

static void add_area(void *user, const double c[9])
{
    spilled_sum *s = user;
    s->sum += triangle_area(s->job, c);
}

static svo_result spilled_area(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    area_job *job = user;
    for (uint64_t piece = begin; piece < end; piece++) {
        spilled_sum s = {job, 0};
        SVO_TRY(svo_soup_triangles(job->part->soup, piece, piece + 1, add_area, &s, err));
        job->sum[piece] = s.sum;
    }
    return SVO_OK;
}

static svo_result part_area(area_job *job, uint32_t threads, double *area, svo_error *err)
{
    const struct svo_soup *soup = job->part->soup;
    const uint64_t count = soup != NULL ? soup->pieces.size / sizeof(svo_soup_piece) : (job->part->triangle_count + BLOCK - 1) / BLOCK;
    if (count == 0) return SVO_OK;
    job->sum = svo_calloc(NULL, count, sizeof *job->sum);
    if (job->sum == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to measure the surface");
    svo_result r = svo_parallel_for(threads, count, soup != NULL ? 0 : 1, soup != NULL ? spilled_area : resident_area, job, err);
    for (uint64_t i = 0; r == SVO_OK && i < count; i++) *area += job->sum[i];
    svo_free(NULL, job->sum, count, sizeof *job->sum);
    return r;
}

svo_result svo_estimate_area(const svo_mesh *mesh, uint32_t threads, double *area, svo_error *err)
{
    double sum = 0;
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
        for (uint32_t p = 0; p < shape->part_count; p++) {
            area_job job = {.part = &shape->parts[p], .transform = &mesh->instances[i].transform};
            SVO_TRY(part_area(&job, threads, &sum, err));
        }
    }
    *area = sum;
    return SVO_OK;
}
