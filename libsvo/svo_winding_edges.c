/* Which parts of a snapped mesh are closed: edges counted in a hash table, faces turned so that neighbours agree. */
#include <math.h>
#include <string.h>

#include "svo_task.h"
#include "svoi_winding.h"

static uint64_t mix(uint64_t h)
{
    h ^= h >> 32;
    h *= 0xd6e8feb86659fd93u;
    h ^= h >> 32;
    h *= 0xd6e8feb86659fd93u;
    return h ^ h >> 32;
}

static int compare_points(const int32_t a[3], const int32_t b[3])
{
    for (int k = 0; k < 3; k++)
        if (a[k] != b[k]) return a[k] < b[k] ? -1 : 1;
    return 0;
}

/* A number for the undirected edge, never 0; lower end first. */
static uint64_t edge_key(const int32_t *low, const int32_t *high, uint64_t salt)
{
    uint64_t h = salt;
    h = mix(h ^ ((uint64_t)(uint32_t)low[0] << 32 | (uint32_t)low[1]));
    h = mix(h ^ ((uint64_t)(uint32_t)low[2] << 32 | (uint32_t)high[0]));
    h = mix(h ^ ((uint64_t)(uint32_t)high[1] << 32 | (uint32_t)high[2]));
    return h | 1;
}

void svoi_edge_sum(const int32_t q[3][3], uint64_t sum[2])
{
    for (int e = 0; e < 3; e++) {
        const int32_t *a = q[e], *b = q[e == 2 ? 0 : e + 1];
        int order = compare_points(a, b);
        if (order == 0) continue;
        uint64_t key = edge_key(order < 0 ? a : b, order < 0 ? b : a, 1), other = mix(key ^ 0x9e3779b97f4a7c15u);
        sum[0] += order < 0 ? key : 0 - key;
        sum[1] += order < 0 ? other : 0 - other;
    }
}

/* --- the table ---------------------------------------------------------------------------------------------------- */

typedef struct edge {
    uint64_t key;   /* 0: empty */
    uint32_t first; /* triangle that used it first */
    uint16_t uses;  /* counts on to 65535, then between 65534 and 65535: parity stays */
    int16_t net;    /* uses from the lower end to the higher less those back, after turning; stays at the limits */
} edge;

typedef struct classify {
    const svoi_edges_input *in;
    edge *edges;
    uint64_t capacity, used;
    uint32_t *parent; /* of the union of triangles */
    uint8_t *bits;    /* a triangle's TURN relative to its parent; of roots also the others */
} classify;

/* Of `bits`. Those after the first belong to whole parts and are kept at their roots. */
enum { TURN = 1, CONFLICT = 2, ODD = 4, UNBALANCED = 8, WHOLE = 16 };

typedef struct corners { int32_t q[3][3]; } corners;

/* False for triangles with two equal corners: they have no area, and their edges cancel. */
static bool load(const classify *c, uint64_t t, corners *out)
{
    if ((c->in->kind[t] & 3) == SVOI_SKIPPED) return false;
    svo_record r;
    svo_bins_record(c->in->bins, (uint32_t)t, &r);
    memcpy(out->q, r.q, sizeof out->q);
    return compare_points(r.q[0], r.q[1]) != 0 && compare_points(r.q[1], r.q[2]) != 0 && compare_points(r.q[2], r.q[0]) != 0;
}

/* Edge e of a triangle: its key, and whether it goes from the lower end to the higher. */
static uint64_t key_of(const corners *t, int e, bool *up)
{
    const int32_t *a = t->q[e], *b = t->q[e == 2 ? 0 : e + 1];
    *up = compare_points(a, b) < 0;
    return edge_key(*up ? a : b, *up ? b : a, 2);
}

static edge *find(const classify *c, uint64_t key)
{
    uint64_t i = key >> 1 & (c->capacity - 1);
    while (c->edges[i].key != 0 && c->edges[i].key != key) i = (i + 1) & (c->capacity - 1);
    return &c->edges[i];
}

static bool count_edges(classify *c)
{
    for (uint64_t t = 0; t < c->in->count; t++) {
        corners tri;
        if (!load(c, t, &tri)) continue;
        for (int e = 0; e < 3; e++) {
            bool up;
            uint64_t key = key_of(&tri, e, &up);
            if ((c->used + 1) * 4 > c->capacity * 3) {
                classify old = *c;
                c->capacity = old.capacity == 0 ? 1024 : old.capacity * 2;
                c->edges = svo_calloc(c->in->allocator, c->capacity, sizeof *c->edges);
                if (c->edges == NULL) {
                    *c = old;
                    return false;
                }
                for (uint64_t i = 0; i < old.capacity; i++)
                    if (old.edges[i].key != 0) *find(c, old.edges[i].key) = old.edges[i];
                svo_free(c->in->allocator, old.edges, old.capacity, sizeof *old.edges);
            }
            edge *at = find(c, key);
            if (at->key == 0) {
                *at = (edge){.key = key, .first = (uint32_t)t};
                c->used++;
            }
            at->uses = at->uses == UINT16_MAX ? UINT16_MAX - 1 : (uint16_t)(at->uses + 1);
        }
    }
    return true;
}

/* --- parts: triangles joined across edges of two faces ------------------------------------------------------------ */

/* Root of a triangle; *turn: is it turned relative to the root? */
static uint32_t root_of(classify *c, uint32_t t, bool *turn)
{
    uint32_t root = t;
    uint8_t flip = 0;
    while (c->parent[root] != root) {
        flip ^= c->bits[root] & TURN;
        root = c->parent[root];
    }
    *turn = flip != 0;
    while (c->parent[t] != root && t != root) { /* shorten the path */
        uint32_t next = c->parent[t];
        uint8_t own = c->bits[t] & TURN;
        c->parent[t] = root;
        c->bits[t] = (uint8_t)((c->bits[t] & ~TURN) | flip);
        flip ^= own;
        t = next;
    }
    return root;
}

/* Two triangles share an edge of two faces; they agree when they use it in opposite directions. */
static void unite(classify *c, uint32_t a, uint32_t b, bool agree)
{
    bool turn_a, turn_b;
    uint32_t ra = root_of(c, a, &turn_a), rb = root_of(c, b, &turn_b);
    bool turn = (turn_a != turn_b) != !agree; /* of one root relative to the other */
    if (ra == rb) {
        if (turn) c->bits[ra] |= CONFLICT;
        return;
    }
    /* the smaller number becomes the root, so that the result does not depend on how paths were shortened */
    uint32_t low = ra < rb ? ra : rb, high = ra < rb ? rb : ra;
    c->parent[high] = low;
    c->bits[low] |= c->bits[high] & CONFLICT;
    c->bits[high] = turn ? TURN : 0;
}

static void unite_all(classify *c)
{
    for (uint64_t t = 0; t < c->in->count; t++) {
        corners tri;
        if (!load(c, t, &tri)) continue;
        for (int e = 0; e < 3; e++) {
            bool up;
            edge *at = find(c, key_of(&tri, e, &up));
            if (at->uses != 2) continue;
            if (at->first == t && at->net == 0) at->net = up ? 1 : -1; /* its direction, for the second user */
            else unite(c, at->first, (uint32_t)t, (at->net > 0) != up);
        }
    }
    for (uint64_t i = 0; i < c->capacity; i++) c->edges[i].net = 0;
}

static double area2(const corners *t, double n[3])
{
    double a[3], b[3];
    for (int k = 0; k < 3; k++) a[k] = (double)t->q[1][k] - t->q[0][k], b[k] = (double)t->q[2][k] - t->q[0][k];
    for (int k = 0; k < 3; k++) n[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
    return sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

/* What is summed over a part, at its root. */
typedef struct part_sum { double area, turned, volume, origin[3]; } part_sum;

/* Most of a part keeps the orientation it came with; where nothing says which, the first triangle does. */
static bool turn_parts(classify *c)
{
    const uint64_t n = c->in->count;
    uint64_t parts = 0;
    uint32_t *part = svo_alloc(c->in->allocator, n, sizeof *part); /* of roots: their number among roots */
    if (part == NULL) return false;
    for (uint64_t t = 0; t < n; t++)
        if (c->parent[t] == t) part[t] = (uint32_t)parts++;
    part_sum *sum = svo_calloc(c->in->allocator, parts, sizeof *sum);
    if (sum == NULL) {
        svo_free(c->in->allocator, part, n, sizeof *part);
        return false;
    }
    for (int pass = 0; pass < 2; pass++) {
        for (uint64_t t = 0; t < n; t++) {
            corners tri;
            if (!load(c, t, &tri)) continue;
            bool turn;
            double normal[3];
            uint32_t root = root_of(c, (uint32_t)t, &turn);
            part_sum *s = &sum[part[root]];
            if (pass == 0) {
                if (s->area == 0)
                    for (int k = 0; k < 3; k++) s->origin[k] = tri.q[0][k];
                double area = area2(&tri, normal);
                s->area += area;
                if (turn) s->turned += area;
            } else {
                /* volume over the part's first corner; exact enough to tell a clear sign */
                area2(&tri, normal);
                double v = 0;
                for (int k = 0; k < 3; k++) v += normal[k] * (tri.q[0][k] - s->origin[k]);
                bool whole = (c->bits[root] & WHOLE) != 0;
                s->volume += turn != whole ? -v : v;
            }
        }
        for (uint64_t t = 0; t < n; t++)
            if (pass == 0 && c->parent[t] == t && sum[part[t]].turned * 2 > sum[part[t]].area) c->bits[t] |= WHOLE;
    }
    /* A mesh that is inside out as a whole is turned as a whole; single parts are not, they may be cavities. (6 volumes and 2 areas: of a
     * sphere 0.19.) */
    double volume = 0, area = 0;
    for (uint64_t i = 0; i < parts; i++) volume += sum[i].volume, area += sum[i].area;
    for (uint64_t t = 0; volume < -0.02 * area * sqrt(area) && t < n; t++)
        if (c->parent[t] == t) c->bits[t] ^= WHOLE;
    svo_free(c->in->allocator, sum, parts, sizeof *sum);
    svo_free(c->in->allocator, part, n, sizeof *part);
    return true;
}

static bool turned(classify *c, uint64_t t, uint32_t *root)
{
    bool turn;
    *root = root_of(c, (uint32_t)t, &turn);
    return turn != ((c->bits[*root] & WHOLE) != 0);
}

/* Parts with edges of an odd number of uses are open. */
static void find_odd(classify *c)
{
    for (uint64_t t = 0; t < c->in->count; t++) {
        corners tri;
        if (!load(c, t, &tri)) continue;
        bool turn, up;
        uint32_t root = root_of(c, (uint32_t)t, &turn);
        for (int e = 0; e < 3; e++)
            if (find(c, key_of(&tri, e, &up))->uses % 2 != 0) c->bits[root] |= ODD;
    }
}

static void find_unbalanced(classify *c)
{
    for (int pass = 0; pass < 2; pass++)
        for (uint64_t t = 0; t < c->in->count; t++) {
            corners tri;
            if (!load(c, t, &tri)) continue;
            uint32_t root;
            bool turn = turned(c, t, &root);
            for (int e = 0; e < 3; e++) {
                bool up;
                edge *at = find(c, key_of(&tri, e, &up));
                if (pass == 1 && at->net != 0) c->bits[root] |= UNBALANCED;
                if (pass == 0 && at->net < INT16_MAX && at->net > INT16_MIN) at->net = (int16_t)(at->net + (up != turn ? 1 : -1));
            }
        }
}

static bool list_boundary(classify *c, svo_buffer *boundary)
{
    for (uint64_t t = 0; t < c->in->count; t++) {
        corners tri;
        if ((c->in->kind[t] & 3) != SVOI_OPEN || !load(c, t, &tri)) continue;
        for (int e = 0; e < 3; e++) {
            bool up;
            edge *at = find(c, key_of(&tri, e, &up));
            if (at->net == 0) continue;
            svoi_boundary_edge b = {.times = (uint32_t)(at->net < 0 ? -at->net : at->net)};
            const int32_t *from = tri.q[e], *to = tri.q[e == 2 ? 0 : e + 1];
            memcpy(b.a, up == (at->net > 0) ? from : to, sizeof b.a);
            memcpy(b.b, up == (at->net > 0) ? to : from, sizeof b.b);
            at->net = 0; /* once */
            if (svo_buffer_append(boundary, &b, sizeof b) == NULL) return false;
        }
    }
    return true;
}

svo_result svoi_edges_classify(const svoi_edges_input *in, svo_buffer *boundary, svo_error *err)
{
    classify c = {.in = in};
    const uint64_t n = in->count;
    c.parent = svo_alloc(in->allocator, n, sizeof *c.parent);
    c.bits = svo_calloc(in->allocator, n, 1);
    bool ok = c.parent != NULL && c.bits != NULL && count_edges(&c);
    if (ok) {
        for (uint64_t t = 0; t < n; t++) c.parent[t] = (uint32_t)t;
        unite_all(&c);
        find_odd(&c);
        ok = turn_parts(&c);
    }
    if (ok) {
        find_unbalanced(&c);
        for (uint64_t t = 0; t < n; t++) {
            if (in->kind[t] == SVOI_SKIPPED) continue;
            uint32_t root;
            bool turn = turned(&c, t, &root);
            uint8_t bits = c.bits[root];
            in->kind[t] = bits & ODD ? SVOI_OPEN : bits & UNBALANCED ? SVOI_EVEN : SVOI_ORIENTED;
            if (turn) in->kind[t] |= SVOI_TURNED;
        }
        ok = list_boundary(&c, boundary);
    }
    svo_free(in->allocator, c.edges, c.capacity, sizeof *c.edges);
    svo_free(in->allocator, c.parent, n, sizeof *c.parent);
    svo_free(in->allocator, c.bits, n, 1);
    return ok ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the edges of %llu triangles", (unsigned long long)n);
}
