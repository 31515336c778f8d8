/* Questions about distances to a mesh's winding: what the number can change by, and which triangle is nearest. */
#include <math.h>
#include <string.h>

#include "svoi_winding.h"

static double gap2(const svoi_box *b, const int32_t low[3], const int32_t high[3])
{
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        double d = b->low[k] > high[k] ? (double)b->low[k] - high[k] : low[k] > b->high[k] ? (double)low[k] - b->high[k] : 0;
        sum += d * d;
    }
    return sum;
}

/* A box of points that is asked about. */
typedef struct region {
    const int32_t *low, *high;
    double middle[3], diagonal;
} region;

/* At most the squared distance of an edge from a region: that of its box, or that from the middle less half of the diagonal. */
static double edge_gap2(const svoi_boundary_edge *e, const region *r)
{
    svoi_box own;
    svoi_edge_box(e, &own);
    double along = 0, length2 = 0, d2 = 0;
    for (int k = 0; k < 3; k++) {
        const double d = (double)e->b[k] - e->a[k];
        along += d * (r->middle[k] - e->a[k]);
        length2 += d * d;
    }
    const double t = length2 > 0 ? fmin(fmax(along / length2, 0), 1) : 0;
    for (int k = 0; k < 3; k++) {
        const double d = e->a[k] + t * ((double)e->b[k] - e->a[k]) - r->middle[k];
        d2 += d * d;
    }
    /* a little less, for the rounding of what is above */
    const double box2 = gap2(&own, r->low, r->high), d = sqrt(d2) * (1 - 1e-12) - 0.5 * r->diagonal - 1e-6;
    return d > 0 ? fmax(box2, d * d) : box2;
}

/* The number changes along a way by the field of the boundary as if it carried a current (the law of Biot and Savart): by 1 / (4 pi) of the integral of
 * |dl x r| / r^3. For an edge that is at most length / d^2, and 2 / d, as of a straight line without ends. For many edges that are together
 * within rho of a point: what their sum as one vector there gives, and for each the way from there, |d(r / r^3)| <= 2 / d^3; so what goes round in a loop
 * falls off faster. */
double svo_winding_change(const svo_winding *w, const int32_t low[3], const int32_t high[3])
{
    const svoi_bounds_tree *t = &w->edges;
    double gradient = 0;
    if (t->count == 0) return 0;
    region r = {.low = low, .high = high};
    for (int k = 0; k < 3; k++) {
        r.diagonal += ((double)high[k] - low[k]) * ((double)high[k] - low[k]);
        r.middle[k] = 0.5 * ((double)low[k] + high[k]);
    }
    r.diagonal = sqrt(r.diagonal);
    svoi_tree_node stack[SVOI_TREE_STACK];
    uint32_t top = 0;
    stack[top++] = (svoi_tree_node){t->levels - 1, 0};
    while (top != 0) {
        svoi_tree_node n = stack[--top];
        const svoi_box *b = svoi_node_box(t, n);
        const double d2 = gap2(b, low, high);
        double extent2 = 0, sum = 0;
        for (int k = 0; k < 3; k++) extent2 += ((double)b->high[k] - b->low[k]) * ((double)b->high[k] - b->low[k]);
        const bool far = d2 > 9 * extent2;
        if (!far && n.level != 0) {
            top += svoi_node_children(t, n, &stack[top]);
            continue;
        }
        if (far) {
            const svoi_lines *l = svoi_at(&w->lines, svoi_node_number(t, n));
            const double one = sqrt(l->sum[0] * l->sum[0] + l->sum[1] * l->sum[1] + l->sum[2] * l->sum[2]);
            sum = fmin(l->length, one * (1 + 1e-12) + l->length * sqrt(extent2 / d2)) / d2; /* extent = 2 rho */
        } else {
            uint64_t begin, end;
            for (svoi_leaf_items(t, n, &begin, &end); begin < end; begin++) {
                const svoi_boundary_edge *e = svoi_at(&w->boundary, begin);
                const double near2 = edge_gap2(e, &r);
                double length2 = 0;
                if (!(near2 > 0)) return INFINITY;
                for (int k = 0; k < 3; k++) length2 += ((double)e->b[k] - e->a[k]) * ((double)e->b[k] - e->a[k]);
                sum += e->times * fmin(sqrt(length2) / near2, 2 / sqrt(near2));
            }
        }
        gradient += sum / SVOI_FOUR_PI;
        if (gradient * r.diagonal > 1) return INFINITY;
    }
    return gradient * r.diagonal;
}

/* --- the nearest surface ------------------------------------------------------------------------------------------ */

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Squared distance of the origin from a triangle; barycentric coordinates of the nearest point (Ericson 2005, 5.1.5). */
static double nearest_on(double (*v)[3], double out[3])
{
    double ab[3], ac[3];
    for (int k = 0; k < 3; k++) ab[k] = v[1][k] - v[0][k], ac[k] = v[2][k] - v[0][k];
    double d1 = -dot(ab, v[0]), d2 = -dot(ac, v[0]), d3 = -dot(ab, v[1]), d4 = -dot(ac, v[1]), d5 = -dot(ab, v[2]), d6 = -dot(ac, v[2]);
    double vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
    out[0] = 1, out[1] = out[2] = 0;
    if (d1 <= 0 && d2 <= 0) {
    } else if (d3 >= 0 && d4 <= d3) {
        out[0] = 0, out[1] = 1;
    } else if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) {
        out[1] = d1 / (d1 - d3), out[0] = 1 - out[1];
    } else if (d6 >= 0 && d5 <= d6) {
        out[0] = 0, out[2] = 1;
    } else if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 > d6) {
        out[2] = d2 / (d2 - d6), out[0] = 1 - out[2];
    } else if (va <= 0 && d4 >= d3 && d5 >= d6 && d4 - d3 + d5 - d6 > 0) {
        out[2] = (d4 - d3) / (d4 - d3 + d5 - d6), out[1] = 1 - out[2], out[0] = 0;
    } else if (va + vb + vc > 0) {
        double scale = 1 / (va + vb + vc);
        out[1] = vb * scale, out[2] = vc * scale, out[0] = 1 - out[1] - out[2];
    }
    double p[3];
    for (int k = 0; k < 3; k++) p[k] = out[0] * v[0][k] + out[1] * v[1][k] + out[2] * v[2][k];
    return dot(p, p);
}

/* Squared distance of a point from a box. Without branches: whether a coordinate is before, in or behind the box cannot be foreseen. */
static inline double point_gap2(const svoi_box *b, const int32_t p[3])
{
    int64_t sum = 0;
    for (int k = 0; k < 3; k++) {
        const int64_t before = (int64_t)b->low[k] - p[k], behind = (int64_t)p[k] - b->high[k], d = before > behind ? before : behind;
        sum += d > 0 ? d * d : 0;
    }
    return (double)sum;
}

/* INFINITY when its box is farther away than `most` (squared). Never less than its box is away, whatever was rounded, so that what is nearest does not
 * depend on the order in which triangles are looked at. */
static double distance_to(const svoi_triangle *t, const int32_t p[3], double most, double barycentric[3])
{
    double v[3][3];
    svoi_box box;
    svoi_triangle_box((const int32_t(*)[3])t->q, &box);
    const double least = point_gap2(&box, p);
    if (least > most) return INFINITY;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) v[i][k] = (double)t->q[i][k] - p[k];
    const double d = nearest_on(v, barycentric);
    return d > least ? d : least;
}

static void nearest_in(const svo_winding *w, uint32_t class, const int32_t p[3], double *best, svo_winding_hit *hit, double barycentric[3])
{
    const svoi_bounds_tree *t = &w->tree[class];
    svoi_tree_node stack[SVOI_TREE_STACK];
    double bound[SVOI_TREE_STACK];
    uint32_t top = 0;
    bound[top] = 0;
    stack[top++] = (svoi_tree_node){t->levels - 1, 0};
    while (top != 0) {
        svoi_tree_node n = stack[--top];
        if (bound[top] > *best) continue;
        if (n.level != 0) {
            svoi_tree_node child[2];
            double d[2];
            uint32_t count = svoi_node_children(t, n, child);
            for (uint32_t i = 0; i < count; i++) d[i] = point_gap2(svoi_node_box(t, child[i]), p);
            uint32_t far = count == 2 && d[1] > d[0] ? 1 : 0; /* the nearer one is looked at first */
            for (uint32_t i = 0; i < count; i++) {
                uint32_t c = i == 0 ? far : far ^ 1;
                if (d[c] > *best) continue;
                bound[top] = d[c];
                stack[top++] = child[c];
            }
            continue;
        }
        uint64_t begin, end;
        svoi_leaf_items(t, n, &begin, &end);
        for (; begin < end; begin++) {
            const svoi_triangle *triangle = svoi_at(&w->triangles[class], begin);
            double b[3], d = distance_to(triangle, p, *best, b);
            if (d > *best || (d == *best && (class != hit->part ? class > hit->part : begin >= hit->at))) continue;
            *best = d;
            *hit = (svo_winding_hit){triangle->number, class, begin};
            memcpy(barycentric, b, sizeof b);
        }
    }
}

bool svo_winding_nearest(const svo_winding *w, const int32_t p[3], svo_winding_hit *hit, double barycentric[3])
{
    double best = INFINITY;
    if (hit->triangle != UINT32_MAX) best = distance_to(svoi_at(&w->triangles[hit->part], hit->at), p, INFINITY, barycentric);
    for (uint32_t c = 0; c < SVOI_CLASSES; c++)
        if (w->tree[c].count != 0) nearest_in(w, c, p, &best, hit, barycentric);
    if (hit->triangle == UINT32_MAX) return false;
    const uint32_t turned = ((const svoi_triangle *)svoi_at(&w->triangles[hit->part], hit->at))->turned;
    if (turned & 1) {
        const double swap = barycentric[1];
        barycentric[1] = barycentric[2];
        barycentric[2] = swap;
    }
    const double own[3] = {barycentric[0], barycentric[1], barycentric[2]};
    for (uint32_t k = 0; k < 3; k++) barycentric[((turned >> 1) + k) % 3] = own[k];
    return true;
}
