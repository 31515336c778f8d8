/* A copy of a mesh that may be changed before its skeleton is built, and the way back to the elements of the mesh that was given. */
#include "skel_prepare.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "skeli_internal.h"

/* Points by place (coordinates as numbers, so that 0 and -0 are one), then by number. */
typedef struct placed { double p[3]; uint32_t index; } placed;

static int by_place(const void *a, const void *b)
{
    const placed *x = a, *y = b;
    for (int k = 0; k < 3; k++)
        if (x->p[k] != y->p[k]) return x->p[k] < y->p[k] ? -1 : 1;
    return (x->index > y->index) - (x->index < y->index);
}

/* What has a finite triangle: state 1 of a point. Returns the number of such triangles, which come first. */
static uint64_t finite_triangles(const skel_flat *f, uint8_t *used)
{
    uint64_t n = 0;
    for (uint64_t t = 0; t < f->triangles; t++) {
        uint32_t c[3];
        bool finite = true;
        memcpy(c, f->corner + 3 * t, sizeof c);
        for (uint64_t k = 0; k < 9; k++) finite &= isfinite(f->position[3 * (uint64_t)c[k / 3] + k % 3]);
        if (!finite) continue;
        for (uint64_t k = 0; k < 3; k++) used[c[k]] = 1;
        memcpy(f->corner + 3 * n++, c, sizeof c);
    }
    return n;
}

/* Points that have a triangle, sorted by place, one for each; same[] is where each went. The places go to the front of position. */
static svo_result weld(const skel_flat *f, const uint8_t *used, const svo_allocator *a, uint32_t *same, uint64_t *places, svo_error *err)
{
    placed *all = svo_alloc(a, f->points, sizeof *all);
    if (all == NULL) return skeli_no_memory(err);
    uint64_t n = 0;
    for (uint64_t i = 0; i < f->points; i++) {
        same[i] = SVO_NONE;
        if (!used[i]) continue;
        memcpy(all[n].p, f->position + 3 * i, sizeof all[n].p);
        all[n++].index = (uint32_t)i;
    }
    qsort(all, n, sizeof *all, by_place);
    *places = 0;
    for (uint64_t i = 0; i < n; i++) {
        const double *before = f->position + 3 * (*places - 1);
        if (i == 0 || all[i].p[0] != before[0] || all[i].p[1] != before[1] || all[i].p[2] != before[2])
            memcpy(f->position + 3 * (*places)++, all[i].p, sizeof all[i].p);
        same[all[i].index] = (uint32_t)(*places - 1);
    }
    svo_free(a, all, f->points, sizeof *all);
    return SVO_OK;
}

void skel_prepared_replace(skel_prepared *p, double *position, uint64_t points, uint32_t *corner, uint64_t triangles)
{
    if (p->part.positions != position) svo_free(p->allocator, p->part.positions, 3 * p->points, sizeof *p->part.positions);
    if (p->part.indices != corner) svo_free(p->allocator, p->part.indices, 3 * p->triangles, sizeof *p->part.indices);
    p->part.positions = position;
    p->part.indices = corner;
    p->part.vertex_count = p->points = points;
    p->part.triangle_count = p->triangles = triangles;
}

svo_result skel_prepare(const svo_mesh *mesh, const svo_allocator *a, skel_prepared *out, svo_error *err)
{
    static char no_name[] = "";
    skel_flat f = {0};
    *out = (skel_prepared){.allocator = a, .part = {.material = SVO_NONE}};
    svo_result r = skel_flat_make(mesh, a, &f, err);
    if (r != SVO_OK) {
        skel_flat_free(&f, a);
        return r;
    }
    skel_prepared_replace(out, f.position, f.points, f.corner, f.triangles);
    out->shape = (svo_shape){.name = no_name, .part_count = 1, .parts = &out->part};
    out->instance = (svo_instance){.name = no_name, .transform = svo_mat4_identity()};
    out->mesh = (svo_mesh){.allocator = a, .shape_count = 1, .instance_count = 1, .shapes = &out->shape, .instances = &out->instance};
    for (uint64_t i = 0; i < f.points; i++) {
        const double *x = f.position + 3 * i;
        out->points_not_finite += !isfinite(x[0]) || !isfinite(x[1]) || !isfinite(x[2]);
    }
    out->given = f.points;
    out->same = svo_alloc(a, f.points, sizeof *out->same);
    uint8_t *used = svo_calloc(a, f.points, 1);
    r = out->same == NULL || used == NULL ? skeli_no_memory(err) : SVO_OK;
    if (r == SVO_OK) {
        out->part.triangle_count = finite_triangles(&f, used);
        out->not_finite = f.triangles - out->part.triangle_count;
        r = weld(&f, used, a, out->same, &out->places, err);
    }
    if (r == SVO_OK) {
        for (uint64_t c = 0; c < 3 * out->part.triangle_count; c++) f.corner[c] = out->same[f.corner[c]];
        for (uint64_t i = 0; i < f.points; i++) out->merged += out->same[i] != SVO_NONE;
        out->merged -= out->places;
        out->part.vertex_count = out->places;
        if (out->part.triangle_count == 0) r = svo_fail(err, SVO_INVALID_DATA, "the model has no triangle with finite corners, so it has no skeleton");
    }
    svo_free(a, used, f.points, 1);
    return r;
}

void skel_prepared_free(skel_prepared *p)
{
    if (p == NULL) return;
    skel_prepared_replace(p, NULL, 0, NULL, 0);
    svo_free(p->allocator, p->same, p->given, sizeof *p->same);
    memset(p, 0, sizeof *p);
}

svo_result skel_prepared_unit(const skel_prepared *p, skel_normalize how, double *unit, svo_error *err)
{
    double centre[3];
    return skeli_normalization(p->part.positions, p->places, how, centre, unit, err);
}

svo_result skel_prepared_map(const skel_prepared *p, skel_skeleton *s, svo_error *err)
{
    skel_report *r = &s->report;
    SVO_ASSERT(s->map_count == p->part.vertex_count);
    uint32_t *map = svo_alloc(s->allocator, p->given, sizeof *map);
    if (map == NULL) return skeli_no_memory(err);
    r->mapped_count = 0;
    for (uint64_t i = 0; i < p->given; i++) {
        map[i] = p->same[i] != SVO_NONE ? s->map[p->same[i]] : SVO_NONE;
        r->mapped_count += map[i] != SVO_NONE;
    }
    svo_free(s->allocator, s->map, s->map_count, sizeof *s->map);
    s->map = map;
    s->map_count = r->input_count = p->given;
    r->not_finite = p->points_not_finite;
    r->unreferenced = p->given - r->not_finite - r->mapped_count;
    r->coincident = p->merged;
    r->dropped_triangles += p->not_finite;
    return SVO_OK;
}
