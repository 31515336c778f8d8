/* Selection inside the hierarchy (Willcocks 2013, section 3.2): from all instances of a scene to the deformed boxes that a picture needs. Boxes are deformed on
 * the way down, so that what is outside the picture, hidden or too small to see costs nothing below it. */
#ifndef SVO_SELECT_H
#define SVO_SELECT_H

#include "svo_deform.h"
#include "svo_render.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct svo_select_options {
    svo_eye eye;
    uint32_t width, height; /* samples of the picture; a box is sized in them */
    double delta;           /* a node whose picture is narrower than this many samples is taken as it is (3.2.5); > 0 */
    bool everything;        /* instances without a pose too */
    bool frustum;           /* leave out what is outside the picture (3.2.3) */
    bool whole;             /* ignore the size: down to the finest voxels everywhere */
    uint32_t threads;       /* 0 = all */
    const svo_allocator *allocator;
} svo_select_options;

/* A deformed node: its box relative to the selection's origin, rounded outwards. */
typedef struct svo_selected {
    float low[3], high[3];
    uint32_t instance;
    uint8_t normal[4]; /* octahedral, scene; towards the eye where the asset has no normals or the map is flat */
    uint64_t attribute; /* of the node in its asset */
} svo_selected;

typedef struct svo_select_report {
    uint64_t pages, pages_seen;         /* that hold instances to select; of them inside the picture */
    uint64_t instances, instances_seen; /* the same for instances */
    uint64_t overflowed;                /* instances left out because their boxes are not finite */
    uint64_t visited, outside;          /* nodes deformed; of them outside the picture */
    uint64_t selected, finest;          /* of them finest voxels */
    double seconds;
} svo_select_report;

typedef struct svo_selection {
    const svo_allocator *allocator;
    double origin[3];
    uint64_t count;
    svo_selected *boxes; /* in the order of pages, instances and nodes */
    svo_select_report report;
} svo_selection;

/* Does not depend on threads. Of a full leaf only nodes at its surface are taken: what is inside cannot be seen. */
svo_result svo_select(const svo_scene *scene, const svo_select_options *options, svo_selection *out, svo_error *err);
void svo_selection_free(svo_selection *s);

#ifdef __cplusplus
}
#endif
#endif
