/* svo-skeleton: reading a mesh or voxels, preparing them, and building the skeleton. */
#include <string.h>

#include "fmt_import.h"
#include "fmt_svo.h"
#include "skeleton.h"

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

static void report_repair(cli *c, const skel_prepared *p, const skel_repair_report *r)
{
    json_t *j = json_object();
    cli_put_text(j, "by", "CGAL");
    cli_put_u64(j, "points_merged", p->merged);
    cli_put_u64(j, "points_unused", r->points_unused);
    cli_put_u64(j, "triangles_not_finite", p->not_finite);
    cli_put_u64(j, "triangles_degenerate", r->triangles_degenerate);
    cli_put_u64(j, "triangles_duplicate", r->triangles_duplicate);
    cli_put_u64(j, "triangles_turned", r->triangles_turned);
    cli_put_u64(j, "edges_nonmanifold", r->edges_nonmanifold);
    cli_put_u64(j, "vertices_nonmanifold", r->vertices_nonmanifold);
    cli_put_u64(j, "points_added", r->points_added);
    json_object_set_new(j, "manifold", json_boolean(r->manifold));
    json_object_set_new(cli_section(c, "input"), "repair", j);
}

/* A copy of the mesh, changed by other people's code; from it the skeleton, whose map is that of the mesh. */
static svo_result from_prepared(cli *c, const skeleton_options *o, const skel_options *library, const svo_limit_allocator *memory, skeleton_input *in, skel_skeleton *out, svo_error *err)
{
    skel_prepared *p = &in->prepared;
    in->is_prepared = true;
    SVO_TRY(skel_prepare(&in->mesh, library->allocator, p, err));
    uint64_t left = 0; /* of --memory, for what does not come from the allocator */
    if (memory != NULL) left = memory->limit > svo_limit_in_use(memory) ? memory->limit - svo_limit_in_use(memory) : 1;
    if (o->repair == REPAIR_CGAL) {
        skel_repair_report r;
        cli_phase(c, "repair");
        SVO_TRY(skel_repair_cgal(p, left, &r, err));
        report_repair(c, p, &r);
    }
    if (o->tessellate == TESSELLATE_OPENMESH) {
        skel_split_report r;
        double unit;
        cli_phase(c, "split");
        SVO_TRY(skel_prepared_unit(p, library->normalize, &unit, err));
        SVO_TRY(skel_split_openmesh(p, library->omega * unit, library->max_vertices, left, &r, err));
        json_t *j = json_object();
        cli_put_text(j, "by", "OpenMesh");
        cli_put_u64(j, "splits", r.splits);
        cli_put_u64(j, "triangles_apart", r.triangles_apart);
        json_object_set_new(cli_section(c, "input"), "tessellation", j);
    }
    cli_phase(c, NULL);
    SVO_TRY(skel_build_mesh(&p->mesh, library, out, err));
    return skel_prepared_map(p, out, err);
}

static svo_result from_mesh(cli *c, const skeleton_options *o, const skel_options *library, const svo_limit_allocator *memory, skeleton_input *in, skel_skeleton *out, svo_error *err)
{
    fmt_bytes bytes;
    char hash[33];
    SVO_TRY(fmt_bytes_open(c->inputs[0], 0, library->allocator, &bytes, err));
    fmt_hash_hex(bytes.data, bytes.size, hash);
    fmt_bytes_close(&bytes);
    json_array_append_new(in->provenance, cli_provenance_input(c->inputs[0], hash));
    fmt_import_options import = {.allocator = library->allocator, .threads = (uint32_t)c->threads, .skip_images = o->glb == NULL, .warnings = &c->warnings};
    SVO_TRY(fmt_import_mesh(c->inputs[0], &import, &in->mesh, err));
    cli_turn_mesh(&o->axes, &in->mesh);
    svo_mesh_counts n = svo_mesh_count(&in->mesh);
    json_t *input = cli_section(c, "input");
    cli_put_text(input, "kind", "mesh");
    cli_put_u64(input, "triangles", n.placed_triangles);
    cli_put_u64(input, "instances", in->mesh.instance_count);
    if (o->repair != REPAIR_OWN || o->tessellate != TESSELLATE_OWN) return from_prepared(c, o, library, memory, in, out, err);
    cli_phase(c, NULL); /* the library measures its own */
    return skel_build_mesh(&in->mesh, library, out, err);
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

svo_result skeleton_build(cli *c, const skeleton_options *o, const skel_options *library, const svo_limit_allocator *memory, skeleton_input *in, skel_skeleton *out, svo_error *err)
{
    const char *path = c->inputs[0];
    bool voxels = strcmp(path, "-") == 0; /* stdin is for our own formats */
    if (!voxels) SVO_TRY(is_container(path, &voxels, err));
    if (!voxels) return from_mesh(c, o, library, memory, in, out, err);
    if (cli_axes_given(&o->axes)) return svo_fail(err, SVO_UNSUPPORTED, "--up and --unit are for meshes; this input is voxels");
    if (o->repair != REPAIR_OWN || o->tessellate != TESSELLATE_OWN)
        return svo_fail(err, SVO_UNSUPPORTED, "%s works on the triangles of a mesh; this input is voxels", o->repair != REPAIR_OWN ? "--repair" : "--tessellate");
    fmt_input *file;
    SVO_TRY(fmt_input_open(path, &file, err));
    svo_result r = from_voxels(c, file, library, out, in->provenance, err);
    fmt_input_close(file);
    return r;
}

void skeleton_input_free(skeleton_input *in)
{
    skel_prepared_free(&in->prepared);
    svo_mesh_free(&in->mesh);
    json_decref(in->provenance);
}
