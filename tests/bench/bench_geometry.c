/* Sizes and rates of the layouts of a packed octree on the same voxels, in one run.
 *
 *     bench_geometry [-c] [-s] [-n ROUNDS] [-q QUERIES] A.svdag [B.svdag ...]
 *
 * Every layout is made of the voxels of A twice: without attributes (nothing is numbered) and with one 8-bit channel that
 * varies, lod on (every node is numbered). Bits are geometry only, a finest voxel and a node of the octree.
 *   build    seconds of CPU: merging under symmetry and laying out, after the voxels are in the builder's tables
 *   hit      ns: svo_view_voxel with index at random voxels
 *   is       ns: the same, without index
 *   near     ns: without index, at cells next to random voxels (about half are empty)
 *   primary  Mray/s, 1280x720 in blocks of 4x4, seen from outside
 *   random   Mray/s, chords through the box
 * -c: as CSV. -s: rates alone, without the unnumbered octrees (their sizes are 0).
 *
 * Rates are those of numbered octrees. Layouts take turns in short rounds: a slice of the questions that is not counted, so that a layout
 * finds the caches as it leaves them, and then the next slice, in the thread's CPU time. A ratio is the median of the rounds' ratios to
 * layout 1, a time that of layout 1 in its median round times the ratio: what else the machine does then falls on all layouts alike. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bench_median.h"
#include "fmt_file.h"
#include "fmt_svdag.h"
#include "svo_dag.h"
#include "svo_morton.h"
#include "svo_render.h"
#include "svo_unpack.h"

enum { LAYOUTS = 4, RAY_SETS = 2, BATCH = 256, KINDS = 5, MOST_ROUNDS = 1001 };
static const char *const layout_names[LAYOUTS] = {"svdag", "fast", "symmetric", "best"};
static const svo_geometry layout_ids[LAYOUTS] = {SVO_GEOMETRY_SVDAG, SVO_GEOMETRY_FAST, SVO_GEOMETRY_SYMMETRIC, SVO_GEOMETRY_BEST};

static double seconds(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static uint64_t random_number(uint64_t *state)
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return z ^ z >> 31;
}
static double random_unit(uint64_t *state) { return (double)(random_number(state) >> 11) * 0x1p-53; }

static void *get(uint64_t count, size_t size)
{
    void *p = calloc(count + 1, size);
    if (p == NULL) fputs("out of memory\n", stderr), exit(1);
    return p;
}

static void must(svo_result r, const svo_error *err)
{
    if (r != SVO_OK) fprintf(stderr, "%s\n", err->message), exit(1);
}

/* --- the same voxels with a channel of our own -------------------------------------------------------------------- */

typedef struct relabel { svo_chunk_source from; bool channel; } relabel;

static svo_result relabel_fetch(void *user, svo_buffer *packed, bool *more, svo_error *err)
{
    relabel *r = user;
    return r->from.fetch(r->from.user, packed, more, err);
}

static svo_result relabel_decode(void *user, const svo_buffer *packed, svo_buffer *storage, svo_chunk *out, svo_error *err)
{
    relabel *r = user;
    SVO_TRY(r->from.decode(r->from.user, packed, storage, out, err));
    if (!r->channel) return SVO_OK;
    uint64_t masks = out->node_count, values = out->value_count;
    storage->size = (size_t)masks; /* masks are at the begin; channels are not wanted */
    if (!svo_buffer_reserve(storage, (size_t)values)) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    for (uint64_t i = 0; i < values; i++) storage->data[masks + i] = (uint8_t)(i * 7 ^ i >> 5);
    out->masks = storage->data;
    out->channels[0] = storage->data + masks;
    return SVO_OK;
}

typedef struct phases { double geometry, attributes; } phases;
static void on_phase(void *user, const char *name)
{
    phases *p = user;
    *(strcmp(name, "geometry") == 0 ? &p->geometry : &p->attributes) = seconds(CLOCK_PROCESS_CPUTIME_ID);
}

static svo_packed *build(const svo_view *v, svo_geometry geometry, bool numbered, double *cpu)
{
    svo_unpack u;
    svo_unpack_begin(&u, v);
    relabel r = {svo_unpack_source(&u), numbered};
    svo_tree_info info = svo_unpack_info(v);
    info.channel_count = numbered ? 1 : 0;
    memset(info.channels, 0, sizeof info.channels);
    strcpy(info.channels[0].name, "metallic");
    info.channels[0].kind = SVO_KIND_UNORM8;
    phases t = {0, 0};
    svo_dag_options o = svo_default_dag_options();
    o.geometry = geometry;
    o.phase = on_phase, o.phase_user = &t;
    svo_chunk_source s = {&r, relabel_fetch, relabel_decode};
    svo_packed *p;
    svo_error err;
    must(svo_dag_build(&info, &s, &o, &p, NULL, &err), &err);
    *cpu = t.attributes - t.geometry;
    return p;
}

/* --- queries ------------------------------------------------------------------------------------------------------ */

typedef struct cells { uint32_t (*cell)[3]; uint64_t count, capacity, step, at, seed; } cells;

/* A random voxel of each run of `step`. */
static bool pick(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    cells *c = user;
    (void)index;
    if (c->at++ % c->step != 0 || c->count == c->capacity) return true;
    uint32_t *to = c->cell[c->count++];
    to[0] = x, to[1] = y, to[2] = z;
    return true;
}

/* A slice of the questions. Returns seconds. */
static double query(const svo_view *v, const cells *c, uint64_t first, uint64_t count, bool index, uint64_t *check)
{
    double start = seconds(CLOCK_THREAD_CPUTIME_ID);
    uint64_t sum = 0, i = 0;
    for (uint64_t k = first; k < first + count; k++) sum += svo_view_voxel(v, c->cell[k][0], c->cell[k][1], c->cell[k][2], index ? &i : NULL) + 3 * i;
    *check += sum;
    return seconds(CLOCK_THREAD_CPUTIME_ID) - start;
}

typedef struct rays { svo_ray *ray; uint64_t count; } rays;

static void make_rays(const svo_view *v, rays sets[RAY_SETS])
{
    svo_error err;
    uint32_t low[3], high[3];
    bool any;
    must(svo_view_grid_bounds(v, NULL, &any, low, high, &err), &err);
    double from[3], to[3], radius = 0;
    for (int k = 0; k < 3; k++) from[k] = low[k], to[k] = high[k] + 1.0, radius += 0.25 * (to[k] - from[k]) * (to[k] - from[k]);
    radius = sqrt(radius);
    svo_render_options o = svo_default_render_options();
    o.eye = svo_eye_frame(from, to, 1280.0 / 720, 0.7);
    sets[0] = (rays){get(1280 * 720, sizeof(svo_ray)), 0};
    for (uint32_t y = 0; y < 720; y += 4)
        for (uint32_t x = 0; x < 1280; x += 4)
            for (uint32_t i = 0; i < 16; i++) {
                svo_scene_ray r = svo_render_ray(&o, x + i % 4 + 0.5, y + i / 4 + 0.5);
                sets[0].ray[sets[0].count++] = (svo_ray){{r.origin.x, r.origin.y, r.origin.z}, {r.direction.x, r.direction.y, r.direction.z}, 0, INFINITY, 0, 0};
            }
    enum { CHORDS = 400000 };
    sets[1] = (rays){get(CHORDS, sizeof(svo_ray)), 0};
    uint64_t seed = 1;
    for (int i = 0; i < CHORDS; i++) {
        double z = 2 * random_unit(&seed) - 1, a = 6.283185307179586 * random_unit(&seed), s = sqrt(1 - z * z);
        double out[3] = {s * cos(a), s * sin(a), z};
        svo_ray r = {.t_max = INFINITY};
        for (int k = 0; k < 3; k++) {
            r.origin[k] = 0.5 * (from[k] + to[k]) + radius * out[k];
            r.direction[k] = from[k] + (to[k] - from[k]) * random_unit(&seed) - r.origin[k];
        }
        sets[1].ray[sets[1].count++] = r;
    }
}

static double cast(const svo_view *v, const rays *r, uint64_t first, uint64_t count, uint64_t *check)
{
    static svo_hit hits[BATCH];
    uint64_t sum = 0;
    double start = seconds(CLOCK_THREAD_CPUTIME_ID);
    for (uint64_t i = first; i < first + count; i += BATCH) {
        uint32_t n = first + count - i < BATCH ? (uint32_t)(first + count - i) : BATCH;
        svo_raycast(v, r->ray + i, n, hits);
        for (uint32_t k = 0; k < n; k++) sum += hits[k].hit ? 1 + hits[k].attribute + 5 * (uint64_t)hits[k].cell[0] : 0;
    }
    *check += sum;
    return seconds(CLOCK_THREAD_CPUTIME_ID) - start;
}

/* --- measuring ---------------------------------------------------------------------------------------------------- */

typedef struct questions { cells hit, near; rays set[RAY_SETS]; } questions;

static uint64_t questions_count(const questions *q, int kind) { return kind < 3 ? q->hit.count : q->set[kind - 3].count; }

static double ask(const svo_view *v, const questions *q, int kind, uint64_t first, uint64_t count, uint64_t *check)
{
    if (kind < 3) return query(v, kind == 2 ? &q->near : &q->hit, first, count, kind == 0, check);
    return cast(v, &q->set[kind - 3], first, count, check);
}

/* Seconds a question of layout 1, and of each layout as a multiple of that. */
static void measure_kind(const char *path, svo_packed *packed[LAYOUTS][2], const questions *q, int kind, int rounds, double *plain, double ratio[LAYOUTS])
{
    static double took[LAYOUTS][MOST_ROUNDS];
    uint64_t all = questions_count(q, kind), slices = kind < 3 ? all / 20000 : all / 16384, check[LAYOUTS] = {0};
    if (slices < 2) slices = 2;
    uint64_t slice = all / slices;
    for (int r = 0; r < rounds; r++)
        for (int k = 0; k < LAYOUTS; k++) {
            int l = (k + r) % LAYOUTS;
            const svo_view *v = svo_packed_view(packed[l][1]);
            ask(v, q, kind, (uint64_t)r % slices * slice, slice, &check[l]);
            took[l][r] = ask(v, q, kind, (uint64_t)(r + 1) % slices * slice, slice, &check[l]) / (double)slice;
        }
    for (int l = 1; l < LAYOUTS; l++)
        if (check[l] != check[0]) fprintf(stderr, "%s: %s gives other answers (%d)\n", path, layout_names[l], kind), exit(1);
    for (int l = LAYOUTS; l-- > 0;) {
        for (int r = 0; r < rounds; r++) took[l][r] /= l == 0 ? 1 : took[0][r];
        ratio[l] = l == 0 ? 1 : bench_median(took[l], rounds);
    }
    *plain = bench_median(took[0], rounds);
}

static void make_questions(const svo_view *v, uint64_t queries, questions *q)
{
    q->hit = (cells){.cell = get(queries, sizeof *q->hit.cell), .capacity = queries, .step = v->nodes[v->depth] / queries + 1};
    svo_view_voxels(v, pick, &q->hit);
    uint64_t seed = 2;
    for (uint64_t i = q->hit.count; i > 1; i--) { /* in random order */
        uint64_t j = random_number(&seed) % i;
        uint32_t keep[3];
        memcpy(keep, q->hit.cell[i - 1], sizeof keep);
        memcpy(q->hit.cell[i - 1], q->hit.cell[j], sizeof keep);
        memcpy(q->hit.cell[j], keep, sizeof keep);
    }
    q->near = (cells){.cell = get(q->hit.count, sizeof *q->near.cell), .count = q->hit.count};
    for (uint64_t i = 0; i < q->hit.count; i++)
        for (int k = 0; k < 3; k++) {
            uint32_t side = (uint32_t)1 << v->depth, x = q->hit.cell[i][k] + (uint32_t)(random_number(&seed) % 17) - 8;
            q->near.cell[i][k] = x < side ? x : q->hit.cell[i][k];
        }
    make_rays(v, q->set);
}

static void measure(const char *path, const svo_view *v, int rounds, uint64_t queries, bool csv, bool rates)
{
    svo_packed *packed[LAYOUTS][2] = {{NULL}};
    double cpu[LAYOUTS][2], plain[KINDS], ratio[KINDS][LAYOUTS];
    uint64_t bytes[LAYOUTS][2] = {{0}}, svo_nodes = 0;
    for (int l = 0; l < LAYOUTS; l++)
        for (int n = rates ? 1 : 0; n < 2; n++) {
            packed[l][n] = build(v, layout_ids[l], n != 0, &cpu[l][n]);
            svo_view_section parts[SVO_VIEW_SECTIONS];
            uint32_t count = svo_view_sections(svo_packed_view(packed[l][n]), parts);
            for (uint32_t i = 0; i < count; i++) bytes[l][n] += parts[i].bytes;
        }
    double voxels = (double)v->nodes[v->depth];
    for (uint32_t i = 0; i <= v->depth; i++) svo_nodes += v->nodes[i];
    questions q;
    make_questions(v, queries, &q);
    for (int k = 0; k < KINDS; k++) measure_kind(path, packed, &q, k, rounds, &plain[k], ratio[k]);
    const char *name = strrchr(path, '/');
    name = name ? name + 1 : path;
    for (int l = 0; l < LAYOUTS && csv; l++) {
        printf("%s,%u,%.0f,%llu,%s,%.4f,%.4f,%.4f,%.3f", name, v->depth, voxels, (unsigned long long)svo_nodes, layout_names[l],
               8.0 * (double)bytes[l][0] / voxels, 8.0 * (double)bytes[l][1] / voxels, 8.0 * (double)bytes[l][1] / (double)svo_nodes, cpu[l][1]);
        for (int k = 0; k < 3; k++) printf(",%.1f", 1e9 * plain[k] * ratio[k][l]);
        for (int k = 3; k < KINDS; k++) printf(",%.3f", 1e-6 / (plain[k] * ratio[k][l]));
        for (int k = 0; k < KINDS; k++) printf(",%.3f", ratio[k][l]);
        putchar('\n');
    }
    if (csv) goto done;
    printf("%s: depth %u, %.0f voxels, %llu nodes\n", name, v->depth, voxels, (unsigned long long)svo_nodes);
    printf("  %-9s %9s %9s %9s %9s %8s | %7s %7s %7s %9s %8s | ratios to svdag: size, times\n", "layout", "b/voxel", "numbered", "b/node", "bytes", "build s",
           "hit", "is", "near", "primary", "random");
    for (int l = 0; l < LAYOUTS; l++) {
        printf("  %-9s %9.4f %9.4f %9.4f %9llu %8.3f |", layout_names[l], 8.0 * (double)bytes[l][0] / voxels, 8.0 * (double)bytes[l][1] / voxels,
               8.0 * (double)bytes[l][1] / (double)svo_nodes, (unsigned long long)bytes[l][1], cpu[l][1]);
        for (int k = 0; k < 3; k++) printf(" %7.1f", 1e9 * plain[k] * ratio[k][l]);
        printf(" %9.2f %8.2f | %.3f", 1e-6 / (plain[3] * ratio[3][l]), 1e-6 / (plain[4] * ratio[4][l]), (double)bytes[l][1] / (double)bytes[0][1]);
        for (int k = 0; k < KINDS; k++) printf(" %.2f", ratio[k][l]);
        putchar('\n');
    }
done:
    for (int l = 0; l < LAYOUTS; l++)
        for (int n = 0; n < 2; n++) svo_packed_free(packed[l][n]);
    for (int s = 0; s < RAY_SETS; s++) free(q.set[s].ray);
    free(q.hit.cell);
    free(q.near.cell);
}

int main(int argc, char **argv)
{
    int rounds = 41;
    uint64_t queries = 400000;
    bool any = false, csv = false, rates = false;
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "-c") == 0) {
            csv = true;
            puts("model,depth,voxels,nodes,layout,bits_per_voxel,bits_per_voxel_numbered,bits_per_node_numbered,build_cpu_s,lookup_numbered_ns,lookup_ns,near_ns,primary_mrays,random_mrays,"
                 "lookup_numbered_ratio,lookup_ratio,near_ratio,primary_ratio,random_ratio");
        } else if (strcmp(argv[i], "-s") == 0) rates = true;
        else if (strcmp(argv[i], "-n") == 0 && i + 1 < argc) rounds = atoi(argv[++i]);
        else if (strcmp(argv[i], "-q") == 0 && i + 1 < argc) queries = strtoull(argv[++i], NULL, 10);
        else {
            fmt_bytes bytes;
            fmt_svdag dag;
            svo_error err;
            must(fmt_bytes_open(argv[i], 0, NULL, &bytes, &err), &err);
            must(fmt_svdag_open(bytes.data, bytes.size, NULL, &dag, &err), &err);
            if (dag.view.empty || queries == 0 || rounds < 1 || rounds > MOST_ROUNDS) return fputs("nothing to measure\n", stderr), 1;
            measure(argv[i], &dag.view, rounds, queries, csv, rates);
            fmt_svdag_close(&dag);
            fmt_bytes_close(&bytes);
            any = true;
        }
    }
    return any ? 0 : (fputs("usage: bench_geometry [-c] [-s] [-n ROUNDS] [-q QUERIES] A.svdag [B.svdag ...]\n", stderr), 1);
}
