/* Error of pictures of deformed octrees against the deformed triangles, over seconds.
 *
 *     bench_poses [-w WIDTH] MESH A.svdag [B.svdag ...] > poses.csv
 *
 * The reference is MESH with every corner put where the pose puts it (triangles stay flat, so the mesh should be fine), traced by Embree with 8x8 samples a pixel and lit as
 * svo-render lights without shadows. The files, octrees of the same mesh without colours, are drawn under the same poses by every way of resampling (mipmap, direct, resize, emit), with
 * nodes at least 1, 2 and 4 samples wide (`--delta`) and 2x2 samples a pixel. A line each: boxes and cells, thread CPU seconds of what comes before drawing (selection, deformation, cells and their
 * octree) and of drawing, one thread, best of three; root mean square and largest difference of light, pixels of silhouette error. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "embree_picture.h"
#include "fmt_file.h"
#include "fmt_svdag.h"
#include "svo_rays.h"
#include "svo_resample.h"

enum { SAMPLES = 2, REPEATS = 3 };

typedef struct posed_mesh {
    const char *name;
    svo_pose pose;
    float matrix[12];
    svo_poses all;
    svo_deform map; /* of mesh coordinates */
    svo_render_options look;
    float *reference;
} posed_mesh;

static svo_vec3 move_point(const void *user, svo_vec3 p) { return svo_deform_point(&((const posed_mesh *)user)->map, SVO_NO_BONE, p); }

/* Poses are stated in full, from the bounds of the mesh, so that they do not depend on the depth of an octree. */
static void pose_make(posed_mesh *p, int kind, const double low[3], const double high[3])
{
    static const char *const names[] = {"rest", "twist 60", "bend 60", "shear 0.7"};
    const svo_mat4 id = svo_mat4_identity();
    p->name = names[kind];
    p->pose = svo_pose_stated();
    for (int k = 0; k < 12; k++) p->matrix[k] = k % 5 == 0 ? 1 : 0;
    if (kind == 1) p->pose.flags = SVO_POSE_TWIST, p->pose.twist_axis = 1, p->pose.twist_angle = 1.0471976f;
    if (kind == 2) p->pose.flags = SVO_POSE_BEND, p->pose.bend_axis = 1, p->pose.bend_towards = 0, p->pose.bend_angle = 1.0471976f;
    if (kind == 3) p->pose.flags = SVO_POSE_MATRIX, p->matrix[1] = 0.7f;
    svo_pose_resolve(&p->pose, low, high);
    p->all = (svo_poses){.count = 1, .pose = &p->pose, .matrix_count = 1, .matrix = p->matrix};
    p->map = svo_deform_make(&p->all, &p->pose, &id, &id);
}

static void draw_reference(posed_mesh *p, RTCDevice device, const svo_mesh *mesh, uint32_t width)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
        for (uint32_t k = 0; k < shape->part_count; k++)
            for (uint64_t v = 0; v < shape->parts[k].vertex_count; v++) {
                const double *x = shape->parts[k].positions + 3 * v;
                const svo_vec3 at = move_point(p, svo_mat4_point(&mesh->instances[i].transform, svo_v3(x[0], x[1], x[2])));
                const double c[3] = {at.x, at.y, at.z};
                for (int a = 0; a < 3; a++) low[a] = fmin(low[a], c[a]), high[a] = fmax(high[a], c[a]);
            }
    }
    p->look = svo_default_render_options();
    p->look.width = width, p->look.height = width * 9 / 16, p->look.shadows = false, p->look.transparent = true, p->look.threads = 1;
    p->look.eye = svo_eye_frame(low, high, (double)p->look.width / p->look.height, 0.7);
    p->reference = get(8 * (size_t)p->look.width * p->look.height);
    RTCScene scene = embree_scene(device, mesh, move_point, p);
    embree_picture(scene, &p->look, p->reference);
    rtcReleaseScene(scene);
}

/* Pixels as svo_render writes them to light times coverage, and coverage. */
static void to_light(const uint8_t *pixels, uint32_t count, float *light)
{
    for (uint32_t i = 0; i < count; i++) {
        light[4 * i + 3] = pixels[4 * i + 3] / 255.0f;
        for (int k = 0; k < 3; k++) light[4 * i + k] = svo_srgb_to_linear(pixels[4 * i + k]) * light[4 * i + 3];
    }
}

static void draw_boxes(const char *file, const svo_scene *scene, const svo_select_options *o, svo_draw_method method, const svo_render_options *look, uint8_t *pixels, double *ready,
                       uint64_t *boxes)
{
    svo_selection s;
    svo_error err = {0};
    if (svo_select(scene, o, &s, &err) != SVO_OK) fail(file, &err);
    *ready = seconds();
    *boxes = s.count;
    if (svo_select_render(scene, &s, look, method, pixels, NULL, NULL, &err) != SVO_OK) fail(file, &err);
    svo_selection_free(&s);
}

static void draw_cells(const char *file, const svo_scene *scene, const svo_select_options *select, svo_resample_method method, const svo_render_options *look, uint8_t *pixels, double *ready,
                       uint64_t *boxes, uint64_t *cells)
{
    const svo_unpose_options o = {.select = *select, .method = method};
    const svo_rays_options rays = svo_default_rays_options();
    svo_unposed *u;
    svo_unpose_report r;
    svo_bvh *bvh;
    svo_error err = {0};
    if (svo_unpose(scene, &o, &u, &r, &err) != SVO_OK) fail(file, &err);
    if (svo_bvh_build(svo_unposed_scene(u), 1, NULL, NULL, &bvh, NULL, &err) != SVO_OK || svo_bvh_use_rays(bvh, &rays, NULL, &err) != SVO_OK) fail(file, &err);
    *ready = seconds();
    *boxes = r.select.selected, *cells = r.hierarchy.cells;
    if (svo_render(bvh, svo_unposed_scene(u), look, pixels, NULL, &err) != SVO_OK) fail(file, &err);
    svo_bvh_free(bvh);
    svo_unposed_free(u);
}

static void compare(const char *file, const svo_view *view, const posed_mesh *p)
{
    static const char *const methods[] = {"mipmap", "direct", "resize", "emit"};
    const uint32_t count = p->look.width * p->look.height;
    uint8_t *pixels = get(4 * (size_t)count);
    float *light = get(16 * (size_t)count);
    svo_scene_one one;
    svo_error err = {0};
    uint32_t number = 0;
    if (svo_scene_single(view, file, NULL, &one, &err) != SVO_OK) fail(file, &err);
    for (int k = 0; k < 3; k++) one.page.low[k] = -1e9, one.page.high[k] = 1e9;
    one.scene.instance_pose = &number, one.scene.poses = p->all;
    for (int method = 0; method < 4; method++)
        for (uint32_t delta = 1; delta <= 4; delta *= 2) {
            svo_render_options look = p->look;
            svo_select_options select = {.eye = look.eye, .width = SAMPLES * look.width, .height = SAMPLES * look.height, .delta = delta, .everything = true, .frustum = true,
                                         .occlusion = true, .threads = 1};
            uint64_t boxes = 0, cells = 0;
            double before = INFINITY, drawing = INFINITY;
            look.samples = SAMPLES;
            for (int i = 0; i < REPEATS; i++) {
                const double start = seconds();
                double ready;
                if (method < 2) draw_boxes(file, &one.scene, &select, method == 0 ? SVO_DRAW_MIPMAPS : SVO_DRAW_BOXES, &look, pixels, &ready, &boxes);
                else draw_cells(file, &one.scene, &select, method == 2 ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT, &look, pixels, &ready, &boxes, &cells);
                before = fmin(before, ready - start), drawing = fmin(drawing, seconds() - ready);
            }
            to_light(pixels, count, light);
            const picture_error e = picture_compare(light, p->reference, count);
            printf("%s,%u,%s,%s,%u,%llu,%llu,%.4f,%.4f,%.4f,%.5f,%.1f,%.4f\n", file, view->depth, p->name, methods[method], delta, (unsigned long long)boxes, (unsigned long long)cells, before,
                   drawing, before + drawing, e.rms, e.outline, e.most);
            fflush(stdout);
        }
    free(pixels), free(light);
}

int main(int argc, char **argv)
{
    uint32_t width;
    svo_mesh mesh;
    svo_error err = {0};
    double low[3], high[3];
    const int at = bench_begin("bench_poses", argc, argv, &width, &mesh, low, high);
    RTCDevice device = rtcNewDevice("threads=1");
    posed_mesh poses[4];
    for (int k = 0; k < 4; k++) pose_make(&poses[k], k, low, high), draw_reference(&poses[k], device, &mesh, width);
    puts("file,depth,pose,resample,delta,boxes,cells,ready_seconds,draw_seconds,seconds,rms_light,silhouette_pixels,max_light");
    for (int i = at + 1; i < argc; i++) {
        fmt_bytes bytes;
        fmt_svdag dag;
        if (fmt_bytes_open(argv[i], 0, NULL, &bytes, &err) != SVO_OK || fmt_svdag_open(bytes.data, bytes.size, NULL, &dag, &err) != SVO_OK) fail(argv[i], &err);
        const char *slash = strrchr(argv[i], '/');
        for (int k = 0; k < 4; k++) compare(slash != NULL ? slash + 1 : argv[i], &dag.view, &poses[k]);
        fmt_svdag_close(&dag);
        fmt_bytes_close(&bytes);
    }
    for (int k = 0; k < 4; k++) free(poses[k].reference);
    rtcReleaseDevice(device);
    svo_mesh_free(&mesh);
    return 0;
}
