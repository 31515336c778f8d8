/* svo-skeleton: what its parts share. */
#ifndef SKELETON_H
#define SKELETON_H

#include "cli_axes.h"
#include "fmt_skel.h"
#include "skel_repair.h"
#include "svo_mesh.h"

enum { SKELETON_MAX_LISTED = 256 }; /* components and segments in the report; all are counted */

enum { REPAIR_OWN, REPAIR_CGAL };
enum { TESSELLATE_OWN, TESSELLATE_OPENMESH };

typedef struct skeleton_options {
    double omega, delta;
    uint64_t max_iterations, max_vertices;
    int method, normalize, search, place, repair, tessellate;
    const char *glb, *obj, *swc;
    uint64_t influences, smoothing, solid_divide, draco;
    const char *bind, *bound, *solid, *reconstruct, *refine, *segments;
    cli_axes axes;
} skeleton_options;

/* What is read and what is made of it. Zero-initialise; free by skeleton_input_free. */
typedef struct skeleton_input {
    svo_mesh mesh;           /* as it was given; empty of voxels */
    bool is_prepared;        /* the skeleton is that of `prepared` */
    skel_prepared prepared;  /* --repair, --tessellate */
    json_t *provenance;      /* array of inputs */
} skeleton_input;
/* The input of the command line to a skeleton, of library->allocator; free both, also after a failure. `memory`: the account of --memory, NULL without a limit. */
svo_result skeleton_build(cli *c, const skeleton_options *o, const skel_options *library, const svo_limit_allocator *memory, skeleton_input *in, skel_skeleton *out, svo_error *err);
void skeleton_input_free(skeleton_input *in);

typedef struct skeleton_outputs { fmt_output *skel, *glb, *obj, *swc, *bound, *solid, *closed, *segments; } skeleton_outputs;
/* All are opened before any work is done, so that a wrong path costs no time. */
svo_result skeleton_open_outputs(const cli *c, const skeleton_options *o, skeleton_outputs *out, svo_error *err);
/* All are written, then all are put in their places. *bytes: of the .skel. */
svo_result skeleton_write(cli *c, const skeleton_options *o, skeleton_outputs *out, const skeleton_input *in, const skel_skeleton *s, const char *provenance, uint64_t *bytes,
                          svo_error *err);
void skeleton_discard_outputs(skeleton_outputs *out);

void skeleton_report(cli *c, const skel_skeleton *s, uint64_t bytes);
void skeleton_report_refined(cli *c, const skel_options *o);

#endif
