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
        for (int k = 0; k < 3; k++) most += l->plane[p][k] * (l->plane[p][k] > 0 ? high[k] : low[k]);
        if (most < 0) return true;
    }
    return false;
}

/* ---- drawing --------------------------------------------------------------------------------------------------------- */

void svoi_draw_box(const svoi_look *l, const float low[3], const float high[3], svoi_sample_fn hit, void *user) { svoi_draw_box_rows(l, low, high, 0, l->height, hit, user); }

void svoi_draw_box_rows(const svoi_look *l, const float low[3], const float high[3], uint32_t begin, uint32_t end, svoi_sample_fn hit, void *user)
{
    double lo[3], hi[3];
    for (int k = 0; k < 3; k++) lo[k] = low[k], hi[k] = high[k];
    svoi_rect r = svoi_project(l, lo, hi);
    if (r.far <= 0) return;
    svoi_span s = svoi_samples(l, &r);
    s.y0 = s.y0 > begin ? s.y0 : begin, s.y1 = s.y1 < end ? s.y1 : end;
    svoi_draw_span(l, lo, hi, &s, hit, user);
}

void svoi_draw_span(const svoi_look *l, const double lo[3], const double hi[3], const svoi_span *s, svoi_sample_fn hit, void *user)
{
    for (uint32_t y = s->y0; y < s->y1; y++)
        for (uint32_t x = s->x0; x < s->x1; x++) {
            double u = (x + 0.5 - 0.5 * l->width) / l->focal, v = (0.5 * l->height - y - 0.5) / l->focal, enter = 0, leave = INFINITY;
            for (int k = 0; k < 3; k++) {
                double d = l->axis[2][k] + u * l->axis[0][k] + v * l->axis[1][k];
                if (d == 0) {
                    if (lo[k] > 0 || hi[k] < 0) leave = -1;
                    continue;
                }
                double w = 1 / d, a = lo[k] * w, b = hi[k] * w, first = a < b ? a : b, last = a < b ? b : a;
                enter = first > enter ? first : enter, leave = last < leave ? last : leave;
            }
            if (enter <= leave) hit(user, x, y, (float)enter, (float)leave);
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
void svoi_depth_add(void *depth, uint32_t x, uint32_t y, float at, float leave)
{
    (void)leave;
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
