/* What the two kinds of surface promise: no path of the matching connectivity passes through a closed surface.
 *
 * The winding number of a closed mesh at voxel centres, exact on the snapped triangles, only changes where the surface is crossed. So
 * the promise is: two neighbours that are both empty have the same winding number; neighbours over faces, edges and corners
 * for the conservative set, over faces for the thin one. Every pair is tested, not only those that some path takes. */
#include <math.h>

#include "fmt_import.h"
#include "voxel_set.h"

typedef struct solid {
    double *positions; /* 9 a triangle */
    uint64_t count, capacity;
} solid;

static void add(solid *s, const double a[3], const double b[3], const double c[3])
{
    if (s->count == s->capacity) {
        s->capacity = 2 * s->capacity + 64;
        s->positions = realloc(s->positions, s->capacity * 72);
    }
    double *p = s->positions + 9 * s->count++;
    memcpy(p, a, 24);
    memcpy(p + 3, b, 24);
    memcpy(p + 6, c, 24);
}

static void tetrahedron(solid *s, double p[4][3])
{
    static const int face[4][3] = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};
    for (int i = 0; i < 4; i++) add(s, p[face[i][0]], p[face[i][1]], p[face[i][2]]);
}

/* A torus whose surface is pushed in and out at random, so that it crosses itself. */
static void rough_torus(solid *s, uint64_t *seed, uint32_t n, double roughness)
{
    double(*p)[3] = malloc(n * n * sizeof *p);
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t k = 0; k < n; k++) {
            double a = 2 * M_PI * i / n, b = 2 * M_PI * k / n, r = 0.4 * (1 + roughness * (test_random_unit(seed) - 0.5));
            p[i * n + k][0] = (1 + r * cos(b)) * cos(a);
            p[i * n + k][1] = (1 + r * cos(b)) * sin(a);
            p[i * n + k][2] = r * sin(b);
        }
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t k = 0; k < n; k++) {
            const double *a = p[i * n + k], *b = p[(i + 1) % n * n + k], *c = p[(i + 1) % n * n + (k + 1) % n], *d = p[i * n + (k + 1) % n];
            add(s, a, b, c);
            add(s, a, c, d);
        }
    free(p);
}

static int32_t snap(double v, double low, double size, uint32_t depth)
{
    double q = 2 * floor((v - low) / size * 128) + 1, most = ldexp(1, (int)depth + 8) - 1;
    return (int32_t)(q < 1 ? 1 : q > most ? most : q);
}

/* A directed edge between lattice points, as the undirected one and its sense. */
typedef struct edge { uint64_t a, b; int sense; } edge;
static int by_edge(const void *x, const void *y)
{
    const edge *e = x, *f = y;
    if (e->a != f->a) return e->a < f->a ? -1 : 1;
    return e->b < f->b ? -1 : e->b > f->b;
}

/* Each edge runs as often one way as the other: the mesh is a cycle, and winding numbers are whole. */
static bool closed(const int32_t (*q)[3][3], uint64_t count)
{
    edge *list = malloc((3 * count + 1) * sizeof *list);
    for (uint64_t t = 0; t < count; t++)
        for (int k = 0; k < 3; k++) {
            const int32_t *p = q[t][k], *r = q[t][(k + 1) % 3];
            uint64_t a = (uint64_t)p[0] | (uint64_t)p[1] << 21 | (uint64_t)p[2] << 42, b = (uint64_t)r[0] | (uint64_t)r[1] << 21 | (uint64_t)r[2] << 42;
            list[3 * t + (uint64_t)k] = a < b ? (edge){a, b, 1} : a > b ? (edge){b, a, -1} : (edge){a, a, 0};
        }
    qsort(list, 3 * count, sizeof *list, by_edge);
    bool good = true;
    for (uint64_t i = 0; i < 3 * count && good;) {
        int sum = 0;
        uint64_t k = i;
        for (; k < 3 * count && by_edge(&list[i], &list[k]) == 0; k++) sum += list[k].sense;
        good = sum == 0;
        i = k;
    }
    free(list);
    return good;
}

/* winding[x + n (y + n z)] of every voxel centre that is not on the surface. Lines along x at even y and z: they meet no vertex, and where they
 * meet an edge, one moved by (e, e^2) decides for both triangles of the edge alike. */
static void wind(const int32_t (*q)[3][3], uint64_t count, int32_t n, int16_t *winding)
{
    memset(winding, 0, (size_t)n * (size_t)n * (size_t)n * sizeof *winding);
    for (uint64_t t = 0; t < count; t++) {
        int64_t u[3], v[3], nx, d;
        for (int k = 0; k < 3; k++) u[k] = (int64_t)q[t][1][k] - q[t][0][k], v[k] = (int64_t)q[t][2][k] - q[t][0][k];
        nx = u[1] * v[2] - u[2] * v[1];
        if (nx == 0) continue;
        int64_t ny = u[2] * v[0] - u[0] * v[2], nz = u[0] * v[1] - u[1] * v[0];
        d = nx * q[t][0][0] + ny * q[t][0][1] + nz * q[t][0][2];
        int64_t sign = nx > 0 ? 1 : -1;
        int32_t lo[2], hi[2];
        for (int k = 0; k < 2; k++) {
            int32_t a = q[t][0][k + 1], b = q[t][1][k + 1], c = q[t][2][k + 1];
            int32_t least = a < b ? (a < c ? a : c) : b < c ? b : c, most = a > b ? (a > c ? a : c) : b > c ? b : c;
            lo[k] = (least - 128) >> 8, hi[k] = (most - 128) >> 8;
            if (lo[k] < 0) lo[k] = 0;
            if (hi[k] >= n) hi[k] = n - 1;
        }
        for (int32_t z = lo[1]; z <= hi[1]; z++)
            for (int32_t y = lo[0]; y <= hi[0]; y++) {
                int64_t cy = 256 * (int64_t)y + 128, cz = 256 * (int64_t)z + 128;
                bool inside = true;
                for (int k = 0; k < 3 && inside; k++) {
                    const int32_t *a = q[t][k], *b = q[t][(k + 1) % 3];
                    int64_t dy = (int64_t)b[1] - a[1], dz = (int64_t)b[2] - a[2];
                    int64_t side = sign * (dy * (cz - a[2]) - dz * (cy - a[1])); /* grows by -dz e + dy e^2 */
                    if (side == 0) side = sign * (dz != 0 ? -dz : dy);
                    inside = side > 0;
                }
                if (!inside) continue;
                int64_t top = sign * (d - ny * cy - nz * cz), den = sign * nx; /* x = top / den */
                int64_t last = (top - 128 * den) / (256 * den);
                while (last * 256 * den + 128 * den >= top) last--;
                while ((last + 1) * 256 * den + 128 * den < top) last++;
                if (last >= n) last = n - 1;
                for (int64_t x = 0; x <= last; x++) winding[x + n * (y + (int64_t)n * z)] += (int16_t)sign;
            }
    }
}

/* *pairs and *inside tell that the test says something. */
static void check_tight(const solid *s, uint32_t depth, svo_surface surface, const char *what, uint64_t *inside)
{
    loose_mesh m;
    loose_make(&m, s->positions, s->count);
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = depth;
    o.surface = surface;
    o.channels = 0;
    o.threads = 2;
    voxel_set set;
    svo_error err;
    CHECK_OK(voxel_run(&m.mesh, &o, true, &set, &err));
    int32_t(*q)[3][3] = malloc((s->count + 1) * sizeof *q);
    for (uint64_t t = 0; t < s->count; t++)
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < 3; k++)
                q[t][c][k] = snap(s->positions[9 * t + 3 * (uint64_t)c + (uint64_t)k], set.info.voxel_to_world[4 * k + 3], set.info.voxel_to_world[0], depth);
    const int32_t n = 1 << depth;
    size_t cells = (size_t)n * (size_t)n * (size_t)n;
    int16_t *winding = malloc(cells * sizeof *winding);
    uint8_t *marked = calloc(cells, 1);
    bool whole = closed((const int32_t(*)[3][3])q, s->count);
    wind((const int32_t(*)[3][3])q, s->count, n, winding);
    for (uint64_t i = 0; i < set.count; i++) {
        uint32_t x, y, z;
        svo_morton_decode(set.codes[i], &x, &y, &z);
        marked[x + (uint32_t)n * (y + (size_t)n * z)] = 1;
    }
    int32_t leak[3] = {-1, -1, -1};
    for (int32_t z = 0; z < n; z++)
        for (int32_t y = 0; y < n; y++)
            for (int32_t x = 0; x < n; x++) {
                int64_t at = x + (int64_t)n * (y + (int64_t)n * z);
                if (marked[at]) continue;
                *inside += winding[at] != 0;
                bool edge_of_grid = x == 0 || y == 0 || z == 0 || x == n - 1 || y == n - 1 || z == n - 1;
                bool good = !edge_of_grid || winding[at] == 0; /* beyond the grid is outside */
                for (int k = 0; k < 13 && good; k++) {           /* half of the neighbours: pairs have two ends */
                    int dx = (k + 14) % 3 - 1, dy = (k + 14) / 3 % 3 - 1, dz = (k + 14) / 9 - 1;
                    if (surface == SVO_SURFACE_THIN && abs(dx) + abs(dy) + abs(dz) != 1) continue;
                    int32_t a = x + dx, b = y + dy, c = z + dz;
                    if (a < 0 || b < 0 || c < 0 || a >= n || b >= n || c >= n) continue;
                    int64_t to = a + (int64_t)n * (b + (int64_t)n * c);
                    good = marked[to] || winding[to] == winding[at];
                }
                if (!good && leak[0] < 0) leak[0] = x, leak[1] = y, leak[2] = z;
            }
    free(q);
    free(winding);
    free(marked);
    voxel_free(&set);
    loose_free(&m);
    CHECK_MSG(whole, "%s is not closed", what);
    CHECK_MSG(leak[0] < 0, "%s, depth %u, surface %d: a path leaks at %d %d %d", what, depth, (int)surface, leak[0], leak[1], leak[2]);
}

static void both(const solid *s, uint32_t depth, const char *what, uint64_t *inside)
{
    check_tight(s, depth, SVO_SURFACE_CONSERVATIVE, what, inside);
    if (!test_failed()) check_tight(s, depth, SVO_SURFACE_THIN, what, inside);
}

TEST(random_tetrahedra)
{
    uint64_t seed = 4, inside = 0;
    for (uint32_t round = 0; round < 240 && !test_failed(); round++) {
        solid s = {0};
        for (uint64_t k = 1 + test_random(&seed) % 12; k > 0; k--) {
            double p[4][3], size = k % 3 == 0 ? 0.2 : 1;
            for (int i = 0; i < 12; i++) p[i / 3][i % 3] = size * test_random_unit(&seed);
            if (round % 4 == 1) /* flat ones: far thinner than a voxel */
                for (int i = 0; i < 3; i++) p[3][i] = (p[0][i] + p[1][i] + p[2][i]) / 3 + 1e-3 * test_random_unit(&seed);
            if (round % 4 == 2) /* corners on grid planes */
                for (int i = 0; i < 12; i++) p[i / 3][i % 3] = (double)(test_random(&seed) % 9);
            tetrahedron(&s, p);
        }
        both(&s, 2 + round % 4, "tetrahedra", &inside);
        free(s.positions);
    }
    CHECK(test_failed() || inside > 10000);
}

TEST(rough_tori)
{
    uint64_t seed = 8, inside = 0;
    for (uint32_t round = 0; round < 24 && !test_failed(); round++) {
        solid s = {0};
        rough_torus(&s, &seed, 5 + 9 * (round % 6), round % 2 ? 0.2 : 2.5);
        both(&s, 3 + round % 4, "a torus", &inside);
        free(s.positions);
    }
    CHECK(test_failed() || inside > 10000);
}

TEST(real_models)
{
    const char *const models[] = {"A_organic/bunny_closed/bunny_hr.obj", "A_organic/hand_closed/hand_closed.obj", "A_organic/camel/camel.off", "A_organic/fertility/fertility.off"};
    for (size_t k = 0; k < sizeof models / sizeof *models && !test_failed(); k++) {
        const char *path = test_models() != NULL ? test_model(models[k]) : NULL;
        if (path == NULL) {
            test_skip("%s is not there (SVOKIT_MODELS)", models[k]);
            return;
        }
        svo_mesh mesh;
        svo_error err;
        uint64_t inside = 0;
        fmt_import_options o = {.skip_images = true};
        CHECK_OK(fmt_import_mesh(path, &o, &mesh, &err));
        solid s = {0};
        for (uint32_t p = 0; p < mesh.shapes[0].part_count; p++) {
            const svo_part *part = &mesh.shapes[0].parts[p];
            for (uint64_t t = 0; t < part->triangle_count; t++) {
                const uint32_t *i = part->indices + 3 * t;
                add(&s, part->positions + 3 * (size_t)i[0], part->positions + 3 * (size_t)i[1], part->positions + 3 * (size_t)i[2]);
            }
        }
        svo_mesh_free(&mesh);
        for (uint32_t depth = 5; depth <= 7 && !test_failed(); depth++) both(&s, depth, models[k], &inside);
        free(s.positions);
        CHECK(test_failed() || inside > 10000);
    }
}
