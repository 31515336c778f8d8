/* Ray rates and image error beside Embree on the source triangles, in one process.
 *
 *     bench_rays [-n REPEATS] [-t THREADS] [-o SET] [-i] [-s] [-a] [-c] [-k KERNEL] MESH A.svdag [B.svdag ...]
 *
 * Four lists of rays, made with Embree from the triangles of MESH, in its coordinates:
 *   primary  1280x720 in the order of 4x4 blocks; svo-render's automatic view, or with -i from inside along the longest side
 *   shadow   from each primary hit towards one light, any hit
 *   diffuse  from each primary hit over the hemisphere, weighted by the cosine
 *   random   10^6 chords from a sphere around the box into the box
 * Secondary rays begin 1/240 of the longest side along the normal above the hit: 4 voxels at 1024^3.
 * All systems take turns on the same list, which is traced as often as fills a fifth of a second: a list takes 10 ms, in which a new thread's cold caches and
 * whatever else the machine does count too much. A rate is of thread CPU time, best of the repeats, with -t 2 of two threads (rays over the mean of their CPU
 * times), beside what one thread does in the same repeats. -o takes one list alone (primary, shadow, ...). -s adds svo_raycast, -c compares every hit with svo_raycast's.
 * -a decodes all attributes of every hit as well. -k takes another kernel than the best: avx2 or portable. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "embree_mesh.h"
#include "fmt_file.h"
#include "fmt_import.h"
#include "fmt_svdag.h"
#include "svo_rays.h"
#include "svo_render.h"

enum { SETS = 4, PRIMARY = 0, SHADOW = 1, DIFFUSE = 2, RANDOM = 3, MAX_FILES = 8, CHUNK = 4096, BATCH = 256, MAX_THREADS = 64 };
static const char *set_names[SETS] = {"primary", "shadow", "diffuse", "random"};

typedef struct world_ray { float origin[3], direction[3]; } world_ray;
typedef struct ray_list { uint64_t count; world_ray *rays; } ray_list;

static double thread_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *get(uint64_t count, size_t size)
{
    void *p = NULL;
    if (posix_memalign(&p, 64, (count + 16) * size) != 0) fputs("out of memory\n", stderr), exit(1);
    return p;
}

static double random_unit(uint64_t *state) /* splitmix64 */
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

static svo_vec3 on_sphere(uint64_t *seed)
{
    double z = 2 * random_unit(seed) - 1, a = 6.283185307179586 * random_unit(seed), r = sqrt(1 - z * z);
    return svo_v3(r * cos(a), r * sin(a), z);
}

/* ---- Embree --------------------------------------------------------------------------------------------------------- */

static uint64_t embree_chunk(RTCScene scene, const world_ray *rays, uint32_t count, int set)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    if (set == PRIMARY || set == SHADOW) context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    uint64_t hits = 0;
    for (uint32_t i = 0; i < count; i += 16) {
        _Alignas(64) struct RTCRayHit16 h;
        _Alignas(64) int valid[16];
        for (uint32_t l = 0; l < 16; l++) {
            bool used = i + l < count;
            const world_ray *r = &rays[used ? i + l : i];
            valid[l] = used ? -1 : 0;
            h.ray.org_x[l] = r->origin[0], h.ray.org_y[l] = r->origin[1], h.ray.org_z[l] = r->origin[2];
            h.ray.dir_x[l] = r->direction[0], h.ray.dir_y[l] = r->direction[1], h.ray.dir_z[l] = r->direction[2];
            h.ray.tnear[l] = 0, h.ray.tfar[l] = INFINITY, h.ray.time[l] = 0;
            h.ray.mask[l] = 0xffffffffu, h.ray.id[l] = 0, h.ray.flags[l] = 0;
            h.hit.geomID[l] = RTC_INVALID_GEOMETRY_ID, h.hit.instID[0][l] = RTC_INVALID_GEOMETRY_ID;
        }
        if (set == SHADOW) rtcOccluded16(valid, scene, &context, (struct RTCRay16 *)&h.ray);
        else rtcIntersect16(valid, scene, &context, &h);
        for (uint32_t l = 0; l < 16; l++) hits += valid[l] && (set == SHADOW ? h.ray.tfar[l] < 0 : h.hit.geomID[l] != RTC_INVALID_GEOMETRY_ID);
    }
    return hits;
}

/* t and normal of one ray; false for none. */
static bool embree_one(RTCScene scene, const world_ray *r, double *t, svo_vec3 *normal)
{
    struct RTCIntersectContext context;
    struct RTCRayHit h;
    rtcInitIntersectContext(&context);
    memset(&h, 0, sizeof h);
    h.ray.org_x = r->origin[0], h.ray.org_y = r->origin[1], h.ray.org_z = r->origin[2];
    h.ray.dir_x = r->direction[0], h.ray.dir_y = r->direction[1], h.ray.dir_z = r->direction[2];
    h.ray.tfar = INFINITY, h.ray.mask = 0xffffffffu;
    h.hit.geomID = RTC_INVALID_GEOMETRY_ID, h.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(scene, &context, &h);
    if (h.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;
    *t = h.ray.tfar;
    *normal = svo_normalize(svo_v3(h.hit.Ng_x, h.hit.Ng_y, h.hit.Ng_z));
    return true;
}

/* ---- lists of rays ---------------------------------------------------------------------------------------------------- */

static void put(ray_list *l, svo_vec3 o, svo_vec3 d)
{
    world_ray *r = &l->rays[l->count++];
    r->origin[0] = (float)o.x, r->origin[1] = (float)o.y, r->origin[2] = (float)o.z;
    r->direction[0] = (float)d.x, r->direction[1] = (float)d.y, r->direction[2] = (float)d.z;
}

static void make_rays(ray_list lists[SETS], RTCScene scene, const double low[3], const double high[3], bool inside)
{
    svo_render_options o = svo_default_render_options();
    svo_vec3 middle = {0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])}, size = {high[0] - low[0], high[1] - low[1], high[2] - low[2]};
    double longest = fmax(size.x, fmax(size.y, size.z)), radius = 0.5 * svo_length(size);
    o.eye = svo_eye_frame(low, high, 1280.0 / 720, 0.7);
    if (inside) {
        svo_vec3 along = size.x >= size.z ? svo_v3(1, 0, 0) : svo_v3(0, 0, 1), at = middle;
        at.y = low[1] + 0.35 * size.y;
        at = svo_add(at, svo_scale(along, -0.4 * longest));
        if (svo_eye_look(at, svo_add(at, svo_add(along, svo_v3(0.03, 0.05, 0.04))), svo_v3(0, 1, 0), 1.1, &o.eye, NULL) != SVO_OK) exit(1);
    }
    for (int s = 0; s < SETS; s++) lists[s] = (ray_list){0, get(s == RANDOM ? 1000000 : 1280 * 720, sizeof(world_ray))};
    svo_vec3 light = svo_normalize(svo_v3(0.4, 0.9, 0.35));
    uint64_t seed = 1;
    for (uint32_t y = 0; y < 720; y += 4)
        for (uint32_t x = 0; x < 1280; x += 4)
            for (uint32_t i = 0; i < 16; i++) {
                svo_scene_ray r = svo_render_ray(&o, x + i % 4 + 0.5, y + i / 4 + 0.5);
                put(&lists[PRIMARY], r.origin, r.direction);
                double t;
                svo_vec3 n;
                if (!embree_one(scene, &lists[PRIMARY].rays[lists[PRIMARY].count - 1], &t, &n)) continue;
                if (svo_dot(n, r.direction) > 0) n = svo_scale(n, -1);
                svo_vec3 at = svo_add(svo_add(r.origin, svo_scale(r.direction, t)), svo_scale(n, longest / 240));
                put(&lists[SHADOW], at, light);
                put(&lists[DIFFUSE], at, svo_normalize(svo_add(n, svo_scale(on_sphere(&seed), 0.9999))));
            }
    for (int i = 0; i < 1000000; i++) {
        svo_vec3 from = svo_add(middle, svo_scale(on_sphere(&seed), radius));
        svo_vec3 to = {low[0] + size.x * random_unit(&seed), low[1] + size.y * random_unit(&seed), low[2] + size.z * random_unit(&seed)};
        put(&lists[RANDOM], from, svo_normalize(svo_sub(to, from)));
    }
}

/* ---- one system on one list --------------------------------------------------------------------------------------------- */

static bool decode; /* attributes of hits too */

typedef enum system_kind { EMBREE, RAYS, RAYCAST } system_kind;
typedef struct job {
    system_kind kind;
    int set;
    RTCScene scene;
    const world_ray *world;
    const svo_view *view;
    const svo_rays *rays;
    const svo_ray *grid;
    uint64_t count, passes; /* rays, and how often they are traced */
    atomic_uint_fast64_t next;
} job;
typedef struct worker { job *job; double seconds; uint64_t hits, sum; pthread_t thread; } worker;

static void *work(void *user)
{
    worker *w = user;
    job *j = w->job;
    svo_hit *hits = get(CHUNK, sizeof *hits);
    bool *blocked = get(CHUNK, sizeof *blocked);
    uint8_t *values = get(CHUNK, SVO_MAX_STRIDE);
    double start = thread_seconds();
    w->hits = w->sum = 0;
    const uint64_t chunks = (j->count + CHUNK - 1) / CHUNK;
    for (;;) {
        uint64_t first = atomic_fetch_add(&j->next, 1);
        if (first >= chunks * j->passes) break;
        first = first % chunks * CHUNK;
        uint32_t n = j->count - first < CHUNK ? (uint32_t)(j->count - first) : CHUNK;
        bool any = j->set == SHADOW;
        if (j->kind == EMBREE) w->hits += embree_chunk(j->scene, j->world + first, n, j->set);
        else {
            if (j->kind == RAYS && any) svo_rays_blocked(j->rays, j->grid + first, n, blocked);
            else if (j->kind == RAYS) svo_rays_cast(j->rays, j->grid + first, n, hits);
            else if (any)
                for (uint32_t i = 0; i < n; i++) blocked[i] = svo_ray_blocked(j->view, j->grid + first + i);
            else
                for (uint32_t i = 0; i < n; i += BATCH) svo_raycast(j->view, j->grid + first + i, n - i < BATCH ? n - i : BATCH, hits + i);
            for (uint32_t c = 0; decode && !any && c < j->view->channel_count; c++) {
                svo_rays_values(j->view, c, hits, n, values);
                w->sum += values[0];
            }
            for (uint32_t i = 0; i < n; i++) w->hits += any ? blocked[i] : hits[i].hit;
        }
    }
    w->seconds = thread_seconds() - start;
    free(hits), free(blocked), free(values);
    return NULL;
}

/* Seconds of a thread for one pass. */
static double run_passes(job *j, int threads, uint64_t passes, uint64_t *hits)
{
    worker w[MAX_THREADS];
    double seconds = 0;
    j->next = 0;
    j->passes = passes;
    *hits = 0;
    for (int i = 0; i < threads; i++) {
        w[i].job = j;
        if (i + 1 == threads) work(&w[i]);
        else if (pthread_create(&w[i].thread, NULL, work, &w[i]) != 0) fputs("no thread\n", stderr), exit(1);
    }
    for (int i = 0; i < threads; i++) {
        if (i + 1 != threads) pthread_join(w[i].thread, NULL);
        seconds += w[i].seconds;
        *hits += w[i].hits;
    }
    *hits /= passes;
    return seconds / threads / (double)passes;
}

/* One system: passes of a run, 0 for not known yet; best times of one thread and of all. */
typedef struct score { uint64_t passes, hits; double one, all; } score;

static void run(job *j, int threads, score *s)
{
    uint64_t hits;
    if (s->passes == 0) {
        s->passes = 1 + (uint64_t)(0.2 * threads / run_passes(j, 1, 1, &hits));
        s->one = s->all = INFINITY;
    }
    if (threads > 1) s->one = fmin(s->one, run_passes(j, 1, s->passes, &hits));
    s->all = fmin(s->all, run_passes(j, threads, s->passes, &s->hits));
}

static uint64_t differences(const svo_view *v, const svo_rays *r, const svo_ray *rays, uint64_t count)
{
    uint64_t bad = 0;
    svo_hit *a = get(BATCH, sizeof *a), *b = get(BATCH, sizeof *b);
    bool *blocked = get(BATCH, sizeof *blocked);
    for (uint64_t i = 0; i < count; i += BATCH) {
        uint32_t n = count - i < BATCH ? (uint32_t)(count - i) : BATCH;
        svo_raycast(v, rays + i, n, a);
        svo_rays_cast(r, rays + i, n, b);
        svo_rays_blocked(r, rays + i, n, blocked);
        for (uint32_t k = 0; k < n; k++) bad += memcmp(&a[k], &b[k], sizeof *a) != 0 || blocked[k] != a[k].hit;
    }
    free(a), free(b), free(blocked);
    return bad;
}

typedef struct file {
    const char *name;
    fmt_bytes bytes;
    fmt_svdag dag;
    svo_rays *rays;
    svo_rays_report report;
    svo_ray *lists[SETS];
} file;

static void to_grid(file *f, const ray_list lists[SETS])
{
    svo_mat4 m, inverse;
    memcpy(m.m, f->dag.view.voxel_to_world, sizeof m.m);
    if (!svo_mat4_affine_inverse(&m, &inverse)) fputs("singular voxel_to_world\n", stderr), exit(1);
    for (int s = 0; s < SETS; s++) {
        f->lists[s] = get(lists[s].count, sizeof(svo_ray));
        for (uint64_t i = 0; i < lists[s].count; i++) {
            const world_ray *r = &lists[s].rays[i];
            svo_vec3 o = svo_mat4_point(&inverse, svo_v3(r->origin[0], r->origin[1], r->origin[2]));
            svo_vec3 d = svo_mat4_vector(&inverse, svo_v3(r->direction[0], r->direction[1], r->direction[2]));
            f->lists[s][i] = (svo_ray){{o.x, o.y, o.z}, {d.x, d.y, d.z}, 0, INFINITY, 0, 0};
        }
    }
}

static void compare(const file *files, int count, RTCScene scene, const ray_list lists[SETS], int repeats, int threads, bool scalar, const char *only)
{
    for (int s = 0; s < SETS; s++) {
        if (only != NULL && strcmp(only, set_names[s]) != 0) continue;
        score embree = {.passes = 0}, fast[MAX_FILES] = {{.passes = 0}}, slow[MAX_FILES] = {{.passes = 0}};
        for (int r = 0; r < repeats; r++) {
            job j = {.kind = EMBREE, .set = s, .scene = scene, .world = lists[s].rays, .count = lists[s].count};
            run(&j, threads, &embree);
            for (int f = 0; f < count; f++) {
                job k = {.kind = RAYS, .set = s, .view = &files[f].dag.view, .rays = files[f].rays, .grid = files[f].lists[s], .count = lists[s].count};
                run(&k, threads, &fast[f]);
                k.kind = RAYCAST;
                if (scalar && r < 2) run(&k, threads, &slow[f]);
            }
        }
        double n = 1e-6 * (double)lists[s].count, share = 100.0 / (double)lists[s].count;
        printf("%-8s %7.2f M  embree16 %7.2f Mray/s hit %5.1f%%", set_names[s], n, n / embree.all, share * (double)embree.hits);
        if (threads > 1) printf("  %5.2f x one thread", embree.one / embree.all);
        putchar('\n');
        for (int f = 0; f < count; f++) {
            printf("  %-30s %7.2f Mray/s hit %5.1f%%  %5.2f x embree16", files[f].name, n / fast[f].all, share * (double)fast[f].hits, embree.all / fast[f].all);
            if (threads > 1) printf("  %5.2f x one thread", fast[f].one / fast[f].all);
            if (scalar) printf("  svo_raycast %6.2f", n / slow[f].all);
            putchar('\n');
        }
        fflush(stdout);
    }
}

int main(int argc, char **argv)
{
    int repeats = 5, threads = 1, count = 0;
    bool inside = false, scalar = false, check = false;
    const char *mesh_path = NULL, *only = NULL;
    svo_ray_kernel kernel = SVO_KERNEL_AUTO;
    static file files[MAX_FILES];
    svo_error err = {0};
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "-n") == 0 && i + 1 < argc) repeats = atoi(argv[++i]);
        else if (strcmp(argv[i], "-t") == 0 && i + 1 < argc) threads = atoi(argv[++i]);
        else if (strcmp(argv[i], "-o") == 0 && i + 1 < argc) only = argv[++i];
        else if (strcmp(argv[i], "-i") == 0) inside = true;
        else if (strcmp(argv[i], "-s") == 0) scalar = true;
        else if (strcmp(argv[i], "-c") == 0) check = true;
        else if (strcmp(argv[i], "-a") == 0) decode = true;
        else if (strcmp(argv[i], "-k") == 0 && i + 1 < argc) kernel = strcmp(argv[++i], "avx2") == 0 ? SVO_KERNEL_AVX2 : SVO_KERNEL_PORTABLE;
        else if (mesh_path == NULL) mesh_path = argv[i];
        else if (count < MAX_FILES) files[count++].name = argv[i];
    }
    if (count == 0 || repeats < 1 || threads < 1 || threads > MAX_THREADS)
        return fputs("usage: bench_rays [-n REPEATS] [-t THREADS] [-o SET] [-i] [-s] [-a] [-c] [-k KERNEL] MESH A.svdag [B.svdag ...]\n", stderr), 1;
    svo_mesh mesh;
    fmt_import_options import = {.skip_images = true};
    if (fmt_import_mesh(mesh_path, &import, &mesh, &err) != SVO_OK) return fprintf(stderr, "%s: %s\n", mesh_path, err.message), 1;
    double low[3], high[3];
    if (!svo_mesh_bounds(&mesh, low, high)) return fprintf(stderr, "%s: no triangles\n", mesh_path), 1;
    RTCDevice device = rtcNewDevice("threads=1");
    RTCScene scene = embree_scene(device, &mesh, NULL, NULL);
    ray_list lists[SETS];
    make_rays(lists, scene, low, high, inside);
    for (int i = 0; i < count; i++) {
        file *f = &files[i];
        svo_rays_options options = svo_default_rays_options();
        options.kernel = kernel;
        if (fmt_bytes_open(f->name, 0, NULL, &f->bytes, &err) != SVO_OK || fmt_svdag_open(f->bytes.data, f->bytes.size, NULL, &f->dag, &err) != SVO_OK ||
            svo_rays_build(&f->dag.view, &options, &f->rays, &f->report, &err) != SVO_OK)
            return fprintf(stderr, "%s: %s\n", f->name, err.message), 1;
        const char *slash = strrchr(f->name, '/');
        f->name = slash != NULL ? slash + 1 : f->name;
        to_grid(f, lists);
        printf("%-30s depth %u, %llu voxels, file %llu bytes; kernel %s, %llu bytes in %.3f s\n", f->name, f->dag.view.depth,
               (unsigned long long)f->dag.view.nodes[f->dag.view.depth], (unsigned long long)f->bytes.size, svo_ray_kernel_name(f->report.kernel),
               (unsigned long long)f->report.bytes, f->report.seconds);
    }
    if (check)
        for (int i = 0; i < count; i++)
            for (int s = 0; s < SETS; s++)
                printf("%-30s %-8s %llu of %llu rays differ from svo_raycast\n", files[i].name, set_names[s],
                       (unsigned long long)differences(&files[i].dag.view, files[i].rays, files[i].lists[s], lists[s].count), (unsigned long long)lists[s].count);
    fflush(stdout);
    compare(files, count, scene, lists, repeats, threads, scalar, only);
    for (int i = 0; i < count; i++) {
        svo_rays_free(files[i].rays);
        fmt_svdag_close(&files[i].dag);
        fmt_bytes_close(&files[i].bytes);
    }
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    svo_mesh_free(&mesh);
    return 0;
}
