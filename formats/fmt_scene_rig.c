/* Skins and animations as poses: the bones of an asset, frames of them, and what is kept of both. */
#include <math.h>
#include <string.h>

#include "fmti_scene_build.h"

/* A bone that moves nothing of the mesh farther than this share of its extent rests: what rounding of the file's matrices makes. */
#define RESTING 4e-6
#define FRAME_FLOATS(r) (12 * (uint64_t)(r)->bone_count)

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the bones of a mesh"); }

void fmti_rigged_free(fmti_rigged *r)
{
    if (r == NULL) return;
    const svo_allocator *a = r->allocator;
    svo_free(a, r->bones, r->bone_count, sizeof *r->bones);
    svo_free(a, r->first_bone, r->mesh->instance_count, sizeof *r->first_bone);
    svo_free(a, r->world, r->rig->node_count, sizeof *r->world);
    svo_free(a, r->number, r->bone_count, sizeof *r->number);
    svo_buffer_free(&r->frames);
    memset(r, 0, sizeof *r);
}

static uint32_t rig_shape(const fmti_rigged *r, bool flat, uint32_t shape, uint32_t instance) { return flat ? r->mesh->instances[instance].shape : shape; }

/* Bones that vertices follow. */
static void mark_used(const fmt_rig_shape *shape, fmti_bone *bones)
{
    for (uint32_t p = 0; p < shape->part_count; p++) {
        const fmt_rig_part *part = &shape->parts[p];
        if (part->influences == NULL) bones[0].used = true;
        for (uint64_t i = 0; part->influences != NULL && i < part->vertex_count; i++)
            for (uint32_t k = 0; k < SVO_SKIN_BONES; k++)
                if (part->influences[i].weight[k] > 0) bones[part->influences[i].bone[k]].used = true;
    }
}

svo_result fmti_rigged_make(fmti_rigged *r, const fmt_rig *rig, const svo_mesh *mesh, bool flat, uint32_t shape, double extent, const svo_allocator *a, svo_error *err)
{
    memset(r, 0, sizeof *r);
    r->allocator = a, r->rig = rig, r->mesh = mesh, r->extent = extent, r->stretch = 1;
    r->after = svo_mat4_identity();
    svo_buffer_init(&r->frames, a);
    uint64_t count = 0;
    r->first_bone = svo_alloc(a, mesh->instance_count, sizeof *r->first_bone);
    r->world = svo_alloc(a, rig->node_count, sizeof *r->world);
    if ((r->first_bone == NULL && mesh->instance_count != 0) || (r->world == NULL && rig->node_count != 0)) return no_memory(err);
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        uint32_t skin = rig->shapes[rig_shape(r, flat, shape, i)].skin;
        r->first_bone[i] = (uint32_t)count;
        count += skin != SVO_NONE ? rig->skins[skin].joint_count : 1;
        if (count >= SVO_SKIN_REST) return svo_fail(err, SVO_LIMIT, "more than %u bones in one asset", SVO_SKIN_REST - 1);
    }
    r->bones = svo_calloc(a, count, sizeof *r->bones);
    r->number = svo_alloc(a, count, sizeof *r->number);
    r->bone_count = (uint32_t)count;
    if (count != 0 && (r->bones == NULL || r->number == NULL)) return no_memory(err);
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const fmt_rig_shape *s = &rig->shapes[rig_shape(r, flat, shape, i)];
        svo_mat4 inverse, place = s->skin != SVO_NONE ? fmt_rig_place(rig, s->skin) : mesh->instances[i].transform;
        fmti_bone *bone = &r->bones[r->first_bone[i]];
        bool invertible = svo_mat4_affine_inverse(&place, &inverse);
        if (s->skin == SVO_NONE) { /* what stands at the node's world goes with it: world at a time * (world now)^-1 */
            uint32_t node = rig->instance_node[i];
            fmt_rig_world(rig, SVO_NONE, 0, r->world);
            *bone = (fmti_bone){.skin = SVO_NONE, .joint = node, .used = true};
            if (!svo_mat4_affine_inverse(&r->world[node], &bone->back)) bone->joint = SVO_NONE; /* flat as it stands: there is nothing to move */
            continue;
        }
        if (!invertible) inverse = svo_mat4_identity();
        if (!flat) r->after = inverse;
        for (uint32_t j = 0; j < rig->skins[s->skin].joint_count; j++)
            bone[j] = (fmti_bone){.skin = s->skin, .joint = j, .back = flat ? inverse : svo_mat4_identity()};
        mark_used(s, bone);
    }
    return SVO_OK;
}

/* How far a matrix moves a corner of the mesh's bounds. */
static double moves(const float m[12], const double low[3], const double high[3])
{
    double most = 0;
    for (int c = 0; c < 8; c++) {
        double p[3] = {c & 1 ? high[0] : low[0], c & 2 ? high[1] : low[1], c & 4 ? high[2] : low[2]};
        for (int i = 0; i < 3; i++)
            most = fmax(most, fabs((double)m[4 * i] * p[0] + (double)m[4 * i + 1] * p[1] + (double)m[4 * i + 2] * p[2] + (double)m[4 * i + 3] - p[i]));
    }
    return most;
}

static svo_result store(const svo_mat4 *m, float to[12], svo_error *err)
{
    for (int k = 0; k < 12; k++) {
        to[k] = (float)m->m[k];
        if (!isfinite(to[k])) return svo_fail(err, SVO_INVALID_DATA, "a bone's matrix is not finite in single precision");
    }
    return SVO_OK;
}

static const float identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};

static float *new_frame(fmti_rigged *r, uint32_t *frame)
{
    *frame = r->bone_count == 0 ? 0 : (uint32_t)(r->frames.size / (FRAME_FLOATS(r) * sizeof(float)));
    float *m = svo_buffer_append(&r->frames, NULL, FRAME_FLOATS(r) * sizeof(float));
    for (uint32_t i = 0; m != NULL && i < r->bone_count; i++) memcpy(m + 12 * (uint64_t)i, identity, sizeof identity);
    return m;
}

svo_result fmti_rigged_frame(fmti_rigged *r, uint32_t animation, double time, uint32_t *frame, svo_error *err)
{
    float *to = new_frame(r, frame);
    if (to == NULL && r->bone_count != 0) return no_memory(err);
    fmt_rig_world(r->rig, animation, time, r->world);
    for (uint32_t i = 0; i < r->bone_count; i++) {
        const fmti_bone *b = &r->bones[i];
        if (b->joint == SVO_NONE) continue;
        svo_mat4 m = b->skin != SVO_NONE ? fmt_rig_joint(r->rig, b->skin, b->joint, r->world) : r->world[b->joint];
        m = svo_mat4_mul(r->after, svo_mat4_mul(m, b->back));
        SVO_TRY(store(&m, to + 12 * (uint64_t)i, err));
    }
    return SVO_OK;
}

svo_result fmti_rigged_stated(fmti_rigged *r, const float *matrices, uint32_t count, uint32_t *frame, svo_error *err)
{
    float *to = new_frame(r, frame);
    if (to == NULL && r->bone_count != 0) return no_memory(err);
    if (count > r->bone_count) return svo_fail(err, SVO_INVALID_DATA, "a pose has a bone %u, but the mesh has %u", count - 1, r->bone_count);
    memcpy(to, matrices, 12 * sizeof(float) * (uint64_t)count);
    return SVO_OK;
}

svo_result fmti_rigged_finish(fmti_rigged *r, svo_error *err)
{
    double low[3], high[3];
    uint64_t frames = r->bone_count == 0 ? 0 : r->frames.size / (FRAME_FLOATS(r) * sizeof(float));
    (void)err;
    bool any = svo_mesh_bounds(r->mesh, low, high);
    r->kept = r->moved = 0;
    for (uint32_t i = 0; i < r->bone_count; i++) {
        bool moved = false;
        for (uint64_t f = 0; f < frames && any; f++) {
            float *m = (float *)(void *)r->frames.data + f * FRAME_FLOATS(r) + 12 * (uint64_t)i;
            if (moves(m, low, high) > RESTING * r->extent) moved = true;
            else memcpy(m, identity, sizeof identity);
            if (!r->bones[i].used) continue;
            for (int k = 0; k < 3; k++) r->stretch = fmax(r->stretch, svo_length(svo_v3((double)m[k], (double)m[4 + k], (double)m[8 + k])));
        }
        r->moved += moved;
        r->number[i] = moved && r->bones[i].used ? (uint16_t)r->kept++ : (uint16_t)SVO_SKIN_REST;
    }
    return SVO_OK;
}

bool fmti_rigged_matrices(const fmti_rigged *r, uint32_t frame, svo_buffer *matrices)
{
    for (uint32_t i = 0; i < r->bone_count; i++) {
        const float *m = (const float *)(const void *)r->frames.data + frame * FRAME_FLOATS(r) + 12 * (uint64_t)i;
        if (r->number[i] != SVO_SKIN_REST && svo_buffer_append(matrices, m, 12 * sizeof *m) == NULL) return false;
    }
    return true;
}

/* ---- the mesh with its bones ------------------------------------------------------------------------------------------- */

void fmti_skin_free(fmti_skin *s)
{
    svo_free(s->allocator, s->positions, s->mesh.vertex_count, 3 * sizeof(double));
    svo_free(s->allocator, s->influences, s->mesh.vertex_count, sizeof(svo_influence));
    svo_free(s->allocator, s->indices, s->mesh.triangle_count, 3 * sizeof(uint32_t));
    memset(s, 0, sizeof *s);
}

static svo_influence influence_of(const fmti_rigged *r, const fmt_rig_part *part, uint64_t vertex, uint32_t first)
{
    svo_influence f = {{SVO_SKIN_REST, SVO_SKIN_REST, SVO_SKIN_REST, SVO_SKIN_REST}, {0}};
    if (part == NULL || part->influences == NULL) f.bone[0] = r->number[first], f.weight[0] = 1;
    else
        for (uint32_t k = 0; k < SVO_SKIN_BONES; k++) {
            f.weight[k] = part->influences[vertex].weight[k];
            if (f.weight[k] > 0) f.bone[k] = r->number[first + part->influences[vertex].bone[k]];
        }
    return f;
}

svo_result fmti_skin_make(const fmti_rigged *r, uint32_t shape, fmti_skin *out, svo_error *err)
{
    const svo_mesh *mesh = r->mesh;
    const svo_allocator *a = r->allocator;
    uint64_t vertices = 0, triangles = 0, v = 0, t = 0;
    memset(out, 0, sizeof *out);
    out->allocator = a;
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *s = &mesh->shapes[mesh->instances[i].shape];
        for (uint32_t p = 0; p < s->part_count; p++) vertices += s->parts[p].vertex_count, triangles += s->parts[p].triangle_count;
    }
    if (vertices >= UINT32_MAX || triangles >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "a mesh with bones has more than 2^32 vertices or triangles");
    out->positions = svo_alloc(a, vertices, 3 * sizeof(double));
    out->influences = svo_alloc(a, vertices, sizeof(svo_influence));
    out->indices = svo_alloc(a, triangles, 3 * sizeof(uint32_t));
    out->mesh = (svo_skin_mesh){vertices, triangles, out->positions, out->influences, out->indices};
    if ((vertices != 0 && (out->positions == NULL || out->influences == NULL)) || (triangles != 0 && out->indices == NULL)) {
        fmti_skin_free(out);
        return no_memory(err);
    }
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *s = &mesh->shapes[mesh->instances[i].shape];
        const fmt_rig_shape *bound = &r->rig->shapes[shape != SVO_NONE ? shape : mesh->instances[i].shape];
        for (uint32_t p = 0; p < s->part_count; p++) {
            const svo_part *part = &s->parts[p];
            const fmt_rig_part *rig_part = bound->skin != SVO_NONE ? &bound->parts[p] : NULL;
            for (uint64_t k = 0; k < 3 * part->triangle_count; k++) out->indices[t++] = part->indices[k] + (uint32_t)v;
            for (uint64_t k = 0; k < part->vertex_count; k++, v++) {
                const double *from = part->positions + 3 * k;
                svo_vec3 q = svo_mat4_point(&mesh->instances[i].transform, svo_v3(from[0], from[1], from[2]));
                out->positions[3 * v] = q.x, out->positions[3 * v + 1] = q.y, out->positions[3 * v + 2] = q.z;
                out->influences[v] = influence_of(r, rig_part, k, r->first_bone[i]);
            }
        }
    }
    return SVO_OK;
}

/* ---- poses ------------------------------------------------------------------------------------------------------------- */

svo_result fmti_scene_add_pose(fmt_scene_build *b, const fmti_entry *e, const svo_pose *stated, uint32_t frame, uint32_t *out, svo_error *err)
{
    uint64_t n = b->poses.size / sizeof(svo_pose);
    uint32_t of[2] = {(uint32_t)(e - b->entries), frame};
    svo_pose pose = *stated;
    pose.flags &= ~(uint32_t)SVO_POSE_BONES, pose.bone_first = pose.bone_count = 0;
    if (n >= UINT32_MAX - 1) return svo_fail(err, SVO_LIMIT, "more than 2^32 - 2 poses");
    if (svo_buffer_append(&b->poses, &pose, sizeof pose) == NULL || svo_buffer_append(&b->frames, of, sizeof of) == NULL) return no_memory(err);
    *out = (uint32_t)n + 1;
    return SVO_OK;
}

static const fmt_scene_json_clip *clip_of(const fmt_scene_json *j, uint32_t pose)
{
    uint64_t low = 0, count = j->clip_count;
    while (count > 1) {
        uint64_t half = count / 2;
        if (j->clips[low + half].pose <= pose) low += half;
        count -= half;
    }
    return count == 1 && j->clips[low].pose == pose ? &j->clips[low] : NULL;
}

/* The frame that a stated pose (number + 1, 0: none) asks for. */
static svo_result frame_of(fmt_scene_build *b, fmti_entry *e, uint32_t pose, uint32_t *frame, svo_error *err)
{
    const fmt_scene_json *j = &b->json;
    const fmt_scene_json_clip *clip = pose != 0 ? clip_of(j, pose - 1) : NULL;
    const svo_pose *stated = pose != 0 ? &j->poses.pose[pose - 1] : NULL;
    if (clip != NULL) {
        const char *name = clip->animation != 0 ? j->names + clip->animation : "0";
        uint32_t animation = fmt_rig_find(&e->rig, name);
        if (animation == SVO_NONE)
            return svo_fail(err, SVO_INVALID_DATA, "%.60s: there is no animation '%.60s', which a pose names; the file has %u", e->info.file, name, e->rig.animation_count);
        return fmti_rigged_frame(e->rigged, animation, clip->time, frame, err);
    }
    if (stated != NULL && (stated->flags & SVO_POSE_BONES) != 0)
        return fmti_rigged_stated(e->rigged, j->poses.matrix + 12 * (uint64_t)stated->bone_first, stated->bone_count, frame, err);
    return fmti_rigged_frame(e->rigged, SVO_NONE, 0, frame, err);
}

svo_result fmti_scene_resolve_poses(fmt_scene_build *b, svo_error *err)
{
    fmt_scene_json *j = &b->json;
    svo_place *places = (svo_place *)(void *)j->storage[1].data;
    bool any = false;
    for (uint32_t i = 0; i < b->count; i++) any = any || b->entries[i].rigged != NULL;
    if (!any) return SVO_OK;
    svo_pose none = svo_pose_stated();
    if (j->poses.count != 0 && svo_buffer_append(&b->poses, j->poses.pose, j->poses.count * sizeof none) == NULL) return no_memory(err);
    if (j->poses.matrix_count != 0 && svo_buffer_append(&b->matrices, j->poses.matrix, j->poses.matrix_count * 48) == NULL) return no_memory(err);
    if (svo_buffer_append(&b->frames, NULL, (size_t)j->poses.count * 8) == NULL && j->poses.count != 0) return no_memory(err);
    for (uint64_t i = 0; i < j->place_count; i++) {
        fmti_entry *e = &b->entries[places[i].asset];
        uint32_t pose = places[i].pose, frame;
        if (e->rigged == NULL) continue;
        if (e->pose_of == NULL) {
            e->pose_slots = (uint64_t)j->poses.count + 1;
            e->pose_of = svo_calloc(b->allocator, e->pose_slots, sizeof *e->pose_of);
            if (e->pose_of == NULL) return no_memory(err);
        }
        if (e->pose_of[pose] == 0) {
            SVO_TRY(frame_of(b, e, pose, &frame, err));
            SVO_TRY(fmti_scene_add_pose(b, e, pose != 0 ? &j->poses.pose[pose - 1] : &none, frame, &e->pose_of[pose], err));
        }
        places[i].pose = e->pose_of[pose];
    }
    return SVO_OK;
}

svo_result fmti_scene_finish_poses(fmt_scene_build *b, svo_error *err)
{
    uint64_t first = b->json.poses.count, count = b->poses.size / sizeof(svo_pose);
    for (uint32_t i = 0; i < b->count; i++) {
        fmti_entry *e = &b->entries[i];
        if (e->rigged == NULL) continue;
        SVO_TRY(fmti_rigged_finish(e->rigged, err));
        e->scale *= e->rigged->stretch;
        e->info.bones = e->rigged->bone_count, e->info.bones_kept = e->rigged->kept;
    }
    for (uint64_t i = first; i < count; i++) {
        svo_pose *pose = (svo_pose *)(void *)b->poses.data + i;
        const uint32_t *of = (const uint32_t *)(const void *)b->frames.data + 2 * i;
        const fmti_rigged *r = b->entries[of[0]].rigged;
        b->entries[of[0]].info.bones_left_out += r->bone_count - r->kept;
        if (r->kept == 0) continue;
        uint64_t matrix = b->matrices.size / 48;
        if (matrix + r->kept >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "the poses have more than 2^32 - 1 matrices");
        if (!fmti_rigged_matrices(r, of[1], &b->matrices)) return no_memory(err);
        pose->flags |= SVO_POSE_BONES;
        pose->bone_first = (uint32_t)matrix, pose->bone_count = r->kept;
    }
    if (count == 0) return SVO_OK;
    b->input.poses = (svo_poses){.count = (uint32_t)count, .pose = (const svo_pose *)(const void *)b->poses.data, .matrix_count = b->matrices.size / 48,
                                 .matrix = (const float *)(const void *)b->matrices.data};
    return SVO_OK;
}
