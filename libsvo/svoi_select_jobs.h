/* The parts of a selection: svo_select.c (what is to be done, and what came of it), svo_select_nodes.c (from the top of a subtree down), svo_select_order.c (from near to far),
 * svo_select_depth.c (boxes in the picture, depths), svo_select_copies.c (instances that are where others are). */
#ifndef SVOI_SELECT_JOBS_H
#define SVOI_SELECT_JOBS_H

#include "svoi_select.h"

/* A node to look at. */
typedef struct svoi_visit {
    svo_view_node node;
    uint32_t cell[3]; /* on its level */
    uint8_t level, full_level; /* full_level: of the full leaf it is in */
} svoi_visit;

/* What a thread takes at a time: a subtree of an instance, or all instances of a page. */
typedef struct svoi_job {
    svoi_visit top;
    uint32_t page;
    uint64_t instance; /* SVOI_WHOLE_PAGE */
} svoi_job;
#define SVOI_WHOLE_PAGE UINT64_MAX

/* What a thread alone has drawn of its job, so that a job hides parts of itself whatever other threads do. */
typedef struct svoi_own_depth {
    float *nearest; /* of each sample of the picture, those of `span` made ready; NULL: there is none */
    svoi_span span; /* where the job can be */
} svoi_own_depth;

typedef struct svoi_output {
    svo_buffer boxes;
    svoi_own_depth own;
    svo_slice_cache slices;
    svo_select_report report;
} svoi_output;

/* Where the boxes of a job went. */
typedef struct svoi_job_span { uint32_t worker; uint64_t first, count; } svoi_job_span;

typedef struct svoi_selecting {
    const svo_scene *scene;
    const svo_select_options *o;
    double origin[3];
    svoi_look look;
    svoi_depth depth;         /* with occlusion */
    uint32_t *normal_channel, *coverage_channel; /* of each asset; what covers a part only hides nothing */
    uint8_t *copy;            /* of each instance: it is where another is */
    svo_bones **bones;        /* of each asset that an instance moves by its bones, else NULL */
    bool by_pages;
    const svoi_job *jobs;
    svoi_job_span *spans;
    svoi_output *outputs;
} svoi_selecting;

/* An instance made ready. */
typedef struct svoi_posed {
    const svo_view *view;
    svo_deform map;         /* to the selection's coordinates */
    const svo_bones *bones; /* NULL: its pose has none */
    uint32_t page;
    uint64_t instance;
} svoi_posed;
svoi_posed svoi_posed_make(const svoi_selecting *s, uint32_t page, uint64_t instance);

svo_result svoi_select_no_memory(svo_error *err);

/* svo_select_nodes.c */
typedef enum svoi_sight { SVOI_OUT_OF_SIGHT, SVOI_HIDDEN, SVOI_SEEN } svoi_sight;
typedef enum svoi_fate { SVOI_OUTSIDE, SVOI_BEHIND, SVOI_TAKE, SVOI_DESCEND, SVOI_OVERFLOW } svoi_fate;
/* Is an instance to be selected at all? */
bool svoi_wanted(const svoi_selecting *s, uint64_t instance);
/* Bounds of a page relative to the eye, a little wider than they are stored: sines differ in their last bits between machines. */
void svoi_page_box(const svoi_selecting *s, uint32_t page, double low[3], double high[3]);
svoi_sight svoi_see_page(const svoi_selecting *s, uint32_t page);
/* How far cells reach beyond a box, scene units (options->overhang); *longest: its longest side. */
double svoi_overhang(const double overhang[2], const double low[3], const double high[3], double *longest);
/* Can what is in the box, or in cells made of it, throw a shadow on what is seen (options->shading)? */
bool svoi_can_shade(const svo_select_options *o, const double low[3], const double high[3]);
/* Of a box that reaches behind the eye, where there is no picture: samples that one of that size would take at its distance. */
double svoi_size_at_distance(const svoi_selecting *s, const double low[3], const double high[3]);
/* The top of an instance. */
svoi_visit svoi_root_of(const svo_view *v);
uint32_t svoi_children(const svo_view *v, const svoi_visit *n, svoi_visit out[8]);
/* Where a box is in the picture, and all that cells made of it can cover. */
typedef struct svoi_place { svoi_rect box, reach; } svoi_place;
/* Deform a node and say what is to be done with it. low and high are its box unless it overflows; *place, where it is not outside, where that is. */
svoi_fate svoi_judge(const svoi_selecting *s, const svoi_posed *p, const svoi_visit *n, double low[3], double high[3], svoi_place *place);
/* A svo_range_fn over s->jobs, for svo_parallel_for. */
svo_result svoi_run_jobs(void *selecting, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err);

/* svo_select_order.c: all jobs from near to far in rounds that grow; the pyramid of depths is that of the rounds before, so the result does not depend on threads. Jobs are
 * replaced by their parts. */
svo_result svoi_run_by_depth(svoi_selecting *s, svo_buffer *jobs, svo_buffer *spans, uint32_t threads, svo_select_report *r, svo_error *err);

#endif
