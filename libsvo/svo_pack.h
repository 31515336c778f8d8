/* Instances to pages: leaves out what a scene does not need, groups what is left by place, and gives a svo_scene. */
#ifndef SVO_PACK_H
#define SVO_PACK_H

#include "svo_scene.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One instance as a scene states it, in double precision. */
typedef struct svo_place {
    double transform[12]; /* row-major 3x4, mesh coordinates of the asset to scene */
    uint64_t id;
    uint32_t asset; /* < asset_count */
    uint32_t name;  /* offset into names, 0 = none */
    uint32_t pose;  /* number of a pose + 1, 0 = none */
} svo_place;

typedef struct svo_pack_input {
    uint32_t asset_count;
    const svo_view *const *assets;    /* NULL for an asset that no instance names */
    const char *const *asset_names;   /* UTF-8 */
    uint64_t place_count;
    const svo_place *places;
    svo_poses poses;    /* as stated (svo_pose_resolve), in mesh coordinates */
    const char *names;  /* NUL-terminated UTF-8 strings, the first one empty; may be NULL when no place has a name */
    uint64_t names_size;
    bool has_camera;
    svo_mat4 camera_transform;
    double camera_yfov;
} svo_pack_input;

typedef struct svo_pack_options {
    uint32_t page_instances; /* largest number of instances in a page; 0 = 1024 */
    bool keep_bones;         /* keep the channel `bone` of assets whose instances have no bones in their poses */
    uint32_t threads;        /* 0 = all */
    const svo_allocator *allocator;
    svo_warnings *warnings;
} svo_pack_options;

/* What became of an asset of the input. */
typedef enum svo_pack_fate { SVO_PACK_KEPT, SVO_PACK_UNUSED, SVO_PACK_EMPTY, SVO_PACK_EQUAL } svo_pack_fate;
typedef struct svo_pack_asset {
    svo_pack_fate fate;
    uint32_t packed;    /* number in the packed scene (KEPT, EQUAL) */
    uint64_t instances; /* in the packed scene */
    bool bones;         /* an instance's pose has bones */
    bool moved;         /* its coordinates were moved to the middle of its grid, see docs/design/004-scenes.md */
} svo_pack_asset;

typedef struct svo_pack_report {
    svo_pack_asset *assets; /* input.asset_count; freed with the scene */
    uint64_t kept;          /* instances */
    uint64_t dropped_empty; /* instances of assets without voxels */
    uint64_t dropped_hidden; /* scale 0 on all axes: glTF's way to hide */
    uint64_t dropped_flat;  /* singular: they have no volume to draw */
    uint64_t posed;          /* instances with a pose */
    uint64_t poses_rest;     /* of the kept instances: poses that move nothing, left out */
    uint64_t poses_shared;   /* poses equal to one that is stored already */
    uint64_t bones_rest;     /* matrices of bones that move nothing, at the end of a pose's list */
    uint64_t matrices_shared; /* of poses, stored already */
    uint32_t bone_channels;  /* channels `bone` left out, as no pose of the asset's instances has bones */
    uint64_t bone_channel_bytes;
    double translation_error; /* largest distance that rounding moved an instance's origin, scene units */
} svo_pack_report;

/* A packed scene in memory. `scene` points into it and into the views and asset names of the input, which must outlive it. */
typedef struct svo_packed_scene svo_packed_scene;
const svo_scene *svo_packed_scene_get(const svo_packed_scene *p);
const svo_pack_report *svo_packed_scene_report(const svo_packed_scene *p);
void svo_packed_scene_free(svo_packed_scene *p);

/* Pack. Assets that no (kept) instance names are left out; assets that are equal in every stored byte are merged into
 * the first; the names that are left are shared. Instances are split by a k-d tree into pages of at most page_instances
 * (all full but the last of a split), in the order of the input inside a page. The result depends on the input only, not
 * on threads. A transform that is not finite in single precision is SVO_INVALID_DATA; an asset too large to be placed in
 * it, or too far from the others of a page, is SVO_LIMIT (err->index = the place), and so is a name table beyond 4 GiB.
 * Memory: about 100 bytes an instance besides the result's 64. */
svo_result svo_pack(const svo_pack_input *input, const svo_pack_options *options, svo_packed_scene **out, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
