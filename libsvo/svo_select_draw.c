/* The direct output of a selection (Willcocks 2013, 3.3.1): boxes drawn as they are. Of boxes that hide what is behind them a sample shows the nearest; boxes that cover a
 * part only (channel "coverage") and are nearer than that are kept for each sample, sorted and drawn over it from back to front.
 *
 * Deformed boxes overlap, and a ray meets several of one surface, so coverages cannot be multiplied box by box. Boxes of one instance whose normals agree and that follow each other
 * along the ray, at most as far apart as the way through a layer of boxes is long (a ray may leave one stair of a slanted surface and enter the next), are one surface. It covers what its boxes cover in the mean, weighted
 * by the ray's way inside each. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_task.h"
#include "svoi_select.h"

enum {
    LAYERS_AT_A_TIME = 1 << 21, /* of a band of rows, unless one row has more */
    OPEN_SURFACES = 16          /* that a sample can be inside of */
};

/* A box that covers a part, in one sample. */
typedef struct layer { float enter, leave; uint32_t number, instance; uint64_t attribute; } layer;

typedef struct drawing {
    const svo_scene *scene;
    const svo_selection *selection;
    const svo_render_options *o;
    svoi_look look;
    uint32_t threads;
    uint64_t *nearest; /* of each sample: depth's bits, then the number of the box */
    const uint8_t *cover; /* of each box; NULL: all hide what is behind them */
    /* layers of the rows [begin, end) of samples */
    uint32_t begin, end;
    uint32_t *count; /* of each sample of the picture, then how many are there */
    uint64_t *first; /* of each sample of the rows */
    layer *layers;
    /* shading */
    uint32_t *color, *emissive; /* channels of each asset */
    svo_vec3 light;
    uint8_t *pixels;
} drawing;

typedef struct pen { drawing *d; uint32_t number; } pen;

static float depth_of(uint64_t nearest)
{
    const uint32_t bits = (uint32_t)(nearest >> 32);
    float depth;
    if (nearest == UINT64_MAX) return INFINITY;
    memcpy(&depth, &bits, 4);
    return depth;
}

/* ---- the nearest box ------------------------------------------------------------------------------------------------- */

static bool comes_first(const svo_selected *a, const svo_selected *b)
{
    if (a->instance != b->instance) return a->instance < b->instance;
    if (a->attribute != b->attribute) return a->attribute < b->attribute;
    for (int k = 0; k < 3; k++) {
        if (a->low[k] != b->low[k]) return a->low[k] < b->low[k];
        if (a->high[k] != b->high[k]) return a->high[k] < b->high[k];
    }
    return a < b;
}

bool svoi_is_nearer(const svo_selection *s, uint64_t a, uint64_t b)
{
    if (a >> 32 != b >> 32 || b == UINT64_MAX) return a < b;
    return a != b && comes_first(&s->boxes[(uint32_t)a], &s->boxes[(uint32_t)b]);
}

static void add_nearest(void *user, uint32_t x, uint32_t y, float depth, float leave)
{
    (void)leave;
    const pen *p = user;
    uint32_t bits;
    memcpy(&bits, &depth, 4);
    svoi_set_nearest(p->d->selection, &p->d->nearest[(uint64_t)y * p->d->look.width + x], (uint64_t)bits << 32 | p->number);
}

static svo_result draw_boxes(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    drawing *d = user;
    for (uint64_t i = begin; i < end; i++) {
        pen p = {d, (uint32_t)i};
        if (d->cover != NULL && d->cover[i] != svoi_covers) continue;
        svoi_draw_box(&d->look, d->selection->boxes[i].low, d->selection->boxes[i].high, add_nearest, &p);
    }
    return SVO_OK;
}

static svo_result find_nearest(drawing *d, svo_draw_method method, const svo_allocator *a, svo_error *err)
{
    const uint64_t count = (uint64_t)d->look.width * d->look.height;
    d->nearest = svo_alloc(a, count, sizeof *d->nearest);
    if (d->nearest == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a picture of %u x %u samples", d->look.width, d->look.height);
    memset(d->nearest, 0xff, count * sizeof *d->nearest);
    if (method == SVO_DRAW_MIPMAPS) return svoi_draw_mipmap(d->selection, d->cover, &d->look, d->threads, a, d->nearest, err);
    return svo_parallel_for(d->threads, d->selection->count, 0, draw_boxes, d, err);
}

svo_result svo_select_draw(const svo_selection *s, const svo_select_options *o, svo_draw_method method, uint32_t *owner, float *depth, svo_error *err)
{
    const uint64_t count = (uint64_t)o->width * o->height;
    drawing d = {.selection = s, .look = svoi_look_make(&o->eye, o->width, o->height), .threads = o->threads};
    svo_result result = find_nearest(&d, method, o->allocator, err);
    for (uint64_t i = 0; i < count && result == SVO_OK; i++) owner[i] = (uint32_t)d.nearest[i], depth[i] = depth_of(d.nearest[i]);
    svo_free(o->allocator, d.nearest, count, sizeof *d.nearest);
    return result;
}

/* ---- layers over it --------------------------------------------------------------------------------------------------- */

static void count_layer(void *user, uint32_t x, uint32_t y, float depth, float leave)
{
    (void)leave;
    const pen *p = user;
    const uint64_t at = (uint64_t)y * p->d->look.width + x;
    if (depth < depth_of(p->d->nearest[at])) __atomic_fetch_add(&p->d->count[at], 1, __ATOMIC_RELAXED);
}

/* The order in which threads come does not matter: the layers of a sample are sorted before they are drawn. */
static void put_layer(void *user, uint32_t x, uint32_t y, float depth, float leave)
{
    const pen *p = user;
    drawing *d = p->d;
    const uint64_t at = (uint64_t)y * d->look.width + x;
    const float behind = depth_of(d->nearest[at]);
    if (depth < behind)
        d->layers[d->first[at - (uint64_t)d->begin * d->look.width] + __atomic_fetch_add(&d->count[at], 1, __ATOMIC_RELAXED)] = 
            (layer){depth, fminf(leave, behind), p->number, d->selection->boxes[p->number].instance, d->selection->boxes[p->number].attribute};
}

static svo_result draw_layers(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    drawing *d = user;
    for (uint64_t i = begin; i < end; i++) {
        pen p = {d, (uint32_t)i};
        if (d->cover[i] == svoi_covers || d->cover[i] == 0) continue;
        svoi_draw_box_rows(&d->look, d->selection->boxes[i].low, d->selection->boxes[i].high, d->begin, d->end, d->layers != NULL ? put_layer : count_layer, &p);
    }
    return SVO_OK;
}

/* ---- shading --------------------------------------------------------------------------------------------------------- */

static void read_color(const drawing *d, const uint32_t *channel, const svo_selected *b, uint32_t asset, float rgb[3])
{
    uint8_t value[SVO_MAX_STRIDE];
    if (channel[asset] == SVO_MAX_CHANNELS) return;
    svo_view_attribute(d->scene->assets[asset], channel[asset], b->attribute, value);
    for (int k = 0; k < 3; k++) rgb[k] = svo_srgb_to_linear(value[k]);
}

/* As in svo_render: two-sided, and a sky that is brighter than the ground. */
static void shade_box(const drawing *d, uint32_t number, float out[3])
{
    const svo_selected *b = &d->selection->boxes[number];
    const uint32_t asset = d->scene->instance_asset[b->instance];
    float rgb[3] = {0.6f, 0.6f, 0.6f}, emissive[3] = {0, 0, 0}, n[3];
    read_color(d, d->color, b, asset, rgb);
    read_color(d, d->emissive, b, asset, emissive);
    svo_oct32_decode(b->normal, n);
    svo_vec3 normal = {n[0], n[1], n[2]}, view = {b->low[0] + b->high[0], b->low[1] + b->high[1], b->low[2] + b->high[2]};
    if (svo_dot(normal, svo_normalize(view)) > 0.25) normal = svo_scale(normal, -1);
    const float light = (float)(d->o->ambient * (0.75 + 0.25 * normal.y) + (1 - d->o->ambient) * fmax(0, svo_dot(normal, d->light)));
    for (int k = 0; k < 3; k++) out[k] = rgb[k] * light + emissive[k];
}

static int compare_layers(const void *a, const void *b)
{
    const layer *x = a, *y = b;
    if (x->enter != y->enter) return x->enter < y->enter ? -1 : 1;
    /* what is culled behind them changes numbers, but not these */
    if (x->instance != y->instance) return x->instance < y->instance ? -1 : 1;
    if (x->attribute != y->attribute) return x->attribute < y->attribute ? -1 : 1;
    return x->number < y->number ? -1 : x->number > y->number;
}

/* What layers of one surface have come to. */
typedef struct surface {
    float leave, normal[3]; /* where it ends as far as is known */
    uint32_t instance;
    double way, cover, light[3]; /* sums: of ways, of ways * coverage, of these * light */
} surface;

/* The surface that a layer belongs to, or `count`: none of the last ones that are still open where the layer begins. */
static uint32_t find_surface(const drawing *d, const surface *all, uint32_t count, const layer *l, const svo_selected *b, const float normal[3])
{
    double thick = 0, across = 0, depth = 0;
    for (int k = 0; k < 3; k++) {
        const double middle = 0.5 * ((double)b->low[k] + b->high[k]);
        thick += fabsf(normal[k]) * ((double)b->high[k] - b->low[k]);
        across += normal[k] * middle, depth += d->look.axis[2][k] * middle;
    }
    const double gap = thick * fmin(fabs(depth / across), 10); /* along the view's axis */
    for (uint32_t back = 1; back <= count && back <= OPEN_SURFACES; back++) {
        const surface *s = &all[count - back];
        if (s->instance != b->instance || !(l->enter <= s->leave + gap)) continue;
        if (normal[0] * s->normal[0] + normal[1] * s->normal[1] + normal[2] * s->normal[2] > 0.5f) return count - back;
    }
    return count;
}

/* Layers of a sample from near to far: adds light times coverage and coverage to the sum, returns the share of the sample that is left. `found` has room for `count`. */
static double add_layers(const drawing *d, layer *l, uint32_t count, surface *found, double sum[4])
{
    uint32_t surfaces = 0;
    qsort(l, count, sizeof *l, compare_layers);
    for (uint32_t i = 0; i < count; i++) {
        const svo_selected *b = &d->selection->boxes[l[i].number];
        float normal[3], light[3];
        svo_oct32_decode(b->normal, normal);
        const uint32_t k = find_surface(d, found, surfaces, &l[i], b, normal);
        surface *s = &found[k];
        if (k == surfaces) {
            *s = (surface){.leave = l[i].leave, .instance = b->instance, .normal = {normal[0], normal[1], normal[2]}};
            surfaces++;
        }
        const double way = fmax((double)l[i].leave - l[i].enter, 1e-6 * l[i].enter + 1e-30), covers = way * (d->cover[l[i].number] / 255.0);
        shade_box(d, l[i].number, light);
        s->leave = fmaxf(s->leave, l[i].leave);
        s->way += way, s->cover += covers;
        for (int c = 0; c < 3; c++) s->light[c] += covers * light[c];
    }
    double left = 1;
    for (uint32_t k = 0; k < surfaces; k++) {
        const surface *s = &found[k];
        for (int c = 0; c < 3; c++) sum[c] += left * s->light[c] / s->way;
        sum[3] += left * s->cover / s->way;
        left *= 1 - s->cover / s->way;
    }
    return left;
}

static void put_pixel(const drawing *d, uint32_t x, uint32_t y, const double sum[4])
{
    const svo_render_options *o = d->o;
    const double total = (double)o->samples * o->samples, height = (y + 0.5) / o->height;
    uint8_t *out = d->pixels + 4 * ((uint64_t)y * o->width + x);
    for (int k = 0; k < 3; k++) {
        const double back = o->background_top[k] * (1 - height) + o->background_bottom[k] * height;
        out[k] = svo_linear_to_srgb((float)(o->transparent ? (sum[3] > 0 ? sum[k] / sum[3] : 0) : (sum[k] + (total - sum[3]) * back) / total));
    }
    out[3] = o->transparent ? (uint8_t)(255 * sum[3] / total + 0.5) : 255;
}

/* Rows of pixels, relative to the band. */
static svo_result shade_rows(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    const drawing *d = user;
    const svo_render_options *o = d->o;
    const uint32_t n = o->samples, row = d->begin / n;
    surface *found = NULL;
    uint32_t room = 0;
    for (uint64_t line = begin; line < end; line++)
        for (uint32_t x = 0; x < o->width; x++) {
            double sum[4] = {0, 0, 0, 0};
            const uint32_t y = row + (uint32_t)line;
            for (uint32_t s = 0; s < n * n; s++) {
                const uint64_t at = (uint64_t)(y * n + s / n) * d->look.width + (uint64_t)x * n + s % n, nearest = d->nearest[at];
                const uint32_t layers = d->count != NULL ? d->count[at] : 0;
                double left = 1;
                if (layers > room) {
                    svo_free(o->allocator, found, room, sizeof *found);
                    found = svo_alloc(o->allocator, layers, sizeof *found);
                    if (found == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %u surfaces that light passes", layers);
                    room = layers;
                }
                if (layers != 0) left = add_layers(d, d->layers + d->first[at - (uint64_t)d->begin * d->look.width], layers, found, sum);
                if (nearest == UINT64_MAX) continue;
                float light[3];
                shade_box(d, (uint32_t)nearest, light);
                for (int k = 0; k < 3; k++) sum[k] += left * light[k];
                sum[3] += left;
            }
            put_pixel(d, x, y, sum);
        }
    svo_free(o->allocator, found, room, sizeof *found);
    return SVO_OK;
}

/* Rows of pixels whose layers fit into memory at a time. */
static svo_result shade_bands(drawing *d, svo_error *err)
{
    const svo_allocator *a = d->o->allocator;
    const uint32_t n = d->o->samples;
    const uint64_t line = (uint64_t)n * d->look.width; /* samples of a row of pixels */
    d->begin = 0, d->end = d->look.height;
    SVO_TRY(svo_parallel_for(d->threads, d->selection->count, 0, draw_layers, d, err));
    svo_result result = SVO_OK;
    for (uint32_t row = 0, next; row < d->o->height && result == SVO_OK; row = next) {
        uint64_t layers = 0;
        for (next = row; next < d->o->height; next++) {
            uint64_t more = 0;
            for (uint64_t i = 0; i < line; i++) more += d->count[next * line + i];
            if (next != row && layers + more > LAYERS_AT_A_TIME) break;
            layers += more;
        }
        d->begin = row * n, d->end = next * n;
        const uint64_t samples = (next - row) * line;
        d->first = svo_alloc(a, samples, sizeof *d->first);
        d->layers = svo_alloc(a, layers + 1, sizeof *d->layers);
        if (d->first == NULL || d->layers == NULL) result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %llu voxels that light passes", (unsigned long long)layers);
        uint64_t at = 0;
        for (uint64_t i = 0; i < samples && result == SVO_OK; i++) {
            d->first[i] = at;
            at += d->count[row * line + i];
            d->count[row * line + i] = 0;
        }
        if (result == SVO_OK) result = svo_parallel_for(d->threads, d->selection->count, 0, draw_layers, d, err);
        if (result == SVO_OK) result = svo_parallel_for(d->threads, next - row, 8, shade_rows, d, err);
        svo_free(a, d->first, samples, sizeof *d->first);
        svo_free(a, d->layers, layers + 1, sizeof *d->layers);
        d->layers = NULL;
    }
    return result;
}

static uint64_t count_covered(const drawing *d, uint64_t samples)
{
    uint64_t n = 0;
    for (uint64_t i = 0; i < samples; i++) n += d->nearest[i] != UINT64_MAX || (d->count != NULL && d->count[i] != 0);
    return n;
}

/* Coverage of each box; *out stays NULL where all cover. */
static svo_result find_covers(const svo_scene *scene, const svo_selection *s, const svo_allocator *a, uint8_t **out, svo_error *err)
{
    bool any;
    uint32_t *channel = svoi_find_channels(scene, "coverage", SVO_KIND_UNORM8, &svoi_covers, a, &any);
    *out = any ? svo_alloc(a, s->count, 1) : NULL;
    const bool ok = (channel != NULL || scene->asset_count == 0) && (*out != NULL || !any || s->count == 0);
    for (uint64_t i = 0; i < s->count && ok && any; i++) {
        const uint32_t asset = scene->instance_asset[s->boxes[i].instance];
        uint8_t value[SVO_MAX_STRIDE] = {svoi_covers};
        if (channel[asset] != SVO_MAX_CHANNELS) svo_view_attribute(scene->assets[asset], channel[asset], s->boxes[i].attribute, value);
        (*out)[i] = value[0];
    }
    svo_free(a, channel, scene->asset_count, sizeof *channel);
    return ok ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a picture");
}

svo_result svo_select_render(const svo_scene *scene, const svo_selection *selection, const svo_render_options *o, svo_draw_method method, uint8_t *pixels, uint64_t *covered,
                             double *seconds, svo_error *err)
{
    const svo_allocator *a = o->allocator;
    const uint32_t width = o->width * o->samples, height = o->height * o->samples;
    const uint64_t samples = (uint64_t)width * height;
    uint8_t *cover = NULL;
    bool any;
    drawing d = {.scene = scene, .selection = selection, .o = o, .look = svoi_look_make(&o->eye, width, height), .threads = o->threads, .end = height,
                 .light = svo_normalize(o->light), .pixels = pixels};
    d.color = svoi_find_channels(scene, "color", SVO_KIND_COLOR_SRGB8, NULL, a, &any);
    d.emissive = svoi_find_channels(scene, "emissive", SVO_KIND_COLOR_SRGB8, NULL, a, &any);
    svo_result result = find_covers(scene, selection, a, &cover, err);
    d.cover = cover;
    if (result == SVO_OK && cover != NULL) d.count = svo_calloc(a, samples, sizeof *d.count);
    if (result == SVO_OK && (((d.color == NULL || d.emissive == NULL) && scene->asset_count != 0) || (cover != NULL && d.count == NULL)))
        result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a picture");
    const double began = svo_seconds();
    if (result == SVO_OK) result = find_nearest(&d, method, a, err);
    if (seconds != NULL) *seconds = svo_seconds() - began;
    if (result == SVO_OK) result = cover != NULL ? shade_bands(&d, err) : svo_parallel_for(o->threads, o->height, 8, shade_rows, &d, err);
    if (result == SVO_OK && covered != NULL) *covered = count_covered(&d, samples);
    svo_free(a, d.nearest, samples, sizeof *d.nearest);
    svo_free(a, d.count, samples, sizeof *d.count);
    svo_free(a, cover, selection->count, 1);
    svo_free(a, d.color, scene->asset_count, sizeof *d.color);
    svo_free(a, d.emissive, scene->asset_count, sizeof *d.emissive);
    return result;
}
