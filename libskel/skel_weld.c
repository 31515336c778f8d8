/* Welding: greedy grouping of points within a radius, and the replacement of live vertices by such groups while contracting. */
#include "skeli_internal.h"

#include <math.h>
#include <string.h>

/* --- greedy grouping ---------------------------------------------------------------------------------------------- */

/* Seeds by cell of a grid twice as wide as the radius: a hash from cell to a list of seeds. */
typedef struct seeds {
    uint64_t *key; /* cell, UINT64_MAX = empty */
    uint32_t *head;
    uint32_t *next;   /* of each seed */
    uint32_t *point;  /* which point each seed is */
    const double *position;
    uint64_t mask;
} seeds;

static uint64_t cell_key(const int64_t c[3]) /* cells fit 21 bits: radius >= 2^-18 units, coordinates in (-1, 1) */
{
    return (uint64_t)(c[0] + (1 << 20)) | (uint64_t)(c[1] + (1 << 20)) << 21 | (uint64_t)(c[2] + (1 << 20)) << 42;
}

static uint64_t cell_slot(const seeds *s, uint64_t key)
{
    uint64_t h = key * 0x9e3779b97f4a7c15ull;
    h ^= h >> 31;
    uint64_t i = h & s->mask;
    while (s->key[i] != UINT64_MAX && s->key[i] != key) i = (i + 1) & s->mask;
    return i;
}

/* What is within the radius lies in the cell or, on each axis, in that of the neighbours to which p is nearer (side, 1 or -1). */
static uint32_t nearest_seed(const seeds *s, const double *p, const int64_t cell[3], const int64_t side[3], double radius)
{
    uint32_t best = SVO_NONE;
    double best2 = radius * radius;
    for (int k = 0; k < 8; k++) {
        const int64_t c[3] = {cell[0] + (k & 1 ? side[0] : 0), cell[1] + (k & 2 ? side[1] : 0), cell[2] + (k & 4 ? side[2] : 0)};
        const uint64_t slot = cell_slot(s, cell_key(c));
        if (s->key[slot] == UINT64_MAX) continue;
        for (uint32_t i = s->head[slot]; i != SVO_NONE; i = s->next[i]) {
            const double *q = s->position + 3 * (uint64_t)s->point[i];
            double dx = q[0] - p[0], dy = q[1] - p[1], dz = q[2] - p[2], d = dx * dx + dy * dy + dz * dz;
            if (d < best2 || (d == best2 && i < best && best != SVO_NONE)) {
                best2 = d;
                best = i;
            }
        }
    }
    return best;
}

svo_result skeli_weld(const svo_allocator *a, const double *position, uint32_t count, const uint32_t *order, double radius,
                      uint32_t *label, uint32_t *seed_count, svo_error *err)
{
    *seed_count = 0;
    if (count == 0) return SVO_OK;
    if (radius < 128) radius = 128; /* lattice steps; see cell_key */
    uint64_t capacity = 64;
    while (capacity < 2 * (uint64_t)count) capacity *= 2;
    seeds s = {.mask = capacity - 1, .position = position};
    s.key = svo_alloc(a, capacity, sizeof *s.key);
    s.head = svo_alloc(a, capacity, sizeof *s.head);
    s.next = svo_alloc(a, count, sizeof *s.next);
    s.point = svo_alloc(a, count, sizeof *s.point);
    svo_result result = SVO_OK;
    if (s.key == NULL || s.head == NULL || s.next == NULL || s.point == NULL) {
        result = skeli_no_memory(err);
    } else {
        memset(s.key, 0xff, capacity * sizeof *s.key);
        uint32_t n = 0;
        for (uint32_t k = 0; k < count; k++) {
            uint32_t i = order == NULL ? k : order[k];
            const double *p = position + 3 * (uint64_t)i;
            int64_t cell[3], side[3];
            for (int axis = 0; axis < 3; axis++) {
                const double at = p[axis] / (2 * radius), low = floor(at);
                cell[axis] = (int64_t)low;
                side[axis] = at - low < 0.5 ? -1 : 1;
            }
            uint32_t seed = nearest_seed(&s, p, cell, side, radius);
            if (seed == SVO_NONE) {
                seed = n++;
                s.point[seed] = i;
                uint64_t slot = cell_slot(&s, cell_key(cell));
                s.next[seed] = s.key[slot] == UINT64_MAX ? SVO_NONE : s.head[slot];
                s.key[slot] = cell_key(cell);
                s.head[slot] = seed;
            }
            label[i] = seed;
        }
        *seed_count = n;
    }
    svo_free(a, s.key, capacity, sizeof *s.key);
    svo_free(a, s.head, capacity, sizeof *s.head);
    svo_free(a, s.next, count, sizeof *s.next);
    svo_free(a, s.point, count, sizeof *s.point);
    return result;
}

/* --- connected clusters ------------------------------------------------------------------------------------------- */

/* Grow each cluster from its seed, the first vertex that has none yet, along edges: what lies nearer than `radius` to the seed and is
 * reached through members joins. Sheets that are near each other but not connected stay apart, which greedy grouping would not promise. */
uint32_t skeli_cluster(skeli_state *s, double radius, const uint8_t *doublings)
{
    uint32_t clusters = 0, *queue = s->bucket; /* count + 2 elements */
    memset(s->label, 0xff, (size_t)s->count * sizeof *s->label);
    for (uint32_t first = 0; first < s->count; first++) {
        if (s->label[first] != SVO_NONE) continue;
        const double *seed = s->position + 3 * (uint64_t)first;
        const double wide = doublings == NULL ? radius : doublings[first] == 0 ? 0 : radius * (double)(1u << doublings[first]), reach = wide * wide;
        uint64_t head = 0, tail = 0;
        s->label[first] = clusters;
        queue[tail++] = first;
        while (head < tail) {
            uint32_t v = queue[head++];
            for (uint64_t e = s->edge_start[v]; e < s->edge_start[v + 1]; e++) {
                uint32_t u = s->edge[2 * e + 1];
                if (s->label[u] != SVO_NONE || (doublings != NULL && doublings[u] < doublings[first])) continue;
                const double *p = s->position + 3 * (uint64_t)u;
                double x = p[0] - seed[0], y = p[1] - seed[1], z = p[2] - seed[2];
                if (x * x + y * y + z * z >= reach) continue;
                s->label[u] = clusters;
                queue[tail++] = u;
            }
        }
        clusters++;
    }
    return clusters;
}

/* --- replacing live vertices -------------------------------------------------------------------------------------- */

static void sort3(uint32_t *t)
{
    uint32_t x;
    if (t[0] > t[1]) { x = t[0]; t[0] = t[1]; t[1] = x; }
    if (t[1] > t[2]) { x = t[1]; t[1] = t[2]; t[2] = x; }
    if (t[0] > t[1]) { x = t[0]; t[0] = t[1]; t[1] = x; }
}

void skeli_index(skeli_state *s)
{
    memset(s->edge_start, 0, ((size_t)s->count + 1) * sizeof *s->edge_start);
    for (uint64_t e = 0; e < s->edge_count; e++) s->edge_start[s->edge[2 * e] + 1]++;
    memset(s->incident_start, 0, ((size_t)s->count + 1) * sizeof *s->incident_start);
    for (uint64_t i = 0; i < 3 * (uint64_t)s->triangle_count; i++) s->incident_start[s->corner[i] + 1]++;
    for (uint32_t i = 0; i < s->count; i++) {
        s->edge_start[i + 1] += s->edge_start[i];
        s->incident_start[i + 1] += s->incident_start[i];
    }
    memcpy(s->bucket, s->incident_start, (size_t)s->count * sizeof *s->bucket);
    for (uint32_t t = 0; t < s->triangle_count; t++)
        for (int k = 0; k < 3; k++) s->incident[s->bucket[s->corner[3 * (uint64_t)t + (uint64_t)k]]++] = t;
}

/* Sums over each group into s->gather: weight, 3 position, 3 step, then beta; rho and reversals into mean. */
static void gather_groups(skeli_state *s, uint32_t groups)
{
    memset(s->gather, 0, (size_t)groups * 8 * sizeof *s->gather);
    memset(s->mean, 0, (size_t)groups * 3 * sizeof *s->mean);
    for (uint32_t i = 0; i < s->count; i++) {
        double w = s->weight[i], *g = s->gather + 8 * (uint64_t)s->label[i], *m = s->mean + 3 * (uint64_t)s->label[i];
        g[0] += w;
        for (int k = 0; k < 3; k++) {
            g[1 + k] += w * s->position[3 * (uint64_t)i + (uint64_t)k];
            g[4 + k] += w * s->step[3 * (uint64_t)i + (uint64_t)k];
        }
        g[7] += w * s->beta[i];
        m[0] += w * s->rho[i];
        if (s->reversals[i] > m[1]) m[1] = s->reversals[i];
    }
}

/* n edges from lower to higher vertices, sorted, become those of both directions, sorted: to the lower neighbours of each vertex first. */
static void both_ways(skeli_state *s, uint64_t n, uint32_t count)
{
    uint32_t *at = s->bucket;
    memcpy(s->scratch, s->edge, 2 * n * sizeof *s->edge);
    memset(at, 0, ((size_t)count + 1) * sizeof *at);
    for (uint64_t k = 0; k < 2 * n; k++) at[s->scratch[k] + 1]++;
    for (uint32_t i = 0; i < count; i++) at[i + 1] += at[i];
    for (int higher = 0; higher < 2; higher++)
        for (uint64_t e = 0; e < n; e++) {
            const uint32_t from = s->scratch[2 * e + (higher ? 0 : 1)], to = s->scratch[2 * e + (higher ? 1 : 0)], k = at[from]++;
            s->edge[2 * (uint64_t)k] = from;
            s->edge[2 * (uint64_t)k + 1] = to;
        }
    s->edge_count = 2 * n;
}

void skeli_collapse(skeli_state *s, uint32_t groups)
{
    gather_groups(s, groups);
    uint64_t n = 0;
    for (uint64_t t = 0; t < s->triangle_count; t++) {
        uint32_t c[3];
        for (int k = 0; k < 3; k++) c[k] = s->label[s->corner[3 * t + (uint64_t)k]];
        if (c[0] == c[1] || c[1] == c[2] || c[2] == c[0]) continue;
        sort3(c);
        memcpy(s->corner + 3 * n++, c, sizeof c);
    }
    s->triangle_count = (uint32_t)skeli_sort_unique(s->corner, n, 3, groups, s->scratch, s->bucket);
    n = 0;
    for (uint64_t e = 0; e < s->edge_count; e++) {
        if (s->edge[2 * e] > s->edge[2 * e + 1]) continue; /* of the two directions one will do */
        uint32_t a = s->label[s->edge[2 * e]], b = s->label[s->edge[2 * e + 1]];
        if (a == b) continue;
        s->edge[2 * n] = a < b ? a : b;
        s->edge[2 * n++ + 1] = a < b ? b : a;
    }
    n = skeli_sort_unique(s->edge, n, 2, groups, s->scratch, s->bucket);
    both_ways(s, n, groups);
    for (uint32_t i = 0; i < s->original_count; i++) s->live[i] = s->label[s->live[i]];
    s->count = groups;
    for (uint32_t g = 0; g < groups; g++) {
        const double *sum = s->gather + 8 * (uint64_t)g;
        s->weight[g] = (uint32_t)sum[0];
        for (int k = 0; k < 3; k++) {
            s->position[3 * (uint64_t)g + (uint64_t)k] = rint(sum[1 + k] / sum[0]);
            s->step[3 * (uint64_t)g + (uint64_t)k] = sum[4 + k] / sum[0];
        }
        s->reversals[g] = (uint32_t)s->mean[3 * (uint64_t)g + 1];
    }
    skeli_index(s);
    /* A group goes on with the contraction it had: its reference area is such that its beta is the mean beta of its members, but
     * not less than a tenth of their mean reference, so that a group that came out small does not start to smooth again. */
    for (uint32_t g = 0; g < groups; g++) {
        double w = s->gather[8 * (uint64_t)g], beta = s->gather[8 * (uint64_t)g + 7] / w, rho = s->mean[3 * (uint64_t)g] / w, ring = 0;
        for (uint32_t k = s->incident_start[g]; k < s->incident_start[g + 1]; k++) {
            const uint32_t *c = s->corner + 3 * (uint64_t)s->incident[k];
            ring += skeli_area(s->position + 3 * (uint64_t)c[0], s->position + 3 * (uint64_t)c[1], s->position + 3 * (uint64_t)c[2]);
        }
        double reference = beta > 1e-9 ? ring / beta : rho;
        s->rho[g] = reference < 0.1 * rho ? 0.1 * rho : reference;
        s->beta[g] = beta;
    }
}
