/* Deformation: every image is inside its box, and what touched still touches, under every finite pose. */
#include "svo_deform.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "svo_morton.h"
#include "svo_pack.h"
#include "svo_resample.h"
#include "test.h"

#define PI 3.14159265358979323846

static double between(uint64_t *seed, double a, double b) { return a + (b - a) * test_random_unit(seed); }

/* ---- poses ------------------------------------------------------------------------------------------------------------ */

typedef struct posed {
    svo_pose pose;
    float matrix[12];
    svo_poses all;
} posed;

/* A pose as stated, in double precision. */
typedef struct spec {
    uint32_t flags;
    uint8_t twist_axis, bend_axis, bend_towards;
    double twist_angle, bend_angle, twist_range[2], bend_range[2];
    bool has_twist_range, has_bend_range;
    svo_mat4 matrix;
} spec;

static void finish(posed *p, const spec *s, double size)
{
    double low[3] = {0, 0, 0}, high[3] = {size, size, size};
    p->pose = svo_pose_stated();
    p->pose.flags = s->flags;
    if ((s->flags & SVO_POSE_TWIST) != 0) p->pose.twist_axis = s->twist_axis, p->pose.twist_angle = (float)s->twist_angle;
    if ((s->flags & SVO_POSE_BEND) != 0) p->pose.bend_axis = s->bend_axis, p->pose.bend_towards = s->bend_towards, p->pose.bend_angle = (float)s->bend_angle;
    if (s->has_twist_range) p->pose.twist_from = (float)s->twist_range[0], p->pose.twist_to = (float)s->twist_range[1];
    if (s->has_bend_range) p->pose.bend_from = (float)s->bend_range[0], p->pose.bend_to = (float)s->bend_range[1];
    for (int i = 0; i < 12; i++) p->matrix[i] = (float)s->matrix.m[i];
    svo_pose_resolve(&p->pose, low, high);
    p->all = (svo_poses){.count = 1, .pose = &p->pose, .matrix_count = 1, .matrix = p->matrix};
}

/* Named extreme poses, then random ones. */
enum { NAMED = 16, POSES = 48 };

static svo_mat4 rows(double a, double b, double c, double d, double e, double f, double g, double h, double i)
{
    svo_mat4 m = {{a, b, c, 0, d, e, f, 0, g, h, i, 0, 0, 0, 0, 1}};
    return m;
}

static void make_pose(int which, double size, posed *out)
{
    uint64_t seed = 77 + (uint64_t)which;
    spec s = {0};
    s.matrix = svo_mat4_identity();
    switch (which) {
    case 0: break; /* rest */
    case 1: s.flags = SVO_POSE_TWIST, s.twist_axis = 1, s.twist_angle = 50 * 2 * PI; break; /* 50 turns */
    case 2: s.flags = SVO_POSE_MATRIX, s.matrix = rows(1, 0, 0, 0, 1, 0, 0, 0, 0); break;   /* singular: a plane */
    case 3: s.flags = SVO_POSE_MATRIX, s.matrix = rows(1, 1, 1, 2, 2, 2, 3, 3, 3); break;   /* singular: a line */
    case 4: s.flags = SVO_POSE_MATRIX, s.matrix = rows(0, 0, 0, 0, 0, 0, 0, 0, 0); break;   /* a point */
    case 5: s.flags = SVO_POSE_MATRIX, s.matrix = rows(-1, 0, 0, 0, 1, 0, 0, 0, 1); break;  /* reflection */
    case 6: s.flags = SVO_POSE_MATRIX, s.matrix = rows(1, 0, 0, 0, 1, 1, 0, 1, 1 + 1e-12); break; /* near singular */
    case 7: s.flags = SVO_POSE_MATRIX, s.matrix = rows(1, 1e6, 0, 0, 1, 0, 0, 0, 1); break; /* shear of 1e6 */
    case 8: s.flags = SVO_POSE_MATRIX, s.matrix = rows(1e-6, 0, 0, 0, 1e-6, 0, 0, 0, 1e-6); break;
    case 9: s.flags = SVO_POSE_MATRIX, s.matrix = rows(1e6, 0, 0, 0, 1e6, 0, 0, 0, 1e6); break;
    case 10: s.flags = SVO_POSE_BEND, s.bend_axis = 1, s.bend_towards = 0, s.bend_angle = 4 * PI; break; /* folds onto itself twice */
    case 11: s.flags = SVO_POSE_BEND, s.bend_axis = 1, s.bend_towards = 2, s.bend_angle = 1e-9; break;
    case 12: s.flags = SVO_POSE_TWIST | SVO_POSE_BEND, s.twist_axis = 1, s.twist_angle = 3, s.bend_axis = 1, s.bend_towards = 0, s.bend_angle = 2; break;
    case 13: /* the bend goes through the middle of its circle: slices cross */
        s.flags = SVO_POSE_BEND, s.bend_axis = 0, s.bend_towards = 1, s.bend_angle = 20, s.has_bend_range = true, s.bend_range[0] = 0.4 * size, s.bend_range[1] = 0.6 * size;
        break;
    case 14: s.flags = SVO_POSE_TWIST, s.twist_axis = 2, s.twist_angle = PI, s.has_twist_range = true, s.twist_range[0] = s.twist_range[1] = 0.5 * size; break; /* in no length */
    case 15: s.flags = SVO_POSE_MATRIX | SVO_POSE_TWIST, s.twist_axis = 0, s.twist_angle = -5, s.matrix = rows(1, 3, 0, 0, 1, -2, 0.5, 0, -1); break;
    default: {
        s.flags = (uint32_t)test_random(&seed) & (SVO_POSE_TWIST | SVO_POSE_BEND | SVO_POSE_MATRIX);
        s.twist_axis = (uint8_t)(test_random(&seed) % 3);
        s.bend_axis = (uint8_t)(test_random(&seed) % 3);
        s.bend_towards = (uint8_t)((s.bend_axis + 1 + test_random(&seed) % 2) % 3);
        s.twist_angle = between(&seed, -9, 9);
        s.bend_angle = between(&seed, -6, 6);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) s.matrix.m[4 * i + j] = between(&seed, -2, 2);
        s.has_twist_range = s.has_bend_range = test_random(&seed) % 2 != 0;
        s.twist_range[0] = between(&seed, 0, 0.5 * size), s.twist_range[1] = between(&seed, 0.5 * size, size);
        s.bend_range[0] = between(&seed, 0, 0.5 * size), s.bend_range[1] = between(&seed, 0.5 * size, size);
    }
    }
    finish(out, &s, size);
}

static svo_mat4 random_place(uint64_t *seed)
{
    double t[3] = {between(seed, -5, 5), between(seed, -5, 5), between(seed, -5, 5)};
    double q[4] = {between(seed, -1, 1), between(seed, -1, 1), between(seed, -1, 1), between(seed, -1, 1)};
    double s[3] = {between(seed, 0.2, 3), between(seed, 0.2, 3), between(seed, -3, -0.2)};
    return svo_mat4_trs(t, q, s);
}

TEST(faults_and_rest)
{
    posed p;
    for (int i = 0; i < POSES; i++) {
        make_pose(i, 8, &p);
        CHECK_MSG(svo_pose_fault(&p.all, &p.pose) == NULL, "pose %d: %s", i, svo_pose_fault(&p.all, &p.pose));
    }
    make_pose(0, 8, &p);
    CHECK(svo_pose_is_rest(&p.all, &p.pose));
    make_pose(1, 8, &p);
    CHECK(!svo_pose_is_rest(&p.all, &p.pose));
    p.pose.twist_angle = NAN;
    CHECK(svo_pose_fault(&p.all, &p.pose) != NULL);
    make_pose(2, 8, &p);
    p.pose.matrix = 1;
    CHECK(svo_pose_fault(&p.all, &p.pose) != NULL);
    make_pose(10, 8, &p);
    p.pose.bend_towards = p.pose.bend_axis;
    CHECK(svo_pose_fault(&p.all, &p.pose) != NULL);
}

/* The map itself, against formulas written down another way. */
TEST(twist_and_bend_do_what_they_say)
{
    svo_mat4 id = svo_mat4_identity();
    spec s = {.flags = SVO_POSE_TWIST, .twist_axis = 1, .twist_angle = PI / 2};
    posed p;
    finish(&p, &s, 8); /* about x = z = 4, from y = 0 to 8 */
    svo_deform d = svo_deform_make(&p.all, &p.pose, &id, &id);
    svo_vec3 q = svo_deform_point(&d, SVO_NO_BONE, svo_v3(4, 8, 6)); /* +z turns to +x about +y */
    CHECK(fabs(q.x - 6) < 1e-6 && fabs(q.y - 8) < 1e-6 && fabs(q.z - 4) < 1e-6);
    q = svo_deform_point(&d, SVO_NO_BONE, svo_v3(4, 4, 6));
    CHECK(fabs(q.x - 4 - sqrt(2)) < 1e-6 && fabs(q.z - 4 - sqrt(2)) < 1e-6);
    s = (spec){.flags = SVO_POSE_BEND, .bend_axis = 1, .bend_towards = 0, .bend_angle = PI / 2};
    finish(&p, &s, 8);
    d = svo_deform_make(&p.all, &p.pose, &id, &id);
    /* the middle line, 8 long, becomes a quarter of a circle of radius 16 / pi */
    double radius = 16 / PI;
    q = svo_deform_point(&d, SVO_NO_BONE, svo_v3(4, 8, 4));
    CHECK(fabs(q.x - 4 - radius) < 1e-6 && fabs(q.y - radius) < 1e-6 && fabs(q.z - 4) < 1e-9);
    double length = 0;
    svo_vec3 last = svo_deform_point(&d, SVO_NO_BONE, svo_v3(4, 0, 4));
    for (int i = 1; i <= 1000; i++) {
        q = svo_deform_point(&d, SVO_NO_BONE, svo_v3(4, 0.008 * i, 4));
        length += svo_length(svo_sub(q, last));
        last = q;
    }
    CHECK(fabs(length - 8) < 1e-4);
    /* beyond the end everything goes on straight, to the right */
    q = svo_deform_point(&d, SVO_NO_BONE, svo_v3(4, 10, 4));
    CHECK(fabs(q.x - 4 - radius - 2) < 1e-6 && fabs(q.y - radius) < 1e-6);
}

/* Figure 16 is what a box's image is at least: the images under the matrices at both ends are in it. */
TEST(figure_16_is_inside)
{
    uint64_t seed = 5;
    posed p;
    spec s = {.flags = SVO_POSE_TWIST, .twist_axis = 1, .twist_angle = 2};
    finish(&p, &s, 16);
    svo_mat4 id = svo_mat4_identity();
    svo_deform d = svo_deform_make(&p.all, &p.pose, &id, &id);
    for (int i = 0; i < 200; i++) {
        double low[3], high[3], a[3], b[3], out_low[3], out_high[3];
        for (int k = 0; k < 3; k++) low[k] = floor(between(&seed, 0, 16)), high[k] = low[k] + 1;
        svo_mat4 m[2];
        for (int e = 0; e < 2; e++) {
            double y = e == 0 ? low[1] : high[1], angle = 2 * y / 16;
            svo_mat4 to = svo_mat4_identity(), back = to, turn = rows(cos(angle), 0, sin(angle), 0, 1, 0, -sin(angle), 0, cos(angle));
            for (int k = 0; k < 3; k++) to.m[4 * k + 3] = -8, back.m[4 * k + 3] = 8;
            m[e] = svo_mat4_mul(back, svo_mat4_mul(turn, to));
        }
        svo_deform_two(m, low, high, a, b);
        svo_deform_box(&d, SVO_NO_BONE, low, high, out_low, out_high);
        for (int k = 0; k < 3; k++) {
            CHECK(out_low[k] <= a[k] + 1e-9 && out_high[k] >= b[k] - 1e-9);
            CHECK(a[k] - out_low[k] < 0.0222 && out_high[k] - b[k] < 0.0222); /* and it is hardly larger: 11.32 * 0.125^2 / 8 */
        }
    }
}

TEST(boxes_hold_the_images_of_their_points_and_parts)
{
    for (int which = 0; which < POSES; which++) {
        posed p;
        make_pose(which, 64, &p);
        uint64_t seed = 900 + (uint64_t)which;
        svo_mat4 id = svo_mat4_identity(), place = random_place(&seed);
        svo_deform d = svo_deform_make(&p.all, &p.pose, &id, &place);
        for (int i = 0; i < 60; i++) {
            double edge = ldexp(1, (int)(test_random(&seed) % 7)), low[3], high[3], out_low[3], out_high[3];
            for (int k = 0; k < 3; k++) low[k] = edge * floor(between(&seed, 0, 64 / edge)), high[k] = low[k] + edge;
            svo_deform_box(&d, SVO_NO_BONE, low, high, out_low, out_high);
            for (int t = 0; t < 60; t++) {
                double at[3];
                for (int k = 0; k < 3; k++) at[k] = t < 8 ? (t >> k & 1 ? high[k] : low[k]) : between(&seed, low[k], high[k]);
                svo_vec3 q = svo_deform_point(&d, SVO_NO_BONE, svo_v3(at[0], at[1], at[2]));
                CHECK_MSG(q.x >= out_low[0] && q.x <= out_high[0] && q.y >= out_low[1] && q.y <= out_high[1] && q.z >= out_low[2] && q.z <= out_high[2],
                          "pose %d, box %d: a point leaves its box", which, i);
            }
        }
    }
}

/* Whatever was asked for before, of this map or of others. */
TEST(kept_slices_change_no_box)
{
    svo_slice_cache *kept = calloc(1, sizeof *kept);
    uint64_t seed = 12;
    for (int round = 0; round < 2 && kept != NULL; round++)
        for (int which = 0; which < POSES; which++) {
            posed p;
            make_pose(which, 64, &p);
            svo_mat4 id = svo_mat4_identity(), place = random_place(&seed);
            svo_deform d = svo_deform_make(&p.all, &p.pose, &id, &place), with = d;
            kept->map++;
            with.kept = kept;
            for (int i = 0; i < 400; i++) {
                const double edge = ldexp(1, (int)(test_random(&seed) % 7));
                double low[3], high[3], a[2][3], b[2][3];
                for (int k = 0; k < 3; k++) low[k] = edge * floor(between(&seed, 0, 64 / edge)), high[k] = low[k] + edge;
                svo_deform_box(&d, SVO_NO_BONE, low, high, a[0], a[1]);
                svo_deform_box(&with, SVO_NO_BONE, low, high, b[0], b[1]);
                CHECK_MSG(memcmp(a, b, sizeof a) == 0, "pose %d, box %d", which, i);
            }
        }
    CHECK(kept != NULL);
    free(kept);
}

TEST(normals_follow_the_surface)
{
    uint64_t seed = 3;
    for (int which = 16; which < POSES; which++) {
        posed p;
        make_pose(which, 64, &p);
        svo_mat4 id = svo_mat4_identity(), place = random_place(&seed);
        svo_deform d = svo_deform_make(&p.all, &p.pose, &id, &place);
        for (int i = 0; i < 50; i++) {
            svo_vec3 at = svo_v3(between(&seed, 5, 59), between(&seed, 5, 59), between(&seed, 5, 59));
            svo_vec3 n = svo_normalize(svo_v3(between(&seed, -1, 1), between(&seed, -1, 1), between(&seed, -1, 1)));
            svo_vec3 a = svo_normalize(svo_cross(n, svo_v3(0.3, 0.5, 0.8))), b = svo_cross(n, a);
            svo_vec3 m = svo_deform_normal(&d, SVO_NO_BONE, at, 0.01, n), o = svo_deform_point(&d, SVO_NO_BONE, at);
            if (svo_dot(m, m) == 0) continue;
            for (int t = 0; t < 2; t++) { /* tangents stay at right angles to it */
                svo_vec3 step = svo_scale(t == 0 ? a : b, 1e-4);
                svo_vec3 v = svo_sub(svo_deform_point(&d, SVO_NO_BONE, svo_add(at, step)), svo_deform_point(&d, SVO_NO_BONE, svo_sub(at, step)));
                CHECK_MSG(fabs(svo_dot(svo_normalize(v), m)) < 1e-4, "pose %d: normal leans %g", which, svo_dot(svo_normalize(v), m));
            }
            svo_vec3 out = svo_sub(svo_deform_point(&d, SVO_NO_BONE, svo_add(at, svo_scale(n, 1e-4))), o);
            CHECK(svo_dot(out, m) > 0); /* outside stays outside */
        }
    }
}

/* ---- no gaps ------------------------------------------------------------------------------------------------------------ */

enum { DEPTH = 5, SIDE = 1 << DEPTH };

/* A closed surface: the voxels that a sphere meets. */
static svo_view *sphere(uint64_t **codes_out, uint64_t *count_out)
{
    uint64_t *codes = malloc(8 * SIDE * SIDE * SIDE), n = 0;
    double radius = 0.42 * SIDE;
    for (uint32_t z = 0; z < SIDE; z++)
        for (uint32_t y = 0; y < SIDE; y++)
            for (uint32_t x = 0; x < SIDE; x++) {
                double near = 0, far = 0;
                uint32_t c[3] = {x, y, z};
                for (int k = 0; k < 3; k++) {
                    double a = c[k] - 0.5 * SIDE, b = a + 1, least = a > 0 ? a : b < 0 ? -b : 0, most = fmax(fabs(a), fabs(b));
                    near += least * least, far += most * most;
                }
                if (near <= radius * radius && far >= radius * radius) codes[n++] = svo_morton_encode(x, y, z);
            }
    packer_options o = {.lod = true, .unnumbered = true};
    *codes_out = codes, *count_out = n;
    return packer_make(DEPTH, codes, n, &o);
}

typedef struct world {
    svo_view *view;
    uint64_t *codes, count;
    svo_scene_one single;
    svo_scene scene;
    posed p;
    uint32_t instance_pose;
} world;

static void world_make(world *w, int which, const svo_mat4 *place)
{
    svo_error err;
    memset(w, 0, sizeof *w);
    w->view = sphere(&w->codes, &w->count);
    CHECK_OK(svo_scene_single(w->view, "", NULL, &w->single, &err));
    make_pose(which, SIDE, &w->p);
    for (int i = 0; i < 12; i++) w->single.transform[i] = (float)place->m[i];
    w->scene = w->single.scene;
    w->scene.instance_pose = &w->instance_pose;
    w->scene.poses = w->p.all;
    for (int k = 0; k < 3; k++) w->single.page.low[k] = -1e9, w->single.page.high[k] = 1e9;
}

static void world_free(world *w)
{
    packer_free(w->view);
    free(w->codes);
}

static svo_select_options looking(bool whole)
{
    svo_select_options o = {.width = 640, .height = 480, .delta = 1, .whole = whole};
    svo_error err;
    if (svo_eye_look(svo_v3(60, 50, 90), svo_v3(0, 0, 0), svo_v3(0, 1, 0), 0.8, &o.eye, &err) != SVO_OK) abort();
    return o;
}

/* Is the point in a filled cell? */
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

/* Every image of a point that was in a voxel is in a filled cell; so the image of a joined surface is joined. */
static void check_covered(const world *w, const svo_view *octree, int which, const char *method, uint64_t *seed)
{
    svo_mat4 id = svo_mat4_identity(), place = svo_scene_instance_transform(&w->scene, 0, 0);
    svo_deform d = svo_deform_make(&w->p.all, &w->p.pose, &id, &place);
    for (int i = 0; i < 3000; i++) {
        uint32_t c[3];
        svo_morton_decode(w->codes[test_random(seed) % w->count], &c[0], &c[1], &c[2]);
        double at[3];
        for (int k = 0; k < 3; k++) {
            uint64_t r = test_random(seed) % 4; /* often on the faces, edges and corners that neighbours share */
            at[k] = c[k] + (r == 0 ? 0 : r == 1 ? 1 : test_random_unit(seed));
        }
        svo_vec3 q = svo_deform_point(&d, SVO_NO_BONE, svo_v3(at[0], at[1], at[2]));
        /* a float's rounding of the box's ends is outwards, so nothing is lost by it */
        CHECK_MSG(filled(octree, q), "pose %d, %s: the image of a voxel's point is not covered", which, method);
    }
}

/* Nodes by the length of their boxes: each is short enough or a finest voxel, and there are fewer the longer they may be. */
TEST(nodes_of_a_length)
{
    svo_error err = {0};
    const svo_mat4 place = svo_mat4_identity();
    for (int which = 0; which < NAMED && !test_failed(); which++) {
        world w;
        uint64_t before = UINT64_MAX;
        world_make(&w, which, &place);
        for (double edge = 0; edge < 100 && !test_failed(); edge = edge == 0 ? 1 : 2 * edge) {
            svo_select_options o = looking(true);
            svo_selection s;
            uint64_t longer = 0;
            o.edge = edge;
            CHECK_OK(svo_select(&w.scene, &o, &s, &err));
            for (uint64_t i = 0; i < s.count; i++)
                for (int k = 0; k < 3; k++)
                    if (s.boxes[i].high[k] - s.boxes[i].low[k] > edge * (1 + 1e-6) + 1e-4) {
                        longer++;
                        break;
                    }
            CHECK_MSG(longer <= s.report.finest, "pose %d, edge %g: %llu of %llu boxes are longer, %llu are finest voxels", which, edge, (unsigned long long)longer,
                      (unsigned long long)s.count, (unsigned long long)s.report.finest);
            CHECK_MSG(s.count <= before && (edge != 0 || s.report.finest == s.count), "pose %d: more nodes for longer ones", which);
            before = s.count;
            svo_selection_free(&s);
        }
        world_free(&w);
    }
}

TEST(no_gap_under_any_pose)
{
    svo_error err = {0};
    for (int which = 0; which < NAMED + 8; which++) {
        uint64_t seed = 40 + (uint64_t)which;
        svo_mat4 place = which % 2 == 0 ? svo_mat4_identity() : random_place(&seed);
        world w;
        world_make(&w, which, &place);
        if (test_failed()) return;
        for (int m = 0; m < 2 && !test_failed(); m++)
            for (int whole = 0; whole < 3 && !test_failed(); whole++) {
                svo_unpose_options o = {.select = looking(whole != 0), .method = m == 0 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT};
                if (whole == 2) o.select.edge = 6, o.most_cells = 64; /* coarser nodes, and few cells of each */
                svo_unposed *u;
                svo_unpose_report r;
                CHECK_OK(svo_unpose(&w.scene, &o, &u, &r, &err));
                CHECK_U64(r.select.overflowed, 0);
                CHECK_OK(svo_view_validate(svo_unposed_view(u), NULL, &err));
                if (whole == 1) CHECK_U64(r.select.selected, w.count);
                check_covered(&w, svo_unposed_view(u), which, m == 0 ? "resize" : "emit", &seed);
                svo_unposed_free(u);
            }
        world_free(&w);
        if (test_failed()) return;
    }
}

/* Rays from inside a closed surface never get out, whatever happens to it (poses that keep an inside). */
TEST(no_ray_passes_between_neighbours)
{
    static const int poses[] = {0, 1, 5, 15};
    svo_error err = {0};
    for (size_t n = 0; n < sizeof poses / sizeof poses[0]; n++) {
        uint64_t seed = 11;
        svo_mat4 place = random_place(&seed);
        world w;
        world_make(&w, poses[n], &place);
        for (int m = 0; m < 2; m++) {
            svo_unpose_options o = {.select = looking(true), .method = m == 0 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT};
            svo_unposed *u;
            CHECK_OK(svo_unpose(&w.scene, &o, &u, NULL, &err));
            svo_bvh *bvh;
            CHECK_OK(svo_bvh_build(svo_unposed_scene(u), 1, NULL, NULL, &bvh, NULL, &err));
            svo_mat4 id = svo_mat4_identity();
            svo_deform d = svo_deform_make(&w.p.all, &w.p.pose, &id, &place);
            svo_vec3 middle = svo_deform_point(&d, SVO_NO_BONE, svo_v3(0.5 * SIDE, 0.5 * SIDE, 0.5 * SIDE));
            for (int i = 0; i < 20000; i++) {
                svo_scene_ray ray = {.origin = middle, .t_max = INFINITY};
                ray.direction = svo_v3(between(&seed, -1, 1), between(&seed, -1, 1), between(&seed, -1, 1));
                svo_scene_hit hit;
                svo_scene_trace(bvh, &ray, 1, &hit);
                CHECK_MSG(hit.node.hit, "pose %d: ray %d passes", poses[n], i);
            }
            svo_bvh_free(bvh);
            svo_unposed_free(u);
        }
        world_free(&w);
    }
}

/* ---- selection ----------------------------------------------------------------------------------------------------------- */

/* What is taken is small enough, and what was split was not; threads do not matter. */
TEST(selection_stops_where_voxels_are_small)
{
    svo_error err = {0};
    svo_mat4 place = svo_mat4_identity();
    world w;
    world_make(&w, 12, &place);
    svo_select_options o = looking(false);
    uint64_t last = UINT64_MAX;
    for (double delta = 0.25; delta < 100; delta *= 2) {
        svo_selection a, b;
        o.delta = delta;
        o.threads = 1;
        CHECK_OK(svo_select(&w.scene, &o, &a, &err));
        o.threads = 3;
        CHECK_OK(svo_select(&w.scene, &o, &b, &err));
        CHECK_U64(a.count, b.count);
        CHECK(memcmp(a.boxes, b.boxes, a.count * sizeof *a.boxes) == 0);
        CHECK(a.count <= last);
        CHECK(a.count > 0 && a.count <= w.count);
        last = a.count;
        svo_selection_free(&a);
        svo_selection_free(&b);
    }
    CHECK_MSG(last < w.count / 4, "%llu of %llu", (unsigned long long)last, (unsigned long long)w.count);
    world_free(&w);
}

/* ---- bones -------------------------------------------------------------------------------------------------------------- */

static uint16_t label_of(uint32_t x, uint32_t y) { return y < 14 ? 0 : x < 16 ? 1 : y > 26 ? 0xffff : 2; }

static void bone_value(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    (void)user, (void)channel, (void)z;
    uint16_t label = label_of(x, y);
    memcpy(out, &label, 2);
}

/* Voxels that touch still touch where bones tear them apart: each box holds the image of every corner that it shares with a neighbour, under the neighbour's
 * bone too. And the filled cells hold every voxel's image under its own bone. */
TEST(no_gap_between_bones)
{
    svo_error err = {0};
    uint64_t *codes, count, seed = 4;
    packer_free(sphere(&codes, &count));
    packer_options po = {.lod = true, .channel_count = 1, .value = bone_value};
    strcpy(po.channels[0].name, "bone");
    po.channels[0].kind = SVO_KIND_ID16;
    svo_view *view = packer_make(DEPTH, codes, count, &po);
    svo_mat4 bones[3] = {svo_mat4_trs((double[3]){0, 0, 0}, (double[4]){0, 0, 0, 1}, (double[3]){1, 1, 1}),
                         svo_mat4_trs((double[3]){-9, 4, 2}, (double[4]){0, 0.3, 0.2, 1}, (double[3]){1, 1, 1}),
                         svo_mat4_trs((double[3]){7, 9, -3}, (double[4]){0.3, 0, 0, 1}, (double[3]){1.5, 1, 1})};
    float matrices[36];
    for (int b = 0; b < 3; b++)
        for (int i = 0; i < 12; i++) matrices[12 * b + i] = (float)bones[b].m[i];
    svo_pose pose = {.flags = SVO_POSE_BONES, .bone_count = 3};
    svo_scene_one one;
    CHECK_OK(svo_scene_single(view, "", NULL, &one, &err));
    uint32_t number = 0;
    svo_scene scene = one.scene;
    scene.instance_pose = &number;
    scene.poses = (svo_poses){.count = 1, .pose = &pose, .matrix_count = 3, .matrix = matrices};
    CHECK(svo_pose_fault(&scene.poses, &pose) == NULL);
    for (int k = 0; k < 3; k++) one.page.low[k] = -100, one.page.high[k] = 100;
    svo_mat4 id = svo_mat4_identity();
    svo_deform d = svo_deform_make(&scene.poses, &pose, &id, &id);
    for (int m = 0; m < 2; m++) {
        svo_unpose_options o = {.select = looking(true), .method = m == 0 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT};
        svo_unposed *u;
        CHECK_OK(svo_unpose(&scene, &o, &u, NULL, &err));
        const svo_view *v = svo_unposed_view(u);
        CHECK_OK(svo_view_validate(v, NULL, &err));
        for (int i = 0; i < 20000; i++) {
            uint32_t c[3], at[3];
            svo_morton_decode(codes[test_random(&seed) % count], &c[0], &c[1], &c[2]);
            uint32_t bone = label_of(c[0], c[1]) == 0xffff ? SVO_NO_BONE : label_of(c[0], c[1]);
            svo_vec3 p = {c[0] + test_random_unit(&seed), c[1] + test_random_unit(&seed), c[2] + test_random_unit(&seed)};
            CHECK(filled(v, svo_deform_point(&d, bone, p)));
            for (int k = 0; k < 3; k++) at[k] = c[k] + (uint32_t)(test_random(&seed) % 3) - 1;
            if (at[0] >= SIDE || at[1] >= SIDE || at[2] >= SIDE || !svo_view_voxel(view, at[0], at[1], at[2], NULL)) continue;
            /* a shared point under one bone and the other: what is between is filled, so that no ray passes there */
            uint32_t other = label_of(at[0], at[1]) == 0xffff ? SVO_NO_BONE : label_of(at[0], at[1]);
            double s[3];
            for (int k = 0; k < 3; k++) s[k] = at[k] > c[k] ? c[k] + 1 : at[k] < c[k] ? c[k] : c[k] + test_random_unit(&seed);
            svo_vec3 a = svo_deform_point(&d, bone, svo_v3(s[0], s[1], s[2])), b = svo_deform_point(&d, other, svo_v3(s[0], s[1], s[2]));
            double t = test_random_unit(&seed);
            CHECK(filled(v, svo_add(svo_scale(a, 1 - t), svo_scale(b, t))));
        }
        svo_unposed_free(u);
    }
    packer_free(view);
    free(codes);
}

/* A grid of posed spheres, many behind others. */
typedef struct crowd {
    svo_view *view;
    svo_scene scene;
    svo_packed_scene *packed;
} crowd;

static void crowd_make(crowd *c, uint32_t side, uint32_t page)
{
    static svo_error err;
    uint64_t *codes, count, seed = 6;
    c->view = sphere(&codes, &count);
    free(codes);
    svo_place *places = calloc(side * side, sizeof *places);
    svo_pose *poses = calloc(side * side, sizeof *poses);
    for (uint32_t i = 0; i < side * side; i++) {
        svo_mat4 m = svo_mat4_trs((double[3]){20.0 * (i % side), 0, -20.0 * (i / side)}, (double[4]){0, (double)i, 0, 1}, (double[3]){1, 1.5, 1});
        memcpy(places[i].transform, m.m, sizeof places[i].transform);
        places[i].id = i, places[i].pose = i + 1;
        poses[i] = svo_pose_stated();
        poses[i].flags = SVO_POSE_TWIST, poses[i].twist_axis = (uint8_t)(i % 3), poses[i].twist_angle = (float)between(&seed, -4, 4);
    }
    svo_pack_input in = {.asset_count = 1, .assets = (const svo_view *const[]){c->view}, .asset_names = (const char *const[]){""}, .place_count = side * side,
                         .places = places, .poses = {.count = side * side, .pose = poses}};
    svo_pack_options o = {.page_instances = page};
    CHECK_OK(svo_pack(&in, &o, &c->packed, &err));
    c->scene = *svo_packed_scene_get(c->packed);
    free(places);
    free(poses);
}

static void crowd_free(crowd *c)
{
    svo_packed_scene_free(c->packed);
    packer_free(c->view);
}

/* With and without culling the same boxes are seen at the same depths, sample by sample; by instances and by pages; whatever the threads. */
TEST(culling_loses_nothing_that_is_seen)
{
    svo_error err = {0};
    for (int big = 0; big < 2; big++) {
        crowd c;
        crowd_make(&c, big ? 66 : 12, big ? 64 : 16);
        if (test_failed()) return;
        svo_select_options o = {.width = 240, .height = 150, .delta = big ? 6 : 1.5};
        CHECK_OK(svo_eye_look(svo_v3(-30, 40, 60), svo_v3(60, 0, -80), svo_v3(0, 1, 0), 0.9, &o.eye, &err));
        uint64_t samples = 240 * 150, shown = 0;
        uint32_t *owner = malloc(4 * samples);
        float *depth[3];
        svo_selection s[3];
        for (int i = 0; i < 3; i++) {
            o.frustum = o.occlusion = i > 0;
            o.threads = i == 2 ? 3 : 1;
            depth[i] = malloc(4 * samples);
            CHECK_OK(svo_select(&c.scene, &o, &s[i], &err));
            CHECK_OK(svo_select_draw(&s[i], &o, SVO_DRAW_BOXES, owner, depth[i], &err));
        }
        for (uint64_t i = 0; i < samples; i++) shown += isfinite(depth[0][i]) != 0;
        CHECK(shown > samples / 4);
        CHECK(memcmp(depth[0], depth[1], 4 * samples) == 0);
        CHECK_U64(s[1].count, s[2].count);
        CHECK(memcmp(s[1].boxes, s[2].boxes, s[1].count * sizeof *s[1].boxes) == 0);
        CHECK_MSG(s[1].count < s[0].count / 2, "%llu of %llu", (unsigned long long)s[1].count, (unsigned long long)s[0].count);
        for (int i = 0; i < 3; i++) {
            svo_selection_free(&s[i]);
            free(depth[i]);
        }
        free(owner);
        crowd_free(&c);
    }
}

/* One instance alone, which one thread draws at a time: its front hides its back, and what is seen stays the same. */
TEST(a_shape_hides_its_own_back)
{
    enum { WIDTH = 120, HEIGHT = 90, SAMPLES = WIDTH * HEIGHT }; /* too small to be cut into parts */
    svo_error err = {0};
    svo_mat4 place = svo_mat4_identity();
    for (int which = 0; which < POSES && !test_failed(); which++) {
        world w;
        world_make(&w, which, &place);
        svo_select_options o = looking(false);
        o.width = WIDTH, o.height = HEIGHT, o.delta = 0.5;
        uint32_t *owner = malloc(4 * SAMPLES);
        float *depth[2];
        svo_selection s[2];
        for (int i = 0; i < 2; i++) {
            o.frustum = o.occlusion = i > 0;
            o.threads = 1 + (uint32_t)i;
            depth[i] = malloc(4 * SAMPLES);
            CHECK_OK(svo_select(&w.scene, &o, &s[i], &err));
            CHECK_OK(svo_select_draw(&s[i], &o, SVO_DRAW_BOXES, owner, depth[i], &err));
        }
        CHECK(memcmp(depth[0], depth[1], 4 * SAMPLES) == 0);
        CHECK_MSG(which != 0 || s[1].count < s[0].count / 2, "%llu of %llu", (unsigned long long)s[1].count, (unsigned long long)s[0].count);
        for (int i = 0; i < 2; i++) {
            svo_selection_free(&s[i]);
            free(depth[i]);
        }
        free(owner);
        world_free(&w);
    }
}

/* The same for cells: the first hit of every sample's ray is where it is without culling. */
TEST(culling_loses_no_cell_that_is_seen)
{
    svo_error err = {0};
    crowd c;
    crowd_make(&c, 10, 16);
    if (test_failed()) return;
    for (int m = 0; m < 2; m++) {
        svo_unpose_options o = {.select = {.width = 160, .height = 100, .delta = 1}, .method = m == 0 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT};
        CHECK_OK(svo_eye_look(svo_v3(-30, 40, 60), svo_v3(60, 0, -80), svo_v3(0, 1, 0), 0.9, &o.select.eye, &err));
        svo_scene_hit *hits[2];
        uint64_t selected[2];
        for (int i = 0; i < 2; i++) {
            svo_unposed *u;
            svo_unpose_report r;
            svo_bvh *bvh;
            o.select.frustum = o.select.occlusion = i > 0;
            CHECK_OK(svo_unpose(&c.scene, &o, &u, &r, &err));
            CHECK_OK(svo_bvh_build(svo_unposed_scene(u), 1, NULL, NULL, &bvh, NULL, &err));
            selected[i] = r.select.selected;
            hits[i] = malloc(160 * 100 * sizeof *hits[i]);
            svo_render_options ro = svo_default_render_options();
            ro.width = 160, ro.height = 100, ro.footprint = 0, ro.eye = o.select.eye;
            for (uint32_t n = 0; n < 160 * 100; n++) {
                svo_scene_ray ray = svo_render_ray(&ro, n % 160 + 0.5, n / 160 + 0.5);
                svo_scene_trace(bvh, &ray, 1, &hits[i][n]);
            }
            svo_bvh_free(bvh);
            svo_unposed_free(u);
        }
        for (uint32_t n = 0; n < 160 * 100; n++) {
            CHECK(hits[0][n].node.hit == hits[1][n].node.hit);
            if (hits[0][n].node.hit) CHECK_MSG(fabs(hits[0][n].node.t - hits[1][n].node.t) < 1e-9 * hits[0][n].node.t, "method %d, sample %u: %g, %g", m, n, hits[0][n].node.t, hits[1][n].node.t);
        }
        CHECK(selected[1] < selected[0]);
        free(hits[0]);
        free(hits[1]);
    }
    crowd_free(&c);
}

/* Nor a shadow: from every surface that is seen the light is in the way of the same things. */
TEST(culling_loses_no_shadow)
{
    enum { WIDTH = 160, HEIGHT = 100 };
    const svo_vec3 lights[] = {{-0.45, 0.85, 0.65}, {1, 0.1, 0.3}, {0.2, 0.3, -1}, {0, 2, 0}};
    svo_error err = {0};
    uint64_t blocked[2] = {0, 0}, selected[2] = {0, 0};
    for (int light = 0; light < 4 && !test_failed(); light++) {
        svo_unposed *u[2];
        svo_unpose_report r[2];
        svo_bvh *bvh[2];
        crowd c;
        crowd_make(&c, 10, 16);
        svo_unpose_options o = {.select = {.width = WIDTH, .height = HEIGHT, .delta = 1}, .method = light % 2 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT, .shadows = true, .light = lights[light]};
        CHECK_OK(svo_eye_look(light < 2 ? svo_v3(-30, 40, 60) : svo_v3(50, 6, -60), svo_v3(60, 0, -80), svo_v3(0, 1, 0), 0.9, &o.select.eye, &err));
        for (int i = 0; i < 2; i++) {
            o.select.frustum = o.select.occlusion = i > 0;
            CHECK_OK(svo_unpose(&c.scene, &o, &u[i], &r[i], &err));
            CHECK_OK(svo_bvh_build(svo_unposed_scene(u[i]), 1, NULL, NULL, &bvh[i], NULL, &err));
        }
        svo_render_options ro = svo_default_render_options();
        ro.width = WIDTH, ro.height = HEIGHT, ro.footprint = 0, ro.eye = o.select.eye;
        for (uint32_t n = 0; n < WIDTH * HEIGHT && !test_failed(); n++) {
            svo_scene_ray ray = svo_render_ray(&ro, n % WIDTH + 0.5, n / WIDTH + 0.5);
            svo_scene_hit hit[2];
            for (int i = 0; i < 2; i++) svo_scene_trace(bvh[i], &ray, 1, &hit[i]);
            CHECK(hit[0].node.hit == hit[1].node.hit);
            if (!hit[0].node.hit) continue;
            bool dark[2];
            for (int i = 0; i < 2; i++) {
                svo_scene_ray to = ray;
                to.origin = svo_render_shadow_origin(bvh[i], &hit[i], svo_scale(svo_normalize(ray.direction), -1));
                to.direction = lights[light], to.t_max = INFINITY;
                dark[i] = svo_scene_blocked(bvh[i], &to);
            }
            CHECK_MSG(dark[0] == dark[1], "light %d, sample %u: %d, %d", light, n, dark[0], dark[1]);
            blocked[dark[0]]++;
        }
        for (int i = 0; i < 2; i++) selected[i] += r[i].select.selected;
        for (int i = 0; i < 2; i++) svo_bvh_free(bvh[i]), svo_unposed_free(u[i]);
        crowd_free(&c);
    }
    CHECK(blocked[0] > 1000 && blocked[1] > 1000);
    CHECK_MSG(selected[1] < selected[0], "%llu of %llu", (unsigned long long)selected[1], (unsigned long long)selected[0]);
}

TEST(zero_instances_and_empty_assets)
{
    svo_error err = {0};
    svo_scene none = {.names = "", .names_size = 1};
    svo_unpose_options o = {.select = looking(false), .method = SVO_RESAMPLE_EMIT};
    svo_unposed *u;
    CHECK_OK(svo_unpose(&none, &o, &u, NULL, &err));
    CHECK_U64(svo_unposed_scene(u)->instance_count, 0);
    CHECK(svo_unposed_view(u)->empty);
    svo_unposed_free(u);
}
