/* Voxels that cover a part of what is behind them, deformed: what a picture lets through is what the coverage says, however boxes and cells overlap. */
#include <math.h>
#include <stdio.h>
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
    bool varied;  /* colours and coverages of each row and column, the latter around `coverage`, where that is below 255 */
} sheet;

static uint32_t mixed(uint32_t x, uint32_t y, uint32_t what) { return ((x * 73856093u ^ y * 19349663u ^ (what + 1) * 83492791u) * 2654435761u) >> 24; }
static uint8_t coverage_of(const sheet *s, uint32_t x, uint32_t y) { return (uint8_t)(s->varied && s->coverage != 255 ? s->coverage / 2 + mixed(x, y, 3) % s->coverage : s->coverage); }

static void value_of(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    const sheet *s = user;
    const float n[3] = {(float)s->n.x, (float)s->n.y, (float)s->n.z};
    (void)z;
    if (channel == 0) svo_oct32_encode(n, out);
    else if (channel == 1) out[0] = coverage_of(s, x, y);
    else if (s->varied) out[0] = (uint8_t)mixed(x, y, 0), out[1] = (uint8_t)mixed(x, y, 1), out[2] = (uint8_t)mixed(x, y, 2);
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

/* The picture is a window into the middle of the sheet, seen at an angle with its normal. */
typedef struct window {
    svo_view *view;
    svo_scene_one one;
    svo_scene scene;
    uint32_t pose_number;
    svo_pose pose;
    svo_render_options look;
} window;

static const double even[3] = {1, 1, 1};
enum { HIGH = 60 }; /* of the eye above the sheet */

static void window_make(window *w, const sheet *s, const double q[4], const double size[3], double twist, double bend, double angle)
{
    svo_error err;
    w->view = make(s);
    CHECK_OK(svo_scene_single(w->view, "", NULL, &w->one, &err));
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
    const double g[3] = {s->n.x / (size[0] * size[0]), s->n.y / (size[1] * size[1]), s->n.z / (size[2] * size[2])}; /* m has sizes; normals are divided by them */
    svo_vec3 n = svo_normalize(svo_v3(m.m[0] * g[0] + m.m[1] * g[1] + m.m[2] * g[2], m.m[4] * g[0] + m.m[5] * g[1] + m.m[6] * g[2],
                                      m.m[8] * g[0] + m.m[9] * g[1] + m.m[10] * g[2]));
    svo_vec3 side = svo_normalize(svo_cross(n, svo_v3(0.31, 0.5, 0.8)));
    svo_vec3 from = svo_add(svo_scale(n, HIGH * cos(angle)), svo_scale(side, HIGH * sin(angle)));
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

static const sheet sheets[] = {{{0, 0, 1}, 128, 0, false}, {{0.70710678, 0, 0.70710678}, 128, 0, false}, {{0.57735027, 0.57735027, 0.57735027}, 64, 0, false}, {{0.2, 0.3, 0.932737905}, 200, 0, false}};
static const double turns[][4] = {{0, 0, 0, 1}, {0, 0.38268343, 0, 0.92387953}, {0.3, 0.2, -0.5, 0.78740079}};

/* Every sample of a single sheet has exactly the sheet's coverage, and its colour does not depend on it. */
TEST(a_sheet_of_boxes_covers_what_its_voxels_do)
{
    static uint8_t pixels[4 * W * H];
    for (uint32_t i = 0; i < sizeof sheets / sizeof sheets[0]; i++)
        for (uint32_t t = 0; t < 3; t++)
            for (int pose = 0; pose < 3; pose++) {
                window w;
                window_make(&w, &sheets[i], turns[t], even, pose == 1 ? 0.3 : 0, pose == 2 ? 0.3 : 0, 0.44);
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
        window_make(&w, &s, turns[2], even, 0, 0, 0.44);
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
        sheet s = {{0, 0, 1}, end == 0 ? 0 : 255, 0, false};
        window_make(&w, &s, turns[0], even, 0, 0, 0.44);
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

/* What cells made of a sheet come to in a window, over what was asked: the mean of the samples' optical depths, and the optical depth of their mean. */
typedef struct depths { double mean, of_mean; } depths;

static void depth_of_cells(const sheet *s, const double q[4], const double size[3], double twist, double bend, double angle, svo_resample_method method, depths *got)
{
    static uint8_t pixels[4 * W * H];
    static float light[4 * W * H];
    svo_error err;
    window w;
    window_make(&w, s, q, size, twist, bend, angle);
    svo_unpose_options o = {.select = selecting(&w), .method = method};
    svo_unposed *u;
    svo_bvh *bvh;
    svo_render_stats stats;
    svo_render_planes planes = {.light = light};
    o.select.frustum = o.select.occlusion = false;
    CHECK_OK(svo_unpose(&w.scene, &o, &u, NULL, &err));
    CHECK_OK(svo_bvh_build(svo_unposed_scene(u), 1, NULL, NULL, &bvh, NULL, &err));
    CHECK_OK(svo_render_with_planes(bvh, svo_unposed_scene(u), &w.look, pixels, &planes, &stats, &err));
    double depth = 0, cover = 0;
    for (int k = 0; k < W * H; k++) depth -= log(1 - fmin(light[4 * k + 3], 1 - 1e-7)), cover += light[4 * k + 3];
    svo_bvh_free(bvh);
    svo_unposed_free(u);
    packer_free(w.view);
    const double asked = -log(1 - s->coverage / 255.0);
    *got = (depths){depth / (W * H) / asked, -log(1 - cover / (W * H)) / asked};
}

/* Cells overlap the boxes they come from and each other; in the mean they let through what the voxels do. */
TEST(a_sheet_of_cells_covers_what_its_voxels_do_in_the_mean)
{
    static const uint8_t coverages[] = {8, 32, 64, 128, 200, 235};
    static const double sizes[][3] = {{1, 1, 1}, {0.8, 1.3, 1}, {1.1, 0.75, 1.6}}, angles[] = {0, 0.44, 0.9};
    depths least = {INFINITY, INFINITY}, most = {0, 0}, thin = {INFINITY, INFINITY};
    for (uint32_t i = 0; i < sizeof sheets / sizeof sheets[0]; i++)
        for (uint32_t c = 0; c < sizeof coverages; c++)
            for (uint32_t t = 0; t < 3; t++)
                for (uint32_t pose = 0; pose < 3; pose++)
                    for (uint32_t a = 0; a < 3; a++)
                        for (uint32_t m = SVO_RESAMPLE_RESIZE; m <= SVO_RESAMPLE_EMIT; m++) {
                            if ((i + 2 * c + t + 2 * pose + 3 * a + m) % 5 != 0) continue; /* a fifth of them, with all pairs */
                            sheet s = sheets[i];
                            depths got = {0, 0};
                            s.coverage = coverages[c];
                            depth_of_cells(&s, turns[t], sizes[(i + c + 2 * a) % 3], pose == 1 ? 0.3 : 0, pose == 2 ? 0.3 : 0, angles[a], (svo_resample_method)m, &got);
                            if (test_failed()) return;
                            CHECK_MSG(got.mean > 0.95 && got.mean < 1.05, "sheet %u of %u, turn %u, pose %u, angle %u, method %u: %g times the optical depth", i, s.coverage, t, pose, a, m, got.mean);
                            least.mean = fmin(least.mean, got.mean), most.mean = fmax(most.mean, got.mean);
                            least.of_mean = fmin(least.of_mean, got.of_mean), most.of_mean = fmax(most.of_mean, got.of_mean);
                            if (s.coverage <= 64) thin.of_mean = fmin(thin.of_mean, got.of_mean);
                        }
    printf("optical depths %.3f to %.3f of what was asked, those of the mean cover %.3f to %.3f, from %.3f up to a coverage of 64\n", least.mean, most.mean, least.of_mean, most.of_mean, thin.of_mean);
    CHECK(thin.of_mean > 0.95 && least.of_mean > 0.8 && most.of_mean < 1.05); /* what is uneven lets more through, the more so the less there is to let through */
}

static double overlap(double low, double high, double from, double to) { return fmax(fmin(high, to) - fmax(low, from), 0); }

/* Cells of 1 over voxels of 0.9 that lie in a plane: the colour of a cell is the average of its voxels' by the area of each that is in it, and by its optical depth. */
TEST(colours_of_cells_are_weighted_by_area_and_optical_depth)
{
    static const double size[3] = {0.9, 0.9, 0.9};
    static const uint8_t coverages[] = {255, 120};
    svo_error err;
    uint32_t uneven = 0;
    for (int c = 0; c < 2; c++) {
        window w;
        sheet s = {{0, 0, 1}, coverages[c], 0, true};
        window_make(&w, &s, turns[0], size, 0, 0, 0);
        svo_unpose_options o = {.select = selecting(&w), .method = SVO_RESAMPLE_EMIT};
        svo_unposed *u;
        o.select.frustum = o.select.occlusion = false;
        CHECK_OK(svo_unpose(&w.scene, &o, &u, NULL, &err));
        const svo_view *v = svo_unposed_view(u);
        const uint32_t color = svo_view_find_channel(v, "color");
        CHECK(color < v->channel_count && fabs(v->voxel_to_world[0] - 1) < 1e-9);
        for (int y = -12; y < 12 && !test_failed(); y++)
            for (int x = -12; x < 12; x++) {
                double sum[3] = {0, 0, 0}, weight = 0, plain[3] = {0, 0, 0};
                uint32_t count = 0;
                for (uint32_t j = 0; j < SIDE; j++)
                    for (uint32_t i = 0; i < SIDE; i++) {
                        const double part = overlap(0.9 * i - 14.4, 0.9 * i - 13.5, x, x + 1) * overlap(0.9 * j - 14.4, 0.9 * j - 13.5, y, y + 1);
                        const double n = part * -log(1 - fmin(coverage_of(&s, i, j), 254.5) / 255.0);
                        if (part == 0) continue;
                        weight += n, count++;
                        for (uint32_t k = 0; k < 3; k++) {
                            const double light = svo_srgb_to_linear((uint8_t)mixed(i, j, k));
                            sum[k] += n * light, plain[k] += light;
                        }
                    }
                uint64_t index = 0;
                uint8_t got[SVO_MAX_STRIDE];
                const double *m = v->voxel_to_world;
                CHECK(svo_view_voxel(v, (uint32_t)lrint(x - m[3]), (uint32_t)lrint(y - m[7]), (uint32_t)lrint(-m[11]), &index));
                svo_view_attribute(v, color, index, got);
                for (int k = 0; k < 3; k++) {
                    const int expected = svo_linear_to_srgb((float)(sum[k] / weight));
                    CHECK_MSG(abs(got[k] - expected) <= 1, "coverage %u, cell %d, %d: %d, not %d", s.coverage, x, y, got[k], expected);
                    uneven += abs(expected - svo_linear_to_srgb((float)(plain[k] / count))) > 3;
                }
            }
        svo_unposed_free(u);
        packer_free(w.view);
    }
    CHECK_MSG(uneven > 1000, "%u averages differ from plain ones", uneven);
}
