/* Parts of svo-compare: each fills a JSON object with what was found, which is printed as text or as it is. */
#ifndef COMPARE_H
#define COMPARE_H

#include "cli.h"
#include "fmt_container.h"
#include "fmt_image.h"

/* An input whose kind has been recognised by its content. */
typedef struct compare_input {
    const char *path; /* "-" is stdin */
    bool image;     /* of 8 bits, or nothing that is known */
    bool floats;    /* an OpenEXR picture */
    fmt_kind kind;  /* when it is neither */
    bool loaded;    /* bytes holds the file */
    fmt_bytes bytes;
} compare_input;

/* Whole file into bytes (mapped where possible), once. */
svo_result compare_load(compare_input *in, const cli *c, const svo_allocator *a, svo_error *err);

typedef struct compare_tolerance {
    double psnr, ssim, max_diff, float_diff;
    bool psnr_set, ssim_set, max_diff_set;
    double delta_e, degrees, value;
    bool geometry_only;
    uint64_t max_voxels;
} compare_tolerance;

typedef struct compare_job {
    cli *c;
    compare_input in[2]; /* A is the reference */
    compare_tolerance tolerance;
    const svo_allocator *allocator;
    json_t *json;    /* "kind", "identical", "differs", "reasons" and the measures */
    json_t *reasons; /* texts: why the inputs differ beyond tolerance; borrowed from json */
} compare_job;

void compare_reason(compare_job *j, const char *format, ...) SVO_PRINTF(2, 3);

/* Is this an image that can be decoded? The message says what else it could have been. */
svo_result compare_can_read(compare_job *j, compare_input *in, svo_error *err);
svo_result compare_images(compare_job *j, svo_error *err);
/* OpenEXR pictures, plane by plane. */
svo_result compare_floats(compare_job *j, svo_error *err);
svo_result compare_octrees(compare_job *j, svo_error *err);
/* .skel and .svscene: validity of both, then chunk by chunk. */
svo_result compare_containers(compare_job *j, svo_error *err);

/* Text of j->json to stdout. */
void compare_print(const compare_job *j);

#endif
