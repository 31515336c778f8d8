/* OpenEXR pictures, plane by plane. */
#include <math.h>
#include <string.h>

#include "compare.h"
#include "exr_read.h"

typedef struct plane_difference {
    uint64_t different, unmatched; /* values; of them those that are a number in one picture alone */
    double max, squares;           /* over values that are numbers in both */
    uint64_t worst, numbers;       /* pixel of the largest; how many are numbers in both */
} plane_difference;

static plane_difference measure(const double *a, const double *b, uint64_t count)
{
    plane_difference d = {0};
    for (uint64_t i = 0; i < count; i++) {
        if (a[i] == b[i] || (isnan(a[i]) && isnan(b[i]))) {
            d.numbers += isfinite(a[i]) != 0;
            continue;
        }
        if (d.different++ == 0) d.worst = i;
        if (!isfinite(a[i]) || !isfinite(b[i])) {
            d.unmatched++;
            continue;
        }
        const double by = fabs(a[i] - b[i]);
        d.numbers++;
        d.squares += by * by;
        if (by > d.max) d.max = by, d.worst = i;
    }
    return d;
}

/* What one picture alone has. */
static void missing(compare_job *j, json_t *list, const char *name, bool in_a)
{
    json_t *o = json_object();
    cli_put_text(o, "name", name);
    json_object_set_new(o, "in_a", json_boolean(in_a));
    json_object_set_new(o, "in_b", json_boolean(!in_a));
    json_array_append_new(list, o);
    compare_reason(j, "only %s has the plane %.60s", in_a ? "A" : "B", name);
}

static void compare_plane(compare_job *j, json_t *list, const fmt_exr_plane *a, const fmt_exr_plane *b, uint32_t width, uint32_t height)
{
    const plane_difference d = measure(a->values, b->values, (uint64_t)width * height);
    const bool labels = a->integer || b->integer;
    json_t *o = json_object();
    cli_put_text(o, "name", a->name);
    json_object_set_new(o, "in_a", json_true());
    json_object_set_new(o, "in_b", json_true());
    cli_put_text(o, "type", labels ? "integer" : "float");
    cli_put_u64(o, "different", d.different);
    cli_put_u64(o, "unmatched", d.unmatched);
    cli_put_f64(o, "max", d.max);
    cli_put_f64(o, "rmse", d.numbers != 0 ? sqrt(d.squares / (double)d.numbers) : 0);
    if (d.different != 0) json_object_set_new(o, "worst", json_pack("[I,I]", (json_int_t)(d.worst % width), (json_int_t)(d.worst / width)));
    json_array_append_new(list, o);
    if (a->integer != b->integer) compare_reason(j, "the plane %.60s holds integers in one and floats in the other", a->name);
    else if (labels && d.different != 0) compare_reason(j, "%llu labels differ in the plane %.60s", (unsigned long long)d.different, a->name);
    else if (d.unmatched != 0) compare_reason(j, "%llu values of the plane %.60s are a number in one alone", (unsigned long long)d.unmatched, a->name);
    else if (d.max > j->tolerance.float_diff) compare_reason(j, "the plane %.60s differs by up to %.6g, above %.6g", a->name, d.max, j->tolerance.float_diff);
}

static void compare_planes(compare_job *j, const fmt_exr_picture *a, const fmt_exr_picture *b)
{
    json_t *list = json_array();
    uint32_t m = 0, n = 0;
    while (m < a->plane_count || n < b->plane_count) { /* both by name */
        const int order = m == a->plane_count ? 1 : n == b->plane_count ? -1 : strcmp(a->planes[m].name, b->planes[n].name);
        if (order < 0) missing(j, list, a->planes[m++].name, true);
        else if (order > 0) missing(j, list, b->planes[n++].name, false);
        else compare_plane(j, list, &a->planes[m++], &b->planes[n++], a->width, a->height);
    }
    const json_t *o;
    size_t i;
    bool identical = true;
    json_array_foreach(list, i, o) identical = identical && json_integer_value(json_object_get(o, "different")) == 0 && json_object_get(o, "type") != NULL;
    json_object_set_new(j->json, "identical", json_boolean(identical && json_array_size(j->reasons) == 0));
    json_object_set_new(j->json, "planes", list);
}

svo_result compare_floats(compare_job *j, svo_error *err)
{
    fmt_exr_picture picture[2] = {{0}, {0}};
    svo_result r = SVO_OK;
    for (int i = 0; i < 2 && r == SVO_OK; i++) {
        compare_input *in = &j->in[i];
        svo_error inner = {0};
        r = compare_load(in, j->c, j->allocator, err);
        if (r != SVO_OK) break;
        r = fmt_exr_read(in->bytes.data, in->bytes.size, 0, j->allocator, &picture[i], &inner);
        if (r != SVO_OK) {
            svo_fail(err, r, "%.150s: %s", strcmp(in->path, "-") == 0 ? "stdin" : in->path, inner.message);
            break;
        }
        json_t *side = json_object_get(j->json, i == 0 ? "a" : "b");
        cli_put_u64(side, "width", picture[i].width);
        cli_put_u64(side, "height", picture[i].height);
        cli_put_u64(side, "planes", picture[i].plane_count);
    }
    if (r == SVO_OK && (picture[0].width != picture[1].width || picture[0].height != picture[1].height)) {
        json_object_set_new(j->json, "identical", json_false());
        compare_reason(j, "the sizes differ: %u x %u and %u x %u pixels", picture[0].width, picture[0].height, picture[1].width, picture[1].height);
    } else if (r == SVO_OK) {
        compare_planes(j, &picture[0], &picture[1]);
    }
    for (int i = 0; i < 2; i++) fmt_exr_free(&picture[i]);
    return r;
}
