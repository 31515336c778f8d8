/* svo-render: deformation options, and scenes with poses made ready for one picture. */
#ifndef RENDER_POSE_H
#define RENDER_POSE_H

#include "cli.h"
#include "svo_resample.h"

/* twist=AXIS:DEG, bend=AXIS TOWARDS:DEG, shear=AXIS BY:K, scale=K or scale=X:Y:Z, joined by commas. Returns what is wrong (static text), NULL when
 * nothing is. */
const char *parse_deform(const char *text, svo_pose *stated, float matrix[12]);

/* The scene with every instance posed as --deform says (NULL: no such option). Closed with the picture. */
typedef struct posing {
    svo_posed_scene *posed;
    svo_unposed *unposed;
} posing;

/* The decision tree of figure 29: what --resample auto means here. */
enum { RESAMPLE_AUTO, RESAMPLE_DIRECT, RESAMPLE_RESIZE, RESAMPLE_EMIT, RESAMPLE_MIPMAP };
typedef struct direct_boxes { double delta; bool mipmap, culling; } direct_boxes;
static inline bool draws_boxes(int resample) { return resample == RESAMPLE_DIRECT || resample == RESAMPLE_MIPMAP; }

svo_result pose_scene(posing *p, const svo_scene **scene, const svo_pose *stated, const float matrix[12], const svo_allocator *a, svo_error *err);
bool has_poses(const svo_scene *scene);

/* Replace *scene by one that the ray caster takes; `select` says what the picture needs. Reports under "deformation". labels: bones are wanted. save: path of an .svo,
 * or NULL. */
svo_result unpose_scene(posing *p, cli *c, const svo_scene **scene, const svo_select_options *select, const svo_render_options *look, int resample, bool labels, const char *save,
                        svo_error *err);
void posing_close(posing *p);

/* What --resample auto is: boxes as they are when nothing but the eye asks what is where, else cells that follow them (figure 29, for a renderer without a budget
 * of time). */
int choose_resample(int asked, bool rays);

/* The picture of all instances by their boxes (--resample direct). */
svo_result draw_direct(cli *c, const svo_scene *scene, const svo_render_options *o, direct_boxes boxes, uint8_t *pixels, svo_render_stats *stats, svo_error *err);

#endif
