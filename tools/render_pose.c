#include "render_pose.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_file.h"
#include "fmt_svo.h"
#include "svo_unpack.h"

#define PI 3.14159265358979323846

/* ---- --deform -------------------------------------------------------------------------------------------------------- */

static bool take_axis(const char **at, uint8_t *axis)
{
    int c = tolower((unsigned char)**at);
    if (c < 'x' || c > 'z') return false;
    *axis = (uint8_t)(c - 'x');
    ++*at;
    return true;
}

static bool take_number(const char **at, double *out)
{
    char *end;
    *out = strtod(*at, &end);
    if (end == *at || !isfinite(*out)) return false;
    *at = end;
    return true;
}

static bool take_colon(const char **at) { return **at == ':' ? (++*at, true) : false; }

static bool take_word(const char **at, const char *word)
{
    size_t n = strlen(word);
    if (strncmp(*at, word, n) != 0 || (*at)[n] != '=') return false;
    *at += n + 1;
    return true;
}

static const char *take_part(const char **at, svo_pose *s, svo_mat4 *matrix)
{
    uint8_t a, b;
    double v[3];
    if (take_word(at, "twist")) {
        if ((s->flags & SVO_POSE_TWIST) != 0) return "twist is there twice";
        if (!take_axis(at, &a) || !take_colon(at) || !take_number(at, v)) return "twist takes an axis and degrees: twist=y:90";
        s->flags |= SVO_POSE_TWIST;
        s->twist_axis = a;
        s->twist_angle = (float)(v[0] * PI / 180);
        return NULL;
    }
    if (take_word(at, "bend")) {
        if ((s->flags & SVO_POSE_BEND) != 0) return "bend is there twice";
        if (!take_axis(at, &a) || !take_axis(at, &b) || a == b || !take_colon(at) || !take_number(at, v))
            return "bend takes the axis to bend, the one to bend it towards, and degrees: bend=yx:45";
        s->flags |= SVO_POSE_BEND;
        s->bend_axis = a, s->bend_towards = b;
        s->bend_angle = (float)(v[0] * PI / 180);
        return NULL;
    }
    svo_mat4 m = svo_mat4_identity();
    if (take_word(at, "shear")) {
        if (!take_axis(at, &a) || !take_axis(at, &b) || a == b || !take_colon(at) || !take_number(at, v))
            return "shear takes the axis that moves, the one it moves with, and how much: shear=xy:0.5";
        m.m[4 * a + b] = v[0];
    } else if (take_word(at, "scale")) {
        if (!take_number(at, v)) return "scale takes one number or three: scale=2 or scale=1:2:1";
        v[1] = v[2] = v[0];
        if (take_colon(at) && (!take_number(at, v + 1) || !take_colon(at) || !take_number(at, v + 2))) return "scale takes one number or three: scale=1:2:1";
        for (int k = 0; k < 3; k++) m.m[5 * k] = v[k];
    } else return "a deformation is twist=, bend=, shear= or scale=";
    *matrix = svo_mat4_mul(m, *matrix);
    s->flags |= SVO_POSE_MATRIX;
    return NULL;
}

const char *parse_deform(const char *text, svo_pose *stated, float matrix[12])
{
    svo_mat4 m = svo_mat4_identity();
    *stated = svo_pose_stated();
    for (;;) {
        const char *fault = take_part(&text, stated, &m);
        if (fault != NULL) return fault;
        for (int i = 0; i < 12; i++) {
            matrix[i] = (float)m.m[i];
            if (!isfinite(matrix[i])) return "a number is too large";
        }
        if (*text == 0) return NULL;
        if (*text++ != ',') return "parts are joined by commas";
    }
}

/* ---- scenes ----------------------------------------------------------------------------------------------------------- */

bool has_poses(const svo_scene *s)
{
    for (uint64_t i = 0; i < s->instance_count && s->instance_pose != NULL; i++)
        if (s->instance_pose[i] != SVO_NO_POSE) return true;
    return false;
}

svo_result pose_scene(posing *p, const svo_scene **scene, const svo_pose *stated, const float matrix[12], const svo_allocator *a, svo_error *err)
{
    SVO_TRY(svo_scene_pose_all(*scene, stated, matrix, a, &p->posed, err));
    *scene = svo_posed_scene_get(p->posed);
    return SVO_OK;
}

static svo_result save_octree(cli *c, const svo_view *view, const char *path, const svo_allocator *a, svo_error *err)
{
    fmt_output *out;
    fmt_svo_writer *writer;
    svo_tree_info info = svo_unpack_info(view);
    SVO_TRY(fmt_output_open(path, c->force, &out, err));
    char *provenance = cli_provenance(c, cli_options_json(c, false), NULL);
    svo_result r = fmt_svo_writer_begin(out, &info, provenance, 0, a, &writer, err);
    if (r == SVO_OK) {
        svo_unpack u;
        svo_unpack_begin(&u, view);
        svo_chunk_source source = svo_unpack_source(&u);
        svo_chunk_sink sink = fmt_svo_writer_sink(writer);
        svo_buffer packed, storage;
        svo_buffer_init(&packed, a);
        svo_buffer_init(&storage, a);
        bool more = true;
        while (r == SVO_OK) {
            svo_chunk chunk;
            void *blob;
            r = source.fetch(source.user, &packed, &more, err);
            if (r != SVO_OK || !more) break;
            r = source.decode(source.user, &packed, &storage, &chunk, err);
            if (r == SVO_OK) r = sink.encode(sink.user, &chunk, 0, &blob, err);
            if (r == SVO_OK) r = sink.commit(sink.user, blob, err);
        }
        svo_buffer_free(&packed);
        svo_buffer_free(&storage);
        if (r == SVO_OK) r = fmt_svo_writer_end(writer, NULL, err);
        else fmt_svo_writer_discard(writer);
    }
    free(provenance);
    if (r == SVO_OK) return fmt_output_commit(out, err);
    fmt_output_discard(out);
    return r;
}

static json_t *report_selection(cli *c, const svo_select_report *r, int resample)
{
    static const char *const names[] = {"auto", "direct", "resize", "emit", "mipmap"};
    json_t *o = cli_section(c, "deformation");
    cli_put_text(o, "resample", names[resample]);
    cli_put_u64(o, "pages", r->pages);
    cli_put_u64(o, "pages_seen", r->pages_seen);
    cli_put_u64(o, "instances", r->instances);
    cli_put_u64(o, "instances_seen", r->instances_seen);
    cli_put_u64(o, "nodes_visited", r->visited);
    cli_put_u64(o, "nodes_outside", r->outside);
    cli_put_u64(o, "nodes_hidden", r->hidden);
    cli_put_u64(o, "occlusion_rounds", r->rounds);
    cli_put_u64(o, "selected", r->selected);
    cli_put_u64(o, "selected_finest", r->finest);
    cli_put_u64(o, "overflowed", r->overflowed);
    cli_put_f64(o, "seconds_select", r->seconds);
    if (r->overflowed != 0)
        svo_warn(&c->warnings, "%llu parts of instances are left out: their pose takes them beyond the range of numbers", (unsigned long long)r->overflowed);
    return o;
}

static void report_unpose(cli *c, const svo_unpose_report *r, int resample)
{
    json_t *o = report_selection(c, &r->select, resample);
    cli_put_u64(o, "samples", r->resample.samples);
    cli_put_u64(o, "samples_coarsened", r->resample.coarsened);
    cli_put_u64(o, "samples_clamped", r->resample.clamped);
    cli_put_u64(o, "cells", r->hierarchy.cells);
    cli_put_u64(o, "octree_depth", r->resample.depth);
    cli_put_u64(o, "octree_bytes", r->hierarchy.bytes);
    cli_put_f64(o, "seconds_resample", r->resample.seconds);
    cli_put_f64(o, "seconds_attributes", r->seconds_values);
    cli_put_f64(o, "seconds_sort", r->hierarchy.seconds_sort);
    cli_put_f64(o, "seconds_hierarchy", r->hierarchy.seconds_build);
}

int choose_resample(int asked, bool rays) { return asked != RESAMPLE_AUTO ? asked : rays ? RESAMPLE_EMIT : RESAMPLE_DIRECT; }

svo_result draw_direct(cli *c, const svo_scene *scene, const svo_render_options *o, direct_boxes boxes, uint8_t *pixels, svo_render_stats *stats, svo_error *err)
{
    svo_select_options select = {.eye = o->eye, .width = o->width * o->samples, .height = o->height * o->samples, .delta = boxes.delta, .everything = true,
                                 .frustum = boxes.culling, .occlusion = boxes.culling, .threads = o->threads, .allocator = o->allocator};
    svo_selection selection;
    uint64_t covered = 0;
    double seconds = 0;
    if (o->shadows || o->bounce != 0 || o->reflections)
        svo_warn(&c->warnings, "--resample direct and mipmap draw no shadows, bounces or reflections: there is no octree to trace");
    cli_phase(c, "deform");
    SVO_TRY(svo_select(scene, &select, &selection, err));
    json_t *report = report_selection(c, &selection.report, boxes.mipmap ? RESAMPLE_MIPMAP : RESAMPLE_DIRECT);
    cli_phase(c, "render");
    svo_result r = svo_select_render(scene, &selection, o, boxes.mipmap ? SVO_DRAW_MIPMAPS : SVO_DRAW_BOXES, pixels, &covered, &seconds, err);
    cli_put_f64(report, "seconds_draw", seconds);
    svo_selection_free(&selection);
    memset(stats, 0, sizeof *stats);
    stats->primary = (uint64_t)o->width * o->height * o->samples * o->samples;
    stats->hits = covered;
    stats->parent_min = INFINITY;
    return r;
}

svo_result unpose_scene(posing *p, cli *c, const svo_scene **scene, const svo_select_options *select, const svo_render_options *look, int resample, bool labels, const char *save,
                        svo_error *err)
{
    svo_unpose_options o = {.select = *select, .shadows = look->shadows, .light = look->light, .method = resample == RESAMPLE_RESIZE ? SVO_RESAMPLE_RESIZE : SVO_RESAMPLE_EMIT,
                            .reflections = look->reflections || save != NULL, .reflectance = look->reflectance, .labels = labels || save != NULL};
    svo_unpose_report r;
    cli_phase(c, "deform");
    SVO_TRY(svo_unpose(*scene, &o, &p->unposed, &r, err));
    report_unpose(c, &r, resample == RESAMPLE_RESIZE ? RESAMPLE_RESIZE : RESAMPLE_EMIT);
    *scene = svo_unposed_scene(p->unposed);
    if (save == NULL) return SVO_OK;
    cli_phase(c, "save");
    return save_octree(c, svo_unposed_view(p->unposed), save, select->allocator, err);
}

void posing_close(posing *p)
{
    svo_unposed_free(p->unposed);
    svo_posed_scene_free(p->posed);
}
