/* Scene descriptions in JSON: docs/tools/svo-pack.md describes the format. */
#ifndef FMT_SCENE_JSON_H
#define FMT_SCENE_JSON_H

#include "svo_pack.h"

#ifdef __cplusplus
extern "C" {
#endif

/* An element of the file, object by object, may be at most this long; so memory follows from what is kept. */
#define FMT_SCENE_JSON_ELEMENT_BYTES 65536u

typedef struct fmt_scene_json_asset {
    char *name;
    char *file; /* relative path without "..", not absolute */
} fmt_scene_json_asset;

/* A pose that is that of an animation at a time. */
typedef struct fmt_scene_json_clip {
    uint32_t pose;      /* its number; ascending */
    uint32_t animation; /* name or number: an offset into names; 0: the first one */
    double time;        /* seconds */
} fmt_scene_json_clip;

typedef struct fmt_scene_json {
    const svo_allocator *allocator;
    uint32_t asset_count;
    fmt_scene_json_asset *assets;
    uint64_t place_count;
    const svo_place *places;
    const char *names; /* of instances, and others; offset 0 is "" */
    uint64_t names_size;
    svo_poses poses; /* as stated */
    uint64_t clip_count;
    const fmt_scene_json_clip *clips; /* poses that come from animations */
    bool has_camera;
    svo_mat4 camera_transform;
    double camera_yfov;
    svo_buffer storage[6]; /* private: assets, places, names, poses, matrices, clips */
} fmt_scene_json;

/* Parse `size` bytes of UTF-8. Every rule is checked: unknown keys, wrong types, numbers that are not finite, paths that
 * leave the folder, unknown and duplicate assets are SVO_INVALID_DATA with the path of the key (and the line, for
 * errors of syntax) in the message; more than 2^32 - 1 instances, 2^20 assets or 4 GiB of names are SVO_LIMIT. No file is touched. Memory: 112 bytes an
 * instance, the names, 64 bytes a pose of its own, 48 a matrix (the matrices of a pose reach to its highest bone; all of them may be 64 times as large as the
 * text and 64 MiB, more is SVO_LIMIT). */
svo_result fmt_scene_json_parse(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_warnings *warnings,
                                fmt_scene_json *out, svo_error *err);
/* Frees and zeroes. */
void fmt_scene_json_free(fmt_scene_json *s);

#ifdef __cplusplus
}
#endif
#endif
