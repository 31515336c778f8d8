/* What moves the meshes of a glTF file: its nodes, skins and animations. Filled by fmt_import_mesh where it is asked for (fmt_import_options.rig). */
#ifndef FMT_RIG_H
#define FMT_RIG_H

#include "svo_mesh.h"
#include "svo_skin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A node's own transform: a matrix, or translation, rotation (unit quaternion x y z w) and scale, which alone can be animated. */
typedef struct fmt_rig_node {
    uint32_t parent; /* SVO_NONE for roots */
    bool has_matrix;
    svo_mat4 matrix;
    double part[3][4]; /* FMT_RIG_TRANSLATION, ROTATION, SCALE */
} fmt_rig_node;

enum { FMT_RIG_TRANSLATION, FMT_RIG_ROTATION, FMT_RIG_SCALE, FMT_RIG_WEIGHTS };
enum { FMT_RIG_STEP, FMT_RIG_LINEAR, FMT_RIG_CUBIC };

/* One part of one node over time, or the weights of its mesh's morph targets. */
typedef struct fmt_rig_track {
    uint32_t node;
    uint8_t part, interpolation;
    uint32_t width;  /* >= 1: 3, rotations 4, weights as many as there are targets */
    uint64_t count;  /* >= 1 */
    float *times;    /* seconds, increasing */
    float *values;   /* `width` a time; CUBIC: three times as many, in-tangent, value, out-tangent */
} fmt_rig_track;

typedef struct fmt_rig_animation {
    char *name; /* never NULL, may be empty */
    uint32_t track_count;
    fmt_rig_track *tracks; /* by node, then by part */
    double begin, end; /* seconds: first and last time of all tracks; 0 without any */
} fmt_rig_animation;

typedef struct fmt_rig_skin {
    uint32_t joint_count;
    uint32_t *joints;       /* nodes */
    svo_mat4 *inverse_bind; /* mesh to joint, at the time of binding */
} fmt_rig_skin;

/* Of a part of a shape with a skin: influences of its vertices, by numbers of joints of the skin. NULL: bound to nothing. */
typedef struct fmt_rig_part { uint64_t vertex_count; svo_influence *influences; } fmt_rig_part;
typedef struct fmt_rig_shape {
    uint32_t skin; /* SVO_NONE: none, and no parts */
    uint32_t part_count;
    fmt_rig_part *parts;
} fmt_rig_shape;

/* Everything is allocated from `allocator`. Of a file that is no glTF all counts are 0. */
typedef struct fmt_rig {
    const svo_allocator *allocator;
    uint32_t node_count, skin_count, animation_count, shape_count, instance_count;
    fmt_rig_node *nodes;
    uint32_t *order; /* all nodes, parents before their children */
    fmt_rig_skin *skins;
    fmt_rig_animation *animations;
    fmt_rig_shape *shapes;   /* as the mesh's; the positions of one with a skin are those of the file, not skinned */
    uint32_t *instance_node; /* of each instance of the mesh. One with a skin has `place` of its skin as its transform */
} fmt_rig;
void fmt_rig_free(fmt_rig *r); /* and zeroes; a zeroed one is fine */

/* Number of an animation: by its name, else by its number in decimal; SVO_NONE when there is none of that name. Of several with one name the first. */
uint32_t fmt_rig_find(const fmt_rig *r, const char *name);

/* Nodes to the file's world at a time in seconds (before the first key as at the first, after the last as at the last). animation SVO_NONE: as the nodes stand.
 * `world` has room for node_count. */
void fmt_rig_world(const fmt_rig *r, uint32_t animation, double time, svo_mat4 *world);

/* The track of an animation that has the weights of a node's morph targets, or NULL; and those at a time, `width` of them. */
const fmt_rig_track *fmt_rig_weights_track(const fmt_rig *r, uint32_t animation, uint32_t node);
void fmt_rig_weights(const fmt_rig_track *t, double time, double *weights);

/* Where a skin's joint takes a point of the mesh. */
svo_mat4 fmt_rig_joint(const fmt_rig *r, uint32_t skin, uint32_t joint, const svo_mat4 *world);

/* A place for the mesh of a skin that no bone has moved: where the first joint that can (its matrix is invertible) takes it while the nodes stand as they are in
 * the file. With it the matrices of bones are near the identity, and a file whose nodes stand as they were bound needs none. */
svo_mat4 fmt_rig_place(const fmt_rig *r, uint32_t skin);

#ifdef __cplusplus
}
#endif
#endif
