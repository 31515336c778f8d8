/* Inside libskel: refinement of chosen bones. */
#ifndef SKELI_REFINE_H
#define SKELI_REFINE_H

#include "skeli_surface.h"

/* A skeleton in the making with the mesh it is mapped from. Arrays belong to `pool`. */
typedef struct skeli_model {
    skeli_pool *pool;
    skeli_soup mesh;    /* tessellated, canonical */
    uint32_t *joint_of; /* of each of its vertices */
    uint32_t *moved;    /* vertex of the canonical soup -> vertex of mesh */
    uint32_t soup_vertices;
    const skeli_surface *surface; /* may be NULL */
    skel_skeleton *s;
} skeli_model;

/* chosen[bone_count]: the number of the first of the refinements that selects the bone, SVO_NONE where none does. SVO_INVALID_ARGUMENT for bones that are not there. */
svo_result skeli_select(const skel_skeleton *s, const skel_refine *list, uint32_t count, uint32_t *chosen, svo_error *err);
/* All refinements of the options. Replaces mesh, joint_of and moved of the model and joints and bones of its skeleton, and measures what is new. */
svo_result skeli_refine(skeli_model *m, const skel_options *o, svo_error *err);

typedef struct skeli_spokes { uint32_t *start, *bone; } skeli_spokes; /* bones of joint j: bone[start[j] .. start[j + 1]) */
svo_result skeli_spokes_make(skeli_pool *pool, const skel_skeleton *s, skeli_spokes *out, svo_error *err);

/* --- joining (skel_refine_join.c) --- */
/* What a part looked like before and after. A vertex of `mesh` belongs to a joint of `curve`. */
typedef struct skeli_part {
    const skel_skeleton *base;
    const skeli_spokes *spokes;  /* of base */
    const uint8_t *selected;     /* of each bone of base */
    const uint32_t *bone_group;  /* of each selected bone: which group of connected selected bones */
    const skel_skeleton *curve;  /* made anew */
    const skeli_soup *mesh;      /* its mesh */
    const uint32_t *curve_of;    /* vertex of mesh -> joint of curve */
    const uint8_t *inside;       /* vertex of mesh: it belongs to the selected bones, not to what lies beside them */
    const uint32_t *owner;       /* vertex of mesh: the joint of base that the selected bones are joined to there, or SVO_NONE */
    const uint32_t *group_of;    /* vertex of mesh that is inside: its group of bones */
    double near;                 /* joints as near as this to what they are joined to become one with it; the model's coordinates */
} skeli_part;

/* The two curves as one. node: joints of base, then joints of curve (base->joint_count + j) -> joint of the result, SVO_NONE where there is none. */
typedef struct skeli_joined {
    uint32_t joints, bones, links;
    double *position; /* 3 each, the model's coordinates */
    uint32_t *bone;   /* 2 each, a < b, sorted, distinct */
    uint32_t *node;
    uint32_t kept;    /* joints of base that are left */
} skeli_joined;
svo_result skeli_join(skeli_pool *pool, const skeli_part *p, skeli_joined *out, svo_error *err);

#endif
