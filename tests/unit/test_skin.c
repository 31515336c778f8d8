/* Skins: weights that are picked, the nearest triangle, bounds of blended boxes, and a limb that bends without gaps. */
#include "svo_skin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "svo_bvh.h"
#include "svo_deform.h"
#include "svo_mesh.h"
#include "svo_morton.h"
#include "svo_resample.h"
#include "test.h"

static double between(uint64_t *seed, double a, double b) { return a + (b - a) * test_random_unit(seed); }

TEST(weights_are_picked)
{
    uint64_t seed = 7;
    for (int round = 0; round < 20000; round++) {
        uint16_t bone[SVO_SKIN_CANDIDATES], got[SVO_SKIN_BONES];
        double weight[SVO_SKIN_CANDIDATES], of[6] = {0}, total = 0, kept = 0;
        uint8_t part[SVO_SKIN_BONES];
        uint32_t n = (uint32_t)(test_random(&seed) % (SVO_SKIN_CANDIDATES + 1)), sum = 0;
        for (uint32_t i = 0; i < n; i++) {
            bone[i] = (uint16_t)(test_random(&seed) % 6);
            weight[i] = test_random(&seed) % 3 == 0 ? 0 : test_random_unit(&seed) * (test_random(&seed) % 4 == 0 ? 1e-3 : 1);
            of[bone[i]] += weight[i], total += weight[i];
        }
        double dropped = svo_skin_pick(bone, weight, n, got, part);
        for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) sum += part[i];
        CHECK_U64(sum, 255);
        if (total == 0) {
            CHECK(got[0] == SVO_SKIN_REST && part[0] == 255 && dropped == 0);
            continue;
        }
        for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) {
            CHECK(i < 2 || part[i] <= part[i - 1]); /* (the first takes what rounding leaves) */
            CHECK((part[i] == 0) == (got[i] == SVO_SKIN_REST));
            if (part[i] != 0) kept += of[got[i]];
        }
        for (uint32_t i = 0; i < SVO_SKIN_BONES; i++)
            if (part[i] != 0) CHECK(fabs(part[i] - 255 * of[got[i]] / kept) <= 3); /* of each of four half a step, and those that became 0 */
        CHECK(dropped >= 0 && dropped < 0.5);
    }
}

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* The point that is found is on its triangle, where it is nearest, and no other point of any triangle is nearer. */
TEST(the_nearest_triangle_is_found)
{
    enum { VERTICES = 60, TRIANGLES = 90 };
    svo_error err = {0};
    uint64_t seed = 3;
    for (int round = 0; round < 10; round++) {
        double positions[3 * VERTICES];
        uint32_t indices[3 * TRIANGLES];
        svo_influence influences[VERTICES] = {{{0}, {0}}};
        for (int i = 0; i < 3 * VERTICES; i++) positions[i] = between(&seed, 0, 32);
        for (int i = 0; i < 3 * TRIANGLES; i++) indices[i] = (uint32_t)(test_random(&seed) % VERTICES);
        if (round == 5) positions[0] = NAN; /* its triangles are left out */
        svo_tree_info info = {.depth = 5, .voxel_to_world = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
        svo_skin_mesh mesh = {VERTICES, TRIANGLES, positions, influences, indices};
        svo_skin *s;
        CHECK_OK(svo_skin_create(&mesh, &info, NULL, &s, &err));
        for (int i = 0; i < 300; i++) {
            double p[3], w[3], v[3], at[3], least = 0;
            uint32_t t, again;
            for (int k = 0; k < 3; k++) p[k] = between(&seed, -4, 36);
            CHECK(svo_skin_nearest(s, p, SVO_NONE, &t, w));
            CHECK(t < TRIANGLES && w[0] >= 0 && w[1] >= 0 && w[2] >= -1e-12 && fabs(w[0] + w[1] + w[2] - 1) < 1e-9);
            for (int k = 0; k < 3; k++) {
                at[k] = 0;
                for (int c = 0; c < 3; c++) at[k] += w[c] * positions[3 * indices[3 * t + (uint32_t)c] + (uint32_t)k];
                at[k] -= p[k];
            }
            least = sqrt(dot(at, at));
            for (int n = 0; n < 400; n++) {
                uint32_t other = (uint32_t)(test_random(&seed) % TRIANGLES);
                double a = test_random_unit(&seed), b = test_random_unit(&seed) * (1 - a);
                for (int k = 0; k < 3; k++)
                    v[k] = (1 - a - b) * positions[3 * indices[3 * other] + (uint32_t)k] + a * positions[3 * indices[3 * other + 1] + (uint32_t)k] +
                           b * positions[3 * indices[3 * other + 2] + (uint32_t)k] - p[k];
                CHECK(!(sqrt(dot(v, v)) < least - 1e-9));
            }
            uint32_t from = (uint32_t)(test_random(&seed) % TRIANGLES); /* wherever the search begins */
            if (round == 5) continue;
            CHECK(svo_skin_nearest(s, p, from, &again, v) && again == t);
        }
        svo_skin_free(s);
    }
}

/* ---- blended boxes ---------------------------------------------------------------------------------------------------- */

enum { BONES = 4 };

typedef struct rigged { svo_pose pose; float matrix[12 * BONES]; svo_poses all; } rigged;

static void random_rig(rigged *r, uint64_t *seed, uint32_t flags)
{
    r->pose = svo_pose_stated();
    r->pose.flags = SVO_POSE_BONES | flags;
    r->pose.bone_count = BONES;
    r->pose.twist_axis = 1, r->pose.twist_angle = (flags & SVO_POSE_TWIST) != 0 ? 2 : 0;
    r->pose.bend_axis = (flags & SVO_POSE_BEND) != 0 ? 1 : 0, r->pose.bend_angle = (flags & SVO_POSE_BEND) != 0 ? 1 : 0;
    r->pose.bend_towards = 0;
    if ((flags & SVO_POSE_TWIST) == 0) r->pose.twist_axis = 0;
    for (int b = 0; b < BONES; b++) {
        svo_mat4 m = svo_mat4_trs((double[3]){between(seed, -5, 5), between(seed, -5, 5), between(seed, -5, 5)},
                                  (double[4]){between(seed, -1, 1), between(seed, -1, 1), between(seed, -1, 1), 1}, (double[3]){1, between(seed, 0.5, 2), 1});
        for (int i = 0; i < 12; i++) r->matrix[12 * b + i] = (float)m.m[i];
    }
    double low[3] = {0, 0, 0}, high[3] = {32, 32, 32};
    svo_pose_resolve(&r->pose, low, high);
    r->all = (svo_poses){.count = 1, .pose = &r->pose, .matrix_count = BONES, .matrix = r->matrix};
}

/* A point under stated weights, written down another way than the library does. */
static svo_vec3 blend_point(const rigged *r, const svo_mat4 *place, const double weight[BONES + 1], svo_vec3 p)
{
    svo_vec3 sum = svo_scale(p, weight[BONES]); /* rests */
    for (uint64_t b = 0; b < BONES; b++) {
        svo_mat4 m = svo_pose_matrix(&r->all, b);
        sum = svo_add(sum, svo_scale(svo_mat4_point(&m, p), weight[b]));
    }
    svo_pose rest = r->pose;
    rest.flags &= ~(uint32_t)SVO_POSE_BONES, rest.bone_count = 0;
    svo_mat4 id = svo_mat4_identity();
    svo_deform d = svo_deform_make(&r->all, &rest, &id, place);
    return svo_deform_point(&d, SVO_NO_BONE, sum);
}

/* The box holds every point under all weights in the ranges, and without twist and bend each side is reached by some. */
TEST(a_blended_box_holds_what_the_ranges_allow)
{
    static const uint32_t flags[] = {0, SVO_POSE_TWIST, SVO_POSE_BEND, SVO_POSE_TWIST | SVO_POSE_BEND};
    uint64_t seed = 21;
    svo_mat4 id = svo_mat4_identity();
    for (int round = 0; round < 400; round++) {
        rigged r;
        random_rig(&r, &seed, flags[round % 4]);
        svo_mat4 place = svo_mat4_trs((double[3]){1, 2, 3}, (double[4]){0.1, 0.5, -0.2, 1}, (double[3]){1, -1, 2});
        svo_deform d = svo_deform_make(&r.all, &r.pose, &id, &place);
        double low[3], high[3], out_low[3], out_high[3], base[BONES + 1], reach[6] = {INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY};
        for (int k = 0; k < 3; k++) low[k] = between(&seed, 0, 30), high[k] = low[k] + between(&seed, 0.1, 2);
        /* weights in 255ths that add up, and ranges around them */
        svo_bone_range range[BONES + 1] = {{0}};
        uint32_t n = 1 + (uint32_t)(test_random(&seed) % (BONES + 1)), left = 255;
        for (uint32_t i = 0; i < n; i++) {
            uint32_t w = i + 1 == n ? left : (uint32_t)(test_random(&seed) % (left + 1)), below = (uint32_t)(test_random(&seed) % (w + 1)), above = (uint32_t)(test_random(&seed) % (256 - w));
            range[i] = (svo_bone_range){.bone = i == BONES ? SVO_NO_BONE : i, .low = (uint8_t)(w - below), .high = (uint8_t)(w + above)};
            if (n == 1) range[i].low = range[i].high = 255;
            base[i] = w;
            left -= w;
        }
        svo_deform_blended_box(&d, (svo_bone_list){range, n}, low, high, out_low, out_high);
        for (int i = 0; i < 500; i++) {
            double weight[BONES + 1] = {0}, p[3];
            for (uint32_t k = 0; k < n; k++) weight[k] = base[k];
            for (int move = 0; move < 20; move++) { /* from one bone to another, as far as the ranges let */
                uint32_t a = (uint32_t)(test_random(&seed) % n), b = (uint32_t)(test_random(&seed) % n);
                double most = fmin(weight[a] - range[a].low, range[b].high - weight[b]);
                if (a == b || !(most > 0)) continue;
                double some = test_random(&seed) % 2 == 0 ? most : most * test_random_unit(&seed);
                weight[a] -= some, weight[b] += some;
            }
            double by_bone[BONES + 1] = {0};
            for (uint32_t k = 0; k < n; k++) by_bone[range[k].bone == SVO_NO_BONE ? BONES : range[k].bone] = weight[k] / 255;
            for (int k = 0; k < 3; k++) p[k] = test_random(&seed) % 2 == 0 ? (test_random(&seed) % 2 == 0 ? low[k] : high[k]) : between(&seed, low[k], high[k]);
            svo_vec3 q = blend_point(&r, &place, by_bone, svo_v3(p[0], p[1], p[2]));
            double c[3] = {q.x, q.y, q.z};
            for (int k = 0; k < 3; k++) {
                double slack = 1e-9 * (1 + fabs(c[k]));
                CHECK_MSG(c[k] >= out_low[k] - slack && c[k] <= out_high[k] + slack, "round %d: a point is outside", round);
                reach[k] = fmin(reach[k], c[k]), reach[3 + k] = fmax(reach[3 + k], c[k]);
            }
        }
        for (int k = 0; k < 3 && flags[round % 4] == 0; k++) {
            double size = out_high[k] - out_low[k];
            CHECK_MSG(reach[k] - out_low[k] < 0.3 * size && out_high[k] - reach[3 + k] < 0.3 * size, "round %d: the box is much larger than its points", round);
        }
    }
}

/* ---- a limb ------------------------------------------------------------------------------------------------------------ */

enum { DEPTH = 5, SIDE = 1 << DEPTH };

/* Weights of three bones up the limb, in 255ths: they blend in two places, where all three meet too. */
static void weights_at(double y, uint8_t out[3])
{
    double a = fmin(fmax((14 - y) / 8, 0), 1), c = fmin(fmax((y - 12) / 9, 0), 1);
    uint32_t first = (uint32_t)(255 * a * (1 - 0.5 * c)), last = (uint32_t)(255 * c * (1 - 0.5 * a));
    out[0] = (uint8_t)first, out[2] = (uint8_t)last, out[1] = (uint8_t)(255 - first - last);
}

/* Channels bone, bone1, bone2, weight1, weight2; the greatest first. */
static void limb_value(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    (void)user, (void)x, (void)z;
    uint8_t w[3], part[SVO_SKIN_BONES];
    uint16_t bone[3] = {0, 1, 2}, got[SVO_SKIN_BONES];
    double d[3];
    weights_at(y + 0.5, w);
    for (int i = 0; i < 3; i++) d[i] = w[i];
    svo_skin_pick(bone, d, 3, got, part);
    if (channel < 3) memcpy(out, &got[channel], 2);
    else *out = part[channel - 2];
}

/* The voxels that the surface of a capsule along y passes between the corners of. */
static svo_view *limb(uint64_t **codes_out, uint64_t *count_out)
{
    uint64_t *codes = malloc(8 * SIDE * SIDE * SIDE), n = 0;
    packer_options o = {.lod = true, .channel_count = 5, .value = limb_value};
    static const char *const names[] = {"bone", "bone1", "bone2", "weight1", "weight2"};
    for (int i = 0; i < 5; i++) {
        strcpy(o.channels[i].name, names[i]);
        o.channels[i].kind = i < 3 ? SVO_KIND_ID16 : SVO_KIND_UNORM8;
    }
    for (uint32_t z = 0; z < SIDE; z++)
        for (uint32_t y = 0; y < SIDE; y++)
            for (uint32_t x = 0; x < SIDE; x++) {
                int inside = 0;
                for (uint32_t c = 0; c < 8; c++) {
                    double p[3] = {x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)}, along = fmin(fmax(p[1], 5.3), 26.7);
                    inside += hypot(hypot(p[0] - 16.1, p[2] - 15.8), p[1] - along) < 3.9;
                }
                if (inside != 0 && inside != 8) codes[n++] = svo_morton_encode(x, y, z);
            }
    *codes_out = codes, *count_out = n;
    return packer_make(DEPTH, codes, n, &o);
}

static bool filled(const svo_view *v, svo_vec3 p)
{
    double c[3] = {p.x, p.y, p.z};
    uint32_t cell[3];
    for (int k = 0; k < 3; k++) {
        double x = (c[k] - v->voxel_to_world[4 * k + 3]) / v->voxel_to_world[5 * k];
        if (x < 0 || x >= ldexp(1, (int)v->depth)) return false;
        cell[k] = (uint32_t)x;
    }
    return svo_view_voxel(v, cell[0], cell[1], cell[2], NULL);
}

/* Turn about x (degrees) about a point on the limb's middle line. */
static svo_mat4 turned(double y, double degrees)
{
    double half = degrees * 3.14159265358979 / 360;
    svo_mat4 there = svo_mat4_trs((double[3]){16, y, 16}, (double[4]){sin(half), 0, 0, cos(half)}, (double[3]){1, 1, 1}), back = svo_mat4_identity();
    back.m[3] = -16, back.m[7] = -y, back.m[11] = -16;
    return svo_mat4_mul(there, back);
}

static svo_vec3 limb_point(const rigged *r, const svo_mat4 *place, double cell_y, svo_vec3 p)
{
    double by_bone[BONES + 1] = {0};
    uint8_t w[3];
    weights_at(cell_y + 0.5, w);
    for (int i = 0; i < 3; i++) by_bone[i] = w[i] / 255.0;
    return blend_point(r, place, by_bone, p);
}

static void check_limb(const svo_view *view, const uint64_t *codes, uint64_t count, const rigged *r, const svo_view *octree, const svo_scene *posed, bool closed)
{
    svo_error err = {0};
    svo_mat4 id = svo_mat4_identity();
    uint64_t seed = 12;
    for (int i = 0; i < 20000; i++) {
        uint32_t c[3], at[3];
        double s[3];
        svo_morton_decode(codes[test_random(&seed) % count], &c[0], &c[1], &c[2]);
        svo_vec3 p = {c[0] + test_random_unit(&seed), c[1] + test_random_unit(&seed), c[2] + test_random_unit(&seed)};
        CHECK(filled(octree, limb_point(r, &id, c[1], p)));
        for (int k = 0; k < 3; k++) at[k] = c[k] + (uint32_t)(test_random(&seed) % 3) - 1;
        if (at[0] >= SIDE || at[1] >= SIDE || at[2] >= SIDE || !svo_view_voxel(view, at[0], at[1], at[2], NULL)) continue;
        /* what both share goes to two places: what is between them is filled */
        for (int k = 0; k < 3; k++) s[k] = at[k] > c[k] ? c[k] + 1 : at[k] < c[k] ? c[k] : c[k] + test_random_unit(&seed);
        svo_vec3 a = limb_point(r, &id, c[1], svo_v3(s[0], s[1], s[2])), b = limb_point(r, &id, at[1], svo_v3(s[0], s[1], s[2]));
        double t = test_random_unit(&seed);
        CHECK(filled(octree, svo_add(svo_scale(a, 1 - t), svo_scale(b, t))));
    }
    if (!closed) return;
    svo_bvh *bvh;
    CHECK_OK(svo_bvh_build(posed, 1, NULL, NULL, &bvh, NULL, &err));
    for (int i = 0; i < 20000; i++) { /* no ray from inside gets out */
        double y = between(&seed, 5, 27);
        svo_scene_ray ray = {.origin = limb_point(r, &id, floor(y), svo_v3(16, y, 16)), .t_max = INFINITY};
        ray.direction = svo_v3(between(&seed, -1, 1), between(&seed, -1, 1), between(&seed, -1, 1));
        svo_scene_hit hit;
        svo_scene_trace(bvh, &ray, 1, &hit);
        CHECK_MSG(hit.node.hit, "ray %d passes between voxels", i);
    }
    svo_bvh_free(bvh);
}

/* A limb that bends at two blended joints, and one that is torn by any matrices. */
TEST(no_ray_passes_between_the_voxels_of_a_bent_limb)
{
    svo_error err = {0};
    uint64_t *codes, count, seed = 5;
    svo_view *view = limb(&codes, &count);
    for (int round = 0; round < 5; round++) {
        rigged r;
        random_rig(&r, &seed, round == 4 ? SVO_POSE_TWIST : 0);
        r.pose.bone_count = 3;
        if (round < 3) {
            svo_mat4 m[3] = {svo_mat4_identity(), turned(10, 25 * (round + 1)), svo_mat4_mul(turned(10, 25 * (round + 1)), turned(17, 20 * (round + 1)))};
            for (int b = 0; b < 3; b++)
                for (int i = 0; i < 12; i++) r.matrix[12 * b + i] = (float)m[b].m[i];
        }
        svo_scene_one one;
        CHECK_OK(svo_scene_single(view, "", NULL, &one, &err));
        uint32_t number = 0;
        svo_scene scene = one.scene;
        scene.instance_pose = &number;
        scene.poses = r.all;
        CHECK(svo_pose_fault(&scene.poses, &r.pose) == NULL);
        for (int k = 0; k < 3; k++) one.page.low[k] = -100, one.page.high[k] = 100;
        for (int m = 0; m < 4 && !test_failed(); m++) {
            svo_unpose_options o = {.method = m % 2 == 0 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT};
            o.select = (svo_select_options){.width = 640, .height = 480, .delta = 1, .whole = m < 2};
            CHECK_OK(svo_eye_look(svo_v3(60, 50, 90), svo_v3(16, 16, 16), svo_v3(0, 1, 0), 0.8, &o.select.eye, &err));
            svo_unposed *u;
            CHECK_OK(svo_unpose(&scene, &o, &u, NULL, &err));
            CHECK_OK(svo_view_validate(svo_unposed_view(u), NULL, &err));
            check_limb(view, codes, count, &r, svo_unposed_view(u), svo_unposed_scene(u), round < 3);
            svo_unposed_free(u);
        }
        if (test_failed()) break;
    }
    packer_free(view);
    free(codes);
}

/* Ranges of a node hold those of the nodes below it, so that its box holds theirs; and the extents of bones hold their voxels. */
TEST(nodes_hold_the_bones_of_their_parts)
{
    svo_error err = {0};
    uint64_t *codes, count;
    svo_view *view = limb(&codes, &count);
    svo_bones *bones[2];
    svo_extent e;
    for (uint32_t t = 0; t < 2; t++) CHECK_OK(svo_bones_make(view, 1 + 2 * t, NULL, &bones[t], &err));
    CHECK_OK(svo_extent_make(view, true, NULL, &e, &err));
    CHECK(bones[0] != NULL && e.bones == 3);
    for (uint64_t i = 0; i < count; i++) {
        uint32_t c[3];
        uint8_t w[3];
        svo_morton_decode(codes[i], &c[0], &c[1], &c[2]);
        weights_at(c[1] + 0.5, w);
        for (uint32_t level = DEPTH + 1; level-- > 0;) {
            uint32_t at[3] = {c[0] >> (DEPTH - level), c[1] >> (DEPTH - level), c[2] >> (DEPTH - level)};
            svo_bone_list l = svo_bones_at(bones[0], level, at), again = svo_bones_at(bones[1], level, at);
            CHECK(l.range != NULL && again.count == l.count && memcmp(l.range, again.range, l.count * sizeof *l.range) == 0);
            for (uint32_t b = 0; b < 3; b++) {
                uint32_t k = 0;
                while (k < l.count && l.range[k].bone != b) k++;
                CHECK(k < l.count ? l.range[k].low <= w[b] && w[b] <= l.range[k].high : w[b] == 0);
            }
        }
        for (uint32_t b = 0; b < 3; b++)
            for (int k = 0; w[b] != 0 && k < 3; k++) CHECK(e.box[6 * b + (uint32_t)k] <= c[k] && c[k] + 1 <= e.box[6 * b + 3 + (uint32_t)k]);
    }
    for (int t = 0; t < 2; t++) svo_bones_free(bones[t]);
    svo_extent_free(&e);
    packer_free(view);
    free(codes);
}
