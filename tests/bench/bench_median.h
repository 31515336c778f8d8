/* Medians of repeated measurements. */
#ifndef BENCH_MEDIAN_H
#define BENCH_MEDIAN_H

#include <stdlib.h>

static int bench_compare_doubles(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Of n > 0 figures, which it sorts. */
static double bench_median(double *of, int n)
{
    qsort(of, (size_t)n, sizeof *of, bench_compare_doubles);
    return n % 2 != 0 ? of[n / 2] : 0.5 * (of[n / 2 - 1] + of[n / 2]);
}

#endif
