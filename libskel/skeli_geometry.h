/* Inside libskel: small geometry that several files share. */
#ifndef SKELI_GEOMETRY_H
#define SKELI_GEOMETRY_H

#include <math.h>

/* Distance of two points in lattice steps. */
static inline double skeli_apart(const double a[3], const double b[3])
{
    double x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2];
    return sqrt(x * x + y * y + z * z);
}

/* The same in the model's coordinates, whose squares may overflow. */
static inline double skeli_apart_far(const double a[3], const double b[3]) { return hypot(hypot(b[0] - a[0], b[1] - a[1]), b[2] - a[2]); }

/* Unit vectors u, v that are perpendicular to d (a unit vector) and to each other. */
static inline void skeli_across(const double d[3], double u[3], double v[3])
{
    int least = fabs(d[0]) <= fabs(d[1]) && fabs(d[0]) <= fabs(d[2]) ? 0 : fabs(d[1]) <= fabs(d[2]) ? 1 : 2;
    double length = 0;
    for (int k = 0; k < 3; k++) {
        u[k] = (k == least) - d[least] * d[k];
        length += u[k] * u[k];
    }
    length = sqrt(length);
    for (int k = 0; k < 3; k++) u[k] /= length;
    for (int k = 0; k < 3; k++) v[k] = d[(k + 1) % 3] * u[(k + 2) % 3] - d[(k + 2) % 3] * u[(k + 1) % 3];
}

/* Cosine and sine of 0, 15, .. 345 degrees. Written out, since sin and cos may differ in their last bits from one C library, or processor, to the next. */
enum { SKELI_CIRCLE = 24 };
static const double skeli_circle[SKELI_CIRCLE][2] = {
    {1, 0}, {0.96592582628906829, 0.25881904510252076}, {0.86602540378443865, 0.5},
    {0.70710678118654752, 0.70710678118654752}, {0.5, 0.86602540378443865}, {0.25881904510252076, 0.96592582628906829},
    {0, 1}, {-0.25881904510252076, 0.96592582628906829}, {-0.5, 0.86602540378443865},
    {-0.70710678118654752, 0.70710678118654752}, {-0.86602540378443865, 0.5}, {-0.96592582628906829, 0.25881904510252076},
    {-1, 0}, {-0.96592582628906829, -0.25881904510252076}, {-0.86602540378443865, -0.5},
    {-0.70710678118654752, -0.70710678118654752}, {-0.5, -0.86602540378443865}, {-0.25881904510252076, -0.96592582628906829},
    {0, -1}, {0.25881904510252076, -0.96592582628906829}, {0.5, -0.86602540378443865},
    {0.70710678118654752, -0.70710678118654752}, {0.86602540378443865, -0.5}, {0.96592582628906829, -0.25881904510252076}};

#endif
