/* svo-skeleton: the files it writes, and what the report says of each. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_svo.h"
#include "skel_bind.h"
#include "skel_solid.h"
#include "skeleton.h"

svo_result skeleton_open_outputs(const cli *c, const skeleton_options *o, skeleton_outputs *out, svo_error *err)
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
static svo_result write_glb(cli *c, const skeleton_options *o, fmt_output *out, const svo_mesh *mesh, const skel_skeleton *s, const skel_tree *tree, svo_error *err)
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
static svo_result bind_octree(cli *c, const skeleton_options *o, fmt_input *in, fmt_output *out, const skel_skeleton *s, const char *provenance, skel_bind_report *report,
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

static svo_result write_bound(cli *c, const skeleton_options *o, fmt_output *out, const skel_skeleton *s, const char *provenance, svo_error *err)
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
    cli_put_f64(j, "model_distance_mean", closed.distance_mean);
    cli_put_f64(j, "model_distance_max", closed.distance_max);
    cli_put_f64(j, "model_distance_mean_percent_of_unit", 100 * closed.distance_mean / s->report.unit);
    cli_put_f64(j, "model_distance_max_percent_of_unit", 100 * closed.distance_max / s->report.unit);
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
        if (i >= SKELETON_MAX_LISTED) continue;
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

svo_result skeleton_write(cli *c, const skeleton_options *o, skeleton_outputs *out, const skeleton_input *in, const skel_skeleton *s, const char *provenance, uint64_t *bytes,
                          svo_error *err)
{
    SVO_TRY(fmt_skel_write(out->skel, s, provenance, err));
    skel_tree tree;
    SVO_TRY(skel_tree_make(s, s->allocator, &tree, err));
    json_t *output = cli_section(c, "output");
    cli_put_u64(output, "roots", tree.root_count);
    cli_put_u64(output, "bones_outside_trees", tree.loop_count);
    svo_result r = SVO_OK;
    if (out->glb != NULL) r = write_glb(c, o, out->glb, &in->mesh, s, &tree, err);
    if (r == SVO_OK && out->swc != NULL) r = fmt_export_skel_swc(out->swc, s, &tree, err);
    skel_tree_free(&tree);
    if (r == SVO_OK && out->obj != NULL) r = fmt_export_skel_obj(out->obj, s, err);
    if (r == SVO_OK && out->bound != NULL) {
        cli_phase(c, "bind");
        r = write_bound(c, o, out->bound, s, provenance, err);
        cli_phase(c, "write");
    }
    if (r == SVO_OK && out->solid != NULL) r = write_solid(c, out->solid, s, provenance, err);
    if (r == SVO_OK && out->closed != NULL) r = write_closed(c, out->closed, in->is_prepared ? &in->prepared.mesh : &in->mesh, s, err);
    if (r == SVO_OK && out->segments != NULL) r = write_segments(c, out->segments, &in->mesh, s, err);
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

void skeleton_discard_outputs(skeleton_outputs *out)
{
    fmt_output_discard(out->skel);
    fmt_output_discard(out->glb);
    fmt_output_discard(out->obj);
    fmt_output_discard(out->swc);
    fmt_output_discard(out->bound);
    fmt_output_discard(out->solid);
    fmt_output_discard(out->closed);
    fmt_output_discard(out->segments);
}
