#include "svo_resample.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"
#include "svo_task.h"

enum { DEFAULT_CELLS = 4096, MAX_CELLS = 1 << 20 };

typedef struct resampling {
    const svo_selection *selection;
    svo_resample_method method;
    uint64_t most_cells;
    double corner[3], side; /* of the root cube, relative to the selection's origin */
    uint32_t depth;
    uint64_t *start; /* first sample of each box */
    svo_sample *samples;
} resampling;

/* The cells of a box: level and their first and last an axis. */
typedef struct cells {
    uint32_t level, first[3], last[3];
    bool clamped, coarsened;
} cells;

/* Level of the smallest cells that are at least as wide as `width` (in parts of the root cube). */
static int level_of(double width)
{
    int e;
    double m = frexp(width, &e); /* width = m 2^e, 0.5 <= m < 1 */
    return m == 0.5 ? 1 - e : -e;
}

static cells cells_of(const resampling *r, const svo_selected *b)
{
    cells c = {0};
    double low[3], high[3], shortest = INFINITY, longest = 0;
    for (int k = 0; k < 3; k++) {
        low[k] = (b->low[k] - r->corner[k]) / r->side, high[k] = (b->high[k] - r->corner[k]) / r->side;
        shortest = fmin(shortest, high[k] - low[k]), longest = fmax(longest, high[k] - low[k]);
    }
    double width = r->method == SVO_RESAMPLE_RESIZE ? longest : shortest;
    int level = width > 0 ? level_of(width) + (r->method == SVO_RESAMPLE_RESIZE) : (int)r->depth + 1;
    c.clamped = level > (int)r->depth;
    if (c.clamped) level = (int)r->depth;
    if (level < 0) level = 0;
    for (;; level--, c.coarsened = true) {
        uint64_t count = 1;
        double scale = ldexp(1, level), end = scale - 1;
        for (int k = 0; k < 3; k++) {
            /* (samples outside the cube are constrained to it, 4.2.1; only rounding puts any there) */
            double first = fmin(fmax(floor(low[k] * scale), 0), end), last = fmin(fmax(floor(high[k] * scale), 0), end);
            c.first[k] = (uint32_t)first, c.last[k] = (uint32_t)last;
            count *= (uint64_t)c.last[k] - c.first[k] + 1;
        }
        c.level = (uint32_t)level;
        if (level == 0 || count <= r->most_cells) return c;
    }
}

static uint64_t count_of(const cells *c)
{
    uint64_t n = 1;
    for (int k = 0; k < 3; k++) n *= (uint64_t)c->last[k] - c->first[k] + 1;
    return n;
}

static svo_result count_boxes(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    resampling *r = user;
    for (uint64_t i = begin; i < end; i++) {
        cells c = cells_of(r, &r->selection->boxes[i]);
        r->start[i] = count_of(&c) | (uint64_t)c.clamped << 62 | (uint64_t)c.coarsened << 63;
    }
    return SVO_OK;
}

static svo_result fill_boxes(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    resampling *r = user;
    for (uint64_t i = begin; i < end; i++) {
        cells c = cells_of(r, &r->selection->boxes[i]);
        svo_sample *to = r->samples + r->start[i];
        for (uint32_t z = c.first[2]; z <= c.last[2]; z++)
            for (uint32_t y = c.first[1]; y <= c.last[1]; y++)
                for (uint32_t x = c.first[0]; x <= c.last[0]; x++)
                    *to++ = (svo_sample){svo_morton_encode(x, y, z) << 3 * (r->depth - c.level), (uint32_t)i, c.level};
    }
    return SVO_OK;
}

/* A cube around everything, and the depth at which the finest cells that are asked for are. */
static void find_root(resampling *r)
{
    const svo_selection *s = r->selection;
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, finest = INFINITY;
    for (uint64_t i = 0; i < s->count; i++) {
        const svo_selected *b = &s->boxes[i];
        double shortest = INFINITY, longest = 0;
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], b->low[k]), high[k] = fmax(high[k], b->high[k]);
            shortest = fmin(shortest, (double)b->high[k] - b->low[k]), longest = fmax(longest, (double)b->high[k] - b->low[k]);
        }
        double width = r->method == SVO_RESAMPLE_RESIZE ? 0.5 * longest : shortest;
        if (width > 0) finest = fmin(finest, width);
    }
    if (s->count == 0) {
        r->depth = 2, r->side = 1;
        return;
    }
    /* Cells lie at multiples of their size from the selection's origin, so that they do not depend on what else is selected: the root is a cube of a power of
     * two around the origin. What is far from the eye is coarse, so this costs few levels. */
    double reach = 0;
    for (int k = 0; k < 3; k++) reach = fmax(reach, fmax(fabs(low[k]), fabs(high[k])));
    if (!(reach > 0)) reach = 1; /* a point at the eye */
    int e;
    frexp(reach * (1 + 1e-6), &e);
    r->side = ldexp(1, e + 1);
    for (int k = 0; k < 3; k++) r->corner[k] = -0.5 * r->side;
    int depth = finest < INFINITY ? level_of(finest / r->side) : 2;
    r->depth = depth < 2 ? 2 : depth > (int)SVO_MAX_DEPTH ? SVO_MAX_DEPTH : (uint32_t)depth;
}

svo_result svo_resample(const svo_selection *s, svo_resample_method method, uint64_t most_cells, uint32_t threads, const svo_allocator *a,
                        svo_resampled *out, svo_error *err)
{
    double began = svo_seconds();
    if (most_cells == 0) most_cells = DEFAULT_CELLS;
    resampling r = {.selection = s, .method = method, .most_cells = most_cells > MAX_CELLS ? MAX_CELLS : most_cells < 64 ? 64 : most_cells};
    memset(out, 0, sizeof *out);
    find_root(&r);
    svo_resample_report report = {.boxes = s->count, .depth = r.depth};
    r.start = svo_alloc(a, s->count, sizeof *r.start);
    if (r.start == NULL && s->count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for resampling");
    svo_result result = svo_parallel_for(threads, s->count, 0, count_boxes, &r, err);
    uint64_t total = 0;
    for (uint64_t i = 0; i < s->count && result == SVO_OK; i++) {
        uint64_t n = r.start[i];
        report.clamped += n >> 62 & 1, report.coarsened += n >> 63;
        r.start[i] = total;
        total += n & ~((uint64_t)3 << 62);
    }
    r.samples = result == SVO_OK ? svo_alloc(a, total, sizeof *r.samples) : NULL;
    if (result == SVO_OK && r.samples == NULL && total != 0)
        result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %llu samples of deformed voxels", (unsigned long long)total);
    if (result == SVO_OK) result = svo_parallel_for(threads, s->count, 0, fill_boxes, &r, err);
    svo_free(a, r.start, s->count, sizeof *r.start);
    if (result != SVO_OK) {
        svo_free(a, r.samples, total, sizeof *r.samples);
        return result;
    }
    report.samples = total;
    report.seconds = svo_seconds() - began;
    double voxel = ldexp(r.side, -(int)r.depth);
    *out = (svo_resampled){.allocator = a, .depth = r.depth, .count = total, .samples = r.samples, .report = report};
    for (int k = 0; k < 3; k++) {
        out->voxel_to_world[5 * k] = voxel;
        out->voxel_to_world[4 * k + 3] = s->origin[k] + r.corner[k];
    }
    out->voxel_to_world[15] = 1;
    return SVO_OK;
}

void svo_resampled_free(svo_resampled *r)
{
    if (r == NULL) return;
    svo_free(r->allocator, r->samples, r->count, sizeof *r->samples);
    memset(r, 0, sizeof *r);
}
