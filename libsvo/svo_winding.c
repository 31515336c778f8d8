/* Is a point inside? Crossings of a ray, solid angles, hierarchical winding numbers. */
#include <math.h>

#include "svoi_winding.h"

__extension__ typedef __int128 wide;

/* --- closed parts: crossings of a ray ----------------------------------------------------------------------------- */

int svoi_side_of(const int32_t a[3], const int32_t b[3], const int32_t p[3])
{
    int64_t dx = (int64_t)b[0] - a[0], dy = (int64_t)b[1] - a[1];
    int64_t e = dx * ((int64_t)p[1] - a[1]) - dy * ((int64_t)p[0] - a[0]);
    if (e != 0) return e > 0 ? 1 : -1;
    if (dy != 0) return dy > 0 ? -1 : 1;
    return dx > 0 ? 1 : dx < 0 ? -1 : 0;
}

/* 1 or -1 when the ray from p along +z leaves or enters through the triangle, else 0. */
static int crossing(const int32_t (*q)[3], const int32_t p[3])
{
    int side = svoi_side_of(q[0], q[1], p);
    if (side == 0 || svoi_side_of(q[1], q[2], p) != side || svoi_side_of(q[2], q[0], p) != side) return 0;
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
static int64_t crossings(const svo_winding *w, int class, const int32_t p[3], uint64_t *number)
{
    const svoi_bounds_tree *t = &w->tree[class];
    int64_t sum = 0;
    *number = 0;
    if (t->count == 0) return 0;
    svoi_tree_node stack[SVOI_TREE_STACK];
    uint32_t top = 0;
    stack[top++] = (svoi_tree_node){t->levels - 1, 0};
    while (top != 0) {
        svoi_tree_node n = stack[--top];
        const svoi_box *b = svoi_node_box(t, n);
        /* the moved point may be inside where p lies on the lower side */
        if (p[0] < b->low[0] || p[0] > b->high[0] || p[1] < b->low[1] || p[1] > b->high[1] || p[2] > b->high[2]) continue;
        if (n.level != 0) {
            top += svoi_node_children(t, n, &stack[top]);
            continue;
        }
        uint64_t begin, end;
        svoi_leaf_items(t, n, &begin, &end);
        for (; begin < end; begin++) {
            const svoi_triangle *triangle = svoi_at(&w->triangles[class], begin);
            const int c = crossing((const int32_t(*)[3])triangle->q, p);
            sum += c;
            *number += c != 0;
        }
    }
    return sum;
}

/* --- open parts: hierarchical winding numbers --------------------------------------------------------------------- */

/* Solid angle of a triangle over 4 pi (van Oosterom and Strackee 1983). */
static double solid_angle(const int32_t (*q)[3], const int32_t p[3])
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
        const svoi_boundary_edge *e = svoi_at(&w->boundary, i);
        double a[3], b[3], dot_ab = 0, aa = 0, bb = 0;
        int64_t ax = (int64_t)e->a[0] - p[0], ay = (int64_t)e->a[1] - p[1], bx = (int64_t)e->b[0] - p[0], by = (int64_t)e->b[1] - p[1];
        for (int k = 0; k < 3; k++) {
            a[k] = (double)e->a[k] - p[k], b[k] = (double)e->b[k] - p[k];
            dot_ab += a[k] * b[k], aa += a[k] * a[k], bb += b[k] * b[k];
        }
        double la = sqrt(aa), lb = sqrt(bb);
        /* the triangle b, a, infinity; where the point is in the curtain's plane the side decides that the ray's rule has it on */
        double up = (double)(ax * by - ay * bx), across = la * lb + dot_ab - a[2] * lb - b[2] * la;
        if (bx * ay == by * ax) up = svoi_side_of(e->a, e->b, p) > 0 ? 0.0 : -0.0;
        sum += e->times * atan2(up, across);
    }
    return (double)crossings(w, SVOI_OPEN, p, &number) - 2 * sum / SVOI_FOUR_PI;
}

double svoi_open_crossings(const svo_winding *w, const int32_t p[3])
{
    uint64_t number;
    return (double)crossings(w, SVOI_OPEN, p, &number);
}

static double open_winding(const svo_winding *w, const int32_t p[3])
{
    const svoi_bounds_tree *t = &w->tree[SVOI_OPEN];
    double sum = 0;
    if (t->count == 0) return 0;
    if (w->moments.data == NULL) return curtain_winding(w, p);
    svoi_tree_node stack[SVOI_TREE_STACK];
    uint32_t top = 0;
    stack[top++] = (svoi_tree_node){t->levels - 1, 0};
    while (top != 0) {
        svoi_tree_node n = stack[--top];
        const svoi_moment *m = svoi_at(&w->moments, svoi_node_number(t, n));
        double d[3] = {m->centre[0] - p[0], m->centre[1] - p[1], m->centre[2] - p[2]};
        double r2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2], reach = SVOI_ACCEPT * (double)m->radius;
        if (r2 > reach * reach) {
            double inverse = 1 / r2, r3 = inverse / sqrt(r2);
            double quadratic = (double)m->symmetric[0] * d[0] * d[0] + (double)m->symmetric[1] * d[1] * d[1] + (double)m->symmetric[2] * d[2] * d[2] +
                               (double)m->symmetric[3] * d[0] * d[1] + (double)m->symmetric[4] * d[0] * d[2] + (double)m->symmetric[5] * d[1] * d[2];
            sum += r3 * (m->normal[0] * d[0] + m->normal[1] * d[1] + m->normal[2] * d[2] + (double)m->trace - 3 * quadratic * inverse) / SVOI_FOUR_PI;
        } else if (n.level != 0) {
            top += svoi_node_children(t, n, &stack[top]);
        } else {
            uint64_t begin, end;
            svoi_leaf_items(t, n, &begin, &end);
            for (; begin < end; begin++) {
                const svoi_triangle *triangle = svoi_at(&w->triangles[SVOI_OPEN], begin);
                sum += solid_angle((const int32_t(*)[3])triangle->q, p);
            }
        }
    }
    return sum;
}

bool svoi_winding_verdict(const svo_winding *w, const int32_t p[3], double open, double *margin)
{
    uint64_t number;
    int64_t oriented = crossings(w, SVOI_ORIENTED, p, &number);
    const double total = (double)oriented + open;
    bool inside;
    if (oriented < 0) { /* inside where the total is beyond 1/2 either way */
        inside = fabs(total) > 0.5;
        *margin = fabs(fabs(total) - 0.5);
    } else {
        inside = total > 0.5;
        *margin = fabs(total - 0.5);
    }
    crossings(w, SVOI_EVEN, p, &number);
    if (number % 2 != 0) {
        inside = true;
        *margin = 1;
    }
    return inside;
}

bool svo_winding_inside(const svo_winding *w, const int32_t p[3], double *margin) { return svoi_winding_verdict(w, p, open_winding(w, p), margin); }
