/* The pipeline: import -> soup -> tessellation -> contraction -> curve -> measures -> map. */
#include "skel_build.h"

#include <math.h>
#include <string.h>

#include "skeli_internal.h"
#include "skel_prepare.h"
#include "skeli_refine.h"
#include "skel_solid.h"
#include "skeli_segment.h"
#include "skeli_solid.h"

skel_options skel_default_options(void)
{
    skel_options o;
    memset(&o, 0, sizeof o);
    o.omega = 0.0125;
    o.place = SKEL_PLACE_INSIDE;
    return o;
}

svo_result skeli_check_options(const skel_options *o, svo_error *err)
{
    if (!(o->omega >= SKEL_MIN_OMEGA && o->omega <= SKEL_MAX_OMEGA))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "omega must be %g to %g, not %g", SKEL_MIN_OMEGA, SKEL_MAX_OMEGA, o->omega);
    if (!(o->delta >= 0) || !isfinite(o->delta)) return svo_fail(err, SVO_INVALID_ARGUMENT, "delta must be 0 or more, not %g", o->delta);
    for (uint32_t i = 0; i < o->refine_count; i++)
        if (!(o->refine[i].omega >= SKEL_MIN_OMEGA && o->refine[i].omega <= SKEL_MAX_OMEGA))
            return svo_fail(err, SVO_INVALID_ARGUMENT, "the omega of a refinement must be %g to %g, not %g", SKEL_MIN_OMEGA, SKEL_MAX_OMEGA, o->refine[i].omega);
    if (o->solid_divide > 64) return svo_fail(err, SVO_INVALID_ARGUMENT, "voxels of a solid are omega / 1 to omega / 64, not omega / %u", o->solid_divide);
    return SVO_OK;
}

void skeli_phase(skel_report *r, const char *name, double *since)
{
    double now = svo_seconds();
    if (r->phase_count < SKEL_MAX_PHASES) r->phases[r->phase_count++] = (skel_phase){name, now - *since};
    *since = now;
}

void skel_skeleton_free(skel_skeleton *s)
{
    if (s == NULL) return;
    svo_free(s->allocator, s->joints, s->joint_count, sizeof *s->joints);
    svo_free(s->allocator, s->bones, s->bone_count, sizeof *s->bones);
    svo_free(s->allocator, s->map, s->map_count, sizeof *s->map);
    svo_free(s->allocator, s->samples, 3 * s->sample_count, sizeof *s->samples);
    svo_free(s->allocator, s->sample_joint, s->sample_count, sizeof *s->sample_joint);
    svo_free(s->allocator, s->solid.codes, s->solid.count, sizeof *s->solid.codes);
    memset(s, 0, sizeof *s);
}

static void warn_about(const skel_report *r, svo_warnings *w)
{
    if (r->not_finite > 0) svo_warn(w, "%llu vertices with coordinates that are not finite were dropped", (unsigned long long)r->not_finite);
    if (r->unreferenced > 0) svo_warn(w, "%llu vertices that belong to no triangle were dropped", (unsigned long long)r->unreferenced);
    if (!r->converged)
        svo_warn(w, "the contraction did not converge in %llu sweeps (largest movement %.3g omega, thinness error %.3g %%); the skeleton may have false loops",
                 (unsigned long long)r->iterations, r->final_movement_max / r->omega, r->thinness_error);
}

static svo_result keep_samples(const skeli_soup *mesh, const uint32_t *joint_of, skel_skeleton *out, svo_error *err)
{
    const skel_report *r = &out->report;
    uint64_t n = mesh->vertex_count;
    out->sample_count = n;
    out->samples = svo_alloc(out->allocator, 3 * n, sizeof *out->samples);
    out->sample_joint = svo_alloc(out->allocator, n, sizeof *out->sample_joint);
    if (out->samples == NULL || out->sample_joint == NULL) return skeli_no_memory(err);
    memcpy(out->sample_joint, joint_of, n * sizeof *joint_of);
    for (uint64_t i = 0; i < 3 * n; i++) out->samples[i] = r->centre[i % 3] + r->unit * ((double)mesh->position[i] / SKEL_LATTICE);
    return SVO_OK;
}

/* The curve, and how good it is. surface is made here and the caller's to free. Refinement replaces mesh, joint_of and moved. */
static svo_result curve(skeli_pool *pool, const skeli_soup *soup, skeli_model *m, const skeli_state *state, const double *position, uint64_t points, const uint32_t *corner,
                        uint64_t triangles, const uint32_t *remap, const skel_options *o, skeli_surface *surface, skel_skeleton *out, svo_error *err)
{
    skel_report *r = &out->report;
    double since = svo_seconds();
    bool needed = !o->skip_quality || o->place == SKEL_PLACE_INSIDE || o->solid_divide > 0;
    if (needed) SVO_TRY(skeli_surface_make(pool, soup, position, points, corner, triangles, remap, r, o->threads, surface, err));
    skeli_phase(r, "surface", &since);
    m->surface = needed ? surface : NULL;
    SVO_TRY(skeli_extract(pool, &m->mesh, state, m->surface, o, out, m->joint_of, err));
    skeli_phase(r, "extract", &since);
    SVO_TRY(skeli_measure(pool, &m->mesh, m->joint_of, NULL, out, err));
    if (o->refine_count > 0) {
        SVO_TRY(skeli_refine(m, o, err));
        skeli_phase(r, "refine", &since);
    }
    if (!o->skip_quality) SVO_TRY(skeli_quality_of(pool, surface, &m->mesh, out, r->centre, r->unit, o->threads, &r->quality, err));
    skeli_phase(r, "measure", &since);
    return SVO_OK;
}

static svo_result pipeline(skeli_pool *pool, const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles,
                           const skel_options *o, skel_skeleton *out, svo_error *err)
{
    skel_report *r = &out->report;
    double since = svo_seconds();
    skeli_soup soup, mesh;
    skeli_state state;
    uint32_t *remap = skeli_take(pool, points, sizeof *remap);
    if (remap == NULL) return skeli_no_memory(err);
    SVO_TRY(skeli_soup_make(pool, position, points, corner, triangles, r, &soup, remap, err));
    skeli_phase(r, "clean", &since);
    uint32_t *moved = skeli_take(pool, soup.vertex_count, sizeof *moved);
    if (moved == NULL) return skeli_no_memory(err);
    SVO_TRY(skeli_tessellate(pool, &soup, o->omega * SKEL_LATTICE, o->max_vertices != 0 ? o->max_vertices : 8000000, &mesh, moved, err));
    r->tessellated_vertices = mesh.vertex_count;
    r->tessellated_triangles = mesh.triangle_count;
    skeli_phase(r, "tessellate", &since);
    skeli_model model = {.pool = pool, .mesh = mesh, .moved = moved, .soup_vertices = soup.vertex_count, .s = out};
    model.joint_of = skeli_take(pool, mesh.vertex_count, sizeof *model.joint_of);
    if (model.joint_of == NULL) return skeli_no_memory(err);
    skeli_surface surface = {0};
    skeli_solid solid = {0};
    svo_result result = o->solid_divide > 0 ? skeli_solid_begin(o->allocator, &mesh, o->omega * SKEL_LATTICE, o->solid_divide, &solid, err) : SVO_OK;
    if (result == SVO_OK) result = skeli_contract(pool, &mesh, o, o->solid_divide > 0 ? &solid : NULL, r, &state, err);
    skeli_phase(r, "contract", &since);
    if (result == SVO_OK) result = curve(pool, &soup, &model, &state, position, points, corner, triangles, remap, o, &surface, out, err);
    if (result == SVO_OK && o->solid_divide > 0) result = skeli_solid_end(&solid, &surface, out, err);
    skeli_solid_free(&solid);
    skeli_surface_free(&surface);
    SVO_TRY(result);
    if (o->keep_samples) SVO_TRY(keep_samples(&model.mesh, model.joint_of, out, err));
    out->map = svo_alloc(out->allocator, points, sizeof *out->map);
    if (out->map == NULL) return skeli_no_memory(err);
    out->map_count = r->input_count = points;
    for (uint64_t i = 0; i < points; i++) {
        out->map[i] = remap[i] == SVO_NONE ? SVO_NONE : model.joint_of[model.moved[remap[i]]];
        r->mapped_count += out->map[i] != SVO_NONE;
    }
    return SVO_OK;
}

svo_result skeli_pipeline(const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles, const skel_options *o,
                          skel_skeleton *out, svo_error *err)
{
    skeli_pool pool = {.allocator = o->allocator};
    skel_skeleton s = {.allocator = o->allocator};
    s.report = (skel_report){.method = o->method, .normalize = o->normalize, .place = o->place, .omega = o->omega, .delta = o->delta};
    svo_result result = pipeline(&pool, position, points, corner, triangles, o, &s, err);
    skeli_pool_free(&pool);
    if (result != SVO_OK) {
        skel_skeleton_free(&s);
        return result;
    }
    warn_about(&s.report, o->warnings);
    *out = s;
    return SVO_OK;
}

/* All instances as one list of points and triangles in world coordinates, in the order the map is defined by. */
static void flatten(const svo_mesh *mesh, double *position, uint32_t *corner)
{
    uint64_t base = 0, t = 0;
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_instance *in = &mesh->instances[i];
        const svo_shape *shape = &mesh->shapes[in->shape];
        const bool mirrored = svo_mat4_det3(&in->transform) < 0;
        for (uint32_t k = 0; k < shape->part_count; k++) {
            const svo_part *part = &shape->parts[k];
            for (uint64_t v = 0; v < part->vertex_count; v++) {
                const double *p = part->positions + 3 * v;
                svo_vec3 q = svo_mat4_point(&in->transform, svo_v3(p[0], p[1], p[2]));
                double *to = position + 3 * (base + v);
                to[0] = q.x;
                to[1] = q.y;
                to[2] = q.z;
            }
            for (uint64_t c = 0; c < 3 * part->triangle_count; c++) { /* a mirror turns triangles round */
                uint64_t from = mirrored && c % 3 == 1 ? c + 1 : mirrored && c % 3 == 2 ? c - 1 : c;
                corner[t++] = (uint32_t)base + part->indices[from];
            }
            base += part->vertex_count;
        }
    }
}

svo_result skel_flat_make(const svo_mesh *mesh, const svo_allocator *a, skel_flat *out, svo_error *err)
{
    uint64_t points = 0, triangles = 0;
    memset(out, 0, sizeof *out);
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
        for (uint32_t k = 0; k < shape->part_count; k++) {
            points += shape->parts[k].vertex_count;
            triangles += shape->parts[k].triangle_count;
            if (points >= INT32_MAX || triangles >= INT32_MAX)
                return svo_fail(err, SVO_LIMIT, "the model has more than 2^31 vertices or triangles with its instances");
        }
    }
    if (triangles == 0) return svo_fail(err, SVO_INVALID_DATA, "the model has no triangles, so it has no skeleton");
    *out = (skel_flat){svo_alloc(a, 3 * points, sizeof *out->position), svo_alloc(a, 3 * triangles, sizeof *out->corner), points, triangles};
    if (out->position == NULL || out->corner == NULL) return skeli_no_memory(err);
    flatten(mesh, out->position, out->corner);
    return SVO_OK;
}

void skel_flat_free(skel_flat *f, const svo_allocator *a)
{
    svo_free(a, f->position, 3 * f->points, sizeof *f->position);
    svo_free(a, f->corner, 3 * f->triangles, sizeof *f->corner);
}

svo_result skel_build_mesh(const svo_mesh *mesh, const skel_options *options, skel_skeleton *out, svo_error *err)
{
    SVO_TRY(skeli_check_options(options, err));
    skel_flat f;
    svo_result result = skel_flat_make(mesh, options->allocator, &f, err);
    if (result == SVO_OK) result = skeli_pipeline(f.position, f.points, f.corner, f.triangles, options, out, err);
    skel_flat_free(&f, options->allocator);
    return result;
}

static svo_result quality_of(skeli_pool *pool, const skel_flat *f, const skel_skeleton *s, uint32_t threads, skel_quality *q, svo_error *err)
{
    skel_report r = {.omega = 0.0125, .normalize = SKEL_NORMALIZE_BALL};
    skeli_soup soup, mesh;
    skeli_surface surface = {0};
    uint32_t *remap = skeli_take(pool, f->points, sizeof *remap);
    if (remap == NULL) return skeli_no_memory(err);
    SVO_TRY(skeli_soup_make(pool, f->position, f->points, f->corner, f->triangles, &r, &soup, remap, err));
    uint32_t *moved = skeli_take(pool, soup.vertex_count, sizeof *moved);
    if (moved == NULL) return skeli_no_memory(err);
    SVO_TRY(skeli_tessellate(pool, &soup, r.omega * SKEL_LATTICE, UINT32_MAX / 2, &mesh, moved, err));
    svo_result result = skeli_surface_make(pool, &soup, f->position, f->points, f->corner, f->triangles, remap, &r, threads, &surface, err);
    if (result == SVO_OK) result = skeli_quality_of(pool, &surface, &mesh, s, r.centre, r.unit, threads, q, err);
    skeli_surface_free(&surface);
    return result;
}

svo_result skel_measure_quality(const svo_mesh *mesh, const skel_skeleton *s, uint32_t threads, const svo_allocator *a, skel_quality *out, svo_error *err)
{
    skel_flat f;
    skeli_pool pool = {.allocator = a};
    svo_result result = skel_flat_make(mesh, a, &f, err);
    if (result == SVO_OK) result = quality_of(&pool, &f, s, threads, out, err);
    skeli_pool_free(&pool);
    skel_flat_free(&f, a);
    return result;
}

svo_result skel_reconstruct(const svo_mesh *mesh, const skel_skeleton *s, const svo_allocator *a, skel_closed *out, svo_error *err)
{
    skel_flat f;
    svo_result result = skel_flat_make(mesh, a, &f, err);
    if (result == SVO_OK) result = skeli_reconstruct(f.position, f.points, f.corner, f.triangles, s, a, out, err);
    skel_flat_free(&f, a);
    return result;
}

svo_result skel_segments_make(const svo_mesh *mesh, const skel_skeleton *s, const svo_allocator *a, skel_segments *out, svo_error *err)
{
    skel_flat f;
    svo_result result = skel_flat_make(mesh, a, &f, err);
    if (result == SVO_OK && (s->report.source != SKEL_SOURCE_MESH || s->map_count != f.points))
        result = svo_fail(err, SVO_INVALID_ARGUMENT, "the skeleton was not built from this mesh");
    if (result == SVO_OK) result = skeli_segments(f.position, f.points, f.corner, f.triangles, s, a, out, err);
    skel_flat_free(&f, a);
    return result;
}
