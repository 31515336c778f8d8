/* A scene made by hand, to look at: octrees, instances of them, and the hierarchy. */
#ifndef STAGE_H
#define STAGE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "svo_bvh.h"
#include "test.h"

enum { MAX_ASSETS = 4 };
typedef struct stage {
    svo_scene scene;
    svo_view *views[MAX_ASSETS];
    const svo_view *view_list[MAX_ASSETS];
    const char *names[MAX_ASSETS];
    uint32_t *asset, *name;
    float *transform;
    uint64_t *id;
    svo_scene_page pages[64];
    svo_bvh *bvh;
    svo_bvh_report report;
    svo_warnings warnings;
} stage;

static void stage_begin(stage *s, uint64_t instances)
{
    memset(s, 0, sizeof *s);
    s->asset = calloc(instances + 1, 4), s->name = calloc(instances + 1, 4), s->id = calloc(instances + 1, 8);
    s->transform = calloc(12 * instances + 1, 4);
    s->scene.instance_asset = s->asset, s->scene.instance_name = s->name, s->scene.instance_id = s->id;
    s->scene.instance_transform = s->transform, s->scene.names = "", s->scene.names_size = 1;
    s->scene.assets = s->view_list, s->scene.asset_names = s->names, s->scene.pages = s->pages;
}

static void stage_asset(stage *s, svo_view *v)
{
    s->views[s->scene.asset_count] = v, s->view_list[s->scene.asset_count] = v, s->names[s->scene.asset_count] = "";
    s->scene.asset_count++;
}

static void stage_instance(stage *s, uint32_t asset, const svo_mat4 *m)
{
    uint64_t i = s->scene.instance_count++;
    s->asset[i] = asset, s->id[i] = i;
    for (int k = 0; k < 12; k++) s->transform[12 * i + (uint64_t)k] = (float)m->m[k];
}

/* Into `pages` pages of equal size; bounds are those of the instances' grids. Page p has its origin at x = shift * p. */
static bool stage_build(stage *s, uint32_t pages, double shift, uint32_t threads)
{
    svo_error err;
    s->scene.page_count = s->scene.instance_count == 0 ? 0 : pages;
    for (uint32_t p = 0; p < s->scene.page_count; p++) {
        svo_scene_page *g = &s->pages[p];
        g->first = s->scene.instance_count * p / pages;
        g->count = s->scene.instance_count * (p + 1) / pages - g->first;
        g->origin[0] = shift * p;
        for (int k = 0; k < 3; k++) g->low[k] = INFINITY, g->high[k] = -INFINITY;
        for (uint64_t i = g->first; i < g->first + g->count; i++) {
            svo_mat4 m = svo_scene_instance_transform(&s->scene, p, i), v;
            memcpy(v.m, s->view_list[s->asset[i]]->voxel_to_world, sizeof v.m);
            m = svo_mat4_mul(m, v);
            for (int c = 0; c < 8; c++) {
                double n = ldexp(1, (int)s->view_list[s->asset[i]]->depth);
                svo_vec3 q = svo_mat4_point(&m, svo_v3(c & 1 ? n : 0, c & 2 ? n : 0, c & 4 ? n : 0));
                double x[3] = {q.x, q.y, q.z};
                for (int k = 0; k < 3; k++)
                    if (isfinite(x[k])) g->low[k] = fmin(g->low[k], x[k]), g->high[k] = fmax(g->high[k], x[k]);
            }
        }
    }
    svo_result r = svo_bvh_build(&s->scene, threads, NULL, &s->warnings, &s->bvh, &s->report, &err);
    if (r != SVO_OK) test_fail(__FILE__, __LINE__, "svo_bvh_build: %s", err.message);
    return r == SVO_OK;
}

static void stage_end(stage *s)
{
    svo_bvh_free(s->bvh);
    for (uint32_t i = 0; i < s->scene.asset_count; i++) packer_free(s->views[i]);
    free(s->asset), free(s->name), free(s->transform), free(s->id);
    memset(s, 0, sizeof *s);
}

#endif
