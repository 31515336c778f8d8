/* Inside libskel: questions about the model's surface: how far is it, what does a ray meet, is a point inside. Everything is in lattice steps. */
#ifndef SKELI_SURFACE_H
#define SKELI_SURFACE_H

#include "skeli_internal.h"
#include "svo_winding.h"

enum { SKELI_SURFACE_LEVELS = 32 };

/* Parts of the surface that share vertices; whether all of them are closed (every edge has two triangles), and then the sum of their genera. */
typedef struct skeli_genus { uint32_t components, closed; bool known; uint64_t genus; } skeli_genus;

typedef struct skeli_surface {
    const skeli_soup *soup;
    /* A complete binary tree over the triangles in their (Morton) order, four a leaf. */
    uint32_t levels;
    uint64_t first[SKELI_SURFACE_LEVELS], size[SKELI_SURFACE_LEVELS]; /* nodes of a level, leaves first */
    float *box;                                                      /* low x y z, high x y z; whole lattice steps, so exact */
    /* Of every other level, leaves first, four nodes side by side: their boxes, and of the lowest levels unit normals and lowest and highest coordinates along them. */
    float *four;
    uint64_t first_four[SKELI_SURFACE_LEVELS / 2 + 1];
    /* Inside: the model as it was given, with its orientation. */
    svo_part part;
    svo_shape shape;
    svo_instance instance;
    svo_mesh mesh;
    svo_winding *winding; /* NULL where no triangle has an area */
    uint64_t turned, boundary_edges;
    skeli_genus genus;
} skeli_surface;

/* position, corner: the model as it was given, remap: its points in the soup (all are borrowed); report has the normalisation. Zero-initialise before; free also on failure. */
svo_result skeli_surface_make(skeli_pool *pool, const skeli_soup *soup, const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles,
                              const uint32_t *remap, const skel_report *report, uint32_t threads, skeli_surface *out, svo_error *err);
/* Distances and rays alone: nothing is inside. */
svo_result skeli_surface_tree(skeli_pool *pool, const skeli_soup *soup, skeli_surface *out, svo_error *err);
void skeli_surface_free(skeli_surface *s);

/* Distance of p to the surface, but not more than `most`; *nearest (may be NULL) only where it is less. */
double skeli_surface_distance(const skeli_surface *s, const double p[3], double most, double nearest[3]);
/* The same for callers who have no use for distances up to `least`: the search ends at the first one. */
double skeli_surface_clearance(const skeli_surface *s, const double p[3], double least, double most, double nearest[3]);
/* How far along the unit vector d the surface is first met, `most` when not before. */
double skeli_surface_ray(const skeli_surface *s, const double p[3], const double d[3], double most);
/* Generalised winding number above 1/2. */
bool skeli_surface_inside(const skeli_surface *s, const double p[3]);

svo_result skeli_surface_genus(skeli_pool *pool, const skeli_soup *soup, skeli_genus *out, svo_error *err);

/* Measure a curve: joints in lattice steps, bones as pairs; mesh: vertices the surface is sampled at. */
svo_result skeli_quality(skeli_pool *pool, const skeli_surface *surface, const skeli_soup *mesh, const double *joint, uint32_t joints, const uint32_t *bone, uint64_t bones,
                         uint32_t threads, skel_quality *q, svo_error *err);
svo_result skeli_quality_of(skeli_pool *pool, const skeli_surface *surface, const skeli_soup *mesh, const skel_skeleton *s, const double centre[3], double unit, uint32_t threads,
                            skel_quality *q, svo_error *err);

#endif
