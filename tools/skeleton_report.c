/* svo-skeleton: what its report and its last lines say. */
#include <stdio.h>
#include <stdlib.h>

#include "skeleton.h"

static void report_components(json_t *output, const skel_skeleton *s)
{
    skel_component *part = calloc(s->report.components, sizeof *part);
    json_t *list = json_array();
    if (part != NULL) skel_components(s, part);
    for (uint32_t i = 0; part != NULL && i < s->report.components && i < SKELETON_MAX_LISTED; i++) {
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

void skeleton_report_refined(cli *c, const skel_options *o)
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

void skeleton_report(cli *c, const skel_skeleton *s, uint64_t bytes)
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
    cli_put_u64(output, "contracted_loops", r->contracted_loops);
    cli_put_u64(output, "contracted_components", r->contracted_components);
    json_object_set_new(output, "rebuilt", json_boolean(r->rebuilt));
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
