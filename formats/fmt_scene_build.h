/* Everything that svo-pack takes, to a packed scene in memory: a scene description in JSON with its assets, a glTF scene,
 * any other mesh, an octree file. */
#ifndef FMT_SCENE_BUILD_H
#define FMT_SCENE_BUILD_H

#include "fmt_file.h"
#include "svo_dag.h"
#include "svo_pack.h"
#include "svo_voxelize.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct fmt_scene_build_options {
    /* For meshes. With voxel_size 0 a voxel in the scene is at most the largest asset's extent (with its largest
     * instance's scale) over 2^depth, for every asset: smaller assets get fewer levels. With voxel_size > 0 it is at most
     * voxel_size; a mesh that needs more than SVO_MAX_DEPTH levels for it is SVO_LIMIT. */
    uint32_t depth;
    double voxel_size;
    svo_voxelize_options voxelize; /* surface, fill, channels, threads, memory, allocator, warnings; not depth, voxel_size */
    svo_dag_options dag;
    uint32_t page_instances; /* 0 = default */
    /* glTF scenes: nodes stand, and skins are posed, as this animation (its name or number) has them at `time` seconds; NULL: as they stand in the file. */
    const char *animation;
    double time;
    bool bake_skins; /* skinned meshes as they stand, without bones and poses */
    void (*phase)(void *user, const char *name); /* called when a phase begins: read, voxelize, pack; may be NULL */
    void (*progress)(void *user, uint64_t done, uint64_t total); /* called in the phases read and voxelize: assets that are done; may be NULL */
    void *user;
    fmt_file_read_fn file_read; /* told of every file that is read, the scene itself too; of some twice. NULL: not wanted */
    void *file_read_user;
} fmt_scene_build_options;
fmt_scene_build_options fmt_default_scene_build_options(void); /* depth 10 */

typedef struct fmt_scene_build_asset {
    const char *name, *file; /* file: as in the description, or the last part of the scene's own path */
    const char *source;      /* "svdag", "svo", "mesh" */
    uint64_t source_bytes;   /* of the file, also where it was not opened; 0 for meshes inside a glTF scene */
    char hash[33];           /* of what was read: the content hash of our files, else of the mesh file's bytes; "" when not opened */
    uint32_t depth;
    uint64_t voxels;
    uint32_t bones, bones_kept; /* of a mesh that poses move by its bones */
    uint64_t bones_left_out;    /* matrices: of all its poses, of bones that move nothing or that nothing follows */
    svo_pack_asset packed;
} fmt_scene_build_asset;

typedef struct fmt_scene_build fmt_scene_build;

/* Assets that no instance names are not opened. SVO_IO when a file is missing, SVO_INVALID_DATA for a broken one; messages
 * begin with the name of the file. Files of a description are looked for in its folder; "-" is a description on
 * stdin, whose folder is the current one. Result does not depend on threads. */
svo_result fmt_scene_build_open(const char *path, const fmt_scene_build_options *options, fmt_scene_build **out, svo_error *err);
const svo_scene *fmt_scene_build_scene(const fmt_scene_build *b);
const svo_pack_report *fmt_scene_build_report(const fmt_scene_build *b);
/* All assets of the source, packed or not, in its order. */
const fmt_scene_build_asset *fmt_scene_build_assets(const fmt_scene_build *b, uint32_t *count);
/* Hash of the description or mesh file itself (32 hexadecimal digits). */
const char *fmt_scene_build_hash(const fmt_scene_build *b);
void fmt_scene_build_close(fmt_scene_build *b);

#ifdef __cplusplus
}
#endif
#endif
