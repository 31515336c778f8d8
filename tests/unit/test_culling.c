/* Occlusion culling beside a picture without it, over random scenes and cameras: nothing that a sample shows is lost. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "svo_bvh.h"
#include "svo_morton.h"
#include "svo_pack.h"
#include "svo_resample.h"
#include "svoi_select.h"
#include "test.h"

enum { ASSETS = 3, PLACES = 40 };

static double between(uint64_t *seed, double a, double b) { return a + (b - a) * test_random_unit(seed); }
static bool chance(uint64_t *seed, uint32_t of) { return test_random(seed) % of == 0; }

typedef struct world {
    svo_view *view[ASSETS];
    svo_place place[PLACES];
    svo_pose pose[PLACES];
    float matrix[12 * PLACES];
    svo_packed_scene *packed;
} world;

static uint16_t label_of(uint32_t y, uint32_t side) { return (uint16_t)(3 * y / side); }
static void bone_of(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    uint16_t label = label_of(y, *(const uint32_t *)user);
    if (channel == 0) memcpy(out, &label, 2);
    else out[0] = (x + y + z) % 2 == 0 ? 90 : 255; /* half of them let light pass */
}

/* A slab, a cloud of single voxels, or a hollow box; of one voxel to 16^3. */
static svo_view *random_asset(uint64_t *seed, int kind, bool coverage)
{
    uint32_t depth = (uint32_t)(test_random(seed) % 5), side = 1u << depth;
    uint64_t *codes = malloc(8 * (uint64_t)side * side * side), n = 0;
    for (uint32_t z = 0; z < side; z++)
        for (uint32_t y = 0; y < side; y++)
            for (uint32_t x = 0; x < side; x++) {
                bool rim = x == 0 || y == 0 || z == 0 || x + 1 == side || y + 1 == side || z + 1 == side;
                if (kind == 0 ? z == side / 2 : kind == 1 ? chance(seed, 3) || n == 0 : rim) codes[n++] = svo_morton_encode(x, y, z);
            }
    packer_options o = {.lod = true, .channel_count = coverage ? 2 : 1, .value = bone_of, .user = &side};
    strcpy(o.channels[0].name, "bone"), strcpy(o.channels[1].name, "coverage");
    o.channels[0].kind = SVO_KIND_ID16, o.channels[1].kind = SVO_KIND_UNORM8;
    svo_view *v = packer_make(depth, codes, n, &o);
    free(codes);
    return v;
}

static void random_pose(world *w, uint32_t i, uint64_t *seed)
{
    svo_pose *p = &w->pose[i];
    *p = svo_pose_stated();
    p->flags = (uint32_t)(test_random(seed) % 16);
    if ((p->flags & SVO_POSE_TWIST) != 0) p->twist_axis = (uint8_t)(test_random(seed) % 3), p->twist_angle = (float)between(seed, -6, 6);
    if ((p->flags & SVO_POSE_BEND) != 0) {
        p->bend_axis = (uint8_t)(test_random(seed) % 3), p->bend_towards = (uint8_t)((p->bend_axis + 1u) % 3);
        p->bend_angle = (float)between(seed, -3, 3);
    }
    for (int k = 0; k < 12; k++) w->matrix[12 * i + (uint32_t)k] = (float)((k % 5 == 0) + between(seed, -0.4, 0.4));
    if (chance(seed, 8)) memset(w->matrix + 12 * i, 0, 16); /* flat */
    p->matrix = (p->flags & SVO_POSE_MATRIX) != 0 ? i : 0;
    if ((p->flags & SVO_POSE_BONES) != 0) p->bone_first = i < PLACES - 3 ? i : 0, p->bone_count = 1 + (uint32_t)(test_random(seed) % 3);
}

static void world_make(world *w, uint64_t *seed)
{
    static svo_error err;
    static const char *const names[ASSETS] = {"a", "b", "c"};
    memset(w, 0, sizeof *w);
    for (int i = 0; i < ASSETS; i++) w->view[i] = random_asset(seed, i, i != 1);
    for (uint32_t i = 0; i < PLACES; i++) {
        svo_place *p = &w->place[i];
        p->asset = (uint32_t)(test_random(seed) % ASSETS);
        double size = ldexp(1, -(int)w->view[p->asset]->depth) * (chance(seed, 6) ? between(seed, 10, 60) : between(seed, 0.5, 8)), s[3];
        for (int k = 0; k < 3; k++) s[k] = (chance(seed, 6) ? -size : size) * between(seed, 0.3, 1.5);
        double q[4] = {between(seed, -1, 1), between(seed, -1, 1), between(seed, -1, 1), between(seed, 0.1, 1)};
        if (chance(seed, 3)) q[0] = q[1] = q[2] = 0;
        svo_mat4 m = svo_mat4_trs((double[3]){between(seed, -30, 30), between(seed, -15, 15), between(seed, -30, 30)}, q, s);
        memcpy(p->transform, m.m, sizeof p->transform);
        p->id = i, p->pose = i + 1;
        random_pose(w, i, seed);
    }
    const svo_view *views[ASSETS] = {w->view[0], w->view[1], w->view[2]};
    svo_pack_input in = {.asset_count = ASSETS, .assets = views, .asset_names = names, .place_count = PLACES, .places = w->place,
                         .poses = {.count = PLACES, .pose = w->pose, .matrix_count = PLACES, .matrix = w->matrix}};
    svo_pack_options o = {.page_instances = 1 + (uint32_t)(test_random(seed) % 16)};
    CHECK_OK(svo_pack(&in, &o, &w->packed, &err));
}

static void world_free(world *w)
{
    svo_packed_scene_free(w->packed);
    for (int i = 0; i < ASSETS; i++) packer_free(w->view[i]);
}

/* Often close to something, inside of it, or along an axis; from a needle's eye to nearly half of everything. */
static bool random_eye(uint64_t *seed, svo_eye *eye)
{
    static svo_error err;
    svo_vec3 from = svo_v3(between(seed, -40, 40), between(seed, -20, 20), between(seed, -40, 40)), to = svo_v3(between(seed, -20, 20), between(seed, -10, 10), between(seed, -20, 20));
    if (chance(seed, 4)) from = svo_v3(round(from.x), round(from.y), round(from.z)), to = svo_add(from, svo_v3(0, 0, chance(seed, 2) ? -1 : 1));
    double fov = chance(seed, 5) ? between(seed, 0.02, 0.1) : chance(seed, 5) ? between(seed, 2.5, 3.1) : between(seed, 0.4, 1.5);
    return svo_eye_look(from, to, svo_v3(0, 1, 0), fov, eye, &err) == SVO_OK;
}

/* Boxes: depths and pictures are the same sample by sample, through voxels that cover a part only too. */
TEST(no_visible_box_is_lost_in_random_scenes)
{
    enum { W = 56, H = 42 };
    static float depth[2][W * H];
    static uint32_t owner[W * H];
    static uint8_t pixels[2][4 * W * H];
    svo_error err = {0};
    uint64_t seed = 2024, hidden = 0, shown = 0, glass = 0;
    for (int round = 0; round < 30; round++) {
        world w;
        world_make(&w, &seed);
        for (int view = 0; view < 4 && !test_failed(); view++) {
            svo_select_options o = {.width = W, .height = H, .delta = between(&seed, 0.6, 5), .everything = view % 2 == 0};
            if (!random_eye(&seed, &o.eye)) continue;
            for (int i = 0; i < 2; i++) {
                svo_selection s;
                o.frustum = o.occlusion = i > 0;
                o.threads = 1 + (uint32_t)(test_random(&seed) % 3);
                CHECK_OK(svo_select(svo_packed_scene_get(w.packed), &o, &s, &err));
                CHECK_OK(svo_select_draw(&s, &o, SVO_DRAW_BOXES, owner, depth[i], &err));
                svo_render_options ro = svo_default_render_options();
                ro.width = W, ro.height = H, ro.samples = 1, ro.eye = o.eye, ro.shadows = false, ro.transparent = true, ro.threads = o.threads;
                CHECK_OK(svo_select_render(svo_packed_scene_get(w.packed), &s, &ro, SVO_DRAW_BOXES, pixels[i], NULL, NULL, &err));
                hidden += s.report.hidden;
                svo_selection_free(&s);
            }
            for (uint32_t i = 0; i < W * H; i++) {
                shown += isfinite(depth[0][i]) != 0;
                CHECK_MSG(depth[0][i] == depth[1][i], "round %d, view %d, sample %u: %g without culling, %g with it", round, view, i, (double)depth[0][i], (double)depth[1][i]);
                /* (of boxes at the same depth another may be nearest, with other colours) */
                CHECK_MSG(pixels[0][4 * i + 3] == pixels[1][4 * i + 3], "round %d, view %d, sample %u: covered %d without culling, %d with it", round, view, i, pixels[0][4 * i + 3], pixels[1][4 * i + 3]);
                glass += pixels[0][4 * i + 3] != 0 && pixels[0][4 * i + 3] != 255;
            }
        }
        world_free(&w);
        if (test_failed()) return;
    }
    CHECK_MSG(hidden > 2000 && shown > 30000 && glass > 500, "%llu nodes hidden, %llu samples, %llu seen through", (unsigned long long)hidden, (unsigned long long)shown,
              (unsigned long long)glass);
}

/* Mipmaps: every sample that a box covers is covered, no farther away; and no more than half a rectangle and a sample is added around it. */
TEST(mipmaps_cover_boxes_and_little_more)
{
    enum { W = 70, H = 45 };
    static float depth[2][W * H];
    static uint32_t owner[2][W * H];
    svo_error err = {0};
    uint64_t seed = 5, shown = 0, added = 0;
    for (int round = 0; round < 20; round++) {
        world w;
        world_make(&w, &seed);
        for (int view = 0; view < 3 && !test_failed(); view++) {
            svo_select_options o = {.width = W, .height = H, .delta = between(&seed, 0.6, 5), .everything = true, .frustum = true, .occlusion = view == 0};
            svo_selection s;
            if (!random_eye(&seed, &o.eye)) continue;
            CHECK_OK(svo_select(svo_packed_scene_get(w.packed), &o, &s, &err));
            CHECK_OK(svo_select_draw(&s, &o, SVO_DRAW_BOXES, owner[0], depth[0], &err));
            o.threads = 1 + (uint32_t)(test_random(&seed) % 3);
            CHECK_OK(svo_select_draw(&s, &o, SVO_DRAW_MIPMAPS, owner[1], depth[1], &err));
            const svoi_look look = svoi_look_make(&o.eye, W, H);
            for (uint32_t i = 0; i < W * H; i++) {
                const double x = i % W + 0.5, y = i / W + 0.5;
                shown += isfinite(depth[0][i]) != 0;
                CHECK_MSG(depth[1][i] <= depth[0][i], "round %d, view %d, sample %u: a box at %g, a texel at %g", round, view, i, (double)depth[0][i], (double)depth[1][i]);
                if (owner[1][i] == UINT32_MAX) continue;
                added += owner[0][i] == UINT32_MAX;
                double low[3], high[3];
                for (int k = 0; k < 3; k++) low[k] = s.boxes[owner[1][i]].low[k], high[k] = s.boxes[owner[1][i]].high[k];
                const svoi_rect r = svoi_project(&look, low, high);
                if (r.near <= 0) continue;
                const double room = fmax(0.5 * fmax(r.x1 - r.x0, r.y1 - r.y0), 0) + 1.5;
                CHECK_MSG(x > r.x0 - room && x < r.x1 + room && y > r.y0 - room && y < r.y1 + room, "round %d, view %d, sample %u is far from its box", round, view, i);
            }
            svo_selection_free(&s);
        }
        world_free(&w);
        if (test_failed()) return;
    }
    CHECK_MSG(shown > 20000 && added > 100 && added < shown, "%llu samples shown, %llu added", (unsigned long long)shown, (unsigned long long)added);
}

/* Cells: where a ray hits something without culling, it hits something with it, and no farther away. (Cells of what is left may be finer than before: the octree's
 * finest level follows from its root.) */
TEST(no_visible_cell_is_lost_in_random_scenes)
{
    enum { W = 48, H = 36 };
    svo_error err = {0};
    uint64_t seed = 77, hidden = 0, shown = 0;
    for (int round = 0; round < 24; round++) {
        static svo_scene_hit hit[2][W * H];
        world w;
        world_make(&w, &seed);
        svo_unpose_options o = {.select = {.width = W, .height = H, .delta = between(&seed, 1, 4), .everything = round % 2 == 0},
                                .method = round % 3 == 0 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT};
        if (!random_eye(&seed, &o.select.eye)) continue;
        for (int i = 0; i < 2; i++) {
            svo_unposed *u;
            svo_unpose_report r;
            svo_bvh *bvh;
            o.select.frustum = o.select.occlusion = i > 0;
            CHECK_OK(svo_unpose(svo_packed_scene_get(w.packed), &o, &u, &r, &err));
            CHECK_OK(svo_bvh_build(svo_unposed_scene(u), 1, NULL, NULL, &bvh, NULL, &err));
            hidden += r.select.hidden;
            svo_render_options ro = svo_default_render_options();
            ro.width = W, ro.height = H, ro.footprint = 0, ro.eye = o.select.eye;
            for (uint32_t n = 0; n < W * H; n++) {
                svo_scene_ray ray = svo_render_ray(&ro, n % W + 0.5, n / W + 0.5);
                svo_scene_trace(bvh, &ray, 1, &hit[i][n]);
            }
            svo_bvh_free(bvh);
            svo_unposed_free(u);
        }
        for (uint32_t n = 0; n < W * H; n++) {
            if (!hit[0][n].node.hit) continue;
            shown++;
            CHECK_MSG(hit[1][n].node.hit, "round %d, sample %u: lost", round, n);
        }
        world_free(&w);
    }
    CHECK_MSG(hidden > 500 && shown > 5000, "%llu nodes hidden, %llu samples", (unsigned long long)hidden, (unsigned long long)shown);
}

/* The same scene with its pages in another order. */
typedef struct shuffled { svo_scene scene; uint32_t asset[PLACES], pose[PLACES]; uint64_t id[PLACES]; float transform[12 * PLACES]; svo_scene_page page[PLACES]; } shuffled;

static void shuffle(const svo_scene *from, shuffled *to, uint64_t *seed)
{
    uint32_t order[PLACES];
    uint64_t n = 0;
    to->scene = *from;
    for (uint32_t i = 0; i < from->page_count; i++) {
        uint32_t k = (uint32_t)(test_random(seed) % (i + 1));
        order[i] = order[k], order[k] = i;
    }
    for (uint32_t i = 0; i < from->page_count; i++) {
        to->page[i] = from->pages[order[i]];
        to->page[i].first = n;
        for (uint64_t k = 0; k < to->page[i].count; k++, n++) {
            uint64_t old = from->pages[order[i]].first + k;
            to->asset[n] = from->instance_asset[old], to->id[n] = from->instance_id[old];
            to->pose[n] = from->instance_pose != NULL ? from->instance_pose[old] : SVO_NO_POSE;
            memcpy(to->transform + 12 * n, from->instance_transform + 12 * old, 48);
        }
    }
    to->scene.instance_asset = to->asset, to->scene.instance_pose = to->pose, to->scene.instance_id = to->id;
    to->scene.instance_transform = to->transform, to->scene.pages = to->page;
}

TEST(the_order_of_pages_does_not_matter)
{
    enum { W = 56, H = 42 };
    static float depth[2][W * H];
    static uint32_t owner[2][W * H];
    static shuffled other;
    svo_error err = {0};
    uint64_t seed = 5, shown = 0;
    for (int round = 0; round < 20; round++) {
        world w;
        world_make(&w, &seed);
        const svo_scene *scenes[2] = {svo_packed_scene_get(w.packed), &other.scene};
        shuffle(scenes[0], &other, &seed);
        svo_select_options o = {.width = W, .height = H, .delta = between(&seed, 0.6, 3), .everything = round % 2 == 0, .frustum = true, .occlusion = round % 3 != 0};
        if (random_eye(&seed, &o.eye)) {
            uint64_t voxels[2];
            for (int i = 0; i < 2; i++) {
                svo_selection s;
                svo_unpose_options u = {.select = o, .method = round % 2 == 0 ? SVO_RESAMPLE_EMIT : SVO_RESAMPLE_RESIZE};
                svo_unposed *unposed;
                o.threads = 1 + (uint32_t)i;
                CHECK_OK(svo_select(scenes[i], &o, &s, &err));
                CHECK_OK(svo_select_draw(&s, &o, SVO_DRAW_BOXES, owner[i], depth[i], &err));
                for (uint32_t k = 0; k < W * H; k++)
                    if (owner[i][k] != UINT32_MAX) owner[i][k] = (uint32_t)scenes[i]->instance_id[s.boxes[owner[i][k]].instance];
                svo_selection_free(&s);
                u.select.frustum = u.select.occlusion = false; /* what is left out may depend on what came first */
                CHECK_OK(svo_unpose(scenes[i], &u, &unposed, NULL, &err));
                voxels[i] = svo_unposed_view(unposed)->nodes[svo_unposed_view(unposed)->depth];
                svo_unposed_free(unposed);
            }
            CHECK_U64(voxels[0], voxels[1]);
            for (uint32_t k = 0; k < W * H; k++) {
                shown += isfinite(depth[0][k]) != 0;
                CHECK_MSG(depth[0][k] == depth[1][k], "round %d, sample %u: %g and %g", round, k, (double)depth[0][k], (double)depth[1][k]);
            }
        }
        world_free(&w);
    }
    CHECK(shown > 10000);
}
