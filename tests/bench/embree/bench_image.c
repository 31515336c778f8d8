/* Error of pictures against the triangles, over seconds and bytes.
 *
 *     bench_image [-w WIDTH] MESH A.svdag [B.svdag ...] > image.csv
 *
 * The reference is MESH (its triangles alone: no textures) traced by Embree with 8x8 samples a pixel, and lit as svo-render lights without shadows: grey, from the
 * default light and from everywhere. The files, octrees of the same mesh without colours (any depth and bounds), are drawn by svo_render with both kernels, 1, 2 and 4
 * samples a side, and delta (`--footprint`) 0, 1, 2 and 4. A line each: root mean square difference of linear light over the pixels that the reference or the picture covers, pixels of silhouette error
 * (sum of differences in coverage), largest difference, bytes of the file, and thread CPU seconds with one thread, best of three. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "embree_picture.h"
#include "fmt_file.h"
#include "fmt_svdag.h"
#include "svo_rays.h"
#include "svo_render.h"

enum { REPEATS = 3 };

static void compare(const char *name, uint64_t bytes, const svo_view *view, svo_render_options o, const float *reference)
{
    static const uint32_t samples[] = {1, 2, 4}, footprints[] = {0, 1, 2, 4};
    const uint32_t pixels = o.width * o.height;
    uint8_t *picture = get(4 * (size_t)pixels);
    float *light = get(16 * (size_t)pixels);
    svo_render_planes planes = {.light = light};
    for (int k = 0; k < 2; k++) {
        svo_scene_one storage;
        svo_warnings warnings;
        svo_bvh *bvh;
        svo_error err = {0};
        memset(&warnings, 0, sizeof warnings);
        svo_rays_options rays = svo_default_rays_options();
        rays.kernel = k == 0 ? SVO_KERNEL_PORTABLE : SVO_KERNEL_AVX512;
        if (svo_scene_single(view, name, NULL, &storage, &err) != SVO_OK || svo_bvh_build(&storage.scene, 1, NULL, &warnings, &bvh, NULL, &err) != SVO_OK ||
            (k == 1 && svo_bvh_use_rays(bvh, &rays, NULL, &err) != SVO_OK))
            fail(name, &err);
        for (size_t s = 0; s < sizeof samples / sizeof *samples; s++)
            for (size_t f = 0; f < sizeof footprints / sizeof *footprints; f++) {
                double best = INFINITY;
                o.samples = samples[s], o.footprint = footprints[f], o.threads = 1;
                for (int i = 0; i < REPEATS; i++) {
                    double start = seconds();
                    if (svo_render_with_planes(bvh, &storage.scene, &o, picture, &planes, NULL, &err) != SVO_OK) fail(name, &err);
                    best = fmin(best, seconds() - start);
                }
                const picture_error e = picture_compare(light, reference, pixels);
                printf("%s,%u,%llu,%s,%u,%u,%.4f,%.5f,%.1f,%.4f\n", name, view->depth, (unsigned long long)bytes, k == 0 ? "portable" : "avx512", samples[s], footprints[f], best,
                       e.rms, e.outline, e.most);
                fflush(stdout);
            }
        svo_bvh_free(bvh);
    }
    free(picture), free(light);
}

int main(int argc, char **argv)
{
    uint32_t width;
    svo_mesh mesh;
    svo_error err = {0};
    double low[3], high[3];
    const int at = bench_begin("bench_image", argc, argv, &width, &mesh, low, high);
    RTCDevice device = rtcNewDevice("threads=1");
    RTCScene scene = embree_scene(device, &mesh, NULL, NULL);
    svo_render_options o = svo_default_render_options();
    o.width = width, o.height = width * 9 / 16, o.shadows = false, o.transparent = true;
    o.eye = svo_eye_frame(low, high, (double)o.width / o.height, 0.7);
    float *reference = get(8 * (size_t)o.width * o.height);
    embree_picture(scene, &o, reference);
    puts("file,depth,bytes,kernel,samples,delta,seconds,rms_light,silhouette_pixels,max_light");
    for (int i = at + 1; i < argc; i++) {
        fmt_bytes bytes;
        fmt_svdag dag;
        if (fmt_bytes_open(argv[i], 0, NULL, &bytes, &err) != SVO_OK || fmt_svdag_open(bytes.data, bytes.size, NULL, &dag, &err) != SVO_OK) fail(argv[i], &err);
        const char *slash = strrchr(argv[i], '/');
        compare(slash != NULL ? slash + 1 : argv[i], bytes.size, &dag.view, o, reference);
        fmt_svdag_close(&dag);
        fmt_bytes_close(&bytes);
    }
    free(reference);
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    svo_mesh_free(&mesh);
    return 0;
}
