/* Area, centroid and central second moments of a polygon in double precision: what pieces of triangles in voxels are held against. */
#ifndef POLYGON_MOMENTS_H
#define POLYGON_MOMENTS_H

#include <math.h>

#include "svo_shade.h"

typedef struct exact { double area, x, y, xx, xy, yy; } exact;

/* On axes i and j. Nothing where the area is below 5e-10. */
static inline exact of_polygon(const svo_polygon *p, uint32_t i, uint32_t j)
{
    exact e = {0, 0, 0, 0, 0, 0};
    for (uint32_t k = 2; k < p->count; k++) {
        double ax = p->at[k - 1][i] - p->at[0][i], ay = p->at[k - 1][j] - p->at[0][j], bx = p->at[k][i] - p->at[0][i], by = p->at[k][j] - p->at[0][j];
        double cross = ax * by - ay * bx;
        e.area += cross;
        e.x += cross * (ax + bx), e.y += cross * (ay + by);
        e.xx += cross * (ax * ax + ax * bx + bx * bx), e.yy += cross * (ay * ay + ay * by + by * by);
        e.xy += cross * (2 * ax * ay + ax * by + bx * ay + 2 * bx * by) / 2;
    }
    if (fabs(e.area) < 1e-9) return (exact){0, 0, 0, 0, 0, 0};
    e.x /= 3 * e.area, e.y /= 3 * e.area;
    e.xx = e.xx / (6 * e.area) - e.x * e.x, e.xy = e.xy / (6 * e.area) - e.x * e.y, e.yy = e.yy / (6 * e.area) - e.y * e.y;
    e.x += p->at[0][i], e.y += p->at[0][j];
    e.area = fabs(e.area) / 2;
    return e;
}

#endif
