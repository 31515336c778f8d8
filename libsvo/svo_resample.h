/* Deformed boxes to cells of one octree (Willcocks 2013, section 3.3), and a scene with poses to one without. */
#ifndef SVO_RESAMPLE_H
#define SVO_RESAMPLE_H

#include "svo_hierarchy.h"
#include "svo_select.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How boxes become cells of the octree. Both cover every box completely, so that what touched stays joined.
 *
 * RESIZE (3.3.6 to 3.3.9): cells half as wide as the smallest cell that is at least as wide as the box's longest side. The thesis sets two an axis around the
 * box's middle and says that they enclose it; they do not in 44 % of random boxes, as the box may be as long as both and not lie on their boundary. Here each
 * axis has the ones that the box meets, two or three along the longest, one to three along the others: 2 to 27 samples. (As printed, with a ceiling, they are never those that the box meets.)
 * EMIT (3.3.10 to 3.3.12): cells at least as wide as the box's shortest side, all that the box meets, with floors at both ends (the printed ceiling
 * leaves out the first). The number grows with the box's length; so a cell is also no smaller than a 2^-16th of the number of cells allowed (`most_cells`).
 * In both, cells are not finer than the octree's finest level, which is at most 21 below a cube around everything selected. */
typedef enum svo_resample_method { SVO_RESAMPLE_RESIZE = 1, SVO_RESAMPLE_EMIT = 2 } svo_resample_method;

typedef struct svo_resample_report {
    uint64_t boxes, samples;
    uint32_t depth;
    uint64_t clamped;   /* boxes whose cells would be finer than the finest level */
    uint64_t coarsened; /* emit: boxes with larger cells than (3.3.10) says, for their number */
    double seconds;
} svo_resample_report;

/* Cells of a selection. samples[i].value is the number of the box. The root cube holds all boxes. */
typedef struct svo_resampled {
    const svo_allocator *allocator;
    uint32_t depth;
    double voxel_to_world[16];
    uint64_t count;
    svo_sample *samples; /* in the order of the boxes */
    svo_resample_report report;
} svo_resampled;

/* most_cells: of one box, at least 64; 0 = 4096. */
svo_result svo_resample(const svo_selection *selection, svo_resample_method method, uint64_t most_cells, uint32_t threads, const svo_allocator *a,
                        svo_resampled *out, svo_error *err);
void svo_resampled_free(svo_resampled *r);

/* ---- a scene with poses ---------------------------------------------------------------------------------------------- */

typedef struct svo_unpose_options {
    svo_select_options select; /* allocator and threads are used for all; with `shadows` and culling, what can shade what is seen is kept (all of few instances, or where some have no pose) */
    bool shadows;
    svo_vec3 light;            /* towards it, any length > 0 */
    svo_resample_method method;
    bool reflections;   /* metallic and roughness are wanted */
    double reflectance; /* of assets that have neither, 0..1 */
    bool labels;        /* bones are wanted */
    uint64_t most_cells; /* of one box, as in svo_resample */
} svo_unpose_options;

typedef struct svo_unpose_report {
    svo_select_report select;
    svo_resample_report resample;
    svo_hierarchy_report hierarchy;
    double seconds_values; /* gathering attributes */
} svo_unpose_report;

/* A scene for one picture: all instances without a pose as they are (none with select.everything), and one more asset, an octree of what the picture needs of all others, in
 * scene coordinates. Its channels are normal, and color, emissive, coverage, metallic, roughness and bone (ID32) as far as an asset has them and they are wanted. Coverage is that
 * of cells, so many of which lie behind each other that together they cover about what the voxel does. `scene` is borrowed. */
typedef struct svo_unposed svo_unposed;
svo_result svo_unpose(const svo_scene *scene, const svo_unpose_options *options, svo_unposed **out, svo_unpose_report *report, svo_error *err);
const svo_scene *svo_unposed_scene(const svo_unposed *u);
/* The octree alone (empty when nothing was selected). */
const svo_view *svo_unposed_view(const svo_unposed *u);
void svo_unposed_free(svo_unposed *u);

#ifdef __cplusplus
}
#endif
#endif
