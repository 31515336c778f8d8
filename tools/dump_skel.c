/* svo-dump of a .skel. */
#include "dump.h"

#include <string.h>

#include "fmt_skel.h"

enum { LISTED = 1000 }; /* joints and bones named one by one */

static void put_joints(json_t *o, const skel_skeleton *s)
{
    json_t *joints = json_array(), *bones = json_array();
    for (uint32_t i = 0; i < s->joint_count && i < LISTED; i++) {
        json_t *e = json_object();
        json_object_set_new(e, "position", dump_reals(s->joints[i].position, 3));
        cli_put_f64(e, "radius", s->joints[i].radius);
        cli_put_u64(e, "component", s->joints[i].component);
        json_array_append_new(joints, e);
    }
    for (uint32_t i = 0; i < s->bone_count && i < LISTED; i++) {
        json_t *e = json_object();
        cli_put_u64(e, "a", s->bones[i].a);
        cli_put_u64(e, "b", s->bones[i].b);
        json_array_append_new(bones, e);
    }
    json_object_set_new(o, "joints", joints);
    json_object_set_new(o, "bones", bones);
    json_object_set_new(o, "listed_in_full", json_boolean(s->joint_count <= LISTED && s->bone_count <= LISTED));
}

/* What every kind has in its JSON and a skeleton has not. */
static void put_absent(json_t *o)
{
    static const char *const keys[] = {"depth", "voxel_to_world", "nodes", "voxels", "bytes_per_voxel", "bytes_per_node"};
    for (size_t i = 0; i < sizeof keys / sizeof keys[0]; i++) json_object_set_new(o, keys[i], json_null());
    json_object_set_new(o, "levels", json_array());
    json_object_set_new(o, "attributes", json_array());
}

static void put_run(json_t *o, const skel_report *r)
{
    cli_put_text(o, "source", r->source == SKEL_SOURCE_VOXELS ? "voxels" : "mesh");
    cli_put_text(o, "method", r->method == SKEL_METHOD_LITERAL ? "literal" : "fast");
    cli_put_text(o, "normalisation", r->normalize == SKEL_NORMALIZE_BOX ? "box" : "ball");
    cli_put_text(o, "joints_at", r->place == SKEL_PLACE_CONTRACTED ? "contracted position" : r->place == SKEL_PLACE_INSIDE ? "middle of the solid" : "centroid");
    cli_put_f64(o, "omega", r->omega);
    cli_put_f64(o, "delta", r->delta);
    json_object_set_new(o, "centre", dump_reals(r->centre, 3));
    cli_put_f64(o, "unit", r->unit);
    json_object_set_new(o, "converged", json_boolean(r->converged));
    cli_put_u64(o, "iterations", r->iterations);
    cli_put_f64(o, "final_movement_sum", r->final_movement_sum);
    cli_put_f64(o, "final_movement_max", r->final_movement_max);
    cli_put_f64(o, "thinness_error", r->thinness_error);
    cli_put_f64(o, "surface_distance_mean", r->surface_distance_mean);
    cli_put_f64(o, "surface_distance_max", r->surface_distance_max);
    cli_put_f64(o, "reconstruction_mean", r->reconstruction_mean);
    cli_put_f64(o, "reconstruction_max", r->reconstruction_max);
    cli_put_u64(o, "tessellated_vertices", r->tessellated_vertices);
    cli_put_u64(o, "tessellated_triangles", r->tessellated_triangles);
    cli_put_u64(o, "components", r->components);
    cli_put_u64(o, "ends", r->ends);
    cli_put_u64(o, "branches", r->branches);
    cli_put_u64(o, "loops", r->loops);
    cli_put_u64(o, "isolated", r->isolated);
    cli_put_u64(o, "leftover_triangles", r->leftover_triangles);
    if (r->source == SKEL_SOURCE_VOXELS) {
        cli_put_u64(o, "contracted_level", r->voxel_level);
        cli_put_u64(o, "octree_depth", r->voxel_depth);
    }
}

svo_result dump_skel(dump_job *j, svo_error *err)
{
    if (j->voxels != NULL) return svo_fail(err, SVO_UNSUPPORTED, "a .skel holds no voxels; --voxels takes a .svo, .svdag or .svscene");
    skel_skeleton s;
    fmt_container c;
    char *provenance;
    SVO_TRY(fmt_container_open(j->data, j->size, j->allocator, &c, err));
    svo_result r = fmt_skel_read(j->data, j->size, j->allocator, &s, &provenance, err);
    if (r == SVO_OK) {
        dump_container(j, &c);
        cli_put_u64(j->json, "joint_count", s.joint_count);
        cli_put_u64(j->json, "bone_count", s.bone_count);
        cli_put_u64(j->json, "map_count", s.map_count);
        cli_put_u64(j->json, "mapped_count", s.report.mapped_count);
        put_absent(j->json);
        put_run(j->json, &s.report);
        put_joints(j->json, &s);
        dump_sections(j, &c);
        dump_provenance(j->json, provenance);
        svo_string_free(j->allocator, provenance);
        skel_skeleton_free(&s);
    }
    fmt_container_close(&c);
    return r;
}
