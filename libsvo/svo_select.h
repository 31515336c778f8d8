/* Selection inside the hierarchy (Willcocks 2013, section 3.2): from all instances of a scene to the deformed boxes that a picture needs. Boxes are deformed on
 * the way down, so that what is outside the picture, hidden or too small to see costs nothing below it. */
#ifndef SVO_SELECT_H
#define SVO_SELECT_H

#include "svo_deform.h"
#include "svo_render.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What can throw a shadow on what is seen. */
typedef struct svo_light_mask svo_light_mask;

typedef struct svo_select_options {
    svo_eye eye;
    uint32_t width, height; /* samples of the picture; a box is sized in them */
    double delta;           /* a node whose picture is narrower than this many samples is taken as it is (3.2.5); > 0 */
    bool everything;        /* instances without a pose too */
    bool frustum;           /* leave out what is outside the picture (3.2.3) */
    bool occlusion;         /* leave out what is behind nearer boxes at every sample (3.2.7, with depths of this picture: nothing that a sample shows is lost) */
    const svo_light_mask *shading; /* what is out of the picture or hidden is kept where it can be between what this is of and the light; NULL: it is not */
    double overhang[2];     /* cells reach beyond their box by less than these many times its shortest and its longest side; 0: boxes are drawn as they are */
    bool whole;             /* ignore the size in the picture: down to the finest voxels everywhere */
    double edge;            /* with `whole`: a node whose box is at most so long on every axis (scene units) is taken as it is too; 0: finest voxels alone */
    uint32_t threads;       /* 0 = all */
    const svo_allocator *allocator;
} svo_select_options;

/* A deformed node: its box relative to the selection's origin, rounded outwards. */
typedef struct svo_selected {
    float low[3], high[3];
    uint32_t instance;
    uint8_t normal[4]; /* octahedral, scene; towards the eye where the asset has no normals or the map is flat */
    uint64_t attribute; /* of the node in its asset */
    float area;         /* of the surface that it stands for, scene units squared (svo_deform_blended_area), where its asset covers a part only of what is behind it; else 0 */
} svo_selected;

typedef struct svo_select_report {
    uint64_t pages, pages_seen;         /* that hold instances to select; of them inside the picture */
    uint64_t instances, instances_seen; /* the same for instances */
    uint64_t overflowed;                /* instances left out because their boxes are not finite */
    uint64_t visited, outside, hidden;  /* nodes deformed; of them outside the picture, behind others */
    uint32_t rounds;                    /* of occlusion: depths are those of earlier rounds */
    uint64_t selected, finest;          /* of them finest voxels */
    double seconds;
} svo_select_report;

typedef struct svo_selection {
    const svo_allocator *allocator;
    double origin[3];
    uint64_t count;
    svo_selected *boxes; /* in the order of pages, instances and nodes; with occlusion from near to far */
    svo_select_report report;
} svo_selection;

/* Does not depend on threads. Of a full leaf only nodes at its surface are taken: what is inside cannot be seen. */
svo_result svo_select(const svo_scene *scene, const svo_select_options *options, svo_selection *out, svo_error *err);
void svo_selection_free(svo_selection *s);

/* Of a selection for the same eye, with these overhangs (as in the options); light: towards it, any length > 0. The selection is read alone. *out: 1.4 MB, freed by svo_light_mask_free, read by any number of
 * threads at once. SVO_OUT_OF_MEMORY. */
svo_result svo_light_mask_make(const svo_selection *seen, svo_vec3 light, const double overhang[2], const svo_allocator *a, svo_light_mask **out, svo_error *err);
void svo_light_mask_free(svo_light_mask *m);

/* How boxes become samples. BOXES: those whose rays meet the box. MIPMAPS (4.4): texels about half as wide as the box's rectangle, at the box's least depth: a few writes a box however
 * large it looks, and at least the samples of BOXES, at most half a rectangle (and a sample) farther out. */
typedef enum svo_draw_method { SVO_DRAW_BOXES, SVO_DRAW_MIPMAPS } svo_draw_method;

/* Draw the boxes themselves (the thesis' direct output): for each sample of the picture the nearest box that its ray meets, and the depth along the view's axis.
 * owner, depth: width * height; UINT32_MAX and infinity where there is none. Of equal depths the lower instance wins, then the lower attribute and
 * place, so that a picture does not change with what is left out behind. */
svo_result svo_select_draw(const svo_selection *s, const svo_select_options *options, svo_draw_method method, uint32_t *owner, float *depth, svo_error *err);

/* A picture of the boxes, without shadows, with the options of svo_render (eye, size, samples, light, ambient, background). pixels as in svo_render. Boxes that cover a part only of what
 * is behind them are always drawn as BOXES. seconds: of finding what is nearest; may be NULL, as may covered. */
svo_result svo_select_render(const svo_scene *scene, const svo_selection *s, const svo_render_options *o, svo_draw_method method, uint8_t *pixels, uint64_t *covered, double *seconds,
                             svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
