#include "svo_estimate.h"

#include <math.h>

#include "svo_soup.h"
#include "svo_task.h"

enum { MAX_WORKERS = 256 };

typedef struct area_job {
    const svo_part *part;
    const svo_mat4 *transform;
    double sum[MAX_WORKERS];
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
    area_job *job = user;
    for (uint64_t t = begin; t < end; t++) {
        double c[9];
        for (uint64_t k = 0; k < 9; k++) c[k] = job->part->positions[3 * (uint64_t)job->part->indices[3 * t + k / 3] + k % 3];
        job->sum[worker] += triangle_area(job, c);
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
    area_job *job = user;
    spilled_sum s = {job, 0};
    svo_result r = svo_soup_triangles(job->part->soup, begin, end, add_area, &s, err);
    job->sum[worker] += s.sum;
    return r;
}

svo_result svo_estimate_area(const svo_mesh *mesh, uint32_t threads, double *area, svo_error *err)
{
    area_job job = {0};
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
        job.transform = &mesh->instances[i].transform;
        for (uint32_t p = 0; p < shape->part_count; p++) {
            job.part = &shape->parts[p];
            if (job.part->soup != NULL) SVO_TRY(svo_parallel_for(threads, job.part->soup->pieces.size / sizeof(svo_soup_piece), 0, spilled_area, &job, err));
            else SVO_TRY(svo_parallel_for(threads, job.part->triangle_count, 1 << 14, resident_area, &job, err));
        }
    }
    *area = 0;
    for (int w = 0; w < MAX_WORKERS; w++) *area += job.sum[w];
    return SVO_OK;
}
