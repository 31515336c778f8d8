/* Rates of the ray caster on stored ray lists.
 *
 *     bench_raycast [-r RAYS] [-n REPEATS] A.svdag [B.svdag ...]
 *
 * Four lists, in the mesh's own coordinates so that files of one model at several depths get the same rays:
 *   primary  1280x720 in the order of 4x4 blocks, view of svo-render's automatic framing
 *   shadow   from each primary hit towards one light, any hit
 *   diffuse  from each primary hit over the hemisphere, weighted by the cosine
 *   random   10^6 chords from a sphere around the box into the box
 * With -r they are read from RAYS; if that file is missing they are made from A and written there. Secondary rays begin 4
 * voxels of A along the normal above the hit. Files take turns; the rate is of thread CPU time, best of the repeats. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmt_file.h"
#include "fmt_svdag.h"
#include "svo_render.h"
#include "svo_scene.h"

enum { SETS = 4, PRIMARY = 0, SHADOW = 1, DIFFUSE = 2, RANDOM = 3, MAX_FILES = 16, BATCH = 256 };
static const char *set_names[SETS] = {"primary", "shadow", "diffuse", "random"};

typedef struct stored_ray { double origin[3], direction[3]; } stored_ray;
typedef struct ray_lists { uint64_t count[SETS]; stored_ray *rays[SETS]; } ray_lists;

static double thread_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *get(uint64_t count, size_t size)
{
    void *p = calloc(count + 1, size);
    if (p == NULL) fputs("out of memory\n", stderr), exit(1);
    return p;
}

/* splitmix64 */
static double random_unit(uint64_t *state)
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

static svo_vec3 sphere(uint64_t *seed)
{
    double z = 2 * random_unit(seed) - 1, a = 6.283185307179586 * random_unit(seed), r = sqrt(1 - z * z);
    return svo_v3(r * cos(a), r * sin(a), z);
}

static void put(ray_lists *l, int set, svo_vec3 o, svo_vec3 d)
{
    stored_ray *r = &l->rays[set][l->count[set]++];
    r->origin[0] = o.x, r->origin[1] = o.y, r->origin[2] = o.z, r->direction[0] = d.x, r->direction[1] = d.y, r->direction[2] = d.z;
}

static svo_ray to_grid(const svo_mat4 *inverse, const stored_ray *s)
{
    svo_vec3 o = svo_mat4_point(inverse, svo_v3(s->origin[0], s->origin[1], s->origin[2]));
    svo_vec3 d = svo_mat4_vector(inverse, svo_v3(s->direction[0], s->direction[1], s->direction[2]));
    svo_ray r = {{o.x, o.y, o.z}, {d.x, d.y, d.z}, 0, INFINITY, 0, 0};
    return r;
}

static void make_rays(ray_lists *l, const svo_view *v)
{
    svo_mat4 m, inverse;
    memcpy(m.m, v->voxel_to_world, sizeof m.m);
    uint32_t grid_low[3], grid_high[3];
    bool any;
    if (!svo_mat4_affine_inverse(&m, &inverse) || svo_view_grid_bounds(v, NULL, &any, grid_low, grid_high, NULL) != SVO_OK || !any)
        fputs("the first file has no voxels\n", stderr), exit(1);
    for (int k = 0; k < 3; k++) grid_high[k]++; /* cells to corners */
    double low[3], high[3], radius = 0;
    for (int k = 0; k < 3; k++) low[k] = INFINITY, high[k] = -INFINITY;
    for (int i = 0; i < 8; i++) {
        svo_vec3 p = svo_mat4_point(&m, svo_v3(i & 1 ? grid_high[0] : grid_low[0], i & 2 ? grid_high[1] : grid_low[1], i & 4 ? grid_high[2] : grid_low[2]));
        double x[3] = {p.x, p.y, p.z};
        for (int k = 0; k < 3; k++) low[k] = fmin(low[k], x[k]), high[k] = fmax(high[k], x[k]);
    }
    for (int k = 0; k < 3; k++) radius += 0.25 * (high[k] - low[k]) * (high[k] - low[k]);
    radius = sqrt(radius);
    svo_render_options o = svo_default_render_options();
    o.eye = svo_eye_frame(low, high, 1280.0 / 720, 0.7);
    for (int s = 0; s < SETS; s++) l->rays[s] = get(s == RANDOM ? 1000000 : 1280 * 720, sizeof(stored_ray));
    uint32_t normal = svo_view_find_channel(v, "normal");
    double voxel = cbrt(fabs(svo_mat4_det3(&m)));
    svo_vec3 light = svo_normalize(o.light);
    uint64_t seed = 1;
    for (uint32_t y = 0; y < 720; y += 4)
        for (uint32_t x = 0; x < 1280; x += 4)
            for (uint32_t i = 0; i < 16; i++) {
                svo_scene_ray r = svo_render_ray(&o, x + i % 4 + 0.5, y + i / 4 + 0.5);
                put(l, PRIMARY, r.origin, r.direction);
                svo_ray g = to_grid(&inverse, &l->rays[PRIMARY][l->count[PRIMARY] - 1]);
                svo_hit h;
                svo_raycast(v, &g, 1, &h);
                if (!h.hit || h.face == SVO_FACE_INSIDE) continue;
                double n[3] = {0, 0, 0};
                n[h.face / 2] = h.face & 1 ? 1 : -1;
                svo_vec3 at = svo_add(r.origin, svo_scale(r.direction, h.t)), up = svo_normalize(svo_mat4_normal(&m, svo_v3(n[0], n[1], n[2])));
                if (normal < v->channel_count) {
                    uint8_t value[SVO_MAX_STRIDE];
                    float f[3];
                    svo_view_attribute(v, normal, h.attribute, value);
                    svo_oct32_decode(value, f);
                    up = svo_v3(f[0], f[1], f[2]);
                    if (svo_dot(up, r.direction) > 0) up = svo_scale(up, -1);
                }
                at = svo_add(at, svo_scale(up, 4 * voxel));
                put(l, SHADOW, at, light);
                put(l, DIFFUSE, at, svo_normalize(svo_add(up, svo_scale(sphere(&seed), 0.9999))));
            }
    svo_vec3 middle = {0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])};
    for (int i = 0; i < 1000000; i++) {
        svo_vec3 from = svo_add(middle, svo_scale(sphere(&seed), radius)), to;
        to = svo_v3(low[0] + (high[0] - low[0]) * random_unit(&seed), low[1] + (high[1] - low[1]) * random_unit(&seed),
                    low[2] + (high[2] - low[2]) * random_unit(&seed));
        put(l, RANDOM, from, svo_normalize(svo_sub(to, from)));
    }
}

static bool load_rays(ray_lists *l, const char *path)
{
    FILE *f = fopen(path, "rb");
    if (f == NULL) return false;
    for (int s = 0; s < SETS; s++) {
        if (fread(&l->count[s], 8, 1, f) != 1 || l->count[s] > (uint64_t)1 << 28) fputs("damaged ray file\n", stderr), exit(1);
        l->rays[s] = get(l->count[s], sizeof(stored_ray));
        if (fread(l->rays[s], sizeof(stored_ray), l->count[s], f) != l->count[s]) fputs("damaged ray file\n", stderr), exit(1);
    }
    fclose(f);
    return true;
}

static void save_rays(const ray_lists *l, const char *path)
{
    FILE *f = fopen(path, "wb");
    bool good = f != NULL;
    for (int s = 0; s < SETS && good; s++)
        good = fwrite(&l->count[s], 8, 1, f) == 1 && fwrite(l->rays[s], sizeof(stored_ray), l->count[s], f) == l->count[s];
    if (f == NULL || fclose(f) != 0 || !good) perror(path), exit(1);
}

static uint64_t trace_all(const svo_view *v, const svo_ray *rays, uint64_t count, bool any, svo_hit *hits)
{
    uint64_t sum = 0;
    if (any) {
        for (uint64_t i = 0; i < count; i++) sum += svo_ray_blocked(v, &rays[i]);
        return sum;
    }
    for (uint64_t i = 0; i < count; i += BATCH) {
        uint32_t n = count - i < BATCH ? (uint32_t)(count - i) : BATCH;
        svo_raycast(v, rays + i, n, hits);
        for (uint32_t j = 0; j < n; j++) sum += hits[j].hit;
    }
    return sum;
}

int main(int argc, char **argv)
{
    const char *ray_path = NULL, *paths[MAX_FILES];
    int repeats = 6, files = 0;
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "-r") == 0 && i + 1 < argc) ray_path = argv[++i];
        else if (strcmp(argv[i], "-n") == 0 && i + 1 < argc) repeats = atoi(argv[++i]);
        else if (files < MAX_FILES) paths[files++] = argv[i];
    }
    if (files == 0 || repeats < 1) return fputs("usage: bench_raycast [-r RAYS] [-n REPEATS] A.svdag [B.svdag ...]\n", stderr), 1;
    static fmt_bytes bytes[MAX_FILES];
    static fmt_svdag dags[MAX_FILES];
    svo_error err;
    for (int f = 0; f < files; f++)
        if (fmt_bytes_open(paths[f], 0, NULL, &bytes[f], &err) != SVO_OK || fmt_svdag_open(bytes[f].data, bytes[f].size, NULL, &dags[f], &err) != SVO_OK)
            return fprintf(stderr, "%s: %s\n", paths[f], err.message), 1;
    ray_lists lists = {{0}, {NULL}};
    if (ray_path == NULL || !load_rays(&lists, ray_path)) {
        make_rays(&lists, &dags[0].view);
        if (ray_path != NULL) save_rays(&lists, ray_path);
    }
    printf("%-28s %5s %10s %12s", "file", "depth", "bytes", "voxels");
    for (int s = 0; s < SETS; s++) printf(" %8s %6s", set_names[s], "hit");
    puts("   (Mray/s of one thread's CPU time)");
    double best[MAX_FILES][SETS];
    uint64_t hits[MAX_FILES][SETS];
    svo_hit *buffer = get(BATCH, sizeof *buffer);
    for (int s = 0; s < SETS; s++)
        for (int r = 0; r < repeats; r++)
            for (int f = 0; f < files; f++) {
                svo_mat4 m, inverse;
                memcpy(m.m, dags[f].view.voxel_to_world, sizeof m.m);
                if (!svo_mat4_affine_inverse(&m, &inverse)) return fprintf(stderr, "%s: singular voxel_to_world\n", paths[f]), 1;
                svo_ray *rays = get(lists.count[s], sizeof *rays);
                for (uint64_t i = 0; i < lists.count[s]; i++) rays[i] = to_grid(&inverse, &lists.rays[s][i]);
                double start = thread_seconds();
                hits[f][s] = trace_all(&dags[f].view, rays, lists.count[s], s == SHADOW, buffer);
                double seconds = thread_seconds() - start;
                if (r == 0 || seconds < best[f][s]) best[f][s] = seconds;
                free(rays);
            }
    for (int f = 0; f < files; f++) {
        const char *name = strrchr(paths[f], '/');
        printf("%-28s %5u %10llu %12llu", name ? name + 1 : paths[f], dags[f].view.depth, (unsigned long long)bytes[f].size,
               (unsigned long long)dags[f].view.nodes[dags[f].view.depth]);
        for (int s = 0; s < SETS; s++)
            printf(" %8.2f %5.1f%%", (double)lists.count[s] / best[f][s] / 1e6, 100.0 * (double)hits[f][s] / (double)(lists.count[s] + !lists.count[s]));
        putchar('\n');
        fmt_svdag_close(&dags[f]);
        fmt_bytes_close(&bytes[f]);
    }
    for (int s = 0; s < SETS; s++) free(lists.rays[s]);
    free(buffer);
    return 0;
}
