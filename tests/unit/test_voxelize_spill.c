/* Voxelizing triangles that do not fit in memory: the same bytes as in memory, whatever the memory, the threads and where the
 * triangles lie; failures of the spill; memory. */
#include <math.h>
#include <stdio.h>

#include "fmt_spill.h"
#include "rich_mesh.h"
#include "svo_soup.h"

static svo_voxelize_options at_depth(uint32_t depth, uint32_t channels)
{
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = depth;
    o.channels = channels;
    return o;
}

/* The same mesh with its triangles outside of memory, in pieces of odd sizes. Shares everything else. */
typedef struct soup_mesh {
    svo_mesh mesh;
    svo_shape shape;
    svo_part parts[2];
} soup_mesh;

static void soup_make(soup_mesh *m, const svo_mesh *from, const svo_spill *spill)
{
    svo_error err = {0};
    svo_soup_file *file = NULL;
    memset(m, 0, sizeof *m);
    m->mesh = *from;
    m->shape = from->shapes[0];
    m->mesh.shapes = &m->shape;
    m->shape.parts = m->parts;
    CHECK_OK(svo_soup_file_create(spill, NULL, &file, &err));
    uint64_t at[2] = {0, 0}, piece = 1;
    for (bool more = true; more; piece = piece * 7 % 1009) { /* pieces of both parts in turn */
        more = false;
        for (uint32_t p = 0; p < from->shapes[0].part_count; p++) {
            const svo_part *part = &from->shapes[0].parts[p];
            svo_soup_layout layout = svo_soup_layout_of(part);
            uint64_t n = part->triangle_count - at[p] < piece ? part->triangle_count - at[p] : piece;
            uint8_t *records = malloc((size_t)(n + 1) * layout.stride);
            for (uint64_t i = 0; i < n; i++) svo_soup_pack(&layout, part, at[p] + i, records + i * layout.stride);
            m->parts[p].material = part->material;
            CHECK_OK(svo_soup_append(&m->parts[p], file, &layout, NULL, records, n, &err));
            free(records);
            at[p] += n;
            more |= at[p] < part->triangle_count;
        }
    }
    svo_soup_file_release(file);
}
static void soup_done(soup_mesh *m)
{
    for (int p = 0; p < 2; p++) svo_soup_free(m->parts[p].soup);
}

/* An independent shuffle of what a record holds. */
TEST(records_hold_what_parts_hold)
{
    rich_mesh m;
    rich_make(&m, 50, 1);
    const svo_part *part = &m.parts[1];
    for (int wide = 0; wide < 2; wide++) {
        svo_soup_layout l = svo_soup_layout_of(part);
        CHECK(l.wide && l.normals && l.colors && l.uvs[0] && !l.uvs[1]);
        CHECK_U64(l.stride, 72 + 36 + 24 + 48);
        if (!wide) {
            for (uint64_t i = 0; i < 3 * part->vertex_count; i++) part->positions[i] = (double)(float)part->positions[i];
            part->positions[5] = NAN;
            l = svo_soup_layout_of(part);
            CHECK(!l.wide);
        }
        svo_part out = {.triangle_count = part->triangle_count, .vertex_count = 3 * part->triangle_count};
        out.positions = malloc(out.vertex_count * 24);
        out.normals = malloc(out.vertex_count * 12);
        out.uvs[0] = malloc(out.vertex_count * 8);
        out.colors = malloc(out.vertex_count * 16);
        uint8_t record[SVO_SOUP_MAX_STRIDE];
        for (uint64_t t = 0; t < part->triangle_count; t++) {
            svo_soup_pack(&l, part, t, record);
            svo_soup_unpack(&l, record, &out, t);
            for (uint64_t k = 0; k < 3; k++) {
                uint64_t v = part->indices[3 * t + k], o = 3 * t + k;
                for (uint64_t i = 0; i < 3; i++) {
                    double a = out.positions[3 * o + i], b = part->positions[3 * v + i];
                    CHECK(a == b || (a != a && b != b));
                }
                CHECK(memcmp(&out.normals[3 * o], &part->normals[3 * v], 12) == 0);
                CHECK(memcmp(&out.uvs[0][2 * o], &part->uvs[0][2 * v], 8) == 0);
                CHECK(memcmp(&out.colors[4 * o], &part->colors[4 * v], 16) == 0);
            }
        }
        free(out.positions);
        free(out.normals);
        free(out.uvs[0]);
        free(out.colors);
        if (!wide) break;
        rich_free(&m);
        rich_make(&m, 50, 1);
    }
    rich_free(&m);
}

static uint64_t most_rounds, split_units, most_bins;

static void expect_same(const svo_mesh *resident, const svo_mesh *other, svo_voxelize_options o, const svo_spill *spill, bool spilled, const char *what)
{
    svo_error err = {0};
    voxel_set a, b;
    svo_voxelize_options whole = o;
    whole.memory = 0;
    CHECK_OK(voxel_run(resident, &whole, false, &a, &err));
    o.spill = spill;
    CHECK_OK(voxel_run(other, &o, false, &b, &err));
    CHECK_MSG(!spilled || b.report.spilled, "%s: it did not spill", what);
    most_rounds = b.report.spill_rounds > most_rounds ? b.report.spill_rounds : most_rounds;
    split_units += b.report.split_units;
    most_bins = b.report.spill_bins > most_bins ? b.report.spill_bins : most_bins;
    CHECK(b.ordered && b.live_blobs == 0);
    CHECK_MSG(memcmp(&a.counts, &b.counts, sizeof a.counts) == 0, "%s: %llu voxels, not %llu", what, (unsigned long long)b.counts.nodes[o.depth],
              (unsigned long long)a.counts.nodes[o.depth]);
    CHECK_MSG(a.hash == b.hash, "%s: other bytes", what);
    CHECK(memcmp(&b.counts, &b.report.counts, sizeof b.counts) == 0);
    CHECK_U64(b.report.triangles, a.report.triangles);
    CHECK_U64(b.report.skipped_not_finite, a.report.skipped_not_finite);
    CHECK_U64(b.report.degenerate, a.report.degenerate);
    CHECK_U64(b.report.masked_voxels, a.report.masked_voxels);
    CHECK(b.report.snap_max == a.report.snap_max);
    CHECK_MSG(b.report.snap_mean > 0.999999 * a.report.snap_mean && b.report.snap_mean < 1.000001 * a.report.snap_mean, "%s", what);
    CHECK_MSG(o.memory == 0 || b.report.peak_bytes <= o.memory, "%s: %llu bytes", what, (unsigned long long)b.report.peak_bytes);
    voxel_free(&a);
    voxel_free(&b);
}

TEST(same_bytes_as_in_memory)
{
    svo_error err = {0};
    fmt_spill *s = NULL;
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder()}, &s, &err));
    static const struct { uint32_t depth, threads, triangles; uint64_t memory; } cases[] = {
        {0, 1, 3000, 24 << 20}, {3, 2, 3000, 40 << 20}, {6, 2, 40000, 24 << 20}, {10, 1, 150000, 5 << 20}, {8, 2, 12000, 24 << 20}, {9, 3, 12000, 32 << 20},
        {10, 2, 12000, 0},      {11, 2, 2000, 24 << 20}, {7, 1, 30000, 5 << 20}, {9, 3, 60000, 10 << 20},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        for (int surface = 0; surface < 2; surface++) {
            rich_mesh m;
            soup_mesh soup;
            rich_make(&m, cases[i].triangles, i + 1);
            if (i % 2 == 0) m.loose.part.positions[7] = INFINITY;
            bool bare = cases[i].memory == 5 << 20 || cases[i].memory == 10 << 20; /* geometry alone */
            for (int k = 0; k < 2 && bare; k++) m.materials[k].alpha_mode = SVO_ALPHA_OPAQUE;
            /* a few large ones among many small ones */
            for (uint64_t t = cases[i].depth >= 10 ? 0 : 500; t < cases[i].triangles; t++)
                for (int k = 3; k < 9; k++) {
                    double *c = m.loose.part.positions + 9 * t;
                    c[k] = c[k % 3] + 0.02 * (c[k] - c[k % 3]);
                }
            soup_make(&soup, &m.loose.mesh, fmt_spill_files(s));
            svo_voxelize_options o = at_depth(cases[i].depth, bare ? 0 : EVERYTHING);
            o.surface = (svo_surface)surface;
            o.threads = cases[i].threads;
            o.memory = cases[i].memory;
            char what[100];
            snprintf(what, sizeof what, "case %d, surface %d", (int)i, surface);
            expect_same(&m.loose.mesh, &soup.mesh, o, fmt_spill_files(s), true, what);
            snprintf(what, sizeof what, "case %d, surface %d, in memory", (int)i, surface);
            expect_same(&m.loose.mesh, &m.loose.mesh, o, fmt_spill_files(s), false, what);
            soup_done(&soup);
            rich_free(&m);
            if (test_failed()) return;
        }
    CHECK_U64(fmt_spill_count(s).bytes_now, 0);
    CHECK_MSG(most_rounds > 1 && most_bins > 8 && split_units > 4, "%d rounds, %d bins, %d units in parts", (int)most_rounds, (int)most_bins,
              (int)split_units); /* all ways were gone */
    fmt_spill_close(s);
}

/* A spill that fails at its n-th operation. */
typedef struct failing {
    const svo_spill *to;
    uint64_t left;
    uint64_t open;
} failing;
static svo_result fail_now(failing *f, svo_error *err) { return f->left == 0 ? svo_fail(err, SVO_IO, "the disk is gone") : (f->left--, SVO_OK); }
static svo_result f_create(void *user, void **file, svo_error *err)
{
    failing *f = user;
    SVO_TRY(fail_now(f, err));
    f->open++;
    return f->to->create(f->to->user, file, err);
}
static svo_result f_write(void *user, void *file, uint64_t offset, const void *bytes, uint64_t size, svo_error *err)
{
    SVO_TRY(fail_now(user, err));
    return ((failing *)user)->to->write(((failing *)user)->to->user, file, offset, bytes, size, err);
}
static svo_result f_read(void *user, void *file, uint64_t offset, void *bytes, uint64_t size, svo_error *err)
{
    SVO_TRY(fail_now(user, err));
    return ((failing *)user)->to->read(((failing *)user)->to->user, file, offset, bytes, size, err);
}
static void f_close(void *user, void *file)
{
    ((failing *)user)->open--;
    ((failing *)user)->to->close(((failing *)user)->to->user, file);
}

TEST(a_disk_that_fails_is_passed_on_and_nothing_is_left)
{
    svo_error err = {0};
    fmt_spill *s = NULL;
    CHECK_OK(fmt_spill_open(&(fmt_spill_options){.folder = test_folder()}, &s, &err));
    rich_mesh m;
    soup_mesh soup;
    rich_make(&m, 4000, 5);
    for (uint64_t t = 100; t < 4000; t++)
        for (int k = 3; k < 9; k++) {
            double *c = m.loose.part.positions + 9 * t;
            c[k] = c[k % 3] + 0.02 * (c[k] - c[k % 3]);
        }
    soup_make(&soup, &m.loose.mesh, fmt_spill_files(s));
    bool done = false;
    uint64_t failures = 0;
    for (uint64_t n = 0; !done && n < 1000; n += 1 + n / 3) {
        failing f = {.to = fmt_spill_files(s), .left = n};
        svo_spill spill = {.user = &f, .create = f_create, .write = f_write, .read = f_read, .close = f_close};
        svo_limit_allocator outer;
        svo_limit_allocator_init(&outer, UINT64_MAX, NULL);
        svo_voxelize_options o = at_depth(8, SVO_WANT_COLOR);
        o.spill = &spill;
        o.threads = 1; /* the count of operations is that of one order */
        o.allocator = &outer.base;
        voxel_set v;
        svo_result r = voxel_run(&soup.mesh, &o, false, &v, &err);
        CHECK_MSG(r == SVO_OK || r == SVO_IO, "%s", err.message);
        done = r == SVO_OK;
        failures += r != SVO_OK;
        CHECK_U64(f.open, 0);
        CHECK_U64(svo_limit_in_use(&outer), 0);
        CHECK_U64(v.live_blobs, 0);
        voxel_free(&v);
    }
    CHECK(done && failures > 3);
    soup_done(&soup);
    rich_free(&m);
    fmt_spill_close(s);
}
