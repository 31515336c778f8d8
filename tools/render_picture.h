/* svo-render's pictures: one, or the frames of a turntable or camera path. */
#ifndef RENDER_PICTURE_H
#define RENDER_PICTURE_H

#include "cli.h"
#include "render_pose.h"
#include "svo_render.h"

typedef struct picture_frames {
    svo_eye *eyes;
    uint64_t count, capacity;
} picture_frames;
void picture_frames_free(picture_frames *f, const svo_allocator *a);

/* `count` views of a camera that goes once around the axis `up` through `middle`. */
svo_result picture_turntable(picture_frames *f, const svo_eye *first, svo_vec3 middle, svo_vec3 up, uint64_t count, const svo_allocator *a, svo_error *err);
/* A text file: a line a frame, "ex ey ez tx ty tz [fov]", eye and target and a field of view in degrees; # begins a comment. */
svo_result picture_path(picture_frames *f, const char *path, svo_vec3 up, double yfov, const svo_allocator *a, svo_error *err);

/* PNG and EXR are told apart by the name's end; "-" is PNG. */
bool picture_is_exr(const char *path);
bool picture_is_png(const char *path);

/* What is drawn. bvh NULL: boxes of deformed voxels at least `boxes.delta` samples wide, without rays. make != NULL: sets bvh and scene anew for the camera of each picture; what it made
 * before is its own. */
typedef struct picture_source {
    const svo_bvh *bvh;
    const svo_scene *scene;
    direct_boxes boxes;
    svo_result (*make)(void *user, const svo_render_options *o, struct picture_source *s, svo_error *err);
    void *user;
} picture_source;

/* Render and write all frames: to `path`, or with frames that are not empty to numbered files beside it (a.png: a_0000.png ...). Nothing appears
 * of a picture that fails. *stats sums up. */
svo_result picture_draw(cli *c, picture_source *s, const svo_render_options *o, const char *path, const picture_frames *frames, svo_render_stats *stats, uint64_t *bytes,
                        svo_error *err);

#endif
