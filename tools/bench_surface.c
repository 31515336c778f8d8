/* svo-bench: how far the surface is from the voxels that stand for it. */
#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "bench.h"
#include "fmt_svo.h"
#include "svo_morton.h"
#include "svo_stream.h"

enum { POINTS = 4096, NEIGHBOURS = 27 };

/* A voxel that would be near a point. */
typedef struct candidate {
    uint64_t code;
    uint32_t point;
    float distance; /* of its centre */
} candidate;

typedef struct measure {
    candidate *list; /* by code */
    uint64_t count, at;
    double nearest[POINTS];
} measure;

static int by_code(const void *a, const void *b)
{
    const candidate *x = a, *y = b;
    if (x->code != y->code) return x->code < y->code ? -1 : 1;
    return x->point < y->point ? -1 : x->point > y->point;
}

static void corners_of(const svo_mesh *mesh, const svo_instance *instance, const svo_part *part, uint64_t t, svo_vec3 v[3])
{
    (void)mesh;
    for (int k = 0; k < 3; k++) {
        const double *p = part->positions + 3 * (size_t)part->indices[3 * t + (uint64_t)k];
        v[k] = svo_mat4_point(&instance->transform, svo_v3(p[0], p[1], p[2]));
    }
}

static double area_of(const svo_vec3 v[3])
{
    svo_vec3 n = svo_cross(svo_sub(v[1], v[0]), svo_sub(v[2], v[0]));
    double area = sqrt(svo_dot(n, n)) / 2;
    return isfinite(area) ? area : 0;
}

/* Equal steps of area along all triangles in order; in each triangle a point of a low-discrepancy sequence. */
static uint32_t choose_points(const svo_mesh *mesh, svo_vec3 out[POINTS])
{
    double total = 0, sum = 0;
    uint32_t n = 0;
    for (int pass = 0; pass < 2; pass++)
        for (uint32_t i = 0; i < mesh->instance_count; i++) {
            const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
            for (uint32_t p = 0; p < shape->part_count; p++)
                for (uint64_t t = 0; t < shape->parts[p].triangle_count; t++) {
                    svo_vec3 v[3];
                    corners_of(mesh, &mesh->instances[i], &shape->parts[p], t, v);
                    double area = area_of(v);
                    if (pass == 0) {
                        total += area;
                        continue;
                    }
                    sum += area;
                    for (; area > 0 && n < POINTS && sum >= total * ((double)n + 0.5) / POINTS; n++) {
                        double a = fmod(0.754877666246693 * (n + 1), 1), b = fmod(0.569840290998053 * (n + 1), 1);
                        if (a + b > 1) a = 1 - a, b = 1 - b;
                        out[n] = svo_add(v[0], svo_add(svo_scale(svo_sub(v[1], v[0]), a), svo_scale(svo_sub(v[2], v[0]), b)));
                    }
                }
        }
    return n;
}

static bool visit(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    (void)index;
    measure *m = user;
    uint64_t first = svo_morton_encode(low[0], low[1], low[2]), end = first + (uint64_t)size * size * size;
    while (m->at < m->count && m->list[m->at].code < first) m->at++;
    for (; m->at < m->count && m->list[m->at].code < end; m->at++) {
        const candidate *c = &m->list[m->at];
        if ((double)c->distance < m->nearest[c->point]) m->nearest[c->point] = (double)c->distance;
    }
    return m->at < m->count;
}

static svo_result read_voxels(const svo_buffer *svo, const svo_allocator *a, measure *m, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *reader = NULL;
    svo_buffer packed, storage;
    svo_buffer_init(&packed, a);
    svo_buffer_init(&storage, a);
    SVO_TRY(fmt_input_open_memory(svo->data, svo->size, &in, err));
    svo_result r = fmt_svo_reader_open(in, a, &reader, err);
    if (r == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(reader);
        for (bool more = true; r == SVO_OK && more;) {
            svo_chunk chunk;
            r = source.fetch(source.user, &packed, &more, err);
            if (r == SVO_OK && more) r = source.decode(source.user, &packed, &storage, &chunk, err);
            if (r == SVO_OK && more) svo_chunk_values(&chunk, visit, m);
        }
    }
    fmt_svo_reader_close(reader);
    fmt_input_close(in);
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    return r;
}

static uint64_t gather(const svo_vec3 *points, uint32_t count, const svo_tree_info *info, candidate *list)
{
    uint64_t n = 0;
    const double edge = ldexp(1, (int)info->depth);
    for (uint32_t i = 0; i < count; i++) {
        const double world[3] = {points[i].x, points[i].y, points[i].z};
        double at[3];
        for (int k = 0; k < 3; k++) at[k] = (world[k] - info->voxel_to_world[4 * k + 3]) / info->voxel_to_world[5 * k];
        for (int k = 0; k < NEIGHBOURS; k++) {
            double d = 0;
            uint32_t cell[3];
            bool inside = true;
            for (int j = 0; j < 3; j++) {
                int step = (j == 0 ? k % 3 : j == 1 ? k / 3 % 3 : k / 9) - 1;
                /* the far end of the grid belongs to its last layer */
                double c = fmin(floor(at[j]), edge - 1) + step;
                inside = inside && c >= 0 && c < edge;
                cell[j] = inside ? (uint32_t)c : 0;
                d += (c + 0.5 - at[j]) * (c + 0.5 - at[j]);
            }
            if (inside) list[n++] = (candidate){svo_morton_encode(cell[0], cell[1], cell[2]), i, (float)sqrt(d)};
        }
    }
    qsort(list, n, sizeof *list, by_code);
    return n;
}

svo_result bench_surface_distances(const svo_mesh *mesh, const svo_buffer *svo, const svo_tree_info *info, const svo_allocator *a, bench_surface *out, svo_error *err)
{
    *out = (bench_surface){0};
    svo_vec3 *points = svo_alloc(a, POINTS, sizeof *points);
    measure *m = svo_calloc(a, 1, sizeof *m);
    svo_result r = SVO_OK;
    uint32_t count = 0;
    if (m != NULL) m->list = svo_alloc(a, POINTS * NEIGHBOURS, sizeof *m->list);
    if (points == NULL || m == NULL || m->list == NULL) {
        r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    } else {
        count = choose_points(mesh, points);
        m->count = gather(points, count, info, m->list);
        for (uint32_t i = 0; i < count; i++) m->nearest[i] = 1.5; /* no nearer than that when none of the neighbours is there */
        if (count != 0) r = read_voxels(svo, a, m, err);
    }
    for (uint32_t i = 0; i < count; i++) {
        out->mean += m->nearest[i] / count;
        if (m->nearest[i] > out->max) out->max = m->nearest[i];
    }
    out->count = count;
    if (m != NULL) svo_free(a, m->list, POINTS * NEIGHBOURS, sizeof *m->list);
    svo_free(a, m, 1, sizeof *m);
    svo_free(a, points, POINTS, sizeof *points);
    return r;
}
