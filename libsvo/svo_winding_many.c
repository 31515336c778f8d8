/* Winding numbers of the voxels of a brick together: one way through the tree for all of them, and loops over points. Angles are not added but
 * their complex numbers multiplied, so that there is one arc tangent a point and not one a triangle. */
#include <math.h>

#include "svoi_winding.h"

enum { MOST_TIMES = 4 }; /* uses of an edge that are multiplied one by one */

/* Points as arrays, and for each the product of what stands for half the solid angles: its argument is their sum less `turns` full turns. */
typedef struct batch {
    uint32_t count;
    double at[3][SVO_WINDING_MANY], sum[SVO_WINDING_MANY], re[SVO_WINDING_MANY], im[SVO_WINDING_MANY], turns[SVO_WINDING_MANY];
    double low[3], high[3]; /* of the points */
} batch;

/* Multiply with re + i im, whose argument is in -pi .. pi; a sum beyond that is a turn. */
static inline void multiply(batch *b, uint32_t i, double re, double im)
{
    const double x = b->re[i] * re - b->im[i] * im, y = b->re[i] * im + b->im[i] * re;
    const double up = b->im[i] >= 0 && im >= 0 && y < 0 ? 1.0 : 0.0, down = b->im[i] < 0 && im < 0 && y >= 0 ? 1.0 : 0.0;
    const double size = fabs(x) + fabs(y), scale = size > 0 ? 1 / size : 0;
    b->turns[i] += up - down;
    b->re[i] = size > 0 ? x * scale : 1;
    b->im[i] = y * scale;
}

static void far_node(batch *b, const svoi_moment *m)
{
    const double nx = m->normal[0], ny = m->normal[1], nz = m->normal[2], trace = (double)m->trace;
    const double xx = (double)m->symmetric[0], yy = (double)m->symmetric[1], zz = (double)m->symmetric[2], xy = (double)m->symmetric[3], xz = (double)m->symmetric[4], yz = (double)m->symmetric[5];
    for (uint32_t i = 0; i < b->count; i++) {
        const double x = m->centre[0] - b->at[0][i], y = m->centre[1] - b->at[1][i], z = m->centre[2] - b->at[2][i];
        const double inverse = 1 / (x * x + y * y + z * z), r3 = inverse * sqrt(inverse);
        const double quadratic = xx * x * x + yy * y * y + zz * z * z + xy * x * y + xz * x * z + yz * y * z;
        b->sum[i] += r3 * (nx * x + ny * y + nz * z + trace - 3 * quadratic * inverse);
    }
}

static void near_triangle(batch *b, const int32_t (*q)[3])
{
    for (uint32_t i = 0; i < b->count; i++) {
        const double px = b->at[0][i], py = b->at[1][i], pz = b->at[2][i];
        const double ax = q[0][0] - px, ay = q[0][1] - py, az = q[0][2] - pz, bx = q[1][0] - px, by = q[1][1] - py, bz = q[1][2] - pz, cx = q[2][0] - px, cy = q[2][1] - py, cz = q[2][2] - pz;
        const double a = sqrt(ax * ax + ay * ay + az * az), l = sqrt(bx * bx + by * by + bz * bz), c = sqrt(cx * cx + cy * cy + cz * cz);
        const double det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx);
        const double den = a * l * c + (ax * bx + ay * by + az * bz) * c + (bx * cx + by * cy + bz * cz) * a + (cx * ax + cy * ay + cz * az) * l;
        multiply(b, i, den, det);
    }
}

/* At least how far (squared) the points are from a place. */
static double away2(const batch *b, const double from[3])
{
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        const double d = fmax(fmax(b->low[k] - from[k], from[k] - b->high[k]), 0);
        sum += d * d;
    }
    return sum;
}

static void hierarchy(const svo_winding *w, batch *b)
{
    const svoi_bounds_tree *t = &w->tree[SVOI_OPEN];
    svoi_tree_node stack[SVOI_TREE_STACK];
    uint32_t top = 0;
    stack[top++] = (svoi_tree_node){t->levels - 1, 0};
    while (top != 0) {
        const svoi_tree_node n = stack[--top];
        const svoi_moment *m = svoi_at(&w->moments, svoi_node_number(t, n));
        const double reach = SVOI_ACCEPT * (double)m->radius;
        if (away2(b, m->centre) > reach * reach) {
            far_node(b, m);
        } else if (n.level != 0) {
            top += svoi_node_children(t, n, &stack[top]);
        } else {
            uint64_t begin, end;
            for (svoi_leaf_items(t, n, &begin, &end); begin < end; begin++) near_triangle(b, (const int32_t(*)[3])((const svoi_triangle *)svoi_at(&w->triangles[SVOI_OPEN], begin))->q);
        }
    }
}

/* Solid angles of the curtains below the boundary (see curtain_winding). A point in a curtain's plane is on the side that the ray's rule has it on. */
static void curtains(const svo_winding *w, batch *b, const int32_t (*p)[3])
{
    for (uint64_t n = 0; n < w->boundary_count; n++) {
        const svoi_boundary_edge *e = svoi_at(&w->boundary, n);
        double up[SVO_WINDING_MANY], across[SVO_WINDING_MANY];
        for (uint32_t i = 0; i < b->count; i++) {
            const double ax = e->a[0] - b->at[0][i], ay = e->a[1] - b->at[1][i], az = e->a[2] - b->at[2][i], bx = e->b[0] - b->at[0][i], by = e->b[1] - b->at[1][i], bz = e->b[2] - b->at[2][i];
            const double la = sqrt(ax * ax + ay * ay + az * az), lb = sqrt(bx * bx + by * by + bz * bz);
            up[i] = ax * by - ay * bx;
            across[i] = la * lb + (ax * bx + ay * by + az * bz) - az * lb - bz * la;
        }
        for (uint32_t i = 0; i < b->count; i++)
            if (up[i] == 0) up[i] = svoi_side_of(e->a, e->b, p[i]) > 0 ? 1e-30 : -1e-30;
        for (uint32_t k = 0; k < e->times && k < MOST_TIMES; k++)
            for (uint32_t i = 0; i < b->count; i++) multiply(b, i, across[i], up[i]);
        for (uint32_t i = 0; e->times > MOST_TIMES && i < b->count; i++) b->sum[i] += 2 * (double)(e->times - MOST_TIMES) * atan2(up[i], across[i]);
    }
}

void svo_winding_inside_many(const svo_winding *w, const int32_t (*p)[3], uint32_t count, bool *inside, double *margin)
{
    SVO_ASSERT(count <= SVO_WINDING_MANY);
    if (w->tree[SVOI_OPEN].count == 0) {
        for (uint32_t i = 0; i < count; i++) inside[i] = svo_winding_inside(w, p[i], &margin[i]);
        return;
    }
    batch b = {.count = count};
    for (uint32_t i = 0; i < count; i++) {
        b.re[i] = 1;
        for (int k = 0; k < 3; k++) {
            b.at[k][i] = p[i][k];
            if (i == 0 || b.at[k][i] < b.low[k]) b.low[k] = b.at[k][i];
            if (i == 0 || b.at[k][i] > b.high[k]) b.high[k] = b.at[k][i];
        }
    }
    const bool few = w->moments.data == NULL;
    if (few) curtains(w, &b, p);
    else hierarchy(w, &b);
    for (uint32_t i = 0; i < count; i++) {
        double open = (b.sum[i] + 2 * atan2(b.im[i], b.re[i])) / SVOI_FOUR_PI + b.turns[i]; /* a turn of half a solid angle is a winding number of 1 */
        if (few) open = svoi_open_crossings(w, p[i]) - open;
        inside[i] = svoi_winding_verdict(w, p[i], open, &margin[i]);
    }
}
