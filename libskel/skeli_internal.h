/* Inside libskel: scratch memory, the canonical triangle soup, the contraction's state, and the steps of the pipeline. */
#ifndef SKELI_INTERNAL_H
#define SKELI_INTERNAL_H

#include "skel_build.h"
#include "skel_radius.h"

/* --- scratch memory: blocks that are freed together -------------------------------------------------------------- */
enum { SKELI_POOL_BLOCKS = 96 };
typedef struct skeli_pool {
    const svo_allocator *allocator;
    uint32_t count;
    struct { void *data; uint64_t count; size_t size; } block[SKELI_POOL_BLOCKS];
} skeli_pool;
/* A block of count (at least 1 is taken) elements, NULL when out of memory. */
void *skeli_take(skeli_pool *p, uint64_t count, size_t size);
void skeli_give(skeli_pool *p, void *data); /* free one block early; NULL is fine */
void skeli_pool_free(skeli_pool *p);
svo_result skeli_no_memory(svo_error *err);

/* --- linear-time sorting ------------------------------------------------------------------------------------------ */
/* Stable sort of `order` (count indices) by key[order[i]] of `bits` significant bits; `scratch` has count elements. */
void skeli_sort_by64(uint32_t *order, uint32_t *scratch, uint64_t count, const uint64_t *key, uint32_t bits);
/* Sort tuples of `width` (2 or 3) numbers below n in lexicographic order and drop duplicates; returns how many are left.
 * scratch: width * count, bucket: n + 1. */
uint64_t skeli_sort_unique(uint32_t *tuples, uint64_t count, uint32_t width, uint32_t n, uint32_t *scratch, uint32_t *bucket);

/* --- triangle soup on the lattice --------------------------------------------------------------------------------- */
/* Canonical: vertices are distinct and in Morton order, corners of a triangle ascend, triangles are sorted and distinct, so
 * nothing later depends on how the file numbered or shared them. A triangle may have two equal corners (an edge), not three.
 * Vertices without a triangle occur only where there is no triangle at all. */
typedef struct skeli_soup {
    uint32_t vertex_count, triangle_count;
    int32_t *position; /* 3 each, lattice steps */
    uint32_t *corner;  /* 3 each */
} skeli_soup;

/* Make a soup of any points and triangles on the lattice; arrays are taken from the pool. remap (length `points`) tells where
 * each point went, SVO_NONE for points without a triangle. Counts triangles dropped because all corners meet. */
svo_result skeli_canonical(skeli_pool *pool, const int32_t *position, uint64_t points, const uint32_t *corner, uint64_t triangles,
                           skeli_soup *out, uint32_t *remap, uint64_t *point_triangles, svo_error *err);

/* Normalisation of points (3 doubles each, all finite): centre and unit. */
svo_result skeli_normalization(const double *position, uint64_t count, skel_normalize how, double centre[3], double *unit, svo_error *err);

/* Points and triangles in model coordinates to a canonical soup; fills the counts of the report. remap as above. */
svo_result skeli_soup_make(skeli_pool *pool, const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles,
                           skel_report *report, skeli_soup *out, uint32_t *remap, svo_error *err);

/* Split edges until all are shorter than omega (lattice steps), conforming; then canonical again. moved[i] is where vertex i
 * of `in` went. */
svo_result skeli_tessellate(skeli_pool *pool, const skeli_soup *in, double omega, uint64_t max_vertices, skeli_soup *out, uint32_t *moved,
                            svo_error *err);

static inline double skeli_area(const double *a, const double *b, const double *c)
{
    double u[3], v[3];
    for (int k = 0; k < 3; k++) {
        u[k] = b[k] - a[k];
        v[k] = c[k] - a[k];
    }
    double x = u[1] * v[2] - u[2] * v[1], y = u[2] * v[0] - u[0] * v[2], z = u[0] * v[1] - u[1] * v[0];
    return 0.5 * __builtin_sqrt(x * x + y * y + z * z);
}
static inline void skeli_sort3(uint32_t *t)
{
    uint32_t x;
    if (t[0] > t[1]) { x = t[0]; t[0] = t[1]; t[1] = x; }
    if (t[1] > t[2]) { x = t[1]; t[1] = t[2]; t[2] = x; }
    if (t[0] > t[1]) { x = t[0]; t[0] = t[1]; t[1] = x; }
}
static inline uint64_t skeli_hash3(const uint32_t *t)
{
    uint64_t h = (t[0] * 0x9e3779b97f4a7c15ull ^ t[1]) * 0xc2b2ae3d27d4eb4full ^ t[2];
    h *= 0x165667b19e3779f9ull;
    return h ^ h >> 29;
}
/* One-ring area of every vertex (the triangles around it), into ring[vertex_count], square lattice steps. */
void skeli_rings(const skeli_soup *s, const double *position, double *ring);

/* --- contraction -------------------------------------------------------------------------------------------------- */
/* Live vertices: at first those of the tessellated mesh, fewer where they have been welded. */
typedef struct skeli_state {
    uint32_t count;
    double *position;  /* 3 each, whole lattice steps between sweeps */
    uint32_t *weight;  /* original vertices in it */
    double *rho, *beta;
    double *step;      /* 3 each, last step */
    uint32_t *reversals; /* how often a vertex has turned round of late, in eighths; skel_contract.c */
    uint32_t triangle_count;
    uint32_t *corner;  /* 3 each, distinct corners */
    uint64_t edge_count;
    uint32_t *edge;    /* 2 each: (from, to), both directions, sorted */
    uint64_t *edge_start;     /* count + 1 */
    uint32_t *incident_start; /* count + 1 */
    uint32_t *incident;       /* triangles of each vertex */
    double *area;             /* of each triangle */
    uint32_t *live;           /* original vertex -> live vertex, original_count */
    uint32_t original_count;
    /* scratch */
    uint32_t *scratch, *bucket, *label;
    double *mean, *next; /* 3 each */
    double *gather;      /* 8 each */
} skeli_state;

/* Greedy weld: in `order` (NULL: by index) each point joins the nearest seed nearer than radius (lattice steps) or becomes one.
 * label[i] gets the seed's number, *seeds their count. */
svo_result skeli_weld(const svo_allocator *a, const double *position, uint32_t count, const uint32_t *order, double radius,
                      uint32_t *label, uint32_t *seeds, svo_error *err);
/* Label the live vertices by connected clusters of at most `radius` (lattice steps) around a seed; returns their number. With doublings, a seed that has none stays
 * alone, and the radius of the others is doubled so often; they take in no vertex that has fewer. */
uint32_t skeli_cluster(skeli_state *s, double radius, const uint8_t *doublings);
/* Replace the live vertices by the groups of s->label. */
void skeli_collapse(skeli_state *s, uint32_t groups);
/* After edges or triangles changed. */
void skeli_index(skeli_state *s);

/* What the curve does not need is freed at the end: position, weight, live and their counts are left of the state. */
struct skeli_solid; /* may be NULL; else it is told of every step */
svo_result skeli_contract(skeli_pool *pool, const skeli_soup *mesh, const skel_options *options, struct skeli_solid *solid, skel_report *report, skeli_state *state,
                          svo_error *err);

/* --- curve -------------------------------------------------------------------------------------------------------- */
/* Joints, bones, radii, measures; joint_of (vertices of the mesh) gets the map. Fills out but for its map. */
struct skeli_surface; /* may be NULL: then nothing is known about inside */
svo_result skeli_extract(skeli_pool *pool, const skeli_soup *mesh, const skeli_state *state, const struct skeli_surface *surface, const skel_options *options,
                         skel_skeleton *out, uint32_t *joint_of, svo_error *err);
/* Distance of p from the segment a b, and where its foot lies (0 at a, 1 at b). */
double skeli_segment_distance(const double *p, const double *a, const double *b, double *foot);
/* Distances of the surface to the curve, radii of the joints. known (NULL: none): radii, in the skeleton's units, that joints keep, negative for those that are measured. */
svo_result skeli_measure(skeli_pool *pool, const skeli_soup *mesh, const uint32_t *joint_of, const double *known, skel_skeleton *out, svo_error *err);
/* Components (numbered by first joint), ends, branches, loops into report and joints. parent: scratch of joint_count. */
void skeli_topology(skel_skeleton *s, uint32_t *parent);

/* Everything after the import: soup, tessellation, contraction, curve. out->map has one entry a point. */
svo_result skeli_pipeline(const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles, const skel_options *options,
                          skel_skeleton *out, svo_error *err);
svo_result skeli_check_options(const skel_options *options, svo_error *err);
void skeli_phase(skel_report *r, const char *name, double *since);

/* Union-find with path halving. */
static inline uint32_t skeli_root(uint32_t *parent, uint32_t i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}
#endif
