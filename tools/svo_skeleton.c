/* svo-skeleton: the curve skeleton of a mesh or of voxels. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli.h"
#include "fmt_import.h"
#include "fmt_skel.h"
#include "fmt_svo.h"
#include "skel_bind.h"
#include "skel_solid.h"

static const char *const methods[] = {"fast", "literal", NULL};
static const char *const normalizations[] = {"ball", "box", NULL};
static const char *const searches[] = {"flann", "grid", NULL};
static const char *const places[] = {"centroid", "contracted", "inside", NULL};

enum { MAX_COMPONENTS = 256 }; /* in the report; all are counted */

typedef struct tool_options {
    double omega, delta;
    uint64_t max_iterations, max_vertices;
    int method, normalize, search, place;
    const char *glb, *obj, *swc;
    uint64_t influences, smoothing, solid_divide, draco;
    const char *bind, *bound, *solid, *reconstruct, *refine, *segments;
} tool_options;

static bool progress(void *user, double fraction)
{
    cli_progress(user, "contracting", fraction);
    return true;
}

static skel_options library_options(cli *c, const tool_options *o, const svo_allocator *a)
{
    skel_options s = skel_default_options();
    s.allocator = a;
    s.omega = o->omega;
    s.delta = o->delta;
    s.max_iterations = o->max_iterations;
    s.max_vertices = o->max_vertices;
    s.method = (skel_method)o->method;
    s.normalize = (skel_normalize)o->normalize;
    s.search = (skel_search)o->search;
    s.place = (skel_place)o->place;
    s.threads = (uint32_t)c->threads;
    s.keep_samples = o->bind != NULL;
    s.solid_divide = o->solid != NULL || o->reconstruct != NULL ? (uint32_t)o->solid_divide : 0;
    s.warnings = &c->warnings;
    s.progress = progress;
    s.user = c;
    return s;
}

/* --- input -------------------------------------------------------------------------------------------------------- */

static svo_result from_voxels(cli *c, fmt_input *in, const skel_options *o, skel_skeleton *out, json_t *inputs, svo_error *err)
{
    fmt_svo_reader *reader;
    SVO_TRY(fmt_svo_reader_open(in, o->allocator, &reader, err));
    svo_chunk_source source = fmt_svo_reader_source(reader);
    cli_phase(c, NULL); /* the library measures its own */
    svo_result r = skel_build_voxels(fmt_svo_reader_info(reader), &source, o, out, err);
    if (r == SVO_OK) {
        json_t *input = cli_section(c, "input");
        cli_put_text(input, "kind", "voxels");
        cli_put_u64(input, "depth", out->report.voxel_depth);
        cli_put_u64(input, "level_used", out->report.voxel_level);
        cli_put_text(input, "method", "outer boundary of the voxels at level_used as quads, welded at grid corners; enclosed space filled");
        cli_put_u64(input, "voxels", out->map_count);
        uint8_t hash[16];
        char hex[33];
        fmt_svo_reader_content_hash(reader, hash);
        fmt_hash_text(hash, hex);
        json_array_append_new(inputs, cli_provenance_input(c->inputs[0], hex));
    }
    fmt_svo_reader_close(reader);
    return r;
}

/* *mesh stays the caller's. */
static svo_result from_mesh(cli *c, const skel_options *o, bool textures, svo_mesh *mesh, skel_skeleton *out, json_t *inputs, svo_error *err)
{
    fmt_bytes bytes;
    char hash[33];
    SVO_TRY(fmt_bytes_open(c->inputs[0], 0, o->allocator, &bytes, err));
    fmt_hash_hex(bytes.data, bytes.size, hash);
    fmt_bytes_close(&bytes);
    json_array_append_new(inputs, cli_provenance_input(c->inputs[0], hash));
    fmt_import_options import = {.allocator = o->allocator, .threads = (uint32_t)c->threads, .skip_images = !textures, .warnings = &c->warnings};
    SVO_TRY(fmt_import_mesh(c->inputs[0], &import, mesh, err));
    svo_mesh_counts n = svo_mesh_count(mesh);
    json_t *input = cli_section(c, "input");
    cli_put_text(input, "kind", "mesh");
    cli_put_u64(input, "triangles", n.placed_triangles);
    cli_put_u64(input, "instances", mesh->instance_count);
    cli_phase(c, NULL);
    return skel_build_mesh(mesh, o, out, err);
}

static svo_result is_container(const char *path, bool *yes, svo_error *err)
{
    uint8_t start[64];
    size_t got;
    fmt_input *in;
    SVO_TRY(fmt_input_open(path, &in, err));
    svo_result r = fmt_input_read(in, start, sizeof start, &got, err);
    fmt_input_close(in);
    *yes = r == SVO_OK && fmt_container_kind(start, got) != 0;
    return r;
}

static svo_result build(cli *c, const skel_options *o, bool textures, svo_mesh *mesh, skel_skeleton *out, json_t *inputs, svo_error *err)
{
    const char *path = c->inputs[0];
    bool voxels = strcmp(path, "-") == 0; /* stdin is for our own formats */
    if (!voxels) SVO_TRY(is_container(path, &voxels, err));
    if (!voxels) return from_mesh(c, o, textures, mesh, out, inputs, err);
    fmt_input *in;
    SVO_TRY(fmt_input_open(path, &in, err));
    svo_result r = from_voxels(c, in, o, out, inputs, err);
    fmt_input_close(in);
    return r;
}

/* --- report ------------------------------------------------------------------------------------------------------- */

static void report_components(json_t *output, const skel_skeleton *s)
{
    skel_component *part = calloc(s->report.components, sizeof *part);
    json_t *list = json_array();
    if (part != NULL) skel_components(s, part);
    for (uint32_t i = 0; part != NULL && i < s->report.components && i < MAX_COMPONENTS; i++) {
        json_t *p = json_object();
        cli_put_u64(p, "joints", part[i].joints);
        cli_put_u64(p, "bones", part[i].bones);
        cli_put_u64(p, "ends", part[i].ends);
        cli_put_u64(p, "branches", part[i].branches);
        cli_put_u64(p, "loops", part[i].loops);
        json_array_append_new(list, p);
    }
    json_object_set_new(output, "component_list", list);
    free(part);
}

static void report_refined(cli *c, const skel_options *o)
{
    json_t *list = json_array();
    for (uint32_t i = 0; i < o->refine_count; i++) {
        const struct skel_refined *r = &o->refine[i].result;
        json_t *p = json_object();
        cli_put_f64(p, "omega", o->refine[i].omega);
        cli_put_u64(p, "bones_selected", r->bones);
        cli_put_u64(p, "joints_removed", r->joints_removed);
        cli_put_u64(p, "joints_added", r->joints_added);
        cli_put_u64(p, "links", r->links);
        cli_put_u64(p, "iterations", r->iterations);
        json_object_set_new(p, "converged", json_boolean(r->converged));
        cli_put_f64(p, "reconstruction_mean_before", r->error_before);
        cli_put_f64(p, "reconstruction_mean_after", r->error_after);
        json_array_append_new(list, p);
    }
    json_object_set_new(cli_section(c, "output"), "refined", list);
}

static void report(cli *c, const skel_skeleton *s, uint64_t bytes)
{
    const skel_report *r = &s->report;
    json_t *input = cli_section(c, "input"), *output = cli_section(c, "output"), *errors = cli_section(c, "errors");
    cli_put_u64(input, "elements", r->input_count);
    cli_put_u64(input, "mapped", r->mapped_count);
    cli_put_u64(input, "vertices_not_finite", r->not_finite);
    cli_put_u64(input, "vertices_unreferenced", r->unreferenced);
    cli_put_u64(input, "vertices_coincident", r->coincident);
    cli_put_u64(input, "triangles_dropped", r->dropped_triangles);
    cli_put_u64(input, "vertices", r->mesh_vertices);
    cli_put_u64(input, "vertices_tessellated", r->tessellated_vertices);
    cli_put_u64(input, "triangles_tessellated", r->tessellated_triangles);
    cli_put_f64(input, "unit", r->unit);

    cli_put_u64(output, "bytes", bytes);
    json_object_set_new(output, "converged", json_boolean(r->converged));
    cli_put_u64(output, "iterations", r->iterations);
    cli_put_f64(output, "final_movement_sum", r->final_movement_sum);
    cli_put_f64(output, "final_movement_max", r->final_movement_max);
    cli_put_u64(output, "joints", s->joint_count);
    cli_put_u64(output, "bones", s->bone_count);
    cli_put_u64(output, "components", r->components);
    cli_put_u64(output, "ends", r->ends);
    cli_put_u64(output, "branches", r->branches);
    cli_put_u64(output, "loops", r->loops);
    cli_put_u64(output, "isolated_joints", r->isolated);
    cli_put_u64(output, "leftover_triangles", r->leftover_triangles);
    report_components(output, s);

    cli_put_f64(errors, "thinness_percent", r->thinness_error);
    cli_put_text(errors, "distance_unit", "percent of the bounding box's diagonal");
    cli_put_f64(errors, "surface_distance_mean", r->surface_distance_mean);
    cli_put_f64(errors, "surface_distance_max", r->surface_distance_max);
    cli_put_f64(errors, "reconstruction_mean", r->reconstruction_mean);
    cli_put_f64(errors, "reconstruction_max", r->reconstruction_max);

    const skel_quality *q = &r->quality;
    cli_put_u64(input, "surface_components", q->surface_components);
    cli_put_u64(input, "surface_closed_components", q->surface_closed);
    json_object_set_new(input, "genus", q->genus_known ? json_integer((json_int_t)q->genus) : json_null());
    cli_put_u64(errors, "curve_samples", q->samples);
    cli_put_f64(errors, "joints_inside_percent", q->joints_inside);
    cli_put_f64(errors, "length_inside_percent", q->length_inside);
    cli_put_f64(errors, "outside_max", q->outside_max);
    cli_put_f64(errors, "off_centre_median", q->off_centre_median);
    cli_put_f64(errors, "off_centre_p95", q->off_centre_p95);
    cli_put_f64(errors, "inscribed_balls_mean", q->balls_mean);
    cli_put_f64(errors, "inscribed_balls_max", q->balls_max);

    json_t *phases = json_object_get(c->json, "phases");
    for (uint32_t i = 0; i < r->phase_count; i++) {
        json_t *p = json_object();
        cli_put_text(p, "name", r->phases[i].name);
        cli_put_f64(p, "seconds", r->phases[i].seconds);
        json_array_append_new(phases, p);
    }
    cli_info(c, "%u joints, %u bones, %u ends, %u branches, %u loops in %u component%s; %s after %llu sweeps, thinness error %.3g %%", s->joint_count, s->bone_count,
             r->ends, r->branches, r->loops, r->components, r->components == 1 ? "" : "s", r->converged ? "converged" : "NOT converged",
             (unsigned long long)r->iterations, r->thinness_error);
    char genus[48] = "surface not closed";
    if (q->genus_known) snprintf(genus, sizeof genus, "surface of genus %llu", (unsigned long long)q->genus);
    cli_info(c, "%s; %.1f %% of the curve inside, off centre %.2f (median), reconstruction error %.2f %% of the diagonal", genus, q->length_inside, q->off_centre_median,
             q->balls_mean);
}

/* --- output ------------------------------------------------------------------------------------------------------- */

typedef struct outputs { fmt_output *skel, *glb, *obj, *swc, *bound, *solid, *closed, *segments; } outputs;

/* All are opened before any work is done, so that a wrong path costs no time. */
static svo_result open_all(const cli *c, const tool_options *o, outputs *out, svo_error *err)
{
    SVO_TRY(fmt_output_open(c->output, c->force, &out->skel, err));
    if (o->glb != NULL) SVO_TRY(fmt_output_open(o->glb, c->force, &out->glb, err));
    if (o->obj != NULL) SVO_TRY(fmt_output_open(o->obj, c->force, &out->obj, err));
    if (o->swc != NULL) SVO_TRY(fmt_output_open(o->swc, c->force, &out->swc, err));
    if (o->bound != NULL) SVO_TRY(fmt_output_open(o->bound, c->force, &out->bound, err));
    if (o->solid != NULL) SVO_TRY(fmt_output_open(o->solid, c->force, &out->solid, err));
    if (o->segments != NULL) SVO_TRY(fmt_output_open(o->segments, c->force, &out->segments, err));
    if (o->reconstruct != NULL) SVO_TRY(fmt_output_open(o->reconstruct, c->force, &out->closed, err));
    return SVO_OK;
}

static svo_result commit(fmt_output **out, svo_error *err)
{
    fmt_output *o = *out;
    *out = NULL;
    return o != NULL ? fmt_output_commit(o, err) : SVO_OK;
}

/* Of a mesh, the .glb is the mesh with its joints and weights; voxels have none, so it is the curve. */
static svo_result write_glb(cli *c, const tool_options *o, fmt_output *out, const svo_mesh *mesh, const skel_skeleton *s, const skel_tree *tree, svo_error *err)
{
    if (s->report.source != SKEL_SOURCE_MESH) return fmt_export_skel_glb(out, s, err);
    skel_skin skin;
    const skel_skin_options k = {.influences = (uint32_t)o->influences, .smoothing = (uint32_t)o->smoothing, .allocator = s->allocator};
    SVO_TRY(skel_skin_make(mesh, s, tree, &k, &skin, err));
    fmt_draco_report d;
    svo_result r = fmt_export_skinned_glb(out, mesh, s, tree, &skin, (uint32_t)o->draco, &d, &c->warnings, err);
    json_t *output = cli_section(c, "output");
    if (r == SVO_OK && o->draco > 0) {
        json_t *j = json_object();
        cli_put_u64(j, "bits", o->draco);
        cli_put_u64(j, "bytes_plain", d.plain_bytes);
        cli_put_u64(j, "bytes", d.bytes);
        cli_put_text(j, "errors", d.measured ? "measured on what a decoder gives" : "bounds of the quantization");
        cli_put_f64(j, "position_error_max", d.position_error);
        cli_put_f64(j, "normal_error_max_degrees", d.normal_error);
        cli_put_f64(j, "uv_error_max", d.uv_error);
        cli_put_f64(j, "color_error_max", d.color_error);
        cli_put_f64(j, "weight_error_max", d.weight_error);
        json_object_set_new(output, "draco", j);
    }
    cli_put_u64(output, "skin_influences", skin.most);
    skel_skin_free(&skin);
    return r;
}

/* The octree of --bind with a bone for every value; its provenance is this run's. */
static svo_result bind_octree(cli *c, const tool_options *o, fmt_input *in, fmt_output *out, const skel_skeleton *s, const char *provenance, skel_bind_report *report,
                              svo_error *err)
{
    fmt_svo_reader *reader = NULL;
    fmt_svo_writer *writer = NULL;
    skel_binder *binder = NULL;
    svo_tree_info info;
    svo_result r = fmt_svo_reader_open(in, s->allocator, &reader, err);
    if (r == SVO_OK) r = skel_bind_info(s, fmt_svo_reader_info(reader), &info, err);
    if (r == SVO_OK) r = skel_binder_create(s, s->allocator, &binder, err);
    if (r == SVO_OK) r = fmt_svo_writer_begin(out, &info, provenance, 0, s->allocator, &writer, err);
    if (r == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(reader);
        svo_chunk_sink sink = fmt_svo_writer_sink(writer);
        r = skel_bind_octree(binder, fmt_svo_reader_info(reader), &source, &info, &sink, (uint32_t)c->threads, s->allocator, report, err);
    }
    if (r == SVO_OK && fmt_svo_reader_shard(reader) != NULL) r = svo_fail(err, SVO_UNSUPPORTED, "it is a shard of an octree; join the shards with svo-merge first");
    if (r == SVO_OK) {
        r = fmt_svo_writer_end(writer, NULL, err);
        writer = NULL;
    }
    fmt_svo_writer_discard(writer);
    skel_binder_free(binder);
    if (reader != NULL) fmt_svo_reader_close(reader);
    return cli_about(o->bind, r, err);
}

static svo_result write_bound(cli *c, const tool_options *o, fmt_output *out, const skel_skeleton *s, const char *provenance, svo_error *err)
{
    fmt_input *in;
    skel_bind_report report;
    SVO_TRY(fmt_input_open(o->bind, &in, err));
    svo_result r = bind_octree(c, o, in, out, s, provenance, &report, err);
    fmt_input_close(in);
    if (r != SVO_OK) return r;
    json_t *b = json_object();
    cli_put_u64(b, "bytes", fmt_output_offset(out));
    cli_put_u64(b, "values", report.counts.values);
    cli_put_u64(b, "bones_used", report.bones_used);
    cli_put_u64(b, "unbound", report.unbound);
    cli_put_f64(b, "sample_distance_mean_voxels", report.distance_mean);
    cli_put_f64(b, "sample_distance_max_voxels", report.distance_max);
    json_object_set_new(cli_section(c, "output"), "bound", b);
    return SVO_OK;
}

static svo_result write_solid(cli *c, fmt_output *out, const skel_skeleton *s, const char *provenance, svo_error *err)
{
    svo_tree_info info;
    fmt_svo_writer *writer;
    svo_tree_counts counts;
    SVO_TRY(skel_solid_info(s, &info, err));
    SVO_TRY(fmt_svo_writer_begin(out, &info, provenance, 0, s->allocator, &writer, err));
    svo_chunk_sink sink = fmt_svo_writer_sink(writer);
    svo_result r = skel_solid_stream(s, &sink, s->allocator, NULL, err);
    if (r != SVO_OK) {
        fmt_svo_writer_discard(writer);
        return r;
    }
    SVO_TRY(fmt_svo_writer_end(writer, &counts, err));
    json_t *j = json_object();
    cli_put_u64(j, "bytes", fmt_output_offset(out));
    cli_put_u64(j, "depth", s->solid.depth);
    cli_put_f64(j, "voxel_size", s->solid.voxel_to_world[0]);
    cli_put_u64(j, "voxels", s->solid.count);
    cli_put_u64(j, "voxels_passed", s->solid.swept);
    cli_put_u64(j, "voxels_filled", s->solid.filled);
    cli_put_u64(j, "full_leaves", counts.full_leaves);
    json_object_set_new(cli_section(c, "output"), "solid", j);
    return SVO_OK;
}

static svo_result write_closed(cli *c, fmt_output *out, const svo_mesh *mesh, const skel_skeleton *s, svo_error *err)
{
    skel_closed closed;
    if (s->report.source != SKEL_SOURCE_MESH) return svo_fail(err, SVO_UNSUPPORTED, "--reconstruct closes the holes of a mesh; this input is voxels");
    SVO_TRY(skel_reconstruct(mesh, s, s->allocator, &closed, err));
    svo_result r = fmt_export_closed_ply(out, &closed, err);
    json_t *j = json_object();
    cli_put_u64(j, "vertices", closed.vertex_count);
    cli_put_u64(j, "triangles", closed.triangle_count);
    cli_put_u64(j, "vertices_invented", closed.invented_count);
    json_object_set_new(cli_section(c, "output"), "reconstruction", j);
    skel_closed_free(&closed);
    return r;
}

static svo_result write_segments(cli *c, fmt_output *out, const svo_mesh *mesh, const skel_skeleton *s, svo_error *err)
{
    skel_segments g;
    if (s->report.source != SKEL_SOURCE_MESH) return svo_fail(err, SVO_UNSUPPORTED, "--segments colours the triangles of a mesh; of voxels, --bind gives each its bone");
    SVO_TRY(skel_segments_make(mesh, s, s->allocator, &g, err));
    svo_result r = fmt_export_segments_ply(out, &g, err);
    json_t *j = json_object(), *list = json_array();
    cli_put_u64(j, "bytes", fmt_output_offset(out));
    cli_put_u64(j, "segments", g.count);
    cli_put_u64(j, "colors", g.color_count);
    cli_put_u64(j, "islands_moved", g.islands);
    uint64_t apart = 0;
    for (uint32_t i = 0; i < g.count; i++) {
        const skel_segment *k = &g.segment[i];
        apart += k->pieces > 1;
        if (i >= MAX_COMPONENTS) continue;
        json_t *o = json_object();
        char color[8];
        snprintf(color, sizeof color, "#%06x", k->color & 0xffffff);
        cli_put_u64(o, "first_joint", k->first);
        cli_put_u64(o, "last_joint", k->last);
        cli_put_u64(o, "bones", k->bones);
        cli_put_u64(o, "triangles", k->triangles);
        cli_put_f64(o, "area", k->area);
        cli_put_u64(o, "pieces", k->pieces);
        cli_put_text(o, "color", color);
        json_array_append_new(list, o);
    }
    cli_put_u64(j, "segments_in_pieces", apart);
    json_object_set_new(j, "list", list);
    json_object_set_new(cli_section(c, "output"), "segmentation", j);
    skel_segments_free(&g);
    return r;
}

static svo_result write_all(cli *c, const tool_options *o, outputs *out, const svo_mesh *mesh, const skel_skeleton *s, const char *provenance, uint64_t *bytes, svo_error *err)
{
    SVO_TRY(fmt_skel_write(out->skel, s, provenance, err));
    skel_tree tree;
    SVO_TRY(skel_tree_make(s, s->allocator, &tree, err));
    json_t *output = cli_section(c, "output");
    cli_put_u64(output, "roots", tree.root_count);
    cli_put_u64(output, "bones_outside_trees", tree.loop_count);
    svo_result r = SVO_OK;
    if (out->glb != NULL) r = write_glb(c, o, out->glb, mesh, s, &tree, err);
    if (r == SVO_OK && out->swc != NULL) r = fmt_export_skel_swc(out->swc, s, &tree, err);
    skel_tree_free(&tree);
    if (r == SVO_OK && out->obj != NULL) r = fmt_export_skel_obj(out->obj, s, err);
    if (r == SVO_OK && out->bound != NULL) {
        cli_phase(c, "bind");
        r = write_bound(c, o, out->bound, s, provenance, err);
        cli_phase(c, "write");
    }
    if (r == SVO_OK && out->solid != NULL) r = write_solid(c, out->solid, s, provenance, err);
    if (r == SVO_OK && out->closed != NULL) r = write_closed(c, out->closed, mesh, s, err);
    if (r == SVO_OK && out->segments != NULL) r = write_segments(c, out->segments, mesh, s, err);
    if (r != SVO_OK) return r;
    *bytes = fmt_output_offset(out->skel);
    SVO_TRY(commit(&out->solid, err));
    SVO_TRY(commit(&out->closed, err));
    SVO_TRY(commit(&out->segments, err));
    SVO_TRY(commit(&out->glb, err));
    SVO_TRY(commit(&out->obj, err));
    SVO_TRY(commit(&out->swc, err));
    SVO_TRY(commit(&out->bound, err));
    return commit(&out->skel, err);
}

static svo_result run(cli *c, const tool_options *o, svo_error *err)
{
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, c->memory != 0 ? c->memory : UINT64_MAX, NULL);
    outputs out = {0};
    json_t *inputs = json_array();
    skel_skeleton s = {0};
    svo_mesh mesh = {0};
    skel_options options = library_options(c, o, &limit.base);
    svo_result r = o->refine != NULL ? skel_refine_parse(o->refine, &limit.base, &options.refine, &options.refine_count, err) : SVO_OK;
    if (r == SVO_OK) r = open_all(c, o, &out, err);
    if (r == SVO_OK) {
        cli_phase(c, "import");
        r = cli_about(c->inputs[0], build(c, &options, o->glb != NULL, &mesh, &s, inputs, err), err);
    }
    if (r == SVO_OK) {
        json_t *how = json_object();
        cli_put_f64(how, "omega", o->omega);
        cli_put_f64(how, "delta", o->delta);
        cli_put_u64(how, "max_iterations", o->max_iterations);
        cli_put_text(how, "method", methods[o->method]);
        cli_put_text(how, "normalize", normalizations[o->normalize]);
        cli_put_text(how, "place", places[o->place]);
        if (o->refine != NULL) cli_put_text(how, "refine", o->refine);
        char *provenance = cli_provenance(c, how, json_incref(inputs));
        uint64_t bytes = 0;
        cli_phase(c, "write");
        r = provenance == NULL ? svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory") : write_all(c, o, &out, &mesh, &s, provenance, &bytes, err);
        cli_phase(c, NULL);
        free(provenance);
        if (r == SVO_OK) report(c, &s, bytes);
        if (r == SVO_OK && options.refine_count > 0) report_refined(c, &options);
    }
    skel_skeleton_free(&s);
    skel_refine_free(&limit.base, options.refine, options.refine_count);
    svo_mesh_free(&mesh);
    fmt_output_discard(out.skel);
    fmt_output_discard(out.glb);
    fmt_output_discard(out.obj);
    fmt_output_discard(out.swc);
    fmt_output_discard(out.bound);
    fmt_output_discard(out.solid);
    fmt_output_discard(out.closed);
    fmt_output_discard(out.segments);
    json_decref(inputs);
    if (r == SVO_OUT_OF_MEMORY && c->memory != 0) r = svo_fail(err, SVO_LIMIT, "--memory is too small for this model and omega");
    return r;
}

int main(int argc, char **argv)
{
    tool_options o = {.omega = skel_default_options().omega, .max_iterations = 6000, .max_vertices = 8000000, .influences = 4, .smoothing = 8, .solid_divide = 2, .place = SKEL_PLACE_INSIDE};
    cli_option options[] = {
        {.name = "omega", .letter = 'w', .kind = CLI_DOUBLE, .value = &o.omega, .argument = "W", .min = SKEL_MIN_OMEGA, .max = SKEL_MAX_OMEGA,
         .help = "Feature size, as a part of the model's size: what is thinner is merged. 0.0125 keeps fingers, 0.025 is enough for limbs and several times as fast."},
        {.name = "delta", .kind = CLI_DOUBLE, .value = &o.delta, .argument = "D", .min = 0, .max = 1e9,
         .help = "Stop when the movements of all vertices in a sweep sum up to less (0.05 in the thesis); 0: when no vertex moves by omega/1000 for 8 sweeps."},
        {.name = "max-iterations", .kind = CLI_U64, .value = &o.max_iterations, .argument = "N", .min = 1, .max = 1e9,
         .help = "Sweeps after which to stop, converged or not; a warning and the report say so."},
        {.name = "max-vertices", .kind = CLI_U64, .value = &o.max_vertices, .argument = "N", .min = 1, .max = 2e9,
         .help = "Most vertices that the mesh may have when its edges have been cut to omega (about 600 bytes each)."},
        {.name = "method", .kind = CLI_CHOICE, .value = &o.method, .choices = methods, .argument = "M",
         .help = "fast: vertices that have met are welded on the way; literal: the thesis' iteration on every vertex."},
        {.name = "normalize", .kind = CLI_CHOICE, .value = &o.normalize, .choices = normalizations, .argument = "N",
         .help = "The model's size: diameter of its enclosing ball / 1.15, which no rotation changes, or longest side of its box."},
        {.name = "search", .kind = CLI_CHOICE, .value = &o.search, .choices = searches, .argument = "S", .help = "Neighbour search; both give the same result."},
        {.name = "place", .kind = CLI_CHOICE, .value = &o.place, .choices = places, .argument = "P",
         .help = "inside: joints in the middle of the solid, ends out to the tips, bones kept inside; centroid: of the surface that belongs to them; contracted: where they were contracted to."},
        {.name = "refine", .kind = CLI_TEXT, .value = &o.refine, .argument = "BONES@W", .no_default = true,
         .help = "Make these bones again with omega W: 3,7-12 (numbers without refinement), ends, thin:R, ball:X,Y,Z,R or box:X0,Y0,Z0,X1,Y1,Z1; several with ; between."},
        {.name = "glb", .kind = CLI_TEXT, .value = &o.glb, .argument = "OUT.glb", .no_default = true, .group = "Output",
         .help = "Write the mesh with joints and weights as skinned glTF too (of voxels: the curve as lines)."},
        {.name = "obj", .kind = CLI_TEXT, .value = &o.obj, .argument = "OUT.obj", .no_default = true, .group = "Output", .help = "Write the curve as OBJ lines too."},
        {.name = "swc", .kind = CLI_TEXT, .value = &o.swc, .argument = "OUT.swc", .no_default = true, .group = "Output", .help = "Write the curve as trees with radii (SWC) too."},
        {.name = "influences", .kind = CLI_U64, .value = &o.influences, .argument = "N", .min = 1, .max = SKEL_MAX_INFLUENCES, .group = "Output",
         .help = "Joints that may move a vertex of the skinned .glb."},
        {.name = "draco", .kind = CLI_U64, .value = &o.draco, .max = 24, .argument = "BITS", .group = "Output",
         .help = "Compress the mesh of the skinned .glb by Draco, positions to 8 to 24 bits; the report has the errors. 0: not."},
        {.name = "smoothing", .kind = CLI_U64, .value = &o.smoothing, .argument = "N", .max = 1000, .group = "Output",
         .help = "Rounds in which a vertex's weights are averaged with its neighbours'."},
        {.name = "bind", .kind = CLI_TEXT, .value = &o.bind, .argument = "IN.svo", .no_default = true, .group = "Output",
         .help = "Give the voxels of this octree, which lies where the model lies, a channel with their bone."},
        {.name = "bound", .kind = CLI_TEXT, .value = &o.bound, .argument = "OUT.svo", .no_default = true, .group = "Output", .help = "Where --bind writes the octree."},
        {.name = "solid", .kind = CLI_TEXT, .value = &o.solid, .argument = "OUT.svo", .no_default = true, .group = "Output", .help = "Write an octree of what the surface encloses, holes or not: every voxel that it passes while it is contracted."},
        {.name = "reconstruct", .kind = CLI_TEXT, .value = &o.reconstruct, .argument = "OUT.ply", .no_default = true, .group = "Output", .help = "Write a closed surface of the mesh, its holes filled, as PLY."},
        {.name = "segments", .kind = CLI_TEXT, .value = &o.segments, .argument = "OUT.ply", .no_default = true, .group = "Output",
         .help = "Write the mesh as PLY with a colour for each branch of the curve."},
        {.name = "solid-divide", .kind = CLI_U64, .value = &o.solid_divide, .min = 1, .max = 64, .argument = "N", .group = "Output",
         .help = "Voxels of --solid and --reconstruct along an edge of omega."},
    };
    cli_tool tool = {
        .name = "svo-skeleton",
        .summary = "Contract a mesh or voxels to a curve skeleton with a map from every vertex or voxel to its joint.",
        .synopsis = "IN -o OUT.skel [--omega W] [options]",
        .options = options,
        .option_count = sizeof options / sizeof *options,
        .details = "IN is a .gltf .glb .obj .ply .stl .off .drc mesh of any quality (open, unshared, non-manifold, in parts), or a .svo (- is stdin).",
        .example = "svo-skeleton horse.ply -o horse.skel --omega 0.025 --glb horse_curve.glb\nsvo-skeleton scan.svo -o scan.skel --omega 0.05",
        .min_inputs = 1,
        .max_inputs = 1,
        .has_output = true,
    };
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    if (c.output == NULL) return cli_usage(&c, "-o OUT.skel is needed");
    if (o.draco != 0 && (o.draco < 8 || o.glb == NULL)) return cli_usage(&c, o.glb == NULL ? "--draco compresses the mesh of --glb, which is not given" : "--draco takes 8 to 24 bits, or 0");
    if ((o.bind == NULL) != (o.bound == NULL)) return cli_usage(&c, "--bind IN.svo and --bound OUT.svo need each other");
    const char *const files[] = {c.output, o.glb, o.obj, o.swc, o.bound, o.solid, o.reconstruct, o.segments};
    for (int i = 0; i < (int)(sizeof files / sizeof *files); i++)
        for (int k = 0; k < i; k++)
            if (files[i] != NULL && files[k] != NULL && strcmp(files[i], files[k]) == 0) return cli_usage(&c, "two outputs name the same file, %s", files[i]);
    svo_error err = {0};
    svo_result r = run(&c, &o, &err);
    return cli_end(&c, r, &err);
}
