/* Weighted sums over balls of a fixed radius: the one neighbour query of the contraction (equation 5.4.2), through FLANN or through a grid.
 *
 * Points lie on a lattice: coordinate = integer * 2^-24, |integer| < 2^24. So 32-bit floats hold them exactly, sums of
 * weight * coordinate are exact in 64-bit integers, and the result depends neither on the order of summation nor on the number of
 * threads nor on the search structure: both backends give the same bits. The squared distance of two points is the 32-bit float
 * (dx*dx + dy*dy) + dz*dz of float differences (as flann::L2_Simple<float> computes it), and a point is inside
 * when that is less than the squared radius as a float. */
#ifndef SKEL_RADIUS_H
#define SKEL_RADIUS_H

#include "svo_alloc.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SKEL_LATTICE 16777216 /* 2^24 steps a unit */

/* Sum over the ball of one point. It contains the point itself, so weight >= its weight. */
typedef struct skel_ball_sum {
    int64_t x, y, z;  /* sum of weight * coordinate, in lattice steps */
    int64_t weight;   /* sum of weights */
} skel_ball_sum;

/* FLANN's exact single-tree index, kept from call to call for points that move: neighbour lists with a skin (Verlet 1967) serve as long as few points have moved farther than half of it. The sums are
 * those of skel_radius_flann, whatever came before. One call at a time; after an error only skel_flann_close. */
typedef struct skel_flann skel_flann;
/* radius in units, > 0; threads (0 = all processors) share each call; *out is the caller's, who closes it. Errors: SVO_OUT_OF_MEMORY. */
svo_result skel_flann_open(double radius, uint32_t threads, skel_flann **out, svo_error *err);
/* points: 3 * count lattice coordinates; weights: count, each 1 .. 2^31 - 1, their sum below 2^38; doublings: how often the radius of each point's ball is doubled, 0 .. 7 (NULL: never);
 * count < 2^31; out: count. All are the caller's and used during the call alone. moved: point i is that of the call before (welded since, where they were), with the doublings it had, and may lie elsewhere.
 * Errors: SVO_OUT_OF_MEMORY, SVO_LIMIT (count), SVO_RUNTIME (an exception of the library). */
svo_result skel_flann_sums(skel_flann *f, const int32_t *points, const uint32_t *weights, const uint8_t *doublings, uint64_t count, bool moved, skel_ball_sum *out, svo_error *err);
/* Between two calls: points are welded, i to label[i] < count, each number at least once; the next call has `count` points, whose weights are stated anew. Linear in points and lists.
 * Errors: SVO_OUT_OF_MEMORY. */
svo_result skel_flann_weld(skel_flann *f, const uint32_t *label, uint32_t count, svo_error *err);
void skel_flann_close(skel_flann *f); /* NULL is fine */

/* One call, with points of which nothing is known: arguments and errors are those of the above. */
svo_result skel_radius_flann(const int32_t *points, const uint32_t *weights, const uint8_t *doublings, uint64_t count, double radius, uint32_t threads,
                             skel_ball_sum *out, svo_error *err);

/* The same through a grid with cells of the radius (brute force for few points). Scratch memory from `a`. */
svo_result skel_radius_grid(const svo_allocator *a, const int32_t *points, const uint32_t *weights, const uint8_t *doublings, uint64_t count, double radius,
                            uint32_t threads, skel_ball_sum *out, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
