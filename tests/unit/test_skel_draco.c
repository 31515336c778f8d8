/* The skinned mesh through Draco: joints and weights exactly, positions within what is reported, any triangles. */
#include <stdio.h>

#include "fmt_import.h"
#include "fmt_skel.h"
#include "fmti_draco.h"
#include "skel_shapes.h"
#include "test.h"

static svo_error err;

/* Encode s with joints and weights that depend on the vertex in no smooth way. */
static void check_shape(const shape *s, uint32_t bits)
{
    uint64_t n = s->points, seed = 7;
    float *p = malloc(3 * n * sizeof *p), low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    uint16_t *joint = malloc(4 * n * sizeof *joint);
    uint8_t *weight = malloc(4 * n);
    for (uint64_t i = 0; i < 3 * n; i++) {
        p[i] = (float)s->p[i];
        low[i % 3] = fminf(low[i % 3], p[i]);
        high[i % 3] = fmaxf(high[i % 3], p[i]);
    }
    for (uint64_t i = 0; i < 4 * n; i++) {
        joint[i] = (uint16_t)test_random(&seed);
        weight[i] = (uint8_t)test_random(&seed);
    }
    fmt_draco_arrays m = {.vertices = n, .triangles = s->triangles, .corner = s->t, .attribute_count = 3};
    m.attribute[0] = (fmt_draco_attribute){.kind = FMT_DRACO_POSITION, .type = FMT_DRACO_F32, .components = 3, .bits = bits, .values = p};
    m.attribute[1] = (fmt_draco_attribute){.kind = FMT_DRACO_GENERIC, .type = FMT_DRACO_U16, .components = 4, .values = joint};
    m.attribute[2] = (fmt_draco_attribute){.kind = FMT_DRACO_GENERIC, .type = FMT_DRACO_U8, .components = 4, .values = weight};
    svo_buffer bytes;
    svo_buffer_init(&bytes, NULL);
    CHECK_OK(fmt_draco_pack(&m, &bytes, &err));
    CHECK(m.measured);
    CHECK(m.attribute[1].error == 0 && m.attribute[2].error == 0);
    double range = fmax(high[0] - low[0], fmax(high[1] - low[1], high[2] - low[2])), step = range / (pow(2, bits) - 1);
    CHECK(m.attribute[0].error <= step * sqrt(3) / 2 * 1.001 + 1e-6 * range);
    CHECK(range == 0 || m.attribute[0].error > 0 || s->points < 9);
    CHECK(m.decoded_triangles <= s->triangles && m.decoded_triangles > 0);
    for (int k = 0; k < 3; k++) CHECK(m.attribute[0].low[k] >= low[k] - 2 * step && m.attribute[0].high[k] <= high[k] + 2 * step);
    svo_buffer_free(&bytes);
    free(p);
    free(joint);
    free(weight);
}

TEST(any_triangles)
{
    shape tube = shape_tube(4, 0.3, 40, 12), torus = shape_torus(2, 0.3, 30, 12), star = shape_star(3, 0.2, 20, 8), soup = {0}, one = {0}, fan = {0};
    for (uint64_t t = 0; t < torus.triangles; t++) { /* unshared */
        uint32_t c[3];
        for (int k = 0; k < 3; k++) {
            const double *p = torus.p + 3 * (uint64_t)torus.t[3 * t + (uint64_t)k];
            c[k] = shape_point(&soup, p[0], p[1], p[2]);
        }
        shape_triangle(&soup, c[0], c[1], c[2]);
    }
    shape_point(&one, 0, 0, 0);
    shape_point(&one, 1, 0, 0);
    shape_point(&one, 0, 1, 0);
    shape_triangle(&one, 0, 1, 2);
    shape_point(&fan, 0, 0, 0); /* twenty triangles at one edge, one of them twice and turned round, and one without area */
    shape_point(&fan, 0, 0, 1);
    for (uint32_t i = 0; i < 20; i++) {
        shape_point(&fan, cos(0.3 * i), sin(0.3 * i), 0.5);
        shape_triangle(&fan, 0, 1, 2 + i);
    }
    shape_triangle(&fan, 1, 0, 2);
    shape_triangle(&fan, 3, 3, 4);
    for (uint32_t bits = 8; bits <= 20; bits += 6) {
        check_shape(&tube, bits);
        check_shape(&torus, bits);
        check_shape(&star, bits);
        check_shape(&soup, bits);
        check_shape(&one, bits);
        check_shape(&fan, bits);
    }
    shape_free(&tube);
    shape_free(&torus);
    shape_free(&star);
    shape_free(&soup);
    shape_free(&one);
    shape_free(&fan);
}

/* The whole file, read by the importer: every vertex is where one of the model's is, within the error that was reported. */
TEST(a_file)
{
    shape s = shape_star(3, 0.25, 40, 12);
    for (uint64_t i = 0; i < s.points; i++) s.p[3 * i] += 1000;
    svo_part part = {.material = SVO_NONE, .vertex_count = s.points, .triangle_count = s.triangles, .positions = s.p, .indices = s.t};
    svo_shape sh = {.part_count = 1, .parts = &part};
    svo_instance in = {.transform = svo_mat4_identity()};
    svo_mesh mesh = {.shape_count = 1, .instance_count = 1, .shapes = &sh, .instances = &in}, again = {0};
    skel_options o = skel_default_options();
    skel_skeleton k;
    skel_tree tree;
    skel_skin skin;
    o.omega = 0.05;
    o.search = SKEL_SEARCH_GRID;
    CHECK_OK(skel_build_mesh(&mesh, &o, &k, &err));
    CHECK_OK(skel_tree_make(&k, NULL, &tree, &err));
    for (uint32_t influences = 1; influences <= 8; influences += 7) {
        const skel_skin_options w = {.influences = influences, .smoothing = 8};
        fmt_output *out;
        fmt_draco_report r;
        char path[4200];
        snprintf(path, sizeof path, "%s/d%u.glb", test_folder(), influences);
        CHECK_OK(skel_skin_make(&mesh, &k, &tree, &w, &skin, &err));
        CHECK_OK(fmt_output_open(path, true, &out, &err));
        CHECK_OK(fmt_export_skinned_glb(out, &mesh, &k, &tree, &skin, 12, &r, NULL, &err));
        CHECK_OK(fmt_output_commit(out, &err));
        CHECK(r.measured && r.position_error > 0 && r.position_error < 6 * 0.87 / 4095 * 1.01);
        CHECK(r.weight_error <= 1.0 / 255 && r.bytes * 4 < r.plain_bytes);
        const fmt_import_options io = {0};
        CHECK_OK(fmt_import_mesh(path, &io, &again, &err));
        svo_mesh_counts n = svo_mesh_count(&again);
        CHECK_U64(n.triangles, s.triangles);
        for (uint64_t v = 0; v < again.shapes[0].parts[0].vertex_count; v++) {
            svo_vec3 q = svo_mat4_point(&again.instances[0].transform, svo_v3(again.shapes[0].parts[0].positions[3 * v], again.shapes[0].parts[0].positions[3 * v + 1], again.shapes[0].parts[0].positions[3 * v + 2]));
            double best = INFINITY;
            for (uint64_t i = 0; i < s.points; i++) best = fmin(best, hypot(hypot(q.x - s.p[3 * i], q.y - s.p[3 * i + 1]), q.z - s.p[3 * i + 2]));
            CHECK(best <= r.position_error * 1.001 + 1e-4 * 0.003);
        }
        svo_mesh_free(&again);
        skel_skin_free(&skin);
    }
    skel_tree_free(&tree);
    skel_skeleton_free(&k);
    shape_free(&s);
}
