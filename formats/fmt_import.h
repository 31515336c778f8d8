/* Mesh import: files of other people's formats into svo_mesh. */
#ifndef FMT_IMPORT_H
#define FMT_IMPORT_H

#include "fmt_file.h"
#include "svo_mesh.h"
#include "svo_spill.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Textures that the caller does not read. They are neither opened nor decoded, and materials have none in their place. Alpha of cut-outs (MASK) stays:
 * it decides where a surface is. So without COLOR base colours are read for that alone, from images that can have alpha. */
enum { FMT_WITHOUT_COLOR = 1, FMT_WITHOUT_EMISSIVE = 2, FMT_WITHOUT_METALLIC_ROUGHNESS = 4 };

typedef struct fmt_import_options {
    const svo_allocator *allocator; /* NULL = default */
    uint64_t max_file_bytes;        /* a file (also one referred to); 0 = 16 GiB */
    uint64_t max_image_pixels;      /* 0 = 2^28 */
    bool skip_images;               /* do not decode textures, not even for alpha */
    uint32_t without;               /* FMT_WITHOUT_...: textures that nobody reads */
    uint32_t threads;               /* 0 = all; the mesh does not depend on it */
    uint64_t block_bytes;           /* text is cut into blocks of about this size, which are read in parallel; 0 = 1 MiB; nor on this */
    svo_warnings *warnings;         /* may be NULL */
    /* Called for every file that was read, the model first and then what it refers to (materials, buffers, textures), in
     * the order of reading, with its path as it was opened and its bytes, which are valid during the call, or until what it returns has been waited
     * for (fmt_file.h). May be NULL. An image that is used twice may be read, and told, twice. */
    fmt_file_read_fn file_read;
    void *file_read_user;
    /* Where a mesh goes that does not fit in `memory` bytes (0 = no limit) beside its builder: its parts are spilled then
     * (svo_soup.h). Works for all but .drc and the parts of a glTF file that Draco packed, which are read into memory. NULL: never. */
    const svo_spill *spill;
    uint64_t memory;
    /* Where the nodes, skins and animations of a glTF file go; zeroed before, freed by the caller. Meshes with a skin then keep the
     * coordinates of the file and stand at fmt_rig_place; without it they are skinned as the nodes stand. */
    struct fmt_rig *rig;
    const char *animation; /* with rig: nodes stand as this animation (fmt_rig_find) has them at `time`; NULL: as in the file */
    double time;
    svo_pager *pager; /* where textures go that do not fit in memory; it must outlive the mesh. NULL: they stay in memory */
} fmt_import_options;

/* Format by content first, then by extension: .gltf .glb .obj .ply .stl .off .drc. Unknown = SVO_UNSUPPORTED; a file
 * that breaks its format's rules in a way that would give a wrong mesh = SVO_INVALID_DATA; a missing file = SVO_IO.
 * A mesh without triangles is not an error (it warns). What is ignored (textures that are missing, points and lines ...) is named in a warning. A required glTF extension that is not supported is
 * SVO_UNSUPPORTED. A file (also one referred to) that changes while the import reads is SVO_IO. Files referred to are looked for beside `path` only; paths that leave that folder are refused. */
svo_result fmt_import_mesh(const char *path, const fmt_import_options *options, svo_mesh *out, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
