/* Scenes and skeletons: both must be valid; then their chunks are compared. */
#include <math.h>
#include <string.h>

#include "compare.h"
#include "fmt_scene.h"
#include "fmt_skel.h"

/* Prove that the file is sound, as any other tool would before using it. A skeleton is kept for measuring. */
static svo_result validate(compare_job *j, const compare_input *in, skel_skeleton *skeleton, svo_error *err)
{
    if (in->kind == FMT_KIND_SKEL) return fmt_skel_read(in->bytes.data, in->bytes.size, j->allocator, skeleton, NULL, err);
    if (in->kind == FMT_KIND_SCENE) {
        fmt_scene scene;
        SVO_TRY(fmt_scene_open(in->bytes.data, in->bytes.size, j->allocator, &scene, err));
        fmt_scene_close(&scene);
        return SVO_OK;
    }
    return svo_fail(err, SVO_UNSUPPORTED, "files of this kind cannot be compared");
}

static double length_of(const skel_skeleton *s)
{
    double sum = 0;
    for (uint32_t i = 0; i < s->bone_count; i++) {
        const double *p = s->joints[s->bones[i].a].position, *q = s->joints[s->bones[i].b].position;
        sum += sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) + (p[2] - q[2]) * (p[2] - q[2]));
    }
    return sum;
}

/* Joints are numbered in a fixed order, so equal runs give equal numbers; distances are between joints of one number. */
static void compare_skeletons(compare_job *j, const skel_skeleton *a, const skel_skeleton *b)
{
    json_t *o = json_object();
    const skel_skeleton *both[2] = {a, b};
    for (int i = 0; i < 2; i++) {
        json_t *side = json_object_get(j->json, i == 0 ? "a" : "b");
        cli_put_u64(side, "joints", both[i]->joint_count);
        cli_put_u64(side, "bones", both[i]->bone_count);
        cli_put_u64(side, "mapped", both[i]->map_count);
        const skel_report *r = &both[i]->report;
        cli_put_f64(side, "omega", r->omega);
        json_object_set_new(side, "converged", json_boolean(r->converged));
        cli_put_u64(side, "components", r->components);
        cli_put_u64(side, "ends", r->ends);
        cli_put_u64(side, "branches", r->branches);
        cli_put_u64(side, "loops", r->loops);
        cli_put_f64(side, "length", length_of(both[i]));
        cli_put_f64(side, "thinness_percent", r->thinness_error);
        cli_put_f64(side, "surface_distance_mean", r->surface_distance_mean);
        cli_put_f64(side, "reconstruction_mean", r->reconstruction_mean);
    }
    if (a->joint_count == b->joint_count) {
        double sum = 0, max = 0;
        for (uint32_t i = 0; i < a->joint_count; i++) {
            const double *p = a->joints[i].position, *q = b->joints[i].position;
            double d = sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) + (p[2] - q[2]) * (p[2] - q[2]));
            sum += d;
            if (d > max) max = d;
        }
        cli_put_f64(o, "joint_distance_mean", a->joint_count > 0 ? sum / a->joint_count : 0);
        cli_put_f64(o, "joint_distance_max", max);
    }
    bool same_bones = a->bone_count == b->bone_count;
    for (uint32_t i = 0; same_bones && i < a->bone_count; i++)
        same_bones = a->bones[i].a == b->bones[i].a && a->bones[i].b == b->bones[i].b;
    json_object_set_new(o, "same_bones", json_boolean(same_bones));
    skel_distance d;
    skel_curve_distance(a, b, &d);
    double unit = a->report.unit, omega = a->report.omega * unit;
    cli_put_f64(o, "curve_distance_mean", fmax(d.mean[0], d.mean[1]));
    cli_put_f64(o, "curve_distance_mean_a_to_b", d.mean[0]);
    cli_put_f64(o, "curve_distance_mean_b_to_a", d.mean[1]);
    cli_put_f64(o, "hausdorff", fmax(d.max[0], d.max[1]));
    cli_put_f64(o, "hausdorff_percent_of_unit", 100 * fmax(d.max[0], d.max[1]) / unit);
    cli_put_f64(o, "curve_distance_mean_percent_of_unit", 100 * fmax(d.mean[0], d.mean[1]) / unit);
    cli_put_f64(o, "curve_distance_mean_omegas", fmax(d.mean[0], d.mean[1]) / omega);
    if (a->map_count == b->map_count) {
        uint64_t moved = 0;
        for (uint64_t i = 0; i < a->map_count; i++) moved += a->map[i] != b->map[i];
        cli_put_u64(o, "map_different", moved);
    }
    json_object_set_new(j->json, "skeleton", o);
}

static json_t *chunk_json(const fmt_chunk *chunk, const char *state)
{
    char type[5];
    fmt_fourcc_text(chunk->type, type);
    json_t *o = json_object();
    cli_put_text(o, "type", type);
    cli_put_u64(o, "id", chunk->id);
    cli_put_text(o, "state", state);
    return o;
}

enum { MOST_LISTED = 100 };

/* Chunks that only one has, or whose bytes differ. META says how a file was made and does not count. */
static void compare_chunks(compare_job *j, const fmt_container *a, const fmt_container *b)
{
    json_t *list = json_array();
    uint64_t different = 0;
    for (int pass = 0; pass < 2; pass++) {
        const fmt_container *from = pass == 0 ? a : b, *other = pass == 0 ? b : a;
        for (uint32_t i = 0; i < from->chunk_count; i++) {
            const fmt_chunk *chunk = &from->chunks[i];
            if (chunk->type == FMT_FOURCC('M', 'E', 'T', 'A')) continue;
            /* files of one writer have the same chunks in the same order, so the other's is most often at i */
            const fmt_chunk *twin = i < other->chunk_count ? &other->chunks[i] : NULL;
            if (twin == NULL || twin->type != chunk->type || twin->id != chunk->id)
                twin = fmt_container_find(other, chunk->type, false, chunk->id);
            const char *state = twin == NULL ? (pass == 0 ? "only in A" : "only in B") : "different";
            if (twin != NULL && (pass == 1 || (twin->hash == chunk->hash && twin->stored_size == chunk->stored_size))) continue;
            if (different++ < MOST_LISTED) json_array_append_new(list, chunk_json(chunk, state));
        }
    }
    if (different == 0 && memcmp(a->content_hash, b->content_hash, sizeof a->content_hash) != 0) different = 1; /* another order */
    json_object_set_new(j->json, "identical", json_boolean(different == 0));
    json_object_set_new(j->json, "chunks", list);
    cli_put_u64(j->json, "different_chunks", different);
    if (different > 0) compare_reason(j, "%llu chunks differ", (unsigned long long)different);
}

svo_result compare_containers(compare_job *j, svo_error *err)
{
    fmt_container c[2];
    skel_skeleton skeleton[2];
    memset(c, 0, sizeof c);
    memset(skeleton, 0, sizeof skeleton);
    svo_result r = SVO_OK;
    for (int i = 0; i < 2 && r == SVO_OK; i++) {
        compare_input *in = &j->in[i];
        r = compare_load(in, j->c, j->allocator, err);
        if (r == SVO_OK) r = fmt_container_open(in->bytes.data, in->bytes.size, j->allocator, &c[i], err);
        if (r == SVO_OK) r = validate(j, in, &skeleton[i], err);
        r = cli_about(in->path, r, err);
    }
    if (r == SVO_OK) compare_chunks(j, &c[0], &c[1]);
    if (r == SVO_OK && j->in[0].kind == FMT_KIND_SKEL) compare_skeletons(j, &skeleton[0], &skeleton[1]);
    for (int i = 0; i < 2; i++) {
        fmt_container_close(&c[i]);
        skel_skeleton_free(&skeleton[i]);
    }
    return r;
}
