/* svo-compare: how much two images or two of our files differ. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "compare.h"
#include "exr_read.h"

static const char DETAILS[] =
    "A is the reference: colour differences are weighted by its chroma.\n"
    "\n"
    "Images (PNG, JPEG, BMP, TGA) must have the same size. PSNR is over the stored 8-bit values, of each channel and of all "
    "(alpha counts where one of the images has any). SSIM is that of Wang et al. 2004 on luma. Without a tolerance any "
    "difference counts; with one or more of them, these decide.\n"
    "\n"
    "OpenEXR pictures of the same size are compared plane by plane: floats by their difference, integers (labels) as equal or not. Infinite or not a number in both is no difference.\n"
    "\n"
    "Octrees (.svo and .svdag in any mix) are compared by voxels: which of them only one has, and how far the attributes of the "
    "common ones are apart: colours as delta E CIE94 (graphic arts, CIELAB D65), normals in degrees, metallic and roughness as "
    "values 0..1, labels as equal or not. Another depth, another voxel_to_world or another set of channels is a difference.\n"
    "\n"
    "Scenes (.svscene) and skeletons (.skel) are compared by their content, chunk by chunk.";

static bool set_psnr, set_ssim, set_max_diff;
static compare_tolerance tolerance = {.max_voxels = (uint64_t)1 << 34, .max_diff = 0, .ssim = 1, .psnr = 100};
static uint64_t max_diff;
static bool as_json;

static const cli_option options[] = {
    {.name = "json", .kind = CLI_FLAG, .value = &as_json, .help = "Print JSON instead of text."},
    {.name = "psnr", .kind = CLI_DOUBLE, .value = &tolerance.psnr, .argument = "DB", .max = 200, .seen = &set_psnr, .no_default = true,
     .help = "Images: accept a PSNR (all channels) of at least this.", .group = "Tolerances"},
    {.name = "ssim", .kind = CLI_DOUBLE, .value = &tolerance.ssim, .argument = "S", .min = -1, .max = 1, .seen = &set_ssim, .no_default = true,
     .help = "Images: accept a mean SSIM of at least this.", .group = "Tolerances"},
    {.name = "max-diff", .kind = CLI_U64, .value = &max_diff, .argument = "N", .max = 255, .seen = &set_max_diff, .no_default = true,
     .help = "Images: accept differences of up to this in every channel of every pixel.", .group = "Tolerances"},
    {.name = "float-diff", .kind = CLI_DOUBLE, .value = &tolerance.float_diff, .argument = "X", .max = INFINITY,
     .help = "OpenEXR pictures: accept differences of up to this in every float of every pixel.", .group = "Tolerances"},
    {.name = "deltaE", .kind = CLI_DOUBLE, .value = &tolerance.delta_e, .argument = "X", .max = INFINITY,
     .help = "Octrees: accept colours that are at most this far apart, in every voxel.", .group = "Tolerances"},
    {.name = "deg", .kind = CLI_DOUBLE, .value = &tolerance.degrees, .argument = "X", .max = 180,
     .help = "Octrees: accept normals that are at most this many degrees apart, in every voxel.", .group = "Tolerances"},
    {.name = "value", .kind = CLI_DOUBLE, .value = &tolerance.value, .argument = "X", .max = 1,
     .help = "Octrees: accept metallic and roughness that are at most this far apart, in every voxel.", .group = "Tolerances"},
    {.name = "geometry-only", .kind = CLI_FLAG, .value = &tolerance.geometry_only,
     .help = "Octrees: attributes are measured but do not count.", .group = "Tolerances"},
    {.name = "max-voxels", .kind = CLI_U64, .value = &tolerance.max_voxels, .argument = "N",
     .help = "Octrees: give up (exit 6) beyond this many voxels in both files together; 0 = no limit.", .group = "Limits"},
};

static const cli_tool tool = {
    .name = "svo-compare",
    .summary = "Compare two images, octrees, scenes or skeletons; exit 7 where they differ beyond tolerance.",
    .synopsis = "A B [--json] [--psnr DB] [--ssim S] [--max-diff N] [--float-diff X] [--deltaE X] [--deg X] [--value X] [--geometry-only]",
    .options = options,
    .option_count = sizeof options / sizeof *options,
    .details = DETAILS,
    .example = "svo-compare statue.svo statue.svdag --deltaE 2 --deg 1\nsvo-compare before.png after.png --psnr 40",
    .min_inputs = 2,
    .max_inputs = 2,
};

void compare_reason(compare_job *j, const char *format, ...)
{
    char text[400];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    json_array_append_new(j->reasons, cli_text(text));
}

svo_result compare_load(compare_input *in, const cli *c, const svo_allocator *a, svo_error *err)
{
    if (in->loaded) return SVO_OK;
    SVO_TRY(fmt_bytes_open(in->path, c->memory, a, &in->bytes, err));
    in->loaded = true;
    return SVO_OK;
}

/* Kind by the first bytes. A file is looked at and closed again, so that a large .svo is not mapped; stdin cannot be
 * read twice and is taken whole. */
static svo_result recognise(compare_input *in, const cli *c, const svo_allocator *a, svo_error *err)
{
    uint8_t head[64] = {0};
    size_t got = 0;
    if (strcmp(in->path, "-") == 0) {
        SVO_TRY(compare_load(in, c, a, err));
        got = in->bytes.size < sizeof head ? (size_t)in->bytes.size : sizeof head;
        memcpy(head, in->bytes.data, got);
    } else {
        fmt_input *file;
        SVO_TRY(fmt_input_open(in->path, &file, err));
        svo_result r = fmt_input_read(file, head, sizeof head, &got, err);
        fmt_input_close(file);
        if (r != SVO_OK) return r;
    }
    in->kind = (fmt_kind)fmt_container_kind(head, got);
    in->floats = in->kind == 0 && fmt_exr_is(head, got);
    in->image = in->kind == 0 && !in->floats;
    return SVO_OK;
}

static const char *kind_name(const compare_input *in)
{
    if (in->image) return "image";
    if (in->floats) return "OpenEXR picture";
    switch (in->kind) {
    case FMT_KIND_SVO:
    case FMT_KIND_SVDAG: return "octree";
    case FMT_KIND_SKEL: return "skeleton";
    case FMT_KIND_SCENE: return "scene";
    }
    return "file of an unknown kind";
}

static svo_result run(compare_job *j, svo_error *err)
{
    cli_phase(j->c, "open");
    for (int i = 0; i < 2; i++) SVO_TRY(recognise(&j->in[i], j->c, j->allocator, err));
    const char *kind = kind_name(&j->in[0]);
    for (int i = 0; i < 2; i++) {
        json_t *side = json_object();
        cli_put_text(side, "file", j->in[i].path);
        json_object_set_new(j->json, i == 0 ? "a" : "b", side);
    }
    cli_put_text(j->json, "kind", kind);
    if (strcmp(kind, kind_name(&j->in[1])) != 0) {
        /* An image may as well be a damaged file: say that first. */
        for (int i = 0; i < 2; i++)
            if (j->in[i].image) SVO_TRY(compare_can_read(j, &j->in[i], err));
        return svo_fail(err, SVO_UNSUPPORTED, "%s is of kind %s and %s of kind %s; they cannot be compared", j->in[0].path, kind,
                        j->in[1].path, kind_name(&j->in[1]));
    }
    cli_phase(j->c, "compare");
    if (j->in[0].image) return compare_images(j, err);
    if (j->in[0].floats) return compare_floats(j, err);
    if (strcmp(kind, "octree") == 0) return compare_octrees(j, err);
    return compare_containers(j, err);
}

int main(int argc, char **argv)
{
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    tolerance.psnr_set = set_psnr;
    tolerance.ssim_set = set_ssim;
    tolerance.max_diff_set = set_max_diff;
    tolerance.max_diff = (double)max_diff;
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, c.memory != 0 ? c.memory : UINT64_MAX, NULL);
    compare_job j = {.c = &c, .in = {{.path = c.inputs[0]}, {.path = c.inputs[1]}}, .tolerance = tolerance,
                     .allocator = c.memory != 0 ? &limit.base : NULL, .json = json_object()};
    json_object_set_new(j.json, "reasons", json_array());
    j.reasons = json_object_get(j.json, "reasons");
    svo_error err = {0};
    svo_result result = run(&j, &err);
    for (int i = 0; i < 2; i++)
        if (j.in[i].loaded) fmt_bytes_close(&j.in[i].bytes);
    if (result != SVO_OK) {
        json_decref(j.json);
        return cli_end(&c, result, &err);
    }
    bool differs = json_array_size(j.reasons) > 0;
    json_object_set_new(j.json, "differs", json_boolean(differs));
    json_object_set(c.json, "comparison", j.json);
    if (as_json) {
        json_dumpf(j.json, stdout, JSON_SORT_KEYS | JSON_INDENT(2) | JSON_REAL_PRECISION(17));
        putchar('\n');
    } else {
        compare_print(&j);
    }
    json_decref(j.json);
    return cli_end_code(&c, differs ? 7 : 0);
}
