#include "svoi_winding.h"

#include <math.h>
#include <string.h>

#include "svo_task.h"

__extension__ typedef __int128 wide;

enum { BLOCK = 8192, FEW_EDGES = 256 /* boundary edges that are rather summed one by one */ };

static const double accept = 2.3; /* distance over radius from which a node is one term */

/* --- building ----------------------------------------------------------------------------------------------------- */

static void triangle_box(void *user, uint32_t t, svoi_box *box)
{
    const svo_winding *w = user;
    svo_record r;
    svo_bins_record(w->bins, t, &r);
    for (int k = 0; k < 3; k++) {
        int32_t a = r.q[0][k], b = r.q[1][k], c = r.q[2][k];
        box->low[k] = a < b ? a < c ? a : c : b < c ? b : c;
        box->high[k] = a > b ? a > c ? a : c : b > c ? b : c;
    }
}

static void edge_box(void *user, uint32_t e, svoi_box *box) { svoi_edge_box(&((const svo_winding *)user)->boundary[e], box); }

typedef struct scan {
    svo_winding *w;
    const svo_placement *placement;
    uint64_t *keys;
    uint32_t lattice_bits;
    uint64_t sum[256][2];
} scan;

static svo_result scan_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)err;
    scan *s = user;
    const svo_placement *p = s->placement;
    uint64_t g = svo_placement_group(p, begin);
    for (uint64_t t = begin; t < end; t++) {
        while (t - p->groups[g].first >= p->groups[g].part->triangle_count) g++;
        svo_vec3 v[3];
        svo_placement_world(p, &p->groups[g], t - p->groups[g].first, v);
        double z = 0; /* 0 * x is NaN for infinities and NaNs */
        for (int k = 0; k < 3; k++) z += v[k].x * 0 + v[k].y * 0 + v[k].z * 0;
        s->w->kind[t] = z == 0 ? 0 : SVOI_SKIPPED;
        if (!(z == 0)) continue;
        svo_record r;
        svo_bins_record(s->w->bins, (uint32_t)t, &r);
        svoi_edge_sum((const int32_t(*)[3])r.q, s->sum[worker]);
        int32_t centre[3];
        for (int k = 0; k < 3; k++) centre[k] = (int32_t)(((int64_t)r.q[0][k] + r.q[1][k] + r.q[2][k]) / 3);
        s->keys[t] = svoi_tree_key(centre, s->lattice_bits);
    }
    return SVO_OK;
}

static bool build_trees(svo_winding *w, const uint64_t *keys)
{
    uint64_t counts[4] = {0};
    for (uint64_t t = 0; t < w->count; t++) counts[w->kind[t] & 3]++;
    for (int c = 0; c < SVOI_CLASSES; c++) {
        if (counts[c] == 0) continue;
        uint32_t *order = svo_alloc(w->allocator, counts[c], sizeof *order);
        if (order == NULL) return false;
        uint64_t n = 0;
        for (uint64_t t = 0; t < w->count; t++)
            if ((w->kind[t] & 3) == c) order[n++] = (uint32_t)t;
        if (!svoi_tree_build(&w->tree[c], order, n, keys, triangle_box, w, w->allocator)) return false;
    }
    return true;
}

static bool build_edges(svo_winding *w, uint32_t lattice_bits)
{
    uint64_t n = w->boundary_count, *keys = svo_alloc(w->allocator, n, sizeof *keys);
    uint32_t *order = svo_alloc(w->allocator, n, sizeof *order);
    bool ok = keys != NULL && order != NULL;
    for (uint64_t i = 0; ok && i < n; i++) {
        int32_t middle[3];
        for (int k = 0; k < 3; k++) middle[k] = (int32_t)(((int64_t)w->boundary[i].a[k] + w->boundary[i].b[k]) / 2);
        keys[i] = svoi_tree_key(middle, lattice_bits);
        order[i] = (uint32_t)i;
    }
    if (ok) ok = svoi_tree_build(&w->edges, order, n, keys, edge_box, w, w->allocator);
    else svo_free(w->allocator, order, n, sizeof *order);
    svo_free(w->allocator, keys, n, sizeof *keys);
    if (!ok) return false;
    svoi_tree *t = &w->edges;
    w->lines = svo_calloc(w->allocator, t->node_count, sizeof *w->lines);
    if (w->lines == NULL) return false;
    for (uint64_t i = 0; i < n; i++) {
        const svoi_boundary_edge *e = &w->boundary[t->order[i]];
        svoi_lines *to = &w->lines[i / SVOI_TREE_LEAF];
        double d2 = 0;
        for (int k = 0; k < 3; k++) {
            const double d = (double)e->b[k] - e->a[k];
            d2 += d * d;
            to->sum[k] += e->times * d;
        }
        to->length += e->times * sqrt(d2);
    }
    for (uint32_t l = 1; l < t->levels; l++)
        for (uint64_t i = 0; i < t->size[l - 1]; i++) {
            const svoi_lines *from = &w->lines[t->first[l - 1] + i];
            svoi_lines *to = &w->lines[t->first[l] + i / 2];
            to->length += from->length;
            for (int k = 0; k < 3; k++) to->sum[k] += from->sum[k];
        }
    return true;
}

/* Corners of a triangle, turned as its part wants. */
static void corners_of(const svo_winding *w, uint32_t t, int32_t q[3][3])
{
    svo_record r;
    svo_bins_record(w->bins, t, &r);
    memcpy(q, r.q, sizeof r.q);
    if (w->kind[t] & SVOI_TURNED) memcpy(q[1], r.q[2], sizeof q[1]), memcpy(q[2], r.q[1], sizeof q[2]);
}

static void area_vector(int32_t (*q)[3], double n[3])
{
    double a[3], b[3];
    for (int k = 0; k < 3; k++) a[k] = (double)q[1][k] - q[0][k], b[k] = (double)q[2][k] - q[0][k];
    for (int k = 0; k < 3; k++) n[k] = 0.5 * (a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
}

/* Sums of a node before they are brought to its centre. */
typedef struct sums { double area, centre[3], normal[3], m[3][3]; } sums;

static void finish_moment(const svoi_box *box, const sums *s, svoi_moment *out)
{
    double m[3][3];
    for (int i = 0; i < 3; i++) out->centre[i] = s->area > 0 ? s->centre[i] / s->area : 0.5 * ((double)box->low[i] + box->high[i]);
    for (int i = 0; i < 3; i++) {
        out->normal[i] = s->normal[i];
        for (int j = 0; j < 3; j++) m[i][j] = s->m[i][j] - out->centre[i] * s->normal[j];
    }
    out->trace = (float)(m[0][0] + m[1][1] + m[2][2]);
    for (int i = 0; i < 3; i++) out->symmetric[i] = (float)m[i][i];
    out->symmetric[3] = (float)(m[0][1] + m[1][0]);
    out->symmetric[4] = (float)(m[0][2] + m[2][0]);
    out->symmetric[5] = (float)(m[1][2] + m[2][1]);
    double r2 = 0;
    for (int i = 0; i < 3; i++) {
        double d = fmax(out->centre[i] - box->low[i], box->high[i] - out->centre[i]);
        r2 += d * d;
    }
    out->radius = nextafterf((float)sqrt(r2), INFINITY);
}

static bool build_moments(svo_winding *w)
{
    const svoi_tree *t = &w->tree[SVOI_OPEN];
    w->moments = svo_alloc(w->allocator, t->node_count, sizeof *w->moments);
    sums *s = svo_calloc(w->allocator, t->node_count, sizeof *s);
    if (w->moments == NULL || s == NULL) {
        svo_free(w->allocator, s, t->node_count, sizeof *s);
        return false;
    }
    for (uint64_t i = 0; i < t->count; i++) {
        int32_t q[3][3];
        double n[3], c[3];
        sums *to = &s[i / SVOI_TREE_LEAF];
        corners_of(w, t->order[i], q);
        area_vector(q, n);
        double area = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        to->area += area;
        for (int k = 0; k < 3; k++) {
            c[k] = ((double)q[0][k] + q[1][k] + q[2][k]) / 3;
            to->centre[k] += area * c[k];
            to->normal[k] += n[k];
        }
        for (int k = 0; k < 3; k++)
            for (int j = 0; j < 3; j++) to->m[k][j] += c[k] * n[j];
    }
    for (uint32_t l = 1; l < t->levels; l++)
        for (uint64_t i = 0; i < t->size[l - 1]; i++) {
            const sums *from = &s[t->first[l - 1] + i];
            sums *to = &s[t->first[l] + i / 2];
            to->area += from->area;
            for (int k = 0; k < 3; k++) {
                to->centre[k] += from->centre[k];
                to->normal[k] += from->normal[k];
                for (int j = 0; j < 3; j++) to->m[k][j] += from->m[k][j];
            }
        }
    for (uint64_t i = 0; i < t->node_count; i++) finish_moment(&t->box[i], &s[i], &w->moments[i]);
    svo_free(w->allocator, s, t->node_count, sizeof *s);
    return true;
}

static svo_result no_memory(uint64_t count, svo_error *err)
{
    return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to tell inside from outside of %llu triangles", (unsigned long long)count);
}

static svo_result build(svo_winding *w, const svo_placement *p, const svo_grid *grid, uint32_t threads, uint64_t *keys, svo_error *err)
{
    const uint32_t lattice_bits = grid->depth + 8;
    scan s = {.w = w, .placement = p, .keys = keys, .lattice_bits = lattice_bits};
    SVO_TRY(svo_parallel_for(threads, w->count, BLOCK, scan_block, &s, err));
    uint64_t sum[2] = {0, 0};
    for (int i = 0; i < 256; i++)
        for (int k = 0; k < 2; k++) sum[k] += s.sum[i][k];
    svo_result r = SVO_OK;
    if (sum[0] != 0 || sum[1] != 0) { /* not every edge is balanced */
        svo_buffer boundary;
        svo_buffer_init(&boundary, w->allocator);
        svoi_edges_input in = {w->bins, w->count, w->kind, threads, w->allocator};
        r = svoi_edges_classify(&in, &boundary, err);
        w->boundary_count = boundary.size / sizeof *w->boundary;
        if (r == SVO_OK && w->boundary_count != 0) {
            w->boundary = svo_alloc(w->allocator, w->boundary_count, sizeof *w->boundary);
            if (w->boundary == NULL) r = no_memory(w->count, err);
            else memcpy(w->boundary, boundary.data, boundary.size);
        }
        svo_buffer_free(&boundary);
    }
    SVO_TRY(r);
    bool ok = build_trees(w, keys);
    if (ok && w->boundary_count != 0) ok = build_edges(w, lattice_bits);
    if (ok && w->tree[SVOI_OPEN].count != 0 && w->boundary_count > FEW_EDGES) ok = build_moments(w);
    return ok ? SVO_OK : no_memory(w->count, err);
}

svo_result svo_winding_create(const svo_bins *bins, const svo_placement *placement, const svo_grid *grid, uint32_t threads, const svo_allocator *a,
                              svo_winding **out, svo_winding_report *report, svo_error *err)
{
    double started = svo_seconds();
    svo_winding *w = svo_calloc(a, 1, sizeof *w);
    if (w == NULL) return no_memory(placement->triangle_count, err);
    w->bins = bins;
    w->allocator = a;
    w->count = placement->triangle_count;
    svo_result r = SVO_OK;
    if (w->count != 0) {
        uint64_t *keys = svo_alloc(a, w->count, sizeof *keys);
        w->kind = svo_alloc(a, w->count, 1);
        r = keys == NULL || w->kind == NULL ? no_memory(w->count, err) : build(w, placement, grid, threads, keys, err);
        svo_free(a, keys, w->count, sizeof *keys);
    }
    if (r != SVO_OK) {
        svo_winding_free(w);
        return r;
    }
    *report = (svo_winding_report){.oriented = w->tree[0].count, .even = w->tree[1].count, .open = w->tree[2].count, .boundary_edges = w->boundary_count};
    for (uint64_t t = 0; t < w->count; t++) report->turned += (w->kind[t] & SVOI_TURNED) != 0;
    report->seconds = svo_seconds() - started;
    *out = w;
    return SVO_OK;
}

void svo_winding_free(svo_winding *w)
{
    if (w == NULL) return;
    uint64_t moments = w->tree[SVOI_OPEN].node_count, lengths = w->edges.node_count;
    svo_free(w->allocator, w->moments, moments, sizeof *w->moments);
    svo_free(w->allocator, w->lines, lengths, sizeof *w->lines);
    for (int c = 0; c < SVOI_CLASSES; c++) svoi_tree_free(&w->tree[c]);
    svoi_tree_free(&w->edges);
    svo_free(w->allocator, w->boundary, w->boundary_count, sizeof *w->boundary);
    svo_free(w->allocator, w->kind, w->count, 1);
    svo_free(w->allocator, w, 1, sizeof *w);
}

bool svo_winding_closed(const svo_winding *w) { return w->tree[SVOI_OPEN].count == 0; }

/* --- closed parts: crossings of a ray ----------------------------------------------------------------------------- */

/* On which side of the edge a -> b, seen along z, the point lies. The point is moved by (e, e^2) for an e that is smaller than everything, so that
 * it lies on no edge; 0 only where the edge is a point. The other direction gives the negative. */
static int side_of(const int32_t a[3], const int32_t b[3], const int32_t p[3])
{
    int64_t dx = (int64_t)b[0] - a[0], dy = (int64_t)b[1] - a[1];
    int64_t e = dx * ((int64_t)p[1] - a[1]) - dy * ((int64_t)p[0] - a[0]);
    if (e != 0) return e > 0 ? 1 : -1;
    if (dy != 0) return dy > 0 ? -1 : 1;
    return dx > 0 ? 1 : dx < 0 ? -1 : 0;
}

/* 1 or -1 when the ray from p along +z leaves or enters through the triangle, else 0. */
static int crossing(int32_t (*q)[3], const int32_t p[3])
{
    int side = side_of(q[0], q[1], p);
    if (side == 0 || side_of(q[1], q[2], p) != side || side_of(q[2], q[0], p) != side) return 0;
    int64_t a[3], b[3], d[3];
    for (int k = 0; k < 3; k++) {
        a[k] = (int64_t)q[1][k] - q[0][k];
        b[k] = (int64_t)q[2][k] - q[0][k];
        d[k] = (int64_t)p[k] - q[0][k];
    }
    wide height = (wide)(a[1] * b[2] - a[2] * b[1]) * d[0] + (wide)(a[2] * b[0] - a[0] * b[2]) * d[1] + (wide)(a[0] * b[1] - a[1] * b[0]) * d[2];
    return (side > 0 ? height < 0 : height > 0) ? side : 0;
}

/* Signed sum of crossings, and their number. */
static int64_t crossings(const svo_winding *w, const svoi_tree *t, const int32_t p[3], uint64_t *number)
{
    int64_t sum = 0;
    *number = 0;
    if (t->count == 0) return 0;
    svoi_tree_node stack[SVOI_TREE_STACK];
    uint32_t top = 0;
    stack[top++] = (svoi_tree_node){t->levels - 1, 0};
    while (top != 0) {
        svoi_tree_node n = stack[--top];
        const svoi_box *b = svoi_tree_box(t, n);
        /* the moved point may be inside where p lies on the lower side */
        if (p[0] < b->low[0] || p[0] > b->high[0] || p[1] < b->low[1] || p[1] > b->high[1] || p[2] > b->high[2]) continue;
        if (n.level != 0) {
            top += svoi_tree_children(t, n, &stack[top]);
            continue;
        }
        uint64_t begin, end;
        svoi_tree_items(t, n, &begin, &end);
        for (; begin < end; begin++) {
            int32_t q[3][3];
            corners_of(w, t->order[begin], q);
            int c = crossing(q, p);
            sum += c;
            *number += c != 0;
        }
    }
    return sum;
}

/* --- open parts: hierarchical winding numbers --------------------------------------------------------------------- */

/* Solid angle of a triangle over 4 pi (van Oosterom and Strackee 1983). */
static double solid_angle(int32_t (*q)[3], const int32_t p[3])
{
    double v[3][3], l[3];
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) v[i][k] = (double)q[i][k] - p[k];
        l[i] = sqrt(v[i][0] * v[i][0] + v[i][1] * v[i][1] + v[i][2] * v[i][2]);
    }
    double det = v[0][0] * (v[1][1] * v[2][2] - v[1][2] * v[2][1]) + v[0][1] * (v[1][2] * v[2][0] - v[1][0] * v[2][2]) +
                 v[0][2] * (v[1][0] * v[2][1] - v[1][1] * v[2][0]);
    double ab = v[0][0] * v[1][0] + v[0][1] * v[1][1] + v[0][2] * v[1][2], bc = v[1][0] * v[2][0] + v[1][1] * v[2][1] + v[1][2] * v[2][2],
           ca = v[2][0] * v[0][0] + v[2][1] * v[0][1] + v[2][2] * v[0][2];
    double den = l[0] * l[1] * l[2] + ab * l[2] + bc * l[0] + ca * l[1];
    return 2 * atan2(det, den) / SVOI_FOUR_PI;
}

/* Curtains hung from the boundary to infinity along -z close the open parts. A ray along +z crosses none of them, so the winding number of
 * the whole is the sum of the crossings of the surface, and that of the surface is less by the solid angles of the curtains. */
static double curtain_winding(const svo_winding *w, const int32_t p[3])
{
    uint64_t number;
    double sum = 0;
    for (uint64_t i = 0; i < w->boundary_count; i++) {
        const svoi_boundary_edge *e = &w->boundary[i];
        double a[3], b[3], dot_ab = 0, aa = 0, bb = 0;
        int64_t ax = (int64_t)e->a[0] - p[0], ay = (int64_t)e->a[1] - p[1], bx = (int64_t)e->b[0] - p[0], by = (int64_t)e->b[1] - p[1];
        for (int k = 0; k < 3; k++) {
            a[k] = (double)e->a[k] - p[k], b[k] = (double)e->b[k] - p[k];
            dot_ab += a[k] * b[k], aa += a[k] * a[k], bb += b[k] * b[k];
        }
        double la = sqrt(aa), lb = sqrt(bb);
        /* the triangle b, a, infinity; where the point is in the curtain's plane the side decides that the ray's rule has it on */
        double up = (double)(ax * by - ay * bx), across = la * lb + dot_ab - a[2] * lb - b[2] * la;
        if (bx * ay == by * ax) up = side_of(e->a, e->b, p) > 0 ? 0.0 : -0.0;
        sum += e->times * atan2(up, across);
    }
    return (double)crossings(w, &w->tree[SVOI_OPEN], p, &number) - 2 * sum / SVOI_FOUR_PI;
}

static double open_winding(const svo_winding *w, const int32_t p[3])
{
    const svoi_tree *t = &w->tree[SVOI_OPEN];
    double sum = 0;
    if (t->count == 0) return 0;
    if (w->moments == NULL) return curtain_winding(w, p);
    svoi_tree_node stack[SVOI_TREE_STACK];
    uint32_t top = 0;
    stack[top++] = (svoi_tree_node){t->levels - 1, 0};
    while (top != 0) {
        svoi_tree_node n = stack[--top];
        const svoi_moment *m = &w->moments[t->first[n.level] + n.at];
        double d[3] = {m->centre[0] - p[0], m->centre[1] - p[1], m->centre[2] - p[2]};
        double r2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2], reach = accept * (double)m->radius;
        if (r2 > reach * reach) {
            double inverse = 1 / r2, r3 = inverse / sqrt(r2);
            double quadratic = (double)m->symmetric[0] * d[0] * d[0] + (double)m->symmetric[1] * d[1] * d[1] + (double)m->symmetric[2] * d[2] * d[2] +
                               (double)m->symmetric[3] * d[0] * d[1] + (double)m->symmetric[4] * d[0] * d[2] + (double)m->symmetric[5] * d[1] * d[2];
            sum += r3 * (m->normal[0] * d[0] + m->normal[1] * d[1] + m->normal[2] * d[2] + (double)m->trace - 3 * quadratic * inverse) / SVOI_FOUR_PI;
        } else if (n.level != 0) {
            top += svoi_tree_children(t, n, &stack[top]);
        } else {
            uint64_t begin, end;
            svoi_tree_items(t, n, &begin, &end);
            for (; begin < end; begin++) {
                int32_t q[3][3];
                corners_of(w, t->order[begin], q);
                sum += solid_angle(q, p);
            }
        }
    }
    return sum;
}

bool svo_winding_inside(const svo_winding *w, const int32_t p[3], double *margin)
{
    uint64_t number;
    int64_t oriented = crossings(w, &w->tree[SVOI_ORIENTED], p, &number);
    double open = open_winding(w, p), total = (double)oriented + open;
    bool inside;
    if (oriented < 0) { /* inside where the total is beyond 1/2 either way */
        inside = fabs(total) > 0.5;
        *margin = fabs(fabs(total) - 0.5);
    } else {
        inside = total > 0.5;
        *margin = fabs(total - 0.5);
    }
    crossings(w, &w->tree[SVOI_EVEN], p, &number);
    if (number % 2 != 0) {
        inside = true;
        *margin = 1;
    }
    return inside;
}
