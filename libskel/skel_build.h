/* Feature-varying curve skeletons (Willcocks 2013, chapter 5): a mesh or a voxel set is contracted until it has no
 * area left, and the groups its vertices end in become joints and bones.
 *
 * "Units": positions are normalised as p' = (p - centre) / unit, where `unit` is about the longest side of the model
 * (see skel_normalize), so that omega and delta mean the same for models of any size. Lengths in the report are in
 * these units unless their comment says otherwise; joints are in the mesh's own coordinates. */
#ifndef SKEL_BUILD_H
#define SKEL_BUILD_H

#include "svo_mesh.h"
#include "svo_stream.h"
#include "svo_rules.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How the contraction is run. Both stop by the same rules and share pre- and postprocessing. */
typedef enum skel_method {
    SKEL_METHOD_FAST = 0,   /* vertices that have come within omega/8 are welded on the way; 4 smoothing steps a ball search; in long runs with momentum (Polyak 1964) */
    SKEL_METHOD_LITERAL = 1 /* equations 5.4.1 to 5.4.4 on every vertex of the tessellated mesh, in every sweep */
} skel_method;

typedef enum skel_normalize {
    SKEL_NORMALIZE_BALL = 0, /* unit = diameter of the smallest enclosing ball / 1.15: does not change under rotation */
    SKEL_NORMALIZE_BOX = 1   /* unit = longest side of the axis-aligned box (Willcocks 2013, 5.5, FitToBox) */
} skel_normalize;

/* Ball search. Both give the same sums, bit for bit (skel_radius.h). */
typedef enum skel_search { SKEL_SEARCH_FLANN = 0, SKEL_SEARCH_GRID = 1 } skel_search;

/* Where a joint is put. */
typedef enum skel_place {
    SKEL_PLACE_CENTROID = 0,  /* area-weighted centroid of the original surface that is mapped to it */
    SKEL_PLACE_CONTRACTED = 1, /* where its vertices were contracted to */
    SKEL_PLACE_INSIDE = 2 /* the centroid, moved to the middle of the section across the curve; ends reach tips, bones are kept inside of the solid. Where
                             most of the curve is outside (a sheet), as the centroid */
} skel_place;

/* Refinement (Willcocks 2013, section 5.6): some bones are made again with another omega. What they are joined to stays as it is, bit for bit. */
typedef enum skel_select {
    SKEL_SELECT_BONES = 0, /* by number */
    SKEL_SELECT_BOX = 1,   /* with their middle in a box */
    SKEL_SELECT_BALL = 2,  /* with their middle in a ball */
    SKEL_SELECT_THIN = 3,  /* the mean of whose joints' radii is at most so much */
    SKEL_SELECT_ENDS = 4   /* from an end to the next branch */
} skel_select;

typedef struct skel_refine {
    skel_select select;
    double omega;         /* in units of the whole model, as skel_options.omega */
    double where[6];      /* BOX: low, high; BALL: centre, radius (the model's coordinates); THIN: largest radius (units) */
    uint32_t *range;      /* BONES: first, last, first, last, ...; numbers in the skeleton without refinement */
    uint32_t range_count; /* pairs */
    /* Filled in by the build. */
    struct skel_refined {
        uint32_t bones, joints_removed, joints_added; /* bones selected; a bone that several refinements select is the first one's */
        uint32_t links;      /* bones that were added because the parts made anew would have come apart */
        uint64_t iterations; /* sweeps of the contraction */
        bool converged;
        double error_before, error_after; /* reconstruction error in the mean of the surface of the selected bones, percent of the diagonal */
    } result;
} skel_refine;

/* From text: SELECTION@OMEGA, several with `;` between: `ends`, `thin:R`, `box:X0,Y0,Z0,X1,Y1,Z1`, `ball:X,Y,Z,R`, or bone numbers as `3,7-12`.
 * SVO_INVALID_ARGUMENT tells what is wrong. *out is freed by skel_refine_free. */
svo_result skel_refine_parse(const char *text, const svo_allocator *a, skel_refine **out, uint32_t *count, svo_error *err);
void skel_refine_free(const svo_allocator *a, skel_refine *list, uint32_t count);

typedef struct skel_options {
    const svo_allocator *allocator; /* NULL = default */
    double omega;                   /* feature size in units, SKEL_MIN_OMEGA..SKEL_MAX_OMEGA */
    double delta;                   /* > 0: stop when the movements of all vertices in a sweep sum up to less (5.5.1);
                                       0: stop when for 8 sweeps no vertex moved by 1e-3 omega */
    uint64_t max_iterations;        /* sweeps; 0: 6000, and with the fast method up to 20000 while at most 2000 vertices are left */
    uint64_t max_vertices;          /* of the tessellated mesh; 0 = 8 million */
    skel_method method;
    skel_normalize normalize;
    skel_search search;
    skel_place place;
    uint32_t threads; /* 0 = all; no influence on the result */
    uint32_t solid_divide; /* > 0: fill `solid` of the skeleton with voxels of omega / solid_divide (skel_solid.h) */
    skel_refine *refine; /* refine_count of them, one after the other; their results are filled in */
    uint32_t refine_count;
    bool skip_quality; /* leave report.quality unmeasured */
    bool keep_samples; /* fill `samples` of the skeleton, which skel_bind.h needs */
    svo_warnings *warnings;
    /* Called now and then with 0..1; may be NULL. Returning false cancels (SVO_CANCELLED). */
    bool (*progress)(void *user, double fraction);
    void *user;
} skel_options;

#define SKEL_MIN_OMEGA 1e-4
#define SKEL_MAX_OMEGA 4.0

/* omega 0.0125, place INSIDE, everything else 0. */
skel_options skel_default_options(void);

typedef struct skel_joint {
    double position[3]; /* the mesh's coordinates */
    double radius;      /* mean distance of the mapped surface from the joint and its bones, the mesh's coordinates */
    uint32_t component;
} skel_joint;

typedef struct skel_bone { uint32_t a, b; } skel_bone; /* joints, a < b */

typedef enum skel_source { SKEL_SOURCE_MESH = 0, SKEL_SOURCE_VOXELS = 1 } skel_source;

typedef struct skel_phase { const char *name; double seconds; } skel_phase;
enum { SKEL_MAX_PHASES = 10 };

/* How good the curve is, measured on the model's surface (of voxels: their outer boundary) at samples 0.004 units apart along the bones. Inside
 * means a generalised winding number above 1/2. Lengths are percent of the bounding box's diagonal. */
typedef struct skel_quality {
    bool measured;               /* else all of this is 0 */
    uint32_t surface_components; /* parts of the surface that share vertices */
    uint32_t surface_closed;     /* of these: every edge has two triangles */
    bool genus_known;            /* all parts are closed */
    uint64_t genus;              /* sum over the parts, from their Euler characteristics */
    uint64_t samples;
    double joints_inside, length_inside; /* percent of the joints, of the length of the bones */
    double outside_max;                  /* farthest sample from the surface of those outside */
    /* Of samples inside, 24 rays across the bone with lengths r and directions d: 2 |sum r d| / sum r, 0 in the middle, about 1 at the surface. */
    double off_centre_median, off_centre_p95;
    /* Surface to the union of the inscribed balls of all samples. */
    double balls_mean, balls_max;
} skel_quality;

/* What the run was and found. */
typedef struct skel_report {
    skel_source source;
    skel_method method;
    skel_normalize normalize;
    skel_place place;
    double omega, delta;
    double centre[3], unit; /* of the normalisation */
    uint64_t input_count;   /* vertices of the mesh as placed by its instances, or finest voxels: length of the map */
    uint64_t mapped_count;  /* of these, mapped to a joint */
    uint64_t not_finite, unreferenced, coincident; /* input vertices dropped, dropped, welded to another */
    uint64_t dropped_triangles;                    /* with a corner that is not finite, or all corners in one point */
    uint64_t mesh_vertices, mesh_triangles;        /* after welding */
    uint64_t tessellated_vertices, tessellated_triangles;
    uint64_t iterations; /* sweeps done */
    bool converged;
    double final_movement_sum, final_movement_max; /* units: the steps that the last sweep asked for, before damping and without momentum; the sum is over the tessellated vertices */
    double thinness_error;                         /* percent, equation 5.7.1 */
    uint32_t components, ends, branches, loops, isolated;
    uint32_t leftover_triangles;                 /* after the final weld, before they were made joints */
    double surface_distance_mean, surface_distance_max; /* surface to the bones of its joint, percent of the box diagonal */
    double reconstruction_mean, reconstruction_max;     /* the same minus the bone's radius there, absolute value */
    uint32_t voxel_level;  /* source VOXELS: octree level that was contracted, and that of the file */
    uint32_t voxel_depth;
    skel_quality quality; /* not kept in files */
    /* Not kept in files: where the surface is closed, what the contraction came to, and whether the curve was made again from the solid's cells because this was not the surface's genus. */
    uint32_t contracted_components;
    uint64_t contracted_loops;
    bool rebuilt;
    uint32_t phase_count;
    skel_phase phases[SKEL_MAX_PHASES];
} skel_report;

/* Voxels that the surface passed while it was contracted, and those inside by winding number that are joined to them. */
typedef struct skel_solid {
    uint32_t depth;            /* of the octree */
    double voxel_to_world[16]; /* as in svo_tree_info */
    uint64_t count, swept, filled;
    uint64_t *codes; /* ascending Morton codes at `depth` */
} skel_solid;

/* A skeleton, its map and its report. Joints are in order of their components, bones sorted by (a, b). */
typedef struct skel_skeleton {
    const svo_allocator *allocator;
    uint32_t joint_count, bone_count;
    skel_joint *joints;
    skel_bone *bones;
    /* One entry for each input vertex or voxel: joint, or SVO_NONE where it was dropped. Vertices are counted over
     * instances in order, then the parts of the instance's shape, then the part's vertices (a shape that is placed twice is counted
     * twice). Voxels are counted in Morton order of the finest level. */
    uint64_t map_count;
    uint32_t *map;
    /* With keep_samples: the vertices of the tessellated mesh (no edge of which is longer than omega), in the mesh's coordinates, and their joints. */
    uint64_t sample_count;
    double *samples; /* 3 each */
    uint32_t *sample_joint;
    skel_solid solid; /* with solid_divide; else empty */
    skel_report report;
} skel_skeleton;

/* Degree of each joint is all that ends and branches need; a component is one tree or graph of bones. */
typedef struct skel_component {
    uint32_t joints, bones, ends, branches, loops;
} skel_component;

/* Skeleton of a mesh. Takes any triangles: open, non-manifold, unshared, overlapping. Not converging is no failure: see
 * report.converged (a warning is added too). SVO_INVALID_DATA when no triangle is finite, SVO_LIMIT when the tessellation to edges
 * below omega needs more than max_vertices, SVO_INVALID_ARGUMENT for options out of range. */
svo_result skel_build_mesh(const svo_mesh *mesh, const skel_options *options, skel_skeleton *out, svo_error *err);

/* Skeleton of a voxel set: of the outer boundary of its voxels at the coarsest level whose voxels are at most omega/2,
 * with what cannot be reached from outside filled. SVO_LIMIT where that level is beyond 10 and finer than the voxels allow. */
svo_result skel_build_voxels(const svo_tree_info *info, const svo_chunk_source *source, const skel_options *options,
                             skel_skeleton *out, svo_error *err);

void skel_skeleton_free(skel_skeleton *s);

/* How far two curves are from each other, in the model's coordinates: samples 0.004 units of their own curve apart along all bones (fewer where there are so many bones
 * that it would take long), to the nearest bone or joint of the other. */
typedef struct skel_distance { double mean[2], max[2]; } skel_distance; /* from a to b, from b to a; the Hausdorff distance is the larger max */
void skel_curve_distance(const skel_skeleton *a, const skel_skeleton *b, skel_distance *out);

/* Measure any curve (joints and bones of s, in the mesh's coordinates; nothing else of it is read) against the surface of a mesh. */
svo_result skel_measure_quality(const svo_mesh *mesh, const skel_skeleton *s, uint32_t threads, const svo_allocator *a, skel_quality *out, svo_error *err);

/* Count joints, bones, ends (degree 1), branches (degree 3 and more) and loops (bones - joints + 1) of each component
 * into out[0 .. report.components). */
void skel_components(const skel_skeleton *s, skel_component *out);

/* The rules of docs/format/skel.md (SKL-03..SKL-07) on a skeleton in memory. */
svo_result skel_check(const skel_skeleton *s, svo_error *err);
/* The same, but violations go to `rules` (NULL: as above), and what does not hang on them is checked as well. */
svo_result skel_check_all(const skel_skeleton *s, svo_rules *rules, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
