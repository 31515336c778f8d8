/* .svscene: a packed, instanced scene that is mapped and drawn in place; docs/format/svscene.md is normative. */
#ifndef FMT_SCENE_H
#define FMT_SCENE_H

#include "fmt_container.h"
#include "fmt_svdag.h"
#include "svo_scene.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Bytes of a written scene by part; payloads with their chunk headers and padding. */
typedef struct fmt_scene_bytes {
    uint64_t assets, instances, pages, names, poses, rest; /* rest: header, HEAD, camera, META, table, footer */
} fmt_scene_bytes;

/* Write a scene (pages as svo_pack made them, or a mapped scene again). It is checked as fmt_scene_open checks a file,
 * its assets excepted, so that nothing is written that cannot be read: SVO_INVALID_ARGUMENT otherwise. Assets are stored
 * as .svdag images without provenance, one after the other, with one image in memory at a time. Same scene and
 * provenance (JSON text, may be NULL), same bytes. bytes, and asset_bytes (scene->asset_count sizes of the images), may be NULL. */
svo_result fmt_scene_write(fmt_output *out, const svo_scene *scene, const char *provenance, const svo_allocator *a,
                           fmt_scene_bytes *bytes, uint64_t *asset_bytes, svo_error *err);

/* The same with a provenance that is made when everything else is written: it may tell of sizes. `tell` gets asset_bytes, which must be there, and gives the text,
 * which free() frees; NULL is SVO_OUT_OF_MEMORY. */
typedef char *(*fmt_scene_tell_fn)(void *user, const uint64_t *asset_bytes);
svo_result fmt_scene_write_telling(fmt_output *out, const svo_scene *scene, fmt_scene_tell_fn tell, void *user, const svo_allocator *a, fmt_scene_bytes *bytes,
                                   uint64_t *asset_bytes, svo_error *err);

enum { FMT_SCENE_ARRAYS = 6 };

/* An opened file. Arrays of `scene` point into the file's bytes, which must outlive it. All hashes are checked,
 * every asset is opened by fmt_svdag_open, and every rule of docs/format/svscene.md holds when this returns SVO_OK.
 * Memory: the table of chunks and a few hundred bytes an asset; nothing an instance. Do not copy the struct: scene
 * points into what it owns, not into the struct itself, so moving it is fine, closing it twice is not. */
typedef struct fmt_scene {
    svo_scene scene;
    fmt_container container;
    fmt_svdag *assets;     /* scene.asset_count; scene.assets point to their views */
    const svo_view **views;
    const char **asset_names;
    char *provenance; /* JSON text or "" */
    const uint8_t *page_hashes;
    svo_buffer copies[FMT_SCENE_ARRAYS]; /* of the arrays of a scene opened partly, without what is damaged */
    const svo_allocator *allocator;
} fmt_scene;
svo_result fmt_scene_open(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_scene *out, svo_error *err);
/* Everything that is wrong with the file goes to `rules`, as in fmt_svdag_violations; what is wrong inside an asset as well. */
svo_result fmt_scene_violations(const uint8_t *data, uint64_t size, const svo_allocator *a, svo_rules *rules, svo_error *err);
/* The same as fmt_scene_open, but what is damaged is left out: pages whose bytes are not those that were written (each page has a hash of its own), assets that cannot be opened,
 * and instances of such assets. The rest is checked as ever; damage to anything else is an error. */
typedef struct fmt_scene_loss { uint64_t pages, assets, instances; } fmt_scene_loss;
svo_result fmt_scene_open_partly(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_scene *out, fmt_scene_loss *loss, svo_error *err);
/* Zeroes *s; a zeroed one is fine. */
void fmt_scene_close(fmt_scene *s);

#ifdef __cplusplus
}
#endif
#endif
