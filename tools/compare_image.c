#include <math.h>
#include <string.h>

#include "compare.h"
#include "svo_compare.h"

/* Name the file in a decoder's message. */
static svo_result read_image(compare_input *in, compare_job *j, svo_image *out, svo_error *err)
{
    SVO_TRY(compare_load(in, j->c, j->allocator, err));
    svo_error inner = {0};
    const char *name = strcmp(in->path, "-") == 0 ? "stdin" : in->path;
    if (!fmt_image_is_known(in->bytes.data, in->bytes.size))
        return svo_fail(err, SVO_INVALID_DATA, "%.150s: %s", name, in->bytes.size == 0 ? "the file is empty" : "neither an .svo, .svdag, .svscene or .skel nor an image (PNG, JPEG, BMP, TGA, OpenEXR)");
    svo_result r = fmt_image_decode(in->bytes.data, in->bytes.size, 0, j->allocator, out, &inner);
    return r == SVO_OK ? r : svo_fail(err, r, "%.150s: %s", name, inner.message);
}

svo_result compare_can_read(compare_job *j, compare_input *in, svo_error *err)
{
    svo_image image;
    SVO_TRY(read_image(in, j, &image, err));
    fmt_image_free(j->allocator, &image);
    return SVO_OK;
}

static void check_tolerances(compare_job *j, const svo_compare_image *r)
{
    const compare_tolerance *t = &j->tolerance;
    if (t->psnr_set && r->psnr_all < t->psnr) compare_reason(j, "PSNR is %.4f dB, below %.10g", r->psnr_all, t->psnr);
    if (t->ssim_set && isnan(r->ssim)) compare_reason(j, "SSIM is not defined for images below 11 x 11 pixels");
    else if (t->ssim_set && r->ssim < t->ssim) compare_reason(j, "SSIM is %.6f, below %.10g", r->ssim, t->ssim);
    if (t->max_diff_set && r->max_difference > t->max_diff)
        compare_reason(j, "the largest difference is %u, above %.10g", r->max_difference, t->max_diff);
    if (!t->psnr_set && !t->ssim_set && !t->max_diff_set && r->different > 0)
        compare_reason(j, "%llu pixels differ", (unsigned long long)r->different);
}

static svo_result measure(compare_job *j, const svo_image *a, const svo_image *b, svo_error *err)
{
    svo_compare_image r;
    SVO_TRY(svo_compare_images(a, b, j->allocator, &r, err));
    json_t *o = j->json, *psnr = json_object();
    static const char *const names[4] = {"r", "g", "b", "a"};
    json_object_set_new(o, "identical", json_boolean(r.different == 0));
    for (int k = 0; k < (r.alpha ? 4 : 3); k++) cli_put_f64(psnr, names[k], r.psnr[k]);
    cli_put_f64(psnr, "all", r.psnr_all);
    json_object_set_new(o, "psnr_db", psnr);
    cli_put_f64(o, "mse", r.mse_all);
    cli_put_f64(o, "ssim", r.ssim);
    cli_put_u64(o, "pixels", r.pixels);
    cli_put_u64(o, "different_pixels", r.different);
    cli_put_f64(o, "different_share", (double)r.different / (double)r.pixels);
    cli_put_u64(o, "max_difference", r.max_difference);
    json_t *errors = cli_section(j->c, "errors");
    cli_put_f64(errors, "psnr_db", r.psnr_all);
    cli_put_f64(errors, "ssim", r.ssim);
    cli_put_u64(errors, "max_difference", r.max_difference);
    cli_put_u64(errors, "different_pixels", r.different);
    check_tolerances(j, &r);
    return SVO_OK;
}

svo_result compare_images(compare_job *j, svo_error *err)
{
    svo_image image[2] = {{0}, {0}};
    svo_result r = SVO_OK;
    for (int i = 0; i < 2 && r == SVO_OK; i++) {
        r = read_image(&j->in[i], j, &image[i], err);
        if (r != SVO_OK) break;
        json_t *side = json_object_get(j->json, i == 0 ? "a" : "b");
        cli_put_u64(side, "width", image[i].width);
        cli_put_u64(side, "height", image[i].height);
        json_object_set_new(side, "alpha", json_boolean(image[i].has_alpha));
    }
    if (r == SVO_OK && (image[0].width != image[1].width || image[0].height != image[1].height)) {
        json_object_set_new(j->json, "identical", json_false());
        compare_reason(j, "the sizes differ: %u x %u and %u x %u pixels", image[0].width, image[0].height, image[1].width, image[1].height);
    } else if (r == SVO_OK) {
        r = measure(j, &image[0], &image[1], err);
    }
    for (int i = 0; i < 2; i++) fmt_image_free(j->allocator, &image[i]);
    return r;
}
