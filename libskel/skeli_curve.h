/* Inside libskel: the curve while it is made, before it becomes a skeleton. */
#ifndef SKELI_CURVE_H
#define SKELI_CURVE_H

#include "skeli_geometry.h"
#include "skeli_surface.h"

typedef struct skeli_curve {
    uint32_t joints;    /* welded ones first, then those made of leftover triangles */
    uint32_t welded;
    uint32_t *joint_of; /* mesh vertex -> joint */
    uint32_t *bone;     /* 2 each, a < b, sorted and distinct, but for the steps in between */
    uint64_t bones;
    uint32_t *triangle; /* leftover, 3 each, sorted */
    uint64_t triangles;
    uint32_t *group_of; /* leftover triangle -> group */
    uint32_t groups;
    double *position;   /* joints, lattice steps */
} skeli_curve;

static inline uint32_t skeli_other_end(const skeli_curve *c, uint32_t bone, uint32_t joint)
{
    const uint32_t *b = c->bone + 2 * (uint64_t)bone;
    return b[0] == joint ? b[1] : b[0];
}

/* Bones of each joint: bone[start[j] .. start[j + 1]). */
typedef struct skeli_fans { uint32_t *start, *bone; } skeli_fans;
svo_result skeli_fans_make(skeli_pool *pool, const skeli_curve *c, skeli_fans *out, svo_error *err);
void skeli_fans_free(skeli_pool *pool, skeli_fans *f);

/* Chains of bones between joints that have not two of them: chain k is joint[start[k] .. start[k + 1]), its first and last such joints. A loop without one
 * begins and ends at its lowest joint. */
typedef struct skeli_chains { uint32_t count, *start, *joint; } skeli_chains;
svo_result skeli_chains_make(skeli_pool *pool, const skeli_curve *c, skeli_chains *out, svo_error *err);
void skeli_chains_free(skeli_pool *pool, skeli_chains *f);

/* Merge every joint j into into[j] (which may be merged itself; no cycles), number what is left without gaps, drop bones that became points and double ones. */
svo_result skeli_curve_merge(skeli_pool *pool, const skeli_soup *mesh, skeli_curve *c, uint32_t *into, svo_error *err);
/* Insert count[b] points (at point + 3 * first[b], from bone a to b) into bone b; vertices of a bone's joints go to the nearest of its points. */
svo_result skeli_curve_insert(skeli_pool *pool, const skeli_soup *mesh, skeli_curve *c, const uint32_t *count, const uint64_t *first, const double *point, svo_error *err);

/* How many parts it has, and how many loops. */
svo_result skeli_curve_betti(skeli_pool *pool, const skeli_curve *c, uint32_t *components, uint64_t *loops, svo_error *err);

/* --- after the weld --- */
/* A loop that can be filled by a disc inside the solid is none: its joints become one. */
svo_result skeli_close_false_loops(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, skeli_curve *c, svo_error *err);
/* Let bones follow the bends of their limb, put joints into the middle of the sections across them, ends where their ball touches the tip; drop branches that do not stick out. */
svo_result skeli_centre(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, skeli_curve *c, svo_error *err);
/* After that: limbs that are missing, bones inside the solid, no joints that are not needed. */
svo_result skeli_finish(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, uint32_t threads, skeli_curve *c, svo_error *err);
/* Which limbs the curve has (skel_limbs.c): branches that do not stick out are dropped; limbs that the contraction has merged with others, or with the body, get one. *grown: whether there are any. */
/* Half the widest opposite pair of rays across a unit vector. */
double skeli_half_width(const skeli_surface *s, const double p[3], const double along[3]);
/* Limbs that the contraction has found, those that are to be made, and all after that. */
typedef enum skeli_limb { SKELI_LIMB_FOUND, SKELI_LIMB_NEW, SKELI_LIMB_ANY } skeli_limb;
/* Is a chain of points, from its end to its root, a limb, of which at most `most` sticks out? *ratio: the way to its tip by the radius at its root. */
bool skeli_is_limb(const skeli_surface *s, double omega, skeli_limb which, double most, const double *point, uint32_t count, double *ratio);
svo_result skeli_drop_stubs(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, skeli_limb which, skeli_curve *c, svo_error *err);
svo_result skeli_grow(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, uint32_t threads, skeli_curve *c, bool *grown, svo_error *err);
/* Joints but ends to where the curve is shortest, near the surface being far (skel_relax.c). */
svo_result skeli_relax(skeli_pool *pool, const skeli_surface *surface, int rounds, skeli_curve *c, svo_error *err);
/* Joints, by at most 0.12 of their radius, to where the mean distance of the surface (of `mesh`, in the lattice) to the inscribed balls along the curve is less (skel_fit.c). The same for any
 * number of threads (0 = all). A curve of too many bones is left as it is. SVO_OUT_OF_MEMORY. */
svo_result skeli_fit(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, uint32_t threads, skeli_curve *c, svo_error *err);
/* Branches of four and more bones become several of three; those of three that are joined by a bone shorter than `nearer` one. */
svo_result skeli_split_branches(skeli_pool *pool, const skeli_surface *surface, skeli_curve *c, svo_error *err);
svo_result skeli_merge_branches(skeli_pool *pool, const skeli_soup *mesh, double nearer, skeli_curve *c, svo_error *err);
/* Is most of the curve inside, so that "inside" means something? */
bool skeli_mostly_inside(const skeli_surface *surface, const skeli_curve *c);

#endif
