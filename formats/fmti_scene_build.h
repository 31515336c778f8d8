/* What the parts of building a scene share: fmt_scene_build.c (descriptions, octrees, the whole), fmt_scene_meshes.c (a mesh file as a scene, meshes to octrees),
 * fmt_scene_rig.c (skins and animations as poses). */
#ifndef FMTI_SCENE_BUILD_H
#define FMTI_SCENE_BUILD_H

#include "fmt_import.h"
#include "fmt_rig.h"
#include "fmt_scene_build.h"
#include "fmt_scene_json.h"
#include "fmt_svdag.h"

/* One bone of an asset: a joint of a skin, or a node that carries a mesh. */
typedef struct fmti_bone {
    uint32_t skin;  /* SVO_NONE: a node */
    uint32_t joint; /* of the skin; or the node */
    svo_mat4 back;  /* the asset's coordinates to those that the joint's matrix (the node's world) takes */
    bool used;      /* some vertex follows it */
} fmti_bone;

/* What an asset needs to be posed. Frames are matrices of all bones, asset coordinates to asset coordinates. */
typedef struct fmti_rigged {
    const svo_allocator *allocator;
    const fmt_rig *rig;
    const svo_mesh *mesh;
    uint32_t bone_count;
    fmti_bone *bones;
    uint32_t *first_bone;    /* of each instance of the mesh */
    svo_mat4 after;          /* what takes the joints' results to the asset's coordinates */
    svo_mat4 *world;         /* scratch: rig->node_count */
    svo_buffer frames;       /* 12 * bone_count floats each */
    uint16_t *number;        /* of each bone in the octree; SVO_SKIN_REST: left out */
    uint32_t kept, moved;    /* bones in the octree; by how many frames a bone moves at all */
    double stretch;          /* longest image of a unit vector, at least 1 */
    double extent;           /* of the mesh: what counts as moving is measured by it */
} fmti_rigged;

/* flat: the asset is all instances of the mesh as they stand; else it is one shape in its own coordinates and `mesh` holds that shape alone, as instance 0, whose
 * shape in the rig is number `shape`. Everything is borrowed. */
svo_result fmti_rigged_make(fmti_rigged *r, const fmt_rig *rig, const svo_mesh *mesh, bool flat, uint32_t shape, double extent, const svo_allocator *a, svo_error *err);
void fmti_rigged_free(fmti_rigged *r);
/* Add a frame: at a time of an animation (SVO_NONE: as the nodes stand), or from `stated` matrices (12 floats a bone, by number; the others rest). *frame is its number. */
svo_result fmti_rigged_frame(fmti_rigged *r, uint32_t animation, double time, uint32_t *frame, svo_error *err);
svo_result fmti_rigged_stated(fmti_rigged *r, const float *matrices, uint32_t count, uint32_t *frame, svo_error *err);
/* After the last frame: which bones are kept. */
svo_result fmti_rigged_finish(fmti_rigged *r, svo_error *err);
/* Then: the matrices of a frame for the bones that are kept, appended to `matrices`. False when out of memory. */
bool fmti_rigged_matrices(const fmti_rigged *r, uint32_t frame, svo_buffer *matrices);
/* Then: the mesh as svo_skin takes it, in memory of the rig; freed by fmti_skin_free. */
typedef struct fmti_skin { svo_skin_mesh mesh; double *positions; svo_influence *influences; uint32_t *indices; const svo_allocator *allocator; } fmti_skin;
svo_result fmti_skin_make(const fmti_rigged *r, uint32_t shape, fmti_skin *out, svo_error *err);
void fmti_skin_free(fmti_skin *s);

/* One asset of the source and what keeps its octree alive. */
typedef struct fmti_entry {
    fmt_scene_build_asset info;
    char *name, *path;
    bool used, is_mesh;
    double scale;  /* longest image of a mesh axis under any instance */
    double extent; /* longest edge of the mesh's bounds */
    fmt_bytes bytes;
    fmt_svdag svdag;
    bool svdag_open;
    svo_packed *packed;
    const svo_view *view;
    /* a mesh of a description that poses move by bones: */
    bool posed, has_clip; /* an instance's pose has bones or names an animation; it names one */
    svo_mesh mesh;        /* of a description: until the asset is built */
    fmt_rig rig;
    svo_mesh alone;       /* of a mesh scene: the shape in its own coordinates (borrowed), at `place` */
    svo_instance place;
    fmti_rigged *rigged;  /* of whatever has bones; NULL otherwise */
    uint32_t *pose_of;    /* [stated pose + 1]: new pose + 1 */
    uint64_t pose_slots;
} fmti_entry;

struct fmt_scene_build {
    fmt_scene_build_options options;
    const svo_allocator *allocator;
    char hash[33];
    uint32_t count;
    fmti_entry *entries;
    fmt_scene_build_asset *infos;
    const svo_view **views;
    const char **names;
    fmt_scene_json json;
    svo_mesh mesh; /* of a mesh scene, until its assets are built */
    fmt_rig rig;
    svo_buffer places, place_names;
    svo_buffer poses, matrices, frames; /* poses made of animations, their matrices, and the frame of each (u32) */
    svo_pack_input input;
    svo_packed_scene *packed;
};

/* fmt_scene_build.c */
svo_result fmti_scene_no_memory(svo_error *err);
svo_result fmti_scene_entries(fmt_scene_build *b, uint32_t count, svo_error *err);
void fmti_scene_phase(const fmt_scene_build *b, const char *name);
void fmti_scene_progress(const fmt_scene_build *b, uint64_t done); /* of b->count assets */
const char *fmti_last_part(const char *path);
char *fmti_clean_name(const fmt_scene_build *b, const char *name);
/* What an entry has only while it is built. */
void fmti_entry_rig_free(const fmt_scene_build *b, fmti_entry *e);
void fmti_look_at_places(fmt_scene_build *b, const svo_place *places, uint64_t count); /* used and scale of every entry */

/* fmt_scene_meshes.c */
fmt_import_options fmti_import_options(const fmt_scene_build *b, bool skip_images);
double fmti_mesh_extent(const svo_mesh *mesh); /* longest edge of the bounds of what it places; 0 when there is nothing */
double fmti_scene_voxel(const fmt_scene_build *b);
/* Levels that an asset needs for voxels of at most `voxel` in the scene. */
svo_result fmti_needed_depth(const fmt_scene_build *b, const fmti_entry *e, double voxel, uint32_t *depth, svo_error *err);
/* shape: in the rig, with e->rigged and a mesh of one shape. */
svo_result fmti_build_mesh(fmt_scene_build *b, fmti_entry *e, const svo_mesh *mesh, uint32_t shape, uint32_t depth, svo_error *err);
void fmti_warn_coarse(const fmt_scene_build *b);
svo_result fmti_load_mesh_scene(fmt_scene_build *b, const char *path, const fmt_bytes *file, svo_error *err);

/* fmt_scene_rig.c: poses of a description whose assets have rigs. Places get numbers of new poses. */
svo_result fmti_scene_resolve_poses(fmt_scene_build *b, svo_error *err);
/* After all frames: matrices and poses for svo_pack. */
svo_result fmti_scene_finish_poses(fmt_scene_build *b, svo_error *err);
/* A new pose of entry e with the parts of `stated` (flags other than bones) and a frame; *out is its number + 1. */
svo_result fmti_scene_add_pose(fmt_scene_build *b, const fmti_entry *e, const svo_pose *stated, uint32_t frame, uint32_t *out, svo_error *err);

#endif
