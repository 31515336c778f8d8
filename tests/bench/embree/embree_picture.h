/* A picture of a mesh as Embree traces it, to measure others against. */
#ifndef EMBREE_PICTURE_H
#define EMBREE_PICTURE_H

#include <math.h>
#include <time.h>

#include "embree_mesh.h"
#include "fmt_import.h"
#include "svo_render.h"

/* Of this thread. */
static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Both end the program. */
static void *get(size_t size)
{
    void *p = malloc(size);
    if (p == NULL) fputs("out of memory\n", stderr), exit(1);
    return p;
}

static void fail(const char *name, const svo_error *err)
{
    fprintf(stderr, "%s: %s\n", name, err->message);
    exit(1);
}

/* Reads "NAME [-w WIDTH] MESH FILES...": the mesh, free by svo_mesh_free, and its bounds. Returns the place of MESH. */
static int bench_begin(const char *name, int argc, char **argv, uint32_t *width, svo_mesh *mesh, double low[3], double high[3])
{
    const fmt_import_options import = {.skip_images = true};
    svo_error err = {0};
    int at = 1;
    *width = 640;
    if (argc > 3 && strcmp(argv[1], "-w") == 0) *width = (uint32_t)atoi(argv[2]), at = 3;
    if (argc < at + 2 || *width < 16 || *width > 4096) fprintf(stderr, "usage: %s [-w WIDTH] MESH A.svdag [B.svdag ...]\n", name), exit(1);
    if (fmt_import_mesh(argv[at], &import, mesh, &err) != SVO_OK) fail(argv[at], &err);
    if (!svo_mesh_bounds(mesh, low, high)) fprintf(stderr, "%s: no triangles\n", argv[at]), exit(1);
    return at;
}

enum { EMBREE_SAMPLES = 8 }; /* a side */

/* As svo-render lights without shadows. Light (of the grey that svo_render takes where there is no colour) and coverage, 2 a pixel. */
static void embree_picture(RTCScene scene, const svo_render_options *o, float *out)
{
    struct RTCIntersectContext context;
    svo_vec3 light = svo_normalize(o->light);
    for (uint32_t i = 0; i < o->width * o->height; i++) {
        double sum = 0, cover = 0;
        for (uint32_t s = 0; s < EMBREE_SAMPLES * EMBREE_SAMPLES; s++) {
            svo_scene_ray r = svo_render_ray(o, i % o->width + (s % EMBREE_SAMPLES + 0.5) / EMBREE_SAMPLES, i / o->width + (s / EMBREE_SAMPLES + 0.5) / EMBREE_SAMPLES);
            struct RTCRayHit h;
            memset(&h, 0, sizeof h);
            h.ray.org_x = (float)r.origin.x, h.ray.org_y = (float)r.origin.y, h.ray.org_z = (float)r.origin.z;
            h.ray.dir_x = (float)r.direction.x, h.ray.dir_y = (float)r.direction.y, h.ray.dir_z = (float)r.direction.z;
            h.ray.tfar = INFINITY, h.ray.mask = 0xffffffffu;
            h.hit.geomID = RTC_INVALID_GEOMETRY_ID, h.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
            rtcInitIntersectContext(&context);
            rtcIntersect1(scene, &context, &h);
            if (h.hit.geomID == RTC_INVALID_GEOMETRY_ID) continue;
            svo_vec3 n = svo_normalize(svo_v3(h.hit.Ng_x, h.hit.Ng_y, h.hit.Ng_z));
            if (svo_dot(n, r.direction) > 0) n = svo_scale(n, -1);
            sum += 0.6 * (o->ambient * (0.75 + 0.25 * n.y) + (1 - o->ambient) * fmax(0, svo_dot(n, light)));
            cover++;
        }
        out[2 * i] = (float)(sum / (EMBREE_SAMPLES * EMBREE_SAMPLES)), out[2 * i + 1] = (float)(cover / (EMBREE_SAMPLES * EMBREE_SAMPLES));
    }
}

/* Of what a picture and the reference cover: root mean square and largest difference of light, and pixels of silhouette (sum of differences in coverage). */
typedef struct picture_error { double rms, most, outline; } picture_error;

/* light: linear RGBA as in svo_render_planes. */
static picture_error picture_compare(const float *light, const float *reference, uint32_t pixels)
{
    picture_error e = {0, 0, 0};
    uint64_t count = 0;
    for (uint32_t i = 0; i < pixels; i++) {
        if (light[4 * i + 3] == 0 && reference[2 * i + 1] == 0) continue;
        const double d = light[4 * i] - reference[2 * i];
        e.rms += d * d, count++;
        e.most = fmax(e.most, fabs(d));
        e.outline += fabs(light[4 * i + 3] - reference[2 * i + 1]);
    }
    e.rms = sqrt(e.rms / (double)(count > 0 ? count : 1));
    return e;
}

#endif
