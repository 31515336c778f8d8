/* Boxes in a picture, and a buffer of depths with its pyramid of maxima (Willcocks 2013, 3.2.6 and 3.2.7). */
#ifndef SVOI_SELECT_H
#define SVOI_SELECT_H

#include <math.h>

#include "svo_select.h"

/* How a picture is seen; positions are relative to the eye. */
typedef struct svoi_look {
    double axis[3][3];  /* right, up, forward */
    double plane[4][3]; /* of the picture's sides, inside positive */
    double focal;       /* samples at depth 1 */
    uint32_t width, height;
} svoi_look;
svoi_look svoi_look_make(const svo_eye *eye, uint32_t width, uint32_t height);

/* Rectangle of a box in samples; `near` is its least depth. Infinite for a box that reaches behind the eye's plane. */
typedef struct svoi_rect { double x0, y0, x1, y1, near, far; } svoi_rect;
svoi_rect svoi_project(const svoi_look *look, const double low[3], const double high[3]);
/* Is all of the box beyond one side of the picture? */
bool svoi_outside(const svoi_look *look, const double low[3], const double high[3]);

/* Samples whose middles a rectangle holds: [x0, x1) x [y0, y1), empty where x0 >= x1 or y0 >= y1. */
typedef struct svoi_span { uint32_t x0, y0, x1, y1; } svoi_span;
static inline uint32_t svoi_clamped(double x, uint32_t most) { return x > 0 ? x < most ? (uint32_t)x : most : 0; } /* not a number: 0 */
static inline svoi_span svoi_samples(const svoi_look *l, const svoi_rect *r)
{
    svoi_span s;
    /* (a little wider, for the rounding of the projection) */
    double e = 1e-6;
    s.x0 = svoi_clamped(ceil(r->x0 - 0.5 - e), l->width), s.y0 = svoi_clamped(ceil(r->y0 - 0.5 - e), l->height);
    s.x1 = svoi_clamped(floor(r->x1 - 0.5 + e) + 1, l->width), s.y1 = svoi_clamped(floor(r->y1 - 0.5 + e) + 1, l->height);
    return s;
}

/* Calls hit(user, x, y, depth, leave) for the samples whose rays meet the box, with the depths at which they enter and leave it. Behind the eye's plane nothing
 * is met; an eye inside a box meets it at depth 0. */
typedef void (*svoi_sample_fn)(void *user, uint32_t x, uint32_t y, float depth, float leave);
void svoi_draw_box_rows(const svoi_look *look, const float low[3], const float high[3], uint32_t begin, uint32_t end, svoi_sample_fn hit, void *user); /* rows [begin, end) */
void svoi_draw_box(const svoi_look *look, const float low[3], const float high[3], svoi_sample_fn hit, void *user);
void svoi_draw_span(const svoi_look *look, const double low[3], const double high[3], const svoi_span *s, svoi_sample_fn hit, void *user); /* of its samples, those in *s */

extern const uint8_t svoi_covers; /* coverage of a voxel that hides what is behind it */
/* For each asset the number of its channel with this name and kind, SVO_MAX_CHANNELS where it has none, or one that is `plain` (NULL: any) everywhere. Freed by the
 * caller, scene->asset_count; NULL without memory (or assets). *any: does one have it? */
uint32_t *svoi_find_channels(const svo_scene *scene, const char *name, svo_channel_kind kind, const uint8_t *plain, const svo_allocator *a, bool *any);

/* Of two boxes as depth's bits and number (UINT64_MAX: none), the nearer one; of equal depths the one whose instance, attribute and place come first. Numbers depend on what is culled, these do not. */
bool svoi_is_nearer(const svo_selection *s, uint64_t a, uint64_t b);
static inline void svoi_set_nearest(const svo_selection *s, uint64_t *to, uint64_t mine)
{
    uint64_t old = __atomic_load_n(to, __ATOMIC_RELAXED);
    while (svoi_is_nearer(s, mine, old) && !__atomic_compare_exchange_n(to, &old, mine, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) continue;
}

/* The nearest box of each sample by mipmaps: depth's bits, then the number of the box; UINT64_MAX, which all are set to before, where there is none. cover: of each box, those that do
 * not hide what is behind them are left out; NULL: none. */
svo_result svoi_draw_mipmap(const svo_selection *s, const uint8_t *cover, const svoi_look *look, uint32_t threads, const svo_allocator *a, uint64_t *nearest, svo_error *err);

/* (*out)[i] is 1 where an earlier instance has the same asset, place and pose, so that i can never be seen. Freed by the caller: one byte an instance. */
svo_result svoi_find_copies(const svo_scene *s, const svo_allocator *a, uint8_t **out, svo_error *err);

enum { SVOI_DEPTH_LEVELS = 18 };
typedef struct svoi_depth {
    const svo_allocator *allocator;
    uint32_t width, height, levels;
    uint32_t *nearest; /* bits of the depth of each sample, written by several threads at once */
    float *level[SVOI_DEPTH_LEVELS]; /* [l]: maxima over 2^l * 2^l samples, l >= 1 */
} svoi_depth;
svo_result svoi_depth_make(svoi_depth *d, uint32_t width, uint32_t height, const svo_allocator *a, svo_error *err);
void svoi_depth_free(svoi_depth *d);
void svoi_depth_add(void *depth, uint32_t x, uint32_t y, float at, float leave); /* a svoi_sample_fn */
void svoi_depth_update(svoi_depth *d);
/* Is every sample of the span nearer than `near`, as of the last update? True for an empty span. */
bool svoi_depth_hides(const svoi_depth *d, const svoi_span *s, double near);

#endif
