/* Properties of the voxelizer that need no exact kernel: known answers, the same bytes whatever the threads, memory and order,
 * tightness, extreme input, failures, attributes against a slow reference. The exact set is in oracle/test_voxelize.cpp. */
#include <math.h>

#include "svo_distance.h"
#include "rich_mesh.h"

static void add_triangle(double *out, uint64_t t, const double a[3], const double b[3], const double c[3])
{
    memcpy(out + 9 * t, a, 24);
    memcpy(out + 9 * t + 3, b, 24);
    memcpy(out + 9 * t + 6, c, 24);
}

static void cube(double positions[108], double low, double size)
{
    uint64_t t = 0;
    for (int axis = 0; axis < 3; axis++)
        for (int side = 0; side < 2; side++) {
            double q[4][3];
            for (int c = 0; c < 4; c++) {
                q[c][axis] = low + side * size;
                q[c][(axis + 1) % 3] = low + (c == 1 || c == 2 ? size : 0);
                q[c][(axis + 2) % 3] = low + (c >= 2 ? size : 0);
            }
            add_triangle(positions, t++, q[0], q[1], q[2]);
            add_triangle(positions, t++, q[0], q[2], q[3]);
        }
}

/* A closed sphere of 2 * rings * rings * 2 triangles or so. */
static uint64_t sphere(double *out, int rings, double radius)
{
    uint64_t t = 0;
    for (int r = 0; r < rings; r++)
        for (int a = 0; a < 2 * rings; a++) {
            double p[4][3];
            for (int c = 0; c < 4; c++) {
                double theta = M_PI * (r + (c >> 1)) / rings, phi = M_PI * ((a + (c & 1)) % (2 * rings)) / rings;
                double s = r + (c >> 1) == 0 || r + (c >> 1) == rings ? 0 : sin(theta);
                p[c][0] = radius * s * cos(phi), p[c][1] = radius * cos(theta), p[c][2] = radius * s * sin(phi);
            }
            if (r > 0) add_triangle(out, t++, p[0], p[1], p[2]);
            if (r < rings - 1) add_triangle(out, t++, p[1], p[3], p[2]);
        }
    return t;
}

static svo_voxelize_options at_depth(uint32_t depth, uint32_t channels)
{
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = depth;
    o.channels = channels;
    o.threads = 2;
    return o;
}

TEST(cube_gives_its_shell)
{
    double positions[108];
    for (int k = 0; k < 3; k++) {
        cube(positions, k == 0 ? 0 : k == 1 ? -7.25 : 1e9, k == 2 ? 1e-3 : 1);
        loose_mesh m;
        loose_make(&m, positions, 12);
        for (uint32_t depth = 0; depth <= 9; depth++) {
            svo_voxelize_options o = at_depth(depth, 0);
            voxel_set s;
            svo_error err;
            CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
            uint64_t n = (uint64_t)1 << depth, inside = n > 2 ? (n - 2) * (n - 2) * (n - 2) : 0;
            CHECK_U64(s.count, n * n * n - inside);
            CHECK(s.ordered && s.live_blobs == 0);
            CHECK(memcmp(&s.counts, &s.report.counts, sizeof s.counts) == 0);
            CHECK_U64(s.report.triangles, 12);
            CHECK(s.report.snap_max < 0.0136 && s.report.distance_max < 0.88);
            voxel_free(&s);
        }
        loose_free(&m);
    }
}

TEST(thin_cube_is_its_shell_too)
{
    /* The snapped faces lie 1/256 inside the first and last layer, on the near side of the centres of no other. */
    double positions[108];
    cube(positions, 0, 1);
    loose_mesh m;
    loose_make(&m, positions, 12);
    svo_voxelize_options o = at_depth(4, 0);
    o.surface = SVO_SURFACE_THIN;
    voxel_set s;
    svo_error err;
    CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
    for (uint64_t i = 0; i < s.count; i++) {
        uint32_t x, y, z;
        svo_morton_decode(s.codes[i], &x, &y, &z);
        int faces = (x == 0 || x == 15) + (y == 0 || y == 15) + (z == 0 || z == 15);
        CHECK(faces >= 1);
    }
    CHECK_U64(s.count, 16 * 16 * 16 - 14 * 14 * 14);
    voxel_free(&s);
    loose_free(&m);
}

/* Voxels of a grid with one layer around it that paths of the given neighbours reach from outside. */
static void flood(const voxel_set *s, uint32_t n, bool corners, uint8_t *reached)
{
    uint32_t size = n + 2;
    uint32_t *stack = malloc((size_t)size * size * size * 4);
    uint64_t height = 0;
    memset(reached, 0, (size_t)size * size * size);
    for (uint64_t i = 0; i < s->count; i++) {
        uint32_t x, y, z;
        svo_morton_decode(s->codes[i], &x, &y, &z);
        reached[((size_t)(z + 1) * size + y + 1) * size + x + 1] = 2;
    }
    reached[0] = 1;
    stack[height++] = 0;
    while (height != 0) {
        uint32_t at = stack[--height], x = at % size, y = at / size % size, z = at / size / size;
        for (int d = 0; d < 27; d++) {
            int dx = d % 3 - 1, dy = d / 3 % 3 - 1, dz = d / 9 - 1;
            if (!corners && abs(dx) + abs(dy) + abs(dz) != 1) continue;
            uint32_t a = x + (uint32_t)dx, b = y + (uint32_t)dy, c = z + (uint32_t)dz;
            if (a >= size || b >= size || c >= size) continue;
            uint32_t next = (c * size + b) * size + a;
            if (reached[next] != 0) continue;
            reached[next] = 1;
            stack[height++] = next;
        }
    }
    free(stack);
}

TEST(closed_surfaces_are_tight)
{
    double *positions = malloc(72 * 4000);
    uint64_t triangles = sphere(positions, 24, 1);
    loose_mesh m;
    loose_make(&m, positions, triangles);
    for (uint32_t depth = 3; depth <= 7; depth++)
        for (int surface = 0; surface < 2; surface++) {
            svo_voxelize_options o = at_depth(depth, 0);
            o.surface = (svo_surface)surface;
            voxel_set s;
            svo_error err;
            CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
            uint32_t n = 1u << depth, size = n + 2;
            uint8_t *reached = malloc((size_t)size * size * size);
            /* conservative: not even through corners; thin: not through faces */
            flood(&s, n, surface == SVO_SURFACE_CONSERVATIVE, reached);
            uint8_t centre = reached[((size_t)(n / 2) * size + n / 2) * size + n / 2];
            CHECK_MSG(centre == 0, "depth %u, surface %d: the inside was reached", depth, surface);
            free(reached);
            voxel_free(&s);
        }
    loose_free(&m);
    free(positions);
}

TEST(same_bytes_for_any_threads_memory_and_order)
{
    for (int surface = 0; surface < 2; surface++)
        for (uint32_t depth = 5; depth <= 9; depth += 2) {
            rich_mesh m;
            rich_make(&m, 300, depth);
            uint64_t hash = 0, voxels = 0;
            for (int k = 0; k < 6; k++) {
                svo_voxelize_options o = at_depth(depth, EVERYTHING);
                o.surface = (svo_surface)surface;
                const uint32_t threads[] = {1, 2, 7, 2, 3, 2};
                o.threads = threads[k];
                if (k == 3) o.memory = 100 << 20;
                if (k == 4) o.memory = 14 << 20; /* too little to keep the snapped triangles too */
                if (k == 5) { /* triangles in reverse order */
                    for (int p = 0; p < 2; p++)
                        for (uint64_t a = 0, b = m.parts[p].triangle_count - 1; a < b; a++, b--)
                            for (int i = 0; i < 3; i++) {
                                uint32_t swap = m.parts[p].indices[3 * a + (uint64_t)i];
                                m.parts[p].indices[3 * a + (uint64_t)i] = m.parts[p].indices[3 * b + (uint64_t)i];
                                m.parts[p].indices[3 * b + (uint64_t)i] = swap;
                            }
                }
                voxel_set s;
                svo_error err;
                CHECK_OK(voxel_run(&m.loose.mesh, &o, false, &s, &err));
                CHECK(s.ordered && s.live_blobs == 0);
                CHECK(memcmp(&s.counts, &s.report.counts, sizeof s.counts) == 0);
                if (k == 0) hash = s.hash, voxels = s.report.counts.nodes[depth];
                CHECK_U64(s.report.counts.nodes[depth], voxels);
                CHECK_MSG(s.hash == hash, "depth %u, run %d: other bytes", depth, k);
                CHECK(o.memory == 0 || s.report.peak_bytes <= o.memory);
                CHECK(s.report.masked_voxels > 0);
                voxel_free(&s);
            }
            rich_free(&m);
        }
}

TEST(too_little_memory_is_a_limit_and_leaves_nothing)
{
    rich_mesh m;
    rich_make(&m, 400, 3);
    for (uint64_t memory = 1000; memory < 40 << 20; memory = memory * 3 / 2) {
        svo_limit_allocator outer;
        svo_limit_allocator_init(&outer, UINT64_MAX, NULL);
        svo_voxelize_options o = at_depth(8, EVERYTHING);
        o.memory = memory;
        o.allocator = &outer.base;
        voxel_set s;
        svo_error err = {0};
        svo_result r = voxel_run(&m.loose.mesh, &o, false, &s, &err);
        CHECK_MSG(r == SVO_OK || r == SVO_LIMIT, "%s %s", svo_result_name(r), err.message);
        CHECK(r == SVO_OK || err.message[0] != 0);
        CHECK_U64(svo_limit_in_use(&outer), 0);
        CHECK_U64(s.live_blobs, 0);
        voxel_free(&s);
    }
    rich_free(&m);
}

TEST(every_allocation_may_fail)
{
    rich_mesh m;
    rich_make(&m, 60, 3);
    bool done = false;
    for (uint64_t n = 1; n < 400 && !done; n++) {
        svo_limit_allocator outer;
        svo_limit_allocator_init(&outer, UINT64_MAX, NULL);
        outer.fail_at = n;
        svo_voxelize_options o = at_depth(7, EVERYTHING);
        o.allocator = &outer.base;
        voxel_set s;
        svo_error err = {0};
        svo_result r = voxel_run(&m.loose.mesh, &o, false, &s, &err);
        done = r == SVO_OK;
        CHECK(r == SVO_OK || r == SVO_OUT_OF_MEMORY);
        CHECK_U64(svo_limit_in_use(&outer), 0);
        CHECK_U64(s.live_blobs, 0);
        voxel_free(&s);
    }
    CHECK(done);
    rich_free(&m);
}

typedef struct failing_sink { voxel_set *set; uint64_t encoded, fail_encode, committed, fail_commit; } failing_sink;
static svo_result failing_encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err)
{
    failing_sink *f = user;
    if (__atomic_add_fetch(&f->encoded, 1, __ATOMIC_RELAXED) == f->fail_encode) return svo_fail(err, SVO_IO, "encode");
    return voxel_encode(f->set, chunk, worker, blob, err);
}
static svo_result failing_commit(void *user, void *blob, svo_error *err)
{
    failing_sink *f = user;
    bool fail = ++f->committed == f->fail_commit;
    svo_result r = voxel_commit(f->set, blob, err); /* consumes it in any case */
    return fail ? svo_fail(err, SVO_IO, "commit") : r;
}
static void failing_discard(void *user, void *blob) { voxel_discard(((failing_sink *)user)->set, blob); }

TEST(failures_of_the_sink_are_passed_on)
{
    rich_mesh m;
    rich_make(&m, 100, 3);
    for (uint64_t k = 1; k < 12; k++) {
        svo_voxelize_options o = at_depth(9, SVO_WANT_NORMAL);
        voxel_set s;
        memset(&s, 0, sizeof s);
        svo_error err;
        CHECK_OK(svo_voxelize_plan(&m.loose.mesh, &o, &s.info, &err));
        failing_sink f = {.set = &s};
        if (k % 2) f.fail_encode = k;
        else f.fail_commit = k;
        svo_chunk_sink sink = {&f, failing_encode, failing_commit, failing_discard};
        CHECK_RESULT(svo_voxelize(&m.loose.mesh, &o, &s.info, &sink, NULL, &err), SVO_IO);
        CHECK(strcmp(err.message, k % 2 ? "encode" : "commit") == 0);
        CHECK_U64(s.live_blobs, 0);
        voxel_free(&s);
    }
    rich_free(&m);
}

/* --- extreme input -------------------------------------------------------------------------------------------- */

static void expect_voxels(const double *positions, uint64_t triangles, svo_voxelize_options o, uint64_t expected, uint64_t skipped, const char *what)
{
    loose_mesh m;
    loose_make(&m, positions, triangles);
    svo_warnings warnings = {0};
    o.warnings = &warnings;
    voxel_set s;
    svo_error err;
    CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
    CHECK_MSG(s.count == expected, "%s: %llu voxels, expected %llu", what, (unsigned long long)s.count, (unsigned long long)expected);
    CHECK_U64(s.report.skipped_not_finite, skipped);
    CHECK((warnings.count != 0) == (expected == 0 || skipped != 0));
    for (int i = 0; i < 16; i++) CHECK(isfinite(s.info.voxel_to_world[i]));
    CHECK(s.info.voxel_to_world[0] > 0);
    voxel_free(&s);
    loose_free(&m);
}

TEST(extreme_meshes)
{
    const uint32_t depths[] = {0, 1, 7, 8, 21};
    for (int d = 0; d < 5; d++) {
        svo_voxelize_options o = at_depth(depths[d], SVO_WANT_AUTO);
        expect_voxels(NULL, 0, o, 0, 0, "empty mesh");
        double v[27];
        for (int i = 0; i < 27; i++) v[i] = 3.5;
        expect_voxels(v, 3, o, 1, 0, "all vertices equal");
        for (int i = 0; i < 27; i++) v[i] = i % 3 == 0 ? 1e30 : -1e30;
        expect_voxels(v, 3, o, 1, 0, "all vertices equal, far out");
        for (int i = 0; i < 27; i++) v[i] = 5e-324;
        expect_voxels(v, 3, o, 1, 0, "denormal, equal");
        for (int i = 0; i < 9; i++) v[9 + i] = NAN;
        expect_voxels(v, 2, o, 1, 1, "one triangle of NaN");
        v[0] = INFINITY;
        expect_voxels(v, 2, o, 0, 2, "nothing finite");
    }
    for (int e = -30; e <= 30; e += 15) {
        double v[9] = {0, 0, 0, 1, 0, 0, 1, 0, 0};
        for (int i = 0; i < 9; i++) v[i] *= pow(10, e);
        expect_voxels(v, 1, at_depth(10, SVO_WANT_AUTO), 1024, 0, "a segment along x");
        if (e == 0) expect_voxels(v, 1, at_depth(17, SVO_WANT_AUTO), 1 << 17, 0, "a segment along x, deep");
    }
}

TEST(coincident_vertices_and_fans)
{
    enum { N = 100000 };
    double *v = malloc(72 * N);
    for (uint64_t i = 0; i < 9 * N; i++) v[i] = i < 9 ? (double)(i == 3) : 0.25;
    loose_mesh m;
    loose_make(&m, v, N);
    svo_voxelize_options o = at_depth(9, SVO_WANT_AUTO);
    voxel_set s;
    svo_error err;
    CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
    CHECK_U64(s.report.degenerate, N); /* the first is a segment */
    CHECK_U64(s.count, 512 + 1);
    voxel_free(&s);
    loose_free(&m);
    /* a fan of 100k triangles about one vertex: a disc */
    for (uint64_t t = 0; t < N; t++) {
        double p[3][3] = {{0, 0, 0}, {cos(2 * M_PI * (double)t / N), sin(2 * M_PI * (double)t / N), 0},
                          {cos(2 * M_PI * (double)(t + 1) / N), sin(2 * M_PI * (double)(t + 1) / N), 0}};
        add_triangle(v, t, p[0], p[1], p[2]);
    }
    loose_make(&m, v, N);
    o = at_depth(6, SVO_WANT_AUTO);
    CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
    CHECK(s.count > 0.7853 * 64 * 64 && s.count < 0.7854 * 67 * 67);
    /* all normals are +z: the sums of 100k contributions at the hub neither overflow nor tilt */
    for (uint64_t i = 0; i < s.count; i++) {
        float n[3];
        svo_oct32_decode(s.values[0] + 4 * i, n);
        CHECK(fabsf(n[0]) < 1e-4f && fabsf(n[1]) < 1e-4f && n[2] > 0.9999f);
    }
    voxel_free(&s);
    loose_free(&m);
    free(v);
}

TEST(deep_grids_are_walked_not_filled)
{
    /* three small triangles, far apart, at the greatest depth: a few chunks out of 2^42 */
    uint64_t seed = 9;
    double v[27];
    for (int t = 0; t < 3; t++)
        for (int i = 0; i < 9; i++) v[9 * t + i] = (t == i % 3 ? 1.0 : 0.0) + 1e-4 * test_random_unit(&seed);
    loose_mesh m;
    loose_make(&m, v, 3);
    svo_voxelize_options o = at_depth(21, SVO_WANT_AUTO);
    voxel_set s;
    svo_error err;
    CHECK_OK(voxel_run(&m.mesh, &o, false, &s, &err));
    CHECK(s.ordered && memcmp(&s.counts, &s.report.counts, sizeof s.counts) == 0);
    CHECK(s.report.counts.nodes[21] > 3000 && s.report.counts.nodes[21] < 300000);
    CHECK(s.report.peak_bytes < 64 << 20);
    voxel_free(&s);
    loose_free(&m);
}

TEST(voxel_size_aligns_the_grid)
{
    uint64_t seed = 2;
    for (int k = 0; k < 200; k++) {
        double v[18];
        for (int i = 0; i < 18; i++) v[i] = 100 * test_random_unit(&seed) - 50;
        loose_mesh m;
        loose_make(&m, v, 2);
        svo_voxelize_options o = at_depth(3, 0);
        o.voxel_size = k % 2 ? 0.37 : 1;
        voxel_set s;
        svo_error err;
        CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
        const double *w = s.info.voxel_to_world;
        CHECK(w[0] == o.voxel_size && w[5] == o.voxel_size && w[10] == o.voxel_size);
        double cells = 0;
        for (int i = 0; i < 3; i++) {
            double origin = w[4 * i + 3], steps = origin / o.voxel_size;
            CHECK_MSG(fabs(steps - floor(steps + 0.5)) < 1e-9, "origin %g is no multiple of %g", origin, o.voxel_size);
            for (int c = i; c < 18; c += 3) {
                CHECK(v[c] >= origin && v[c] < origin + ldexp(o.voxel_size, (int)s.info.depth));
                cells = fmax(cells, floor((v[c] - origin) / o.voxel_size) + 1);
            }
        }
        CHECK(s.info.depth == 0 || ldexp(1, (int)s.info.depth - 1) < cells); /* the smallest that covers */
        voxel_free(&s);
        loose_free(&m);
    }
    double v[9] = {0, 0, 0, 1, 1, 1, 1, 0, 0};
    loose_mesh m;
    loose_make(&m, v, 1);
    svo_voxelize_options o = at_depth(3, 0);
    svo_tree_info info;
    svo_error err;
    o.voxel_size = 1e-9;
    CHECK_RESULT(svo_voxelize_plan(&m.mesh, &o, &info, &err), SVO_LIMIT);
    o.voxel_size = NAN;
    CHECK_RESULT(svo_voxelize_plan(&m.mesh, &o, &info, &err), SVO_INVALID_ARGUMENT);
    o.voxel_size = -1;
    CHECK_RESULT(svo_voxelize_plan(&m.mesh, &o, &info, &err), SVO_INVALID_ARGUMENT);
    o.voxel_size = 0;
    o.depth = 22;
    CHECK_RESULT(svo_voxelize_plan(&m.mesh, &o, &info, &err), SVO_LIMIT);
    loose_free(&m);
}

TEST(distance_of_a_point_from_a_triangle)
{
    /* against the smallest distance over many points of the triangle */
    uint64_t seed = 6;
    for (int k = 0; k < 200; k++) {
        double c[3][3], p[3], best = INFINITY;
        for (int i = 0; i < 9; i++) c[i / 3][i % 3] = test_random_unit(&seed);
        if (k % 4 == 0) memcpy(c[2], c[1], sizeof c[1]);
        if (k % 8 == 0) memcpy(c[0], c[1], sizeof c[1]);
        for (int i = 0; i < 3; i++) p[i] = 3 * test_random_unit(&seed) - 1;
        const int steps = 200;
        for (int a = 0; a <= steps; a++)
            for (int b = 0; a + b <= steps; b++) {
                double d = 0;
                for (int i = 0; i < 3; i++) {
                    double x = (c[0][i] * (steps - a - b) + c[1][i] * a + c[2][i] * b) / steps - p[i];
                    d += x * x;
                }
                best = fmin(best, sqrt(d));
            }
        double got = svo_point_triangle(p, (const double(*)[3])c);
        CHECK_MSG(got <= best + 1e-12 && got > best - 0.01, "%g, sampled %g", got, best);
    }
}
