#include "render_picture.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "fmt_exr.h"
#include "fmt_image.h"
#include "render_pose.h"

static const double degree = 3.14159265358979323846 / 180;
enum { MOST_FRAMES = 100000 };

static bool ends_with(const char *text, const char *end)
{
    size_t n = strlen(text), m = strlen(end);
    return n >= m && strcasecmp(text + n - m, end) == 0;
}
bool picture_is_exr(const char *path) { return ends_with(path, ".exr"); }
bool picture_is_png(const char *path) { return ends_with(path, ".png") || strcmp(path, "-") == 0; }

/* ---- cameras -------------------------------------------------------------------------------------------------------- */

void picture_frames_free(picture_frames *f, const svo_allocator *a)
{
    svo_free(a, f->eyes, f->capacity, sizeof *f->eyes);
    memset(f, 0, sizeof *f);
}

static svo_result make_room(picture_frames *f, uint64_t count, const svo_allocator *a, svo_error *err)
{
    f->eyes = svo_alloc(a, count, sizeof *f->eyes);
    if (f->eyes == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %llu cameras", (unsigned long long)count);
    f->capacity = count;
    return SVO_OK;
}

/* v turned by an angle around a unit axis (Rodrigues). */
static svo_vec3 turned(svo_vec3 v, svo_vec3 axis, double angle)
{
    double c = cos(angle), s = sin(angle);
    return svo_add(svo_add(svo_scale(v, c), svo_scale(svo_cross(axis, v), s)), svo_scale(axis, svo_dot(axis, v) * (1 - c)));
}

svo_result picture_turntable(picture_frames *f, const svo_eye *first, svo_vec3 middle, svo_vec3 up, uint64_t count, const svo_allocator *a, svo_error *err)
{
    svo_vec3 axis = svo_normalize(up);
    SVO_TRY(make_room(f, count, a, err));
    for (uint64_t i = 0; i < count; i++) {
        double angle = 360 * degree * (double)i / (double)count;
        svo_eye e = *first;
        e.position = svo_add(middle, turned(svo_sub(first->position, middle), axis, angle));
        e.right = turned(first->right, axis, angle), e.up = turned(first->up, axis, angle), e.forward = turned(first->forward, axis, angle);
        f->eyes[f->count++] = e;
    }
    return SVO_OK;
}

static svo_result path_line(picture_frames *f, const char *path, uint64_t number, char *line, svo_vec3 up, double yfov, svo_error *err)
{
    double v[7];
    int n = 0;
    line[strcspn(line, "#\r\n")] = 0;
    for (char *at = line, *end; n < 8; n++, at = end) {
        double x = strtod(at, &end);
        if (end == at) {
            if (at[strspn(at, " \t")] != 0) n = 99;
            break;
        }
        if (n < 7) v[n] = x;
    }
    if (n == 0) return SVO_OK;
    if (n != 6 && n != 7) return svo_fail(err, SVO_INVALID_DATA, "%s: line %llu is not \"ex ey ez tx ty tz [fov]\"", path, (unsigned long long)number);
    if (f->count == MOST_FRAMES) return svo_fail(err, SVO_LIMIT, "%s has more than %d frames", path, MOST_FRAMES);
    svo_error why;
    if (svo_eye_look(svo_v3(v[0], v[1], v[2]), svo_v3(v[3], v[4], v[5]), up, n == 7 ? v[6] * degree : yfov, &f->eyes[f->count], &why) != SVO_OK)
        return svo_fail(err, SVO_INVALID_DATA, "%s: line %llu: %s", path, (unsigned long long)number, why.message);
    f->count++;
    return SVO_OK;
}

svo_result picture_path(picture_frames *f, const char *path, svo_vec3 up, double yfov, const svo_allocator *a, svo_error *err)
{
    FILE *file = fopen(path, "r");
    char line[512];
    svo_result r = SVO_OK;
    if (file == NULL) return svo_fail(err, SVO_IO, "%s: cannot be opened", path);
    r = make_room(f, MOST_FRAMES, a, err);
    for (uint64_t number = 1; r == SVO_OK && fgets(line, sizeof line, file) != NULL; number++) {
        if (strlen(line) + 1 == sizeof line) r = svo_fail(err, SVO_INVALID_DATA, "%s: line %llu is too long", path, (unsigned long long)number);
        else r = path_line(f, path, number, line, up, yfov, err);
    }
    if (r == SVO_OK && ferror(file)) r = svo_fail(err, SVO_IO, "%s: cannot be read", path);
    if (r == SVO_OK && f->count == 0) r = svo_fail(err, SVO_INVALID_DATA, "%s has no frames", path);
    fclose(file);
    return r;
}

/* ---- one picture ---------------------------------------------------------------------------------------------------- */

static svo_result write_png(fmt_output *out, uint8_t *pixels, const svo_render_options *o, svo_error *err)
{
    uint64_t count = (uint64_t)o->width * o->height;
    if (!o->transparent)
        for (uint64_t i = 0; i < count; i++) memmove(pixels + 3 * i, pixels + 4 * i, 3);
    return fmt_png_write(out, pixels, o->width, o->height, o->transparent ? 4 : 3, err);
}

/* 10 values of 4 bytes a pixel, plane after plane. */
enum { PLANE_VALUES = 11 };
static svo_render_planes split(void *values, uint64_t count)
{
    float *f = values;
    svo_render_planes p = {.light = f, .normal = f + 4 * count, .depth = f + 7 * count};
    uint32_t *u = (uint32_t *)values + 8 * count;
    p.level = u, p.instance = u + count, p.bone = u + 2 * count;
    return p;
}

static svo_result write_exr(fmt_output *out, const svo_render_planes *p, const svo_render_options *o, svo_error *err)
{
    fmt_exr_channel channels[PLANE_VALUES] = {
        {"R", FMT_EXR_FLOAT, p->light, 4}, {"G", FMT_EXR_FLOAT, p->light + 1, 4}, {"B", FMT_EXR_FLOAT, p->light + 2, 4}, {"A", FMT_EXR_FLOAT, p->light + 3, 4},
        {"N.X", FMT_EXR_FLOAT, p->normal, 3}, {"N.Y", FMT_EXR_FLOAT, p->normal + 1, 3}, {"N.Z", FMT_EXR_FLOAT, p->normal + 2, 3},
        {"Z", FMT_EXR_FLOAT, p->depth, 1}, {"level", FMT_EXR_UINT, p->level, 1}, {"instance", FMT_EXR_UINT, p->instance, 1}, {"bone", FMT_EXR_UINT, p->bone, 1},
    };
    return fmt_exr_write(out, o->width, o->height, channels, PLANE_VALUES, err);
}

static svo_result draw_one(cli *c, picture_source *s, const svo_render_options *o, const char *path, svo_render_stats *stats, uint64_t *bytes, svo_error *err)
{
    const svo_allocator *a = o->allocator;
    uint64_t count = (uint64_t)o->width * o->height;
    bool exr = picture_is_exr(path);
    if (exr && s->bvh == NULL && s->make == NULL) return svo_fail(err, SVO_UNSUPPORTED, "%s: --resample direct and mipmap draw .png only", path);
    fmt_output *out = NULL;
    uint8_t *pixels = NULL;
    void *values = NULL;
    /* before the work, so that a bad place is known at once */
    SVO_TRY(fmt_output_open(path, c->force, &out, err));
    svo_result r = SVO_OK;
    pixels = svo_alloc(a, count, 4);
    if (exr) values = svo_alloc(a, count, 4 * PLANE_VALUES);
    if (pixels == NULL || (exr && values == NULL)) r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a picture of %u x %u pixels", o->width, o->height);
    svo_render_planes planes = {.light = NULL};
    if (r == SVO_OK && s->make != NULL) r = s->make(s->user, o, s, err);
    if (r == SVO_OK) {
        if (exr) planes = split(values, count);
        cli_phase(c, "render");
        if (s->bvh == NULL) r = draw_direct(c, s->scene, o, s->boxes, pixels, stats, err);
        else r = svo_render_with_planes(s->bvh, s->scene, o, pixels, exr ? &planes : NULL, stats, err);
    }
    if (r == SVO_OK) {
        cli_phase(c, "write");
        r = exr ? write_exr(out, &planes, o, err) : write_png(out, pixels, o, err);
    }
    if (r == SVO_OK) {
        *bytes += fmt_output_offset(out);
        r = fmt_output_commit(out, err);
        out = NULL;
    }
    fmt_output_discard(out);
    svo_free(a, pixels, count, 4);
    if (exr) svo_free(a, values, count, 4 * PLANE_VALUES);
    return r;
}

svo_result picture_draw(cli *c, picture_source *s, const svo_render_options *o, const char *path, const picture_frames *frames, svo_render_stats *stats, uint64_t *bytes,
                        svo_error *err)
{
    *bytes = 0;
    if (frames->count == 0) return draw_one(c, s, o, path, stats, bytes, err);
    size_t stem = strlen(path) - 4, size = strlen(path) + 16;
    char *name = svo_alloc(o->allocator, size, 1);
    if (name == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    svo_result r = SVO_OK;
    svo_render_stats sum = {.parent_min = INFINITY};
    for (uint64_t i = 0; i < frames->count && r == SVO_OK; i++) {
        svo_render_options frame = *o;
        frame.eye = frames->eyes[i];
        frame.progress = NULL;
        snprintf(name, size, "%.*s_%04llu%s", (int)stem, path, (unsigned long long)i, path + stem);
        r = draw_one(c, s, &frame, name, stats, bytes, err);
        if (r != SVO_OK) break;
        svo_render_add_stats(&sum, stats);
        cli_progress(c, "frames", (double)(i + 1) / (double)frames->count);
    }
    svo_free(o->allocator, name, size, 1);
    *stats = sum;
    return r;
}
