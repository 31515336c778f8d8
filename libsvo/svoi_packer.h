/* What the parts of svo_pack share: the scene that is being packed and the scratch of one call. */
#ifndef SVOI_PACKER_H
#define SVOI_PACKER_H

#include "svo_pack.h"
#include "svoi_pack.h"

/* A used asset of the input. */
typedef struct svoi_pack_source {
    svo_view view; /* shallow copy; voxel_to_world may be moved */
    double shift[3]; /* mesh coordinates = moved coordinates + shift */
    svo_extent extent;
} svoi_pack_source;

struct svo_packed_scene {
    svo_scene scene;
    svo_pack_report report;
    const svo_allocator *allocator;
    uint32_t input_assets;
    svoi_pack_source *sources; /* input_assets; zero where not used */
    const svo_view **views; /* input_assets slots; the first scene.asset_count are used */
    const char **asset_names;
    uint64_t capacity; /* slots of the instance arrays */
    uint32_t *asset, *name;
    float *transform;
    uint64_t *id;
    uint32_t page_capacity;
    svo_scene_page *pages;
    svo_buffer names;
    svoi_pose_table poses;
    uint32_t *pose; /* of each instance, or NULL */
};

/* Scratch of one call. */
typedef struct svoi_packer {
    const svo_pack_input *in;
    svo_packed_scene *out;
    const svo_allocator *allocator;
    svo_warnings *warnings;
    uint32_t threads;
    uint64_t page_instances;
    uint64_t kept;
    uint64_t *order;   /* kept places, input order, then grouped by page */
    uint64_t *scratch; /* kept */
    uint64_t *keys;    /* kept */
    double *centre;    /* 3 for every place of the input */
    uint32_t *pose;    /* of every place of the input: number in the table, or SVO_NO_POSE; NULL when the input has none */
    bool keep_bones;
} svoi_packer;

svo_result svoi_pack_no_memory(svo_error *err, const char *what, uint64_t count);

/* The transform of a place, for the moved coordinates of its asset. */
svo_mat4 svoi_pack_transform(const svoi_packer *p, const svo_place *place);

/* Kept assets that are equal to an earlier one become SVO_PACK_EQUAL; the others get numbers in the order of the input (svo_pack_equal.c). */
svo_result svoi_pack_merge_assets(svoi_packer *p, svo_error *err);

/* Group p->order into pages of at most page_instances by a k-d tree over the middles of the instances' bounds (svo_pack_pages.c). */
svo_result svoi_pack_make_pages(svoi_packer *p, svo_error *err);
/* Origin, bounds, transforms, assets, ids and poses of all pages. */
svo_result svoi_pack_fill_pages(svoi_packer *p, svo_error *err);

#endif
