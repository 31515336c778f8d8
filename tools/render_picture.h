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

/* Render and write all frames: to `path`, or with frames != NULL to numbered files beside it (a.png: a_0000.png ...). Nothing appears
 * of a picture that fails. *stats sums up. bvh NULL: boxes of deformed voxels at least `boxes.delta` samples wide, without rays. */
svo_result picture_draw(cli *c, const svo_bvh *bvh, const svo_scene *scene, const svo_render_options *o, direct_boxes boxes, const char *path, const picture_frames *frames,
                        svo_render_stats *stats, uint64_t *bytes, svo_error *err);

#endif
