/* Internal: values as points in which errors are measured, and the nearest entries of a table. Not installed.
 *
 * Colours: L*, a*, b* and the chroma; CIE94 of a reference with weights wh, wd is dL^2 + wh (da^2 + db^2) + wd dC^2.
 * Normals: unit vectors * 180 / pi, so that a chord is nearly the angle in degrees. All in single precision; a bound is
 * lowered by more than that can be wrong. */
#ifndef SVOI_POINTS_H
#define SVOI_POINTS_H

#include "svoi_palette.h"

typedef struct svoi_point { float x[4]; } svoi_point;
typedef struct svoi_weights { float wh, wd; } svoi_weights;

typedef struct svoi_points {
    svo_channel_kind kind;
    bool squares;        /* costs are squared differences of sRGB bytes, the bound is in CIE94 */
    float bound2;        /* squared */
    float price;         /* bits a unit of cost */
    float cell, per_cell; /* edge of the cells of svoi_near; 1 / edge */
    svoi_point *table;   /* where costs are measured */
    svoi_point *check;   /* where the bound is measured: `table` but with squares */
    uint32_t *order;     /* of the table by x[0] */
    float *sorted[3];    /* components in this order, with SVOI_NEAR_STEP infinitely far ones before and behind */
    uint64_t count;
} svoi_points;

svoi_point svoi_point_of(svo_channel_kind kind, bool rgb, uint32_t value);
svoi_weights svoi_weights_of(svo_channel_kind kind, bool rgb, const svoi_point *p);

static inline float svoi_distance2(const svoi_point *p, svoi_weights w, const svoi_point *q)
{
    float a = p->x[0] - q->x[0], b = p->x[1] - q->x[1], c = p->x[2] - q->x[2], d = p->x[3] - q->x[3];
    return a * a + w.wh * (b * b + c * c) + w.wd * (d * d);
}

/* What was found for a cell; a pure function of the cell, so each worker may have its own. */
enum { SVOI_NEAR = 4, SVOI_NEAR_STEP = 8, SVOI_NEAR_BITS = 14 };
typedef struct svoi_near_cell { uint64_t key; uint16_t entry[SVOI_NEAR]; } svoi_near_cell; /* tables have fewer than 2^16 entries here */
typedef struct svoi_near_cache { svoi_near_cell cell[1 << SVOI_NEAR_BITS]; } svoi_near_cache;

/* An entry of the table (which is not empty) that is near `p`. x[3] of p may be anything. */
uint32_t svoi_near(const svoi_points *t, svoi_near_cache *cache, const float p[3]);

#endif
