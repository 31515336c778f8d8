/* Skeletons of voxels: the axis of a tube, hollow equals solid, finer octrees of the same cells give the same, the map. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_svo.h"
#include "skel_shapes.h"
#include "svo_morton.h"
#include "test.h"
#include "trees.h"

static svo_error err;

static int by_code(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return x < y ? -1 : x > y;
}

/* Voxels of 2^depth for which inside() holds; hollow: only those with an outside neighbour. */
typedef bool (*inside_fn)(int x, int y, int z, int n);
static tree make(uint32_t depth, inside_fn inside, bool hollow)
{
    tree t = {.info = {.depth = depth}};
    for (int i = 0; i < 4; i++) t.info.voxel_to_world[5 * i] = i < 3 ? 1.0 / (1 << depth) : 1;
    int n = 1 << depth;
    for (int z = 0; z < n; z++)
        for (int y = 0; y < n; y++)
            for (int x = 0; x < n; x++) {
                if (!inside(x, y, z, n)) continue;
                bool deep = inside(x - 1, y, z, n) && inside(x + 1, y, z, n) && inside(x, y - 1, z, n) && inside(x, y + 1, z, n) && inside(x, y, z - 1, n) && inside(x, y, z + 1, n);
                if (hollow && deep) continue;
                if (t.count == t.capacity) t.codes = realloc(t.codes, (t.capacity = t.capacity * 2 + 64) * sizeof *t.codes);
                t.codes[t.count++] = svo_morton_encode((uint32_t)x, (uint32_t)y, (uint32_t)z);
            }
    qsort(t.codes, t.count, sizeof *t.codes, by_code);
    return t;
}

/* Every voxel becomes 8 of the next level: the same solid. */
static tree finer(const tree *t)
{
    tree f = {.info = t->info, .count = 8 * t->count};
    f.info.depth++;
    for (int i = 0; i < 3; i++) f.info.voxel_to_world[5 * i] /= 2;
    f.codes = malloc(f.count * sizeof *f.codes);
    for (uint64_t i = 0; i < f.count; i++) f.codes[i] = t->codes[i / 8] * 8 + i % 8;
    return f;
}

static svo_result build(const tree *t, const skel_options *o, skel_skeleton *s)
{
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    tree_write(t, 1, &file, NULL);
    fmt_input *in = NULL;
    fmt_svo_reader *r;
    svo_result result = fmt_input_open_memory(file.data, file.size, &in, &err);
    if (result == SVO_OK) result = fmt_svo_reader_open(in, o->allocator, &r, &err);
    if (result == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(r);
        result = skel_build_voxels(fmt_svo_reader_info(r), &source, o, s, &err);
        fmt_svo_reader_close(r);
    }
    if (in != NULL) fmt_input_close(in);
    svo_buffer_free(&file);
    return result;
}

static skel_options options(double omega)
{
    skel_options o = skel_default_options();
    o.omega = omega;
    o.threads = 1;
    o.search = SKEL_SEARCH_GRID;
    return o;
}

static bool tube(int x, int y, int z, int n)
{
    double dy = (y + 0.5) / n - 0.5, dz = (z + 0.5) / n - 0.4, at = (x + 0.5) / n;
    return x >= 0 && y >= 0 && z >= 0 && at > 0.05 && at < 0.95 && dy * dy + dz * dz < 0.08 * 0.08;
}

static bool ring(int x, int y, int z, int n)
{
    double dx = (x + 0.5) / n - 0.5, dy = (y + 0.5) / n - 0.5, dz = (z + 0.5) / n - 0.5, r = sqrt(dx * dx + dy * dy) - 0.35;
    return x >= 0 && y >= 0 && z >= 0 && r * r + dz * dz < 0.07 * 0.07;
}

static bool all(int x, int y, int z, int n) { return x >= 0 && y >= 0 && z >= 0 && x < n && y < n && z < n; }

static bool same_curve(const skel_skeleton *a, const skel_skeleton *b)
{
    return a->joint_count == b->joint_count && a->bone_count == b->bone_count && memcmp(a->joints, b->joints, a->joint_count * sizeof *a->joints) == 0 &&
           (a->bone_count == 0 || memcmp(a->bones, b->bones, a->bone_count * sizeof *a->bones) == 0);
}

TEST(tube_axis_and_map)
{
    tree t = make(6, tube, false);
    skel_options o = options(0.05);
    skel_skeleton s;
    CHECK_OK(build(&t, &o, &s));
    CHECK_OK(skel_check(&s, &err));
    CHECK(s.report.converged && s.report.source == SKEL_SOURCE_VOXELS);
    CHECK_U64(s.report.components, 1);
    CHECK_U64(s.report.ends, 2);
    CHECK_U64(s.report.loops, 0);
    CHECK_U64(s.map_count, t.count);
    CHECK_U64(s.report.mapped_count, t.count);
    for (uint32_t j = 0; j < s.joint_count; j++) {
        const double *p = s.joints[j].position;
        CHECK_MSG(hypot(p[1] - 0.5, p[2] - 0.4) < 0.02, "joint %u at %g %g %g", j, p[0], p[1], p[2]);
    }
    for (uint64_t i = 0; i < t.count; i++) { /* inner voxels too: a joint beside each */
        uint32_t x, y, z;
        svo_morton_decode(t.codes[i], &x, &y, &z);
        CHECK(fabs(s.joints[s.map[i]].position[0] - (x + 0.5) / 64) < 0.2);
    }
    skel_skeleton_free(&s);
    tree_free(&t);
}

TEST(hollow_equals_solid)
{
    const inside_fn shapes[] = {tube, ring, all};
    for (int i = 0; i < 3; i++) {
        tree a = make(5, shapes[i], false), b = make(5, shapes[i], true);
        CHECK(b.count < a.count);
        skel_options o = options(0.08);
        skel_skeleton s, t;
        CHECK_OK(build(&a, &o, &s));
        CHECK_OK(build(&b, &o, &t));
        CHECK_MSG(same_curve(&s, &t), "shape %d", i);
        if (shapes[i] == ring) CHECK_U64(s.report.loops, 1);
        skel_skeleton_free(&s);
        skel_skeleton_free(&t);
        tree_free(&a);
        tree_free(&b);
    }
}

TEST(finer_voxels_of_the_same_cells)
{
    tree a = make(5, tube, false), b = finer(&a), c = finer(&b);
    skel_options o = options(0.08);
    skel_skeleton s, t, u;
    CHECK_OK(build(&a, &o, &s));
    CHECK_OK(build(&b, &o, &t));
    CHECK_OK(build(&c, &o, &u));
    CHECK_U64(t.report.voxel_level, s.report.voxel_level);
    CHECK_U64(u.report.voxel_depth, 7);
    CHECK(same_curve(&s, &t) && same_curve(&s, &u));
    CHECK_U64(u.map_count, 64 * s.map_count);
    for (uint64_t i = 0; i < u.map_count; i++) CHECK(u.map[i] == s.map[i / 64] && t.map[i / 8] == s.map[i / 64]);
    skel_skeleton_free(&s);
    skel_skeleton_free(&t);
    skel_skeleton_free(&u);
    tree_free(&a);
    tree_free(&b);
    tree_free(&c);
}

TEST(extremes)
{
    skel_options o = options(0.3);
    skel_skeleton s = {0};
    for (uint32_t depth = 0; depth <= 21; depth += 7) { /* one voxel: a joint in its middle */
        tree t = {.info = {.depth = depth}, .count = 1, .codes = calloc(1, 8)};
        for (int i = 0; i < 4; i++) t.info.voxel_to_world[5 * i] = 1;
        t.codes[0] = ((uint64_t)1 << 3 * depth) - 1;
        svo_result r = build(&t, &o, &s);
        if (depth > 10) { /* a speck in a grid too fine to be searched for its outside */
            CHECK_U64(r, SVO_LIMIT);
            tree_free(&t);
            continue;
        }
        CHECK_MSG(r == SVO_OK, "depth %u: %s", depth, err.message);
        CHECK_OK(skel_check(&s, &err));
        CHECK_U64(s.map_count, 1);
        skel_skeleton_free(&s);
        tree_free(&t);
    }
    tree empty = {.info = {.depth = 3}};
    for (int i = 0; i < 4; i++) empty.info.voxel_to_world[5 * i] = 1;
    CHECK_RESULT(build(&empty, &o, &s), SVO_INVALID_DATA);
    tree t = make(5, tube, false);
    o = options(0.05);
    o.max_vertices = 100;
    CHECK_RESULT(build(&t, &o, &s), SVO_LIMIT);
    o = options(9);
    CHECK_RESULT(build(&t, &o, &s), SVO_INVALID_ARGUMENT);
    tree_free(&t);
}

TEST(out_of_memory)
{
    tree t = make(4, tube, false);
    for (uint64_t at = 1;; at++) {
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = at;
        skel_options o = options(0.2);
        o.allocator = &a.base;
        o.max_iterations = 12;
        skel_skeleton s = {0};
        svo_result r = build(&t, &o, &s);
        if (r == SVO_OK) {
            skel_skeleton_free(&s);
            CHECK_U64(svo_limit_in_use(&a), 0);
            CHECK(at > 20);
            break;
        }
        CHECK_U64(r, SVO_OUT_OF_MEMORY);
    }
    tree_free(&t);
}

/* --- the same curve from voxels as from a mesh, parts apart by less than omega ------------------------------------- */

static void box(shape *s, double x0, double y0, double z0, double x1, double y1, double z1)
{
    uint32_t v[8];
    for (int i = 0; i < 8; i++) v[i] = shape_point(s, i & 1 ? x1 : x0, i & 2 ? y1 : y0, i & 4 ? z1 : z0);
    static const uint8_t side[12][3] = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4}, {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
    for (int i = 0; i < 12; i++) shape_triangle(s, v[side[i][0]], v[side[i][1]], v[side[i][2]]);
}

/* Graphs are equal and each curve is within one voxel and omega / 5 of the other in the mean. */
static void same_as_mesh(const shape *m, inside_fn inside, uint32_t depth, double omega, uint32_t components)
{
    tree t = make(depth, inside, false);
    skel_options o = options(omega);
    skel_skeleton a, b;
    CHECK_OK(shape_skeleton(m, &o, &a, &err));
    CHECK_OK(build(&t, &o, &b));
    CHECK_U64(a.report.components, components);
    CHECK_U64(b.report.components, components);
    CHECK_U64(b.report.quality.surface_components, a.report.quality.surface_components);
    CHECK_U64(a.report.ends, b.report.ends);
    CHECK_U64(a.report.loops, b.report.loops);
    skel_distance d;
    skel_curve_distance(&a, &b, &d);
    double allowed = 1.0 / (1 << depth) + 0.2 * omega * a.report.unit;
    CHECK_MSG(d.mean[0] <= allowed && d.mean[1] <= allowed, "%g and %g apart, %g allowed", d.mean[0], d.mean[1], allowed);
    skel_skeleton_free(&a);
    skel_skeleton_free(&b);
    tree_free(&t);
}

/* Bars side by side, one voxel apart, which is little more than omega. */
static bool bars(int x, int y, int z, int n)
{
    (void)n;
    return x >= 2 && x < 30 && z >= 10 && z < 14 && ((y >= 10 && y < 14) || (y >= 15 && y < 19));
}

TEST(bars_one_voxel_apart)
{
    shape s = {0};
    box(&s, 2 / 32.0, 10 / 32.0, 10 / 32.0, 30 / 32.0, 14 / 32.0, 14 / 32.0);
    box(&s, 2 / 32.0, 15 / 32.0, 10 / 32.0, 30 / 32.0, 19 / 32.0, 14 / 32.0);
    same_as_mesh(&s, bars, 5, 0.025, 2);
    shape_free(&s);
}

/* Plates one voxel apart, less than omega or more: two curves in both cases. Their surfaces are two: sides of voxels that do not touch share no corner. */
static bool plates(int x, int y, int z, int n)
{
    (void)n;
    return x >= 4 && x < 28 && y >= 4 && y < 28 && ((z >= 10 && z < 12) || (z >= 13 && z < 15));
}

TEST(plates_nearer_than_omega_and_not)
{
    shape s = {0};
    box(&s, 4 / 32.0, 4 / 32.0, 10 / 32.0, 28 / 32.0, 28 / 32.0, 12 / 32.0);
    box(&s, 4 / 32.0, 4 / 32.0, 13 / 32.0, 28 / 32.0, 28 / 32.0, 15 / 32.0);
    tree t = make(5, plates, false);
    for (int larger = 0; larger < 2; larger++) {
        skel_options o = options(larger != 0 ? 0.1 : 0.03);
        skel_skeleton a, b;
        CHECK_OK(shape_skeleton(&s, &o, &a, &err));
        CHECK_OK(build(&t, &o, &b));
        CHECK_U64(a.report.quality.surface_components, 2);
        CHECK_U64(b.report.quality.surface_components, 2);
        CHECK_U64(a.report.components, 2);
        CHECK_U64(b.report.components, 2);
        skel_skeleton_free(&a);
        skel_skeleton_free(&b);
    }
    tree_free(&t);
    shape_free(&s);
}

/* --- normals keep parts apart ------------------------------------------------------------------------------------------ */

/* The voxels with a normal each, from the box of its part: 0 and 1 are the two rods or legs. */
static void add_normals(tree *t, int gap, bool hook)
{
    t->info.channel_count = 1;
    t->info.channels[0] = (svo_channel){.name = "normal", .kind = SVO_KIND_NORMAL_OCT32};
    t->values[0] = malloc(4 * t->count);
    for (uint64_t i = 0; i < t->count; i++) {
        uint32_t x, y, z;
        svo_morton_decode(t->codes[i], &x, &y, &z);
        const int low = (int)y < 14 ? 10 : 14 + gap, in = (int)y - low; /* 0 .. 3 across */
        float n[3] = {0, in == 0 ? -1.0f : in == 3 ? 1.0f : 0, z == 10 ? -1.0f : z == 13 ? 1.0f : 0};
        if (hook && x < 6) n[1] = y == 10 ? -1.0f : (int)y == 17 + gap ? 1.0f : 0;
        if (hook && x < 6 && n[1] == 0) n[0] = x == 5 && (y == 13 || (int)y == 14 + gap) ? 0.2f : 0;
        if (n[0] == 0 && n[1] == 0 && n[2] == 0) n[2] = 1;
        svo_oct32_encode(n, t->values[0] + 4 * i);
    }
}

static int part_gap;
static bool near_rods(int x, int y, int z, int n)
{
    (void)n;
    return x >= 2 && x < 30 && z >= 10 && z < 14 && ((y >= 10 && y < 14) || (y >= 14 + part_gap && y < 18 + part_gap));
}
static bool near_legs(int x, int y, int z, int n) { return near_rods(x, y, z, n) || (x >= 2 && x < 6 && z >= 10 && z < 14 && y >= 10 && y < 18 + part_gap); }

/* Rods whose voxels touch, the gap between them being narrower than a voxel, and 1 and 2 voxels apart; at an omega below and above the distance of their axes. */
TEST(rods_that_normals_keep_apart)
{
    for (part_gap = 0; part_gap <= 2 && !test_failed(); part_gap++)
        for (int wide = 0; wide < 2 && !test_failed(); wide++) {
            tree t = make(5, near_rods, false);
            add_normals(&t, part_gap, false);
            skel_options o = options(wide != 0 ? 0.16 : 0.07);
            skel_skeleton s;
            CHECK_OK(build(&t, &o, &s));
            CHECK_OK(skel_check(&s, &err));
            CHECK_U64(s.report.quality.surface_components, 2);
            CHECK_U64(s.report.components, 2);
            CHECK_U64(s.report.ends, 4);
            CHECK_U64(s.report.loops, 0);
            for (uint64_t i = 0; i < t.count; i++) { /* each voxel goes to its own rod's curve */
                uint32_t x, y, z;
                svo_morton_decode(t.codes[i], &x, &y, &z);
                const double at = 32 * s.joints[s.map[i]].position[1];
                CHECK_MSG((y < 14) == (at < 14 + 0.5 * part_gap), "voxel %u %u %u at a joint at %g", x, y, z, at);
            }
            skel_skeleton_free(&s);
            tree_free(&t);
        }
    part_gap = 0; /* without normals nothing tells them apart */
    tree t = make(5, near_rods, false);
    skel_options o = options(0.07);
    skel_skeleton s;
    CHECK_OK(build(&t, &o, &s));
    CHECK_U64(s.report.components, 1);
    skel_skeleton_free(&s);
    tree_free(&t);
}

/* Legs of a hook whose voxels touch: one curve with an end in the tip of each, as long as both. */
TEST(hook_that_normals_keep_open)
{
    for (part_gap = 0; part_gap <= 1 && !test_failed(); part_gap++) {
        tree t = make(5, near_legs, false);
        add_normals(&t, part_gap, true);
        skel_options o = options(0.07);
        skel_skeleton s;
        CHECK_OK(build(&t, &o, &s));
        CHECK_U64(s.report.components, 1);
        CHECK_U64(s.report.loops, 0);
        double length = 0, tip[2] = {INFINITY, INFINITY};
        for (uint32_t j = 0; j < s.joint_count; j++)
            for (int leg = 0; leg < 2; leg++) {
                const double *p = s.joints[j].position;
                tip[leg] = fmin(tip[leg], hypot(hypot(32 * p[0] - 28, 32 * p[1] - (leg == 0 ? 12 : 16 + part_gap)), 32 * p[2] - 12));
            }
        CHECK_MSG(tip[0] < 3 && tip[1] < 3, "%g and %g voxels from the tips", tip[0], tip[1]);
        for (uint32_t b = 0; b < s.bone_count; b++) {
            const double *p = s.joints[s.bones[b].a].position, *q = s.joints[s.bones[b].b].position;
            length += 32 * hypot(hypot(p[0] - q[0], p[1] - q[1]), p[2] - q[2]);
        }
        CHECK_MSG(length > 40, "%g voxels long", length);
        skel_skeleton_free(&s);
        tree_free(&t);
    }
}
