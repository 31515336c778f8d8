/* Bounds of posed instances, and scenes posed as a whole. */
#include <math.h>
#include <string.h>

#include "svo_deform.h"

static void join(double low[3], double high[3], const double l[3], const double h[3])
{
    for (int k = 0; k < 3; k++) {
        if (!(l[k] >= low[k])) low[k] = l[k];
        if (!(h[k] <= high[k])) high[k] = h[k];
    }
}

/* Pieces to cut a box into along each axis of the grid, so that none turns by more than half a radian. */
static void choose_pieces(const svo_deform *d, const double size[3], uint32_t pieces[3])
{
    enum { MOST = 32 };
    double turn[3] = {0, 0, 0};
    for (int part = 0; part < 2; part++) {
        if ((d->flags & (uint32_t)(part == 0 ? SVO_POSE_TWIST : SVO_POSE_BEND)) == 0) continue;
        const svo_slices *s = part == 0 ? &d->twist : &d->bend;
        for (int k = 0; k < 3; k++)
            turn[k] += fmin(fabs(s->angle), fabs(d->in.m[4 * s->axis + (uint32_t)k]) * size[k] / (s->to - s->from) * fabs(s->angle));
    }
    for (int k = 0; k < 3; k++) pieces[k] = turn[k] > 0.5 ? turn[k] < 0.5 * MOST ? (uint32_t)ceil(2 * turn[k]) : MOST : 1;
    while (pieces[0] * pieces[1] * pieces[2] > MOST)
        for (int k = 0; k < 3; k++) pieces[k] = (pieces[k] + 1) / 2;
}

/* Bounds of what bones make of an asset, through d->out: a point that follows several lies between its images under each. */
static void bone_bounds(const svo_deform *d, const svo_extent *e, double low[3], double high[3])
{
    double l[3], h[3];
    if (e->box == NULL) {
        svo_deform_blended_box(d, (svo_bone_list){NULL, 0}, e->low, e->high, low, high);
        return;
    }
    for (int k = 0; k < 3; k++) low[k] = INFINITY, high[k] = -INFINITY;
    for (uint32_t b = 0; b <= e->bones; b++) {
        const double *box = e->box + 6 * (uint64_t)b;
        if (!(box[0] < box[3])) continue;
        svo_deform_box(d, b < e->bones ? b : SVO_NO_BONE, box, box + 3, l, h);
        join(low, high, l, h);
    }
}

/* Bounds of a box under the rest of a pose, piece by piece. */
static void piece_bounds(const svo_deform *d, const double first[3], const double last[3], double low[3], double high[3])
{
    double size[3], l[3], h[3], from[3], to[3];
    uint32_t pieces[3], at[3];
    for (int k = 0; k < 3; k++) size[k] = last[k] - first[k], low[k] = INFINITY, high[k] = -INFINITY;
    choose_pieces(d, size, pieces);
    for (at[2] = 0; at[2] < pieces[2]; at[2]++)
        for (at[1] = 0; at[1] < pieces[1]; at[1]++)
            for (at[0] = 0; at[0] < pieces[0]; at[0]++) {
                for (int k = 0; k < 3; k++) {
                    from[k] = at[k] == 0 ? first[k] : first[k] + size[k] * at[k] / pieces[k];
                    to[k] = at[k] + 1 == pieces[k] ? last[k] : first[k] + size[k] * (at[k] + 1) / pieces[k];
                }
                svo_deform_box(d, SVO_NO_BONE, from, to, l, h);
                join(low, high, l, h);
            }
}

bool svo_deform_bounds(const svo_poses *poses, const svo_pose *pose, const svo_mat4 *grid_to_mesh, const svo_mat4 *mesh_to_target, const svo_extent *extent, double low[3],
                       double high[3])
{
    if (pose == NULL) {
        svo_mat4 m = svo_mat4_mul(*mesh_to_target, *grid_to_mesh);
        svo_box_transform(&m, extent->low, extent->high, 16, low, high);
    } else {
        svo_deform d = svo_deform_make(poses, pose, grid_to_mesh, mesh_to_target);
        bool slices = (d.flags & (SVO_POSE_TWIST | SVO_POSE_BEND)) != 0;
        if ((d.flags & SVO_POSE_BONES) == 0) piece_bounds(&d, extent->low, extent->high, low, high);
        else if (!slices) bone_bounds(&d, extent, low, high);
        else { /* twist and bend take what the bones have made */
            svo_deform bones = d;
            double l[3], h[3];
            bones.flags &= ~(uint32_t)(SVO_POSE_TWIST | SVO_POSE_BEND), bones.out = svo_mat4_identity();
            bone_bounds(&bones, extent, l, h);
            d.flags &= ~(uint32_t)SVO_POSE_BONES, d.in = svo_mat4_identity();
            piece_bounds(&d, l, h, low, high);
        }
    }
    for (int k = 0; k < 3; k++)
        if (!isfinite(low[k]) || !isfinite(high[k])) return false;
    return true;
}

bool svo_scene_instance_bounds(const svo_scene *s, uint32_t page, uint64_t instance, const svo_extent *extent, double low[3], double high[3])
{
    svo_mat4 grid, place = svo_scene_instance_transform(s, page, instance);
    memcpy(grid.m, s->assets[s->instance_asset[instance]]->voxel_to_world, sizeof grid.m);
    return svo_deform_bounds(&s->poses, svo_scene_instance_pose(s, instance), &grid, &place, extent, low, high);
}

svo_result svo_scene_extents(const svo_scene *s, const svo_allocator *a, svo_extent *out, svo_error *err)
{
    bool *bones = svo_calloc(a, s->asset_count, sizeof *bones);
    if (bones == NULL && s->asset_count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %u assets", s->asset_count);
    for (uint64_t i = 0; s->poses.matrix_count != 0 && i < s->instance_count; i++) {
        uint32_t pose = s->instance_pose != NULL ? s->instance_pose[i] : SVO_NO_POSE;
        if (pose < s->poses.count && s->instance_asset[i] < s->asset_count && (s->poses.pose[pose].flags & SVO_POSE_BONES) != 0) bones[s->instance_asset[i]] = true;
    }
    svo_result result = SVO_OK;
    uint32_t made = 0;
    for (; made < s->asset_count && result == SVO_OK; made++) result = svo_extent_make(s->assets[made], bones[made], a, &out[made], err);
    for (uint32_t i = 0; result != SVO_OK && i + 1 < made; i++) svo_extent_free(&out[i]);
    svo_free(a, bones, s->asset_count, sizeof *bones);
    return result;
}

struct svo_posed_scene {
    svo_scene scene;
    const svo_allocator *allocator;
    const svo_scene *source;
    svo_pose *pose;
    float *matrix;
    uint32_t *instance_pose;
    svo_scene_page *pages;
};

const svo_scene *svo_posed_scene_get(const svo_posed_scene *p) { return &p->scene; }

void svo_posed_scene_free(svo_posed_scene *p)
{
    if (p == NULL) return;
    svo_free(p->allocator, p->pose, p->source->asset_count, sizeof *p->pose);
    svo_free(p->allocator, p->matrix, 12, sizeof *p->matrix);
    svo_free(p->allocator, p->instance_pose, p->source->instance_count, sizeof *p->instance_pose);
    svo_free(p->allocator, p->pages, p->source->page_count, sizeof *p->pages);
    svo_free(p->allocator, p, 1, sizeof *p);
}

/* Boxes of the assets' voxels in the grid, 6 numbers each. */
static svo_result pose_assets(svo_posed_scene *p, const svo_pose *stated, const float matrix[12], svo_extent *extents, svo_error *err)
{
    const svo_scene *s = p->source;
    memcpy(p->matrix, matrix, 12 * sizeof *matrix);
    for (uint32_t i = 0; i < s->asset_count; i++) {
        double low[3], high[3];
        SVO_TRY(svo_extent_make(s->assets[i], false, p->allocator, &extents[i], err));
        if (s->assets[i]->empty)
            for (int k = 0; k < 3; k++) extents[i].high[k] = 1;
        svo_mat4 grid;
        memcpy(grid.m, s->assets[i]->voxel_to_world, sizeof grid.m);
        svo_box_transform(&grid, extents[i].low, extents[i].high, 0, low, high);
        for (int k = 0; k < 3; k++)
            if (!isfinite((float)low[k]) || !isfinite((float)high[k])) return svo_fail(err, SVO_LIMIT, "asset %u is too large to be deformed in single precision (3.4e38)", i);
        p->pose[i] = *stated;
        svo_pose_resolve(&p->pose[i], low, high);
        const char *fault = svo_pose_fault(&p->scene.poses, &p->pose[i]);
        if (fault != NULL) return svo_fail(err, SVO_INVALID_ARGUMENT, "the deformation cannot be used for asset %u: %s", i, fault);
    }
    return SVO_OK;
}

static void pose_pages(svo_posed_scene *p, const svo_extent *extents)
{
    const svo_scene *s = &p->scene;
    for (uint32_t g = 0; g < s->page_count; g++) {
        svo_scene_page *page = &p->pages[g];
        *page = p->source->pages[g];
        double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, l[3], h[3];
        for (uint64_t i = page->first; i < page->first + page->count; i++) {
            p->instance_pose[i] = s->instance_asset[i];
            if (svo_scene_instance_bounds(s, g, i, &extents[s->instance_asset[i]], l, h)) join(low, high, l, h);
        }
        if (!(low[0] <= high[0])) continue; /* nothing is finite: the bounds stay */
        memcpy(page->low, low, sizeof low);
        memcpy(page->high, high, sizeof high);
    }
}

svo_result svo_scene_pose_all(const svo_scene *s, const svo_pose *stated, const float matrix[12], const svo_allocator *a, svo_posed_scene **out, svo_error *err)
{
    svo_posed_scene *p = svo_calloc(a, 1, sizeof *p);
    if (p == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for poses");
    p->allocator = a;
    p->source = s;
    p->pose = svo_calloc(a, s->asset_count, sizeof *p->pose);
    p->matrix = svo_alloc(a, 12, sizeof *p->matrix);
    p->instance_pose = svo_alloc(a, s->instance_count, sizeof *p->instance_pose);
    p->pages = svo_alloc(a, s->page_count, sizeof *p->pages);
    svo_extent *extents = svo_calloc(a, s->asset_count, sizeof *extents); /* (without bones, they own nothing) */
    p->scene = *s;
    svo_result result = SVO_OK;
    if (p->matrix == NULL || (s->asset_count != 0 && (p->pose == NULL || extents == NULL)) || (s->instance_count != 0 && (p->instance_pose == NULL || p->pages == NULL)))
        result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for poses");
    if (result == SVO_OK && s->asset_count != 0) {
        p->scene.instance_pose = p->instance_pose;
        p->scene.pages = p->pages;
        p->scene.poses = (svo_poses){.count = s->asset_count, .pose = p->pose, .matrix_count = 1, .matrix = p->matrix};
        result = pose_assets(p, stated, matrix, extents, err);
    }
    if (result == SVO_OK) pose_pages(p, extents);
    svo_free(a, extents, s->asset_count, sizeof *extents);
    if (result != SVO_OK) {
        svo_posed_scene_free(p);
        return result;
    }
    *out = p;
    return SVO_OK;
}
