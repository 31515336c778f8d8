#include "svo_scene.h"

#include <float.h>
#include <math.h>
#include <string.h>

const char *svo_scene_instance_name(const svo_scene *s, uint64_t instance)
{
    return s->instance_name != NULL ? s->names + s->instance_name[instance] : "";
}

const svo_pose *svo_scene_instance_pose(const svo_scene *s, uint64_t instance)
{
    return s->instance_pose != NULL && s->instance_pose[instance] != SVO_NO_POSE ? &s->poses.pose[s->instance_pose[instance]] : NULL;
}

svo_mat4 svo_scene_instance_transform(const svo_scene *s, uint32_t page, uint64_t instance)
{
    const float *t = s->instance_transform + 12 * instance;
    svo_mat4 m = svo_mat4_identity();
    for (int i = 0; i < 12; i++) m.m[i] = t[i];
    for (int k = 0; k < 3; k++) m.m[4 * k + 3] += s->pages[page].origin[k];
    return m;
}

bool svo_scene_bounds(const svo_scene *s, double low[3], double high[3])
{
    for (int k = 0; k < 3; k++) low[k] = INFINITY, high[k] = -INFINITY;
    for (uint32_t p = 0; p < s->page_count; p++)
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], s->pages[p].low[k]);
            high[k] = fmax(high[k], s->pages[p].high[k]);
        }
    return s->page_count != 0;
}

void svo_box_transform(const svo_mat4 *m, const double low[3], const double high[3], double ulps, double out_low[3], double out_high[3])
{
    /* Interval arithmetic on the rows gives the exact bounds of an affine image of a box; the slack covers the rounding
     * of the products and sums, here and in whoever maps a point of the box. */
    for (int i = 0; i < 3; i++) {
        const double *r = m->m + 4 * i;
        double a = r[3], b = r[3], size = fabs(r[3]);
        for (int k = 0; k < 3; k++) {
            double p = r[k] * low[k], q = r[k] * high[k];
            a += fmin(p, q), b += fmax(p, q);
            size += fmax(fabs(p), fabs(q));
        }
        out_low[i] = a - ulps * DBL_EPSILON * size;
        out_high[i] = b + ulps * DBL_EPSILON * size;
    }
}

svo_result svo_scene_single(const svo_view *view, const char *name, const svo_allocator *a, svo_scene_one *s, svo_error *err)
{
    bool any;
    uint32_t low[3], high[3];
    SVO_TRY(svo_view_grid_bounds(view, a, &any, low, high, err));
    memset(s, 0, sizeof *s);
    s->view = view;
    s->asset_name = name;
    for (int k = 0; k < 3; k++) s->transform[5 * k] = 1;
    s->scene.asset_count = 1;
    s->scene.assets = &s->view;
    s->scene.asset_names = &s->asset_name;
    s->scene.names = "";
    s->scene.names_size = 1;
    if (!any) return SVO_OK;
    s->scene.instance_count = 1;
    s->scene.instance_asset = &s->asset;
    s->scene.instance_transform = s->transform;
    s->scene.instance_id = &s->id;
    s->scene.page_count = 1;
    s->scene.pages = &s->page;
    s->page.count = 1;
    svo_mat4 m;
    memcpy(m.m, view->voxel_to_world, sizeof m.m);
    double from[3], to[3];
    for (int k = 0; k < 3; k++) from[k] = low[k], to[k] = (double)high[k] + 1;
    svo_box_transform(&m, from, to, 16, s->page.low, s->page.high);
    return SVO_OK;
}
