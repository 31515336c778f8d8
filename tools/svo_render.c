/* svo-render: a picture of a packed scene or of one octree. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "cli.h"
#include "cli_scene.h"
#include "fmt_image.h"
#include "fmt_scene.h"
#include "fmt_svo.h"
#include "render_pose.h"
#include "svo_dag.h"
#include "render_picture.h"
#include "svo_render.h"

/* What the user asked for. */
static struct {
    const char *size, *background;
    double eye[3], target[3], up[3], light[3], fov, ambient, footprint;
    bool eye_seen, target_seen, up_seen, fov_seen, no_shadows, no_culling;
    uint64_t samples;
    const char *deform, *save_svo, *path;
    uint64_t turntable, bounce;
    double reflectance;
    bool reflections;
    double delta;
    int resample;
} ask = {.size = "1280x720", .background = "sky", .up = {0, 1, 0}, .light = {-0.45, 0.85, 0.65}, .fov = 40, .ambient = 0.35,
         .footprint = 1, .samples = 1, .delta = 1};

static const char *const resamples[] = {"auto", "direct", "resize", "emit", "mipmap", NULL};

static const cli_option options[] = {
    {"size", 0, CLI_TEXT, &ask.size, "WxH", "Picture in pixels, 1 to 65536 a side, at most 2^28 in all.", 0, 0, NULL, NULL, false, "Picture"},
    {"samples", 0, CLI_U64, &ask.samples, "N", "N x N rays a pixel on a regular grid.", 1, 16, NULL, NULL, false, "Picture"},
    {"background", 0, CLI_TEXT, &ask.background, "B", "sky (a gradient), transparent, or r,g,b in sRGB 0..255.", 0, 0, NULL, NULL, false, "Picture"},
    {"footprint", 0, CLI_DOUBLE, &ask.footprint, "S",
     "Stop at voxels at most S samples wide, using their averaged attributes; 0 goes down to the finest voxels.", 0, 1e6, NULL, NULL, false, "Picture"},
    {"eye", 0, CLI_VEC3, ask.eye, "x,y,z", "Where the camera stands.", 0, 0, NULL, &ask.eye_seen, true, "Camera"},
    {"target", 0, CLI_VEC3, ask.target, "x,y,z", "What it looks at (with --eye alone: the middle of the scene).", 0, 0, NULL, &ask.target_seen, true, "Camera"},
    {"up", 0, CLI_VEC3, ask.up, "x,y,z", "Which way is up in the picture.", 0, 0, NULL, &ask.up_seen, false, "Camera"},
    {"fov", 0, CLI_DOUBLE, &ask.fov, "DEG", "Vertical field of view in degrees.", 1e-3, 179, NULL, &ask.fov_seen, false, "Camera"},
    {"turntable", 0, CLI_U64, &ask.turntable, "N", "N pictures once around the scene: OUT_0000.png ...; 0 = one picture.", 0, 100000, NULL, NULL, false, "Camera"},
    {"path", 0, CLI_TEXT, &ask.path, "F", "A picture for every line \"ex ey ez tx ty tz [fov]\" of a text file.", 0, 0, NULL, NULL, true, "Camera"},
    {"light", 0, CLI_VEC3, ask.light, "x,y,z", "Direction towards the light.", 0, 0, NULL, NULL, false, "Light"},
    {"ambient", 0, CLI_DOUBLE, &ask.ambient, "A", "Share of the light that comes from everywhere.", 0, 1, NULL, NULL, false, "Light"},
    {"bounce", 0, CLI_U64, &ask.bounce, "N", "Light by way of other surfaces: N x N rays over the hemisphere of every hit, in place of even ambient light.", 0, 16, NULL, NULL, false, "Light"},
    {"reflections", 0, CLI_FLAG, &ask.reflections, NULL, "Mirror what metallic * (1 - roughness) reflects.", 0, 0, NULL, NULL, false, "Light"},
    {"reflectance", 0, CLI_DOUBLE, &ask.reflectance, "R", "What surfaces without these channels reflect; above 0 it means --reflections.", 0, 1, NULL, NULL, false, "Light"},
    {"no-shadows", 0, CLI_FLAG, &ask.no_shadows, NULL, "Do not trace shadow rays.", 0, 0, NULL, NULL, false, "Light"},
    {"deform", 0, CLI_TEXT, &ask.deform, "D", "Deform every asset: twist=y:90, bend=yx:45, shear=xy:0.5, scale=1:2:1 (degrees; joined by commas), in place of its pose.", 0, 0,
     NULL, NULL, true, "Deformation"},
    {"resample", 0, CLI_CHOICE, &ask.resample, "KIND", "How deformed voxels are drawn: cells of an octree of fixed (resize) or growing (emit) number, as boxes (direct), or as boxes by the texels of a mipmap (mipmap).", 0,
     0, resamples, NULL, false, "Deformation"},
    {"delta", 0, CLI_DOUBLE, &ask.delta, "S", "Take deformed nodes that are less than S samples wide.", 1e-3, 1e6, NULL, NULL, false, "Deformation"},
    {"no-culling", 0, CLI_FLAG, &ask.no_culling, NULL, "Deform what is hidden or out of the picture too, whatever it can shade: to compare pictures.", 0, 0, NULL, NULL, false, "Deformation"},
    {"save-svo", 0, CLI_TEXT, &ask.save_svo, "F", "Write the octree of deformed voxels as .svo.", 0, 0, NULL, NULL, true, "Deformation"},
};

static const cli_tool tool = {
    .name = "svo-render",
    .summary = "Ray-cast a picture of a packed scene or of one octree.",
    .synopsis = "IN -o OUT.png|OUT.exr [--size WxH] [--eye x,y,z --target x,y,z --fov DEG]",
    .options = options,
    .option_count = sizeof options / sizeof options[0],
    .details = "IN is an .svscene, .svdag or .svo file, or - for stdin. Without --eye and --target the scene's own camera "
               "is used, or, where it has none, a view from the right, above and in front that holds everything.",
    .example = "svo-render city.svscene -o city.png --size 1920x1080 --samples 2\nsvo-render cow.svdag -o - --eye 1,1,3 --target 0,0,0 --fov 30 > cow.png",
    .min_inputs = 1, .max_inputs = 1, .has_output = true};

/* ---- the input: whatever it is, a scene ---------------------------------------------------------------------------- */

typedef struct input {
    fmt_bytes bytes;
    cli_scene opened;
    fmt_scene_loss loss; /* of a damaged scene */
} input;

static svo_result open_input(input *in, cli *c, const svo_allocator *a, svo_error *err)
{
    SVO_TRY(fmt_bytes_open(c->inputs[0], c->memory, a, &in->bytes, err));
    SVO_TRY(cli_scene_open(c, c->inputs[0], in->bytes.data, in->bytes.size, a, &in->loss, &in->opened, err));
    if ((in->loss.pages != 0 || in->loss.assets != 0) && in->opened.scene->instance_count == 0)
        return svo_fail(err, SVO_INVALID_DATA, "%s is damaged: nothing of it can be drawn", c->inputs[0]);
    if (in->loss.pages != 0) svo_warn(&c->warnings, "%llu pages are damaged and left out", (unsigned long long)in->loss.pages);
    if (in->loss.assets != 0) svo_warn(&c->warnings, "%llu assets are damaged; nothing is drawn of them", (unsigned long long)in->loss.assets);
    return SVO_OK;
}

static void close_input(input *in)
{
    cli_scene_close(&in->opened);
    fmt_bytes_close(&in->bytes);
}

/* ---- options that need more than the table -------------------------------------------------------------------------- */

static bool parse_size(const char *text, uint32_t *width, uint32_t *height)
{
    unsigned w, h;
    int end = 0;
    if (strlen(text) > 16 || sscanf(text, "%5u%*1[xX]%5u%n", &w, &h, &end) != 2 || text[end] != 0) return false;
    if (w < 1 || h < 1 || w > 65536 || h > 65536) return false;
    *width = w, *height = h;
    return true;
}

static bool parse_background(const char *text, svo_render_options *o)
{
    if (strcmp(text, "sky") == 0) return true;
    if (strcmp(text, "transparent") == 0) return o->transparent = true;
    unsigned c[3];
    int end = 0;
    if (sscanf(text, "%3u,%3u,%3u%n", &c[0], &c[1], &c[2], &end) != 3 || text[end] != 0) return false;
    for (int k = 0; k < 3; k++) {
        if (c[k] > 255) return false;
        o->background_top[k] = o->background_bottom[k] = svo_srgb_to_linear((uint8_t)c[k]);
    }
    return true;
}

static svo_vec3 vec(const double v[3]) { return svo_v3(v[0], v[1], v[2]); }

/* bvh NULL: by the bounds of the scene's pages. */
static svo_result choose_camera(const svo_scene *scene, const svo_bvh *bvh, svo_render_options *o, const char **how, svo_error *err)
{
    double low[3] = {0, 0, 0}, high[3] = {1, 1, 1}, fov = ask.fov * 3.14159265358979323846 / 180;
    if (bvh != NULL) svo_bvh_bounds(bvh, low, high);
    else svo_scene_bounds(scene, low, high);
    if (!ask.eye_seen && !ask.target_seen && scene->has_camera) {
        *how = "scene";
        return svo_eye_from_transform(&scene->camera_transform, ask.fov_seen ? fov : scene->camera_yfov, &o->eye, err);
    }
    *how = "framed";
    if (ask.turntable != 0) { /* what holds the scene from all sides: a square around its circle */
        double x = 0.5 * low[0] + 0.5 * high[0], z = 0.5 * low[2] + 0.5 * high[2], radius = hypot(high[0] - x, high[2] - z);
        low[0] = x - radius, high[0] = x + radius, low[2] = z - radius, high[2] = z + radius;
    }
    o->eye = svo_eye_frame(low, high, (double)o->width / o->height, fov);
    if (!ask.eye_seen && !ask.target_seen && !ask.up_seen) return SVO_OK;
    *how = "given";
    svo_vec3 middle = {0.5 * low[0] + 0.5 * high[0], 0.5 * low[1] + 0.5 * high[1], 0.5 * low[2] + 0.5 * high[2]};
    return svo_eye_look(ask.eye_seen ? vec(ask.eye) : o->eye.position, ask.target_seen ? vec(ask.target) : middle, vec(ask.up), fov, &o->eye, err);
}

/* ---- the report ----------------------------------------------------------------------------------------------------- */

static void put_vec(json_t *o, const char *key, svo_vec3 v) { json_object_set_new(o, key, json_pack("[f,f,f]", v.x, v.y, v.z)); }

static void put_rays(json_t *rays, const char *name, uint64_t count, uint64_t hits, double seconds)
{
    json_t *o = json_object();
    cli_put_u64(o, "rays", count);
    cli_put_u64(o, "hits", hits);
    cli_put_f64(o, "thread_seconds", seconds);
    cli_put_f64(o, "mrays_per_thread_second", seconds > 0 ? (double)count / seconds / 1e6 : NAN);
    json_object_set_new(rays, name, o);
}

static void report_input(cli *c, const input *in, const svo_bvh_report *b)
{
    json_t *o = cli_section(c, "input");
    cli_put_text(o, "kind", in->opened.kind);
    cli_put_u64(o, "bytes", in->bytes.size);
    cli_put_u64(o, "assets", in->opened.scene->asset_count);
    cli_put_u64(o, "pages", in->opened.scene->page_count);
    cli_put_u64(o, "instances", b->instances);
    cli_put_u64(o, "instances_placed", b->placed);
    cli_put_u64(o, "instances_empty", b->empty);
    cli_put_u64(o, "instances_singular", b->singular);
    cli_put_u64(o, "instances_hidden_duplicates", b->duplicates);
    cli_put_u64(o, "pages_damaged", in->loss.pages);
    cli_put_u64(o, "assets_damaged", in->loss.assets);
    cli_put_u64(o, "instances_damaged", in->loss.instances);
    cli_put_u64(o, "hierarchy_nodes", b->nodes);
    cli_put_u64(o, "hierarchy_bytes", b->bytes);
}

static void report_rays(cli *c, const svo_rays_report *form)
{
    json_t *o = cli_section(c, "rays");
    cli_put_text(o, "kernel", svo_ray_kernel_name(form->kernel == SVO_KERNEL_AUTO ? SVO_KERNEL_PORTABLE : form->kernel));
    cli_put_u64(o, "traversal_bytes", form->bytes);
    cli_put_f64(o, "traversal_seconds", form->seconds);
}

static void report_picture(cli *c, const svo_render_options *o, const svo_render_stats *s, const char *camera, uint64_t bytes)
{
    json_t *out = cli_section(c, "output");
    cli_put_u64(out, "bytes", bytes);
    cli_put_u64(out, "width", o->width);
    cli_put_u64(out, "height", o->height);
    json_t *eye = cli_section(c, "camera");
    cli_put_text(eye, "from", camera);
    put_vec(eye, "eye", o->eye.position);
    put_vec(eye, "forward", o->eye.forward);
    put_vec(eye, "up", o->eye.up);
    cli_put_f64(eye, "fov", o->eye.yfov * 180 / 3.14159265358979323846);
    json_t *rays = cli_section(c, "rays");
    put_rays(rays, "primary", s->primary, s->hits, s->primary_seconds);
    put_rays(rays, "shadow", s->shadow, s->blocked, s->shadow_seconds);
    put_rays(rays, "secondary", s->secondary, s->secondary_hits, s->secondary_seconds);
    cli_put_f64(rays, "shade_thread_seconds", s->shade_seconds);
    json_t *levels = cli_section(c, "levels"), *counts = json_array();
    uint64_t most = 0;
    double sum = 0;
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++)
        if (s->levels[l] != 0) most = l, sum += (double)s->levels[l] * l;
    for (uint32_t l = 0; l <= most; l++) json_array_append_new(counts, json_integer((json_int_t)s->levels[l]));
    cli_put_f64(levels, "mean", s->hits != 0 ? sum / (double)s->hits : NAN);
    cli_put_u64(levels, "max", most);
    json_object_set_new(levels, "hits", counts);
    cli_put_u64(levels, "stops_above_finest", s->lod_stops);
    cli_put_u64(levels, "rays_begun_inside", s->inside);
    /* The stop rule, measured: a stopped-at node is at most `footprint` samples wide, its parent was wider. */
    json_t *errors = cli_section(c, "errors");
    cli_put_f64(errors, "stop_edge_max_samples", s->stop_max);
    cli_put_f64(errors, "stop_parent_edge_min_samples", s->parent_min);
    json_object_set_new(errors, "stop_rule_holds", json_boolean(s->stop_max <= o->footprint * (1 + 1e-9) && s->parent_min > o->footprint * (1 - 1e-9)));
}

/* ---- main ----------------------------------------------------------------------------------------------------------- */

static void show_progress(void *user, double fraction) { cli_progress(user, "rendering", fraction); }

/* A scene whose voxels are deformed for the camera of each picture. */
typedef struct deforming {
    cli *c;
    const svo_scene *scene; /* with poses; NULL: it needs none of this */
    bool everything;
    int resample;
    posing now; /* of the picture that is drawn */
    svo_bvh *bvh;
    svo_bvh_report report;
    svo_rays_report form;
} deforming;

static svo_result use_rays(cli *c, svo_bvh *bvh, const svo_allocator *a, svo_rays_report *form, svo_error *err)
{
    svo_rays_options fast = svo_default_rays_options();
    fast.allocator = a;
    if (c->memory != 0) fast.memory = c->memory / 8; /* its building takes some of that again */
    cli_phase(c, "rays");
    return svo_bvh_use_rays(bvh, &fast, form, err);
}

/* Does the scene need it? Chooses the camera then. */
static svo_result find_deforming(cli *c, const svo_scene *scene, svo_render_options *o, deforming *d, const char **camera, svo_error *err)
{
    const bool everything = ask.save_svo != NULL && !has_poses(scene); /* the octree of a scene without poses is that of all of it */
    *d = (deforming){.c = c, .everything = everything};
    if (!has_poses(scene) && !everything && !draws_boxes(ask.resample)) return SVO_OK;
    SVO_TRY(choose_camera(scene, NULL, o, camera, err));
    const bool octree = ask.save_svo != NULL || picture_is_exr(c->output); /* these need more than boxes */
    d->resample = choose_resample(octree && ask.resample == RESAMPLE_AUTO ? RESAMPLE_EMIT : ask.resample, o->shadows || o->bounce != 0 || o->reflections);
    if (ask.save_svo != NULL && draws_boxes(d->resample)) return svo_fail(err, SVO_INVALID_ARGUMENT, "--resample %s makes no octree for --save-svo", resamples[d->resample]);
    d->scene = scene;
    return SVO_OK;
}

static void end_picture(deforming *d)
{
    svo_bvh_free(d->bvh);
    posing_close(&d->now);
    d->bvh = NULL;
    d->now = (posing){0};
}

/* Cells for one camera, and rays into them. */
static svo_result deform_picture(void *user, const svo_render_options *o, picture_source *s, svo_error *err)
{
    deforming *d = user;
    end_picture(d);
    s->scene = d->scene;
    /* rays that go anywhere meet anything, and an octree with shadows is kept whole */
    const bool culling = !ask.no_culling && o->bounce == 0 && !o->reflections && !(o->shadows && ask.save_svo != NULL);
    const svo_select_options select = {.eye = o->eye, .width = o->width * o->samples, .height = o->height * o->samples, .delta = ask.delta, .everything = d->everything,
                                       .frustum = culling, .occlusion = culling, .threads = o->threads, .allocator = o->allocator};
    SVO_TRY(unpose_scene(&d->now, d->c, &s->scene, &select, o, d->resample, picture_is_exr(d->c->output), ask.save_svo, err));
    cli_phase(d->c, "hierarchy");
    SVO_TRY(svo_bvh_build(s->scene, o->threads, o->allocator, &d->c->warnings, &d->bvh, &d->report, err));
    s->bvh = d->bvh;
    return use_rays(d->c, d->bvh, o->allocator, &d->form, err);
}

/* Cameras of many pictures; none for one. */
static svo_result find_frames(const svo_scene *scene, const svo_bvh *bvh, const svo_render_options *o, picture_frames *frames, svo_error *err)
{
    double low[3] = {0, 0, 0}, high[3] = {1, 1, 1};
    if (ask.path != NULL) return picture_path(frames, ask.path, vec(ask.up), o->eye.yfov, o->allocator, err);
    if (ask.turntable == 0) return SVO_OK;
    if (bvh != NULL) svo_bvh_bounds(bvh, low, high);
    else svo_scene_bounds(scene, low, high);
    return picture_turntable(frames, &o->eye, svo_v3(0.5 * low[0] + 0.5 * high[0], 0.5 * low[1] + 0.5 * high[1], 0.5 * low[2] + 0.5 * high[2]), vec(ask.up), ask.turntable,
                             o->allocator, err);
}

static svo_result run(cli *c, svo_render_options *o, const svo_pose *stated, const float matrix[12], const svo_allocator *a, svo_error *err)
{
    posing posed = {0};
    deforming deformed = {0};
    picture_source source = {.boxes = {ask.delta, ask.resample == RESAMPLE_MIPMAP, !ask.no_culling}, .user = &deformed};
    const svo_scene *scene;
    input in;
    memset(&in, 0, sizeof in);
    svo_bvh *bvh = NULL;
    svo_bvh_report b;
    svo_rays_report form;
    svo_render_stats stats;
    uint64_t bytes = 0;
    const char *camera = "";
    svo_result r = SVO_OK;
    picture_frames frames = {NULL, 0, 0};
    if (!picture_is_exr(c->output) && !picture_is_png(c->output)) return svo_fail(err, SVO_UNSUPPORTED, "%s: svo-render writes .png and .exr only", c->output);
    if (ask.turntable == 0 && ask.path == NULL) { /* before the work, so that a bad place is known at once */
        fmt_output *out;
        SVO_TRY(fmt_output_open(c->output, c->force, &out, err));
        fmt_output_discard(out);
    }

    cli_phase(c, "open");
    if ((r = cli_about(c->inputs[0], open_input(&in, c, a, err), err)) != SVO_OK) goto done;
    scene = in.opened.scene;
    if (stated != NULL && (r = pose_scene(&posed, &scene, stated, matrix, a, err)) != SVO_OK) goto done;
    if ((r = find_deforming(c, scene, o, &deformed, &camera, err)) != SVO_OK) goto done;
    b = (svo_bvh_report){.instances = scene->instance_count, .placed = scene->instance_count};
    if (deformed.scene != NULL && !draws_boxes(deformed.resample)) source.make = deform_picture;
    else if (deformed.scene == NULL) {
        cli_phase(c, "hierarchy");
        if ((r = svo_bvh_build(scene, (uint32_t)c->threads, a, &c->warnings, &bvh, &b, err)) != SVO_OK) goto done;
        if (camera[0] == 0 && (r = choose_camera(scene, bvh, o, &camera, err)) != SVO_OK) goto done;
        if ((r = use_rays(c, bvh, a, &form, err)) != SVO_OK) goto done;
        report_rays(c, &form);
    }
    source.bvh = bvh, source.scene = scene;
    if ((r = find_frames(scene, bvh, o, &frames, err)) != SVO_OK) goto done;
    if ((r = picture_draw(c, &source, o, c->output, &frames, &stats, &bytes, err)) != SVO_OK) goto done;
    if (source.make != NULL) { /* of the last picture */
        b = deformed.report;
        report_rays(c, &deformed.form);
    }
    report_input(c, &in, &b);
    if (b.placed == 0) svo_warn(&c->warnings, "there is nothing to draw: the picture shows the background alone");
    cli_phase(c, NULL);
    report_picture(c, o, &stats, camera, bytes);
    cli_info(c, "%s: %u x %u, %.2f Mray primary at %.2f and %.2f Mray shadow at %.2f Mray/s a thread", c->output, o->width, o->height,
             1e-6 * (double)stats.primary, stats.primary_seconds > 0 ? 1e-6 * (double)stats.primary / stats.primary_seconds : 0,
             1e-6 * (double)stats.shadow, stats.shadow_seconds > 0 ? 1e-6 * (double)stats.shadow / stats.shadow_seconds : 0);
    if (in.loss.pages != 0 || in.loss.assets != 0) /* the picture is there, but it is not that of the whole scene */
        r = svo_fail(err, SVO_INVALID_DATA, "%s is damaged: the picture lacks %llu instances", c->inputs[0], (unsigned long long)in.loss.instances);
done:
    picture_frames_free(&frames, a);
    end_picture(&deformed);
    svo_bvh_free(bvh);
    posing_close(&posed);
    close_input(&in);
    return r;
}

int main(int argc, char **argv)
{
    cli c;
    svo_error err = {0};
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    svo_render_options o = svo_default_render_options();
    if (!parse_size(ask.size, &o.width, &o.height)) return cli_usage(&c, "--size takes WxH with 1 to 65536 pixels a side, not \"%s\"", ask.size);
    if (!parse_background(ask.background, &o))
        return cli_usage(&c, "--background takes sky, transparent or r,g,b with 0..255 each, not \"%s\"", ask.background);
    if (svo_length(vec(ask.light)) == 0) return cli_usage(&c, "--light needs a direction, not 0,0,0");
    if (c.output == NULL) return cli_usage(&c, "-o OUT.png is missing");
    if (ask.turntable != 0 && ask.path != NULL) return cli_usage(&c, "--turntable and --path are two ways to say the same: give one");
    if ((ask.turntable != 0 || ask.path != NULL) && strcmp(c.output, "-") == 0) return cli_usage(&c, "many pictures do not go to stdout");
    if ((ask.turntable != 0 || ask.path != NULL) && ask.save_svo != NULL) return cli_usage(&c, "--save-svo writes the octree of one picture: no --turntable and --path with it");
    if (svo_length(vec(ask.up)) == 0 && ask.turntable != 0) return cli_usage(&c, "--turntable needs an axis: --up is 0,0,0");
    svo_pose stated;
    float matrix[12];
    const char *fault = ask.deform != NULL ? parse_deform(ask.deform, &stated, matrix) : NULL;
    if (fault != NULL) return cli_usage(&c, "--deform %s: %s", ask.deform, fault);
    o.samples = (uint32_t)ask.samples;
    o.light = vec(ask.light);
    o.ambient = ask.ambient;
    o.shadows = !ask.no_shadows;
    o.bounce = (uint32_t)ask.bounce;
    o.reflections = ask.reflections || ask.reflectance > 0;
    o.reflectance = ask.reflectance;
    o.footprint = ask.footprint;
    o.measure = c.report != NULL;
    o.threads = (uint32_t)c.threads;
    svo_limit_allocator limited;
    const svo_allocator *a = NULL;
    if (c.memory != 0) {
        svo_limit_allocator_init(&limited, c.memory, NULL);
        a = &limited.base;
    }
    o.allocator = a;
    o.progress = show_progress;
    o.user = &c;
    svo_result r = run(&c, &o, ask.deform != NULL ? &stated : NULL, matrix, a, &err);
    if (r == SVO_OUT_OF_MEMORY && c.memory != 0) r = svo_fail(&err, SVO_LIMIT, "the picture does not fit into --memory");
    return cli_end(&c, r, &err);
}
