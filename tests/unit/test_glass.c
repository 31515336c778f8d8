/* Voxels that cover a part of what is behind them, deformed: what a picture lets through is what the coverage says, however boxes and cells overlap. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "svo_bvh.h"
#include "svo_morton.h"
#include "svo_resample.h"
#include "test.h"

enum { DEPTH = 5, SIDE = 1 << DEPTH, W = 64, H = 64 };

/* One or two sheets of voxels that meet a plane at right angles to n. */
typedef struct sheet {
    svo_vec3 n;
    uint8_t coverage;
    double apart; /* of the second one, in voxels; 0: one */
} sheet;

static void value_of(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    const sheet *s = user;
    const float n[3] = {(float)s->n.x, (float)s->n.y, (float)s->n.z};
    (void)x, (void)y, (void)z;
    if (channel == 0) svo_oct32_encode(n, out);
    else if (channel == 1) out[0] = s->coverage;
    else out[0] = 255, out[1] = 128, out[2] = 0;
}

static svo_view *make(const sheet *s)
{
    uint64_t *codes = malloc(8 * SIDE * SIDE * SIDE), n = 0;
    const double reach = 0.5 * (fabs(s->n.x) + fabs(s->n.y) + fabs(s->n.z));
    for (uint32_t z = 0; z < SIDE; z++)
        for (uint32_t y = 0; y < SIDE; y++)
            for (uint32_t x = 0; x < SIDE; x++) {
                const double from = (x + 0.5 - SIDE / 2) * s->n.x + (y + 0.5 - SIDE / 2) * s->n.y + (z + 0.5 - SIDE / 2) * s->n.z - 0.31;
                if (fabs(from) <= reach || (s->apart != 0 && fabs(from - s->apart) <= reach)) codes[n++] = svo_morton_encode(x, y, z);
            }
    packer_options o = {.lod = true, .channel_count = 3, .value = value_of, .user = (void *)(uintptr_t)s};
    strcpy(o.channels[0].name, "normal"), o.channels[0].kind = SVO_KIND_NORMAL_OCT32;
    strcpy(o.channels[1].name, "coverage"), o.channels[1].kind = SVO_KIND_UNORM8;
    strcpy(o.channels[2].name, "color"), o.channels[2].kind = SVO_KIND_COLOR_SRGB8;
    svo_view *v = packer_make(DEPTH, codes, n, &o);
    free(codes);
    return v;
}

/* The picture is a window into the middle of the sheet, seen 25 degrees off its normal. */
typedef struct window {
    svo_view *view;
    svo_scene_one one;
    svo_scene scene;
    uint32_t pose_number;
    svo_pose pose;
    svo_render_options look;
} window;

static void window_make(window *w, const sheet *s, const double q[4], double twist, double bend)
{
    svo_error err;
    w->view = make(s);
    CHECK_OK(svo_scene_single(w->view, "", NULL, &w->one, &err));
    const double size[3] = {1, 1, 1};
    double middle[3];
    svo_mat4 m = svo_mat4_trs((double[3]){0, 0, 0}, q, size);
    for (int k = 0; k < 3; k++) middle[k] = m.m[4 * k] * 16 + m.m[4 * k + 1] * 16 + m.m[4 * k + 2] * 16;
    for (int k = 0; k < 3; k++) m.m[4 * k + 3] = -middle[k];
    for (int i = 0; i < 12; i++) w->one.transform[i] = (float)m.m[i];
    for (int k = 0; k < 3; k++) w->one.page.low[k] = -100, w->one.page.high[k] = 100;
    w->scene = w->one.scene;
    w->pose_number = 0;
    w->scene.instance_pose = &w->pose_number;
    w->pose = svo_pose_stated();
    if (twist != 0) w->pose.flags |= SVO_POSE_TWIST, w->pose.twist_axis = 0, w->pose.twist_angle = (float)twist;
    if (bend != 0) w->pose.flags |= SVO_POSE_BEND, w->pose.bend_axis = 0, w->pose.bend_towards = 2, w->pose.bend_angle = (float)bend;
    svo_pose_resolve(&w->pose, (double[3]){0, 0, 0}, (double[3]){SIDE, SIDE, SIDE});
    w->scene.poses = (svo_poses){.count = 1, .pose = &w->pose};
    svo_vec3 n = svo_v3(m.m[0] * s->n.x + m.m[1] * s->n.y + m.m[2] * s->n.z, m.m[4] * s->n.x + m.m[5] * s->n.y + m.m[6] * s->n.z,
                        m.m[8] * s->n.x + m.m[9] * s->n.y + m.m[10] * s->n.z);
    svo_vec3 side = svo_normalize(svo_cross(n, svo_v3(0.31, 0.5, 0.8)));
    svo_vec3 from = svo_add(svo_scale(n, 60 * cos(0.44)), svo_scale(side, 60 * sin(0.44)));
    w->look = svo_default_render_options();
    w->look.width = W, w->look.height = H, w->look.samples = 1, w->look.transparent = true, w->look.shadows = false, w->look.footprint = 0;
    CHECK_OK(svo_eye_look(from, svo_v3(0, 0, 0), svo_v3(0.2, 1, 0.1), 0.15, &w->look.eye, &err));
}

static svo_select_options selecting(const window *w)
{
    return (svo_select_options){.eye = w->look.eye, .width = W, .height = H, .delta = 1e-3, .everything = true, .frustum = true, .occlusion = true};
}

static void draw_direct(const window *w, uint8_t *pixels)
{
    svo_error err;
    svo_select_options o = selecting(w);
    svo_selection s;
    uint64_t covered = 0;
    CHECK_OK(svo_select(&w->scene, &o, &s, &err));
    CHECK_OK(svo_select_render(&w->scene, &s, &w->look, SVO_DRAW_BOXES, pixels, &covered, NULL, &err));
    CHECK_MSG(covered == W * H, "%llu of %d samples covered", (unsigned long long)covered, W * H);
    svo_selection_free(&s);
}

static double mean_alpha(const uint8_t *pixels)
{
    double sum = 0;
    for (int i = 0; i < W * H; i++) sum += pixels[4 * i + 3];
    return sum / (W * H) / 255;
}

static const sheet sheets[] = {{{0, 0, 1}, 128, 0}, {{0.70710678, 0, 0.70710678}, 128, 0}, {{0.57735027, 0.57735027, 0.57735027}, 64, 0}, {{0.2, 0.3, 0.932737905}, 200, 0}};
static const double turns[][4] = {{0, 0, 0, 1}, {0, 0.38268343, 0, 0.92387953}, {0.3, 0.2, -0.5, 0.78740079}};

/* Every sample of a single sheet has exactly the sheet's coverage, and its colour does not depend on it. */
TEST(a_sheet_of_boxes_covers_what_its_voxels_do)
{
    static uint8_t pixels[4 * W * H];
    for (uint32_t i = 0; i < sizeof sheets / sizeof sheets[0]; i++)
        for (uint32_t t = 0; t < 3; t++)
            for (int pose = 0; pose < 3; pose++) {
                window w;
                window_make(&w, &sheets[i], turns[t], pose == 1 ? 0.3 : 0, pose == 2 ? 0.3 : 0);
                draw_direct(&w, pixels);
                for (int k = 0; k < W * H; k++)
                    CHECK_MSG(abs(pixels[4 * k + 3] - sheets[i].coverage) <= 1, "sheet %u, turn %u, pose %d, sample %d: %d of %d", i, t, pose, k, pixels[4 * k + 3], sheets[i].coverage);
                packer_free(w.view);
                if (test_failed()) return;
            }
}

TEST(sheets_behind_each_other_cover_one_after_the_other)
{
    static uint8_t pixels[4 * W * H];
    for (uint32_t i = 0; i < sizeof sheets / sizeof sheets[0]; i++) {
        window w;
        sheet s = sheets[i];
        s.apart = 9;
        const double c = s.coverage / 255.0, both = 1 - (1 - c) * (1 - c);
        window_make(&w, &s, turns[2], 0, 0);
        draw_direct(&w, pixels);
        for (int k = 0; k < W * H; k++) CHECK_MSG(fabs(pixels[4 * k + 3] - 255 * both) <= 1, "sheet %u, sample %d: %d of %g", i, k, pixels[4 * k + 3], 255 * both);
        packer_free(w.view);
    }
}

/* Nothing shows through a sheet that covers all but nothing, and what covers nothing is not there. */
TEST(the_ends_of_the_range)
{
    static uint8_t pixels[4 * W * H];
    svo_error err;
    for (int end = 0; end < 2; end++) {
        window w;
        sheet s = {{0, 0, 1}, end == 0 ? 0 : 255, 0};
        window_make(&w, &s, turns[0], 0, 0);
        svo_select_options o = selecting(&w);
        svo_selection boxes;
        uint64_t covered = 0;
        CHECK_OK(svo_select(&w.scene, &o, &boxes, &err));
        CHECK_OK(svo_select_render(&w.scene, &boxes, &w.look, end == 0 ? SVO_DRAW_BOXES : SVO_DRAW_MIPMAPS, pixels, &covered, NULL, &err));
        CHECK(covered == (end == 0 ? 0 : W * H));
        for (int k = 0; k < W * H; k++) CHECK(pixels[4 * k + 3] == (end == 0 ? 0 : 255));
        svo_selection_free(&boxes);
        packer_free(w.view);
    }
}

/* Cells overlap the boxes they come from and each other; in the mean they let through what the voxels do, within a third of the optical depth. */
TEST(a_sheet_of_cells_covers_what_its_voxels_do_in_the_mean)
{
    static uint8_t pixels[4 * W * H];
    svo_error err;
    for (uint32_t i = 0; i < sizeof sheets / sizeof sheets[0]; i++)
        for (uint32_t t = 0; t < 3; t++)
            for (int m = 0; m < 2; m++) {
                window w;
                window_make(&w, &sheets[i], turns[t], 0.2, 0);
                svo_unpose_options o = {.select = selecting(&w), .method = m == 0 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT};
                svo_unposed *u;
                svo_bvh *bvh;
                svo_render_stats stats;
                o.select.frustum = o.select.occlusion = false;
                CHECK_OK(svo_unpose(&w.scene, &o, &u, NULL, &err));
                CHECK_OK(svo_bvh_build(svo_unposed_scene(u), 1, NULL, NULL, &bvh, NULL, &err));
                CHECK_OK(svo_render(bvh, svo_unposed_scene(u), &w.look, pixels, &stats, &err));
                const double asked = -log(1 - sheets[i].coverage / 255.0), got = -log(1 - mean_alpha(pixels));
                CHECK_MSG(got > asked / 1.35 && got < 1.35 * asked, "sheet %u, turn %u, %s: optical depth %g, asked %g", i, t, m == 0 ? "resize" : "emit", got, asked);
                svo_bvh_free(bvh);
                svo_unposed_free(u);
                packer_free(w.view);
            }
}
