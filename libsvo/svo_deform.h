/* Sparse volumetric deformation (Willcocks 2013, chapter 3): where the boxes of an octree go under an instance's pose and transform.
 *
 * A box is mapped to an axis-aligned box that encloses the image of every point of it. Figure 16 of the thesis maps a voxel by the two matrices
 * at its two extreme corners and joins the two boxes; here these are the matrices of the slices through its two ends, and the result is widened by the
 * largest distance between the curve that a point really follows and the chord between the two: second derivative * length^2 / 8. So
 *  - images of boxes that touch, touch: both hold the image of what they share. Figure 16 alone keeps neighbours joined that share an extreme corner's
 *    matrix, but not neighbours at different levels, nor long boxes in a steep twist;
 *  - the image of an octree's node holds the images of all nodes below it, which hierarchical selection needs (a test: at any angle). */
#ifndef SVO_DEFORM_H
#define SVO_DEFORM_H

#include "svo_bones.h"
#include "svo_pose.h"
#include "svo_scene.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Figure 16: bounds of a box under both matrices (3x4 rows of svo_mat4). */
void svo_deform_two(const svo_mat4 a[2], const double low[3], const double high[3], double out_low[3], double out_high[3]);

/* A part that moves slices across an axis: twist or bend. Private. */
typedef struct svo_slices {
    uint32_t axis, u, v; /* twist: turns u towards v; bend: axis line bends towards u */
    double from, to, angle;
} svo_slices;

/* Matrices of slices that were asked for last: neighbours, parents and children have theirs in common. Of one map at a time, for one thread. */
enum { SVO_SLICES_KEPT = 256 };
typedef struct svo_slice { uint64_t map; double at, angle, all[12]; bool twist; } svo_slice;
typedef struct svo_slice_cache {
    uint64_t map; /* number of the map whose slices count; one more for the next map. From 1 on */
    svo_slice slice[SVO_SLICES_KEPT];
} svo_slice_cache;

/* An instance's map from the grid of its asset to a target space, made ready. Plain data, owns nothing; the scene's arrays are borrowed. */
typedef struct svo_deform {
    uint32_t flags; /* of the pose */
    svo_mat4 in;    /* grid to the pose's coordinates, relative to its pivot, after its matrix */
    svo_mat4 out;   /* pose's coordinates relative to the pivot to the target space */
    svo_slices twist, bend;
    svo_mat4 grid;  /* grid to mesh; with bones, `in` is what comes after them */
    const svo_poses *poses;
    uint32_t bone_first, bone_count;
    svo_slice_cache *kept; /* NULL: none. Borrowed; changes no result, and then one thread at a time may use the map */
} svo_deform;

/* pose NULL: none. grid_to_mesh: the asset's voxel_to_world; mesh_to_target: the instance's transform (or any affine map after it). */
svo_deform svo_deform_make(const svo_poses *poses, const svo_pose *pose, const svo_mat4 *grid_to_mesh, const svo_mat4 *mesh_to_target);

/* Image of a point, box (as said above) and unit normal at a point, for what follows one bone: a label of the channel `bone`, SVO_NO_BONE for what rests; it means
 * nothing to a pose without bones. A box that overflows has bounds that are not finite. */
svo_vec3 svo_deform_point(const svo_deform *d, uint32_t bone, svo_vec3 p);
void svo_deform_box(const svo_deform *d, uint32_t bone, const double low[3], const double high[3], double out_low[3], double out_high[3]);
/* `edge`: of the voxel at p, grid units. Zero where the map is flat there. n in mesh coordinates. */
svo_vec3 svo_deform_normal(const svo_deform *d, uint32_t bone, svo_vec3 p, double edge, svo_vec3 n);

/* The same for what follows several bones. A point goes to the sum of weight * image under the bone's matrix, and then through the pose's other parts. The box holds the images
 * under all weights that the list allows. Points and normals are those for weights in the middle of the ranges. */
svo_vec3 svo_deform_blended_point(const svo_deform *d, svo_bone_list list, svo_vec3 p);
void svo_deform_blended_box(const svo_deform *d, svo_bone_list list, const double low[3], const double high[3], double out_low[3], double out_high[3]);
svo_vec3 svo_deform_blended_normal(const svo_deform *d, svo_bone_list list, svo_vec3 p, double edge, svo_vec3 n);
/* How much of a surface one of its voxels stands for after the map, as an area in the target's units: the volume of a voxel at p with that edge (grid units) over the thickness of a layer of
 * voxels around a surface with normal n (mesh coordinates), mapped as that area is. `thin`: of a 6-separating surface, else of a conservative one. n 0: the mean of the three axes. */
double svo_deform_blended_area(const svo_deform *d, svo_bone_list list, svo_vec3 p, double edge, svo_vec3 n, bool thin);

/* Bounds of an asset's voxels under a pose (NULL: none); false when they are not finite. Long twists and bends are cut into pieces, so that the bounds are within a few
 * percent; of bones each moves the box of the voxels that follow it. */
bool svo_deform_bounds(const svo_poses *poses, const svo_pose *pose, const svo_mat4 *grid_to_mesh, const svo_mat4 *mesh_to_target, const svo_extent *extent, double low[3],
                       double high[3]);
/* The same for an instance of a scene. */
bool svo_scene_instance_bounds(const svo_scene *s, uint32_t page, uint64_t instance, const svo_extent *extent, double low[3], double high[3]);
/* The extents of all assets, as many as there are (each freed by svo_extent_free; after an error none is left); bones are told apart where an instance's pose has some. */
svo_result svo_scene_extents(const svo_scene *s, const svo_allocator *a, svo_extent *out, svo_error *err);

/* A copy of a scene in which every instance has the pose as stated (its matrix is the one given, its bones are not used), with new bounds of the pages. The
 * source is borrowed. Errors: SVO_INVALID_ARGUMENT where the pose cannot be used, SVO_LIMIT where an asset is too large to be deformed in single
 * precision, SVO_OUT_OF_MEMORY. */
typedef struct svo_posed_scene svo_posed_scene;
svo_result svo_scene_pose_all(const svo_scene *s, const svo_pose *stated, const float matrix[12], const svo_allocator *a, svo_posed_scene **out, svo_error *err);
const svo_scene *svo_posed_scene_get(const svo_posed_scene *p);
void svo_posed_scene_free(svo_posed_scene *p);

#ifdef __cplusplus
}
#endif
#endif
