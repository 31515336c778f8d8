#include <string.h>

#include "svo_task.h"
#include "svoi_select.h"

/* ---- projection ------------------------------------------------------------------------------------------------------ */

svoi_look svoi_look_make(const svo_eye *eye, uint32_t width, uint32_t height)
{
    svoi_look l = {.width = width, .height = height};
    const svo_vec3 axes[3] = {eye->right, eye->up, eye->forward};
    for (int i = 0; i < 3; i++) l.axis[i][0] = axes[i].x, l.axis[i][1] = axes[i].y, l.axis[i][2] = axes[i].z;
    double ty = tan(0.5 * eye->yfov), tx = ty * width / height;
    for (int k = 0; k < 3; k++) {
        l.plane[0][k] = l.axis[0][k] + tx * l.axis[2][k];
        l.plane[1][k] = -l.axis[0][k] + tx * l.axis[2][k];
        l.plane[2][k] = l.axis[1][k] + ty * l.axis[2][k];
        l.plane[3][k] = -l.axis[1][k] + ty * l.axis[2][k];
    }
    l.focal = 0.5 * height / ty;
    return l;
}

svoi_rect svoi_project(const svoi_look *l, const double low[3], const double high[3])
{
    double x[8], y[8], z[8], part[3][3][2];
    svoi_rect r = {-INFINITY, -INFINITY, INFINITY, INFINITY, INFINITY, -INFINITY};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) part[i][k][0] = l->axis[i][k] * low[k], part[i][k][1] = l->axis[i][k] * high[k];
    for (int i = 0; i < 8; i++) {
        x[i] = part[0][0][i & 1] + part[0][1][i >> 1 & 1] + part[0][2][i >> 2];
        y[i] = part[1][0][i & 1] + part[1][1][i >> 1 & 1] + part[1][2][i >> 2];
        z[i] = part[2][0][i & 1] + part[2][1][i >> 1 & 1] + part[2][2][i >> 2];
    }
    for (int i = 0; i < 8; i++) r.near = z[i] < r.near ? z[i] : r.near, r.far = z[i] > r.far ? z[i] : r.far;
    if (r.near <= 0) return r;
    double x0 = INFINITY, x1 = -INFINITY, y0 = INFINITY, y1 = -INFINITY;
    for (int i = 0; i < 8; i++) {
        double w = 1 / z[i], u = x[i] * w, v = y[i] * w;
        x0 = u < x0 ? u : x0, x1 = u > x1 ? u : x1, y0 = v < y0 ? v : y0, y1 = v > y1 ? v : y1;
    }
    r.x0 = 0.5 * l->width + l->focal * x0, r.x1 = 0.5 * l->width + l->focal * x1;
    r.y0 = 0.5 * l->height - l->focal * y1, r.y1 = 0.5 * l->height - l->focal * y0;
    return r;
}

bool svoi_outside(const svoi_look *l, const double low[3], const double high[3])
{
    for (int p = 0; p < 4; p++) {
        double most = 0;
        for (int k = 0; k < 3; k++) most += fmax(l->plane[p][k] * low[k], l->plane[p][k] * high[k]);
        if (most < 0) return true;
    }
    return false;
}

/* ---- drawing --------------------------------------------------------------------------------------------------------- */

void svoi_draw_box(const svoi_look *l, const float low[3], const float high[3], svoi_sample_fn hit, void *user)
{
    double lo[3], hi[3];
    for (int k = 0; k < 3; k++) lo[k] = low[k], hi[k] = high[k];
    svoi_rect r = svoi_project(l, lo, hi);
    if (r.far <= 0) return;
    svoi_span s = svoi_samples(l, &r);
    for (uint32_t y = s.y0; y < s.y1; y++)
        for (uint32_t x = s.x0; x < s.x1; x++) {
            double u = (x + 0.5 - 0.5 * l->width) / l->focal, v = (0.5 * l->height - y - 0.5) / l->focal, enter = 0, leave = INFINITY;
            for (int k = 0; k < 3; k++) {
                double d = l->axis[2][k] + u * l->axis[0][k] + v * l->axis[1][k];
                if (d == 0) {
                    if (lo[k] > 0 || hi[k] < 0) leave = -1;
                    continue;
                }
                double w = 1 / d, a = lo[k] * w, b = hi[k] * w;
                enter = fmax(enter, fmin(a, b)), leave = fmin(leave, fmax(a, b));
            }
            if (enter <= leave) hit(user, x, y, (float)enter);
        }
}

/* ---- depths ---------------------------------------------------------------------------------------------------------- */

svo_result svoi_depth_make(svoi_depth *d, uint32_t width, uint32_t height, const svo_allocator *a, svo_error *err)
{
    memset(d, 0, sizeof *d);
    d->allocator = a, d->width = width, d->height = height;
    d->nearest = svo_alloc(a, (uint64_t)width * height, sizeof *d->nearest);
    bool ok = d->nearest != NULL;
    for (uint32_t l = 1; l < SVOI_DEPTH_LEVELS && ok; l++) {
        uint64_t w = (width + (1u << l) - 1) >> l, h = (height + (1u << l) - 1) >> l;
        d->level[l] = svo_alloc(a, w * h, sizeof(float));
        ok = d->level[l] != NULL;
        d->levels = l;
        if (w == 1 && h == 1) break;
    }
    if (!ok) {
        svoi_depth_free(d);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for depths");
    }
    const float none = INFINITY;
    uint32_t bits;
    memcpy(&bits, &none, 4);
    for (uint64_t i = 0; i < (uint64_t)width * height; i++) d->nearest[i] = bits;
    svoi_depth_update(d);
    return SVO_OK;
}

void svoi_depth_free(svoi_depth *d)
{
    svo_free(d->allocator, d->nearest, (uint64_t)d->width * d->height, sizeof *d->nearest);
    for (uint32_t l = 1; l < SVOI_DEPTH_LEVELS; l++)
        svo_free(d->allocator, d->level[l], (uint64_t)((d->width + (1u << l) - 1) >> l) * ((d->height + (1u << l) - 1) >> l), sizeof(float));
    memset(d, 0, sizeof *d);
}

/* Depths are not negative, so their bits are in their order, and the least is the same whoever comes first. */
void svoi_depth_add(void *depth, uint32_t x, uint32_t y, float at)
{
    svoi_depth *d = depth;
    uint32_t *to = &d->nearest[(uint64_t)y * d->width + x], bits, old = __atomic_load_n(to, __ATOMIC_RELAXED);
    memcpy(&bits, &at, 4);
    while (bits < old && !__atomic_compare_exchange_n(to, &old, bits, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) continue;
}

static float of_bits(uint32_t bits)
{
    float v;
    memcpy(&v, &bits, 4);
    return v;
}

void svoi_depth_update(svoi_depth *d)
{
    uint32_t w = d->width, h = d->height;
    for (uint32_t l = 1; l <= d->levels; l++) {
        uint32_t nw = (d->width + (1u << l) - 1) >> l, nh = (d->height + (1u << l) - 1) >> l;
        for (uint32_t y = 0; y < nh; y++)
            for (uint32_t x = 0; x < nw; x++) {
                float most = 0;
                for (uint32_t j = 2 * y; j < 2 * y + 2 && j < h; j++)
                    for (uint32_t i = 2 * x; i < 2 * x + 2 && i < w; i++) {
                        float v = l == 1 ? of_bits(d->nearest[(uint64_t)j * w + i]) : d->level[l - 1][(uint64_t)j * w + i];
                        most = v > most ? v : most;
                    }
                d->level[l][(uint64_t)y * nw + x] = most;
            }
        w = nw, h = nh;
    }
}

/* The thesis takes four corners at the level where the rectangle is at most two wide; here all texels that it meets at that level, at most three an axis. */
bool svoi_depth_hides(const svoi_depth *d, const svoi_span *s, double near)
{
    if (s->x0 >= s->x1 || s->y0 >= s->y1) return true;
    uint32_t size = s->x1 - s->x0 > s->y1 - s->y0 ? s->x1 - s->x0 : s->y1 - s->y0, l = 1;
    while (l < d->levels && (size - 1) >> l > 1) l++;
    uint32_t w = (d->width + (1u << l) - 1) >> l;
    for (uint32_t y = s->y0 >> l; y <= (s->y1 - 1) >> l; y++)
        for (uint32_t x = s->x0 >> l; x <= (s->x1 - 1) >> l; x++)
            if (!(near > d->level[l][(uint64_t)y * w + x])) return false;
    return true;
}

/* ---- the direct output ----------------------------------------------------------------------------------------------- */

typedef struct drawing {
    const svo_selection *selection;
    svoi_look look;
    uint64_t *nearest; /* depth's bits, then the number of the box */
} drawing;

typedef struct pen { drawing *d; uint32_t number; } pen;

static void add_owner(void *user, uint32_t x, uint32_t y, float depth)
{
    const pen *p = user;
    uint64_t *to = &p->d->nearest[(uint64_t)y * p->d->look.width + x], old = __atomic_load_n(to, __ATOMIC_RELAXED);
    uint32_t bits;
    memcpy(&bits, &depth, 4);
    uint64_t mine = (uint64_t)bits << 32 | p->number;
    while (mine < old && !__atomic_compare_exchange_n(to, &old, mine, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) continue;
}

static svo_result draw_boxes(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    drawing *d = user;
    for (uint64_t i = begin; i < end; i++) {
        pen p = {d, (uint32_t)i};
        svoi_draw_box(&d->look, d->selection->boxes[i].low, d->selection->boxes[i].high, add_owner, &p);
    }
    return SVO_OK;
}

svo_result svo_select_draw(const svo_selection *s, const svo_select_options *o, uint32_t *owner, float *depth, svo_error *err)
{
    uint64_t count = (uint64_t)o->width * o->height;
    drawing d = {.selection = s, .look = svoi_look_make(&o->eye, o->width, o->height)};
    d.nearest = svo_alloc(o->allocator, count, sizeof *d.nearest);
    if (d.nearest == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a picture of %u x %u samples", o->width, o->height);
    memset(d.nearest, 0xff, count * sizeof *d.nearest);
    svo_result result = svo_parallel_for(o->threads, s->count, 0, draw_boxes, &d, err);
    for (uint64_t i = 0; i < count && result == SVO_OK; i++) {
        owner[i] = (uint32_t)d.nearest[i];
        depth[i] = d.nearest[i] == UINT64_MAX ? INFINITY : of_bits((uint32_t)(d.nearest[i] >> 32));
    }
    svo_free(o->allocator, d.nearest, count, sizeof *d.nearest);
    return result;
}

typedef struct shading {
    const svo_scene *scene;
    const svo_selection *selection;
    const svo_render_options *o;
    const uint32_t *owner;
    uint32_t *channel[2];
    uint8_t *pixels;
    svo_vec3 light;
} shading;

static void add_sample(const shading *s, uint32_t number, float sum[4])
{
    const svo_selected *b = &s->selection->boxes[number];
    uint32_t asset = s->scene->instance_asset[b->instance];
    float rgb[2][3] = {{0.6f, 0.6f, 0.6f}, {0, 0, 0}}, n[3];
    for (int c = 0; c < 2; c++) {
        uint8_t value[SVO_MAX_STRIDE];
        if (s->channel[c][asset] == SVO_MAX_CHANNELS) continue;
        svo_view_attribute(s->scene->assets[asset], s->channel[c][asset], b->attribute, value);
        for (int k = 0; k < 3; k++) rgb[c][k] = svo_srgb_to_linear(value[k]);
    }
    svo_oct32_decode(b->normal, n);
    /* as in svo_render: two-sided, and a sky that is brighter than the ground */
    svo_vec3 normal = {n[0], n[1], n[2]}, view = {b->low[0] + b->high[0], b->low[1] + b->high[1], b->low[2] + b->high[2]};
    if (svo_dot(normal, svo_normalize(view)) > 0.25) normal = svo_scale(normal, -1);
    float light = (float)(s->o->ambient * (0.75 + 0.25 * normal.y) + (1 - s->o->ambient) * fmax(0, svo_dot(normal, s->light)));
    for (int k = 0; k < 3; k++) sum[k] += rgb[0][k] * light + rgb[1][k];
    sum[3] += 1;
}

static svo_result shade_rows(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    const shading *s = user;
    const svo_render_options *o = s->o;
    float total = (float)(o->samples * o->samples);
    for (uint64_t y = begin; y < end; y++)
        for (uint32_t x = 0; x < o->width; x++) {
            float sum[4] = {0, 0, 0, 0};
            for (uint32_t j = 0; j < o->samples; j++)
                for (uint32_t i = 0; i < o->samples; i++) {
                    uint32_t number = s->owner[(y * o->samples + j) * o->width * o->samples + (uint64_t)x * o->samples + i];
                    if (number != UINT32_MAX) add_sample(s, number, sum);
                }
            uint8_t *out = s->pixels + 4 * (y * o->width + x);
            double height = ((double)y + 0.5) / o->height;
            for (int k = 0; k < 3; k++) {
                float back = (float)(o->background_top[k] * (1 - height) + o->background_bottom[k] * height);
                float c = o->transparent ? (sum[3] > 0 ? sum[k] / sum[3] : 0) : (sum[k] + (total - sum[3]) * back) / total;
                out[k] = svo_linear_to_srgb(c);
            }
            out[3] = o->transparent ? (uint8_t)(255 * sum[3] / total + 0.5f) : 255;
        }
    return SVO_OK;
}

svo_result svo_select_render(const svo_scene *scene, const svo_selection *selection, const svo_render_options *o, uint8_t *pixels, uint64_t *covered, svo_error *err)
{
    static const char *const names[2] = {"color", "emissive"};
    svo_select_options draw = {.eye = o->eye, .width = o->width * o->samples, .height = o->height * o->samples, .threads = o->threads, .allocator = o->allocator};
    uint64_t count = (uint64_t)draw.width * draw.height;
    uint32_t *owner = svo_alloc(o->allocator, count, sizeof *owner);
    float *depth = svo_alloc(o->allocator, count, sizeof *depth);
    shading s = {.scene = scene, .selection = selection, .o = o, .owner = owner, .pixels = pixels, .light = svo_normalize(o->light)};
    bool ok = owner != NULL && depth != NULL;
    for (int c = 0; c < 2; c++) {
        s.channel[c] = svo_alloc(o->allocator, scene->asset_count, sizeof *s.channel[c]);
        ok = ok && (s.channel[c] != NULL || scene->asset_count == 0);
        for (uint32_t a = 0; a < scene->asset_count && ok; a++) {
            uint32_t n = svo_view_find_channel(scene->assets[a], names[c]);
            s.channel[c][a] = n < scene->assets[a]->channel_count && scene->assets[a]->channels[n].channel.kind == SVO_KIND_COLOR_SRGB8 ? n : SVO_MAX_CHANNELS;
        }
    }
    svo_result result = ok ? svo_select_draw(selection, &draw, owner, depth, err) : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a picture");
    if (result == SVO_OK) result = svo_parallel_for(o->threads, o->height, 8, shade_rows, &s, err);
    if (result == SVO_OK && covered != NULL) {
        *covered = 0;
        for (uint64_t i = 0; i < count; i++) *covered += owner[i] != UINT32_MAX;
    }
    svo_free(o->allocator, owner, count, sizeof *owner);
    svo_free(o->allocator, depth, count, sizeof *depth);
    for (int c = 0; c < 2; c++) svo_free(o->allocator, s.channel[c], scene->asset_count, sizeof *s.channel[c]);
    return result;
}
