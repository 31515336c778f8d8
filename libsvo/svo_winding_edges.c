/* Which parts of a snapped mesh are closed: uses of edges are sorted, so that those of an edge are together, and faces turned so that neighbours agree. Uses are
 * in the order of places, so that what is looked up of triangles lies together too; everything else goes from one end of a store to the other. */
#include <math.h>
#include <string.h>

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

/* --- uses of edges ------------------------------------------------------------------------------------------------ */

typedef struct use {
    uint64_t hash;     /* of the edge */
    uint32_t triangle; /* number in the sorted store */
    uint32_t what;     /* where the edge is (PLACE bits), UP, number of the edge in the triangle */
} use;

enum { UP = 4, EDGE = 3, PLACE_SHIFT = 3, PLACE_BITS = 27 /* 9 an axis */ };

static uint64_t use_key(const void *record, const void *user)
{
    (void)user;
    const use *u = record;
    return (uint64_t)(u->what >> PLACE_SHIFT) << (SVOI_SORT_BITS - PLACE_BITS) | u->hash >> (64 - (SVOI_SORT_BITS - PLACE_BITS));
}

static int compare_uses(const void *a, const void *b)
{
    const use *s = a, *t = b;
    if (s->hash != t->hash) return s->hash < t->hash ? -1 : 1;
    if (s->triangle != t->triangle) return s->triangle < t->triangle ? -1 : 1;
    return (int)(s->what & EDGE) - (int)(t->what & EDGE);
}

typedef struct classify {
    const svoi_room *room;
    const svoi_store *triangles;
    uint64_t count, use_count;
    uint32_t lattice_bits;
    svoi_store uses, parent; /* parent: uint32_t, of the union of triangles */
    svoi_store *bits;        /* a byte a triangle: TURN relative to its parent; of roots also the others */
    svoi_store part;         /* uint32_t: of roots, their number among roots */
} classify;

/* Of `bits`. Those after the first belong to whole parts and are kept at their roots. */
enum { TURN = 1, ODD = 2, UNBALANCED = 4, WHOLE = 8 };

static uint32_t *parent_of(const classify *c, uint64_t t) { return svoi_at(&c->parent, t); }
static uint8_t *bits_of(const classify *c, uint64_t t) { return svoi_at(c->bits, t); }
static const svoi_triangle *triangle(const classify *c, uint64_t t) { return svoi_at(c->triangles, t); }

/* False for triangles with two equal corners: they have no area, and their edges cancel. */
static bool has_edges(const svoi_triangle *t)
{
    return compare_points(t->q[0], t->q[1]) != 0 && compare_points(t->q[1], t->q[2]) != 0 && compare_points(t->q[2], t->q[0]) != 0;
}

/* Ends of a triangle's edge, the lower one first; returns whether that is its direction. */
static bool ends_of(const svoi_triangle *t, uint32_t e, const int32_t **low, const int32_t **high)
{
    const int32_t *a = t->q[e], *b = t->q[e == 2 ? 0 : e + 1];
    const bool up = compare_points(a, b) < 0;
    *low = up ? a : b;
    *high = up ? b : a;
    return up;
}

static svo_result sort_uses(classify *c, svo_error *err)
{
    const svoi_order order = {use_key, compare_uses, NULL};
    svoi_sorter s;
    svo_result r = svoi_sorter_begin(&s, c->room, &order, sizeof(use), 3 * c->count, err);
    for (uint64_t t = 0; r == SVO_OK && t < c->count; t++) {
        const svoi_triangle *tri = triangle(c, t);
        if (!has_edges(tri)) continue;
        for (uint32_t e = 0; r == SVO_OK && e < 3; e++) {
            const int32_t *low, *high;
            const bool up = ends_of(tri, e, &low, &high);
            int32_t middle[3];
            for (int k = 0; k < 3; k++) middle[k] = (int32_t)(((int64_t)low[k] + high[k]) / 2);
            const use u = {edge_key(low, high, 2), (uint32_t)t, (uint32_t)(svoi_tree_key(middle, c->lattice_bits) >> (42 - PLACE_BITS)) << PLACE_SHIFT | (up ? UP : 0) | e};
            r = svoi_sorter_put(&s, &u, err);
        }
    }
    if (r == SVO_OK) return svoi_sorter_end(&s, &c->uses, &c->use_count, err);
    svoi_sorter_drop(&s);
    return r;
}

/* Uses [first, *end) are those of one edge. */
static use uses_of(const classify *c, uint64_t first, uint64_t *end)
{
    const use u = *(const use *)svoi_at(&c->uses, first);
    for (*end = first + 1; *end < c->use_count; (*end)++) {
        const use *v = svoi_at(&c->uses, *end);
        if (v->hash != u.hash || v->what >> PLACE_SHIFT != u.what >> PLACE_SHIFT) break;
    }
    return u;
}

/* --- parts: triangles joined across edges of two faces ------------------------------------------------------------ */

/* Root of a triangle; *turn: is it turned relative to the root? */
static uint32_t root_of(classify *c, uint32_t t, bool *turn)
{
    uint32_t root = t;
    uint8_t flip = 0;
    for (uint32_t up; (up = *parent_of(c, root)) != root; root = up) flip ^= *bits_of(c, root) & TURN;
    *turn = flip != 0;
    while (t != root) { /* shorten the path */
        uint32_t *parent = parent_of(c, t), next = *parent;
        if (next == root) break;
        uint8_t *bits = bits_of(c, t), own = *bits & TURN;
        *parent = root;
        *bits = (uint8_t)((*bits & ~TURN) | flip);
        flip ^= own;
        t = next;
    }
    return root;
}

/* Two triangles share an edge of two faces; they agree when they use it in opposite directions. */
static void unite(classify *c, uint32_t a, uint32_t b, bool agree)
{
    bool turn_a, turn_b;
    const uint32_t ra = root_of(c, a, &turn_a), rb = root_of(c, b, &turn_b);
    if (ra == rb) return; /* where that is a contradiction the part cannot be oriented, and an edge will be unbalanced */
    const bool turn = (turn_a != turn_b) != !agree; /* of one root relative to the other */
    /* the smaller number becomes the root, so that the result does not depend on how paths were shortened */
    const uint32_t low = ra < rb ? ra : rb, high = ra < rb ? rb : ra;
    *parent_of(c, high) = low;
    *bits_of(c, high) = turn ? TURN : 0;
}

static void unite_all(classify *c)
{
    for (uint64_t first = 0, end; first < c->use_count; first = end) {
        const use a = uses_of(c, first, &end);
        if (end - first != 2) continue;
        const use b = *(const use *)svoi_at(&c->uses, first + 1);
        unite(c, a.triangle, b.triangle, ((a.what ^ b.what) & UP) != 0);
    }
}

/* Parts with edges of an odd number of uses are open. */
static void find_odd(classify *c)
{
    for (uint64_t first = 0, end; first < c->use_count; first = end) {
        uses_of(c, first, &end);
        for (uint64_t i = first; (end - first) % 2 != 0 && i < end; i++) {
            bool turn;
            *bits_of(c, root_of(c, ((const use *)svoi_at(&c->uses, i))->triangle, &turn)) |= ODD;
        }
    }
}

static double area2(const svoi_triangle *t, double n[3])
{
    double a[3], b[3];
    for (int k = 0; k < 3; k++) a[k] = (double)t->q[1][k] - t->q[0][k], b[k] = (double)t->q[2][k] - t->q[0][k];
    for (int k = 0; k < 3; k++) n[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
    return sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

/* What is summed over a part. */
typedef struct part_sum { double area, turned, volume, origin[3]; } part_sum;

/* Most of a part keeps the orientation it came with; where nothing says which, its first triangle does. */
static svo_result turn_parts(classify *c, svo_error *err)
{
    uint64_t parts = 0;
    for (uint64_t t = 0; t < c->count; t++)
        if (*parent_of(c, t) == t) *(uint32_t *)svoi_at(&c->part, t) = (uint32_t)parts++;
    svoi_store sums;
    SVO_TRY(svoi_store_create(c->room, parts, sizeof(part_sum), &sums, err));
    for (int pass = 0; pass < 2; pass++) {
        for (uint64_t t = 0; t < c->count; t++) {
            const svoi_triangle *tri = triangle(c, t);
            if (!has_edges(tri)) continue;
            bool turn;
            double normal[3];
            const uint32_t root = root_of(c, (uint32_t)t, &turn);
            part_sum *s = svoi_at(&sums, *(const uint32_t *)svoi_at(&c->part, root));
            const double area = area2(tri, normal);
            if (pass == 0) {
                if (s->area == 0)
                    for (int k = 0; k < 3; k++) s->origin[k] = tri->q[0][k];
                s->area += area;
                if (turn) s->turned += area;
            } else {
                /* volume over the part's first corner; exact enough to tell a clear sign */
                double v = 0;
                for (int k = 0; k < 3; k++) v += normal[k] * (tri->q[0][k] - s->origin[k]);
                s->volume += turn != ((*bits_of(c, root) & WHOLE) != 0) ? -v : v;
            }
        }
        for (uint64_t t = 0; pass == 0 && t < c->count; t++) {
            if (*parent_of(c, t) != t) continue;
            const part_sum *s = svoi_at(&sums, *(const uint32_t *)svoi_at(&c->part, t));
            if (s->turned * 2 > s->area) *bits_of(c, t) |= WHOLE;
        }
    }
    /* A mesh that is inside out as a whole is turned as a whole; single parts are not, they may be cavities. (6 volumes and 2 areas: of a
     * sphere 0.19.) */
    double volume = 0, area = 0;
    for (uint64_t i = 0; i < parts; i++) {
        const part_sum *s = svoi_at(&sums, i);
        volume += s->volume, area += s->area;
    }
    for (uint64_t t = 0; volume < -0.02 * area * sqrt(area) && t < c->count; t++)
        if (*parent_of(c, t) == t) *bits_of(c, t) ^= WHOLE;
    svoi_store_free(&sums);
    return SVO_OK;
}

static bool turned(classify *c, uint32_t t, uint32_t *root)
{
    bool turn;
    *root = root_of(c, t, &turn);
    return turn != ((*bits_of(c, *root) & WHOLE) != 0);
}

/* Uses from the lower end of an edge to the higher less those back, after turning. */
static int64_t net_of(classify *c, uint64_t first, uint64_t end)
{
    int64_t net = 0;
    for (uint64_t i = first; i < end; i++) {
        const use u = *(const use *)svoi_at(&c->uses, i);
        uint32_t root;
        net += ((u.what & UP) != 0) != turned(c, u.triangle, &root) ? 1 : -1;
    }
    return net;
}

static void find_unbalanced(classify *c)
{
    for (uint64_t first = 0, end; first < c->use_count; first = end) {
        uses_of(c, first, &end);
        if (net_of(c, first, end) == 0) continue;
        for (uint64_t i = first; i < end; i++) {
            uint32_t root;
            turned(c, ((const use *)svoi_at(&c->uses, i))->triangle, &root);
            *bits_of(c, root) |= UNBALANCED;
        }
    }
}

static uint8_t class_of(classify *c, uint32_t t)
{
    uint32_t root;
    const bool turn = turned(c, t, &root);
    const uint8_t bits = *bits_of(c, root);
    return (uint8_t)((bits & ODD ? SVOI_OPEN : bits & UNBALANCED ? SVOI_EVEN : SVOI_ORIENTED) | (turn ? SVOI_TURNED : 0));
}

/* Edges that are not balanced and have a face of an open part: their number, or (with a sorter) all of them. */
static svo_result list_boundary(classify *c, svoi_sorter *to, uint64_t *number, svo_error *err)
{
    *number = 0;
    for (uint64_t first = 0, end; first < c->use_count; first = end) {
        const use u = uses_of(c, first, &end);
        const int64_t net = net_of(c, first, end);
        bool open = false;
        for (uint64_t i = first; net != 0 && !open && i < end; i++) open = (class_of(c, ((const use *)svoi_at(&c->uses, i))->triangle) & 3) == SVOI_OPEN;
        if (!open) continue;
        ++*number;
        if (to == NULL) continue;
        const int32_t *low, *high;
        ends_of(triangle(c, u.triangle), u.what & EDGE, &low, &high);
        svoi_boundary_edge b = {.times = (uint32_t)(net < 0 ? -net : net)};
        memcpy(b.a, net > 0 ? low : high, sizeof b.a);
        memcpy(b.b, net > 0 ? high : low, sizeof b.b);
        SVO_TRY(svoi_sorter_put(to, &b, err));
    }
    return SVO_OK;
}

static svo_result sort_boundary(classify *c, svoi_store *boundary, uint64_t *boundary_count, svo_error *err)
{
    svoi_order order;
    svoi_sorter s;
    uint64_t n;
    svoi_boundary_order(&c->lattice_bits, &order);
    SVO_TRY(list_boundary(c, NULL, &n, err));
    svo_result r = svoi_sorter_begin(&s, c->room, &order, sizeof(svoi_boundary_edge), n, err);
    if (r == SVO_OK) r = list_boundary(c, &s, &n, err);
    if (r == SVO_OK) return svoi_sorter_end(&s, boundary, boundary_count, err);
    svoi_sorter_drop(&s);
    return r;
}

svo_result svoi_edges_classify(const svoi_room *room, const svoi_store *triangles, uint64_t count, uint32_t lattice_bits, svoi_store *kind, svoi_store *boundary,
                               uint64_t *boundary_count, svo_error *err)
{
    classify c = {.room = room, .triangles = triangles, .count = count, .lattice_bits = lattice_bits};
    svoi_store bits = {0};
    c.bits = &bits;
    svo_result r = sort_uses(&c, err);
    if (r == SVO_OK) r = svoi_store_create(room, count, sizeof(uint32_t), &c.parent, err);
    if (r == SVO_OK) r = svoi_store_create(room, count, 1, &bits, err);
    if (r == SVO_OK) r = svoi_store_create(room, count, sizeof(uint32_t), &c.part, err);
    if (r == SVO_OK) {
        for (uint64_t t = 0; t < count; t++) *parent_of(&c, t) = (uint32_t)t;
        unite_all(&c);
        find_odd(&c);
        r = turn_parts(&c, err);
    }
    svoi_store_free(&c.part);
    if (r == SVO_OK) {
        find_unbalanced(&c);
        r = sort_boundary(&c, boundary, boundary_count, err);
    }
    svoi_store_free(&c.uses);
    if (r == SVO_OK) r = svoi_store_create(room, count, 1, kind, err);
    for (uint64_t t = 0; r == SVO_OK && t < count; t++) *(uint8_t *)svoi_at(kind, t) = class_of(&c, (uint32_t)t);
    svoi_store_free(&c.parent);
    svoi_store_free(&bits);
    return r;
}
