/* A million instances in one place: packed, indexed, selected, deformed and drawn, in memory that is a multiple of their number. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "svo_bvh.h"
#include "svo_morton.h"
#include "svo_pack.h"
#include "svo_resample.h"
#include "test.h"

enum { MILLION = 1000000 };

typedef struct crowd {
    svo_view *view;
    svo_pose *poses;
    svo_limit_allocator limit;
    svo_packed_scene *packed;
} crowd;

/* poses: 0, 1 for all, or one each. */
static void crowd_make(crowd *c, uint32_t poses)
{
    svo_error err = {0};
    const char *names[] = {"a"};
    packer_options po = {.lod = true, .unnumbered = true};
    memset(c, 0, sizeof *c);
    c->view = packer_make(1, (uint64_t[]){0, 3, 5, 6}, 4, &po);
    svo_place *places = calloc(MILLION, sizeof *places);
    c->poses = calloc(poses + 1, sizeof *c->poses);
    for (uint32_t i = 0; i < poses; i++) {
        c->poses[i] = svo_pose_stated();
        c->poses[i].flags = SVO_POSE_TWIST, c->poses[i].twist_axis = 1, c->poses[i].twist_angle = (float)(0.5 + 1e-6 * i);
    }
    svo_mat4 m = svo_mat4_trs((double[3]){3, 4, 5}, (double[4]){0, 0, 0, 1}, (double[3]){1, 1, 1});
    for (uint32_t i = 0; i < MILLION; i++) {
        memcpy(places[i].transform, m.m, sizeof places[i].transform);
        places[i].id = i;
        places[i].pose = poses == 0 ? 0 : poses == 1 ? 1 : i + 1;
    }
    const svo_view *views[] = {c->view};
    svo_pack_input in = {.asset_count = 1, .assets = views, .asset_names = names, .place_count = MILLION, .places = places, .poses = {.count = poses, .pose = c->poses}};
    svo_limit_allocator_init(&c->limit, UINT64_MAX, NULL);
    svo_pack_options o = {.allocator = &c->limit.base};
    CHECK_OK(svo_pack(&in, &o, &c->packed, &err));
    free(places);
    const svo_scene *s = svo_packed_scene_get(c->packed);
    CHECK_U64(s->instance_count, MILLION);
    CHECK_U64(s->page_count, (MILLION + 1023) / 1024);
    CHECK_U64(s->poses.count, poses);
    /* about 100 bytes an instance beside the result's 64, and poses of their own with a table of numbers */
    CHECK_MSG(svo_limit_peak(&c->limit) < (uint64_t)MILLION * (poses <= 1 ? 180 : 330), "%.1f bytes an instance", (double)svo_limit_peak(&c->limit) / MILLION);
}

static void crowd_free(crowd *c)
{
    svo_packed_scene_free(c->packed);
    packer_free(c->view);
    free(c->poses);
}

static svo_select_options looking(void)
{
    svo_select_options o = {.width = 96, .height = 64, .delta = 8, .frustum = true, .occlusion = true};
    svo_error err;
    if (svo_eye_look(svo_v3(29, 24, 42), svo_v3(4, 5, 6), svo_v3(0, 1, 0), 0.8, &o.eye, &err) != SVO_OK) abort();
    return o;
}

static void draw(const svo_selection *s, const svo_select_options *o, uint64_t *shown)
{
    static uint32_t owner[96 * 64];
    static float depth[96 * 64];
    svo_error err = {0};
    CHECK_OK(svo_select_draw(s, o, SVO_DRAW_BOXES, owner, depth, &err));
    *shown = 0;
    for (uint32_t i = 0; i < 96 * 64; i++) *shown += owner[i] != UINT32_MAX;
}

TEST(a_million_instances_in_one_place)
{
    svo_error err = {0};
    crowd c;
    crowd_make(&c, 0);
    if (test_failed()) return;
    svo_bvh *bvh;
    svo_bvh_report r;
    CHECK_OK(svo_bvh_build(svo_packed_scene_get(c.packed), 0, NULL, NULL, &bvh, &r, &err));
    CHECK_U64(r.placed, 1);
    CHECK_U64(r.duplicates, MILLION - 1);
    svo_scene_ray ray = {.origin = svo_v3(3.5, 4.5, -10), .direction = svo_v3(0, 0, 1), .t_max = INFINITY};
    svo_scene_hit hit;
    svo_scene_trace(bvh, &ray, 1, &hit);
    CHECK(hit.node.hit && hit.node.t == 15);
    svo_bvh_free(bvh);
    crowd_free(&c);
}

/* With one pose: one of them is deformed. Each with a twist of its own, all in one place: all are, and nothing runs over. */
TEST(a_million_posed_instances_in_one_place)
{
    svo_error err = {0};
    for (uint32_t poses = 1; poses <= MILLION; poses += MILLION - 1) {
        crowd c;
        uint64_t shown = 0;
        crowd_make(&c, poses);
        if (test_failed()) return;
        svo_select_options o = looking();
        svo_selection s;
        CHECK_OK(svo_select(svo_packed_scene_get(c.packed), &o, &s, &err));
        CHECK_U64(s.report.instances, poses);
        CHECK(s.report.overflowed == 0 && s.count >= 1);
        if (poses == 1) CHECK(s.report.visited < 12);
        draw(&s, &o, &shown);
        CHECK_MSG(shown > 4, "%llu samples", (unsigned long long)shown);
        svo_selection_free(&s);
        crowd_free(&c);
    }
}
