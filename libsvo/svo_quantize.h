/* Reducing values within a measured error: colours by clustering in CIELAB (Dado et al. 2016, section 2.4.3),
 * normals by octahedral grids, both by number of bits or by a bound that every value keeps. */
#ifndef SVO_QUANTIZE_H
#define SVO_QUANTIZE_H

#include "svo_dag.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Measured on the decoded values against the originals, weighted by how often each value occurs. */
typedef struct svo_quantize_result {
    bool lossy; /* something was mapped to another value */
    double error_mean, error_max; /* CIE94 with the original as reference, or degrees */
} svo_quantize_result;

/* Map `count` distinct values (little-endian bytes as u32), ascending, which occur `times` each, to the values that are
 * kept. Kinds or options without reduction map each value to itself. The result does not depend on threads.
 * With options->color_bits at most 2^bits different values remain; with color_delta_e no colour is farther than that
 * from what it became; with normal_bits or normal_degrees the same for normals (degrees). */
svo_result svo_quantize(svo_channel_kind kind, const uint32_t *values, const uint64_t *times, uint64_t count,
                        const svo_dag_options *options, const svo_allocator *a, uint32_t *mapped, svo_quantize_result *result,
                        svo_error *err);

/* A normal on the octahedral grid of bits / 2 a component: the grid point nearest in angle of the four around it. */
uint32_t svo_quantize_normal(uint32_t value, uint32_t bits);
/* Angle between two stored normals, degrees. */
double svo_normal_degrees(uint32_t a, uint32_t b);

#ifdef __cplusplus
}
#endif
#endif
